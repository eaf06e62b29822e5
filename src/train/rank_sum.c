/* All-reduces arrays in device memory, by MPI in host memory. */
#include "train/rank_sum.h"

#include "base/base.h"

enum { FIRST_BYTES = 1 << 16 };

/* Ensures that the staging memory on the host has at least this size. Its contents are lost. */
static spin_status need_host(struct spin_rank_sum *s, size_t bytes)
{
    const struct spin_device_ops *op = s->device->op;

    if (bytes <= s->host.bytes)
        return SPIN_OK;
    op->host_release(s->device, &s->host);
    return op->host_reserve(s->device, bytes + bytes / 8, &s->host);
}

spin_status spin_rank_sum_open(struct spin_rank_sum *s, struct spin_device *device)
{
    *s = (struct spin_rank_sum){.device = device};
    if (spin_n_ranks() == 1 || device->is_host)
        return SPIN_OK;
    SPIN_TRY(need_host(s, FIRST_BYTES));
    spin_log(1, "all-reduce between GPUs: through %s host memory",
             s->host.pinned ? "page-locked" : "ordinary");
    return SPIN_OK;
}

void spin_rank_sum_close(struct spin_rank_sum *s)
{
    if (s->host.at)
        s->device->op->host_release(s->device, &s->host);
    *s = (struct spin_rank_sum){0};
}

spin_status spin_rank_sum(struct spin_rank_sum *s, void SPIN_DEV *at, size_t n, int kind)
{
    struct spin_device *d = s->device;
    void *host;

    if (spin_n_ranks() == 1 || n == 0)
        return SPIN_OK;
    SPIN_TRY(d->op->wait(d));
    host = d->op->host_view(d, at);
    if (host)
        return spin_ranks_sum(host, n, kind);
    SPIN_TRY(need_host(s, 4 * n));
    SPIN_TRY(d->op->download(d, s->host.at, at, 4 * n));
    SPIN_TRY(spin_ranks_sum(s->host.at, n, kind));
    d->op->upload(d, at, s->host.at, 4 * n);
    /* The next download may overwrite the host memory only after the upload. */
    return d->op->wait(d);
}
