/* Transforms of prims of USD. */
#pragma once

#include "formats/gaussian.h"
#include "formats/usd_compose.h"

/* Sets *out to the transform from a prim to the scene. If `turned` is true, a rotation to the axes
 * right, down, forward, which trainings use, is appended: from z up to y up, if the stage has z up,
 * and then half a turn about x. */
spin_status spin_usd_place(struct spin_usd_stage *s, const struct usd_node *node, double time,
                           bool turned, struct spin_placement *out);
