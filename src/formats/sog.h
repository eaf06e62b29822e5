/* PlayCanvas's SOG, version 2: a zip of stored members, lossless WebP pictures and a meta.json that
 * names them. Read are also such files that lie loose in a folder, and version 1. A Gaussian is the
 * same pixel, row by row, in all pictures but that of the palette:
 *
 *     means_l, means_u   low and high bytes of x y z: 65535 steps between mins and maxs of
 *                        sign(v) ln(1 + |v|)
 *     quats              three of w x y z, each (v / sqrt(2) + 0.5) * 255, and 252 + which is left out: the
 *                        largest, taken as positive
 *     scales             per axis the index of a log scale in a book of 256
 *     sh0                indices of dc in a book of 256, and opacity * 255
 *     shN_labels         low and high byte of the index of a vector of SH in a palette of at most 65536
 *     shN_centroids      the palette, 64 vectors a line, one pixel a coefficient: indices of r g b in a book of
 *                        256
 *
 * Version 1, whose meta.json says no version, has ranges in place of books: a byte of scales and
 * sh0 lies between the mins and maxs of its channel, opacity as a logit, and one of shN between its
 * two. The number of Gaussians and of coefficients are shapes of arrays.
 *
 * Facts from PlayCanvas's specification of the format, of version 1 from its readers. The axes are
 * the PLY's. */
#pragma once

#include "formats/codebook.h"
#include "formats/gaussian.h"

enum spin_sog_picture {
    SPIN_SOG_MEANS_LOW,
    SPIN_SOG_MEANS_HIGH,
    SPIN_SOG_QUATS,
    SPIN_SOG_SCALES,
    SPIN_SOG_SH0,
    SPIN_SOG_LABELS, /* the last two with SH only */
    SPIN_SOG_CENTROIDS,
    SPIN_SOG_PICTURES
};

enum { SPIN_SOG_PALETTE_LINE = 64, SPIN_SOG_MAX_PALETTE = 65536 };

/* The "model" in meta.json of splats that are meant to be drawn antialiased. */
#define SPIN_SOG_ANTIALIASED "antialiased"

struct spin_sog_range {
    double mins[3], maxs[3];
};

struct spin_sog {
    size_t n;
    int sh_degree; /* 0 to 3 */
    bool antialias;
    struct spin_sog_range means; /* of spin_sog_log() of the places */
    float scales[SPIN_CODEBOOK], sh0[SPIN_CODEBOOK], sh_n[SPIN_CODEBOOK];
    size_t n_palette;
    int version; /* 1 or 2, of a file that is read */
};

/* The member of a picture. */
const char *spin_sog_name(enum spin_sog_picture picture);
/* Pixels of a picture; width 0: there is none. */
void spin_sog_size(const struct spin_sog *sog, enum spin_sog_picture picture, int *width,
                   int *height);
/* Vectors that the palette of n Gaussians gets, as splat-transform has it: the largest power of 2
 * up to n, from 1024 to 65536. */
size_t spin_sog_palette(size_t n);

/* ---- Writing --------------------------------------------------------------------------------- */

double spin_sog_log(double v);
double spin_sog_unlog(double v);
/* n numbers of a range (of their spin_sog_log(), unless it is linear) as its nearest steps: 16
 * bits, or 8 where high is NULL. shown: what a reader sees, here and below. */
void spin_sog_code(const struct spin_sog_range *range, bool linear, size_t n, const float *v,
                   uint8_t *low, uint8_t *high, float *shown);
/* Number c at step q of so many. */
float spin_sog_number(const struct spin_sog_range *range, bool linear, size_t c, unsigned q,
                      double steps);
void spin_sog_code_rotation(const float q[4], uint8_t out[4], float shown[4]);
/* Of such a pixel; false when its mark is none. */
bool spin_sog_rotation(const uint8_t pixel[4], float q[4]);
/* meta.json, allocated with malloc. */
spin_status spin_sog_meta(const struct spin_sog *sog, char **text, size_t *n);

/* ---- Reading --------------------------------------------------------------------------------- */

/* What meta.json says, and that its pictures are there, of the right size. The file is the zip; or,
 * with a folder, meta.json itself, whose pictures lie in the folder. Errors do not name the file,
 * here and below. */
spin_status spin_sog_peek(const void *file, size_t size, const char *folder, struct spin_sog *out);
/* All that comes out is finite, rotations are of unit length. Refused are versions above 2, and
 * pictures that are much larger than what they hold. */
spin_status spin_sog_read(const void *file, size_t size, const char *folder, unsigned columns,
                          struct spin_splats *out);
