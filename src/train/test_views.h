/* How good the result is by now: quality over the test views, and pictures of them (--preview). */
#pragma once

#include "eval/metrics.h"
#include "train/photos.h"

/* Of what a renderer shows. live_counts as in metrics.h. */
spin_status spin_test_views_measure(const struct spin_plan *plan, struct spin_photos *photos,
                                    struct spin_player *shown, const size_t *live_counts,
                                    const char *what, struct spin_quality *out);
/* Of what training begins with: the trained clip with --method 4d, else the source, when the bundle
 * has all of it; else out is not valid. */
spin_status spin_test_views_measure_input(struct spin_plan *plan, struct spin_photos *photos,
                                          struct spin_device *device, struct spin_quality *out);
/* Truth | source | shown of the clip's middle frame, one PNG a test camera, with this at the end of
 * their names. Nothing without --preview. See spin_plan_beside() for failures. */
spin_status spin_test_views_preview(struct spin_plan *plan, struct spin_photos *photos,
                                    struct spin_player *shown, const char *label);
