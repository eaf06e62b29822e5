/* A splat's own values, added to the heads' outputs or without any: their columns, the gradient,
 * the same bits for any number of threads.
 * K: threads residual */

#include "tests/device/verbs.h"

enum { N = 2500, ROWS = 1700 };

static float residual[SPIN_RESIDUAL * N], raw[N * SPIN_ATTR], first[N * SPIN_ATTR],
    d_raw[ROWS * SPIN_ATTR];
static float d_residual[SPIN_RESIDUAL * N], sh[45 * N], d_sh[45 * N];
static uint32_t rows[ROWS];

/* Each group of own values is a separate matrix; a row of attributes has columns of all groups. */
static bool is_own(int column, size_t sh_width)
{
    return column < SPIN_ATTR_SH + 3 + (int)sh_width || column == SPIN_ATTR_OPACITY;
}

static float of_own(const float *v, const float *of_sh, size_t sh_width, size_t i, int column)
{
    if (column >= SPIN_ATTR_SH + 3 && column < SPIN_ATTR_OPACITY)
        return is_own(column, sh_width) ? of_sh[sh_width * i + (size_t)column - SPIN_ATTR_SH - 3]
                                        : 0;
    if (column < SPIN_ATTR_ROTATION)
        return v[3 * i + (size_t)column];
    if (column < SPIN_ATTR_SH)
        return v[3 * N + 4 * i + (size_t)(column - SPIN_ATTR_ROTATION)];
    if (column < SPIN_ATTR_SH + 3)
        return v[7 * N + 3 * i + (size_t)(column - SPIN_ATTR_SH)];
    return v[10 * N + i];
}

static void check_path(const char *path, int n_threads, size_t width)
{
    struct spin_device *d;
    int wrong = 0;

    setenv("SPIN_CPU", path, 1);
    d = check_device(n_threads);
    memcpy(raw, first, sizeof raw);
    on_residual(d, N, residual, width, width ? sh : NULL, raw);
    for (size_t i = 0; i < N; i++)
        for (int k = 0; k < SPIN_ATTR; k++) {
            float sum = first[i * SPIN_ATTR + (size_t)k] + of_own(residual, sh, width, i, k);

            wrong += raw[i * SPIN_ATTR + (size_t)k] != sum;
        }
    ok(wrong == 0, "%s, %d threads: outputs plus own values (%d differ)", path, n_threads, wrong);
    wrong = 0;
    memcpy(raw, first, sizeof raw);
    on_residual_set(d, N, residual, width, width ? sh : NULL, raw);
    for (size_t i = 0; i < N; i++)
        for (int k = 0; k < SPIN_ATTR; k++) {
            size_t at = i * SPIN_ATTR + (size_t)k;

            wrong += raw[at] != (is_own(k, width) ? of_own(residual, sh, width, i, k) : first[at]);
        }
    ok(wrong == 0, "%s, %d threads: own values in place of outputs (%d differ)", path, n_threads,
       wrong);
    wrong = 0;
    for (size_t i = 0; i < SPIN_RESIDUAL * N; i++)
        d_residual[i] = 1;
    for (size_t i = 0; i < 45 * N; i++)
        d_sh[i] = 1;
    on_residual_back(d, N, ROWS, rows, d_raw, d_residual, width, width ? d_sh : NULL);
    for (size_t i = 0, r = 0; i < N; i++) {
        bool active = r < ROWS && rows[r] == i;

        for (int k = 0; k < SPIN_ATTR; k++)
            if (is_own(k, width) && of_own(d_residual, d_sh, width, i, k) !=
                                        1 + (active ? d_raw[r * SPIN_ATTR + (size_t)k] : 0))
                wrong++;
        r += active;
    }
    ok(wrong == 0, "%s, %d threads: gradients of the active rows gather (%d differ)", path,
       n_threads, wrong);
    check_device_free(d);
}

static void fill(float *to, size_t n, size_t step)
{
    for (size_t i = 0; i < n; i++)
        to[i] = (float)(i * step % 1999) / 1000 - 1;
}

TAP_MAIN
{
    static const char *const paths[] = {"base", "v3", "v4"};

    fill(residual, SPIN_RESIDUAL * N, 7919);
    fill(sh, (size_t)45 * N, 15485863);
    fill(first, (size_t)N * SPIN_ATTR, 104729);
    fill(d_raw, (size_t)ROWS * SPIN_ATTR, 1299709);
    for (uint32_t i = 0; i < ROWS; i++)
        rows[i] = i + i / 3;
    for (int p = 0; p < 3; p++) {
        struct spin_device d;

        setenv("SPIN_CPU", paths[p], 1);
        if (spin_device_open("cpu", 1, &d) != SPIN_OK) {
            skip(paths[p], spin_last_error());
            continue;
        }
        spin_device_close(&d);
        for (int n = 1; n <= 8; n = n == 3 ? 8 : n + 1)
            check_path(paths[p], n, n == 1 ? 0 : n == 2 ? 9 : 45);
    }
}
