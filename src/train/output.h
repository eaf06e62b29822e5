/* The bundle that a retraining leaves: the source, the refined frames, the network. */
#pragma once

#include "train/checkpoint.h"
#include "train/frames.h"

struct spin_output {
    struct spin_plan *plan;
    struct spin_refinement *refinement;
    struct spin_frames *frames;   /* with a network */
    struct spin_trainer *trainer; /* with a network */
    const char *fingerprint;
    const char *code_paths; /* that did the work */
};

/* Nothing in it tells when or how fast it was made, so equal runs give equal files. */
spin_status spin_output_write(const struct spin_output *output);
/* The output is there and was made this way. */
bool spin_output_is_done(const struct spin_plan *plan, const char *fingerprint);
