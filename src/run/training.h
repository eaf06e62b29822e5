/* What meta.json says of the training of what is measured or drawn. */
#pragma once

#include "scene/clip.h"

/* NULL: the source of others. */
const spin_json *spin_training_of(const struct spin_bundle *bundle, enum spin_splat_source from);
/* Where nothing covers them, pictures over another colour than the training had are wrong by it.
 * what: is done over it. */
void spin_training_warn_background(const struct spin_bundle *bundle, enum spin_splat_source from,
                                   const float background[3], const char *what);
/* Pictures of another size than the training had are another measure: what was trained on small
 * ones has less detail. */
void spin_training_warn_scale(const struct spin_bundle *bundle, enum spin_splat_source from,
                              double image_scale);
/* Cameras that are measured as held out, and are not. */
void spin_training_warn_taught(const struct spin_clip *clip, int n_test_cameras);
