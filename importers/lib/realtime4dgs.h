/* The Gaussians in a checkpoint of Realtime-4DGS and of its forks: tensors of one row each, in a tuple in the
 * method's own, in dicts in forks. */
#ifndef SPIN_IMPORTERS_LIB_REALTIME4DGS_H
#define SPIN_IMPORTERS_LIB_REALTIME4DGS_H

#include "importers/lib/gaussian4d.h"

/* Floats of all SH of a row, in space and in time. */
#define REALTIME4DGS_SH 144

/* The renderer skips a Gaussian whose weight in time is not above this. */
#define REALTIME4DGS_LEAST_WEIGHT 0.05
/* Initial times are drawn from the clip and 10% beyond both its ends. */
#define REALTIME4DGS_SPREAD 1.2

enum realtime4dgs_part {
    R4_ACTIVE,
    R4_XYZ, /* from here on to R4_OPACITY: what static Gaussians have too */
    R4_DC,
    R4_REST,
    R4_SCALING,
    R4_ROTATION,
    R4_OPACITY,
    R4_T,
    R4_SCALING_T,
    R4_ROTATION_R,
    R4_ROT_4D,
    R4_ENV_MAP,
    R4_ACTIVE_T,
    R4_OPTIMIZER,
    R4_N_PARTS
};

struct realtime4dgs {
    /* Where the parts are. */
    const char *who; /* stands before their names in messages; NULL: nothing */
    const struct spin_value *part[R4_N_PARTS]; /* NULL: not there */
    bool swapped;                              /* SH are [N][3][K] */
    bool masked;                               /* a fork's mask follows */
    bool moving;                               /* gaussian_dim 4: has t and scaling_t */
    double iteration;                          /* -1: not told */
    /* What was read. */
    size_t n;
    bool rot_4d;             /* rotated in four dimensions: has rotation_r too */
    int n_sh;                /* of a row in the file; 0: SH are not read */
    int degree, degree_t;    /* of SH that are drawn, in space and in time */
    struct spin_array sh[2]; /* dc, rest; in the checkpoint, with which they die */
    /* While open() runs: xyz, scaling [n][3]; rotation, rotation_r [n][4] of any length; opacity [n] logits; t,
     * scaling_t [n] */
    float *column[R4_N_PARTS];
};

/* How rows become Gaussians. */
struct realtime4dgs_reading {
    bool older;      /* the rotations of 4-D are those before 2024-09 */
    bool transposed; /* those of 3-D are turned the other way */
    double extra;    /* is added to the variance of time where it weighs only */
};

/* Finds the parts; *r is zero before. Other methods' checkpoints are refused, with their name where it shows. */
spin_status spin_realtime4dgs_parts(const struct spin_value *root, struct realtime4dgs *r);
/* For forks that save more: the items of a 4-D model's tuple, from the 1st to the 19th. */
void spin_realtime4dgs_items(const struct spin_value *model, struct realtime4dgs *r);
/* And the dict that training takes as loaded_pth, whose keys begin with `prefix`: features have their last
 * two axes swapped, and there are no degrees. */
void spin_realtime4dgs_loaded(const struct spin_value *dict, const char *prefix,
                              struct realtime4dgs *r);
/* A part is not there, None, or without elements. */
bool spin_realtime4dgs_lacks(const struct realtime4dgs *r, enum realtime4dgs_part part);
/* Its name in messages. */
const char *spin_realtime4dgs_name(enum realtime4dgs_part part);

/* Reads all tensors, SH on demand, with the SH degree that cfg_args tells. No rows at all are no error. */
spin_status spin_realtime4dgs_read(struct spin_model *m, bool with_sh, struct realtime4dgs *r);

/* A row with rot_4d at any time. */
void spin_realtime4dgs_slice(const struct realtime4dgs *r, size_t i, bool older, spin_slice *out);

/* Adds all rows, the first as `row`; what is not finite is counted as dropped. Those that do not move are
 * there at all times. Returns how many are nearly transparent. */
size_t spin_realtime4dgs_add(const struct realtime4dgs *r, size_t row,
                             const struct realtime4dgs_reading *reading,
                             struct gaussian4d *gaussians);

/* All SH of a row, [n_sh][3]. */
void spin_realtime4dgs_sh(const struct realtime4dgs *r, size_t i, float out[REALTIME4DGS_SH]);
/* Those that are drawn, [(degree+1)^2][3], dt after the row's own time in a clip of such a length. */
void spin_realtime4dgs_colours(const struct realtime4dgs *r, size_t i, double dt, double length,
                               float *out);

/* ", iteration 30000", or nothing. */
const char *spin_realtime4dgs_iteration(const struct realtime4dgs *r, char text[48]);
/* Notes times that were guessed, and an environment map. */
void spin_realtime4dgs_note(const struct realtime4dgs *r, const struct clip_times *times,
                            struct spin_sequence_info *sequence);

#endif
