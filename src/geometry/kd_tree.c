/* Builds a k-d tree, and finds all points within a radius. */
#include "geometry/kd_tree.h"

#include <float.h>

#include "base/base.h"

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
