/* A 4D splat over time: the path of its mean, and the window in time that scales its opacity, both
 * with their adjoints. */
#pragma once

#include "math/portable.h"

/* Sets out to the position centre + path[0] d + path[1] d^2 + ..., up to d^degree. path:
 * [degree][3]; d: time minus the splat's centre in time. */
SPIN_FN void spin_path_at(const float centre[3], const float *path, int degree, double d,
                          double out[3])
{
    for (int c = 0; c < 3; c++) {
        double sum = 0;

        for (int k = degree - 1; k >= 0; k--)
            sum = (sum + (double)path[3 * k + c]) * d;
        out[c] = (double)centre[c] + sum;
    }
}

/* Adjoint of spin_path_at(). g: gradient of the position, which is also the gradient of `centre`.
 * Sets g_path [degree][3] to the gradient of the path. Returns the gradient of the splat's centre
 * in time. */
SPIN_FN double spin_path_adj(const float *path, int degree, double d, const double g[3],
                             double *g_path)
{
    double power = 1, g_time = 0;

    for (int k = 0; k < degree; k++) {
        for (int c = 0; c < 3; c++) {
            g_time -= (k + 1) * power * (double)path[3 * k + c] * g[c];
            g_path[3 * k + c] = power * d * g[c];
        }
        power *= d;
    }
    return g_time;
}

/* The window in time of a splat. It is 1 from lo to hi. Before lo, it falls towards the minimum
 * `gate` like a Gaussian with standard deviation sigma; after hi, like a Gaussian with standard
 * deviation sigma2. Outside [first, end) it is 0. A Gaussian window has lo = hi, sigma = sigma2 and
 * gate = 0. */
struct spin_window {
    double lo, hi, sigma, sigma2, gate, first, end;
};

SPIN_FN double spin_window_at(const struct spin_window *w, double t)
{
    double x = t < w->lo ? (t - w->lo) / w->sigma : t > w->hi ? (t - w->hi) / w->sigma2 : 0;

    return t >= w->first && t < w->end ? w->gate + (1 - w->gate) * exp(-0.5 * x * x) : 0;
}

/* Gradients of the parameters of struct spin_window, except first and end, which have none. For a
 * Gaussian window, the gradient of the centre is the sum of lo and hi, and that of its standard
 * deviation is the sum of sigma and sigma2. */
struct spin_window_slopes {
    double lo, hi, sigma, sigma2, gate;
};

/* Adjoint of spin_window_at(). g: gradient of the window's value at t. */
SPIN_FN void spin_window_adj(const struct spin_window *w, double t, double g,
                             struct spin_window_slopes *out)
{
    int before = w->lo > t, after = w->hi < t;
    double sigma = before ? w->sigma : w->sigma2;
    double x = before ? (t - w->lo) / sigma : after ? (t - w->hi) / sigma : 0;
    double bell = exp(-0.5 * x * x), seen = t >= w->first && t < w->end ? g : 0;
    double slope = seen * (1 - w->gate) * bell * x / sigma;

    out->lo = before ? slope : 0;
    out->hi = after ? slope : 0;
    out->sigma = before ? slope * x : 0;
    out->sigma2 = after ? slope * x : 0;
    out->gate = seen * (1 - bell);
}

/* ln(e^l (1 - w)) with w = exp(ln_weight), a term of the next two functions; minus infinity if w is
 * 1. */
SPIN_FN float spin_windowed_logit_term(float l, float ln_weight)
{
    return l + logf(-expm1f(ln_weight));
}

/* The logit of w o, where o is the opacity of a splat and w its window in time. l: the logit of o;
 * ln_weight: ln(w), at most 0. Since w o = w e^l / (1 + e^l), the logit of w o is l + ln w - ln(1 +
 * e^l (1 - w)). */
SPIN_FN float spin_windowed_logit(float l, float ln_weight)
{
    float a = spin_windowed_logit_term(l, ln_weight);

    return l + ln_weight - (a > 0 ? a + log1pf(expf(-a)) : log1pf(expf(a)));
}

/* The derivative of spin_windowed_logit() with respect to l: 1 / (1 + e^l (1 - w)). */
SPIN_FN float spin_windowed_logit_adj(float l, float ln_weight)
{
    return 1 / (1 + expf(spin_windowed_logit_term(l, ln_weight)));
}

/* Sets span to the first and last time at which the window is at least `least`. If there is no such
 * time, span[0] > span[1]. */
SPIN_FN void spin_window_span(const struct spin_window *w, double least, double span[2])
{
    double bell = w->gate < 1 ? (least - w->gate) / (1 - w->gate) : least > 1 ? 2 : 0;
    double reach = bell > 0 && bell <= 1 ? sqrt(-2 * log(bell)) : HUGE_VAL;
    double last = nextafter(w->end, -HUGE_VAL);

    span[0] = reach < HUGE_VAL ? w->lo - w->sigma * reach : -HUGE_VAL;
    span[1] = reach < HUGE_VAL ? w->hi + w->sigma2 * reach : HUGE_VAL;
    span[0] = span[0] > w->first ? span[0] : w->first;
    span[1] = span[1] < last ? span[1] : last;
    if (bell > 1) {
        span[0] = HUGE_VAL;
        span[1] = -HUGE_VAL;
    }
}
