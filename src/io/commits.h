/* Files that are whole but not yet under their names: threads of their own flush, where asked wait for
 * the disk, and rename them, while the next ones are being made. */
#ifndef SPIN_IO_COMMITS_H
#define SPIN_IO_COMMITS_H

#include "io/file.h"

struct spin_commits;

spin_status spin_commits_create(struct spin_commits **out);
/* Takes the file over, whatever the status, and waits while too many are under way. The failure is
 * that of an earlier file, whose name it holds; this one is abandoned then. */
spin_status spin_commits_add(struct spin_commits *commits, struct spin_out *out);
/* All are under their names, or the first failure. */
spin_status spin_commits_wait(struct spin_commits *commits);
/* Waits for those under way. */
void spin_commits_free(struct spin_commits *commits);

#endif
