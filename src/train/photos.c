/* Loads the images and masks for training, checks their files and computes their digests. */
#include "train/photos.h"

#include "base/base.h"
#include "io/image.h"

spin_status spin_photos_open(struct spin_photos *photos, const struct spin_plan *plan)
{
    SPIN_TRY(spin_image_cache_open(&plan->clip.views, plan->pixels_budget, plan->o->background,
                                   &photos->cache));
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
    spin_image_cache_close(&photos->cache);
    free(photos->image);
    free(photos->digest);
}

spin_status spin_photos_open_store(const struct spin_plan *plan, struct spin_device *device,
                                   size_t n, struct spin_image_store *store)
{
    SPIN_TRY(spin_image_store_open(store, device, n, plan->max_pixels, SPIN_IMAGE_RGB8,
                                   spin_plan_is_weighted(plan)));
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

/* Checks that the image of a view exists and has the size of the view, by the header of the file.
 * Sets *hash to the digest of the image and the camera and, if the data set has masks of dynamic
 * pixels that are used, of the mask. With `hash` NULL it computes no digest. */
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

/* Sets `view` to the views of a camera whose images are compared to find dynamic pixels, and
 * returns their number; 0 if dynamic pixels are not found by comparing images. */
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
