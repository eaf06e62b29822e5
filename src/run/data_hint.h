/* Finds data sets near a run. */
#pragma once

#include "spin.h"

/* Writes one line, ending in "\n", about the data sets in the input's folder, in its parent or
 * beside it; "" if there are none. It is unknown whether the run was trained on them. */
void spin_data_hint(const char *input, char *text, size_t n_text);
/* Allocated path of the data set, if spin_data_hint() finds exactly one; else NULL. */
char *spin_data_beside(const char *input);
/* Whether transforms_train.json or transforms.json of the folder stores focal lengths as fl_x
 * instead of angles. */
bool spin_data_has_focal(const char *folder);
