/* Finds what stands still in a clip whose frames share no splats, and stores it once. */
#pragma once

#include "scene/clip.h"

struct spin_settled {
    double n_static, n_dynamic; /* rows that are the same in all frames; other rows per frame */
    double n_before;            /* rows per frame of the source */
};

/* Writes the bundle `output`, whose frames begin with the same static rows to the bit, which
 * spin-retrain recognises as static tracks, followed by the dynamic rows of each frame. The data
 * set of the new bundle is `input`, drawn by "renders".
 *
 * A splat is dynamic if, in some frame, the renders of most cameras that have it in their image
 * differ there from their median over time. This is a visual hull of what moves; it needs no links
 * between splats, and flicker below a threshold is no motion. Static rows are those of the middle
 * frame; those of other frames fill its holes.
 *
 * keep: NULL, or the shares of static and dynamic rows to keep at random, with scales enlarged so
 * that they cover as much. */
spin_status spin_settle(const char *input, const char *data_from, const double keep[2],
                        const char *output, bool force, struct spin_settled *settled);
