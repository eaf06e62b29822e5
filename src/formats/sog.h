/* PlayCanvas's SOG, version 2: a zip of stored members, lossless WebP images and a meta.json that
 * names them. The reader also accepts the same as separate files in a folder, and version 1. A
 * Gaussian is the same pixel, row by row, in all images except that of the palette:
 *
 *     means_l, means_u   low and high bytes of x y z: 65535 steps between mins and maxs of
 *                        sign(v) ln(1 + |v|)
 *     quats              three of w x y z, each (v / sqrt(2) + 0.5) * 255, and 252 + the index of
 *                        the omitted one: the largest, which is positive
 *     scales             for each axis the index of a log scale in a codebook of 256
 *     sh0                indices of dc in a codebook of 256, and opacity * 255
 *     shN_labels         low and high byte of the index of an SH vector in a palette of at most
 *                        65536
 *     shN_centroids      the palette, 64 vectors a row, one pixel a coefficient: indices of r g b
 *                        in a codebook of 256
 *
 * Version 1, whose meta.json has no version, uses ranges instead of codebooks: a byte of scales and
 * sh0 is between the mins and maxs of its channel, opacity as a logit, and a byte of shN between
 * its min and max. The numbers of Gaussians and coefficients are given as shapes of arrays.
 *
 * The description is based on PlayCanvas's specification, and for version 1 on its readers. The
 * axes are those of a PLY. */
#pragma once

#include "formats/codebook.h"
#include "formats/gaussian.h"

enum spin_sog_picture {
    SPIN_SOG_MEANS_LOW,
    SPIN_SOG_MEANS_HIGH,
    SPIN_SOG_QUATS,
    SPIN_SOG_SCALES,
    SPIN_SOG_SH0,
    SPIN_SOG_LABELS, /* the last two only with SH */
    SPIN_SOG_CENTROIDS,
    SPIN_SOG_PICTURES
};

enum { SPIN_SOG_PALETTE_LINE = 64, SPIN_SOG_MAX_PALETTE = 65536 };

/* The "model" in meta.json of splats that are to be drawn antialiased. */
#define SPIN_SOG_ANTIALIASED "antialiased"

struct spin_sog_range {
    double mins[3], maxs[3];
};

struct spin_sog {
    size_t n;
    int sh_degree; /* 0 to 3 */
    bool antialias;
    struct spin_sog_range means; /* of spin_sog_log() of the positions */
    float scales[SPIN_CODEBOOK], sh0[SPIN_CODEBOOK], sh_n[SPIN_CODEBOOK];
    size_t n_palette;
    int version; /* 1 or 2, of a file that was read */
};

/* The name of an image's member. */
const char *spin_sog_name(enum spin_sog_picture picture);
/* The size of an image in pixels; width 0: it does not exist. */
void spin_sog_size(const struct spin_sog *sog, enum spin_sog_picture picture, int *width,
                   int *height);
/* The size of the palette for n Gaussians, as in splat-transform: the largest power of 2 up to n,
 * but at least 1024 and at most 65536. */
size_t spin_sog_palette(size_t n);

/* ---- Writing --------------------------------------------------------------------------------- */

double spin_sog_log(double v);
double spin_sog_unlog(double v);
/* Quantises n numbers to the steps of a range (of their spin_sog_log(), unless it is linear): 16
 * bits, or 8 if high is NULL. shown: the decoded values, here and below. */
void spin_sog_code(const struct spin_sog_range *range, bool linear, size_t n, const float *v,
                   uint8_t *low, uint8_t *high, float *shown);
/* Decodes number c from step q of `steps`. */
float spin_sog_number(const struct spin_sog_range *range, bool linear, size_t c, unsigned q,
                      double steps);
void spin_sog_code_rotation(const float q[4], uint8_t out[4], float shown[4]);
/* Decodes such a pixel; false if its mark is invalid. */
bool spin_sog_rotation(const uint8_t pixel[4], float q[4]);
/* The text of meta.json, malloc'ed. */
spin_status spin_sog_meta(const struct spin_sog *sog, char **text, size_t *n);

/* ---- Reading --------------------------------------------------------------------------------- */

/* Reads meta.json and checks that its images exist and have the right size. The file is the zip;
 * or, with a folder, meta.json itself, whose images are files in the folder. Errors do not name the
 * file, here and below. */
spin_status spin_sog_peek(const void *file, size_t size, const char *folder, struct spin_sog *out);
/* Reads all splats. All values are finite, rotations are normalised. Refuses versions above 2, and
 * images that are much larger than their contents. */
spin_status spin_sog_read(const void *file, size_t size, const char *folder, unsigned columns,
                          struct spin_splats *out);
