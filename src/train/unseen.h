/* Initial values of splats that no training camera sees. */
#pragma once

#include "train/cloud.h"
#include "train/plan.h"

/* Splats start faint, in order to learn. Those that no training camera sees learn nothing and would
 * stay faint, as holes in views from elsewhere. They start with the source's attributes or, if it
 * has only points, nearly opaque. All others are marked as seen. The cloud has the initial values
 * of frame f, made from these splats. */
spin_status spin_show_unseen(const struct spin_plan *plan, const struct spin_splats *s, int f,
                             struct spin_refine_cloud *cloud);
