/* The network that colours pixels, evaluated for Gaussians. */
#include "importers/lib/pixel_decoder.h"

#include <math.h>
#include <string.h>

#include "base/err.h"
#include "base/mem.h"
#include "importers/lib/gaussian4d.h"
#include "math/sh.h"

/* ---- Loading --------------------------------------------------------------------------------- */

/* A 1x1 convolution without bias. */
static spin_status load_layer(struct spin_torch *torch, const char *key, int n_out, int n_in,
                              struct mlp_linear *out)
{
    const int64_t shape[4] = {n_out, n_in, 1, 1};

    SPIN_TRY(spin_mlp_floats(torch, torch->root, "", key, 4, shape, NULL, &out->weight));
    out->n_in = n_in;
    out->n_out = n_out;
    return spin_alloc((size_t)n_out, sizeof *out->bias, (void **)&out->bias);
}

spin_status spin_pixel_decoder_load(const char *path, struct pixel_decoder *out)
{
    struct spin_torch torch;
    spin_status status;

    memset(&torch, 0, sizeof torch);
    SPIN_TRY_OUT(spin_torch_open(path, &torch));
    if (!torch.root || torch.root->kind != SPIN_VALUE_DICT)
        SPIN_TRY_OUT(spin_fail(SPIN_E_MALFORMED, "what was saved is not a state dict"));
    SPIN_TRY_OUT(load_layer(&torch, "mlp1.weight", PIXEL_HIDDEN, PIXEL_INPUTS, &out->hidden));
    SPIN_TRY_OUT(load_layer(&torch, "mlp2.weight", 3, PIXEL_HIDDEN, &out->rgb));
    if (torch.root->n != 2)
        SPIN_TRY_OUT(spin_fail(SPIN_E_UNSUPPORTED,
                               "%zu tensors, expected mlp1.weight and mlp2.weight alone",
                               torch.root->n));
out:
    spin_torch_close(&torch);
    return spin_fail_reading(status, path);
}

void spin_pixel_decoder_free(struct pixel_decoder *d)
{
    spin_mlp_free(&d->hidden);
    spin_mlp_free(&d->rgb);
}

/* ---- Colours --------------------------------------------------------------------------------- */

static double end_colour(const struct pixel_decoder *d, double x)
{
    if (d->ending == PIXEL_SIGMOID)
        return spin_sigmoid_of(x);
    return d->ending == PIXEL_CLAMP ? fmin(fmax(x, 0), 1) : x;
}

float spin_pixel_dc(double colour) { return (float)((colour - 0.5) / SPIN_SH_C0); }

float spin_pixel_base_dc(const struct pixel_decoder *d, float base)
{
    return spin_pixel_dc(end_colour(d, base));
}

/* Of one point over the cameras: means of ray directions d, of colours c, and of their products. */
struct means {
    double d[3], c[3], dd[3][3], dc[3][3];
};

/* a x = b for three columns at once; a is symmetric and positive definite. b becomes x. */
static void solve3(double a[3][3], double b[3][3])
{
    for (int k = 0; k < 3; k++) {
        for (int i = k + 1; i < 3; i++) {
            double f = a[i][k] / a[k][k];

            for (int j = 0; j < 3; j++) {
                a[i][j] -= f * a[k][j];
                b[i][j] -= f * b[k][j];
            }
        }
    }
    for (int k = 2; k >= 0; k--) {
        for (int j = 0; j < 3; j++) {
            for (int i = k + 1; i < 3; i++)
                b[k][j] -= a[k][i] * b[i][j];
            b[k][j] /= a[k][k];
        }
    }
}

/* SH of degree 1 by least squares: colour = mean colour + slope (d - mean d), with two things besides the
 * cameras' colours. Without its slope, which is how some viewers show it, the colour is to be the mean one:
 * (slope mean d)^2 counts as much as the cameras do. And slopes are small along which rays differ by less
 * than about `least` (radians), as they would be noise there. */
static void fit(const struct means *m, float sh[12])
{
    const double least = 1e-2;
    double a[3][3], slope[3][3];

    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            a[i][j] = m->dd[i][j]; /* less d d^T, which the first of the two adds again */
            slope[i][j] = m->dc[i][j] - m->d[i] * m->c[j];
        }
        a[i][i] += least * least;
    }
    solve3(a, slope);
    for (int c = 0; c < 3; c++) {
        double x = slope[0][c], y = slope[1][c], z = slope[2][c];

        sh[c] = spin_pixel_dc(m->c[c] - x * m->d[0] - y * m->d[1] - z * m->d[2]);
        sh[3 + c] = (float)(-y / SPIN_SH_C1);
        sh[6 + c] = (float)(z / SPIN_SH_C1);
        sh[9 + c] = (float)(-x / SPIN_SH_C1);
    }
}

/* Inputs 6 to 11 of a point: the ray from a camera, its origin and its direction. */
static void set_ray(const float camera[3], const double place[3], float *in)
{
    double d[3], norm;

    for (int c = 0; c < 3; c++)
        d[c] = place[c] - camera[c];
    norm = sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
    for (int c = 0; c < 3; c++) {
        in[(6 + c) * MLP_BLOCK] = camera[c];
        in[(9 + c) * MLP_BLOCK] = (float)(norm > 0 ? d[c] / norm : 0);
    }
}

/* One camera of `n_cameras`: the point's inputs and outputs, of a block. */
static void add_camera(const struct pixel_decoder *d, const struct pixel_splat *splat,
                       const float *in, const float *rgb, struct means *m)
{
    double weight = 1.0 / d->cameras.n, ray[3], colour[3];

    for (int i = 0; i < 3; i++) {
        ray[i] = in[(9 + i) * MLP_BLOCK];
        colour[i] = end_colour(d, splat->base[i] + (double)rgb[i * MLP_BLOCK]);
    }
    for (int i = 0; i < 3; i++) {
        m->d[i] += weight * ray[i];
        m->c[i] += weight * colour[i];
        for (int j = 0; j < 3; j++) {
            m->dd[i][j] += weight * ray[i] * ray[j];
            m->dc[i][j] += weight * ray[i] * colour[j];
        }
    }
}

void spin_pixel_decoder_sh(const struct pixel_decoder *d, const struct pixel_splat *splat, int n,
                           float *scratch, float *sh)
{
    float *in = scratch, *hidden = in + PIXEL_INPUTS * MLP_BLOCK;
    float *rgb = hidden + PIXEL_HIDDEN * MLP_BLOCK;
    struct means means[MLP_BLOCK];

    memset(means, 0, sizeof means);
    for (int p = 0; p < MLP_BLOCK; p++) {
        for (int i = 0; i < 3; i++) {
            in[i * MLP_BLOCK + p] = splat[p].view[i];
            in[(3 + i) * MLP_BLOCK + p] = splat[p].time[i];
        }
    }
    for (int camera = 0; camera < d->cameras.n; camera++) {
        for (int p = 0; p < MLP_BLOCK; p++)
            set_ray(d->cameras.place[camera], splat[p].place, in + p);
        spin_mlp_linear(&d->hidden, in, hidden, true);
        spin_mlp_linear(&d->rgb, hidden, rgb, false);
        for (int p = 0; p < n; p++)
            add_camera(d, &splat[p], in + p, rgb + p, &means[p]);
    }
    for (int p = 0; p < n; p++)
        fit(&means[p], sh + 12 * p);
}
