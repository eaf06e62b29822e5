/* The C interface between glb_write.c and the shared object that contains tinygltf (glb_tiny.cpp):
 * a struct that describes a clip, and a table with one function, which glb_write.c finds by the
 * table's symbol. No C++ exception crosses this boundary. */
#pragma once

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define SPIN_GLB_SHIM_ABI 6
#define SPIN_GLB_SHIM_SYMBOL "spin_glb_shim_table"

/* The 21 attributes are POSITION, ROTATION, SCALE, OPACITY, 16 SH coefficients and COLOR_0. */
enum { SPIN_GLB_MAX_ATTRIBUTES = 21, SPIN_GLB_NAME = 64 };

/* The data of one attribute in the binary chunk. */
struct spin_glb_column {
    int attribute;
    uint64_t n, offset;    /* number of rows; position in the binary chunk, in bytes */
    uint64_t hash[2];      /* hash of the data, to find equal columns */
    float low[3], high[3]; /* bounding box, for POSITION only */
};

/* A node with a mesh of n points. If n is 0, the node has no mesh. */
struct spin_glb_frame {
    size_t n;
    int number;                             /* number of the frame in the source */
    double time;                            /* time of the frame, in the source's unit */
    size_t column[SPIN_GLB_MAX_ATTRIBUTES]; /* index of each attribute's column */
};

struct spin_glb_clip {
    /* The caller sets these before spin_glb_begin(). */
    struct spin_out *out; /* the output file, which the caller opens and commits */
    int sh_degree;
    /* Texts that are written to the object "extras" of the file. source: name of the method that
     * the clip was imported from; NULL: unknown. */
    const char *axes, *source;
    double fps;     /* frames per second; 0: unknown */
    bool antialias; /* true: write to the extras that splats must be drawn antialiased */
    int n_frames;
    bool animated; /* true: an animation shows the frames in turn, by scaling nodes to 0 or 1 */

    /* spin_glb_begin() sets these. The attributes are in the order of the file. The last attribute
     * is COLOR_0, with 16-bit integers; all others are floats. */
    int n_attributes;
    char name[SPIN_GLB_MAX_ATTRIBUTES][SPIN_GLB_NAME];
    int components[SPIN_GLB_MAX_ATTRIBUTES]; /* numbers per row of each attribute */
    /* width: bytes per row of each attribute; row: their sum, the bytes of a splat. */
    size_t width[SPIN_GLB_MAX_ATTRIBUTES], row;
    size_t room; /* number of bytes reserved for the JSON */

    /* The caller sets these before spin_glb_end(). */
    const struct spin_glb_frame *frame; /* [n_frames] the nodes of all frames */
    /* The splats that are the same in all frames, in a separate node. This node is the last in the
     * list of nodes, but the first in the scene, since some viewers draw meshes in the order of the
     * scene. Members `number` and `time` are ignored. If there are no such splats, `still` is NULL
     * or still->n is 0. */
    const struct spin_glb_frame *still;
    const struct spin_glb_column *column; /* [n_columns] the data of all attributes */
    size_t n_columns;
    uint64_t n_bytes; /* number of bytes in the binary chunk so far */
};

struct spin_glb_shim {
    int abi;
    /* Returns the JSON text, which the caller frees. On failure, returns NULL and writes the reason
     * to why[n_why], or an empty string if memory ran out. keys: offset of the animation's data in
     * the binary chunk: n_frames + 1 times, followed by n_frames + 1 scales for each frame. */
    char *(*text)(const struct spin_glb_clip *clip, const char *generator, uint64_t keys, char *why,
                  size_t n_why);
};

extern const struct spin_glb_shim spin_glb_shim_table;

#ifdef __cplusplus
}
#endif
