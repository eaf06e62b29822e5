/* Linear least squares on logarithms of colour values. The unknowns are a log colour for each
 * point, which is eliminated by subtracting the weighted mean of the point's samples; a log gain
 * for each camera; and two coefficients a and b for each lens, where a r^2 + b r^4 approximates the
 * log falloff, log(1 + c1 r^2 + c2 r^4). Conjugate gradients solve the normal equations. The fit is
 * repeated a few times, with lower weights for samples with large residuals.
 *
 * The fit attributes all differences between views to gains and falloffs, even those with other
 * causes: view-dependent light, smoke, points at the wrong depth. It is therefore accepted only if
 * a fit to one half of the scene predicts the samples of the other half. */
#include "train/photometric_fit.h"

#include "base/base.h"
#include "math/exposure.h"
#include "train/train_frame.h"

enum { ROUNDS = 6, STEPS = 100, GRID = 64 };
/* Residual, a difference of logarithms, at which a sample has the weight 1/2. */
static const double outlier = 0.05;

/* A falloff is accepted under three conditions. First, the standard deviation of r^2 over the
 * samples of its lens, after subtracting the means of points and of cameras, is at least this
 * value. */
static const double least_deviation = 0.1;
/* Second condition for a falloff: from the image centre to the corner, it stays between `darkest`
 * and `brightest`, and beyond its minimum it rises by at most most_rise. */
static const double darkest = 0.3, brightest = 1.05, most_rise = 0.02;
/* Third condition for a falloff, and first condition for gains: the loss of held-out points is
 * lower with the falloff or gains than without, by more than this many standard errors of the mean
 * difference. */
static const double least_errors = 3;
/* Second condition for gains: they reduce the loss of held-out points by at least this share. Even
 * if views differ for other reasons, such as smoke, some gains reduce this loss slightly. */
static const double least_explained = 0.05;

struct fit {
    const struct spin_photometric_sample *sample;
    size_t n, n_unknown;
    int n_cameras, n_lenses;
    const bool *falls;             /* [lenses] true if the falloff of the lens is fitted */
    double *y, *weight, *residual; /* [n] log value, weight and residual of each sample */
    /* [n_unknown] x: solution; r, p, q: vectors of the conjugate gradients. */
    double *x, *r, *p, *q;
};

static double *lens_of(const struct fit *f, double *x, size_t i)
{
    return x + f->n_cameras + 2 * f->sample[i].lens;
}

static void close_fit(struct fit *f) { free(f->y); }

static double r2_of(const struct fit *f, size_t i)
{
    return f->falls[f->sample[i].lens] ? (double)f->sample[i].r2 : 0;
}

/* Returns the predicted log value of sample i for the unknowns x, minus the log colour of its
 * point. */
static double value_of(const struct fit *f, double *x, size_t i)
{
    double r2 = r2_of(f, i), *lens = lens_of(f, x, i);

    return x[f->sample[i].camera] + r2 * (lens[0] + r2 * lens[1]);
}

static size_t end_of_point(const struct fit *f, size_t i)
{
    size_t end = i;

    while (end < f->n && f->sample[end].point == f->sample[i].point)
        end++;
    return end;
}

/* Subtracts from each value of v [n] the weighted mean of the values of all samples of the same
 * point. */
static void subtract_point_means(const struct fit *f, double *v)
{
    for (size_t i = 0, end; i < f->n; i = end) {
        double sum = 0, weights = 0;

        end = end_of_point(f, i);
        for (size_t k = i; k < end; k++) {
            sum += f->weight[k] * v[k];
            weights += f->weight[k];
        }
        for (size_t k = i; k < end; k++)
            v[k] -= sum / weights;
    }
}

/* out [n_unknown] = J^T W v, with the Jacobian J of the predictions by the unknowns, the diagonal
 * matrix W of the weights, and v [n]. */
static void multiply_transposed(const struct fit *f, const double *v, double *out)
{
    memset(out, 0, f->n_unknown * sizeof *out);
    for (size_t i = 0; i < f->n; i++) {
        double r2 = r2_of(f, i), d = f->weight[i] * v[i], *lens = lens_of(f, out, i);

        out[f->sample[i].camera] += d;
        lens[0] += d * r2;
        lens[1] += d * r2 * r2;
    }
}

/* out [n_unknown] = A x, with the matrix A of the normal equations and x [n_unknown]. */
static void multiply_normal(const struct fit *f, double *x, double *out)
{
    for (size_t i = 0; i < f->n; i++)
        f->residual[i] = value_of(f, x, i);
    subtract_point_means(f, f->residual);
    multiply_transposed(f, f->residual, out);
}

static double dot(const struct fit *f, const double *a, const double *b)
{
    double sum = 0;

    for (size_t i = 0; i < f->n_unknown; i++)
        sum += a[i] * b[i];
    return sum;
}

/* Solves the normal equations for f->x by conjugate gradients. The initial x is 0, so unknowns
 * without samples remain 0. */
static void solve_normal(struct fit *f)
{
    double squares, before, first;

    memcpy(f->residual, f->y, f->n * sizeof *f->y);
    subtract_point_means(f, f->residual);
    multiply_transposed(f, f->residual, f->r);
    memset(f->x, 0, f->n_unknown * sizeof *f->x);
    memcpy(f->p, f->r, f->n_unknown * sizeof *f->p);
    squares = first = dot(f, f->r, f->r);
    for (int step = 0; step < STEPS && squares > 1e-20 * first; step++) {
        double length;

        multiply_normal(f, f->p, f->q);
        length = squares / dot(f, f->p, f->q);
        before = squares;
        for (size_t i = 0; i < f->n_unknown; i++) {
            f->x[i] += length * f->p[i];
            f->r[i] -= length * f->q[i];
        }
        squares = dot(f, f->r, f->r);
        for (size_t i = 0; i < f->n_unknown; i++)
            f->p[i] = f->r[i] + squares / before * f->p[i];
    }
}

static void update_weights(struct fit *f)
{
    for (size_t i = 0; i < f->n; i++)
        f->residual[i] = f->y[i] - value_of(f, f->x, i);
    subtract_point_means(f, f->residual);
    for (size_t i = 0; i < f->n; i++) {
        double off = f->residual[i] / outlier;

        f->weight[i] = 1 / (1 + off * off);
    }
}

/* Sets *c1 and *c2 so that 1 + c1 r^2 + c2 r^4 approximates exp(a r^2 + b r^4), where a and b are
 * ab[0] and ab[1], for r^2 from 0 to `most`. */
static void fit_polynomial(const double ab[2], double most, float *c1, float *c2)
{
    double xx = 0, xxx = 0, xxxx = 0, xy = 0, xxy = 0, det;

    for (int i = 1; i <= GRID; i++) {
        double x = most * i / GRID, y = exp(x * (ab[0] + x * ab[1])) - 1;

        xx += x * x;
        xxx += x * x * x;
        xxxx += x * x * x * x;
        xy += x * y;
        xxy += x * x * y;
    }
    det = xx * xxxx - xxx * xxx;
    *c1 = det > 0 ? (float)((xy * xxxx - xxy * xxx) / det) : 0;
    *c2 = det > 0 ? (float)((xxy * xx - xy * xxx) / det) : 0;
}

static double most_r2(const struct fit *f, int lens)
{
    double most = 0;

    for (size_t i = 0; i < f->n; i++)
        if (f->sample[i].lens == lens)
            most = fmax(most, (double)f->sample[i].r2);
    return most;
}

static void store_channel(const struct fit *f, int rgb, float *exposure)
{
    double mean = 0;

    for (int k = 0; k < f->n_cameras; k++)
        mean += f->x[k] / f->n_cameras;
    for (int k = 0; k < f->n_cameras; k++)
        exposure[6 * k + rgb] = f->x[k] != 0 ? (float)(f->x[k] - mean) : 0;
    exposure += 6 * f->n_cameras;
    for (int k = 0; k < f->n_lenses; k++)
        fit_polynomial(f->x + f->n_cameras + 2 * k, most_r2(f, k), &exposure[6 * k + rgb],
                       &exposure[6 * k + 3 + rgb]);
}

/* Allocates the arrays of a fit. The caller must call close_fit(), also after a failure. */
static spin_status open_fit(struct fit *f, const struct spin_photometric_sample *sample, size_t n,
                            int n_cameras, int n_lenses, const bool *falls)
{
    *f = (struct fit){.sample = sample,
                      .n = n,
                      .n_unknown = (size_t)(n_cameras + 2 * n_lenses),
                      .n_cameras = n_cameras,
                      .n_lenses = n_lenses,
                      .falls = falls};
    SPIN_TRY(spin_alloc(3 * n + 4 * f->n_unknown + 1, sizeof(double), (void **)&f->y));
    f->weight = f->y + n;
    f->residual = f->weight + n;
    f->x = f->residual + n;
    f->r = f->x + f->n_unknown;
    f->p = f->r + f->n_unknown;
    f->q = f->p + f->n_unknown;
    return SPIN_OK;
}

static void start_channel(struct fit *f, int rgb)
{
    for (size_t i = 0; i < f->n; i++) {
        f->y[i] = log((double)f->sample[i].value[rgb]);
        f->weight[i] = 1;
    }
}

static void fit_channel(struct fit *f, int rgb)
{
    start_channel(f, rgb);
    for (int round = 0; round < ROUNDS; round++) {
        solve_normal(f);
        update_weights(f);
    }
}

static spin_status fit_gains_and_falloffs(const struct spin_photometric_sample *sample, size_t n,
                                          int n_cameras, int n_lenses, const bool *falls,
                                          float *exposure)
{
    SPIN_LEAVES(close_fit) struct fit f = {0};

    memset(exposure, 0, (size_t)(n_cameras + n_lenses) * 6 * sizeof *exposure);
    SPIN_TRY(open_fit(&f, sample, n, n_cameras, n_lenses, falls));
    for (int rgb = 0; rgb < 3; rgb++) {
        fit_channel(&f, rgb);
        store_channel(&f, rgb, exposure);
    }
    return SPIN_OK;
}

/* ---- Accepting a fit ------------------------------------------------------------------------- */

/* Returns the standard deviation of r^2 over the samples of a lens, after subtracting the means of
 * points and of cameras. camera: scratch for two values per camera. */
static double deviation_of(struct fit *f, int lens, double *camera)
{
    double *v = f->residual, squares = 0;
    size_t n = 0;

    for (size_t i = 0; i < f->n; i++) {
        v[i] = f->sample[i].lens == lens ? (double)f->sample[i].r2 : 0;
        f->weight[i] = 1;
    }
    for (int round = 0; round < ROUNDS; round++) {
        subtract_point_means(f, v);
        memset(camera, 0, 2 * (size_t)f->n_cameras * sizeof *camera);
        for (size_t i = 0; i < f->n; i++) {
            camera[2 * f->sample[i].camera] += v[i];
            camera[2 * f->sample[i].camera + 1]++;
        }
        for (size_t i = 0; i < f->n; i++)
            v[i] -= camera[2 * f->sample[i].camera] / camera[2 * f->sample[i].camera + 1];
    }
    for (size_t i = 0; i < f->n; i++)
        if (f->sample[i].lens == lens) {
            squares += v[i] * v[i];
            n++;
        }
    return n ? sqrt(squares / (double)n) : 0;
}

/* Checks the second condition for a falloff, see `darkest`. corner: r^2 at the image corner. */
static bool is_plausible(const float *falloff, double corner)
{
    for (int rgb = 0; rgb < 3; rgb++) {
        double least = 1;

        for (int i = 0; i <= GRID; i++) {
            double r2 = corner * i / GRID,
                   v = 1 + r2 * ((double)falloff[rgb] + r2 * (double)falloff[3 + rgb]);

            if (!(v >= darkest && v <= brightest && v <= least + most_rise))
                return false;
            least = fmin(least, v);
        }
    }
    return true;
}

/* loss [n] += the Cauchy loss of each sample of h in a channel, where x predicts the samples. x
 * contains unknowns that were fitted to other samples; x NULL means that all unknowns are 0. */
static void add_loss(struct fit *h, const double *x, int rgb, double *loss)
{
    start_channel(h, rgb);
    if (x)
        memcpy(h->x, x, h->n_unknown * sizeof *x);
    else
        memset(h->x, 0, h->n_unknown * sizeof *h->x);
    update_weights(h);
    /* The second call subtracts point means in which outliers have low weights. */
    update_weights(h);
    for (size_t i = 0; i < h->n; i++)
        loss[i] -= log(h->weight[i]);
}

/* loss [n] += the loss of each sample, summed over the channels. If `fits` is true, a fit to the
 * other half of the scene predicts the sample, otherwise gains and falloffs are 0. The samples of
 * half 0 come first; their number is `first`. falls [lenses]: the falloffs to fit. */
static spin_status add_held_out_loss(const struct spin_photometric_sample *sample, size_t n,
                                     size_t first, int n_cameras, int n_lenses, const bool *falls,
                                     bool fits, double *loss)
{
    for (int half = 0; half < 2; half++) {
        SPIN_LEAVES(close_fit) struct fit f = {0};
        SPIN_LEAVES(close_fit) struct fit h = {0};
        size_t at = half ? 0 : first, held = half ? first : 0;
        size_t n_fit = half ? first : n - first;

        SPIN_TRY(open_fit(&f, sample + at, n_fit, n_cameras, n_lenses, falls));
        SPIN_TRY(open_fit(&h, sample + held, n - n_fit, n_cameras, n_lenses, falls));
        for (int rgb = 0; rgb < 3; rgb++) {
            if (fits)
                fit_channel(&f, rgb);
            add_loss(&h, fits ? f.x : NULL, rgb, loss + held);
        }
    }
    return SPIN_OK;
}

static double sum_of(const double *v, size_t n)
{
    double sum = 0;

    for (size_t i = 0; i < n; i++)
        sum += v[i];
    return sum;
}

/* Returns by how many standard errors `loss` is below `other`: other - loss is summed over the
 * samples of each point, and the mean of these sums over all points is divided by its standard
 * error. */
static double errors_below(const struct spin_photometric_sample *sample, size_t n,
                           const double *loss, const double *other)
{
    double sum = 0, squares = 0, points = 0, mean;

    for (size_t i = 0, end; i < n; i = end) {
        double less = 0;

        for (end = i; end < n && sample[end].point == sample[i].point; end++)
            less += other[end] - loss[end];
        sum += less;
        squares += less * less;
        points++;
    }
    mean = sum / points;
    return mean / sqrt((squares / points - mean * mean) / points);
}

/* Copies the samples of half 0 to `out`, followed by the samples of half 1. Returns the number of
 * samples of half 0. */
static size_t split_halves(const struct spin_photometric_sample *sample, size_t n,
                           struct spin_photometric_sample *out)
{
    size_t k = 0, first = 0;

    for (int half = 0; half < 2; half++) {
        for (size_t i = 0; i < n; i++)
            if (sample[i].half == half)
                out[k++] = sample[i];
        first = half ? first : k;
    }
    return first;
}

/* Sets falls [lenses] to true for lenses whose samples determine the falloff (least_deviation).
 * Then fits gains and these falloffs, clears the entries of implausible falloffs (is_plausible()),
 * and repeats this until all fitted falloffs are plausible. *why: SPIN_PHOTOMETRIC_SEEN if any
 * falloff remains, otherwise the reason for rejection. */
static spin_status fit_sane(const struct spin_photometric_sample *sample, size_t n, int n_cameras,
                            int n_lenses, const double *corner, bool *falls, float *exposure,
                            enum spin_photometric_why *why)
{
    SPIN_LEAVES(close_fit) struct fit f = {0};
    SPIN_FREED double *camera = NULL;
    int left = 0;

    SPIN_TRY(open_fit(&f, sample, n, n_cameras, n_lenses, falls));
    SPIN_TRY(spin_alloc((size_t)n_cameras, 2 * sizeof *camera, (void **)&camera));
    for (int k = 0; k < n_lenses; k++) {
        falls[k] = deviation_of(&f, k, camera) >= least_deviation;
        left += falls[k];
    }
    *why = left ? SPIN_PHOTOMETRIC_SEEN : SPIN_PHOTOMETRIC_SAME_RADII;
    for (int before = left + 1; left > 0 && left < before;) {
        SPIN_TRY(fit_gains_and_falloffs(sample, n, n_cameras, n_lenses, falls, exposure));
        before = left;
        for (int k = 0; k < n_lenses; k++)
            if (falls[k] && !is_plausible(exposure + 6 * (n_cameras + k), corner[k])) {
                falls[k] = false;
                left--;
                *why = left ? SPIN_PHOTOMETRIC_SEEN : SPIN_PHOTOMETRIC_ODD;
            }
    }
    return SPIN_OK;
}

spin_status spin_photometric_choose(const struct spin_photometric_sample *sample, size_t n,
                                    int n_cameras, int n_lenses, const double *corner,
                                    float *exposure, struct spin_photometric_result *result)
{
    SPIN_FREED struct spin_photometric_sample *parted = NULL;
    SPIN_FREED double *nothing = NULL;
    /* [2 lenses]: the first half is true for lenses whose falloff is fitted; the second half,
     * `none`, is false for all lenses. */
    SPIN_FREED bool *falls = NULL;
    const bool *none;
    double *gains, *falloff;
    size_t first;

    SPIN_TRY(spin_alloc(n + 1, sizeof *parted, (void **)&parted));
    SPIN_TRY(spin_alloc(3 * n + 1, sizeof *nothing, (void **)&nothing));
    SPIN_TRY(spin_alloc(2 * (size_t)n_lenses + 1, sizeof *falls, (void **)&falls));
    none = falls + n_lenses;
    gains = nothing + n;
    falloff = gains + n;
    first = split_halves(sample, n, parted);
    SPIN_TRY(add_held_out_loss(parted, n, first, n_cameras, n_lenses, none, false, nothing));
    SPIN_TRY(add_held_out_loss(parted, n, first, n_cameras, n_lenses, none, true, gains));
    result->gains = errors_below(parted, n, gains, nothing) > least_errors &&
                            sum_of(gains, n) < (1 - least_explained) * sum_of(nothing, n)
                        ? SPIN_PHOTOMETRIC_SEEN
                        : SPIN_PHOTOMETRIC_NOT_HELD_OUT;
    SPIN_TRY(fit_sane(sample, n, n_cameras, n_lenses, corner, falls, exposure, &result->falloff));
    if (result->falloff == SPIN_PHOTOMETRIC_SEEN) {
        SPIN_TRY(add_held_out_loss(parted, n, first, n_cameras, n_lenses, falls, true, falloff));
        if (!(errors_below(parted, n, falloff, gains) > least_errors &&
              errors_below(parted, n, falloff, nothing) > 0))
            result->falloff = SPIN_PHOTOMETRIC_NOT_HELD_OUT;
    }
    if (result->falloff == SPIN_PHOTOMETRIC_SEEN)
        return SPIN_OK;
    if (result->gains == SPIN_PHOTOMETRIC_SEEN)
        return fit_gains_and_falloffs(sample, n, n_cameras, n_lenses, none, exposure);
    memset(exposure, 0, (size_t)(n_cameras + n_lenses) * 6 * sizeof *exposure);
    return SPIN_OK;
}

/* ---- Samples of the training views ----------------------------------------------------------- */

/* Points of a few frames are projected into the training views, and the image colours at these
 * pixels are compared. A coarse depth map of the nearest points of each view detects occluded
 * points, which are ignored. Since the map misses some occlusions, results are medians, which are
 * robust against a few wrong colours. */

enum {
    FRAMES = 3,    /* largest number of frames whose points are compared */
    POINTS = 4096, /* largest number of points of a frame whose colours are compared */
    CELLS = 64,    /* cells of the depth map along each axis */
    /* A point is used for the spread if it is visible to at least this many cameras. */
    LEAST_CAMERAS = 3,
    /* A camera is used for the spread if at least this many of these points are visible to it. */
    LEAST_POINTS = 32,
    /* A point is used for the fit if it is visible to at least this many cameras. */
    FIT_CAMERAS = 3,
    /* Gains and falloffs are fitted if at least this many points are used for the fit. */
    FIT_POINTS = 200
};
/* Only colour values in this range are used for the fit: darker ones are noisy, brighter ones may
 * be clipped. */
static const float least_colour = 0.1f, most_colour = 0.95f;
/* Edge length of the cubes into which half_of() divides the scene, relative to the radius of the
 * ball that contains most points. */
static const double region = 0.5;
/* A point is occluded if its depth is more than `behind` times the smallest depth in its cell of
 * the depth map. */
static const double behind = 1.05;

struct colours {
    struct spin_plan *plan;
    struct spin_photos *photos;
    struct spin_splats splats; /* splats of the current frame */
    size_t step, n_points;     /* the compared points are every step-th splat of the frame */
    uint8_t *image;            /* [h][w][3] image of the current view */
    /* [points][cameras] samples of the current frame: the colour (red, green, blue, in 0..1), and
     * the squared distance of the pixel from the image centre (spin_lens_r2()). The colour is NaN
     * if the point is not visible. */
    float (*seen)[4];
    int *lens; /* [cameras] index of the lens of each camera */
    /* For each channel, [cameras][FRAMES * POINTS] deviations: colour of a point in a camera, 0..1,
     * minus the point's mean colour in all cameras. */
    float *difference[3];
    size_t *n;     /* [cameras] number of deviations of each camera */
    float ball[3]; /* centre of the ball that contains most points */
    double radius;
    struct spin_photometric_sample *sample;
    size_t n_samples, n_points_seen; /* n_points_seen: number of points that have samples */
    double nearest[CELLS][CELLS];
};

/* Projects a splat of the current frame: sets its pixel and depth. Returns false if the splat is
 * not visible to the camera. */
static bool project(const struct colours *c, const struct spin_camera *camera, size_t splat,
                    int pixel[2], double *depth)
{
    const float *mean = c->splats.means + 3 * splat;
    double p[3];

    if (!spin_camera_project_visible(camera, mean, p))
        return false;
    pixel[0] = (int)p[0];
    pixel[1] = (int)p[1];
    *depth = p[2];
    return true;
}

static double *cell_of(struct colours *c, const struct spin_camera *camera, const int pixel[2])
{
    return &c->nearest[(size_t)pixel[1] * CELLS / (size_t)camera->height]
                      [(size_t)pixel[0] * CELLS / (size_t)camera->width];
}

static void map_nearest(struct colours *c, const struct spin_camera *camera)
{
    double depth, *cell;
    int pixel[2];

    for (size_t i = 0; i < (size_t)CELLS * CELLS; i++)
        c->nearest[i / CELLS][i % CELLS] = INFINITY;
    for (size_t i = 0; i < c->splats.n; i++)
        if (project(c, camera, i, pixel, &depth)) {
            cell = cell_of(c, camera, pixel);
            *cell = fmin(*cell, depth);
        }
}

/* Samples the colours of the current frame's points in a view, into c->seen. */
static spin_status sample_view(struct colours *c, size_t view)
{
    const struct spin_view *v = &c->plan->clip.views.view[view];
    size_t k = (size_t)spin_plan_camera(c->plan, v->camera_id), n = (size_t)c->plan->n_cameras;

    SPIN_TRY(spin_image_cache_get_rgb8(&c->photos->cache, view, c->image));
    map_nearest(c, &v->camera);
    c->lens[k] = spin_lenses_find(&c->plan->lenses, &v->camera);
    for (size_t i = 0; i < c->n_points; i++) {
        double depth;
        int pixel[2];

        if (!project(c, &v->camera, i * c->step, pixel, &depth) ||
            depth > behind * *cell_of(c, &v->camera, pixel))
            continue;
        for (size_t rgb = 0; rgb < 3; rgb++)
            c->seen[i * n + k][rgb] =
                (float)
                    c->image[3 * ((size_t)pixel[1] * (size_t)v->camera.width + (size_t)pixel[0]) +
                             rgb] /
                255;
        c->seen[i * n + k][3] = spin_lens_r2(pixel[0], pixel[1], (float)v->camera.cx,
                                             (float)v->camera.cy, 0.5f * (float)v->camera.width);
    }
    return SPIN_OK;
}

/* For each point of the current frame, adds the deviations of all cameras to c->difference. */
static void add_deviations(struct colours *c)
{
    size_t n = (size_t)c->plan->n_cameras;

    for (size_t i = 0; i < c->n_points; i++) {
        const float(*seen)[4] = (const float(*)[4])c->seen + i * n;
        float mean[3] = {0};
        int cameras = 0;

        for (size_t k = 0; k < n; k++)
            if (!isnan(seen[k][0])) {
                cameras++;
                for (int rgb = 0; rgb < 3; rgb++)
                    mean[rgb] += seen[k][rgb];
            }
        for (size_t k = 0; k < n && cameras >= LEAST_CAMERAS; k++)
            if (!isnan(seen[k][0])) {
                for (int rgb = 0; rgb < 3; rgb++)
                    c->difference[rgb][k * FRAMES * POINTS + c->n[k]] =
                        seen[k][rgb] - mean[rgb] / (float)cameras;
                c->n[k]++;
            }
    }
}

static bool determines_gain(const float seen[4])
{
    bool tells = true;

    for (int rgb = 0; rgb < 3; rgb++)
        tells &= seen[rgb] > least_colour && seen[rgb] < most_colour; /* false for NaN */
    return tells;
}

/* Returns the half of the scene, 0 or 1, to which a splat belongs. The scene is divided into cubes,
 * which are assigned to the halves alternately along each axis, like the colours of a chessboard.
 */
static int half_of(const struct colours *c, size_t splat)
{
    const float *mean = c->splats.means + 3 * splat;
    int64_t sum = 0;

    for (int k = 0; k < 3; k++) {
        double cell = floor(((double)mean[k] - (double)c->ball[k]) / (region * c->radius));

        sum += fabs(cell) < 1e15 ? (int64_t)cell : 0;
    }
    return (int)(sum & 1);
}

/* Adds the samples of those points of the current frame that are visible to enough cameras. */
static spin_status add_fit_samples(struct colours *c)
{
    size_t n = (size_t)c->plan->n_cameras;

    for (size_t i = 0; i < c->n_points; i++) {
        const float(*seen)[4] = (const float(*)[4])c->seen + i * n;
        size_t cameras = 0;

        for (size_t k = 0; k < n; k++)
            cameras += determines_gain(seen[k]);
        if (cameras < FIT_CAMERAS)
            continue;
        SPIN_TRY(spin_grow(c->n_samples + cameras, sizeof *c->sample, (void **)&c->sample));
        for (size_t k = 0; k < n; k++)
            if (determines_gain(seen[k])) {
                struct spin_photometric_sample *s = &c->sample[c->n_samples++];

                *s = (struct spin_photometric_sample){.point = (uint32_t)c->n_points_seen,
                                                      .camera = (int)k,
                                                      .lens = c->lens[k],
                                                      .half = half_of(c, i * c->step),
                                                      .r2 = seen[k][3]};
                memcpy(s->value, seen[k], sizeof s->value);
            }
        c->n_points_seen++;
    }
    return SPIN_OK;
}

static spin_status fit_samples(struct colours *c, struct spin_photometric_result *result)
{
    struct spin_plan *plan = c->plan;
    const float *lens = plan->exposure + SPIN_EXPOSURE * (size_t)plan->n_cameras;
    SPIN_FREED double *corner = NULL;

    if (c->n_points_seen < FIT_POINTS)
        return SPIN_OK;
    SPIN_TRY(spin_alloc((size_t)plan->lenses.n + 1, sizeof *corner, (void **)&corner));
    for (int k = 0; k < plan->lenses.n; k++)
        corner[k] = spin_lens_corner_r2(&plan->lenses.lens[k]);
    SPIN_TRY(spin_photometric_choose(c->sample, c->n_samples, plan->n_cameras, plan->lenses.n,
                                     corner, plan->exposure, result));
    for (int k = 0; k < plan->lenses.n; k++)
        memcpy(plan->lenses.lens[k].falloff, lens + SPIN_EXPOSURE * k,
               sizeof plan->lenses.lens[k].falloff);
    return SPIN_OK;
}

static spin_status measure_scene(struct colours *c)
{
    SPIN_LEAVES(spin_point_sample_close) struct spin_point_sample sample = {0};
    int frame = spin_plan_middle_frame(c->plan);

    SPIN_TRY(spin_point_sample_open(&sample, 1));
    SPIN_TRY(spin_bundle_frame(&c->plan->clip.bundle, spin_plan_index(c->plan, frame),
                               SPIN_COL_MEANS, &c->splats));
    spin_point_sample_add(&sample, &c->splats);
    c->radius = (double)spin_point_sample_enclose(&sample, c->ball);
    return SPIN_OK;
}

static spin_status sample_frame(struct colours *c, int frame)
{
    size_t n = (size_t)c->plan->n_cameras;

    SPIN_TRY(spin_bundle_frame(&c->plan->clip.bundle, spin_plan_index(c->plan, frame),
                               SPIN_COL_MEANS, &c->splats));
    c->step = c->splats.n / POINTS + 1;
    c->n_points = (c->splats.n + c->step - 1) / c->step;
    for (size_t i = 0; i < c->n_points * n; i++)
        c->seen[i][0] = NAN;
    for (size_t i = 0; i < c->plan->n_train; i++)
        if (c->plan->train[i].frame == frame)
            SPIN_TRY(sample_view(c, c->plan->train[i].view));
    add_deviations(c);
    return add_fit_samples(c);
}

/* Returns the largest deviation of any camera in a channel, that is, the largest absolute value of
 * the cameras' medians; -1 if no camera has enough points. */
static double spread_of(struct colours *c, int rgb)
{
    double most = -1;

    for (size_t k = 0; k < (size_t)c->plan->n_cameras; k++) {
        float *values = c->difference[rgb] + k * FRAMES * POINTS;

        if (c->n[k] < LEAST_POINTS)
            continue;
        qsort(values, c->n[k], sizeof *values, spin_by_float);
        most = fmax(most, fabs((double)values[c->n[k] / 2]));
    }
    return most;
}

spin_status spin_photometric_fit_cameras(struct spin_plan *plan, struct spin_photos *photos,
                                         struct spin_photometric_result *result)
{
    struct colours *c = NULL;
    size_t n = (size_t)plan->n_cameras;
    int frames = plan->clip.n_frames < FRAMES ? plan->clip.n_frames : FRAMES;
    spin_status status;

    *result = (struct spin_photometric_result){
        .spread = -1, .gains = SPIN_PHOTOMETRIC_FEW, .falloff = SPIN_PHOTOMETRIC_FEW};
    SPIN_TRY(spin_alloc(1, sizeof *c, (void **)&c));
    c->plan = plan;
    c->photos = photos;
    SPIN_TRY_OUT(spin_alloc(plan->max_pixels, 3, (void **)&c->image));
    SPIN_TRY_OUT(spin_alloc(n * POINTS, sizeof *c->seen, (void **)&c->seen));
    SPIN_TRY_OUT(spin_alloc(n, sizeof *c->n, (void **)&c->n));
    SPIN_TRY_OUT(spin_alloc(n, sizeof *c->lens, (void **)&c->lens));
    for (int rgb = 0; rgb < 3; rgb++)
        SPIN_TRY_OUT(spin_alloc(n * FRAMES * POINTS, sizeof(float), (void **)&c->difference[rgb]));
    SPIN_TRY_OUT(measure_scene(c));
    for (int i = 0; i < frames; i++)
        SPIN_TRY_OUT(
            sample_frame(c, frames > 1 ? i * (plan->clip.n_frames - 1) / (frames - 1) : 0));
    for (int rgb = 0; rgb < 3; rgb++)
        result->spread = fmax(result->spread, spread_of(c, rgb));
    status = fit_samples(c, result);
out:
    for (int rgb = 0; rgb < 3; rgb++)
        free(c->difference[rgb]);
    free(c->n);
    free(c->lens);
    free(c->sample);
    free(c->seen);
    free(c->image);
    spin_splats_free(&c->splats);
    free(c);
    return status;
}
