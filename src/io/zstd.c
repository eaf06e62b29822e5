#include "io/compress.h"

#include <zstd.h>
#include <zstd_errors.h>

#include "base/mem.h"
#include "base/shim.h"

static __typeof__(ZSTD_decompress) *decompress;
static __typeof__(ZSTD_compress) *compress;
static __typeof__(ZSTD_compressBound) *compress_bound;
static __typeof__(ZSTD_isError) *is_error;
static __typeof__(ZSTD_getErrorName) *error_name;
static __typeof__(ZSTD_getErrorCode) *error_code;

spin_status spin_zstd_need(void)
{
    static const struct spin_library_function functions[] = {
        {"ZSTD_decompress", &decompress},
        {"ZSTD_compress", &compress},
        {"ZSTD_compressBound", &compress_bound},
        {"ZSTD_isError", &is_error},
        {"ZSTD_getErrorName", &error_name},
        {"ZSTD_getErrorCode", &error_code},
        {0}};
    static struct spin_library library = {"libzstd.so.1", "SPIN_ZSTD", "zstd",
                                          functions,      false,       ""};

    return spin_library_load(&library);
}

spin_status spin_zstd_read(const void *data, size_t size, void *out, size_t n_out)
{
    size_t n;

    SPIN_TRY(spin_zstd_need());
    n = decompress(out, n_out, data, size);
    if (is_error(n) && error_code(n) == ZSTD_error_memory_allocation)
        return spin_fail(SPIN_E_MEMORY, "not enough memory to unpack zstd data");
    if (is_error(n))
        return spin_malformed("damaged zstd data: %s", error_name(n));
    if (n != n_out)
        return spin_malformed("zstd data expand to %zu bytes, expected %zu", n, n_out);
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
        return spin_fail(SPIN_E_MEMORY, "not enough memory to compress %zu bytes with zstd: %s",
                         size, error_name(*n_out));
    return SPIN_OK;
}
