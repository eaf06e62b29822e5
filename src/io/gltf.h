/* A .glb of frames of points, written in any order with the bytes streamed to their places; tinygltf
 * makes the JSON. Knows glTF, nothing of what the points are. */
#ifndef SPIN_IO_GLTF_H
#define SPIN_IO_GLTF_H

#include "io/file.h"
#include "io/gltf_shim.h"

/* The JSON comes first in the file but is known last: room is left for the longest it can become. */
struct spin_glb {
    struct spin_out out;
    size_t room; /* bytes kept for the JSON */
};

/* `worst` describes the clip with as many frames and attributes as will come; its counts, offsets,
 * ranges and times are not looked at. */
spin_status spin_glb_open(const char *path, bool force, const struct spin_gltf_clip *worst,
                          struct spin_glb *out);
/* At a place in the binary chunk. SPIN_E_UNSUPPORTED beyond the 4 GiB that the format can count. */
spin_status spin_glb_write(struct spin_glb *glb, uint64_t at, const void *data, size_t bytes);
/* Everything in [0, clip->n_bytes) has been written. */
spin_status spin_glb_commit(struct spin_glb *glb, const struct spin_gltf_clip *clip);
void spin_glb_abandon(struct spin_glb *glb);

#endif
