/* K: codebook sog threads
 * Books of numbers and palettes of vectors: what there are few of is kept, what there are many of
 * is stood for well. */
#include "formats/codebook.h"
#include "tests/tap.h"

static float draw(uint32_t *seed)
{
    *seed = *seed * 1664525u + 1013904223u;
    return (float)(*seed >> 8) / 16777216.0f;
}

static double book_error(const float *book, const float *v, size_t n)
{
    double sum = 0;

    for (size_t i = 0; i < n; i++)
        sum += pow((double)v[i] - (double)book[spin_codebook_nearest(book, v[i])], 2);
    return sqrt(sum / (double)n);
}

static void test_book(void)
{
    enum { N = 40000 };
    static float v[N], book[SPIN_CODEBOOK];
    uint32_t seed = 3;
    int rising = 1, nearest = 1;

    for (size_t i = 0; i < N; i++)
        v[i] = (float)(i % 100) * 0.125f - 3;
    ok(spin_codebook_make(v, N, book) == SPIN_OK && book_error(book, v, N) < 1e-6,
       "a hundred values are kept as they are");
    for (size_t i = 0; i < N; i++)
        v[i] = draw(&seed) + draw(&seed) + draw(&seed) + draw(&seed) - 2;
    v[7] = 40; /* one far off */
    ok(spin_codebook_make(v, N, book) == SPIN_OK, "makes a book");
    for (int k = 1; k < SPIN_CODEBOOK; k++)
        rising &= book[k] >= book[k - 1];
    ok(rising, "it rises");
    for (size_t i = 0; i < N; i += 97) {
        float best = INFINITY;

        for (int k = 0; k < SPIN_CODEBOOK; k++)
            best = fminf(best, fabsf(v[i] - book[k]));
        nearest &= fabsf(v[i] - book[spin_codebook_nearest(book, v[i])]) <= best * 1.0001f;
    }
    ok(nearest, "the nearest of it is found");
    /* 256 even steps over this range, of which the far one takes most, would be off by 0.05 */
    ok(book_error(book, v, N) < 0.004, "an error of %.4f", book_error(book, v, N));
    near(book[255], 40, 1e-4, "the far one is kept");
    ok(spin_codebook_make(v, 0, book) == SPIN_OK && book[0] == 0 && book[255] == 0,
       "a book of nothing");
    v[0] = v[1] = v[2] = -7.25f;
    ok(spin_codebook_make(v, 3, book) == SPIN_OK &&
           book[spin_codebook_nearest(book, -7.25f)] == -7.25f,
       "a book of one value");
}

static double palette_error(const float *rows, size_t n, size_t width, const uint32_t *label,
                            const float *palette)
{
    double sum = 0;

    for (size_t i = 0; i < n; i++)
        for (size_t k = 0; k < width; k++)
            sum += pow((double)rows[i * width + k] - (double)palette[label[i] * width + k], 2);
    return sqrt(sum / (double)(n * width));
}

static void test_palette(void)
{
    enum { N = 3000, WIDTH = 9, GROUPS = 40 };
    static float rows[N * WIDTH], palette[N * WIDTH], centre[GROUPS * WIDTH];
    static uint32_t label[N];
    uint32_t seed = 11;
    size_t n_used = 0;
    double before = INFINITY;

    for (size_t i = 0; i < GROUPS * WIDTH; i++)
        centre[i] = 4 * draw(&seed) - 2;
    for (size_t i = 0; i < N * WIDTH; i++)
        rows[i] = centre[i / WIDTH % GROUPS * WIDTH + i % WIDTH] + 0.02f * draw(&seed) - 0.01f;
    ok(spin_palette_make(rows, N, WIDTH, GROUPS, NULL, label, palette, &n_used) == SPIN_OK &&
           n_used == GROUPS && palette_error(rows, N, WIDTH, label, palette) < 0.02,
       "forty groups are found, error %.4f", palette_error(rows, N, WIDTH, label, palette));
    for (size_t k = 1; k <= N; k *= 4) {
        double error;

        spin_palette_make(rows, N, WIDTH, k, NULL, label, palette, &n_used);
        error = palette_error(rows, N, WIDTH, label, palette);
        ok(n_used <= k && error < before, "%zu vectors: error %.4f", k, error);
        before = error;
    }
    ok(spin_palette_make(rows, N, WIDTH, N, NULL, label, palette, &n_used) == SPIN_OK &&
           palette_error(rows, N, WIDTH, label, palette) == 0,
       "as many as rows: none is changed");
    for (size_t i = 0; i < N * WIDTH; i++)
        rows[i] = (float)(i % WIDTH);
    ok(spin_palette_make(rows, N, WIDTH, 64, NULL, label, palette, &n_used) == SPIN_OK &&
           n_used == 1 && palette_error(rows, N, WIDTH, label, palette) == 0,
       "rows that are all the same take one");
    ok(spin_palette_make(rows, 0, WIDTH, 64, NULL, label, palette, &n_used) == SPIN_OK &&
           n_used == 0,
       "no rows");
}

/* The same palette by any number of threads, of more parts than are divided at a time. */
static void test_threads(void)
{
    enum { N = 20000, WIDTH = 24, COLOURS = 4096 };
    static float rows[N * WIDTH], one[COLOURS * WIDTH], other[COLOURS * WIDTH];
    static uint32_t labels[N], other_labels[N];
    uint32_t seed = 23;
    size_t n_one, n_other;

    for (size_t i = 0; i < N * WIDTH; i++)
        rows[i] = draw(&seed) * draw(&seed) - 0.25f;
    ok(spin_palette_make(rows, N, WIDTH, COLOURS, NULL, labels, one, &n_one) == SPIN_OK &&
           n_one == COLOURS,
       "a palette without threads");
    for (int n_threads = 1; n_threads <= 7; n_threads += 3) {
        struct spin_pool *pool;

        if (spin_pool_create(n_threads, &pool) != SPIN_OK)
            exit(1);
        ok(spin_palette_make(rows, N, WIDTH, COLOURS, pool, other_labels, other, &n_other) ==
                   SPIN_OK &&
               n_other == n_one && memcmp(one, other, sizeof one) == 0 &&
               memcmp(labels, other_labels, sizeof labels) == 0,
           "the same by %d", n_threads);
        spin_pool_free(pool);
    }
}

/* Two vectors for many rows close to 0 and a few far from them: the plane between the two moves to
 * the gap. */
static void test_cut(void)
{
    enum { N = 1030, WIDTH = 3, FAR = 1000 };
    static float rows[N * WIDTH], palette[2 * WIDTH];
    static uint32_t label[N];
    uint32_t seed = 31;
    size_t n_used;
    double error;

    for (size_t i = 0; i < N * WIDTH; i++)
        rows[i] = (i < FAR * WIDTH ? 0 : 10) + draw(&seed);
    ok(spin_palette_make(rows, N, WIDTH, 2, NULL, label, palette, &n_used) == SPIN_OK &&
           n_used == 2,
       "two vectors");
    error = palette_error(rows, N, WIDTH, label, palette);
    ok(error < 0.32, "one of them for a few rows far off, error %.3f", error);
}

/* A heap of what is one group and what is many: the cuts go to the many. */
static void test_largest_first(void)
{
    enum { N = 4000, WIDTH = 3, COLOURS = 512 };
    static float rows[N * WIDTH], palette[COLOURS * WIDTH];
    static uint32_t label[N];
    uint32_t seed = 5;
    size_t n_used, tight = 0;

    for (size_t i = 0; i < N; i++) /* half of them far from the rest, and close together */
        for (size_t k = 0; k < WIDTH; k++)
            rows[i * WIDTH + k] = i % 2 ? 100 + 0.001f * draw(&seed) : draw(&seed);
    ok(spin_palette_make(rows, N, WIDTH, COLOURS, NULL, label, palette, &n_used) == SPIN_OK &&
           n_used == COLOURS,
       "all vectors are used");
    for (size_t k = 0; k < n_used; k++)
        tight += palette[k * WIDTH] > 50;
    ok(tight == 1, "of rows close together one, not %zu", tight);
}

TAP_MAIN
{
    test_book();
    test_palette();
    test_threads();
    test_largest_first();
    test_cut();
}
