/* Files that others cut short while we have them mapped, and what must not be left behind then. */
#ifndef SPIN_IO_WATCH_H
#define SPIN_IO_WATCH_H

#include <sys/stat.h>

#include "spin.h"

/* What spin_map_open() and spin_map_close() tell. */
void spin_watch_map(const void *data, const char *path, const struct stat *st);
void spin_unwatch_map(const void *data);
/* SPIN_E_IO when the file behind a map that is watched has another size or time by now. One that was
 * removed or replaced is still whole in the map. */
spin_status spin_watch_check(const void *data);

/* A temporary file, or a new folder, to be removed when the process ends because of a cut file. The
 * pointer is kept. */
void spin_watch_out(const char *path);
void spin_unwatch_out(const char *path);

#endif
