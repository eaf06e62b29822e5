/* Loads the splats of all frames in one pass over the clip. */
#include "train/training_frames.h"

#include "base/base.h"
#include "geometry/neighbours.h"
#include "math/quat.h"
#include "model/field.h"
#include "train/backdrop.h"
#include "train/train_frame.h"
#include "train/track_matching.h"
#include "train/photos.h"

/* Reads a refined frame or, if refinement is NULL, a frame of the source with the splats of the
 * backdrop appended. Fails if a mean is not finite. */
static spin_status read_frame(struct spin_plan *plan, struct spin_refinement *refinement, int frame,
                              unsigned columns, struct spin_splats *out)
{
    int index = spin_plan_index(plan, frame);

    if (refinement)
        SPIN_TRY(spin_refinement_read(refinement, plan, frame, columns, out));
    else
        SPIN_TRY(spin_bundle_frame(&plan->clip.bundle, index, columns, out));
    SPIN_TRY(spin_plan_check_means(plan, frame, refinement != NULL, out));
    return refinement ? SPIN_OK : spin_backdrop_append(&plan->backdrop, out);
}

spin_status spin_frames_reserve(struct spin_frames *frames, const struct spin_trainer *t, int f,
                                size_t n)
{
    return spin_pages_reserve_in(t->scratch, (n + 1) * sizeof **frames->permutation,
                                 (void **)&frames->permutation[f]);
}

/* ---- The scene transform --------------------------------------------------------------------- */

/* With --scene-normalise auto, sets the centre of the scene transform to the median of the sampled
 * points along each axis, and its radius to that of the ball around the centre that contains 90 %
 * of the points (docs/method.md 3.1). Otherwise the transform remains the identity. */
static void fit_transform(const struct spin_retrain_options *o, struct spin_point_sample *sample,
                          struct spin_scene_transform *t)
{
    if (o->normalise == SPIN_NORMALISE_AUTO)
        t->inv_radius = 1.0f / fmaxf(spin_point_sample_enclose(sample, t->centre), 1e-20f);
}

static double share_outside(const struct spin_point_sample *sample,
                            const struct spin_scene_transform *t)
{
    size_t outside = 0;

    for (size_t i = 0; i < sample->n; i++)
        outside +=
            spin_point_square_to(sample->point + 3 * i, t->centre) * pow((double)t->inv_radius, 2) >
            1;
    return sample->n ? (double)outside / (double)sample->n : 0;
}

spin_status spin_frames_check_points(struct spin_plan *plan)
{
    struct spin_scene_transform transform = plan->field.transform;
    SPIN_LEAVES(spin_splats_free) struct spin_splats splats = {0};
    SPIN_LEAVES(spin_point_sample_close) struct spin_point_sample sample = {0};

    SPIN_TRY(spin_point_sample_open(&sample, plan->clip.n_frames));
    for (int f = 0; f < plan->clip.n_frames; f++) {
        SPIN_TRY(read_frame(plan, NULL, f, SPIN_COL_MEANS, &splats));
        spin_point_sample_add(&sample, &splats);
    }
    fit_transform(plan->o, &sample, &transform);
    plan->report->outside_ball = share_outside(&sample, &transform);
    return SPIN_OK;
}

/* ---- Initial values -------------------------------------------------------------------------- */

/* Returns the columns that the initial values of a frame require: all attributes with --residual
 * source, colours with other residual values, which are then initialised from coloured points as in
 * 3DGS, and only the means without residual values. */
static unsigned first_columns(const struct spin_plan *plan, bool refined)
{
    if (!spin_plan_has_residual(plan))
        return SPIN_COL_MEANS;
    if (plan->o->residual == SPIN_RESIDUAL_SOURCE)
        return SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    return refined ? SPIN_COL_MEANS | SPIN_COL_RGB : spin_plan_point_columns(plan);
}

/* If an attribute of a splat is not finite, replaces all its attributes by those of a small, grey
 * and faint splat. */
static void make_finite(struct spin_refine_row *p)
{
    static const struct spin_refine_row none = {
        .logit_opacity = -2.1972246f, .log_scale = {-5, -5, -5}, .rotation = {1, 0, 0, 0}};
    float sum = p->logit_opacity;

    for (int k = 0; k < 3; k++)
        sum += p->log_scale[k] + p->dc[k];
    for (int k = 0; k < 4; k++)
        sum += p->rotation[k];
    if (!isfinite(sum))
        *p = none;
}

/* Initial values of the tracks, in host memory. The values of a track are copied from its first
 * splat that is visible in any training view or, if none is visible, from its first splat. */
struct first_tracks {
    const struct spin_tracks *tracks;
    /* displacement: [n][3] positions of static tracks, displacements of dynamic tracks. residual:
     * [n][SPIN_RESIDUAL]. */
    float *displacement, *residual;
    /* [n] origin of the values of each track so far: 0 none, 1 an invisible splat, 2 a visible
     * splat */
    uint8_t *seen;
};

static spin_status open_first_tracks(struct first_tracks *first, const struct spin_tracks *tracks)
{
    SPIN_TRY(
        spin_alloc(tracks->n + 1, SPIN_TRACK * sizeof(float) + 1, (void **)&first->displacement));
    first->tracks = tracks;
    first->residual = first->displacement + 3 * tracks->n;
    first->seen = (uint8_t *)(first->residual + SPIN_RESIDUAL * tracks->n);
    return SPIN_OK;
}

static void close_first_tracks(struct first_tracks *first) { free(first->displacement); }

/* Copies the initial values of tracks from the points of a frame. Skips a track that already has
 * values, unless these are from an invisible splat and the point of this frame is visible. The
 * displacement of a static track is its position; that of a dynamic track, which is added to the
 * positions of its splats, remains 0. */
static void record_first_values(struct first_tracks *first, int frame,
                                const struct spin_refine_cloud *cloud)
{
    for (size_t i = 0; i < cloud->n; i++) {
        uint32_t track = first->tracks->of[frame][i];
        uint8_t seen = cloud->point[i].seen ? 2 : 1;

        if (track == SPIN_NO_TRACK || first->seen[track] >= seen)
            continue;
        first->seen[track] = seen;
        memcpy(first->residual + SPIN_RESIDUAL * track, cloud->point[i].p.log_scale,
               SPIN_RESIDUAL * sizeof(float));
        if (track >= first->tracks->n_moving)
            memcpy(first->displacement + 3 * track, first->tracks->place + 3 * track,
                   3 * sizeof(float));
    }
}

/* Converts the initial values of the tracks to groups (device.h) and uploads them. */
static spin_status send_first_tracks(const struct first_tracks *first, struct spin_trainer *t)
{
    struct spin_device *d = t->device;
    size_t n = first->tracks->n;
    SPIN_FREED void *block = NULL;

    if (n == 0)
        return SPIN_OK;
    SPIN_TRY(spin_alloc(n, SPIN_RESIDUAL * sizeof(float), &block));
    spin_residual_from_rows(n, first->residual, SPIN_RESIDUAL, NULL, block);
    d->op->upload(d, t->tracks.p, first->displacement, 3 * n * sizeof(float));
    d->op->upload(d, t->tracks.p + 3 * n, block, SPIN_RESIDUAL * n * sizeof(float));
    return SPIN_OK;
}

/* Zeroes the residual values of splats with a track: their initial values are stored in the track,
 * and the sum of the values of the splat and of its track is rendered. */
static void clear_tracked(const struct spin_tracks *tracks, int frame,
                          struct spin_refine_cloud *cloud)
{
    for (size_t i = 0; i < cloud->n; i++)
        if (tracks->of[frame][i] != SPIN_NO_TRACK)
            memset(cloud->point[i].p.log_scale, 0, SPIN_RESIDUAL * sizeof(float));
}

/* Computes the initial values of frame f from its splats s, records the values of tracks in *first,
 * and uploads all other values in the trainer's order. */
static spin_status send_frame(const struct spin_plan *plan, const struct spin_splats *s, int f,
                              const uint32_t *permutation, struct first_tracks *first,
                              struct spin_device *device, struct spin_train_frame *frame)
{
    SPIN_LEAVES(spin_refine_cloud_free) struct spin_refine_cloud cloud = {0};
    struct spin_frame_rows rows = {.pos = {s->means, 3}};

    if (spin_plan_has_residual(plan)) {
        if (plan->o->residual == SPIN_RESIDUAL_SOURCE)
            SPIN_TRY(spin_refine_init_from_splats(s, &cloud));
        else {
            SPIN_TRY(spin_refine_init_from_colours(s, &cloud));
            SPIN_TRY(spin_show_unseen(plan, s, f, &cloud));
        }
        for (size_t i = 0; i < cloud.n; i++)
            make_finite(&cloud.point[i].p);
        spin_backdrop_first_values(&plan->backdrop, &cloud);
        if (first->tracks->n > 0) {
            record_first_values(first, f, &cloud);
            clear_tracked(first->tracks, f, &cloud);
        }
        if (cloud.n > 0)
            rows.residual =
                (struct spin_rows){cloud.point[0].p.log_scale, sizeof *cloud.point / sizeof(float)};
    }
    return spin_train_frame_upload(frame, device, SPIN_TRAIN_VALUES, rows, permutation);
}

/* Uploads the track of each splat of frame f, in the trainer's order. */
static spin_status send_track_numbers(const struct spin_tracks *tracks, int f, size_t n,
                                      const uint32_t *permutation, struct spin_device *device,
                                      struct spin_train_frame *frame)
{
    SPIN_FREED uint32_t *track = NULL;

    SPIN_TRY(spin_alloc(n + 1, sizeof *track, (void **)&track));
    for (size_t i = 0; i < n; i++)
        track[i] = tracks->of[f][permutation[i]];
    device->op->upload(device, frame->track, track, n * sizeof *track);
    return SPIN_OK;
}

/* Records the tracks and positions of the splats of dynamic tracks in frame f. In the trainer's
 * order, these splats follow those without a track, sorted by track. */
static spin_status add_places(struct spin_turns *turns, const struct spin_tracks *tracks, int f,
                              const struct spin_splats *s, const uint32_t *permutation,
                              const struct spin_frame_size *size)
{
    size_t n = size->n_pos - size->n_free;

    SPIN_TRY(spin_turns_reserve(turns, f, n));
    for (size_t i = 0; i < n; i++) {
        uint32_t row = permutation[size->n_free + i];

        turns->frame[f].track[i] = tracks->of[f][row];
        memcpy(turns->frame[f].at + 3 * i, s->means + 3 * (size_t)row, 3 * sizeof *s->means);
    }
    return SPIN_OK;
}

static spin_status send_turns(const struct spin_plan *plan, struct spin_turns *turns,
                              size_t n_tracks, struct spin_trainer *t)
{
    struct spin_pool *pool = NULL;
    spin_status status;

    SPIN_TRY_OUT(spin_pool_create(plan->o->n_threads, &pool));
    SPIN_TRY_OUT(spin_turns_find(turns, n_tracks, pool));
    for (int f = 0; f < t->n_frames; f++) {
        const struct spin_train_frame *frame = &t->frame[f];
        const struct spin_turns_frame *from = &turns->frame[f];

        if (from->n > 0)
            t->device->op->upload(t->device, frame->turn + 4 * frame->size.n_free, from->turn,
                                  4 * from->n * sizeof *from->turn);
    }
    status = SPIN_OK;
out:
    spin_pool_free(pool);
    return status;
}

/* Converts the initial rotation of each track to the reference frame: it was copied from the first
 * splat of the track, so the inverse of that splat's turn is applied. Rendering applies the turn
 * again. Tracks that were initialised from coloured points need no conversion, since they are
 * isotropic. */
static void turn_first_tracks(struct first_tracks *first, const struct spin_turns *turns)
{
    memset(first->seen, 0, first->tracks->n);
    for (int f = 0; f < turns->n_frames; f++)
        for (size_t i = 0; i < turns->frame[f].n; i++) {
            uint32_t track = turns->frame[f].track[i];
            float *rotation = first->residual + SPIN_RESIDUAL * track + 3, back[4];

            if (first->seen[track])
                continue;
            first->seen[track] = 1;
            spin_turn_adj(turns->frame[f].turn + 4 * i, 4, rotation, back);
            memcpy(rotation, back, sizeof back);
        }
}

/* ---- The pass -------------------------------------------------------------------------------- */

static spin_status load_frame(struct spin_frames *frames, struct spin_plan *plan,
                              struct first_tracks *first, struct spin_turns *turns,
                              struct spin_trainer *trainer, int f, const struct spin_splats *s,
                              bool first_values)
{
    const struct spin_tracks *tracks = first->tracks;
    /* After a resume, this number may differ from that in the bundle because of densification. */
    size_t n = trainer->frame[f].size.n;

    SPIN_TRY(spin_frames_reserve(frames, trainer, f, n > s->n ? n : s->n));
    /* Order splats along a space-filling curve so that neighbours share cache lines. */
    SPIN_TRY(spin_morton_order(s->n, s->means, frames->permutation[f]));
    if (trainer->tracked && first_values) {
        SPIN_TRY(spin_tracks_sort(tracks, f, s->n, frames->permutation[f]));
        SPIN_TRY(send_track_numbers(tracks, f, s->n, frames->permutation[f], trainer->device,
                                    &trainer->frame[f]));
        if (trainer->frame[f].turn)
            SPIN_TRY(
                add_places(turns, tracks, f, s, frames->permutation[f], &trainer->frame[f].size));
    }
    trainer->frame[f].time = spin_plan_info(plan, f)->time;
    if (!first_values)
        return SPIN_OK;
    return send_frame(plan, s, f, frames->permutation[f], first, trainer->device,
                      &trainer->frame[f]);
}

spin_status spin_frames_load(struct spin_frames *frames, struct spin_plan *plan,
                             struct spin_refinement *refinement, struct spin_tracks *tracks,
                             struct spin_trainer *trainer, bool first_values)
{
    SPIN_LEAVES(close_first_tracks) struct first_tracks first = {0};
    struct spin_refinement *from = refinement->frame ? refinement : NULL;
    unsigned columns = first_values ? first_columns(plan, from != NULL) : SPIN_COL_MEANS;
    struct spin_scene_transform *transform = &trainer->field.transform;
    SPIN_LEAVES(spin_splats_free) struct spin_splats splats = {0};
    SPIN_LEAVES(spin_point_sample_close) struct spin_point_sample sample = {0};
    SPIN_LEAVES(spin_turns_close) struct spin_turns turns = {0};

    SPIN_TRY(spin_turns_open(&turns, plan->clip.n_frames));
    turns.scratch = trainer->scratch;
    SPIN_TRY(spin_alloc((size_t)plan->clip.n_frames, sizeof *frames->permutation,
                        (void **)&frames->permutation));
    frames->n = plan->clip.n_frames;
    SPIN_TRY(open_first_tracks(&first, tracks));
    SPIN_TRY(spin_point_sample_open(&sample, plan->clip.n_frames));
    for (int f = 0; f < frames->n; f++) {
        SPIN_TRY(read_frame(plan, from, f, columns, &splats));
        spin_point_sample_add(&sample, &splats);
        SPIN_TRY(load_frame(frames, plan, &first, &turns, trainer, f, &splats, first_values));
        if (tracks->of) {
            free(tracks->of[f]);
            tracks->of[f] = NULL;
        }
    }
    fit_transform(plan->o, &sample, transform);
    plan->report->outside_ball = share_outside(&sample, transform);
    spin_point_sample_close(&sample);
    sample.point = NULL;
    if (first_values) {
        SPIN_TRY(send_turns(plan, &turns, tracks->n, trainer));
        if (plan->o->residual == SPIN_RESIDUAL_SOURCE)
            turn_first_tracks(&first, &turns);
        SPIN_TRY(send_first_tracks(&first, trainer));
    }
    return SPIN_OK;
}

void spin_frames_close(struct spin_frames *frames)
{
    for (int f = 0; f < frames->n; f++)
        spin_pages_release(frames->permutation[f]);
    free(frames->permutation);
}
