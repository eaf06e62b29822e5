/* Finds the subject of a clip: the part that moves or, in a static clip, the densest part. That is
 * the part with the most opaque area or, if `detail` is set, with the most small splats: in a room,
 * a person instead of a wall. The subject is described by its splats and by a ball around most of
 * them. */
#pragma once

#include "geometry/voxels.h"

struct spin_subject {
    double centre[3], radius;
    double reach; /* radius of the ball around `centre` that contains 90 % of the opaque area */
    double span;  /* only splats within this distance of `centre` belong to the subject */
    bool moves;
    size_t *splat; /* [n] splats of the subject, as indices into spin_voxels.splat */
    /* [n] weights of these splats. If the subject moves: their opacity, reduced where they are
     * occluded or seem to flicker; with `detail`, their opacity; otherwise their opaque area. */
    double *weight;
    size_t n;
};

spin_status spin_subject_find(const struct spin_voxels *v, bool detail, uint64_t seed,
                              struct spin_subject *out);
void spin_subject_free(struct spin_subject *s);

/* Samples an item by its weight: returns the first i whose running sum sums[i] exceeds `share`, 0
 * to 1, of the total. A uniform random share gives item i with the probability weight[i] /
 * total. */
size_t spin_subject_draw(const double *sums, size_t n, double share);
