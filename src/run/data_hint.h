/* Finds data sets near a run. */
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
