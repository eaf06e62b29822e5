#include "run/settle.h"

#include "base/base.h"
#include "base/pool.h"
#include "geometry/neighbours.h"
#include "math/activate.h"
#include "math/rng.h"
#include "render/player.h"
#include "scene/dataset.h"

/* A splat is dynamic if its pixel has changed, in one frame, in at least this share of the cameras
 * that see it. */
#define SHARE 0.7
/* Captured images need a smaller share, since they do not flicker like frames that were trained one
 * by one. */
#define SHARE_CAPTURED 0.5
/* Nevertheless it is static if less than this share of the splats around it would be dynamic. */
#define CROWD 0.5
#define MOST_BYTES 1.5e9 /* of the sampled renders, if they are large */
/* The threshold is at most these factors times two quantiles of the differences from the median
 * over time. */
#define QUARTILE_FACTOR 2.5
#define MEDIAN_FACTOR 5
#define BEHIND 1.05 /* a splat is visible up to this factor times the depth of the background */
/* Rows of other frames fill a hole only above this opacity, and only where at least this share of
 * the frames has such static rows. Fewer frames have splats that float in empty space, each frame
 * in other places, so that those of all frames together would hide the scene. */
#define FILL_OPACITY 0.1f
#define FILL_SHARE 0.25
/* Points are drawn as splats with this logit of the opacity, and with a standard deviation of their
 * distance to their neighbours, limited to this factor times the mean distance. */
#define POINT_LOGIT 4
#define MOST_SPACING 4
#define MOST_SHARED 0.1 /* share of rows whose positions two frames may share */
enum {
    WIDTH = 320,        /* width to which captured images are reduced */
    LEAST_CAMERAS = 4,  /* that capture images */
    LEAST_FRAMES = 8,   /* with captured images; fewer frames hardly tell motion from noise */
    LEAST_CHANGE = 12,  /* smallest threshold, in 255ths, above which a pixel has changed */
    LEAST_CAPTURED = 6, /* the same for captured images */
    LEAST_SAMPLES = 8,  /* sampled frames of large images */
    MEDIAN_FRAMES = 31, /* largest number of sampled frames; one bit less than a uint32_t has */
    OWN = 31,           /* bit of the frame whose splats are examined, unless it is a sample */
    CELLS = 100,        /* cells along the longest side of the grid */
    DEPTH_STEP = 3,     /* of more than LEAST_SAMPLES frames, every third gives the background */
    BLUR = 2,           /* radius of the box filter that is applied to renders */
};

struct cell {
    uint32_t n, n_dynamic; /* numbers of rows in the current frame */
    /* number of frames with static rows above FILL_OPACITY; 1 + the last such frame */
    uint32_t n_frames, last;
    bool taken; /* the cell or a neighbouring cell contains a static row of `base` */
};

struct settling {
    struct spin_clip clip;
    struct spin_device device;
    struct spin_player player; /* renders the frames of the clip */
    bool opened;               /* device and player are open */
    unsigned columns;          /* of the clip */
    int n_cameras, n_frames;
    struct spin_pair *pair; /* [n_frames][n_cameras] training views, in the same order */
    bool captured;          /* the images are not rendered but read from `photos` */
    struct spin_image_cache photos;
    struct spin_pool *pool;    /* used if `points` is */
    struct spin_splats points; /* the points of the shown frame, as splats */
    int width, height;
    size_t plane;  /* number of pixels */
    float *image;  /* [3][plane] */
    float *depth;  /* [2][plane] */
    uint8_t *part; /* [plane] */
    /* The median over time is computed from the frames sample[0] to sample[n_samples - 1]. */
    int sample[MEDIAN_FRAMES], n_samples;
    uint8_t *picture;  /* [n_samples][n_cameras][3][plane] blurred renders of these frames */
    uint8_t *median;   /* [n_cameras][3][plane] */
    uint8_t *change;   /* [plane] difference of an image from the median */
    uint32_t *changed; /* [n_cameras][plane] bit k: the pixel has changed in sample k */
    int threshold;
    float *background;   /* [n_cameras][plane] depth of the farthest surface over time */
    uint8_t **mark;      /* [n_frames][rows] 1: static; 2: static and stored in `base` */
    double low[3], cell; /* lowest corner and cell size of the grid */
    int dim[3];
    size_t n_cells;
    struct cell *grid;       /* [n_cells] */
    struct spin_splats base; /* the static rows */
    double keep[2];          /* the shares of static and of dynamic rows to keep */
    struct spin_splats frame, out;
    struct spin_progress progress;
};

/* ---- Shared positions ------------------------------------------------------------------------ */

static int compare_positions(const void *a, const void *b)
{
    return memcmp(a, b, 3 * sizeof(float));
}

spin_status spin_settle_applies(struct spin_bundle *bundle, bool *applies)
{
    SPIN_LEAVES(spin_splats_free) struct spin_splats a = {0}, b = {0};
    int middle = bundle->meta.n_frames / 2;
    size_t shared = 0, position = 3 * sizeof(float);

    *applies = false;
    if (bundle->meta.n_frames < LEAST_FRAMES || bundle->meta.identity || bundle->meta.four_d.n > 0)
        return SPIN_OK;
    SPIN_TRY(spin_bundle_frame(bundle, middle - 1, SPIN_COL_MEANS, &a));
    SPIN_TRY(spin_bundle_frame(bundle, middle, SPIN_COL_MEANS, &b));
    qsort(a.means, a.n, position, compare_positions);
    for (size_t i = 0; i < b.n; i++)
        shared += bsearch(b.means + 3 * i, a.means, a.n, position, compare_positions) != NULL;
    *applies = (double)shared < MOST_SHARED * (double)b.n;
    return SPIN_OK;
}

/* ---- Images ---------------------------------------------------------------------------------- */

int spin_settle_step(int n_frames, double n_pixels)
{
    int most = (int)fmax(LEAST_SAMPLES, fmin(MEDIAN_FRAMES, MOST_BYTES / (3 * n_pixels)));

    return (n_frames + most - 1) / most;
}

/* Returns camera c, which is the same in all frames. */
static const struct spin_camera *camera_of(const struct settling *s, int c)
{
    return &s->clip.views.view[s->pair[c].view].camera;
}

/* Lists the training views. Fails with SPIN_E_UNSUPPORTED if not every frame has the same ones. */
static spin_status list_views(struct settling *s)
{
    const struct spin_view *view = s->clip.views.view;
    size_t n;

    SPIN_TRY(spin_clip_pairs(&s->clip, SPIN_SPLIT_TRAIN, &s->pair, &n));
    s->n_frames = s->clip.bundle.meta.n_frames;
    while ((size_t)s->n_cameras < n && s->pair[s->n_cameras].frame == s->pair[0].frame)
        s->n_cameras++;
    if (n != (size_t)s->n_cameras * (size_t)s->n_frames)
        return spin_unsupported("not all frames have images of the same cameras");
    if (s->captured && s->n_cameras < LEAST_CAMERAS)
        return spin_unsupported("there are fewer than %d cameras", LEAST_CAMERAS);
    for (size_t i = 0; i < n; i++) {
        const struct spin_view *first = &view[s->pair[i % (size_t)s->n_cameras].view];
        const struct spin_view *own = &view[s->pair[i].view];

        if (s->pair[i].frame != (int)(i / (size_t)s->n_cameras) ||
            own->camera_id != first->camera_id || own->camera.width != view->camera.width ||
            own->camera.height != view->camera.height ||
            memcmp(own->camera.w2c, first->camera.w2c, sizeof own->camera.w2c) != 0)
            return spin_unsupported("the cameras move, or differ in their number or image size");
    }
    return SPIN_OK;
}

/* Reads a frame of points as splats, of which only the depth is rendered. */
static spin_status read_points(void *context, int f, struct spin_splats *out)
{
    struct settling *s = context;
    SPIN_FREED float *square = NULL;
    double mean = 0;

    SPIN_TRY(spin_bundle_frame(&s->clip.bundle, f, s->columns, &s->frame));
    SPIN_TRY(spin_splats_reserve(out, s->frame.n, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES, 0));
    memcpy(out->means, s->frame.means, 3 * out->n * sizeof(float));
    memset(out->sh, 0, 3 * out->n * sizeof(float));
    SPIN_TRY(spin_alloc(out->n + 1, sizeof *square, (void **)&square));
    SPIN_TRY(spin_knn_mean_dist2(s->pool, out->n, out->means, square));
    for (size_t i = 0; i < out->n; i++)
        mean += sqrt((double)square[i]) / (double)out->n;
    for (size_t i = 0; i < out->n; i++) {
        double spacing = fmin(sqrt((double)square[i]), MOST_SPACING * mean);

        for (size_t c = 0; c < 3; c++)
            out->log_scales[3 * i + c] = (float)log(fmax(spacing, 1e-9));
        memcpy(out->quats + 4 * i, (const float[4]){1, 0, 0, 0}, 4 * sizeof(float));
        out->logit_opacities[i] = POINT_LOGIT;
    }
    return SPIN_OK;
}

static spin_status open_player(struct settling *s, int n_threads)
{
    SPIN_TRY(spin_device_open("cpu", n_threads, &s->device));
    s->opened = true;
    if (!(SPIN_COL_ATTRIBUTES & ~s->columns))
        return spin_player_open(&s->player, &s->device, &s->clip.bundle, SPIN_FROM_SOURCE);
    SPIN_TRY(spin_pool_create(n_threads, &s->pool));
    spin_player_open_reader(&s->player, &s->device, NULL, s);
    return SPIN_OK;
}

static spin_status show(struct settling *s, int f)
{
    if (!s->pool)
        return spin_player_show(&s->player, f);
    SPIN_TRY(read_points(s, f, &s->points));
    return spin_player_show_splats(&s->player, &s->points);
}

static spin_status open_images(struct settling *s, int n_threads)
{
    int step;
    size_t all;

    s->captured = !spin_clip_is_drawn(&s->clip);
    s->columns = s->clip.bundle.meta.columns;
    SPIN_TRY(list_views(s));
    s->width = camera_of(s, 0)->width;
    s->height = camera_of(s, 0)->height;
    s->plane = (size_t)s->width * (size_t)s->height;
    all = (size_t)s->n_cameras * s->plane;
    step = spin_settle_step(s->n_frames, (double)all);
    for (int f = 0; f < s->n_frames; f += step)
        s->sample[s->n_samples++] = f;
    if (s->captured)
        SPIN_TRY(spin_image_cache_open(&s->clip.views, 0, NULL, &s->photos));
    SPIN_TRY(spin_alloc(5 * s->plane, sizeof *s->image, (void **)&s->image));
    s->depth = s->image + 3 * s->plane;
    SPIN_TRY(spin_alloc(s->plane, 1, (void **)&s->part));
    SPIN_TRY(spin_alloc((size_t)s->n_samples, 3 * all, (void **)&s->picture));
    SPIN_TRY(spin_alloc(3, all, (void **)&s->median));
    SPIN_TRY(spin_alloc(s->plane, 1, (void **)&s->change));
    SPIN_TRY(spin_alloc(all, sizeof *s->changed, (void **)&s->changed));
    SPIN_TRY(spin_alloc(all, sizeof *s->background, (void **)&s->background));
    return open_player(s, n_threads);
}

static int clamped(int i, int n) { return i < 0 ? 0 : i < n ? i : n - 1; }

/* Applies a box filter to an image [height][width], in place. */
static void blur(const struct settling *s, uint8_t *image)
{
    enum { N = 2 * BLUR + 1 };
    int w = s->width, h = s->height;

    for (int y = 0; y < h; y++)
        for (int x = 0; x < w; x++) {
            int sum = BLUR;

            for (int d = -BLUR; d <= BLUR; d++)
                sum += image[y * w + clamped(x + d, w)];
            s->part[y * w + x] = (uint8_t)(sum / N);
        }
    for (int y = 0; y < h; y++)
        for (int x = 0; x < w; x++) {
            int sum = BLUR;

            for (int d = -BLUR; d <= BLUR; d++)
                sum += s->part[clamped(y + d, h) * w + x];
            image[y * w + x] = (uint8_t)(sum / N);
        }
}

/* Sets `out` [3][plane] to the blurred image of camera c in frame f: the captured image, or a
 * render, for which f must be the current frame of the player. */
static spin_status draw_blurred(struct settling *s, int f, int c, uint8_t *out)
{
    static const float black[3];
    size_t i = (size_t)f * (size_t)s->n_cameras + (size_t)c;

    if (spin_cancelled())
        return spin_fail_cancelled();
    if (s->captured)
        SPIN_TRY(spin_image_cache_get(&s->photos, s->pair[i].view, s->image));
    else
        SPIN_TRY(spin_player_draw(&s->player, camera_of(s, c), black, s->image));
    for (size_t k = 0; k < 3 * s->plane; k++)
        out[k] = (uint8_t)lrintf(255 * fminf(fmaxf(s->image[k], 0), 1));
    for (size_t k = 0; k < 3; k++)
        blur(s, out + k * s->plane);
    return SPIN_OK;
}

/* Updates the depth of the background, which hides splats behind it, from a render of the shown
 * frame. What moves in front of the background hides a place for a part of the time only. */
static spin_status add_depth(struct settling *s, int c)
{
    float *background = s->background + (size_t)c * s->plane, *median = s->depth + s->plane;
    static const float black[3];

    if (s->captured)
        SPIN_TRY(spin_player_draw(&s->player, camera_of(s, c), black, NULL));
    SPIN_TRY(spin_player_layers(&s->player, NULL, s->depth));
    for (size_t i = 0; i < s->plane; i++) /* a depth of 0: there is no surface */
        background[i] = median[i] > 0 ? fmaxf(background[i], median[i]) : INFINITY;
    return SPIN_OK;
}

static spin_status draw_samples(struct settling *s)
{
    uint8_t *picture = s->picture;

    for (int k = 0; k < s->n_samples; k++) {
        bool has_depth = s->n_samples <= LEAST_SAMPLES || k % DEPTH_STEP == 0;

        if (has_depth || !s->captured)
            SPIN_TRY(show(s, s->sample[k]));
        for (int c = 0; c < s->n_cameras; c++, picture += 3 * s->plane) {
            SPIN_TRY(draw_blurred(s, s->sample[k], c, picture));
            if (has_depth)
                SPIN_TRY(add_depth(s, c));
        }
        spin_progress_set(&s->progress, k + 1, "%d frames", s->n_frames);
    }
    return SPIN_OK;
}

/* ---- Changed pixels -------------------------------------------------------------------------- */

/* Returns the median of n values that are `step` bytes apart, at most MEDIAN_FRAMES. */
static uint8_t median_of(const uint8_t *value, int n, size_t step)
{
    uint8_t sorted[MEDIAN_FRAMES] = {0};

    for (int i = 0; i < n; i++) {
        int k = i;

        for (; k > 0 && sorted[k - 1] > value[(size_t)i * step]; k--)
            sorted[k] = sorted[k - 1];
        sorted[k] = value[(size_t)i * step];
    }
    return sorted[n / 2];
}

/* Sets s->change to the largest difference, over the colour channels, between an image of camera c
 * and the median. */
static void compare(const struct settling *s, int c, const uint8_t *picture)
{
    const uint8_t *median = s->median + (size_t)c * 3 * s->plane;
    uint8_t *change = s->change;

    memset(change, 0, s->plane);
    for (int k = 0; k < 3; k++, picture += s->plane, median += s->plane)
        for (size_t i = 0; i < s->plane; i++) {
            int off = abs(picture[i] - median[i]);

            change[i] = off > change[i] ? (uint8_t)off : change[i];
        }
}

/* Returns the smallest value that is not exceeded by the given share of the values. */
static int quantile(const size_t count[256], double share, size_t all)
{
    size_t sum = 0;
    int value = 0;

    while (value < 255 && (double)(sum += count[value]) < share * (double)all)
        value++;
    return value;
}

/* Derives the threshold from the flicker of the clip, which the differences of the pixels measure
 * that do not show motion. These are most of the pixels, but their share is unknown: the upper
 * quartile measures a flicker that is stronger in some places, unless these places move, so the
 * median limits its effect. */
static void set_threshold(struct settling *s, const size_t count[256], size_t all)
{
    double flicker = fmin(QUARTILE_FACTOR * quantile(count, 0.75, all),
                          MEDIAN_FACTOR * quantile(count, 0.5, all));

    s->threshold = (int)fmax(s->captured ? LEAST_CAPTURED : LEAST_CHANGE, flicker);
}

/* Sets bit k of s->changed, for camera c and an image of it. */
static void mark_changes(struct settling *s, int k, int c, const uint8_t *picture)
{
    uint32_t *changed = s->changed + (size_t)c * s->plane, bit = (uint32_t)1 << k;

    compare(s, c, picture);
    for (size_t i = 0; i < s->plane; i++)
        changed[i] = (changed[i] & ~bit) | (s->change[i] > s->threshold ? bit : 0);
}

static void find_changes(struct settling *s)
{
    size_t row = 3 * (size_t)s->n_cameras * s->plane, n = (size_t)(s->n_samples * s->n_cameras);
    size_t count[256] = {0};

    for (size_t i = 0; i < row; i++)
        s->median[i] = median_of(s->picture + i, s->n_samples, row);
    for (size_t k = 0; k < n; k++) {
        compare(s, (int)k % s->n_cameras, s->picture + k * 3 * s->plane);
        for (size_t i = 0; i < s->plane; i++)
            count[s->change[i]]++;
    }
    set_threshold(s, count, n * s->plane);
    for (size_t k = 0; k < n; k++)
        mark_changes(s, (int)k / s->n_cameras, (int)k % s->n_cameras,
                     s->picture + k * 3 * s->plane);
}

/* Sets the bits OWN of s->changed to the changes of frame f, and *is_sample to whether f is among
 * the samples, whose bits are set already. */
static spin_status changes_of(struct settling *s, int f, bool *is_sample)
{
    *is_sample = false;
    for (int k = 0; k < s->n_samples; k++)
        *is_sample |= s->sample[k] == f;
    if (*is_sample)
        return SPIN_OK;
    if (!s->captured)
        SPIN_TRY(show(s, f));
    for (int c = 0; c < s->n_cameras; c++) {
        SPIN_TRY(draw_blurred(s, f, c, s->picture));
        mark_changes(s, OWN, c, s->picture);
    }
    return SPIN_OK;
}

/* ---- Static rows ----------------------------------------------------------------------------- */

/* Returns whether camera c sees a point, and sets `at` to the index of its pixel. */
static bool sees(const struct settling *s, int c, const float point[3], size_t *at)
{
    double pixel[3];

    if (!spin_camera_project_visible(camera_of(s, c), point, pixel))
        return false;
    *at = (size_t)pixel[1] * (size_t)s->width + (size_t)pixel[0];
    return pixel[2] <= BEHIND * (double)s->background[(size_t)c * s->plane + *at];
}

/* Returns whether a splat is static in the frames of which `bits` contains the bits. */
static bool is_static(const struct settling *s, const float point[3], uint32_t bits)
{
    int changed[OWN + 1] = {0}, seen = 0;
    double share = s->captured ? SHARE_CAPTURED : SHARE;

    for (int c = 0; c < s->n_cameras; c++) {
        uint32_t mask;
        size_t at;

        if (!sees(s, c, point, &at))
            continue;
        seen++;
        mask = s->changed[(size_t)c * s->plane + at] & bits;
        for (int k = 0; k <= OWN; k++)
            changed[k] += mask >> k & 1;
    }
    for (int k = 0; k <= OWN; k++)
        if (seen >= 2 && changed[k] >= share * seen)
            return false;
    return true;
}

static spin_status read_rows(struct settling *s, int f)
{
    return spin_bundle_frame(&s->clip.bundle, f, s->columns, &s->frame);
}

/* ---- The grid -------------------------------------------------------------------------------- */

static size_t cell_of(const struct settling *s, const float at[3])
{
    size_t cell = 0;

    for (int c = 0; c < 3; c++) {
        double i = ((double)at[c] - s->low[c]) / s->cell;

        i = fmin(fmax(i, 0), s->dim[c] - 1);
        cell = cell * (size_t)s->dim[c] + (size_t)i;
    }
    return cell;
}

/* Returns the cell of a position (k = 13) or one of its 26 neighbours. */
static size_t neighbour_of(const struct settling *s, const float at[3], int k)
{
    const float by[3] = {at[0] + (float)((k % 3 - 1) * s->cell),
                         at[1] + (float)((k / 3 % 3 - 1) * s->cell),
                         at[2] + (float)((k / 9 - 1) * s->cell)};

    return cell_of(s, by);
}

/* Sets the grid to the bounding box of the middle frame's rows, ignoring the outermost 1 % of the
 * coordinates. */
static spin_status make_grid(struct settling *s)
{
    SPIN_FREED float *value = NULL;
    double high[3], side = 0;

    SPIN_TRY(spin_alloc(s->frame.n + 1, sizeof *value, (void **)&value));
    for (size_t c = 0; c < 3; c++) {
        size_t n = s->frame.n;

        for (size_t i = 0; i < n; i++)
            value[i] = s->frame.means[3 * i + c];
        qsort(value, n, sizeof *value, spin_by_float);
        s->low[c] = n > 0 ? (double)value[n / 200] : 0;
        high[c] = n > 0 ? (double)value[n - 1 - n / 200] : 0;
        side = fmax(side, high[c] - s->low[c]);
    }
    s->cell = side > 0 ? side / CELLS : 1;
    for (int c = 0; c < 3; c++) {
        s->dim[c] = (int)ceil((high[c] - s->low[c]) / s->cell) + 3;
        s->low[c] -= s->cell;
    }
    s->n_cells = (size_t)s->dim[0] * (size_t)s->dim[1] * (size_t)s->dim[2];
    return spin_alloc(s->n_cells, sizeof *s->grid, (void **)&s->grid);
}

/* ---- Static and dynamic rows ----------------------------------------------------------------- */

static bool is_opaque(const struct spin_splats *rows, size_t i)
{
    return !rows->logit_opacities ||
           spin_sigmoid_of((double)rows->logit_opacities[i]) > (double)FILL_OPACITY;
}

/* Marks each dynamic row as static unless the share CROWD of the rows around it, in its cell and in
 * the neighbouring ones, is dynamic. A moving object consists of many splats; a lone one has only
 * flickered. */
static void settle_lone_rows(struct settling *s, uint8_t *mark)
{
    for (size_t k = 0; k < s->n_cells; k++)
        s->grid[k].n = s->grid[k].n_dynamic = 0;
    for (size_t i = 0; i < s->frame.n; i++) {
        struct cell *c = &s->grid[cell_of(s, s->frame.means + 3 * i)];

        c->n++;
        c->n_dynamic += !mark[i];
    }
    for (size_t i = 0; i < s->frame.n; i++) {
        size_t n = 0, n_dynamic = 0;

        for (int k = 0; k < 27 && !mark[i]; k++) {
            const struct cell *c = &s->grid[neighbour_of(s, s->frame.means + 3 * i, k)];

            n += c->n;
            n_dynamic += c->n_dynamic;
        }
        mark[i] |= (double)n_dynamic < CROWD * (double)n;
    }
}

/* Counts frame f in each cell that contains a static row above FILL_OPACITY. */
static void count_static_frames(struct settling *s, int f)
{
    for (size_t i = 0; i < s->frame.n; i++) {
        struct cell *c = &s->grid[cell_of(s, s->frame.means + 3 * i)];

        if (s->mark[f][i] && is_opaque(&s->frame, i) && c->last != (uint32_t)f + 1) {
            c->last = (uint32_t)f + 1;
            c->n_frames++;
        }
    }
}

static spin_status mark_rows(struct settling *s)
{
    SPIN_TRY(read_rows(s, s->n_frames / 2));
    SPIN_TRY(make_grid(s));
    SPIN_TRY(spin_alloc((size_t)s->n_frames, sizeof *s->mark, (void **)&s->mark));
    for (int f = 0; f < s->n_frames; f++) {
        uint32_t bits = ((uint32_t)1 << s->n_samples) - 1;
        bool is_sample;

        SPIN_TRY(changes_of(s, f, &is_sample));
        bits |= is_sample ? 0 : (uint32_t)1 << OWN;
        SPIN_TRY(read_rows(s, f));
        SPIN_TRY(spin_alloc(s->frame.n + 1, 1, (void **)&s->mark[f]));
        for (size_t i = 0; i < s->frame.n; i++)
            s->mark[f][i] = is_static(s, s->frame.means + 3 * i, bits);
        settle_lone_rows(s, s->mark[f]);
        count_static_frames(s, f);
        spin_progress_set(&s->progress, s->n_samples + f + 1, "%d frames", s->n_frames);
    }
    return SPIN_OK;
}

static spin_status find_static(struct settling *s, int n_threads)
{
    spin_status status;

    SPIN_TRY(open_images(s, n_threads));
    spin_progress_begin(&s->progress, "comparing", "frames", 0, s->n_samples + s->n_frames);
    status = draw_samples(s);
    if (status == SPIN_OK) {
        find_changes(s);
        status = mark_rows(s);
    }
    spin_progress_end(&s->progress);
    return status;
}

/* ---- Shared rows ----------------------------------------------------------------------------- */

/* Marks the cell that contains a static row, and its neighbours, as filled. */
static void take_cells(struct settling *s, const float at[3])
{
    for (int k = 0; k < 27; k++)
        s->grid[neighbour_of(s, at, k)].taken = true;
}

static size_t n_sh(const struct spin_splats *s)
{
    return 3 * (size_t)((s->sh_degree + 1) * (s->sh_degree + 1));
}

static void copy_values(const float *from, size_t i, size_t n, float *to, size_t k)
{
    if (from)
        memcpy(to + n * k, from + n * i, n * sizeof *to);
}

/* Copies row i of `from` to row k, and adds `larger` to the log scales of the copy. */
static void copy_row(const struct spin_splats *from, size_t i, float larger, struct spin_splats *to,
                     size_t k)
{
    copy_values(from->means, i, 3, to->means, k);
    copy_values(from->quats, i, 4, to->quats, k);
    copy_values(from->log_scales, i, 3, to->log_scales, k);
    copy_values(from->logit_opacities, i, 1, to->logit_opacities, k);
    copy_values(from->sh, i, n_sh(from), to->sh, k);
    copy_values(from->rgb, i, 3, to->rgb, k);
    for (size_t c = 0; from->log_scales && c < 3; c++)
        to->log_scales[3 * k + c] += larger;
}

/* Appends the rows of s->frame with mark 2 to the static rows. */
static spin_status append_base(struct settling *s, const uint8_t *mark)
{
    struct spin_splats all = {0};
    size_t n = s->base.n;

    for (size_t i = 0; i < s->frame.n; i++)
        n += mark[i] == 2;
    SPIN_TRY(spin_splats_reserve(&all, n, s->columns, s->frame.sh_degree));
    all.antialias = s->frame.antialias;
    for (n = 0; n < s->base.n; n++)
        copy_row(&s->base, n, 0, &all, n);
    for (size_t i = 0; i < s->frame.n; i++)
        if (mark[i] == 2)
            copy_row(&s->frame, i, 0, &all, n++);
    spin_splats_free(&s->base);
    s->base = all;
    return SPIN_OK;
}

/* Returns whether a static row of another frame than the middle one fills a hole. */
static bool fills_hole(const struct settling *s, size_t i)
{
    const struct cell *c = &s->grid[cell_of(s, s->frame.means + 3 * i)];

    return !c->taken && is_opaque(&s->frame, i) && c->n_frames >= FILL_SHARE * s->n_frames;
}

/* Adds static rows of frame f: all of them if `first`, otherwise those in holes. Their cells are
 * marked only after all rows were examined, so that neighbouring rows of one frame can fill a hole
 * together. */
static spin_status add_static(struct settling *s, int f, bool first)
{
    uint8_t *mark = s->mark[f];

    SPIN_TRY(read_rows(s, f));
    for (size_t i = 0; i < s->frame.n; i++)
        if (mark[i] && (first || fills_hole(s, i)))
            mark[i] = 2;
    for (size_t i = 0; i < s->frame.n; i++)
        if (mark[i] == 2)
            take_cells(s, s->frame.means + 3 * i);
    return append_base(s, mark);
}

static spin_status gather_static(struct settling *s)
{
    int middle = s->n_frames / 2;

    SPIN_TRY(add_static(s, middle, true));
    for (int d = 1; d < s->n_frames; d++) {
        if (middle - d >= 0)
            SPIN_TRY(add_static(s, middle - d, false));
        if (middle + d < s->n_frames)
            SPIN_TRY(add_static(s, middle + d, false));
    }
    return SPIN_OK;
}

/* ---- The new bundle -------------------------------------------------------------------------- */

static bool keeps(double share, uint64_t stream, size_t i)
{
    return (double)spin_rng_uniform(0, stream, i) < share;
}

/* Assembles the rows of a frame: the static rows, followed by the dynamic rows of s->frame. */
static spin_status make_frame(struct settling *s, int f)
{
    const double *keep = s->keep;
    const float larger[2] = {(float)(-log(keep[0]) / 3), (float)(-log(keep[1]) / 3)};
    uint64_t own = 1 + (uint64_t)f;
    size_t n = 0;

    SPIN_TRY(spin_splats_reserve(&s->out, s->base.n + s->frame.n, s->columns, s->frame.sh_degree));
    s->out.antialias = s->frame.antialias;
    for (size_t i = 0; i < s->base.n; i++)
        if (keeps(keep[0], 0, i))
            copy_row(&s->base, i, larger[0], &s->out, n++);
    for (size_t i = 0; i < s->frame.n; i++)
        if (!s->mark[f][i] && keeps(keep[1], own, i))
            copy_row(&s->frame, i, larger[1], &s->out, n++);
    s->out.n = n;
    return SPIN_OK;
}

static spin_status write_frames(struct settling *s, struct spin_bundle_writer *w,
                                struct spin_bundle_meta *meta, struct spin_settled *settled)
{
    for (int f = 0; f < s->n_frames; f++) {
        SPIN_TRY(read_rows(s, f));
        SPIN_TRY(make_frame(s, f));
        meta->frame[f].n = s->out.n;
        settled->n_before += (double)s->frame.n / s->n_frames;
        settled->n_dynamic += (double)s->out.n / s->n_frames;
        SPIN_TRY(spin_bundle_write_frame(w, f, s->columns, 0, &s->out));
    }
    for (size_t i = 0; i < s->base.n; i++)
        settled->n_static += keeps(s->keep[0], 0, i);
    settled->n_dynamic -= settled->n_static;
    return SPIN_OK;
}

/* Writes the bundle. meta.json is that of the source, except for the rows and the data set. */
static spin_status write_bundle(struct settling *s, const char *output, bool force,
                                struct spin_settled *settled)
{
    struct spin_bundle_meta meta = s->clip.bundle.meta;
    struct spin_bundle_writer w = {0};
    SPIN_FREED struct spin_frame_info *frame = NULL;
    SPIN_FREED char *folder = NULL;
    spin_status status;

    meta.static_columns = 0;
    meta.identity = false;
    meta.data_path = meta.data_absolute = NULL;
    snprintf(meta.data_from, sizeof meta.data_from, "%s", s->clip.data_from);
    if (!s->captured)
        *meta.pair = '\0';
    SPIN_TRY(spin_alloc((size_t)s->n_frames, sizeof *frame, (void **)&frame));
    memcpy(frame, meta.frame, (size_t)s->n_frames * sizeof *frame);
    meta.frame = frame;
    SPIN_TRY(spin_path_folder(output, &folder));
    SPIN_TRY(spin_bundle_writer_open(output, force, false, &w));
    SPIN_TRY_OUT(spin_bundle_set_data_path(&meta, folder, s->clip.data_path));
    SPIN_TRY_OUT(write_frames(s, &w, &meta, settled));
    status = spin_bundle_writer_finish(&w, &meta, NULL);
    free(meta.data_path);
    free(meta.data_absolute);
    return status;
out:
    free(meta.data_path);
    free(meta.data_absolute);
    spin_bundle_writer_abandon(&w);
    return status;
}

static void close_settling(struct settling *s)
{
    for (int f = 0; s->mark && f < s->n_frames; f++)
        free(s->mark[f]);
    free(s->mark);
    free(s->image);
    free(s->part);
    free(s->picture);
    free(s->median);
    free(s->change);
    free(s->background);
    free(s->changed);
    free(s->grid);
    free(s->pair);
    spin_image_cache_close(&s->photos);
    spin_pool_free(s->pool);
    spin_splats_free(&s->points);
    spin_splats_free(&s->base);
    spin_splats_free(&s->frame);
    spin_splats_free(&s->out);
    if (s->opened) {
        spin_player_close(&s->player);
        spin_device_close(&s->device);
    }
    spin_clip_close(&s->clip);
}

/* Sets the shares of rows to keep. */
static void set_shares(struct settling *s, const struct spin_settle_options *o)
{
    double rows = (double)s->base.n;

    for (int f = 0; f < s->n_frames; f++)
        for (size_t i = 0; i < s->clip.bundle.meta.frame[f].n; i++)
            rows += s->mark[f][i] ? 0 : 1.0 / s->n_frames;
    s->keep[0] = o->most <= 0 ? o->keep_static : rows > o->most ? o->most / rows : 1;
    s->keep[1] = o->most <= 0 ? o->keep_dynamic : s->keep[0];
}

/* Opens the clip with the images that `clip` names. Captured images are reduced to WIDTH. */
static spin_status open_clip(struct settling *s, struct spin_clip_options *clip)
{
    double scale;

    SPIN_TRY(spin_clip_open(clip, &s->clip));
    scale = (double)WIDTH / s->clip.views.view->camera.width;
    if (spin_clip_is_drawn(&s->clip) || scale >= 1)
        return SPIN_OK;
    spin_clip_close(&s->clip);
    memset(&s->clip, 0, sizeof s->clip);
    clip->image_scale = scale;
    return spin_clip_open(clip, &s->clip);
}

spin_status spin_settle(const struct spin_settle_options *o, struct spin_settled *settled)
{
    struct spin_clip_options clip = {
        .input = o->input, .data = o->data, .data_from = o->data_from, .needs_views = true};
    struct settling s = {0};
    spin_status status;

    memset(settled, 0, sizeof *settled);
    SPIN_TRY(open_clip(&s, &clip));
    SPIN_TRY_OUT(find_static(&s, o->n_threads));
    SPIN_TRY_OUT(gather_static(&s));
    set_shares(&s, o);
    settled->n_frames = s.n_frames;
    SPIN_TRY_OUT(write_bundle(&s, o->output, o->force, settled));
out:
    close_settling(&s);
    return status;
}
