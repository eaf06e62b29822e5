/* SPZ, .splat, .ksplat, SOG and GLB as sources: files of other programs, our own, and malformed
 * files.
 * K: spz splat ksplat sog gltf glb import */
#include "tests/importers/expected_clouds.h"

#include "spin_run.h"
#include "run/run.h"
#include "formats/splat.h"
#include "io/webp.h"
#include "tests/formats/spz_files.h"
#include "scene/bundle.h"

static const char *write_file(const char *folder, const char *name, const void *bytes, size_t n)
{
    const char *path = path_in(folder, name);
    FILE *file = fopen(path, "wb");

    if (!file || fwrite(bytes, 1, n, file) != n || fclose(file) != 0)
        exit(1);
    return path;
}

/* ---- Files of other programs */

static void test_fixture(const char *name, const char *importer)
{
    const char *fixture = check_fixture(path_in("splats", name)), *folder, *first;
    const struct spin_importer *found = NULL;
    spin_json *manifest;
    struct run run;

    if (!fixture) {
        skip(name, "no such fixture");
        return;
    }
    folder = path_in(fixture, ".");
    manifest = load_manifest(folder);
    first = path_in(folder, spin_json_string(spin_json_at(spin_json_get(manifest, "files"), 0)));
    ok(spin_importer_find(folder, NULL, false, &found) == SPIN_OK && !strcmp(found->name, importer),
       "%s: the folder is recognised", name);
    ok(spin_importer_find(first, NULL, false, &found) == SPIN_OK && !strcmp(found->name, importer),
       "%s: so is a file", name);
    compare_run(NULL, folder, path_in(folder, "expected.npz"), manifest, 0, name);
    ok(run_open(importer, folder, &run) == SPIN_OK && run.sequence.n_frames == 3 &&
           run.sequence.numbers && run.sequence.numbers[2] == 2 && !run.sequence.continuous,
       "%s: three numbered frames", name);
    run_close(&run);
    ok(run_open(importer, first, &run) == SPIN_OK && run.sequence.n_frames == 1 &&
           run.sequence.numbers && run.sequence.numbers[0] == 0,
       "%s: a file is one frame with its number", name);
    run_close(&run);
    /* .splat has no header: any number of whole rows is a file. */
    ok(read_truncations(importer, first) == (strcmp(importer, "splat") == 0 ? 39 : 0),
       "%s: no truncation of a file can be read but whole rows", name);
    spin_json_free(manifest);
}

/* The files of a SOG in a folder. */
static void test_loose(void)
{
    const char *sog = check_fixture("splats/sog"), *folder = new_folder(), *meta;
    const struct spin_importer *found = NULL;
    struct spin_splats packed = {0}, loose = {0};
    static char text[1 << 16];
    struct spin_zip zip;
    struct run run;

    if (!sog || spin_webp_need() != SPIN_OK) {
        skip("loose SOG", "no fixture, or no libwebp");
        return;
    }
    sog = path_in(sog, "frame_00001.sog");
    if (spin_zip_open(sog, &zip) != SPIN_OK)
        exit(1);
    for (size_t i = 0; i < zip.n; i++) {
        const unsigned char *data;
        void *owned;

        if (spin_zip_read(&zip, &zip.member[i], true, 1 << 20, &data, &owned) != SPIN_OK)
            exit(1);
        write_file(folder, zip.member[i].name, data, (size_t)zip.member[i].size);
        if (!strcmp(zip.member[i].name, "meta.json"))
            snprintf(text, sizeof text, "{\"model\":\"antialiased\",%.*s",
                     (int)zip.member[i].size - 1, (const char *)data + 1);
        free(owned);
    }
    spin_zip_close(&zip);
    ok(run_open("sog", sog, &run) == SPIN_OK &&
           run.importer->frame(run.self, 0, 0, ALL, &packed) == SPIN_OK,
       "a SOG");
    run_close(&run);
    meta = path_in(folder, "meta.json");
    for (int i = 0; i < 2; i++) {
        const char *path = i ? meta : folder;

        ok(spin_importer_find(path, NULL, false, &found) == SPIN_OK && !strcmp(found->name, "sog"),
           "loose, it is recognised by its %s", i ? "meta.json" : "folder");
        ok(run_open(NULL, path, &run) == SPIN_OK && run.sequence.n_frames == 1 &&
               run.importer->frame(run.self, 0, 0, ALL, &loose) == SPIN_OK && loose.n == 40 &&
               !memcmp(loose.means, packed.means, 3 * 40 * sizeof *loose.means) &&
               !memcmp(loose.sh, packed.sh, 27 * 40 * sizeof *loose.sh),
           "and the same");
        run_close(&run);
    }
    write_file(folder, "meta.json", text, strlen(text));
    ok(!run.sequence.antialias && run_open("sog", folder, &run) == SPIN_OK &&
           run.sequence.antialias && run.importer->frame(run.self, 0, 0, ALL, &loose) == SPIN_OK &&
           loose.antialias,
       "says that it is meant to be drawn antialiased, and only then");
    run_close(&run);
    write_file(folder, "quats.webp", "", 0);
    fails("sog", folder, "meta.json': not a WebP", "a picture that is empty");
    spin_splats_free(&packed);
    spin_splats_free(&loose);
}

/* ---- Our own files */

static const char *work;

/* Compares the frames of `path` with those of the bundle `in`, which has the same order. */
static void compare_with(struct spin_bundle *in, const char *path, const char *const *options,
                         const double bound[5], const char *name)
{
    static const char *const what[5] = {"places", "rotations", "log scales", "opacities", "SH"};
    struct spin_plugin_values values = {options};
    struct spin_splats is = {0}, back = {0};
    struct run run = {0};
    double worst[5] = {0};
    int n_frames = 0;

    if (spin_importer_find(path, NULL, false, &run.importer) != SPIN_OK ||
        run.importer->open(path, &values, &run.self, &run.sequence) != SPIN_OK)
        printf("#   %s\n", spin_last_error());
    else
        n_frames = run.sequence.n_frames;
    ok(n_frames == in->meta.n_frames, "%s: as many frames", name);
    for (int f = 0; f < n_frames; f++) {
        size_t n_sh;

        if (!ok(run.importer->frame(run.self, f, 0, ALL, &back) == SPIN_OK &&
                    spin_bundle_frame(in, f, ALL, &is) == SPIN_OK && is.n == back.n &&
                    run.sequence.numbers[f] == in->meta.frame[f].number,
                "%s: frame %d and its number", name, f))
            break;
        n_sh = 3 * (size_t)((back.sh_degree + 1) * (back.sh_degree + 1));
        for (size_t i = 0; i < is.n; i++) {
            double same = 0, other = 0; /* q and -q are one rotation */

            for (size_t c = 0; c < 3; c++) {
                worst[0] =
                    larger(worst[0], fabs((double)is.means[3 * i + c] - back.means[3 * i + c]));
                worst[2] = larger(
                    worst[2], fabs((double)is.log_scales[3 * i + c] - back.log_scales[3 * i + c]));
            }
            for (size_t k = 0; k < 4; k++) {
                same += pow((double)is.quats[4 * i + k] - back.quats[4 * i + k], 2);
                other += pow((double)is.quats[4 * i + k] + back.quats[4 * i + k], 2);
            }
            worst[1] = larger(worst[1], 4 * asin(sqrt(fmin(same, other)) / 2) * 180 / M_PI);
            worst[3] = larger(
                worst[3], fabs(sigmoid(is.logit_opacities[i]) - sigmoid(back.logit_opacities[i])));
            for (size_t k = 0; k < n_sh; k++)
                worst[4] = larger(
                    worst[4],
                    fabs((double)
                             is.sh[3 * (size_t)((is.sh_degree + 1) * (is.sh_degree + 1)) * i + k] -
                         back.sh[n_sh * i + k]));
        }
    }
    for (int k = 0; k < 5 && n_frames > 0; k++)
        ok(worst[k] <= bound[k], "%s: %s within %g: %g", name, what[k], bound[k], worst[k]);
    if (run.self)
        run_close(&run);
    spin_splats_free(&is);
    spin_splats_free(&back);
}

/* Positions, rotations (degrees), log scales, opacities, SH: half a quantisation step of each
 * format (for rotations, of all components together), and the rounding of floats that are read
 * and written. */
#define BYTE (0.5 / 255 * 1.001)
#define SPZ_BOUNDS                                                                                 \
    {                                                                                              \
        0.5 / 4096 * 1.001, 0.24, 0.5 / 16 * 1.001, BYTE, 4.0 / 128 * 1.001                        \
    }
#define GLTF_BOUNDS                                                                                \
    {                                                                                              \
        0, 1e-4, 1e-6, 1e-6, 0                                                                     \
    }
static const struct written {
    const char *to, *output;
    const char *out_options[3], *in_options[3];
    double bound[5];
} written[] = {
    {"spz", "spz", {0}, {0}, SPZ_BOUNDS},
    {"spz", "spz-rub", {"axes", "rub"}, {"axes", "rub"}, SPZ_BOUNDS},
    {"splat", "splat", {0}, {0}, {0, 1.0, 1e-6, BYTE, BYTE / 0.282}},
    {"gltf", "gltf", {0}, {0}, GLTF_BOUNDS},
    {"gltf", "gltf-source", {"axes", "source"}, {"axes", "source"}, GLTF_BOUNDS},
    {"gltf", "clip.glb", {0}, {0}, GLTF_BOUNDS},
    /* a chunk is as wide as the clip: 8, and 4 of log scales */
    {"compressed-ply",
     "packed",
     {"order", "source"},
     {0},
     {8.0 / 2046, 0.28, 4.0 / 2046, BYTE, 1.001 / 64}},
    {"ply", "ply", {0}, {0}, {0, 1e-4, 0, 1e-6, 0}},
};

/* A clip whose values are within the range of every format, opened by the library. */
static const char *write_clip(void)
{
    const char *path = path_in(work, "in.spin");
    struct spin_bundle_meta meta = {
        .columns = ALL, .numbered = true, .n_source_frames = 3, .sh_degree = 1};
    struct spin_bundle_writer w;
    struct spin_splats s = {0};
    uint32_t seed = 3;

    if (spin_bundle_meta_reserve(&meta, 3) != SPIN_OK ||
        spin_bundle_writer_open(path, false, false, &w) != SPIN_OK)
        exit(1);
    for (int f = 0; f < 3; f++) {
        size_t n = 300 - 10 * (size_t)f;

        if (spin_splats_reserve(&s, n, ALL, 1) != SPIN_OK)
            exit(1);
        for (size_t i = 0; i < n * 23; i++) {
            float *to = i < 3 * n    ? s.means + i
                        : i < 7 * n  ? s.quats + i - 3 * n
                        : i < 10 * n ? s.log_scales + i - 7 * n
                        : i < 11 * n ? s.logit_opacities + i - 10 * n
                                     : s.sh + i - 11 * n;
            float low = i < 3 * n ? -4 : i < 7 * n ? -1 : i < 10 * n ? -6 : i < 11 * n ? -3 : -0.9f;
            float high = i < 3 * n ? 4 : i < 7 * n ? 1 : i < 10 * n ? -2 : i < 11 * n ? 3 : 0.9f;

            seed = seed * 1664525u + 1013904223u;
            *to = low + (high - low) * (float)(seed >> 8) / 16777216.0f;
        }
        for (size_t i = 0; i < n; i++) {
            double norm = 0;

            for (size_t k = 0; k < 4; k++)
                norm += (double)s.quats[4 * i + k] * s.quats[4 * i + k];
            for (size_t k = 0; k < 4; k++)
                s.quats[4 * i + k] = (float)(s.quats[4 * i + k] / sqrt(norm));
        }
        meta.frame[f] = (struct spin_frame_info){.number = 5 + 2 * f, .time = 0.1 * f, .n = n};
        meta.source_index[f] = f;
        if (spin_bundle_write_frame(&w, f, ALL, 0, &s) != SPIN_OK)
            exit(1);
    }
    if (spin_bundle_writer_finish(&w, &meta, NULL) != SPIN_OK)
        exit(1);
    spin_bundle_meta_free(&meta);
    spin_splats_free(&s);
    return path;
}

static void test_written(void)
{
    const char *clip = write_clip();
    struct spin_bundle in;

    if (spin_bundle_open(clip, &in) != SPIN_OK)
        exit(1);
    for (size_t i = 0; i < sizeof written / sizeof *written; i++) {
        const struct written *w = &written[i];
        const char *output = path_in(work, w->output);
        struct spin_export_options o = {.input = clip,
                                        .output = output,
                                        .to = w->to,
                                        .device = "cpu",
                                        .plugin_pairs = w->out_options};
        struct spin_export_report r;

        if (!ok(spin_export_clip(&o, &r) == SPIN_OK, "%s: is written", w->output)) {
            printf("#   %s\n", spin_last_error());
            continue;
        }
        compare_with(&in, output, w->in_options, w->bound, w->output);
    }
    spin_bundle_close(&in);
}

static void write_frames(const char *output, const char *to, int first, int last,
                         const char *const *options)
{
    struct spin_export_options o = {.input = path_in(work, "in.spin"),
                                    .output = output,
                                    .to = to,
                                    .device = "cpu",
                                    .range = {true, first, last, 1},
                                    .plugin_pairs = options};
    struct spin_export_report r;

    if (spin_export_clip(&o, &r) != SPIN_OK)
        exit(1);
}

static void move(const char *from, const char *to)
{
    if (rename(from, to) != 0)
        exit(1);
}

/* A clip in one file keeps the times of the bundle; among the frames of another clip it is
 * refused. */
static void test_clip(void)
{
    const char *clip = path_in(work, "clip.glb");
    static unsigned char bytes[1 << 18];
    struct spin_map map;
    struct run run;

    ok(run_open(NULL, clip, &run) == SPIN_OK && run.sequence.times &&
           fabs(run.sequence.times[2] - 0.2) < 1e-12 &&
           run.sequence.time_last == run.sequence.times[2] && !*run.sequence.notes,
       "a clip in one file keeps its times");
    run_close(&run);
    if (spin_map_open(clip, &map) != SPIN_OK || map.size > sizeof bytes)
        exit(1);
    memcpy(bytes, map.data, map.size);
    memcpy(memmem(bytes, map.size, "\"STEP\"", 6), "\"ELSE\"", 6);
    ok(run_open(NULL, write_file(new_folder(), "moves.glb", bytes, map.size), &run) == SPIN_OK &&
           strstr(run.sequence.notes, "that move or fade nodes are ignored"),
       "one that does more than switch says what is left out");
    run_close(&run);
    spin_map_close(&map);
    move(clip, path_in(work, "gltf/frame_00100.glb"));
    fails("gltf", path_in(work, "gltf"), "contains a clip of",
          "a clip among the frames of another");
}

/* Frames of different SH degrees; gaps between numbers. */
static void test_degrees(void)
{
    static const char *const sh_0[] = {"sh", "0", NULL};
    const char *folder = path_in(work, "mixed"), *other = path_in(work, "others");
    struct spin_splats s = {0};
    struct run run;
    double rest = 0;

    write_frames(folder, "spz", 5, 6, NULL);
    write_frames(other, "spz", 7, 8, sh_0);
    move(path_in(other, "frame_00007.spz"), path_in(folder, "frame_00007.spz"));
    if (!ok(run_open("spz", folder, &run) == SPIN_OK && run.sequence.sh_degree == 1 &&
                strstr(run.sequence.notes, "missing SH are set to 0") &&
                strstr(run.sequence.notes, "gaps") &&
                run.importer->frame(run.self, 0, 0, ALL, &s) == SPIN_OK && s.sh[3] != 0 &&
                run.importer->frame(run.self, 1, 0, ALL, &s) == SPIN_OK && s.sh_degree == 1,
            "frames of different SH degrees: the larger one"))
        printf("#   %s\n", spin_last_error());
    for (size_t i = 0; i < s.n; i++)
        for (size_t k = 3; k < 12; k++)
            rest += fabs((double)s.sh[12 * i + k]);
    ok(s.n == 290 && rest == 0, "what a frame lacks is 0");
    run_close(&run);
    spin_splats_free(&s);
}

/* An SPZ that declares right, up, back as its axes is rotated automatically. */
static void test_axes(void)
{
    static const unsigned char record[] = {3, 0, 0xbe, 0xad, 4, 0, 0, 0, SPIN_SPZ_RIGHT_UP_BACK,
                                           0, 0, 0};
    static const char *const third[] = {"axes", "rub", "spz-version", "3", NULL};
    const char *folder = path_in(work, "said"), *rub = path_in(work, "third/frame_00005.spz");
    static unsigned char bytes[65536];
    struct spin_splats is = {0}, said = {0};
    struct spin_map map;
    struct run run;
    unsigned char *file;
    size_t n = 0, size;
    FILE *out;

    spin_folder_make(folder);
    write_frames(path_in(work, "third"), "spz", 5, 6, third);
    if (spin_map_open(rub, &map) != SPIN_OK ||
        spin_gzip_read(map.data, map.size, bytes, sizeof bytes, &n) != SPIN_OK)
        exit(1);
    bytes[14] |= 2;
    file = make_spz_4(bytes, record, sizeof record, &size);
    out = fopen(path_in(folder, "a.spz"), "wb");
    if (!out || fwrite(file, 1, size, out) != size || fclose(out) != 0)
        exit(1);
    ok(run_open("spz", path_in(work, "spz"), &run) == SPIN_OK &&
           strstr(run.sequence.notes, "does not record its axes") &&
           run.importer->frame(run.self, 0, 0, ALL, &is) == SPIN_OK,
       "a file that does not record its axes: a note");
    run_close(&run);
    ok(run_open("spz", folder, &run) == SPIN_OK && !strstr(run.sequence.notes, "axes") &&
           run.importer->frame(run.self, 0, 0, ALL, &said) == SPIN_OK && said.n == is.n,
       "one that does: none");
    run_close(&run);
    if (said.n == is.n) {
        double worst = 0;

        for (size_t i = 0; i < 3 * is.n; i++)
            worst = larger(worst, fabs((double)is.means[i] - said.means[i]));
        for (size_t i = 0; i < 12 * is.n; i++)
            worst = larger(worst, fabs((double)is.sh[i] - said.sh[i]) - 1.0 / 16);
        ok(worst <= 1.0 / 4096, "places and SH are turned back: %g", worst);
    }
    spin_map_close(&map);
    spin_splats_free(&is);
    spin_splats_free(&said);
    free(file);
}

/* ---- Files made here ---------------------------------------------------------------------------
 */

static void test_refused(void)
{
    const char *folder = new_folder();
    unsigned char row[2 * SPIN_SPLAT_ROW] = {0};
    const float bad = NAN;
    static const char pointer[] = "version https://git-lfs.github.com/spec/v1\noid sha256:00\n";

    fails("spz", write_file(folder, "a.spz", "", 0), "a.spz", "an empty SPZ");
    fails("spz", write_file(folder, "b.spz", "NGSP", 4), "b.spz", "an SPZ of its magic");
    fails("splat", write_file(folder, "a.splat", "", 0), "0 splats", "an empty .splat");
    fails("splat", write_file(folder, "b.splat", row, 33), "multiple of 32",
          ".splat with half a row");
    memcpy(row + SPIN_SPLAT_ROW + 4, &bad, sizeof bad);
    fails("splat", write_file(folder, "c.splat", row, sizeof row), "row 1",
          "NaN in a .splat, with its row");
    ok(strstr(spin_last_error(), "c.splat") != NULL, "and its file");
    fails("gltf", write_file(folder, "a.glb", "glTF", 4), "a.glb", "a GLB of its magic");
    fails("gltf", new_folder(), "no .glb files", "a folder without files");
    fails(NULL, write_file(folder, "lfs.spz", "version https://git-lfs.github.com/spec/v1\n", 43),
          "LFS", "a pointer to an SPZ");
    fails(NULL, write_file(folder, "lfs.splat", pointer, sizeof pointer - 1),
          "lfs.splat': it is a Git LFS", "one to a .splat");
    folder = new_folder();
    write_file(folder, "0.splat", row, SPIN_SPLAT_ROW);
    write_file(folder, "1.splat", pointer, sizeof pointer - 1);
    fails("splat", folder, "1.splat': it is a Git LFS", "and one among the frames of a clip");
}

/* A run of 3DGS with a viewer's file beside its clouds. */
static void test_stray(void)
{
    static const char *const clouds[] = {"point_cloud/iteration_7", "iteration_7", "."};
    static const char *const strays[] = {"scene.splat", "scene.spz", "scene.glb"};
    const struct spin_importer *found = NULL;
    unsigned char row[SPIN_SPLAT_ROW] = {0};

    for (size_t i = 0; i < 3; i++) {
        const char *folder = new_folder(), *cloud = path_in(folder, clouds[i]);

        spin_folder_make(cloud);
        write_file(cloud, "point_cloud.ply", "ply\n", 4);
        write_file(folder, strays[i], row, sizeof row);
        ok(spin_importer_find(folder, NULL, false, &found) == SPIN_OK &&
               strcmp(found->name, "ply") == 0,
           "%s and %s: the run", clouds[i], strays[i]);
    }
}

TAP_MAIN
{
    spin_log_set_level(-1);
    work = new_folder();
    test_fixture("spz2", "spz");
    test_fixture("spz3", "spz");
    test_fixture("spz4", "spz");
    test_fixture("splat", "splat");
    test_fixture("ksplat", "ksplat");
    if (spin_webp_need() == SPIN_OK)
        test_fixture("sog", "sog");
    else
        skip("sog", spin_last_error());
    test_loose();
    test_fixture("glb", "gltf");
    test_written();
    test_clip();
    test_degrees();
    test_axes();
    test_refused();
    test_stray();
}
