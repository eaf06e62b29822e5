/* The nodes of a glTF document: where each puts its mesh. A splat stays a splat when it is turned, moved and
 * scaled alike along all axes; other nodes are refused. */
#ifndef SPIN_FORMATS_GLB_NODES_H
#define SPIN_FORMATS_GLB_NODES_H

#include "formats/gaussian.h"
#include "io/json.h"

#define SPIN_GLB_VISIBILITY "KHR_node_visibility"
/* A node whose scale is below shows nothing. */
#define SPIN_GLB_NO_SCALE 1e-6

/* Turns, scales, moves; then its parent does. */
struct spin_glb_node {
    double q[4], scale, shift[3];
    int64_t parent; /* -1: none */
    int64_t key;    /* what switches it on and off, the caller's; -1: nothing */
    bool hidden;    /* by KHR_node_visibility, unless something switches it */
    bool in_scene;  /* as a root */
};

struct spin_glb_nodes {
    struct spin_glb_node *node; /* [n], malloc'ed, also after a failure */
    size_t n;
};

/* All nodes of a document. Errors name the node. */
spin_status spin_glb_nodes_read(const spin_json *json, struct spin_glb_nodes *out);
/* What three scales have in common. SPIN_E_UNSUPPORTED when they differ, are negative or no numbers. */
spin_status spin_glb_one_scale(const double scale[3], double *out);
/* After what `inout` does, what node i and its parents do. *shown: it is in the scene, and not hidden other
 * than by a switch. */
spin_status spin_glb_nodes_place(const struct spin_glb_nodes *nodes, size_t i,
                                 struct spin_placement *inout, bool *shown);

#endif
