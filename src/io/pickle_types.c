/* The globals that a pickle may name, and what REDUCE, NEWOBJ and BUILD make of them: tensors, numpy
 * arrays, dicts, plain objects. Every other name is refused. */
#include "io/pickle_machine.h"

#include <limits.h>
#include <string.h>

#include "base/err.h"

/* A view that repeats elements (stride 0) may have more of them than its storage, up to this. */
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
    G_OBJECT
};

static const struct {
    const char *module, *name;
    enum global id;
    char kind; /* storages */
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
};
enum { N_GLOBALS = sizeof globals / sizeof *globals };

/* What is refused with more than its name. Modules end in '.' when all below them are meant. */
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

static spin_status refuse_global(const struct spin_pickle_machine *m, const char *module,
                                 const char *name)
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
    return spin_fail(SPIN_E_UNSUPPORTED, "cannot read '%s': it refers to '%s.%s', which is %s",
                     m->what, spin_pickle_shown(module, strlen(module), a),
                     spin_pickle_shown(name, strlen(name), b), why);
}

static spin_status push_global(struct spin_pickle_machine *m, const char *module, const char *name)
{
    struct spin_pickle_node *node;
    char full[128];

    for (int i = 0; i < N_GLOBALS; i++) {
        if (strcmp(module, globals[i].module) != 0 || strcmp(name, globals[i].name) != 0)
            continue;
        SPIN_TRY(spin_pickle_new_node(m, SPIN_VALUE_OBJECT, GLOBAL, &node));
        node->id = (unsigned char)i;
        snprintf(full, sizeof full, "%s.%s", module, name);
        SPIN_TRY(spin_pickle_copy_text(m, full, strlen(full), &node->v.text));
        node->v.n = 0;
        return spin_pickle_push(m, &node->v);
    }
    return refuse_global(m, module, name);
}

/* A line of the input, without its end, as text in `out`. */
static spin_status read_line(struct spin_pickle_machine *m, char out[128])
{
    const unsigned char *end = memchr(m->p, '\n', (size_t)(m->end - m->p));
    size_t n;

    if (!end)
        return spin_pickle_bad(m, "cut short");
    n = (size_t)(end - m->p);
    if (n >= 128 || memchr(m->p, '\0', n))
        return spin_pickle_bad(m, "a global whose name is not one");
    memcpy(out, m->p, n);
    out[n] = '\0';
    m->p = end + 1;
    return SPIN_OK;
}

spin_status spin_pickle_op_global(struct spin_pickle_machine *m)
{
    char module[128], name[128];

    SPIN_TRY(read_line(m, module));
    SPIN_TRY(read_line(m, name));
    return push_global(m, module, name);
}

spin_status spin_pickle_op_stack_global(struct spin_pickle_machine *m)
{
    struct spin_value *name, *module;

    SPIN_TRY(spin_pickle_need(m, 2));
    name = spin_pickle_pop(m);
    module = spin_pickle_pop(m);
    if (name->kind != SPIN_VALUE_TEXT || module->kind != SPIN_VALUE_TEXT || name->n >= 128 ||
        module->n >= 128 || strlen(name->text) != name->n || strlen(module->text) != module->n)
        return spin_pickle_bad(m, "a global whose name is not one");
    return push_global(m, module->text, name->text);
}

static bool is_global(struct spin_value *v, enum global id)
{
    const struct spin_pickle_node *node = spin_pickle_node(v);

    return node->role == GLOBAL && globals[node->id].id == id;
}

/* ---- Tensors --------------------------------------------------------------------------------- */

/* A count that may be one: an int that is not negative. */
static bool count_of(const struct spin_value *v, uint64_t *out)
{
    if (v->kind != SPIN_VALUE_INT || v->integer < 0 || v->number >= 0x1p63)
        return false;
    *out = (uint64_t)v->integer;
    return true;
}

bool spin_pickle_is_key(const struct spin_value *v)
{
    if (v->kind != SPIN_VALUE_TEXT || v->n == 0 || v->n > 20)
        return false;
    for (size_t i = 0; i < v->n; i++)
        if (v->text[i] < '0' || v->text[i] > '9')
            return false;
    return true;
}

/* The view of very old files, (key, offset, size), shifts where tensors begin. */
static spin_status read_view(struct spin_pickle_machine *m, const struct spin_value *view,
                             struct spin_array *out)
{
    uint64_t offset, size;

    if (view->kind == SPIN_VALUE_NONE)
        return SPIN_OK;
    if (view->kind != SPIN_VALUE_TUPLE || view->n != 3 || !count_of(view->item[1], &offset) ||
        !count_of(view->item[2], &size) || offset > out->storage_count ||
        size > out->storage_count - offset)
        return spin_pickle_bad(m, "a view that does not lie in its storage");
    out->offset = offset;
    return SPIN_OK;
}

/* ('storage', type, key, location, count) and, in legacy streams, a view */
spin_status spin_pickle_op_persistent_id(struct spin_pickle_machine *m)
{
    struct spin_value *id;
    struct spin_storage *row;
    struct spin_pickle_node *node;
    uint64_t count, bytes;
    int type;

    SPIN_TRY(spin_pickle_need(m, 1));
    id = spin_pickle_pop(m);
    if (id->kind != SPIN_VALUE_TUPLE || id->n < 5 || id->n > 6 ||
        id->item[0]->kind != SPIN_VALUE_TEXT || strcmp(id->item[0]->text, "storage") != 0)
        return spin_pickle_bad(m, "a persistent id that is not of a storage");
    if (!is_global(id->item[1], G_STORAGE))
        return spin_pickle_bad(m, "a storage of no known type");
    if (!spin_pickle_is_key(id->item[2]))
        return spin_pickle_bad(m, "a storage whose key is not a number");
    type = spin_pickle_node(id->item[1])->id;
    if (!count_of(id->item[4], &count) ||
        __builtin_mul_overflow(count, (uint64_t)globals[type].item_size, &bytes))
        return spin_pickle_bad(m, "a storage with an impossible count");
    SPIN_TRY(spin_pickle_room_for(m, (void **)&m->storage, m->n_storages, &m->storage_capacity,
                                  sizeof *m->storage));
    row = &m->storage[m->n_storages++];
    *row = (struct spin_storage){.key = id->item[2]->text,
                                 .kind = globals[type].kind,
                                 .item_size = globals[type].item_size,
                                 .count = count};
    SPIN_TRY(spin_pickle_new_node(m, SPIN_VALUE_OBJECT, STORAGE, &node));
    node->v.text = id->item[1]->text;
    node->v.tensor.kind = row->kind;
    node->v.tensor.item_size = row->item_size;
    node->v.tensor.storage_count = count;
    node->v.tensor.storage = row->key;
    if (id->n == 6)
        SPIN_TRY(read_view(m, id->item[5], &node->v.tensor));
    return spin_pickle_push(m, &node->v);
}

/* Every element must lie in the storage, and there may not be absurdly many. */
static spin_status check_tensor(const struct spin_pickle_machine *m, struct spin_array *t)
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
            return spin_pickle_bad(m, "a tensor whose shape is beyond counting");
    }
    if (last >= t->storage_count)
        return spin_pickle_bad(m, "a tensor that reaches beyond its storage");
    if (t->count > t->storage_count && t->count > MAX_REPEATED)
        return spin_pickle_bad(m, "a tensor that repeats its few elements too often");
    return SPIN_OK;
}

/* (storage, offset, sizes, strides, ...) */
static spin_status make_tensor(struct spin_pickle_machine *m, const struct spin_value *args)
{
    const struct spin_value *sizes, *strides;
    struct spin_pickle_node *node;
    struct spin_array *t;
    uint64_t offset, value;

    if (args->n < 4 || spin_pickle_node(args->item[0])->role != STORAGE ||
        !count_of(args->item[1], &offset))
        return spin_pickle_bad(m, "a tensor without a storage");
    sizes = args->item[2];
    strides = args->item[3];
    if (!spin_value_is_sequence(sizes) || !spin_value_is_sequence(strides) ||
        sizes->n != strides->n)
        return spin_pickle_bad(m, "a tensor whose sizes and strides do not match");
    if (sizes->n > SPIN_NPY_MAX_DIMS)
        return spin_pickle_fail_at(m, SPIN_E_UNSUPPORTED, "a tensor of more than 8 dimensions");
    SPIN_TRY(spin_pickle_new_node(m, SPIN_VALUE_TENSOR, PLAIN, &node));
    t = &node->v.tensor;
    *t = args->item[0]->tensor;
    if (__builtin_add_overflow(t->offset, offset, &t->offset))
        return spin_pickle_bad(m, "a tensor that reaches beyond its storage");
    t->n_dims = (int)sizes->n;
    for (size_t i = 0; i < sizes->n; i++) {
        if (!count_of(sizes->item[i], &t->shape[i]) || !count_of(strides->item[i], &value))
            return spin_pickle_bad(m, "a tensor whose shape is not made of counts");
        t->stride[i] = (int64_t)value;
    }
    SPIN_TRY(check_tensor(m, t));
    return spin_pickle_push(m, &node->v);
}

/* ---- numpy ----------------------------------------------------------------------------------- */

/* dtype(code, align, copy): the byte order comes with BUILD. */
static spin_status make_dtype(struct spin_pickle_machine *m, const struct spin_value *args)
{
    const char *code = args->n > 0 ? spin_value_text(args->item[0]) : NULL;
    struct spin_array type = {0};
    struct spin_pickle_node *node;
    char name[100];

    if (!code)
        return spin_pickle_bad(m, "a numpy dtype without a name");
    if (!spin_array_set_type(&type, code))
        return spin_fail(SPIN_E_UNSUPPORTED,
                         "cannot read '%s': numpy dtype '%s' is not a plain number", m->what,
                         spin_pickle_shown(code, strlen(code), name));
    SPIN_TRY(spin_pickle_new_node(m, SPIN_VALUE_OBJECT, DTYPE, &node));
    node->v.text = "numpy.dtype";
    node->v.tensor = type;
    return spin_pickle_push(m, &node->v);
}

static spin_status build_dtype(struct spin_pickle_machine *m, struct spin_value *dtype,
                               const struct spin_value *state)
{
    const char *order = spin_value_text(spin_value_at(state, 1));

    if (!order || strlen(order) != 1 || !strchr("<>|=", order[0]))
        return spin_pickle_bad(m, "a numpy dtype without a byte order");
    dtype->tensor.big_endian = order[0] == '>' && dtype->tensor.item_size > 1;
    return SPIN_OK;
}

/* The bytes become the elements: their number must be that of the shape. */
static spin_status fill_array(struct spin_pickle_machine *m, struct spin_array *t,
                              struct spin_value *dtype, const struct spin_value *shape,
                              bool fortran, const struct spin_value *raw)
{
    uint64_t stride = 1, bytes;

    if (spin_pickle_node(dtype)->role != DTYPE || !spin_value_is_sequence(shape) ||
        shape->n > SPIN_NPY_MAX_DIMS || raw->kind != SPIN_VALUE_BYTES)
        return spin_pickle_bad(m, "a numpy array that is not made of shape, dtype and bytes");
    *t = (struct spin_array){.kind = dtype->tensor.kind,
                             .item_size = dtype->tensor.item_size,
                             .big_endian = dtype->tensor.big_endian,
                             .n_dims = (int)shape->n,
                             .data = (const unsigned char *)raw->text};
    t->storage_count = raw->n / (size_t)t->item_size;
    for (size_t i = 0; i < shape->n; i++)
        if (!count_of(shape->item[i], &t->shape[i]))
            return spin_pickle_bad(m, "a numpy array whose shape is not made of counts");
    for (int k = 0; k < t->n_dims; k++) {
        int i = fortran ? k : t->n_dims - 1 - k;

        t->stride[i] = (int64_t)stride;
        if (__builtin_mul_overflow(stride, t->shape[i] ? t->shape[i] : 1, &stride) ||
            stride > INT64_MAX)
            return spin_pickle_bad(m, "a numpy array whose shape is beyond counting");
    }
    SPIN_TRY(check_tensor(m, t));
    if (__builtin_mul_overflow(t->count, (uint64_t)t->item_size, &bytes) || bytes != raw->n)
        return spin_pickle_bad(m, "a numpy array whose shape does not fit its bytes");
    return SPIN_OK;
}

/* BUILD (version, shape, dtype, is_fortran, bytes) */
static spin_status build_array(struct spin_pickle_machine *m, struct spin_value *array,
                               const struct spin_value *state)
{
    if (state->kind != SPIN_VALUE_TUPLE || state->n != 5 || state->item[3]->kind != SPIN_VALUE_BOOL)
        return spin_pickle_bad(m, "a numpy array of an unknown form");
    SPIN_TRY(fill_array(m, &array->tensor, state->item[2], state->item[1],
                        state->item[3]->integer != 0, state->item[4]));
    spin_pickle_node(array)->role = PLAIN;
    return SPIN_OK;
}

/* _reconstruct(ndarray, (0,), b'b') */
static spin_status make_unfilled(struct spin_pickle_machine *m, const struct spin_value *args)
{
    struct spin_pickle_node *node;

    if (args->n != 3 || !is_global(args->item[0], G_NDARRAY))
        return spin_pickle_bad(m, "a numpy array of an unknown form");
    SPIN_TRY(spin_pickle_new_node(m, SPIN_VALUE_TENSOR, UNFILLED, &node));
    node->v.tensor = (struct spin_array){
        .kind = 'f', .item_size = 4, .n_dims = 1, .stride = {1}, .data = (const unsigned char *)""};
    return spin_pickle_push(m, &node->v);
}

/* _frombuffer(bytes, dtype, shape, order) */
static spin_status make_from_buffer(struct spin_pickle_machine *m, const struct spin_value *args)
{
    const char *order = args->n == 4 ? spin_value_text(args->item[3]) : NULL;
    struct spin_pickle_node *node;

    if (!order || (strcmp(order, "C") != 0 && strcmp(order, "F") != 0))
        return spin_pickle_bad(m, "a numpy array of an unknown form");
    SPIN_TRY(spin_pickle_new_node(m, SPIN_VALUE_TENSOR, PLAIN, &node));
    SPIN_TRY(fill_array(m, &node->v.tensor, args->item[1], args->item[2], order[0] == 'F',
                        args->item[0]));
    return spin_pickle_push(m, &node->v);
}

/* scalar(dtype, bytes) becomes a plain number. */
static spin_status make_scalar(struct spin_pickle_machine *m, const struct spin_value *args)
{
    struct spin_value none = {0};
    struct spin_array t;
    int64_t integer;
    struct spin_pickle_node *node;
    double number;

    if (args->n != 2)
        return spin_pickle_bad(m, "a numpy number of an unknown form");
    none.kind = SPIN_VALUE_TUPLE;
    SPIN_TRY(fill_array(m, &t, args->item[0], &none, false, args->item[1]));
    spin_array_to_i64(&t, 0, 1, &integer);
    if (t.kind == 'i' || t.kind == 'u')
        return spin_pickle_push_int(m, integer);
    if (t.kind == 'b')
        return spin_pickle_push_constant(m, integer ? &m->yes : &m->no, SPIN_VALUE_BOOL,
                                         integer != 0);
    SPIN_TRY(spin_pickle_new_node(m, SPIN_VALUE_TENSOR, PLAIN,
                                  &node)); /* read as a tensor of one, once */
    node->v.tensor = t;
    spin_value_number(&node->v, &number);
    return spin_pickle_push_float(m, number);
}

/* _codecs.encode(text, 'latin1'): how protocol 2 spells bytes; code point n is byte n. */
static spin_status make_encoded(struct spin_pickle_machine *m, const struct spin_value *args)
{
    const char *to = args->n == 2 ? spin_value_text(args->item[1]) : NULL;
    struct spin_pickle_node *node;
    void *block;
    unsigned char *out;

    if (!to || (strcmp(to, "latin1") != 0 && strcmp(to, "latin-1") != 0) ||
        args->item[0]->kind != SPIN_VALUE_TEXT)
        return spin_pickle_bad(m, "bytes in an unknown encoding");
    SPIN_TRY(spin_pickle_take(m, args->item[0]->n + 1, &block));
    SPIN_TRY(spin_pickle_new_node(m, SPIN_VALUE_BYTES, PLAIN, &node));
    out = block;
    for (size_t i = 0; i < args->item[0]->n; i++) {
        const unsigned char *c = (const unsigned char *)args->item[0]->text + i;

        if (c[0] < 0x80) {
            out[node->v.n++] = c[0];
        } else if ((c[0] == 0xc2 || c[0] == 0xc3) && (c[1] & 0xc0) == 0x80) {
            out[node->v.n++] = (unsigned char)((c[0] & 3) << 6 | (c[1] & 0x3f));
            i++;
        } else {
            return spin_pickle_bad(m, "text that is to be bytes, but is not Latin-1");
        }
    }
    node->v.text = block;
    return spin_pickle_push(m, &node->v);
}

/* ---- REDUCE, NEWOBJ, BUILD ------------------------------------------------------------------- */

static spin_status make_ordered(struct spin_pickle_machine *m, const struct spin_value *args)
{
    struct spin_pickle_node *node;

    if (args->n > 1 || (args->n == 1 && !spin_value_is_sequence(args->item[0])))
        return spin_pickle_bad(m, "an OrderedDict of an unknown form");
    SPIN_TRY(spin_pickle_new_node(m, SPIN_VALUE_DICT, ORDERED, &node));
    for (size_t i = 0; args->n == 1 && i < args->item[0]->n; i++) {
        const struct spin_value *pair = args->item[0]->item[i];

        if (!spin_value_is_sequence(pair) || pair->n != 2)
            return spin_pickle_bad(m, "an OrderedDict of an unknown form");
        SPIN_TRY(spin_pickle_append(m, &node->v, 2 * i, pair->item, 2));
        node->v.n++;
    }
    return spin_pickle_push(m, &node->v);
}

static spin_status make_instance(struct spin_pickle_machine *m, struct spin_value *of)
{
    struct spin_pickle_node *node;

    SPIN_TRY(spin_pickle_new_node(m, SPIN_VALUE_OBJECT, INSTANCE, &node));
    node->id = spin_pickle_node(of)->id;
    node->v.text = of->text;
    return spin_pickle_push(m, &node->v);
}

static spin_status call(struct spin_pickle_machine *m, struct spin_value *of,
                        const struct spin_value *args)
{
    char why[160];

    switch (globals[spin_pickle_node(of)->id].id) {
    case G_TENSOR_V2:
    case G_TENSOR:
        return make_tensor(m, args);
    case G_PARAMETER:
        if (args->n < 1 || args->item[0]->kind != SPIN_VALUE_TENSOR)
            return spin_pickle_bad(m, "a parameter that is not a tensor");
        return spin_pickle_push(m, args->item[0]);
    case G_ORDERED_DICT:
        return make_ordered(m, args);
    case G_SIZE:
        if (args->n == 0)
            return spin_pickle_push(m, (struct spin_value *)(uintptr_t)args);
        if (args->n != 1 || !spin_value_is_sequence(args->item[0]))
            return spin_pickle_bad(m, "a torch.Size of an unknown form");
        return spin_pickle_push(m, args->item[0]);
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
        return spin_pickle_load_from_bytes(m, args);
    case G_OBJECT:
        if (args->n == 0)
            return make_instance(m, of);
        break;
    case G_STORAGE:
    case G_NDARRAY:
        break;
    }
    snprintf(why, sizeof why, "'%s' is called, which is not how data are written", of->text);
    return spin_pickle_bad(m, why);
}

spin_status spin_pickle_op_reduce(struct spin_pickle_machine *m)
{
    struct spin_value *args, *of;

    SPIN_TRY(spin_pickle_need(m, 2));
    args = spin_pickle_pop(m);
    of = spin_pickle_pop(m);
    if (spin_pickle_node(of)->role != GLOBAL || args->kind != SPIN_VALUE_TUPLE)
        return spin_pickle_bad(m, "a call of what is not a function");
    return call(m, of, args);
}

spin_status spin_pickle_op_newobj(struct spin_pickle_machine *m)
{
    struct spin_value *args, *of;

    SPIN_TRY(spin_pickle_need(m, 2));
    args = spin_pickle_pop(m);
    of = spin_pickle_pop(m);
    if (!is_global(of, G_OBJECT) || args->kind != SPIN_VALUE_TUPLE || args->n != 0)
        return spin_pickle_bad(m, "an object of a class that is not known as data");
    return make_instance(m, of);
}

spin_status spin_pickle_op_build(struct spin_pickle_machine *m)
{
    struct spin_value *state, *to;
    void *item;

    SPIN_TRY(spin_pickle_need(m, 2));
    state = spin_pickle_pop(m);
    to = m->stack[m->n_stack - 1];
    switch (spin_pickle_node(to)->role) {
    case ORDERED: /* _metadata of a state_dict(): of no use */
        return state->kind == SPIN_VALUE_DICT ? SPIN_OK
                                              : spin_pickle_bad(m, "a dict with a strange state");
    case DTYPE:
        return build_dtype(m, to, state);
    case UNFILLED:
        return build_array(m, to, state);
    case INSTANCE:
        if (state->kind != SPIN_VALUE_DICT)
            return spin_pickle_bad(m, "an object with a strange state");
        SPIN_TRY(spin_pickle_take(m, sizeof *to->item, &item));
        to->item = item;
        to->item[0] = state;
        to->n = 1;
        return spin_pickle_deepen(m, spin_pickle_node(to), state);
    default:
        return spin_pickle_bad(m, "a state for what has none");
    }
}
