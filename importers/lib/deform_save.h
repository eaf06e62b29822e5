/* Saves of Deformable 3D Gaussians and its descendants: point_cloud/iteration_<N>/point_cloud.ply and
 * deform/iteration_<N>/deform.pth of one model. */
#ifndef SPIN_IMPORTERS_LIB_DEFORM_SAVE_H
#define SPIN_IMPORTERS_LIB_DEFORM_SAVE_H

#include "spin.h"

struct deform_save {
    char *model, *name;    /* the model's folder, iteration_<N> */
    char *cloud, *network; /* the two files */
};

/* `path` is the model's folder, or MODEL/deform/iteration_<N>/deform.pth, which says the save. wanted: N or
 * "best"; NULL: the last of which both halves are there; together: the last of either must be it. To be freed,
 * also after a failure. */
spin_status spin_deform_save_find(const char *path, const char *wanted, bool together,
                                  struct deform_save *out);
void spin_deform_save_free(struct deform_save *save);

#endif
