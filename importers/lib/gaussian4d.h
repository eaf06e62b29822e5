/* Four-dimensional Gaussians as 4D splats: ellipsoids of fixed shape on straight lines, with a
 * Gaussian window in time. */
#pragma once

#include "importers/lib/model.h"
#include "math/activate.h"
#include "math/covariance.h"

/* State while splats are added to the model's splats_4d. */
struct gaussian4d {
    size_t n;         /* added */
    size_t n_dropped; /* rows of the file that cannot be used */
    size_t *row;      /* [n] row of the file of each splat */
};

/* Reserves n rows in the model's splats_4d, whose paths are lines. */
spin_status spin_gaussian4d_reserve(struct spin_model *m, struct gaussian4d *g, size_t n,
                                    int sh_degree, unsigned parts);

/* Adds one Gaussian of known shape; variance: of its window in time, HUGE_VAL for a permanent one.
 * A row that would yield nonfinite values is counted and dropped. Returns NULL then, else where its
 * SH go; SH that vary in time go to the same row of sh_cos. */
float *spin_gaussian4d_add(struct spin_model *m, struct gaussian4d *g, size_t row,
                           const float mean[3], double time, double logit, const double velocity[3],
                           double variance, const double log_scale[3], const double quat[4]);

/* Adds one Gaussian from its slice; `extra` is added to the variance of the window only. */
float *spin_gaussian4d_add_slice(struct spin_model *m, struct gaussian4d *g, size_t row,
                                 const float mean[3], double time, double logit,
                                 const spin_slice *slice, double extra);

/* Call after all n rows: SPIN_E_MALFORMED when none can be used. Notes how many were dropped and
 * `why` (NULL: no note), and that training had just reset opacities when nearly all, n_faint, are
 * below SPIN_FAINT. */
#define SPIN_FAINT 0.02
spin_status spin_gaussian4d_check(const struct gaussian4d *g, size_t n, size_t n_faint,
                                  const char *why, struct spin_sequence_info *sequence);

/* Call before spin_gaussian4d_finish(): drops sh_cos if it is 0 in all rows, and without sh_cos
 * also the highest SH degrees that are 0 in all rows. */
void spin_gaussian4d_drop_zeros(struct spin_model *m);

/* Call last: multiplies the times of the splats, which are in the unit of the file, by `ratio`,
 * calls spin_splats_4d_settle(), and describes the sequence as continuous over the clip's times. */
spin_status spin_gaussian4d_finish(struct spin_model *m, const struct gaussian4d *g, double ratio,
                                   const struct clip_times *times);
