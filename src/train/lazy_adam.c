/* The numbers by which missed steps are made up for. */
#include "train/lazy_adam.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/mem.h"
#include "math/adam.h"

/* Of a step, (.9 / sqrt(.999))^400 = 6e-19 is left 400 steps later: nothing. */
enum { REACH = 400 };
static const int64_t most_steps = 1 << 24; /* steps are kept as floats */

static size_t begin_of(const struct spin_field *field)
{
    return (size_t)field->grid.offset[spin_lazy_level(&field->grid)] *
           (size_t)field->grid.n_features;
}

static size_t lines_of(const struct spin_field *field)
{
    return (field->n_table - begin_of(field)) / SPIN_LINE;
}

size_t spin_lazy_pad(const struct spin_field *field)
{
    return (SPIN_LINE - begin_of(field) % SPIN_LINE) % SPIN_LINE;
}

size_t spin_lazy_bytes(const struct spin_field *field, int64_t steps)
{
    return lines_of(field) * sizeof(float) +
           (size_t)(steps + 1) * (4 * sizeof(float) + 2 * sizeof(double));
}

/* A splat needs 16 rows of a level, which lie in about 9 lines: neighbours along x share one. */
bool spin_lazy_pays(const struct spin_field *field, double splats, int64_t steps)
{
    const struct spin_grid *grid = &field->grid;
    int level = spin_lazy_level(grid);
    double rows, lines;

    if (level == grid->n_levels || steps > most_steps || lines_of(field) > UINT32_MAX)
        return false;
    rows = (double)grid->offset[level + 1] - grid->offset[level];
    lines = rows * grid->n_features / SPIN_LINE;
    return lines >= 1 && fmod(rows * grid->n_features, SPIN_LINE) == 0 &&
           1 - exp(-9 * splats / lines) < 0.5;
}

spin_status spin_lazy_enable(struct spin_lazy_table *t, struct spin_device *device,
                             const struct spin_field *field, int64_t steps)
{
    size_t n = (size_t)steps + 1;
    void *block = NULL;
    spin_status status;

    memset(t, 0, sizeof *t);
    t->n_lines = lines_of(field);
    t->capacity = steps;
    SPIN_TRY_OUT(device->op->reserve(device, t->n_lines * sizeof(float), (void **)&t->lazy.last));
    SPIN_TRY_OUT(spin_alloc(n, 4 * sizeof(float) + 2 * sizeof(double), &block));
    t->sum = block;
    t->skipped_step = (float *)(t->sum + 2 * n);
    t->moment_decay = t->skipped_step + 2 * n;
    for (size_t i = 0; i < n; i++) {
        t->moment_decay[2 * i] = (float)pow((double)0.9f, (double)i);
        t->moment_decay[2 * i + 1] = (float)pow((double)0.999f, (double)i);
        t->skipped_step[2 * i + 1] = 1e-15f;
    }
    t->lazy.skipped_step = t->skipped_step;
    t->lazy.moment_decay = t->moment_decay;
    return SPIN_OK;
out:
    spin_lazy_close(t, device);
    return status;
}

void spin_lazy_close(struct spin_lazy_table *t, struct spin_device *device)
{
    if (t->lazy.last)
        device->op->release(device, t->lazy.last, t->n_lines * sizeof(float));
    free(t->sum);
    memset(t, 0, sizeof *t);
}

void spin_lazy_advance(struct spin_lazy_table *t, double lr)
{
    int64_t step = ++t->lazy.done, first = step > REACH ? step - REACH : 0;
    struct spin_adam_step s = spin_adam_step_of(lr, step);
    double one = (double)s.rate / (double)s.inv_root, other = (double)s.rate;

    for (int64_t j = step - 1; j >= first; j--) {
        one *= (double)0.9f / sqrt((double)0.999f);
        other *= (double)0.9f;
        t->sum[2 * j] += one;
        t->sum[2 * j + 1] += other;
        t->skipped_step[2 * j] = (float)t->sum[2 * j];
        t->skipped_step[2 * j + 1] = (float)(1e-15 * t->sum[2 * j] / t->sum[2 * j + 1]);
    }
}
