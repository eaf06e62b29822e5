/* GLB files around a document and bytes that a test has made. */
#ifndef SPIN_TESTS_FORMATS_GLB_FILES_H
#define SPIN_TESTS_FORMATS_GLB_FILES_H

#include "formats/glb.h"
#include "tests/formats/splats.h"

static void put_u32(unsigned char *at, size_t value)
{
    for (int b = 0; b < 4; b++)
        at[b] = (unsigned char)(value >> (8 * b));
}

/* A GLB of this text and these bytes. */
__attribute__((unused)) static unsigned char *make_glb(const char *json, const unsigned char *bytes,
                                                       size_t n, size_t *size)
{
    size_t n_json = (strlen(json) + 3) / 4 * 4;
    unsigned char *file = malloc(28 + n_json + n);

    *size = 28 + n_json + n;
    memcpy(file, "glTF", 4);
    put_u32(file + 4, 2);
    put_u32(file + 8, *size);
    put_u32(file + 12, n_json);
    memcpy(file + 16, "JSON", 4);
    memset(file + 20, ' ', n_json);
    memcpy(file + 20, json, strlen(json));
    put_u32(file + 20 + n_json, n);
    memcpy(file + 24 + n_json, "BIN", 4);
    memcpy(file + 28 + n_json, bytes, n);
    return file;
}

#endif
