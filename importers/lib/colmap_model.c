/* Reads sparse models of COLMAP. */
#include "importers/lib/colmap.h"

#include "importers/lib/views_check.h"
#include "io/text_file.h"
#include "math/covariance.h"

enum { MAX_PARAMETERS = 16, MAX_NAME = 4096, MAX_POINTS = 1000 };

/* Camera models, at the index that is their id in COLMAP: the number n of parameters and the
 * indices of fx, fy, cx and cy. Parameters from index `distortion` on must be 0; `distortion` is -1
 * for models that are never pinhole cameras. */
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

/* A binary or text file that is being read. For text, `word` is the rest of the current line, which
 * is split in place. */
struct source {
    bool binary;
    char *at, *end, *word;
};

static spin_status read_bytes(struct source *s, size_t n, const char **out)
{
    if ((size_t)(s->end - s->at) < n)
        return spin_malformed("the file is cut short");
    *out = s->at;
    s->at += n;
    return SPIN_OK;
}

/* Reads a little-endian number of n bytes. */
static spin_status take_bits(struct source *s, size_t n, uint64_t *out)
{
    const char *p = NULL;

    SPIN_TRY(read_bytes(s, n, &p));
    *out = 0;
    for (size_t i = n; i-- > 0;)
        *out = *out << 8 | (unsigned char)p[i];
    return SPIN_OK;
}

/* Reads a count of records and checks that the rest of the file is large enough for them, at
 * `smallest` bytes each. */
static spin_status take_count(struct source *s, size_t smallest, const char *what, uint64_t *out)
{
    SPIN_TRY(take_bits(s, 8, out));
    if (*out > (uint64_t)(s->end - s->at) / smallest)
        return spin_malformed(
            "the file announces %llu %s, more than fit into the remaining %zu bytes",
            (unsigned long long)*out, what, (size_t)(s->end - s->at));
    return SPIN_OK;
}

/* Sets s->word to the next line. Returns false at the end of the file. */
static bool next_line(struct source *s)
{
    char *stop = memchr(s->at, '\n', (size_t)(s->end - s->at));

    if (s->at >= s->end)
        return false;
    s->word = s->at;
    stop = stop ? stop : s->end;
    s->at = stop + (stop < s->end);
    *stop = '\0';
    return true;
}

/* Whether a line is neither a comment nor blank. */
static bool is_record(const char *line)
{
    line += strspn(line, " \t");
    return *line != '#' && *line != '\0';
}

/* Returns the next word of the line, terminated in place, or "" at the end of the line. */
static char *next_word(struct source *s)
{
    char *word = s->word + strspn(s->word, " \t");

    s->word = word + strcspn(word, " \t");
    if (*s->word)
        *s->word++ = '\0';
    return word;
}

static spin_status next_number(struct source *s, const char *what, double *out)
{
    const char *word = next_word(s);

    if (!spin_views_is_number(word, out))
        return spin_malformed("%s is '%.40s', expected a number", what, word);
    return SPIN_OK;
}

static spin_status take_real(struct source *s, const char *what, double *out)
{
    uint64_t bits;

    if (!s->binary)
        return next_number(s, what, out);
    SPIN_TRY(take_bits(s, 8, &bits));
    memcpy(out, &bits, sizeof bits);
    return SPIN_OK;
}

static spin_status take_integer(struct source *s, const char *what, int *out)
{
    uint64_t bits;
    double value;

    if (s->binary) {
        SPIN_TRY(take_bits(s, 4, &bits));
        *out = (int)(int32_t)bits;
        return SPIN_OK;
    }
    SPIN_TRY(next_number(s, what, &value));
    if (value != floor(value) || fabs(value) > INT_MAX)
        return spin_malformed("%s is %g, expected a whole number", what, value);
    *out = (int)value;
    return SPIN_OK;
}

static spin_status take_size(struct source *s, const char *what, double *out)
{
    uint64_t bits;

    if (!s->binary)
        return next_number(s, what, out);
    SPIN_TRY(take_bits(s, 8, &bits));
    *out = (double)bits;
    return SPIN_OK;
}

/* ---- Cameras --------------------------------------------------------------------------------- */

static spin_status fill_lens(struct spin_colmap *m, int id, int kind, double width, double height,
                             const double *p)
{
    struct spin_camera *c = &m->lens[m->n_lenses].camera;

    for (size_t i = 0; i < m->n_lenses; i++) {
        if (m->lens[i].id == id)
            return spin_malformed("there are two cameras with id %d", id);
    }
    SPIN_TRY(spin_views_check_size(width, height));
    if (models[kind].distortion < 0)
        return spin_unsupported(
            "the camera model %s is not that of a pinhole camera: undistort the images",
            models[kind].name);
    for (int i = models[kind].distortion; i < models[kind].n; i++) {
        if (p[i] != 0)
            return spin_unsupported(
                "the camera model %s has a distortion of %g: undistort the images",
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

/* Reads the camera model: a number in binary files, a name in text. */
static spin_status take_kind(struct source *s, int *kind)
{
    const char *name = NULL;

    if (s->binary) {
        SPIN_TRY(take_integer(s, "", kind));
        if (*kind < 0 || *kind >= N_MODELS)
            return spin_unsupported("the camera model has number %d, which COLMAP does not define",
                                    *kind);
        return SPIN_OK;
    }
    name = next_word(s);
    for (*kind = 0; *kind < N_MODELS; ++*kind) {
        if (strcmp(models[*kind].name, name) == 0)
            return SPIN_OK;
    }
    return spin_unsupported("COLMAP does not define the camera model '%.40s'", name);
}

static spin_status read_lens(struct spin_colmap *m, struct source *s, int *id)
{
    double p[MAX_PARAMETERS], width, height;
    int kind;

    SPIN_TRY(spin_grow(m->n_lenses + 1, sizeof *m->lens, (void **)&m->lens));
    memset(&m->lens[m->n_lenses], 0, sizeof *m->lens);
    SPIN_TRY(take_integer(s, "the id", id));
    SPIN_TRY(take_kind(s, &kind));
    SPIN_TRY(take_size(s, "the width", &width));
    SPIN_TRY(take_size(s, "the height", &height));
    for (int i = 0; i < models[kind].n; i++)
        SPIN_TRY(take_real(s, "a parameter", &p[i]));
    return fill_lens(m, *id, kind, width, height, p);
}

/* ---- Images ---------------------------------------------------------------------------------- */

static const struct spin_colmap_lens *find_lens(const struct spin_colmap *m, int id)
{
    for (size_t i = 0; i < m->n_lenses; i++) {
        if (m->lens[i].id == id)
            return &m->lens[i];
    }
    return NULL;
}

/* Sets the pose m [3][4] from a translation t and a quaternion q [w x y z], whose norm may have any
 * value except 0. */
static spin_status fill_pose(const double q[4], const double t[3], double m[12])
{
    double norm = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]), r[9];

    if (!(norm > 1e-12) || !isfinite(norm))
        return spin_malformed("the quaternion %g %g %g %g is not a rotation", q[0], q[1], q[2],
                              q[3]);
    spin_matrix_of_quat(q, r);
    for (int i = 0; i < 3; i++) {
        memcpy(m + 4 * i, r + 3 * i, 3 * sizeof *m);
        m[4 * i + 3] = t[i];
    }
    return spin_views_check_pose(m, "the pose");
}

/* Reads the name of an image: the rest of the line or, in binary files, a NUL-terminated string. In
 * binary files, also skips the points of the image, which follow its name. */
static spin_status take_name(struct source *s, const char **name)
{
    const char *end;
    uint64_t n_points;

    if (!s->binary) {
        *name = s->word + strspn(s->word, " \t");
        return SPIN_OK;
    }
    end = memchr(s->at, '\0', (size_t)(s->end - s->at));
    if (!end || end - s->at > MAX_NAME)
        return spin_malformed("the name of the image is not terminated by a NUL byte");
    SPIN_TRY(read_bytes(s, (size_t)(end - s->at) + 1, name));
    SPIN_TRY(take_count(s, 24, "points of the image", &n_points));
    s->at += 24 * n_points;
    return SPIN_OK;
}

static spin_status read_image(struct spin_colmap *m, struct source *s, int *id)
{
    static const char *const what[] = {"QW", "QX", "QY", "QZ", "TX", "TY", "TZ"};
    struct spin_colmap_image image = {.place = m->n_images};
    const struct spin_colmap_lens *lens;
    const char *name = NULL;

    SPIN_TRY(take_integer(s, "the id", id));
    for (int i = 0; i < 7; i++)
        SPIN_TRY(take_real(s, what[i], i < 4 ? &image.q[i] : &image.t[i - 4]));
    SPIN_TRY(take_integer(s, "the camera's id", &image.lens_id));
    SPIN_TRY(take_name(s, &name));
    lens = find_lens(m, image.lens_id);
    if (!lens)
        return spin_malformed("the image refers to camera %d, which does not exist", image.lens_id);
    if (!spin_views_is_safe_name(name))
        return spin_malformed(
            "the name of the image is '%.80s', expected a path below the folder of images", name);
    image.camera = lens->camera;
    SPIN_TRY(fill_pose(image.q, image.t, image.camera.w2c));
    SPIN_TRY(spin_model_text(m->base, &image.name, "%s", name));
    SPIN_TRY(spin_array_grow(m->n_images, &m->capacity, sizeof *m->image, (void **)&m->image));
    m->image[m->n_images++] = image;
    return SPIN_OK;
}

/* ---- Points ---------------------------------------------------------------------------------- */

/* Reads the id and the position of a point and, if rgb is not NULL, its colour; in binary files,
 * skips the rest of its record. */
static spin_status take_point(struct source *s, int *id, double xyz[3], unsigned char *rgb)
{
    uint64_t bits, n_track;
    const char *rest = NULL;
    int value;

    if (s->binary) {
        SPIN_TRY(take_bits(s, 8, &bits));
        *id = (int)bits;
    } else {
        SPIN_TRY(take_integer(s, "the id", id));
    }
    for (int i = 0; i < 3; i++)
        SPIN_TRY(take_real(s, "a coordinate", &xyz[i]));
    for (int i = 0; i < 3 && rgb && !s->binary; i++) {
        SPIN_TRY(take_integer(s, "a colour", &value));
        rgb[i] = (unsigned char)(value < 0 ? 0 : value > 255 ? 255 : value);
    }
    if (!s->binary)
        return SPIN_OK;
    SPIN_TRY(read_bytes(s, 3 + 8, &rest));
    if (rgb)
        memcpy(rgb, rest, 3);
    SPIN_TRY(take_count(s, 8, "observations of the point", &n_track));
    s->at += 8 * n_track;
    return SPIN_OK;
}

static spin_status keep_point(struct source *s, struct spin_colmap_points *p, int *id)
{
    double xyz[3];
    unsigned char rgb[3];
    size_t capacity = p->capacity;

    SPIN_TRY(take_point(s, id, xyz, rgb));
    SPIN_TRY(spin_array_grow(p->n, &capacity, sizeof *p->xyz, (void **)&p->xyz));
    SPIN_TRY(spin_array_grow(p->n, &p->capacity, sizeof *p->rgb, (void **)&p->rgb));
    memcpy(p->xyz[p->n], xyz, sizeof xyz);
    memcpy(p->rgb[p->n++], rgb, sizeof rgb);
    return SPIN_OK;
}

/* Reads a point. Keeps all points if m->all is set, otherwise a sample of the points with which
 * warn_behind() detects wrong poses. */
static spin_status read_point(struct spin_colmap *m, struct source *s, int *id)
{
    double xyz[3];

    if (m->all)
        return keep_point(s, m->all, id);
    SPIN_TRY(take_point(s, id, xyz, NULL));
    if (m->n_seen++ % m->point_step != 0 || m->n_points == MAX_POINTS)
        return SPIN_OK;
    if (!m->point)
        SPIN_TRY(spin_model_alloc(m->base, MAX_POINTS, sizeof *m->point, (void **)&m->point));
    memcpy(m->point[m->n_points++], xyz, sizeof *m->point);
    return SPIN_OK;
}

/* Warns if all points are behind a camera, since the camera then has OpenGL's axes or a wrong pose.
 */
static void warn_behind(const struct spin_colmap *m)
{
    for (size_t i = 0; i < m->n_images; i++) {
        const double *w = m->image[i].camera.w2c;
        bool behind = m->n_points > 0;

        for (size_t k = 0; k < m->n_points && behind; k++) {
            const double *p = m->point[k];

            behind = w[8] * p[0] + w[9] * p[1] + w[10] * p[2] + w[11] <= 0;
        }
        if (behind) {
            spin_warn("'%s': all points are behind the camera of image '%s': its pose may be "
                      "wrong, or in OpenGL's axes",
                      m->sparse, m->image[i].name);
            return;
        }
    }
}

/* ---- The files ------------------------------------------------------------------------------- */

/* The three files of a model, and how their records are read. */
static const struct kind {
    const char *name, *what, *many;
    size_t smallest; /* smallest size of a record in a binary file, in bytes */
    spin_status (*read)(struct spin_colmap *m, struct source *s, int *id);
    /* True if, in a text file, each record is followed by a line with the points of the image. This
     * line may be empty, and some programs do not write it. */
    bool has_points;
} camera_file = {"cameras", "camera", "cameras", 24 + 3 * 8, read_lens, false},
  image_file = {"images", "image", "images", 4 + 7 * 8 + 4 + 1 + 8, read_image, true},
  point_file = {"points3D", "point", "points", 8 + 3 * 8 + 3 + 8 + 8, read_point, false};

/* Skips the next line if it is empty or contains only numbers, in groups of three. It is then not
 * the record of the next image, which would end with a name. */
static void skip_points_line(struct source *s)
{
    const char *at = s->at;
    size_t n = 0;

    while (at < s->end && *at != '\n') {
        double value;
        char word[64];
        size_t n_word;

        at += strspn(at, " \t\r");
        n_word = strcspn(at, " \t\r\n");
        if (n_word == 0)
            continue;
        snprintf(word, sizeof word, "%.*s", (int)(n_word < sizeof word ? n_word : 1), at);
        if (n_word >= sizeof word || !spin_views_is_number(word, &value))
            return;
        at += n_word;
        n++;
    }
    if (n % 3 == 0)
        next_line(s);
}

static spin_status read_records(struct spin_colmap *m, const struct kind *kind, struct source *s)
{
    uint64_t n = 0;

    if (s->binary)
        SPIN_TRY(take_count(s, kind->smallest, kind->many, &n));
    m->point_step = n / MAX_POINTS + 1;
    for (uint64_t i = 0; s->binary ? i < n : next_line(s); i++) {
        int id = -1;

        if (!s->binary && !is_record(s->word))
            continue;
        SPIN_TRY_IN(kind->read(m, s, &id), "%s %d", kind->what, id);
        if (!s->binary && kind->has_points)
            skip_points_line(s);
    }
    return SPIN_OK;
}

static spin_status read_path(struct spin_colmap *m, const struct kind *kind, const char *path)
{
    struct source s = {.binary = m->binary};
    SPIN_LEAVES(spin_map_close) struct spin_map map = {0};
    SPIN_LEAVES(spin_text_file_close) struct spin_text_file file = {0}; /* parsed in place */

    SPIN_TRY(m->binary ? spin_map_open(path, &map) : spin_text_file_open(path, &file));
    s.at = m->binary ? (char *)map.data : file.text;
    s.end = s.at + (m->binary ? map.size : file.n);
    return spin_fail_context(read_records(m, kind, &s), "cannot read '%s'", path);
}

spin_status spin_colmap_read_points(const char *path, struct spin_colmap_points *out)
{
    struct spin_colmap m = {.binary = spin_text_ends_any_case(path, ".bin"), .all = out};

    return read_path(&m, &point_file, path);
}

/* Reads <name>.bin or <name>.txt of the model. */
static spin_status read_file(struct spin_colmap *m, const struct kind *kind)
{
    const char *path;

    SPIN_TRY(
        spin_model_join(m->base, &path, m->sparse, "%s.%s", kind->name, m->binary ? "bin" : "txt"));
    return read_path(m, kind, path);
}

spin_status spin_colmap_find(struct spin_colmap *m, const char *folder)
{
    static const char *const places[] = {"sparse/0", "sparse", "sparse_", ".", "colmap/sparse/0"};

    for (size_t i = 0; i < sizeof places / sizeof *places; i++) {
        SPIN_TRY(spin_model_join(m->base, &m->sparse, folder, "%s", places[i]));
        m->binary =
            spin_model_holds(m->sparse, "images.bin") && spin_model_holds(m->sparse, "cameras.bin");
        if (m->binary || (spin_model_holds(m->sparse, "images.txt") &&
                          spin_model_holds(m->sparse, "cameras.txt")))
            return SPIN_OK;
    }
    m->sparse = NULL;
    return SPIN_OK;
}

/* Compares names without their extensions, since training programs sort images in this way before
 * they choose the held-out ones. */
static int by_name(const void *a, const void *b)
{
    const char *x = ((const struct spin_colmap_image *)a)->name,
               *y = ((const struct spin_colmap_image *)b)->name;
    const char *x_end = strrchr(x, '.'), *y_end = strrchr(y, '.');
    size_t n_x = x_end ? (size_t)(x_end - x) : strlen(x);
    size_t n_y = y_end ? (size_t)(y_end - y) : strlen(y);
    int order = memcmp(x, y, n_x < n_y ? n_x : n_y);

    if (order == 0)
        order = n_x < n_y ? -1 : n_x > n_y;
    return order ? order : strcmp(x, y);
}

spin_status spin_colmap_read(struct spin_colmap *m)
{
    SPIN_TRY(read_file(m, &camera_file));
    SPIN_TRY(read_file(m, &image_file));
    if (m->n_images == 0)
        return spin_malformed("'%s' has no images", m->sparse);
    if (m->n_images > INT_MAX)
        return spin_unsupported("'%s' has 2^31 or more images", m->sparse);
    if (spin_model_holds(m->sparse, m->binary ? "points3D.bin" : "points3D.txt"))
        SPIN_TRY(read_file(m, &point_file));
    warn_behind(m);
    qsort(m->image, m->n_images, sizeof *m->image, by_name);
    for (size_t i = 1; i < m->n_images; i++) {
        if (strcmp(m->image[i].name, m->image[i - 1].name) == 0)
            return spin_malformed("'%s' has two images called '%s'", m->sparse, m->image[i].name);
    }
    return SPIN_OK;
}
