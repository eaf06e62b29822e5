/* Device memory from card to card, or by way of the host's. */
#include "train/exchange.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

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

/* What a rank could have for a link. */
struct offer {
    char about[32], card[40], why[200]; /* about "": nothing, and why */
};

static void make_offer(struct spin_device *d, struct offer *offer)
{
    memset(offer, 0, sizeof *offer);
    memcpy(offer->card, d->card, sizeof d->card);
    if (!d->op->link_ready)
        snprintf(offer->why, sizeof offer->why, "this build is without NCCL");
    else if (d->op->link_ready(d, offer->about) != SPIN_OK)
        snprintf(offer->why, sizeof offer->why, "%s", spin_last_error());
}

/* Why the ranks cannot be linked; "" when they can. */
static void compare(const struct offer *offer, int n, char why[300])
{
    *why = '\0';
    for (int r = 0; r < n && !*why; r++) {
        if (!*offer[r].about)
            snprintf(why, 300, "%.199s", offer[r].why);
        else if (strcmp(offer[r].about, offer[0].about) != 0)
            snprintf(why, 300, "rank %d has %s and rank 0 has %s", r, offer[r].about,
                     offer[0].about);
        for (int k = 0; k < r && !*why; k++)
            if (strcmp(offer[r].card, offer[k].card) == 0)
                snprintf(why, 300, "ranks %d and %d have the same card", k, r);
    }
}

/* Link the cards; else why not. */
static spin_status link_cards(struct spin_exchange *e, char about[32], char why[300])
{
    struct spin_device *d = e->device;
    struct spin_link_name name = {0};
    struct offer *offer = NULL;
    spin_status status;

    SPIN_TRY(spin_alloc((size_t)spin_n_ranks(), sizeof *offer, (void **)&offer));
    make_offer(d, &offer[spin_rank()]);
    SPIN_TRY_OUT(spin_ranks_gather(offer, sizeof *offer));
    compare(offer, spin_n_ranks(), why);
    memcpy(about, offer[0].about, sizeof offer[0].about);
    if (*why)
        goto out;
    SPIN_TRY_OUT(spin_ranks_agree(spin_rank() == 0 ? d->op->link_name(d, &name) : SPIN_OK));
    SPIN_TRY_OUT(spin_ranks_share(&name, sizeof name, 0));
    SPIN_TRY_OUT(d->op->link(d, &name, spin_rank(), spin_n_ranks()));
    e->linked = true;
out:
    free(offer);
    return status;
}

spin_status spin_exchange_open(struct spin_exchange *e, struct spin_device *device)
{
    char about[32], why[300];

    *e = (struct spin_exchange){.device = device};
    if (spin_n_ranks() == 1 || device->is_host)
        return SPIN_OK;
    SPIN_TRY(link_cards(e, about, why));
    if (e->linked) {
        spin_log(1, "messages between processes go from card to card by %s", about);
        return SPIN_OK;
    }
    SPIN_TRY(need_host(e, FIRST_BYTES));
    spin_log(1, "messages between processes go through %s host memory, as: %s",
             e->host.pinned ? "page-locked" : "ordinary", why);
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

static spin_status exchange_linked(struct spin_exchange *e,
                                   const struct spin_device_message *message, size_t n)
{
    double start = spin_now_s();
    uint64_t bytes = 0;
    spin_status status = e->device->op->exchange(e->device, message, n, spin_ranks_listen);

    for (size_t i = 0; i < n; i++)
        bytes += message[i].receive ? 0 : message[i].bytes;
    spin_ranks_spend(bytes, spin_now_s() - start);
    return status;
}

spin_status spin_exchange(struct spin_exchange *e, const struct spin_device_message *message,
                          size_t n)
{
    struct spin_device *d = e->device;
    size_t bytes;

    if (spin_n_ranks() == 1)
        return SPIN_OK;
    if (e->linked)
        return exchange_linked(e, message, n);
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
