/* Any bytes as a checkpoint: open it, bind and read every tensor within reach of the root.
 * K: fuzz torch */
#include "base/log.h"
#include "io/torch.h"
#include "tests/fuzz/input.h"

static void read_tensor(struct spin_torch *torch, const struct spin_value *v)
{
    float values[64];
    int64_t integers[64];
    struct spin_array t;
    uint64_t count, first;
    volatile float sum = 0;
    const float *in_place;

    if (spin_torch_tensor(torch, v, "x", &t) != SPIN_OK || t.count == 0)
        return;
    count = t.count < 64 ? t.count : 64;
    first = t.count - count;
    spin_array_to_f32(&t, first, count, values);
    spin_array_to_i64(&t, 0, count, integers);
    in_place = spin_array_f32(&t);
    if (in_place)
        sum += in_place[t.count - 1];
}

/* Values are a graph that may be endless as a tree: three levels, a few of each. */
static void read_values(struct spin_torch *torch, const struct spin_value *v, int depth)
{
    size_t n = v->kind == SPIN_VALUE_DICT ? 2 * v->n : v->n;
    double number;

    (void)spin_value_number(v, &number);
    (void)spin_value_get(v, "state");
    if (v->kind == SPIN_VALUE_TENSOR)
        read_tensor(torch, v);
    for (size_t i = 0; v->item && depth < 3 && i < n && i < 32; i++)
        read_values(torch, v->item[i], depth + 1);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t n)
{
    const char *path = input_path(data, n);
    struct spin_pickle pickle;
    struct spin_torch torch;

    spin_log_set_level(-2);
    if (path && spin_torch_open(path, &torch) == SPIN_OK) {
        read_values(&torch, torch.root, 0);
        spin_torch_close(&torch);
    }
    /* Inside a zip the fuzzer would have to get checksums right; so the pickle alone, too. */
    if (spin_pickle_parse("x", data, n, &pickle) == SPIN_OK)
        spin_pickle_free(&pickle);
    return 0;
}
