/* Least-squares fits of a gain and an offset per camera and channel. */
#include "eval/colour_fit.h"

#include <math.h>

#include "math/loss.h"

void spin_colour_sums(int camera, size_t plane, const float *image, const float *truth,
                      struct spin_colour_sums *out)
{
    *out = (struct spin_colour_sums){.camera = camera, .n = (double)plane};
    for (size_t c = 0; c < 3; c++)
        for (size_t i = c * plane; i < (c + 1) * plane; i++) {
            double x = fmin(fmax((double)image[i], 0), 1), y = (double)truth[i];

            out->of[c].x += x;
            out->of[c].y += y;
            out->of[c].xx += x * x;
            out->of[c].xy += x * y;
            out->of[c].yy += y * y;
        }
}

/* Fits ground truth = gain * rendered image + offset in channel c over all views of a camera. The
 * gain is 0 if all pixels of the rendered images have the same value. */
static void fit_channel(const struct spin_colour_sums *view, size_t n_views, int camera, int c,
                        double *gain, double *offset)
{
    double n = 0, x = 0, y = 0, xx = 0, xy = 0, spread;

    for (size_t i = 0; i < n_views; i++)
        if (view[i].camera == camera) {
            n += view[i].n;
            x += view[i].of[c].x;
            y += view[i].of[c].y;
            xx += view[i].of[c].xx;
            xy += view[i].of[c].xy;
        }
    spread = xx - x * x / n;
    *gain = spread > 1e-9 * n ? (xy - x * y / n) / spread : 0;
    *offset = (y - *gain * x) / n;
}

static void fit_camera(const struct spin_colour_sums *view, size_t n_views, int camera,
                       double *psnr)
{
    double a[3], b[3];

    for (int c = 0; c < 3; c++)
        fit_channel(view, n_views, camera, c, &a[c], &b[c]);
    for (size_t i = 0; i < n_views; i++) {
        const struct spin_colour_sums *v = &view[i];
        double squares = 0;

        if (v->camera != camera)
            continue;
        for (int c = 0; c < 3; c++)
            squares += a[c] * a[c] * v->of[c].xx + v->n * b[c] * b[c] + v->of[c].yy +
                       2 * (a[c] * b[c] * v->of[c].x - a[c] * v->of[c].xy - b[c] * v->of[c].y);
        psnr[i] = spin_psnr(fmax(squares, 0) / (3 * v->n));
    }
}

void spin_colour_fit(const struct spin_colour_sums *view, size_t n_views, double *psnr)
{
    for (size_t i = 0; i < n_views; i++) {
        bool done = false;

        for (size_t k = 0; k < i && !done; k++)
            done = view[k].camera == view[i].camera;
        if (!done)
            fit_camera(view, n_views, view[i].camera, psnr);
    }
}
