#include "formats/usd_layer.h"

#include <math.h>
#include <string.h>

#include "base/base.h"
#include "formats/gaussian.h"
#include "formats/usd_packed.h"

enum { HEAD = 88, MIN_VERSION = 7, MAX_VERSION = 13 };
/* Limits on the number of paths, and on the total number of fields and time samples. */
enum { MAX_PATHS = 1 << 24, MAX_FIELDS = 1 << 22 };
/* Arrays with fewer values than this are never compressed. */
enum { LEAST_PACKED = 16 };

enum kind { SPEC_ATTRIBUTE = 1, SPEC_PRIM = 6, SPEC_ROOT = 7 };

/* Types of values. ITEM is not a type of the format: this module uses it for the words of items of
 * lists of references, whose payload is the offset of the item. */
enum type {
    BOOL = 1,
    UCHAR,
    INT,
    UINT,
    INT64,
    UINT64,
    HALF,
    FLOAT,
    DOUBLE,
    STRING,
    TOKEN,
    ASSET,
    MATRIX2,
    MATRIX3,
    MATRIX4,
    QUATD,
    QUATF,
    QUATH,
    VEC2D,
    VEC4I = 30,
    DICTIONARY = 31,
    REFERENCES = 35,
    TOKENS = 41,
    SPECIFIER = 42,
    SAMPLES = 46,
    PAYLOAD = 47,
    DOUBLES = 48,
    STRINGS = 50,
    BLOCK = 51,
    PAYLOADS = 55,
    ITEM = 255
};

struct path {
    struct spin_usd_prim *prim;  /* the prim, or the owner of the property; NULL: neither */
    struct spin_usd_prim **tail; /* prims: end of the list of children; else NULL */
    const char *name;            /* name of the property; NULL: the path is that of a prim */
    uint32_t parent;
    struct spin_usd_field *attribute;
};

struct spin_usd_crate {
    const unsigned char *data;
    size_t size;
    const char **token;
    size_t n_tokens;
    uint32_t *string; /* [n_strings] indices of tokens */
    size_t n_strings;
    struct path *path;
    size_t n_paths;
    int32_t *field_name; /* [n_fields] indices of tokens */
    uint64_t *field_value;
    size_t n_fields;
    int32_t *set; /* [n_set] lists of indices of fields; each list ends with -1 */
    size_t n_set, n_made;
};

/* ---- Bytes ----------------------------------------------------------------------------------- */

/* A part of the file that is read sequentially. */
struct part {
    const unsigned char *at, *end;
};

static size_t left(const struct part *p) { return (size_t)(p->end - p->at); }

static spin_status part_at(const struct spin_usd_crate *c, uint64_t offset, struct part *out)
{
    *out = (struct part){c->data, c->data};
    if (offset > c->size)
        return spin_malformed("a value has offset %llu, but the file has only %zu bytes",
                              (unsigned long long)offset, c->size);
    *out = (struct part){c->data + offset, c->data + c->size};
    return SPIN_OK;
}

static spin_status skip_bytes(struct part *p, uint64_t n, const unsigned char **out)
{
    *out = p->at;
    if (n > left(p))
        return spin_malformed("the file ends within a value or a section");
    p->at += n;
    return SPIN_OK;
}

static spin_status read_u32(struct part *p, uint32_t *out)
{
    const unsigned char *at;

    SPIN_TRY(skip_bytes(p, 4, &at));
    *out = spin_u32_at(at);
    return SPIN_OK;
}

static uint64_t u64_at(const unsigned char *at)
{
    return spin_u32_at(at) | (uint64_t)spin_u32_at(at + 4) << 32;
}

static spin_status read_u64(struct part *p, uint64_t *out)
{
    const unsigned char *at;

    SPIN_TRY(skip_bytes(p, 8, &at));
    *out = u64_at(at);
    return SPIN_OK;
}

/* Reads the number of items that follow, each of which has at least `size` bytes. */
static spin_status read_count(struct part *p, size_t size, size_t *out)
{
    uint64_t n;

    *out = 0;
    SPIN_TRY(read_u64(p, &n));
    if (n > left(p) / size)
        return spin_malformed("%llu items do not fit into the file", (unsigned long long)n);
    *out = (size_t)n;
    return SPIN_OK;
}

/* Reads an offset of 8 bytes, and moves *p by this offset, counted from the position at which the
 * offset is stored. */
static spin_status follow(const struct spin_usd_crate *c, struct part *p)
{
    uint64_t from = (uint64_t)(p->at - c->data), distance;

    SPIN_TRY(read_u64(p, &distance));
    return part_at(c, from + distance, p);
}

/* Reads n compressed integers, preceded by the size of their block. */
static spin_status read_ints(struct part *p, uint64_t n, int32_t **out)
{
    const unsigned char *block;
    uint64_t size;

    SPIN_TRY(read_u64(p, &size));
    SPIN_TRY(skip_bytes(p, size, &block));
    return spin_usd_unpack_ints(block, (size_t)size, n, out);
}

/* The same as read_ints(), but allocates *out in the arena of the layer. */
static spin_status keep_ints(struct spin_usd_layer *layer, struct part *p, size_t n, int32_t **out)
{
    SPIN_FREED int32_t *ints = NULL;

    SPIN_TRY(read_ints(p, n, &ints));
    SPIN_TRY(spin_arena_take(&layer->arena, n + 1, sizeof **out, (void **)out));
    memcpy(*out, ints, n * sizeof **out);
    return SPIN_OK;
}

/* ---- Sections -------------------------------------------------------------------------------- */

static spin_status find_section(const struct spin_usd_crate *c, const char *name, struct part *out)
{
    struct part table;
    size_t n;

    SPIN_TRY(part_at(c, u64_at(c->data + 16), &table));
    SPIN_TRY(read_count(&table, 32, &n));
    for (; n > 0; n--) {
        const unsigned char *row;
        uint64_t start, size;

        SPIN_TRY(skip_bytes(&table, 32, &row));
        if (strncmp((const char *)row, name, 16) != 0)
            continue;
        start = u64_at(row + 16);
        size = u64_at(row + 24);
        if (start > c->size || size > c->size - start)
            return spin_malformed("section %s extends beyond the file", name);
        *out = (struct part){c->data + start, c->data + start + size};
        return SPIN_OK;
    }
    return spin_malformed("there is no section %s", name);
}

static spin_status read_tokens(struct spin_usd_layer *layer)
{
    struct spin_usd_crate *c = layer->crate;
    const unsigned char *block;
    uint64_t n, bytes, size;
    struct part p;
    char *text;

    SPIN_TRY(find_section(c, "TOKENS", &p));
    SPIN_TRY(read_u64(&p, &n));
    SPIN_TRY(read_u64(&p, &bytes));
    SPIN_TRY(read_u64(&p, &size));
    SPIN_TRY(skip_bytes(&p, size, &block));
    if (bytes / 256 > size || n > bytes)
        return spin_malformed("%llu tokens do not fit into %llu bytes", (unsigned long long)n,
                              (unsigned long long)size);
    SPIN_TRY(spin_arena_take(&layer->arena, (size_t)bytes + 1, 1, (void **)&text));
    SPIN_TRY(spin_arena_take(&layer->arena, (size_t)n + 1, sizeof *c->token, (void **)&c->token));
    if (spin_usd_unpack(block, (size_t)size, (unsigned char *)text, (size_t)bytes) != bytes)
        return spin_malformed("the table of tokens is malformed");
    for (uint64_t at = 0; c->n_tokens < n; at += strlen(text + at) + 1) {
        if (at >= bytes)
            return spin_malformed("there are %zu tokens, expected %llu", c->n_tokens,
                                  (unsigned long long)n);
        c->token[c->n_tokens++] = text + at;
    }
    return SPIN_OK;
}

static spin_status read_strings(struct spin_usd_layer *layer)
{
    struct spin_usd_crate *c = layer->crate;
    struct part p;

    SPIN_TRY(find_section(c, "STRINGS", &p));
    SPIN_TRY(read_count(&p, 4, &c->n_strings));
    SPIN_TRY(spin_arena_take(&layer->arena, c->n_strings, sizeof *c->string, (void **)&c->string));
    for (size_t i = 0; i < c->n_strings; i++)
        SPIN_TRY(read_u32(&p, &c->string[i]));
    return SPIN_OK;
}

static spin_status read_fields(struct spin_usd_layer *layer)
{
    struct spin_usd_crate *c = layer->crate;
    const unsigned char *block;
    uint64_t n, size;
    struct part p;

    SPIN_TRY(find_section(c, "FIELDS", &p));
    SPIN_TRY(read_u64(&p, &n));
    SPIN_TRY(keep_ints(layer, &p, (size_t)n, &c->field_name));
    SPIN_TRY(read_u64(&p, &size));
    SPIN_TRY(skip_bytes(&p, size, &block));
    if (n / 32 > size)
        return spin_malformed("%llu fields do not fit into %llu bytes", (unsigned long long)n,
                              (unsigned long long)size);
    SPIN_TRY(spin_arena_take(&layer->arena, (size_t)n + 1, sizeof *c->field_value,
                             (void **)&c->field_value));
    if (spin_usd_unpack(block, (size_t)size, (unsigned char *)c->field_value, 8 * (size_t)n) !=
        8 * n)
        return spin_malformed("the table of fields is malformed");
    for (size_t i = 0; i < n; i++)
        c->field_value[i] = u64_at((const unsigned char *)&c->field_value[i]);
    c->n_fields = (size_t)n;
    SPIN_TRY(find_section(c, "FIELDSETS", &p));
    SPIN_TRY(read_u64(&p, &n));
    c->n_set = (size_t)n;
    return keep_ints(layer, &p, c->n_set, &c->set);
}

/* ---- Paths ----------------------------------------------------------------------------------- */

/* The encoded tree of paths, with one row per path in depth-first order. */
struct tree {
    int32_t *path;  /* index of the path */
    int32_t *token; /* last name of the path; negative for properties */
    /* -2: the row has no child and no later sibling; -1: the next row is its child, and there is no
     * later sibling; 0: the next row is its sibling; k > 0: the next row is its child, and the row
     * k further is its sibling. */
    int32_t *jump;
    size_t n;
};

/* Creates the path of row i, whose parent is the path `parent`. */
static spin_status make_path(struct spin_usd_layer *layer, const struct tree *t, size_t i,
                             uint32_t parent)
{
    struct spin_usd_crate *c = layer->crate;
    struct path *above = &c->path[parent], *made = &c->path[(size_t)t->path[i]];
    size_t token = (size_t)(t->token[i] < 0 ? -(int64_t)t->token[i] : t->token[i]);

    if (token >= c->n_tokens || made->tail || made->name)
        return spin_malformed("the table of paths is malformed");
    made->parent = parent;
    made->name = t->token[i] < 0 || !above->tail ? c->token[token] : NULL;
    made->prim = above->tail ? above->prim : NULL;
    if (made->name)
        return SPIN_OK;
    layer->variants = layer->variants || c->token[token][0] == '{';
    SPIN_TRY(spin_arena_take(&layer->arena, 1, sizeof *made->prim, (void **)&made->prim));
    made->prim->name = c->token[token];
    made->prim->type = "";
    made->tail = &made->prim->child;
    *above->tail = made->prim;
    above->tail = &made->prim->next;
    return SPIN_OK;
}

/* Visits all rows of the tree from row 0, the root. The loop always ends: visiting a row again
 * would define its path a second time, which is an error. */
static spin_status walk_paths(struct spin_usd_layer *layer, const struct tree *t, size_t *stack)
{
    struct path *path = layer->crate->path;
    size_t i = 0, n_stack = 0;
    uint32_t parent = (uint32_t)t->path[0];

    path[parent].prim = &layer->root;
    path[parent].tail = &layer->root.child;
    for (;;) {
        int32_t jump = t->jump[i];

        if (i > 0)
            SPIN_TRY(make_path(layer, t, i, parent));
        if (jump > 0) {
            stack[n_stack++] = i + (size_t)jump;
            stack[n_stack++] = parent;
        }
        if (jump > 0 || jump == -1)
            parent = (uint32_t)t->path[i];
        if (jump != -2) {
            i++;
        } else if (n_stack > 0) {
            parent = (uint32_t)stack[--n_stack];
            i = stack[--n_stack];
        } else {
            return SPIN_OK;
        }
        if (i >= t->n)
            return spin_malformed("the table of paths is malformed");
    }
}

static spin_status walk_tree(struct spin_usd_layer *layer, const struct tree *t)
{
    SPIN_FREED size_t *stack = NULL;

    for (size_t i = 0; i < t->n; i++)
        if (t->path[i] < 0 || (size_t)t->path[i] >= layer->crate->n_paths || t->jump[i] < -2)
            return spin_malformed("the table of paths is malformed");
    if (t->n == 0)
        return spin_malformed("there are no paths");
    SPIN_TRY(spin_alloc(2 * t->n + 2, sizeof *stack, (void **)&stack));
    return walk_paths(layer, t, stack);
}

static spin_status read_paths(struct spin_usd_layer *layer)
{
    struct spin_usd_crate *c = layer->crate;
    SPIN_FREED int32_t *path = NULL, *token = NULL, *jump = NULL;
    uint64_t n_paths, n;
    struct part p;

    SPIN_TRY(find_section(c, "PATHS", &p));
    SPIN_TRY(read_u64(&p, &n_paths));
    SPIN_TRY(read_u64(&p, &n));
    /* A few paths, such as the empty path, are in the table but not in the tree. */
    if (n_paths > MAX_PATHS || n > n_paths || n_paths > 2 * n + 64)
        return spin_malformed("%llu paths are declared, but the tree of paths contains %llu",
                              (unsigned long long)n_paths, (unsigned long long)n);
    SPIN_TRY(read_ints(&p, n, &path));
    SPIN_TRY(read_ints(&p, n, &token));
    SPIN_TRY(read_ints(&p, n, &jump));
    c->n_paths = (size_t)n_paths;
    SPIN_TRY(spin_arena_take(&layer->arena, c->n_paths, sizeof *c->path, (void **)&c->path));
    return walk_tree(layer, &(struct tree){path, token, jump, (size_t)n});
}

/* ---- Specs ----------------------------------------------------------------------------------- */

static enum type type_of(uint64_t word) { return (enum type)(word >> 48 & 255u); }
static bool is_array(uint64_t word) { return word >> 63 != 0; }
static bool is_inline(uint64_t word) { return (word >> 62 & 1u) != 0; }
static bool is_packed(uint64_t word) { return (word >> 61 & 1u) != 0; }
static uint64_t payload_of(uint64_t word) { return word & 0xffffffffffffu; }

static struct spin_usd_value value_of(const struct spin_usd_layer *layer, uint64_t word)
{
    return (struct spin_usd_value){
        .layer = type_of(word) == BLOCK ? NULL : layer, .word = word, .n_numbers = SIZE_MAX};
}

static spin_status count_fields(struct spin_usd_crate *c, size_t n)
{
    c->n_made += n;
    return c->n_made <= MAX_FIELDS && n <= MAX_FIELDS
               ? SPIN_OK
               : spin_malformed("there are too many fields or time samples");
}

/* Reads the times of samples, and the words that represent the values of the samples. */
static spin_status read_samples(struct spin_usd_layer *layer, uint64_t word,
                                struct spin_usd_field *out)
{
    struct spin_usd_crate *c = layer->crate;
    struct part p, times;
    uint64_t times_word, value;
    size_t n, n_times;

    SPIN_TRY(part_at(c, payload_of(word), &p));
    SPIN_TRY(follow(c, &p));
    SPIN_TRY(read_u64(&p, &times_word));
    SPIN_TRY(part_at(c, payload_of(times_word), &times));
    SPIN_TRY(read_count(&times, 8, &n_times));
    SPIN_TRY(follow(c, &p));
    SPIN_TRY(read_count(&p, 8, &n));
    if (n != n_times || type_of(times_word) != DOUBLES)
        return spin_malformed("%zu time samples, but %zu times", n, n_times);
    SPIN_TRY(count_fields(c, n));
    SPIN_TRY(spin_arena_take(&layer->arena, n, sizeof *out->sample, (void **)&out->sample));
    for (size_t i = 0; i < n; i++) {
        uint64_t bits = 0;

        SPIN_TRY(read_u64(&times, &bits));
        memcpy(&out->sample[i].time, &bits, sizeof bits);
        SPIN_TRY(read_u64(&p, &value));
        out->sample[i].value = value_of(layer, value);
        if (i > 0 && !(out->sample[i].time > out->sample[i - 1].time))
            return spin_malformed("the times of samples do not increase");
    }
    out->n_samples = n;
    return SPIN_OK;
}

static spin_status add_field(struct spin_usd_layer *layer, const char *name,
                             struct spin_usd_field **list, struct spin_usd_field **out)
{
    SPIN_TRY(count_fields(layer->crate, 1));
    SPIN_TRY(spin_arena_take(&layer->arena, 1, sizeof **out, (void **)out));
    (*out)->name = name;
    (*out)->next = *list;
    *list = *out;
    return SPIN_OK;
}

static const char *token_of(const struct spin_usd_crate *c, uint64_t index)
{
    return index < c->n_tokens ? c->token[index] : "";
}

/* Adds a field of a prim or of the layer. */
static spin_status add_metadata(struct spin_usd_layer *layer, struct spin_usd_prim *prim,
                                const char *name, uint64_t word)
{
    struct spin_usd_field *field;

    if (strcmp(name, "specifier") == 0)
        prim->defined = type_of(word) == SPECIFIER && payload_of(word) == 0;
    else if (strcmp(name, "typeName") == 0)
        prim->type = type_of(word) == TOKEN ? token_of(layer->crate, payload_of(word)) : "";
    else {
        SPIN_TRY(add_field(layer, name, &prim->metadata, &field));
        field->value = value_of(layer, word);
    }
    return SPIN_OK;
}

/* Adds a field of an attribute. Only default values and samples are kept. */
static spin_status add_attribute(struct spin_usd_layer *layer, struct path *path, const char *name,
                                 uint64_t word)
{
    bool samples = strcmp(name, "timeSamples") == 0 && type_of(word) == SAMPLES;

    if (!samples && strcmp(name, "default") != 0)
        return SPIN_OK;
    if (!path->attribute)
        SPIN_TRY(add_field(layer, path->name, &path->prim->attribute, &path->attribute));
    if (samples)
        return read_samples(layer, word, path->attribute);
    path->attribute->value = value_of(layer, word);
    return SPIN_OK;
}

static spin_status read_spec(struct spin_usd_layer *layer, int32_t path, int32_t set, int32_t kind)
{
    struct spin_usd_crate *c = layer->crate;
    struct path *p = c->path + path;

    if (path < 0 || (size_t)path >= c->n_paths || set < 0)
        return spin_malformed("the table of specs is malformed");
    for (size_t i = (size_t)set; i < c->n_set && c->set[i] >= 0; i++) {
        size_t f = (size_t)c->set[i];

        if (f >= c->n_fields || c->field_name[f] < 0 || (size_t)c->field_name[f] >= c->n_tokens)
            return spin_malformed("the table of fields is malformed");
        if (kind == SPEC_ATTRIBUTE && p->name && p->prim)
            SPIN_TRY(add_attribute(layer, p, c->token[c->field_name[f]], c->field_value[f]));
        else if ((kind == SPEC_PRIM || kind == SPEC_ROOT) && p->tail)
            SPIN_TRY(add_metadata(layer, p->prim, c->token[c->field_name[f]], c->field_value[f]));
    }
    return SPIN_OK;
}

static spin_status read_specs(struct spin_usd_layer *layer)
{
    SPIN_FREED int32_t *path = NULL, *set = NULL, *kind = NULL;
    struct part p;
    uint64_t n;

    SPIN_TRY(find_section(layer->crate, "SPECS", &p));
    SPIN_TRY(read_u64(&p, &n));
    SPIN_TRY(read_ints(&p, n, &path));
    SPIN_TRY(read_ints(&p, n, &set));
    SPIN_TRY(read_ints(&p, n, &kind));
    for (size_t i = 0; i < n; i++)
        SPIN_TRY(read_spec(layer, path[i], set[i], kind[i]));
    return SPIN_OK;
}

bool spin_usd_crate_detect(const void *data, size_t size)
{
    return size >= 8 && memcmp(data, "PXR-USDC", 8) == 0;
}

spin_status spin_usd_crate_open(struct spin_usd_layer *out)
{
    const unsigned char *data = out->data;

    out->root.name = out->root.type = "";
    if (out->size < HEAD)
        return spin_malformed("the file ends within the header of a crate");
    if (data[8] != 0 || data[9] < MIN_VERSION || data[9] > MAX_VERSION)
        return spin_unsupported("crate version %d.%d.%d, expected 0.%d to 0.%d", data[8], data[9],
                                data[10], MIN_VERSION, MAX_VERSION);
    SPIN_TRY(spin_arena_take(&out->arena, 1, sizeof *out->crate, (void **)&out->crate));
    out->crate->data = data;
    out->crate->size = out->size;
    SPIN_TRY(read_tokens(out));
    SPIN_TRY(read_strings(out));
    SPIN_TRY(read_fields(out));
    SPIN_TRY(read_paths(out));
    return read_specs(out);
}

/* ---- Numbers --------------------------------------------------------------------------------- */

/* Returns the type of the components of a value, and sets *width to the number of components of a
 * tuple: 1 for plain numbers, 0 for types that do not consist of numbers. */
static enum type component_of(enum type type, unsigned *width)
{
    static const enum type of[] = {DOUBLE, FLOAT, HALF, INT};

    *width = 1;
    if (type >= BOOL && type <= DOUBLE)
        return type;
    if (type >= MATRIX2 && type <= MATRIX4) {
        *width = (type - MATRIX2 + 2) * (type - MATRIX2 + 2);
        return DOUBLE;
    }
    if (type >= QUATD && type <= QUATH) {
        *width = 4;
        return of[type - QUATD];
    }
    if (type >= VEC2D && type <= VEC4I) {
        *width = 2 + (type - VEC2D) / 4;
        return of[(type - VEC2D) % 4];
    }
    *width = 0;
    return BOOL;
}

static size_t size_of(enum type component)
{
    static const unsigned char size[] = {0, 1, 1, 4, 4, 8, 8, 2, 4, 8};

    return size[component];
}

static double half_of(uint32_t bits)
{
    uint32_t exponent = bits >> 10 & 31u, fraction = bits & 1023u;
    double a = exponent == 31  ? fraction ? NAN : INFINITY
               : exponent == 0 ? ldexp(fraction, -24)
                               : ldexp(1024 + fraction, (int)exponent - 25);

    return bits & 0x8000u ? -a : a;
}

static double number_at(enum type component, const unsigned char *at)
{
    uint32_t word = component == HALF || size_of(component) == 1 ? 0 : spin_u32_at(at);
    uint64_t wide = size_of(component) == 8 ? u64_at(at) : 0;
    double d;
    float f;

    switch (component) {
    case BOOL:
    case UCHAR:
        return at[0];
    case INT:
        return (int32_t)word;
    case UINT:
        return word;
    case INT64:
        return (double)(int64_t)wide;
    case UINT64:
        return (double)wide;
    case HALF:
        return half_of(at[0] | (uint32_t)at[1] << 8);
    case FLOAT:
        memcpy(&f, &word, sizeof f);
        return (double)f;
    default:
        memcpy(&d, &wide, sizeof d);
        return d;
    }
}

/* Returns number i of an inline value. In inline form, the numbers of a tuple are signed bytes; a
 * matrix has only its diagonal, also as signed bytes; a double is stored as a float; a 64-bit
 * integer is stored in 32 bits. */
static double inline_number(enum type component, unsigned width, bool matrix, uint64_t payload,
                            unsigned i)
{
    unsigned char bytes[8];
    unsigned side = width == 4 ? 2 : width == 9 ? 3 : 4;

    for (unsigned k = 0; k < 8; k++)
        bytes[k] = (unsigned char)(payload >> 8 * k);
    if (matrix)
        return i % (side + 1) == 0 ? (int8_t)bytes[i / (side + 1)] : 0;
    if (width > 1)
        return (int8_t)bytes[i];
    return number_at(component == DOUBLE   ? FLOAT
                     : component == INT64  ? INT
                     : component == UINT64 ? UINT
                                           : component,
                     bytes);
}

/* Where and how the numbers of a value are stored. Inline values have no part p. */
struct numbers {
    enum type component;
    unsigned width;
    size_t n;      /* tuples */
    struct part p; /* begins with the first number */
    bool packed, swap;
};

static spin_status find_numbers(const struct spin_usd_value *v, struct numbers *out)
{
    const struct spin_usd_crate *c = v->layer->crate;
    enum type type = type_of(v->word);

    *out = (struct numbers){.n = 1, .swap = type >= QUATD && type <= QUATH};
    out->component = component_of(type, &out->width);
    if (out->width == 0)
        return spin_malformed("expected numbers, not a value of type %d", (int)type);
    if (is_inline(v->word))
        return SPIN_OK;
    SPIN_TRY(part_at(c, payload_of(v->word), &out->p));
    if (is_array(v->word) && payload_of(v->word) == 0) {
        out->n = 0;
    } else if (is_array(v->word)) {
        uint64_t n;

        SPIN_TRY(read_u64(&out->p, &n));
        out->packed = is_packed(v->word) && n >= LEAST_PACKED;
        if (n / (out->packed ? 4 * 255 : 1) > left(&out->p))
            return spin_malformed("an array of %llu values does not fit into the file",
                                  (unsigned long long)n);
        out->n = (size_t)n;
    }
    if (!out->packed && out->n > left(&out->p) / (out->width * size_of(out->component)))
        return spin_malformed("an array of %zu values does not fit into the file", out->n);
    return SPIN_OK;
}

spin_status spin_usd_crate_count(const struct spin_usd_value *v, unsigned width, size_t *n)
{
    struct numbers of;

    SPIN_TRY(find_numbers(v, &of));
    if (of.width != width && of.width != 1)
        return spin_malformed("tuples of %u numbers, expected %u", of.width, width);
    *n = of.n * of.width;
    return SPIN_OK;
}

static void store_number(size_t i, double value, float *floats, double *doubles)
{
    if (floats)
        floats[i] = (float)value;
    else
        doubles[i] = value;
}

/* Reads compressed numbers. They are stored as integers or, for real numbers, as indices in a
 * table. */
static spin_status read_packed(struct numbers *of, float *floats, double *doubles)
{
    bool real = of->component == HALF || of->component == FLOAT || of->component == DOUBLE;
    size_t size = size_of(of->component);
    const unsigned char *code = (const unsigned char *)"i", *table = NULL;
    SPIN_FREED int32_t *ints = NULL;
    uint32_t n_table = 0;

    if (!real && size != 4)
        return spin_unsupported("compressed integers of %zu bytes are not supported", size);
    if (real)
        SPIN_TRY(skip_bytes(&of->p, 1, &code));
    if (*code == 't') {
        SPIN_TRY(read_u32(&of->p, &n_table));
        SPIN_TRY(skip_bytes(&of->p, (uint64_t)n_table * size, &table));
    } else if (*code != 'i') {
        return spin_malformed("numbers are compressed by an unknown code, %d", *code);
    }
    SPIN_TRY(read_ints(&of->p, of->n, &ints));
    for (size_t i = 0; i < of->n; i++) {
        if (table && (uint32_t)ints[i] >= n_table)
            return spin_malformed("index %u is out of range: the table has only %u values",
                                  (uint32_t)ints[i], n_table);
        store_number(i,
                     table ? number_at(of->component, table + (size_t)ints[i] * size)
                     : of->component == UINT ? (double)(uint32_t)ints[i]
                                             : (double)ints[i],
                     floats, doubles);
    }
    return SPIN_OK;
}

spin_status spin_usd_crate_numbers(const struct spin_usd_value *v, size_t n, float *floats,
                                   double *doubles)
{
    bool matrix = type_of(v->word) >= MATRIX2 && type_of(v->word) <= MATRIX4;
    struct numbers of;
    size_t size;

    SPIN_TRY(find_numbers(v, &of));
    if (of.packed)
        return read_packed(&of, floats, doubles);
    size = size_of(of.component);
    for (size_t i = 0; i < n; i++) {
        /* Quaternions are stored in the order x y z w. */
        size_t from = of.swap ? i - i % 4 + (i + 3) % 4 : i;

        store_number(i,
                     is_inline(v->word) ? inline_number(of.component, of.width, matrix,
                                                        payload_of(v->word), (unsigned)from)
                                        : number_at(of.component, of.p.at + from * size),
                     floats, doubles);
    }
    return SPIN_OK;
}

/* ---- Texts and lists ------------------------------------------------------------------------- */

/* Returns the text of a string, token or asset path with this index. Asset paths are stored as
 * tokens. */
static const char *text_of(const struct spin_usd_crate *c, enum type type, uint64_t index)
{
    if (type == STRING)
        return index < c->n_strings ? token_of(c, c->string[index]) : "";
    return token_of(c, index);
}

spin_status spin_usd_crate_text(const struct spin_usd_value *v, char **out)
{
    enum type type = type_of(v->word);

    if (is_array(v->word) || !is_inline(v->word) || type < STRING || type > ASSET)
        return spin_malformed("expected a text, not a value of type %d", (int)type);
    return spin_strdup(text_of(v->layer->crate, type, payload_of(v->word)), out);
}

/* Writes the path of a prim to `out`, [bytes]. Returns false if the path does not fit. */
static bool print_path(const struct spin_usd_crate *c, uint32_t path, char *out, size_t bytes)
{
    size_t at = bytes - 1;

    memset(out, 0, bytes);
    while (path < c->n_paths && c->path[path].prim && *c->path[path].prim->name) {
        const char *name = c->path[path].prim->name;
        size_t n = strlen(name);

        if (n + 1 > at)
            return false;
        at -= n + 1;
        out[at] = '/';
        memcpy(out + at + 1, name, n);
        path = c->path[path].parent;
    }
    memmove(out, out + at, bytes - at);
    return true;
}

spin_status spin_usd_crate_reference(const struct spin_usd_value *v, char **asset, char **path)
{
    const struct spin_usd_crate *c = v->layer->crate;
    char text[4096] = "";
    uint32_t string, at;
    struct part p;

    if (type_of(v->word) != ITEM) {
        SPIN_TRY(spin_usd_crate_text(v, asset));
        return spin_strdup("", path);
    }
    SPIN_TRY(part_at(c, payload_of(v->word), &p));
    SPIN_TRY(read_u32(&p, &string));
    SPIN_TRY(read_u32(&p, &at));
    if (!print_path(c, at, text, sizeof text))
        return spin_unsupported("a path has more than %zu bytes", sizeof text);
    SPIN_TRY(spin_strdup(text_of(c, STRING, string), asset));
    return spin_strdup(text, path);
}

spin_status spin_usd_crate_entry(const struct spin_usd_value *dictionary, const char *name,
                                 struct spin_usd_value *out)
{
    const struct spin_usd_crate *c = dictionary->layer->crate;
    struct part p;
    size_t n;

    *out = (struct spin_usd_value){.layer = NULL};
    if (type_of(dictionary->word) != DICTIONARY)
        return spin_malformed("expected a dictionary");
    if (is_inline(dictionary->word))
        return SPIN_OK;
    SPIN_TRY(part_at(c, payload_of(dictionary->word), &p));
    SPIN_TRY(read_count(&p, 12, &n));
    for (; n > 0; n--) {
        uint32_t key;
        uint64_t word;

        SPIN_TRY(read_u32(&p, &key));
        SPIN_TRY(follow(c, &p));
        SPIN_TRY(read_u64(&p, &word));
        if (name && strcmp(text_of(c, STRING, key), name) != 0)
            continue;
        *out = value_of(dictionary->layer, word);
        return SPIN_OK;
    }
    return SPIN_OK;
}

/* Sets *out to item i of an array of texts. The array is stored as the number of items, followed by
 * a 4-byte index for each item. Returns false if there is no such item. */
static bool text_item(const struct spin_usd_value *of, enum type type, size_t i,
                      struct spin_usd_value *out)
{
    struct part p;
    size_t n;

    if (payload_of(of->word) == 0 ||
        part_at(of->layer->crate, payload_of(of->word), &p) != SPIN_OK ||
        read_count(&p, 4, &n) != SPIN_OK || i >= n)
        return false;
    *out =
        value_of(of->layer, (uint64_t)1 << 62 | (uint64_t)type << 48 | spin_u32_at(p.at + 4 * i));
    return true;
}

/* Sets *out to item i of a list of references or payloads. Returns false if there is no such item.
 * USD stores a list operation as a byte followed by up to six lists, in the order explicit, added,
 * prepended, appended, deleted and ordered items. Bits 1, 2, 5, 6, 3 and 4 of the byte, in the same
 * order, specify which lists exist. Only the first list is read, unless it contains deleted or
 * ordered items. size: bytes of an item without custom data. */
static bool reference_item(const struct spin_usd_value *of, size_t size, size_t i,
                           struct spin_usd_value *out)
{
    const struct spin_usd_crate *c = of->layer->crate;
    const unsigned char *bits;
    struct part p;
    size_t n;

    if (part_at(c, payload_of(of->word), &p) != SPIN_OK || skip_bytes(&p, 1, &bits) != SPIN_OK ||
        (*bits & 0x66u) == 0 || read_count(&p, size, &n) != SPIN_OK || i >= n)
        return false;
    *out = value_of(of->layer, (uint64_t)ITEM << 48 | (uint64_t)(p.at + size * i - c->data));
    return true;
}

bool spin_usd_crate_next(struct spin_usd_items *items, struct spin_usd_value *out)
{
    uint64_t word = items->of->word;
    enum type type = type_of(word);
    size_t i = items->at++;

    if (type == TOKENS || type == STRINGS)
        return text_item(items->of, type == TOKENS ? TOKEN : STRING, i, out);
    if (type >= STRING && type <= ASSET && is_array(word))
        return text_item(items->of, type, i, out);
    if (type == REFERENCES || type == PAYLOADS)
        return reference_item(items->of, type == REFERENCES ? 32 : 24, i, out);
    if (i > 0)
        return false;
    *out = type == PAYLOAD ? value_of(items->of->layer, (uint64_t)ITEM << 48 | payload_of(word))
                           : *items->of;
    return type == PAYLOAD || (type >= STRING && type <= ASSET);
}
