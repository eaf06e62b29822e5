/* Writes one SOG per frame, PlayCanvas's compact format (formats/sog.h). The axes are those of the
 * training, unless --up or --rotate rotates the scene. Rows are in Morton order, since WebP
 * compresses better if neighbouring pixels are similar splats.
 *
 * Codes of static splats should not change from frame to frame. For this, the bounding box of
 * positions only grows, and codebooks of an earlier frame are reused if their error is close to
 * that of new ones. The palette of SH is not reused: each frame has its own. */
#include "base/base.h"
#include "exporters/lib/frames.h"
#include "exporters/lib/pictures.h"
#include "formats/sog.h"
#include "io/webp.h"
#include "math/sh.h"

/* A codebook is reused if its squared error is at most this multiple of the squared error of a new
 * codebook. */
#define KEEP_BOOK 1.1

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
    struct spin_sog sog;
    struct spin_picture picture[SPIN_SOG_PICTURES];
    int level;
    bool begun; /* true: `sog` contains the bounding box and the codebooks of an earlier frame */

    /* The following members describe the current frame; rows are in the order of the file. */
    float *scales, *dc; /* [n][3] logarithms of scales; SH coefficients of degree 0 */
    float *rest;        /* [n][n_rest] SH coefficients above degree 0 */
    uint32_t *label;    /* [n] palette index of each splat */
    float *palette;     /* [n_palette][n_rest] */
};

static size_t n_rest(const struct export *x) { return spin_n_rest(x->frames.rows.sh_degree); }

/* ---- Bounding box, codebooks and palette ----------------------------------------------------- */

static spin_status make_room(struct export *x)
{
    size_t n = x->frames.rows.n_kept + 1, width = n_rest(x) + 1;

    SPIN_TRY(spin_grow(n, 3 * sizeof *x->scales, (void **)&x->scales));
    SPIN_TRY(spin_grow(n, 3 * sizeof *x->dc, (void **)&x->dc));
    SPIN_TRY(spin_grow(n, width * sizeof *x->rest, (void **)&x->rest));
    SPIN_TRY(spin_grow(n, sizeof *x->label, (void **)&x->label));
    return spin_grow(spin_sog_palette(n - 1), width * sizeof *x->palette, (void **)&x->palette);
}

static void gather_task(void *context, size_t i, size_t end)
{
    struct export *x = context;
    const struct spin_splat_rows *rows = &x->frames.rows;
    size_t width = n_rest(x);
    size_t n_sh = 3 * (size_t)spin_splat_rows_n_sh(rows);
    float room[3 * SPIN_SH_MAX];

    for (; i < end; i++) {
        size_t row = x->frames.order.item[i].row;
        const float *sh = spin_splat_rows_sh(rows, row, room);

        memcpy(x->scales + 3 * i, rows->splats->log_scales + 3 * row, 3 * sizeof *x->scales);
        memcpy(x->dc + 3 * i, sh, 3 * sizeof *x->dc);
        memset(x->rest + width * i, 0, width * sizeof *x->rest);
        memcpy(x->rest + width * i, sh + 3, (n_sh - 3) * sizeof *x->rest);
    }
}

static void grow_box(struct export *x)
{
    const struct spin_splat_rows *rows = &x->frames.rows;
    float place[3];

    for (size_t i = 0; i < rows->n_kept; i++) {
        spin_splat_rows_place(rows, x->frames.order.item[i].row, place);
        for (int c = 0; c < 3; c++) {
            double v = spin_sog_log((double)place[c]);

            if (!x->begun && i == 0)
                x->sog.means.mins[c] = x->sog.means.maxs[c] = v;
            x->sog.means.mins[c] = fmin(x->sog.means.mins[c], v);
            x->sog.means.maxs[c] = fmax(x->sog.means.maxs[c], v);
        }
    }
}

static double error_of(const float book[SPIN_CODEBOOK], const float *values, size_t n)
{
    double sum = 0;

    for (size_t i = 0; i < n; i++) {
        double e = (double)values[i] - (double)book[spin_codebook_nearest(book, values[i])];

        sum += e * e;
    }
    return sum;
}

static spin_status choose_book(const struct export *x, const float *values, size_t n,
                               float book[SPIN_CODEBOOK])
{
    float own[SPIN_CODEBOOK];

    SPIN_TRY(spin_codebook_make(values, n, own));
    if (!x->begun || error_of(book, values, n) > KEEP_BOOK * error_of(own, values, n))
        memcpy(book, own, sizeof own);
    return SPIN_OK;
}

static spin_status choose_coding(struct export *x)
{
    const struct spin_splat_rows *rows = &x->frames.rows;
    size_t n = rows->n_kept;

    SPIN_TRY(make_room(x));
    spin_pool_rows(rows->pool, n, SPIN_ROWS_BLOCK, gather_task, x);
    x->sog.n = n;
    x->sog.sh_degree = rows->sh_degree;
    x->sog.antialias = x->frames.job->antialias;
    grow_box(x);
    SPIN_TRY(choose_book(x, x->scales, 3 * n, x->sog.scales));
    SPIN_TRY(choose_book(x, x->dc, 3 * n, x->sog.sh0));
    x->sog.n_palette = 0;
    if (rows->sh_degree > 0) {
        SPIN_TRY(spin_palette_make(x->rest, n, n_rest(x), spin_sog_palette(n), rows->pool, x->label,
                                   x->palette, &x->sog.n_palette));
        SPIN_TRY(spin_codebook_make(x->palette, x->sog.n_palette * n_rest(x), x->sog.sh_n));
        x->sog.n_palette = x->sog.n_palette > 0 ? x->sog.n_palette : 1;
    }
    x->begun |= n > 0;
    return SPIN_OK;
}

/* ---- Images ---------------------------------------------------------------------------------- */

static spin_status blank_pictures(struct export *x)
{
    for (int p = 0; p < SPIN_SOG_PICTURES; p++) {
        int width, height;

        spin_sog_size(&x->sog, (enum spin_sog_picture)p, &width, &height);
        snprintf(x->picture[p].name, sizeof x->picture[p].name, "%s",
                 spin_sog_name((enum spin_sog_picture)p));
        SPIN_TRY(spin_picture_blank(&x->picture[p], width, height));
    }
    return SPIN_OK;
}

static void code_row(const struct export *x, size_t i, struct spin_quant_error *quant)
{
    const struct spin_splat_rows *rows = &x->frames.rows;
    const struct spin_sog *sog = &x->sog;
    struct spin_gaussian is, shown;
    uint8_t *at[SPIN_SOG_PICTURES];

    for (int p = 0; p < SPIN_SOG_CENTROIDS; p++)
        at[p] = x->picture[p].rgba + 4 * i;
    spin_splat_rows_get(rows, x->frames.order.item[i].row, &is);
    spin_sog_code(&sog->means, false, 3, is.place, at[SPIN_SOG_MEANS_LOW], at[SPIN_SOG_MEANS_HIGH],
                  shown.place);
    spin_sog_code_rotation(is.rotation, at[SPIN_SOG_QUATS], shown.rotation);
    for (size_t c = 0; c < 3; c++) {
        uint8_t scale = spin_codebook_nearest(sog->scales, is.log_scale[c]);
        uint8_t dc = spin_codebook_nearest(sog->sh0, x->dc[3 * i + c]);

        at[SPIN_SOG_SCALES][c] = scale;
        at[SPIN_SOG_SH0][c] = dc;
        shown.log_scale[c] = sog->scales[scale];
        shown.colour[c] = 0.5f + (float)SPIN_SH_C0 * sog->sh0[dc];
    }
    at[SPIN_SOG_SH0][3] = spin_byte_of(is.opacity * 255);
    shown.opacity = (float)at[SPIN_SOG_SH0][3] / 255;
    spin_quant_error_row(quant, &is, &shown);
    if (sog->sh_degree > 0) {
        at[SPIN_SOG_LABELS][0] = (uint8_t)x->label[i];
        at[SPIN_SOG_LABELS][1] = (uint8_t)(x->label[i] >> 8);
    }
}

static void code_task(void *context, size_t i, size_t end)
{
    struct export *x = context;
    size_t width = n_rest(x);
    struct spin_quant_error *quant = &x->frames.block_quant[i / SPIN_ROWS_BLOCK];
    float lost[3 * SPIN_SH_MAX];

    for (; i < end; i++) {
        code_row(x, i, quant);
        if (x->sog.sh_degree == 0)
            continue;
        for (size_t k = 0; k < width; k++) {
            float shown = x->palette[width * x->label[i] + k];

            lost[k] =
                x->rest[width * i + k] - x->sog.sh_n[spin_codebook_nearest(x->sog.sh_n, shown)];
        }
        spin_quant_error_add_sh(quant, lost, width);
    }
}

/* Copies the palette, as indices into its codebook, to the image of the palette. A row of the image
 * contains exactly 64 vectors, so consecutive vectors are consecutive pixels. */
static void code_palette(struct export *x)
{
    uint8_t *to = x->picture[SPIN_SOG_CENTROIDS].rgba;
    size_t n = x->sog.sh_degree > 0 && x->sog.n > 0 ? x->sog.n_palette * n_rest(x) : 0;

    for (size_t i = 0; i < n; i++)
        to[i / 3 * 4 + i % 3] = spin_codebook_nearest(x->sog.sh_n, x->palette[i]);
}

/* ---- One file -------------------------------------------------------------------------------- */

static spin_status write_members(struct export *x, struct spin_zip_writer *zip)
{
    SPIN_FREED char *meta = NULL;
    size_t n_meta;

    SPIN_TRY(spin_sog_meta(&x->sog, &meta, &n_meta));
    SPIN_TRY(spin_zip_member_whole(zip, "meta.json", meta, n_meta, NULL, 0));
    return spin_pictures_write(x->picture, SPIN_SOG_PICTURES, zip);
}

static spin_status sog_write(void *self, const struct spin_frame_info *info, struct spin_out *out)
{
    struct export *x = self;
    const struct spin_splat_rows *rows = &x->frames.rows;
    struct spin_zip_writer zip;
    spin_status status;

    (void)info;
    SPIN_TRY(spin_frames_order(&x->frames));
    SPIN_TRY(choose_coding(x));
    SPIN_TRY(blank_pictures(x));
    spin_pool_rows(rows->pool, x->sog.n, SPIN_ROWS_BLOCK, code_task, x);
    code_palette(x);
    spin_pictures_pack(x->picture, SPIN_SOG_PICTURES, x->level, rows->pool);
    for (size_t b = 0; b < spin_splat_rows_blocks(rows); b++)
        spin_splat_rows_release(rows, b, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES);
    spin_zip_writer_begin(out, &zip);
    status = spin_zip_writer_end(&zip, write_members(x, &zip), out);
    spin_pictures_free(x->picture, SPIN_SOG_PICTURES, false);
    return status;
}

static uint64_t sog_bytes(const void *self, size_t n)
{
    const struct export *x = self;
    uint64_t of_sh = 2 * (uint64_t)n + (uint64_t)spin_sog_palette(n) * n_rest(x);

    return 16384 + 20 * (uint64_t)n + (n_rest(x) > 0 ? of_sh : 0);
}

/* ---- The plug-in ----------------------------------------------------------------------------- */

static spin_status parse_options(void *self, const struct spin_export_job *job)
{
    struct export *x = self;

    x->frames.sort = spin_sort_rows_by_place;
    x->level = 3;
    SPIN_TRY(spin_option_count(job->values, "level", 0, 9, &x->level));
    return spin_webp_need();
}

static void free_export(void *self)
{
    struct export *x = self;

    spin_pictures_free(x->picture, SPIN_SOG_PICTURES, true);
    free(x->scales);
    free(x->dc);
    free(x->rest);
    free(x->label);
    free(x->palette);
}

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
