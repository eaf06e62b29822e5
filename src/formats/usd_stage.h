/* Composes layers of USD to a scene, and reads its splats: prims of type
 * ParticleField3DGaussianSplat (OpenUSD 26.03). Sublayers, references, payloads, value clips and
 * packages (.usdz) are supported. Paths of files are relative to the layer that contains them.
 *
 * There is a frame at each time code at which a splat attribute or a transform has a sample;
 * between samples, values stay constant. Transforms of prims must be similarities. Scales in a file
 * are standard deviations, and opacities are 0 to 1. Arrays may consist of floats or of half
 * floats; the latter have other attribute names. */
#pragma once

#include "formats/usd_compose.h"

/* Opens the stage whose root layer or package is the file `path`. Set *out to zero before the call,
 * and close it even after a failure. All arrays of a prim must have the same number of splats.
 * Error messages contain the path of a file. */
spin_status spin_usd_stage_open(const char *path, struct spin_usd_stage *out);
void spin_usd_stage_close(struct spin_usd_stage *stage);
/* Reads the splats of a frame, in the axes of the stage or, if `turned` is true, in the axes right,
 * down, forward, which trainings use. Rows that are not finite are dropped, and *n_dropped receives
 * their number; more than one in 1,000 are an error. Rotations are normalised. */
spin_status spin_usd_stage_read(struct spin_usd_stage *stage, size_t frame, bool turned,
                                unsigned columns, struct spin_splats *out, size_t *n_dropped);
