/* Retraining, before it begins: options to shapes, the clip, memory and time (--dry-run). */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/log.h"
#include "base/mem.h"
#include "base/pool.h"
#include "train/knn.h"
#include "train/run.h"

static const size_t program_bytes = 150 << 20; /* the image library, mostly */

/* ---- Options ---------------------------------------------------------------------------------- */

void spin_retrain_defaults(struct spin_retrain_options *o)
{
    memset(o, 0, sizeof *o);
    o->image_scale = 1;
    o->iterations = 40000;
    o->batch = 3;
    o->levels = 16;
    o->features = 4;
    o->hash_log2 = 21;
    o->hidden = 64;
    o->sh_degree = 3;
    for (int d = 0; d < 4; d++) {
        o->base_resolution[d] = 8;
        o->finest_resolution[d] = d < 3 ? 2048 : 0;
    }
    o->lambda_dssim = 0.2;
    o->dynamic_weight = 1;
    o->hash_init_range = SPIN_HASH_INIT_RANGE;
    o->warmup = -1;
    o->lr_table = 8e-3;
    o->lr_sh = 1e-3;
    o->lr_scale = 3e-4;
    o->lr_rotation = 3e-5;
    o->lr_opacity = 8e-4;
    o->lr_position = 1.6e-4;
    o->lr_exposure = 1e-3;
    o->lr_head_factor = 1;
    o->lr_residual = 1;
    o->init_log_scale = -5;
    o->views_per_frame = 1;
    o->device = "auto";
}

/* What a budget of minutes wants. A frame is visited some hundred times, not some thousand: rates are
 * higher, the views of a batch share one run of the network, and the splats begin with what is known. */
static void preset_short(struct spin_retrain_options *o)
{
    o->iterations = 1500;
    o->views_per_frame = 3;
    o->hash_log2 = 19;
    o->normalise = SPIN_NORMALISE_AUTO;
    o->residual = SPIN_RESIDUAL_POINTS;
    o->lr_residual = 8;
    o->lr_position = 1e-3;
    o->lr_table = 4e-2;
    o->lr_head_factor = 4;
}

spin_status spin_retrain_preset(const char *name, struct spin_retrain_options *o)
{
    spin_retrain_defaults(o);
    if (!strcmp(name, "short"))
        preset_short(o);
    else if (strcmp(name, "paper") != 0)
        return spin_fail(SPIN_E_USAGE, "no preset '%s': paper or short", name);
    return SPIN_OK;
}

spin_status spin_run_check(const struct spin_retrain_options *o)
{
    if (!o->input || (!o->output && !o->dry_run))
        return spin_fail(SPIN_E_USAGE, "retraining needs an input and an output");
    if (o->iterations < 1 || o->batch < 1 || o->views_per_frame < 1 || o->batch > 4096)
        return spin_fail(SPIN_E_USAGE, "iterations, batch and views per frame must be at least 1");
    if (!(o->lambda_dssim >= 0 && o->lambda_dssim <= 1))
        return spin_fail(SPIN_E_USAGE, "lambda-dssim %g is not in 0 to 1", o->lambda_dssim);
    if (!(o->lambda_scale >= 0 && o->lambda_opacity >= 0 && o->dynamic_weight > 0 &&
          o->hash_init_range >= 0))
        return spin_fail(SPIN_E_USAGE, "weights and ranges are not negative numbers");
    if (!(o->image_scale > 0 && o->image_scale <= 1))
        return spin_fail(SPIN_E_USAGE, "image scale %g is not in (0, 1]", o->image_scale);
    if (o->refine < 0 || o->max_points < 0)
        return spin_fail(SPIN_E_USAGE, "refinement has no negative iterations or points");
    if (o->method == SPIN_METHOD_EXPLICIT && o->refine < 1)
        return spin_fail(SPIN_E_USAGE, "the explicit method needs iterations for every frame: say "
                                       "how many with --refine");
    return SPIN_OK;
}

/* ---- Reading the clip -------------------------------------------------------------------------- */

int spin_run_index(const struct spin_run *r, int frame) { return r->clip.frame[frame]; }

const struct spin_frame_info *spin_run_info(const struct spin_run *r, int frame)
{
    return &r->clip.bundle.meta.frame[spin_run_index(r, frame)];
}

spin_status spin_run_means(struct spin_run *r, int frame)
{
    int index = spin_run_index(r, frame);

    if (r->is_refined)
        SPIN_TRY(spin_run_refined(r, frame, SPIN_COL_MEANS, &r->splats));
    else
        SPIN_TRY(spin_bundle_frame(&r->clip.bundle, index, SPIN_COL_MEANS, &r->splats));
    for (size_t i = 0; i < r->splats.n * 3; i++)
        if (!isfinite(r->splats.means[i]))
            return spin_fail(SPIN_E_MALFORMED,
                             "'%s': array '%s/means/%05d' has a value that is "
                             "not finite in row %zu",
                             r->o->input, r->is_refined ? "refined" : "source", index, i / 3);
    return SPIN_OK;
}

/* The training cameras' ids, each once. */
static spin_status list_cameras(struct spin_run *r)
{
    void *block = NULL;

    SPIN_TRY(spin_alloc(r->n_train, sizeof *r->camera, &block));
    r->camera = block;
    for (size_t i = 0; i < r->n_train; i++) {
        int id = r->clip.views.view[r->train[i].view].camera_id, k = 0;

        while (k < r->n_cameras && r->camera[k] < id)
            k++;
        if (k < r->n_cameras && r->camera[k] == id)
            continue;
        memmove(r->camera + k + 1, r->camera + k, (size_t)(r->n_cameras++ - k) * sizeof *r->camera);
        r->camera[k] = id;
    }
    return SPIN_OK;
}

int spin_run_camera(const struct spin_run *r, int id)
{
    int k = 0;

    while (r->camera[k] != id)
        k++;
    return k;
}

static void measure_pictures(struct spin_run *r)
{
    for (size_t i = 0; i < r->clip.views.n; i++) {
        struct spin_camera_f32 cam = spin_camera_f32_from(&r->clip.views.view[i].camera);
        size_t pixels = (size_t)cam.width * (size_t)cam.height;
        size_t tiles = (size_t)cam.tiles_x * (size_t)cam.tiles_y;

        r->max_pixels = pixels > r->max_pixels ? pixels : r->max_pixels;
        r->max_tiles = tiles > r->max_tiles ? tiles : r->max_tiles;
    }
}

/* ---- Where the points are ----------------------------------------------------------------------- */

enum { SAMPLE = 20000 }; /* points of a frame that are looked at, at most */

static int compare_floats(const void *a, const void *b)
{
    float x = *(const float *)a, y = *(const float *)b;

    return (x > y) - (x < y);
}

/* Points of a frame, evenly from all of them, behind the n that are there. */
static spin_status sample_means(struct spin_run *r, int frame, float *sample, size_t *n)
{
    size_t step;

    SPIN_TRY(spin_run_means(r, frame));
    step = r->splats.n / SAMPLE + 1;
    for (size_t i = 0; i < r->splats.n; i += step)
        memcpy(sample + 3 * (*n)++, r->splats.means + 3 * i, 3 * sizeof(float));
    return SPIN_OK;
}

/* Per-axis medians, and the radius around them that holds nine tenths. value [n] is scratch. */
static float enclose(const float *sample, size_t n, float *value, float centre[3])
{
    for (int c = 0; c < 3; c++) {
        for (size_t i = 0; i < n; i++)
            value[i] = sample[3 * i + (size_t)c];
        qsort(value, n, sizeof *value, compare_floats);
        centre[c] = value[n / 2];
    }
    for (size_t i = 0; i < n; i++) {
        double d2 = 0;

        for (int c = 0; c < 3; c++)
            d2 += pow((double)(sample[3 * i + (size_t)c] - centre[c]), 2);
        value[i] = (float)sqrt(d2);
    }
    qsort(value, n, sizeof *value, compare_floats);
    return value[(size_t)(0.9 * (double)(n - 1))];
}

static int middle_frame(const struct spin_run *r)
{
    int f = r->clip.n_frames / 2;

    while (r->counts[f] == 0)
        f = (f + 1) % r->clip.n_frames;
    return f;
}

/* The extent of the training cameras scales the position rate and 3DGS's thresholds. Cameras that all
 * stand in one place have none. Then it is what a ring of such cameras around the points would have:
 * 1.1 x the distance from the camera to the median of the points, or 1.1 x the radius that holds nine
 * tenths of them where that is larger (the camera stands among them). */
static spin_status plan_extent(struct spin_run *r)
{
    struct spin_camera_f32 cam = spin_camera_f32_from(&r->clip.views.view[r->train[0].view].camera);
    double extent = spin_views_extent(&r->clip.views), distance = 0, one_place;
    float centre[3], radius, *sample;
    void *block = NULL;
    size_t n = 0;
    spin_status status;

    SPIN_TRY(spin_alloc(4 * SAMPLE, sizeof *sample, &block));
    sample = block;
    SPIN_TRY_OUT(sample_means(r, middle_frame(r), sample, &n));
    radius = enclose(sample, n, sample + 3 * n, centre);
    for (int c = 0; c < 3; c++)
        distance += pow((double)cam.centre[c] - (double)centre[c], 2);
    one_place = 1.1 * fmax(sqrt(distance), (double)radius);
    r->extent = extent;
    if (extent <= 1e-6 * one_place || extent == 0) {
        r->extent = one_place > 0 ? one_place : 1;
        spin_log(0,
                 "the training cameras all stand in one place: their extent is taken from the "
                 "distance to the points, %.4g",
                 r->extent);
    }
    if (!isfinite(r->extent))
        status = spin_fail(SPIN_E_MALFORMED, "the extent of the training cameras is not finite");
out:
    free(block);
    return status;
}

spin_status spin_run_open_clip(struct spin_run *r)
{
    const struct spin_retrain_options *o = r->o;
    struct spin_clip_options c = {
        .input = o->input,
        .data = o->data,
        .data_from = o->data_from,
        .pair = o->pair,
        .range = o->range,
        .test_cameras = o->test_cameras,
        .n_test_cameras = o->n_test_cameras,
        .image_scale = o->image_scale,
        .needs_views = true,
    };
    void *block = NULL;

    SPIN_TRY(spin_clip_open(&c, &r->clip));
    if (o->residual == SPIN_RESIDUAL_SOURCE && o->refine == 0 && !spin_run_has_source(r))
        return spin_fail(
            SPIN_E_NOT_FOUND,
            "'%s' has no attributes of its source: let the network add to its points, with "
            "--residual points",
            o->input);
    SPIN_TRY(spin_alloc((size_t)r->clip.n_frames, sizeof *r->counts, &block));
    r->counts = block;
    for (int f = 0; f < r->clip.n_frames; f++)
        r->counts[f] = spin_run_info(r, f)->n;
    if (r->clip.n_max == 0)
        return spin_fail(SPIN_E_MALFORMED, "'%s' has no splat in any frame", o->input);
    SPIN_TRY(spin_clip_pairs(&r->clip, SPIN_SPLIT_TRAIN, &r->train, &r->n_train));
    SPIN_TRY(spin_clip_pairs(&r->clip, SPIN_SPLIT_TEST, &r->test, &r->n_test));
    if (r->n_train == 0)
        return spin_fail(SPIN_E_USAGE, "no training camera is left: all are held out for testing");
    block = NULL;
    SPIN_TRY(spin_alloc(3 * r->n_train, sizeof *r->sequence, &block));
    r->sequence = block;
    r->epoch = -1;
    SPIN_TRY(list_cameras(r));
    SPIN_TRY(spin_times_check(r->clip.bundle.meta.frame, r->clip.frame, r->clip.n_frames));
    measure_pictures(r);
    return plan_extent(r);
}

/* ---- Planning ---------------------------------------------------------------------------------- */

/* Centre: per-axis medians over a sample of all frames; radius: the 90th percentile of the distance
 * to it (method.md 3.1). Also the share of points outside the unit ball with the norm in use. */
static spin_status plan_norm(struct spin_run *r)
{
    const struct spin_retrain_options *o = r->o;
    size_t n = 0, outside = 0;
    void *block = NULL;
    float *sample;
    spin_status status = SPIN_OK;

    SPIN_TRY(spin_alloc(SAMPLE * (size_t)r->clip.n_frames * 4, sizeof(float), &block));
    sample = block;
    for (int f = 0; f < r->clip.n_frames; f++)
        SPIN_TRY_OUT(sample_means(r, f, sample, &n));
    if (o->normalise_radius > 0) {
        for (int c = 0; c < 3; c++)
            r->field.transform.centre[c] = (float)o->normalise_centre[c];
        r->field.transform.inv_radius = (float)(1 / o->normalise_radius);
    } else if (o->normalise == SPIN_NORMALISE_AUTO) {
        float *value = sample + 3 * n;

        float radius = enclose(sample, n, value, r->field.transform.centre);

        r->field.transform.inv_radius = 1.0f / fmaxf(radius, 1e-20f);
    }
    for (size_t i = 0; i < n; i++) {
        double d2 = 0;

        for (int c = 0; c < 3; c++)
            d2 += pow((double)(sample[3 * i + (size_t)c] - r->field.transform.centre[c]), 2);
        outside += d2 * pow((double)r->field.transform.inv_radius, 2) > 1;
    }
    r->report->outside_ball = n ? (double)outside / (double)n : 0;
out:
    free(block);
    return status;
}

static int decodings(const struct spin_retrain_options *o)
{
    return (o->batch + o->views_per_frame - 1) / o->views_per_frame;
}

bool spin_run_is_lazy(const struct spin_run *r)
{
    return spin_lazy_pays(&r->field, decodings(r->o) * r->clip.n_mean, r->o->iterations);
}

/* Log of the median distance to the three nearest points, in the clip's middle frame with points. */
static spin_status plan_scale_bias(struct spin_run *r)
{
    int f = middle_frame(r);
    struct spin_pool *pool = NULL;
    void *block = NULL;
    float *d2;
    spin_status status;

    r->init_log_scale = r->o->init_log_scale;
    if (!isnan(r->init_log_scale))
        return SPIN_OK;
    SPIN_TRY(spin_run_means(r, f));
    SPIN_TRY_OUT(spin_pool_create(r->o->n_threads, &pool));
    SPIN_TRY_OUT(spin_alloc(r->splats.n, sizeof(float), &block));
    d2 = block;
    SPIN_TRY_OUT(spin_knn_mean_dist2(pool, r->splats.n, r->splats.means, d2));
    qsort(d2, r->splats.n, sizeof *d2, compare_floats);
    r->init_log_scale = 0.5 * log(fmax((double)d2[r->splats.n / 2], 1e-7));
out:
    spin_pool_free(pool);
    free(block);
    return status;
}

/* Decoded images are kept while there is room beside what is `needed`, in at most a third of the
 * memory; what has no room is decoded again. The plan counts no more than that. */
static size_t plan_pixels(struct spin_run *r, size_t needed)
{
    size_t all = 0, available = r->report->bytes_available, most = available / 3;

    for (size_t i = 0; i < r->n_train + r->n_test; i++) {
        size_t view = i < r->n_train ? r->train[i].view : r->test[i - r->n_train].view;
        const struct spin_camera *c = &r->clip.views.view[view].camera;

        all += 3 * (size_t)c->width * (size_t)c->height;
    }
    if (needed >= available)
        most = 0;
    else if (most > available - needed)
        most = available - needed;
    if (most < r->pixels.held) /* planned anew, when some are there */
        most = r->pixels.held;
    r->pixels_budget = r->pixels.budget = most;
    return all < most ? all : most;
}

spin_status spin_run_plan(struct spin_run *r)
{
    const struct spin_retrain_options *o = r->o;
    int finest[4];
    size_t needed;

    memcpy(finest, o->finest_resolution, sizeof finest);
    if (finest[3] == 0)
        finest[3] = r->clip.n_frames > 16 ? r->clip.n_frames : 16;
    SPIN_TRY(spin_field_plan(&r->field, o->levels, o->features, o->hash_log2, o->hidden,
                             o->sh_degree, o->base_resolution, finest));
    r->field.heads.relu = o->relu;
    r->field.antialias = o->antialias;
    r->field.transform.raw = o->normalise == SPIN_NORMALISE_NONE;
    r->field.time_first = r->field.time_last = spin_run_info(r, 0)->time;
    for (int f = 1; f < r->clip.n_frames; f++) {
        r->field.time_first = fmin(r->field.time_first, spin_run_info(r, f)->time);
        r->field.time_last = fmax(r->field.time_last, spin_run_info(r, f)->time);
    }
    SPIN_TRY(plan_norm(r));
    SPIN_TRY(plan_scale_bias(r));
    needed =
        spin_trainer_bytes(&r->field, r->clip.n_frames, r->counts, r->max_pixels,
                           spin_run_has_residual(r)) +
        spin_field_eval_bytes(&r->field, r->clip.n_max, false) + /* evaluation, with host copies */
        3 * r->clip.n_max * SPIN_ATTR * sizeof(float) +
        (size_t)(o->batch + 12) * 3 * r->max_pixels * sizeof(float) +
        (spin_run_is_lazy(r) ? spin_lazy_bytes(&r->field, o->iterations) : 0);
    if (r->refined && (o->method == SPIN_METHOD_EXPLICIT || needed < spin_run_refine_bytes(r)))
        needed = spin_run_refine_bytes(r);
    needed += program_bytes;
    r->report->bytes_available = spin_memory_available() + r->pixels.held;
    r->report->bytes_needed = needed + plan_pixels(r, needed);
    return SPIN_OK;
}

/* The frame-wise stage, on one thread: rasteriser and what the host carries per splat, rasteriser and
 * loss per pixel. Points that densification adds are not foreseen. */
static double guess_refining(const struct spin_run *r)
{
    double splat = 0.6e-6, pixel = 0.25e-6;

    return (double)r->clip.n_frames * r->o->refine *
           (r->clip.n_mean * splat + (double)r->max_pixels * pixel);
}

/* Seconds of the whole run, from what the ops take on one thread of a present server core: network
 * per splat and decoding, rasteriser per splat and view, rasteriser and loss per pixel, Adam. */
double spin_run_guess(const struct spin_run *r)
{
    const struct spin_retrain_options *o = r->o;
    double network = 3.2e-6, raster = 0.27e-6, pixel = 0.25e-6, adam = 1.1e-9;
    double threads = o->n_threads;
    double iteration = r->clip.n_mean * (decodings(o) * network + o->batch * raster) +
                       o->batch * (double)r->max_pixels * pixel + (double)r->field.n_table * adam;
    double seconds = r->refined ? guess_refining(r) : 0;
    struct spin_pool *pool = NULL;

    if (threads < 1 && spin_pool_create(0, &pool) == SPIN_OK)
        threads = spin_pool_n_threads(pool);
    spin_pool_free(pool);
    if (o->method == SPIN_METHOD_NETWORK)
        seconds += o->iterations * iteration;
    return seconds / (threads > 1 ? threads : 1);
}
