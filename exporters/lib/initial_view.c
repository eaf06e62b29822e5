#include "exporters/lib/initial_view.h"

#include <limits.h>

#include "base/base.h"
#include "exporters/lib/path_file.h"
#include "exporters/lib/splat_rows.h"
#include "geometry/camera_rig.h"
#include "geometry/viewpoints.h"
#include "io/image.h"

#define FRONT_FOVY_DEG 50.0
#define DEGREES 57.29577951308232 /* per radian */

spin_status spin_initial_view_middle(const struct spin_splats *s, double middle[3], double *size)
{
    SPIN_FREED float *value = NULL;

    SPIN_TRY(spin_alloc(s->n + 1, sizeof *value, (void **)&value));
    *size = 0;
    for (int c = 0; c < 3; c++) {
        size_t n = 0;

        for (size_t i = 0; i < s->n; i++)
            if (isfinite(s->means[3 * i + (size_t)c]))
                value[n++] = s->means[3 * i + (size_t)c];
        qsort(value, n, sizeof *value, spin_by_float);
        middle[c] = n ? (double)value[n / 2] : 0;
        if (n)
            *size = fmax(*size, 0.5 * ((double)value[n - 1 - n / 20] - (double)value[n / 20]));
    }
    if (!(*size > 1e-12) || !isfinite(*size))
        *size = 1;
    return SPIN_OK;
}

spin_status spin_initial_view_middle_after_empty(const struct spin_export_job *job,
                                                 double middle[3], double *size)
{
    const struct spin_splats *s = NULL;
    int f = 0;

    *size = 0;
    for (; job->again && f < job->n_frames && (!s || s->n == 0); f++)
        if (!job->counts || job->counts[f] > 0)
            SPIN_TRY(job->again(job->context, f, &s));
    return s && s->n > 0 && f > 1 ? spin_initial_view_middle(s, middle, size) : SPIN_OK;
}

double spin_initial_view_focal(const struct spin_initial_view *view, int height)
{
    return 0.5 * height / tan(view->fovy_deg / 114.59155902616465);
}

bool spin_initial_view_is_blank(const float *image, size_t n, const float background[3])
{
    for (size_t i = 0; i < 3 * n; i++)
        if (image[i] != (background ? background[i / n] : 0))
            return false;
    return true;
}

const struct spin_view *spin_initial_view_view(const struct spin_views *views, int row, bool test)
{
    const struct spin_view *best = NULL;

    for (size_t i = 0; views && i < views->n; i++) {
        const struct spin_view *v = &views->view[i];

        if (row >= 0 && v->dataset_frame != row)
            continue;
        if (!best || (v->test == test && best->test != test))
            best = v;
    }
    return best;
}

/* Sets `up` to the normalised mean of the up vectors of the cameras in data-set frame `row` (-1:
 * all frames) or, if these vectors cancel out, to that of the camera `first`. */
static void set_mean_up(const struct spin_views *views, int row, const struct spin_camera *first,
                        double up[3])
{
    double sum[3] = {0}, length = 0;

    for (size_t i = 0; i < views->n; i++)
        for (int c = 0; c < 3; c++)
            if (row < 0 || views->view[i].dataset_frame == row)
                sum[c] -= views->view[i].camera.w2c[4 + c];
    for (int c = 0; c < 3; c++)
        length += sum[c] * sum[c];
    for (int c = 0; c < 3; c++)
        up[c] = length > 1e-6 ? sum[c] / sqrt(length) : -first->w2c[4 + c];
}

/* Sets out->reach, the range of distances from the target: from a third of the distance of the data
 * set's nearest camera to 1.2 times the distance of its farthest camera. */
static void set_reach(const struct spin_views *views, int row, struct spin_initial_view *out)
{
    double least = INFINITY, most = 0;

    for (size_t i = 0; i < views->n; i++) {
        double eye[3], d = 0;

        if (row >= 0 && views->view[i].dataset_frame != row)
            continue;
        spin_camera_centre(&views->view[i].camera, eye);
        for (int c = 0; c < 3; c++)
            d += (eye[c] - out->target[c]) * (eye[c] - out->target[c]);
        least = fmin(least, sqrt(d));
        most = fmax(most, sqrt(d));
    }
    out->reach[0] = least / 3;
    out->reach[1] = 1.2 * most;
}

/* Sets the view to that of a camera. The target is the point of the optical axis that is nearest to
 * the centre of the scene. */
static void set_camera(const struct spin_camera *camera, const double middle[3], double size,
                       struct spin_initial_view *out)
{
    double along = 0;

    out->z_near = spin_camera_near(camera);
    spin_camera_centre(camera, out->eye);
    for (int c = 0; c < 3; c++)
        along += camera->w2c[8 + c] * (middle[c] - out->eye[c]);
    along = fmax(along, 0.1 * size);
    for (int c = 0; c < 3; c++)
        out->target[c] = out->eye[c] + along * camera->w2c[8 + c];
    out->fovy_deg = 2 * atan(0.5 * camera->height / camera->fy) * DEGREES;
    out->aspect = camera->width * camera->fy / (camera->height * camera->fx);
}

/* Places the camera in front of its target, on the axis z or, if z points up or down, on the axis
 * y. */
static void set_front(double away, struct spin_initial_view *out)
{
    memcpy(out->eye, out->target, sizeof out->eye);
    out->eye[fabs(out->up[2]) > 0.7 ? 1 : 2] -= away;
}

void spin_initial_view_first(const struct spin_views *views, const double *up, int row, bool test,
                             const double middle[3], double size, struct spin_initial_view *out)
{
    const struct spin_view *first = spin_initial_view_view(views, row, test);

    *out = (struct spin_initial_view){.up = {0, -1, 0}, .fovy_deg = FRONT_FOVY_DEG, .aspect = 1.5};
    if (!first) {
        double away = 3 * size;

        if (up)
            memcpy(out->up, up, sizeof out->up);
        memcpy(out->target, middle, sizeof out->target);
        set_front(away, out);
        out->reach[0] = away / 10;
        out->reach[1] = 3 * away;
        /* The near plane must be in front of the target, whose smallest distance is reach[0]. */
        out->z_near = SPIN_NEAR * fmin(size, 1);
        return;
    }
    set_mean_up(views, row, &first->camera, out->up);
    set_camera(&first->camera, middle, size, out);
    set_reach(views, row, out);
}

/* ---- Options of the user --------------------------------------------------------------------- */

/* Finds the camera with this number in data-set frame `row` (-1: in any frame). */
static spin_status find_camera(const struct spin_views *views, int row, int number,
                               const struct spin_camera **out)
{
    for (size_t i = 0; views && i < views->n; i++)
        if (views->view[i].camera_id == number &&
            (row < 0 || views->view[i].dataset_frame == row)) {
            *out = &views->view[i].camera;
            return SPIN_OK;
        }
    return views ? spin_not_found("--camera %d: the data set has no camera %d", number, number)
                 : spin_not_found("--camera %d needs a data set: give --data DIR", number);
}

/* Reads the first camera of a camera path. */
static spin_status read_camera(const char *path, struct spin_camera *out)
{
    SPIN_LEAVES(spin_path_file_close) struct spin_path_file file = {0};
    double fovy;

    SPIN_TRY(spin_path_file_open(path, &file));
    fovy = file.pose->fovy_deg > 0 ? file.pose->fovy_deg : FRONT_FOVY_DEG;
    *out = (struct spin_camera){.width = file.width ? file.width : 1500,
                                .height = file.height ? file.height : 1000};
    out->fx = out->fy = 0.5 * out->height / tan(0.5 * fovy / DEGREES);
    memcpy(out->w2c, file.pose->w2c, sizeof file.pose->w2c);
    return SPIN_OK;
}

/* Sets *out to the camera that `text`, the value of --camera, specifies: the number of a camera of
 * the data set, or a file. */
static spin_status parse_camera(const char *text, const struct spin_views *views, int row,
                                struct spin_camera *own, const struct spin_camera **out)
{
    char *end;
    long number = strtol(text, &end, 10);

    if (end != text && *end == '\0' && number >= 0 && number <= INT_MAX)
        return find_camera(views, row, (int)number, out);
    *out = own;
    return read_camera(text, own);
}

static spin_status set_up(const struct spin_plugin_values *values, double up[3])
{
    int axis = -1;

    if (!spin_plugin_value(values, "up", NULL))
        return SPIN_OK;
    SPIN_TRY(spin_option_word(values, "up", "x|y|z|-x|-y|-z", &axis));
    for (int c = 0; c < 3; c++)
        up[c] = c == axis % 3 ? axis < 3 ? 1 : -1 : 0;
    return SPIN_OK;
}

static void make_unit(double v[3])
{
    double length = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);

    for (int c = 0; c < 3; c++)
        v[c] /= length + 1e-300;
}

static void cross_product(const double a[3], const double b[3], double out[3])
{
    for (int c = 0; c < 3; c++)
        out[c] = a[(c + 1) % 3] * b[(c + 2) % 3] - a[(c + 2) % 3] * b[(c + 1) % 3];
}

void spin_initial_view_axes(const double eye[3], const double target[3], const double up[3],
                            double axis[3][3])
{
    for (int c = 0; c < 3; c++)
        axis[2][c] = target[c] - eye[c];
    make_unit(axis[2]);
    cross_product(axis[2], up, axis[0]);
    make_unit(axis[0]);
    cross_product(axis[2], axis[0], axis[1]);
}

void spin_initial_view_pose(const double eye[3], const double target[3], const double up[3],
                            double w2c[12])
{
    double axis[3][3];

    spin_initial_view_axes(eye, target, up, axis);
    for (int r = 0; r < 3; r++) {
        w2c[4 * r + 3] = 0;
        for (int c = 0; c < 3; c++) {
            w2c[4 * r + c] = axis[r][c];
            w2c[4 * r + 3] -= axis[r][c] * eye[c];
        }
    }
}

void spin_initial_view_turn(const double v[3], const double axis[3], double angle, double out[3])
{
    double along = v[0] * axis[0] + v[1] * axis[1] + v[2] * axis[2], turned[3];

    for (int c = 0; c < 3; c++) { /* Rodrigues' formula */
        int a = (c + 1) % 3, b = (c + 2) % 3;

        turned[c] = v[c] * cos(angle) + (axis[a] * v[b] - axis[b] * v[a]) * sin(angle) +
                    axis[c] * along * (1 - cos(angle));
    }
    memcpy(out, turned, sizeof turned);
}

/* Sets q to the inverse of the rotation of --rotate, as a unit quaternion w x y z, or to the
 * identity if --rotate is not given. */
static spin_status parse_inverse(const struct spin_plugin_values *values, double q[4])
{
    const char *text = spin_plugin_value(values, "rotate", NULL);

    q[0] = 1;
    q[1] = q[2] = q[3] = 0;
    if (text)
        SPIN_TRY(spin_splat_rows_parse_rotate(text, q));
    for (int c = 1; c < 4; c++)
        q[c] = -q[c];
    return SPIN_OK;
}

/* Rotates v by a unit quaternion. */
static void turn_by(const double q[4], double v[3])
{
    double sine = sqrt(q[1] * q[1] + q[2] * q[2] + q[3] * q[3]), axis[3];

    if (sine < 1e-12)
        return;
    for (int c = 0; c < 3; c++)
        axis[c] = q[1 + c] / sine;
    spin_initial_view_turn(v, axis, 2 * atan2(sine, q[0]), v);
}

/* Rotates the position and `up` of the view about its target. */
static void turn_view(const double q[4], struct spin_initial_view *out)
{
    double away[3];

    for (int c = 0; c < 3; c++)
        away[c] = out->eye[c] - out->target[c];
    turn_by(q, away);
    turn_by(q, out->up);
    for (int c = 0; c < 3; c++)
        out->eye[c] = out->target[c] + away[c];
}

spin_status spin_initial_view_chosen(const struct spin_export_job *job, int row,
                                     const double middle[3], double size,
                                     struct spin_initial_view *out)
{
    const char *text = spin_plugin_value(job->values, "camera", NULL);
    const struct spin_camera *camera = NULL;
    struct spin_camera own;
    double back[4];

    SPIN_TRY(parse_inverse(job->values, back));
    if (text)
        SPIN_TRY(parse_camera(text, job->views, row, &own, &camera));
    for (int c = 0; c < 3 && camera && !job->views; c++)
        out->up[c] = -camera->w2c[4 + c];
    SPIN_TRY(set_up(job->values, out->up));
    if (!camera && !job->views)
        set_front(3 * size, out);
    if (camera)
        set_camera(camera, middle, size, out);
    if (camera && job->views)
        set_reach(job->views, row, out);
    turn_view(back, out);
    return SPIN_OK;
}

/* Rotates the position of the view about the target by that part of the rotation q which is about
 * the axis `up` (swing-twist decomposition). */
static void turn_sideways(const double q[4], struct spin_initial_view *out)
{
    double away[3], along = q[1] * out->up[0] + q[2] * out->up[1] + q[3] * out->up[2];

    for (int c = 0; c < 3; c++)
        away[c] = out->eye[c] - out->target[c];
    spin_initial_view_turn(away, out->up, 2 * atan2(along, q[0]), away);
    for (int c = 0; c < 3; c++)
        out->eye[c] = out->target[c] + away[c];
}

/* Share of the subject that windows must show. */
#define KEPT_SHARE 0.97
/* Height of the image, in heights of this share: the head of a person may be the rest. */
#define HEADROOM 1.2
#define MOST_FOVY_DEG 75.0

/* Projects the sample of the subject with a pose, and returns spin_initial_view.keep: the tangent
 * of the angle to the right or to the left that contains KEPT_SHARE of the sample, or up or down if
 * `axis` is 1 instead of 0. *outside: the share of the sample that is outside an image of these
 * half sizes, as tangents; off: the distances of the mean of the sample from its centre, in half
 * sizes. `value` [n_sample] is overwritten. */
static double project_sample(const struct spin_viewpoints *subject, const double w2c[12], int axis,
                             const double half[2], double *value, double *outside, double off[2])
{
    int n = subject->n_sample;

    *outside = off[0] = off[1] = 0;
    for (int i = 0; i < n; i++) {
        double at[3];
        bool inside = true;

        for (int r = 0; r < 3; r++) {
            at[r] = w2c[4 * r + 3];
            for (int c = 0; c < 3; c++)
                at[r] += w2c[4 * r + c] * subject->sample[i][c];
        }
        at[2] = fmax(at[2], 1e-9);
        for (int k = 0; k < 2; k++) {
            double place = at[k] / at[2] / half[k];

            inside = inside && fabs(place) < 1;
            off[k] += fmax(-2, fmin(2, place)) / n;
        }
        *outside += inside ? 0 : 1.0 / n;
        value[i] = fabs(at[axis]) / at[2];
    }
    qsort(value, (size_t)n, sizeof *value, spin_by_double);
    return n > 0 ? value[(int)ceil(KEPT_SHARE * (n - 1))] : 0;
}

/* The densest part of a static clip may be a wall. If it is far from the point at which the cameras
 * look, makes the ball around this point the subject, with the corners of a cube as the sample. */
static void correct_static_subject(const struct spin_views *views, int row,
                                   struct spin_viewpoints *subject)
{
    double pivot[3], distance, off = 0;

    if (subject->moves || !spin_camera_pivot(views, row, pivot, &distance))
        return;
    for (int c = 0; c < 3; c++)
        off += pow(subject->centre[c] - pivot[c], 2);
    if (sqrt(off) < 0.5 * distance)
        return;
    memcpy(subject->centre, pivot, sizeof pivot);
    subject->radius = 0.3 * distance;
    subject->n_sample = subject->n_sample < 8 ? subject->n_sample : 8;
    for (int i = 0; i < subject->n_sample; i++)
        for (int c = 0; c < 3; c++)
            subject->sample[i][c] = pivot[c] + (i >> c & 1 ? 1 : -1) * subject->radius;
}

/* Sets the view to that of the camera, in data-set frame `row` (-1: in any frame), whose image
 * shows the most of the subject, and shows it closest to its centre. Held-out cameras are used only
 * if there are no others. */
static spin_status set_best_camera(const struct spin_views *views, int row,
                                   const struct spin_viewpoints *subject,
                                   struct spin_initial_view *out)
{
    const struct spin_view *best = spin_initial_view_view(views, row, false);
    bool test = best->test;
    double least = INFINITY;
    SPIN_FREED double *value = NULL;

    SPIN_TRY(spin_alloc((size_t)subject->n_sample + 1, sizeof *value, (void **)&value));
    for (size_t i = 0; i < views->n; i++) {
        const struct spin_view *v = &views->view[i];
        const struct spin_camera *c = &v->camera;
        const double half[2] = {0.5 * c->width / c->fx, 0.5 * c->height / c->fy};
        double outside, off[2], keep;

        if ((row >= 0 && v->dataset_frame != row) || v->test != test)
            continue;
        keep = project_sample(subject, c->w2c, 0, half, value, &outside, off);
        outside = 2 * outside + fmax(fabs(off[0]), fabs(off[1]));
        if (outside >= least)
            continue;
        best = v;
        least = outside;
        out->keep = keep;
    }
    set_camera(&best->camera, subject->centre, subject->radius, out);
    set_reach(views, row, out);
    return SPIN_OK;
}

/* Sets out->keep of a view that faces the subject: the ball around the subject and KEPT_SHARE of
 * the sample must be visible. If `high` is set and the image is not high enough for this share,
 * increases the field of view, up to MOST_FOVY_DEG. */
static spin_status set_keep(const struct spin_viewpoints *subject, bool high,
                            struct spin_initial_view *out)
{
    static const double half[2] = {1, 1};
    SPIN_FREED double *value = NULL;
    double w2c[12], outside, off[2], tangent, distance = 0, radius = subject->radius;

    SPIN_TRY(spin_alloc((size_t)subject->n_sample + 1, sizeof *value, (void **)&value));
    for (int c = 0; c < 3; c++)
        distance += pow(out->eye[c] - out->target[c], 2);
    spin_initial_view_pose(out->eye, out->target, out->up, w2c);
    out->keep = fmax(radius / sqrt(fmax(distance - radius * radius, 0.01 * distance)),
                     project_sample(subject, w2c, 0, half, value, &outside, off));
    if (!high)
        return SPIN_OK;
    tangent = project_sample(subject, w2c, 1, half, value, &outside, off);
    out->fovy_deg =
        fmax(out->fovy_deg, fmin(MOST_FOVY_DEG, 2 * atan(HEADROOM * tangent) * DEGREES));
    return SPIN_OK;
}

/* If the distance of a camera from the subject is less than this multiple of the subject's radius,
 * the image shows only a part of the subject. */
#define LEAST_RADII 1.6
#define LEAST_DETAIL_RADII 1.3 /* for a detail, whose ball is large compared with its splats */

/* Returns the distance of the position in front of the subject. */
static double front_distance(const struct spin_viewpoints *placed)
{
    double square = 0;

    for (int c = 0; c < 3; c++)
        square += pow(placed->front[c] - placed->centre[c], 2);
    return sqrt(square);
}

/* Finds the subject. If the densest part of a static clip without cameras cannot be shown as a
 * whole, it is probably the wall of a room: the subject is then the part of the room with the most
 * small splats. */
static spin_status find_subject(const struct spin_export_job *job,
                                struct spin_viewpoints_options *o, struct spin_viewpoints *placed)
{
    SPIN_TRY(spin_viewpoints_open(o, job->n_frames, job->again, job->context, placed));
    if (job->views || placed->moves || front_distance(placed) >= LEAST_RADII * placed->radius)
        return SPIN_OK;
    spin_viewpoints_close(placed);
    o->detail = true;
    return spin_viewpoints_open(o, job->n_frames, job->again, job->context, placed);
}

spin_status spin_initial_view_subject(const struct spin_export_job *job, int width, int height,
                                      struct spin_initial_view *out, bool *found)
{
    SPIN_LEAVES(spin_viewpoints_close) struct spin_viewpoints placed = {0};
    struct spin_viewpoints_options o = {
        .width = width, .height = height, .fovy_deg = out->fovy_deg};
    int row = job->dataset_frame_of ? job->dataset_frame_of[0] : -1;
    const struct spin_view *first = spin_initial_view_view(job->views, row, false);
    double distance, back[4];
    spin_status status;

    *found = false;
    if (!job->again || (job->views && !first))
        return SPIN_OK;
    if (first)
        set_mean_up(job->views, row, &first->camera, out->up);
    SPIN_TRY(set_up(job->values, out->up));
    SPIN_TRY(parse_inverse(job->values, back));
    if (!first)
        turn_by(back, out->up);
    memcpy(o.up, out->up, sizeof o.up);
    status = find_subject(job, &o, &placed);
    if (status != SPIN_OK)
        return status == SPIN_E_UNSUPPORTED ? SPIN_OK : status;
    if (job->views) {
        correct_static_subject(job->views, row, &placed);
        SPIN_TRY(set_best_camera(job->views, row, &placed, out));
        turn_view(back, out);
        *found = true;
        return SPIN_OK;
    }
    distance = front_distance(&placed);
    if (distance < (o.detail ? LEAST_DETAIL_RADII : LEAST_RADII) * placed.radius ||
        (o.detail && !placed.room))
        return SPIN_OK;
    memcpy(out->eye, placed.front, sizeof out->eye);
    memcpy(out->target, placed.centre, sizeof out->target);
    turn_sideways(back, out);
    out->z_near = fmin(SPIN_NEAR, 0.05 * distance);
    SPIN_TRY(set_keep(&placed, placed.moves || o.detail, out));
    out->reach[0] = distance / 10;
    out->reach[1] = placed.room ? fmax(placed.distance, distance) : 3 * distance;
    *found = true;
    return SPIN_OK;
}

/* ---- The poster of a page -------------------------------------------------------------------- */

enum { W = SPIN_POSTER_WIDTH, H = SPIN_POSTER_HEIGHT };

static void set_poster_camera(const struct spin_initial_view *view, struct spin_camera *out)
{
    double aspect = (double)W / H, focal = spin_initial_view_focal(view, H);

    focal *= fmin(1, aspect / view->aspect);
    *out = (struct spin_camera){.width = W,
                                .height = H,
                                .fx = focal,
                                .fy = focal,
                                .cx = 0.5 * W,
                                .cy = 0.5 * H,
                                .z_near = view->z_near};
    spin_initial_view_pose(view->eye, view->target, view->up, out->w2c);
}

spin_status spin_poster_write(const struct spin_export_job *job,
                              const struct spin_initial_view *view,
                              const struct spin_splats *splats, struct spin_out *out)
{
    SPIN_FREED float *image = NULL;
    SPIN_FREED uint8_t *rgb = NULL;
    SPIN_FREED unsigned char *png = NULL;
    struct spin_camera camera;
    size_t n_png = 0;

    set_poster_camera(view, &camera);
    SPIN_TRY(spin_alloc((size_t)W * H, 3 * sizeof *image, (void **)&image));
    SPIN_TRY(spin_alloc((size_t)W * H, 3, (void **)&rgb));
    SPIN_TRY(spin_render(job->renderer, splats, &camera, job->background, image));
    for (size_t c = 0; c < 3; c++)
        for (size_t i = 0; i < (size_t)W * H; i++)
            rgb[3 * i + c] = (uint8_t)(255 * fminf(fmaxf(image[c * W * H + i], 0), 1) + 0.5f);
    SPIN_TRY(spin_image_encode(W, H, rgb, &png, &n_png));
    return spin_out_write(out, png, n_png);
}
