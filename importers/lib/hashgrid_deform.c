/* Hash grids, heads and folders that Grid4D and DASH share. */
#include "importers/lib/hashgrid_deform.h"

#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "importers/lib/deform_save.h"
#include "importers/lib/notes.h"
#include "math/grid.h"

#define MOVED ((unsigned)SPIN_COL_MEANS | SPIN_COL_QUATS | SPIN_COL_LOG_SCALES)

void spin_hash_grid_free(struct hash_grid *grid)
{
    free(grid->table);
    memset(grid, 0, sizeof *grid);
}

void spin_hash_model_free(struct hash_model *m)
{
    for (int i = 0; i < HASH_MAX_DEPTH; i++)
        spin_mlp_free(&m->grid_mlp[i]);
    spin_mlp_free(&m->warp);
    spin_mlp_free(&m->rotation);
    spin_mlp_free(&m->scaling);
    spin_mlp_team_free(&m->team);
    spin_splats_free(&m->canonical);
    free(m->extra);
    free(m->save);
    free(m->path);
}

/* ---- Recognising ----------------------------------------------------------------------------- */

static bool hash_says(const struct spin_peek *peek, const char *word)
{
    return peek->n_head > 0 && memmem(peek->head, peek->n_head, word, strlen(word)) != NULL;
}

int spin_hash_probe(const struct spin_peek *peek, const char *key, const char *option)
{
    bool deform = false, cloud = false;

    if (!peek->is_folder)
        return hash_says(peek, key) ? 90 : 0;
    for (size_t i = 0; peek->names && peek->names[i]; i++) {
        deform = deform || strcmp(peek->names[i], "deform") == 0;
        cloud = cloud || strcmp(peek->names[i], "point_cloud") == 0;
    }
    if (!deform || !cloud)
        return 0;
    if (hash_says(peek, option))
        return 90;
    return !hash_says(peek, "Namespace(") ? 55 : hash_says(peek, "grid_args") ? 40 : 0;
}

/* ---- Settings -------------------------------------------------------------------------------- */

static spin_status read_settings(const struct cfg_args *cfg,
                                 const struct spin_plugin_values *values, struct hash_model *m,
                                 struct spin_sequence_info *sequence)
{
    const char *bound = spin_plugin_value(values, "bound", NULL);
    const char *scale = spin_plugin_value(values, "scale-xyz", NULL);
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
        spin_note(sequence, "cfg_args names no bound: assumed 1.6 as the method does");
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

/* ---- Opening --------------------------------------------------------------------------------- */

static spin_status open_save(const struct deform_save *save,
                             const struct spin_plugin_values *values,
                             const struct hash_method *method, struct hash_model *m,
                             struct spin_sequence_info *sequence)
{
    struct spin_torch torch;
    struct cfg_args cfg;
    spin_status status;

    memset(&torch, 0, sizeof torch);
    SPIN_TRY(spin_strdup(save->network, &m->path));
    SPIN_TRY(spin_strdup(save->name, &m->save));
    status = spin_model_folder_cfg(save->model, NULL, &cfg);
    if (status == SPIN_OK)
        status = spin_fail_reading(spin_torch_open(save->network, &torch), save->network);
    if (status == SPIN_OK)
        status = spin_fail_reading(method->load(&torch, m), save->network);
    if (status == SPIN_OK)
        status = read_settings(&cfg, values, m, sequence);
    if (status == SPIN_OK && method->settle)
        status = method->settle(&cfg, values, m, sequence);
    spin_torch_close(&torch);
    spin_cfg_close(&cfg);
    SPIN_TRY(status);
    SPIN_TRY(spin_model_folder_read(save->cloud, &m->canonical, method->extra,
                                    method->extra ? &m->extra : NULL));
    spin_deform_describe(&m->canonical, MOVED, sequence);
    snprintf(sequence->variant, sizeof sequence->variant, "%s, %zu Gaussians, bound %g, width %d",
             method->name, m->canonical.n, m->bound, m->width);
    spin_note(sequence, "times run from 0 to 1 and are not stored: frame i of n is at i/(n-1) in "
                        "most data sets, at i/n in some");
    return spin_mlp_team_create(m->n_scratch, &m->team);
}

spin_status spin_hash_open(const char *path, const struct spin_plugin_values *values,
                           const struct hash_method *method, struct hash_model *m,
                           struct spin_sequence_info *sequence)
{
    struct deform_save save;
    spin_status status =
        spin_deform_save_find(path, spin_plugin_value(values, "iteration", NULL), false, &save);

    if (status == SPIN_OK)
        status = open_save(&save, values, method, m, sequence);
    spin_deform_save_free(&save);
    return status;
}

/* ---- Tensors --------------------------------------------------------------------------------- */

static spin_status hash_load_offsets(struct spin_torch *torch, const struct spin_value *dict,
                                     const char *name, uint64_t n_rows,
                                     int64_t offset[HASH_MAX_LEVELS + 1], int *n_levels)
{
    const struct spin_value *v = spin_mlp_get(dict, name, ".offsets");
    static const int64_t shape[1] = {-1};
    struct spin_array t;
    char what[80];

    snprintf(what, sizeof what, "%s.offsets", name);
    if (!v)
        return spin_fail(SPIN_E_MALFORMED, "no tensor '%s'", what);
    SPIN_TRY(spin_torch_tensor_of(torch, v, what, 1, shape, &t));
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

static spin_status hash_load_axis(struct spin_torch *torch, const struct spin_value *dict,
                                  const char *name, const char *key, int n_dims, float out[4])
{
    int64_t shape[1] = {n_dims};
    float *values = NULL;

    SPIN_TRY(spin_mlp_floats(torch, dict, name, key, 1, shape, NULL, &values));
    memcpy(out, values, (size_t)n_dims * sizeof *out);
    free(values);
    return SPIN_OK;
}

spin_status spin_hash_load_grid(struct spin_torch *torch, const struct spin_value *dict,
                                const char *name, int n_dims, struct hash_grid *grid)
{
    static const int64_t shape[2] = {-1, -1};
    int64_t offset[HASH_MAX_LEVELS + 1];
    float growth[4], base[4];
    struct spin_array info;

    SPIN_TRY(spin_mlp_floats(torch, dict, name, ".embeddings", 2, shape, &info, &grid->table));
    if (info.shape[1] != 1 && info.shape[1] != 2 && info.shape[1] != 4 && info.shape[1] != 8)
        return spin_fail(SPIN_E_MALFORMED,
                         "tensor '%s.embeddings' has %llu features a row, expected 1, 2, 4 or 8",
                         name, (unsigned long long)info.shape[1]);
    grid->n_dims = n_dims;
    grid->n_features = (int)info.shape[1];
    SPIN_TRY(hash_load_offsets(torch, dict, name, info.shape[0], offset, &grid->n_levels));
    SPIN_TRY(hash_load_axis(torch, dict, name, ".per_level_scale", n_dims, growth));
    SPIN_TRY(hash_load_axis(torch, dict, name, ".base_resolution", n_dims, base));
    for (int l = 0; l < grid->n_levels; l++) {
        struct hash_level *level = &grid->level[l];

        if (!spin_grid_stored_level(l, n_dims, growth, base, level->scale, level->res))
            return spin_fail(SPIN_E_MALFORMED,
                             "tensors '%s.per_level_scale' and '.base_resolution' make no grid at "
                             "level %d",
                             name, l);
        level->rows = (uint32_t)(offset[l + 1] - offset[l]);
        level->hashed = spin_grid_is_hashed(level->res, level->rows);
        level->table = grid->table + (size_t)offset[l] * (size_t)grid->n_features;
    }
    return SPIN_OK;
}

spin_status spin_hash_load_heads(struct spin_torch *torch, const struct spin_value *dict, int width,
                                 int n_warp, struct hash_model *m)
{
    m->width = width;
    for (m->depth = 0; m->depth < HASH_MAX_DEPTH; m->depth++) {
        char key[40];

        snprintf(key, sizeof key, "grid_mlp.%d", 2 * m->depth);
        if (!spin_mlp_has(dict, "", key))
            break;
        SPIN_TRY(spin_mlp_load(torch, dict, "", key, width, width, &m->grid_mlp[m->depth]));
    }
    SPIN_TRY(spin_mlp_load(torch, dict, "", "gaussian_warp", width, n_warp, &m->warp));
    SPIN_TRY(spin_mlp_load(torch, dict, "", "gaussian_rotation", width, 4, &m->rotation));
    return spin_mlp_load(torch, dict, "", "gaussian_scaling", width, 3, &m->scaling);
}

spin_status spin_hash_split(const struct spin_value *root, const char *key, const char *other_key,
                            const char *other, struct hash_pair *out)
{
    out->grid = spin_value_at(root, 0);
    out->network = spin_value_at(root, 1);
    if (root && root->kind == SPIN_VALUE_DICT)
        return spin_fail(SPIN_E_UNSUPPORTED,
                         "what was saved is one state dict, not a pair of a grid and a network: it "
                         "looks like Deformable-3D-Gaussians");
    if (!root || root->kind != SPIN_VALUE_TUPLE || root->n != 2 ||
        out->grid->kind != SPIN_VALUE_DICT || out->network->kind != SPIN_VALUE_DICT)
        return spin_fail(SPIN_E_MALFORMED,
                         "what was saved is not a pair of two state dicts, grid and network");
    if (spin_value_get(out->grid, other_key))
        return spin_fail(SPIN_E_UNSUPPORTED, "tensor '%s' says that this is a run of %s", other_key,
                         other);
    if (spin_value_get(out->network, key))
        return spin_fail(SPIN_E_MALFORMED,
                         "the pair is swapped: the network comes before the grid");
    if (!spin_value_get(out->grid, key))
        return spin_fail(SPIN_E_MALFORMED, "no tensor '%s'", key);
    return SPIN_OK;
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

const float *spin_hash_layers(const struct hash_model *m, float *a, float *b)
{
    for (int i = 0; i < m->depth; i++) {
        float *t = a;

        spin_mlp_linear(&m->grid_mlp[i], a, b, true);
        a = b;
        b = t;
    }
    return a;
}

spin_status spin_hash_frame(struct hash_model *m, double time, unsigned columns, mlp_block_fn fn,
                            struct spin_splats *out)
{
    return spin_deform_frame(m->path, &m->canonical, time, columns, MOVED, &m->team, fn, m, out);
}
