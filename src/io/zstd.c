#include "io/zstd.h"

#include <dlfcn.h>
#include <pthread.h>
#include <stdlib.h>

#include "base/err.h"
#include "base/mem.h"

#define LIBRARY "libzstd.so.1"

/* Of the library's stable interface, in its words. */
static size_t (*decompress)(void *dst, size_t dst_capacity, const void *src, size_t src_size);
static size_t (*compress)(void *dst, size_t dst_capacity, const void *src, size_t src_size,
                          int level);
static size_t (*compress_bound)(size_t src_size);
static unsigned (*is_error)(size_t code);
static const char *(*error_name)(size_t code);

static pthread_once_t once = PTHREAD_ONCE_INIT;
static char failure[256]; /* why there is no library */

static void start(void)
{
    const char *name = getenv("SPIN_ZSTD");
    void *library = dlopen(name ? name : LIBRARY, RTLD_NOW | RTLD_LOCAL);

    if (!library) {
        snprintf(failure, sizeof failure, "%s", dlerror());
        return;
    }
    *(void **)&decompress = dlsym(library, "ZSTD_decompress");
    *(void **)&compress = dlsym(library, "ZSTD_compress");
    *(void **)&compress_bound = dlsym(library, "ZSTD_compressBound");
    *(void **)&is_error = dlsym(library, "ZSTD_isError");
    *(void **)&error_name = dlsym(library, "ZSTD_getErrorName");
    if (!decompress || !compress || !compress_bound || !is_error || !error_name)
        snprintf(failure, sizeof failure, "it lacks functions");
}

spin_status spin_zstd_need(void)
{
    pthread_once(&once, start);
    if (*failure)
        return spin_fail(SPIN_E_UNSUPPORTED, "zstd needs the library '" LIBRARY "': %s", failure);
    return SPIN_OK;
}

spin_status spin_zstd_read(const void *data, size_t size, void *out, size_t n_out)
{
    size_t n;

    SPIN_TRY(spin_zstd_need());
    n = decompress(out, n_out, data, size);
    if (is_error(n))
        return spin_fail(SPIN_E_MALFORMED, "damaged zstd data: %s", error_name(n));
    if (n != n_out)
        return spin_fail(SPIN_E_MALFORMED, "zstd data of %zu bytes, expected %zu", n, n_out);
    return SPIN_OK;
}

spin_status spin_zstd_write(const void *data, size_t size, int level, unsigned char **out,
                            size_t *n_room, size_t *n_out)
{
    size_t bound;

    SPIN_TRY(spin_zstd_need());
    bound = compress_bound(size);
    if (bound > *n_room) {
        SPIN_TRY(spin_grow(bound, 1, (void **)out));
        *n_room = bound;
    }
    *n_out = compress(*out, *n_room, data, size, level);
    if (is_error(*n_out))
        return spin_fail(SPIN_E_MEMORY, "zstd of %zu bytes: %s", size, error_name(*n_out));
    return SPIN_OK;
}
