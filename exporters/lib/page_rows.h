/* 4D splats as blocks of a page: a row once, with its path, its window and the time that it is
 * seen, for a clip whose frames are evenly spaced. exporters/html/format.md says what its columns
 * are.
 *
 * The page's time counts frames from the first, in ticks. At each tick of a row all its values are
 * within the bounds: a path by its places at even times, an opacity by its shares for height,
 * middle and width of the window. A row that turns far is written as several, one after the other.
 */
#pragma once

#include "exporters/lib/page_group.h"
#include "io/json.h"

enum { SPIN_PAGE_TICKS = 16 }; /* of a frame */

struct spin_page_rows {
    /* Set by the caller. */
    struct spin_page_space space;
    struct spin_pool *pool;
    const struct spin_splats_4d *splats;
    int n_sh, n_frames, key_every;
    const double *times; /* [n_frames] of the frames, in the source's unit */
    double step;         /* from one of them to the next */

    /* Set by spin_page_rows_begin(). */
    struct spin_page_space inner; /* bounds of the numbers themselves */
    int octave;                   /* steps of a sigma until it is doubled */
    double middle, gate, ratio;   /* steps: of a sigma's octave, of a gate, of a logarithm */
    double phase, cosine, cosine_sh;
    int n_columns, path, plateau, gates, turn, cosines; /* where columns begin; 0: there are none */

    /* Set by spin_page_rows_write(). */
    struct spin_quant_error quant; /* rotations in radians */
    uint64_t n_rows, n_values;
};

struct spin_page_rows_block {
    size_t n;
    int from, end; /* ticks: nothing of it is seen before or after */
    const uint8_t *data;
    size_t n_bytes;
};
typedef spin_status (*spin_page_rows_sink)(void *context, const struct spin_page_rows_block *block);

/* Whether frames at these times are as evenly spaced as rows need; sets the step. */
bool spin_page_rows_can(const double *times, int n_frames, double *step);
/* Chooses steps and columns. */
void spin_page_rows_begin(struct spin_page_rows *r);
/* The rows that the filter keeps, whose frame is `view`: the arrays of the splats as those of one.
 * Blocks come by time, first that of rows which last; each is read back and held to the bounds
 * before. */
spin_status spin_page_rows_write(struct spin_page_rows *r, const struct spin_splat_filter *rows,
                                 spin_page_rows_sink sink, void *context);
/* What the page must know to read them. */
spin_json *spin_page_rows_json(const struct spin_page_rows *r);
