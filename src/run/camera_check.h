/* Checks that cameras match the points of a clip. Points drawn over the images of the data set
 * reveal wrong axes or a wrong pairing. A camera whose images contain far fewer points than the
 * images of other cameras probably has a wrong pose or image size. */
#pragma once

#include "scene/dataset.h"

struct spin_camera_overlay_share {
    /* Shares of the points that are in front of the camera and inside its image, 0..1. */
    double in_front, inside;
};

/* Draws the points of a frame (means, and colours if it has rgb or sh) over the darkened image of
 * the view and writes a PNG to path. */
spin_status spin_camera_overlay_draw(const struct spin_view *view, const struct spin_splats *s,
                                     const char *path, struct spin_camera_overlay_share *out);

/* Chooses up to `most` views of one data set frame, evenly spaced: indices into views->view.
 * Returns their number. */
size_t spin_camera_overlay_choose(const struct spin_views *views, int row, size_t most,
                                  size_t *index);

/* One camera, with the shares of its worst view: of its outliers or, if it has none, of all its
 * views, the one with the fewest points inside its image. */
struct spin_camera_share {
    size_t view;             /* index into views->view */
    double in_front, inside; /* see struct spin_camera_overlay_share */
    /* True if this view is an outlier: far fewer points are in front of the camera or inside its
     * image than in the median over all views. */
    bool apart;
};

struct spin_camera_shares {
    struct spin_camera_share *camera; /* [n], one entry for each camera_id */
    size_t n;
    double in_front, inside; /* medians over all views */
    /* share of the points that are inside at least one image of the last of the frames */
    double seen;
};

/* Measures the views of the given data set frames, all with the points of a single frame, since
 * motion is small compared to the error of a wrong pose. The caller frees out->camera. */
spin_status spin_camera_shares(const struct spin_views *views, const int *rows, int n_rows,
                               const struct spin_splats *s, struct spin_camera_shares *out);
