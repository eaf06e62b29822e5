/* Numeric helpers that several folders share: comparison, hashing, and the projection of points. */
#pragma once

#include "spin.h"

/* Ascending order, for qsort(). */
int spin_by_float(const void *a, const void *b);
int spin_by_double(const void *a, const void *b);
int spin_by_int(const void *a, const void *b);

/* Number of NaN and infinite values. Runs at memory speed: every value of every frame is
 * checked. */
size_t spin_finite_missing(const float *values, size_t n);

/* Continue a 64-bit FNV-1a hash with more bytes. */
#define SPIN_HASH_BEGIN 0xcbf29ce484222325u
void spin_hash(uint64_t *hash, const void *data, size_t n);

/* sRGB (IEC 61966-2-1) to linear; defined above 1 as well. */
float spin_light_of(float v);

/* Project a point to out = x, y (pixels) and depth; false if the point is behind the camera. */
bool spin_camera_project(const struct spin_camera *camera, const float point[3], double out[3]);
/* spin_camera_project() that also returns false if the point is outside the image. */
bool spin_camera_sees(const struct spin_camera *camera, const float point[3], double out[3]);
/* Depth of the near plane, world units. */
double spin_camera_near(const struct spin_camera *camera);
