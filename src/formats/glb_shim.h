/* A clip as glb_write.c hands it to the shared object that holds tinygltf (glb_tiny.cpp), in plain
 * C, and one function found by name. Nothing thrown on the far side crosses over. */
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

/* Rows of an attribute in the binary chunk. */
struct spin_glb_column {
    int attribute;
    uint64_t n, offset;
    uint64_t hash[2];      /* of what it holds */
    float low[3], high[3]; /* of POSITION */
};

/* A node with a mesh of points, or without one when n is 0. */
struct spin_glb_frame {
    size_t n;
    int number;  /* the source's */
    double time; /* in the source's unit */
    size_t
        column[SPIN_GLB_MAX_ATTRIBUTES]; /* which one each attribute has; frames may share them */
};

struct spin_glb_clip {
    /* Set before spin_glb_begin(). */
    struct spin_out *out; /* the caller opens and commits it */
    int sh_degree;
    const char *axes, *source; /* for extras; source NULL: unknown */
    double fps;                /* 0: unknown */
    bool antialias;            /* for extras: the splats are meant to be drawn antialiased */
    int n_frames;
    bool animated; /* frames take turns, by STEP keys on the scale of their nodes */

    /* The attributes in the order of the file: what they are called, numbers and bytes of a row,
     * and the bytes of all. The last is the colour, of 16 bits a number; the others are floats. */
    int n_attributes;
    char name[SPIN_GLB_MAX_ATTRIBUTES][SPIN_GLB_NAME];
    int components[SPIN_GLB_MAX_ATTRIBUTES];
    size_t width[SPIN_GLB_MAX_ATTRIBUTES], row;
    size_t room; /* bytes kept for the JSON */

    /* Set before spin_glb_end(). */
    const struct spin_glb_frame *frame; /* [n_frames] */
    /* Points of all frames, in a node of their own: the last of the list and the first of the
     * scene, as some viewers draw mesh after mesh. Its number and time say nothing. NULL, or n 0:
     * none. */
    const struct spin_glb_frame *still;
    const struct spin_glb_column *column; /* [n_columns] */
    size_t n_columns;
    uint64_t n_bytes; /* of the binary chunk so far; becomes those of all of it */
};

struct spin_glb_shim {
    int abi;
    /* The JSON text, malloc'ed; NULL and a reason in why when it cannot be had; none for a lack of
     * memory. keys: where those of the animation begin: n_frames + 1 times, then for each frame as
     * many scales. */
    char *(*text)(const struct spin_glb_clip *clip, const char *generator, uint64_t keys, char *why,
                  size_t n_why);
};

extern const struct spin_glb_shim spin_glb_shim_table;

#ifdef __cplusplus
}
#endif
