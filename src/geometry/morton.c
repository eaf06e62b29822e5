/* Computes the Morton codes of points and sorts the points by them. */
#include "geometry/morton.h"

#include "base/base.h"
#include "math/morton.h"

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
