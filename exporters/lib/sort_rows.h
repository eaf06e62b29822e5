/* The kept rows of a frame as a list, and a stable sort of this list by 64-bit keys. */
#pragma once

#include "exporters/lib/splat_rows.h"

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
