/* Computes the sizes of lazy Adam's memory, and decides whether to use it. */
#include "train/lazy_adam.h"

#include <math.h>

/* Lazy Adam stores step numbers as floats, which represent integers exactly up to this number. */
static const int64_t most_steps = 1 << 24;

static size_t begin_of(const struct spin_field *field)
{
    return (size_t)field->grid.offset[spin_lazy_level(&field->grid)] *
           (size_t)field->grid.n_features;
}

size_t spin_lazy_lines(const struct spin_field *field)
{
    return (field->n_table - begin_of(field)) / SPIN_LINE;
}

size_t spin_lazy_pad(const struct spin_field *field)
{
    return (SPIN_LINE - begin_of(field) % SPIN_LINE) % SPIN_LINE;
}

/* A splat reads 16 rows of a level, one for each corner of a 4D cell. Corners that are neighbours
 * along x often share a line, so these rows are in about 9 lines. */
bool spin_lazy_pays(const struct spin_field *field, double splats, int64_t steps)
{
    const struct spin_grid *grid = &field->grid;
    int level = spin_lazy_level(grid);
    double rows, lines;

    if (level == grid->n_levels || steps > most_steps || spin_lazy_lines(field) > UINT32_MAX)
        return false;
    rows = (double)grid->offset[level + 1] - grid->offset[level];
    lines = rows * grid->n_features / SPIN_LINE;
    return lines >= 1 && fmod(rows * grid->n_features, SPIN_LINE) == 0 &&
           1 - exp(-9 * splats / lines) < 0.5;
}
