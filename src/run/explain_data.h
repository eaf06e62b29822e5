/* The error for an input that is a data set and not a run. */
#pragma once

#include "spin.h"

/* Called if no importer of runs recognises the folder `path`, or if the run that was found in it
 * consists of the data set's own points. If the folder is a data set, replaces the error `status`
 * by one that describes its contents, suggests what to do and, if the data set contains points,
 * contains the command that imports these points. If it clearly is a data set but cannot be read,
 * returns the error of reading it. */
spin_status spin_explain_data_set(const char *path, spin_status status);
/* Returns whether the folder `path` clearly is a data set, and the PLY files in `run`, which is
 * `path` or a folder in it, are only the points of that data set. */
bool spin_run_is_points(const char *path, const char *run);
