/* Four-dimensional Gaussians as 4D splats: ellipsoids of fixed shape on straight lines, with a
 * Gaussian window in time. */
#pragma once

#include "importers/lib/model.h"
#include "math/activate.h"
#include "math/covariance.h"

/* State while splats are added to the model's splats_4d. */
struct gaussian4d {
    size_t n;         /* splats added so far */
    size_t n_dropped; /* rows of the file that were dropped */
    size_t *row;      /* [n] for each splat, its row in the file */
};

/* Reserves n rows in the model's splats_4d, whose paths are lines. */
spin_status spin_gaussian4d_reserve(struct spin_model *m, struct gaussian4d *g, size_t n,
                                    int sh_degree, unsigned parts);

/* Adds one Gaussian of known shape. variance: of its window in time; HUGE_VAL for a permanent
 * Gaussian. Returns the address at which the caller stores the SH; SH that vary in time go to the
 * same row of sh_cos. A row that would yield nonfinite values is dropped and counted, and the
 * function returns NULL. */
float *spin_gaussian4d_add(struct spin_model *m, struct gaussian4d *g, size_t row,
                           const float mean[3], double time, double logit, const double velocity[3],
                           double variance, const double log_scale[3], const double quat[4]);

/* Adds one Gaussian whose shape, velocity and variance in time are those of `slice`; `extra` is
 * added to the variance. */
float *spin_gaussian4d_add_slice(struct spin_model *m, struct gaussian4d *g, size_t row,
                                 const float mean[3], double time, double logit,
                                 const spin_slice *slice, double extra);

/* To be called after all n rows. Returns SPIN_E_MALFORMED if all rows were dropped. Notes the
 * number of dropped rows and the reason `why` (NULL: no note). If n_faint, the number of opacities
 * below SPIN_FAINT, is nearly n, notes that training had just reset opacities. */
#define SPIN_FAINT 0.02
spin_status spin_gaussian4d_check(const struct gaussian4d *g, size_t n, size_t n_faint,
                                  const char *why, struct spin_sequence_info *sequence);

/* To be called before spin_gaussian4d_finish(). Drops sh_cos if all its values are 0; without
 * sh_cos, also drops the highest SH degrees while all their values are 0. */
void spin_gaussian4d_drop_zeros(struct spin_model *m);

/* To be called last. Multiplies the splats' times, which are in the file's unit, by `ratio`, calls
 * spin_splats_4d_settle(), and describes the sequence as continuous over the clip's times. */
spin_status spin_gaussian4d_finish(struct spin_model *m, const struct gaussian4d *g, double ratio,
                                   const struct clip_times *times);
