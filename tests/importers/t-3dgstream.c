/* 3dgstream: moved clouds and evaluated networks against the official classes, both layouts, and
 * malformed folders.
 * K: 3dgstream import */
#include "importers/lib/ntc_eval.h"
#include "tests/importers/expected_clouds.h"
#include "tests/importers/sets.h"

/* ---- Fixtures -------------------------------------------------------------------------------- */

/* Frames in this order, each against expected.npz. */
static void compare_frames(struct run *run, struct spin_npz *npz, const spin_json *manifest,
                           bool networks, const char *name)
{
    const spin_json *tolerance = spin_json_get(spin_json_get(manifest, "tolerance"), "ply_route");
    struct spin_splats s = {0};
    double abs = 2e-6, rel = 2e-5;

    spin_json_number(spin_json_get(tolerance, "abs"), &abs);
    spin_json_number(spin_json_get(tolerance, "rel"), &rel);
    for (int k = 0; k < run->sequence.n_frames; k++) {
        int f = k % 2 ? k - 1 : k + 1 < run->sequence.n_frames ? k + 1 : k; /* 1 0 3 2 ... */
        struct spin_array info;
        char key[64];
        size_t n;

        if (!ok(run->importer->frame(run->self, f, f, run->sequence.columns, &s) == SPIN_OK,
                "%s: frame %d is read", name, f)) {
            printf("#   %s\n", spin_last_error());
            continue;
        }
        snprintf(key, sizeof key, "%04d_base_means", f);
        free(check_load(npz, key, &info));
        n = (size_t)info.shape[0];
        snprintf(key, sizeof key, "%04d_base_", f);
        if (s.n >= n)
            compare_cloud(npz, key, &s, 0, n, networks ? 3e-3 * f + abs : abs, networks ? 0 : rel,
                          0, !networks, name);
        snprintf(key, sizeof key, "%04d_added_means", f);
        if (!ok(s.n == run->sequence.counts[f] && (s.n > n) == spin_npz_has(npz, key),
                "%s: frame %d has its %zu Gaussians", name, f, s.n) ||
            s.n <= n)
            continue;
        snprintf(key, sizeof key, "%04d_added_", f);
        compare_cloud(npz, key, &s, n, s.n - n, abs, rel, 0, true, name);
    }
    spin_splats_free(&s);
}

static void test_route(const char *folder, const char *const *pairs, bool networks,
                       const spin_json *manifest, struct spin_npz *npz, const char *name)
{
    struct run run;
    double frames = -1;

    if (!ok(model_open("3dgstream", folder, pairs, &run) == SPIN_OK, "%s: opens", name)) {
        printf("#   %s\n", spin_last_error());
        return;
    }
    spin_json_number(spin_json_get(manifest, "frames"), &frames);
    near(run.sequence.n_frames, frames, 0, "has as many frames as the manifest says");
    ok(run.sequence.sh_degree == 1 && run.sequence.numbers[0] == 0 && run.sequence.numbers[1] == 1,
       "%s: SH degree 1, numbered from 0", name);
    ok(!strstr(run.sequence.variant, "evaluated") == !networks, "%s: %s", name,
       run.sequence.variant);
    compare_frames(&run, npz, manifest, networks, name);
    run_close(&run);
}

/* The encoding and the outputs at given points. Half has 11 bits. */
static void test_outputs(const char *folder, const char *config)
{
    const char *path = path_in(folder, "expected_ntc_last.npz");
    struct spin_array info;
    struct ntc_shape shape;
    struct spin_npz npz;
    struct ntc network;
    double *encoding, *output;
    float *points, *got_e, *got_o;
    size_t n, width;
    char last[64] = "";

    for (int f = 1; f < 100; f++) {
        char name[64];

        snprintf(name, sizeof name, "frame%06d/NTC.pth", f);
        if (spin_path_exists(path_in(folder, name)))
            memcpy(last, name, sizeof name);
    }
    if (!spin_path_exists(path) || !last[0])
        return;
    if (!ok(spin_ntc_open_config(config, &shape) == SPIN_OK &&
                spin_ntc_open(path_in(folder, last), &shape, &network) == SPIN_OK &&
                spin_npz_open(path, &npz) == SPIN_OK,
            "the last network is read")) {
        printf("#   %s\n", spin_last_error());
        return;
    }
    points = check_load_f32(&npz, "unit_points", &info);
    n = (size_t)info.shape[0];
    encoding = check_load(&npz, "encoding", &info);
    width = (size_t)info.shape[1];
    output = check_load(&npz, "output", &info);
    got_e = malloc(n * NTC_MAX_WIDTH * sizeof *got_e);
    got_o = malloc(n * NTC_OUT * sizeof *got_o);
    for (size_t i = 0; i < n; i++) {
        static float e[NTC_MAX_WIDTH * MLP_BLOCK], a[NTC_MAX_WIDTH * MLP_BLOCK];
        static float b[NTC_MAX_WIDTH * MLP_BLOCK];
        const float *o;

        spin_ntc_encode(&network, points + 3 * i, e);
        o = spin_mlp_run(&network.net, e, a, b);
        for (size_t k = 0; k < width; k++)
            got_e[width * i + k] = e[k * MLP_BLOCK];
        for (size_t k = 0; k < NTC_OUT; k++)
            got_o[NTC_OUT * i + k] = o[k * MLP_BLOCK];
    }
    check_rel_to_absmax(got_e, encoding, n * width, 2e-3, "the grid's features");
    check_rel_to_absmax(got_o, output, n * NTC_OUT, 4e-3, "the network's outputs");
    free(points);
    free(encoding);
    free(output);
    free(got_e);
    free(got_o);
    spin_ntc_free(&network);
    spin_npz_close(&npz);
}

/* "cases": altered folders or files of the held-out set. */
static void test_cases(const char *folder, const spin_json *manifest)
{
    const spin_json *cases = spin_json_get(manifest, "cases");

    for (size_t i = 0; i < spin_json_length(cases); i++) {
        const spin_json *c = spin_json_at(cases, i);
        const char *file = spin_json_string(spin_json_get(c, "file"));
        const char *expect = spin_json_string(spin_json_get(c, "expect"));

        if (!file || !expect || !spin_path_is_folder(path_in(folder, file)))
            continue;
        if (strcmp(expect, "error") == 0) {
            fails("3dgstream", path_in(folder, file), NULL, file);
            continue;
        }
        spin_fail(SPIN_E_USAGE, "an older message");
        ok(read_all("3dgstream", path_in(folder, file)) == SPIN_OK ||
               !strstr(spin_last_error(), "an older message"),
           "%s is read, or refused with a word", file);
    }
}

static void test_fixture(const char *folder)
{
    static const char *const networks[] = {"way", "networks", NULL};
    spin_json *manifest = load_manifest(folder);
    const char *fvv = path_in(folder, "fvv");
    struct spin_npz npz;
    struct run run;

    if (!manifest || !spin_path_exists(path_in(folder, "expected.npz"))) {
        skip("3dgstream fixtures", "there are none here");
        spin_json_free(manifest);
        return;
    }
    if (ok(spin_npz_open(path_in(folder, "expected.npz"), &npz) == SPIN_OK, "has expected.npz")) {
        ok(run_open(NULL, folder, &run) == SPIN_OK && !strcmp(run.importer->name, "3dgstream"),
           "the output folder is recognised");
        run_close(&run);
        ok(run_open(NULL, fvv, &run) == SPIN_OK && !strcmp(run.importer->name, "3dgstream"),
           "so is what is packed for the viewer");
        run_close(&run);
        test_route(folder, NULL, false, manifest, &npz, "moved clouds");
        test_route(folder, networks, true, manifest, &npz, "networks");
        test_route(fvv, NULL, true, manifest, &npz, "packed");
        spin_npz_close(&npz);
    }
    test_outputs(folder, path_in(fvv, "NTCs/config.json"));
    test_cases(folder, manifest);
    spin_json_free(manifest);
}

/* ---- Folders made here ----------------------------------------------------------------------- */

static const char *link_clip(const char *root, int n_frames)
{
    const char *folder = new_folder();
    char name[64];

    make_link(path_in(root, "init_3dgs"), folder, "init_3dgs");
    for (int f = 1; f <= n_frames; f++) {
        snprintf(name, sizeof name, "frame%06d", f);
        make_link(path_in(root, name), folder, name);
    }
    return folder;
}

static const char *link_packed(const char *root, bool config)
{
    const char *folder = new_folder(), *fvv = path_in(root, "fvv");

    make_folder(folder, "NTCs");
    make_link(path_in(fvv, "init_3dgs.ply"), folder, "init_3dgs.ply");
    make_link(path_in(fvv, "NTCs/NTC_000000.pth"), folder, "NTCs/NTC_000000.pth");
    if (config)
        make_link(path_in(fvv, "NTCs/config.json"), folder, "NTCs/config.json");
    return folder;
}

static void test_folders(const char *root)
{
    const char *folder = link_clip(root, 2), *cloud;
    const char *init[] = {"init", path_in(root, "init_3dgs"), NULL};
    const char *way[] = {"way", "x", NULL};
    struct run run;

    remove(path_in(folder, "init_3dgs"));
    ok(run_open("3dgstream", folder, &run) == SPIN_OK && run.sequence.n_frames == 2 &&
           run.sequence.numbers[0] == 1 && strstr(run.sequence.notes, "--init"),
       "without the first cloud the clip begins with frame 1, and a note says so");
    run_close(&run);
    ok(model_open("3dgstream", folder, init, &run) == SPIN_OK && run.sequence.n_frames == 3 &&
           run.sequence.numbers[0] == 0,
       "give the cloud with --init");
    run_close(&run);
    init[1] = path_in(root, "manifest");
    ok(model_open("3dgstream", folder, init, &run) != SPIN_OK &&
           strstr(spin_last_error(), "'init'"),
       "and what is not there is refused");
    ok(model_open("3dgstream", folder, way, &run) != SPIN_OK && strstr(spin_last_error(), "'way'"),
       "so is an unknown way");
    way[1] = "networks";
    ok(model_open("3dgstream", folder, way, &run) != SPIN_OK &&
           strstr(spin_last_error(), "frame 0"),
       "networks need the first cloud");
    folder = link_clip(root, 0);
    remove(path_in(folder, "init_3dgs"));
    make_folder(folder, "frame000001/point_cloud/iteration_9");
    make_link(path_in(root, "frame000002"), folder, "frame000002");
    fails("3dgstream", folder, "frame 1 has no moved cloud", "a first frame with nothing in it");
    folder = link_clip(root, 3);
    remove(path_in(folder, "frame000002"));
    fails("3dgstream", folder, "not 2 between", "a gap in the frames");
    folder = link_clip(root, 1);
    make_folder(folder, "frame000002/point_cloud/iteration_9");
    fails("3dgstream", folder, "frame 2 has no moved cloud", "a frame with nothing in it");
    cloud = "frame000002/point_cloud/iteration_9/point_cloud.ply";
    make_link(path_in(root, "frame000001/point_cloud/iteration_250/added/point_cloud.ply"), folder,
              cloud);
    fails("3dgstream", folder, "has 11 Gaussians, but", "a moved cloud of another size");
    remove(path_in(folder, cloud));
    make_text(folder, cloud,
              "ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\nend_header\n");
    fails("3dgstream", folder, "no property 'y'", "a moved cloud without y");
    fails("3dgstream", new_folder(), "neither frame folders nor 'NTCs'", "an empty folder");
}

static void test_settings(const char *root)
{
    const char *folder = link_clip(root, 1);
    struct spin_splats s = {0};
    struct run run, whole;
    char *other = NULL;

    /* Intermediate saves: the settings say which one is the frame. */
    make_folder(folder, "frame000002/point_cloud/iteration_150");
    make_folder(folder, "frame000002/point_cloud/iteration_200");
    make_link(path_in(root, "frame000002/point_cloud/iteration_150/point_cloud.ply"), folder,
              "frame000002/point_cloud/iteration_150/point_cloud.ply");
    make_link(path_in(root, "frame000003/point_cloud/iteration_150/point_cloud.ply"), folder,
              "frame000002/point_cloud/iteration_200/point_cloud.ply");
    for (int i = 0; i < 2; i++) {
        float x[2] = {0};

        if (i == 1)
            make_text(folder, "cfg_args.json", "{\"iterations\": 150, \"iterations_s2\": 100}");
        for (int k = 0; k < 2; k++) {
            bool good =
                run_open("3dgstream", k ? root : folder, &run) == SPIN_OK &&
                run.importer->frame(run.self, k ? 3 - i : 2, 0, SPIN_COL_MEANS, &s) == SPIN_OK;

            x[k] = good ? s.means[0] : NAN;
            run_close(&run);
        }
        ok(x[0] == x[1], "%s",
           i ? "cfg_args.json says which save is the frame"
             : "without it the largest iteration is");
    }
    for (int i = 0; i < 2; i++) {
        const char *to = i ? "frame000002/point_cloud/iteration_300/added"
                           : "frame000002/point_cloud/iteration_250/added";

        make_folder(folder, to);
        make_link(path_in(root, i ? "frame000001/point_cloud/iteration_150/point_cloud.ply"
                                  : "frame000002/point_cloud/iteration_250/added/point_cloud.ply"),
                  folder, path_in(to, "point_cloud.ply"));
    }
    ok(run_open("3dgstream", folder, &run) == SPIN_OK &&
           run_open("3dgstream", root, &whole) == SPIN_OK &&
           run.sequence.counts[2] == whole.sequence.counts[2],
       "and, both numbers together, which one of what is added");
    run_close(&run);
    run_close(&whole);
    spin_splats_free(&s);
    free(other);
}

#define GRID                                                                                       \
    "{\"network\":{\"otype\":\"FullyFusedMLP\",\"activation\":\"ReLU\",\"n_neurons\":64,"          \
    "\"n_hidden_layers\":2},\"encoding\":{\"otype\":\"HashGrid\","
#define SIZES                                                                                      \
    "\"n_levels\":32,\"n_features_per_level\":4,\"log2_hashmap_size\":9,\"base_resolution\":8"

static void test_networks(const char *root)
{
    static const char *const bad[][3] = {
        {"{}", "no object 'network'", "a configuration without a network"},
        {"{\"network\":{\"otype\":\"CutlassMLP\",\"activation\":\"ReLU\",\"n_neurons\":64,"
         "\"n_hidden_layers\":2}}",
         "has 23552 numbers", "a network without a grid does not fit the file"},
        {"{\"network\":{\"otype\":\"Other\"}}", "'Other'", "another kind of network"},
        {"{\"network\":{\"otype\":\"FullyFusedMLP\",\"activation\":\"Sine\"}}", "'Sine'",
         "another activation"},
        {"{\"network\":{\"otype\":\"FullyFusedMLP\",\"activation\":\"ReLU\",\"n_neurons\":1e9}}",
         "'n_neurons'", "an absurd width"},
        {"{\"network\":{\"otype\":\"FullyFusedMLP\",\"activation\":\"ReLU\",\"n_neurons\":64,"
         "\"n_hidden_layers\":2},\"encoding\":{\"otype\":\"Frequency\"}}",
         "'Frequency'", "another encoding"},
        {GRID "\"type\":\"Tiled\"}}", "'Tiled'", "a grid that is tiled"},
        {GRID "\"hash\":\"Rng\"}}", "'Rng'", "another hash"},
        {GRID SIZES "}}", "the hash grid is too large", "a grid with more levels than numbers"},
        {GRID SIZES ",\"per_level_scale\":0.9}}", "'per_level_scale' is 0.9", "levels that shrink"},
        {GRID SIZES ",\"per_level_scale\":65}}", "'per_level_scale' is 65", "levels that explode"},
    };
    const char *folder = link_packed(root, true), *network = path_in(folder, "NTCs/NTC_000000.pth");
    struct spin_map map;
    struct run run;

    ok(run_open(NULL, folder, &run) == SPIN_OK && run.sequence.n_frames == 2,
       "one network makes two frames");
    run_close(&run);
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        const char *config = path_in(folder, "NTCs/config.json");

        remove(config);
        make_text(folder, "NTCs/config.json", bad[i][0]);
        fails("3dgstream", folder, bad[i][1], bad[i][2]);
        ok(strstr(spin_last_error(), "config.json'") != NULL, "which names the configuration");
    }
    make_text(folder, "NTCs/config.json", "// the file's own\n{ # one\n");
    fails("3dgstream", folder, "config.json", "half a configuration");
    fails("3dgstream", link_packed(root, false), "--config",
          "no configuration, when the usual one does not fit");
    folder = link_packed(root, true);
    network = path_in(folder, "NTCs/NTC_000000.pth");
    if (spin_map_open(path_in(root, "fvv/NTCs/NTC_000000.pth"), &map) == SPIN_OK) {
        for (int i = 1; i < 40; i++) {
            remove(network);
            make_file(folder, "NTCs/NTC_000000.pth", map.data, map.size * (size_t)i / 40);
            if (read_all("3dgstream", folder) == SPIN_OK)
                ok(0, "%d/40 of a network is read", i);
        }
        remove(network);
        make_text(folder, "NTCs/NTC_000000.pth", "\x80\2no zip");
        fails("3dgstream", folder, "not a zip", "a network that is not a zip");
        remove(network);
        make_link(path_in(root, "ntc_warmup.pth"), folder, "NTCs/NTC_000000.pth");
        ok(read_all("3dgstream", folder) == SPIN_OK, "a network whose box is of integers is read");
        spin_map_close(&map);
    }
    make_link(path_in(root, "fvv/NTCs/NTC_000000.pth"), folder, "NTCs/NTC_000002.pth");
    fails("3dgstream", folder, "not 2 between", "a gap in the networks");
}

/* ---- Arithmetic ------------------------------------------------------------------------------ */

/* What the method makes without a configuration: 64 x 64 twice, 16 x 64, and four numbers for each
 * of the 16^3 corners of the coarsest level and of 2^15 entries of the 15 others. */
static void test_usual_shape(void)
{
    struct ntc_shape shape;

    spin_ntc_default_shape(&shape);
    ok(spin_ntc_layout(&shape) == SPIN_OK, "the usual network");
    near((double)shape.n_parameters, 64 * 64 * 2 + 16 * 64 + 4 * (16 * 16 * 16 + 15 * 32768), 0,
         "has as many numbers as the method's");
}

static void test_half(void)
{
    static const float pairs[][2] = {
        {1, 1},
        {1.0f + 1.0f / 2048, 1},
        {1.0f + 3.0f / 2048, 1.0f + 2.0f / 1024},
        {65504, 65504},
        {65519, 65504},
        {65520, INFINITY},
        {-65520, -INFINITY},
        {5.9604645e-8f, 5.9604645e-8f},
        {2.9802322e-8f, 0},
        {8.9406967e-8f, 1.1920929e-7f},
        {6.1035156e-5f, 6.1035156e-5f},
        {-0.1f, -0.099975586f},
    };
    bool good = isnan(spin_half(NAN));

    for (size_t i = 0; i < sizeof pairs / sizeof *pairs; i++)
        good = good && spin_half(pairs[i][0]) == pairs[i][1];
    ok(good, "floats are rounded to half, ties to even");
}

TAP_MAIN
{
    const char *root = check_fixture("3dgstream");

    spin_log_set_level(-2);
    test_half();
    test_usual_shape();
    if (!root) {
        skip("3dgstream fixtures", "there are none here");
        return;
    }
    test_fixture(root);
    if (spin_path_exists(path_in(root, "fvv"))) {
        test_folders(root);
        test_settings(root);
        test_networks(root);
    }
}
