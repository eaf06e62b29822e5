/* The values of a pickle, looked up; and the elements behind its tensors, through their strides. */
#include <math.h>
#include <string.h>

#include "io/pickle.h"

/* ---- Looking things up ----------------------------------------------------------------------- */

static bool is_sequence(const struct spin_value *v)
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
    if (!list_or_tuple || !is_sequence(list_or_tuple) || index >= list_or_tuple->n)
        return NULL;
    return list_or_tuple->item[index];
}

const char *spin_value_text(const struct spin_value *v)
{
    return v && (v->kind == SPIN_VALUE_TEXT || v->kind == SPIN_VALUE_BYTES) ? v->text : NULL;
}

/* ---- Elements -------------------------------------------------------------------------------- */

static uint64_t item_bits(const struct spin_tensor *t, const unsigned char *p)
{
    uint64_t bits = 0;

    for (int i = 0; i < t->item_size; i++)
        bits |= (uint64_t)p[i] << 8 * (t->big_endian ? t->item_size - 1 - i : i);
    return bits;
}

static float float_of(uint32_t bits)
{
    float f;

    memcpy(&f, &bits, 4);
    return f;
}

/* IEEE half precision: 1 sign, 5 exponent, 10 fraction bits. */
static double half_value(uint64_t bits)
{
    int exponent = bits >> 10 & 31;
    double fraction = (double)(bits & 1023);
    double value;

    if (exponent == 31)
        value = fraction == 0 ? INFINITY : NAN;
    else if (exponent == 0)
        value = ldexp(fraction, -24);
    else
        value = ldexp(fraction + 1024, exponent - 25);
    return bits & 0x8000 ? -value : value;
}

static int64_t signed_value(int item_size, uint64_t bits)
{
    int shift = 64 - 8 * item_size;

    return (int64_t)(bits << shift) >> shift;
}

static double item_f64(const struct spin_tensor *t, const unsigned char *p)
{
    uint64_t bits = item_bits(t, p);
    double d;

    switch (t->kind) {
    case 'f':
        if (t->item_size == 2)
            return half_value(bits);
        if (t->item_size == 4)
            return float_of((uint32_t)bits);
        memcpy(&d, &bits, 8);
        return d;
    case 'B': /* bfloat16: the upper half of a float */
        return float_of((uint32_t)bits << 16);
    case 'i':
        return (double)signed_value(t->item_size, bits);
    case 'b':
        return bits != 0;
    default:
        return (double)bits;
    }
}

/* Fractions are cut off; what does not fit becomes the nearest limit, NaN becomes 0. */
static int64_t item_i64(const struct spin_tensor *t, const unsigned char *p)
{
    uint64_t bits = item_bits(t, p);
    double v;

    switch (t->kind) {
    case 'i':
        return signed_value(t->item_size, bits);
    case 'u':
        return bits > INT64_MAX ? INT64_MAX : (int64_t)bits;
    case 'b':
        return bits != 0;
    default:
        v = item_f64(t, p);
        if (isnan(v))
            return 0;
        return v >= 0x1p63 ? INT64_MAX : v <= -0x1p63 ? INT64_MIN : (int64_t)v;
    }
}

static bool is_contiguous(const struct spin_tensor *t)
{
    uint64_t stride = 1;

    for (int i = t->n_dims - 1; i >= 0; i--) {
        if (t->shape[i] != 1 && (uint64_t)t->stride[i] != stride)
            return false;
        stride *= t->shape[i];
    }
    return true;
}

static bool host_is_little(void)
{
    const uint16_t one = 1;

    return *(const unsigned char *)&one == 1;
}

static bool is_native(const struct spin_tensor *t, char kind, size_t item_size)
{
    return t->kind == kind && (size_t)t->item_size == item_size &&
           t->big_endian != host_is_little() && is_contiguous(t);
}

/* Walks the elements in row-major order from a flat index on. */
struct walk {
    const struct spin_tensor *t;
    uint64_t at; /* element of the storage */
    uint64_t index[SPIN_NPY_MAX_DIMS];
};

static void walk_begin(struct walk *w, const struct spin_tensor *t, uint64_t first)
{
    w->t = t;
    w->at = t->offset;
    for (int i = t->n_dims - 1; i >= 0; i--) {
        w->index[i] = first % t->shape[i];
        first /= t->shape[i];
        w->at += w->index[i] * (uint64_t)t->stride[i];
    }
}

static void walk_on(struct walk *w)
{
    for (int i = w->t->n_dims - 1; i >= 0; i--) {
        w->at += (uint64_t)w->t->stride[i];
        if (++w->index[i] < w->t->shape[i])
            return;
        w->at -= (uint64_t)w->t->stride[i] * w->t->shape[i];
        w->index[i] = 0;
    }
}

#define TENSOR_TO(name, type, kind, item)                                                          \
    void name(const struct spin_tensor *t, uint64_t first, uint64_t count, type *out)              \
    {                                                                                              \
        struct walk w;                                                                             \
                                                                                                   \
        if (count == 0)                                                                            \
            return;                                                                                \
        if (is_native(t, kind, sizeof *out)) {                                                     \
            memcpy(out, t->data + (t->offset + first) * sizeof *out, (size_t)count * sizeof *out); \
            return;                                                                                \
        }                                                                                          \
        walk_begin(&w, t, first);                                                                  \
        for (uint64_t i = 0; i < count; i++) {                                                     \
            out[i] = (type)item(t, t->data + w.at * (uint64_t)t->item_size);                       \
            walk_on(&w);                                                                           \
        }                                                                                          \
    }

TENSOR_TO(spin_tensor_to_f32, float, 'f', item_f64)
TENSOR_TO(spin_tensor_to_i64, int64_t, 'i', item_i64)

const float *spin_tensor_f32(const struct spin_tensor *t)
{
    const unsigned char *p;

    if (!t->data || !is_native(t, 'f', sizeof(float)))
        return NULL;
    p = t->data + t->offset * sizeof(float);
    if ((uintptr_t)p % _Alignof(float) != 0)
        return NULL;
    return (const float *)(const void *)p;
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
        *out =
            item_f64(&v->tensor, v->tensor.data + v->tensor.offset * (uint64_t)v->tensor.item_size);
        return true;
    default:
        return false;
    }
}
