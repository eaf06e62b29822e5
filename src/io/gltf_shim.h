/* What gltf.c and the shared object behind it agree on: a clip described in plain C, and one function
 * found by name. Nothing thrown on the far side crosses over. */
#ifndef SPIN_IO_GLTF_SHIM_H
#define SPIN_IO_GLTF_SHIM_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define SPIN_GLTF_SHIM_ABI 4
#define SPIN_GLTF_SHIM_SYMBOL "spin_gltf_shim_table"

/* Numbers of glTF's own. */
enum spin_gltf_component { SPIN_GLTF_U8 = 5121, SPIN_GLTF_U16 = 5123, SPIN_GLTF_F32 = 5126 };

/* A vertex attribute; all bytes of one lie together, the attributes one after the other. */
struct spin_gltf_attribute {
    const char *name;
    int n_components; /* 1 to 4 */
    enum spin_gltf_component component;
    bool normalised;
};

enum { SPIN_GLTF_MOST_ATTRIBUTES = 24 };

/* A frame: a node with a mesh of points, or without one when n is 0. */
struct spin_gltf_frame {
    uint64_t n;            /* points */
    uint64_t offset;       /* of its first attribute in the binary chunk */
    /* Of each attribute: 0, it lies here, behind those before it that do; else 1 more than where it lies as one of
     * an earlier frame, which is the same. */
    uint64_t elsewhere[SPIN_GLTF_MOST_ATTRIBUTES];
    float low[3], high[3]; /* of the first attribute, which is the place */
    int number;            /* the source's */
    double time;           /* in the source's unit */
};

struct spin_gltf_clip {
    const char *generator;
    const char *const *extras;           /* of the asset: pairs key, value, NULL at the end */
    double fps;                          /* 0: unknown */
    const char *extension;               /* of every mesh primitive */
    const char *const *extension_values; /* pairs, NULL at the end */
    const struct spin_gltf_attribute *attribute;
    int n_attributes;
    const struct spin_gltf_frame *frame;
    int n_frames;
    /* Points of all frames, in a node of their own: the last of the list and the first of the scene, as some
     * viewers draw mesh after mesh. Its number and time say nothing. NULL, or n 0: none. */
    const struct spin_gltf_frame *still;
    /* Frames take turns, by STEP keys on the scale of their nodes. At keys_offset: n_frames + 1 times
     * (floats), then for each frame n_frames + 1 scales (three floats). */
    bool animated;
    /* By KHR_node_visibility instead, through KHR_animation_pointer: for each frame n_frames + 1 bytes,
     * 0 or 1, and as many zeros as fill up the last four. */
    bool visibility;
    uint64_t keys_offset;
    uint64_t n_bytes; /* of the binary chunk */
};

struct spin_gltf_shim {
    int abi;
    /* The JSON text of the document, malloc'ed; 0 and a reason in why when it cannot be had. */
    int (*json)(const struct spin_gltf_clip *clip, char **text, size_t *n, char *why, size_t n_why);
};

extern const struct spin_gltf_shim spin_gltf_shim_table;

#ifdef __cplusplus
}
#endif
#endif
