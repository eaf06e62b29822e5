/* K: usd export threads
 * Stages of USD, read by a reader of their text that is written here, and held to what OpenUSD's schema and the
 * published rules of validation ask: required attributes, lengths, ranges. */
#include "base/log.h"
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

/* The samples of an attribute "TYPE NAME": one time, [tuples of `group`]; how many numbers, or -1 when the text is
 * not of that form. out: allocated. */
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

static int all_within(const double *v, long n, double least, double most)
{
    for (long i = 0; i < n; i++)
        if (!(v[i] >= least && v[i] <= most))
            return 0;
    return 1;
}

/* Values of degree n are of one sign, or of the other, when the scene is turned half about x. */
static const char sh_signs[] = "+--+-++-+-+--+-+";

static void test_values(int degree, const char *sh, int to, int half, const char *axes)
{
    const char *pairs[] = {
        "sh", sh, "axes", axes, "fps", "24", half ? "half" : "fps", half ? NULL : "24", NULL, NULL};
    struct spin_plugin_values values = {pairs};
    struct spin_export_job job = {.output = in_folder("v"),
                                  .n_frames = 1,
                                  .force = true,
                                  .sh_degree = degree,
                                  .values = &values};
    size_t n = 9000, n_sh = (size_t)((to + 1) * (to + 1)),
           n_from = (size_t)((degree + 1) * (degree + 1));
    double *place, *q, *scale, *opacity, *coef, *extent, time[6], relative = half ? 5.1e-4 : 1e-7;
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
            double reach =
                3 * exp(fmax(fmax(want.log_scale[0], want.log_scale[1]), want.log_scale[2]));
            double was = exp(want.log_scale[c]);

            good[2] &= fabs(place[3 * i + c] - want.place[c]) < 1e-6;
            good[3] &= fabs(scale[3 * i + c] - was) < was * (relative + 1e-6) + (half ? 6e-8 : 0);
            good[5] &= extent[c] <= place[3 * i + c] - reach + 1e-5 &&
                       extent[3 + c] >= place[3 * i + c] + reach - 1e-5;
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
    free(text);
    free(place);
    free(q);
    free(scale);
    free(opacity);
    free(coef);
    free(extent);
    spin_splats_free(&s);
}

/* Every third frame of a clip of 30 frames a second, or of a second that nobody knows, plays as fast as all of them. */
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

static void test_edges(void)
{
    struct spin_export_job job = {
        .output = in_folder("edges"), .n_frames = 1, .force = true, .sh_degree = 3};
    struct spin_splats s = {0};
    double time, *v;
    char *text;

    make_frame(&s, 20, 3, 2);
    spoil_frame(&s);
    ok(run(&spin_exporter_usd, &job, &s, 0) == SPIN_OK, "writes rows that cannot be drawn");
    text = slurp(in_folder("edges/frame_00000.usda"));
    ok(samples(text, "point3f[] positions", 3, &time, &v) == 3 * 14 &&
           strstr(text, "int splats = 14\n") && !strstr(text, "nan") && !strstr(text, "inf"),
       "leaves out the six");
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
    static const char *const bad[][2] = {{"axes", "gltf"},
                                         {"pattern", "a@%d.usda"},
                                         {"fps", "0"},
                                         {"sh", "4"},
                                         {"min-opacity", "x"}};

    spin_log_set_level(-2);
    test_values(0, "keep", 0, 0, "usd");
    test_values(3, "keep", 3, 0, "usd");
    test_values(1, "2", 2, 0, "source");
    test_values(2, "1", 1, 1, "usd");
    test_stage();
    test_stride(10, NULL, 10, 30);
    test_stride(0, NULL, 10, 30);
    test_stride(10, "5", 5, 15);
    test_edges();
    n_more = 2; /* clip.usda and manifest.usda */
    check_folder_rules(&spin_exporter_usd, "frame_00001.usda", bad, sizeof bad / sizeof bad[0]);
}
