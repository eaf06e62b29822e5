/* Deferred acceptance (Gale and Shapley), in rounds. In each round, every unmatched splat of `from`
 * proposes to a splat of `to`: the one with the lowest cost among those that are unmatched or
 * matched at a higher cost. A splat of `to` keeps the proposal with the lowest cost and drops a
 * match with a higher cost. The result is a stable matching. */
#include "train/link.h"

#include "base/base.h"
#include "geometry/kd_tree.h"

enum { CHUNK = 256, MOST_ROUNDS = 100 };

/* The match of a splat with another one. */
struct link {
    float cost;     /* INFINITY: there is no match */
    uint32_t splat; /* the other splat */
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

/* Returns the cost of a match of two splats; INFINITY if they must not be matched. */
static float cost_of(const struct round *r, size_t from, size_t to)
{
    const float *at = r->from->at + 3 * from, *to_at = r->to->at + 3 * to;
    const float *look = r->from->look + r->width * from, *to_look = r->to->look + r->width * to;
    float cost = 0, reach = r->reach[from];

    for (int k = 0; k < 3; k++)
        cost += (to_at[k] - at[k]) * (to_at[k] - at[k]);
    if (!(cost <= reach * reach))
        return INFINITY;
    cost /= reach * reach;
    for (size_t k = 0; k < r->width; k++) {
        float e = to_look[k] - look[k];

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

/* Accepts all proposals whose cost is lower than that of the current match. Returns whether there
 * was a proposal. */
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
