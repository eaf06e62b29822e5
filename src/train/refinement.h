/* Refinement, the per-frame stage of a retraining (docs/method.md section 2), in which every frame
 * is optimised independently. */
#pragma once

#include "train/frame_cache.h"
#include "train/key.h"
#include "train/step.h"

struct spin_refinement {
    struct spin_refined *frame; /* [frames]; NULL if frames are not refined */
    size_t *counts;             /* [frames] number of splats of each refined frame */
    struct spin_splats scratch; /* a refined frame while it is read */
};

/* Allocates memory. SPIN_E_NOT_FOUND if refined frames are to start from the source's attributes
 * and the input does not have these. Zero *refinement first; close it also after a failure. */
spin_status spin_refinement_open(struct spin_refinement *refinement, const struct spin_plan *plan);
void spin_refinement_close(struct spin_refinement *refinement);
/* Computes the key of every frame (key.h), by which frames that were refined earlier are found. */
spin_status spin_refinement_keys(struct spin_refinement *refinement, struct spin_plan *plan,
                                 const struct spin_photos *photos);
/* Refines all frames that are neither in the input nor in the cache, updates the numbers of splats
 * in the plan, and measures the quality of the refined frames. */
spin_status spin_refinement_run(struct spin_refinement *refinement, struct spin_plan *plan,
                                struct spin_photos *photos, struct spin_device *device,
                                struct spin_simd_paths *simd_paths, struct spin_step_log *step_log);
/* Reads the given columns of a refined frame, from the input or from the cache. */
spin_status spin_refinement_read(struct spin_refinement *refinement, struct spin_plan *plan,
                                 int frame, unsigned columns, struct spin_splats *out);
/* The columns of refined frames that the output contains. */
unsigned spin_refinement_columns(const struct spin_plan *plan);
/* Returns the "refined" object of meta.json, which the caller frees. */
spin_json *spin_refinement_to_json(const struct spin_refinement *refinement,
                                   const struct spin_plan *plan);
