/* One .splat per frame (formats/splat.h), in the axes of the training. The order is the source's;
 * --order size puts the largest and least transparent first, so that a part of the file shows the scene. */
#include "base/base.h"
#include "exporters/lib/frames.h"
#include "formats/splat.h"

static const struct spin_plugin_option options[] = {
    SPIN_FRAMES_OPTIONS("frame_%05d.splat"),
    SPIN_FRAMES_OPTION_FPS,
    {"order", "source|size", "order of the splats; size: the most visible first", "source"},
    {0},
};

struct export
{
    struct spin_frames frames;
    struct spin_sort_rows order;
    bool by_size;
};

/* ---- One file -------------------------------------------------------------------------------- */

static void code_row(void *self, size_t i, unsigned char *out, struct spin_quant_error *quant)
{
    const struct export *x = self;
    struct spin_gaussian is, shown;

    spin_splat_filter_take(&x->frames.rows, i, &is);
    spin_splat_code(&is, out);
    shown = is; /* place and scale are floats in the file */
    spin_splat_decode_bytes(out, &shown);
    spin_quant_error_row(quant, &is, &shown);
}

/* Rows in the order of x->order, in pieces. */
static spin_status write_ordered(struct export *x, struct spin_out *out)
{
    unsigned char *block;

    SPIN_TRY(spin_frames_scratch(&x->frames, SPIN_ROWS_BLOCK * SPIN_SPLAT_ROW, &block));
    for (size_t i = 0, n = 0; i < x->order.n; i++) {
        size_t row = x->order.item[i].row;

        code_row(x, row, block + SPIN_SPLAT_ROW * n++,
                 &x->frames.block_quant[row / SPIN_ROWS_BLOCK]);
        if (n == SPIN_ROWS_BLOCK || i + 1 == x->order.n) {
            SPIN_TRY(spin_out_write(out, block, n * SPIN_SPLAT_ROW));
            n = 0;
        }
    }
    return SPIN_OK;
}

static spin_status order_rows(struct export *x)
{
    SPIN_TRY(spin_sort_rows_fill(&x->order, &x->frames.rows));
    spin_sort_rows_by_size(&x->order, x->frames.rows.splats);
    return SPIN_OK;
}

static spin_status splat_write(void *self, const struct spin_frame_info *info, struct spin_out *out)
{
    struct export *x = self;

    (void)info;
    if (!x->by_size)
        return spin_frames_write_rows(x, out, 0, SPIN_SPLAT_ROW, code_row);
    SPIN_TRY(order_rows(x));
    return write_ordered(x, out);
}

static uint64_t splat_bytes(const void *self, size_t n)
{
    (void)self;
    return (uint64_t)n * SPIN_SPLAT_ROW;
}

static spin_status splat_order(void *self, const struct spin_keyed **row)
{
    struct export *x = self;

    if (!x->by_size)
        return SPIN_OK;
    SPIN_TRY(order_rows(x));
    *row = x->order.item;
    return SPIN_OK;
}

/* ---- The plug-in ----------------------------------------------------------------------------- */

static spin_status begin(void *self, const struct spin_export_job *job)
{
    struct export *x = self;
    int order;

    SPIN_TRY(spin_option_word(job->values, "order", "source|size", &order));
    x->by_size = order == 1;
    return SPIN_OK;
}

static void end(void *self) { spin_sort_rows_free(&((struct export *)self)->order); }

static const struct spin_frames_format format = {
    .name = "splat",
    .pattern = "frame_%05d.splat",
    .self_bytes = sizeof(struct export),
    .lossy = true,
    .begin = begin,
    .bytes = splat_bytes,
    .write = splat_write,
    .order = splat_order,
    .end = end,
};

static spin_status splat_begin(const struct spin_export_job *job, void **self)
{
    if (job->sh_degree > 0)
        spin_log(0, "splat holds no colour that depends on the direction: sh is left out");
    return spin_frames_begin(&format, job, self);
}

SPIN_EXPORTER(splat, "splat", SPIN_FRAMES_FUNCTIONS,
              .summary = "a folder with one .splat per frame: 32 bytes a Gaussian, no SH",
              .options = options, .checks = true, .begin = splat_begin);
