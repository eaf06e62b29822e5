/* What work was made from and how, as text: kept work is taken again only under the same. */
#pragma once

#include "train/photos.h"

enum { SPIN_FRAME_KEY = 40 }; /* bytes a key may have, with its end */

struct spin_refined {
    char key[SPIN_FRAME_KEY]; /* what it is made from and how */
    bool from_input;          /* the input has it; else it is in the frame cache */
};

/* Of a frame by itself: options, images, its lenses, what it starts from. */
spin_status spin_frame_key(struct spin_plan *plan, const struct spin_photos *photos, int frame,
                           char key[SPIN_FRAME_KEY]);
/* Of a run: options, the frames and what refined frames are made from [frames] or NULL, the images,
 * the names, sizes and CRCs of the input's arrays in their order. To be freed. */
spin_status spin_fingerprint(const struct spin_plan *plan, const struct spin_refined *refined,
                             const struct spin_photos *photos, const struct spin_device *device,
                             char **out);
