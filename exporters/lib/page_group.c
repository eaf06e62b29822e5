#include "exporters/lib/page_group.h"

#include "base/base.h"
#include "io/compress.h"

#define NONE UINT32_MAX

static size_t columns_of(const struct spin_page_group *g)
{
    return (size_t)(SPIN_PAGE_SH + g->n_sh);
}

static void free_frame(struct spin_page_frame *f)
{
    free(f->value);
    free(f->present);
    free(f->row);
    free(f->own);
}

void spin_page_group_free(struct spin_page_group *g)
{
    for (int f = 0; f < SPIN_PAGE_MOST_FRAMES; f++)
        free_frame(&g->frame[f]);
    free(g->shared);
    free(g->key);
    free(g->number);
    free(g->base_key);
    free(g->base_place);
    free(g->referred);
    memset(g, 0, sizeof *g);
}

static const float *row_value(const struct spin_page_group *g, int frame, size_t i)
{
    const struct spin_page_frame *f = &g->frame[frame];

    return f->value + (f->row ? f->row[i] : i) * spin_page_width(g);
}

/* Lists the shared rows (rows of the first frame whose splat all frames of the group have and at
 * least one keeps) and, sorted by position, the own rows of each frame. */
static spin_status split_rows(struct spin_page_group *g, struct spin_sort_rows *order)
{
    const struct spin_page_frame *first = &g->frame[0];
    size_t most = first->n;
    SPIN_FREED uint8_t *used = NULL;

    SPIN_TRY(spin_grow(first->n + 1, sizeof *g->shared, (void **)&g->shared));
    g->n_shared = 0;
    for (size_t i = 0; i < first->n; i++) {
        bool everywhere = true, somewhere = false;

        for (int f = 0; f < g->n_frames; f++) {
            const struct spin_page_frame *at = &g->frame[f];

            everywhere = everywhere && (!at->row || at->row[i] != NONE);
            somewhere = somewhere || (at->row ? at->row[i] != NONE : at->present[i]);
        }
        if (everywhere && somewhere)
            g->shared[g->n_shared++] = (uint32_t)i;
    }
    for (int f = 0; f < g->n_frames; f++)
        most = g->frame[f].n > most ? g->frame[f].n : most;
    SPIN_TRY(spin_alloc(most + 1, 1, (void **)&used));
    for (int f = 0; f < g->n_frames; f++) {
        struct spin_page_frame *at = &g->frame[f];

        memset(used, 0, at->n);
        for (size_t k = 0; k < g->n_shared; k++)
            used[at->row ? at->row[g->shared[k]] : g->shared[k]] = 1;
        order->n = 0;
        for (size_t i = 0; i < at->n; i++)
            if (at->present[i] && !used[i])
                order->item[order->n++] = (struct spin_keyed){
                    .key = spin_page_place_key(&g->space, at->value + i * spin_page_width(g)),
                    .row = (uint32_t)i};
        spin_sort_rows_sort(order);
        SPIN_TRY(spin_grow(order->n + 1, sizeof *at->own, (void **)&at->own));
        at->n_own = order->n;
        for (size_t i = 0; i < order->n; i++)
            at->own[i] = order->item[i].row;
    }
    return SPIN_OK;
}

/* ---- Numbers --------------------------------------------------------------------------------- */

struct number {
    struct spin_page_group *g;
    struct spin_keyed *order;
    _Atomic bool failed;
};

/* Sets value[f] to the values of shared row i in frame f. For a frame that lacks the row, these are
 * the values of the nearest earlier frame that has the row or, if no earlier frame has it, of the
 * first frame that does. Sets present[f] to 1 if frame f has the row, else to 0. */
static void gather_values(const struct spin_page_group *g, size_t i, const float **value,
                          uint8_t *present)
{
    int first = -1;

    for (int f = 0; f < g->n_frames; f++) {
        present[f] = g->frame[f].row ? 1 : g->frame[f].present[i];
        if (present[f] && first < 0)
            first = f;
        value[f] = present[f] ? row_value(g, f, i) : f ? value[f - 1] : NULL;
    }
    for (int f = 0; f < first; f++)
        value[f] = row_value(g, first, i);
}

static unsigned bits_of(int32_t d)
{
    return d ? 32 - (unsigned)__builtin_clz((uint32_t)abs(d)) : 0;
}

static void number_task(void *context, size_t from, size_t to)
{
    struct number *t = context;
    struct spin_page_group *g = t->g;
    size_t columns = columns_of(g), n = (size_t)g->n_frames;
    int32_t number[SPIN_PAGE_COLUMNS * SPIN_PAGE_MOST_FRAMES];
    const float *value[SPIN_PAGE_MOST_FRAMES];
    uint8_t present[SPIN_PAGE_MOST_FRAMES];

    for (size_t k = from; k < to; k++) {
        size_t i = g->shared[k];
        uint64_t activity = 0, level = 0;

        gather_values(g, i, value, present);
        if (!spin_page_number_row(&g->space, value, present, g->n_frames, g->n_sh,
                                  g->key + k * columns, number, n))
            t->failed = true;
        for (size_t c = 0; c < columns; c++)
            for (size_t f = 0; f < n; f++) {
                int32_t x = number[c * n + f];

                g->number[(c * n + f) * g->n_shared + k] = x;
                activity += f ? bits_of(x - number[c * n + f - 1]) : 0;
            }
        /* level: 0 for static rows; for others 1 plus twice the mean bit length of the changes from
         * frame to frame. */
        if (activity)
            level = 1 + 2 * activity / (columns * (n - 1));
        t->order[k] = (struct spin_keyed){.key = (level > 15 ? 15 : level) << 60 |
                                                 spin_page_place_key(&g->space, value[0]),
                                          .row = (uint32_t)k};
    }
}

/* ---- Rows of the base ------------------------------------------------------------------------ */

/* Finds the static rows that the base has, too, and sets bit 63 of their keys in `order`. Both
 * lists are sorted by position, and mostly have the same rows: of rows at the same position, only
 * the next few are compared. */
static void match_base(struct spin_page_group *g, struct spin_keyed *order)
{
    enum { NEXT = 16 };
    size_t columns = columns_of(g), next = 0;

    g->n_referred = 0;
    memset(g->referred, 0, (g->n_base + 7) / 8);
    for (size_t k = 0; k < g->n_still; k++) {
        const int32_t *key = g->key + order[k].row * columns;
        size_t i;

        while (next < g->n_base && g->base_place[next] < order[k].key)
            next++;
        for (i = next; i < g->n_base && i < next + NEXT && g->base_place[i] == order[k].key &&
                       memcmp(key, g->base_key + i * columns, columns * sizeof *key) != 0;
             i++)
            ;
        if (i == g->n_base || i == next + NEXT || g->base_place[i] != order[k].key)
            continue;
        order[k].key |= 1ULL << 63;
        g->referred[i / 8] |= (uint8_t)(1 << i % 8);
        g->n_referred++;
        next = i + 1;
    }
}

/* Makes this group the base. */
static spin_status set_base(struct spin_page_group *g, const struct spin_keyed *order)
{
    size_t columns = columns_of(g), n = g->n_still;

    g->n_base = 0;
    SPIN_TRY(spin_grow(n + 1, columns * sizeof *g->base_key, (void **)&g->base_key));
    SPIN_TRY(spin_grow(n + 1, sizeof *g->base_place, (void **)&g->base_place));
    SPIN_TRY(spin_grow(n / 8 + 1, 1, (void **)&g->referred));
    for (size_t k = 0; k < n; k++) {
        g->base_place[k] = order[k].key;
        memcpy(g->base_key + k * columns, g->key + order[k].row * columns,
               columns * sizeof *g->key);
    }
    g->n_base = n;
    return SPIN_OK;
}

/* Sorts the static rows of the base first, if they are at least half of the static rows. Otherwise
 * this group becomes the base. */
static spin_status refer_to_base(struct spin_page_group *g, struct spin_sort_rows *order)
{
    const uint64_t mark = 1ULL << 63;
    size_t n = 0;

    g->n_referred = 0;
    if (!g->refers)
        return SPIN_OK;
    if (g->n_base > 0)
        match_base(g, order->item);
    if (g->n_referred == 0 || 2 * g->n_referred < g->n_still) {
        for (size_t k = 0; k < g->n_still; k++)
            order->item[k].key &= ~mark;
        g->n_referred = 0;
        return set_base(g, order->item);
    }
    memcpy(order->spare, order->item, g->n_still * sizeof *order->item);
    for (int side = 1; side >= 0; side--)
        for (size_t k = 0; k < g->n_still; k++)
            if ((order->spare[k].key & mark ? 1 : 0) == side)
                order->item[n++] = order->spare[k];
    return SPIN_OK;
}

/* Checks that the rows of the base in the mask are the first rows of the group. */
static spin_status check_referred(const struct spin_page_group *g, const struct spin_keyed *order,
                                  const uint8_t *mask)
{
    size_t columns = columns_of(g), n = 0;

    for (size_t i = 0; g->n_referred > 0 && i < g->n_base; i++)
        if (mask[i / 8] >> i % 8 & 1) {
            if (n == g->n_referred ||
                memcmp(g->base_key + i * columns, g->key + order[n].row * columns,
                       columns * sizeof *g->key) != 0)
                n = g->n_base;
            n++;
        }
    return n == g->n_referred
               ? SPIN_OK
               : spin_malformed("a block of the page refers to other rows than were encoded: a bug "
                                "in spin4d");
}

/* ---- Blocks ---------------------------------------------------------------------------------- */

struct column {
    struct spin_page_bytes *bytes; /* [n_frames] the coded column of the shared rows */
    struct spin_page_bytes *own;   /* [n_frames] the coded column of the own rows */
    int32_t *row, *last, *mean;    /* [rows] scratch memory */
    spin_status status;
};

struct blocks {
    struct spin_page_group *g;
    const struct spin_keyed *order;
    struct column *column;
    int32_t **own; /* [n_frames][n_own][columns] numbers of the own rows */
    struct spin_page_bytes packed;
    /* The following members describe the block that is being checked. */
    int frame;
    const size_t *start; /* [2 columns] offsets of the columns in the block: first those of shared
                            rows, then those of own rows */
    uint8_t *again;
};

/* Returns number c of a key as the block stores it: red and blue are stored as differences from
 * green. */
static int32_t stored_number(const int32_t *key, size_t c)
{
    enum { GREEN = SPIN_PAGE_COLOUR + 1 };

    return c == GREEN - 1 || c == GREEN + 1 ? key[c] - key[GREEN] : key[c];
}

static spin_status column_bytes(struct blocks *b, size_t c)
{
    const struct spin_page_group *g = b->g;
    struct column *col = &b->column[c];
    size_t columns = columns_of(g), n = (size_t)g->n_frames, moving = g->n_shared - g->n_still;
    struct spin_page_state state = {col->last, col->mean};

    for (size_t k = g->n_referred; k < g->n_shared; k++)
        col->row[k] = stored_number(g->key + b->order[k].row * columns, c);
    SPIN_TRY(spin_page_encode_whole(&col->bytes[0], col->row + g->n_referred,
                                    g->n_shared - g->n_referred));
    memset(col->last, 0, moving * sizeof *col->last);
    memset(col->mean, 0, moving * sizeof *col->mean);
    for (size_t f = 1; f < n; f++) {
        const int32_t *from = g->number + (c * n + f) * g->n_shared;

        for (size_t k = 0; k < moving; k++)
            col->row[k] = from[b->order[g->n_still + k].row];
        SPIN_TRY(spin_page_encode_changes(&col->bytes[f], col->row, moving, &state));
    }
    for (size_t f = 0; f < n; f++) {
        for (size_t k = 0; k < g->frame[f].n_own; k++)
            col->row[k] = stored_number(b->own[f] + k * columns, c);
        if (g->frame[f].n_own)
            SPIN_TRY(spin_page_encode_whole(&col->own[f], col->row, g->frame[f].n_own));
    }
    memset(col->last, 0, moving * sizeof *col->last);
    memset(col->mean, 0, moving * sizeof *col->mean);
    return SPIN_OK;
}

static void column_task(void *context, int c)
{
    struct blocks *b = context;

    b->column[c].status = column_bytes(b, (size_t)c);
}

/* ---- Verification ---------------------------------------------------------------------------- */

/* Decodes a column of the current block and compares it with the numbers that were coded. */
static spin_status column_again(struct blocks *b, size_t c)
{
    const struct spin_page_group *g = b->g;
    const struct spin_page_frame *frame = &g->frame[b->frame];
    struct column *col = &b->column[c];
    struct spin_page_state state = {col->last, col->mean};
    size_t columns = columns_of(g), n = (size_t)g->n_frames, f = (size_t)b->frame, at = b->start[c];
    size_t first = f ? g->n_still : g->n_referred, wrong = 0;

    if (f == 0)
        SPIN_TRY(spin_page_decode_whole(b->again, b->packed.n, &at, col->row + first,
                                        g->n_shared - first));
    else
        SPIN_TRY(
            spin_page_decode_changes(b->again, b->packed.n, &at, g->n_shared - g->n_still, &state));
    for (size_t k = first; k < g->n_shared; k++) {
        size_t row = b->order[k].row;

        wrong += f ? state.last[k - first] != g->number[(c * n + f) * g->n_shared + row]
                   : col->row[k] != stored_number(g->key + row * columns, c);
    }
    if (frame->n_own) {
        at = b->start[columns + c];
        SPIN_TRY(spin_page_decode_whole(b->again, b->packed.n, &at, col->row, frame->n_own));
        for (size_t k = 0; k < frame->n_own; k++)
            wrong += col->row[k] != stored_number(b->own[f] + k * columns, c);
    }
    return wrong ? spin_malformed("a block of the page decodes to other values than were encoded: "
                                  "a bug in spin4d")
                 : SPIN_OK;
}

static void again_task(void *context, int c)
{
    struct blocks *b = context;

    b->column[c].status = column_again(b, (size_t)c);
}

static spin_status run_columns(struct blocks *b, spin_task_fn fn)
{
    spin_pool_run(b->g->pool, (int)columns_of(b->g), fn, b);
    for (size_t c = 0; c < columns_of(b->g); c++)
        if (b->column[c].status != SPIN_OK)
            return b->column[c].status;
    return SPIN_OK;
}

struct errors {
    struct blocks *b;
    struct spin_quant_error *quant; /* [tasks of all frames] errors of the rows of a task */
    size_t first_task[SPIN_PAGE_MOST_FRAMES + 1];
};

/* Decodes the rows of a task, and adds their differences from the values of the source to the
 * errors of the task. */
static void error_task(void *context, int task)
{
    struct errors *e = context;
    const struct spin_page_group *g = e->b->g;
    size_t columns = columns_of(g), n = (size_t)g->n_frames, f = 0, from, to;
    const struct spin_page_frame *frame;

    while ((size_t)task >= e->first_task[f + 1])
        f++;
    frame = &g->frame[f];
    from = ((size_t)task - e->first_task[f]) * SPIN_ROWS_BLOCK;
    to = fmin(from + SPIN_ROWS_BLOCK, g->n_shared + frame->n_own);
    for (size_t k = from; k < to; k++) {
        int32_t key[SPIN_PAGE_COLUMNS], number[SPIN_PAGE_COLUMNS];
        double value[SPIN_PAGE_WIDTH], want[SPIN_PAGE_WIDTH];
        const float *row;
        bool present = true;

        for (size_t c = 0; c < columns; c++) {
            key[c] = k < g->n_shared ? g->key[k * columns + c]
                                     : 2 * e->b->own[f][(k - g->n_shared) * columns + c];
            number[c] = k < g->n_shared ? g->number[(c * n + f) * g->n_shared + k] : 0;
        }
        if (k < g->n_shared) {
            row = row_value(g, (int)f, g->shared[k]);
            present = frame->row || frame->present[g->shared[k]];
        } else
            row = frame->value + frame->own[k - g->n_shared] * spin_page_width(g);
        for (size_t c = 0; c < spin_page_width(g); c++)
            want[c] = (double)row[c];
        spin_page_value_of(&g->space, key, number, g->n_sh, value);
        spin_page_errors_add(&e->quant[task], value, want, present, g->n_sh);
    }
}

static spin_status check_values(struct blocks *b)
{
    struct spin_page_group *g = b->g;
    struct errors e = {.b = b};
    size_t n_tasks = 0;

    for (int f = 0; f < g->n_frames; f++) {
        size_t n = g->n_shared + g->frame[f].n_own;

        e.first_task[f] = n_tasks;
        n_tasks += (n + SPIN_ROWS_BLOCK - 1) / SPIN_ROWS_BLOCK;
        e.first_task[f + 1] = n_tasks;
        g->n_values += n * spin_page_width(g);
    }
    SPIN_TRY(spin_alloc(n_tasks + 1, sizeof *e.quant, (void **)&e.quant));
    spin_pool_run(g->pool, (int)n_tasks, error_task, &e);
    for (size_t t = 0; t < n_tasks; t++)
        spin_quant_error_merge(&g->quant, &e.quant[t]);
    free(e.quant);
    return spin_page_errors_check(&g->quant, &g->space.bounds);
}

/* ---- The whole group ------------------------------------------------------------------------- */

static spin_status too_far(const struct spin_page_group *g)
{
    return spin_unsupported(
        "a splat is too far from the others to store positions in steps of %g: set a larger "
        "--bound-place",
        2 * g->space.bounds.place);
}

static spin_status number_shared(struct spin_page_group *g, struct spin_sort_rows *order)
{
    struct number number = {.g = g, .order = order->item};
    size_t columns = columns_of(g), n = g->n_shared;

    free(g->key);
    free(g->number);
    g->key = g->number = NULL;
    SPIN_TRY(spin_alloc(n * columns + 1, sizeof *g->key, (void **)&g->key));
    SPIN_TRY(
        spin_alloc(n * columns + 1, (size_t)g->n_frames * sizeof *g->number, (void **)&g->number));
    spin_pool_rows(g->pool, n, SPIN_ROWS_BLOCK, number_task, &number);
    if (number.failed)
        return too_far(g);
    order->n = n;
    spin_sort_rows_sort(order);
    for (g->n_still = 0; g->n_still < n && order->item[g->n_still].key >> 60 == 0; g->n_still++)
        ;
    return SPIN_OK;
}

static spin_status number_own(struct blocks *b)
{
    struct spin_page_group *g = b->g;
    size_t columns = columns_of(g);

    for (int f = 0; f < g->n_frames; f++) {
        const struct spin_page_frame *frame = &g->frame[f];

        SPIN_TRY(spin_alloc(frame->n_own * columns + 1, sizeof **b->own, (void **)&b->own[f]));
        for (size_t k = 0; k < frame->n_own; k++)
            if (!spin_page_number_own(&g->space, frame->value + frame->own[k] * spin_page_width(g),
                                      g->n_sh, b->own[f] + k * columns))
                return too_far(g);
    }
    return SPIN_OK;
}

/* Concatenates the mask of the base's rows and the columns of the current frame, and sets start[]
 * to the offsets of the columns. */
static spin_status join_columns(struct blocks *b, size_t *start)
{
    size_t columns = columns_of(b->g), f = (size_t)b->frame;
    size_t n_mask = f == 0 && b->g->n_referred > 0 ? (b->g->n_base + 7) / 8 : 0, n = n_mask;

    for (size_t i = 0; i < 2 * columns; i++) {
        const struct column *col = &b->column[i % columns];

        start[i] = n;
        n += (i < columns ? col->bytes : col->own)[f].n;
    }
    SPIN_TRY(spin_grow(2 * n + 2, 1, (void **)&b->packed.data));
    b->packed.n = n;
    b->again = b->packed.data + n + 1;
    if (n_mask > 0)
        memcpy(b->packed.data, b->g->referred, n_mask);
    for (size_t i = 0; i < 2 * columns; i++) {
        struct spin_page_bytes *piece =
            &(i < columns ? b->column[i].bytes : b->column[i - columns].own)[f];

        if (piece->n)
            memcpy(b->packed.data + start[i], piece->data, piece->n);
        spin_page_bytes_free(piece);
    }
    return SPIN_OK;
}

static spin_status write_block(struct blocks *b, spin_page_sink sink, void *context)
{
    struct spin_page_group *g = b->g;
    struct spin_page_block block = {.frame = b->frame,
                                    .n_shared = g->n_shared,
                                    .n_still = g->n_still,
                                    .n_own = g->frame[b->frame].n_own,
                                    .n_referred = b->frame == 0 ? g->n_referred : 0};
    size_t start[2 * SPIN_PAGE_COLUMNS], n_room = 0, n_again = 0;
    SPIN_FREED unsigned char *bytes = NULL;

    SPIN_TRY(join_columns(b, start));
    b->start = start;
    SPIN_TRY(
        spin_gzip_write(g->pool, 6, b->packed.data, b->packed.n, &bytes, &n_room, &block.n_bytes));
    block.data = bytes;
    SPIN_TRY(spin_gzip_read(bytes, block.n_bytes, b->again, b->packed.n + 1, &n_again));
    if (n_again != b->packed.n)
        return spin_malformed(
            "a block of the page decodes to other values than were encoded: a bug in spin4d");
    if (b->frame == 0)
        SPIN_TRY(check_referred(g, b->order, b->again));
    SPIN_TRY(run_columns(b, again_task));
    return sink(context, &block);
}

static spin_status make_columns(struct blocks *b)
{
    struct spin_page_group *g = b->g;
    size_t columns = columns_of(g), n = (size_t)g->n_frames, rows = g->n_shared;

    for (size_t f = 0; f < n; f++)
        rows = g->frame[f].n_own > rows ? g->frame[f].n_own : rows;
    SPIN_TRY(spin_alloc(columns, sizeof *b->column, (void **)&b->column));
    SPIN_TRY(spin_alloc(n, sizeof *b->own, (void **)&b->own));
    for (size_t c = 0; c < columns; c++) {
        struct column *col = &b->column[c];

        SPIN_TRY(spin_alloc(2 * n, sizeof *col->bytes, (void **)&col->bytes));
        col->own = col->bytes + n;
        SPIN_TRY(spin_alloc(3 * rows + 1, sizeof *col->row, (void **)&col->row));
        col->last = col->row + rows;
        col->mean = col->last + rows;
    }
    return SPIN_OK;
}

static void free_columns(struct blocks *b)
{
    for (size_t c = 0; b->column && c < columns_of(b->g); c++) {
        for (int f = 0; b->column[c].bytes && f < 2 * b->g->n_frames; f++)
            spin_page_bytes_free(&b->column[c].bytes[f]);
        free(b->column[c].bytes);
        free(b->column[c].row);
    }
    for (int f = 0; b->own && f < b->g->n_frames; f++)
        free(b->own[f]);
    free(b->column);
    free(b->own);
    spin_page_bytes_free(&b->packed);
}

static spin_status write_group(struct blocks *b, struct spin_sort_rows *order, spin_page_sink sink,
                               void *context)
{
    struct spin_page_group *g = b->g;
    size_t most = 1;

    for (int f = 0; f < g->n_frames; f++)
        most = g->frame[f].n > most ? g->frame[f].n : most;
    SPIN_TRY(spin_alloc(most, sizeof *order->item, (void **)&order->item));
    SPIN_TRY(spin_alloc(most, sizeof *order->spare, (void **)&order->spare));
    SPIN_TRY(split_rows(g, order));
    SPIN_TRY(number_shared(g, order));
    SPIN_TRY(refer_to_base(g, order));
    b->order = order->item;
    SPIN_TRY(make_columns(b));
    SPIN_TRY(number_own(b));
    SPIN_TRY(check_values(b));
    SPIN_TRY(run_columns(b, column_task));
    for (b->frame = 0; b->frame < g->n_frames; b->frame++)
        SPIN_TRY(write_block(b, sink, context));
    return SPIN_OK;
}

spin_status spin_page_group_write(struct spin_page_group *g, spin_page_sink sink, void *context)
{
    struct spin_sort_rows order = {0};
    struct blocks b = {.g = g};
    spin_status status = g->n_frames ? write_group(&b, &order, sink, context) : SPIN_OK;

    free_columns(&b);
    spin_sort_rows_free(&order);
    g->n_frames = 0;
    return status;
}
