/* PlayCanvas's compressed PLY (splat-transform, SuperSplat): a binary little-endian PLY with the
 * elements `chunk`, `vertex` and, for SH above degree 0, `sh`.
 *
 * A chunk is a group of 256 splats, and stores the minimum and maximum of their positions, log
 * scales and colours. A vertex stores four words, quantised within the ranges of its chunk:
 *
 *     packed_position, packed_scale   x, y, z in 11, 10 and 11 bits; x in the highest bits
 *     packed_rotation                 2 bits: index of the largest of w x y z, which is omitted;
 *                                     10 bits for each other component: (v / sqrt(2) + 0.5) * 1023
 *     packed_color                    r, g, b and opacity in 8 bits each; the range of opacity is
 *                                     0 to 1
 *
 * An element of `sh` stores f_rest_*, channel-major, as bytes: 256 steps over [-4, 4]. */
#pragma once

#include "formats/gs_ply.h"

enum {
    SPIN_COMPRESSED_CHUNK = 256,
    SPIN_COMPRESSED_RANGES = 18, /* floats per chunk: minimum and maximum of 9 values */
    SPIN_COMPRESSED_VERTEX = 16  /* bytes per vertex */
};

/* ---- Writing --------------------------------------------------------------------------------- */

static inline size_t spin_compressed_chunks(size_t n)
{
    return n / SPIN_COMPRESSED_CHUNK + (n % SPIN_COMPRESSED_CHUNK != 0);
}

/* Returns the size in bytes of a file with n splats, without its header. */
uint64_t spin_compressed_body(int sh_degree, size_t n);
/* Writes the header of a file with n rows. Arguments and result are those of
 * spin_gs_ply_header(). */
size_t spin_compressed_header(int sh_degree, size_t n, const char *comments,
                              char text[SPIN_GS_PLY_MAX_HEADER]);
/* Packs one chunk of n rows, at most 256, in native byte order. range: receives the ranges of the
 * chunk; word: [n], receives the four words of each row. Clamps row[].log_scale to -20..20 in
 * place. */
void spin_compressed_pack(struct spin_gaussian *row, size_t n, float range[SPIN_COMPRESSED_RANGES],
                          uint32_t (*word)[4]);
/* Decodes a row exactly as readers of the format do. */
void spin_compressed_unpack(const uint32_t word[4], const float range[SPIN_COMPRESSED_RANGES],
                            struct spin_gaussian *out);
/* Packs the f_rest_* of one row into out [spin_n_rest()]. sh: n_sh coefficients [k][3]; missing
 * coefficients are written as 0. lost [spin_n_rest()]: quantisation error, each coefficient minus
 * its decoded value. */
void spin_compressed_pack_sh(const float *sh, int n_sh, int sh_degree, unsigned char *out,
                             float *lost);

/* ---- Reading --------------------------------------------------------------------------------- */

struct spin_compressed_ply {
    const struct spin_ply *ply; /* borrowed */
    /* Elements of the PLY. sh: NULL if the SH degree is 0. */
    const struct spin_ply_element *vertex, *chunk, *sh;
    /* Indices of the vertex properties packed_*. */
    int packed[4];
    int n_rest, sh_degree; /* as in struct spin_gs_ply */
};

/* True if the vertices have properties named packed_*. */
bool spin_compressed_any(const struct spin_ply_element *vertex);
/* Finds all elements and properties. Error messages contain the path and the property. */
spin_status spin_compressed_find(const struct spin_ply *ply, struct spin_compressed_ply *out);
/* Reads all rows. The columns of *out must be reserved with at least the file's SH degree;
 * coefficients above the file's degree become 0. Values that are not finite are an error. Rotations
 * are normalised. */
spin_status spin_compressed_read(const struct spin_compressed_ply *file, unsigned columns,
                                 struct spin_splats *out);
