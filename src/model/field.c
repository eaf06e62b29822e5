/* Computes the layout and the initial values of the network (docs/method.md section 3), and
 * converts the layout to and from JSON. */
#include "model/field.h"

#include <string.h>

#include "base/base.h"
#include "math/grid.h"
#include "math/rng.h"

/* Streams of the random generator (math/rng.h) for the initial values of the table and of the
 * heads. */
enum { STREAM_TABLE = 1, STREAM_HEADS = 2 };

static const int head_outputs[SPIN_HEADS] = {3, 4, 48, 1};

static void plan_heads(struct spin_heads *heads, int n_in, int hidden)
{
    size_t offset = 0;

    memset(heads, 0, sizeof *heads);
    heads->n_in = n_in;
    heads->hidden = hidden;
    for (int k = 0; k < SPIN_HEADS; k++) {
        size_t h = (size_t)hidden;

        heads->n_out[k] = head_outputs[k];
        heads->offset[k] = offset;
        offset += h * (size_t)n_in + h + h * h + h + (size_t)head_outputs[k] * (h + 1);
    }
    heads->offset[SPIN_HEADS] = offset;
}

static void count_parameters(struct spin_field *field)
{
    field->n_table =
        (size_t)field->grid.offset[field->grid.n_levels] * (size_t)field->grid.n_features;
    field->n_heads = field->heads.offset[SPIN_HEADS];
}

static spin_status check_shape(int levels, int features, int hidden, int sh_degree)
{
    if (levels < 1 || levels > SPIN_MAX_LEVELS)
        return spin_misuse("cannot build the network: levels %d is not in the range 1 to %d",
                           levels, SPIN_MAX_LEVELS);
    if (features != 1 && features != 2 && features != 4 && features != 8)
        return spin_misuse("cannot build the network: features %d is not 1, 2, 4 or 8", features);
    if (levels * features % 4 != 0)
        return spin_misuse(
            "cannot build the network: levels times features is %d, which is not a multiple of 4",
            levels * features);
    if (hidden < 4 || hidden > 256 || hidden % 4 != 0)
        return spin_misuse(
            "cannot build the network: hidden %d is not a multiple of 4 in the range 4 to 256",
            hidden);
    if (sh_degree < 0 || sh_degree > 3)
        return spin_misuse("cannot build the network: sh_degree %d is not in the range 0 to 3",
                           sh_degree);
    return SPIN_OK;
}

spin_status spin_field_plan(struct spin_field *field, int levels, int features, int hash_log2,
                            int hidden, int sh_degree, const int base[4], const int finest[4])
{
    uint64_t offset = 0;

    memset(field, 0, sizeof *field);
    SPIN_TRY(check_shape(levels, features, hidden, sh_degree));
    if (hash_log2 < 4 || hash_log2 > 26)
        return spin_misuse("cannot build the network: hash_log2 %d is not in the range 4 to 26",
                           hash_log2);
    for (int d = 0; d < 4; d++)
        if (base[d] < 2 || finest[d] < base[d] || finest[d] > 65536)
            return spin_misuse("cannot build the network: along %c, base_resolution %d and "
                               "finest_resolution %d do not satisfy 2 <= base <= finest <= 65536",
                               "xyzt"[d], base[d], finest[d]);
    field->grid.n_levels = levels;
    field->grid.n_features = features;
    field->sh_degree = sh_degree;
    for (int l = 0; l < levels; l++) {
        int hashed = 0;

        field->grid.offset[l] = (uint32_t)offset;
        offset += spin_grid_level(l, levels, base, finest, hash_log2, field->grid.scale[l],
                                  field->grid.res[l], &hashed);
        field->grid.hashed[l] = (uint8_t)hashed;
    }
    if (offset > UINT32_MAX / 8)
        return spin_misuse("cannot build the network: its hash grid would have %llu rows, more "
                           "than 2^29; lower hash_log2 or levels",
                           (unsigned long long)offset);
    field->grid.offset[levels] = (uint32_t)offset;
    plan_heads(&field->heads, levels * features, hidden);
    count_parameters(field);
    field->transform.inv_radius = 1.0f;
    return SPIN_OK;
}

static void fill_uniform(float *out, size_t n, uint64_t seed, uint32_t stream, uint64_t first,
                         float bound)
{
    for (size_t i = 0; i < n; i++)
        out[i] = bound * (2.0f * spin_rng_uniform(seed, stream, first + i) - 1.0f);
}

void spin_field_init(const struct spin_field *field, uint64_t seed, double range,
                     double init_log_scale, float *table, float *heads)
{
    const struct spin_heads *h = &field->heads;

    fill_uniform(table, field->n_table, seed, STREAM_TABLE, 0, (float)range);
    for (int k = 0; k < SPIN_HEADS; k++) {
        float *p = heads + h->offset[k];
        size_t hidden = (size_t)h->hidden, n_in = (size_t)h->n_in, n_out = (size_t)h->n_out[k];
        size_t first = h->offset[k];
        size_t layer[3] = {hidden * (n_in + 1), hidden * (hidden + 1), n_out * (hidden + 1)};
        float *last_bias = p + layer[0] + layer[1] + n_out * hidden;

        for (int i = 0; i < 3; i++) {
            float bound = 1.0f / sqrtf((float)(i == 0 ? n_in : hidden));

            fill_uniform(p, layer[i], seed, STREAM_HEADS, first, bound);
            p += layer[i];
            first += layer[i];
        }
        if (k == SPIN_HEAD_SCALE)
            for (int i = 0; i < 3; i++)
                last_bias[i] = (float)init_log_scale;
        if (k == SPIN_HEAD_ROTATION)
            for (int i = 0; i < 4; i++)
                last_bias[i] = i == 0 ? 1.0f : 0.0f;
        if (k == SPIN_HEAD_OPACITY)
            last_bias[0] = logf(0.1f / 0.9f);
    }
}

void spin_field_clear_sh(const struct spin_field *field, float *heads)
{
    const struct spin_heads *h = &field->heads;
    size_t hidden = (size_t)h->hidden, n_in = (size_t)h->n_in;
    size_t n_out = (size_t)h->n_out[SPIN_HEAD_SH];
    float *w3 = heads + h->offset[SPIN_HEAD_SH] + hidden * (n_in + 1) + hidden * (hidden + 1);

    memset(w3 + 3 * hidden, 0, (n_out - 3) * hidden * sizeof *w3);
    memset(w3 + n_out * hidden + 3, 0, (n_out - 3) * sizeof *w3);
}

void spin_field_clear_heads(const struct spin_field *field, float *heads)
{
    const struct spin_heads *h = &field->heads;
    size_t hidden = (size_t)h->hidden;

    for (int k = 0; k < SPIN_HEADS; k++) {
        size_t n = (size_t)h->n_out[k] * (hidden + 1);

        memset(heads + h->offset[k + 1] - n, 0, n * sizeof *heads);
    }
}

float spin_field_time(const struct spin_field *field, double time)
{
    double span = field->time_last - field->time_first;
    double t = span > 0 ? (time - field->time_first) / span : 0.0;

    return (float)(t < 0 ? 0 : t > 1 ? 1 : t);
}

/* ---- meta.json ------------------------------------------------------------------------------- */

static spin_json *network_to_json(const struct spin_field *field)
{
    spin_json *j = spin_json_object(), *transform = spin_json_object(), *centre = spin_json_array();
    spin_json *scale = spin_json_array(), *res = spin_json_array();
    spin_json *offset = spin_json_array(), *hashed = spin_json_array();

    for (int l = 0; l < field->grid.n_levels; l++) {
        spin_json *s = spin_json_array(), *r = spin_json_array();

        for (int d = 0; d < 4; d++) {
            spin_json_push_number(s, (double)field->grid.scale[l][d]);
            spin_json_push_number(r, (double)field->grid.res[l][d]);
        }
        spin_json_push(scale, s);
        spin_json_push(res, r);
        spin_json_push_number(offset, (double)field->grid.offset[l]);
        spin_json_push_number(hashed, field->grid.hashed[l]);
    }
    spin_json_push_number(offset, (double)field->grid.offset[field->grid.n_levels]);
    for (int i = 0; i < 3; i++)
        spin_json_push_number(centre, (double)field->transform.centre[i]);
    spin_json_set(transform, "centre", centre);
    spin_json_set_number(transform, "inv_radius", (double)field->transform.inv_radius);
    if (field->transform.raw) /* the contraction of the paper is the default and is not recorded */
        spin_json_set_bool(transform, "raw", true);
    if (field->heads.relu)
        spin_json_set_string(j, "activation", "relu");
    spin_json_set_integer(j, "levels", field->grid.n_levels);
    spin_json_set_integer(j, "features", field->grid.n_features);
    spin_json_set_integer(j, "hidden", field->heads.hidden);
    spin_json_set(j, "scale", scale);
    spin_json_set(j, "res", res);
    spin_json_set(j, "offset", offset);
    spin_json_set(j, "hashed", hashed);
    spin_json_set(j, "norm", transform);
    spin_json_set_number(j, "time_first", field->time_first);
    spin_json_set_number(j, "time_last", field->time_last);
    return j;
}

spin_json *spin_field_to_json(const struct spin_field *field, bool there)
{
    spin_json *trained = spin_json_object();

    if (there)
        spin_json_set(trained, "field", network_to_json(field));
    else
        spin_json_set_null(trained, "field");
    spin_json_set_integer(trained, "sh_degree", field->sh_degree);
    if (field->antialias)
        spin_json_set_bool(trained, "antialias", true);
    return trained;
}

static bool get_int(const spin_json *j, const char *key, int lo, int hi, int *out)
{
    int64_t v;

    if (!spin_json_integer(spin_json_get(j, key), &v) || v < lo || v > hi)
        return false;
    *out = (int)v;
    return true;
}

static bool get_float(const spin_json *j, double lo, double hi, float *out)
{
    double v;

    if (!spin_json_number(j, &v) || !(v >= lo && v <= hi))
        return false;
    *out = (float)v;
    return true;
}

/* Reads the scale, resolution, offset and kind (hashed or dense) of level l of the hash grid and
 * checks that they are consistent. If a dense level had fewer rows than vertices, the encoder would
 * read beyond the end of the level. */
static bool read_level(const spin_json *json, int l, struct spin_grid *grid)
{
    const spin_json *scale = spin_json_at(spin_json_get(json, "scale"), (size_t)l);
    const spin_json *res = spin_json_at(spin_json_get(json, "res"), (size_t)l);
    const spin_json *offset = spin_json_get(json, "offset");
    int64_t first, end, hashed, r;

    for (size_t d = 0; d < 4; d++) {
        if (!get_float(spin_json_at(scale, d), 0, 65536, &grid->scale[l][d]) ||
            !spin_json_integer(spin_json_at(res, d), &r) || r < 1 || r > 65537 ||
            fabs((double)r - 1.5 - (double)grid->scale[l][d]) > 0.51)
            return false;
        grid->res[l][d] = (uint32_t)r;
    }
    if (!spin_json_integer(spin_json_at(offset, (size_t)l), &first) || first != grid->offset[l] ||
        !spin_json_integer(spin_json_at(offset, (size_t)l + 1), &end) || end <= first ||
        end > UINT32_MAX / 8 ||
        !spin_json_integer(spin_json_at(spin_json_get(json, "hashed"), (size_t)l), &hashed) ||
        hashed != spin_grid_is_hashed(grid->res[l], (uint64_t)(end - first)))
        return false;
    grid->offset[l + 1] = (uint32_t)end;
    grid->hashed[l] = (uint8_t)hashed;
    return true;
}

static spin_status network_from_json(const spin_json *json, struct spin_field *out)
{
    const spin_json *transform = spin_json_get(json, "norm");
    const char *activation = spin_json_string(spin_json_get(json, "activation"));
    int levels, features, hidden;

    if (!get_int(json, "levels", 1, SPIN_MAX_LEVELS, &levels) ||
        !get_int(json, "features", 1, 8, &features) || !get_int(json, "hidden", 4, 256, &hidden) ||
        check_shape(levels, features, hidden, out->sh_degree) != SPIN_OK)
        return spin_malformed("meta.json: 'levels', 'features' or 'hidden' of 'trained.field' is "
                              "missing or out of range");
    out->grid.n_levels = levels;
    out->grid.n_features = features;
    for (int l = 0; l < levels; l++)
        if (!read_level(json, l, &out->grid))
            return spin_malformed("meta.json: 'scale', 'res', 'offset' and 'hashed' of "
                                  "'trained.field' contradict each other in level %d",
                                  l);
    plan_heads(&out->heads, levels * features, hidden);
    out->heads.relu = activation && strcmp(activation, "relu") == 0;
    if (activation && !out->heads.relu && strcmp(activation, "gelu") != 0)
        return spin_unsupported("meta.json: 'activation' of 'trained.field' is '%.32s', but only "
                                "gelu and relu are supported",
                                activation);
    spin_json_bool(spin_json_get(transform, "raw"), &out->transform.raw);
    count_parameters(out);
    for (size_t i = 0; i < 3; i++)
        if (!get_float(spin_json_at(spin_json_get(transform, "centre"), i), -1e30, 1e30,
                       &out->transform.centre[i]))
            return spin_malformed(
                "meta.json: 'norm.centre' of 'trained.field' is missing or out of range");
    if (!get_float(spin_json_get(transform, "inv_radius"), 1e-30, 1e30,
                   &out->transform.inv_radius) ||
        !spin_json_number(spin_json_get(json, "time_first"), &out->time_first) ||
        !spin_json_number(spin_json_get(json, "time_last"), &out->time_last))
        return spin_malformed("meta.json: 'norm.inv_radius', 'time_first' or 'time_last' of "
                              "'trained.field' is missing or out of range");
    return SPIN_OK;
}

spin_status spin_field_from_json(const spin_json *trained, struct spin_field *out, bool *there)
{
    const spin_json *field = spin_json_get(trained, "field");

    memset(out, 0, sizeof *out);
    *there = spin_json_is_object(field);
    if (!get_int(trained, "sh_degree", 0, 3, &out->sh_degree))
        return spin_malformed(
            "meta.json: 'trained.sh_degree' is missing or not in the range 0 to 3");
    spin_json_bool(spin_json_get(trained, "antialias"), &out->antialias);
    return *there ? network_from_json(field, out) : SPIN_OK;
}

/* ---- Residuals ------------------------------------------------------------------------------- */

const size_t spin_residual_width[SPIN_HEADS] = {3, 4, 3, 1};

void spin_residual_from_rows(size_t n, const float *rows, size_t stride, const uint32_t *row_of,
                             float *groups)
{
    for (size_t k = 0, first = 0; k < SPIN_HEADS; first += spin_residual_width[k++])
        for (size_t i = 0; i < n; i++, groups += spin_residual_width[k])
            memcpy(groups, rows + (row_of ? row_of[i] : i) * stride + first,
                   spin_residual_width[k] * sizeof *groups);
}

void spin_residual_to_rows(size_t n, const float *groups, const uint32_t *row_of, float *rows,
                           size_t stride)
{
    for (size_t k = 0, first = 0; k < SPIN_HEADS; first += spin_residual_width[k++])
        for (size_t i = 0; i < n; i++, groups += spin_residual_width[k])
            memcpy(rows + (row_of ? row_of[i] : i) * stride + first, groups,
                   spin_residual_width[k] * sizeof *groups);
}
