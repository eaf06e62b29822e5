/* What the exporters that draw share: a camera that stands still or moves, and pictures side by
 * side. */
#pragma once

#include <string.h>

#include "exporters/lib/initial_view.h"
#include "exporters/lib/path_file.h"
#include "exporters/lib/splat_filter.h"

#define SPIN_DRAWING_OPTION_PATH                                                                   \
    {                                                                                              \
        "path", "camera|orbit|spiral|train|FILE",                                                  \
            "where to look from: cameras of the data set, or a moving one; FILE: a camera path "   \
            "of "                                                                                  \
            "nerfstudio, or matrices",                                                             \
            "camera"                                                                               \
    }

/* Those of a moving camera and of panels. */
#define SPIN_DRAWING_OPTIONS                                                                       \
    {"panels", "LIST", "side by side: truth (the data set's image), before, after", "after"},      \
        {"repeat", "N", "draw each frame N times while the camera moves on", "1"},                 \
        {"no-labels", NULL, "do not write the name of each of several panels into it", NULL},      \
        {"size", "WxH",                                                                            \
         "pixels of an image; the vertical field of view stays; otherwise the camera's", NULL},    \
    {                                                                                              \
        "duration", "S",                                                                           \
            "seconds that the clip lasts, instead of --repeat: frames are repeated or left out "   \
            "to fit; otherwise 8 for a camera that moves, unless the clip is longer",              \
            NULL                                                                                   \
    }

enum spin_camera_path_path {
    SPIN_PATH_CAMERA,
    SPIN_PATH_ORBIT,
    SPIN_PATH_SPIRAL,
    SPIN_PATH_TRAIN,
    SPIN_PATH_FILE
};

enum spin_camera_path_panel { SPIN_PANEL_TRUTH, SPIN_PANEL_BEFORE, SPIN_PANEL_AFTER };

/* A path through the training cameras of a rig. */

/* A camera that the path goes through. */
struct spin_rig_stop {
    double eye[3];  /* world */
    double turn[4]; /* quaternion w x y z of world to camera, on the same side as the one before */
    double at;      /* way to here, 0 at the first */
};

struct spin_rig_path {
    struct spin_rig_stop *stop; /* [n] */
    int n;
};

/* Through the training cameras of this row, each once: from the first of them always to a near one,
 * then without crossings. SPIN_E_NOT_FOUND: it has fewer than two places. */
spin_status spin_rig_path_open(const struct spin_views *views, int row, struct spin_rig_path *path);
/* At share 0..1 of the way, at about even speed, without a kink. */
void spin_rig_path_camera(const struct spin_rig_path *path, double share, double w2c[12]);
void spin_rig_path_free(struct spin_rig_path *path);

struct spin_camera_path {
    const struct spin_export_job *job;
    enum spin_camera_path_path path;
    enum spin_camera_path_panel panel[3];
    int n_panels;
    bool labels;
    int64_t n_pictures;            /* of all frames */
    double fps;                    /* frames per second */
    int size[2];                   /* of a picture, instead of the cameras'; 0: theirs */
    int row;                       /* the data set's, of the first frame */
    struct spin_rig_path rig;      /* of SPIN_PATH_TRAIN */
    struct spin_path_file file;    /* of SPIN_PATH_FILE: a camera a picture */
    struct spin_camera lens;       /* all but the pose of a camera that is not a view's */
    double middle[3], reach;       /* of the scene; reach 0: not known yet */
    bool looked;                   /* the next is set */
    struct spin_initial_view look; /* such a camera begins here */
    float *image;                  /* [3][h][w] of a panel */
    float *wide;                   /* [3][h][n_panels w] */
    int number;                    /* of the frame at hand, as the source counts */
    int n_drawn, n_blank;          /* renders; those that show nothing but the background */
    struct spin_splat_filter rows; /* which splats can be drawn */
    struct spin_splats fit;        /* room for them, where not all can */
    struct spin_splats source;     /* of source_frame, as imported */
    int source_frame;              /* -1: none */
    struct spin_splats source_fit;
    const struct spin_splats *before; /* those of source that can be drawn */
};

/* Zero d before. */
spin_status spin_camera_path_begin(struct spin_camera_path *d, const struct spin_export_job *job);

void spin_camera_path_free(struct spin_camera_path *d);

/* A warning when a render showed nothing. */
void spin_camera_path_say_blank(const struct spin_camera_path *d);

/* Pictures of frame f are those from this one up to that of frame f + 1. */
int64_t spin_camera_path_first(const struct spin_camera_path *d, int frame);

/* --size, and what a moving camera has without it: the same height of view, square pixels stay
 * square; the sides show more or less. */
void spin_camera_path_resize(const struct spin_camera_path *d, struct spin_camera *camera);

/* Whether the pictures come from another camera than the data set's: it moves, or there are none.
 */
static inline bool spin_camera_path_is_own(const struct spin_camera_path *d)
{
    return d->path != SPIN_PATH_CAMERA || !d->job->views || d->job->views->n == 0;
}
/* What such pictures are called by. */
const char *spin_camera_path_name(const struct spin_camera_path *d);

/* Such a camera at a picture. It turns about the place that is nearest to the axes of all cameras,
 * no farther away than half of them are; where these are parallel, the first view's target. Without
 * a data set it begins at the front, as a page does. */
spin_status spin_camera_path_camera(struct spin_camera_path *d, int64_t picture,
                                    const struct spin_splats *splats, struct spin_camera *out);

/* Begin a frame: *splats become those to draw. */
spin_status spin_camera_path_frame(struct spin_camera_path *d, const struct spin_frame_info *info,
                                   const struct spin_splats **splats);

/* The panels into d->wide. truth: the data set's image, or NULL where no panel shows it. */
spin_status spin_camera_path_draw(struct spin_camera_path *d, int frame,
                                  const struct spin_splats *splats,
                                  const struct spin_camera *camera, const char *truth);
