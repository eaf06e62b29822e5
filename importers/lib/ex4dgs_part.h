/* The Gaussians of Ex4DGS: the static ones and the dynamic ones, out of its checkpoint or out of its PLYs. */
#ifndef SPIN_IMPORTERS_LIB_EX4DGS_PART_H
#define SPIN_IMPORTERS_LIB_EX4DGS_PART_H

#include "io/torch.h"

enum ex4dgs_column {
    EX4DGS_PLACE,    /* [3] of every key frame */
    EX4DGS_ROTATION, /* [4] of every key frame, w x y z of any length */
    EX4DGS_SCALE,    /* [3] logarithms */
    EX4DGS_OPACITY,  /* logit */
    EX4DGS_SH,       /* [(sh_degree+1)^2][3] */
    EX4DGS_DRIFT,    /* static ones: [3] over the whole clip */
    EX4DGS_CENTRE,   /* dynamic ones: [2] times, in key frames */
    EX4DGS_WIDTH,    /* dynamic ones: [2] logarithms, in key frames */
    EX4DGS_N_COLUMNS
};

struct ex4dgs_part {
    bool moving; /* the dynamic ones; set by the caller before reading */
    size_t n;
    int n_keys; /* 1 of static ones */
    int sh_degree;
    float *column[EX4DGS_N_COLUMNS]; /* [n][spin_ex4dgs_width()]; NULL: these Gaussians have none */
};

size_t spin_ex4dgs_width(const struct ex4dgs_part *p, enum ex4dgs_column column);

void spin_ex4dgs_part_free(struct ex4dgs_part *p);

/* From the tuple of a checkpoint, with SH up to the degree `active`. A part that training has not made yet
 * is n = 0. Free it also after a failure. */
spin_status spin_ex4dgs_part_of_chkpnt(struct spin_torch *torch, const struct spin_value *model,
                                       int active, struct ex4dgs_part *p);

/* From point_cloud.ply or dynamic_point_cloud.ply of a folder. Free it also after a failure. */
spin_status spin_ex4dgs_part_of_ply(const char *folder, struct ex4dgs_part *p);

/* Makes the rotations of static Gaussians unit quaternions, with scales that give the ellipsoids of the
 * method's rasteriser. Removes rows that cannot be drawn, and returns how many. */
size_t spin_ex4dgs_part_clean(struct ex4dgs_part *p);

#endif
