/* Images that are rendered from a bundle when they are read, instead of being decoded from a file.
 * Their path is the path of the bundle, followed by "#draw=" and a description of the view. The
 * functions of io/image.h read them like other images. */
#pragma once

#include "spin.h"

#define SPIN_DRAWN_MARK "#draw="

/* Renders the image over the background (NULL: black) to interleaved 8-bit RGB [h][w][3], allocated
 * with malloc. If rgb is NULL, only the size is set. */
typedef spin_status (*spin_draw_image_fn)(const char *path, const float background[3], int *width,
                                          int *height, uint8_t **rgb);
/* Sets the function that renders all such images. While it is NULL, they cannot be read. */
void spin_drawn_images_set(spin_draw_image_fn draw);

bool spin_image_is_drawn(const char *path);
spin_status spin_drawn_image_read(const char *path, const float background[3], int *width,
                                  int *height, uint8_t **rgb);
/* Sets the size of the image, and a digest that is computed from the path of the image and the size
 * of the bundle file. Fails if the bundle does not exist. */
struct spin_digest;
spin_status spin_drawn_image_check(const char *path, int *width, int *height,
                                   struct spin_digest *digest);
