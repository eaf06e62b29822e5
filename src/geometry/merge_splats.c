#include "geometry/merge_splats.h"

#include "base/base.h"
#include "geometry/neighbours.h"
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
#define DROP 0.05 /* cost of dropping a splat, in squared differences of colour */
#define MOST_OPACITY 0.999
#define LEAST_WEIGHT 1e-60 /* avoids divisions by zero */

#define COLUMNS (SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES)

/* ---- One pair -------------------------------------------------------------------------------- */

struct merged {
    double mean[3], cov[6];
    double opacity, area;
    double dc[3]; /* SH of degree 0 */
};

/* Returns a measure of the area of the Gaussian's projections: the square root of the sum of the
 * squared products of two standard deviations. */
static double area_of(const double cov[6])
{
    double square = cov[0] * cov[3] - cov[1] * cov[1] + cov[0] * cov[5] - cov[2] * cov[2] +
                    cov[3] * cov[5] - cov[4] * cov[4];

    return sqrt(fmax(square, LEAST_WEIGHT));
}

static double weight_of(const struct merged *m) { return m->opacity * m->area + LEAST_WEIGHT; }

static void read_splat(const struct spin_splats *s, size_t i, struct merged *out)
{
    const float *sh = s->sh + i * 3 * (size_t)spin_sh_count(s->sh_degree);
    double scale[3], quat[4];

    for (size_t c = 0; c < 3; c++) {
        out->mean[c] = (double)s->means[3 * i + c];
        scale[c] = exp((double)s->log_scales[3 * i + c]);
        out->dc[c] = (double)sh[c];
    }
    for (size_t c = 0; c < 4; c++)
        quat[c] = (double)s->quats[4 * i + c];
    spin_covariance_of(scale, quat, out->cov);
    out->area = area_of(out->cov);
    out->opacity = spin_sigmoid_of((double)s->logit_opacities[i]);
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

/* Sets *m, which may be *a, to the two splats together. */
static void join(const struct merged *a, const struct merged *b, struct merged *m)
{
    double wa = weight_of(a), wb = weight_of(b), share = wb / (wa + wb), off[3];
    int at = 0;

    for (int i = 0; i < 3; i++) {
        off[i] = b->mean[i] - a->mean[i];
        m->mean[i] = a->mean[i] + share * off[i];
        m->dc[i] = a->dc[i] + share * (b->dc[i] - a->dc[i]);
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

/* Returns the cost of merging two splats: the squared difference of their colours plus a measure of
 * how far the area grows. */
static double change_of(const struct merged *a, const struct merged *b)
{
    double colour = 0, spread;
    struct merged m;

    join(a, b, &m);
    for (int c = 0; c < 3; c++)
        colour += pow(SPIN_SH_C0 * (a->dc[c] - b->dc[c]), 2);
    spread = fmax(0, m.area / fmax(a->area + b->area, LEAST_WEIGHT) - FREE_AREA);
    return colour + SPREAD * spread;
}

/* ---- The plan -------------------------------------------------------------------------------- */

struct candidate {
    float cost;
    uint32_t a, b;
};

struct planning {
    int n_frames;
    size_t n_rows;        /* rows of each frame */
    struct merged *splat; /* [n_frames][n_rows] */
    double *seen;         /* [n_rows] how much of each splat is seen, in the unit of weights */
    bool drops;
    uint32_t *row; /* [n] the rows that are left */
    size_t n;
    float *points;   /* [n][3] */
    uint32_t *order; /* [n] indices in `row`, in spatial order */
    struct candidate *candidate;
    size_t n_candidates;
    unsigned char *used; /* [n_rows] */
    int round;
    struct spin_merge_plan *plan;
};

static struct merged *splat_of(const struct planning *x, int frame, uint32_t row)
{
    return &x->splat[(size_t)frame * x->n_rows + row];
}

static int by_cost(const void *a, const void *b)
{
    const struct candidate *x = a, *y = b;

    if (x->cost != y->cost)
        return x->cost < y->cost ? -1 : 1;
    return x->a != y->a ? (x->a < y->a ? -1 : 1) : (x->b > y->b) - (x->b < y->b);
}

/* Sets x->order to a spatial order. The orders of successive rounds differ in the frame, and in the
 * curve, since each has other pairs of neighbours that are far apart in it. */
static spin_status sort_splats(struct planning *x)
{
    struct spin_kd_tree tree = {0};
    spin_status status;

    for (size_t i = 0; i < x->n; i++) {
        const struct merged *m = splat_of(x, x->round / 2 % x->n_frames, x->row[i]);

        for (int c = 0; c < 3; c++)
            x->points[3 * i + (size_t)c] = (float)m->mean[c];
    }
    if (x->round++ % 2 == 0)
        return spin_morton_order(x->n, x->points, x->order);
    status = spin_kd_tree_open(&tree, x->n, x->points);
    if (status == SPIN_OK)
        memcpy(x->order, tree.order, x->n * sizeof *x->order);
    spin_kd_tree_close(&tree);
    return status;
}

static void list_candidates(struct planning *x)
{
    x->n_candidates = 0;
    for (size_t i = 0; i < x->n; i++) {
        if (x->drops)
            x->candidate[x->n_candidates++] =
                (struct candidate){(float)(DROP * x->seen[x->row[i]]), SPIN_MERGE_NONE, x->row[i]};
        for (size_t k = i + 1; k < x->n && k <= i + WINDOW; k++) {
            uint32_t a = x->row[x->order[i]], b = x->row[x->order[k]];
            double change = 0, cost;

            for (int f = 0; f < x->n_frames; f++)
                change = fmax(change, change_of(splat_of(x, f, a), splat_of(x, f, b)));
            cost = change * x->seen[a] * x->seen[b] / (x->seen[a] + x->seen[b] + LEAST_WEIGHT);
            x->candidate[x->n_candidates++] =
                (struct candidate){(float)cost, a < b ? a : b, a < b ? b : a};
        }
    }
    qsort(x->candidate, x->n_candidates, sizeof *x->candidate, by_cost);
}

/* Merges the cheapest disjoint pairs, at most n of them. */
static void merge_round(struct planning *x, size_t n)
{
    struct spin_merge_plan *plan = x->plan;
    size_t kept = 0;

    memset(x->used, 0, x->n_rows);
    for (size_t i = 0; i < x->n_candidates && n > 0; i++) {
        const struct candidate *c = &x->candidate[i];

        if (x->used[c->b] || (c->a != SPIN_MERGE_NONE && x->used[c->a]))
            continue;
        x->used[c->b] = 2;
        if (c->a != SPIN_MERGE_NONE) {
            x->used[c->a] = 1;
            x->seen[c->a] += x->seen[c->b];
        }
        for (int f = 0; f < x->n_frames && c->a != SPIN_MERGE_NONE; f++)
            join(splat_of(x, f, c->a), splat_of(x, f, c->b), splat_of(x, f, c->a));
        plan->pair[plan->n][0] = c->a;
        plan->pair[plan->n++][1] = c->b;
        plan->cost += (double)c->cost;
        n--;
    }
    for (size_t i = 0; i < x->n; i++)
        if (x->used[x->row[i]] != 2)
            x->row[kept++] = x->row[i];
    x->n = kept;
}

/* Sets x->seen to the weights in the first frame or, if `seen` is given, to these numbers in the
 * unit of weights. */
static void set_seen(struct planning *x, const float *seen)
{
    double weights = 0, sum = 0;

    for (size_t i = 0; i < x->n_rows; i++) {
        x->seen[i] = weight_of(splat_of(x, 0, (uint32_t)i));
        weights += x->seen[i];
        sum += seen ? (double)seen[i] : 0;
    }
    for (size_t i = 0; i < x->n_rows && seen; i++)
        x->seen[i] = (double)seen[i] * weights / fmax(sum, LEAST_WEIGHT);
    x->drops = seen != NULL;
}

static spin_status begin_plan(struct planning *x, const struct spin_splats *frames,
                              const float *seen, size_t n)
{
    SPIN_TRY(spin_alloc(x->n_rows, sizeof *x->seen, (void **)&x->seen));
    SPIN_TRY(spin_alloc(x->n_rows * (size_t)x->n_frames, sizeof *x->splat, (void **)&x->splat));
    SPIN_TRY(spin_alloc(x->n, sizeof *x->row, (void **)&x->row));
    SPIN_TRY(spin_alloc(x->n, 3 * sizeof *x->points, (void **)&x->points));
    SPIN_TRY(spin_alloc(x->n, sizeof *x->order, (void **)&x->order));
    SPIN_TRY(spin_alloc(x->n, (WINDOW + 1) * sizeof *x->candidate, (void **)&x->candidate));
    SPIN_TRY(spin_alloc(x->n_rows, 1, (void **)&x->used));
    SPIN_TRY(spin_alloc(x->n > n ? x->n - n : 1, sizeof *x->plan->pair, (void **)&x->plan->pair));
    for (size_t i = 0; i < x->n; i++) {
        x->row[i] = (uint32_t)i;
        for (int f = 0; f < x->n_frames; f++)
            read_splat(&frames[f], i, splat_of(x, f, (uint32_t)i));
    }
    set_seen(x, seen);
    return SPIN_OK;
}

spin_status spin_merge_plan_make(const struct spin_splats *frames, int n_frames, const float *seen,
                                 size_t n, struct spin_merge_plan *out)
{
    struct planning x = {.n_frames = n_frames, .n_rows = frames->n, .n = frames->n, .plan = out};
    spin_status status = SPIN_OK;

    *out = (struct spin_merge_plan){0};
    SPIN_TRY_OUT(begin_plan(&x, frames, seen, n));
    while (x.n > n) {
        size_t most = x.n / STEP + 1;

        if (spin_cancelled())
            SPIN_TRY_OUT(spin_fail_cancelled());
        SPIN_TRY_OUT(sort_splats(&x));
        list_candidates(&x);
        merge_round(&x, x.n - n < most ? x.n - n : most);
    }
out:
    free(x.splat);
    free(x.seen);
    free(x.row);
    free(x.points);
    free(x.order);
    free(x.candidate);
    free(x.used);
    return status;
}

void spin_merge_plan_free(struct spin_merge_plan *plan)
{
    free(plan->pair);
    *plan = (struct spin_merge_plan){0};
}

/* ---- One frame ------------------------------------------------------------------------------- */

static spin_status copy_splats(const struct spin_splats *from, struct spin_splats *to)
{
    size_t n = from->n, n_sh = 3 * (size_t)spin_sh_count(from->sh_degree);

    SPIN_TRY(spin_splats_reserve(to, n, COLUMNS, from->sh_degree));
    to->antialias = from->antialias;
    if (n == 0)
        return SPIN_OK;
    memcpy(to->means, from->means, 3 * n * sizeof *to->means);
    memcpy(to->quats, from->quats, 4 * n * sizeof *to->quats);
    memcpy(to->log_scales, from->log_scales, 3 * n * sizeof *to->log_scales);
    memcpy(to->logit_opacities, from->logit_opacities, n * sizeof *to->logit_opacities);
    memcpy(to->sh, from->sh, n_sh * n * sizeof *to->sh);
    return SPIN_OK;
}

static spin_status write_splat(const struct merged *m, size_t i, struct spin_splats *out)
{
    double log_scale[3], quat[4], opacity = fmax(m->opacity, 1e-7);

    if (!spin_covariance_split(m->cov, log_scale, quat))
        return spin_malformed("splat %zu is too large to be merged with others: drop splats of "
                              "that size with --max-scale 1",
                              i);
    for (size_t c = 0; c < 3; c++) {
        out->means[3 * i + c] = (float)m->mean[c];
        out->log_scales[3 * i + c] = (float)log_scale[c];
    }
    for (size_t c = 0; c < 4; c++)
        out->quats[4 * i + c] = (float)quat[c];
    out->logit_opacities[i] = (float)log(opacity / (1 - opacity));
    return SPIN_OK;
}

/* Merges row b into row a of the splats, whose SH are in out. */
static void merge_rows(struct merged *splat, size_t a, size_t b, struct spin_splats *out)
{
    size_t n_sh = 3 * (size_t)spin_sh_count(out->sh_degree);
    double wa = weight_of(&splat[a]), wb = weight_of(&splat[b]);
    float *to = out->sh + n_sh * a;
    const float *from = out->sh + n_sh * b;

    for (size_t k = 0; k < n_sh; k++)
        to[k] = (float)((wa * (double)to[k] + wb * (double)from[k]) / (wa + wb));
    join(&splat[a], &splat[b], &splat[a]);
}

spin_status spin_merge_plan_apply(const struct spin_merge_plan *plan,
                                  const struct spin_splats *frame, const unsigned char *skip,
                                  struct spin_splats *out)
{
    enum { UNREAD, READ, CHANGED };
    SPIN_FREED struct merged *splat = NULL;
    SPIN_FREED unsigned char *state = NULL;

    SPIN_TRY(copy_splats(frame, out));
    SPIN_TRY(spin_alloc(frame->n + 1, sizeof *splat, (void **)&splat));
    SPIN_TRY(spin_alloc(frame->n + 1, 1, (void **)&state));
    for (size_t i = 0; i < plan->n; i++) {
        const uint32_t *pair = plan->pair[i];

        if (pair[0] >= frame->n || pair[1] >= frame->n ||
            (skip && (skip[pair[0]] || skip[pair[1]])))
            continue;
        for (int k = 0; k < 2; k++) {
            if (state[pair[k]] == UNREAD)
                read_splat(frame, pair[k], &splat[pair[k]]);
            state[pair[k]] = state[pair[k]] == UNREAD ? READ : state[pair[k]];
        }
        merge_rows(splat, pair[0], pair[1], out);
        state[pair[0]] = CHANGED;
    }
    for (size_t i = 0; i < frame->n; i++)
        if (state[i] == CHANGED)
            SPIN_TRY(write_splat(&splat[i], i, out));
    return SPIN_OK;
}

spin_status spin_merge_splats(const struct spin_splats *from, size_t n, struct spin_splats *out,
                              double *cost)
{
    SPIN_LEAVES(spin_merge_plan_free) struct spin_merge_plan plan = {0};
    SPIN_LEAVES(spin_splats_free) struct spin_splats all = {0};
    SPIN_FREED unsigned char *mark = NULL;

    SPIN_TRY(spin_merge_plan_make(from, 1, NULL, n, &plan));
    SPIN_TRY(spin_merge_plan_apply(&plan, from, NULL, &all));
    SPIN_TRY(spin_alloc(from->n + 1, 1, (void **)&mark));
    memset(mark, 1, from->n);
    for (size_t i = 0; i < plan.n; i++)
        mark[plan.pair[i][1]] = 0;
    *cost += plan.cost;
    return spin_splats_select(&all, mark, out);
}
