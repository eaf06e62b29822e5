/* Stores the words of an array as planes of bytes, column by column. Bytes that are similar in
 * consecutive rows (signs, exponents, high bytes) become neighbours in the file, and deflate
 * compresses them well. */
#include "scene/bundle_pack.h"

#include "base/base.h"

/* PORTION: number of values that are written at a time. GROUP: number of columns that are gathered
 * in one pass over the rows. */
enum { PORTION = 1 << 15, GROUP = 16 };

/* The words of an array, row by row. */
struct words {
    uint64_t n_rows, width;
    uint32_t *at;
    /* true: words are integers, in units of 1 / per_unit; false: bit patterns of floats */
    bool whole;
};

struct spin_pack_series {
    char name[64];
    float *per_unit; /* [n_units], reciprocal of each column's unit; NULL: words are floats */
    size_t n_units;
    bool written;     /* whether at least one array was written */
    struct words key; /* words of frame 0 */
    /* Value of "xor_rows" for this series: one number per frame written so far. NULL if the series
     * is a single array for the whole clip. */
    spin_json *rows;
};

/* ---- One array ------------------------------------------------------------------------------- */

spin_status spin_pack_write(struct spin_zip_writer *w, const char *name, int n_dims,
                            const uint64_t *shape, spin_pack_read_fn read, void *context)
{
    uint64_t planes[SPIN_NPY_MAX_DIMS] = {4}, count = 1;
    uint32_t values[PORTION];
    unsigned char bytes[PORTION];

    for (int d = 0; d < n_dims; d++) {
        planes[d + 1] = shape[d];
        count *= shape[d];
    }
    SPIN_TRY(spin_npz_write_begin_deflated(w, name, "|u1", n_dims + 1, planes));
    for (int plane = 0; plane < 4; plane++)
        for (uint64_t first = 0; first < count; first += PORTION) {
            size_t n = count - first < PORTION ? (size_t)(count - first) : PORTION;

            SPIN_TRY(read(context, first, n, values));
            for (size_t i = 0; i < n; i++)
                bytes[i] = (unsigned char)(values[i] >> 8 * plane);
            SPIN_TRY(spin_zip_member_write(w, bytes, n));
        }
    return spin_zip_member_end(w);
}

static spin_status read_words(void *context, uint64_t first, size_t n, uint32_t *to)
{
    memcpy(to, (const uint32_t *)context + first, n * sizeof *to);
    return SPIN_OK;
}

static spin_status write_bytes(struct spin_zip_writer *w, const unsigned char *bytes, uint64_t n)
{
    for (uint64_t first = 0; first < n; first += PORTION)
        SPIN_TRY(spin_zip_member_write(w, bytes + first,
                                       (size_t)(n - first < PORTION ? n - first : PORTION)));
    return SPIN_OK;
}

/* Writes the planes column by column. Each pass over the rows gathers 16 columns, whose words in
 * one row fill a cache line. */
static spin_status write_columns(struct spin_zip_writer *w, const char *name, int n_dims,
                                 const uint64_t *shape, const struct words *words, bool quick)
{
    uint64_t dims[SPIN_NPY_MAX_DIMS] = {1};
    uint32_t any = 0;
    SPIN_FREED unsigned char *bytes = NULL;
    spin_status status = SPIN_OK;

    for (uint64_t i = 0; i < words->n_rows * words->width; i++)
        any |= words->at[i];
    while (dims[0] < 4 && any >> 8 * dims[0] != 0)
        dims[0]++;
    memcpy(dims + 1, shape + 1, (size_t)(n_dims - 1) * sizeof *dims);
    dims[n_dims] = shape[0];
    SPIN_TRY(spin_npz_write_begin_deflated(w, name, "|i1", n_dims + 1, dims));
    if (quick && words->width >= SPIN_WIDE)
        spin_zip_member_runs(w);
    SPIN_TRY(spin_alloc((size_t)words->n_rows + 1, GROUP, (void **)&bytes));
    for (uint64_t plane = 0; plane < dims[0] && status == SPIN_OK; plane++)
        for (uint64_t first = 0; first < words->width && status == SPIN_OK; first += GROUP) {
            uint64_t n = words->width - first < GROUP ? words->width - first : GROUP;

            for (uint64_t i = 0; i < words->n_rows; i++)
                for (uint64_t c = 0; c < n; c++)
                    bytes[c * words->n_rows + i] =
                        (unsigned char)(words->at[i * words->width + first + c] >> 8 * plane);
            for (uint64_t c = 0; c < n && status == SPIN_OK; c++)
                status = write_bytes(w, bytes + c * words->n_rows, words->n_rows);
        }
    return status == SPIN_OK ? spin_zip_member_end(w) : status;
}

/* ---- Series ---------------------------------------------------------------------------------- */

/* Estimates the compressed size in bits if the first `rows` rows are XORed with the key: the sum
 * over the planes of the entropy of their bytes. */
static double estimate_bits(const struct words *words, const uint32_t *key, uint64_t rows)
{
    uint64_t seen[4][256] = {{0}}, count = words->n_rows * words->width,
             n_key = rows * words->width;
    double bits = 0;

    for (uint64_t i = 0; i < count; i++) {
        uint32_t word = words->at[i] ^ (i < n_key ? key[i] : 0);

        for (int plane = 0; plane < 4; plane++)
            seen[plane][word >> 8 * plane & 255]++;
    }
    for (int i = 0; i < 4 * 256; i++)
        if (seen[i / 256][i % 256] > 0)
            bits += (double)seen[i / 256][i % 256] *
                    log2((double)count / (double)seen[i / 256][i % 256]);
    return bits;
}

/* Chooses how many rows, from the first on, to XOR with frame 0: none, all, or those up to the last
 * row that is equal in this frame and in frame 0. */
static uint64_t choose_rows(const struct spin_pack_series *s, const struct words *words)
{
    uint64_t width = words->width, best = 0;
    uint64_t all = words->n_rows < s->key.n_rows ? words->n_rows : s->key.n_rows, same = all;
    uint64_t tried[3];
    double least = INFINITY;

    if (!s->key.at || s->key.width != width || s->key.whole != words->whole)
        return 0;
    while (same > 0 && memcmp(words->at + width * (same - 1), s->key.at + width * (same - 1),
                              width * sizeof *words->at) != 0)
        same--;
    tried[0] = 0;
    tried[1] = same;
    tried[2] = all;
    for (int i = 0; i < 3; i++) {
        double bits = estimate_bits(words, s->key.at, tried[i]);

        if (bits < 0.99 * least) {
            least = bits;
            best = tried[i];
        }
    }
    return best;
}

static spin_status find_series(struct spin_packer *p, const char *name,
                               struct spin_pack_series **out)
{
    for (size_t i = 0; i < p->n; i++)
        if (strcmp(p->series[i].name, name) == 0) {
            *out = &p->series[i];
            return SPIN_OK;
        }
    SPIN_TRY(spin_array_grow(p->n, &p->capacity, sizeof *p->series, (void **)&p->series));
    *out = &p->series[p->n++];
    memset(*out, 0, sizeof **out);
    snprintf((*out)->name, sizeof(*out)->name, "%s", name);
    return SPIN_OK;
}

spin_status spin_packer_units(struct spin_packer *packer, const char *series, size_t width,
                              const float *per_unit)
{
    struct spin_pack_series *s;

    SPIN_TRY(find_series(packer, series, &s));
    SPIN_TRY(spin_alloc(width, sizeof *per_unit, (void **)&s->per_unit));
    memcpy(s->per_unit, per_unit, width * sizeof *per_unit);
    s->n_units = width;
    return SPIN_OK;
}

/* Replaces words that are floats by words that are integers, in units of 1 / per_unit. If a value
 * is not a multiple of its unit, returns false and changes nothing. */
static bool make_whole(const struct spin_pack_series *s, struct words *words)
{
    uint64_t count = words->n_rows * words->width;

    if (s->n_units != words->width)
        return false;
    for (int pass = 0; pass < 2; pass++)
        for (uint64_t i = 0; i < count; i++) {
            float per_unit = s->per_unit[i % words->width], value, k, back;

            memcpy(&value, &words->at[i], sizeof value);
            k = rintf(value * per_unit);
            if (!(fabsf(k) < 0x1p31f))
                return false;
            back = (float)(int32_t)k / per_unit;
            /* Compare bits, since -0 would be decoded as 0. */
            if (memcmp(&back, &value, sizeof back) != 0)
                return false;
            if (pass == 1)
                words->at[i] = spin_word_of((int32_t)k);
        }
    return true;
}

spin_status spin_packer_put(struct spin_packer *packer, struct spin_zip_writer *w,
                            const char *series, int frame, int n_dims, const uint64_t *shape,
                            const void *values)
{
    struct spin_pack_series *s;
    struct words words = {.n_rows = shape[0], .width = 1};
    uint64_t rows = 0;
    bool as_it_is;
    char name[80];
    spin_status status;

    for (int i = 1; i < n_dims; i++)
        words.width *= shape[i];
    SPIN_TRY(find_series(packer, series, &s));
    /* these words are stored unchanged, so no copy is needed */
    as_it_is = frame < 0 && !s->per_unit;
    if (as_it_is) {
        words.at = (uint32_t *)(uintptr_t)values;
    } else {
        SPIN_TRY(spin_alloc((size_t)(words.n_rows * words.width) + 1, sizeof *words.at,
                            (void **)&words.at));
        memcpy(words.at, values, (size_t)(words.n_rows * words.width) * sizeof *words.at);
        words.whole = make_whole(s, &words);
        rows = choose_rows(s, &words);
    }
    s->written = true;
    if (frame < 0) {
        snprintf(name, sizeof name, "%s", series);
    } else {
        if (!s->rows)
            s->rows = spin_json_array();
        spin_json_push_number(s->rows, (double)rows);
        snprintf(name, sizeof name, "%s/%05d", series, frame);
    }
    for (uint64_t i = 0; i < rows * words.width; i++)
        words.at[i] ^= s->key.at[i];
    if (s->per_unit && !words.whole)
        status = spin_pack_write(w, name, n_dims, shape, read_words, words.at);
    else
        status = write_columns(w, name, n_dims, shape, &words, packer->quick);
    if (frame == 0)
        s->key = words;
    else if (!as_it_is)
        free(words.at);
    return status;
}

void spin_packer_json(const struct spin_packer *packer, spin_json *meta)
{
    spin_json *all = spin_json_object(), *units = spin_json_object();

    for (size_t i = 0; i < packer->n; i++) {
        struct spin_pack_series *s = &packer->series[i];

        if (s->per_unit && s->written) {
            spin_json *list = spin_json_array();

            for (size_t c = 0; c < s->n_units; c++)
                spin_json_push_number(list, s->per_unit[c]);
            spin_json_set(units, s->name, list);
        }
        if (s->rows)
            spin_json_set(all, s->name, s->rows);
        s->rows = NULL;
    }
    spin_json_set(meta, "xor_rows", all);
    spin_json_set(meta, "per_unit", units);
}

void spin_packer_free(struct spin_packer *packer)
{
    for (size_t i = 0; i < packer->n; i++) {
        free(packer->series[i].per_unit);
        free(packer->series[i].key.at);
        spin_json_free(packer->series[i].rows);
    }
    free(packer->series);
    memset(packer, 0, sizeof *packer);
}

/* ---- Rounding -------------------------------------------------------------------------------- */

/* Rounds the mantissa to `bits` bits, to nearest with ties to even, and then the value to a
 * multiple of `step`. The mantissa is rounded by an addition to the bit pattern of the float, where
 * a carry into the exponent gives the correct result. */
static float round_one(float value, int bits, float step)
{
    uint32_t u, dropped = 24 - (uint32_t)bits;
    float rounded;

    memcpy(&u, &value, sizeof u);
    u += (1u << (dropped - 1)) - 1 + (u >> dropped & 1);
    u = u >> dropped << dropped;
    memcpy(&rounded, &u, sizeof u);
    if (!isfinite(value) || !isfinite(rounded))
        return value;
    if (step > 0 && fabsf(rounded) < 0x1p22f * step)
        rounded = rintf(rounded / step) * step;
    return rounded == 0 ? 0 : rounded; /* replaces -0, which make_whole() cannot convert, by 0 */
}

void spin_round_values(float *values, size_t n, int bits, float step)
{
    for (size_t i = 0; i < n; i++)
        values[i] = round_one(values[i], bits, step);
}
