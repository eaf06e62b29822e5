/* Clone, split and prune as 3DGS does. Everything goes in the order of the points and random
 * numbers are counted, not drawn in turn, so the result is a function of the statistics and the
 * seed. */
#include "train/densify.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/mem.h"
#include "train/knn.h"
#include "scene/bundle.h"
#include "math/activate.h"
#include "math/rng.h"
#include "math/sh.h"

enum { STREAM_SPLIT = 32 }; /* of the random numbers, see math/rng.h */
enum { KEEP, CLONE, SPLIT };

static const float start_logit = -2.1972246f; /* opacity 0.1 */
static const float log_shrink = 0.47000363f;  /* ln 1.6: a child's scale is its parent's / 1.6 */

_Static_assert(sizeof(struct spin_refine_row) == SPIN_REFINE_WIDTH * sizeof(float),
               "a row is nothing but its floats");

/* ---- The cloud ------------------------------------------------------------------------------- */

spin_status spin_refine_cloud_reserve(struct spin_refine_cloud *cloud, size_t n)
{
    size_t capacity = n + n / 2;
    void *block = cloud->point;

    if (n > INT32_MAX) /* the rasteriser's lists hold 32-bit indices */
        return spin_fail(SPIN_E_MEMORY, "%zu points in one frame are more than %d", n, INT32_MAX);
    if (n <= cloud->capacity)
        return SPIN_OK;
    SPIN_TRY(spin_grow(capacity, sizeof *cloud->point, &block));
    cloud->point = block;
    cloud->capacity = capacity;
    return SPIN_OK;
}

void spin_refine_cloud_free(struct spin_refine_cloud *cloud)
{
    free(cloud->point);
    memset(cloud, 0, sizeof *cloud);
}

static spin_status begin(struct spin_refine_cloud *out, size_t n)
{
    SPIN_TRY(spin_refine_cloud_reserve(out, n));
    if (n > 0)
        memset(out->point, 0, n * sizeof *out->point);
    out->n = n;
    return SPIN_OK;
}

static void start_point(struct spin_refine_row *p, const float *pos_w, const float *rgb,
                        double dist2)
{
    float log_scale = (float)(0.5 * log(dist2 > 1e-7 ? dist2 : 1e-7));

    for (int c = 0; c < 3; c++) {
        p->pos_w[c] = pos_w[c];
        p->dc[c] = rgb ? (float)((rgb[c] - 0.5) / SPIN_SH_C0) : 0;
        p->log_scale[c] = log_scale;
    }
    p->rotation[0] = 1;
    p->logit_opacity = start_logit;
}

spin_status spin_refine_init_from_points(struct spin_pool *pool, size_t n, const float *pos_w,
                                         const float *rgb, struct spin_refine_cloud *out)
{
    spin_status status;
    void *block = NULL;
    float *dist2;

    for (size_t i = 0; i < n * 3; i++)
        if (!isfinite(pos_w[i]))
            return spin_fail(SPIN_E_MALFORMED, "point %zu has a coordinate that is not finite",
                             i / 3);
    SPIN_TRY(begin(out, n));
    SPIN_TRY(spin_alloc(n + 1, sizeof *dist2, &block));
    dist2 = block;
    SPIN_TRY_OUT(spin_knn_mean_dist2(pool, n, pos_w, dist2));
    for (size_t i = 0; i < n; i++)
        start_point(&out->point[i].p, pos_w + 3 * i, rgb ? rgb + 3 * i : NULL, dist2[i]);
out:
    free(block);
    return status;
}

spin_status spin_refine_init_from_colours(const struct spin_splats *s,
                                          struct spin_refine_cloud *out)
{
    size_t width = spin_column_width(SPIN_COL_SH, s->sh_degree);
    void *block = NULL;
    float *rgb;
    spin_status status;

    if (s->rgb || !s->sh)
        return spin_refine_init_from_points(NULL, s->n, s->means, s->rgb, out);
    SPIN_TRY(spin_alloc(3 * s->n + 1, sizeof(float), &block));
    rgb = block;
    for (size_t i = 0; i < 3 * s->n; i++)
        rgb[i] = (float)(SPIN_SH_C0 * (double)s->sh[i / 3 * width + i % 3] + 0.5);
    status = spin_refine_init_from_points(NULL, s->n, s->means, rgb, out);
    free(block);
    return status;
}

spin_status spin_refine_init_from_splats(const struct spin_splats *s, struct spin_refine_cloud *out)
{
    size_t sh_row = 3 * (size_t)(s->sh_degree + 1) * (size_t)(s->sh_degree + 1);

    if (s->n > 0 && !(s->means && s->quats && s->log_scales && s->logit_opacities && s->sh))
        return spin_fail(SPIN_E_USAGE, "refining from the source's attributes needs all of them: "
                                       "means, quats, log_scales, logit_opacities, sh");
    SPIN_TRY(begin(out, s->n));
    for (size_t i = 0; i < s->n; i++) {
        struct spin_refine_row *p = &out->point[i].p;

        memcpy(p->pos_w, s->means + 3 * i, sizeof p->pos_w);
        memcpy(p->dc, s->sh + sh_row * i, sizeof p->dc);
        memcpy(p->log_scale, s->log_scales + 3 * i, sizeof p->log_scale);
        memcpy(p->rotation, s->quats + 4 * i, sizeof p->rotation);
        p->logit_opacity = s->logit_opacities[i];
    }
    return SPIN_OK;
}

spin_status spin_refine_to_splats(const struct spin_refine_cloud *cloud, struct spin_splats *out)
{
    SPIN_TRY(spin_splats_reserve(out, cloud->n, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES, 0));
    for (size_t i = 0; i < cloud->n; i++) {
        const struct spin_refine_row *p = &cloud->point[i].p;

        memcpy(out->means + 3 * i, p->pos_w, sizeof p->pos_w);
        memcpy(out->sh + 3 * i, p->dc, sizeof p->dc);
        memcpy(out->log_scales + 3 * i, p->log_scale, sizeof p->log_scale);
        out->logit_opacities[i] = p->logit_opacity;
        spin_rotation_of(p->rotation, out->quats + 4 * i);
    }
    return SPIN_OK;
}

/* ---- Choosing -------------------------------------------------------------------------------- */

void spin_densify_defaults(struct spin_densify_options *o)
{
    memset(o, 0, sizeof *o);
    o->gradient_threshold = 2e-4;
    o->percent_dense = 0.01;
    o->prune_opacity = 0.005;
}

static float mean_gradient(const struct spin_refine_point *p)
{
    return p->seen ? p->gradient / (float)p->seen : 0;
}

static float largest_scale(const struct spin_refine_point *p)
{
    const float *s = p->p.log_scale;

    return spin_scale_of(spin_maxf(s[0], spin_maxf(s[1], s[2])));
}

static size_t mark_points(const struct spin_densify_options *o, const struct spin_refine_cloud *c,
                          uint8_t *mark)
{
    float threshold = (float)o->gradient_threshold;
    float small = (float)(o->percent_dense * o->extent);
    size_t marked = 0;

    for (size_t i = 0; i < c->n; i++) {
        mark[i] = KEEP;
        if (!(mean_gradient(&c->point[i]) >= threshold))
            continue;
        mark[i] = largest_scale(&c->point[i]) <= small ? CLONE : SPLIT;
        marked++;
    }
    return marked;
}

struct wish {
    float gradient;
    uint32_t point;
};

static int compare_wishes(const void *a, const void *b)
{
    const struct wish *x = a, *y = b;

    if (x->gradient != y->gradient)
        return x->gradient < y->gradient ? 1 : -1;
    return (x->point > y->point) - (x->point < y->point);
}

/* Clones and splits each make one point more. When that is more than the cap leaves room for, those
 * with the largest mean gradients have their way. */
static spin_status respect_cap(const struct spin_densify_options *o,
                               const struct spin_refine_cloud *c, size_t marked, uint8_t *mark)
{
    size_t room = o->max_points > c->n ? o->max_points - c->n : 0, n = 0;
    struct wish *wish;
    void *block = NULL;

    if (o->max_points == 0 || marked <= room)
        return SPIN_OK;
    SPIN_TRY(spin_alloc(marked, sizeof *wish, &block));
    wish = block;
    for (size_t i = 0; i < c->n; i++)
        if (mark[i] != KEEP)
            wish[n++] = (struct wish){mean_gradient(&c->point[i]), (uint32_t)i};
    qsort(wish, n, sizeof *wish, compare_wishes);
    for (size_t i = room; i < n; i++)
        mark[wish[i].point] = KEEP;
    free(block);
    return SPIN_OK;
}

/* ---- Changing -------------------------------------------------------------------------------- */

/* A new point: its parent's parameters, no moments, no statistics. */
static struct spin_refine_point *add_point(struct spin_refine_cloud *c, size_t parent)
{
    struct spin_refine_point *p = &c->point[c->n++];

    memset(p, 0, sizeof *p);
    p->p = c->point[parent].p;
    return p;
}

/* v turned by the unit quaternion q: v + 2 w (u x v) + 2 u x (u x v), u = (x, y, z). */
static void turn(const float q[4], const float v[3], float out[3])
{
    const float *u = q + 1;
    float a[3] = {u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]};
    float b[3] = {u[1] * a[2] - u[2] * a[1], u[2] * a[0] - u[0] * a[2], u[0] * a[1] - u[1] * a[0]};

    for (int i = 0; i < 3; i++)
        out[i] = v[i] + 2 * (q[0] * a[i] + b[i]);
}

static void add_child(struct spin_refine_cloud *c, size_t parent, const float normal[3])
{
    struct spin_refine_row *p = &add_point(c, parent)->p;
    float q[4], along[3], offset[3];

    for (int i = 0; i < 3; i++) {
        along[i] = normal[i] * spin_scale_of(p->log_scale[i]);
        p->log_scale[i] -= log_shrink;
    }
    spin_rotation_of(p->rotation, q);
    turn(q, along, offset);
    for (int i = 0; i < 3; i++)
        p->pos_w[i] += offset[i];
}

static void draw_normals(const struct spin_densify_options *o, int iteration, size_t n, float *out)
{
    uint64_t seed = spin_rng_u64(o->seed, STREAM_SPLIT, (uint64_t)o->frame);

    if (o->normals) {
        o->normals(o->context, iteration, n, out);
        return;
    }
    for (size_t i = 0; i < n * 3; i++)
        out[i] = spin_rng_normal(seed, (uint64_t)iteration, i);
}

static spin_status add_children(const struct spin_densify_options *o, int iteration,
                                struct spin_refine_cloud *c, const uint8_t *mark, size_t n_before,
                                size_t splits)
{
    void *block = NULL;
    float *normal;

    if (splits == 0)
        return SPIN_OK;
    SPIN_TRY(spin_alloc(2 * splits, 3 * sizeof *normal, &block));
    normal = block;
    draw_normals(o, iteration, 2 * splits, normal);
    for (int child = 0; child < 2; child++)
        for (size_t i = 0; i < n_before; i++)
            if (mark[i] == SPLIT) {
                add_child(c, i, normal);
                normal += 3;
            }
    free(block);
    return SPIN_OK;
}

/* Differs: 3DGS keeps points that are not finite; here they would be handed on to stage (b). */
static bool worth_keeping(const struct spin_refine_row *p, float prune_opacity)
{
    const float *value = (const float *)p;

    for (int i = 0; i < SPIN_REFINE_WIDTH; i++)
        if (!isfinite(value[i]))
            return false;
    return spin_opacity_of(p->logit_opacity) >= prune_opacity;
}

/* Close the gaps of split parents (the first n_marked points have marks) and of pruned points. */
static size_t compact(struct spin_refine_cloud *c, const uint8_t *mark, size_t n_marked,
                      double prune_opacity)
{
    size_t n = 0, pruned = 0;

    for (size_t i = 0; i < c->n; i++) {
        struct spin_refine_point *p = &c->point[i];

        if (i < n_marked && mark[i] == SPLIT)
            continue;
        if (!worth_keeping(&p->p, (float)prune_opacity)) {
            pruned++;
            continue;
        }
        p->gradient = 0;
        p->seen = 0;
        if (n != i)
            c->point[n] = *p;
        n++;
    }
    c->n = n;
    return pruned;
}

size_t spin_refine_prune(struct spin_refine_cloud *cloud, double prune_opacity)
{
    return compact(cloud, NULL, 0, prune_opacity);
}

spin_status spin_densify(const struct spin_densify_options *o, int iteration,
                         struct spin_refine_cloud *cloud, struct spin_densify_change *change)
{
    size_t n = cloud->n, marked;
    spin_status status;
    void *block = NULL;
    uint8_t *mark;

    memset(change, 0, sizeof *change);
    SPIN_TRY(spin_alloc(n + 1, 1, &block));
    mark = block;
    marked = mark_points(o, cloud, mark);
    SPIN_TRY_OUT(respect_cap(o, cloud, marked, mark));
    for (size_t i = 0; i < n; i++) {
        change->clones += mark[i] == CLONE;
        change->splits += mark[i] == SPLIT;
    }
    SPIN_TRY_OUT(spin_refine_cloud_reserve(cloud, n + change->clones + 2 * change->splits));
    for (size_t i = 0; i < n; i++)
        if (mark[i] == CLONE)
            add_point(cloud, i);
    SPIN_TRY_OUT(add_children(o, iteration, cloud, mark, n, change->splits));
    change->pruned = compact(cloud, mark, n, o->prune_opacity);
out:
    free(block);
    return status;
}
