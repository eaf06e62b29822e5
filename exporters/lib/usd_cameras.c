#include <stdlib.h>

#include "base/base.h"
#include "exporters/lib/usd_export.h"

struct visitor {
    spin_usd_camera_fn visit;
    void *context;
};

/* Sets `out` to the matrix that maps to the world, in the axes of the file, from a camera with the
 * axes x right, y up, z back. The rows of the matrix are the three axes and the position of the
 * camera. */
static void make_matrix(const struct spin_usd_export *x, const struct spin_camera *camera,
                        double out[4][4])
{
    const double *m = camera->w2c, *q = x->frames.rows.turn_q;
    double back[4] = {q[0], q[1], q[2], q[3]}, row[4][3] = {{0}};

    for (int r = 0; r < 3; r++)
        for (int c = 0; c < 3; c++) {
            row[r][c] = (r == 0 ? 1 : -1) * m[4 * r + c];
            row[3][c] -= m[4 * r + c] * m[4 * r + 3];
        }
    /* The vector v, rotated by the quaternion (w, u), is v + 2 w u x v + 2 u x (u x v). */
    for (int r = 0; r < 4; r++) {
        double *v = row[r], *u = back + 1, a[3], b[3];

        for (int c = 0; c < 3; c++)
            a[c] = u[(c + 1) % 3] * v[(c + 2) % 3] - u[(c + 2) % 3] * v[(c + 1) % 3];
        for (int c = 0; c < 3; c++)
            b[c] = u[(c + 1) % 3] * a[(c + 2) % 3] - u[(c + 2) % 3] * a[(c + 1) % 3];
        for (int c = 0; c < 3; c++)
            v[c] += 2 * back[0] * a[c] + 2 * b[c];
        for (int c = 0; c < 3; c++)
            out[r][c] = v[c] + 0.0;
        out[r][3] = r == 3;
    }
}

static double focal_of(const struct spin_camera *camera)
{
    return camera->fx * SPIN_USD_APERTURE / camera->width;
}

/* Calls visit() for a camera that has the pose and the focal length of camera[k] at time[k]. All
 * other intrinsics are those of camera[0]. */
static spin_status visit_camera(const struct spin_usd_export *x, const char *name,
                                const struct spin_camera *camera, const double *time, size_t n,
                                const struct visitor *visitor)
{
    double focal = focal_of(camera);
    struct spin_usd_camera is = {.name = name, .n = n, .time = time};
    spin_status status = SPIN_OK;

    is.clip_near = 0.05 * spin_camera_near(camera);
    is.high = focal * camera->height / camera->fy;
    is.offset[0] = (0.5 * camera->width - camera->cx) / camera->fx * focal;
    is.offset[1] = (camera->cy - 0.5 * camera->height) / camera->fy * focal;
    SPIN_TRY_OUT(spin_alloc(n, sizeof *is.focal, (void **)&is.focal));
    SPIN_TRY_OUT(spin_alloc(n, sizeof *is.matrix, (void **)&is.matrix));
    for (size_t k = 0; k < n; k++) {
        is.focal[k] = focal_of(&camera[k]);
        make_matrix(x, &camera[k], is.matrix[k]);
        is.zooms = is.zooms || is.focal[k] != focal;
        is.moves = is.moves || memcmp(camera[k].w2c, camera->w2c, sizeof camera->w2c) != 0;
    }
    visitor->visit(visitor->context, &is);
out:
    free(is.focal);
    free(is.matrix);
    return status;
}

/* Returns the index of view v among the views with the same camera id and the same data-set
 * frame. */
static int duplicate_index(const struct spin_views *views, size_t v)
{
    size_t first = v;

    while (first > 0 && views->view[first - 1].dataset_frame == views->view[v].dataset_frame &&
           views->view[first - 1].camera_id == views->view[v].camera_id)
        first--;
    return (int)(v - first);
}

static bool find_frame(const struct spin_usd_export *x, const struct spin_view *view, size_t *frame)
{
    for (*frame = 0; *frame < x->frames.n_entries; ++*frame)
        if (x->frames.job->dataset_frame_of[*frame] == view->dataset_frame)
            return true;
    return false;
}

/* Visits each camera of the data set that has a view in the exported frames. */
static spin_status visit_rig(const struct spin_usd_export *x, const struct visitor *visitor)
{
    const struct spin_views *views = x->frames.job->views;
    size_t n_views = views && x->frames.job->dataset_frame_of ? views->n : 0;
    SPIN_FREED struct spin_camera *camera = NULL;
    SPIN_FREED double *time = NULL;
    SPIN_FREED bool *done = NULL;

    SPIN_TRY(spin_alloc(n_views + 1, sizeof *camera, (void **)&camera));
    SPIN_TRY(spin_alloc(n_views + 1, sizeof *time, (void **)&time));
    SPIN_TRY(spin_alloc(n_views + 1, sizeof *done, (void **)&done));
    for (size_t v = 0; v < n_views; v++) {
        const struct spin_view *view = &views->view[v];
        size_t n = 0, frame;
        char name[48], twin[16] = "";

        for (size_t w = v; w < n_views && !done[v]; w++) {
            if (views->view[w].camera_id != view->camera_id ||
                duplicate_index(views, w) != duplicate_index(views, v))
                continue;
            done[w] = w > v;
            if (!find_frame(x, &views->view[w], &frame))
                continue;
            camera[n] = views->view[w].camera;
            time[n++] = x->frames.entry[frame].number;
        }
        if (duplicate_index(views, v) > 0)
            snprintf(twin, sizeof twin, "_%d", duplicate_index(views, v) + 1);
        snprintf(name, sizeof name, "cam_%02d%s", view->camera_id, twin);
        if (n > 0)
            SPIN_TRY(visit_camera(x, name, camera, time, n, visitor));
    }
    return SPIN_OK;
}

/* Visits the camera of --path. The poses are evenly spaced in time, from the first frame to the end
 * of the last frame. */
static spin_status visit_path(const struct spin_usd_export *x, const struct visitor *visitor)
{
    size_t n = (size_t)x->path.n_pictures;
    double first = x->frames.entry[0].number;
    SPIN_FREED double *time = NULL;
    double span = x->frames.entry[x->frames.n_entries - 1].number + x->codes - first;

    SPIN_TRY(spin_alloc(n, sizeof *time, (void **)&time));
    for (size_t p = 0; p < n; p++)
        time[p] = first + span * (double)p / (double)n;
    return visit_camera(x, spin_camera_path_name(&x->path), x->camera, time, n, visitor);
}

spin_status spin_usd_begin_path(struct spin_usd_export *x)
{
    if (!x->has_path || x->camera)
        return SPIN_OK;
    SPIN_TRY(spin_alloc((size_t)x->path.n_pictures, sizeof *x->camera, (void **)&x->camera));
    for (int64_t p = 0; p < x->path.n_pictures; p++)
        SPIN_TRY(spin_camera_path_camera(&x->path, p, x->frames.rows.splats, &x->camera[p]));
    return SPIN_OK;
}

bool spin_usd_has_cameras(const struct spin_usd_export *x)
{
    return x->camera || (x->frames.job->views && x->frames.job->views->n > 0);
}

spin_status spin_usd_each_camera(const struct spin_usd_export *x, spin_usd_camera_fn visit,
                                 void *context)
{
    const struct visitor visitor = {visit, context};

    SPIN_TRY(visit_rig(x, &visitor));
    return x->camera ? visit_path(x, &visitor) : SPIN_OK;
}
