/* .npy arrays (format versions 1 to 3) and .npz archives of them.
 *
 * The header of an .npy file is the text of a Python dictionary with exactly three keys. The parser
 * accepts nothing else. It refuses all dtypes except plain numbers, so that the pickle in an object
 * array is never read. */
#include "io/npy.h"

#include "base/base.h"
#include "io/zip_format.h"

/* The most bytes before the data: magic, version and length (12 bytes) and the dictionary, which
 * numpy also limits to 10000 bytes. */
#define MAX_HEAD (12 + 10000)
/* Bytes of an archived array that are decompressed at first: NumPy and spin4d write headers of 128
 * bytes. Clips have several arrays for each frame. */
#define USUAL_HEAD 128

/* ---- The header's dictionary --------------------------------------------------------------- */

struct text {
    const char *what; /* name of the array, for messages */
    const unsigned char *p, *end;
};

struct header {
    bool has_descr, has_fortran, has_shape, fortran;
};

static spin_status fail_header(const struct text *t)
{
    return spin_malformed("array '%s' has a damaged header", t->what);
}

static void skip_space(struct text *t)
{
    while (t->p < t->end && (*t->p == ' ' || *t->p == '\t' || *t->p == '\n' || *t->p == '\r'))
        t->p++;
}

/* Consume white space, then the character c. Returns false if the next character is not c. */
static bool consume_char(struct text *t, char c)
{
    skip_space(t);
    if (t->p >= t->end || *t->p != (unsigned char)c)
        return false;
    t->p++;
    return true;
}

static bool consume_word(struct text *t, const char *word)
{
    size_t n = strlen(word);

    skip_space(t);
    if ((size_t)(t->end - t->p) < n || memcmp(t->p, word, n) != 0)
        return false;
    t->p += n;
    return true;
}

/* Consume a string in single or double quotes, without escapes. */
static bool consume_string(struct text *t, char *out, size_t n_out)
{
    unsigned char quote;
    size_t n = 0;

    skip_space(t);
    if (t->p >= t->end || (*t->p != '\'' && *t->p != '"'))
        return false;
    quote = *t->p++;
    while (t->p < t->end && *t->p != quote) {
        if (*t->p == '\\' || *t->p < 0x20 || n + 1 >= n_out)
            return false;
        out[n++] = (char)*t->p++;
    }
    if (t->p >= t->end)
        return false;
    t->p++;
    out[n] = '\0';
    return true;
}

static bool consume_number(struct text *t, uint64_t *out)
{
    uint64_t value = 0;
    const unsigned char *first;

    skip_space(t);
    first = t->p;
    for (; t->p < t->end && *t->p >= '0' && *t->p <= '9'; t->p++)
        if (__builtin_mul_overflow(value, 10, &value) ||
            __builtin_add_overflow(value, (uint64_t)(*t->p - '0'), &value))
            return false;
    if (t->p == first)
        return false;
    if (t->p < t->end && *t->p == 'L') /* Python 2 wrote large numbers with an L at the end */
        t->p++;
    *out = value;
    return true;
}

/* Parse a dtype such as "<f4", which consists of byte order, kind and size in bytes. */
static spin_status read_dtype(const struct text *t, const char *descr, struct spin_array *out)
{
    char order = descr[0];

    if (strlen(descr) == 3 && strchr("<>|=", order) && (order != '|' || descr[2] == '1') &&
        spin_array_set_type(out, descr + 1)) {
        out->big_endian = order == '>' && out->item_size > 1;
        return SPIN_OK;
    }
    return spin_unsupported("array '%s' has dtype '%s', expected a plain number type such as '<f4'",
                            t->what, descr);
}

static spin_status read_descr(struct text *t, struct spin_array *out)
{
    char descr[64];

    skip_space(t);
    if (t->p < t->end && (*t->p == '[' || *t->p == '(')) {
        size_t n = (size_t)(t->end - t->p);

        return spin_unsupported("array '%s' has a structured dtype: %.*s", t->what,
                                (int)(n < 60 ? n : 60), (const char *)t->p);
    }
    if (!consume_string(t, descr, sizeof descr))
        return fail_header(t);
    return read_dtype(t, descr, out);
}

/* Parse a shape such as "()", "(5,)", "(6, 1032, 3)" or "(6, 1032, 3,)". */
static spin_status read_shape(struct text *t, struct spin_array *out)
{
    bool comma = true;

    out->n_dims = 0;
    if (!consume_char(t, '('))
        return fail_header(t);
    while (!consume_char(t, ')')) {
        if (!comma)
            return fail_header(t);
        if (out->n_dims == SPIN_NPY_MAX_DIMS)
            return spin_unsupported("array '%s' has more than %d dimensions", t->what,
                                    SPIN_NPY_MAX_DIMS);
        if (!consume_number(t, &out->shape[out->n_dims]))
            return spin_malformed("array '%s' has a shape that is not a tuple of integers",
                                  t->what);
        out->n_dims++;
        comma = consume_char(t, ',');
    }
    if (out->n_dims == 1 && !comma) /* for Python, "(5)" is a number, not a tuple */
        return fail_header(t);
    return SPIN_OK;
}

static spin_status read_item(struct text *t, struct header *seen, struct spin_array *out)
{
    char key[32];
    bool *have;

    if (!consume_string(t, key, sizeof key) || !consume_char(t, ':'))
        return fail_header(t);
    have = strcmp(key, "descr") == 0           ? &seen->has_descr
           : strcmp(key, "fortran_order") == 0 ? &seen->has_fortran
           : strcmp(key, "shape") == 0         ? &seen->has_shape
                                               : NULL;
    if (!have || *have)
        return fail_header(t);
    *have = true;
    if (have == &seen->has_descr)
        return read_descr(t, out);
    if (have == &seen->has_shape)
        return read_shape(t, out);
    seen->fortran = consume_word(t, "True");
    return seen->fortran || consume_word(t, "False") ? SPIN_OK : fail_header(t);
}

static spin_status read_dictionary(struct text *t, struct spin_array *out)
{
    struct header seen = {0};
    bool comma = true;

    if (!consume_char(t, '{'))
        return fail_header(t);
    while (!consume_char(t, '}')) {
        if (!comma)
            return fail_header(t);
        SPIN_TRY(read_item(t, &seen, out));
        comma = consume_char(t, ',');
    }
    skip_space(t);
    if (t->p != t->end || !seen.has_descr || !seen.has_fortran || !seen.has_shape)
        return fail_header(t);
    spin_array_set_strides(out, seen.fortran);
    return SPIN_OK;
}

/* ---- One array ----------------------------------------------------------------------------- */

/* Check that at least as many bytes are present as the shape and item size require, and set the
 * count and size of the array. */
static spin_status check_size(const char *what, struct spin_array *a, size_t n_present)
{
    uint64_t bytes = 0;
    char shape[128];
    bool overflow = false;

    a->count = 1;
    for (int i = 0; i < a->n_dims; i++)
        if (a->shape[i] == 0)
            a->count = 0;
    for (int i = 0; i < a->n_dims && a->count > 0; i++)
        overflow = overflow || __builtin_mul_overflow(a->count, a->shape[i], &a->count);
    overflow = overflow || __builtin_mul_overflow(a->count, (uint64_t)a->item_size, &bytes);
    if (overflow || bytes > n_present) {
        spin_array_shape_text(a->n_dims, a->shape, shape, sizeof shape);
        return spin_malformed(
            "array '%s' is cut short: shape %s of %d-byte items, but only %zu bytes are present",
            what, shape, a->item_size, n_present);
    }
    a->n_bytes = (size_t)bytes;
    return SPIN_OK;
}

/* spin_npy_parse() for an array of n_bytes bytes of which only the first n_readable are
 * available. */
static spin_status parse_head(const char *what, const unsigned char *bytes, size_t n_readable,
                              size_t n_bytes, struct spin_array *out)
{
    struct text t = {.what = what};
    size_t prefix, n_header;

    memset(out, 0, sizeof *out);
    if (n_readable < 10 || memcmp(bytes, "\x93NUMPY", 6) != 0)
        return spin_malformed("array '%s' does not begin with the .npy magic", what);
    if (bytes[6] < 1 || bytes[6] > 3)
        return spin_unsupported("array '%s' has .npy version %d; supported are 1 to 3", what,
                                bytes[6]);
    prefix = bytes[6] == 1 ? 10 : 12;
    if (n_readable < prefix)
        return fail_header(&t);
    n_header = bytes[8] | (size_t)bytes[9] << 8;
    if (prefix == 12)
        n_header |= (size_t)bytes[10] << 16 | (size_t)bytes[11] << 24;
    if (n_header > n_readable - prefix)
        return spin_malformed(
            "array '%s' is cut short: its header has %zu bytes, but only %zu bytes were read", what,
            n_header, n_readable);
    t.p = bytes + prefix;
    t.end = t.p + n_header;
    SPIN_TRY(read_dictionary(&t, out));
    out->data = bytes + prefix + n_header;
    return check_size(what, out, n_bytes - prefix - n_header);
}

spin_status spin_npy_parse(const char *what, const unsigned char *bytes, size_t n_bytes,
                           struct spin_array *out)
{
    return parse_head(what, bytes, n_bytes, n_bytes, out);
}

void spin_npz_forget(const struct spin_npz *npz, const struct spin_array *a, uint64_t first,
                     uint64_t count)
{
    size_t item = (size_t)a->item_size;

    if (spin_array_is_contiguous(a))
        spin_map_forget(&npz->zip.map, a->data + first * item, (size_t)count * item);
}

/* ---- Archives ------------------------------------------------------------------------------ */

spin_status spin_npz_open(const char *path, struct spin_npz *out)
{
    memset(out, 0, sizeof *out);
    return spin_zip_open(path, &out->zip);
}

void spin_npz_close(struct spin_npz *npz)
{
    for (size_t i = 0; i < npz->n_owned; i++)
        free(npz->owned[i]);
    free(npz->owned);
    spin_zip_close(&npz->zip);
    memset(npz, 0, sizeof *npz);
}

static const struct spin_zip_member *find_array(const struct spin_npz *npz, const char *key)
{
    size_t n_prefix = npz->prefix ? strlen(npz->prefix) : 0;
    const char *there = "";

    if (n_prefix > 0 && strncmp(key, npz->prefix, n_prefix) == 0) {
        there = npz->prefix_there;
        key += n_prefix;
    }
    return spin_zip_find_parts(&npz->zip, (const char *const[]){there, key, ".npy", NULL});
}

bool spin_npz_has(const struct spin_npz *npz, const char *key)
{
    return find_array(npz, key) != NULL;
}

/* Keep a decompressed member until spin_npz_close(). */
static spin_status keep_block(struct spin_npz *npz, void *block)
{
    void *list = npz->owned;
    spin_status status;

    if (!block)
        return SPIN_OK;
    status = spin_grow(npz->n_owned + 1, sizeof *npz->owned, &list);
    if (status != SPIN_OK) {
        free(block);
        return status;
    }
    npz->owned = list;
    npz->owned[npz->n_owned++] = block;
    return SPIN_OK;
}

/* Read the header of an array and compare the size that it requires with the size of the member in
 * the archive, before the data are decompressed. out->data is NULL. */
static spin_status read_head(const struct spin_npz *npz, const char *key,
                             const struct spin_zip_member *member, struct spin_array *out)
{
    unsigned char head[MAX_HEAD];
    size_t n = 0, n_head;

    SPIN_TRY(spin_zip_head(&npz->zip, member, head, USUAL_HEAD, &n));
    if (n == USUAL_HEAD && (head[6] != 1 || 10 + (head[8] | head[9] << 8) > USUAL_HEAD))
        SPIN_TRY(spin_zip_head(&npz->zip, member, head, sizeof head, &n));
    SPIN_TRY(parse_head(key, head, n < member->size ? n : (size_t)member->size,
                        (size_t)member->size, out));
    n_head = (size_t)(out->data - head);
    out->data = NULL;
    if (n_head + out->n_bytes != member->size)
        return spin_malformed("array '%s' has %zu bytes more than its header states", key,
                              (size_t)member->size - n_head - out->n_bytes);
    return SPIN_OK;
}

/* Find the member for a key; SPIN_E_NOT_FOUND if there is none. */
static spin_status find_member(const struct spin_npz *npz, const char *key,
                               const struct spin_zip_member **out)
{
    *out = find_array(npz, key);
    return *out ? SPIN_OK : spin_not_found("no array '%s'", key);
}

spin_status spin_npz_head(const struct spin_npz *npz, const char *key, struct spin_array *out)
{
    const struct spin_zip_member *member;

    memset(out, 0, sizeof *out);
    SPIN_TRY(find_member(npz, key, &member));
    return read_head(npz, key, member, out);
}

uint64_t spin_npz_unpacked(const struct spin_npz *npz, const char *key)
{
    const struct spin_zip_member *member = find_array(npz, key);

    return member && member->method != METHOD_STORED ? member->size : 0;
}

spin_status spin_npz_take(const struct spin_npz *npz, const char *key, bool check_crc,
                          struct spin_array *out, void **owned)
{
    const struct spin_zip_member *member;
    const unsigned char *bytes = NULL;
    uint64_t limit;

    *owned = NULL;
    SPIN_TRY(find_member(npz, key, &member));
    /* Limit the array to half of the available memory, since the conversion of the array needs
     * memory too. For stored members, which need no limit, skip the query of the available memory,
     * which takes a dozen system calls. */
    limit = member->method == METHOD_STORED ? 0 : spin_memory_available() / 2;
    SPIN_TRY(spin_zip_read(&npz->zip, member, check_crc, limit, &bytes, owned));
    return spin_npy_parse(key, bytes, (size_t)member->size, out);
}

/* spin_npz_take(), but the archive keeps the decompressed block until spin_npz_close(). */
static spin_status read_data(struct spin_npz *npz, const char *key, bool check_crc,
                             struct spin_array *out)
{
    void *owned = NULL;
    spin_status status = spin_npz_take(npz, key, check_crc, out, &owned);

    SPIN_TRY(keep_block(npz, owned));
    return status;
}

spin_status spin_npz_array(struct spin_npz *npz, const char *key, bool check_crc,
                           struct spin_array *out)
{
    SPIN_TRY(spin_npz_head(npz, key, out));
    return read_data(npz, key, check_crc, out);
}

spin_status spin_array_check_shape(const char *key, const struct spin_array *a, int n_dims,
                                   const int64_t *shape)
{
    char got[192], want[192];

    if (spin_array_has_shape(a, n_dims, shape))
        return SPIN_OK;
    spin_array_shape_text(a->n_dims, a->shape, got, sizeof got);
    spin_array_shape_text(n_dims, (const uint64_t *)shape, want, sizeof want);
    return spin_malformed("array '%s' has shape %s, expected %s", key, got, want);
}

spin_status spin_npz_array_of(struct spin_npz *npz, const char *key, bool check_crc, int n_dims,
                              const int64_t *shape, struct spin_array *out)
{
    SPIN_TRY(spin_npz_head(npz, key, out));
    SPIN_TRY(spin_array_check_shape(key, out, n_dims, shape));
    return read_data(npz, key, check_crc, out);
}

/* ---- Writing ------------------------------------------------------------------------------- */

/* Format the header of an .npy file as numpy writes it, padded with spaces so that the data are
 * 64-byte aligned. */
static spin_status header_bytes(const char *name, const char *descr, int n_dims,
                                const uint64_t *shape, unsigned char head[256], size_t *n_head)
{
    char text[246];
    int n =
        snprintf(text, sizeof text, "{'descr': '%s', 'fortran_order': False, 'shape': (", descr);
    size_t total;

    for (int i = 0; i < n_dims && n < (int)sizeof text; i++)
        n += snprintf(text + n, sizeof text - (size_t)n,
                      n_dims == 1 ? "%llu,"
                      : i         ? ", %llu"
                                  : "%llu",
                      (unsigned long long)shape[i]);
    if (n < (int)sizeof text)
        n += snprintf(text + n, sizeof text - (size_t)n, "), }");
    total = (10 + (size_t)n + 1 + 63) / 64 * 64;
    if (n >= (int)sizeof text || total > 256)
        return spin_misuse("cannot write array '%s': its header is too long", name);
    memset(head, ' ', total);
    memcpy(head, "\x93NUMPY\x01\x00", 8);
    head[8] = (unsigned char)(total - 10);
    head[9] = (unsigned char)((total - 10) >> 8);
    memcpy(head + 10, text, (size_t)n);
    head[total - 1] = '\n';
    *n_head = total;
    return SPIN_OK;
}

/* Format the name and .npy header of a member, and compute the size in bytes of the data that
 * follow the header. */
static spin_status describe_member(const char *name, const char *descr, int n_dims,
                                   const uint64_t *shape, unsigned char head[256], size_t *n_head,
                                   size_t *n_bytes, char **member)
{
    struct text t = {.what = name};
    struct spin_array a = {0};
    size_t n_member = strlen(name) + 5;

    if (n_dims < 0 || n_dims > SPIN_NPY_MAX_DIMS)
        return spin_misuse(
            "cannot write array '%s': it has %d dimensions, but 0 to %d are supported", name,
            n_dims, SPIN_NPY_MAX_DIMS);
    SPIN_TRY(read_dtype(&t, descr, &a));
    a.n_dims = n_dims;
    for (int i = 0; i < n_dims; i++)
        a.shape[i] = shape[i];
    SPIN_TRY(check_size(name, &a, SIZE_MAX - 256));
    SPIN_TRY(header_bytes(name, descr, n_dims, shape, head, n_head));
    SPIN_TRY(spin_alloc(n_member, 1, (void **)member));
    snprintf(*member, n_member, "%s.npy", name);
    *n_bytes = a.n_bytes;
    return SPIN_OK;
}

typedef spin_status begin_fn(struct spin_zip_writer *w, const char *name, uint64_t size);

static spin_status write_begin(struct spin_zip_writer *w, const char *name, const char *descr,
                               int n_dims, const uint64_t *shape, begin_fn *begin)
{
    unsigned char head[256];
    size_t n_head = 0, n_bytes = 0;
    SPIN_FREED char *member = NULL;

    SPIN_TRY(describe_member(name, descr, n_dims, shape, head, &n_head, &n_bytes, &member));
    SPIN_TRY(begin(w, member, n_head + n_bytes));
    return spin_zip_member_write(w, head, n_head);
}

spin_status spin_npz_write_begin(struct spin_zip_writer *w, const char *name, const char *descr,
                                 int n_dims, const uint64_t *shape)
{
    return write_begin(w, name, descr, n_dims, shape, spin_zip_member_begin);
}

spin_status spin_npz_write_begin_deflated(struct spin_zip_writer *w, const char *name,
                                          const char *descr, int n_dims, const uint64_t *shape)
{
    return write_begin(w, name, descr, n_dims, shape, spin_zip_member_begin_deflated);
}

spin_status spin_npz_write(struct spin_zip_writer *w, const char *name, const char *descr,
                           int n_dims, const uint64_t *shape, const void *data)
{
    unsigned char head[256];
    size_t n_head = 0, n_bytes = 0;
    SPIN_FREED char *member = NULL;

    SPIN_TRY(describe_member(name, descr, n_dims, shape, head, &n_head, &n_bytes, &member));
    return spin_zip_member_whole(w, member, head, n_head, data, n_bytes);
}
