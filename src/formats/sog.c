#include "formats/sog.h"

#include "base/base.h"
#include "io/json.h"
#include "io/webp.h"
#include "io/zip.h"
#include "math/quat.h"

#define VERSION 2
#define STEPS 65535.0 /* largest 16-bit code of a coordinate */
#define TAG 252       /* mode byte of a rotation: 252 + index of the largest of w x y z */
#define SQRT2 1.41421356237309505f
#define MAX_META (1u << 20)
#define MAX_COUNT ((int64_t)SPIN_WEBP_MAX_SIDE * SPIN_WEBP_MAX_SIDE)
#define SLACK 4096 /* an image of n splats may have at most 2 n + SLACK pixels */
/* A splat has about 12 bytes in the image files. If a file declares more than n + MOST_SPLATS
 * splats for images of n bytes, it is refused as a decompression bomb. */
#define MOST_SPLATS (1u << 20)

/* For each image: its name in the zip, the object of meta.json whose list `files` contains the
 * name, and the index of the name in this list. */
static const struct {
    const char *name, *object;
    size_t place;
} pictures[SPIN_SOG_PICTURES] = {
    {"means_l.webp", "means", 0},     {"means_u.webp", "means", 1}, {"quats.webp", "quats", 0},
    {"scales.webp", "scales", 0},     {"sh0.webp", "sh0", 0},       {"shN_labels.webp", "shN", 1},
    {"shN_centroids.webp", "shN", 0},
};

const char *spin_sog_name(enum spin_sog_picture picture) { return pictures[picture].name; }

static int n_vectors(int sh_degree) { return (sh_degree + 1) * (sh_degree + 1) - 1; }

void spin_sog_size(const struct spin_sog *sog, enum spin_sog_picture picture, int *width,
                   int *height)
{
    size_t lines = (sog->n_palette + SPIN_SOG_PALETTE_LINE - 1) / SPIN_SOG_PALETTE_LINE;

    *width = *height = 0;
    if (picture >= SPIN_SOG_LABELS && sog->sh_degree == 0)
        return;
    if (picture == SPIN_SOG_CENTROIDS) {
        *width = SPIN_SOG_PALETTE_LINE * n_vectors(sog->sh_degree);
        *height = lines > 0 ? (int)lines : 1;
        return;
    }
    /* The images are nearly square; their sides are multiples of 4. */
    *width = sog->n > 0 ? (int)ceil(sqrt((double)sog->n) / 4) * 4 : 4;
    *height = sog->n > 0 ? (int)ceil((double)sog->n / *width / 4) * 4 : 4;
}

size_t spin_sog_palette(size_t n)
{
    size_t k = 1024;

    while (k < SPIN_SOG_MAX_PALETTE && 2 * k <= n)
        k *= 2;
    return k;
}

/* ---- Writing --------------------------------------------------------------------------------- */

double spin_sog_log(double v) { return copysign(log1p(fabs(v)), v); }

double spin_sog_unlog(double v) { return copysign(expm1(fabs(v)), v); }

float spin_sog_number(const struct spin_sog_range *range, bool linear, size_t c, unsigned q,
                      double steps)
{
    double v = range->mins[c] + (range->maxs[c] - range->mins[c]) * q / steps;

    return (float)(linear ? v : spin_sog_unlog(v));
}

void spin_sog_code(const struct spin_sog_range *range, bool linear, size_t n, const float *v,
                   uint8_t *low, uint8_t *high, float *shown)
{
    double steps = high ? STEPS : 255;

    for (size_t c = 0; c < n; c++) {
        double width = range->maxs[c] - range->mins[c];
        double at = (linear ? (double)v[c] : spin_sog_log((double)v[c])) - range->mins[c];
        unsigned q = width > 0 ? (unsigned)lrint(fmin(fmax(at / width, 0), 1) * steps) : 0;

        low[c] = (uint8_t)q;
        if (high)
            high[c] = (uint8_t)(q >> 8);
        shown[c] = spin_sog_number(range, linear, c, q, steps);
    }
}

bool spin_sog_rotation(const uint8_t pixel[4], float q[4])
{
    int largest = pixel[3] - TAG, from = 0;
    float rest = 1;

    if (largest < 0)
        return false;
    for (int k = 0; k < 4; k++) {
        if (k == largest)
            continue;
        q[k] = ((float)pixel[from++] / 255 * 2 - 1) / SQRT2;
        rest -= q[k] * q[k];
    }
    q[largest] = sqrtf(spin_maxf(rest, 0));
    spin_quat_normalise(q);
    return true;
}

void spin_sog_code_rotation(const float q[4], uint8_t out[4], float shown[4])
{
    int largest = spin_largest_of_4(q), to = 0;
    float sign = q[largest] < 0 ? -1 : 1;

    for (int k = 0; k < 4; k++)
        if (k != largest)
            out[to++] = spin_byte_of((sign * q[k] * SQRT2 * 0.5f + 0.5f) * 255);
    out[3] = (uint8_t)(TAG + largest);
    spin_sog_rotation(out, shown);
    for (int k = 0; k < 4 && q[largest] < 0; k++) /* same sign as q */
        shown[k] = -shown[k];
}

static void print_book(FILE *to, const float book[SPIN_CODEBOOK])
{
    fprintf(to, "\"codebook\":[");
    for (int k = 0; k < SPIN_CODEBOOK; k++)
        fprintf(to, "%s%.6g", k ? "," : "", (double)book[k]);
    fprintf(to, "],");
}

static void print_files(FILE *to, const char *object)
{
    fprintf(to, "\"files\":[");
    for (size_t place = 0; place < 2; place++)
        for (int p = 0; p < SPIN_SOG_PICTURES; p++)
            if (strcmp(pictures[p].object, object) == 0 && pictures[p].place == place)
                fprintf(to, "%s\"%s\"", place ? "," : "", pictures[p].name);
    fprintf(to, "]}");
}

static void print_meta(FILE *to, const struct spin_sog *sog)
{
    const struct spin_sog_range *m = &sog->means;

    fprintf(to, "{\"version\":%d,\"asset\":{\"generator\":\"spin4d %s\"},\"count\":%zu,", VERSION,
            SPIN_VERSION, sog->n);
    if (sog->antialias)
        fprintf(to, "\"model\":\"" SPIN_SOG_ANTIALIASED "\",");
    fprintf(to, "\"means\":{\"mins\":[%.17g,%.17g,%.17g],\"maxs\":[%.17g,%.17g,%.17g],", m->mins[0],
            m->mins[1], m->mins[2], m->maxs[0], m->maxs[1], m->maxs[2]);
    print_files(to, "means");
    fprintf(to, ",\"scales\":{");
    print_book(to, sog->scales);
    print_files(to, "scales");
    fprintf(to, ",\"quats\":{");
    print_files(to, "quats");
    fprintf(to, ",\"sh0\":{");
    print_book(to, sog->sh0);
    print_files(to, "sh0");
    if (sog->sh_degree > 0) {
        fprintf(to, ",\"shN\":{\"count\":%zu,\"bands\":%d,", sog->n_palette, sog->sh_degree);
        print_book(to, sog->sh_n);
        print_files(to, "shN");
    }
    fprintf(to, "}\n");
}

spin_status spin_sog_meta(const struct spin_sog *sog, char **text, size_t *n)
{
    FILE *to = spin_text_open(text, n);

    if (!to)
        return spin_fail(SPIN_E_MEMORY, "not enough memory for meta.json");
    print_meta(to, sog);
    if (fclose(to) != 0)
        return spin_fail(SPIN_E_MEMORY, "not enough memory for meta.json");
    return SPIN_OK;
}

/* ---- A file that is being read --------------------------------------------------------------- */

struct reading {
    struct spin_zip zip;
    /* Folder with the files of an unpacked SOG; NULL: the files are in the zip. */
    const char *folder;
    spin_json *meta;
    struct spin_sog sog;
    /* Tables with the values of bytes 0..255 of the images, from codebooks (version 2) or ranges
     * (version 1). */
    float scale[3][SPIN_CODEBOOK], dc[3][SPIN_CODEBOOK], logit[SPIN_CODEBOOK];
    struct {
        const unsigned char *data;
        size_t size;
        void *owned;         /* memory with the data of a compressed zip member; else NULL */
        struct spin_map map; /* mapped file with the data, if they are in `folder` */
        int width, height;
    } file[SPIN_SOG_PICTURES];
};

static void close_reading(struct reading *r)
{
    for (int p = 0; p < SPIN_SOG_PICTURES; p++) {
        free(r->file[p].owned);
        spin_map_close(&r->file[p].map);
    }
    spin_json_free(r->meta);
    spin_zip_close(&r->zip);
}

/* ---- meta.json ------------------------------------------------------------------------------- */

static spin_status read_numbers(const spin_json *object, const char *key, size_t n, double *out)
{
    const spin_json *list = spin_json_get(object, key);

    for (size_t i = 0; i < n; i++)
        if (spin_json_length(list) != n || !spin_json_number(spin_json_at(list, i), &out[i]) ||
            fabs(out[i]) > 1e9)
            return spin_malformed("SOG: '%s' is not a list of %zu numbers of at most 1e9", key, n);
    return SPIN_OK;
}

/* Reads a codebook. Some writers store null as the first value, which the reader then extrapolates
 * from the other values. */
static spin_status read_book(const spin_json *meta, const char *key, float book[SPIN_CODEBOOK])
{
    const spin_json *list = spin_json_get(spin_json_get(meta, key), "codebook");
    double value[SPIN_CODEBOOK];

    for (size_t k = SPIN_CODEBOOK; k-- > 0;) {
        const spin_json *json = spin_json_at(list, k);

        if (k == 0 && spin_json_is_null(json))
            value[0] = value[1] + (value[1] - value[SPIN_CODEBOOK - 1]) / (SPIN_CODEBOOK - 1);
        else if (spin_json_length(list) != SPIN_CODEBOOK || !spin_json_number(json, &value[k]) ||
                 fabs(value[k]) > 1e9)
            return spin_malformed("SOG: '%s.codebook' is not a list of %d numbers of at most 1e9",
                                  key, SPIN_CODEBOOK);
        book[k] = (float)value[k];
    }
    return SPIN_OK;
}

/* Reads an integer and checks that it is in [least, most]. */
static spin_status check_count(const spin_json *json, const char *key, int64_t least, int64_t most,
                               int64_t *out)
{
    if (!spin_json_integer(json, out) || *out < least || *out > most)
        return spin_malformed("SOG: '%s' is not an integer from %lld to %lld", key,
                              (long long)least, (long long)most);
    return SPIN_OK;
}

static spin_status parse_2(struct reading *r, int64_t *count)
{
    const spin_json *meta = r->meta, *sh_n = spin_json_get(meta, "shN");
    const char *model = spin_json_string(spin_json_get(meta, "model"));
    int64_t bands = 0, n_palette = 0;

    SPIN_TRY(check_count(spin_json_get(meta, "count"), "count", 0, MAX_COUNT, count));
    r->sog.antialias = model && strcmp(model, SPIN_SOG_ANTIALIASED) == 0;
    SPIN_TRY(read_book(meta, "scales", r->sog.scales));
    SPIN_TRY(read_book(meta, "sh0", r->sog.sh0));
    for (int c = 0; c < 3; c++) {
        memcpy(r->scale[c], r->sog.scales, sizeof r->scale[c]);
        memcpy(r->dc[c], r->sog.sh0, sizeof r->dc[c]);
    }
    for (int k = 0; k < SPIN_CODEBOOK; k++)
        r->logit[k] = spin_byte_logit((unsigned char)k);
    if (sh_n) {
        SPIN_TRY(check_count(spin_json_get(sh_n, "bands"), "bands", 1, 3, &bands));
        SPIN_TRY(check_count(spin_json_get(sh_n, "count"), "count", 1, SPIN_SOG_MAX_PALETTE,
                             &n_palette));
        SPIN_TRY(read_book(meta, "shN", r->sog.sh_n));
    }
    r->sog.sh_degree = (int)bands;
    r->sog.n_palette = (size_t)n_palette;
    return SPIN_OK;
}

static void fill_range(double least, double largest, float out[SPIN_CODEBOOK])
{
    for (int k = 0; k < SPIN_CODEBOOK; k++)
        out[k] = (float)(least + (largest - least) * k / (SPIN_CODEBOOK - 1));
}

static spin_status read_ranges(const spin_json *meta, const char *key, size_t n, float *const out[])
{
    const spin_json *object = spin_json_get(meta, key);
    double mins[4], maxs[4];

    SPIN_TRY(read_numbers(object, "mins", n, mins));
    SPIN_TRY(read_numbers(object, "maxs", n, maxs));
    for (size_t c = 0; c < n; c++)
        fill_range(mins[c], maxs[c], out[c]);
    return SPIN_OK;
}

/* Reads 'shN' of version 1, which does not contain the number of palette vectors. open_picture()
 * derives this number from the size of the palette's image. */
static spin_status parse_1_sh(struct reading *r, const spin_json *sh_n)
{
    const spin_json *shape = spin_json_get(sh_n, "shape");
    int64_t n_rest = 0;
    double least, largest;

    SPIN_TRY(check_count(spin_json_at(shape, 1), "shape", 9, 45, &n_rest));
    for (int degree = 1; degree <= 3; degree++)
        if (spin_n_rest(degree) == (size_t)n_rest)
            r->sog.sh_degree = degree;
    if (r->sog.sh_degree == 0 || !spin_json_number(spin_json_get(sh_n, "mins"), &least) ||
        !spin_json_number(spin_json_get(sh_n, "maxs"), &largest) || fabs(least) > 1e9 ||
        fabs(largest) > 1e9)
        return spin_malformed("SOG: 'shN' has no valid 'shape', 'mins' and 'maxs'");
    fill_range(least, largest, r->sog.sh_n);
    return SPIN_OK;
}

static spin_status parse_1(struct reading *r, int64_t *count)
{
    const spin_json *meta = r->meta, *sh_n = spin_json_get(meta, "shN");
    const char *encoding =
        spin_json_string(spin_json_get(spin_json_get(meta, "quats"), "encoding"));
    float *const scale[3] = {r->scale[0], r->scale[1], r->scale[2]};
    float *const colour[4] = {r->dc[0], r->dc[1], r->dc[2], r->logit};

    if (!encoding || strcmp(encoding, "quaternion_packed") != 0)
        return spin_unsupported("SOG version 1: 'quats.encoding' is '%.60s', expected "
                                "'quaternion_packed'",
                                encoding ? encoding : "");
    SPIN_TRY(check_count(spin_json_at(spin_json_get(spin_json_get(meta, "means"), "shape"), 0),
                         "shape", 0, MAX_COUNT, count));
    SPIN_TRY(read_ranges(meta, "scales", 3, scale));
    SPIN_TRY(read_ranges(meta, "sh0", 4, colour));
    return sh_n ? parse_1_sh(r, sh_n) : SPIN_OK;
}

static spin_status parse_meta(struct reading *r)
{
    const spin_json *version = spin_json_get(r->meta, "version");
    int64_t number = 1, count = 0;

    if (version && (!spin_json_integer(version, &number) || number < 1 || number > VERSION))
        return spin_unsupported("SOG: version %lld, expected 1 or %d%s", (long long)number, VERSION,
                                number == 4 ? " (4 is TSOG: use --from tsog)" : "");
    r->sog.version = (int)number;
    SPIN_TRY(number == 1 ? parse_1(r, &count) : parse_2(r, &count));
    r->sog.n = (size_t)count;
    SPIN_TRY(read_numbers(spin_json_get(r->meta, "means"), "mins", 3, r->sog.means.mins));
    return read_numbers(spin_json_get(r->meta, "means"), "maxs", 3, r->sog.means.maxs);
}

/* ---- The files ------------------------------------------------------------------------------- */

static spin_status open_meta(struct reading *r, const void *file, size_t size)
{
    const struct spin_zip_member *member;
    const unsigned char *data = file;
    SPIN_FREED void *owned = NULL;

    if (!r->folder) {
        SPIN_TRY(spin_zip_parse("SOG", file, size, &r->zip));
        member = spin_zip_find(&r->zip, "meta.json");
        size = member ? (size_t)member->size : SIZE_MAX;
        if (size <= MAX_META)
            SPIN_TRY(spin_zip_read(&r->zip, member, true, MAX_META, &data, &owned));
    }
    if (size > MAX_META)
        return spin_malformed("SOG: meta.json is missing or above 1 MiB");
    SPIN_TRY(spin_json_parse("meta.json", (const char *)data, size, &r->meta));
    return parse_meta(r);
}

/* Finds the WebP data of an image in the folder or in the zip. */
static spin_status find_picture(struct reading *r, enum spin_sog_picture p)
{
    const spin_json *files = spin_json_get(spin_json_get(r->meta, pictures[p].object), "files");
    const char *name = spin_json_string(spin_json_at(files, pictures[p].place));
    const struct spin_zip_member *member = NULL;
    char *path = NULL;
    spin_status status;

    if (r->folder && name && *name && !strchr(name, '/')) {
        SPIN_TRY(spin_path_join(r->folder, name, &path));
        status = spin_map_open(path, &r->file[p].map);
        free(path);
        r->file[p].data = r->file[p].map.data;
        r->file[p].size = r->file[p].map.size;
        return status;
    }
    if (!r->folder && name)
        member = spin_zip_find(&r->zip, name);
    if (!member)
        return spin_malformed("SOG: image '%s' is missing", pictures[p].name);
    r->file[p].size = (size_t)member->size;
    return spin_zip_read(&r->zip, member, true, r->zip.map.size, &r->file[p].data,
                         &r->file[p].owned);
}

/* Finds an image and checks that it has enough pixels for its values, but not many more. */
static spin_status open_picture(struct reading *r, enum spin_sog_picture p)
{
    int least_width, least_height, width, height;
    int64_t least, pixels;

    spin_sog_size(&r->sog, p, &least_width, &least_height);
    if (least_width == 0)
        return SPIN_OK;
    SPIN_TRY(find_picture(r, p));
    SPIN_TRY(spin_webp_size(r->file[p].data, r->file[p].size, &width, &height));
    if (p == SPIN_SOG_CENTROIDS && r->sog.version == 1) {
        r->sog.n_palette = (size_t)height * SPIN_SOG_PALETTE_LINE;
        if (r->sog.n_palette > SPIN_SOG_MAX_PALETTE)
            r->sog.n_palette = SPIN_SOG_MAX_PALETTE;
        spin_sog_size(&r->sog, p, &least_width, &least_height);
    }
    least = p == SPIN_SOG_CENTROIDS ? (int64_t)least_width * least_height : (int64_t)r->sog.n;
    pixels = (int64_t)width * height;
    if (pixels < least || pixels > 2 * least + SLACK ||
        (p == SPIN_SOG_CENTROIDS && width != least_width))
        return spin_malformed(
            "SOG: image '%s' has %dx%d pixels, too few or too many for its contents",
            pictures[p].name, width, height);
    r->file[p].width = width;
    r->file[p].height = height;
    return SPIN_OK;
}

static spin_status open_reading(const void *file, size_t size, struct reading *r)
{
    uint64_t n_bytes = 0;

    SPIN_TRY(open_meta(r, file, size));
    for (int p = 0; p < SPIN_SOG_PICTURES; p++) {
        SPIN_TRY(open_picture(r, (enum spin_sog_picture)p));
        n_bytes += r->file[p].size;
    }
    if (r->sog.n > n_bytes + MOST_SPLATS)
        return spin_malformed("SOG: a file of %llu bytes cannot contain %zu splats",
                              (unsigned long long)n_bytes, r->sog.n);
    return SPIN_OK;
}

spin_status spin_sog_peek(const void *file, size_t size, const char *folder, struct spin_sog *out)
{
    struct reading r = {.folder = folder};
    spin_status status = open_reading(file, size, &r);

    *out = r.sog;
    close_reading(&r);
    return status;
}

/* ---- Pixels ---------------------------------------------------------------------------------- */

static spin_status read_picture(const struct reading *r, enum spin_sog_picture p, uint8_t **out)
{
    size_t n = (size_t)r->file[p].width * (size_t)r->file[p].height;

    free(*out);
    *out = NULL;
    SPIN_TRY(spin_alloc(n, 4, (void **)out));
    return spin_webp_read(r->file[p].data, r->file[p].size, r->file[p].width, r->file[p].height,
                          *out);
}

static spin_status read_means(const struct reading *r, uint8_t **a, uint8_t **b, float *means)
{
    SPIN_TRY(read_picture(r, SPIN_SOG_MEANS_LOW, a));
    SPIN_TRY(read_picture(r, SPIN_SOG_MEANS_HIGH, b));
    for (size_t i = 0; i < r->sog.n; i++)
        for (size_t c = 0; c < 3; c++)
            means[3 * i + c] = spin_sog_number(
                &r->sog.means, false, c, (*a)[4 * i + c] | (unsigned)(*b)[4 * i + c] << 8, STEPS);
    return spin_check_finite("means", means, r->sog.n, 3);
}

static spin_status read_quats(const struct reading *r, uint8_t **a, float *quats)
{
    SPIN_TRY(read_picture(r, SPIN_SOG_QUATS, a));
    for (size_t i = 0; i < r->sog.n; i++)
        if (!spin_sog_rotation(*a + 4 * i, quats + 4 * i))
            return spin_malformed("SOG: rotation %zu has the invalid mode byte %d", i,
                                  (*a)[4 * i + 3]);
    return SPIN_OK;
}

static spin_status read_sh_0(const struct reading *r, uint8_t **a, unsigned columns,
                             struct spin_splats *out)
{
    size_t n_sh = 3 + spin_n_rest(out->sh_degree);

    SPIN_TRY(read_picture(r, SPIN_SOG_SH0, a));
    for (size_t i = 0; i < r->sog.n; i++) {
        for (size_t c = 0; c < 3 && (columns & SPIN_COL_SH); c++)
            out->sh[n_sh * i + c] = r->dc[c][(*a)[4 * i + c]];
        if (columns & SPIN_COL_LOGIT_OPACITIES)
            out->logit_opacities[i] = r->logit[(*a)[4 * i + 3]];
    }
    return SPIN_OK;
}

static spin_status read_sh_n(const struct reading *r, uint8_t **a, uint8_t **b,
                             struct spin_splats *out)
{
    size_t n_vec = (size_t)n_vectors(r->sog.sh_degree);

    SPIN_TRY(read_picture(r, SPIN_SOG_LABELS, a));
    SPIN_TRY(read_picture(r, SPIN_SOG_CENTROIDS, b));
    for (size_t i = 0; i < r->sog.n; i++) {
        size_t label = (*a)[4 * i] | (size_t)(*a)[4 * i + 1] << 8;
        const uint8_t *pixel = *b + 4 * n_vec * label; /* image rows are 64 whole vectors */

        if (label >= r->sog.n_palette)
            return spin_malformed("SOG: splat %zu has SH vector %zu, but the palette has only %zu "
                                  "vectors, counted from 0",
                                  i, label, r->sog.n_palette);
        for (size_t k = 0; k < n_vec; k++)
            for (size_t c = 0; c < 3; c++)
                out->sh[(3 + 3 * n_vec) * i + 3 + 3 * k + c] = r->sog.sh_n[pixel[4 * k + c]];
    }
    return SPIN_OK;
}

static spin_status read_pixels(const struct reading *r, unsigned columns, struct spin_splats *out)
{
    SPIN_FREED uint8_t *a = NULL, *b = NULL;

    if (columns & SPIN_COL_MEANS)
        SPIN_TRY(read_means(r, &a, &b, out->means));
    if (columns & SPIN_COL_QUATS)
        SPIN_TRY(read_quats(r, &a, out->quats));
    if (columns & SPIN_COL_LOG_SCALES) {
        SPIN_TRY(read_picture(r, SPIN_SOG_SCALES, &a));
        for (size_t i = 0; i < r->sog.n; i++)
            for (size_t c = 0; c < 3; c++)
                out->log_scales[3 * i + c] = r->scale[c][a[4 * i + c]];
    }
    if (columns & (SPIN_COL_SH | SPIN_COL_LOGIT_OPACITIES))
        SPIN_TRY(read_sh_0(r, &a, columns, out));
    if ((columns & SPIN_COL_SH) && r->sog.sh_degree > 0)
        SPIN_TRY(read_sh_n(r, &a, &b, out));
    return SPIN_OK;
}

spin_status spin_sog_read(const void *file, size_t size, const char *folder, unsigned columns,
                          struct spin_splats *out)
{
    SPIN_LEAVES(close_reading) struct reading r = {.folder = folder};

    SPIN_TRY(open_reading(file, size, &r));
    SPIN_TRY(spin_splats_reserve(out, r.sog.n, columns, r.sog.sh_degree));
    out->antialias = r.sog.antialias;
    return read_pixels(&r, columns, out);
}
