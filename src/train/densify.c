/* Clones, splits and prunes points. Points are processed in order, and each random number is
 * computed from its index instead of drawn from a sequence, so the result depends only on the
 * statistics and the seed. */
#include "train/densify.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "base/mem.h"
#include "math/activate.h"
#include "math/quat.h"
#include "math/rng.h"

enum { STREAM_SPLIT = 32 }; /* stream of random numbers, see math/rng.h */
enum { KEEP, CLONE, SPLIT };

/* Ln 1.6: the scale of a child is that of its parent / 1.6. */
static const float log_shrink = 0.47000363f;

/* ---- Choosing points ------------------------------------------------------------------------- */

const double spin_prune_opacity = 0.005;

void spin_densify_defaults(struct spin_densify_options *o)
{
    memset(o, 0, sizeof *o);
    o->gradient_threshold = 2e-4;
    o->percent_dense = 0.01;
    o->prune_opacity = spin_prune_opacity;
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

static size_t choose_actions(const struct spin_densify_options *o,
                             const struct spin_refine_cloud *c, uint8_t *mark)
{
    float threshold = (float)o->gradient_threshold;
    float small = (float)(o->percent_dense * o->extent);
    size_t marked = 0;

    for (size_t i = 0; i < c->n; i++) {
        mark[i] = KEEP;
        if (!(mean_gradient(&c->point[i]) >= threshold))
            continue;
        mark[i] = !o->long_axis && largest_scale(&c->point[i]) <= small ? CLONE : SPLIT;
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

/* Limits the number of marked points, since each clone and each split adds one point. If max_points
 * allows fewer new points than are marked, only those with the largest mean gradients stay marked.
 */
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

/* ---- Changing the cloud ---------------------------------------------------------------------- */

enum { SH_ROW = 3 * SPIN_REFINE_SH };

/* Adds a point with the parameters of its parent, and with moments and statistics of zero. */
static struct spin_refine_point *add_point(struct spin_refine_cloud *c, size_t parent)
{
    struct spin_refine_point *p = &c->point[c->n];

    if (c->sh) {
        memset(c->sh + SH_ROW * c->n, 0, SH_ROW * sizeof(float));
        memcpy(c->sh + SH_ROW * c->n, c->sh + SH_ROW * parent, SPIN_REFINE_SH * sizeof(float));
    }
    c->n++;
    memset(p, 0, sizeof *p);
    p->p = c->point[parent].p;
    p->origin = (uint32_t)parent;
    p->is_new = true;
    return p;
}

/* Moves a point by an offset along its own axes. */
static void shift_point(struct spin_refine_row *p, const float along[3])
{
    float q[4], offset[3];

    spin_rotation_of(p->rotation, q);
    spin_quat_rotate(q, along, offset);
    for (int i = 0; i < 3; i++)
        p->pos_w[i] += offset[i];
}

static void add_child(struct spin_refine_cloud *c, size_t parent, const float normal[3])
{
    struct spin_refine_row *p = &add_point(c, parent)->p;
    float along[3];

    for (int i = 0; i < 3; i++) {
        along[i] = normal[i] * spin_scale_of(p->log_scale[i]);
        p->log_scale[i] -= log_shrink;
    }
    shift_point(p, along);
}

/* With long_axis, each half of a split point is shifted along the point's longest axis by
 * half_offset times the scale of that axis. The scale of this axis is multiplied by half_long, the
 * other two scales by half_other, and the opacity by half_opacity. Tuned on the clips "court" and
 * "basketball" (docs/results.md). */
static const float half_offset = 0.6f, half_long = 0.5f, half_other = 0.85f, half_opacity = 0.6f;

static void add_half(struct spin_refine_cloud *c, size_t parent, float side)
{
    struct spin_refine_row *p = &add_point(c, parent)->p;
    float along[3] = {0};
    int longest = 0;

    for (int i = 1; i < 3; i++)
        if (p->log_scale[i] > p->log_scale[longest])
            longest = i;
    along[longest] = side * half_offset * spin_scale_of(p->log_scale[longest]);
    for (int i = 0; i < 3; i++)
        p->log_scale[i] += logf(i == longest ? half_long : half_other);
    p->logit_opacity = spin_logit_of((double)(half_opacity * spin_opacity_of(p->logit_opacity)));
    shift_point(p, along);
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

    for (int child = 0; o->long_axis && child < 2; child++)
        for (size_t i = 0; i < n_before; i++)
            if (mark[i] == SPLIT)
                add_half(c, i, child == 0 ? -1 : 1);
    if (splits == 0 || o->long_axis)
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

/* True if a point is not pruned. Unlike 3DGS, this prunes points with values that are not finite,
 * since such values would spread through the training of the network. */
static bool is_kept(const struct spin_refine_cloud *c, size_t i, float prune_opacity)
{
    const struct spin_refine_row *p = &c->point[i].p;
    const float *value = (const float *)p;

    for (int k = 0; k < SPIN_REFINE_WIDTH; k++)
        if (!isfinite(value[k]))
            return false;
    for (size_t k = 0; c->sh && k < SPIN_REFINE_SH; k++)
        if (!isfinite(c->sh[SH_ROW * i + k]))
            return false;
    return spin_opacity_of(p->logit_opacity) >= prune_opacity;
}

/* Removes the points that were split, which are marked SPLIT (only the first n_marked points have
 * marks), and the points that is_kept() rejects; clears the statistics of the others. Returns the
 * number of points that is_kept() rejected. */
static size_t remove_points(struct spin_refine_cloud *c, const uint8_t *mark, size_t n_marked,
                            double prune_opacity)
{
    size_t n = 0, pruned = 0;

    for (size_t i = 0; i < c->n; i++) {
        struct spin_refine_point *p = &c->point[i];

        if (i < n_marked && mark[i] == SPLIT)
            continue;
        if (!is_kept(c, i, (float)prune_opacity)) {
            pruned++;
            continue;
        }
        p->gradient = 0;
        p->seen = 0;
        if (n != i)
            c->point[n] = *p;
        if (n != i && c->sh)
            memcpy(c->sh + SH_ROW * n, c->sh + SH_ROW * i, SH_ROW * sizeof(float));
        n++;
    }
    c->n = n;
    return pruned;
}

size_t spin_refine_prune(struct spin_refine_cloud *cloud, double prune_opacity)
{
    return remove_points(cloud, NULL, 0, prune_opacity);
}

spin_status spin_densify(const struct spin_densify_options *o, int iteration,
                         struct spin_refine_cloud *cloud, struct spin_densify_change *change)
{
    size_t n = cloud->n, marked;
    SPIN_FREED void *block = NULL;
    uint8_t *mark;

    memset(change, 0, sizeof *change);
    SPIN_TRY(spin_alloc(n + 1, 1, &block));
    mark = block;
    marked = choose_actions(o, cloud, mark);
    SPIN_TRY(respect_cap(o, cloud, marked, mark));
    for (size_t i = 0; i < n; i++) {
        cloud->point[i].origin = (uint32_t)i;
        cloud->point[i].is_new = false;
        change->clones += mark[i] == CLONE;
        change->splits += mark[i] == SPLIT;
    }
    SPIN_TRY(spin_refine_cloud_reserve(cloud, n + change->clones + 2 * change->splits));
    for (size_t i = 0; i < n; i++)
        if (mark[i] == CLONE)
            add_point(cloud, i);
    SPIN_TRY(add_children(o, iteration, cloud, mark, n, change->splits));
    change->pruned = remove_points(cloud, mark, n, o->prune_opacity);
    return SPIN_OK;
}
