/* A round of a step with several ranks (share.h): frame i of the round is drawn by rank i.
 *
 *   0. Positions of all its frames go from their owners to every rank that encodes, all values to the rank that draws.
 *   1. Every rank encodes the splats of all frames with its levels; frame i's features go to rank i.
 *   2. Rank i decodes and draws its frame, and goes back to the gradient of the features.
 *   3. That goes to the levels' ranks, of the splats that have one. They add up the table's gradient, frame after
 *      frame, and send back their branches of the gradient of the positions.
 *   4. Everybody gets the gradients of heads and exposures, and the losses, and takes the same step of these; the
 *      owner of a frame gets the frame's gradients, and steps it. With tracks all get these, and step the tracks.
 *
 * Messages lie in the device's memory (exchange.h). */
#include "train/step_ranks.h"

#include <stdlib.h>

#include "base/err.h"
#include "base/mem.h"
#include "io/ranks.h"

struct round {
    struct spin_trainer *t;
    const struct spin_step_batch *b;
    const int *first;
    int n;                               /* frames */
    struct spin_device_message *message; /* room for one of each frame to each rank, and four */
    size_t n_messages;
    struct told {
        uint32_t active;     /* splats of its frame that have a gradient */
        uint32_t seen;       /* whether a view showed any splat */
    } * told;                /* [ranks] */
    uint32_t SPIN_DEV *rows; /* [told.active of this rank] these splats of its frame */
    int first_value;         /* row of the losses */
    float SPIN_DEV *values;  /* of each frame, see spin_trainer_pack() */
};

enum buffer { TO_SEND, RECEIVED, ROWS, BRANCHES, BLOBS, VALUES };

/* Memory of this round for so many values of 4 bytes, until the next call for the same buffer. */
static spin_status need(struct round *r, enum buffer buffer, size_t values, float SPIN_DEV **out)
{
    struct spin_trainer *t = r->t;
    size_t bytes = values * sizeof **out;

    if (!t->round[buffer] || bytes > t->round_bytes[buffer]) {
        t->device->op->release(t->device, t->round[buffer], t->round_bytes[buffer]);
        t->round[buffer] = NULL;
        t->round_bytes[buffer] = bytes + bytes / 8 + 64;
        SPIN_TRY(t->device->op->reserve(t->device, t->round_bytes[buffer], &t->round[buffer]));
    }
    *out = t->round[buffer];
    return SPIN_OK;
}

static void copy(const struct round *r, float SPIN_DEV *to, const float SPIN_DEV *from, size_t n)
{
    r->t->device->op->copy_rows(r->t->device, 1, n, from, n, to, n);
}

static bool has_frame(const struct round *r, int rank) { return rank < r->n; }

static size_t splats_of(const struct round *r, int frame)
{
    return r->t->frame[r->b->items[r->first[frame]].frame].size.n;
}

static int features_of(const struct round *r, struct spin_levels levels)
{
    return (levels.end - levels.first) * r->t->field.grid.n_features;
}

static struct spin_levels levels_of(const struct round *r, int rank)
{
    return spin_share_levels(&r->t->field.grid, rank, spin_n_ranks());
}

static void add_message(struct round *r, int peer, bool receive, void SPIN_DEV *at, size_t values)
{
    if (values > 0)
        r->message[r->n_messages++] =
            (struct spin_device_message){peer, receive, at, values * sizeof(float)};
}

static spin_status send_all(struct round *r)
{
    size_t n = r->n_messages;

    r->n_messages = 0;
    return spin_exchange(&r->t->exchange, r->message, n);
}

static int frame_of(const struct round *r, int i) { return r->b->items[r->first[i]].frame; }

/* Where frame i's values are among those of the round. */
static float SPIN_DEV *values_of(const struct round *r, int i)
{
    size_t at = 0;

    for (int k = 0; k < i; k++)
        at += spin_trainer_floats(r->t, frame_of(r, k));
    return r->values + at;
}

/* One frame of the round alone, of which the means are there. */
static struct spin_frame_batch take_frame(struct round *r, int i)
{
    struct spin_frame_batch frames;
    int f = frame_of(r, i);

    if (!spin_trainer_owns(f) && r->t->visiting != f)
        spin_trainer_receive(r->t, f, values_of(r, i), false);
    frames = spin_step_frames(r->t, r->b, &r->first[i], 1);

    spin_step_add_tracks(r->t, &frames);
    return frames;
}

/* ---- 0: frames' values --------------------------------------------------------------------------- */

/* Floats of frame i that a rank needs: all when it draws, positions when it encodes, which are the first. */
static size_t floats_for(const struct round *r, int i, int rank)
{
    int f = frame_of(r, i);
    bool encodes = spin_trainer_network(r->t) && features_of(r, levels_of(r, rank)) > 0;

    return i == rank ? spin_trainer_floats(r->t, f) : encodes * 3 * r->t->frame[f].size.n_pos;
}

static spin_status share_values(struct round *r)
{
    struct spin_trainer *t = r->t;

    t->visiting = -1; /* its values have changed */
    SPIN_TRY(need(r, VALUES, (size_t)(values_of(r, r->n) - r->values), &r->values));
    for (int i = 0; i < r->n; i++) {
        int owner = spin_share_owner(frame_of(r, i));
        float SPIN_DEV *at = values_of(r, i);

        if (owner != spin_rank()) {
            add_message(r, owner, true, at, floats_for(r, i, spin_rank()));
            continue;
        }
        spin_trainer_pack(t, frame_of(r, i), at, i != owner);
        for (int k = 0; k < spin_n_ranks(); k++)
            if (k != owner)
                add_message(r, k, false, at, floats_for(r, i, k));
    }
    return send_all(r);
}

/* ---- 1: features --------------------------------------------------------------------------------- */

/* This rank's features of every frame, one after the other. */
static void encode_frames(struct round *r, float SPIN_DEV *to)
{
    struct spin_trainer *t = r->t;
    size_t width = (size_t)features_of(r, t->levels);

    t->part.transform = t->field.transform;
    for (int i = 0; i < r->n && width > 0; i++) {
        struct spin_frame_batch frames = take_frame(r, i);

        spin_field_encode(&t->field_eval, &t->part, t->table.p, &frames);
        copy(r, to, t->field_eval.z, frames.n * width);
        if (i != spin_rank())
            add_message(r, i, false, to, frames.n * width);
        to += frames.n * width;
    }
}

/* The features of this rank's frame, from all ranks, to the rows of all features. */
static void put_features(struct round *r, const float SPIN_DEV *received, const float SPIN_DEV *own)
{
    struct spin_trainer *t = r->t;
    size_t n = splats_of(r, spin_rank()), all = (size_t)t->field.heads.n_in, at = 0;

    for (int k = 0; k < spin_n_ranks(); k++) {
        size_t width = (size_t)features_of(r, levels_of(r, k));

        t->device->op->copy_rows(t->device, n, width, k == spin_rank() ? own : received, width,
                                 t->field_eval.z + at, all);
        received += k == spin_rank() ? 0 : n * width;
        at += width;
    }
}

static spin_status share_features(struct round *r)
{
    size_t width = (size_t)features_of(r, r->t->levels), before = 0, sum = 0, n = 0, at = 0;
    float SPIN_DEV *to_send;
    float SPIN_DEV *received;

    for (int i = 0; i < r->n; i++) {
        before += i < spin_rank() ? splats_of(r, i) : 0;
        sum += splats_of(r, i);
    }
    n = has_frame(r, spin_rank()) ? splats_of(r, spin_rank()) : 0;
    SPIN_TRY(need(r, TO_SEND, sum * width, &to_send));
    SPIN_TRY(need(r, RECEIVED, n * (size_t)r->t->field.heads.n_in, &received));
    for (int k = 0; k < spin_n_ranks() && n > 0; k++) {
        size_t floats = k == spin_rank() ? 0 : n * (size_t)features_of(r, levels_of(r, k));

        add_message(r, k, true, received + at, floats);
        at += floats;
    }
    encode_frames(r, to_send);
    SPIN_TRY(send_all(r));
    if (n > 0)
        put_features(r, received, to_send + before * width);
    return SPIN_OK;
}

/* ---- 2: a rank's own frame ----------------------------------------------------------------------- */

static int items_of(const struct round *r, int frame)
{
    int n = 0;

    for (int k = r->first[frame]; k < r->b->n; k++)
        n += r->b->items[k].frame == r->b->items[r->first[frame]].frame;
    return n;
}

/* Losses have a row each, in the order of frames, whoever draws them. Returns that of this rank's frame. */
static int number_values(struct round *r)
{
    struct spin_trainer *t = r->t;
    int own = 0;

    r->first_value = t->n_drawn;
    for (int i = 0; i < r->n; i++) {
        own = i == spin_rank() ? t->n_drawn : own;
        for (int k = r->first[i]; k < r->b->n; k++)
            if (r->b->items[k].frame == r->b->items[r->first[i]].frame)
                t->drawn[t->n_drawn++] = k;
    }
    return own;
}

static spin_status draw_own(struct round *r, int first_value)
{
    struct spin_trainer *t = r->t;
    const struct spin_field *network = spin_trainer_network(t);
    int n_drawn = t->n_drawn, f = frame_of(r, spin_rank());
    struct spin_frame_batch frames;

    if (!spin_trainer_owns(f)) /* once: drawing adds to what densification goes by */
        spin_trainer_receive(t, f, values_of(r, spin_rank()), true);
    frames = take_frame(r, spin_rank());
    spin_field_decode(&t->field_eval, network, t->heads.p, &frames);
    t->n_drawn = first_value;
    SPIN_TRY(spin_step_draw(t, r->b, &r->first[spin_rank()], &frames));
    t->n_drawn = n_drawn;
    spin_field_decode_back(&t->field_eval, network, t->heads.p, &frames, t->heads.g);
    return SPIN_OK;
}

/* Every rank's number of active splats, and whether it saw any. */
static spin_status tell(struct round *r)
{
    struct spin_trainer *t = r->t;
    struct told *own = &r->told[spin_rank()];

    own->seen = t->seen;
    if (has_frame(r, spin_rank()) && spin_trainer_network(t))
        SPIN_TRY(t->device->op->download(t->device, &own->active, t->field_eval.active.n,
                                         sizeof own->active));
    SPIN_TRY(spin_ranks_gather(r->told, sizeof *r->told));
    for (int k = 0; k < spin_n_ranks(); k++)
        t->seen |= r->told[k].seen != 0;
    return SPIN_OK;
}

/* ---- 3: the table -------------------------------------------------------------------------------- */

/* d_z [n][all] of the active splats by branches of the ranks' levels, so that a branch is a matrix of its own: those
 * of this rank to own, the others one after the other to out. */
static void cut_branches(const struct round *r, size_t n, float SPIN_DEV *own, float SPIN_DEV *out)
{
    struct spin_trainer *t = r->t;
    size_t all = (size_t)t->field.heads.n_in;

    for (int k = 0; k < spin_n_ranks(); k++) {
        struct spin_levels branch[SPIN_MAX_LEVELS];
        int n_branches = spin_share_branches(t->field.grid.n_levels, levels_of(r, k), branch);
        float SPIN_DEV **to = k == spin_rank() ? &own : &out;

        for (int j = 0; j < n_branches; j++) {
            size_t width = (size_t)features_of(r, branch[j]);
            size_t at = (size_t)branch[j].first * (size_t)t->field.grid.n_features;

            t->device->op->copy_rows(t->device, n, width, t->field_eval.d_z + at, all, *to, width);
            *to += n * width;
        }
    }
}

/* The active splats and their d_z: this rank's go to all, and all frames' come here, for this rank's levels. */
static spin_status share_gradients(struct round *r, uint32_t SPIN_DEV **rows, float SPIN_DEV **d_z)
{
    struct spin_trainer *t = r->t;
    size_t all = (size_t)t->field.heads.n_in, width = (size_t)features_of(r, t->levels), sum = 0;
    size_t own = r->told[spin_rank()].active;
    float SPIN_DEV *cut;
    float SPIN_DEV *all_rows;
    float SPIN_DEV *own_d_z = NULL;

    for (int i = 0; i < r->n; i++)
        sum += r->told[i].active;
    SPIN_TRY(need(r, TO_SEND, own * all, &cut));
    SPIN_TRY(need(r, ROWS, sum, &all_rows));
    SPIN_TRY(need(r, RECEIVED, sum * width, d_z));
    *rows = (uint32_t SPIN_DEV *)all_rows;
    for (size_t i = 0, at = 0; i < (size_t)r->n; at += r->told[i++].active) {
        size_t n = r->told[i].active;

        if ((int)i == spin_rank()) {
            r->rows = *rows + at;
            own_d_z = *d_z + at * width;
        } else if (width > 0) {
            add_message(r, (int)i, true, *rows + at, n);
            add_message(r, (int)i, true, *d_z + at * width, n * width);
        }
    }
    if (own == 0)
        return send_all(r);
    copy(r, (float SPIN_DEV *)r->rows, (float SPIN_DEV *)t->field_eval.active.row, own);
    cut_branches(r, own, own_d_z, cut);
    for (int k = 0; k < spin_n_ranks(); k++) {
        size_t floats = own * (size_t)features_of(r, levels_of(r, k));

        if (k == spin_rank() || floats == 0)
            continue;
        add_message(r, k, false, r->rows, own);
        add_message(r, k, false, cut, floats);
        cut += floats;
    }
    return send_all(r);
}

/* A list of active splats for the device. */
static struct spin_active put_active(struct round *r, uint32_t SPIN_DEV *rows, uint32_t n)
{
    struct spin_active active = {rows, r->t->field_eval.active.n, n};

    r->t->device->op->upload(r->t->device, active.n, &n, sizeof n);
    return active;
}

/* One frame's part of the table's gradient; with d_x [branches][n][4] the branches of that of the positions. */
static void add_to_table(struct round *r, int frame, uint32_t SPIN_DEV *rows,
                         const float SPIN_DEV *d_z, float SPIN_DEV *d_x)
{
    struct spin_trainer *t = r->t;
    struct spin_device *d = t->device;
    struct spin_field_eval *eval = &t->field_eval;
    struct spin_levels branch[SPIN_MAX_LEVELS];
    int n_branches = spin_share_branches(t->field.grid.n_levels, t->levels, branch);
    struct spin_frame_batch frames = take_frame(r, frame);
    size_t n = r->told[frame].active;
    struct spin_active active = put_active(r, rows, r->told[frame].active);

    d->op->contract(d, &t->field.transform, &frames, eval->x_u);
    for (int j = 0; j < n_branches; j++) {
        struct spin_field part = spin_share_part(&t->field, branch[j]);
        size_t at = spin_share_floats(&t->field.grid, branch[j].first) -
                    spin_share_floats(&t->field.grid, t->levels.first);

        d->op->grid_back(d, &part.grid, t->table.p + at, &active, eval->x_u, d_z, t->table.g + at,
                         d_x);
        d_x += d_x ? 4 * n : 0;
        d_z += n * (size_t)features_of(r, branch[j]);
    }
}

/* The tree's sum over levels [first, first + n) of the branches, in the place of its first one. */
static float SPIN_DEV *sum_tree(struct spin_device *d, const struct spin_levels *branch,
                                int n_branches, float SPIN_DEV *d_x, size_t rows, int first, int n)
{
    int half = 1;
    float SPIN_DEV *left;
    float SPIN_DEV *right;

    for (int j = 0; j < n_branches; j++)
        if (branch[j].first == first && branch[j].end == first + n)
            return d_x + 4 * (size_t)j * rows;
    while (2 * half < n)
        half *= 2;
    left = sum_tree(d, branch, n_branches, d_x, rows, first, half);
    right = sum_tree(d, branch, n_branches, d_x, rows, first + half, n - half);
    d->op->add(d, 4 * rows, right, left);
    return left;
}

/* All branches of this rank's frame to its positions. */
static void finish_positions(struct round *r, float SPIN_DEV *d_x)
{
    struct spin_trainer *t = r->t;
    struct spin_device *d = t->device;
    struct spin_levels branch[SPIN_MAX_LEVELS];
    struct spin_frame_batch frames = take_frame(r, spin_rank());
    uint32_t n = r->told[spin_rank()].active;
    struct spin_active active = put_active(r, r->rows, n);
    int n_branches = 0, n_levels = t->field.grid.n_levels;

    for (int k = 0; k < spin_n_ranks(); k++)
        n_branches += spin_share_branches(n_levels, levels_of(r, k), branch + n_branches);
    d_x = sum_tree(d, branch, n_branches, d_x, n, 0, n_levels);
    d->op->contract_back(d, &t->field.transform, &frames, &active, d_x);
}

static int n_branches_of(const struct round *r, int rank)
{
    struct spin_levels branch[SPIN_MAX_LEVELS];

    return spin_share_branches(r->t->field.grid.n_levels, levels_of(r, rank), branch);
}

static spin_status table_back(struct round *r)
{
    struct spin_trainer *t = r->t;
    size_t width = (size_t)features_of(r, t->levels), sum = 0, at = 0, own_n = 0, own_at = 0;
    size_t mine = (size_t)n_branches_of(r, spin_rank());
    float SPIN_DEV *d_z = NULL;
    float SPIN_DEV *own = NULL;
    float SPIN_DEV *others = NULL;
    uint32_t SPIN_DEV *rows = NULL;

    SPIN_TRY(share_gradients(r, &rows, &d_z));
    for (int i = 0; i < r->n; i++)
        sum += r->told[i].active;
    own_n = r->told[spin_rank()].active;
    if (!t->field_eval.still) {
        size_t all = 0;

        for (int k = 0; k < spin_n_ranks(); k++) {
            own_at = k == spin_rank() ? all : own_at;
            all += 4 * own_n * (size_t)n_branches_of(r, k);
        }
        SPIN_TRY(need(r, BRANCHES, all + 4 * sum * mine, &own));
        others = own + all;
        for (int k = 0; k < spin_n_ranks(); k++) {
            size_t floats = 4 * own_n * (size_t)n_branches_of(r, k);

            if (k != spin_rank())
                add_message(r, k, true, own + at, floats);
            at += floats;
        }
    }
    for (int i = 0; i < r->n; i++) {
        size_t n = r->told[i].active;
        bool is_own = i == spin_rank();
        float SPIN_DEV *d_x = others && is_own ? own + own_at : others;

        add_to_table(r, i, rows, d_z, d_x);
        if (others && !is_own) {
            add_message(r, i, false, others, 4 * n * mine);
            others += 4 * n * mine;
        }
        rows += n;
        d_z += n * width;
    }
    SPIN_TRY(send_all(r));
    if (others && own_n > 0)
        finish_positions(r, own);
    return SPIN_OK;
}

/* ---- 4: what all need ---------------------------------------------------------------------------- */

/* What a frame's rank sends to the others: losses; gradients of what all frames share; to the frame's owner, or with
 * tracks to all, gradients of positions and of residual values; to the owner what densification goes by. */
struct blob {
    size_t shared, d_pos, d_residual, gather, end; /* floats before each part */
};

/* Floats of the losses of so many pictures: they are doubles. */
static size_t value_floats(int n)
{
    return (size_t)n * SPIN_LOSS_VALUES * (sizeof(double) / sizeof(float));
}

static struct blob blob_of(const struct round *r, int frame)
{
    const struct spin_trainer *t = r->t;
    struct spin_frame_batch frames = spin_step_frames(r->t, r->b, &r->first[frame], 1);
    size_t n = frames.n;
    struct blob blob;

    blob.shared = value_floats(items_of(r, frame));
    blob.d_pos = blob.shared + spin_step_shared(t);
    blob.d_residual = blob.d_pos + 3 * n;
    blob.gather = blob.d_residual;
    if (frames.frame[0].d_residual)
        blob.gather += SPIN_RESIDUAL * n;
    blob.end = blob.gather + (t->gather ? 2 * n : 0);
    return blob;
}

/* The place of a picture's losses among those of the step. */
static float SPIN_DEV *losses_of(const struct round *r, int value)
{
    return (float SPIN_DEV *)(r->t->values + value * SPIN_LOSS_VALUES);
}

static void fill_blob(struct round *r, const struct blob *blob, int first_value, float SPIN_DEV *at)
{
    struct spin_trainer *t = r->t;
    struct spin_frame_batch frames = spin_step_frames(t, r->b, &r->first[spin_rank()], 1);
    const struct spin_frame_of_batch *frame = &frames.frame[0];

    copy(r, at, losses_of(r, first_value), blob->shared);
    spin_step_take_shared(t, at + blob->shared);
    copy(r, at + blob->d_pos, frame->d_means, blob->d_residual - blob->d_pos);
    if (frame->d_residual)
        copy(r, at + blob->d_residual, frame->d_residual, blob->gather - blob->d_residual);
    if (!t->gather)
        return;
    copy(r, at + blob->gather, frame->gradient, frames.n);
    copy(r, at + blob->gather + frames.n, (float SPIN_DEV *)frame->seen, frames.n);
}

/* Floats of it for a rank. */
static size_t floats_of_blob(const struct round *r, int i, const struct blob *blob, int rank)
{
    if (spin_share_owner(frame_of(r, i)) == rank)
        return blob->end;
    return r->t->tracked ? blob->gather : blob->d_pos;
}

/* A frame's step, from what its rank sent. */
static void step_frame(struct round *r, int i, const struct blob *blob, const float SPIN_DEV *at,
                       int first_value)
{
    struct spin_trainer *t = r->t;
    struct spin_frame_batch frames = spin_step_frames(t, r->b, &r->first[i], 1);
    const struct spin_frame_of_batch *frame = &frames.frame[0];
    bool mine = spin_trainer_owns(frame_of(r, i));

    copy(r, losses_of(r, first_value), at, blob->shared);
    spin_step_add_shared(t, at + blob->shared);
    if (!mine)
        t->frame[frame_of(r, i)].steps++;
    if (floats_of_blob(r, i, blob, spin_rank()) == blob->d_pos)
        return;
    copy(r, frame->d_means, at + blob->d_pos, blob->d_residual - blob->d_pos);
    if (frame->d_residual)
        copy(r, frame->d_residual, at + blob->d_residual, blob->gather - blob->d_residual);
    if (!mine) {
        spin_step_tracks_back(t, &frames);
        return;
    }
    if (t->gather && i != spin_rank()) {
        copy(r, frame->gradient, at + blob->gather, frames.n);
        copy(r, (float SPIN_DEV *)frame->seen, at + blob->gather + frames.n, frames.n);
    }
    spin_step_finish(t, r->b, &r->first[i], &frames);
}

static spin_status share_steps(struct round *r, int own_value)
{
    size_t sum = 0;
    int value = r->first_value;
    float SPIN_DEV *all;
    float SPIN_DEV *at;

    for (int i = 0; i < r->n; i++)
        sum += blob_of(r, i).end;
    SPIN_TRY(need(r, BLOBS, sum, &all));
    at = all;
    for (int i = 0; i < r->n; i++) {
        struct blob blob = blob_of(r, i);

        if (i == spin_rank())
            fill_blob(r, &blob, own_value, at);
        for (int k = 0; i == spin_rank() && k < spin_n_ranks(); k++)
            if (k != i)
                add_message(r, k, false, at, floats_of_blob(r, i, &blob, k));
        if (i != spin_rank())
            add_message(r, i, true, at, floats_of_blob(r, i, &blob, spin_rank()));
        at += blob.end;
    }
    SPIN_TRY(send_all(r));
    at = all;
    for (int i = 0; i < r->n; i++) {
        struct blob blob = blob_of(r, i);

        step_frame(r, i, &blob, at, value);
        value += items_of(r, i);
        at += blob.end;
    }
    return SPIN_OK;
}

spin_status spin_step_round(struct spin_trainer *t, const struct spin_step_batch *b,
                            const int *first, int n)
{
    struct round r = {.t = t, .b = b, .first = first, .n = n};
    int own_value = number_values(&r);
    spin_status status;

    SPIN_TRY_OUT(spin_alloc((size_t)spin_n_ranks() * (size_t)(spin_n_ranks() + 5),
                            sizeof *r.message, (void **)&r.message));
    SPIN_TRY_OUT(spin_alloc((size_t)spin_n_ranks(), sizeof *r.told, (void **)&r.told));
    SPIN_TRY_OUT(share_values(&r));
    if (spin_trainer_network(t))
        SPIN_TRY_OUT(share_features(&r));
    if (has_frame(&r, spin_rank()))
        SPIN_TRY_OUT(draw_own(&r, own_value));
    SPIN_TRY_OUT(tell(&r));
    if (spin_trainer_network(t))
        SPIN_TRY_OUT(table_back(&r));
    status = share_steps(&r, own_value);
out:
    free(r.message);
    free(r.told);
    return status;
}
