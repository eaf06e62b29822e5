/* Runs the iterations of a training. A single frame is trained like a clip with one frame. */
#pragma once

#include "train/checkpoint.h"
#include "train/densify.h"
#include "train/photos.h"
#include "train/step.h"

struct spin_loop {
    struct spin_plan *plan;
    struct spin_photos *photos;
    struct spin_trainer *trainer;
    struct spin_checkpoint *checkpoint; /* for a single frame, only its times are set */
    struct spin_step_log *step_log;
    /* Iterations that end with a densification. */
    struct spin_schedule schedule;
    struct spin_densify_options densify;
    /* Called with `context` after each evaluation of the test views; may be NULL. */
    spin_status (*looked)(void *context);
    void *context;
};
/* Returns a loop over these objects, with the schedule and the densification options of the plan.
 */
struct spin_loop spin_loop_of(struct spin_plan *plan, struct spin_photos *photos,
                              struct spin_trainer *trainer, struct spin_checkpoint *checkpoint,
                              struct spin_step_log *step_log);

/* Statistics of the iterations of this run. Zero the struct before the first iteration. */
struct spin_steps {
    struct spin_train_values last;     /* losses in the last iteration */
    struct spin_densify_change change; /* changes by the last densification */
    /* done: number of iterations. blind: number of iterations without a visible splat. first_blind:
     * the first iteration without a visible splat. */
    int64_t done, blind, first_blind;
    /* Seconds of each device operation in the last iteration (step_s) and in all iterations (op_s);
     * elapsed seconds of all iterations (wall_s). */
    double step_s[SPIN_N_OPS], op_s[SPIN_N_OPS], wall_s;
    /* Communication with other ranks in all iterations: seconds spent, and bytes sent by this rank.
     */
    double exchange_s, sent;
};

/* Runs one iteration, densifies if the schedule contains this iteration, and writes a line to the
 * log. After SPIN_OK, the loss is finite and the trainer can be saved in a checkpoint. */
spin_status spin_loop_step(const struct spin_loop *loop, struct spin_sampler *sampler,
                           struct spin_steps *steps);
/* Runs the remaining iterations of a clip's training, saves checkpoints regularly, and evaluates
 * the test views at the end. */
spin_status spin_loop_run(const struct spin_loop *loop);
