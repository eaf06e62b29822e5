#include "exporters/lib/splat_rows.h"

#include "base/base.h"
#include "math/approx.h"
#include "math/morton.h"

spin_status spin_sort_rows_reserve(struct spin_sort_rows *order, size_t n)
{
    order->n = 0;
    SPIN_TRY(spin_grow(n + 1, sizeof *order->item, (void **)&order->item));
    return spin_grow(n + 1, sizeof *order->spare, (void **)&order->spare);
}

spin_status spin_sort_rows_fill(struct spin_sort_rows *order, const struct spin_splat_rows *rows)
{
    SPIN_TRY(spin_sort_rows_reserve(order, rows->n_kept));
    for (size_t i = 0; i < rows->splats->n; i++)
        if (rows->keep[i])
            order->item[order->n++] = (struct spin_keyed){.row = (uint32_t)i};
    return SPIN_OK;
}

/* A radix sort, from the lowest to the highest bits, with 11 bits per pass. A pass is skipped if
 * these bits are the same in all keys. */
void spin_sort_rows_sort(struct spin_sort_rows *order)
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

/* Maps log(volume times opacity) to an integer that is smaller for larger splats. The bits of a
 * positive float grow with its value and are inverted; those of a negative float grow with its
 * magnitude and are kept. */
static uint64_t size_key(const struct spin_splats *s, size_t i)
{
    const float *scale = s->log_scales + 3 * i;
    float size = scale[0] + scale[1] + scale[2] +
                 logf(fmaxf(spin_sigmoid(spin_finite_logit(s->logit_opacities[i])), 1e-30f));
    uint32_t bits = spin_bits_of_float(size);

    return bits & 0x80000000u ? bits : ~(bits | 0x80000000u);
}

void spin_sort_rows_by_size(struct spin_sort_rows *order, const struct spin_splats *s)
{
    for (size_t i = 0; i < order->n; i++)
        order->item[i].key = size_key(s, order->item[i].row);
    spin_sort_rows_sort(order);
}

void spin_sort_rows_widen(float box[6], const float place[3])
{
    for (int c = 0; c < 3; c++) {
        box[c] = spin_minf(box[c], place[c]);
        box[3 + c] = spin_maxf(box[3 + c], place[c]);
    }
}

uint64_t spin_sort_rows_place_key(const float box[6], const float place[3])
{
    uint64_t key = 0;

    for (int c = 0; c < 3; c++) {
        double width = (double)box[3 + c] - box[c];
        double u = width > 0 ? ((double)place[c] - box[c]) / width : 0;

        key |= spin_morton_spread((uint64_t)(u * SPIN_MORTON_MAX)) << c;
    }
    return key;
}

void spin_sort_rows_by_place(struct spin_sort_rows *order, const struct spin_splats *s)
{
    float box[6] = SPIN_SORT_ROWS_NO_BOX;

    for (size_t i = 0; i < order->n; i++)
        spin_sort_rows_widen(box, s->means + 3 * (size_t)order->item[i].row);
    for (size_t i = 0; i < order->n; i++)
        order->item[i].key |=
            spin_sort_rows_place_key(box, s->means + 3 * (size_t)order->item[i].row);
    spin_sort_rows_sort(order);
}

void spin_sort_rows_free(struct spin_sort_rows *order)
{
    free(order->item);
    free(order->spare);
    *order = (struct spin_sort_rows){0};
}
