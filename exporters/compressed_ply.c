/* Writes one compressed PLY per frame in PlayCanvas's layout (formats/compressed_ply.h). The axes
 * are those of the training, unless --up or --rotate rotates the scene.
 *
 * The values of a chunk are quantised within their common range. Rows are sorted in Morton order,
 * which keeps these ranges small; --order source keeps the source's order at the cost of precision.
 *
 * SH is by far the largest column. All SH are read once, in the order of the source, and are packed
 * into an array in the order of the file, so that pages of the mapped bundle can be released early.
 */
#include <stdatomic.h>

#include "base/base.h"
#include "exporters/lib/frames.h"
#include "formats/compressed_ply.h"

#define CHUNK SPIN_COMPRESSED_CHUNK
#define RANGES SPIN_COMPRESSED_RANGES
#define VERTEX SPIN_COMPRESSED_VERTEX
#define CHUNKS_PER_TASK (SPIN_ROWS_BLOCK / CHUNK)

static const struct spin_plugin_option options[] = {
    SPIN_FRAMES_OPTIONS("frame_%05d.compressed.ply"),
    SPIN_FRAMES_OPTION_FPS,
    SPIN_ROWS_OPTION_SH,
    {"order", "morton|source",
     "order of the splats; source: as in the bundle, with less precise values", "morton"},
    {0},
};

struct export
{
    struct spin_frames frames;

    /* The following members describe the current frame. */
    uint32_t *row;   /* [n] row i of the file is row row[i] of the source */
    uint32_t *place; /* [rows of the source] inverse of `row`: index in the file of a kept row */
    float *colour;   /* [n][3] colours in the order of the file */
    unsigned char *rest; /* [n][n_rest] packed SH above degree 0, in the order of the file */
    unsigned char *scratch;
    struct spin_out *out;
    uint64_t range_at, vertex_at;
    atomic_int error;
};

static int degree_of(const struct export *x) { return x->frames.rows.sh_degree; }

/* ---- One chunk ------------------------------------------------------------------------------- */

static void take_row(const struct export *x, size_t at, struct spin_gaussian *out)
{
    const struct spin_splat_rows *rows = &x->frames.rows;
    size_t i = x->row[at];

    spin_splat_rows_place(rows, i, out->place);
    memcpy(out->log_scale, rows->splats->log_scales + 3 * i, sizeof out->log_scale);
    spin_splat_rows_turned(rows, i, out->rotation);
    out->opacity = spin_splat_rows_opacity(rows, i);
    memcpy(out->colour, x->colour + 3 * at, sizeof out->colour);
}

static void pack_chunk(const struct export *x, size_t first, size_t n, float *range,
                       uint32_t (*word)[4], struct spin_quant_error *quant)
{
    struct spin_gaussian row[CHUNK], shown;

    for (size_t i = 0; i < n; i++)
        take_row(x, first + i, &row[i]);
    spin_compressed_pack(row, n, range, word);
    for (size_t i = 0; i < n; i++) {
        spin_compressed_unpack(word[i], range, &shown);
        spin_quant_error_row(quant, &row[i], &shown);
    }
}

static void pack_task(void *context, int task)
{
    struct export *x = context;
    float *range =
        (float *)(void *)(x->scratch + (size_t)spin_pool_worker() * x->frames.scratch_bytes);
    uint32_t(*word)[4] = (uint32_t(*)[4])(void *)(range + CHUNKS_PER_TASK * RANGES);
    size_t first = (size_t)task * SPIN_ROWS_BLOCK, n = x->frames.rows.n_kept - first;
    size_t n_chunks;
    int error;

    n = n < SPIN_ROWS_BLOCK ? n : SPIN_ROWS_BLOCK;
    n_chunks = spin_compressed_chunks(n);
    for (size_t c = 0; c < n_chunks; c++)
        pack_chunk(x, first + c * CHUNK, n - c * CHUNK < CHUNK ? n - c * CHUNK : CHUNK,
                   range + c * RANGES, word + c * CHUNK, &x->frames.block_quant[task]);
    spin_little_endian(range, n_chunks * RANGES);
    spin_little_endian(word, 4 * n);
    error = spin_out_put(x->out, x->range_at + first / CHUNK * RANGES * sizeof *range, range,
                         n_chunks * RANGES * sizeof *range);
    if (!error)
        error = spin_out_put(x->out, x->vertex_at + first * VERTEX, word, n * VERTEX);
    if (error)
        atomic_store(&x->error, error);
}

/* ---- SH -------------------------------------------------------------------------------------- */

/* Copies colours and packed SH of one block of source rows to the arrays in the order of the file.
 */
static void scatter_block(void *context, int b)
{
    struct export *x = context;
    const struct spin_splat_rows *rows = &x->frames.rows;
    size_t i = (size_t)b * SPIN_ROWS_BLOCK, end = i + SPIN_ROWS_BLOCK;
    size_t n_rest = spin_n_rest(degree_of(x));
    float room[3 * SPIN_SH_MAX], lost[3 * SPIN_SH_MAX];

    for (end = end < rows->splats->n ? end : rows->splats->n; i < end; i++) {
        if (!rows->keep[i])
            continue;
        spin_splat_rows_colour(rows, i, x->colour + 3 * (size_t)x->place[i]);
        spin_compressed_pack_sh(spin_splat_rows_sh(rows, i, room), spin_splat_rows_n_sh(rows),
                                degree_of(x), x->rest + n_rest * x->place[i], lost);
        spin_quant_error_add_sh(&x->frames.block_quant[b], lost, n_rest);
    }
    spin_splat_rows_release(rows, (size_t)b, SPIN_COL_SH);
}

/* ---- Order ----------------------------------------------------------------------------------- */

/* Sorts the kept rows, copies their order to x->row and x->place, and frees the memory of the sort,
 * which is four times as large as x->row. */
static spin_status choose_order(struct export *x)
{
    struct spin_sort_rows *order = &x->frames.order;
    size_t n = x->frames.rows.n_kept + 1;

    SPIN_TRY(spin_frames_order(&x->frames));
    SPIN_TRY(spin_grow(n, sizeof *x->row, (void **)&x->row));
    SPIN_TRY(spin_grow(n, 3 * sizeof *x->colour, (void **)&x->colour));
    SPIN_TRY(spin_grow(n, spin_n_rest(degree_of(x)) + 1, (void **)&x->rest));
    SPIN_TRY(spin_grow(x->frames.rows.splats->n + 1, sizeof *x->place, (void **)&x->place));
    for (size_t i = 0; i < order->n; i++) {
        x->row[i] = order->item[i].row;
        x->place[x->row[i]] = (uint32_t)i;
    }
    spin_sort_rows_free(order);
    return SPIN_OK;
}

/* ---- One file -------------------------------------------------------------------------------- */

static size_t make_header(const struct export *x, const struct spin_frame_info *info, size_t n,
                          char text[SPIN_GS_PLY_MAX_HEADER])
{
    char comments[SPIN_FRAMES_MAX_COMMENTS];

    spin_frames_comments(&x->frames, info, comments);
    return spin_compressed_header(degree_of(x), n, comments, text);
}

static uint64_t compressed_bytes(const void *self, size_t n)
{
    static const struct spin_frame_info info;
    char text[SPIN_GS_PLY_MAX_HEADER];

    return make_header(self, &info, n, text) + spin_compressed_body(degree_of(self), n);
}

static spin_status write_chunks(struct export *x)
{
    struct spin_frames *frames = &x->frames;
    const struct spin_splat_rows *rows = &frames->rows;
    size_t bytes = CHUNKS_PER_TASK * RANGES * sizeof(float) + SPIN_ROWS_BLOCK * VERTEX;
    size_t n_tasks = (rows->n_kept + SPIN_ROWS_BLOCK - 1) / SPIN_ROWS_BLOCK;

    SPIN_TRY(spin_frames_scratch(frames, bytes, &x->scratch));
    atomic_store(&x->error, 0);
    spin_pool_run(rows->pool, (int)n_tasks, pack_task, x);
    for (size_t b = 0; b < spin_splat_rows_blocks(rows); b++)
        spin_splat_rows_release(rows, b, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES);
    return x->error ? spin_out_failed(x->out, x->error) : SPIN_OK;
}

static spin_status compressed_write(void *self, const struct spin_frame_info *info,
                                    struct spin_out *out)
{
    struct export *x = self;
    size_t n = x->frames.rows.n_kept;
    char text[SPIN_GS_PLY_MAX_HEADER];

    SPIN_TRY(choose_order(x));
    spin_splat_rows_each(&x->frames.rows, scatter_block, x);
    x->out = out;
    x->range_at = make_header(x, info, n, text);
    x->vertex_at = x->range_at + spin_compressed_chunks(n) * RANGES * sizeof(float);
    SPIN_TRY(spin_out_write_at(out, 0, text, (size_t)x->range_at));
    SPIN_TRY(write_chunks(x));
    return spin_out_write_at(out, x->vertex_at + n * VERTEX, x->rest,
                             n * spin_n_rest(degree_of(x)));
}

/* ---- The plug-in ----------------------------------------------------------------------------- */

static spin_status parse_options(void *self, const struct spin_export_job *job)
{
    struct export *x = self;
    int order;

    SPIN_TRY(spin_option_word(job->values, "order", "morton|source", &order));
    x->frames.sort = order == 0 ? spin_sort_rows_by_place : NULL;
    return SPIN_OK;
}

static void free_export(void *self)
{
    struct export *x = self;

    free(x->row);
    free(x->place);
    free(x->colour);
    free(x->rest);
}

static const struct spin_frames_format format = {
    .name = "compressed-ply",
    .importer = "ply",
    .pattern = "frame_%05d.compressed.ply",
    .self_bytes = sizeof(struct export),
    .lossy = true,
    .begin = parse_options,
    .bytes = compressed_bytes,
    .write = compressed_write,
    .end = free_export,
};

SPIN_FRAMES_EXPORTER(
    compressed_ply, "compressed-ply",
    .summary = "a folder with one compressed PLY per frame, for SuperSplat and PlayCanvas",
    .options = options, .checks = true, .antialias = true);
