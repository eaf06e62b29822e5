/* The bytes of the values in a USD crate, which is little-endian on every machine.
 * K: usd usdc formats endian */
#include <string.h>

#include "base/err.h"
#include "formats/usd_crate_write.h"
#include "tests/check.h"
#include "tests/tap.h"

#define BYTES(...)                                                                                 \
    (const unsigned char[]) { __VA_ARGS__ }

static unsigned char file[4096];
static size_t n_file;

/* Checks the n bytes at the offset in the payload of a word. */
static void check_bytes(uint64_t word, size_t n, const unsigned char *want, const char *what)
{
    size_t at = (size_t)(word & 0xffffffffffffu);

    ok(at + n <= n_file && memcmp(file + at, want, n) == 0, "%s", what);
}

TAP_MAIN
{
    static const float floats[3] = {1, -2, 0.5f};
    static const uint16_t halves[4] = {0x3c00, 0x4001, 0, 0x8000};
    static const double matrix[16] = {0.1, 1}, time[2] = {1, 2};
    struct spin_usdc_writer w = {.at = 0};
    struct spin_out out = {0};
    char path[600];
    uint64_t array, half, value, number, samples, whole, tokens, word[2];
    FILE *in;

    snprintf(path, sizeof path, "%s/a.usdc", check_folder());
    ok(spin_out_open(path, false, &out) == SPIN_OK, "opens: %s", spin_last_error());
    spin_usdc_begin(&w, &out);
    array = spin_usdc_array(&w, SPIN_USDC_FLOAT3, 1, floats, sizeof floats);
    half = spin_usdc_array(&w, SPIN_USDC_QUATH, 1, halves, sizeof halves);
    value = spin_usdc_value(&w, SPIN_USDC_MATRIX4D, matrix, sizeof matrix);
    number = spin_usdc_double(&w, 0.1);
    whole = spin_usdc_double(&w, 24);
    word[0] = spin_usdc_float(1);
    word[1] = spin_usdc_int(-2);
    samples = spin_usdc_samples(&w, time, word, 2);
    spin_usdc_token(&w, "a");
    tokens = spin_usdc_tokens(&w, "b");
    spin_usdc_attribute(&w, spin_usdc_prim(&w, 0, "Scope", "scope"), "float3[]", "x", true);
    ok(spin_usdc_end(&w) == SPIN_OK && spin_out_commit(&out) == SPIN_OK, "writes: %s",
       spin_last_error());
    spin_usdc_free(&w);
    in = fopen(path, "rb");
    n_file = in ? fread(file, 1, sizeof file, in) : 0;
    if (in)
        fclose(in);
    ok(n_file > 88 && n_file < sizeof file && memcmp(file, "PXR-USDC", 8) == 0, "%zu bytes",
       n_file);
    check_bytes(array, 20,
                BYTES(1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0x80, 0x3f, 0, 0, 0, 0xc0, 0, 0, 0, 0x3f),
                "an array of floats");
    check_bytes(half, 16, BYTES(1, 0, 0, 0, 0, 0, 0, 0, 0, 0x3c, 1, 0x40, 0, 0, 0, 0x80),
                "an array of halves");
    check_bytes(
        value, 17,
        BYTES(0x9a, 0x99, 0x99, 0x99, 0x99, 0x99, 0xb9, 0x3f, 0, 0, 0, 0, 0, 0, 0xf0, 0x3f, 0),
        "a matrix of doubles");
    check_bytes(number, 8, BYTES(0x9a, 0x99, 0x99, 0x99, 0x99, 0x99, 0xb9, 0x3f), "a double");
    ok((whole & 0xffffffff) == 0x41c00000, "a double that is a float");
    check_bytes(samples, 8, BYTES(8, 0, 0, 0, 0, 0, 0, 0), "samples");
    check_bytes(
        samples - 24, 24,
        BYTES(2, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0xf0, 0x3f, 0, 0, 0, 0, 0, 0, 0, 0x40),
        "and their times");
    check_bytes(samples + 24, 16, BYTES(2, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0x80, 0x3f, 0, 0, 8, 0x40),
                "and values");
    check_bytes(tokens, 12, BYTES(1, 0, 0, 0, 0, 0, 0, 0, 3, 0, 0, 0), "an array of tokens");
}
