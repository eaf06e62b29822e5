/* The splats of one frame of a .glb of ours, for --check. */
#ifndef SPIN_EXPORTERS_LIB_GLTF_READ_H
#define SPIN_EXPORTERS_LIB_GLTF_READ_H

#include "io/file.h"

/* Frame: the number of its node. Errors do not name the file. */
spin_status spin_gltf_read(const struct spin_map *map, int frame, struct spin_splats *out);

#endif
