/* Messages between ranks (io/ranks.h) that lie in a device's memory. The CPU's memory is the host's, and they go as they
 * are. Those of cards go from card to card by NCCL, when every rank has NCCL and a card of its own. Else they go through
 * the host: down, from rank to rank by MPI, and up again; the memory for it is page-locked where that is to be had
 * (host_reserve() of device.h), so that a copy takes one way only. */
#ifndef SPIN_TRAIN_EXCHANGE_H
#define SPIN_TRAIN_EXCHANGE_H

#include "device/device.h"
#include "io/ranks.h"

/* What a rank keeps for it. All zero when there is one rank. */
struct spin_exchange {
    struct spin_device *device;
    bool linked;                  /* from card to card */
    struct spin_host_memory host; /* of a card's messages */
    struct spin_message *message; /* [room] the messages where the host has them */
    size_t room;
};

/* All ranks open it together; says with -v how the messages of a card go. */
spin_status spin_exchange_open(struct spin_exchange *e, struct spin_device *device);
void spin_exchange_close(struct spin_exchange *e);

/* As spin_ranks_exchange() (now): on return all messages have arrived, and all that was queued before is done. Without
 * memory, with a device that fails, or when another rank has failed, it fails. */
spin_status spin_exchange(struct spin_exchange *e, const struct spin_device_message *message,
                          size_t n);

#endif
