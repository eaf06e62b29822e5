/* Finds data sets near a run, and explains an input that is a data set and not a run. */
#pragma once

#include "spin.h"

/* Writes one line, with a newline at the end, about data sets near the input: the input itself if
 * it is one, else its parent folder, else the folders beside it. Writes "" if there are none.
 * Whether the run was trained on one of these data sets is unknown, so the line only suggests using
 * it. */
void spin_data_hint(const char *input, char *text, size_t n_text);
/* Returns the path of the data set, allocated, if spin_data_hint() would find exactly one;
 * otherwise NULL. */
char *spin_data_beside(const char *input);
/* Returns whether transforms_train.json or transforms.json in this folder stores focal lengths as
 * "fl_x", not as an angle of view. */
bool spin_data_has_focal(const char *folder);

/* Called if no importer of runs recognises the folder `path`, or if the run that was found in it
 * consists of the data set's own points. If the folder is a data set, replaces the error `status`
 * by one that describes its contents, suggests what to do and, if the data set contains points,
 * contains the command that imports these points. If it clearly is a data set but cannot be read,
 * returns the error of reading it. */
spin_status spin_explain_data_set(const char *path, spin_status status);
/* Returns whether the folder `path` clearly is a data set, and the PLY files in `run`, which is
 * `path` or a folder in it, are only the points of that data set. */
bool spin_run_is_points(const char *path, const char *run);
