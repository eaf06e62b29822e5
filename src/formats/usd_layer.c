#include "formats/usd_layer.h"

#include <string.h>

#include "base/base.h"

spin_status spin_usd_open(const void *data, size_t size, struct spin_usd_layer *out)
{
    out->data = data;
    out->size = size;
    if (spin_usd_text_detect(data, size))
        return spin_usd_text_open(out);
    if (spin_usd_crate_detect(data, size))
        return spin_usd_crate_open(out);
    return spin_malformed("not a layer of USD: it begins neither with '#usda 1.0' nor with "
                          "'PXR-USDC'");
}

void spin_usd_close(struct spin_usd_layer *layer)
{
    spin_arena_free(&layer->arena);
    memset(layer, 0, sizeof *layer);
}

struct spin_usd_prim *spin_usd_child(const struct spin_usd_prim *prim, const char *name, size_t n)
{
    struct spin_usd_prim *child = prim->child;

    while (child && (strlen(child->name) != n || memcmp(child->name, name, n) != 0))
        child = child->next;
    return child;
}

struct spin_usd_prim *spin_usd_prim_at(struct spin_usd_layer *layer, const char *path)
{
    struct spin_usd_prim *prim = &layer->root;

    for (path += *path == '/'; prim && *path; path += *path == '/') {
        size_t n = strcspn(path, "/");

        prim = spin_usd_child(prim, path, n);
        path += n;
    }
    return prim;
}

struct spin_usd_field *spin_usd_field(struct spin_usd_field *list, const char *name)
{
    while (list && strcmp(list->name, name) != 0)
        list = list->next;
    return list;
}

struct spin_usd_value *spin_usd_sample_at(struct spin_usd_field *field, double time)
{
    size_t low = 0, high = field->n_samples;

    while (high - low > 1) {
        size_t middle = low + (high - low) / 2;

        if (field->sample[middle].time <= time)
            low = middle;
        else
            high = middle;
    }
    return field->n_samples > 0 ? &field->sample[low].value : NULL;
}

/* ---- Values ---------------------------------------------------------------------------------- */

static bool is_crate(const struct spin_usd_value *v) { return v->layer->crate != NULL; }

spin_status spin_usd_count(struct spin_usd_value *v, unsigned width, size_t *n)
{
    if (v->n_numbers == SIZE_MAX)
        SPIN_TRY(is_crate(v) ? spin_usd_crate_count(v, width, &v->n_numbers)
                             : spin_usd_text_count(v, width, &v->n_numbers));
    if (v->n_numbers % width != 0)
        return spin_malformed("%zu numbers, expected a multiple of %u", v->n_numbers, width);
    *n = v->n_numbers / width;
    return SPIN_OK;
}

static spin_status read_numbers(struct spin_usd_value *v, unsigned width, size_t n, float *floats,
                                double *doubles)
{
    size_t is = 0;

    SPIN_TRY(spin_usd_count(v, width, &is));
    if (is != n)
        return spin_malformed("%zu values, expected %zu", is, n);
    return is_crate(v) ? spin_usd_crate_numbers(v, n * width, floats, doubles)
                       : spin_usd_text_numbers(v, width, n * width, floats, doubles);
}

spin_status spin_usd_floats(struct spin_usd_value *v, unsigned width, size_t n, float *out)
{
    return read_numbers(v, width, n, out, NULL);
}

spin_status spin_usd_doubles(struct spin_usd_value *v, unsigned width, size_t n, double *out)
{
    return read_numbers(v, width, n, NULL, out);
}

spin_status spin_usd_text(const struct spin_usd_value *v, char **out)
{
    return is_crate(v) ? spin_usd_crate_text(v, out) : spin_usd_text_text(v, out);
}

spin_status spin_usd_reference(const struct spin_usd_value *item, char **asset, char **path)
{
    return is_crate(item) ? spin_usd_crate_reference(item, asset, path)
                          : spin_usd_text_reference(item, asset, path);
}

spin_status spin_usd_entry(const struct spin_usd_value *dictionary, const char *name,
                           struct spin_usd_value *out)
{
    return is_crate(dictionary) ? spin_usd_crate_entry(dictionary, name, out)
                                : spin_usd_text_entry(dictionary, name, out);
}

bool spin_usd_next(struct spin_usd_items *items, struct spin_usd_value *out)
{
    return is_crate(items->of) ? spin_usd_crate_next(items, out) : spin_usd_text_next(items, out);
}
