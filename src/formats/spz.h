/* Niantic's SPZ. Versions 2 to 4 can be read, versions 3 and 4 can be written.
 *
 * Versions 2 and 3 consist of a header of 16 bytes, six streams in a row, and extensions. The whole
 * file is compressed with gzip, but some writers omit this compression. The streams, with their
 * bytes per splat, are
 *
 *     positions  9  x y z, each a signed 24-bit integer in steps of 2^-fractional_bits
 *     alphas     1  opacity * 255
 *     colours    3  dc * 0.15 * 255 + 127.5
 *     scales     3  (log scale + 10) * 16
 *     rotations  4  2 bits: index of the largest of x y z w, which is omitted; 10 bits for each
 *                   other component: a sign, and the magnitude in 9 bits
 *                3  in version 2: x y z of the quaternion with w >= 0, each q * 127.5 + 127.5
 *     sh         0, 9, 24, 45 or 72: for each coefficient r g b, each x * 128 + 128, rounded to a
 *                   multiple of 8 (degree 1) or 16 (higher degrees)
 *
 * The header contains three 4-byte words: the magic number NGSP, the version, and the number of
 * splats; then four bytes: SH degree, fractional bits, flags (1: trained antialiased, 2:
 * extensions), and 0. An extension is a record of type, length and content.
 *
 * Version 4 compresses each stream separately with zstd. The last of the 16 bytes is the number of
 * streams that are not empty. The header has 16 more bytes: a word with the offset of the table of
 * contents, and 12 zero bytes. The extensions follow, then the table of contents (the compressed
 * and the unpacked size of each stream as 64-bit integers), then the streams. */
#pragma once

#include "formats/gaussian.h"

enum {
    SPIN_SPZ_HEADER = 16,
    SPIN_SPZ_HEADER_4 = 32,  /* size of the header of version 4 */
    SPIN_SPZ_TOC_ENTRY = 16, /* size of an entry of the table of contents of version 4 */
    /* Default number of fractional bits, as in Niantic's library, for positions from -2048 to 2048
     * world units. */
    SPIN_SPZ_FRACTION = 12,
    /* Numbers of the streams. */
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
    /* SH degree, 0 to 4, and number of fractional bits of positions. */
    int sh_degree, fraction;
    bool antialias;
    int version; /* 2 to 4 for reading; 3 or 4 for writing */
    int axes;    /* 1 to 16, see SPZ_ADOBE_coordinate_system; 0: not in the file */
};

/* Values of spin_spz_header.axes: the default of Niantic's library, the axes of a PLY, and the axes
 * of glTF. */
enum { SPIN_SPZ_RIGHT_UP_BACK = 4, SPIN_SPZ_RIGHT_DOWN_FORWARD = 6, SPIN_SPZ_LEFT_UP_FORWARD = 7 };

/* ---- Writing --------------------------------------------------------------------------------- */

/* Returns the number of bytes per splat in a stream. */
size_t spin_spz_width(int stream, int sh_degree);
/* Returns the size of a file in bytes before compression. The compressed file is smaller, or
 * exceeds this size by the small overhead that gzip and zstd add to incompressible data. */
uint64_t spin_spz_bytes(size_t n, int sh_degree);
/* Returns the number of streams that are not empty, for the header of version 4. */
int spin_spz_n_streams(const struct spin_spz_header *header);
/* Writes the header to `out` and returns its size: SPIN_SPZ_HEADER or, for version 4,
 * SPIN_SPZ_HEADER_4. In version 4 the caller must write the table of contents next. */
size_t spin_spz_code_header(const struct spin_spz_header *header, unsigned char *out);
/* Writes an entry of the table of contents. packed, bytes: compressed and unpacked size. */
void spin_spz_code_toc_entry(uint64_t packed, uint64_t bytes,
                             unsigned char out[SPIN_SPZ_TOC_ENTRY]);
/* Returns the largest possible number of fractional bits of positions, but not more than `at_most`.
 * largest: the largest absolute coordinate. Returns a negative number if `largest` is above
 * 8388606, which the format cannot store. */
int spin_spz_fraction(float largest, int at_most);

/* Each of these functions quantises the values of one splat for a stream. shown: receives the
 * values as readers decode them. */
void spin_spz_code_place(const float place[3], int fraction, unsigned char out[9], float shown[3]);
unsigned char spin_spz_code_alpha(float opacity, float *shown);
void spin_spz_code_colour(const float colour[3], unsigned char out[3], float shown[3]);
void spin_spz_code_scale(const float log_scale[3], unsigned char out[3], float shown[3]);
void spin_spz_code_rotation(const float q[4], unsigned char out[4], float shown[4]);
/* Quantises the SH of one splat above degree 0 into out [spin_n_rest()]. sh: n_sh coefficients
 * [k][3]; missing coefficients are written as 0. lost [spin_n_rest()]: quantisation error, each
 * coefficient minus its decoded value. */
void spin_spz_code_sh(const float *sh, int n_sh, int sh_degree, unsigned char *out, float *lost);

/* ---- Reading --------------------------------------------------------------------------------- */

/* Reads the header of a file in memory, and checks that all lengths match the number of splats.
 * Files that would unpack to more than 32 times their size plus 8 MiB are refused. Error messages
 * of the next three functions do not contain the path. */
spin_status spin_spz_peek(const void *file, size_t size, struct spin_spz_header *out);
/* Sets q to the rotation w x y z from `axes` to right, down, forward. Fails with SPIN_E_UNSUPPORTED
 * unless the rotation is the identity, or half a turn about x, y or z. */
spin_status spin_spz_axes(int axes, double q[4]);
/* Reads a whole file from memory, in the axes of the file. SH of degree 4 are truncated to degree
 * 3. The results are finite, and rotations are normalised. */
spin_status spin_spz_read(const void *file, size_t size, unsigned columns, struct spin_splats *out);
