/* Pickles as data: a stack machine modelled on Python's Lib/pickletools.py, with only the opcodes
 * that build values.
 *
 * A global is pushed as its index in a table; REDUCE, NEWOBJ and BUILD switch on that index and
 * create or change values as the global would. No code is called. The cost of reading a file is
 * bounded: lengths by the remaining input, memo slots by the number of opcodes executed, nesting by
 * a constant, and the total of all values by a budget. Nothing recurses, except for one level of a
 * stream inside a pickle (torch.storage._load_from_bytes). */
#include "io/torch.h"

#include "base/base.h"

/* Limit of the memory for values, in bytes. For a pickle that is not in a legacy stream, the size
 * of the input is added. Real checkpoints need kilobytes. */
#define BUDGET ((size_t)32 << 20)
#define SLAB ((size_t)16 << 10) /* small values are allocated in blocks of this size */
#define MAX_DEPTH 256

enum role {
    PLAIN,
    GLOBAL, /* a global; id: its index in globals[] */
    DTYPE,  /* a dtype of numpy: `tensor` contains its kind, item_size and big_endian */
    /* A storage. `tensor` describes it: its kind, item_size and storage_count; `offset`, the start
     * of the view of the storage; and either its key in `storage` or its elements in `data`. */
    STORAGE,
    ORDERED,  /* a dict created as an OrderedDict */
    UNFILLED, /* a numpy array whose elements a BUILD will set */
    INSTANCE  /* an object; id: index of its class in globals[]; a BUILD may set its state */
};

struct node {
    unsigned char role, id;
    uint16_t depth;
    struct spin_value v;
};

struct machine {
    const char *what;
    const unsigned char *start, *p, *end;
    const unsigned char *op; /* start of the current opcode */
    struct spin_arena *arena;
    char *slab;
    size_t slab_left, budget;
    struct spin_value **stack, **memo;
    size_t n_stack, stack_capacity, n_memo, memo_capacity;
    size_t *mark, n_marks, mark_capacity;
    struct spin_storage *storage; /* one entry for each persistent id, unsorted, with duplicates */
    size_t n_storages, storage_capacity;
    size_t n_ops;
    int level;     /* 1 within a legacy stream inside a pickle, else 0 */
    bool in_model; /* a class with G_MODEL has occurred; see enum global */
    struct spin_value *none, *yes, *no, *empty_tuple, *small[256];
};

static struct node *node_of(struct spin_value *v)
{
    return (struct node *)(void *)((char *)v - offsetof(struct node, v));
}

/* Returns the stack index of the first value above the last mark; values with lower indices must
 * not be popped. */
static size_t stack_floor(const struct machine *m)
{
    return m->n_marks ? m->mark[m->n_marks - 1] : 0;
}

static struct spin_value *pop_value(struct machine *m) { return m->stack[--m->n_stack]; }

static void free_machine(struct machine *m)
{
    free(m->stack);
    free(m->memo);
    free(m->mark);
    free(m->storage);
}

static spin_status fail_at(const struct machine *m, spin_status code, const char *why)
{
    return spin_fail(code, "cannot read '%s': its pickle is not valid at byte %zu: %s", m->what,
                     (size_t)(m->op - m->start), why);
}

static spin_status fail_malformed(const struct machine *m, const char *why)
{
    return fail_at(m, SPIN_E_MALFORMED, why);
}

/* Prepare text from the file for messages: cut it off after 99 characters, and replace characters
 * that are not printable ASCII by '?'. */
static const char *printable(const char *text, size_t n, char out[100])
{
    size_t i = 0;

    for (; i < n && i < 99; i++)
        out[i] = text[i] < 0x20 || text[i] > 0x7e ? '?' : text[i];
    out[i] = '\0';
    return out;
}

static spin_status spend_budget(struct machine *m, size_t bytes)
{
    if (bytes > m->budget)
        return fail_malformed(m, "its values need too much memory for a checkpoint");
    m->budget -= bytes;
    return SPIN_OK;
}

static spin_status allocate_value(struct machine *m, size_t bytes, void **out)
{
    bytes = (bytes + 15) & ~(size_t)15;
    SPIN_TRY(spend_budget(m, bytes));
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

/* The member v.tensor is allocated only for values that describe elements: tensors, dtypes and
 * storages. */
static spin_status new_node(struct machine *m, enum spin_value_kind kind, enum role role,
                            struct node **out)
{
    bool whole = kind == SPIN_VALUE_TENSOR || role == DTYPE || role == STORAGE;
    void *block;

    SPIN_TRY(allocate_value(m, whole ? sizeof **out : offsetof(struct node, v.tensor), &block));
    *out = block;
    (*out)->role = (unsigned char)role;
    (*out)->v.kind = kind;
    return SPIN_OK;
}

/* Ensure that a growing array of n items has capacity for one more. */
static spin_status room_for(struct machine *m, void **array, size_t n, size_t *capacity,
                            size_t size)
{
    size_t wanted;

    if (n < *capacity)
        return SPIN_OK;
    wanted = *capacity ? 2 * *capacity : 64;
    SPIN_TRY(spend_budget(m, (wanted - *capacity) * size));
    SPIN_TRY(spin_grow(wanted, size, array));
    memset((char *)*array + *capacity * size, 0, (wanted - *capacity) * size);
    *capacity = wanted;
    return SPIN_OK;
}

/* ---- The stack ------------------------------------------------------------------------------ */

static spin_status push_value(struct machine *m, struct spin_value *v)
{
    SPIN_TRY(room_for(m, (void **)&m->stack, m->n_stack, &m->stack_capacity, sizeof *m->stack));
    m->stack[m->n_stack++] = v;
    return SPIN_OK;
}

/* Check that there are at least n values above the last mark. */
static spin_status need_values(const struct machine *m, size_t n)
{
    if (m->n_stack - stack_floor(m) < n)
        return fail_malformed(m, "too few values on the stack");
    return SPIN_OK;
}

static spin_status push_mark(struct machine *m)
{
    SPIN_TRY(room_for(m, (void **)&m->mark, m->n_marks, &m->mark_capacity, sizeof *m->mark));
    m->mark[m->n_marks++] = m->n_stack;
    return SPIN_OK;
}

static spin_status pop_mark(struct machine *m, size_t *at)
{
    if (m->n_marks == 0)
        return fail_malformed(m, "no mark on the stack");
    *at = m->mark[--m->n_marks];
    return SPIN_OK;
}

static spin_status put_memo(struct machine *m, uint64_t slot)
{
    SPIN_TRY(need_values(m, 1));
    if (slot > m->n_ops)
        return fail_malformed(m, "a memo index out of range");
    while (m->n_memo <= slot) {
        SPIN_TRY(room_for(m, (void **)&m->memo, m->n_memo, &m->memo_capacity, sizeof *m->memo));
        m->memo[m->n_memo++] = NULL;
    }
    m->memo[slot] = m->stack[m->n_stack - 1];
    return SPIN_OK;
}

static spin_status get_memo(struct machine *m, uint64_t slot)
{
    if (slot >= m->n_memo || !m->memo[slot])
        return fail_malformed(m, "a memo entry that was never set");
    return push_value(m, m->memo[slot]);
}

/* ---- Plain values --------------------------------------------------------------------------- */

static spin_status new_int(struct machine *m, int64_t value, struct spin_value **out)
{
    bool small = value >= 0 && value < 256;
    struct node *node;

    if (small && m->small[value]) {
        *out = m->small[value];
        return SPIN_OK;
    }
    SPIN_TRY(new_node(m, SPIN_VALUE_INT, PLAIN, &node));
    node->v.integer = value;
    node->v.number = (double)value;
    *out = &node->v;
    if (small)
        m->small[value] = *out;
    return SPIN_OK;
}

static spin_status push_int(struct machine *m, int64_t value)
{
    struct spin_value *v;

    SPIN_TRY(new_int(m, value, &v));
    return push_value(m, v);
}

static spin_status push_float(struct machine *m, double value)
{
    struct node *node;

    SPIN_TRY(new_node(m, SPIN_VALUE_FLOAT, PLAIN, &node));
    node->v.number = value;
    return push_value(m, &node->v);
}

/* Push None, True or False. The value is created once and then kept in *kept. */
static spin_status push_constant(struct machine *m, struct spin_value **kept,
                                 enum spin_value_kind kind, int value)
{
    struct node *node;

    if (!*kept) {
        SPIN_TRY(new_node(m, kind, PLAIN, &node));
        node->v.integer = value;
        node->v.number = value;
        *kept = &node->v;
    }
    return push_value(m, *kept);
}

/* Push a little-endian two's complement integer of any length. Values beyond 64 bits are clamped,
 * with their magnitude in `number`; callers that cannot use such a value report an error. */
static spin_status push_long(struct machine *m, const unsigned char *p, size_t n)
{
    bool negative = n > 0 && p[n - 1] & 0x80;
    uint64_t low = negative ? UINT64_MAX : 0;
    bool fits = true;
    double number = negative ? -1 : 0;
    struct node *node;

    for (size_t i = 0; i < n && i < 8; i++)
        low = (low & ~((uint64_t)0xff << 8 * i)) | (uint64_t)p[i] << 8 * i;
    for (size_t i = 8; i < n; i++)
        fits = fits && p[i] == (negative ? 0xff : 0);
    fits = fits && (n < 8 || (low >> 63 != 0) == negative);
    if (fits)
        return push_int(m, (int64_t)low);
    for (size_t i = n; i-- > 0;)
        number = i == n - 1 ? (double)(signed char)p[i] : number * 256 + p[i];
    SPIN_TRY(new_node(m, SPIN_VALUE_INT, PLAIN, &node));
    node->v.integer = negative ? INT64_MIN : INT64_MAX;
    node->v.number = number;
    return push_value(m, &node->v);
}

static spin_status copy_text(struct machine *m, const void *text, size_t n, const char **out)
{
    void *copy;

    SPIN_TRY(allocate_value(m, n + 1, &copy));
    memcpy(copy, text, n);
    *out = copy;
    return SPIN_OK;
}

static spin_status push_text(struct machine *m, enum spin_value_kind kind, const unsigned char *p,
                             size_t n)
{
    struct node *node;

    SPIN_TRY(new_node(m, kind, PLAIN, &node));
    SPIN_TRY(copy_text(m, p, n, &node->v.text));
    node->v.n = n;
    return push_value(m, &node->v);
}

/* ---- Containers ----------------------------------------------------------------------------- */

static spin_status update_depth(struct machine *m, struct node *parent, struct spin_value *child)
{
    unsigned depth = node_of(child)->depth + 1u;

    if (depth > MAX_DEPTH)
        return fail_malformed(m, "values nested too deeply for a checkpoint");
    if (depth > parent->depth)
        parent->depth = (uint16_t)depth;
    return SPIN_OK;
}

/* Replace the values from stack index `at` on by one tuple that contains them. */
static spin_status make_tuple(struct machine *m, size_t at)
{
    size_t n = m->n_stack - at;
    struct node *node;
    void *items;

    if (n == 0 && m->empty_tuple)
        return push_value(m, m->empty_tuple);
    SPIN_TRY(new_node(m, SPIN_VALUE_TUPLE, PLAIN, &node));
    if (n > 0) {
        SPIN_TRY(allocate_value(m, n * sizeof *node->v.item, &items));
        memcpy(items, m->stack + at, n * sizeof *node->v.item);
        node->v.item = items;
    } else {
        m->empty_tuple = &node->v;
    }
    node->v.n = n;
    for (size_t i = 0; i < n; i++)
        SPIN_TRY(update_depth(m, node, node->v.item[i]));
    m->n_stack = at;
    return push_value(m, &node->v);
}

static spin_status push_empty(struct machine *m, enum spin_value_kind kind)
{
    struct node *node;

    SPIN_TRY(new_node(m, kind, PLAIN, &node));
    return push_value(m, &node->v);
}

static size_t power_of_two(size_t n)
{
    size_t p = n ? 4 : 0;

    while (p < n)
        p *= 2;
    return p;
}

/* Append n pointers to the `have` pointers of a value. The capacity of to->item is always the
 * number of pointers rounded up to a power of two. */
static spin_status append_pointers(struct machine *m, struct spin_value *to, size_t have,
                                   struct spin_value *const *from, size_t n)
{
    if (power_of_two(have + n) > power_of_two(have)) {
        void *items;

        SPIN_TRY(allocate_value(m, power_of_two(have + n) * sizeof *to->item, &items));
        if (have)
            memcpy(items, to->item, have * sizeof *to->item);
        to->item = items;
    }
    for (size_t i = 0; i < n; i++) {
        SPIN_TRY(update_depth(m, node_of(to), from[i]));
        to->item[have + i] = from[i];
    }
    return SPIN_OK;
}

/* Pop the values from stack index `at` on, and append them to the list below them. */
static spin_status append_items(struct machine *m, size_t at)
{
    struct spin_value *list;
    size_t n = m->n_stack - at;

    if (at <= stack_floor(m) || m->stack[at - 1]->kind != SPIN_VALUE_LIST)
        return fail_malformed(m, "items for a value that is not a list");
    list = m->stack[at - 1];
    SPIN_TRY(append_pointers(m, list, list->n, m->stack + at, n));
    list->n += n;
    m->n_stack = at;
    return SPIN_OK;
}

/* Pop the keys and values from stack index `at` on, and add them to the dict below them. */
static spin_status set_items(struct machine *m, size_t at)
{
    struct spin_value *dict;
    size_t n = m->n_stack - at;

    if (at <= stack_floor(m) || m->stack[at - 1]->kind != SPIN_VALUE_DICT)
        return fail_malformed(m, "items for a value that is not a dict");
    if (n % 2)
        return fail_malformed(m, "a key without a value");
    dict = m->stack[at - 1];
    SPIN_TRY(append_pointers(m, dict, 2 * dict->n, m->stack + at, n));
    dict->n += n / 2;
    m->n_stack = at;
    return SPIN_OK;
}

/* ---- Storages ------------------------------------------------------------------------------- */

static int by_key(const void *a, const void *b)
{
    return strcmp(((const struct spin_storage *)a)->key, ((const struct spin_storage *)b)->key);
}

/* Sort the storages and remove duplicates, which must agree in type and count. */
static spin_status keep_storages(struct machine *m, struct spin_pickle *out)
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
            return spin_malformed(
                "cannot read '%s': storage '%s' occurs with different types or sizes", m->what,
                s->key);
    }
    SPIN_TRY(allocate_value(m, n * sizeof *out->storage, &block));
    out->storage = memcpy(block, m->storage, n * sizeof *out->storage);
    out->n_storages = n;
    m->n_storages = 0;
    return SPIN_OK;
}

/* Execute torch.storage._load_from_bytes, whose argument is a bytes object with a complete legacy
 * stream: push the storage that the stream contains. */
static spin_status load_from_bytes(struct machine *m, const struct spin_value *args);

/* ---- The globals that a pickle may refer to; any other is refused --------------------------- */

/* Maximum number of elements of a tensor that repeats elements (stride 0) and therefore has more
 * elements than its storage. */
#define MAX_REPEATED ((uint64_t)1 << 22)

enum global {
    G_TENSOR_V2,
    G_TENSOR,
    G_PARAMETER,
    G_STORAGE,
    G_ORDERED_DICT,
    G_SIZE,
    G_SCALAR,
    G_RECONSTRUCT,
    G_FROMBUFFER,
    G_NDARRAY,
    G_DTYPE,
    G_ENCODE,
    G_LOAD_FROM_BYTES,
    G_OBJECT,
    /* The following globals are accepted only after the class of a model that was saved as an
     * object: that class itself; the classes of its parts, whose states are read as data;
     * constants; and set(). */
    G_MODEL,
    G_PART,
    G_CONSTANT,
    G_SET
};

static const struct {
    const char *module, *name;
    enum global id;
    char kind; /* for storages: letter of the element type */
    int item_size;
} globals[] = {
    {"torch._utils", "_rebuild_tensor_v2", G_TENSOR_V2, 0, 0},
    {"torch._utils", "_rebuild_tensor", G_TENSOR, 0, 0},
    {"torch._utils", "_rebuild_parameter", G_PARAMETER, 0, 0},
    {"torch._utils", "_rebuild_parameter_with_state", G_PARAMETER, 0, 0},
    {"torch", "FloatStorage", G_STORAGE, 'f', 4},
    {"torch", "DoubleStorage", G_STORAGE, 'f', 8},
    {"torch", "HalfStorage", G_STORAGE, 'f', 2},
    {"torch", "BFloat16Storage", G_STORAGE, 'B', 2},
    {"torch", "LongStorage", G_STORAGE, 'i', 8},
    {"torch", "IntStorage", G_STORAGE, 'i', 4},
    {"torch", "ShortStorage", G_STORAGE, 'i', 2},
    {"torch", "CharStorage", G_STORAGE, 'i', 1},
    {"torch", "ByteStorage", G_STORAGE, 'u', 1},
    {"torch", "BoolStorage", G_STORAGE, 'b', 1},
    {"collections", "OrderedDict", G_ORDERED_DICT, 0, 0},
    {"torch", "Size", G_SIZE, 0, 0},
    {"numpy.core.multiarray", "scalar", G_SCALAR, 0, 0},
    {"numpy._core.multiarray", "scalar", G_SCALAR, 0, 0},
    {"numpy.core.multiarray", "_reconstruct", G_RECONSTRUCT, 0, 0},
    {"numpy._core.multiarray", "_reconstruct", G_RECONSTRUCT, 0, 0},
    {"numpy.core.numeric", "_frombuffer", G_FROMBUFFER, 0, 0},
    {"numpy._core.numeric", "_frombuffer", G_FROMBUFFER, 0, 0},
    {"numpy", "ndarray", G_NDARRAY, 0, 0},
    {"numpy", "dtype", G_DTYPE, 0, 0},
    {"_codecs", "encode", G_ENCODE, 0, 0},
    {"torch.storage", "_load_from_bytes", G_LOAD_FROM_BYTES, 0, 0},
    {"dahuffman.huffmancodec", "_EndOfFileSymbol", G_OBJECT, 0, 0},
    {"argparse", "Namespace", G_OBJECT, 0, 0},
    {"ftgspp.models.gaussians", "Gaussians", G_MODEL, 0, 0},
    {"ftgspp.models.velocity", "VelocityField", G_PART, 0, 0},
    {"ftgspp.models.velocity", "Bounds", G_PART, 0, 0},
    {"ftgspp.models.velocity", "HyperMLP", G_PART, 0, 0},
    {"ftgspp.models.velocity", "MLP", G_PART, 0, 0},
    {"tinycudann.modules", "Encoding", G_PART, 0, 0},
    {"tinycudann_bindings", "Precision", G_PART, 0, 0},
    {"torch.nn.modules.container", "ModuleList", G_PART, 0, 0},
    {"torch.nn.modules.linear", "Linear", G_PART, 0, 0},
    {"torch.nn.functional", "relu", G_CONSTANT, 0, 0},
    {"torch", "float16", G_CONSTANT, 0, 0},
    {"torch", "float32", G_CONSTANT, 0, 0},
    {"__builtin__", "set", G_SET, 0, 0},
    {"builtins", "set", G_SET, 0, 0},
};
enum { N_GLOBALS = sizeof globals / sizeof *globals };

/* Globals that are refused with a specific message. If `name` is NULL, this applies to all globals
 * of the module and of its submodules. */
static const struct {
    const char *module, *name, *why;
} refused[] = {
    {"torch._utils", "_rebuild_tensor_v3", "a tensor of an element type without a storage class"},
    {"torch.storage", "UntypedStorage", "a tensor of an element type without a storage class"},
    {"torch._tensor", "_rebuild_from_type_v2", "a tensor of a subclass"},
    {"torch._utils", "_rebuild_qtensor", "a quantised tensor"},
    {"torch._utils", "_rebuild_sparse_tensor", "a sparse tensor"},
    {"torch.jit", NULL, "part of a TorchScript program, not of a checkpoint"},
    {"torch.nn", NULL, "a whole model object: save its state_dict() instead"},
    {"__main__", NULL, "an object of the program that wrote it: save a state_dict() instead"},
};

static spin_status refuse_global(const struct machine *m, const char *module, const char *name)
{
    const char *why = "not data that a checkpoint needs; nothing was run";
    char a[100], b[100];

    for (size_t i = 0; i < sizeof refused / sizeof *refused; i++) {
        size_t n = strlen(refused[i].module);

        if (refused[i].name
                ? strcmp(module, refused[i].module) == 0 && strcmp(name, refused[i].name) == 0
                : strncmp(module, refused[i].module, n) == 0 &&
                      (module[n] == '\0' || module[n] == '.'))
            why = refused[i].why;
    }
    return spin_unsupported("cannot read '%s': it refers to '%s.%s', which is %s", m->what,
                            printable(module, strlen(module), a), printable(name, strlen(name), b),
                            why);
}

/* The module of tiny-cuda-nn has a name for each kind of GPU, tinycudann_bindings._<kind>_C. */
static bool is_module(const char *name, const char *known)
{
    size_t n = strlen(known);

    return strcmp(name, known) == 0 || (strcmp(known, "tinycudann_bindings") == 0 &&
                                        strncmp(name, known, n) == 0 && name[n] == '.');
}

static spin_status push_global(struct machine *m, const char *module, const char *name)
{
    struct node *node;
    char full[128];

    for (int i = 0; i < N_GLOBALS; i++) {
        if (!is_module(module, globals[i].module) || strcmp(name, globals[i].name) != 0 ||
            (globals[i].id > G_MODEL && !m->in_model))
            continue;
        m->in_model = m->in_model || globals[i].id == G_MODEL;
        SPIN_TRY(new_node(m, SPIN_VALUE_OBJECT, GLOBAL, &node));
        node->id = (unsigned char)i;
        snprintf(full, sizeof full, "%s.%s", module, name);
        SPIN_TRY(copy_text(m, full, strlen(full), &node->v.text));
        node->v.n = 0;
        return push_value(m, &node->v);
    }
    return refuse_global(m, module, name);
}

/* Read a line into `out`, without its newline. */
static spin_status read_line(struct machine *m, char out[128])
{
    const unsigned char *end = memchr(m->p, '\n', (size_t)(m->end - m->p));
    size_t n;

    if (!end)
        return fail_malformed(m, "cut short");
    n = (size_t)(end - m->p);
    if (n >= 128 || memchr(m->p, '\0', n))
        return fail_malformed(m, "a global with an invalid name");
    memcpy(out, m->p, n);
    out[n] = '\0';
    m->p = end + 1;
    return SPIN_OK;
}

static spin_status op_global(struct machine *m)
{
    char module[128], name[128];

    SPIN_TRY(read_line(m, module));
    SPIN_TRY(read_line(m, name));
    return push_global(m, module, name);
}

static spin_status op_stack_global(struct machine *m)
{
    struct spin_value *name, *module;

    SPIN_TRY(need_values(m, 2));
    name = pop_value(m);
    module = pop_value(m);
    if (name->kind != SPIN_VALUE_TEXT || module->kind != SPIN_VALUE_TEXT || name->n >= 128 ||
        module->n >= 128 || strlen(name->text) != name->n || strlen(module->text) != module->n)
        return fail_malformed(m, "a global with an invalid name");
    return push_global(m, module->text, name->text);
}

static bool is_global(struct spin_value *v, enum global id)
{
    const struct node *node = node_of(v);

    return node->role == GLOBAL && globals[node->id].id == id;
}

/* ---- Tensors -------------------------------------------------------------------------------- */

/* Read a count, which must be a non-negative int; returns false for other values. */
static bool count_of(const struct spin_value *v, uint64_t *out)
{
    if (v->kind != SPIN_VALUE_INT || v->integer < 0 || v->number >= 0x1p63)
        return false;
    *out = (uint64_t)v->integer;
    return true;
}

static bool is_key(const struct spin_value *v)
{
    if (v->kind != SPIN_VALUE_TEXT || v->n == 0 || v->n > 20)
        return false;
    for (size_t i = 0; i < v->n; i++)
        if (v->text[i] < '0' || v->text[i] > '9')
            return false;
    return true;
}

/* Read the view of a storage, a tuple (key, offset, size) that very old files contain. Tensors then
 * begin `offset` elements later in the storage. */
static spin_status read_view(struct machine *m, const struct spin_value *view,
                             struct spin_array *out)
{
    uint64_t offset, size;

    if (view->kind == SPIN_VALUE_NONE)
        return SPIN_OK;
    if (view->kind != SPIN_VALUE_TUPLE || view->n != 3 || !count_of(view->item[1], &offset) ||
        !count_of(view->item[2], &size) || offset > out->storage_count ||
        size > out->storage_count - offset)
        return fail_malformed(m, "a view outside its storage");
    out->offset = offset;
    return SPIN_OK;
}

/* Replace the persistent id on the stack by the storage that it describes. The id is a tuple
 * ('storage', type, key, location, count), which in legacy streams also contains a view. */
static spin_status op_persistent_id(struct machine *m)
{
    struct spin_value *id;
    struct spin_storage *row;
    struct node *node;
    uint64_t count, bytes;
    int type;

    SPIN_TRY(need_values(m, 1));
    id = pop_value(m);
    if (id->kind != SPIN_VALUE_TUPLE || id->n < 5 || id->n > 6 ||
        id->item[0]->kind != SPIN_VALUE_TEXT || strcmp(id->item[0]->text, "storage") != 0)
        return fail_malformed(m, "a persistent id that is not a storage");
    if (!is_global(id->item[1], G_STORAGE))
        return fail_malformed(m, "a storage of unknown type");
    if (!is_key(id->item[2]))
        return fail_malformed(m, "a storage whose key is not a number");
    type = node_of(id->item[1])->id;
    if (!count_of(id->item[4], &count) ||
        __builtin_mul_overflow(count, (uint64_t)globals[type].item_size, &bytes))
        return fail_malformed(m, "a storage whose count of elements is not valid");
    SPIN_TRY(
        room_for(m, (void **)&m->storage, m->n_storages, &m->storage_capacity, sizeof *m->storage));
    row = &m->storage[m->n_storages++];
    *row = (struct spin_storage){.key = id->item[2]->text,
                                 .kind = globals[type].kind,
                                 .item_size = globals[type].item_size,
                                 .count = count};
    SPIN_TRY(new_node(m, SPIN_VALUE_OBJECT, STORAGE, &node));
    node->v.text = id->item[1]->text;
    node->v.tensor.kind = row->kind;
    node->v.tensor.item_size = row->item_size;
    node->v.tensor.storage_count = count;
    node->v.tensor.storage = row->key;
    if (id->n == 6)
        SPIN_TRY(read_view(m, id->item[5], &node->v.tensor));
    return push_value(m, &node->v);
}

/* Check that every element of a tensor lies in the storage, and limit the number of elements. */
static spin_status check_tensor(const struct machine *m, struct spin_array *t)
{
    uint64_t last = t->offset, reach;

    t->count = 1;
    for (int i = 0; i < t->n_dims; i++)
        if (t->shape[i] == 0)
            t->count = 0;
    if (t->count == 0)
        return SPIN_OK;
    for (int i = 0; i < t->n_dims; i++) {
        if (__builtin_mul_overflow(t->count, t->shape[i], &t->count) ||
            __builtin_mul_overflow(t->shape[i] - 1, (uint64_t)t->stride[i], &reach) ||
            __builtin_add_overflow(last, reach, &last))
            return fail_malformed(m, "a tensor whose size overflows");
    }
    if (last >= t->storage_count)
        return fail_malformed(m, "a tensor that extends beyond its storage");
    if (t->count > t->storage_count && t->count > MAX_REPEATED)
        return fail_malformed(m, "a tensor that repeats its elements too often");
    return SPIN_OK;
}

/* Push a tensor. args: (storage, offset, sizes, strides, ...) */
static spin_status make_tensor(struct machine *m, const struct spin_value *args)
{
    const struct spin_value *sizes, *strides;
    struct node *node;
    struct spin_array *t;
    uint64_t offset, value;

    if (args->n < 4 || node_of(args->item[0])->role != STORAGE || !count_of(args->item[1], &offset))
        return fail_malformed(m, "a tensor without a storage");
    sizes = args->item[2];
    strides = args->item[3];
    if (!spin_value_is_sequence(sizes) || !spin_value_is_sequence(strides) ||
        sizes->n != strides->n)
        return fail_malformed(m, "a tensor whose sizes and strides do not match");
    if (sizes->n > SPIN_NPY_MAX_DIMS)
        return fail_at(m, SPIN_E_UNSUPPORTED, "a tensor of more than 8 dimensions");
    SPIN_TRY(new_node(m, SPIN_VALUE_TENSOR, PLAIN, &node));
    t = &node->v.tensor;
    *t = args->item[0]->tensor;
    if (__builtin_add_overflow(t->offset, offset, &t->offset))
        return fail_malformed(m, "a tensor that extends beyond its storage");
    t->n_dims = (int)sizes->n;
    for (size_t i = 0; i < sizes->n; i++) {
        if (!count_of(sizes->item[i], &t->shape[i]) || !count_of(strides->item[i], &value))
            return fail_malformed(m, "a tensor with an invalid shape");
        t->stride[i] = (int64_t)value;
    }
    SPIN_TRY(check_tensor(m, t));
    return push_value(m, &node->v);
}

/* ---- NumPy ---------------------------------------------------------------------------------- */

/* Execute numpy's dtype(code, align, copy); a later BUILD sets the byte order. */
static spin_status make_dtype(struct machine *m, const struct spin_value *args)
{
    const char *code = args->n > 0 ? spin_value_text(args->item[0]) : NULL;
    struct spin_array type = {0};
    struct node *node;
    char name[100];

    if (!code)
        return fail_malformed(m, "a numpy dtype without a name");
    if (!spin_array_set_type(&type, code))
        return spin_unsupported("cannot read '%s': numpy dtype '%s' is not a plain number type",
                                m->what, printable(code, strlen(code), name));
    SPIN_TRY(new_node(m, SPIN_VALUE_OBJECT, DTYPE, &node));
    node->v.text = "numpy.dtype";
    node->v.tensor = type;
    return push_value(m, &node->v);
}

static spin_status build_dtype(struct machine *m, struct spin_value *dtype,
                               const struct spin_value *state)
{
    const char *order = spin_value_text(spin_value_at(state, 1));

    if (!order || strlen(order) != 1 || !strchr("<>|=", order[0]))
        return fail_malformed(m, "a numpy dtype without a byte order");
    dtype->tensor.big_endian = order[0] == '>' && dtype->tensor.item_size > 1;
    return SPIN_OK;
}

/* Use the bytes `raw` as the elements of an array; the shape must match their number. */
static spin_status fill_array(struct machine *m, struct spin_array *t, struct spin_value *dtype,
                              const struct spin_value *shape, bool fortran,
                              const struct spin_value *raw)
{
    uint64_t stride = 1, bytes;

    if (node_of(dtype)->role != DTYPE || !spin_value_is_sequence(shape) ||
        shape->n > SPIN_NPY_MAX_DIMS || raw->kind != SPIN_VALUE_BYTES)
        return fail_malformed(m, "a numpy array that does not consist of shape, dtype and bytes");
    *t = (struct spin_array){.kind = dtype->tensor.kind,
                             .item_size = dtype->tensor.item_size,
                             .big_endian = dtype->tensor.big_endian,
                             .n_dims = (int)shape->n,
                             .data = (const unsigned char *)raw->text};
    t->storage_count = raw->n / (size_t)t->item_size;
    for (size_t i = 0; i < shape->n; i++)
        if (!count_of(shape->item[i], &t->shape[i]))
            return fail_malformed(m, "a numpy array with an invalid shape");
    for (int k = 0; k < t->n_dims; k++) {
        int i = fortran ? k : t->n_dims - 1 - k;

        t->stride[i] = (int64_t)stride;
        if (__builtin_mul_overflow(stride, t->shape[i] ? t->shape[i] : 1, &stride) ||
            stride > INT64_MAX)
            return fail_malformed(m, "a numpy array whose size overflows");
    }
    SPIN_TRY(check_tensor(m, t));
    if (__builtin_mul_overflow(t->count, (uint64_t)t->item_size, &bytes) || bytes != raw->n)
        return fail_malformed(m, "a numpy array whose shape does not fit its bytes");
    return SPIN_OK;
}

/* Execute BUILD for a numpy array: set its elements from the state (version, shape, dtype,
 * is_fortran, bytes). */
static spin_status build_array(struct machine *m, struct spin_value *array,
                               const struct spin_value *state)
{
    if (state->kind != SPIN_VALUE_TUPLE || state->n != 5 || state->item[3]->kind != SPIN_VALUE_BOOL)
        return fail_malformed(m, "a numpy array of an unknown form");
    SPIN_TRY(fill_array(m, &array->tensor, state->item[2], state->item[1],
                        state->item[3]->integer != 0, state->item[4]));
    node_of(array)->role = PLAIN;
    return SPIN_OK;
}

/* Execute numpy's _reconstruct(ndarray, (0,), b'b'): push an empty array, whose elements a later
 * BUILD sets. */
static spin_status make_unfilled(struct machine *m, const struct spin_value *args)
{
    struct node *node;

    if (args->n != 3 || !is_global(args->item[0], G_NDARRAY))
        return fail_malformed(m, "a numpy array of an unknown form");
    SPIN_TRY(new_node(m, SPIN_VALUE_TENSOR, UNFILLED, &node));
    node->v.tensor = (struct spin_array){
        .kind = 'f', .item_size = 4, .n_dims = 1, .stride = {1}, .data = (const unsigned char *)""};
    return push_value(m, &node->v);
}

/* Execute numpy's _frombuffer(bytes, dtype, shape, order): push an array. */
static spin_status make_from_buffer(struct machine *m, const struct spin_value *args)
{
    const char *order = args->n == 4 ? spin_value_text(args->item[3]) : NULL;
    struct node *node;

    if (!order || (strcmp(order, "C") != 0 && strcmp(order, "F") != 0))
        return fail_malformed(m, "a numpy array of an unknown form");
    SPIN_TRY(new_node(m, SPIN_VALUE_TENSOR, PLAIN, &node));
    SPIN_TRY(fill_array(m, &node->v.tensor, args->item[1], args->item[2], order[0] == 'F',
                        args->item[0]));
    return push_value(m, &node->v);
}

/* Execute numpy's scalar(dtype, bytes): push a plain number. */
static spin_status make_scalar(struct machine *m, const struct spin_value *args)
{
    struct spin_value none = {0};
    struct spin_array t;
    int64_t integer;
    struct node *node;
    double number;

    if (args->n != 2)
        return fail_malformed(m, "a numpy number of an unknown form");
    none.kind = SPIN_VALUE_TUPLE;
    SPIN_TRY(fill_array(m, &t, args->item[0], &none, false, args->item[1]));
    spin_array_to_i64(&t, 0, 1, &integer);
    if (t.kind == 'i' || t.kind == 'u')
        return push_int(m, integer);
    if (t.kind == 'b')
        return push_constant(m, integer ? &m->yes : &m->no, SPIN_VALUE_BOOL, integer != 0);
    /* spin_value_number() converts floats of all sizes, but only from a tensor: wrap the number in
     * one. */
    SPIN_TRY(new_node(m, SPIN_VALUE_TENSOR, PLAIN, &node));
    node->v.tensor = t;
    spin_value_number(&node->v, &number);
    return push_float(m, number);
}

/* Execute _codecs.encode(text, 'latin1'): push a bytes object in which each character of the text
 * is the byte of the same code point. Protocol 2 stores bytes in this way. */
static spin_status make_encoded(struct machine *m, const struct spin_value *args)
{
    const char *to = args->n == 2 ? spin_value_text(args->item[1]) : NULL;
    struct node *node;
    void *block;
    unsigned char *out;

    if (!to || (strcmp(to, "latin1") != 0 && strcmp(to, "latin-1") != 0) ||
        args->item[0]->kind != SPIN_VALUE_TEXT)
        return fail_malformed(m, "bytes in an unknown encoding");
    SPIN_TRY(allocate_value(m, args->item[0]->n + 1, &block));
    SPIN_TRY(new_node(m, SPIN_VALUE_BYTES, PLAIN, &node));
    out = block;
    for (size_t i = 0; i < args->item[0]->n; i++) {
        const unsigned char *c = (const unsigned char *)args->item[0]->text + i;

        if (c[0] < 0x80) {
            out[node->v.n++] = c[0];
        } else if ((c[0] == 0xc2 || c[0] == 0xc3) && (c[1] & 0xc0) == 0x80) {
            out[node->v.n++] = (unsigned char)((c[0] & 3) << 6 | (c[1] & 0x3f));
            i++;
        } else {
            return fail_malformed(m, "text to be encoded as bytes is not Latin-1");
        }
    }
    node->v.text = block;
    return push_value(m, &node->v);
}

/* ---- REDUCE, NEWOBJ, BUILD ------------------------------------------------------------------ */

static spin_status make_ordered(struct machine *m, const struct spin_value *args)
{
    struct node *node;

    if (args->n > 1 || (args->n == 1 && !spin_value_is_sequence(args->item[0])))
        return fail_malformed(m, "an OrderedDict of an unknown form");
    SPIN_TRY(new_node(m, SPIN_VALUE_DICT, ORDERED, &node));
    for (size_t i = 0; args->n == 1 && i < args->item[0]->n; i++) {
        const struct spin_value *pair = args->item[0]->item[i];

        if (!spin_value_is_sequence(pair) || pair->n != 2)
            return fail_malformed(m, "an OrderedDict of an unknown form");
        SPIN_TRY(append_pointers(m, &node->v, 2 * i, pair->item, 2));
        node->v.n++;
    }
    return push_value(m, &node->v);
}

static spin_status make_instance(struct machine *m, struct spin_value *of)
{
    struct node *node;

    SPIN_TRY(new_node(m, SPIN_VALUE_OBJECT, INSTANCE, &node));
    node->id = node_of(of)->id;
    node->v.text = of->text;
    return push_value(m, &node->v);
}

static spin_status call_global(struct machine *m, struct spin_value *of,
                               const struct spin_value *args)
{
    char why[160];

    switch (globals[node_of(of)->id].id) {
    case G_TENSOR_V2:
    case G_TENSOR:
        return make_tensor(m, args);
    case G_PARAMETER:
        if (args->n < 1 || args->item[0]->kind != SPIN_VALUE_TENSOR)
            return fail_malformed(m, "a parameter that is not a tensor");
        return push_value(m, args->item[0]);
    case G_ORDERED_DICT:
        return make_ordered(m, args);
    case G_SIZE:
        if (args->n == 0)
            return push_value(m, (struct spin_value *)(uintptr_t)args);
        if (args->n != 1 || !spin_value_is_sequence(args->item[0]))
            return fail_malformed(m, "a torch.Size of an unknown form");
        return push_value(m, args->item[0]);
    case G_SCALAR:
        return make_scalar(m, args);
    case G_RECONSTRUCT:
        return make_unfilled(m, args);
    case G_FROMBUFFER:
        return make_from_buffer(m, args);
    case G_DTYPE:
        return make_dtype(m, args);
    case G_ENCODE:
        return make_encoded(m, args);
    case G_LOAD_FROM_BYTES:
        return load_from_bytes(m, args);
    case G_OBJECT:
    case G_MODEL:
    case G_PART:
        if (args->n == 0)
            return make_instance(m, of);
        break;
    case G_SET:
        if (args->n == 1 && spin_value_is_sequence(args->item[0]))
            return push_value(m, args->item[0]);
        break;
    case G_CONSTANT:
    case G_STORAGE:
    case G_NDARRAY:
        break;
    }
    snprintf(why, sizeof why, "'%s' is called with unexpected arguments", of->text);
    return fail_malformed(m, why);
}

static spin_status op_reduce(struct machine *m)
{
    struct spin_value *args, *of;

    SPIN_TRY(need_values(m, 2));
    args = pop_value(m);
    of = pop_value(m);
    if (node_of(of)->role != GLOBAL || args->kind != SPIN_VALUE_TUPLE)
        return fail_malformed(m, "a call of a value that is not a function");
    return call_global(m, of, args);
}

static spin_status op_newobj(struct machine *m)
{
    struct spin_value *args, *of;

    SPIN_TRY(need_values(m, 2));
    args = pop_value(m);
    of = pop_value(m);
    if (!(is_global(of, G_OBJECT) || is_global(of, G_MODEL) || is_global(of, G_PART)) ||
        args->kind != SPIN_VALUE_TUPLE || args->n != 0)
        return fail_malformed(m, "an object of an unsupported class");
    return make_instance(m, of);
}

static spin_status op_build(struct machine *m)
{
    struct spin_value *state, *to;
    void *item;

    SPIN_TRY(need_values(m, 2));
    state = pop_value(m);
    to = m->stack[m->n_stack - 1];
    switch (node_of(to)->role) {
    case ORDERED: /* the state is the _metadata of a state_dict(), which is ignored */
        return state->kind == SPIN_VALUE_DICT
                   ? SPIN_OK
                   : fail_malformed(m, "a dict with an unexpected state");
    case DTYPE:
        return build_dtype(m, to, state);
    case UNFILLED:
        return build_array(m, to, state);
    case INSTANCE:
        if (state->kind == SPIN_VALUE_INT && globals[node_of(to)->id].id == G_PART)
            return SPIN_OK; /* an enumerator of tiny-cuda-nn, which is ignored */
        if (state->kind != SPIN_VALUE_DICT)
            return fail_malformed(m, "an object with an unexpected state");
        SPIN_TRY(allocate_value(m, sizeof *to->item, &item));
        to->item = item;
        to->item[0] = state;
        to->n = 1;
        return update_depth(m, node_of(to), state);
    default:
        return fail_malformed(m, "a state for a value that cannot have one");
    }
}

/* ---- Opcodes -------------------------------------------------------------------------------- */

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

/* Read an unsigned little-endian argument of n bytes. */
static spin_status read_uint(struct machine *m, int n, uint64_t *out)
{
    *out = 0;
    if (m->end - m->p < n)
        return fail_malformed(m, "cut short");
    for (int i = 0; i < n; i++)
        *out |= (uint64_t)m->p[i] << 8 * i;
    m->p += n;
    return SPIN_OK;
}

/* Read a length, stored in n_length bytes, and locate the data of this length after it. */
static spin_status read_bytes(struct machine *m, int n_length, const unsigned char **p, size_t *n)
{
    uint64_t length;

    SPIN_TRY(read_uint(m, n_length, &length));
    if (length > (uint64_t)(m->end - m->p))
        return fail_malformed(m, "a length that is larger than the rest of the data");
    *p = m->p;
    *n = (size_t)length;
    m->p += length;
    return SPIN_OK;
}

static spin_status op_text(struct machine *m, enum spin_value_kind kind, int n_length)
{
    const unsigned char *p = NULL;
    size_t n = 0;

    SPIN_TRY(read_bytes(m, n_length, &p, &n));
    return push_text(m, kind, p, n);
}

static spin_status op_long(struct machine *m, int n_length)
{
    const unsigned char *p = NULL;
    size_t n = 0;

    SPIN_TRY(read_bytes(m, n_length, &p, &n));
    return push_long(m, p, n);
}

static spin_status op_int(struct machine *m, int n)
{
    uint64_t value;

    SPIN_TRY(read_uint(m, n, &value));
    return push_int(m, n == 4 ? (int32_t)value : (int64_t)value);
}

static spin_status op_float(struct machine *m)
{
    uint64_t bits;
    double value;

    SPIN_TRY(read_uint(m, 8, &bits));
    bits = __builtin_bswap64(bits);
    memcpy(&value, &bits, 8);
    return push_float(m, value);
}

static spin_status op_tuple(struct machine *m, size_t n)
{
    SPIN_TRY(need_values(m, n));
    return make_tuple(m, m->n_stack - n);
}

static spin_status op_pop(struct machine *m)
{
    size_t at = 0;

    if (m->n_stack == stack_floor(m))
        return pop_mark(m, &at);
    (void)pop_value(m);
    return SPIN_OK;
}

static spin_status op_memo(struct machine *m, int n, spin_status (*fn)(struct machine *, uint64_t))
{
    uint64_t slot;

    SPIN_TRY(read_uint(m, n, &slot));
    return fn(m, slot);
}

static spin_status op_proto(struct machine *m)
{
    uint64_t version;

    SPIN_TRY(read_uint(m, 1, &version));
    if (version < 2 || version > 5)
        return fail_at(m, SPIN_E_UNSUPPORTED, "its protocol version is not between 2 and 5");
    return SPIN_OK;
}

static spin_status op_frame(struct machine *m)
{
    uint64_t length;

    SPIN_TRY(read_uint(m, 8, &length));
    if (length > (uint64_t)(m->end - m->p))
        return fail_malformed(m, "a frame that is longer than the rest of the pickle");
    return SPIN_OK;
}

static spin_status execute_opcode(struct machine *m, unsigned char op)
{
    size_t at = 0;
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
        SPIN_TRY(need_values(m, 1));
        return push_value(m, m->stack[m->n_stack - 1]);
    case NONE:
        return push_constant(m, &m->none, SPIN_VALUE_NONE, 0);
    case NEWTRUE:
        return push_constant(m, &m->yes, SPIN_VALUE_BOOL, 1);
    case NEWFALSE:
        return push_constant(m, &m->no, SPIN_VALUE_BOOL, 0);
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
        SPIN_TRY(pop_mark(m, &at));
        return make_tuple(m, at);
    case SETITEMS:
        SPIN_TRY(pop_mark(m, &at));
        return set_items(m, at);
    case APPENDS:
    case ADDITEMS:
        SPIN_TRY(pop_mark(m, &at));
        return append_items(m, at);
    case POP_MARK:
        return pop_mark(m, &m->n_stack);
    case APPEND:
        SPIN_TRY(need_values(m, 2));
        return append_items(m, m->n_stack - 1);
    case SETITEM:
        SPIN_TRY(need_values(m, 3));
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
        return op_global(m);
    case STACK_GLOBAL:
        return op_stack_global(m);
    case BINPERSID:
        return op_persistent_id(m);
    case REDUCE:
        return op_reduce(m);
    case NEWOBJ:
        return op_newobj(m);
    case BUILD:
        return op_build(m);
    case STOP:
        break;
    }
    snprintf(why, sizeof why, "opcode 0x%02x, which checkpoints do not use", op);
    return fail_at(m, SPIN_E_UNSUPPORTED, why);
}

/* Read one pickle from m->p up to STOP. */
static spin_status run_pickle(struct machine *m, const struct spin_value **root)
{
    m->op = m->start = m->p;
    if (m->end - m->p < 2)
        return fail_malformed(m, "cut short");
    if (m->p[0] != PROTO)
        return fail_malformed(m, "it does not begin with a header of protocol 2 to 5");
    m->n_stack = m->n_marks = m->n_memo = m->n_ops = 0;
    for (;;) {
        m->op = m->p;
        if (m->p == m->end)
            return fail_malformed(m, "cut short");
        m->n_ops++;
        m->p++;
        if (*m->op == STOP)
            break;
        SPIN_TRY(execute_opcode(m, *m->op));
    }
    if (m->n_stack != 1 || m->n_marks != 0)
        return fail_malformed(m, "it does not end with one value");
    *root = m->stack[0];
    return SPIN_OK;
}

/* ---- The stream that torch.save wrote before 1.6: five pickles, then the storages ----------- */

static const unsigned char legacy_magic[15] = {0x80, 0x02, 0x8a, 0x0a, 0x6c, 0xfc, 0x9c, 0x46,
                                               0xf9, 0x20, 0x6a, 0xa8, 0x50, 0x19, 0x2e};

bool spin_pickle_is_legacy(const unsigned char *bytes, size_t n)
{
    return n >= sizeof legacy_magic && memcmp(bytes, legacy_magic, sizeof legacy_magic) == 0;
}

/* Read the number of elements of one storage, and locate the elements, which follow this number. */
static spin_status bind_storage(struct machine *m, const struct spin_pickle *pickle,
                                const struct spin_value *key)
{
    struct spin_storage *s;
    uint64_t count = 0, bytes;
    char name[100];

    m->op = m->p;
    if (!is_key(key))
        return fail_malformed(m, "a storage whose key is not a number");
    s = (struct spin_storage *)(uintptr_t)spin_pickle_storage(pickle, key->text);
    if (!s)
        return spin_malformed("cannot read '%s': storage '%s' is of unknown type", m->what,
                              printable(key->text, key->n, name));
    if (m->end - m->p < 8)
        return fail_malformed(m, "the storages are cut short");
    for (int i = 0; i < 8; i++)
        count |= (uint64_t)m->p[i] << 8 * (pickle->big_endian ? 7 - i : i);
    m->p += 8;
    if (count != s->count)
        return spin_malformed("cannot read '%s': storage '%s' has %llu elements, expected %llu",
                              m->what, s->key, (unsigned long long)count,
                              (unsigned long long)s->count);
    /* This product cannot overflow, see op_persistent_id(). */
    bytes = count * (uint64_t)s->item_size;
    if (bytes > (uint64_t)(m->end - m->p))
        return fail_malformed(m, "the storages are cut short");
    s->data = m->p;
    m->p += bytes;
    return SPIN_OK;
}

/* Read a legacy stream. Its five pickles are the magic number, the version, the byte order, the
 * object, and the list of storage keys. The storages follow in the order of that list. */
static spin_status run_legacy(struct machine *m, struct spin_pickle *out)
{
    const struct spin_value *version, *system, *keys, *little;

    if (!spin_pickle_is_legacy(m->p, (size_t)(m->end - m->p)))
        return spin_malformed("cannot read '%s': not a torch.save stream", m->what);
    m->p += sizeof legacy_magic;
    SPIN_TRY(run_pickle(m, &version));
    if (version->kind != SPIN_VALUE_INT || version->integer != 1001)
        return fail_at(m, SPIN_E_UNSUPPORTED, "a torch.save stream that is not of version 1001");
    SPIN_TRY(run_pickle(m, &system));
    little = spin_value_get(system, "little_endian");
    if (!little || little->kind != SPIN_VALUE_BOOL)
        return fail_malformed(m, "the byte order is missing");
    out->big_endian = !little->integer;
    m->n_storages = 0;
    SPIN_TRY(run_pickle(m, &out->root));
    SPIN_TRY(keep_storages(m, out));
    SPIN_TRY(run_pickle(m, &keys));
    if (keys->kind != SPIN_VALUE_LIST)
        return fail_malformed(m, "the list of storages is missing");
    for (size_t i = 0; i < keys->n; i++)
        SPIN_TRY(bind_storage(m, out, keys->item[i]));
    for (size_t i = 0; i < out->n_storages; i++)
        if (!out->storage[i].data)
            return spin_malformed("cannot read '%s': storage '%s' is missing", m->what,
                                  out->storage[i].key);
    return SPIN_OK;
}

static spin_status load_from_bytes(struct machine *m, const struct spin_value *args)
{
    struct machine inner = {.what = m->what, .arena = m->arena, .level = m->level + 1};
    struct spin_pickle stream = {0};
    const struct spin_storage *s;
    spin_status status;
    struct node *node;

    if (args->n != 1 || args->item[0]->kind != SPIN_VALUE_BYTES)
        return fail_malformed(m, "a storage that is not made of bytes");
    if (inner.level > 1)
        return fail_malformed(m, "a torch.save stream that contains another torch.save stream");
    inner.start = inner.op = inner.p = (const unsigned char *)args->item[0]->text;
    inner.end = inner.p + args->item[0]->n;
    inner.budget = m->budget;
    status = run_legacy(&inner, &stream);
    m->budget = inner.budget;
    free_machine(&inner);
    SPIN_TRY(status);
    if (stream.root->kind != SPIN_VALUE_OBJECT ||
        node_of((struct spin_value *)(uintptr_t)stream.root)->role != STORAGE)
        return fail_malformed(m, "a torch.save stream of something other than one storage");
    s = spin_pickle_storage(&stream, stream.root->tensor.storage);
    SPIN_TRY(new_node(m, SPIN_VALUE_OBJECT, STORAGE, &node));
    node->v.text = stream.root->text;
    node->v.tensor = stream.root->tensor;
    node->v.tensor.storage = NULL;
    node->v.tensor.data = s->data;
    node->v.tensor.big_endian = stream.big_endian && s->item_size > 1;
    return push_value(m, &node->v);
}

/* ---- Parsing -------------------------------------------------------------------------------- */

static spin_status parse_input(const char *what, const unsigned char *bytes, size_t n, bool legacy,
                               struct spin_pickle *out)
{
    struct machine m = {.what = what,
                        .start = bytes,
                        .p = bytes,
                        .op = bytes,
                        .end = bytes + n,
                        .arena = &out->arena};
    spin_status status;

    memset(out, 0, sizeof *out);
    if (legacy) {
        /* The size of the input is not added, since most of it is storages, which are not
         * copied. */
        m.budget = BUDGET;
        SPIN_TRY_OUT(run_legacy(&m, out));
    } else {
        m.budget = n < SIZE_MAX - BUDGET ? BUDGET + n : BUDGET;
        SPIN_TRY_OUT(run_pickle(&m, &out->root));
        SPIN_TRY_OUT(keep_storages(&m, out));
    }
    out->used = (size_t)(m.p - bytes);
out:
    free_machine(&m);
    if (status != SPIN_OK)
        spin_pickle_free(out);
    return status;
}

spin_status spin_pickle_parse(const char *what, const unsigned char *bytes, size_t n,
                              struct spin_pickle *out)
{
    return parse_input(what, bytes, n, false, out);
}

spin_status spin_pickle_parse_legacy(const char *what, const unsigned char *bytes, size_t n,
                                     struct spin_pickle *out)
{
    return parse_input(what, bytes, n, true, out);
}

/* ---- Looking up values ---------------------------------------------------------------------- */

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

/* Returns the value of a key. If the key occurs several times, the last value is returned, as in
 * Python. */
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
