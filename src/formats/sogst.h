/* .sogst of Solipsist Studios, container version 1 (revision 14): a zip of stored members with a
 * meta.json and the images of SOG with those of time (sog_4d.h), for the whole clip or for each
 * segment.
 *
 * Splats have Gaussian windows with times in seconds, and paths of degree 1 or 2. Times and sigmas
 * are indices in two codebooks of 256; velocities and accelerations (the coefficient of d^2) are
 * stored as logarithms, like positions. Persistent splats come first, then the splats of each
 * segment in order. With `streams`, each of these groups has its own folder of images, and the
 * palette is at the root.
 *
 * The same data as a PLY, for exchange: a 3DGS point cloud with vx vy vz t_center t_sigma, and ax
 * ay az for degree 2. The comments sogst.time_min, .time_max and .fps are required, or a file
 * NAME.sogst.json with the same values, which takes precedence.
 *
 * The description is based on the format's specification, docs/sogst-format.md of
 * solipsist-studios/cumuli (CC-BY-4.0). */
#pragma once

#include "formats/sog_4d.h"

struct spin_sogst {
    double first, last, fps; /* seconds; frames per second */
    size_t n_segments;
};

/* Reads a file into *out and *splats, which must be zero before, and be freed even after a failure;
 * the splats are not settled. Errors do not name the file. */
spin_status spin_sogst_read(const void *file, size_t size, struct spin_sogst *out,
                            struct spin_splats_4d *splats);
/* The same for the exchange PLY; here, errors of the PLY itself name the file. */
spin_status spin_sogst_read_ply(const char *path, struct spin_sogst *out,
                                struct spin_splats_4d *splats);
