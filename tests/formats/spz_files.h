/* SPZ files around streams that a test has made: a gzip, or version 4 with streams of zstd that are
 * written without a compressor, as raw blocks or as runs of one byte (RFC 8878, 3.1.1.2). */
#ifndef SPIN_TESTS_FORMATS_SPZ_FILES_H
#define SPIN_TESTS_FORMATS_SPZ_FILES_H

#include "formats/spz.h"
#include "io/compress.h"
#include "tests/formats/splats.h"

/* A gzip of these bytes. */
__attribute__((unused)) static unsigned char *pack(const unsigned char *bytes, size_t n,
                                                   size_t *n_packed)
{
    unsigned char *packed = NULL;
    size_t n_room = 0;

    if (spin_gzip_write(NULL, 1, bytes, n, &packed, &n_room, n_packed) != SPIN_OK)
        exit(1);
    return packed;
}

/* A frame of n bytes: blocks of 64 KiB at most, raw (type 0) or runs of their first byte (type 1).
 * Returns its end. */
static unsigned char *put_zstd(unsigned char *to, const unsigned char *from, size_t n, int type)
{
    static const unsigned char magic[4] = {0x28, 0xb5, 0x2f, 0xfd};

    memcpy(to, magic, 4);
    to[4] = 0xa0; /* one segment, its length in four bytes */
    to += 5;
    for (int b = 0; b < 4; b++)
        *to++ = (unsigned char)(n >> 8 * b);
    do {
        size_t size = n < 65536 ? n : 65536, kept = type && size > 1 ? 1 : size;
        uint32_t head = (uint32_t)size << 3 | (uint32_t)(type << 1) | (n == size);

        for (int b = 0; b < 3; b++)
            *to++ = (unsigned char)(head >> 8 * b);
        memcpy(to, from, kept);
        to += kept;
        from += size;
        n -= size;
    } while (n > 0);
    return to;
}

/* Version 4 of what version 3 packs: its header of 16 bytes and its streams. */
__attribute__((unused)) static unsigned char *make_spz_4_by(const unsigned char *packed,
                                                            const unsigned char *extensions,
                                                            size_t n_extensions, int type,
                                                            size_t *size)
{
    size_t n = spin_u32_at(packed + 8), n_rest = spin_n_rest(packed[12]), toc = 32 + n_extensions;
    const size_t width[6] = {9, 1, 3, 3, 4, n_rest};
    size_t room = 4096 + n_extensions + n * (20 + n_rest) + n * (20 + n_rest) / 8192;
    unsigned char *file = calloc(room, 1), *at, *entry = file + toc;
    int n_streams = n == 0 ? 0 : n_rest ? 6 : 5;

    memcpy(file, packed, SPIN_SPZ_HEADER);
    file[4] = 4;
    file[15] = (unsigned char)n_streams;
    memcpy(file + 16, &(uint32_t){(uint32_t)toc}, 4);
    spin_little_endian(file + 16, 1);
    if (n_extensions)
        memcpy(file + 32, extensions, n_extensions);
    packed += SPIN_SPZ_HEADER;
    at = entry + 16 * n_streams;
    for (int i = 0; i < n_streams; i++, entry += 16) {
        size_t n_bytes = n * width[i];
        unsigned char *end = put_zstd(at, packed, n_bytes, type);

        for (int b = 0; b < 8; b++) {
            entry[b] = (unsigned char)((uint64_t)(end - at) >> 8 * b);
            entry[8 + b] = (unsigned char)((uint64_t)n_bytes >> 8 * b);
        }
        packed += n_bytes;
        at = end;
    }
    *size = (size_t)(at - file);
    return file;
}

__attribute__((unused)) static unsigned char *make_spz_4(const unsigned char *packed,
                                                         const unsigned char *extensions,
                                                         size_t n_extensions, size_t *size)
{
    return make_spz_4_by(packed, extensions, n_extensions, 0, size);
}

/* Each block becomes a run of its first byte. */
__attribute__((unused)) static unsigned char *make_spz_4_of_runs(const unsigned char *packed,
                                                                 size_t *size)
{
    return make_spz_4_by(packed, NULL, 0, 1, size);
}

#endif
