/* Makes the plan of a retraining from its options: opens the clip, computes the sizes of arrays,
 * and estimates memory and, for --dry-run, time. */
#include "train/plan.h"

#include "base/base.h"
#include "train/checkpoint.h"
#include "train/trainer.h"
#include "train/options.h"
#include "train/train_frame.h"

/* Memory of the program without its data, in bytes. The additional 130 MB of OpenImageIO, which
 * loads images other than PNG and JPEG, are not included. */
static const size_t program_bytes = 10 << 20;

/* Number of frames whose pages should be in memory if frames are kept in temporary files. */
enum { SCRATCH_FRAMES = 4 };

/* ---- Options --------------------------------------------------------------------------------- */

/* Fails if no temporary file can be created in the folder of --scratch. */
static spin_status check_scratch(const char *folder)
{
    void *block;

    SPIN_TRY(spin_pages_reserve_in(folder, 1, &block));
    spin_pages_release(block);
    if (spin_path_is_in_memory(folder))
        spin_warn("'%s' is in memory, not on a disk: --scratch saves no memory there", folder);
    return SPIN_OK;
}

static spin_status check_options(const struct spin_retrain_options *o)
{
    if (!o->input || (!o->output && !o->dry_run))
        return spin_misuse("no input or no output was given");
    SPIN_TRY(spin_options_check(o));
    if (o->method == SPIN_METHOD_FRAMES && o->refine < 1)
        return spin_misuse(
            "--method frames needs a number of iterations per frame: give it with --refine");
    if (o->scratch && strcmp(o->scratch, "off") != 0)
        SPIN_TRY(check_scratch(o->scratch));
    if (o->method == SPIN_METHOD_TRACKS && !o->tracks)
        return spin_misuse("--method tracks does not support --tracks off: use --tracks auto");
    if ((o->method == SPIN_METHOD_TRACKS || o->method == SPIN_METHOD_4D) && o->refine > 0)
        return spin_misuse("--method %s does not support --refine, since refined frames have no "
                           "splats in common: omit --refine",
                           o->method == SPIN_METHOD_4D ? "4d" : "tracks");
    return SPIN_OK;
}

/* ---- The clip -------------------------------------------------------------------------------- */

int spin_plan_index(const struct spin_plan *plan, int frame) { return plan->clip.frame[frame]; }

const struct spin_frame_info *spin_plan_info(const struct spin_plan *plan, int frame)
{
    return &plan->clip.bundle.meta.frame[spin_plan_index(plan, frame)];
}

int spin_plan_middle_frame(const struct spin_plan *plan)
{
    int f = plan->clip.n_frames / 2;

    while (plan->counts[f] == 0)
        f = (f + 1) % plan->clip.n_frames;
    return f;
}

spin_status spin_plan_check_means(const struct spin_plan *plan, int frame, bool refined,
                                  const struct spin_splats *s)
{
    for (size_t i = 0; i < s->n * 3; i++)
        if (!isfinite(s->means[i]))
            return spin_malformed("'%s': array '%s/means/%05d' has a value that is not finite in "
                                  "row %zu: import the clip again",
                                  plan->o->input, refined ? "refined" : "source",
                                  spin_plan_index(plan, frame), i / 3);
    return SPIN_OK;
}

/* Sets plan->camera to the ids of the training cameras, in ascending order and without duplicates.
 */
static spin_status list_cameras(struct spin_plan *plan)
{
    SPIN_TRY(spin_alloc(plan->n_train + 1, sizeof *plan->camera, (void **)&plan->camera));
    for (size_t i = 0; i < plan->n_train; i++) {
        int id = plan->clip.views.view[plan->train[i].view].camera_id, k = 0;

        while (k < plan->n_cameras && plan->camera[k] < id)
            k++;
        if (k < plan->n_cameras && plan->camera[k] == id)
            continue;
        memmove(plan->camera + k + 1, plan->camera + k,
                (size_t)(plan->n_cameras++ - k) * sizeof *plan->camera);
        plan->camera[k] = id;
    }
    return SPIN_OK;
}

/* Allocates the initial exposures of cameras and lenses, and sets them to zero. */
static spin_status reserve_exposure(struct spin_plan *plan)
{
    return spin_alloc((size_t)(plan->n_cameras + plan->lenses.n) + 1, SPIN_EXPOSURE * sizeof(float),
                      (void **)&plan->exposure);
}

bool spin_plan_has_source(const struct spin_plan *plan)
{
    return (plan->clip.bundle.meta.columns & SPIN_COL_ATTRIBUTES) == SPIN_COL_ATTRIBUTES;
}

bool spin_plan_has_residual(const struct spin_plan *plan)
{
    return plan->o->residual != SPIN_RESIDUAL_OFF || plan->o->tracks;
}

/* Densification of a single frame starts after 500 iterations, as in 3DGS, or after a fifth of its
 * iterations if that is earlier. A clip is densified only while static tracks are trained. */
struct spin_schedule spin_plan_schedule(const struct spin_plan *plan)
{
    const struct spin_retrain_options *o = plan->o;
    int fifth = o->iterations / 5;

    if (o->method != SPIN_METHOD_FRAMES)
        return (struct spin_schedule){0, (int64_t)ceil(o->densify_until * o->track_iterations),
                                      o->densify_every};
    return (struct spin_schedule){fifth < 500 ? fifth : 500, 3 * (int64_t)o->iterations / 4,
                                  o->densify ? 100 : 0};
}

bool spin_plan_densifies(const struct spin_plan *plan)
{
    struct spin_schedule schedule = spin_plan_schedule(plan);

    return plan->o->tracks && plan->o->refine == 0 && schedule.every > 0 &&
           schedule.every < schedule.until;
}

struct spin_frame_size spin_plan_frame_size(const struct spin_plan *plan, size_t n)
{
    /* With --method 4d, tracks store all values. */
    size_t own = plan->o->method == SPIN_METHOD_4D ? 0 : n;

    return (struct spin_frame_size){n, own, own, spin_plan_has_residual(plan) ? own : 0};
}

int spin_plan_camera(const struct spin_plan *plan, int id)
{
    int k = 0;

    while (plan->camera[k] != id)
        k++;
    return k;
}

static void measure_images(struct spin_plan *plan)
{
    for (size_t i = 0; i < plan->clip.views.n; i++) {
        struct spin_camera_f32 cam = spin_camera_f32_from(&plan->clip.views.view[i].camera);
        size_t pixels = (size_t)cam.width * (size_t)cam.height;
        size_t tiles = (size_t)cam.tiles_x * (size_t)cam.tiles_y;

        plan->max_pixels = pixels > plan->max_pixels ? pixels : plan->max_pixels;
        plan->max_tiles = tiles > plan->max_tiles ? tiles : plan->max_tiles;
    }
    plan->edges = 0.05 * (double)plan->max_pixels; /* until they are counted */
}

/* Computes the extent if all cameras are at one position: 1.1 times the distance of the first
 * training camera from the median of the points, as if the cameras formed a ring around the points.
 * This distance is too small if the camera is among the points, so the extent is at least 1.1 times
 * the radius of the ball around the median that contains 90 % of the points. */
static spin_status measure_one_place(struct spin_plan *plan, double *extent)
{
    struct spin_camera_f32 cam =
        spin_camera_f32_from(&plan->clip.views.view[plan->train[0].view].camera);
    int f = spin_plan_middle_frame(plan);
    SPIN_LEAVES(spin_splats_free) struct spin_splats splats = {0};
    SPIN_LEAVES(spin_point_sample_close) struct spin_point_sample sample = {0};
    double distance = 0;
    float centre[3], radius;

    SPIN_TRY(spin_point_sample_open(&sample, 1));
    SPIN_TRY(
        spin_bundle_frame(&plan->clip.bundle, spin_plan_index(plan, f), SPIN_COL_MEANS, &splats));
    SPIN_TRY(spin_plan_check_means(plan, f, false, &splats));
    spin_point_sample_add(&sample, &splats);
    radius = spin_point_sample_enclose(&sample, centre);
    for (int c = 0; c < 3; c++)
        distance += pow((double)cam.centre[c] - (double)centre[c], 2);
    *extent = 1.1 * fmax(sqrt(distance), (double)radius);
    return SPIN_OK;
}

/* Sets plan->extent, by which 3DGS scales the learning rate of positions and the thresholds of
 * densification. If all cameras are at one position, spin_views_extent() is 0, and the extent is
 * computed from the points instead. */
static spin_status plan_extent(struct spin_plan *plan)
{
    double one_place;

    plan->extent = spin_views_extent(&plan->clip.views);
    SPIN_TRY(measure_one_place(plan, &one_place));
    if (plan->extent <= 1e-6 * one_place || plan->extent == 0) {
        plan->extent = one_place > 0 ? one_place : 1;
        spin_log(0,
                 "all training cameras are at one position: the camera extent, %.4g, is computed "
                 "from the distance to the points",
                 plan->extent);
    }
    if (!isfinite(plan->extent))
        return spin_malformed(
            "the extent of the training cameras is not finite: check their poses");
    return SPIN_OK;
}

enum { BASE_RESOLUTION = 8 }; /* resolution of the coarsest level along x, y, z and t */

/* Computes the layout of the network from the options. */
static spin_status plan_field(struct spin_plan *plan)
{
    static const int base[4] = {BASE_RESOLUTION, BASE_RESOLUTION, BASE_RESOLUTION, BASE_RESOLUTION};
    const struct spin_retrain_options *o = plan->o;
    int finest[4];

    memcpy(finest, o->finest_resolution, sizeof finest);
    if (finest[3] == 0)
        finest[3] = plan->clip.n_frames > 16 ? plan->clip.n_frames : 16;
    SPIN_TRY(spin_field_plan(
        &plan->field, o->levels, o->features, o->hash_log2, o->hidden,
        o->method == SPIN_METHOD_NETWORK || o->method == SPIN_METHOD_FRAMES ? o->sh_degree : 0,
        base, finest));
    plan->field.heads.relu = o->relu;
    plan->field.antialias = o->antialias;
    plan->field.transform.raw = o->normalise == SPIN_NORMALISE_NONE;
    plan->field.time_first = plan->field.time_last = spin_plan_info(plan, 0)->time;
    for (int f = 1; f < plan->clip.n_frames; f++) {
        double time = spin_plan_info(plan, f)->time;

        plan->field.time_first = fmin(plan->field.time_first, time);
        plan->field.time_last = fmax(plan->field.time_last, time);
    }
    return SPIN_OK;
}

/* ---- Derived settings ------------------------------------------------------------------------ */

/* Returns the number of frames whose splats an iteration evaluates. */
static int decodings(const struct spin_retrain_options *o)
{
    return (o->batch + o->views_per_frame - 1) / o->views_per_frame;
}

/* Warns if an iteration has fewer images than there are ranks: since the images are divided among
 * the ranks, some ranks are then idle. */
static void warn_idle_ranks(const struct spin_retrain_options *o)
{
    int n = spin_n_ranks();

    if (o->method != SPIN_METHOD_FRAMES && o->batch < n)
        spin_warn(
            "an iteration has %d image%s (--batch %d), so only %d of %d processes work%s: give "
            "--batch %d, or start fewer processes",
            o->batch, o->batch == 1 ? "" : "s", o->batch, o->batch, n, o->batch == 1 ? "s" : "", n);
}

bool spin_plan_is_lazy(const struct spin_plan *plan)
{
    return plan->device->op->lazy_adam_enable && spin_n_ranks() == 1 &&
           spin_lazy_pays(&plan->field, decodings(plan->o) * plan->clip.n_mean,
                          plan->o->iterations);
}

bool spin_plan_is_weighted(const struct spin_plan *plan) { return plan->o->dynamic_weight != 1; }

size_t spin_plan_image_bytes(const struct spin_plan *plan)
{
    return 3 * plan->max_pixels + (spin_plan_is_weighted(plan) ? (plan->max_pixels + 7) / 8 : 0);
}

bool spin_plan_starts_from_source(const struct spin_plan *plan)
{
    return plan->o->refine_start == SPIN_REFINE_FROM_SOURCE;
}

unsigned spin_plan_point_columns(const struct spin_plan *plan)
{
    unsigned columns = plan->clip.bundle.meta.columns;

    return SPIN_COL_MEANS | (columns & SPIN_COL_RGB ? SPIN_COL_RGB : columns & SPIN_COL_SH) |
           (spin_plan_has_source(plan) ? SPIN_COL_ATTRIBUTES : 0);
}

unsigned spin_plan_start_columns(const struct spin_plan *plan)
{
    return spin_plan_starts_from_source(plan) ? SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES
                                              : spin_plan_point_columns(plan);
}

int spin_plan_sh_increase_every(const struct spin_plan *plan)
{
    if (spin_plan_starts_from_source(plan))
        return 0;
    return plan->o->sh_increase_every > 0 ? plan->o->sh_increase_every : SPIN_SH_INCREASE_EVERY;
}

int spin_sh_degree_reached(int sh_degree, int increase_every, int iterations)
{
    int reached = increase_every > 0 ? (iterations - 1) / increase_every : sh_degree;

    return reached < sh_degree ? reached : sh_degree;
}

int spin_plan_frame_sh_degree(const struct spin_plan *plan)
{
    int most = plan->o->sh_degree, source = plan->clip.bundle.meta.sh_degree;

    if (plan->o->method != SPIN_METHOD_FRAMES)
        return 0;
    if (spin_plan_starts_from_source(plan))
        most = most < source ? most : source;
    return spin_sh_degree_reached(most, spin_plan_sh_increase_every(plan), plan->o->refine);
}

/* ---- A single frame, and the trainer --------------------------------------------------------- */

spin_status spin_plan_of_frame(const struct spin_plan *clip, int frame, struct spin_device *device,
                               struct spin_plan *plan)
{
    struct spin_retrain_options *o = &plan->options;
    size_t n = 0;

    *plan = *clip;
    plan->o = o;
    plan->device = device;
    plan->train = NULL;
    plan->camera = NULL;
    plan->exposure = NULL;
    plan->n_train = plan->n_test = 0;
    plan->n_cameras = 0;
    plan->counts = &plan->n_of_frame;
    plan->n_of_frame = clip->counts[frame];
    plan->clip.frame += frame;
    plan->clip.n_frames = 1;
    plan->field.sh_degree = spin_plan_frame_sh_degree(clip);
    *o = *clip->o;
    o->method = SPIN_METHOD_FRAMES;
    o->iterations = o->refine;
    o->batch = o->views_per_frame = 1;
    o->sh_increase_every = spin_plan_sh_increase_every(clip);
    for (size_t i = 0; i < clip->n_train; i++)
        n += clip->train[i].frame == frame;
    SPIN_TRY(spin_alloc(n + 1, sizeof *plan->train, (void **)&plan->train));
    for (size_t i = 0; i < clip->n_train; i++)
        if (clip->train[i].frame == frame)
            plan->train[plan->n_train++] = (struct spin_pair){0, clip->train[i].view};
    SPIN_TRY(list_cameras(plan));
    SPIN_TRY(reserve_exposure(plan));
    memcpy(plan->exposure + SPIN_EXPOSURE * plan->n_cameras,
           clip->exposure + SPIN_EXPOSURE * clip->n_cameras,
           SPIN_EXPOSURE * (size_t)plan->lenses.n * sizeof *plan->exposure);
    return SPIN_OK;
}

void spin_plan_close_frame(struct spin_plan *plan)
{
    free(plan->train);
    free(plan->camera);
    free(plan->exposure);
}

/* With a Polyak average, learning rates decay to this share of their peak. Tuned together with the
 * default of --average, on the clips "court" and "basketball" (docs/results.md). */
static const double averaged_floor = 0.2;

static bool averages(const struct spin_plan *plan)
{
    return plan->o->average > 0 && plan->o->method != SPIN_METHOD_FRAMES &&
           plan->o->method != SPIN_METHOD_NETWORK;
}

static struct spin_train_rates clip_rates(const struct spin_plan *plan)
{
    const struct spin_retrain_options *o = plan->o;
    struct spin_train_rates rates = {
        .table = o->lr_table,
        .head = {[SPIN_HEAD_SCALE] = o->lr_scale * o->lr_head_factor,
                 [SPIN_HEAD_ROTATION] = o->lr_rotation * o->lr_head_factor,
                 [SPIN_HEAD_SH] = o->lr_sh * o->lr_head_factor,
                 [SPIN_HEAD_OPACITY] = o->lr_opacity * o->lr_head_factor},
        .position = o->lr_position * plan->extent,
        .tracked = o->lr_tracked,
        .displacement = o->lr_displacement * plan->extent,
        .exposure = o->lr_exposure,
        .lenses_stay = plan->lenses_stay,
        .end = 1e-7,
        .floor = averages(plan) ? averaged_floor : 0,
        .warmup = o->warmup >= 0 ? o->warmup : o->iterations / 40,
        .iterations = o->iterations,
        .track_iterations = o->track_iterations,
    };

    for (int k = 0; k < SPIN_HEADS; k++) {
        rates.residual[k] = spin_rate_3dgs[k] * o->lr_residual;
        rates.track[k] = spin_rate_3dgs[k] * o->lr_track;
    }
    return rates;
}

spin_status spin_plan_open_trainer(const struct spin_plan *plan, struct spin_device *device,
                                   struct spin_trainer_size *size, struct spin_trainer *t)
{
    const struct spin_retrain_options *o = plan->o;
    bool exposures = o->learn_exposure == SPIN_EXPOSURE_ON;

    size->motion = o->method == SPIN_METHOD_4D;
    size->network = o->method == SPIN_METHOD_NETWORK;
    size->alone = o->method == SPIN_METHOD_FRAMES;
    size->sh_degree = size->alone ? plan->field.sh_degree : 0;
    size->max_items = o->batch;
    size->max_pixels = plan->max_pixels;
    size->max_tiles = plan->max_tiles;
    size->n_cameras = exposures ? plan->n_cameras : 0;
    size->n_lenses = plan->lenses.n;
    size->exposure = plan->exposure;
    /* A device that only counts has no memory, hence no files either. */
    size->scratch = size->alone || device != plan->device ? NULL : plan->scratch;
    SPIN_TRY(spin_trainer_open(t, device, &plan->field, size));
    t->rates = size->alone ? spin_rates_3dgs(plan->extent, o->iterations) : clip_rates(plan);
    if (size->alone)
        t->rates.exposure = o->lr_exposure;
    t->lambda_dssim = (float)o->lambda_dssim;
    t->sh_increase_every = o->sh_increase_every;
    memcpy(t->background, o->background, sizeof t->background);
    if (averages(plan)) {
        struct spin_schedule split = spin_plan_schedule(plan);

        t->average = spin_average_of(o->average, split.every > 0 ? split.until : 0, o->iterations);
    }
    return t->network && spin_plan_is_lazy(plan) ? spin_trainer_enable_lazy_adam(t) : SPIN_OK;
}

/* ---- Memory and time ------------------------------------------------------------------------- */

/* Limits an estimated factor of growth by --max-points. */
static double limit_growth(const struct spin_plan *plan, double factor)
{
    double most = plan->o->max_points / fmax(plan->clip.n_mean, 1);

    return plan->o->max_points > 0 ? fmin(factor, fmax(most, 1)) : factor;
}

/* Returns the estimated factor by which densification multiplies the number of splats of a frame.
 * It adds splats at the edges in the images, in proportion to the square root of their pixels. The
 * constants of this function and the next were fitted to the clips in tests/bench/README.md. */
static double guess_growth(const struct spin_plan *plan)
{
    return spin_plan_densifies(plan)
               ? limit_growth(plan, 1 + 415 * sqrt(plan->edges) / fmax(plan->clip.n_mean, 1))
               : 1;
}

/* The same for refinement: a densification adds splats by the same relation, but not more than
 * three fifths. */
static double guess_refined_growth(const struct spin_plan *plan)
{
    struct spin_retrain_options o = *plan->o;
    const struct spin_plan one = {.o = &o};
    struct spin_schedule s;
    double n = fmax(plan->clip.n_mean, 1), grown = n;

    o.method = SPIN_METHOD_FRAMES;
    o.iterations = o.refine;
    s = spin_plan_schedule(&one);
    for (int64_t i = s.every; i > 0 && i < s.until; i += s.every)
        grown += i > s.first ? fmin(0.6 * grown, 210 * sqrt(plan->edges)) : 0;
    return limit_growth(plan, grown / n);
}

size_t spin_plan_refine_bytes(const struct spin_plan *plan)
{
    size_t n = (size_t)(guess_refined_growth(plan) * (double)plan->clip.n_max);
    size_t host = 2 * sizeof(struct spin_refine_point);
    struct spin_frame_size frame = {n, n, n, n};
    struct spin_trainer_size size = {.n_frames = 1, .frame = &frame, .tracked = true};
    struct spin_trainer t = {0};
    struct spin_image_store images = {0};
    struct spin_counting_device c;
    struct spin_plan one = {0};
    spin_status status;

    spin_device_count(&c, plan->device);
    SPIN_TRY_OUT(spin_plan_of_frame(plan, plan->train[0].frame, &c.device, &one));
    SPIN_TRY_OUT(spin_plan_open_trainer(&one, &c.device, &size, &t));
    status = spin_image_store_open(&images, &c.device, one.n_train, one.max_pixels, SPIN_IMAGE_RGB8,
                                   spin_plan_is_weighted(plan));
    if (t.sh_width > 0)
        host += 6 * SPIN_REFINE_SH * sizeof(float);
out:
    spin_image_store_close(&images);
    spin_trainer_close(&t);
    spin_plan_close_frame(&one);
    return status == SPIN_OK ? c.bytes + n * host + spin_raster_grows(n, plan->max_pixels, true)
                             : SIZE_MAX;
}

/* Estimates how many splats n splats become during the training. */
static size_t grown_count(const struct spin_plan *plan, size_t n)
{
    return (size_t)((double)n * guess_growth(plan));
}

/* Estimates the sizes of a frame at the end of the training. */
static struct spin_frame_size grown_size(const struct spin_plan *plan, int f)
{
    struct spin_frame_size size =
        plan->sizes ? plan->sizes[f] : spin_plan_frame_size(plan, plan->counts[f]);

    return (struct spin_frame_size){grown_count(plan, size.n), grown_count(plan, size.n_free),
                                    grown_count(plan, size.n_pos),
                                    grown_count(plan, size.n_residual)};
}

/* Sizes in bytes of the arrays that grow with the number of frames. */
struct clip_bytes {
    size_t frames;     /* all arrays of struct spin_train_frame */
    size_t statistics; /* those of `frames` that are released after the last densification */
    size_t permutations, average;
};

/* Opens and closes all objects of a training, on a device that only counts allocated memory. Before
 * tracks are found, the count is an upper bound: it assumes that all splats own their values and
 * that there are as many tracks as splats. */
static spin_status open_training(const struct spin_plan *plan, struct spin_device *device,
                                 struct clip_bytes *of)
{
    const struct spin_retrain_options *o = plan->o;
    size_t n_frames = (size_t)plan->clip.n_frames, most = grown_count(plan, plan->clip.n_max);
    size_t n_averaged = 0;
    struct spin_frame_size *frame = NULL;
    struct spin_trainer_size size = {.n_frames = plan->clip.n_frames,
                                     .tracked = o->tracks || plan->n_rows > 0,
                                     .n_tracks = plan->sizes ? grown_count(plan, plan->n_tracks)
                                                 : o->tracks ? most
                                                             : plan->n_rows};
    struct spin_trainer t = {0};
    struct spin_image_store images = {0};
    struct spin_field_eval evaluation = {0};
    spin_status status;

    SPIN_TRY(spin_alloc(n_frames, sizeof *frame, (void **)&frame));
    for (size_t f = 0; f < n_frames; f++)
        frame[f] = grown_size(plan, (int)f);
    size.frame = frame;
    SPIN_TRY_OUT(spin_plan_open_trainer(plan, device, &size, &t));
    SPIN_TRY_OUT(spin_field_eval_open(&evaluation, device, t.network, false, most, false));
    if (averages(plan))
        SPIN_TRY_OUT(spin_average_values(&t, &n_averaged));
    of->average = n_averaged * sizeof(float);
    for (size_t f = 0; f < n_frames; f++) {
        size_t statistics;

        of->frames += spin_train_frame_bytes(frame[f], t.sh_width, t.tracked, &statistics);
        of->statistics += statistics;
        of->permutations += frame[f].n * sizeof(uint32_t);
    }
    status = spin_image_store_open(&images, device, (size_t)o->batch, plan->max_pixels,
                                   SPIN_IMAGE_RGB8, spin_plan_is_weighted(plan));
out:
    spin_image_store_close(&images);
    spin_field_eval_close(&evaluation, t.network);
    spin_trainer_close(&t);
    free(frame);
    return status;
}

/* Returns the size in bytes of the scratch memory inside the device (src/device): gradients for
 * each level of the hash grid; on a GPU also activations for a chunk of splats, positions and keys
 * for sorting, and fixed-point sums. */
static size_t scratch_bytes(const struct spin_plan *plan)
{
    const struct spin_device *d = plan->device;
    size_t frames =
        (size_t)(plan->o->batch < d->frames_at_once ? plan->o->batch : d->frames_at_once);
    size_t n = frames * plan->clip.n_max, chunk = n < (1 << 15) ? n : 1 << 15;
    bool network = plan->o->method == SPIN_METHOD_NETWORK;
    size_t bytes = network ? n * (size_t)plan->field.grid.n_levels * 4 * sizeof(float) : 0;

    if (d->is_host)
        return bytes;
    bytes += 16 * n + 160 * plan->clip.n_max + 24 * plan->max_pixels;
    if (network)
        bytes +=
            chunk * (size_t)(6 * plan->field.heads.hidden + plan->field.heads.n_in) * sizeof(float);
    return bytes + (network && d->deterministic ? plan->field.n_table * sizeof(uint64_t) : 0);
}

/* Estimates the memory for training the clip, in bytes: *of_device on the device, *of_host on the
 * host, and *of_clip for arrays that grow with the number of frames, which are included in the
 * other two. */
static void training_bytes(const struct spin_plan *plan, size_t *of_device, size_t *of_host,
                           size_t *of_clip)
{
    const struct spin_device *d = plan->device;
    size_t image = 3 * plan->max_pixels * sizeof(float);
    int views = d->views_at_once < plan->o->batch ? d->views_at_once : plan->o->batch;
    struct spin_counting_device c;
    struct clip_bytes of = {0};
    size_t most = grown_count(plan, plan->clip.n_max), released = 0;

    spin_device_count(&c, d);
    *of_host = most * SPIN_ATTR * sizeof(float) + 12 * image;
    *of_device = SIZE_MAX / 4; /* result if open_training() fails: more than any device has */
    *of_clip = 0;
    if (open_training(plan, &c.device, &of) != SPIN_OK)
        return;
    /* The average begins after the statistics are released. */
    if (d->is_host)
        released = of.statistics < of.average ? of.statistics : of.average;
    *of_clip = of.frames + of.permutations + of.average - released;
    *of_host += of.permutations + of.average;
    *of_device = c.bytes - released + scratch_bytes(plan) +
                 (size_t)views * spin_raster_grows(most, plan->max_pixels, true);
}

/* Sets the budget of the image cache in host memory: a third of `available`, but at most available
 * - needed, and at least `held`, the size of the images already cached. Images beyond the budget
 * are decoded again for each use. Returns the size that the cache will reach: the budget or, if
 * smaller, the size of all images. All sizes are in bytes. */
static size_t plan_pixels(struct spin_plan *plan, size_t available, size_t needed, size_t held)
{
    size_t all = 0, most = available / 3;

    for (size_t i = 0; i < plan->n_train + plan->n_test; i++) {
        size_t view = i < plan->n_train ? plan->train[i].view : plan->test[i - plan->n_train].view;
        const struct spin_camera *c = &plan->clip.views.view[view].camera;

        all += 3 * (size_t)c->width * (size_t)c->height;
    }
    if (needed >= available)
        most = 0;
    else if (most > available - needed)
        most = available - needed;
    plan->pixels_budget = most > held ? most : held;
    return all < plan->pixels_budget ? all : plan->pixels_budget;
}

/* Returns the size in bytes of the gradients that a rank contributes to the all-reduces of an
 * iteration: those of the network, and those of the values of splats or, with --method 4d, of 4D
 * splats. The result is an upper bound, which assumes that no splats share values through a track.
 */
static double step_bytes(const struct spin_plan *plan)
{
    double own = spin_plan_has_residual(plan) ? SPIN_TRACK : 3;
    double floats =
        own * (plan->n_rows > 0 ? (double)plan->n_rows : plan->o->batch * plan->clip.n_mean);

    if (plan->o->method == SPIN_METHOD_NETWORK)
        floats += (double)plan->field.n_table + (double)plan->field.n_heads;
    return sizeof(float) * floats;
}

/* Decides whether the arrays of the frames are kept in temporary files: if the needed memory is
 * insufficient, and the arrays are larger than the pages of a few frames, which stay in memory.
 * Returns the number of bytes that this saves. */
static size_t plan_scratch(struct spin_plan *plan, size_t needed, size_t of_clip)
{
    struct spin_retrain_report *report = plan->report;
    size_t pages = SCRATCH_FRAMES * (of_clip / (size_t)plan->clip.n_frames);
    bool possible = plan->scratch_folder && plan->device->is_host && of_clip > pages &&
                    needed <= spin_addresses_available();

    plan->scratch = possible && needed > report->bytes_available ? plan->scratch_folder : NULL;
    report->bytes_scratch = plan->scratch ? of_clip : 0;
    report->bytes_disk = plan->scratch ? spin_path_free_bytes(plan->scratch) : 0;
    return plan->scratch ? of_clip - pages : 0;
}

/* Estimates the memory of the run for the report. On a GPU, device memory and host memory must both
 * be sufficient; the report contains the numbers of host memory if only host memory is
 * insufficient, otherwise those of device memory. held: size in bytes of the decoded images that
 * are already cached. */
static void plan_memory(struct spin_plan *plan, size_t held)
{
    struct spin_retrain_report *report = plan->report;
    size_t of_device, of_host, of_clip, available, refining = spin_plan_refine_bytes(plan);

    training_bytes(plan, &of_device, &of_host, &of_clip);
    if (plan->o->refine > 0 &&
        (plan->o->method == SPIN_METHOD_FRAMES || of_device + of_host < refining)) {
        of_device = refining;
        of_host = of_clip = 0;
    }
    report->ranks = spin_n_ranks();
    if (plan->o->method != SPIN_METHOD_FRAMES)
        report->bytes_sent = (spin_n_ranks() > 1 ? spin_n_ranks() : 0) * step_bytes(plan);
    of_host += program_bytes + (plan->device->is_host ? of_device : 0);
    report->bytes_available = spin_memory_available() + held;
    of_host -= plan_scratch(plan, of_host, of_clip);
    of_host += plan_pixels(plan, report->bytes_available, of_host, held);
    report->bytes_needed = of_host;
    if (plan->device->is_host)
        return;
    available = plan->device->op->memory_available(plan->device);
    if (available < of_device || report->bytes_available >= of_host) {
        report->bytes_needed = of_device;
        report->bytes_available = available;
    }
}

/* True if the memory is insufficient; false also if the available memory is unknown, that is, if
 * bytes_available is 0. */
static bool is_short(const struct spin_retrain_report *report)
{
    return report->bytes_available > 0 && report->bytes_needed > report->bytes_available;
}

/* True if a run with the options o on the first n_frames frames would fit into the available
 * memory. */
static bool fits_memory(const struct spin_plan *plan, const struct spin_retrain_options *o,
                        int n_frames)
{
    struct spin_retrain_report report = *plan->report;
    struct spin_plan trial = *plan;
    double smaller = o->image_scale / plan->o->image_scale;

    trial.o = o;
    trial.report = &report;
    trial.clip.n_frames = n_frames;
    trial.max_pixels = (size_t)ceil((double)plan->max_pixels * smaller * smaller);
    if (plan_field(&trial) != SPIN_OK)
        return false;
    plan_memory(&trial, 0);
    return report.bytes_available > 0 && !is_short(&report);
}

/* Writes to text [n] the options of a trial that differ from those of the run, in the syntax of the
 * command line. */
static void name_trial(const struct spin_plan *plan, const struct spin_retrain_options *o,
                       int n_frames, char *text, size_t n)
{
    size_t at = 0;

    text[0] = '\0';
    if (o->hash_log2 != plan->o->hash_log2)
        at += (size_t)snprintf(text + at, n - at, " --hash-log2 %d", o->hash_log2);
    if (o->batch != plan->o->batch)
        at += (size_t)snprintf(text + at, n - at, " --batch %d", o->batch);
    if (o->image_scale != plan->o->image_scale)
        at += (size_t)snprintf(text + at, n - at, " --scale %g", o->image_scale);
    if (n_frames < plan->clip.n_frames)
        snprintf(text + at, n - at, " --range %d:%d", spin_plan_info(plan, 0)->number,
                 spin_plan_info(plan, n_frames - 1)->number + 1);
    memmove(text, text + 1, strlen(text)); /* remove the blank before the first option */
}

/* If the memory is insufficient, searches for options with which the run would fit, and sets
 * report->fitting to the first ones found. Tries smaller hash tables and batches first, then
 * smaller images, then fewer frames. */
static void find_fitting(const struct spin_plan *plan)
{
    struct spin_retrain_options o = *plan->o;
    bool network = o.method == SPIN_METHOD_NETWORK, one_step = !o.range.given || o.range.step == 1;
    int least = network && o.hash_log2 > 15 ? 15 : o.hash_log2, n = plan->clip.n_frames;
    struct spin_retrain_report *report = plan->report;

    report->fitting[0] = '\0';
    for (; is_short(report) && n > 0; n = one_step ? n / 2 : 0)
        for (double scale = 1; scale > 0.2; scale /= 2) {
            o.image_scale = scale * plan->o->image_scale;
            for (o.hash_log2 = plan->o->hash_log2; o.hash_log2 >= least; o.hash_log2--)
                for (int whole = 1; whole >= 0; whole--) {
                    o.batch = whole ? plan->o->batch : o.views_per_frame;
                    if (!fits_memory(plan, &o, n))
                        continue;
                    name_trial(plan, &o, n, report->fitting, sizeof report->fitting);
                    return;
                }
        }
}

spin_status spin_plan_check_memory(const struct spin_plan *plan)
{
    const struct spin_retrain_report *report = plan->report;
    char needed[32], free_bytes[32];

    if (!is_short(report))
        return SPIN_OK;
    spin_text_bytes(report->bytes_needed, needed);
    spin_text_bytes(report->bytes_available, free_bytes);
    if (!*report->fitting)
        return spin_fail(SPIN_E_MEMORY,
                         "the training needs about %s of memory, but only %s are free: no smaller "
                         "--hash-log2, --batch, --scale or --range would fit; free some memory",
                         needed, free_bytes);
    return spin_fail(
        SPIN_E_MEMORY,
        "the training needs about %s of memory, but only %s are free: use %s, which fits", needed,
        free_bytes, report->fitting);
}

/* The constants below are seconds on one thread of a server CPU with AVX-512, per unit of work.
 * They were fitted to the runs in tests/bench/README.md. */

/* Seconds to render and train one pixel, with its loss, and one splat, in one view. */
static const double pixel_s = 0.1e-6, splat_s = 0.13e-6;

/* Returns the seconds to render and train the pixels of a view, without its splats. */
static double guess_pixels(const struct spin_plan *plan)
{
    return (double)plan->max_pixels * (1 - 0.5 * plan->empty) * pixel_s;
}

/* Returns the mean over the iterations of a number that grows by `factor` during the share `until`
 * of them, at first faster than later; 1 without growth. */
static double mean_growth(double factor, double until)
{
    return 1 + (factor - 1) * (1 - 0.4 * fmin(until, 1));
}

/* Estimates the seconds of refinement, where views cost less per pixel, since splats are small, and
 * splats more, since they have SH. */
static double guess_refining(const struct spin_plan *plan)
{
    double splats = plan->clip.n_mean * (1 + guess_refined_growth(plan)) / 2;

    return (double)plan->clip.n_frames * plan->o->refine *
           (splats * 2 * splat_s + 0.4 * guess_pixels(plan));
}

/* Estimates the seconds of an iteration. network: forward and backward pass of one splat. adam: one
 * value of the hash table. values: the residual values of one splat. */
static double guess_iteration(const struct spin_plan *plan)
{
    const struct spin_retrain_options *o = plan->o;
    double network = 2.7e-6, adam = 1.1e-9, values = 0.05e-6;
    double until = (double)spin_plan_schedule(plan).until / o->iterations;
    double splats = plan->clip.n_mean * mean_growth(guess_growth(plan), until);
    double seconds = o->batch * (splats * splat_s + guess_pixels(plan));

    if (spin_plan_has_residual(plan))
        seconds += decodings(o) * splats * values;
    if (o->method == SPIN_METHOD_NETWORK)
        seconds += decodings(o) * splats * network + (double)plan->field.n_table * adam;
    return seconds;
}

/* Estimates the seconds outside of iterations. splat: to load and write one splat of a frame.
 * decoded: to decode a pixel and to examine it before the training. tested: per splat and per
 * pixel, to render and measure a test view. Test views are measured after the training, every
 * `eval_every` iterations and, if the source has attributes, before the training. table: to
 * initialise and write one value of the hash table. */
static double guess_frames(const struct spin_plan *plan)
{
    const struct spin_retrain_options *o = plan->o;
    double splat = 4e-6, decoded = 0.045e-6, tested = 0.06e-6, table = 0.18e-6;
    double splats = plan->clip.n_mean * guess_growth(plan), pixels = (double)plan->max_pixels;
    double tests = 1 + spin_plan_has_source(plan), seconds;

    if (o->eval_every > 0)
        tests += o->iterations / o->eval_every;
    seconds = plan->clip.n_frames * splats * splat + (double)plan->n_train * pixels * decoded +
              tests * (double)plan->n_test * tested * (splats + pixels);
    return seconds + (o->method == SPIN_METHOD_NETWORK ? (double)plan->field.n_table * table : 0);
}

/* Returns the estimated time on a SIMD path, relative to AVX-512. Forced on one machine, AVX2 takes
 * 1.1 times as long, but processors without AVX-512 are often slower otherwise, too. */
static double slowdown_of_path(const char *path)
{
    return strcmp(path, "base") == 0 ? 2 : strcmp(path, "v3") == 0 ? 1.3 : 1;
}

/* Estimates the seconds of the whole run; NaN on a GPU, for which the constants were not measured.
 */
static double guess_seconds(const struct spin_plan *plan)
{
    const struct spin_retrain_options *o = plan->o;
    double threads = o->n_threads;
    double seconds = plan->o->refine > 0 ? guess_refining(plan) : 0;
    struct spin_pool *pool = NULL;

    if (!plan->device->is_host)
        return NAN;
    if (threads < 1 && spin_pool_create(0, &pool) == SPIN_OK)
        threads = spin_pool_n_threads(pool);
    spin_pool_free(pool);
    if (o->method != SPIN_METHOD_FRAMES)
        seconds += o->iterations * guess_iteration(plan) + guess_frames(plan);
    return seconds * slowdown_of_path(plan->device->path) / (threads > 1 ? threads : 1);
}

/* ---- The plan -------------------------------------------------------------------------------- */

/* Opens the clip with its views and its data set, and chooses the frames and the cameras for
 * training and testing. */
static spin_status open_clip(struct spin_plan *plan)
{
    const struct spin_retrain_options *o = plan->o;
    struct spin_clip_options c = {
        .input = o->input,
        .data = o->data,
        .data_from = o->data_from,
        .pair = o->pair,
        .range = o->range,
        .test_cameras = o->test_cameras,
        .n_test_cameras = o->n_test_cameras,
        .n_outer = o->test_outer,
        .image_scale = o->image_scale,
        .needs_views = true,
        .as_trained = true,
    };

    SPIN_TRY(spin_clip_open(&c, &plan->clip));
    if (o->residual == SPIN_RESIDUAL_SOURCE && o->refine == 0 && !spin_plan_has_source(plan))
        return spin_not_found("'%s' does not contain the attributes of its source, which "
                              "--residual source needs: use --residual points",
                              o->input);
    SPIN_TRY(spin_alloc((size_t)plan->clip.n_frames, sizeof *plan->counts, (void **)&plan->counts));
    for (int f = 0; f < plan->clip.n_frames; f++)
        plan->counts[f] = spin_plan_info(plan, f)->n;
    if (plan->clip.n_max == 0)
        return spin_malformed("no frame of '%s' contains any splats", o->input);
    SPIN_TRY(spin_clip_pairs(&plan->clip, SPIN_SPLIT_TRAIN, &plan->train, &plan->n_train));
    SPIN_TRY(spin_clip_pairs(&plan->clip, SPIN_SPLIT_TEST, &plan->test, &plan->n_test));
    if (plan->n_train == 0)
        return spin_misuse("no training camera is left: all cameras are held out for testing; hold "
                           "out fewer cameras with --test-cams");
    SPIN_TRY(list_cameras(plan));
    SPIN_TRY(spin_lenses_list(&plan->clip.views, plan->train, plan->n_train, o->image_scale,
                              &plan->lenses));
    SPIN_TRY(reserve_exposure(plan));
    SPIN_TRY(spin_times_check(plan->clip.bundle.meta.frame, plan->clip.frame, plan->clip.n_frames));
    measure_images(plan);
    return plan_extent(plan);
}

/* Sets the folder of temporary files: that of --scratch, or the folder of the output. */
static spin_status name_scratch(struct spin_plan *plan)
{
    const char *chosen = plan->o->scratch, *output = plan->o->output;

    if (!SPIN_PAGES_IN_FILES || (chosen && strcmp(chosen, "off") == 0))
        return SPIN_OK;
    if (chosen)
        return spin_strdup(chosen, &plan->scratch_folder);
    SPIN_TRY(spin_path_folder(output ? output : "", &plan->scratch_folder));
    if (spin_path_is_in_memory(plan->scratch_folder)) {
        free(plan->scratch_folder);
        plan->scratch_folder = NULL;
    }
    return SPIN_OK;
}

/* Sets the paths of the files of an unfinished run: checkpoint, bundle for viewing, and folder of
 * refined frames. */
static spin_status name_parts(struct spin_plan *plan)
{
    const char *output = plan->o->output ? plan->o->output : "";
    const char *cache = plan->o->cache;
    size_t n = strlen(output) + sizeof ".part" SPIN_CLIP_OF_STATE + (cache ? strlen(cache) : 0);

    SPIN_TRY(spin_alloc(n, 1, (void **)&plan->part));
    snprintf(plan->part, n, "%s.part", output);
    SPIN_TRY(spin_alloc(n, 1, (void **)&plan->clip_of_state));
    snprintf(plan->clip_of_state, n, "%s" SPIN_CLIP_OF_STATE, plan->part);
    SPIN_TRY(spin_alloc(n, 1, (void **)&plan->parts));
    if (cache)
        snprintf(plan->parts, n, "%s", cache);
    else
        snprintf(plan->parts, n, "%s.parts", output);
    return name_scratch(plan);
}

spin_status spin_plan_open(struct spin_plan *plan, const struct spin_retrain_options *o,
                           struct spin_retrain_report *report)
{
    size_t n_positions;

    report->options = *o;
    plan->o = &report->options;
    plan->report = report;
    SPIN_TRY(check_options(o));
    SPIN_TRY(name_parts(plan));
    SPIN_TRY(open_clip(plan));
    SPIN_TRY(spin_views_count_positions(&plan->clip.views, &n_positions));
    spin_options_resolve(&report->options, plan->clip.n_frames,
                         spin_options_most_iterations(plan->n_train, n_positions));
    warn_idle_ranks(plan->o);
    SPIN_TRY(plan_field(plan));
    report->frames = plan->clip.n_frames;
    report->densify_every = spin_plan_densifies(plan) ? plan->o->densify_every : 0;
    report->splats_mean = plan->clip.n_mean;
    report->iterations =
        plan->o->method == SPIN_METHOD_FRAMES ? plan->o->refine : plan->o->iterations;
    return SPIN_OK;
}

spin_status spin_plan_beside(const struct spin_plan *plan, spin_status status)
{
    char *incomplete = plan->report->incomplete;

    if (status == SPIN_OK || status == SPIN_E_CANCELLED)
        return status;
    if (!*incomplete)
        spin_warn("%s; the training continues", spin_last_error());
    if (!*incomplete)
        snprintf(incomplete, sizeof plan->report->incomplete, "%s", spin_last_error());
    return SPIN_OK;
}

bool spin_plan_is_short(const struct spin_plan *plan) { return is_short(plan->report); }

static void estimate(struct spin_plan *plan, size_t held)
{
    plan_memory(plan, held);
    find_fitting(plan);
    plan->report->seconds_estimated = guess_seconds(plan);
}

void spin_plan_set_sizes(struct spin_plan *plan, const struct spin_frame_size *sizes,
                         size_t n_tracks, size_t held)
{
    plan->sizes = sizes;
    plan->n_tracks = n_tracks;
    estimate(plan, held);
}

void spin_plan_set_content(struct spin_plan *plan, double edges, double empty, size_t held)
{
    plan->edges = edges;
    plan->empty = empty;
    estimate(plan, held);
}

void spin_plan_set_device(struct spin_plan *plan, struct spin_device *device)
{
    plan->device = device;
    memcpy(plan->report->device, device->description, sizeof plan->report->device);
    estimate(plan, 0);
}

void spin_plan_close(struct spin_plan *plan)
{
    free(plan->counts);
    free(plan->backdrop.row);
    free(plan->camera);
    spin_lenses_free(&plan->lenses);
    free(plan->exposure);
    free(plan->train);
    free(plan->test);
    free(plan->part);
    free(plan->clip_of_state);
    free(plan->parts);
    free(plan->scratch_folder);
    spin_clip_close(&plan->clip);
}

spin_status spin_plan_recount(struct spin_plan *plan, const size_t *counts, size_t held)
{
    struct spin_clip *clip = &plan->clip;

    clip->n_max = 0;
    clip->n_mean = 0;
    for (int f = 0; f < clip->n_frames; f++) {
        plan->counts[f] = counts[f];
        clip->n_max = counts[f] > clip->n_max ? counts[f] : clip->n_max;
        clip->n_mean += (double)counts[f];
    }
    clip->n_mean /= clip->n_frames;
    if (clip->n_max == 0)
        return spin_malformed(
            "refinement left no splat in any frame: check that the cameras belong to the points");
    plan->report->splats_mean = clip->n_mean;
    plan_memory(plan, held);
    find_fitting(plan);
    return SPIN_OK;
}
