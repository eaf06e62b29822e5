/* The visible splats of a GLB's scene, placed by its nodes. An animation may switch nodes on and
 * off, which stores a clip in one file: by STEP keys on the scale of nodes, or on
 * KHR_node_visibility. */
#pragma once

#include "formats/glb.h"

/* A mesh primitive of the scene. */
struct spin_gs_glb_piece {
    struct spin_gs_glb_points points;
    struct spin_placement placement;
    size_t node;
};

struct spin_gs_glb_frame {
    size_t n;              /* splats */
    size_t first, n_shown; /* range in scene->shown */
    int number;            /* from the extras of the frame's node; -1: none */
    double time; /* start of the frame in seconds; from the extras, if all frames have them */
    double extras_time; /* private; NaN: none */
};

struct spin_gs_glb_scene {
    struct spin_glb_file file;
    struct spin_gs_glb_piece *piece; /* [n_pieces] */
    struct spin_gs_glb_frame *frame; /* [n_frames], at least one */
    size_t *shown;                   /* indices of the visible pieces, frame by frame */
    size_t n_pieces, n_frames;
    int sh_degree;          /* the largest of the pieces */
    bool linear;            /* some colours are linear */
    bool antialias;         /* to be drawn antialiased, by the extras of our exporter or an SPZ */
    bool moves;             /* an animation does more than switch nodes; that is ignored */
    bool others;            /* there are meshes other than splats; they are skipped */
    struct spin_splats raw; /* private */
};

/* Opens a file in memory, which must stay valid until the close. Zero *out before the call, and
 * close it even after a failure. Errors do not name the file. */
spin_status spin_gs_glb_scene_open(const unsigned char *file, size_t size,
                                   struct spin_gs_glb_scene *out);
void spin_gs_glb_scene_close(struct spin_gs_glb_scene *scene);
/* Reads the splats of a frame, in the axes of glTF and with the scene's SH degree. All values are
 * checked to be finite; rotations are normalised. */
spin_status spin_gs_glb_scene_read(struct spin_gs_glb_scene *scene, size_t frame, unsigned columns,
                                   struct spin_splats *out);
