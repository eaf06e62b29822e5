/* .ksplat, the files of mkkellogg's viewer (GaussianSplats3D), version 0.1. Everything is little
 * endian.
 *
 *     header, 4096 bytes       0 version (0, 1)    4 sections that there is room for    8 sections
 *                              16 splats           20 level, 2 bytes                     36 least and largest SH
 *     a section's, 1024 each   0 splats            4 splats that there is room for       8 splats of a full bucket
 *                              12 buckets          16 width of a bucket, a float         20 bytes of a bucket, 2
 *                              24 steps of half a width     32 full buckets              36 others
 *                              40 SH degree, 2 bytes
 *     a section                splats of the buckets that are not full, their number; centres of buckets, 3 floats;
 *                              rows of splats, bucket after bucket
 *
 * A row has place, scale (not its logarithm), rotation w x y z, colour and opacity as 4 bytes, SH.
 * SH of a degree follow those of the degree before: its coefficients of red, then of green, then of
 * blue.
 *
 *     level 0    all floats, no buckets
 *     level 1    place in steps of 16 bits around the centre of the bucket, the others halves
 *     level 2    the same, SH as bytes between least and largest
 *
 * Facts from the viewer's own reader and writer. The axes are the PLY's. */
#pragma once

#include "formats/gaussian.h"

enum { SPIN_KSPLAT_HEADER = 4096, SPIN_KSPLAT_SECTION = 1024 };

struct spin_ksplat {
    size_t n;
    int sh_degree; /* the largest of the sections, 0 to 3 */
};

/* What a file in memory holds, and that all of it is there. Errors do not name the file, here and
 * below. */
spin_status spin_ksplat_peek(const unsigned char *file, size_t size, struct spin_ksplat *out);
/* All that comes out is finite, rotations are of unit length; a scale of 0 and below becomes the
 * least float. Coefficients that a section lacks are 0. */
spin_status spin_ksplat_read(const unsigned char *file, size_t size, unsigned columns,
                             struct spin_splats *out);
