/* The options of a training as a bundle tells them, for people. */
#ifndef SPIN_SCENE_TRAINED_OPTIONS_H
#define SPIN_SCENE_TRAINED_OPTIONS_H

#include "io/json.h"

/* A copy of "options" of "trained" (of meta.json); where no network was trained, without those of a network. NULL:
 * there are none. */
spin_json *spin_trained_options(const spin_json *trained);

#endif
