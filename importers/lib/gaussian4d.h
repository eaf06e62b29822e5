/* Conversion of four-dimensional Gaussians to 4D splats: ellipsoids of fixed shape that move along
 * straight lines and have a Gaussian window in time. */
#pragma once

#include "importers/lib/model.h"
#include "math/activate.h"
#include "math/covariance.h"

/* State while splats are added to the model's splats_4d. */
struct gaussian4d {
    size_t n;         /* number of splats added so far */
    size_t n_dropped; /* number of rows of the file that were dropped */
    size_t *row;      /* [n] for each splat, its row in the file */
};

/* Allocates n rows in the model's splats_4d, with straight lines as paths and with the optional
 * arrays `parts`. */
spin_status spin_gaussian4d_reserve(struct spin_model *m, struct gaussian4d *g, size_t n,
                                    int sh_degree, unsigned parts);

/* Adds the Gaussian of row `row` of the file, with its log scales and its quaternion. `variance` is
 * the variance of its window in time, or HUGE_VAL if the Gaussian is permanent. Returns the address
 * in splats_4d.sh to which the caller writes the SH of the Gaussian; SH that vary over time belong
 * in the row of sh_cos with the same index. A row whose values could overflow is dropped and
 * counted in g->n_dropped, and the function returns NULL. */
float *spin_gaussian4d_add(struct spin_model *m, struct gaussian4d *g, size_t row,
                           const float mean[3], double time, double logit, const double velocity[3],
                           double variance, const double log_scale[3], const double quat[4]);

/* Like spin_gaussian4d_add(), but shape, velocity and variance are those of `slice`; `extra` is
 * added to the variance. */
float *spin_gaussian4d_add_slice(struct spin_model *m, struct gaussian4d *g, size_t row,
                                 const float mean[3], double time, double logit,
                                 const spin_slice *slice, double extra);

/* To be called when all n rows of the file have been passed to the functions above. Returns
 * SPIN_E_MALFORMED if all were dropped. If some were, adds a note for the user with their number
 * and the reason `why` (NULL: no note). n_faint is the number of opacities below SPIN_FAINT; if it
 * is nearly n, another note states that training had just reset opacities. */
#define SPIN_FAINT 0.02
spin_status spin_gaussian4d_check(const struct gaussian4d *g, size_t n, size_t n_faint,
                                  const char *why, struct spin_sequence_info *sequence);

/* To be called before spin_gaussian4d_finish(). Frees sh_cos if all its values are 0. If there is
 * then no sh_cos, lowers the SH degree as long as all coefficients of the highest degree are 0. */
void spin_gaussian4d_drop_zeros(struct spin_model *m);

/* To be called last. Converts the splats from the file's unit of time to that of the clip, which is
 * smaller by the factor `ratio`: multiplies times and sigmas by `ratio`, and divides velocities by
 * it. Also sets the period of the cosines in time to the length of the clip. Then calls
 * spin_model_finish_4d() and sets the range of the sequence to the clip's times. */
spin_status spin_gaussian4d_finish(struct spin_model *m, const struct gaussian4d *g, double ratio,
                                   const struct clip_times *times);
