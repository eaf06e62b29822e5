/* Cameras and panels of the exporters that render: a camera of the data set or one that moves along
 * a path, and several versions of an image side by side. */
#pragma once

#include <string.h>

#include "exporters/lib/initial_view.h"
#include "exporters/lib/path_file.h"
#include "exporters/lib/splat_filter.h"

#define SPIN_DRAWING_OPTION_PATH                                                                   \
    {                                                                                              \
        "path", "camera|orbit|spiral|train|FILE",                                                  \
            "the cameras of the data set, or a moving one; FILE: a camera path of nerfstudio, or " \
            "matrices",                                                                            \
            "camera"                                                                               \
    }

/* Options of the moving camera and of panels. */
#define SPIN_DRAWING_OPTIONS                                                                       \
    {"panels", "LIST", "images side by side: truth (the data set's image), before, after",         \
     "after"},                                                                                     \
        {"repeat", "N", "draw each frame N times while the camera moves on", "1"},                 \
        {"no-labels", NULL, "do not label the panels", NULL},                                      \
        {"size", "WxH",                                                                            \
         "size in pixels, with the camera's vertical field of view; default: the camera's", NULL}, \
    {                                                                                              \
        "duration", "S",                                                                           \
            "duration of the clip in seconds, instead of --repeat: frames are repeated or "        \
            "skipped to fit; default for a moving camera: at least 8",                             \
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

/* A training camera that a path goes through. */
struct spin_rig_stop {
    double eye[3]; /* world */
    /* Quaternion w x y z, world to camera; its sign puts it in the same hemisphere as the previous
     * stop's. */
    double turn[4];
    double at; /* length of the path from the first stop to this one */
};

/* A path through the training cameras of a rig. */
struct spin_rig_path {
    struct spin_rig_stop *stop; /* [n] */
    int n;
};

/* Opens a path through the training cameras of this row of the data set, each once: greedily from
 * the first to the nearest next one, then improved until the path does not cross itself.
 * SPIN_E_NOT_FOUND: fewer than two distinct positions. */
spin_status spin_rig_path_open(const struct spin_views *views, int row, struct spin_rig_path *path);
/* The camera at share 0..1 of the path: smooth, at nearly constant speed. */
void spin_rig_path_camera(const struct spin_rig_path *path, double share, double w2c[12]);
void spin_rig_path_free(struct spin_rig_path *path);

struct spin_camera_path {
    const struct spin_export_job *job;
    enum spin_camera_path_path path;
    enum spin_camera_path_panel panel[3];
    int n_panels;
    bool labels;
    int64_t n_pictures;            /* images to render, over all frames */
    double fps;                    /* frames per second */
    int size[2];                   /* width, height of a panel in pixels; 0: the camera's own */
    int row;                       /* of the first frame in the data set */
    struct spin_rig_path rig;      /* of SPIN_PATH_TRAIN */
    struct spin_path_file file;    /* of SPIN_PATH_FILE: one camera per image */
    struct spin_camera lens;       /* of a moving camera: everything but the pose */
    double middle[3], reach;       /* centre and half extent of the scene; reach 0: not yet known */
    bool looked;                   /* look is set */
    struct spin_initial_view look; /* where a moving camera starts */
    float *image;                  /* [3][h][w] of a panel */
    float *wide;                   /* [3][h][n_panels w] */
    int n_drawn, n_blank;          /* renders; those that show only the background */
    struct spin_splats source;     /* frame source_frame as imported, for the panel "before" */
    int source_frame;              /* -1: none */
};

/* Zero *d before; free it also after a failure. */
spin_status spin_camera_path_begin(struct spin_camera_path *d, const struct spin_export_job *job);

void spin_camera_path_free(struct spin_camera_path *d);

/* Warns if some renders showed only the background. */
void spin_camera_path_say_blank(const struct spin_camera_path *d);

/* The first image of frame f; frame f has those up to the first of frame f + 1. */
int64_t spin_camera_path_first(const struct spin_camera_path *d, int frame);

/* Applies --size to a camera, or the size of a moving camera. The vertical field of view and the
 * shape of pixels stay; the image gains or loses at the sides. */
void spin_camera_path_resize(const struct spin_camera_path *d, struct spin_camera *camera);

/* Whether the images come from a camera that is not the data set's: a moving one, or there is no
 * data set. */
static inline bool spin_camera_path_is_own(const struct spin_camera_path *d)
{
    return d->path != SPIN_PATH_CAMERA || !d->job->views || d->job->views->n == 0;
}
/* The name of such a camera in file names. */
const char *spin_camera_path_name(const struct spin_camera_path *d);

/* Such a camera at image number `picture`. It turns about the point nearest to the axes of all
 * cameras, but no farther away than the median of them; if the axes are parallel, about the target
 * of the first view. Without a data set it starts at the front, like the web page. */
spin_status spin_camera_path_camera(struct spin_camera_path *d, int64_t picture,
                                    const struct spin_splats *splats, struct spin_camera *out);

/* Renders the panels into d->wide. truth: path of the data set's image; NULL: no panel shows it. */
spin_status spin_camera_path_draw(struct spin_camera_path *d, int frame,
                                  const struct spin_splats *splats,
                                  const struct spin_camera *camera, const char *truth);
