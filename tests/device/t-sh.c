/* Spherical harmonics: golden colours and gradients of degrees 0 to 3, derivatives by finite
 * differences.
 * K: golden sh raster */
#include "math/project.h"
#include "math/sh.h"
#include "tests/check.h"
#include "tests/tap.h"

static void golden_degree(struct spin_npz *npz, int degree)
{
    struct spin_array info;
    char key[32];
    float *means = check_load_f32(npz, "means", &info),
          *centre = check_load_f32(npz, "campos", NULL);
    float *sh = check_load_f32(npz, "sh", NULL), *v = check_load_f32(npz, "v", NULL);
    size_t n = (size_t)info.shape[0];
    float *colour = calloc(n, 3 * sizeof(float)), *d_sh = calloc(n, 48 * sizeof(float));
    float *d_means = calloc(n, 3 * sizeof(float));
    double *want, tolerance = check_tolerance("sh.npz", "abs", 1e-5);

    for (size_t i = 0; i < n; i++) {
        float distance, g[3];
        spin_vec3 d = spin_view_direction(centre, means + 3 * i, &distance), d_d;
        unsigned clamped = spin_sh_colour(degree, d, sh + 48 * i, colour + 3 * i);
        for (int c = 0; c < 3; c++)
            g[c] = clamped >> c & 1 ? 0 : v[3 * i + (size_t)c];
        d_d = spin_sh_colour_adj(degree, d, sh + 48 * i, g, d_sh + 48 * i);
        spin_view_direction_adj(d, distance, d_d, d_means + 3 * i);
    }
    snprintf(key, sizeof key, "color%d", degree);
    want = check_load(npz, key, NULL);
    check_close(colour, want, 3 * n, tolerance, 0, key);
    free(want);
    snprintf(key, sizeof key, "grad_sh%d", degree);
    want = check_load(npz, key, NULL);
    check_close(d_sh, want, 48 * n, tolerance, 0, key);
    free(want);
    snprintf(key, sizeof key, "grad_means%d", degree);
    want = check_load(npz, key, NULL);
    check_close(d_means, want, 3 * n, tolerance, 0, key);
    free(want);
    free(means);
    free(centre);
    free(sh);
    free(v);
    free(colour);
    free(d_sh);
    free(d_means);
}

/* d basis / d direction, one axis at a time, against central differences. */
static void slopes(void)
{
    const float at[3] = {0.48f, -0.6f, 0.64f};
    double worst = 0;

    for (int k = 0; k < 16; k++) {
        float weight[16] = {0}, got[3];
        spin_vec3 g;
        weight[k] = 1;
        g = spin_sh_slope(3, spin_v3(at[0], at[1], at[2]), weight);
        got[0] = g.x;
        got[1] = g.y;
        got[2] = g.z;
        for (int axis = 0; axis < 3; axis++) {
            float low[3], high[3], a[16], b[16], step = 1e-2f;
            double slope;
            memcpy(low, at, sizeof low);
            memcpy(high, at, sizeof high);
            low[axis] -= step;
            high[axis] += step;
            spin_sh_basis(3, spin_v3(low[0], low[1], low[2]), a);
            spin_sh_basis(3, spin_v3(high[0], high[1], high[2]), b);
            slope = ((double)b[k] - a[k]) / (2 * step);
            worst = larger(worst, fabs(slope - got[axis]));
        }
    }
    near(worst, 0, 1e-3, "slopes of the basis are its differences");
}

TAP_MAIN
{
    const char *file = check_fixture("core/sh.npz");
    struct spin_npz npz;
    char key[32];

    slopes();
    if (!file) {
        skip("golden values", "core/sh.npz is not here");
        return;
    }
    if (spin_npz_open(file, &npz) != SPIN_OK) {
        ok(0, "core/sh.npz opens: %s", spin_last_error());
        return;
    }
    for (int degree = 0; snprintf(key, sizeof key, "color%d", degree), spin_npz_has(&npz, key);
         degree++)
        golden_degree(&npz, degree);
    spin_npz_close(&npz);
}
