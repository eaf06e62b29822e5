/* Pickles as data: a stack machine after Python's Lib/pickletools.py, of which only the opcodes that
 * build values are there.
 *
 * A global is pushed as the number of a row in a table; REDUCE, NEWOBJ and BUILD switch on that
 * number and make the value it stands for. There is no call. What a file can cost is bounded:
 * lengths by what is left of the input, memo slots by the number of opcodes so far, nesting by a
 * constant, and the sum of all values by a budget. Nothing here recurses, but for a stream inside a
 * pickle (torch.storage._load_from_bytes), once. */
#include "io/pickle_machine.h"

#include <stdlib.h>
#include <string.h>

#include "base/err.h"

static void release(struct spin_pickle_machine *m)
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

static spin_status push_mark(struct spin_pickle_machine *m)
{
    SPIN_TRY(
        spin_pickle_room_for(m, (void **)&m->mark, m->n_marks, &m->mark_capacity, sizeof *m->mark));
    m->mark[m->n_marks++] = m->n_stack;
    return SPIN_OK;
}

static spin_status pop_mark(struct spin_pickle_machine *m, size_t *at)
{
    if (m->n_marks == 0)
        return spin_pickle_bad(m, "no mark on the stack");
    *at = m->mark[--m->n_marks];
    return SPIN_OK;
}

static spin_status put_memo(struct spin_pickle_machine *m, uint64_t slot)
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

static spin_status get_memo(struct spin_pickle_machine *m, uint64_t slot)
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
static spin_status push_long(struct spin_pickle_machine *m, const unsigned char *p, size_t n)
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

static spin_status push_text(struct spin_pickle_machine *m, enum spin_value_kind kind,
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
static spin_status make_tuple(struct spin_pickle_machine *m, size_t at)
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

static spin_status push_empty(struct spin_pickle_machine *m, enum spin_value_kind kind)
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
static spin_status append_items(struct spin_pickle_machine *m, size_t at)
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
static spin_status set_items(struct spin_pickle_machine *m, size_t at)
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

/* The storages, sorted, each once; a key always means the same. */
static spin_status keep_storages(struct spin_pickle_machine *m, struct spin_pickle *out)
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

/* ---- Opcodes ----------------------------------------------------------------------------------- */

enum opcode {
    MARK = 0x28,
    EMPTY_TUPLE = 0x29,
    STOP = 0x2e,
    POP = 0x30,
    POP_MARK = 0x31,
    DUP = 0x32,
    BINBYTES = 0x42,
    SHORT_BINBYTES = 0x43,
    BINFLOAT = 0x47,
    BININT = 0x4a,
    BININT1 = 0x4b,
    BININT2 = 0x4d,
    NONE = 0x4e,
    BINPERSID = 0x51,
    REDUCE = 0x52,
    BINSTRING = 0x54,
    SHORT_BINSTRING = 0x55,
    BINUNICODE = 0x58,
    EMPTY_LIST = 0x5d,
    APPEND = 0x61,
    BUILD = 0x62,
    GLOBAL_OP = 0x63,
    APPENDS = 0x65,
    BINGET = 0x68,
    LONG_BINGET = 0x6a,
    BINPUT = 0x71,
    LONG_BINPUT = 0x72,
    SETITEM = 0x73,
    TUPLE = 0x74,
    SETITEMS = 0x75,
    EMPTY_DICT = 0x7d,
    PROTO = 0x80,
    NEWOBJ = 0x81,
    TUPLE1 = 0x85,
    TUPLE2 = 0x86,
    TUPLE3 = 0x87,
    NEWTRUE = 0x88,
    NEWFALSE = 0x89,
    LONG1 = 0x8a,
    LONG4 = 0x8b,
    SHORT_BINUNICODE = 0x8c,
    BINUNICODE8 = 0x8d,
    BINBYTES8 = 0x8e,
    EMPTY_SET = 0x8f,
    ADDITEMS = 0x90,
    FROZENSET = 0x91,
    STACK_GLOBAL = 0x93,
    MEMOIZE = 0x94,
    FRAME = 0x95,
    BYTEARRAY8 = 0x96
};

/* An unsigned little-endian argument of n bytes. */
static spin_status read_uint(struct spin_pickle_machine *m, int n, uint64_t *out)
{
    *out = 0;
    if (m->end - m->p < n)
        return spin_pickle_bad(m, "cut short");
    for (int i = 0; i < n; i++)
        *out |= (uint64_t)m->p[i] << 8 * i;
    m->p += n;
    return SPIN_OK;
}

/* A length of n_length bytes and as many bytes. */
static spin_status read_bytes(struct spin_pickle_machine *m, int n_length, const unsigned char **p,
                              size_t *n)
{
    uint64_t length;

    SPIN_TRY(read_uint(m, n_length, &length));
    if (length > (uint64_t)(m->end - m->p))
        return spin_pickle_bad(m, "a length beyond its end");
    *p = m->p;
    *n = (size_t)length;
    m->p += length;
    return SPIN_OK;
}

static spin_status op_text(struct spin_pickle_machine *m, enum spin_value_kind kind, int n_length)
{
    const unsigned char *p = NULL;
    size_t n = 0;

    SPIN_TRY(read_bytes(m, n_length, &p, &n));
    return push_text(m, kind, p, n);
}

static spin_status op_long(struct spin_pickle_machine *m, int n_length)
{
    const unsigned char *p = NULL;
    size_t n = 0;

    SPIN_TRY(read_bytes(m, n_length, &p, &n));
    return push_long(m, p, n);
}

static spin_status op_int(struct spin_pickle_machine *m, int n)
{
    uint64_t value;

    SPIN_TRY(read_uint(m, n, &value));
    return spin_pickle_push_int(m, n == 4 ? (int32_t)value : (int64_t)value);
}

static spin_status op_float(struct spin_pickle_machine *m)
{
    uint64_t bits;
    double value;

    SPIN_TRY(read_uint(m, 8, &bits));
    bits = __builtin_bswap64(bits);
    memcpy(&value, &bits, 8);
    return spin_pickle_push_float(m, value);
}

static spin_status op_tuple(struct spin_pickle_machine *m, size_t n)
{
    SPIN_TRY(spin_pickle_need(m, n));
    return make_tuple(m, m->n_stack - n);
}

static spin_status op_from_mark(struct spin_pickle_machine *m, enum opcode op)
{
    size_t at = 0;

    SPIN_TRY(pop_mark(m, &at));
    switch (op) {
    case TUPLE:
    case FROZENSET:
        return make_tuple(m, at);
    case SETITEMS:
        return set_items(m, at);
    case POP_MARK:
        m->n_stack = at;
        return SPIN_OK;
    default:
        return append_items(m, at);
    }
}

static spin_status op_pop(struct spin_pickle_machine *m)
{
    size_t at = 0;

    if (m->n_stack == spin_pickle_floor(m))
        return pop_mark(m, &at);
    (void)spin_pickle_pop(m);
    return SPIN_OK;
}

static spin_status op_memo(struct spin_pickle_machine *m, int n,
                           spin_status (*fn)(struct spin_pickle_machine *, uint64_t))
{
    uint64_t slot;

    SPIN_TRY(read_uint(m, n, &slot));
    return fn(m, slot);
}

static spin_status op_proto(struct spin_pickle_machine *m)
{
    uint64_t version;

    SPIN_TRY(read_uint(m, 1, &version));
    if (version < 2 || version > 5)
        return spin_pickle_fail_at(m, SPIN_E_UNSUPPORTED, "a protocol that is not 2 to 5");
    return SPIN_OK;
}

static spin_status op_frame(struct spin_pickle_machine *m)
{
    uint64_t length;

    SPIN_TRY(read_uint(m, 8, &length));
    if (length > (uint64_t)(m->end - m->p))
        return spin_pickle_bad(m, "a length beyond its end");
    return SPIN_OK;
}

static spin_status step(struct spin_pickle_machine *m, unsigned char op)
{
    char why[80];

    switch ((enum opcode)op) {
    case PROTO:
        return op_proto(m);
    case FRAME:
        return op_frame(m);
    case MARK:
        return push_mark(m);
    case POP:
        return op_pop(m);
    case DUP:
        SPIN_TRY(spin_pickle_need(m, 1));
        return spin_pickle_push(m, m->stack[m->n_stack - 1]);
    case NONE:
        return spin_pickle_push_constant(m, &m->none, SPIN_VALUE_NONE, 0);
    case NEWTRUE:
        return spin_pickle_push_constant(m, &m->yes, SPIN_VALUE_BOOL, 1);
    case NEWFALSE:
        return spin_pickle_push_constant(m, &m->no, SPIN_VALUE_BOOL, 0);
    case BININT1:
        return op_int(m, 1);
    case BININT2:
        return op_int(m, 2);
    case BININT:
        return op_int(m, 4);
    case LONG1:
        return op_long(m, 1);
    case LONG4:
        return op_long(m, 4);
    case BINFLOAT:
        return op_float(m);
    case SHORT_BINUNICODE:
        return op_text(m, SPIN_VALUE_TEXT, 1);
    case BINUNICODE:
        return op_text(m, SPIN_VALUE_TEXT, 4);
    case BINUNICODE8:
        return op_text(m, SPIN_VALUE_TEXT, 8);
    case SHORT_BINSTRING:
    case SHORT_BINBYTES:
        return op_text(m, SPIN_VALUE_BYTES, 1);
    case BINSTRING:
    case BINBYTES:
        return op_text(m, SPIN_VALUE_BYTES, 4);
    case BINBYTES8:
    case BYTEARRAY8:
        return op_text(m, SPIN_VALUE_BYTES, 8);
    case EMPTY_TUPLE:
        return make_tuple(m, m->n_stack);
    case TUPLE1:
        return op_tuple(m, 1);
    case TUPLE2:
        return op_tuple(m, 2);
    case TUPLE3:
        return op_tuple(m, 3);
    case EMPTY_SET:
    case EMPTY_LIST:
        return push_empty(m, SPIN_VALUE_LIST);
    case EMPTY_DICT:
        return push_empty(m, SPIN_VALUE_DICT);
    case TUPLE:
    case FROZENSET:
    case SETITEMS:
    case APPENDS:
    case ADDITEMS:
    case POP_MARK:
        return op_from_mark(m, (enum opcode)op);
    case APPEND:
        SPIN_TRY(spin_pickle_need(m, 2));
        return append_items(m, m->n_stack - 1);
    case SETITEM:
        SPIN_TRY(spin_pickle_need(m, 3));
        return set_items(m, m->n_stack - 2);
    case BINPUT:
        return op_memo(m, 1, put_memo);
    case LONG_BINPUT:
        return op_memo(m, 4, put_memo);
    case MEMOIZE:
        return put_memo(m, m->n_memo);
    case BINGET:
        return op_memo(m, 1, get_memo);
    case LONG_BINGET:
        return op_memo(m, 4, get_memo);
    case GLOBAL_OP:
        return spin_pickle_op_global(m);
    case STACK_GLOBAL:
        return spin_pickle_op_stack_global(m);
    case BINPERSID:
        return spin_pickle_op_persistent_id(m);
    case REDUCE:
        return spin_pickle_op_reduce(m);
    case NEWOBJ:
        return spin_pickle_op_newobj(m);
    case BUILD:
        return spin_pickle_op_build(m);
    case STOP:
        break;
    }
    snprintf(why, sizeof why, "opcode 0x%02x, which checkpoints do not use", op);
    return spin_pickle_fail_at(m, SPIN_E_UNSUPPORTED, why);
}

/* One pickle from m->p on, to STOP. */
static spin_status run(struct spin_pickle_machine *m, const struct spin_value **root)
{
    m->op = m->start = m->p;
    if (m->end - m->p < 2)
        return spin_pickle_bad(m, "cut short");
    if (m->p[0] != PROTO)
        return spin_pickle_bad(m, "it does not begin as pickles of protocol 2 to 5 do");
    m->n_stack = m->n_marks = m->n_memo = m->n_ops = 0;
    for (;;) {
        m->op = m->p;
        if (m->p == m->end)
            return spin_pickle_bad(m, "cut short");
        m->n_ops++;
        m->p++;
        if (*m->op == STOP)
            break;
        SPIN_TRY(step(m, *m->op));
    }
    if (m->n_stack != 1 || m->n_marks != 0)
        return spin_pickle_bad(m, "it does not end with one value");
    *root = m->stack[0];
    return SPIN_OK;
}

/* ---- The stream that torch.save wrote before 1.6: five pickles, then the storages ------------ */

static const unsigned char legacy_magic[15] = {0x80, 0x02, 0x8a, 0x0a, 0x6c, 0xfc, 0x9c, 0x46,
                                               0xf9, 0x20, 0x6a, 0xa8, 0x50, 0x19, 0x2e};

bool spin_pickle_is_legacy(const unsigned char *bytes, size_t n)
{
    return n >= sizeof legacy_magic && memcmp(bytes, legacy_magic, sizeof legacy_magic) == 0;
}

/* Count and elements of one storage. */
static spin_status bind_storage(struct spin_pickle_machine *m, const struct spin_pickle *pickle,
                                const struct spin_value *key)
{
    struct spin_storage *s;
    uint64_t count = 0, bytes;
    char name[100];

    m->op = m->p;
    if (!spin_pickle_is_key(key))
        return spin_pickle_bad(m, "a storage whose key is not a number");
    s = (struct spin_storage *)(uintptr_t)spin_pickle_storage(pickle, key->text);
    if (!s)
        return spin_fail(SPIN_E_MALFORMED, "cannot read '%s': storage '%s' is of unknown type",
                         m->what, spin_pickle_shown(key->text, key->n, name));
    if (m->end - m->p < 8)
        return spin_pickle_bad(m, "the storages are cut short");
    for (int i = 0; i < 8; i++)
        count |= (uint64_t)m->p[i] << 8 * (pickle->big_endian ? 7 - i : i);
    m->p += 8;
    if (count != s->count)
        return spin_fail(SPIN_E_MALFORMED,
                         "cannot read '%s': storage '%s' has %llu elements, expected %llu", m->what,
                         s->key, (unsigned long long)count, (unsigned long long)s->count);
    bytes = count * (uint64_t)s->item_size; /* checked at its persistent id */
    if (bytes > (uint64_t)(m->end - m->p))
        return spin_pickle_bad(m, "the storages are cut short");
    s->data = m->p;
    m->p += bytes;
    return SPIN_OK;
}

/* The pickles: magic number, version, byte order, the object, the keys in order; then the data. */
static spin_status run_legacy(struct spin_pickle_machine *m, struct spin_pickle *out)
{
    const struct spin_value *version, *system, *keys, *little;

    if (!spin_pickle_is_legacy(m->p, (size_t)(m->end - m->p)))
        return spin_fail(SPIN_E_MALFORMED, "cannot read '%s': no stream of torch.save", m->what);
    m->p += sizeof legacy_magic;
    SPIN_TRY(run(m, &version));
    if (version->kind != SPIN_VALUE_INT || version->integer != 1001)
        return spin_pickle_fail_at(m, SPIN_E_UNSUPPORTED,
                                   "a torch.save stream that is not of version 1001");
    SPIN_TRY(run(m, &system));
    little = spin_value_get(system, "little_endian");
    if (!little || little->kind != SPIN_VALUE_BOOL)
        return spin_pickle_bad(m, "no word about the byte order");
    out->big_endian = !little->integer;
    m->n_storages = 0;
    SPIN_TRY(run(m, &out->root));
    SPIN_TRY(keep_storages(m, out));
    SPIN_TRY(run(m, &keys));
    if (keys->kind != SPIN_VALUE_LIST)
        return spin_pickle_bad(m, "no list of storages");
    for (size_t i = 0; i < keys->n; i++)
        SPIN_TRY(bind_storage(m, out, keys->item[i]));
    for (size_t i = 0; i < out->n_storages; i++)
        if (!out->storage[i].data)
            return spin_fail(SPIN_E_MALFORMED, "cannot read '%s': storage '%s' is missing", m->what,
                             out->storage[i].key);
    return SPIN_OK;
}

spin_status spin_pickle_load_from_bytes(struct spin_pickle_machine *m,
                                        const struct spin_value *args)
{
    struct spin_pickle_machine inner = {.what = m->what, .arena = m->arena, .level = m->level + 1};
    struct spin_pickle stream = {0};
    const struct spin_storage *s;
    spin_status status;
    struct spin_pickle_node *node;

    if (args->n != 1 || args->item[0]->kind != SPIN_VALUE_BYTES)
        return spin_pickle_bad(m, "a storage that is not made of bytes");
    if (inner.level > 1)
        return spin_pickle_bad(m, "a stream inside a stream inside a pickle");
    inner.start = inner.op = inner.p = (const unsigned char *)args->item[0]->text;
    inner.end = inner.p + args->item[0]->n;
    inner.budget = m->budget;
    status = run_legacy(&inner, &stream);
    m->budget = inner.budget;
    release(&inner);
    SPIN_TRY(status);
    if (stream.root->kind != SPIN_VALUE_OBJECT ||
        spin_pickle_node((struct spin_value *)(uintptr_t)stream.root)->role != STORAGE)
        return spin_pickle_bad(m, "a stream that does not hold one storage");
    s = spin_pickle_storage(&stream, stream.root->tensor.storage);
    SPIN_TRY(spin_pickle_new_node(m, SPIN_VALUE_OBJECT, STORAGE, &node));
    node->v.text = stream.root->text;
    node->v.tensor = stream.root->tensor;
    node->v.tensor.storage = NULL;
    node->v.tensor.data = s->data;
    node->v.tensor.big_endian = stream.big_endian && s->item_size > 1;
    return spin_pickle_push(m, &node->v);
}

/* ---- The machine put together ------------------------------------------------------------------ */

static spin_status parse(const char *what, const unsigned char *bytes, size_t n, bool legacy,
                         struct spin_pickle *out)
{
    struct spin_pickle_machine m = {.what = what,
                                    .start = bytes,
                                    .p = bytes,
                                    .op = bytes,
                                    .end = bytes + n,
                                    .arena = &out->arena};
    spin_status status;

    memset(out, 0, sizeof *out);
    if (legacy) {
        m.budget = BUDGET; /* the rest is storages, which are not copied */
        SPIN_TRY_OUT(run_legacy(&m, out));
    } else {
        m.budget = n < SIZE_MAX - BUDGET ? BUDGET + n : BUDGET;
        SPIN_TRY_OUT(run(&m, &out->root));
        SPIN_TRY_OUT(keep_storages(&m, out));
    }
    out->used = (size_t)(m.p - bytes);
out:
    release(&m);
    if (status != SPIN_OK)
        spin_pickle_free(out);
    return status;
}

spin_status spin_pickle_parse(const char *what, const unsigned char *bytes, size_t n,
                              struct spin_pickle *out)
{
    return parse(what, bytes, n, false, out);
}

spin_status spin_pickle_parse_legacy(const char *what, const unsigned char *bytes, size_t n,
                                     struct spin_pickle *out)
{
    return parse(what, bytes, n, true, out);
}

/* ---- Values, looked up ------------------------------------------------------------------------- */

void spin_pickle_free(struct spin_pickle *pickle)
{
    spin_arena_free(&pickle->arena);
    memset(pickle, 0, sizeof *pickle);
}

static int compare_key(const void *key, const void *row)
{
    return strcmp(key, ((const struct spin_storage *)row)->key);
}

const struct spin_storage *spin_pickle_storage(const struct spin_pickle *pickle, const char *key)
{
    if (!key || pickle->n_storages == 0)
        return NULL;
    return bsearch(key, pickle->storage, pickle->n_storages, sizeof *pickle->storage, compare_key);
}

bool spin_value_is_sequence(const struct spin_value *v)
{
    return v->kind == SPIN_VALUE_TUPLE || v->kind == SPIN_VALUE_LIST;
}

/* Of two equal keys the later counts, as in Python. */
const struct spin_value *spin_value_get(const struct spin_value *dict, const char *key)
{
    if (!dict || dict->kind != SPIN_VALUE_DICT)
        return NULL;
    for (size_t i = dict->n; i-- > 0;) {
        const struct spin_value *k = dict->item[2 * i];

        if (k->kind == SPIN_VALUE_TEXT && strlen(key) == k->n && memcmp(k->text, key, k->n) == 0)
            return dict->item[2 * i + 1];
    }
    return NULL;
}

const struct spin_value *spin_value_at(const struct spin_value *list_or_tuple, size_t index)
{
    if (!list_or_tuple || !spin_value_is_sequence(list_or_tuple) || index >= list_or_tuple->n)
        return NULL;
    return list_or_tuple->item[index];
}

const char *spin_value_text(const struct spin_value *v)
{
    return v && (v->kind == SPIN_VALUE_TEXT || v->kind == SPIN_VALUE_BYTES) ? v->text : NULL;
}

bool spin_value_number(const struct spin_value *v, double *out)
{
    if (!v)
        return false;
    switch (v->kind) {
    case SPIN_VALUE_BOOL:
    case SPIN_VALUE_INT:
    case SPIN_VALUE_FLOAT:
        *out = v->number;
        return true;
    case SPIN_VALUE_TENSOR:
        if (v->tensor.count != 1 || !v->tensor.data)
            return false;
        spin_array_to_f64(&v->tensor, 0, 1, out);
        return true;
    default:
        return false;
    }
}
