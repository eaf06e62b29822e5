/* Memory of a frame's parameters, their way to and from the host, and their step. */
#include "train/train_frame.h"

#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/mem.h"
#include "model/residual.h"

/* NULL where there are none. */
static spin_status reserve(struct spin_device *d, size_t floats, float SPIN_DEV **out)
{
    return floats == 0 ? SPIN_OK : d->op->reserve(d, floats * sizeof(float), (void SPIN_DEV **)out);
}

spin_status spin_train_frame_open(struct spin_train_frame *f, struct spin_device *d,
                                  struct spin_frame_size size, bool tracked)
{
    float SPIN_DEV **pos[3] = {&f->pos, &f->m, &f->v};
    float SPIN_DEV **residual[3] = {&f->residual, &f->residual_m, &f->residual_v};

    memset(f, 0, sizeof *f);
    f->size = f->capacity = size;
    for (int i = 0; i < 3; i++) {
        SPIN_TRY(reserve(d, size.n_pos * 3, pos[i]));
        SPIN_TRY(reserve(d, size.n_residual * SPIN_RESIDUAL, residual[i]));
    }
    if (!tracked)
        return SPIN_OK;
    SPIN_TRY(reserve(d, size.n, (float SPIN_DEV **)&f->track));
    SPIN_TRY(reserve(d, size.n, &f->gradient));
    return reserve(d, size.n, (float SPIN_DEV **)&f->seen);
}

void spin_train_frame_close(struct spin_train_frame *f, struct spin_device *d)
{
    void SPIN_DEV *all[] = {f->pos,        f->m,     f->v,        f->residual, f->residual_m,
                            f->residual_v, f->track, f->gradient, f->seen};

    for (size_t i = 0; i < sizeof all / sizeof *all; i++)
        d->op->release(d, all[i]);
    memset(f, 0, sizeof *f);
}

static float SPIN_DEV *positions(const struct spin_train_frame *f, enum spin_train_array which)
{
    return which == SPIN_TRAIN_VALUES ? f->pos : which == SPIN_TRAIN_MOMENT_1 ? f->m : f->v;
}

static float SPIN_DEV *residuals(const struct spin_train_frame *f, enum spin_train_array which)
{
    return which == SPIN_TRAIN_VALUES     ? f->residual
           : which == SPIN_TRAIN_MOMENT_1 ? f->residual_m
                                          : f->residual_v;
}

spin_status spin_train_frame_upload(struct spin_train_frame *frame, struct spin_device *d,
                                    enum spin_train_array which, struct spin_rows pos,
                                    struct spin_rows residual, const uint32_t *row_of)
{
    size_t n = frame->size.n_pos, n_residual = frame->size.n_residual;
    void *block = NULL;
    float *host;

    SPIN_TRY(spin_alloc(SPIN_RESIDUAL * frame->size.n + 1, sizeof(float), &block));
    host = block;
    for (size_t i = 0; pos.at && i < n; i++)
        memcpy(host + 3 * i, pos.at + (row_of ? row_of[i] : i) * pos.stride, 3 * sizeof *host);
    if (pos.at)
        d->op->upload(d, positions(frame, which), host, 3 * n * sizeof *host);
    if (residual.at) {
        spin_residual_from_rows(n_residual, residual.at, residual.stride, row_of, host);
        d->op->upload(d, residuals(frame, which), host, SPIN_RESIDUAL * n_residual * sizeof *host);
    }
    free(block);
    return SPIN_OK;
}

spin_status spin_train_frame_download(const struct spin_train_frame *frame, struct spin_device *d,
                                      enum spin_train_array which, struct spin_rows pos,
                                      struct spin_rows residual, const uint32_t *row_of)
{
    size_t n = frame->size.n_pos, n_residual = frame->size.n_residual;
    void *block = NULL;
    float *host;
    spin_status status;

    SPIN_TRY_OUT(spin_alloc(SPIN_RESIDUAL * frame->size.n + 1, sizeof(float), &block));
    host = block;
    if (pos.at)
        SPIN_TRY_OUT(d->op->download(d, host, positions(frame, which), 3 * n * sizeof *host));
    for (size_t i = 0; pos.at && i < n; i++)
        memcpy(pos.at + (row_of ? row_of[i] : i) * pos.stride, host + 3 * i, 3 * sizeof *host);
    if (residual.at) {
        SPIN_TRY_OUT(d->op->download(d, host, residuals(frame, which),
                                     SPIN_RESIDUAL * n_residual * sizeof *host));
        spin_residual_to_rows(n_residual, host, row_of, residual.at, residual.stride);
    }
out:
    free(block);
    return status;
}

/* n rows of one width, of which the first n_free have the rate lr and the others `tracked` times that. */
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

int spin_train_frame_step(struct spin_train_frame *frame, double lr_pos,
                          const double lr_residual[SPIN_HEADS], double tracked,
                          float SPIN_DEV *d_pos, float SPIN_DEV *d_residual,
                          struct spin_param_group group[SPIN_TRAIN_FRAME_GROUPS])
{
    const struct spin_frame_size *size = &frame->size;
    int n_groups = 0;

    frame->steps++;
    for (size_t k = 0, sum = 0; d_residual && k < SPIN_HEADS; sum += spin_residual_width[k++]) {
        size_t at = sum * size->n_residual;
        struct spin_param_group all = {.p = frame->residual + at,
                                       .g = d_residual + sum * size->n,
                                       .m = frame->residual_m + at,
                                       .v = frame->residual_v + at,
                                       .lr = lr_residual[k],
                                       .step = frame->steps};

        n_groups += split_group(all, spin_residual_width[k], size->n_residual, size->n_free,
                                tracked, group + n_groups);
    }
    if (lr_pos > 0) {
        struct spin_param_group all = {.p = frame->pos,
                                       .g = d_pos,
                                       .m = frame->m,
                                       .v = frame->v,
                                       .lr = lr_pos,
                                       .step = frame->steps};

        n_groups += split_group(all, 3, size->n_pos, size->n_free, tracked, group + n_groups);
    }
    return n_groups;
}
