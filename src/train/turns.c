/* Computes turns: follows each dynamic track from its reference frame to both ends of the clip. */
#include "train/turns.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "base/mem.h"
#include "math/quat.h"
#include "geometry/kd_tree.h"
#include "geometry/knn.h"

/* A turn is determined from the NEIGHBOURS nearest neighbours of a splat, within reach_of_spacing
 * times the median spacing of splats. With fewer than FEWEST neighbours it is not determined. Tuned
 * on the clip "court" (docs/results.md). */
enum { NEIGHBOURS = 24, FEWEST = 4, CHUNK = 64 };
static const float reach_of_spacing = 8;
/* The rotation is fitted PASSES times again, with lower weights for neighbours that have large
 * errors, such as those on a part of the body that moves differently. */
enum { PASSES = 3 };
/* A neighbour follows a turn if the turn explains its displacement: the squared distance between
 * the turned offset and the actual one is at most this share of the squared displacement. A turn is
 * accepted only if most neighbours follow it, since splats that were matched by colour may slide
 * over a surface and then do not show how it turns. Tuned on the clips "court" and "basketball". */
static const float most_left = 0.5f;

spin_status spin_turns_open(struct spin_turns *turns, int n_frames)
{
    turns->n_frames = n_frames;
    return spin_alloc((size_t)n_frames, sizeof *turns->frame, (void **)&turns->frame);
}

void spin_turns_close(struct spin_turns *turns)
{
    for (int f = 0; turns->frame && f < turns->n_frames; f++) {
        free(turns->frame[f].track);
        free(turns->frame[f].at);
    }
    free(turns->frame);
    memset(turns, 0, sizeof *turns);
}

spin_status spin_turns_reserve(struct spin_turns *turns, int f, size_t n)
{
    struct spin_turns_frame *frame = &turns->frame[f];

    SPIN_TRY(spin_alloc(n + 1, sizeof *frame->track, (void **)&frame->track));
    SPIN_TRY(spin_alloc(n + 1, 7 * sizeof *frame->at, (void **)&frame->at));
    frame->n = n;
    frame->turn = frame->at + 3 * n;
    for (size_t i = 0; i < n; i++)
        frame->turn[4 * i] = 1;
    return SPIN_OK;
}

/* ---- A rotation ------------------------------------------------------------------------------ */

/* Offsets of the neighbours of a splat, in the reference frame (from) and in another frame (to),
 * relative to the weighted mean of the offsets in the same frame. */
struct offsets {
    int n;
    float from[NEIGHBOURS][3], to[NEIGHBOURS][3], weight[NEIGHBOURS];
};

static void centre_offsets(const struct offsets *o, float (*at)[3])
{
    float sum[3] = {0}, weight = 0;

    for (int i = 0; i < o->n; weight += o->weight[i++])
        for (int c = 0; c < 3; c++)
            sum[c] += o->weight[i] * at[i][c];
    for (int i = 0; i < o->n; i++)
        for (int c = 0; c < 3; c++)
            at[i][c] -= sum[c] / weight;
}

/* Sets m to Horn's symmetric matrix, whose eigenvector for the largest eigenvalue is the quaternion
 * of the rotation that best maps `from` to `to`. Returns an upper bound for the absolute values of
 * the eigenvalues. */
static double fill_matrix(const struct offsets *o, double m[4][4])
{
    double s[3][3] = {{0}}, most = 0;

    for (int i = 0; i < o->n; i++)
        for (int r = 0; r < 3; r++) {
            double a = (double)o->from[i][r], b = (double)o->to[i][r], w = (double)o->weight[i];

            most += w * (a * a + b * b) / 2;
            for (int c = 0; c < 3; c++)
                s[r][c] += w * a * (double)o->to[i][c];
        }
    m[0][0] = s[0][0] + s[1][1] + s[2][2];
    m[1][1] = s[0][0] - s[1][1] - s[2][2];
    m[2][2] = s[1][1] - s[0][0] - s[2][2];
    m[3][3] = s[2][2] - s[0][0] - s[1][1];
    m[0][1] = m[1][0] = s[1][2] - s[2][1];
    m[0][2] = m[2][0] = s[2][0] - s[0][2];
    m[0][3] = m[3][0] = s[0][1] - s[1][0];
    m[1][2] = m[2][1] = s[0][1] + s[1][0];
    m[1][3] = m[3][1] = s[2][0] + s[0][2];
    m[2][3] = m[3][2] = s[1][2] + s[2][1];
    return most;
}

/* Sets q to the best rotation. Power iteration finds the eigenvector; before, a multiple of the
 * identity is added to the matrix, so that no eigenvalue is negative. The iteration starts from the
 * value of q on entry. If several rotations fit equally well, as for neighbours on a line, it finds
 * the one nearest to that value. */
static void fit_rotation(const struct offsets *o, float q[4])
{
    enum { MOST_POWERS = 100 };
    double m[4][4], most = fill_matrix(o, m), at[4], change = 1;

    for (int r = 0; r < 4; r++) {
        at[r] = (double)q[r];
        m[r][r] += most;
    }
    for (int k = 0; k < MOST_POWERS && change > 1e-12; k++) {
        double next[4] = {0}, square = 0;

        for (int r = 0; r < 4; r++) {
            for (int c = 0; c < 4; c++)
                next[r] += m[r][c] * at[c];
            square += next[r] * next[r];
        }
        if (!(square > 0))
            return;
        change = 0;
        for (int r = 0; r < 4; r++) {
            double unit = next[r] / sqrt(square);

            change += (unit - at[r]) * (unit - at[r]);
            at[r] = unit;
        }
    }
    for (int r = 0; r < 4; r++)
        q[r] = (float)at[r];
}

/* Returns the squared distance between two offsets. */
static float square_of(const float from[3], const float to[3])
{
    float x = from[0] - to[0], y = from[1] - to[1], z = from[2] - to[2];

    return x * x + y * y + z * z;
}

/* Sets the weight of each neighbour from its error under the rotation q. Returns whether most
 * neighbours follow q (most_left). */
static bool update_weights(struct offsets *o, const float q[4])
{
    float square[NEIGHBOURS], mean = 0, turned[3];
    int n_follow = 0;

    for (int i = 0; i < o->n; i++) {
        spin_quat_rotate(q, o->from[i], turned);
        square[i] = square_of(turned, o->to[i]);
        mean += square[i] / (float)o->n;
        n_follow += square[i] <= most_left * square_of(o->from[i], o->to[i]);
    }
    for (int i = 0; i < o->n && mean > 0; i++)
        o->weight[i] = 1 / powf(1 + 2 * square[i] / mean, 2);
    return 2 * n_follow > o->n;
}

/* ---- Following tracks ------------------------------------------------------------------------ */

/* A neighbour of a splat: its row in the reference frame, and its squared distance. */
struct near {
    uint32_t row;
    float square;
};

/* A reference frame, with the data for finding neighbours in it. */
struct origin {
    const struct spin_turns *turns;
    int frame;
    const int *frame_of; /* [tracks] reference frame of each track */
    struct spin_kd_tree tree;
    float reach;
};

struct nearest {
    const float *points, *at;
    float reach;
    uint32_t self;
    int n;
    struct near near[NEIGHBOURS];
};

static void insert_neighbour(void *context, uint32_t row)
{
    struct nearest *found = context;
    const float *p = found->points + 3 * (size_t)row, *at = found->at;
    float x = p[0] - at[0], y = p[1] - at[1], z = p[2] - at[2], square = x * x + y * y + z * z;
    int i = found->n;

    if (row == found->self || square > found->reach * found->reach ||
        (i == NEIGHBOURS && square >= found->near[i - 1].square))
        return;
    i = i == NEIGHBOURS ? i - 1 : found->n++;
    for (; i > 0 && found->near[i - 1].square > square; i--)
        found->near[i] = found->near[i - 1];
    found->near[i] = (struct near){row, square};
}

static int by_track(const void *key, const void *track)
{
    uint32_t a = *(const uint32_t *)key, b = *(const uint32_t *)track;

    return (a > b) - (a < b);
}

/* Returns the row of a track's splat in a frame, or frame->n if the track has no splat there. */
static size_t row_of(const struct spin_turns_frame *frame, uint32_t track)
{
    const uint32_t *found =
        frame->n == 0 ? NULL : bsearch(&track, frame->track, frame->n, sizeof track, by_track);

    return found ? (size_t)(found - frame->track) : frame->n;
}

static void subtract(const float a[3], const float b[3], float out[3])
{
    for (int c = 0; c < 3; c++)
        out[c] = a[c] - b[c];
}

/* Sets q to the turn of the splat in row j of frame `to`, whose track has row i in the reference
 * frame. On entry q is the turn in the previous frame; it stays unchanged if the neighbours do not
 * determine a turn. */
static void turn_to(const struct origin *origin, const struct nearest *near, size_t i,
                    const struct spin_turns_frame *to, size_t j, float q[4])
{
    const struct spin_turns_frame *from = &origin->turns->frame[origin->frame];
    struct offsets o = {0};
    float prior[4];
    bool follow = false;

    for (int k = 0; k < near->n; k++) {
        size_t other = near->near[k].row, there = row_of(to, from->track[other]);

        if (there == to->n)
            continue;
        subtract(from->at + 3 * other, from->at + 3 * i, o.from[o.n]);
        subtract(to->at + 3 * there, to->at + 3 * j, o.to[o.n]);
        o.weight[o.n++] = 1;
    }
    if (o.n < FEWEST)
        return;
    memcpy(prior, q, sizeof prior);
    for (int pass = 0; pass <= PASSES; pass++) {
        centre_offsets(&o, o.from);
        centre_offsets(&o, o.to);
        fit_rotation(&o, q);
        follow = update_weights(&o, q);
    }
    if (!follow)
        memcpy(q, prior, sizeof prior);
}

static void follow_track(const struct origin *origin, size_t i)
{
    const struct spin_turns *turns = origin->turns;
    const struct spin_turns_frame *from = &turns->frame[origin->frame];
    struct nearest near = {
        .points = from->at, .at = from->at + 3 * i, .reach = origin->reach, .self = (uint32_t)i};

    spin_kd_tree_within(&origin->tree, near.at, origin->reach, insert_neighbour, &near);
    for (int way = -1; way <= 1; way += 2) {
        float q[4] = {1, 0, 0, 0};

        for (int f = origin->frame + way; f >= 0 && f < turns->n_frames; f += way) {
            const struct spin_turns_frame *to = &turns->frame[f];
            size_t j = row_of(to, from->track[i]);

            if (j == to->n)
                continue;
            turn_to(origin, &near, i, to, j, q);
            memcpy(to->turn + 4 * j, q, sizeof q);
        }
    }
}

static void follow_rows(void *context, size_t first, size_t end)
{
    const struct origin *origin = context;
    const struct spin_turns_frame *from = &origin->turns->frame[origin->frame];

    for (size_t i = first; i < end; i++)
        if (origin->frame_of[from->track[i]] == origin->frame)
            follow_track(origin, i);
}

/* Computes the turns of all tracks whose reference frame is this one. */
static spin_status follow_frame(struct origin *origin, struct spin_pool *pool)
{
    const struct spin_turns_frame *from = &origin->turns->frame[origin->frame];
    float square;
    spin_status status;

    if (from->n < FEWEST)
        return SPIN_OK;
    SPIN_TRY(spin_knn_median_dist2(pool, from->n, from->at, &square));
    origin->reach = reach_of_spacing * sqrtf(square);
    status = spin_kd_tree_open(&origin->tree, from->n, from->at);
    if (status == SPIN_OK)
        spin_pool_rows(pool, from->n, CHUNK, follow_rows, origin);
    spin_kd_tree_close(&origin->tree);
    return status;
}

/* Sets *frame_of [n_tracks] to the reference frame of each track: of the frames in which the track
 * has a splat, the one nearest to the middle of the clip. The caller frees it. */
static spin_status choose_frames(const struct spin_turns *turns, size_t n_tracks, int **frame_of)
{
    int middle = turns->n_frames / 2;

    SPIN_TRY(spin_alloc(n_tracks + 1, sizeof **frame_of, (void **)frame_of));
    for (size_t k = 0; k < n_tracks; k++)
        (*frame_of)[k] = turns->n_frames + middle;
    for (int f = 0; f < turns->n_frames; f++)
        for (size_t i = 0; i < turns->frame[f].n; i++) {
            int *best = &(*frame_of)[turns->frame[f].track[i]];

            if (abs(f - middle) < abs(*best - middle))
                *best = f;
        }
    return SPIN_OK;
}

spin_status spin_turns_find(struct spin_turns *turns, size_t n_tracks, struct spin_pool *pool)
{
    SPIN_FREED int *frame_of = NULL;

    SPIN_TRY(choose_frames(turns, n_tracks, &frame_of));
    for (int f = 0; f < turns->n_frames; f++)
        SPIN_TRY(
            follow_frame(&(struct origin){.turns = turns, .frame = f, .frame_of = frame_of}, pool));
    return SPIN_OK;
}
