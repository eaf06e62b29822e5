/* The lenses of a camera rig. Cameras of one kind, with the same image size and about the same
 * field of view, share a lens: a falloff of brightness from the image centre to the corners
 * (math/exposure.h). */
#pragma once

#include "io/json.h"
#include "scene/clip.h"

struct spin_lens {
    double width, height; /* size of the images as stored, pixels */
    double focal;         /* focal length as a fraction of the image width */
    float falloff[6];     /* c1 r g b, c2 r g b; all 0: no falloff */
};

/* Initialise with zeros, spin_lenses_list() or spin_lenses_from_json(); free with
 * spin_lenses_free(). */
struct spin_lenses {
    struct spin_lens *lens; /* [n] */
    int n;
    double scale; /* image scale of the cameras in spin_lenses_find(); 1: as stored */
};

/* Lists the lenses of the views of n_pairs pairs, without falloff. scale: the image scale that was
 * given to spin_views_scale(). */
spin_status spin_lenses_list(const struct spin_views *views, const struct spin_pair *pairs,
                             size_t n_pairs, double scale, struct spin_lenses *out);
/* Reads "lenses" of a bundle's meta.json. json NULL: no lenses. SPIN_E_MALFORMED if a value is
 * missing, a size or focal length is not positive, or the magnitude of a falloff coefficient is
 * above 100. */
spin_status spin_lenses_from_json(const spin_json *json, double scale, struct spin_lenses *out);
spin_json *spin_lenses_to_json(const struct spin_lenses *lenses);
void spin_lenses_free(struct spin_lenses *lenses);

/* Index of the lens that matches the camera best; -1: none matches. */
int spin_lenses_find(const struct spin_lenses *lenses, const struct spin_camera *camera);
/* If there are lenses, prints a warning about the first camera of these pairs that matches none of
 * them: its images are rendered without falloff. */
void spin_lenses_warn(const struct spin_lenses *lenses, const struct spin_views *views,
                      const struct spin_pair *pairs, size_t n_pairs);
/* spin_lens_r2() at the corners of the lens's images. */
double spin_lens_corner_r2(const struct spin_lens *lens);
/* Brightness at the image corners relative to the centre, mean over the channels, of the lens for
 * which it is farthest from 1. 1 if there are no lenses. */
double spin_lenses_corner(const struct spin_lenses *lenses);
