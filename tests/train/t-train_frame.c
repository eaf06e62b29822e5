/* The optimiser step of a frame's own parameters: each group at its rate, and splats with a
 * track at a fraction of it.
 * K: tracks adam */
#include "train/train_frame.h"

#include "tests/device/strict.h"
#include "tests/tap.h"

/* Splats; without a track; with a position; with residual values. */
enum { N = 5, FREE = 2, POS = 4, RESIDUAL = 3 };
static const size_t width[SPIN_HEADS] = {3, 4, 3, 1};
static const double rate[SPIN_HEADS] = {0.5, 0.25, 0.125, 0.0625}, rate_pos = 0.75, rate_sh = 0.375;

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

/* Adam's first step has the length of the rate. Checks that rows [first, end) of `width` values
 * changed by it. */
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
    struct spin_frame_rates rates = {.pos = rate_pos, .sh = rate_sh, .tracked = tracked};
    struct spin_frame_of_batch of = {0};
    int n_groups;

    if (spin_device_open("cpu", 1, d) != SPIN_OK ||
        spin_train_frame_open(&frame, d, NULL, size, 0, true) != SPIN_OK)
        exit(1);
    d->op->upload(d, frame.pos, host, 3 * POS * sizeof *host);
    d->op->upload(d, frame.residual, host, SPIN_RESIDUAL * RESIDUAL * sizeof *host);
    memcpy(rates.residual, rate, sizeof rate);
    of.d_means = lend(d, 3 * N, 1);
    of.d_residual = lend(d, SPIN_RESIDUAL * N, 1);
    n_groups = spin_train_frame_step(&frame, &rates, &of, group);
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
    d->op->release(d, of.d_means);
    d->op->release(d, of.d_residual);
    spin_train_frame_close(&frame, d);
    spin_device_close(d);
}

/* SH beyond the first coefficient, of splats without tracks. */
static void test_sh(void)
{
    enum { WIDTH = 9 };
    static const struct spin_frame_size size = {N, N, N, N};
    struct spin_device device, *d = &device;
    struct spin_train_frame frame;
    struct spin_param_group group[SPIN_TRAIN_FRAME_GROUPS];
    const struct spin_frame_rates rates = {.pos = rate_pos, .sh = rate_sh, .tracked = 1};
    struct spin_frame_of_batch of = {0};
    float host[WIDTH * N], back[WIDTH * N];
    struct spin_frame_rows rows = {.sh = {host, WIDTH}}, to = {.sh = {back, WIDTH}};
    uint32_t turned[N];

    if (spin_device_open("cpu", 1, d) != SPIN_OK ||
        spin_train_frame_open(&frame, d, NULL, size, WIDTH, true) != SPIN_OK)
        exit(1);
    for (uint32_t i = 0; i < WIDTH * N; i++)
        host[i] = (float)i;
    for (uint32_t i = 0; i < N; i++)
        turned[i] = N - 1 - i;
    ok(spin_train_frame_upload(&frame, d, SPIN_TRAIN_VALUES, rows, turned) == SPIN_OK &&
           spin_train_frame_download(&frame, d, SPIN_TRAIN_VALUES, to, NULL) == SPIN_OK &&
           memcmp(back, host + WIDTH * (N - 1), WIDTH * sizeof *back) == 0 &&
           memcmp(back + WIDTH * (N - 1), host, WIDTH * sizeof *back) == 0,
       "SH goes to the device and back, in another order");
    memset(host, 0, sizeof host);
    spin_train_frame_upload(&frame, d, SPIN_TRAIN_VALUES, rows, NULL);
    of.d_means = lend(d, 3 * N, 1);
    of.d_sh = lend(d, WIDTH * N, 1);
    d->op->adam(d, spin_train_frame_step(&frame, &rates, &of, group), group);
    ok(spin_train_frame_download(&frame, d, SPIN_TRAIN_VALUES, to, NULL) == SPIN_OK &&
           moved(back, WIDTH, 0, N, rate_sh),
       "and learns at its rate");
    d->op->release(d, of.d_means);
    d->op->release(d, of.d_sh);
    spin_train_frame_close(&frame, d);
    spin_device_close(d);
}

TAP_MAIN
{
    test_sh();
    test_step(1);
    test_step(0.25);
    test_step(0);
}
