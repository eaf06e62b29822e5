/* Zip and zip64, after PKWARE's APPNOTE 6.3: reading by the central directory, writing stored
 * members.
 *
 * A reader that trusts nothing. Every offset and size is compared with the bytes of the file
 * before it is used; members may not overlap each other or the directory (which is how a small
 * file pretends to hold petabytes); deflate cannot yield more than 1032 times what went in, so a
 * larger claim is a lie that is seen before memory is reserved. Sizes in local headers are never
 * used: they may be zero (data descriptor) or saturated (numpy asks for zip64 headers always). */
#include "io/zip.h"

#include <limits.h>
#include <pthread.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#include <zlib.h>

#include "base/err.h"
#include "base/mem.h"
#include "io/crc.h"

enum {
    SIG_LOCAL = 0x04034b50,
    SIG_CENTRAL = 0x02014b50,
    SIG_END = 0x06054b50,
    SIG_END64 = 0x06064b50,
    SIG_LOCATOR = 0x07064b50,
    LOCAL_BYTES = 30,
    CENTRAL_BYTES = 46,
    END_BYTES = 22,
    END64_BYTES = 56,
    LOCATOR_BYTES = 20,
    EXTRA_ZIP64 = 0x0001,
    EXTRA_ALIGN = 0xd935, /* the record zipalign uses: u16 alignment, then padding */
    FLAG_ENCRYPTED = 1 << 0,
    FLAG_UTF8 = 1 << 11,
    METHOD_STORED = 0,
    METHOD_DEFLATE = 8,
    ALIGN = 64,
    DOS_DATE_1980 = 0x21
};
static const uint32_t full32 = 0xffffffffu;
static const uint64_t deflate_ratio = 1032, deflate_slack = 4096;

static uint16_t u16(const unsigned char *p) { return (uint16_t)(p[0] | p[1] << 8); }
static uint32_t u32(const unsigned char *p) { return u16(p) | (uint32_t)u16(p + 2) << 16; }
static uint64_t u64(const unsigned char *p) { return u32(p) | (uint64_t)u32(p + 4) << 32; }

/* ---- Reading: where the directory is ------------------------------------------------------- */

struct directory {
    uint64_t offset, size, n; /* bytes, bytes, entries */
    uint64_t limit;           /* the end records begin here */
};

bool spin_zip_looks_like(const unsigned char *head, size_t n_head)
{
    return n_head >= 4 && (u32(head) == SIG_LOCAL || u32(head) == SIG_END);
}

/* The end record: the last one whose comment ends with the file. */
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
        return spin_fail(SPIN_E_MALFORMED,
                         "cannot read '%s': its zip64 end record lies outside the file", path);
    p = map->data + at;
    if (u32(p) != SIG_END64)
        return spin_fail(SPIN_E_MALFORMED,
                         "cannot read '%s': no zip64 end record where it should be", path);
    if (u32(p + 16) != 0 || u32(p + 20) != 0 || u64(p + 24) != u64(p + 32))
        return spin_fail(SPIN_E_UNSUPPORTED,
                         "cannot read '%s': the archive is split over several files", path);
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
        return spin_fail(SPIN_E_MALFORMED, "cannot read '%s': the file is empty", path);
    if (!find_end(map, &end))
        return spin_fail(
            SPIN_E_MALFORMED,
            "cannot read '%s': no zip directory at its end (cut short or not a zip file)", path);
    p = map->data + end;
    if (end >= LOCATOR_BYTES && u32(p - LOCATOR_BYTES) == SIG_LOCATOR) {
        SPIN_TRY(read_end64(path, map, end, dir));
    } else {
        if (u16(p + 4) != 0 || u16(p + 6) != 0 || u16(p + 8) != u16(p + 10))
            return spin_fail(SPIN_E_UNSUPPORTED,
                             "cannot read '%s': the archive is split over several files", path);
        dir->n = u16(p + 10);
        dir->size = u32(p + 12);
        dir->offset = u32(p + 16);
        dir->limit = end;
    }
    if (dir->offset > dir->limit || dir->size > dir->limit - dir->offset)
        return spin_fail(SPIN_E_MALFORMED, "cannot read '%s': its directory lies outside the file",
                         path);
    if (dir->n > dir->size / CENTRAL_BYTES)
        return spin_fail(SPIN_E_MALFORMED,
                         "cannot read '%s': its directory of %llu bytes cannot hold %llu members",
                         path, (unsigned long long)dir->size, (unsigned long long)dir->n);
    return SPIN_OK;
}

/* ---- Reading: the directory's entries ------------------------------------------------------ */

static spin_status fail_member(spin_status code, const char *path, const char *name,
                               const char *what)
{
    return spin_fail(code, "cannot read '%s': member '%s' %s", path, name, what);
}

/* Values that did not fit in 32 bits stand in the zip64 record, in this order, and only those. */
static bool read_zip64_extra(const unsigned char *extra, size_t n, struct spin_zip_member *m)
{
    uint64_t *field[3] = {&m->size, &m->packed_size, &m->header_offset};
    const unsigned char *p = NULL;
    size_t left = 0;

    if (m->size != full32 && m->packed_size != full32 && m->header_offset != full32)
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
        if (*field[i] != full32)
            continue;
        if (left < 8)
            return false;
        *field[i] = u64(p);
        p += 8;
        left -= 8;
    }
    return true;
}

/* One entry at p, of which `left` bytes remain in the directory. Its length goes to *taken; the
 * name is copied to `name`, where there is room for it and a NUL. */
static spin_status read_entry(const char *path, const struct directory *dir, const unsigned char *p,
                              uint64_t left, char *name, struct spin_zip_member *m, uint64_t *taken)
{
    size_t n_name, n_extra;
    uint64_t room;

    if (left < CENTRAL_BYTES || u32(p) != SIG_CENTRAL)
        return spin_fail(SPIN_E_MALFORMED, "cannot read '%s': its directory is damaged", path);
    n_name = u16(p + 28);
    n_extra = u16(p + 30);
    *taken = (uint64_t)CENTRAL_BYTES + n_name + n_extra + u16(p + 32);
    if (*taken > left)
        return spin_fail(SPIN_E_MALFORMED, "cannot read '%s': its directory is damaged", path);
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
    if (u16(p + 8) & FLAG_ENCRYPTED)
        return fail_member(SPIN_E_UNSUPPORTED, path, name, "is encrypted");
    if (!read_zip64_extra(p + CENTRAL_BYTES + n_name, n_extra, m))
        return fail_member(SPIN_E_MALFORMED, path, name, "lacks its zip64 sizes");
    if (m->method == METHOD_STORED && m->size != m->packed_size)
        return fail_member(SPIN_E_MALFORMED, path, name, "is stored but has two different sizes");

    /* Members lie before the directory: header, name, data. */
    if (m->header_offset > dir->offset || dir->offset - m->header_offset < LOCAL_BYTES + n_name)
        return fail_member(SPIN_E_MALFORMED, path, name, "lies outside the file");
    room = dir->offset - m->header_offset - LOCAL_BYTES - n_name;
    if (m->packed_size > room)
        return spin_fail(SPIN_E_MALFORMED,
                         "cannot read '%s': member '%s' claims %llu bytes where only %llu are",
                         path, name, (unsigned long long)m->packed_size, (unsigned long long)room);
    return SPIN_OK;
}

static int by_offset(const void *a, const void *b)
{
    const struct spin_zip_member *x = *(const struct spin_zip_member *const *)a;
    const struct spin_zip_member *y = *(const struct spin_zip_member *const *)b;

    return x->header_offset < y->header_offset ? -1 : x->header_offset > y->header_offset;
}

/* No byte may belong to two members. */
static spin_status check_overlap(const char *path, const struct spin_zip *zip)
{
    void *block;
    const struct spin_zip_member **order;
    spin_status status = SPIN_OK;

    SPIN_TRY(spin_alloc(zip->n, sizeof *order, &block));
    order = block;
    for (size_t i = 0; i < zip->n; i++)
        order[i] = &zip->member[i];
    qsort(order, zip->n, sizeof *order, by_offset);
    for (size_t i = 1; i < zip->n && status == SPIN_OK; i++) {
        const struct spin_zip_member *m = order[i - 1];
        uint64_t end = m->header_offset + LOCAL_BYTES + strlen(m->name) + m->packed_size;

        if (end > order[i]->header_offset)
            status = spin_fail(SPIN_E_MALFORMED, "cannot read '%s': members '%s' and '%s' overlap",
                               path, m->name, order[i]->name);
    }
    free(block);
    return status;
}

static spin_status read_directory(const char *path, const struct directory *dir,
                                  struct spin_zip *out)
{
    const unsigned char *p = out->map.data + dir->offset;
    uint64_t left = dir->size, taken = 0;
    void *block = NULL;
    char *name;

    SPIN_TRY(spin_alloc((size_t)dir->n, sizeof *out->member, &block));
    out->member = block;
    /* Names are shorter than their entries, which leaves room for their NULs. */
    SPIN_TRY(spin_alloc((size_t)dir->size + 1, 1, &block));
    name = out->names = block;
    for (uint64_t i = 0; i < dir->n; i++) {
        SPIN_TRY(read_entry(path, dir, p, left, name, &out->member[i], &taken));
        name += strlen(name) + 1;
        p += taken;
        left -= taken;
        out->n++;
    }
    if (left > 0)
        return spin_fail(SPIN_E_MALFORMED,
                         "cannot read '%s': %llu bytes of its directory are unused", path,
                         (unsigned long long)left);
    return check_overlap(path, out);
}

spin_status spin_zip_open(const char *path, struct spin_zip *out)
{
    struct directory dir = {0};
    spin_status status;

    memset(out, 0, sizeof *out);
    SPIN_TRY(spin_map_open(path, &out->map));
    SPIN_TRY_OUT(spin_strdup(path, &out->path));
    SPIN_TRY_OUT(find_directory(path, &out->map, &dir));
    SPIN_TRY_OUT(read_directory(path, &dir, out));
    return SPIN_OK;
out:
    spin_zip_close(out);
    return status;
}

void spin_zip_close(struct spin_zip *zip)
{
    spin_map_close(&zip->map);
    free(zip->path);
    free(zip->member);
    free(zip->names);
    memset(zip, 0, sizeof *zip);
}

const struct spin_zip_member *spin_zip_find(const struct spin_zip *zip, const char *name)
{
    for (size_t i = zip->n; i-- > 0;)
        if (strcmp(zip->member[i].name, name) == 0)
            return &zip->member[i];
    return NULL;
}

/* ---- Reading: a member's bytes ------------------------------------------------------------- */

/* The packed bytes. The local header gives only the place where they begin, and must bear the
 * name. */
static spin_status find_data(const struct spin_zip *zip, const struct spin_zip_member *m,
                             const unsigned char **data)
{
    const unsigned char *p = zip->map.data + m->header_offset;
    uint64_t left = zip->map.size - m->header_offset;
    size_t n_name = strlen(m->name);
    uint64_t head;

    if (left < LOCAL_BYTES || u32(p) != SIG_LOCAL)
        return fail_member(SPIN_E_MALFORMED, zip->path, m->name,
                           "has no header where it should be");
    head = (uint64_t)LOCAL_BYTES + u16(p + 26) + u16(p + 28);
    if (head > left || m->packed_size > left - head)
        return fail_member(SPIN_E_MALFORMED, zip->path, m->name, "is cut short");
    if (u16(p + 26) != n_name || memcmp(p + LOCAL_BYTES, m->name, n_name) != 0)
        return fail_member(SPIN_E_MALFORMED, zip->path, m->name, "has another name in its header");
    *data = p + head;
    return SPIN_OK;
}

/* Raw deflate of n bytes into exactly `size` bytes; false when it is damaged or yields another
 * size. zlib counts in unsigned int, so both sides are fed in pieces. */
static bool inflate_exactly(const unsigned char *packed, uint64_t n, unsigned char *out,
                            uint64_t size)
{
    const uint64_t piece = 1u << 30;
    unsigned char beyond; /* takes the byte too many, if there is one */
    z_stream z = {0};
    int result = Z_OK;

    if (inflateInit2(&z, -MAX_WBITS) != Z_OK)
        return false;
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
    return result == Z_STREAM_END && n == 0 && size == 0;
}

/* Raw deflate of the first bytes: how many came out, at most n. */
static size_t inflate_head(const unsigned char *packed, uint64_t n_packed, void *out, size_t n)
{
    const uint64_t piece = 1u << 30;
    z_stream z = {0};
    size_t n_out;

    if (inflateInit2(&z, -MAX_WBITS) != Z_OK)
        return 0;
    z.next_in = (Bytef *)(uintptr_t)packed;
    z.avail_in = (uInt)(n_packed < piece ? n_packed : piece);
    z.next_out = out;
    z.avail_out = (uInt)(n < piece ? n : piece);
    inflate(&z, Z_SYNC_FLUSH); /* damage is found when the whole is read */
    n_out = (size_t)z.total_out;
    inflateEnd(&z);
    return n_out;
}

static spin_status read_deflated(const struct spin_zip *zip, const struct spin_zip_member *m,
                                 const unsigned char *packed, uint64_t limit, void **owned)
{
    if (m->size > SIZE_MAX ||
        (m->size > deflate_slack && (m->size - deflate_slack) / deflate_ratio > m->packed_size))
        return spin_fail(SPIN_E_MALFORMED,
                         "cannot read '%s': member '%s' claims %llu bytes out of %llu packed ones",
                         zip->path, m->name, (unsigned long long)m->size,
                         (unsigned long long)m->packed_size);
    if (m->size > limit)
        return spin_fail(
            SPIN_E_UNSUPPORTED,
            "cannot read '%s': member '%s' unpacks to %llu bytes, more than the %llu allowed",
            zip->path, m->name, (unsigned long long)m->size, (unsigned long long)limit);
    *owned = malloc(m->size ? (size_t)m->size : 1);
    if (!*owned)
        return spin_fail(SPIN_E_MEMORY,
                         "cannot read '%s': not enough memory for the %llu bytes of member '%s'",
                         zip->path, (unsigned long long)m->size, m->name);
    if (!inflate_exactly(packed, m->packed_size, *owned, m->size)) {
        free(*owned);
        *owned = NULL;
        return fail_member(SPIN_E_MALFORMED, zip->path, m->name, "is damaged (it does not unpack)");
    }
    return SPIN_OK;
}

static spin_status fail_method(const struct spin_zip *zip, const struct spin_zip_member *member)
{
    return spin_fail(SPIN_E_UNSUPPORTED,
                     "cannot read '%s': member '%s' is packed with method %d, not 0 or 8",
                     zip->path, member->name, member->method);
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
        *n_out = inflate_head(packed, member->packed_size, out, n);
    } else {
        return fail_method(zip, member);
    }
    return SPIN_OK;
}

/* ---- Checksums ----------------------------------------------------------------------------- */

enum { CRC_PARTS = 4, CRC_PART_BYTES = 2 << 20 }; /* least for a thread of its own */

struct crc_part {
    const unsigned char *data;
    size_t size;
    uint32_t crc;
    pthread_t thread;
    bool started;
};

static void *sum_part(void *context)
{
    struct crc_part *part = context;

    part->crc = spin_crc32(0, part->data, part->size);
    return NULL;
}

/* Of a large member by a few threads: nothing else goes on while a frame is waited for. */
static uint32_t checksum(const unsigned char *data, size_t size)
{
    long n_cores = sysconf(_SC_NPROCESSORS_ONLN);
    size_t n = size / CRC_PART_BYTES, most = n_cores < CRC_PARTS ? (size_t)n_cores : CRC_PARTS;
    struct crc_part part[CRC_PARTS] = {{0}};
    uint32_t crc;

    n = n < 1 || n_cores < 1 ? 1 : n < most ? n : most;
    for (size_t i = 0; i < n; i++) {
        part[i].data = data + size / n * i;
        part[i].size = i + 1 < n ? size / n : size - size / n * i;
        part[i].started = i > 0 && pthread_create(&part[i].thread, NULL, sum_part, &part[i]) == 0;
    }
    sum_part(&part[0]);
    crc = part[0].crc;
    for (size_t i = 1; i < n; i++) {
        if (part[i].started)
            pthread_join(part[i].thread, NULL);
        else
            sum_part(&part[i]);
        crc = (uint32_t)crc32_combine(crc, part[i].crc, (z_off_t)part[i].size);
    }
    return crc;
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
    if (check_crc && checksum(*data, (size_t)member->size) != member->crc) {
        free(*owned);
        *owned = NULL;
        *data = NULL;
        return fail_member(SPIN_E_MALFORMED, zip->path, member->name,
                           "is damaged (its CRC differs)");
    }
    return SPIN_OK;
}

/* ---- Writing ------------------------------------------------------------------------------- */

struct spin_zip_written {
    char *name;
    uint64_t size, header_offset;
    uint32_t crc;
};

/* Headers are put together here; none is longer. */
struct bytes {
    unsigned char data[128 + ALIGN];
    size_t n;
};

static void put(struct bytes *b, uint64_t value, int n_bytes)
{
    for (int i = 0; i < n_bytes; i++) {
        b->data[b->n++] = (unsigned char)value;
        value >>= 8;
    }
}

static uint32_t low32(uint64_t value) { return value < full32 ? (uint32_t)value : full32; }

static int name_flags(const char *name)
{
    for (; *name; name++)
        if ((unsigned char)*name >= 0x80)
            return FLAG_UTF8;
    return 0;
}

spin_status spin_zip_writer_open(const char *path, bool force, struct spin_zip_writer *w)
{
    memset(w, 0, sizeof *w);
    return spin_out_open(path, force, &w->out);
}

static spin_status add_written(struct spin_zip_writer *w, const char *name, uint64_t size)
{
    struct spin_zip_written *entry;

    if (w->n == w->capacity) {
        size_t capacity = w->capacity ? 2 * w->capacity : 32;
        void *block = w->written;

        SPIN_TRY(spin_grow(capacity, sizeof *w->written, &block));
        w->written = block;
        w->capacity = capacity;
    }
    entry = &w->written[w->n];
    memset(entry, 0, sizeof *entry);
    SPIN_TRY(spin_strdup(name, &entry->name));
    entry->size = size;
    entry->header_offset = w->out.bytes;
    w->n++;
    return SPIN_OK;
}

/* The fields that local header and directory entry share, from "version needed" to the name
 * length. */
static void put_common(struct bytes *b, const struct spin_zip_written *e, bool zip64)
{
    put(b, zip64 ? 45 : 20, 2);
    put(b, (uint64_t)name_flags(e->name), 2);
    put(b, METHOD_STORED, 2);
    put(b, 0, 2);
    put(b, DOS_DATE_1980, 2);
    put(b, e->crc, 4);
    put(b, low32(e->size), 4);
    put(b, low32(e->size), 4);
    put(b, strlen(e->name), 2);
}

/* The padding record that brings the data behind `used` header bytes to a multiple of ALIGN. */
static size_t padding(uint64_t used)
{
    size_t pad = (size_t)(-used & (ALIGN - 1));

    return pad == 0 || pad >= 6 ? pad : pad + ALIGN;
}

/* The local header. crc: 0 when it is not known yet. */
static spin_status begin_member(struct spin_zip_writer *w, const char *name, uint64_t size,
                                uint32_t crc)
{
    struct bytes b = {.n = 0}, extra = {.n = 0};
    size_t n_name = strlen(name), pad;
    bool zip64 = size >= full32;

    if (n_name == 0 || n_name > UINT16_MAX)
        return spin_fail(SPIN_E_USAGE, "cannot write '%s': a member's name has %zu bytes",
                         w->out.path, n_name);
    SPIN_TRY(add_written(w, name, size));
    if (zip64) {
        put(&extra, EXTRA_ZIP64, 2);
        put(&extra, 16, 2);
        put(&extra, size, 8);
        put(&extra, size, 8);
    }
    w->written[w->n - 1].crc = crc;
    pad = padding(w->out.bytes + LOCAL_BYTES + n_name + extra.n);
    if (pad > 0) {
        put(&extra, EXTRA_ALIGN, 2);
        put(&extra, pad - 4, 2);
        put(&extra, ALIGN, 2);
        for (size_t i = 6; i < pad; i++)
            put(&extra, 0, 1);
    }
    put(&b, SIG_LOCAL, 4);
    put_common(&b, &w->written[w->n - 1], zip64);
    put(&b, extra.n, 2);
    SPIN_TRY(spin_out_write(&w->out, b.data, b.n));
    SPIN_TRY(spin_out_write(&w->out, name, n_name));
    return spin_out_write(&w->out, extra.data, extra.n);
}

spin_status spin_zip_member_begin(struct spin_zip_writer *w, const char *name, uint64_t size)
{
    w->crc = 0;
    w->member_size = 0;
    SPIN_TRY(begin_member(w, name, size, 0));
    w->in_member = true;
    return SPIN_OK;
}

spin_status spin_zip_member_whole(struct spin_zip_writer *w, const char *name, const void *head,
                                  size_t n_head, const void *data, size_t n_data)
{
    uint32_t crc = spin_crc32(spin_crc32(0, head, n_head), data, n_data);

    SPIN_TRY(begin_member(w, name, (uint64_t)n_head + n_data, crc));
    SPIN_TRY(spin_out_write(&w->out, head, n_head));
    return spin_out_write(&w->out, data, n_data);
}

spin_status spin_zip_member_write(struct spin_zip_writer *w, const void *data, size_t bytes)
{
    if (bytes > w->written[w->n - 1].size - w->member_size)
        return spin_fail(SPIN_E_USAGE, "cannot write '%s': member '%s' is longer than announced",
                         w->out.path, w->written[w->n - 1].name);
    w->crc = spin_crc32(w->crc, data, bytes);
    w->member_size += bytes;
    return spin_out_write(&w->out, data, bytes);
}

/* The CRC is known only now: put it into the local header. Not by seeking, as stdio then reads and
 * writes again what lies around it. */
spin_status spin_zip_member_end(struct spin_zip_writer *w)
{
    struct spin_zip_written *entry = &w->written[w->n - 1];
    struct bytes b = {.n = 0};

    w->in_member = false;
    if (w->member_size != entry->size)
        return spin_fail(SPIN_E_USAGE, "cannot write '%s': member '%s' is shorter than announced",
                         w->out.path, entry->name);
    entry->crc = w->crc;
    put(&b, entry->crc, 4);
    if (fflush(w->out.file) != 0 || pwrite(fileno(w->out.file), b.data, b.n,
                                           (off_t)(entry->header_offset + 14)) != (ssize_t)b.n)
        return spin_fail(SPIN_E_IO, "cannot write '%s': the disk refused", w->out.path);
    return SPIN_OK;
}

static spin_status write_entry(struct spin_zip_writer *w, const struct spin_zip_written *e)
{
    struct bytes b = {.n = 0}, extra = {.n = 0};

    if (e->size >= full32) {
        put(&extra, e->size, 8);
        put(&extra, e->size, 8);
    }
    if (e->header_offset >= full32)
        put(&extra, e->header_offset, 8);

    put(&b, SIG_CENTRAL, 4);
    put(&b, extra.n > 0 ? 45 : 20, 2); /* made by: no system's attributes */
    put_common(&b, e, extra.n > 0);
    put(&b, extra.n > 0 ? extra.n + 4 : 0, 2);
    put(&b, 0, 2 + 2 + 2 + 4); /* comment, disk, attributes */
    put(&b, low32(e->header_offset), 4);
    SPIN_TRY(spin_out_write(&w->out, b.data, b.n));
    SPIN_TRY(spin_out_write(&w->out, e->name, strlen(e->name)));
    if (extra.n == 0)
        return SPIN_OK;
    b.n = 0;
    put(&b, EXTRA_ZIP64, 2);
    put(&b, extra.n, 2);
    SPIN_TRY(spin_out_write(&w->out, b.data, b.n));
    return spin_out_write(&w->out, extra.data, extra.n);
}

static spin_status write_directory(struct spin_zip_writer *w)
{
    struct bytes b = {.n = 0};
    uint64_t offset = w->out.bytes, size, end;

    for (size_t i = 0; i < w->n; i++)
        SPIN_TRY(write_entry(w, &w->written[i]));
    end = w->out.bytes;
    size = end - offset;
    if (w->n >= UINT16_MAX || offset >= full32 || size >= full32) {
        put(&b, SIG_END64, 4);
        put(&b, END64_BYTES - 12, 8);
        put(&b, 45, 2);
        put(&b, 45, 2);
        put(&b, 0, 8); /* disks */
        put(&b, w->n, 8);
        put(&b, w->n, 8);
        put(&b, size, 8);
        put(&b, offset, 8);
        put(&b, SIG_LOCATOR, 4);
        put(&b, 0, 4);
        put(&b, end, 8);
        put(&b, 1, 4);
    }
    put(&b, SIG_END, 4);
    put(&b, 0, 4); /* disks */
    put(&b, w->n < UINT16_MAX ? w->n : UINT16_MAX, 2);
    put(&b, w->n < UINT16_MAX ? w->n : UINT16_MAX, 2);
    put(&b, low32(size), 4);
    put(&b, low32(offset), 4);
    put(&b, 0, 2);
    return spin_out_write(&w->out, b.data, b.n);
}

static void free_written(struct spin_zip_writer *w)
{
    for (size_t i = 0; i < w->n; i++)
        free(w->written[i].name);
    free(w->written);
    memset(w, 0, sizeof *w);
}

spin_status spin_zip_writer_commit(struct spin_zip_writer *w)
{
    spin_status status = SPIN_OK;

    if (w->in_member)
        status = spin_fail(SPIN_E_USAGE, "cannot write '%s': its last member was not ended",
                           w->out.path);
    if (status == SPIN_OK)
        status = write_directory(w);
    if (status == SPIN_OK)
        status = spin_out_commit(&w->out);
    else
        spin_out_abandon(&w->out);
    free_written(w);
    return status;
}

void spin_zip_writer_abandon(struct spin_zip_writer *w)
{
    spin_out_abandon(&w->out);
    free_written(w);
}
