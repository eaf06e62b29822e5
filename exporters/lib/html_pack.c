#include "exporters/lib/html_pack.h"

#include <math.h>
#include <stdlib.h>

#include "base/mem.h"

spin_status spin_html_reserve(struct spin_html_frame *f, size_t n, int n_sh)
{
    if (n > f->room) {
        f->room = 0;
        SPIN_TRY(spin_grow(n, SPIN_HTML_WIDE * sizeof *f->wide, (void **)&f->wide));
        SPIN_TRY(spin_grow(n, (size_t)(SPIN_HTML_NARROW + n_sh), (void **)&f->narrow));
        f->room = n;
    }
    f->n = n;
    return SPIN_OK;
}

void spin_html_free(struct spin_html_frame *f)
{
    free(f->wide);
    free(f->narrow);
    *f = (struct spin_html_frame){0};
}

/* ---- Values ---------------------------------------------------------------------------------- */

static double squash(double x) { return x / (1 + fabs(x)); }

/* low..high to 0..steps, nearest, clamped. */
static unsigned step_of(double x, double low, double high, unsigned steps)
{
    double t = (x - low) / (high - low) * steps;

    return (unsigned)(fmin(fmax(t, 0), steps) + 0.5);
}

void spin_html_take(const struct spin_html_space *space, const struct spin_gaussian *row,
                    const float *sh, int n_sh, struct spin_html_frame *f, size_t i)
{
    int largest = 0;

    for (int c = 1; c < 4; c++)
        if (fabsf(row->rotation[c]) > fabsf(row->rotation[largest]))
            largest = c;
    for (int c = 0; c < 3; c++) {
        double u = squash(((double)row->place[c] - space->centre[c]) / space->size);

        f->wide[(size_t)c * f->n + i] = (uint16_t)(1 + step_of(u, -1, 1, 65534));
        f->wide[(size_t)(3 + c) * f->n + i] =
            (uint16_t)step_of((double)row->colour[c], -0.5, 1.5, 1023);
        f->narrow[(size_t)c * f->n + i] =
            (uint8_t)step_of((double)row->log_scale[c] - log(space->size), -12, 2, 255);
    }
    for (int c = 0, k = 6; c < 4; c++) {
        double v = row->rotation[largest] < 0 ? -row->rotation[c] : row->rotation[c];

        if (c != largest)
            f->wide[(size_t)k++ * f->n + i] =
                (uint16_t)(1 + step_of(v * 1.41421356237309505, -1, 1, 4094));
    }
    f->narrow[3 * f->n + i] = (uint8_t)step_of((double)row->opacity, 0, 1, 255);
    f->narrow[4 * f->n + i] = (uint8_t)largest;
    for (int k = 0; k < n_sh; k++)
        f->narrow[(size_t)(SPIN_HTML_NARROW + k) * f->n + i] =
            (uint8_t)(2 + step_of(squash((double)sh[k]), -126 / 127.0, 126 / 127.0, 252));
}

/* ---- Packing --------------------------------------------------------------------------------- */

/* Whether differences to the key, modulo the size of a value, are smaller in sum than distances to the mean.
 * Values have 16 bits when wide, else 8. */
static inline bool differs_less(const void *x, const void *key, size_t n, bool wide)
{
    const uint16_t *x16 = x, *key16 = key;
    const uint8_t *x8 = x, *key8 = key;
    uint64_t sum = 0, spread = 0, differences = 0;

    for (size_t i = 0; i < n; i++)
        sum += wide ? x16[i] : x8[i];
    for (size_t i = 0; i < n; i++) {
        int mean = (int)(sum / n), value = wide ? x16[i] : x8[i];
        int d = wide ? (int16_t)(uint16_t)(value - key16[i]) : (int8_t)(uint8_t)(value - key8[i]);

        spread += (uint64_t)abs(value - mean);
        differences += (uint64_t)abs(d);
    }
    return 2 * differences < spread;
}

size_t spin_html_packed_size(size_t n, int n_sh)
{
    size_t columns = (size_t)(SPIN_HTML_WIDE + SPIN_HTML_NARROW + n_sh);

    return columns + n * (columns + SPIN_HTML_WIDE);
}

void spin_html_pack(const struct spin_html_frame *f, const struct spin_html_frame *key, int n_sh,
                    uint8_t *out)
{
    size_t n = f->n, narrows = (size_t)(SPIN_HTML_NARROW + n_sh);
    uint8_t *flag = out, *at = out + SPIN_HTML_WIDE + narrows;

    for (size_t c = 0; c < SPIN_HTML_WIDE; c++, at += 2 * n) {
        const uint16_t *x = f->wide + c * n, *base = key ? key->wide + c * n : NULL;

        flag[c] = base && differs_less(x, base, n, true);
        for (size_t i = 0; i < n; i++) {
            uint16_t d = (uint16_t)(x[i] - (flag[c] ? base[i] : 0));

            at[i] = (uint8_t)d;
            at[n + i] = (uint8_t)(d >> 8);
        }
    }
    flag += SPIN_HTML_WIDE;
    for (size_t c = 0; c < narrows; c++, at += n) {
        const uint8_t *x = f->narrow + c * n, *base = key ? key->narrow + c * n : NULL;

        flag[c] = base && differs_less(x, base, n, false);
        for (size_t i = 0; i < n; i++)
            at[i] = (uint8_t)(x[i] - (flag[c] ? base[i] : 0));
    }
}
