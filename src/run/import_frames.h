/* Frame times of an import: how the frames of a data set map to the times of a continuous method,
 * and what sequence.json records beside frames written by spin-export. */
#pragma once

#include "scene/bundle_meta.h"

/* Sets the times of all n frames, which initially have the data set's own, by a rule: "data",
 * "unit", "count", or "auto" (also NULL). Methods do not store the times of their frames, and their
 * readers of the same data set differ: most use i/(n-1), some i/n. numbered: frames have numbers
 * from file names. Assumptions are added to the notes of `t`. */
void spin_frame_times(const char *rule, bool numbered, struct spin_sequence_info *t,
                      struct spin_frame_info *all, int n);

/* Applies sequence.json to frames frame[n] found at `input`. If the file lists all of them, sets
 * their times, place[n] (their indices in the exported clip), and n_source_frames, numbered, pair,
 * fps and identity of meta. A file that does not match is ignored with a warning. Fails with
 * SPIN_E_MEMORY only. */
spin_status spin_exported_frames(const char *input, struct spin_frame_info *frame, int n,
                                 int *place, struct spin_bundle_meta *meta);

/* Path and format of the data set recorded in sequence.json beside exported frames, both allocated;
 * NULL if there is none or it no longer exists. */
spin_status spin_exported_data(const char *input, char **data, char **from);
