/* The iterations of a training: of a clip, or of a single frame, which is a clip of one frame. */
#pragma once

#include "train/checkpoint.h"
#include "train/densify.h"
#include "train/sampler.h"
#include "train/step_log.h"

struct spin_loop {
    struct spin_plan *plan;
    struct spin_photos *photos;
    struct spin_trainer *trainer;
    struct spin_checkpoint *checkpoint; /* a single frame uses only its clock */
    struct spin_step_log *step_log;
    struct spin_schedule schedule; /* iterations that densify */
    struct spin_densify_options densify;
    /* Called after each evaluation; NULL: none. */
    spin_status (*looked)(void *context);
    void *context;
};
/* Sets the schedule and the densification options from the plan. */
struct spin_loop spin_loop_of(struct spin_plan *plan, struct spin_photos *photos,
                              struct spin_trainer *trainer, struct spin_checkpoint *checkpoint,
                              struct spin_step_log *step_log);

/* Statistics of the iterations so far. Zero it first. */
struct spin_steps {
    struct spin_train_values last;     /* losses of the last iteration */
    struct spin_densify_change change; /* result of the last densification */
    /* Number of iterations; number of iterations without a visible splat; first such iteration. */
    int64_t done, blind, first_blind;
    /* Seconds of each operation in the last iteration, and in all; seconds of all iterations. */
    double step_s[SPIN_N_OPS], op_s[SPIN_N_OPS], wall_s;
    double exchange_s, sent; /* communication with other ranks: seconds, bytes sent */
};

/* Runs one iteration, densifies if it is due, and logs a line. Afterwards the trainer can be saved,
 * and the loss is finite. */
spin_status spin_loop_step(const struct spin_loop *loop, struct spin_sampler *sampler,
                           struct spin_steps *steps);
/* Runs the remaining iterations of a clip, saves checkpoints, and evaluates the result. */
spin_status spin_loop_run(const struct spin_loop *loop);
