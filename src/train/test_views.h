/* Measures the quality of the test views during and after training, and writes previews of them
 * (--preview). */
#pragma once

#include "eval/metrics.h"
#include "train/photos.h"

/* Renders the test views with the player `shown` and measures their quality. live_counts: see
 * metrics.h. `what` names the work in the progress display. */
spin_status spin_test_views_measure(const struct spin_plan *plan, struct spin_photos *photos,
                                    struct spin_player *shown, const size_t *live_counts,
                                    const char *what, struct spin_quality *out);
/* Measures the quality of the splats that the training starts from: with --method 4d the clip that
 * an earlier training wrote to the bundle, with other methods the source. If the source is needed
 * and the bundle lacks some of its attributes, nothing is measured and out->valid is false. */
spin_status spin_test_views_measure_input(struct spin_plan *plan, struct spin_photos *photos,
                                          struct spin_device *device, struct spin_quality *out);
/* Writes one PNG for each test camera, of the middle frame of the clip. It shows side by side: the
 * captured image, the source if the bundle has all its attributes, and the image rendered by
 * `shown`. File names end in `label`. Does nothing without --preview. A failure to write is handled
 * by spin_plan_beside(). */
spin_status spin_test_views_preview(struct spin_plan *plan, struct spin_photos *photos,
                                    struct spin_player *shown, const char *label);
