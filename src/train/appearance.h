/* Which places of a scene look different over time: in shadows that pass, or in reflections. */
#pragma once

#include "train/photos.h"

/* varies [n]: whether the brightness at place [n][3] (world units) changes over the clip. In some
 * frame it differs from its median over time in more than half of the training cameras, and in two
 * or more of them: so a change at the place is told from what passes in front of it, which only
 * some cameras see. Looks at 32 frames of the clip at most. A place that fewer than two cameras see
 * in a frame does not vary there. */
spin_status spin_appearance_varies(const struct spin_plan *plan, struct spin_photos *photos,
                                   size_t n, const float *place, uint8_t *varies);
