/* Renders all views, compares them with the ground truth, and averages the measures. */
#include "eval/metrics.h"

#include <math.h>

#include "base/base.h"
#include "io/image.h"
#include "io/ranks.h"
#include "math/loss.h"

spin_status spin_write_beside(const char *path, int width, int height, const float *const *picture,
                              int n)
{
    size_t w = (size_t)width, h = (size_t)height, gap = 4;
    size_t whole = w * (size_t)n + gap * (size_t)(n - 1);
    SPIN_FREED float *sheet = NULL;

    SPIN_TRY(spin_alloc(3 * whole * h, sizeof(float), (void **)&sheet));
    for (size_t i = 0; i < 3 * whole * h; i++)
        sheet[i] = 1.0f;
    for (size_t k = 0; k < (size_t)n; k++)
        for (size_t row = 0; row < 3 * h; row++)
            memcpy(sheet + row * whole + k * (w + gap), picture[k] + row * w, w * sizeof(float));
    return spin_image_save(path, (int)whole, height, sheet, false);
}

/* Renders the view from the source into *out, which the caller frees; sets *out to NULL if there is
 * no source. */
static spin_status draw_source(struct spin_metrics *m, const struct spin_pair *pair, float **out)
{
    const struct spin_camera *c = &m->clip->views.view[pair->view].camera;

    *out = NULL;
    if (!m->source)
        return SPIN_OK;
    SPIN_TRY(spin_alloc(3 * (size_t)c->width * (size_t)c->height, sizeof(float), (void **)out));
    SPIN_TRY(spin_player_show(m->source, m->clip->frame[pair->frame]));
    return spin_player_draw(m->source, c, m->background, *out);
}

static spin_status save_view(struct spin_metrics *m, const struct spin_pair *pair, int number,
                             const float *truth, const float *image)
{
    const struct spin_view *view = &m->clip->views.view[pair->view];
    const float *picture[3];
    char name[SPIN_IMAGE_NAME];
    SPIN_FREED char *path = NULL;
    SPIN_FREED float *source = NULL;
    int n = 0;

    spin_image_name(&m->clip->views, pair->view, number, NULL, name);
    SPIN_TRY(draw_source(m, pair, &source));
    SPIN_TRY(spin_path_join(m->images, name, &path));
    picture[n++] = truth;
    if (source)
        picture[n++] = source;
    picture[n++] = image;
    return spin_write_beside(path, view->camera.width, view->camera.height, picture, n);
}

static spin_status show_frame(struct spin_metrics *m, int frame)
{
    int index = m->clip->frame[frame];

    if (m->live_counts)
        return spin_player_show_live(m->player, frame, m->live_counts[frame]);
    return spin_player_show(m->player, index);
}

/* Computes the measures of a view from the sums v. plane: number of measured pixels. If `regions`
 * is true, also computes the PSNR inside and outside the dynamic regions, unless a region has too
 * few pixels for a meaningful value. */
static void set_quality(const double v[SPIN_MEASURE_VALUES], double plane, bool regions,
                        double n_dynamic, struct spin_quality *q)
{
    enum { FEWEST_PIXELS = 16 };

    *q = (struct spin_quality){.psnr_dynamic = NAN,
                               .psnr_static = NAN,
                               .dynamic = NAN,
                               .psnr_opposite = NAN,
                               .lpips = {NAN, NAN}};
    q->valid = true;
    q->psnr = spin_psnr(v[SPIN_MEASURE_SQUARES] / (3 * plane));
    for (int c = 0; c < 3; c++)
        q->psnr_channel_mean += spin_psnr(v[SPIN_MEASURE_RED + c] / plane);
    q->psnr_channel_mean /= 3;
    q->ssim = v[SPIN_MEASURE_SSIM];
    if (!regions)
        return;
    q->dynamic = n_dynamic / plane;
    if (n_dynamic >= FEWEST_PIXELS)
        q->psnr_dynamic = spin_psnr(v[SPIN_MEASURE_INSIDE] / (3 * n_dynamic));
    if (plane - n_dynamic >= FEWEST_PIXELS)
        q->psnr_static = spin_psnr(v[SPIN_MEASURE_OUTSIDE] / (3 * (plane - n_dynamic)));
}

/* Renders pair i on the device, and adds the times to m->seconds_decode and m->seconds_draw. */
static spin_status draw_one(struct spin_metrics *m, size_t i)
{
    const struct spin_pair *pair = &m->pairs[i];
    double start = spin_now_s();

    if (i == 0 || m->pairs[i - 1].frame != pair->frame) {
        SPIN_TRY(show_frame(m, pair->frame));
        SPIN_TRY(m->player->device->op->wait(m->player->device));
        m->seconds_decode += spin_now_s() - start;
        m->n_decoded++;
        start = spin_now_s();
    }
    SPIN_TRY(
        spin_player_draw(m->player, &m->clip->views.view[pair->view].camera, m->background, NULL));
    SPIN_TRY(m->player->device->op->wait(m->player->device));
    m->seconds_draw += spin_now_s() - start;
    return SPIN_OK;
}

/* Host memory for the images of a view. */
struct pictures {
    float *image, *truth; /* [3][h][w] rendered image, ground truth */
    uint8_t *rgb8, *mask; /* ground truth [h][w][3]; dynamic mask, one bit per pixel */
};

/* Announces the images of the next pairs of this rank, so that they are decoded while the current
 * pair is measured. */
static void announce_next(struct spin_metrics *m, size_t i)
{
    size_t left = spin_image_cache_ahead(m->pixels);

    for (i++; i < m->n_pairs && left > 0; i++)
        if (spin_metrics_rank(m->pairs[i].frame) == spin_rank()) {
            spin_image_cache_announce(m->pixels, m->pairs[i].view);
            left--;
        }
}

/* Loads the ground truth of a view and, if `regions` is true, its dynamic mask. */
static spin_status load_ground_truth(struct spin_metrics *m, size_t view, size_t plane,
                                     bool regions, struct pictures *p, size_t *n_dynamic)
{
    SPIN_TRY(spin_image_cache_get_rgb8(m->pixels, view, p->rgb8));
    spin_image_floats(p->rgb8, plane, p->truth);
    if (!regions)
        return SPIN_OK;
    SPIN_TRY(spin_dynamic_mask_find(m->dynamic, view, p->truth, n_dynamic));
    spin_dynamic_mask_bits(m->dynamic, plane, p->mask);
    return SPIN_OK;
}

/* ---- The subject only ------------------------------------------------------------------------ */

/* Returns the number of pixels of mask [h][w] after dilation by half the SSIM window. Pixels
 * outside the dilated mask have an SSIM of 1, since their windows contain only background. */
static size_t count_grown(const uint8_t *mask, int width, int height)
{
    size_t n = 0;

    for (int y = 0; y < height; y++)
        for (int x = 0; x < width; x++) {
            bool near = false;

            for (int v = y - SPIN_SSIM_HALF; v <= y + SPIN_SSIM_HALF && !near; v++)
                for (int u = x - SPIN_SSIM_HALF; u <= x + SPIN_SSIM_HALF && !near; u++)
                    near = v >= 0 && v < height && u >= 0 && u < width &&
                           mask[(size_t)v * (size_t)width + (size_t)u];
            n += near;
        }
    return n;
}

/* Measures the subject only: replaces all pixels outside the mask by the background, in ground
 * truth and rendered image, and averages errors over the pixels of the mask. */
static spin_status measure_subject(struct spin_metrics *m, const struct spin_camera *c, size_t view,
                                   struct pictures *p, struct spin_quality *q)
{
    size_t plane = (size_t)c->width * (size_t)c->height, n, n_grown;
    double v[SPIN_MEASURE_VALUES];

    SPIN_TRY(spin_dynamic_mask_find(m->subject, view, NULL, &n));
    SPIN_TRY(spin_player_image(m->player, p->image));
    for (size_t i = 0; i < plane; i++)
        for (size_t k = 0; k < 3 && !m->subject->mask[i]; k++) {
            float back = fminf(fmaxf(m->background[k], 0), 1);

            p->rgb8[3 * i + k] = (uint8_t)lrintf(255 * back);
            p->image[k * plane + i] = p->truth[k * plane + i] = p->rgb8[3 * i + k] / 255.0f;
        }
    spin_player_set_image(m->player, p->image);
    SPIN_TRY(spin_player_measure(m->player, p->rgb8, NULL, v));
    set_quality(v, (double)n, false, 0, q);
    q->valid = n > 0;
    if (n == 0)
        return SPIN_OK;
    n_grown = count_grown(m->subject->mask, c->width, c->height);
    q->ssim = 1 - (1 - v[SPIN_MEASURE_SSIM]) * (double)plane / (double)n_grown;
    return SPIN_OK;
}

/* The results of a view, which ranks exchange. */
struct measured {
    struct spin_eval_view view;
    struct spin_colour_sums sums;
};

/* Computes psnr_opposite without mattes: renders the view over the opposite background and compares
 * it with the unchanged ground truth. */
static spin_status measure_opposite(struct spin_metrics *m, const struct spin_camera *c,
                                    const uint8_t *rgb8, double *psnr)
{
    float background[3];
    double v[SPIN_MEASURE_VALUES];

    for (int k = 0; k < 3; k++)
        background[k] = 1 - m->background[k];
    SPIN_TRY(spin_player_draw(m->player, c, background, NULL));
    SPIN_TRY(spin_player_measure(m->player, rgb8, NULL, v));
    *psnr = spin_psnr(v[SPIN_MEASURE_SQUARES] / (3 * (double)c->width * (double)c->height));
    return SPIN_OK;
}

/* Computes psnr_opposite with mattes: at pixels of known alpha, renders the view over the opposite
 * background and compares it with the ground truth composited over the same background; at other
 * pixels, both images keep the background. */
static spin_status measure_alpha(struct spin_metrics *m, const struct spin_camera *c, size_t view,
                                 const struct pictures *p, double *psnr)
{
    size_t plane = (size_t)c->width * (size_t)c->height;
    SPIN_FREED uint8_t *matte = NULL;
    SPIN_FREED float *drawn = NULL;
    float background[3];
    double squares = 0;

    for (int k = 0; k < 3; k++)
        background[k] = 1 - m->background[k];
    SPIN_TRY(spin_alloc(plane, 1, (void **)&matte));
    SPIN_TRY(spin_alloc(plane, 3 * sizeof *drawn, (void **)&drawn));
    SPIN_TRY(spin_mattes_find(m->mattes, view, matte));
    SPIN_TRY(spin_player_draw(m->player, c, background, drawn));
    for (size_t i = 0; i < 3 * plane; i++) {
        size_t k = i / plane, at = i % plane;
        float truth =
            p->truth[i] + spin_matte_transmittance(matte[at]) * (background[k] - m->background[k]);
        double d = (double)((matte[at] ? fminf(fmaxf(drawn[i], 0), 1) : p->image[i]) - truth);

        squares += d * d;
    }
    *psnr = spin_psnr(squares / (3 * (double)plane));
    return SPIN_OK;
}

static spin_status measure_one(struct spin_metrics *m, size_t i, struct pictures *p,
                               struct measured *one)
{
    struct spin_eval_view *out = &one->view;
    const struct spin_pair *pair = &m->pairs[i];
    const struct spin_view *view = &m->clip->views.view[pair->view];
    size_t plane = (size_t)view->camera.width * (size_t)view->camera.height, n_dynamic = 0;
    bool regions = m->dynamic && m->dynamic->from != SPIN_DYNAMIC_OFF;
    double values[SPIN_MEASURE_VALUES];

    SPIN_TRY(draw_one(m, i));
    SPIN_TRY(load_ground_truth(m, pair->view, plane, regions, p, &n_dynamic));
    out->frame = m->clip->bundle.meta.frame[m->clip->frame[pair->frame]].number;
    out->camera = view->camera_id;
    if (m->subject) {
        SPIN_TRY(measure_subject(m, &view->camera, pair->view, p, &out->q));
    } else {
        SPIN_TRY(spin_player_measure(m->player, p->rgb8, regions ? p->mask : NULL, values));
        set_quality(values, (double)plane, regions, (double)n_dynamic, &out->q);
        SPIN_TRY(spin_player_image(m->player, p->image));
    }
    spin_colour_sums(view->camera_id, plane, p->image, p->truth, &one->sums);
    for (int k = 0; k < SPIN_N_LPIPS; k++)
        if (m->lpips[k] && out->q.valid)
            SPIN_TRY(spin_lpips_compare(m->lpips[k], view->camera.width, view->camera.height,
                                        p->image, p->truth, &out->q.lpips[k], NULL));
    if (m->images)
        SPIN_TRY(save_view(m, pair, out->frame, p->truth, p->image));
    if (m->opposite && m->mattes)
        SPIN_TRY(measure_alpha(m, &view->camera, pair->view, p, &out->q.psnr_opposite));
    else if (m->opposite)
        SPIN_TRY(measure_opposite(m, &view->camera, p->rgb8, &out->q.psnr_opposite));
    return SPIN_OK;
}

/* ---- Means ----------------------------------------------------------------------------------- */

static void add_one(double value, double *sum, size_t *n)
{
    if (isnan(value))
        return;
    *sum += value;
    ++*n;
}

void spin_quality_add(struct spin_quality_sum *s, const struct spin_quality *q)
{
    if (!q->valid)
        return;
    s->n++;
    s->sum.psnr += q->psnr;
    s->sum.ssim += q->ssim;
    s->sum.psnr_channel_mean += q->psnr_channel_mean;
    s->sum.psnr_colour_fitted += q->psnr_colour_fitted;
    add_one(q->psnr_dynamic, &s->sum.psnr_dynamic, &s->n_dynamic);
    add_one(q->psnr_static, &s->sum.psnr_static, &s->n_still);
    add_one(q->dynamic, &s->sum.dynamic, &s->n_share);
    add_one(q->psnr_opposite, &s->sum.psnr_opposite, &s->n_opposite);
    for (int i = 0; i < SPIN_N_LPIPS; i++)
        add_one(q->lpips[i], &s->sum.lpips[i], &s->n_lpips[i]);
}

static double mean_of(double sum, size_t n) { return n ? sum / (double)n : NAN; }

struct spin_quality spin_quality_mean(const struct spin_quality_sum *s)
{
    struct spin_quality mean = {
        .valid = s->n > 0,
        .psnr = mean_of(s->sum.psnr, s->n),
        .ssim = mean_of(s->sum.ssim, s->n),
        .psnr_channel_mean = mean_of(s->sum.psnr_channel_mean, s->n),
        .psnr_colour_fitted = mean_of(s->sum.psnr_colour_fitted, s->n),
        .psnr_dynamic = mean_of(s->sum.psnr_dynamic, s->n_dynamic),
        .psnr_static = mean_of(s->sum.psnr_static, s->n_still),
        .dynamic = mean_of(s->sum.dynamic, s->n_share),
        .psnr_opposite = mean_of(s->sum.psnr_opposite, s->n_opposite),
    };

    for (int i = 0; i < SPIN_N_LPIPS; i++)
        mean.lpips[i] = mean_of(s->sum.lpips[i], s->n_lpips[i]);
    return mean;
}

struct spin_quality spin_eval_mean(const struct spin_eval_report *r, const int *frame,
                                   const int *camera)
{
    struct spin_quality_sum sum = {0};

    for (size_t i = 0; i < r->n_views; i++)
        if ((!frame || r->view[i].frame == *frame) && (!camera || r->view[i].camera == *camera))
            spin_quality_add(&sum, &r->view[i].q);
    return spin_quality_mean(&sum);
}

/* ---- All views ------------------------------------------------------------------------------- */

int spin_metrics_rank(int frame) { return frame % spin_n_ranks(); }

/* Distributes the results of each rank to view [n_pairs] of all ranks, and adds up the times of all
 * ranks. */
static spin_status merge_views(struct spin_metrics *m, struct measured *view)
{
    SPIN_FREED struct times {
        double decode, draw;
        int n;
    } *times = NULL;
    SPIN_FREED int *owner = NULL;

    if (spin_n_ranks() == 1)
        return SPIN_OK;
    SPIN_TRY(spin_alloc(m->n_pairs, sizeof *owner, (void **)&owner));
    for (size_t i = 0; i < m->n_pairs; i++)
        owner[i] = spin_metrics_rank(m->pairs[i].frame);
    SPIN_TRY(spin_ranks_merge(view, m->n_pairs, sizeof *view, owner));
    SPIN_TRY(spin_alloc((size_t)spin_n_ranks(), sizeof *times, (void **)&times));
    times[spin_rank()] = (struct times){m->seconds_decode, m->seconds_draw, m->n_decoded};
    SPIN_TRY(spin_ranks_gather(times, sizeof *times));
    m->seconds_decode = m->seconds_draw = m->n_decoded = 0;
    for (int r = 0; r < spin_n_ranks(); r++) {
        m->seconds_decode += times[r].decode;
        m->seconds_draw += times[r].draw;
        m->n_decoded += times[r].n;
    }
    return SPIN_OK;
}

/* Sets psnr_colour_fitted of all views. If only the subject was measured, sets it to NaN, since the
 * fit would include the background around the subject. */
static spin_status add_fitted(struct measured *view, size_t n, bool subject)
{
    SPIN_FREED struct spin_colour_sums *sums = NULL;
    SPIN_FREED double *psnr = NULL;

    SPIN_TRY(spin_alloc(n, sizeof *sums, (void **)&sums));
    SPIN_TRY(spin_alloc(n, sizeof *psnr, (void **)&psnr));
    for (size_t i = 0; i < n; i++)
        sums[i] = view[i].sums;
    spin_colour_fit(sums, n, psnr);
    for (size_t i = 0; i < n; i++)
        view[i].view.q.psnr_colour_fitted = subject ? NAN : psnr[i];
    return SPIN_OK;
}

spin_status spin_metrics_run(struct spin_metrics *m, struct spin_quality *mean)
{
    struct spin_quality_sum sum = {0};
    struct spin_progress progress;
    spin_status status;
    size_t pixels = spin_views_pixels(&m->clip->views);
    SPIN_FREED struct measured *view = NULL;
    struct pictures p = {0};
    long long done = 0, n_own = 0;

    memset(mean, 0, sizeof *mean);
    m->seconds_decode = m->seconds_draw = 0;
    m->n_decoded = 0;
    for (size_t i = 0; i < m->n_pairs; i++)
        n_own += spin_metrics_rank(m->pairs[i].frame) == spin_rank();
    spin_progress_begin(&progress, m->what, "views", 0, n_own);
    SPIN_TRY_OUT(spin_alloc(pixels, 6 * sizeof(float) + 4, (void **)&p.image));
    p.truth = p.image + 3 * pixels;
    p.rgb8 = (uint8_t *)(p.truth + 3 * pixels);
    p.mask = p.rgb8 + 3 * pixels;
    SPIN_TRY_OUT(spin_alloc(m->n_pairs, sizeof *view, (void **)&view));
    status = SPIN_OK;
    for (size_t i = 0; i < m->n_pairs && status == SPIN_OK; i++) {
        if (spin_metrics_rank(m->pairs[i].frame) != spin_rank())
            continue;
        announce_next(m, i);
        status = spin_cancelled() ? spin_fail_cancelled() : measure_one(m, i, &p, &view[i]);
        spin_progress_set(&progress, ++done, "%.2f dB", view[i].view.q.psnr);
    }
    SPIN_TRY_OUT(spin_ranks_agree(status));
    SPIN_TRY_OUT(merge_views(m, view));
    SPIN_TRY_OUT(add_fitted(view, m->n_pairs, m->subject != NULL));
    for (size_t i = 0; i < m->n_pairs; i++) {
        spin_quality_add(&sum, &view[i].view.q);
        if (m->view)
            m->view[i] = view[i].view;
    }
    *mean = spin_quality_mean(&sum);
    status = SPIN_OK;
out:
    spin_progress_end(&progress);
    free(p.image);
    return status;
}

/* ---- Photometric fit ------------------------------------------------------------------------- */

/* Least-squares fits of a gain and an offset per camera and channel. */

void spin_colour_sums(int camera, size_t plane, const float *image, const float *truth,
                      struct spin_colour_sums *out)
{
    *out = (struct spin_colour_sums){.camera = camera, .n = (double)plane};
    for (size_t c = 0; c < 3; c++)
        for (size_t i = c * plane; i < (c + 1) * plane; i++) {
            double x = fmin(fmax((double)image[i], 0), 1), y = (double)truth[i];

            out->of[c].x += x;
            out->of[c].y += y;
            out->of[c].xx += x * x;
            out->of[c].xy += x * y;
            out->of[c].yy += y * y;
        }
}

/* Fits ground truth = gain * rendered image + offset in channel c over all views of a camera. The
 * gain is 0 if all pixels of the rendered images have the same value. */
static void fit_channel(const struct spin_colour_sums *view, size_t n_views, int camera, int c,
                        double *gain, double *offset)
{
    double n = 0, x = 0, y = 0, xx = 0, xy = 0, spread;

    for (size_t i = 0; i < n_views; i++)
        if (view[i].camera == camera) {
            n += view[i].n;
            x += view[i].of[c].x;
            y += view[i].of[c].y;
            xx += view[i].of[c].xx;
            xy += view[i].of[c].xy;
        }
    spread = xx - x * x / n;
    *gain = spread > 1e-9 * n ? (xy - x * y / n) / spread : 0;
    *offset = (y - *gain * x) / n;
}

static void fit_camera(const struct spin_colour_sums *view, size_t n_views, int camera,
                       double *psnr)
{
    double a[3], b[3];

    for (int c = 0; c < 3; c++)
        fit_channel(view, n_views, camera, c, &a[c], &b[c]);
    for (size_t i = 0; i < n_views; i++) {
        const struct spin_colour_sums *v = &view[i];
        double squares = 0;

        if (v->camera != camera)
            continue;
        for (int c = 0; c < 3; c++)
            squares += a[c] * a[c] * v->of[c].xx + v->n * b[c] * b[c] + v->of[c].yy +
                       2 * (a[c] * b[c] * v->of[c].x - a[c] * v->of[c].xy - b[c] * v->of[c].y);
        psnr[i] = spin_psnr(fmax(squares, 0) / (3 * v->n));
    }
}

void spin_colour_fit(const struct spin_colour_sums *view, size_t n_views, double *psnr)
{
    for (size_t i = 0; i < n_views; i++) {
        bool done = false;

        for (size_t k = 0; k < i && !done; k++)
            done = view[k].camera == view[i].camera;
        if (!done)
            fit_camera(view, n_views, view[i].camera, psnr);
    }
}
