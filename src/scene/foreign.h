/* Recognises common inputs that no importer reads, and suggests a correct input. */
#pragma once

#include "spin.h"

/* SPIN_E_NOT_FOUND with a suggestion if `path` is a URL or a pattern; otherwise SPIN_OK, also if
 * the file does not exist. */
spin_status spin_foreign_missing(const char *path);
/* Writes a description of an existing input to text[n_text], as the end of an error message:
 * "it is a ZIP archive: unpack it". Returns false if the kind of the input is unknown. want_views:
 * a data set was expected. */
bool spin_foreign_input(const char *path, bool want_views, char *text, size_t n_text);
