/* Writes the output bundle of a retraining: the source, the refined frames, and the trained values.
 */
#pragma once

#include "train/checkpoint.h"
#include "train/training_frames.h"

struct spin_output {
    struct spin_plan *plan;
    struct spin_refinement *refinement;
    struct spin_frames *frames;   /* unused with --method frames */
    struct spin_trainer *trainer; /* unused with --method frames */
    const char *fingerprint;
    const char *simd_paths; /* all SIMD paths that the training used */
};

/* Writes the output bundle. It contains no times or durations, so equal runs write identical files.
 */
spin_status spin_output_write(const struct spin_output *output);
/* True if the output file exists, and has this fingerprint and the precision of the plan. */
bool spin_output_is_done(const struct spin_plan *plan, const char *fingerprint);
