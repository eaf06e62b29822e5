/* A step of a frame's own parameters: each group at its rate, and what splats with a track have at a part of it.
 * K: tracks adam */
#include "train/train_frame.h"

#include <math.h>
#include <stdlib.h>

#include "tests/device/strict.h"
#include "tests/tap.h"

/* Splats; without a track; with a position; with residual values. */
enum { N = 5, FREE = 2, POS = 4, RESIDUAL = 3 };
static const size_t width[SPIN_HEADS] = {3, 4, 3, 1};
static const double rate[SPIN_HEADS] = {0.5, 0.25, 0.125, 0.0625}, rate_pos = 0.75;

static float SPIN_DEV *lend(struct spin_device *d, size_t n, float value)
{
    void SPIN_DEV *at = NULL;
    float host[SPIN_RESIDUAL * N];

    for (size_t i = 0; i < n; i++)
        host[i] = value;
    if (d->op->reserve(d, n * sizeof *host, &at) != SPIN_OK)
        exit(1);
    d->op->upload(d, at, host, n * sizeof *host);
    return (float SPIN_DEV *)at;
}

/* Adam's first step has the length of the rate. Rows [first, end) of `width` values moved by it. */
static bool moved(const float *rows, size_t width_of, size_t first, size_t end, double by)
{
    for (size_t i = width_of * first; i < width_of * end; i++)
        if (!(fabs((double)rows[i] + by) < 1e-6))
            return false;
    return true;
}

static void test_step(double tracked)
{
    static const struct spin_frame_size size = {N, FREE, POS, RESIDUAL};
    struct spin_device device, *d = &device;
    struct spin_train_frame frame;
    struct spin_param_group group[SPIN_TRAIN_FRAME_GROUPS];
    float host[SPIN_RESIDUAL * N] = {0};
    float SPIN_DEV *d_pos, SPIN_DEV *d_residual;
    int n_groups;

    if (spin_device_open("cpu", 1, d) != SPIN_OK ||
        spin_train_frame_open(&frame, d, size, true) != SPIN_OK)
        exit(1);
    d->op->upload(d, frame.pos, host, 3 * POS * sizeof *host);
    d->op->upload(d, frame.residual, host, SPIN_RESIDUAL * RESIDUAL * sizeof *host);
    d_pos = lend(d, 3 * N, 1);
    d_residual = lend(d, SPIN_RESIDUAL * N, 1);
    n_groups = spin_train_frame_step(&frame, rate_pos, rate, tracked, d_pos, d_residual, group);
    d->op->adam(d, n_groups, group);
    ok(d->op->download(d, host, frame.pos, 3 * POS * sizeof *host) == SPIN_OK &&
           moved(host, 3, 0, FREE, rate_pos) && moved(host, 3, FREE, POS, tracked * rate_pos),
       "positions, %g of the rate for those of tracks", tracked);
    ok(d->op->download(d, host, frame.residual, SPIN_RESIDUAL * RESIDUAL * sizeof *host) == SPIN_OK,
       "residual values");
    for (size_t k = 0, at = 0; k < SPIN_HEADS; at += RESIDUAL * width[k++])
        ok(moved(host + at, width[k], 0, FREE, rate[k]) &&
               moved(host + at, width[k], FREE, RESIDUAL, tracked * rate[k]),
           "group %zu of them", k);
    d->op->release(d, d_pos);
    d->op->release(d, d_residual);
    spin_train_frame_close(&frame, d);
    spin_device_close(d);
}

TAP_MAIN
{
    test_step(1);
    test_step(0.25);
    test_step(0);
}
