/* One splat as splat files hold it, and what their readers and writers share. */
#pragma once

#include <math.h>

#include "spin.h"

struct spin_gaussian {
    float place[3];     /* world units */
    float log_scale[3]; /* natural logarithm of the standard deviation */
    float rotation[4];  /* w x y z, unit length */
    float opacity;      /* 0..1 */
    float colour[3];    /* of the degree 0 term: 0.5 + C0 dc; seen from 0 to 1 */
};

/* In place of an infinite logit: the sigmoid of 30 is within 1e-13 of 1, and rounds to 1 as a
 * float. */
#define SPIN_LOGIT_LIMIT 30.0f

static inline float spin_finite_logit(float logit)
{
    return isinf(logit) ? copysignf(SPIN_LOGIT_LIMIT, logit) : logit;
}

/* The logit of an opacity 0..1, and of one in 255 steps; finite. */
float spin_opacity_logit(float opacity);
float spin_byte_logit(unsigned char opacity);

/* 0..255, nearest, clamped. A cast rounds, as roundf is a call on the oldest machines. */
static inline unsigned char spin_byte_of(float x)
{
    x = x > 0 ? x : 0;
    return (unsigned char)((x < 255 ? x : 255) + 0.5f);
}

/* Unit length, w >= 0. A quaternion that already is of unit length keeps its bits; one of length
 * zero becomes NaN. */
void spin_unit_rotation(const float q[4], float out[4]);

/* Which component of a unit quaternion has the largest size: the one that formats of few bits leave
 * out. */
int spin_largest_of_4(const float q[4]);

/* Coefficients of f_rest_* (all but degree 0, all channels) of a degree. */
static inline size_t spin_n_rest(int sh_degree)
{
    return 3 * (size_t)((sh_degree + 1) * (sh_degree + 1)) - 3;
}

/* Words of 4 bytes between this machine's order and that of the files. A machine of little endian,
 * as all are that this was built on, has nothing to do. */
void spin_little_endian(void *words, size_t n);
/* A word of 4 bytes anywhere in a file, the lowest byte first. */
static inline uint32_t spin_u32_at(const unsigned char *at)
{
    return at[0] | (uint32_t)at[1] << 8 | (uint32_t)at[2] << 16 | (uint32_t)at[3] << 24;
}

/* Where splats are put in a scene: turned, then scaled, then moved. */
struct spin_placement {
    double q[4]; /* w x y z, unit */
    double scale, shift[3];
};

/* All rows of `from`, so placed, to rows `first` and on of columns that are reserved, with at least
 * their SH degree; coefficients above it become 0. Half turns alone lose no bit. */
void spin_splats_place(const struct spin_splats *from, unsigned columns,
                       const struct spin_placement *placement, size_t first,
                       struct spin_splats *out);

/* SPIN_E_MALFORMED with the first row that holds NaN or infinity among values [n][width]; `what`
 * names them. The message does not name the file. */
spin_status spin_check_finite(const char *what, const float *values, size_t n, size_t width);
/* The same for n rows of columns of s from `first` on; what[5] names them, in the order of enum
 * spin_column. */
spin_status spin_check_columns(const char *const what[5], unsigned columns, size_t first, size_t n,
                               const struct spin_splats *s);
