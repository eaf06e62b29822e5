/* Where every option of a retraining starts, by preset. The values stand here a second time, so that no
 * change to one goes unnoticed.
 * K: retrain defaults presets */
#include "spin.h"

#include "tests/tap.h"

/* Every field in its order and by no name: a new field does not compile until its defaults stand here. */
#pragma GCC diagnostic error "-Wmissing-field-initializers"

static const struct spin_retrain_options paper = {
    NULL,
    NULL, /* input, output */
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
    false,                   /* no_densify */
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
    8e-3,
    1e-3,
    3e-4, /* lr_table, lr_sh, lr_scale */
    3e-5,
    8e-4,
    1.6e-4,             /* lr_rotation, lr_opacity, lr_position */
    0,                  /* sh_increase_every */
    false,              /* learn_exposure */
    1e-3,               /* lr_exposure */
    1,                  /* lr_head_factor */
    SPIN_RESIDUAL_OFF,  /* residual */
    1,                  /* lr_residual */
    -5,                 /* init_log_scale */
    false,              /* relu */
    SPIN_NORMALISE_OFF, /* normalise */
    {0, 0, 0},
    0,         /* normalise_centre, normalise_radius */
    1,         /* views_per_frame */
    {0, 0, 0}, /* background */
    "auto",    /* device */
    0,         /* n_threads */
    0,
    0, /* eval_every, save_every */
    false,
    false,
    false, /* resume, force, dry_run */
    NULL,
    NULL, /* preview, log */
};

static const struct spin_retrain_options shorter = {
    NULL,
    NULL, /* input, output */
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
    false,                   /* no_densify */
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
    4e-2,
    1e-3,
    3e-4, /* lr_table, lr_sh, lr_scale */
    3e-5,
    8e-4,
    1e-3,                 /* lr_rotation, lr_opacity, lr_position */
    0,                    /* sh_increase_every */
    false,                /* learn_exposure */
    1e-3,                 /* lr_exposure */
    4,                    /* lr_head_factor */
    SPIN_RESIDUAL_POINTS, /* residual */
    8,                    /* lr_residual */
    -5,                   /* init_log_scale */
    false,                /* relu */
    SPIN_NORMALISE_AUTO,  /* normalise */
    {0, 0, 0},
    0,         /* normalise_centre, normalise_radius */
    3,         /* views_per_frame */
    {0, 0, 0}, /* background */
    "auto",    /* device */
    0,         /* n_threads */
    0,
    0, /* eval_every, save_every */
    false,
    false,
    false, /* resume, force, dry_run */
    NULL,
    NULL, /* preview, log */
};

static void same(const char *name, const struct spin_retrain_options *want)
{
    struct spin_retrain_options got;
    const unsigned char *a = (const unsigned char *)&got, *b = (const unsigned char *)want;
    size_t i = 0;

    memset(&got, 0xff, sizeof got);
    if (!ok(spin_retrain_preset(name, &got) == SPIN_OK, "there is a preset '%s'", name))
        return;
    is_text(got.device, want->device, "its device");
    got.device = want->device;
    while (i < sizeof got && a[i] == b[i])
        i++;
    ok(i == sizeof got, "'%s': every field is as it stands here", name);
    if (i < sizeof got)
        printf("#   the first that is not: byte %zu of struct spin_retrain_options\n", i);
}

TAP_MAIN
{
    struct spin_retrain_options defaults, preset;

    same("paper", &paper);
    same("short", &shorter);
    memset(&defaults, 0xff, sizeof defaults);
    spin_retrain_defaults(&defaults);
    ok(spin_retrain_preset("paper", &preset) == SPIN_OK &&
           memcmp(&defaults, &preset, sizeof preset) == 0,
       "the defaults are those of 'paper'");
    ok(spin_retrain_preset("no such", &preset) == SPIN_E_USAGE, "there is no other preset");
}
