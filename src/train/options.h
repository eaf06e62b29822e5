/* Checks, resolves and converts the retraining options, as the rows of options.def describe them.
 */
#pragma once

#include "spin_train.h"
#include "io/json.h"

/* Checks that all options are within their limits. SPIN_E_USAGE if one is not; the error names the
 * first such option. */
spin_status spin_options_check(const struct spin_retrain_options *o);

/* Replaces the numbers that depend on the length of the clip and on the number of ranks by their
 * final values: batch, iterations, the interval between densifications, learning rates. Default
 * iterations of quick and best are limited to most_iterations. */
void spin_options_resolve(struct spin_retrain_options *o, int n_frames, int most_iterations);

/* Returns the limit on default iterations for n_images training images of cameras at n_positions
 * distinct positions: the square of the positions / 12 for each image, and at least 1000. With more
 * iterations, few cameras are overtrained (docs/results.md). */
int spin_options_most_iterations(size_t n_images, size_t n_positions);

/* Phrase for the end of an error message: how to continue an unfinished run. */
const char *spin_options_continue(const struct spin_retrain_options *o);
/* Phrase for error messages: the options that discard an unfinished run. */
const char *spin_options_restart(const struct spin_retrain_options *o);

enum spin_options_of { SPIN_OPTIONS_OF_NETWORK, SPIN_OPTIONS_OF_REFINEMENT };
/* Returns the options that affect the result of a clip's training (OF_NETWORK), or of a frame's
 * refinement (OF_REFINEMENT), as a JSON object. The caller frees it. */
spin_json *spin_options_to_json(const struct spin_retrain_options *o, enum spin_options_of of);
