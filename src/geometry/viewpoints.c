#include "geometry/viewpoints.h"

#include "base/base.h"
#include "math/rng.h"

#define LOWEST (-0.1)      /* directions whose elevation has a smaller sine are not used */
#define WALL_DEPTH 0.7     /* optical depth at which a ray ends in a wall */
#define FREE_SHARE 0.03    /* a view is free if covered_share() is below this */
#define INWARDS 0.93       /* factor on a camera's distance in each step inwards */
#define LEAST_DISTANCE 1.2 /* smallest distance of a camera, in radii of the subject */
#define MOST_DISTANCE                                                                              \
    5.0 /* largest distance, in radii of the subject: the scene may be unbounded */
enum {
    DIRECTIONS = 200, /* number of rays that decide whether the scene is a room */
    TRIES = 8,        /* largest number of steps inwards to find a free view */
    ACROSS = 16,      /* columns and rows of the grid of rays that probes a view */
    DOWN = 9,
    SAMPLES = 40,     /* sample points along each of these rays */
    MOST_PLACES = 60, /* directions to try per camera before the search ends */
    TARGETS = 400,    /* number of targets in the subject, and again in the whole scene */
    DRAWS = 4000,     /* largest number of random draws to find TARGETS targets */
    AIMS = 13,        /* number of points among which each camera chooses its target */
    LEAST_CAMERAS = 8,
    AZIMUTHS = 24, /* positions on a circle */
};
/* Numbers of independent random streams. */
enum { NEAR_CENTRE = 2, DISTANCE, AIM, SUBJECT, REST };

struct target {
    double at[3], weight;
    bool moves; /* true: sampled from the subject; false: sampled from the whole scene */
    int draw;   /* index of the random draw that selected this target */
    int seen;   /* number of cameras whose image contains this target */
};

struct placing {
    const struct spin_viewpoints_options *o;
    struct spin_viewpoints *out;
    const struct spin_voxels *v;
    const struct spin_subject *subject;
    double axis[3][3]; /* two horizontal axes, and up */
    double half[2];    /* tangents of half the field of view: horizontal and vertical */
    double far;        /* largest distance of a camera from the centre */
    struct target *target;
    int n_targets, n_moving; /* the first n_moving targets are those of the subject */
};

/* ---- Vectors --------------------------------------------------------------------------------- */

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static void cross(const double a[3], const double b[3], double out[3])
{
    for (int c = 0; c < 3; c++)
        out[c] = a[(c + 1) % 3] * b[(c + 2) % 3] - a[(c + 2) % 3] * b[(c + 1) % 3];
}

static void make_unit(double v[3])
{
    double length = sqrt(dot(v, v)) + 1e-300;

    for (int c = 0; c < 3; c++)
        v[c] /= length;
}

static void add_scaled(const double a[3], double t, const double b[3], double out[3])
{
    for (int c = 0; c < 3; c++)
        out[c] = a[c] + t * b[c];
}

static double distance_to(const double a[3], const double b[3])
{
    double v[3];

    add_scaled(a, -1, b, v);
    return sqrt(dot(v, v));
}

/* Sets the rows of `axis` to the camera's directions right, down and forward. */
static void find_axes(const double eye[3], const double target[3], const double up[3],
                      double axis[3][3])
{
    add_scaled(target, -1, eye, axis[2]);
    make_unit(axis[2]);
    cross(axis[2], up, axis[0]);
    make_unit(axis[0]);
    cross(axis[2], axis[0], axis[1]);
}

void spin_viewpoints_set_pose(const double eye[3], const double target[3], const double up[3],
                              struct spin_camera *camera)
{
    double axis[3][3];

    find_axes(eye, target, up, axis);
    for (int r = 0; r < 3; r++) {
        memcpy(camera->w2c + 4 * r, axis[r], sizeof axis[r]);
        camera->w2c[4 * r + 3] = -dot(axis[r], eye);
    }
}

/* ---- Directions ------------------------------------------------------------------------------ */

/* Sets `out` to direction i of n, evenly distributed over the sphere (a Fibonacci lattice with the
 * pole at `up`) and turned around `up` by the angle `turn`. Returns false if the direction is below
 * LOWEST. */
static bool find_direction(const struct placing *p, int i, int n, double turn, double out[3])
{
    double z = 1 - 2 * (i + 0.5) / n, angle = M_PI * (1 + sqrt(5)) * (i + 0.5) + turn;
    double flat = sqrt(1 - z * z), part[3] = {flat * cos(angle), flat * sin(angle), z};

    for (int c = 0; c < 3; c++)
        out[c] = part[0] * p->axis[0][c] + part[1] * p->axis[1][c] + part[2] * p->axis[2][c];
    return z >= LOWEST;
}

/* Returns the distance from the centre to the first wall in a direction that is farther than
 * `from`; INFINITY if there is no wall up to `far`. */
static double wall_distance(const struct placing *p, double from, const double direction[3])
{
    double step = p->v->cell / 2, sum = 0;

    for (double t = from; t < p->far; t += step) {
        double at[3];
        size_t cell;

        add_scaled(p->out->centre, t, direction, at);
        cell = spin_voxels_find(p->v, at);
        sum += cell == SIZE_MAX ? 0 : (double)p->v->walls[cell] * step;
        if (sum > WALL_DEPTH)
            return t;
    }
    return INFINITY;
}

/* Sets `wall` to the sorted distances of the walls around the centre and returns their number. *n
 * is the number of directions that were searched. The small splats of a detail are no walls. */
static int list_walls(const struct placing *p, double wall[DIRECTIONS], int *n)
{
    double from = (p->o->detail ? 1 : 0.3) * p->out->radius;
    int n_walls = 0;

    *n = 0;
    for (int i = 0; i < DIRECTIONS; i++) {
        double direction[3];

        if (!find_direction(p, i, DIRECTIONS, 0, direction))
            continue;
        ++*n;
        wall[n_walls] = wall_distance(p, from, direction);
        n_walls += isfinite(wall[n_walls]);
    }
    qsort(wall, (size_t)n_walls, sizeof *wall, spin_by_double);
    return n_walls;
}

/* Returns the share of the subject's weight within a radius around the centre. */
static double share_within(const struct placing *p, double radius)
{
    double sum = 0, all = 0;

    for (size_t i = 0; i < p->subject->n; i++) {
        const float *f = p->v->splat[p->subject->splat[i]].at;
        const double at[3] = {(double)f[0], (double)f[1], (double)f[2]};

        all += p->subject->weight[i];
        sum += distance_to(at, p->out->centre) < radius ? p->subject->weight[i] : 0;
    }
    return all > 0 ? sum / all : 0;
}

/* Decides whether walls surround the subject. In a room, `far` is limited to the median distance of
 * the walls, so that cameras do not leave through openings, and the radius of a subject that fills
 * the room is reduced. In a static clip, the shell of an object looks like a room from inside, so a
 * room must also have splats in its middle. */
static void find_room(struct placing *p)
{
    double wall[DIRECTIONS];
    int n, n_walls = list_walls(p, wall, &n), first = n_walls / 10, n_far = 0;
    double middle = n_walls > 0 ? wall[first + (n_walls - first) / 2] : 0;

    if (n_walls - first <= n / 4 || (!p->subject->moves && share_within(p, middle / 2) < 0.02))
        return;
    while (first < n_walls && wall[first] <= p->out->radius)
        first++;
    n_far = n_walls - first;
    p->out->room = n_far > n / 4;
    if (!p->out->room)
        return;
    p->out->radius = fmin(p->out->radius, 0.4 * middle);
    p->far = fmin(p->far, wall[first + n_far / 2]);
}

/* ---- Camera positions ------------------------------------------------------------------------ */

/* Returns whether splats absorb at least 30 % of a ray from the eye. */
static bool is_covered(const struct placing *p, const double eye[3], const double ray[3],
                       double length)
{
    double along[3] = {length * ray[0], length * ray[1], length * ray[2]};

    return spin_voxels_depth(p->v, p->v->haze, eye, along, SAMPLES) > -log(0.7);
}

/* Measures how much of the view from `eye` towards `aim` is blocked, by a grid of rays: returns the
 * share of rays that are covered within a third of the distance to the centre, plus half the share
 * of the middle rays that are covered before they reach the subject. */
static double covered_share(const struct placing *p, const double eye[3], const double aim[3])
{
    double axis[3][3], away = distance_to(eye, p->out->centre);
    double before = fmax(0.05 * p->out->radius, away - 1.1 * p->out->radius);
    double near = 0, middle = 0;

    find_axes(eye, aim, p->out->up, axis);
    for (int y = 0; y < DOWN; y++)
        for (int x = 0; x < ACROSS; x++) {
            double u = p->half[0] * (2.0 * x / (ACROSS - 1) - 1), ray[3];
            double v = p->half[1] * (2.0 * y / (DOWN - 1) - 1);

            add_scaled(axis[2], u, axis[0], ray);
            add_scaled(ray, v, axis[1], ray);
            near += is_covered(p, eye, ray, 0.33 * away);
            if (abs(2 * x - ACROSS + 1) == 1 && abs(2 * y - DOWN + 1) <= 2)
                middle += is_covered(p, eye, ray, before);
        }
    return near / (ACROSS * DOWN) + 0.5 * middle / 6;
}

/* Moves a camera inwards until its view is free. Returns false if no position has a free view. */
static bool free_view(const struct placing *p, double eye[3])
{
    const double *centre = p->out->centre;

    for (int k = 0; k < TRIES; k++) {
        if (distance_to(eye, centre) <= LEAST_DISTANCE * p->out->radius)
            return false;
        if (covered_share(p, eye, centre) < FREE_SHARE)
            return true;
        for (int c = 0; c < 3; c++)
            eye[c] = centre[c] + INWARDS * (eye[c] - centre[c]);
    }
    return false;
}

/* Finds a position with a free view for a camera in a direction, at `scale` times the largest
 * possible distance. A wall close to the centre is probably a static part of the subject, so the
 * next wall is used instead. Returns false if there is no such position. */
static bool find_place(const struct placing *p, const double direction[3], double scale,
                       double eye[3])
{
    double radius = p->out->radius, wall = wall_distance(p, 0.3 * radius, direction);

    if (wall < 1.3 * radius)
        wall = wall_distance(p, radius, direction);
    if (wall < 1.3 * radius)
        return false;
    add_scaled(p->out->centre, scale * (isfinite(wall) ? 0.85 * wall : p->far), direction, eye);
    return free_view(p, eye);
}

/* Lists the positions with a free view in n directions, and returns their number. Each distance is
 * a random share, from `least` to 1, of the largest possible distance. */
static int list_places(const struct placing *p, int n, double turn, double least, double (*eye)[3])
{
    int n_eyes = 0;

    for (int i = 0; i < n; i++) {
        double direction[3];
        double share = (double)spin_rng_uniform(p->o->seed, DISTANCE, (uint64_t)i);

        if (find_direction(p, i, n, turn, direction) &&
            find_place(p, direction, least + (1 - least) * share, eye[n_eyes]))
            n_eyes++;
    }
    return n_eyes;
}

/* Finds positions for up to n cameras in evenly distributed directions, and sets *found to their
 * number. */
static spin_status find_places(const struct placing *p, int n, double turn, double least,
                               double (*eye)[3], int *found)
{
    SPIN_FREED double(*all)[3] = NULL;
    int tried = n + n / 5 + 1, n_all;

    SPIN_TRY(spin_alloc((size_t)n * MOST_PLACES * 2 + 2, sizeof *all, (void **)&all));
    for (;; tried += 1 + tried / 7) {
        n_all = list_places(p, tried, turn, least, all);
        if (n_all >= n || tried > MOST_PLACES * n)
            break;
    }
    *found = n_all < n ? n_all : n;
    for (int i = 0; i < *found; i++) {
        int k = *found < n_all ? (int)rint(i * (n_all - 1.0) / fmax(n - 1, 1)) : i;

        memcpy(eye[i], all[k], sizeof *all);
    }
    return SPIN_OK;
}

/* ---- A circle -------------------------------------------------------------------------------- */

/* Sets `eye` to position k of AZIMUTHS on a circle around the axis `up`; position 0 is in front. */
static void find_azimuth(const struct placing *p, int k, double sine, double distance,
                         double eye[3])
{
    double angle = 2 * M_PI * k / AZIMUTHS, flat = sqrt(1 - sine * sine) * distance;

    add_scaled(p->out->centre, flat * cos(angle), p->axis[1], eye);
    add_scaled(eye, flat * sin(angle), p->axis[0], eye);
    add_scaled(eye, sine * distance, p->axis[2], eye);
}

/* Returns the distance from the centre for the cameras of a circle whose elevation has this sine:
 * 85 % of the distance of the nearest wall in these directions, but at most `far`, and at least
 * LEAST_DISTANCE radii of the subject even if a wall is nearer. */
static double circle_distance(const struct placing *p, double sine)
{
    double least = p->far, radius = p->out->radius, unit[3], eye[3];

    for (int k = 0; k < AZIMUTHS; k++) {
        find_azimuth(p, k, sine, 1, eye);
        add_scaled(eye, -1, p->out->centre, unit);
        least = fmin(least, 0.85 * wall_distance(p, radius, unit));
    }
    return fmax(least, LEAST_DISTANCE * radius);
}

static int count_covered(const struct placing *p, double sine, double distance)
{
    int n = 0;

    for (int k = 0; k < AZIMUTHS; k++) {
        double eye[3];

        find_azimuth(p, k, sine, distance, eye);
        n += covered_share(p, eye, p->out->centre) >= FREE_SHARE;
    }
    return n;
}

/* Finds the circle with the fewest blocked positions. Among circles with equally few, chooses the
 * first elevation in `sines`, then the largest distance. */
static void find_circle(struct placing *p)
{
    static const double sines[] = {0.2, 0.35, 0.5, 0.05};
    int best = AZIMUTHS + 1;

    for (size_t s = 0; s < sizeof sines / sizeof *sines && best > 0; s++) {
        double distance = circle_distance(p, sines[s]);

        for (int k = 0; k < TRIES && best > 0; k++, distance *= INWARDS) {
            int n = distance < LEAST_DISTANCE * p->out->radius && k > 0
                        ? best
                        : count_covered(p, sines[s], distance);

            if (n < best)
                find_azimuth(p, 0, sines[s], distance, p->out->front);
            best = n < best ? n : best;
        }
    }
    p->out->free_circle = best == 0;
}

/* ---- Targets --------------------------------------------------------------------------------- */

/* Returns whether at least 40 % of the light passes between a point and the centre. */
static bool is_in_sight(const struct placing *p, const double at[3])
{
    double from[3], along[3];

    add_scaled(at, -1, p->out->centre, along);
    add_scaled(p->out->centre, 0.1, along, from);
    for (int c = 0; c < 3; c++)
        along[c] *= 0.82;
    return spin_voxels_depth(p->v, p->v->opacity, from, along, SAMPLES) < -log(0.4);
}

static void add_target(struct placing *p, const float position[3], bool moves, int draw)
{
    const double at[3] = {(double)position[0], (double)position[1], (double)position[2]};
    struct target *t = &p->target[p->n_targets];

    if (!is_in_sight(p, at) || (moves && distance_to(at, p->out->centre) >= p->subject->span))
        return;
    *t = (struct target){.weight = moves ? 1 : 0.25, .moves = moves, .draw = draw};
    memcpy(t->at, at, sizeof t->at);
    p->n_targets++;
    p->n_moving += moves;
}

/* Samples splats of the subject at random, by their weight: for out->sample, and as targets. */
static spin_status add_subject(struct placing *p)
{
    const struct spin_subject *s = p->subject;
    SPIN_FREED double *sums = NULL;

    SPIN_TRY(spin_alloc(TARGETS, sizeof *p->out->sample, (void **)&p->out->sample));
    SPIN_TRY(spin_alloc(s->n, sizeof *sums, (void **)&sums));
    for (size_t i = 0; i < s->n; i++)
        sums[i] = s->weight[i] + (i > 0 ? sums[i - 1] : 0);
    for (uint64_t k = 0; k < DRAWS && p->n_targets < TARGETS; k++) {
        double share = (double)spin_rng_uniform(p->o->seed, SUBJECT, k);
        const float *at = p->v->splat[s->splat[spin_subject_draw(sums, s->n, share)]].at;
        const double place[3] = {(double)at[0], (double)at[1], (double)at[2]};

        if (k < TARGETS && distance_to(place, p->out->centre) < s->span)
            memcpy(p->out->sample[p->out->n_sample++], place, sizeof place);
        add_target(p, at, true, (int)k);
    }
    return SPIN_OK;
}

/* Samples splats of the whole scene at random, by their opaque area, as targets. */
static spin_status add_rest(struct placing *p)
{
    int most = p->n_targets + TARGETS;
    size_t n = p->v->n_splats;
    SPIN_FREED double *sums = NULL;

    SPIN_TRY(spin_alloc(n, sizeof *sums, (void **)&sums));
    for (size_t i = 0; i < n; i++)
        sums[i] = spin_voxels_area(p->v, &p->v->splat[i]) + (i > 0 ? sums[i - 1] : 0);
    for (uint64_t k = 0; k < DRAWS && p->n_targets < most; k++) {
        double share = (double)spin_rng_uniform(p->o->seed, REST, k);

        add_target(p, p->v->splat[spin_subject_draw(sums, n, share)].at, false, (int)k);
    }
    return SPIN_OK;
}

static bool is_inside(const struct placing *p, const double eye[3], double axis[3][3],
                      const double at[3])
{
    double v[3], depth;

    add_scaled(at, -1, eye, v);
    depth = dot(axis[2], v);
    return depth > 0.07 * distance_to(eye, p->out->centre) &&
           fabs(dot(axis[0], v)) < 0.95 * p->half[0] * depth &&
           fabs(dot(axis[1], v)) < 0.95 * p->half[1] * depth;
}

/* Returns the gain in coverage by a camera: the sum of the weights of the targets inside its image,
 * each divided by 1 plus the number of earlier cameras that see the target. If `count` is set, the
 * camera is added to these numbers. */
static double gain_of(const struct placing *p, const double eye[3], const double aim[3], bool count)
{
    double axis[3][3], gain = 0;

    find_axes(eye, aim, p->out->up, axis);
    for (int i = 0; i < p->n_targets; i++)
        if (is_inside(p, eye, axis, p->target[i].at)) {
            gain += p->target[i].weight / (1 + p->target[i].seen);
            p->target[i].seen += count;
        }
    return gain;
}

/* Returns a random target in the subject. The random number is compared with target.draw, not with
 * an index, so that the choice does not depend on how many earlier draws were rejected. */
static const struct target *choose_target(const struct placing *p, uint64_t counter)
{
    int draw = (int)spin_rng_below(p->o->seed, AIM, counter, TARGETS), i = 0;

    while (i + 1 < p->n_moving && p->target[i].draw < draw)
        i++;
    return &p->target[i];
}

/* Sets `aim` to the k-th point at which camera i may look: a random target in the subject, or a
 * point near the centre if k is 0 or the subject has no target. */
static void find_aim(const struct placing *p, int i, int k, double aim[3])
{
    uint64_t at = 3 * ((uint64_t)i * AIMS + (uint64_t)k);

    if (k > 0 && p->n_moving > 0) {
        memcpy(aim, choose_target(p, at)->at, 3 * sizeof *aim);
        return;
    }
    memcpy(aim, p->out->centre, 3 * sizeof *aim);
    for (int c = 0; c < 3; c++) {
        double off = (double)spin_rng_uniform(p->o->seed, NEAR_CENTRE, at + (uint64_t)c) - 0.5;

        add_scaled(aim, 0.6 * off * p->out->radius, p->axis[c], aim);
    }
}

/* Adds a camera that looks at the point, among AIMS candidates, with the largest gain in
 * coverage. */
static void add_camera(struct placing *p, const double eye[3], bool test)
{
    struct spin_viewpoint *c = &p->out->camera[p->out->n];
    double best[3], most = -1, focal = 0.5 * p->o->height / p->half[1];

    for (int k = 0; k < AIMS; k++) {
        double aim[3], gain;

        find_aim(p, p->out->n, k, aim);
        gain =
            distance_to(aim, eye) < 0.5 * p->out->radius || covered_share(p, eye, aim) >= FREE_SHARE
                ? -1
                : gain_of(p, eye, aim, false);
        if (gain <= 1.001 * most) /* the margin prevents rounding errors from deciding */
            continue;
        most = gain;
        memcpy(best, aim, sizeof best);
    }
    if (most < 0)
        memcpy(best, p->out->centre, sizeof best);
    gain_of(p, eye, best, true);
    *c = (struct spin_viewpoint){.test = test};
    c->camera = (struct spin_camera){.width = p->o->width,
                                     .height = p->o->height,
                                     .fx = focal,
                                     .fy = focal,
                                     .cx = 0.5 * p->o->width,
                                     .cy = 0.5 * p->o->height,
                                     .z_near = 0.05 * distance_to(eye, p->out->centre)};
    spin_viewpoints_set_pose(eye, best, p->out->up, &c->camera);
    p->out->n++;
    p->out->distance = fmax(p->out->distance, distance_to(eye, p->out->centre));
}

static void measure_targets(struct placing *p)
{
    int few[2] = {0}, n[2] = {p->n_targets - p->n_moving, p->n_moving};

    for (int i = 0; i < p->n_targets; i++) {
        few[p->target[i].moves] += p->target[i].seen < 3;
        p->target[i].seen = 0;
    }
    p->out->few_static = n[0] > 0 ? (double)few[0] / n[0] : 0;
    p->out->few_moving = n[1] > 0 ? (double)few[1] / n[1] : 0;
}

/* ---- All cameras ----------------------------------------------------------------------------- */

/* Derives two horizontal axes from `up`, so that they rotate with the scene. */
static void set_axes(struct placing *p)
{
    double x[3] = {1, 0, 0}, z[3] = {0, 0, 1}, *up = p->out->up;

    memcpy(up, p->o->up, sizeof p->out->up);
    if (dot(up, up) == 0)
        up[1] = -1;
    make_unit(up);
    memcpy(p->axis[2], up, sizeof p->axis[2]);
    add_scaled(fabs(up[0]) < 0.9 ? x : z, fabs(up[0]) < 0.9 ? -up[0] : -up[2], up, p->axis[0]);
    make_unit(p->axis[0]);
    cross(p->axis[0], up, p->axis[1]);
}

static void set_view(struct placing *p)
{
    p->half[1] = tan(p->o->fovy_deg / 2 * M_PI / 180);
    p->half[0] = p->half[1] * p->o->width / p->o->height;
    p->far = p->out->reach / sin(atan(p->half[1]));
    find_room(p);
    p->far = fmin(p->far, MOST_DISTANCE * p->out->radius);
}

static spin_status place_cameras(struct placing *p)
{
    int least = p->o->n_cameras < LEAST_CAMERAS ? p->o->n_cameras : LEAST_CAMERAS;
    int most = p->o->n_cameras > p->o->n_test ? p->o->n_cameras : p->o->n_test, n;
    SPIN_FREED double(*eye)[3] = NULL;

    SPIN_TRY(spin_alloc((size_t)most + 1, sizeof *eye, (void **)&eye));
    SPIN_TRY(find_places(p, p->o->n_cameras, 0.3, 0.92, eye, &n));
    for (int i = 0; i < n; i++)
        add_camera(p, eye[i], false);
    measure_targets(p);
    if (n < least)
        return spin_unsupported("only %d of %d cameras have a free view of the scene", n,
                                p->o->n_cameras);
    SPIN_TRY(find_places(p, p->o->n_test, 1.9, 0.75, eye, &n));
    for (int i = 0; i < n; i++)
        add_camera(p, eye[i], true);
    return SPIN_OK;
}

static spin_status place_all(struct placing *p)
{
    size_t n = (size_t)(p->o->n_cameras + p->o->n_test);

    set_axes(p);
    memcpy(p->out->centre, p->subject->centre, sizeof p->out->centre);
    p->out->radius = p->subject->radius;
    p->out->moves = p->subject->moves;
    p->out->reach = p->subject->reach;
    set_view(p);
    find_circle(p);
    SPIN_TRY(spin_alloc(2 * TARGETS, sizeof *p->target, (void **)&p->target));
    SPIN_TRY(spin_alloc(n + 1, sizeof *p->out->camera, (void **)&p->out->camera));
    SPIN_TRY(add_subject(p));
    SPIN_TRY(add_rest(p));
    return place_cameras(p);
}

spin_status spin_viewpoints_open(const struct spin_viewpoints_options *o, int n_frames,
                                 spin_voxel_read_fn read, void *context,
                                 struct spin_viewpoints *out)
{
    struct spin_voxels v;
    struct spin_subject subject = {0};
    struct placing p = {.o = o, .out = out, .v = &v, .subject = &subject};
    spin_status status;

    memset(out, 0, sizeof *out);
    SPIN_TRY(spin_voxels_open(&v, n_frames, read, context));
    status = spin_subject_find(&v, o->detail, o->seed, &subject);
    if (status == SPIN_OK)
        status = place_all(&p);
    free(p.target);
    spin_subject_free(&subject);
    spin_voxels_close(&v);
    if (status != SPIN_OK)
        spin_viewpoints_close(out);
    return status;
}

void spin_viewpoints_close(struct spin_viewpoints *p)
{
    free(p->camera);
    free(p->sample);
    memset(p, 0, sizeof *p);
}
