/* Checks that cameras match the points of a clip: draws the points over the images of the data set,
 * which reveals wrong axes or pairing, and finds cameras that see a far smaller share of the points
 * than the others, whose pose or image size is probably wrong. */
#pragma once

#include "scene/dataset.h"

struct spin_camera_overlay_share {
    double in_front,
        inside; /* shares of the points, 0..1: in front of the camera; inside its image */
};

/* Draws the points of a frame (means, and colours if it has rgb or sh) over the darkened image of
 * the view and writes a PNG to path. */
spin_status spin_camera_overlay_draw(const struct spin_view *view, const struct spin_splats *s,
                                     const char *path, struct spin_camera_overlay_share *out);

/* Chooses up to `most` views of one data set frame, evenly spaced: indices into views->view.
 * Returns their number. */
size_t spin_camera_overlay_choose(const struct spin_views *views, int row, size_t most,
                                  size_t *index);

/* One camera, in its view with the smallest share of points. */
struct spin_camera_share {
    size_t view;             /* index into views->view */
    double in_front, inside; /* shares of the points in front of it and inside its image, 0..1 */
    bool apart;              /* outlier: far fewer points than in other views */
};

struct spin_camera_shares {
    struct spin_camera_share *camera; /* [n], each camera_id once */
    size_t n;
    double in_front, inside; /* medians over all views */
};

/* Measures the views of the given data set frames with the points of a single frame: motion is
 * small compared to the error of a wrong pose. Free out->camera. */
spin_status spin_camera_shares(const struct spin_views *views, const int *rows, int n_rows,
                               const struct spin_splats *s, struct spin_camera_shares *out);
