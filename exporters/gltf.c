/* glTF 2.0 with KHR_gaussian_splatting (Khronos, release candidate of 2026): one .glb per frame in a
 * folder, or, when the output's name ends in .glb, one file with the whole clip.
 *
 * glTF has no vertex data that changes with time, so the clip is a node per frame, and an animation
 * that switches them: STEP keys on their scale, 1 while a frame is shown and else 0. A key after the
 * last frame repeats its value, or players would cut it.
 *
 * Against 3D Gaussian Splatting: quaternions are x y z w, scales and opacities are finished (after
 * exp and sigmoid), one accessor holds one SH coefficient. glTF's axes are x left, y up, z forward;
 * those of a camera's world x right, y down, z forward. Half a turn about z brings one to the other:
 * x and y change sign, the quaternion is multiplied by (0, 0, 0, 1) on the left, SH coefficients of
 * odd order change sign.
 *
 * COLOR_0 is for viewers that do not know the extension and draw points: linear light.
 *
 * Attributes lie one after the other in the file, splats in memory; blocks of rows are taken apart
 * and each piece is written to its place, so that a frame is never held twice. */
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/mem.h"
#include "exporters/frames.h"
#include "exporters/quant.h"
#include "io/gltf.h"

#define EXTENSION "KHR_gaussian_splatting"
#define DEFAULT_FPS 30
#define MAX_ATTRIBUTES (4 + SPIN_SH_MAX + 1)
#define BLOCK 4096
#define MAX_ROW (4 * (3 + 4 + 3 + 1 + 3 * SPIN_SH_MAX) + 8)

static const struct spin_plugin_option options[] = {
    SPIN_FRAMES_OPTION_PATTERN("frame_%05d.glb"),
    SPIN_FRAMES_OPTION_SH,
    SPIN_FRAMES_OPTION_MIN_OPACITY,
    {"axes", "gltf|source", "axes to write; gltf: x left, y up, z forward, half a turn about z",
     "gltf"},
    {"fps", "F", "frames a second of a clip in one file; otherwise the bundle's, else 30", NULL},
    {"no-fallback", NULL, "leave out COLOR_0, for viewers that draw plain points", NULL},
    {0},
};

struct export
{
    struct spin_frames frames; /* of one per file; its rows serve both */
    bool single;               /* all in one file */
    struct spin_glb glb;       /* that file */
    const char *extras[5];
    double fps;
    bool turned;
    int sh_degree; /* written */
    int n_attributes;
    struct spin_gltf_attribute attribute[MAX_ATTRIBUTES];
    char name[SPIN_SH_MAX][64];
    int n_frames, n_done;          /* of a single file */
    struct spin_gltf_frame *frame; /* [n_frames] */
    uint64_t n_bytes;              /* of the binary chunk so far */
    unsigned char *column[MAX_ATTRIBUTES];
    _Alignas(8) unsigned char block[BLOCK * MAX_ROW];
};

/* ---- Attributes ------------------------------------------------------------------------------ */

static size_t width_of(const struct spin_gltf_attribute *a)
{
    return (size_t)a->n_components * (a->component == SPIN_GLTF_F32 ? 4 : 2);
}

static void add_attribute(struct export *x, const char *name, int n_components,
                          enum spin_gltf_component component)
{
    x->attribute[x->n_attributes++] =
        (struct spin_gltf_attribute){name, n_components, component, component != SPIN_GLTF_F32};
}

static void list_attributes(struct export *x, bool fallback)
{
    int k = 0;

    add_attribute(x, "POSITION", 3, SPIN_GLTF_F32);
    add_attribute(x, EXTENSION ":ROTATION", 4, SPIN_GLTF_F32);
    add_attribute(x, EXTENSION ":SCALE", 3, SPIN_GLTF_F32);
    add_attribute(x, EXTENSION ":OPACITY", 1, SPIN_GLTF_F32);
    for (int l = 0; l <= x->sh_degree; l++) {
        for (int m = 0; m < 2 * l + 1; m++, k++) {
            snprintf(x->name[k], sizeof x->name[k], EXTENSION ":SH_DEGREE_%d_COEF_%d", l, m);
            add_attribute(x, x->name[k], 3, SPIN_GLTF_F32);
        }
    }
    if (fallback)
        add_attribute(x, "COLOR_0", 4, SPIN_GLTF_U16);
}

/* Pieces of the block, one per attribute. */
static void divide_block(struct export *x)
{
    unsigned char *at = x->block;

    for (int a = 0; a < x->n_attributes; a++) {
        x->column[a] = at;
        at += BLOCK * width_of(&x->attribute[a]);
    }
}

static struct spin_gltf_clip describe(const struct export *x, const struct spin_gltf_frame *frame,
                                      int n_frames)
{
    static const char *const values[] = {"kernel", "ellipse", "colorSpace", "srgb_rec709_display",
                                         NULL};

    return (struct spin_gltf_clip){
        .generator = "spin4d " SPIN_VERSION,
        .extras = x->extras,
        .fps = x->fps,
        .extension = EXTENSION,
        .extension_values = values,
        .attribute = x->attribute,
        .n_attributes = x->n_attributes,
        .frame = frame,
        .n_frames = n_frames,
        .animated = x->single && n_frames > 1,
        .n_bytes = x->n_bytes,
    };
}

/* ---- Rows ------------------------------------------------------------------------------------ */

static void turn_row(struct spin_quant_row *row)
{
    float w = row->rotation[0], qx = row->rotation[1], y = row->rotation[2], z = row->rotation[3];

    row->place[0] = -row->place[0];
    row->place[1] = -row->place[1];
    row->rotation[0] = -z;
    row->rotation[1] = -y;
    row->rotation[2] = qx;
    row->rotation[3] = w;
}

static uint16_t u16_of(float x) { return (uint16_t)(spin_minf(spin_maxf(x, 0), 1) * 65535 + 0.5f); }

/* The curve of sRGB (IEC 61966-2-1), undone. */
static float linear_of(float x)
{
    return x <= 0.04045f ? x / 12.92f : powf((x + 0.055f) / 1.055f, 2.4f);
}

static void put_sh(struct export *x, const float *sh, int n_from, size_t at)
{
    /* Of odd order: those that change sign in half a turn about z. */
    static const float turned[SPIN_SH_MAX] = {1, -1, 1, -1, 1, -1, 1, -1,
                                              1, -1, 1, -1, 1, -1, 1, -1};
    int n = spin_sh_count(x->sh_degree);

    for (int k = 0; k < n; k++) {
        float *out = (float *)(void *)x->column[4 + k] + 3 * at;
        float sign = x->turned ? turned[k] : 1;

        for (int c = 0; c < 3; c++)
            out[c] = k < n_from ? sign * sh[3 * k + c] : 0;
    }
}

/* Row i of the frame to row `at` of the block. */
static void put_row(struct export *x, const struct spin_splats *s, size_t i, size_t at)
{
    int n_from = spin_sh_count(s->sh_degree), n = spin_sh_count(x->sh_degree);
    struct spin_quant_row row;
    float *rotation = (float *)(void *)x->column[1] + 4 * at;
    float *scale = (float *)(void *)x->column[2] + 3 * at;
    uint16_t *colour = (uint16_t *)(void *)x->column[x->n_attributes - 1] + 4 * at;

    spin_quant_take(s, i, &row);
    if (x->turned)
        turn_row(&row);
    memcpy(x->column[0] + 12 * at, row.place, sizeof row.place);
    for (int k = 0; k < 4; k++)
        rotation[k] = row.rotation[(k + 1) % 4];
    for (int c = 0; c < 3; c++)
        scale[c] = expf(row.log_scale[c]);
    memcpy(x->column[3] + 4 * at, &row.opacity, sizeof row.opacity);
    put_sh(x, s->sh + i * 3 * (size_t)n_from, n_from, at);
    if (x->n_attributes == 4 + n)
        return;
    for (int c = 0; c < 3; c++)
        colour[c] = u16_of(linear_of(spin_minf(spin_maxf(row.colour[c], 0), 1)));
    colour[3] = u16_of(row.opacity);
}

/* Two bytes of COLOR_0 at a time, four of the others. */
static void to_little_endian(struct export *x, size_t n)
{
#if __BYTE_ORDER__ == __ORDER_BIG_ENDIAN__
    for (int a = 0; a < x->n_attributes; a++) {
        size_t n_words = n * width_of(&x->attribute[a]) / 4;
        uint16_t *half = (uint16_t *)(void *)x->column[a];

        if (x->attribute[a].component == SPIN_GLTF_F32)
            spin_rows_little_endian(x->column[a], n_words);
        for (size_t i = 0; x->attribute[a].component == SPIN_GLTF_U16 && i < 2 * n_words; i++)
            half[i] = __builtin_bswap16(half[i]);
    }
#else
    (void)x;
    (void)n;
#endif
}

/* Rows first .. first + n of the frame, each attribute to its place. */
static spin_status write_block(struct export *x, struct spin_glb *glb,
                               const struct spin_gltf_frame *frame, uint64_t first, size_t n)
{
    uint64_t at = frame->offset;

    to_little_endian(x, n);
    for (int a = 0; a < x->n_attributes; a++) {
        size_t width = width_of(&x->attribute[a]);

        SPIN_TRY(spin_glb_write(glb, at + first * width, x->column[a], n * width));
        at += frame->n * width;
    }
    return SPIN_OK;
}

static void widen(struct spin_gltf_frame *frame, const float *place)
{
    for (int c = 0; c < 3; c++) {
        frame->low[c] = spin_minf(frame->low[c], place[c]);
        frame->high[c] = spin_maxf(frame->high[c], place[c]);
    }
}

static spin_status write_rows(struct export *x, struct spin_glb *glb, const struct spin_splats *s,
                              struct spin_gltf_frame *frame)
{
    size_t n = 0;
    uint64_t first = 0;

    for (int c = 0; c < 3; c++) {
        frame->low[c] = INFINITY;
        frame->high[c] = -INFINITY;
    }
    for (size_t i = 0; i < s->n; i++) {
        if (x->frames.rows.keep[i]) {
            put_row(x, s, i, n);
            widen(frame, (float *)(void *)x->column[0] + 3 * n++);
        }
        if (n == BLOCK || (n > 0 && i + 1 == s->n)) {
            SPIN_TRY(write_block(x, glb, frame, first, n));
            first += n;
            n = 0;
        }
    }
    return SPIN_OK;
}

/* ---- Files ----------------------------------------------------------------------------------- */

static struct spin_gltf_frame begin_frame(const struct export *x,
                                          const struct spin_frame_info *info, size_t n)
{
    return (struct spin_gltf_frame){
        .n = n, .offset = x->n_bytes, .number = info->number, .time = info->time};
}

static uint64_t bytes_of_row(const struct export *x)
{
    uint64_t sum = 0;

    for (int a = 0; a < x->n_attributes; a++)
        sum += width_of(&x->attribute[a]);
    return sum;
}

static spin_status write_own_file(struct export *x, const struct spin_frame_info *info,
                                  const struct spin_splats *s)
{
    struct spin_gltf_frame frame;
    struct spin_gltf_clip clip;
    struct spin_glb glb;
    char *path = NULL;
    size_t n_kept;
    spin_status status;

    SPIN_TRY(spin_rows_choose(&x->frames.rows, s, info->number, &n_kept));
    SPIN_TRY(spin_pattern_path(&x->frames.pattern, x->frames.folder.path, info->number, &path));
    x->n_bytes = 0;
    frame = begin_frame(x, info, n_kept);
    x->n_bytes = n_kept * bytes_of_row(x);
    clip = describe(x, &frame, 1);
    status = spin_glb_open(path, x->frames.force, &clip, &glb);
    free(path);
    SPIN_TRY(status);
    status = write_rows(x, &glb, s, &frame);
    if (status == SPIN_OK)
        return spin_glb_commit(&glb, &clip);
    spin_glb_abandon(&glb);
    return status;
}

/* All frames of one size would not fit: said before the hours of writing, not after. */
static void warn_if_large(const struct export *x, uint64_t n_bytes)
{
    if (x->n_done == 0 && (double)n_bytes * x->n_frames > (double)UINT32_MAX)
        spin_warn("%d frames like the first are %.1f GB, a .glb ends at 4.3 GB; see --range, --sh "
                  "and --min-opacity, or give a folder",
                  x->n_frames, (double)n_bytes * x->n_frames / 1e9);
}

static spin_status add_to_file(struct export *x, const struct spin_frame_info *info,
                               const struct spin_splats *s)
{
    struct spin_gltf_frame *frame = &x->frame[x->n_done];
    size_t n_kept;

    SPIN_TRY(spin_rows_choose(&x->frames.rows, s, info->number, &n_kept));
    *frame = begin_frame(x, info, n_kept);
    warn_if_large(x, n_kept * bytes_of_row(x));
    SPIN_TRY(write_rows(x, &x->glb, s, frame));
    x->n_bytes += n_kept * bytes_of_row(x);
    x->n_done++;
    return SPIN_OK;
}

/* Key i is at i / fps. A frame's scale is 1 at its own key; the last one's also at the last. */
static spin_status write_keys(struct export *x, uint64_t at)
{
    size_t n = (size_t)x->n_frames + 1;
    float *key = NULL;
    spin_status status;

    SPIN_TRY(spin_alloc(n, 3 * sizeof *key, (void **)&key));
    for (size_t i = 0; i < n; i++)
        key[i] = (float)((double)i / x->fps);
    spin_rows_little_endian(key, n);
    SPIN_TRY_OUT(spin_glb_write(&x->glb, at, key, n * sizeof *key));
    at += n * sizeof *key;
    for (size_t f = 0; f + 1 < n; f++, at += 3 * n * sizeof *key) {
        memset(key, 0, 3 * n * sizeof *key);
        for (int c = 0; c < 3; c++)
            key[3 * f + (size_t)c] = key[3 * (f + (f + 2 == n)) + (size_t)c] = 1;
        spin_rows_little_endian(key, 3 * n);
        SPIN_TRY_OUT(spin_glb_write(&x->glb, at, key, 3 * n * sizeof *key));
    }
    x->n_bytes = at;
out:
    free(key);
    return status;
}

/* ---- The plug-in ----------------------------------------------------------------------------- */

static bool ends_in_glb(const char *path)
{
    size_t n = strlen(path);

    return n > 4 && strcmp(path + n - 4, ".glb") == 0;
}

static spin_status parse_fps(const char *text, double bundle, double *out)
{
    char *end;

    *out = bundle > 0 ? bundle : DEFAULT_FPS;
    if (!text)
        return SPIN_OK;
    *out = strtod(text, &end);
    if (end == text || *end || !(*out > 0 && *out <= 1e6))
        return spin_fail(SPIN_E_USAGE, "--fps '%s': expected a number above 0", text);
    return SPIN_OK;
}

static spin_status read_options(struct export *x, const struct spin_export_job *job)
{
    const struct spin_plugin_values *v = job->values;
    const char *axes = spin_plugin_value(v, "axes", "gltf");

    if (strcmp(axes, "gltf") != 0 && strcmp(axes, "source") != 0)
        return spin_fail(SPIN_E_USAGE, "--axes '%s': expected gltf or source", axes);
    x->turned = strcmp(axes, "gltf") == 0;
    x->extras[0] = "axes";
    x->extras[1] = x->turned ? "glTF, from x right, y down, z forward" : "as in the source";
    if (job->source && *job->source) {
        x->extras[2] = "source";
        x->extras[3] = job->source;
    }
    SPIN_TRY(spin_rows_parse_sh(spin_plugin_value(v, "sh", "keep"), job->sh_degree, &x->sh_degree));
    SPIN_TRY(parse_fps(spin_plugin_value(v, "fps", NULL), job->fps, &x->fps));
    list_attributes(x, spin_plugin_value(v, "no-fallback", NULL) == NULL);
    divide_block(x);
    return SPIN_OK;
}

static spin_status open_single(struct export *x, const struct spin_export_job *job)
{
    struct spin_gltf_clip worst;

    SPIN_TRY(spin_rows_parse_min_opacity(spin_plugin_value(job->values, "min-opacity", "0"),
                                         &x->frames.rows));
    x->n_frames = job->n_frames;
    SPIN_TRY(spin_alloc((size_t)job->n_frames + 1, sizeof *x->frame, (void **)&x->frame));
    worst = describe(x, x->frame, x->n_frames);
    return spin_glb_open(job->output, job->force, &worst, &x->glb);
}

static void finish(struct export *x)
{
    spin_frames_end(&x->frames);
    free(x->frame);
    free(x);
}

static spin_status gltf_begin(const struct spin_export_job *job, void **self)
{
    struct export *x = NULL;
    spin_status status;

    SPIN_TRY(spin_alloc(1, sizeof *x, (void **)&x));
    x->single = ends_in_glb(job->output);
    SPIN_TRY_OUT(read_options(x, job));
    SPIN_TRY_OUT(x->single ? open_single(x, job)
                           : spin_frames_begin(&x->frames, job, "frame_%05d.glb"));
    *self = x;
    return SPIN_OK;
out:
    finish(x);
    return status;
}

static spin_status gltf_frame(void *self, int frame, const struct spin_frame_info *info,
                              const struct spin_splats *splats)
{
    struct export *x = self;

    (void)frame;
    return x->single ? add_to_file(x, info, splats) : write_own_file(x, info, splats);
}

static spin_status end_single(struct export *x)
{
    uint64_t keys_offset = x->n_bytes;
    struct spin_gltf_clip clip;
    spin_status status = SPIN_OK;

    x->n_frames = x->n_done;
    if (x->n_frames > 1)
        status = write_keys(x, keys_offset);
    if (status != SPIN_OK) {
        spin_glb_abandon(&x->glb);
        return status;
    }
    clip = describe(x, x->frame, x->n_frames);
    clip.keys_offset = keys_offset;
    return spin_glb_commit(&x->glb, &clip);
}

static spin_status gltf_end(void *self)
{
    struct export *x = self;
    spin_status status = x->single ? end_single(x) : SPIN_OK;

    finish(x);
    return status;
}

static void gltf_abort(void *self)
{
    struct export *x = self;

    if (x->single)
        spin_glb_abandon(&x->glb);
    else
        spin_out_folder_abandon(&x->frames.folder);
    finish(x);
}

extern const struct spin_exporter spin_exporter_gltf;
const struct spin_exporter spin_exporter_gltf = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "gltf",
    .summary = "GLB with KHR_gaussian_splatting: one per frame, or one with the clip (OUT.glb)",
    .options = options,
    .wants = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES,
    .begin = gltf_begin,
    .frame = gltf_frame,
    .end = gltf_end,
    .abort = gltf_abort,
};
