/* The checks that all readers of data sets use. */
#include "importers/lib/views_check.h"

#include <ctype.h>
#include <unistd.h>

#include "base/base.h"
#include "io/file.h"
#include "io/numbered.h"

#define VIEWS_MAX_SIZE 65536 /* largest width or height of an image, in pixels */

/* For a rotation R, no element of R R^T may differ from the identity by more than this limit, which
 * accepts matrices that were printed with six digits. */
#define VIEWS_ROTATION_TOLERANCE 1e-3

spin_status spin_views_check_pose(const double m[12], const char *what)
{
    double worst = 0, determinant;

    for (int i = 0; i < 12; i++) {
        if (!isfinite(m[i]))
            return spin_malformed("%s has values that are not finite", what);
    }
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            double dot =
                m[4 * i] * m[4 * j] + m[4 * i + 1] * m[4 * j + 1] + m[4 * i + 2] * m[4 * j + 2];

            worst = fmax(worst, fabs(dot - (i == j)));
        }
    }
    if (!(worst <= VIEWS_ROTATION_TOLERANCE))
        return spin_malformed(
            "the rotation in %s is not orthonormal: it deviates by %.2g, the limit is %g", what,
            worst, VIEWS_ROTATION_TOLERANCE);
    determinant = m[0] * (m[5] * m[10] - m[6] * m[9]) - m[1] * (m[4] * m[10] - m[6] * m[8]) +
                  m[2] * (m[4] * m[9] - m[5] * m[8]);
    if (determinant < 0)
        return spin_malformed("the rotation in %s is a reflection, as its determinant is negative: "
                              "negate two axes or none (y and z to convert OpenGL to OpenCV)",
                              what);
    return SPIN_OK;
}

static spin_status fail_matrix(const char *key, size_t n)
{
    return spin_malformed("'%s' is not a %zu x %zu matrix", key, n, n);
}

spin_status spin_views_matrix(const spin_json *m, const char *key, size_t n, double *out)
{
    static const double last[4] = {0, 0, 0, 1};
    size_t n_rows = spin_json_length(m);

    if (n == 4)
        memcpy(out + 12, last, sizeof last);
    if (n_rows != n && !(n == 4 && n_rows == 3))
        return fail_matrix(key, n);
    for (size_t i = 0; i < n_rows; i++) {
        const spin_json *row = spin_json_at(m, i);

        if (spin_json_length(row) != n)
            return fail_matrix(key, n);
        for (size_t j = 0; j < n; j++) {
            if (!spin_json_number(spin_json_at(row, j), &out[i * n + j]))
                return spin_malformed("'%s'[%zu][%zu] is not a number", key, i, j);
        }
    }
    for (int j = 0; j < 4 && n == 4; j++) {
        if (!(fabs(out[12 + j] - last[j]) <= 1e-6))
            return spin_malformed("the last row of '%s' is %g %g %g %g, expected 0 0 0 1", key,
                                  out[12], out[13], out[14], out[15]);
    }
    return SPIN_OK;
}

spin_status spin_views_read_json(const char *folder, const char *name,
                                 spin_status (*read)(void *context, const spin_json *root,
                                                     struct spin_views *out),
                                 void *context, struct spin_views *out, bool *found)
{
    SPIN_FREED char *path = NULL;
    SPIN_LEAVES(spin_json_freed) spin_json *root = NULL;
    spin_status status;

    SPIN_TRY(spin_path_join(folder, name, &path));
    if (found)
        *found = spin_path_exists(path);
    if (found && !*found)
        return SPIN_OK;
    SPIN_TRY(spin_json_load(path, &root));
    status = spin_json_is_object(root) ? read(context, root, out)
                                       : spin_malformed("the file is not a JSON object");
    return spin_fail_context(status, "cannot read '%s'", path);
}

void spin_views_invert(const double c2w[12], double w2c[12])
{
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++)
            w2c[4 * i + j] = c2w[4 * j + i];
        w2c[4 * i + 3] = -(c2w[i] * c2w[3] + c2w[4 + i] * c2w[7] + c2w[8 + i] * c2w[11]);
    }
}

spin_status spin_views_check_size(double width, double height)
{
    if (!(width >= 1 && width <= VIEWS_MAX_SIZE && width == floor(width)) ||
        !(height >= 1 && height <= VIEWS_MAX_SIZE && height == floor(height)))
        return spin_malformed("the image size is %g x %g, expected 1 to %d pixels", width, height,
                              VIEWS_MAX_SIZE);
    return SPIN_OK;
}

spin_status spin_views_size(double width, double height, struct spin_camera *out)
{
    SPIN_TRY(spin_views_check_size(width, height));
    out->width = (int)width;
    out->height = (int)height;
    return SPIN_OK;
}

spin_status spin_views_check_intrinsics(const struct spin_camera *c)
{
    if (!(c->fx > 0 && c->fy > 0 && isfinite(c->fx) && isfinite(c->fy)))
        return spin_malformed("the focal lengths are %g, %g, expected both above 0", c->fx, c->fy);
    if (!(c->cx >= 0 && c->cx <= c->width && c->cy >= 0 && c->cy <= c->height))
        return spin_malformed("the principal point is %g, %g, outside the image of %d x %d", c->cx,
                              c->cy, c->width, c->height);
    return SPIN_OK;
}

spin_status spin_views_intrinsics(const double k[9], const char *key, struct spin_camera *out)
{
    if (!(fabs(k[6]) <= 1e-6 && fabs(k[7]) <= 1e-6 && fabs(k[8] - 1) <= 1e-6 && fabs(k[3]) <= 1e-6))
        return spin_malformed("'%s' is not of the form [fx 0 cx; 0 fy cy; 0 0 1]", key);
    if (fabs(k[1]) > 1e-6 * fabs(k[0]))
        return spin_unsupported("'%s' has a skew of %g, expected 0", key, k[1]);
    out->fx = k[0];
    out->fy = k[4];
    out->cx = k[2];
    out->cy = k[5];
    return spin_views_check_intrinsics(out);
}

/* Scales the camera to an image of another resolution. The image must have the camera's aspect
 * ratio, to within one per cent or, if that is more, to within the rounding of width and height to
 * whole pixels. Focal lengths and principal point are multiplied by the ratio of the sizes, without
 * a half-pixel shift, as in the readers of the methods. */
static spin_status views_fit(struct spin_camera *c, const char *path, int width, int height)
{
    double sx = (double)width / c->width, sy = (double)height / c->height;
    double expected = (double)c->height * width / height;

    if (fabs(c->width - expected) > fmax(0.01 * c->width, 0.5 + 0.5 * c->width / c->height))
        return spin_malformed(
            "image '%s' has %d x %d pixels, another aspect ratio than the camera's %d x %d", path,
            width, height, c->width, c->height);
    c->width = width;
    c->height = height;
    c->fx *= sx;
    c->cx *= sx;
    c->fy *= sy;
    c->cy *= sy;
    return SPIN_OK;
}

spin_status spin_views_fit_image(struct spin_camera *c, const char *path)
{
    int width, height, channels;

    SPIN_TRY(spin_image_size(path, &width, &height, &channels));
    return views_fit(c, path, width, height);
}

spin_status spin_views_time(const struct spin_plugin_values *values, const char *fallback,
                            size_t row, size_t n_rows, double *out)
{
    const char *rule = spin_plugin_value(values, "time", fallback);
    double whole;

    if (strcmp(rule, "unit") == 0)
        whole = n_rows > 1 ? (double)(n_rows - 1) : 1;
    else if (strcmp(rule, "count") == 0)
        whole = (double)n_rows;
    else if (strcmp(rule, "row") == 0)
        whole = 1;
    else if (!spin_views_is_number(rule, &whole) || !(whole > 0))
        return spin_misuse("option 'time' is '%s', expected unit, count, row or a number above 0",
                           rule);
    *out = (double)row / whole;
    return SPIN_OK;
}

bool spin_views_is_safe_name(const char *name)
{
    if (name[0] == '\0' || name[0] == '/')
        return false;
    for (const char *part = name; part; part = strchr(part, '/')) {
        part += *part == '/';
        if (strncmp(part, "..", 2) == 0 && (part[2] == '/' || part[2] == '\0'))
            return false;
    }
    return true;
}

/* Returns the number of views from index `first` on whose image cannot be read, and sets *missing
 * to the path of the first such image. */
static size_t count_missing(const struct spin_views *views, size_t first, const char **missing)
{
    size_t n = 0;

    for (size_t i = first; i < views->n; i++) {
        if (access(views->view[i].path, R_OK) == 0)
            continue;
        if (n++ == 0)
            *missing = views->view[i].path;
    }
    return n;
}

spin_status spin_views_check_most(const struct spin_views *views, size_t first)
{
    const char *missing = NULL;
    size_t n = count_missing(views, first, &missing);

    if (n > (views->n - first - 1) / 2)
        return spin_not_found(
            "%s missing, the first is '%s'",
            spin_text_share(n, views->n - first, "image", "is", "are", (char[96]){0}), missing);
    return SPIN_OK;
}

/* Renumbers the frames of the data set so that every frame has at least one view. */
static spin_status close_rows(struct spin_views *views, size_t first)
{
    size_t n = views->n - first;
    SPIN_FREED int *row = NULL;

    SPIN_TRY(spin_alloc(n, sizeof *row, (void **)&row));
    for (size_t i = 0; i < n; i++)
        row[i] = views->view[first + i].dataset_frame;
    n = spin_views_unique(row, n);
    views->lacks_frames = n > 0 && (size_t)row[n - 1] >= n;
    for (size_t i = first; i < views->n; i++)
        views->view[i].dataset_frame = spin_views_index_of(row, n, views->view[i].dataset_frame);
    views->n_dataset_frames = (int)n;
    return SPIN_OK;
}

spin_status spin_views_drop_missing(struct spin_views *views, size_t first)
{
    const char *missing = NULL;
    size_t n = count_missing(views, first, &missing), kept = first, all = views->n - first;
    SPIN_FREED char *name = NULL;

    if (n == 0)
        return SPIN_OK;
    SPIN_TRY(spin_strdup(missing, &name));
    for (size_t i = first; i < views->n; i++) {
        if (access(views->view[i].path, R_OK) == 0) {
            views->view[kept++] = views->view[i];
            continue;
        }
        free(views->view[i].path);
        free(views->view[i].mask);
    }
    views->n = kept;
    SPIN_TRY(close_rows(views, first));
    spin_warn("%s missing and left out, the first is '%s'",
              spin_text_share(n, all, "image", "is", "are", (char[96]){0}), name);
    return SPIN_OK;
}

int spin_views_number(const char *path)
{
    const char *name = spin_path_name(path), *dot = strrchr(name, '.');
    const char *end = dot && dot > name ? dot : name + strlen(name), *at;

    while (end > name && !isdigit((unsigned char)end[-1]))
        end--;
    for (at = end; at > name && isdigit((unsigned char)at[-1]);)
        at--;
    return at < end && end - at < 10 ? atoi(at) : -1;
}

spin_status spin_views_set_numbers(struct spin_views *views, size_t first)
{
    SPIN_LEAVES(spin_numbers_free) struct spin_numbers numbers = {0};
    size_t n = views->n - first;
    SPIN_FREED const char **name = NULL;
    SPIN_FREED int *camera = NULL;
    spin_status status;

    SPIN_TRY(spin_alloc(n, sizeof *name, (void **)&name));
    SPIN_TRY(spin_alloc(n, sizeof *camera, (void **)&camera));
    for (size_t i = 0; i < n; i++) {
        name[i] = spin_path_name(views->view[first + i].path);
        camera[i] = views->view[first + i].camera_id;
    }
    status = spin_numbered_read(&(struct spin_numbering){.name = name, .n = n, .group = camera},
                                &numbers);
    for (size_t i = 0; i < n; i++)
        views->view[first + i].number = status == SPIN_OK ? numbers.number[i] : -1;
    return status == SPIN_E_MEMORY ? status : SPIN_OK;
}

int spin_frame_number(const char *name)
{
    size_t n = strncmp(name, "frame", 5) == 0 ? strspn(name + 5, "0123456789") : 0;

    return n > 0 && n < 10 && !name[5 + n] ? atoi(name + 5) : -1;
}

bool spin_views_is_number(const char *text, double *out)
{
    char *end;

    *out = strtod(text, &end);
    return end != text && *end == '\0' && isfinite(*out);
}

size_t spin_views_unique(int *list, size_t n)
{
    size_t kept = 0;

    if (n > 0)
        qsort(list, n, sizeof *list, spin_by_int);
    for (size_t i = 0; i < n; i++) {
        if (kept == 0 || list[kept - 1] != list[i])
            list[kept++] = list[i];
    }
    return kept;
}

int spin_views_index_of(const int *list, size_t n, int value)
{
    const int *found = n ? bsearch(&value, list, n, sizeof *list, spin_by_int) : NULL;

    return found ? (int)(found - list) : -1;
}
