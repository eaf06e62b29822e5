/* .sogst of Solipsist Studios, container version 1 (revision 14): a zip of stored members, a
 * meta.json and the pictures of SOG with those of time (sog_4d.h), of the whole clip or of each
 * segment.
 *
 * Bells at times in seconds, on paths of degree 1 or 2. Times and sigmas are places in two books of
 * 256; velocities and accelerations (what d^2 is multiplied with) have logarithms as places do.
 * Splats are those that last, then one segment after the other; where `streams` stands, each has
 * pictures in a folder of its own, and the palette is at the root.
 *
 * The same as a PLY, for exchange: a cloud of 3DGS with vx vy vz t_center t_sigma, and ax ay az
 * with degree 2. Comments sogst.time_min, .time_max and .fps must be there, or a file
 * NAME.sogst.json that says the same and wins.
 *
 * Facts from the format's specification, docs/sogst-format.md of solipsist-studios/cumuli
 * (CC-BY-4.0). */
#pragma once

#include "formats/sog_4d.h"

struct spin_sogst {
    double first, last, fps; /* seconds; frames a second */
    size_t n_segments;
};

/* Also fills *splats, which is zero and to be freed also after a failure, not settled. Errors do
 * not name the file. */
spin_status spin_sogst_read(const void *file, size_t size, struct spin_sogst *out,
                            struct spin_splats_4d *splats);
/* The same of the PLY for exchange; its errors do. */
spin_status spin_sogst_read_ply(const char *path, struct spin_sogst *out,
                                struct spin_splats_4d *splats);
