/* Checked sizes, huge-page blocks, arenas, scratch.  K: base */
#include <stdint.h>

#include "base/mem.h"
#include "tests/tap.h"

static int all_zero(const void *block, size_t n)
{
    const unsigned char *p = block;

    for (size_t i = 0; i < n; i++)
        if (p[i])
            return 0;
    return 1;
}

static void sizes(void)
{
    size_t n = 0;
    void *p = &n;
    char *text;

    ok(spin_mul_size(6, 7, &n) && n == 42, "multiplies sizes");
    ok(!spin_mul_size(SIZE_MAX / 2, 3, &n), "sees overflow");
    ok(spin_alloc(SIZE_MAX / 2, 3, &p) == SPIN_E_MEMORY && !p, "alloc refuses an overflowing size");
    ok(strstr(spin_last_error(), "not enough memory") != NULL, "and says so");
    ok(spin_alloc(0, 8, &p) == SPIN_OK && p, "alloc of nothing is not NULL");
    ok(spin_grow(100, 4, &p) == SPIN_OK, "grows");
    memset(p, 1, 400);
    ok(spin_grow(SIZE_MAX, 2, &p) == SPIN_E_MEMORY && ((char *)p)[399] == 1,
       "a failed growth leaves the block alone");
    free(p);
    ok(spin_alloc(1000, 3, &p) == SPIN_OK && all_zero(p, 3000), "alloc is zeroed");
    free(p);
    {
        size_t capacity = 0, at = 0;
        int *list = NULL, good = 1;

        for (; at < 1000; at++) {
            good = good && spin_room(at, &capacity, sizeof *list, (void **)&list) == SPIN_OK;
            list[at] = (int)at;
        }
        for (size_t i = 0; i < at; i++)
            good = good && list[i] == (int)i;
        ok(good && capacity == 1024, "an array doubles when it must");
        capacity = SIZE_MAX / 2;
        ok(spin_room(capacity, &capacity, sizeof *list, (void **)&list) == SPIN_E_MEMORY &&
               capacity == SIZE_MAX / 2 && list[7] == 7,
           "what cannot grow stays as it was");
        free(list);
    }
    ok(spin_strdup("ball", &text) == SPIN_OK && strcmp(text, "ball") == 0, "copies text");
    free(text);
}

static void pages(void)
{
    static const size_t size[] = {0, 1, 63, 4096, (2 << 20) - 1, 2 << 20, (2 << 20) + 1, 5 << 20};
    int aligned = 1, zero = 1, got = 1;
    void *p;

    for (size_t i = 0; i < sizeof size / sizeof size[0]; i++) {
        size_t unit = size[i] >= 2 << 20 ? 2 << 20 : 64;

        got = got && spin_pages_reserve(size[i], &p) == SPIN_OK && p;
        if (!got)
            break;
        aligned = aligned && (uintptr_t)p % unit == 0;
        zero = zero && all_zero(p, size[i]);
        memset(p, 0xff, size[i]);
        spin_pages_release(p);
    }
    ok(got, "reserves pages of any size");
    ok(aligned, "aligned to 2 MiB when that large, else to 64 bytes");
    ok(zero, "zeroed");
    ok(spin_pages_reserve(SIZE_MAX, &p) == SPIN_E_MEMORY && !p, "refuses the impossible");
    ok(spin_pages_reserve(SIZE_MAX / 2, &p) == SPIN_E_MEMORY && !p, "refuses the absurd");
    spin_pages_release(NULL);
}

static void arenas(void)
{
    struct spin_arena arena = {0};
    void *piece[300];
    int good = 1, apart = 1;

    for (size_t i = 0; i < 300; i++) {
        size_t n = i * 97 % 9000;

        good = good && spin_arena_take(&arena, n, 1, &piece[i]) == SPIN_OK &&
               (uintptr_t)piece[i] % 64 == 0 && all_zero(piece[i], n);
        memset(piece[i], (int)i, n);
    }
    for (size_t i = 0; i < 300; i++)
        for (size_t k = 0; k < i * 97 % 9000; k++)
            apart = apart && ((unsigned char *)piece[i])[k] == (unsigned char)i;
    ok(good, "pieces are zeroed and 64-byte aligned");
    ok(apart, "pieces do not overlap");
    ok(spin_arena_take(&arena, 3 << 20, 1, &piece[0]) == SPIN_OK && all_zero(piece[0], 3 << 20),
       "a piece larger than a block");
    ok(spin_arena_take(&arena, SIZE_MAX / 4, 8, &piece[0]) == SPIN_E_MEMORY && !piece[0],
       "an overflowing piece is refused");
    ok(spin_arena_take(&arena, SIZE_MAX - 32, 1, &piece[0]) == SPIN_E_MEMORY,
       "a piece of nearly all addresses is refused");
    spin_arena_free(&arena);
    ok(arena.first == NULL, "is empty after free");
    spin_arena_free(&arena);
}

static void scratch(void)
{
    struct spin_scratch s = {0};
    void *first;

    ok(spin_scratch_need(&s, 1000) == SPIN_OK && s.bytes >= 1000 && (uintptr_t)s.block % 64 == 0,
       "scratch of 1000 bytes");
    first = s.block;
    ok(spin_scratch_need(&s, 10) == SPIN_OK && s.block == first, "a smaller need keeps the block");
    ok(spin_scratch_need(&s, 5 << 20) == SPIN_OK && s.bytes >= 5 << 20, "a larger one grows it");
    memset(s.block, 1, 5 << 20);
    ok(spin_scratch_need(&s, SIZE_MAX) == SPIN_E_MEMORY && !s.block && s.bytes == 0,
       "an impossible need leaves it empty");
    spin_scratch_free(&s);
    spin_scratch_free(&s);
}

TAP_MAIN
{
    size_t before;
    void *p;

    sizes();
    pages();
    arenas();
    scratch();
    ok(spin_memory_available() > 1 << 20 && spin_memory_available() < (size_t)1 << 50,
       "knows what memory is available");
    before = spin_memory_peak();
    ok(before > 100 << 10, "knows the peak so far");
    spin_pages_reserve(96 << 20, &p);
    memset(p, 1, 96 << 20);
    ok(spin_memory_peak() >= before + (64 << 20), "the peak rises with use");
    spin_pages_release(p);
}
