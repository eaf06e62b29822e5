/* Stack, memo, plain values and containers of the pickle machine. */
#include "io/pickle_machine.h"

#include <stdlib.h>
#include <string.h>

#include "base/err.h"

void spin_pickle_release(struct spin_pickle_machine *m)
{
    free(m->stack);
    free(m->memo);
    free(m->mark);
    free(m->storage);
}

spin_status spin_pickle_fail_at(const struct spin_pickle_machine *m, spin_status code,
                                const char *why)
{
    return spin_fail(code, "cannot read '%s': its pickle at byte %zu: %s", m->what,
                     (size_t)(m->op - m->start), why);
}

spin_status spin_pickle_bad(const struct spin_pickle_machine *m, const char *why)
{
    return spin_pickle_fail_at(m, SPIN_E_MALFORMED, why);
}

/* Text of the file as it may be shown: no control characters, not long. */
const char *spin_pickle_shown(const char *text, size_t n, char out[100])
{
    size_t i = 0;

    for (; i < n && i < 99; i++)
        out[i] = text[i] < 0x20 || text[i] > 0x7e ? '?' : text[i];
    out[i] = '\0';
    return out;
}

static spin_status spend(struct spin_pickle_machine *m, size_t bytes)
{
    if (bytes > m->budget)
        return spin_pickle_bad(m, "its values would take more memory than any checkpoint needs");
    m->budget -= bytes;
    return SPIN_OK;
}

spin_status spin_pickle_take(struct spin_pickle_machine *m, size_t bytes, void **out)
{
    bytes = (bytes + 15) & ~(size_t)15;
    SPIN_TRY(spend(m, bytes));
    if (bytes > SLAB / 4)
        return spin_arena_take(m->arena, bytes, 1, out);
    if (bytes > m->slab_left) {
        void *slab;

        SPIN_TRY(spin_arena_take(m->arena, SLAB, 1, &slab));
        m->slab = slab;
        m->slab_left = SLAB;
    }
    *out = m->slab;
    m->slab += bytes;
    m->slab_left -= bytes;
    return SPIN_OK;
}

/* Only values that describe elements have room for the tensor at their end. */
spin_status spin_pickle_new_node(struct spin_pickle_machine *m, enum spin_value_kind kind,
                                 enum role role, struct spin_pickle_node **out)
{
    bool whole = kind == SPIN_VALUE_TENSOR || role == DTYPE || role == STORAGE;
    void *block;

    SPIN_TRY(spin_pickle_take(m, whole ? sizeof **out : offsetof(struct spin_pickle_node, v.tensor),
                              &block));
    *out = block;
    (*out)->role = (unsigned char)role;
    (*out)->v.kind = kind;
    return SPIN_OK;
}

/* Make room for one more in a growing array. */
spin_status spin_pickle_room_for(struct spin_pickle_machine *m, void **array, size_t n,
                                 size_t *capacity, size_t size)
{
    size_t wanted;

    if (n < *capacity)
        return SPIN_OK;
    wanted = *capacity ? 2 * *capacity : 64;
    SPIN_TRY(spend(m, (wanted - *capacity) * size));
    SPIN_TRY(spin_grow(wanted, size, array));
    memset((char *)*array + *capacity * size, 0, (wanted - *capacity) * size);
    *capacity = wanted;
    return SPIN_OK;
}

/* ---- The stack ------------------------------------------------------------------------------- */

spin_status spin_pickle_push(struct spin_pickle_machine *m, struct spin_value *v)
{
    SPIN_TRY(spin_pickle_room_for(m, (void **)&m->stack, m->n_stack, &m->stack_capacity,
                                  sizeof *m->stack));
    m->stack[m->n_stack++] = v;
    return SPIN_OK;
}

/* At least n values above the last mark. */
spin_status spin_pickle_need(const struct spin_pickle_machine *m, size_t n)
{
    if (m->n_stack - spin_pickle_floor(m) < n)
        return spin_pickle_bad(m, "too few values on the stack");
    return SPIN_OK;
}

spin_status spin_pickle_push_mark(struct spin_pickle_machine *m)
{
    SPIN_TRY(
        spin_pickle_room_for(m, (void **)&m->mark, m->n_marks, &m->mark_capacity, sizeof *m->mark));
    m->mark[m->n_marks++] = m->n_stack;
    return SPIN_OK;
}

spin_status spin_pickle_pop_mark(struct spin_pickle_machine *m, size_t *at)
{
    if (m->n_marks == 0)
        return spin_pickle_bad(m, "no mark on the stack");
    *at = m->mark[--m->n_marks];
    return SPIN_OK;
}

spin_status spin_pickle_put_memo(struct spin_pickle_machine *m, uint64_t slot)
{
    SPIN_TRY(spin_pickle_need(m, 1));
    if (slot > m->n_ops)
        return spin_pickle_bad(m, "a memo slot far beyond those used so far");
    while (m->n_memo <= slot) {
        SPIN_TRY(spin_pickle_room_for(m, (void **)&m->memo, m->n_memo, &m->memo_capacity,
                                      sizeof *m->memo));
        m->memo[m->n_memo++] = NULL;
    }
    m->memo[slot] = m->stack[m->n_stack - 1];
    return SPIN_OK;
}

spin_status spin_pickle_get_memo(struct spin_pickle_machine *m, uint64_t slot)
{
    if (slot >= m->n_memo || !m->memo[slot])
        return spin_pickle_bad(m, "a memo slot that was never set");
    return spin_pickle_push(m, m->memo[slot]);
}

/* ---- Plain values ---------------------------------------------------------------------------- */

static spin_status new_int(struct spin_pickle_machine *m, int64_t value, struct spin_value **out)
{
    bool small = value >= 0 && value < 256;
    struct spin_pickle_node *node;

    if (small && m->small[value]) {
        *out = m->small[value];
        return SPIN_OK;
    }
    SPIN_TRY(spin_pickle_new_node(m, SPIN_VALUE_INT, PLAIN, &node));
    node->v.integer = value;
    node->v.number = (double)value;
    *out = &node->v;
    if (small)
        m->small[value] = *out;
    return SPIN_OK;
}

spin_status spin_pickle_push_int(struct spin_pickle_machine *m, int64_t value)
{
    struct spin_value *v;

    SPIN_TRY(new_int(m, value, &v));
    return spin_pickle_push(m, v);
}

spin_status spin_pickle_push_float(struct spin_pickle_machine *m, double value)
{
    struct spin_pickle_node *node;

    SPIN_TRY(spin_pickle_new_node(m, SPIN_VALUE_FLOAT, PLAIN, &node));
    node->v.number = value;
    return spin_pickle_push(m, &node->v);
}

/* None, True and False: one of each. */
spin_status spin_pickle_push_constant(struct spin_pickle_machine *m, struct spin_value **kept,
                                      enum spin_value_kind kind, int value)
{
    struct spin_pickle_node *node;

    if (!*kept) {
        SPIN_TRY(spin_pickle_new_node(m, kind, PLAIN, &node));
        node->v.integer = value;
        node->v.number = value;
        *kept = &node->v;
    }
    return spin_pickle_push(m, *kept);
}

/* Two's complement, little-endian, any length. What does not fit in 64 bits is the nearest limit, with
 * the magnitude in `number`: an error only where it is needed. */
spin_status spin_pickle_push_long(struct spin_pickle_machine *m, const unsigned char *p, size_t n)
{
    bool negative = n > 0 && p[n - 1] & 0x80;
    uint64_t low = negative ? UINT64_MAX : 0;
    bool fits = true;
    double number = negative ? -1 : 0;
    struct spin_pickle_node *node;

    for (size_t i = 0; i < n && i < 8; i++)
        low = (low & ~((uint64_t)0xff << 8 * i)) | (uint64_t)p[i] << 8 * i;
    for (size_t i = 8; i < n; i++)
        fits = fits && p[i] == (negative ? 0xff : 0);
    fits = fits && (n < 8 || (low >> 63 != 0) == negative);
    if (fits)
        return spin_pickle_push_int(m, (int64_t)low);
    for (size_t i = n; i-- > 0;)
        number = i == n - 1 ? (double)(signed char)p[i] : number * 256 + p[i];
    SPIN_TRY(spin_pickle_new_node(m, SPIN_VALUE_INT, PLAIN, &node));
    node->v.integer = negative ? INT64_MIN : INT64_MAX;
    node->v.number = number;
    return spin_pickle_push(m, &node->v);
}

spin_status spin_pickle_copy_text(struct spin_pickle_machine *m, const void *text, size_t n,
                                  const char **out)
{
    void *copy;

    SPIN_TRY(spin_pickle_take(m, n + 1, &copy));
    memcpy(copy, text, n);
    *out = copy;
    return SPIN_OK;
}

spin_status spin_pickle_push_text(struct spin_pickle_machine *m, enum spin_value_kind kind,
                                  const unsigned char *p, size_t n)
{
    struct spin_pickle_node *node;

    SPIN_TRY(spin_pickle_new_node(m, kind, PLAIN, &node));
    SPIN_TRY(spin_pickle_copy_text(m, p, n, &node->v.text));
    node->v.n = n;
    return spin_pickle_push(m, &node->v);
}

/* ---- Containers ------------------------------------------------------------------------------ */

spin_status spin_pickle_deepen(struct spin_pickle_machine *m, struct spin_pickle_node *parent,
                               struct spin_value *child)
{
    unsigned depth = spin_pickle_node(child)->depth + 1u;

    if (depth > MAX_DEPTH)
        return spin_pickle_bad(m, "nested deeper than any checkpoint");
    if (depth > parent->depth)
        parent->depth = (uint16_t)depth;
    return SPIN_OK;
}

/* The n values from `at` on become a tuple in their place. */
spin_status spin_pickle_make_tuple(struct spin_pickle_machine *m, size_t at)
{
    size_t n = m->n_stack - at;
    struct spin_pickle_node *node;
    void *items;

    if (n == 0 && m->empty_tuple)
        return spin_pickle_push(m, m->empty_tuple);
    SPIN_TRY(spin_pickle_new_node(m, SPIN_VALUE_TUPLE, PLAIN, &node));
    if (n > 0) {
        SPIN_TRY(spin_pickle_take(m, n * sizeof *node->v.item, &items));
        memcpy(items, m->stack + at, n * sizeof *node->v.item);
        node->v.item = items;
    } else {
        m->empty_tuple = &node->v;
    }
    node->v.n = n;
    for (size_t i = 0; i < n; i++)
        SPIN_TRY(spin_pickle_deepen(m, node, node->v.item[i]));
    m->n_stack = at;
    return spin_pickle_push(m, &node->v);
}

spin_status spin_pickle_push_empty(struct spin_pickle_machine *m, enum spin_value_kind kind)
{
    struct spin_pickle_node *node;

    SPIN_TRY(spin_pickle_new_node(m, kind, PLAIN, &node));
    return spin_pickle_push(m, &node->v);
}

static size_t power_of_two(size_t n)
{
    size_t p = n ? 4 : 0;

    while (p < n)
        p *= 2;
    return p;
}

/* Append pointers; the room is always the next power of two. */
spin_status spin_pickle_append(struct spin_pickle_machine *m, struct spin_value *to, size_t have,
                               struct spin_value *const *from, size_t n)
{
    if (power_of_two(have + n) > power_of_two(have)) {
        void *items;

        SPIN_TRY(spin_pickle_take(m, power_of_two(have + n) * sizeof *to->item, &items));
        if (have)
            memcpy(items, to->item, have * sizeof *to->item);
        to->item = items;
    }
    for (size_t i = 0; i < n; i++) {
        SPIN_TRY(spin_pickle_deepen(m, spin_pickle_node(to), from[i]));
        to->item[have + i] = from[i];
    }
    return SPIN_OK;
}

/* Values from `at` on go into the list below them. */
spin_status spin_pickle_append_items(struct spin_pickle_machine *m, size_t at)
{
    struct spin_value *list;
    size_t n = m->n_stack - at;

    if (at <= spin_pickle_floor(m) || m->stack[at - 1]->kind != SPIN_VALUE_LIST)
        return spin_pickle_bad(m, "items for what is not a list");
    list = m->stack[at - 1];
    SPIN_TRY(spin_pickle_append(m, list, list->n, m->stack + at, n));
    list->n += n;
    m->n_stack = at;
    return SPIN_OK;
}

/* Keys and values from `at` on go into the dict below them. */
spin_status spin_pickle_set_items(struct spin_pickle_machine *m, size_t at)
{
    struct spin_value *dict;
    size_t n = m->n_stack - at;

    if (at <= spin_pickle_floor(m) || m->stack[at - 1]->kind != SPIN_VALUE_DICT)
        return spin_pickle_bad(m, "items for what is not a dict");
    if (n % 2)
        return spin_pickle_bad(m, "a key without a value");
    dict = m->stack[at - 1];
    SPIN_TRY(spin_pickle_append(m, dict, 2 * dict->n, m->stack + at, n));
    dict->n += n / 2;
    m->n_stack = at;
    return SPIN_OK;
}

/* ---- Storages -------------------------------------------------------------------------------- */

static int by_key(const void *a, const void *b)
{
    return strcmp(((const struct spin_storage *)a)->key, ((const struct spin_storage *)b)->key);
}

spin_status spin_pickle_keep_storages(struct spin_pickle_machine *m, struct spin_pickle *out)
{
    size_t n = 0;
    void *block;

    out->n_storages = 0;
    if (m->n_storages == 0)
        return SPIN_OK;
    qsort(m->storage, m->n_storages, sizeof *m->storage, by_key);
    for (size_t i = 0; i < m->n_storages; i++) {
        struct spin_storage *s = &m->storage[i], *last = &m->storage[n ? n - 1 : 0];

        if (n == 0 || strcmp(last->key, s->key) != 0)
            m->storage[n++] = *s;
        else if (s->kind != last->kind || s->item_size != last->item_size ||
                 s->count != last->count)
            return spin_fail(SPIN_E_MALFORMED,
                             "cannot read '%s': storage '%s' has two types or counts", m->what,
                             s->key);
    }
    SPIN_TRY(spin_pickle_take(m, n * sizeof *out->storage, &block));
    out->storage = memcpy(block, m->storage, n * sizeof *out->storage);
    out->n_storages = n;
    m->n_storages = 0;
    return SPIN_OK;
}
