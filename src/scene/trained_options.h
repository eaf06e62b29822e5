/* The options of a training as a bundle tells them, for people. */
#pragma once

#include "io/json.h"

/* A copy of "options" of "trained" (of meta.json); where no network was trained, without those of a
 * network. NULL: there are none. */
spin_json *spin_trained_options(const spin_json *trained);
