/* A clip's points drawn over the images of its data set: a wrong axis or pairing is seen at once. */
#ifndef SPIN_RUN_CAMERA_OVERLAY_H
#define SPIN_RUN_CAMERA_OVERLAY_H

#include "scene/dataset.h"

struct spin_camera_overlay_share {
    double in_front, inside; /* of the points: before the camera; in the image, too. 0..1 */
};

/* Draw the points of a frame (means; colours when there are rgb or sh) over the view's image, darkened,
 * into a PNG of that name. */
spin_status spin_camera_overlay_draw(const struct spin_view *view, const struct spin_splats *s,
                                     const char *path, struct spin_camera_overlay_share *out);

/* The shares alone, of at most `most` points, evenly from all of them. */
void spin_overlay_measure(const struct spin_camera *camera, const struct spin_splats *s,
                          size_t most, struct spin_camera_overlay_share *out);

/* The views of one row lie together: how many, and which is the first. */
size_t spin_overlay_row(const struct spin_views *views, int row, size_t *first);

/* At most `most` of the views of one row, evenly from all of them: indices into views->view. Returns how many. */
size_t spin_camera_overlay_choose(const struct spin_views *views, int row, size_t most,
                                  size_t *index);

#endif
