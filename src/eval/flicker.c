/* Renders the views of each static camera frame by frame and sums the differences between
 * successive images. */
#include "eval/flicker.h"

#include "base/base.h"
#include "io/image.h"
#include "io/ranks.h"

/* The images of one view. struct flicker contains one for the previous and one for the current view
 * of a camera. */
struct moment {
    float *render, *image; /* [3][h][w] */
    uint8_t *dynamic;      /* [h][w] 1 for dynamic pixels, otherwise 0 */
    int frame;             /* index of the frame in the clip; -1: no view so far */
};

struct flicker {
    const struct spin_metrics *m;
    struct moment moment[2];
    struct spin_flicker_strip *strip;
    struct spin_progress progress;
    long long done;
};

#define NO_STATIC_CAMERA                                                                           \
    "cannot measure flicker: no measured camera is static in two successive frames; omit "         \
    "--temporal"

struct spin_flicker spin_flicker_mean(const struct spin_flicker_sums *sums, size_t n)
{
    struct spin_flicker_sums all = {0};

    for (size_t i = 0; i < n; i++) {
        all.n_static += sums[i].n_static;
        all.n_dynamic += sums[i].n_dynamic;
        all.render += sums[i].render;
        all.images += sums[i].images;
        all.dynamic_error += sums[i].dynamic_error;
    }
    return (struct spin_flicker){
        .render = all.n_static ? all.render / (double)all.n_static : NAN,
        .images = all.n_static ? all.images / (double)all.n_static : NAN,
        .dynamic_error = all.n_dynamic ? all.dynamic_error / (double)all.n_dynamic : NAN,
    };
}

void spin_flicker_strip_free(struct spin_flicker_strip *strip)
{
    free(strip->images);
    free(strip->render);
    memset(strip, 0, sizeof *strip);
}

/* ---- Cameras --------------------------------------------------------------------------------- */

static int camera_of(const struct spin_metrics *m, size_t pair)
{
    return m->clip->views.view[m->pairs[pair].view].camera_id;
}

/* Lists the static cameras among the pairs. */
static spin_status list_cameras(const struct spin_metrics *m, struct spin_flicker_sums **out,
                                size_t *n)
{
    size_t chosen[SPIN_MOVING_ROWS];
    struct spin_flicker_sums *sums;

    SPIN_TRY(spin_alloc(m->n_pairs, sizeof *sums, (void **)out));
    sums = *out;
    *n = 0;
    for (size_t i = 0; i < m->n_pairs; i++) {
        size_t k = 0;

        while (k < i && camera_of(m, k) != camera_of(m, i))
            k++;
        if (k == i && spin_moving_views(&m->clip->views, camera_of(m, i), chosen) > 1)
            sums[(*n)++].camera = camera_of(m, i);
    }
    return SPIN_OK;
}

/* ---- The strip ------------------------------------------------------------------------------- */

/* Finds the row with the most dynamic pixels in all frames of the camera; without dynamic pixels,
 * the middle row. */
static spin_status choose_row(const struct flicker *f, int camera, int *row)
{
    const struct spin_metrics *m = f->m;
    SPIN_FREED size_t *count = NULL;

    for (size_t i = 0; i < m->n_pairs; i++) {
        const struct spin_camera *c = &m->clip->views.view[m->pairs[i].view].camera;
        size_t n = 0, width = (size_t)c->width;

        if (camera_of(m, i) != camera)
            continue;
        if (!count) {
            SPIN_TRY(spin_alloc((size_t)c->height, sizeof *count, (void **)&count));
            *row = c->height / 2;
        }
        if (m->dynamic && m->dynamic->from != SPIN_DYNAMIC_OFF)
            SPIN_TRY(spin_dynamic_mask_find(m->dynamic, m->pairs[i].view, NULL, &n));
        for (size_t p = 0; n > 0 && p < width * (size_t)c->height; p++)
            count[p / width] += m->dynamic->mask[p];
        for (int y = 0; n > 0 && y < c->height; y++)
            *row = count[y] > count[*row] ? y : *row;
    }
    return SPIN_OK;
}

static spin_status open_strip(struct flicker *f, int camera)
{
    const struct spin_metrics *m = f->m;
    struct spin_flicker_strip *s = f->strip;
    size_t n;

    s->camera = camera;
    for (size_t i = 0; i < m->n_pairs; i++)
        if (camera_of(m, i) == camera) {
            s->width = m->clip->views.view[m->pairs[i].view].camera.width;
            s->n_frames++;
        }
    n = (size_t)s->width * (size_t)s->n_frames;
    SPIN_TRY(choose_row(f, camera, &s->row));
    SPIN_TRY(spin_alloc(n, 3 * sizeof(float), (void **)&s->images));
    return spin_alloc(n, 3 * sizeof(float), (void **)&s->render);
}

/* Copies row s->row of an image of `plane` pixels to row `at` of the strip image `to`. */
static void copy_row(const struct spin_flicker_strip *s, const float *image, size_t plane, int at,
                     float *to)
{
    size_t width = (size_t)s->width;

    for (size_t c = 0; c < 3; c++)
        memcpy(to + (c * (size_t)s->n_frames + (size_t)at) * width,
               image + c * plane + (size_t)s->row * width, width * sizeof(float));
}

/* ---- Measuring ------------------------------------------------------------------------------- */

/* Renders a view, and loads its image and its dynamic mask. */
static spin_status load_moment(struct flicker *f, const struct spin_pair *pair, struct moment *now)
{
    const struct spin_metrics *m = f->m;
    const struct spin_camera *c = &m->clip->views.view[pair->view].camera;
    size_t plane = (size_t)c->width * (size_t)c->height, n;

    SPIN_TRY(spin_player_show(m->player, m->clip->frame[pair->frame]));
    SPIN_TRY(spin_player_draw(m->player, c, m->background, now->render));
    for (size_t i = 0; i < 3 * plane; i++)
        now->render[i] = fminf(fmaxf(now->render[i], 0), 1);
    SPIN_TRY(spin_image_cache_get(m->pixels, pair->view, now->image));
    memset(now->dynamic, 0, plane);
    if (m->dynamic && m->dynamic->from != SPIN_DYNAMIC_OFF) {
        SPIN_TRY(spin_dynamic_mask_find(m->dynamic, pair->view, now->image, &n));
        memcpy(now->dynamic, m->dynamic->mask, plane);
    }
    now->frame = pair->frame;
    return SPIN_OK;
}

/* Adds the differences between two successive frames. Samples are static if their pixel is static
 * in both frames. */
static void add_step(const struct moment *a, const struct moment *b, size_t plane,
                     struct spin_flicker_sums *sums)
{
    for (size_t i = 0; i < 3 * plane; i++) {
        double render = 255.0 * ((double)b->render[i] - (double)a->render[i]);
        double image = 255.0 * ((double)b->image[i] - (double)a->image[i]);

        if (a->dynamic[i % plane] || b->dynamic[i % plane]) {
            sums->dynamic_error += fabs(render - image);
            sums->n_dynamic++;
        } else {
            sums->render += fabs(render);
            sums->images += fabs(image);
            sums->n_static++;
        }
    }
}

static spin_status measure_camera(struct flicker *f, struct spin_flicker_sums *sums, bool strip)
{
    const struct spin_metrics *m = f->m;
    int at = 0;

    f->moment[0].frame = -1;
    if (strip)
        SPIN_TRY(open_strip(f, sums->camera));
    for (size_t i = 0; i < m->n_pairs; i++) {
        const struct spin_camera *c = &m->clip->views.view[m->pairs[i].view].camera;
        size_t plane = (size_t)c->width * (size_t)c->height;
        struct moment *before = &f->moment[0], *now = &f->moment[1], swap;

        if (camera_of(m, i) != sums->camera)
            continue;
        if (spin_cancelled())
            return spin_fail_cancelled();
        SPIN_TRY(load_moment(f, &m->pairs[i], now));
        if (before->frame >= 0 && before->frame + 1 == now->frame)
            add_step(before, now, plane, sums);
        if (strip) {
            copy_row(f->strip, now->image, plane, at, f->strip->images);
            copy_row(f->strip, now->render, plane, at++, f->strip->render);
        }
        swap = *before;
        *before = *now;
        *now = swap;
        spin_progress_set(&f->progress, ++f->done, "camera %d", sums->camera);
    }
    return SPIN_OK;
}

/* Measures this rank's share of the static cameras: one in spin_n_ranks() of them. */
static spin_status measure_own(struct flicker *f, struct spin_flicker_sums *sums, size_t n)
{
    for (size_t i = (size_t)spin_rank(); i < n; i += (size_t)spin_n_ranks())
        SPIN_TRY(measure_camera(f, &sums[i], f->strip && i == 0));
    return SPIN_OK;
}

static spin_status merge(struct spin_flicker_sums *sums, size_t n)
{
    SPIN_FREED int *owner = NULL;

    SPIN_TRY(spin_alloc(n, sizeof *owner, (void **)&owner));
    for (size_t i = 0; i < n; i++)
        owner[i] = (int)(i % (size_t)spin_n_ranks());
    return spin_ranks_merge(sums, n, sizeof *sums, owner);
}

static spin_status measure_all(struct flicker *f, struct spin_flicker_sums *sums, size_t n)
{
    size_t pixels = spin_views_pixels(&f->m->clip->views), samples = 0;
    long long n_own = 0;

    if (n == 0)
        return spin_unsupported(NO_STATIC_CAMERA);
    for (int k = 0; k < 2; k++) {
        SPIN_TRY(spin_alloc(pixels, 6 * sizeof(float) + 1, (void **)&f->moment[k].render));
        f->moment[k].image = f->moment[k].render + 3 * pixels;
        f->moment[k].dynamic = (uint8_t *)(f->moment[k].image + 3 * pixels);
    }
    for (size_t k = (size_t)spin_rank(); k < n; k += (size_t)spin_n_ranks())
        for (size_t i = 0; i < f->m->n_pairs; i++)
            n_own += camera_of(f->m, i) == sums[k].camera;
    spin_progress_begin(&f->progress, "measuring flicker", "views", 0, n_own);
    SPIN_TRY(spin_ranks_agree(measure_own(f, sums, n)));
    SPIN_TRY(merge(sums, n));
    for (size_t i = 0; i < n; i++)
        samples += sums[i].n_static + sums[i].n_dynamic;
    return samples > 0 ? SPIN_OK : spin_unsupported(NO_STATIC_CAMERA);
}

spin_status spin_flicker_run(const struct spin_metrics *m, struct spin_flicker_sums **sums,
                             size_t *n, struct spin_flicker_strip *strip)
{
    struct flicker f = {.m = m, .strip = strip};
    spin_status status = list_cameras(m, sums, n);

    if (status == SPIN_OK)
        status = measure_all(&f, *sums, *n);
    spin_progress_end(&f.progress);
    for (int k = 0; k < 2; k++)
        free(f.moment[k].render);
    return status;
}
