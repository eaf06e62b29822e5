/* SOG (formats/sog.h): one file, a folder with one per frame, or the loose files of one, by their folder or their
 * meta.json. */
#include <stdlib.h>
#include <string.h>

#include "formats/sog.h"
#include "importers/lib/splat_files.h"
#include "io/zip.h"

#define META "meta.json"

struct file {
    const struct spin_map *map; /* borrowed */
    char *folder;               /* of loose files, or NULL */
    struct spin_sog sog;
};

static spin_status open_sog(void *self, const struct spin_map *map, struct spin_splat_file *out)
{
    struct file *f = self;

    f->map = map;
    if (spin_file_has_suffix(out->path, ".json"))
        SPIN_TRY(spin_path_folder(out->path, &f->folder));
    SPIN_TRY(spin_sog_peek(map->data, map->size, f->folder, &f->sog));
    out->sh_degree = f->sog.sh_degree;
    out->antialias = f->sog.antialias;
    return SPIN_OK;
}

static void info(const void *self, size_t frame, struct spin_frame_info *out)
{
    const struct file *f = self;

    (void)frame;
    *out = (struct spin_frame_info){.number = -1, .n = f->sog.n};
}

static spin_status read_sog(void *self, size_t frame, unsigned columns, struct spin_splats *out)
{
    const struct file *f = self;

    (void)frame;
    return spin_sog_read(f->map->data, f->map->size, f->folder, columns, out);
}

static void close_sog(void *self) { free(((struct file *)self)->folder); }

static const struct spin_splat_format format = {
    .suffix = ".sog",
    .name = "SOG",
    .self_bytes = sizeof(struct file),
    .open = open_sog,
    .info = info,
    .read = read_sog,
    .close = close_sog,
};

/* A zip with pictures and a meta.json, the folder of both, or a meta.json that says where places lie. */
static int probe(const struct spin_peek *peek)
{
    bool meta = false, picture = false;

    for (size_t i = 0; peek->is_folder && peek->names && peek->names[i]; i++) {
        meta = meta || strcmp(peek->names[i], META) == 0;
        picture = picture || strcmp(peek->names[i], "means_l.webp") == 0;
    }
    if (!peek->is_folder && spin_file_has_suffix(peek->path, ".json")) {
        meta = memmem(peek->head, peek->n_head, "\"means\"", 7) != NULL;
        picture = memmem(peek->head, peek->n_head, "\"mins\"", 6) != NULL;
    } else if (spin_zip_looks_like(peek->head, peek->n_head)) {
        meta = strstr(peek->tail_names, META) != NULL;
        picture = strstr(peek->tail_names, ".webp") != NULL;
    }
    return meta && picture ? 90 : spin_splat_files_probe(&format, peek);
}

static spin_status sog_open(const char *path, const struct spin_plugin_values *values, void **self,
                            struct spin_sequence_info *sequence)
{
    char *meta = NULL;
    spin_status status;

    (void)values;
    SPIN_TRY(spin_path_join(path, META, &meta));
    status =
        spin_splat_files_open(&format, NULL, spin_path_exists(meta) ? meta : path, self, sequence);
    free(meta);
    return status;
}

const struct spin_importer spin_importer_sog = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "sog",
    .summary = "SOG, versions 1 and 2: one file or meta.json, or a folder with one per frame",
    .upstream = "playcanvas/splat-transform 0f60b17",
    .probe = probe,
    .open = sog_open,
    .frame = spin_splat_files_frame,
    .close = spin_splat_files_close,
};
