/* Encodes 4D splats as blocks of a web page, for clips with evenly spaced frames: each splat is
 * stored once, with its path, its window and the time in which it is visible.
 * exporters/html/format.md describes the columns.
 *
 * The page counts time in ticks from the first frame. All values of a row are within their bounds
 * at every tick in which the row is visible. Paths are stored as positions at evenly spaced times;
 * the bound of an opacity is divided among height, centre and width of the window. A splat that
 * rotates by more than 90 degrees becomes several consecutive rows. */
#pragma once

#include "exporters/lib/page_group.h"
#include "io/json.h"

enum { SPIN_PAGE_TICKS = 16 }; /* number of ticks from one frame to the next */

struct spin_page_rows {
    /* The caller sets the following members. */
    struct spin_page_space space;
    struct spin_pool *pool;
    const struct spin_splats_4d *splats;
    int n_sh, n_frames, key_every;
    const double *times; /* [n_frames] times of the frames in the source's unit */
    double step;         /* time from one frame to the next */

    /* spin_page_rows_begin() sets the following members. */
    /* `space` with smaller bounds, which determine the quantisation steps. */
    struct spin_page_space inner;
    int octave; /* number of quantisation steps from a sigma to twice that sigma */
    /* Quantisation steps. middle: of the centre of a time window, as a multiple of sigma rounded
     * down to an octave; gate: of a gate; ratio: of the logarithm of the ratio of two quaternions'
     * lengths; phase: of the phase in radians; cosine, cosine_sh: of the amplitudes of colours and
     * of SH coefficients. */
    double middle, gate, ratio;
    double phase, cosine, cosine_sh;
    /* The number of columns, and the index of the first column of each optional part; 0: the part
     * is absent. */
    int n_columns, path, plateau, gates, turn, cosines;

    /* spin_page_rows_write() sets the following members. */
    struct spin_quant_error quant; /* errors of all rows; those of rotations are in radians */
    uint64_t n_values;
};

struct spin_page_rows_block {
    size_t n;
    int from, end; /* rows of the block are visible in ticks `from` to `end` - 1 only */
    const uint8_t *data;
    size_t n_bytes;
};
typedef spin_status (*spin_page_rows_sink)(void *context, const struct spin_page_rows_block *block);

/* Sets *step to the mean time from one frame to the next. Returns true if the frames are spaced so
 * evenly that 4D splats can be written as rows. */
bool spin_page_rows_can(const double *times, int n_frames, double *step);
/* Chooses the quantisation steps and the columns. */
void spin_page_rows_begin(struct spin_page_rows *r);
/* Writes the kept rows. The current frame of `rows` must be the result of spin_splats_of_4d(). The
 * first block contains the rows that are visible for more than two key intervals; the other blocks
 * are in order of time. Each block is decoded and compared with the bounds before it is passed to
 * the sink. */
spin_status spin_page_rows_write(struct spin_page_rows *r, const struct spin_splat_rows *rows,
                                 spin_page_rows_sink sink, void *context);
/* Returns the parameters that the page needs to decode the rows. */
spin_json *spin_page_rows_json(const struct spin_page_rows *r);
