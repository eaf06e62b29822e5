/* The contraction of unbounded space to the unit cube (SPIN-4DGS; docs/method.md 3.1).
 *
 * A point p with |p| = r is multiplied by
 *
 *     s(r) = 1            for r <= 1
 *     s(r) = (2 - 1/r)/r  for r > 1
 *
 * Points inside the unit ball thus do not move; outside, radius r becomes 2 - 1/r, so that all
 * points are within radius 2. The result is multiplied by 1/4 and shifted by 1/2 into the unit
 * cube. At r = 1, both branches map to radius 1 with radial derivative 1: the map is continuously
 * differentiable, and the adjoint needs no special case. */
#pragma once

#include "math/portable.h"

/* Clamps x to [0, 1], since a coordinate of 1 + 1e-7, from rounding, would be outside the grid
 * (docs/method.md 3.3). NaN stays NaN. */
SPIN_FN float spin_clamp_unit(float x)
{
    x = x < 0.0f ? 0.0f : x;
    return x > 1.0f ? 1.0f : x;
}

/* One axis of the transform that maps the sphere around the scene, with this centre and radius 1 /
 * inv_radius, to the unit ball. The result is clamped to +-1e18, so that its square stays finite.
 */
SPIN_FN float spin_contract_axis(float p_w, float centre, float inv_radius)
{
    float x = (p_w - centre) * inv_radius;

    x = x < -1e18f ? -1e18f : x;
    return x > 1e18f ? 1e18f : x;
}

SPIN_FN spin_vec3 spin_contract(spin_vec3 p)
{
    float r2 = spin_dot3(p, p), s = 1.0f;

    if (r2 > 1.0f) {
        float inv_r = 1.0f / sqrtf(r2);
        s = (2.0f - inv_r) * inv_r;
    }
    return spin_v3(spin_clamp_unit(0.25f * s * p.x + 0.5f), spin_clamp_unit(0.25f * s * p.y + 0.5f),
                   spin_clamp_unit(0.25f * s * p.z + 0.5f));
}

/* Adjoint of spin_contract(): returns the gradient of p from d_u, the gradient of the result. For u
 * = s(r) p, d_p = s d_u + (s'(r) / r) (p . d_u) p. Outside the unit ball, the second term is
 * computed as (1/r^2 - s) n (n . d_u) with n = p/r, since products of two coordinates could
 * overflow. The factor 1/4 scales the ball of radius 2 to the unit cube. */
SPIN_FN spin_vec3 spin_contract_adj(spin_vec3 p, spin_vec3 d_u)
{
    float r2 = spin_dot3(p, p), s = 1.0f, k = 0.0f, inv_r = 0.0f;

    if (r2 > 1.0f) {
        inv_r = 1.0f / sqrtf(r2);
        s = (2.0f - inv_r) * inv_r;
        k = (inv_r * inv_r - s) * (p.x * inv_r * d_u.x + p.y * inv_r * d_u.y + p.z * inv_r * d_u.z);
    }
    return spin_v3(0.25f * (s * d_u.x + k * inv_r * p.x), 0.25f * (s * d_u.y + k * inv_r * p.y),
                   0.25f * (s * d_u.z + k * inv_r * p.z));
}
