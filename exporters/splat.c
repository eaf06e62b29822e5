/* Writes one .splat file per frame (formats/splat.h), in the axes of the source. Splats keep the
 * order of the source. --order size writes the largest and most opaque splats first, so that a
 * player can show the scene before the file is fully loaded. */
#include "base/base.h"
#include "exporters/lib/frames.h"
#include "formats/splat.h"

static const struct spin_plugin_option options[] = {
    SPIN_FRAMES_OPTIONS("frame_%05d.splat"),
    SPIN_FRAMES_OPTION_FPS,
    {"order", "source|size", "order of the splats; size: the largest and most opaque first",
     "source"},
    {0},
};

/* ---- One file -------------------------------------------------------------------------------- */

static void code_row(void *self, size_t i, unsigned char *out, struct spin_quant_error *quant)
{
    const struct spin_frames *x = self;
    struct spin_gaussian is, shown;

    spin_splat_rows_get(&x->rows, i, &is);
    spin_splat_code(&is, out);
    shown = is; /* position and scale are stored as floats, without rounding */
    spin_splat_decode_bytes(out, &shown);
    spin_quant_error_row(quant, &is, &shown);
}

/* Writes the rows in the order of x->order, one block at a time. */
static spin_status write_ordered(struct spin_frames *x, struct spin_out *out)
{
    unsigned char *block;

    SPIN_TRY(spin_frames_scratch(x, SPIN_ROWS_BLOCK * SPIN_SPLAT_ROW, &block));
    for (size_t i = 0, n = 0; i < x->order.n; i++) {
        size_t row = x->order.item[i].row;

        code_row(x, row, block + SPIN_SPLAT_ROW * n++, &x->block_quant[row / SPIN_ROWS_BLOCK]);
        if (n == SPIN_ROWS_BLOCK || i + 1 == x->order.n) {
            SPIN_TRY(spin_out_write(out, block, n * SPIN_SPLAT_ROW));
            n = 0;
        }
    }
    return SPIN_OK;
}

static spin_status splat_write(void *self, const struct spin_frame_info *info, struct spin_out *out)
{
    struct spin_frames *x = self;

    (void)info;
    if (!x->sort)
        return spin_frames_write_rows(x, out, 0, SPIN_SPLAT_ROW, code_row);
    SPIN_TRY(spin_frames_order(x));
    return write_ordered(x, out);
}

static uint64_t splat_bytes(const void *self, size_t n)
{
    (void)self;
    return (uint64_t)n * SPIN_SPLAT_ROW;
}

/* ---- The plug-in ----------------------------------------------------------------------------- */

static spin_status parse_options(void *self, const struct spin_export_job *job)
{
    struct spin_frames *x = self;
    int order;

    SPIN_TRY(spin_option_word(job->values, "order", "source|size", &order));
    x->sort = order == 1 ? spin_sort_rows_by_size : NULL;
    return SPIN_OK;
}

static const struct spin_frames_format format = {
    .name = "splat",
    .pattern = "frame_%05d.splat",
    .self_bytes = sizeof(struct spin_frames),
    .lossy = true,
    .clips_colours = true,
    .begin = parse_options,
    .bytes = splat_bytes,
    .write = splat_write,
};

static spin_status splat_begin(const struct spin_export_job *job, void **self)
{
    if (job->sh_degree > 0)
        spin_log(0, ".splat cannot store view-dependent colours: SH above degree 0 are dropped");
    return spin_frames_begin(&format, job, self);
}

SPIN_EXPORTER(splat, "splat", SPIN_FRAMES_FUNCTIONS,
              .summary = "a folder with one .splat per frame: 32 bytes per Gaussian, no SH",
              .options = options, .checks = true, .begin = splat_begin);
