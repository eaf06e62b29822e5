/* Memory that runs out when a test says so: this program's malloc() and its kin, which shared
 * objects call as well. Where a sanitiser has an allocator of its own, or the C library is not
 * glibc, WITHOUT_MEMORY() runs nothing. */
#ifndef SPIN_TESTS_NO_MEMORY_H
#define SPIN_TESTS_NO_MEMORY_H

#include <errno.h>
#include <stdatomic.h>
#include <string.h>

#include "spin.h"
#include "tests/tap.h"

static atomic_long calls_until_none; /* 1: the next call gets nothing; 0: all get something */

#if defined(__GLIBC__) && !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
enum { CAN_RUN_OUT = 1 };

void *__libc_malloc(size_t n);
void *__libc_calloc(size_t n, size_t size);
void *__libc_realloc(void *block, size_t n);
void *__libc_memalign(size_t to, size_t n);

static int runs_out(void)
{
    if (atomic_load(&calls_until_none) == 0 || atomic_fetch_sub(&calls_until_none, 1) != 1)
        return 0;
    errno = ENOMEM;
    return 1;
}

void *malloc(size_t n) { return runs_out() ? NULL : __libc_malloc(n); }
void *calloc(size_t n, size_t size) { return runs_out() ? NULL : __libc_calloc(n, size); }
void *realloc(void *block, size_t n) { return runs_out() ? NULL : __libc_realloc(block, n); }
void *aligned_alloc(size_t to, size_t n) { return runs_out() ? NULL : __libc_memalign(to, n); }
#else
enum { CAN_RUN_OUT = 0 };
#endif

/* call(context) with each of its allocations missing once, until none is, or the first `most` of
 * them. Each failure must be of memory and say so; a call may also do without. All calls must do
 * the same. */
__attribute__((unused)) static void without_memory(spin_status (*call)(void *context),
                                                   void *context, const char *what, long most)
{
    spin_status status = SPIN_OK;
    int good = 1, n_failed = 0;
    long n = 0, left = 0;

    if (!CAN_RUN_OUT) {
        skip(what, "another allocator");
        return;
    }
    status = call(context); /* libraries are loaded, tables made */
    while (good && status == SPIN_OK && left <= 0 && n < most) {
        atomic_store(&calls_until_none, ++n);
        status = call(context);
        left = atomic_exchange(&calls_until_none, 0);
        if (status == SPIN_OK)
            continue;
        n_failed++;
        good = status == SPIN_E_MEMORY && strstr(spin_last_error(), "memory");
        if (!good)
            printf("# allocation %ld: %d %s\n", n, (int)status, spin_last_error());
        status = SPIN_OK;
    }
    ok(good && n_failed > 0, "%s: %d of its %ld allocations missing are told as such", what,
       n_failed, n - 1);
    ok(call(context) == SPIN_OK, "%s: and then it works: %s", what, spin_last_error());
}

#endif
