/* Matches the splats of each frame with those of the next frame, in one pass with two frames in
 * memory at a time. Also computes the rotations of tracks. */
#include "train/track_matching.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "base/base.h"
#include "geometry/neighbours.h"
#include "math/sh.h"
#include "base/mem.h"
#include "math/quat.h"

/* reach_of_spacing: search radius of a splat, in units of its distance to its neighbours.
 * colour_tolerance: largest difference of matched splats in a colour channel, 0..1. share_of_step:
 * the predicted displacement of a splat is this factor times its last displacement. Tuned on the
 * clip "basketball" (docs/results.md). */
static const float reach_of_spacing = 3, colour_tolerance = 0.1f, share_of_step = 0.7f;
/* In the search radius, the distance of a splat to its neighbours is limited to this factor times
 * the mean over all splats, so that outliers are not matched across the scene. */
static const float most_spacing = 4;

/* The splats of a frame that are to be matched. */
struct loose {
    size_t n;
    uint32_t *splat; /* [n] row of each splat in the frame */
    uint32_t *chain; /* [n] index of the splat's track in the result, or SPIN_NO_TRACK */
    float *at;       /* [n][3] position */
    float *expected; /* [n][3] predicted position in the next frame */
    float *colour;   /* [n][3] in units of colour_tolerance */
    float *reach;    /* [n] search radius */
};

static void close_loose(struct loose *l)
{
    free(l->splat);
    free(l->at);
    memset(l, 0, sizeof *l);
}

static spin_status open_loose(struct loose *l, size_t n)
{
    close_loose(l);
    SPIN_TRY(spin_alloc(n + 1, 2 * sizeof *l->splat, (void **)&l->splat));
    SPIN_TRY(spin_alloc(n + 1, 10 * sizeof *l->at, (void **)&l->at));
    l->n = n;
    l->chain = l->splat + n;
    l->expected = l->at + 3 * n;
    l->colour = l->expected + 3 * n;
    l->reach = l->colour + 3 * n;
    return SPIN_OK;
}

static float colour_of(const struct spin_splats *s, size_t i, size_t c)
{
    size_t coefficients = (size_t)(s->sh_degree + 1) * (size_t)(s->sh_degree + 1);

    if (s->rgb)
        return s->rgb[3 * i + c];
    return s->sh ? (float)(SPIN_SH_C0 * (double)s->sh[3 * coefficients * i + c]) : 0;
}

/* Sets the search radius of each splat around its predicted position. */
static spin_status set_reach(struct spin_pool *pool, struct loose *l)
{
    double mean = 0;

    SPIN_TRY(spin_knn_mean_dist2(pool, l->n, l->at, l->reach));
    for (size_t i = 0; i < l->n; i++) {
        l->reach[i] = sqrtf(l->reach[i]);
        mean += (double)l->reach[i] / (double)l->n;
    }
    for (size_t i = 0; i < l->n; i++)
        l->reach[i] = reach_of_spacing * fminf(l->reach[i], most_spacing * (float)mean);
    return SPIN_OK;
}

/* True if splat i is to be matched: it has no track, and its position and colour are finite. */
static bool may_be_linked(const struct spin_splats *s, const uint32_t *of, size_t i)
{
    float sum = 0;

    for (size_t c = 0; c < 3; c++)
        sum += s->means[3 * i + c] + colour_of(s, i, c);
    return of[i] == SPIN_NO_TRACK && isfinite(sum);
}

static spin_status read_loose(struct spin_pool *pool, const struct spin_splats *s,
                              const uint32_t *of, struct loose *l)
{
    size_t n = 0;

    for (size_t i = 0; i < s->n; i++)
        n += may_be_linked(s, of, i);
    SPIN_TRY(open_loose(l, n));
    n = 0;
    for (size_t i = 0; i < s->n; i++) {
        if (!may_be_linked(s, of, i))
            continue;
        l->splat[n] = (uint32_t)i;
        l->chain[n] = SPIN_NO_TRACK;
        memcpy(l->at + 3 * n, s->means + 3 * i, 3 * sizeof *l->at);
        memcpy(l->expected + 3 * n, s->means + 3 * i, 3 * sizeof *l->at);
        for (size_t c = 0; c < 3; c++)
            l->colour[3 * n + c] = colour_of(s, i, c) / colour_tolerance;
        n++;
    }
    return set_reach(pool, l);
}

static spin_status add_track(struct spin_track_matching *chains, const float at[3],
                             uint32_t *number)
{
    SPIN_TRY(spin_array_grow(chains->n, &chains->capacity, 3 * sizeof *chains->place,
                             (void **)&chains->place));
    memcpy(chains->place + 3 * chains->n, at, 3 * sizeof *at);
    *number = (uint32_t)chains->n++;
    return SPIN_OK;
}

/* Records that splat k of `to` is the match of splat i of `from`: adds splat k to the track of
 * splat i, which is created if necessary, and sets the predicted position of splat k. */
static spin_status add_link(struct spin_track_matching *chains, struct loose *from, size_t i,
                            struct loose *to, size_t k)
{
    if (from->chain[i] == SPIN_NO_TRACK)
        SPIN_TRY(add_track(chains, from->at + 3 * i, &from->chain[i]));
    to->chain[k] = from->chain[i];
    for (size_t c = 0; c < 3; c++)
        to->expected[3 * k + c] += share_of_step * (to->at[3 * k + c] - from->at[3 * i + c]);
    return SPIN_OK;
}

static spin_status link_frames(struct spin_pool *pool, struct spin_track_matching *chains,
                               struct loose *from, struct loose *to)
{
    SPIN_FREED uint32_t *next = NULL;

    SPIN_TRY(spin_alloc(from->n + 1, sizeof *next, (void **)&next));
    SPIN_TRY(spin_link(pool, &(struct spin_link_side){from->n, from->expected, from->colour},
                       from->reach, &(struct spin_link_side){to->n, to->at, to->colour}, 3, next));
    for (size_t i = 0; i < from->n; i++)
        if (next[i] != SPIN_NO_LINK)
            SPIN_TRY(add_link(chains, from, i, to, next[i]));
    return SPIN_OK;
}

static void number_splats(const struct loose *l, uint32_t *of, uint32_t first)
{
    for (size_t i = 0; i < l->n; i++)
        if (l->chain[i] != SPIN_NO_TRACK)
            of[l->splat[i]] = first + l->chain[i];
}

static spin_status match_frames(struct spin_pool *pool, struct spin_track_matching *chains,
                                struct spin_plan *plan, uint32_t **of, uint32_t first)
{
    unsigned there = plan->clip.bundle.meta.columns;
    unsigned columns = SPIN_COL_MEANS | (there & SPIN_COL_RGB ? SPIN_COL_RGB : there & SPIN_COL_SH);
    struct spin_splats splats = {0};
    struct loose side[2] = {{0}};
    spin_status status = SPIN_OK;

    for (int f = 0; f < plan->clip.n_frames; f++) {
        struct loose *from = &side[(f + 1) % 2], *to = &side[f % 2];

        SPIN_TRY_OUT(
            spin_bundle_frame(&plan->clip.bundle, spin_plan_index(plan, f), columns, &splats));
        SPIN_TRY_OUT(read_loose(pool, &splats, of[f], to));
        SPIN_TRY_OUT(link_frames(pool, chains, from, to));
        if (f > 0)
            number_splats(from, of[f - 1], first);
    }
    number_splats(&side[(plan->clip.n_frames + 1) % 2], of[plan->clip.n_frames - 1], first);
out:
    for (int k = 0; k < 2; k++)
        close_loose(&side[k]);
    spin_splats_free(&splats);
    return status;
}

spin_status spin_track_matching_find(struct spin_track_matching *chains, struct spin_plan *plan,
                                     uint32_t **of, uint32_t first)
{
    struct spin_pool *pool = NULL;
    spin_status status;

    SPIN_TRY(spin_pool_create(plan->o->n_threads, &pool));
    status = match_frames(pool, chains, plan, of, first);
    spin_pool_free(pool);
    return status;
}

void spin_track_matching_close(struct spin_track_matching *chains)
{
    free(chains->place);
    memset(chains, 0, sizeof *chains);
}

/* ---- Stable matching of two frames ----------------------------------------------------------- */

enum { CHUNK = 256, MOST_ROUNDS = 100 };

/* A pair of splats. One of them is known from the context: it is the index of the element in `held`
 * or `wanted` below. */
struct link {
    float cost;     /* INFINITY: no match */
    uint32_t splat; /* the other splat of the pair */
};

struct round {
    const struct spin_link_side *from, *to;
    const float *reach;
    size_t width;
    struct spin_kd_tree tree; /* positions of `to` */
    struct link *held;        /* [to->n] current match of each splat of `to` */
    struct link *wanted;      /* [from->n] proposals of this round */
    uint32_t *next;           /* [from->n] current match of each splat of `from` */
};

struct search {
    const struct round *round;
    size_t from;
    struct link *wanted;
};

static bool is_better(struct link a, struct link b)
{
    return a.cost < b.cost || (a.cost == b.cost && a.cost < INFINITY && a.splat < b.splat);
}

/* Returns the cost of a pair of splats; INFINITY if they must not be matched. */
static float cost_of(const struct round *r, size_t from, size_t to)
{
    const float *at = r->from->at + 3 * from, *to_at = r->to->at + 3 * to;
    const float *appearance = r->from->appearance + r->width * from,
                *to_appearance = r->to->appearance + r->width * to;
    float cost = 0, reach = r->reach[from];

    for (int k = 0; k < 3; k++)
        cost += (to_at[k] - at[k]) * (to_at[k] - at[k]);
    if (!(cost <= reach * reach))
        return INFINITY;
    cost /= reach * reach;
    for (size_t k = 0; k < r->width; k++) {
        float e = to_appearance[k] - appearance[k];

        if (fabsf(e) > 1)
            return INFINITY;
        cost += e * e;
    }
    return cost;
}

static void improve_proposal(void *context, uint32_t to)
{
    const struct search *s = context;
    struct link link = {cost_of(s->round, s->from, to), to};

    if (is_better(link, *s->wanted) &&
        is_better((struct link){link.cost, (uint32_t)s->from}, s->round->held[to]))
        *s->wanted = link;
}

static void find_best(void *context, size_t first, size_t last)
{
    const struct round *r = context;

    for (size_t i = first; i < last; i++) {
        r->wanted[i] = (struct link){INFINITY, 0};
        if (r->next[i] == SPIN_NO_LINK && r->reach[i] > 0)
            spin_kd_tree_within(&r->tree, r->from->at + 3 * i, r->reach[i], improve_proposal,
                                &(struct search){r, i, &r->wanted[i]});
    }
}

/* Accepts each proposal whose cost is lower than that of the current match of the splat of `to`,
 * and dissolves that match. Returns true if there was any proposal. */
static bool make_links(struct round *r)
{
    bool any = false;

    for (size_t i = 0; i < r->from->n; i++) {
        struct link want = r->wanted[i], *held;

        if (want.cost == INFINITY)
            continue;
        any = true;
        held = &r->held[want.splat];
        if (!is_better((struct link){want.cost, (uint32_t)i}, *held))
            continue;
        if (held->cost < INFINITY)
            r->next[held->splat] = SPIN_NO_LINK;
        *held = (struct link){want.cost, (uint32_t)i};
        r->next[i] = want.splat;
    }
    return any;
}

spin_status spin_link(struct spin_pool *pool, const struct spin_link_side *from, const float *reach,
                      const struct spin_link_side *to, size_t width, uint32_t *next)
{
    struct round r = {.from = from, .to = to, .reach = reach, .width = width, .next = next};
    int n_rounds = 0;
    spin_status status = SPIN_OK;

    SPIN_TRY_OUT(spin_kd_tree_open(&r.tree, to->n, to->at));
    SPIN_TRY_OUT(spin_alloc(to->n + 1, sizeof *r.held, (void **)&r.held));
    SPIN_TRY_OUT(spin_alloc(from->n + 1, sizeof *r.wanted, (void **)&r.wanted));
    for (size_t i = 0; i < to->n; i++)
        r.held[i].cost = INFINITY;
    for (size_t i = 0; i < from->n; i++)
        next[i] = SPIN_NO_LINK;
    do
        spin_pool_rows(pool, from->n, CHUNK, find_best, &r);
    while (make_links(&r) && ++n_rounds < MOST_ROUNDS);
out:
    spin_kd_tree_close(&r.tree);
    free(r.held);
    free(r.wanted);
    return status;
}

/* ---- Rotation of tracks ---------------------------------------------------------------------- */

/* A turn is fitted to the NEIGHBOURS nearest neighbours of a splat within rotation_reach times the
 * median spacing of splats. With fewer than FEWEST neighbours, the turn is not determined. Tuned on
 * the clip "court" (docs/results.md). */
enum { NEIGHBOURS = 24, FEWEST = 4, TURNS_CHUNK = 64 };
static const float rotation_reach = 8;
/* The fit is repeated PASSES times, with lower weights for neighbours with large errors, such as
 * those on another part of the body that moves differently. */
enum { PASSES = 3 };
/* A neighbour follows a turn if the squared error of the rotated offset is at most this share of
 * the squared change of the offset. A turn is accepted only if most neighbours follow it: splats
 * that are matched by colour may slide over a surface, and their displacements then do not reflect
 * its rotation. Tuned on the clips "court" and "basketball". */
static const float most_left = 0.5f;

spin_status spin_turns_open(struct spin_turns *turns, int n_frames)
{
    turns->n_frames = n_frames;
    return spin_alloc((size_t)n_frames, sizeof *turns->frame, (void **)&turns->frame);
}

void spin_turns_close(struct spin_turns *turns)
{
    for (int f = 0; turns->frame && f < turns->n_frames; f++) {
        spin_pages_release(turns->frame[f].at);
    }
    free(turns->frame);
    memset(turns, 0, sizeof *turns);
}

spin_status spin_turns_reserve(struct spin_turns *turns, int f, size_t n)
{
    struct spin_turns_frame *frame = &turns->frame[f];

    SPIN_TRY(spin_pages_reserve_in(turns->scratch, (8 * n + 1) * sizeof *frame->at,
                                   (void **)&frame->at));
    frame->n = n;
    frame->turn = frame->at + 3 * n;
    frame->track = (uint32_t *)(frame->turn + 4 * n);
    for (size_t i = 0; i < n; i++)
        frame->turn[4 * i] = 1;
    return SPIN_OK;
}

/* ---- A rotation ------------------------------------------------------------------------------ */

/* Offsets of the neighbours of a splat in the reference frame (from) and in another frame (to).
 * centre_offsets() subtracts the weighted mean of the offsets of each frame. */
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

/* Sets m to Horn's symmetric matrix: its eigenvector with the largest eigenvalue is the quaternion
 * of the rotation that best maps `from` to `to`. Returns an upper bound of the absolute values of
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

/* Sets q to the best rotation. Power iteration finds the eigenvector, after adding a multiple of
 * the identity to the matrix, which makes all eigenvalues nonnegative. The iteration starts from
 * the value of q on entry. If several rotations fit equally well, as for neighbours on a line, the
 * result is the rotation nearest to that value. */
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

/* Computes the weight of each neighbour from its error under the rotation q. Returns true if most
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

/* A neighbour of a splat: its row in the reference frame, and its squared distance from the splat.
 */
struct near {
    uint32_t row;
    float square;
};

/* A reference frame, with a kd-tree to find neighbours. */
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

/* Sets q to the turn of the splat in row j of frame `to`; i is the row of its track in the
 * reference frame. On entry, q is the turn of the previous step; it is left unchanged if the
 * neighbours do not determine a turn. */
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

/* Computes the turns of all tracks whose reference frame is origin->frame. */
static spin_status follow_frame(struct origin *origin, struct spin_pool *pool)
{
    const struct spin_turns_frame *from = &origin->turns->frame[origin->frame];
    float square;
    spin_status status;

    if (from->n < FEWEST)
        return SPIN_OK;
    SPIN_TRY(spin_knn_median_dist2(pool, from->n, from->at, &square));
    origin->reach = rotation_reach * sqrtf(square);
    status = spin_kd_tree_open(&origin->tree, from->n, from->at);
    if (status == SPIN_OK)
        spin_pool_rows(pool, from->n, TURNS_CHUNK, follow_rows, origin);
    spin_kd_tree_close(&origin->tree);
    return status;
}

/* Sets *frame_of [n_tracks] to the reference frame of each track, which is the frame nearest to the
 * middle of the clip in which the track has a splat. The caller frees *frame_of. */
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
