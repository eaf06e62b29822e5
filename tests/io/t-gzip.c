/* K: gzip spz threads */
#include <zlib.h>

#include "base/log.h"
#include "io/gzip.h"
#include "tests/check.h"
#include "tests/tap.h"

static char path[2][4096];

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

static int write_file(struct spin_gzip *gzip, const char *name, const unsigned char *bytes,
                      size_t n, size_t piece)
{
    struct spin_out out;
    spin_status status;

    if (spin_out_open(name, true, &out) != SPIN_OK)
        return 0;
    status = spin_gzip_begin(gzip, &out);
    for (size_t at = 0; status == SPIN_OK && at < n; at += piece)
        status = spin_gzip_write(gzip, bytes + at, n - at < piece ? n - at : piece);
    if (status == SPIN_OK)
        status = spin_gzip_end(gzip);
    if (status == SPIN_OK)
        return spin_out_commit(&out) == SPIN_OK;
    spin_out_abandon(&out);
    return 0;
}

/* One member, no more and no less than what was written. */
static int reads_back(const char *name, const unsigned char *want, size_t n)
{
    struct spin_map map;
    unsigned char *got = malloc(n + 16);
    z_stream z = {0};
    int good;

    if (spin_map_open(name, &map) != SPIN_OK || inflateInit2(&z, 15 + 16) != Z_OK)
        return 0;
    z.next_in = (unsigned char *)(uintptr_t)map.data;
    z.avail_in = (uInt)map.size;
    z.next_out = got;
    z.avail_out = (uInt)(n + 16);
    good = inflate(&z, Z_FINISH) == Z_STREAM_END && z.total_out == n && z.avail_in == 0 &&
           memcmp(got, want, n) == 0;
    inflateEnd(&z);
    spin_map_close(&map);
    free(got);
    return good;
}

static size_t size_of(const char *name)
{
    struct spin_map map;
    size_t n = spin_map_open(name, &map) == SPIN_OK ? map.size : 0;

    spin_map_close(&map);
    return n;
}

TAP_MAIN
{
    static const size_t sizes[] = {0, 1, 32767, 262143, 262144, 262145, 4194304, 4194305, 9000001};
    const size_t largest = 9000001;
    unsigned char *bytes = make_bytes(largest);
    struct spin_gzip *one = NULL, *four = NULL;
    uLongf n_packed = compressBound((uLong)largest);
    unsigned char *packed = malloc(n_packed);

    spin_log_set_level(-2);
    for (int i = 0; i < 2; i++)
        snprintf(path[i], sizeof path[i], "%s/%d.gz", check_folder(), i);
    ok(spin_gzip_create(6, 1, &one) == SPIN_OK && spin_gzip_create(6, 4, &four) == SPIN_OK,
       "is made with one thread and with four");
    for (size_t i = 0; i < sizeof sizes / sizeof sizes[0]; i++) {
        struct spin_map a, b;

        ok(write_file(one, path[0], bytes, sizes[i], 4097) &&
               write_file(four, path[1], bytes, sizes[i], 1 << 20) &&
               reads_back(path[0], bytes, sizes[i]),
           "%zu bytes read back", sizes[i]);
        spin_map_open(path[0], &a);
        spin_map_open(path[1], &b);
        ok(a.size == b.size && memcmp(a.data, b.data, a.size) == 0,
           "the same whatever the threads and the pieces");
        spin_map_close(&a);
        spin_map_close(&b);
    }
    compress2(packed, &n_packed, bytes, (uLong)largest, 6);
    ok((double)size_of(path[0]) < 1.01 * (double)n_packed,
       "not one percent longer than in one go (%zu, %lu)", size_of(path[0]), n_packed);
    spin_gzip_free(one);
    spin_gzip_free(four);
    spin_gzip_free(NULL);
    free(bytes);
    free(packed);
}
