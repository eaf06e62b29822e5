/* The kept rows of a frame as a list, and a stable sort of it by a 64-bit key. */
#pragma once

#include "exporters/lib/splat_filter.h"

struct spin_keyed {
    uint64_t key;
    uint32_t row;
};

struct spin_sort_rows {
    struct spin_keyed *item, *spare; /* [kept rows] */
    size_t n;
};

/* The kept rows in the source's order, keys zero. Zero *order before; spin_sort_rows_free()
 * releases it. */
spin_status spin_sort_rows_fill(struct spin_sort_rows *order, const struct spin_splat_filter *rows);

/* By rising key; rows of one key keep their order. */
void spin_sort_rows_sort(struct spin_sort_rows *order);
/* Sets the keys and sorts: the largest and least transparent splats come first, by volume times
 * opacity. */
void spin_sort_rows_by_size(struct spin_sort_rows *order, const struct spin_splats *s);

/* Likewise in the order of Morton: neighbours in space mostly stand together. */
void spin_sort_rows_by_place(struct spin_sort_rows *order, const struct spin_splats *s);

void spin_sort_rows_free(struct spin_sort_rows *order);
