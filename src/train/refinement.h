/* The frame-wise stage of a retraining (docs/method.md section 2): every frame is optimised on its
 * own. */
#pragma once

#include "train/code_paths.h"
#include "train/frame_cache.h"
#include "train/key.h"
#include "train/step_log.h"

struct spin_refinement {
    struct spin_refined *frame; /* [frames], or NULL: frames are not refined */
    size_t *counts;             /* [frames] splats of the refined frame */
    struct spin_splats scratch; /* of one refined frame */
};

/* Room for what is known of every frame; nothing is done yet. Zero it first; close it also after a
 * failure. */
spin_status spin_refinement_open(struct spin_refinement *refinement, const struct spin_plan *plan);
void spin_refinement_close(struct spin_refinement *refinement);
/* What every frame will be made from. */
spin_status spin_refinement_keys(struct spin_refinement *refinement, struct spin_plan *plan,
                                 const struct spin_photos *photos);
/* Refine all frames that are not there yet, plan with what became of them, and measure it. */
spin_status spin_refinement_run(struct spin_refinement *refinement, struct spin_plan *plan,
                                struct spin_photos *photos, struct spin_device *device,
                                struct spin_code_paths *code_paths, struct spin_step_log *step_log);
/* Columns of a refined frame. */
spin_status spin_refinement_read(struct spin_refinement *refinement, struct spin_plan *plan,
                                 int frame, unsigned columns, struct spin_splats *out);
/* The columns that the output keeps of refined frames, and the "refined" object of meta.json. */
unsigned spin_refinement_columns(const struct spin_plan *plan);
spin_json *spin_refinement_to_json(const struct spin_refinement *refinement,
                                   const struct spin_plan *plan);
