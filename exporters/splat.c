/* One .splat per frame, the light preview format of antimatter15's viewer: no header, 32 bytes a
 * Gaussian, no colour beyond SH degree 0, the axes of the training.
 *
 *     0  place, 3 floats        24  colour, 3 bytes   clamp(0.5 + C0 dc) * 255
 *    12  scale, 3 floats        27  opacity, 1 byte
 *                               28  rotation w x y z, 4 bytes   q * 128 + 128
 *
 * The order is the source's; --order size puts the largest and least transparent first, so that a
 * part of the file shows the scene. */
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/mem.h"
#include "exporters/frames.h"
#include "exporters/order.h"
#include "exporters/quant.h"

#define ROW 32
#define BLOCK 8192

static const struct spin_plugin_option options[] = {
    SPIN_FRAMES_OPTION_PATTERN("frame_%05d.splat"),
    SPIN_FRAMES_OPTION_MIN_OPACITY,
    {"order", "source|size", "order of the splats; size: the most visible first", "source"},
    {0},
};

struct export
{
    struct spin_frames frames;
    struct spin_order order;
    struct spin_quant quant;
    bool by_size;
    bool loses_sh;
    _Alignas(4) unsigned char block[BLOCK * ROW];
};

/* Nearest; a cast, as roundf is a call on the oldest machines. */
static unsigned char byte_of(float x)
{
    return (unsigned char)(spin_minf(spin_maxf(x, 0), 255) + 0.5f);
}

static void write_row(const struct spin_quant_row *is, unsigned char *out)
{
    float scale[3];

    for (int c = 0; c < 3; c++)
        scale[c] = expf(is->log_scale[c]);
    memcpy(out, is->place, sizeof is->place);
    memcpy(out + 12, scale, sizeof scale);
    spin_rows_little_endian(out, 6);
    for (int c = 0; c < 3; c++)
        out[24 + c] = byte_of(is->colour[c] * 255);
    out[27] = byte_of(is->opacity * 255);
    for (int k = 0; k < 4; k++)
        out[28 + k] = byte_of(is->rotation[k] * 128 + 128);
}

/* As antimatter15's viewer decodes it. */
static void read_row(const struct spin_quant_row *is, const unsigned char *in,
                     struct spin_quant_row *out)
{
    float q[4];

    *out = *is;
    for (int c = 0; c < 3; c++)
        out->colour[c] = in[24 + c] / 255.0f;
    out->opacity = in[27] / 255.0f;
    for (int k = 0; k < 4; k++)
        q[k] = ((float)in[28 + k] - 128) / 128;
    spin_rows_rotation(q, out->rotation);
}

/* Falling exp(sum of log scales) * opacity: the float's bits in order, turned over. */
static uint64_t size_key(const struct spin_splats *s, size_t i)
{
    const float *scale = s->log_scales + 3 * i;
    float size = scale[0] + scale[1] + scale[2] +
                 logf(fmaxf(spin_sigmoid(spin_rows_logit(s->logit_opacities[i])), 1e-30f));
    uint32_t bits = spin_bits_of_float(size);

    return bits & 0x80000000u ? bits : ~(bits | 0x80000000u);
}

static spin_status write_rows(struct export *x, const struct spin_splats *s, struct spin_out *out)
{
    size_t n = 0;

    for (size_t i = 0; i < x->order.n; i++) {
        struct spin_quant_row is, shown;

        spin_quant_take(s, x->order.item[i].row, &is);
        write_row(&is, x->block + ROW * n);
        read_row(&is, x->block + ROW * n++, &shown);
        spin_quant_row(&x->quant, &is, &shown);
        if (n == BLOCK || i + 1 == x->order.n) {
            SPIN_TRY(spin_out_write(out, x->block, n * ROW));
            n = 0;
        }
    }
    return SPIN_OK;
}

/* ---- The plug-in ----------------------------------------------------------------------------- */

static spin_status splat_begin(const struct spin_export_job *job, void **self)
{
    const char *order = spin_plugin_value(job->values, "order", "source");
    struct export *x = NULL;
    spin_status status;

    if (strcmp(order, "source") != 0 && strcmp(order, "size") != 0)
        return spin_fail(SPIN_E_USAGE, "--order '%s': expected source or size", order);
    SPIN_TRY(spin_alloc(1, sizeof *x, (void **)&x));
    x->by_size = strcmp(order, "size") == 0;
    x->loses_sh = job->sh_degree > 0;
    SPIN_TRY_OUT(spin_frames_begin(&x->frames, job, "frame_%05d.splat"));
    *self = x;
    return SPIN_OK;
out:
    spin_frames_end(&x->frames);
    free(x);
    return status;
}

static spin_status splat_frame(void *self, int frame, const struct spin_frame_info *info,
                               const struct spin_splats *splats)
{
    struct export *x = self;
    struct spin_out out;
    size_t n_kept;
    spin_status status;

    (void)frame;
    SPIN_TRY(spin_frames_open(&x->frames, splats, info->number, &n_kept, &out));
    SPIN_TRY_OUT(spin_order_fill(&x->order, &x->frames.rows, splats->n, n_kept));
    if (x->by_size) {
        for (size_t i = 0; i < n_kept; i++)
            x->order.item[i].key = size_key(splats, x->order.item[i].row);
        spin_order_sort(&x->order);
    }
    SPIN_TRY_OUT(write_rows(x, splats, &out));
    return spin_out_commit(&out);
out:
    spin_out_abandon(&out);
    return status;
}

static spin_status splat_end(void *self)
{
    struct export *x = self;

    spin_quant_say(&x->quant, "splat");
    if (x->loses_sh)
        spin_log(0, "splat holds no colour that depends on the direction: sh is left out");
    spin_frames_end(&x->frames);
    spin_order_free(&x->order);
    free(x);
    return SPIN_OK;
}

static void splat_abort(void *self)
{
    struct export *x = self;

    spin_frames_abandon(&x->frames);
    spin_order_free(&x->order);
    free(x);
}

extern const struct spin_exporter spin_exporter_splat;
const struct spin_exporter spin_exporter_splat = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "splat",
    .summary = "a folder with one .splat per frame: 32 bytes a Gaussian, no SH",
    .options = options,
    .wants = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES,
    .begin = splat_begin,
    .frame = splat_frame,
    .end = splat_end,
    .abort = splat_abort,
};
