/* Where every option of a retraining starts, by preset, and its limits. The values stand here a
 * second time, so that no change to one goes unnoticed. K: retrain defaults presets limits */

#include "train/options.h"
#include "spin_run.h"
#include "run/run.h"
#include "tests/tap.h"

/* Every field in its order and by no name: a new field does not compile until its defaults stand
 * here. */
#pragma GCC diagnostic error "-Wmissing-field-initializers"

static const struct spin_retrain_options paper = {
    NULL,
    NULL,    /* input, output */
    "paper", /* preset */
    NULL,
    NULL,
    NULL, /* data, data_from, pair */
    {0},  /* range */
    1,    /* image_scale */
    NULL,
    0,                       /* test_cameras */
    SPIN_METHOD_NETWORK,     /* method */
    0,                       /* refine */
    SPIN_REFINE_FROM_POINTS, /* refine_start */
    true,                    /* densify */
    0,                       /* max_points */
    40000,
    3, /* iterations, batch */
    16,
    4,
    21, /* levels, features, hash_log2 */
    64,
    3,                     /* hidden, sh_degree */
    {8, 8, 8, 8},          /* base_resolution */
    {2048, 2048, 2048, 0}, /* finest_resolution */
    0.2,                   /* lambda_dssim */
    0,
    0,     /* lambda_scale, lambda_opacity */
    1,     /* dynamic_weight */
    false, /* antialias */
    1e-4,  /* hash_init_range */
    0,     /* seed */
    -1,    /* warmup */
    0,     /* average */
    8e-3,
    1e-3,
    3e-4, /* lr_table, lr_sh, lr_scale */
    3e-5,
    8e-4,
    1.6e-4,            /* lr_rotation, lr_opacity, lr_position */
    0,                 /* sh_increase_every */
    SPIN_EXPOSURE_OFF, /* learn_exposure */
    1e-3,              /* lr_exposure */
    1,                 /* lr_head_factor */
    false,             /* tracks */
    2,
    1,
    2.5e-4, /* lr_track, lr_tracked, lr_displacement */
    -1,     /* track_iterations */
    SPIN_BACKDROP_OFF,
    true, /* dynamic_residual */
    0,    /* densify_every */
    5e-4,
    0.6,                /* densify_threshold, densify_until */
    0,                  /* network_start */
    SPIN_RESIDUAL_OFF,  /* residual */
    1,                  /* lr_residual */
    -5,                 /* init_log_scale */
    false,              /* relu */
    SPIN_NORMALISE_OFF, /* normalise */
    {0, 0, 0},
    0,                      /* normalise_centre, normalise_radius */
    1,                      /* views_per_frame */
    {0, 0, 0},              /* background */
    SPIN_PRECISION_COMPACT, /* precision */
    "auto",                 /* device */
    0,                      /* n_threads */
    false,                  /* deterministic */
    0,
    0, /* eval_every, save_every */
    false,
    false,
    false,
    false, /* resume, force, dry_run, auto_resume */
    NULL,
    NULL,
    NULL,
    NULL, /* preview, log, watch, cache */
};

static const struct spin_retrain_options shorter = {
    NULL,
    NULL,    /* input, output */
    "short", /* preset */
    NULL,
    NULL,
    NULL, /* data, data_from, pair */
    {0},  /* range */
    1,    /* image_scale */
    NULL,
    0,                       /* test_cameras */
    SPIN_METHOD_NETWORK,     /* method */
    0,                       /* refine */
    SPIN_REFINE_FROM_POINTS, /* refine_start */
    true,                    /* densify */
    0,                       /* max_points */
    1500,
    3, /* iterations, batch */
    16,
    4,
    19, /* levels, features, hash_log2 */
    64,
    3,                     /* hidden, sh_degree */
    {8, 8, 8, 8},          /* base_resolution */
    {2048, 2048, 2048, 0}, /* finest_resolution */
    0.2,                   /* lambda_dssim */
    0,
    0,     /* lambda_scale, lambda_opacity */
    1,     /* dynamic_weight */
    false, /* antialias */
    1e-4,  /* hash_init_range */
    0,     /* seed */
    -1,    /* warmup */
    0,     /* average */
    4e-2,
    1e-3,
    3e-4, /* lr_table, lr_sh, lr_scale */
    3e-5,
    8e-4,
    1e-3,               /* lr_rotation, lr_opacity, lr_position */
    0,                  /* sh_increase_every */
    SPIN_EXPOSURE_AUTO, /* learn_exposure */
    4e-3,               /* lr_exposure */
    4,                  /* lr_head_factor */
    false,              /* tracks */
    2,
    1,
    2.5e-4, /* lr_track, lr_tracked, lr_displacement */
    -1,     /* track_iterations */
    SPIN_BACKDROP_OFF,
    true, /* dynamic_residual */
    0,    /* densify_every */
    5e-4,
    0.6,                  /* densify_threshold, densify_until */
    0,                    /* network_start */
    SPIN_RESIDUAL_POINTS, /* residual */
    8,                    /* lr_residual */
    -5,                   /* init_log_scale */
    false,                /* relu */
    SPIN_NORMALISE_AUTO,  /* normalise */
    {0, 0, 0},
    0,                      /* normalise_centre, normalise_radius */
    3,                      /* views_per_frame */
    {0, 0, 0},              /* background */
    SPIN_PRECISION_COMPACT, /* precision */
    "auto",                 /* device */
    0,                      /* n_threads */
    false,                  /* deterministic */
    0,
    0, /* eval_every, save_every */
    false,
    false,
    false,
    false, /* resume, force, dry_run, auto_resume */
    NULL,
    NULL,
    NULL,
    NULL, /* preview, log, watch, cache */
};

/* What differs from "short". */
static const struct spin_retrain_options *quick(void)
{
    static struct spin_retrain_options q;

    q = shorter;
    q.preset = "quick";
    q.backdrop = SPIN_BACKDROP_AUTO;
    q.method = SPIN_METHOD_TRACKS;
    q.tracks = q.antialias = true;
    q.iterations = -1;
    q.batch = -1;
    q.views_per_frame = 1;
    q.lr_position = 5e-4;
    q.average = 0.3;
    q.lr_track = 3;
    q.lr_tracked = 0.3;
    q.densify_every = -1;
    return &q;
}

static const struct spin_retrain_options *best(void)
{
    static struct spin_retrain_options b;

    b = *quick();
    b.preset = "best";
    b.lr_track = 2;
    b.lr_tracked = 0.15;
    b.iterations = -3;
    return &b;
}

static void same(const char *name, const struct spin_retrain_options *want)
{
    struct spin_retrain_options got;
    const unsigned char *a = (const unsigned char *)&got, *b = (const unsigned char *)want;
    size_t i = 0;

    memset(&got, 0xff, sizeof got);
    if (!ok(spin_retrain_preset(name, &got) == SPIN_OK, "there is a preset '%s'", name))
        return;
    is_text(got.device, want->device, "its device");
    is_text(got.preset, want->preset, "its name");
    got.device = want->device;
    got.preset = want->preset;
    while (i < sizeof got && a[i] == b[i])
        i++;
    ok(i == sizeof got, "'%s': every field is as it stands here", name);
    if (i < sizeof got)
        printf("#   the first that is not: byte %zu of struct spin_retrain_options\n", i);
}

/* ---- Limits of the library call -----------------------------------------------------------------
 */

static struct spin_retrain_options o;

/* The input is not there, which is found after the options were checked. */
static void is_refused(bool want, const char *field)
{
    struct spin_retrain_report report;
    spin_status status = spin_train(&o, &report);
    char name[40];

    snprintf(name, sizeof name, "%.*s", (int)strcspn(field, "["), field);
    if (want)
        ok(status == SPIN_E_USAGE && strstr(spin_last_error(), name), "%s is refused: %s", field,
           spin_last_error());
    else
        ok(status != SPIN_OK && status != SPIN_E_USAGE, "%s is allowed: %s", field,
           spin_last_error());
    spin_retrain_preset("paper", &o);
    o.input = "nowhere/in.spin";
    o.output = "nowhere/out.spin";
}

/* One value on the limit, one beyond it. */
#define LIMIT(field, on, beyond)                                                                   \
    do {                                                                                           \
        o.field = on;                                                                              \
        is_refused(false, #field);                                                                 \
        o.field = beyond;                                                                          \
        is_refused(true, #field);                                                                  \
    } while (0)

static void test_limits(void)
{
    spin_retrain_preset("paper", &o);
    is_refused(true, "input");
    LIMIT(image_scale, 0.01, 0.009);
    LIMIT(image_scale, 1, NAN);
    LIMIT(background[2], 1, 1.01f);
    LIMIT(iterations, 1, 0);
    LIMIT(iterations, -1, -2);
    LIMIT(iterations, -3, -4);
    LIMIT(densify_every, -1, -2);
    LIMIT(track_iterations, -1, 0);
    LIMIT(batch, 1024, 1025);
    LIMIT(views_per_frame, 3, 4);
    LIMIT(views_per_frame, 1, 0);
    LIMIT(lambda_dssim, 1, 1.01);
    LIMIT(dynamic_weight, 1e-3, 0);
    LIMIT(lambda_opacity, 1e3, -1);
    LIMIT(lambda_scale, 1e3, INFINITY);
    LIMIT(warmup, 0, -2);
    LIMIT(lr_table, 0, -1e-3);
    LIMIT(lr_sh, 1, 2);
    LIMIT(lr_scale, 1, NAN);
    LIMIT(lr_rotation, 1, 2);
    LIMIT(lr_opacity, 1, 2);
    LIMIT(lr_position, 0, INFINITY);
    LIMIT(lr_head_factor, 1000, 1001);
    LIMIT(sh_increase_every, 0, -1);
    LIMIT(learn_exposure, SPIN_EXPOSURE_AUTO, SPIN_EXPOSURE_AUTO + 1);
    LIMIT(backdrop, SPIN_BACKDROP_AUTO, SPIN_BACKDROP_AUTO + 1);
    LIMIT(lr_exposure, 1, 2);
    LIMIT(eval_every, 0, -1);
    LIMIT(save_every, 0, -1);
    LIMIT(method, SPIN_METHOD_NETWORK, SPIN_METHOD_4D + 1);
    LIMIT(lr_track, 0, -1);
    LIMIT(average, 1, 2);
    LIMIT(lr_tracked, 1000, 1001);
    LIMIT(lr_displacement, 1, 2);
    LIMIT(densify_threshold, 1, 2);
    LIMIT(densify_until, 1, 1.5);
    LIMIT(network_start, 1, -1);
    LIMIT(refine, 0, -1);
    LIMIT(refine_start, SPIN_REFINE_FROM_SOURCE, SPIN_REFINE_FROM_SOURCE + 1);
    LIMIT(max_points, 0, -1);
    LIMIT(levels, 32, 33);
    LIMIT(features, 8, 0);
    LIMIT(hash_log2, 4, 27);
    LIMIT(hidden, 256, 0);
    LIMIT(sh_degree, 0, 4);
    LIMIT(base_resolution[3], 2, 1);
    LIMIT(finest_resolution[0], 65536, 65537);
    LIMIT(hash_init_range, 10, -1);
    LIMIT(init_log_scale, NAN, INFINITY);
    LIMIT(normalise, SPIN_NORMALISE_NONE, SPIN_NORMALISE_GIVEN); /* which has no radius yet */
    LIMIT(normalise, SPIN_NORMALISE_OFF, SPIN_NORMALISE_GIVEN + 1);
    LIMIT(residual, SPIN_RESIDUAL_SOURCE, SPIN_RESIDUAL_SOURCE + 1);
    LIMIT(lr_residual, 0, 1001);
    o.normalise = SPIN_NORMALISE_GIVEN;
    o.normalise_radius = 1;
    is_refused(false, "a radius");
    o.method = SPIN_METHOD_FRAMES;
    is_refused(true, "--refine");
    o.method = SPIN_METHOD_TRACKS;
    is_refused(true, "--tracks auto");
    o.method = SPIN_METHOD_TRACKS;
    o.tracks = true;
    is_refused(false, "tracks");
    o.method = SPIN_METHOD_TRACKS;
    o.tracks = true;
    o.refine = 1;
    is_refused(true, "does not work with --refine");
}

/* ---- Numbers that follow from the clip ---------------------------------------------------------
 */

static void resolves(const char *preset, int n_frames, int iterations, int densify_every)
{
    spin_retrain_preset(preset, &o);
    spin_options_resolve(&o, n_frames);
    ok(o.iterations == iterations && o.densify_every == densify_every,
       "%s, %d frames: %d iterations, densified every %d", preset, n_frames, o.iterations,
       o.densify_every);
}

static void test_resolve(void)
{
    resolves("quick", 1, 1600, 80);
    resolves("quick", 18, 3300, 165);
    resolves("quick", 150, 16500, 250);
    resolves("best", 18, 9900, 250);
    resolves("best", 100000000, 1000000000, 250);
    resolves("paper", 18, 40000, 0);
    resolves("short", 18, 1500, 0);
    spin_retrain_defaults(&o);
    o.iterations = 600;
    spin_options_resolve(&o, 18);
    ok(o.iterations == 600 && o.densify_every == 30,
       "given iterations stay; they are densified by them");
    spin_retrain_defaults(&o);
    o.densify_every = 0;
    spin_options_resolve(&o, 18);
    ok(o.iterations == 3300 && o.densify_every == 0, "a given rhythm stays");
    ok(o.track_iterations == 3300, "tracks learn in all of 3300 iterations");
    spin_retrain_defaults(&o);
    spin_options_resolve(&o, 150);
    ok(o.track_iterations == 5000, "in the first 5000 of 16500");
    o.track_iterations = 20000;
    spin_options_resolve(&o, 150);
    ok(o.track_iterations == 16500, "and never in more than there are");
}

/* ---- Settings in JSON
 * ---------------------------------------------------------------------------- */

/* want: with ' in place of ". */
static void is_json(enum spin_options_of of, const char *want)
{
    spin_json *j = spin_options_to_json(&o, of);
    char *text = spin_json_text(j, false);

    for (char *c = text; *c; c++)
        *c = *c == '"' ? '\'' : *c;
    is_text(text, want,
            of == SPIN_OPTIONS_OF_NETWORK ? "settings of the network" : "settings of a refinement");
    free(text);
    spin_json_free(j);
}

/* What decides a result and does not stand here passes for unchanged when a run is resumed. */
static void test_json(void)
{
    spin_retrain_preset("paper", &o);
    is_json(SPIN_OPTIONS_OF_NETWORK,
            "{'image_scale':1,'background':[0,0,0],'iterations':40000,'batch':3,"
            "'views_per_frame':1,'lambda_dssim':0.2,'seed':0,'warmup':-1,"
            "'lr_table':0.008,'lr_sh':0.001,'lr_scale':0.0003,'lr_rotation':3e-05,"
            "'lr_opacity':0.0008,'lr_position':0.00016,'lr_head_factor':1,"
            "'learn_exposure':'off','lr_exposure':0.001,'hash_log2':21,"
            "'base_resolution':[8,8,8,8],"
            "'finest_resolution':[2048,2048,2048,0],'init_log_scale':-5}");
    is_json(SPIN_OPTIONS_OF_REFINEMENT,
            "{'image_scale':1,'background':[0,0,0],'lambda_dssim':0.2,'seed':0,"
            "'iterations':0,'start':'points','densify':true,'max_points':0}");
    o.dynamic_weight = 2;
    o.lambda_opacity = 3;
    o.lambda_scale = 4;
    o.antialias = true;
    o.learn_exposure = SPIN_EXPOSURE_ON;
    o.sh_increase_every = 5;
    o.tracks = true;
    o.backdrop = SPIN_BACKDROP_ON;
    o.network_start = 0.25;
    o.max_points = 7;
    o.refine_start = SPIN_REFINE_FROM_SOURCE;
    o.densify = false;
    o.hash_init_range = 0.5;
    o.init_log_scale = NAN;
    o.residual = SPIN_RESIDUAL_SOURCE;
    o.seed = 9007199254740991;
    is_json(SPIN_OPTIONS_OF_NETWORK,
            "{'image_scale':1,'background':[0,0,0],'iterations':40000,'batch':3,"
            "'views_per_frame':1,'lambda_dssim':0.2,'dynamic_weight':2,"
            "'lambda_opacity':3,'lambda_scale':4,'seed':9007199254740991,"
            "'warmup':-1,'lr_table':0.008,'lr_sh':0.001,'lr_scale':0.0003,"
            "'lr_rotation':3e-05,'lr_opacity':0.0008,'lr_position':0.00016,"
            "'lr_head_factor':1,'sh_increase_every':5,'learn_exposure':'on',"
            "'lr_exposure':0.001,'max_points':7,'tracks':true,'lr_track':2,"
            "'lr_tracked':1,'lr_displacement':0.00025,'track_iterations':-1,'backdrop':'on','"
            "dynamic_residual':true,'densify_every':0,"
            "'densify_threshold':0.0005,'densify_until':0.6,'network_start':0.25,"
            "'hash_log2':21,'base_resolution':[8,8,8,8],"
            "'finest_resolution':[2048,2048,2048,0],'hash_init_range':0.5,"
            "'init_log_scale':'auto','residual':'source','lr_residual':1}");
    is_json(SPIN_OPTIONS_OF_REFINEMENT,
            "{'image_scale':1,'background':[0,0,0],'lambda_dssim':0.2,"
            "'dynamic_weight':2,'lambda_opacity':3,'lambda_scale':4,"
            "'antialias':true,'seed':9007199254740991,'lr_exposure':0.001,"
            "'iterations':0,'start':'source','densify':false,'max_points':7}");
}

TAP_MAIN
{
    struct spin_retrain_options defaults, preset;

    same("paper", &paper);
    same("short", &shorter);
    same("quick", quick());
    same("best", best());
    memset(&defaults, 0xff, sizeof defaults);
    spin_retrain_defaults(&defaults);
    ok(spin_retrain_preset("quick", &preset) == SPIN_OK &&
           memcmp(&defaults, &preset, sizeof preset) == 0,
       "the defaults are those of 'quick'");
    ok(spin_retrain_preset("no such", &preset) == SPIN_E_USAGE, "there is no other preset");
    test_limits();
    test_resolve();
    test_json();
}
