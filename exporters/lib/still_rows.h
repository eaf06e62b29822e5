/* Splats that are the same in all frames of a clip: to the bit, as they would be written. They are
 * told by what they hold, so the order of rows may differ from frame to frame. */
#pragma once

#include <string.h>

#include "exporters/lib/sort_rows.h"

struct spin_still_row {
    uint64_t hash[2]; /* of what the row holds */
    uint32_t row;
};

struct spin_still_rows {
    size_t n;                    /* rows that are the same in all frames */
    struct spin_still_row *kept; /* [n] of the first frame, by hash */
    struct spin_still_row *now;  /* the chosen rows of the frame at hand, by hash */
    unsigned char *keep;         /* [rows] 1: a row of the frame at hand that is not one of them */
    uint32_t *mate; /* [n_first] of rows of the first frame: which row of the frame at hand each is;
                     * UINT32_MAX: none */
    size_t n_first;
    struct spin_keyed *order; /* [rows] see spin_still_rows_order() */
};

/* n words of 4 bytes into two numbers of 64 bits, mixed by different factors: equal ones mean equal
 * bytes. */
static inline void spin_still_hash(uint64_t hash[2], const void *words, size_t n)
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

/* Read all frames by job->again() and find them. Where no row stays, frames are read up to the one
 * that says so. Zero it before, free it also after a failure. */
spin_status spin_still_rows_find(struct spin_still_rows *still, struct spin_splat_filter *rows,
                                 const struct spin_export_job *job);
/* The chosen rows of a frame without those that stay. SPIN_E_IO when one of them is not there: the
 * frame was another one when it was read first. */
spin_status spin_still_rows_leave_out(struct spin_still_rows *still, struct spin_splat_filter *rows,
                                      int number);
/* After it, of the first frame: only those that stay, instead. */
void spin_still_rows_only(const struct spin_still_rows *still, struct spin_splat_filter *rows);
/* All chosen rows of a frame: those that move, then those that stay, in the first frame's order. */
spin_status spin_still_rows_order(struct spin_still_rows *still,
                                  const struct spin_splat_filter *rows, int number,
                                  const struct spin_keyed **order);
void spin_still_rows_free(struct spin_still_rows *still);
