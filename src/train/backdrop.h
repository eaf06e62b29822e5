/* Opaque splats behind the outermost surfaces of a scene. In training over black, dark surfaces may
 * become transparent, since the black behind them shows through; over any other background they are
 * holes. A backdrop with the colours of the surfaces fills these holes already during training, so
 * the result looks the same over any background.
 *
 * Its splats are static tracks, the last ones of the clip. They are trained like others, but stay
 * opaque and are neither split nor pruned. */
#pragma once

#include "train/cloud.h"
#include "train/photos.h"
#include "train/tracks.h"

/* Resolves SPIN_BACKDROP_AUTO in the report's options: off where image borders are flat (a subject
 * before a uniform colour), else on. Always off without tracks, with refined frames and for 4D
 * splats. */
spin_status spin_backdrop_choose(struct spin_plan *plan, struct spin_photos *photos);
/* If the backdrop is on, lays out plan->backdrop, appends its tracks to those of the source and
 * adds its splats to plan->counts. SPIN_E_MALFORMED if a mean is not finite. */
spin_status spin_backdrop_add(struct spin_plan *plan, struct spin_tracks *tracks);
/* Appends the backdrop's splats to a frame of the source; their columns other than means are 0. */
spin_status spin_backdrop_append(const struct spin_backdrop *b, struct spin_splats *s);
/* Sets the initial values of a frame's last b->n splats. */
void spin_backdrop_first_values(const struct spin_backdrop *b, struct spin_refine_cloud *cloud);
