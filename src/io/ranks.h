/* Ranks: several processes that share one piece of work, on one or more hosts. They are started by
 * MPI's mpirun or srun, and all make the same calls below in the same order. A process that was
 * started without these is rank 0 of 1: MPI is not loaded, and every call returns immediately.
 *
 * A rank that fails sends the others a notice when its work ends (spin_ranks_end, spin_run.h).
 * Ranks that wait for the failed one in these calls then fail as well, instead of waiting forever.
 * Only the thread that called spin_ranks_begin() may make these calls. */
#pragma once

#include "spin.h"
#include "io/ranks_shim.h"

int spin_rank(void);
int spin_n_ranks(void);

/* Send and receive all listed messages concurrently. Messages between two ranks match in list
 * order. */
spin_status spin_ranks_exchange(const struct spin_message *message, size_t n);
/* All-reduce: replace each of the n numbers by its sum, which is bit-identical on all ranks.
 * kind: SPIN_SUM_... */
spin_status spin_ranks_sum(void *at, size_t n, int kind);
/* rows [n][bytes]: rank owner[i] has row i, and all ranks receive it. */
spin_status spin_ranks_merge(void *rows, size_t n, size_t bytes, const int *owner);
/* rows [ranks][bytes]: each rank has its own row, and all receive all rows. */
spin_status spin_ranks_gather(void *rows, size_t bytes);
/* Broadcast these bytes from rank `from` to all. */
spin_status spin_ranks_share(void *at, size_t bytes, int from);
/* Exchange the status of all ranks: SPIN_OK if all succeeded, else all return the error and message
 * of the lowest rank that failed. */
spin_status spin_ranks_agree(spin_status status);

/* Whether spin_ranks_agree() has reported a failure to all ranks, so that they can still
 * communicate. Always true for a single rank. */
bool spin_ranks_agreed(void);

/* Check for notices without waiting: SPIN_OK, or the error and message of another rank that
 * failed. */
spin_status spin_ranks_listen(void);

/* Bytes that this rank has sent, and seconds that it spent in these calls. spin_ranks_spend() adds
 * communication by other means. */
void spin_ranks_spent(uint64_t *bytes, double *seconds);
void spin_ranks_spend(uint64_t bytes, double seconds);
