/* 4D splats as blocks of a page: each row once, with its path, its window and the time in which it
 * is visible, for clips with evenly spaced frames. exporters/html/format.md describes the columns.
 *
 * The page counts time in ticks from the first frame. At each tick of a row all its values are
 * within the bounds: a path at evenly spaced sample times; an opacity by dividing its bound among
 * height, centre and width of the window. A row that rotates far is split into consecutive ones. */
#pragma once

#include "exporters/lib/page_group.h"
#include "io/json.h"

enum { SPIN_PAGE_TICKS = 16 }; /* per frame */

struct spin_page_rows {
    /* Set by the caller. */
    struct spin_page_space space;
    struct spin_pool *pool;
    const struct spin_splats_4d *splats;
    int n_sh, n_frames, key_every;
    const double *times; /* [n_frames] in the source's unit */
    double step;         /* between two of them */

    /* Set by spin_page_rows_begin(). */
    struct spin_page_space inner; /* bounds used for quantising */
    int octave;                   /* quantisation steps per doubling of sigma */
    double middle, gate, ratio;   /* steps: of a centre in octaves of sigma, of a gate, of a log */
    double phase, cosine, cosine_sh;
    int n_columns, path, plateau, gates, turn, cosines; /* first column of each; 0: absent */

    /* Set by spin_page_rows_write(). */
    struct spin_quant_error quant; /* rotations in radians */
    uint64_t n_rows, n_values;
};

struct spin_page_rows_block {
    size_t n;
    int from, end; /* ticks: nothing of it is visible outside of them */
    const uint8_t *data;
    size_t n_bytes;
};
typedef spin_status (*spin_page_rows_sink)(void *context, const struct spin_page_rows_block *block);

/* Whether the frames are evenly enough spaced for rows; sets *step. */
bool spin_page_rows_can(const double *times, int n_frames, double *step);
/* Chooses quantisation steps and columns. */
void spin_page_rows_begin(struct spin_page_rows *r);
/* Writes the rows that the filter keeps; its frame is `view`, the arrays of the 4D splats as a
 * frame's. Blocks come in order of time, preceded by that of the rows which last; each is decoded
 * and compared with the bounds before. */
spin_status spin_page_rows_write(struct spin_page_rows *r, const struct spin_splat_filter *rows,
                                 spin_page_rows_sink sink, void *context);
/* The parameters that the page needs to decode the rows. */
spin_json *spin_page_rows_json(const struct spin_page_rows *r);
