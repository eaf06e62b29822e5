/* Writes zip archives. Headers of stored members are padded to align their data. */
#include "base/base.h"
#include "io/compress.h"
#include "io/zip.h"
#include "io/zip_format.h"

enum {
    /* Extra record that zipalign uses: the alignment as 16-bit integer, then padding. */
    EXTRA_ALIGN = 0xd935,
    FLAG_UTF8 = 1 << 11,
    ALIGN = 64,
    DOS_DATE_1980 = 0x21,
    DEFLATE_LEVEL = 6,
    WINDOW = SPIN_DEFLATE_WINDOW,
    /* Number of bytes of a member that several threads deflate at a time. */
    PART = 8 << 20
};
/* Deflated members of at least this size get 64-bit fields in their headers, since compression may
 * make data slightly longer. */
static const uint64_t deflate_zip64 = 0xf0000000u;

struct spin_zip_deflate {
    bool runs; /* spin_zip_member_runs() was called */
    /* [n_room]: n_before bytes that were already compressed, then n that were not */
    unsigned char *in;
    size_t n_room, n_before, n;
    uint64_t packed_size;
    struct spin_deflate_room out;
};

struct spin_zip_written {
    char *name;
    uint64_t size, packed_size, header_offset;
    uint32_t crc;
    int method;
    bool zip64; /* the local header contains 64-bit sizes */
};

/* A buffer for one header, large enough for the longest one. */
struct bytes {
    unsigned char data[128 + ALIGN];
    size_t n;
};

static void put_int(struct bytes *b, uint64_t value, int n_bytes)
{
    for (int i = 0; i < n_bytes; i++) {
        b->data[b->n++] = (unsigned char)value;
        value >>= 8;
    }
}

static uint32_t low32(uint64_t value) { return value < FULL32 ? (uint32_t)value : FULL32; }

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

static spin_status add_written(struct spin_zip_writer *w, const char *name, uint64_t size,
                               int method)
{
    struct spin_zip_written *entry;

    SPIN_TRY(spin_array_grow(w->n, &w->capacity, sizeof *w->written, (void **)&w->written));
    entry = &w->written[w->n];
    memset(entry, 0, sizeof *entry);
    SPIN_TRY(spin_strdup(name, &entry->name));
    /* The packed_size of a deflated member is corrected when the member ends. */
    entry->size = entry->packed_size = size;
    entry->method = method;
    entry->zip64 = size >= (method == METHOD_STORED ? FULL32 : deflate_zip64);
    entry->header_offset = w->out.bytes;
    w->n++;
    return SPIN_OK;
}

/* Append the fields that local header and directory entry have in common, from "version needed" to
 * the length of the name. */
static void put_common(struct bytes *b, const struct spin_zip_written *e, bool zip64,
                       uint32_t packed_size, uint32_t size)
{
    put_int(b, zip64 ? 45 : 20, 2);
    put_int(b, (uint64_t)name_flags(e->name), 2);
    put_int(b, (uint64_t)e->method, 2);
    put_int(b, 0, 2);
    put_int(b, DOS_DATE_1980, 2);
    put_int(b, e->crc, 4);
    put_int(b, packed_size, 4);
    put_int(b, size, 4);
    put_int(b, strlen(e->name), 2);
}

/* Returns the size of the padding record that aligns the data after `used` header bytes: 0 for no
 * record, or at least 6 bytes. */
static size_t padding_size(uint64_t used)
{
    size_t pad = (size_t)(-used & (ALIGN - 1));

    return pad == 0 || pad >= 6 ? pad : pad + ALIGN;
}

/* Write the local header of a member. crc: the CRC-32 of the data; 0 if not known yet. */
static spin_status begin_member(struct spin_zip_writer *w, const char *name, uint64_t size,
                                uint32_t crc, int method)
{
    struct bytes b = {.n = 0}, extra = {.n = 0};
    size_t n_name = strlen(name), pad;
    uint32_t size32;
    struct spin_zip_written *e;

    if (n_name == 0 || n_name > UINT16_MAX)
        return spin_misuse(
            "cannot write '%s': a member's name has %zu bytes, but 1 to 65535 are supported",
            w->out.path, n_name);
    SPIN_TRY(add_written(w, name, size, method));
    e = &w->written[w->n - 1];
    size32 = e->zip64 ? FULL32 : (uint32_t)size;
    if (e->zip64) {
        put_int(&extra, EXTRA_ZIP64, 2);
        put_int(&extra, 16, 2);
        put_int(&extra, size, 8);
        put_int(&extra, size, 8);
    }
    e->crc = crc;
    pad = method == METHOD_STORED && !w->plain
              ? padding_size(w->out.bytes + LOCAL_BYTES + n_name + extra.n)
              : 0;
    if (pad > 0) {
        put_int(&extra, EXTRA_ALIGN, 2);
        put_int(&extra, pad - 4, 2);
        put_int(&extra, ALIGN, 2);
        for (size_t i = 6; i < pad; i++)
            put_int(&extra, 0, 1);
    }
    put_int(&b, SIG_LOCAL, 4);
    put_common(&b, e, e->zip64, size32, size32);
    put_int(&b, extra.n, 2);
    SPIN_TRY(spin_out_write(&w->out, b.data, b.n));
    SPIN_TRY(spin_out_write(&w->out, name, n_name));
    return spin_out_write(&w->out, extra.data, extra.n);
}

spin_status spin_zip_member_begin(struct spin_zip_writer *w, const char *name, uint64_t size)
{
    w->crc = 0;
    w->member_size = 0;
    SPIN_TRY(begin_member(w, name, size, 0, METHOD_STORED));
    w->in_member = true;
    return SPIN_OK;
}

static void free_deflate(struct spin_zip_writer *w)
{
    if (w->deflate) {
        free(w->deflate->in);
        free(w->deflate->out.data);
    }
    free(w->deflate);
    w->deflate = NULL;
}

spin_status spin_zip_member_begin_deflated(struct spin_zip_writer *w, const char *name,
                                           uint64_t size)
{
    struct spin_zip_deflate *d;

    w->crc = 0;
    w->member_size = 0;
    SPIN_TRY(spin_alloc(1, sizeof *d, (void **)&d));
    *d = (struct spin_zip_deflate){.n_room = WINDOW + (size < PART ? (size_t)size : PART)};
    w->deflate = d;
    SPIN_TRY(spin_alloc(d->n_room, 1, (void **)&d->in));
    if (size > PART && !w->pool)
        SPIN_TRY(spin_pool_create(w->n_threads, &w->pool));
    w->in_member = true;
    return begin_member(w, name, size, 0, METHOD_DEFLATE);
}

void spin_zip_member_runs(struct spin_zip_writer *w) { w->deflate->runs = true; }

/* Compress the pending bytes and write the result. */
static spin_status deflate_part(struct spin_zip_writer *w, bool last)
{
    struct spin_zip_deflate *d = w->deflate;
    const struct spin_deflate job = {.data = d->in + d->n_before,
                                     .n = d->n,
                                     .n_before = d->n_before,
                                     .level = DEFLATE_LEVEL,
                                     .rle = d->runs,
                                     .noise_as_is = d->runs,
                                     .last = last};
    size_t all = d->n_before + d->n;

    SPIN_TRY(spin_deflate(w->pool, &job, 0, 0, &d->out));
    d->packed_size += d->out.n;
    d->n_before = all < WINDOW ? all : WINDOW;
    d->n = 0;
    memmove(d->in, d->in + all - d->n_before, d->n_before);
    return spin_out_write(&w->out, d->out.data, d->out.n);
}

static spin_status append_deflated(struct spin_zip_writer *w, const unsigned char *data, size_t n)
{
    struct spin_zip_deflate *d = w->deflate;

    while (n > 0) {
        size_t room = d->n_room - d->n_before - d->n, n_fits = n < room ? n : room;

        memcpy(d->in + d->n_before + d->n, data, n_fits);
        d->n += n_fits;
        data += n_fits;
        n -= n_fits;
        if (n > 0)
            SPIN_TRY(deflate_part(w, false));
    }
    return SPIN_OK;
}

spin_status spin_zip_member_whole(struct spin_zip_writer *w, const char *name, const void *head,
                                  size_t n_head, const void *data, size_t n_data)
{
    uint32_t crc = spin_crc32(spin_crc32(0, head, n_head), data, n_data);

    SPIN_TRY(begin_member(w, name, (uint64_t)n_head + n_data, crc, METHOD_STORED));
    SPIN_TRY(spin_out_write(&w->out, head, n_head));
    return spin_out_write(&w->out, data, n_data);
}

spin_status spin_zip_member_write(struct spin_zip_writer *w, const void *data, size_t bytes)
{
    if (bytes > w->written[w->n - 1].size - w->member_size)
        return spin_misuse("cannot write '%s': member '%s' is longer than announced", w->out.path,
                           w->written[w->n - 1].name);
    w->crc = spin_crc32(w->crc, data, bytes);
    w->member_size += bytes;
    if (w->deflate)
        return append_deflated(w, data, bytes);
    return spin_out_write(&w->out, data, bytes);
}

/* Write values that became known later into a local header. pwrite() is used because stdio would
 * reload and rewrite its buffer after a seek. */
static spin_status patch_header(struct spin_zip_writer *w, const struct bytes *b, uint64_t at)
{
    if (fflush(w->out.file) != 0)
        return spin_out_failed(&w->out, errno);
    return spin_out_write_at(&w->out, at, b->data, b->n);
}

spin_status spin_zip_member_end(struct spin_zip_writer *w)
{
    struct spin_zip_written *entry = &w->written[w->n - 1];
    struct bytes b = {.n = 0};

    w->in_member = false;
    if (w->member_size != entry->size)
        return spin_misuse("cannot write '%s': member '%s' is shorter than announced", w->out.path,
                           entry->name);
    entry->crc = w->crc;
    put_int(&b, entry->crc, 4);
    if (!w->deflate)
        return patch_header(w, &b, entry->header_offset + 14);
    SPIN_TRY(deflate_part(w, true));
    entry->packed_size = w->deflate->packed_size;
    free_deflate(w);
    if (!entry->zip64)
        put_int(&b, entry->packed_size, 4);
    SPIN_TRY(patch_header(w, &b, entry->header_offset + 14));
    if (!entry->zip64)
        return SPIN_OK;
    b.n = 0;
    /* The compressed size in the zip64 record follows the record's header and the uncompressed
     * size. */
    put_int(&b, entry->packed_size, 8);
    return patch_header(w, &b, entry->header_offset + LOCAL_BYTES + strlen(entry->name) + 4 + 8);
}

static spin_status write_entry(struct spin_zip_writer *w, const struct spin_zip_written *e)
{
    struct bytes b = {.n = 0}, extra = {.n = 0};

    if (e->size >= FULL32)
        put_int(&extra, e->size, 8);
    if (e->packed_size >= FULL32)
        put_int(&extra, e->packed_size, 8);
    if (e->header_offset >= FULL32)
        put_int(&extra, e->header_offset, 8);

    put_int(&b, SIG_CENTRAL, 4);
    put_int(&b, extra.n > 0 ? 45 : 20, 2); /* the field "version made by" */
    put_common(&b, e, extra.n > 0, low32(e->packed_size), low32(e->size));
    put_int(&b, extra.n > 0 ? extra.n + 4 : 0, 2);
    put_int(&b, 0, 2 + 2 + 2 + 4); /* no comment, disk 0, no attributes */
    put_int(&b, low32(e->header_offset), 4);
    SPIN_TRY(spin_out_write(&w->out, b.data, b.n));
    SPIN_TRY(spin_out_write(&w->out, e->name, strlen(e->name)));
    if (extra.n == 0)
        return SPIN_OK;
    b.n = 0;
    put_int(&b, EXTRA_ZIP64, 2);
    put_int(&b, extra.n, 2);
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
    if (w->n >= UINT16_MAX || offset >= FULL32 || size >= FULL32) {
        put_int(&b, SIG_END64, 4);
        put_int(&b, END64_BYTES - 12, 8);
        put_int(&b, 45, 2);
        put_int(&b, 45, 2);
        put_int(&b, 0, 8); /* numbers of disks */
        put_int(&b, w->n, 8);
        put_int(&b, w->n, 8);
        put_int(&b, size, 8);
        put_int(&b, offset, 8);
        put_int(&b, SIG_LOCATOR, 4);
        put_int(&b, 0, 4);
        put_int(&b, end, 8);
        put_int(&b, 1, 4);
    }
    put_int(&b, SIG_END, 4);
    put_int(&b, 0, 4); /* numbers of disks */
    put_int(&b, w->n < UINT16_MAX ? w->n : UINT16_MAX, 2);
    put_int(&b, w->n < UINT16_MAX ? w->n : UINT16_MAX, 2);
    put_int(&b, low32(size), 4);
    put_int(&b, low32(offset), 4);
    put_int(&b, 0, 2);
    return spin_out_write(&w->out, b.data, b.n);
}

static void free_written(struct spin_zip_writer *w)
{
    free_deflate(w);
    for (size_t i = 0; i < w->n; i++)
        free(w->written[i].name);
    free(w->written);
    spin_pool_free(w->pool);
    memset(w, 0, sizeof *w);
}

void spin_zip_writer_begin(const struct spin_out *out, struct spin_zip_writer *w)
{
    memset(w, 0, sizeof *w);
    w->out = *out;
}

spin_status spin_zip_writer_end(struct spin_zip_writer *w, spin_status so_far, struct spin_out *out)
{
    if (so_far == SPIN_OK)
        so_far = write_directory(w);
    *out = w->out;
    free_written(w);
    return so_far;
}

spin_status spin_zip_writer_commit(struct spin_zip_writer *w)
{
    spin_status status = SPIN_OK;

    if (w->in_member)
        status = spin_misuse("cannot write '%s': its last member was not ended", w->out.path);
    if (status == SPIN_OK)
        status = write_directory(w);
    if (status == SPIN_OK)
        /* This closes the output also after a failure, so that spin_zip_writer_abandon() only frees
         * memory. */
        status = spin_out_commit(&w->out);
    spin_zip_writer_abandon(w);
    return status;
}

void spin_zip_writer_abandon(struct spin_zip_writer *w)
{
    spin_out_abandon(&w->out);
    free_written(w);
}
