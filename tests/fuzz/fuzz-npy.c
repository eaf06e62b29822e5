/* Any bytes as an .npy array: parse, then read every value in every type.  K: fuzz npy */
#include "io/npy.h"
#include "tests/fuzz/input.h"

#include <stdlib.h>

static void read_values(const struct spin_array *a)
{
    uint64_t count = a->count < 1 << 16 ? a->count : 1 << 16, first = a->count - count;
    double *values = malloc((size_t)count * sizeof *values + 1);
    const float *in_place = spin_array_f32(a);
    volatile float sum = 0;
    char text[40];

    if (!values)
        return;
    spin_array_to_f32(a, first, count, (float *)values);
    spin_array_to_i64(a, first, count, (int64_t *)values);
    spin_array_to_f64(a, 0, count, values);
    if (in_place && a->count > 0)
        sum += in_place[a->count - 1];
    spin_array_shape_text(a->n_dims, a->shape, text, sizeof text);
    free(values);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t n)
{
    struct spin_array a;

    if (spin_npy_parse("x", data, n, &a) == SPIN_OK)
        read_values(&a);
    return 0;
}
