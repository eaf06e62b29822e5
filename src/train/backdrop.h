/* Opaque splats behind the outermost surfaces of a scene. In training over a black background, dark
 * surfaces may become transparent, since the black that shows through them matches their colour;
 * over any other background such surfaces look like holes. A backdrop with the colours of the
 * surfaces fills these holes already during training, so the result looks the same over any
 * background.
 *
 * The splats of the backdrop are static tracks, the last ones of the clip. They are trained like
 * other static tracks, except that their opacity is fixed and that they are neither split nor
 * pruned. */
#pragma once

#include "train/train_frame.h"
#include "train/photos.h"
#include "train/tracks.h"

/* Resolves SPIN_BACKDROP_AUTO in the options of the report to off or on. AUTO becomes off if frames
 * have fewer than 1000 splats on average, or if the borders of the training images show one flat
 * colour (a subject in front of a uniform background). Any choice becomes off without tracks, with
 * refined frames, or with --method 4d. */
spin_status spin_backdrop_choose(struct spin_plan *plan, struct spin_photos *photos);
/* If the option is on, computes the splats of plan->backdrop, appends one track for each of them to
 * those of the source and adds the number of these splats to plan->counts of every frame.
 * SPIN_E_MALFORMED if a mean of the source is not finite. */
spin_status spin_backdrop_add(struct spin_plan *plan, struct spin_tracks *tracks);
/* Appends the backdrop's splats to a frame of the source. Sets their means; their values in all
 * other columns are 0. */
spin_status spin_backdrop_append(const struct spin_backdrop *b, struct spin_splats *s);
/* Sets the last b->n points of a frame's cloud to the initial values of the backdrop's splats. */
void spin_backdrop_first_values(const struct spin_backdrop *b, struct spin_refine_cloud *cloud);
