/* COLMAP sparse models with undistorted images.
 *
 *     sparse/0/{cameras,images,points3D}.{bin,txt}, images/ one model; each image is one frame
 *     frame000001/{sparse/0, images}, frame000002/...       3DGStream: one folder per frame, the
 *                                                           model of the first one counts for all
 *
 * Binary files are little-endian and packed; of text and binary the binary is taken, as the methods
 * do. A pose is w2c in OpenCV's axes already: R(q) p + t. The principal point of the file is kept;
 * the methods' own readers put it in the centre, which principal=centre does too. Only pinhole
 * cameras can be rendered: a model with distortion that is not zero must be undistorted first.
 *
 * With one model the time of an image is its place in the file over the number of images
 * (4DGaussians, which takes it for a video of one camera), and each eighth image by name is held
 * out (3DGS's --eval). With a folder per frame each image is a camera of every frame, times are
 * 0, 1, 2, ..., and the first camera is held out (3DGStream). */
#include "spin.h"

#include <ctype.h>
#include <limits.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "base/log.h"
#include "base/mem.h"
#include "importers/lib/views_check.h"
#include "io/file.h"

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

struct lens {
    int id;
    struct spin_camera camera; /* without a pose */
};

struct image {
    char *name;
    double q[4], t[3];
    int lens_id;
    size_t place; /* in the file */
    struct spin_camera camera;
};

struct model {
    const char *folder; /* that has sparse/ and images/ */
    char *sparse;       /* where the files are */
    bool binary, centre;
    struct lens *lens;
    size_t n_lenses;
    struct image *image;
    size_t n_images, capacity;
    double (*point)[3]; /* every point_step-th */
    size_t n_points;
    uint64_t point_step;
};

/* ---- Recognising ----------------------------------------------------------------------------- */

/* "frame000012": 12, else -1. */
static int frame_number(const char *name)
{
    int n = 0;

    if (strncmp(name, "frame", 5) != 0)
        return -1;
    for (const char *c = name + 5; *c; c++, n++) {
        if (!isdigit((unsigned char)*c))
            return -1;
    }
    return n > 0 ? spin_views_number(name) : -1;
}

static int probe(const struct spin_peek *peek)
{
    bool frames = false;

    for (size_t i = 0; peek->is_folder && peek->names && peek->names[i]; i++) {
        if (strcmp(peek->names[i], "sparse") == 0)
            return 100;
        frames = frames || frame_number(peek->names[i]) >= 0;
    }
    return frames ? 50 : 0;
}

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
                         "%llu %s are promised, which the remaining %zu bytes cannot hold",
                         (unsigned long long)*out, what, (size_t)(b->end - b->at));
    return SPIN_OK;
}

/* The next line as a string, or false at the end; `line` is reused. */
static spin_status next_line(struct bytes *b, char **line, bool *found)
{
    const unsigned char *newline = memchr(b->at, '\n', (size_t)(b->end - b->at));
    size_t n = (size_t)((newline ? newline : b->end) - b->at);
    void *block = *line;

    *found = b->at < b->end;
    if (!*found)
        return SPIN_OK;
    SPIN_TRY(spin_grow(n + 1, 1, &block));
    *line = block;
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

static spin_status fill_lens(struct model *m, int id, int kind, double width, double height,
                             const double *p)
{
    struct spin_camera *c = &m->lens[m->n_lenses].camera;

    for (size_t i = 0; i < m->n_lenses; i++) {
        if (m->lens[i].id == id)
            return spin_fail(SPIN_E_MALFORMED, "there are two cameras with id %d", id);
    }
    SPIN_TRY(spin_views_check_size(width, height));
    if (models[kind].distortion < 0)
        return spin_fail(SPIN_E_UNSUPPORTED, "its model %s is no pinhole: undistort the images",
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

static spin_status read_lens_binary(struct model *m, struct bytes *b, int *id)
{
    double p[MAX_PARAMETERS];
    uint64_t width, height;
    int kind;

    SPIN_TRY(take_i32(b, id));
    SPIN_TRY(take_i32(b, &kind));
    SPIN_TRY(take_u64(b, &width));
    SPIN_TRY(take_u64(b, &height));
    if (kind < 0 || kind >= N_MODELS)
        return spin_fail(SPIN_E_UNSUPPORTED, "its model is number %d, which is not known", kind);
    SPIN_TRY(take_f64(b, models[kind].n, p));
    return fill_lens(m, *id, kind, (double)width, (double)height, p);
}

static spin_status read_lens_text(struct model *m, char *line, int *id)
{
    double p[MAX_PARAMETERS], width, height;
    const char *name;
    int kind = 0;

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

static spin_status reserve_lens(struct model *m)
{
    void *block = m->lens;

    SPIN_TRY(spin_grow(m->n_lenses + 1, sizeof *m->lens, &block));
    m->lens = block;
    memset(&m->lens[m->n_lenses], 0, sizeof *m->lens);
    return SPIN_OK;
}

static spin_status read_lenses_binary(struct model *m, struct bytes *b)
{
    uint64_t n;

    SPIN_TRY(take_count(b, 24 + 3 * 8, "cameras", &n));
    for (uint64_t i = 0; i < n; i++) {
        spin_status status;
        int id = -1;

        SPIN_TRY(reserve_lens(m));
        status = read_lens_binary(m, b, &id);
        if (status != SPIN_OK)
            return spin_fail_context(status, "camera %d", id);
    }
    return SPIN_OK;
}

static spin_status read_lenses_text(struct model *m, struct bytes *b)
{
    char *line = NULL;
    bool found = true;
    spin_status status = SPIN_OK;

    while (status == SPIN_OK && found) {
        int id = -1;

        status = next_line(b, &line, &found);
        if (status != SPIN_OK || !found || !is_record(line))
            continue;
        status = reserve_lens(m);
        if (status == SPIN_OK)
            status = read_lens_text(m, line, &id);
        if (status != SPIN_OK)
            status = spin_fail_context(status, "camera %d", id);
    }
    free(line);
    return status;
}

/* ---- Images ---------------------------------------------------------------------------------- */

static const struct lens *find_lens(const struct model *m, int id)
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
    double norm = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    double w, x, y, z;

    if (!(norm > 1e-12) || !isfinite(norm))
        return spin_fail(SPIN_E_MALFORMED, "its quaternion %g %g %g %g is no rotation", q[0], q[1],
                         q[2], q[3]);
    w = q[0] / norm;
    x = q[1] / norm;
    y = q[2] / norm;
    z = q[3] / norm;
    m[0] = 1 - 2 * (y * y + z * z);
    m[1] = 2 * (x * y - w * z);
    m[2] = 2 * (x * z + w * y);
    m[4] = 2 * (x * y + w * z);
    m[5] = 1 - 2 * (x * x + z * z);
    m[6] = 2 * (y * z - w * x);
    m[8] = 2 * (x * z - w * y);
    m[9] = 2 * (y * z + w * x);
    m[10] = 1 - 2 * (x * x + y * y);
    for (int i = 0; i < 3; i++)
        m[4 * i + 3] = t[i];
    return spin_views_check_pose(m, "the pose");
}

static spin_status add_image(struct model *m, struct image *image, const char *name)
{
    const struct lens *lens = find_lens(m, image->lens_id);

    if (!lens)
        return spin_fail(SPIN_E_MALFORMED, "there is no camera %d", image->lens_id);
    if (!spin_views_is_safe_name(name))
        return spin_fail(SPIN_E_MALFORMED, "its name is '%.80s', expected one below the images",
                         name);
    image->camera = lens->camera;
    SPIN_TRY(fill_pose(image->q, image->t, image->camera.w2c));
    if (m->n_images == m->capacity) {
        void *block = m->image;
        size_t capacity = m->capacity ? 2 * m->capacity : 64;

        SPIN_TRY(spin_grow(capacity, sizeof *m->image, &block));
        m->image = block;
        m->capacity = capacity;
    }
    image->place = m->n_images;
    SPIN_TRY(spin_strdup(name, &image->name));
    m->image[m->n_images++] = *image;
    return SPIN_OK;
}

static spin_status read_image_binary(struct model *m, struct bytes *b, int *id)
{
    struct image image = {0};
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
static spin_status read_image_text(struct model *m, char *line, int *id)
{
    static const char *const what[] = {"QW", "QX", "QY", "QZ", "TX", "TY", "TZ"};
    struct image image = {0};

    SPIN_TRY(next_integer(&line, "the id", id));
    for (int i = 0; i < 7; i++)
        SPIN_TRY(next_number(&line, what[i], i < 4 ? &image.q[i] : &image.t[i - 4]));
    SPIN_TRY(next_integer(&line, "the camera's id", &image.lens_id));
    line += strspn(line, " \t");
    return add_image(m, &image, line);
}

static spin_status read_images_binary(struct model *m, struct bytes *b)
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

/* Two lines per image; the second, its points, may be empty. */
static spin_status read_images_text(struct model *m, struct bytes *b)
{
    char *line = NULL;
    bool found = true;
    spin_status status = SPIN_OK;

    while (status == SPIN_OK && found) {
        int id = -1;

        status = next_line(b, &line, &found);
        if (status != SPIN_OK || !found || !is_record(line))
            continue;
        status = read_image_text(m, line, &id);
        if (status != SPIN_OK)
            status = spin_fail_context(status, "image %d", id);
        else
            status = next_line(b, &line, &found);
    }
    free(line);
    return status;
}

/* ---- Points ---------------------------------------------------------------------------------- */

/* A sample of the points, by which a camera that looks the wrong way is noticed. */
static spin_status add_point(struct model *m, uint64_t index, const double xyz[3])
{
    if (index % m->point_step != 0 || m->n_points == MAX_POINTS)
        return SPIN_OK;
    if (!m->point)
        SPIN_TRY(spin_alloc(MAX_POINTS, sizeof *m->point, (void **)&m->point));
    memcpy(m->point[m->n_points++], xyz, sizeof *m->point);
    return SPIN_OK;
}

static spin_status read_points_binary(struct model *m, struct bytes *b)
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

static spin_status read_point_text(struct model *m, uint64_t index, char *line)
{
    double xyz[3];
    int id;

    SPIN_TRY(next_integer(&line, "the id", &id));
    for (int i = 0; i < 3; i++)
        SPIN_TRY(next_number(&line, "a coordinate", &xyz[i]));
    return add_point(m, index, xyz);
}

static spin_status read_points_text(struct model *m, struct bytes *b)
{
    char *line = NULL;
    bool found = true;
    uint64_t n = 0;
    spin_status status = SPIN_OK;

    m->point_step = 1;
    while (status == SPIN_OK && found) {
        status = next_line(b, &line, &found);
        if (status != SPIN_OK || !found || !is_record(line))
            continue;
        status = read_point_text(m, n, line);
        if (status != SPIN_OK)
            status = spin_fail_context(status, "point %llu", (unsigned long long)n);
        n++;
    }
    free(line);
    return status;
}

/* All points behind a camera: its axes are OpenGL's, or its pose is wrong. */
static void warn_behind(const struct model *m)
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

/* <name>.bin or <name>.txt of the model. */
static spin_status read_file(struct model *m, const char *name,
                             spin_status (*binary)(struct model *, struct bytes *),
                             spin_status (*text)(struct model *, struct bytes *))
{
    char file[32], *path = NULL;
    struct spin_map map = {0};
    struct bytes bytes;
    spin_status status;

    snprintf(file, sizeof file, "%s.%s", name, m->binary ? "bin" : "txt");
    SPIN_TRY(spin_path_join(m->sparse, file, &path));
    SPIN_TRY_OUT(spin_map_open(path, &map));
    bytes = (struct bytes){map.data, map.data + map.size};
    status = m->binary ? binary(m, &bytes) : text(m, &bytes);
    if (status != SPIN_OK)
        status = spin_fail_context(status, "cannot read '%s'", path);
out:
    spin_map_close(&map);
    free(path);
    return status;
}

static bool has_file(const char *folder, const char *name)
{
    char *path = NULL;
    bool found = spin_path_join(folder, name, &path) == SPIN_OK && spin_path_exists(path);

    free(path);
    return found;
}

/* sparse/0, or sparse itself. */
static spin_status find_sparse(struct model *m)
{
    static const char *const places[] = {"sparse/0", "sparse"};

    for (int i = 0; i < 2; i++) {
        SPIN_TRY(spin_path_join(m->folder, places[i], &m->sparse));
        m->binary = has_file(m->sparse, "images.bin");
        if (m->binary || has_file(m->sparse, "images.txt"))
            return SPIN_OK;
        free(m->sparse);
        m->sparse = NULL;
    }
    return spin_fail(SPIN_E_NOT_FOUND,
                     "'%s' has neither images.bin nor images.txt in 'sparse/0' or 'sparse'",
                     m->folder);
}

/* By name without its ending, which is what decides who is held out. */
static int by_name(const void *a, const void *b)
{
    const char *x = ((const struct image *)a)->name, *y = ((const struct image *)b)->name;
    const char *x_end = strrchr(x, '.'), *y_end = strrchr(y, '.');
    size_t n_x = x_end ? (size_t)(x_end - x) : strlen(x);
    size_t n_y = y_end ? (size_t)(y_end - y) : strlen(y);
    int order = memcmp(x, y, n_x < n_y ? n_x : n_y);

    if (order == 0)
        order = n_x < n_y ? -1 : n_x > n_y;
    return order ? order : strcmp(x, y);
}

static spin_status read_model(struct model *m)
{
    SPIN_TRY(find_sparse(m));
    SPIN_TRY(read_file(m, "cameras", read_lenses_binary, read_lenses_text));
    SPIN_TRY(read_file(m, "images", read_images_binary, read_images_text));
    if (m->n_images == 0)
        return spin_fail(SPIN_E_MALFORMED, "'%s' has no images", m->sparse);
    if (m->n_images > INT_MAX)
        return spin_fail(SPIN_E_UNSUPPORTED, "'%s' has too many images", m->sparse);
    if (has_file(m->sparse, m->binary ? "points3D.bin" : "points3D.txt"))
        SPIN_TRY(read_file(m, "points3D", read_points_binary, read_points_text));
    warn_behind(m);
    qsort(m->image, m->n_images, sizeof *m->image, by_name);
    for (size_t i = 1; i < m->n_images; i++) {
        if (strcmp(m->image[i].name, m->image[i - 1].name) == 0)
            return spin_fail(SPIN_E_MALFORMED, "'%s' has two images called '%s'", m->sparse,
                             m->image[i].name);
    }
    return SPIN_OK;
}

static void free_model(struct model *m)
{
    for (size_t i = 0; i < m->n_images; i++)
        free(m->image[i].name);
    free(m->image);
    free(m->lens);
    free(m->point);
    free(m->sparse);
}

/* ---- Views ----------------------------------------------------------------------------------- */

struct options {
    const char *images; /* folder */
    bool by_name;       /* time of one model's images */
    int hold;           /* each hold-th is test; 0: none; -1: what suits the layout */
};

/* Numbers in the names are the cameras' when no two are equal; else their places by name. */
static spin_status camera_ids(const struct model *m, int **out)
{
    int *sorted = NULL;
    bool usable = true;

    SPIN_TRY(spin_alloc(m->n_images, sizeof **out, (void **)out));
    SPIN_TRY(spin_alloc(m->n_images, sizeof *sorted, (void **)&sorted));
    for (size_t i = 0; i < m->n_images; i++) {
        sorted[i] = (*out)[i] = spin_views_number(m->image[i].name);
        usable = usable && sorted[i] >= 0;
    }
    usable = usable && spin_views_unique(sorted, m->n_images) == m->n_images;
    for (size_t i = 0; !usable && i < m->n_images; i++)
        (*out)[i] = (int)i;
    free(sorted);
    return SPIN_OK;
}

/* One view of each image, found in `folder`; row < 0: each image is a row of its own. */
static spin_status add_views(const struct model *m, const struct options *o, const char *folder,
                             const int *ids, int row, int number, struct spin_views *out)
{
    char *images = NULL;
    spin_status status;

    SPIN_TRY(spin_path_join(folder, o->images, &images));
    status = SPIN_OK;
    for (size_t i = 0; i < m->n_images && status == SPIN_OK; i++) {
        const struct image *image = &m->image[i];
        size_t place = o->by_name ? i : image->place;
        struct spin_view view = {.camera = image->camera, .camera_id = ids[i]};

        view.dataset_frame = row < 0 ? (int)place : row;
        view.number = row < 0 ? spin_views_number(image->name) : number;
        view.time = row < 0 ? (double)place / (double)m->n_images : row;
        view.test = o->hold < 0    ? (row < 0 ? i % 8 == 0 : i == 0)
                    : o->hold == 0 ? false
                                   : i % (size_t)o->hold == 0;
        status = spin_path_join(images, image->name, &view.path);
        if (status == SPIN_OK)
            status = spin_views_add(out, &view);
        free(view.path);
    }
    free(images);
    return status;
}

/* Make all cameras those of the images that are there; the first n views tell. */
static spin_status fit_cameras(const struct model *m, struct spin_views *out, size_t first)
{
    for (size_t i = 0; i < m->n_images; i++)
        SPIN_TRY(spin_views_fit_image(&out->view[first + i].camera, out->view[first + i].path));
    for (size_t i = first + m->n_images; i < out->n; i++)
        out->view[i].camera = out->view[i - m->n_images].camera;
    return SPIN_OK;
}

static int by_frame_number(const void *a, const void *b)
{
    int x = frame_number(*(char *const *)a), y = frame_number(*(char *const *)b);

    return x < y ? -1 : x > y;
}

/* Folders frame<digits>, sorted by number, to the front of names. */
static spin_status keep_frames(const char *path, char **names, size_t *n)
{
    size_t kept = 0;

    for (size_t i = 0; i < *n; i++) {
        if (frame_number(names[i]) >= 0) {
            char *name = names[i];

            names[i] = names[kept];
            names[kept++] = name;
        }
    }
    qsort(names, kept, sizeof *names, by_frame_number);
    for (size_t i = 1; i < kept; i++) {
        if (frame_number(names[i]) == frame_number(names[i - 1]))
            return spin_fail(SPIN_E_MALFORMED, "'%s' and '%s' are both frame %d", names[i - 1],
                             names[i], frame_number(names[i]));
    }
    if (kept == 0)
        return spin_fail(SPIN_E_NOT_FOUND, "'%s' has neither 'sparse' nor frame folders", path);
    *n = kept;
    return SPIN_OK;
}

static spin_status read_frames(const char *path, char **names, size_t n, struct model *m,
                               const struct options *o, struct spin_views *out)
{
    char *folder = NULL;
    int *ids = NULL;
    spin_status status;

    for (size_t f = 0; f < n; f++) {
        SPIN_TRY_OUT(spin_path_join(path, names[f], &folder));
        if (f == 0) {
            m->folder = folder;
            SPIN_TRY_OUT(read_model(m));
            SPIN_TRY_OUT(camera_ids(m, &ids));
        }
        SPIN_TRY_OUT(add_views(m, o, folder, ids, (int)f, frame_number(names[f]), out));
        free(folder);
        folder = NULL;
    }
    status = SPIN_OK;
out:
    free(folder);
    free(ids);
    return status;
}

static spin_status read_one(const char *path, struct model *m, const struct options *o,
                            struct spin_views *out)
{
    int *ids = NULL;
    spin_status status;

    m->folder = path;
    SPIN_TRY(read_model(m));
    status = camera_ids(m, &ids);
    if (status == SPIN_OK)
        status = add_views(m, o, path, ids, -1, -1, out);
    free(ids);
    return status;
}

static spin_status read_options(const struct spin_plugin_values *values, struct options *o,
                                struct model *m)
{
    const char *time = spin_plugin_value(values, "time", "file");
    const char *principal = spin_plugin_value(values, "principal", "file");

    o->images = spin_plugin_value(values, "images", "images");
    if (!spin_views_is_safe_name(o->images))
        return spin_fail(SPIN_E_USAGE, "option 'images' is '%s', expected a folder's name",
                         o->images);
    o->by_name = strcmp(time, "name") == 0;
    if (!o->by_name && strcmp(time, "file") != 0)
        return spin_fail(SPIN_E_USAGE, "option 'time' is '%s', expected file or name", time);
    m->centre = strcmp(principal, "centre") == 0;
    if (!m->centre && strcmp(principal, "file") != 0)
        return spin_fail(SPIN_E_USAGE, "option 'principal' is '%s', expected file or centre",
                         principal);
    SPIN_TRY(spin_views_option_count(values, "hold", "-1", &o->hold));
    if (o->hold < -1)
        return spin_fail(SPIN_E_USAGE, "option 'hold' is %d, expected 0 or more", o->hold);
    return SPIN_OK;
}

static spin_status colmap_views(const char *path, const struct spin_plugin_values *values,
                                struct spin_views *out)
{
    struct options o = {0};
    struct model m = {0};
    size_t first = out->n, n = 0;
    char *sparse = NULL, **names = NULL;
    spin_status status;

    SPIN_TRY(read_options(values, &o, &m));
    SPIN_TRY(spin_path_join(path, "sparse", &sparse));
    if (spin_path_is_folder(sparse)) {
        SPIN_TRY_OUT(read_one(path, &m, &o, out));
    } else {
        SPIN_TRY_OUT(spin_folder_list(path, &names, &n));
        SPIN_TRY_OUT(keep_frames(path, names, &n));
        SPIN_TRY_OUT(read_frames(path, names, n, &m, &o, out));
    }
    SPIN_TRY_OUT(spin_views_check_images(out, first));
    SPIN_TRY_OUT(fit_cameras(&m, out, first));
out:
    spin_folder_list_free(names);
    free(sparse);
    free_model(&m);
    return status;
}

static const struct spin_plugin_option options[] = {
    {"images", "FOLDER", "where the images are, such as images_2", "images"},
    {"time", "RULE",
     "one model: frame and time i/n of an image by its place in the file, or by its name", "file"},
    {"hold", "N",
     "hold out each N-th image by name, the first included; 0: none (8; with frame folders only "
     "the first)",
     NULL},
    {"principal", "RULE", "principal point: file, or centre as the methods' readers have it",
     "file"},
    {NULL, NULL, NULL, NULL},
};

const struct spin_importer spin_importer_views_colmap = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "colmap",
    .summary = "views: COLMAP's sparse model and undistorted images, one or one per frame folder",
    .upstream = "hustvl/4DGaussians scene/colmap_loader.py, SJoJoK/3DGStream 747ddfe",
    .options = options,
    .probe = probe,
    .views = colmap_views,
};
