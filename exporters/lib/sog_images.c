#include "exporters/lib/sog_images.h"

#include "base/base.h"
#include "io/file.h"
#include "math/sh.h"

/* A codebook is reused if its squared error is at most this multiple of the squared error of a new
 * codebook. */
#define KEEP_BOOK 1.1

static size_t n_rest(const struct spin_sog_images *x) { return spin_n_rest(x->rows->sh_degree); }

/* ---- Bounding box, codebooks and palette ----------------------------------------------------- */

static spin_status make_room(struct spin_sog_images *x)
{
    size_t n = x->rows->n_kept + 1, width = n_rest(x) + 1;

    SPIN_TRY(spin_grow(n, 3 * sizeof *x->scales, (void **)&x->scales));
    SPIN_TRY(spin_grow(n, 3 * sizeof *x->dc, (void **)&x->dc));
    SPIN_TRY(spin_grow(n, width * sizeof *x->rest, (void **)&x->rest));
    SPIN_TRY(spin_grow(n, sizeof *x->label, (void **)&x->label));
    return spin_grow(spin_sog_palette(n - 1), width * sizeof *x->palette, (void **)&x->palette);
}

static void gather_task(void *context, size_t i, size_t end)
{
    struct spin_sog_images *x = context;
    size_t width = n_rest(x);
    size_t n_sh = 3 * (size_t)spin_splat_rows_n_sh(x->rows);
    float room[3 * SPIN_SH_MAX];

    for (; i < end; i++) {
        size_t row = x->order[i].row;
        const float *sh = spin_splat_rows_sh(x->rows, row, room);

        memcpy(x->scales + 3 * i, x->rows->splats->log_scales + 3 * row, 3 * sizeof *x->scales);
        memcpy(x->dc + 3 * i, sh, 3 * sizeof *x->dc);
        memset(x->rest + width * i, 0, width * sizeof *x->rest);
        memcpy(x->rest + width * i, sh + 3, (n_sh - 3) * sizeof *x->rest);
    }
}

static void grow_box(struct spin_sog_images *x)
{
    float place[3];

    for (size_t i = 0; i < x->rows->n_kept; i++) {
        spin_splat_rows_place(x->rows, x->order[i].row, place);
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

static spin_status choose_book(const struct spin_sog_images *x, const float *values, size_t n,
                               float book[SPIN_CODEBOOK])
{
    float own[SPIN_CODEBOOK];

    SPIN_TRY(spin_codebook_make(values, n, own));
    if (!x->begun || error_of(book, values, n) > KEEP_BOOK * error_of(own, values, n))
        memcpy(book, own, sizeof own);
    return SPIN_OK;
}

static spin_status choose_coding(struct spin_sog_images *x, bool antialias)
{
    const struct spin_splat_rows *rows = x->rows;
    size_t n = rows->n_kept;

    SPIN_TRY(make_room(x));
    spin_pool_rows(rows->pool, n, SPIN_ROWS_BLOCK, gather_task, x);
    x->sog.n = n;
    x->sog.sh_degree = rows->sh_degree;
    x->sog.antialias = antialias;
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

static spin_status blank_pictures(struct spin_sog_images *x)
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

static void code_row(const struct spin_sog_images *x, size_t i, struct spin_quant_error *quant)
{
    const struct spin_sog *sog = &x->sog;
    struct spin_gaussian is, shown;
    uint8_t *at[SPIN_SOG_PICTURES];

    for (int p = 0; p < SPIN_SOG_CENTROIDS; p++)
        at[p] = x->picture[p].rgba + 4 * i;
    spin_splat_rows_get(x->rows, x->order[i].row, &is);
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
    struct spin_sog_images *x = context;
    size_t width = n_rest(x);
    struct spin_quant_error *quant = &x->block_quant[i / SPIN_ROWS_BLOCK];
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
static void code_palette(struct spin_sog_images *x)
{
    uint8_t *to = x->picture[SPIN_SOG_CENTROIDS].rgba;
    size_t n = x->sog.sh_degree > 0 && x->sog.n > 0 ? x->sog.n_palette * n_rest(x) : 0;

    for (size_t i = 0; i < n; i++)
        to[i / 3 * 4 + i % 3] = spin_codebook_nearest(x->sog.sh_n, x->palette[i]);
}

spin_status spin_sog_images_encode(struct spin_sog_images *x, const struct spin_splat_rows *rows,
                                   bool antialias, const struct spin_keyed *order,
                                   struct spin_quant_error *block_quant)
{
    x->rows = rows;
    x->order = order;
    x->block_quant = block_quant;
    SPIN_TRY(choose_coding(x, antialias));
    SPIN_TRY(blank_pictures(x));
    spin_pool_rows(rows->pool, x->sog.n, SPIN_ROWS_BLOCK, code_task, x);
    code_palette(x);
    spin_pictures_pack(x->picture, SPIN_SOG_PICTURES, x->level, rows->pool);
    return SPIN_OK;
}

/* ---- Files ----------------------------------------------------------------------------------- */

static spin_status write_members(struct spin_sog_images *x, struct spin_zip_writer *zip)
{
    SPIN_FREED char *meta = NULL;
    size_t n_meta;

    SPIN_TRY(spin_sog_meta(&x->sog, &meta, &n_meta));
    SPIN_TRY(spin_zip_member_whole(zip, "meta.json", meta, n_meta, NULL, 0));
    return spin_pictures_write(x->picture, SPIN_SOG_PICTURES, zip);
}

spin_status spin_sog_images_write_zip(struct spin_sog_images *x, struct spin_out *out)
{
    struct spin_zip_writer zip;
    spin_status status;

    spin_zip_writer_begin(out, &zip);
    status = spin_zip_writer_end(&zip, write_members(x, &zip), out);
    spin_pictures_free(x->picture, SPIN_SOG_PICTURES, false);
    return status;
}

static spin_status write_file(const char *folder, const char *name, const void *data, size_t n,
                              bool sync, uint64_t *bytes)
{
    SPIN_FREED char *path = NULL;

    SPIN_TRY(spin_path_join(folder, name, &path));
    *bytes += n;
    return spin_out_whole(path, data, n, sync);
}

spin_status spin_sog_images_write_folder(struct spin_sog_images *x, const char *folder, bool sync,
                                         uint64_t *bytes)
{
    SPIN_FREED char *meta = NULL;
    spin_status status = SPIN_OK;
    size_t n_meta;

    *bytes = 0;
    SPIN_TRY_OUT(spin_sog_meta(&x->sog, &meta, &n_meta));
    SPIN_TRY_OUT(write_file(folder, "meta.json", meta, n_meta, sync, bytes));
    for (int i = 0; i < SPIN_SOG_PICTURES; i++) {
        const struct spin_picture *p = &x->picture[i];

        if (p->width == 0)
            continue;
        if (p->status != SPIN_OK)
            SPIN_TRY_OUT(spin_fail(p->status, "%s: %s", p->name, p->why));
        SPIN_TRY_OUT(write_file(folder, p->name, p->file, p->n_file, sync, bytes));
    }
out:
    spin_pictures_free(x->picture, SPIN_SOG_PICTURES, false);
    return status;
}

uint64_t spin_sog_images_most_bytes(int sh_degree, size_t n)
{
    size_t width = spin_n_rest(sh_degree);
    uint64_t of_sh = 2 * (uint64_t)n + (uint64_t)spin_sog_palette(n) * width;

    return 16384 + 20 * (uint64_t)n + (width > 0 ? of_sh : 0);
}

void spin_sog_images_free(struct spin_sog_images *x)
{
    spin_pictures_free(x->picture, SPIN_SOG_PICTURES, true);
    free(x->scales);
    free(x->dc);
    free(x->rest);
    free(x->label);
    free(x->palette);
}
