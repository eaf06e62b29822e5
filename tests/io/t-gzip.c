/* K: gzip spz threads */
#include <zlib.h>

#include "io/compress.h"
#include "tests/check.h"
#include "tests/tap.h"

/* Half of it says nothing new, half is noise. */
static unsigned char *make_bytes(size_t n)
{
    unsigned char *bytes = malloc(n + 1);
    uint32_t seed = 7;

    for (size_t i = 0; i < n; i++) {
        seed = seed * 1664525u + 1013904223u;
        bytes[i] = i / 5000 % 2 ? (unsigned char)(seed >> 24) : (unsigned char)(i / 100);
    }
    return bytes;
}

/* One member, no more and no less than what was written. */
static int reads_back(unsigned char *packed, size_t n_packed, const unsigned char *want, size_t n)
{
    unsigned char *got = malloc(n + 16);
    z_stream z = {.next_in = packed, .avail_in = (uInt)n_packed, .next_out = got};
    int good;

    if (inflateInit2(&z, 15 + 16) != Z_OK)
        return 0;
    z.avail_out = (uInt)(n + 16);
    good = inflate(&z, Z_FINISH) == Z_STREAM_END && z.total_out == n && z.avail_in == 0 &&
           memcmp(got, want, n) == 0;
    inflateEnd(&z);
    free(got);
    return good;
}

TAP_MAIN
{
    static const size_t sizes[] = {0, 1, 32767, 262143, 262144, 262145, 4194304, 4194305, 9000001};
    const size_t largest = 9000001;
    unsigned char *bytes = make_bytes(largest), *one = NULL, *four = NULL;
    size_t n_one = 0, n_four = 0, room_one = 0, room_four = 0;
    struct spin_pool *pool = NULL;
    uLongf n_packed = compressBound((uLong)largest);
    unsigned char *packed = malloc(n_packed);

    ok(spin_pool_create(4, &pool) == SPIN_OK, "four threads");
    for (size_t i = 0; i < sizeof sizes / sizeof sizes[0]; i++) {
        ok(spin_gzip_write(NULL, 6, bytes, sizes[i], &one, &room_one, &n_one) == SPIN_OK &&
               reads_back(one, n_one, bytes, sizes[i]),
           "%zu bytes read back", sizes[i]);
        ok(spin_gzip_write(pool, 6, bytes, sizes[i], &four, &room_four, &n_four) == SPIN_OK &&
               n_one == n_four && memcmp(one, four, n_one) == 0,
           "the same whatever the threads");
    }
    compress2(packed, &n_packed, bytes, (uLong)largest, 6);
    ok((double)n_one < 1.01 * (double)n_packed, "not one percent longer than in one go (%zu, %lu)",
       n_one, n_packed);
    spin_pool_free(pool);
    free(one);
    free(four);
    free(bytes);
    free(packed);
}
