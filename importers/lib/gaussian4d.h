/* 4-D Gaussians, as 4D splats: ellipsoids of fixed shape on straight lines, whose opacity is a bell
 * in time. */
#pragma once

#include "importers/lib/model.h"
#include "math/activate.h"
#include "math/covariance.h"

/* The splats of a model while they are added; when all are, they are the model's splats_4d. */
struct gaussian4d {
    size_t n;         /* added */
    size_t n_dropped; /* rows of the file that cannot be used */
    size_t *row;      /* [n] of the file */
};

/* Room for n rows in the model's splats, whose paths are lines. */
spin_status spin_gaussian4d_reserve(struct spin_model *m, struct gaussian4d *g, size_t n,
                                    int sh_degree, unsigned parts);

/* One Gaussian of known shape; variance: of time, HUGE_VAL for one that is there at all times. A
 * row that would write anything that is not finite is counted and dropped. NULL, or where its SH
 * go; those in time go to the same place of sh_cos. */
float *spin_gaussian4d_add(struct spin_model *m, struct gaussian4d *g, size_t row,
                           const float mean[3], double time, double logit, const double velocity[3],
                           double variance, const double log_scale[3], const double quat[4]);

/* One Gaussian out of its slice; `extra` is added to the variance of time where it weighs only. */
float *spin_gaussian4d_add_slice(struct spin_model *m, struct gaussian4d *g, size_t row,
                                 const float mean[3], double time, double logit,
                                 const spin_slice *slice, double extra);

/* When all n rows were added: SPIN_E_MALFORMED when none can be used. Notes how many were dropped,
 * as of `why` (NULL: it does not), and that training had just reset opacities when nearly all,
 * n_faint, are below SPIN_FAINT. */
#define SPIN_FAINT 0.02
spin_status spin_gaussian4d_check(const struct gaussian4d *g, size_t n, size_t n_faint,
                                  const char *why, struct spin_sequence_info *sequence);

/* Before that: SH in time that are 0 in all rows go, and without those what is 0 in all of the
 * highest degrees. */
void spin_gaussian4d_drop_zeros(struct spin_model *m);

/* Last of all: the times of the splats, which are those of the file, become those of the clip,
 * `ratio` times as many, and the sequence is any time in the clip. */
spin_status spin_gaussian4d_finish(struct spin_model *m, const struct gaussian4d *g, double ratio,
                                   const struct clip_times *times);
