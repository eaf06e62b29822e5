/* At which times of a method that is continuous in time the frames of a data set are. */
#ifndef SPIN_RUN_FRAME_TIMES_H
#define SPIN_RUN_FRAME_TIMES_H

#include "spin.h"

/* One line of the notes, with its end, or none where there is no room for it. */
void spin_add_note(struct spin_sequence_info *t, const char *fmt, ...) SPIN_PRINTF(2, 3);

/* Sets the times of all n frames, which come with the data set's own, by a rule: "data", "unit", "count",
 * or "auto" (NULL too). Methods do not say at which times their frames were, and their readers of one and
 * the same data set differ: i/(n-1) with most, i/n with some. numbered: frames have numbers from file names.
 * What was assumed is added to the notes of `t`. */
void spin_frame_times(const char *rule, bool numbered, struct spin_sequence_info *t,
                      struct spin_frame_info *all, int n);

#endif
