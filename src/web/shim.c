/* Replaces base/shim.c in the browser, where libraries cannot be loaded at run time. Functions of
 * the linked libraries are looked up by name. */
#include "base/shim.h"

#include <stdio.h>
#include <string.h>
#include <webp/decode.h>
#include <webp/encode.h>
#include <zstd.h>
#include <zstd_errors.h>

#include "formats/glb_shim.h"

static const struct {
    const char *name;
    void *function;
} linked[] = {
    {"WebPConfigInitInternal", WebPConfigInitInternal},
    {"WebPConfigLosslessPreset", WebPConfigLosslessPreset},
    {"WebPPictureInitInternal", WebPPictureInitInternal},
    {"WebPPictureImportRGBA", WebPPictureImportRGBA},
    {"WebPPictureFree", WebPPictureFree},
    {"WebPEncode", WebPEncode},
    {"WebPGetInfo", WebPGetInfo},
    {"WebPInitDecoderConfigInternal", WebPInitDecoderConfigInternal},
    {"WebPDecode", WebPDecode},
    {"ZSTD_decompress", ZSTD_decompress},
    {"ZSTD_compress", ZSTD_compress},
    {"ZSTD_compressBound", ZSTD_compressBound},
    {"ZSTD_isError", ZSTD_isError},
    {"ZSTD_getErrorName", ZSTD_getErrorName},
    {"ZSTD_getErrorCode", ZSTD_getErrorCode},
};

spin_status spin_shim_load(struct spin_shim *shim, const void **table)
{
    if (strcmp(shim->symbol, SPIN_GLB_SHIM_SYMBOL) == 0)
        *table = &spin_glb_shim_table;
    if (*table)
        return SPIN_OK;
    return spin_unsupported("%s is not part of spin4d in the browser", shim->lacking);
}

spin_status spin_library_load(struct spin_library *library)
{
    for (const struct spin_library_function *f = library->function; f->name; f++) {
        size_t i = 0, n = sizeof linked / sizeof *linked;

        while (i < n && strcmp(linked[i].name, f->name) != 0)
            i++;
        if (i == n)
            return spin_unsupported(
                "%s needs the function %s, which the browser version of spin4d lacks",
                library->user, f->name);
        *(void **)f->into = linked[i].function;
    }
    return SPIN_OK;
}
