/* Draws points over images and finds outlying cameras. Each point is drawn as a square of its own
 * colour, and near points cover far ones. The image behind the points is darkened, so that a
 * mismatch shows as a double image. Outliers are found by the median and the median absolute
 * deviation (MAD), which are reliable as long as fewer than half of the views are wrong. */
#include "run/camera_check.h"

#include <float.h>

#include "base/base.h"
#include "math/sh.h"

#define DARKEN 0.45f
/* The radius of a square, in pixels, is the image width divided by this number, rounded down. A
 * square of radius 0 is a single pixel. */
#define PIXELS_PER_RADIUS 900

struct canvas {
    int width, height;
    float *image; /* [3][h][w] */
    float *depth; /* [h][w] depth of the nearest point drawn at each pixel */
};

static float clamp01(float value) { return value > 0 ? (value < 1 ? value : 1) : 0; }

static void point_colour(const struct spin_splats *s, size_t i, float rgb[3])
{
    static const float orange[3] = {1, 0.5f, 0};
    size_t side = (size_t)(s->sh_degree + 1);

    for (int c = 0; c < 3; c++) {
        if (s->rgb)
            rgb[c] = clamp01(s->rgb[3 * i + (size_t)c]);
        else if (s->sh)
            rgb[c] = clamp01(0.5f + (float)SPIN_SH_C0 * s->sh[3 * side * side * i + (size_t)c]);
        else
            rgb[c] = orange[c];
    }
}

static void draw_square(struct canvas *canvas, int u, int v, float depth, const float rgb[3])
{
    int radius = canvas->width / PIXELS_PER_RADIUS;
    size_t plane = (size_t)canvas->width * (size_t)canvas->height;

    for (int y = v - radius; y <= v + radius; y++) {
        for (int x = u - radius; x <= u + radius; x++) {
            size_t at = (size_t)y * (size_t)canvas->width + (size_t)x;

            if (x < 0 || y < 0 || x >= canvas->width || y >= canvas->height ||
                canvas->depth[at] <= depth)
                continue;
            canvas->depth[at] = depth;
            for (size_t c = 0; c < 3; c++)
                canvas->image[c * plane + at] = rgb[c];
        }
    }
}

/* Draws every stride-th point on the canvas, and sets *out to the shares of these points that are
 * in front of the camera and inside its image. If canvas is NULL, nothing is drawn. */
static void draw_points(struct canvas *canvas, const struct spin_camera *camera,
                        const struct spin_splats *s, size_t stride,
                        struct spin_camera_overlay_share *out)
{
    size_t n = 0, in_front = 0, inside = 0;

    for (size_t i = 0; i < s->n; i += stride, n++) {
        double p[3];
        float rgb[3];

        if (!spin_camera_project(camera, s->means + 3 * i, p))
            continue;
        in_front++;
        if (!(p[0] >= 0 && p[1] >= 0 && p[0] < camera->width && p[1] < camera->height))
            continue;
        inside++;
        if (!canvas)
            continue;
        point_colour(s, i, rgb);
        draw_square(canvas, (int)p[0], (int)p[1], (float)p[2], rgb);
    }
    out->in_front = n ? (double)in_front / (double)n : 0;
    out->inside = n ? (double)inside / (double)n : 0;
}

spin_status spin_camera_overlay_draw(const struct spin_view *view, const struct spin_splats *s,
                                     const char *path, struct spin_camera_overlay_share *out)
{
    int width = view->camera.width, height = view->camera.height;
    size_t plane = (size_t)width * (size_t)height;
    SPIN_FREED float *image = NULL, *depth = NULL;

    SPIN_TRY(spin_alloc(plane, 3 * sizeof *image, (void **)&image));
    SPIN_TRY(spin_alloc(plane, sizeof *depth, (void **)&depth));
    SPIN_TRY(spin_image_load(view->path, width, height, NULL, image));
    for (size_t i = 0; i < 3 * plane; i++)
        image[i] *= DARKEN;
    for (size_t i = 0; i < plane; i++)
        depth[i] = FLT_MAX;
    draw_points(&(struct canvas){width, height, image, depth}, &view->camera, s, 1, out);
    return spin_image_save(path, width, height, image, false);
}

/* Returns the number of views of frame `row` of the data set, which are adjacent, and sets *first
 * to the index of the first of them. */
static size_t find_views(const struct spin_views *views, int row, size_t *first)
{
    size_t n = 0;

    *first = 0;
    while (*first < views->n && views->view[*first].dataset_frame < row)
        (*first)++;
    while (*first + n < views->n && views->view[*first + n].dataset_frame == row)
        n++;
    return n;
}

size_t spin_camera_overlay_choose(const struct spin_views *views, int row, size_t most,
                                  size_t *index)
{
    size_t first, n = find_views(views, row, &first), chosen = n < most ? n : most;

    for (size_t i = 0; i < chosen; i++)
        index[i] = first + i * n / chosen;
    return chosen;
}

/* ---- Outlying cameras ------------------------------------------------------------------------ */

/* About this many points, evenly spaced in the list of points, are projected into each view. */
#define POINTS 4096
/* With fewer views than this, no view is called an outlier, since the median is then unreliable. */
#define LEAST_VIEWS 4
/* A view is an outlier if its share of the points is below the median of all views by more than
 * DEVIATIONS standard deviations, estimated from the MAD. The difference must also exceed
 * LEAST_GAP, since the shares of correct cameras differ too. */
#define DEVIATIONS 6
#define LEAST_GAP 0.25

struct view_shares {
    size_t view;
    double share[2]; /* share of points in front of the camera; share inside the image */
};

static double median(double *values, size_t n)
{
    qsort(values, n, sizeof *values, spin_by_double);
    return n % 2 ? values[n / 2] : 0.5 * (values[n / 2 - 1] + values[n / 2]);
}

/* Computes the median of share[which] over all views, and the limit of this share below which a
 * view is an outlier. */
static void find_limit(const struct view_shares *view_shares, size_t n, int which, double *values,
                       double *middle, double *limit)
{
    for (size_t i = 0; i < n; i++)
        values[i] = view_shares[i].share[which];
    *middle = median(values, n);
    for (size_t i = 0; i < n; i++)
        values[i] = fabs(view_shares[i].share[which] - *middle);
    *limit = *middle - fmax(LEAST_GAP, DEVIATIONS * 1.4826 * median(values, n));
}

/* Returns whether view a of a camera is worse than view b of the same camera. If only one of them
 * is an outlier, that one is worse; otherwise the view with fewer points inside its image is
 * worse. */
static bool is_lower(const struct spin_camera_share *a, const struct spin_camera_share *b)
{
    return a->apart != b->apart ? a->apart : a->inside < b->inside;
}

/* Adds a view to the list of cameras, which contains each camera with its worst view so far. */
static void add_camera(const struct spin_views *views, const struct spin_camera_share *one,
                       struct spin_camera_shares *out)
{
    int id = views->view[one->view].camera_id;
    size_t k = 0;

    while (k < out->n && views->view[out->camera[k].view].camera_id != id)
        k++;
    if (k == out->n || is_lower(one, &out->camera[k]))
        out->camera[k] = *one;
    out->n += k == out->n;
}

/* Computes the shares of every view of the given data set frames, and returns the number of these
 * views. */
static size_t measure_views(const struct spin_views *views, const int *rows, int n_rows,
                            const struct spin_splats *s, struct view_shares *view_shares)
{
    size_t n = 0;

    for (int r = 0; r < n_rows; r++) {
        size_t first, n_views = find_views(views, rows[r], &first);

        for (size_t v = first; v < first + n_views && n < views->n; v++) {
            struct spin_camera_overlay_share share;

            draw_points(NULL, &views->view[v].camera, s, s->n / POINTS + 1, &share);
            view_shares[n++] = (struct view_shares){v, {share.in_front, share.inside}};
        }
    }
    return n;
}

/* Returns whether a point is inside the image of at least one of n views. */
static bool is_seen(const struct spin_view *view, size_t n, const float *point)
{
    for (size_t v = 0; v < n; v++) {
        const struct spin_camera *c = &view[v].camera;
        double p[3];

        if (spin_camera_project(c, point, p) && p[0] >= 0 && p[1] >= 0 && p[0] < c->width &&
            p[1] < c->height)
            return true;
    }
    return false;
}

/* Returns the share of the points that are inside the image of at least one view of data-set frame
 * `row`. */
static double share_seen(const struct spin_views *views, int row, const struct spin_splats *s)
{
    size_t first, n_views = find_views(views, row, &first), n = 0, n_seen = 0;

    for (size_t i = 0; i < s->n; i += s->n / POINTS + 1, n++)
        n_seen += is_seen(views->view + first, n_views, s->means + 3 * i);
    return n > 0 ? (double)n_seen / (double)n : 0;
}

spin_status spin_camera_shares(const struct spin_views *views, const int *rows, int n_rows,
                               const struct spin_splats *s, struct spin_camera_shares *out)
{
    SPIN_FREED double *values = NULL;
    double limit[2];
    SPIN_FREED struct view_shares *view_shares = NULL;
    size_t n;

    *out = (struct spin_camera_shares){0};
    SPIN_TRY(spin_alloc(views->n, sizeof *view_shares, (void **)&view_shares));
    SPIN_TRY(spin_alloc(views->n, sizeof *values, (void **)&values));
    SPIN_TRY(spin_alloc(views->n, sizeof *out->camera, (void **)&out->camera));
    n = measure_views(views, rows, n_rows, s, view_shares);
    if (n == 0)
        return SPIN_OK;
    out->seen = share_seen(views, rows[n_rows - 1], s);
    find_limit(view_shares, n, 0, values, &out->in_front, &limit[0]);
    find_limit(view_shares, n, 1, values, &out->inside, &limit[1]);
    for (size_t i = 0; i < n; i++) {
        const double *share = view_shares[i].share;
        bool apart = n >= LEAST_VIEWS && (share[0] < limit[0] || share[1] < limit[1]);

        add_camera(views,
                   &(struct spin_camera_share){view_shares[i].view, share[0], share[1], apart},
                   out);
    }
    return SPIN_OK;
}
