/* Clones, splits and prunes points. Points are processed in order, and random numbers are a
 * function of the seed and an index, so the result depends only on the statistics and the seed. */
#include "train/densify.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "base/mem.h"
#include "math/activate.h"
#include "math/quat.h"
#include "math/rng.h"
#include "base/base.h"
#include "model/field.h"

enum { STREAM_SPLIT = 32 }; /* stream of the random generator, see math/rng.h */
enum { KEEP, CLONE, SPLIT };

/* ln 1.6: the scales of a child are those of its parent divided by 1.6. */
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

/* Each clone and each split adds one point. If max_points allows fewer new points than are marked,
 * removes the marks of the points with the smallest mean gradients. */
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

/* Adds a point with the parameters of its parent. Its Adam moments and its statistics are zero. */
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

/* With long_axis, the two halves of a split point are shifted along the longest axis of the point,
 * in opposite directions, by half_offset times the scale of that axis. In each half, the scale of
 * that axis is multiplied by half_long, the other two scales by half_other, and the opacity by
 * half_opacity. The constants were tuned on the clips "court" and "basketball" (docs/results.md).
 */
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

/* False if a point is to be pruned. Unlike 3DGS, points with values that are not finite are pruned
 * too, since such values would spread to all parameters of the network during training. */
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

/* Removes points with the mark SPLIT, which have been replaced by their children, and points that
 * is_kept() rejects; clears the statistics of all other points. Only the first n_marked points have
 * marks. Returns the number of points that is_kept() rejected. */
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

/* ---- Densification of tracks ----------------------------------------------------------------- */

/* A densification in progress. */
struct change {
    struct spin_trainer *t;
    const struct spin_densify_options *o;
    int iteration;
    /* Before change_tracks(): empty. After it: the densified tracks, sorted by kind: dynamic,
     * varying, static, backdrop. */
    struct spin_refine_cloud tracks;
    /* Number of tracks before the densification; numbers of dynamic and of varying tracks (see
     * struct spin_trainer) after it. */
    size_t n_before, n_moving, n_varying;
    /* [n_before] for each track before the densification: the row of its splat in the current
     * frame, or SPIN_NO_TRACK if it has none there. */
    uint32_t *row;
    /* Splats of the current frame before and after the densification; the memory is reused for each
     * frame. */
    struct spin_refine_cloud before, after;
};

/* ---- The tracks' parameters ------------------------------------------------------------------ */

static struct spin_refine_row *row_of_part(struct spin_refine_point *p, int part)
{
    return part == 0 ? &p->p : part == 1 ? &p->m : &p->v;
}

/* Copies values and moments of the tracks from the rows of a cloud to the groups on the device
 * (model/field.h) if `up` is true, from the device to the cloud otherwise. */
static spin_status copy_tracks(struct spin_device *d, const struct spin_param *param,
                               struct spin_refine_cloud *cloud, bool up)
{
    float SPIN_DEV *at[3] = {param->p, param->m, param->v};
    size_t n = cloud->n, stride = sizeof *cloud->point / sizeof(float);
    SPIN_FREED float *host = NULL;

    SPIN_TRY(spin_alloc(n + 1, SPIN_TRACK * sizeof *host, (void **)&host));
    for (int part = 0; n > 0 && part < 3; part++) {
        struct spin_refine_row *first = row_of_part(cloud->point, part);

        if (!up)
            SPIN_TRY(d->op->download(d, host, at[part], SPIN_TRACK * n * sizeof *host));
        for (size_t i = 0; i < n; i++) {
            float *place = row_of_part(&cloud->point[i], part)->pos_w;

            memcpy(up ? host + 3 * i : place, up ? place : host + 3 * i, 3 * sizeof *host);
        }
        if (up)
            spin_residual_from_rows(n, first->log_scale, stride, NULL, host + 3 * n);
        else
            spin_residual_to_rows(n, host + 3 * n, NULL, first->log_scale, stride);
        if (up)
            d->op->upload(d, at[part], host, SPIN_TRACK * n * sizeof *host);
    }
    return SPIN_OK;
}

/* Densification statistics and track of each splat of a frame, in host memory. */
struct seen_frame {
    float *gradient;
    uint32_t *seen, *track;
};

static spin_status fetch_seen(struct spin_trainer *t, int f, struct seen_frame *out)
{
    const struct spin_train_frame *frame = &t->frame[f];
    struct spin_device *d = t->device;
    size_t n = frame->size.n;

    SPIN_TRY(spin_alloc(n + 1, 3 * sizeof(float), (void **)&out->gradient));
    out->seen = (uint32_t *)(out->gradient + n);
    out->track = out->seen + n;
    SPIN_TRY(d->op->download(d, out->gradient, frame->gradient, n * sizeof *out->gradient));
    SPIN_TRY(d->op->download(d, out->seen, frame->seen, n * sizeof *out->seen));
    memset(out->track, 0xff, n * sizeof *out->track); /* SPIN_NO_TRACK */
    return t->n_tracks == 0 ? SPIN_OK
                            : d->op->download(d, out->track, frame->track, n * sizeof *out->track);
}

/* Adds the statistics of the splats of all frames to those of their tracks. */
static spin_status add_statistics(struct change *c)
{
    spin_status status = SPIN_OK;

    for (int f = 0; f < c->t->n_frames; f++) {
        struct seen_frame seen = {0};

        status = fetch_seen(c->t, f, &seen);
        for (size_t i = 0; status == SPIN_OK && i < c->t->frame[f].size.n; i++)
            if (seen.track[i] != SPIN_NO_TRACK) {
                c->tracks.point[seen.track[i]].gradient += seen.gradient[i];
                c->tracks.point[seen.track[i]].seen += seen.seen[i];
            }
        free(seen.gradient);
        SPIN_TRY(status);
    }
    return SPIN_OK;
}

/* Returns the kind of a track, given by its index before the densification: 0 dynamic, 1 varying, 2
 * static, 3 backdrop. New tracks have the kind of the track from which they were split or cloned.
 */
static int kind_of(const struct spin_trainer *t, uint32_t origin)
{
    return origin < t->n_moving                   ? 0
           : origin < t->n_varying                ? 1
           : origin < t->n_tracks - t->n_backdrop ? 2
                                                  : 3;
}

static spin_status sort_tracks(struct change *c)
{
    struct spin_refine_cloud sorted = {0};

    SPIN_TRY(spin_refine_cloud_reserve(&sorted, c->tracks.n));
    for (int kind = 0; kind < 4; kind++) {
        for (size_t i = 0; i < c->tracks.n; i++)
            if (kind_of(c->t, c->tracks.point[i].origin) == kind)
                sorted.point[sorted.n++] = c->tracks.point[i];
        if (kind == 0)
            c->n_moving = sorted.n;
        if (kind == 1 && c->t->n_varying > 0)
            c->n_varying = sorted.n;
    }
    spin_refine_cloud_free(&c->tracks);
    c->tracks = sorted;
    return SPIN_OK;
}

/* Returns how many splats a frame may have in addition to `others` splats, as a value of
 * max_points: 0 if there is no limit, otherwise at least 1, since 0 would mean no limit. */
static size_t remaining_budget(const struct change *c, size_t others)
{
    size_t most = c->o->max_points;

    return most == 0 ? 0 : most > others ? most - others : 1;
}

static spin_status change_tracks(struct change *c, struct spin_densify_change *sum)
{
    struct spin_trainer *t = c->t;
    struct spin_densify_options o = *c->o;
    size_t n = t->n_tracks, most_free = 0;

    for (int f = 0; f < t->n_frames; f++)
        most_free = t->frame[f].size.n_free > most_free ? t->frame[f].size.n_free : most_free;
    o.max_points = remaining_budget(c, most_free);

    SPIN_TRY(spin_refine_cloud_reserve(&c->tracks, n));
    if (n > 0)
        memset(c->tracks.point, 0, n * sizeof *c->tracks.point);
    c->tracks.n = n;
    SPIN_TRY(copy_tracks(t->device, &t->tracks, &c->tracks, false));
    SPIN_TRY(add_statistics(c));
    for (size_t k = n - t->n_backdrop; k < n; k++)
        c->tracks.point[k].gradient = 0;
    o.frame = -1;
    SPIN_TRY(spin_densify(&o, c->iteration, &c->tracks, sum));
    SPIN_TRY(sort_tracks(c));
    spin_param_close(&t->tracks, t->device);
    SPIN_TRY(spin_param_open(&t->tracks, t->device, SPIN_TRACK * c->tracks.n, 0));
    return copy_tracks(t->device, &t->tracks, &c->tracks, true);
}

/* ---- A frame --------------------------------------------------------------------------------- */

/* The splats of a frame after the densification. The cloud contains only the splats that own
 * values, which come first. */
struct rows {
    struct spin_refine_cloud *cloud;
    uint32_t *track;  /* [n] track of each splat, or SPIN_NO_TRACK */
    uint32_t *origin; /* [n] row of each splat before the densification, or NEW_ROW */
    struct spin_frame_size size;
};
static const uint32_t NEW_ROW = UINT32_MAX;

/* Sets c->row for a frame with n splats. Returns the number of splats with a track that this frame
 * has after the densification. */
static size_t find_rows(struct change *c, const struct seen_frame *seen, size_t n)
{
    size_t n_tracked = 0;

    memset(c->row, 0xff, c->n_before * sizeof *c->row);
    for (size_t i = 0; i < n; i++)
        if (seen->track[i] != SPIN_NO_TRACK)
            c->row[seen->track[i]] = (uint32_t)i;
    for (size_t k = 0; k < c->tracks.n; k++)
        n_tracked += c->row[c->tracks.point[k].origin] != SPIN_NO_TRACK;
    return n_tracked;
}

/* Densifies the splats of frame f that have no track, and sets c->after to the result. */
static spin_status change_free(struct change *c, int f, const struct seen_frame *seen,
                               size_t n_free, size_t n_tracked, struct spin_densify_change *sum)
{
    const struct spin_refine_cloud *before = &c->before;
    struct spin_refine_cloud *out = &c->after;
    struct spin_densify_options o = *c->o;
    struct spin_densify_change change;

    SPIN_TRY(spin_refine_cloud_reserve(out, n_free + 1));
    memcpy(out->point, before->point, n_free * sizeof *before->point);
    out->n = n_free;
    if (before->sh)
        memcpy(out->sh, before->sh, 3 * SPIN_REFINE_SH * n_free * sizeof *out->sh);
    for (size_t i = 0; i < n_free; i++) {
        out->point[i].gradient = seen->gradient[i];
        out->point[i].seen = seen->seen[i];
    }
    o.frame += f;
    o.max_points = remaining_budget(c, n_tracked);
    SPIN_TRY(spin_densify(&o, c->iteration, out, &change));
    sum->clones += change.clones;
    sum->splits += change.splits;
    sum->pruned += change.pruned;
    return SPIN_OK;
}

/* Adds a splat of track k to the cloud, with the values that row `row` of the frame had before the
 * densification. */
static void add_own(const struct change *c, size_t k, uint32_t row, struct rows *rows)
{
    struct spin_refine_point *p = &rows->cloud->point[rows->cloud->n++];

    *p = c->before.point[row];
    if (c->tracks.point[k].is_new)
        memset(&p->m, 0, 2 * sizeof p->m); /* m and v */
    rows->size.n_pos += k < c->n_moving;
    rows->size.n_residual += k < c->n_varying;
}

/* Appends the splats of all tracks, in the order of the tracks, to the splats without a track. */
static spin_status add_tracked(const struct change *c, struct rows *rows)
{
    size_t n_free = rows->cloud->n, most = n_free + c->tracks.n, n = n_free;
    size_t n_own = c->n_moving > c->n_varying ? c->n_moving : c->n_varying;

    SPIN_TRY(spin_refine_cloud_reserve(rows->cloud, n_free + n_own));
    SPIN_TRY(spin_alloc(2 * most + 1, sizeof *rows->track, (void **)&rows->track));
    rows->origin = rows->track + most;
    for (size_t i = 0; i < n_free; i++) {
        const struct spin_refine_point *p = &rows->cloud->point[i];

        rows->track[i] = SPIN_NO_TRACK;
        rows->origin[i] = p->is_new ? NEW_ROW : p->origin;
    }
    rows->size.n_free = rows->size.n_pos = rows->size.n_residual = n_free;
    for (size_t k = 0; k < c->tracks.n; k++) {
        uint32_t row = c->row[c->tracks.point[k].origin];

        if (row == SPIN_NO_TRACK)
            continue;
        if (k < n_own)
            add_own(c, k, row, rows);
        rows->origin[n] = c->tracks.point[k].is_new ? NEW_ROW : row;
        rows->track[n++] = (uint32_t)k;
    }
    rows->size.n = n;
    return SPIN_OK;
}

/* Replaces *permutation, the rows of a frame's splats in the output. Kept splats keep their order
 * in the output, and gaps of removed splats are closed; new splats get the last rows. */
static spin_status update_permutation(const struct change *c, const struct rows *rows,
                                      size_t n_before, uint32_t **permutation)
{
    size_t n = rows->size.n, n_kept = 0;
    /* row_at [n_before]: for each row of the output before the densification, the present row of
     * its splat in `rows`, or NEW_ROW if the splat was removed. */
    SPIN_FREED uint32_t *row_at = NULL;
    uint32_t *to;

    SPIN_TRY(spin_alloc(n_before + 1, sizeof *row_at, (void **)&row_at));
    SPIN_TRY(spin_pages_reserve_in(c->t->scratch, (n + 1) * sizeof *to, (void **)&to));
    memset(row_at, 0xff, n_before * sizeof *row_at);
    for (size_t i = 0; i < n; i++)
        if (rows->origin[i] != NEW_ROW)
            row_at[(*permutation)[rows->origin[i]]] = (uint32_t)i;
    for (size_t place = 0; place < n_before; place++)
        if (row_at[place] != NEW_ROW)
            to[row_at[place]] = (uint32_t)n_kept++;
    for (size_t i = 0; i < n; i++)
        if (rows->origin[i] == NEW_ROW)
            to[i] = (uint32_t)n_kept++;
    spin_pages_release(*permutation);
    *permutation = to;
    return SPIN_OK;
}

/* Sets *turn [n_pos][4] to the turns of the frame's splats after the densification, that is, the
 * rotations since the reference frame of their track: a kept splat keeps its turn, a new splat gets
 * that of its parent, and splats without a track get the identity. If the frame has no turns, *turn
 * is left unchanged. The caller frees *turn. */
static spin_status inherit_turns(const struct change *c, const struct spin_train_frame *frame,
                                 const struct rows *rows, float **turn)
{
    struct spin_device *d = c->t->device;
    size_t n = rows->size.n_pos, n_before = frame->size.n_pos;
    float *before;

    if (!frame->turn)
        return SPIN_OK;
    SPIN_TRY(spin_alloc(n + n_before, 4 * sizeof **turn, (void **)turn));
    before = *turn + 4 * n;
    SPIN_TRY(d->op->download(d, before, frame->turn, 4 * n_before * sizeof **turn));
    for (size_t i = 0; i < n; i++) {
        uint32_t k = rows->track[i];

        if (k == SPIN_NO_TRACK)
            (*turn)[4 * i] = 1;
        else
            memcpy(*turn + 4 * i, before + 4 * (size_t)c->row[c->tracks.point[k].origin],
                   4 * sizeof **turn);
    }
    return SPIN_OK;
}

static spin_status replace_frame(struct change *c, int f, const struct rows *rows)
{
    struct spin_device *d = c->t->device;
    struct spin_train_frame *frame = &c->t->frame[f], old = *frame;
    SPIN_FREED float *turn = NULL;

    SPIN_TRY(inherit_turns(c, frame, rows, &turn));
    spin_train_frame_close(frame, d);
    SPIN_TRY(spin_train_frame_open(frame, d, c->t->scratch, rows->size, c->t->sh_width, true));
    frame->time = old.time;
    frame->steps = old.steps;
    d->op->upload(d, frame->track, rows->track, rows->size.n * sizeof *rows->track);
    if (frame->turn)
        d->op->upload(d, frame->turn, turn, 4 * rows->size.n_pos * sizeof *turn);
    return spin_refine_cloud_send(rows->cloud, d, frame);
}

/* Downloads the splats of the frame that own values to c->before. */
static spin_status fetch_frame(struct change *c, const struct spin_train_frame *frame)
{
    const struct spin_frame_size *size = &frame->size;
    struct spin_refine_cloud *before = &c->before;
    size_t n = size->n_pos > size->n_residual ? size->n_pos : size->n_residual;

    SPIN_TRY(spin_refine_cloud_reserve(before, n + 1));
    memset(before->point, 0, n * sizeof *before->point);
    before->n = n;
    return spin_refine_cloud_fetch(before, c->t->device, frame);
}

static spin_status change_frame(struct change *c, int f, uint32_t **permutation,
                                struct spin_densify_change *sum)
{
    const struct spin_train_frame *frame = &c->t->frame[f];
    size_t n = frame->size.n, n_tracked;
    struct rows rows = {.cloud = &c->after};
    struct seen_frame seen = {0};
    spin_status status;

    SPIN_TRY_OUT(fetch_seen(c->t, f, &seen));
    SPIN_TRY_OUT(fetch_frame(c, frame));
    n_tracked = find_rows(c, &seen, n);
    SPIN_TRY_OUT(change_free(c, f, &seen, frame->size.n_free, n_tracked, sum));
    SPIN_TRY_OUT(add_tracked(c, &rows));
    if (permutation)
        SPIN_TRY_OUT(update_permutation(c, &rows, n, permutation));
    status = replace_frame(c, f, &rows);
out:
    free(seen.gradient);
    free(rows.track);
    return status;
}

/* ---- All tracks and frames ------------------------------------------------------------------- */

spin_status spin_densify_tracks(struct spin_trainer *t, const struct spin_densify_options *o,
                                int iteration, uint32_t **permutation, size_t *counts,
                                struct spin_densify_change *change)
{
    struct change c = {.t = t, .o = o, .iteration = iteration, .n_before = t->n_tracks};
    spin_status status;

    SPIN_TRY(spin_alloc(t->n_tracks + 1, sizeof *c.row, (void **)&c.row));
    SPIN_TRY_OUT(spin_trainer_join_seen(t));
    if (t->sh_degree > 0) {
        SPIN_TRY_OUT(spin_refine_add_sh(t->sh_degree, NULL, &c.before));
        SPIN_TRY_OUT(spin_refine_add_sh(t->sh_degree, NULL, &c.after));
    }
    SPIN_TRY_OUT(change_tracks(&c, change));
    for (int f = 0; f < t->n_frames; f++) {
        SPIN_TRY_OUT(change_frame(&c, f, permutation ? &permutation[f] : NULL, change));
        counts[f] = t->frame[f].size.n;
    }
    t->n_tracks = c.tracks.n;
    t->n_moving = c.n_moving;
    t->n_varying = c.n_varying;
    status = spin_trainer_resize(t);
out:
    spin_refine_cloud_free(&c.before);
    spin_refine_cloud_free(&c.after);
    spin_refine_cloud_free(&c.tracks);
    free(c.row);
    return status;
}
