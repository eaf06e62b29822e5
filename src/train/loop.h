/* The iterations of a network training. */
#ifndef SPIN_TRAIN_LOOP_H
#define SPIN_TRAIN_LOOP_H

#include "train/checkpoint.h"
#include "train/frames.h"
#include "train/step_log.h"

struct spin_loop {
    struct spin_plan *plan;
    struct spin_photos *photos;
    struct spin_frames *frames;
    struct spin_trainer *trainer;
    struct spin_checkpoint *checkpoint;
    struct spin_step_log *step_log;
};

/* All iterations that are left, states saved on the way, then a last measurement. */
spin_status spin_loop_run(const struct spin_loop *loop);

#endif
