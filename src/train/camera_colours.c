/* Projects points of a few frames into the training views and compares the image colours at these
 * pixels. A coarse depth map of the nearest points of each view detects occluded points, which are
 * ignored. Since the map misses some occlusions, results are medians, which are robust against a
 * few wrong colours. */
#include "train/camera_colours.h"

#include "base/base.h"
#include "math/exposure.h"
#include "train/train_frame.h"

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
static const float darkest = 0.1f, brightest = 0.95f;
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
        tells &= seen[rgb] > darkest && seen[rgb] < brightest; /* false for NaN */
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
