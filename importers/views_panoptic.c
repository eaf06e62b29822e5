/* CMU Panoptic Sports as prepared for Dynamic 3D Gaussians: cameras and images.
 *
 *     train_meta.json  test_meta.json      w, h, k [T][C][3][3], w2c [T][C][4][4], fn [T][C],
 *                                          cam_id [T][C] (may be missing)
 *     ims/<fn>                             the images
 *     seg/<fn, as .png>                    foreground masks, values 0 and 1 (may be missing)
 *
 * Cameras are OpenCV's already. Row t of the lists is frame t of the data set, whatever number the
 * file names carry. Without test_meta.json every camera trains. */
#include "spin.h"

#include <ctype.h>
#include <limits.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "base/err.h"
#include "base/mem.h"
#include "io/file.h"
#include "io/json.h"

#define MAX_SIZE 65536 /* pixels along a side */
/* How far a rotation may be from orthonormal: files with six digits pass. */
#define ROTATION_TOLERANCE 1e-3

/* One of the two files. */
struct split {
    const char *folder, *name;
    const spin_json *k, *w2c, *fn, *cam_id; /* cam_id may be NULL */
    int width, height;
    size_t n_rows, n_cameras;
    bool test;
};

/* ---- Recognising ----------------------------------------------------------------------------- */

static int probe(const struct spin_peek *peek)
{
    for (size_t i = 0; peek->is_folder && peek->names && peek->names[i]; i++) {
        if (strcmp(peek->names[i], "train_meta.json") == 0)
            return 70;
    }
    return 0;
}

/* ---- The lists ------------------------------------------------------------------------------- */

static spin_status read_size(const spin_json *root, const char *key, int *out)
{
    double value;

    if (!spin_json_number(spin_json_get(root, key), &value))
        return spin_fail(SPIN_E_MALFORMED, "no number '%s'", key);
    if (value != floor(value) || value < 1 || value > MAX_SIZE)
        return spin_fail(SPIN_E_MALFORMED, "'%s' is %g, expected 1 to %d pixels", key, value,
                         MAX_SIZE);
    *out = (int)value;
    return SPIN_OK;
}

/* A list of T rows of C things; the first list seen sets T and C. */
static spin_status read_list(struct split *s, const spin_json *root, const char *key,
                             const spin_json **out)
{
    const spin_json *list = spin_json_get(root, key);
    size_t n_rows = spin_json_length(list);

    if (!list || !spin_json_is_array(list))
        return spin_fail(SPIN_E_MALFORMED, "no list '%s'", key);
    if (n_rows == 0)
        return spin_fail(SPIN_E_MALFORMED, "list '%s' has no frames", key);
    if (s->n_rows == 0) {
        s->n_rows = n_rows;
        s->n_cameras = spin_json_length(spin_json_at(list, 0));
        if (s->n_cameras == 0)
            return spin_fail(SPIN_E_MALFORMED, "list '%s' has no cameras in frame 0", key);
    }
    if (n_rows != s->n_rows || n_rows > INT_MAX)
        return spin_fail(SPIN_E_MALFORMED, "list '%s' has %zu frames, expected %zu as 'k' has", key,
                         n_rows, s->n_rows);
    for (size_t t = 0; t < n_rows; t++) {
        size_t n = spin_json_length(spin_json_at(list, t));

        if (n != s->n_cameras)
            return spin_fail(SPIN_E_MALFORMED,
                             "list '%s' has %zu cameras in frame %zu, expected %zu", key, n, t,
                             s->n_cameras);
    }
    *out = list;
    return SPIN_OK;
}

static const spin_json *at(const spin_json *list, size_t row, size_t camera)
{
    return spin_json_at(spin_json_at(list, row), camera);
}

static spin_status read_matrix(const spin_json *m, const char *key, size_t n, double *out)
{
    if (spin_json_length(m) != n)
        return spin_fail(SPIN_E_MALFORMED, "'%s' is not a %zu x %zu matrix", key, n, n);
    for (size_t i = 0; i < n; i++) {
        if (spin_json_length(spin_json_at(m, i)) != n)
            return spin_fail(SPIN_E_MALFORMED, "'%s' is not a %zu x %zu matrix", key, n, n);
        for (size_t j = 0; j < n; j++) {
            if (!spin_json_number(at(m, i, j), &out[i * n + j]) || !isfinite(out[i * n + j]))
                return spin_fail(SPIN_E_MALFORMED, "'%s'[%zu][%zu] is not a number", key, i, j);
        }
    }
    return SPIN_OK;
}

/* ---- One camera ------------------------------------------------------------------------------ */

static spin_status read_intrinsics(const spin_json *json, struct spin_camera *camera)
{
    double k[9];

    SPIN_TRY(read_matrix(json, "k", 3, k));
    if (!(k[0] > 0) || !(k[4] > 0))
        return spin_fail(SPIN_E_MALFORMED, "'k' has focal lengths %g, %g, expected both above 0",
                         k[0], k[4]);
    if (fabs(k[6]) > 1e-6 || fabs(k[7]) > 1e-6 || fabs(k[8] - 1) > 1e-6 || fabs(k[3]) > 1e-6)
        return spin_fail(SPIN_E_MALFORMED, "'k' is not [fx 0 cx; 0 fy cy; 0 0 1]");
    if (fabs(k[1]) > 1e-6 * k[0])
        return spin_fail(SPIN_E_UNSUPPORTED, "'k' has a skew of %g, expected 0", k[1]);
    if (!(k[2] >= 0 && k[2] <= camera->width && k[5] >= 0 && k[5] <= camera->height))
        return spin_fail(
            SPIN_E_MALFORMED,
            "'k' has its principal point at %g, %g, outside the image of %d x %d; is it "
            "of another resolution",
            k[2], k[5], camera->width, camera->height);
    camera->fx = k[0];
    camera->fy = k[4];
    camera->cx = k[2];
    camera->cy = k[5];
    return SPIN_OK;
}

static spin_status read_pose(const spin_json *json, struct spin_camera *camera)
{
    double m[16], worst = 0, determinant;

    SPIN_TRY(read_matrix(json, "w2c", 4, m));
    if (fabs(m[12]) > 1e-6 || fabs(m[13]) > 1e-6 || fabs(m[14]) > 1e-6 || fabs(m[15] - 1) > 1e-6)
        return spin_fail(SPIN_E_MALFORMED, "the last row of 'w2c' is %g %g %g %g, expected 0 0 0 1",
                         m[12], m[13], m[14], m[15]);
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            double dot =
                m[4 * i] * m[4 * j] + m[4 * i + 1] * m[4 * j + 1] + m[4 * i + 2] * m[4 * j + 2];

            worst = fmax(worst, fabs(dot - (i == j)));
        }
    }
    if (!(worst <= ROTATION_TOLERANCE))
        return spin_fail(SPIN_E_MALFORMED,
                         "the rotation in 'w2c' is not orthonormal: off by %.2g, allowed %g", worst,
                         ROTATION_TOLERANCE);
    determinant = m[0] * (m[5] * m[10] - m[6] * m[9]) - m[1] * (m[4] * m[10] - m[6] * m[8]) +
                  m[2] * (m[4] * m[9] - m[5] * m[8]);
    if (determinant < 0)
        return spin_fail(SPIN_E_MALFORMED,
                         "the rotation in 'w2c' is a mirror: its determinant is -1");
    memcpy(camera->w2c, m, sizeof camera->w2c);
    return SPIN_OK;
}

/* Names stay below ims/. */
static bool is_safe_name(const char *name)
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

/* cam_id, else the number that the camera's folder is called by, else its place in the list. */
static spin_status read_camera_id(const struct split *s, size_t row, size_t camera, const char *fn,
                                  int *out)
{
    size_t n_digits = 0;
    double value;

    if (s->cam_id) {
        if (!spin_json_number(at(s->cam_id, row, camera), &value) || value != floor(value) ||
            fabs(value) > INT_MAX)
            return spin_fail(SPIN_E_MALFORMED, "'cam_id' is not a whole number");
        *out = (int)value;
        return SPIN_OK;
    }
    while (isdigit((unsigned char)fn[n_digits]))
        n_digits++;
    *out = n_digits > 0 && n_digits < 9 && fn[n_digits] == '/' ? atoi(fn) : (int)camera;
    return SPIN_OK;
}

/* seg/<fn> with the ending .png, when there is such a file; NULL otherwise. */
static spin_status find_mask(const struct split *s, const char *fn, char **out)
{
    size_t stem = strlen(fn), n;
    const char *dot = strrchr(spin_path_name(fn), '.');
    char *name;

    *out = NULL;
    if (dot)
        stem = (size_t)(dot - fn);
    n = strlen("seg/") + stem + sizeof ".png";
    SPIN_TRY(spin_alloc(n, 1, (void **)&name));
    snprintf(name, n, "seg/%.*s.png", (int)stem, fn);
    spin_status status = spin_path_join(s->folder, name, out);
    free(name);
    if (status == SPIN_OK && !spin_path_exists(*out)) {
        free(*out);
        *out = NULL;
    }
    return status;
}

static spin_status read_view(const struct split *s, size_t row, size_t camera,
                             struct spin_views *out)
{
    struct spin_view view = {.dataset_frame = (int)row, .time = (double)row, .test = s->test};
    const char *fn = spin_json_string(at(s->fn, row, camera));
    char *ims = NULL;
    long long number;
    spin_status status;

    view.camera.width = s->width;
    view.camera.height = s->height;
    if (!fn || !is_safe_name(fn))
        return spin_fail(SPIN_E_MALFORMED, "'fn' is '%s', expected a path below 'ims'",
                         fn ? fn : "");
    number = spin_path_number(fn);
    view.number = number <= INT_MAX ? (int)number : -1;
    SPIN_TRY(read_intrinsics(at(s->k, row, camera), &view.camera));
    SPIN_TRY(read_pose(at(s->w2c, row, camera), &view.camera));
    SPIN_TRY(read_camera_id(s, row, camera, fn, &view.camera_id));
    SPIN_TRY(spin_path_join(s->folder, "ims", &ims));
    SPIN_TRY_OUT(spin_path_join(ims, fn, &view.path));
    SPIN_TRY_OUT(find_mask(s, fn, &view.mask));
    SPIN_TRY_OUT(spin_views_add(out, &view));
out:
    free(view.path);
    free(view.mask);
    free(ims);
    return status;
}

/* ---- The two files --------------------------------------------------------------------------- */

static spin_status read_views(struct split *s, const spin_json *root, struct spin_views *out)
{
    SPIN_TRY(read_size(root, "w", &s->width));
    SPIN_TRY(read_size(root, "h", &s->height));
    SPIN_TRY(read_list(s, root, "k", &s->k));
    SPIN_TRY(read_list(s, root, "w2c", &s->w2c));
    SPIN_TRY(read_list(s, root, "fn", &s->fn));
    if (spin_json_get(root, "cam_id"))
        SPIN_TRY(read_list(s, root, "cam_id", &s->cam_id));
    for (size_t t = 0; t < s->n_rows; t++) {
        for (size_t c = 0; c < s->n_cameras; c++) {
            spin_status status = read_view(s, t, c, out);

            if (status != SPIN_OK)
                return spin_fail_context(status, "frame %zu, camera %zu", t, c);
        }
    }
    return SPIN_OK;
}

static spin_status read_split(struct split *s, struct spin_views *out)
{
    char *path = NULL;
    spin_json *root = NULL;
    spin_status status;

    SPIN_TRY(spin_path_join(s->folder, s->name, &path));
    SPIN_TRY_OUT(spin_json_load(path, &root));
    if (!spin_json_is_object(root))
        status = spin_fail(SPIN_E_MALFORMED, "not a JSON object");
    else
        status = read_views(s, root, out);
    if (status != SPIN_OK)
        status = spin_fail_context(status, "cannot read '%s'", path);
out:
    spin_json_free(root);
    free(path);
    return status;
}

static spin_status check_images(const struct spin_views *views, size_t first)
{
    const char *missing = NULL;
    size_t n = 0;

    for (size_t i = first; i < views->n; i++) {
        if (access(views->view[i].path, R_OK) == 0)
            continue;
        if (n++ == 0)
            missing = views->view[i].path;
    }
    if (n > 0)
        return spin_fail(SPIN_E_NOT_FOUND, "%zu of %zu images are missing, the first is '%s'", n,
                         views->n - first, missing);
    return SPIN_OK;
}

static spin_status panoptic_views(const char *path, const struct spin_plugin_values *values,
                                  struct spin_views *out)
{
    struct split train = {.folder = path, .name = "train_meta.json"};
    struct split test = {.folder = path, .name = "test_meta.json", .test = true};
    size_t first = out->n;
    char *test_path = NULL;
    bool has_test;

    (void)values;
    SPIN_TRY(read_split(&train, out));
    SPIN_TRY(spin_path_join(path, test.name, &test_path));
    has_test = spin_path_exists(test_path);
    free(test_path);
    if (has_test) {
        SPIN_TRY(read_split(&test, out));
        if (test.n_rows != train.n_rows)
            return spin_fail(SPIN_E_MALFORMED,
                             "'%s': train_meta.json has %zu frames and test_meta.json %zu", path,
                             train.n_rows, test.n_rows);
    }
    return check_images(out, first);
}

const struct spin_importer spin_importer_views_panoptic = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "panoptic",
    .summary = "views: CMU Panoptic Sports as Dynamic 3D Gaussians reads it (train_meta.json)",
    .upstream = "JonathonLuiten/Dynamic3DGaussians 7dbbd4d",
    .probe = probe,
    .views = panoptic_views,
};
