/* Opaque splats behind the outermost surfaces of a scene. In a training over a black background,
 * dark surfaces may become transparent, because the black background shows through them in their
 * own colour; over any other background, such surfaces look like holes. A backdrop with the colours
 * of the surfaces closes the scene from the start of the training, so the result looks the same
 * over any background.
 *
 * Each splat of the backdrop is a static track. These tracks are the last ones of the clip. They
 * are trained like other static tracks, except that their opacity is fixed and that they are
 * neither split nor pruned. */
#pragma once

#include "train/train_frame.h"
#include "train/photos.h"
#include "train/tracks.h"

/* Replaces SPIN_BACKDROP_AUTO in the options of the report by OFF or ON. It is OFF if frames have
 * fewer than 1000 splats on average, or if the borders of the training images show one flat colour
 * (a subject in front of a uniform background). Without tracks, with refined frames and with
 * --method 4d, any value is replaced by OFF. */
spin_status spin_backdrop_choose(struct spin_plan *plan, struct spin_photos *photos);
/* If the option is ON, computes the splats plan->backdrop, appends one track per backdrop splat to
 * `tracks`, and adds the number of these splats to plan->counts of every frame. SPIN_E_MALFORMED if
 * a mean of the source is not finite. */
spin_status spin_backdrop_add(struct spin_plan *plan, struct spin_tracks *tracks);
/* Appends the splats of the backdrop to a frame of the source. Only their means are set; all other
 * columns of these splats are 0. */
spin_status spin_backdrop_append(const struct spin_backdrop *b, struct spin_splats *s);
/* Sets the last b->n points of a frame's cloud to the initial values of the backdrop. */
void spin_backdrop_first_values(const struct spin_backdrop *b, struct spin_refine_cloud *cloud);
