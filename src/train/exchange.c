/* Device memory by way of the host's. */
#include "train/exchange.h"

#include <stdlib.h>

#include "base/err.h"
#include "base/log.h"
#include "base/mem.h"

enum { ALIGNED = 64, FIRST_BYTES = 1 << 16 };

/* Host memory for so many bytes; what was there is lost. */
static spin_status need_host(struct spin_exchange *e, size_t bytes)
{
    const struct spin_device_ops *op = e->device->op;

    if (bytes <= e->host.bytes)
        return SPIN_OK;
    op->host_release(e->device, &e->host);
    return op->host_reserve(e->device, bytes + bytes / 8, &e->host);
}

spin_status spin_exchange_open(struct spin_exchange *e, struct spin_device *device)
{
    *e = (struct spin_exchange){.device = device};
    if (spin_n_ranks() == 1 || device->is_host)
        return SPIN_OK;
    SPIN_TRY(need_host(e, FIRST_BYTES));
    spin_log(1, "messages between processes go through %s host memory",
             e->host.pinned ? "page-locked" : "ordinary");
    return SPIN_OK;
}

void spin_exchange_close(struct spin_exchange *e)
{
    if (e->host.at)
        e->device->op->host_release(e->device, &e->host);
    free(e->message);
    *e = (struct spin_exchange){0};
}

/* Where the host has each message; returns the bytes of those that are staged. base: of the staging memory, or NULL
 * to count only. */
static size_t place(struct spin_exchange *e, const struct spin_device_message *message, size_t n,
                    char *base)
{
    size_t at = 0;

    for (size_t i = 0; i < n; i++) {
        const struct spin_device_message *m = &message[i];
        void *host = e->device->op->host_view(e->device, m->at);

        e->message[i] = (struct spin_message){m->peer, m->receive, host, m->bytes};
        if (host)
            continue;
        e->message[i].at = base ? base + at : NULL;
        at += (m->bytes + ALIGNED - 1) / ALIGNED * ALIGNED;
    }
    return at;
}

spin_status spin_exchange(struct spin_exchange *e, const struct spin_device_message *message,
                          size_t n)
{
    struct spin_device *d = e->device;
    size_t bytes;

    if (spin_n_ranks() == 1)
        return SPIN_OK;
    if (n > e->room) {
        SPIN_TRY(spin_grow(n, sizeof *e->message, (void **)&e->message));
        e->room = n;
    }
    bytes = place(e, message, n, NULL);
    if (bytes == 0) {
        SPIN_TRY(d->op->wait(d));
        return spin_ranks_exchange(e->message, n);
    }
    SPIN_TRY(need_host(e, bytes));
    place(e, message, n, e->host.at);
    for (size_t i = 0; i < n; i++)
        if (!message[i].receive)
            SPIN_TRY(d->op->download(d, e->message[i].at, message[i].at, message[i].bytes));
    SPIN_TRY(spin_ranks_exchange(e->message, n));
    for (size_t i = 0; i < n; i++)
        if (message[i].receive)
            d->op->upload(d, message[i].at, e->message[i].at, message[i].bytes);
    return d->op->wait(d); /* the host memory is free again */
}
