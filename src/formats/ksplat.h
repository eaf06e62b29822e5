/* .ksplat, the format of mkkellogg's viewer (GaussianSplats3D), version 0.1. Little endian.
 *
 *     header, 4096 bytes      0 version (0, 1)    4 capacity in sections    8 sections
 *                             16 splats    20 level, 2 bytes    36 least and largest SH
 *     section header, 1024    0 splats    4 capacity in splats    8 splats of a full bucket
 *                             12 buckets    16 width of a bucket, a float
 *                             20 bytes of a bucket, 2    24 steps of half a width
 *                             32 full buckets    36 other buckets    40 SH degree, 2 bytes
 *     data of a section       the number of splats of each bucket that is not full; centres of
 *                             buckets, 3 floats; rows of splats, bucket after bucket
 *
 * A row has position, scale (not its logarithm), rotation w x y z, colour and opacity as 4 bytes,
 * and SH. SH are ordered by degree: within a degree, the coefficients of red, then green, then
 * blue.
 *
 *     level 0    all floats, no buckets
 *     level 1    position in 16-bit steps around the bucket's centre, the others half floats
 *     level 2    the same, with SH as bytes between least and largest
 *
 * The description is based on the viewer's own reader and writer. The axes are those of a PLY. */
#pragma once

#include "formats/gaussian.h"

enum { SPIN_KSPLAT_HEADER = 4096, SPIN_KSPLAT_SECTION = 1024 };

struct spin_ksplat {
    size_t n;
    int sh_degree; /* the largest of the sections, 0 to 3 */
};

/* Reads the headers of a file in memory and checks that all its data are present. Errors do not
 * name the file, here and below. */
spin_status spin_ksplat_peek(const unsigned char *file, size_t size, struct spin_ksplat *out);
/* Reads all splats. All values are checked to be finite, rotations are normalised; a scale of 0 or
 * less becomes 1e-38. Coefficients that a section lacks are 0. */
spin_status spin_ksplat_read(const unsigned char *file, size_t size, unsigned columns,
                             struct spin_splats *out);
