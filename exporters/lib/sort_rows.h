/* The kept rows of a frame as a list, and a stable sort of it by a 64-bit key. */
#ifndef SPIN_EXPORTERS_LIB_SORT_ROWS_H
#define SPIN_EXPORTERS_LIB_SORT_ROWS_H

#include "exporters/lib/splat_filter.h"

struct spin_keyed {
    uint64_t key;
    uint32_t row;
};

struct spin_sort_rows {
    struct spin_keyed *item, *spare; /* [room] */
    size_t n, room;
};

/* The kept rows in the source's order, keys zero. */
static inline spin_status spin_sort_rows_fill(struct spin_sort_rows *order,
                                              const struct spin_splat_filter *rows)
{
    if (rows->n_kept > order->room) {
        SPIN_TRY(spin_grow(rows->n_kept, sizeof *order->item, (void **)&order->item));
        SPIN_TRY(spin_grow(rows->n_kept, sizeof *order->spare, (void **)&order->spare));
        order->room = rows->n_kept;
    }
    order->n = 0;
    for (size_t i = 0; i < rows->splats->n; i++)
        if (rows->keep[i])
            order->item[order->n++] = (struct spin_keyed){.row = (uint32_t)i};
    return SPIN_OK;
}

/* Eleven bits at a time, from the low end; rounds in which all keys agree are skipped. */
static inline void spin_sort_rows_sort(struct spin_sort_rows *order)
{
    enum { BITS = 11, N = 1 << BITS };

    for (int shift = 0; shift < 64; shift += BITS) {
        size_t start[N + 1] = {0};
        struct spin_keyed *sorted = order->spare;

        for (size_t i = 0; i < order->n; i++)
            start[1 + ((order->item[i].key >> shift) & (N - 1))]++;
        if (order->n == 0 || start[1 + ((order->item[0].key >> shift) & (N - 1))] == order->n)
            continue;
        for (int b = 0; b < N; b++)
            start[b + 1] += start[b];
        for (size_t i = 0; i < order->n; i++)
            sorted[start[(order->item[i].key >> shift) & (N - 1)]++] = order->item[i];
        order->spare = order->item;
        order->item = sorted;
    }
}

static inline void spin_sort_rows_free(struct spin_sort_rows *order)
{
    free(order->item);
    free(order->spare);
    *order = (struct spin_sort_rows){0};
}

#endif
