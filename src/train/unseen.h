/* What no training camera sees. */
#pragma once

#include "train/cloud.h"
#include "train/plan.h"

/* Splats begin faint, in order to learn. Those that no training camera sees learn nothing, and
 * would stay faint: holes for who looks from elsewhere. They begin as the source has them, or,
 * where it is points, nearly opaque. All others are marked as seen. The cloud is what frame f
 * begins with, made from these splats. */
spin_status spin_show_unseen(const struct spin_plan *plan, const struct spin_splats *s, int f,
                             struct spin_refine_cloud *cloud);
