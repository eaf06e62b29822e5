/* Cameras and panels for the exporters that render. The camera is one of the data set's, or moves
 * along a path. Panels are versions of the same image, side by side. */
#pragma once

#include <string.h>

#include "exporters/lib/initial_view.h"
#include "exporters/lib/path_file.h"
#include "exporters/lib/splat_rows.h"

#define SPIN_DRAWING_OPTION_PATH                                                                   \
    {                                                                                              \
        "path", "camera|orbit|spiral|train|FILE",                                                  \
            "the cameras of the data set, or a moving one; FILE: a camera path of nerfstudio, or " \
            "matrices",                                                                            \
            "camera"                                                                               \
    }

/* Options of the view, of the moving camera and of panels. */
#define SPIN_DRAWING_OPTIONS                                                                       \
    {"camera", "N|FILE",                                                                           \
     "camera N of the data set, or the first camera in a file; a moving camera starts there",      \
     NULL},                                                                                        \
        {"up", "AXIS", "axis of the source that points up: x, y, z, -x, -y or -z", NULL},          \
        {"rotate", "X,Y,Z", "show the scene rotated about x, then y, then z, in degrees", NULL},   \
        {"panels", "LIST", "images side by side: truth (the data set's image), before, after",     \
         "after"},                                                                                 \
        {"repeat", "N", "draw each frame N times while the camera moves on", "1"},                 \
        {"no-labels", NULL, "do not label the panels", NULL},                                      \
        {"size", "WxH",                                                                            \
         "size in pixels, with the camera's vertical field of view; default: the camera's", NULL}, \
    {                                                                                              \
        "duration", "S",                                                                           \
            "duration of the clip in seconds, instead of --repeat: frames are repeated or "        \
            "skipped to fit; default for a moving camera: that of the clip, but at least 8",       \
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

/* A stop of a path: a training camera. */
struct spin_rig_stop {
    double eye[3]; /* position in the world */
    /* The rotation from the world to the camera, as a quaternion w x y z. The sign is chosen such
     * that the dot product with the quaternion of the previous stop is not negative. */
    double turn[4];
    double at; /* length of the path from the first stop to this one */
};

/* A path through the training cameras of a rig. */
struct spin_rig_path {
    struct spin_rig_stop *stop; /* [n] */
    int n;
};

/* Computes a path that visits every training camera of data-set frame `row` once: it starts at the
 * first camera, continues to the nearest remaining camera each time, and is then shortened by
 * 2-opt. Fails with SPIN_E_NOT_FOUND if the cameras have fewer than two distinct positions. */
spin_status spin_rig_path_open(const struct spin_views *views, int row, struct spin_rig_path *path);
/* Sets w2c to the pose of the moving camera at the fraction `share`, 0..1, of the path. The path is
 * smooth, and the speed of the camera is nearly constant. */
void spin_rig_path_camera(const struct spin_rig_path *path, double share, double w2c[12]);
void spin_rig_path_free(struct spin_rig_path *path);

struct spin_camera_path {
    const struct spin_export_job *job;
    enum spin_camera_path_path path;
    enum spin_camera_path_panel panel[3];
    int n_panels;
    bool labels;
    int64_t n_pictures;         /* number of images to render, over all frames */
    double fps;                 /* images per second */
    int size[2];                /* width, height of a panel in pixels; 0: those of the camera */
    int row;                    /* data-set frame of the first exported frame */
    struct spin_rig_path rig;   /* for SPIN_PATH_TRAIN */
    struct spin_path_file file; /* for SPIN_PATH_FILE: one camera per image */
    bool fixed;                 /* true: the first camera of `file` is used for all images */
    int camera_id;              /* --camera, for SPIN_PATH_CAMERA; -1: not given */
    struct spin_camera lens;    /* intrinsics and near plane of a moving camera */
    double middle[3], reach;    /* centre and half extent of the scene; reach 0: not yet known */
    bool has_initial;           /* true: `initial` is set */
    struct spin_initial_view initial; /* the view from which a moving camera starts */
    float *image;                     /* [3][h][w] the panel that was rendered last */
    float *wide;                      /* [3][h][n_panels w] all panels side by side */
    int n_drawn, n_blank; /* numbers of renders, and of renders that show only the background */
    struct spin_splats source; /* imported splats of a frame, for the panel "before" */
    int source_frame;          /* index of the frame in `source`; -1: none */
};

/* Set *d to zero before the call, and free it even if the call fails. */
spin_status spin_camera_path_begin(struct spin_camera_path *d, const struct spin_export_job *job);

void spin_camera_path_free(struct spin_camera_path *d);

/* Warns if some renders showed only the background. */
void spin_camera_path_warn_blank(const struct spin_camera_path *d);

/* Returns the index of the first image that shows frame f. The last image of frame f precedes the
 * first image of frame f + 1. A frame may have no image. */
int64_t spin_camera_path_first(const struct spin_camera_path *d, int frame);

/* Resizes a camera to d->size, unless d->size is 0. The vertical field of view and the aspect ratio
 * of pixels stay the same; the image is extended or cropped at the left and the right. */
void spin_camera_path_resize(const struct spin_camera_path *d, struct spin_camera *camera);

/* Returns whether the camera moves along a path. */
static inline bool spin_camera_path_moves(const struct spin_camera_path *d)
{
    return d->path != SPIN_PATH_CAMERA && !d->fixed;
}
/* Returns whether images are rendered from a camera that is not in the data set. */
static inline bool spin_camera_path_is_own(const struct spin_camera_path *d)
{
    return d->path != SPIN_PATH_CAMERA || !d->job->views || d->job->views->n == 0;
}
/* Returns the name of the camera in file names, such as "orbit". Only for cameras that are not in
 * the data set. */
const char *spin_camera_path_name(const struct spin_camera_path *d);

/* Sets *out to the moving camera of image `picture`. On an orbit or a spiral, the camera faces the
 * point nearest to the optical axes of the data set's cameras, and is not farther from this point
 * than the median distance of these cameras; if the axes are parallel, it faces the target of the
 * first view. Without a data set, the camera starts in front of the scene, as in the web page. */
spin_status spin_camera_path_camera(struct spin_camera_path *d, int64_t picture,
                                    const struct spin_splats *splats, struct spin_camera *out);

/* Renders the panels into d->wide. truth: path of the data set's image, for the panel "truth"; or
 * NULL. */
spin_status spin_camera_path_draw(struct spin_camera_path *d, int frame,
                                  const struct spin_splats *splats,
                                  const struct spin_camera *camera, const char *truth);
