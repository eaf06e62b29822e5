/* Any document and any bytes as a GLB: all that its scene shows is finite. An input that does not
 * begin as a GLB is the document and, behind a zero, the binary chunk, so that their lengths are
 * always right. */
#include <stdlib.h>
#include <string.h>

#include "formats/glb.h"

#define ALL (SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES)

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void read_glb(const uint8_t *data, size_t size)
{
    static const char *const what[5] = {"", "", "", "", ""};
    struct spin_gs_glb_scene scene = {0};
    struct spin_splats s = {0};

    if (spin_gs_glb_scene_open(data, size, &scene) == SPIN_OK) {
        for (size_t f = 0; f < scene.n_frames && f < 20; f++) {
            if (spin_gs_glb_scene_read(&scene, f, ALL, &s) == SPIN_OK &&
                (s.n != scene.frame[f].n || spin_check_columns(what, ALL, 0, s.n, &s) != SPIN_OK))
                abort();
        }
    }
    spin_gs_glb_scene_close(&scene);
    spin_splats_free(&s);
}

static void put_u32(unsigned char *at, size_t value)
{
    for (int b = 0; b < 4; b++)
        at[b] = (unsigned char)(value >> (8 * b));
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    const uint8_t *zero = memchr(data, 0, size);
    size_t n_json = zero ? (size_t)(zero - data) : size, n_chunk = zero ? size - n_json - 1 : 0;
    unsigned char *file;

    if (size >= 4 && memcmp(data, "glTF", 4) == 0) {
        read_glb(data, size);
        return 0;
    }
    file = malloc(28 + n_json + n_chunk);
    if (!file)
        abort();
    memcpy(file, "glTF\2\0\0\0", 8);
    put_u32(file + 8, 28 + n_json + n_chunk);
    put_u32(file + 12, n_json);
    memcpy(file + 16, "JSON", 4);
    memcpy(file + 20, data, n_json);
    put_u32(file + 20 + n_json, n_chunk);
    memcpy(file + 24 + n_json, "BIN", 4);
    if (n_chunk)
        memcpy(file + 28 + n_json, zero + 1, n_chunk);
    read_glb(file, 28 + n_json + n_chunk);
    free(file);
    return 0;
}
