/* Mattes: the alpha of input images that show a subject in front of one flat colour.
 *
 * Trained over one background only, splats may render the colour of the background with opaque
 * splats, and the subject with transparent ones. Both are wrong over any other background. Where
 * the alpha of the input images is known, they can be composited over other backgrounds, and splats
 * learn it. */
#pragma once

#include "scene/clip.h"

/* What surrounds the subject of the images. */
enum spin_surroundings {
    SPIN_SURROUNDED_BY_SCENE, /* nothing: a scene fills the images */
    SPIN_SURROUNDED_BY_COLOUR,
    SPIN_SURROUNDED_BY_ALPHA /* the image files have alpha, and transparent pixels */
};

/* Finds what surrounds the subject in the n views of `pairs`, of which it decodes at most 24,
 * evenly spaced. ALPHA: all files have alpha, and at least 5 % of the pixels are transparent.
 * COLOUR: at least half of the border pixels have the same colour, except for noise; sets colour to
 * it, 0..1.
 */
spin_status spin_surroundings_find(const struct spin_views *views, struct spin_image_cache *images,
                                   const struct spin_pair *pairs, size_t n,
                                   enum spin_surroundings *out, float colour[3]);

struct spin_mattes {
    const struct spin_views *views; /* NULL: there are no mattes */
    struct spin_image_cache *images;
    bool alpha;            /* from the alpha of the files; otherwise from the colours of pixels */
    uint8_t background[3]; /* colour of empty pixels */
    uint8_t **kept;      /* [views->n] mattes computed so far, as far as `budget` allows; or NULL */
    size_t held, budget; /* bytes */
};

/* Opens mattes of the views of these pairs, from the alpha of the files or, if the subject is
 * surrounded by the background colour of `images`, from the colours of pixels: those that have the
 * background colour, except for noise, are connected to the border of the image, and are not beside
 * a pixel that is not empty are empty, and the alpha of all others is unknown. Otherwise m->views
 * remains NULL. A quarter of the budget of `images` becomes that of the mattes. Sets *surroundings
 * to those of the subject. */
spin_status spin_mattes_open(const struct spin_views *views, struct spin_image_cache *images,
                             const struct spin_pair *pairs, size_t n, struct spin_mattes *m,
                             enum spin_surroundings *surroundings);
void spin_mattes_close(struct spin_mattes *m);

/* Sets out [h][w] to the matte of a view: 0 where alpha is unknown, otherwise 1 + 254 alpha. */
spin_status spin_mattes_find(struct spin_mattes *m, size_t view, uint8_t *out);

/* Computes a matte from the colours of the image rgb8 [h][w][3]; exported for tests. */
spin_status spin_matte_of_colours(int width, int height, const uint8_t *rgb8,
                                  const uint8_t background[3], uint8_t *out);
