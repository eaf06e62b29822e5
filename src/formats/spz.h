/* Niantic's SPZ. Read are versions 2 to 4; written are 3 and 4. Versions 2 and 3 are a gzip of a
 * header of 16 bytes and one stream after the other, or just these, which some writers leave
 * unpacked:
 *
 *     places     9 bytes  per axis 24 bits, signed, in steps of 2^-fractional_bits
 *     alphas     1        opacity * 255
 *     colours    3        dc * 0.15 * 255 + 127.5
 *     scales     3        (log scale + 10) * 16
 *     rotations  4        2 bits: the largest of x y z w; of the other three a sign and 9 bits each
 *                3        version 2: x y z of the quaternion with w >= 0, each q * 127.5 + 127.5
 *     sh         0, 9, 24, 45 or 72  coefficient by coefficient, r g b within: x * 128 + 128, to the
 *                         nearest multiple of 8 (degree 1) or 16
 *
 * The header: the magic NGSP, version and number of splats as words, then bytes: SH degree,
 * fractional bits, flags (1: trained antialiased, 2: extensions), 0. Extensions are records (type,
 * length, bytes), in versions 2 and 3 behind the streams.
 *
 * Version 4 is not packed as a whole. The last byte of those 16 is the number of streams that are
 * not empty, the word behind it says where the table of contents lies, 12 bytes of zero end the
 * header. Extensions follow, then the table (for each stream two numbers of 64 bits: its bytes
 * here, and unpacked), then the streams, each compressed by zstd. */
#pragma once

#include "formats/gaussian.h"

enum {
    SPIN_SPZ_HEADER = 16,
    SPIN_SPZ_HEADER_4 = 32,  /* of version 4 */
    SPIN_SPZ_TOC_ENTRY = 16, /* likewise */
    SPIN_SPZ_FRACTION = 12,  /* bits, as the reference has it: places reach to 2048 */
    /* Streams, and bytes of a row. */
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
    int sh_degree, fraction; /* 0..3, of version 4 up to 4; fractional bits of places */
    bool antialias;
    int version; /* 2 to 4; 3 or 4 when one is written */
    int axes;    /* as SPZ_ADOBE_coordinate_system counts them, 1 to 16; 0: the file does not say */
};

/* Of spin_spz_header.axes: Niantic's library takes the first where a file does not say; a PLY has
 * the second, glTF the third. */
enum { SPIN_SPZ_RIGHT_UP_BACK = 4, SPIN_SPZ_RIGHT_DOWN_FORWARD = 6, SPIN_SPZ_LEFT_UP_FORWARD = 7 };

/* ---- Writing --------------------------------------------------------------------------------- */

/* Bytes of a row of a stream. */
size_t spin_spz_width(int stream, int sh_degree);
/* Bytes before gzip or zstd; at most those of a file, but for what these add to bytes that they
 * cannot make fewer. */
uint64_t spin_spz_bytes(size_t n, int sh_degree);
/* Streams of version 4: those that are not empty. */
int spin_spz_n_streams(const struct spin_spz_header *header);
/* How many bytes it has: SPIN_SPZ_HEADER or, of version 4, SPIN_SPZ_HEADER_4, with the table of
 * contents right behind it. */
size_t spin_spz_code_header(const struct spin_spz_header *header, unsigned char *out);
/* An entry of that table: bytes packed, and before. */
void spin_spz_code_toc_entry(uint64_t packed, uint64_t bytes,
                             unsigned char out[SPIN_SPZ_TOC_ENTRY]);
/* The most fractional bits, up to `at_most`, that hold a place whose largest size of a coordinate
 * this is; negative when there are none: above 8388606. */
int spin_spz_fraction(float largest, int at_most);

/* One row of a stream. shown: what a reader sees. */
void spin_spz_code_place(const float place[3], int fraction, unsigned char out[9], float shown[3]);
unsigned char spin_spz_code_alpha(float opacity, float *shown);
void spin_spz_code_colour(const float colour[3], unsigned char out[3], float shown[3]);
void spin_spz_code_scale(const float log_scale[3], unsigned char out[3], float shown[3]);
void spin_spz_code_rotation(const float q[4], unsigned char out[4], float shown[4]);
/* From the first n_sh coefficients [k][3]; more are written as 0. lost: by how much a reader sees
 * less than each is. Both [spin_n_rest()]. */
void spin_spz_code_sh(const float *sh, int n_sh, int sh_degree, unsigned char *out, float *lost);

/* ---- Reading --------------------------------------------------------------------------------- */

/* The header of a file in memory, and whether its lengths are those of its splats. A file that
 * would unpack to more than 32 times itself and 8 MiB is refused. Errors do not name the file, here
 * and below. */
spin_status spin_spz_peek(const void *file, size_t size, struct spin_spz_header *out);
/* The rotation w x y z that turns these axes to right, down, forward. Only those that take half a
 * turn at most are known. */
spin_status spin_spz_axes(int axes, double q[4]);
/* A whole file in memory, in the axes that it holds; SH of degree 4 are cut to 3. All that comes
 * out is finite, rotations are of unit length. */
spin_status spin_spz_read(const void *file, size_t size, unsigned columns, struct spin_splats *out);
