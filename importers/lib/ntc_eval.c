/* Loading and evaluating the networks of 3DGStream. */
#include "importers/lib/ntc_eval.h"

#include "base/base.h"
#include "io/json.h"
#include "io/torch.h"
#include "io/zip.h"
#include "math/quat.h"

/* ---- Configuration --------------------------------------------------------------------------- */

void spin_ntc_default_shape(struct ntc_shape *s)
{
    memset(s, 0, sizeof *s);
    s->n_levels = 16;
    s->n_features = 4;
    s->log2_entries = 15;
    s->base = 16;
    s->growth = 2.0f;
    s->width = 64;
    s->n_hidden = 2;
}

spin_status spin_ntc_layout(struct ntc_shape *s)
{
    size_t width = (size_t)s->width;
    int n_in = s->n_levels > 0 ? s->n_levels * s->n_features : NTC_IN;

    s->n_in = (n_in + 15) / 16 * 16;
    s->n_parameters =
        width * (size_t)s->n_in + (size_t)(s->n_hidden - 1) * width * width + 16 * width;
    for (int l = 0; l < s->n_levels; l++) {
        if (!spin_ntc_level(l, s->base, s->growth, s->log2_entries, &s->level[l]))
            return spin_unsupported("level %d of the hash grid is too large", l);
        s->level_at[l] = s->n_parameters;
        s->n_parameters += (size_t)s->level[l].entries * (size_t)s->n_features;
    }
    return SPIN_OK;
}

static spin_status ntc_count(const spin_json *object, const char *key, int least, int most,
                             int *out)
{
    double value;

    if (!spin_json_number(spin_json_get(object, key), &value))
        return spin_malformed("there is no number '%s'", key);
    if (!(value >= least && value <= most && value == floor(value)))
        return spin_unsupported("'%s' is %g, expected %d to %d", key, value, least, most);
    *out = (int)value;
    return SPIN_OK;
}

/* Checks that the string at `key` is `word` or `other`. If `needed` is false, the string may be
 * missing. */
static spin_status ntc_word(const spin_json *object, const char *key, const char *word,
                            const char *other, bool needed)
{
    const char *text = spin_json_string(spin_json_get(object, key));

    if (!text && !needed)
        return SPIN_OK;
    if (!text)
        return spin_malformed("'%s' is missing or not a string", key);
    if (strcmp(text, word) != 0 && strcmp(text, other) != 0)
        return spin_unsupported("'%s' is '%s', expected %s", key, text, word);
    return SPIN_OK;
}

static spin_status ntc_read_shape(const spin_json *root, struct ntc_shape *s)
{
    const spin_json *grid = spin_json_get(root, "encoding"), *net = spin_json_get(root, "network");
    double growth = 2;

    if (!net)
        return spin_malformed("there is no object 'network'");
    SPIN_TRY(ntc_word(net, "otype", "FullyFusedMLP", "CutlassMLP", true));
    SPIN_TRY(ntc_word(net, "activation", "ReLU", "ReLU", true));
    SPIN_TRY(ntc_word(net, "output_activation", "None", "none", false));
    SPIN_TRY(ntc_count(net, "n_neurons", 16, NTC_MAX_WIDTH, &s->width));
    SPIN_TRY(ntc_count(net, "n_hidden_layers", 1, NTC_MAX_LAYERS, &s->n_hidden));
    if (s->width % 16 != 0)
        return spin_unsupported("'n_neurons' is %d, expected a multiple of 16", s->width);
    if (!grid)
        return SPIN_OK;
    SPIN_TRY(ntc_word(grid, "otype", "HashGrid", "HashGrid", true));
    SPIN_TRY(ntc_word(grid, "type", "Hash", "hash", false));
    SPIN_TRY(ntc_word(grid, "hash", "CoherentPrime", "coherentprime", false));
    SPIN_TRY(ntc_word(grid, "interpolation", "Linear", "linear", false));
    SPIN_TRY(ntc_count(grid, "n_levels", 1, NTC_MAX_LEVELS, &s->n_levels));
    SPIN_TRY(ntc_count(grid, "n_features_per_level", 1, 8, &s->n_features));
    SPIN_TRY(ntc_count(grid, "log2_hashmap_size", 3, 24, &s->log2_entries));
    SPIN_TRY(ntc_count(grid, "base_resolution", 1, 65536, &s->base));
    if (spin_json_get(grid, "per_level_scale") &&
        !spin_json_number(spin_json_get(grid, "per_level_scale"), &growth))
        return spin_malformed("'per_level_scale' is not a number");
    if (!(growth >= 1 && growth <= 64))
        return spin_unsupported("'per_level_scale' is %g, expected 1 to 64", growth);
    s->growth = (float)growth;
    return SPIN_OK;
}

/* Replaces comments by spaces. Comments begin with // or #, outside of strings; upstream's parser
 * allows them although JSON does not. */
static void ntc_strip_comments(char *text)
{
    bool quoted = false, comment = false;

    for (; *text; text++) {
        if (comment) {
            comment = *text != '\n';
        } else if (quoted) {
            if (*text == '\\' && text[1])
                text++;
            else
                quoted = *text != '"';
            continue;
        } else {
            quoted = *text == '"';
            comment = *text == '#' || (*text == '/' && text[1] == '/');
        }
        if (comment)
            *text = ' ';
    }
}

spin_status spin_ntc_open_config(const char *path, struct ntc_shape *s)
{
    SPIN_LEAVES(spin_map_close) struct spin_map map = {0};
    SPIN_LEAVES(spin_json_freed) spin_json *root = NULL;
    SPIN_FREED char *text = NULL;
    spin_status status;

    memset(s, 0, sizeof *s);
    SPIN_TRY(spin_map_open(path, &map));
    SPIN_TRY(spin_alloc(map.size + 1, 1, (void **)&text));
    memcpy(text, map.data, map.size);
    ntc_strip_comments(text);
    SPIN_TRY(spin_json_parse(path, text, strlen(text), &root));
    status = ntc_read_shape(root, s);
    if (status == SPIN_OK)
        status = spin_ntc_layout(s);
    return spin_fail_context(status, "cannot read '%s'", path);
}

/* ---- Parameters ------------------------------------------------------------------------------ */

void spin_ntc_free(struct ntc *n)
{
    free(n->parameters);
    memset(n, 0, sizeof *n);
}

/* Sets up the layers. Their matrices are stored one after the other at the start of `parameters`,
 * with one row per output. */
static void ntc_layers(struct ntc *n)
{
    const struct ntc_shape *s = n->shape;
    const float *matrix = n->parameters;

    n->net = (struct mlp_net){.n = s->n_hidden + 1, .half = true};
    for (int i = 0; i <= s->n_hidden; i++) {
        int n_in = i == 0 ? s->n_in : s->width, n_out = i == s->n_hidden ? 16 : s->width;

        n->net.layer[i] =
            (struct mlp_layer){n_in, n_out, i == s->n_hidden ? MLP_PLAIN : MLP_RELU, matrix, NULL};
        matrix += n_in * n_out;
    }
}

static spin_status ntc_read_bounds(struct spin_torch *torch, const char *key, float out[3])
{
    static const int64_t shape[1] = {3};
    struct spin_array t;

    SPIN_TRY(spin_torch_tensor_of(torch, spin_value_get(torch->root, key), key, 1, shape, &t));
    spin_array_to_f32(&t, 0, 3, out);
    for (int i = 0; i < 3; i++) {
        if (!isfinite(out[i]))
            return spin_malformed("tensor '%s' has values that are not finite", key);
    }
    return SPIN_OK;
}

static spin_status ntc_fill(const char *path, struct spin_torch *torch, struct ntc *n)
{
    static const char *const keys[] = {"xyz_bound_min", "xyz_bound_max", "model.params"};
    static const int64_t any[1] = {-1};
    struct spin_array info;

    for (int i = 0; i < 3; i++) {
        if (!spin_value_get(torch->root, keys[i]))
            return spin_malformed("there is no tensor '%s'", keys[i]);
    }
    SPIN_TRY(ntc_read_bounds(torch, keys[0], n->low));
    SPIN_TRY(ntc_read_bounds(torch, keys[1], n->high));
    for (int i = 0; i < 3; i++) {
        if (!(n->low[i] < n->high[i]))
            return spin_malformed("the bounding box is empty along axis %d: %g to %g", i,
                                  (double)n->low[i], (double)n->high[i]);
    }
    SPIN_TRY(spin_torch_floats(torch, spin_value_get(torch->root, keys[2]), keys[2], 1, any, &info,
                               &n->parameters));
    if (info.count != n->shape->n_parameters)
        return spin_malformed("tensor '%s' of '%s' has %llu numbers, but the configuration of the "
                              "network implies %zu",
                              keys[2], spin_path_name(path), (unsigned long long)info.count,
                              n->shape->n_parameters);
    for (size_t i = 0; i < n->shape->n_parameters; i++)
        n->parameters[i] = spin_half(n->parameters[i]);
    ntc_layers(n);
    return SPIN_OK;
}

spin_status spin_ntc_open(const char *path, const struct ntc_shape *shape, struct ntc *n)
{
    struct spin_torch torch;
    unsigned char head[4];
    size_t n_head;
    spin_status status;

    memset(n, 0, sizeof *n);
    n->shape = shape;
    SPIN_TRY(spin_file_head(path, head, sizeof head, &n_head));
    if (!spin_zip_detect(head, n_head))
        return spin_unsupported("'%s' is not a zip file: save it with PyTorch 1.6 or later", path);
    SPIN_TRY(spin_torch_open(path, &torch));
    status = ntc_fill(path, &torch, n);
    spin_torch_close(&torch);
    if (status != SPIN_OK)
        spin_ntc_free(n);
    return spin_fail_reading(status, path);
}

/* ---- Evaluation ------------------------------------------------------------------------------ */

void spin_ntc_encode(const struct ntc *n, const float x[3], float *out)
{
    const struct ntc_shape *s = n->shape;
    int used = s->n_levels > 0 ? s->n_levels * s->n_features : NTC_IN;

    for (int i = 0; i < NTC_IN && s->n_levels == 0; i++)
        out[i * MLP_BLOCK] = spin_half(x[i]);
    for (int l = 0; l < s->n_levels; l++) {
        const float *table = n->parameters + s->level_at[l];
        float weight[8], sum[8] = {0};
        uint32_t row[8];

        spin_ntc_corners(&s->level[l], x, row, weight);
        for (int c = 0; c < 8; c++) {
            for (int f = 0; f < s->n_features; f++)
                sum[f] += weight[c] * table[(size_t)row[c] * (size_t)s->n_features + (size_t)f];
        }
        for (int f = 0; f < s->n_features; f++)
            out[(l * s->n_features + f) * MLP_BLOCK] = spin_half(sum[f]);
    }
    for (int i = used; i < s->n_in; i++)
        out[i * MLP_BLOCK] = s->n_levels > 0 ? 0.0f : 1.0f;
}

void spin_ntc_apply(const struct ntc *n, int count, float *means, float *quats, float *scratch)
{
    size_t widest = spin_mlp_widest(&n->net);
    float *a = scratch + widest, *b = a + widest, x[MLP_BLOCK][3];
    bool inside[MLP_BLOCK];
    const float *out;

    for (int p = 0; p < MLP_BLOCK; p++) { /* pad the last block with its last point */
        const float *mu = means + 3 * (p < count ? p : count - 1);

        inside[p] = true;
        for (int i = 0; i < 3; i++) {
            x[p][i] = (mu[i] - n->low[i]) / (n->high[i] - n->low[i]);
            inside[p] = inside[p] && x[p][i] >= 0 && x[p][i] <= 1;
        }
        for (int i = 0; i < 3 && !inside[p]; i++)
            x[p][i] = 0;
        spin_ntc_encode(n, x[p], scratch + p);
    }
    out = spin_mlp_run(&n->net, scratch, a, b);
    for (int p = 0; p < count; p++) {
        float *mu = means + 3 * p, *q = quats + 4 * p, r[4], product[4];

        spin_quat_normalise(q);
        if (!inside[p])
            continue;
        for (int i = 0; i < 3; i++)
            mu[i] += out[i * MLP_BLOCK + p];
        for (int i = 0; i < 4; i++)
            r[i] = out[(3 + i) * MLP_BLOCK + p];
        spin_quat_normalise(r);
        spin_quat_product(q, r, product);
        memcpy(q, product, sizeof product);
    }
}
