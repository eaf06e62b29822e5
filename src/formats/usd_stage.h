/* Composes layers of USD to a scene, and reads its splats: prims of type
 * ParticleField3DGaussianSplat (OpenUSD 26.03). Composed are sublayers, references and payloads,
 * value clips, and packages (.usdz). Files that a layer names are opened
 * relative to it.
 *
 * There is a frame at each time code at which a splat attribute or a transform has a sample;
 * between samples, values stay constant. Transforms of prims must be similarities. Scales in a file
 * are standard deviations, and opacities are 0 to 1. Numbers may be half floats, which are in
 * attributes with other names. */
#pragma once

#include "formats/usd_compose.h"

/* Opens the stage whose root layer, or package, is at `path`. Zero *out before the call, and close
 * it even after a failure. All arrays are checked to have the same number of splats. Error messages
 * contain the path of a file. */
spin_status spin_usd_stage_open(const char *path, struct spin_usd_stage *out);
void spin_usd_stage_close(struct spin_usd_stage *stage);
/* Reads the splats of a frame in the axes of the stage, after a further rotation to the axes right,
 * down, forward of a training if `turned`. Up to one in 1,000 rows that are not finite are dropped,
 * and *n_dropped receives their number; more are an error. Rotations are normalised. */
spin_status spin_usd_stage_read(struct spin_usd_stage *stage, size_t frame, bool turned,
                                unsigned columns, struct spin_splats *out, size_t *n_dropped);
