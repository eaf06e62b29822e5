/* Opaque splats behind the outermost surfaces of a scene. Training over black lets dark surfaces
 * become transparent, since black lies behind them; over any other colour they are holes. With a
 * backdrop in the colours of the surfaces, holes show what closes them during training already, so
 * that the result looks the same over any background.
 *
 * Its splats are static tracks, the last ones of the clip. They learn as others do, but stay opaque
 * and are neither split nor pruned. */
#pragma once

#include "train/cloud.h"
#include "train/photos.h"
#include "train/tracks.h"

/* Turns SPIN_BACKDROP_AUTO of the report's options into on or off: off where image borders are
 * flat, and for methods without tracks. */
spin_status spin_backdrop_choose(struct spin_plan *plan, struct spin_photos *photos);
/* Lays it out as plan->backdrop where the options say on, and adds its tracks behind those of the
 * source and its splats to plan->counts. SPIN_E_MALFORMED when a mean is not finite. */
spin_status spin_backdrop_add(struct spin_plan *plan, struct spin_tracks *tracks);
/* Adds its splats behind those of a frame of the source; columns other than means are 0. */
spin_status spin_backdrop_append(const struct spin_backdrop *b, struct spin_splats *s);
/* The first values of a frame's last splats. */
void spin_backdrop_first_values(const struct spin_backdrop *b, struct spin_refine_cloud *cloud);
void spin_backdrop_free(struct spin_backdrop *b);
