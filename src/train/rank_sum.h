/* All-reduce (io/ranks.h) of values in device memory. On the CPU device this is host memory, where
 * MPI sums the values in place. GPUs sum with NCCL if every rank has NCCL and a GPU of its own.
 * Otherwise the values of a GPU are downloaded, summed by MPI and uploaded; the host memory for
 * this is page-locked if possible (host_reserve() of device.h), which saves a copy. */
#pragma once

#include "device/device.h"
#include "io/ranks.h"

/* State of the all-reduce in a rank. All members are zero if there is only one rank. */
struct spin_rank_sum {
    struct spin_device *device;
    bool linked;                  /* true if NCCL connects the GPUs of all ranks */
    struct spin_host_memory host; /* for values that are downloaded from a GPU and summed by MPI */
};

/* All ranks must call it. With -v it logs whether the values of GPUs are summed by NCCL or by MPI.
 */
spin_status spin_rank_sum_open(struct spin_rank_sum *s, struct spin_device *device);
void spin_rank_sum_close(struct spin_rank_sum *s);

/* All-reduces each of the n arrays of the list, after the queued work of the device is done:
 * afterwards an array contains the sum of the corresponding arrays of all ranks. All ranks must
 * call it with the same list. The sums are bit-identical on all ranks, and reproducible with the
 * same number of ranks. Fails if memory is exhausted, if the device fails, or if another rank has
 * failed. With only one rank it does nothing. */
spin_status spin_rank_sum(struct spin_rank_sum *s, const struct spin_device_sum *sum, size_t n);
