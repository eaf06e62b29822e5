/* Niantic's SPZ. Versions 2 to 4 are read, 3 and 4 are written. Versions 2 and 3 are a gzip of a
 * header of 16 bytes and the streams, one after the other; some writers omit the gzip:
 *
 *     positions  9 bytes  for each axis 24 bits, signed, in steps of 2^-fractional_bits
 *     alphas     1        opacity * 255
 *     colours    3        dc * 0.15 * 255 + 127.5
 *     scales     3        (log scale + 10) * 16
 *     rotations  4        2 bits: the largest of x y z w; of the other three a sign and 9 bits each
 *                3        version 2: x y z of the quaternion with w >= 0, each q * 127.5 + 127.5
 *     sh         0, 9, 24, 45 or 72  coefficient by coefficient, r g b within: x * 128 + 128, to
 *                         the nearest multiple of 8 (degree 1) or 16
 *
 * The header: the magic NGSP, version and number of splats as words, then bytes: SH degree,
 * fractional bits, flags (1: trained antialiased, 2: extensions), 0. Extensions are records (type,
 * length, bytes); in versions 2 and 3 they follow the streams.
 *
 * Version 4 is not compressed as a whole. The last of those 16 bytes is the number of streams that
 * are not empty, the next word is the offset of the table of contents, and 12 zero bytes end the
 * header. Then come the extensions, the table (two 64-bit numbers for each stream: its compressed
 * and its unpacked size), and the streams, each compressed by zstd. */
#pragma once

#include "formats/gaussian.h"

enum {
    SPIN_SPZ_HEADER = 16,
    SPIN_SPZ_HEADER_4 = 32,  /* of version 4 */
    SPIN_SPZ_TOC_ENTRY = 16, /* of version 4 */
    SPIN_SPZ_FRACTION = 12,  /* bits, as in the reference: positions up to 2048 */
    /* Streams. */
    SPIN_SPZ_PLACE = 0,
    SPIN_SPZ_ALPHA,
    SPIN_SPZ_COLOUR,
    SPIN_SPZ_SCALE,
    SPIN_SPZ_ROTATION,
    SPIN_SPZ_SH,
    SPIN_SPZ_STREAMS
};

struct spin_spz_header {
    size_t n;
    int sh_degree, fraction; /* 0..3, in version 4 up to 4; fractional bits of positions */
    bool antialias;
    int version; /* 2 to 4; 3 or 4 for writing */
    int axes;    /* numbered as in SPZ_ADOBE_coordinate_system, 1 to 16; 0: not given in the file */
};

/* Values of spin_spz_header.axes: the default of Niantic's library, the axes of a PLY, those of
 * glTF. */
enum { SPIN_SPZ_RIGHT_UP_BACK = 4, SPIN_SPZ_RIGHT_DOWN_FORWARD = 6, SPIN_SPZ_LEFT_UP_FORWARD = 7 };

/* ---- Writing --------------------------------------------------------------------------------- */

/* Bytes per row of a stream. */
size_t spin_spz_width(int stream, int sh_degree);
/* Bytes before gzip or zstd. Files are not larger, except for the overhead on incompressible
 * data. */
uint64_t spin_spz_bytes(size_t n, int sh_degree);
/* Number of streams of version 4: those that are not empty. */
int spin_spz_n_streams(const struct spin_spz_header *header);
/* Writes the header and returns its size: SPIN_SPZ_HEADER or, for version 4, SPIN_SPZ_HEADER_4,
 * after which the table of contents must follow. */
size_t spin_spz_code_header(const struct spin_spz_header *header, unsigned char *out);
/* Writes an entry of that table: compressed and unpacked bytes. */
void spin_spz_code_toc_entry(uint64_t packed, uint64_t bytes,
                             unsigned char out[SPIN_SPZ_TOC_ENTRY]);
/* The most fractional bits, up to `at_most`, for positions whose largest absolute coordinate is
 * this; negative if it is above 8388606, which the format cannot store. */
int spin_spz_fraction(float largest, int at_most);

/* Write one row of a stream. shown: the decoded values. */
void spin_spz_code_place(const float place[3], int fraction, unsigned char out[9], float shown[3]);
unsigned char spin_spz_code_alpha(float opacity, float *shown);
void spin_spz_code_colour(const float colour[3], unsigned char out[3], float shown[3]);
void spin_spz_code_scale(const float log_scale[3], unsigned char out[3], float shown[3]);
void spin_spz_code_rotation(const float q[4], unsigned char out[4], float shown[4]);
/* The same, from the first n_sh coefficients [k][3]; the others are written as 0. lost: each
 * coefficient minus its decoded value. Both [spin_n_rest()]. */
void spin_spz_code_sh(const float *sh, int n_sh, int sh_degree, unsigned char *out, float *lost);

/* ---- Reading --------------------------------------------------------------------------------- */

/* Reads the header of a file in memory and checks that its lengths match its splats. A file that
 * would unpack to more than 32 times its size plus 8 MiB is refused. Errors do not name the file,
 * here and below. */
spin_status spin_spz_peek(const void *file, size_t size, struct spin_spz_header *out);
/* The rotation w x y z from these axes to right, down, forward. SPIN_E_UNSUPPORTED unless it is at
 * most half a turn about an axis. */
spin_status spin_spz_axes(int axes, double q[4]);
/* Reads a whole file in memory, in its own axes; SH of degree 4 are truncated to 3. All values are
 * finite, rotations are normalised. */
spin_status spin_spz_read(const void *file, size_t size, unsigned columns, struct spin_splats *out);
