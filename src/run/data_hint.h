/* Data sets that lie beside a run. */
#pragma once

#include "spin.h"

/* One line, "\n" at its end, about a data set in the input's own folder, in the one around it or
 * beside it; "" when there is none. What the input was trained on nobody can know from that. */
void spin_data_hint(const char *input, char *text, size_t n_text);
/* Its path, allocated, when there is just one; else NULL. */
char *spin_data_beside(const char *input);
/* Its transforms_train.json, or transforms.json, tells focal lengths by fl_x, not by angles. */
bool spin_data_has_focal(const char *folder);
