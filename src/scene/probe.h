/* Finds the importer for an input. */
#pragma once

#include "spin.h"

/* Reads the data that probe() of an importer receives: the first bytes of `path`, the entries if it
 * is a folder, and the names of the members if it is a zip. The caller frees *out with
 * spin_peek_free(). */
spin_status spin_peek_open(const char *path, struct spin_peek *out);
void spin_peek_free(struct spin_peek *peek);

/* Finds the importer called `from`; if `from` is NULL, the importer whose probe() returns the
 * highest score for `path`. If want_views is true, only importers of data sets are considered,
 * which have views(); otherwise only importers of runs, which have open(). Fails with
 * SPIN_E_NOT_RECOGNISED if the two highest scores are about equal; the message then names both
 * importers. Fails in the same way if no importer recognises the input; the message then names a
 * subfolder that an importer recognises, if there is one. */
spin_status spin_importer_find(const char *path, const char *from, bool want_views,
                               const struct spin_importer **out);
/* Like spin_importer_find() for a run, but if `path` is a folder that no importer recognises,
 * searches its subfolders. If exactly one of them is recognised, *in is its path, which the caller
 * frees. If the run is `path` itself, *in is NULL. */
spin_status spin_importer_find_run(const char *path, const char *from,
                                   const struct spin_importer **out, char **in);
/* Returns the importer with the highest score for `path`, if this score is high and well above the
 * second highest; otherwise NULL. */
const struct spin_importer *spin_importer_guess(const char *path, bool want_views);

/* Fails with SPIN_E_USAGE if a key in `pairs` (key, value, ..., NULL) is not an option of the
 * plug-in. */
spin_status spin_plugin_check(const char *plugin, const struct spin_plugin_option *options,
                              const char *const *pairs);

/* Common inputs that no importer reads: what to give instead. */

/* Fails with SPIN_E_NOT_FOUND and a suggestion if `path` is a URL or a pattern. Returns SPIN_OK for
 * any other path, even if the file does not exist. */
spin_status spin_foreign_missing(const char *path);
/* Writes a description of an existing input to text[n_text], as the end of an error message, such
 * as "it is a ZIP archive: unpack it". Returns false if the kind of the input is unknown.
 * `want_views` states whether a data set was expected, and not splats. */
bool spin_foreign_input(const char *path, bool want_views, char *text, size_t n_text);
