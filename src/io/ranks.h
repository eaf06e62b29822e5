/* Several processes that do one piece of work together ("ranks"), on one machine or several. They
 * are started by MPI's mpirun or srun, and all make the same calls below in the same order. A
 * process that was started alone is rank 0 of 1: nothing is loaded, and every call returns at once.
 *
 * A rank that fails sends the others a notice when its work ends (spin_ranks_end, spin_run.h). Who
 * waits for it in a call below then fails too, so nobody waits for ever. Only the thread that began
 * may call. */
#pragma once

#include "spin.h"
#include "io/ranks_shim.h"

int spin_rank(void);
int spin_n_ranks(void);

/* All messages of the list, at once: to and from others, in the order of the list between two
 * ranks. */
spin_status spin_ranks_exchange(const struct spin_message *message, size_t n);
/* at [n], SPIN_SUM_...: their sums over all ranks, the same bits on each of them, take their place.
 */
spin_status spin_ranks_sum(void *at, size_t n, int kind);
/* rows [n][bytes]: row i is known to rank owner[i], and afterwards to all. */
spin_status spin_ranks_merge(void *rows, size_t n, size_t bytes, const int *owner);
/* rows [ranks][bytes]: every rank knows its own, and afterwards all. */
spin_status spin_ranks_gather(void *rows, size_t bytes);
/* What rank `from` has at this place, afterwards all have. */
spin_status spin_ranks_share(void *at, size_t bytes, int from);
/* Whether all ranks may go on: the failure of the lowest that cannot, in its own words, at all of
 * them. */
spin_status spin_ranks_agree(spin_status status);

/* Whether after a failure all ranks know of it, from spin_ranks_agree(), and can still do something
 * together. */
bool spin_ranks_agreed(void);

/* Without waiting: SPIN_OK, or another rank has failed, and this one fails in its words. */
spin_status spin_ranks_listen(void);

/* Bytes that this rank sent so far, and seconds that it spent in these calls. spend: what was sent
 * in another way counts, too. */
void spin_ranks_spent(uint64_t *bytes, double *seconds);
void spin_ranks_spend(uint64_t bytes, double seconds);
