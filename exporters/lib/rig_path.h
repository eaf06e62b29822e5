/* A camera path through the training cameras of a rig. */
#ifndef SPIN_EXPORTERS_LIB_RIG_PATH_H
#define SPIN_EXPORTERS_LIB_RIG_PATH_H

#include "spin.h"

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

/* Through the training cameras of this row, each once: from the first of them always to a near one, then without
 * crossings. SPIN_E_NOT_FOUND: it has fewer than two places. */
spin_status spin_rig_path_open(const struct spin_views *views, int row, struct spin_rig_path *path);
/* At share 0..1 of the way, at about even speed, without a kink. */
void spin_rig_path_camera(const struct spin_rig_path *path, double share, double w2c[12]);
void spin_rig_path_free(struct spin_rig_path *path);

#endif
