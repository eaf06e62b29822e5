/* A .glb of frames of points, written in any order with the bytes streamed to their places; tinygltf
 * makes the JSON. Knows glTF, nothing of what the points are. */
#ifndef SPIN_IO_GLTF_H
#define SPIN_IO_GLTF_H

#include "io/file.h"
#include "io/gltf_shim.h"

/* The JSON comes first in the file but is known last: room is left for the longest it can become. */
struct spin_glb {
    struct spin_out *out; /* the caller's */
    size_t room;          /* bytes kept for the JSON */
};

/* Into a file that the caller has opened and commits. `worst` describes the clip with as many frames
 * and attributes as will come; its counts, offsets, ranges and times are not looked at. */
spin_status spin_glb_begin(struct spin_out *out, const struct spin_gltf_clip *worst,
                           struct spin_glb *glb);
/* At a place in the binary chunk. SPIN_E_UNSUPPORTED beyond the 4 GiB that the format can count. */
spin_status spin_glb_write(struct spin_glb *glb, uint64_t at, const void *data, size_t bytes);
/* The same by any thread, without the trail: 0, or an error for spin_glb_failed(). */
int spin_glb_put(struct spin_glb *glb, uint64_t at, const void *data, size_t bytes);
spin_status spin_glb_failed(const struct spin_glb *glb, int error);
/* Everything in [0, clip->n_bytes) has been written. */
spin_status spin_glb_end(struct spin_glb *glb, const struct spin_gltf_clip *clip);

#endif
