/* Detects whether images show a subject in front of one flat colour, as renders and masked images
 * do, or a scene that fills the image. */
#pragma once

#include "scene/clip.h"

/* *flat = at least half of the border pixels of the images have the same colour, within noise.
 * Decodes at most 24 of the n views in `pairs`, evenly spaced; false without views. */
spin_status spin_borders_are_flat(const struct spin_views *views, struct spin_image_cache *images,
                                  const struct spin_pair *pairs, size_t n, bool *flat);
