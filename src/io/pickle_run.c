/* Pickles as data: a stack machine after Python's Lib/pickletools.py, of which only the opcodes that
 * build values are there.
 *
 * A global is pushed as the number of a row in a table; REDUCE, NEWOBJ and BUILD switch on that
 * number and make the value it stands for. There is no call. What a file can cost is bounded:
 * lengths by what is left of the input, memo slots by the number of opcodes so far, nesting by a
 * constant, and the sum of all values by a budget. Nothing here recurses, but for a stream inside a
 * pickle (torch.storage._load_from_bytes), once. */
#include "io/pickle_run.h"

#include <string.h>

#include "base/err.h"
#include "io/pickle_types.h"

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
    return spin_pickle_push_text(m, kind, p, n);
}

static spin_status op_long(struct spin_pickle_machine *m, int n_length)
{
    const unsigned char *p = NULL;
    size_t n = 0;

    SPIN_TRY(read_bytes(m, n_length, &p, &n));
    return spin_pickle_push_long(m, p, n);
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
    return spin_pickle_make_tuple(m, m->n_stack - n);
}

static spin_status op_from_mark(struct spin_pickle_machine *m, enum opcode op)
{
    size_t at = 0;

    SPIN_TRY(spin_pickle_pop_mark(m, &at));
    switch (op) {
    case TUPLE:
    case FROZENSET:
        return spin_pickle_make_tuple(m, at);
    case SETITEMS:
        return spin_pickle_set_items(m, at);
    case POP_MARK:
        m->n_stack = at;
        return SPIN_OK;
    default:
        return spin_pickle_append_items(m, at);
    }
}

static spin_status op_pop(struct spin_pickle_machine *m)
{
    size_t at = 0;

    if (m->n_stack == spin_pickle_floor(m))
        return spin_pickle_pop_mark(m, &at);
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
        return spin_pickle_push_mark(m);
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
        return spin_pickle_make_tuple(m, m->n_stack);
    case TUPLE1:
        return op_tuple(m, 1);
    case TUPLE2:
        return op_tuple(m, 2);
    case TUPLE3:
        return op_tuple(m, 3);
    case EMPTY_SET:
    case EMPTY_LIST:
        return spin_pickle_push_empty(m, SPIN_VALUE_LIST);
    case EMPTY_DICT:
        return spin_pickle_push_empty(m, SPIN_VALUE_DICT);
    case TUPLE:
    case FROZENSET:
    case SETITEMS:
    case APPENDS:
    case ADDITEMS:
    case POP_MARK:
        return op_from_mark(m, (enum opcode)op);
    case APPEND:
        SPIN_TRY(spin_pickle_need(m, 2));
        return spin_pickle_append_items(m, m->n_stack - 1);
    case SETITEM:
        SPIN_TRY(spin_pickle_need(m, 3));
        return spin_pickle_set_items(m, m->n_stack - 2);
    case BINPUT:
        return op_memo(m, 1, spin_pickle_put_memo);
    case LONG_BINPUT:
        return op_memo(m, 4, spin_pickle_put_memo);
    case MEMOIZE:
        return spin_pickle_put_memo(m, m->n_memo);
    case BINGET:
        return op_memo(m, 1, spin_pickle_get_memo);
    case LONG_BINGET:
        return op_memo(m, 4, spin_pickle_get_memo);
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

spin_status spin_pickle_run(struct spin_pickle_machine *m, const struct spin_value **root)
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
