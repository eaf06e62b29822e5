/* .ksplat (formats/ksplat.h): one file, or a folder with one per frame. The format has no magic, so only its name
 * tells it. */
#include "formats/ksplat.h"
#include "importers/lib/splat_files.h"

struct file {
    const struct spin_map *map; /* borrowed */
    struct spin_ksplat header;
};

static spin_status open_ksplat(void *self, const struct spin_map *map, struct spin_splat_file *out)
{
    struct file *f = self;

    f->map = map;
    SPIN_TRY(spin_ksplat_peek(map->data, map->size, &f->header));
    out->sh_degree = f->header.sh_degree;
    return SPIN_OK;
}

static void info(const void *self, size_t frame, struct spin_frame_info *out)
{
    const struct file *f = self;

    (void)frame;
    *out = (struct spin_frame_info){.number = -1, .n = f->header.n};
}

static spin_status read_ksplat(void *self, size_t frame, unsigned columns, struct spin_splats *out)
{
    const struct file *f = self;

    (void)frame;
    return spin_ksplat_read(f->map->data, f->map->size, columns, out);
}

static void close_ksplat(void *self) { (void)self; }

static const struct spin_splat_format format = {
    .suffix = ".ksplat",
    .name = ".ksplat",
    .self_bytes = sizeof(struct file),
    .open = open_ksplat,
    .info = info,
    .read = read_ksplat,
    .close = close_ksplat,
};

static int probe(const struct spin_peek *peek) { return spin_splat_files_probe(&format, peek); }

static spin_status ksplat_open(const char *path, const struct spin_plugin_values *values,
                               void **self, struct spin_sequence_info *sequence)
{
    (void)values;
    return spin_splat_files_open(&format, NULL, path, self, sequence);
}

const struct spin_importer spin_importer_ksplat = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "ksplat",
    .summary = ".ksplat files, levels 0 to 2: one, or a folder with one per frame",
    .upstream = "mkkellogg/GaussianSplats3D",
    .probe = probe,
    .open = ksplat_open,
    .frame = spin_splat_files_frame,
    .close = spin_splat_files_close,
};
