/* The iterations of a training: of a clip, or of a frame by itself, which is a clip of one frame.
 */
#pragma once

#include "train/checkpoint.h"
#include "train/densify.h"
#include "train/sampler.h"
#include "train/step_log.h"

struct spin_loop {
    struct spin_plan *plan;
    struct spin_photos *photos;
    struct spin_trainer *trainer;
    struct spin_checkpoint *checkpoint; /* of a frame by itself its clock alone */
    struct spin_step_log *step_log;
    struct spin_schedule schedule; /* of densification */
    struct spin_densify_options densify;
    /* After each look at the state; NULL: nothing more is done. */
    spin_status (*looked)(void *context);
    void *context;
};
/* With schedule and densification of the plan. */
struct spin_loop spin_loop_of(struct spin_plan *plan, struct spin_photos *photos,
                              struct spin_trainer *trainer, struct spin_checkpoint *checkpoint,
                              struct spin_step_log *step_log);

/* What the steps came to so far. Zero it to begin. */
struct spin_steps {
    struct spin_train_values last;     /* of the last step */
    struct spin_densify_change change; /* the same */
    int64_t done, blind,
        first_blind; /* steps; those that showed no splat, iteration of the first */
    double step_s[SPIN_N_OPS], op_s[SPIN_N_OPS], wall_s; /* of the last step; of all */
    double exchange_s, sent; /* with other ranks: seconds, bytes that this one sent */
};

/* One step, its densification and its line in the log; after it the trainer is sound, and its loss
 * finite. */
spin_status spin_loop_step(const struct spin_loop *loop, struct spin_sampler *sampler,
                           struct spin_steps *steps);
/* All iterations of a clip that are left, states saved on the way, then a last measurement. */
spin_status spin_loop_run(const struct spin_loop *loop);
