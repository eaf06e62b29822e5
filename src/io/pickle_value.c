/* The values of a pickle, looked up. */
#include "io/pickle_value.h"

#include <stdlib.h>
#include <string.h>

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
