/* Writes one SOG per frame, PlayCanvas's compact format (formats/sog.h). The axes are those of the
 * training, unless --up or --rotate rotates the scene. */
#include "base/base.h"
#include "exporters/lib/frames.h"
#include "exporters/lib/sog_images.h"
#include "io/webp.h"

static const struct spin_plugin_option options[] = {
    SPIN_FRAMES_OPTIONS("frame_%05d.sog"),
    SPIN_FRAMES_OPTION_FPS,
    SPIN_ROWS_OPTION_SH,
    {"level", "N", "effort of WebP, 0 (fast) to 9 (small)", "3"},
    {0},
};

struct export
{
    struct spin_frames frames;
    struct spin_sog_images images;
};

static spin_status sog_write(void *self, const struct spin_frame_info *info, struct spin_out *out)
{
    struct export *x = self;
    const struct spin_splat_rows *rows = &x->frames.rows;

    (void)info;
    SPIN_TRY(spin_frames_order(&x->frames));
    SPIN_TRY(spin_sog_images_encode(&x->images, rows, x->frames.job->antialias,
                                    x->frames.order.item, x->frames.block_quant));
    for (size_t b = 0; b < spin_splat_rows_blocks(rows); b++)
        spin_splat_rows_release(rows, b, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES);
    return spin_sog_images_write_zip(&x->images, out);
}

static uint64_t sog_bytes(const void *self, size_t n)
{
    return spin_sog_images_most_bytes(((const struct export *)self)->frames.rows.sh_degree, n);
}

/* ---- The plug-in ----------------------------------------------------------------------------- */

static spin_status parse_options(void *self, const struct spin_export_job *job)
{
    struct export *x = self;

    x->frames.sort = spin_sort_rows_by_place;
    x->images.level = 3;
    SPIN_TRY(spin_option_count(job->values, "level", 0, 9, &x->images.level));
    return spin_webp_need();
}

static void free_export(void *self) { spin_sog_images_free(&((struct export *)self)->images); }

static const struct spin_frames_format format = {
    .name = "sog",
    .pattern = "frame_%05d.sog",
    .self_bytes = sizeof(struct export),
    .lossy = true,
    .packed = true,
    .begin = parse_options,
    .bytes = sog_bytes,
    .write = sog_write,
    .end = free_export,
};

SPIN_FRAMES_EXPORTER(
    sog, "sog",
    .summary = "a folder with one SOG per frame, for PlayCanvas and SuperSplat; small files",
    .options = options, .checks = true, .antialias = true);
