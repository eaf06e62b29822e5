#include "geometry/viewpoints.h"

#include "base/base.h"
#include "math/rng.h"

/* A cell in which dynamic splats have less than this share of the opaque area is treated as
 * flicker, not as motion. */
#define LEAST_SHARE 0.3f
/* Radius of the search for the densest ball, as a share of the radius of the scene. Ground and
 * walls near a person have small splats, too, so the ball must not be much larger than a person. */
#define BALL_SHARE 0.6
#define DETAIL_SHARE 0.3

enum {
    STARTS = 30,  /* number of starting points of the search for the densest ball */
    SHIFTS = 12,  /* mean-shift steps from each starting point */
    FEW = 20,     /* a clip with fewer dynamic splats is treated as static */
    MOST = 40000, /* largest number of splats that the search examines */
    SAMPLES = 60, /* sample points along a ray */
};

struct item {
    double value, weight;
};

static int by_value(const void *a, const void *b)
{
    const struct item *x = a, *y = b;

    return (x->value > y->value) - (x->value < y->value);
}

/* Returns the weighted quantile: the smallest value such that the items up to it have this share of
 * the total weight. Sorts the items. */
static double quantile(struct item *item, size_t n, double share)
{
    double all = 0, sum = 0;
    size_t i = 0;

    qsort(item, n, sizeof *item, by_value);
    for (size_t k = 0; k < n; k++)
        all += item[k].weight;
    while (i + 1 < n && (sum += item[i].weight) < share * all)
        i++;
    return n > 0 ? item[i].value : 0;
}

static double distance_to(const double a[3], const double b[3])
{
    return sqrt(pow(a[0] - b[0], 2) + pow(a[1] - b[1], 2) + pow(a[2] - b[2], 2));
}

static void position_of(const struct spin_voxels *v, size_t splat, double at[3])
{
    for (int c = 0; c < 3; c++)
        at[c] = (double)v->splat[splat].at[c];
}

/* ---- The scene as a whole -------------------------------------------------------------------- */

/* Sets each coordinate of `middle` to the median of the opaque area along that axis. */
static spin_status find_middle(const struct spin_voxels *v, double middle[3])
{
    SPIN_FREED struct item *item = NULL;

    SPIN_TRY(spin_alloc(v->n, sizeof *item, (void **)&item));
    for (int c = 0; c < 3; c++) {
        size_t n = 0;

        for (size_t i = 0; i < v->n; i++) {
            double at[3];

            spin_voxels_centre(v, i, at);
            if (v->mean[i] > 0)
                item[n++] = (struct item){at[c], (double)v->mean[i]};
        }
        middle[c] = quantile(item, n, 0.5);
    }
    return SPIN_OK;
}

/* Sets *reach to the radius of the ball around `from` that contains 90 % of the opaque area. */
static spin_status find_reach(const struct spin_voxels *v, const double from[3], double *reach)
{
    SPIN_FREED struct item *item = NULL;
    size_t n = 0;

    SPIN_TRY(spin_alloc(v->n, sizeof *item, (void **)&item));
    for (size_t i = 0; i < v->n; i++) {
        double at[3];

        spin_voxels_centre(v, i, at);
        if (v->mean[i] > 0)
            item[n++] = (struct item){distance_to(at, from), (double)v->mean[i]};
    }
    *reach = fmax(quantile(item, n, 0.9), v->cell);
    return SPIN_OK;
}

/* ---- The splats of the subject --------------------------------------------------------------- */

/* Computes for each cell which share of its opaque area belongs to dynamic splats. The caller frees
 * *share. */
static spin_status find_moving_shares(const struct spin_voxels *v, float **share)
{
    SPIN_FREED float *all = NULL;

    SPIN_TRY(spin_alloc(v->n, sizeof *all, (void **)&all));
    SPIN_TRY(spin_alloc(v->n, sizeof **share, (void **)share));
    for (size_t i = 0; i < v->n_splats; i++) {
        double at[3];
        size_t cell;

        position_of(v, i, at);
        cell = spin_voxels_find(v, at);
        if (cell == SIZE_MAX)
            continue;
        all[cell] += (float)spin_voxels_area(v, &v->splat[i]);
        if (spin_voxels_moves(v, &v->splat[i]))
            (*share)[cell] += (float)spin_voxels_area(v, &v->splat[i]);
    }
    for (size_t i = 0; i < v->n; i++)
        (*share)[i] /= all[i] > 0 ? all[i] : 1;
    return SPIN_OK;
}

/* Multiplies the weight of each splat by the square of the share of dynamic splats in its cell.
 * This suppresses flickering walls, in which only some splats seem to move. */
static spin_status weight_by_share(const struct spin_voxels *v, struct spin_subject *s)
{
    SPIN_FREED float *share = NULL;

    SPIN_TRY(find_moving_shares(v, &share));
    for (size_t i = 0; i < s->n; i++) {
        double at[3];
        size_t cell;

        position_of(v, s->splat[i], at);
        cell = spin_voxels_find(v, at);
        s->weight[i] *=
            cell == SIZE_MAX || share[cell] < LEAST_SHARE ? 0 : (double)(share[cell] * share[cell]);
    }
    return SPIN_OK;
}

/* Lists the dynamic splats if `moving` is set, else all splats. If `small` is set, large splats are
 * omitted, since they usually belong to a wall or background. */
static spin_status list_splats(const struct spin_voxels *v, bool moving, bool small,
                               struct spin_subject *s)
{
    SPIN_TRY(spin_grow(v->n_splats + 1, sizeof *s->splat, (void **)&s->splat));
    SPIN_TRY(spin_grow(v->n_splats + 1, sizeof *s->weight, (void **)&s->weight));
    s->n = 0;
    for (size_t i = 0; i < v->n_splats; i++) {
        const struct spin_voxel_splat *p = &v->splat[i];

        if ((small && !((double)p->largest < 0.5 * v->cell)) ||
            (moving && !spin_voxels_moves(v, p)))
            continue;
        s->splat[s->n] = i;
        s->weight[s->n++] = (double)((small ? p->opacity : p->area) * p->count);
    }
    return SPIN_OK;
}

/* Multiplies the weight of each splat by the transmittance between the splat and the middle of the
 * scene, since splats that flicker behind a wall are not part of the subject. */
static void weight_by_visibility(const struct spin_voxels *v, const double middle[3],
                                 struct spin_subject *s)
{
    for (size_t i = 0; i < s->n; i++) {
        double at[3], from[3], along[3];

        position_of(v, s->splat[i], at);
        for (int c = 0; c < 3; c++) {
            along[c] = 0.8 * (at[c] - middle[c]);
            from[c] = middle[c] + 0.1 * (at[c] - middle[c]);
        }
        s->weight[i] *= exp(-spin_voxels_depth(v, v->opacity, from, along, SAMPLES));
    }
}

static bool is_enough(const struct spin_subject *s)
{
    double sum = 0;

    for (size_t i = 0; i < s->n; i++)
        sum += s->weight[i];
    return s->n >= FEW && sum > 1;
}

/* ---- The densest ball ------------------------------------------------------------------------ */

/* Performs one mean-shift step: moves `at` to the weighted mean of the splats within `radius`, and
 * returns the total weight of these splats. */
static double shift_ball(const struct spin_voxels *v, const struct spin_subject *s, double radius,
                         double at[3])
{
    size_t stride = 1 + s->n / MOST;
    double sum = 0, mean[3] = {0}, p[3];

    for (size_t i = 0; i < s->n; i += stride) {
        position_of(v, s->splat[i], p);
        if (distance_to(p, at) >= radius)
            continue;
        sum += s->weight[i];
        for (int c = 0; c < 3; c++)
            mean[c] += s->weight[i] * p[c];
    }
    for (int c = 0; c < 3 && sum > 0; c++)
        at[c] = mean[c] / sum;
    return sum;
}

size_t spin_subject_draw(const double *sums, size_t n, double share)
{
    size_t low = 0, high = n - 1;

    while (low < high) {
        size_t middle = (low + high) / 2;

        if (sums[middle] > share * sums[n - 1])
            high = middle;
        else
            low = middle + 1;
    }
    return low;
}

static spin_status find_ball(const struct spin_voxels *v, double radius, uint64_t seed,
                             struct spin_subject *s)
{
    SPIN_FREED double *sums = NULL;
    double best = -1;

    SPIN_TRY(spin_alloc(s->n, sizeof *sums, (void **)&sums));
    for (size_t i = 0; i < s->n; i++)
        sums[i] = s->weight[i] + (i > 0 ? sums[i - 1] : 0);
    for (uint64_t k = 0; k < STARTS; k++) {
        double at[3], sum = 0, share = (double)spin_rng_uniform(seed, 1, k);

        position_of(v, s->splat[spin_subject_draw(sums, s->n, share)], at);
        for (int i = 0; i < SHIFTS; i++)
            sum = shift_ball(v, s, radius, at);
        if (sum <= best)
            continue;
        best = sum;
        memcpy(s->centre, at, sizeof at);
    }
    return SPIN_OK;
}

/* Sets the radius to that of the ball that contains 80 % of the subject's weight. Splats farther
 * than `span` from the centre are ignored. */
static spin_status find_radius(const struct spin_voxels *v, struct spin_subject *s)
{
    SPIN_FREED struct item *item = NULL;
    size_t n = 0;

    SPIN_TRY(spin_alloc(s->n, sizeof *item, (void **)&item));
    for (size_t i = 0; i < s->n; i++) {
        double at[3], away;

        position_of(v, s->splat[i], at);
        away = distance_to(at, s->centre);
        if (away < s->span)
            item[n++] = (struct item){away + (double)v->splat[s->splat[i]].largest, s->weight[i]};
    }
    s->radius = fmax(quantile(item, n, 0.8), 0.5 * v->cell);
    return SPIN_OK;
}

spin_status spin_subject_find(const struct spin_voxels *v, bool detail, uint64_t seed,
                              struct spin_subject *s)
{
    double middle[3], around, radius;

    memset(s, 0, sizeof *s);
    SPIN_TRY(find_middle(v, middle));
    SPIN_TRY(find_reach(v, middle, &around));
    SPIN_TRY(list_splats(v, true, true, s));
    weight_by_visibility(v, middle, s);
    SPIN_TRY(weight_by_share(v, s));
    s->moves = is_enough(s);
    detail = detail && !s->moves;
    if (detail)
        SPIN_TRY(list_splats(v, false, true, s));
    detail = detail && is_enough(s);
    if (!s->moves && !detail)
        SPIN_TRY(list_splats(v, false, false, s));
    radius = (detail ? DETAIL_SHARE : BALL_SHARE) * around;
    SPIN_TRY(find_ball(v, radius, seed, s));
    s->span = 1.4 * radius;
    SPIN_TRY(find_radius(v, s));
    SPIN_TRY(find_reach(v, s->centre, &s->reach));
    s->reach = fmax(s->reach, s->radius);
    return SPIN_OK;
}

void spin_subject_free(struct spin_subject *s)
{
    free(s->splat);
    free(s->weight);
    memset(s, 0, sizeof *s);
}
