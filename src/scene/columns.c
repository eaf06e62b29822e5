/* Allocates and enlarges the columns of splats and lists of views. */
#include "scene/columns.h"

#include "base/base.h"
#include "io/ranks.h"

static const struct {
    const char *name;
    size_t width; /* floats per row; 0: depends on the SH degree */
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

/* Enlarges a column to n rows. The contents are lost: the old memory is freed before the new memory
 * is allocated, since both together might exceed the available memory. *held is the capacity of the
 * column in bytes. */
static spin_status column_reserve(float **column, size_t *held, size_t n, size_t row_bytes)
{
    size_t bytes;

    if (!spin_mul_size(n, row_bytes, &bytes))
        return spin_fail(SPIN_E_MEMORY, "%zu splats need more memory than a process can address",
                         n);
    if (*column && bytes <= *held)
        return SPIN_OK;
    free(*column);
    *column = NULL;
    *held = 0;
    /* Even if the frame has no splats, the column must not be NULL, which means a missing
     * column. */
    SPIN_TRY(spin_alloc(bytes ? bytes : row_bytes, 1, (void **)column));
    *held = bytes ? bytes : row_bytes;
    return SPIN_OK;
}

spin_status spin_splats_reserve(struct spin_splats *s, size_t n, unsigned columns, int sh_degree)
{
    size_t capacity = SIZE_MAX;

    if ((columns & SPIN_COL_SH) && (sh_degree < 0 || sh_degree > 3))
        return spin_unsupported("SH degree %d is not in 0..3", sh_degree);
    if (s->mapped)
        *s = (struct spin_splats){0};
    s->n = s->capacity = 0;
    s->sh_degree = sh_degree;
    s->antialias = false;
    for (int i = 0; i < SPIN_N_COLUMNS; i++) {
        float **column = spin_column_of(s, 1u << i);
        size_t row_bytes = spin_column_width(1u << i, sh_degree) * sizeof(float);

        /* Columns that an earlier call has allocated are enlarged too, even if they are not
         * requested. */
        if (!*column && !(columns & 1u << i))
            continue;
        SPIN_TRY(column_reserve(column, &s->held[i], n, row_bytes));
        if (s->held[i] / row_bytes < capacity)
            capacity = s->held[i] / row_bytes;
    }
    s->capacity = capacity == SIZE_MAX ? 0 : capacity;
    s->n = n;
    return SPIN_OK;
}

void spin_splats_free(struct spin_splats *s)
{
    for (int i = 0; i < SPIN_N_COLUMNS && !s->mapped; i++)
        free(*spin_column_of(s, 1u << i));
    *s = (struct spin_splats){0};
}

void spin_rows_select(const float *from, size_t n, size_t width, const unsigned char *mark,
                      float *to)
{
    for (size_t i = 0; i < n; i++)
        if (mark[i]) {
            memcpy(to, from + width * i, width * sizeof *to);
            to += width;
        }
}

spin_status spin_splats_select(const struct spin_splats *s, const unsigned char *mark,
                               struct spin_splats *out)
{
    struct spin_splats from = *s;
    size_t n = 0;

    for (size_t i = 0; i < s->n; i++)
        n += mark[i];
    SPIN_TRY(spin_splats_reserve(out, n, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES, s->sh_degree));
    out->antialias = s->antialias;
    for (unsigned c = SPIN_COL_MEANS; c <= SPIN_COL_SH; c <<= 1)
        spin_rows_select(*spin_column_of(&from, c), s->n, spin_column_width(c, s->sh_degree), mark,
                         *spin_column_of(out, c));
    return SPIN_OK;
}

spin_status spin_splats_gather(const struct spin_splats *s, const uint32_t *row, size_t n,
                               struct spin_splats *out)
{
    struct spin_splats from = *s;

    SPIN_TRY(spin_splats_reserve(out, n, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES, s->sh_degree));
    out->antialias = s->antialias;
    for (unsigned c = SPIN_COL_MEANS; c <= SPIN_COL_SH; c <<= 1) {
        size_t width = spin_column_width(c, s->sh_degree);
        const float *in = *spin_column_of(&from, c);
        float *to = *spin_column_of(out, c);

        for (size_t i = 0; i < n; i++)
            memcpy(to + i * width, in + row[i] * width, width * sizeof *to);
    }
    return SPIN_OK;
}

spin_status spin_views_add(struct spin_views *views, const struct spin_view *v)
{
    char *path = NULL, *mask = NULL;
    spin_status status;

    SPIN_TRY(
        spin_array_grow(views->n, &views->capacity, sizeof *views->view, (void **)&views->view));
    if (v->path)
        SPIN_TRY_OUT(spin_strdup(v->path, &path));
    if (v->mask)
        SPIN_TRY_OUT(spin_strdup(v->mask, &mask));
    views->view[views->n] = *v;
    views->view[views->n].path = path;
    views->view[views->n++].mask = mask;
    if (v->dataset_frame >= views->n_dataset_frames)
        views->n_dataset_frames = v->dataset_frame + 1;
    return SPIN_OK;
out:
    free(path);
    free(mask);
    return status;
}

void spin_views_free(struct spin_views *views)
{
    for (size_t i = 0; i < views->n; i++) {
        free(views->view[i].path);
        free(views->view[i].mask);
    }
    free(views->view);
    *views = (struct spin_views){0};
}

/* What precedes the columns of shared splats. */
struct head {
    uint64_t n;
    int32_t sh_degree, antialias;
};

spin_status spin_share_splats(struct spin_splats *splats, unsigned columns, int from)
{
    bool receives = spin_rank() == 0;
    struct head head = {splats->n, splats->sh_degree, splats->antialias};
    struct spin_message m[8];
    size_t n = 0;

    if (from == 0 || (!receives && spin_rank() != from))
        return SPIN_OK;
    m[0] = (struct spin_message){receives ? from : 0, receives, &head, sizeof head};
    SPIN_TRY(spin_ranks_exchange(m, 1));
    if (receives) {
        SPIN_TRY(spin_splats_reserve(splats, head.n, columns, head.sh_degree));
        splats->antialias = head.antialias != 0;
    }
    for (unsigned column = 1; column < SPIN_COLUMNS_END; column <<= 1)
        if (columns & column)
            m[n++] = (struct spin_message){m[0].peer, receives, *spin_column_of(splats, column),
                                           head.n * spin_column_width(column, head.sh_degree) *
                                               sizeof(float)};
    return spin_ranks_exchange(m, n);
}
