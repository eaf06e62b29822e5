#include "formats/usd_packed.h"

#include <string.h>

#include "formats/gaussian.h"

/* The most bytes that LZ4 can decompress from one byte of a block. */
#define MOST_YIELD 255

/* Completes a length, of which the caller has read 4 bits. If all of them are set, further bytes
 * are added, up to and including the first that is not 255. Returns false if the block ends before
 * that byte. */
static bool read_length(const unsigned char **in, const unsigned char *end, size_t *length)
{
    unsigned char more = 255;

    if (*length < 15)
        return true;
    while (more == 255) {
        if (*in == end)
            return false;
        more = *(*in)++;
        *length += more;
    }
    return true;
}

/* Decompresses an LZ4 block, in which literals alternate with copies of earlier output. The block
 * ends with literals. Returns the number of decompressed bytes; SIZE_MAX on failure. */
static size_t unpack_chunk(const unsigned char *in, size_t n, unsigned char *out, size_t capacity)
{
    const unsigned char *end = in + n;
    size_t at = 0;

    while (in < end) {
        size_t literals = *in >> 4, copied = *in & 15u, back;

        in++;
        if (!read_length(&in, end, &literals) || literals > (size_t)(end - in) ||
            literals > capacity - at)
            return SIZE_MAX;
        memcpy(out + at, in, literals);
        at += literals;
        in += literals;
        if (in == end)
            return at;
        if (end - in < 2)
            return SIZE_MAX;
        back = in[0] | (size_t)in[1] << 8;
        in += 2;
        if (!read_length(&in, end, &copied) || back == 0 || back > at || copied + 4 > capacity - at)
            return SIZE_MAX;
        for (copied += 4; copied > 0; copied--, at++)
            out[at] = out[at - back];
    }
    return SIZE_MAX;
}

size_t spin_usd_unpack(const unsigned char *in, size_t n, unsigned char *out, size_t capacity)
{
    size_t at = 0;

    if (n == 0)
        return SIZE_MAX;
    if (in[0] == 0)
        return unpack_chunk(in + 1, n - 1, out, capacity);
    for (size_t chunks = in[0], i = 1; chunks > 0; chunks--) {
        size_t size = n - i >= 4 ? spin_u32_at(in + i) : SIZE_MAX, got;

        if (n - i < 4 || size > n - i - 4)
            return SIZE_MAX;
        got = unpack_chunk(in + i + 4, size, out + at, capacity - at);
        if (got == SIZE_MAX)
            return SIZE_MAX;
        at += got;
        i += 4 + size;
    }
    return at;
}

/* Decodes n integers from a decompressed block. Returns false if the block is too short. */
static bool decode_ints(const unsigned char *in, size_t n_in, size_t n, int32_t *out)
{
    size_t at = 4 + (n + 3) / 4;
    uint32_t value = 0;

    if (n_in < at)
        return false;
    for (size_t i = 0; i < n; i++) {
        unsigned code = in[4 + i / 4] >> 2 * (i % 4) & 3u;
        size_t bytes = code == 3 ? 4 : code;

        if (n_in - at < bytes)
            return false;
        value += code == 0   ? spin_u32_at(in)
                 : code == 1 ? (uint32_t)(int8_t)in[at]
                 : code == 2 ? (uint32_t)(int16_t)(in[at] | in[at + 1] << 8)
                             : spin_u32_at(in + at);
        out[i] = (int32_t)value;
        at += bytes;
    }
    return true;
}

spin_status spin_usd_unpack_ints(const unsigned char *in, size_t n_in, uint64_t n, int32_t **out)
{
    SPIN_FREED unsigned char *block = NULL;
    size_t got;

    *out = NULL;
    if (n / 4 > (uint64_t)n_in * MOST_YIELD)
        return spin_malformed("%llu integers do not fit into %zu bytes", (unsigned long long)n,
                              n_in);
    SPIN_TRY(spin_alloc(4 + (size_t)(n + 3) / 4 + 4 * (size_t)n, 1, (void **)&block));
    SPIN_TRY(spin_alloc((size_t)n + 1, sizeof **out, (void **)out));
    got = spin_usd_unpack(in, n_in, block, 4 + (size_t)(n + 3) / 4 + 4 * (size_t)n);
    if (got == SIZE_MAX || !decode_ints(block, got, (size_t)n, *out))
        return spin_malformed("compressed integers are malformed");
    return SPIN_OK;
}
