/* Splats that are the same in all frames of a clip: to the bit, as they would be written. They are told by
 * what they hold, so the order of rows may differ from frame to frame. */
#ifndef SPIN_EXPORTERS_LIB_STILL_ROWS_H
#define SPIN_EXPORTERS_LIB_STILL_ROWS_H

#include "exporters/lib/splat_filter.h"

struct spin_still_row {
    uint64_t hash; /* of what the row holds */
    uint32_t row;
};

struct spin_still_rows {
    size_t n;                    /* rows that are the same in all frames */
    struct spin_splats first;    /* the first frame */
    struct spin_still_row *kept; /* [n] of the first frame, by hash */
    struct spin_still_row *now;  /* [room] rows of the frame at hand, by hash */
    unsigned char *keep;         /* [room] 1: a row of the frame at hand that is not one of them */
    uint32_t *mate;  /* [first.n] which row of the frame at hand each is; UINT32_MAX: none */
    uint32_t *order; /* [room] see spin_still_rows_order() */
    size_t room;
};

/* Read all frames by job->again() and find them. Where no row stays, frames are read up to the one that
 * says so. Zero it before, free it also after a failure. */
spin_status spin_still_rows_find(struct spin_still_rows *still, struct spin_splat_filter *rows,
                                 const struct spin_export_job *job);
/* The chosen rows of a frame without those that stay. SPIN_E_IO when one of them is not there: the frame
 * was another one when it was read first. */
spin_status spin_still_rows_leave_out(struct spin_still_rows *still, struct spin_splat_filter *rows,
                                      int number);
/* After it, of the first frame: only those that stay, instead. */
void spin_still_rows_only(const struct spin_still_rows *still, struct spin_splat_filter *rows);
/* All chosen rows of a frame: those that move, then those that stay, in the first frame's order. */
spin_status spin_still_rows_order(struct spin_still_rows *still,
                                  const struct spin_splat_filter *rows, int number,
                                  const uint32_t **order);
void spin_still_rows_free(struct spin_still_rows *still);

#endif
