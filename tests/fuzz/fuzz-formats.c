/* Any bytes as each kind of splat file: what is read is finite. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "formats/4dgs.h"
#include "formats/compressed_ply.h"
#include "formats/glb.h"
#include "formats/ksplat.h"
#include "formats/sog.h"
#include "formats/splat.h"
#include "formats/splat4d.h"
#include "formats/spz.h"
#include "io/webp.h"

#define ALL (SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES)

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static spin_status read_ply(const uint8_t *data, size_t size, struct spin_splats *out)
{
    struct spin_gs_ply file;
    struct spin_ply ply;
    spin_status status;

    SPIN_TRY(spin_ply_parse("fuzz", data, size, &ply));
    SPIN_TRY_OUT(spin_gs_ply_find(&ply, &file));
    SPIN_TRY_OUT(spin_splats_reserve(out, (size_t)file.vertex->count, ALL, file.sh_degree));
    status = spin_gs_ply_read(&file, ALL, 0, out);
out:
    spin_ply_close(&ply);
    return status;
}

static spin_status read_compressed(const uint8_t *data, size_t size, struct spin_splats *out)
{
    struct spin_compressed_ply file;
    struct spin_ply ply;
    spin_status status;

    SPIN_TRY(spin_ply_parse("fuzz", data, size, &ply));
    SPIN_TRY_OUT(spin_compressed_find(&ply, &file));
    SPIN_TRY_OUT(spin_splats_reserve(out, (size_t)file.vertex->count, ALL, file.sh_degree));
    status = spin_compressed_read(&file, ALL, out);
out:
    spin_ply_close(&ply);
    return status;
}

static spin_status read_spz(const uint8_t *data, size_t size, struct spin_splats *out)
{
    return spin_spz_read(data, size, ALL, out);
}

static spin_status read_splat(const uint8_t *data, size_t size, struct spin_splats *out)
{
    return spin_splat_read(data, size, ALL, out);
}

static spin_status read_ksplat(const uint8_t *data, size_t size, struct spin_splats *out)
{
    return spin_ksplat_read(data, size, ALL, out);
}

static spin_status read_splat4d(const uint8_t *data, size_t size, struct spin_splats *out)
{
    struct spin_splat4d clip;
    spin_status status = spin_splat4d_open(data, size, &clip);

    for (int f = 0; status == SPIN_OK && f < clip.n_frames && f < 100; f++)
        status = spin_splat4d_read(&clip, f, ALL, out);
    spin_splat4d_close(&clip);
    return status;
}

static spin_status read_4dgs(const uint8_t *data, size_t size, struct spin_splats *out)
{
    struct spin_splats_4d splats = {0};
    struct spin_4dgs info;
    size_t n_dropped;
    spin_status status = spin_4dgs_read(data, size, &info, &splats);

    if (status == SPIN_OK)
        status = spin_splats_4d_finish(&splats, &n_dropped, NULL);
    if (status == SPIN_OK)
        status = spin_splats_4d_slice(&splats, info.duration / 2, ALL, out);
    spin_splats_4d_free(&splats);
    return status;
}

/* Writes the images of a SOG with 16 splats and SH of degree 1, to which a fuzzed meta.json
 * refers. */
static const char *pictures(void)
{
    static char folder[] = "/tmp/spin-fuzz-XXXXXX";
    static bool made;

    if (made)
        return folder;
    made = mkdtemp(folder) != NULL;
    for (int p = 0; made && p < SPIN_SOG_PICTURES; p++) {
        static uint8_t pixels[4 * 192 * 4];
        unsigned char *packed = NULL;
        char path[80];
        size_t n = 0;
        FILE *file;

        for (size_t i = 0; i < sizeof pixels; i++)
            pixels[i] = (uint8_t)(i % 4 == 3                           ? 252 + i / 4 % 4
                                  : i % 4 == 1 && p == SPIN_SOG_LABELS ? 0
                                                                       : 7 * i * i + 3 * i);
        snprintf(path, sizeof path, "%s/%s", folder, spin_sog_name((enum spin_sog_picture)p));
        if (spin_webp_write(pixels, p == SPIN_SOG_CENTROIDS ? 192 : 4, 4, 0, &packed, &n) ==
                SPIN_OK &&
            (file = fopen(path, "wb"))) {
            fwrite(packed, 1, n, file);
            fclose(file);
        }
        free(packed);
    }
    return folder;
}

static spin_status read_sog(const uint8_t *data, size_t size, struct spin_splats *out)
{
    bool loose = size > 0 && data[0] == '{';

    return spin_sog_read(data, size, loose ? pictures() : NULL, ALL, out);
}

static spin_status read_glb(const uint8_t *data, size_t size, struct spin_splats *out)
{
    struct spin_gs_glb_scene scene = {0};
    spin_status status = spin_gs_glb_scene_open(data, size, &scene);

    for (size_t f = 0; status == SPIN_OK && f < scene.n_frames; f++)
        status = spin_gs_glb_scene_read(&scene, f, ALL, out);
    spin_gs_glb_scene_close(&scene);
    return status;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static spin_status (*const read[])(const uint8_t *, size_t, struct spin_splats *) = {
        read_ply,     read_compressed, read_spz, read_splat, read_ksplat,
        read_splat4d, read_4dgs,       read_sog, read_glb};
    static const char *const what[5] = {"", "", "", "", ""};

    for (size_t i = 0; i < sizeof read / sizeof *read; i++) {
        struct spin_splats s = {0};

        if (read[i](data, size, &s) == SPIN_OK &&
            spin_check_columns(what, ALL, 0, s.n, &s) != SPIN_OK)
            abort();
        spin_splats_free(&s);
    }
    return 0;
}
