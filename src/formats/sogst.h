/* The .sogst format of Solipsist Studios, container version 1 (revision 14): a zip with
 * uncompressed members, which are a meta.json, the images of SOG, and the additional images for 4D
 * splats (sog_4d.h). There is one set of images for the whole clip, or one for each segment of the
 * clip.
 *
 * Splats have Gaussian windows with times in seconds, and paths of degree 1 or 2. Centres in time
 * and sigmas are indices in two codebooks of 256 values. Velocities and accelerations (the
 * coefficients of d and d^2) are stored as logarithms, like positions. The first rows are the
 * persistent splats, which are not limited to a segment, followed by the splats of each segment in
 * order. If meta.json contains 'streams', the persistent splats and each segment have their own
 * folder of images, and the palette is at the root.
 *
 * The exchange PLY is another form of the same data: a 3DGS point cloud with the additional
 * properties vx vy vz t_center t_sigma and, for degree 2, ax ay az. The comments sogst.time_min,
 * sogst.time_max and sogst.fps are required, unless a sidecar file NAME.sogst.json contains these
 * values, which override the comments.
 *
 * This description follows the specification of the format, docs/sogst-format.md of
 * solipsist-studios/cumuli (CC-BY-4.0). */
#pragma once

#include "formats/sog_4d_sound.h"

struct spin_sogst {
    double first, last, fps; /* start and end of the clip in seconds; frames per second */
    size_t n_segments;
    struct spin_sog_4d_sound sound; /* only spin4d writes one */
};

/* Reads a file from memory. Set *splats to zero before the call, and free it even after a failure.
 * The caller must call spin_splats_4d_finish() on the splats. Error messages do not contain the
 * path. */
spin_status spin_sogst_read(const void *file, size_t size, struct spin_sogst *out,
                            struct spin_splats_4d *splats);
/* Reads an exchange PLY; otherwise the same as spin_sogst_read(). Error messages about the
 * structure of the PLY contain the path; other messages do not. */
spin_status spin_sogst_read_ply(const char *path, struct spin_sogst *out,
                                struct spin_splats_4d *splats);
