/* Initial values of splats that no training camera sees. */
#pragma once

#include "train/cloud.h"
#include "train/plan.h"

/* cloud: initial values of frame f, made from the splats s. They are faint, since training makes
 * them opaque. Splats that no training camera sees would stay faint and leave holes in other views:
 * they get the source's attributes or, from a source of points, a high opacity. All other points of
 * the cloud are marked as seen. */
spin_status spin_show_unseen(const struct spin_plan *plan, const struct spin_splats *s, int f,
                             struct spin_refine_cloud *cloud);
