/* What an input is that nothing here reads, and what to do with it. */
#pragma once

#include "spin.h"

/* A URL or a pattern in place of a path is SPIN_E_NOT_FOUND, and says what to give; what exists is
 * not. */
spin_status spin_foreign_missing(const char *path);
/* Of what exists: "it is a ZIP archive: unpack it", for the end of an error. False where there is
 * nothing to say. want_views: a data set was expected. */
bool spin_foreign_input(const char *path, bool want_views, char *text, size_t n_text);
