/* Evaluation: draw every view, compare, average. */
#include "core/measure.h"

#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/log.h"
#include "base/mem.h"

spin_status spin_write_beside(const char *path, int width, int height, const float *const *picture,
                              int n)
{
    size_t w = (size_t)width, h = (size_t)height, gap = 4;
    size_t whole = w * (size_t)n + gap * (size_t)(n - 1);
    void *block = NULL;
    float *sheet;
    spin_status status;

    SPIN_TRY(spin_alloc(3 * whole * h, sizeof(float), &block));
    sheet = block;
    for (size_t i = 0; i < 3 * whole * h; i++)
        sheet[i] = 1.0f;
    for (size_t k = 0; k < (size_t)n; k++)
        for (size_t row = 0; row < 3 * h; row++)
            memcpy(sheet + row * whole + k * (w + gap), picture[k] + row * w, w * sizeof(float));
    status = spin_image_save(path, (int)whole, height, sheet);
    free(block);
    return status;
}

/* The source's picture of the same view, when there is a source to show. */
static spin_status draw_source(struct spin_measure *m, const struct spin_pair *pair, float **out)
{
    const struct spin_camera *c = &m->clip->views.view[pair->view].camera;
    void *block = NULL;

    *out = NULL;
    if (!m->source)
        return SPIN_OK;
    SPIN_TRY(spin_alloc(3 * (size_t)c->width * (size_t)c->height, sizeof(float), &block));
    *out = block;
    SPIN_TRY(spin_player_show(m->source, m->clip->frame[pair->frame]));
    return spin_player_draw(m->source, c, m->background, *out);
}

static spin_status save_view(struct spin_measure *m, const struct spin_pair *pair, int number,
                             const float *truth, const float *image)
{
    const struct spin_view *view = &m->clip->views.view[pair->view];
    const float *picture[3];
    char name[64];
    char *path = NULL;
    float *source = NULL;
    int n = 0;
    spin_status status;

    snprintf(name, sizeof name, "cam_%02d_frame_%05d.png", view->camera_id, number);
    SPIN_TRY_OUT(draw_source(m, pair, &source));
    SPIN_TRY_OUT(spin_path_join(m->images, name, &path));
    picture[n++] = truth;
    if (source)
        picture[n++] = source;
    picture[n++] = image;
    SPIN_TRY_OUT(spin_write_beside(path, view->camera.width, view->camera.height, picture, n));
out:
    free(source);
    free(path);
    return status;
}

static spin_status show(struct spin_measure *m, int frame)
{
    int index = m->clip->frame[frame];

    if (m->live_counts)
        return spin_player_show_live(m->player, frame, m->live_counts[frame],
                                     m->clip->bundle.meta.frame[index].time);
    return spin_player_show(m->player, index);
}

static spin_status measure_one(struct spin_measure *m, size_t i, float *image, float *truth,
                               struct spin_eval_view *out)
{
    const struct spin_pair *pair = &m->pairs[i];
    const struct spin_view *view = &m->clip->views.view[pair->view];
    const struct spin_camera *camera = &view->camera;
    double start = spin_now_s();

    if (i == 0 || m->pairs[i - 1].frame != pair->frame)
        SPIN_TRY(show(m, pair->frame));
    SPIN_TRY(spin_player_draw(m->player, camera, m->background, image));
    m->seconds += spin_now_s() - start;
    SPIN_TRY(spin_pixels_get(m->pixels, pair->view, truth));
    out->frame = m->clip->bundle.meta.frame[m->clip->frame[pair->frame]].number;
    out->camera = view->camera_id;
    SPIN_TRY(spin_player_compare(m->player, camera->width, camera->height, image, truth, out));
    if (m->images)
        SPIN_TRY(save_view(m, pair, out->frame, truth, image));
    return SPIN_OK;
}

static size_t largest_picture(const struct spin_measure *m)
{
    size_t most = 1;

    for (size_t i = 0; i < m->n_pairs; i++) {
        const struct spin_camera *c = &m->clip->views.view[m->pairs[i].view].camera;
        size_t pixels = (size_t)c->width * (size_t)c->height;

        most = pixels > most ? pixels : most;
    }
    return most;
}

spin_status spin_measure_run(struct spin_measure *m, struct spin_quality *mean)
{
    struct spin_progress progress;
    spin_status status;
    void *block = NULL;
    size_t values = 3 * largest_picture(m);

    memset(mean, 0, sizeof *mean);
    m->seconds = 0;
    spin_progress_begin(&progress, m->what, "views", 0, (long long)m->n_pairs);
    SPIN_TRY_OUT(spin_alloc(values, 2 * sizeof(float), &block));
    for (size_t i = 0; i < m->n_pairs; i++) {
        struct spin_eval_view one;

        if (spin_cancelled()) {
            status = spin_fail_cancelled();
            goto out;
        }
        SPIN_TRY_OUT(measure_one(m, i, block, (float *)block + values, &one));
        if (m->view)
            m->view[i] = one;
        mean->psnr += one.psnr / (double)m->n_pairs;
        mean->ssim += one.ssim / (double)m->n_pairs;
        mean->psnr_channel_mean += one.psnr_channel_mean / (double)m->n_pairs;
        spin_progress_set(&progress, (long long)i + 1, "%.2f dB", one.psnr);
    }
    mean->valid = m->n_pairs > 0;
    status = SPIN_OK;
out:
    spin_progress_end(&progress);
    free(block);
    return status;
}
