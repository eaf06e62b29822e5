/* xz: decompressed data, bounds, and malformed files. */
#include <lzma.h>

#include "io/compress.h"
#include "tests/check.h"
#include "tests/tap.h"

static char path[300];

static void write_file(const void *bytes, size_t n)
{
    FILE *file = fopen(path, "wb");

    if (!file || fwrite(bytes, 1, n, file) != n || fclose(file) != 0)
        exit(1);
}

/* `copies` streams, one after the other. */
static size_t write_xz(const unsigned char *bytes, size_t n, int preset, int copies)
{
    size_t room = lzma_stream_buffer_bound(n), used = 0;
    unsigned char *packed = malloc(room * (size_t)copies);

    for (int i = 0; i < copies; i++) {
        if (lzma_easy_buffer_encode((uint32_t)preset, LZMA_CHECK_CRC64, NULL, bytes, n, packed,
                                    &used, room * (size_t)copies) != LZMA_OK)
            exit(1);
    }
    write_file(packed, used);
    free(packed);
    return used;
}

static void fails(size_t limit, const char *word, const char *what)
{
    unsigned char *out = NULL;
    size_t n = 7;
    spin_status status = spin_xz_load(path, limit, &out, &n);

    ok(status != SPIN_OK && !out && n == 0 && strstr(spin_last_error(), word) &&
           strstr(spin_last_error(), path),
       "%s", what);
    if (status == SPIN_OK || !strstr(spin_last_error(), word))
        printf("#   '%s'\n", status == SPIN_OK ? "" : spin_last_error());
    free(out);
}

static void same(size_t limit, const unsigned char *want, size_t n_want, const char *what)
{
    unsigned char *out = NULL;
    size_t n = 0;

    ok(spin_xz_load(path, limit, &out, &n) == SPIN_OK && n == n_want &&
           memcmp(out, want, n_want) == 0,
       "%s", what);
    free(out);
}

TAP_MAIN
{
    enum { SIZE = 5 << 20 };
    unsigned char *bytes = malloc(SIZE);
    size_t packed;

    snprintf(path, sizeof path, "%s/file.xz", check_folder());
    for (size_t i = 0; i < SIZE; i++)
        bytes[i] = (unsigned char)(i * i >> 7);
    ok(spin_xz_detect((const unsigned char *)"\xfd"
                                             "7zXZ\0",
                      6) &&
           !spin_xz_detect((const unsigned char *)"\xfd"
                                                  "7zXZ",
                           5) &&
           !spin_xz_detect((const unsigned char *)"PK\3\4..", 6),
       "knows an xz by its first six bytes");
    for (int preset = 0; preset <= 9; preset += 9) {
        write_xz(bytes, SIZE, preset, 1);
        same(SIZE, bytes, SIZE, "comes out as it went in, at the bound exactly");
        fails(SIZE - 1, "unpacks to more than", "one byte beyond the bound");
    }
    write_xz(bytes, 0, 1, 1);
    same(0, bytes, 0, "nothing is nothing");
    write_xz(bytes, SIZE / 2, 1, 2);
    fails(SIZE / 2, "unpacks to more than", "streams in a row count together");
    packed = write_xz(bytes, 500, 0, 1);
    {
        unsigned char *copy = malloc(packed);
        FILE *file = fopen(path, "rb");
        int n_short = 0, n_flipped = 0;

        if (!file || fread(copy, 1, packed, file) != packed)
            exit(1);
        fclose(file);
        for (size_t n = 0; n < packed; n++) {
            unsigned char *out = NULL;
            size_t got = 0;

            write_file(copy, n);
            n_short += spin_xz_load(path, 5000, &out, &got) == SPIN_OK;
            copy[n] ^= 4;
            write_file(copy, packed);
            n_flipped += spin_xz_load(path, 5000, &out, &got) == SPIN_OK;
            copy[n] ^= 4;
            free(out);
        }
        near(n_short, 0, 0, "no truncation is read");
        near(n_flipped, 0, 0, "no damaged byte passes the checks");
        free(copy);
    }
    write_file("", 0);
    fails(100, "cut short", "an empty file");
    write_file("plain text, not packed", 22);
    fails(100, "is not an xz file", "a file of another kind");
    remove(path);
    fails(100, "file.xz", "a missing file");
    free(bytes);
}
