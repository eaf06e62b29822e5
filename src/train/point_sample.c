/* Collects a sample of points, and computes medians and percentiles of it. */
#include "train/point_sample.h"

#include "base/base.h"

enum { SAMPLE = 20000 }; /* largest number of points sampled in a frame */

spin_status spin_point_sample_open(struct spin_point_sample *sample, int n_frames)
{
    SPIN_TRY(
        spin_alloc((size_t)SAMPLE * (size_t)n_frames * 4, sizeof(float), (void **)&sample->point));
    sample->n = 0;
    return SPIN_OK;
}

void spin_point_sample_close(struct spin_point_sample *sample) { free(sample->point); }

void spin_point_sample_add(struct spin_point_sample *sample, const struct spin_splats *s)
{
    size_t step = s->n / SAMPLE + 1;

    for (size_t i = 0; i < s->n; i += step)
        memcpy(sample->point + 3 * sample->n++, s->means + 3 * i, 3 * sizeof(float));
}

double spin_point_square_to(const float *point, const float centre[3])
{
    double d2 = 0;

    for (int c = 0; c < 3; c++)
        d2 += pow((double)(point[c] - centre[c]), 2);
    return d2;
}

float spin_point_sample_enclose(struct spin_point_sample *sample, float centre[3])
{
    size_t n = sample->n;
    float *value = sample->point + 3 * n;

    for (int c = 0; c < 3; c++) {
        for (size_t i = 0; i < n; i++)
            value[i] = sample->point[3 * i + (size_t)c];
        qsort(value, n, sizeof *value, spin_by_float);
        centre[c] = value[n / 2];
    }
    for (size_t i = 0; i < n; i++)
        value[i] = (float)sqrt(spin_point_square_to(sample->point + 3 * i, centre));
    qsort(value, n, sizeof *value, spin_by_float);
    return value[(size_t)(0.9 * (double)(n - 1))];
}
