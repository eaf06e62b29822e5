/* GLB with KHR_gaussian_splatting (formats/glb_scene.h): one file with a scene, one with a clip whose frames an
 * animation switches on and off, or a folder with one file per frame.
 *
 * glTF's axes are x left, y up, z forward, those of a run mostly x right, y down, z forward: --axes gltf takes
 * the half turn about z back that exporters make. */
#include <string.h>

#include "formats/glb_scene.h"
#include "importers/lib/splat_files.h"

static const struct spin_plugin_option options[] = {
    {"axes", "gltf|source",
     "axes of the file; gltf: x left, y up, z forward, half a turn about z from those of a run",
     "gltf"},
    {0},
};

static spin_status open_glb(void *self, const struct spin_map *map, struct spin_splat_file *out)
{
    struct spin_gs_glb_scene *scene = self;

    SPIN_TRY(spin_gs_glb_scene_open(map->data, map->size, scene));
    out->n_frames = scene->n_frames;
    out->sh_degree = scene->sh_degree;
    if (scene->linear)
        out->note[0] = "colours are of linear light: they are taken as they are";
    if (scene->moves)
        out->note[1] = "animations that move or fade nodes are left out";
    if (scene->others)
        out->note[2] = "meshes that are no splats are left out";
    return SPIN_OK;
}

static void info(const void *self, size_t frame, struct spin_frame_info *out)
{
    const struct spin_gs_glb_frame *f = &((const struct spin_gs_glb_scene *)self)->frame[frame];

    *out = (struct spin_frame_info){.number = f->number, .time = f->time, .n = f->n};
}

static spin_status read_glb(void *self, size_t frame, unsigned columns, struct spin_splats *out)
{
    return spin_gs_glb_scene_read(self, frame, columns, out);
}

static void close_glb(void *self) { spin_gs_glb_scene_close(self); }

static const struct spin_splat_format format = {
    .suffix = ".glb",
    .name = "GLB",
    .self_bytes = sizeof(struct spin_gs_glb_scene),
    .open = open_glb,
    .info = info,
    .read = read_glb,
    .close = close_glb,
};

static int probe(const struct spin_peek *peek)
{
    if (peek->is_folder)
        return spin_splat_files_probe(&format, peek);
    return peek->n_head >= 4 && memcmp(peek->head, "glTF", 4) == 0 ? 90 : 0;
}

static spin_status gltf_open(const char *path, const struct spin_plugin_values *values, void **self,
                             struct spin_sequence_info *sequence)
{
    static const double half_about_z[4] = {0, 0, 0, 1};
    const char *axes = spin_plugin_value(values, "axes", "gltf");

    if (strcmp(axes, "gltf") != 0 && strcmp(axes, "source") != 0)
        return spin_fail(SPIN_E_USAGE, "--axes '%s': expected gltf or source", axes);
    return spin_splat_files_open(&format, strcmp(axes, "gltf") == 0 ? half_about_z : NULL, path,
                                 self, sequence);
}

const struct spin_importer spin_importer_gltf = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "gltf",
    .summary = "GLB with KHR_gaussian_splatting: a scene, a clip, or a folder with one per frame",
    .upstream = "KhronosGroup/glTF 77b44be",
    .options = options,
    .probe = probe,
    .open = gltf_open,
    .frame = spin_splat_files_frame,
    .close = spin_splat_files_close,
};
