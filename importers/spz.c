/* SPZ (formats/spz.h): one file, or a folder with one per frame.
 *
 * Most files do not say which axes they hold: splat-transform and our exporter write those of the training,
 * Niantic's library right, up and back when it is told what it is given. --axes decides where the file
 * does not. */
#include <string.h>

#include "formats/spz.h"
#include "importers/lib/splat_files.h"

static const struct spin_plugin_option options[] = {
    {"axes", "source|rub",
     "axes of files that do not say theirs; rub: right, up, back, half a turn about x", "source"},
    {0},
};

struct file {
    const struct spin_map *map; /* borrowed */
    struct spin_spz_header header;
};

static spin_status open_spz(void *self, const struct spin_map *map, struct spin_splat_file *out)
{
    struct file *f = self;

    f->map = map;
    SPIN_TRY(spin_spz_peek(map->data, map->size, &f->header));
    out->sh_degree = f->header.sh_degree < 3 ? f->header.sh_degree : 3;
    out->antialias = f->header.antialias;
    out->has_axes = f->header.axes != 0;
    if (f->header.sh_degree > 3)
        out->note[0] = "SH degree 4 is cut to degree 3";
    if (!out->has_axes)
        out->note[1] = "the file does not say its axes: see --axes";
    return out->has_axes ? spin_spz_axes(f->header.axes, out->axes) : SPIN_OK;
}

static void info(const void *self, size_t frame, struct spin_frame_info *out)
{
    const struct file *f = self;

    (void)frame;
    *out = (struct spin_frame_info){.number = -1, .n = f->header.n};
}

static spin_status read_spz(void *self, size_t frame, unsigned columns, struct spin_splats *out)
{
    const struct file *f = self;

    (void)frame;
    return spin_spz_read(f->map->data, f->map->size, columns, out);
}

static void close_spz(void *self) { (void)self; }

static const struct spin_splat_format format = {
    .suffix = ".spz",
    .name = "SPZ",
    .self_bytes = sizeof(struct file),
    .open = open_spz,
    .info = info,
    .read = read_spz,
    .close = close_spz,
};

/* Folders of the format's files, such a file of versions 2 and 3, and version 4 of any name: a gzip may hold
 * anything. */
static int probe(const struct spin_peek *peek)
{
    int named = spin_splat_files_probe(&format, peek);

    if (peek->is_folder)
        return named;
    if (peek->n_head >= 4 && memcmp(peek->head, "NGSP", 4) == 0)
        return 90;
    return named && peek->n_head >= 2 && peek->head[0] == 0x1f && peek->head[1] == 0x8b ? 90 : 0;
}

static spin_status spz_open(const char *path, const struct spin_plugin_values *values, void **self,
                            struct spin_sequence_info *sequence)
{
    static const double half_about_x[4] = {0, 1, 0, 0};
    const char *axes = spin_plugin_value(values, "axes", "source");

    if (strcmp(axes, "source") != 0 && strcmp(axes, "rub") != 0)
        return spin_fail(SPIN_E_USAGE, "--axes '%s': expected source or rub", axes);
    return spin_splat_files_open(&format, strcmp(axes, "rub") == 0 ? half_about_x : NULL, path,
                                 self, sequence);
}

const struct spin_importer spin_importer_spz = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "spz",
    .summary = "SPZ files, versions 2 to 4: one, or a folder with one per frame",
    .upstream = "nianticlabs/spz 21715c3",
    .options = options,
    .probe = probe,
    .open = spz_open,
    .frame = spin_splat_files_frame,
    .close = spin_splat_files_close,
};
