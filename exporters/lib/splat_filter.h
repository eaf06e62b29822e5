/* What every exporter asks of a frame's rows: which can be drawn at all, and how each is written -
 * turned, its rotation of unit length, its logit finite. The options that go with it are common to
 * all formats; the rules stand in splat_filter.c. */
#pragma once

#include "base/pool.h"
#include "formats/gaussian.h"
#include "math/drawable.h"
#include "math/scene_rotation.h"

/* Defines the exporter `id`, the plug-in `label`, of all columns; what else its table has follows,
 * `.summary = "..."` and so on. */
#define SPIN_EXPORTER(id, label, ...)                                                              \
    const struct spin_exporter spin_exporter_##id = {.abi = SPIN_PLUGIN_ABI,                       \
                                                     .name = label,                                \
                                                     .wants =                                      \
                                                         SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES,     \
                                                     __VA_ARGS__}
/* Defines an exporter whose begin() makes a `struct export` of zeros, which prepare(it, job) fills,
 * and whose end() does finish(it). discard(void *it) is its abort(), and comes after a failure of
 * prepare() and after finish() too: it frees all, and removes what was not committed. */
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
            "SH degree to write, 0 to 3; missing ones are zeros; keep: that of the bundle", "keep" \
    }
#define SPIN_ROWS_OPTIONS                                                                          \
    {"min-opacity", "V", "leave out splats whose opacity is below V, 0 to 1", "0"},                \
        {"max-scale", "F",                                                                         \
         "leave out splats larger than F times the diagonal of the frame; 0: none", "1"},          \
        {"up", "AXIS",                                                                             \
         "the source's axis that points up, x, y, z, -x, -y or -z: the scene is turned so that "   \
         "y does",                                                                                 \
         NULL},                                                                                    \
    {                                                                                              \
        "rotate", "X,Y,Z", "turn the scene about x, then y, then z, in degrees; after --up", NULL  \
    }

#define SPIN_ROWS_BLOCK 4096 /* rows that one task takes */

struct spin_splat_filter_block;

struct spin_splat_filter {
    /* How; from the options. */
    struct spin_pool *pool;
    struct spin_scene_rotation turn; /* from the source's axes to those of the file */
    double turn_q[4];                /* the same */
    bool up;                         /* --up was given: y of the file points up */
    int sh_degree;                   /* to write */
    float min_logit;                 /* rows below are left out */
    double max_scale;                /* diagonals of the frame; 0: no limit */

    /* The frame at hand. */
    const struct spin_splats *splats;
    size_t n_kept;
    unsigned char *keep;                   /* [splats] 1 for a row to write */
    struct spin_splat_filter_block *block; /* [blocks] */

    /* The clip. */
    bool quiet; /* these frames were counted before: say nothing, add nothing */
    uint64_t n_left_out[SPIN_ROWS_REASONS];
    struct spin_export_report *report; /* of the job, or NULL */
};

/* Read the common options. `axes` (w x y z) turns the source's axes to those that the format is
 * written in when --up is not given; NULL: they are the same. Free also after a failure. */
spin_status spin_splat_filter_begin(struct spin_splat_filter *rows,
                                    const struct spin_export_job *job, const double *axes);
/* An --sh of the user's, of splats of degree `kept` (-1: none). */
spin_status spin_splat_filter_parse_sh(const char *text, int kept, int *out);
/* 4D splats: the mean number of splats that the kept rows show in each frame becomes the job's
 * report's. from: the row of job->splats_4d that each row is; NULL: the same. times: those of the
 * n_frames frames that are written. */
spin_status spin_splat_filter_report_4d(const struct spin_splat_filter *rows,
                                        const struct spin_export_job *job, const size_t *from,
                                        const double *times, int n_frames);
/* A warning when some frames are written without a splat. */
void spin_splat_filter_warn_empty(size_t n_empty, size_t n_frames);
/* Tell the job's report what was left out, and free. */
void spin_splat_filter_end(struct spin_splat_filter *rows);

/* Mark the rows of a frame that are written, and count them; say how many cannot be drawn. */
spin_status spin_splat_filter_choose(struct spin_splat_filter *rows, const struct spin_splats *s,
                                     int number);
/* Mark others of the frame at hand instead: keep[i] is 1 or 0 for each of its rows. */
void spin_splat_filter_keep(struct spin_splat_filter *rows, const unsigned char *keep);
/* Kept rows before a block of the frame. */
size_t spin_splat_filter_before(const struct spin_splat_filter *rows, size_t block);
size_t spin_splat_filter_blocks(const struct spin_splat_filter *rows);
/* All threads: fn(context, block) for each block of the frame. */
void spin_splat_filter_each(const struct spin_splat_filter *rows, spin_task_fn fn, void *context);
/* The rows of a block will not be looked at again soon. */
void spin_splat_filter_rest(const struct spin_splat_filter *rows, size_t block, unsigned columns);

static inline int spin_splat_filter_workers(const struct spin_splat_filter *rows)
{
    return spin_pool_n_threads(rows->pool);
}

/* ---- One row, as it is written ----------------------------------------------------------------
 */

/* Turned to the axes of the file; the rotation of unit length, w >= 0. */
void spin_splat_filter_place(const struct spin_splat_filter *rows, size_t i, float out[3]);
/* A difference of places, as it is written: turned only. */
void spin_splat_filter_direction(const struct spin_splat_filter *rows, const float v[3],
                                 float out[3]);
void spin_splat_filter_turned(const struct spin_splat_filter *rows, size_t i, float out[4]);
float spin_splat_filter_opacity(const struct spin_splat_filter *rows, size_t i); /* 0..1 */
void spin_splat_filter_colour(const struct spin_splat_filter *rows, size_t i, float out[3]);
/* All of these. */
void spin_splat_filter_take(const struct spin_splat_filter *rows, size_t i,
                            struct spin_gaussian *out);
/* Coefficients of a row that there are and that are wanted. */
static inline int spin_splat_filter_n_sh(const struct spin_splat_filter *rows)
{
    int from = rows->splats->sh_degree, to = rows->sh_degree;

    return spin_sh_count(from < to ? from : to);
}

/* The first spin_splat_filter_n_sh() of them, [k][3]; in `room` [16][3] where they must be turned.
 */
const float *spin_splat_filter_sh(const struct spin_splat_filter *rows, size_t i, float *room);
