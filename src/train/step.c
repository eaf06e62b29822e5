/* Runs one iteration. The frames and views of the batch are processed in groups, as many at a time
 * as the device supports. Gradients of shared parameters accumulate over all groups. The values
 * that a frame owns get their Adam step at the end of the group of the frame or, with several
 * ranks, after the all-reduce, since each rank renders only its part of the items. */
#include "train/step.h"

#include <fcntl.h>
#include <string.h>
#include <unistd.h>

#include "base/base.h"
#include "io/file.h"
#include "model/field.h"

struct batch {
    const struct spin_images *images;
    const struct spin_train_item *items;
    int n;
};

int spin_step_rank(int item, int n, int n_ranks) { return (int)((int64_t)item * n_ranks / n); }

static int rank_of(const struct spin_trainer *t, const struct batch *b, int item)
{
    return spin_step_rank(item, b->n, t->n_ranks);
}

/* ---- Drawing --------------------------------------------------------------------------------- */

/* Computes the losses of the images that the raster has just rendered, one row of t->values per
 * view (spin_device_ops.loss). Sets t->raster.d_image to the gradient of the weighted losses with
 * respect to the rendered images, and adds the gradient with respect to the exposure parameters to
 * t->exposures.param.g. */
static void add_loss(struct spin_trainer *t, const struct spin_images *images,
                     const struct spin_view_batch *views)
{
    struct spin_device *d = t->device;
    struct spin_exposures *e = &t->exposures;
    const float SPIN_DEV *drawn = t->raster.image, *image = e->param.n ? e->exposed : drawn;

    if (e->param.n)
        d->op->exposure(d, views, e->param.p, drawn, e->exposed);
    d->op->loss(d, views, images, t->lambda_dssim, image, t->values, t->raster.d_image);
    if (e->param.n)
        d->op->exposure_back(d, views, e->param.p, drawn, t->raster.d_image, e->param.g);
}

/* Renders the views, adds the gradients of the losses to d_attr and d_pos, and clears the batch of
 * views. */
static spin_status draw_views(struct spin_trainer *t, const struct batch *b,
                              const struct spin_frame_batch *frames, struct spin_view_batch *views)
{
    struct spin_field_eval *eval = &t->field_eval;
    int sh_degree = spin_trainer_sh_degree(t);

    if (views->n_views == 0)
        return SPIN_OK;
    SPIN_TRY(spin_raster_forward(&t->raster, views, frames, eval->attr, sh_degree));
    t->seen |= t->raster.tiles.n_intersections > 0;
    add_loss(t, b->images, views);
    spin_raster_backward(&t->raster, views, frames, eval->attr, sh_degree, eval->d_attr);
    if (t->gather)
        t->device->op->densify_stats(t->device, views, frames, t->raster.splat2d,
                                     t->raster.d_splat2d);
    views->n_views = 0;
    return SPIN_OK;
}

static void add_item(struct spin_trainer *t, const struct batch *b, int item, int frame, size_t n,
                     struct spin_view_batch *views)
{
    struct spin_view_of_batch *view = spin_raster_add_view(
        &t->raster, views, frame, n, b->items[item].camera, t->field.antialias);

    view->weight = 1.0f / (float)b->n;
    view->image = b->items[item].image;
    view->matte = b->items[item].matte;
    memcpy(view->background_change, b->items[item].background_change,
           sizeof view->background_change);
    view->exposure = b->items[item].exposure;
    view->lens = b->items[item].lens;
    view->value = t->n_drawn;
    t->drawn[t->n_drawn++] = item;
}

/* Renders the views of `frames` that this rank has to render. first[f]: the first item that shows
 * frame f of `frames`. */
static spin_status draw_frames(struct spin_trainer *t, const struct batch *b, const int *first,
                               struct spin_frame_batch *frames)
{
    struct spin_view_batch views = spin_raster_batch(&t->raster, t->background);

    views.absolute = t->gather && t->absolute;
    for (int f = 0; f < frames->n_frames; f++) {
        struct spin_frame_of_batch *frame = &frames->frame[f];

        for (int i = first[f]; i < b->n; i++) {
            if (b->items[i].frame != b->items[first[f]].frame || rank_of(t, b, i) != t->rank)
                continue;
            if (views.n_views == t->raster.views || views.n_views == SPIN_MAX_VIEWS)
                SPIN_TRY(draw_views(t, b, frames, &views));
            add_item(t, b, i, f, frame->n, &views);
        }
    }
    return draw_views(t, b, frames, &views);
}

static void add_frame(const struct spin_trainer *t, int number, struct spin_frame_batch *frames)
{
    struct spin_frame_of_batch *to = &frames->frame[frames->n_frames++];
    const struct spin_train_frame *frame = &t->frame[number];
    bool residual = frame->residual && t->rates.residual[SPIN_HEAD_SCALE] > 0;
    /* While the SH degree is 0, coefficients beyond the first are zero and need no gradient. */
    bool sh = frame->sh && spin_trainer_sh_degree(t) > 0;

    *to = (struct spin_frame_of_batch){
        .first = frames->n,
        .n = frame->size.n,
        .t = spin_field_time(&t->field, frame->time),
        .means = frame->pos,
        .d_means = t->d_pos + 3 * frames->n,
        .residual = frame->residual,
        .d_residual = residual ? t->d_residual + SPIN_RESIDUAL * frames->n : NULL,
        .sh = sh ? frame->sh : NULL,
        .d_sh = sh && residual ? t->d_sh + frame->sh_width * frames->n : NULL,
        .sh_width = frame->sh_width,
        .gradient = frame->gradient,
        .seen = frame->seen,
    };
    if (t->n_tracks > 0) {
        to->track = frame->track;
        to->own_means = frame->pos;
        to->n_own_means = frame->size.n_pos;
        to->own_residual = frame->residual;
        to->n_own_residual = frame->size.n_residual;
        to->turn = frame->turn;
        to->means = t->means + 3 * frames->n;
        to->residual = t->residual + SPIN_RESIDUAL * frames->n;
        to->d_residual = t->d_residual + SPIN_RESIDUAL * frames->n;
    }
    frames->n += frame->size.n;
}

/* Computes t->means and t->residual of `frames` by adding the values of the tracks to those of the
 * splats. Does nothing without tracks. */
static void add_tracks(struct spin_trainer *t, const struct spin_frame_batch *frames)
{
    struct spin_tracks_f32 tracks = {t->n_tracks, t->tracks.p, t->tracks.g, t->motion};

    if (t->n_tracks > 0)
        t->device->op->tracks(t->device, frames, &tracks, t->means, t->residual);
}

struct spin_frame_batch spin_trainer_frame(struct spin_trainer *t, int frame)
{
    struct spin_frame_batch frames = {0};

    add_frame(t, frame, &frames);
    add_tracks(t, &frames);
    return frames;
}

/* ---- Values that frames own ------------------------------------------------------------------ */

/* Makes an Adam step of the values that the frames own: positions, residual values and SH. */
static void step_frames(struct spin_trainer *t, const struct batch *b, const int *first,
                        const struct spin_frame_batch *frames)
{
    struct spin_param_group group[SPIN_MAX_FRAMES * SPIN_TRAIN_FRAME_GROUPS];
    struct spin_frame_rates rates = {.pos = spin_trainer_position_rate(t),
                                     .sh = spin_trainer_rate(t, t->rates.sh, t->iteration),
                                     .tracked = t->rates.tracked};
    /* True if residual values are not trained. */
    bool fixed = t->rates.residual[SPIN_HEAD_SCALE] == 0;
    int n_groups = 0;

    for (int k = 0; k < SPIN_HEADS; k++)
        rates.residual[k] = spin_trainer_rate(t, t->rates.residual[k], t->iteration);
    for (int f = 0; f < frames->n_frames; f++) {
        struct spin_frame_of_batch of = frames->frame[f];

        of.d_residual = fixed ? NULL : of.d_residual;
        n_groups += spin_train_frame_step(&t->frame[b->items[first[f]].frame], &rates, &of,
                                          group + n_groups);
    }
    t->device->op->adam(t->device, n_groups, group);
}

/* Copies the gradients of the values that a frame owns between the frame's buffers and `at`, the
 * frame's part of the all-reduce buffer t->own_grad: from the frame to `at` if `put` is true,
 * otherwise from `at` to the frame. Returns the number of floats copied. */
static size_t copy_own_gradients(struct spin_trainer *t, const struct spin_frame_of_batch *frame,
                                 const struct spin_frame_size *size, float SPIN_DEV *at, bool put)
{
    float SPIN_DEV *from[2 + SPIN_HEADS] = {[0] = frame->d_means, [1 + SPIN_HEADS] = frame->d_sh};
    size_t n[2 + SPIN_HEADS] = {[0] = 3 * size->n_pos,
                                [1 + SPIN_HEADS] = frame->d_sh ? frame->sh_width * size->n : 0};
    size_t sum = 0, all = 0;

    for (int k = 0; frame->d_residual && k < SPIN_HEADS; k++) {
        from[1 + k] = frame->d_residual + sum * frame->n;
        n[1 + k] = spin_residual_width[k] * size->n_residual;
        sum += spin_residual_width[k];
    }
    for (int i = 0; i <= 1 + SPIN_HEADS; all += n[i++])
        if (n[i] > 0)
            t->device->op->copy_rows(t->device, 1, n[i], put ? from[i] : at + all, n[i],
                                     put ? at + all : from[i], n[i]);
    return all;
}

static bool seen_before(const struct spin_trainer *t, const struct batch *b, int i, int rank)
{
    for (int j = 0; j < i; j++)
        if (b->items[j].frame == b->items[i].frame && (rank < 0 || rank_of(t, b, j) == rank))
            return true;
    return false;
}

/* True if item i is the first item that shows its frame, among the items of a rank or, with rank
 * -1, among all items. Always false if the frame has no splats. */
static bool is_first_of_frame(const struct spin_trainer *t, const struct batch *b, int i, int rank)
{
    return (rank < 0 || rank_of(t, b, i) == rank) && !seen_before(t, b, i, rank) &&
           t->frame[b->items[i].frame].size.n > 0;
}

/* Returns the size of a frame's part of t->own_grad, in floats. */
static size_t own_floats(const struct spin_trainer *t, const struct spin_frame_size *size)
{
    return 3 * size->n_pos + SPIN_RESIDUAL * size->n_residual + t->sh_width * size->n;
}

/* Returns the start of the part of t->own_grad that belongs to an item's frame. Parts are in the
 * order in which items first show the frames. */
static float SPIN_DEV *own_grad_of(const struct spin_trainer *t, const struct batch *b, int item)
{
    float SPIN_DEV *at = t->own_grad;

    for (int i = 0; i < b->n && b->items[i].frame != b->items[item].frame; i++)
        if (is_first_of_frame(t, b, i, -1))
            at += own_floats(t, &t->frame[b->items[i].frame].size);
    return at;
}

/* With several ranks, all-reduces all gradients, then makes an Adam step of the values that frames
 * own. Does nothing with a single rank. */
static spin_status sum_gradients(struct spin_trainer *t, const struct batch *b)
{
    const struct spin_param *param[] = {&t->table, &t->heads, &t->tracks, &t->exposures.param};
    size_t own = 0;

    if (t->n_ranks == 1)
        return SPIN_OK;
    for (int k = 0; k < 4; k++)
        if (param[k]->n > 0)
            SPIN_TRY(spin_rank_sum(&t->rank_sum, param[k]->g, param[k]->n, SPIN_SUM_F32));
    for (int i = 0; i < b->n; i++)
        if (is_first_of_frame(t, b, i, -1))
            own += own_floats(t, &t->frame[b->items[i].frame].size);
    SPIN_TRY(spin_rank_sum(&t->rank_sum, t->own_grad, own, SPIN_SUM_F32));
    for (int i = 0; i < b->n; i++) {
        struct spin_frame_batch frames = {0};

        if (!is_first_of_frame(t, b, i, -1))
            continue;
        add_frame(t, b->items[i].frame, &frames);
        copy_own_gradients(t, &frames.frame[0], &t->frame[b->items[i].frame].size,
                           own_grad_of(t, b, i), false);
        step_frames(t, b, &i, &frames);
    }
    t->device->op->zero(t->device, t->own_grad, own * sizeof(float));
    return SPIN_OK;
}

/* ---- The iteration --------------------------------------------------------------------------- */

/* Processes n frames. first [n] is the first item of this rank that shows each frame; further items
 * of the frame need not be adjacent to it. */
static spin_status process_frames(struct spin_trainer *t, const struct batch *b, const int *first,
                                  int n)
{
    const struct spin_field *network = t->network;
    struct spin_tracks_f32 tracks = {t->n_tracks, t->tracks.p, t->tracks.g, t->motion};
    struct spin_frame_batch frames = {0};
    struct spin_device *d = t->device;

    for (int i = 0; i < n; i++)
        add_frame(t, b->items[first[i]].frame, &frames);
    add_tracks(t, &frames);
    frames.narrow = t->field_eval.narrow;
    spin_field_forward(&t->field_eval, network, t->table.p, t->heads.p, &frames);
    d->op->zero(d, t->field_eval.d_attr, frames.n * spin_attr_width(&frames) * sizeof(float));
    d->op->zero(d, t->d_pos, frames.n * 3 * sizeof(float));
    /* An Adam step clears the gradients that it reads. With tracks it reads only a part of the
     * gradients, and with several ranks it reads copies, so the originals must be cleared here. */
    if (t->n_tracks > 0 || (t->n_ranks > 1 && t->residuals))
        d->op->zero(d, t->d_residual, frames.n * SPIN_RESIDUAL * sizeof(float));
    if (t->n_ranks > 1 && t->sh_width > 0)
        d->op->zero(d, t->d_sh, frames.n * t->sh_width * sizeof(float));
    SPIN_TRY(draw_frames(t, b, first, &frames));
    if (t->hold)
        return SPIN_OK;
    spin_field_backward(&t->field_eval, network, t->table.p, t->heads.p, &frames, t->table.g,
                        t->heads.g);
    if (t->n_tracks > 0)
        d->op->tracks_back(d, &frames, &tracks);
    if (t->n_ranks == 1)
        step_frames(t, b, first, &frames);
    for (int f = 0; t->n_ranks > 1 && f < n; f++)
        copy_own_gradients(t, &frames.frame[f], &t->frame[b->items[first[f]].frame].size,
                           own_grad_of(t, b, first[f]), true);
    return SPIN_OK;
}

/* Processes the frames that the items of this rank show, in groups, in the order in which items
 * first show them. */
static spin_status process_groups(struct spin_trainer *t, const struct batch *b)
{
    int at_once = spin_trainer_frames_at_once(t), first[SPIN_MAX_FRAMES], n = 0;

    for (int i = 0; i < b->n; i++) {
        if (!is_first_of_frame(t, b, i, t->rank))
            continue;
        first[n++] = i;
        if (n == at_once || n == SPIN_MAX_FRAMES) {
            SPIN_TRY(process_frames(t, b, first, n));
            n = 0;
        }
    }
    return n > 0 ? process_frames(t, b, first, n) : SPIN_OK;
}

/* Sets group[] to the parameter groups of the network for an Adam step, and returns the number of
 * groups. With lazy Adam, the table has no group, and its step is queued here. */
static int step_network(struct spin_trainer *t, struct spin_param_group *group)
{
    const size_t *offset = t->field.heads.offset;
    struct spin_device *d = t->device;
    double lr = spin_trainer_rate(t, t->rates.table, t->iteration);
    int n = 0;

    if (t->lazy)
        d->op->lazy_adam_step(d, t->lazy, lr);
    else
        group[n++] = spin_param_group(&t->table, 0, t->table.n, lr, t->iteration);
    for (int k = 0; k < SPIN_HEADS; k++)
        group[n++] =
            spin_param_group(&t->heads, offset[k], offset[k + 1],
                             spin_trainer_rate(t, t->rates.head[k], t->iteration), t->iteration);
    return n;
}

/* Sets *group to the values [first, end) of the tracks for an Adam step, and returns 1, the number
 * of groups. If rate is 0, the values must not change: only clears their gradient, and returns 0.
 */
static int step_part(const struct spin_trainer *t, size_t first, size_t end, double rate,
                     struct spin_param_group *group)
{
    if (rate > 0)
        *group = spin_param_group(&t->tracks, first, end, rate, t->iteration);
    else
        t->device->op->zero(t->device, t->tracks.g + first, (end - first) * sizeof(float));
    return rate > 0;
}

/* Sets group[] to the values [first, first + width * n_tracks) of the tracks, `width` per track,
 * for an Adam step, and returns the number of groups. lr0 is the peak learning rate; if it is 0,
 * the values do not change. The rate of dynamic tracks is `share` times that of other tracks.
 * Dynamic tracks are trained in all iterations, like the values of frames, since they are visible
 * in fewer images than static tracks. The values of the last `frozen` tracks do not change. */
static int step_values(const struct spin_trainer *t, size_t first, size_t width, double lr0,
                       double share, size_t frozen, struct spin_param_group *group)
{
    double moving = lr0 > 0 ? spin_trainer_rate(t, share * lr0, t->iteration) : 0;
    double still = lr0 > 0 ? spin_trainer_track_rate(t, lr0) : 0;
    size_t split = moving == still ? 0 : first + width * t->n_moving;
    int n = 0;

    if (split > first)
        n += step_part(t, first, split, moving, group);
    n += step_part(t, split > first ? split : first, first + width * (t->n_tracks - frozen), still,
                   group + n);
    if (frozen)
        n += step_part(t, first + width * (t->n_tracks - frozen), first + width * t->n_tracks, 0,
                       group + n);
    return n;
}

static int step_tracks(const struct spin_trainer *t, struct spin_param_group *group)
{
    /* Displacements of dynamic tracks are trained with half of the learning rate, since the
     * positions of the splats of these tracks are trained too. */
    int n = step_values(t, 0, 3, t->rates.displacement, 0.5, 0, group);
    size_t first = 3 * t->n_tracks;

    for (int k = 0; k < SPIN_HEADS; k++) {
        n += step_values(t, first, spin_residual_width[k], t->rates.track[k], 1,
                         k == SPIN_HEAD_OPACITY ? t->n_backdrop : 0, group + n);
        first += spin_residual_width[k] * t->n_tracks;
    }
    return n;
}

/* Makes an Adam step of the parameters that all frames share. */
static void step_shared(struct spin_trainer *t)
{
    struct spin_device *d = t->device;
    const struct spin_param *exposure = &t->exposures.param;
    size_t n_exposure = t->rates.lenses_stay ? SPIN_EXPOSURE * t->exposures.n_cameras : exposure->n;
    /* At most one group for the table, SPIN_HEADS for the heads, 2 SPIN_HEADS + 2 for the tracks,
     * and one for the exposures. */
    struct spin_param_group group[3 * SPIN_HEADS + 4];
    int n = 0;

    if (t->network)
        n += step_network(t, group + n);
    if (t->n_tracks > 0)
        n += step_tracks(t, group + n);
    if (exposure->n > 0)
        group[n++] =
            spin_param_group(exposure, 0, n_exposure,
                             spin_trainer_rate(t, t->rates.exposure, t->iteration), t->iteration);
    d->op->adam(d, n, group);
    if (exposure->n > n_exposure)
        d->op->zero(d, exposure->g + n_exposure, (exposure->n - n_exposure) * sizeof(float));
    spin_exposures_centre(&t->exposures, d);
}

/* Downloads the losses, divides them by the number n of items of all ranks, and sums them over all
 * items by an all-reduce. */
static spin_status read_values(struct spin_trainer *t, int n, struct spin_train_values *values)
{
    double sum[4] = {0};

    SPIN_TRY(
        t->device->op->download(t->device, t->host_values, t->values,
                                (size_t)t->n_drawn * SPIN_LOSS_VALUES * sizeof *t->host_values));
    sum[3] = t->seen;
    for (int i = 0; i < t->n_drawn; i++) {
        const double *v = t->host_values + i * SPIN_LOSS_VALUES;

        sum[0] += v[SPIN_LOSS] / n;
        sum[1] += v[SPIN_LOSS_L1] / n;
        sum[2] += v[SPIN_LOSS_SSIM] / n;
        if (values->each)
            values->each[t->drawn[i]] = v[SPIN_LOSS];
    }
    if (t->n_ranks > 1)
        SPIN_TRY(spin_ranks_sum(sum, 4, SPIN_SUM_F64));
    values->loss = sum[0];
    values->l1 = sum[1];
    values->ssim = sum[2];
    values->seen = sum[3] > 0;
    return SPIN_OK;
}

spin_status spin_trainer_step(struct spin_trainer *t, const struct spin_images *images,
                              const struct spin_train_item *items, int n,
                              struct spin_train_values *values)
{
    const struct batch b = {images, items, n};

    t->seen = false;
    t->n_drawn = 0;
    spin_trainer_catch_up(t, t->iteration);
    t->iteration++;
    t->field_eval.still = t->rates.position == 0 && t->rates.displacement == 0;
    SPIN_TRY(process_groups(t, &b));
    SPIN_TRY(sum_gradients(t, &b));
    step_shared(t);
    return read_values(t, n, values);
}

/* ---- Log ------------------------------------------------------------------------------------- */

/* True for a character device, such as a terminal, to which a log may be written without --force.
 * False for a FIFO, which could block the training. */
static bool is_device(const char *path)
{
    struct stat st;

    return stat(path, &st) == 0 && S_ISCHR(st.st_mode);
}

/* True if the file is empty or begins with a log line of spin-retrain, as written by log_step() and
 * evaluate_clip() in loop.c. */
static bool is_log(const char *path)
{
    static const char *const begin[] = {"{\"iteration\":", "{\"refine\":"};
    char head[16] = "";
    size_t n;

    if (spin_file_head(path, head, sizeof head - 1, &n) != SPIN_OK)
        return false;
    return n == 0 || strncmp(head, begin[0], strlen(begin[0])) == 0 ||
           strncmp(head, begin[1], strlen(begin[1])) == 0;
}

spin_status spin_step_log_open(struct spin_step_log *log, const char *path, bool append, bool force)
{
    int fd, flags = O_WRONLY | O_CREAT | O_CLOEXEC;

    log->path = path;
    if (!path)
        return SPIN_OK;
    append = append && spin_path_is_taken(path) && (!force || is_log(path));
    if (!is_device(path))
        SPIN_TRY(spin_out_check(path, append || force));
    if (append && !is_device(path) && !is_log(path))
        return spin_fail(SPIN_E_IO,
                         "cannot append to '%s': the file is not a log of spin-retrain; give "
                         "another name, or --force to overwrite the file",
                         path);
    pthread_mutex_init(&log->lock, NULL);
    flags |= append ? O_APPEND : force || is_device(path) ? O_TRUNC : O_EXCL;
    fd = open(path, flags, 0666);
    log->file = fd >= 0 ? fdopen(fd, append ? "a" : "w") : NULL;
    if (log->file)
        return SPIN_OK;
    (void)spin_fail(SPIN_E_IO, "cannot write the log '%s': %s", path, strerror(errno));
    if (fd >= 0)
        close(fd);
    return SPIN_E_IO;
}

static void check_write(struct spin_step_log *log, bool flush)
{
    if (!ferror(log->file) && (!flush || fflush(log->file) == 0))
        return;
    snprintf(log->error, sizeof log->error, "%s", strerror(errno ? errno : EIO));
    spin_warn("cannot write the log '%s': %s; the training continues without a log", log->path,
              log->error);
    fclose(log->file);
    log->file = NULL;
}

FILE *spin_step_log_begin(struct spin_step_log *log)
{
    if (!log->path)
        return NULL;
    pthread_mutex_lock(&log->lock);
    if (log->file)
        return log->file;
    pthread_mutex_unlock(&log->lock);
    return NULL;
}

void spin_step_log_end(struct spin_step_log *log, bool flush)
{
    check_write(log, flush);
    pthread_mutex_unlock(&log->lock);
}

void spin_step_log_close(struct spin_step_log *log)
{
    if (log->file)
        check_write(log, true);
    if (log->file && fclose(log->file) != 0)
        snprintf(log->error, sizeof log->error, "%s", strerror(errno));
    log->file = NULL;
}

/* ---- SIMD paths ------------------------------------------------------------------------------ */

void spin_simd_paths_begin(struct spin_simd_paths *paths, const char *now)
{
    paths->now = now;
    snprintf(paths->all, sizeof paths->all, "%s", now);
}

void spin_simd_paths_add(struct spin_simd_paths *paths, const char *before)
{
    bool other = false;

    for (const char *at = before ? before : ""; *at;) {
        size_t n = strcspn(at, "+"), used = strlen(paths->all);
        char one[sizeof paths->all];

        snprintf(one, sizeof one, "%.*s", (int)n, at);
        at += n + (at[n] == '+');
        if (one[strspn(one, "abcdefghijklmnopqrstuvwxyz0123456789")] || strstr(paths->all, one) ||
            used + strlen(one) + 2 > sizeof paths->all)
            continue;
        snprintf(paths->all + used, sizeof paths->all - used, "%s%s", used ? "+" : "", one);
        other = true;
    }
    if (other)
        spin_warn(
            "the SIMD path of this run is %s, but the training has used several (%s): its output "
            "will differ in the last bits from that of an uninterrupted training",
            paths->now, paths->all);
}
