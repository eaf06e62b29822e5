/* Decompresses xz files with liblzma, in parts: the memory in use grows with the actual output, and
 * does not depend on sizes in headers. */
#include "io/compress.h"

#include <lzma.h>

#include "base/base.h"
#include "io/file.h"

/* The decompressed size may be RATIO times the size of the file, plus RATIO_SLACK bytes. Networks,
 * codebooks and indices compress to about half; a larger ratio probably means a decompression bomb,
 * since xz can reach a ratio of 7000. */
#define RATIO 32
#define RATIO_SLACK ((size_t)8 << 20)
#define FIRST_PIECE ((size_t)1 << 20)
/* Limit of the decoder's own memory in bytes. Files compressed with level 9 need 65 MiB, for the
 * dictionary. */
#define DECODER_MEMORY ((uint64_t)256 << 20)

bool spin_xz_detect(const unsigned char *head, size_t n)
{
    return n >= 6 && memcmp(head,
                            "\xfd"
                            "7zXZ\0",
                            6) == 0;
}

static spin_status fail_lzma(const char *path, lzma_ret code)
{
    switch (code) {
    case LZMA_FORMAT_ERROR:
        return spin_malformed("'%s' is not an xz file", path);
    case LZMA_BUF_ERROR:
        return spin_malformed("'%s' is cut short", path);
    case LZMA_OPTIONS_ERROR:
        return spin_unsupported("'%s' uses unsupported xz options", path);
    case LZMA_MEMLIMIT_ERROR:
        return spin_unsupported("'%s' needs more than 268 MB of memory to be decompressed", path);
    case LZMA_MEM_ERROR:
        return spin_fail(SPIN_E_MEMORY, "not enough memory to unpack '%s'", path);
    default:
        return spin_malformed("'%s' is damaged: its xz data cannot be decompressed", path);
    }
}

/* Double the capacity of the block, to at most limit + 1 bytes. Output that fills even such a block
 * exceeds the limit. */
static spin_status more_room(lzma_stream *stream, size_t limit, unsigned char **block, size_t *size)
{
    size_t used = *size - stream->avail_out, larger = *size ? 2 * *size : FIRST_PIECE;

    larger = larger > limit ? limit + 1 : larger;
    SPIN_TRY(spin_grow(larger, 1, (void **)block));
    *size = larger;
    stream->next_out = *block + used;
    stream->avail_out = larger - used;
    return SPIN_OK;
}

static spin_status inflate_all(const char *path, lzma_stream *stream, size_t limit,
                               unsigned char **block, size_t *n)
{
    size_t size = 0;
    lzma_ret code = LZMA_OK;

    while (code == LZMA_OK) {
        if (stream->avail_out == 0) {
            if (size > limit)
                return spin_unsupported("'%s' unpacks to more than %zu bytes", path, limit);
            SPIN_TRY(more_room(stream, limit, block, &size));
        }
        code = lzma_code(stream, LZMA_FINISH);
    }
    if (code != LZMA_STREAM_END)
        return fail_lzma(path, code);
    *n = size - stream->avail_out;
    if (*n > limit)
        return spin_unsupported("'%s' unpacks to more than %zu bytes", path, limit);
    return SPIN_OK;
}

spin_status spin_xz_load(const char *path, size_t limit, unsigned char **out, size_t *n)
{
    lzma_stream stream = LZMA_STREAM_INIT;
    unsigned char *block = NULL;
    struct spin_map map;
    lzma_ret code;
    spin_status status;

    *out = NULL;
    *n = 0;
    SPIN_TRY(spin_map_open(path, &map));
    if (limit > RATIO_SLACK && map.size < (limit - RATIO_SLACK) / RATIO)
        limit = RATIO_SLACK + RATIO * map.size;
    code = lzma_stream_decoder(&stream, DECODER_MEMORY, LZMA_CONCATENATED);
    stream.next_in = map.data;
    stream.avail_in = map.size;
    status = code == LZMA_OK ? inflate_all(path, &stream, limit, &block, n) : fail_lzma(path, code);
    lzma_end(&stream);
    spin_map_close(&map);
    if (status != SPIN_OK) {
        free(block);
        *n = 0;
        return status;
    }
    *out = block;
    return SPIN_OK;
}
