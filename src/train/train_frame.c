/* Manages the memory of a frame's parameters, transfers them to and from the host, and describes
 * them for Adam. */
#include "train/train_frame.h"

#include "base/base.h"
#include "model/residual.h"

/* Allocates device memory; for 0 floats *out stays NULL. */
static spin_status reserve_floats(struct spin_device *d, size_t floats, float SPIN_DEV **out)
{
    return floats == 0 ? SPIN_OK : d->op->reserve(d, floats * sizeof(float), (void SPIN_DEV **)out);
}

static spin_status reserve_turns(struct spin_train_frame *f, struct spin_device *d)
{
    size_t n = f->size.n_pos;
    SPIN_FREED float *identity = NULL;

    if (n == f->size.n_free || n > f->size.n_residual)
        return SPIN_OK;
    SPIN_TRY(reserve_floats(d, 4 * n, &f->turn));
    SPIN_TRY(spin_alloc(4 * n, sizeof *identity, (void **)&identity));
    for (size_t i = 0; i < n; i++)
        identity[4 * i] = 1;
    d->op->upload(d, f->turn, identity, 4 * n * sizeof *identity);
    return SPIN_OK;
}

spin_status spin_train_frame_open(struct spin_train_frame *f, struct spin_device *d,
                                  struct spin_frame_size size, size_t sh_width, bool tracked)
{
    float SPIN_DEV **pos[3] = {&f->pos, &f->m, &f->v};
    float SPIN_DEV **residual[3] = {&f->residual, &f->residual_m, &f->residual_v};
    float SPIN_DEV **sh[3] = {&f->sh, &f->sh_m, &f->sh_v};

    memset(f, 0, sizeof *f);
    f->size = size;
    f->sh_width = sh_width;
    for (int i = 0; i < 3; i++) {
        SPIN_TRY(reserve_floats(d, size.n_pos * 3, pos[i]));
        SPIN_TRY(reserve_floats(d, size.n_residual * SPIN_RESIDUAL, residual[i]));
        SPIN_TRY(reserve_floats(d, size.n * sh_width, sh[i]));
    }
    if (!tracked)
        return SPIN_OK;
    SPIN_TRY(reserve_floats(d, size.n, (float SPIN_DEV **)&f->track));
    SPIN_TRY(reserve_floats(d, size.n, &f->gradient));
    SPIN_TRY(reserve_floats(d, size.n, (float SPIN_DEV **)&f->seen));
    return reserve_turns(f, d);
}

void spin_train_frame_close(struct spin_train_frame *f, struct spin_device *d)
{
    void SPIN_DEV *all[] = {f->pos,        f->m,    f->v,    f->residual, f->residual_m,
                            f->residual_v, f->sh,   f->sh_m, f->sh_v,     f->track,
                            f->gradient,   f->seen, f->turn};

    for (size_t i = 0; i < sizeof all / sizeof *all; i++)
        d->op->release(d, all[i]);
    memset(f, 0, sizeof *f);
}

struct arrays {
    float SPIN_DEV *pos, *residual, *sh;
};

static struct arrays arrays_of(const struct spin_train_frame *f, enum spin_train_array which)
{
    return which == SPIN_TRAIN_VALUES     ? (struct arrays){f->pos, f->residual, f->sh}
           : which == SPIN_TRAIN_MOMENT_1 ? (struct arrays){f->m, f->residual_m, f->sh_m}
                                          : (struct arrays){f->v, f->residual_v, f->sh_v};
}

static spin_status reserve_host(const struct spin_train_frame *f, float **host)
{
    size_t width = f->sh_width > SPIN_RESIDUAL ? f->sh_width : SPIN_RESIDUAL;

    return spin_alloc(width * f->size.n + 1, sizeof **host, (void **)host);
}

static void upload_rows(struct spin_device *d, struct spin_rows rows, size_t n, size_t width,
                        const uint32_t *row_of, float *host, float SPIN_DEV *to)
{
    for (size_t i = 0; rows.at && i < n; i++)
        memcpy(host + width * i, rows.at + (row_of ? row_of[i] : i) * rows.stride,
               width * sizeof *host);
    if (rows.at)
        d->op->upload(d, to, host, width * n * sizeof *host);
}

spin_status spin_train_frame_upload(struct spin_train_frame *frame, struct spin_device *d,
                                    enum spin_train_array which, struct spin_frame_rows rows,
                                    const uint32_t *row_of)
{
    size_t n = frame->size.n_residual;
    struct arrays to = arrays_of(frame, which);
    SPIN_FREED float *host = NULL;

    SPIN_TRY(reserve_host(frame, &host));
    upload_rows(d, rows.pos, frame->size.n_pos, 3, row_of, host, to.pos);
    if (rows.residual.at) {
        spin_residual_from_rows(n, rows.residual.at, rows.residual.stride, row_of, host);
        d->op->upload(d, to.residual, host, SPIN_RESIDUAL * n * sizeof *host);
    }
    if (frame->sh)
        upload_rows(d, rows.sh, frame->size.n, frame->sh_width, row_of, host, to.sh);
    return SPIN_OK;
}

static spin_status download_rows(struct spin_device *d, const float SPIN_DEV *from, size_t n,
                                 size_t width, const uint32_t *row_of, float *host,
                                 struct spin_rows rows)
{
    if (!rows.at || n == 0)
        return SPIN_OK;
    SPIN_TRY(d->op->download(d, host, from, width * n * sizeof *host));
    for (size_t i = 0; i < n; i++)
        memcpy(rows.at + (row_of ? row_of[i] : i) * rows.stride, host + width * i,
               width * sizeof *host);
    return SPIN_OK;
}

spin_status spin_train_frame_download(const struct spin_train_frame *frame, struct spin_device *d,
                                      enum spin_train_array which, struct spin_frame_rows rows,
                                      const uint32_t *row_of)
{
    size_t n = frame->size.n_residual;
    struct arrays from = arrays_of(frame, which);
    SPIN_FREED float *host = NULL;

    SPIN_TRY(reserve_host(frame, &host));
    SPIN_TRY(download_rows(d, from.pos, frame->size.n_pos, 3, row_of, host, rows.pos));
    if (rows.residual.at && n > 0) {
        SPIN_TRY(d->op->download(d, host, from.residual, SPIN_RESIDUAL * n * sizeof *host));
        spin_residual_to_rows(n, host, row_of, rows.residual.at, rows.residual.stride);
    }
    if (frame->sh)
        return download_rows(d, from.sh, frame->size.n, frame->sh_width, row_of, host, rows.sh);
    return SPIN_OK;
}

/* Splits `all`, the values of n splats with `width` values each, into up to two groups and returns
 * their number. The first n_free splats have the rate all.lr, and the others, which have a track,
 * `tracked` times that rate. */
static int split_group(struct spin_param_group all, size_t width, size_t n, size_t n_free,
                       double tracked, struct spin_param_group *group)
{
    int n_groups = 0;

    for (int part = 0; part < 2; part++) {
        size_t first = part == 0 ? 0 : n_free, end = part == 0 ? n_free : n;
        double lr = part == 0 ? all.lr : tracked * all.lr;

        if (end == first)
            continue;
        group[n_groups] = all;
        group[n_groups].p += width * first;
        group[n_groups].g += width * first;
        group[n_groups].m += width * first;
        group[n_groups].v += width * first;
        group[n_groups].n = width * (end - first);
        group[n_groups++].lr = lr;
    }
    return n_groups;
}

int spin_train_frame_step(struct spin_train_frame *frame, const struct spin_frame_rates *rates,
                          const struct spin_frame_of_batch *of,
                          struct spin_param_group group[SPIN_TRAIN_FRAME_GROUPS])
{
    const struct spin_frame_size *size = &frame->size;
    int n_groups = 0;

    frame->steps++;
    for (size_t k = 0, sum = 0; of->d_residual && k < SPIN_HEADS; sum += spin_residual_width[k++]) {
        size_t at = sum * size->n_residual;
        struct spin_param_group all = {.p = frame->residual + at,
                                       .g = of->d_residual + sum * size->n,
                                       .m = frame->residual_m + at,
                                       .v = frame->residual_v + at,
                                       .lr = rates->residual[k],
                                       .step = frame->steps};

        n_groups += split_group(all, spin_residual_width[k], size->n_residual, size->n_free,
                                rates->tracked, group + n_groups);
    }
    if (of->d_sh)
        group[n_groups++] = (struct spin_param_group){.p = frame->sh,
                                                      .g = of->d_sh,
                                                      .m = frame->sh_m,
                                                      .v = frame->sh_v,
                                                      .n = frame->sh_width * size->n,
                                                      .lr = rates->sh,
                                                      .step = frame->steps};
    if (rates->pos > 0) {
        struct spin_param_group all = {.p = frame->pos,
                                       .g = of->d_means,
                                       .m = frame->m,
                                       .v = frame->v,
                                       .lr = rates->pos,
                                       .step = frame->steps};

        n_groups +=
            split_group(all, 3, size->n_pos, size->n_free, rates->tracked, group + n_groups);
    }
    return n_groups;
}
