/* Finds the (splat, tile) pairs of one splat. There is one pair for each tile of the splat's
 * rectangle, without the columns and rows in tile_cull. The pairs are ordered row by row: pair k of
 * a splat has the index first_intersection + k. */
#pragma once

#include "device/device.h"
#include "math/portable.h"

struct spin_pair_rect {
    int x0, y0, x1, y1; /* columns [x0, x1) and rows [y0, y1) of tiles */
};

SPIN_FN struct spin_pair_rect spin_pair_rect(const struct spin_splat2d *s)
{
    struct spin_pair_rect r = {0, 0, 0, 0};

    if (s->radius_px > 0) {
        r.x0 = s->x0 + s->tile_cull[0];
        r.y0 = s->y0 + s->tile_cull[1];
        r.x1 = s->x1 - s->tile_cull[2];
        r.y1 = s->y1 - s->tile_cull[3];
    }
    return r;
}

SPIN_FN uint32_t spin_pair_count(struct spin_pair_rect r)
{
    return (uint32_t)(r.x1 - r.x0) * (uint32_t)(r.y1 - r.y0);
}
