/* Grid4D (Xu et al., NeurIPS 2024): a cloud of canonical Gaussians, four 3-D hash grids (one over
 * space, three over two axes of space and time) and a network that rotates, moves and reshapes the
 * Gaussians.
 *
 * Residuals are added after the activations, so the norms of the quaternions that the method's
 * rasteriser receives are not 1: see spin_deform_shape().
 *
 * DASH (Chen et al., 2025): a descendant of Grid4D. A cloud of canonical Gaussians, some of which
 * are dynamic; a 4-D hash grid and a network move and reshape the dynamic ones. The heads for
 * opacity and colour are stored, but the importer does not use them, like the method's render
 * script. Static Gaussians do not change. */
#include <string.h>

#include "importers/lib/deform.h"
#include "math/grid.h"
#include "math/quat.h"
#include "math/rounded.h"

enum { HASH_MAX_LEVELS = 64 };

struct hash_level {
    float scale[4];
    uint32_t res[4], rows;
    int hashed;
    const float *table; /* [rows][n_features] */
};

struct hash_grid {
    int n_dims, n_levels, n_features; /* n_features: number of features of each level */
    struct hash_level level[HASH_MAX_LEVELS];
};

struct hash_model;

/* The differences between Grid4D and DASH. */
struct hash_method {
    const char *name;              /* name of the method, such as "Grid4D" */
    const char *extra;             /* name of an additional property of the cloud, or NULL */
    const char *key;               /* name of a tensor that only this method's grid has */
    const char *other_key, *other; /* name of a tensor that only the other method's grid has; name
                                      of the other method, with advice for the user */
    /* Loads the networks and sets layer and n_scratch; m is the importer's struct hash_model. */
    spin_status (*load)(struct hash_model *m);
    /* Reads settings other than bound and scale_xyz; may be NULL. */
    spin_status (*settle)(struct hash_model *m);
};

/* The part of a model that both methods share. */
struct hash_model {
    struct spin_model base;
    const struct hash_method *method;
    const char *save; /* name of the checkpoint: iteration_<N> */
    float *extra;     /* [n] values of the additional property of the cloud, or NULL */
    double bound, scale_xyz[3];
    const struct spin_value *grid,
        *network;         /* the two saved dicts; valid during load_checkpoint() */
    struct mlp_net trunk; /* grid_mlp; in DASH, d4_mlp is the first layer */
    int width;            /* number of inputs of each head */
    struct mlp_net warp, rotation, scaling;
    size_t layer;     /* number of floats of a block in the widest layer */
    size_t n_scratch; /* number of floats of scratch memory for a block */
};

/* ---- Recognising ----------------------------------------------------------------------------- */

/* Returns the confidence that the input is of a method. `key` is a tensor name that occurs in the
 * first bytes of this method's checkpoints only, `option` the prefix of the grid options that this
 * method writes to cfg_args. Folder names alone do not identify the method: all descendants of
 * Deformable-3D-Gaussians use the same names. */
static int hash_probe(const struct spin_peek *peek, const char *key, const char *option)
{
    if (!peek->is_folder)
        return spin_peek_contains(peek, key) ? 90 : 0;
    if (!spin_peek_has(peek, "deform") || !spin_peek_has(peek, "point_cloud"))
        return 0;
    if (spin_peek_contains(peek, option))
        return 90;
    return !spin_peek_contains(peek, "Namespace(") ? 55
           : spin_peek_contains(peek, "grid_args") ? 40
                                                   : 0;
}

/* ---- Settings -------------------------------------------------------------------------------- */

static spin_status read_settings(struct hash_model *m)
{
    struct cfg_span bound = spin_model_option_span(&m->base, "bound");
    const char *scale = spin_model_option(&m->base, "scale-xyz");
    const struct cfg_args *cfg = &m->base.settings.cfg;
    struct cfg_span grid_args = spin_cfg_get(cfg, "grid_args"), s;

    if (bound.at) {
        if (!spin_cfg_number(bound, &m->bound))
            return spin_misuse("--bound '%s': expected a number", bound.at);
    } else if (!grid_args.at) {
        return spin_not_found(
            "%s%s%s does not give the bound of the scene, which is required: use --bound",
            cfg->path ? "'" : "", cfg->path ? cfg->path : "there is no cfg_args, so the model",
            cfg->path ? "'" : "");
    } else if ((s = spin_cfg_item(grid_args, "bound")).at) {
        if (!spin_cfg_number(s, &m->bound))
            return spin_malformed("'%s': bound is not a number", cfg->path);
    } else {
        m->bound = 1.6;
        spin_note(m->base.sequence, "cfg_args has no bound: assumed 1.6, the method's default");
    }
    if (!(m->bound > 0) || !isfinite(m->bound))
        return spin_fail(bound.at ? SPIN_E_USAGE : SPIN_E_MALFORMED,
                         "%s: bound is %g, expected a number above 0",
                         bound.at ? "--bound" : cfg->path, m->bound);
    m->scale_xyz[0] = m->scale_xyz[1] = m->scale_xyz[2] = 1;
    if (scale) {
        char list[128];

        snprintf(list, sizeof list, strchr(scale, ',') ? "[%.100s]" : "%.100s", scale);
        if (!spin_cfg_numbers((struct cfg_span){list, list + strlen(list)}, 3, m->scale_xyz))
            return spin_misuse(
                "--scale-xyz '%s': expected one number, or three separated by commas", scale);
        return SPIN_OK;
    }
    s = spin_cfg_get(cfg, "scale_xyz");
    if (s.at && !spin_cfg_numbers(s, 3, m->scale_xyz))
        return spin_malformed("'%s': scale_xyz is neither a number nor a list of three numbers",
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
        return spin_malformed("there is no tensor '%s'", what);
    SPIN_TRY(spin_torch_tensor_of(&m->base.torch, v, what, 1, shape, &t));
    if (t.count < 2 || t.count > HASH_MAX_LEVELS + 1 || (t.kind != 'i' && t.kind != 'u'))
        return spin_malformed("tensor '%s' has %llu values, expected 2 to %d whole numbers", what,
                              (unsigned long long)t.count, HASH_MAX_LEVELS + 1);
    spin_array_to_i64(&t, 0, t.count, offset);
    *n_levels = (int)t.count - 1;
    if (offset[0] != 0)
        return spin_malformed("tensor '%s' begins with %lld, expected 0", what,
                              (long long)offset[0]);
    for (int l = 0; l < *n_levels; l++) {
        if (offset[l + 1] <= offset[l] || (uint64_t)offset[l + 1] > n_rows)
            return spin_malformed(
                "tensor '%s': level %d has rows %lld to %lld, but the table has %llu rows", what, l,
                (long long)offset[l], (long long)offset[l + 1], (unsigned long long)n_rows);
    }
    return SPIN_OK;
}

/* Loads the hash grid `name`, whose points have n_dims coordinates. */
static spin_status hash_load_grid(struct hash_model *m, const char *name, int n_dims,
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
        return spin_malformed("tensor '%s' has %llu features per row, expected 1, 2, 4 or 8", key,
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
            return spin_malformed("tensors '%s.per_level_scale' and '.base_resolution' yield no "
                                  "valid grid at level %d",
                                  name, l);
        level->rows = (uint32_t)(offset[l + 1] - offset[l]);
        level->hashed = spin_grid_is_hashed(level->res, level->rows);
        level->table = table + (size_t)offset[l] * (size_t)grid->n_features;
    }
    return SPIN_OK;
}

/* Loads the layers grid_mlp.0, grid_mlp.2, ..., which have `width` inputs and outputs, and the
 * heads; gaussian_warp has n_warp outputs. m->base.tensors must be the dict of the network, not
 * that of the grid. */
static spin_status hash_load_heads(struct hash_model *m, int width, int n_warp)
{
    m->width = width;
    SPIN_TRY(spin_model_trunk(&m->base, "grid_mlp", 0, width, &m->trunk));
    SPIN_TRY(spin_model_layer(&m->base, "gaussian_warp", width, n_warp, MLP_PLAIN, &m->warp));
    SPIN_TRY(spin_model_layer(&m->base, "gaussian_rotation", width, 4, MLP_PLAIN, &m->rotation));
    return spin_model_layer(&m->base, "gaussian_scaling", width, 3, MLP_PLAIN, &m->scaling);
}

/* ---- Opening --------------------------------------------------------------------------------- */

/* Splits the saved pair (grid, network) and checks that the pair belongs to this method. */
static spin_status split_checkpoint(struct hash_model *m)
{
    const struct spin_value *root = m->base.torch.root;
    const struct hash_method *method = m->method;

    m->grid = spin_value_at(root, 0);
    m->network = spin_value_at(root, 1);
    if (root && root->kind == SPIN_VALUE_DICT)
        return spin_unsupported("the file has a single state dict, not a pair of grid and network: "
                                "it is probably of Deformable 3D Gaussians");
    if (!root || root->kind != SPIN_VALUE_TUPLE || root->n != 2 ||
        m->grid->kind != SPIN_VALUE_DICT || m->network->kind != SPIN_VALUE_DICT)
        return spin_malformed("the file does not contain a pair of state dicts, grid and network");
    if (spin_value_get(m->grid, method->other_key))
        return spin_unsupported("tensor '%s' belongs to a run of %s", method->other_key,
                                method->other);
    if (spin_value_get(m->network, method->key))
        return spin_malformed("the pair is swapped: the network comes before the grid");
    if (!spin_value_get(m->grid, method->key))
        return spin_malformed("there is no tensor '%s'", method->key);
    m->base.tensors = m->grid;
    return SPIN_OK;
}

static spin_status load_checkpoint(struct spin_model *base)
{
    struct hash_model *m = (struct hash_model *)base;

    SPIN_TRY(split_checkpoint(m));
    return m->method->load(m);
}

/* Opens the checkpoint at `path`, which is the model's folder or a deform.pth in it. The tensors do
 * not contain bound and scale_xyz: these are read from options or cfg_args. */
static spin_status hash_open(struct hash_model *m, const char *path,
                             const struct hash_method *method)
{
    struct spin_model *base = &m->base;
    struct deform_save save;

    m->method = method;
    SPIN_TRY(spin_deform_find(base, path, false, &save));
    base->path = save.network;
    m->save = save.name;
    SPIN_TRY(spin_model_cfg(base, save.model, NULL));
    SPIN_TRY(spin_model_torch(base, save.network, load_checkpoint));
    SPIN_TRY(read_settings(m));
    if (method->settle)
        SPIN_TRY(method->settle(m));
    SPIN_TRY(spin_model_read(base, save.cloud, method->extra, 0, &m->extra));
    spin_model_describe(base, &base->canonical.n, base->canonical.sh_degree, DEFORM_MOVED);
    snprintf(base->sequence->variant, sizeof base->sequence->variant,
             "%s, %zu Gaussians, bound %g, width %d", method->name, base->canonical.n, m->bound,
             m->width);
    spin_note(base->sequence, "times run from 0 to 1 and are not stored: frame i of n is at "
                              "i/(n-1) in most data sets, at i/n in some");
    return spin_mlp_team_create(m->n_scratch, &base->team);
}

/* ---- Evaluating ------------------------------------------------------------------------------ */

/* Interpolates one level at x in [0, 1]^n_dims and writes the features to out[0], out[MLP_BLOCK],
 * ... Callers pass constants for n_dims and n_features, so the compiler can unroll the inlined
 * loops. As in the method's kernel, x * scale is rounded only once. */
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

/* Samples all levels at x into one column of a block [levels x features][MLP_BLOCK]. Features are 0
 * if any coordinate is outside [0, 1]. */
static void hash_sample(const struct hash_grid *grid, const float *x, float *out)
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

/* Computes the inputs of the grids: maps positions from [-bound, bound] to [0, 1], and the time
 * from [0, 1] to [0.05, 0.95]. Operations are in float and in the method's order. */
static void hash_coordinates(const struct hash_model *m, const float p[3], float time, float out[4])
{
    float bound = (float)m->bound;

    for (int d = 0; d < 3; d++)
        out[d] = (p[d] * (float)m->scale_xyz[d] + bound) / (2 * bound);
    out[3] = ((time * 2 * bound - bound) * 0.9f + bound) / (2 * bound);
}

/* ---- Grid4D ---------------------------------------------------------------------------------- */

enum { XYZ, XYT, YZT, XZT, N_GRIDS };

/* The grids, in the order in which the network receives their features. */
static const struct {
    const char *name;
    int axis[3];
} grids[N_GRIDS] = {
    {"xyz_encoding", {0, 1, 2}},
    {"xyt_encoding", {0, 1, 3}},
    {"yzt_encoding", {1, 2, 3}},
    {"xzt_encoding", {0, 2, 3}},
};

struct grid4d_model {
    struct hash_model base;
    struct hash_grid grid[N_GRIDS];
    struct mlp_net spatial, temporal;
    bool directional;
};

static int grid4d_probe(const struct spin_peek *peek)
{
    return hash_probe(peek, "xyt_encoding.", "'deform_");
}

/* Reads network_args['directional']. If it is true, the gate in hidden_layer() has the range -1..1,
 * otherwise 0..1. */
static spin_status read_directional(struct hash_model *base)
{
    struct grid4d_model *model = (struct grid4d_model *)base;
    struct cfg_span given = spin_model_option_span(&base->base, "directional");
    const struct cfg_args *cfg = &base->base.settings.cfg;
    struct cfg_span s = spin_cfg_item(spin_cfg_get(cfg, "network_args"), "directional");

    model->directional = true;
    if (given.at) {
        if (!spin_cfg_bool(given, &model->directional))
            return spin_misuse("--directional '%s': expected true or false", given.at);
    } else if (s.at) {
        if (!spin_cfg_bool(s, &model->directional))
            return spin_malformed("'%s': directional is neither True nor False", cfg->path);
    } else {
        spin_note(base->base.sequence,
                  "cfg_args has no 'directional': assumed true, the method's default");
    }
    return SPIN_OK;
}

static spin_status grid4d_load(struct hash_model *base)
{
    struct grid4d_model *model = (struct grid4d_model *)base;
    int n_space = 0, n_temporal = 0;
    size_t spatial, temporal;

    for (int g = 0; g < N_GRIDS; g++) {
        SPIN_TRY(hash_load_grid(base, grids[g].name, 3, &model->grid[g]));
        *(g == XYZ ? &n_space : &n_temporal) += model->grid[g].n_levels * model->grid[g].n_features;
    }
    base->base.tensors = base->network;
    SPIN_TRY(
        spin_model_layer(&base->base, "spatial_mlp.0", n_space, -1, MLP_PLAIN, &model->spatial));
    SPIN_TRY(spin_model_layer(&base->base, "temporal_mlp.0", n_temporal,
                              spin_mlp_n_out(&model->spatial), MLP_RELU, &model->temporal));
    spatial = spin_mlp_widest(&model->spatial);
    temporal = spin_mlp_widest(&model->temporal);
    base->layer = spatial > temporal ? spatial : temporal;
    base->n_scratch = 3 * base->layer + 14 * MLP_BLOCK;
    return hash_load_heads(base, spin_mlp_n_out(&model->spatial), 7);
}

static spin_status grid4d_open_save(void *self, const char *path)
{
    static const struct hash_method method = {.name = "Grid4D",
                                              .key = "xyt_encoding.embeddings",
                                              .other_key = "xyzt_encoding.embeddings",
                                              .other = "DASH: use --from dash",
                                              .load = grid4d_load,
                                              .settle = read_directional};

    return hash_open(self, path, &method);
}

/* ---- Evaluating ------------------------------------------------------------------------------ */

/* Computes the features of a block: writes the features of the spatial grid to `space`, and the
 * features of the three grids with a time axis to `moving`, grid after grid. */
static void sample_grids(const struct deform_job *job, size_t first, int n, float *space,
                         float *moving)
{
    const struct grid4d_model *model = job->model;

    for (int p = 0; p < MLP_BLOCK; p++) {
        const float *mean = job->from->means + 3 * (first + (size_t)(p < n ? p : n - 1));
        float u[4], *to = moving;

        hash_coordinates(&model->base, mean, job->time, u);
        for (int g = 0; g < N_GRIDS; g++) {
            const int *axis = grids[g].axis;
            float x[4] = {u[axis[0]], u[axis[1]], u[axis[2]], 0};

            hash_sample(&model->grid[g], x, (g == XYZ ? space : to) + p);
            if (g != XYZ)
                to += model->grid[g].n_levels * model->grid[g].n_features * MLP_BLOCK;
        }
    }
}

/* Computes the hidden layer that the heads receive: multiplies the output of temporal_mlp, after
 * its ReLU, by a gate that depends on the position, and runs grid_mlp. Returns the layer of
 * `scratch` that contains the result. */
static float *hidden_layer(const struct deform_job *job, size_t first, int n, float *scratch)
{
    const struct grid4d_model *model = job->model;
    float *a = scratch, *b = a + model->base.layer, *gate = b + model->base.layer;
    int n_hidden = model->base.width * MLP_BLOCK;

    sample_grids(job, first, n, a, b);
    spin_mlp_run(&model->spatial, a, gate, NULL);
    for (int i = 0; i < n_hidden; i++) {
        gate[i] = 1 / (1 + spin_rounded_exp(-gate[i]));
        if (model->directional)
            gate[i] = 2 * gate[i] - 1;
    }
    spin_mlp_run(&model->temporal, b, a, NULL);
    for (int i = 0; i < n_hidden; i++)
        a[i] *= gate[i];
    return spin_mlp_run(&model->base.trunk, a, b, a);
}

/* Rotates positions about the world's origin, then translates them. */
static void move_gaussians(const struct deform_job *job, const float *warp, size_t first, int n)
{
    float *means = job->out->means;

    for (int p = 0; p < n; p++) {
        size_t at = 3 * (first + (size_t)p);
        float q[4];

        for (int c = 0; c < 4; c++)
            q[c] = warp[c * MLP_BLOCK + p] + (c == 0);
        spin_quat_rotate(q, job->from->means + at, means + at);
        for (int c = 0; c < 3; c++)
            means[at + (size_t)c] += warp[(4 + c) * MLP_BLOCK + p];
    }
}

static void grid4d_evaluate(void *context, size_t first, int n, float *scratch)
{
    const struct deform_job *job = context;
    const struct grid4d_model *model = job->model;
    float *warp = scratch + 3 * model->base.layer, *d_scale = warp + 7 * MLP_BLOCK;
    float *d_quat = d_scale + 3 * MLP_BLOCK, *h = hidden_layer(job, first, n, scratch);

    if (job->columns & SPIN_COL_MEANS) {
        spin_mlp_run(&model->base.warp, h, warp, NULL);
        move_gaussians(job, warp, first, n);
    }
    if (job->columns & (SPIN_COL_QUATS | SPIN_COL_LOG_SCALES)) {
        spin_mlp_run(&model->base.scaling, h, d_scale, NULL);
        spin_mlp_run(&model->base.rotation, h, d_quat, NULL);
        spin_deform_shape(job, first, n, d_scale, d_quat);
    }
}

static spin_status grid4d_frame(void *self, int frame, double time, unsigned columns,
                                struct spin_splats *out)
{
    (void)frame;
    return spin_deform_frame(self, time, columns, DEFORM_MOVED, grid4d_evaluate, out);
}

/* Options of Grid4D; DASH has all except the first. */
static const struct spin_plugin_option options[] = {
    {"directional", "BOOL", "the option directional of the run (default: as in cfg_args)", NULL},
    {"iteration", "N", "the checkpoint to read, a number or best (default: the last)", NULL},
    {"bound", "X", "half the side of the grids' bounding box (default: as in cfg_args)", NULL},
    {"scale-xyz", "X[,Y,Z]", "the option scale_xyz of the run (default: as in cfg_args)", NULL},
    {NULL, NULL, NULL, NULL},
};

SPIN_MODEL_IMPORTER(grid4d, struct grid4d_model, grid4d_open_save, spin_model_close,
                    .summary = "Grid4D: the model's folder, with cfg_args, point_cloud and deform",
                    .upstream = "JiaweiXu8/Grid4D c9a93fb", .options = options,
                    .probe = grid4d_probe, .frame = grid4d_frame)

/* ---- DASH ------------------------------------------------------------------------------------ */

struct dash_model {
    struct hash_model base; /* base.extra: not 0 for dynamic Gaussians */
    struct hash_grid grid;
};

static int dash_probe(const struct spin_peek *peek)
{
    return hash_probe(peek, "xyzt_encoding.", "'D4_");
}

/* ---- Opening --------------------------------------------------------------------------------- */

static spin_status dash_load(struct hash_model *base)
{
    struct dash_model *model = (struct dash_model *)base;
    int n_features;

    SPIN_TRY(hash_load_grid(base, "xyzt_encoding", 4, &model->grid));
    n_features = model->grid.n_levels * model->grid.n_features;
    base->base.tensors = base->network;
    SPIN_TRY(spin_model_layer(&base->base, "d4_mlp.0", n_features, -1, MLP_RELU, &base->trunk));
    SPIN_TRY(hash_load_heads(base, spin_mlp_n_out(&base->trunk), 3));
    base->layer = spin_mlp_widest(&base->trunk);
    base->n_scratch = 2 * base->layer + 10 * MLP_BLOCK;
    return SPIN_OK;
}

static spin_status dash_open_save(void *self, const char *path)
{
    static const struct hash_method method = {.name = "DASH",
                                              .extra = "dynamic",
                                              .key = "xyzt_encoding.embeddings",
                                              .other_key = "xyt_encoding.embeddings",
                                              .other = "Grid4D: use --from grid4d",
                                              .load = dash_load};
    struct hash_model *m = self;
    size_t n_dynamic = 0;
    long long iteration;

    SPIN_TRY(hash_open(m, path, &method));
    for (size_t i = 0; i < m->base.canonical.n; i++)
        n_dynamic += m->extra[i] != 0;
    spin_note(
        m->base.sequence, "%s dynamic",
        spin_text_share(n_dynamic, m->base.canonical.n, "Gaussian", "is", "are", (char[96]){0}));
    iteration = spin_model_iteration(m->save);
    if (iteration >= 0 && iteration <= 2000)
        spin_note(m->base.sequence,
                  "%s is probably of the first training stage, which renders differently: the "
                  "result may be wrong",
                  m->save);
    return SPIN_OK;
}

/* ---- Evaluating ------------------------------------------------------------------------------ */

static void copy_static(const struct deform_job *job, size_t i)
{
    for (int c = 0; c < 3; c++) { /* means, quats and log scales */
        size_t width;
        const float *from = spin_model_values(job->from, c, &width);

        if (job->columns & 1u << c)
            memcpy(spin_model_values(job->out, c, &width) + width * i, from + width * i,
                   width * sizeof *from);
    }
    if (job->columns & SPIN_COL_QUATS)
        spin_quat_normalise(job->out->quats + 4 * i);
}

static void dash_evaluate(void *context, size_t first, int n, float *scratch)
{
    const struct deform_job *job = context;
    const struct dash_model *model = job->model;
    const struct hash_model *base = &model->base;
    float *a = scratch, *b = a + base->layer, *d_mean = b + base->layer;
    float *d_scale = d_mean + 3 * MLP_BLOCK, *d_quat = d_scale + 3 * MLP_BLOCK, *h;
    bool any = false, shape = (job->columns & (SPIN_COL_QUATS | SPIN_COL_LOG_SCALES)) != 0;

    for (int p = 0; p < n; p++)
        any = any || base->extra[first + (size_t)p] != 0;
    for (int p = 0; any && p < MLP_BLOCK; p++) {
        const float *mean = job->from->means + 3 * (first + (size_t)(p < n ? p : n - 1));
        float x[4];

        hash_coordinates(base, mean, job->time, x);
        hash_sample(&model->grid, x, b + p);
    }
    if (any) {
        h = spin_mlp_run(&base->trunk, b, a, b);
        spin_mlp_run(&base->warp, h, d_mean, NULL);
        spin_mlp_run(&base->scaling, h, d_scale, NULL);
        spin_mlp_run(&base->rotation, h, d_quat, NULL);
    }
    for (int p = 0; p < n; p++) {
        size_t i = first + (size_t)p;

        if (base->extra[i] == 0) {
            copy_static(job, i);
            continue;
        }
        for (size_t c = 0; (job->columns & SPIN_COL_MEANS) && c < 3; c++)
            job->out->means[3 * i + c] =
                job->from->means[3 * i + c] + d_mean[c * MLP_BLOCK + (size_t)p];
        if (shape)
            spin_deform_shape(job, i, 1, d_scale + p, d_quat + p);
    }
}

static spin_status dash_frame(void *self, int frame, double time, unsigned columns,
                              struct spin_splats *out)
{
    (void)frame;
    return spin_deform_frame(self, time, columns, DEFORM_MOVED, dash_evaluate, out);
}

SPIN_MODEL_IMPORTER(dash, struct dash_model, dash_open_save, spin_model_close,
                    .summary = "DASH: the model's folder, with cfg_args, point_cloud and deform",
                    .upstream = "chenj02/DASH 0898b2d", .options = options + 1, .probe = dash_probe,
                    .frame = dash_frame)
