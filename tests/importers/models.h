/* Shared by the tests of methods with a network: opening a model with options, and checkpoints
 * made by tests: a fixture's tensors with some of them changed. */
#ifndef SPIN_TESTS_IMPORTERS_MODELS_H
#define SPIN_TESTS_IMPORTERS_MODELS_H

#include "io/torch.h"
#include "tests/importers/runs.h"

/* run_open() with options: key, value, ..., NULL. */
static inline spin_status model_open(const char *from, const char *path, const char *const *pairs,
                                     struct run *run)
{
    struct spin_plugin_values values = {pairs};
    spin_status status;

    memset(run, 0, sizeof *run);
    status = spin_importer_find(path, from, false, &run->importer);
    if (status == SPIN_OK)
        status = run->importer->open(path, &values, &run->self, &run->sequence);
    if (status != SPIN_OK)
        run_close(run);
    return status;
}

/* Opening fails with a message of one line that contains both words. */
static inline void model_fails(const char *from, const char *path, const char *const *pairs,
                               const char *file, const char *word, const char *what)
{
    struct run run;
    spin_status status = model_open(from, path, pairs, &run);
    const char *said = status == SPIN_OK ? "" : spin_last_error();
    bool good = status != SPIN_OK && strstr(said, word) && !strchr(said, '\n') &&
                (!file || strstr(said, file));

    ok(good, "%s", what);
    if (!good)
        printf("#   status %d, '%s'\n", status, said);
    run_close(&run);
}

/* A copy of the file in which `other` replaces the first `line`. */
static inline const char *with_line(const char *path, const char *line, const char *other)
{
    const char *copy = path_in(new_folder(), spin_path_name(path));
    struct spin_map map;
    FILE *out = fopen(copy, "wb");
    const char *at;

    if (!out || spin_map_open(path, &map) != SPIN_OK ||
        !(at = memmem(map.data, map.size, line, strlen(line))))
        exit(1);
    fwrite(map.data, 1, (size_t)(at - (const char *)map.data), out);
    fputs(other, out);
    at += strlen(line);
    fwrite(at, 1, map.size - (size_t)(at - (const char *)map.data), out);
    fclose(out);
    spin_map_close(&map);
    return copy;
}

static inline double largest(const double *values, size_t n)
{
    double most = 0;

    for (size_t i = 0; i < n; i++)
        most = larger(most, fabs(values[i]));
    return most;
}

/* ---- Checkpoints ----------------------------------------------------------------------------- */

struct pth_tensor {
    char name[100];
    int dict;   /* which of a pair */
    bool whole; /* int32 */
    int n_dims;
    uint64_t shape[5], count;
    float *values;
};

struct pth {
    struct pth_tensor tensor[160];
    int n;
    bool pair;                /* a tuple of two dicts */
    const char *within;       /* the dict is the value of this key of another, */
    const char *key, *text;   /* which has this text too, */
    const char *number, *yes; /* a number of -1, and a True; NULL: none */
    const char *zero;         /* a number of 0 among the tensors; NULL: none */
};

static inline void pth_free(struct pth *pth)
{
    for (int i = 0; i < pth->n; i++)
        free(pth->tensor[i].values);
    pth->n = 0;
}

static inline struct pth_tensor *pth_find(struct pth *pth, const char *name)
{
    for (int i = 0; i < pth->n; i++) {
        if (strcmp(pth->tensor[i].name, name) == 0)
            return &pth->tensor[i];
    }
    printf("# no tensor '%s'\n", name);
    exit(1);
}

static inline void pth_drop(struct pth *pth, const char *name)
{
    struct pth_tensor *t = pth_find(pth, name);

    free(t->values);
    *t = pth->tensor[--pth->n];
}

/* A tensor of zeros, in place of the one of that name if there is one. */
static inline struct pth_tensor *pth_put(struct pth *pth, const char *name, int n_dims,
                                         const uint64_t *shape)
{
    struct pth_tensor *t = NULL;

    for (int i = 0; i < pth->n; i++) {
        if (strcmp(pth->tensor[i].name, name) == 0)
            t = &pth->tensor[i];
    }
    if (!t) {
        t = &pth->tensor[pth->n++];
        memset(t, 0, sizeof *t);
        snprintf(t->name, sizeof t->name, "%s", name);
    }
    free(t->values);
    t->n_dims = n_dims;
    t->count = 1;
    for (int d = 0; d < n_dims; d++) {
        t->shape[d] = shape[d];
        t->count *= shape[d];
    }
    t->values = calloc(t->count + 1, sizeof *t->values);
    return t;
}

static inline void pth_load_dict(struct spin_torch *torch, const struct spin_value *dict, int index,
                                 struct pth *pth)
{
    for (size_t i = 0; dict && i < dict->n; i++) {
        const char *name = spin_value_text(dict->item[2 * i]);
        struct pth_tensor *t = &pth->tensor[pth->n];
        struct spin_array tensor;

        if (pth->n == 160 ||
            spin_torch_tensor(torch, dict->item[2 * i + 1], name, &tensor) != SPIN_OK)
            exit(1);
        memset(t, 0, sizeof *t);
        pth->n++;
        snprintf(t->name, sizeof t->name, "%s", name);
        t->dict = index;
        t->whole = tensor.kind == 'i';
        t->n_dims = tensor.n_dims;
        memcpy(t->shape, tensor.shape, sizeof t->shape);
        t->count = tensor.count;
        t->values = malloc((t->count + 1) * sizeof *t->values);
        spin_array_to_f32(&tensor, 0, t->count, t->values);
    }
}

static inline void pth_load(const char *path, struct pth *pth)
{
    struct spin_torch torch;

    memset(pth, 0, sizeof *pth);
    if (spin_torch_open(path, &torch) != SPIN_OK) {
        printf("# %s\n", spin_last_error());
        exit(1);
    }
    pth->pair = torch.root->kind == SPIN_VALUE_TUPLE;
    for (int i = 0; i < (pth->pair ? 2 : 1); i++)
        pth_load_dict(&torch, pth->pair ? spin_value_at(torch.root, (size_t)i) : torch.root, i,
                      pth);
    spin_torch_close(&torch);
}

/* ---- Writing them ---------------------------------------------------------------------------- */

struct bytes {
    unsigned char *at;
    size_t n, capacity;
};

static inline void pickle(struct bytes *b, const void *data, size_t n)
{
    if (b->n + n > b->capacity) {
        b->capacity = 2 * (b->n + n) + 256;
        b->at = realloc(b->at, b->capacity);
    }
    memcpy(b->at + b->n, data, n);
    b->n += n;
}

static inline void pickle_op(struct bytes *b, const char *op) { pickle(b, op, strlen(op)); }

static inline void pickle_int(struct bytes *b, uint64_t v)
{
    uint32_t small = (uint32_t)v;

    pickle(b, "J", 1);
    pickle(b, &small, 4);
}

static inline void pickle_text(struct bytes *b, const char *text)
{
    uint32_t n = (uint32_t)strlen(text);

    pickle(b, "X", 1);
    pickle(b, &n, 4);
    pickle(b, text, n);
}

/* _rebuild_tensor_v2(storage, 0, sizes, strides, False, OrderedDict()) */
static inline void pickle_tensor(struct bytes *b, const struct pth_tensor *t, int index)
{
    uint64_t stride[5] = {1, 1, 1, 1, 1};
    char key[16];

    snprintf(key, sizeof key, "%d", index);
    for (int d = t->n_dims - 2; d >= 0; d--)
        stride[d] = stride[d + 1] * t->shape[d + 1];
    pickle_op(b, "ctorch._utils\n_rebuild_tensor_v2\n((");
    pickle_text(b, "storage");
    pickle_op(b, t->whole ? "ctorch\nIntStorage\n" : "ctorch\nFloatStorage\n");
    pickle_text(b, key);
    pickle_text(b, "cpu");
    pickle_int(b, t->count);
    pickle_op(b, "tQ");
    pickle_int(b, 0);
    pickle_op(b, "(");
    for (int d = 0; d < t->n_dims; d++)
        pickle_int(b, t->shape[d]);
    pickle_op(b, "t(");
    for (int d = 0; d < t->n_dims; d++)
        pickle_int(b, stride[d]);
    pickle_op(b, "t\x89"
                 "ccollections\nOrderedDict\n)RtR");
}

static inline void pth_member(struct spin_zip_writer *w, const char *name, const void *data,
                              size_t n)
{
    if (spin_zip_member_begin(w, name, n) != SPIN_OK ||
        spin_zip_member_write(w, data, n) != SPIN_OK || spin_zip_member_end(w) != SPIN_OK)
        exit(1);
}

static inline void pth_save(const struct pth *pth, const char *path)
{
    struct spin_zip_writer w;
    struct bytes b = {NULL, 0, 0};

    pickle_op(&b, "\x80\x02");
    if (pth->within) {
        pickle_op(&b, "}(");
        pickle_text(&b, pth->within);
    }
    for (int dict = 0; dict < (pth->pair ? 2 : 1); dict++) {
        pickle_op(&b, "}(");
        for (int i = 0; i < pth->n; i++) {
            if (pth->tensor[i].dict != dict)
                continue;
            pickle_text(&b, pth->tensor[i].name);
            pickle_tensor(&b, &pth->tensor[i], i);
        }
        if (pth->zero) {
            pickle_text(&b, pth->zero);
            pickle_int(&b, 0);
        }
        pickle_op(&b, "u");
    }
    if (pth->key) {
        pickle_text(&b, pth->key);
        pickle_text(&b, pth->text);
    }
    if (pth->number) {
        pickle_text(&b, pth->number);
        pickle_int(&b, (uint64_t)-1);
    }
    if (pth->yes) {
        pickle_text(&b, pth->yes);
        pickle_op(&b, "\x88");
    }
    if (pth->within)
        pickle_op(&b, "u");
    pickle_op(&b, pth->pair ? "\x86." : ".");
    if (spin_zip_writer_open(path, true, &w) != SPIN_OK)
        exit(1);
    pth_member(&w, "archive/data.pkl", b.at, b.n);
    pth_member(&w, "archive/version", "3\n", 2);
    for (int i = 0; i < pth->n; i++) {
        const struct pth_tensor *t = &pth->tensor[i];
        int32_t *whole = calloc(t->count + 1, sizeof *whole);
        char name[40];

        snprintf(name, sizeof name, "archive/data/%d", i);
        for (uint64_t k = 0; t->whole && k < t->count; k++)
            whole[k] = (int32_t)t->values[k];
        pth_member(&w, name, t->whole ? (void *)whole : (void *)t->values, 4 * t->count);
        free(whole);
    }
    free(b.at);
    if (spin_zip_writer_commit(&w) != SPIN_OK)
        exit(1);
}

/* ---- Files ----------------------------------------------------------------------------------- */

/* Byte for byte, including what the library would refuse to open. */
static inline void copy_file(const char *from, const char *to)
{
    char part[4096];
    struct spin_out out;
    FILE *file = fopen(from, "rb");
    size_t n;

    if (!file || spin_out_open(to, true, &out) != SPIN_OK) {
        printf("# cannot copy '%s'\n", from);
        exit(1);
    }
    while ((n = fread(part, 1, sizeof part, file)) > 0)
        if (spin_out_write(&out, part, n) != SPIN_OK)
            exit(1);
    if (fclose(file) != 0 || spin_out_commit(&out) != SPIN_OK)
        exit(1);
}

static inline void write_text(const char *path, const char *text)
{
    struct spin_out out;

    if (spin_out_open(path, true, &out) != SPIN_OK ||
        spin_out_write(&out, text, strlen(text)) != SPIN_OK || spin_out_commit(&out) != SPIN_OK)
        exit(1);
}

#endif
