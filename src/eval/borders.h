/* Detects whether the borders of images show one flat colour, as in renders and masked images of a
 * subject, or a scene that fills the images. */
#pragma once

#include "scene/clip.h"

/* Sets colour to the most frequent colour, 0..1, of the border pixels of the images, and *flat to
 * true if at least half of the border pixels have this colour, up to noise. Decodes at most 24 of
 * the n views in `pairs`, evenly spaced. If n is 0, *flat is false and colour is left unchanged. */
spin_status spin_borders_are_flat(const struct spin_views *views, struct spin_image_cache *images,
                                  const struct spin_pair *pairs, size_t n, bool *flat,
                                  float colour[3]);
