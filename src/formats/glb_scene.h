/* Reads the visible splats of a GLB's scene, transformed by its nodes. A file can contain a clip:
 * an animation shows one node after the other, by STEP key frames that change the scale of the
 * nodes or their KHR_node_visibility. */
#pragma once

#include "formats/glb.h"

/* A mesh primitive with splats, and the placement of its node in the scene. */
struct spin_gs_glb_piece {
    struct spin_gs_glb_points points;
    struct spin_placement placement;
    size_t node;
};

struct spin_gs_glb_frame {
    size_t n;              /* number of splats in the frame */
    size_t first, n_shown; /* range in scene->shown: the pieces that are visible in this frame */
    int number;            /* frame number in the extras of the frame's node; -1: there is none */
    double time;           /* start of the frame in seconds: the time in the extras if all frames
                              have one, otherwise the time of the animation */
    double extras_time;    /* private: time in the extras; NaN: there is none */
};

struct spin_gs_glb_scene {
    struct spin_glb_file file;
    /* [n_pieces] mesh primitives that are not permanently hidden. */
    struct spin_gs_glb_piece *piece;
    struct spin_gs_glb_frame *frame; /* [n_frames] all frames, at least one */
    size_t *shown; /* indices of the visible pieces of frame 0, then of frame 1, and so on */
    size_t n_pieces, n_frames;
    int sh_degree;  /* maximum of the SH degrees of all pieces */
    bool linear;    /* some pieces have linear colours instead of sRGB */
    bool antialias; /* splats must be drawn antialiased, according to the extras or the SPZ data */
    double fps;     /* frames per second, from the extras; 0: unknown */
    /* The file also contains animations, or channels of the first animation, that do not show and
     * hide nodes; these are ignored. */
    bool moves;
    bool others;            /* the scene has meshes that are not splats; they are skipped */
    struct spin_splats raw; /* private: splats of one piece before their transform */
};

/* Opens a file that is in memory, which must stay valid until spin_gs_glb_scene_close(). Zero *out
 * before the call, and close it even after a failure. Error messages do not contain the path. */
spin_status spin_gs_glb_scene_open(const unsigned char *file, size_t size,
                                   struct spin_gs_glb_scene *out);
void spin_gs_glb_scene_close(struct spin_gs_glb_scene *scene);
/* Reads the splats of frame 0..n_frames - 1, in the axes of glTF and with the SH degree of the
 * scene. Values that are not finite are an error. Rotations are normalised. */
spin_status spin_gs_glb_scene_read(struct spin_gs_glb_scene *scene, size_t frame, unsigned columns,
                                   struct spin_splats *out);
