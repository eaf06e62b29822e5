#include "formats/sog_4d.h"

#include <float.h>

#include "base/base.h"
#include "io/webp.h"

#define MAX_META (4u << 20)
#define MAX_PICTURE (512u << 20)
#define MAX_COUNT ((int64_t)SPIN_WEBP_MAX_SIDE * SPIN_WEBP_MAX_SIDE)
#define SLACK 4096             /* an image of n splats may have at most 2 n + SLACK pixels */
#define MOST_SPLATS (1u << 20) /* a file of n bytes may have at most n + MOST_SPLATS splats */

/* ---- meta.json ------------------------------------------------------------------------------- */

spin_status spin_sog_4d_integer(const struct spin_sog_4d *r, const spin_json *j, const char *name,
                                int64_t least, int64_t most, int64_t *out)
{
    if (!spin_json_integer(j, out) || *out < least || *out > most)
        return spin_malformed("%s: '%s' is not an integer from %lld to %lld", r->what, name,
                              (long long)least, (long long)most);
    return SPIN_OK;
}

spin_status spin_sog_4d_number(const struct spin_sog_4d *r, const spin_json *j, const char *name,
                               double *out)
{
    if (!spin_json_number(j, out) || !(fabs(*out) <= (double)FLT_MAX))
        return spin_malformed("%s: '%s' is not a number in the range of a float", r->what, name);
    return SPIN_OK;
}

static spin_status read_list(const struct spin_sog_4d *r, const spin_json *list, const char *name,
                             size_t n, double *out)
{
    if (spin_json_length(list) != n)
        return spin_malformed("%s: '%s' is not a list of %zu numbers", r->what, name, n);
    for (size_t i = 0; i < n; i++)
        SPIN_TRY(spin_sog_4d_number(r, spin_json_at(list, i), name, &out[i]));
    return SPIN_OK;
}

spin_status spin_sog_4d_range(const struct spin_sog_4d *r, const spin_json *mins,
                              const spin_json *maxs, const char *name, size_t n,
                              struct spin_sog_range *out)
{
    SPIN_TRY(read_list(r, mins, name, n, out->mins));
    SPIN_TRY(read_list(r, maxs, name, n, out->maxs));
    for (size_t c = 0; c < n; c++)
        if (out->mins[c] > out->maxs[c])
            return spin_malformed("%s: '%s' has a minimum above its maximum", r->what, name);
    return SPIN_OK;
}

spin_status spin_sog_4d_book(const struct spin_sog_4d *r, const spin_json *j, const char *name,
                             size_t least, struct spin_sog_book *out)
{
    size_t n = spin_json_length(j);
    double value[SPIN_CODEBOOK];

    if (n < least || n > SPIN_CODEBOOK)
        return spin_malformed("%s: '%s.codebook' has %zu numbers, expected %zu to %d", r->what,
                              name, n, least, SPIN_CODEBOOK);
    SPIN_TRY(read_list(r, j, name, n, value));
    out->n = n;
    for (size_t k = 0; k < n; k++)
        out->value[k] = (float)value[k];
    return SPIN_OK;
}

bool spin_sog_4d_name_is_plain(const char *name)
{
    for (const char *at = name;; at++) {
        size_t n = strcspn(at, "/");

        if (n == 0 || (n <= 2 && strspn(at, ".") == n))
            return false;
        at += n;
        if (!*at)
            break;
    }
    for (const char *at = name; *at; at++)
        if ((unsigned char)*at < 32 || *at == 127 || strchr("\\:?#", *at))
            return false;
    return true;
}

spin_status spin_sog_4d_files(struct spin_sog_4d *r, const spin_json *object, const char *name,
                              size_t least, size_t most, enum spin_sog_4d_picture first)
{
    const spin_json *files = spin_json_get(object, "files");
    size_t n = spin_json_length(files);

    if (n < least || n > most)
        return spin_malformed("%s: '%s.files' lists %zu files, expected %zu", r->what, name, n,
                              most);
    for (size_t i = 0; i < n; i++) {
        const char *file = spin_json_string(spin_json_at(files, i));

        if (!file || !spin_sog_4d_name_is_plain(file) || strcmp(file, "meta.json") == 0 ||
            (i > 0 && strcmp(file, r->name[first]) == 0))
            return spin_malformed(
                "%s: '%s.files' lists '%.60s', which is not a valid name of an image", r->what,
                name, file ? file : "");
        r->name[first + i] = file;
    }
    return SPIN_OK;
}

spin_status spin_sog_4d_still(struct spin_sog_4d *r, size_t least)
{
    const spin_json *means = spin_json_get(r->meta, "means");
    const spin_json *scales = spin_json_get(r->meta, "scales");
    const spin_json *sh0 = spin_json_get(r->meta, "sh0"), *sh_n = spin_json_get(r->meta, "shN");
    const char *model = spin_json_string(spin_json_get(r->meta, "model"));
    int64_t n = 0, bands = 0, n_palette = 0;

    SPIN_TRY(spin_sog_4d_integer(r, spin_json_get(r->meta, "count"), "count", 1, MAX_COUNT, &n));
    if ((uint64_t)n > r->zip.map.size + MOST_SPLATS)
        return spin_malformed("%s: a file of %zu bytes cannot contain %lld splats", r->what,
                              r->zip.map.size, (long long)n);
    r->n = (size_t)n;
    r->antialias = model && strcmp(model, SPIN_SOG_ANTIALIASED) == 0;
    SPIN_TRY(spin_sog_4d_range(r, spin_json_get(means, "mins"), spin_json_get(means, "maxs"),
                               "means", 3, &r->means));
    SPIN_TRY(spin_sog_4d_files(r, means, "means", 2, 2, SPIN_4D_MEANS));
    SPIN_TRY(spin_sog_4d_book(r, spin_json_get(scales, "codebook"), "scales", least, &r->scales));
    SPIN_TRY(spin_sog_4d_files(r, scales, "scales", 1, 1, SPIN_4D_SCALES));
    SPIN_TRY(spin_sog_4d_files(r, spin_json_get(r->meta, "quats"), "quats", 1, 1, SPIN_4D_QUATS));
    SPIN_TRY(spin_sog_4d_book(r, spin_json_get(sh0, "codebook"), "sh0", least, &r->sh0));
    SPIN_TRY(spin_sog_4d_files(r, sh0, "sh0", 1, 1, SPIN_4D_SH0));
    if (!sh_n)
        return SPIN_OK;
    SPIN_TRY(spin_sog_4d_integer(r, spin_json_get(sh_n, "bands"), "bands", 1, 3, &bands));
    SPIN_TRY(spin_sog_4d_integer(r, spin_json_get(sh_n, "count"), "count of shN", 1,
                                 SPIN_SOG_MAX_PALETTE, &n_palette));
    SPIN_TRY(spin_sog_4d_book(r, spin_json_get(sh_n, "codebook"), "shN", least, &r->sh_n));
    r->sh_degree = (int)bands;
    r->n_palette = (size_t)n_palette;
    return spin_sog_4d_files(r, sh_n, "shN", 2, 2, SPIN_4D_CENTROIDS);
}

/* ---- The file -------------------------------------------------------------------------------- */

spin_status spin_sog_4d_open(const char *what, const void *file, size_t size,
                             struct spin_sog_4d *out)
{
    const struct spin_zip_member *member;
    const unsigned char *data;
    SPIN_FREED void *owned = NULL;

    *out = (struct spin_sog_4d){.what = what, .opacity.n = SPIN_CODEBOOK};
    for (int k = 0; k < SPIN_CODEBOOK; k++)
        out->opacity.value[k] = spin_byte_logit((unsigned char)k);
    SPIN_TRY(spin_zip_parse(what, file, size, &out->zip));
    member = spin_zip_find(&out->zip, "meta.json");
    if (!member || member->size > MAX_META)
        return spin_malformed("%s: meta.json is missing or above 4 MiB", what);
    SPIN_TRY(spin_zip_read(&out->zip, member, true, MAX_META, &data, &owned));
    return spin_json_parse("meta.json", (const char *)data, (size_t)member->size, &out->meta);
}

void spin_sog_4d_close(struct spin_sog_4d *r)
{
    free(r->centroids);
    spin_json_free(r->meta);
    spin_zip_close(&r->zip);
}

/* ---- Images ---------------------------------------------------------------------------------- */

/* A set of images of the same size, which contain n splats: the rows of *out from `first` on. */
struct set {
    struct spin_sog_4d *r;
    const char *folder; /* folder of the images in the zip; NULL: the root */
    size_t first, n;
    int width, height; /* size of the images; 0: not yet known */
    /* Scratch memory: pixels of the current image, and of the image with the high bytes. */
    uint8_t *low, *high;
    struct spin_splats_4d *out;
};

static spin_status decode_image(const struct spin_sog_4d *r, const void *data, size_t size,
                                struct set *set, uint8_t **out)
{
    size_t n_vec = spin_n_rest(r->sh_degree) / 3 * SPIN_SOG_PALETTE_LINE;
    size_t n = set ? set->n : n_vec * ((r->n_palette + 63) / SPIN_SOG_PALETTE_LINE), pixels;
    int width, height;

    SPIN_TRY(spin_webp_lossless(data, size, &width, &height));
    pixels = (size_t)width * (size_t)height;
    if (pixels < n || pixels > 2 * n + SLACK || (!set && (size_t)width != n_vec) ||
        (set && set->width > 0 && (set->width != width || set->height != height)))
        return spin_malformed("size of %dx%d pixels, too few or too many for the splats", width,
                              height);
    if (set) {
        set->width = width;
        set->height = height;
    }
    free(*out);
    *out = NULL;
    SPIN_TRY(spin_alloc(pixels, 4, (void **)out));
    return spin_webp_read(data, size, width, height, *out);
}

/* Reads an image of a set, or the palette if set is NULL. */
static spin_status open_picture(const struct spin_sog_4d *r, enum spin_sog_4d_picture p,
                                struct set *set, uint8_t **out)
{
    const char *folder = set ? set->folder : NULL;
    const struct spin_zip_member *member;
    const unsigned char *data;
    SPIN_FREED void *owned = NULL;
    SPIN_FREED char *name = NULL;
    spin_status status;

    if (folder)
        SPIN_TRY(spin_path_join(folder, r->name[p], &name));
    else
        SPIN_TRY(spin_strdup(r->name[p], &name));
    member = spin_zip_find(&r->zip, name);
    status = member ? spin_zip_read(&r->zip, member, true, MAX_PICTURE, &data, &owned)
                    : spin_malformed("the file is missing");
    if (status == SPIN_OK)
        status = decode_image(r, data, (size_t)member->size, set, out);
    return spin_fail_context(status, "%s: image '%s'", r->what, name);
}

/* Dequantises channels of image p. If image p + 1 exists, it contains the high bytes of 16-bit
 * codes; otherwise codes have 8 bits. Channel c of row i is written to to[c][step * i]. The list
 * `to` ends with NULL. */
static spin_status read_numbers(struct set *set, enum spin_sog_4d_picture p,
                                const struct spin_sog_range *range, bool linear, float *to[4],
                                size_t step)
{
    bool wide = set->r->name[p + 1] != NULL;

    SPIN_TRY(open_picture(set->r, p, set, &set->low));
    if (wide)
        SPIN_TRY(open_picture(set->r, (enum spin_sog_4d_picture)(p + 1), set, &set->high));
    for (size_t c = 0; to[c]; c++)
        for (size_t i = 0; i < set->n; i++) {
            unsigned q = set->low[4 * i + c] | (wide ? (unsigned)set->high[4 * i + c] << 8 : 0);

            to[c][step * i] = spin_sog_number(range, linear, c, q, wide ? 65535 : 255);
            if (!isfinite(to[c][step * i]))
                return spin_malformed("%s: image '%s': splat %zu is not finite", set->r->what,
                                      set->r->name[p], i);
        }
    return SPIN_OK;
}

/* Decodes channels of image p, which are indices in codebooks. Channel c of row i is written to
 * to[c][step[c] * i]. The list `to` ends with NULL. */
static spin_status read_books(struct set *set, enum spin_sog_4d_picture p,
                              const struct spin_sog_book *const book[4], float *to[5],
                              const size_t step[4])
{
    SPIN_TRY(open_picture(set->r, p, set, &set->low));
    for (size_t c = 0; to[c]; c++)
        for (size_t i = 0; i < set->n; i++) {
            uint8_t k = set->low[4 * i + c];

            if (k >= book[c]->n)
                return spin_malformed("%s: image '%s': splat %zu has index %d in a codebook of %zu",
                                      set->r->what, set->r->name[p], i, k, book[c]->n);
            to[c][step[c] * i] = book[c]->value[k];
        }
    return SPIN_OK;
}

static spin_status read_quats(struct set *set, float *quats)
{
    SPIN_TRY(open_picture(set->r, SPIN_4D_QUATS, set, &set->low));
    for (size_t i = 0; i < set->n; i++)
        if (!spin_sog_rotation(set->low + 4 * i, quats + 4 * i))
            return spin_malformed("%s: image '%s': rotation %zu has the invalid mode byte %d",
                                  set->r->what, set->r->name[SPIN_4D_QUATS], i,
                                  set->low[4 * i + 3]);
    return SPIN_OK;
}

static spin_status read_rest(struct set *set, float *sh, size_t width)
{
    struct spin_sog_4d *r = set->r;
    size_t n_vec = width / 3 - 1;

    if (!r->centroids)
        SPIN_TRY(open_picture(r, SPIN_4D_CENTROIDS, NULL, &r->centroids));
    SPIN_TRY(open_picture(r, SPIN_4D_LABELS, set, &set->low));
    for (size_t i = 0; i < set->n; i++) {
        size_t label = set->low[4 * i] | (size_t)set->low[4 * i + 1] << 8;
        /* An image row is exactly 64 vectors, so vectors are contiguous. */
        const uint8_t *pixel = r->centroids + 4 * n_vec * label;

        if (label >= r->n_palette)
            return spin_malformed("%s: splat %zu has SH vector %zu, but the palette has only %zu "
                                  "vectors, counted from 0",
                                  r->what, i, label, r->n_palette);
        for (size_t k = 0; k < 3 * n_vec; k++) {
            uint8_t entry = pixel[k / 3 * 4 + k % 3];

            if (entry >= r->sh_n.n)
                return spin_malformed("%s: the palette has index %d in a codebook of %zu", r->what,
                                      entry, r->sh_n.n);
            sh[width * i + 3 + k] = r->sh_n.value[entry];
        }
    }
    return SPIN_OK;
}

static spin_status read_time(struct set *set, float *times, float *sigmas)
{
    const struct spin_sog_4d *r = set->r;

    if (!r->name[SPIN_4D_TIME]) {
        for (size_t i = 0; i < set->n; i++) {
            times[i] = 0;
            sigmas[i] = SPIN_FOREVER;
        }
        return SPIN_OK;
    }
    if (r->centre.n > 0)
        return read_books(set, SPIN_4D_TIME,
                          (const struct spin_sog_book *const[4]){&r->centre, &r->sigma},
                          (float *[5]){times, sigmas}, (const size_t[4]){1, 1});
    return read_numbers(set, SPIN_4D_TIME, &r->time, true, (float *[4]){times, sigmas}, 1);
}

static spin_status read_set(struct set *set)
{
    const struct spin_sog_4d *r = set->r;
    const struct spin_splats_4d *o = set->out;
    const struct spin_sog_book *s = &r->scales, *dc = &r->sh0;
    size_t i = set->first, step = 3 * (size_t)o->degree, n_sh = 3 + spin_n_rest(o->sh_degree);
    float *x = o->centres + 3 * i, *scale = o->log_scales + 3 * i, *sh = o->sh + n_sh * i;
    float *path = o->degree > 0 ? o->paths + step * i : NULL;

    SPIN_TRY(read_numbers(set, SPIN_4D_MEANS, &r->means, false, (float *[4]){x, x + 1, x + 2}, 3));
    if (path)
        SPIN_TRY(read_numbers(set, SPIN_4D_MOTION, &r->motion, r->linear,
                              (float *[4]){path, path + 1, path + 2}, step));
    if (o->degree > 1)
        SPIN_TRY(read_numbers(set, SPIN_4D_ACCEL, &r->accel, false,
                              (float *[4]){path + 3, path + 4, path + 5}, step));
    SPIN_TRY(read_books(set, SPIN_4D_SCALES, (const struct spin_sog_book *const[4]){s, s, s},
                        (float *[5]){scale, scale + 1, scale + 2}, (const size_t[4]){3, 3, 3}));
    SPIN_TRY(read_books(set, SPIN_4D_SH0,
                        (const struct spin_sog_book *const[4]){dc, dc, dc, &r->opacity},
                        (float *[5]){sh, sh + 1, sh + 2, o->logit_opacities + i},
                        (const size_t[4]){n_sh, n_sh, n_sh, 1}));
    SPIN_TRY(read_quats(set, o->quats + 4 * i));
    SPIN_TRY(read_time(set, o->times + i, o->sigmas + i));
    return o->sh_degree > 0 ? read_rest(set, sh, n_sh) : SPIN_OK;
}

spin_status spin_sog_4d_rows(struct spin_sog_4d *r, const char *folder, size_t first, size_t n,
                             struct spin_splats_4d *out)
{
    struct set set = {.r = r, .folder = folder, .first = first, .n = n, .out = out};
    spin_status status = read_set(&set);

    free(set.low);
    free(set.high);
    return status;
}
