/* Finds the record of a training in meta.json, and warns if the options of a command differ from
 * those of that training. */
#pragma once

#include "scene/clip.h"

/* Returns the record of the training that produced the splats `from`; NULL if the splats were
 * imported. */
const spin_json *spin_training_of(const struct spin_bundle *bundle, enum spin_splat_source from);
/* Warns if the background differs from that of the training, since transparent regions then show
 * the wrong colour. `what` is the verb of the warning, such as "measures". */
void spin_training_warn_background(const struct spin_bundle *bundle, enum spin_splat_source from,
                                   const float background[3], const char *what);
/* Warns if the image scale differs from that of the training: scores are not comparable, and splats
 * trained on small images lack detail. */
void spin_training_warn_scale(const struct spin_bundle *bundle, enum spin_splat_source from,
                              double image_scale);
/* Warns if some of the test cameras were used by the training, since their scores are then too
 * high. */
void spin_training_warn_test_cameras(const struct spin_clip *clip, int n_test_cameras);
