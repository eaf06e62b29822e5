/* Matches the splats of each frame with those of the next, in one pass; only two frames are in
 * memory at a time. */
#include "train/track_matching.h"

#include "base/base.h"
#include "math/sh.h"
#include "geometry/knn.h"
#include "train/link.h"

/* Tuned on the clip "basketball" (docs/results.md). The search radius of a splat is
 * reach_of_spacing times its distance to its neighbours. Matched splats differ by at most
 * colour_tolerance in each colour channel, 0..1. A splat is expected to repeat share_of_step of its
 * last displacement. */
static const float reach_of_spacing = 3, colour_tolerance = 0.1f, share_of_step = 0.7f;
/* For the search radius, the distance of a splat to its neighbours is limited to this many times
 * the mean distance of all splats, so that outliers are not matched across the scene. */
static const float most_spacing = 4;

/* The splats of a frame that may be matched. */
struct loose {
    size_t n;
    uint32_t *splat; /* [n] row of each splat in the frame */
    uint32_t *chain; /* [n] index of the track built by matching, or SPIN_NO_TRACK */
    float *at;       /* [n][3] position */
    float *expected; /* [n][3] expected position in the next frame */
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

/* Sets the search radius of each splat, around its expected position. */
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

/* True if splat i may be matched: it has no track, and all its values are finite. */
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

/* Records that splat k of `to` is the match of splat i of `from`: adds it to the track of i, and
 * updates its expected position. */
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
