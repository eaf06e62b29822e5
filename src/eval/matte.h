/* Mattes: the alpha of input images that show a subject in front of a flat colour.
 *
 * If splats are trained over a single background, opaque splats may reproduce the colour of the
 * background, and transparent splats parts of the subject. Both are wrong over any other
 * background. Where the alpha of the input images is known, training composites the images over
 * random backgrounds, from which splats learn the alpha. */
#pragma once

#include "scene/clip.h"

/* Surroundings of the subject in the images. */
enum spin_surroundings {
    SPIN_SURROUNDED_BY_SCENE, /* there is no subject: a scene fills the images */
    SPIN_SURROUNDED_BY_COLOUR,
    SPIN_SURROUNDED_BY_ALPHA /* the image files have an alpha channel with transparent pixels */
};

/* Sets *out to the surroundings of the subject in the n views of `pairs`. Decodes at most 24 of
 * these views, evenly spaced. ALPHA: all image files have alpha, and at least 5 % of the pixels are
 * transparent. COLOUR: at least half of the border pixels have the same colour, up to noise.
 * Otherwise SCENE. Sets colour to the most frequent colour of the border pixels, 0..1. */
spin_status spin_surroundings_find(const struct spin_views *views, struct spin_image_cache *images,
                                   const struct spin_pair *pairs, size_t n,
                                   enum spin_surroundings *out, float colour[3]);

struct spin_mattes {
    const struct spin_views *views; /* NULL: there are no mattes */
    struct spin_image_cache *images;
    /* True: mattes are the alpha of the files; false: they are computed from colours. */
    bool alpha;
    uint8_t background[3]; /* colour of pixels outside the subject */
    uint8_t **kept;        /* [views->n] cached mattes; NULL: not cached */
    size_t held, budget;   /* size of the cache, and its limit, in bytes */
};

/* Opens mattes for the views of these pairs. If the image files have alpha, the mattes are this
 * alpha. If the subject is surrounded by the background colour of `images`, the mattes are computed
 * from colours: pixels are empty (alpha 0) if they have the background colour, up to noise, are
 * connected to the border of the image by such pixels, and are more than two pixels away from any
 * pixel that does not meet these two conditions; the alpha of all remaining pixels is unknown. In
 * all other cases, m->views remains NULL. A quarter of the memory budget of `images` is assigned to
 * the mattes. Sets *surroundings to the result of spin_surroundings_find(). */
spin_status spin_mattes_open(const struct spin_views *views, struct spin_image_cache *images,
                             const struct spin_pair *pairs, size_t n, struct spin_mattes *m,
                             enum spin_surroundings *surroundings);
void spin_mattes_close(struct spin_mattes *m);

/* Sets out [h][w] to the matte of a view: 0 where alpha is unknown, otherwise 1 + 254 alpha. */
spin_status spin_mattes_find(struct spin_mattes *m, size_t view, uint8_t *out);

/* Sets out [h][w] to a matte of the image rgb8 [h][w][3], computed from colours: 1 for empty
 * pixels, otherwise 0. Exported for tests. */
spin_status spin_matte_of_colours(int width, int height, const uint8_t *rgb8,
                                  const uint8_t background[3], uint8_t *out);

/* ---- Borders --------------------------------------------------------------------------------- */

/* The borders of images show one flat colour in renders and masked images of a subject, but not if
 * a scene fills the images. */

/* Sets colour to the most frequent colour, 0..1, of the border pixels of the images, and *flat to
 * true if at least half of the border pixels have this colour, up to noise. Decodes at most 24 of
 * the n views in `pairs`, evenly spaced. If n is 0, *flat is false and colour is left unchanged. */
spin_status spin_borders_are_flat(const struct spin_views *views, struct spin_image_cache *images,
                                  const struct spin_pair *pairs, size_t n, bool *flat,
                                  float colour[3]);
