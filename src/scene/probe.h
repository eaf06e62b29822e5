/* Which importer reads this input. */
#pragma once

#include "spin.h"

/* First bytes, entries and zip member names of path, for probing. Free with spin_peek_free(). */
spin_status spin_peek_open(const char *path, struct spin_peek *out);
void spin_peek_free(struct spin_peek *peek);

/* The importer called `from`, or with from NULL the one whose probe() is surest of `path`. Only
 * importers with open() count, or with views() when want_views. Two that are about equally sure are
 * an error that names both; SPIN_E_NOT_RECOGNISED when there is none: the message then names a
 * folder one level down that is known. */
spin_status spin_importer_find(const char *path, const char *from, bool want_views,
                               const struct spin_importer **out);
/* The same for a run that may lie one level down, when it is the only one there: *in is its folder,
 * allocated, or NULL when it is `path` itself. */
spin_status spin_importer_find_run(const char *path, const char *from,
                                   const struct spin_importer **out, char **in);
/* The importer that knows `path` by itself and well; NULL when there is none, or two. */
const struct spin_importer *spin_importer_guess(const char *path, bool want_views);

/* Every key of the pairs is an option of the plug-in: others are asked wrongly, not dropped. */
spin_status spin_plugin_check(const char *plugin, const struct spin_plugin_option *options,
                              const char *const *pairs);
