/* All-reduce (io/ranks.h) of values in device memory. On the CPU device this is host memory, where
 * MPI sums the values in place. The values of a GPU are downloaded, summed by MPI and uploaded; the
 * host memory for this is page-locked if possible (host_reserve() of device.h), which saves a copy.
 */
#pragma once

#include "device/device.h"
#include "io/ranks.h"

/* State of the all-reduce in a rank. All members are zero if there is only one rank. */
struct spin_rank_sum {
    struct spin_device *device;
    struct spin_host_memory host; /* for values that are downloaded from a GPU and summed by MPI */
};

/* All ranks must call it. With -v it logs which host memory the values of a GPU pass through. */
spin_status spin_rank_sum_open(struct spin_rank_sum *s, struct spin_device *device);
void spin_rank_sum_close(struct spin_rank_sum *s);

/* All-reduces an array of n values, after the queued work of the device is done: afterwards it
 * contains the sum of the arrays of all ranks. kind: SPIN_SUM_F32 or SPIN_SUM_U32. All ranks must
 * call it with the same n and kind. The sums are bit-identical on all ranks, and reproducible with
 * the same number of ranks. Fails if memory is exhausted, if the device fails, or if another rank
 * has failed. With only one rank it does nothing. */
spin_status spin_rank_sum(struct spin_rank_sum *s, void SPIN_DEV *at, size_t n, int kind);
