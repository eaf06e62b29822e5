/* spin-retrain: a bundle in, a better bundle out. Data, schedule of views, evaluation, checkpoints.
 *
 * The unfinished state lives beside the output as OUT.part, written whole or not at all. Everything
 * that follows from an iteration depends on the options, the seed and the state alone, so a resumed
 * run ends in the same bits as one that was never stopped, on any number of threads. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/log.h"
#include "base/mem.h"
#include "base/pool.h"
#include "core/knn.h"
#include "core/measure.h"
#include "core/morton.h"
#include "core/ops.h"
#include "core/train.h"
#include "math/contract.h"
#include "math/rng.h"

enum { STREAM_SHUFFLE = 16 };                  /* of the random numbers, see math/rng.h */
static const size_t program_bytes = 150 << 20; /* the image library, mostly */
static const double save_seconds = 300;        /* between states, when --save-every is not given */

struct retrain {
    const struct spin_retrain_options *o;
    struct spin_retrain_report *report;
    struct spin_clip clip;
    struct spin_pixels pixels;
    struct spin_device device;
    struct spin_model model;
    struct spin_trainer trainer;
    size_t *counts;            /* [frames] splats */
    uint32_t **order;          /* [frames][n] the source's row at each place of ours */
    struct spin_splats splats; /* scratch of one frame */
    int *camera;               /* [n_cameras] ids of the training cameras, ascending */
    int n_cameras;
    struct spin_pair *train, *test; /* pairs (frame, view) */
    size_t n_train, n_test;
    uint32_t *sequence; /* [n_train] of the present epoch */
    int64_t epoch;      /* sequence belongs to; -1 none */
    float *truth;       /* [batch][3][max pixels] host */
    size_t max_pixels, max_tiles;
    double extent, scale_bias;
    char *part;        /* path of the unfinished state */
    char *fingerprint; /* what must be equal for a resume */
    FILE *log;
    double worked_s, saved_s;
    double worked_before_s;
};

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
    o->warmup = -1;
    o->lr_table = 8e-3;
    o->lr_sh = 1e-3;
    o->lr_scale = 3e-4;
    o->lr_rotation = 3e-5;
    o->lr_opacity = 8e-4;
    o->lr_position = 1.6e-4;
    o->lr_camera = 1e-3;
    o->lr_head_factor = 1;
    o->scale_bias = -5;
    o->views_per_frame = 1;
    o->device = "auto";
}

static spin_status check_options(const struct spin_retrain_options *o)
{
    if (!o->input || (!o->output && !o->dry_run))
        return spin_fail(SPIN_E_USAGE, "retraining needs an input and an output");
    if (o->iterations < 1 || o->batch < 1 || o->views_per_frame < 1 || o->batch > 4096)
        return spin_fail(SPIN_E_USAGE, "iterations, batch and views per frame must be at least 1");
    if (!(o->lambda_dssim >= 0 && o->lambda_dssim <= 1))
        return spin_fail(SPIN_E_USAGE, "lambda-dssim %g is not in 0 to 1", o->lambda_dssim);
    if (!(o->image_scale > 0 && o->image_scale <= 1))
        return spin_fail(SPIN_E_USAGE, "image scale %g is not in (0, 1]", o->image_scale);
    return SPIN_OK;
}

/* ---- Reading the clip -------------------------------------------------------------------------- */

static int frame_index(const struct retrain *r, int frame) { return r->clip.frame[frame]; }

static const struct spin_frame_info *frame_info(const struct retrain *r, int frame)
{
    return &r->clip.bundle.meta.frame[frame_index(r, frame)];
}

static spin_status read_means(struct retrain *r, int frame)
{
    SPIN_TRY(spin_bundle_frame(&r->clip.bundle, frame_index(r, frame), SPIN_COL_MEANS, &r->splats));
    for (size_t i = 0; i < r->splats.n * 3; i++)
        if (!isfinite(r->splats.means[i]))
            return spin_fail(SPIN_E_MALFORMED,
                             "'%s': array 'source/means/%05d' has a value that is "
                             "not finite in row %zu",
                             r->o->input, frame_index(r, frame), i / 3);
    return SPIN_OK;
}

/* The training cameras' ids, each once. */
static spin_status list_cameras(struct retrain *r)
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

static int camera_place(const struct retrain *r, int id)
{
    int k = 0;

    while (r->camera[k] != id)
        k++;
    return k;
}

static void measure_pictures(struct retrain *r)
{
    for (size_t i = 0; i < r->clip.views.n; i++) {
        struct spin_cam cam = spin_cam_from(&r->clip.views.view[i].camera);
        size_t pixels = (size_t)cam.width * (size_t)cam.height;
        size_t tiles = (size_t)cam.tiles_x * (size_t)cam.tiles_y;

        r->max_pixels = pixels > r->max_pixels ? pixels : r->max_pixels;
        r->max_tiles = tiles > r->max_tiles ? tiles : r->max_tiles;
    }
}

static spin_status open_clip(struct retrain *r)
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
    SPIN_TRY(spin_alloc((size_t)r->clip.n_frames, sizeof *r->counts, &block));
    r->counts = block;
    for (int f = 0; f < r->clip.n_frames; f++)
        r->counts[f] = frame_info(r, f)->n;
    if (r->clip.n_max == 0)
        return spin_fail(SPIN_E_MALFORMED, "'%s' has no splat in any frame", o->input);
    SPIN_TRY(spin_clip_pairs(&r->clip, SPIN_SPLIT_TRAIN, &r->train, &r->n_train));
    SPIN_TRY(spin_clip_pairs(&r->clip, SPIN_SPLIT_TEST, &r->test, &r->n_test));
    if (r->n_train == 0)
        return spin_fail(SPIN_E_USAGE, "no training camera is left: all are held out for testing");
    block = NULL;
    SPIN_TRY(spin_alloc(r->n_train, sizeof *r->sequence, &block));
    r->sequence = block;
    r->epoch = -1;
    SPIN_TRY(list_cameras(r));
    r->extent = spin_views_extent(&r->clip.views);
    measure_pictures(r);
    return SPIN_OK;
}

/* ---- Planning ---------------------------------------------------------------------------------- */

static int compare_floats(const void *a, const void *b)
{
    float x = *(const float *)a, y = *(const float *)b;

    return (x > y) - (x < y);
}

/* Centre: per-axis medians over a sample of all frames; radius: the 90th percentile of the distance
 * to it (method.md 3.1). Also the share of points outside the unit ball with the norm in use. */
static spin_status plan_norm(struct retrain *r)
{
    const struct spin_retrain_options *o = r->o;
    size_t per_frame = 20000, n = 0, outside = 0;
    void *block = NULL;
    float *sample;
    spin_status status = SPIN_OK;

    SPIN_TRY(spin_alloc(per_frame * (size_t)r->clip.n_frames * 4, sizeof(float), &block));
    sample = block;
    for (int f = 0; f < r->clip.n_frames; f++) {
        size_t step;

        SPIN_TRY_OUT(read_means(r, f));
        step = r->splats.n / per_frame + 1;
        for (size_t i = 0; i < r->splats.n; i += step)
            memcpy(sample + 3 * n++, r->splats.means + 3 * i, 3 * sizeof(float));
    }
    if (o->normalise_radius > 0) {
        for (int c = 0; c < 3; c++)
            r->model.norm.centre[c] = (float)o->normalise_centre[c];
        r->model.norm.inv_radius = (float)(1 / o->normalise_radius);
    } else if (o->normalise == SPIN_NORMALISE_AUTO) {
        float *value = sample + 3 * n;

        for (int c = 0; c < 3; c++) {
            for (size_t i = 0; i < n; i++)
                value[i] = sample[3 * i + (size_t)c];
            qsort(value, n, sizeof *value, compare_floats);
            r->model.norm.centre[c] = value[n / 2];
        }
        for (size_t i = 0; i < n; i++) {
            double d2 = 0;

            for (int c = 0; c < 3; c++)
                d2 += pow((double)(sample[3 * i + (size_t)c] - r->model.norm.centre[c]), 2);
            value[i] = (float)sqrt(d2);
        }
        qsort(value, n, sizeof *value, compare_floats);
        r->model.norm.inv_radius = 1.0f / fmaxf(value[(size_t)(0.9 * (double)(n - 1))], 1e-20f);
    }
    for (size_t i = 0; i < n; i++) {
        double d2 = 0;

        for (int c = 0; c < 3; c++)
            d2 += pow((double)(sample[3 * i + (size_t)c] - r->model.norm.centre[c]), 2);
        outside += d2 * pow((double)r->model.norm.inv_radius, 2) > 1;
    }
    r->report->outside_ball = n ? (double)outside / (double)n : 0;
out:
    free(block);
    return status;
}

/* Log of the median distance to the three nearest points, in the clip's middle frame with points. */
static spin_status plan_scale_bias(struct retrain *r)
{
    int f = r->clip.n_frames / 2;
    struct spin_pool *pool = NULL;
    void *block = NULL;
    float *d2;
    spin_status status;

    r->scale_bias = r->o->scale_bias;
    if (!isnan(r->scale_bias))
        return SPIN_OK;
    while (r->counts[f] == 0)
        f = (f + 1) % r->clip.n_frames;
    SPIN_TRY(read_means(r, f));
    SPIN_TRY_OUT(spin_pool_create(r->o->n_threads, &pool));
    SPIN_TRY_OUT(spin_alloc(r->splats.n, sizeof(float), &block));
    d2 = block;
    SPIN_TRY_OUT(spin_knn_mean_dist2(pool, r->splats.n, r->splats.means, d2));
    qsort(d2, r->splats.n, sizeof *d2, compare_floats);
    r->scale_bias = 0.5 * log(fmax((double)d2[r->splats.n / 2], 1e-7));
out:
    spin_pool_free(pool);
    free(block);
    return status;
}

static spin_status plan(struct retrain *r)
{
    const struct spin_retrain_options *o = r->o;
    int finest[4];
    size_t pixels_cache = 0;

    memcpy(finest, o->finest_resolution, sizeof finest);
    if (finest[3] == 0)
        finest[3] = r->clip.n_frames > 16 ? r->clip.n_frames : 16;
    SPIN_TRY(spin_model_plan(&r->model, o->levels, o->features, o->hash_log2, o->hidden,
                             o->sh_degree, o->base_resolution, finest));
    r->model.time_first = frame_info(r, 0)->time;
    r->model.time_last = frame_info(r, r->clip.n_frames - 1)->time;
    SPIN_TRY(plan_norm(r));
    SPIN_TRY(plan_scale_bias(r));
    for (size_t i = 0; i < r->n_train + r->n_test; i++) {
        size_t view = i < r->n_train ? r->train[i].view : r->test[i - r->n_train].view;
        const struct spin_camera *c = &r->clip.views.view[view].camera;

        pixels_cache += 3 * (size_t)c->width * (size_t)c->height;
    }
    r->report->bytes_needed =
        spin_trainer_bytes(&r->model, r->clip.n_frames, r->counts, r->max_pixels) +
        spin_decode_bytes(&r->model, r->clip.n_max, false) + /* evaluation, with its host copies */
        3 * r->clip.n_max * SPIN_ATTR * sizeof(float) +
        (size_t)(o->batch + 12) * 3 * r->max_pixels * sizeof(float) + pixels_cache + program_bytes;
    r->report->bytes_available = spin_memory_available();
    return SPIN_OK;
}

/* Seconds of the whole run, from what the ops take on one thread of a present server core: network
 * per splat and decoding, rasteriser per splat and view, rasteriser and loss per pixel, Adam. */
static double guess_seconds(const struct retrain *r)
{
    const struct spin_retrain_options *o = r->o;
    double network = 3.2e-6, raster = 0.27e-6, pixel = 0.25e-6, adam = 1.1e-9;
    double threads = o->n_threads;
    int decodings = (o->batch + o->views_per_frame - 1) / o->views_per_frame;
    struct spin_pool *pool = NULL;

    if (threads < 1 && spin_pool_create(0, &pool) == SPIN_OK)
        threads = spin_pool_n_threads(pool);
    spin_pool_free(pool);
    return o->iterations *
           (r->clip.n_mean * (decodings * network + o->batch * raster) +
            o->batch * (double)r->max_pixels * pixel + (double)r->model.n_table * adam) /
           (threads > 1 ? threads : 1);
}

/* ---- The state: first values, save, load ------------------------------------------------------ */

static void set_string(spin_json *j, const char *key, const char *format, double v)
{
    char text[64];

    snprintf(text, sizeof text, format, v);
    spin_json_set_string(j, key, text);
}

/* The options that decide the result. Stored with the network, compared before a resume. */
static spin_json *options_to_json(const struct retrain *r)
{
    const struct spin_retrain_options *o = r->o;
    spin_json *j = spin_json_object(), *base = spin_json_array(), *finest = spin_json_array();
    spin_json *back = spin_json_array(), *test = spin_json_array();

    for (int d = 0; d < 4; d++) {
        spin_json_push_number(base, o->base_resolution[d]);
        spin_json_push_number(finest, o->finest_resolution[d]);
    }
    for (int c = 0; c < 3; c++)
        spin_json_push_number(back, (double)o->background[c]);
    for (size_t i = 0; i < r->clip.views.n; i++)
        if (r->clip.views.view[i].test && r->clip.views.view[i].row == r->clip.row[0])
            spin_json_push_number(test, r->clip.views.view[i].camera_id);
    spin_json_set_integer(j, "iterations", o->iterations);
    spin_json_set_integer(j, "batch", o->batch);
    spin_json_set_integer(j, "hash_log2", o->hash_log2);
    spin_json_set(j, "base_resolution", base);
    spin_json_set(j, "finest_resolution", finest);
    spin_json_set_number(j, "lambda_dssim", o->lambda_dssim);
    set_string(j, "seed", "%.0f", (double)o->seed);
    spin_json_set_integer(j, "warmup", o->warmup);
    spin_json_set_number(j, "lr_table", o->lr_table);
    spin_json_set_number(j, "lr_sh", o->lr_sh);
    spin_json_set_number(j, "lr_scale", o->lr_scale);
    spin_json_set_number(j, "lr_rotation", o->lr_rotation);
    spin_json_set_number(j, "lr_opacity", o->lr_opacity);
    spin_json_set_number(j, "lr_position", o->lr_position);
    spin_json_set_number(j, "lr_head_factor", o->lr_head_factor);
    spin_json_set_bool(j, "camera_colour", o->camera_colour);
    spin_json_set_number(j, "lr_camera", o->lr_camera);
    spin_json_set_number(j, "scale_bias", r->scale_bias);
    spin_json_set_integer(j, "views_per_frame", o->views_per_frame);
    spin_json_set_number(j, "image_scale", o->image_scale);
    spin_json_set_number(j, "spatial_extent", r->extent);
    spin_json_set(j, "background", back);
    spin_json_set(j, "test_cameras", test);
    return j;
}

static spin_json *network_to_json(const struct retrain *r)
{
    spin_json *j = spin_model_to_json(&r->model);

    spin_json_set(j, "options", options_to_json(r));
    spin_json_set_string(j, "device", r->device.op->name);
    return j;
}

/* The network's plan and options, the frames, and the CRCs of the input's arrays. */
static spin_status make_fingerprint(struct retrain *r)
{
    spin_json *j = network_to_json(r), *frames = spin_json_array();
    const struct spin_zip *zip = &r->clip.bundle.npz.zip;
    double sum = 0;

    for (size_t i = 0; i < zip->n; i++)
        sum += (double)zip->member[i].crc;
    for (int f = 0; f < r->clip.n_frames; f++) {
        spin_json_push_number(frames, frame_info(r, f)->number);
        spin_json_push_number(frames, (double)r->counts[f]);
    }
    spin_json_set(j, "frames", frames);
    set_string(j, "input", "%.0f", sum);
    r->fingerprint = spin_json_text(j, false);
    spin_json_free(j);
    return r->fingerprint ? SPIN_OK : spin_fail(SPIN_E_MEMORY, "out of memory");
}

/* Our order of a frame's splats: along a space-filling curve, so that neighbours share cache lines. */
static spin_status sort_frames(struct retrain *r)
{
    void *block = NULL;

    SPIN_TRY(spin_alloc((size_t)r->clip.n_frames, sizeof *r->order, &block));
    r->order = block;
    for (int f = 0; f < r->clip.n_frames; f++) {
        block = NULL;
        SPIN_TRY(spin_alloc(r->counts[f] + 1, sizeof(uint32_t), &block));
        r->order[f] = block;
        SPIN_TRY(read_means(r, f));
        SPIN_TRY(spin_morton_order(r->counts[f], r->splats.means, r->order[f]));
    }
    return SPIN_OK;
}

static spin_status start_fresh(struct retrain *r)
{
    struct spin_device *d = &r->device;
    struct spin_trainer *t = &r->trainer;
    size_t floats = t->table.n + t->heads.n;
    void *block = NULL;
    float *host;

    floats = floats > r->clip.n_max * 3 ? floats : r->clip.n_max * 3;
    SPIN_TRY(spin_alloc(floats, sizeof(float), &block));
    host = block;
    spin_model_init(&r->model, r->o->seed, r->scale_bias, host, host + t->table.n);
    d->op->up(d, t->table.p, host, t->table.n * sizeof(float));
    d->op->up(d, t->heads.p, host + t->table.n, t->heads.n * sizeof(float));
    for (int f = 0; f < r->clip.n_frames; f++) {
        spin_status status = read_means(r, f);

        if (status != SPIN_OK) {
            free(block);
            return status;
        }
        for (size_t i = 0; i < r->counts[f]; i++)
            memcpy(host + 3 * i, r->splats.means + 3 * (size_t)r->order[f][i], 3 * sizeof(float));
        d->op->up(d, t->frame[f].pos, host, r->counts[f] * 3 * sizeof(float));
    }
    free(block);
    return SPIN_OK;
}

/* Everything the state holds, in one list: walked to save and to load. */
struct piece {
    char name[48];
    float *at; /* device */
    size_t n;
};

static spin_status list_pieces(struct retrain *r, struct piece **out, size_t *n)
{
    struct spin_trainer *t = &r->trainer;
    struct spin_param *param[3] = {&t->table, &t->heads, &t->tint};
    const char *param_name[3] = {"table", "heads", "tint"};
    void *block = NULL;
    struct piece *piece;
    size_t k = 0;

    SPIN_TRY(spin_alloc(9 + 3 * (size_t)t->n_frames, sizeof *piece, &block));
    piece = block;
    for (int i = 0; i < 3; i++) {
        float *at[3] = {param[i]->p, param[i]->m, param[i]->v};

        for (int j = 0; j < 3; j++, k++) {
            snprintf(piece[k].name, sizeof piece[k].name, "%s/%c", param_name[i], "pmv"[j]);
            piece[k].at = at[j];
            piece[k].n = param[i]->n;
        }
    }
    for (int f = 0; f < t->n_frames; f++) {
        float *at[3] = {t->frame[f].pos, t->frame[f].m, t->frame[f].v};

        for (int j = 0; j < 3; j++, k++) {
            snprintf(piece[k].name, sizeof piece[k].name, "frames/%05d/%c", f, "pmv"[j]);
            piece[k].at = at[j];
            piece[k].n = 3 * t->frame[f].n;
        }
    }
    *out = piece;
    *n = k;
    return SPIN_OK;
}

/* An array on the device into an archive, through a host copy. */
static spin_status write_array(struct retrain *r, struct spin_zip_writer *w, const char *name,
                               int n_dims, const uint64_t *shape, const float *at, size_t n)
{
    void *block = NULL;
    spin_status status;

    SPIN_TRY(spin_alloc(n + 1, sizeof(float), &block));
    r->device.op->down(&r->device, block, at, n * sizeof(float));
    status = spin_npz_write(w, name, "<f4", n_dims, shape, block);
    free(block);
    return status;
}

static spin_status save_pieces(struct retrain *r, struct spin_zip_writer *w)
{
    struct piece *piece = NULL;
    size_t n = 0;
    spin_status status;

    SPIN_TRY_OUT(list_pieces(r, &piece, &n));
    for (size_t i = 0; i < n; i++) {
        uint64_t shape[1] = {piece[i].n};

        SPIN_TRY_OUT(write_array(r, w, piece[i].name, 1, shape, piece[i].at, piece[i].n));
    }
out:
    free(piece);
    return status;
}

static spin_status write_text(struct spin_zip_writer *w, const char *name, const char *text)
{
    size_t n = strlen(text);

    SPIN_TRY(spin_zip_member_begin(w, name, n));
    SPIN_TRY(spin_zip_member_write(w, text, n));
    return spin_zip_member_end(w);
}

static spin_status save_state(struct retrain *r)
{
    struct spin_zip_writer w;
    spin_json *j = spin_json_object(), *steps = spin_json_array();
    char *text;
    spin_status status;

    for (int f = 0; f < r->trainer.n_frames; f++)
        spin_json_push_number(steps, (double)r->trainer.frame[f].steps);
    spin_json_set_integer(j, "iteration", r->trainer.iteration);
    spin_json_set_number(j, "seconds", r->worked_before_s + spin_now_s() - r->worked_s);
    spin_json_set(j, "steps", steps);
    spin_json_set_string(j, "fingerprint", r->fingerprint);
    text = spin_json_text(j, true);
    spin_json_free(j);
    status = spin_zip_writer_open(r->part, true, &w);
    if (status == SPIN_OK) {
        status = write_text(&w, "state.json", text ? text : "");
        if (status == SPIN_OK)
            status = save_pieces(r, &w);
        if (status == SPIN_OK)
            status = spin_zip_writer_commit(&w);
        else
            spin_zip_writer_abandon(&w);
    }
    free(text);
    r->saved_s = spin_now_s();
    if (status != SPIN_OK)
        return spin_more(status, "cannot save the unfinished state");
    spin_log(1, "saved the state of iteration %lld to '%s'", (long long)r->trainer.iteration,
             r->part);
    return SPIN_OK;
}

static spin_status load_pieces(struct retrain *r, struct spin_npz *npz)
{
    struct piece *piece = NULL;
    size_t n = 0;
    void *block = NULL;
    spin_status status;

    SPIN_TRY_OUT(list_pieces(r, &piece, &n));
    for (size_t i = 0; i < n; i++) {
        struct spin_array a;
        int64_t shape[1] = {(int64_t)piece[i].n};

        SPIN_TRY_OUT(spin_npz_array_of(npz, piece[i].name, true, 1, shape, &a));
        SPIN_TRY_OUT(spin_grow(piece[i].n + 1, sizeof(float), &block));
        spin_array_to_f32(&a, 0, piece[i].n, block);
        r->device.op->up(&r->device, piece[i].at, block, piece[i].n * sizeof(float));
    }
out:
    free(piece);
    free(block);
    return status;
}

static spin_status load_header(struct retrain *r, struct spin_npz *npz)
{
    const struct spin_zip_member *member = spin_zip_find(&npz->zip, "state.json");
    const unsigned char *bytes;
    void *owned = NULL;
    spin_json *j = NULL;
    int64_t iteration, steps;
    const char *fingerprint;
    spin_status status;

    if (!member)
        return spin_fail(SPIN_E_MALFORMED, "no state.json");
    SPIN_TRY_OUT(spin_zip_read(&npz->zip, member, true, 1 << 26, &bytes, &owned));
    SPIN_TRY_OUT(spin_json_parse("state.json", (const char *)bytes, member->size, &j));
    fingerprint = spin_json_string(spin_json_get(j, "fingerprint"));
    if (!fingerprint || strcmp(fingerprint, r->fingerprint) != 0) {
        status = spin_fail(SPIN_E_USAGE, "it was made from another input or with other options "
                                         "than these; give the same ones, or --force without "
                                         "--resume to start anew");
        goto out;
    }
    if (!spin_json_integer(spin_json_get(j, "iteration"), &iteration) || iteration < 0 ||
        iteration > r->o->iterations) {
        status = spin_fail(SPIN_E_MALFORMED, "state.json: bad iteration");
        goto out;
    }
    spin_json_number(spin_json_get(j, "seconds"), &r->worked_before_s);
    r->trainer.iteration = iteration;
    for (int f = 0; f < r->trainer.n_frames; f++) {
        const spin_json *step = spin_json_at(spin_json_get(j, "steps"), (size_t)f);
        double v = 0;

        if (!spin_json_number(step, &v) || v < 0 || v > 1e15) {
            status = spin_fail(SPIN_E_MALFORMED, "state.json: bad steps");
            goto out;
        }
        steps = (int64_t)v;
        r->trainer.frame[f].steps = steps;
    }
    status = SPIN_OK;
out:
    spin_json_free(j);
    free(owned);
    return status;
}

static spin_status load_state(struct retrain *r)
{
    struct spin_npz npz;
    spin_status status = spin_npz_open(r->part, &npz);

    if (status == SPIN_OK) {
        status = load_header(r, &npz);
        if (status == SPIN_OK)
            status = load_pieces(r, &npz);
        spin_npz_close(&npz);
    }
    if (status != SPIN_OK)
        return spin_more(status, "cannot resume from '%s'", r->part);
    spin_log(0, "resuming at iteration %lld of %d", (long long)r->trainer.iteration,
             r->o->iterations);
    return SPIN_OK;
}

/* ---- The schedule of views --------------------------------------------------------------------- */

static void shuffle(const struct retrain *r, uint64_t key, uint32_t *list, size_t n)
{
    for (size_t i = n; i > 1; i--) {
        size_t j = spin_rng_below(r->o->seed, STREAM_SHUFFLE, key << 32 | i, (uint32_t)i);
        uint32_t keep = list[i - 1];

        list[i - 1] = list[j];
        list[j] = keep;
    }
}

/* One epoch: a permutation of all (frame, training camera) pairs. With views_per_frame V > 1 the
 * views of a frame are permuted, cut into groups of V, and the groups permuted. A function of the
 * seed and the epoch. */
static spin_status plan_epoch(struct retrain *r, int64_t epoch)
{
    size_t n = r->n_train, v = (size_t)r->o->views_per_frame, n_groups = 0;
    void *block = NULL;
    uint32_t *views, *groups;

    if (r->epoch == epoch)
        return SPIN_OK;
    for (size_t i = 0; i < n; i++)
        r->sequence[i] = (uint32_t)i;
    r->epoch = epoch;
    if (v == 1) {
        shuffle(r, 2 * (uint64_t)epoch, r->sequence, n);
        return SPIN_OK;
    }
    SPIN_TRY(spin_alloc(2 * n, sizeof *views, &block));
    views = block;
    groups = views + n;
    memcpy(views, r->sequence, n * sizeof *views);
    shuffle(r, 2 * (uint64_t)epoch, views, n);
    /* Stable by frame: pairs of one frame stay in their shuffled order, side by side. */
    for (size_t f = 0, k = 0; f < (size_t)r->clip.n_frames; f++) {
        size_t first = k;

        for (size_t i = 0; i < n; i++)
            if (r->train[views[i]].frame == (int)f)
                r->sequence[k++] = views[i];
        for (size_t i = first; i < k; i += v)
            groups[n_groups++] = (uint32_t)i;
    }
    memcpy(views, r->sequence, n * sizeof *views);
    shuffle(r, 2 * (uint64_t)epoch + 1, groups, n_groups);
    for (size_t g = 0, k = 0; g < n_groups; g++) {
        int frame = r->train[views[groups[g]]].frame;

        for (size_t i = groups[g]; i < n && i < groups[g] + v && r->train[views[i]].frame == frame;
             i++)
            r->sequence[k++] = views[i];
    }
    free(block);
    return SPIN_OK;
}

/* Items of iteration i (from 0), pixels loaded. The last incomplete batch of an epoch is dropped. */
static spin_status plan_batch(struct retrain *r, int64_t i, struct spin_train_item *items,
                              const struct spin_pair **pairs)
{
    size_t batch = (size_t)r->o->batch;
    int64_t per_epoch = (int64_t)(r->n_train / batch);

    if (per_epoch < 1)
        per_epoch = 1;
    SPIN_TRY(plan_epoch(r, i / per_epoch));
    for (size_t k = 0; k < batch; k++) {
        size_t at = ((size_t)(i % per_epoch) * batch + k) % r->n_train;
        const struct spin_pair *pair = &r->train[r->sequence[at]];
        float *truth = r->truth + k * 3 * r->max_pixels;

        SPIN_TRY(spin_pixels_get(&r->pixels, pair->view, truth));
        items[k].frame = pair->frame;
        items[k].camera = &r->clip.views.view[pair->view].camera;
        items[k].tint = camera_place(r, r->clip.views.view[pair->view].camera_id);
        items[k].truth = truth;
        pairs[k] = pair;
    }
    return SPIN_OK;
}

/* ---- Looking at it ------------------------------------------------------------------------------ */

static spin_status measure(struct retrain *r, bool network, struct spin_quality *out)
{
    struct spin_player player;
    struct spin_measure m = {.player = &player,
                             .clip = &r->clip,
                             .pixels = &r->pixels,
                             .pairs = r->test,
                             .n_pairs = r->n_test,
                             .background = r->o->background,
                             .what = network ? "evaluating" : "evaluating the source"};
    void *block = NULL;
    spin_status status;

    memset(out, 0, sizeof *out);
    if (r->n_test == 0)
        return SPIN_OK;
    if (network) {
        SPIN_TRY(spin_alloc((size_t)r->clip.n_frames, sizeof(float *), &block));
        for (int f = 0; f < r->clip.n_frames; f++)
            ((float **)block)[f] = r->trainer.frame[f].pos;
        m.live_counts = r->counts;
        status = spin_player_open_live(&player, &r->device, &r->model, r->trainer.table.p,
                                       r->trainer.heads.p, block);
    } else {
        status = spin_player_open(&player, &r->device, &r->clip.bundle, false);
    }
    if (status == SPIN_OK) {
        status = spin_measure_run(&m, out);
        spin_player_close(&player);
    }
    free(block);
    return status;
}

static bool has_source(const struct retrain *r)
{
    return (r->clip.bundle.meta.columns & SPIN_COL_ATTRIBUTES) == SPIN_COL_ATTRIBUTES;
}

/* Truth | before | after of the clip's middle frame, one PNG a test camera. */
static spin_status preview_view(struct retrain *r, struct spin_player *live,
                                struct spin_player *source, const struct spin_pair *pair)
{
    const struct spin_view *view = &r->clip.views.view[pair->view];
    size_t pixels = 3 * (size_t)view->camera.width * (size_t)view->camera.height;
    const float *picture[3];
    char name[96];
    char *path = NULL;
    void *block = NULL;
    float *values;
    int n = 0;
    spin_status status;

    SPIN_TRY(spin_alloc(3 * pixels, sizeof(float), &block));
    values = block;
    SPIN_TRY_OUT(spin_pixels_get(&r->pixels, pair->view, values));
    picture[n++] = values;
    if (source) {
        SPIN_TRY_OUT(spin_player_show(source, frame_index(r, pair->frame)));
        SPIN_TRY_OUT(spin_player_draw(source, &view->camera, r->o->background, values + pixels));
        picture[n++] = values + pixels;
    }
    SPIN_TRY_OUT(spin_player_draw(live, &view->camera, r->o->background, values + 2 * pixels));
    picture[n++] = values + 2 * pixels;
    snprintf(name, sizeof name, "frame_%05d_cam_%02d_iteration_%07lld.png",
             frame_info(r, pair->frame)->number, view->camera_id, (long long)r->trainer.iteration);
    SPIN_TRY_OUT(spin_path_join(r->o->preview, name, &path));
    SPIN_TRY_OUT(spin_write_beside(path, view->camera.width, view->camera.height, picture, n));
out:
    free(block);
    free(path);
    return status;
}

static spin_status preview(struct retrain *r)
{
    struct spin_player live, source;
    bool with_source = has_source(r);
    int middle = r->clip.n_frames / 2;
    void *block = NULL;
    spin_status status;

    if (!r->o->preview || r->n_test == 0)
        return SPIN_OK;
    SPIN_TRY(spin_folder_make(r->o->preview));
    SPIN_TRY(spin_alloc((size_t)r->clip.n_frames, sizeof(float *), &block));
    for (int f = 0; f < r->clip.n_frames; f++)
        ((float **)block)[f] = r->trainer.frame[f].pos;
    status = spin_player_open_live(&live, &r->device, &r->model, r->trainer.table.p,
                                   r->trainer.heads.p, block);
    if (status == SPIN_OK && with_source)
        status = spin_player_open(&source, &r->device, &r->clip.bundle, false);
    if (status == SPIN_OK)
        status =
            spin_player_show_live(&live, middle, r->counts[middle], frame_info(r, middle)->time);
    for (size_t i = 0; status == SPIN_OK && i < r->n_test; i++)
        if (r->test[i].frame == middle)
            status = preview_view(r, &live, with_source ? &source : NULL, &r->test[i]);
    spin_player_close(&live);
    if (with_source)
        spin_player_close(&source);
    free(block);
    return status;
}

static spin_status look(struct retrain *r)
{
    struct spin_quality q;

    SPIN_TRY(measure(r, true, &q));
    if (q.valid)
        spin_log(0, "iteration %lld: test PSNR %.3f dB, SSIM %.4f", (long long)r->trainer.iteration,
                 q.psnr, q.ssim);
    if (r->log && q.valid) {
        fprintf(
            r->log,
            "{\"iteration\": %lld, \"seconds\": %.3f, \"test_psnr\": %.6f, \"test_ssim\": %.6f}\n",
            (long long)r->trainer.iteration, r->worked_before_s + spin_now_s() - r->worked_s,
            q.psnr, q.ssim);
        fflush(r->log);
    }
    r->report->test = q;
    return preview(r);
}

static const char *const op_names[] = SPIN_OP_NAMES;

/* One line a step; seconds of each op since the line before. */
static void log_step(struct retrain *r, const struct spin_train_values *v,
                     const struct spin_pair *const *pairs, double seconds)
{
    FILE *f = r->log;

    fprintf(f,
            "{\"iteration\": %lld, \"seconds\": %.3f, \"step_s\": %.5f, \"loss\": %.7g, "
            "\"l1\": %.7g, \"ssim\": %.7g, \"views\": [",
            (long long)r->trainer.iteration, r->worked_before_s + spin_now_s() - r->worked_s,
            seconds, v->loss, v->l1, v->ssim);
    for (int i = 0; i < r->o->batch; i++)
        fprintf(f, "%s[%d, %d]", i ? ", " : "", frame_info(r, pairs[i]->frame)->number,
                r->clip.views.view[pairs[i]->view].camera_id);
    fprintf(f, "], \"ops_s\": {");
    for (int i = 0; i < SPIN_N_OPS; i++) {
        fprintf(f, "%s\"%s\": %.6f", i ? ", " : "", op_names[i], r->device.seconds[i]);
        r->device.seconds[i] = 0;
    }
    fprintf(f, "}}\n");
}

/* ---- The loop ----------------------------------------------------------------------------------- */

static bool due(int64_t iteration, int every) { return every > 0 && iteration % every == 0; }

static spin_status stop_or_save(struct retrain *r)
{
    bool last = r->trainer.iteration == r->o->iterations;

    if (spin_cancelled()) {
        SPIN_TRY(save_state(r));
        return spin_fail_cancelled();
    }
    if (last)
        return SPIN_OK;
    if (r->o->save_every > 0 ? due(r->trainer.iteration, r->o->save_every)
                             : spin_now_s() - r->saved_s > save_seconds)
        return save_state(r);
    return SPIN_OK;
}

static spin_status train(struct retrain *r)
{
    struct spin_trainer *t = &r->trainer;
    struct spin_train_item *items;
    const struct spin_pair **pairs;
    struct spin_progress progress;
    struct spin_train_values v = {0};
    double smooth = 0;
    void *block = NULL, *block2 = NULL;
    spin_status status;

    spin_progress_begin(&progress, "retraining", "it", t->iteration, r->o->iterations);
    SPIN_TRY_OUT(spin_alloc((size_t)r->o->batch, sizeof *items, &block));
    SPIN_TRY_OUT(spin_alloc((size_t)r->o->batch, sizeof *pairs, &block2));
    items = block;
    pairs = block2;
    while (t->iteration < r->o->iterations) {
        double start = spin_now_s();

        SPIN_TRY_OUT(plan_batch(r, t->iteration, items, pairs));
        r->device.seconds[SPIN_OP_PIXELS] += spin_now_s() - start;
        SPIN_TRY_OUT(spin_trainer_step(t, items, r->o->batch, &v));
        if (!isfinite(v.loss)) {
            status = spin_fail(SPIN_E_MALFORMED,
                               "the loss is not finite at iteration %lld; lower "
                               "the learning rates, or look for bad points",
                               (long long)t->iteration);
            goto out;
        }
        smooth = smooth > 0 ? 0.98 * smooth + 0.02 * v.loss : v.loss;
        if (r->log)
            log_step(r, &v, pairs, spin_now_s() - start);
        spin_progress_set(&progress, t->iteration, "loss %.4f", smooth);
        SPIN_TRY_OUT(stop_or_save(r));
        if (due(t->iteration, r->o->eval_every) && t->iteration < r->o->iterations)
            SPIN_TRY_OUT(look(r));
    }
    r->report->loss_last = smooth;
    status = SPIN_OK;
out:
    spin_progress_end(&progress);
    free(block);
    free(block2);
    return status;
}

/* ---- The output --------------------------------------------------------------------------------- */

static spin_status write_means(struct retrain *r, struct spin_bundle_writer *w, int frame)
{
    size_t n = r->counts[frame];
    uint64_t shape[2] = {n, 3};
    char name[64];
    void *block = NULL;
    float *ours, *theirs;
    spin_status status;

    SPIN_TRY(spin_alloc(6 * n + 1, sizeof(float), &block));
    ours = block;
    theirs = ours + 3 * n;
    r->device.op->down(&r->device, ours, r->trainer.frame[frame].pos, 3 * n * sizeof(float));
    for (size_t i = 0; i < n; i++)
        memcpy(theirs + 3 * (size_t)r->order[frame][i], ours + 3 * i, 3 * sizeof(float));
    snprintf(name, sizeof name, "network/means/%05d", frame);
    status = spin_npz_write(&w->zip, name, "<f4", 2, shape, theirs);
    free(block);
    return status;
}

static spin_status fill_meta(struct retrain *r, struct spin_bundle_meta *meta)
{
    const struct spin_bundle_meta *from = &r->clip.bundle.meta;
    char *folder = NULL;
    spin_status status;

    SPIN_TRY(spin_bundle_meta_reserve(meta, r->clip.n_frames));
    memcpy(meta->from, from->from, sizeof meta->from);
    memcpy(meta->upstream, from->upstream, sizeof meta->upstream);
    memcpy(meta->variant, from->variant, sizeof meta->variant);
    for (int f = 0; f < r->clip.n_frames; f++) {
        meta->frame[f] = *frame_info(r, f);
        meta->source_index[f] = from->source_index[frame_index(r, f)];
    }
    meta->n_source_frames = from->n_source_frames;
    meta->numbered = from->numbered;
    meta->columns = from->columns;
    meta->still_columns = from->still_columns;
    meta->sh_degree = from->sh_degree;
    memcpy(meta->data_from, r->clip.data_from, sizeof meta->data_from);
    SPIN_TRY(spin_path_folder(r->o->output, &folder));
    status = spin_path_relative(folder, r->clip.data_path, &meta->data_path);
    free(folder);
    return status;
}

static spin_status write_network(struct retrain *r, struct spin_bundle_writer *w)
{
    struct spin_trainer *t = &r->trainer;
    uint64_t features = (uint64_t)r->model.grid.n_features;
    uint64_t table[2] = {t->table.n / features, features}, heads[1] = {t->heads.n};

    for (int f = 0; f < r->clip.n_frames; f++)
        SPIN_TRY(write_means(r, w, f));
    SPIN_TRY(write_array(r, &w->zip, "network/table", 2, table, t->table.p, t->table.n));
    return write_array(r, &w->zip, "network/heads", 1, heads, t->heads.p, t->heads.n);
}

static void set_quality(spin_json *j, const char *key, const struct spin_quality *q)
{
    spin_json *value;

    if (!q->valid) {
        spin_json_set_null(j, key);
        return;
    }
    value = spin_json_object();
    spin_json_set_number(value, "psnr", q->psnr);
    spin_json_set_number(value, "ssim", q->ssim);
    spin_json_set(j, key, value);
}

/* What was learned of the cameras: by id, the log of the gain and the offset, r g b each. */
static spin_status cameras_to_json(struct retrain *r, spin_json **out)
{
    spin_json *all = spin_json_array();
    void *block = NULL;

    SPIN_TRY(spin_alloc(r->trainer.tint.n + 1, sizeof(float), &block));
    r->device.op->down(&r->device, block, r->trainer.tint.p, r->trainer.tint.n * sizeof(float));
    for (size_t i = 0; i < r->trainer.tint.n / 6; i++) {
        spin_json *one = spin_json_object(), *gain = spin_json_array(), *offset = spin_json_array();
        const float *tint = (const float *)block + 6 * i;

        for (int c = 0; c < 3; c++) {
            spin_json_push_number(gain, (double)tint[c]);
            spin_json_push_number(offset, (double)tint[3 + c]);
        }
        spin_json_set_integer(one, "camera", r->camera[i]);
        spin_json_set(one, "log_gain", gain);
        spin_json_set(one, "offset", offset);
        spin_json_push(all, one);
    }
    free(block);
    *out = all;
    return SPIN_OK;
}

/* Nothing in the output tells when or how fast it was made, so equal runs give equal files. */
static spin_status write_output(struct retrain *r)
{
    struct spin_bundle_writer w;
    struct spin_bundle_meta meta;
    spin_json *extra, *network, *cameras = NULL;
    spin_status status;

    memset(&meta, 0, sizeof meta);
    SPIN_TRY(spin_bundle_writer_open(r->o->output, r->o->force || r->o->resume, &w));
    SPIN_TRY_OUT(fill_meta(r, &meta));
    for (int f = 0; f < r->clip.n_frames; f++) {
        SPIN_TRY_OUT(
            spin_bundle_frame(&r->clip.bundle, frame_index(r, f), meta.columns, &r->splats));
        SPIN_TRY_OUT(spin_bundle_write_frame(&w, f, meta.columns, meta.still_columns, &r->splats));
    }
    SPIN_TRY_OUT(write_network(r, &w));
    SPIN_TRY_OUT(cameras_to_json(r, &cameras));
    extra = spin_json_object();
    network = network_to_json(r);
    spin_json_set(network, "cameras", cameras);
    spin_json_set_string(network, "fingerprint", r->fingerprint);
    set_quality(network, "before", &r->report->before);
    set_quality(network, "test", &r->report->test);
    spin_json_set(extra, "network", network);
    status = spin_bundle_writer_finish(&w, &meta, extra);
    spin_bundle_meta_free(&meta);
    return status;
out:
    spin_bundle_meta_free(&meta);
    spin_bundle_writer_abandon(&w);
    return status;
}

/* ---- From start to end -------------------------------------------------------------------------- */

/* --resume after the run had already finished: the output is there and was made this way. */
static bool already_done(struct retrain *r)
{
    struct spin_bundle bundle;
    const char *text;
    bool same;

    if (spin_bundle_open(r->o->output, &bundle) != SPIN_OK)
        return false;
    text = spin_json_string(spin_json_get(spin_json_get(bundle.json, "network"), "fingerprint"));
    same = text && strcmp(text, r->fingerprint) == 0;
    spin_bundle_close(&bundle);
    return same;
}

static spin_status check_output(struct retrain *r, bool *done)
{
    const struct spin_retrain_options *o = r->o;
    bool part = spin_path_exists(r->part);

    *done = false;
    if (spin_path_exists(o->output) && !o->force) {
        if (o->resume && !part && already_done(r)) {
            *done = true;
            return SPIN_OK;
        }
        if (!o->resume || !part)
            return spin_fail(SPIN_E_IO, "'%s' exists; use --force to overwrite", o->output);
    }
    if (part && !o->resume && !o->force)
        return spin_fail(SPIN_E_IO,
                         "an unfinished run is in '%s': use --resume to go on, or "
                         "--force to start anew",
                         r->part);
    return SPIN_OK;
}

static spin_status prepare(struct retrain *r)
{
    const struct spin_retrain_options *o = r->o;
    struct spin_train_rates *rates = &r->trainer.rates;
    size_t budget = r->report->bytes_available / 3;
    void *block = NULL;

    if (r->report->bytes_needed > r->report->bytes_available)
        return spin_fail(SPIN_E_MEMORY,
                         "needs about %.1f GB of memory and %.1f GB are free: lower "
                         "--hash-log2 or --scale, or take a --range of the frames",
                         (double)r->report->bytes_needed / 1e9,
                         (double)r->report->bytes_available / 1e9);
    SPIN_TRY(spin_pixels_open(&r->clip.views, budget, &r->pixels));
    SPIN_TRY(spin_alloc((size_t)o->batch * 3 * r->max_pixels, sizeof(float), &block));
    r->truth = block;
    SPIN_TRY(sort_frames(r));
    SPIN_TRY(spin_trainer_open(&r->trainer, &r->device, &r->model, r->clip.n_frames, r->counts,
                               r->max_pixels, r->max_tiles, o->camera_colour ? r->n_cameras : 0));
    for (int f = 0; f < r->clip.n_frames; f++)
        r->trainer.frame[f].time = frame_info(r, f)->time;
    rates->table = o->lr_table;
    rates->head[SPIN_HEAD_SCALE] = o->lr_scale * o->lr_head_factor;
    rates->head[SPIN_HEAD_ROTATION] = o->lr_rotation * o->lr_head_factor;
    rates->head[SPIN_HEAD_SH] = o->lr_sh * o->lr_head_factor;
    rates->head[SPIN_HEAD_OPACITY] = o->lr_opacity * o->lr_head_factor;
    rates->position = o->lr_position * r->extent;
    rates->tint = o->lr_camera;
    rates->end = 1e-7;
    rates->iterations = o->iterations;
    rates->warmup = o->warmup >= 0 ? o->warmup : o->iterations / 40;
    r->trainer.lambda_dssim = (float)o->lambda_dssim;
    memcpy(r->trainer.background, o->background, sizeof r->trainer.background);
    if (o->resume && spin_path_exists(r->part))
        return load_state(r);
    return start_fresh(r);
}

static spin_status open_log(struct retrain *r)
{
    if (!r->o->log)
        return SPIN_OK;
    r->log = fopen(r->o->log, r->o->resume ? "a" : "w");
    if (!r->log)
        return spin_fail(SPIN_E_IO, "cannot write '%s'", r->o->log);
    return SPIN_OK;
}

static void say_plan(const struct retrain *r)
{
    spin_log(0, "%d frames, %.0f splats a frame, %zu training and %zu test views, %s",
             r->clip.n_frames, r->clip.n_mean, r->n_train, r->n_test, r->device.description);
    spin_log(0, "%.1f M parameters in the table, %.1f %% of the points outside the unit ball",
             (double)r->model.n_table / 1e6, 100 * r->report->outside_ball);
    if (r->report->outside_ball > 0.9)
        spin_warn("nearly all points lie outside the unit ball: consider --scene-normalise auto");
}

static spin_status work(struct retrain *r)
{
    const struct spin_retrain_options *o = r->o;
    bool done = false;

    SPIN_TRY(check_options(o));
    SPIN_TRY(open_clip(r));
    SPIN_TRY(plan(r));
    r->report->frames = r->clip.n_frames;
    r->report->splats_mean = r->clip.n_mean;
    r->report->iterations = o->iterations;
    r->report->seconds_estimated = guess_seconds(r);
    SPIN_TRY(spin_device_open(o->device, o->n_threads, &r->device));
    memcpy(r->report->device, r->device.description, sizeof r->report->device);
    if (o->dry_run)
        return SPIN_OK;
    SPIN_TRY(make_fingerprint(r));
    SPIN_TRY(check_output(r, &done));
    if (done) {
        spin_log(0, "'%s' is already finished", o->output);
        return SPIN_OK;
    }
    SPIN_TRY(prepare(r));
    SPIN_TRY(open_log(r));
    say_plan(r);
    if (has_source(r)) {
        SPIN_TRY(measure(r, false, &r->report->before));
        if (r->report->before.valid)
            spin_log(0, "before: test PSNR %.3f dB, SSIM %.4f", r->report->before.psnr,
                     r->report->before.ssim);
    }
    memset(r->device.seconds, 0, sizeof r->device.seconds);
    r->worked_s = r->saved_s = spin_now_s();
    SPIN_TRY(train(r));
    r->report->seconds = r->worked_before_s + spin_now_s() - r->worked_s;
    r->report->seconds_per_iteration = r->report->seconds / o->iterations;
    SPIN_TRY(look(r));
    SPIN_TRY(write_output(r));
    remove(r->part);
    return SPIN_OK;
}

static void close_all(struct retrain *r)
{
    if (r->log)
        fclose(r->log);
    spin_trainer_close(&r->trainer);
    spin_device_close(&r->device);
    for (int f = 0; r->order && f < r->clip.n_frames; f++)
        free(r->order[f]);
    free(r->order);
    free(r->counts);
    free(r->camera);
    free(r->truth);
    free(r->train);
    free(r->test);
    free(r->sequence);
    free(r->part);
    free(r->fingerprint);
    spin_splats_free(&r->splats);
    spin_pixels_close(&r->pixels);
    spin_clip_close(&r->clip);
}

spin_status spin_retrain(const struct spin_retrain_options *o, struct spin_retrain_report *report)
{
    struct retrain r;
    spin_status status;

    memset(&r, 0, sizeof r);
    memset(report, 0, sizeof *report);
    r.o = o;
    r.report = report;
    r.part = o->output ? malloc(strlen(o->output) + 6) : NULL;
    if (r.part)
        sprintf(r.part, "%s.part", o->output);
    status = work(&r);
    close_all(&r);
    if (status != SPIN_OK && status != SPIN_E_CANCELLED && o->input)
        return spin_more(status, "cannot retrain '%s'", o->input);
    return status;
}
