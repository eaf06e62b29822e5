/* Where a checkpoint of Realtime-4DGS has its tensors: a tuple in the method's own, dicts in forks. */
#ifndef SPIN_IMPORTERS_LIB_REALTIME4DGS_PARTS_H
#define SPIN_IMPORTERS_LIB_REALTIME4DGS_PARTS_H

#include "io/pickle.h"

/* NULL: not there. */
struct realtime4dgs_parts {
    const char *who; /* stands before their names in messages; NULL: nothing */
    const struct spin_value *active, *xyz, *dc, *rest, *scaling, *rotation, *opacity;
    const struct spin_value *t, *scaling_t, *rotation_r, *rot_4d, *env_map, *active_t, *optimizer;
    bool swapped;     /* SH are [N][3][K] */
    bool masked;      /* a fork's mask follows */
    bool moving;      /* gaussian_dim 4 */
    double iteration; /* -1: not told */
};

/* *p is zero before. Other methods' checkpoints are refused, with their name where it shows. */
spin_status spin_realtime4dgs_parts(const struct spin_value *root, struct realtime4dgs_parts *p);
/* Once OMG4's networks exist they draw, and SH and opacities in its checkpoints are leftovers. */
bool spin_realtime4dgs_is_stale(const struct realtime4dgs_parts *p);

/* For forks that save more: the items of a 4-D model's tuple, from the 1st to the 19th. */
void spin_realtime4dgs_items(const struct spin_value *model, struct realtime4dgs_parts *p);
/* And the dict that training takes as loaded_pth, whose keys begin with `prefix`: features have their last
 * two axes swapped, and there are no degrees. */
void spin_realtime4dgs_loaded(const struct spin_value *dict, const char *prefix,
                              struct realtime4dgs_parts *p);

#endif
