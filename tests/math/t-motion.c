/* motion: a splat's path and window compared with values computed by hand, and their adjoints with
 * finite differences.
 * K: motion 4d */
#include "math/motion.h"
#include "math/rng.h"
#include "tests/tap.h"

static uint32_t drawn;

static double draw(void) { return 2.0 * (double)spin_rng_u32(11, 0, drawn++) / 4294967295.0 - 1.0; }

static void test_path(void)
{
    const float centre[3] = {1, 2, 3}, path[9] = {1, 0, 0, 0, 2, 0, 0, 0, 3};
    double out[3], worst = 0;

    spin_path_at(centre, path, 3, 2, out);
    ok(out[0] == 3 && out[1] == 10 && out[2] == 27, "a cubic path");
    spin_path_at(centre, path, 1, 2, out);
    ok(out[0] == 3 && out[1] == 2 && out[2] == 3, "its line alone");
    spin_path_at(centre, NULL, 0, 2, out);
    ok(out[0] == 1 && out[1] == 2 && out[2] == 3, "what stands still");
    for (int k = 0; k < 64; k++) {
        float p[9];
        double g[3], g_path[9], g_time, d = 2 * draw(), at[2][3], h = 1e-3;

        for (int i = 0; i < 9; i++)
            p[i] = (float)draw();
        for (int c = 0; c < 3; c++)
            g[c] = draw();
        g_time = spin_path_adj(p, 3, d, g, g_path);
        for (int i = 0; i < 10; i++) {
            double slope = 0;

            for (int s = 0; s < 2; s++) {
                float q[9];

                for (int j = 0; j < 9; j++)
                    q[j] = p[j] + (j == i ? (float)(s ? h : -h) : 0);
                /* if its own time is later, d is smaller */
                spin_path_at(centre, q, 3, i == 9 ? d - (s ? h : -h) : d, at[s]);
            }
            for (int c = 0; c < 3; c++)
                slope += g[c] * (at[1][c] - at[0][c]) / (2 * h);
            worst = larger(worst, fabs(slope - (i == 9 ? g_time : g_path[i])));
        }
    }
    ok(worst < 2e-3, "slopes of a path are those of finite differences, to %.2g", worst);
}

static void test_window(void)
{
    struct spin_window bell = {5, 5, 2, 2, 0, -HUGE_VAL, HUGE_VAL};
    struct spin_window flat = {4, 6, 1, 2, 0, -HUGE_VAL, HUGE_VAL};
    struct spin_window gate = {5, 5, 2, 2, 0.25, -HUGE_VAL, HUGE_VAL};
    struct spin_window hard = {0, 0, 3e38, 3e38, 0, 2, 4};
    double span[2], half = exp(-0.5);

    ok(spin_window_at(&bell, 5) == 1 && fabs(spin_window_at(&bell, 3) - half) < 1e-15 &&
           fabs(spin_window_at(&bell, 7) - half) < 1e-15,
       "a bell is exp(-1/2) a sigma away");
    ok(spin_window_at(&flat, 4.5) == 1 && fabs(spin_window_at(&flat, 3) - half) < 1e-15 &&
           fabs(spin_window_at(&flat, 8) - half) < 1e-15,
       "a plateau has a bell of its own on each side");
    ok(fabs(spin_window_at(&gate, 7) - (0.25 + 0.75 * half)) < 1e-15 &&
           fabs(spin_window_at(&gate, 500) - 0.25) < 1e-15,
       "a gate is a floor");
    ok(spin_window_at(&hard, 2) == 1 && spin_window_at(&hard, 1.999) == 0 &&
           spin_window_at(&hard, 4) == 0 && spin_window_at(&hard, 3.999) == 1,
       "a cut has its beginning and lacks its end");

    spin_window_span(&bell, half, span);
    ok(fabs(span[0] - 3) < 1e-12 && fabs(span[1] - 7) < 1e-12, "where a bell is at least so");
    spin_window_span(&flat, half, span);
    ok(fabs(span[0] - 3) < 1e-12 && fabs(span[1] - 8) < 1e-12, "where a plateau is");
    spin_window_span(&gate, 0.2, span);
    ok(span[0] < -1e300 && span[1] > 1e300, "below a gate it always is");
    spin_window_span(&hard, 0.5, span);
    ok(span[0] == 2 && span[1] < 4 && span[1] > 3.999999, "a cut ends just before its end");
    spin_window_span(&bell, 1.5, span);
    ok(span[0] > span[1], "more than 1 it never is");
    spin_window_span(&bell, 0, span);
    ok(span[0] < -1e300 && span[1] > 1e300, "0 it always is");
}

static void test_window_slopes(void)
{
    double worst = 0, h = 1e-6;

    for (int k = 0; k < 256; k++) {
        double p[5] = {draw(), 0, 1.2 + draw(), 1.2 + draw(), 0.5 + 0.4 * draw()}, t = 4 * draw();
        struct spin_window_slopes s;
        struct spin_window w;

        p[1] = p[0] + 0.5 + 0.4 * draw();
        w = (struct spin_window){p[0], p[1], p[2], p[3], p[4], -3, 3};
        spin_window_adj(&w, t, 0.7, &s);
        for (int i = 0; i < 5; i++) {
            double at[2], got[5] = {s.lo, s.hi, s.sigma, s.sigma2, s.gate};

            for (int side = 0; side < 2; side++) {
                double q[5];

                for (int j = 0; j < 5; j++)
                    q[j] = p[j] + (j == i ? (side ? h : -h) : 0);
                w = (struct spin_window){q[0], q[1], q[2], q[3], q[4], -3, 3};
                at[side] = spin_window_at(&w, t);
            }
            worst = larger(worst, fabs(0.7 * (at[1] - at[0]) / (2 * h) - got[i]));
        }
    }
    ok(worst < 1e-6, "slopes of a window are those of finite differences, to %.2g", worst);
}

/* The visible opacity is the opacity times the window, and the adjoint is its derivative. */
static void test_seen(void)
{
    double worst = 0, worst_slope = 0;

    for (int k = 0; k < 4096; k++) {
        float l = (float)(8 * draw()), ln_w = k % 8 ? (float)(-3 * (1 + draw())) : -1e-4f;
        double o = 1 / (1 + exp(-(double)l)), seen = exp((double)ln_w) * o, h = 0.02;
        double got = 1 / (1 + exp(-(double)spin_windowed_logit(l, ln_w)));
        double up = log(exp((double)ln_w) / (1 + exp(-(l + h)) - exp((double)ln_w)));
        double down = log(exp((double)ln_w) / (1 + exp(-(l - h)) - exp((double)ln_w)));
        double slope = (double)spin_windowed_logit_adj(l, ln_w);

        worst = larger(worst, fabs(got - seen));
        worst_slope = larger(worst_slope, fabs((up - down) / (2 * h) - slope));
    }
    ok(worst < 1e-6, "what a window leaves of an opacity, to %.2g", worst);
    ok(worst_slope < 1e-4, "its slope is that of finite differences, to %.2g", worst_slope);
    ok(spin_windowed_logit(3.25f, -0.0f) == 3.25f && spin_windowed_logit_adj(3.25f, -0.0f) == 1,
       "where all is seen nothing changes");
    ok(spin_windowed_logit_adj(200, -1) == 0 && isfinite(spin_windowed_logit(200, -1)),
       "an opacity of 1 is no trouble");
}

TAP_MAIN
{
    test_seen();
    test_path();
    test_window();
    test_window_slopes();
}
