/* The lenses of a rig. Cameras of one kind (the same image size, about the same field of view)
 * share a lens, and with it the falloff of brightness from the centre of their images to the
 * corners (math/exposure.h). */
#pragma once

#include "io/json.h"
#include "scene/clip.h"

struct spin_lens {
    double width, height; /* of its images as stored, pixels */
    double focal;         /* focal length as a fraction of the image width */
    float falloff[6];     /* c1 r g b, c2 r g b; all 0: no falloff */
};

/* Zero it, or fill it with one of the first two functions; free it once. */
struct spin_lenses {
    struct spin_lens *lens; /* [n] */
    int n;
    double scale; /* image scale of the cameras to be matched; 1: as stored */
};

/* Lists the lenses of these views, without falloff. scale: the argument of spin_views_scale(). */
spin_status spin_lenses_list(const struct spin_views *views, const struct spin_pair *pairs,
                             size_t n_pairs, double scale, struct spin_lenses *out);
/* Reads "lenses" of a bundle's meta.json; NULL: no lenses. SPIN_E_MALFORMED if a value is missing,
 * a size or focal length is not positive, or a falloff coefficient is not within +-100. */
spin_status spin_lenses_from_json(const spin_json *json, double scale, struct spin_lenses *out);
spin_json *spin_lenses_to_json(const struct spin_lenses *lenses);
void spin_lenses_free(struct spin_lenses *lenses);

/* The index of the camera's lens; -1 if none matches. */
int spin_lenses_find(const struct spin_lenses *lenses, const struct spin_camera *camera);
/* Warns, once, if the camera of one of these views matches no lens although there are some: its
 * images are rendered without falloff. */
void spin_lenses_warn(const struct spin_lenses *lenses, const struct spin_views *views,
                      const struct spin_pair *pairs, size_t n_pairs);
/* r^2 at the corners of its images, as defined by spin_lens_r2(). */
double spin_lens_corner_r2(const struct spin_lens *lens);
/* Brightness at the image corners relative to the centre, as the mean over the channels. 1 without
 * a lens; of several lenses, the value that is farthest from 1. */
double spin_lenses_corner(const struct spin_lenses *lenses);
