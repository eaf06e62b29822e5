/* The options that decide the result, as JSON: stored with it, and compared before a resume. */
#pragma once

#include "io/json.h"
#include "train/plan.h"

/* Of refining a frame. */
spin_json *spin_settings_refine(const struct spin_plan *plan);
/* Of training the network. init_log_scale: the log scale that splats begin with; NaN: not known
 * yet. */
spin_json *spin_settings_network(const struct spin_plan *plan, double init_log_scale);
