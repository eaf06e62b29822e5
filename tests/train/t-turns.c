/* Rotations of splats from the positions of their neighbours: rotating bodies, noise, neighbours
 * that move differently, and frames that lack some of them; identical bits for any number of
 * threads.
 * K: tracks threads */

#include "math/quat.h"
#include "math/rng.h"
#include "tests/check.h"
#include "tests/tap.h"
#include "train/track_matching.h"

enum { FRAMES = 5, SIDE = 8, BODY = SIDE * SIDE, MIDDLE = (FRAMES + 1) / 2 };
/* The first track of each kind, see place_of(). */
enum { GOES = BODY, ALONE = 2 * BODY, ROD = ALONE + 4, TRACKS = ROD + SIDE };

static const float axis[3] = {0.48f, 0.6f, 0.64f};
static double noise; /* standard deviation, of the distance between neighbours */

/* About the axis, by 0.4 per frame relative to the middle frame. */
static void turn_of(int frame, float q[4])
{
    double half = 0.2 * (frame - MIDDLE);

    q[0] = (float)cos(half);
    for (int c = 0; c < 3; c++)
        q[1 + c] = (float)sin(half) * axis[c];
}

/* A sheet that rotates and translates; a static one beside it; isolated points; and a rod that
 * rotates about z, whose spin about its own axis cannot be observed. */
static void place_of(int frame, uint32_t track, float at[3])
{
    size_t i = track % BODY;
    float flat[3] = {(float)(i % SIDE), (float)(i / SIDE), 0.1f * (float)((i * 7) % 5)}, q[4];
    double angle_of_rod = 0.4 * (frame - MIDDLE);

    turn_of(frame, q);
    if (track < GOES)
        spin_quat_rotate(q, flat, at);
    else
        memcpy(at, flat, sizeof flat);
    at[0] += track < GOES ? (float)frame : track < ALONE ? MIDDLE - 11 : 1000 * (float)(1 + i);
    if (track >= ROD) {
        at[0] = -5000 + (float)(cos(angle_of_rod) * (track - ROD));
        at[1] = (float)(sin(angle_of_rod) * (track - ROD));
        at[2] = 0;
    }
    for (int c = 0; c < 3; c++)
        at[c] += (float)noise * spin_rng_normal(5, (uint64_t)c, (uint64_t)(frame * TRACKS) + track);
}

/* Frame 1 lacks every fourth track, frame 2 (the middle) track 1. */
static bool is_there(int frame, uint32_t track)
{
    return !(frame == 1 && track % 4 == 3) && !(frame == MIDDLE && track == 1);
}

static void find(int n_threads, struct spin_turns *turns)
{
    struct spin_pool *pool = NULL;
    spin_status status =
        spin_turns_open(turns, FRAMES + 1); /* everything is static in the last frame */

    for (int f = 0; f < FRAMES && status == SPIN_OK; f++) {
        size_t n = 0;

        for (uint32_t k = 0; k < TRACKS; k++)
            n += is_there(f, k);
        status = spin_turns_reserve(turns, f, n);
        n = 0;
        for (uint32_t k = 0; k < TRACKS && status == SPIN_OK; k++)
            if (is_there(f, k)) {
                place_of(f, k, turns->frame[f].at + 3 * n);
                turns->frame[f].track[n++] = k;
            }
    }
    if (status == SPIN_OK)
        status = spin_pool_create(n_threads, &pool);
    if (status == SPIN_OK)
        status = spin_turns_find(turns, TRACKS, pool);
    spin_pool_free(pool);
    if (status != SPIN_OK) {
        ok(0, "%s", spin_last_error());
        exit(tap_done());
    }
}

/* The angle between a splat's rotation and q. */
static double angle(const float turn[4], const float q[4])
{
    double dot = 0;

    for (int c = 0; c < 4; c++)
        dot += (double)turn[c] * (double)q[c];
    return 2 * acos(fmin(1, fabs(dot)));
}

/* The largest and the mean angle between the rotations of tracks [first, end) and the true ones. */
static double off(const struct spin_turns *turns, uint32_t first, uint32_t end, bool turns_too,
                  double *mean)
{
    double worst = 0;
    size_t n = 0;

    *mean = 0;
    for (int f = 0; f < FRAMES; f++)
        for (size_t i = 0; i < turns->frame[f].n; i++) {
            uint32_t k = turns->frame[f].track[i];
            float q[4] = {1, 0, 0, 0};
            double is;

            if (k < first || k >= end || k == 1)
                continue;
            if (turns_too)
                turn_of(f, q);
            is = angle(turns->frame[f].turn + 4 * i, q);
            worst = larger(worst, is);
            *mean += is;
            n++;
        }
    *mean /= (double)n;
    return worst;
}

/* The rod's rotation is the shortest one: about z. */
static double off_rod(const struct spin_turns *turns)
{
    double worst = 0;

    for (int f = 0; f < FRAMES; f++)
        for (size_t i = 0; i < turns->frame[f].n; i++) {
            double half = 0.2 * (f - MIDDLE);
            float q[4] = {(float)cos(half), 0, 0, (float)sin(half)};

            if (turns->frame[f].track[i] >= ROD)
                worst = larger(worst, angle(turns->frame[f].turn + 4 * i, q));
        }
    return worst;
}

/* Track 1 is missing from the middle frame: its reference is the frame before, as near as the
 * one after. */
static void check_own_frame(const struct spin_turns *turns)
{
    double worst = 0;

    for (int f = 0; f < FRAMES; f++)
        for (size_t i = 0; i < turns->frame[f].n; i++) {
            float q[4], to[4], from[4];

            if (turns->frame[f].track[i] != 1)
                continue;
            turn_of(f, to);
            turn_of(MIDDLE - 1, from);
            for (int c = 1; c < 4; c++)
                from[c] = -from[c];
            spin_quat_product(to, from, q);
            worst = larger(worst, angle(turns->frame[f].turn + 4 * i, q));
        }
    ok(worst < 0.02, "a track that the middle frame lacks turns from the nearest, to %.2g", worst);
}

TAP_MAIN
{
    struct spin_turns turns = {0}, other = {0};
    double mean, worst, size = 0;
    int wrong = 0;

    find(1, &turns);
    worst = off(&turns, 0, BODY, true, &mean);
    ok(worst < 0.02, "a body that turns, to %.2g: %.2g on average", worst, mean);
    worst = off(&turns, GOES, ALONE, false, &mean);
    ok(worst < 0.02, "one that goes without turning, to %.2g", worst);
    worst = off(&turns, ALONE, ROD, false, &mean);
    ok(worst == 0, "splats without neighbours do not turn");
    worst = off_rod(&turns);
    ok(worst < 1e-3, "a rod turns by the shortest way, to %.2g", worst);
    check_own_frame(&turns);
    for (int f = 0; f < FRAMES; f++)
        for (size_t i = 0; i < turns.frame[f].n; i++)
            size = larger(size, fabs(spin_quat_norm(turns.frame[f].turn + 4 * i) - 1));
    ok(size < 1e-6, "turns have length 1, to %.2g", size);
    spin_turns_close(&turns);

    noise = 0.15;
    find(1, &turns);
    worst = off(&turns, 0, BODY, true, &mean);
    ok(mean < 0.06, "noise of a seventh of the distance to neighbours: off by %.2g on average",
       mean);
    find(3, &other);
    for (int f = 0; f < FRAMES; f++)
        wrong += memcmp(turns.frame[f].turn, other.frame[f].turn,
                        4 * turns.frame[f].n * sizeof(float)) != 0;
    ok(wrong == 0, "three threads find the same");
    spin_turns_close(&turns);
    spin_turns_close(&other);

    noise = 5;
    find(1, &turns);
    worst = off(&turns, 0, ALONE, false, &mean);
    ok(mean < 0.1, "of neighbours that go anywhere no turn is taken: %.2g on average", mean);
    spin_turns_close(&turns);
}
