/* CRC-32 by carry-less multiplication, after V. Gopal et al., "Fast CRC Computation for Generic
 * Polynomials Using PCLMULQDQ Instruction" (Intel, 2009): 16 bytes times x^D mod P are as good as the
 * same 16 bytes D bits further on, so that 64 bytes at a time fold into the next 64. What 16 bytes
 * remain in the end go through zlib, as do short pieces and other processors. */
#include "io/crc.h"

#include <pthread.h>
#include <stdbool.h>
#include <unistd.h>
#include <zlib.h>

#if defined(__x86_64__) && defined(__GNUC__)
#include <immintrin.h>

#define FOLDS __attribute__((target("pclmul")))
#define LEAST 256 /* bytes that are worth it */

/* Bits run backwards here. The halves of 16 bytes lie 64 bits apart, and a product is one bit short and
 * 32 bits ahead of its place: the multipliers are x^(D - 32) and x^(D + 32) mod 0x104C11DB7, turned
 * around in 32 bits, times 2. */
#define BY_512 _mm_set_epi64x(0x1c6e41596, 0x154442bd4)
#define BY_128 _mm_set_epi64x(0x0ccaa009e, 0x1751997d0)

static inline __m128i load(const unsigned char *at) { return _mm_loadu_si128((const void *)at); }

FOLDS static inline __m128i fold(__m128i sum, __m128i by, __m128i next)
{
    __m128i low = _mm_clmulepi64_si128(sum, by, 0x00), high = _mm_clmulepi64_si128(sum, by, 0x11);

    return _mm_xor_si128(_mm_xor_si128(low, high), next);
}

FOLDS static uint32_t folded(uint32_t crc, const unsigned char *at, size_t n)
{
    __m128i a = _mm_xor_si128(load(at), _mm_cvtsi32_si128((int)~crc));
    __m128i b = load(at + 16), c = load(at + 32), d = load(at + 48);
    unsigned char rest[16];

    for (at += 64, n -= 64; n >= 64; at += 64, n -= 64) {
        a = fold(a, BY_512, load(at));
        b = fold(b, BY_512, load(at + 16));
        c = fold(c, BY_512, load(at + 32));
        d = fold(d, BY_512, load(at + 48));
    }
    a = fold(fold(fold(a, BY_128, b), BY_128, c), BY_128, d);
    for (; n >= 16; at += 16, n -= 16)
        a = fold(a, BY_128, load(at));
    _mm_storeu_si128((void *)rest, a);
    /* zlib inverts what it is given: this begins with a register of zero, as the sum holds the rest. */
    crc = (uint32_t)crc32_z(0xffffffff, rest, sizeof rest);
    return (uint32_t)crc32_z(crc, at, n);
}

uint32_t spin_crc32(uint32_t crc, const void *data, size_t n)
{
    if (n >= LEAST && __builtin_cpu_supports("pclmul"))
        return folded(crc, data, n);
    return n > 0 ? (uint32_t)crc32_z(crc, data, n) : crc;
}

#else

uint32_t spin_crc32(uint32_t crc, const void *data, size_t n)
{
    return n > 0 ? (uint32_t)crc32_z(crc, data, n) : crc;
}

#endif

/* ---- By threads ------------------------------------------------------------------------------ */

enum { PARTS = 4, PART_BYTES = 2 << 20 }; /* least for a thread of its own */

struct part {
    const unsigned char *data;
    size_t size;
    uint32_t crc;
    pthread_t thread;
    bool started;
};

static void *sum_part(void *context)
{
    struct part *part = context;

    part->crc = spin_crc32(0, part->data, part->size);
    return NULL;
}

uint32_t spin_crc32_whole(const void *data, size_t size)
{
    long n_cores = sysconf(_SC_NPROCESSORS_ONLN);
    size_t n = size / PART_BYTES, most = n_cores < PARTS ? (size_t)n_cores : PARTS;
    struct part part[PARTS] = {{0}};
    uint32_t crc;

    n = n < 1 || n_cores < 1 ? 1 : n < most ? n : most;
    for (size_t i = 0; i < n; i++) {
        part[i].data = (const unsigned char *)data + size / n * i;
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
