/* geometry/camera_rig.h: which cameras are at the edge of a rig, and holding them out.  K: views */

#include "geometry/camera_rig.h"
#include "scene/dataset.h"
#include "tests/tap.h"

/* Sets `views` to two frames of the cameras 0 to n - 1, all for training. */
static void make_views(struct spin_views *views, int n)
{
    memset(views, 0, sizeof *views);
    for (int i = 0; i < 2 * n; i++) {
        struct spin_view v = {.dataset_frame = i / n, .camera_id = i % n, .number = -1};

        v.path = (char[]){"none.png"};
        if (spin_views_add(views, &v) != SPIN_OK)
            exit(1);
    }
    views->n_dataset_frames = 2;
}

static size_t count_positions(const struct spin_views *views)
{
    size_t n = 0;

    ok(spin_views_count_positions(views, &n) == SPIN_OK, "positions are counted");
    return n;
}

/* Places a camera on a circle of radius 4 around the point (0, 0, 4), towards which it looks; at
 * angle 0 it is at the origin. */
static void circle_at(struct spin_view *view, double degrees)
{
    double c = cos(degrees * M_PI / 180), s = sin(degrees * M_PI / 180);
    const double w2c[12] = {c, 0, s, -4 * s, 0, 1, 0, 0, -s, 0, c, 4 - 4 * c};

    memcpy(view->camera.w2c, w2c, sizeof w2c);
}

static void test_outer(void)
{
    static const double at[] = {-20, 0, 60};
    struct spin_views views;
    struct spin_camera_cone cone;

    make_views(&views, 3);
    for (size_t i = 0; i < views.n; i++)
        circle_at(&views.view[i], at[i % 3]);
    ok(count_positions(&views) == 3, "three positions in two frames");
    ok(spin_outer_cameras_hold(&views, 2) == SPIN_E_USAGE && !views.view[2].test,
       "two cameras must remain: %s", spin_last_error());
    ok(spin_outer_cameras_hold(&views, 1) == SPIN_OK && views.view[2].test && views.view[5].test &&
           !views.view[0].test && !views.view[1].test,
       "the camera is held out that is farthest from the others");
    ok(count_positions(&views) == 2, "two training cameras remain");
    ok(spin_camera_cone_open(&views, &cone) == SPIN_OK &&
           spin_camera_cone_excludes(&cone, &views.view[2].camera),
       "it is outside the cone of the others");
    circle_at(&views.view[2], -10);
    ok(!spin_camera_cone_excludes(&cone, &views.view[2].camera),
       "a camera between them is inside, though it protrudes from their hull");
    circle_at(&views.view[2], 2);
    ok(!spin_camera_cone_excludes(&cone, &views.view[2].camera), "2 degrees do not count");
    circle_at(&views.view[2], 8);
    ok(spin_camera_cone_excludes(&cone, &views.view[2].camera), "8 degrees count");
    spin_views_free(&views);
}

static void test_refused(void)
{
    struct spin_views views;
    struct spin_camera_cone cone;

    make_views(&views, 8);
    for (size_t i = 0; i < views.n; i++) {
        circle_at(&views.view[i], 45.0 * (double)i);
        views.view[i].camera.w2c[7] = i % 2 ? 1 : -1; /* above or below the plane of the circle */
    }
    ok(spin_outer_cameras_hold(&views, 1) == SPIN_E_USAGE &&
           strstr(spin_last_error(), "surround the scene"),
       "cameras all around: %s", spin_last_error());
    for (size_t i = 0; i < views.n; i++) {
        circle_at(&views.view[i], 0);
        views.view[i].camera.w2c[3] = (double)(i % 8);
    }
    ok(spin_outer_cameras_hold(&views, 1) == SPIN_E_UNSUPPORTED &&
           spin_camera_cone_open(&views, &cone) == SPIN_E_UNSUPPORTED &&
           strstr(spin_last_error(), "do not look at a common point"),
       "parallel cameras: %s", spin_last_error());
    spin_views_free(&views);
}

TAP_MAIN
{
    test_outer();
    test_refused();
}
