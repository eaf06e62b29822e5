/* Converts the elements of arrays (struct spin_array) to other types. */
#include "io/array.h"

#include "base/base.h"

void spin_array_set_strides(struct spin_array *a, bool fortran)
{
    int64_t stride = 1;

    for (int k = 0; k < a->n_dims; k++) {
        int i = fortran ? k : a->n_dims - 1 - k;

        a->stride[i] = stride;
        stride = (int64_t)((uint64_t)stride * a->shape[i]);
    }
}

bool spin_array_is_contiguous(const struct spin_array *a)
{
    uint64_t stride = 1;

    for (int i = a->n_dims - 1; i >= 0; i--) {
        if (a->shape[i] != 1 && (uint64_t)a->stride[i] != stride)
            return false;
        stride *= a->shape[i];
    }
    return true;
}

/* ---- One element ---------------------------------------------------------------------------- */

/* Returns the bits of the element at p as an unsigned number, whatever the byte order of the array.
 */
static uint64_t item_bits(const struct spin_array *a, const unsigned char *p)
{
    uint64_t bits = 0;

    for (int i = 0; i < a->item_size; i++)
        bits |= (uint64_t)p[i] << 8 * (a->big_endian ? a->item_size - 1 - i : i);
    return bits;
}

static float float_of(uint32_t bits)
{
    float f;

    memcpy(&f, &bits, 4);
    return f;
}

/* Converts an IEEE half-precision number, which has 1 sign bit, 5 exponent bits and 10 fraction
 * bits. */
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

static double item_f64(const struct spin_array *a, const unsigned char *p)
{
    uint64_t bits = item_bits(a, p);
    double d;

    switch (a->kind) {
    case 'f':
        if (a->item_size == 2)
            return half_value(bits);
        if (a->item_size == 4)
            return float_of((uint32_t)bits);
        memcpy(&d, &bits, 8);
        return d;
    case 'B': /* bfloat16: the upper half of a float */
        return float_of((uint32_t)bits << 16);
    case 'i':
        return (double)signed_value(a->item_size, bits);
    case 'b':
        return bits != 0;
    default:
        return (double)bits;
    }
}

static int64_t item_i64(const struct spin_array *a, const unsigned char *p)
{
    uint64_t bits = item_bits(a, p);
    double v;

    switch (a->kind) {
    case 'i':
        return signed_value(a->item_size, bits);
    case 'u':
        return bits > INT64_MAX ? INT64_MAX : (int64_t)bits;
    case 'b':
        return bits != 0;
    default:
        v = item_f64(a, p);
        if (isnan(v))
            return 0;
        return v >= 0x1p63 ? INT64_MAX : v <= -0x1p63 ? INT64_MIN : (int64_t)v;
    }
}

/* ---- Many elements -------------------------------------------------------------------------- */

static bool host_is_little(void)
{
    const uint16_t one = 1;

    return *(const unsigned char *)&one == 1;
}

static bool is_native(const struct spin_array *a, char kind, size_t item_size)
{
    return a->kind == kind && (size_t)a->item_size == item_size &&
           a->big_endian != host_is_little() && spin_array_is_contiguous(a);
}

/* An iterator over the elements in row-major order. */
struct walk {
    const struct spin_array *a;
    uint64_t at; /* index of the current element in the storage */
    uint64_t index[SPIN_NPY_MAX_DIMS];
    bool contiguous;
};

static void walk_begin(struct walk *w, const struct spin_array *a, uint64_t first)
{
    w->a = a;
    w->at = a->offset;
    w->contiguous = spin_array_is_contiguous(a);
    for (int i = a->n_dims - 1; i >= 0; i--) {
        w->index[i] = first % a->shape[i];
        first /= a->shape[i];
        w->at += w->index[i] * (uint64_t)a->stride[i];
    }
}

static void walk_on(struct walk *w)
{
    if (w->contiguous) {
        w->at++;
        return;
    }
    for (int i = w->a->n_dims - 1; i >= 0; i--) {
        w->at += (uint64_t)w->a->stride[i];
        if (++w->index[i] < w->a->shape[i])
            return;
        w->at -= (uint64_t)w->a->stride[i] * w->a->shape[i];
        w->index[i] = 0;
    }
}

#define ARRAY_TO(name, type, kind, item)                                                           \
    void name(const struct spin_array *a, uint64_t first, uint64_t count, type *out)               \
    {                                                                                              \
        struct walk w;                                                                             \
                                                                                                   \
        if (count == 0)                                                                            \
            return;                                                                                \
        if (is_native(a, kind, sizeof *out)) {                                                     \
            memcpy(out, a->data + (a->offset + first) * sizeof *out, (size_t)count * sizeof *out); \
            return;                                                                                \
        }                                                                                          \
        walk_begin(&w, a, first);                                                                  \
        for (uint64_t i = 0; i < count; i++) {                                                     \
            out[i] = (type)item(a, a->data + w.at * (uint64_t)a->item_size);                       \
            walk_on(&w);                                                                           \
        }                                                                                          \
    }

ARRAY_TO(spin_array_to_f32, float, 'f', item_f64)
ARRAY_TO(spin_array_to_f64, double, 'f', item_f64)
ARRAY_TO(spin_array_to_i64, int64_t, 'i', item_i64)

const float *spin_array_f32(const struct spin_array *a)
{
    const unsigned char *p;

    if (!a->data || !is_native(a, 'f', sizeof(float)))
        return NULL;
    p = a->data + a->offset * sizeof(float);
    if ((uintptr_t)p % _Alignof(float) != 0)
        return NULL;
    return (const float *)(const void *)p;
}

bool spin_array_set_type(struct spin_array *a, const char *code)
{
    static const struct {
        char kind;
        const char *sizes;
    } known[] = {{'f', "248"}, {'i', "1248"}, {'u', "1248"}, {'b', "1"}};

    for (size_t i = 0; i < sizeof known / sizeof known[0] && strlen(code) == 2; i++)
        if (code[0] == known[i].kind && strchr(known[i].sizes, code[1])) {
            a->kind = code[0];
            a->item_size = code[1] - '0';
            return true;
        }
    return false;
}

bool spin_array_has_shape(const struct spin_array *a, int n_dims, const int64_t *shape)
{
    for (int i = 0; i < n_dims && a->n_dims == n_dims; i++)
        if (shape[i] >= 0 && a->shape[i] != (uint64_t)shape[i])
            return false;
    return a->n_dims == n_dims;
}

void spin_array_shape_text(int n_dims, const uint64_t *shape, char *text, size_t n_text)
{
    size_t n = (size_t)snprintf(text, n_text, "[");

    for (int i = 0; i < n_dims && n < n_text; i++)
        n += (size_t)snprintf(text + n, n_text - n, shape[i] == UINT64_MAX ? "%s*" : "%s%llu",
                              i ? ", " : "", (unsigned long long)shape[i]);
    if (n < n_text)
        snprintf(text + n, n_text - n, "]");
}
