/* Finds the importer that reads an input. */
#pragma once

#include "spin.h"

/* The first bytes, folder entries and zip member names of path, for probe(). Free it with
 * spin_peek_free(). */
spin_status spin_peek_open(const char *path, struct spin_peek *out);
void spin_peek_free(struct spin_peek *peek);

/* Finds the importer called `from`, or, if from is NULL, the one whose probe() scores `path`
 * highest. Only importers with open() are considered, with views() if want_views.
 * SPIN_E_NOT_RECOGNISED if two score about equally (the message names both) or if none recognises
 * the input (the message names a subfolder that is recognised, if any). */
spin_status spin_importer_find(const char *path, const char *from, bool want_views,
                               const struct spin_importer **out);
/* The same for a run, which may also be in the only subfolder that is recognised: *in is this
 * folder, allocated, or NULL if the run is `path` itself. */
spin_status spin_importer_find_run(const char *path, const char *from,
                                   const struct spin_importer **out, char **in);
/* The importer that recognises `path` with a high score and no close rival; else NULL. */
const struct spin_importer *spin_importer_guess(const char *path, bool want_views);

/* SPIN_E_USAGE if a key of the pairs is not an option of the plug-in. */
spin_status spin_plugin_check(const char *plugin, const struct spin_plugin_option *options,
                              const char *const *pairs);
