/* Lossless WebP images in memory, by the system's libwebp, a dependency of OpenImageIO. The library
 * is loaded when first needed, so that only reading and writing SOG files requires it. The
 * environment variable SPIN_WEBP can replace the path libwebp.so.7. OpenImageIO itself cannot be
 * used: it changes the colours of transparent pixels, in which SOG stores data. */
#pragma once

#include "spin.h"

#define SPIN_WEBP_MAX_SIDE 16383 /* maximum width and height in pixels, a limit of the format */

/* SPIN_E_UNSUPPORTED if the library is missing. */
spin_status spin_webp_need(void);
/* Encode an image [height][width][4] losslessly, including the colours of transparent pixels.
 * effort: 0 (fast) to 9 (small). *out is allocated with malloc. The result is decoded for
 * verification; SPIN_E_IO if the pixels differ. */
spin_status spin_webp_write(const uint8_t *rgba, int width, int height, int effort,
                            unsigned char **out, size_t *n_out);
/* Read the size of an image; SPIN_E_MALFORMED if the data are not a WebP image. */
spin_status spin_webp_size(const void *data, size_t size, int *width, int *height);
/* Read the size of a lossless still image from a whole file. The file must contain one VP8L chunk;
 * it may also contain a VP8X chunk with the same size, and chunks without pixels. Errors state what
 * is wrong. This function does not need the library. */
spin_status spin_webp_lossless(const void *data, size_t size, int *width, int *height);
/* Decode an image into rgba [height][width][4]. width and height must be those that
 * spin_webp_size() or spin_webp_lossless() returned for this image. */
spin_status spin_webp_read(const void *data, size_t size, int width, int height, uint8_t *rgba);
