/* Adam for one parameter and one step, and the learning rate schedules (docs/method.md 6; Kingma
 * and Ba 2015).
 *
 *     m = .9 m + .1 g;  v = .999 v + .001 g^2
 *     p -= lr/(1-.9^k) m / (sqrt(v)/sqrt(1-.999^k) + 1e-15) */
#pragma once

#include "math/portable.h"

/* The two bias corrections of Adam step k, the same for all parameters. Steps count from 1. */
struct spin_adam_step {
    float rate;     /* lr / (1 - .9^k) */
    float inv_root; /* 1 / sqrt(1 - .999^k) */
};

SPIN_FN struct spin_adam_step spin_adam_step_of(double lr, int64_t step)
{
    struct spin_adam_step s;

    s.rate = (float)(lr / (1.0 - pow(0.9, (double)step)));
    s.inv_root = (float)(1.0 / sqrt(1.0 - pow(0.999, (double)step)));
    return s;
}

SPIN_FN void spin_adam_one(struct spin_adam_step s, float g, float *p, float *m, float *v)
{
    float m_new = 0.9f * *m + 0.1f * g;
    float v_new = 0.999f * *v + 0.001f * g * g;

    *p -= s.rate * m_new / (sqrtf(v_new) * s.inv_root + 1e-15f);
    *m = m_new;
    *v = v_new;
}

/* Applies t steps without a gradient at once. After t such steps from step j to k = j + t, a
 * parameter has m .9^t and v .999^t, and the steps i = j+1..k have moved it by, with
 * r_i = sqrt(1-.999^i),
 *
 *     m / sqrt(v) * sum of lr_i r_i/(1-.9^i) (.9/sqrt(.999))^(i-j)    where sqrt(v) dominates, and
 *     m / 1e-15   * sum of lr_i    /(1-.9^i)  .9^(i-j)                where the 1e-15 does.
 *
 * The sums depend on j and k only. `drift` is the first sum and `tiny` is 1e-15 times the first
 * divided by the second: both limits are exact, with a smooth transition. `decay_m` and `decay_v`
 * are .9^t and .999^t. Equal to t single steps up to rounding, except for gradients of 1e-16 to
 * 1e-14. */
SPIN_FN void spin_adam_skip(float drift, float tiny, float decay_m, float decay_v, float *p,
                            float *m, float *v)
{
    *p -= drift * *m / (sqrtf(*v) + tiny);
    *m *= decay_m;
    *v *= decay_v;
}

/* Learning rate of iteration i = 1..n: linear warm-up for `warmup` iterations, then half a cosine
 * to lr_end. */
SPIN_FN double spin_lr(double lr0, double lr_end, int64_t i, int64_t warmup, int64_t n)
{
    double along;

    if (i <= warmup)
        return lr0 * (double)i / (double)warmup;
    if (i >= n)
        return lr_end;
    along = (double)(i - warmup) / (double)(n - warmup);
    return lr_end + (lr0 - lr_end) * 0.5 * (1.0 + cos(3.14159265358979323846 * along));
}

/* Log-linear from lr0 (at i = 0) to lr_end (from i = n on): positions in the refinement
 * (docs/method.md 2). */
SPIN_FN double spin_lr_exp(double lr0, double lr_end, int64_t i, int64_t n)
{
    double along = n > 0 ? (double)i / (double)n : 1.0;

    along = along < 0.0 ? 0.0 : along > 1.0 ? 1.0 : along;
    return exp(log(lr0) * (1.0 - along) + log(lr_end) * along);
}
