/* Numeric helpers that several folders share: comparison, hashing, and the projection of points. */
#pragma once

#include "spin.h"

/* Comparison functions with which qsort() sorts in ascending order. */
int spin_by_float(const void *a, const void *b);
int spin_by_double(const void *a, const void *b);
int spin_by_int(const void *a, const void *b);

/* Returns how many values are NaN or infinite. Must run at memory bandwidth, since it is called for
 * every value of every frame. */
size_t spin_finite_missing(const float *values, size_t n);

/* Update a 64-bit FNV-1a hash with n more bytes. A new hash begins with the value
 * SPIN_HASH_BEGIN. */
#define SPIN_HASH_BEGIN 0xcbf29ce484222325u
void spin_hash(uint64_t *hash, const void *data, size_t n);

/* Convert a value from sRGB (IEC 61966-2-1) to linear light. Values above 1 are allowed. */
float spin_light_of(float v);

/* Project a point; out[] receives x and y in pixels, then the depth. Returns false if the point is
 * behind the camera. */
bool spin_camera_project(const struct spin_camera *camera, const float point[3], double out[3]);
/* The same, but also returns false if the point is outside the image. */
bool spin_camera_project_visible(const struct spin_camera *camera, const float point[3],
                                 double out[3]);
/* Returns the depth of the camera's near plane, in world units. */
double spin_camera_near(const struct spin_camera *camera);
