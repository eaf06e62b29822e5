/* The lenses of a rig. Cameras of one kind (pictures of one size, about the same field of view)
 * share a lens, and with it how brightness falls off from the middle of their pictures to the
 * corners (math/exposure.h). */
#pragma once

#include "io/json.h"
#include "scene/clip.h"

struct spin_lens {
    double width, height; /* of its pictures as they are stored, pixels */
    double focal;         /* focal length in widths of the picture */
    float falloff[6];     /* c1 r g b, c2 r g b; all 0: none */
};

/* Zero it, or fill it by one of the first two; free it once. */
struct spin_lenses {
    struct spin_lens *lens; /* [n] */
    int n;
    double scale; /* of the pictures of those that ask: their size to that of the stored ones */
};

/* Those of these views, without a falloff. scale: what spin_views_scale() was called with. */
spin_status spin_lenses_list(const struct spin_views *views, const struct spin_pair *pairs,
                             size_t n_pairs, double scale, struct spin_lenses *out);
/* From a bundle's meta.json, "lenses"; none when json is NULL. SPIN_E_MALFORMED when values are
 * missing or not finite. */
spin_status spin_lenses_from_json(const spin_json *json, double scale, struct spin_lenses *out);
spin_json *spin_lenses_to_json(const struct spin_lenses *lenses);
void spin_lenses_free(struct spin_lenses *lenses);

/* The camera's lens; -1 when none of them is like it. */
int spin_lenses_find(const struct spin_lenses *lenses, const struct spin_camera *camera);
/* Warns of the views [n_pairs] whose camera is like none of them, when there are some: they are
 * drawn without a falloff. */
void spin_lenses_warn(const struct spin_lenses *lenses, const struct spin_views *views,
                      const struct spin_pair *pairs, size_t n_pairs);
/* r^2 at the corners of its pictures, as spin_lens_r2() has it. */
double spin_lens_corner_r2(const struct spin_lens *lens);
/* Brightness at the corners of a picture whose middle has 1: mean of the channels. 1 without a
 * lens. Of several lenses the one whose value is farthest from 1. */
double spin_lenses_corner(const struct spin_lenses *lenses);
