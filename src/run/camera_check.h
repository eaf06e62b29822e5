/* A clip's points drawn over the images of its data set: a wrong axis or pairing is seen at once.
 * And what share of a frame's points each camera sees, and which camera sees far fewer than the
 * others: its pose or size is probably wrong, though the mean over many cameras hardly shows it. */
#pragma once

#include "scene/dataset.h"

struct spin_camera_overlay_share {
    double in_front, inside; /* of the points: before the camera; in the image, too. 0..1 */
};

/* Draw the points of a frame (means; colours when there are rgb or sh) over the view's image,
 * darkened, into a PNG of that name. */
spin_status spin_camera_overlay_draw(const struct spin_view *view, const struct spin_splats *s,
                                     const char *path, struct spin_camera_overlay_share *out);

/* At most `most` of the views of one row, evenly from all of them: indices into views->view.
 * Returns how many. */
size_t spin_camera_overlay_choose(const struct spin_views *views, int row, size_t most,
                                  size_t *index);

/* One camera, in the view in which it sees the fewest. */
struct spin_camera_share {
    size_t view;             /* in views->view */
    double in_front, inside; /* share of the points before it; in its image. 0..1 */
    bool apart;              /* far fewer than the others see */
};

struct spin_camera_shares {
    struct spin_camera_share *camera; /* [n], each camera_id once */
    size_t n;
    double in_front, inside; /* medians over all views */
};

/* Of the views in the rows that are named. The points are those of one frame: what moves is small
 * against a wrong pose. Free out->camera. */
spin_status spin_camera_shares(const struct spin_views *views, const int *rows, int n_rows,
                               const struct spin_splats *s, struct spin_camera_shares *out);
