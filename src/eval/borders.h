/* Detects whether images show a subject in front of one flat colour, as in renderings and masked
 * images, or a scene that fills the image. */
#pragma once

#include "scene/clip.h"

/* Sets *flat to true if at least half of the border pixels of the images have the same colour,
 * except for noise, and colour to the most frequent one, 0..1. Decodes at most 24 of the n views in
 * `pairs`, evenly spaced. *flat is false and colour black if n is 0. */
spin_status spin_borders_are_flat(const struct spin_views *views, struct spin_image_cache *images,
                                  const struct spin_pair *pairs, size_t n, bool *flat,
                                  float colour[3]);
