/* A k-d tree over points: split at the median of the widest axis, leaves of eight. Left-balanced, so
 * the tree is nothing but an order of the points. */
#include "train/knn.h"

#include <float.h>
#include <stdlib.h>

#include "base/err.h"
#include "base/mem.h"

enum { LEAF = 8, NEIGHBOURS = 3, CHUNK = 1024 };

struct tree {
    const float *points;
    uint32_t *order; /* points, leaf after leaf */
    uint8_t *axis;   /* of the split whose median lies at this place */
    size_t n;
    float *mean_dist2;
};

static float coordinate(const struct tree *t, size_t place, int axis)
{
    return t->points[(size_t)t->order[place] * 3 + (size_t)axis];
}

static void swap(struct tree *t, size_t a, size_t b)
{
    uint32_t keep = t->order[a];

    t->order[a] = t->order[b];
    t->order[b] = keep;
}

/* Quickselect: what belongs at `middle` gets there, smaller before it, larger after. */
static void select_middle(struct tree *t, size_t lo, size_t hi, size_t middle, int axis)
{
    while (hi - lo > 1) {
        size_t i = lo, j = hi - 1;
        float pivot = coordinate(t, lo + (hi - lo - 1) / 2, axis); /* never the last */

        for (;;) {
            while (coordinate(t, i, axis) < pivot)
                i++;
            while (coordinate(t, j, axis) > pivot)
                j--;
            if (i >= j)
                break;
            swap(t, i++, j--);
        }
        /* Now [lo, i) <= pivot <= [j + 1, hi), and i is j or j + 1. */
        if (middle <= j)
            hi = j + 1;
        else
            lo = j + 1;
    }
}

static int widest_axis(const struct tree *t, size_t lo, size_t hi)
{
    float width = -1;
    int widest = 0;

    for (int axis = 0; axis < 3; axis++) {
        float low = FLT_MAX, high = -FLT_MAX;

        for (size_t i = lo; i < hi; i++) {
            float x = coordinate(t, i, axis);

            low = x < low ? x : low;
            high = x > high ? x : high;
        }
        if (high - low > width) {
            width = high - low;
            widest = axis;
        }
    }
    return widest;
}

static void build(struct tree *t, size_t lo, size_t hi)
{
    while (hi - lo > LEAF) {
        size_t middle = lo + (hi - lo) / 2;
        int axis = widest_axis(t, lo, hi);

        select_middle(t, lo, hi, middle, axis);
        t->axis[middle] = (uint8_t)axis;
        build(t, lo, middle);
        lo = middle + 1;
    }
}

static void offer(float best[NEIGHBOURS], float d2)
{
    int i = NEIGHBOURS - 1;

    if (d2 >= best[i])
        return;
    for (; i > 0 && best[i - 1] > d2; i--)
        best[i] = best[i - 1];
    best[i] = d2;
}

static void visit(const struct tree *t, size_t place, uint32_t self, float best[NEIGHBOURS])
{
    const float *a = t->points + (size_t)self * 3;
    const float *b = t->points + (size_t)t->order[place] * 3;
    float x = a[0] - b[0], y = a[1] - b[1], z = a[2] - b[2];

    if (t->order[place] != self)
        offer(best, x * x + y * y + z * z);
}

static void search(const struct tree *t, size_t lo, size_t hi, uint32_t self,
                   float best[NEIGHBOURS])
{
    size_t middle;
    float gap;

    if (hi - lo <= LEAF) {
        for (size_t i = lo; i < hi; i++)
            visit(t, i, self, best);
        return;
    }
    middle = lo + (hi - lo) / 2;
    gap = t->points[(size_t)self * 3 + t->axis[middle]] - coordinate(t, middle, t->axis[middle]);
    if (gap < 0)
        search(t, lo, middle, self, best);
    else
        search(t, middle + 1, hi, self, best);
    visit(t, middle, self, best);
    if (gap * gap < best[NEIGHBOURS - 1]) {
        if (gap < 0)
            search(t, middle + 1, hi, self, best);
        else
            search(t, lo, middle, self, best);
    }
}

static void measure(void *context, int task, int worker)
{
    struct tree *t = context;
    size_t first = (size_t)task * CHUNK, last = first + CHUNK < t->n ? first + CHUNK : t->n;

    (void)worker;
    for (size_t i = first; i < last; i++) {
        float best[NEIGHBOURS] = {FLT_MAX, FLT_MAX, FLT_MAX}, sum = 0;
        uint32_t self = t->order[i];
        int found = 0;

        search(t, 0, t->n, self, best);
        for (; found < NEIGHBOURS && best[found] < FLT_MAX; found++)
            sum += best[found];
        t->mean_dist2[self] = found ? sum / (float)found : 0;
    }
}

spin_status spin_knn_mean_dist2(struct spin_pool *pool, size_t n, const float *points,
                                float *mean_dist2)
{
    struct tree t = {.points = points, .n = n, .mean_dist2 = mean_dist2};
    spin_status status;
    void *order = NULL, *axis = NULL;

    SPIN_TRY_OUT(spin_alloc(n + 1, sizeof *t.order, &order));
    SPIN_TRY_OUT(spin_alloc(n + 1, 1, &axis));
    t.order = order;
    t.axis = axis;
    for (size_t i = 0; i < n; i++)
        t.order[i] = (uint32_t)i;
    build(&t, 0, n);
    spin_pool_run(pool, (int)((n + CHUNK - 1) / CHUNK), measure, &t);
out:
    free(order);
    free(axis);
    return status;
}
