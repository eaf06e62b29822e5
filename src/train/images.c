/* What a retraining learns from: its images are looked at before the first step, so that a run does not
 * end at one that is missing or cut short hours later, and their imprints tell whether kept work was
 * made from the same. */
#include <stdlib.h>

#include "base/err.h"
#include "base/mem.h"
#include "train/run.h"
#include "io/image.h"

/* ---- Numbers for bytes ------------------------------------------------------------------------- */

/* FNV-1a, 64 bits, of more bytes. */
static void add(uint64_t *hash, const void *data, size_t n)
{
    const unsigned char *byte = data;

    for (size_t i = 0; i < n; i++)
        *hash = (*hash ^ byte[i]) * 0x100000001b3u;
}

static void add_number(uint64_t *hash, double value) { add(hash, &value, sizeof value); }

static void add_imprint(uint64_t *hash, const struct spin_imprint *imprint)
{
    add(hash, &imprint->size, sizeof imprint->size);
    add(hash, &imprint->crc, sizeof imprint->crc);
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

/* ---- Looking ----------------------------------------------------------------------------------- */

/* The image of a view, and its mask where masks decide; *hash may be NULL. */
static spin_status look_at(const struct spin_run *r, size_t index, uint64_t *hash)
{
    const struct spin_view *view = &r->clip.views.view[index];
    struct spin_imprint imprint;
    int width, height;

    if (spin_cancelled())
        return spin_fail_cancelled();
    SPIN_TRY(spin_image_look(view->path, &width, &height, &imprint));
    SPIN_TRY(spin_view_check_size(view, width, height));
    if (!hash)
        return SPIN_OK;
    *hash = 0xcbf29ce484222325u;
    add_imprint(hash, &imprint);
    add_camera(hash, view);
    if (r->dynamic.from != SPIN_DYNAMIC_MASKS)
        return SPIN_OK;
    SPIN_TRY(spin_image_look(view->mask, &width, &height, &imprint));
    add_imprint(hash, &imprint);
    return SPIN_OK;
}

/* Views that a camera's pixels are compared with to find what moves. */
static size_t median_views(const struct spin_run *r, int camera, size_t *view)
{
    if (r->dynamic.from != SPIN_DYNAMIC_IMAGES)
        return 0;
    return spin_moving_views(&r->clip.views, camera, view);
}

spin_status spin_run_look_at_images(struct spin_run *r)
{
    size_t median[SPIN_MOVING_ROWS];
    void *block = NULL;

    SPIN_TRY(spin_alloc(r->clip.views.n, sizeof *r->imprint, &block));
    r->imprint = block;
    for (size_t i = 0; i < r->n_train; i++)
        SPIN_TRY(look_at(r, r->train[i].view, &r->imprint[r->train[i].view]));
    for (int k = 0; k < r->n_cameras; k++) {
        size_t n = median_views(r, r->camera[k], median);

        for (size_t i = 0; i < n; i++)
            if (!r->imprint[median[i]])
                SPIN_TRY(look_at(r, median[i], &r->imprint[median[i]]));
    }
    for (size_t i = 0; i < r->n_test; i++)
        SPIN_TRY(look_at(r, r->test[i].view, NULL));
    return SPIN_OK;
}

uint64_t spin_run_imprint(const struct spin_run *r, int frame)
{
    size_t median[SPIN_MOVING_ROWS];
    uint64_t hash = 0xcbf29ce484222325u;

    for (size_t i = 0; i < r->n_train; i++) {
        const struct spin_pair *pair = &r->train[i];
        size_t n;

        if (frame >= 0 && pair->frame != frame)
            continue;
        add_number(&hash, frame < 0 ? pair->frame : 0);
        add(&hash, &r->imprint[pair->view], sizeof *r->imprint);
        n = median_views(r, r->clip.views.view[pair->view].camera_id, median);
        for (size_t k = 0; k < n; k++)
            add(&hash, &r->imprint[median[k]], sizeof *r->imprint);
    }
    return hash;
}
