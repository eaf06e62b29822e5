/* One .splat per frame, the light preview format of antimatter15's viewer: no header, 32 bytes a
 * Gaussian, no colour beyond SH degree 0, the axes of the training.
 *
 *     0  place, 3 floats        24  colour, 3 bytes   clamp(0.5 + C0 dc) * 255
 *    12  scale, 3 floats        27  opacity, 1 byte
 *                               28  rotation w x y z, 4 bytes   q * 128 + 128
 *
 * The order is the source's; --order size puts the largest and least transparent first, so that a
 * part of the file shows the scene. */
#include <string.h>

#include "exporters/lib/roundtrip_check.h"
#include "exporters/lib/frames.h"
#include "exporters/lib/sort_rows.h"

#define ROW 32

static const struct spin_plugin_option options[] = {
    SPIN_FRAMES_OPTIONS("frame_%05d.splat"),
    {"order", "source|size", "order of the splats; size: the most visible first", "source"},
    {0},
};

struct export
{
    struct spin_frames frames;
    struct spin_sort_rows order;
    bool by_size;
    uint32_t *row; /* the order, for a check */
};

/* Nearest; a cast, as roundf is a call on the oldest machines. */
static unsigned char byte_of(float x)
{
    return (unsigned char)(spin_minf(spin_maxf(x, 0), 255) + 0.5f);
}

static void write_row(const struct spin_quant_error_row *is, unsigned char *out)
{
    float scale[3];

    for (int c = 0; c < 3; c++)
        scale[c] = expf(is->log_scale[c]);
    memcpy(out, is->place, sizeof is->place);
    memcpy(out + 12, scale, sizeof scale);
    spin_splat_filter_little_endian(out, 6);
    for (int c = 0; c < 3; c++)
        out[24 + c] = byte_of(is->colour[c] * 255);
    out[27] = byte_of(is->opacity * 255);
    for (int k = 0; k < 4; k++)
        out[28 + k] = byte_of(is->rotation[k] * 128 + 128);
}

/* As antimatter15's viewer decodes it. */
static void read_row(const struct spin_quant_error_row *is, const unsigned char *in,
                     struct spin_quant_error_row *out)
{
    float q[4];

    *out = *is;
    for (int c = 0; c < 3; c++)
        out->colour[c] = in[24 + c] / 255.0f;
    out->opacity = in[27] / 255.0f;
    for (int k = 0; k < 4; k++)
        q[k] = ((float)in[28 + k] - 128) / 128;
    spin_splat_filter_rotation(q, out->rotation);
}

/* ---- One file -------------------------------------------------------------------------------- */

static void code_row(void *self, size_t i, unsigned char *out, struct spin_quant_error *quant)
{
    const struct export *x = self;
    struct spin_quant_error_row is, shown;

    spin_quant_error_take(&x->frames.rows, i, &is);
    write_row(&is, out);
    read_row(&is, out, &shown);
    spin_quant_error_row(quant, &is, &shown);
}

/* Rows in the order of x->order, in pieces. */
static spin_status write_ordered(struct export *x, struct spin_out *out)
{
    struct spin_quant_error *quant;
    unsigned char *block;

    SPIN_TRY(spin_frames_scratch(&x->frames, SPIN_ROWS_BLOCK * ROW, &block));
    SPIN_TRY(spin_frames_quants(&x->frames, &quant));
    for (size_t i = 0, n = 0; i < x->order.n; i++) {
        size_t row = x->order.item[i].row;

        code_row(x, row, block + ROW * n++, &quant[row / SPIN_ROWS_BLOCK]);
        if (n == SPIN_ROWS_BLOCK || i + 1 == x->order.n) {
            SPIN_TRY(spin_out_write(out, block, n * ROW));
            n = 0;
        }
    }
    spin_frames_merge(&x->frames);
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
        return spin_frames_write_rows(x, out, 0, ROW, code_row);
    SPIN_TRY(order_rows(x));
    return write_ordered(x, out);
}

static uint64_t splat_bytes(const void *self, size_t n)
{
    (void)self;
    return (uint64_t)n * ROW;
}

/* The format has no header: whole rows are all that can be asked for. */
static bool splat_complete(void *self, const struct spin_frame_info *info,
                           const struct spin_map *map, size_t *n)
{
    (void)self;
    (void)info;
    *n = map->size / ROW;
    return map->size % ROW == 0;
}

static spin_status splat_order(void *self, const uint32_t **row)
{
    struct export *x = self;

    if (!x->by_size)
        return SPIN_OK;
    SPIN_TRY(order_rows(x));
    SPIN_TRY(spin_grow(x->order.n + 1, sizeof *x->row, (void **)&x->row));
    for (size_t i = 0; i < x->order.n; i++)
        x->row[i] = x->order.item[i].row;
    *row = x->row;
    return SPIN_OK;
}

static spin_status splat_read(void *self, const struct spin_map *map, int frame,
                              struct spin_splats *out)
{
    size_t n = map->size / ROW;

    (void)self;
    (void)frame;
    if (map->size % ROW != 0)
        return spin_fail(SPIN_E_MALFORMED, "%zu bytes are not rows of %d", map->size, ROW);
    SPIN_TRY(spin_splats_reserve(out, n, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES, 0));
    for (size_t i = 0; i < n; i++) {
        const unsigned char *row = map->data + ROW * i;
        struct spin_quant_error_row is = {0}, shown;
        float scale[3];

        memcpy(is.place, row, sizeof is.place);
        memcpy(scale, row + 12, sizeof scale);
        spin_splat_filter_little_endian(is.place, 3);
        spin_splat_filter_little_endian(scale, 3);
        read_row(&is, row, &shown);
        memcpy(out->means + 3 * i, shown.place, sizeof shown.place);
        memcpy(out->quats + 4 * i, shown.rotation, sizeof shown.rotation);
        out->logit_opacities[i] = spin_roundtrip_check_logit(shown.opacity);
        for (size_t c = 0; c < 3; c++) {
            out->log_scales[3 * i + c] = logf(spin_maxf(scale[c], 1e-38f));
            out->sh[3 * i + c] = (shown.colour[c] - 0.5f) / (float)SPIN_SH_C0;
        }
    }
    return SPIN_OK;
}

/* ---- The plug-in ----------------------------------------------------------------------------- */

static spin_status begin(void *self, const struct spin_export_job *job)
{
    const char *order = spin_plugin_value(job->values, "order", "source");
    struct export *x = self;

    if (strcmp(order, "source") != 0 && strcmp(order, "size") != 0)
        return spin_fail(SPIN_E_USAGE, "--order '%s': expected source or size", order);
    x->by_size = strcmp(order, "size") == 0;
    return SPIN_OK;
}

static void end(void *self)
{
    struct export *x = self;

    spin_sort_rows_free(&x->order);
    free(x->row);
}

static const struct spin_frames_format format = {
    .name = "splat",
    .pattern = "frame_%05d.splat",
    .self_bytes = sizeof(struct export),
    .lossy = true,
    .begin = begin,
    .bytes = splat_bytes,
    .write = splat_write,
    .complete = splat_complete,
    .read = splat_read,
    .order = splat_order,
    .end = end,
};

static spin_status splat_begin(const struct spin_export_job *job, void **self)
{
    if (job->sh_degree > 0)
        spin_log(0, "splat holds no colour that depends on the direction: sh is left out");
    return spin_frames_begin(&format, job, self);
}

extern const struct spin_exporter spin_exporter_splat;
const struct spin_exporter spin_exporter_splat = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "splat",
    .summary = "a folder with one .splat per frame: 32 bytes a Gaussian, no SH",
    .options = options,
    .checks = true,
    .wants = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES,
    .begin = splat_begin,
    .frame = spin_frames_frame,
    .end = spin_frames_end,
    .abort = spin_frames_abort,
    .skip = spin_frames_skip,
};
