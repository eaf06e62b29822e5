/* Chooses the views of each iteration from shuffled epochs, and loads their images into the store
 * of the device. */
#include "train/sampler.h"

#include "base/base.h"
#include "math/rng.h"

enum { STREAM_SHUFFLE = 16, STREAM_FRAME = 33 }; /* streams of random numbers, see math/rng.h */

static void shuffle(const struct spin_sampler *s, uint64_t key, uint32_t *list, size_t n)
{
    for (size_t i = n; i > 1; i--) {
        size_t j = spin_rng_below(s->seed, STREAM_SHUFFLE, key << 32 | i, (uint32_t)i);
        uint32_t keep = list[i - 1];

        list[i - 1] = list[j];
        list[j] = keep;
    }
}

static bool is_single_frame(const struct spin_plan *plan)
{
    return plan->o->method == SPIN_METHOD_FRAMES;
}

static spin_status find_image(struct spin_sampler *s, size_t view, uint32_t *image)
{
    return spin_image_store_find(&s->images, view, image)
               ? SPIN_OK
               : spin_photos_put(s->photos, s->plan, view, &s->images, *image);
}

/* Sets s->sequence to the order of an epoch: a permutation of all pairs of a frame and a training
 * camera. With views_per_frame V above 1, the pairs of each frame are permuted and cut into groups
 * of at most V pairs, and then the groups of all frames are permuted. The order depends only on the
 * seed and the epoch. */
static void plan_epoch(struct spin_sampler *s, int64_t epoch)
{
    size_t n = s->plan->n_train, v = (size_t)s->plan->o->views_per_frame, n_groups = 0;
    uint32_t *views = s->sequence + n, *groups = views + n;

    if (s->epoch == epoch)
        return;
    for (size_t i = 0; i < n; i++)
        s->sequence[i] = (uint32_t)i;
    s->epoch = epoch;
    if (v == 1) {
        shuffle(s, 2 * (uint64_t)epoch, s->sequence, n);
        return;
    }
    memcpy(views, s->sequence, n * sizeof *views);
    shuffle(s, 2 * (uint64_t)epoch, views, n);
    /* Sort by frame, in a stable way, so that the pairs of each frame are consecutive and keep
     * their shuffled order. */
    for (size_t f = 0, k = 0; f < (size_t)s->plan->clip.n_frames; f++) {
        size_t first = k;

        for (size_t i = 0; i < n; i++)
            if (s->plan->train[views[i]].frame == (int)f)
                s->sequence[k++] = views[i];
        for (size_t i = first; i < k; i += v)
            groups[n_groups++] = (uint32_t)i;
    }
    memcpy(views, s->sequence, n * sizeof *views);
    shuffle(s, 2 * (uint64_t)epoch + 1, groups, n_groups);
    for (size_t g = 0, k = 0; g < n_groups; g++) {
        int frame = s->plan->train[views[groups[g]]].frame;

        for (size_t i = groups[g];
             i < n && i < groups[g] + v && s->plan->train[views[i]].frame == frame; i++)
            s->sequence[k++] = views[i];
    }
}

spin_status spin_sampler_batch(struct spin_sampler *s, int64_t iteration)
{
    const struct spin_plan *plan = s->plan;
    size_t batch = (size_t)plan->o->batch;
    int64_t per_epoch = (int64_t)(plan->n_train / batch);

    if (per_epoch < 1)
        per_epoch = 1;
    plan_epoch(s, iteration / per_epoch);
    spin_image_store_begin_batch(&s->images);
    for (size_t k = 0; k < batch; k++) {
        size_t at = ((size_t)(iteration % per_epoch) * batch + k) % plan->n_train;
        const struct spin_pair *pair = &plan->train[s->sequence[at]];
        const struct spin_view *view = &plan->clip.views.view[pair->view];
        struct spin_train_item *item = &s->items[k];

        item->frame = pair->frame;
        item->camera = &view->camera;
        item->exposure = spin_plan_camera(plan, view->camera_id);
        item->lens = plan->n_cameras + spin_lenses_find(&plan->lenses, &view->camera);
        s->pairs[k] = pair;
    }
    for (size_t k = 0; k < batch; k++)
        if (is_single_frame(plan) ||
            spin_step_rank((int)k, (int)batch, spin_n_ranks()) == spin_rank())
            SPIN_TRY(find_image(s, s->pairs[k]->view, &s->items[k].image));
    return SPIN_OK;
}

/* Returns the number of images that the store can hold. On a GPU this is as many as fit in half of
 * its free memory, but at least a batch and at most all. On the CPU it is a batch, since the image
 * cache holds more in the same memory. For a single frame it is all its images. */
static size_t images_kept(const struct spin_plan *plan)
{
    size_t batch = (size_t)plan->o->batch, most;

    if (is_single_frame(plan))
        return plan->n_train;
    if (plan->device->is_host)
        return batch;
    most = plan->device->op->memory_available(plan->device) / 2 / spin_plan_image_bytes(plan);
    most = plan->n_train < most ? plan->n_train : most;
    return most > batch ? most : batch;
}

spin_status spin_sampler_open(struct spin_sampler *s, const struct spin_plan *plan,
                              struct spin_photos *photos)
{
    size_t batch = (size_t)plan->o->batch;

    s->plan = plan;
    s->photos = photos;
    s->epoch = -1;
    s->seed = plan->o->seed;
    if (is_single_frame(plan))
        s->seed = spin_rng_u64(s->seed, STREAM_FRAME, (uint64_t)spin_plan_info(plan, 0)->number);
    SPIN_TRY(spin_alloc(3 * plan->n_train, sizeof *s->sequence, (void **)&s->sequence));
    SPIN_TRY(spin_photos_open_store(plan, plan->device, images_kept(plan), &s->images));
    SPIN_TRY(spin_alloc(batch, sizeof *s->items, (void **)&s->items));
    SPIN_TRY(spin_alloc(batch, sizeof *s->pairs, (void **)&s->pairs));
    for (size_t i = 0; is_single_frame(plan) && i < plan->n_train; i++) {
        uint32_t image;

        SPIN_TRY(find_image(s, plan->train[i].view, &image));
    }
    return SPIN_OK;
}

void spin_sampler_close(struct spin_sampler *s)
{
    free(s->sequence);
    spin_image_store_close(&s->images);
    free(s->items);
    free(s->pairs);
}
