/* Quality over the test views during and after training, and previews of them (--preview). */
#pragma once

#include "eval/metrics.h"
#include "train/photos.h"

/* Measures the test views, rendered by a player. live_counts: see metrics.h. */
spin_status spin_test_views_measure(const struct spin_plan *plan, struct spin_photos *photos,
                                    struct spin_player *shown, const size_t *live_counts,
                                    const char *what, struct spin_quality *out);
/* Measures the input of the training: the trained clip with --method 4d, else the source if the
 * bundle has all its attributes; otherwise *out is not valid. */
spin_status spin_test_views_measure_input(struct spin_plan *plan, struct spin_photos *photos,
                                          struct spin_device *device, struct spin_quality *out);
/* Writes one PNG for each test camera of the clip's middle frame: captured image, source if it has
 * all attributes, and `shown`, side by side. `label` ends the file names. Does nothing without
 * --preview. Failures: see spin_plan_beside(). */
spin_status spin_test_views_preview(struct spin_plan *plan, struct spin_photos *photos,
                                    struct spin_player *shown, const char *label);
