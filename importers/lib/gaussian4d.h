/* 4-D Gaussians as any one time sees them: ellipsoids of fixed shape on straight lines, whose
 * opacity is a bell in time. The shape is worked out once; a frame only moves and weighs. */
#ifndef SPIN_IMPORTERS_LIB_GAUSSIAN4D_H
#define SPIN_IMPORTERS_LIB_GAUSSIAN4D_H

#include "importers/lib/model.h"
#include "math/covariance.h"
#include "math/quat.h"

struct gaussian4d {
    size_t n;          /* Gaussians that can be used */
    size_t n_dropped;  /* rows of the file that cannot */
    float *mean;       /* [n][3] at its own time */
    double *time;      /* [n] that time */
    double *velocity;  /* [n][3] */
    double *variance;  /* [n] of time */
    float *log_scales; /* [n][3] */
    float *quats;      /* [n][4] */
    float *opacity;    /* [n] at its own time */
    size_t *row;       /* [n] of the file */
    size_t *kept;      /* [n] scratch: those that the last time asked for sees */
    size_t n_kept;
    /* What frames show: a weight above the one, and at least the other opacity. */
    double least_weight, least_opacity;
    int sh_degree;
};

/* Room for n rows, as long as the model lives. */
spin_status spin_gaussian4d_reserve(struct spin_model *m, struct gaussian4d *s, size_t n);

/* One Gaussian of known shape. A row that would write anything that is not finite is counted and
 * dropped. */
void spin_gaussian4d_add(struct gaussian4d *s, size_t row, const float mean[3], double time,
                         double opacity, const double velocity[3], double variance,
                         const double log_scale[3], const double quat[4]);

/* One Gaussian out of its slice; `extra` is added to the variance of time where it weighs only. */
void spin_gaussian4d_add_slice(struct gaussian4d *s, size_t row, const float mean[3], double time,
                               double opacity, const spin_slice *slice, double extra);

/* When all n rows were added: SPIN_E_MALFORMED when none can be used. Notes how many were dropped, as of
 * `why` (NULL: it does not), and that training had just reset opacities when nearly all, n_faint, are below
 * SPIN_FAINT. */
#define SPIN_FAINT 0.02
spin_status spin_gaussian4d_check(const struct gaussian4d *s, size_t n, size_t n_faint,
                                  const char *why, struct spin_sequence_info *sequence);

double spin_sigmoid_of(double logit);

double spin_gaussian4d_weight(const struct gaussian4d *s, size_t i, double time);

/* The logit, of an opacity held off 0 and 1 where it has none. */
float spin_logit_of(double opacity);

/* Any time in the clip, of SH that do not say otherwise. */
void spin_gaussian4d_describe(const struct spin_model *m, const struct gaussian4d *s,
                              const struct clip_times *times);

/* A frame: `sh` gives the colours of Gaussian i, dt after its own time; NULL: the caller does. */
typedef void (*gaussian4d_sh_fn)(const void *model, size_t i, double dt, float *out);
spin_status spin_gaussian4d_frame(const struct spin_model *m, struct gaussian4d *s, int frame,
                                  double time, unsigned columns, gaussian4d_sh_fn sh,
                                  struct spin_splats *out);

#endif
