/* Finds the training options that a bundle records, for reports. */
#pragma once

#include "io/json.h"

/* Returns a copy of "options" in "trained" of meta.json. If no network was trained, the options of
 * the network are omitted. Returns NULL if there are no options. */
spin_json *spin_trained_options(const spin_json *trained);
