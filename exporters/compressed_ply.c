/* One compressed PLY per frame, PlayCanvas's layout (splat-transform, SuperSplat): a binary little
 * endian PLY with the elements chunk, vertex and, with SH, sh. Axes stay those of the training.
 *
 * Gaussians are cut into chunks of 256; a chunk holds the ranges of place, log scale and colour, a
 * vertex four words within them:
 *
 *     packed_position, packed_scale   11, 10 and 11 bits, x high
 *     packed_rotation                 2 bits: the largest of w x y z; the other three, 10 bits each,
 *                                     (v / sqrt(2) + 0.5) * 1023
 *     packed_color                    r g b within the range and opacity, 8 bits each
 *
 * sh holds f_rest, channel-major, in 256 steps over [-4, 4]. The ranges are small only if neighbours
 * share a chunk, so the order is Morton's; --order source keeps the source's and costs precision.
 *
 * In the order of Morton neighbours in the file lie far apart in the bundle, and its SH, the bulk of
 * it, is not to be held: it is read once from end to end, packed, and each row put to its place. */
#include <stdatomic.h>
#include <string.h>

#include "exporters/lib/roundtrip_check.h"
#include "exporters/lib/frames.h"
#include "exporters/lib/sort_rows.h"
#include "io/ply.h"
#include "math/morton.h"

#define CHUNK 256
#define RANGES 18 /* floats of a chunk */
#define MAX_REST 45
#define CHUNKS_PER_TASK (SPIN_ROWS_BLOCK / CHUNK)
#define VERTEX 16         /* bytes */
#define SCALE_LIMIT 20.0f /* of the logarithm, as splat-transform has it */
#define SQRT2 1.41421356237309505f
#define MAX_HEADER 4096

static const struct spin_plugin_option options[] = {
    SPIN_FRAMES_OPTIONS("frame_%05d.compressed.ply"),
    SPIN_ROWS_OPTION_SH,
    {"order", "morton|source", "order of the splats; source: as they were, less precise", "morton"},
    {0},
};

struct export
{
    struct spin_frames frames;
    struct spin_sort_rows order;
    bool by_source;

    /* One frame. */
    size_t room, room_before;       /* rows written; of the frame */
    uint32_t *row;                  /* [n] rows in the order of the file */
    uint32_t *place;                /* [rows] where each goes */
    float *colour;                  /* [n][3] */
    unsigned char *rest;            /* [n][n_rest] */
    struct spin_quant_error *quant; /* [blocks] */
    unsigned char *scratch;
    struct spin_out *out;
    uint64_t range_at, vertex_at;
    atomic_int error;
};

static size_t n_rest(const struct export *x)
{
    return 3 * (size_t)spin_sh_count(x->frames.rows.sh_degree) - 3;
}

static size_t chunks_of(size_t n) { return (n + CHUNK - 1) / CHUNK; }

/* ---- One chunk ------------------------------------------------------------------------------- */

/* x in [low, high] as n steps. */
static uint32_t steps(float x, float low, float high, uint32_t n)
{
    float u = high - low > 0 ? (x - low) / (high - low) : 0;

    return (uint32_t)(spin_minf(spin_maxf(u, 0), 1) * (float)n + 0.5f);
}

static float back(uint32_t step, float low, float high, uint32_t n)
{
    return low + (high - low) * ((float)step / (float)n);
}

static uint32_t pack_3(const float *x, const float *low, const float *high)
{
    return steps(x[0], low[0], high[0], 2047) << 21 | steps(x[1], low[1], high[1], 1023) << 11 |
           steps(x[2], low[2], high[2], 2047);
}

static void unpack_3(uint32_t word, const float *low, const float *high, float *x)
{
    x[0] = back(word >> 21, low[0], high[0], 2047);
    x[1] = back(word >> 11 & 1023, low[1], high[1], 1023);
    x[2] = back(word & 2047, low[2], high[2], 2047);
}

static uint32_t pack_rotation(const float q[4])
{
    int largest = 0;
    uint32_t word;
    float sign;

    for (int k = 1; k < 4; k++)
        largest = fabsf(q[k]) > fabsf(q[largest]) ? k : largest;
    word = (uint32_t)largest;
    sign = q[largest] < 0 ? -1 : 1;
    for (int k = 0; k < 4; k++)
        if (k != largest)
            word = word << 10 | steps(sign * q[k], -0.5f * SQRT2, 0.5f * SQRT2, 1023);
    return word;
}

static void unpack_rotation(uint32_t word, float q[4])
{
    int largest = (int)(word >> 30), shift = 20;
    float rest = 1;

    for (int k = 0; k < 4; k++) {
        if (k == largest)
            continue;
        q[k] = back(word >> shift & 1023, -0.5f * SQRT2, 0.5f * SQRT2, 1023);
        rest -= q[k] * q[k];
        shift -= 10;
    }
    q[largest] = sqrtf(spin_maxf(rest, 0));
}

static uint32_t pack_colour(const struct spin_quant_error_row *row, const float *low,
                            const float *high)
{
    uint32_t word = 0;

    for (int c = 0; c < 3; c++)
        word = word << 8 | steps(row->colour[c], low[c], high[c], 255);
    return word << 8 | steps(row->opacity, 0, 1, 255);
}

static void unpack_vertex(const uint32_t *word, const float *range,
                          struct spin_quant_error_row *out)
{
    unpack_3(word[0], range, range + 3, out->place);
    unpack_3(word[2], range + 6, range + 9, out->log_scale);
    unpack_rotation(word[1], out->rotation);
    for (int c = 0; c < 3; c++)
        out->colour[c] = back(word[3] >> (24 - 8 * c) & 255, range[12 + c], range[15 + c], 255);
    out->opacity = (float)(word[3] & 255) / 255;
}

static void widen(float *range, const float *x)
{
    for (int c = 0; c < 3; c++) {
        range[c] = spin_minf(range[c], x[c]);
        range[3 + c] = spin_maxf(range[3 + c], x[c]);
    }
}

static void range_of(const struct spin_quant_error_row *row, size_t n, float *range)
{
    for (int i = 0; i < RANGES; i++)
        range[i] = i / 3 % 2 ? -INFINITY : INFINITY;
    for (size_t i = 0; i < n; i++) {
        widen(range, row[i].place);
        widen(range + 6, row[i].log_scale);
        widen(range + 12, row[i].colour);
    }
}

static void take_row(const struct export *x, size_t at, struct spin_quant_error_row *out)
{
    const struct spin_splat_filter *rows = &x->frames.rows;
    size_t i = x->row[at];

    spin_splat_filter_place(rows, i, out->place);
    for (int c = 0; c < 3; c++)
        out->log_scale[c] = spin_minf(
            spin_maxf(rows->splats->log_scales[3 * i + (size_t)c], -SCALE_LIMIT), SCALE_LIMIT);
    spin_splat_filter_turned(rows, i, out->rotation);
    out->opacity = spin_quant_error_opacity(rows, i);
    memcpy(out->colour, x->colour + 3 * at, sizeof out->colour);
}

static void pack_chunk(const struct export *x, size_t first, size_t n, float *range, uint32_t *word,
                       struct spin_quant_error *quant)
{
    struct spin_quant_error_row row[CHUNK], shown;

    for (size_t i = 0; i < n; i++)
        take_row(x, first + i, &row[i]);
    range_of(row, n, range);
    for (size_t i = 0; i < n; i++, word += 4) {
        word[0] = pack_3(row[i].place, range, range + 3);
        word[1] = pack_rotation(row[i].rotation);
        word[2] = pack_3(row[i].log_scale, range + 6, range + 9);
        word[3] = pack_colour(&row[i], range + 12, range + 15);
        unpack_vertex(word, range, &shown);
        spin_quant_error_row(quant, &row[i], &shown);
    }
}

static void pack_task(void *context, int task, int worker)
{
    struct export *x = context;
    float *range = (float *)(void *)(x->scratch + (size_t)worker * x->frames.scratch_bytes);
    uint32_t *word = (uint32_t *)(void *)(range + CHUNKS_PER_TASK * RANGES);
    size_t first = (size_t)task * SPIN_ROWS_BLOCK, n = x->frames.rows.n_kept - first;
    size_t n_chunks;
    int error;

    n = n < SPIN_ROWS_BLOCK ? n : SPIN_ROWS_BLOCK;
    n_chunks = chunks_of(n);
    for (size_t c = 0; c < n_chunks; c++)
        pack_chunk(x, first + c * CHUNK, n - c * CHUNK < CHUNK ? n - c * CHUNK : CHUNK,
                   range + c * RANGES, word + c * CHUNK * 4, &x->quant[task]);
    spin_splat_filter_little_endian(range, n_chunks * RANGES);
    spin_splat_filter_little_endian(word, 4 * n);
    error = spin_out_put(x->out, x->range_at + first / CHUNK * RANGES * sizeof *range, range,
                         n_chunks * RANGES * sizeof *range);
    if (!error)
        error = spin_out_put(x->out, x->vertex_at + first * VERTEX, word, n * VERTEX);
    if (error)
        atomic_store(&x->error, error);
}

/* ---- SH -------------------------------------------------------------------------------------- */

/* Byte u stands for (u + 0.5) / 32 - 4, the first and the last for the ends. */
static float shown_rest(unsigned char u)
{
    return u == 0 ? -4 : u == 255 ? 4 : ((float)u + 0.5f) / 32 - 4;
}

/* f_rest of one row. */
static void pack_rest(const struct export *x, size_t i, struct spin_quant_error *quant,
                      unsigned char *out)
{
    size_t n_there = (size_t)spin_splat_filter_n_sh(&x->frames.rows), n = n_rest(x) / 3, at = 0;
    float error[MAX_REST], room[3 * SPIN_SH_MAX];
    const float *sh = spin_splat_filter_sh(&x->frames.rows, i, room);

    for (size_t c = 0; c < 3; c++) {
        for (size_t k = 1; k <= n; k++, at++) {
            float v = k < n_there ? sh[3 * k + c] : 0;
            float u = spin_minf(spin_maxf((v / 8 + 0.5f) * 256, 0), 255);

            out[at] = (unsigned char)u;
            error[at] = v - shown_rest(out[at]);
        }
    }
    spin_quant_error_add_all(quant, SPIN_QUANT_SH, error, at);
}

/* Colours and SH of a block of the source to their places in the order of the file. */
static void scatter_block(void *context, int b, int worker)
{
    struct export *x = context;
    const struct spin_splat_filter *rows = &x->frames.rows;
    size_t i = (size_t)b * SPIN_ROWS_BLOCK, end = i + SPIN_ROWS_BLOCK;

    (void)worker;
    for (end = end < rows->splats->n ? end : rows->splats->n; i < end; i++) {
        if (!rows->keep[i])
            continue;
        spin_quant_error_colour(rows, i, x->colour + 3 * (size_t)x->place[i]);
        pack_rest(x, i, &x->quant[b], x->rest + n_rest(x) * x->place[i]);
    }
    spin_splat_filter_rest(rows, (size_t)b, SPIN_COL_SH);
}

/* ---- Order ----------------------------------------------------------------------------------- */

static void key_by_place(struct export *x)
{
    const struct spin_splats *s = x->frames.rows.splats;
    float range[6] = {INFINITY, INFINITY, INFINITY, -INFINITY, -INFINITY, -INFINITY};

    for (size_t i = 0; i < x->order.n; i++)
        widen(range, s->means + 3 * (size_t)x->order.item[i].row);
    for (size_t i = 0; i < x->order.n; i++) {
        const float *place = s->means + 3 * (size_t)x->order.item[i].row;

        for (int c = 0; c < 3; c++) {
            double width = (double)range[3 + c] - range[c];
            double u = width > 0 ? ((double)place[c] - range[c]) / width : 0;

            x->order.item[i].key |= spin_morton_spread((uint64_t)(u * SPIN_MORTON_MAX)) << c;
        }
    }
}

static spin_status make_room(struct export *x)
{
    size_t n = x->frames.rows.n_kept, n_before = x->frames.rows.splats->n;

    if (n > x->room) {
        SPIN_TRY(spin_grow(n, sizeof *x->row, (void **)&x->row));
        SPIN_TRY(spin_grow(n, 3 * sizeof *x->colour, (void **)&x->colour));
        SPIN_TRY(spin_grow(n, n_rest(x) + 1, (void **)&x->rest));
        x->room = n;
    }
    if (n_before > x->room_before) {
        SPIN_TRY(spin_grow(n_before, sizeof *x->place, (void **)&x->place));
        x->room_before = n_before;
    }
    return SPIN_OK;
}

/* What sorts is four times as large as the order itself, and goes before the rest comes. */
static spin_status choose_order(struct export *x)
{
    SPIN_TRY(spin_sort_rows_fill(&x->order, &x->frames.rows));
    if (!x->by_source) {
        key_by_place(x);
        spin_sort_rows_sort(&x->order);
    }
    SPIN_TRY(make_room(x));
    for (size_t i = 0; i < x->order.n; i++) {
        x->row[i] = x->order.item[i].row;
        x->place[x->row[i]] = (uint32_t)i;
    }
    spin_sort_rows_free(&x->order);
    return SPIN_OK;
}

/* ---- One file -------------------------------------------------------------------------------- */

static size_t make_header(const struct export *x, const struct spin_frame_info *info, size_t n,
                          char text[MAX_HEADER])
{
    static const char *const chunk[RANGES] = {
        "min_x",       "min_y",       "min_z",       "max_x",       "max_y",       "max_z",
        "min_scale_x", "min_scale_y", "min_scale_z", "max_scale_x", "max_scale_y", "max_scale_z",
        "min_r",       "min_g",       "min_b",       "max_r",       "max_g",       "max_b"};
    size_t at = (size_t)snprintf(text, MAX_HEADER, "ply\nformat binary_little_endian 1.0\n");

    at += spin_frames_comments(&x->frames, info, text + at, MAX_HEADER - at);
    at += (size_t)snprintf(text + at, MAX_HEADER - at, "element chunk %zu\n", chunks_of(n));
    for (int i = 0; i < RANGES; i++)
        at += (size_t)snprintf(text + at, MAX_HEADER - at, "property float %s\n", chunk[i]);
    at += (size_t)snprintf(text + at, MAX_HEADER - at,
                           "element vertex %zu\nproperty uint packed_position\n"
                           "property uint packed_rotation\nproperty uint packed_scale\n"
                           "property uint packed_color\n",
                           n);
    if (n_rest(x) > 0)
        at += (size_t)snprintf(text + at, MAX_HEADER - at, "element sh %zu\n", n);
    for (size_t i = 0; i < n_rest(x); i++)
        at += (size_t)snprintf(text + at, MAX_HEADER - at, "property uchar f_rest_%zu\n", i);
    at += (size_t)snprintf(text + at, MAX_HEADER - at, "end_header\n");
    return at;
}

static uint64_t body_bytes(const struct export *x, size_t n)
{
    return chunks_of(n) * RANGES * sizeof(float) + (uint64_t)n * (VERTEX + n_rest(x));
}

static uint64_t compressed_bytes(const void *self, size_t n)
{
    static const struct spin_frame_info info;
    char text[MAX_HEADER];

    return make_header(self, &info, n, text) + body_bytes(self, n);
}

static spin_status write_chunks(struct export *x)
{
    struct spin_frames *frames = &x->frames;
    const struct spin_splat_filter *rows = &frames->rows;
    size_t bytes = CHUNKS_PER_TASK * RANGES * sizeof(float) + SPIN_ROWS_BLOCK * VERTEX;
    size_t n_tasks = (rows->n_kept + SPIN_ROWS_BLOCK - 1) / SPIN_ROWS_BLOCK;

    SPIN_TRY(spin_frames_scratch(frames, bytes, &x->scratch));
    atomic_store(&x->error, 0);
    spin_pool_run(rows->pool, (int)n_tasks, pack_task, x);
    for (size_t b = 0; b < spin_splat_filter_blocks(rows); b++)
        spin_splat_filter_rest(rows, b, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES);
    return x->error ? spin_out_failed(x->out, x->error) : SPIN_OK;
}

static spin_status compressed_write(void *self, const struct spin_frame_info *info,
                                    struct spin_out *out)
{
    struct export *x = self;
    size_t n = x->frames.rows.n_kept;
    char text[MAX_HEADER];

    SPIN_TRY(choose_order(x));
    SPIN_TRY(spin_frames_quants(&x->frames, &x->quant));
    spin_splat_filter_each(&x->frames.rows, scatter_block, x);
    x->out = out;
    x->range_at = make_header(x, info, n, text);
    x->vertex_at = x->range_at + chunks_of(n) * RANGES * sizeof(float);
    SPIN_TRY(spin_out_write_at(out, 0, text, (size_t)x->range_at));
    SPIN_TRY(write_chunks(x));
    SPIN_TRY(spin_out_write_at(out, x->vertex_at + n * VERTEX, x->rest, n * n_rest(x)));
    spin_frames_merge(&x->frames);
    return SPIN_OK;
}

/* The very header that would be written, and rows to its end. */
static bool compressed_complete(void *self, const struct spin_frame_info *info,
                                const struct spin_map *map, size_t *n)
{
    static const char key[] = "element vertex ";
    const struct export *x = self;
    char text[MAX_HEADER + 1], *at;
    size_t n_header = map->size < MAX_HEADER ? map->size : MAX_HEADER;

    memcpy(text, map->data, n_header);
    text[n_header] = '\0';
    at = strstr(text, key);
    if (!at)
        return false;
    *n = strtoul(at + sizeof key - 1, NULL, 10);
    if (*n > info->n)
        return false;
    n_header = make_header(x, info, *n, text);
    return map->size == n_header + body_bytes(x, *n) && memcmp(map->data, text, n_header) == 0;
}

static spin_status compressed_order(void *self, const uint32_t **row)
{
    struct export *x = self;

    SPIN_TRY(choose_order(x));
    *row = x->row;
    return SPIN_OK;
}

static spin_status find_elements(const struct spin_ply *ply, size_t n_sh,
                                 const unsigned char *out[3], size_t *n)
{
    static const char *const names[] = {"chunk", "vertex", "sh"};
    const size_t bytes[] = {RANGES * sizeof(float), VERTEX, n_sh};
    const struct spin_ply_element *e[3];

    for (int i = 0; i < (n_sh > 0 ? 3 : 2); i++) {
        e[i] = spin_ply_find_element(ply, names[i]);
        if (!e[i] || e[i]->has_list || e[i]->stride != bytes[i] || ply->ascii || ply->big_endian)
            return spin_fail(SPIN_E_MALFORMED, "no element '%s' of %zu bytes", names[i], bytes[i]);
        out[i] = ply->map.data + e[i]->data_offset;
    }
    *n = (size_t)e[1]->count;
    if (e[0]->count != chunks_of(*n) || (n_sh > 0 && e[2]->count != *n))
        return spin_fail(SPIN_E_MALFORMED, "elements of %zu splats do not agree", *n);
    return SPIN_OK;
}

/* Row i as PlayCanvas's engine decodes it. */
static void read_row(const unsigned char *const element[3], size_t i, struct spin_splats *out)
{
    size_t n_sh = (size_t)spin_sh_count(out->sh_degree), n = n_sh - 1;
    struct spin_quant_error_row row;
    float range[RANGES];
    uint32_t word[4];

    memcpy(range, element[0] + i / CHUNK * sizeof range, sizeof range);
    memcpy(word, element[1] + i * VERTEX, sizeof word);
    spin_splat_filter_little_endian(range, RANGES);
    spin_splat_filter_little_endian(word, 4);
    unpack_vertex(word, range, &row);
    memcpy(out->means + 3 * i, row.place, sizeof row.place);
    memcpy(out->log_scales + 3 * i, row.log_scale, sizeof row.log_scale);
    memcpy(out->quats + 4 * i, row.rotation, sizeof row.rotation);
    out->logit_opacities[i] = spin_roundtrip_check_logit(row.opacity);
    for (size_t c = 0; c < 3; c++) {
        float *sh = out->sh + 3 * n_sh * i + c;

        sh[0] = (row.colour[c] - 0.5f) / (float)SPIN_SH_C0;
        for (size_t k = 0; k < n; k++)
            sh[3 * (k + 1)] = shown_rest(element[2][(3 * i + c) * n + k]);
    }
}

static spin_status compressed_read(void *self, const struct spin_map *map, int frame,
                                   struct spin_splats *out)
{
    const struct export *x = self;
    const unsigned char *element[3] = {0};
    struct spin_ply ply;
    size_t n = 0;
    spin_status status;

    (void)frame;
    SPIN_TRY(spin_ply_parse("PLY", map->data, map->size, &ply));
    SPIN_TRY_OUT(find_elements(&ply, n_rest(x), element, &n));
    SPIN_TRY_OUT(spin_splats_reserve(out, n, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES,
                                     x->frames.rows.sh_degree));
    for (size_t i = 0; i < n; i++)
        read_row(element, i, out);
out:
    spin_ply_close(&ply);
    return status;
}

/* ---- The plug-in ----------------------------------------------------------------------------- */

static spin_status begin(void *self, const struct spin_export_job *job)
{
    const char *order = spin_plugin_value(job->values, "order", "morton");
    struct export *x = self;

    if (strcmp(order, "morton") != 0 && strcmp(order, "source") != 0)
        return spin_fail(SPIN_E_USAGE, "--order '%s': expected morton or source", order);
    x->by_source = strcmp(order, "source") == 0;
    return SPIN_OK;
}

static void end(void *self)
{
    struct export *x = self;

    spin_sort_rows_free(&x->order);
    free(x->row);
    free(x->place);
    free(x->colour);
    free(x->rest);
}

static const struct spin_frames_format format = {
    .name = "compressed-ply",
    .pattern = "frame_%05d.compressed.ply",
    .self_bytes = sizeof(struct export),
    .lossy = true,
    .begin = begin,
    .bytes = compressed_bytes,
    .write = compressed_write,
    .complete = compressed_complete,
    .read = compressed_read,
    .order = compressed_order,
    .end = end,
};

static spin_status compressed_begin(const struct spin_export_job *job, void **self)
{
    return spin_frames_begin(&format, job, self);
}

extern const struct spin_exporter spin_exporter_compressed_ply;
const struct spin_exporter spin_exporter_compressed_ply = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "compressed-ply",
    .summary = "a folder with one compressed PLY per frame, for SuperSplat and PlayCanvas",
    .options = options,
    .checks = true,
    .antialias = true,
    .wants = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES,
    .begin = compressed_begin,
    .frame = spin_frames_frame,
    .end = spin_frames_end,
    .abort = spin_frames_abort,
    .skip = spin_frames_skip,
};
