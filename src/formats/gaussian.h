/* The values of one splat, and helpers shared by the readers and writers of splat files. */
#pragma once

#include <math.h>

#include "spin.h"

struct spin_gaussian {
    float place[3]; /* position of the centre in world units */
    /* Natural logarithm of the standard deviation along each axis, in world units. */
    float log_scale[3];
    float rotation[4]; /* quaternion w x y z of unit length */
    float opacity;     /* opacity in 0..1 */
    /* Colour 0.5 + C0 dc, where dc is the SH coefficient of degree 0; displays can show values from
     * 0 to 1. */
    float colour[3];
};

/* Log scale of a splat without thickness, whose scale is 0: that of the smallest scale that files
 * of plain scales yield. Other values, also those that are not finite, are returned as they are. */
static inline float spin_finite_log_scale(float log_scale)
{
    return log_scale == -INFINITY ? -87.498f : log_scale;
}

/* Finite logits +-30 replace +-infinity, which are the logits of opacity 1 and 0. The sigmoid of 30
 * is within 1e-13 of 1, and rounds to 1 as a float. */
#define SPIN_LOGIT_LIMIT 30.0f

static inline float spin_finite_logit(float logit)
{
    return isinf(logit) ? copysignf(SPIN_LOGIT_LIMIT, logit) : logit;
}

/* Return the logit of an opacity, which is given in 0..1 or, for the second function, in 0..255.
 * The logit is always finite. */
float spin_opacity_logit(float opacity);
float spin_byte_logit(unsigned char opacity);

/* Rounds to the nearest integer, clamped to 0..255. A cast is used since roundf() would be a
 * function call in the base SIMD path. */
static inline unsigned char spin_byte_of(float x)
{
    x = x > 0 ? x : 0;
    return (unsigned char)((x < 255 ? x : 255) + 0.5f);
}

/* Normalises a quaternion and flips its sign if w is negative. A quaternion that already has unit
 * length keeps its bits, except for the sign; a quaternion of length zero becomes NaN. */
void spin_unit_rotation(const float q[4], float out[4]);

/* Returns the index of the quaternion's component with the largest absolute value, which compact
 * formats omit. */
int spin_largest_of_4(const float q[4]);

/* Returns the number of f_rest_* coefficients for an SH degree: those of all degrees above 0, in
 * all three channels. */
static inline size_t spin_n_rest(int sh_degree)
{
    return 3 * (size_t)((sh_degree + 1) * (sh_degree + 1)) - 3;
}

/* Swaps 4-byte words between native order and little endian; does nothing on little-endian
 * machines. */
void spin_little_endian(void *words, size_t n);
/* Reads a little-endian 4-byte word at any alignment. */
static inline uint32_t spin_u32_at(const unsigned char *at)
{
    return at[0] | (uint32_t)at[1] << 8 | (uint32_t)at[2] << 16 | (uint32_t)at[3] << 24;
}

/* A similarity transform: rotates, then scales, then shifts. */
struct spin_placement {
    double q[4]; /* rotation: quaternion w x y z of unit length */
    double scale, shift[3];
};

/* Applies the placement to all rows of `from` and writes them to `out`, from row `first` on. The
 * columns of `out` must be reserved, with an SH degree of at least that of `from`; coefficients
 * above the degree of `from` become 0. Half turns about the x, y or z axis are exact. */
void spin_splats_place(const struct spin_splats *from, unsigned columns,
                       const struct spin_placement *placement, size_t first,
                       struct spin_splats *out);

/* Drops rows with values that are not finite from all `columns`, if these rows are at most one in
 * 1,000; *n_dropped receives their number. Otherwise the columns stay unchanged. */
void spin_drop_nonfinite(unsigned columns, struct spin_splats *s, size_t *n_dropped);
/* Returns SPIN_E_MALFORMED if any of values [n][width] is NaN or infinite. The message contains
 * `what` and the first row with such a value, but not the path of the file. */
spin_status spin_check_finite(const char *what, const float *values, size_t n, size_t width);
/* Checks rows [first, first + n) of the given columns of s, with the same result as
 * spin_check_finite(). what[5]: the names in messages of all columns, in the order of enum
 * spin_column. */
spin_status spin_check_columns(const char *const what[5], unsigned columns, size_t first, size_t n,
                               const struct spin_splats *s);
