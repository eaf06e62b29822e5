/* The values of one splat, and helpers shared by the readers and writers of splat files. */
#pragma once

#include <math.h>

#include "spin.h"

struct spin_gaussian {
    float place[3]; /* position of the mean in world units */
    /* Natural logarithms of the standard deviations along the axes, in world units. */
    float log_scale[3];
    float rotation[4]; /* quaternion w x y z of unit length */
    float opacity;     /* opacity in 0..1 */
    /* Colour 0.5 + C0 dc, where dc is the SH coefficient of degree 0 and C0 = SPIN_SH_C0. Values
     * outside 0..1 are possible. */
    float colour[3];
};

/* Replaces -infinity, the log scale of a splat with scale 0, by -87.498, which is the log of 1e-38,
 * the least scale that readers return. All other values, including NaN and infinity, are returned
 * unchanged. */
static inline float spin_finite_log_scale(float log_scale)
{
    return log_scale == -INFINITY ? -87.498f : log_scale;
}

/* The logits of opacity 1 and 0, +infinity and -infinity, are replaced by 30 and -30. The sigmoid
 * of 30 differs from 1 by less than 1e-13, so it rounds to 1 as a float. */
#define SPIN_LOGIT_LIMIT 30.0f

static inline float spin_finite_logit(float logit)
{
    return isinf(logit) ? copysignf(SPIN_LOGIT_LIMIT, logit) : logit;
}

/* These functions return the logit of an opacity, which is in 0..1 for the first function, and in
 * 0..255 for the second. The logit is always finite. */
float spin_opacity_logit(float opacity);
float spin_byte_logit(unsigned char opacity);

/* Rounds x to the nearest integer and clamps it to 0..255. The code does not call roundf(), which
 * is not inlined in the base SIMD path. */
static inline unsigned char spin_byte_of(float x)
{
    x = x > 0 ? x : 0;
    return (unsigned char)((x < 255 ? x : 255) + 0.5f);
}

/* Normalises a quaternion, and negates it if w is negative. If its length is 1 up to rounding, the
 * components keep their exact values, except for their signs. A quaternion of length zero becomes
 * NaN. */
void spin_unit_rotation(const float q[4], float out[4]);

/* Returns the index of the quaternion's component with the largest absolute value, which compact
 * formats omit. */
int spin_largest_of_4(const float q[4]);

/* Returns the number of f_rest_* coefficients for an SH degree: all coefficients above degree 0, in
 * three channels. */
static inline size_t spin_n_rest(int sh_degree)
{
    return 3 * (size_t)((sh_degree + 1) * (sh_degree + 1)) - 3;
}

/* Converts n 4-byte words between native byte order and little endian; does nothing on
 * little-endian machines. */
void spin_little_endian(void *words, size_t n);
/* Reads a little-endian 4-byte word at any alignment. */
static inline uint32_t spin_u32_at(const unsigned char *at)
{
    return at[0] | (uint32_t)at[1] << 8 | (uint32_t)at[2] << 16 | (uint32_t)at[3] << 24;
}

/* A similarity transform: a rotation, then a scale, then a shift. */
struct spin_placement {
    double q[4]; /* rotation: quaternion w x y z of unit length */
    double scale, shift[3];
};

/* Applies the transform to all rows of `from` and writes them to `out`, from row `first` on. The
 * columns of `out` must be reserved, with an SH degree of at least that of `from`; coefficients
 * above the degree of `from` become 0. Half turns about the x, y or z axis cause no rounding
 * errors. */
void spin_splats_place(const struct spin_splats *from, unsigned columns,
                       const struct spin_placement *placement, size_t first,
                       struct spin_splats *out);

/* Drops all rows that contain NaN or infinity in one of the `columns`, and sets *n_dropped to their
 * number. If more than one row in 1,000 is affected, drops none and sets *n_dropped to 0, so that a
 * later check refuses the file. */
void spin_drop_nonfinite(unsigned columns, struct spin_splats *s, size_t *n_dropped);
/* Returns SPIN_E_MALFORMED if any of values [n][width] is NaN or infinite. The message contains
 * `what` and the first row with such a value, but not the path of the file. */
spin_status spin_check_finite(const char *what, const float *values, size_t n, size_t width);
/* Calls spin_check_finite() for rows first to first + n - 1 of the given columns of s. what[5]: the
 * names of all columns in error messages, in the order of enum spin_column. */
spin_status spin_check_columns(const char *const what[5], unsigned columns, size_t first, size_t n,
                               const struct spin_splats *s);
