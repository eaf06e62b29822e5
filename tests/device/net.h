/* Shared by the tests of contract, grid, mlp, activate and adam: iteration over the SIMD paths of
 * the CPU, random arrays, fixtures. */
#ifndef SPIN_TESTS_DEVICE_NET_H
#define SPIN_TESTS_DEVICE_NET_H

#include "math/rng.h"
#include "tests/device/verbs.h"

static const char *const net_paths[] = {"base", "v3", "v4"};
enum { N_NET_PATHS = 3 };

/* Selects the SIMD path that check_device opens. Returns 0 and prints a skipped test if this
 * machine lacks it. */
__attribute__((unused)) static int net_path(const char *path)
{
    struct spin_device d;
    char what[64];

    if (!check_device_is_cpu())
        return strcmp(path, net_paths[0]) == 0; /* other devices have a single path */
    setenv("SPIN_CPU", path, 1);
    if (spin_device_open("cpu", 1, &d) == SPIN_OK) {
        spin_device_close(&d);
        return 1;
    }
    snprintf(what, sizeof what, "code path %s", path);
    skip(what, "not of this processor");
    return 0;
}

__attribute__((unused)) static void *net_alloc(size_t n, size_t size)
{
    void *block = calloc(n ? n : 1, size);

    if (!block) {
        printf("Bail out! out of memory\n");
        exit(1);
    }
    return block;
}

__attribute__((unused)) static float *net_floats(size_t n) { return net_alloc(n, sizeof(float)); }

/* n floats, uniform in [low, high). */
__attribute__((unused)) static float *net_random(size_t n, uint64_t stream, float low, float high)
{
    float *x = net_floats(n);

    for (size_t i = 0; i < n; i++)
        x[i] = low + (high - low) * spin_rng_uniform(7, stream, i);
    return x;
}

__attribute__((unused)) static float *net_copy(const float *x, size_t n)
{
    float *y = net_floats(n);

    memcpy(y, x, n * sizeof *y);
    return y;
}

/* Every third row of n, ascending; returns their number. */
__attribute__((unused)) static size_t net_rows(size_t n, uint32_t **rows)
{
    size_t n_rows = 0;

    *rows = net_alloc(n, sizeof **rows);
    for (size_t i = 1; i < n; i += 3)
        (*rows)[n_rows++] = (uint32_t)i;
    return n_rows;
}

__attribute__((unused)) static double net_dot(const float *a, const float *b, size_t n)
{
    double sum = 0;

    for (size_t i = 0; i < n; i++)
        sum += (double)a[i] * b[i];
    return sum;
}

__attribute__((unused)) static size_t net_n_nan(const float *x, size_t n)
{
    size_t count = 0;

    for (size_t i = 0; i < n; i++)
        count += isnan(x[i]) != 0;
    return count;
}

/* Opens a fixture. Returns 0 and prints a skipped test if it is missing. */
__attribute__((unused)) static int net_open(const char *name, struct spin_npz *npz)
{
    const char *path = check_fixture(name);

    if (!path) {
        skip(name, "fixture not found");
        return 0;
    }
    return ok(spin_npz_open(path, npz) == SPIN_OK, "%s opens", name);
}

#endif
