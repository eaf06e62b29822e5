/* The arrays of a Dynamic 3D Gaussians run (params.npz) and of its descendants.
 *
 * Frames are converted one by one, straight from the map. */
#ifndef SPIN_IMPORTERS_LIB_D3DGS_RUN_H
#define SPIN_IMPORTERS_LIB_D3DGS_RUN_H

#include "importers/lib/model.h"
#include "io/npy.h"

enum { D3DGS_MEANS, D3DGS_COLOURS, D3DGS_ROTATIONS, D3DGS_OPACITIES, D3DGS_SCALES, D3DGS_N_KEYS };

struct d3dgs_run {
    struct spin_model base;
    struct spin_npz npz;
    struct spin_array array[D3DGS_N_KEYS];
    uint64_t n_frames, n;
    size_t *counts; /* [n_frames] */
};

/* Among the member names of a peek. */
bool spin_d3dgs_has_key(const struct spin_peek *peek, const char *key);

/* How many of the five arrays are there. */
int spin_d3dgs_count_keys(const struct spin_peek *peek);

spin_status spin_d3dgs_fail_shape(const struct spin_array *a, const char *key,
                                  const char *expected);

spin_status spin_d3dgs_array(struct d3dgs_run *run, const char *key, struct spin_array *out);

/* Opens params.npz, or that of a folder, and binds the arrays: a track of n_frames frames of n Gaussians. */
spin_status spin_d3dgs_load(const char *path, struct d3dgs_run *run);

/* An importer's close(). */
void spin_d3dgs_close(void *self);

/* All Gaussians of one frame. */
spin_status spin_d3dgs_read(const struct d3dgs_run *run, int frame, unsigned columns,
                            struct spin_splats *out);

#endif
