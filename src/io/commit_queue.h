/* Files that are whole but not yet under their names: threads of their own flush, where asked wait for
 * the disk, and rename them, while the next ones are being made. */
#ifndef SPIN_IO_COMMIT_QUEUE_H
#define SPIN_IO_COMMIT_QUEUE_H

#include "io/file.h"

struct spin_commit_queue;

spin_status spin_commit_queue_create(struct spin_commit_queue **out);
/* Takes the file over, whatever the status, and waits while too many are under way. The failure is
 * that of an earlier file, whose name it holds; this one is abandoned then. */
spin_status spin_commit_queue_add(struct spin_commit_queue *commits, struct spin_out *out);
/* All are under their names, or the first failure. */
spin_status spin_commit_queue_wait(struct spin_commit_queue *commits);
/* Waits for those under way. */
void spin_commit_queue_free(struct spin_commit_queue *commits);

#endif
