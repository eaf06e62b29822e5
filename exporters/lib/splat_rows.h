/* The rows of a frame, or 4D splats, as an exporter writes them: rotated to the axes of the file,
 * with quaternions of unit length and finite logits. Exporters only receive rows that can be drawn
 * (run/row_filter.h), and may distribute them among several files or nodes with
 * spin_splat_rows_keep(). The options below are common to all formats. */
#pragma once

#include "base/pool.h"
#include "formats/gaussian.h"
#include "math/scene_rotation.h"

/* Defines the exporter `id` with the plug-in name `label`, which reads all columns. The further
 * arguments initialise the remaining fields, such as .summary. */
#define SPIN_EXPORTER(id, label, ...)                                                              \
    const struct spin_exporter spin_exporter_##id = {.abi = SPIN_PLUGIN_ABI,                       \
                                                     .name = label,                                \
                                                     .wants =                                      \
                                                         SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES,     \
                                                     __VA_ARGS__}
/* Defines an exporter whose begin() allocates a zeroed `struct export` and calls prepare(x, job),
 * and whose end() calls finish(x). discard(void *x) serves as abort() and is also called after
 * finish() and after a failure of prepare(): it frees everything and removes files that were not
 * committed. */
#define SPIN_OWN_EXPORTER(id, label, prepare, finish, discard, ...)                                \
    static spin_status spin_begin_##id(const struct spin_export_job *job, void **self)             \
    {                                                                                              \
        void *x;                                                                                   \
        spin_status status;                                                                        \
                                                                                                   \
        SPIN_TRY(spin_alloc(1, sizeof(struct export), &x));                                        \
        status = prepare(x, job);                                                                  \
        if (status == SPIN_OK)                                                                     \
            *self = x;                                                                             \
        else                                                                                       \
            discard(x);                                                                            \
        return status;                                                                             \
    }                                                                                              \
                                                                                                   \
    static spin_status spin_end_##id(void *self)                                                   \
    {                                                                                              \
        spin_status status = finish(self);                                                         \
                                                                                                   \
        discard(self);                                                                             \
        return status;                                                                             \
    }                                                                                              \
                                                                                                   \
    SPIN_EXPORTER(id, label, .begin = spin_begin_##id, .end = spin_end_##id, .abort = discard,     \
                  __VA_ARGS__)

#define SPIN_ROWS_OPTION_SH                                                                        \
    {                                                                                              \
        "sh", "DEGREE",                                                                            \
            "SH degree to write, 0 to 3, padded with zeros; keep: the degree of the bundle",       \
            "keep"                                                                                 \
    }
#define SPIN_ROWS_OPTIONS                                                                          \
    {"up", "AXIS",                                                                                 \
     "rotate the scene so that this axis of the source points up, along y: x, y, z, -x, -y or -z", \
     NULL},                                                                                        \
    {                                                                                              \
        "rotate", "X,Y,Z", "rotate the scene about x, then y, then z, in degrees; after --up",     \
            NULL                                                                                   \
    }

#define SPIN_ROWS_BLOCK 4096 /* number of rows of a block; each block is a task */

struct spin_splat_rows_block;

struct spin_splat_rows {
    /* The following members are set from the options. */
    struct spin_pool *pool;
    struct spin_scene_rotation turn; /* rotation from the source's axes to those of the file */
    double turn_q[4];                /* `turn` as a quaternion w x y z */
    bool up;       /* true: --up was given without --rotate, so y of the file points up */
    int sh_degree; /* SH degree to write */

    /* The following members describe the current frame. */
    const struct spin_splats *splats;
    size_t n_kept;
    unsigned char *keep;                 /* [splats] 1: write the row */
    struct spin_splat_rows_block *block; /* [blocks] */

    struct spin_export_report *report; /* the report of the job; NULL: none */
};

/* Sets q (w x y z) to the rotation of --rotate "X,Y,Z". */
spin_status spin_splat_rows_parse_rotate(const char *text, double q[4]);

/* Reads the common options. `axes` (quaternion w x y z) rotates the source's axes to those of the
 * format, unless --up is given; NULL: the axes are the same. Call spin_splat_rows_end() also
 * after a failure. */
spin_status spin_splat_rows_begin(struct spin_splat_rows *rows, const struct spin_export_job *job,
                                  const double *axes);
/* Parses the value of --sh and sets *out to the SH degree to write. The value "keep" selects
 * `kept`, the degree of the splats, or -1 if they have no SH. */
spin_status spin_splat_rows_parse_sh(const char *text, int kept, int *out);
/* For 4D splats: computes, for the job's report, how many of the kept rows are visible in a frame
 * on average. from: for each row, the row of job->splats_4d that it was made from; NULL: the
 * indices are the same. times: the times of the n_frames frames. */
spin_status spin_splat_rows_report_4d(const struct spin_splat_rows *rows,
                                      const struct spin_export_job *job, const size_t *from,
                                      const double *times, int n_frames);
/* Warns if some frames are written without splats. */
void spin_splat_rows_warn_empty(size_t n_empty, size_t n_frames);
void spin_splat_rows_end(struct spin_splat_rows *rows);

/* Makes *s the current frame and keeps all of its rows. *s must stay valid while it is the current
 * frame. */
spin_status spin_splat_rows_choose(struct spin_splat_rows *rows, const struct spin_splats *s);
/* Keeps a part of the current frame: keep[i] is 1 or 0 for each of its rows. */
void spin_splat_rows_keep(struct spin_splat_rows *rows, const unsigned char *keep);
/* Returns the number of kept rows before a block of the frame. */
size_t spin_splat_rows_before(const struct spin_splat_rows *rows, size_t block);
size_t spin_splat_rows_blocks(const struct spin_splat_rows *rows);
/* Runs fn(context, block) for each block of the frame on all threads. */
void spin_splat_rows_each(const struct spin_splat_rows *rows, spin_task_fn fn, void *context);
/* Releases the mapped memory of these columns of a block. Call it if they will not be needed
 * soon. */
void spin_splat_rows_release(const struct spin_splat_rows *rows, size_t block, unsigned columns);

static inline int spin_splat_rows_workers(const struct spin_splat_rows *rows)
{
    return spin_pool_n_threads(rows->pool);
}

/* ---- One row, as it is written --------------------------------------------------------------- */

/* These functions return values in the axes of the file; quaternions have unit length and w >= 0.
 */
void spin_splat_rows_place(const struct spin_splat_rows *rows, size_t i, float out[3]);
/* Sets `out` to v, a difference of two positions, rotated to the axes of the file. */
void spin_splat_rows_direction(const struct spin_splat_rows *rows, const float v[3], float out[3]);
void spin_splat_rows_turned(const struct spin_splat_rows *rows, size_t i, float out[4]);
float spin_splat_rows_opacity(const struct spin_splat_rows *rows, size_t i); /* 0..1 */
void spin_splat_rows_colour(const struct spin_splat_rows *rows, size_t i, float out[3]);
/* Sets all members of *out: position, scale, rotation, opacity and colour. */
void spin_splat_rows_get(const struct spin_splat_rows *rows, size_t i, struct spin_gaussian *out);
/* Returns the number of SH coefficients per row that the source contains and that are to be
 * written. */
static inline int spin_splat_rows_n_sh(const struct spin_splat_rows *rows)
{
    int from = rows->splats->sh_degree, to = rows->sh_degree;

    return spin_sh_count(from < to ? from : to);
}

/* Returns the first spin_splat_rows_n_sh() SH coefficients of row i, [k][3]. If they must be
 * rotated, they are stored in `room` [16][3]. */
const float *spin_splat_rows_sh(const struct spin_splat_rows *rows, size_t i, float *room);

/* ---- Sorted rows ----------------------------------------------------------------------------- */

/* The kept rows of a frame as a list, and a stable sort of this list by 64-bit keys. */

struct spin_keyed {
    uint64_t key;
    uint32_t row;
};

struct spin_sort_rows {
    struct spin_keyed *item, *spare; /* [kept rows] */
    size_t n;
};

/* Reserves memory for n items, and sets order->n to 0. */
spin_status spin_sort_rows_reserve(struct spin_sort_rows *order, size_t n);
/* Lists the kept rows in the order of the source, with keys of 0. Set *order to zero before the
 * first call, and free it with spin_sort_rows_free(). */
spin_status spin_sort_rows_fill(struct spin_sort_rows *order, const struct spin_splat_rows *rows);

/* Sorts by ascending key; rows with equal keys keep their order. */
void spin_sort_rows_sort(struct spin_sort_rows *order);
/* Sets the keys and sorts by volume times opacity, in descending order, so that the largest and
 * most opaque splats come first. */
void spin_sort_rows_by_size(struct spin_sort_rows *order, const struct spin_splats *s);

/* Sets the keys and sorts in Morton order: neighbours in space are mostly neighbours in the list.
 */
void spin_sort_rows_by_place(struct spin_sort_rows *order, const struct spin_splats *s);

/* The same in two steps, for callers that do not have all positions in memory: widen the box by all
 * positions, then compute the key of each. */
#define SPIN_SORT_ROWS_NO_BOX                                                                      \
    {                                                                                              \
        INFINITY, INFINITY, INFINITY, -INFINITY, -INFINITY, -INFINITY                              \
    }
void spin_sort_rows_widen(float box[6], const float place[3]);
uint64_t spin_sort_rows_place_key(const float box[6], const float place[3]);

void spin_sort_rows_free(struct spin_sort_rows *order);
