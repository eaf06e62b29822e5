/* Gzip (RFC 1952) around deflate (RFC 1951), in blocks that threads deflate side by side.
 *
 * Each block starts from the 32 KiB before it as dictionary and ends on a byte (zlib's sync flush,
 * an empty stored block), so that the blocks, one after the other, are one ordinary stream: about
 * 0.1 % longer than if deflated in one go. Their checksums are combined. */
#include "io/gzip.h"

#include <stdlib.h>
#include <string.h>
#include <zlib.h>

#include "base/err.h"
#include "base/mem.h"
#include "base/pool.h"
#include "io/crc.h"

#define BLOCK ((size_t)256 << 10)
#define MAX_BLOCKS 16 /* of a batch */
#define WINDOW ((size_t)32 << 10)

struct block {
    uLong crc;
    size_t n_packed;
    bool failed;
};

struct spin_gzip {
    int level;
    struct spin_pool *pool;
    struct spin_out *out;
    size_t n_raw;       /* bytes of this batch */
    size_t n_before;    /* bytes of the window that are there */
    size_t slot;        /* room for a packed block */
    bool last;          /* batch of the stream */
    uLong crc;          /* of what was written */
    uint64_t n_total;   /* likewise */
    unsigned char *raw; /* [WINDOW + MAX_BLOCKS * BLOCK]; the window ends where the batch begins */
    unsigned char *packed; /* [MAX_BLOCKS][slot] */
    struct block block[MAX_BLOCKS];
};

spin_status spin_gzip_create(int level, int n_threads, struct spin_gzip **out)
{
    struct spin_gzip *g = NULL;
    spin_status status;

    *out = NULL;
    SPIN_TRY(spin_alloc(1, sizeof *g, (void **)&g));
    g->level = level;
    g->slot = compressBound(BLOCK) + 64; /* the bound knows nothing of the flush */
    SPIN_TRY_OUT(spin_alloc(WINDOW + MAX_BLOCKS * BLOCK, 1, (void **)&g->raw));
    SPIN_TRY_OUT(spin_alloc(MAX_BLOCKS, g->slot, (void **)&g->packed));
    SPIN_TRY_OUT(spin_pool_create(n_threads, &g->pool));
    *out = g;
    return SPIN_OK;
out:
    spin_gzip_free(g);
    return status;
}

void spin_gzip_free(struct spin_gzip *g)
{
    if (!g)
        return;
    if (g->pool)
        spin_pool_free(g->pool);
    free(g->raw);
    free(g->packed);
    free(g);
}

spin_status spin_gzip_begin(struct spin_gzip *g, struct spin_out *out)
{
    /* Magic, deflate, no flags, no date, no hint about the effort, Unix. */
    static const unsigned char header[10] = {0x1f, 0x8b, 8, 0, 0, 0, 0, 0, 0, 3};

    g->out = out;
    g->n_raw = g->n_before = 0;
    g->n_total = 0;
    g->crc = crc32(0, NULL, 0);
    g->last = false;
    return spin_out_write(out, header, sizeof header);
}

static size_t size_of_block(const struct spin_gzip *g, int i)
{
    size_t rest = g->n_raw - (size_t)i * BLOCK;

    return rest < BLOCK ? rest : BLOCK;
}

static int n_blocks(const struct spin_gzip *g)
{
    return g->n_raw == 0 ? 1 : (int)((g->n_raw + BLOCK - 1) / BLOCK);
}

static void deflate_block(void *context, int i, int worker)
{
    struct spin_gzip *g = context;
    struct block *b = &g->block[i];
    unsigned char *raw = g->raw + WINDOW + (size_t)i * BLOCK;
    size_t n = size_of_block(g, i), n_window = i > 0 ? WINDOW : g->n_before;
    bool end = g->last && i == n_blocks(g) - 1;
    z_stream z = {0};
    int result;

    (void)worker;
    b->failed = deflateInit2(&z, g->level, Z_DEFLATED, -MAX_WBITS, 8,
                             g->level == 1 ? Z_RLE : Z_DEFAULT_STRATEGY) != Z_OK;
    if (b->failed)
        return;
    if (n_window > 0)
        deflateSetDictionary(&z, raw - n_window, (uInt)n_window);
    z.next_in = raw;
    z.avail_in = (uInt)n;
    z.next_out = g->packed + (size_t)i * g->slot;
    z.avail_out = (uInt)g->slot;
    result = deflate(&z, end ? Z_FINISH : Z_SYNC_FLUSH);
    b->failed = result != (end ? Z_STREAM_END : Z_OK) || z.avail_in > 0 || z.avail_out == 0;
    b->n_packed = g->slot - z.avail_out;
    b->crc = spin_crc32(0, raw, n);
    deflateEnd(&z);
}

/* Deflate what has gathered, write it, keep its end as the window of the next batch. */
static spin_status write_batch(struct spin_gzip *g)
{
    int n = n_blocks(g);
    size_t n_keep = g->n_before + g->n_raw < WINDOW ? g->n_before + g->n_raw : WINDOW;

    spin_pool_run(g->pool, n, deflate_block, g);
    for (int i = 0; i < n; i++) {
        const struct block *b = &g->block[i];

        if (b->failed)
            return spin_fail(SPIN_E_MEMORY, "cannot deflate '%s': not enough memory", g->out->path);
        SPIN_TRY(spin_out_write(g->out, g->packed + (size_t)i * g->slot, b->n_packed));
        g->crc = crc32_combine(g->crc, b->crc, (z_off_t)size_of_block(g, i));
    }
    memmove(g->raw + WINDOW - n_keep, g->raw + WINDOW + g->n_raw - n_keep, n_keep);
    g->n_before = n_keep;
    g->n_total += g->n_raw;
    g->n_raw = 0;
    return SPIN_OK;
}

spin_status spin_gzip_write(struct spin_gzip *g, const void *data, size_t bytes)
{
    const unsigned char *from = data;

    while (bytes > 0) {
        size_t room = MAX_BLOCKS * BLOCK - g->n_raw, n = bytes < room ? bytes : room;

        if (room == 0) {
            SPIN_TRY(write_batch(g));
            continue;
        }
        memcpy(g->raw + WINDOW + g->n_raw, from, n);
        g->n_raw += n;
        from += n;
        bytes -= n;
    }
    return SPIN_OK;
}

spin_status spin_gzip_end(struct spin_gzip *g)
{
    unsigned char trailer[8];

    g->last = true;
    SPIN_TRY(write_batch(g));
    for (int i = 0; i < 4; i++) {
        trailer[i] = (unsigned char)(g->crc >> (8 * i));
        trailer[4 + i] = (unsigned char)(g->n_total >> (8 * i));
    }
    return spin_out_write(g->out, trailer, sizeof trailer);
}

spin_status spin_gzip_read(const void *data, size_t size, void *out, size_t n_out, size_t *n)
{
    const unsigned char *from = data;
    unsigned char *to = out;
    z_stream z = {0};
    int result = Z_OK;

    *n = 0;
    if (inflateInit2(&z, MAX_WBITS + 16) != Z_OK)
        return spin_fail(SPIN_E_MEMORY, "not enough memory to inflate");
    while (result == Z_OK && *n < n_out) {
        size_t n_in = size < UINT32_MAX / 2 ? size : UINT32_MAX / 2;
        size_t n_room = n_out - *n < UINT32_MAX / 2 ? n_out - *n : UINT32_MAX / 2;

        z.next_in = (unsigned char *)(uintptr_t)from;
        z.avail_in = (uInt)n_in;
        z.next_out = to + *n;
        z.avail_out = (uInt)n_room;
        result = inflate(&z, Z_NO_FLUSH);
        from += n_in - z.avail_in;
        size -= n_in - z.avail_in;
        *n += n_room - z.avail_out;
    }
    inflateEnd(&z);
    if (result != Z_STREAM_END && *n < n_out)
        return spin_fail(SPIN_E_MALFORMED, "the gzip is damaged or cut short after %zu bytes", *n);
    return SPIN_OK;
}

uint32_t spin_gzip_length(const void *data, size_t size)
{
    const unsigned char *end = (const unsigned char *)data + size;

    if (size < 18) /* header and trailer */
        return 0;
    return end[-4] | (uint32_t)end[-3] << 8 | (uint32_t)end[-2] << 16 | (uint32_t)end[-1] << 24;
}
