/* The Gaussians in a checkpoint of Realtime-4DGS and of its forks: tensors of one row each. */
#ifndef SPIN_IMPORTERS_LIB_REALTIME4DGS_ROWS_H
#define SPIN_IMPORTERS_LIB_REALTIME4DGS_ROWS_H

#include "importers/lib/gaussian4d.h"
#include "importers/lib/realtime4dgs_parts.h"
#include "io/torch.h"

/* Floats of all SH of a row, in space and in time. */
#define REALTIME4DGS_SH 144

struct realtime4dgs_rows {
    size_t n;
    bool moving;                  /* in four dimensions: has t and scaling_t */
    bool rot_4d;                  /* rotated in them: has rotation_r too */
    int n_sh;                     /* of a row in the file; 0: SH are not read */
    int degree, degree_t;         /* of SH that are drawn, in space and in time */
    struct spin_array dc, rest;   /* SH, in the checkpoint, with which they die */
    float *xyz, *scaling;         /* [n][3] */
    float *rotation, *rotation_r; /* [n][4] of any length */
    float *opacity;               /* [n] logits */
    float *t, *scaling_t;         /* [n] */
};

/* How rows become Gaussians. */
struct realtime4dgs_reading {
    bool older;      /* the rotations of 4-D are those before 2024-09 */
    bool transposed; /* those of 3-D are turned the other way */
    double extra;    /* is added to the variance of time where it weighs only */
};

/* Reads all tensors, SH on demand. sh_degree: of cfg_args, -1: not told. No rows at all are no error. Free
 * also after a failure. */
spin_status spin_realtime4dgs_rows_open(struct spin_torch *torch,
                                        const struct realtime4dgs_parts *parts, bool with_sh,
                                        double sh_degree, struct realtime4dgs_rows *rows);
/* All but SH, which are no memory of their own. */
void spin_realtime4dgs_rows_free(struct realtime4dgs_rows *rows);

/* A row with rot_4d at any time. */
void spin_realtime4dgs_slice(const struct realtime4dgs_rows *rows, size_t i, bool older,
                             spin_slice *out);

/* Adds all rows, the first as `row`; what is not finite is counted as dropped. Those that do not move are
 * there at all times. Returns how many are nearly transparent. */
size_t spin_realtime4dgs_rows_add(const struct realtime4dgs_rows *rows, size_t row,
                                  const struct realtime4dgs_reading *reading,
                                  struct gaussian4d *gaussians);

/* All SH of a row, [n_sh][3]. */
void spin_realtime4dgs_sh(const struct realtime4dgs_rows *rows, size_t i,
                          float out[REALTIME4DGS_SH]);
/* Those that are drawn, [(degree+1)^2][3], dt after the row's own time in a clip of such a length. */
void spin_realtime4dgs_colours(const struct realtime4dgs_rows *rows, size_t i, double dt,
                               double length, float *out);

#endif
