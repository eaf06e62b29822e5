/* K: zstd spz
 * Frames of zstd by hand: raw blocks and runs (RFC 8878); and without the library. */
#include "io/compress.h"
#include "tests/tap.h"

#include <sys/wait.h>
#include <unistd.h>

static const unsigned char raw[] = {0x28, 0xb5, 0x2f, 0xfd, 0x20, 5,   41,
                                    0,    0,    'h',  'e',  'l',  'l', 'o'};
static const unsigned char run[] = {0x28, 0xb5, 0x2f, 0xfd, 0x20, 200, 67, 6, 0, 'x'};

static void test_frames(void)
{
    unsigned char out[205];
    unsigned char both[sizeof raw + sizeof run];
    int n_good = 0;

    ok(spin_zstd_read(raw, sizeof raw, out, 5) == SPIN_OK && !memcmp(out, "hello", 5),
       "a raw block");
    ok(spin_zstd_read(run, sizeof run, out, 200) == SPIN_OK && out[0] == 'x' && out[199] == 'x',
       "a run");
    memcpy(both, raw, sizeof raw);
    memcpy(both + sizeof raw, run, sizeof run);
    ok(spin_zstd_read(both, sizeof both, out, 205) == SPIN_OK && out[4] == 'o' && out[5] == 'x',
       "two frames");
    ok(spin_zstd_read(raw, sizeof raw, out, 4) == SPIN_E_MALFORMED, "more than there is room for");
    ok(spin_zstd_read(raw, sizeof raw, out, 6) == SPIN_E_MALFORMED &&
           strstr(spin_last_error(), "5 bytes, expected 6"),
       "less than expected");
    for (size_t n = 0; n < sizeof raw; n++)
        n_good += spin_zstd_read(raw, n, out, 5) == SPIN_OK;
    ok(n_good == 0, "no truncation is read");
    ok(spin_zstd_read("not zstd", 8, out, 5) == SPIN_E_MALFORMED &&
           strstr(spin_last_error(), "damaged zstd"),
       "other bytes");
}

static void test_writing(void)
{
    unsigned char in[5000], back[5000], *out = NULL;
    size_t n_room = 0, n = 0, n_small = 0;

    for (size_t i = 0; i < sizeof in; i++)
        in[i] = (unsigned char)(i * i % 251 % 7);
    ok(spin_zstd_write(in, sizeof in, 1, &out, &n_room, &n) == SPIN_OK && n < sizeof in &&
           n <= n_room && spin_zstd_read(out, n, back, sizeof back) == SPIN_OK &&
           !memcmp(in, back, sizeof in),
       "what is written is read back");
    ok(spin_zstd_write(in, sizeof in, 19, &out, &n_room, &n_small) == SPIN_OK && n_small <= n,
       "a higher level is not larger");
    ok(spin_zstd_write(in, 0, 1, &out, &n_room, &n) == SPIN_OK &&
           spin_zstd_read(out, n, back, 0) == SPIN_OK,
       "nothing");
    free(out);
}

/* In a process of its own, as the library is looked for once. */
static void test_without(void)
{
    int status = 0;
    pid_t child = fork();

    if (child == 0) {
        unsigned char out[5];

        setenv("SPIN_ZSTD", "/no/such.so", 1);
        _exit(spin_zstd_read(raw, sizeof raw, out, 5) == SPIN_E_UNSUPPORTED &&
                      strstr(spin_last_error(), "libzstd.so.1") &&
                      strstr(spin_last_error(), "/no/such.so")
                  ? 0
                  : 1);
    }
    ok(child > 0 && waitpid(child, &status, 0) == child && status == 0,
       "without the library: an error that names it");
}

TAP_MAIN
{
    test_without();
    test_frames();
    test_writing();
}
