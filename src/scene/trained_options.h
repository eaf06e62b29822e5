/* The options of a training as recorded in a bundle, for reports. */
#pragma once

#include "io/json.h"

/* A copy of "options" of "trained" in meta.json, without the options of a network if none was
 * trained. NULL: there are none. */
spin_json *spin_trained_options(const spin_json *trained);
