/* Recognises common inputs that no importer reads, and suggests what to give instead. */
#pragma once

#include "spin.h"

/* SPIN_E_NOT_FOUND, with a suggestion, if a URL or a pattern was given instead of a path; SPIN_OK
 * for everything else, missing files included. */
spin_status spin_foreign_missing(const char *path);
/* Describes an existing input for the end of an error: "it is a ZIP archive: unpack it". False if
 * there is nothing to say. want_views: a data set was expected. */
bool spin_foreign_input(const char *path, bool want_views, char *text, size_t n_text);
