/* Blending of one Gaussian at one pixel: the blending step, applied front to back, and its adjoint,
 * applied back to front (docs/method.md 4.2, 4.3). Exponents are to the base 2 and include the
 * opacity: alpha = exp2(-log2(e)/2 (a dx^2 + 2 b dx dy + c dy^2) + log2(opacity)), where (a, b, c)
 * is the conic (the inverse of the 2-D covariance) and (dx, dy) the offset of the pixel from the
 * mean, in pixels. */
#pragma once

#include "math/approx.h"
#include "math/portable.h"

/* Constants of the 3DGS rasteriser: limits of alpha, and the transmittance at which blending stops.
 * Other values would change the images. */
#define SPIN_ALPHA_MAX 0.99f
#define SPIN_ALPHA_MIN_LOG2 -7.994353436858858f /* log2(1/255) */
#define SPIN_T_MIN 1e-4f

#define SPIN_LOG2_E 1.4426950408889634f

/* log2 of a positive, normal float: the exponent plus a series in (m - 1)/(m + 1) for mantissa m.
 * The series has an absolute error of 2e-7. */
SPIN_FN float spin_blend_log2(float v)
{
    uint32_t bits = spin_bits_of_float(v);
    int e = (int)(bits - 0x3f3504f3u) >> 23; /* for a mantissa in [sqrt(1/2), sqrt(2)) */
    float m = spin_float_of_bits(bits - ((uint32_t)e << 23)), s = (m - 1) / (m + 1), ss = s * s;

    return (float)e + s * (2.885390082f + ss * (0.961796694f + ss * (0.577078016f + ss * 0.44f)));
}

/* A projected Gaussian, prepared for blending: mean in pixels, coefficients a, b, c of dx^2, dx dy
 * and dy^2 in the exponent, and log2 of the opacity. For the conic (A, B, C) the coefficients are
 * (A, 2 B, C) times -log2(e)/2. */
struct spin_blend_splat {
    float u_px, v_px, a, b, c, log2_opacity;
    float colour[3];
};

/* Sets *reach_x and *reach_y to the half extents in pixels, rounded up, of the region in which
 * alpha can be 1/255 or more. They are 1e30 if the ellipse is too thin for the precision of float,
 * and -1 if the region is empty. a, b, c: as in struct spin_blend_splat. With det = a c - b^2 / 4,
 * the half extent in x of the ellipse with a dx^2 + b dx dy + c dy^2 = -L is sqrt(-L c / det), and
 * in y sqrt(-L a / det). Margins are added for rounding errors of the exponent, whose terms can be
 * a c / det times larger than their sum. */
SPIN_FN void spin_blend_reach(float a, float b, float c, float log2_opacity, float *reach_x,
                              float *reach_y)
{
    float level = log2_opacity - SPIN_ALPHA_MIN_LOG2 + 1e-4f;
    float ac = a * c, det = ac - 0.25f * b * b;
    float cancel = ac / det;
    float by = level * (1 + 2e-6f * cancel) / det;
    int usable = det > 0 && cancel < 1e4f;

    *reach_x = !(level > 0) ? -1 : usable ? sqrtf(-c * by) * 1.0005f + 0.01f : 1e30f;
    *reach_y = !(level > 0) ? -1 : usable ? sqrtf(-a * by) * 1.0005f + 0.01f : 1e30f;
}

/* Converts a conic in place to the coefficients a, b, c of struct spin_blend_splat. The opacity
 * must be at most 1. Returns log2 of the opacity. For an opacity of 0, a denormal or NaN, the
 * result is so low that the Gaussian is not drawn. */
SPIN_FN float spin_blend_scale(float *a, float *b, float *c, float opacity)
{
    float log2_opacity = spin_blend_log2(spin_maxf(opacity, 1e-30f));

    *a *= -0.5f * SPIN_LOG2_E;
    *b *= -SPIN_LOG2_E;
    *c *= -0.5f * SPIN_LOG2_E;
    return spin_minf(log2_opacity, 100);
}

SPIN_FN struct spin_blend_splat spin_blend_prepare(float u_px, float v_px, const float *conic,
                                                   float opacity, const float *colour)
{
    struct spin_blend_splat s = {
        u_px, v_px, conic[0], conic[1], conic[2], 0, {colour[0], colour[1], colour[2]}};

    s.log2_opacity = spin_blend_scale(&s.a, &s.b, &s.c, opacity);
    return s;
}

/* The exponent without log2 of the opacity. Rounding can make the result positive;
 * spin_blend_counts() then rejects the Gaussian. */
SPIN_FN float spin_blend_power(const struct spin_blend_splat *s, float dx, float dy)
{
    return s->a * dx * dx + s->b * dx * dy + s->c * dy * dy;
}

/* Returns 1 if alpha is at least 1/255, the least alpha that is blended. */
SPIN_FN int spin_blend_counts(float power, float log2_opacity)
{
    return power <= 0 && power + log2_opacity >= SPIN_ALPHA_MIN_LOG2;
}

struct spin_blend_pixel {
    float t, colour[3]; /* transmittance and colour of the Gaussians blended so far */
    int stopped;        /* 1: the next Gaussian would lower t below SPIN_T_MIN */
};

/* Blends the next Gaussian, front to back. Returns 1 if the Gaussian contributes to the pixel. */
SPIN_FN int spin_blend_step(const struct spin_blend_splat *s, float dx, float dy,
                            struct spin_blend_pixel *pixel)
{
    float power = spin_blend_power(s, dx, dy), alpha, t;

    if (pixel->stopped || !spin_blend_counts(power, s->log2_opacity))
        return 0;
    alpha = spin_minf(spin_exp2_within(power + s->log2_opacity), SPIN_ALPHA_MAX);
    t = pixel->t - alpha * pixel->t;
    if (t < SPIN_T_MIN) {
        pixel->stopped = 1;
        return 0;
    }
    for (int c = 0; c < 3; c++)
        pixel->colour[c] += alpha * pixel->t * s->colour[c];
    pixel->t = t;
    return 1;
}

/* Blends depths instead of colours: s->colour must be (depth, 1, 0). The three elements of
 * pixel->colour are then the weighted sum of depths, the sum of weights, and the median depth: the
 * depth of the Gaussian at which the transmittance falls to one half, or 0 if the transmittance
 * stays above one half. */
SPIN_FN void spin_blend_depth(const struct spin_blend_splat *s, float dx, float dy,
                              struct spin_blend_pixel *pixel)
{
    float before = pixel->t;

    if (spin_blend_step(s, dx, dy, pixel) && before > 0.5f && pixel->t <= 0.5f)
        pixel->colour[2] = s->colour[0];
}

/* The expected depth after spin_blend_depth(): the weighted mean of depths; 0 if nothing is
 * visible. */
SPIN_FN float spin_blend_expected(const struct spin_blend_pixel *pixel)
{
    return pixel->colour[1] > 0 ? pixel->colour[0] / pixel->colour[1] : 0;
}

/* Sums over the pixels of a Gaussian, from which the gradient of the Gaussian is computed. colour:
 * the sum of weight times g, the gradient of the pixel. e, ex, ...: the sums of de, de dx, de dy,
 * de dx^2, de dx dy and de dy^2, where de is the gradient of the exponent to the base e. */
struct spin_blend_sums {
    float colour[3], e, ex, ey, exx, exy, eyy;
    float absolute_u, absolute_v; /* sums of |de (2 a dx + b dy)| and of |de (2 c dy + b dx)| */
};

struct spin_blend_pixel_adj {
    float t;    /* transmittance behind the current Gaussian */
    float s;    /* sum of weight (colour . g) over the Gaussians behind and the background */
    float g[3]; /* gradient of the pixel */
};

/* Adjoint of one blending step, back to front, of a Gaussian that contributes to the pixel. power:
 * from spin_blend_power(). Sets *weight to the Gaussian's weight in the pixel (alpha times
 * transmittance) and *de to the gradient of its exponent, and updates *pixel for the next Gaussian
 * in front. As in 3DGS, the gradient is not set to 0 where alpha is clamped to 0.99. */
SPIN_FN void spin_blend_pixel_adj(const struct spin_blend_splat *s, float power,
                                  struct spin_blend_pixel_adj *pixel, float *weight, float *de)
{
    float raw = spin_exp2_within(power + s->log2_opacity);
    float alpha = spin_minf(raw, SPIN_ALPHA_MAX), back = spin_reciprocal(1 - alpha);
    float t = pixel->t * back, w = alpha * t;
    float cg = s->colour[0] * pixel->g[0] + s->colour[1] * pixel->g[1] + s->colour[2] * pixel->g[2];

    *de = raw * (t * cg - pixel->s * back);
    *weight = w;
    pixel->t = t;
    pixel->s += w * cg;
}

/* Adds the terms of one pixel to the sums of a Gaussian. */
SPIN_FN void spin_blend_add_adj(const float g[3], float weight, float de, float dx, float dy,
                                struct spin_blend_sums *sums)
{
    for (int c = 0; c < 3; c++)
        sums->colour[c] += weight * g[c];
    sums->e += de;
    sums->ex += de * dx;
    sums->ey += de * dy;
    sums->exx += de * dx * dx;
    sums->exy += de * dx * dy;
    sums->eyy += de * dy * dy;
}

/* Adds the terms of one pixel to absolute_u and absolute_v. */
SPIN_FN void spin_blend_add_absolute(const struct spin_blend_splat *s, float de, float dx, float dy,
                                     struct spin_blend_sums *sums)
{
    sums->absolute_u += fabsf(de * (2 * s->a * dx + s->b * dy));
    sums->absolute_v += fabsf(de * (2 * s->c * dy + s->b * dx));
}

SPIN_FN void spin_blend_step_adj(const struct spin_blend_splat *s, float dx, float dy,
                                 struct spin_blend_pixel_adj *pixel, struct spin_blend_sums *sums)
{
    float weight, de;

    spin_blend_pixel_adj(s, spin_blend_power(s, dx, dy), pixel, &weight, &de);
    spin_blend_add_adj(pixel->g, weight, de, dx, dy, sums);
    spin_blend_add_absolute(s, de, dx, dy, sums);
}

/* Computes the gradients of u, v, the conic and the opacity from the sums. */
SPIN_FN void spin_blend_finish_adj(const float *conic, float opacity,
                                   const struct spin_blend_sums *sums, float *d_u, float *d_v,
                                   float *d_conic, float *d_opacity)
{
    *d_u = -conic[0] * sums->ex - conic[1] * sums->ey;
    *d_v = -conic[2] * sums->ey - conic[1] * sums->ex;
    d_conic[0] = -0.5f * sums->exx;
    d_conic[1] = -sums->exy;
    d_conic[2] = -0.5f * sums->eyy;
    *d_opacity = opacity > 0 ? sums->e / opacity : 0;
}

/* Computes the absolute gradients of u and v from the sums. a, b and c of struct spin_blend_splat
 * are in units of the logarithm to the base 2. */
SPIN_FN void spin_blend_finish_absolute(const struct spin_blend_sums *sums, float *u, float *v)
{
    *u = sums->absolute_u / SPIN_LOG2_E;
    *v = sums->absolute_v / SPIN_LOG2_E;
}
