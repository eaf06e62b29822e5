#include "run/settle.h"

#include "base/base.h"
#include "math/activate.h"
#include "math/rng.h"
#include "render/player.h"
#include "scene/data_path.h"

#define COLUMNS (SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES)
/* A splat is dynamic if its pixel has changed, in one frame, in at least this share of the cameras
 * that see it. */
#define SHARE 0.7
#define BEHIND 1.05 /* a splat is visible up to this factor times the depth of the background */
#define FILL_OPACITY 0.1f /* rows of other frames fill holes only above this opacity */
enum {
    /* A pixel has changed if its difference from the median over time is more than LEAST_CHANGE, in
     * 255ths, and more than NOISE_FACTOR times the median of all differences. */
    LEAST_CHANGE = 12,
    NOISE_FACTOR = 3,
    MEDIAN_FRAMES = 31, /* largest number of frames from which the median over time is computed */
    FRAMES = 8,         /* frames that are examined for each splat, besides its own */
    CELLS = 100,        /* cells along the longest side of the grid in which holes are found */
    BLUR = 2,           /* radius of the box filter that is applied to renders */
};

struct settling {
    struct spin_clip clip;
    struct spin_image_cache images;
    int n_cameras, n_frames;
    const struct spin_view **view; /* [n_cameras][n_frames] training views */
    size_t plane;
    int threshold;
    uint8_t *change;     /* [n_cameras][n_frames][plane], difference from the median over time */
    float *background;   /* [n_cameras][plane] depth of the farthest surface over time */
    uint8_t **mark;      /* [n_frames][rows] 1: static; 2: static and stored in `base` */
    double low[3], cell; /* lowest corner and cell size of the grid of holes */
    int dim[3];
    /* [cells] 1: the cell or a neighbouring cell contains a static row; 0: the cell is a hole */
    uint8_t *taken;
    struct spin_splats base; /* the static rows */
    double keep[2];          /* the shares of static and of dynamic rows to keep */
    struct spin_splats frame, out;
};

/* ---- Changed pixels -------------------------------------------------------------------------- */

static spin_status list_views(struct settling *s)
{
    const struct spin_views *views = &s->clip.views;
    int n = 0;

    for (size_t i = 0; i < views->n && views->view[i].dataset_frame == 0; i++)
        n += !views->view[i].test;
    s->n_frames = s->clip.bundle.meta.n_frames;
    s->plane = (size_t)views->view[0].camera.width * (size_t)views->view[0].camera.height;
    SPIN_TRY(spin_alloc((size_t)n * (size_t)s->n_frames, sizeof *s->view, (void **)&s->view));
    for (size_t i = 0; i < views->n; i++) {
        const struct spin_view *v = &views->view[i];

        if (!v->test) /* training cameras have the lowest numbers */
            s->view[v->camera_id * s->n_frames + v->dataset_frame] = v;
    }
    s->n_cameras = n;
    return spin_alloc((size_t)n * (size_t)s->n_frames, s->plane, (void **)&s->change);
}

/* Applies a box filter to n lines of `length` values. Consecutive values of a line are `step` bytes
 * apart, consecutive lines line_step bytes. */
static void blur_lines(const uint8_t *from, int n, size_t line_step, int length, size_t step,
                       uint8_t *out)
{
    for (int k = 0; k < n; k++)
        for (int i = 0; i < length; i++) {
            int sum = 0;

            for (int d = -BLUR; d <= BLUR; d++) {
                int at = i + d < 0 ? 0 : i + d >= length ? length - 1 : i + d;

                sum += from[(size_t)k * line_step + (size_t)at * step];
            }
            out[(size_t)k * line_step + (size_t)i * step] =
                (uint8_t)((sum + BLUR) / (2 * BLUR + 1));
        }
}

static spin_status read_blurred(struct settling *s, const struct spin_view *view, uint8_t *part,
                                uint8_t *out)
{
    int w = view->camera.width, h = view->camera.height;
    size_t row = 3 * (size_t)w;

    if (spin_cancelled())
        return spin_fail_cancelled();
    SPIN_TRY(spin_image_cache_get_rgb8(&s->images, (size_t)(view - s->clip.views.view), out));
    for (size_t c = 0; c < 3; c++) {
        blur_lines(out + c, h, row, w, 3, part + c);
        blur_lines(part + c, w, 3, h, row, out + c);
    }
    return SPIN_OK;
}

/* Returns the median of one value over time, computed from at most MEDIAN_FRAMES frames. */
static uint8_t median_over_time(const struct settling *s, const uint8_t *value)
{
    int stride = (s->n_frames + MEDIAN_FRAMES - 1) / MEDIAN_FRAMES, n = 0;
    uint8_t sorted[MEDIAN_FRAMES] = {0};

    for (int f = 0; f < s->n_frames; f += stride, n++) {
        uint8_t v = value[(size_t)f * 3 * s->plane];
        int k = n;

        for (; k > 0 && sorted[k - 1] > v; k--)
            sorted[k] = sorted[k - 1];
        sorted[k] = v;
    }
    return sorted[n / 2];
}

/* Sets the changes of one camera from the images of all frames, [n_frames][plane][3]. */
static void compare_frames(struct settling *s, const uint8_t *image, uint8_t *change)
{
    for (size_t i = 0; i < 3 * s->plane; i++) {
        uint8_t median = median_over_time(s, image + i);

        for (size_t f = 0; f < (size_t)s->n_frames; f++) {
            int off = abs(image[f * 3 * s->plane + i] - median);
            uint8_t *most = &change[f * s->plane + i / 3];

            *most = off > *most ? (uint8_t)off : *most;
        }
    }
}

/* Renders all images into the cache, frame by frame: this is faster than camera by camera, since
 * each frame is decoded only once. */
static spin_status draw_images(struct settling *s)
{
    struct spin_progress progress;
    SPIN_FREED uint8_t *image = NULL;
    spin_status status = SPIN_OK;

    SPIN_TRY(spin_alloc(s->plane, 3, (void **)&image));
    spin_progress_begin(&progress, "drawing", "images", 0, (int)s->clip.views.n);
    for (size_t i = 0; i < s->clip.views.n && status == SPIN_OK; i++) {
        if (!s->clip.views.view[i].test)
            status = spin_image_cache_get_rgb8(&s->images, i, image);
        if (status == SPIN_OK && spin_cancelled())
            status = spin_fail_cancelled();
        spin_progress_set(&progress, (int)i + 1, "%d frames", s->n_frames);
    }
    spin_progress_end(&progress);
    return status;
}

static spin_status find_changes(struct settling *s)
{
    size_t n = (size_t)s->n_frames;
    SPIN_FREED uint8_t *image = NULL, *part = NULL;

    SPIN_TRY(spin_alloc(n, 3 * s->plane, (void **)&image));
    SPIN_TRY(spin_alloc(s->plane, 3, (void **)&part));
    for (int c = 0; c < s->n_cameras; c++) {
        for (int f = 0; f < s->n_frames; f++)
            SPIN_TRY(read_blurred(s, s->view[c * s->n_frames + f], part,
                                  image + (size_t)f * 3 * s->plane));
        compare_frames(s, image, s->change + (size_t)c * n * s->plane);
    }
    return SPIN_OK;
}

/* Derives the threshold from the flicker of the clip, which the median difference measures. */
static void set_threshold(struct settling *s)
{
    size_t all = (size_t)s->n_cameras * (size_t)s->n_frames * s->plane, sum = 0;
    size_t count[256] = {0};
    int median = 0;

    for (size_t i = 0; i < all; i++)
        count[s->change[i]]++;
    while (median < 255 && (sum += count[median]) < all / 2)
        median++;
    s->threshold = NOISE_FACTOR * median > LEAST_CHANGE ? NOISE_FACTOR * median : LEAST_CHANGE;
}

/* ---- The background -------------------------------------------------------------------------- */

/* Returns frame k of the FRAMES evenly spaced frames, or of all frames if there are fewer. */
static int spread_frame(const struct settling *s, int k)
{
    return k * s->n_frames / (s->n_frames < FRAMES ? s->n_frames : FRAMES);
}

static spin_status add_depths(struct settling *s, struct spin_player *player, float *depth)
{
    for (int k = 0; k < FRAMES && k < s->n_frames; k++) {
        SPIN_TRY(spin_player_show(player, spread_frame(s, k)));
        for (int c = 0; c < s->n_cameras; c++) {
            float *background = s->background + (size_t)c * s->plane, *median = depth + s->plane;
            static const float black[3];

            if (spin_cancelled())
                return spin_fail_cancelled();
            SPIN_TRY(spin_player_draw(player, &s->view[c * s->n_frames]->camera, black, NULL));
            SPIN_TRY(spin_player_layers(player, NULL, depth));
            for (size_t i = 0; i < s->plane; i++) /* a depth of 0: there is no surface */
                background[i] = median[i] > 0 ? fmaxf(background[i], median[i]) : INFINITY;
        }
    }
    return SPIN_OK;
}

/* Finds the depth of the background, which hides splats behind it. What moves in front of it hides
 * a place for a part of the time only. */
static spin_status find_background(struct settling *s, int n_threads)
{
    struct spin_device device;
    struct spin_player player;
    SPIN_FREED float *depth = NULL;
    spin_status status;

    SPIN_TRY(spin_alloc((size_t)s->n_cameras, s->plane * sizeof *s->background,
                        (void **)&s->background));
    SPIN_TRY(spin_alloc(2 * s->plane, sizeof *depth, (void **)&depth));
    SPIN_TRY(spin_device_open("cpu", n_threads, &device));
    status = spin_player_open(&player, &device, &s->clip.bundle, SPIN_FROM_SOURCE);
    if (status == SPIN_OK) {
        status = add_depths(s, &player, depth);
        spin_player_close(&player);
    }
    spin_device_close(&device);
    return status;
}

/* Returns whether camera c sees a point, and sets `pixel` to its pixel and depth. */
static bool sees(const struct settling *s, int c, const float at[3], double pixel[3])
{
    const struct spin_camera *camera = &s->view[c * s->n_frames]->camera;
    size_t i;

    if (!spin_camera_project_visible(camera, at, pixel))
        return false;
    i = (size_t)pixel[1] * (size_t)camera->width + (size_t)pixel[0];
    return pixel[2] <= BEHIND * (double)s->background[(size_t)c * s->plane + i];
}

/* ---- Static rows ----------------------------------------------------------------------------- */

/* Adds 1 to changed[k] if the pixel to which a point projects in camera c has changed in
 * frame[k]. */
static void count_changes(const struct settling *s, const double pixel[3], int c, const int *frame,
                          int n, int *changed)
{
    int width = s->view[c * s->n_frames]->camera.width;
    size_t at = (size_t)pixel[1] * (size_t)width + (size_t)pixel[0];

    for (int k = 0; k < n; k++) {
        size_t image = (size_t)c * (size_t)s->n_frames + (size_t)frame[k];

        changed[k] += s->change[image * s->plane + at] > s->threshold;
    }
}

/* Returns whether a splat of frame `own` is static in its own frame and in FRAMES evenly spaced
 * frames. */
static bool is_static(const struct settling *s, const float at[3], int own)
{
    int frame[FRAMES + 1] = {own}, changed[FRAMES + 1] = {0}, n = 1, seen = 0;

    for (; n <= FRAMES && n <= s->n_frames; n++)
        frame[n] = spread_frame(s, n - 1);
    for (int c = 0; c < s->n_cameras; c++) {
        double pixel[3];

        if (!sees(s, c, at, pixel))
            continue;
        seen++;
        count_changes(s, pixel, c, frame, n, changed);
    }
    for (int k = 0; k < n; k++)
        if (seen >= 2 && changed[k] >= SHARE * seen)
            return false;
    return true;
}

static spin_status read_rows(struct settling *s, int f)
{
    return spin_bundle_frame(&s->clip.bundle, f, COLUMNS, &s->frame);
}

static spin_status mark_rows(struct settling *s)
{
    SPIN_TRY(spin_alloc((size_t)s->n_frames, sizeof *s->mark, (void **)&s->mark));
    for (int f = 0; f < s->n_frames; f++) {
        SPIN_TRY(read_rows(s, f));
        SPIN_TRY(spin_alloc(s->frame.n + 1, 1, (void **)&s->mark[f]));
        for (size_t i = 0; i < s->frame.n; i++)
            s->mark[f][i] = is_static(s, s->frame.means + 3 * i, f);
    }
    return SPIN_OK;
}

/* ---- Shared rows ----------------------------------------------------------------------------- */

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

/* Marks the cell that contains a static row, and its neighbours, as filled. */
static void take_cells(struct settling *s, const float at[3])
{
    for (int k = 0; k < 27; k++) {
        float by[3] = {at[0] + (float)((k % 3 - 1) * s->cell),
                       at[1] + (float)((k / 3 % 3 - 1) * s->cell),
                       at[2] + (float)((k / 9 - 1) * s->cell)};

        s->taken[cell_of(s, by)] = 1;
    }
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
    return spin_alloc((size_t)s->dim[0] * (size_t)s->dim[1] * (size_t)s->dim[2], 1,
                      (void **)&s->taken);
}

static size_t n_sh(const struct spin_splats *s)
{
    return 3 * (size_t)((s->sh_degree + 1) * (s->sh_degree + 1));
}

/* Copies row i of `from` to row k, and adds `larger` to the log scales of the copy. */
static void copy_row(const struct spin_splats *from, size_t i, float larger, struct spin_splats *to,
                     size_t k)
{
    size_t n = n_sh(from);

    memcpy(to->means + 3 * k, from->means + 3 * i, 3 * sizeof(float));
    memcpy(to->quats + 4 * k, from->quats + 4 * i, 4 * sizeof(float));
    memcpy(to->sh + n * k, from->sh + n * i, n * sizeof(float));
    to->logit_opacities[k] = from->logit_opacities[i];
    for (size_t c = 0; c < 3; c++)
        to->log_scales[3 * k + c] = from->log_scales[3 * i + c] + larger;
}

/* Appends the rows of s->frame with mark 2 to the static rows. */
static spin_status append_base(struct settling *s, const uint8_t *mark)
{
    struct spin_splats all = {0};
    size_t n = s->base.n;

    for (size_t i = 0; i < s->frame.n; i++)
        n += mark[i] == 2;
    SPIN_TRY(spin_splats_reserve(&all, n, COLUMNS, s->frame.sh_degree));
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

/* Adds static rows of frame f: all of them if `first`, otherwise those in holes. Their cells are
 * marked only after all rows were examined, so that neighbouring rows of one frame can fill a hole
 * together. */
static spin_status add_static(struct settling *s, int f, bool first)
{
    uint8_t *mark = s->mark[f];

    SPIN_TRY(read_rows(s, f));
    if (first)
        SPIN_TRY(make_grid(s));
    for (size_t i = 0; i < s->frame.n; i++) {
        double opacity = spin_sigmoid_of((double)s->frame.logit_opacities[i]);

        if (mark[i] && (first || (!s->taken[cell_of(s, s->frame.means + 3 * i)] &&
                                  opacity > (double)FILL_OPACITY)))
            mark[i] = 2;
    }
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

    SPIN_TRY(spin_splats_reserve(&s->out, s->base.n + s->frame.n, COLUMNS, s->frame.sh_degree));
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
        SPIN_TRY(spin_bundle_write_frame(w, f, COLUMNS, 0, &s->out));
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
    free(s->view);
    free(s->change);
    free(s->taken);
    free(s->background);
    spin_splats_free(&s->base);
    spin_splats_free(&s->frame);
    spin_splats_free(&s->out);
    spin_image_cache_close(&s->images);
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

spin_status spin_settle(const struct spin_settle_options *o, struct spin_settled *settled)
{
    const struct spin_clip_options clip = {
        .input = o->input, .data = "renders", .data_from = o->data_from, .needs_views = true};
    struct settling s = {0};
    spin_status status;

    memset(settled, 0, sizeof *settled);
    SPIN_TRY(spin_clip_open(&clip, &s.clip));
    SPIN_TRY_OUT(list_views(&s));
    SPIN_TRY_OUT(
        spin_image_cache_open(&s.clip.views, spin_memory_available() / 4, NULL, &s.images));
    SPIN_TRY_OUT(draw_images(&s));
    SPIN_TRY_OUT(find_changes(&s));
    set_threshold(&s);
    SPIN_TRY_OUT(find_background(&s, o->n_threads));
    SPIN_TRY_OUT(mark_rows(&s));
    SPIN_TRY_OUT(gather_static(&s));
    set_shares(&s, o);
    SPIN_TRY_OUT(write_bundle(&s, o->output, o->force, settled));
out:
    close_settling(&s);
    return status;
}
