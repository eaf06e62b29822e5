/* The interface between glb_write.c and the shared object that contains tinygltf (glb_tiny.cpp), in
 * plain C: a description of a clip, and one function found by name. No C++ exception crosses this
 * boundary. */
#pragma once

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define SPIN_GLB_SHIM_ABI 6
#define SPIN_GLB_SHIM_SYMBOL "spin_glb_shim_table"

/* POSITION, ROTATION, SCALE, OPACITY, the SH coefficients, COLOR_0. */
enum { SPIN_GLB_MAX_ATTRIBUTES = 21, SPIN_GLB_NAME = 64 };

/* The rows of an attribute in the binary chunk. */
struct spin_glb_column {
    int attribute;
    uint64_t n, offset;
    uint64_t hash[2];      /* of its bytes */
    float low[3], high[3]; /* of POSITION */
};

/* A node with a mesh of points; n 0: without a mesh. */
struct spin_glb_frame {
    size_t n;
    int number;                             /* the source's frame number */
    double time;                            /* in the source's unit */
    size_t column[SPIN_GLB_MAX_ATTRIBUTES]; /* index of each attribute's column; frames may share
                                               columns */
};

struct spin_glb_clip {
    /* Set before spin_glb_begin(). */
    struct spin_out *out; /* opened and committed by the caller */
    int sh_degree;
    const char *axes, *source; /* for the extras; source NULL: unknown */
    double fps;                /* 0: unknown */
    bool antialias;            /* for the extras: to be drawn antialiased */
    int n_frames;
    bool animated; /* frames are shown one after the other, by STEP keys on the scale of their nodes
                    */

    /* The attributes in the order of the file: names, numbers per row, bytes per row, and bytes of
     * a row of all. The last is the colour, as 16-bit numbers; the others are floats. */
    int n_attributes;
    char name[SPIN_GLB_MAX_ATTRIBUTES][SPIN_GLB_NAME];
    int components[SPIN_GLB_MAX_ATTRIBUTES];
    size_t width[SPIN_GLB_MAX_ATTRIBUTES], row;
    size_t room; /* bytes reserved for the JSON */

    /* Set before spin_glb_end(). */
    const struct spin_glb_frame *frame; /* [n_frames] */
    /* Static points of all frames, in their own node: the last in the list of nodes, but the first
     * in the scene, since some viewers draw the meshes in order. Its number and time are not used.
     * NULL, or n 0: none. */
    const struct spin_glb_frame *still;
    const struct spin_glb_column *column; /* [n_columns] */
    size_t n_columns;
    uint64_t n_bytes; /* bytes of the binary chunk so far; finally of all of it */
};

struct spin_glb_shim {
    int abi;
    /* Returns the JSON text, malloc'ed; or NULL with a reason in why, which is empty if memory ran
     * out. keys: offset of the animation's keys: n_frames + 1 times, then for each frame as many
     * scales. */
    char *(*text)(const struct spin_glb_clip *clip, const char *generator, uint64_t keys, char *why,
                  size_t n_why);
};

extern const struct spin_glb_shim spin_glb_shim_table;

#ifdef __cplusplus
}
#endif
