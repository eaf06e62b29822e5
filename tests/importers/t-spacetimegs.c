/* spacetimegs: the colours of the full model's network, options, clouds edited in many ways, and
 * malformed files.
 * K: spacetimegs import threads */
#include "tests/importers/edits.h"

#define FROM "spacetimegs"
#define SAVE "point_cloud/*"
#define CLOUD SAVE "/point_cloud.ply"
#define NETWORK SAVE "/point_cloud.pt"

static const char *const anywhere[] = {"rgb-function", "sandwichnoact", "camera", "0,0,0", NULL};

/* ---- Colours --------------------------------------------------------------------------------- */

/* For one camera the colours equal the network's exactly. */
static void compare_camera(const char *folder, struct spin_npz *npz, const double *camera, size_t c)
{
    static const struct golden_array decoded = {.key = "rgb_decoded", .kind = BASE};
    struct golden_now now = {.manifest = load_manifest(folder), .npz = npz};
    struct spin_array info;
    struct spin_splats s = {0};
    struct run run;
    double *times = check_load(npz, "times", &info);
    char place[100], what[100];
    const char *pairs[] = {"camera", place, NULL};

    snprintf(place, sizeof place, "%.9g,%.9g,%.9g", camera[0], camera[1], camera[2]);
    if (model_open(FROM, path_in(folder, "model"), pairs, &run) != SPIN_OK)
        exit(1);
    ok(run.sequence.sh_degree == 1 && run.sequence.static_columns == SPIN_COL_LOG_SCALES,
       "colours change with view and time");
    for (size_t t = 0; t < info.count; t++) {
        if (run.importer->frame(run.self, 0, times[t], run.sequence.columns, &s) != SPIN_OK)
            exit(1);
        snprintf(what, sizeof what, "%s, camera %zu, time %g", spin_path_name(folder), c, times[t]);
        now.name = what;
        now.s = &s;
        now.index = 3 * t + c;
        now.n_all = s.n;
        now.row = realloc(now.row, (s.n + 1) * sizeof *now.row);
        for (size_t i = 0; i < s.n; i++)
            now.row[i] = i;
        golden_compare(&now, &decoded);
    }
    free(now.row);
    spin_json_free((spin_json *)now.manifest);
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

/* For three cameras: for no Gaussian worse than their mean colour, far better over all, and
 * close to the mean colour if the slope is removed. */
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
    if (model_open(FROM, path_in(folder, "model"), pairs, &run) != SPIN_OK)
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

/* ---- Models made here ------------------------------------------------------------------------ */

static const char *make_with(const char *model, const char *word, const char *by)
{
    const char *copy = copy_of(model);

    replace_text(path_in(copy, "cfg_args"), word, by);
    return copy;
}

static bool read_at(const char *path, const char *const *pairs, double time,
                    struct spin_splats *out, struct spin_sequence_info *info)
{
    struct run run;
    bool good = model_open(FROM, path, pairs, &run) == SPIN_OK;

    if (info)
        *info = run.sequence;
    good = good && run.importer->frame(run.self, 0, time, run.sequence.columns, out) == SPIN_OK;
    if (!good)
        printf("#   %s\n", spin_last_error());
    run_close(&run);
    return good;
}

/* Colours of a lite model are stored in the file. */
static void test_lite(const char *model)
{
    const char *views[] = {"colour", "views", NULL}, *lite;
    struct spin_sequence_info info;
    struct spin_splats s = {0};
    struct cloud c;
    double worst = 0;

    lite = edited(model, CLOUD, "drop f_dc_ 3 5; drop f_t_ 0 2; set f_dc_1 3 -0.75");
    cloud_load(golden_path(lite, CLOUD), &c);
    ok(read_at(lite, NULL, 0.3, &s, &info) && strstr(info.variant, "lite"), "a lite model");
    for (size_t i = 0; i < s.n; i++)
        worst =
            larger(worst, fabs(0.5 + SPIN_SH_C0 * s.sh[3 * i + 1] - cloud_find(&c, "f_dc_1")[i]));
    near(worst, 0, 1e-6, "its colours are RGB as stored, also below 0");
    model_fails(FROM, lite, views, "point_cloud.ply", "lite",
                "a lite model has no colours of views");
    spin_splats_free(&s);
    cloud_free(&c);
}

/* Rows with values at the limits of evaluation. */
static void test_edges(const char *model)
{
    const char *copy = copy_of(model), *path = golden_path(copy, CLOUD);
    struct spin_sequence_info info;
    struct spin_splats s = {0};
    struct cloud c;
    float colours[12];
    size_t n;

    cloud_load(path, &c);
    n = c.n;
    /* no rotation; visible at one time only; always visible */
    edit_file(path,
              "set rot_0 0 0; set rot_1 0 0; set rot_2 0 0; set rot_3 0 0; set omega_0 0 0; "
              "set omega_1 0 0; set omega_2 0 0; set omega_3 0 0; set trbf_scale 1 -1000; "
              "set trbf_center 1 0.5; set opacity 1 0; set trbf_scale 2 1000; set opacity 2 0");
    ok(read_at(copy, NULL, 0.5, &s, &info) && s.n == n, "rows at the edge are read");
    ok(s.quats[0] == 1 && s.quats[1] == 0 && s.quats[2] == 0 && s.quats[3] == 0,
       "a quaternion without length is no rotation");
    near(s.logit_opacities[1], 0, 1e-6, "the narrowest bell is 1 at its top");
    near(s.logit_opacities[2], 0, 1e-6, "the widest one is 1");
    read_at(copy, NULL, 0.25, &s, NULL);
    ok(s.logit_opacities[1] < -13 && isfinite(s.logit_opacities[1]), "and 0 elsewhere");
    near(s.logit_opacities[2], 0, 1e-6, "everywhere");
    read_at(copy, anywhere, 0.5, &s, NULL);
    memcpy(colours, s.sh + 12 * 9, sizeof colours);

    edit_file(path,
              "set motion_7 3 nan; set scale_1 4 -inf; set scale_1 5 100; set motion_6 6 1e30; "
              "set trbf_center 7 1e30; set f_t_2 8 inf");
    ok(read_at(copy, NULL, 0.5, &s, &info) && s.n == n - 6 &&
           strstr(info.notes, "6 of 140 Gaussians dropped"),
       "rows that cannot be evaluated are dropped and counted");
    near(s.log_scales[0], cloud_find(&c, "scale_0")[0], 0, "the first one stays");
    near(s.log_scales[3 * 3], cloud_find(&c, "scale_0")[9], 0, "the others follow in their order");
    ok(read_at(copy, anywhere, 0.5, &s, NULL) &&
           memcmp(s.sh + 12 * 3, colours, sizeof colours) == 0,
       "with the network's colours of their own");
    model_fails(FROM, edited(model, CLOUD, "set x * nan"), NULL, "point_cloud.ply",
                "none of 140 Gaussians", "nothing but NaN");
    spin_splats_free(&s);
    cloud_free(&c);
}

/* The chosen save, the number of frames, and the first of them. */
static void test_settings(const char *model)
{
    const char *third[] = {"duration", "75", NULL}, *none[] = {"duration", "0", NULL};
    const char *word[] = {"duration", "x", NULL}, *missing[] = {"iteration", "7", NULL};
    const char *copy = make_with(model, "colmap_0", "colmap_100");
    struct spin_sequence_info info;
    struct spin_splats s = {0};
    struct run run;

    ok(read_at(copy, NULL, 0, &s, &info), "a run from frame 100 on");
    ok(strstr(info.notes, "20 frames, the first is frame 100 of the video") &&
           strstr(info.notes, "i/20"),
       "the notes say which frames it has");
    ok(read_at(make_with(model, "colmap_0", "take_100"), NULL, 0, &s, &info) &&
           !strstr(info.notes, "the first is"),
       "the number of another folder is not that of a frame");
    ok(read_at(copy, NULL, 0, &s, &info) && info.continuous && info.time_first == 0 &&
           info.time_last == 0.95 && !info.half_open,
       "times run to that of the last frame");
    ok(read_at(copy, third, 0, &s, &info) && fabs(info.time_last - 74.0 / 75) < 1e-12,
       "--duration counts more than cfg_args");
    model_fails(FROM, copy, none, "--duration", "number of frames", "--duration 0");
    model_fails(FROM, copy, word, "--duration", "number of frames", "--duration x");
    model_fails(FROM, copy, missing, copy, "iteration_7", "a save that is not there");
    copy = make_with(model, "loader='technicolor'", "loader='immersivess'");
    ok(read_at(copy, NULL, 0, &s, &info) && strstr(info.notes, "fisheye"), "fisheye is noted");

    copy = copy_of(model);
    unlink(path_in(copy, "cfg_args"));
    ok(read_at(copy, anywhere, 0, &s, &info) && info.time_last == 1 && info.half_open &&
           strstr(info.notes, "usually 50"),
       "without cfg_args: to 1, and a note says how many frames are usual");
    if (model_open(FROM, copy, anywhere, &run) != SPIN_OK)
        exit(1);
    ok(run.importer->frame(run.self, 0, NAN, SPIN_COL_MEANS, &s) == SPIN_E_USAGE,
       "there is no time NaN");
    ok(run.importer->frame(run.self, 0, 1.5, SPIN_COL_MEANS, &s) == SPIN_OK,
       "times beyond are taken");
    ok(run.importer->frame(run.self, 0, 1e30, SPIN_COL_MEANS, &s) == SPIN_E_MALFORMED &&
           strstr(spin_last_error(), "positions are not finite"),
       "but for those that nothing finite comes of");
    run_close(&run);
    spin_splats_free(&s);
}

/* The colours of the full model, by the available files and the options. */
static void test_colours(const char *model)
{
    const char *views[] = {"colour", "views", NULL};
    const char *bad[] = {"colour", "green", NULL}, *no_end[] = {"rgb-function", "mlp", NULL};
    const char *far[] = {"camera", "1,2", NULL}, *copy = copy_of(model);
    const char *pt = golden_path(copy, NETWORK);
    const char *cameras = path_in(copy, "cameras.json"), *end[] = {"rgb-function", NULL, NULL};
    struct spin_sequence_info info;
    struct spin_splats s = {0}, t = {0};

    model_fails(FROM, copy, views, "point_cloud.ply", "cameras.json", "views without cameras");
    model_fails(FROM, copy, bad, "green", "expected", "colours of no kind");
    model_fails(FROM, copy, no_end, "mlp", "expected", "an ending of no kind");
    model_fails(FROM, copy, far, "--camera", "X,Y,Z", "--camera of two numbers");

    write_text(cameras, "[{\"position\": [0, 0, 0]}, {\"position\": [1, 0, 0]},"
                        " {\"position\": [0, 0, 0]}]");
    ok(read_at(copy, views, 0.5, &s, &info) && s.sh_degree == 1 &&
           strstr(info.notes, "from 2 cameras"),
       "the different places in cameras.json");
    ok(read_at(golden_path(copy, SAVE), views, 0.5, &t, &info), "found from the save as well");
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
        model_fails(FROM, copy, NULL, "cameras.json", "", wrong[i]);
    }
    ok(read_at(copy, anywhere, 0.5, &t, &info), "--camera does without it");
    unlink(cameras);

    unlink(pt);
    ok(read_at(copy, NULL, 0.5, &s, &info) && s.sh_degree == 0 &&
           strstr(info.notes, "no point_cloud.pt"),
       "without its network a full model has base colours, and a note says so");
    model_fails(FROM, copy, views, "point_cloud.ply", "point_cloud.pt", "views without a network");

    /* 0.5 + C0 dc of one base colour by the three endings */
    for (int i = 0; i < 3; i++) {
        static const char *const names[] = {"sandwich", "sandwichnoact", "sandwichnoactss"};
        double x = 1.75, want = i == 0 ? 1 / (1 + exp(-x)) : i == 1 ? 1 : x;

        end[1] = names[i];
        copy = edited(model, CLOUD, "set f_dc_2 0 1.75");
        read_at(copy, end, 0.5, &s, NULL);
        near(0.5 + SPIN_SH_C0 * s.sh[2], want, 1e-6, names[i]);
    }
    copy = make_with(model, "rgbfunction='sandwichnoact'", "rgbfunction='rgbv2'");
    model_fails(FROM, copy, NULL, "cfg_args", "--rgb-function", "an unknown ending");
    unlink(path_in(copy, "cfg_args"));
    model_fails(FROM, copy, NULL, "point_cloud.ply", "--rgb-function", "none at all");
    spin_splats_free(&s);
    spin_splats_free(&t);
}

/* More positions than the capacity are thinned out evenly. */
static void test_many_cameras(const char *model)
{
    const char *copy = copy_of(model);
    struct spin_sequence_info info;
    struct spin_splats s = {0};
    char *text = malloc(200 * 2000);
    int n = snprintf(text, 10, "[");

    for (int i = 0; i < 2000; i++)
        n += snprintf(text + n, 200, "%s{\"position\": [%d, 0.5, -1]}", i ? "," : "", i);
    snprintf(text + n, 10, "]");
    write_text(path_in(copy, "cameras.json"), text);
    ok(read_at(copy, NULL, 0.5, &s, &info) && strstr(info.notes, "from 64 cameras"),
       "of many cameras 64 are taken");
    spin_splats_free(&s);
    free(text);
}

/* ---- Malformed files --------------------------------------------------------------------------
 */

static void test_lies(const char *model)
{
    static const struct lie lies[] = {
        {CLOUD, "drop trbf_center", "trbf_center", "no centre in time"},
        {CLOUD, "drop trbf_scale", "trbf_scale", "no width in time"},
        {CLOUD, "drop y", "'y'", "no y"},
        {CLOUD, "drop opacity", "opacity", "no opacity"},
        {CLOUD, "drop motion_8", "8 properties motion_*", "eight numbers of a path"},
        {CLOUD, "drop motion_3; put motion_9", "motion_3", "a path with a hole"},
        {CLOUD, "put motion_9", "10 properties motion_*", "ten numbers of a path"},
        {CLOUD, "drop omega_0", "3 properties omega_*", "three numbers of a turn"},
        {CLOUD, "drop scale_2", "2 properties scale_*", "two scales"},
        {CLOUD, "drop rot_1", "3 properties rot_*", "three numbers of a rotation"},
        {CLOUD, "drop f_dc_ 4 5", "4 properties f_dc_* and 3 f_t_*", "four colours"},
        {CLOUD, "drop f_t_1", "6 properties f_dc_* and 2 f_t_*", "two features of time"},
        {CLOUD, "drop f_t_ 0 2", "6 properties f_dc_* and 0 f_t_*", "no features of time"},
        {CLOUD, "put f_rest_0", "f_rest_*", "a fork with SH"},
        {CLOUD, "rows 0", "0 vertices", "a cloud of nothing"},
        {"cfg_args", "text duration=20=>duration=0.5", "duration", "half a frame"},
        {"cfg_args", "text duration=20=>duration=-1", "duration", "-1 frames"},
        {"cfg_args", "text duration=20=>duration='x'", "duration", "frames in words"},
        {"cfg_args", "text duration=20=>duration=1e9", "duration", "more frames than can be"},
        {"cfg_args", "text duration=20=>duration=[1, 2", "cut short",
         "a bracket that is not closed"},
    };
    static const struct lie networks[] = {
        {NETWORK, "set mlp1.weight 5 nan", "mlp1.weight", "NaN in the network"},
        {NETWORK, "put mlp1.weight 6 13 1 1", "mlp1.weight", "a network of 13 inputs"},
        {NETWORK, "put mlp1.weight 6 12", "mlp1.weight", "a network of plain layers"},
        {NETWORK, "drop mlp2.weight", "mlp2.weight", "a network of one layer"},
        {NETWORK, "put mlp3.weight 6 13 1 1", "3 tensors", "a network of three layers"},
        {NETWORK, "pair", "not contain a state dict", "a pair instead of a state dict"},
    };
    struct spin_sequence_info info;
    struct spin_splats s = {0};

    refuse_lies(FROM, model, NULL, lies, sizeof lies / sizeof *lies);
    refuse_lies(FROM, model, anywhere, networks, sizeof networks / sizeof *networks);
    ok(read_at(edited(model, CLOUD, "put spare"), NULL, 0.5, &s, &info) &&
           strstr(info.notes, "the first is 'spare'"),
       "a property that is not known is noted");
    spin_splats_free(&s);
}

static void test_files(const char *model)
{
    const char *copy = copy_of(model), *frames = new_folder();

    write_text(path_in(copy, "cameras.json"), "[{\"position\": [0, 0, 0]}]");
    refuse_cuts(FROM, copy, NULL, "cameras.json");
    copy_file(golden_path(copy, CLOUD), path_in(frames, "0001.ply"));
    unlink(golden_path(copy, CLOUD));
    model_fails(FROM, copy, NULL, copy, "point_cloud.ply", "no cloud");
    model_fails(FROM, golden_path(copy, NETWORK), NULL, "point_cloud.ply", "no such",
                "a network without its cloud");
    model_fails(FROM, path_in(model, "../manifest.json"), NULL, "manifest.json",
                "is neither the model's folder", "a file of another kind");
    model_fails("ply", frames, NULL, "0001.ply", "--from spacetimegs",
                "a cloud that moves is no frame, and ply says whose it is");
}

TAP_MAIN
{
    const char *root = check_fixture(FROM), **names = check_cases(FROM, "expected.npz"), *model;

    spin_log_set_level(-2);
    if (!root) {
        skip("spacetimegs fixtures", "there are none here");
        return;
    }
    for (size_t i = 0; names[i]; i++) {
        model = path_in(path_in(root, names[i]), "model");
        if (golden_path(model, NETWORK)) {
            PART(test_decoder, path_in(root, names[i]));
            PART(refuse_cuts, FROM, model, anywhere, NETWORK);
        }
        PART(refuse_cuts, FROM, model, anywhere, CLOUD);
        PART(refuse_cuts, FROM, model, anywhere, "cfg_args");
    }
    free(names);
    model = path_in(root, "full_techni/model");
    PART(test_lite, model);
    PART(test_edges, model);
    PART(test_settings, model);
    PART(test_colours, model);
    PART(test_many_cameras, model);
    PART(test_lies, model);
    PART(refuse_containers, FROM, model, anywhere, NETWORK);
    PART(test_files, model);
}
