/* Memory of a frame's parameters, their way to and from the host, and their step. */
#include "train/train_frame.h"

#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/mem.h"
#include "model/residual.h"

enum { N_ARRAYS = 6 };

/* Positions with their moments, then residual values with theirs. */
static void list_arrays(struct spin_train_frame *f, float SPIN_DEV **list[N_ARRAYS],
                        size_t width[N_ARRAYS])
{
    float SPIN_DEV **all[N_ARRAYS] = {&f->pos,      &f->m,          &f->v,
                                      &f->residual, &f->residual_m, &f->residual_v};

    memcpy(list, all, sizeof all);
    for (int i = 0; i < N_ARRAYS; i++)
        width[i] = i < 3 ? 3 : SPIN_RESIDUAL;
}

spin_status spin_train_frame_open(struct spin_train_frame *frame, struct spin_device *d, size_t n,
                                  bool residual)
{
    float SPIN_DEV **list[N_ARRAYS];
    size_t width[N_ARRAYS];

    memset(frame, 0, sizeof *frame);
    frame->n = frame->capacity = n;
    list_arrays(frame, list, width);
    for (int i = 0; i < (residual ? N_ARRAYS : 3); i++)
        SPIN_TRY(d->op->reserve(d, n * width[i] * sizeof(float), (void SPIN_DEV **)list[i]));
    return SPIN_OK;
}

void spin_train_frame_close(struct spin_train_frame *frame, struct spin_device *d)
{
    float SPIN_DEV **list[N_ARRAYS];
    size_t width[N_ARRAYS];

    list_arrays(frame, list, width);
    for (int i = 0; i < N_ARRAYS; i++)
        d->op->release(d, *list[i], frame->capacity * width[i] * sizeof(float));
    memset(frame, 0, sizeof *frame);
}

size_t spin_train_frame_bytes(bool residual)
{
    return 3 * (residual ? 3 + SPIN_RESIDUAL : 3) * sizeof(float);
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
    size_t n = frame->n;
    void *block = NULL;
    float *host;

    SPIN_TRY(spin_alloc(SPIN_RESIDUAL * n + 1, sizeof(float), &block));
    host = block;
    for (size_t i = 0; pos.at && i < n; i++)
        memcpy(host + 3 * i, pos.at + (row_of ? row_of[i] : i) * pos.stride, 3 * sizeof *host);
    if (pos.at)
        d->op->upload(d, positions(frame, which), host, 3 * n * sizeof *host);
    if (residual.at) {
        spin_residual_from_rows(n, residual.at, residual.stride, row_of, host);
        d->op->upload(d, residuals(frame, which), host, SPIN_RESIDUAL * n * sizeof *host);
    }
    free(block);
    return SPIN_OK;
}

spin_status spin_train_frame_download(const struct spin_train_frame *frame, struct spin_device *d,
                                      enum spin_train_array which, struct spin_rows pos,
                                      struct spin_rows residual, const uint32_t *row_of)
{
    size_t n = frame->n;
    void *block = NULL;
    float *host;
    spin_status status;

    SPIN_TRY_OUT(spin_alloc(SPIN_RESIDUAL * n + 1, sizeof(float), &block));
    host = block;
    if (pos.at)
        SPIN_TRY_OUT(d->op->download(d, host, positions(frame, which), 3 * n * sizeof *host));
    for (size_t i = 0; pos.at && i < n; i++)
        memcpy(pos.at + (row_of ? row_of[i] : i) * pos.stride, host + 3 * i, 3 * sizeof *host);
    if (residual.at) {
        SPIN_TRY_OUT(
            d->op->download(d, host, residuals(frame, which), SPIN_RESIDUAL * n * sizeof *host));
        spin_residual_to_rows(n, host, row_of, residual.at, residual.stride);
    }
out:
    free(block);
    return status;
}

int spin_train_frame_step(struct spin_train_frame *frame, double lr_pos,
                          const double lr_residual[SPIN_HEADS], float SPIN_DEV *d_pos,
                          float SPIN_DEV *d_residual,
                          struct spin_param_group group[SPIN_TRAIN_FRAME_GROUPS])
{
    size_t n = frame->n;
    int n_groups = 0;

    frame->steps++;
    for (size_t k = 0, at = 0; d_residual && k < SPIN_HEADS; at += spin_residual_width[k++] * n)
        group[n_groups++] = (struct spin_param_group){.p = frame->residual + at,
                                                      .g = d_residual + at,
                                                      .m = frame->residual_m + at,
                                                      .v = frame->residual_v + at,
                                                      .n = spin_residual_width[k] * n,
                                                      .lr = lr_residual[k],
                                                      .step = frame->steps};
    if (lr_pos > 0)
        group[n_groups++] = (struct spin_param_group){.p = frame->pos,
                                                      .g = d_pos,
                                                      .m = frame->m,
                                                      .v = frame->v,
                                                      .n = 3 * n,
                                                      .lr = lr_pos,
                                                      .step = frame->steps};
    return n_groups;
}
