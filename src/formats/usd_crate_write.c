#include "formats/usd_crate_write.h"

#include <stdlib.h>
#include <string.h>

#include "base/base.h"
#include "formats/gaussian.h"
#include "math/approx.h"

enum { HEAD = 88, SECTIONS = 6, KIND_ATTRIBUTE = 1, KIND_PRIM = 6, KIND_ROOT = 7 };
/* Types of values in addition to enum spin_usdc_type. */
enum { BOOL = 1, INT = 3, DOUBLE = 9, STRING = 10, DICTIONARY = 31, TOKEN_LIST = 32 };
enum { TOKEN_VECTOR = 41, SPECIFIER = 42, VARIABILITY = 44, SAMPLES = 46, DOUBLE_VECTOR = 48 };

/* A growing array of bytes. room: allocated bytes; status: a failure to allocate. */
struct bytes {
    unsigned char *data;
    size_t n, room;
    spin_status status;
};

static void append(struct bytes *b, const void *data, size_t n)
{
    while (b->status == SPIN_OK && b->room - b->n < n) {
        size_t room = 2 * b->room + n + 256;

        b->status = spin_grow(room, 1, (void **)&b->data);
        b->room = b->status == SPIN_OK ? room : b->room;
    }
    if (b->status == SPIN_OK && n > 0)
        memcpy(b->data + b->n, data, n);
    b->n += b->status == SPIN_OK ? n : 0;
}

static void append_int(struct bytes *b, uint64_t v, unsigned n)
{
    unsigned char at[8];

    for (unsigned i = 0; i < n; i++)
        at[i] = (unsigned char)(v >> 8 * i);
    append(b, at, n);
}

/* Returns the size of the numbers of which values of a type consist. */
static unsigned number_bytes(enum spin_usdc_type type)
{
    bool half = type == SPIN_USDC_HALF || type == SPIN_USDC_QUATH || type == SPIN_USDC_HALF3;

    return half ? 2 : type == SPIN_USDC_MATRIX4D ? 8 : 4;
}

/* Appends `bytes` bytes of numbers that are 2, 4 or 8 bytes wide (`width`), least significant byte
 * first. */
static void append_numbers(struct bytes *b, const void *data, size_t bytes, unsigned width)
{
    const unsigned char *from = data;
    uint16_t half = 0;
    uint32_t word = 0;
    uint64_t wide = 0;

    for (size_t at = 0; at < bytes; at += width) {
        memcpy(width == 8   ? (void *)&wide
               : width == 4 ? (void *)&word
                            : (void *)&half,
               from + at, width);
        append_int(b, width == 8 ? wide : width == 4 ? word : half, width);
    }
}

static uint64_t word_of(int type, bool is_array, bool is_inline, uint64_t payload)
{
    return (uint64_t)is_array << 63 | (uint64_t)is_inline << 62 | (uint64_t)type << 48 | payload;
}

/* ---- Values ---------------------------------------------------------------------------------- */

static void keep_status(struct spin_usdc_writer *w, spin_status status)
{
    w->status = w->status == SPIN_OK ? status : w->status;
}

/* Appends bytes to the file at a multiple of 8, and returns their offset. */
static uint64_t append_bytes(struct spin_usdc_writer *w, const void *data, size_t n)
{
    uint64_t at = w->at = (w->at + 7) / 8 * 8;

    if (w->status == SPIN_OK)
        keep_status(w, spin_out_write_at(w->out, at, data, n));
    w->at += n;
    return at;
}

/* Calls append_bytes() and frees the bytes. */
static uint64_t put_bytes(struct spin_usdc_writer *w, struct bytes *b)
{
    uint64_t at;

    keep_status(w, b->status);
    at = append_bytes(w, b->data, b->n);
    free(b->data);
    *b = (struct bytes){.n = 0};
    return at;
}

uint64_t spin_usdc_reserve(struct spin_usdc_writer *w, enum spin_usdc_type type, size_t n,
                           size_t bytes, uint64_t *offset)
{
    struct bytes count = {.n = 0};
    uint64_t at;

    *offset = w->at;
    if (n == 0)
        return word_of((int)type, true, false, 0);
    append_int(&count, n, 8);
    at = put_bytes(w, &count);
    *offset = w->at;
    w->at += (uint64_t)n * bytes;
    return word_of((int)type, true, false, at);
}

uint64_t spin_usdc_value(struct spin_usdc_writer *w, enum spin_usdc_type type, const void *data,
                         size_t bytes)
{
    struct bytes b = {.n = 0};

    append_numbers(&b, data, bytes, number_bytes(type));
    return word_of((int)type, false, false, put_bytes(w, &b));
}

uint64_t spin_usdc_array(struct spin_usdc_writer *w, enum spin_usdc_type type, size_t n,
                         const void *data, size_t bytes)
{
    struct bytes b = {.n = 0};

    append_int(&b, n, 8);
    append_numbers(&b, data, n * bytes, number_bytes(type));
    return word_of((int)type, true, false, put_bytes(w, &b));
}

uint64_t spin_usdc_int(int32_t v) { return word_of(INT, false, true, (uint32_t)v); }

uint64_t spin_usdc_float(float v)
{
    return word_of(SPIN_USDC_FLOAT, false, true, spin_bits_of_float(v));
}

uint64_t spin_usdc_double(struct spin_usdc_writer *w, double v)
{
    struct bytes b = {.n = 0};

    if ((double)(float)v == v)
        return word_of(DOUBLE, false, true, spin_bits_of_float((float)v));
    append_numbers(&b, &v, sizeof v, sizeof v);
    return word_of(DOUBLE, false, false, put_bytes(w, &b));
}

/* Returns the index of a token, which is added if it is new. */
static uint32_t token_index(struct spin_usdc_writer *w, const char *text)
{
    struct bytes b = {(unsigned char *)w->tokens, w->n_token_bytes, w->token_room, SPIN_OK};
    size_t i = 0;

    for (const char *t = w->tokens; i < w->n_tokens; i++, t += strlen(t) + 1)
        if (strcmp(t, text) == 0)
            return (uint32_t)i;
    append(&b, text, strlen(text) + 1);
    keep_status(w, b.status);
    w->tokens = (char *)b.data;
    w->n_token_bytes = b.n;
    w->token_room = b.room;
    w->n_tokens += b.status == SPIN_OK;
    return (uint32_t)i;
}

uint64_t spin_usdc_token(struct spin_usdc_writer *w, const char *text)
{
    return word_of(SPIN_USDC_TOKEN, false, true, token_index(w, text));
}

static uint32_t string_index(struct spin_usdc_writer *w, const char *text)
{
    spin_status status =
        spin_array_grow(w->n_strings, &w->string_room, sizeof *w->string, (void **)&w->string);

    keep_status(w, status);
    if (status == SPIN_OK)
        w->string[w->n_strings++] = token_index(w, text);
    return (uint32_t)w->n_strings - 1;
}

uint64_t spin_usdc_string(struct spin_usdc_writer *w, const char *text)
{
    return word_of(STRING, false, true, string_index(w, text));
}

uint64_t spin_usdc_tokens(struct spin_usdc_writer *w, const char *text)
{
    uint32_t index = token_index(w, text);

    return spin_usdc_array(w, SPIN_USDC_TOKEN, 1, &index, sizeof index);
}

uint64_t spin_usdc_flag(struct spin_usdc_writer *w, const char *name)
{
    struct bytes b = {.n = 0};

    append_int(&b, 1, 8);
    append_int(&b, string_index(w, name), 4);
    append_int(&b, 8, 8); /* distance in bytes from this field to the value */
    append_int(&b, word_of(BOOL, false, true, 1), 8);
    return word_of(DICTIONARY, false, false, put_bytes(w, &b));
}

uint64_t spin_usdc_samples(struct spin_usdc_writer *w, const double *time, const uint64_t *value,
                           size_t n)
{
    struct bytes b = {.n = 0};
    uint64_t times;

    append_int(&b, n, 8);
    append_numbers(&b, time, n * sizeof *time, sizeof *time);
    times = word_of(DOUBLE_VECTOR, false, false, put_bytes(w, &b));
    append_int(&b, 8, 8); /* distance in bytes from this field to the word of the times */
    append_int(&b, times, 8);
    append_int(&b, 8, 8); /* distance in bytes from this field to the values */
    append_int(&b, n, 8);
    for (size_t i = 0; i < n; i++)
        append_int(&b, value[i], 8);
    return word_of(SAMPLES, false, false, put_bytes(w, &b));
}

/* ---- Prims and attributes -------------------------------------------------------------------- */

static int32_t add_node(struct spin_usdc_writer *w, int32_t parent, const char *name,
                        bool is_attribute)
{
    spin_status status =
        spin_array_grow(w->n_nodes, &w->node_room, sizeof *w->node, (void **)&w->node);

    keep_status(w, status);
    if (w->status == SPIN_OK)
        w->node[w->n_nodes++] = (struct spin_usdc_node){
            .name = token_index(w, name), .parent = parent, .is_attribute = is_attribute};
    return (int32_t)w->n_nodes - 1;
}

static void add_field(struct spin_usdc_writer *w, struct spin_usdc_node *node, const char *name,
                      uint64_t value)
{
    if (w->status != SPIN_OK)
        return;
    node->field_name[node->n_fields] = token_index(w, name);
    node->field[node->n_fields++] = value;
}

void spin_usdc_field(struct spin_usdc_writer *w, const char *name, uint64_t value)
{
    add_field(w, &w->node[w->n_nodes - 1], name, value);
}

int32_t spin_usdc_prim(struct spin_usdc_writer *w, int32_t parent, const char *type,
                       const char *name)
{
    int32_t node = add_node(w, parent, name, false);

    spin_usdc_field(w, "specifier", word_of(SPECIFIER, false, true, 0));
    spin_usdc_field(w, "typeName", spin_usdc_token(w, type));
    return node;
}

void spin_usdc_attribute(struct spin_usdc_writer *w, int32_t prim, const char *type,
                         const char *name, bool uniform)
{
    add_node(w, prim, name, true);
    spin_usdc_field(w, "typeName", spin_usdc_token(w, type));
    if (uniform)
        spin_usdc_field(w, "variability", word_of(VARIABILITY, false, true, 1));
}

void spin_usdc_schema(struct spin_usdc_writer *w, const char *name)
{
    struct bytes b = {.n = 0};

    append_int(&b, 0x20, 1); /* the list operation has a list of prepended items */
    append_int(&b, 1, 8);
    append_int(&b, token_index(w, name), 4);
    spin_usdc_field(w, "apiSchemas", word_of(TOKEN_LIST, false, false, put_bytes(w, &b)));
}

void spin_usdc_begin(struct spin_usdc_writer *w, struct spin_out *out)
{
    w->out = out;
    w->at = HEAD;
    /* A token that is not used, at index 0: in the table of paths, names of attributes are stored
     * as negative indices, and 0 has no negative. */
    token_index(w, ";-)");
    add_node(w, 0, "", false);
}

/* Adds a field that lists the attributes or, if `attributes` is false, the child prims of node i.
 */
static void list_children(struct spin_usdc_writer *w, size_t i, bool attributes, const char *name)
{
    struct bytes b = {.n = 0};
    uint64_t n = 0;

    append_int(&b, 0, 8);
    for (size_t k = i + 1; k < w->n_nodes; k++)
        if (w->node[k].parent == (int32_t)i && w->node[k].is_attribute == attributes) {
            append_int(&b, w->node[k].name, 4);
            n++;
        }
    if (n == 0 || b.status != SPIN_OK) {
        keep_status(w, b.status);
        free(b.data);
        return;
    }
    for (unsigned k = 0; k < 8; k++)
        b.data[k] = (unsigned char)(n >> 8 * k);
    add_field(w, &w->node[i], name, word_of(TOKEN_VECTOR, false, false, put_bytes(w, &b)));
}

/* ---- Tables ---------------------------------------------------------------------------------- */

/* Appends a block in compressed form (usd_packed.h): a single chunk that consists of literals only.
 */
static void append_block(struct bytes *to, const struct bytes *block)
{
    struct bytes b = {.status = block->status};
    size_t n = block->n;

    append_int(&b, 0, 1);
    append_int(&b, (n < 15 ? n : 15) << 4, 1);
    for (size_t rest = n; n >= 15; rest -= 255) {
        if (rest - 15 < 255) {
            append_int(&b, rest - 15, 1);
            break;
        }
        append_int(&b, 255, 1);
    }
    append(&b, block->data, n);
    append_int(to, b.n, 8);
    append(to, b.data, b.n);
    to->status = to->status == SPIN_OK ? b.status : to->status;
    free(b.data);
}

/* Appends integers in compressed form (usd_packed.h). The most frequent difference is assumed to be
 * 1; all other differences are stored in 4 bytes. */
static void append_ints(struct bytes *to, const struct bytes *ints)
{
    struct bytes codes = {.n = 0}, rest = {.n = 0};
    size_t n = ints->n / 4;
    uint32_t before = 0;
    unsigned byte = 0;

    append_int(&codes, 1, 4);
    for (size_t i = 0; i < n; i++) {
        uint32_t now = spin_u32_at(ints->data + 4 * i);

        if (now - before != 1) {
            byte |= 3u << 2 * (i % 4);
            append_int(&rest, now - before, 4);
        }
        before = now;
        if (i % 4 == 3 || i + 1 == n) {
            append_int(&codes, byte, 1);
            byte = 0;
        }
    }
    append(&codes, rest.data, rest.n);
    codes.status = rest.status != SPIN_OK ? rest.status : codes.status;
    append_block(to, &codes);
    free(rest.data);
    free(codes.data);
}

/* Returns the jump of row i in the table of paths. -2: row i has no child and no later sibling; -1:
 * the next row is its child, and there is no later sibling; 0: the next row is its sibling; k > 0:
 * the next row is its child, and row i + k its sibling. */
static int32_t jump_of(const struct spin_usdc_writer *w, size_t i)
{
    bool child = i + 1 < w->n_nodes && w->node[i + 1].parent == (int32_t)i;

    for (size_t k = i + 1; i > 0 && k < w->n_nodes; k++) {
        if (w->node[k].parent == w->node[i].parent)
            return child ? (int32_t)(k - i) : 0;
        if (w->node[k].parent < w->node[i].parent)
            break;
    }
    return child ? -1 : -2;
}

static void append_paths(const struct spin_usdc_writer *w, struct bytes *to)
{
    struct bytes path = {.n = 0}, name = {.n = 0}, jump = {.n = 0};

    append_int(to, w->n_nodes, 8);
    append_int(to, w->n_nodes, 8);
    for (size_t i = 0; i < w->n_nodes; i++) {
        append_int(&path, i, 4);
        append_int(&name, w->node[i].is_attribute ? -(uint64_t)w->node[i].name : w->node[i].name,
                   4);
        append_int(&jump, (uint64_t)(int64_t)jump_of(w, i), 4);
    }
    append_ints(to, &path);
    append_ints(to, &name);
    append_ints(to, &jump);
    free(path.data);
    free(name.data);
    free(jump.data);
}

static void append_specs(const struct spin_usdc_writer *w, struct bytes *to)
{
    struct bytes path = {.n = 0}, set = {.n = 0}, kind = {.n = 0};
    uint64_t at = 0;

    append_int(to, w->n_nodes, 8);
    for (size_t i = 0; i < w->n_nodes; i++) {
        append_int(&path, i, 4);
        append_int(&set, at, 4);
        append_int(&kind,
                   i == 0                    ? KIND_ROOT
                   : w->node[i].is_attribute ? KIND_ATTRIBUTE
                                             : KIND_PRIM,
                   4);
        at += (uint64_t)w->node[i].n_fields + 1;
    }
    append_ints(to, &path);
    append_ints(to, &set);
    append_ints(to, &kind);
    free(path.data);
    free(set.data);
    free(kind.data);
}

static void append_fields(const struct spin_usdc_writer *w, struct bytes *to)
{
    struct bytes name = {.n = 0}, word = {.n = 0};

    for (size_t i = 0; i < w->n_nodes; i++)
        for (int f = 0; f < w->node[i].n_fields; f++) {
            append_int(&name, w->node[i].field_name[f], 4);
            append_int(&word, w->node[i].field[f], 8);
        }
    append_int(to, name.n / 4, 8);
    append_ints(to, &name);
    append_block(to, &word);
    free(name.data);
    free(word.data);
}

/* Appends the lists of fields, one for each node. Each list ends with -1. */
static void append_sets(const struct spin_usdc_writer *w, struct bytes *to)
{
    struct bytes set = {.n = 0};
    uint64_t at = 0;

    for (size_t i = 0; i < w->n_nodes; i++) {
        for (int f = 0; f < w->node[i].n_fields; f++)
            append_int(&set, at++, 4);
        append_int(&set, UINT32_MAX, 4);
    }
    append_int(to, set.n / 4, 8);
    append_ints(to, &set);
    free(set.data);
}

static void append_tokens(const struct spin_usdc_writer *w, struct bytes *to)
{
    const struct bytes all = {(unsigned char *)w->tokens, w->n_token_bytes, 0, SPIN_OK};

    append_int(to, w->n_tokens, 8);
    append_int(to, w->n_token_bytes, 8);
    append_block(to, &all);
}

static void append_strings(const struct spin_usdc_writer *w, struct bytes *to)
{
    append_int(to, w->n_strings, 8);
    for (size_t i = 0; i < w->n_strings; i++)
        append_int(to, w->string[i], 4);
}

spin_status spin_usdc_end(struct spin_usdc_writer *w)
{
    static const struct {
        const char *name;
        void (*append)(const struct spin_usdc_writer *w, struct bytes *to);
    } sections[SECTIONS] = {{"TOKENS", append_tokens}, {"STRINGS", append_strings},
                            {"FIELDS", append_fields}, {"FIELDSETS", append_sets},
                            {"PATHS", append_paths},   {"SPECS", append_specs}};
    struct bytes table = {.n = 0}, section = {.n = 0}, head = {.n = 0};

    for (size_t i = 0; i < w->n_nodes && w->status == SPIN_OK; i++) {
        list_children(w, i, true, "properties");
        list_children(w, i, false, "primChildren");
    }
    append_int(&table, SECTIONS, 8);
    for (int s = 0; s < SECTIONS && w->status == SPIN_OK; s++) {
        char name[16] = "";
        size_t n;

        snprintf(name, sizeof name, "%s", sections[s].name);
        sections[s].append(w, &section);
        n = section.n;
        append(&table, name, sizeof name);
        append_int(&table, put_bytes(w, &section), 8);
        append_int(&table, n, 8);
    }
    append(&head, "PXR-USDC\0\10\0\0\0\0\0", 16); /* the version is 0.8.0 */
    append_int(&head, put_bytes(w, &table), 8);
    append(&head, (const char[64]){0}, 64);
    keep_status(w, head.status);
    if (w->status == SPIN_OK)
        keep_status(w, spin_out_write_at(w->out, 0, head.data, head.n));
    free(head.data);
    return w->status;
}

void spin_usdc_free(struct spin_usdc_writer *w)
{
    free(w->tokens);
    free(w->string);
    free(w->node);
    *w = (struct spin_usdc_writer){.at = 0};
}
