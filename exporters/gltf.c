/* glTF 2.0 with KHR_gaussian_splatting (Khronos, release candidate of 2026): one .glb per frame in a
 * folder, or, when the output's name ends in .glb, one file with the whole clip.
 *
 * glTF has no vertex data that changes with time, so the clip is a node per frame, and an animation
 * that switches them: STEP keys on their scale, 1 while a frame is shown and else 0. A key after the
 * last frame repeats its value, or players would cut it. --visibility switches KHR_node_visibility
 * by KHR_animation_pointer instead, which is what they are for; of the players only Babylon.js knows it.
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
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>

#include "exporters/lib/frames.h"
#include "exporters/lib/gltf_read.h"
#include "io/gltf.h"

#define EXTENSION "KHR_gaussian_splatting"
#define DEFAULT_FPS 30
#define MAX_ATTRIBUTES (4 + SPIN_SH_MAX + 1)
#define BLOCK SPIN_ROWS_BLOCK
#define MAX_ROW (4 * (3 + 4 + 3 + 1 + 3 * SPIN_SH_MAX) + 8)

static const struct spin_plugin_option options[] = {
    SPIN_FRAMES_OPTIONS("frame_%05d.glb"),
    SPIN_ROWS_OPTION_SH,
    {"axes", "gltf|source",
     "axes to write without --up; gltf: x left, y up, z forward, half a turn about z", "gltf"},
    {"fps", "F", "frames a second of a clip in one file; otherwise the bundle's, else 30", NULL},
    {"visibility", NULL,
     "of a clip in one file: switch frames by KHR_node_visibility, which few players know", NULL},
    {"no-fallback", NULL, "leave out COLOR_0, for viewers that draw plain points", NULL},
    {0},
};

struct export
{
    struct spin_frames frames; /* of one per file; its rows and options serve both */
    bool single;               /* all in one file */
    bool visibility;           /* what the animation switches, instead of scale */
    const char *extras[5];
    bool fallback;
    int n_attributes;
    struct spin_gltf_attribute attribute[MAX_ATTRIBUTES];
    char name[SPIN_SH_MAX][64];
    uint64_t n_bytes; /* of the binary chunk so far */

    /* All in one file. */
    struct spin_out out;
    struct spin_glb glb;
    int n_frames, n_done;
    struct spin_gltf_frame *frame; /* [n_frames] */
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
    for (int l = 0; l <= x->frames.rows.sh_degree; l++) {
        for (int m = 0; m < 2 * l + 1; m++, k++) {
            snprintf(x->name[k], sizeof x->name[k], EXTENSION ":SH_DEGREE_%d_COEF_%d", l, m);
            add_attribute(x, x->name[k], 3, SPIN_GLTF_F32);
        }
    }
    if (fallback)
        add_attribute(x, "COLOR_0", 4, SPIN_GLTF_U16);
}

static uint64_t bytes_of_row(const struct export *x)
{
    uint64_t sum = 0;

    for (int a = 0; a < x->n_attributes; a++)
        sum += width_of(&x->attribute[a]);
    return sum;
}

static struct spin_gltf_clip describe(const struct export *x, const struct spin_gltf_frame *frame,
                                      int n_frames)
{
    static const char *const values[] = {"kernel", "ellipse", "colorSpace", "srgb_rec709_display",
                                         NULL};

    return (struct spin_gltf_clip){
        .generator = "spin4d " SPIN_VERSION,
        .extras = x->extras,
        .fps = x->frames.fps,
        .extension = EXTENSION,
        .extension_values = values,
        .attribute = x->attribute,
        .n_attributes = x->n_attributes,
        .frame = frame,
        .n_frames = n_frames,
        .animated = x->single && n_frames > 1,
        .visibility = x->visibility,
        .n_bytes = x->n_bytes,
    };
}

/* ---- Rows ------------------------------------------------------------------------------------ */

/* A block of rows taken apart, and where it goes. */
struct block {
    const struct export *x;
    unsigned char *column[MAX_ATTRIBUTES];
};

static uint16_t u16_of(float x) { return (uint16_t)(spin_minf(spin_maxf(x, 0), 1) * 65535 + 0.5f); }

/* The curve of sRGB (IEC 61966-2-1), undone. */
static float linear_of(float x)
{
    return x <= 0.04045f ? x / 12.92f : powf((x + 0.055f) / 1.055f, 2.4f);
}

static void put_sh(const struct block *b, size_t i, size_t at)
{
    const struct spin_splat_filter *rows = &b->x->frames.rows;
    int n = spin_sh_count(rows->sh_degree), n_there = spin_splat_filter_n_sh(rows);
    float room[3 * SPIN_SH_MAX];
    const float *sh = spin_splat_filter_sh(rows, i, room);

    for (int k = 0; k < n; k++) {
        float *out = (float *)(void *)b->column[4 + k] + 3 * at;

        for (int c = 0; c < 3; c++)
            out[c] = k < n_there ? sh[3 * k + c] : 0;
    }
}

/* Row i of the frame to row `at` of the block. */
static void put_row(const struct block *b, size_t i, size_t at)
{
    const struct export *x = b->x;
    struct spin_quant_error_row row;
    float *rotation = (float *)(void *)b->column[1] + 4 * at;
    float *scale = (float *)(void *)b->column[2] + 3 * at;
    uint16_t *colour = (uint16_t *)(void *)b->column[x->n_attributes - 1] + 4 * at;

    spin_quant_error_take(&x->frames.rows, i, &row);
    memcpy(b->column[0] + 12 * at, row.place, sizeof row.place);
    for (int k = 0; k < 4; k++)
        rotation[k] = row.rotation[(k + 1) % 4];
    for (int c = 0; c < 3; c++)
        scale[c] = expf(row.log_scale[c]);
    memcpy(b->column[3] + 4 * at, &row.opacity, sizeof row.opacity);
    put_sh(b, i, at);
    if (!x->fallback)
        return;
    for (int c = 0; c < 3; c++)
        colour[c] = u16_of(linear_of(spin_minf(spin_maxf(row.colour[c], 0), 1)));
    colour[3] = u16_of(row.opacity);
}

/* Two bytes of COLOR_0 at a time, four of the others. */
static void to_little_endian(const struct block *b, size_t n)
{
#if __BYTE_ORDER__ == __ORDER_BIG_ENDIAN__
    const struct export *x = b->x;

    for (int a = 0; a < x->n_attributes; a++) {
        size_t n_words = n * width_of(&x->attribute[a]) / 4;
        uint16_t *half = (uint16_t *)(void *)b->column[a];

        if (x->attribute[a].component == SPIN_GLTF_F32)
            spin_splat_filter_little_endian(b->column[a], n_words);
        for (size_t i = 0; x->attribute[a].component == SPIN_GLTF_U16 && i < 2 * n_words; i++)
            half[i] = __builtin_bswap16(half[i]);
    }
#else
    (void)b;
    (void)n;
#endif
}

struct writing {
    struct export *x;
    struct spin_glb *glb;
    struct spin_gltf_frame *frame;
    unsigned char *scratch;
    float *bounds; /* [blocks][6] low, high */
    atomic_int error;
};

static void widen(float *bounds, const float *place)
{
    for (int c = 0; c < 3; c++) {
        bounds[c] = spin_minf(bounds[c], place[c]);
        bounds[3 + c] = spin_maxf(bounds[3 + c], place[c]);
    }
}

/* Each attribute of a block to its place. */
static int put_block(const struct writing *w, const struct block *b, uint64_t first, size_t n)
{
    uint64_t at = w->frame->offset;
    int error = 0;

    to_little_endian(b, n);
    for (int a = 0; a < w->x->n_attributes && !error; a++) {
        size_t width = width_of(&w->x->attribute[a]);

        error = spin_glb_put(w->glb, at + first * width, b->column[a], n * width);
        at += w->frame->n * width;
    }
    return error;
}

static void write_block(void *context, int number, int worker)
{
    struct writing *w = context;
    const struct spin_splat_filter *rows = &w->x->frames.rows;
    struct block b = {.x = w->x};
    unsigned char *at = w->scratch + (size_t)worker * w->x->frames.scratch_bytes;
    size_t i = (size_t)number * BLOCK, end = i + BLOCK, n = 0;
    float *bounds = w->bounds + 6 * (size_t)number;
    int error;

    for (int a = 0; a < w->x->n_attributes; a++) {
        b.column[a] = at;
        at += BLOCK * width_of(&w->x->attribute[a]);
    }
    for (int c = 0; c < 6; c++)
        bounds[c] = c < 3 ? INFINITY : -INFINITY;
    for (end = end < rows->splats->n ? end : rows->splats->n; i < end; i++) {
        if (rows->keep[i]) {
            put_row(&b, i, n);
            widen(bounds, (float *)(void *)b.column[0] + 3 * n++);
        }
    }
    spin_splat_filter_rest(rows, (size_t)number, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES);
    error = put_block(w, &b, spin_splat_filter_before(rows, (size_t)number), n);
    if (error)
        atomic_store(&w->error, error);
}

/* The chosen rows, at frame->offset; fills in the frame's bounds. */
static spin_status write_rows(struct export *x, struct spin_glb *glb, struct spin_gltf_frame *frame)
{
    struct writing w = {.x = x, .glb = glb, .frame = frame};
    size_t n_blocks = spin_splat_filter_blocks(&x->frames.rows);

    SPIN_TRY(spin_frames_scratch(&x->frames, BLOCK * MAX_ROW, &w.scratch));
    SPIN_TRY(spin_alloc(n_blocks + 1, 6 * sizeof *w.bounds, (void **)&w.bounds));
    spin_splat_filter_each(&x->frames.rows, write_block, &w);
    for (int c = 0; c < 3; c++) {
        frame->low[c] = INFINITY;
        frame->high[c] = -INFINITY;
        for (size_t b = 0; b < n_blocks; b++) {
            frame->low[c] = spin_minf(frame->low[c], w.bounds[6 * b + (size_t)c]);
            frame->high[c] = spin_maxf(frame->high[c], w.bounds[6 * b + 3 + (size_t)c]);
        }
    }
    free(w.bounds);
    return w.error ? spin_glb_failed(glb, w.error) : SPIN_OK;
}

/* ---- Files ----------------------------------------------------------------------------------- */

static struct spin_gltf_frame begin_frame(const struct export *x,
                                          const struct spin_frame_info *info)
{
    return (struct spin_gltf_frame){.n = x->frames.rows.n_kept,
                                    .offset = x->n_bytes,
                                    .number = info->number,
                                    .time = info->time};
}

static spin_status gltf_write(void *self, const struct spin_frame_info *info, struct spin_out *out)
{
    struct export *x = self;
    struct spin_gltf_frame frame;
    struct spin_gltf_clip clip;
    struct spin_glb glb;

    x->n_bytes = 0;
    frame = begin_frame(x, info);
    x->n_bytes = frame.n * bytes_of_row(x);
    clip = describe(x, &frame, 1);
    SPIN_TRY(spin_glb_begin(out, &clip, &glb));
    SPIN_TRY(write_rows(x, &glb, &frame));
    return spin_glb_end(&glb, &clip);
}

static uint64_t gltf_bytes(const void *self, size_t n)
{
    const struct export *x = self;

    return 2048 + (uint64_t)n * bytes_of_row(x) + 256 * (uint64_t)x->n_attributes; /* JSON: about */
}

static uint32_t u32_at(const unsigned char *at)
{
    return at[0] | (uint32_t)at[1] << 8 | (uint32_t)at[2] << 16 | (uint32_t)at[3] << 24;
}

/* A .glb of ours whose lengths add up and whose bytes are rows of what would be written. */
static bool gltf_complete(void *self, const struct spin_frame_info *info,
                          const struct spin_map *map, size_t *n)
{
    const struct export *x = self;
    uint64_t n_json, n_bytes, row = bytes_of_row(x);
    char number[64];

    if (map->size < 28 || memcmp(map->data, "glTF", 4) != 0 || u32_at(map->data + 8) != map->size)
        return false;
    n_json = u32_at(map->data + 12);
    if (20 + n_json > map->size)
        return false;
    snprintf(number, sizeof number, "\"name\":\"frame_%d\"", info->number);
    n_bytes = 28 + n_json <= map->size ? u32_at(map->data + 20 + n_json) : 0;
    *n = (size_t)(n_bytes / row);
    return n_bytes % row == 0 && (n_bytes == 0 || 28 + n_json + n_bytes == map->size) &&
           memmem(map->data + 20, n_json, number, strlen(number)) != NULL;
}

static spin_status gltf_read(void *self, const struct spin_map *map, int frame,
                             struct spin_splats *out)
{
    (void)self;
    return spin_gltf_read(map, frame, out);
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
    uint64_t n_bytes;

    SPIN_TRY(spin_splat_filter_choose(&x->frames.rows, s, info->number));
    *frame = begin_frame(x, info);
    n_bytes = frame->n * bytes_of_row(x);
    warn_if_large(x, n_bytes);
    SPIN_TRY(write_rows(x, &x->glb, frame));
    x->n_bytes += n_bytes;
    x->n_done++;
    return spin_frames_add(&x->frames, info, frame->n);
}

/* Frame f is shown from its own key on; the last one also at the last key. */
static bool is_shown(size_t f, size_t key, size_t n_keys)
{
    return key == f || (key == f + 1 && key + 1 == n_keys);
}

static spin_status write_scales(struct export *x, uint64_t at, size_t n, float *key)
{
    for (size_t f = 0; f + 1 < n; f++, at += 3 * n * sizeof *key) {
        for (size_t i = 0; i < 3 * n; i++)
            key[i] = is_shown(f, i / 3, n);
        spin_splat_filter_little_endian(key, 3 * n);
        SPIN_TRY(spin_glb_write(&x->glb, at, key, 3 * n * sizeof *key));
    }
    x->n_bytes = at;
    return SPIN_OK;
}

static spin_status write_visibilities(struct export *x, uint64_t at, size_t n, unsigned char *key)
{
    size_t n_padded = (n + 3) / 4 * 4;

    for (size_t f = 0; f + 1 < n; f++, at += n_padded) {
        for (size_t i = 0; i < n_padded; i++)
            key[i] = i < n && is_shown(f, i, n);
        SPIN_TRY(spin_glb_write(&x->glb, at, key, n_padded));
    }
    x->n_bytes = at;
    return SPIN_OK;
}

/* Key i is at i / fps. */
static spin_status write_keys(struct export *x, uint64_t at)
{
    size_t n = (size_t)x->n_frames + 1;
    float *key = NULL;
    spin_status status;

    SPIN_TRY(spin_alloc(n, 3 * sizeof *key, (void **)&key));
    for (size_t i = 0; i < n; i++)
        key[i] = (float)((double)i / x->frames.fps);
    spin_splat_filter_little_endian(key, n);
    SPIN_TRY_OUT(spin_glb_write(&x->glb, at, key, n * sizeof *key));
    at += n * sizeof *key;
    status = x->visibility ? write_visibilities(x, at, n, (unsigned char *)key)
                           : write_scales(x, at, n, key);
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

static spin_status begin(void *self, const struct spin_export_job *job)
{
    static const double half_about_z[4] = {0, 0, 0, 1};
    const struct spin_plugin_values *v = job->values;
    const char *axes = spin_plugin_value(v, "axes", "gltf");
    struct export *x = self;

    if (strcmp(axes, "gltf") != 0 && strcmp(axes, "source") != 0)
        return spin_fail(SPIN_E_USAGE, "--axes '%s': expected gltf or source", axes);
    x->frames.axes = strcmp(axes, "gltf") == 0 ? half_about_z : NULL;
    x->fallback = spin_plugin_value(v, "no-fallback", NULL) == NULL;
    x->visibility = spin_plugin_value(v, "visibility", NULL) != NULL;
    if (x->visibility && !x->single)
        return spin_fail(SPIN_E_USAGE, "--visibility is for a clip in one file, OUT.glb");
    return parse_fps(spin_plugin_value(v, "fps", NULL), job->fps, &x->frames.fps);
}

/* With the options read. */
static void ready(void *self, const struct spin_export_job *job)
{
    struct export *x = self;
    bool plain = x->frames.rows.turn.kind == SPIN_TURN_NONE;

    x->extras[0] = "axes";
    x->extras[1] = x->frames.rows.up ? "y up"
                   : plain           ? "as in the source"
                   : x->frames.axes && !spin_plugin_value(job->values, "rotate", NULL)
                       ? "glTF, from x right, y down, z forward"
                       : "turned by --rotate";
    if (job->source && *job->source) {
        x->extras[2] = "source";
        x->extras[3] = job->source;
    }
    list_attributes(x, x->fallback);
}

static const struct spin_frames_format format = {
    .name = "gltf",
    .pattern = "frame_%05d.glb",
    .self_bytes = sizeof(struct export),
    .begin = begin,
    .ready = ready,
    .bytes = gltf_bytes,
    .write = gltf_write,
    .complete = gltf_complete,
    .read = gltf_read,
};

static void finish(struct export *x)
{
    free(x->frame);
    spin_frames_free(&x->frames);
}

static void say_size(const struct export *x, const struct spin_export_job *job)
{
    uint64_t bytes = 0;

    for (int f = 0; f < job->n_frames && job->counts; f++)
        bytes += gltf_bytes(x, job->counts[f]);
    if (job->counts)
        spin_frames_say_size(job->output, job->n_frames, bytes,
                             x->frames.rows.min_logit > -INFINITY);
}

static spin_status open_single(struct export *x, const struct spin_export_job *job)
{
    struct spin_gltf_clip worst;

    SPIN_TRY(begin(x, job));
    SPIN_TRY(spin_splat_filter_begin(&x->frames.rows, job, x->frames.axes));
    ready(x, job);
    x->n_frames = job->n_frames;
    SPIN_TRY(spin_alloc((size_t)job->n_frames + 1, sizeof *x->frame, (void **)&x->frame));
    worst = describe(x, x->frame, x->n_frames);
    SPIN_TRY(spin_out_open(job->output, job->force, &x->out));
    x->out.sync = job->sync;
    SPIN_TRY(spin_glb_begin(&x->out, &worst, &x->glb));
    say_size(x, job);
    return SPIN_OK;
}

static spin_status begin_single(const struct spin_export_job *job, void **self)
{
    struct export *x = NULL;
    spin_status status;

    SPIN_TRY(spin_alloc(1, sizeof *x, (void **)&x));
    x->frames.format = &format;
    x->frames.job = job;
    x->single = true;
    status = open_single(x, job);
    if (status != SPIN_OK) {
        spin_out_abandon(&x->out);
        finish(x);
        return status;
    }
    *self = x;
    return SPIN_OK;
}

static spin_status gltf_begin(const struct spin_export_job *job, void **self)
{
    if (ends_in_glb(job->output))
        return begin_single(job, self);
    return spin_frames_begin(&format, job, self);
}

static spin_status gltf_frame(void *self, int frame, const struct spin_frame_info *info,
                              const struct spin_splats *splats)
{
    struct export *x = self;

    return x->single ? add_to_file(x, info, splats) : spin_frames_frame(self, frame, info, splats);
}

static bool gltf_skip(void *self, int frame, const struct spin_frame_info *info)
{
    return !((struct export *)self)->single && spin_frames_skip(self, frame, info);
}

static spin_status end_single(struct export *x)
{
    uint64_t keys_offset = x->n_bytes, length;
    struct spin_gltf_clip clip;

    x->n_frames = x->n_done;
    if (x->n_frames > 1)
        SPIN_TRY(write_keys(x, keys_offset));
    clip = describe(x, x->frame, x->n_frames);
    clip.keys_offset = keys_offset;
    SPIN_TRY(spin_glb_end(&x->glb, &clip));
    SPIN_TRY(spin_out_length(&x->out, &length));
    if (x->frames.rows.report)
        x->frames.rows.report->bytes = length;
    SPIN_TRY(spin_out_commit(&x->out));
    return x->frames.job->check ? spin_frames_check(&x->frames, x->frames.job->output) : SPIN_OK;
}

static spin_status gltf_end(void *self)
{
    struct export *x = self;
    spin_status status;

    if (!x->single)
        return spin_frames_end(self);
    status = end_single(x);
    spin_out_abandon(&x->out);
    finish(x);
    return status;
}

static void gltf_abort(void *self)
{
    struct export *x = self;

    if (!x->single) {
        spin_frames_abort(self);
        return;
    }
    spin_out_abandon(&x->out);
    finish(x);
}

extern const struct spin_exporter spin_exporter_gltf;
const struct spin_exporter spin_exporter_gltf = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "gltf",
    .summary = "GLB with KHR_gaussian_splatting: one per frame, or one with the clip (OUT.glb)",
    .options = options,
    .checks = true,
    .wants = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES,
    .begin = gltf_begin,
    .frame = gltf_frame,
    .end = gltf_end,
    .abort = gltf_abort,
    .skip = gltf_skip,
};
