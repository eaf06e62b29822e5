/* Numbers that several rooms need in one way: their order, what bytes are told by, where a camera
 * sees a point. */
#pragma once

#include "spin.h"

/* Rising, for qsort(). */
int spin_by_float(const void *a, const void *b);
int spin_by_double(const void *a, const void *b);
int spin_by_int(const void *a, const void *b);

/* How many of some values are NaN or infinite, at the speed of memory: every value of every frame
 * is looked at. */
size_t spin_finite_missing(const float *values, size_t n);

/* FNV-1a, 64 bits, of more bytes. */
#define SPIN_HASH_BEGIN 0xcbf29ce484222325u
void spin_hash(uint64_t *hash, const void *data, size_t n);

/* The curve of sRGB (IEC 61966-2-1), undone; it goes on above 1. */
float spin_light_of(float v);

/* Pixel and depth of a point; false when it does not lie in front. */
bool spin_camera_project(const struct spin_camera *camera, const float point[3], double out[3]);
/* The same; false also when the point lies beside the picture. */
bool spin_camera_sees(const struct spin_camera *camera, const float point[3], double out[3]);
/* The depth of its near plane, world units. */
double spin_camera_near(const struct spin_camera *camera);
