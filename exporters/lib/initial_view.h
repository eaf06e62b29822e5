/* The view that a viewer shows first. It is derived from the centre and the extent of the splats
 * and, if there is a data set, from its first view. */
#pragma once

#include <math.h>
#include <stdlib.h>

#include "base/mem.h"

struct spin_initial_view {
    double eye[3], target[3], up[3]; /* camera, point it faces, up vector; world */
    double fovy_deg, aspect;
    /* Range of distances from the target that a viewer should allow, so that the camera does not
     * enter the subject or walls. */
    double reach[2];
    double z_near; /* near plane, as in struct spin_camera, but never 0 */
    /* Tangent of the angle between the optical axis and the edge of the subject. Narrow windows
     * must show at least this angle. 0: the subject is not known. */
    double keep;
};

/* Sets `middle` to the median of each coordinate of the splats' means, and *size to half the range
 * from the 5th to the 95th percentile of the coordinate with the largest such range. */
spin_status spin_initial_view_middle(const struct spin_splats *s, double middle[3], double *size);

/* If the clip begins with empty frames, calls spin_initial_view_middle() for the first frame that
 * has splats. In all other clips, sets *size to 0. Must be called before the first frame is
 * exported. */
spin_status spin_initial_view_middle_after_empty(const struct spin_export_job *job,
                                                 double middle[3], double *size);

/* Returns the first test view or, if `test` is false, the first training view of data-set frame
 * `row` (-1: of all frames). If there is none, returns the first view of the frame. NULL: the frame
 * has no views. */
const struct spin_view *spin_initial_view_view(const struct spin_views *views, int row, bool test);

/* Returns the view's focal length in pixels for images of this height. */
double spin_initial_view_focal(const struct spin_initial_view *view, int height);

/* Returns whether an image [3][n] shows only the background (NULL: black). */
bool spin_initial_view_is_blank(const float *image, size_t n, const float background[3]);

/* Sets the view to that of the camera of spin_initial_view_view(). The target is the point on the
 * optical axis that is nearest to `middle`. Without a data set, the camera is in front of the
 * scene, and `up` (NULL: -y) points up. middle, size: from spin_initial_view_middle(). */
void spin_initial_view_first(const struct spin_views *views, const double *up, int row, bool test,
                             const double middle[3], double size, struct spin_initial_view *out);

/* Makes the view show the subject (geometry/viewpoints.h), and applies --up and --rotate. If there
 * is a data set, the view is that of the camera whose image shows the subject best. Otherwise, the
 * view faces the subject from a position where no wall blocks the view; the field of view, unless
 * the subject is too high for it, and, without --up, the up vector are those of *out. width,
 * height: size of the image in pixels. If there is no such view, sets *found to false. Must be
 * called before the first frame is exported. */
spin_status spin_initial_view_subject(const struct spin_export_job *job, int width, int height,
                                      struct spin_initial_view *out, bool *found);

/* These functions set axis[0..2] to the axes right, down, forward of a camera at `eye` that faces
 * `target`, and w2c to the pose of this camera, as in struct spin_camera. */
void spin_initial_view_axes(const double eye[3], const double target[3], const double up[3],
                            double axis[3][3]);
void spin_initial_view_pose(const double eye[3], const double target[3], const double up[3],
                            double w2c[12]);

/* Sets `out` to v, rotated about a unit axis by an angle in radians. */
void spin_initial_view_turn(const double v[3], const double axis[3], double angle, double out[3]);

/* Applies the options of the view to *out: --camera, the number of a camera of the data set or a
 * file with a camera path; --up, the axis of the world that points up; --rotate, a rotation of the
 * scene about the target, for which the view is rotated by the inverse. */
spin_status spin_initial_view_chosen(const struct spin_export_job *job, int row,
                                     const double middle[3], double size,
                                     struct spin_initial_view *out);

/* ---- The poster of a page -------------------------------------------------------------------- */

/* The poster is a PNG file with the first view of the clip. */

/* The size in pixels that previews of links expect. */
enum { SPIN_POSTER_WIDTH = 1200, SPIN_POSTER_HEIGHT = 630 };

/* Renders the splats from `view` and writes the image to `out`, which must be open. Like the page,
 * the image shows at least the field of view of `view`, both horizontally and vertically. */
spin_status spin_poster_write(const struct spin_export_job *job,
                              const struct spin_initial_view *view,
                              const struct spin_splats *splats, struct spin_out *out);
