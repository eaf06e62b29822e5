/* PlayCanvas's SOG, version 2: a zip with uncompressed members, which are lossless WebP images and
 * a meta.json with their names. The reader also accepts an unpacked SOG (files in a folder), and
 * version 1. Pixel i of each image, counted row by row, belongs to splat i; only shN_centroids is
 * different:
 *
 *     means_l, means_u   low and high bytes of x y z: 16-bit codes between mins and maxs of
 *                        sign(v) ln(1 + |v|)
 *     quats              r g b: the three smaller components of w x y z, each
 *                        (v / sqrt(2) + 0.5) * 255; alpha, the mode byte: 252 + index of the
 *                        largest component, which is omitted and positive
 *     scales             indices of the three log scales in a codebook of 256 values
 *     sh0                r g b: indices of dc in a codebook of 256 values; alpha: opacity * 255
 *     shN_labels         low and high byte of the index of an SH vector in a palette of at most
 *                        65536 vectors
 *     shN_centroids      the palette: 64 vectors per image row, one pixel per coefficient; r g b
 *                        are indices in a codebook of 256 values
 *
 * Version 1, whose meta.json has no key 'version', has ranges instead of codebooks: byte 0 is the
 * minimum and byte 255 the maximum of a range. Each channel of scales and sh0 has its own range;
 * all coefficients of shN share one. Opacity is stored as a logit. The number of splats and the SH
 * degree are not stored as such, but follow from the shapes of arrays in meta.json.
 *
 * This description follows PlayCanvas's specification and, for version 1, the code of PlayCanvas's
 * readers. The axes are those of a PLY. */
#pragma once

#include "formats/codebook.h"
#include "formats/gaussian.h"

enum spin_sog_picture {
    SPIN_SOG_MEANS_LOW,
    SPIN_SOG_MEANS_HIGH,
    SPIN_SOG_QUATS,
    SPIN_SOG_SCALES,
    SPIN_SOG_SH0,
    SPIN_SOG_LABELS,    /* exists only with SH above degree 0 */
    SPIN_SOG_CENTROIDS, /* exists only with SH above degree 0 */
    SPIN_SOG_PICTURES
};

enum { SPIN_SOG_PALETTE_LINE = 64, SPIN_SOG_MAX_PALETTE = 65536 };

/* Value of "model" in meta.json for splats that must be drawn antialiased. */
#define SPIN_SOG_ANTIALIASED "antialiased"

struct spin_sog_range {
    double mins[3], maxs[3];
};

struct spin_sog {
    size_t n;
    int sh_degree; /* 0 to 3 */
    bool antialias;
    /* Range of the positions after conversion by spin_sog_log(). */
    struct spin_sog_range means;
    float scales[SPIN_CODEBOOK], sh0[SPIN_CODEBOOK], sh_n[SPIN_CODEBOOK];
    size_t n_palette;
    int version; /* version of the file that was read: 1 or 2 */
};

/* Returns the name of an image in the zip. */
const char *spin_sog_name(enum spin_sog_picture picture);
/* Computes the size of an image in pixels. It is 0 x 0 if the SH degree is 0 and the image exists
 * only for higher degrees. */
void spin_sog_size(const struct spin_sog *sog, enum spin_sog_picture picture, int *width,
                   int *height);
/* Returns the number of palette vectors for n splats, the same as PlayCanvas's splat-transform
 * chooses: the largest power of 2 up to n, but at least 1024 and at most 65536. */
size_t spin_sog_palette(size_t n);

/* ---- Writing --------------------------------------------------------------------------------- */

/* spin_sog_log() returns sign(v) ln(1 + |v|); spin_sog_unlog() is the inverse function. */
double spin_sog_log(double v);
double spin_sog_unlog(double v);
/* Quantises the n <= 3 components of v, component c within range->mins[c] and maxs[c], to 16 bits,
 * or to 8 bits if high is NULL. Unless `linear` is true, the numbers are first converted by
 * spin_sog_log(), and the range is that of the converted numbers. shown: receives the numbers as
 * readers decode them. */
void spin_sog_code(const struct spin_sog_range *range, bool linear, size_t n, const float *v,
                   uint8_t *low, uint8_t *high, float *shown);
/* Decodes a code q, from 0 to steps, of component c. Unless `linear` is true, the result is
 * converted by spin_sog_unlog(). */
float spin_sog_number(const struct spin_sog_range *range, bool linear, size_t c, unsigned q,
                      double steps);
/* Quantises a unit quaternion w x y z to a pixel. shown: receives the quaternion as readers decode
 * it. */
void spin_sog_code_rotation(const float q[4], uint8_t out[4], float shown[4]);
/* Decodes a pixel of quats.webp; returns false if its mode byte is invalid. */
bool spin_sog_rotation(const uint8_t pixel[4], float q[4]);
/* Sets *text, which the caller frees, to the content of meta.json, and *n to the length of the
 * text. */
spin_status spin_sog_meta(const struct spin_sog *sog, char **text, size_t *n);

/* ---- Reading --------------------------------------------------------------------------------- */

/* Reads meta.json, and checks that the images in it exist and have the right size. file: if
 * `folder` is NULL, the content of the zip; otherwise the content of meta.json of an unpacked SOG
 * in `folder`. Error messages of this section do not contain the path. */
spin_status spin_sog_peek(const void *file, size_t size, const char *folder, struct spin_sog *out);
/* Reads all splats; file, size and folder are as for spin_sog_peek(). The results are finite, and
 * rotations are normalised. Versions above 2 are refused, and so are images with many more pixels
 * than splats, which may be decompression bombs. */
spin_status spin_sog_read(const void *file, size_t size, const char *folder, unsigned columns,
                          struct spin_splats *out);
