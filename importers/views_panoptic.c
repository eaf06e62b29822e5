/* Data sets of CMU Panoptic Sports as prepared for Dynamic 3D Gaussians: cameras and images.
 *
 *     train_meta.json  test_meta.json      w, h, k [T][C][3][3], w2c [T][C][4][4], fn [T][C],
 *                                          cam_id [T][C] (may be missing)
 *     ims/<fn>                             the images
 *     seg/<fn, as .png>                    foreground masks, values 0 and 1 (may be missing)
 *
 * Cameras have OpenCV's axes. Row t of the lists is frame t of the data set, regardless of the
 * numbers in file names. Without test_meta.json no camera is held out. */
#include <ctype.h>

#include "importers/lib/model.h"
#include "importers/lib/views_check.h"

/* The contents of train_meta.json or of test_meta.json. */
struct split {
    struct spin_model *m;                   /* m->path: the folder of the data set */
    const spin_json *k, *w2c, *fn, *cam_id; /* cam_id may be NULL */
    int width, height;
    size_t n_rows, n_cameras;
    bool test; /* the file is test_meta.json, whose views are held out */
};

static int probe(const struct spin_peek *peek)
{
    return spin_peek_has(peek, "train_meta.json") ? 70 : 0;
}

/* ---- The lists ------------------------------------------------------------------------------- */

static spin_status read_side(const spin_json *root, const char *key, double *out)
{
    if (!spin_json_number(spin_json_get(root, key), out))
        return spin_malformed("there is no number '%s'", key);
    return SPIN_OK;
}

static spin_status read_size(const spin_json *root, struct split *s)
{
    double width, height;

    SPIN_TRY(read_side(root, "w", &width));
    SPIN_TRY(read_side(root, "h", &height));
    SPIN_TRY(spin_views_check_size(width, height));
    s->width = (int)width;
    s->height = (int)height;
    return SPIN_OK;
}

/* Reads a list of T rows of C items; the first list sets T and C. */
static spin_status read_list(struct split *s, const spin_json *root, const char *key,
                             const spin_json **out)
{
    const spin_json *list = spin_json_get(root, key);
    size_t n_rows = spin_json_length(list);

    if (!list || !spin_json_is_array(list))
        return spin_malformed("there is no list '%s'", key);
    if (n_rows == 0)
        return spin_malformed("list '%s' has no frames", key);
    if (s->n_rows == 0) {
        s->n_rows = n_rows;
        s->n_cameras = spin_json_length(spin_json_at(list, 0));
        if (s->n_cameras == 0)
            return spin_malformed("list '%s' has no cameras in frame 0", key);
    }
    if (n_rows != s->n_rows || n_rows > INT_MAX)
        return spin_malformed("list '%s' has %zu frames, expected %zu as in 'k'", key, n_rows,
                              s->n_rows);
    for (size_t t = 0; t < n_rows; t++) {
        size_t n = spin_json_length(spin_json_at(list, t));

        if (n != s->n_cameras)
            return spin_malformed("list '%s' has %zu cameras in frame %zu, expected %zu", key, n, t,
                                  s->n_cameras);
    }
    *out = list;
    return SPIN_OK;
}

static const spin_json *at(const spin_json *list, size_t row, size_t camera)
{
    return spin_json_at(spin_json_at(list, row), camera);
}

/* ---- One camera ------------------------------------------------------------------------------ */

static spin_status read_intrinsics(const spin_json *json, struct spin_camera *camera)
{
    double k[9];

    SPIN_TRY(spin_views_matrix(json, "k", 3, k));
    return spin_views_intrinsics(k, "k", camera);
}

static spin_status read_pose(const spin_json *json, struct spin_camera *camera)
{
    double m[16];

    SPIN_TRY(spin_views_matrix(json, "w2c", 4, m));
    memcpy(camera->w2c, m, sizeof camera->w2c);
    return spin_views_check_pose(m, "'w2c'");
}

/* Sets *out to the camera's id, which is the first of these that exists: its value in the list
 * cam_id; the name of its folder in `fn`, if this name is a number; its index in the lists. */
static spin_status read_camera_id(const struct split *s, size_t row, size_t camera, const char *fn,
                                  int *out)
{
    size_t n_digits = 0;
    double value;

    if (s->cam_id) {
        if (!spin_json_number(at(s->cam_id, row, camera), &value) || value != floor(value) ||
            fabs(value) > INT_MAX)
            return spin_malformed("'cam_id' is not a whole number");
        *out = (int)value;
        return SPIN_OK;
    }
    while (isdigit((unsigned char)fn[n_digits]))
        n_digits++;
    *out = n_digits > 0 && n_digits < 9 && fn[n_digits] == '/' ? atoi(fn) : (int)camera;
    return SPIN_OK;
}

static spin_status read_view(const struct split *s, size_t row, size_t camera,
                             struct spin_views *out)
{
    struct spin_view view = {.dataset_frame = (int)row, .time = (double)row, .test = s->test};
    const char *fn = spin_json_string(at(s->fn, row, camera)), *dot, *path, *mask, *folder;

    view.camera.width = s->width;
    view.camera.height = s->height;
    SPIN_TRY(spin_model_join(s->m, &folder, s->m->path, "ims"));
    if (fn)
        SPIN_TRY(spin_model_name(s->m, folder, fn, &fn));
    if (!fn || !spin_views_is_safe_name(fn))
        return spin_malformed("'fn' is '%s', expected a path below 'ims'", fn ? fn : "");
    SPIN_TRY(read_intrinsics(at(s->k, row, camera), &view.camera));
    SPIN_TRY(read_pose(at(s->w2c, row, camera), &view.camera));
    SPIN_TRY(read_camera_id(s, row, camera, fn, &view.camera_id));
    SPIN_TRY(spin_model_join(s->m, &path, s->m->path, "ims/%s", fn));
    dot = strrchr(spin_path_name(fn), '.');
    SPIN_TRY(spin_model_find(s->m, &mask, s->m->path, "seg/%.*s.png",
                             (int)(dot ? dot - fn : (long)strlen(fn)), fn));
    view.path = (char *)path;
    view.mask = (char *)mask;
    return spin_views_add(out, &view);
}

/* ---- The two files --------------------------------------------------------------------------- */

static spin_status read_views(void *split, const spin_json *root, struct spin_views *out)
{
    struct split *s = split;

    SPIN_TRY(read_size(root, s));
    SPIN_TRY(read_list(s, root, "k", &s->k));
    SPIN_TRY(read_list(s, root, "w2c", &s->w2c));
    SPIN_TRY(read_list(s, root, "fn", &s->fn));
    if (spin_json_get(root, "cam_id"))
        SPIN_TRY(read_list(s, root, "cam_id", &s->cam_id));
    for (size_t t = 0; t < s->n_rows; t++) {
        for (size_t c = 0; c < s->n_cameras; c++) {
            SPIN_TRY_IN(read_view(s, t, c, out), "frame %zu, camera %zu", t, c);
        }
    }
    return SPIN_OK;
}

static spin_status read_set(struct spin_model *m, struct spin_views *out)
{
    struct split train = {.m = m};
    struct split test = {.m = m, .test = true};
    size_t first = out->n;
    bool found;

    SPIN_TRY(spin_views_read_json(m->path, "train_meta.json", read_views, &train, out, NULL));
    SPIN_TRY(spin_views_read_json(m->path, "test_meta.json", read_views, &test, out, &found));
    if (found && test.n_rows != train.n_rows)
        return spin_malformed(
            "'%s': train_meta.json has %zu frames and test_meta.json %zu, expected the same",
            m->path, train.n_rows, test.n_rows);
    SPIN_TRY(spin_views_set_numbers(out, first));
    SPIN_TRY(spin_views_check_most(out, first));
    return spin_views_drop_missing(out, first);
}

SPIN_VIEWS_IMPORTER(
    views_panoptic, "panoptic", struct spin_model, read_set,
    .summary = "views: CMU Panoptic Sports as Dynamic 3D Gaussians reads it (train_meta.json)",
    .upstream = "JonathonLuiten/Dynamic3DGaussians 7dbbd4d", .probe = probe)
