/* spacetimegs: every fixture at all its times, lite and full; what the full model's network makes of colours,
 * options, clouds changed in many ways, and files that lie.
 * K: spacetimegs import threads */
#include "tests/importers/clouds.h"
#include "tests/importers/slices.h"

static const char *const anywhere[] = {"rgb-function", "sandwichnoact", "camera", "0,0,0", NULL};

/* ---- Fixtures -------------------------------------------------------------------------------- */

static const char *save_of(const char *folder)
{
    const char *clouds = path_in(folder, "model/point_cloud"), *save = NULL;
    char **names = NULL;
    size_t n = 0;
    long most = -1;

    if (spin_folder_list(clouds, &names, &n) != SPIN_OK)
        exit(1);
    for (size_t i = 0; i < n; i++) {
        if (atol(names[i] + strlen("iteration_")) > most) {
            most = atol(names[i] + strlen("iteration_"));
            save = path_in(clouds, names[i]);
        }
    }
    spin_folder_list_free(names);
    return save;
}

/* 0.5 + C0 of the degree 0 coefficients. */
static float *colours_of(const struct spin_splats *s)
{
    size_t width = 3 * (size_t)((s->sh_degree + 1) * (s->sh_degree + 1));
    float *out = malloc(3 * s->n * sizeof *out + 1);

    for (size_t i = 0; i < s->n; i++) {
        for (size_t c = 0; c < 3; c++)
            out[3 * i + c] = (float)(0.5 + SPIN_SH_C0 * s->sh[width * i + c]);
    }
    return out;
}

static void compare_time(struct spin_npz *npz, size_t t, const char *name,
                         const struct spin_splats *s)
{
    struct table cov = table_load(npz, "cov6", 1);
    struct expected xyz = {npz, bound("xyz").abs, bound("xyz").rel, name};
    struct expected rot = {npz, bound("rot").abs, 0, name}, opaque = {npz, 1e-5, 0, name};
    struct expected size = {npz, 0, 1e-5, name};
    float *opacity = map_values(s->logit_opacities, s->n, sigmoid);
    float *scale = map_values(s->log_scales, 3 * s->n, exp);
    size_t *row = malloc(s->n * sizeof *row);

    for (size_t i = 0; i < s->n; i++)
        row[i] = i;
    compare(&xyz, "xyz", 3 * t * s->n, 3 * s->n, s->means);
    compare_quats(&rot, "rot", 4 * t * s->n, s->n, s->quats);
    compare(&size, "scale", 3 * t * s->n, 3 * s->n, scale);
    compare(&opaque, "opacity", t * s->n, s->n, opacity);
    compare_covariances(&cov, t, row, s, name);
    check_sane(s, SPIN_COL_ATTRIBUTES, "all is finite, quaternions are of unit length");
    free(cov.value);
    free(opacity);
    free(scale);
    free(row);
}

/* The same at every time. `of` is the expected array, rgb or rgb_albedo. */
static void compare_base(struct spin_npz *npz, const char *of, const char *name,
                         const struct spin_splats *s)
{
    struct expected e = {npz, 1e-5, 0, name};
    float *rgb = colours_of(s);

    compare(&e, of, 0, 3 * s->n, rgb);
    free(rgb);
}

/* The model at `path` against the numbers of fixture `folder`, with base colours where it is full. */
static void compare_model(const char *path, const char *const *pairs, const char *folder,
                          const char *name)
{
    bool full = strstr(folder, "full_") != NULL;
    struct spin_splats s = {0}, again = {0};
    struct spin_array info;
    struct spin_npz npz;
    struct run run;
    double *times;

    bounds_of = folder;
    if (!ok(model_open("spacetimegs", path, pairs, &run) == SPIN_OK, "%s: opens", name)) {
        printf("#   %s\n", spin_last_error());
        return;
    }
    ok(run.sequence.static_columns == (SPIN_COL_LOG_SCALES | SPIN_COL_SH) &&
           run.sequence.sh_degree == 0,
       "%s: scales and colours are still", name);
    if (spin_npz_open(path_in(folder, "expected.npz"), &npz) != SPIN_OK)
        exit(1);
    times = check_load(&npz, "times", &info);
    for (size_t t = 0; times && t < info.count; t++) {
        char what[200];

        snprintf(what, sizeof what, "%s, time %g", name, times[t]);
        if (!ok(run.importer->frame(run.self, 0, times[t], run.sequence.columns, &s) == SPIN_OK,
                "%s: reads", what)) {
            printf("#   %s\n", spin_last_error());
            continue;
        }
        compare_time(&npz, t, what, &s);
        compare_base(&npz, full ? "rgb_albedo" : "rgb", what, &s);
        run.importer->frame(run.self, 0, times[t], SPIN_COL_MEANS, &again);
        check_same_bits(again.means, s.means, 3 * s.n * sizeof *s.means,
                        "positions alone are the same");
    }
    free(times);
    spin_splats_free(&s);
    spin_splats_free(&again);
    spin_npz_close(&npz);
    run_close(&run);
}

/* For one camera the colours are exactly the network's. */
static void compare_camera(const char *folder, struct spin_npz *npz, const double *camera, size_t c)
{
    struct expected e = {npz, bound("rgb_decoded").abs, 0, ""};
    struct spin_array info;
    struct spin_splats s = {0};
    struct run run;
    double *times = check_load(npz, "times", &info);
    char place[100], what[100];
    const char *pairs[] = {"camera", place, NULL};

    snprintf(place, sizeof place, "%.9g,%.9g,%.9g", camera[0], camera[1], camera[2]);
    if (model_open("spacetimegs", path_in(folder, "model"), pairs, &run) != SPIN_OK)
        exit(1);
    ok(run.sequence.sh_degree == 1 && run.sequence.static_columns == SPIN_COL_LOG_SCALES,
       "colours change with view and time");
    for (size_t t = 0; t < info.count; t++) {
        float *rgb;

        if (run.importer->frame(run.self, 0, times[t], run.sequence.columns, &s) != SPIN_OK)
            exit(1);
        snprintf(what, sizeof what, "%s, camera %zu, time %g", spin_path_name(folder), c, times[t]);
        e.name = what;
        rgb = colours_of(&s);
        compare(&e, "rgb_decoded", 3 * s.n * (3 * t + c), 3 * s.n, rgb);
        free(rgb);
    }
    free(times);
    spin_splats_free(&s);
    run_close(&run);
}

/* Colour c of a row seen along d, without the clamp. */
static double seen(const struct spin_splats *s, size_t i, const double d[3], size_t c)
{
    float basis[SPIN_SH_MAX];
    double sum = 0.5;

    spin_sh_basis(s->sh_degree, spin_v3((float)d[0], (float)d[1], (float)d[2]), basis);
    for (size_t k = 0; k < 4; k++)
        sum += basis[k] * s->sh[12 * i + 3 * k + c];
    return sum;
}

/* For three cameras: no worse for any Gaussian than their mean colour, far better for all, and near to the mean
 * colour without its slope. */
static void compare_views(const char *folder, struct spin_npz *npz, const double *cameras)
{
    struct spin_array info, of_times;
    struct spin_splats s = {0};
    struct run run;
    double *want = check_load(npz, "rgb_decoded", &info), error = 0, spread = 0, off = 0;
    double *times = check_load(npz, "times", &of_times);
    char places[300];
    const char *pairs[] = {"camera", places, "colour", "views", NULL};
    size_t n = info.shape[2], n_worse = 0;

    snprintf(places, sizeof places, "%.9g,%.9g,%.9g;%.9g,%.9g,%.9g;%.9g,%.9g,%.9g", cameras[0],
             cameras[1], cameras[2], cameras[3], cameras[4], cameras[5], cameras[6], cameras[7],
             cameras[8]);
    if (model_open("spacetimegs", path_in(folder, "model"), pairs, &run) != SPIN_OK)
        exit(1);
    ok(strstr(run.sequence.notes, "from 3 cameras") != NULL, "the notes tell what colours are");
    for (size_t t = 0; t < of_times.count; t++) {
        if (run.importer->frame(run.self, 0, times[t], run.sequence.columns, &s) != SPIN_OK)
            exit(1);
        for (size_t k = 0; k < 3 * n; k++) {
            size_t i = k / 3, c = k % 3;
            const double *w = want + 3 * n * 3 * t;
            double mean = (w[k] + w[3 * n + k] + w[6 * n + k]) / 3, e = 0, v = 0, none[3] = {0};

            for (size_t camera = 0; camera < 3; camera++) {
                double d[3], norm = 0;

                for (int x = 0; x < 3; x++) {
                    d[x] = s.means[3 * i + (size_t)x] - cameras[3 * camera + (size_t)x];
                    norm += d[x] * d[x];
                }
                for (int x = 0; x < 3; x++)
                    d[x] /= sqrt(norm);
                e += pow(seen(&s, i, d, c) - w[3 * n * camera + k], 2);
                v += pow(mean - w[3 * n * camera + k], 2);
            }
            n_worse += e > v + 1e-6;
            error += e;
            spread += v;
            off += 3 * pow(seen(&s, i, none, c) - mean, 2);
        }
    }
    ok(n_worse == 0 && error < 0.25 * spread && off < 0.05 * spread,
       "%s: SH holds most of what differs between cameras", spin_path_name(folder));
    printf("#   %zu worse; of the variance are left %.3f, off the mean by %.4f\n", n_worse,
           error / spread, off / spread);
    free(times);
    free(want);
    spin_splats_free(&s);
    run_close(&run);
}

static void test_decoder(const char *folder)
{
    struct spin_array info;
    struct spin_npz npz;
    double *cameras;

    bounds_of = folder;
    if (spin_npz_open(path_in(folder, "expected.npz"), &npz) != SPIN_OK)
        exit(1);
    cameras = check_load(&npz, "cameras", &info);
    for (size_t c = 0; cameras && c < 3; c++)
        compare_camera(folder, &npz, cameras + 3 * c, c);
    if (cameras)
        compare_views(folder, &npz, cameras);
    free(cameras);
    spin_npz_close(&npz);
}

static void is_recognised(const char *path, const char *what)
{
    const struct spin_importer *found = NULL;

    ok(spin_importer_find(path, NULL, false, &found) == SPIN_OK &&
           !strcmp(found->name, "spacetimegs"),
       "%s is recognised", what);
}

static void test_fixture(const char *folder, const char *name)
{
    const char *model = path_in(folder, "model"), *save = save_of(folder);
    const char *base[] = {"colour", "base", NULL};

    compare_model(model, base, folder, name);
    compare_model(path_in(save, "point_cloud.ply"), base, folder, "the cloud alone");
    is_recognised(model, name);
    is_recognised(save, "the folder of its save");
    is_recognised(path_in(save, "point_cloud.ply"), "its cloud");
    if (!has(save, "point_cloud.pt"))
        return;
    is_recognised(path_in(save, "point_cloud.pt"), "its network");
    test_decoder(folder);
}

/* ---- Models made here ------------------------------------------------------------------------ */

static const char save_path[] = "point_cloud/iteration_12000";

/* A copy of a fixture with another cloud and network (NULL: the same). */
static const char *make_model(const char *folder, const struct cloud *cloud, const struct pth *pth)
{
    const char *model = new_folder(), *from = save_of(folder), *to = path_in(model, save_path);

    if (spin_folder_make(to) != SPIN_OK)
        exit(1);
    if (cloud)
        cloud_save(cloud, path_in(to, "point_cloud.ply"));
    else
        copy_file(path_in(from, "point_cloud.ply"), path_in(to, "point_cloud.ply"));
    if (pth)
        pth_save(pth, path_in(to, "point_cloud.pt"));
    else if (has(from, "point_cloud.pt"))
        copy_file(path_in(from, "point_cloud.pt"), path_in(to, "point_cloud.pt"));
    copy_file(path_in(folder, "model/cfg_args"), path_in(model, "cfg_args"));
    return model;
}

static void test_truncations(const char *folder)
{
    const char *model = make_model(folder, NULL, NULL), *save = path_in(model, save_path);

    cut_everywhere("spacetimegs", model, anywhere, save, "point_cloud.ply");
    if (has(save, "point_cloud.pt"))
        cut_everywhere("spacetimegs", model, anywhere, save, "point_cloud.pt");
    cut_everywhere("spacetimegs", model, anywhere, model, "cfg_args");
}

static const char *make_with(const char *folder, const char *word, const char *by)
{
    const char *model = make_model(folder, NULL, NULL);

    replace_text(path_in(model, "cfg_args"), word, by);
    return model;
}

static void load_cloud(const char *folder, struct cloud *c)
{
    cloud_load(path_in(save_of(folder), "point_cloud.ply"), c);
}

static bool read_at(const char *path, const char *const *pairs, double time,
                    struct spin_splats *out, struct spin_sequence_info *info)
{
    struct run run;
    bool good = model_open("spacetimegs", path, pairs, &run) == SPIN_OK;

    if (info)
        *info = run.sequence;
    good = good && run.importer->frame(run.self, 0, time, run.sequence.columns, out) == SPIN_OK;
    if (!good)
        printf("#   %s\n", spin_last_error());
    run_close(&run);
    return good;
}

static void to_lite(struct cloud *c)
{
    static const char *const others[] = {"f_dc_3", "f_dc_4", "f_dc_5", "f_t_0", "f_t_1", "f_t_2"};

    for (size_t i = 0; i < sizeof others / sizeof *others; i++)
        cloud_drop(c, others[i]);
}

/* Colours of a lite model are the numbers of the file. */
static void test_lite(const char *folder)
{
    const char *model, *views[] = {"colour", "views", NULL};
    struct spin_sequence_info info;
    struct spin_splats s = {0};
    struct cloud c;
    double worst = 0;
    float *rgb;

    load_cloud(folder, &c);
    to_lite(&c);
    cloud_find(&c, "f_dc_1")[3] = -0.75f;
    model = make_model(folder, &c, NULL);
    ok(read_at(model, NULL, 0.3, &s, &info) && strstr(info.variant, "lite"), "a lite model");
    rgb = colours_of(&s);
    for (size_t i = 0; i < s.n; i++)
        worst = fmax(worst, fabs((double)rgb[3 * i + 1] - cloud_find(&c, "f_dc_1")[i]));
    near(worst, 0, 1e-6, "its colours are RGB as stored, also below 0");
    model_fails("spacetimegs", model, views, "point_cloud.ply", "lite",
                "a lite model has no colours of views");
    free(rgb);
    spin_splats_free(&s);
    cloud_free(&c);
}

/* Rows whose values are at the edge of what can be evaluated. */
static void test_edges(const char *folder)
{
    const char *model;
    struct spin_sequence_info info;
    struct spin_splats s = {0};
    struct cloud c;
    size_t n;

    load_cloud(folder, &c);
    n = c.n;
    for (int i = 0; i < 4; i++) {
        char name[16];

        snprintf(name, sizeof name, "rot_%d", i);
        cloud_find(&c, name)[0] = 0;
        snprintf(name, sizeof name, "omega_%d", i);
        cloud_find(&c, name)[0] = 0;
    }
    cloud_find(&c, "trbf_scale")[1] = -1000; /* seen at one time only */
    cloud_find(&c, "trbf_center")[1] = 0.5f;
    cloud_find(&c, "opacity")[1] = 0;
    cloud_find(&c, "trbf_scale")[2] = 1000; /* always seen */
    cloud_find(&c, "opacity")[2] = 0;
    model = make_model(folder, &c, NULL);
    ok(read_at(model, NULL, 0.5, &s, &info) && s.n == n, "rows at the edge are read");
    ok(s.quats[0] == 1 && s.quats[1] == 0 && s.quats[2] == 0 && s.quats[3] == 0,
       "a quaternion without length is no rotation");
    near(s.logit_opacities[1], 0, 1e-6, "the narrowest bell is 1 at its top");
    near(s.logit_opacities[2], 0, 1e-6, "the widest one is 1");
    read_at(model, NULL, 0.25, &s, NULL);
    ok(s.logit_opacities[1] < -13 && isfinite(s.logit_opacities[1]), "and 0 elsewhere");
    near(s.logit_opacities[2], 0, 1e-6, "everywhere");

    cloud_find(&c, "motion_7")[3] = NAN;
    cloud_find(&c, "scale_1")[4] = -INFINITY;
    cloud_find(&c, "scale_1")[5] = 100;
    cloud_find(&c, "motion_6")[6] = 1e30f;
    cloud_find(&c, "trbf_center")[7] = 1e30f;
    cloud_find(&c, "f_t_2")[8] = INFINITY;
    model = make_model(folder, &c, NULL);
    ok(read_at(model, NULL, 0.5, &s, &info) && s.n == n - 6 &&
           strstr(info.notes, "6 of 140 Gaussians dropped"),
       "rows that cannot be evaluated are dropped and counted");
    near(s.log_scales[0], cloud_find(&c, "scale_0")[0], 0, "the first one stays");
    near(s.log_scales[3 * 3], cloud_find(&c, "scale_0")[9], 0, "the others follow in their order");
    for (size_t i = 0; i < n; i++)
        cloud_find(&c, "x")[i] = NAN;
    model_fails("spacetimegs", make_model(folder, &c, NULL), NULL, "point_cloud.ply",
                "none of 140 Gaussians", "nothing but NaN");
    spin_splats_free(&s);
    cloud_free(&c);
}

/* Which save, how many frames, from which one on. */
static void test_settings(const char *folder)
{
    static const struct {
        const char *by, *in;
    } bad[] = {{"duration=0.5", "duration"},
               {"duration=-1", "duration"},
               {"duration='x'", "duration"},
               {"duration=1e9", "duration"},
               {"duration=[1, 2", "cut short"}};
    const char *third[] = {"duration", "75", NULL}, *none[] = {"duration", "0", NULL};
    const char *word[] = {"duration", "x", NULL}, *missing[] = {"iteration", "7", NULL};
    const char *model = make_with(folder, "colmap_0", "colmap_100");
    struct spin_sequence_info info;
    struct spin_splats s = {0};
    struct run run;

    ok(read_at(model, NULL, 0, &s, &info), "a run from frame 100 on");
    ok(strstr(info.notes, "20 frames, the first is frame 100 of the video") &&
           strstr(info.notes, "i/20"),
       "the notes say which frames it has");
    ok(info.continuous && info.time_first == 0 && info.time_last == 0.95 && !info.half_open,
       "times run to that of the last frame");
    ok(read_at(model, third, 0, &s, &info) && fabs(info.time_last - 74.0 / 75) < 1e-12,
       "--duration counts more than cfg_args");
    model_fails("spacetimegs", model, none, "--duration", "number of frames", "--duration 0");
    model_fails("spacetimegs", model, word, "--duration", "number of frames", "--duration x");
    model_fails("spacetimegs", model, missing, model, "iteration_7", "a save that is not there");
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++)
        model_fails("spacetimegs", make_with(folder, "duration=20", bad[i].by), NULL, "cfg_args",
                    bad[i].in, bad[i].by);
    model = make_with(folder, "loader='technicolor'", "loader='immersivess'");
    ok(read_at(model, NULL, 0, &s, &info) && strstr(info.notes, "fisheye"), "fisheye is noted");

    model = make_model(folder, NULL, NULL);
    unlink(path_in(model, "cfg_args"));
    ok(read_at(model, anywhere, 0, &s, &info) && info.time_last == 1 && info.half_open &&
           strstr(info.notes, "50 are usual"),
       "without cfg_args: to 1, and a note says how many frames are usual");
    if (model_open("spacetimegs", model, anywhere, &run) != SPIN_OK)
        exit(1);
    ok(run.importer->frame(run.self, 0, NAN, SPIN_COL_MEANS, &s) == SPIN_E_USAGE,
       "there is no time NaN");
    ok(run.importer->frame(run.self, 0, 1.5, SPIN_COL_MEANS, &s) == SPIN_OK,
       "times beyond are taken");
    ok(run.importer->frame(run.self, 0, 1e30, SPIN_COL_MEANS, &s) == SPIN_E_MALFORMED &&
           strstr(spin_last_error(), "not finite"),
       "but for those that nothing finite comes of");
    run_close(&run);
    spin_splats_free(&s);
}

/* What the full model's colours become, by what is there and what is asked for. */
static void test_colours(const char *folder)
{
    const char *base[] = {"colour", "base", NULL}, *views[] = {"colour", "views", NULL};
    const char *bad[] = {"colour", "green", NULL}, *no_end[] = {"rgb-function", "mlp", NULL};
    const char *far[] = {"camera", "1,2", NULL}, *model = make_model(folder, NULL, NULL);
    const char *pt = path_in(path_in(model, save_path), "point_cloud.pt");
    const char *cameras = path_in(model, "cameras.json"), *end[] = {"rgb-function", NULL, NULL};
    struct spin_sequence_info info;
    struct spin_splats s = {0}, t = {0};

    compare_model(model, base, folder, "--colour base");
    model_fails("spacetimegs", model, views, "point_cloud.ply", "cameras.json",
                "views without cameras");
    model_fails("spacetimegs", model, bad, "green", "expected", "colours of no kind");
    model_fails("spacetimegs", model, no_end, "mlp", "expected", "an ending of no kind");
    model_fails("spacetimegs", model, far, "--camera", "X,Y,Z", "--camera of two numbers");

    write_text(cameras, "[{\"position\": [0, 0, 0]}, {\"position\": [1, 0, 0]},"
                        " {\"position\": [0, 0, 0]}]");
    ok(read_at(model, views, 0.5, &s, &info) && s.sh_degree == 1 &&
           strstr(info.notes, "from 2 cameras"),
       "the different places in cameras.json");
    ok(read_at(path_in(model, save_path), views, 0.5, &t, &info), "found from the save as well");
    check_same_bits(s.sh, t.sh, 12 * s.n * sizeof *s.sh, "for the same colours");
    static const char *const wrong[] = {"{}",
                                        "[]",
                                        "[{\"position\": [1, 2]}]",
                                        "[{\"position\": [1, 2, \"3\"]}]",
                                        "[{\"place\": 1}]",
                                        "[{\"position\": [1, 2, 1e30]}]",
                                        "[1, 2",
                                        ""};
    for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++) {
        write_text(cameras, wrong[i]);
        model_fails("spacetimegs", model, NULL, "cameras.json", "", wrong[i]);
    }
    ok(read_at(model, anywhere, 0.5, &t, &info), "--camera does without it");
    unlink(cameras);

    unlink(pt);
    ok(read_at(model, NULL, 0.5, &s, &info) && s.sh_degree == 0 &&
           strstr(info.notes, "no point_cloud.pt"),
       "without its network a full model has base colours, and a note says so");
    model_fails("spacetimegs", model, views, "point_cloud.ply", "point_cloud.pt",
                "views without a network");

    /* 0.5 + C0 dc of one base colour by the three endings */
    for (int i = 0; i < 3; i++) {
        static const char *const names[] = {"sandwich", "sandwichnoact", "sandwichnoactss"};
        struct cloud c;
        double x, want;

        end[1] = names[i];
        load_cloud(folder, &c);
        x = cloud_find(&c, "f_dc_2")[0] = 1.75f;
        want = i == 0 ? sigmoid(x) : i == 1 ? 1 : x;
        model = make_model(folder, &c, NULL);
        read_at(model, end, 0.5, &s, NULL);
        near(0.5 + SPIN_SH_C0 * s.sh[2], want, 1e-6, names[i]);
        cloud_free(&c);
    }
    model = make_with(folder, "rgbfunction='sandwichnoact'", "rgbfunction='rgbv2'");
    model_fails("spacetimegs", model, NULL, "cfg_args", "--rgb-function", "an unknown ending");
    unlink(path_in(model, "cfg_args"));
    model_fails("spacetimegs", model, NULL, "point_cloud.ply", "--rgb-function", "none at all");
    spin_splats_free(&s);
    spin_splats_free(&t);
}

/* More places than there is room for are thinned out evenly. */
static void test_many_cameras(const char *folder)
{
    const char *model = make_model(folder, NULL, NULL);
    struct spin_sequence_info info;
    struct spin_splats s = {0};
    char *text = malloc(200 * 2000);
    int n = snprintf(text, 10, "[");

    for (int i = 0; i < 2000; i++)
        n += snprintf(text + n, 200, "%s{\"position\": [%d, 0.5, -1]}", i ? "," : "", i);
    snprintf(text + n, 10, "]");
    write_text(path_in(model, "cameras.json"), text);
    ok(read_at(model, NULL, 0.5, &s, &info) && strstr(info.notes, "from 64 cameras"),
       "of many cameras 64 are taken");
    spin_splats_free(&s);
    free(text);
}

/* ---- Files that lie -------------------------------------------------------------------------- */

static void no_centre(struct cloud *c) { cloud_drop(c, "trbf_center"); }
static void no_width(struct cloud *c) { cloud_drop(c, "trbf_scale"); }
static void no_y(struct cloud *c) { cloud_drop(c, "y"); }
static void no_opacity(struct cloud *c) { cloud_drop(c, "opacity"); }
static void short_path(struct cloud *c) { cloud_drop(c, "motion_8"); }
static void path_hole(struct cloud *c)
{
    cloud_drop(c, "motion_3");
    cloud_add(c, "motion_9");
}
static void long_path(struct cloud *c) { cloud_add(c, "motion_9"); }
static void short_turn(struct cloud *c) { cloud_drop(c, "omega_0"); }
static void two_scales(struct cloud *c) { cloud_drop(c, "scale_2"); }
static void no_rotation(struct cloud *c) { cloud_drop(c, "rot_1"); }
static void four_colours(struct cloud *c)
{
    cloud_drop(c, "f_dc_4");
    cloud_drop(c, "f_dc_5");
}
static void two_features(struct cloud *c) { cloud_drop(c, "f_t_1"); }
static void no_features(struct cloud *c)
{
    two_features(c);
    cloud_drop(c, "f_t_0");
    cloud_drop(c, "f_t_2");
}
static void with_sh(struct cloud *c) { cloud_add(c, "f_rest_0"); }
static void no_vertices(struct cloud *c) { c->n = 0; }

static const uint64_t wide[4] = {6, 13, 1, 1}, plain[2] = {6, 12};

static void nan_layer(struct pth *p) { pth_find(p, "mlp1.weight")->values[5] = NAN; }
static void wide_layer(struct pth *p) { pth_put(p, "mlp1.weight", 4, wide); }
static void plain_layer(struct pth *p) { pth_put(p, "mlp1.weight", 2, plain); }
static void one_layer(struct pth *p) { pth_drop(p, "mlp2.weight"); }
static void third_layer(struct pth *p) { pth_put(p, "mlp3.weight", 4, wide); }
static void two_dicts(struct pth *p) { p->pair = true; }

static void test_lies(const char *folder)
{
    static const struct {
        void (*change)(struct cloud *);
        const char *word, *what;
    } lies[] = {
        {no_centre, "trbf_center", "no centre in time"},
        {no_width, "trbf_scale", "no width in time"},
        {no_y, "'y'", "no y"},
        {no_opacity, "opacity", "no opacity"},
        {short_path, "8 properties motion_*", "eight numbers of a path"},
        {path_hole, "motion_3", "a path with a hole"},
        {long_path, "10 properties motion_*", "ten numbers of a path"},
        {short_turn, "3 properties omega_*", "three numbers of a turn"},
        {two_scales, "2 properties scale_*", "two scales"},
        {no_rotation, "3 properties rot_*", "three numbers of a rotation"},
        {four_colours, "4 properties f_dc_* and 3 f_t_*", "four colours"},
        {two_features, "6 properties f_dc_* and 2 f_t_*", "two features of time"},
        {no_features, "6 properties f_dc_* and 0 f_t_*", "no features of time"},
        {with_sh, "f_rest_*", "a fork with SH"},
        {no_vertices, "0 vertices", "a cloud of nothing"},
    };
    static const struct {
        void (*change)(struct pth *);
        const char *word, *what;
    } networks[] = {
        {nan_layer, "mlp1.weight", "NaN in the network"},
        {wide_layer, "mlp1.weight", "a network of 13 inputs"},
        {plain_layer, "mlp1.weight", "a network of plain layers"},
        {one_layer, "mlp2.weight", "a network of one layer"},
        {third_layer, "3 tensors", "a network of three layers"},
        {two_dicts, "not a state dict", "a pair instead of a state dict"},
    };
    struct spin_sequence_info info;
    struct spin_splats s = {0};
    struct cloud c;
    struct pth pth;

    for (size_t i = 0; i < sizeof lies / sizeof *lies; i++) {
        load_cloud(folder, &c);
        lies[i].change(&c);
        model_fails("spacetimegs", make_model(folder, &c, NULL), NULL, "point_cloud.ply",
                    lies[i].word, lies[i].what);
        cloud_free(&c);
    }
    for (size_t i = 0; i < sizeof networks / sizeof *networks; i++) {
        pth_load(path_in(save_of(folder), "point_cloud.pt"), &pth);
        networks[i].change(&pth);
        model_fails("spacetimegs", make_model(folder, NULL, &pth), anywhere, "point_cloud.pt",
                    networks[i].word, networks[i].what);
        pth_free(&pth);
    }
    load_cloud(folder, &c);
    cloud_add(&c, "spare");
    ok(read_at(make_model(folder, &c, NULL), NULL, 0.5, &s, &info) &&
           strstr(info.notes, "the first is 'spare'"),
       "a property that is not known is noted");
    cloud_free(&c);
    spin_splats_free(&s);
}

static void test_files(const char *folder)
{
    const char *model = make_model(folder, NULL, NULL), *save = path_in(model, save_path);
    const char *bad = check_fixture("torch_container/malformed"), *frames = new_folder();
    char **names = NULL;
    size_t n = 0;

    write_text(path_in(model, "cameras.json"), "[{\"position\": [0, 0, 0]}]");
    cut_everywhere("spacetimegs", model, NULL, model, "cameras.json");
    if (bad && spin_folder_list(bad, &names, &n) == SPIN_OK) {
        for (size_t i = 0; i < n; i++) {
            if (!strstr(names[i], ".pth"))
                continue;
            copy_file(path_in(bad, names[i]), path_in(save, "point_cloud.pt"));
            model_fails("spacetimegs", model, anywhere, "point_cloud.pt", "", names[i]);
        }
        spin_folder_list_free(names);
    } else {
        skip("malformed containers", "there are none here");
    }
    unlink(path_in(save, "point_cloud.ply"));
    model_fails("spacetimegs", model, NULL, model, "point_cloud.ply", "no cloud");
    model_fails("spacetimegs", path_in(save, "point_cloud.pt"), NULL, "point_cloud.ply", "no such",
                "a network without its cloud");
    model_fails("spacetimegs", path_in(folder, "manifest.json"), NULL, "manifest.json",
                "is neither the model's folder", "a file of another kind");
    copy_file(path_in(save_of(folder), "point_cloud.ply"), path_in(frames, "0001.ply"));
    model_fails("ply", frames, NULL, "0001.ply", "--from spacetimegs",
                "a cloud that moves is no frame, and ply says whose it is");
}

TAP_MAIN
{
    const char *root = check_fixture("spacetimegs"), *folder;
    char **names = NULL;
    size_t n = 0;

    spin_log_set_level(-2);
    if (!root || spin_folder_list(root, &names, &n) != SPIN_OK) {
        skip("spacetimegs fixtures", "there are none here");
        return;
    }
    for (size_t i = 0; i < n; i++) {
        test_fixture(path_in(root, names[i]), names[i]);
        PART(test_truncations, path_in(root, names[i]));
    }
    spin_folder_list_free(names);
    folder = path_in(root, "full_techni");
    PART(test_lite, folder);
    PART(test_edges, folder);
    PART(test_settings, folder);
    PART(test_colours, folder);
    PART(test_many_cameras, folder);
    PART(test_lies, folder);
    PART(test_files, folder);
}
