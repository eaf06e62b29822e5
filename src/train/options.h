/* Operations on the retraining options by their rows in options.def. */
#pragma once

#include "spin_train.h"
#include "io/json.h"

/* SPIN_E_USAGE if an option is outside its limits, naming the first one. */
spin_status spin_options_check(const struct spin_retrain_options *o);

/* Resolves numbers that depend on the clip and on the ranks: batch, iterations, the interval
 * between densifications, learning rates. */
void spin_options_resolve(struct spin_retrain_options *o, int n_frames);

/* Phrases that end error messages: how to continue an unfinished run. */
const char *spin_options_continue(const struct spin_retrain_options *o);
/* The options that discard an unfinished run. */
const char *spin_options_restart(const struct spin_retrain_options *o);

enum spin_options_of { SPIN_OPTIONS_OF_NETWORK, SPIN_OPTIONS_OF_REFINEMENT };
/* The options that decide the result of the network's training, or of a frame's refinement. The
 * caller frees it. */
spin_json *spin_options_to_json(const struct spin_retrain_options *o, enum spin_options_of of);
