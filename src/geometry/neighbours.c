/* A k-d tree, the search for nearest neighbours in it, and Morton codes. */
#include "geometry/neighbours.h"

#include <float.h>

#include "base/base.h"
#include "math/morton.h"

/* ---- A k-d tree ------------------------------------------------------------------------------ */

static float coordinate(const struct spin_kd_tree *t, size_t place, int axis)
{
    return t->points[(size_t)t->order[place] * 3 + (size_t)axis];
}

static void swap_points(struct spin_kd_tree *t, size_t a, size_t b)
{
    uint32_t keep = t->order[a];

    t->order[a] = t->order[b];
    t->order[b] = keep;
}

/* Quickselect: reorders [lo, hi) by the coordinate of this axis, such that no element before
 * position `middle` is larger than the element at `middle`, and no element after it is smaller. */
static void select_middle(struct spin_kd_tree *t, size_t lo, size_t hi, size_t middle, int axis)
{
    while (hi - lo > 1) {
        size_t i = lo, j = hi - 1;
        /* The pivot is not the last element, so both parts are smaller than the range. */
        float pivot = coordinate(t, lo + (hi - lo - 1) / 2, axis);

        for (;;) {
            while (coordinate(t, i, axis) < pivot)
                i++;
            while (coordinate(t, j, axis) > pivot)
                j--;
            if (i >= j)
                break;
            swap_points(t, i++, j--);
        }
        /* Now no element of [lo, i) exceeds the pivot, no element of [j + 1, hi) is below it, and i
         * is j or j + 1. */
        if (middle <= j)
            hi = j + 1;
        else
            lo = j + 1;
    }
}

static int widest_axis(const struct spin_kd_tree *t, size_t lo, size_t hi)
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

static void build_subtree(struct spin_kd_tree *t, size_t lo, size_t hi)
{
    while (hi - lo > SPIN_KD_LEAF) {
        size_t middle = lo + (hi - lo) / 2;
        int axis = widest_axis(t, lo, hi);

        select_middle(t, lo, hi, middle, axis);
        t->axis[middle] = (uint8_t)axis;
        build_subtree(t, lo, middle);
        lo = middle + 1;
    }
}

spin_status spin_kd_tree_open(struct spin_kd_tree *tree, size_t n, const float *points)
{
    tree->points = points;
    tree->n = n;
    SPIN_TRY(spin_alloc(n + 1, sizeof *tree->order, (void **)&tree->order));
    SPIN_TRY(spin_alloc(n + 1, 1, (void **)&tree->axis));
    for (size_t i = 0; i < n; i++)
        tree->order[i] = (uint32_t)i;
    build_subtree(tree, 0, n);
    return SPIN_OK;
}

void spin_kd_tree_close(struct spin_kd_tree *tree)
{
    free(tree->order);
    free(tree->axis);
    memset(tree, 0, sizeof *tree);
}

struct within {
    const struct spin_kd_tree *tree;
    const float *at;
    float reach;
    spin_kd_visit visit;
    void *context;
};

static void visit_subtree(const struct within *w, size_t lo, size_t hi)
{
    size_t middle = lo + (hi - lo) / 2;
    float gap;

    if (hi - lo <= SPIN_KD_LEAF) {
        for (size_t i = lo; i < hi; i++)
            w->visit(w->context, w->tree->order[i]);
        return;
    }
    gap = spin_kd_gap(w->tree, middle, w->at);
    w->visit(w->context, w->tree->order[middle]);
    if (gap <= w->reach)
        visit_subtree(w, lo, middle);
    if (gap >= -w->reach)
        visit_subtree(w, middle + 1, hi);
}

void spin_kd_tree_within(const struct spin_kd_tree *tree, const float at[3], float reach,
                         spin_kd_visit visit, void *context)
{
    visit_subtree(&(struct within){tree, at, reach, visit, context}, 0, tree->n);
}

/* ---- Distances to nearest neighbours --------------------------------------------------------- */

enum { NEIGHBOURS = 3, CHUNK = 1024 };

static void insert_distance(float best[NEIGHBOURS], float d2)
{
    int i = NEIGHBOURS - 1;

    if (d2 >= best[i])
        return;
    for (; i > 0 && best[i - 1] > d2; i--)
        best[i] = best[i - 1];
    best[i] = d2;
}

static void compare_points(const struct spin_kd_tree *t, size_t place, uint32_t self,
                           float best[NEIGHBOURS])
{
    const float *a = t->points + (size_t)self * 3;
    const float *b = t->points + (size_t)t->order[place] * 3;
    float x = a[0] - b[0], y = a[1] - b[1], z = a[2] - b[2];

    if (t->order[place] != self)
        insert_distance(best, x * x + y * y + z * z);
}

static void search_subtree(const struct spin_kd_tree *t, size_t lo, size_t hi, uint32_t self,
                           float best[NEIGHBOURS])
{
    size_t middle;
    float gap;

    if (hi - lo <= SPIN_KD_LEAF) {
        for (size_t i = lo; i < hi; i++)
            compare_points(t, i, self, best);
        return;
    }
    middle = lo + (hi - lo) / 2;
    gap = spin_kd_gap(t, middle, t->points + (size_t)self * 3);
    if (gap < 0)
        search_subtree(t, lo, middle, self, best);
    else
        search_subtree(t, middle + 1, hi, self, best);
    compare_points(t, middle, self, best);
    if (gap * gap < best[NEIGHBOURS - 1]) {
        if (gap < 0)
            search_subtree(t, middle + 1, hi, self, best);
        else
            search_subtree(t, lo, middle, self, best);
    }
}

struct measured {
    struct spin_kd_tree tree;
    float *mean_dist2;
};

static void measure_rows(void *context, size_t first, size_t last)
{
    const struct measured *m = context;
    const struct spin_kd_tree *t = &m->tree;

    for (size_t i = first; i < last; i++) {
        float best[NEIGHBOURS] = {FLT_MAX, FLT_MAX, FLT_MAX}, sum = 0;
        uint32_t self = t->order[i];
        int found = 0;

        search_subtree(t, 0, t->n, self, best);
        for (; found < NEIGHBOURS && best[found] < FLT_MAX; found++)
            sum += best[found];
        m->mean_dist2[self] = found ? sum / (float)found : 0;
    }
}

spin_status spin_knn_mean_dist2(struct spin_pool *pool, size_t n, const float *points,
                                float *mean_dist2)
{
    struct measured m = {.mean_dist2 = mean_dist2};
    spin_status status = spin_kd_tree_open(&m.tree, n, points);

    if (status == SPIN_OK)
        spin_pool_rows(pool, n, CHUNK, measure_rows, &m);
    spin_kd_tree_close(&m.tree);
    return status;
}

spin_status spin_knn_median_dist2(struct spin_pool *pool, size_t n, const float *points,
                                  float *median)
{
    SPIN_FREED float *square = NULL;

    SPIN_TRY(spin_alloc(n, sizeof *square, (void **)&square));
    SPIN_TRY(spin_knn_mean_dist2(pool, n, points, square));
    qsort(square, n, sizeof *square, spin_by_float);
    *median = square[n / 2];
    return SPIN_OK;
}

/* ---- Order along a Morton curve -------------------------------------------------------------- */

struct keyed {
    uint64_t key;
    uint32_t index;
};

static int compare_keys(const void *a, const void *b)
{
    const struct keyed *x = a, *y = b;

    if (x->key != y->key)
        return x->key < y->key ? -1 : 1;
    return x->index < y->index ? -1 : x->index > y->index;
}

spin_status spin_morton_order(size_t n, const float *points, uint32_t *order)
{
    float low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    SPIN_FREED struct keyed *keyed = NULL;

    SPIN_TRY(spin_alloc(n + 1, sizeof *keyed, (void **)&keyed));
    for (size_t i = 0; i < 3 * n; i++) {
        low[i % 3] = fminf(low[i % 3], points[i]);
        high[i % 3] = fmaxf(high[i % 3], points[i]);
    }
    for (size_t i = 0; i < n; i++) {
        keyed[i].index = (uint32_t)i;
        for (int c = 0; c < 3; c++) {
            double width = (double)high[c] - (double)low[c];
            double u = width > 0 ? ((double)points[3 * i + (size_t)c] - (double)low[c]) / width : 0;

            keyed[i].key |= spin_morton_spread((uint64_t)(u * 2097151.0)) << c;
        }
    }
    qsort(keyed, n, sizeof *keyed, compare_keys);
    for (size_t i = 0; i < n; i++)
        order[i] = keyed[i].index;
    return SPIN_OK;
}
