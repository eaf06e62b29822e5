/* Adam step k = 1, 2, ... of one parameter p with gradient g, first moment m, second moment v and
 * learning rate lr (Kingma and Ba 2015), and the learning rate schedules (docs/method.md 6).
 *
 *     m = .9 m + .1 g;  v = .999 v + .001 g^2
 *     p -= lr/(1-.9^k) m / (sqrt(v)/sqrt(1-.999^k) + 1e-15) */
#pragma once

#include "math/portable.h"

/* The factors of Adam step k, with the bias corrections. All parameters share them. */
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

/* Applies t Adam steps i = j + 1 .. k, with k = j + t, in which the gradient of the parameter is 0.
 * Together these steps multiply m by .9^t and v by .999^t. With the learning rates lr_i and r_i =
 * sqrt(1-.999^i), they subtract from the parameter
 *
 *     m / sqrt(v) * sum of lr_i r_i/(1-.9^i) (.9/sqrt(.999))^(i-j)    if sqrt(v) is far above 1e-15
 *     m / 1e-15   * sum of lr_i    /(1-.9^i)  .9^(i-j)                if sqrt(v) is far below 1e-15
 *
 * Both sums are the same for all parameters, so the caller computes them once. drift: the first
 * sum; tiny: 1e-15 times the first sum divided by the second; decay_m, decay_v: .9^t and .999^t.
 * The formula below is exact in both limits and smooth in between: up to rounding, the result is
 * that of t single steps, except for sqrt(v) from 1e-16 to 1e-14. */
SPIN_FN void spin_adam_skip(float drift, float tiny, float decay_m, float decay_v, float *p,
                            float *m, float *v)
{
    *p -= drift * *m / (sqrtf(*v) + tiny);
    *m *= decay_m;
    *v *= decay_v;
}

/* Learning rate of iteration i = 1..n: rises linearly to lr0 in `warmup` iterations, then falls to
 * lr_end along half a cosine. */
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

/* Learning rate of positions in the refinement (docs/method.md 2): log-linear from lr0 at i = 0 to
 * lr_end at i = n, then constant. */
SPIN_FN double spin_lr_exp(double lr0, double lr_end, int64_t i, int64_t n)
{
    double along = n > 0 ? (double)i / (double)n : 1.0;

    along = along < 0.0 ? 0.0 : along > 1.0 ? 1.0 : along;
    return exp(log(lr0) * (1.0 - along) + log(lr_end) * along);
}
