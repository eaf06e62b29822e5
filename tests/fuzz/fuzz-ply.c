/* Any bytes as a PLY: open, then read every column. */
#include <stdlib.h>

#include "io/ply.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    struct spin_ply ply;

    if (spin_ply_parse("fuzz", data, size, &ply) != SPIN_OK)
        return 0;
    for (size_t i = 0; i < ply.n_elements; i++) {
        const struct spin_ply_element *e = &ply.element[i];
        float *out = e->count <= size ? malloc((e->count + 1) * sizeof *out) : NULL;

        for (size_t p = 0; out && p < e->n_properties; p++) {
            if (!e->property[p].is_list)
                spin_ply_column(&ply, e, (int)p, out, 1);
        }
        free(out);
    }
    spin_ply_close(&ply);
    return 0;
}
