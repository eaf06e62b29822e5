#include "exporters/lib/camera_path.h"

#include "base/base.h"
#include "geometry/camera_rig.h"
#include "io/file.h"
#include "math/covariance.h"

/* ---- Options --------------------------------------------------------------------------------- */

static int word_of(const char *text, size_t n, const char *const *words, int n_words)
{
    for (int i = 0; i < n_words; i++)
        if (strlen(words[i]) == n && strncmp(words[i], text, n) == 0)
            return i;
    return -1;
}

static const char *const panel_words[] = {"truth", "before", "after"};

static spin_status parse_panels(struct spin_camera_path *d, const char *list)
{
    for (const char *at = list;; at++) {
        size_t n = strcspn(at, ",");
        int word = word_of(at, n, panel_words, 3);

        if (word < 0 || d->n_panels == 3)
            return spin_misuse("--panels '%s': expected up to three of truth, before and after, "
                               "separated by commas",
                               list);
        d->panel[d->n_panels++] = (enum spin_camera_path_panel)word;
        if (word == SPIN_PANEL_TRUTH && d->path != SPIN_PATH_CAMERA)
            return spin_misuse(
                "--panels truth: the data set has no images of a moving camera; leave "
                "out --path or choose other panels");
        if (word == SPIN_PANEL_TRUTH &&
            (!d->job->views || d->job->views->n == 0 || !d->job->views->view[0].path))
            return spin_misuse("--panels truth needs a data set: give --data DIR");
        if (word == SPIN_PANEL_BEFORE && !d->job->source_frame)
            return spin_not_found(
                "--panels before: the bundle does not contain both imported and retrained splats");
        at += n;
        if (!*at)
            return SPIN_OK;
    }
}

#define DEFAULT_FPS 30
#define DEFAULT_SECONDS 8.0
/* Shorter clips are slowed down to this duration, unless --fps or --duration is given. */
#define LEAST_SECONDS 2.0
enum {
    OWN_WIDTH = 1280,
    OWN_HEIGHT = 720,
    LEAST_SIDE = 16,
    MOST_SIDE = 16384,
    MOST_PICTURES = 10000000
};

static spin_status parse_size(struct spin_camera_path *d)
{
    const char *text = spin_plugin_value(d->job->values, "size", NULL);
    int end = 0;

    if (!text)
        return SPIN_OK;
    if (sscanf(text, "%5dx%5d%n", &d->size[0], &d->size[1], &end) != 2 || text[end] ||
        d->size[0] < LEAST_SIDE || d->size[1] < LEAST_SIDE || d->size[0] > MOST_SIDE ||
        d->size[1] > MOST_SIDE)
        return spin_misuse("--size '%s': expected WxH in pixels, both from %d to %d", text,
                           LEAST_SIDE, MOST_SIDE);
    for (int p = 0; p < d->n_panels; p++)
        if (d->panel[p] == SPIN_PANEL_TRUTH)
            return spin_misuse(
                "--size cannot resize the images of the panel truth: leave out --size "
                "or choose other --panels");
    return SPIN_OK;
}

/* Parses --path: one of four words, or the name of a file with a camera for each image. */
static spin_status parse_path(struct spin_camera_path *d)
{
    static const char *const words[] = {"camera", "orbit", "spiral", "train"};
    const char *text = spin_plugin_value(d->job->values, "path", "camera");
    int word = word_of(text, strlen(text), words, 4);

    d->path = word < 0 ? SPIN_PATH_FILE : (enum spin_camera_path_path)word;
    if (word >= 0)
        return SPIN_OK;
    if (!spin_path_exists(text) || spin_path_is_folder(text))
        return spin_misuse(
            "--path '%s': expected camera, orbit, spiral, train or a file of cameras", text);
    return spin_path_file_open(text, &d->file);
}

/* Returns SPIN_E_USAGE if an option of the view would have no effect. placed: the camera is neither
 * from the data set nor from a file. */
static spin_status check_view(const struct spin_camera_path *d, bool placed)
{
    static const char *const words[] = {"up", "rotate"};
    const struct spin_plugin_values *v = d->job->values;

    if (spin_plugin_value(v, "camera", NULL) &&
        (d->path == SPIN_PATH_TRAIN || (d->path == SPIN_PATH_FILE && !d->fixed)))
        return spin_misuse("--camera has no effect: --path has a camera for each image");
    for (int i = 0; i < 2; i++)
        if (!placed && spin_plugin_value(v, words[i], NULL))
            return spin_misuse("--%s has no effect on a camera of the data set or of a file: use "
                               "--path orbit or spiral",
                               words[i]);
    return SPIN_OK;
}

/* Parses --camera: the number of a camera of the data set, or a file of cameras, of which only the
 * first is used, for all images. For an orbit or a spiral, spin_initial_view_chosen() reads the
 * option instead. */
static spin_status parse_camera(struct spin_camera_path *d)
{
    const char *text = spin_plugin_value(d->job->values, "camera", NULL);
    bool turns = d->path == SPIN_PATH_ORBIT || d->path == SPIN_PATH_SPIRAL;

    d->camera_id = -1;
    if (d->path != SPIN_PATH_CAMERA || !text)
        return check_view(d, turns || (d->path == SPIN_PATH_CAMERA && !d->job->views));
    if (text[strspn(text, "0123456789")] == '\0') {
        if (!d->job->views)
            return spin_misuse(
                "--camera %s: there is no data set; give --data DIR, or a file of cameras", text);
        SPIN_TRY(spin_option_count(d->job->values, "camera", 0, 1000000000, &d->camera_id));
        return check_view(d, false);
    }
    if (!spin_path_exists(text) || spin_path_is_folder(text))
        return spin_misuse("--camera '%s': expected the number of a camera or a file of cameras",
                           text);
    d->path = SPIN_PATH_FILE;
    d->fixed = true;
    SPIN_TRY(spin_path_file_open(text, &d->file));
    return check_view(d, false);
}

/* Sets the number of images and the number of images per second. */
static spin_status parse_pace(struct spin_camera_path *d)
{
    const struct spin_plugin_values *v = d->job->values;
    double seconds = 0;
    int repeat = 1;

    d->fps = d->file.fps > 0 && !d->fixed ? d->file.fps
             : d->job->fps > 0            ? d->job->fps
                                          : DEFAULT_FPS;
    SPIN_TRY(spin_option_number(v, "fps", 0.01, 1000, &d->fps));
    SPIN_TRY(spin_option_count(v, "repeat", 1, 10000, &repeat));
    SPIN_TRY(spin_option_number(v, "duration", 0.001, 1e6, &seconds));
    d->n_pictures = (int64_t)d->job->n_frames * repeat;
    if (d->path == SPIN_PATH_FILE && !d->fixed) {
        d->n_pictures = (int64_t)d->file.n;
        return seconds > 0 || spin_plugin_value(v, "repeat", NULL)
                   ? spin_misuse("--duration and --repeat have no effect: the file of --path has "
                                 "one camera for each image")
                   : SPIN_OK;
    }
    if (seconds <= 0 && spin_camera_path_moves(d) && !spin_plugin_value(v, "repeat", NULL))
        seconds = fmax(DEFAULT_SECONDS, d->job->n_frames / d->fps);
    if (seconds <= 0) {
        if (d->job->n_frames > 1 && !d->job->sound && !spin_plugin_value(v, "fps", NULL))
            d->fps = fmin(d->fps, (double)d->n_pictures / LEAST_SECONDS);
        return SPIN_OK;
    }
    if (spin_plugin_value(v, "repeat", NULL))
        return spin_misuse("--duration and --repeat exclude each other: give one of the two");
    if (seconds * d->fps > MOST_PICTURES)
        return spin_misuse(
            "--duration %g: more than %d images are needed; choose a shorter duration", seconds,
            MOST_PICTURES);
    d->n_pictures = (int64_t)fmax(1, rint(seconds * d->fps));
    return SPIN_OK;
}

int64_t spin_camera_path_first(const struct spin_camera_path *d, int frame)
{
    return (frame * d->n_pictures + d->job->n_frames - 1) / d->job->n_frames;
}

void spin_camera_path_resize(const struct spin_camera_path *d, struct spin_camera *camera)
{
    double scale = (double)d->size[1] / camera->height;

    if (d->size[0] == 0)
        return;
    camera->cx = 0.5 * d->size[0] + (camera->cx - 0.5 * camera->width) * scale;
    camera->cy *= scale;
    camera->fx *= scale;
    camera->fy *= scale;
    camera->width = d->size[0];
    camera->height = d->size[1];
}

/* Sets the intrinsics of a moving camera to those of a view of the data set or, without a data set,
 * to those of the web page's initial view. Then applies --size. */
static void set_lens(struct spin_camera_path *d)
{
    const struct spin_views *views = d->job->views;
    const struct spin_view *view =
        spin_initial_view_view(views, d->row, d->path != SPIN_PATH_TRAIN);
    struct spin_initial_view front;

    if (!view && views && views->n > 0)
        view = &views->view[0];
    if (view) {
        d->lens = view->camera;
    } else {
        static const double middle[3] = {0};
        double focal;

        spin_initial_view_first(NULL, NULL, 0, false, middle, 1, &front);
        focal = spin_initial_view_focal(&front, OWN_HEIGHT);
        d->lens = (struct spin_camera){.width = OWN_WIDTH,
                                       .height = OWN_HEIGHT,
                                       .fx = focal,
                                       .fy = focal,
                                       .cx = 0.5 * OWN_WIDTH,
                                       .cy = 0.5 * OWN_HEIGHT};
    }
    if (d->size[0] == 0 && d->file.width > 0) {
        d->size[0] = d->file.width;
        d->size[1] = d->file.height;
    } else if (d->size[0] == 0 && spin_camera_path_is_own(d) && d->lens.height < OWN_HEIGHT) {
        double width = (double)OWN_HEIGHT * d->lens.width / d->lens.height;

        d->size[0] = (int)fmin(2 * rint(width / 2), MOST_SIDE);
        d->size[1] = OWN_HEIGHT;
    }
    spin_camera_path_resize(d, &d->lens);
}

const char *spin_camera_path_name(const struct spin_camera_path *d)
{
    static const char *const name[] = {"front", "orbit", "spiral", "train", "path"};

    return d->fixed ? "camera" : name[d->path];
}

/* Makes the moving camera face the subject, from a position where no wall blocks the view; if there
 * is no such position, the camera is in front of all splats. Called if neither a data set nor
 * --camera is given. */
static spin_status look_at_subject(struct spin_camera_path *d)
{
    static const double origin[3] = {0};

    spin_initial_view_first(NULL, d->job->up, 0, false, origin, 1, &d->initial);
    SPIN_TRY(spin_initial_view_subject(d->job, d->lens.width, d->lens.height, &d->initial,
                                       &d->has_initial));
    if (d->has_initial)
        d->lens.z_near = d->initial.z_near;
    return SPIN_OK;
}

spin_status spin_camera_path_begin(struct spin_camera_path *d, const struct spin_export_job *job)
{
    d->job = job;
    d->source_frame = -1;
    SPIN_TRY(parse_path(d));
    SPIN_TRY(parse_camera(d));
    d->row = job->dataset_frame_of ? job->dataset_frame_of[0] : 0;
    SPIN_TRY(parse_pace(d));
    SPIN_TRY(parse_panels(d, spin_plugin_value(job->values, "panels", "after")));
    SPIN_TRY(parse_size(d));
    if (d->path == SPIN_PATH_TRAIN && !job->views)
        return spin_misuse("--path train needs a data set: give --data DIR");
    if (d->path == SPIN_PATH_TRAIN)
        SPIN_TRY(spin_rig_path_open(job->views, d->row, &d->rig));
    set_lens(d);
    SPIN_TRY(spin_initial_view_middle_after_empty(job, d->middle, &d->reach));
    if (!job->views && d->path != SPIN_PATH_FILE &&
        !spin_plugin_value(job->values, "camera", NULL)) {
        spin_log(0, "no data set: the camera is in front of the scene");
        if (job->again)
            SPIN_TRY(look_at_subject(d));
    }
    d->labels = spin_plugin_value(job->values, "no-labels", NULL) == NULL;
    return SPIN_OK;
}

void spin_camera_path_warn_blank(const struct spin_camera_path *d)
{
    if (d->n_blank > 0)
        spin_warn("%s only the background: no splat is in front of the camera",
                  spin_text_share((size_t)d->n_blank, (size_t)d->n_drawn, "render", "shows", "show",
                                  (char[96]){0}));
}

void spin_camera_path_free(struct spin_camera_path *d)
{
    spin_rig_path_free(&d->rig);
    spin_path_file_close(&d->file);
    free(d->image);
    free(d->wide);
    spin_splats_free(&d->source);
}

/* ---- Through the cameras of a rig ------------------------------------------------------------ */

static double stop_distance(const struct spin_rig_stop *a, const struct spin_rig_stop *b)
{
    return sqrt(pow(a->eye[0] - b->eye[0], 2) + pow(a->eye[1] - b->eye[1], 2) +
                pow(a->eye[2] - b->eye[2], 2));
}

static void swap_stops(struct spin_rig_stop *a, struct spin_rig_stop *b)
{
    struct spin_rig_stop kept = *a;

    *a = *b;
    *b = kept;
}

/* Orders the stops greedily: each stop is followed by the nearest of the remaining stops. */
static void order_stops(struct spin_rig_path *path)
{
    struct spin_rig_stop *s = path->stop;

    for (int i = 1; i < path->n; i++) {
        int next = i;

        for (int k = i + 1; k < path->n; k++)
            next = stop_distance(&s[i - 1], &s[k]) < stop_distance(&s[i - 1], &s[next]) ? k : next;
        swap_stops(&s[i], &s[next]);
    }
}

/* Reverses sections of the path as long as this makes the path shorter (2-opt). The first stop
 * keeps its place. */
static void shorten_path(struct spin_rig_path *path)
{
    struct spin_rig_stop *s = path->stop;

    for (int turned = 1, rounds = 0; turned && rounds < 100; rounds++) {
        turned = 0;
        for (int i = 1; i < path->n; i++)
            for (int k = i + 1; k < path->n; k++) {
                bool last = k + 1 == path->n;
                double now =
                    stop_distance(&s[i - 1], &s[i]) + (last ? 0 : stop_distance(&s[k], &s[k + 1]));
                double then =
                    stop_distance(&s[i - 1], &s[k]) + (last ? 0 : stop_distance(&s[i], &s[k + 1]));

                if (!(then < now * (1 - 1e-9)))
                    continue;
                turned = 1;
                for (int a = i, b = k; a < b; a++, b--)
                    swap_stops(&s[a], &s[b]);
            }
    }
}

/* Sets the path length up to each stop. Negates quaternions where needed, so that successive
 * quaternions have a dot product of at least 0 and can be interpolated. */
static void measure_path(struct spin_rig_path *path)
{
    for (int i = 1; i < path->n; i++) {
        struct spin_rig_stop *was = &path->stop[i - 1], *s = &path->stop[i];
        double dot = 0;

        s->at = was->at + stop_distance(was, s);
        for (int c = 0; c < 4; c++)
            dot += was->turn[c] * s->turn[c];
        for (int c = 0; c < 4 && dot < 0; c++)
            s->turn[c] = -s->turn[c];
    }
}

static bool is_new(const struct spin_rig_path *path, const struct spin_rig_stop *stop)
{
    for (int i = 0; i < path->n; i++)
        if (stop_distance(&path->stop[i], stop) < 1e-9)
            return false;
    return true;
}

spin_status spin_rig_path_open(const struct spin_views *views, int row, struct spin_rig_path *path)
{
    *path = (struct spin_rig_path){0};
    SPIN_TRY(spin_alloc(views->n + 1, sizeof *path->stop, (void **)&path->stop));
    for (size_t i = 0; i < views->n; i++) {
        struct spin_rig_stop *s = &path->stop[path->n];
        const double *m = views->view[i].camera.w2c;
        const double r[9] = {m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]};

        if (views->view[i].dataset_frame != row || views->view[i].test)
            continue;
        spin_camera_centre(&views->view[i].camera, s->eye);
        spin_quat_of_matrix(r, s->turn);
        path->n += is_new(path, s);
    }
    if (path->n < 2) {
        int n = path->n;

        spin_rig_path_free(path);
        return spin_not_found(
            "--path train needs two or more training cameras in the first frame, found %d", n);
    }
    order_stops(path);
    shorten_path(path);
    measure_path(path);
    return SPIN_OK;
}

void spin_rig_path_free(struct spin_rig_path *path)
{
    free(path->stop);
    *path = (struct spin_rig_path){0};
}

/* Returns component c of stop i. Components 0 to 2 are the position, 3 to 6 the quaternion. */
static double value_of(const struct spin_rig_path *path, int i, int c)
{
    return c < 3 ? path->stop[i].eye[c] : path->stop[i].turn[c - 3];
}

/* Estimates the derivative of component c at stop i, with respect to the path length, from the
 * neighbouring stops. */
static double derivative_at(const struct spin_rig_path *path, int i, int c)
{
    int a = i > 0 ? i - 1 : 0, b = i + 1 < path->n ? i + 1 : i;

    return (value_of(path, b, c) - value_of(path, a, c)) / (path->stop[b].at - path->stop[a].at);
}

void spin_rig_path_camera(const struct spin_rig_path *path, double share, double w2c[12])
{
    double at = share * path->stop[path->n - 1].at, v[7], length = 0, u, step;
    int i = 0;

    while (i + 2 < path->n && path->stop[i + 1].at < at)
        i++;
    step = path->stop[i + 1].at - path->stop[i].at;
    u = (at - path->stop[i].at) / step;
    for (int c = 0; c < 7; c++) /* cubic Hermite spline */
        v[c] = value_of(path, i, c) * (1 + 2 * u) * (1 - u) * (1 - u) +
               value_of(path, i + 1, c) * u * u * (3 - 2 * u) +
               step * u * (1 - u) *
                   (derivative_at(path, i, c) * (1 - u) - derivative_at(path, i + 1, c) * u);
    for (int c = 3; c < 7; c++)
        length += v[c] * v[c];
    for (int c = 3; c < 7; c++)
        v[c] /= sqrt(length);
    for (int r = 0; r < 3; r++) {
        double w = v[3], axis[3] = {v[4], v[5], v[6]};
        int s = (r + 1) % 3, t = (r + 2) % 3;

        w2c[4 * r + r] = 1 - 2 * (axis[s] * axis[s] + axis[t] * axis[t]);
        w2c[4 * r + s] = 2 * (axis[r] * axis[s] - w * axis[t]);
        w2c[4 * r + t] = 2 * (axis[r] * axis[t] + w * axis[s]);
        w2c[4 * r + 3] = 0;
        for (int c = 0; c < 3; c++)
            w2c[4 * r + 3] -= w2c[4 * r + c] * v[c];
    }
}

/* ---- A camera that moves --------------------------------------------------------------------- */

/* Sets `eye` to the position of the moving camera at the fraction `turn`, 0 to 1, of its path. The
 * orbit is a circle around the target. On the spiral, the camera makes three loops that pass
 * through the position of the first view, with an amplitude of a tenth of the distance to the
 * target, while it moves forward and back once. */
static void eye_of(const struct spin_camera_path *d, double turn, double eye[3])
{
    const double *from = d->initial.eye, *to = d->initial.target;
    double away[3], axis[3][3], angle = 6.283185307179586 * turn, distance = 0;

    for (int c = 0; c < 3; c++) {
        away[c] = from[c] - to[c];
        distance += away[c] * away[c];
    }
    distance = sqrt(distance);
    if (d->path == SPIN_PATH_CAMERA) {
        memcpy(eye, from, 3 * sizeof *eye);
        return;
    }
    if (d->path == SPIN_PATH_ORBIT) {
        spin_initial_view_turn(away, d->initial.up, angle, eye);
        for (int c = 0; c < 3; c++)
            eye[c] += to[c];
        return;
    }
    spin_initial_view_axes(from, to, d->initial.up, axis);
    for (int c = 0; c < 3; c++)
        eye[c] = from[c] + 0.1 * distance *
                               (sin(3 * angle) * axis[0][c] +
                                (1 - cos(3 * angle)) * axis[1][c] * 0.5 + sin(angle) * axis[2][c]);
}

/* Makes the moving camera face the pivot, the point nearest to the optical axes of the data set's
 * cameras. If the distance of the camera from the pivot is larger than the median distance of the
 * data set's cameras, reduces it to the median. */
static void move_into_rig(struct spin_camera_path *d, int row)
{
    double pivot[3], median, distance = 0;

    if (!spin_camera_pivot(d->job->views, row, pivot, &median))
        return;
    for (int c = 0; c < 3; c++)
        distance += (d->initial.eye[c] - pivot[c]) * (d->initial.eye[c] - pivot[c]);
    distance = sqrt(distance);
    for (int c = 0; c < 3; c++) {
        d->initial.target[c] = pivot[c];
        if (distance > median)
            d->initial.eye[c] = pivot[c] + (d->initial.eye[c] - pivot[c]) * median / distance;
    }
}

/* Sets the view from which a moving camera starts, and the camera's near plane. */
static spin_status set_first_view(struct spin_camera_path *d, const struct spin_splats *splats)
{
    const struct spin_views *views = d->job->views;

    if (d->reach == 0)
        SPIN_TRY(spin_initial_view_middle(splats, d->middle, &d->reach));
    spin_initial_view_first(views, d->job->up, d->row, true, d->middle, d->reach, &d->initial);
    if (!spin_plugin_value(d->job->values, "camera", NULL))
        move_into_rig(d, d->row);
    SPIN_TRY(spin_initial_view_chosen(d->job, d->row, d->middle, d->reach, &d->initial));
    d->lens.z_near = d->initial.z_near;
    d->has_initial = true;
    return SPIN_OK;
}

spin_status spin_camera_path_camera(struct spin_camera_path *d, int64_t picture,
                                    const struct spin_splats *splats, struct spin_camera *out)
{
    double eye[3];
    double turn = (double)picture / (double)d->n_pictures;

    if (!d->has_initial)
        SPIN_TRY(set_first_view(d, splats));
    *out = d->lens;
    if (d->path == SPIN_PATH_FILE) {
        const struct spin_path_pose *pose = &d->file.pose[d->fixed ? 0 : picture];

        memcpy(out->w2c, pose->w2c, sizeof out->w2c);
        if (pose->fovy_deg > 0) {
            out->fx = out->fy = 0.5 * out->height / tan(pose->fovy_deg / 114.59155902616465);
            out->cx = 0.5 * out->width;
            out->cy = 0.5 * out->height;
        }
        return SPIN_OK;
    }
    if (d->path == SPIN_PATH_TRAIN) {
        double last = d->n_pictures > 1 ? (double)(d->n_pictures - 1) : 1;

        spin_rig_path_camera(&d->rig, (double)picture / last, out->w2c);
        return SPIN_OK;
    }
    eye_of(d, turn, eye);
    spin_initial_view_pose(eye, d->initial.target, d->initial.up, out->w2c);
    return SPIN_OK;
}

/* ---- Panels ---------------------------------------------------------------------------------- */

/* Reads the imported attributes of the frame into d->source, unless d->source already contains
 * them. */
static spin_status read_source(struct spin_camera_path *d, int frame)
{
    if (d->source_frame == frame)
        return SPIN_OK;
    d->source_frame = -1;
    SPIN_TRY(d->job->source_frame(d->job->source_of, frame, &d->source));
    d->source_frame = frame;
    return SPIN_OK;
}

/* ---- Labels of panels ------------------------------------------------------------------------ */

/* Glyphs of 5 x 7 pixels for the panels' names: one byte per row, whose bit 4 is the leftmost
 * pixel. */
static const struct {
    char letter;
    unsigned char row[7];
} glyphs[] = {
    {'a', {0, 0, 14, 1, 15, 17, 15}},    {'b', {16, 16, 22, 25, 17, 17, 30}},
    {'e', {0, 0, 14, 17, 31, 16, 14}},   {'f', {6, 9, 8, 28, 8, 8, 8}},
    {'h', {16, 16, 22, 25, 17, 17, 17}}, {'o', {0, 0, 14, 17, 17, 17, 14}},
    {'r', {0, 0, 22, 25, 16, 16, 16}},   {'t', {8, 8, 28, 8, 8, 9, 6}},
    {'u', {0, 0, 17, 17, 17, 19, 13}},
};

static bool is_ink(const char *word, int x, int y)
{
    for (size_t g = 0; x >= 0 && y >= 0 && y < 7 && g < sizeof glyphs / sizeof *glyphs; g++) {
        if (glyphs[g].letter == word[x / 6])
            return x % 6 < 5 && glyphs[g].row[y] >> (4 - x % 6) & 1;
    }
    return false;
}

/* Draws `word` into the upper left corner of image [3][height][width], white on black. Does nothing
 * if the image is too small. */
static void draw_label(const char *word, int width, int height, float *image)
{
    int dot = height / 180 > 1 ? height / 180 : 1, n = (int)strlen(word);
    int wide = (6 * n + 3) * dot, high = 11 * dot;

    if (height < 4 * high || width < wide)
        return;
    for (int c = 0; c < 3; c++)
        for (int y = 0; y < high; y++)
            for (int x = 0; x < wide; x++)
                image[((size_t)c * (size_t)height + (size_t)y) * (size_t)width + (size_t)x] =
                    x / dot < 6 * n + 2 && is_ink(word, x / dot - 2, y / dot - 2);
}

/* ---- Images ---------------------------------------------------------------------------------- */

static spin_status draw_panel(struct spin_camera_path *d, enum spin_camera_path_panel panel,
                              int frame, const struct spin_splats *splats,
                              const struct spin_camera *camera, const char *truth)
{
    const struct spin_export_job *job = d->job;

    if (panel == SPIN_PANEL_TRUTH)
        return spin_image_load(truth, camera->width, camera->height, job->background, d->image);
    if (panel == SPIN_PANEL_BEFORE)
        SPIN_TRY(read_source(d, frame));
    SPIN_TRY(spin_render(job->renderer, panel == SPIN_PANEL_BEFORE ? &d->source : splats, camera,
                         job->background, d->image));
    d->n_drawn++;
    d->n_blank += spin_initial_view_is_blank(
        d->image, (size_t)camera->width * (size_t)camera->height, job->background);
    return SPIN_OK;
}

spin_status spin_camera_path_draw(struct spin_camera_path *d, int frame,
                                  const struct spin_splats *splats,
                                  const struct spin_camera *camera, const char *truth)
{
    size_t w = (size_t)camera->width, h = (size_t)camera->height, n = (size_t)d->n_panels;

    SPIN_TRY(spin_grow(w * h, 3 * sizeof *d->image, (void **)&d->image));
    SPIN_TRY(spin_grow(w * h, 3 * n * sizeof *d->wide, (void **)&d->wide));
    for (size_t p = 0; p < n; p++) {
        SPIN_TRY(draw_panel(d, d->panel[p], frame, splats, camera, truth));
        if (n > 1 && d->labels)
            draw_label(panel_words[d->panel[p]], camera->width, camera->height, d->image);
        for (size_t row = 0; row < 3 * h; row++)
            memcpy(d->wide + (row * n + p) * w, d->image + row * w, w * sizeof *d->image);
    }
    return SPIN_OK;
}
