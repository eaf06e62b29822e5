/* Reads the visible splats of the scene of a GLB file, transformed by its nodes. A file can contain
 * a clip: an animation shows the frames, which are nodes, in turn. To do so, STEP key frames change
 * the scale of the nodes or their KHR_node_visibility. */
#pragma once

#include "formats/glb.h"

/* A mesh primitive with splats, and the transform from its node to the scene. */
struct spin_gs_glb_piece {
    struct spin_gs_glb_points points;
    struct spin_placement placement;
    size_t node;
};

struct spin_gs_glb_frame {
    size_t n; /* number of splats in the frame */
    /* The mesh primitives that are visible in this frame: scene->shown[first] to
     * scene->shown[first + n_shown - 1]. */
    size_t first, n_shown;
    int number; /* frame number in the extras of the frame's node; -1: none */
    /* Start of the frame in seconds: the time in the extras if all frames have one, otherwise the
     * time of the animation. */
    double time;
    double extras_time; /* private: time in the extras; NaN: none */
};

struct spin_gs_glb_scene {
    struct spin_glb_file file;
    /* [n_pieces] mesh primitives that are not permanently hidden. */
    struct spin_gs_glb_piece *piece;
    struct spin_gs_glb_frame *frame; /* [n_frames], at least one */
    /* Indices in piece[] of the primitives that frame 0 shows, then of those of frame 1, and so on.
     */
    size_t *shown;
    size_t n_pieces, n_frames;
    int sh_degree;  /* largest SH degree of all mesh primitives */
    bool linear;    /* true: a mesh primitive has linear colours instead of sRGB */
    bool antialias; /* true: the extras or SPZ data require antialiasing */
    double fps;     /* frames per second, from the extras; 0: unknown */
    /* True: the file contains animations that are ignored: further animations after the first, or
     * channels of the first animation that do more than show and hide nodes. */
    bool moves;
    bool others;            /* true: meshes without splats were skipped */
    struct spin_splats raw; /* private: splats of a mesh primitive before the transform */
};

/* Opens a file in memory. The memory must stay valid until spin_gs_glb_scene_close(). Set *out to
 * zero before the call, and close it even after a failure. Error messages do not contain the path.
 */
spin_status spin_gs_glb_scene_open(const unsigned char *file, size_t size,
                                   struct spin_gs_glb_scene *out);
void spin_gs_glb_scene_close(struct spin_gs_glb_scene *scene);
/* Reads the splats of a frame, 0..n_frames - 1, in the axes of glTF and with the SH degree of the
 * scene. Values that are not finite are an error. Rotations are normalised. */
spin_status spin_gs_glb_scene_read(struct spin_gs_glb_scene *scene, size_t frame, unsigned columns,
                                   struct spin_splats *out);
