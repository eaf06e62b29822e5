/* .splat (formats/splat.h): one file, or a folder with one per frame. The format has no header, so only its
 * name tells it. */
#include "formats/splat.h"
#include "importers/lib/splat_files.h"

static spin_status open_splat(void *self, const struct spin_map *map, struct spin_splat_file *out)
{
    const struct spin_map **file = self;

    *file = map;
    out->note[0] = "the format holds no colour that depends on the direction";
    if (map->size % SPIN_SPLAT_ROW != 0)
        return spin_fail(SPIN_E_MALFORMED, "%zu bytes are not rows of %d", map->size,
                         SPIN_SPLAT_ROW);
    return SPIN_OK;
}

static void info(const void *self, size_t frame, struct spin_frame_info *out)
{
    const struct spin_map *const *file = self;

    (void)frame;
    *out = (struct spin_frame_info){.number = -1, .n = (*file)->size / SPIN_SPLAT_ROW};
}

static spin_status read_splat(void *self, size_t frame, unsigned columns, struct spin_splats *out)
{
    const struct spin_map *const *file = self;

    (void)frame;
    return spin_splat_read((*file)->data, (*file)->size, columns, out);
}

static void close_splat(void *self) { (void)self; }

static const struct spin_splat_format format = {
    .suffix = ".splat",
    .name = ".splat",
    .self_bytes = sizeof(struct spin_map *),
    .open = open_splat,
    .info = info,
    .read = read_splat,
    .close = close_splat,
};

static int probe(const struct spin_peek *peek) { return spin_splat_files_probe(&format, peek); }

static spin_status splat_open(const char *path, const struct spin_plugin_values *values,
                              void **self, struct spin_sequence_info *sequence)
{
    (void)values;
    return spin_splat_files_open(&format, NULL, path, self, sequence);
}

const struct spin_importer spin_importer_splat = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "splat",
    .summary = ".splat files: one, or a folder with one per frame; no SH",
    .upstream = "antimatter15/splat",
    .probe = probe,
    .open = splat_open,
    .frame = spin_splat_files_frame,
    .close = spin_splat_files_close,
};
