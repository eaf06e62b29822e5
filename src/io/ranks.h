/* Ranks: several processes that share one piece of work, on one or more hosts. They are started by
 * MPI's mpirun or Slurm's srun, and all call the functions below in the same order. A process that
 * was started in another way is rank 0 of 1: MPI is not loaded, and every call returns immediately.
 *
 * A rank that fails sends the others a notice when its work ends (spin_ranks_end() in spin.h).
 * Ranks that wait for the failed rank in one of the functions below then fail as well, instead of
 * waiting forever. Only the thread that called spin_ranks_begin() may call these functions. */
#pragma once

#include "spin.h"
#include "io/ranks_shim.h"

int spin_rank(void);
int spin_n_ranks(void);

/* Send and receive all listed messages concurrently. If several messages go from one rank to
 * another, the lists of both ranks must contain them in the same order. */
spin_status spin_ranks_exchange(const struct spin_message *message, size_t n);
/* All-reduce: replace each of the n numbers by the sum of the ranks' numbers, which is
 * bit-identical on all ranks. kind: type of the numbers, one of SPIN_SUM_... */
spin_status spin_ranks_sum(void *at, size_t n, int kind);
/* Distribute n rows of `bytes` bytes each: row i is taken from rank owner[i] and copied to all
 * other ranks. */
spin_status spin_ranks_merge(void *rows, size_t n, size_t bytes, const int *owner);
/* Distribute one row of `bytes` bytes per rank: row r is taken from rank r and copied to all other
 * ranks. */
spin_status spin_ranks_gather(void *rows, size_t bytes);
/* Broadcast these bytes from rank `from` to all other ranks. */
spin_status spin_ranks_broadcast(void *at, size_t bytes, int from);
/* Exchange the status of all ranks: returns SPIN_OK if all ranks succeeded. Otherwise all ranks
 * return the error and message of the lowest rank that failed. */
spin_status spin_ranks_agree(spin_status status);

/* Whether all ranks can still communicate after a failure, because spin_ranks_agree() reported the
 * failure to all of them. Always true for a single rank. */
bool spin_ranks_agreed(void);

/* Sets *bytes to the number of bytes that this rank has sent, and *seconds to the time that it has
 * spent in the functions above. */
void spin_ranks_spent(uint64_t *bytes, double *seconds);
