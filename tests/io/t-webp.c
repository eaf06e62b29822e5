/* K: webp sog
 * Lossless WebP: all four values of every pixel come back, also where it is transparent; and
 * without the library. */
#include "io/webp.h"
#include "tests/tap.h"

#include <sys/wait.h>
#include <unistd.h>

static void test_pictures(void)
{
    static const int sizes[][2] = {{1, 1}, {7, 3}, {64, 128}, {300, 40}};
    unsigned char *file;
    uint32_t seed = 5;
    size_t n_file = 0;

    for (size_t k = 0; k < sizeof sizes / sizeof *sizes; k++) {
        int w = sizes[k][0], h = sizes[k][1], back_w, back_h;
        size_t n = (size_t)w * (size_t)h * 4;
        uint8_t *rgba = malloc(n), *back = malloc(n);

        for (size_t i = 0; i < n; i++) {
            seed = seed * 1664525u + 1013904223u;
            rgba[i] = i % 4 == 3 && i % 3 ? 0 : (uint8_t)(seed >> 24);
        }
        ok(spin_webp_write(rgba, w, h, (int)k * 3, &file, &n_file) == SPIN_OK, "writes %dx%d: %s",
           w, h, spin_last_error());
        ok(spin_webp_size(file, n_file, &back_w, &back_h) == SPIN_OK && back_w == w &&
               back_h == h && spin_webp_read(file, n_file, w, h, back) == SPIN_OK &&
               !memcmp(rgba, back, n),
           "every value comes back");
        ok(!memcmp(file, "RIFF", 4) && !memcmp(file + 8, "WEBPVP8L", 8), "it is a lossless WebP");
        free(rgba);
        free(back);
        if (k + 1 < sizeof sizes / sizeof *sizes)
            free(file);
    }
    {
        uint8_t *back = malloc(300 * 40 * 4);
        int n_good = 0, w, h;

        for (size_t n = 0; n < n_file; n += 1 + n / 8)
            n_good += spin_webp_read(file, n, 300, 40, back) == SPIN_OK;
        ok(n_good == 0, "no truncation is read");
        ok(spin_webp_read(file, n_file, 299, 40, back) == SPIN_E_MALFORMED,
           "nor a picture of another size");
        ok(spin_webp_size("RIFFxxxxWEBP", 12, &w, &h) == SPIN_E_MALFORMED, "nor other bytes");
        ok(spin_webp_write(back, 16384, 1, 1, &file, &n_file) == SPIN_E_UNSUPPORTED,
           "a side too long");
        free(back);
    }
    free(file);
}

/* In a process of its own, as the library is looked for once. */
static void test_without(void)
{
    int status = 0;
    pid_t child = fork();

    if (child == 0) {
        setenv("SPIN_WEBP", "/no/such.so", 1);
        _exit(spin_webp_need() == SPIN_E_UNSUPPORTED && strstr(spin_last_error(), "libwebp.so.7")
                  ? 0
                  : 1);
    }
    ok(child > 0 && waitpid(child, &status, 0) == child && status == 0,
       "without the library: an error that names it");
}

TAP_MAIN
{
    test_without();
    if (spin_webp_need() != SPIN_OK) {
        skip("WebP", spin_last_error());
        return;
    }
    test_pictures();
}
