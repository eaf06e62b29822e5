/* Hash grids, heads and folders that Grid4D and DASH share. */
#include "importers/lib/hashgrid_deform.h"

#include <string.h>

#include "math/grid.h"

/* ---- Recognising ----------------------------------------------------------------------------- */

int spin_hash_probe(const struct spin_peek *peek, const char *key, const char *option)
{
    if (!peek->is_folder)
        return spin_peek_says(peek, key) ? 90 : 0;
    if (!spin_peek_has(peek, "deform") || !spin_peek_has(peek, "point_cloud"))
        return 0;
    if (spin_peek_says(peek, option))
        return 90;
    return !spin_peek_says(peek, "Namespace(") ? 55 : spin_peek_says(peek, "grid_args") ? 40 : 0;
}

/* ---- Settings -------------------------------------------------------------------------------- */

static spin_status read_settings(struct hash_model *m)
{
    const char *bound = spin_model_option(&m->base, "bound");
    const char *scale = spin_model_option(&m->base, "scale-xyz");
    const struct cfg_args *cfg = &m->base.settings.cfg;
    struct cfg_span grid_args = spin_cfg_get(cfg, "grid_args"), s;

    if (bound) {
        if (!spin_cfg_number((struct cfg_span){bound, bound + strlen(bound)}, &m->bound))
            return spin_fail(SPIN_E_USAGE, "--bound '%s': expected a number", bound);
    } else if (!grid_args.at) {
        return spin_fail(SPIN_E_NOT_FOUND,
                         "%s%s%s does not say the bound of the scene, without which nothing can be "
                         "read: give it with --bound",
                         cfg->path ? "'" : "", cfg->path ? cfg->path : "no cfg_args, so the model",
                         cfg->path ? "'" : "");
    } else if ((s = spin_cfg_item(grid_args, "bound")).at) {
        if (!spin_cfg_number(s, &m->bound))
            return spin_fail(SPIN_E_MALFORMED, "'%s': bound is not a number", cfg->path);
    } else {
        m->bound = 1.6;
        spin_note(m->base.sequence, "cfg_args names no bound: assumed 1.6 as the method does");
    }
    if (!(m->bound > 0) || !isfinite(m->bound))
        return spin_fail(bound ? SPIN_E_USAGE : SPIN_E_MALFORMED,
                         "%s: bound is %g, expected a number above 0",
                         bound ? "--bound" : cfg->path, m->bound);
    m->scale_xyz[0] = m->scale_xyz[1] = m->scale_xyz[2] = 1;
    if (scale) {
        char list[128];

        snprintf(list, sizeof list, strchr(scale, ',') ? "[%.100s]" : "%.100s", scale);
        if (!spin_cfg_numbers((struct cfg_span){list, list + strlen(list)}, 3, m->scale_xyz))
            return spin_fail(SPIN_E_USAGE, "--scale-xyz '%s': expected a number or three", scale);
        return SPIN_OK;
    }
    s = spin_cfg_get(cfg, "scale_xyz");
    if (s.at && !spin_cfg_numbers(s, 3, m->scale_xyz))
        return spin_fail(SPIN_E_MALFORMED, "'%s': scale_xyz is neither a number nor three of them",
                         cfg->path);
    return SPIN_OK;
}

/* ---- Tensors --------------------------------------------------------------------------------- */

static spin_status load_offsets(struct hash_model *m, const char *name, uint64_t n_rows,
                                int64_t offset[HASH_MAX_LEVELS + 1], int *n_levels)
{
    const struct spin_value *v = spin_model_get(&m->base, "%s.offsets", name);
    static const int64_t shape[1] = {-1};
    struct spin_array t;
    char what[80];

    snprintf(what, sizeof what, "%s.offsets", name);
    if (!v)
        return spin_fail(SPIN_E_MALFORMED, "no tensor '%s'", what);
    SPIN_TRY(spin_torch_tensor_of(&m->base.torch, v, what, 1, shape, &t));
    if (t.count < 2 || t.count > HASH_MAX_LEVELS + 1 || (t.kind != 'i' && t.kind != 'u'))
        return spin_fail(SPIN_E_MALFORMED,
                         "tensor '%s' has %llu values, expected 2 to %d whole numbers", what,
                         (unsigned long long)t.count, HASH_MAX_LEVELS + 1);
    spin_array_to_i64(&t, 0, t.count, offset);
    *n_levels = (int)t.count - 1;
    if (offset[0] != 0)
        return spin_fail(SPIN_E_MALFORMED, "tensor '%s' begins with %lld, expected 0", what,
                         (long long)offset[0]);
    for (int l = 0; l < *n_levels; l++) {
        if (offset[l + 1] <= offset[l] || (uint64_t)offset[l + 1] > n_rows)
            return spin_fail(SPIN_E_MALFORMED,
                             "tensor '%s': level %d has rows %lld to %lld of a table of %llu", what,
                             l, (long long)offset[l], (long long)offset[l + 1],
                             (unsigned long long)n_rows);
    }
    return SPIN_OK;
}

spin_status spin_hash_load_grid(struct hash_model *m, const char *name, int n_dims,
                                struct hash_grid *grid)
{
    static const int64_t any[2] = {-1, -1};
    const int64_t axes[1] = {n_dims};
    int64_t offset[HASH_MAX_LEVELS + 1];
    float *growth, *base, *table;
    struct spin_array info;
    char key[80];

    snprintf(key, sizeof key, "%s.embeddings", name);
    SPIN_TRY(spin_model_floats(&m->base, key, 2, any, &info, &table));
    if (info.shape[1] != 1 && info.shape[1] != 2 && info.shape[1] != 4 && info.shape[1] != 8)
        return spin_fail(SPIN_E_MALFORMED,
                         "tensor '%s' has %llu features a row, expected 1, 2, 4 or 8", key,
                         (unsigned long long)info.shape[1]);
    grid->n_dims = n_dims;
    grid->n_features = (int)info.shape[1];
    SPIN_TRY(load_offsets(m, name, info.shape[0], offset, &grid->n_levels));
    snprintf(key, sizeof key, "%s.per_level_scale", name);
    SPIN_TRY(spin_model_floats(&m->base, key, 1, axes, NULL, &growth));
    snprintf(key, sizeof key, "%s.base_resolution", name);
    SPIN_TRY(spin_model_floats(&m->base, key, 1, axes, NULL, &base));
    for (int l = 0; l < grid->n_levels; l++) {
        struct hash_level *level = &grid->level[l];

        if (!spin_grid_stored_level(l, n_dims, growth, base, level->scale, level->res))
            return spin_fail(SPIN_E_MALFORMED,
                             "tensors '%s.per_level_scale' and '.base_resolution' make no grid at "
                             "level %d",
                             name, l);
        level->rows = (uint32_t)(offset[l + 1] - offset[l]);
        level->hashed = spin_grid_is_hashed(level->res, level->rows);
        level->table = table + (size_t)offset[l] * (size_t)grid->n_features;
    }
    return SPIN_OK;
}

spin_status spin_hash_load_heads(struct hash_model *m, int width, int n_warp)
{
    m->width = width;
    SPIN_TRY(spin_model_trunk(&m->base, "grid_mlp", 0, width, &m->trunk));
    SPIN_TRY(spin_model_layer(&m->base, "gaussian_warp", width, n_warp, MLP_PLAIN, &m->warp));
    SPIN_TRY(spin_model_layer(&m->base, "gaussian_rotation", width, 4, MLP_PLAIN, &m->rotation));
    return spin_model_layer(&m->base, "gaussian_scaling", width, 3, MLP_PLAIN, &m->scaling);
}

/* ---- Opening --------------------------------------------------------------------------------- */

/* The pair (grid, network) that was saved, and that it is this method's. */
static spin_status split(struct hash_model *m)
{
    const struct spin_value *root = m->base.torch.root;
    const struct hash_method *method = m->method;

    m->grid = spin_value_at(root, 0);
    m->network = spin_value_at(root, 1);
    if (root && root->kind == SPIN_VALUE_DICT)
        return spin_fail(SPIN_E_UNSUPPORTED,
                         "what was saved is one state dict, not a pair of a grid and a network: it "
                         "looks like Deformable-3D-Gaussians");
    if (!root || root->kind != SPIN_VALUE_TUPLE || root->n != 2 ||
        m->grid->kind != SPIN_VALUE_DICT || m->network->kind != SPIN_VALUE_DICT)
        return spin_fail(SPIN_E_MALFORMED,
                         "what was saved is not a pair of two state dicts, grid and network");
    if (spin_value_get(m->grid, method->other_key))
        return spin_fail(SPIN_E_UNSUPPORTED, "tensor '%s' says that this is a run of %s",
                         method->other_key, method->other);
    if (spin_value_get(m->network, method->key))
        return spin_fail(SPIN_E_MALFORMED,
                         "the pair is swapped: the network comes before the grid");
    if (!spin_value_get(m->grid, method->key))
        return spin_fail(SPIN_E_MALFORMED, "no tensor '%s'", method->key);
    m->base.tensors = m->grid;
    return SPIN_OK;
}

static spin_status load(struct spin_model *base)
{
    struct hash_model *m = (struct hash_model *)base;

    SPIN_TRY(split(m));
    return m->method->load(m);
}

spin_status spin_hash_open(struct hash_model *m, const char *path, const struct hash_method *method)
{
    struct spin_model *base = &m->base;
    struct deform_save save;

    m->method = method;
    SPIN_TRY(spin_deform_find(base, path, false, &save));
    base->path = save.network;
    m->save = save.name;
    SPIN_TRY(spin_model_cfg(base, save.model, NULL));
    SPIN_TRY(spin_model_torch(base, save.network, load));
    SPIN_TRY(read_settings(m));
    if (method->settle)
        SPIN_TRY(method->settle(m));
    SPIN_TRY(spin_model_read(base, save.cloud, method->extra, 0, &m->extra));
    spin_deform_describe(base, DEFORM_MOVED);
    snprintf(base->sequence->variant, sizeof base->sequence->variant,
             "%s, %zu Gaussians, bound %g, width %d", method->name, base->canonical.n, m->bound,
             m->width);
    spin_note(base->sequence,
              "times run from 0 to 1 and are not stored: frame i of n is at i/(n-1) in "
              "most data sets, at i/n in some");
    return spin_mlp_team_create(m->n_scratch, &base->team);
}

/* ---- Evaluating ------------------------------------------------------------------------------ */

/* One level at x in [0, 1]: features to out[0], out[MLP_BLOCK], ... n_dims and n_features are
 * constants where it is inlined. Positions have one rounding, as in the kernel. */
MLP_INLINE void hash_sample_level(const struct hash_level *level, int n_dims, int n_features,
                                  const float *x, float *out)
{
    float weight[4][2], sum[8] = {0};
    uint32_t cell[4] = {0, 0, 0, 0};

    for (int d = 0; d < n_dims; d++) {
        float at = x[d] * level->scale[d];
        float low = floorf(at);

        cell[d] = (uint32_t)low;
        weight[d][1] = spin_smoothstep(at - low);
        weight[d][0] = 1.0f - weight[d][1];
    }
    for (int k = 0; k < 1 << n_dims; k++) {
        uint32_t q[4] = {0, 0, 0, 0};
        const float *row;
        float w = 1.0f;

        for (int d = 0; d < n_dims; d++) {
            q[d] = cell[d] + (uint32_t)(k >> d & 1);
            w *= weight[d][k >> d & 1];
        }
        row = level->table +
              (size_t)spin_grid_row(q, level->res, level->rows, level->hashed) * (size_t)n_features;
        for (int c = 0; c < n_features; c++)
            sum[c] += w * row[c];
    }
    for (int c = 0; c < n_features; c++)
        out[c * MLP_BLOCK] = sum[c];
}

MLP_INLINE void hash_sample_levels(const struct hash_grid *grid, int n_dims, int n_features,
                                   const float *x, float *out)
{
    for (int l = 0; l < grid->n_levels; l++)
        hash_sample_level(&grid->level[l], n_dims, n_features, x, out + l * n_features * MLP_BLOCK);
}

void spin_hash_sample(const struct hash_grid *grid, const float *x, float *out)
{
    for (int d = 0; d < grid->n_dims; d++) {
        if (!(x[d] >= 0.0f && x[d] <= 1.0f)) {
            for (int i = 0; i < grid->n_levels * grid->n_features; i++)
                out[i * MLP_BLOCK] = 0;
            return;
        }
    }
    if (grid->n_dims == 3 && grid->n_features == 2)
        hash_sample_levels(grid, 3, 2, x, out);
    else if (grid->n_dims == 4 && grid->n_features == 2)
        hash_sample_levels(grid, 4, 2, x, out);
    else if (grid->n_dims == 3)
        hash_sample_levels(grid, 3, grid->n_features, x, out);
    else
        hash_sample_levels(grid, 4, grid->n_features, x, out);
}

void spin_hash_coordinates(const struct hash_model *m, const float p[3], float time, float out[4])
{
    float bound = (float)m->bound;

    for (int d = 0; d < 3; d++)
        out[d] = (p[d] * (float)m->scale_xyz[d] + bound) / (2 * bound);
    out[3] = ((time * 2 * bound - bound) * 0.9f + bound) / (2 * bound);
}
