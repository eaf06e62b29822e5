/* PLY files: a text header, then the records of each element, as text or as packed binary values in
 * either byte order.
 *
 * The header is parsed line by line, since comments may contain anything. Binary records stay in
 * the map and are addressed by offset; text is converted to numbers once, on opening. Before memory
 * is allocated for a count, the count is compared with the size of the file. */
#include "io/ply.h"

#include <assert.h>

#include "base/base.h"

#define MAX_HEADER (128u * 1024)
/* spin_ply_columns() reads all requested columns of this many records before it continues with the
 * next records. 64 records of 62 floats occupy 16 KB, which fit in the L1 cache. */
#define BLOCK 64

static const int type_size[] = {1, 1, 2, 2, 4, 4, 4, 8};

/* ---- Header ---------------------------------------------------------------------------------- */

struct word {
    const char *text;
    size_t n;
};

/* The state of the parser of the header. */
struct header {
    const char *what;
    const char *at, *end;
    int line;
    bool has_format;
    size_t element_capacity, property_capacity, comment_capacity;
};

static bool is_blank(char c) { return c == ' ' || c == '\t' || c == '\r'; }

static bool word_is(struct word w, const char *text)
{
    return w.n == strlen(text) && memcmp(w.text, text, w.n) == 0;
}

/* Read the next word of the line; it is empty at the end of the line. */
static struct word next_word(const char **at, const char *end)
{
    struct word w;

    while (*at < end && is_blank(**at))
        (*at)++;
    w.text = *at;
    while (*at < end && !is_blank(**at))
        (*at)++;
    w.n = (size_t)(*at - w.text);
    return w;
}

/* Copy a word for a message: cut it off after 36 characters, and replace characters that are not
 * printable ASCII by '?'. */
static const char *word_text(struct word w, char text[40])
{
    size_t n = w.n < 36 ? w.n : 36;

    for (size_t i = 0; i < n; i++)
        text[i] = w.text[i] >= 32 && w.text[i] < 127 ? w.text[i] : '?';
    text[n] = '\0';
    return text;
}

static spin_status fail_line(const struct header *h, const char *why, struct word w)
{
    char text[40];

    return spin_malformed("'%s': header line %d: %s '%s'", h->what, h->line, why,
                          word_text(w, text));
}

static spin_status copy_name(const struct header *h, struct word w, char name[64])
{
    if (w.n == 0 || w.n > 63 || memchr(w.text, '\0', w.n))
        return fail_line(h, "empty or overlong name", w);
    memcpy(name, w.text, w.n);
    name[w.n] = '\0';
    return SPIN_OK;
}

static bool parse_type(struct word w, enum spin_ply_type *out)
{
    static const struct {
        const char *name;
        enum spin_ply_type type;
    } names[] = {{"float", SPIN_PLY_F32},   {"float32", SPIN_PLY_F32}, {"double", SPIN_PLY_F64},
                 {"float64", SPIN_PLY_F64}, {"uchar", SPIN_PLY_U8},    {"uint8", SPIN_PLY_U8},
                 {"char", SPIN_PLY_I8},     {"int8", SPIN_PLY_I8},     {"short", SPIN_PLY_I16},
                 {"int16", SPIN_PLY_I16},   {"ushort", SPIN_PLY_U16},  {"uint16", SPIN_PLY_U16},
                 {"int", SPIN_PLY_I32},     {"int32", SPIN_PLY_I32},   {"uint", SPIN_PLY_U32},
                 {"uint32", SPIN_PLY_U32}};

    for (size_t i = 0; i < sizeof names / sizeof names[0]; i++) {
        if (word_is(w, names[i].name)) {
            *out = names[i].type;
            return true;
        }
    }
    return false;
}

static bool parse_count(struct word w, uint64_t *out)
{
    uint64_t value = 0;

    if (w.n == 0)
        return false;
    for (size_t i = 0; i < w.n; i++) {
        if (w.text[i] < '0' || w.text[i] > '9')
            return false;
        if (__builtin_mul_overflow(value, 10, &value) ||
            __builtin_add_overflow(value, (uint64_t)(w.text[i] - '0'), &value))
            return false;
    }
    *out = value;
    return true;
}

static spin_status parse_format(struct header *h, const char *at, const char *end,
                                struct spin_ply *ply)
{
    struct word kind = next_word(&at, end), version = next_word(&at, end);

    if (h->has_format)
        return fail_line(h, "a second format", kind);
    if (!word_is(version, "1.0"))
        return fail_line(h, "unknown format version", version);
    ply->ascii = word_is(kind, "ascii");
    ply->big_endian = word_is(kind, "binary_big_endian");
    if (!ply->ascii && !ply->big_endian && !word_is(kind, "binary_little_endian"))
        return fail_line(h, "unknown format", kind);
    h->has_format = true;
    return SPIN_OK;
}

static spin_status parse_element(struct header *h, const char *at, const char *end,
                                 struct spin_ply *ply)
{
    struct word name = next_word(&at, end), count = next_word(&at, end);
    struct spin_ply_element e = {0};

    SPIN_TRY(copy_name(h, name, e.name));
    if (!parse_count(count, &e.count))
        return fail_line(h, "invalid count of an element:", count);
    if (spin_ply_find_element(ply, e.name))
        return fail_line(h, "a second element", name);
    SPIN_TRY(
        spin_array_grow(ply->n_elements, &h->element_capacity, sizeof e, (void **)&ply->element));
    ply->element[ply->n_elements++] = e;
    h->property_capacity = 0;
    return SPIN_OK;
}

static spin_status parse_property(struct header *h, const char *at, const char *end,
                                  struct spin_ply *ply)
{
    struct spin_ply_property p = {0};
    struct spin_ply_element *e;
    struct word type = next_word(&at, end);

    if (ply->n_elements == 0)
        return fail_line(h, "a property before any element:", type);
    e = &ply->element[ply->n_elements - 1];
    if (word_is(type, "list")) {
        struct word count = next_word(&at, end);

        p.is_list = true;
        if (!parse_type(count, &p.count_type) || p.count_type >= SPIN_PLY_F32)
            return fail_line(h, "the count of a list cannot have type", count);
        type = next_word(&at, end);
    }
    if (!parse_type(type, &p.type))
        return fail_line(h, "unknown type", type);
    SPIN_TRY(copy_name(h, next_word(&at, end), p.name));
    for (size_t i = 0; i < e->n_properties; i++) {
        if (strcmp(e->property[i].name, p.name) == 0)
            return spin_malformed("'%s': header line %d: element '%s' has property '%s' twice",
                                  h->what, h->line, e->name, p.name);
    }
    p.offset = e->stride;
    e->has_list |= p.is_list;
    e->stride += p.is_list ? 0 : (size_t)type_size[p.type];
    SPIN_TRY(
        spin_array_grow(e->n_properties, &h->property_capacity, sizeof p, (void **)&e->property));
    e->property[e->n_properties++] = p;
    return SPIN_OK;
}

static spin_status parse_comment(struct header *h, const char *at, const char *end,
                                 struct spin_ply *ply)
{
    size_t n;
    void *text = NULL;

    if (at < end && is_blank(*at))
        at++;
    while (end > at && is_blank(end[-1]))
        end--;
    n = (size_t)(end - at);
    SPIN_TRY(spin_array_grow(ply->n_comments, &h->comment_capacity, sizeof *ply->comment,
                             (void **)&ply->comment));
    SPIN_TRY(spin_alloc(n + 1, 1, &text));
    memcpy(text, at, n);
    ply->comment[ply->n_comments++] = text;
    return SPIN_OK;
}

/* Parse one line of the header, given without its line end. *done becomes true at the line
 * end_header. */
static spin_status parse_line(struct header *h, const char *at, const char *end,
                              struct spin_ply *ply, bool *done)
{
    struct word key = next_word(&at, end);

    if (word_is(key, "comment"))
        return parse_comment(h, at, end, ply);
    if (word_is(key, "obj_info"))
        return SPIN_OK;
    if (word_is(key, "format"))
        return parse_format(h, at, end, ply);
    if (word_is(key, "element"))
        return parse_element(h, at, end, ply);
    if (word_is(key, "property"))
        return parse_property(h, at, end, ply);
    if (!word_is(key, "end_header"))
        return fail_line(h, "unknown keyword", key);
    *done = true;
    return SPIN_OK;
}

static spin_status parse_header(struct spin_ply *ply, uint64_t *n_header)
{
    const char *data = (const char *)ply->map.data;
    size_t n_seen = ply->map.size < MAX_HEADER ? ply->map.size : MAX_HEADER;
    struct header h = {.what = ply->path, .at = data, .end = data + n_seen};
    bool done = false;

    if (n_seen < 4 || memcmp(data, "ply", 3) != 0 || (data[3] != '\n' && !is_blank(data[3])))
        return spin_malformed("'%s': not a PLY file: it does not begin with 'ply'", ply->path);
    while (!done) {
        const char *line = h.at;
        const char *stop = memchr(line, '\n', (size_t)(h.end - line));

        if (!stop)
            return spin_malformed("'%s': no end_header in the first %zu bytes", ply->path, n_seen);
        h.at = stop + 1;
        if (h.line++ > 0)
            SPIN_TRY(parse_line(&h, line, stop, ply, &done));
    }
    if (!h.has_format)
        return spin_malformed("'%s': header has no format line", ply->path);
    *n_header = (uint64_t)(h.at - data);
    return SPIN_OK;
}

/* ---- Binary body ---------------------------------------------------------------------------- */

static inline uint64_t load_bytes(const unsigned char *at, int n, bool big_endian)
{
    uint64_t bits = 0;

    for (int i = 0; i < n; i++)
        bits |= (uint64_t)at[i] << 8 * (big_endian ? n - 1 - i : i);
    return bits;
}

static inline float bits_to_float(uint32_t bits)
{
    float value;

    memcpy(&value, &bits, sizeof value);
    return value;
}

static double load_value(const unsigned char *at, enum spin_ply_type type, bool big_endian)
{
    uint64_t bits = load_bytes(at, type_size[type], big_endian);
    double value;

    switch (type) {
    case SPIN_PLY_I8:
        return (int8_t)bits;
    case SPIN_PLY_I16:
        return (int16_t)bits;
    case SPIN_PLY_I32:
        return (int32_t)bits;
    case SPIN_PLY_F32:
        return bits_to_float((uint32_t)bits);
    case SPIN_PLY_F64:
        memcpy(&value, &bits, sizeof value);
        return value;
    default:
        return (double)bits;
    }
}

/* *out receives the size in bytes of the value of property p at `at`. Returns false if the value
 * extends beyond the `left` bytes that remain in the file. */
static bool property_bytes(const struct spin_ply *ply, const struct spin_ply_property *p,
                           const unsigned char *at, uint64_t left, uint64_t *out)
{
    uint64_t size = (uint64_t)type_size[p->type];
    double count;

    if (p->is_list) {
        uint64_t n_count = (uint64_t)type_size[p->count_type];

        if (left < n_count)
            return false;
        count = load_value(at, p->count_type, ply->big_endian);
        if (count < 0)
            return false;
        size = n_count + (uint64_t)count * size; /* cannot overflow: at most 4 + (2^32 - 1) * 8 */
    }
    *out = size;
    return size <= left;
}

/* Advance *at past the records of an element with lists, which differ in size. */
static spin_status walk_lists(const struct spin_ply *ply, const struct spin_ply_element *e,
                              uint64_t *at)
{
    for (uint64_t i = 0; i < e->count; i++) {
        for (size_t p = 0; p < e->n_properties; p++) {
            uint64_t size;

            if (!property_bytes(ply, &e->property[p], ply->map.data + *at, ply->map.size - *at,
                                &size))
                return spin_malformed("'%s': property '%s' of record %llu of element '%s' extends "
                                      "beyond the end of the file: the file is cut short, or "
                                      "a list has a wrong count",
                                      ply->path, e->property[p].name, (unsigned long long)i,
                                      e->name);
            *at += size;
        }
    }
    return SPIN_OK;
}

static spin_status check_binary(struct spin_ply *ply, uint64_t at)
{
    for (size_t i = 0; i < ply->n_elements; i++) {
        struct spin_ply_element *e = &ply->element[i];
        uint64_t left = ply->map.size - at;

        e->data_offset = at;
        if (e->has_list) {
            SPIN_TRY(walk_lists(ply, e, &at));
            continue;
        }
        if (e->stride > 0 && e->count > left / e->stride)
            return spin_malformed("'%s': cut short: element '%s' has %llu records of %zu bytes, "
                                  "but only %llu bytes are left",
                                  ply->path, e->name, (unsigned long long)e->count, e->stride,
                                  (unsigned long long)left);
        at += e->count * e->stride;
    }
    ply->extra_bytes = ply->map.size - at;
    return SPIN_OK;
}

/* ---- Text body ------------------------------------------------------------------------------ */

struct text {
    const char *at, *end;        /* the lines after the current one */
    const char *word, *line_end; /* the part of the current line not read yet */
};

/* Advance to the next line that is not blank; returns false if there is none. */
static bool next_line(struct text *t)
{
    while (t->at < t->end) {
        const char *stop = memchr(t->at, '\n', (size_t)(t->end - t->at));

        t->word = t->at;
        t->line_end = stop ? stop : t->end;
        t->at = stop ? stop + 1 : t->end;
        for (const char *c = t->word; c < t->line_end; c++) {
            if (!is_blank(*c))
                return true;
        }
    }
    return false;
}

static bool next_number(struct text *t, double *out)
{
    struct word w = next_word(&t->word, t->line_end);
    char text[64], *stop;

    if (w.n == 0 || w.n >= sizeof text)
        return false;
    memcpy(text, w.text, w.n);
    text[w.n] = '\0';
    *out = strtod(text, &stop);
    return stop == text + w.n;
}

/* Read one record, which is one line. For a list, `value` receives the number of items, and the
 * items are skipped. */
static bool read_text_record(struct text *t, const struct spin_ply_element *e, double *value)
{
    double ignored;

    if (!next_line(t))
        return false;
    for (size_t p = 0; p < e->n_properties; p++) {
        if (!next_number(t, &value[p]))
            return false;
        if (!e->property[p].is_list)
            continue;
        if (!(value[p] >= 0))
            return false;
        for (double i = 0; i < value[p]; i++) {
            if (!next_number(t, &ignored))
                return false;
        }
    }
    return next_word(&t->word, t->line_end).n == 0;
}

static spin_status read_text(struct spin_ply *ply, uint64_t first)
{
    uint64_t n_values = 0, left = ply->map.size - first;
    struct text t = {.at = (const char *)ply->map.data + first};
    double *value;

    t.end = t.at + left;
    for (size_t i = 0; i < ply->n_elements; i++) {
        struct spin_ply_element *e = &ply->element[i];
        uint64_t n;

        /* A value occupies at least two bytes: a digit and a separator. */
        if (__builtin_mul_overflow(e->count, (uint64_t)e->n_properties, &n) ||
            __builtin_add_overflow(n_values, n, &n_values) || n_values > left / 2 + 1)
            return spin_malformed("'%s': cut short: element '%s' has %llu records of %zu values, "
                                  "but only %llu bytes follow the header",
                                  ply->path, e->name, (unsigned long long)e->count, e->n_properties,
                                  (unsigned long long)left);
    }
    SPIN_TRY(spin_alloc(n_values + 1, sizeof *value, (void **)&ply->ascii_values));
    value = ply->ascii_values;
    for (size_t i = 0; i < ply->n_elements; i++) {
        const struct spin_ply_element *e = &ply->element[i];

        for (uint64_t record = 0; record < e->count; record++, value += e->n_properties) {
            if (!read_text_record(&t, e, value))
                return spin_malformed(
                    "'%s': element '%s' record %llu is missing or is not a line of %zu numbers",
                    ply->path, e->name, (unsigned long long)record, e->n_properties);
        }
    }
    if (next_line(&t))
        ply->extra_bytes = (uint64_t)(t.end - t.word);
    return SPIN_OK;
}

/* ---- Opening -------------------------------------------------------------------------------- */

static spin_status parse_file(struct spin_ply *ply)
{
    uint64_t n_header = 0;

    SPIN_TRY(parse_header(ply, &n_header));
    for (size_t i = 0; i < ply->n_elements; i++) {
        if (ply->element[i].n_properties == 0 && ply->element[i].count > 0)
            return spin_malformed("'%s': element '%s' has records but no properties", ply->path,
                                  ply->element[i].name);
    }
    return ply->ascii ? read_text(ply, n_header) : check_binary(ply, n_header);
}

spin_status spin_ply_parse(const char *what, const unsigned char *bytes, size_t n_bytes,
                           struct spin_ply *out)
{
    spin_status status;

    *out = (struct spin_ply){.map = {.data = bytes, .size = n_bytes}, .borrowed = true};
    SPIN_TRY_OUT(spin_strdup(what, &out->path));
    SPIN_TRY_OUT(parse_file(out));
    return SPIN_OK;
out:
    spin_ply_close(out);
    return status;
}

spin_status spin_ply_open(const char *path, struct spin_ply *out)
{
    struct spin_map map;

    *out = (struct spin_ply){0};
    SPIN_TRY(spin_map_open(path, &map));
    spin_status status = spin_ply_parse(path, map.data, map.size, out);

    if (status != SPIN_OK)
        spin_map_close(&map);
    else
        out->borrowed = false;
    return status;
}

bool spin_ply_is_antialiased(const struct spin_ply *ply)
{
    for (size_t i = 0; i < ply->n_comments; i++)
        if (strcasecmp(ply->comment[i], "SplatRenderMode: mip") == 0 ||
            strcmp(ply->comment[i], "antialiased 1") == 0)
            return true;
    return false;
}

void spin_ply_close(struct spin_ply *ply)
{
    for (size_t i = 0; i < ply->n_elements; i++)
        free(ply->element[i].property);
    for (size_t i = 0; i < ply->n_comments; i++)
        free(ply->comment[i]);
    free(ply->element);
    free(ply->comment);
    free(ply->ascii_values);
    free(ply->path);
    if (ply->map.data && !ply->borrowed)
        spin_map_close(&ply->map);
    *ply = (struct spin_ply){0};
}

/* ---- Reading -------------------------------------------------------------------------------- */

const struct spin_ply_element *spin_ply_find_element(const struct spin_ply *ply, const char *name)
{
    for (size_t i = 0; i < ply->n_elements; i++) {
        if (strcmp(ply->element[i].name, name) == 0)
            return &ply->element[i];
    }
    return NULL;
}

spin_status spin_ply_vertices(const struct spin_ply *ply, const struct spin_ply_element **out)
{
    *out = spin_ply_find_element(ply, "vertex");
    if (!*out)
        return spin_malformed("'%s': no element 'vertex'", ply->path);
    return (*out)->count <= UINT32_MAX
               ? SPIN_OK
               : spin_unsupported("'%s': more than 2^32 vertices", ply->path);
}

int spin_ply_find(const struct spin_ply_element *e, const char *name)
{
    for (size_t i = 0; i < e->n_properties; i++) {
        if (!e->property[i].is_list && strcmp(e->property[i].name, name) == 0)
            return (int)i;
    }
    return -1;
}

/* Returns the element of ply->shift for the properties x, y and z, and 0 for others. */
static double shift_of(const struct spin_ply *ply, const struct spin_ply_property *p)
{
    return p->name[0] >= 'x' && p->name[0] <= 'z' && !p->name[1] ? ply->shift[p->name[0] - 'x'] : 0;
}

/* Read records first .. first + n - 1 of a column, in an element whose records have equal size. */
static void read_packed(const struct spin_ply *ply, const struct spin_ply_element *e,
                        const struct spin_ply_target *t, uint64_t first, uint64_t n)
{
    const struct spin_ply_property *p = &e->property[t->property];
    const unsigned char *at = ply->map.data + e->data_offset + first * e->stride + p->offset;
    float *out = t->out + first * t->step;
    double shift = shift_of(ply, p);

    if (p->type == SPIN_PLY_F32 && !ply->big_endian && shift == 0) {
        for (uint64_t i = 0; i < n; i++)
            out[i * t->step] = bits_to_float((uint32_t)load_bytes(at + i * e->stride, 4, false));
        return;
    }
    for (uint64_t i = 0; i < n; i++)
        out[i * t->step] =
            (float)(load_value(at + i * e->stride, p->type, ply->big_endian) - shift);
}

static void read_parsed(const struct spin_ply *ply, const struct spin_ply_element *e,
                        const struct spin_ply_target *t)
{
    const double *value = ply->ascii_values, shift = shift_of(ply, &e->property[t->property]);

    for (const struct spin_ply_element *before = ply->element; before != e; before++)
        value += before->count * before->n_properties;
    for (uint64_t i = 0; i < e->count; i++)
        t->out[i * t->step] = (float)(value[i * e->n_properties + (size_t)t->property] - shift);
}

/* Read a column of an element that also has lists, by walking through all properties of every
 * record. */
static void read_walking(const struct spin_ply *ply, const struct spin_ply_element *e,
                         const struct spin_ply_target *t)
{
    uint64_t at = e->data_offset, size = 0;
    double shift = shift_of(ply, &e->property[t->property]);

    for (uint64_t i = 0; i < e->count; i++) {
        for (size_t p = 0; p < e->n_properties; p++, at += size) {
            const unsigned char *here = ply->map.data + at;

            if ((int)p == t->property)
                t->out[i * t->step] =
                    (float)(load_value(here, e->property[p].type, ply->big_endian) - shift);
            if (!property_bytes(ply, &e->property[p], here, ply->map.size - at, &size))
                return; /* the file has changed since it was opened */
        }
    }
}

void spin_ply_columns(const struct spin_ply *ply, const struct spin_ply_element *e,
                      const struct spin_ply_target *target, size_t n_targets)
{
    for (size_t i = 0; i < n_targets; i++) {
        assert(target[i].property >= 0 && (size_t)target[i].property < e->n_properties);
        assert(!e->property[target[i].property].is_list);
        if (ply->ascii)
            read_parsed(ply, e, &target[i]);
        else if (e->has_list)
            read_walking(ply, e, &target[i]);
    }
    if (ply->ascii || e->has_list)
        return;
    for (uint64_t first = 0; first < e->count; first += BLOCK) {
        uint64_t n = e->count - first < BLOCK ? e->count - first : BLOCK;

        for (size_t i = 0; i < n_targets; i++)
            read_packed(ply, e, &target[i], first, n);
    }
}

void spin_ply_column(const struct spin_ply *ply, const struct spin_ply_element *e, int property,
                     float *out, size_t step)
{
    struct spin_ply_target target = {property, out, step};

    spin_ply_columns(ply, e, &target, 1);
}
