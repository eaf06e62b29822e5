/* Finds the nearest neighbours of each point by a search in a k-d tree, for all points in parallel.
 */
#include "geometry/knn.h"

#include <float.h>

#include "base/base.h"
#include "geometry/kd_tree.h"

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
