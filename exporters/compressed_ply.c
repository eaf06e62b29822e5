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
 * Chunks are packed side by side by all threads. */
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/mem.h"
#include "base/pool.h"
#include "exporters/frames.h"
#include "exporters/order.h"
#include "exporters/quant.h"
#include "math/morton.h"

#define CHUNK 256
#define RANGES 18 /* floats of a chunk */
#define MAX_REST 45
#define CHUNKS_PER_TASK 16
#define SCALE_LIMIT 20.0f /* of the logarithm, as splat-transform has it */
#define SQRT2 1.41421356237309505f

static const struct spin_plugin_option options[] = {
    SPIN_FRAMES_OPTION_PATTERN("frame_%05d.compressed.ply"),
    SPIN_FRAMES_OPTION_SH,
    SPIN_FRAMES_OPTION_MIN_OPACITY,
    {"order", "morton|source", "order of the splats; source: as they were, less precise", "morton"},
    {0},
};

struct export
{
    struct spin_frames frames;
    struct spin_order order;
    struct spin_quant quant;
    struct spin_pool *pool;
    bool by_source;
    int sh_degree; /* written */
    size_t n_rest; /* bytes of sh a row */

    /* One frame, packed. */
    const struct spin_splats *splats;
    size_t room;            /* rows */
    float *range;           /* [chunks][RANGES] */
    uint32_t *vertex;       /* [n][4] */
    unsigned char *rest;    /* [n][n_rest] */
    struct spin_quant *sum; /* [tasks] */
};

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

static uint32_t pack_colour(const struct spin_quant_row *row, const float *low, const float *high)
{
    uint32_t word = 0;

    for (int c = 0; c < 3; c++)
        word = word << 8 | steps(row->colour[c], low[c], high[c], 255);
    return word << 8 | steps(row->opacity, 0, 1, 255);
}

static void unpack_vertex(const uint32_t *word, const float *range, struct spin_quant_row *out)
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

static void range_of(const struct spin_quant_row *row, size_t n, float *range)
{
    for (int i = 0; i < RANGES; i++)
        range[i] = i / 3 % 2 ? -INFINITY : INFINITY;
    for (size_t i = 0; i < n; i++) {
        widen(range, row[i].place);
        widen(range + 6, row[i].log_scale);
        widen(range + 12, row[i].colour);
    }
}

/* f_rest of one row: byte u stands for (u + 0.5) / 32 - 4, the first and the last for the ends. */
static void pack_rest(const struct spin_splats *s, size_t i, size_t n_rest,
                      struct spin_quant *quant, unsigned char *out)
{
    size_t n_from = (size_t)spin_sh_count(s->sh_degree), n = n_rest / 3, at = 0;
    const float *sh = s->sh + i * 3 * n_from;
    float error[MAX_REST];

    for (size_t c = 0; c < 3; c++) {
        for (size_t k = 1; k <= n; k++, at++) {
            float x = k < n_from ? sh[3 * k + c] : 0;
            float u = spin_minf(spin_maxf((x / 8 + 0.5f) * 256, 0), 255);
            unsigned char byte = (unsigned char)u;
            float shown = byte == 0 ? -4 : byte == 255 ? 4 : ((float)byte + 0.5f) / 32 - 4;

            out[at] = byte;
            error[at] = x - shown;
        }
    }
    spin_quant_add_all(quant, SPIN_QUANT_SH, error, at);
}

static void pack_chunk(struct export *x, size_t chunk, struct spin_quant *quant)
{
    size_t first = chunk * CHUNK, n = x->order.n - first < CHUNK ? x->order.n - first : CHUNK;
    float *range = x->range + chunk * RANGES;
    struct spin_quant_row row[CHUNK], shown;

    for (size_t i = 0; i < n; i++) {
        spin_quant_take(x->splats, x->order.item[first + i].row, &row[i]);
        for (int c = 0; c < 3; c++)
            row[i].log_scale[c] =
                spin_minf(spin_maxf(row[i].log_scale[c], -SCALE_LIMIT), SCALE_LIMIT);
    }
    range_of(row, n, range);
    for (size_t i = 0; i < n; i++) {
        uint32_t *word = x->vertex + 4 * (first + i);

        word[0] = pack_3(row[i].place, range, range + 3);
        word[1] = pack_rotation(row[i].rotation);
        word[2] = pack_3(row[i].log_scale, range + 6, range + 9);
        word[3] = pack_colour(&row[i], range + 12, range + 15);
        unpack_vertex(word, range, &shown);
        spin_quant_row(quant, &row[i], &shown);
        pack_rest(x->splats, x->order.item[first + i].row, x->n_rest, quant,
                  x->rest + x->n_rest * (first + i));
    }
}

/* ---- One frame ------------------------------------------------------------------------------- */

static size_t chunks_of(size_t n) { return (n + CHUNK - 1) / CHUNK; }

static void pack_task(void *context, int task, int worker)
{
    struct export *x = context;
    size_t end = chunks_of(x->order.n), chunk = (size_t)task * CHUNKS_PER_TASK;

    (void)worker;
    x->sum[task] = (struct spin_quant){0};
    for (int i = 0; i < CHUNKS_PER_TASK && chunk < end; i++, chunk++)
        pack_chunk(x, chunk, &x->sum[task]);
}

static size_t tasks_of(size_t n) { return (chunks_of(n) + CHUNKS_PER_TASK - 1) / CHUNKS_PER_TASK; }

static spin_status make_room(struct export *x, size_t n)
{
    if (n <= x->room)
        return SPIN_OK;
    SPIN_TRY(spin_grow(chunks_of(n), RANGES * sizeof *x->range, (void **)&x->range));
    SPIN_TRY(spin_grow(n, 4 * sizeof *x->vertex, (void **)&x->vertex));
    SPIN_TRY(spin_grow(n, x->n_rest + 1, (void **)&x->rest));
    SPIN_TRY(spin_grow(tasks_of(n), sizeof *x->sum, (void **)&x->sum));
    x->room = n;
    return SPIN_OK;
}

static void sort_by_place(struct export *x)
{
    float range[6] = {INFINITY, INFINITY, INFINITY, -INFINITY, -INFINITY, -INFINITY};

    for (size_t i = 0; i < x->order.n; i++)
        widen(range, x->splats->means + 3 * (size_t)x->order.item[i].row);
    for (size_t i = 0; i < x->order.n; i++) {
        const float *place = x->splats->means + 3 * (size_t)x->order.item[i].row;

        for (int c = 0; c < 3; c++) {
            double width = (double)range[3 + c] - range[c];
            double u = width > 0 ? ((double)place[c] - range[c]) / width : 0;

            x->order.item[i].key |= spin_morton_spread((uint64_t)(u * SPIN_MORTON_MAX)) << c;
        }
    }
    spin_order_sort(&x->order);
}

static spin_status write_header(const struct export *x, struct spin_out *out)
{
    static const char *const chunk[RANGES] = {
        "min_x",       "min_y",       "min_z",       "max_x",       "max_y",       "max_z",
        "min_scale_x", "min_scale_y", "min_scale_z", "max_scale_x", "max_scale_y", "max_scale_z",
        "min_r",       "min_g",       "min_b",       "max_r",       "max_g",       "max_b"};
    char text[4096];
    int at = snprintf(text, sizeof text,
                      "ply\nformat binary_little_endian 1.0\ncomment Generated by spin4d %s\n"
                      "element chunk %zu\n",
                      SPIN_VERSION, chunks_of(x->order.n));

    for (int i = 0; i < RANGES; i++)
        at += snprintf(text + at, sizeof text - (size_t)at, "property float %s\n", chunk[i]);
    at += snprintf(text + at, sizeof text - (size_t)at,
                   "element vertex %zu\nproperty uint packed_position\n"
                   "property uint packed_rotation\nproperty uint packed_scale\n"
                   "property uint packed_color\n",
                   x->order.n);
    if (x->n_rest > 0)
        at += snprintf(text + at, sizeof text - (size_t)at, "element sh %zu\n", x->order.n);
    for (size_t i = 0; i < x->n_rest; i++)
        at += snprintf(text + at, sizeof text - (size_t)at, "property uchar f_rest_%zu\n", i);
    at += snprintf(text + at, sizeof text - (size_t)at, "end_header\n");
    return spin_out_write(out, text, (size_t)at);
}

static spin_status write_file(struct export *x, struct spin_out *out)
{
    size_t n = x->order.n, n_range = chunks_of(n) * RANGES, n_tasks = tasks_of(n);

    spin_pool_run(x->pool, (int)n_tasks, pack_task, x);
    for (size_t t = 0; t < n_tasks; t++)
        spin_quant_merge(&x->quant, &x->sum[t]);
    spin_rows_little_endian(x->range, n_range);
    spin_rows_little_endian(x->vertex, 4 * n);
    SPIN_TRY(write_header(x, out));
    SPIN_TRY(spin_out_write(out, x->range, n_range * sizeof *x->range));
    SPIN_TRY(spin_out_write(out, x->vertex, n * 4 * sizeof *x->vertex));
    return spin_out_write(out, x->rest, n * x->n_rest);
}

/* ---- The plug-in ----------------------------------------------------------------------------- */

static void finish(struct export *x)
{
    spin_order_free(&x->order);
    if (x->pool)
        spin_pool_free(x->pool);
    free(x->range);
    free(x->vertex);
    free(x->rest);
    free(x->sum);
    free(x);
}

static spin_status compressed_begin(const struct spin_export_job *job, void **self)
{
    const struct spin_plugin_values *v = job->values;
    const char *order = spin_plugin_value(v, "order", "morton");
    struct export *x = NULL;
    spin_status status;

    if (strcmp(order, "morton") != 0 && strcmp(order, "source") != 0)
        return spin_fail(SPIN_E_USAGE, "--order '%s': expected morton or source", order);
    SPIN_TRY(spin_alloc(1, sizeof *x, (void **)&x));
    x->by_source = strcmp(order, "source") == 0;
    SPIN_TRY_OUT(
        spin_rows_parse_sh(spin_plugin_value(v, "sh", "keep"), job->sh_degree, &x->sh_degree));
    x->n_rest = 3 * (size_t)spin_sh_count(x->sh_degree) - 3;
    SPIN_TRY_OUT(spin_pool_create(job->n_threads, &x->pool));
    SPIN_TRY_OUT(spin_frames_begin(&x->frames, job, "frame_%05d.compressed.ply"));
    *self = x;
    return SPIN_OK;
out:
    spin_frames_end(&x->frames);
    finish(x);
    return status;
}

static spin_status compressed_frame(void *self, int frame, const struct spin_frame_info *info,
                                    const struct spin_splats *splats)
{
    struct export *x = self;
    struct spin_out out;
    size_t n_kept;
    spin_status status;

    (void)frame;
    x->splats = splats;
    SPIN_TRY(spin_frames_open(&x->frames, splats, info->number, &n_kept, &out));
    SPIN_TRY_OUT(spin_order_fill(&x->order, &x->frames.rows, splats->n, n_kept));
    SPIN_TRY_OUT(make_room(x, n_kept));
    if (!x->by_source)
        sort_by_place(x);
    SPIN_TRY_OUT(write_file(x, &out));
    return spin_out_commit(&out);
out:
    spin_out_abandon(&out);
    return status;
}

static spin_status compressed_end(void *self)
{
    struct export *x = self;

    spin_quant_say(&x->quant, "compressed-ply");
    spin_frames_end(&x->frames);
    finish(x);
    return SPIN_OK;
}

static void compressed_abort(void *self)
{
    struct export *x = self;

    spin_frames_abandon(&x->frames);
    finish(x);
}

extern const struct spin_exporter spin_exporter_compressed_ply;
const struct spin_exporter spin_exporter_compressed_ply = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "compressed-ply",
    .summary = "a folder with one compressed PLY per frame, for SuperSplat and PlayCanvas",
    .options = options,
    .wants = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES,
    .begin = compressed_begin,
    .frame = compressed_frame,
    .end = compressed_end,
    .abort = compressed_abort,
};
