/* K: viewpoints cameras
 *
 * Cameras are placed inside rooms and around subjects, with a free view of what moves; and a scene
 * that is turned upside down and scaled has the same cameras, turned and scaled. */
#include "base/number.h"
#include "geometry/viewpoints.h"
#include "geometry/voxels.h"
#include "math/rng.h"
#include "../tap.h"

enum { ROOM = 20000, BODY = 600, FRAMES = 9, CAMERAS = 24, TESTS = 8, WIDTH = 320, HEIGHT = 180 };
#define RADIUS 3.0 /* of the room */

struct scene {
    bool room;
    int bodies;
    double scale; /* of the twin */
    bool turned;  /* the twin: y up */
    bool moves;
    bool detail;
    bool flickers; /* a part of the room changes its colour in every frame */
    bool fine;     /* the splats of bodies are small */
    bool sky;      /* the half sphere is a wide sky, so the scene is not indoors */
    struct spin_splats splats;
};

static double uniform(uint64_t stream, uint64_t i)
{
    return (double)spin_rng_uniform(3, stream, i);
}

static void put_splat(struct scene *s, size_t i, const double at[3], double size)
{
    struct spin_splats *o = &s->splats;
    double turn = s->turned ? -1 : 1;

    for (size_t c = 0; c < 3; c++) {
        o->means[3 * i + c] = (float)(at[c] * s->scale * (c > 0 ? turn : 1));
        o->log_scales[3 * i + c] = (float)log(size * s->scale);
        o->sh[3 * i + c] = (float)uniform(c, i % 50);
        o->quats[4 * i + c] = c == 0;
    }
    o->quats[4 * i + 3] = 0;
    o->logit_opacities[i] = 2;
}

/* A half sphere above a floor at y = 0, and y is down. */
static void put_room(struct scene *s, size_t i)
{
    double z = uniform(5, i), angle = 6.2832 * uniform(6, i), flat = sqrt(1 - z * z);
    double radius = s->sky ? 100 * RADIUS : RADIUS;
    double wall[3] = {radius * flat * cos(angle), -radius * z, radius * flat * sin(angle)};
    double floor[3] = {radius * sqrt(z) * cos(angle), 0, radius * sqrt(z) * sin(angle)};

    put_splat(s, i, i % 3 || s->sky ? wall : floor, 0.02 * radius);
}

/* A ball that swings beside the middle of the room; or two; or two, one twice as dense. */
static void put_body(struct scene *s, size_t i, int f)
{
    double swing = s->moves ? 0.35 * sin(0.9 * f) : 0, at[3];
    int body = (int)(i % (size_t)s->bodies);

    for (int c = 0; c < 3; c++)
        at[c] = 0.5 * (uniform(7 + (uint64_t)c, i) - 0.5);
    at[0] += 0.5 + swing;
    at[1] -= 0.9;
    at[2] += body != 1 ? 0.4 : -0.8;
    put_splat(s, s->splats.n - BODY + i, at, s->fine ? 0.0005 : 0.015);
}

static spin_status read_frame(void *context, int f, const struct spin_splats **out)
{
    struct scene *s = context;
    size_t n = (s->room ? ROOM : 0) + BODY;

    *out = &s->splats;
    SPIN_TRY(spin_splats_reserve(&s->splats, n, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES, 0));
    for (size_t i = 0; i + BODY < n; i++) {
        put_room(s, i);
        if (s->flickers && uniform(20 + (uint64_t)f, i) < 0.15)
            s->splats.sh[3 * i] += 2;
    }
    for (size_t i = 0; i < BODY; i++)
        put_body(s, i, f);
    return SPIN_OK;
}

static void find_eye(const struct spin_camera *c, const struct scene *s, double eye[3])
{
    const double *m = c->w2c;

    for (int a = 0; a < 3; a++)
        eye[a] = -(m[a] * m[3] + m[4 + a] * m[7] + m[8 + a] * m[11]) / s->scale *
                 (s->turned && a > 0 ? -1 : 1);
}

static void place_cameras(struct scene *s, struct spin_viewpoints *p)
{
    struct spin_viewpoints_options o = {.n_cameras = CAMERAS,
                                        .n_test = TESTS,
                                        .width = WIDTH,
                                        .height = HEIGHT,
                                        .fovy_deg = 50,
                                        .up = {0, s->turned ? 1 : -1, 0},
                                        .detail = s->detail};

    ok(spin_viewpoints_open(&o, FRAMES, read_frame, s, p) == SPIN_OK, "places %d cameras: %s",
       CAMERAS + TESTS, spin_last_error());
}

/* Returns the number of cameras that have less than half of a body inside their image. */
static int count_blind(struct scene *s, const struct spin_viewpoints *p, int body, int *n_seen)
{
    const struct spin_splats *splats;
    int blind = 0;

    *n_seen = 0;
    ok(read_frame(s, 0, &splats) == SPIN_OK, "reads");
    for (int k = 0; k < p->n; k++) {
        int inside = 0;
        double at[3];

        for (size_t i = 0; i < BODY; i++)
            inside += (int)(i % (size_t)s->bodies) == body &&
                      spin_camera_project_visible(&p->camera[k].camera,
                                                  splats->means + 3 * (splats->n - BODY + i), at);
        blind += inside < BODY / s->bodies / 2;
        *n_seen += inside >= BODY / s->bodies / 2 && !p->camera[k].test;
    }
    return blind;
}

static void check_room(bool flickers)
{
    struct scene s = {.room = true, .bodies = 1, .scale = 1, .moves = true, .flickers = flickers};
    struct spin_viewpoints p = {0};
    int outside = 0, n_seen;

    place_cameras(&s, &p);
    ok(p.room && p.n == CAMERAS + TESTS, "the room is one, with all cameras");
    near(p.centre[0], 0.5, 0.15, "the subject is where the ball swings, x");
    near(p.centre[1], -0.9, 0.1, "and y");
    near(p.centre[2], 0.4, 0.1, "and z");
    ok(p.radius < 0.7, "it is small: %.2f", p.radius);
    for (int k = 0; k < p.n; k++) {
        double eye[3];

        find_eye(&p.camera[k].camera, &s, eye);
        outside += eye[1] > -0.02 ||
                   sqrt(eye[0] * eye[0] + eye[1] * eye[1] + eye[2] * eye[2]) > RADIUS - 0.05;
    }
    ok(outside == 0, "no camera is outside the room or below its floor: %d", outside);
    ok(count_blind(&s, &p, 0, &n_seen) == 0, "every camera has the ball in its image");
    ok(p.few_moving == 0 && p.few_static < 0.5, "three or more see all that moves: %g, %g",
       p.few_moving, p.few_static);
    ok(p.free_circle && p.front[2] > p.centre[2] - RADIUS - 0.5 && p.front[2] < p.centre[2] &&
           p.front[1] < p.centre[1],
       "the circle is free, and begins in front, above");
    spin_viewpoints_close(&p);
    spin_splats_free(&s.splats);
}

static void check_two_bodies(void)
{
    struct scene s = {.room = true, .bodies = 2, .scale = 1, .moves = true};
    struct spin_viewpoints p = {0};
    int n_seen[2], n_between = 0;

    place_cameras(&s, &p);
    for (int b = 0; b < 2; b++)
        count_blind(&s, &p, b, &n_seen[b]);
    ok(n_seen[0] >= CAMERAS / 2 && n_seen[1] >= CAMERAS / 2, "both players are in view: %d, %d",
       n_seen[0], n_seen[1]);
    for (int k = 0; k < p.n; k++) {
        const struct spin_camera *c = &p.camera[k].camera;
        double off[3] = {INFINITY, INFINITY, INFINITY}, at[3];

        for (int b = 0; b < 3; b++)
            if (spin_camera_project(c, (const float[3]){0.5f, -0.9f, 0.4f - 0.6f * (float)b}, at))
                off[b] = hypot(at[0] - c->cx, at[1] - c->cy);
        n_between += off[1] < off[0] && off[1] < off[2];
    }
    ok(n_between <= 2 * p.n / 3, "many look at one of them, %d between them", n_between);
    spin_viewpoints_close(&p);
    spin_splats_free(&s.splats);
}

static void check_subject(bool moves)
{
    struct scene s = {.bodies = 1, .scale = 1, .moves = moves};
    struct spin_viewpoints p = {0};
    int n_near = 0, n_seen;

    place_cameras(&s, &p);
    ok(!p.room && p.n == CAMERAS + TESTS, "a subject alone is no room");
    for (int k = 0; k < p.n; k++) {
        double eye[3];

        find_eye(&p.camera[k].camera, &s, eye);
        n_near += sqrt(pow(eye[0] - 0.5, 2) + pow(eye[1] + 0.9, 2) + pow(eye[2] - 0.4, 2)) < 0.5;
    }
    ok(n_near == 0 && count_blind(&s, &p, 0, &n_seen) == 0,
       "all cameras see it from outside: %d are near", n_near);
    spin_viewpoints_close(&p);
    spin_splats_free(&s.splats);
}

/* A room is not left out because a body in it is more detailed. */
static void check_fine_body(void)
{
    struct scene s = {.room = true, .fine = true, .bodies = 1, .scale = 1, .detail = true};
    struct spin_viewpoints p = {0};

    place_cameras(&s, &p);
    ok(p.room && p.n == CAMERAS + TESTS, "a detailed body is in a room");
    spin_viewpoints_close(&p);
    spin_splats_free(&s.splats);
}

/* Below a sky, cameras stand around the body, not around the sky. */
static void check_sky(void)
{
    struct scene s = {.room = true, .sky = true, .bodies = 1, .scale = 1, .moves = true};
    struct spin_viewpoints p = {0};
    double nearest = INFINITY, farthest = 0;
    int n_seen;

    place_cameras(&s, &p);
    ok(!p.room && p.moves && p.n == CAMERAS + TESTS, "a sky is no room");
    for (int k = 0; k < p.n; k++) {
        double eye[3], away;

        find_eye(&p.camera[k].camera, &s, eye);
        away = sqrt(pow(eye[0] - 0.5, 2) + pow(eye[1] + 0.9, 2) + pow(eye[2] - 0.4, 2));
        nearest = fmin(nearest, away);
        farthest = fmax(farthest, away);
    }
    ok(nearest > 0.5 && farthest < 4, "cameras are near the body: %g to %g", nearest, farthest);
    ok(count_blind(&s, &p, 0, &n_seen) == 0, "and all of them see it");
    spin_viewpoints_close(&p);
    spin_splats_free(&s.splats);
}

/* The densest part of a static clip is the denser of two bodies, not both. */
static void check_denser(void)
{
    struct scene s = {.bodies = 3, .scale = 1};
    struct spin_viewpoints p = {0};

    place_cameras(&s, &p);
    ok(!p.moves, "nothing moves");
    near(p.centre[2], 0.4, 0.05, "the subject is the denser body");
    ok(p.radius > 0.2 && p.radius < 0.4, "alone: %.2f", p.radius);
    spin_viewpoints_close(&p);
    spin_splats_free(&s.splats);
}

/* A static body in a room: the detail is the body, and without `detail` the subject is a wall. */
static void check_detail(bool detail, double scale)
{
    struct scene s = {.room = true, .bodies = 1, .scale = scale, .detail = detail};
    struct spin_viewpoints p = {0};
    const double body[3] = {0.5, -0.9, 0.4};
    double off = 0;

    place_cameras(&s, &p);
    for (int c = 0; c < 3; c++)
        off += pow(p.centre[c] / scale - body[c], 2);
    ok(!p.moves && (sqrt(off) < 0.1) == detail && (p.radius < 0.6 * scale) == detail,
       "%s: %g from the body, with a radius of %g", detail ? "the body" : "a wall", sqrt(off),
       p.radius);
    ok(!detail || p.room, "a body in a room");
    spin_viewpoints_close(&p);
    spin_splats_free(&s.splats);
}

static void check_twin(void)
{
    struct scene a = {.room = true, .bodies = 1, .scale = 1, .moves = true};
    struct scene b = {.room = true, .bodies = 1, .scale = 100, .turned = true, .moves = true};
    struct spin_viewpoints p = {0}, q = {0};
    double worst = 0;

    place_cameras(&a, &p);
    place_cameras(&b, &q);
    for (int k = 0; k < p.n && k < q.n; k++) {
        double eye[3], other[3];

        find_eye(&p.camera[k].camera, &a, eye);
        find_eye(&q.camera[k].camera, &b, other);
        for (int c = 0; c < 3; c++)
            worst = larger(worst, fabs(eye[c] - other[c]));
        worst = larger(worst, fabs(p.camera[k].camera.w2c[8] - q.camera[k].camera.w2c[8]));
    }
    ok(p.n == q.n && worst < 0.02, "the twin has the same cameras: %g", worst);
    spin_viewpoints_close(&p);
    spin_viewpoints_close(&q);
    spin_splats_free(&a.splats);
    spin_splats_free(&b.splats);
}

static spin_status read_points(void *context, int f, const struct spin_splats **out)
{
    (void)f;
    *out = context;
    return SPIN_OK;
}

enum { CORNERS = 8 };

/* Small splats at the corners of a cube, and a large disc, `turns` times a quarter turn about z. */
static spin_status read_haze(void *context, int f, const struct spin_splats **out)
{
    static struct spin_splats s;
    const int *quarter_turns = context;
    double half = *quarter_turns * M_PI / 4;

    (void)f;
    *out = &s;
    SPIN_TRY(spin_splats_reserve(&s, CORNERS + 1, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES, 0));
    for (size_t i = 0; i <= CORNERS; i++) {
        for (size_t c = 0; c < 3; c++) {
            s.means[3 * i + c] = i == CORNERS ? 0 : i >> c & 1 ? 4 : -4;
            s.log_scales[3 * i + c] = logf(0.001f);
            s.sh[3 * i + c] = 0;
        }
        memcpy(s.quats + 4 * i, (const float[4]){1, 0, 0, 0}, 4 * sizeof(float));
        s.logit_opacities[i] = 0;
    }
    s.log_scales[3 * CORNERS] = logf(2);
    s.log_scales[3 * CORNERS + 1] = logf(1);
    s.quats[4 * CORNERS] = (float)cos(half);
    s.quats[4 * CORNERS + 3] = (float)sin(half);
    return SPIN_OK;
}

/* The optical depth of a large splat is its opacity times its Gaussian. Cells contain different
 * numbers of samples, which only a mean over many rays hides. */
static void check_haze(int turns)
{
    struct spin_voxels v;
    double worst = 0, sum[2] = {0};

    ok(spin_voxels_open(&v, 1, read_haze, &turns) == SPIN_OK, "opens");
    for (double x = -3; x <= 3; x += 0.05) {
        const double from[3] = {turns ? 0 : x, turns ? x : 0, -3}, along[3] = {0, 0, 6};
        double want = 0.5 * exp(-x * x / 8);
        double depth = spin_voxels_depth(&v, v.haze, from, along, 400);

        worst = larger(worst, fabs(depth / want - 1));
        sum[0] += depth;
        sum[1] += want;
    }
    ok(worst < 0.5, "the optical depth of a large splat: %g", worst);
    near(sum[0] / sum[1], 1, 0.1, "mean optical depth");
    spin_voxels_close(&v);
}

static void check_refusals(void)
{
    struct spin_splats points = {0};
    struct spin_viewpoints_options o = {
        .n_cameras = CAMERAS, .width = WIDTH, .height = HEIGHT, .fovy_deg = 50};
    struct spin_viewpoints p = {0};

    ok(spin_splats_reserve(&points, 0, SPIN_COL_MEANS, 0) == SPIN_OK, "reserves");
    ok(spin_viewpoints_open(&o, 1, read_points, &points, &p) == SPIN_E_UNSUPPORTED &&
           strstr(spin_last_error(), "no frame contains a splat"),
       "empty frames are refused");
    ok(spin_splats_reserve(&points, 4, SPIN_COL_MEANS, 0) == SPIN_OK, "reserves");
    memset(points.means, 0, 12 * sizeof *points.means);
    ok(spin_viewpoints_open(&o, 1, read_points, &points, &p) == SPIN_E_UNSUPPORTED &&
           strstr(spin_last_error(), "without opacities"),
       "points are refused");
    spin_splats_free(&points);
}

TAP_MAIN
{
    check_room(false);
    check_room(true);
    check_two_bodies();
    check_subject(true);
    check_subject(false);
    check_fine_body();
    check_sky();
    check_denser();
    check_detail(false, 1);
    check_detail(true, 1);
    check_detail(true, 100);
    check_twin();
    check_haze(0);
    check_haze(1);
    check_refusals();
}
