/* Whole numbers of one column as bytes, for a page's blocks; exporters/html/format.md has the
 * layout.
 *
 * A column begins with one byte: the planes in bits 0 to 2 (0: all numbers are zero), in bits 4 and
 * 5 what the numbers are told from. Numbers are written d < 0 ? -2 d - 1 : 2 d, low bytes first,
 * then the next higher: a plane of bytes each. */
#pragma once

#include "spin.h"

#define SPIN_PAGE_MOST (1 << 26) /* no number may be larger: sums and products of the decoder fit  \
                                  */

struct spin_page_bytes {
    uint8_t *data;
    size_t n, room;
};
void spin_page_bytes_free(struct spin_page_bytes *b);

/* A key: each of n numbers as it is, or against the one before it, whichever is less. */
spin_status spin_page_put_whole(struct spin_page_bytes *b, const int32_t *x, size_t n);

/* A column of rows: the same, but also against the column before, `other` (NULL: there is none), or
 * against both. */
spin_status spin_page_put_column(struct spin_page_bytes *b, const int32_t *x, const int32_t *other,
                                 size_t n);

/* What a decoder knows of a moving column: the numbers of the frame before, and sixteen times their
 * mean, in which each frame before it counts half as much as the next. */
struct spin_page_state {
    int32_t *last, *mean;
};

/* A difference: a bit for each number that is not as told, then only those, less one. Told from the
 * frame before or from the mean, whichever is less. The state then is that after x. */
spin_status spin_page_put_changes(struct spin_page_bytes *b, const int32_t *x, size_t n,
                                  struct spin_page_state *state);

/* The opposite, from byte *at on, which moves on. SPIN_E_MALFORMED when the bytes end. */
spin_status spin_page_get_whole(const uint8_t *data, size_t size, size_t *at, int32_t *x, size_t n);
spin_status spin_page_get_column(const uint8_t *data, size_t size, size_t *at, int32_t *x,
                                 const int32_t *other, size_t n);
spin_status spin_page_get_changes(const uint8_t *data, size_t size, size_t *at, size_t n,
                                  struct spin_page_state *state);
