#include "geometry/camera_rig.h"

#include "base/base.h"

/* spin_camera_pivot() fails if the mean of I - d d^T over all camera axes d has a determinant
 * below this. Parallel axes have a determinant of 0; axes that spread by about 3 degrees reach this
 * value. */
#define LEAST_SPREAD 2e-3

void spin_camera_centre(const struct spin_camera *camera, double out[3])
{
    const double *m = camera->w2c;

    for (int c = 0; c < 3; c++)
        out[c] = -(m[c] * m[3] + m[4 + c] * m[7] + m[8 + c] * m[11]);
}

static double det3(const double a[3], const double b[3], const double c[3])
{
    return a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0]) +
           a[2] * (b[0] * c[1] - b[1] * c[0]);
}

/* Sums I - d d^T into the columns a, and (I - d d^T) e into b, over all cameras with axis d and
 * centre e: the normal equations of the point nearest to all axes. Returns the number of cameras.
 */
static int sum_axes(const struct spin_views *views, int row, double a[3][3], double b[3])
{
    int n = 0;

    for (size_t i = 0; i < views->n; i++) {
        const double *axis = views->view[i].camera.w2c + 8;
        double eye[3];

        if (row >= 0 && views->view[i].dataset_frame != row)
            continue;
        spin_camera_centre(&views->view[i].camera, eye);
        n++;
        for (int r = 0; r < 3; r++)
            for (int c = 0; c < 3; c++) {
                double part = (r == c) - axis[r] * axis[c];

                a[c][r] += part;
                b[r] += part * eye[c];
            }
    }
    return n;
}

bool spin_camera_pivot(const struct spin_views *views, int row, double pivot[3], double *median)
{
    double a[3][3] = {{0}}, b[3] = {0}, det, at[3];
    SPIN_FREED double *away = NULL;
    int n = views ? sum_axes(views, row, a, b) : 0, n_away = 0, n_behind = 0;

    det = det3(a[0], a[1], a[2]);
    if (n < 2 || !(det > LEAST_SPREAD * n * n * n) ||
        spin_alloc((size_t)n, sizeof *away, (void **)&away) != SPIN_OK)
        return false;
    at[0] = det3(b, a[1], a[2]) / det;
    at[1] = det3(a[0], b, a[2]) / det;
    at[2] = det3(a[0], a[1], b) / det;
    for (size_t i = 0; i < views->n; i++) {
        const double *axis = views->view[i].camera.w2c + 8;
        double eye[3], along = 0, square = 0;

        if (row >= 0 && views->view[i].dataset_frame != row)
            continue;
        spin_camera_centre(&views->view[i].camera, eye);
        for (int c = 0; c < 3; c++) {
            along += (at[c] - eye[c]) * axis[c];
            square += (at[c] - eye[c]) * (at[c] - eye[c]);
        }
        n_behind += along <= 0;
        away[n_away++] = sqrt(square);
    }
    qsort(away, (size_t)n, sizeof *away, spin_by_double);
    if (2 * n_behind < n) {
        memcpy(pivot, at, sizeof at);
        *median = away[n / 2];
    }
    return 2 * n_behind < n;
}

/* ---- Near plane ------------------------------------------------------------------------------ */

enum {
    NEAR_VIEWS = 64,    /* maximum number of views that are sampled, evenly spaced */
    NEAR_POINTS = 4096, /* maximum number of points that are sampled, evenly spaced */
    /* 1/NEAR_SHARE of the points in an image are nearer than the depth of the foreground. */
    NEAR_SHARE = 20,
    /* A warning is printed if the near plane cuts off over 1/CUT_SHARE of the points in an
     * image. */
    CUT_SHARE = 100
};
/* Maximum distance of the near plane, as a fraction of the foreground's depth. */
static const double before_foreground = 0.25;

/* Samples the points, lists the depths of those inside a camera's image in ascending order, and
 * returns the number of listed depths. */
static size_t list_depths(const struct spin_camera *camera, const float *points, size_t n,
                          float *depth)
{
    size_t n_inside = 0, stride = n / NEAR_POINTS + 1;
    double p[3];

    for (size_t i = 0; i < n; i += stride)
        if (spin_camera_project_visible(camera, points + 3 * i, p))
            depth[n_inside++] = (float)p[2];
    qsort(depth, n_inside, sizeof *depth, spin_by_float);
    return n_inside;
}

/* Prints a warning about the view whose near plane cuts off the largest share of the points in its
 * image, if this share is more than 1 / CUT_SHARE. */
static void warn_cut(const struct spin_views *views, const float *points, size_t n, float *depth)
{
    const struct spin_view *worst = NULL;
    size_t step = views->n / NEAR_VIEWS + 1;
    double most = 1.0 / CUT_SHARE;

    for (size_t v = 0; v < views->n; v += step) {
        const struct spin_camera *camera = &views->view[v].camera;
        size_t n_inside = list_depths(camera, points, n, depth), n_cut = 0;

        while (n_cut < n_inside && (double)depth[n_cut] <= spin_camera_near(camera))
            n_cut++;
        if ((double)n_cut > most * (double)n_inside) {
            worst = &views->view[v];
            most = (double)n_cut / (double)n_inside;
        }
    }
    if (worst)
        spin_warn("camera %d: %.0f %% of the splats in its image are cut off by the near plane at "
                  "%.3g world units: check whether the camera is inside the scene's splats",
                  worst->camera_id, 100 * most, spin_camera_near(&worst->camera));
}

spin_status spin_views_set_near(struct spin_views *views, const float *points, size_t n, bool warns)
{
    size_t step = views->n / NEAR_VIEWS + 1, n_views = 0;
    SPIN_FREED float *depth = NULL;
    float foreground[NEAR_VIEWS];
    double z_near;

    SPIN_TRY(spin_alloc(NEAR_POINTS, sizeof *depth, (void **)&depth));
    for (size_t v = 0; v < views->n; v += step) {
        size_t n_inside = list_depths(&views->view[v].camera, points, n, depth);

        if (n_inside > 0)
            foreground[n_views++] = depth[n_inside / NEAR_SHARE];
    }
    qsort(foreground, n_views, sizeof *foreground, spin_by_float);
    z_near = n_views > 0 ? before_foreground * (double)foreground[n_views / 2] : SPIN_NEAR;
    for (size_t v = 0; v < views->n && z_near < SPIN_NEAR; v++)
        views->view[v].camera.z_near = z_near;
    if (warns)
        warn_cut(views, points, n, depth);
    return SPIN_OK;
}

/* ---- The cone -------------------------------------------------------------------------------- */

/* Sine of 3 degrees: a camera counts as outside the cone only if its direction from the apex is
 * more than 3 degrees outside. */
static const double least_outside = 0.05;

/* A training camera. */
struct camera {
    int id;
    size_t n_views;
    double centre[3]; /* mean over its views */
    double direction[3];
};

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* Sets `out` to unit normal k, 0 <= k < SPIN_CONE_PLANES. The normals are points on a spiral that
 * turns by the golden angle, which spreads them evenly over the sphere. */
static void set_normal(int k, double out[3])
{
    double z = 1 - (2 * k + 1.0) / SPIN_CONE_PLANES, angle = k * M_PI * (3 - sqrt(5));

    out[0] = sqrt(1 - z * z) * cos(angle);
    out[1] = sqrt(1 - z * z) * sin(angle);
    out[2] = z;
}

/* Sets camera->direction to the unit vector from the apex to the camera's centre. */
static void set_direction(const double apex[3], struct camera *camera)
{
    double length = 0;

    for (int c = 0; c < 3; c++) {
        camera->direction[c] = camera->centre[c] - apex[c];
        length += camera->direction[c] * camera->direction[c];
    }
    for (int c = 0; c < 3; c++)
        camera->direction[c] /= sqrt(length) + 1e-300;
}

/* Measures the cone of all n cameras but camera `but`; if `but` is n, of all cameras. */
static void measure_cone(struct spin_camera_cone *cone, const struct camera *camera, size_t n,
                         size_t but)
{
    for (int k = 0; k < SPIN_CONE_PLANES; k++) {
        double normal[3];

        set_normal(k, normal);
        cone->taken[k] = false;
        for (size_t i = 0; i < n && !cone->taken[k]; i++)
            cone->taken[k] = i != but && dot(normal, camera[i].direction) > 0;
    }
}

/* Returns the sine of the angle by which a camera is outside the cone; 0 inside. */
static double protrusion(const struct spin_camera_cone *cone, const struct camera *camera)
{
    double most = 0, normal[3];

    for (int k = 0; k < SPIN_CONE_PLANES; k++) {
        if (cone->taken[k])
            continue;
        set_normal(k, normal);
        most = fmax(most, dot(normal, camera->direction));
    }
    return most;
}

static spin_status find_apex(const struct spin_views *views, double apex[3])
{
    double median;

    return spin_camera_pivot(views, -1, apex, &median)
               ? SPIN_OK
               : spin_unsupported("outer cameras are not defined for this data set: its cameras do "
                                  "not look at a common point");
}

spin_status spin_camera_cone_open(const struct spin_views *views, struct spin_camera_cone *out)
{
    SPIN_FREED struct camera *camera = NULL;
    size_t n = 0;

    SPIN_TRY(spin_alloc(views->n, sizeof *camera, (void **)&camera));
    SPIN_TRY(find_apex(views, out->apex));
    for (size_t i = 0; i < views->n; i++) {
        if (views->view[i].test)
            continue;
        spin_camera_centre(&views->view[i].camera, camera[n].centre);
        set_direction(out->apex, &camera[n++]);
    }
    measure_cone(out, camera, n, n);
    return SPIN_OK;
}

bool spin_camera_cone_excludes(const struct spin_camera_cone *cone,
                               const struct spin_camera *camera)
{
    struct camera at = {0};

    spin_camera_centre(camera, at.centre);
    set_direction(cone->apex, &at);
    return protrusion(cone, &at) > least_outside;
}

/* ---- Holding cameras out --------------------------------------------------------------------- */

/* Lists the training cameras and returns their number. */
static size_t list_cameras(const struct spin_views *views, const double apex[3],
                           struct camera *camera)
{
    size_t n = 0;

    for (size_t i = 0; i < views->n; i++) {
        size_t k = 0;
        double centre[3];

        if (views->view[i].test)
            continue;
        while (k < n && camera[k].id != views->view[i].camera_id)
            k++;
        if (k == n)
            camera[n++] = (struct camera){.id = views->view[i].camera_id};
        spin_camera_centre(&views->view[i].camera, centre);
        camera[k].n_views++;
        for (int c = 0; c < 3; c++)
            camera[k].centre[c] += (centre[c] - camera[k].centre[c]) / (double)camera[k].n_views;
    }
    for (size_t k = 0; k < n; k++)
        set_direction(apex, &camera[k]);
    return n;
}

/* Returns the index of the camera that is farthest outside the cone of the other cameras, or n if
 * no camera is outside. */
static size_t find_outermost(struct spin_camera_cone *cone, const struct camera *camera, size_t n)
{
    size_t found = n;
    double most = 0;

    for (size_t i = 0; i < n; i++) {
        double outside;

        measure_cone(cone, camera, n, i);
        outside = protrusion(cone, &camera[i]);
        if (outside > most) {
            most = outside;
            found = i;
        }
    }
    return found;
}

spin_status spin_outer_cameras_hold(struct spin_views *views, int n)
{
    SPIN_FREED struct camera *camera = NULL;
    struct spin_camera_cone cone;
    size_t left;

    SPIN_TRY(spin_alloc(views->n, sizeof *camera, (void **)&camera));
    SPIN_TRY(find_apex(views, cone.apex));
    left = list_cameras(views, cone.apex, camera);
    if (left < (size_t)n + 2)
        return spin_misuse("cannot hold out %d of %s: two must remain for the training", n,
                           spin_text_count((int)left, "training camera", (char[48]){0}));
    for (; n > 0; n--) {
        size_t outermost = find_outermost(&cone, camera, left);

        if (outermost == left)
            return spin_misuse("no camera can be held out as outermost: the cameras surround the "
                               "scene");
        for (size_t i = 0; i < views->n; i++)
            views->view[i].test |= views->view[i].camera_id == camera[outermost].id;
        camera[outermost] = camera[--left];
    }
    return SPIN_OK;
}
