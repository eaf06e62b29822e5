#include "exporters/lib/merge_splats.h"

#include "base/base.h"
#include "formats/gaussian.h"
#include "geometry/kd_tree.h"
#include "geometry/morton.h"
#include "math/activate.h"
#include "math/covariance.h"
#include "math/sh.h"

enum {
    WINDOW = 12, /* number of following splats in spatial order that each splat is compared with */
    STEP = 4,    /* at most 1/STEP of the splats disappear in one round */
};
/* Cost of an area that doubles, in squared differences of colour; and the area of a merged splat,
 * relative to the sum of both areas, from which on it costs. */
#define SPREAD 0.3
#define FREE_AREA 0.8
#define MOST_OPACITY 0.999

struct merged {
    double mean[3], cov[6];
    double opacity, area;
    float *sh; /* [3 * coefficients] */
    bool gone;
};

struct candidate {
    float cost;
    uint32_t a, b;
};

struct merging {
    struct merged *splat; /* [n] */
    size_t n;
    size_t n_sh; /* floats per splat */
    float *sh, *points;
    uint32_t *order;
    struct candidate *candidate;
    size_t n_candidates;
    bool by_curve; /* the spatial order is that of a Morton curve, else that of a k-d tree */
};

/* Returns a measure of the area of the Gaussian's projections: the square root of the sum of the
 * squared products of two standard deviations. */
static double area_of(const double cov[6])
{
    double square = cov[0] * cov[3] - cov[1] * cov[1] + cov[0] * cov[5] - cov[2] * cov[2] +
                    cov[3] * cov[5] - cov[4] * cov[4];

    return sqrt(fmax(square, 1e-60));
}

/* Enlarges a splat whose opacity would exceed 1. Two opaque splats side by side need an area that
 * is larger by the whole excess, and two splats one behind the other need none of it; the square
 * root of the excess is between both. With a sixteenth of the splats, images of one frame of
 * 'court' and of one frame of real footage gain 6 and 3 dB by it. */
static void enlarge(struct merged *m)
{
    double factor = sqrt(m->opacity / MOST_OPACITY);

    for (int i = 0; i < 6; i++)
        m->cov[i] *= factor;
    m->area *= factor;
    m->opacity = MOST_OPACITY;
}

/* Sets mean, covariance, opacity and area of *m to those of the two splats together. The colour
 * stays that of the caller. */
static void join(const struct merged *a, const struct merged *b, struct merged *m)
{
    double wa = a->opacity * a->area + 1e-60, wb = b->opacity * b->area + 1e-60, share, off[3];
    int at = 0;

    share = wb / (wa + wb);
    for (int i = 0; i < 3; i++) {
        off[i] = b->mean[i] - a->mean[i];
        m->mean[i] = a->mean[i] + share * off[i];
    }
    for (int i = 0; i < 3; i++) {
        for (int j = i; j < 3; j++, at++)
            m->cov[at] = (1 - share) * a->cov[at] + share * b->cov[at] +
                         share * (1 - share) * off[i] * off[j];
    }
    m->area = area_of(m->cov);
    m->opacity = (wa + wb) / m->area;
    if (m->opacity > MOST_OPACITY)
        enlarge(m);
}

/* Returns the cost of merging two splats: the smaller of their weights, roughly, times the squared
 * difference of their colours plus a measure of how far the area grows. */
static double cost_of(const struct merged *a, const struct merged *b)
{
    double wa = a->opacity * a->area, wb = b->opacity * b->area, colour = 0, spread;
    struct merged m;

    join(a, b, &m);
    for (int c = 0; c < 3; c++)
        colour += pow(SPIN_SH_C0 * (double)(a->sh[c] - b->sh[c]), 2);
    spread = fmax(0, m.area / fmax(a->area + b->area, 1e-60) - FREE_AREA);
    return wa * wb / (wa + wb + 1e-60) * (colour + SPREAD * spread);
}

static int by_cost(const void *a, const void *b)
{
    const struct candidate *x = a, *y = b;

    if (x->cost != y->cost)
        return x->cost < y->cost ? -1 : 1;
    return x->a != y->a ? (x->a < y->a ? -1 : 1) : (x->b > y->b) - (x->b < y->b);
}

/* Sets x->order to a spatial order. The orders alternate, since each has other pairs of neighbours
 * that are far apart in it. */
static spin_status sort_splats(struct merging *x)
{
    struct spin_kd_tree tree = {0};
    spin_status status;

    for (size_t i = 0; i < x->n; i++)
        for (int c = 0; c < 3; c++)
            x->points[3 * i + (size_t)c] = (float)x->splat[i].mean[c];
    x->by_curve = !x->by_curve;
    if (x->by_curve)
        return spin_morton_order(x->n, x->points, x->order);
    status = spin_kd_tree_open(&tree, x->n, x->points);
    if (status == SPIN_OK)
        memcpy(x->order, tree.order, x->n * sizeof *x->order);
    spin_kd_tree_close(&tree);
    return status;
}

static void list_candidates(struct merging *x)
{
    x->n_candidates = 0;
    for (size_t i = 0; i < x->n; i++) {
        for (size_t k = i + 1; k < x->n && k <= i + WINDOW; k++) {
            uint32_t a = x->order[i], b = x->order[k];

            x->candidate[x->n_candidates++] = (struct candidate){
                (float)cost_of(&x->splat[a], &x->splat[b]), a < b ? a : b, a < b ? b : a};
        }
    }
    qsort(x->candidate, x->n_candidates, sizeof *x->candidate, by_cost);
}

static void merge_pair(struct merging *x, const struct candidate *c)
{
    struct merged *a = &x->splat[c->a], *b = &x->splat[c->b];
    double wa = a->opacity * a->area + 1e-60, wb = b->opacity * b->area + 1e-60;
    struct merged m = *a;

    join(a, b, &m);
    for (size_t k = 0; k < x->n_sh; k++)
        m.sh[k] = (float)((wa * (double)a->sh[k] + wb * (double)b->sh[k]) / (wa + wb));
    *a = m;
    b->gone = true;
}

/* Merges the cheapest disjoint pairs, at most n of them; returns the sum of their costs. */
static double merge_round(struct merging *x, size_t n, unsigned char *used)
{
    double sum = 0;
    size_t kept = 0;

    memset(used, 0, x->n);
    for (size_t i = 0; i < x->n_candidates && n > 0; i++) {
        const struct candidate *c = &x->candidate[i];

        if (used[c->a] || used[c->b])
            continue;
        used[c->a] = used[c->b] = 1;
        merge_pair(x, c);
        sum += (double)c->cost;
        n--;
    }
    for (size_t i = 0; i < x->n; i++)
        if (!x->splat[i].gone)
            x->splat[kept++] = x->splat[i];
    x->n = kept;
    return sum;
}

static spin_status begin(struct merging *x, const struct spin_splats *from)
{
    x->n = from->n;
    x->n_sh = 3 * (size_t)spin_sh_count(from->sh_degree);
    SPIN_TRY(spin_alloc(x->n, sizeof *x->splat, (void **)&x->splat));
    SPIN_TRY(spin_alloc(x->n, x->n_sh * sizeof *x->sh, (void **)&x->sh));
    SPIN_TRY(spin_alloc(x->n, 3 * sizeof *x->points, (void **)&x->points));
    SPIN_TRY(spin_alloc(x->n, sizeof *x->order, (void **)&x->order));
    SPIN_TRY(spin_alloc(x->n, WINDOW * sizeof *x->candidate, (void **)&x->candidate));
    memcpy(x->sh, from->sh, x->n * x->n_sh * sizeof *x->sh);
    for (size_t i = 0; i < x->n; i++) {
        struct merged *m = &x->splat[i];
        double scale[3], quat[4];

        for (size_t c = 0; c < 3; c++) {
            m->mean[c] = (double)from->means[3 * i + c];
            scale[c] = exp((double)from->log_scales[3 * i + c]);
        }
        for (size_t c = 0; c < 4; c++)
            quat[c] = (double)from->quats[4 * i + c];
        spin_covariance_of(scale, quat, m->cov);
        m->area = area_of(m->cov);
        m->opacity = spin_sigmoid_of((double)from->logit_opacities[i]);
        m->sh = x->sh + i * x->n_sh;
    }
    return SPIN_OK;
}

static spin_status copy_out(const struct merging *x, int sh_degree, struct spin_splats *out)
{
    SPIN_TRY(spin_splats_reserve(out, x->n, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES, sh_degree));
    for (size_t i = 0; i < x->n; i++) {
        const struct merged *m = &x->splat[i];
        double log_scale[3], quat[4];

        if (!spin_covariance_split(m->cov, log_scale, quat))
            return spin_malformed("a splat has a scale that is too large to be merged");
        for (size_t c = 0; c < 3; c++) {
            out->means[3 * i + c] = (float)m->mean[c];
            out->log_scales[3 * i + c] = (float)log_scale[c];
        }
        for (size_t c = 0; c < 4; c++)
            out->quats[4 * i + c] = (float)quat[c];
        out->logit_opacities[i] = spin_opacity_logit((float)m->opacity);
        memcpy(out->sh + i * x->n_sh, m->sh, x->n_sh * sizeof *m->sh);
    }
    return SPIN_OK;
}

spin_status spin_merge_splats(const struct spin_splats *from, size_t n, struct spin_splats *out,
                              double *error)
{
    struct merging x = {0};
    SPIN_FREED unsigned char *used = NULL;
    spin_status status = SPIN_OK;

    SPIN_TRY_OUT(begin(&x, from));
    SPIN_TRY_OUT(spin_alloc(x.n + 1, 1, (void **)&used));
    while (x.n > n) {
        size_t most = x.n / STEP + 1;

        SPIN_TRY_OUT(sort_splats(&x));
        list_candidates(&x);
        *error += merge_round(&x, x.n - n < most ? x.n - n : most, used);
    }
    SPIN_TRY_OUT(copy_out(&x, from->sh_degree, out));
out:
    free(x.splat);
    free(x.sh);
    free(x.points);
    free(x.order);
    free(x.candidate);
    return status;
}
