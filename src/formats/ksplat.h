/* .ksplat, the format of mkkellogg's viewer (GaussianSplats3D), version 0.1. A file is little
 * endian and consists of the file header, the headers of all sections, and the data of all
 * sections. In this table, the number before a field is its offset in bytes; fields are 4-byte
 * integers unless another type is given:
 *
 *     file header, 4096 bytes       0 version, bytes 0 and 1    4 capacity in sections
 *                                   8 number of sections    16 number of splats
 *                                   20 level, 2 bytes    36 minimum and 40 maximum of SH, floats
 *     section header, 1024 bytes    0 number of splats    4 capacity in splats
 *                                   8 splats per full bucket    12 number of buckets
 *                                   16 width of a bucket, float
 *                                   20 size of a bucket's centre, 2 bytes
 *                                   24 steps for half the width of a bucket
 *                                   32 number of full buckets    36 number of other buckets
 *                                   40 SH degree, 2 bytes
 *     data of a section             number of splats of each bucket that is not full; centre of
 *                                   each bucket, 3 floats; rows of splats, bucket by bucket
 *
 * A row contains position, scale (not its logarithm), rotation w x y z, colour and opacity in 4
 * bytes, and the SH coefficients above degree 0. These are ordered by degree; each degree has all
 * coefficients of red, then those of green, then those of blue. The compression level defines the
 * types:
 *
 *     level 0    all values are floats; there are no buckets
 *     level 1    positions are 16-bit steps around the centre of the bucket; all other values are
 *                half floats
 *     level 2    like level 1, but SH are bytes between minimum and maximum
 *
 * This description follows the viewer's own reader and writer. The axes are those of a PLY. */
#pragma once

#include "formats/gaussian.h"

enum { SPIN_KSPLAT_HEADER = 4096, SPIN_KSPLAT_SECTION = 1024 };

struct spin_ksplat {
    size_t n;
    int sh_degree; /* maximum of the SH degrees of all sections, 0 to 3 */
};

/* Reads the headers of a file in memory, and checks that the file is complete. Error messages of
 * these functions do not contain the path. */
spin_status spin_ksplat_peek(const unsigned char *file, size_t size, struct spin_ksplat *out);
/* Reads all splats. Values that are not finite are an error. Rotations are normalised. Scales below
 * 1e-38, including 0 and negative ones, become 1e-38. In sections with a lower SH degree than the
 * file, the missing coefficients become 0. */
spin_status spin_ksplat_read(const unsigned char *file, size_t size, unsigned columns,
                             struct spin_splats *out);
