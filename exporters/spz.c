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
#include <string.h>

#include "exporters/lib/roundtrip_check.h"
#include "exporters/lib/frames.h"
#include "io/gzip.h"

#define MAGIC 0x5053474eu /* "NGSP" */
#define MAX_FRACTION 12
#define MAX_WIDTH 45 /* bytes of one stream a row */
#define BATCH 16     /* blocks of rows coded at a time */
#define HEADER 16
#define ANTIALIASED 1 /* of the header's flags */
#define SQRT2 1.41421356237309505f

static const struct spin_plugin_option options[] = {
    SPIN_FRAMES_OPTIONS("frame_%05d.spz"),
    SPIN_ROWS_OPTION_SH,
    {"axes", "source|rub", "axes to write; rub: right, up, back, half a turn about x", "source"},
    {"level", "N", "effort of gzip; 1: no search for repeats, of which there are few; to 9", "1"},
    {0},
};

struct export;
/* One stream: code row i, and add what a reader is wrong by. */
typedef void (*code_fn)(const struct export *x, size_t i, unsigned char *out,
                        struct spin_quant_error *quant);

struct export
{
    struct spin_frames frames;
    struct spin_gzip *gzip;
    int fraction; /* fractional bits of the places */

    /* The batch at hand. */
    code_fn code;
    size_t width, first;            /* bytes a row; block */
    unsigned char *bytes;           /* [BATCH * rows of a block * MAX_WIDTH] */
    struct spin_quant_error *quant; /* [blocks] */
};

/* ---- Streams --------------------------------------------------------------------------------- */

/* Nearest; a cast, as roundf is a call on the oldest machines. */
static unsigned char byte_of(float x)
{
    return (unsigned char)(spin_minf(spin_maxf(x, 0), 255) + 0.5f);
}

static void code_place(const struct export *x, size_t i, unsigned char *out,
                       struct spin_quant_error *quant)
{
    float place[3], shown[3];

    spin_splat_filter_place(&x->frames.rows, i, place);
    for (int c = 0; c < 3; c++) {
        int32_t fixed = (int32_t)lrint((double)place[c] * (1 << x->fraction));

        for (int b = 0; b < 3; b++)
            out[3 * c + b] = (unsigned char)((uint32_t)fixed >> (8 * b));
        shown[c] = (float)((double)fixed / (1 << x->fraction));
    }
    spin_quant_error_add_place(quant, place, shown);
}

static void code_alpha(const struct export *x, size_t i, unsigned char *out,
                       struct spin_quant_error *quant)
{
    float opacity = spin_quant_error_opacity(&x->frames.rows, i);

    out[0] = byte_of(opacity * 255);
    spin_quant_error_add(quant, SPIN_QUANT_OPACITY, (double)opacity - (float)out[0] / 255);
}

static void code_colour(const struct export *x, size_t i, unsigned char *out,
                        struct spin_quant_error *quant)
{
    float colour[3], shown[3];

    spin_quant_error_colour(&x->frames.rows, i, colour);
    for (int c = 0; c < 3; c++) {
        out[c] = byte_of((colour[c] - 0.5f) / (float)SPIN_SH_C0 * 0.15f * 255 + 127.5f);
        shown[c] = 0.5f + (float)SPIN_SH_C0 * ((float)out[c] - 127.5f) / (0.15f * 255);
    }
    spin_quant_error_add_3(quant, SPIN_QUANT_COLOUR, colour, shown);
}

static void code_scale(const struct export *x, size_t i, unsigned char *out,
                       struct spin_quant_error *quant)
{
    const float *scale = x->frames.rows.splats->log_scales + 3 * i;
    float shown[3];

    for (int c = 0; c < 3; c++) {
        out[c] = byte_of((scale[c] + 10) * 16);
        shown[c] = (float)out[c] / 16 - 10;
    }
    spin_quant_error_add_3(quant, SPIN_QUANT_SCALE, scale, shown);
}

static void code_rotation(const struct export *x, size_t i, unsigned char *out,
                          struct spin_quant_error *quant)
{
    static const int place[4] = {1, 2, 3, 0}; /* x y z w in our w x y z */
    float q[4], shown[4], rest = 1, sign;
    int largest = 0;
    uint32_t word;

    spin_splat_filter_turned(&x->frames.rows, i, q);
    for (int k = 1; k < 4; k++)
        largest = fabsf(q[place[k]]) > fabsf(q[place[largest]]) ? k : largest;
    word = (uint32_t)largest;
    sign = q[place[largest]] < 0 ? -1 : 1;
    for (int k = 0; k < 4; k++) {
        float v = q[place[k]] * sign;
        uint32_t size;

        if (k == largest)
            continue;
        size = (uint32_t)spin_minf(511 * SQRT2 * fabsf(v) + 0.5f, 511);
        word = word << 10 | (uint32_t)(v < 0) << 9 | size;
        shown[place[k]] = (v < 0 ? -1 : 1) * (float)size / (511 * SQRT2);
        rest -= shown[place[k]] * shown[place[k]];
    }
    shown[place[largest]] = sqrtf(spin_maxf(rest, 0));
    for (int b = 0; b < 4; b++)
        out[b] = (unsigned char)(word >> (8 * b));
    spin_quant_error_add_rotation(quant, q, shown);
}

static void code_sh(const struct export *x, size_t i, unsigned char *out,
                    struct spin_quant_error *quant)
{
    const struct spin_splat_filter *rows = &x->frames.rows;
    int n = 3 * spin_sh_count(rows->sh_degree), n_there = 3 * spin_splat_filter_n_sh(rows);
    float room[3 * SPIN_SH_MAX], error[3 * SPIN_SH_MAX];
    const float *sh = spin_splat_filter_sh(rows, i, room);

    for (int k = 3; k < n; k++) {
        float bucket = k < 12 ? 8 : 16, v = k < n_there ? sh[k] : 0;
        float steps = (float)byte_of((v * 128 + 128) / bucket);

        out[k - 3] = byte_of(steps * bucket);
        error[k - 3] = v - ((float)out[k - 3] - 128) / 128;
    }
    spin_quant_error_add_all(quant, SPIN_QUANT_SH, error, (size_t)n - 3);
}

/* ---- One file -------------------------------------------------------------------------------- */

static void code_block(void *context, int task, int worker)
{
    const struct export *x = context;
    const struct spin_splat_filter *rows = &x->frames.rows;
    size_t b = x->first + (size_t)task, i = b * SPIN_ROWS_BLOCK, end = i + SPIN_ROWS_BLOCK;
    size_t before = spin_splat_filter_before(rows, b) - spin_splat_filter_before(rows, x->first);
    unsigned char *out = x->bytes + before * x->width;

    (void)worker;
    for (end = end < rows->splats->n ? end : rows->splats->n; i < end; i++) {
        if (rows->keep[i]) {
            x->code(x, i, out, &x->quant[b]);
            out += x->width;
        }
    }
    spin_splat_filter_rest(rows, b, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES);
}

/* One attribute of all rows, some blocks at a time. */
static spin_status write_stream(struct export *x, code_fn code, size_t width)
{
    const struct spin_splat_filter *rows = &x->frames.rows;
    size_t n_blocks = spin_splat_filter_blocks(rows);

    x->code = code;
    x->width = width;
    for (x->first = 0; x->first < n_blocks; x->first += BATCH) {
        size_t end = x->first + BATCH < n_blocks ? x->first + BATCH : n_blocks;
        size_t n = (end < n_blocks ? spin_splat_filter_before(rows, end) : rows->n_kept) -
                   spin_splat_filter_before(rows, x->first);

        spin_pool_run(rows->pool, (int)(end - x->first), code_block, x);
        SPIN_TRY(spin_gzip_write(x->gzip, x->bytes, n * width));
    }
    return SPIN_OK;
}

/* The most fractional bits, at most those of the frame before, with which all places fit. */
static spin_status choose_fraction(struct export *x, int number)
{
    const struct spin_splat_filter *rows = &x->frames.rows;
    int before = x->fraction;
    float largest = 0, place[3];

    for (size_t i = 0; i < rows->splats->n; i++) {
        if (!rows->keep[i])
            continue;
        spin_splat_filter_place(rows, i, place);
        for (int c = 0; c < 3; c++)
            largest = spin_maxf(largest, fabsf(place[c]));
    }
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

static spin_status write_header(struct export *x)
{
    uint32_t word[3] = {MAGIC, 3, (uint32_t)x->frames.rows.n_kept};
    unsigned char rest[4] = {(unsigned char)x->frames.rows.sh_degree, (unsigned char)x->fraction,
                             x->frames.antialias ? ANTIALIASED : 0};

    spin_splat_filter_little_endian(word, 3);
    SPIN_TRY(spin_gzip_write(x->gzip, word, sizeof word));
    return spin_gzip_write(x->gzip, rest, sizeof rest);
}

static size_t sh_bytes(const struct export *x)
{
    return 3 * (size_t)spin_sh_count(x->frames.rows.sh_degree) - 3;
}

static spin_status spz_write(void *self, const struct spin_frame_info *info, struct spin_out *out)
{
    struct export *x = self;

    SPIN_TRY(choose_fraction(x, info->number));
    SPIN_TRY(spin_frames_quants(&x->frames, &x->quant));
    SPIN_TRY(spin_gzip_begin(x->gzip, out));
    SPIN_TRY(write_header(x));
    SPIN_TRY(write_stream(x, code_place, 9));
    SPIN_TRY(write_stream(x, code_alpha, 1));
    SPIN_TRY(write_stream(x, code_colour, 3));
    SPIN_TRY(write_stream(x, code_scale, 3));
    SPIN_TRY(write_stream(x, code_rotation, 4));
    if (sh_bytes(x) > 0)
        SPIN_TRY(write_stream(x, code_sh, sh_bytes(x)));
    SPIN_TRY(spin_gzip_end(x->gzip));
    spin_frames_merge(&x->frames);
    return SPIN_OK;
}

static uint64_t spz_bytes(const void *self, size_t n)
{
    return HEADER + (uint64_t)n * (20 + sh_bytes(self));
}

/* The header inside, and the length that the gzip ends with. */
static bool spz_complete(void *self, const struct spin_frame_info *info, const struct spin_map *map,
                         size_t *n)
{
    const struct export *x = self;
    unsigned char header[HEADER];
    uint32_t word[3];
    size_t n_read = 0;

    (void)info;
    if (spin_gzip_read(map->data, map->size, header, sizeof header, &n_read) != SPIN_OK ||
        n_read != sizeof header)
        return false;
    memcpy(word, header, sizeof word);
    spin_splat_filter_little_endian(word, 3);
    *n = word[2];
    return word[0] == MAGIC && word[1] == 3 && header[12] == x->frames.rows.sh_degree &&
           spin_gzip_length(map->data, map->size) == (uint32_t)spz_bytes(self, *n);
}

/* One row of each stream, as Niantic's library reads it. `at` points at the row's bytes in the streams
 * of places, alphas, colours, scales, rotations and SH. */
static void read_row(const unsigned char *const at[6], int fraction, size_t i,
                     struct spin_splats *out)
{
    static const int place[4] = {1, 2, 3, 0};
    uint32_t word =
        at[4][0] | (uint32_t)at[4][1] << 8 | (uint32_t)at[4][2] << 16 | (uint32_t)at[4][3] << 24;
    int largest = (int)(word >> 30), n = 3 * spin_sh_count(out->sh_degree);
    float *q = out->quats + 4 * i, *sh = out->sh + (size_t)n * i, rest = 1;

    for (size_t c = 0; c < 3; c++) {
        uint32_t bits = (uint32_t)at[0][3 * c] << 8 | (uint32_t)at[0][3 * c + 1] << 16 |
                        (uint32_t)at[0][3 * c + 2] << 24;

        out->means[3 * i + c] = (float)ldexp((int32_t)bits / 256, -fraction);
        out->log_scales[3 * i + c] = (float)at[3][c] / 16 - 10;
        sh[c] = ((float)at[2][c] - 127.5f) / (0.15f * 255);
    }
    out->logit_opacities[i] = spin_roundtrip_check_logit((float)at[1][0] / 255);
    for (int k = 3; k >= 0; k--) {
        if (k == largest)
            continue;
        q[place[k]] = (word & 512 ? -1 : 1) * (float)(word & 511) / (511 * SQRT2);
        rest -= q[place[k]] * q[place[k]];
        word >>= 10;
    }
    q[place[largest]] = sqrtf(spin_maxf(rest, 0));
    for (int k = 3; k < n; k++)
        sh[k] = ((float)at[5][k - 3] - 128) / 128;
}

static spin_status read_streams(const unsigned char *bytes, size_t n_bytes, struct spin_splats *out)
{
    static const size_t width[6] = {9, 1, 3, 3, 4, 0};
    const unsigned char *at[6] = {bytes + HEADER};
    uint32_t word[3];
    int degree = n_bytes < HEADER ? 4 : bytes[12];
    size_t n_sh = degree > 3 ? 0 : 3 * (size_t)spin_sh_count(degree) - 3, n;

    if (degree > 3)
        return spin_fail(SPIN_E_MALFORMED, "no header of SPZ");
    memcpy(word, bytes, sizeof word);
    spin_splat_filter_little_endian(word, 3);
    n = word[2];
    if (word[0] != MAGIC || word[1] != 3 || n_bytes != HEADER + (uint64_t)n * (20 + n_sh))
        return spin_fail(SPIN_E_MALFORMED, "not a SPZ of version 3 with %zu splats", n);
    SPIN_TRY(spin_splats_reserve(out, n, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES, degree));
    for (int s = 1; s < 6; s++)
        at[s] = at[s - 1] + n * width[s - 1];
    for (size_t i = 0; i < n; i++) {
        read_row(at, bytes[13], i, out);
        for (int s = 0; s < 6; s++)
            at[s] += s < 5 ? width[s] : n_sh;
    }
    return SPIN_OK;
}

static spin_status spz_read(void *self, const struct spin_map *map, int frame,
                            struct spin_splats *out)
{
    size_t n_bytes = spin_gzip_length(map->data, map->size), n = 0;
    unsigned char *bytes = NULL;
    spin_status status;

    (void)self;
    (void)frame;
    SPIN_TRY(spin_alloc(n_bytes + 1, 1, (void **)&bytes));
    SPIN_TRY_OUT(spin_gzip_read(map->data, map->size, bytes, n_bytes + 1, &n));
    status = read_streams(bytes, n, out);
out:
    free(bytes);
    return status;
}

/* ---- The plug-in ----------------------------------------------------------------------------- */

static spin_status begin(void *self, const struct spin_export_job *job)
{
    static const double half_about_x[4] = {0, 1, 0, 0};
    const struct spin_plugin_values *v = job->values;
    const char *axes = spin_plugin_value(v, "axes", "source");
    const char *level = spin_plugin_value(v, "level", "1");
    struct export *x = self;

    if (strcmp(axes, "source") != 0 && strcmp(axes, "rub") != 0)
        return spin_fail(SPIN_E_USAGE, "--axes '%s': expected source or rub", axes);
    if (level[0] < '1' || level[0] > '9' || level[1])
        return spin_fail(SPIN_E_USAGE, "--level '%s': expected 1 to 9", level);
    if (strcmp(axes, "rub") == 0 && spin_plugin_value(v, "up", NULL))
        return spin_fail(SPIN_E_USAGE, "--axes rub takes y down for granted: give it or --up");
    x->frames.axes = strcmp(axes, "rub") == 0 ? half_about_x : NULL;
    x->fraction = MAX_FRACTION;
    SPIN_TRY(spin_alloc((size_t)BATCH * SPIN_ROWS_BLOCK, MAX_WIDTH, (void **)&x->bytes));
    return spin_gzip_create(level[0] - '0', job->n_threads, &x->gzip);
}

static void end(void *self)
{
    struct export *x = self;

    spin_gzip_free(x->gzip);
    free(x->bytes);
}

static const struct spin_frames_format format = {
    .name = "spz",
    .pattern = "frame_%05d.spz",
    .self_bytes = sizeof(struct export),
    .lossy = true,
    .packed = true,
    .begin = begin,
    .bytes = spz_bytes,
    .write = spz_write,
    .complete = spz_complete,
    .read = spz_read,
    .end = end,
};

static spin_status spz_begin(const struct spin_export_job *job, void **self)
{
    return spin_frames_begin(&format, job, self);
}

extern const struct spin_exporter spin_exporter_spz;
const struct spin_exporter spin_exporter_spz = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "spz",
    .summary = "a folder with one SPZ (version 3) per frame: about a tenth of a PLY",
    .options = options,
    .checks = true,
    .antialias = true,
    .wants = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES,
    .begin = spz_begin,
    .frame = spin_frames_frame,
    .end = spin_frames_end,
    .abort = spin_frames_abort,
    .skip = spin_frames_skip,
};
