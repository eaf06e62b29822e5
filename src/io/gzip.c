/* Gzip files (RFC 1952), which contain a deflate stream (RFC 1951). Threads compress the blocks of
 * the stream in parallel.
 *
 * Each block uses the preceding 32 KiB as its dictionary and ends at a byte boundary (zlib's sync
 * flush, an empty stored block). The concatenated blocks are one ordinary stream, which is about
 * 0.1 % longer than one compressed as a whole. */
#include "io/compress.h"

#include <zlib.h>

#include "base/base.h"
#include "io/file.h"

#define BLOCK ((size_t)256 << 10)
#define WINDOW ((size_t)SPIN_DEFLATE_WINDOW)
#define LEAST_NOISE 4096 /* in bytes; blocks shorter than this are always compressed */

struct deflated {
    const struct spin_deflate *job;
    unsigned char *slots; /* [blocks][slot] memory for the compressed blocks */
    size_t slot;
    size_t *n_packed; /* [blocks] sizes of the compressed blocks; 0: not enough memory */
};

/* Whether Huffman coding would save less than about 1 %, judged by the entropy of single bytes. */
static bool is_noise(const unsigned char *data, size_t n)
{
    uint32_t seen[256] = {0};
    double bits = 0;

    for (size_t i = 0; i < n; i++)
        seen[data[i]]++;
    for (int b = 0; b < 256; b++)
        if (seen[b] > 0)
            bits += seen[b] * log2((double)n / seen[b]);
    return n >= LEAST_NOISE && bits > 7.9 * (double)n;
}

static void deflate_block(void *context, int task)
{
    struct deflated *g = context;
    const struct spin_deflate *job = g->job;
    size_t at = (size_t)task * BLOCK, n = job->n - at < BLOCK ? job->n - at : BLOCK;
    size_t before = at > 0 ? WINDOW : job->n_before < WINDOW ? job->n_before : WINDOW;
    int flush = job->last && at + n == job->n ? Z_FINISH : Z_SYNC_FLUSH;
    int level = job->noise_as_is && is_noise(job->data + at, n) ? 0 : job->level;
    z_stream z = {0};

    if (deflateInit2(&z, level, Z_DEFLATED, -MAX_WBITS, 8, job->rle ? Z_RLE : Z_DEFAULT_STRATEGY) !=
        Z_OK)
        return;
    if (before > 0)
        deflateSetDictionary(&z, job->data + at - before, (uInt)before);
    z.next_in = (unsigned char *)(uintptr_t)(job->data + at);
    z.avail_in = (uInt)n;
    z.next_out = g->slots + (size_t)task * g->slot;
    z.avail_out = (uInt)g->slot;
    if (deflate(&z, flush) == (flush == Z_FINISH ? Z_STREAM_END : Z_OK) && z.avail_in == 0 &&
        z.avail_out > 0)
        g->n_packed[task] = g->slot - z.avail_out;
    deflateEnd(&z);
}

spin_status spin_deflate(struct spin_pool *pool, const struct spin_deflate *job, size_t n_head,
                         size_t n_tail, struct spin_deflate_room *to)
{
    size_t n_blocks = job->n > 0 ? (job->n + BLOCK - 1) / BLOCK : 1;
    struct deflated g = {.job = job};
    unsigned char *end;
    spin_status status = SPIN_OK;

    g.slot = compressBound(BLOCK) + 64; /* compressBound() does not include the sync flush */
    if (n_head + n_blocks * g.slot + n_tail > to->n_room) {
        SPIN_TRY(spin_grow(n_head + n_blocks * g.slot + n_tail, 1, (void **)&to->data));
        to->n_room = n_head + n_blocks * g.slot + n_tail;
    }
    SPIN_TRY(spin_alloc(n_blocks, sizeof *g.n_packed, (void **)&g.n_packed));
    end = g.slots = to->data + n_head;
    spin_pool_run(pool, (int)n_blocks, deflate_block, &g);
    for (size_t i = 0; i < n_blocks; i++) {
        if (g.n_packed[i] == 0)
            status = spin_fail(SPIN_E_MEMORY, "not enough memory to compress data");
        memmove(end, g.slots + i * g.slot, g.n_packed[i]);
        end += g.n_packed[i];
    }
    free(g.n_packed);
    to->n = (size_t)(end - g.slots);
    return status;
}

spin_status spin_gzip_write(struct spin_pool *pool, int level, const void *data, size_t n,
                            unsigned char **out, size_t *n_room, size_t *n_out)
{
    /* The fields are the magic, method deflate, no flags, no date, no level, and system Unix. */
    static const unsigned char header[10] = {0x1f, 0x8b, 8, 0, 0, 0, 0, 0, 0, 3};
    const struct spin_deflate job = {
        .data = data, .n = n, .level = level, .rle = level == 1, .last = true};
    struct spin_deflate_room to = {.data = *out, .n_room = *n_room};
    uint32_t crc = spin_crc32(0, data, n);
    spin_status status = spin_deflate(pool, &job, sizeof header, 8, &to);
    unsigned char *end;

    *out = to.data;
    *n_room = to.n_room;
    SPIN_TRY(status);
    memcpy(to.data, header, sizeof header);
    end = to.data + sizeof header + to.n;
    for (int i = 0; i < 4; i++) {
        end[i] = (unsigned char)(crc >> (8 * i));
        end[4 + i] = (unsigned char)(n >> (8 * i));
    }
    *n_out = (size_t)(end + 8 - to.data);
    return SPIN_OK;
}

static spin_status inflate_all(int window_bits, const char *name, const void *data, size_t size,
                               void *out, size_t n_out, size_t *n)
{
    const unsigned char *from = data;
    unsigned char *to = out;
    z_stream z = {0};
    int result = Z_OK;

    *n = 0;
    if (inflateInit2(&z, window_bits) != Z_OK)
        return spin_fail(SPIN_E_MEMORY, "not enough memory to decompress data");
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
    if (result == Z_MEM_ERROR)
        return spin_fail(SPIN_E_MEMORY, "not enough memory to decompress data");
    if (result != Z_STREAM_END && *n < n_out)
        return spin_malformed("the %s is damaged or cut short after %zu decompressed bytes", name,
                              *n);
    return SPIN_OK;
}

spin_status spin_gzip_read(const void *data, size_t size, void *out, size_t n_out, size_t *n)
{
    return inflate_all(MAX_WBITS + 16, "gzip stream", data, size, out, n_out, n);
}

spin_status spin_zlib_read(const void *data, size_t size, void *out, size_t n_out, size_t *n)
{
    return inflate_all(MAX_WBITS, "zlib stream", data, size, out, n_out, n);
}

spin_status spin_zlib_write(const void *data, size_t n, unsigned char **out, size_t *n_out)
{
    uLongf size = compressBound((uLong)n);
    int failed;

    SPIN_TRY(spin_alloc(size, 1, (void **)out));
    failed = compress2(*out, &size, data, (uLong)n, Z_DEFAULT_COMPRESSION);
    *n_out = size;
    return failed ? spin_fail(SPIN_E_MEMORY, "not enough memory to compress %zu bytes", n)
                  : SPIN_OK;
}

uint32_t spin_gzip_length(const void *data, size_t size)
{
    const unsigned char *end = (const unsigned char *)data + size;

    if (size < 18) /* minimum size of header and trailer */
        return 0;
    return end[-4] | (uint32_t)end[-3] << 8 | (uint32_t)end[-2] << 16 | (uint32_t)end[-1] << 24;
}
