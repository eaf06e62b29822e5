/* Checkpoints of 3DGS and its descendants. */
#include "importers/lib/chkpnt.h"

#include <ctype.h>

long long spin_chkpnt_iteration(const char *name)
{
    char *end;
    long long n;

    if (strcmp(name, "chkpnt_best.pth") == 0)
        return INT64_MAX;
    if (strncmp(name, "chkpnt", 6) != 0 || !isdigit((unsigned char)name[6]))
        return -1;
    n = strtoll(name + 6, &end, 10);
    return strcmp(end, ".pth") == 0 ? n : -1;
}

spin_status spin_chkpnt_choose(struct spin_model *m, const char *folder, const char *wanted,
                               const char **out, bool *best)
{
    char **names;
    long long largest = -1, asked = -1;
    size_t n;

    *out = NULL;
    *best = false;
    if (wanted)
        asked = strcmp(wanted, "best") == 0 ? INT64_MAX : strtoll(wanted, NULL, 10);
    SPIN_TRY(spin_model_names(m, folder, &names, &n));
    for (size_t i = 0; i < n; i++) {
        long long number = spin_chkpnt_iteration(names[i]);
        bool is_best = number == INT64_MAX;

        *best = *best || is_best;
        if (number < 0 || (wanted && number != asked))
            continue;
        if (!*out || (!is_best && number > largest)) {
            *out = names[i];
            largest = is_best ? -1 : number;
        }
    }
    *best = *out && *best && spin_chkpnt_iteration(*out) != INT64_MAX;
    return SPIN_OK;
}

spin_status spin_chkpnt_find(struct spin_model *m, const char *path)
{
    const char *name;
    bool best;

    if (!spin_path_is_folder(path))
        return spin_model_text(m, &m->path, "%s", path);
    m->path = NULL;
    SPIN_TRY(spin_chkpnt_choose(m, path, NULL, &name, &best));
    if (!name)
        return SPIN_OK;
    if (best)
        spin_note(m->sequence,
                  "'%s' is read; to import chkpnt_best.pth instead, give that file as the input",
                  name);
    return spin_model_join(m, &m->path, path, "%s", name);
}

const char *spin_chkpnt_kind(const struct spin_value *v)
{
    static const char *const names[] = {"None",   "a bool",   "an int",   "a float",
                                        "a text", "bytes",    "a list",   "a tuple",
                                        "a dict", "a tensor", "an object"};

    return v ? names[v->kind] : "nothing";
}

const char *spin_chkpnt_method(size_t n)
{
    static const struct {
        size_t n;
        const char *name;
    } makers[] = {
        {12, "plain 3DGS (--from realtime4dgs reads it)"},
        {14, "4DGaussians (give the model's folder)"},
        {18, "PVG, which is not supported"},
        {19, "Realtime-4DGS (--from realtime4dgs)"},
        {28, "Hybrid 3D-4DGS (--from hybrid4dgs)"},
        {40, "Ex4DGS (--from ex4dgs)"},
    };

    for (size_t i = 0; i < sizeof makers / sizeof *makers; i++) {
        if (makers[i].n == n)
            return makers[i].name;
    }
    return "an unknown method";
}

spin_status spin_chkpnt_model(const struct spin_value *root, size_t n_items, const char *method,
                              const struct spin_value **model, double *iteration)
{
    const struct spin_value *m = spin_value_at(root, 0), *number = spin_value_at(root, 1);

    *model = NULL;
    if (!root || root->kind != SPIN_VALUE_TUPLE || root->n != 2 || !m ||
        m->kind != SPIN_VALUE_TUPLE || !number || number->kind != SPIN_VALUE_INT)
        return spin_malformed("the checkpoint contains %s with %s and %s, expected (model, "
                              "iteration), where the model is a tuple and the iteration an int",
                              spin_chkpnt_kind(root), spin_chkpnt_kind(m),
                              spin_chkpnt_kind(number));
    if (m->n != n_items)
        return spin_unsupported(
            "the model is a tuple of %zu items, but that of %s has %zu: this is a model of %s",
            m->n, method, n_items, spin_chkpnt_method(m->n));
    *model = m;
    *iteration = number->number;
    return SPIN_OK;
}

spin_status spin_chkpnt_bind(struct spin_torch *torch, const struct spin_value *v, const char *what,
                             int n_dims, const int64_t *shape, struct spin_array *out)
{
    SPIN_TRY(spin_torch_tensor_of(torch, v, what, n_dims, shape, out));
    if (out->kind != 'f' && out->kind != 'B')
        return spin_malformed("%s does not contain floating-point numbers", what);
    if (out->count > out->storage_count)
        return spin_malformed("%s has %llu elements, but its storage has %llu", what,
                              (unsigned long long)out->count,
                              (unsigned long long)out->storage_count);
    return SPIN_OK;
}

bool spin_chkpnt_is_empty(const struct spin_value *v)
{
    return v && v->kind == SPIN_VALUE_TENSOR && v->tensor.count == 0;
}
