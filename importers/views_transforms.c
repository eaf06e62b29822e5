/* Data sets of D-NeRF (Blender), n3v2blender.py and nerfstudio: JSON files with cameras, and
 * images.
 *
 *     transforms_train.json  transforms_test.json, or only transforms.json
 *         camera_angle_x | fl_x fl_y cx cy    for all frames; may also be members of a frame
 *         w, h                                for all frames; may also be members of a frame
 *         frames[]: file_path, transform_matrix (c2w, OpenGL's axes), time
 *
 * Values of a frame override those for all frames, and focal lengths override camera_angle_x. The
 * frames of the data set are the distinct times of both files. All images of a file are of one
 * moving camera, unless their names contain the word cam<NN>. For transforms.json, the number that
 * differs between the names of images with the same time also identifies the camera. When images
 * with alpha are read, they are composited over the colour of --background; D-NeRF's own training
 * uses white.
 *
 * transforms.json contains all images. Those in its lists test_filenames and val_filenames are held
 * out. Without lists, the first camera is held out if there are several cameras and times;
 * otherwise every 8th image is. Without times, every image is a camera of its own. Poses are used
 * as stored: applied_transform is already part of them, and nerfstudio's own centring is left out.
 *
 * 4DGaussians negates the translation of the inverse OpenGL matrix, which gives the translation's x
 * the wrong sign unless the camera's right axis is perpendicular to its position. Option `pose`
 * with the value 4dgaussians reproduces this, for models that were trained on such cameras. */
#include <unistd.h>

#include "importers/lib/model.h"
#include "importers/lib/views_check.h"
#include "io/numbered.h"

enum time_rule { TIME_FILE, TIME_MAX, TIME_UNIT };

struct options {
    const char *test_file, *ending;
    enum time_rule time;
    bool old_pose; /* option `pose` is 4dgaussians */
    int hold;      /* hold out every hold-th image of transforms.json; 0: none; -1: the default */
};

/* One of the JSON files. */
struct split {
    struct spin_model *m; /* m->path: the folder of the data set */
    const struct options *options;
    const spin_json *root; /* valid while the file is read */
    int id;                /* camera id of images that are not named cam<NN>, unless `all` */
    bool test;             /* all images of the file are held out */
    bool all;              /* the file is transforms.json */
    /* For transforms.json. has_lists: it contains lists of held-out images; timed: a frame has a
     * time. */
    bool has_lists, timed;
};

/* ---- Recognising ----------------------------------------------------------------------------- */

#define TRAIN "transforms_train.json"
#define ALL "transforms.json"

static int probe(const struct spin_peek *peek)
{
    if (spin_peek_has(peek, TRAIN))
        return 90;
    /* Some tools add this file to data sets of other formats. */
    return spin_peek_has(peek, ALL) ? 60 : 0;
}

/* ---- One camera ------------------------------------------------------------------------------ */

/* Reads the number `key` of the frame or, if the frame has none, of the file. Sets *found to
 * whether the key exists. A value that is not a number is an error. */
static spin_status read_number(const struct split *s, const spin_json *frame, const char *key,
                               double *out, bool *found)
{
    const spin_json *value = spin_json_get(frame, key);

    if (!value)
        value = spin_json_get(s->root, key);
    *found = value != NULL;
    if (value && (!spin_json_number(value, out) || !isfinite(*out)))
        return spin_malformed("'%s' is not a number", key);
    return SPIN_OK;
}

/* Refuses distortion: only pinhole cameras can be rendered. */
static spin_status check_lens(const struct split *s, const spin_json *frame)
{
    static const char *const names[] = {"k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2"};
    const char *model = spin_json_string(spin_json_get(frame, "camera_model"));
    double value;
    bool found;

    for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
        SPIN_TRY(read_number(s, frame, names[i], &value, &found));
        if (found && value != 0)
            return spin_unsupported(
                "'%s' is %g: images with lens distortion must be undistorted first", names[i],
                value);
    }
    if (!model)
        model = spin_json_string(spin_json_get(s->root, "camera_model"));
    if (model && strcmp(model, "OPENCV") != 0 && strcmp(model, "PINHOLE") != 0 &&
        strcmp(model, "SIMPLE_PINHOLE") != 0 && strcmp(model, "perspective") != 0)
        return spin_unsupported(
            "'camera_model' is '%s', expected a pinhole camera: undistort the images first", model);
    return SPIN_OK;
}

/* Reads the image size from w and h or, without them, from the image. For the first frame, and for
 * frames with their own w and h, the image must have the size that w and h state. */
static spin_status read_size(const struct split *s, const spin_json *frame, size_t index,
                             const char *path, struct spin_camera *camera)
{
    int width, height, channels;
    bool has_w, has_h;
    double w, h;

    SPIN_TRY(read_number(s, frame, "w", &w, &has_w));
    SPIN_TRY(read_number(s, frame, "h", &h, &has_h));
    if (has_w != has_h)
        return spin_malformed("there is no number '%s'", has_w ? "h" : "w");
    if (has_w) {
        SPIN_TRY(spin_views_size(w, h, camera));
        if (index > 0 && !spin_json_get(frame, "w") && !spin_json_get(frame, "h"))
            return SPIN_OK;
    }
    SPIN_TRY(spin_image_size(path, &width, &height, &channels));
    if (has_w && (width != camera->width || height != camera->height))
        return spin_malformed("image '%s' has %d x %d pixels, but 'w' and 'h' are %d and %d", path,
                              width, height, camera->width, camera->height);
    camera->width = width;
    camera->height = height;
    return SPIN_OK;
}

static spin_status read_intrinsics(const struct split *s, const spin_json *frame,
                                   struct spin_camera *camera)
{
    static const char *const names[] = {"fl_x", "fl_y", "cx", "cy"};
    double *const values[] = {&camera->fx, &camera->fy, &camera->cx, &camera->cy};
    bool found[4], has_angle;
    double angle;

    for (int i = 0; i < 4; i++)
        SPIN_TRY(read_number(s, frame, names[i], values[i], &found[i]));
    SPIN_TRY(read_number(s, frame, "camera_angle_x", &angle, &has_angle));
    if (!found[0] && !has_angle)
        return spin_malformed("there is neither 'fl_x' nor 'camera_angle_x'");
    if (!found[0]) {
        if (!(angle > 0 && angle < M_PI))
            return spin_malformed("'camera_angle_x' is %g, expected 0 to pi", angle);
        camera->fx = camera->width / (2 * tan(angle / 2));
    }
    if (!found[1] || !found[0])
        camera->fy = camera->fx;
    if (!found[2])
        camera->cx = camera->width / 2.0;
    if (!found[3])
        camera->cy = camera->height / 2.0;
    return spin_views_check_intrinsics(camera);
}

/* Converts c2w from OpenGL's axes to OpenCV's by negating y and z. */
static spin_status read_pose(const struct split *s, const spin_json *frame,
                             struct spin_camera *camera)
{
    const spin_json *m = spin_json_get(frame, "transform_matrix");
    double c2w[16];

    if (!m)
        return spin_malformed("there is no 'transform_matrix'");
    SPIN_TRY(spin_views_matrix(m, "transform_matrix", 4, c2w));
    for (int i = 0; i < 3; i++) {
        c2w[4 * i + 1] = -c2w[4 * i + 1];
        c2w[4 * i + 2] = -c2w[4 * i + 2];
    }
    SPIN_TRY(spin_views_check_pose(c2w, "'transform_matrix'"));
    spin_views_invert(c2w, camera->w2c);
    if (s->options->old_pose)
        camera->w2c[3] = -camera->w2c[3];
    return SPIN_OK;
}

/* ---- One frame ------------------------------------------------------------------------------- */

/* Sets *out to the path of the image `name` or, if there is no such file, to this path followed by
 * the extension in option `ending`. */
static spin_status find_image(const struct split *s, const char *name, char **out)
{
    const char *path;

    SPIN_TRY(spin_model_join(s->m, &path, s->m->path, "%s", name));
    if (!spin_path_exists(path) || spin_path_is_folder(path))
        SPIN_TRY(spin_model_join(s->m, &path, s->m->path, "%s%s", name, s->options->ending));
    *out = (char *)path;
    return SPIN_OK;
}

static const char *without_dot(const char *name)
{
    while (name && (strncmp(name, "./", 2) == 0 || strncmp(name, ".\\", 2) == 0))
        name += 2;
    return name;
}

/* Whether two names are equal, with '\\' equal to '/'. */
static bool same_name(const char *a, const char *b)
{
    while (*a && (*a == *b || (strchr("/\\", *a) && *b && strchr("/\\", *b)))) {
        a++;
        b++;
    }
    return *a == *b;
}

/* Whether the file is transforms.json and its list `key` contains the image. Sets s->has_lists if
 * this list is not empty. */
static bool lists_image(struct split *s, const char *key, const char *name)
{
    const spin_json *list = spin_json_get(s->root, key);
    bool found = false;

    for (size_t i = 0; i < spin_json_length(list) && s->all; i++) {
        const char *other = without_dot(spin_json_string(spin_json_at(list, i)));

        found = found || (other && same_name(other, name));
        s->has_lists = true;
    }
    return found;
}

static spin_status fill_view(struct split *s, const spin_json *frame, size_t index,
                             struct spin_view *view)
{
    const char *name = without_dot(spin_json_string(spin_json_get(frame, "file_path")));
    const spin_json *time = spin_json_get(frame, "time");

    if (!name)
        return spin_malformed("'file_path' is missing or not a string");
    SPIN_TRY(spin_model_name(s->m, s->m->path, name, &name));
    name = without_dot(name);
    if (!spin_views_is_safe_name(name))
        return spin_malformed(
            "'file_path' is '%s', expected a path below the folder of the data set", name);
    if (time && (!spin_json_number(time, &view->time) || !isfinite(view->time)))
        return spin_malformed("'time' is not a number");
    s->timed = s->timed || time;
    view->camera_id = spin_camera_number(name);
    if (view->camera_id < 0 && !s->all)
        view->camera_id = s->id;
    view->test = s->test;
    if (lists_image(s, "test_filenames", name) || lists_image(s, "val_filenames", name))
        view->test = true;
    SPIN_TRY(find_image(s, name, &view->path));
    if (access(view->path, R_OK) != 0)
        return SPIN_OK; /* read_set() counts the missing images and leaves them out */
    SPIN_TRY(check_lens(s, frame));
    SPIN_TRY(read_size(s, frame, index, view->path, &view->camera));
    SPIN_TRY(read_intrinsics(s, frame, &view->camera));
    return read_pose(s, frame, &view->camera);
}

static spin_status read_frames(void *split, const spin_json *root, struct spin_views *out)
{
    struct split *s = split;
    const spin_json *frames = spin_json_get(root, "frames");
    size_t n = spin_json_length(frames);

    s->root = root;
    if (!frames || !spin_json_is_array(frames))
        return spin_malformed("there is no list 'frames'");
    if (n == 0)
        return spin_malformed("list 'frames' is empty");
    for (size_t i = 0; i < n; i++) {
        struct spin_view view = {.number = -1};

        SPIN_TRY_IN(fill_view(s, spin_json_at(frames, i), i, &view), "frame %zu", i);
        SPIN_TRY(spin_views_add(out, &view));
    }
    return SPIN_OK;
}

/* ---- Frames and times ------------------------------------------------------------------------ */

/* Times belong to the same frame if they differ by at most this fraction of the range of all times,
 * since files are written with six digits. */
#define SAME_TIME 1e-6

/* Sets dataset_frame of each view to the index of its time among the distinct times of all views,
 * then scales the times as option `time` states. */
static spin_status set_rows(struct spin_model *m, struct spin_views *views, size_t first,
                            enum time_rule rule)
{
    size_t n = views->n - first, n_rows = 0;
    struct spin_view *view = views->view + first;
    double *times = NULL, low, high, scale;

    SPIN_TRY(spin_model_alloc(m, n, sizeof *times, (void **)&times));
    for (size_t i = 0; i < n; i++)
        times[i] = view[i].time;
    qsort(times, n, sizeof *times, spin_by_double);
    low = times[0];
    high = times[n - 1];
    for (size_t i = 0; i < n; i++) {
        if (n_rows == 0 || times[i] - times[n_rows - 1] > SAME_TIME * (high - low))
            times[n_rows++] = times[i];
    }
    scale = rule == TIME_MAX ? high : rule == TIME_UNIT ? high - low : 1;
    for (size_t i = 0; i < n; i++) {
        size_t a = 0, b = n_rows; /* binary search for the last distinct time that is not later */

        while (b - a > 1) {
            size_t middle = a + (b - a) / 2;

            if (times[middle] <= view[i].time)
                a = middle;
            else
                b = middle;
        }
        view[i].dataset_frame = (int)a;
        view[i].time = (view[i].time - (rule == TIME_UNIT ? low : 0)) / (scale != 0 ? scale : 1);
        views->n_dataset_frames = views->n_dataset_frames > view[i].dataset_frame + 1
                                      ? views->n_dataset_frames
                                      : view[i].dataset_frame + 1;
    }
    return SPIN_OK;
}

/* ---- Cameras of transforms.json -------------------------------------------------------------- */

/* Whether `number` [n] can be the camera numbers of n views, whose times have the indices `row`
 * [n]: there must be several numbers, several times, and one view for each pair of a number and a
 * time. */
static bool are_cameras(const int *number, const int *row, size_t n)
{
    SPIN_FREED int *list = NULL;
    size_t n_numbers, n_rows;

    if (spin_alloc(n, sizeof *list, (void **)&list) != SPIN_OK)
        return false;
    memcpy(list, number, n * sizeof *list);
    n_numbers = spin_views_unique(list, n);
    memcpy(list, row, n * sizeof *list);
    n_rows = spin_views_unique(list, n);
    return n_numbers > 1 && n_rows > 1 && n_numbers * n_rows == n;
}

/* Finds the camera of each image by its name: of the numbers in a name, the one that differs
 * between images with the same time is the camera's number. If there is no such number, all images
 * are of one moving camera. */
static spin_status read_cameras(struct spin_model *m, struct spin_view *view, size_t n)
{
    SPIN_LEAVES(spin_numbers_free) struct spin_numbers numbers = {0};
    const char **name;
    spin_status status;
    int *row;

    SPIN_TRY(spin_model_alloc(m, n, sizeof *name, (void **)&name));
    SPIN_TRY(spin_model_alloc(m, n, sizeof *row, (void **)&row));
    for (size_t i = 0; i < n; i++) {
        name[i] = view[i].path + strlen(m->path);
        row[i] = view[i].dataset_frame;
    }
    status =
        spin_numbered_read(&(struct spin_numbering){.name = name, .n = n, .group = row}, &numbers);
    if (status == SPIN_E_MEMORY)
        return status;
    if (status == SPIN_OK && !are_cameras(numbers.number, row, n))
        status = SPIN_E_MALFORMED;
    for (size_t i = 0; i < n; i++)
        view[i].camera_id = status == SPIN_OK ? numbers.number[i] : 0;
    return SPIN_OK;
}

/* Sets the cameras of images whose names do not all contain cam<NN>. Without times, every image is
 * a camera of its own, so ids in names are kept only if all of them differ. */
static spin_status set_cameras(const struct split *s, struct spin_views *views, size_t first)
{
    size_t n = views->n - first, n_ids;
    struct spin_view *view = views->view + first;
    int *ids;

    SPIN_TRY(spin_model_alloc(s->m, n, sizeof *ids, (void **)&ids));
    for (size_t i = 0; i < n; i++)
        ids[i] = view[i].camera_id;
    n_ids = spin_views_unique(ids, n);
    if (ids[0] >= 0 && (s->timed || n_ids == n))
        return SPIN_OK;
    if (s->timed)
        return read_cameras(s->m, view, n);
    for (size_t i = 0; i < n; i++)
        view[i].camera_id = (int)i;
    return SPIN_OK;
}

/* ---- Held-out views -------------------------------------------------------------------------- */

static int by_path(const void *a, const void *b)
{
    const struct spin_view *const *x = a, *const *y = b;

    return strcmp((*x)->path, (*y)->path);
}

/* Chooses the held-out views of transforms.json. To be called if option `hold` is given, or if the
 * file has no lists of held-out images; without the option, applies the default rule. */
static spin_status hold_out(const struct split *s, struct spin_views *views, size_t first)
{
    size_t n = views->n - first, hold = s->options->hold < 0 ? 8 : (size_t)s->options->hold;
    struct spin_view *view = views->view + first, **order = NULL;
    int least = view[0].camera_id, largest = least;

    for (size_t i = 1; i < n; i++) {
        least = view[i].camera_id < least ? view[i].camera_id : least;
        largest = view[i].camera_id > largest ? view[i].camera_id : largest;
    }
    if (s->options->hold < 0 && s->timed && least < largest) {
        for (size_t i = 0; i < n; i++)
            view[i].test = view[i].camera_id == least;
        return SPIN_OK;
    }
    SPIN_TRY(spin_model_alloc(s->m, n, sizeof *order, (void **)&order));
    for (size_t i = 0; i < n; i++)
        order[i] = &view[i];
    qsort(order, n, sizeof *order, by_path);
    for (size_t i = 0; i < n; i++)
        order[i]->test = hold > 0 && i % hold == 0;
    return SPIN_OK;
}

static spin_status read_options(const struct spin_plugin_values *values, struct options *out)
{
    int time, pose;

    out->test_file = spin_plugin_value(values, "test-file", "transforms_test.json");
    out->ending = spin_plugin_value(values, "ending", ".png");
    if (!spin_views_is_safe_name(out->test_file))
        return spin_misuse(
            "option 'test-file' is '%s', expected the name of a file in the data set",
            out->test_file);
    SPIN_TRY(spin_option_word(values, "time", "file|max|unit", &time));
    out->time = (enum time_rule)time;
    SPIN_TRY(spin_option_word(values, "pose", "right|4dgaussians", &pose));
    out->old_pose = pose == 1;
    out->hold = -1;
    return spin_option_count(values, "hold", 0, INT_MAX, &out->hold);
}

/* Sets the cameras and the held-out views of transforms.json. */
static spin_status finish_all(const struct split *s, struct spin_views *out, size_t first)
{
    SPIN_TRY(set_cameras(s, out, first));
    return s->has_lists && s->options->hold < 0 ? SPIN_OK : hold_out(s, out, first);
}

static spin_status read_set(struct spin_model *m, struct spin_views *out)
{
    struct options o;
    struct split train = {.m = m, .options = &o};
    struct split test = {.m = m, .options = &o, .id = 1, .test = true};
    bool one = !spin_model_holds(m->path, TRAIN) && spin_model_holds(m->path, ALL), found;
    size_t first = out->n;

    SPIN_TRY(read_options(m->values, &o));
    if (spin_model_option(m, one ? "test-file" : "hold"))
        return spin_misuse("option '%s' applies to '%s', but the data set has '%s'",
                           one ? "test-file" : "hold", one ? TRAIN : ALL, one ? ALL : TRAIN);
    if (one) {
        train.all = true;
        SPIN_TRY(spin_views_read_json(m->path, ALL, read_frames, &train, out, NULL));
    } else {
        SPIN_TRY(spin_views_read_json(m->path, TRAIN, read_frames, &train, out, NULL));
        SPIN_TRY(spin_views_read_json(m->path, o.test_file, read_frames, &test, out, &found));
        if (!found && spin_model_option(m, "test-file"))
            return spin_not_found("there is no file '%s'", o.test_file);
    }
    SPIN_TRY(spin_views_check_most(out, first));
    SPIN_TRY(set_rows(m, out, first, o.time));
    if (one)
        SPIN_TRY(finish_all(&train, out, first));
    SPIN_TRY(spin_views_set_numbers(out, first));
    return spin_views_drop_missing(out, first);
}

static const struct spin_plugin_option options[] = {
    {"time", "RULE",
     "times: file for those stored, max for those divided by the largest, unit for those scaled to "
     "0 (first) to 1 (last)",
     "file"},
    {"test-file", "NAME", "the file of held-out images (transforms_val.json in some data sets)",
     "transforms_test.json"},
    {"ending", "TEXT", "extension of the images, if their names in the file lack it", ".png"},
    {"pose", "RULE",
     "right: correct poses; 4dgaussians: the translation's x has the wrong sign, as in 4DGaussians",
     "right"},
    {"hold", "N",
     "transforms.json: hold out every N-th image by name, including the first; 0: none (default: "
     "the lists in the file, else the first of several cameras, else every 8th image)",
     NULL},
    {NULL, NULL, NULL, NULL},
};

SPIN_VIEWS_IMPORTER(views_transforms, "transforms", struct spin_model, read_set,
                    .summary =
                        "views: JSON of D-NeRF, n3v2blender and nerfstudio (transforms_train.json, "
                        "transforms.json)",
                    .upstream = "fudan-zvg/4d-gaussian-splatting scene/dataset_readers.py",
                    .options = options, .probe = probe)
