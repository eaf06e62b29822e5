/* K: usd export threads
 * Stages of USD, read by a reader of their text that is written here, and held to what OpenUSD's
 * schema and the published rules of validation ask: required attributes, lengths, ranges. */
#include "base/log.h"
#include "formats/usd_layer.h"
#include "io/zip.h"
#include "math/ntc.h"
#include "tests/exporters/frame.h"

extern const struct spin_exporter spin_exporter_usd;

static char *slurp(const char *path)
{
    FILE *file = fopen(path, "rb");
    char *text = calloc(1, 8 << 20);

    if (file) {
        if (fread(text, 1, (8 << 20) - 1, file) == 0)
            text[0] = '\0';
        fclose(file);
    }
    return text;
}

/* The samples of an attribute "TYPE NAME": one time, [tuples of `group`]; how many numbers, or -1
 * when the text is not of that form. out: allocated. */
static long samples(const char *text, const char *attribute, int group, double *time, double **out)
{
    char head[200];
    const char *at;
    char *end;
    long n = 0;

    *out = malloc(sizeof **out * 500000);
    snprintf(head, sizeof head, "\n    %s.timeSamples = {\n", attribute);
    at = strstr(text, head);
    if (!at)
        return -1;
    *time = strtod(at + strlen(head), &end);
    if (strncmp(end, ": [", 3) != 0)
        return -1;
    for (at = end + 3; *at != ']';) {
        if (n > 0 && *at++ != ',')
            return -1;
        at += *at == ' ';
        if (group > 1 && *at++ != '(')
            return -1;
        for (int k = 0; k < group; k++) {
            if (k > 0 && *at++ != ',')
                return -1;
            (*out)[n++] = strtod(at, &end);
            if (end == at)
                return -1;
            at = end;
        }
        if (group > 1 && *at++ != ')')
            return -1;
    }
    return strncmp(at, "],\n    }\n", 9) == 0 ? n : -1;
}

static void as_halves(double *v, size_t n)
{
    for (size_t i = 0; i < n; i++)
        v[i] = (double)spin_half((float)v[i]);
}

static int all_within(const double *v, long n, double least, double most)
{
    for (long i = 0; i < n; i++)
        if (!(v[i] >= least && v[i] <= most))
            return 0;
    return 1;
}

/* The extent of three standard deviations of a splat along an axis, from the image of the axis
 * under its rotation. */
static double reach_of(const struct want *w, size_t axis)
{
    double q[4] = {w->q[0], w->q[1], w->q[2], w->q[3]}, sum = 0;
    double m[3][3] = {{1 - 2 * (q[2] * q[2] + q[3] * q[3]), 2 * (q[1] * q[2] - q[0] * q[3]),
                       2 * (q[1] * q[3] + q[0] * q[2])},
                      {2 * (q[1] * q[2] + q[0] * q[3]), 1 - 2 * (q[1] * q[1] + q[3] * q[3]),
                       2 * (q[2] * q[3] - q[0] * q[1])},
                      {2 * (q[1] * q[3] - q[0] * q[2]), 2 * (q[2] * q[3] + q[0] * q[1]),
                       1 - 2 * (q[1] * q[1] + q[2] * q[2])}};

    for (int k = 0; k < 3; k++)
        sum += pow(m[axis][k] * exp(w->log_scale[k]), 2);
    return 3 * sqrt(sum);
}

/* Whether values of SH degree n keep their sign or change it when the scene is rotated by half a
 * turn about x. */
static const char sh_signs[] = "+--+-++-+-+--+-+";

static bool has_hints(const char *text)
{
    return strstr(text, "    prepend apiSchemas = [\"ColorSpaceAPI\"]\n)\n{\n") &&
           strstr(text, "    uniform token colorSpace:name = \"srgb_rec709_scene\"\n") &&
           strstr(text, "    uniform token projectionModeHint = \"perspective\"\n") &&
           strstr(text, "    uniform token sortingModeHint = \"zDepth\"\n");
}

static void test_values(int degree, const char *sh, int to, int half, const char *axes)
{
    const char *pairs[] = {"sh", sh, "axes", axes, "fps", "24", half ? "half" : NULL, "", NULL};
    struct spin_plugin_values values = {pairs};
    struct spin_export_job job = {.output = in_folder("v"),
                                  .n_frames = 1,
                                  .force = true,
                                  .sh_degree = degree,
                                  .values = &values};
    size_t n = 9000, n_sh = (size_t)((to + 1) * (to + 1)),
           n_from = (size_t)((degree + 1) * (degree + 1));
    double *place, *q, *scale, *opacity, *coef, *extent, time[6], relative = half ? 5.1e-4 : 1e-7;
    double box[6] = {INFINITY, INFINITY, INFINITY, -INFINITY, -INFINITY, -INFINITY};
    int turned = strcmp(axes, "usd") == 0, good[6] = {1, 1, 1, 1, 1, 1};
    struct spin_splats s = {0};
    char *text, line[100];

    make_frame(&s, n, degree, 77);
    s.log_scales[5] = -19; /* below the smallest half */
    if (!ok(run(&spin_exporter_usd, &job, &s, 7) == SPIN_OK,
            "writes degree %d as %s, axes %s%s: %s", degree, sh, axes, half ? ", half" : "",
            spin_last_error()))
        return;
    text = slurp(in_folder("v/frame_00007.usda"));
    ok(!strncmp(text, "#usda 1.0\n(\n", 12) && strstr(text, "    defaultPrim = \"Splats\"\n") &&
           strstr(text, "    upAxis = \"Y\"\n") && strstr(text, "    metersPerUnit = 1\n") &&
           strstr(text, "    timeCodesPerSecond = 24\n") &&
           strstr(text, "    startTimeCode = 7\n") && strstr(text, "    endTimeCode = 7\n") &&
           strstr(text, "\ndef ParticleField3DGaussianSplat \"Splats\" ("),
       "the stage's metadata and the prim");
    snprintf(line, sizeof line, "\n    uniform int radiance:sphericalHarmonicsDegree = %d\n", to);
    ok(strstr(text, line) != NULL, "the degree");
    ok(has_hints(text), "the colour space and the hints");
    ok(samples(text, "point3f[] positions", 3, &time[0], &place) == 3 * (long)n &&
           samples(text, half ? "quath[] orientationsh" : "quatf[] orientations", 4, &time[1],
                   &q) == 4 * (long)n &&
           samples(text, half ? "half3[] scalesh" : "float3[] scales", 3, &time[2], &scale) ==
               3 * (long)n &&
           samples(text, half ? "half[] opacitiesh" : "float[] opacities", 1, &time[3], &opacity) ==
               (long)n &&
           samples(text,
                   half ? "half3[] radiance:sphericalHarmonicsCoefficientsh"
                        : "float3[] radiance:sphericalHarmonicsCoefficients",
                   3, &time[4], &coef) == 3 * (long)(n * n_sh) &&
           samples(text, "float3[] extent", 3, &time[5], &extent) == 6 && all_within(time, 6, 7, 7),
       "all attributes, of the right lengths, at the frame's time");
    if (half) { /* as a reader of halves takes the few digits */
        as_halves(q, 4 * n);
        as_halves(scale, 3 * n);
        as_halves(opacity, n);
        as_halves(coef, 3 * n * n_sh);
    }
    ok(all_within(scale, 3 * (long)n, 5e-9, 65504) && all_within(opacity, (long)n, 0, 1) &&
           (!half || all_within(scale, 3 * (long)n, 5.9e-8, 65504)),
       "scales are above 0, opacities from 0 to 1");
    for (size_t i = 0; i < n; i++) {
        struct want want = want_of(&s, i);
        double length = 0;

        if (turned) { /* half a turn about x: (0, 1, 0, 0) times q */
            double w[4] = {-want.q[1], want.q[0], -want.q[3], want.q[2]};

            memcpy(want.q, w, sizeof w);
            want.place[1] = -want.place[1];
            want.place[2] = -want.place[2];
        }
        for (size_t k = 0; k < 4; k++)
            length += q[4 * i + k] * q[4 * i + k];
        good[0] &= fabs(sqrt(length) - 1) < (half ? 1e-3 : 1e-6);
        good[1] &= degrees_between(q + 4 * i, want.q) < (half ? 0.1 : 0.01);
        for (size_t c = 0; c < 3; c++) {
            double reach = reach_of(&want, c), was = exp(want.log_scale[c]);

            good[2] &= fabs(place[3 * i + c] - want.place[c]) < (half ? 1e-5 : 1e-6);
            good[3] &= fabs(scale[3 * i + c] - was) < was * (relative + 1e-6) + (half ? 6e-8 : 0);
            good[5] &= extent[c] <= place[3 * i + c] - reach + 1e-4 &&
                       extent[3 + c] >= place[3 * i + c] + reach - 1e-4;
            box[c] = fmin(box[c], place[3 * i + c] - reach);
            box[3 + c] = larger(box[3 + c], place[3 * i + c] + reach);
            for (size_t k = 0; k < n_sh; k++) {
                double w = k < n_from ? (double)s.sh[(n_from * i + k) * 3 + c] : 0;

                w = turned && sh_signs[k] == '-' ? -w : w;
                good[4] &= fabs(coef[(n_sh * i + k) * 3 + c] - w) < 1.8 * relative + 1e-6;
            }
        }
        good[3] &= fabs(opacity[i] - want.opacity) < relative + 1e-6;
    }
    ok(good[0], "orientations are of unit length");
    ok(good[1], "and w x y z");
    ok(good[2], "places");
    ok(good[3], "scales are standard deviations, opacities not logits");
    ok(good[4], "SH, coefficient by coefficient");
    ok(good[5], "the extent holds three standard deviations of all");
    for (int k = 0; k < 6; k++)
        near(extent[k], box[k], 1e-4, "and no more");
    free(text);
    free(place);
    free(q);
    free(scale);
    free(opacity);
    free(coef);
    free(extent);
    spin_splats_free(&s);
}

/* Every third frame of a clip of 30 frames per second, or of unknown rate, plays as fast as all
 * of them. */
static void test_stride(double fps, const char *option, double want_fps, double want_codes)
{
    const char *pairs[] = {"fps", option, NULL};
    struct spin_plugin_values values = {pairs};
    struct spin_export_job job = {.output = in_folder("thirds"),
                                  .n_frames = 1,
                                  .force = true,
                                  .fps = fps,
                                  .stride = 3,
                                  .values = option ? &values : NULL};
    struct spin_splats s = {0};
    char *text, line[100];

    make_frame(&s, 5, 0, 1);
    ok(run(&spin_exporter_usd, &job, &s, 3) == SPIN_OK, "writes every third frame");
    text = slurp(in_folder("thirds/clip.usda"));
    snprintf(line, sizeof line, "\n    framesPerSecond = %g\n", want_fps);
    ok(strstr(text, line) != NULL, "%g frames a second", want_fps);
    snprintf(line, sizeof line, "\n    timeCodesPerSecond = %g\n", want_codes);
    ok(strstr(text, line) != NULL, "%g frame numbers a second", want_codes);
    free(text);
    spin_splats_free(&s);
}

/* The stage names the layers, and the time of each. */
static void test_stage(void)
{
    static const int numbers[] = {3, 5, 9};
    struct spin_export_job job = {.output = in_folder("clip"), .n_frames = 3, .fps = 12.5};
    struct spin_splats s = {0};
    void *self = NULL;
    char *text;
    int good = 1;

    make_frame(&s, 50, 0, 1);
    good = spin_exporter_usd.begin(&job, &self) == SPIN_OK;
    for (int f = 0; f < 3 && good; f++) {
        struct spin_frame_info info = {.number = numbers[f], .time = 0.1 * f, .n = s.n};

        good = spin_exporter_usd.frame(self, f, &info, &s) == SPIN_OK;
    }
    ok(good && spin_exporter_usd.end(self) == SPIN_OK, "writes three frames");
    text = slurp(in_folder("clip/clip.usda"));
    ok(has_hints(text), "the stage has the colour space and the hints");
    ok(!strncmp(text, "#usda 1.0\n(\n", 12) && strstr(text, "defaultPrim = \"Splats\"\n") &&
           strstr(text, "startTimeCode = 3\n") && strstr(text, "endTimeCode = 9\n") &&
           strstr(text, "timeCodesPerSecond = 12.5\n") && strstr(text, "upAxis = \"Y\"\n"),
       "the stage says when it plays");
    ok(strstr(text, "double2[] active = [(3, 0), (5, 1), (9, 2)]\n") &&
           strstr(text, "double2[] times = [(3, 3), (5, 5), (9, 9)]\n") &&
           strstr(text, "asset[] assetPaths = [@./frame_00003.usda@, @./frame_00005.usda@, "
                        "@./frame_00009.usda@]\n") &&
           strstr(text, "string primPath = \"/Splats\"\n") &&
           strstr(text, "asset manifestAssetPath = @./manifest.usda@\n"),
       "value clips: which layer at which time");
    /* a default or samples of its own would hide the clips' */
    ok(!strstr(text, "positions =") && !strstr(text, "timeSamples") &&
           strstr(text, "    point3f[] positions\n"),
       "and no value that hides theirs");
    free(text);
    text = slurp(in_folder("clip/manifest.usda"));
    for (int a = 0; a < 6; a++) {
        static const char *const names[] = {
            "float3[] extent",      "point3f[] positions",
            "quatf[] orientations", "float3[] scales",
            "float[] opacities",    "float3[] radiance:sphericalHarmonicsCoefficients"};
        char line[100];

        snprintf(line, sizeof line, "\n    %s\n", names[a]);
        good &= strstr(text, line) != NULL;
    }
    ok(good && strstr(text, "over \"Splats\""), "the manifest declares what the clips bring");
    free(text);
    spin_splats_free(&s);
}

/* Frames with constant scales, opacities and colours, which are stored once in the weakest
 * layer. */
static struct spin_splats clip[3];

static spin_status again(void *context, int frame, const struct spin_splats **out)
{
    (void)context;
    *out = &clip[frame];
    return SPIN_OK;
}

static bool run_clip(const struct spin_export_job *job)
{
    void *self = NULL;
    bool good = spin_exporter_usd.begin(job, &self) == SPIN_OK;

    for (int f = 0; f < job->n_frames && good; f++) {
        struct spin_frame_info info = {.number = 4 + 2 * f, .n = clip[f].n};

        good = spin_exporter_usd.frame(self, f, &info, &clip[f]) == SPIN_OK;
    }
    return good && spin_exporter_usd.end(self) == SPIN_OK;
}

static void test_still(void)
{
    struct spin_export_job job = {
        .output = in_folder("still"), .n_frames = 3, .again = again, .stride = 2, .force = true};
    char *stage, *layer, *still, *manifest;

    for (int f = 0; f < 3; f++) {
        make_frame(&clip[f], 40, 0, 7);
        clip[f].means[3] = 0.5f * (float)f;
        clip[f].quats[4 * 39] = f == 2 ? 0.9f : 0.1f;
    }
    if (!ok(run_clip(&job), "writes frames of which little changes"))
        return;
    stage = slurp(in_folder("still/clip.usda"));
    layer = slurp(in_folder("still/frame_00006.usda"));
    still = slurp(in_folder("still/still.usda"));
    manifest = slurp(in_folder("still/manifest.usda"));
    ok(strstr(layer, "positions.timeSamples") && strstr(layer, "orientations.timeSamples") &&
           !strstr(layer, " scales") && !strstr(layer, " opacities") &&
           !strstr(layer, "radiance:sphericalHarmonicsCoefficients"),
       "a layer has what changes");
    ok(strstr(still, "over \"Splats\"") && strstr(still, "\n    float3[] scales = [(") &&
           strstr(still, "\n    float[] opacities = [") && !strstr(still, "positions") &&
           !strstr(still, "orientations"),
       "what does not stands once");
    ok(strstr(stage, "subLayers = [@./still.usda@]") &&
           strstr(layer, "subLayers = [@./still.usda@]"),
       "below the stage, and below a layer that is opened alone");
    ok(!strstr(stage, " scales") && !strstr(manifest, " scales") && strstr(manifest, "positions"),
       "where the clips do not hide it");
    free(stage);
    free(layer);
    free(still);
    free(manifest);
    clip[2].sh[5] += 0.25f;
    clip[1].logit_opacities[7] += 1;
    clip[2].log_scales[0] += 1;
    job.output = in_folder("moving");
    ok(run_clip(&job) && !spin_path_exists(in_folder("moving/still.usda")), "nothing is still");
}

/* The numbers of a value of a crate, or of its sample at a time: how many tuples of `width`. */
static size_t numbers(struct spin_usd_layer *layer, const char *prim, const char *name, double time,
                      unsigned width, double *out)
{
    struct spin_usd_prim *at = spin_usd_prim_at(layer, prim);
    struct spin_usd_field *field = at ? spin_usd_field(at->attribute, name) : NULL;
    struct spin_usd_value *value = field ? spin_usd_sample_at(field, time) : NULL;
    size_t n = 0;

    value = value || !field ? value : &field->value;
    if (!value || spin_usd_count(value, width, &n) != SPIN_OK || n * width > 160 ||
        spin_usd_doubles(value, width, n, out) != SPIN_OK)
        return 0;
    return n;
}

static double metadata(struct spin_usd_layer *layer, const char *name)
{
    struct spin_usd_field *field = spin_usd_field(layer->root.metadata, name);
    double v = -1;

    return field && spin_usd_doubles(&field->value, 1, 1, &v) == SPIN_OK ? v : -1;
}

static bool text_is(struct spin_usd_field *list, const char *name, const char *want)
{
    struct spin_usd_field *field = spin_usd_field(list, name);
    char *text = NULL;
    bool same = field && spin_usd_text(&field->value, &text) == SPIN_OK && strcmp(text, want) == 0;

    free(text);
    return same;
}

/* A package has the same crate, aligned to 64 bytes. */
static void test_package(struct spin_export_job *job, const struct spin_map *crate)
{
    struct spin_zip zip;
    struct spin_map member;
    char path[4200];
    bool good;

    snprintf(path, sizeof path, "%s", in_folder("clip.usdz"));
    job->output = path;
    ok(run_clip(job) && spin_zip_open(path, &zip) == SPIN_OK && zip.n == 1 &&
           strcmp(zip.member[0].name, "clip.usdc") == 0 && zip.member[0].method == 0,
       "a package: %s", spin_last_error());
    good = spin_map_open(path, &member) == SPIN_OK && member.size > crate->size + 64 &&
           memcmp(member.data + 64, crate->data, crate->size) == 0;
    ok(good, "contains the same crate at a multiple of 64 bytes");
    spin_zip_close(&zip);
    spin_map_close(&member);
}

/* One file with the whole clip, a crate or text: what changes has samples, the rest a plain
 * value. */
static void test_file(const char *name, bool half)
{
    const char *pairs[] = {"axes", "source", half ? "half" : NULL, "", NULL};
    struct spin_plugin_values values = {pairs};
    struct spin_export_job job = {.output = in_folder(name),
                                  .n_frames = 3,
                                  .fps = 24,
                                  .force = true,
                                  .antialias = true,
                                  .values = &values};
    struct spin_usd_layer layer = {.size = 0};
    struct spin_usd_value flag;
    struct spin_map map;
    double v[160];
    bool good;

    for (int f = 0; f < 3; f++) {
        make_frame(&clip[f], 40, 0, 7);
        clip[f].means[3] = 0.5f * (float)f;
    }
    if (!ok(run_clip(&job), "writes %s: %s", name, spin_last_error()) ||
        !ok(spin_map_open(job.output, &map) == SPIN_OK &&
                spin_usd_open(map.data, map.size, &layer) == SPIN_OK,
            "it is read: %s", spin_last_error()))
        return;
    ok(text_is(layer.root.metadata, "defaultPrim", "Splats") &&
           text_is(layer.root.metadata, "upAxis", "Y") && metadata(&layer, "startTimeCode") == 4 &&
           metadata(&layer, "endTimeCode") == 8 && metadata(&layer, "framesPerSecond") == 24 &&
           metadata(&layer, "metersPerUnit") == 1,
       "its metadata");
    ok(spin_usd_entry(&spin_usd_field(layer.root.metadata, "customLayerData")->value, "antialias",
                      &flag) == SPIN_OK &&
           flag.layer,
       "the antialiasing mark");
    good = numbers(&layer, "/Splats", "positions", 6, 3, v) == 40;
    near(v[3], 0.5, 1e-9, "the second position at the second time code");
    good =
        good && numbers(&layer, "/Splats", half ? "orientationsh" : "orientations", 4, 4, v) == 40;
    near(v[4], (double)clip[0].quats[4] * (clip[0].quats[4] < 0 ? -1 : 1), half ? 1e-3 : 1e-7,
         "w is the first number of a rotation");
    good = good && numbers(&layer, "/Splats", half ? "opacitiesh" : "opacities", 9, 1, v) == 40;
    near(v[2], 1 / (1 + exp(-(double)clip[0].logit_opacities[2])), half ? 1e-3 : 1e-7, "opacity");
    good = good && numbers(&layer, "/Splats", half ? "scalesh" : "scales", 0, 3, v) == 40 &&
           numbers(&layer, "/Splats", "extent", 8, 3, v) == 2;
    ok(good, "arrays of all splats");
    ok(spin_usd_field(spin_usd_prim_at(&layer, "/Splats")->attribute, "positions")->n_samples ==
               3 &&
           spin_usd_field(spin_usd_prim_at(&layer, "/Splats")->attribute,
                          half ? "scalesh" : "scales")
                   ->n_samples == 0,
       "only what changes has samples");
    ok(text_is(spin_usd_prim_at(&layer, "/Splats")->attribute, "colorSpace:name",
               "srgb_rec709_scene"),
       "the colour space");
    if (strstr(name, ".usdc"))
        test_package(&job, &map);
    spin_usd_close(&layer);
    spin_map_close(&map);
}

/* The cameras of test_cameras() in one file. */
static void test_file_cameras(struct spin_export_job *job, const char *name)
{
    static const double second[16] = {0, -1, 0, 0, 0, 0, 1, 0, -1, 0, 0, 0, 2, -2, -3, 1};
    struct spin_usd_layer layer = {.size = 0};
    struct spin_map map;
    double v[160] = {0};

    job->output = in_folder(name);
    if (!ok(run_clip(job) && spin_map_open(job->output, &map) == SPIN_OK &&
                spin_usd_open(map.data, map.size, &layer) == SPIN_OK,
            "%s with cameras: %s", name, spin_last_error()))
        return;
    ok(numbers(&layer, "/Cameras/cam_07", "xformOp:transform", 6, 16, v) == 1, "a moving camera");
    for (int k = 0; k < 16; k++)
        near(v[k], second[k], 1e-9, "its matrix at the second time code");
    ok(spin_usd_field(spin_usd_prim_at(&layer, "/Cameras/cam_00")->attribute, "xformOp:transform")
               ->n_samples == 0,
       "a static one has no samples");
    ok(numbers(&layer, "/Cameras/cam_00", "focalLength", 0, 1, v) == 1 && v[0] == 45 &&
           numbers(&layer, "/Cameras/cam_00", "verticalApertureOffset", 0, 1, v + 1) == 1 &&
           fabs(v[1] - 3.6) < 1e-6 &&
           spin_usd_field(spin_usd_prim_at(&layer, "/Cameras/path")->attribute, "xformOpOrder"),
       "the lens, and the path");
    spin_usd_close(&layer);
    spin_map_close(&map);
}

/* Cameras of a rig, of which one moves; a path. Right, up and back in the file's axes, rows of the
 * matrix. */
static void test_cameras(void)
{
    static const int rows[] = {0, 1, 2};
    char path[4200];
    const char *pairs[] = {"path", path, "meters-per-unit", "0.25", NULL};
    struct spin_plugin_values values = {pairs};
    struct spin_views views = {0};
    struct spin_export_job job = {.output = in_folder("cameras"),
                                  .n_frames = 3,
                                  .stride = 2,
                                  .force = true,
                                  .views = &views,
                                  .dataset_frame_of = rows,
                                  .values = &values};
    FILE *file;
    char *text;

    snprintf(path, sizeof path, "%s", in_folder("path.txt"));
    file = fopen(path, "w");
    fputs("1 0 0 1 0 1 0 2 0 0 1 3\n0 0 1 4 0 1 0 5 -1 0 0 6\n", file);
    fclose(file);
    for (int f = 0; f < 3; f++)
        for (int k = 0; k < 2; k++) {
            struct spin_view v = {.dataset_frame = f, .camera_id = 7 * k, .path = path};
            double m[12] = {0, 1, 0, -2, 0, 0, 1, -3, 1, 0, 0, -1 - (k ? f : 0)};

            v.camera = (struct spin_camera){400, 200, 500, 250, 190, 120, {0}, 0};
            memcpy(v.camera.w2c, m, sizeof m);
            if (spin_views_add(&views, &v) != SPIN_OK)
                exit(1);
        }
    if (!ok(run_clip(&job), "writes a stage with cameras: %s", spin_last_error()))
        return;
    text = slurp(in_folder("cameras/clip.usda"));
    ok(strstr(text, "    metersPerUnit = 0.25\n") && strstr(text, "def Scope \"Cameras\""),
       "metres of a unit");
    /* of 36: focal length 36 * 500 / 400, height 45 * 200 / 250; centre 10 pixels left of the
     * middle, 20 below */
    ok(strstr(text,
              "float focalLength = 45\n        float horizontalAperture = 36\n"
              "        float horizontalApertureOffset = 0.9\n        float verticalAperture = 36\n"
              "        float verticalApertureOffset = 3.6\n") != NULL,
       "the lens");
    /* it stands at (1, 2, 3), looks along x, its right is y and its down z; the file has y and z
     * turned */
    ok(strstr(text, "def Camera \"cam_00\"") &&
           strstr(text, "xformOp:transform = ((0, -1, 0, 0), (0, 0, 1, 0), (-1, 0, 0, 0), "
                        "(1, -2, -3, 1))\n"),
       "a camera that stands");
    ok(strstr(text, "def Camera \"cam_07\"") &&
           strstr(text,
                  "xformOp:transform.timeSamples = {\n            4: ((0, -1, 0, 0), (0, 0, 1, 0), "
                  "(-1, 0, 0, 0), (1, -2, -3, 1)),\n            6: ((0, -1, 0, 0), (0, 0, 1, 0), "
                  "(-1, 0, 0, 0), (2, -2, -3, 1)),\n"),
       "one that moves, at the time codes of its frames");
    ok(strstr(text, "def Camera \"path\"") &&
           strstr(text,
                  "            4: ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (1, -2, -3, 1)),\n"
                  "            7: ((0, 0, 1, 0), (0, 1, 0, 0), (-1, 0, 0, 0), (4, -5, -6, 1)),\n"),
       "the path, at even times in the clip");
    free(text);
    test_file_cameras(&job, "cameras.usdc");
    test_file_cameras(&job, "cameras.usda");
    spin_views_free(&views);
}

static void test_edges(void)
{
    struct spin_export_job job = {
        .output = in_folder("edges"), .n_frames = 1, .force = true, .sh_degree = 3};
    struct spin_splats s = {0};
    double time, *v;
    char *text;

    make_frame(&s, 14, 3, 2);
    s.logit_opacities[1] = INFINITY;
    ok(run(&spin_exporter_usd, &job, &s, 0) == SPIN_OK, "writes an infinite logit");
    text = slurp(in_folder("edges/frame_00000.usda"));
    ok(samples(text, "point3f[] positions", 3, &time, &v) == 3 * 14 &&
           strstr(text, "int splats = 14\n") && !strstr(text, "nan") && !strstr(text, "inf"),
       "as a finite one");
    free(text);
    free(v);
    make_frame(&s, 0, 3, 2);
    ok(run(&spin_exporter_usd, &job, &s, 0) == SPIN_OK, "writes an empty frame");
    text = slurp(in_folder("edges/frame_00000.usda"));
    ok(samples(text, "point3f[] positions", 3, &time, &v) == 0, "it is empty");
    free(text);
    free(v);
    spin_splats_free(&s);
}

TAP_MAIN
{
    static const char *const bad[][2] = {
        {"axes", "gltf"}, {"pattern", "a@%d.usda"}, {"fps", "0"}, {"sh", "4"}};

    spin_log_set_level(-2);
    test_values(0, "keep", 0, 0, "usd");
    test_values(3, "keep", 3, 0, "usd");
    test_values(1, "2", 2, 0, "source");
    test_values(2, "1", 1, 1, "usd");
    test_stage();
    test_stride(10, NULL, 10, 30);
    test_stride(0, NULL, 10, 30);
    test_stride(10, "5", 5, 15);
    test_still();
    for (int half = 0; half < 2; half++) {
        test_file("clip.usdc", half);
        test_file("clip.usda", half);
    }
    test_cameras();
    test_edges();
    n_more = 2; /* clip.usda and manifest.usda */
    check_folder_rules(&spin_exporter_usd, "frame_00001.usda", bad, sizeof bad / sizeof bad[0]);
}
