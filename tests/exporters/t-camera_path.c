/* Poses of moving cameras and the first view, for a rig that moves and rolls and for lenses with
 * fx different from fy and a principal point off the centre; expected values are computed here
 * from the cameras' positions and axes.
 * K: video images html export cameras */
#include "exporters/lib/camera_path.h"

#include "base/log.h"
#include "geometry/camera_rig.h"
#include "geometry/viewpoints.h"
#include "math/rng.h"
#include "tests/exporters/frame.h"
#include "tests/rig.h"

enum { ROWS = 3, CAMERAS = 5, PICTURES = 24 };
static const double pi = 3.14159265358979323846;

/* The lens of the training cameras, and that of the others. */
static const struct spin_camera train_lens = {64, 48, 70, 55, 20, 33, {0}, 0},
                                test_lens = {80, 36, 50, 90, 47, 11, {0}, 0};

static double pose_error(const struct spin_camera *got, const struct pose *want)
{
    struct spin_camera wanted = camera_of(train_lens, want);
    double worst = 0;

    for (int k = 0; k < 12; k++)
        worst = isnan(got->w2c[k]) ? INFINITY : fmax(worst, fabs(got->w2c[k] - wanted.w2c[k]));
    return worst;
}

/* ---- The rig -----------------------------------------------------------------------------------
 */

static struct spin_views views;
static struct pose rig[ROWS][CAMERAS]; /* the last two are held out */
static const double pivot[ROWS][3] = {{9, -7, 5}, {1, 2, 3}, {-6, 0, 2}};

/* Each row is another rig around another point: all optical axes pass through it, none is
 * upright. */
static void make_rig(void)
{
    static const double way[CAMERAS][3] = {
        {1, 0.3, -2}, {2, -0.5, -1.5}, {-1.6, 0.2, -1.8}, {0.4, 1, -2}, {-0.3, -0.9, -1}};
    static const double away[CAMERAS] = {3, 4, 5, 7, 6}, roll[CAMERAS] = {0.3, -0.2, 0.5, 0.4, 2.9};
    static const double up[ROWS][3] = {{1, 0, 0.2}, {0.2, -1, 0.3}, {0, 0.3, 1}};

    for (int row = 0; row < ROWS; row++)
        for (int k = 0; k < CAMERAS; k++) {
            struct spin_view v = {.dataset_frame = row, .camera_id = k, .test = k > 2};
            double eye[3];

            memcpy(eye, way[(k + row) % CAMERAS], sizeof eye);
            make_long(eye, away[k] + 20 * (row == 0));
            for (int c = 0; c < 3; c++)
                eye[c] += pivot[row][c];
            rig[row][k] = pose_towards(eye, pivot[row], up[row], roll[k]);
            v.camera = camera_of(k > 2 ? test_lens : train_lens, &rig[row][k]);
            v.path = (char *)"none";
            if (spin_views_add(&views, &v) != SPIN_OK)
                exit(1);
        }
    views.n_dataset_frames = ROWS;
}

/* Of a row's cameras. */
static void mean_up(int row, double up[3])
{
    memset(up, 0, 3 * sizeof *up);
    for (int k = 0; k < CAMERAS; k++)
        for (int c = 0; c < 3; c++)
            up[c] -= rig[row][k].down[c];
    make_long(up, 1);
}

/* ---- Paths -------------------------------------------------------------------------------------
 */

static const int row_of[] = {1, 2};
static struct spin_splats splats;

/* The cameras of a path over frames of rows 1 and 2. */
static void follow(const char *const *pairs, int n, struct spin_camera *out)
{
    struct spin_plugin_values values = {pairs};
    struct spin_export_job job = {
        .n_frames = 2, .views = &views, .values = &values, .dataset_frame_of = row_of};
    struct spin_camera_path d = {0};
    bool good = spin_camera_path_begin(&d, &job) == SPIN_OK && d.n_pictures == n;

    for (int i = 0; i < n && good; i++)
        good = spin_camera_path_camera(&d, i, &splats, &out[i]) == SPIN_OK;
    ok(good && d.fps == n / 2.0, "%s %s: %d pictures in two seconds: %g fps: %s", pairs[0],
       pairs[1], n, d.fps, good ? "" : spin_last_error());
    spin_camera_path_free(&d);
}

/* The start of an orbit: in the direction of the first held-out camera, at the median distance
 * of all. */
static void begin_orbit(double away[3])
{
    for (int c = 0; c < 3; c++)
        away[c] = rig[1][3].eye[c] - pivot[1][c];
    make_long(away, 5); /* of 3, 4, 5, 7 and 6 */
}

static void test_orbit(void)
{
    static const char *const pairs[] = {"path", "orbit", "repeat", "12", NULL};
    struct spin_camera got[PICTURES];
    double up[3], away[3], level[3], side[3], worst = 0;

    mean_up(1, up);
    begin_orbit(away);
    follow(pairs, PICTURES, got);
    for (int c = 0; c < 3; c++)
        level[c] = away[c] - dot(away, up) * up[c];
    across(up, level, side);
    for (int i = 0; i < PICTURES; i++) {
        double a = 2 * pi * i / PICTURES, eye[3];
        struct pose want;

        for (int c = 0; c < 3; c++)
            eye[c] = pivot[1][c] + dot(away, up) * up[c] + cos(a) * level[c] + sin(a) * side[c];
        want = pose_towards(eye, pivot[1], up, 0);
        worst = larger(worst, pose_error(&got[i], &want));
    }
    ok(worst < 1e-9, "an orbit at one height about the place all look at: %g off", worst);
    ok(got[5].width == 1600 && got[5].height == 720 && got[5].fx == 20 * 50 &&
           got[5].fy == 20 * 90 && got[5].cx == 20 * 47 && got[5].cy == 20 * 11,
       "with the lens of the held-out camera, in 720 rows");
}

static void test_spiral(void)
{
    static const char *const pairs[] = {"path", "spiral", "repeat", "12", NULL};
    struct spin_camera got[PICTURES];
    double up[3], away[3], from[3], worst = 0;
    struct pose first;

    mean_up(1, up);
    begin_orbit(away);
    for (int c = 0; c < 3; c++)
        from[c] = pivot[1][c] + away[c];
    first = pose_towards(from, pivot[1], up, 0);
    follow(pairs, PICTURES, got);
    for (int i = 0; i < PICTURES; i++) {
        double a = 2 * pi * i / PICTURES, eye[3];
        struct pose want;

        for (int c = 0; c < 3; c++)
            eye[c] = from[c] +
                     0.5 * (sin(3 * a) * first.right[c] + (0.5 - 0.5 * cos(3 * a)) * first.down[c] +
                            sin(a) * first.ahead[c]);
        want = pose_towards(eye, pivot[1], up, 0);
        worst = larger(worst, pose_error(&got[i], &want));
    }
    ok(worst < 1e-9, "three turns beside the first view, once nearer and farther: %g off", worst);
}

static void test_train(void)
{
    static const char *const pairs[] = {"path", "train", "repeat", "12", NULL};
    struct spin_camera got[PICTURES];
    double nearest[CAMERAS];

    follow(pairs, PICTURES, got);
    for (int k = 0; k < CAMERAS; k++) {
        nearest[k] = INFINITY;
        for (int i = 0; i < PICTURES; i++)
            nearest[k] = fmin(nearest[k], pose_error(&got[i], &rig[1][k]));
    }
    ok(pose_error(&got[0], &rig[1][0]) < 1e-9,
       "begins at the first training camera of the first frame");
    ok(nearest[1] < 0.4 && nearest[2] < 0.4 &&
           fmin(pose_error(&got[PICTURES - 1], &rig[1][1]),
                pose_error(&got[PICTURES - 1], &rig[1][2])) < 1e-9,
       "comes by the others and ends at one: %g, %g", nearest[1], nearest[2]);
    ok(nearest[3] > 0.5 && nearest[4] > 0.5, "not by those held out: %g, %g", nearest[3],
       nearest[4]);
    ok(got[7].width == 960 && got[7].height == 720 && got[7].fx == 15 * 70 &&
           got[7].fy == 15 * 55 && got[7].cx == 15 * 20 && got[7].cy == 15 * 33,
       "with the lens of the training cameras, in 720 rows");
}

/* The frame that an image shows: the one at its time. */
static void test_pace(void)
{
    for (int n_frames = 1; n_frames < 12; n_frames++) {
        struct spin_export_job job = {.n_frames = n_frames};
        bool good = true;

        for (int n = 1; n < 40; n++) {
            struct spin_camera_path d = {.job = &job, .n_pictures = n};

            for (int f = 0; f < n_frames; f++)
                for (int64_t p = spin_camera_path_first(&d, f);
                     p < spin_camera_path_first(&d, f + 1); p++)
                    good = good && (int)floor((double)(p * n_frames) / n) == f;
            good = good && spin_camera_path_first(&d, 0) == 0 &&
                   spin_camera_path_first(&d, n_frames) == n;
        }
        ok(good, "%d frames in 1 to 39 pictures: each shows the frame of its time", n_frames);
    }
}

/* A moving camera takes eight seconds, or the length of a longer clip; a static one shows each
 * frame once. */
static void test_length(void)
{
    static const char *const all[][9] = {
        {"path", "orbit", NULL},
        {"path", "spiral", "fps", "24", NULL},
        {"path", "train", "duration", "2", NULL},
        {"path", "orbit", "fps", "0.1", NULL},
        {"path", "orbit", "repeat", "3", NULL},
        {"path", "camera", NULL},
    };
    static const int want[] = {8 * 25, 8 * 24, 2 * 25, 2, 6, 2};

    for (int k = 0; k < 6; k++) {
        struct spin_plugin_values values = {all[k]};
        struct spin_export_job job = {.n_frames = 2,
                                      .fps = 25,
                                      .views = &views,
                                      .values = &values,
                                      .dataset_frame_of = row_of};
        struct spin_camera_path d = {0};

        ok(spin_camera_path_begin(&d, &job) == SPIN_OK && d.n_pictures == want[k],
           "--path %s, case %d: %d pictures", all[k][1], k, (int)d.n_pictures);
        spin_camera_path_free(&d);
    }
}

/* The field of view comes from the file, or else from the lens of the data set, for images of
 * the file's size. */
static void test_file(void)
{
    static const char text[] =
        "{\"render_width\": 300, \"render_height\": 200, \"fps\": 12.5, \"camera_path\": ["
        "{\"camera_to_world\": [[0, 0, 1, 7], [1, 0, 0, 8], [0, 1, 0, 9]], \"fov\": 90},"
        "{\"camera_to_world\": [[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 3]]}]}";
    static const double want[2][12] = {{0, 1, 0, -8, 0, 0, -1, 9, -1, 0, 0, 7},
                                       {1, 0, 0, -1, 0, -1, 0, 2, 0, 0, -1, 3}};
    char path[4200];
    const char *pairs[] = {"path", path, NULL};
    struct spin_plugin_values values = {pairs};
    struct spin_export_job job = {
        .n_frames = 2, .views = &views, .values = &values, .dataset_frame_of = row_of};
    struct spin_camera_path d = {0};
    struct spin_camera got[2];
    FILE *file;
    double worst = 0;
    bool good;

    snprintf(path, sizeof path, "%s", in_folder("path.json"));
    file = fopen(path, "w");
    good = file && fputs(text, file) >= 0 && fclose(file) == 0 &&
           spin_camera_path_begin(&d, &job) == SPIN_OK && d.n_pictures == 2 && d.fps == 12.5;
    for (int i = 0; i < 2 && good; i++)
        good = spin_camera_path_camera(&d, i, &splats, &got[i]) == SPIN_OK;
    if (!ok(good, "a camera path of nerfstudio: %s", good ? "" : spin_last_error()))
        return;
    for (int k = 0; k < 24; k++)
        worst = larger(worst, fabs(got[k / 12].w2c[k % 12] - want[k / 12][k % 12]));
    ok(worst < 1e-12, "its matrices, of cameras that look back along z: %g off", worst);
    ok(got[0].width == 300 && got[0].height == 200 && fabs(got[0].fx - 100) < 1e-9 &&
           fabs(got[0].fy - 100) < 1e-9 && got[0].cx == 150 && got[0].cy == 100,
       "90 degrees from top to bottom");
    ok(fabs(got[1].fy - 90 * 200.0 / 36) < 1e-9 && fabs(got[1].cy - 11 * 200.0 / 36) < 1e-9,
       "without a field of view, the lens of the data set");
    spin_camera_path_free(&d);
}

/* One side only, and invalid numbers. */
static void test_file_size(void)
{
    static const char *const bad[] = {"\"render_width\": 300", "\"render_height\": 200",
                                      "\"render_width\": 300.5, \"render_height\": 200",
                                      "\"render_width\": 300, \"render_height\": null",
                                      "\"render_width\": 300, \"render_height\": 8"};
    const char *path = in_folder("size.json");

    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        struct spin_path_file f = {0};
        FILE *file = fopen(path, "w");

        ok(file &&
               fprintf(file,
                       "{%s, \"camera_path\": [{\"camera_to_world\": [1,0,0,1,0,1,0,2,0,0,1,3]}]}",
                       bad[i]) > 0 &&
               fclose(file) == 0,
           "a file");
        ok(spin_path_file_open(path, &f) != SPIN_OK && strstr(spin_last_error(), "expected"),
           "%s: %s", bad[i], spin_last_error());
    }
}

/* The context declares which frame is the first with splats. */
static spin_status frame_again(void *context, int frame, const struct spin_splats **out)
{
    static struct spin_splats s;

    make_frame(&s, frame < *(int *)context ? 0 : 40, 0, 5);
    for (size_t i = 0; i < 3 * s.n; i++)
        s.means[i] += 500;
    *out = &s;
    return SPIN_OK;
}

/* A clip that begins with empty frames, without a data set: the camera faces the place where its
 * splats will appear. */
static void test_late_splats(void)
{
    static const size_t counts[2][3] = {{0, 0, 40}, {40, 40, 40}};
    struct spin_splats none = {0};

    for (int k = 0; k < 3;
         k++) { /* counts are known, counts are unknown, and the first frame has splats */
        int first = k == 2 ? 0 : 2;
        struct spin_plugin_values values = {NULL};
        struct spin_export_job job = {.n_frames = 3,
                                      .values = &values,
                                      .counts = k == 1 ? NULL : counts[k / 2],
                                      .again = frame_again,
                                      .context = &first};
        struct spin_camera_path d = {0};
        struct spin_camera camera;

        ok(spin_camera_path_begin(&d, &job) == SPIN_OK &&
               spin_camera_path_camera(&d, 0, &none, &camera) == SPIN_OK,
           "a path");
        ok(fabs(d.initial.target[0] - 500) < 5, "looks at %g", d.initial.target[0]);
        spin_camera_path_free(&d);
    }
}

/* The same vertical field of view; the centre of the image is unchanged. */
static void test_resize(void)
{
    static const int size[][2] = {{100, 60}, {30, 96}, {64, 48}, {0, 0}};
    static const double want[][4] = {{70 * 1.25, 55 * 1.25, 50 - 12 * 1.25, 33 * 1.25},
                                     {140, 110, 15 - 24, 66},
                                     {70, 55, 20, 33},
                                     {70, 55, 20, 33}};

    for (int i = 0; i < 4; i++) {
        struct spin_camera_path d = {.size = {size[i][0], size[i][1]}};
        struct spin_camera c = train_lens;

        spin_camera_path_resize(&d, &c);
        ok(c.width == (i < 3 ? size[i][0] : 64) && c.height == (i < 3 ? size[i][1] : 48) &&
               fabs(c.fx - want[i][0]) + fabs(c.fy - want[i][1]) + fabs(c.cx - want[i][2]) +
                       fabs(c.cy - want[i][3]) <
                   1e-9,
           "--size %dx%d: %g %g, %g %g", size[i][0], size[i][1], c.fx, c.fy, c.cx, c.cy);
    }
}

/* ---- The path of a rig -------------------------------------------------------------------------
 */

/* The world rotated about an axis of any length, row by row of the matrix. */
static struct pose turned(const double eye[3], double x, double y, double z, double angle)
{
    double axis[3] = {x, y, z}, m[3][3];
    struct pose p;

    make_long(axis, 1);
    for (int c = 0; c < 3;
         c++) { /* the images of the unit vectors, by the parts along and across */
        double e[3] = {c == 0, c == 1, c == 2}, side[3];

        across(axis, e, side);
        for (int r = 0; r < 3; r++)
            m[r][c] =
                axis[c] * axis[r] + cos(angle) * (e[r] - axis[c] * axis[r]) + sin(angle) * side[r];
    }
    memcpy(p.eye, eye, sizeof p.eye);
    memcpy(p.right, m[0], sizeof p.right);
    memcpy(p.down, m[1], sizeof p.down);
    memcpy(p.ahead, m[2], sizeof p.ahead);
    return p;
}

static void open_path(const struct pose *pose, int n, struct spin_rig_path *path)
{
    struct spin_views stops = {0};

    for (int i = 0; i < n; i++) {
        struct spin_view v = {
            .camera_id = i, .camera = camera_of(train_lens, &pose[i]), .path = (char *)"none"};

        if (spin_views_add(&stops, &v) != SPIN_OK)
            exit(1);
    }
    ok(spin_rig_path_open(&stops, 0, path) == SPIN_OK && path->n == n, "a path of %d stops", n);
    spin_views_free(&stops);
}

static double at_share(const struct spin_rig_path *path, double share, const struct pose *want)
{
    struct spin_camera c = {0};

    spin_rig_path_camera(path, share, c.w2c);
    return pose_error(&c, want);
}

/* Halfway between two cameras: half of the distance, and half of the shorter rotation. */
static void test_turns(void)
{
    static const double axis[][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1},  {1, 1, 0},  {0, 1, 1},
                                     {1, 0, 1}, {1, 2, 3}, {3, -2, 1}, {-1, 3, -2}};
    static const double angle[][3] = {{0, 90, 45},      {180, 90, 135},  {-80, 110, -165},
                                      {170, -170, 180}, {180, 240, 210}, {10, 40, 25}};
    static const double from[3] = {1, 2, 3}, to[3] = {3, 5, 9}, half[3] = {2, 3.5, 6};

    for (size_t k = 0; k < sizeof axis / sizeof *axis; k++) {
        double worst = 0;

        for (size_t i = 0; i < sizeof angle / sizeof *angle; i++) {
            const double *a = axis[k], *turn = angle[i], d = pi / 180;
            struct pose pose[2] = {turned(from, a[0], a[1], a[2], turn[0] * d),
                                   turned(to, a[0], a[1], a[2], turn[1] * d)},
                        middle = turned(half, a[0], a[1], a[2], turn[2] * d);
            struct spin_rig_path path;

            open_path(pose, 2, &path);
            worst = larger(worst, at_share(&path, 0, &pose[0]));
            worst = larger(worst, at_share(&path, 1, &pose[1]));
            worst = larger(worst, at_share(&path, 0.5, &middle));
            near(path.stop[1].at, 7, 1e-12, "7 units of way");
            spin_rig_path_free(&path);
        }
        ok(worst < 1e-6, "turns about %g %g %g: %g off", axis[k][0], axis[k][1], axis[k][2], worst);
    }
}

/* A path through points in a tilted plane, in the order of the shortest path from the first. */
static void check_order(const double place[][2], const int *order, int n, double way,
                        const char *what)
{
    struct spin_rig_path path;
    struct pose pose[8] = {0};
    bool good = true;

    for (int i = 0; i < n; i++) { /* along two directions of length one that are at right angles */
        double eye[3] = {(2 * place[i][0] + 6 * place[i][1]) / 7,
                         (3 * place[i][0] + 2 * place[i][1]) / 7,
                         (6 * place[i][0] - 3 * place[i][1]) / 7};

        pose[i] = turned(eye, 1, 2, 3, 0.4);
    }
    open_path(pose, n, &path);
    for (int i = 0; i < n; i++)
        for (int c = 0; c < 3; c++)
            good = good && fabs(path.stop[i].eye[c] - pose[order[i]].eye[c]) < 1e-12;
    ok(good, "%s", what);
    near(path.stop[n - 1].at, way, 1e-12, "its way");
    spin_rig_path_free(&path);
}

static void test_order(void)
{
    static const double line[4][2] = {{0, 0}, {1, 0}, {-1.5, 0}, {4, 0}},
                        spread[5][2] = {{3, 3}, {0, 3}, {0, 0}, {2, 1}, {3, 0}};
    static const int line_order[4] = {0, 2, 1, 3}, spread_order[5] = {0, 3, 4, 2, 1};

    check_order(line, line_order, 4, 7, "the nearest always would cross what it has passed");
    check_order(spread, spread_order, 5, sqrt(5) + sqrt(2) + 6,
                "turning pieces round alone is not enough");
}

/* Three stops at unequal distances: cubics that meet at the middle one with a common velocity,
 * derived from its neighbours. */
static void test_curve(void)
{
    static const double eye[3][3] = {{0, 0, 0}, {1, 2, 2}, {1, 8, 10}}; /* 3 and 10 apart */
    struct spin_rig_path path;
    struct pose pose[3];
    double worst = 0;

    for (int i = 0; i < 3; i++)
        pose[i] = turned(eye[i], 3, 1, -2, 0.7);
    open_path(pose, 3, &path);
    for (int k = 0; k <= 26; k++) {
        double at = 13.0 * k / 26, want[3];
        struct pose middle;

        for (int c = 0; c < 3; c++) {
            double a = eye[0][c], b = eye[1][c], e = eye[2][c];
            double slope[3] = {(b - a) / 3, (e - a) / 13, (e - b) / 10};
            /* polynomials in the distance u from the last stop, given value and slope there and
             * at the next */
            double p0 = at < 3 ? a : b, p1 = at < 3 ? b : e, m0 = at < 3 ? slope[0] : slope[1],
                   m1 = at < 3 ? slope[1] : slope[2], h = at < 3 ? 3 : 10, u = at < 3 ? at : at - 3;
            double q = (p1 - p0) / h;

            want[c] =
                p0 + u * (m0 + u * ((3 * q - 2 * m0 - m1) / h + u * (m0 + m1 - 2 * q) / (h * h)));
        }
        middle = turned(want, 3, 1, -2, 0.7);
        worst = larger(worst, at_share(&path, at / 13, &middle));
    }
    ok(worst < 1e-9, "along a curve without a kink, at even speed: %g off", worst);
    spin_rig_path_free(&path);
}

/* ---- The first view ----------------------------------------------------------------------------
 */

static void check_first(int row, bool test, const double middle[3], double size, const char *what)
{
    const struct pose *p = &rig[row < 0 ? 0 : row][test ? 3 : 0];
    const struct spin_camera *lens = test ? &test_lens : &train_lens;
    double up[3], target[3], along = 0, off = 0, least = INFINITY, most = 0, tan_x, tan_y;
    struct spin_initial_view got;

    for (int c = 0; c < 3; c++)
        along += p->ahead[c] * (middle[c] - p->eye[c]);
    along = along > size / 10 ? along : size / 10;
    for (int c = 0; c < 3; c++)
        target[c] = p->eye[c] + along * p->ahead[c];
    for (int k = 0; k < CAMERAS; k++) {
        double away[3];

        for (int c = 0; c < 3; c++)
            away[c] = rig[row][k].eye[c] - target[c];
        least = fmin(least, sqrt(dot(away, away)));
        most = larger(most, sqrt(dot(away, away)));
    }
    mean_up(row, up);
    spin_initial_view_first(&views, NULL, row, test, middle, size, &got);
    for (int c = 0; c < 3; c++)
        off += fabs(got.eye[c] - p->eye[c]) + fabs(got.target[c] - target[c]) +
               fabs(got.up[c] - up[c]);
    ok(off < 1e-9, "%s: where it stands, what it looks at, which way is up: %g off", what, off);
    tan_x = 0.5 * lens->width / lens->fx;
    tan_y = 0.5 * lens->height / lens->fy;
    near(got.fovy_deg, 2 * atan(tan_y) * 180 / pi, 1e-9, "its height");
    near(got.aspect, tan_x / tan_y, 1e-9, "its width");
    near(got.reach[0], least / 3, 1e-9, "one may go to a third of the nearest camera's distance");
    near(got.reach[1], 1.2 * most, 1e-9, "and a little beyond the farthest");
}

static void test_first(void)
{
    static const double middle[3] = {1.5, 2.5, 2}, behind[3] = {3, 3, -40};
    struct spin_views opposed = {0};
    struct spin_initial_view got;
    double wide[2];

    check_first(1, false, middle, 2, "a training view");
    check_first(1, true, middle, 2, "a held-out view");
    check_first(2, false, middle, 2, "of another frame");
    check_first(1, false, behind, 2, "of a scene behind the camera");
    for (int k = 0; k < 2; k++) {
        struct spin_view v = {.path = (char *)"none", .camera = train_lens};
        const double m[12] = {1 - 2 * k, 0, 0, 0, 0, 1 - 2 * k, 0, 0, 0, 0, 1, 5};

        memcpy(v.camera.w2c, m, sizeof m);
        if (spin_views_add(&opposed, &v) != SPIN_OK)
            exit(1);
    }
    spin_initial_view_first(&opposed, NULL, 0, false, middle, 2, &got);
    ok(got.up[0] == 0 && got.up[1] == -1 && got.up[2] == 0,
       "cameras that stand on their heads: up is that of the first");
    spin_views_free(&opposed);
    for (int k = 0; k < 2; k++) {
        spin_initial_view_first(NULL, NULL, 0, false, middle, k ? 0.002 : 2, &got);
        wide[k] = tan(got.fovy_deg * pi / 360) * (middle[2] - got.eye[2]) / (k ? 0.002 : 2);
    }
    near(wide[1], wide[0], 1e-9, "a small scene fills as much of its picture as a large one");
    ok(got.z_near < got.reach[0] && got.z_near > 0, "and one may go as near to it");
}

/* --camera and --up. */
static spin_status choose(const struct spin_views *of, const char *camera, const char *up,
                          struct spin_initial_view *got)
{
    static const double middle[3] = {1.5, 2.5, 2};
    const char *pairs[] = {camera ? "camera" : "up", camera ? camera : up,
                           camera && up ? "up" : NULL, up, NULL};
    struct spin_plugin_values values = {pairs};
    struct spin_export_job job = {.n_frames = 1, .views = of, .values = &values};

    spin_initial_view_first(of, NULL, of ? 1 : -1, false, middle, 2, got);
    return spin_initial_view_chosen(&job, of ? 1 : -1, middle, 2, got);
}

static void test_chosen(void)
{
    struct spin_initial_view got;
    char path[600], name[24];
    double up[3];
    FILE *f;

    for (int k = 0; k < CAMERAS; k++) {
        double off = 0;

        snprintf(name, sizeof name, "%d", k);
        ok(choose(&views, name, NULL, &got) == SPIN_OK, "the view of camera %d", k);
        for (int c = 0; c < 3; c++)
            off += fabs(got.eye[c] - rig[1][k].eye[c]);
        mean_up(1, up);
        near(off, 0, 1e-9, "its position");
        near(dot(got.up, up), 1, 1e-9, "up is that of the rig");
    }
    snprintf(name, sizeof name, "%d", CAMERAS);
    ok(choose(&views, name, NULL, &got) == SPIN_E_NOT_FOUND &&
           strstr(spin_last_error(), "no camera"),
       "a camera that is not there: %s", spin_last_error());
    ok(choose(NULL, "1", NULL, &got) == SPIN_E_NOT_FOUND && strstr(spin_last_error(), "--data"),
       "a camera without a data set: %s", spin_last_error());
    snprintf(path, sizeof path, "%s/first.txt", getenv("TMPDIR") ? getenv("TMPDIR") : "/tmp");
    f = fopen(path, "w");
    if (!f)
        exit(1);
    fprintf(f, "1 0 0 7  0 0 1 8  0 -1 0 9\n1 0 0 0  0 1 0 0  0 0 1 0\n");
    fclose(f);
    ok(choose(NULL, path, NULL, &got) == SPIN_OK && got.eye[0] == 7 && got.eye[1] == 8 &&
           got.eye[2] == 9 && got.target[1] > 8 && got.up[2] == 1,
       "the first camera of a path, upright as it is");
    near(got.fovy_deg, 50, 1e-9, "with a field of view of 50 degrees");
    remove(path);
    ok(choose(&views, NULL, "-z", &got) == SPIN_OK && got.up[0] == 0 && got.up[1] == 0 &&
           got.up[2] == -1,
       "--up -z");
    ok(choose(&views, "2", "x", &got) == SPIN_OK && got.up[0] == 1, "--up x of a camera");
    ok(choose(&views, NULL, "w", &got) == SPIN_E_USAGE, "--up w: %s", spin_last_error());
}

/* --rotate: the view is rotated the other way about its target. */
static void test_rotated(void)
{
    static const char *const pairs[] = {"rotate", "90,0,0", NULL};
    struct spin_plugin_values values = {pairs};
    struct spin_export_job job = {.n_frames = 1, .values = &values};
    static const double middle[3] = {1.5, 2.5, 2};
    struct spin_initial_view got;

    spin_initial_view_first(NULL, NULL, 0, false, middle, 2, &got);
    ok(spin_initial_view_chosen(&job, 0, middle, 2, &got) == SPIN_OK, "--rotate 90,0,0");
    near(fabs(got.eye[0] - 1.5) + fabs(got.eye[1] + 3.5) + fabs(got.eye[2] - 2), 0, 1e-9,
         "the front is where y is less");
    near(fabs(got.up[0]) + fabs(got.up[1]) + fabs(got.up[2] - 1), 0, 1e-9, "z points up");
    near(fabs(got.target[0] - 1.5) + fabs(got.target[1] - 2.5) + fabs(got.target[2] - 2), 0, 1e-9,
         "the target stays");
}

/* An orbit that begins at a camera of the data set, upright in z. */
static void test_begun(void)
{
    static const char *const pairs[] = {"path", "orbit", "repeat", "12", "camera",
                                        "1",    "up",    "z",      NULL};
    struct spin_camera got[PICTURES];
    double worst = 0, eye[3];

    follow(pairs, PICTURES, got);
    for (int i = 0; i < PICTURES; i++) {
        spin_camera_centre(&got[i], eye);
        worst = larger(worst, fabs(eye[2] - rig[1][1].eye[2]));
        worst = larger(worst, fabs(got[i].w2c[2])); /* the right axis is level */
    }
    spin_camera_centre(&got[0], eye);
    for (int c = 0; c < 3; c++)
        worst = larger(worst, fabs(eye[c] - rig[1][1].eye[c]));
    near(worst, 0, 1e-9, "an orbit from camera 1, at its height in z");
}

static double ball_size = 0.03; /* of the ball's splats */

/* A small ball that moves in front of a large wall at z = 9, and a still ball of more splats. */
static spin_status read_ball(void *context, int f, const struct spin_splats **out)
{
    enum { WALL = 4000, BALL = 400, STILL = 800 };
    struct spin_splats *s = context;

    *out = s;
    SPIN_TRY(spin_splats_reserve(s, WALL + BALL + STILL, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES, 0));
    for (size_t i = 0; i < WALL + BALL + STILL; i++) {
        bool wall = i < WALL, still = i >= WALL + BALL;
        double u = (double)(i * 7919 % 1000) / 1000, v = (double)(i * 104729 % 997) / 997;

        s->means[3 * i] = (float)(wall ? 8 * u - 4 : 0.4 * u + (still ? -2 : 0.25 * f));
        s->means[3 * i + 1] = (float)(wall ? 8 * v - 4 : 0.4 * v - 1);
        s->means[3 * i + 2] = (float)(wall ? 9 : 5 + 0.4 * (double)(i % 20) / 20);
        for (size_t c = 0; c < 4; c++)
            s->quats[4 * i + c] = c == 0;
        for (size_t c = 0; c < 3; c++) {
            s->log_scales[3 * i + c] = (float)log(wall ? 0.1 : still ? 0.03 : ball_size);
            s->sh[3 * i + c] = (float)(u - v);
        }
        s->logit_opacities[i] = 3;
    }
    return SPIN_OK;
}

/* Splats that are large compared with the distances between them: the ball that contains them is
 * wider than their centres, and narrow windows show all of it. */
static void test_wide_subject(void)
{
    const char *pairs[] = {NULL};
    struct spin_plugin_values values = {pairs};
    struct spin_splats s = {0};
    struct spin_export_job job = {
        .n_frames = 8, .values = &values, .again = read_ball, .context = &s};
    struct spin_viewpoints_options o = {.width = 320, .height = 180, .up = {0, -1, 0}};
    struct spin_viewpoints placed = {0};
    static const double origin[3] = {0};
    struct spin_initial_view got;
    double square = 0;
    bool found;

    ball_size = 0.2;
    spin_initial_view_first(NULL, NULL, 0, false, origin, 1, &got);
    o.fovy_deg = got.fovy_deg;
    ok(spin_initial_view_subject(&job, 320, 180, &got, &found) == SPIN_OK && found, "a wide ball");
    ok(spin_viewpoints_open(&o, 8, read_ball, &s, &placed) == SPIN_OK, "and its size");
    for (int c = 0; c < 3; c++)
        square += pow(got.eye[c] - placed.centre[c], 2);
    near(got.keep, tan(asin(placed.radius / sqrt(square))), 1e-6, "narrow windows show all of it");
    spin_viewpoints_close(&placed);
    spin_splats_free(&s);
    ball_size = 0.03;
}

/* Without cameras, the view shows the dynamic part. */
static void test_subject(void)
{
    const char *pairs[] = {NULL, NULL, NULL}, *up[] = {"up", "y", NULL};
    static const char *const orbit[] = {"path", "orbit", "size", "320x180", NULL};
    struct spin_camera_path d = {0};
    struct spin_camera camera = {0};
    static const char *const upside[] = {"rotate", "180,0,0", NULL}, *const sideways[] = {
                                                                         "rotate", "0,90,0", NULL};
    struct spin_plugin_values values = {pairs};
    struct spin_splats s = {0};
    struct spin_export_job job = {
        .n_frames = 8, .values = &values, .again = read_ball, .context = &s};
    static const double origin[3] = {0}, ball[3] = {1.075, -0.8, 5.2};
    struct spin_initial_view got;
    double off = 0, away = 0, was[3], first[3];
    bool found;

    spin_initial_view_first(NULL, NULL, 0, false, origin, 1, &got);
    if (!ok(spin_initial_view_subject(&job, 320, 180, &got, &found) == SPIN_OK && found,
            "a view of what moves"))
        return;
    for (int c = 0; c < 3; c++) {
        off += pow(got.target[c] - ball[c], 2);
        away += pow(got.eye[c] - ball[c], 2);
    }
    ok(sqrt(off) < 0.4, "it looks at the ball: %g beside its path", sqrt(off));
    ok(sqrt(away) > 0.5 && got.eye[2] < 8.8, "from outside the ball, in front of the wall: %g, %g",
       sqrt(away), got.eye[2]);
    ok(got.keep > 0.02 && got.keep < 1 && got.up[1] == -1 && got.reach[0] < sqrt(away) &&
           got.reach[1] >= sqrt(away),
       "and knows how wide the subject is: %g", got.keep);
    memcpy(first, got.eye, sizeof first);
    values.pairs = orbit;
    found = spin_camera_path_begin(&d, &job) == SPIN_OK &&
            spin_camera_path_camera(&d, 0, &s, &camera) == SPIN_OK;
    ok(found && got.z_near > 0 && camera.z_near == got.z_near,
       "a moving camera shows what is as near: %g, %g", camera.z_near, got.z_near);
    spin_camera_path_free(&d);
    values.pairs = up;
    ok(spin_initial_view_subject(&job, 320, 180, &got, &found) == SPIN_OK && got.up[1] == 1,
       "--up y turns it");
    memcpy(was, got.eye, sizeof was);
    values.pairs = upside;
    spin_initial_view_first(NULL, NULL, 0, false, origin, 1, &got);
    ok(spin_initial_view_subject(&job, 320, 180, &got, &found) == SPIN_OK && found,
       "--rotate 180,0,0");
    near(fabs(got.up[1] - 1) + fabs(got.eye[0] - was[0]) + fabs(got.eye[1] - was[1]) +
             fabs(got.eye[2] - was[2]),
         0, 1e-9, "is the same as --up y");
    values.pairs = sideways;
    spin_initial_view_first(NULL, NULL, 0, false, origin, 1, &got);
    ok(spin_initial_view_subject(&job, 320, 180, &got, &found) == SPIN_OK && found,
       "--rotate 0,90,0");
    near(fabs(got.eye[0] - got.target[0] + first[2] - got.target[2]) +
             fabs(got.eye[2] - got.target[2] - first[0] + got.target[0]) +
             fabs(got.eye[1] - first[1]),
         0, 1e-9, "shows the scene from another side");
    job.again = NULL;
    ok(spin_initial_view_subject(&job, 320, 180, &got, &found) == SPIN_OK && !found,
       "frames that cannot be read twice");
    spin_splats_free(&s);
}

enum { ROOM = 20000, PERSON = 3000 };

/* The part of the circle on which the room has walls, and the unit of the scene. */
static double walled = 1, unit = 1;

/* A person of small splats in a round room of mostly large ones, whose floor is at y = 0. */
static spin_status read_room(void *context, int f, const struct spin_splats **out)
{
    struct spin_splats *s = context;

    (void)f;
    *out = s;
    SPIN_TRY(spin_splats_reserve(s, ROOM + PERSON, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES, 0));
    for (size_t i = 0; i < ROOM + PERSON; i++) {
        double u = (double)spin_rng_uniform(5, 0, i), v = (double)spin_rng_uniform(5, 1, i);
        double w = (double)spin_rng_uniform(5, 2, i), r = i % 2 ? 4 * sqrt(v) : 4,
               turn = 2 * pi * (0.35 + walled * u);
        bool person = i >= ROOM;

        s->means[3 * i] = (float)(unit * (person ? 0.3 * u - 2.3 : r * cos(turn)));
        s->means[3 * i + 1] = (float)(unit * (person ? -1.8 * v : i % 2 ? 0 : -4 * v));
        s->means[3 * i + 2] = (float)(unit * (person ? 0.4 * w - 0.7 : r * sin(turn)));
        for (size_t c = 0; c < 4; c++)
            s->quats[4 * i + c] = c == 0;
        for (size_t c = 0; c < 3; c++) {
            s->log_scales[3 * i + c] = (float)log(unit * (person       ? 0.015
                                                          : i % 8 == 1 ? 0.03
                                                                       : 0.1));
            s->sh[3 * i + c] = (float)(u - v);
        }
        s->logit_opacities[i] = 3;
    }
    return SPIN_OK;
}

/* The view of a single frame of a room without cameras shows the person in it as a whole. */
static void test_room(void)
{
    const char *pairs[] = {NULL};
    struct spin_plugin_values values = {pairs};
    struct spin_splats s = {0};
    struct spin_export_job job = {
        .n_frames = 1, .values = &values, .again = read_room, .context = &s};
    static const double origin[3] = {0}, person[3] = {-2.15, -0.9, -0.5};
    struct spin_initial_view got;
    double off = 0, w2c[12], high = 0, wide = 0, keep;
    bool found;

    spin_initial_view_first(NULL, NULL, 0, false, origin, 1, &got);
    if (!ok(spin_initial_view_subject(&job, 1280, 720, &got, &found) == SPIN_OK && found,
            "a view of a still in a room"))
        return;
    for (int c = 0; c < 3; c++)
        off += pow(got.target[c] - person[c], 2);
    ok(sqrt(off) < 0.3, "it looks at the person: %g beside", sqrt(off));
    ok(hypot(got.eye[0], got.eye[2]) < 4 && got.eye[1] < 0, "from inside the room");
    spin_initial_view_pose(got.eye, got.target, got.up, w2c);
    for (size_t i = ROOM; i < ROOM + PERSON; i++) {
        double at[3];

        for (int r = 0; r < 3; r++) {
            at[r] = w2c[4 * r + 3];
            for (int c = 0; c < 3; c++)
                at[r] += w2c[4 * r + c] * (double)s.means[3 * i + (size_t)c];
        }
        wide = larger(wide, fabs(at[0]) / at[2]);
        high = larger(high, fabs(at[1]) / at[2]);
    }
    ok(wide < got.keep, "narrow windows show the whole person: %g of %g", wide, got.keep);
    ok(high > tan(25 * pi / 180) && high < tan(got.fovy_deg * pi / 360),
       "and so do wide ones, since the field of view is larger than 50 degrees: %g of %g", high,
       tan(got.fovy_deg * pi / 360));
    keep = got.keep;
    unit = 100;
    ok(spin_initial_view_subject(&job, 1280, 720, &got, &found) == SPIN_OK && found,
       "a room a hundred times as large");
    near(got.keep, keep, 0.01 * keep, "fills as much of the image");
    unit = 1;
    walled = 0.1;
    ok(spin_initial_view_subject(&job, 1280, 720, &got, &found) == SPIN_OK && !found,
       "without a room, the view is that of the whole scene");
    walled = 1;
    spin_splats_free(&s);
}

/* With cameras, the view is that of the training camera whose image shows the subject best. */
static void test_best_camera(void)
{
    static const double ball[3] = {1.075, -0.8, 5.2}, up[3] = {0, -1, 0};
    static const double aim[5][3] = {{1.075, -0.8, -9},
                                     {0.2, -0.8, 5.2},
                                     {1.2, -0.7, 5.2},
                                     {1.075, -2.2, 5.2},
                                     {1.075, -0.8, 5.2}};
    const char *pairs[] = {NULL, NULL, NULL};
    struct spin_plugin_values values = {pairs};
    struct spin_views of = {0};
    struct spin_splats s = {0};
    struct spin_export_job job = {
        .n_frames = 8, .values = &values, .again = read_ball, .context = &s, .views = &of};
    struct spin_initial_view got;
    double off = 0;
    bool found;

    for (int k = 0; k < 5; k++) {
        const double eye[3] = {1 + 0.3 * k, -1, 1.5};
        struct pose p = pose_towards(eye, aim[k], up, 0);
        struct spin_view v = {.camera_id = k, .path = (char *)"none", .test = k == 4};

        v.camera = camera_of(train_lens, &p);
        if (spin_views_add(&of, &v) != SPIN_OK)
            exit(1);
    }
    spin_initial_view_first(NULL, NULL, 0, false, ball, 1, &got);
    ok(spin_initial_view_subject(&job, 320, 180, &got, &found) == SPIN_OK && found,
       "a view of what moves, from a camera");
    near(fabs(got.eye[0] - 1.6) + fabs(got.eye[1] + 1) + fabs(got.eye[2] - 1.5), 0, 1e-6,
         "that which faces it and is not held out");
    for (int c = 0; c < 3; c++)
        off += pow(got.target[c] - ball[c], 2);
    ok(sqrt(off) < 0.5 && got.up[1] < -0.9 && got.keep > 0.2 && got.keep < 0.7,
       "the target is the ball, %g beside its path; narrow windows show %g", sqrt(off), got.keep);
    pairs[0] = "up";
    pairs[1] = "z";
    ok(spin_initial_view_subject(&job, 320, 180, &got, &found) == SPIN_OK && got.up[2] == 1,
       "--up wins over the cameras");
    pairs[0] = NULL;
    for (size_t i = 0; i < 5; i++)
        of.view[i].test = true;
    ok(spin_initial_view_subject(&job, 320, 180, &got, &found) == SPIN_OK &&
           fabs(got.eye[0] - 2.2) < 1e-6,
       "if all cameras are held out, the best of them: %g", got.eye[0]);
    spin_views_free(&of);
    spin_splats_free(&s);
}

/* z is vertical: the camera is on the axis y. */
static void test_up(void)
{
    static const double z[3] = {0, 0, 1}, middle[3] = {1, 2, 3};
    const char *pairs[] = {"up", "-z", NULL};
    struct spin_plugin_values values = {pairs};
    struct spin_export_job job = {.n_frames = 1, .values = &values, .up = z};
    struct spin_initial_view got;

    spin_initial_view_first(NULL, z, 0, false, middle, 2, &got);
    ok(got.up[2] == 1 && got.eye[0] == 1 && got.eye[1] == 2 - 6 && got.eye[2] == 3 &&
           got.target[1] == 2,
       "in front of a scene in which z points up");
    spin_initial_view_first(NULL, NULL, 0, false, middle, 2, &got);
    ok(got.up[1] == -1 && got.eye[1] == 2 && got.eye[2] == 3 - 6, "by default, -y points up");
    ok(spin_initial_view_chosen(&job, 0, middle, 2, &got) == SPIN_OK && got.up[2] == -1 &&
           got.eye[1] == 2 - 6 && got.eye[2] == 3,
       "--up -z moves the camera out of the vertical axis");
    spin_initial_view_first(&views, z, 1, false, middle, 2, &got);
    ok(got.up[2] != 1, "cameras win over the vector of the bundle");
}

/* Medians, and the half extent of nine splats in ten, ignoring nonfinite ones. */
static void test_middle(void)
{
    enum { N = 101 };
    struct spin_splats s = {0};
    double middle[3], size;

    make_frame(&s, N + 1, 0, 4);
    for (int i = 0; i < N; i++) {
        s.means[3 * i] = (float)(i * 37 % N); /* 0 to 100 */
        s.means[3 * i + 1] = s.means[3 * i] < 3 ? -5000 : 10 + 3 * s.means[3 * i];
        s.means[3 * i + 2] = s.means[3 * i] > 97 ? 9000 : 7;
    }
    for (int c = 0; c < 3; c++)
        s.means[3 * N + c] = NAN;
    ok(spin_initial_view_middle(&s, middle, &size) == SPIN_OK && middle[0] == 50 &&
           middle[1] == 160 && middle[2] == 7,
       "the middle: %g %g %g", middle[0], middle[1], middle[2]);
    near(size, 135, 1e-9, "of 95 * 3 less 5 * 3, half");
    spin_splats_free(&s);
}

/* Viewing directions without a common point, or with one behind the cameras. */
static void test_pivot(void)
{
    struct spin_views other = {0};
    double at[3] = {0}, median = 0;

    ok(spin_camera_pivot(&views, 1, at, &median) &&
           fabs(at[0] - 1) + fabs(at[1] - 2) + fabs(at[2] - 3) < 1e-9,
       "the place that all look at");
    near(median, 5, 1e-9, "half of them are as near");
    for (int k = 0; k < 3;
         k++) { /* towards a place that is a thousand times as far as they are apart */
        double eye[3] = {k, k % 2, 4}, target[3] = {0, 0, -996};
        struct pose p;
        struct spin_view v = {.camera_id = k, .path = (char *)"none"};

        p = pose_towards(eye, target, (const double[3]){0, 1, 0.1}, k);
        v.camera = camera_of(train_lens, &p);
        if (spin_views_add(&other, &v) != SPIN_OK)
            exit(1);
    }
    ok(!spin_camera_pivot(&other, 0, at, &median),
       "cameras that look about the same way have none");
    for (int k = 0; k < 3; k++) { /* a ring that looks outwards */
        double eye[3] = {cos(2.1 * k), 0.1, sin(2.1 * k)},
               target[3] = {9 * eye[0], 0.2, 9 * eye[2]};
        struct pose p = pose_towards(eye, target, (const double[3]){0, 1, 0}, 0.1);

        other.view[k].camera = camera_of(train_lens, &p);
    }
    ok(!spin_camera_pivot(&other, 0, at, &median), "nor have those that look away from it");
    spin_views_free(&other);
}

TAP_MAIN
{
    spin_log_set_level(-2);
    make_rig();
    make_frame(&splats, 20, 0, 6);
    test_orbit();
    test_spiral();
    test_train();
    test_pace();
    test_length();
    test_file();
    test_file_size();
    test_late_splats();
    test_resize();
    test_turns();
    test_order();
    test_curve();
    test_first();
    test_chosen();
    test_rotated();
    test_begun();
    test_subject();
    test_wide_subject();
    test_room();
    test_best_camera();
    test_up();
    test_middle();
    test_pivot();
    spin_splats_free(&splats);
    spin_views_free(&views);
}
