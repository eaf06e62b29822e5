/* Static splats of a clip: splats that are written with the same bits in all frames. They are
 * matched by their values, so the order of rows may differ from frame to frame. */
#pragma once

#include <string.h>

#include "exporters/lib/splat_rows.h"

struct spin_static_row {
    uint64_t hash[2]; /* hash of the row's values */
    uint32_t row;
};

struct spin_static_rows {
    size_t n;                     /* number of static rows */
    struct spin_static_row *kept; /* [n] the static rows in the first frame, sorted by hash */
    struct spin_static_row *now;  /* the kept rows of the current frame, sorted by hash */
    unsigned char *keep;          /* [rows of the current frame] 1: the row is kept and dynamic */
    uint32_t *mate; /* [n_first] for each row of the first frame, the matching row of the current
                       frame; UINT32_MAX: the row is not static */
    size_t n_first;
    struct spin_keyed *order; /* [rows] see spin_static_rows_order() */
};

/* Hashes n words of 4 bytes into two 64-bit numbers, with different factors. With 128 bits, equal
 * hashes are assumed to mean equal bytes. */
static inline void spin_static_hash(uint64_t hash[2], const void *words, size_t n)
{
    for (size_t i = 0; i < n; i++) {
        uint32_t word;

        memcpy(&word, (const unsigned char *)words + 4 * i, sizeof word);
        hash[0] = (hash[0] ^ word) * 0x9e3779b97f4a7c15u;
        hash[0] ^= hash[0] >> 29;
        hash[1] = (hash[1] + word) * 0xd6e8feb86659fd93u;
        hash[1] ^= hash[1] >> 32;
    }
}

/* Reads the frames with job->again() and finds the static rows. Stops reading when no static row is
 * left. Set *still to zero before the call, and free it even if the call fails. */
spin_status spin_static_rows_find(struct spin_static_rows *still, struct spin_splat_rows *rows,
                                  const struct spin_export_job *job);
/* Removes the static rows from the kept rows of the frame. Fails with SPIN_E_IO if a static row is
 * missing, because the frame has changed since it was first read. */
spin_status spin_static_rows_leave_out(struct spin_static_rows *still, struct spin_splat_rows *rows,
                                       int number);
/* Keeps only the static rows. May only be called for the first frame, after
 * spin_static_rows_leave_out(). */
void spin_static_rows_only(const struct spin_static_rows *still, struct spin_splat_rows *rows);
/* Sets *order to a list of all kept rows of a frame: first the dynamic rows, then the static rows
 * in the order of the first frame. */
spin_status spin_static_rows_order(struct spin_static_rows *still,
                                   const struct spin_splat_rows *rows, int number,
                                   const struct spin_keyed **order);
void spin_static_rows_free(struct spin_static_rows *still);
