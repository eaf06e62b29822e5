/* What spin_export_clip() hands to an exporter, of a clip whose numbers and times are known: names,
 * sequence.json, frames a second, the splats of each frame; and that --check sees what few bits
 * lose. K: export sequence */
#include "spin_run.h"
#include "run/run.h"
#include "io/ply.h"
#include "scene/bundle.h"
#include "tests/check.h"
#include "tests/tap.h"

enum { FRAMES = 4, SPLATS = 20 };
static const int number[FRAMES] = {10, 11, 12, 15};
static const double times[FRAMES] = {0.5, 0.6, 0.8, 1.1}; /* five frames a second, in the mean */
static char bundle[600], folder[700];

static size_t counts[FRAMES] = {SPLATS, SPLATS + 1, SPLATS + 2, SPLATS + 3};
static float size = 1;

/* Frame f has splats at x = f and of its own colour. */
static void write_bundle(void)
{
    const unsigned columns = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    struct spin_bundle_writer w;
    struct spin_bundle_meta meta = {0};
    struct spin_splats s = {0};

    if (spin_bundle_meta_reserve(&meta, FRAMES) != SPIN_OK ||
        spin_bundle_writer_open(bundle, false, false, &w) != SPIN_OK)
        exit(1);
    snprintf(meta.from, sizeof meta.from, "d3dgs");
    meta.columns = columns;
    meta.numbered = true;
    meta.n_source_frames = FRAMES;
    for (int f = 0; f < FRAMES; f++) {
        size_t n = counts[f];

        if (spin_splats_reserve(&s, n, columns, 0) != SPIN_OK)
            exit(1);
        for (size_t i = 0; i < n; i++) {
            for (size_t c = 0; c < 3; c++) {
                s.means[3 * i + c] = size * (c ? (float)i : (float)f);
                s.log_scales[3 * i + c] = -1.03f - (float)c + logf(size);
                s.sh[3 * i + c] = 0.1f * (float)f + 0.01f * (float)i;
            }
            s.quats[4 * i] = 0.8f;
            s.quats[4 * i + 1] = s.quats[4 * i + 2] = 0;
            s.quats[4 * i + 3] = 0.6f;
            s.logit_opacities[i] = 0.3f;
        }
        meta.frame[f] = (struct spin_frame_info){.number = number[f], .time = times[f], .n = n};
        meta.source_index[f] = f;
        if (spin_bundle_write_frame(&w, f, columns, 0, &s) != SPIN_OK)
            exit(1);
    }
    if (!ok(spin_bundle_writer_finish(&w, &meta, NULL) == SPIN_OK, "a clip of four frames"))
        printf("#   %s\n", spin_last_error());
    spin_bundle_meta_free(&meta);
    spin_splats_free(&s);
}

static double number_of(const spin_json *j, const char *key)
{
    double value = NAN;

    spin_json_number(spin_json_get(j, key), &value);
    return value;
}

static void write_named(const char *name)
{
    snprintf(bundle, sizeof bundle, "%s/%s.spin", check_folder(), name);
    snprintf(folder, sizeof folder, "%s-out", bundle);
    write_bundle();
}

/* One PLY: as many splats as the frame has, at its x, of its colour. */
static bool ply_is(int f)
{
    char path[800];
    struct spin_ply ply;
    float value[SPLATS + FRAMES] = {0};
    bool good;

    snprintf(path, sizeof path, "%s/frame_%05d.ply", folder, number[f]);
    if (spin_ply_open(path, &ply) != SPIN_OK)
        return false;
    good = ply.element[0].count == (uint64_t)(SPLATS + f);
    if (good)
        spin_ply_column(&ply, &ply.element[0], spin_ply_find(&ply.element[0], "x"), value, 1);
    good = good && value[0] == (float)f && value[SPLATS + f - 1] == (float)f;
    if (good)
        spin_ply_column(&ply, &ply.element[0], spin_ply_find(&ply.element[0], "f_dc_1"), value, 1);
    good = good && value[1] == 0.1f * (float)f + 0.01f;
    spin_ply_close(&ply);
    return good;
}

/* Frames first, first + step, ... of the clip are there, under their numbers, and nothing else. */
static void check_sequence(const char *name, struct spin_range range, int first, int step, int n,
                           double fps, const char *what)
{
    struct spin_export_options o = {
        .input = bundle, .output = folder, .to = "ply", .range = range, .device = "cpu"};
    struct spin_export_report r;
    char path[800];
    spin_json *j = NULL;
    const spin_json *frames;
    bool plys = true, entries = true;

    snprintf(folder, sizeof folder, "%s.%s", bundle, name);
    if (!ok(spin_export_clip(&o, &r) == SPIN_OK && r.frames == n, "%s: %d frames", what, n)) {
        printf("#   %s\n", spin_last_error());
        return;
    }
    snprintf(path, sizeof path, "%s/sequence.json", folder);
    if (!ok(spin_json_load(path, &j) == SPIN_OK, "%s: sequence.json", what))
        return;
    frames = spin_json_get(j, "frames");
    for (int k = 0; k < n; k++) {
        const spin_json *e = spin_json_at(frames, (size_t)k);
        int f = first + k * step;

        plys = plys && ply_is(f);
        entries = entries && number_of(e, "frame") == number[f] &&
                  fabs(number_of(e, "time") - times[f]) < 1e-12 &&
                  number_of(e, "splats") == SPLATS + f;
    }
    ok(plys, "%s: every frame under its number, with its own splats", what);
    ok(entries && spin_json_length(frames) == (size_t)n, "%s: numbers, times and counts", what);
    if (fps > 0)
        near(number_of(j, "fps"), fps, 1e-9, "frames a second");
    else
        ok(isnan(number_of(j, "fps")), "%s: one frame has no frames a second", what);
    spin_json_free(j);
}

/* Sixteen steps a unit of the log scale: -1.03 becomes -1, -2.03 becomes -2. */
static void check_check(void)
{
    struct spin_export_options o = {
        .input = bundle, .output = folder, .to = "spz", .check = true, .device = "cpu"};
    struct spin_export_report r;

    snprintf(folder, sizeof folder, "%s-spz", bundle);
    if (!ok(spin_export_clip(&o, &r) == SPIN_OK && r.check.frames == FRAMES,
            "--check reads all back"))
        return;
    near(r.check.largest[1], 0.03, 1e-4, "--check sees the error of the scales");
    near(r.check.rms[1], 0.03, 1e-4, "and its mean");
    ok(r.check.largest[0] < 1e-4 && r.check.largest[3] > 1e-4 &&
           r.check.largest[3] < 0.5 / 255 + 1e-6,
       "places are nearly exact, opacities to half a step");
    ok(r.check.psnr > 30 && r.check.rendered == number[FRAMES / 2],
       "the middle frame is drawn from its file");
}

/* An empty frame in the middle: its neighbour is drawn. Nothing but empty frames: none is. */
static void check_empty(bool all)
{
    struct spin_export_options o = {
        .input = bundle, .output = folder, .to = "spz", .check = true, .device = "cpu"};
    struct spin_export_report r;

    for (int f = 0; f < FRAMES; f++)
        counts[f] = all || f == 2 ? 0 : SPLATS;
    write_named(all ? "empty" : "gap");
    ok(spin_export_clip(&o, &r) == SPIN_OK && r.check.frames == FRAMES, "--check of empty frames");
    if (all)
        ok(r.check.rendered == -1 && isnan(r.check.psnr), "no picture, and no figure of one");
    else
        ok(r.check.rendered == number[1] && r.check.psnr > 30 && isfinite(r.check.psnr),
           "a frame beside the empty one is drawn, %.1f dB", r.check.psnr);
}

/* Returns the share of an image's values that are not black. */
static double lit(const char *path)
{
    enum { VALUES = 3 * 960 * 640 };
    static float image[VALUES];
    int n = 0;

    if (spin_image_load(path, 960, 640, NULL, image) != SPIN_OK)
        return 0;
    for (int i = 0; i < VALUES; i++)
        n += image[i] > 0;
    return (double)n / VALUES;
}

/* A scene of one splat, and one of a thousandth the size, is seen as well: by the check and on an
 * orbit, which shows at least this share of values that are not black. */
static void check_small(float now, size_t n, double least)
{
    struct spin_export_options o = {
        .input = bundle, .output = folder, .to = "spz", .check = true, .device = "cpu"};
    static const char *const orbit[] = {"path", "orbit", "repeat", "1", "size", "480x320", NULL};
    struct spin_export_report r;

    size = now;
    for (int f = 0; f < FRAMES; f++)
        counts[f] = n;
    write_named(n == 1 ? "one" : now < 1 ? "small" : "large");
    ok(spin_export_clip(&o, &r) == SPIN_OK && isfinite(r.check.psnr) && r.check.psnr > 5,
       "--check sees %zu splats of size %g", n, (double)now);
    o = (struct spin_export_options){
        .input = bundle, .output = folder, .to = "images", .device = "cpu", .plugin_pairs = orbit};
    snprintf(folder, sizeof folder, "%s-orbit", bundle);
    ok(spin_export_clip(&o, &r) == SPIN_OK, "four pictures around it");
    for (int p = 0; p < FRAMES; p++) {
        char path[800];

        snprintf(path, sizeof path, "%s/orbit_frame_%05d.png", folder, p);
        ok(lit(path) > least, "picture %d shows it: %g", p, lit(path));
    }
}

TAP_MAIN
{
    spin_set_verbosity(-1);
    snprintf(bundle, sizeof bundle, "%s/clip.spin", check_folder());
    write_bundle();
    check_sequence("all", (struct spin_range){0}, 0, 1, 4, 5, "all");
    check_sequence("two", (struct spin_range){true, 10, 13, 2}, 0, 2, 2, 1 / 0.3, "every second");
    check_sequence("last", (struct spin_range){true, 13, 16, 1}, 3, 1, 1, 0, "the last");
    check_check();
    check_empty(false);
    check_empty(true);
    check_small(1, SPLATS, 0.005);
    check_small(1, 1, 0.005);
    check_small(0.001f, SPLATS, 0.005);
}
