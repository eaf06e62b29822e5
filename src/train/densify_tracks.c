/* Host memory only; one frame after the other comes down, changes and goes up again. All ranks do the same. */
#include "train/densify_tracks.h"

#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/mem.h"
#include "model/residual.h"

/* Old and new tracks. */
struct change {
    struct spin_trainer *t;
    const struct spin_densify_options *o;
    int iteration;
    struct spin_refine_cloud
        tracks; /* the new ones, in the order of kinds: moving, varying, others */
    size_t n_before, n_moving, n_varying;
    uint32_t *row; /* [n_before] a frame's splat of an old track, or SPIN_NO_TRACK */
};

/* ---- The tracks' parameters ---------------------------------------------------------------------- */

static struct spin_refine_row *part_of(struct spin_refine_point *p, int part)
{
    return part == 0 ? &p->p : part == 1 ? &p->m : &p->v;
}

/* Values, first and second moments, between the device's groups and rows of the cloud. */
static spin_status carry_tracks(struct spin_device *d, const struct spin_param *param,
                                struct spin_refine_cloud *cloud, bool up)
{
    float SPIN_DEV *at[3] = {param->p, param->m, param->v};
    size_t n = cloud->n, stride = sizeof *cloud->point / sizeof(float);
    void *block = NULL;
    float *host;
    spin_status status = SPIN_OK;

    SPIN_TRY(spin_alloc(n + 1, SPIN_TRACK * sizeof *host, &block));
    host = block;
    for (int part = 0; n > 0 && part < 3; part++) {
        struct spin_refine_row *first = part_of(cloud->point, part);

        if (!up)
            SPIN_TRY_OUT(d->op->download(d, host, at[part], SPIN_TRACK * n * sizeof *host));
        for (size_t i = 0; i < n; i++) {
            float *place = part_of(&cloud->point[i], part)->pos_w;

            memcpy(up ? host + 3 * i : place, up ? place : host + 3 * i, 3 * sizeof *host);
        }
        if (up)
            spin_residual_from_rows(n, first->log_scale, stride, NULL, host + 3 * n);
        else
            spin_residual_to_rows(n, host + 3 * n, NULL, first->log_scale, stride);
        if (up)
            d->op->upload(d, at[part], host, SPIN_TRACK * n * sizeof *host);
    }
out:
    free(block);
    return status;
}

/* Statistics of a frame's splats, and their tracks. */
struct seen_frame {
    float *gradient;
    uint32_t *seen, *track;
};

static spin_status fetch_seen(struct spin_trainer *t, int f, struct seen_frame *out)
{
    const struct spin_train_frame *frame = &t->frame[f];
    struct spin_device *d = t->device;
    size_t n = frame->size.n;
    void *block = NULL;

    SPIN_TRY(spin_alloc(n + 1, 3 * sizeof(float), &block));
    out->gradient = block;
    out->seen = (uint32_t *)(out->gradient + n);
    out->track = out->seen + n;
    SPIN_TRY(d->op->download(d, out->gradient, frame->gradient, n * sizeof *out->gradient));
    SPIN_TRY(d->op->download(d, out->seen, frame->seen, n * sizeof *out->seen));
    return d->op->download(d, out->track, frame->track, n * sizeof *out->track);
}

/* A track has been seen as often as its splats. */
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

/* A new track is of its parent's kind. */
static int kind_of(const struct spin_trainer *t, uint32_t origin)
{
    return origin < t->n_moving ? 0 : origin < t->n_varying ? 1 : 2;
}

static spin_status sort_tracks(struct change *c)
{
    struct spin_refine_cloud sorted = {0};

    SPIN_TRY(spin_refine_cloud_reserve(&sorted, c->tracks.n));
    for (int kind = 0; kind < 3; kind++) {
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

/* What is left of the most splats of a frame. 0 would be no limit. */
static size_t cap_beside(const struct change *c, size_t others)
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
    o.max_points = cap_beside(c, most_free);

    SPIN_TRY(spin_refine_cloud_reserve(&c->tracks, n));
    memset(c->tracks.point, 0, n * sizeof *c->tracks.point);
    c->tracks.n = n;
    SPIN_TRY(carry_tracks(t->device, &t->tracks, &c->tracks, false));
    SPIN_TRY(add_statistics(c));
    o.frame = -1;
    SPIN_TRY(spin_densify(&o, c->iteration, &c->tracks, sum));
    SPIN_TRY(sort_tracks(c));
    spin_param_close(&t->tracks, t->device);
    SPIN_TRY(spin_param_open(&t->tracks, t->device, SPIN_TRACK * c->tracks.n, 0));
    return carry_tracks(t->device, &t->tracks, &c->tracks, true);
}

/* ---- A frame ------------------------------------------------------------------------------------- */

/* A frame's splats as rows; what a splat has not of its own is zero. */
struct rows {
    struct spin_refine_cloud cloud;
    uint32_t *track; /* [n] */
    struct spin_frame_size size;
};

static spin_status carry_frame(struct spin_device *d, struct spin_train_frame *frame,
                               struct spin_refine_point *point, bool up)
{
    size_t stride = sizeof *point / sizeof(float);

    for (int part = 0; part < 3; part++) {
        enum spin_train_array which = SPIN_TRAIN_VALUES + part;
        struct spin_refine_row *row = part_of(point, part);
        struct spin_rows pos = {frame->size.n_pos ? row->pos_w : NULL, stride};
        struct spin_rows residual = {frame->size.n_residual ? row->log_scale : NULL, stride};

        if (up)
            SPIN_TRY(spin_train_frame_upload(frame, d, which, pos, residual, NULL));
        else
            SPIN_TRY(spin_train_frame_download(frame, d, which, pos, residual, NULL));
    }
    return SPIN_OK;
}

/* c->row of this frame; how many splats the new tracks have there. */
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

/* Densify the splats without a track. */
static spin_status change_free(struct change *c, int f, const struct seen_frame *seen,
                               const struct spin_refine_point *before, size_t n_free,
                               size_t n_tracked, struct spin_refine_cloud *out,
                               struct spin_densify_change *sum)
{
    struct spin_densify_options o = *c->o;
    struct spin_densify_change change;

    SPIN_TRY(spin_refine_cloud_reserve(out, n_free + 1));
    memcpy(out->point, before, n_free * sizeof *before);
    out->n = n_free;
    for (size_t i = 0; i < n_free; i++) {
        out->point[i].gradient = seen->gradient[i];
        out->point[i].seen = seen->seen[i];
    }
    o.frame = f;
    o.max_points = cap_beside(c, n_tracked);
    SPIN_TRY(spin_densify(&o, c->iteration, out, &change));
    sum->clones += change.clones;
    sum->splits += change.splits;
    sum->pruned += change.pruned;
    return SPIN_OK;
}

/* The splats of the new tracks behind those without one, in the order of the tracks. */
static spin_status add_tracked(const struct change *c, const struct spin_refine_point *before,
                               struct rows *rows)
{
    struct spin_refine_cloud *to = &rows->cloud;
    void *block = NULL;

    SPIN_TRY(spin_refine_cloud_reserve(to, to->n + c->tracks.n));
    SPIN_TRY(spin_alloc(to->n + c->tracks.n + 1, sizeof *rows->track, &block));
    rows->track = block;
    for (size_t i = 0; i < to->n; i++)
        rows->track[i] = SPIN_NO_TRACK;
    rows->size.n_free = rows->size.n_pos = rows->size.n_residual = to->n;
    for (size_t k = 0; k < c->tracks.n; k++) {
        const struct spin_refine_point *track = &c->tracks.point[k];
        uint32_t row = c->row[track->origin];
        struct spin_refine_point *p = &to->point[to->n];

        if (row == SPIN_NO_TRACK)
            continue;
        *p = before[row];
        p->origin = row;
        p->is_new = track->is_new;
        if (p->is_new)
            memset(&p->m, 0, 2 * sizeof p->m); /* m and v */
        rows->size.n_pos += k < c->n_moving;
        rows->size.n_residual += k < c->n_varying;
        rows->track[to->n++] = (uint32_t)k;
    }
    rows->size.n = to->n;
    return SPIN_OK;
}

struct place {
    uint32_t place, row;
};

static int compare_places(const void *a, const void *b)
{
    const struct place *x = a, *y = b;

    return (x->place > y->place) - (x->place < y->place);
}

/* Splats that were there keep their order in the output, new ones follow. */
static spin_status permute(const struct rows *rows, uint32_t **permutation)
{
    size_t n = rows->cloud.n, n_kept = 0;
    struct place *kept;
    uint32_t *to;
    void *block = NULL, *list = NULL;
    spin_status status = SPIN_OK;

    SPIN_TRY_OUT(spin_alloc(n + 1, sizeof *to, &block));
    SPIN_TRY_OUT(spin_alloc(n + 1, sizeof *kept, &list));
    to = block;
    kept = list;
    for (size_t i = 0; i < n; i++)
        if (!rows->cloud.point[i].is_new)
            kept[n_kept++] =
                (struct place){(*permutation)[rows->cloud.point[i].origin], (uint32_t)i};
    qsort(kept, n_kept, sizeof *kept, compare_places);
    for (size_t i = 0; i < n_kept; i++)
        to[kept[i].row] = (uint32_t)i;
    for (size_t i = 0; i < n; i++)
        if (rows->cloud.point[i].is_new)
            to[i] = (uint32_t)n_kept++;
    free(*permutation);
    *permutation = to;
    block = NULL;
out:
    free(list);
    free(block);
    return status;
}

static spin_status replace_frame(struct change *c, int f, const struct rows *rows)
{
    struct spin_device *d = c->t->device;
    struct spin_train_frame *frame = &c->t->frame[f], old = *frame;

    spin_train_frame_close(frame, d);
    SPIN_TRY(spin_train_frame_open(frame, d, rows->size, true));
    frame->time = old.time;
    frame->steps = old.steps;
    d->op->upload(d, frame->track, rows->track, rows->size.n * sizeof *rows->track);
    return carry_frame(d, frame, rows->cloud.point, true);
}

static spin_status change_frame(struct change *c, int f, uint32_t **permutation,
                                struct spin_densify_change *sum)
{
    struct spin_train_frame *frame = &c->t->frame[f];
    size_t n = frame->size.n, n_tracked;
    struct spin_refine_cloud before = {0};
    struct rows rows = {0};
    struct seen_frame seen = {0};
    spin_status status;

    SPIN_TRY_OUT(fetch_seen(c->t, f, &seen));
    SPIN_TRY_OUT(spin_refine_cloud_reserve(&before, n + 1));
    memset(before.point, 0, (n + 1) * sizeof *before.point);
    SPIN_TRY_OUT(carry_frame(c->t->device, frame, before.point, false));
    n_tracked = find_rows(c, &seen, n);
    SPIN_TRY_OUT(
        change_free(c, f, &seen, before.point, frame->size.n_free, n_tracked, &rows.cloud, sum));
    SPIN_TRY_OUT(add_tracked(c, before.point, &rows));
    SPIN_TRY_OUT(permute(&rows, permutation));
    status = replace_frame(c, f, &rows);
out:
    free(seen.gradient);
    free(rows.track);
    spin_refine_cloud_free(&rows.cloud);
    spin_refine_cloud_free(&before);
    return status;
}

/* ---- The whole ---------------------------------------------------------------------------------- */

spin_status spin_densify_tracks(struct spin_trainer *t, const struct spin_densify_options *o,
                                int iteration, uint32_t **permutation, size_t *counts,
                                struct spin_densify_change *change)
{
    struct change c = {.t = t, .o = o, .iteration = iteration, .n_before = t->n_tracks};
    void *block = NULL;
    spin_status status;

    SPIN_TRY(spin_alloc(t->n_tracks + 1, sizeof *c.row, &block));
    c.row = block;
    SPIN_TRY_OUT(spin_trainer_join_seen(t));
    SPIN_TRY_OUT(change_tracks(&c, change));
    for (int f = 0; f < t->n_frames; f++) {
        SPIN_TRY_OUT(change_frame(&c, f, &permutation[f], change));
        counts[f] = t->frame[f].size.n;
    }
    t->n_tracks = c.tracks.n;
    t->n_moving = c.n_moving;
    t->n_varying = c.n_varying;
    status = spin_trainer_resize(t);
out:
    spin_refine_cloud_free(&c.tracks);
    free(block);
    return status;
}
