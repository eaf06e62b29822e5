/* The frames of an import: at which times of a continuous method those of a data set are, and what
 * was written beside frames that spin-export wrote. */
#pragma once

#include "scene/bundle_meta.h"

/* Sets the times of all n frames, which come with the data set's own, by a rule: "data", "unit",
 * "count", or "auto" (NULL too). Methods do not say at which times their frames were, and their
 * readers of one and the same data set differ: i/(n-1) with most, i/n with some. numbered: frames
 * have numbers from file names. What was assumed is added to the notes of `t`. */
void spin_frame_times(const char *rule, bool numbered, struct spin_sequence_info *t,
                      struct spin_frame_info *all, int n);

/* What sequence.json says of frames frame[n] that were found at `input`. Where there is such a file
 * that knows all of them: sets their times and place[n], the places in the clip that was exported,
 * and of meta n_source_frames, numbered, pair, fps and identity. What does not fit is not used,
 * with a warning. SPIN_E_MEMORY only. */
spin_status spin_exported_frames(const char *input, struct spin_frame_info *frame, int n,
                                 int *place, struct spin_bundle_meta *meta);

/* The data set that sequence.json beside exported frames names, where it is there: *data
 * (allocated) and *from (allocated); else NULL. */
spin_status spin_exported_data(const char *input, char **data, char **from);
