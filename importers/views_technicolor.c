/* Data sets of Technicolor's light-field rig, as SpacetimeGaussians and others read them.
 *
 *     cameras_parameters.txt                  a heading, then one line per camera
 *     Painter_undist_00100_07.png ...         frame 100 of camera 7
 *
 * A line is: focal length, principal point x and y, aspect ratio, skew, quaternion w x y z,
 * translation x y z; in the data set of the original images, two coefficients of lens distortion
 * precede the quaternion. The pose is w2c in OpenCV's axes. Frame i of n is at time i/n, and camera
 * 10 is held out, as in SpacetimeGaussians. */
#include <ctype.h>
#include <strings.h>

#include "importers/lib/views_rig.h"
#include "io/text_file.h"
#include "math/covariance.h"

#define PARAMETERS "cameras_parameters.txt"

enum { MAX_CAMERAS = 1024, TEST_CAMERA = 10 };

static int probe(const struct spin_peek *peek) { return spin_peek_has(peek, PARAMETERS) ? 80 : 0; }

/* Converts the values of a line to a camera, except for its width and height. A line has 12 values,
 * or 14 if it includes two distortion coefficients, which must be 0. */
static spin_status fill_camera(const double *p, size_t n, struct spin_camera *c)
{
    double norm = 0, q[4], r[9];

    if (n != 12 && n != 14)
        return spin_malformed("the line has %zu values, expected 12 or 14", n);
    if (n == 14 && (p[5] != 0 || p[6] != 0))
        return spin_unsupported("there is a distortion of %g, %g: use the undistorted images", p[5],
                                p[6]);
    if (fabs(p[4]) > 1e-6 * fabs(p[0]))
        return spin_unsupported("there is a skew of %g, expected 0", p[4]);
    c->fx = p[0];
    c->fy = p[0] * p[3];
    c->cx = p[1];
    c->cy = p[2];
    for (int i = 0; i < 4; i++) {
        q[i] = p[n - 7 + (size_t)i];
        norm += q[i] * q[i];
    }
    if (!(norm > 1e-12) || !isfinite(norm))
        return spin_malformed("the quaternion is not a rotation");
    spin_matrix_of_quat(q, r);
    for (int i = 0; i < 3; i++) {
        memcpy(c->w2c + 4 * i, r + 3 * i, 3 * sizeof *r);
        c->w2c[4 * i + 3] = p[n - 3 + (size_t)i];
    }
    return spin_views_check_pose(c->w2c, "the pose");
}

static spin_status read_line(char *line, struct spin_camera *c)
{
    double p[16];
    size_t n = 0;

    for (char *word; (word = strsep(&line, " \t\r"));) {
        if (!*word)
            continue;
        if (n == sizeof p / sizeof *p || !spin_views_is_number(word, &p[n++]))
            return spin_malformed("'%.40s' is not a number, or the line has more than 16 values",
                                  word);
    }
    return fill_camera(p, n, c);
}

static spin_status read_cameras(struct spin_model *m, struct spin_rig_camera **out, size_t *n)
{
    const char *path, *text;
    SPIN_LEAVES(spin_text_file_close) struct spin_text_file file = {0};
    char *rest;
    int at = 0;

    SPIN_TRY(spin_model_join(m, &path, m->path, PARAMETERS));
    SPIN_TRY(spin_text_file_open(path, &file));
    SPIN_TRY(spin_model_text(m, &text, "%s", file.text));
    SPIN_TRY(spin_model_alloc(m, MAX_CAMERAS, sizeof **out, (void **)out));
    rest = (char *)(uintptr_t)text;
    for (char *line; (line = strsep(&rest, "\n")); at++) {
        if (at == 0 || line[strspn(line, " \t\r")] == '\0')
            continue;
        if (*n == MAX_CAMERAS)
            return spin_unsupported("'%s' has more than %d cameras", path, MAX_CAMERAS);
        SPIN_TRY_IN(read_line(line, &(*out)[*n].camera), "cannot read '%s': line %d", path, at + 1);
        (*n)++;
    }
    return *n > 0 ? SPIN_OK : spin_malformed("'%s' has no cameras", path);
}

/* Reads the last two numbers of an image's name: those of the frame and of the camera. */
static bool split_name(const char *name, int *frame, size_t *camera)
{
    size_t n = strlen(name), digits[2], end;
    const char *dot = strrchr(name, '.');

    if (!dot || strcasecmp(dot, ".txt") == 0)
        return false;
    n = (size_t)(dot - name);
    for (int i = 0; i < 2; i++) {
        end = n;
        while (n > 0 && isdigit((unsigned char)name[n - 1]))
            n--;
        digits[i] = n;
        if (n == end || end - n > 9 || n == 0 || name[n - 1] != '_')
            return false;
        n--;
    }
    *camera = (size_t)strtol(name + digits[0], NULL, 10);
    *frame = (int)strtol(name + digits[1], NULL, 10);
    return true;
}

static spin_status list_images(struct spin_model *m, struct spin_rig_camera *c, size_t n)
{
    char **names;
    size_t n_names, camera;
    const char *path;
    int frame;

    SPIN_TRY(spin_model_names(m, m->path, &names, &n_names));
    for (size_t i = 0; i < n; i++) {
        SPIN_TRY(spin_model_text(m, &c[i].name, "%02zu", i));
        c[i].where = m->path;
        SPIN_TRY(spin_file_sequence_reserve(m, &c[i].frames, n_names));
    }
    for (size_t i = 0; i < n_names; i++) {
        if (!split_name(names[i], &frame, &camera))
            continue;
        if (camera >= n)
            return spin_malformed("'%s' is of camera %zu, but " PARAMETERS
                                  " has only cameras 0 to %zu",
                                  names[i], camera, n - 1);
        SPIN_TRY(spin_model_join(m, &path, m->path, "%s", names[i]));
        spin_file_sequence_add(&c[camera].frames, path, names[i]);
        c[camera].frames.frame[c[camera].frames.n_frames - 1].number = frame;
    }
    return SPIN_OK;
}

static int by_number(const void *a, const void *b)
{
    const struct spin_file_frame *x = a, *y = b;

    return (x->number > y->number) - (x->number < y->number);
}

/* Sorts the images of all cameras, and sets the cameras to the size of their images. */
static spin_status prepare_cameras(struct spin_rig_camera *c, size_t n)
{
    int channels;

    for (size_t i = 0; i < n; i++) {
        if (c[i].frames.n_frames == 0)
            return spin_not_found("there are no images <scene>_<frame>_%02zu.png of camera %zu", i,
                                  i);
        qsort(c[i].frames.frame, c[i].frames.n_frames, sizeof *c[i].frames.frame, by_number);
        SPIN_TRY(spin_image_size(c[i].frames.frame[0].path, &c[i].camera.width, &c[i].camera.height,
                                 &channels));
        SPIN_TRY_IN(spin_views_check_intrinsics(&c[i].camera), "camera %zu", i);
    }
    return SPIN_OK;
}

static spin_status read_set(struct spin_model *m, struct spin_views *out)
{
    struct spin_rig_camera *c = NULL;
    size_t n = 0, first = out->n;
    int test;

    SPIN_TRY(read_cameras(m, &c, &n));
    SPIN_TRY(list_images(m, c, n));
    SPIN_TRY(prepare_cameras(c, n));
    SPIN_TRY(spin_rig_views(m, c, n, out));
    test = n > TEST_CAMERA ? TEST_CAMERA : 0;
    for (size_t i = first; i < out->n; i++) {
        struct spin_view *view = &out->view[i];

        if (!spin_model_option(m, "hold"))
            view->test = n > 1 && view->camera_id == test;
        SPIN_TRY(spin_views_time(m->values, "count", (size_t)view->dataset_frame,
                                 (size_t)out->view[out->n - 1].dataset_frame + 1, &view->time));
    }
    return SPIN_OK;
}

static const struct spin_plugin_option options[] = {
    {"time", "RULE",
     "time of frame i of n: count for i/n, unit for i/(n-1), row for i, a number N for i/N",
     "count"},
    SPIN_OFFSETS_OPTION,
    {"hold", "N",
     "hold out every N-th camera, including the first; 0: none (default: camera 10 or, with fewer "
     "cameras, camera 0)",
     NULL},
    {NULL, NULL, NULL, NULL}};

SPIN_VIEWS_IMPORTER(views_technicolor, "technicolor", struct spin_model, read_set,
                    .summary = "views: Technicolor's rig: cameras_parameters.txt and undistorted "
                               "images",
                    .upstream = "oppo-us-research/SpacetimeGaussians script/pre_technicolor.py",
                    .options = options, .probe = probe)
