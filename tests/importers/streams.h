/* Checkpoints made by tests in the format of torch.save() before zip files. */
#ifndef SPIN_TESTS_IMPORTERS_STREAMS_H
#define SPIN_TESTS_IMPORTERS_STREAMS_H

#include "tests/importers/runs.h"

/* A legacy torch stream, written with protocol 2. Storages are floats, all taken from one array
 * of zeros. */
struct writer {
    FILE *file;
    int n_storages, count[64];
};

static inline void put_bytes(struct writer *w, const char *bytes, size_t n)
{
    fwrite(bytes, 1, n, w->file);
}

#define PUT(w, text) put_bytes(w, text, sizeof(text) - 1)

static inline void put_int(struct writer *w, int value)
{
    fputc('J', w->file);
    for (int i = 0; i < 4; i++)
        fputc(value >> 8 * i & 255, w->file);
}

static inline void put_text(struct writer *w, const char *text)
{
    int n = (int)strlen(text);

    fputc('X', w->file);
    for (int i = 0; i < 4; i++)
        fputc(n >> 8 * i & 255, w->file);
    put_bytes(w, text, (size_t)n);
}

/* b, c 0: fewer dimensions. */
static inline void put_tensor(struct writer *w, int a, int b, int c)
{
    int sizes[3] = {a, b, c}, n = c ? 3 : b ? 2 : 1, count = a * (b ? b : 1) * (c ? c : 1);
    char key[12];

    PUT(w, "ctorch._utils\n_rebuild_tensor_v2\n((");
    put_text(w, "storage");
    PUT(w, "ctorch\nFloatStorage\n");
    snprintf(key, sizeof key, "%d", w->n_storages);
    put_text(w, key);
    put_text(w, "cuda:0");
    put_int(w, count);
    PUT(w, "NtQ");
    put_int(w, 0);
    fputc('(', w->file);
    for (int i = 0; i < n; i++)
        put_int(w, sizes[i]);
    PUT(w, "t(");
    for (int i = 0; i < n; i++)
        put_int(w, (i < 1 ? (b ? b : 1) : 1) * (i < 2 ? (c ? c : 1) : 1));
    PUT(w, "t\x89"
           "ccollections\nOrderedDict\n)RtR");
    w->count[w->n_storages++] = count;
}

static inline void begin_stream(struct writer *w, const char *path)
{
    memset(w, 0, sizeof *w);
    w->file = fopen(path, "wb");
    if (!w->file)
        exit(1);
    PUT(w, "\x80\x02\x8a\x0al\xfc\x9c\x46\xf9 j\xa8P\x19.\x80\x02M\xe9\x03.\x80\x02}(");
    put_text(w, "protocol_version");
    PUT(w, "M\xe9\x03");
    put_text(w, "little_endian");
    PUT(w, "\x88");
    put_text(w, "type_sizes");
    PUT(w, "}u.\x80\x02");
}

/* Storages contain: logits 0, scales 1, quaternions of four equal numbers. */
static inline void end_stream(struct writer *w, float value)
{
    PUT(w, ".\x80\x02](");
    for (int i = 0; i < w->n_storages; i++) {
        char key[12];

        snprintf(key, sizeof key, "%d", i);
        put_text(w, key);
    }
    PUT(w, "e.");
    for (int i = 0; i < w->n_storages; i++) {
        int64_t n = w->count[i];

        fwrite(&n, sizeof n, 1, w->file);
        for (int k = 0; k < n; k++)
            fwrite(&value, sizeof value, 1, w->file);
    }
    fclose(w->file);
}

/* An item of a model: 'i' the int a, 'b' the bool a, 't' a tensor [a][b][c], 'n' None. */
struct item {
    char kind;
    int a, b, c;
};

/* (model, 123), where all tensors contain the same value. */
static inline const char *write_items(const char *path, const struct item *item, int n, float value)
{
    struct writer w;

    begin_stream(&w, path);
    PUT(&w, "((");
    for (int i = 0; i < n; i++) {
        if (item[i].kind == 'i')
            put_int(&w, item[i].a);
        else if (item[i].kind == 't')
            put_tensor(&w, item[i].a, item[i].b, item[i].c);
        else if (item[i].kind == 'b')
            put_bytes(&w, item[i].a ? "\x88" : "\x89", 1);
        else
            PUT(&w, "N");
    }
    PUT(&w, "tK{t");
    end_stream(&w, value);
    return path;
}

#endif
