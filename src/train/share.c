/* Levels to ranks, and the tree over levels. */
#include "train/share.h"

#include <string.h>

#include "io/ranks.h"

size_t spin_share_floats(const struct spin_grid *grid, int level)
{
    return (size_t)grid->offset[level] * (size_t)grid->n_features;
}

/* The rank of a level: by where the middle of its weight lies. */
static int rank_of(const struct spin_grid *grid, int level, int n_ranks)
{
    double rows = grid->offset[grid->n_levels], n = grid->n_levels;
    double before = grid->offset[level] / rows + level / n;
    double after = grid->offset[level + 1] / rows + (level + 1) / n;

    return (int)((before + after) / 4 * n_ranks);
}

struct spin_levels spin_share_levels(const struct spin_grid *grid, int rank, int n_ranks)
{
    struct spin_levels levels = {0, 0};

    while (levels.first < grid->n_levels && rank_of(grid, levels.first, n_ranks) < rank)
        levels.first++;
    levels.end = levels.first;
    while (levels.end < grid->n_levels && rank_of(grid, levels.end, n_ranks) == rank)
        levels.end++;
    return levels;
}

struct spin_field spin_share_part(const struct spin_field *field, struct spin_levels levels)
{
    struct spin_field part = *field;
    struct spin_grid *grid = &part.grid;

    grid->n_levels = levels.end - levels.first;
    for (int l = 0; l < grid->n_levels; l++) {
        int from = levels.first + l;

        memcpy(grid->scale[l], field->grid.scale[from], sizeof grid->scale[l]);
        memcpy(grid->res[l], field->grid.res[from], sizeof grid->res[l]);
        grid->hashed[l] = field->grid.hashed[from];
    }
    for (int l = 0; l <= grid->n_levels; l++)
        grid->offset[l] = field->grid.offset[levels.first + l] - field->grid.offset[levels.first];
    part.n_table = spin_share_floats(grid, grid->n_levels);
    return part;
}

size_t spin_share_most(const struct spin_grid *grid)
{
    size_t most = 0;

    for (int r = 0; r < spin_n_ranks(); r++) {
        struct spin_levels levels = spin_share_levels(grid, r, spin_n_ranks());
        size_t n = spin_share_floats(grid, levels.end) - spin_share_floats(grid, levels.first);

        most = n > most ? n : most;
    }
    return most;
}

int spin_share_owner(int frame) { return frame % spin_n_ranks(); }

/* Floats of a splat that one rank sends to another: features and back, the branches of its position's gradient. */
static double network_floats(const struct spin_field *field)
{
    struct spin_levels branch[SPIN_MAX_LEVELS];
    double floats = 0;

    for (int r = 0; r < spin_n_ranks(); r++) {
        struct spin_levels levels = spin_share_levels(&field->grid, r, spin_n_ranks());

        floats += 2 * (levels.end - levels.first) * field->grid.n_features +
                  4 * spin_share_branches(field->grid.n_levels, levels, branch);
    }
    return floats;
}

double spin_share_traffic(const struct spin_field *network, double n, bool residual, bool tracks)
{
    double others = spin_n_ranks() - 1;   /* what goes to every rank */
    double one = others / spin_n_ranks(); /* to one, or in equal parts to all: a part stays here */
    double own = 3 + (residual ? SPIN_RESIDUAL : 0), floats;

    /* to the frame's rank and back; positions to who encodes; gradients to who has the tracks */
    floats = n * own * (tracks ? one + others : 2 * one);
    if (tracks)
        floats += n * 4 * one; /* what densification goes by, there and back */
    if (network)
        floats += n * (network_floats(network) * one + 3 * (others - one) + others) +
                  (double)network->n_heads * others;
    return sizeof(float) * floats;
}

static int branches(int first, int n, struct spin_levels levels, struct spin_levels *out)
{
    int half = 1, count;

    if (first >= levels.end || first + n <= levels.first)
        return 0;
    if (first >= levels.first && first + n <= levels.end) {
        *out = (struct spin_levels){first, first + n};
        return 1;
    }
    while (2 * half < n)
        half *= 2;
    count = branches(first, half, levels, out);
    return count + branches(first + half, n - half, levels, out + count);
}

int spin_share_branches(int n, struct spin_levels levels, struct spin_levels out[SPIN_MAX_LEVELS])
{
    return n > 0 ? branches(0, n, levels, out) : 0;
}
