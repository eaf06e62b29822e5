/* The settings that affect the result, as JSON. They are stored with the result; a resume requires
 * that they are equal to those of the checkpoint. */
#pragma once

#include "io/json.h"
#include "train/plan.h"

/* Returns the settings that affect the refinement of a frame; the caller frees them. */
spin_json *spin_settings_refine(const struct spin_plan *plan);
/* Returns the settings that affect the training of the clip; the caller frees them. */
spin_json *spin_settings_network(const struct spin_plan *plan);
