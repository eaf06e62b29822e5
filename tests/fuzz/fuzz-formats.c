/* Any bytes as each kind of splat file: what is read is finite. */
#include <stdlib.h>
#include <string.h>

#include "formats/compressed_ply.h"
#include "formats/glb_scene.h"
#include "formats/splat.h"
#include "formats/spz.h"

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
        read_ply, read_compressed, read_spz, read_splat, read_glb};
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
