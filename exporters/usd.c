/* One USD stage of ParticleField3DGaussianSplat (the schema of OpenUSD 26.03): OUT/clip.usda, which plays one
 * layer per frame by value clips. Text, so that no library is needed.
 *
 * Value clips and not time samples in one file: a reader opens the layer of the frame that it shows, while a text
 * of all frames would have to be parsed as a whole, gigabytes for a minute. Each layer holds the time samples of its
 * frame under the prim's own path, so that it also opens alone.
 *
 * Facts from OpenUSD's schema and its guide to value clips: scales are standard deviations, opacities 0 to 1,
 * orientations w x y z, SH one float3 a coefficient, splat by splat. The axes are x right, y up, z back: half a turn
 * about x from those of the training. */
#include <stdlib.h>
#include <string.h>

#include "exporters/lib/frames.h"
#include "base/mem.h"
#include "base/option.h"
#include "math/ntc.h"
#include "math/sh.h"

#define DEFAULT_FPS 30
#define BATCH 8          /* blocks of rows made at a time */
#define NUMBER 16        /* characters of a number at most, with what stands between */
#define MAX_FLOATS 48    /* of an attribute of one row */
#define LEAST_HALF 6e-8f /* the smallest half above 0 */
#define MOST_HALF 65504.0f
#define PRIM "Splats"

static const struct spin_plugin_option options[] = {
    SPIN_FRAMES_OPTIONS("frame_%05d.usda"),
    SPIN_ROWS_OPTION_SH,
    SPIN_FRAMES_OPTION_FPS,
    {"axes", "usd|source", "axes to write without --up; usd: x right, y up, half a turn about x",
     "usd"},
    {"half", NULL, "half floats for all but the places: smaller, three digits", NULL},
    {0},
};

enum attribute { POSITIONS, ORIENTATIONS, SCALES, OPACITIES, SH, ATTRIBUTES };

struct form {
    const char *type, *name, *type_half, *name_half; /* of half floats; NULL: never */
};

static const struct form forms[ATTRIBUTES] = {
    {"point3f[]", "positions", NULL, NULL},
    {"quatf[]", "orientations", "quath[]", "orientationsh"},
    {"float3[]", "scales", "half3[]", "scalesh"},
    {"float[]", "opacities", "half[]", "opacitiesh"},
    {"float3[]", "radiance:sphericalHarmonicsCoefficients", "half3[]",
     "radiance:sphericalHarmonicsCoefficientsh"},
};

struct export
{
    struct spin_frames frames;
    double codes; /* of time from one frame to the next */
    bool half;

    /* The batch at hand. */
    enum attribute attribute;
    size_t first;                 /* block */
    char *text;                   /* [BATCH][rows of a block * floats * NUMBER] */
    size_t n_text[BATCH], stride; /* characters there are; there is room for */
};

/* ---- Numbers --------------------------------------------------------------------------------- */

static float as_half(float v, float least)
{
    float h = spin_half(v);

    return h < least ? least : h > MOST_HALF ? MOST_HALF : h;
}

static bool is_half(const struct export *x) { return x->half && forms[x->attribute].type_half; }

/* The values of a row, groups of `group`; what a reader loses is counted. */
static size_t take_row(const struct export *x, size_t i, float out[MAX_FLOATS], size_t *group,
                       struct spin_quant_error *quant)
{
    const struct spin_splat_filter *rows = &x->frames.rows;
    size_t n_sh = 3 * (size_t)spin_splat_filter_n_sh(rows);
    size_t n = 3 * (size_t)spin_sh_count(rows->sh_degree);
    struct spin_gaussian is, shown;
    float room[3 * SPIN_SH_MAX], lost[MAX_FLOATS];

    spin_splat_filter_take(rows, i, &is);
    shown = is;
    *group = 3;
    switch (x->attribute) {
    case POSITIONS:
        memcpy(out, is.place, sizeof is.place);
        spin_quant_error_add_place(quant, is.place, out);
        return 3;
    case ORIENTATIONS:
        for (int k = 0; k < 4; k++)
            out[k] = is_half(x) ? spin_half(is.rotation[k]) : is.rotation[k];
        spin_unit_rotation(out, shown.rotation);
        spin_quant_error_add_rotation(quant, is.rotation, shown.rotation);
        *group = 4;
        return 4;
    case SCALES:
        for (int c = 0; c < 3; c++) {
            out[c] = expf(is.log_scale[c]);
            if (is_half(x))
                out[c] = as_half(out[c], LEAST_HALF);
            shown.log_scale[c] = logf(out[c]);
        }
        spin_quant_error_add_3(quant, SPIN_QUANT_SCALE, is.log_scale, shown.log_scale);
        return 3;
    case OPACITIES:
        out[0] = is_half(x) ? spin_half(is.opacity) : is.opacity;
        spin_quant_error_add(quant, SPIN_QUANT_OPACITY, (double)is.opacity - (double)out[0]);
        *group = 1;
        return 1;
    default:
        memset(out, 0, n * sizeof *out);
        memcpy(out, spin_splat_filter_sh(rows, i, room), n_sh * sizeof *out);
        for (size_t k = 0; k < n; k++) {
            float v = out[k];

            out[k] = is_half(x) ? as_half(v, -MOST_HALF) : v;
            lost[k] = v - out[k];
        }
        spin_quant_error_add_all(quant, SPIN_QUANT_SH, lost + 3, n - 3);
        for (size_t c = 0; c < 3; c++)
            spin_quant_error_add(quant, SPIN_QUANT_COLOUR, SPIN_SH_C0 * (double)lost[c]);
        return n;
    }
}

/* "(1,2,3)" for each group, with commas between. */
static char *print_row(const struct export *x, size_t i, bool first, char *to,
                       struct spin_quant_error *quant)
{
    const char *format = is_half(x) ? "%.5g" : "%.9g";
    float value[MAX_FLOATS];
    size_t group, n = take_row(x, i, value, &group, quant);

    for (size_t k = 0; k < n; k++) {
        if (k > 0 || !first)
            *to++ = ',';
        if (group > 1 && k % group == 0)
            *to++ = '(';
        to += sprintf(to, format, (double)value[k]);
        if (group > 1 && k % group == group - 1)
            *to++ = ')';
    }
    return to;
}

static void print_block(void *context, int task, int worker)
{
    struct export *x = context;
    const struct spin_splat_filter *rows = &x->frames.rows;
    size_t b = x->first + (size_t)task, i = b * SPIN_ROWS_BLOCK, end = i + SPIN_ROWS_BLOCK;
    char *begin = x->text + (size_t)task * x->stride, *to = begin;
    bool first = spin_splat_filter_before(rows, b) == 0;

    (void)worker;
    for (end = end < rows->splats->n ? end : rows->splats->n; i < end; i++) {
        if (!rows->keep[i])
            continue;
        to = print_row(x, i, first, to, &x->frames.block_quant[b]);
        first = false;
    }
    x->n_text[task] = (size_t)(to - begin);
    spin_splat_filter_rest(rows, b, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES);
}

/* ---- A layer --------------------------------------------------------------------------------- */

static spin_status put(struct spin_out *out, const char *text)
{
    return spin_out_write(out, text, strlen(text));
}

static const char *type_of(const struct export *x, enum attribute a)
{
    return x->half && forms[a].type_half ? forms[a].type_half : forms[a].type;
}

static const char *name_of(const struct export *x, enum attribute a)
{
    return x->half && forms[a].type_half ? forms[a].name_half : forms[a].name;
}

static spin_status write_attribute(struct export *x, enum attribute a, int number,
                                   struct spin_out *out)
{
    const struct spin_splat_filter *rows = &x->frames.rows;
    size_t n_blocks = spin_splat_filter_blocks(rows);
    char head[160];

    x->attribute = a;
    snprintf(head, sizeof head, "    %s %s.timeSamples = {\n        %d: [", type_of(x, a),
             name_of(x, a), number);
    SPIN_TRY(put(out, head));
    for (x->first = 0; x->first < n_blocks; x->first += BATCH) {
        size_t n = n_blocks - x->first < BATCH ? n_blocks - x->first : BATCH;

        spin_pool_run(rows->pool, (int)n, print_block, x);
        for (size_t b = 0; b < n; b++)
            SPIN_TRY(spin_out_write(out, x->text + b * x->stride, x->n_text[b]));
    }
    return put(out, "],\n    }\n");
}

/* The box of the ellipsoids at three standard deviations of their longest axis. */
static void find_extent(const struct export *x, float extent[6])
{
    const struct spin_splat_filter *rows = &x->frames.rows;
    bool any = false;
    float place[3];

    memset(extent, 0, 6 * sizeof *extent);
    for (size_t i = 0; i < rows->splats->n; i++) {
        const float *scale = rows->splats->log_scales + 3 * i;
        float reach;

        if (!rows->keep[i])
            continue;
        reach = 3 * expf(spin_maxf(spin_maxf(scale[0], scale[1]), scale[2]));
        spin_splat_filter_place(rows, i, place);
        for (int c = 0; c < 3; c++) {
            extent[c] = any ? spin_minf(extent[c], place[c] - reach) : place[c] - reach;
            extent[3 + c] = any ? spin_maxf(extent[3 + c], place[c] + reach) : place[c] + reach;
        }
        any = true;
    }
}

/* What a layer begins with. */
static void print_head(const struct export *x, int first, int last, FILE *to)
{
    fprintf(to,
            "#usda 1.0\n(\n    defaultPrim = \"" PRIM "\"\n    doc = \"Generated by spin4d %s\"\n"
            "    endTimeCode = %d\n    framesPerSecond = %.9g\n    metersPerUnit = 1\n"
            "    startTimeCode = %d\n    timeCodesPerSecond = %.9g\n    upAxis = \"Y\"\n)\n\n",
            SPIN_VERSION, last, x->frames.fps, first, x->frames.fps * x->codes);
}

static void print_degree(const struct export *x, FILE *to)
{
    fprintf(to, "    uniform int radiance:sphericalHarmonicsDegree = %d\n",
            x->frames.rows.sh_degree);
}

/* The very beginning of the layer of a frame of n splats, allocated with malloc. */
static spin_status layer_head(const struct export *x, int number, size_t n, char **text,
                              size_t *n_text)
{
    FILE *to = open_memstream(text, n_text);

    if (!to)
        return spin_fail(SPIN_E_MEMORY, "no memory for a layer of USD");
    print_head(x, number, number, to);
    fprintf(to,
            "def ParticleField3DGaussianSplat \"" PRIM "\" (\n    customData = {\n"
            "        int splats = %zu\n    }\n)\n{\n",
            n);
    print_degree(x, to);
    return fclose(to) == 0 ? SPIN_OK : spin_fail(SPIN_E_MEMORY, "no memory for a layer of USD");
}

static spin_status usd_write(void *self, const struct spin_frame_info *info, struct spin_out *out)
{
    struct export *x = self;
    size_t n_sh = 3 * (size_t)spin_sh_count(x->frames.rows.sh_degree), n_head;
    char *head = NULL, line[256];
    float e[6];
    spin_status status;

    if (!x->text) {
        x->stride = (size_t)SPIN_ROWS_BLOCK * (n_sh > 4 ? n_sh : 4) * (NUMBER + 1);
        SPIN_TRY(spin_grow(BATCH, x->stride, (void **)&x->text));
    }
    SPIN_TRY(layer_head(x, info->number, x->frames.rows.n_kept, &head, &n_head));
    status = spin_out_write(out, head, n_head);
    free(head);
    SPIN_TRY(status);
    find_extent(x, e);
    snprintf(line, sizeof line,
             "    float3[] extent.timeSamples = {\n"
             "        %d: [(%.9g, %.9g, %.9g), (%.9g, %.9g, %.9g)],\n    }\n",
             info->number, (double)e[0], (double)e[1], (double)e[2], (double)e[3], (double)e[4],
             (double)e[5]);
    SPIN_TRY(put(out, line));
    for (int a = 0; a < ATTRIBUTES; a++)
        SPIN_TRY(write_attribute(x, (enum attribute)a, info->number, out));
    return put(out, "}\n");
}

static uint64_t usd_bytes(const void *self, size_t n)
{
    const struct export *x = self;

    return 2048 +
           (uint64_t)n * NUMBER * (11 + 3 * (uint64_t)spin_sh_count(x->frames.rows.sh_degree));
}

/* ---- The stage ------------------------------------------------------------------------------- */

/* Attributes that the clips bring, declared without a value. */
static void print_attributes(const struct export *x, FILE *to)
{
    fprintf(to, "    float3[] extent\n");
    for (int a = 0; a < ATTRIBUTES; a++)
        fprintf(to, "    %s %s\n", type_of(x, (enum attribute)a), name_of(x, (enum attribute)a));
}

static spin_status print_clips(const struct export *x, FILE *to)
{
    const struct spin_frames *f = &x->frames;

    fprintf(to, "    clips = {\n        dictionary default = {\n            double2[] active = [");
    for (size_t i = 0; i < f->n_entries; i++)
        fprintf(to, "%s(%d, %zu)", i ? ", " : "", f->entry[i].number, i);
    fprintf(to, "]\n            asset[] assetPaths = [");
    for (size_t i = 0; i < f->n_entries; i++) {
        char *path = NULL;

        SPIN_TRY(spin_pattern_path(&f->pattern, f->folder.path, f->entry[i].number, &path));
        fprintf(to, "%s@./%s@", i ? ", " : "", spin_path_name(path));
        free(path);
    }
    fprintf(to, "]\n            asset manifestAssetPath = @./manifest.usda@\n"
                "            string primPath = \"/" PRIM "\"\n            double2[] times = [");
    for (size_t i = 0; i < f->n_entries; i++)
        fprintf(to, "%s(%d, %d)", i ? ", " : "", f->entry[i].number, f->entry[i].number);
    fprintf(to, "]\n        }\n    }\n");
    return SPIN_OK;
}

static spin_status write_stage(struct export *x, bool manifest)
{
    int first = x->frames.n_entries ? x->frames.entry[0].number : 0;
    int last = x->frames.n_entries ? x->frames.entry[x->frames.n_entries - 1].number : 0;
    char *text = NULL;
    size_t n;
    FILE *to = open_memstream(&text, &n);
    spin_status status = SPIN_OK;

    if (!to)
        return spin_fail(SPIN_E_MEMORY, "no memory for a stage of USD");
    if (manifest) {
        fprintf(to, "#usda 1.0\n\nover \"" PRIM "\"\n{\n");
    } else {
        print_head(x, first, last, to);
        fprintf(to, "def ParticleField3DGaussianSplat \"" PRIM "\" (\n");
        status = print_clips(x, to);
        fprintf(to, ")\n{\n");
        print_degree(x, to);
    }
    print_attributes(x, to);
    fprintf(to, "}\n");
    if (fclose(to) != 0)
        status = spin_fail(SPIN_E_MEMORY, "no memory for a stage of USD");
    if (status == SPIN_OK)
        status = spin_frames_write_text(&x->frames, manifest ? "manifest.usda" : "clip.usda", text);
    free(text);
    return status;
}

static spin_status usd_finish(void *self)
{
    SPIN_TRY(write_stage(self, true));
    return write_stage(self, false);
}

/* ---- The plug-in ----------------------------------------------------------------------------- */

static spin_status begin(void *self, const struct spin_export_job *job)
{
    static const double half_about_x[4] = {0, 1, 0, 0};
    const struct spin_plugin_values *v = job->values;
    struct export *x = self;
    int axes;

    SPIN_TRY(spin_option_word(v, "axes", "usd|source", &axes));
    if (strpbrk(spin_plugin_value(v, "pattern", ""), "@"))
        return spin_fail(SPIN_E_USAGE, "--pattern: '@' ends the name of a file in USD");
    x->frames.axes = axes == 0 ? half_about_x : NULL;
    x->codes = job->stride > 0 ? job->stride : 1;
    x->frames.fps = job->fps > 0 ? job->fps : DEFAULT_FPS / x->codes;
    x->half = spin_plugin_value(v, "half", NULL) != NULL;
    return SPIN_OK;
}

static spin_status usd_end(void *self)
{
    struct export *x = self;

    if (x->half)
        spin_quant_error_say(&x->frames.quant, "usd");
    return spin_frames_end(x);
}

static void end(void *self) { free(((struct export *)self)->text); }

static const struct spin_frames_format format = {
    .name = "usd",
    .pattern = "frame_%05d.usda",
    .self_bytes = sizeof(struct export),
    .packed = true,
    .begin = begin,
    .bytes = usd_bytes,
    .write = usd_write,
    .finish = usd_finish,
    .end = end,
};

static spin_status usd_begin(const struct spin_export_job *job, void **self)
{
    return spin_frames_begin(&format, job, self);
}

extern const struct spin_exporter spin_exporter_usd;
const struct spin_exporter spin_exporter_usd = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "usd",
    .summary = "a stage of USD (26.03) in a folder, one layer per frame, played by value clips",
    .options = options,
    .wants = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES,
    .begin = usd_begin,
    .frame = spin_frames_frame,
    .end = usd_end,
    .abort = spin_frames_abort,
};
