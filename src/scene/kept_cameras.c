#include "scene/kept_cameras.h"

#include "base/base.h"
#include "io/file.h"

#define MOST_CAMERAS 256
/* Rotations R are accepted if no element of R R^T deviates from the identity by more than this. */
#define ROTATION_ERROR 1e-3

static bool is_same_camera(const struct spin_camera *a, const struct spin_camera *b)
{
    return a->width == b->width && a->height == b->height && a->fx == b->fx && a->fy == b->fy &&
           memcmp(a->w2c, b->w2c, sizeof a->w2c) == 0;
}

static bool has_rotation(const double m[12])
{
    double det;

    for (int a = 0; a < 3; a++)
        for (int b = 0; b < 3; b++) {
            const double *u = m + 4 * a, *v = m + 4 * b;

            if (!(fabs(u[0] * v[0] + u[1] * v[1] + u[2] * v[2] - (a == b)) <= ROTATION_ERROR))
                return false;
        }
    det = m[0] * (m[5] * m[10] - m[6] * m[9]) - m[1] * (m[4] * m[10] - m[6] * m[8]) +
          m[2] * (m[4] * m[9] - m[5] * m[8]);
    return det > 0;
}

static bool is_valid(const struct spin_camera *c)
{
    const double *values[] = {&c->fx, &c->fy, &c->cx, &c->cy, &c->w2c[3], &c->w2c[7], &c->w2c[11]};

    for (int i = 0; i < 7; i++)
        if (!(fabs(*values[i]) < 1e18))
            return false;
    return c->width > 0 && c->height > 0 && c->width <= 65536 && c->height <= 65536 && c->fx > 0 &&
           c->fy > 0 && has_rotation(c->w2c);
}

/* Appends a camera, without the image, if there are fewer than MOST_CAMERAS. */
static spin_status add_camera(struct spin_views *out, const struct spin_camera *camera, int id,
                              bool test)
{
    struct spin_view view = {.camera = *camera, .camera_id = id, .number = -1, .test = test};

    view.camera.z_near = 0;
    out->n_dataset_frames = 1;
    return out->n < MOST_CAMERAS ? spin_views_add(out, &view) : SPIN_OK;
}

spin_status spin_kept_cameras_choose(const struct spin_views *views, int row,
                                     struct spin_views *out)
{
    spin_views_free(out);
    for (size_t v = 0; v < views->n; v++) {
        const struct spin_view *view = &views->view[v];

        if (view->dataset_frame == row)
            SPIN_TRY(add_camera(out, &view->camera, view->camera_id, view->test));
    }
    return SPIN_OK;
}

/* ---- In meta.json ---------------------------------------------------------------------------- */

spin_json *spin_kept_cameras_json(const struct spin_views *kept)
{
    spin_json *list = spin_json_array();

    for (size_t v = 0; v < kept->n; v++) {
        const struct spin_camera *c = &kept->view[v].camera;
        double lens[4] = {c->fx, c->fy, c->cx, c->cy};
        spin_json *entry = spin_json_object();

        spin_json_set_integer(entry, "camera", kept->view[v].camera_id);
        spin_json_set_integer(entry, "width", c->width);
        spin_json_set_integer(entry, "height", c->height);
        spin_json_set(entry, "lens", spin_json_numbers(lens, 4));
        spin_json_set(entry, "w2c", spin_json_numbers(c->w2c, 12));
        if (kept->view[v].test)
            spin_json_set_bool(entry, "test", true);
        spin_json_push(list, entry);
    }
    return list;
}

static bool read_numbers(const spin_json *list, size_t n, double *out)
{
    bool good = spin_json_length(list) == n;

    for (size_t i = 0; i < n && good; i++)
        good = spin_json_number(spin_json_at(list, i), &out[i]);
    return good;
}

static bool read_size(const spin_json *entry, struct spin_camera *c)
{
    int64_t width, height;

    if (!spin_json_integer(spin_json_get(entry, "width"), &width) ||
        !spin_json_integer(spin_json_get(entry, "height"), &height) || width < 1 || height < 1 ||
        width > 65536 || height > 65536)
        return false;
    c->width = (int)width;
    c->height = (int)height;
    return true;
}

static bool read_entry(const spin_json *entry, struct spin_view *view)
{
    struct spin_camera *c = &view->camera;
    double lens[4];
    int64_t id;

    if (!spin_json_integer(spin_json_get(entry, "camera"), &id) || id < INT_MIN || id > INT_MAX ||
        !read_size(entry, c) || !read_numbers(spin_json_get(entry, "lens"), 4, lens) ||
        !read_numbers(spin_json_get(entry, "w2c"), 12, c->w2c))
        return false;
    c->fx = lens[0];
    c->fy = lens[1];
    c->cx = lens[2];
    c->cy = lens[3];
    view->camera_id = (int)id;
    spin_json_bool(spin_json_get(entry, "test"), &view->test);
    return is_valid(c);
}

spin_status spin_kept_cameras_read(const spin_json *list, struct spin_views *out)
{
    for (size_t i = 0; i < spin_json_length(list); i++) {
        struct spin_view view = {0};

        if (!read_entry(spin_json_at(list, i), &view))
            return spin_malformed("meta.json: entry %zu of 'cameras' is not a valid camera", i);
        SPIN_TRY(add_camera(out, &view.camera, view.camera_id, view.test));
    }
    return SPIN_OK;
}

/* ---- From the cameras.json of a run ---------------------------------------------------------- */

/* Reads an entry of cameras.json: position is the centre of the camera, and rotation the rotation
 * from the camera to the world. The principal point is the middle of the image. */
static bool read_run_entry(const spin_json *entry, struct spin_camera *c)
{
    const spin_json *rotation = spin_json_get(entry, "rotation");
    double centre[3], row[3];

    if (!read_size(entry, c) || !spin_json_number(spin_json_get(entry, "fx"), &c->fx) ||
        !spin_json_number(spin_json_get(entry, "fy"), &c->fy) ||
        !read_numbers(spin_json_get(entry, "position"), 3, centre) ||
        spin_json_length(rotation) != 3)
        return false;
    for (size_t a = 0; a < 3; a++) {
        if (!read_numbers(spin_json_at(rotation, a), 3, row))
            return false;
        for (size_t b = 0; b < 3; b++)
            c->w2c[4 * b + a] = row[b];
    }
    for (int b = 0; b < 3; b++)
        c->w2c[4 * b + 3] = -c->w2c[4 * b] * centre[0] - c->w2c[4 * b + 1] * centre[1] -
                            c->w2c[4 * b + 2] * centre[2];
    c->cx = 0.5 * c->width;
    c->cy = 0.5 * c->height;
    return is_valid(c);
}

/* Adds every distinct camera once, since 4D methods list each camera once per frame. */
static spin_status read_run(const spin_json *list, struct spin_views *out)
{
    for (size_t i = 0; i < spin_json_length(list) && out->n < MOST_CAMERAS; i++) {
        struct spin_camera camera = {0};
        size_t same = 0;

        if (!read_run_entry(spin_json_at(list, i), &camera))
            return spin_malformed("entry %zu is not a valid camera", i);
        while (same < out->n && !is_same_camera(&out->view[same].camera, &camera))
            same++;
        if (same == out->n)
            SPIN_TRY(add_camera(out, &camera, (int)out->n, false));
    }
    return SPIN_OK;
}

/* Sets *out to the folder of the run's output, which contains point_cloud/iteration_N/. */
static spin_status find_run_folder(const char *run, char **out)
{
    SPIN_TRY(spin_path_absolute(run, out));
    while (!spin_path_is_folder(*out) || strcmp(spin_path_name(*out), "point_cloud") == 0 ||
           strncmp(spin_path_name(*out), "iteration_", 10) == 0) {
        char *slash = strrchr(*out, '/');

        if (!slash || slash == *out)
            return SPIN_OK;
        *slash = '\0';
    }
    return SPIN_OK;
}

spin_status spin_kept_cameras_find(const char *run, struct spin_views *out, char **path)
{
    SPIN_LEAVES(spin_json_freed) spin_json *list = NULL;
    SPIN_FREED char *folder = NULL, *file = NULL;
    spin_status status;

    *path = NULL;
    SPIN_TRY(find_run_folder(run, &folder));
    SPIN_TRY(spin_path_join(folder, "cameras.json", &file));
    if (!spin_path_exists(file))
        return SPIN_OK;
    status = spin_json_load(file, &list);
    if (status == SPIN_OK)
        status = read_run(list, out);
    if (status != SPIN_OK || out->n == 0) {
        spin_views_free(out);
        return status == SPIN_E_MEMORY ? status : SPIN_OK;
    }
    *path = file;
    file = NULL;
    return SPIN_OK;
}
