/* Lossless WebP pictures in memory, by the system's libwebp, which comes with OpenImageIO. It is
 * loaded when first needed, as a program that makes no SOG does without. SPIN_WEBP names another
 * file than libwebp.so.7. OpenImageIO itself cannot do this: it changes the colours of what is
 * transparent, and SOG keeps numbers there. */
#pragma once

#include "spin.h"

#define SPIN_WEBP_MAX_SIDE 16383 /* pixels, the format's */

/* SPIN_E_UNSUPPORTED without the library. */
spin_status spin_webp_need(void);
/* The file of a picture [height][width][4] of bytes, all four kept as they are; effort 0 (fast) to
 * 9 (small). *out is allocated with malloc. What was written is read again: SPIN_E_IO when it
 * differs. */
spin_status spin_webp_write(const uint8_t *rgba, int width, int height, int effort,
                            unsigned char **out, size_t *n_out);
/* The size of a picture; SPIN_E_MALFORMED when this is none. */
spin_status spin_webp_size(const void *data, size_t size, int *width, int *height);
/* The same of a whole file that is lossless and nothing else: one chunk VP8L, with perhaps a VP8X
 * of the same size and chunks of no pixels beside it. Says what is wrong; needs no library. */
spin_status spin_webp_lossless(const void *data, size_t size, int *width, int *height);
/* Into [height][width][4] of that size. */
spin_status spin_webp_read(const void *data, size_t size, int width, int height, uint8_t *rgba);
