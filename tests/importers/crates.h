/* Crates of USD made by tests: tokens, values, paths and specs in the order in which they are
 * added, and blocks that LZ4 leaves as they are. */
#ifndef SPIN_TESTS_IMPORTERS_CRATES_H
#define SPIN_TESTS_IMPORTERS_CRATES_H

#include "tests/importers/models.h"

enum { MOST_ITEMS = 256, MOST_BYTES = 65536 };

struct crate {
    const char *token[MOST_ITEMS];
    int n_tokens, n_fields, n_set, n_paths, n_specs;
    int32_t field[MOST_ITEMS], set[MOST_ITEMS];
    uint64_t word[MOST_ITEMS];
    int32_t parent[MOST_ITEMS], element[MOST_ITEMS]; /* of paths, depth first */
    int32_t spec[MOST_ITEMS][3];                     /* path, set, kind */
    unsigned char bytes[MOST_BYTES];
    size_t n;
};

static inline uint32_t crate_token(struct crate *c, const char *text)
{
    for (int i = 0; i < c->n_tokens; i++)
        if (strcmp(c->token[i], text) == 0)
            return (uint32_t)i;
    c->token[c->n_tokens] = text;
    return (uint32_t)c->n_tokens++;
}

static inline size_t crate_put(struct crate *c, const void *data, size_t n)
{
    size_t at = c->n;

    if (c->n + n > MOST_BYTES)
        exit(1);
    memcpy(c->bytes + c->n, data, n);
    c->n += n;
    return at;
}

static inline size_t crate_u64(struct crate *c, uint64_t v) { return crate_put(c, &v, 8); }
static inline size_t crate_u32(struct crate *c, uint32_t v) { return crate_put(c, &v, 4); }

static inline uint64_t crate_word(int type, uint64_t flags, uint64_t payload)
{
    return flags << 61 | (uint64_t)type << 48 | payload;
}

enum { CRATE_PACKED = 1, CRATE_INLINE = 2, CRATE_ARRAY = 4 };

static inline uint64_t crate_text(struct crate *c, int type, const char *text)
{
    return crate_word(type, CRATE_INLINE, crate_token(c, text));
}

/* An array, after its count. */
static inline uint64_t crate_array(struct crate *c, int type, uint64_t count, const void *data,
                                   size_t n)
{
    size_t at = crate_u64(c, count);

    crate_put(c, data, n);
    return crate_word(type, CRATE_ARRAY, at);
}

/* An array of tokens, strings or asset paths, or a vector of strings; strings are numbered like
 * tokens. */
static inline uint64_t crate_texts(struct crate *c, int type, const char *const *text)
{
    uint32_t index[16];
    size_t n = 0;

    for (; text[n]; n++)
        index[n] = crate_token(c, text[n]);
    return crate_array(c, type, n, index, 4 * n) &
           ~(type == 50 ? crate_word(0, CRATE_ARRAY, 0) : 0);
}

/* Samples, whose times are 0, 1, ... */
static inline uint64_t crate_samples(struct crate *c, const uint64_t *word, size_t n)
{
    size_t times = crate_u64(c, n), at;

    for (size_t i = 0; i < n; i++)
        crate_put(c, &(double){(double)i}, 8);
    at = crate_u64(c, 8);
    crate_u64(c, crate_word(48, 0, times));
    crate_u64(c, 8);
    crate_u64(c, n);
    crate_put(c, word, 8 * n);
    return crate_word(46, 0, at);
}

/* A list with one prepended reference (35) or payload (55), or a payload alone (47). */
static inline uint64_t crate_reference(struct crate *c, int type, const char *asset, uint32_t path)
{
    size_t at = type == 47 ? c->n : crate_put(c, &(char){0x20}, 1);

    if (type != 47)
        crate_u64(c, 1);
    crate_u32(c, crate_token(c, asset));
    crate_u32(c, path);
    crate_put(c, (double[]){0, 1}, 16);
    if (type == 35)
        crate_u64(c, 0);
    return crate_word(type, 0, at);
}

static inline int crate_path(struct crate *c, int parent, const char *name, bool property)
{
    int32_t token = (int32_t)crate_token(c, name);

    c->parent[c->n_paths] = parent;
    c->element[c->n_paths] = property ? -token : token;
    return c->n_paths++;
}

/* Begins the spec of a path; crate_field() adds to it. */
static inline void crate_spec(struct crate *c, int path, int kind)
{
    if (c->n_specs > 0)
        c->set[c->n_set++] = -1;
    memcpy(c->spec[c->n_specs++], (int32_t[]){path, c->n_set, kind}, 12);
}

static inline void crate_field(struct crate *c, const char *name, uint64_t word)
{
    c->field[c->n_fields] = (int32_t)crate_token(c, name);
    c->word[c->n_fields] = word;
    c->set[c->n_set++] = c->n_fields++;
}

static inline int crate_prim(struct crate *c, int parent, const char *name, const char *type)
{
    int path = crate_path(c, parent, name, false);

    crate_spec(c, path, path == 0 ? 7 : 6);
    crate_field(c, "specifier", crate_word(42, CRATE_INLINE, 0));
    if (type)
        crate_field(c, "typeName", crate_text(c, 11, type));
    return path;
}

static inline void crate_attribute(struct crate *c, int prim, const char *name, uint64_t word)
{
    crate_spec(c, crate_path(c, prim, name, true), 1);
    crate_field(c, (word >> 48 & 255) == 46 ? "timeSamples" : "default", word);
}

static inline void crate_begin(struct crate *c)
{
    memset(c, 0, sizeof *c);
    crate_token(c, ";-)");
    c->n = 88;
}

/* Writes a block of literals, preceded by its size. */
static inline void crate_block(struct crate *c, const void *data, size_t n)
{
    size_t size = crate_u64(c, 0), from;

    from = crate_put(c, (unsigned char[]){0, (unsigned char)(n < 15 ? n << 4 : 0xf0)}, 2);
    for (size_t left = n; n >= 15; left -= 255) {
        size_t more = left == n ? (left -= 15, left) : left;

        crate_put(c, &(unsigned char){(unsigned char)(more < 255 ? more : 255)}, 1);
        if (more < 255)
            break;
    }
    crate_put(c, data, n);
    memcpy(c->bytes + size, &(uint64_t){c->n - from}, 8);
}

/* Writes integers as differences of four bytes. */
static inline void crate_ints(struct crate *c, const int32_t *v, int n)
{
    unsigned char data[4 + MOST_ITEMS / 4 + 4 * MOST_ITEMS] = {0};
    size_t codes = ((size_t)n + 3) / 4;

    memset(data + 4, 0xff, codes);
    for (int i = 0; i < n; i++)
        memcpy(data + 4 + codes + 4 * (size_t)i,
               &(uint32_t){(uint32_t)v[i] - (i > 0 ? (uint32_t)v[i - 1] : 0)}, 4);
    crate_block(c, data, 4 + codes + 4 * (size_t)n);
}

static inline void crate_tokens(struct crate *c)
{
    char text[8192];
    size_t n = 0;

    for (int i = 0; i < c->n_tokens; i++)
        n += (size_t)snprintf(text + n, sizeof text - n, "%s", c->token[i]) + 1;
    crate_u64(c, (uint64_t)c->n_tokens);
    crate_u64(c, n);
    crate_block(c, text, n);
}

static inline void crate_paths(struct crate *c)
{
    int32_t index[MOST_ITEMS], jump[MOST_ITEMS];

    for (int i = 0; i < c->n_paths; i++) {
        int next = i + 1;

        while (next < c->n_paths && c->parent[next] != c->parent[i])
            next = c->parent[next] < i && c->parent[next] < c->parent[i] ? c->n_paths : next + 1;
        index[i] = i;
        jump[i] = i + 1 < c->n_paths && c->parent[i + 1] == i ? next < c->n_paths ? next - i : -1
                  : next < c->n_paths                         ? 0
                                                              : -2;
    }
    crate_u64(c, (uint64_t)c->n_paths + 1); /* the empty path is not in the tree */
    crate_u64(c, (uint64_t)c->n_paths);
    crate_ints(c, index, c->n_paths);
    crate_ints(c, c->element, c->n_paths);
    crate_ints(c, jump, c->n_paths);
}

static inline void crate_section(struct crate *c, int section)
{
    int32_t column[MOST_ITEMS];

    if (section == 0) {
        crate_tokens(c);
    } else if (section == 1) {
        crate_u64(c, (uint64_t)c->n_tokens);
        for (int i = 0; i < c->n_tokens; i++)
            crate_u32(c, (uint32_t)i);
    } else if (section == 2) {
        crate_u64(c, (uint64_t)c->n_fields);
        crate_ints(c, c->field, c->n_fields);
        crate_block(c, c->word, 8 * (size_t)c->n_fields);
    } else if (section == 3) {
        c->set[c->n_set++] = -1;
        crate_u64(c, (uint64_t)c->n_set);
        crate_ints(c, c->set, c->n_set);
    } else if (section == 4) {
        crate_paths(c);
    } else {
        crate_u64(c, (uint64_t)c->n_specs);
        for (int k = 0; k < 3; k++) {
            for (int i = 0; i < c->n_specs; i++)
                column[i] = c->spec[i][k];
            crate_ints(c, column, c->n_specs);
        }
    }
}

static inline void crate_write(struct crate *c, const char *path)
{
    static const char names[6][16] = {"TOKENS", "STRINGS", "FIELDS", "FIELDSETS", "PATHS", "SPECS"};
    uint64_t from[6], size[6], table;

    for (int i = 0; i < 6; i++) {
        from[i] = c->n;
        crate_section(c, i);
        size[i] = c->n - from[i];
    }
    table = crate_u64(c, 6);
    for (int i = 0; i < 6; i++) {
        crate_put(c, names[i], 16);
        crate_u64(c, from[i]);
        crate_u64(c, size[i]);
    }
    memcpy(c->bytes, "PXR-USDC\0\x08", 10);
    memcpy(c->bytes + 16, &table, 8);
    if (spin_out_whole(path, c->bytes, c->n, false) != SPIN_OK)
        exit(1);
}

#endif
