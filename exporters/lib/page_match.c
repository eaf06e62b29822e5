/* Adds frames to a group: copies their values and matches their rows with those of the first frame.
 */
#include "base/base.h"
#include "exporters/lib/page_group.h"

#define NONE UINT32_MAX
#define TAKEN (UINT32_MAX - 1)
#define MOST_BYTES ((size_t)512 << 20) /* largest size of a group's values */
/* A frame joins a group if at least this fraction of its rows is matched. */
#define LEAST_SHARED 0.25

/* ---- A frame --------------------------------------------------------------------------------- */

struct copy_job {
    const struct spin_page_group *g;
    const struct spin_splat_rows *rows;
    struct spin_page_frame *frame;
};

static void copy_block(void *context, size_t from, size_t to)
{
    struct copy_job *t = context;
    size_t width = spin_page_width(t->g);
    int n_sh = 3 * (spin_sh_count(t->rows->splats->sh_degree) - 1);

    for (size_t i = from; i < to; i++) {
        float *v = t->frame->value + i * width, room[48];
        struct spin_gaussian is;

        t->frame->present[i] = t->rows->keep[i];
        memset(v, 0, width * sizeof *v);
        if (!t->rows->keep[i])
            continue;
        spin_splat_rows_get(t->rows, i, &is);
        memcpy(v + SPIN_PAGE_PLACE, is.place, sizeof is.place);
        memcpy(v + SPIN_PAGE_COLOUR, is.colour, sizeof is.colour);
        v[SPIN_PAGE_OPACITY] = is.opacity;
        memcpy(v + SPIN_PAGE_SCALE, is.log_scale, sizeof is.log_scale);
        memcpy(v + SPIN_PAGE_ROTATION, is.rotation, sizeof is.rotation);
        memcpy(v + SPIN_PAGE_VALUE_SH, spin_splat_rows_sh(t->rows, i, room) + 3,
               (size_t)(n_sh < t->g->n_sh ? n_sh : t->g->n_sh) * sizeof *v);
    }
}

static spin_status copy_frame(const struct spin_page_group *g, const struct spin_splat_rows *rows,
                              size_t n, struct spin_page_frame *f)
{
    struct copy_job copy_job = {.g = g, .rows = rows, .frame = f};

    f->n = f->n_own = 0;
    SPIN_TRY(spin_grow(n + 1, spin_page_width(g) * sizeof *f->value, (void **)&f->value));
    SPIN_TRY(spin_grow(n + 1, 1, (void **)&f->present));
    f->n = n;
    spin_pool_rows(g->pool, n, SPIN_ROWS_BLOCK, copy_block, &copy_job);
    return SPIN_OK;
}

/* ---- Matching of rows ------------------------------------------------------------------------ */

/* Returns the L1 distance between the position of row i in frame a and that of row j in frame b. */
static double row_distance(const struct spin_page_group *g, const struct spin_page_frame *a,
                           size_t i, const struct spin_page_frame *b, size_t j)
{
    const float *x = a->value + i * spin_page_width(g), *y = b->value + j * spin_page_width(g);
    double sum = 0;

    for (int c = 0; c < 3; c++)
        sum += fabs((double)x[c] - (double)y[c]);
    return sum;
}

/* Returns whether row i is the same splat in both frames, for every i. This is assumed if rows
 * move, on average, much less from one frame to the other than the mean distance between two
 * different rows. */
static bool keeps_rows(const struct spin_page_group *g, const struct spin_page_frame *last,
                       const struct spin_page_frame *now)
{
    size_t n = now->n, every = n / 4096 + 1;
    double moved = 0, others = 0;

    if (last->n != n)
        return false;
    for (size_t i = 0; i < n; i += every) {
        size_t j = (i + n / 2) % n;

        if (!last->present[i] || !now->present[i] || !last->present[j])
            continue;
        moved += row_distance(g, now, i, last, i);
        others += row_distance(g, now, i, last, j);
    }
    return moved <= LEAST_SHARED * others;
}

static uint64_t hash_of(const float *value)
{
    uint32_t bits[3];
    uint64_t h = 0;

    memcpy(bits, value, sizeof bits);
    for (int c = 0; c < 3; c++) {
        h = (h ^ bits[c]) * 0x9e3779b97f4a7c15ULL;
        h ^= h >> 29;
    }
    return h;
}

/* Matches rows of `now` with rows of the group's first frame at exactly the same position. */
static spin_status match_places(const struct spin_page_group *g, struct spin_page_frame *now,
                                size_t *n_matched)
{
    const struct spin_page_frame *first = &g->frame[0];
    size_t width = spin_page_width(g), size = 16;
    SPIN_FREED uint32_t *table = NULL;

    while (size < 2 * now->n)
        size *= 2;
    SPIN_TRY(spin_alloc(size, sizeof *table, (void **)&table));
    memset(table, 0xff, size * sizeof *table);
    for (size_t i = 0; i < now->n; i++) {
        uint64_t at = hash_of(now->value + i * width) & (size - 1);

        while (now->present[i] && table[at] != NONE)
            at = (at + 1) & (size - 1);
        if (now->present[i])
            table[at] = (uint32_t)i;
    }
    *n_matched = 0;
    for (size_t i = 0; i < first->n; i++) {
        const float *place = first->value + i * width;
        uint64_t at = hash_of(place) & (size - 1);

        now->row[i] = NONE;
        if (!first->present[i])
            continue;
        while (table[at] != NONE && (table[at] == TAKEN || memcmp(now->value + table[at] * width,
                                                                  place, 3 * sizeof *place) != 0))
            at = (at + 1) & (size - 1);
        if (table[at] == NONE)
            continue;
        now->row[i] = table[at];
        ++*n_matched;
        table[at] = TAKEN; /* several splats at the same position are matched one to one */
    }
    return SPIN_OK;
}

/* Matches rows of `now` with rows of the group's first frame. Used if row i of `now` and row
 * i of `last`, the previous frame, are the same splat for every i. */
static spin_status follow_rows(const struct spin_page_frame *last, struct spin_page_frame *now,
                               size_t n_first)
{
    if (!last->row)
        return SPIN_OK;
    SPIN_TRY(spin_alloc(n_first + 1, sizeof *now->row, (void **)&now->row));
    for (size_t i = 0; i < n_first; i++) {
        uint32_t row = last->row[i];

        now->row[i] = row != NONE && now->present[row] ? row : NONE;
    }
    return SPIN_OK;
}

spin_status spin_page_group_add(struct spin_page_group *g, const struct spin_splat_rows *rows,
                                const struct spin_splats *splats, bool *full)
{
    struct spin_page_frame *now = &g->frame[g->n_frames % SPIN_PAGE_MOST_FRAMES];
    size_t n = splats->n, n_matched, n_first = g->n_frames ? g->frame[0].n : n;

    *full = g->n_frames >= g->most_frames ||
            (g->n_frames &&
             MOST_BYTES / (spin_page_width(g) * sizeof(float)) / (size_t)(g->n_frames + 1) <
                 (n > n_first ? n : n_first));
    if (*full)
        return SPIN_OK;
    SPIN_TRY(copy_frame(g, rows, n, now));
    free(now->row);
    now->row = NULL;
    if (g->n_frames && keeps_rows(g, now - 1, now))
        SPIN_TRY(follow_rows(now - 1, now, n_first));
    else if (g->n_frames) {
        SPIN_TRY(spin_alloc(n_first + 1, sizeof *now->row, (void **)&now->row));
        SPIN_TRY(match_places(g, now, &n_matched));
        *full = (double)n_matched < LEAST_SHARED * (double)n;
        if (*full)
            return SPIN_OK;
    }
    g->n_frames++;
    return SPIN_OK;
}
