#include "base/number.h"

#include <math.h>
#include <string.h>

#define BY(name, type)                                                                             \
    int name(const void *a, const void *b)                                                         \
    {                                                                                              \
        type x = *(const type *)a, y = *(const type *)b;                                           \
                                                                                                   \
        return (x > y) - (x < y);                                                                  \
    }

BY(spin_by_float, float)
BY(spin_by_double, double)
BY(spin_by_int, int)

void spin_hash(uint64_t *hash, const void *data, size_t n)
{
    const unsigned char *byte = data;

    for (size_t i = 0; i < n; i++)
        *hash = (*hash ^ byte[i]) * 0x100000001b3u;
}

float spin_light_of(float v)
{
    return v <= 0.04045f ? v / 12.92f : powf((v + 0.055f) / 1.055f, 2.4f);
}

bool spin_camera_project(const struct spin_camera *camera, const float point[3], double out[3])
{
    for (int i = 0; i < 3; i++) {
        const double *row = camera->w2c + 4 * i;

        out[i] = row[0] * (double)point[0] + row[1] * (double)point[1] + row[2] * (double)point[2] +
                 row[3];
    }
    if (!(out[2] > 0))
        return false;
    out[0] = camera->fx * out[0] / out[2] + camera->cx;
    out[1] = camera->fy * out[1] / out[2] + camera->cy;
    return true;
}

bool spin_camera_project_visible(const struct spin_camera *camera, const float point[3],
                                 double out[3])
{
    return spin_camera_project(camera, point, out) && out[0] >= 0 && out[1] >= 0 &&
           out[0] < camera->width && out[1] < camera->height;
}

double spin_camera_near(const struct spin_camera *camera)
{
    return camera->z_near > 0 ? camera->z_near : SPIN_NEAR;
}

/* NaN and infinities are the values whose exponent bits are all ones. The 32-bit partial sums allow
 * vectorisation. */
size_t spin_finite_missing(const float *values, size_t n)
{
    const uint32_t exponent = 0x7f800000u;
    size_t bad = 0;

    for (size_t first = 0; first < n; first += 4096) {
        size_t end = first + 4096 < n ? first + 4096 : n;
        uint32_t part = 0;

        for (size_t i = first; i < end; i++) {
            uint32_t bits;

            memcpy(&bits, &values[i], sizeof bits);
            part += (bits & exponent) == exponent;
        }
        bad += part;
    }
    return bad;
}
