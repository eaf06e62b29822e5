/* Describes the lenses of a camera rig. A lens is a falloff of brightness from the image centre to
 * the corners (math/exposure.h). It is shared by all cameras of one kind, which have the same image
 * size and about the same field of view. */
#pragma once

#include "io/json.h"
#include "scene/clip.h"

struct spin_lens {
    double width, height; /* size of the images as stored, pixels */
    double focal;         /* focal length as a fraction of the image width */
    float falloff[6];     /* c1 for r, g, b, then c2 for r, g, b; all 0: no falloff */
};

/* A list of lenses. It is initialised with zeros, by spin_lenses_list() or by
 * spin_lenses_from_json(), and freed by spin_lenses_free(). */
struct spin_lenses {
    struct spin_lens *lens; /* [n] */
    int n;
    /* image scale of the cameras that spin_lenses_find() gets; 1: images keep their size */
    double scale;
};

/* Lists the distinct lenses of the views in pairs[n_pairs], with a falloff of 0. `scale` is the
 * image scale that was given to spin_views_scale(). */
spin_status spin_lenses_list(const struct spin_views *views, const struct spin_pair *pairs,
                             size_t n_pairs, double scale, struct spin_lenses *out);
/* Reads the value of "lenses" of a bundle's meta.json; if `json` is NULL, there are no lenses.
 * Fails with SPIN_E_MALFORMED if a value is missing, a size or focal length is not positive, or the
 * magnitude of a falloff coefficient is above 100. */
spin_status spin_lenses_from_json(const spin_json *json, double scale, struct spin_lenses *out);
spin_json *spin_lenses_to_json(const struct spin_lenses *lenses);
void spin_lenses_free(struct spin_lenses *lenses);

/* Returns the index of the lens that matches the camera best; -1 if none matches. */
int spin_lenses_find(const struct spin_lenses *lenses, const struct spin_camera *camera);
/* If there are lenses, prints a warning about the first camera of these pairs that matches no lens,
 * since its images are rendered without falloff. */
void spin_lenses_warn(const struct spin_lenses *lenses, const struct spin_views *views,
                      const struct spin_pair *pairs, size_t n_pairs);
/* Returns the value of spin_lens_r2() at the corners of the images of a lens. */
double spin_lens_corner_r2(const struct spin_lens *lens);
/* Returns the brightness at the image corners relative to the centre, as the mean over the colour
 * channels, for the lens where this ratio is farthest from 1. Returns 1 if there are no lenses. */
double spin_lenses_corner(const struct spin_lenses *lenses);
