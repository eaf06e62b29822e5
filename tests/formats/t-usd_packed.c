/* Compressed blocks and integers of USD crates: chunks, copies, all widths, and damage.
 * K: usd usdc formats lz4 */
#include <string.h>

#include "formats/usd_packed.h"
#include "tests/tap.h"

#define BYTES(...)                                                                                 \
    (const unsigned char[]) { __VA_ARGS__ }

static bool unpacks(const unsigned char *in, size_t n, const char *want)
{
    unsigned char out[64];
    size_t got = spin_usd_unpack(in, n, out, sizeof out);

    return got == strlen(want) && memcmp(out, want, got) == 0;
}

static void test_blocks(void)
{
    unsigned char out[600], same[600];

    ok(unpacks(BYTES(0, 0x30, 'a', 'b', 'c'), 5, "abc"), "literals");
    ok(unpacks(BYTES(0, 0x22, 'a', 'b', 2, 0, 0x10, 'c'), 8, "ababababc"), "a copy of itself");
    ok(unpacks(BYTES(2, 3, 0, 0, 0, 0x20, 'a', 'b', 2, 0, 0, 0, 0x10, 'c'), 14, "abc"),
       "two chunks");
    memset(same, 'x', sizeof same);
    ok(spin_usd_unpack(BYTES(0, 0x1f, 'x', 1, 0, 255, 255, 70, 0x00), 9, out, sizeof out) == 600 &&
           memcmp(out, same, 600) == 0,
       "a length of several bytes");
    ok(spin_usd_unpack(BYTES(0, 0x1f, 'x', 1, 0, 255, 255, 70, 0x00), 9, out, 599) == SIZE_MAX,
       "which does not fit");
}

static void test_damage(void)
{
    static const struct {
        unsigned char in[12];
        size_t n;
        const char *what;
    } bad[] = {
        {{0}, 0, "nothing"},
        {{0}, 1, "no block"},
        {{0, 0x30, 'a', 'b'}, 4, "a literal that is missing"},
        {{0, 0xf0, 255}, 3, "a length that does not end"},
        {{0, 0x20, 'a', 'b', 2}, 5, "half an offset"},
        {{0, 0x20, 'a', 'b', 3, 0, 0}, 7, "a copy from before the beginning"},
        {{0, 0x20, 'a', 'b', 0, 0, 0}, 7, "a copy from itself"},
        {{0, 0x20, 'a', 'b', 1, 0}, 6, "a block that ends with a copy"},
        {{1, 9, 0, 0, 0, 0x10, 'a'}, 7, "a chunk that is missing"},
        {{2, 2, 0, 0, 0, 0x10, 'a', 2, 0}, 9, "half a size"},
        {{1, 2, 0, 0, 0, 0x20, 'a'}, 7, "a chunk that is damaged"},
    };
    unsigned char out[64];

    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++)
        ok(spin_usd_unpack(bad[i].in, bad[i].n, out, sizeof out) == SIZE_MAX, "%s", bad[i].what);
}

static void test_ints(void)
{
    /* common 5; codes 0 1 2 3, then 1; differences 5, -1, 300, -70000, 127 */
    static const unsigned char in[] = {0,    0xe0, 5, 0,    0,    0,    0xe4, 1,
                                       0xff, 0x2c, 1, 0x90, 0xee, 0xfe, 0xff, 0x7f};
    static const int32_t want[] = {5, 4, 304, -69696, -69569};
    int32_t *out = NULL;

    ok(spin_usd_unpack_ints(in, sizeof in, 5, &out) == SPIN_OK &&
           memcmp(out, want, sizeof want) == 0,
       "differences of 0, 1, 2 and 4 bytes");
    free(out);
    ok(spin_usd_unpack_ints(in, sizeof in, 6, &out) == SPIN_OK && out[5] == want[4] + 5,
       "the most frequent difference again");
    free(out);
    ok(spin_usd_unpack_ints(BYTES(0, 0x40, 5, 0, 0, 0), 6, 0, &out) == SPIN_OK, "no integers");
    free(out);
    ok(spin_usd_unpack_ints(in, sizeof in - 1, 5, &out) == SPIN_E_MALFORMED, "a block that is cut");
    free(out);
    ok(spin_usd_unpack_ints(BYTES(0, 0x50, 5, 0, 0, 0, 0x0c), 7, 2, &out) == SPIN_E_MALFORMED,
       "a difference that is missing");
    free(out);
    ok(spin_usd_unpack_ints(BYTES(0, 0x40, 5, 0, 0, 0), 6, 1, &out) == SPIN_E_MALFORMED,
       "codes that are missing");
    free(out);
    ok(spin_usd_unpack_ints(in, sizeof in, 1ull << 40, &out) == SPIN_E_MALFORMED && !out,
       "more integers than a block can have");
}

TAP_MAIN
{
    test_blocks();
    test_damage();
    test_ints();
}
