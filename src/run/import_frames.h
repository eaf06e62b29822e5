/* Finds the frame times of an import: maps the frames of a data set to times of a continuous
 * method, and reads sequence.json, which spin-export writes beside exported frames. */
#pragma once

#include "scene/bundle_meta.h"

/* Sets the times of all n frames by a rule of --frame-times: "data", "unit", "count", or "auto"
 * (also NULL). The caller sets all[i].time to the time that the data set stores for frame i. A rule
 * is necessary since methods do not store the times of their frames, and assign different times to
 * the frames of the same data set: most use i/(n-1) for frame i of n, some i/n. `numbered` states
 * whether the numbers of the frames come from file names. Adds a note to `t` about each assumption.
 */
void spin_frame_times(const char *rule, bool numbered, struct spin_sequence_info *t,
                      struct spin_frame_info *all, int n);

/* Applies sequence.json to the n frames found in the folder `input`, if that folder contains the
 * file. If the file lists all of these frames, sets the time of each frame; place[i], the index of
 * frame i in the exported clip; and the members n_source_frames, numbered, pair, fps and identity
 * of meta. Otherwise ignores the file with a warning. Fails only with SPIN_E_MEMORY. */
spin_status spin_exported_frames(const char *input, struct spin_frame_info *frame, int n,
                                 int *place, struct spin_bundle_meta *meta);

/* Sets *data and *from to the path and the importer of the data set that sequence.json records
 * beside exported frames, as allocated strings. Both are NULL if no data set is recorded or it no
 * longer exists. */
spin_status spin_exported_data(const char *input, char **data, char **from);
