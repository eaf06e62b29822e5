/* Finds fast motion by the differences between three consecutive frames, with summed-area tables.
 */
#include "eval/report/report.h"

#include "base/base.h"

static const float threshold = 20.0f / 255.0f; /* above the noise of images, as in dynamic_mask.c */

struct search {
    const struct spin_clip *clip;
    struct spin_image_cache *pixels;
    float *now, *before, *after; /* [3][h][w] */
    float *speed;                /* [h][w], from find_speed() */
    double *area;                /* [h + 1][w + 1] summed-area table of speed */
};

/* Returns the view of the pair's camera in another frame of the clip; -1 if there is none. */
static long neighbour_view(const struct search *s, const struct spin_pair *pair, int frame)
{
    const struct spin_views *views = &s->clip->views;
    const struct spin_view *from = &views->view[pair->view];

    if (frame < 0 || frame >= s->clip->n_frames || s->clip->dataset_frame[frame] < 0)
        return -1;
    for (size_t i = 0; i < views->n; i++)
        if (views->view[i].dataset_frame == s->clip->dataset_frame[frame] &&
            views->view[i].camera_id == from->camera_id &&
            views->view[i].camera.width == from->camera.width &&
            views->view[i].camera.height == from->camera.height)
            return (long)i;
    return -1;
}

static float pixel_change(const float *a, const float *b, size_t plane, size_t i)
{
    float most = 0;

    for (size_t c = 0; c < 3; c++)
        most = fmaxf(most, fabsf(a[c * plane + i] - b[c * plane + i]));
    return most;
}

/* Computes s->speed of each pixel: its difference from the previous or the next frame, whichever is
 * smaller, minus the difference between the previous and the next frame. A pixel that an object
 * covers in the current frame only, not in its neighbours, has a high speed, since its background
 * is the same in the previous and the next frame. A moving striped shirt has a low speed, since all
 * three frames differ. Sets *found to false if the camera has no previous or next frame. */
static spin_status find_speed(struct search *s, const struct spin_pair *pair, bool *found)
{
    const struct spin_camera *c = &s->clip->views.view[pair->view].camera;
    size_t plane = (size_t)c->width * (size_t)c->height;
    long before = neighbour_view(s, pair, pair->frame - 1),
         after = neighbour_view(s, pair, pair->frame + 1);

    *found = before >= 0 && after >= 0;
    if (!*found)
        return SPIN_OK;
    SPIN_TRY(spin_image_cache_get(s->pixels, pair->view, s->now));
    SPIN_TRY(spin_image_cache_get(s->pixels, (size_t)before, s->before));
    SPIN_TRY(spin_image_cache_get(s->pixels, (size_t)after, s->after));
    for (size_t i = 0; i < plane; i++) {
        float v = fminf(pixel_change(s->now, s->before, plane, i),
                        pixel_change(s->now, s->after, plane, i)) -
                  pixel_change(s->before, s->after, plane, i);

        s->speed[i] = v > threshold ? v : 0;
    }
    return SPIN_OK;
}

/* Returns the sum of the speed in a window, clipped to the image. */
static double sum_in(const struct search *s, const struct spin_camera *c, int x, int y, int side)
{
    int x0 = x > 0 ? x : 0, y0 = y > 0 ? y : 0;
    int x1 = x + side < c->width ? x + side : c->width;
    int y1 = y + side < c->height ? y + side : c->height;
    size_t row = (size_t)c->width + 1;
    const double *top = s->area + (size_t)y0 * row, *foot = s->area + (size_t)y1 * row;

    return foot[x1] - foot[x0] - top[x1] + top[x0];
}

static int clamp_offset(int v, int most) { return v < 0 ? 0 : v < most ? v : most; }

/* Finds the window with the highest score: the speed in its core minus a quarter of the speed
 * around the core. A small object with a static background, such as a ball in front of a wall, thus
 * has a higher score than a part of a large moving object. */
static void best_window(struct search *s, const struct spin_camera *c, struct spin_crop *out)
{
    int w = c->width, h = c->height, core = h / 9 < 8 ? 8 : h / 9, side = 3 * core;
    size_t row = (size_t)w + 1;

    out->score = 0;
    out->side_x = side < w ? side : w;
    out->side_y = side < h ? side : h;
    memset(s->area, 0, row * sizeof *s->area);
    for (int y = 0; y < h; y++) {
        double sum = 0;

        s->area[(size_t)(y + 1) * row] = 0;
        for (int x = 0; x < w; x++) {
            sum += (double)s->speed[(size_t)y * (size_t)w + (size_t)x];
            s->area[(size_t)(y + 1) * row + (size_t)x + 1] =
                s->area[(size_t)y * row + (size_t)x + 1] + sum;
        }
    }
    for (int y = 0; y + core <= h; y += 2)
        for (int x = 0; x + core <= w; x += 2) {
            double inner = sum_in(s, c, x, y, core);
            double score = inner - 0.25 * (sum_in(s, c, x - core, y - core, side) - inner);

            if (score > out->score) {
                out->score = score;
                out->x = clamp_offset(x - core, w - out->side_x);
                out->y = clamp_offset(y - core, h - out->side_y);
            }
        }
}

static spin_status alloc_search(struct search *s)
{
    size_t plane = 1, corners = 1;

    for (size_t i = 0; i < s->clip->views.n; i++) {
        const struct spin_camera *c = &s->clip->views.view[i].camera;
        size_t n = ((size_t)c->width + 1) * ((size_t)c->height + 1);

        corners = n > corners ? n : corners;
        n = (size_t)c->width * (size_t)c->height;
        plane = n > plane ? n : plane;
    }
    SPIN_TRY(spin_alloc(plane, 3 * sizeof(float), (void **)&s->now));
    SPIN_TRY(spin_alloc(plane, 3 * sizeof(float), (void **)&s->before));
    SPIN_TRY(spin_alloc(plane, 3 * sizeof(float), (void **)&s->after));
    SPIN_TRY(spin_alloc(plane, sizeof(float), (void **)&s->speed));
    return spin_alloc(corners, sizeof(double), (void **)&s->area);
}

/* False if a crop of the same camera in the same or an adjacent frame was already chosen. */
static bool is_new(const struct spin_clip *clip, const struct spin_pair *pairs,
                   const struct spin_crop *chosen, size_t n, const struct spin_pair *pair)
{
    for (size_t i = 0; i < n; i++) {
        const struct spin_pair *other = &pairs[chosen[i].pair];

        if (clip->views.view[other->view].camera_id == clip->views.view[pair->view].camera_id &&
            abs(other->frame - pair->frame) <= 1)
            return false;
    }
    return true;
}

spin_status spin_motion_crops_fast(const struct spin_clip *clip, struct spin_image_cache *pixels,
                                   const struct spin_pair *pairs, size_t n_pairs, size_t most,
                                   struct spin_crop *out, size_t *n)
{
    struct search s = {.clip = clip, .pixels = pixels};
    SPIN_FREED struct spin_crop *all = NULL;
    bool found;
    spin_status status;

    *n = 0;
    SPIN_TRY_OUT(spin_alloc(n_pairs, sizeof *all, (void **)&all));
    SPIN_TRY_OUT(alloc_search(&s));
    for (size_t i = 0; i < n_pairs; i++) {
        all[i].pair = i;
        SPIN_TRY_OUT(find_speed(&s, &pairs[i], &found));
        if (found)
            best_window(&s, &clip->views.view[pairs[i].view].camera, &all[i]);
        if (spin_cancelled()) {
            status = spin_fail_cancelled();
            goto out;
        }
    }
    while (*n < most) {
        size_t best = n_pairs;

        for (size_t i = 0; i < n_pairs; i++)
            if (all[i].score > (best < n_pairs ? all[best].score : 0) &&
                is_new(clip, pairs, out, *n, &pairs[i]))
                best = i;
        if (best == n_pairs)
            break;
        out[(*n)++] = all[best];
        all[best].score = 0;
    }
out:
    free(s.now);
    free(s.before);
    free(s.after);
    free(s.speed);
    free(s.area);
    return status;
}

size_t spin_motion_crops_worst(const struct spin_eval_view *view, size_t n_views, size_t most,
                               size_t *out)
{
    size_t n = 0;

    /* First pass: one view per camera; second pass: any view. */
    for (int pass = 0; pass < 2; pass++)
        while (n < most) {
            size_t worst = n_views;

            for (size_t i = 0; i < n_views; i++) {
                bool taken = isnan(view[i].q.psnr);

                for (size_t k = 0; k < n; k++)
                    taken = taken || out[k] == i ||
                            (pass == 0 && view[out[k]].camera == view[i].camera);
                if (!taken && (worst == n_views || view[i].q.psnr < view[worst].q.psnr))
                    worst = i;
            }
            if (worst == n_views)
                break;
            out[n++] = worst;
        }
    return n;
}
