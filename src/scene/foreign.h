/* Recognises common inputs that no importer reads, and suggests what to give instead. */
#pragma once

#include "spin.h"

/* Fails with SPIN_E_NOT_FOUND and a suggestion if `path` is a URL or a pattern. Returns SPIN_OK for
 * any other path, even if the file does not exist. */
spin_status spin_foreign_missing(const char *path);
/* Writes a description of an existing input to text[n_text], as the end of an error message, such
 * as "it is a ZIP archive: unpack it". Returns false if the kind of the input is unknown.
 * `want_views` states whether a data set was expected, and not splats. */
bool spin_foreign_input(const char *path, bool want_views, char *text, size_t n_text);
