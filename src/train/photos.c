/* Loads the images, masks and mattes of a run, checks the files and computes digests. */
#include "train/photos.h"

#include <unistd.h>

#include "base/base.h"
#include "io/file.h"
#include "io/image.h"
#include "math/rng.h"

spin_status spin_photos_open(struct spin_photos *photos, const struct spin_plan *plan)
{
    SPIN_TRY(spin_image_cache_open(&plan->clip.views, plan->pixels_budget, plan->o->background,
                                   &photos->cache));
    if (plan->o->n_threads != 1)
        SPIN_TRY(spin_image_cache_read_ahead(&photos->cache));
    SPIN_TRY(spin_alloc(plan->max_pixels, 4, (void **)&photos->image));
    if (!spin_plan_is_weighted(plan))
        return SPIN_OK;
    SPIN_TRY(spin_dynamic_mask_open(&plan->clip.views, &photos->cache, SPIN_DYNAMIC_AUTO,
                                    plan->train, plan->n_train, &photos->dynamic));
    if (photos->dynamic.from == SPIN_DYNAMIC_OFF)
        return spin_unsupported(
            "--dynamic-weight needs foreground masks or a camera that is static for three frames, "
            "and this data set has neither: omit the option");
    return spin_dynamic_mask_keep(&photos->dynamic);
}

void spin_photos_close(struct spin_photos *photos)
{
    spin_dynamic_mask_close(&photos->dynamic);
    spin_mattes_close(&photos->mattes);
    spin_image_cache_close(&photos->cache);
    free(photos->image);
    free(photos->digest);
}

spin_status spin_photos_choose_alpha(struct spin_photos *photos, struct spin_plan *plan)
{
    bool *choice = &plan->report->options.learn_alpha;
    enum spin_surroundings surroundings;

    /* The exposure of a camera does not affect a random background, so training over one would bias
     * the learned exposures. */
    if (plan->o->learn_exposure == SPIN_EXPOSURE_ON)
        *choice = false;
    if (!*choice)
        return SPIN_OK;
    SPIN_TRY(spin_mattes_open(&plan->clip.views, &photos->cache, plan->train, plan->n_train,
                              &photos->mattes, &surroundings));
    *choice = photos->mattes.views != NULL;
    if (*choice)
        spin_log(0, "learning the alpha of the subject from %s",
                 photos->mattes.alpha ? "the alpha of the images"
                                      : "the background-coloured pixels around it");
    return SPIN_OK;
}

spin_status spin_photos_open_store(const struct spin_photos *photos, const struct spin_plan *plan,
                                   struct spin_device *device, size_t n,
                                   struct spin_image_store *store)
{
    SPIN_TRY(spin_image_store_open(store, device, n, plan->max_pixels, SPIN_IMAGE_RGB8,
                                   spin_plan_is_weighted(plan)));
    if (photos->mattes.views)
        SPIN_TRY(spin_image_store_add_mattes(store));
    store->images.mask_weight[1] = (float)plan->o->dynamic_weight;
    return SPIN_OK;
}

spin_status spin_photos_put(struct spin_photos *photos, const struct spin_plan *plan, size_t view,
                            struct spin_image_store *store, uint32_t number)
{
    const struct spin_camera *camera = &plan->clip.views.view[view].camera;
    size_t n = (size_t)camera->width * (size_t)camera->height, dynamic;
    uint8_t *mask = NULL;

    SPIN_TRY(spin_image_cache_get_rgb8(&photos->cache, view, photos->image));
    if (spin_plan_is_weighted(plan)) {
        mask = photos->image + 3 * plan->max_pixels;
        SPIN_TRY(spin_dynamic_mask_find(&photos->dynamic, view, NULL, &dynamic));
        spin_dynamic_mask_bits(&photos->dynamic, n, mask);
    }
    spin_image_store_put(store, number, n, photos->image, mask);
    if (photos->mattes.views) {
        SPIN_TRY(spin_mattes_find(&photos->mattes, view, photos->image));
        spin_image_store_put_matte(store, number, n, photos->image);
    }
    return SPIN_OK;
}

/* ---- Content --------------------------------------------------------------------------------- */

enum {
    EXAMINED = 8,    /* number of images */
    LEAST_EDGE = 24, /* an edge is a mean difference between neighbours above this, of 255 */
    MOST_NOISE = 16, /* the background is a difference from its colour of at most this, of 255 */
};

/* Adds the numbers of pixels at edges and of pixels of the background in an image [h][w][3]. */
static void add_content(const uint8_t *image, size_t width, size_t height,
                        const float background[3], size_t *n_edges, size_t *n_empty)
{
    size_t row = 3 * width;

    for (size_t y = 0; y + 1 < height; y++)
        for (size_t x = 0; x + 1 < width; x++) {
            const uint8_t *p = image + y * row + 3 * x;
            float away = 0;
            int sum = 0;

            for (size_t c = 0; c < 3; c++) {
                sum += abs(p[c + 3] - p[c]) + abs(p[c + row] - p[c]);
                away = fmaxf(away, fabsf((float)p[c] - 255 * background[c]));
            }
            *n_edges += sum > 2 * 3 * LEAST_EDGE;
            *n_empty += away <= MOST_NOISE;
        }
}

spin_status spin_photos_measure_content(struct spin_photos *photos, struct spin_plan *plan)
{
    size_t n_edges = 0, n_empty = 0, n = 0;

    for (size_t i = 0; i < EXAMINED; i++) {
        size_t view = plan->train[(2 * i + 1) * plan->n_train / (2 * EXAMINED)].view;
        const struct spin_camera *c = &plan->clip.views.view[view].camera;
        size_t width = (size_t)c->width, height = (size_t)c->height;

        SPIN_TRY(spin_image_cache_get_rgb8(&photos->cache, view, photos->image));
        add_content(photos->image, width, height, plan->o->background, &n_edges, &n_empty);
        n += width * height;
    }
    spin_plan_set_content(plan, (double)n_edges / EXAMINED, (double)n_empty / (double)n,
                          photos->cache.held);
    return SPIN_OK;
}

/* ---- Digests --------------------------------------------------------------------------------- */

static void add_number(uint64_t *hash, double value) { spin_hash(hash, &value, sizeof value); }

static void add_digest(uint64_t *hash, const struct spin_digest *digest)
{
    spin_hash(hash, &digest->size, sizeof digest->size);
    spin_hash(hash, &digest->crc, sizeof digest->crc);
}

static void add_camera(uint64_t *hash, const struct spin_view *view)
{
    const struct spin_camera *c = &view->camera;
    const double values[] = {view->camera_id, c->width, c->height, c->fx, c->fy, c->cx, c->cy};

    for (size_t i = 0; i < sizeof values / sizeof *values; i++)
        add_number(hash, values[i]);
    for (int i = 0; i < 12; i++)
        add_number(hash, c->w2c[i]);
}

/* ---- Checking the files ---------------------------------------------------------------------- */

/* Reads the header of a view's image file and checks that the size of the image is that of the
 * view. Sets *hash to a digest of the image, the camera and, if masks of dynamic pixels are read
 * from files, the mask. hash may be NULL. */
static spin_status check_view(const struct spin_photos *photos, const struct spin_plan *plan,
                              size_t index, uint64_t *hash)
{
    const struct spin_view *view = &plan->clip.views.view[index];
    struct spin_digest digest;
    int width, height;

    if (spin_cancelled())
        return spin_fail_cancelled();
    SPIN_TRY(spin_image_check(view->path, &width, &height, &digest));
    SPIN_TRY(spin_view_check_size(view, width, height));
    if (!hash)
        return SPIN_OK;
    *hash = SPIN_HASH_BEGIN;
    add_digest(hash, &digest);
    add_camera(hash, view);
    if (photos->dynamic.from != SPIN_DYNAMIC_MASKS)
        return SPIN_OK;
    SPIN_TRY(spin_image_check(view->mask, &width, &height, &digest));
    add_digest(hash, &digest);
    return SPIN_OK;
}

/* Sets view [SPIN_MOVING_ROWS] to the views of a camera whose images are compared to find dynamic
 * pixels, and returns the number of these views; 0 if dynamic pixels are not found in this way. */
static size_t median_views(const struct spin_photos *photos, const struct spin_plan *plan,
                           int camera, size_t *view)
{
    if (photos->dynamic.from != SPIN_DYNAMIC_IMAGES)
        return 0;
    return spin_moving_views(&plan->clip.views, camera, view);
}

spin_status spin_photos_check_images(struct spin_photos *photos, const struct spin_plan *plan)
{
    size_t median[SPIN_MOVING_ROWS];

    SPIN_TRY(spin_alloc(plan->clip.views.n, sizeof *photos->digest, (void **)&photos->digest));
    for (size_t i = 0; i < plan->n_train; i++)
        SPIN_TRY(
            check_view(photos, plan, plan->train[i].view, &photos->digest[plan->train[i].view]));
    for (int k = 0; k < plan->n_cameras; k++) {
        size_t n = median_views(photos, plan, plan->camera[k], median);

        for (size_t i = 0; i < n; i++)
            if (!photos->digest[median[i]])
                SPIN_TRY(check_view(photos, plan, median[i], &photos->digest[median[i]]));
    }
    for (size_t i = 0; i < plan->n_test; i++)
        SPIN_TRY(check_view(photos, plan, plan->test[i].view, NULL));
    return SPIN_OK;
}

uint64_t spin_photos_digest(const struct spin_photos *photos, const struct spin_plan *plan,
                            int frame)
{
    size_t median[SPIN_MOVING_ROWS];
    uint64_t hash = SPIN_HASH_BEGIN;

    for (size_t i = 0; i < plan->n_train; i++) {
        const struct spin_pair *pair = &plan->train[i];
        size_t n;

        if (frame >= 0 && pair->frame != frame)
            continue;
        add_number(&hash, frame < 0 ? pair->frame : 0);
        spin_hash(&hash, &photos->digest[pair->view], sizeof *photos->digest);
        n = median_views(photos, plan, plan->clip.views.view[pair->view].camera_id, median);
        for (size_t k = 0; k < n; k++)
            spin_hash(&hash, &photos->digest[median[k]], sizeof *photos->digest);
    }
    return hash;
}

/* ---- Views of an iteration ------------------------------------------------------------------- */

/* Streams of the random generator, see math/rng.h. */
enum { STREAM_SHUFFLE = 16, STREAM_FRAME = 33, STREAM_BACKGROUND = 34 };

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

/* Sets s->sequence to the order of an epoch: a random permutation of all pairs of a frame and a
 * training view. If views_per_frame is V > 1, the pairs of each frame are permuted and divided into
 * groups of at most V pairs, and then the groups of all frames are permuted, so that the pairs of a
 * group stay together. The order depends only on the seed and the epoch. */
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
    /* Sort by frame with a stable sort, so that the pairs of a frame are consecutive and keep their
     * shuffled order. */
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

/* Chooses a random background for item k if its image has a matte. */
static void change_background(struct spin_sampler *s, int64_t iteration, size_t k)
{
    struct spin_train_item *item = &s->items[k];
    uint64_t at = 3 * ((uint64_t)iteration * (uint64_t)s->plan->o->batch + k);

    item->matte = spin_image_store_matte(&s->images, item->image);
    for (size_t c = 0; c < 3 && item->matte; c++)
        item->background_change[c] =
            spin_rng_uniform(s->seed, STREAM_BACKGROUND, at + c) - s->plan->o->background[c];
}

/* Announces the images of the next iterations of the same epoch that this rank will load, so that
 * they are decoded during this iteration. */
static void announce_next(struct spin_sampler *s, int64_t iteration, int64_t per_epoch)
{
    const struct spin_plan *plan = s->plan;
    size_t batch = (size_t)plan->o->batch, left = spin_image_cache_ahead(&s->photos->cache);
    size_t at = (size_t)(iteration % per_epoch + 1) * batch, end = (size_t)per_epoch * batch;

    for (; at < end && at < plan->n_train && left > 0; at++) {
        size_t view = plan->train[s->sequence[at]].view;

        if (spin_step_rank((int)(at % batch), (int)batch, spin_n_ranks()) != spin_rank() ||
            spin_image_store_has(&s->images, view))
            continue;
        spin_image_cache_announce(&s->photos->cache, view);
        left--;
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
            spin_step_rank((int)k, (int)batch, spin_n_ranks()) == spin_rank()) {
            SPIN_TRY(find_image(s, s->pairs[k]->view, &s->items[k].image));
            change_background(s, iteration, k);
        }
    if (!is_single_frame(plan))
        announce_next(s, iteration, per_epoch);
    return SPIN_OK;
}

int spin_sampler_next_frame(const struct spin_sampler *s, int64_t iteration, size_t k)
{
    size_t batch = (size_t)s->plan->o->batch, n = s->plan->n_train, per_epoch = n / batch;
    size_t next = per_epoch > 0 ? (size_t)iteration % per_epoch + 1 : 1;

    return next < per_epoch ? s->plan->train[s->sequence[next * batch + k]].frame : -1;
}

/* Returns the number of slots of the sampler's image store. On a GPU: as many images as fit into
 * half of the free memory, but at least a batch and at most all images. On the CPU: a batch, since
 * the image cache in host memory already keeps images. For a single frame: all images of the frame.
 */
static size_t images_kept(const struct spin_photos *photos, const struct spin_plan *plan)
{
    size_t batch = (size_t)plan->o->batch, most;

    if (is_single_frame(plan))
        return plan->n_train;
    if (plan->device->is_host)
        return batch;
    most = plan->device->op->memory_available(plan->device) / 2 /
           (spin_plan_image_bytes(plan) + (photos->mattes.views ? plan->max_pixels : 0));
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
    SPIN_TRY(
        spin_photos_open_store(photos, plan, plan->device, images_kept(photos, plan), &s->images));
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

/* ---- Test views ------------------------------------------------------------------------------ */

spin_status spin_test_views_measure(const struct spin_plan *plan, struct spin_photos *photos,
                                    struct spin_player *shown, const size_t *live_counts,
                                    const char *what, struct spin_quality *out)
{
    struct spin_metrics m = {.player = shown,
                             .clip = &plan->clip,
                             .pixels = &photos->cache,
                             .pairs = plan->test,
                             .n_pairs = plan->n_test,
                             .background = plan->o->background,
                             .live_counts = live_counts,
                             .what = what};

    memset(out, 0, sizeof *out);
    return plan->n_test > 0 ? spin_metrics_run(&m, out) : SPIN_OK;
}

/* With --method 4d, applies the falloffs of the input, which the earlier training learned, to the
 * renders of the player. */
static spin_status set_lenses(const struct spin_plan *plan, struct spin_player *input,
                              struct spin_lenses *lenses)
{
    if (plan->o->method != SPIN_METHOD_4D)
        return SPIN_OK;
    SPIN_TRY(spin_lenses_from_json(spin_json_get(plan->clip.bundle.json, "lenses"),
                                   plan->o->image_scale, lenses));
    return spin_player_set_lenses(input, lenses);
}

spin_status spin_test_views_measure_input(struct spin_plan *plan, struct spin_photos *photos,
                                          struct spin_device *device, struct spin_quality *out)
{
    bool trained = plan->o->method == SPIN_METHOD_4D;
    SPIN_LEAVES(spin_lenses_free) struct spin_lenses lenses = {0};
    SPIN_LEAVES(spin_player_close) struct spin_player input = {0};

    memset(out, 0, sizeof *out);
    if (!trained && !spin_plan_has_source(plan))
        return SPIN_OK;
    SPIN_TRY(spin_player_open(&input, device, &plan->clip.bundle,
                              trained ? SPIN_FROM_TRAINED : SPIN_FROM_SOURCE));
    SPIN_TRY(set_lenses(plan, &input, &lenses));
    return spin_test_views_measure(plan, photos, &input, NULL,
                                   trained ? "evaluating the clip" : "evaluating the source", out);
}

/* Writes the preview of one view as a PNG; source NULL: without the image of the source. */
static spin_status preview_view(struct spin_plan *plan, struct spin_photos *photos,
                                struct spin_player *shown, struct spin_player *source,
                                const struct spin_pair *pair, const char *label)
{
    const struct spin_view *view = &plan->clip.views.view[pair->view];
    size_t pixels = 3 * (size_t)view->camera.width * (size_t)view->camera.height;
    const float *picture[3];
    char name[SPIN_IMAGE_NAME];
    SPIN_FREED char *path = NULL;
    SPIN_FREED float *values = NULL;
    int n = 0;

    SPIN_TRY(spin_alloc(3 * pixels, sizeof(float), (void **)&values));
    SPIN_TRY(spin_image_cache_get(&photos->cache, pair->view, values));
    picture[n++] = values;
    if (source) {
        SPIN_TRY(spin_player_show(source, spin_plan_index(plan, pair->frame)));
        SPIN_TRY(spin_player_draw(source, &view->camera, plan->o->background, values + pixels));
        picture[n++] = values + pixels;
    }
    SPIN_TRY(spin_player_draw(shown, &view->camera, plan->o->background, values + 2 * pixels));
    picture[n++] = values + 2 * pixels;
    spin_image_name(&plan->clip.views, pair->view, spin_plan_info(plan, pair->frame)->number, label,
                    name);
    SPIN_TRY(spin_path_join(plan->o->preview, name, &path));
    return spin_write_beside(path, view->camera.width, view->camera.height, picture, n);
}

static spin_status write_previews(struct spin_plan *plan, struct spin_photos *photos,
                                  struct spin_player *shown, const char *label)
{
    SPIN_LEAVES(spin_player_close) struct spin_player source = {0};
    bool with_source = spin_plan_has_source(plan);
    int middle = spin_plan_middle_frame(plan);

    if (!plan->o->preview || plan->n_test == 0)
        return SPIN_OK;
    if (with_source)
        SPIN_TRY(spin_player_open(&source, shown->device, &plan->clip.bundle, SPIN_FROM_SOURCE));
    SPIN_TRY(spin_player_show_live(shown, middle, plan->counts[middle]));
    for (size_t i = 0; i < plan->n_test; i++)
        if (plan->test[i].frame == middle)
            SPIN_TRY(preview_view(plan, photos, shown, with_source ? &source : NULL, &plan->test[i],
                                  label));
    return SPIN_OK;
}

spin_status spin_test_views_preview(struct spin_plan *plan, struct spin_photos *photos,
                                    struct spin_player *shown, const char *label)
{
    return spin_plan_beside(plan, write_previews(plan, photos, shown, label));
}

/* Returns whether the name is cam_CAMERA_frame_FRAME_iteration_ITERATION.png, see
 * spin_image_name(). */
static bool is_preview(const char *name)
{
    const char *frame = strstr(name, "_frame_"), *iteration = strstr(name, "_iteration_");
    size_t n_digits;

    if (strncmp(name, "cam_", 4) != 0 || !frame || !iteration || iteration < frame)
        return false;
    iteration += strlen("_iteration_");
    n_digits = strspn(iteration, "0123456789");
    return n_digits >= 7 && strcmp(iteration + n_digits, ".png") == 0;
}

static bool remove_file(const char *folder, const char *name)
{
    SPIN_FREED char *path = NULL;

    return spin_path_join(folder, name, &path) == SPIN_OK &&
           spin_out_check(path, true) == SPIN_OK && unlink(path) == 0;
}

void spin_previews_remove(const char *folder)
{
    char **names = NULL, text[48];
    size_t n = 0, n_removed = 0, n_left = 0;

    if (!spin_path_is_taken(folder) || spin_folder_list(folder, &names, &n) != SPIN_OK)
        return;
    for (size_t i = 0; i < n; i++)
        if (is_preview(names[i]))
            (*(remove_file(folder, names[i]) ? &n_removed : &n_left))++;
    spin_folder_list_free(names);
    if (n_removed > 0)
        spin_log(0, "removed %s of an earlier training from '%s'",
                 spin_text_count((long long)n_removed, "preview", text), folder);
    if (n_left > 0)
        spin_warn("cannot remove %s of an earlier training from '%s'",
                  spin_text_count((long long)n_left, "preview", text), folder);
}

/* ---- Splats that no training camera sees ----------------------------------------------------- */

static const float unseen_logit = 1.5f; /* opacity 0.8, for a source without attributes */

/* Sets the first values of out [n_train] to the training cameras of a frame, and returns their
 * number. */
static size_t cameras_of(const struct spin_plan *plan, int f, const struct spin_camera **out)
{
    size_t n = 0;

    for (size_t i = 0; i < plan->n_train; i++)
        if (plan->train[i].frame == f)
            out[n++] = &plan->clip.views.view[plan->train[i].view].camera;
    return n;
}

/* True if the point `place` is visible in at least one of the n cameras. */
static bool is_seen(const struct spin_camera *const *camera, size_t n, const float place[3])
{
    double p[3];

    for (size_t i = 0; i < n; i++)
        if (spin_camera_project_visible(camera[i], place, p))
            return true;
    return false;
}

spin_status spin_show_unseen(const struct spin_plan *plan, const struct spin_splats *s, int f,
                             struct spin_refine_cloud *cloud)
{
    SPIN_LEAVES(spin_refine_cloud_free) struct spin_refine_cloud source = {0};
    SPIN_FREED const struct spin_camera **camera = NULL;
    size_t n;

    SPIN_TRY(spin_alloc(plan->n_train + 1, sizeof *camera, (void **)&camera));
    n = cameras_of(plan, f, camera);
    if (s->logit_opacities)
        SPIN_TRY(spin_refine_init_from_splats(s, &source));
    for (size_t i = 0; i < cloud->n; i++)
        if (is_seen(camera, n, s->means + 3 * i))
            cloud->point[i].seen = 1;
        else if (source.n > 0)
            cloud->point[i].p = source.point[i].p;
        else
            cloud->point[i].p.logit_opacity = unseen_logit;
    return SPIN_OK;
}
