/* All-reduce (io/ranks.h) of values in device memory. The memory of the CPU device is the host's,
 * and MPI sums in place. GPUs use NCCL if every rank has it and a GPU of its own. Otherwise values
 * are downloaded, summed by MPI and uploaded; the host memory for this is page-locked if possible
 * (host_reserve() of device.h), which saves a copy. */
#pragma once

#include "device/device.h"
#include "io/ranks.h"

/* State of a rank. All zero with one rank. */
struct spin_rank_sum {
    struct spin_device *device;
    bool linked;                  /* the GPUs are connected */
    struct spin_host_memory host; /* staging memory for values of a GPU */
};

/* Collective: all ranks call it. Logs with -v how the values of GPUs are summed. */
spin_status spin_rank_sum_open(struct spin_rank_sum *s, struct spin_device *device);
void spin_rank_sum_close(struct spin_rank_sum *s);

/* Sums all arrays of the list, after the queued work is done. All ranks must give the same list.
 * The sums are equal to the bit on all ranks, and reproducible with the same number of ranks. Fails
 * without memory, if the device fails, or if another rank has failed. With one rank it does
 * nothing. */
spin_status spin_rank_sum(struct spin_rank_sum *s, const struct spin_device_sum *sum, size_t n);
