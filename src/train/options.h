/* Checks the retraining options, replaces automatic values, and converts options to JSON, using the
 * table in options.def. */
#pragma once

#include "spin_train.h"
#include "io/json.h"

/* Checks that all options are within their limits. SPIN_E_USAGE if an option is outside its limits;
 * the error names the first such option. */
spin_status spin_options_check(const struct spin_retrain_options *o);

/* Replaces automatic values by those for a clip of n_frames frames and the number of ranks: batch,
 * iterations, track_iterations, densify_every, and learning rates. most_iterations limits the
 * default number of iterations of the presets quick and best. */
void spin_options_resolve(struct spin_retrain_options *o, int n_frames, int most_iterations);

/* Returns the default number of iterations of the preset quick, without the limit below. */
double spin_options_clip_iterations(int n_frames);
/* Returns the upper limit of the default number of iterations, for n_images training images of
 * cameras at n_positions distinct positions: n_images x n_positions^2 / 12, but at least 1000. A
 * longer training with few cameras overfits (docs/results.md). */
int spin_options_most_iterations(size_t n_images, size_t n_positions);

/* Returns a phrase for the end of an error message, which states how to continue an unfinished run.
 */
const char *spin_options_continue(const struct spin_retrain_options *o);
/* Returns a phrase for error messages: the options that discard an unfinished run. */
const char *spin_options_restart(const struct spin_retrain_options *o);

enum spin_options_of { SPIN_OPTIONS_OF_NETWORK, SPIN_OPTIONS_OF_REFINEMENT };
/* Returns a JSON object with the options that affect the result of a clip's training (OF_NETWORK)
 * or of a frame's refinement (OF_REFINEMENT). The caller frees the object. */
spin_json *spin_options_to_json(const struct spin_retrain_options *o, enum spin_options_of of);
