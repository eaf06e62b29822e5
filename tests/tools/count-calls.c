/* Counts what a program asks of the allocator; preloaded by tests/cli/t2003-steady.sh. The count goes to
 * the file named by COUNT_CALLS when the program ends. */
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>

void *__libc_malloc(size_t n);
void *__libc_calloc(size_t n, size_t size);
void *__libc_realloc(void *block, size_t n);
void *__libc_memalign(size_t to, size_t n);

static atomic_llong calls;

void *malloc(size_t n)
{
    atomic_fetch_add(&calls, 1);
    return __libc_malloc(n);
}

void *calloc(size_t n, size_t size)
{
    atomic_fetch_add(&calls, 1);
    return __libc_calloc(n, size);
}

void *realloc(void *block, size_t n)
{
    atomic_fetch_add(&calls, 1);
    return __libc_realloc(block, n);
}

void *aligned_alloc(size_t to, size_t n)
{
    atomic_fetch_add(&calls, 1);
    return __libc_memalign(to, n);
}

__attribute__((destructor)) static void tell(void)
{
    const char *path = getenv("COUNT_CALLS");
    long long n = atomic_load(&calls);
    FILE *file = path ? fopen(path, "w") : NULL;

    if (file) {
        fprintf(file, "%lld\n", n);
        fclose(file);
    }
}
