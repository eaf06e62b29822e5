/* Weights of traced modules. */
#include "importers/lib/torchscript.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/mem.h"
#include "io/zip.h"

/* Storage number `index`: finite floats, *count of them or, where it is 0, as many as there are. TorchScript
 * numbers storages as it meets them: weight and bias of the first layer, of the second. */
static spin_status read_storage(const struct spin_zip *zip, int index, size_t *count, float **out)
{
    const struct spin_zip_member *m = NULL;
    const unsigned char *data;
    void *owned = NULL;
    char name[24];
    spin_status status;

    snprintf(name, sizeof name, "/data/%d", index);
    for (size_t i = 0; i < zip->n; i++) {
        size_t n = strlen(zip->member[i].name), tail = strlen(name);

        if (n > tail && strcmp(zip->member[i].name + n - tail, name) == 0)
            m = &zip->member[i];
    }
    if (!m || m->size % 4 != 0 || m->size == 0 || (*count && m->size != 4 * (uint64_t)*count))
        return spin_fail(SPIN_E_MALFORMED,
                         "member 'data/%d' is missing or not of the size of its "
                         "layer",
                         index);
    SPIN_TRY(spin_zip_read(zip, m, true, 1u << 24, &data, &owned));
    *count = (size_t)m->size / 4;
    status = spin_alloc(*count, sizeof **out, (void **)out);
    if (status == SPIN_OK)
        memcpy(*out, data, (size_t)m->size);
    free(owned);
    SPIN_TRY(status);
    for (size_t i = 0; i < *count; i++) {
        if (!isfinite((*out)[i]))
            return spin_fail(SPIN_E_MALFORMED, "member 'data/%d' has values that are not finite",
                             index);
    }
    return SPIN_OK;
}

static spin_status read_layers(const struct spin_zip *zip, size_t a, size_t k,
                               struct mlp_linear layer[2])
{
    size_t n_in = 0, n_bias = a, n_out = a * k, n_last = k;

    SPIN_TRY(read_storage(zip, 0, &n_in, &layer[0].weight));
    if (n_in != a * (a + 3) && n_in != a * (a + 4))
        return spin_fail(SPIN_E_MALFORMED,
                         "member 'data/0' has %zu values, expected %zu or %zu for %zu features",
                         n_in, a * (a + 3), a * (a + 4), a);
    SPIN_TRY(read_storage(zip, 1, &n_bias, &layer[0].bias));
    SPIN_TRY(read_storage(zip, 2, &n_out, &layer[1].weight));
    SPIN_TRY(read_storage(zip, 3, &n_last, &layer[1].bias));
    layer[0].n_in = (int)(n_in / a);
    layer[0].n_out = layer[1].n_in = (int)a;
    layer[1].n_out = (int)k;
    return SPIN_OK;
}

spin_status spin_torchscript_load(const char *path, int n_features, int n_out,
                                  struct mlp_linear layer[2])
{
    struct spin_zip zip;
    spin_status status;

    memset(&zip, 0, sizeof zip);
    status = spin_zip_open(path, &zip);
    if (status == SPIN_OK)
        status = read_layers(&zip, (size_t)n_features, (size_t)n_out, layer);
    spin_zip_close(&zip);
    return spin_fail_reading(status, path);
}
