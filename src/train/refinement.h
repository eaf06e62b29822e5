/* The per-frame stage of a retraining (docs/method.md section 2): every frame is optimised
 * independently. */
#pragma once

#include "train/code_paths.h"
#include "train/frame_cache.h"
#include "train/key.h"
#include "train/step_log.h"

struct spin_refinement {
    struct spin_refined *frame; /* [frames], or NULL: frames are not refined */
    size_t *counts;             /* [frames] splats of the refined frame */
    struct spin_splats scratch; /* memory for one refined frame */
};

/* Allocates memory. SPIN_E_NOT_FOUND if frames should start from the source's attributes and the
 * input lacks these. Zero it first; close it also after a failure. */
spin_status spin_refinement_open(struct spin_refinement *refinement, const struct spin_plan *plan);
void spin_refinement_close(struct spin_refinement *refinement);
/* Computes the cache key of every frame (key.h), by which earlier refinements are found. */
spin_status spin_refinement_keys(struct spin_refinement *refinement, struct spin_plan *plan,
                                 const struct spin_photos *photos);
/* Refines all frames that neither the input nor the cache contains, updates the numbers of splats
 * in the plan, and measures the refined frames. */
spin_status spin_refinement_run(struct spin_refinement *refinement, struct spin_plan *plan,
                                struct spin_photos *photos, struct spin_device *device,
                                struct spin_code_paths *code_paths, struct spin_step_log *step_log);
/* Reads columns of a refined frame. */
spin_status spin_refinement_read(struct spin_refinement *refinement, struct spin_plan *plan,
                                 int frame, unsigned columns, struct spin_splats *out);
/* The columns of refined frames that the output contains. */
unsigned spin_refinement_columns(const struct spin_plan *plan);
/* The "refined" object of meta.json. */
spin_json *spin_refinement_to_json(const struct spin_refinement *refinement,
                                   const struct spin_plan *plan);
