/* The settings that determine the result, as JSON: stored with the result, and compared before a
 * resume. */
#pragma once

#include "io/json.h"
#include "train/plan.h"

/* Settings for refining a frame. */
spin_json *spin_settings_refine(const struct spin_plan *plan);
/* Settings for training the clip. init_log_scale: the initial log scale of splats, NaN if not known
 * yet. */
spin_json *spin_settings_network(const struct spin_plan *plan, double init_log_scale);
