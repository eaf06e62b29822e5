/* The files of a COLMAP sparse model. */
#include "importers/lib/colmap_model.h"

#include <limits.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "base/log.h"
#include "base/mem.h"
#include "importers/lib/model.h"
#include "importers/lib/views_check.h"
#include "io/file.h"
#include "math/covariance.h"

enum { MAX_PARAMETERS = 16, MAX_NAME = 4096, MAX_POINTS = 1000 };

/* Where a model's parameters lie: places of fx, fy, cx, cy; those from `distortion` on must be 0.
 * A lens that is no pinhole whatever its parameters are has distortion -1. */
static const struct {
    const char *name;
    int n, fx, fy, cx, cy, distortion;
} models[] = {
    {"SIMPLE_PINHOLE", 3, 0, 0, 1, 2, 3},
    {"PINHOLE", 4, 0, 1, 2, 3, 4},
    {"SIMPLE_RADIAL", 4, 0, 0, 1, 2, 3},
    {"RADIAL", 5, 0, 0, 1, 2, 3},
    {"OPENCV", 8, 0, 1, 2, 3, 4},
    {"OPENCV_FISHEYE", 8, 0, 1, 2, 3, -1},
    {"FULL_OPENCV", 12, 0, 1, 2, 3, 4},
    {"FOV", 5, 0, 1, 2, 3, -1},
    {"SIMPLE_RADIAL_FISHEYE", 4, 0, 0, 1, 2, -1},
    {"RADIAL_FISHEYE", 5, 0, 0, 1, 2, -1},
    {"THIN_PRISM_FISHEYE", 12, 0, 1, 2, 3, -1},
    {"RAD_TAN_THIN_PRISM_FISHEYE", 16, 0, 1, 2, 3, -1},
};
enum { N_MODELS = sizeof models / sizeof *models };

/* ---- Bytes and words ------------------------------------------------------------------------- */

struct bytes {
    const unsigned char *at, *end;
};

static spin_status take(struct bytes *b, size_t n, const unsigned char **out)
{
    if ((size_t)(b->end - b->at) < n)
        return spin_fail(SPIN_E_MALFORMED, "the file is cut short");
    *out = b->at;
    b->at += n;
    return SPIN_OK;
}

static uint64_t little_endian(const unsigned char *p, int n)
{
    uint64_t value = 0;

    for (int i = n; i-- > 0;)
        value = value << 8 | p[i];
    return value;
}

static spin_status take_u64(struct bytes *b, uint64_t *out)
{
    const unsigned char *p = NULL;

    SPIN_TRY(take(b, 8, &p));
    *out = little_endian(p, 8);
    return SPIN_OK;
}

static spin_status take_i32(struct bytes *b, int *out)
{
    const unsigned char *p = NULL;

    SPIN_TRY(take(b, 4, &p));
    *out = (int)(int32_t)little_endian(p, 4);
    return SPIN_OK;
}

static spin_status take_f64(struct bytes *b, int n, double *out)
{
    const unsigned char *p = NULL;

    SPIN_TRY(take(b, 8 * (size_t)n, &p));
    for (int i = 0; i < n; i++) {
        uint64_t bits = little_endian(p + 8 * i, 8);

        memcpy(&out[i], &bits, sizeof bits);
    }
    return SPIN_OK;
}

/* A count of records of at least `smallest` bytes each that the rest of the file can hold. */
static spin_status take_count(struct bytes *b, size_t smallest, const char *what, uint64_t *out)
{
    SPIN_TRY(take_u64(b, out));
    if (*out > (uint64_t)(b->end - b->at) / smallest)
        return spin_fail(SPIN_E_MALFORMED,
                         "its header announces %llu %s, more than the remaining %zu bytes hold",
                         (unsigned long long)*out, what, (size_t)(b->end - b->at));
    return SPIN_OK;
}

/* The next line as a string, or false at the end; `line` is reused. */
static spin_status next_line(struct bytes *b, char **line, bool *found)
{
    const unsigned char *newline = memchr(b->at, '\n', (size_t)(b->end - b->at));
    size_t n = (size_t)((newline ? newline : b->end) - b->at);

    *found = b->at < b->end;
    if (!*found)
        return SPIN_OK;
    SPIN_TRY(spin_grow(n + 1, 1, (void **)line));
    memcpy(*line, b->at, n);
    (*line)[n] = '\0';
    if (n > 0 && (*line)[n - 1] == '\r')
        (*line)[n - 1] = '\0';
    b->at += n + (newline != NULL);
    return SPIN_OK;
}

/* The next word, cut out of the line; "" at its end. */
static char *next_word(char **at)
{
    char *word;

    while (**at == ' ' || **at == '\t')
        (*at)++;
    word = *at;
    while (**at && **at != ' ' && **at != '\t')
        (*at)++;
    if (**at)
        *(*at)++ = '\0';
    return word;
}

static spin_status next_number(char **at, const char *what, double *out)
{
    const char *word = next_word(at);

    if (!spin_views_is_number(word, out))
        return spin_fail(SPIN_E_MALFORMED, "%s is '%.40s', expected a number", what, word);
    return SPIN_OK;
}

static spin_status next_integer(char **at, const char *what, int *out)
{
    double value;

    SPIN_TRY(next_number(at, what, &value));
    if (value != floor(value) || fabs(value) > INT_MAX)
        return spin_fail(SPIN_E_MALFORMED, "%s is %g, expected a whole number", what, value);
    *out = (int)value;
    return SPIN_OK;
}

/* A line that is neither a comment nor blank. */
static bool is_record(const char *line)
{
    line += strspn(line, " \t");
    return *line != '#' && *line != '\0';
}

/* ---- Cameras --------------------------------------------------------------------------------- */

static spin_status fill_lens(struct colmap_model *m, int id, int kind, double width, double height,
                             const double *p)
{
    struct spin_camera *c = &m->lens[m->n_lenses].camera;

    for (size_t i = 0; i < m->n_lenses; i++) {
        if (m->lens[i].id == id)
            return spin_fail(SPIN_E_MALFORMED, "there are two cameras with id %d", id);
    }
    SPIN_TRY(spin_views_check_size(width, height));
    if (models[kind].distortion < 0)
        return spin_fail(SPIN_E_UNSUPPORTED,
                         "its model %s is not a pinhole camera: undistort the images",
                         models[kind].name);
    for (int i = models[kind].distortion; i < models[kind].n; i++) {
        if (p[i] != 0)
            return spin_fail(SPIN_E_UNSUPPORTED,
                             "its model %s has a distortion of %g: undistort the images",
                             models[kind].name, p[i]);
    }
    c->width = (int)width;
    c->height = (int)height;
    c->fx = p[models[kind].fx];
    c->fy = p[models[kind].fy];
    c->cx = m->centre ? c->width / 2.0 : p[models[kind].cx];
    c->cy = m->centre ? c->height / 2.0 : p[models[kind].cy];
    SPIN_TRY(spin_views_check_intrinsics(c));
    m->lens[m->n_lenses++].id = id;
    return SPIN_OK;
}

static spin_status reserve_lens(struct colmap_model *m)
{

    SPIN_TRY(spin_grow(m->n_lenses + 1, sizeof *m->lens, (void **)&m->lens));
    memset(&m->lens[m->n_lenses], 0, sizeof *m->lens);
    return SPIN_OK;
}

static spin_status read_lens_binary(struct colmap_model *m, struct bytes *b, int *id)
{
    double p[MAX_PARAMETERS];
    uint64_t width, height;
    int kind;

    SPIN_TRY(reserve_lens(m));
    SPIN_TRY(take_i32(b, id));
    SPIN_TRY(take_i32(b, &kind));
    SPIN_TRY(take_u64(b, &width));
    SPIN_TRY(take_u64(b, &height));
    if (kind < 0 || kind >= N_MODELS)
        return spin_fail(SPIN_E_UNSUPPORTED, "its model is number %d, which is not known", kind);
    SPIN_TRY(take_f64(b, models[kind].n, p));
    return fill_lens(m, *id, kind, (double)width, (double)height, p);
}

static spin_status read_lens_text(struct colmap_model *m, char *line, int *id)
{
    double p[MAX_PARAMETERS], width, height;
    const char *name;
    int kind = 0;

    SPIN_TRY(reserve_lens(m));
    SPIN_TRY(next_integer(&line, "the id", id));
    name = next_word(&line);
    while (kind < N_MODELS && strcmp(models[kind].name, name) != 0)
        kind++;
    if (kind == N_MODELS)
        return spin_fail(SPIN_E_UNSUPPORTED, "its model is '%.40s', which is not known", name);
    SPIN_TRY(next_number(&line, "the width", &width));
    SPIN_TRY(next_number(&line, "the height", &height));
    for (int i = 0; i < models[kind].n; i++)
        SPIN_TRY(next_number(&line, "a parameter", &p[i]));
    return fill_lens(m, *id, kind, width, height, p);
}

static spin_status read_lenses_binary(struct colmap_model *m, struct bytes *b)
{
    uint64_t n;

    SPIN_TRY(take_count(b, 24 + 3 * 8, "cameras", &n));
    for (uint64_t i = 0; i < n; i++) {
        int id = -1;
        spin_status status = read_lens_binary(m, b, &id);

        if (status != SPIN_OK)
            return spin_fail_context(status, "camera %d", id);
    }
    return SPIN_OK;
}

/* ---- Images ---------------------------------------------------------------------------------- */

static const struct colmap_lens *find_lens(const struct colmap_model *m, int id)
{
    for (size_t i = 0; i < m->n_lenses; i++) {
        if (m->lens[i].id == id)
            return &m->lens[i];
    }
    return NULL;
}

/* Rotation matrix of a quaternion w, x, y, z of any length but 0. */
static spin_status fill_pose(const double q[4], const double t[3], double m[12])
{
    double norm = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]), r[9];

    if (!(norm > 1e-12) || !isfinite(norm))
        return spin_fail(SPIN_E_MALFORMED, "its quaternion %g %g %g %g is no rotation", q[0], q[1],
                         q[2], q[3]);
    spin_matrix_of_quat(q, r);
    for (int i = 0; i < 3; i++) {
        memcpy(m + 4 * i, r + 3 * i, 3 * sizeof *m);
        m[4 * i + 3] = t[i];
    }
    return spin_views_check_pose(m, "the pose");
}

static spin_status add_image(struct colmap_model *m, struct colmap_image *image, const char *name)
{
    const struct colmap_lens *lens = find_lens(m, image->lens_id);

    if (!lens)
        return spin_fail(SPIN_E_MALFORMED, "there is no camera %d", image->lens_id);
    if (!spin_views_is_safe_name(name))
        return spin_fail(SPIN_E_MALFORMED, "its name is '%.80s', expected one below the images",
                         name);
    image->camera = lens->camera;
    SPIN_TRY(fill_pose(image->q, image->t, image->camera.w2c));
    SPIN_TRY(spin_room(m->n_images, &m->capacity, sizeof *m->image, (void **)&m->image));
    image->place = m->n_images;
    SPIN_TRY(spin_strdup(name, &image->name));
    m->image[m->n_images++] = *image;
    return SPIN_OK;
}

static spin_status read_image_binary(struct colmap_model *m, struct bytes *b, int *id)
{
    struct colmap_image image = {0};
    const unsigned char *name = NULL, *end;
    uint64_t n_points;

    SPIN_TRY(take_i32(b, id));
    SPIN_TRY(take_f64(b, 4, image.q));
    SPIN_TRY(take_f64(b, 3, image.t));
    SPIN_TRY(take_i32(b, &image.lens_id));
    end = memchr(b->at, '\0', (size_t)(b->end - b->at));
    if (!end || end - b->at > MAX_NAME)
        return spin_fail(SPIN_E_MALFORMED, "its name does not end");
    SPIN_TRY(take(b, (size_t)(end - b->at) + 1, &name));
    SPIN_TRY(take_count(b, 24, "points of the image", &n_points));
    b->at += 24 * n_points;
    return add_image(m, &image, (const char *)name);
}

/* ID QW QX QY QZ TX TY TZ CAMERA_ID NAME; the name is the rest of the line. */
static spin_status read_image_text(struct colmap_model *m, char *line, int *id)
{
    static const char *const what[] = {"QW", "QX", "QY", "QZ", "TX", "TY", "TZ"};
    struct colmap_image image = {0};

    SPIN_TRY(next_integer(&line, "the id", id));
    for (int i = 0; i < 7; i++)
        SPIN_TRY(next_number(&line, what[i], i < 4 ? &image.q[i] : &image.t[i - 4]));
    SPIN_TRY(next_integer(&line, "the camera's id", &image.lens_id));
    line += strspn(line, " \t");
    return add_image(m, &image, line);
}

static spin_status read_images_binary(struct colmap_model *m, struct bytes *b)
{
    uint64_t n;

    SPIN_TRY(take_count(b, 4 + 7 * 8 + 4 + 1 + 8, "images", &n));
    for (uint64_t i = 0; i < n; i++) {
        int id = -1;
        spin_status status = read_image_binary(m, b, &id);

        if (status != SPIN_OK)
            return spin_fail_context(status, "image %d", id);
    }
    return SPIN_OK;
}

/* ---- Points ---------------------------------------------------------------------------------- */

/* A sample of the points, by which a camera that looks the wrong way is noticed. */
static spin_status add_point(struct colmap_model *m, uint64_t index, const double xyz[3])
{
    if (index % m->point_step != 0 || m->n_points == MAX_POINTS)
        return SPIN_OK;
    if (!m->point)
        SPIN_TRY(spin_alloc(MAX_POINTS, sizeof *m->point, (void **)&m->point));
    memcpy(m->point[m->n_points++], xyz, sizeof *m->point);
    return SPIN_OK;
}

static spin_status read_points_binary(struct colmap_model *m, struct bytes *b)
{
    const unsigned char *rest = NULL;
    uint64_t n, id, n_track;
    double xyz[3];

    SPIN_TRY(take_count(b, 8 + 3 * 8 + 3 + 8 + 8, "points", &n));
    m->point_step = n / MAX_POINTS + 1;
    for (uint64_t i = 0; i < n; i++) {
        SPIN_TRY(take_u64(b, &id));
        SPIN_TRY(take_f64(b, 3, xyz));
        SPIN_TRY(take(b, 3 + 8, &rest));
        SPIN_TRY(take_count(b, 8, "places of a point", &n_track));
        b->at += 8 * n_track;
        SPIN_TRY(add_point(m, i, xyz));
    }
    return SPIN_OK;
}

static spin_status read_point_text(struct colmap_model *m, char *line, int *id)
{
    double xyz[3];

    SPIN_TRY(next_integer(&line, "the id", id));
    for (int i = 0; i < 3; i++)
        SPIN_TRY(next_number(&line, "a coordinate", &xyz[i]));
    m->point_step = 1;
    return add_point(m, m->n_seen++, xyz);
}

/* All points behind a camera: its axes are OpenGL's, or its pose is wrong. */
static void warn_behind(const struct colmap_model *m)
{
    for (size_t i = 0; i < m->n_images; i++) {
        const double *w = m->image[i].camera.w2c;
        bool behind = m->n_points > 0;

        for (size_t k = 0; k < m->n_points && behind; k++) {
            const double *p = m->point[k];

            behind = w[8] * p[0] + w[9] * p[1] + w[10] * p[2] + w[11] <= 0;
        }
        if (behind) {
            spin_warn("'%s': all points are behind the camera of image '%s'", m->sparse,
                      m->image[i].name);
            return;
        }
    }
}

/* ---- The files ------------------------------------------------------------------------------- */

/* The files of a model. */
static const struct kind {
    const char *name, *what;
    spin_status (*binary)(struct colmap_model *m, struct bytes *b);
    spin_status (*text)(struct colmap_model *m, char *line, int *id);
    int lines; /* of a record in text; an image's second are its points, and may be empty */
} cameras = {"cameras", "camera", read_lenses_binary, read_lens_text, 1},
  images = {"images", "image", read_images_binary, read_image_text, 2},
  points = {"points3D", "point", read_points_binary, read_point_text, 1};

static spin_status read_text(struct colmap_model *m, const struct kind *kind, struct bytes *b)
{
    char *line = NULL;
    bool found = true;
    spin_status status = SPIN_OK;

    while (status == SPIN_OK && found) {
        int id = -1;

        status = next_line(b, &line, &found);
        if (status != SPIN_OK || !found || !is_record(line))
            continue;
        status = kind->text(m, line, &id);
        if (status != SPIN_OK)
            status = spin_fail_context(status, "%s %d", kind->what, id);
        else if (kind->lines == 2)
            status = next_line(b, &line, &found);
    }
    free(line);
    return status;
}

/* <name>.bin or <name>.txt of the model. */
static spin_status read_file(struct colmap_model *m, const struct kind *kind)
{
    char file[32], *path = NULL;
    struct spin_map map = {0};
    struct bytes bytes;
    spin_status status;

    snprintf(file, sizeof file, "%s.%s", kind->name, m->binary ? "bin" : "txt");
    SPIN_TRY(spin_path_join(m->sparse, file, &path));
    SPIN_TRY_OUT(spin_map_open(path, &map));
    bytes = (struct bytes){map.data, map.data + map.size};
    status = m->binary ? kind->binary(m, &bytes) : read_text(m, kind, &bytes);
    if (status != SPIN_OK)
        status = spin_fail_context(status, "cannot read '%s'", path);
out:
    spin_map_close(&map);
    free(path);
    return status;
}

/* sparse/0, or sparse itself. */
static spin_status find_sparse(struct colmap_model *m, const char *folder)
{
    static const char *const places[] = {"sparse/0", "sparse"};

    for (int i = 0; i < 2; i++) {
        SPIN_TRY(spin_path_join(folder, places[i], &m->sparse));
        m->binary = spin_model_holds(m->sparse, "images.bin");
        if (m->binary || spin_model_holds(m->sparse, "images.txt"))
            return SPIN_OK;
        free(m->sparse);
        m->sparse = NULL;
    }
    return spin_fail(SPIN_E_NOT_FOUND,
                     "'%s' has neither images.bin nor images.txt in 'sparse/0' or 'sparse'",
                     folder);
}

/* By name without its ending, which is what decides who is held out. */
static int by_name(const void *a, const void *b)
{
    const char *x = ((const struct colmap_image *)a)->name,
               *y = ((const struct colmap_image *)b)->name;
    const char *x_end = strrchr(x, '.'), *y_end = strrchr(y, '.');
    size_t n_x = x_end ? (size_t)(x_end - x) : strlen(x);
    size_t n_y = y_end ? (size_t)(y_end - y) : strlen(y);
    int order = memcmp(x, y, n_x < n_y ? n_x : n_y);

    if (order == 0)
        order = n_x < n_y ? -1 : n_x > n_y;
    return order ? order : strcmp(x, y);
}

spin_status spin_colmap_model_read(const char *folder, bool centre, struct colmap_model *m)
{
    m->centre = centre;
    SPIN_TRY(find_sparse(m, folder));
    SPIN_TRY(read_file(m, &cameras));
    SPIN_TRY(read_file(m, &images));
    if (m->n_images == 0)
        return spin_fail(SPIN_E_MALFORMED, "'%s' has no images", m->sparse);
    if (m->n_images > INT_MAX)
        return spin_fail(SPIN_E_UNSUPPORTED, "'%s' has too many images", m->sparse);
    if (spin_model_holds(m->sparse, m->binary ? "points3D.bin" : "points3D.txt"))
        SPIN_TRY(read_file(m, &points));
    warn_behind(m);
    qsort(m->image, m->n_images, sizeof *m->image, by_name);
    for (size_t i = 1; i < m->n_images; i++) {
        if (strcmp(m->image[i].name, m->image[i - 1].name) == 0)
            return spin_fail(SPIN_E_MALFORMED, "'%s' has two images called '%s'", m->sparse,
                             m->image[i].name);
    }
    return SPIN_OK;
}

void spin_colmap_model_free(struct colmap_model *m)
{
    for (size_t i = 0; i < m->n_images; i++)
        free(m->image[i].name);
    free(m->image);
    free(m->lens);
    free(m->point);
    free(m->sparse);
}
