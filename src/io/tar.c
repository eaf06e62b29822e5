#include "io/archive.h"

#include "base/base.h"

enum { LONGEST_NAME = 4096, LONGEST_HEADER = 1 << 20 };

/* Offsets and lengths of the fields of a header. */
enum {
    NAME = 0,
    N_NAME = 100,
    SIZE = 124,
    N_SIZE = 12,
    CHECKSUM = 148,
    N_CHECKSUM = 8,
    TYPE = 156,
    MAGIC = 257,
    PREFIX = 345,
    N_PREFIX = 155
};

/* The name and size that extension headers of pax and GNU give for the next member. */
struct extra {
    char *name;
    bool has_size;
    uint64_t size;
};

static void free_extra(struct extra *extra) { free(extra->name); }

bool spin_tar_looks_like(const unsigned char *head, size_t n)
{
    return n >= MAGIC + 5 && memcmp(head + MAGIC, "ustar", 5) == 0;
}

void spin_tar_close(struct spin_tar *tar)
{
    free(tar->name);
    tar->name = NULL;
}

/* ---- Headers --------------------------------------------------------------------------------- */

/* Parses an octal number or, if the first bit is set, a number in base 256. */
static bool parse_number(const unsigned char *field, int n, uint64_t *out)
{
    int i = 0;

    *out = 0;
    if (*field & 0x80) {
        *out = *field & 0x7f;
        for (i = 1; i < n; i++) {
            if (*out >> 55)
                return false;
            *out = *out << 8 | field[i];
        }
        return true;
    }
    while (i < n && field[i] == ' ')
        i++;
    for (; i < n && field[i] >= '0' && field[i] <= '7'; i++)
        *out = *out << 3 | (uint64_t)(field[i] - '0');
    return i == n || field[i] == ' ' || field[i] == '\0';
}

static bool has_checksum(const unsigned char *block)
{
    uint64_t want, sum = 0;

    for (int i = 0; i < SPIN_TAR_BLOCK; i++)
        sum += i >= CHECKSUM && i < CHECKSUM + N_CHECKSUM ? ' ' : block[i];
    return parse_number(block + CHECKSUM, N_CHECKSUM, &want) && want == sum;
}

static spin_status read_exactly(struct spin_tar *tar, void *out, size_t n)
{
    size_t got;

    SPIN_TRY(spin_stream_read(tar->stream, out, n, &got));
    return got == n ? SPIN_OK : spin_malformed("'%s' is cut short", tar->stream->path);
}

/* Reads the next header. *end is set at the end of the archive, a block of zeros. */
static spin_status read_header(struct spin_tar *tar, unsigned char *block, bool *end)
{
    static const unsigned char zeros[SPIN_TAR_BLOCK];

    SPIN_TRY(read_exactly(tar, block, SPIN_TAR_BLOCK));
    *end = memcmp(block, zeros, SPIN_TAR_BLOCK) == 0;
    if (!*end && (!has_checksum(block) || !spin_tar_looks_like(block, SPIN_TAR_BLOCK)))
        return spin_malformed("'%s' is not a tar archive, or it is damaged", tar->stream->path);
    return SPIN_OK;
}

/* Reads the contents of an extension header, and terminates them with a zero byte. */
static spin_status read_contents(struct spin_tar *tar, uint64_t size, char **out)
{
    size_t padded = ((size_t)size + SPIN_TAR_BLOCK - 1) / SPIN_TAR_BLOCK * SPIN_TAR_BLOCK;

    *out = NULL;
    if (size > LONGEST_HEADER)
        return spin_malformed("cannot unpack '%s': it has a damaged header of %llu bytes",
                              tar->stream->path, (unsigned long long)size);
    SPIN_TRY(spin_alloc(padded + 1, 1, (void **)out));
    SPIN_TRY(read_exactly(tar, *out, padded));
    (*out)[size] = '\0';
    return SPIN_OK;
}

/* ---- Extensions ------------------------------------------------------------------------------ */

/* Parses the pax record "LENGTH KEY=VALUE\n". `record` has n bytes, without LENGTH and the line
 * feed. */
static spin_status parse_record(const struct spin_tar *tar, char *record, size_t n,
                                struct extra *out)
{
    char *value = memchr(record, '=', n), *end;

    if (!value)
        return spin_malformed("cannot unpack '%s': it has a damaged pax header", tar->stream->path);
    *value++ = '\0';
    n -= (size_t)(value - record);
    value[n] = '\0';
    if (strncmp(record, "GNU.sparse.", 11) == 0)
        return spin_unsupported("cannot unpack '%s': it contains a sparse file; unpack it yourself",
                                tar->stream->path);
    if (strcmp(record, "path") == 0) {
        free(out->name);
        SPIN_TRY(spin_strdup(value, &out->name));
        return strlen(value) == n
                   ? SPIN_OK
                   : spin_malformed("cannot unpack '%s': a member name contains a zero byte",
                                    tar->stream->path);
    }
    if (strcmp(record, "size") == 0) {
        errno = 0;
        out->size = strtoull(value, &end, 10);
        out->has_size = *value >= '0' && *value <= '9' && *end == '\0' && errno == 0;
        if (!out->has_size)
            return spin_malformed("cannot unpack '%s': it has a damaged pax header",
                                  tar->stream->path);
    }
    return SPIN_OK;
}

static spin_status parse_pax(const struct spin_tar *tar, char *text, size_t n, struct extra *out)
{
    for (size_t at = 0; at < n;) {
        char *end;
        unsigned long length = strtoul(text + at, &end, 10);
        size_t head = (size_t)(end - (text + at)) + 1;

        if (*end != ' ' || length <= head || length > n - at || text[at + length - 1] != '\n')
            return spin_malformed("cannot unpack '%s': it has a damaged pax header",
                                  tar->stream->path);
        SPIN_TRY(parse_record(tar, text + at + head, length - head - 1, out));
        at += length;
    }
    return SPIN_OK;
}

/* Reads an extension header: type x is pax, L is GNU's long name. The types g (pax, for all
 * members) and K (GNU's long target of a link) are skipped. */
static spin_status read_extra(struct spin_tar *tar, char type, uint64_t size, struct extra *out)
{
    SPIN_FREED char *text = NULL;

    SPIN_TRY(read_contents(tar, size, &text));
    if (type == 'x')
        return parse_pax(tar, text, (size_t)size, out);
    if (type == 'L') {
        free(out->name);
        out->name = text;
        text = NULL;
    }
    return SPIN_OK;
}

/* ---- Members --------------------------------------------------------------------------------- */

static spin_status skip_member(struct spin_tar *tar)
{
    unsigned char block[SPIN_TAR_BLOCK];
    uint64_t padding = (SPIN_TAR_BLOCK - tar->size % SPIN_TAR_BLOCK) % SPIN_TAR_BLOCK;

    for (uint64_t left = tar->name ? tar->unread + padding : 0; left > 0;) {
        size_t n = left < sizeof block ? (size_t)left : sizeof block;

        SPIN_TRY(read_exactly(tar, block, n));
        left -= n;
    }
    return SPIN_OK;
}

/* Sets tar->name to the name in the extension header or, if that has none, in the header. */
static spin_status set_name(struct spin_tar *tar, const unsigned char *block, struct extra *extra)
{
    const char *prefix = (const char *)block + PREFIX, *name = (const char *)block + NAME;
    bool has_prefix = memcmp(block + MAGIC, "ustar", 6) == 0 && *prefix;
    char text[N_PREFIX + N_NAME + 2];

    if (!extra->name) {
        snprintf(text, sizeof text, "%.*s%s%.*s", has_prefix ? N_PREFIX : 0, prefix,
                 has_prefix ? "/" : "", N_NAME, name);
        SPIN_TRY(spin_strdup(text, &extra->name));
    }
    if (strlen(extra->name) > LONGEST_NAME)
        return spin_malformed(
            "cannot unpack '%s': a member name has %zu bytes, expected at most %d",
            tar->stream->path, strlen(extra->name), LONGEST_NAME);
    tar->name = extra->name;
    extra->name = NULL;
    return SPIN_OK;
}

static spin_status check_type(const struct spin_tar *tar, char type)
{
    const char *what = type == '1' || type == '2'                  ? "a link"
                       : type == '3' || type == '4' || type == '6' ? "a device"
                                                                   : "a file of an unknown kind";

    if (type == '0' || type == '\0' || type == '7' || type == '5')
        return SPIN_OK;
    return spin_unsupported(
        "cannot unpack '%s': member '%s' is %s; if you trust it, unpack it yourself",
        tar->stream->path, tar->name, what);
}

spin_status spin_tar_next(struct spin_tar *tar)
{
    unsigned char block[SPIN_TAR_BLOCK];
    SPIN_LEAVES(free_extra) struct extra extra = {0};
    bool end;
    char type;

    SPIN_TRY(skip_member(tar));
    spin_tar_close(tar);
    for (;;) {
        SPIN_TRY(read_header(tar, block, &end));
        if (end)
            return SPIN_OK;
        type = (char)block[TYPE];
        if (!parse_number(block + SIZE, N_SIZE, &tar->size))
            return spin_malformed("cannot unpack '%s': it has a damaged header", tar->stream->path);
        if (!type || !strchr("xgLK", type))
            break;
        SPIN_TRY(read_extra(tar, type, tar->size, &extra));
    }
    if (extra.has_size)
        tar->size = extra.size;
    SPIN_TRY(set_name(tar, block, &extra));
    SPIN_TRY(check_type(tar, type));
    tar->is_folder = type == '5' || spin_text_ends(tar->name, "/");
    tar->unread = tar->size;
    return SPIN_OK;
}

spin_status spin_tar_read(struct spin_tar *tar, void *out, size_t n)
{
    SPIN_TRY(read_exactly(tar, out, n));
    tar->unread -= n;
    return SPIN_OK;
}
