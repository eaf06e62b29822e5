/* Computes the loss, a combination of L1 and SSIM, in two passes over bands of rows (docs/method.md
 * 5). The first pass filters x, y, x^2 + y^2 and x y with the SSIM window, where x and y are the
 * two images, computes the SSIM map from the results, and stores the three partial derivatives of
 * this map. The second pass filters these derivatives, which gives the gradient of the image. The
 * bands depend only on the image size, and their sums are added in order, so the result does not
 * depend on the number of threads. */
#include <string.h>

#include "device/cpu/cpu.h"
#include "math/loss.h"

enum {
    BAND = 24, /* number of rows in a band */
    PART = 8,  /* number of rows of a band that are filtered at a time */
    HALF = SPIN_SSIM_HALF,
    TAPS = 2 * HALF + 1,
    RING = PART + 2 * HALF,
    /* Number of columns that are filtered at a time, so that all rows of the window stay in cache.
     */
    STRIP = 256,
    MAPS = 4, /* number of maps that the first pass filters; the second pass filters 3 */
    /* Number of zeros on each side of a row: a multiple of the vector size, for alignment. */
    PAD = 16,
    SUMS = 16 /* number of partial sums in which a row is added up */
};

static const float window[HALF + 1] = SPIN_SSIM_WINDOW;

struct job {
    int width, height, bands;
    size_t stride; /* number of floats in a padded row */
    const float *image, *truth, *pixel_weight;
    float *d_image;
    float *slope[3]; /* derivatives of the SSIM map, see struct spin_ssim_slope; each [3][h][w] */
    float *rows;     /* scratch of all workers, see struct band */
    size_t rows_floats; /* number of floats of `rows` for each worker */
    float scale_l1, scale_ssim;
    /* [3 * bands] sums of L1, SSIM and pixel weights (`mass`) over each band */
    double *l1, *ssim, *mass;
};

/* Applies the vertical window: sets to [w] to the sum of the rows from[0] to from[TAPS - 1],
 * weighted by the window. */
static void window_down(const float *const *from, int w, float *SPIN_RESTRICT to)
{
    const float *a5 = from[0], *a4 = from[1], *a3 = from[2], *a2 = from[3], *a1 = from[4];
    const float *b1 = from[6], *b2 = from[7], *b3 = from[8], *b4 = from[9], *b5 = from[10];
    const float *row = from[HALF];

    for (int x = 0; x < w; x++)
        to[x] = window[0] * row[x] + window[1] * (a1[x] + b1[x]) + window[2] * (a2[x] + b2[x]) +
                window[3] * (a3[x] + b3[x]) + window[4] * (a4[x] + b4[x]) +
                window[5] * (a5[x] + b5[x]);
}

/* Applies the horizontal window: returns the sum of the row's values around x, weighted by the
 * window. The row is padded with zeros. */
SPIN_FN float window_across(const float *row, int x)
{
    float sum = window[0] * row[x];

    for (int k = 1; k <= HALF; k++)
        sum += window[k] * (row[x - k] + row[x + k]);
    return sum;
}

/* Returns the sum of a row. SUMS partial sums are computed in float and then added in double. The
 * order of the additions does not depend on the SIMD width. */
static double sum_row(const float *row, int w)
{
    float part[SUMS] = {0};
    double sum = 0;
    int x = 0;

    for (; x + SUMS <= w; x += SUMS)
        for (int k = 0; k < SUMS; k++)
            part[k] += row[x + k];
    for (; x < w; x++)
        part[x % SUMS] += row[x];
    for (int k = 0; k < SUMS; k++)
        sum += part[k];
    return sum;
}

struct band {
    int first, last;           /* rows [first, last) of the band */
    const float *x, *y;        /* planes of this channel in the two images */
    size_t at;                 /* offset of the plane in [3][h][w] */
    float *padded[MAPS];       /* filtered maps of PART rows, padded with zeros */
    float *squares, *products; /* ring buffers of RING rows */
    float *line, *zeros;       /* scratch row, and a row of zeros */
};

static struct band band_of(const struct job *job, int task)
{
    int channel = task / job->bands;
    size_t plane = (size_t)job->width * (size_t)job->height;
    float *rows = job->rows + (size_t)spin_pool_worker() * job->rows_floats;
    struct band b;

    b.first = task % job->bands * BAND;
    b.last = b.first + BAND < job->height ? b.first + BAND : job->height;
    b.at = plane * (size_t)channel;
    b.x = job->image + b.at;
    b.y = job->truth + b.at;
    for (int m = 0; m < MAPS; m++)
        b.padded[m] = rows + (size_t)m * PART * job->stride + PAD;
    b.squares = rows + MAPS * PART * job->stride;
    b.products = b.squares + RING * job->stride;
    b.line = b.products + RING * job->stride;
    b.zeros = b.line + job->stride;
    memset(rows, 0, MAPS * PART * job->stride * sizeof *rows);
    memset(b.zeros, 0, job->stride * sizeof *b.zeros);
    return b;
}

/* Computes x^2 + y^2 and x y of a row and stores them in the ring buffers. */
static void multiply_row(const struct job *job, const struct band *b, int row)
{
    const float *SPIN_RESTRICT x = b->x + (size_t)row * (size_t)job->width;
    const float *SPIN_RESTRICT y = b->y + (size_t)row * (size_t)job->width;
    float *SPIN_RESTRICT squares = b->squares + (size_t)(row % RING) * job->stride;
    float *SPIN_RESTRICT products = b->products + (size_t)(row % RING) * job->stride;

    for (int i = 0; i < job->width; i++) {
        squares[i] = x[i] * x[i] + y[i] * y[i];
        products[i] = x[i] * y[i];
    }
}

static float *padded(const struct job *job, const struct band *b, int m, int in_part)
{
    return b->padded[m] + (size_t)in_part * job->stride;
}

/* Applies the vertical window to map m for up to PART rows from row `first` on. Row r of the input
 * is at from + r % n_rows * stride. */
static void window_part_down(const struct job *job, const struct band *b, int first, int m,
                             const float *from, int n_rows, size_t stride)
{
    int last = first + PART < b->last ? first + PART : b->last;

    for (int x = 0; x < job->width; x += STRIP)
        for (int row = first; row < last; row++) {
            const float *tap[TAPS];

            for (int k = 0; k < TAPS; k++) {
                int r = row + k - HALF;
                bool inside = r >= 0 && r < job->height;
                tap[k] = inside ? from + (size_t)(r % n_rows) * stride + x : b->zeros;
            }
            window_down(tap, job->width - x < STRIP ? job->width - x : STRIP,
                        padded(job, b, m, row - first) + x);
        }
}

static void window_forward(const struct job *job, const struct band *b, int first)
{
    for (int r = first == b->first ? first - HALF : first + HALF; r < first + PART + HALF; r++)
        if (r >= 0 && r < job->height)
            multiply_row(job, b, r);
    window_part_down(job, b, first, 0, b->x, job->height, (size_t)job->width);
    window_part_down(job, b, first, 1, b->y, job->height, (size_t)job->width);
    window_part_down(job, b, first, 2, b->squares, RING, job->stride);
    window_part_down(job, b, first, 3, b->products, RING, job->stride);
}

/* Sets map [w] to the SSIM computed from the filtered rows p0 to p3, and d_mu, d_xx and d_xy [w] to
 * the partial derivatives of the SSIM. This is a separate function so that the compiler can rely on
 * arrays that do not overlap, and vectorises the loop. */
static __attribute__((noinline)) void
ssim_row(int w, const float *SPIN_RESTRICT p0, const float *SPIN_RESTRICT p1,
         const float *SPIN_RESTRICT p2, const float *SPIN_RESTRICT p3, float *SPIN_RESTRICT map,
         float *SPIN_RESTRICT d_mu, float *SPIN_RESTRICT d_xx, float *SPIN_RESTRICT d_xy)
{
    for (int x = 0; x < w; x++) {
        struct spin_ssim_slope slope;
        map[x] = spin_ssim(window_across(p0, x), window_across(p1, x), window_across(p2, x),
                           window_across(p3, x), &slope);
        d_mu[x] = slope.d_mu;
        d_xx[x] = slope.d_xx;
        d_xy[x] = slope.d_xy;
    }
}

static void weight_row(int w, const float *SPIN_RESTRICT weight, float *SPIN_RESTRICT row)
{
    for (int x = 0; x < w; x++)
        row[x] *= weight[x];
}

static void forward_task(void *context, int task)
{
    const struct job *job = context;
    struct band b = band_of(job, task);
    float *line = b.line;
    double l1 = 0, ssim = 0, mass = 0;

    for (int row = b.first; row < b.last; row++) {
        int in_part = (row - b.first) % PART;
        const float *x = b.x + (size_t)row * (size_t)job->width;
        const float *y = b.y + (size_t)row * (size_t)job->width;
        size_t at = b.at + (size_t)row * (size_t)job->width;
        const float *weight =
            job->pixel_weight ? job->pixel_weight + (size_t)row * (size_t)job->width : NULL;

        if (in_part == 0)
            window_forward(job, &b, row);
        ssim_row(job->width, padded(job, &b, 0, in_part), padded(job, &b, 1, in_part),
                 padded(job, &b, 2, in_part), padded(job, &b, 3, in_part), line, job->slope[0] + at,
                 job->slope[1] + at, job->slope[2] + at);
        for (int m = 0; weight && m < 3; m++)
            weight_row(job->width, weight, job->slope[m] + at);
        if (weight)
            weight_row(job->width, weight, line);
        ssim += sum_row(line, job->width);
        for (int i = 0; i < job->width; i++)
            line[i] = fabsf(x[i] - y[i]);
        if (weight)
            weight_row(job->width, weight, line);
        l1 += sum_row(line, job->width);
        mass += weight ? sum_row(weight, job->width) : job->width;
    }
    job->l1[task] = l1;
    job->ssim[task] = ssim;
    job->mass[task] = mass;
}

static void backward_row(const struct job *job, const struct band *b, int row)
{
    int in_part = (row - b->first) % PART;
    const float *p0 = padded(job, b, 0, in_part), *p1 = padded(job, b, 1, in_part);
    const float *p2 = padded(job, b, 2, in_part);
    size_t in_plane = (size_t)row * (size_t)job->width;
    const float *SPIN_RESTRICT x = b->x + in_plane, *SPIN_RESTRICT y = b->y + in_plane;
    float *SPIN_RESTRICT d = job->d_image + b->at + in_plane;
    float *SPIN_RESTRICT l1 = b->line;

    for (int i = 0; i < job->width; i++)
        l1[i] = job->scale_l1;
    if (job->pixel_weight)
        weight_row(job->width, job->pixel_weight + in_plane, l1);
    for (int i = 0; i < job->width; i++) {
        float slope =
            window_across(p0, i) + 2 * x[i] * window_across(p1, i) + y[i] * window_across(p2, i);
        d[i] = l1[i] * spin_sign(x[i] - y[i]) + job->scale_ssim * slope;
    }
}

static void backward_task(void *context, int task)
{
    const struct job *job = context;
    struct band b = band_of(job, task);

    for (int row = b.first; row < b.last; row++) {
        for (int m = 0; m < 3 && (row - b.first) % PART == 0; m++)
            window_part_down(job, &b, row, m, job->slope[m] + b.at, job->height,
                             (size_t)job->width);
        backward_row(job, &b, row);
    }
}

static size_t round_up(size_t n) { return (n + 15) / 16 * 16; }

/* ---- Input images ---------------------------------------------------------------------------- */

struct photo {
    const uint8_t *rgb8, *mask, *matte;
    size_t plane;
    float weight[2];
    const float *f32, *change; /* `change`: change of the background where alpha is known */
    float *truth, *pixel_weight;
};

enum { PHOTO_CHUNK = 1 << 14 }; /* number of pixels in a chunk */

static void photo_task(void *context, size_t first, size_t last)
{
    const struct photo *p = context;

    for (size_t c = 0; p->rgb8 && c < 3; c++)
        for (size_t i = first; i < last; i++)
            p->truth[c * p->plane + i] = (float)p->rgb8[3 * i + c] / 255.0f;
    for (size_t c = 0; p->f32 && c < 3; c++)
        memcpy(p->truth + c * p->plane + first, p->f32 + c * p->plane + first,
               (last - first) * sizeof *p->truth);
    for (size_t c = 0; p->matte && c < 3; c++)
        for (size_t i = first; i < last; i++)
            p->truth[c * p->plane + i] += spin_matte_transmittance(p->matte[i]) * p->change[c];
    for (size_t i = first; p->pixel_weight && i < last; i++)
        p->pixel_weight[i] = p->weight[p->mask[i / 8] >> i % 8 & 1];
}

/* Provides the input image of a view as floats and, if `weights` is true, the weights of its
 * pixels. Sets *pixel_weight to NULL if all weights are 1. Returns false if out of memory. */
static bool load_photo(struct spin_device *d, const struct spin_view_of_batch *view,
                       const struct spin_images *images, bool weights, const float **truth,
                       const float **pixel_weight)
{
    size_t plane = (size_t)view->camera.width * (size_t)view->camera.height;
    size_t at = (size_t)view->image * 3 * images->max_pixels;
    struct photo p = {.plane = plane, .weight = {images->mask_weight[0], images->mask_weight[1]}};
    float *scratch = spin_cpu_scratch_need(d, SPIN_SCRATCH_TRUTH, 4 * plane * sizeof *scratch);

    if (!scratch)
        return false;
    p.truth = scratch;
    if (images->rgb8)
        p.rgb8 = images->rgb8 + at;
    if (images->mask && weights) {
        p.mask = images->mask + (size_t)view->image * ((images->max_pixels + 7) / 8);
        p.pixel_weight = scratch + 3 * plane;
    }
    if (view->matte) {
        p.matte = view->matte;
        p.change = view->background_change;
        p.f32 = images->rgb8 ? NULL : images->f32 + at;
    }
    if (p.rgb8 || p.mask || p.matte)
        spin_pool_rows(spin_cpu_pool(d), plane, PHOTO_CHUNK, photo_task, &p);
    *truth = p.rgb8 || p.matte ? p.truth : images->f32 + at;
    *pixel_weight = p.pixel_weight;
    return true;
}

/* ---- Verbs ----------------------------------------------------------------------------------- */

/* Computes the values of the loss of one view and, unless d_image is NULL, its gradient. */
static void compute_loss(struct spin_device *d, int width, int height, const float *image,
                         const float *truth, const float *pixel_weight, float lambda_dssim,
                         float weight, double values[SPIN_LOSS_VALUES], float *d_image)
{
    struct job job = {.width = width,
                      .height = height,
                      .image = image,
                      .truth = truth,
                      .pixel_weight = pixel_weight};
    size_t values_n = 3 * (size_t)width * (size_t)height, plane = round_up(values_n), sums;
    size_t workers = (size_t)spin_pool_n_threads(spin_cpu_pool(d));
    double l1 = 0, ssim = 0, mass = 0;
    float *scratch;

    job.bands = (height + BAND - 1) / BAND;
    job.stride = round_up((size_t)width) + 2 * PAD;
    job.rows_floats = (MAPS * PART + 2 * RING + 2) * job.stride;
    job.d_image = d_image;
    sums = round_up(3 * (size_t)job.bands);
    scratch = spin_cpu_scratch_need(d, SPIN_SCRATCH_LOSS,
                                    3 * sums * sizeof(double) +
                                        (3 * plane + workers * job.rows_floats) * sizeof(float));
    if (!scratch) {
        values[0] = values[1] = values[2] = 0;
        return;
    }
    job.l1 = (double *)scratch;
    job.ssim = job.l1 + sums;
    job.mass = job.ssim + sums;
    scratch = (float *)(job.mass + sums);
    for (int m = 0; m < 3; m++)
        job.slope[m] = scratch + (size_t)m * plane;
    job.rows = scratch + 3 * plane;

    spin_pool_run(spin_cpu_pool(d), 3 * job.bands, forward_task, &job);
    for (int i = 0; i < 3 * job.bands; i++) {
        l1 += job.l1[i];
        ssim += job.ssim[i];
        mass += job.mass[i];
    }
    values[1] = l1 / mass;
    values[2] = ssim / mass;
    job.scale_l1 = (1 - lambda_dssim) * weight / (float)mass;
    job.scale_ssim = -lambda_dssim * weight / (float)mass;
    values[0] = (1 - (double)lambda_dssim) * values[1] + (double)lambda_dssim * (1 - values[2]);
    if (d_image)
        spin_pool_run(spin_cpu_pool(d), 3 * job.bands, backward_task, &job);
}

void SPIN_CPU(loss)(struct spin_device *d, const struct spin_view_batch *views,
                    const struct spin_images *images, float lambda_dssim, const float *image,
                    double *values, float *d_image)
{
    SPIN_CPU_CLOCK(d, SPIN_OP_LOSS);

    for (int k = 0; k < views->n_views; k++) {
        const struct spin_view_of_batch *view = &views->view[k];
        const float *truth, *pixel_weight;

        if (!load_photo(d, view, images, true, &truth, &pixel_weight))
            return;
        compute_loss(d, view->camera.width, view->camera.height,
                     image + (size_t)k * 3 * views->max_pixels, truth, pixel_weight, lambda_dssim,
                     view->weight, values + (size_t)view->value * SPIN_LOSS_VALUES,
                     spin_cpu_picture(views, k, d_image));
    }
}

/* Sets sum[b] to the sum of squared differences over the pixels whose mask bit is b. */
static void sum_regions(size_t plane, const float *image, const float *truth, const uint8_t *mask,
                        double sum[2])
{
    sum[0] = sum[1] = 0;
    for (size_t c = 0; c < 3; c++)
        for (size_t i = 0; i < plane; i++) {
            double d = (double)(image[c * plane + i] - truth[c * plane + i]);

            sum[mask[i / 8] >> i % 8 & 1] += d * d;
        }
}

void SPIN_CPU(measure)(struct spin_device *d, const struct spin_view_batch *views,
                       const struct spin_images *images, float *image, double *values)
{
    for (int k = 0; k < views->n_views; k++) {
        const struct spin_view_of_batch *view = &views->view[k];
        size_t plane = (size_t)view->camera.width * (size_t)view->camera.height;
        size_t mask_at = (size_t)view->image * ((images->max_pixels + 7) / 8);
        double *v = values + (size_t)view->value * SPIN_MEASURE_VALUES, loss[SPIN_LOSS_VALUES];
        float *shown = spin_cpu_picture(views, k, image);
        const float *truth, *pixel_weight;

        if (!load_photo(d, view, images, false, &truth, &pixel_weight))
            return;
        for (size_t i = 0; i < 3 * plane; i++)
            shown[i] = fminf(fmaxf(shown[i], 0.0f), 1.0f);
        v[SPIN_MEASURE_SQUARES] = spin_squares(shown, truth, 3 * plane);
        for (size_t c = 0; c < 3; c++)
            v[SPIN_MEASURE_RED + c] = spin_squares(shown + c * plane, truth + c * plane, plane);
        compute_loss(d, view->camera.width, view->camera.height, shown, truth, NULL, 1.0f, 0.0f,
                     loss, NULL);
        v[SPIN_MEASURE_SSIM] = loss[SPIN_LOSS_SSIM];
        v[SPIN_MEASURE_OUTSIDE] = v[SPIN_MEASURE_SQUARES];
        v[SPIN_MEASURE_INSIDE] = 0;
        if (images->mask)
            sum_regions(plane, shown, truth, images->mask + mask_at, &v[SPIN_MEASURE_OUTSIDE]);
    }
}
