/* Finds what a clip is about, as a ball: what moves or, without motion, its densest part. */
#pragma once

#include "geometry/voxels.h"

struct spin_subject {
    double centre[3], radius;
    double reach; /* radius of the ball around `centre` that contains 90 % of the opaque area */
    double span;  /* radius within which splats of the subject were looked for */
    bool moves;
    size_t *splat;  /* [n], splats of the subject, indices into the voxels' list */
    double *weight; /* [n], visible opacity of each */
    size_t n;
};

spin_status spin_subject_find(const struct spin_voxels *v, uint64_t seed, struct spin_subject *out);
void spin_subject_free(struct spin_subject *s);

/* Draws item i with probability weight[i] / sum of weights; `sums` are the running sums. share: 0
 * to 1. */
size_t spin_subject_draw(const double *sums, size_t n, double share);
