/* Reads arrays of a bundle. Before the header of an array is used, it is checked against meta.json
 * and against the size of the zip member. */
#include <float.h>
#include <inttypes.h>

#include "base/base.h"
#include "scene/bundle.h"

/* Arrays of this size in bytes or more are read without a check of their CRC, which would read
 * every byte even if the caller needs only a few. */
#define CRC_LIMIT (64u << 20)

/* The words of frame 0 of a series. */
struct spin_bundle_key {
    char series[64];
    uint32_t *words;
    bool whole;
    uint64_t shape[SPIN_NPY_MAX_DIMS];
};

static void name_of(const char *series, int frame, char name[80])
{
    if (frame < 0)
        snprintf(name, 80, "%s", series);
    else
        snprintf(name, 80, "%s/%05d", series, frame);
}

/* ---- Words ----------------------------------------------------------------------------------- */

/* Reads words [first, first + n) of an array whose planes are stored column by column. */
static void gather_columns(const struct spin_bundle_values *v, uint64_t first, size_t n,
                           uint32_t *to)
{
    uint64_t row = first / v->width, column = first % v->width;

    for (size_t i = 0; i < n; i++) {
        const unsigned char *p = v->bytes + column * v->shape[0] + row;

        to[i] = 0;
        for (int plane = 0; plane < v->n_planes; plane++, p += v->count)
            to[i] |= (uint32_t)*p << 8 * plane;
        if (++column == v->width) {
            column = 0;
            row++;
        }
    }
}

static void get_words(const struct spin_bundle_values *v, uint64_t first, size_t n, uint32_t *to)
{
    const unsigned char *p = v->bytes + first;
    size_t n_key = first < v->n_key ? (size_t)(v->n_key - first) : 0;

    if (n == 0)
        return;
    if (v->columns)
        gather_columns(v, first, n, to);
    else if (v->n_planes > 0)
        for (size_t i = 0; i < n; i++)
            to[i] = p[i] | (uint32_t)p[v->count + i] << 8 | (uint32_t)p[2 * v->count + i] << 16 |
                    (uint32_t)p[3 * v->count + i] << 24;
    else
        memcpy(to, v->bytes + 4 * first, 4 * n);
    for (size_t i = 0; i < n && i < n_key; i++)
        to[i] ^= v->key[first + i];
}

/* ---- Differences ----------------------------------------------------------------------------- */

/* Reads from "xor_rows" how many rows of the array are XORed with the same rows of frame 0. */
static spin_status difference_rows(struct spin_bundle *b, const char *series, int frame,
                                   uint64_t n_rows, uint64_t *rows)
{
    const spin_json *all = spin_json_get(b->json, "xor_rows"), *list = spin_json_get(all, series);
    int64_t value;

    *rows = 0;
    if (all && !spin_json_is_object(all))
        return spin_meta_fail("xor_rows", "an object");
    if (!list || frame < 0)
        return SPIN_OK;
    if (!spin_json_integer(spin_json_at(list, (size_t)frame), &value) || value < 0 ||
        (uint64_t)value > n_rows || (frame == 0 && value != 0))
        return spin_malformed("meta.json: 'xor_rows' of array '%s/%05d' is not an integer from 0 "
                              "to %" PRIu64,
                              series, frame, frame == 0 ? (uint64_t)0 : n_rows);
    *rows = (uint64_t)value;
    return SPIN_OK;
}

/* Finds the words of frame 0 of a series, decoding them on first use. */
static spin_status find_key(struct spin_bundle *b, const char *series, char kind, int n_dims,
                            const struct spin_bundle_key **out)
{
    int64_t any[SPIN_NPY_MAX_DIMS];
    SPIN_LEAVES(spin_bundle_values_close) struct spin_bundle_values v = {0};
    struct spin_bundle_key *key;
    struct spin_bundle_keys *keys = &b->keys;

    for (size_t i = 0; i < keys->n; i++)
        if (strcmp(keys->key[i].series, series) == 0) {
            *out = &keys->key[i];
            return SPIN_OK;
        }
    SPIN_TRY(spin_array_grow(keys->n, &keys->capacity, sizeof *keys->key, (void **)&keys->key));
    key = &keys->key[keys->n];
    memset(key, 0, sizeof *key);
    for (int d = 0; d < n_dims; d++)
        any[d] = -1;
    SPIN_TRY(spin_bundle_values_open(b, series, 0, kind, n_dims, any, &v));
    SPIN_TRY(spin_alloc((size_t)v.count + 1, sizeof *key->words, (void **)&key->words));
    get_words(&v, 0, (size_t)v.count, key->words);
    key->whole = v.whole;
    snprintf(key->series, sizeof key->series, "%s", series);
    memcpy(key->shape, v.shape, sizeof key->shape);
    keys->n++;
    *out = key;
    return SPIN_OK;
}

/* ---- Headers --------------------------------------------------------------------------------- */

/* Reads "per_unit" of a series, which lists the reciprocal of each column's unit, if meta.json has
 * an entry for the series. */
static spin_status find_units(struct spin_bundle *b, const char *series, char kind,
                              struct spin_bundle_values *out)
{
    const spin_json *all = spin_json_get(b->json, "per_unit"), *list = spin_json_get(all, series);

    if (all && !spin_json_is_object(all))
        return spin_meta_fail("per_unit", "an object");
    if (!list)
        return SPIN_OK;
    out->whole = kind == 'f' && spin_json_length(list) == out->width && out->width <= SPIN_UNITS;
    for (size_t c = 0; out->whole && c < out->width; c++) {
        double value;

        out->whole =
            spin_json_number(spin_json_at(list, c), &value) && value >= FLT_MIN && value <= FLT_MAX;
        out->per_unit[c] = out->whole ? (float)value : 0;
    }
    if (!out->whole)
        return spin_malformed("meta.json: 'per_unit' of '%s' is not a list of %" PRIu64
                              " positive numbers, one per column (at most %d columns)",
                              series, out->width, SPIN_UNITS);
    return SPIN_OK;
}

/* Checks the header of a plain or packed array and fills *out. out->shape is the shape before
 * packing, without the dimension of the planes. */
static spin_status check_header(struct spin_bundle *b, const char *series, const char *name,
                                char kind, int n_dims, const int64_t *shape,
                                struct spin_bundle_values *out)
{
    int64_t wanted[SPIN_NPY_MAX_DIMS] = {-1};
    struct spin_array a;
    bool packed;

    memset(out, 0, sizeof *out);
    SPIN_TRY(spin_npz_head(&b->npz, name, &a));
    packed = a.item_size == 1 && (a.kind == 'u' || a.kind == 'i');
    out->columns = packed && a.kind == 'i';
    for (int d = 0; d < n_dims; d++) /* in layout |i1, rows are the last dimension */
        wanted[out->columns ? (d > 0 ? d : n_dims) : d + packed] = shape[d];
    if (packed && !out->columns)
        wanted[0] = 4;
    SPIN_TRY(spin_array_check_shape(name, &a, n_dims + packed, wanted));
    if ((!packed && (a.kind != kind || a.item_size != 4 || a.big_endian)) ||
        (packed && (a.shape[0] < 1 || a.shape[0] > 4)) || !spin_array_is_contiguous(&a))
        return spin_malformed("array '%s': expected little-endian %s or 1 to 4 byte planes, in "
                              "row-major order",
                              name, kind == 'f' ? "float32" : "uint32");
    out->n_planes = packed ? (int)a.shape[0] : 0;
    out->n_dims = n_dims;
    out->width = 1;
    for (int d = 0; d < n_dims; d++) {
        out->shape[d] = a.shape[out->columns ? (d > 0 ? d : n_dims) : d + packed];
        out->width *= d > 0 ? out->shape[d] : 1;
    }
    out->count = out->shape[0] * out->width;
    return out->columns ? find_units(b, series, kind, out) : SPIN_OK;
}

static spin_status check_frame_header(struct spin_bundle *b, const char *series, int frame,
                                      char kind, int n_dims, const int64_t *shape, char name[80],
                                      struct spin_bundle_values *out, uint64_t *rows)
{
    name_of(series, frame, name);
    SPIN_TRY(check_header(b, series, name, kind, n_dims, shape, out));
    return difference_rows(b, series, frame, out->shape[0], rows);
}

spin_status spin_bundle_values_check(struct spin_bundle *bundle, const char *series, int frame,
                                     char kind, int n_dims, const int64_t *shape)
{
    struct spin_bundle_values values;
    uint64_t rows;
    char name[80];

    return check_frame_header(bundle, series, frame, kind, n_dims, shape, name, &values, &rows);
}

/* ---- Values ---------------------------------------------------------------------------------- */

static spin_status attach_key(struct spin_bundle *b, const char *series, const char *name,
                              char kind, uint64_t rows, struct spin_bundle_values *out)
{
    const struct spin_bundle_key *key;
    bool same;

    SPIN_TRY(find_key(b, series, kind, out->n_dims, &key));
    same = key->shape[0] >= rows && key->whole == out->whole;
    for (int d = 1; d < out->n_dims; d++)
        same = same && key->shape[d] == out->shape[d];
    if (!same && key->shape[0] < rows)
        return spin_malformed("array '%s' has %" PRIu64
                              " rows of differences from frame 0, but frame 0 has only %" PRIu64
                              " rows",
                              name, rows, key->shape[0]);
    if (!same)
        return spin_malformed("array '%s' holds differences from frame 0, but frame 0 has a "
                              "different type or width",
                              name);
    out->key = key->words;
    out->n_key = rows * out->width;
    return SPIN_OK;
}

static spin_status open_values(struct spin_bundle *b, const char *series, int frame, char kind,
                               int n_dims, const int64_t *shape, struct spin_bundle_values *out)
{
    struct spin_array a;
    char name[80];
    uint64_t rows = 0, bytes;

    SPIN_TRY(check_frame_header(b, series, frame, kind, n_dims, shape, name, out, &rows));
    if (rows > 0)
        SPIN_TRY(attach_key(b, series, name, kind, rows, out));
    bytes = (uint64_t)(out->n_planes ? out->n_planes : 4) * out->count;
    SPIN_TRY(spin_npz_take(&b->npz, name, bytes < CRC_LIMIT, &a, &out->owned));
    if (a.n_bytes != bytes)
        return spin_malformed("array '%s' was changed while it was being read", name);
    out->bytes = a.data;
    if (out->n_planes == 0 && !out->owned && out->n_key == 0)
        out->floats = spin_array_f32(&a);
    return SPIN_OK;
}

spin_status spin_bundle_values_open(struct spin_bundle *bundle, const char *series, int frame,
                                    char kind, int n_dims, const int64_t *shape,
                                    struct spin_bundle_values *out)
{
    spin_status status = open_values(bundle, series, frame, kind, n_dims, shape, out);

    if (status != SPIN_OK)
        spin_bundle_values_close(out);
    return spin_fail_reading(status, bundle->path);
}

void spin_bundle_values_get(const struct spin_bundle_values *v, uint64_t first, size_t n, void *out)
{
    uint32_t *word = out;
    size_t column;

    get_words(v, first, n, word);
    if (!v->whole || n == 0)
        return;
    column = (size_t)(first % v->width);
    for (size_t i = 0; i < n; i++) {
        float value = (float)spin_word_to(word[i]) / v->per_unit[column];

        memcpy(&word[i], &value, sizeof value);
        column = column + 1 < v->width ? column + 1 : 0;
    }
}

uint32_t spin_bundle_values_crc(const struct spin_bundle_values *v)
{
    uint32_t piece[4096], crc = 0;
    const size_t most = sizeof piece / sizeof *piece;

    if (v->n_planes == 0 && v->n_key == 0)
        return spin_crc32(0, v->bytes, 4 * (size_t)v->count);
    for (uint64_t first = 0; first < v->count; first += most) {
        size_t n = v->count - first < most ? (size_t)(v->count - first) : most;

        spin_bundle_values_get(v, first, n, piece);
        crc = spin_crc32(crc, piece, n * sizeof *piece);
    }
    return crc;
}

void spin_bundle_values_close(struct spin_bundle_values *values)
{
    free(values->owned);
    memset(values, 0, sizeof *values);
}

void spin_bundle_keys_free(struct spin_bundle_keys *keys)
{
    for (size_t i = 0; i < keys->n; i++)
        free(keys->key[i].words);
    free(keys->key);
    memset(keys, 0, sizeof *keys);
}
