/* How the ranks of a job (io/ranks.h) share a training. The table goes by levels: a rank has some that follow each
 * other, with their moments. The frames of a step go round: the first to rank 0, the next to rank 1. A frame's own
 * parameters and their moments live with its owner, who steps them. What else is trained, every rank has: tracks,
 * heads and exposures, which all ranks step alike.
 *
 * Whatever the number of ranks, the result has the same bits. A level's gradient is added up by its owner, frame
 * after frame; the gradient of a position is added over levels by a binary tree, of which ranks send whole
 * branches; what all frames share is added up frame by frame, on one rank too (step.c). */
#ifndef SPIN_TRAIN_SHARE_H
#define SPIN_TRAIN_SHARE_H

#include "model/field.h"

struct spin_levels {
    int first, end;
};

/* The levels of a rank: each has about the same part of the rows and of the levels. Ranks beyond the number of
 * levels have none. */
struct spin_levels spin_share_levels(const struct spin_grid *grid, int rank, int n_ranks);

/* The network with these levels alone; offsets count from the first of them. */
struct spin_field spin_share_part(const struct spin_field *field, struct spin_levels levels);

/* Floats of the table before a level. */
size_t spin_share_floats(const struct spin_grid *grid, int level);

/* Floats of the largest part of a table that one of the ranks has. */
size_t spin_share_most(const struct spin_grid *grid);

/* The rank that has a frame's own parameters. It also measures the frame: spin_metrics_rank(). */
int spin_share_owner(int frame);

/* Bytes that all ranks together send for a frame of n splats in a step, when all of its splats have a gradient and a
 * position of their own. network: or NULL; residual: they have values of their own too; tracks: and there are tracks,
 * which a step before a densification shows. */
double spin_share_traffic(const struct spin_field *network, double n, bool residual, bool tracks);

/* The largest branches of the tree over n levels that make up these, in order; returns how many. The tree over n
 * adds the first 2^k, 2^k < n, and the others. */
int spin_share_branches(int n, struct spin_levels levels, struct spin_levels out[SPIN_MAX_LEVELS]);

#endif
