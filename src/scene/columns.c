#include "scene/columns.h"

#include <string.h>

static const struct {
    const char *name;
    size_t width; /* 0: depends on the SH degree */
} table[SPIN_N_COLUMNS] = {{"means", 3},           {"quats", 4}, {"log_scales", 3},
                           {"logit_opacities", 1}, {"sh", 0},    {"rgb", 3}};

static int place_of(unsigned column) { return __builtin_ctz(column); }

const char *spin_column_name(unsigned column) { return table[place_of(column)].name; }

unsigned spin_column_named(const char *name)
{
    for (int i = 0; i < SPIN_N_COLUMNS; i++)
        if (strcmp(table[i].name, name) == 0)
            return 1u << i;
    return 0;
}

size_t spin_column_width(unsigned column, int sh_degree)
{
    size_t side = sh_degree > 0 ? (size_t)sh_degree + 1 : 1, width = table[place_of(column)].width;

    return width ? width : 3 * side * side;
}

int spin_column_shape(unsigned column, size_t n, int sh_degree, uint64_t shape[3])
{
    size_t width = spin_column_width(column, sh_degree);

    shape[0] = n;
    shape[1] = column == SPIN_COL_SH ? width / 3 : width;
    shape[2] = 3;
    return column == SPIN_COL_LOGIT_OPACITIES ? 1 : column == SPIN_COL_SH ? 3 : 2;
}

float **spin_column_of(struct spin_splats *s, unsigned column)
{
    float **const of[SPIN_N_COLUMNS] = {&s->means,           &s->quats, &s->log_scales,
                                        &s->logit_opacities, &s->sh,    &s->rgb};

    return of[place_of(column)];
}
