/* The rows of a frame, or 4D splats, as an exporter writes them: turned to the file's axes, with a
 * unit rotation and a finite logit. Exporters receive rows that can be drawn (run/row_filter.h),
 * and may split them over several files or nodes with spin_splat_filter_keep(). The options below
 * are common to all formats. */
#pragma once

#include "base/pool.h"
#include "formats/gaussian.h"
#include "math/scene_rotation.h"

/* Defines the exporter `id` with the plug-in name `label`, which reads all columns; the remaining
 * fields of its table follow, `.summary = "..."` and so on. */
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
            "SH degree to write, 0 to 3, filled up with zeros; keep: that of the bundle", "keep"   \
    }
#define SPIN_ROWS_OPTIONS                                                                          \
    {"up", "AXIS",                                                                                 \
     "axis of the source that points up, x, y, z, -x, -y or -z: rotate the scene so that it is y", \
     NULL},                                                                                        \
    {                                                                                              \
        "rotate", "X,Y,Z", "rotate the scene about x, then y, then z, in degrees; after --up",     \
            NULL                                                                                   \
    }

#define SPIN_ROWS_BLOCK 4096 /* rows per task */

struct spin_splat_filter_block;

struct spin_splat_filter {
    /* From the options. */
    struct spin_pool *pool;
    struct spin_scene_rotation turn; /* from the source's axes to those of the file */
    double turn_q[4];                /* the same as a quaternion w x y z */
    bool up;                         /* --up was given: y of the file points up */
    int sh_degree;                   /* to write */

    /* Of the current frame. */
    const struct spin_splats *splats;
    size_t n_kept;
    unsigned char *keep;                   /* [splats] 1: write the row */
    struct spin_splat_filter_block *block; /* [blocks] */

    struct spin_export_report *report; /* of the job, or NULL */
};

/* Reads the common options. `axes` (quaternion w x y z) turns the source's axes to those of the
 * format if --up is not given; NULL: they are the same. Free also after a failure. */
spin_status spin_splat_filter_begin(struct spin_splat_filter *rows,
                                    const struct spin_export_job *job, const double *axes);
/* Parses --sh for splats of degree `kept` (-1: no SH). */
spin_status spin_splat_filter_parse_sh(const char *text, int kept, int *out);
/* For 4D splats: sets the mean number of kept rows visible per frame in the job's report. from: the
 * row of job->splats_4d for each row; NULL: the same. times: of the n_frames frames. */
spin_status spin_splat_filter_report_4d(const struct spin_splat_filter *rows,
                                        const struct spin_export_job *job, const size_t *from,
                                        const double *times, int n_frames);
/* Warns if some frames are written without splats. */
void spin_splat_filter_warn_empty(size_t n_empty, size_t n_frames);
void spin_splat_filter_end(struct spin_splat_filter *rows);

/* Makes s, which must stay valid, the current frame, and keeps all of its rows. */
spin_status spin_splat_filter_choose(struct spin_splat_filter *rows, const struct spin_splats *s);
/* Keeps a part of the current frame: keep[i] is 1 or 0 for each of its rows. */
void spin_splat_filter_keep(struct spin_splat_filter *rows, const unsigned char *keep);
/* The number of kept rows before a block of the frame. */
size_t spin_splat_filter_before(const struct spin_splat_filter *rows, size_t block);
size_t spin_splat_filter_blocks(const struct spin_splat_filter *rows);
/* Runs fn(context, block) for each block of the frame on all threads. */
void spin_splat_filter_each(const struct spin_splat_filter *rows, spin_task_fn fn, void *context);
/* Releases mapped memory of a block's columns that will not be needed soon. */
void spin_splat_filter_rest(const struct spin_splat_filter *rows, size_t block, unsigned columns);

static inline int spin_splat_filter_workers(const struct spin_splat_filter *rows)
{
    return spin_pool_n_threads(rows->pool);
}

/* ---- One row, as it is written --------------------------------------------------------------- */

/* In the axes of the file; rotations have unit length and w >= 0. */
void spin_splat_filter_place(const struct spin_splat_filter *rows, size_t i, float out[3]);
/* A difference of positions: turned, not moved. */
void spin_splat_filter_direction(const struct spin_splat_filter *rows, const float v[3],
                                 float out[3]);
void spin_splat_filter_turned(const struct spin_splat_filter *rows, size_t i, float out[4]);
float spin_splat_filter_opacity(const struct spin_splat_filter *rows, size_t i); /* 0..1 */
void spin_splat_filter_colour(const struct spin_splat_filter *rows, size_t i, float out[3]);
/* All of the above. */
void spin_splat_filter_take(const struct spin_splat_filter *rows, size_t i,
                            struct spin_gaussian *out);
/* The number of SH coefficients that the source has and that are to be written. */
static inline int spin_splat_filter_n_sh(const struct spin_splat_filter *rows)
{
    int from = rows->splats->sh_degree, to = rows->sh_degree;

    return spin_sh_count(from < to ? from : to);
}

/* The first spin_splat_filter_n_sh() of them, [k][3]; stored in `room` [16][3] if they must be
 * turned. */
const float *spin_splat_filter_sh(const struct spin_splat_filter *rows, size_t i, float *room);
