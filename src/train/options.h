/* What the rows of options.def say of the options of a retraining. */
#pragma once

#include "spin_train.h"
#include "io/json.h"

/* Every option lies within its limits; else SPIN_E_USAGE, which names the first that does not. */
spin_status spin_options_check(const struct spin_retrain_options *o);

/* Numbers that a preset leaves to the clip: iterations, and how often tracks are densified. */
void spin_options_resolve(struct spin_retrain_options *o, int n_frames);

/* How the user continues an unfinished run, and what discards it, for the ends of errors. */
const char *spin_options_continue(const struct spin_retrain_options *o);
const char *spin_options_restart(const struct spin_retrain_options *o);

enum spin_options_of { SPIN_OPTIONS_OF_NETWORK, SPIN_OPTIONS_OF_REFINEMENT };
/* Those that decide the result of the network's training, or of a frame's refinement. Allocated. */
spin_json *spin_options_to_json(const struct spin_retrain_options *o, enum spin_options_of of);
