/* Writes one SPZ per frame (formats/spz.h).
 *
 * Positions have 12 fractional bits, as in the reference implementation, which allow coordinates up
 * to 2048. A frame with larger coordinates and all later frames are written with fewer fractional
 * bits, so that static splats have the same bytes in all of these frames.
 *
 * The format does not define its axes. --axes source writes the axes of the training, like
 * splat-transform. --axes rub rotates the scene by 180 degrees about x, to x right, y up, z back,
 * the axes of Niantic's library. */
#include "base/base.h"
#include "exporters/lib/frames.h"
#include "formats/spz.h"
#include "io/compress.h"

#define MAX_SH 45 /* largest number of SH coefficients above degree 0 of a splat */

static const struct spin_plugin_option options[] = {
    SPIN_FRAMES_OPTIONS("frame_%05d.spz"),
    SPIN_FRAMES_OPTION_FPS,
    SPIN_ROWS_OPTION_SH,
    {"axes", "source|rub", "axes to write; rub: half a turn about x, to x right, y up, z back",
     "source"},
    {"spz-version", "4|3", "version of the format: 4 (zstd streams) or 3 (gzip)", "4"},
    {"level", "N", "effort of gzip or zstd, 1 (fast) to 9 (small)", "1"},
    {0},
};

struct export
{
    struct spin_frames frames;
    int version, level;
    int fraction; /* number of fractional bits of the positions */
    /* Output of the compressor: one stream in version 4, the whole file in version 3. */
    unsigned char *packed; /* [n_packed_room] */
    size_t n_packed_room;
    /* The table of contents; only version 4 has one. */
    unsigned char toc[SPIN_SPZ_STREAMS * SPIN_SPZ_TOC_ENTRY];
    /* Input of the compressor: one stream in version 4, the whole file in version 3. */
    unsigned char *bytes;

    /* The following members describe the current stream: one attribute of all rows. */
    int stream;
    size_t width;      /* bytes per row */
    unsigned char *to; /* [n_kept][width] */
};

/* ---- Streams --------------------------------------------------------------------------------- */

/* Quantises the current attribute of row i, and adds the error (the value of the source minus the
 * decoded value) to quant. */
static void code_row(const struct export *x, size_t i, unsigned char *out,
                     struct spin_quant_error *quant)
{
    const struct spin_splat_rows *rows = &x->frames.rows;
    float is[4], shown[4], room[3 * SPIN_SH_MAX], lost[MAX_SH];
    const float *scale = rows->splats->log_scales + 3 * i;

    switch (x->stream) {
    case SPIN_SPZ_PLACE:
        spin_splat_rows_place(rows, i, is);
        spin_spz_code_place(is, x->fraction, out, shown);
        spin_quant_error_add_place(quant, is, shown);
        break;
    case SPIN_SPZ_ALPHA:
        is[0] = spin_splat_rows_opacity(rows, i);
        out[0] = spin_spz_code_alpha(is[0], shown);
        spin_quant_error_add(quant, SPIN_QUANT_OPACITY, (double)is[0] - shown[0]);
        break;
    case SPIN_SPZ_COLOUR:
        spin_splat_rows_colour(rows, i, is);
        spin_spz_code_colour(is, out, shown);
        spin_quant_error_add_3(quant, SPIN_QUANT_COLOUR, is, shown);
        break;
    case SPIN_SPZ_SCALE:
        spin_spz_code_scale(scale, out, shown);
        spin_quant_error_add_3(quant, SPIN_QUANT_SCALE, scale, shown);
        break;
    case SPIN_SPZ_ROTATION:
        spin_splat_rows_turned(rows, i, is);
        spin_spz_code_rotation(is, out, shown);
        spin_quant_error_add_rotation(quant, is, shown);
        break;
    default:
        spin_spz_code_sh(spin_splat_rows_sh(rows, i, room), spin_splat_rows_n_sh(rows),
                         rows->sh_degree, out, lost);
        spin_quant_error_add_sh(quant, lost, x->width);
    }
}

/* ---- One file -------------------------------------------------------------------------------- */

static void code_block(void *context, int task)
{
    const struct export *x = context;
    const struct spin_splat_rows *rows = &x->frames.rows;
    size_t b = (size_t)task, i = b * SPIN_ROWS_BLOCK, end = i + SPIN_ROWS_BLOCK;
    unsigned char *out = x->to + spin_splat_rows_before(rows, b) * x->width;

    for (end = end < rows->splats->n ? end : rows->splats->n; i < end; i++) {
        if (rows->keep[i]) {
            code_row(x, i, out, &x->frames.block_quant[b]);
            out += x->width;
        }
    }
    spin_splat_rows_release(rows, b, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES);
}

/* Quantises one attribute of all rows into `to`, and returns the number of bytes. */
static size_t code_stream(struct export *x, int stream, unsigned char *to)
{
    const struct spin_splat_rows *rows = &x->frames.rows;

    x->stream = stream;
    x->width = spin_spz_width(stream, rows->sh_degree);
    x->to = to;
    spin_pool_run(rows->pool, (int)spin_splat_rows_blocks(rows), code_block, x);
    return rows->n_kept * x->width;
}

/* Writes one attribute as a zstd frame, and sets its entry in the table of contents. */
static spin_status write_stream(struct export *x, int stream, struct spin_out *out)
{
    size_t n = code_stream(x, stream, x->bytes), n_packed;

    if (n == 0)
        return SPIN_OK;
    SPIN_TRY(spin_zstd_write(x->bytes, n, x->level, &x->packed, &x->n_packed_room, &n_packed));
    spin_spz_code_toc_entry(n_packed, n, x->toc + (size_t)stream * SPIN_SPZ_TOC_ENTRY);
    return spin_out_write(out, x->packed, n_packed);
}

/* Chooses the largest number of fractional bits with which all positions of the frame can be
 * stored, but no more bits than in the previous frame. */
static spin_status choose_fraction(struct export *x, int number)
{
    const struct spin_splat_rows *rows = &x->frames.rows;
    int before = x->fraction;
    float largest = 0, place[3];

    for (size_t i = 0; i < rows->splats->n; i++) {
        if (!rows->keep[i])
            continue;
        spin_splat_rows_place(rows, i, place);
        for (int c = 0; c < 3; c++)
            largest = spin_maxf(largest, fabsf(place[c]));
    }
    x->fraction = spin_spz_fraction(largest, before);
    if (x->fraction < 0)
        return spin_unsupported("frame %d: a coordinate of a splat is %g, but spz cannot store "
                                "more than 8388606: drop the splat with --crop",
                                number, (double)largest);
    if (x->fraction < before)
        spin_warn(
            "frame %d: a coordinate of a splat is %g: to store it, positions of this and all later "
            "frames are rounded to steps of 1/%d",
            number, (double)largest, 1 << x->fraction);
    return SPIN_OK;
}

static struct spin_spz_header header_of(const struct export *x)
{
    return (struct spin_spz_header){.n = x->frames.rows.n_kept,
                                    .sh_degree = x->frames.rows.sh_degree,
                                    .fraction = x->fraction,
                                    .antialias = x->frames.job->antialias,
                                    .version = x->version};
}

static spin_status write_version_3(struct export *x, struct spin_out *out)
{
    const struct spin_spz_header header = header_of(x);
    size_t n = spin_spz_code_header(&header, x->bytes), n_packed;

    for (int stream = 0; stream < SPIN_SPZ_STREAMS; stream++)
        n += code_stream(x, stream, x->bytes + n);
    SPIN_TRY(spin_gzip_write(x->frames.rows.pool, x->level, x->bytes, n, &x->packed,
                             &x->n_packed_room, &n_packed));
    return spin_out_write(out, x->packed, n_packed);
}

/* Writes the table of contents twice: first to reserve its bytes, and again when the sizes of the
 * streams are known. */
static spin_status write_version_4(struct export *x, struct spin_out *out)
{
    const struct spin_spz_header header = header_of(x);
    size_t n_toc = (size_t)spin_spz_n_streams(&header) * SPIN_SPZ_TOC_ENTRY;
    unsigned char bytes[SPIN_SPZ_HEADER_4];
    uint64_t length;

    SPIN_TRY(spin_out_write(out, bytes, spin_spz_code_header(&header, bytes)));
    SPIN_TRY(spin_out_write(out, x->toc, n_toc));
    for (int stream = 0; stream < SPIN_SPZ_STREAMS; stream++)
        SPIN_TRY(write_stream(x, stream, out));
    /* spin_out_write_at() requires a flushed buffer, and spin_out_length() flushes it. */
    SPIN_TRY(spin_out_length(out, &length));
    return spin_out_write_at(out, SPIN_SPZ_HEADER_4, x->toc, n_toc);
}

/* Allocates x->bytes: in version 4 for the largest stream of the frame, in version 3 for all
 * streams. */
static spin_status reserve_bytes(struct export *x)
{
    const struct spin_splat_rows *rows = &x->frames.rows;
    size_t n = SPIN_SPZ_HEADER_4;

    for (int stream = 0; stream < SPIN_SPZ_STREAMS; stream++) {
        size_t bytes = rows->n_kept * spin_spz_width(stream, rows->sh_degree);

        n = x->version == 3 ? n + bytes : bytes > n ? bytes : n;
    }
    return spin_grow(n, 1, (void **)&x->bytes);
}

static spin_status spz_write(void *self, const struct spin_frame_info *info, struct spin_out *out)
{
    struct export *x = self;

    SPIN_TRY(choose_fraction(x, info->number));
    SPIN_TRY(reserve_bytes(x));
    return x->version == 4 ? write_version_4(x, out) : write_version_3(x, out);
}

/* Returns an upper bound on the file size: incompressible data grow by the overhead of a gzip
 * stream or, in version 4, of one zstd frame per stream. */
static uint64_t spz_bytes(const void *self, size_t n)
{
    const struct export *x = self;
    uint64_t bytes = spin_spz_bytes(n, x->frames.rows.sh_degree);

    return x->version == 4 ? bytes + bytes / 256 + 512 : bytes + bytes / 2000 + 64;
}

/* ---- The plug-in ----------------------------------------------------------------------------- */

static spin_status parse_options(void *self, const struct spin_export_job *job)
{
    static const double half_about_x[4] = {0, 1, 0, 0};
    const struct spin_plugin_values *v = job->values;
    struct export *x = self;
    int axes, version;

    SPIN_TRY(spin_option_word(v, "axes", "source|rub", &axes));
    SPIN_TRY(spin_option_word(v, "spz-version", "4|3", &version));
    x->version = 4 - version;
    x->level = 1;
    SPIN_TRY(spin_option_count(v, "level", 1, 9, &x->level));
    if (axes == 1 && spin_plugin_value(v, "up", NULL))
        return spin_misuse(
            "--axes rub and --up exclude each other: rub assumes that y points down");
    x->frames.axes = axes == 1 ? half_about_x : NULL;
    x->fraction = SPIN_SPZ_FRACTION;
    if (x->version == 4)
        SPIN_TRY_IN(spin_zstd_need(), "SPZ version 4 (--spz-version 3 needs no zstd)");
    return SPIN_OK;
}

static void free_export(void *self)
{
    struct export *x = self;

    free(x->bytes);
    free(x->packed);
}

static const struct spin_frames_format format = {
    .name = "spz",
    .pattern = "frame_%05d.spz",
    .self_bytes = sizeof(struct export),
    .lossy = true,
    .packed = true,
    .clips_colours = true,
    .begin = parse_options,
    .bytes = spz_bytes,
    .write = spz_write,
    .end = free_export,
};

SPIN_FRAMES_EXPORTER(
    spz, "spz",
    .summary = "a folder with one SPZ (version 3 or 4) per frame: a tenth to a quarter of a PLY",
    .options = options, .checks = true, .antialias = true);
