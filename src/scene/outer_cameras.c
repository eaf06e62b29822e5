#include "scene/outer_cameras.h"

#include "base/base.h"
#include "geometry/camera_rig.h"

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

/* ---- The cone -------------------------------------------------------------------------------- */

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
