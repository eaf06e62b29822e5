/* All-reduces arrays: of GPUs with NCCL if possible, otherwise in host memory with MPI. */
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

/* Describes whether a rank can connect its GPU to those of other ranks. */
struct offer {
    /* Version of NCCL, or "" if the rank cannot connect its GPU; id of the GPU; reason why the rank
     * cannot connect its GPU. */
    char about[32], card[40], why[200];
};

static void describe_rank(struct spin_device *d, struct offer *offer)
{
    memset(offer, 0, sizeof *offer);
    memcpy(offer->card, d->card, sizeof d->card);
    if (!d->op->link_ready)
        snprintf(offer->why, sizeof offer->why, "this build does not include NCCL");
    else if (d->op->link_ready(d, offer->about) != SPIN_OK)
        snprintf(offer->why, sizeof offer->why, "%s", spin_last_error());
}

/* Sets `why` to the reason why the GPUs of these n ranks cannot be connected, or to "" if they can.
 */
static void find_obstacle(const struct offer *offer, int n, char why[300])
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
                snprintf(why, 300, "ranks %d and %d use the same GPU", k, r);
    }
}

/* Connects the GPUs of all ranks and sets `about` to the version of NCCL. If the GPUs cannot be
 * connected, sets `why` to the reason, otherwise to "". */
static spin_status link_cards(struct spin_rank_sum *s, char about[32], char why[300])
{
    struct spin_device *d = s->device;
    struct spin_link_name name = {0};
    SPIN_FREED struct offer *offer = NULL;

    SPIN_TRY(spin_alloc((size_t)spin_n_ranks(), sizeof *offer, (void **)&offer));
    describe_rank(d, &offer[spin_rank()]);
    SPIN_TRY(spin_ranks_gather(offer, sizeof *offer));
    find_obstacle(offer, spin_n_ranks(), why);
    memcpy(about, offer[0].about, sizeof offer[0].about);
    if (*why)
        return SPIN_OK;
    SPIN_TRY(spin_ranks_agree(spin_rank() == 0 ? d->op->link_name(d, &name) : SPIN_OK));
    SPIN_TRY(spin_ranks_broadcast(&name, sizeof name, 0));
    SPIN_TRY(d->op->link(d, &name, spin_rank(), spin_n_ranks()));
    s->linked = true;
    return SPIN_OK;
}

spin_status spin_rank_sum_open(struct spin_rank_sum *s, struct spin_device *device)
{
    char about[32], why[300];

    *s = (struct spin_rank_sum){.device = device};
    if (spin_n_ranks() == 1 || device->is_host)
        return SPIN_OK;
    SPIN_TRY(link_cards(s, about, why));
    if (s->linked) {
        spin_log(1, "all-reduce between GPUs: with %s", about);
        return SPIN_OK;
    }
    SPIN_TRY(need_host(s, FIRST_BYTES));
    spin_log(1, "all-reduce between GPUs: through %s host memory: %s",
             s->host.pinned ? "page-locked" : "ordinary", why);
    return SPIN_OK;
}

void spin_rank_sum_close(struct spin_rank_sum *s)
{
    if (s->host.at)
        s->device->op->host_release(s->device, &s->host);
    *s = (struct spin_rank_sum){0};
}

static spin_status sum_linked(struct spin_rank_sum *s, const struct spin_device_sum *sum, size_t n)
{
    double start = spin_now_s();
    uint64_t bytes = 0;
    spin_status status = s->device->op->sum(s->device, sum, n, spin_ranks_listen);

    for (size_t i = 0; i < n; i++)
        bytes += 4 * sum[i].n;
    spin_ranks_spend(bytes, spin_now_s() - start);
    return status;
}

spin_status spin_rank_sum(struct spin_rank_sum *s, const struct spin_device_sum *sum, size_t n)
{
    struct spin_device *d = s->device;

    if (spin_n_ranks() == 1)
        return SPIN_OK;
    if (s->linked)
        return sum_linked(s, sum, n);
    SPIN_TRY(d->op->wait(d));
    for (size_t i = 0; i < n; i++) {
        int kind = sum[i].counts ? SPIN_SUM_U32 : SPIN_SUM_F32;
        size_t bytes = 4 * sum[i].n;
        void *at = d->op->host_view(d, sum[i].at);

        if (at) {
            SPIN_TRY(spin_ranks_sum(at, sum[i].n, kind));
            continue;
        }
        SPIN_TRY(need_host(s, bytes));
        SPIN_TRY(d->op->download(d, s->host.at, sum[i].at, bytes));
        SPIN_TRY(spin_ranks_sum(s->host.at, sum[i].n, kind));
        d->op->upload(d, sum[i].at, s->host.at, bytes);
        /* The next download may overwrite the host memory only after the upload. */
        SPIN_TRY(d->op->wait(d));
    }
    return SPIN_OK;
}
