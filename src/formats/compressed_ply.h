/* PlayCanvas's compressed PLY (splat-transform, SuperSplat): a binary little endian PLY with the
 * elements chunk, vertex and, with SH, sh.
 *
 * Gaussians are cut into chunks of 256; a chunk holds the ranges of place, log scale and colour, a
 * vertex four words within them:
 *
 *     packed_position, packed_scale   11, 10 and 11 bits, x high
 *     packed_rotation                 2 bits: the largest of w x y z; the other three, 10 bits each,
 *                                     (v / sqrt(2) + 0.5) * 1023
 *     packed_color                    r g b within the range and opacity, 8 bits each
 *
 * sh holds f_rest, channel-major, in 256 steps over [-4, 4]. */
#pragma once

#include "formats/gs_ply.h"

enum {
    SPIN_COMPRESSED_CHUNK = 256,
    SPIN_COMPRESSED_RANGES = 18, /* floats of a chunk */
    SPIN_COMPRESSED_VERTEX = 16  /* bytes */
};

/* ---- Writing --------------------------------------------------------------------------------- */

static inline size_t spin_compressed_chunks(size_t n)
{
    return n / SPIN_COMPRESSED_CHUNK + (n % SPIN_COMPRESSED_CHUNK != 0);
}

/* Bytes after the header. */
uint64_t spin_compressed_body(int sh_degree, size_t n);
/* As spin_gs_ply_header(). */
size_t spin_compressed_header(int sh_degree, size_t n, const char *comments,
                              char text[SPIN_GS_PLY_MAX_HEADER]);
/* One chunk of n rows, at most 256, in this machine's byte order. Log scales are cut to -20..20. */
void spin_compressed_pack(struct spin_gaussian *row, size_t n, float range[SPIN_COMPRESSED_RANGES],
                          uint32_t (*word)[4]);
/* What a reader sees of a row. */
void spin_compressed_unpack(const uint32_t word[4], const float range[SPIN_COMPRESSED_RANGES],
                            struct spin_gaussian *out);
/* The f_rest_* of one row, from the first n_sh coefficients [k][3]; more are written as 0. lost: by
 * how much a reader sees less than each is. Both [spin_n_rest()]. */
void spin_compressed_pack_sh(const float *sh, int n_sh, int sh_degree, unsigned char *out,
                             float *lost);

/* ---- Reading --------------------------------------------------------------------------------- */

struct spin_compressed_ply {
    const struct spin_ply *ply;                         /* borrowed */
    const struct spin_ply_element *vertex, *chunk, *sh; /* sh: NULL when there is none */
    int packed[4];                                      /* properties of vertex */
    int n_rest, sh_degree;                              /* as of struct spin_gs_ply */
};

/* Whether the vertices are packed. */
bool spin_compressed_any(const struct spin_ply_element *vertex);
/* Finds all that is needed. Errors name the file and the property. */
spin_status spin_compressed_find(const struct spin_ply *ply, struct spin_compressed_ply *out);
/* Into columns that are reserved, with at least the file's SH degree; coefficients above it become
 * 0. All that comes out is finite. Rotations are of unit length. */
spin_status spin_compressed_read(const struct spin_compressed_ply *file, unsigned columns,
                                 struct spin_splats *out);
