/* Frame times of an import: how the frames of a data set map to the times of a continuous method,
 * and what sequence.json records beside frames written by spin-export. */
#pragma once

#include "scene/bundle_meta.h"

/* Sets the times of all n frames by a rule of --frame-times: "data", "unit", "count", or "auto"
 * (also NULL). Initially all[i].time is the data set's own time. A rule is necessary since methods
 * do not store the times of their frames, and read the same data set differently: most use
 * i/(n-1), some i/n. numbered: frames have numbers from file names. Assumptions are added to the
 * notes of `t`. */
void spin_frame_times(const char *rule, bool numbered, struct spin_sequence_info *t,
                      struct spin_frame_info *all, int n);

/* Applies sequence.json, if it is in the folder `input`, to the n frames found there. If the file
 * lists all of them, sets the time of each frame, its index in the exported clip, place[n], and the
 * members n_source_frames, numbered, pair, fps and identity of meta. Otherwise the file is ignored
 * with a warning. Fails with SPIN_E_MEMORY only. */
spin_status spin_exported_frames(const char *input, struct spin_frame_info *frame, int n,
                                 int *place, struct spin_bundle_meta *meta);

/* Returns path and format of the data set that sequence.json records beside exported frames, as
 * allocated strings. *data and *from are NULL if no data set is recorded or it no longer exists. */
spin_status spin_exported_data(const char *input, char **data, char **from);
