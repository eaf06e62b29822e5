/* The record of a training in meta.json, and warnings if options differ from that training. */
#pragma once

#include "scene/clip.h"

/* Record of the training that produced `from`; NULL if it was imported. */
const spin_json *spin_training_of(const struct spin_bundle *bundle, enum spin_splat_source from);
/* Warns if the background differs from that of the training, since transparent regions then show
 * the wrong colour. what: verb for the message, such as "measures". */
void spin_training_warn_background(const struct spin_bundle *bundle, enum spin_splat_source from,
                                   const float background[3], const char *what);
/* Warns if the image scale differs from that of the training: scores are not comparable, and splats
 * trained on small images lack detail. */
void spin_training_warn_scale(const struct spin_bundle *bundle, enum spin_splat_source from,
                              double image_scale);
/* Warns of test cameras that the training used. */
void spin_training_warn_taught(const struct spin_clip *clip, int n_test_cameras);
