/* Data sets that are a sparse model of COLMAP with undistorted images, in one of three layouts.
 *
 *     sparse/0/{cameras,images,points3D}.{bin,txt}, images/
 *         one model; each image is one frame
 *     the same, images/<camera>/<number>.png ...
 *         FreeTimeGS: each image of the model is a camera, with its frames in the folder of that
 *         name
 *     frame000001/{sparse/0, images}, frame000002/...
 *         3DGStream: one folder per frame; the model of the first folder is used for all frames
 *
 * Binary files are little-endian and packed; they are preferred to text files, as in the methods.
 * A pose is w2c in OpenCV's axes: R(q) p + t.
 *
 * The principal point of the file is kept. The methods' own readers move it to the image centre, as
 * option `principal` with the value centre does. Only pinhole cameras can be rendered: images of a
 * model with nonzero distortion must be undistorted first.
 *
 * Times and held-out views depend on the layout. In the first, image i of n in the file is at time
 * i/n, as in 4DGaussians, which reads such a data set as a video of one camera, and every eighth
 * image in the order of names is held out, as by 3DGS's --eval. In the second, frame k of n is at
 * k/(n-1), and every eighth camera is held out. In the third, each image of the model is a camera
 * of every frame, times are 0, 1, 2, ..., and the first camera is held out, as in 3DGStream. */
#include "importers/lib/model.h"
#include "importers/lib/views_rig.h"
#include "io/numbered.h"
#include "io/text_file.h"
#include "math/covariance.h"

enum { MAX_PARAMETERS = 16, MAX_NAME = 4096, MAX_POINTS = 1000 };

struct lens {
    int id;
    struct spin_camera camera; /* intrinsics; the pose is not set */
};

struct image {
    const char *name;
    double q[4], t[3];
    int lens_id;
    size_t place; /* index of the image in the file */
    struct spin_camera camera;
};

/* A sparse model: pinhole cameras with their poses. */
struct colmap {
    struct spin_model base;
    const char *images; /* name of the folder of images */
    bool by_name;       /* times follow the order of the images' names; false: that of the file */
    bool numbered;      /* the names of all images have numbers */
    bool centre;        /* move principal points to the image centre */
    int hold; /* hold out every hold-th image or camera; 0: none; -1: the default of the layout */
    const char *sparse; /* folder of the model's files */
    const char *folder; /* folder of the images that belong to the model */
    bool binary;
    struct lens *lens;
    size_t n_lenses;
    struct image *image; /* sorted by name */
    size_t n_images, capacity;
    double (*point)[3]; /* [n_points] a sample of the model's points: every point_step-th */
    size_t n_points;
    uint64_t point_step, n_seen; /* n_seen: number of points read so far */
};

/* ---- Recognising ----------------------------------------------------------------------------- */

static int probe(const struct spin_peek *peek)
{
    bool frames = false;

    if (spin_peek_has(peek, "sparse"))
        return 100;
    for (size_t i = 0; peek->is_folder && peek->names && peek->names[i]; i++)
        frames = frames || spin_frame_number(peek->names[i]) >= 0;
    return frames ? 50 : 0;
}

/* Camera models: the number n of parameters and the indices of fx, fy, cx and cy. Parameters from
 * index `distortion` on must be 0; `distortion` is -1 for models that are never pinhole cameras. */
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

static spin_status take(struct source *s, size_t n, const char **out)
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

    SPIN_TRY(take(s, n, &p));
    *out = 0;
    for (size_t i = n; i-- > 0;)
        *out = *out << 8 | (unsigned char)p[i];
    return SPIN_OK;
}

/* Reads a count of records and checks that the rest of the file can hold them, at `smallest` bytes
 * each. */
static spin_status take_count(struct source *s, size_t smallest, const char *what, uint64_t *out)
{
    SPIN_TRY(take_bits(s, 8, out));
    if (*out > (uint64_t)(s->end - s->at) / smallest)
        return spin_malformed(
            "its header announces %llu %s, more than fit into the remaining %zu bytes",
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

static spin_status fill_lens(struct colmap *m, int id, int kind, double width, double height,
                             const double *p)
{
    struct spin_camera *c = &m->lens[m->n_lenses].camera;

    for (size_t i = 0; i < m->n_lenses; i++) {
        if (m->lens[i].id == id)
            return spin_malformed("there are two cameras with id %d", id);
    }
    SPIN_TRY(spin_views_check_size(width, height));
    if (models[kind].distortion < 0)
        return spin_unsupported("its model %s is not a pinhole camera: undistort the images",
                                models[kind].name);
    for (int i = models[kind].distortion; i < models[kind].n; i++) {
        if (p[i] != 0)
            return spin_unsupported("its model %s has a distortion of %g: undistort the images",
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
            return spin_unsupported("its model is number %d, which is not known", *kind);
        return SPIN_OK;
    }
    name = next_word(s);
    for (*kind = 0; *kind < N_MODELS; ++*kind) {
        if (strcmp(models[*kind].name, name) == 0)
            return SPIN_OK;
    }
    return spin_unsupported("its model is '%.40s', which is not known", name);
}

static spin_status read_lens(struct colmap *m, struct source *s, int *id)
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

static const struct lens *find_lens(const struct colmap *m, int id)
{
    for (size_t i = 0; i < m->n_lenses; i++) {
        if (m->lens[i].id == id)
            return &m->lens[i];
    }
    return NULL;
}

/* Sets the pose from a translation and a quaternion w, x, y, z of any nonzero length. */
static spin_status fill_pose(const double q[4], const double t[3], double m[12])
{
    double norm = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]), r[9];

    if (!(norm > 1e-12) || !isfinite(norm))
        return spin_malformed("its quaternion %g %g %g %g is not a rotation", q[0], q[1], q[2],
                              q[3]);
    spin_matrix_of_quat(q, r);
    for (int i = 0; i < 3; i++) {
        memcpy(m + 4 * i, r + 3 * i, 3 * sizeof *m);
        m[4 * i + 3] = t[i];
    }
    return spin_views_check_pose(m, "the pose");
}

/* Reads the name of an image: the rest of the line or, in binary files, a text that ends with 0. In
 * binary files, also skips the points of the image, which follow. */
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
        return spin_malformed("its name is not terminated");
    SPIN_TRY(take(s, (size_t)(end - s->at) + 1, name));
    SPIN_TRY(take_count(s, 24, "points of the image", &n_points));
    s->at += 24 * n_points;
    return SPIN_OK;
}

static spin_status read_image(struct colmap *m, struct source *s, int *id)
{
    static const char *const what[] = {"QW", "QX", "QY", "QZ", "TX", "TY", "TZ"};
    struct image image = {.place = m->n_images};
    const struct lens *lens;
    const char *name = NULL;

    SPIN_TRY(take_integer(s, "the id", id));
    for (int i = 0; i < 7; i++)
        SPIN_TRY(take_real(s, what[i], i < 4 ? &image.q[i] : &image.t[i - 4]));
    SPIN_TRY(take_integer(s, "the camera's id", &image.lens_id));
    SPIN_TRY(take_name(s, &name));
    lens = find_lens(m, image.lens_id);
    if (!lens)
        return spin_malformed("there is no camera %d", image.lens_id);
    SPIN_TRY(spin_model_name(&m->base, m->folder, name, &image.name));
    if (!spin_views_is_safe_name(image.name))
        return spin_malformed("its name is '%.80s', expected a path below the folder of images",
                              image.name);
    image.camera = lens->camera;
    SPIN_TRY(fill_pose(image.q, image.t, image.camera.w2c));
    SPIN_TRY(spin_array_grow(m->n_images, &m->capacity, sizeof *m->image, (void **)&m->image));
    m->image[m->n_images++] = image;
    return SPIN_OK;
}

/* ---- Points ---------------------------------------------------------------------------------- */

/* Reads a point, and keeps it if it belongs to the sample with which warn_behind() detects wrong
 * poses. */
static spin_status read_point(struct colmap *m, struct source *s, int *id)
{
    uint64_t bits, n_track;
    const char *rest = NULL;
    double xyz[3];

    if (s->binary) {
        SPIN_TRY(take_bits(s, 8, &bits));
        *id = (int)bits;
    } else {
        SPIN_TRY(take_integer(s, "the id", id));
    }
    for (int i = 0; i < 3; i++)
        SPIN_TRY(take_real(s, "a coordinate", &xyz[i]));
    if (s->binary) {
        SPIN_TRY(take(s, 3 + 8, &rest));
        SPIN_TRY(take_count(s, 8, "places of a point", &n_track));
        s->at += 8 * n_track;
    }
    if (m->n_seen++ % m->point_step != 0 || m->n_points == MAX_POINTS)
        return SPIN_OK;
    if (!m->point)
        SPIN_TRY(spin_model_alloc(&m->base, MAX_POINTS, sizeof *m->point, (void **)&m->point));
    memcpy(m->point[m->n_points++], xyz, sizeof *m->point);
    return SPIN_OK;
}

/* Warns if all points are behind a camera, since the camera then has OpenGL's axes or a wrong pose.
 */
static void warn_behind(const struct colmap *m)
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
    spin_status (*read)(struct colmap *m, struct source *s, int *id);
    /* Lines per record in a text file. The second line of an image has the points of the image and
     * may be empty. */
    int lines;
} camera_file = {"cameras", "camera", "cameras", 24 + 3 * 8, read_lens, 1},
  image_file = {"images", "image", "images", 4 + 7 * 8 + 4 + 1 + 8, read_image, 2},
  point_file = {"points3D", "point", "points", 8 + 3 * 8 + 3 + 8 + 8, read_point, 1};

static spin_status read_records(struct colmap *m, const struct kind *kind, struct source *s)
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
        if (!s->binary && kind->lines == 2)
            next_line(s);
    }
    return SPIN_OK;
}

/* Reads <name>.bin or <name>.txt of the model. */
static spin_status read_file(struct colmap *m, const struct kind *kind)
{
    struct source s = {.binary = m->binary};
    SPIN_LEAVES(spin_map_close) struct spin_map map = {0};
    SPIN_LEAVES(spin_text_file_close) struct spin_text_file file = {0}; /* it is split in place */
    const char *path;

    SPIN_TRY(spin_model_join(&m->base, &path, m->sparse, "%s.%s", kind->name,
                             m->binary ? "bin" : "txt"));
    SPIN_TRY(m->binary ? spin_map_open(path, &map) : spin_text_file_open(path, &file));
    s.at = m->binary ? (char *)map.data : file.text;
    s.end = s.at + (m->binary ? map.size : file.n);
    return spin_fail_context(read_records(m, kind, &s), "cannot read '%s'", path);
}

/* Sets m->sparse to the subfolder sparse/0 or sparse of a folder, whichever contains the model. */
static spin_status find_sparse(struct colmap *m, const char *folder)
{
    static const char *const places[] = {"sparse/0", "sparse"};

    for (int i = 0; i < 2; i++) {
        SPIN_TRY(spin_model_join(&m->base, &m->sparse, folder, "%s", places[i]));
        m->binary = spin_model_holds(m->sparse, "images.bin");
        if (m->binary || spin_model_holds(m->sparse, "images.txt"))
            return SPIN_OK;
    }
    return spin_not_found("'%s' has neither images.bin nor images.txt in 'sparse/0' or 'sparse'",
                          folder);
}

/* Compares names without their extensions, since the methods choose held-out images in this order.
 */
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

/* Reads the model in the subfolder sparse/0 or sparse of a folder. Warns if all points are behind a
 * camera. */
static spin_status read_model(struct colmap *m, const char *folder)
{
    SPIN_TRY(find_sparse(m, folder));
    SPIN_TRY(spin_model_join(&m->base, &m->folder, folder, "%s", m->images));
    SPIN_TRY(read_file(m, &camera_file));
    SPIN_TRY(read_file(m, &image_file));
    if (m->n_images == 0)
        return spin_malformed("'%s' has no images", m->sparse);
    if (m->n_images > INT_MAX)
        return spin_unsupported("'%s' has too many images", m->sparse);
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

/* ---- Folders of frames ----------------------------------------------------------------------- */

/* Returns the length of the part of an image's name that is the name of its camera: the folder or,
 * if there is none, the name without its extension. */
static size_t camera_part(const char *name)
{
    const char *end = strrchr(name, '/');

    if (!end)
        end = strrchr(name, '.');
    return end ? (size_t)(end - name) : strlen(name);
}

static spin_status has_frames(const char *folder, bool *out)
{
    char **names = NULL;
    size_t n_names = 0, n_frames = 0;

    *out = false;
    if (!spin_path_is_folder(folder))
        return SPIN_OK;
    SPIN_TRY(spin_folder_list(folder, &names, &n_names));
    for (size_t k = 0; k < n_names; k++)
        n_frames += names[k][0] != '.' && spin_name_has_number(names[k]);
    spin_folder_list_free(names);
    *out = n_frames > 1;
    return SPIN_OK;
}

/* Sets c[i].where to the folder of each camera's frames. In a data set of FreeTimeGS, each image of
 * the model is a camera, whose frames are in the folder of the image or in a folder with the name
 * of the image. Sets *found to whether all these folders exist and contain frames. */
static spin_status find_folders(struct colmap *m, const char *images, struct spin_rig_camera *c,
                                bool *found)
{
    *found = true;
    for (size_t i = 0; i < m->n_images && *found; i++) {
        SPIN_TRY(spin_model_join(&m->base, &c[i].where, images, "%s", c[i].name));
        SPIN_TRY(has_frames(c[i].where, found));
    }
    return SPIN_OK;
}

/* To be called if the folders of frames are not named like the cameras. If there are as many such
 * folders as cameras, assigns folders to cameras, both in the order of names, and sets *found. */
static spin_status pair_folders(struct colmap *m, const char *images, struct spin_rig_camera *c,
                                bool *found)
{
    char **names;
    size_t n, n_cameras = 0;
    const char *folder;
    bool has;

    *found = false;
    if (!spin_path_is_folder(images) || spin_model_holds(images, m->image[0].name))
        return SPIN_OK;
    SPIN_TRY(spin_model_names(&m->base, images, &names, &n));
    for (size_t i = 0; i < n; i++) {
        SPIN_TRY(spin_model_join(&m->base, &folder, images, "%s", names[i]));
        SPIN_TRY(has_frames(folder, &has));
        if (has && n_cameras < m->n_images)
            c[n_cameras].where = folder;
        n_cameras += has;
    }
    *found = n_cameras == m->n_images;
    if (*found)
        spin_warn("'%s': the folders of frames are not named like the cameras of the model: '%s' "
                  "is used for '%s', and so on in the order of their names",
                  images, spin_path_name(c[0].where), c[0].name);
    return SPIN_OK;
}

/* Sets *out to the cameras, each with its folder of frames, or to NULL if there are no such folders
 * and each image of the model is a frame. */
static spin_status find_rig(struct colmap *m, const char *images, struct spin_rig_camera **out)
{
    struct spin_rig_camera *c;
    bool found;

    *out = NULL;
    SPIN_TRY(spin_model_alloc(&m->base, m->n_images, sizeof *c, (void **)&c));
    for (size_t i = 0; i < m->n_images; i++) {
        const char *name = m->image[i].name;

        c[i].camera = m->image[i].camera;
        SPIN_TRY(spin_model_text(&m->base, &c[i].name, "%.*s", (int)camera_part(name), name));
    }
    if (spin_rig_sort(m->sparse, c, m->n_images) != SPIN_OK)
        return SPIN_OK; /* two cameras have the same name: a folder contains several images of the
                           model */
    SPIN_TRY(find_folders(m, images, c, &found));
    if (!found)
        SPIN_TRY(pair_folders(m, images, c, &found));
    if (found)
        *out = c;
    return SPIN_OK;
}

static spin_status read_manifest(void *model, const spin_json *root, struct spin_views *out)
{
    spin_rig_note(model, spin_json_get(root, "fps"), out);
    return SPIN_OK;
}

static spin_status read_rig(struct colmap *m, struct spin_rig_camera *c, const char *path,
                            struct spin_views *out)
{
    bool found;

    for (size_t i = 0; i < m->n_images; i++)
        SPIN_TRY(spin_rig_pictures(&m->base, &c[i], c[i].where));
    SPIN_TRY(spin_rig_views(&m->base, c, m->n_images, out));
    SPIN_TRY(spin_views_read_json(path, "manifest.json", read_manifest, &m->base, out, &found));
    if (!found)
        spin_rig_note(&m->base, NULL, out);
    return SPIN_OK;
}

/* ---- Views ----------------------------------------------------------------------------------- */

/* Sets *out to the number in the name of each image, or to NULL if the names have no numbers. */
static spin_status image_numbers(struct colmap *m, int **out)
{
    SPIN_LEAVES(spin_numbers_free) struct spin_numbers numbers = {0};
    const char **name;
    spin_status status;

    *out = NULL;
    SPIN_TRY(spin_model_alloc(&m->base, m->n_images, sizeof *name, (void **)&name));
    for (size_t i = 0; i < m->n_images; i++)
        name[i] = spin_path_name(m->image[i].name);
    status = spin_numbered_read(&(struct spin_numbering){.name = name, .n = m->n_images}, &numbers);
    if (status != SPIN_OK || numbers.number[0] < 0)
        return status == SPIN_E_MEMORY ? status : SPIN_OK;
    SPIN_TRY(spin_model_alloc(&m->base, m->n_images, sizeof **out, (void **)out));
    memcpy(*out, numbers.number, m->n_images * sizeof **out);
    return SPIN_OK;
}

/* Sets *out to the camera id of each image: the number in its name or, if the names have no
 * numbers, its index in the order of names. */
static spin_status camera_ids(struct colmap *m, int **out)
{
    SPIN_TRY(image_numbers(m, out));
    m->numbered = *out != NULL;
    if (m->numbered)
        return SPIN_OK;
    SPIN_TRY(spin_model_alloc(&m->base, m->n_images, sizeof **out, (void **)out));
    for (size_t i = 0; i < m->n_images; i++)
        (*out)[i] = (int)i;
    return SPIN_OK;
}

/* Adds a view for each image of the model; the image files are below `folder`. All views belong to
 * frame `row` of the data set or, if `row` is negative, each to a frame of its own. */
static spin_status add_views(struct colmap *m, const char *folder, const int *ids, int row,
                             int number, struct spin_views *out)
{
    const char *images, *path;

    SPIN_TRY(spin_model_join(&m->base, &images, folder, "%s", m->images));
    for (size_t i = 0; i < m->n_images; i++) {
        const struct image *image = &m->image[i];
        size_t place = m->by_name ? i : image->place;
        struct spin_view view = {.camera = image->camera, .camera_id = ids[i]};

        view.dataset_frame = row < 0 ? (int)place : row;
        view.number = row >= 0 ? number : m->numbered ? ids[i] : -1;
        view.time = row < 0 ? (double)place / (double)m->n_images : row;
        view.test = m->hold < 0    ? (row < 0 ? i % 8 == 0 : i == 0)
                    : m->hold == 0 ? false
                                   : i % (size_t)m->hold == 0;
        SPIN_TRY(spin_model_join(&m->base, &path, images, "%s", image->name));
        view.path = (char *)path;
        SPIN_TRY(spin_views_add(out, &view));
    }
    return SPIN_OK;
}

/* Checks that all images exist, and scales each camera to the size of its image in the first frame.
 */
static spin_status fit_views(const struct colmap *m, struct spin_views *out, size_t first)
{
    SPIN_TRY(spin_views_check_images(out, first));
    for (size_t i = 0; i < m->n_images; i++)
        SPIN_TRY(spin_views_fit_image(&out->view[first + i].camera, out->view[first + i].path));
    for (size_t i = first + m->n_images; i < out->n; i++)
        out->view[i].camera = out->view[i - m->n_images].camera;
    return SPIN_OK;
}

static int by_frame_number(const void *a, const void *b)
{
    int x = spin_frame_number(*(char *const *)a), y = spin_frame_number(*(char *const *)b);

    return x < y ? -1 : x > y;
}

/* Reads the folders frame<digits> in the order of their numbers. The first one contains the model.
 */
static spin_status read_frames(struct colmap *m, const char *path, struct spin_views *out)
{
    const char *folder;
    char **names;
    int *ids = NULL;
    size_t n, kept = 0, first = out->n;

    SPIN_TRY(spin_model_names(&m->base, path, &names, &n));
    for (size_t i = 0; i < n; i++) {
        if (spin_frame_number(names[i]) >= 0)
            names[kept++] = names[i];
    }
    qsort(names, kept, sizeof *names, by_frame_number);
    for (size_t i = 1; i < kept; i++) {
        if (spin_frame_number(names[i]) == spin_frame_number(names[i - 1]))
            return spin_malformed("'%s' and '%s' are both frame %d", names[i - 1], names[i],
                                  spin_frame_number(names[i]));
    }
    if (spin_model_option(&m->base, "time"))
        return spin_misuse("option 'time' applies to a single model, not to frame folders");
    if (kept == 0)
        return spin_not_found("'%s' has neither 'sparse' nor frame folders", path);
    for (size_t f = 0; f < kept; f++) {
        SPIN_TRY(spin_model_join(&m->base, &folder, path, "%s", names[f]));
        if (f == 0) {
            SPIN_TRY(read_model(m, folder));
            SPIN_TRY(camera_ids(m, &ids));
        }
        SPIN_TRY(add_views(m, folder, ids, (int)f, spin_frame_number(names[f]), out));
    }
    return fit_views(m, out, first);
}

static spin_status read_one(struct colmap *m, const char *path, struct spin_views *out)
{
    struct spin_rig_camera *rig;
    const char *images;
    size_t first = out->n;
    int *ids, rule;

    SPIN_TRY(read_model(m, path));
    SPIN_TRY(spin_model_join(&m->base, &images, path, "%s", m->images));
    SPIN_TRY(find_rig(m, images, &rig));
    if (rig)
        return read_rig(m, rig, path, out);
    SPIN_TRY(spin_option_word(m->base.values, "time", "file|name", &rule));
    m->by_name = rule == 1;
    SPIN_TRY(camera_ids(m, &ids));
    SPIN_TRY(add_views(m, path, ids, -1, -1, out));
    return fit_views(m, out, first);
}

static spin_status read_options(struct colmap *m)
{
    const struct spin_plugin_values *values = m->base.values;
    int rule;

    m->images = spin_plugin_value(values, "images", "images");
    if (!spin_views_is_safe_name(m->images))
        return spin_misuse("option 'images' is '%s', expected a folder's name", m->images);
    SPIN_TRY(spin_option_word(values, "principal", "file|centre", &rule));
    m->centre = rule == 1;
    m->hold = -1;
    return spin_option_count(values, "hold", 0, INT_MAX, &m->hold);
}

static spin_status read_set(struct colmap *m, const char *path, struct spin_views *out)
{
    const char *sparse;

    SPIN_TRY(read_options(m));
    SPIN_TRY(spin_model_join(&m->base, &sparse, path, "sparse"));
    return spin_path_is_folder(sparse) ? read_one(m, path, out) : read_frames(m, path, out);
}

static spin_status colmap_views(const char *path, const struct spin_plugin_values *values,
                                struct spin_views *out)
{
    struct colmap m = {.base.values = values};
    spin_status status = read_set(&m, path, out);

    free(m.image);
    free(m.lens);
    spin_model_clear(&m.base);
    return status;
}

static const struct spin_plugin_option options[] = {
    {"images", "FOLDER", "the folder of the images, such as images_2", "images"},
    {"time", "RULE",
     "single model: order of the images, at times i/n, as in the file (file) or by name (name); "
     "FreeTimeGS: unit for i/(n-1), count for i/n, row for i, a number N for i/N (default: file; "
     "for FreeTimeGS: unit)",
     NULL},
    {"hold", "N",
     "hold out every N-th image or camera by name, including the first; 0: none (default: 8; with "
     "frame folders: only the first camera)",
     NULL},
    {"principal", "RULE", "principal point: file, or centre as in the methods' readers", "file"},
    {NULL, NULL, NULL, NULL},
};

const struct spin_importer spin_importer_views_colmap = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "colmap",
    .summary = "views: COLMAP's sparse model and undistorted images; folders per frame, or per "
               "camera (FreeTimeGS)",
    .upstream = "hustvl/4DGaussians scene/colmap_loader.py, SJoJoK/3DGStream 747ddfe",
    .options = options,
    .probe = probe,
    .views = colmap_views,
};
