/* Counts what a program asks of the allocator, and refuses what it is told to; preloaded by
 * tests/cli. The count goes to the file named by COUNT_CALLS when the program ends. FAIL_CALL=N
 * refuses the call number N of the program $FAIL_IN, from 1; FAIL_BYTES=N refuses every call for N
 * bytes. */
#include <errno.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

void *__libc_malloc(size_t n);
void *__libc_calloc(size_t n, size_t size);
void *__libc_realloc(void *block, size_t n);
void *__libc_memalign(size_t to, size_t n);

static atomic_llong calls, fail_call, fail_bytes;

__attribute__((constructor)) static void read_settings(void)
{
    const char *call = getenv("FAIL_CALL"), *bytes = getenv("FAIL_BYTES");

    atomic_store(&calls, 0);
    atomic_store(&fail_call, call ? atoll(call) : 0);
    atomic_store(&fail_bytes, bytes ? atoll(bytes) : 0);
}

static int refuses(size_t n)
{
    long long call = atomic_fetch_add(&calls, 1) + 1, bytes = atomic_load(&fail_bytes);

    if (call != atomic_load(&fail_call) && !(bytes > 0 && (long long)n == bytes))
        return 0;
    errno = ENOMEM;
    return 1;
}

void *malloc(size_t n) { return refuses(n) ? NULL : __libc_malloc(n); }

void *calloc(size_t n, size_t size) { return refuses(n * size) ? NULL : __libc_calloc(n, size); }

void *realloc(void *block, size_t n) { return refuses(n) ? NULL : __libc_realloc(block, n); }

void *aligned_alloc(size_t to, size_t n) { return refuses(n) ? NULL : __libc_memalign(to, n); }

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
