/* PlayCanvas's compressed PLY (splat-transform, SuperSplat): a binary little endian PLY with the
 * elements chunk, vertex and, with SH, sh.
 *
 * Gaussians are cut into chunks of 256; a chunk holds the ranges of place, log scale and colour, a
 * vertex four words within them:
 *
 *     packed_position, packed_scale   11, 10 and 11 bits, x high
 *     packed_rotation                 2 bits: the largest of w x y z; 10 bits for each of the
 *                                     others, (v / sqrt(2) + 0.5) * 1023
 *     packed_color                    r g b within the range and opacity, 8 bits each
 *
 * sh holds f_rest, channel-major, in 256 steps over [-4, 4]. */
#pragma once

#include "formats/gs_ply.h"

enum {
    SPIN_COMPRESSED_CHUNK = 256,
    SPIN_COMPRESSED_RANGES = 18, /* floats per chunk */
    SPIN_COMPRESSED_VERTEX = 16  /* bytes per vertex */
};

/* ---- Writing --------------------------------------------------------------------------------- */

static inline size_t spin_compressed_chunks(size_t n)
{
    return n / SPIN_COMPRESSED_CHUNK + (n % SPIN_COMPRESSED_CHUNK != 0);
}

/* Bytes after the header. */
uint64_t spin_compressed_body(int sh_degree, size_t n);
/* Like spin_gs_ply_header(). */
size_t spin_compressed_header(int sh_degree, size_t n, const char *comments,
                              char text[SPIN_GS_PLY_MAX_HEADER]);
/* Packs one chunk of n rows, at most 256, in native byte order. Log scales are clamped to
 * -20..20. */
void spin_compressed_pack(struct spin_gaussian *row, size_t n, float range[SPIN_COMPRESSED_RANGES],
                          uint32_t (*word)[4]);
/* Decodes a row, as readers do. */
void spin_compressed_unpack(const uint32_t word[4], const float range[SPIN_COMPRESSED_RANGES],
                            struct spin_gaussian *out);
/* Packs the f_rest_* of one row, from the first n_sh coefficients [k][3]; the others are written as
 * 0. lost: each coefficient minus its decoded value. Both [spin_n_rest()]. */
void spin_compressed_pack_sh(const float *sh, int n_sh, int sh_degree, unsigned char *out,
                             float *lost);

/* ---- Reading --------------------------------------------------------------------------------- */

struct spin_compressed_ply {
    const struct spin_ply *ply;                         /* borrowed */
    const struct spin_ply_element *vertex, *chunk, *sh; /* sh: NULL if there is none */
    int packed[4];                                      /* indices of vertex properties */
    int n_rest, sh_degree;                              /* see struct spin_gs_ply */
};

/* True if the vertices have packed properties. */
bool spin_compressed_any(const struct spin_ply_element *vertex);
/* Finds all elements and properties. Errors name the file and the property. */
spin_status spin_compressed_find(const struct spin_ply *ply, struct spin_compressed_ply *out);
/* Reads into columns that are reserved with at least the file's SH degree; coefficients above it
 * become 0. All values are checked to be finite. Rotations are normalised. */
spin_status spin_compressed_read(const struct spin_compressed_ply *file, unsigned columns,
                                 struct spin_splats *out);
