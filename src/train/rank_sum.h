/* Sums over ranks (io/ranks.h) of values in a device's memory. The CPU's memory is the host's, and
 * MPI sums them where they are. Those of cards are summed from card to card by NCCL, when every
 * rank has NCCL and a card of its own. Else they go through the host: down, summed by MPI, and up
 * again; the memory for it is page-locked where that is to be had (host_reserve() of device.h), so
 * that a copy takes one way only. */
#pragma once

#include "device/device.h"
#include "io/ranks.h"

/* What a rank keeps for it. All zero when there is one rank. */
struct spin_rank_sum {
    struct spin_device *device;
    bool linked;                  /* from card to card */
    struct spin_host_memory host; /* for a card's values */
};

/* All ranks open it together; says with -v how the values of a card go. */
spin_status spin_rank_sum_open(struct spin_rank_sum *s, struct spin_device *device);
void spin_rank_sum_close(struct spin_rank_sum *s);

/* All of the list, in the same order on each rank (now): what was queued before is done first. The
 * sums have the same bits on all ranks, and for the same number of ranks always. Without memory,
 * with a device that fails, or when another rank has failed, it fails. One rank: nothing is done.
 */
spin_status spin_rank_sum(struct spin_rank_sum *s, const struct spin_device_sum *sum, size_t n);
