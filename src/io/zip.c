/* Reads zip and zip64 archives through the central directory.
 *
 * The file is not trusted. Every offset and size is compared with the bytes of the file before it
 * is used; members must not overlap each other or the directory (overlaps would let a small file
 * appear to contain petabytes). Deflate yields at most 1032 times its input, so larger sizes are
 * refused before memory is allocated. Sizes in local headers are ignored: they may be zero (data
 * descriptor) or saturated (numpy always requests zip64 headers). */
#include "io/zip.h"

#include <zlib.h>

#include "base/base.h"
#include "io/zip_format.h"

enum { ENCRYPTED = 1 << 0 }; /* bit in the flags of a member */
static const uint64_t deflate_ratio = 1032, deflate_slack = 4096;

static uint16_t u16(const unsigned char *p) { return (uint16_t)(p[0] | p[1] << 8); }
static uint32_t u32(const unsigned char *p) { return u16(p) | (uint32_t)u16(p + 2) << 16; }
static uint64_t u64(const unsigned char *p) { return u32(p) | (uint64_t)u32(p + 4) << 32; }

/* ---- Location of the directory -------------------------------------------------------------- */

struct directory {
    uint64_t offset, size, n; /* position and size of the directory in bytes; number of entries */
    uint64_t limit;           /* position of the first end record, which follows the directory */
    bool zip64;
};

bool spin_zip_detect(const unsigned char *head, size_t n_head)
{
    return n_head >= 4 && (u32(head) == SIG_LOCAL || u32(head) == SIG_END);
}

/* Find the end record: the last one whose comment extends to the end of the file. */
static bool find_end(const struct spin_map *map, uint64_t *at)
{
    uint64_t lowest;

    if (map->size < END_BYTES)
        return false;
    lowest = map->size > END_BYTES + 65535u ? map->size - END_BYTES - 65535u : 0;
    for (uint64_t i = map->size - END_BYTES + 1; i-- > lowest;) {
        const unsigned char *p = map->data + i;

        if (p[0] == 'P' && u32(p) == SIG_END && i + END_BYTES + u16(p + 20) == map->size) {
            *at = i;
            return true;
        }
    }
    return false;
}

static spin_status read_end64(const char *path, const struct spin_map *map, uint64_t end,
                              struct directory *dir)
{
    const unsigned char *locator = map->data + end - LOCATOR_BYTES;
    uint64_t at = u64(locator + 8);
    const unsigned char *p;

    if (at > end - LOCATOR_BYTES || end - LOCATOR_BYTES - at < END64_BYTES)
        return spin_malformed("cannot read '%s': its zip64 end record lies outside the file", path);
    p = map->data + at;
    if (u32(p) != SIG_END64)
        return spin_malformed("cannot read '%s': its zip64 end record is missing or damaged", path);
    if (u32(p + 16) != 0 || u32(p + 20) != 0 || u64(p + 24) != u64(p + 32))
        return spin_unsupported("cannot read '%s': the archive is split over several files", path);
    dir->n = u64(p + 32);
    dir->size = u64(p + 40);
    dir->offset = u64(p + 48);
    dir->limit = at;
    return SPIN_OK;
}

static spin_status find_directory(const char *path, const struct spin_map *map,
                                  struct directory *dir)
{
    uint64_t end;
    const unsigned char *p;

    if (map->size == 0)
        return spin_malformed("cannot read '%s': the file is empty", path);
    if (!find_end(map, &end))
        return spin_malformed("cannot read '%s': it has no zip directory at its end; it is cut "
                              "short or not a zip file",
                              path);
    p = map->data + end;
    if (end >= LOCATOR_BYTES && u32(p - LOCATOR_BYTES) == SIG_LOCATOR) {
        SPIN_TRY(read_end64(path, map, end, dir));
        dir->zip64 = true;
    } else {
        if (u16(p + 4) != 0 || u16(p + 6) != 0 || u16(p + 8) != u16(p + 10))
            return spin_unsupported("cannot read '%s': the archive is split over several files",
                                    path);
        dir->n = u16(p + 10);
        dir->size = u32(p + 12);
        dir->offset = u32(p + 16);
        dir->limit = end;
    }
    if (dir->offset > dir->limit || dir->size > dir->limit - dir->offset)
        return spin_malformed("cannot read '%s': its directory lies outside the file", path);
    if (dir->n > dir->size / CENTRAL_BYTES)
        return spin_malformed(
            "cannot read '%s': its directory of %llu bytes is too small for %llu members", path,
            (unsigned long long)dir->size, (unsigned long long)dir->n);
    return SPIN_OK;
}

/* ---- Entries of the directory --------------------------------------------------------------- */

static spin_status fail_member(spin_status code, const char *path, const char *name,
                               const char *what)
{
    return spin_fail(code, "cannot read '%s': member '%s' %s", path, name, what);
}

/* Replace the values that do not fit in 32 bits by those of the zip64 record, which contains only
 * such values, in the order of `field`. */
static bool read_zip64_extra(const unsigned char *extra, size_t n, struct spin_zip_member *m)
{
    uint64_t *field[3] = {&m->size, &m->packed_size, &m->header_offset};
    const unsigned char *p = NULL;
    size_t left = 0;

    if (m->size != FULL32 && m->packed_size != FULL32 && m->header_offset != FULL32)
        return true;
    while (n >= 4) {
        size_t bytes = u16(extra + 2);

        if (bytes > n - 4)
            break;
        if (u16(extra) == EXTRA_ZIP64) {
            p = extra + 4;
            left = bytes;
            break;
        }
        extra += 4 + bytes;
        n -= 4 + bytes;
    }
    for (int i = 0; i < 3; i++) {
        if (*field[i] != FULL32)
            continue;
        if (left < 8)
            return false;
        *field[i] = u64(p);
        p += 8;
        left -= 8;
    }
    return true;
}

/* Read the entry at p, of which `left` bytes remain in the directory. *taken receives the length of
 * the entry in bytes. The member's name and a NUL are copied to `name`, which must have the
 * capacity for them. */
static spin_status read_entry(const char *path, const struct directory *dir, const unsigned char *p,
                              uint64_t left, char *name, struct spin_zip_member *m, uint64_t *taken)
{
    size_t n_name, n_extra;
    uint64_t room;

    if (left < CENTRAL_BYTES || u32(p) != SIG_CENTRAL)
        return spin_malformed("cannot read '%s': its directory is damaged", path);
    n_name = u16(p + 28);
    n_extra = u16(p + 30);
    *taken = (uint64_t)CENTRAL_BYTES + n_name + n_extra + u16(p + 32);
    if (*taken > left)
        return spin_malformed("cannot read '%s': its directory is damaged", path);
    memcpy(name, p + CENTRAL_BYTES, n_name);
    name[n_name] = '\0';
    m->name = name;
    m->method = u16(p + 10);
    m->crc = u32(p + 16);
    m->packed_size = u32(p + 20);
    m->size = u32(p + 24);
    m->header_offset = u32(p + 42);

    if (n_name == 0 || memchr(name, '\0', n_name))
        return fail_member(SPIN_E_MALFORMED, path, name,
                           "has a bad name (empty or with a zero byte)");
    if (u16(p + 8) & ENCRYPTED)
        return fail_member(SPIN_E_UNSUPPORTED, path, name, "is encrypted");
    if (!read_zip64_extra(p + CENTRAL_BYTES + n_name, n_extra, m))
        return fail_member(SPIN_E_MALFORMED, path, name, "lacks its zip64 sizes");
    if (m->method == METHOD_STORED && m->size != m->packed_size)
        return fail_member(SPIN_E_MALFORMED, path, name,
                           "is stored, but its compressed and uncompressed sizes differ");

    /* Header, name and data of each member must end before the directory. */
    if (m->header_offset > dir->offset || dir->offset - m->header_offset < LOCAL_BYTES + n_name)
        return fail_member(SPIN_E_MALFORMED, path, name, "lies outside the file");
    room = dir->offset - m->header_offset - LOCAL_BYTES - n_name;
    if (m->packed_size > room)
        return spin_malformed(
            "cannot read '%s': member '%s' should have %llu bytes, but only %llu follow", path,
            name, (unsigned long long)m->packed_size, (unsigned long long)room);
    return SPIN_OK;
}

static int by_offset(const void *a, const void *b)
{
    const struct spin_zip_member *x = *(const struct spin_zip_member *const *)a;
    const struct spin_zip_member *y = *(const struct spin_zip_member *const *)b;

    return x->header_offset < y->header_offset ? -1 : x->header_offset > y->header_offset;
}

/* Order by name, and members with equal names by position in the directory. */
static int by_name(const void *a, const void *b)
{
    const struct spin_zip_member *x = *(const struct spin_zip_member *const *)a;
    const struct spin_zip_member *y = *(const struct spin_zip_member *const *)b;
    int order = strcmp(x->name, y->name);

    return order ? order : x < y ? -1 : x > y;
}

/* Check that members do not overlap. */
static spin_status check_overlap(const char *path, const struct spin_zip *zip,
                                 const struct spin_zip_member **order)
{
    qsort(order, zip->n, sizeof *order, by_offset);
    for (size_t i = 1; i < zip->n; i++) {
        const struct spin_zip_member *m = order[i - 1];
        uint64_t end = m->header_offset + LOCAL_BYTES + strlen(m->name) + m->packed_size;

        if (end > order[i]->header_offset)
            return spin_malformed("cannot read '%s': members '%s' and '%s' overlap", path, m->name,
                                  order[i]->name);
    }
    return SPIN_OK;
}

static spin_status read_directory(const char *path, const struct directory *dir,
                                  struct spin_zip *out)
{
    const unsigned char *p = out->map.data + dir->offset;
    uint64_t left = dir->size, taken = 0;
    char *name;

    SPIN_TRY(spin_alloc((size_t)dir->n, sizeof *out->member, (void **)&out->member));
    /* Each name is shorter than its entry in the directory, so that the NULs after the names fit
     * too. */
    SPIN_TRY(spin_alloc((size_t)dir->size + 1, 1, (void **)&out->names));
    name = out->names;
    for (uint64_t i = 0; i < dir->n; i++) {
        SPIN_TRY(read_entry(path, dir, p, left, name, &out->member[i], &taken));
        name += strlen(name) + 1;
        p += taken;
        left -= taken;
        out->n++;
    }
    if (left > 0)
        return spin_malformed("cannot read '%s': %llu bytes of its directory are unused", path,
                              (unsigned long long)left);
    SPIN_TRY(spin_alloc(out->n, sizeof *out->by_name, (void **)&out->by_name));
    for (size_t i = 0; i < out->n; i++)
        out->by_name[i] = &out->member[i];
    SPIN_TRY(check_overlap(path, out, out->by_name));
    qsort(out->by_name, out->n, sizeof *out->by_name, by_name);
    return SPIN_OK;
}

static spin_status read_archive(const char *path, struct spin_zip *out)
{
    struct directory dir = {0};
    spin_status status;

    SPIN_TRY_OUT(spin_strdup(path, &out->path));
    SPIN_TRY_OUT(find_directory(path, &out->map, &dir));
    out->zip64 = dir.zip64;
    SPIN_TRY_OUT(read_directory(path, &dir, out));
    return SPIN_OK;
out:
    spin_zip_close(out);
    return status;
}

spin_status spin_zip_open(const char *path, struct spin_zip *out)
{
    memset(out, 0, sizeof *out);
    SPIN_TRY(spin_map_open(path, &out->map));
    return read_archive(path, out);
}

spin_status spin_zip_parse(const char *what, const void *data, size_t size, struct spin_zip *out)
{
    *out = (struct spin_zip){.map = {data, size}, .borrowed = true};
    return read_archive(what, out);
}

void spin_zip_close(struct spin_zip *zip)
{
    if (!zip->borrowed)
        spin_map_close(&zip->map);
    free(zip->path);
    free(zip->member);
    free(zip->names);
    free((void *)zip->by_name);
    memset(zip, 0, sizeof *zip);
}

/* Returns the result of strcmp() for `name` and the concatenation of the parts. */
static int compare_parts(const char *name, const char *const *part)
{
    for (; *part; part++) {
        size_t n = strlen(*part);
        int order = strncmp(name, *part, n);

        if (order)
            return order;
        name += n;
    }
    return *name != '\0';
}

const struct spin_zip_member *spin_zip_find_parts(const struct spin_zip *zip,
                                                  const char *const *part)
{
    /* Binary search for the first member after those with this name. */
    size_t low = 0, high = zip->n;

    while (low < high) {
        size_t middle = low + (high - low) / 2;

        if (compare_parts(zip->by_name[middle]->name, part) <= 0)
            low = middle + 1;
        else
            high = middle;
    }
    return low > 0 && compare_parts(zip->by_name[low - 1]->name, part) == 0 ? zip->by_name[low - 1]
                                                                            : NULL;
}

const struct spin_zip_member *spin_zip_find(const struct spin_zip *zip, const char *name)
{
    const char *const part[] = {name, NULL};

    return spin_zip_find_parts(zip, part);
}

/* ---- Data of members ------------------------------------------------------------------------ */

/* Locate a member's compressed bytes. The local header is used only to find the position of these
 * bytes; the name in it must equal the name in the directory. */
static spin_status find_data(const struct spin_zip *zip, const struct spin_zip_member *m,
                             const unsigned char **data)
{
    const unsigned char *p = zip->map.data + m->header_offset;
    uint64_t left = zip->map.size - m->header_offset;
    size_t n_name = strlen(m->name);
    uint64_t head;

    if (left < LOCAL_BYTES || u32(p) != SIG_LOCAL)
        return fail_member(SPIN_E_MALFORMED, zip->path, m->name,
                           "has no header at the offset that the directory states");
    head = (uint64_t)LOCAL_BYTES + u16(p + 26) + u16(p + 28);
    if (head > left || m->packed_size > left - head)
        return fail_member(SPIN_E_MALFORMED, zip->path, m->name, "is cut short");
    if (u16(p + 26) != n_name || memcmp(p + LOCAL_BYTES, m->name, n_name) != 0)
        return fail_member(SPIN_E_MALFORMED, zip->path, m->name,
                           "has a different name in its own header");
    *data = p + head;
    return SPIN_OK;
}

static spin_status fail_memory(const struct spin_zip *zip, const struct spin_zip_member *m)
{
    return spin_fail(SPIN_E_MEMORY,
                     "cannot read '%s': not enough memory for the %llu bytes of member '%s'",
                     zip->path, (unsigned long long)m->size, m->name);
}

/* Decompress a member; the output must have exactly the size that the directory states. Input and
 * output are passed to zlib in parts, since zlib counts bytes with unsigned int. */
static spin_status inflate_exactly(const struct spin_zip *zip, const struct spin_zip_member *m,
                                   const unsigned char *packed, unsigned char *out)
{
    uint64_t n = m->packed_size, size = m->size;
    const uint64_t piece = 1u << 30;
    unsigned char beyond; /* receives a byte beyond the stated size, which is an error */
    z_stream z = {0};
    int result = Z_OK;

    if (inflateInit2(&z, -MAX_WBITS) != Z_OK)
        return fail_memory(zip, m);
    while (result == Z_OK) {
        uInt in = (uInt)(n < piece ? n : piece);
        uInt room = (uInt)(size < piece ? size : piece);

        z.next_in = (Bytef *)(uintptr_t)packed;
        z.avail_in = in;
        z.next_out = room > 0 ? out : &beyond;
        z.avail_out = room > 0 ? room : 1;
        result = inflate(&z, Z_NO_FLUSH);
        packed += in - z.avail_in;
        n -= in - z.avail_in;
        if (room > 0) {
            out += room - z.avail_out;
            size -= room - z.avail_out;
        } else if (z.avail_out == 0) {
            result = Z_DATA_ERROR;
        }
    }
    inflateEnd(&z);
    if (result == Z_MEM_ERROR)
        return fail_memory(zip, m);
    return result == Z_STREAM_END && n == 0 && size == 0
               ? SPIN_OK
               : fail_member(SPIN_E_MALFORMED, zip->path, m->name,
                             "is damaged (it cannot be decompressed)");
}

/* Decompress the first n bytes of a member; *n_out receives the number of bytes, which is smaller
 * if the member is shorter. */
static spin_status inflate_head(const struct spin_zip *zip, const struct spin_zip_member *m,
                                const unsigned char *packed, void *out, size_t n, size_t *n_out)
{
    const uint64_t piece = 1u << 30;
    uint64_t n_packed = m->packed_size;
    z_stream z = {0};
    int result;

    if (inflateInit2(&z, -MAX_WBITS) != Z_OK)
        return fail_memory(zip, m);
    z.next_in = (Bytef *)(uintptr_t)packed;
    z.avail_in = (uInt)(n_packed < piece ? n_packed : piece);
    z.next_out = out;
    z.avail_out = (uInt)(n < piece ? n : piece);
    /* Errors in the data are reported when the whole member is read. */
    result = inflate(&z, Z_SYNC_FLUSH);
    *n_out = (size_t)z.total_out;
    inflateEnd(&z);
    return result == Z_MEM_ERROR ? fail_memory(zip, m) : SPIN_OK;
}

static spin_status read_deflated(const struct spin_zip *zip, const struct spin_zip_member *m,
                                 const unsigned char *packed, uint64_t limit, void **owned)
{
    spin_status status;

    if (m->size > SIZE_MAX ||
        (m->size > deflate_slack && (m->size - deflate_slack) / deflate_ratio > m->packed_size))
        return spin_malformed("cannot read '%s': %llu compressed bytes of member '%s' cannot "
                              "expand to %llu bytes",
                              zip->path, (unsigned long long)m->packed_size, m->name,
                              (unsigned long long)m->size);
    if (m->size > limit)
        return spin_unsupported(
            "cannot read '%s': member '%s' unpacks to %llu bytes, more than the %llu allowed",
            zip->path, m->name, (unsigned long long)m->size, (unsigned long long)limit);
    *owned = malloc(m->size ? (size_t)m->size : 1);
    if (!*owned)
        return fail_memory(zip, m);
    status = inflate_exactly(zip, m, packed, *owned);
    if (status != SPIN_OK) {
        free(*owned);
        *owned = NULL;
    }
    return status;
}

static spin_status fail_method(const struct spin_zip *zip, const struct spin_zip_member *member)
{
    return spin_unsupported(
        "cannot read '%s': member '%s' is compressed with the unsupported method %d", zip->path,
        member->name, member->method);
}

spin_status spin_zip_head(const struct spin_zip *zip, const struct spin_zip_member *member,
                          void *out, size_t n, size_t *n_out)
{
    const unsigned char *packed = NULL;

    *n_out = 0;
    SPIN_TRY(find_data(zip, member, &packed));
    if (member->method == METHOD_STORED) {
        *n_out = member->size < n ? (size_t)member->size : n;
        memcpy(out, packed, *n_out);
    } else if (member->method == METHOD_DEFLATE) {
        return inflate_head(zip, member, packed, out, n, n_out);
    } else {
        return fail_method(zip, member);
    }
    return SPIN_OK;
}

spin_status spin_zip_read(const struct spin_zip *zip, const struct spin_zip_member *member,
                          bool check_crc, uint64_t limit, const unsigned char **data, void **owned)
{
    const unsigned char *packed = NULL;

    *data = NULL;
    *owned = NULL;
    SPIN_TRY(find_data(zip, member, &packed));
    if (member->method == METHOD_STORED) {
        *data = packed;
    } else if (member->method == METHOD_DEFLATE) {
        SPIN_TRY(read_deflated(zip, member, packed, limit, owned));
        *data = *owned;
    } else {
        return fail_method(zip, member);
    }
    if (check_crc && spin_crc32(0, *data, (size_t)member->size) != member->crc) {
        free(*owned);
        *owned = NULL;
        *data = NULL;
        return fail_member(SPIN_E_MALFORMED, zip->path, member->name,
                           "is damaged (its CRC differs)");
    }
    return SPIN_OK;
}
