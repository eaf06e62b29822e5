/* What the scene of a GLB shows: splats of its meshes where its nodes put them; and at different
 * times, when an animation switches nodes on and off, which is how a clip lies in one file: by STEP
 * keys on the scale of nodes, or on KHR_node_visibility. */
#pragma once

#include "formats/glb.h"

/* A mesh primitive in the scene. */
struct spin_gs_glb_piece {
    struct spin_gs_glb_points points;
    struct spin_placement placement;
    size_t node;
};

struct spin_gs_glb_frame {
    size_t n;              /* splats */
    size_t first, n_shown; /* in shown */
    int number;            /* what extras of the frame's node say, else -1 */
    double time; /* when it begins, in seconds; what extras say where those of all frames do */
    double extras_time; /* private: NaN: none */
};

struct spin_gs_glb_scene {
    struct spin_glb_file file;
    struct spin_gs_glb_piece *piece; /* [n_pieces] */
    struct spin_gs_glb_frame *frame; /* [n_frames] at least one */
    size_t *shown;                   /* the pieces that frames show, one frame after the other */
    size_t n_pieces, n_frames;
    int sh_degree;  /* the largest */
    bool linear;    /* colours of some are of linear light */
    bool antialias; /* meant to be drawn antialiased, as extras of our exporter or an SPZ say */
    bool moves;     /* there is an animation that is more than a switch: it is not followed */
    bool others;    /* meshes that are no splats, which are left out */
    struct spin_splats raw; /* private */
};

/* A file in memory, which is borrowed until the end. Errors do not name it. Free also after a
 * failure. Zero it before. */
spin_status spin_gs_glb_scene_open(const unsigned char *file, size_t size,
                                   struct spin_gs_glb_scene *out);
void spin_gs_glb_scene_close(struct spin_gs_glb_scene *scene);
/* The splats of a frame, in glTF's axes and the scene's SH degree. All that comes out is finite,
 * rotations are of unit length. */
spin_status spin_gs_glb_scene_read(struct spin_gs_glb_scene *scene, size_t frame, unsigned columns,
                                   struct spin_splats *out);
