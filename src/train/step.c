/* The training step. It goes in groups of as many frames and views as the device takes at once. Gradients of
 * table and heads gather over all of them; positions take their step when their group is done. */
#include "train/step.h"

#include "base/err.h"
#include "io/ranks.h"
#include "model/residual.h"
#include "train/step_ranks.h"

/* The sums to where Adam takes them. */
static void put_shared(struct spin_trainer *t)
{
    size_t n = t->heads.n, n_exposure = t->exposures.param.n;
    struct spin_device *d = t->device;

    if (!t->shared || n + n_exposure == 0)
        return;
    if (n > 0)
        d->op->copy_rows(d, 1, n, t->shared, n, t->heads.g, n);
    if (n_exposure > 0)
        d->op->copy_rows(d, 1, n_exposure, t->shared + n, n_exposure, t->exposures.param.g,
                         n_exposure);
    d->op->zero(d, t->shared, (n + n_exposure) * sizeof(float));
}

static void add_own_shared(struct spin_trainer *t)
{
    float SPIN_DEV *mine = t->shared + spin_step_shared(t);

    if (!t->shared)
        return;
    spin_step_take_shared(t, mine);
    spin_step_add_shared(t, mine);
}

/* The frames of these items, whose views may stand anywhere in the batch. */
static spin_status do_frames(struct spin_trainer *t, const struct spin_step_batch *b,
                             const int *first, int n)
{
    const struct spin_field *network = spin_trainer_network(t);
    struct spin_frame_batch frames;

    if (spin_n_ranks() > 1)
        return spin_step_round(t, b, first, n);
    frames = spin_step_frames(t, b, first, n);
    spin_step_add_tracks(t, &frames);
    spin_field_forward(&t->field_eval, network, t->table.p, t->heads.p, &frames);
    SPIN_TRY(spin_step_draw(t, b, first, &frames));
    spin_field_backward(&t->field_eval, network, t->table.p, t->heads.p, &frames, t->table.g,
                        t->heads.g);
    spin_step_finish(t, b, first, &frames);
    add_own_shared(t);
    return SPIN_OK;
}

/* ---- The step -------------------------------------------------------------------------------- */

static bool seen_before(const struct spin_train_item *items, int i)
{
    for (int j = 0; j < i; j++)
        if (items[j].frame == items[i].frame)
            return true;
    return false;
}

int spin_trainer_rank(const struct spin_train_item *items, int item, const size_t *counts)
{
    int place = 0;

    for (int i = 0; i < item; i++) {
        if (items[i].frame == items[item].frame)
            break;
        place += !seen_before(items, i) && counts[items[i].frame] > 0;
    }
    return place % spin_n_ranks();
}

/* Groups of frames, in the order in which the items first show them. Frames without a splat have no part. */
static spin_status do_groups(struct spin_trainer *t, const struct spin_step_batch *b)
{
    int at_once = spin_n_ranks() > 1 ? spin_n_ranks() : spin_trainer_frames_at_once(t);
    int first[SPIN_MAX_RANKS], n = 0;

    for (int i = 0; i < b->n; i++) {
        if (seen_before(b->items, i) || t->frame[b->items[i].frame].size.n == 0)
            continue;
        first[n++] = i;
        if (n == at_once || (spin_n_ranks() == 1 && n == SPIN_MAX_FRAMES)) {
            SPIN_TRY(do_frames(t, b, first, n));
            n = 0;
        }
    }
    return n > 0 ? do_frames(t, b, first, n) : SPIN_OK;
}

/* The network's groups; the table may take its step at once. */
static int step_network(struct spin_trainer *t, struct spin_param_group *group)
{
    const size_t *offset = t->field.heads.offset;
    struct spin_device *d = t->device;
    int64_t step = spin_trainer_network_steps(t);
    double lr = spin_trainer_network_rate(t, t->rates.table, step);
    int n = 0;

    if (t->lazy)
        d->op->lazy_adam_step(d, t->lazy, lr);
    else
        group[n++] = spin_param_group(&t->table, 0, t->table.n, lr, step);
    for (int k = 0; k < SPIN_HEADS; k++)
        group[n++] = spin_param_group(&t->heads, offset[k], offset[k + 1],
                                      spin_trainer_network_rate(t, t->rates.head[k], step), step);
    return n;
}

/* Values first..end of the tracks, or with rate 0 none: they stay as they are. */
static int step_part(const struct spin_trainer *t, size_t first, size_t end, double rate,
                     struct spin_param_group *group)
{
    if (rate > 0)
        *group = spin_param_group(&t->tracks, first, end, spin_trainer_track_rate(t, rate),
                                  t->iteration);
    else
        t->device->op->zero(t->device, t->tracks.g + first, (end - first) * sizeof(float));
    return rate > 0;
}

static int step_tracks(const struct spin_trainer *t, struct spin_param_group *group)
{
    size_t first = 3 * t->n_tracks;
    int n = step_part(t, 0, first, t->rates.displacement, group);

    for (int k = 0; k < SPIN_HEADS; k++) {
        size_t end = first + spin_residual_width[k] * t->n_tracks;

        n += step_part(t, first, end, t->rates.track[k], group + n);
        first = end;
    }
    return n;
}

/* Adam for what all frames share. */
static void step_shared(struct spin_trainer *t)
{
    struct spin_device *d = t->device;
    struct spin_param_group group[2 * SPIN_HEADS + 3];
    int n = 0;

    if (spin_trainer_network(t))
        n += step_network(t, group + n);
    if (t->n_tracks > 0)
        n += step_tracks(t, group + n);
    if (t->exposures.param.n)
        group[n++] =
            spin_param_group(&t->exposures.param, 0, t->exposures.param.n,
                             spin_trainer_rate(t, t->rates.exposure, t->iteration), t->iteration);
    d->op->adam(d, n, group);
    spin_exposures_centre(&t->exposures, d);
}

/* The step's one read-back. */
static spin_status read_values(struct spin_trainer *t, int n, struct spin_train_values *values)
{
    SPIN_TRY(
        t->device->op->download(t->device, t->host_values, t->values,
                                (size_t)t->n_drawn * SPIN_LOSS_VALUES * sizeof *t->host_values));
    values->seen = t->seen;
    for (int i = 0; i < t->n_drawn; i++) {
        const double *v = t->host_values + i * SPIN_LOSS_VALUES;

        values->loss += v[SPIN_LOSS] / n;
        values->l1 += v[SPIN_LOSS_L1] / n;
        values->ssim += v[SPIN_LOSS_SSIM] / n;
        if (values->each)
            values->each[t->drawn[i]] = v[SPIN_LOSS];
    }
    return SPIN_OK;
}

spin_status spin_trainer_step(struct spin_trainer *t, const struct spin_images *images,
                              const struct spin_train_item *items, int n,
                              struct spin_train_values *values)
{
    const struct spin_step_batch b = {images, items, n};

    values->loss = values->l1 = values->ssim = 0;
    t->seen = false;
    t->n_drawn = 0;
    spin_trainer_catch_up(t, spin_trainer_network_steps(t));
    t->iteration++;
    t->field_eval.still = t->rates.position == 0 && t->rates.displacement == 0;
    SPIN_TRY(do_groups(t, &b));
    put_shared(t);
    step_shared(t);
    return read_values(t, n, values);
}
