/* Transforms of prims of USD. */
#pragma once

#include "formats/gaussian.h"
#include "formats/usd_compose.h"

/* Sets *out to the placement of a prim in the scene. A stage with z up is rotated to y up before
 * the half turn about x that leads to the axes of a training, if `turned`. */
spin_status spin_usd_place(struct spin_usd_stage *s, const struct usd_node *node, double time,
                           bool turned, struct spin_placement *out);
