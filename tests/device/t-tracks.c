/* Values that splats get from their tracks, and gradients back, compared with the sums written out;
 * the same bits for any number of threads; on a strict device.
 * K: threads tracks */

#include "math/quat.h"
#include "tests/device/strict.h"
#include "tests/device/verbs.h"

/* Two frames: number of splats, and of those with their own position and residual values. */
enum { FRAMES = 2, TRACKS = 2600, ALL = 2100 + 1500 };
static const size_t n_of[FRAMES] = {2100, 1500}, n_means[FRAMES] = {1300, 1500},
                    n_residual[FRAMES] = {40, 700};
static const size_t width[4] = {3, 4, 3, 1}; /* of the residual's groups */

static uint32_t track[FRAMES][2100];
static float own_means[FRAMES][3 * 1500], own_residual[FRAMES][SPIN_RESIDUAL * 700];
static float values[SPIN_TRACK * TRACKS], d_values[SPIN_TRACK * TRACKS];
static float motion[SPIN_MOTION * TRACKS];
static float turn[FRAMES][4 * 1500];
static float means[3 * ALL], residual[SPIN_RESIDUAL * ALL];
static float d_means[FRAMES][3 * 2100], d_residual[FRAMES][SPIN_RESIDUAL * 2100];

static void fill(float *to, size_t n, size_t step)
{
    for (size_t i = 0; i < n; i++)
        to[i] = (float)(i * step % 1999) / 1000 - 1;
}

static struct spin_frame_batch batch_of(struct loans *l)
{
    struct spin_frame_batch frames = {.n_frames = FRAMES, .n = ALL};

    for (size_t f = 0, first = 0; f < FRAMES; first += n_of[f++]) {
        struct spin_frame_of_batch *to = &frames.frame[f];

        to->first = first;
        to->t = 0.3f + 0.4f * (float)f;
        to->n = n_of[f];
        to->n_own_means = n_means[f];
        to->n_own_residual = n_residual[f];
        to->track = lend(l, track[f], n_of[f] * sizeof **track);
        to->own_means = lend(l, own_means[f], 3 * n_means[f] * sizeof(float));
        to->own_residual = lend(l, own_residual[f], SPIN_RESIDUAL * n_residual[f] * sizeof(float));
        to->d_means = lend(l, d_means[f], 3 * n_of[f] * sizeof(float));
        to->d_residual = lend(l, d_residual[f], SPIN_RESIDUAL * n_of[f] * sizeof(float));
    }
    return frames;
}

enum tracks { STAND, MOVE, TURN };

static void run(struct spin_device *d, bool with_residual, enum tracks what)
{
    struct loans l = {.d = d};
    struct spin_frame_batch frames = batch_of(&l);
    struct spin_tracks_f32 tracks = {.n = TRACKS, .values = lend(&l, values, sizeof values)};
    float SPIN_DEV *to_means = lend_both(&l, means, sizeof means);
    float SPIN_DEV *to_residual = lend_both(&l, residual, sizeof residual);

    if (what == MOVE)
        tracks.motion = lend(&l, motion, sizeof motion);
    for (int f = 0; f < FRAMES; f++) {
        if (what == MOVE)
            frames.frame[f].n_own_residual = 0;
        if (what == TURN)
            frames.frame[f].turn = lend(&l, turn[f], 4 * n_means[f] * sizeof(float));
    }
    for (size_t i = 0; i < SPIN_TRACK * TRACKS; i++)
        d_values[i] = 1;
    tracks.d_values = lend_both(&l, d_values, sizeof d_values);
    for (int f = 0; f < FRAMES && !with_residual; f++)
        frames.frame[f].d_residual = NULL;
    d->op->tracks(d, &frames, &tracks, to_means, to_residual);
    d->op->tracks_back(d, &frames, &tracks);
    settle(&l);
}

static int count_wrong_sums(void)
{
    int wrong = 0;

    for (size_t f = 0, first = 0; f < FRAMES; first += n_of[f++])
        for (size_t i = 0; i < n_of[f]; i++) {
            uint32_t k = track[f][i];
            const float *group = values + 3 * TRACKS, *own = own_residual[f];
            const float *to = residual + SPIN_RESIDUAL * first;

            for (size_t c = 0; c < 3; c++)
                wrong +=
                    means[3 * (first + i) + c] != (i < n_means[f] ? own_means[f][3 * i + c] : 0) +
                                                      (k < TRACKS ? values[3 * k + c] : 0);
            for (int g = 0; g < 4; g++) {
                for (size_t c = 0; c < width[g]; c++)
                    wrong +=
                        to[width[g] * i + c] != (i < n_residual[f] ? own[width[g] * i + c] : 0) +
                                                    (k < TRACKS ? group[width[g] * k + c] : 0);
                group += width[g] * TRACKS;
                own += width[g] * n_residual[f];
                to += width[g] * n_of[f];
            }
        }
    return wrong;
}

static int count_wrong_gradients(bool with_residual)
{
    static float want[SPIN_TRACK * TRACKS];
    int wrong = 0;

    for (size_t i = 0; i < SPIN_TRACK * TRACKS; i++)
        want[i] = 1;
    for (size_t f = 0; f < FRAMES; f++)
        for (size_t i = 0; i < n_of[f]; i++) {
            uint32_t k = track[f][i];
            float *group = want + 3 * TRACKS, *from = d_residual[f];

            for (size_t c = 0; c < 3 && k < TRACKS; c++)
                want[3 * k + c] += d_means[f][3 * i + c];
            for (int g = 0; g < 4 && with_residual; g++) {
                for (size_t c = 0; c < width[g] && k < TRACKS; c++)
                    group[width[g] * k + c] += from[width[g] * i + c];
                group += width[g] * TRACKS;
                from += width[g] * n_of[f];
            }
        }
    for (size_t i = 0; i < SPIN_TRACK * TRACKS; i++)
        wrong += d_values[i] != want[i];
    return wrong;
}

/* Position and opacity of a splat whose track has motion, written out; the other values are the
 * track's. */
static double worst_motion(void)
{
    double worst = 0;

    for (size_t f = 0, first = 0; f < FRAMES; first += n_of[f++])
        for (size_t i = 0; i < n_of[f]; i++) {
            uint32_t k = track[f][i];
            const float *m = motion + SPIN_MOTION * (size_t)k,
                        *to = residual + SPIN_RESIDUAL * first;
            double d = 0.3 + 0.4 * (double)f, o, seen;

            if (k >= TRACKS)
                continue;
            d -= (double)m[3];
            for (size_t c = 0; c < 3; c++)
                worst = larger(worst, fabs((double)means[3 * (first + i) + c] - d * (double)m[c] -
                                           (double)values[3 * k + c] -
                                           (double)(i < n_means[f] ? own_means[f][3 * i + c] : 0)));
            o = 1 / (1 + exp(-(double)values[13 * TRACKS + k]));
            seen = 1 / (1 + exp(-(double)to[10 * n_of[f] + i]));
            worst = larger(worst, fabs(seen - o * exp(-0.5 * pow(d * (double)m[4], 2))));
            worst =
                larger(worst, fabs((double)(to[3 * n_of[f] + 4 * i] - values[6 * TRACKS + 4 * k])));
        }
    return worst;
}

/* Gradients are accumulated as without motion, except for the opacity, whose derivative is d faded
 * opacity / d opacity. */
static double worst_motion_slope(void)
{
    double worst = 0;

    for (size_t k = 0; k < TRACKS; k++) {
        const float *m = motion + SPIN_MOTION * k;
        double want = 1;

        for (size_t f = 0; f < FRAMES; f++)
            for (size_t i = 0; i < n_of[f]; i++) {
                double d = 0.3 + 0.4 * (double)f - (double)m[3];
                double w = exp(-0.5 * pow(d * (double)m[4], 2));

                if (track[f][i] == k)
                    want += (double)d_residual[f][10 * n_of[f] + i] /
                            (1 + exp((double)values[13 * TRACKS + k]) * (1 - w));
            }
        worst = larger(worst, fabs((double)d_values[13 * TRACKS + k] - want));
    }
    return worst;
}

/* Rotation of a vector by its matrix, and product of quaternions by the matrix of the first. */
static double turned(const float q[4], size_t w, const float *in, size_t c)
{
    double a = (double)q[0], x = (double)q[1], y = (double)q[2], z = (double)q[3], sum = 0;
    const double rotation[3][3] = {
        {1 - 2 * (y * y + z * z), 2 * (x * y - z * a), 2 * (x * z + y * a)},
        {2 * (x * y + z * a), 1 - 2 * (x * x + z * z), 2 * (y * z - x * a)},
        {2 * (x * z - y * a), 2 * (y * z + x * a), 1 - 2 * (x * x + y * y)}};
    const double product[4][4] = {{a, -x, -y, -z}, {x, a, -z, y}, {y, z, a, -x}, {z, -y, x, a}};

    for (size_t k = 0; k < w; k++)
        sum += (w == 3 ? rotation[c][k] : product[c][k]) * (double)in[k];
    return sum;
}

/* Rotated positions and rotations, written out. */
static double worst_turn(void)
{
    double worst = 0;

    for (size_t f = 0, first = 0; f < FRAMES; first += n_of[f++])
        for (size_t i = 0; i < n_of[f]; i++) {
            size_t k = track[f][i];
            bool turns = i < n_means[f];
            const float *q = turn[f] + 4 * i;
            const float *place = values + 3 * k, *rotation = values + 6 * TRACKS + 4 * k;

            if (k >= TRACKS)
                continue;
            for (size_t c = 0; c < 3; c++)
                worst = larger(worst, fabs((double)means[3 * (first + i) + c] -
                                           (turns ? turned(q, 3, place, c) : (double)place[c]) -
                                           (double)(turns ? own_means[f][3 * i + c] : 0)));
            for (size_t c = 0; c < 4; c++)
                worst = larger(
                    worst,
                    fabs((double)residual[SPIN_RESIDUAL * first + 3 * n_of[f] + 4 * i + c] -
                         (turns ? turned(q, 4, rotation, c) : (double)rotation[c]) -
                         (double)(i < n_residual[f] ? own_residual[f][3 * n_residual[f] + 4 * i + c]
                                                    : 0)));
        }
    return worst;
}

/* The values of splats are affine in the tracks' values v, A v + own, and the gradient of a track
 * is the adjoint of the splats' g: g (A v) = v (A' g). Returns the largest error over all
 * tracks. */
static double worst_adjoint(void)
{
    static double of_splats[TRACKS], of_tracks[TRACKS];
    double worst = 0;

    memset(of_splats, 0, sizeof of_splats);
    memset(of_tracks, 0, sizeof of_tracks);
    for (size_t f = 0, first = 0; f < FRAMES; first += n_of[f++])
        for (size_t i = 0; i < n_of[f]; i++) {
            size_t k = track[f][i], n = n_of[f], m = n_residual[f];

            if (k >= TRACKS)
                continue;
            for (size_t c = 0; c < 3; c++)
                of_splats[k] += (double)d_means[f][3 * i + c] *
                                ((double)means[3 * (first + i) + c] -
                                 (double)(i < n_means[f] ? own_means[f][3 * i + c] : 0));
            for (size_t c = 0; c < 4; c++)
                of_splats[k] += (double)d_residual[f][3 * n + 4 * i + c] *
                                ((double)residual[SPIN_RESIDUAL * first + 3 * n + 4 * i + c] -
                                 (double)(i < m ? own_residual[f][3 * m + 4 * i + c] : 0));
        }
    for (size_t k = 0; k < TRACKS; k++) {
        for (size_t c = 0; c < 3; c++)
            of_tracks[k] += (double)values[3 * k + c] * ((double)d_values[3 * k + c] - 1);
        for (size_t c = 0; c < 4; c++)
            of_tracks[k] += (double)values[6 * TRACKS + 4 * k + c] *
                            ((double)d_values[6 * TRACKS + 4 * k + c] - 1);
        worst = larger(worst, fabs(of_splats[k] - of_tracks[k]));
    }
    return worst;
}

static void check_turns(struct spin_device *d, const char *path)
{
    double worst, off;

    run(d, true, TURN);
    worst = worst_turn();
    off = worst_adjoint();
    ok(worst < 2e-6, "%s: displacement and rotation of a track turn, to %.2g", path, worst);
    ok(off < 1e-5, "%s: their gradients turn back, to %.2g", path, off);
}

static void check_motion(struct spin_device *d, const char *path)
{
    double worst, slope;

    run(d, true, MOVE);
    worst = worst_motion();
    slope = worst_motion_slope();
    ok(worst < 1e-5, "%s: a track goes its way, and is seen as its bell says, to %.2g", path,
       worst);
    ok(slope < 1e-5, "%s: its opacity learns from what is seen, to %.2g", path, slope);
}

static void check_path(const char *path, int n_threads)
{
    struct spin_device *d;

    setenv("SPIN_CPU", path, 1);
    d = check_device(n_threads);
    run(d, true, STAND);
    ok(count_wrong_sums() == 0, "%s, %d threads: own values plus those of the track", path,
       n_threads);
    ok(count_wrong_gradients(true) == 0, "%s, %d threads: gradients gather over frames", path,
       n_threads);
    run(d, false, STAND);
    ok(count_wrong_gradients(false) == 0, "%s, %d threads: places only", path, n_threads);
    check_motion(d, path);
    check_turns(d, path);
    check_device_free(d);
}

/* Every third splat has no track; among the others, no two of a frame share one. */
static void make_tracks(void)
{
    for (size_t f = 0; f < FRAMES; f++)
        for (size_t i = 0; i < n_of[f]; i++)
            track[f][i] = i % 3 == 2 ? SPIN_NO_TRACK : (uint32_t)((i * 1237 + f * 11) % TRACKS);
}

TAP_MAIN
{
    static const char *const paths[] = {"base", "v3", "v4"};
    struct spin_device *late;
    int complaints = strict_complaints();

    make_tracks();
    fill(values, SPIN_TRACK * TRACKS, 7919);
    fill(motion, SPIN_MOTION * TRACKS, 611953);
    for (size_t k = 0; k < TRACKS; k++) /* every ninth does not fade */
        motion[SPIN_MOTION * k + 4] = k % 9 ? 2 + motion[SPIN_MOTION * k + 4] : 0;
    for (size_t f = 0; f < FRAMES; f++) {
        fill(own_means[f], 3 * n_means[f], 104729 + f);
        fill(turn[f], 4 * n_means[f], 86028121 + f);
        for (size_t i = 0; i < n_means[f]; i++)
            spin_quat_normalise(turn[f] + 4 * i);
        fill(own_residual[f], SPIN_RESIDUAL * n_residual[f], 1299709 + f);
        fill(d_means[f], 3 * n_of[f], 15485863 + f);
        fill(d_residual[f], SPIN_RESIDUAL * n_of[f], 32452843 + f);
    }
    for (int p = 0; p < 3; p++) {
        struct spin_device d;

        setenv("SPIN_CPU", paths[p], 1);
        if (spin_device_open("cpu", 1, &d) != SPIN_OK) {
            skip(paths[p], spin_last_error());
            continue;
        }
        spin_device_close(&d);
        for (int n = 1; n <= 8; n = n == 3 ? 8 : n + 1)
            check_path(paths[p], n);
    }
    unsetenv("SPIN_CPU");
    late = strict_open(check_device(2), 2, 1);
    run(late, true, STAND);
    ok(count_wrong_sums() == 0 && count_wrong_gradients(true) == 0 &&
           strict_complaints() == complaints,
       "on a device that works late, without a complaint");
    run(late, true, MOVE);
    ok(worst_motion() < 1e-5 && strict_complaints() == complaints, "with motion too");
    run(late, true, TURN);
    ok(worst_turn() < 2e-6 && strict_complaints() == complaints, "and with turns");
    strict_close(late);
}
