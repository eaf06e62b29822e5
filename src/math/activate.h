/* Activations of the field's heads, and their adjoints (table in docs/method.md 3.4). h is the raw
 * output of a scale or opacity head, r that of the rotation head. The activation of colour is the
 * identity and needs no function. */
#pragma once

#include "math/approx.h"
#include "math/quat.h"

/* Truncated exponential: above h = 20 the value is constant, so that it stays finite. The gradient
 * is not set to 0 there, so that training can still reduce h. */
SPIN_FN float spin_scale_of(float h) { return spin_exp(h > 20.0f ? 20.0f : h); }
SPIN_FN float spin_scale_adj(float h, float d_scale) { return d_scale * spin_scale_of(h); }

SPIN_FN float spin_opacity_of(float h) { return spin_sigmoid(h); }
SPIN_FN float spin_opacity_adj(float h, float d_opacity)
{
    float o = spin_sigmoid(h);

    return d_opacity * o * (1.0f - o);
}

/* The factor that normalises r: 1 / max(|r|, 1e-12). */
SPIN_FN double spin_rotation_factor(const float r[4])
{
    double norm = spin_quat_norm(r);

    return 1.0 / (norm > 1e-12 ? norm : 1e-12);
}

SPIN_FN void spin_rotation_of(const float r[4], float q[4])
{
    double k = spin_rotation_factor(r);

    for (int i = 0; i < 4; i++)
        q[i] = (float)(r[i] * k);
}

/* d_r = (d_q - q (q.d_q)) / |r|. If |r| < 1e-12, the divisor is the constant 1e-12, whose exact
 * adjoint has no second term; the term is kept, since this only affects outputs r that are zero in
 * practice. */
SPIN_FN void spin_rotation_adj(const float r[4], const float d_q[4], float d_r[4])
{
    double k = spin_rotation_factor(r), dot = 0.0;

    for (int i = 0; i < 4; i++)
        dot += r[i] * k * d_q[i];
    for (int i = 0; i < 4; i++)
        d_r[i] = (float)((d_q[i] - r[i] * k * dot) * k);
}

/* Conversions between logit and opacity, computed in double. spin_logit_of() clamps the opacity to
 * [1e-6, 1 - 1e-6], so that the logit is finite. */
SPIN_FN double spin_sigmoid_of(double logit) { return 1 / (1 + exp(-logit)); }

SPIN_FN float spin_logit_of(double opacity)
{
    double o = opacity < 1e-6 ? 1e-6 : opacity > 1 - 1e-6 ? 1 - 1e-6 : opacity;

    return (float)log(o / (1 - o));
}
