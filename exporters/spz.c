/* One SPZ per frame: Niantic's format, version 3, the one most widely read. A gzip of a header of 16
 * bytes and one stream after the other:
 *
 *     places     9 bytes  per axis 24 bits, signed, in steps of 2^-fractional_bits
 *     alphas     1        opacity * 255
 *     colours    3        dc * 0.15 * 255 + 127.5
 *     scales     3        (log scale + 10) * 16
 *     rotations  4        2 bits: the largest of x y z w; of the other three a sign and 9 bits each
 *     sh         0, 9, 24 or 45  coefficient by coefficient, r g b within: x * 128 + 128, to the
 *                         nearest multiple of 8 (degree 1) or 16
 *
 * Twelve fractional bits, as the reference has it, reach to 2048 units. A frame that lies farther out
 * gets fewer, and so do those after it: what stands still should be the same in every frame.
 *
 * Axes: the format does not say which it holds. --axes source writes those of the training, as
 * splat-transform does; --axes rub turns half about x, to the right, up and back that Niantic's
 * library stores. */
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/mem.h"
#include "exporters/frames.h"
#include "exporters/quant.h"
#include "io/gzip.h"

#define MAGIC 0x5053474eu /* "NGSP" */
#define MAX_FRACTION 12
#define BLOCK 4096
#define MAX_ROW 45 /* bytes of one stream a row */
#define SQRT2 1.41421356237309505f

static const struct spin_plugin_option options[] = {
    SPIN_FRAMES_OPTION_PATTERN("frame_%05d.spz"),
    SPIN_FRAMES_OPTION_SH,
    SPIN_FRAMES_OPTION_MIN_OPACITY,
    {"axes", "source|rub", "axes to write; rub: right, up, back, half a turn about x", "source"},
    {"level", "N", "effort of gzip, 1 fast to 9 small", "3"},
    {0},
};

struct export
{
    struct spin_frames frames;
    struct spin_quant quant;
    struct spin_gzip *gzip;
    bool turned;
    int sh_degree; /* written */
    int fraction;  /* fractional bits of the places */
    const struct spin_splats *splats;
    unsigned char block[BLOCK * MAX_ROW];
};

/* ---- Axes ------------------------------------------------------------------------------------ */

/* Half a turn about x: y and z change sign; so do the coefficients odd in (y, z) together. */
static const float sign_of_sh[16] = {1, -1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1};

static void take_row(const struct export *x, size_t i, struct spin_quant_row *row)
{
    spin_quant_take(x->splats, i, row);
    if (!x->turned)
        return;
    for (int c = 1; c < 3; c++) {
        row->place[c] = -row->place[c];
        row->rotation[1 + c] = -row->rotation[1 + c];
    }
}

/* ---- Streams: code one row, and say what a reader makes of it ---------------------------------- */

/* Nearest; a cast, as roundf is a call on the oldest machines. */
static unsigned char byte_of(float x)
{
    return (unsigned char)(spin_minf(spin_maxf(x, 0), 255) + 0.5f);
}

static void code_place(struct export *x, struct spin_quant_row *row, unsigned char *out)
{
    for (int c = 0; c < 3; c++) {
        double step = ldexp(1, -x->fraction);
        uint32_t fixed = (uint32_t)(int32_t)lrint((double)row->place[c] / step);

        for (int b = 0; b < 3; b++)
            out[3 * c + b] = (unsigned char)(fixed >> (8 * b));
        row->place[c] = (float)((double)(int32_t)fixed * step);
    }
}

static void code_alpha(struct export *x, struct spin_quant_row *row, unsigned char *out)
{
    (void)x;
    out[0] = byte_of(row->opacity * 255);
    row->opacity = (float)out[0] / 255;
}

static void code_colour(struct export *x, struct spin_quant_row *row, unsigned char *out)
{
    (void)x;
    for (int c = 0; c < 3; c++) {
        out[c] = byte_of((row->colour[c] - 0.5f) / SPIN_SH_C0 * 0.15f * 255 + 127.5f);
        row->colour[c] = 0.5f + SPIN_SH_C0 * ((float)out[c] - 127.5f) / (0.15f * 255);
    }
}

static void code_scale(struct export *x, struct spin_quant_row *row, unsigned char *out)
{
    (void)x;
    for (int c = 0; c < 3; c++) {
        out[c] = byte_of((row->log_scale[c] + 10) * 16);
        row->log_scale[c] = (float)out[c] / 16 - 10;
    }
}

static void code_rotation(struct export *x, struct spin_quant_row *row, unsigned char *out)
{
    static const int place[4] = {1, 2, 3, 0}; /* x y z w in our w x y z */
    float *q = row->rotation, rest = 1, sign;
    int largest = 0;
    uint32_t word;

    (void)x;
    for (int k = 1; k < 4; k++)
        largest = fabsf(q[place[k]]) > fabsf(q[place[largest]]) ? k : largest;
    word = (uint32_t)largest;
    sign = q[place[largest]] < 0 ? -1 : 1;
    for (int k = 0; k < 4; k++) {
        float *v = &q[place[k]];
        uint32_t size;

        if (k == largest)
            continue;
        size = (uint32_t)spin_minf(roundf(511 * SQRT2 * fabsf(*v)), 511);
        word = word << 10 | (uint32_t)(*v * sign < 0) << 9 | size;
        *v = (*v * sign < 0 ? -1 : 1) * (float)size / (511 * SQRT2);
        rest -= *v * *v;
    }
    q[place[largest]] = sqrtf(spin_maxf(rest, 0));
    for (int b = 0; b < 4; b++)
        out[b] = (unsigned char)(word >> (8 * b));
}

static void code_sh(struct export *x, size_t i, unsigned char *out)
{
    int n_from = spin_sh_count(x->splats->sh_degree), n = spin_sh_count(x->sh_degree);
    const float *sh = x->splats->sh + i * 3 * (size_t)n_from;
    float error[MAX_ROW];
    size_t at = 0;

    for (int k = 1; k < n; k++) {
        float bucket = k < 4 ? 8 : 16, sign = x->turned ? sign_of_sh[k] : 1;

        for (int c = 0; c < 3; c++, at++) {
            float v = k < n_from ? sign * sh[3 * k + c] : 0;

            out[at] = byte_of((float)byte_of((v * 128 + 128) / bucket) * bucket);
            error[at] = v - ((float)out[at] - 128) / 128;
        }
    }
    spin_quant_add_all(&x->quant, SPIN_QUANT_SH, error, at);
}

/* ---- One file -------------------------------------------------------------------------------- */

typedef void (*code_fn)(struct export *x, struct spin_quant_row *row, unsigned char *out);

/* One attribute of all rows. With no code: the SH. */
static spin_status write_stream(struct export *x, code_fn code, size_t width)
{
    const struct spin_splats *s = x->splats;
    struct spin_quant_row row;
    size_t n = 0;

    for (size_t i = 0; i < s->n; i++) {
        if (x->frames.rows.keep[i] && code) {
            take_row(x, i, &row);
            code(x, &row, x->block + width * n++);
        } else if (x->frames.rows.keep[i]) {
            code_sh(x, i, x->block + width * n++);
        }
        if (n == BLOCK || (n > 0 && i + 1 == s->n)) {
            SPIN_TRY(spin_gzip_write(x->gzip, x->block, width * n));
            n = 0;
        }
    }
    return SPIN_OK;
}

/* What all the streams of a row make of it, beside what it was. */
static void measure(struct export *x)
{
    static const code_fn codes[] = {code_place, code_alpha, code_colour, code_scale, code_rotation};
    struct spin_quant_row is, shown;

    for (size_t i = 0; i < x->splats->n; i++) {
        if (!x->frames.rows.keep[i])
            continue;
        take_row(x, i, &is);
        shown = is;
        for (size_t k = 0; k < sizeof codes / sizeof codes[0]; k++)
            codes[k](x, &shown, x->block);
        spin_quant_row(&x->quant, &is, &shown);
    }
}

/* The most fractional bits, at most those of the frame before, with which all places fit. */
static spin_status choose_fraction(struct export *x, int number)
{
    int before = x->fraction;
    float largest = 0;

    for (size_t i = 0; i < x->splats->n; i++)
        for (int c = 0; c < 3 && x->frames.rows.keep[i]; c++)
            largest = spin_maxf(largest, fabsf(x->splats->means[3 * i + (size_t)c]));
    while (x->fraction >= 0 && ldexp((double)largest, x->fraction) > 8388606)
        x->fraction--;
    if (x->fraction < 0)
        return spin_fail(SPIN_E_UNSUPPORTED,
                         "frame %d: a splat lies at %g, spz holds no place beyond 8388606", number,
                         (double)largest);
    if (x->fraction < before)
        spin_warn("frame %d: a splat lies at %g: places are written in steps of 1/%d from here on",
                  number, (double)largest, 1 << x->fraction);
    return SPIN_OK;
}

static spin_status write_header(struct export *x, size_t n)
{
    uint32_t word[3] = {MAGIC, 3, (uint32_t)n};
    unsigned char rest[4] = {(unsigned char)x->sh_degree, (unsigned char)x->fraction, 0, 0};

    spin_rows_little_endian(word, 3);
    SPIN_TRY(spin_gzip_write(x->gzip, word, sizeof word));
    return spin_gzip_write(x->gzip, rest, sizeof rest);
}

static spin_status write_file(struct export *x, int number, size_t n, struct spin_out *out)
{
    if (n > UINT32_MAX)
        return spin_fail(SPIN_E_UNSUPPORTED, "frame %d: %zu splats are more than spz can count",
                         number, n);
    SPIN_TRY(choose_fraction(x, number));
    SPIN_TRY(spin_gzip_begin(x->gzip, out));
    SPIN_TRY(write_header(x, n));
    SPIN_TRY(write_stream(x, code_place, 9));
    SPIN_TRY(write_stream(x, code_alpha, 1));
    SPIN_TRY(write_stream(x, code_colour, 3));
    SPIN_TRY(write_stream(x, code_scale, 3));
    SPIN_TRY(write_stream(x, code_rotation, 4));
    if (x->sh_degree > 0)
        SPIN_TRY(write_stream(x, NULL, 3 * (size_t)spin_sh_count(x->sh_degree) - 3));
    SPIN_TRY(spin_gzip_end(x->gzip));
    measure(x);
    return SPIN_OK;
}

/* ---- The plug-in ----------------------------------------------------------------------------- */

static void finish(struct export *x)
{
    spin_gzip_free(x->gzip);
    free(x);
}

static spin_status spz_begin(const struct spin_export_job *job, void **self)
{
    const struct spin_plugin_values *v = job->values;
    const char *axes = spin_plugin_value(v, "axes", "source");
    const char *level = spin_plugin_value(v, "level", "3");
    struct export *x = NULL;
    spin_status status;

    if (strcmp(axes, "source") != 0 && strcmp(axes, "rub") != 0)
        return spin_fail(SPIN_E_USAGE, "--axes '%s': expected source or rub", axes);
    if (level[0] < '1' || level[0] > '9' || level[1])
        return spin_fail(SPIN_E_USAGE, "--level '%s': expected 1 to 9", level);
    SPIN_TRY(spin_alloc(1, sizeof *x, (void **)&x));
    x->turned = strcmp(axes, "rub") == 0;
    x->fraction = MAX_FRACTION;
    SPIN_TRY_OUT(
        spin_rows_parse_sh(spin_plugin_value(v, "sh", "keep"), job->sh_degree, &x->sh_degree));
    SPIN_TRY_OUT(spin_gzip_create(level[0] - '0', job->n_threads, &x->gzip));
    SPIN_TRY_OUT(spin_frames_begin(&x->frames, job, "frame_%05d.spz"));
    *self = x;
    return SPIN_OK;
out:
    spin_frames_end(&x->frames);
    finish(x);
    return status;
}

static spin_status spz_frame(void *self, int frame, const struct spin_frame_info *info,
                             const struct spin_splats *splats)
{
    struct export *x = self;
    struct spin_out out;
    size_t n_kept;
    spin_status status;

    (void)frame;
    x->splats = splats;
    SPIN_TRY(spin_frames_open(&x->frames, splats, info->number, &n_kept, &out));
    SPIN_TRY_OUT(write_file(x, info->number, n_kept, &out));
    return spin_out_commit(&out);
out:
    spin_out_abandon(&out);
    return status;
}

static spin_status spz_end(void *self)
{
    struct export *x = self;

    spin_quant_say(&x->quant, "spz");
    spin_frames_end(&x->frames);
    finish(x);
    return SPIN_OK;
}

static void spz_abort(void *self)
{
    struct export *x = self;

    spin_frames_abandon(&x->frames);
    finish(x);
}

extern const struct spin_exporter spin_exporter_spz;
const struct spin_exporter spin_exporter_spz = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "spz",
    .summary = "a folder with one SPZ (version 3) per frame: about a tenth of a PLY",
    .options = options,
    .wants = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES,
    .begin = spz_begin,
    .frame = spz_frame,
    .end = spz_end,
    .abort = spz_abort,
};
