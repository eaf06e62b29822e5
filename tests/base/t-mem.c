/* Checked sizes, huge-page blocks, arenas, scratch.  K: base */
#include <stdint.h>
#include <sys/stat.h>

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
            good = good && spin_array_grow(at, &capacity, sizeof *list, (void **)&list) == SPIN_OK;
            list[at] = (int)at;
        }
        for (size_t i = 0; i < at; i++)
            good = good && list[i] == (int)i;
        ok(good && capacity == 1024, "an array doubles when it must");
        capacity = SIZE_MAX / 2;
        ok(spin_array_grow(capacity, &capacity, sizeof *list, (void **)&list) == SPIN_E_MEMORY &&
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

/* A file below a folder, whose folders are made. */
static void write_file(const char *root, const char *name, const char *text)
{
    char path[512];
    FILE *file;

    snprintf(path, sizeof path, "%s/%s", root, name);
    for (char *p = path + strlen(root) + 1; (p = strchr(p, '/')) != NULL; *p++ = '/') {
        *p = '\0';
        mkdir(path, 0777);
    }
    file = fopen(path, "w");
    if (file) {
        fputs(text, file);
        fclose(file);
    }
}

static void put_group(const char *root, const char *group, const char *limit, const char *used)
{
    char name[256];

    snprintf(name, sizeof name, "sys/fs/cgroup/%s/memory.max", group);
    write_file(root, name, limit);
    snprintf(name, sizeof name, "sys/fs/cgroup/%s/memory.current", group);
    write_file(root, name, used);
    snprintf(name, sizeof name, "sys/fs/cgroup/%s/memory.stat", group);
    write_file(root, name, "anon 1\ninactive_file 20\n");
}

static void groups(void)
{
    char root[] = "/tmp/spin-mem-XXXXXX", command[64];

    if (!mkdtemp(root)) {
        ok(0, "a folder of control groups");
        return;
    }
    ok(spin_memory_group_available(root) == UINT64_MAX, "no control groups: no limit");
    write_file(root, "proc/self/cgroup", "0::/slice/job\n");
    put_group(root, "slice", "max\n", "700\n");
    put_group(root, "slice/job", "1000\n", "300\n");
    ok(spin_memory_group_available(root) == 720,
       "the limit of the process's own group, of which cached files are free");
    put_group(root, "slice", "750\n", "700\n");
    ok(spin_memory_group_available(root) == 70, "a group above it has less left");
    put_group(root, "", "60\n", "30\n");
    ok(spin_memory_group_available(root) == 50, "and so has the topmost, as in a container");
    write_file(root, "proc/self/cgroup", "0::/not/seen\n");
    ok(spin_memory_group_available(root) == 50, "a group that is not seen is skipped");
    write_file(root, "proc/self/cgroup", "3:cpuset:/x\n4:cpu,memory:/old\n0::/not/seen\n");
    write_file(root, "sys/fs/cgroup/memory/old/memory.limit_in_bytes", "90\n");
    write_file(root, "sys/fs/cgroup/memory/old/memory.usage_in_bytes", "80\n");
    write_file(root, "sys/fs/cgroup/memory/old/memory.stat", "total_inactive_file 5\n");
    ok(spin_memory_group_available(root) == 15, "a group of version 1");
    write_file(root, "sys/fs/cgroup/memory/old/memory.usage_in_bytes", "200\n");
    ok(spin_memory_group_available(root) == 0, "a group that is over its limit gives nothing");
    snprintf(command, sizeof command, "rm -r %s", root);
    ok(system(command) == 0, "removes the folder");
}

TAP_MAIN
{
    size_t before;
    void *p;

    sizes();
    pages();
    arenas();
    scratch();
    groups();
    ok(spin_memory_available() > 1 << 20 && spin_memory_available() < (size_t)1 << 50,
       "knows what memory is available");
    before = spin_memory_peak();
    ok(before > 100 << 10, "knows the peak so far");
    spin_pages_reserve(96 << 20, &p);
    memset(p, 1, 96 << 20);
    ok(spin_memory_peak() >= before + (64 << 20), "the peak rises with use");
    spin_pages_release(p);
}
