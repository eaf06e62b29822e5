/* Grid4D (Xu et al., NeurIPS 2024): a cloud of canonical Gaussians, four 3-D hash grids (one over
 * space, three over two axes and time) and a network that turns, moves and reshapes them.
 *
 * Residuals are added after the activations, so that a quaternion is not of unit
 * length when the method's rasteriser takes it for one: see spin_hash_finish(). */
#include "spin.h"
#include <stdlib.h>

#include "base/err.h"
#include "importers/lib/finite.h"
#include "importers/lib/hashgrid_deform.h"
#include "importers/lib/notes.h"
#include "math/covariance.h"
#include "math/quat.h"

enum { XYZ, XYT, YZT, XZT, N_GRIDS };

/* In the order in which their features follow each other. */
static const struct {
    const char *name;
    int axis[3];
} grids[N_GRIDS] = {
    {"xyz_encoding", {0, 1, 2}},
    {"xyt_encoding", {0, 1, 3}},
    {"yzt_encoding", {1, 2, 3}},
    {"xzt_encoding", {0, 2, 3}},
};

struct model {
    struct hash_model base;
    struct hash_grid grid[N_GRIDS];
    struct mlp_linear spatial, temporal;
    bool directional;
    size_t layer; /* floats of the widest layer of a block */
};

static int probe(const struct spin_peek *peek)
{
    return spin_hash_probe(peek, "xyt_encoding.", "'deform_");
}

/* ---- Opening --------------------------------------------------------------------------------- */

/* network_args['directional']: the gate is -1..1, not 0..1. */
static spin_status settle(const struct cfg_args *cfg, const struct spin_plugin_values *values,
                          struct model *model, struct spin_sequence_info *sequence)
{
    const char *given = spin_plugin_value(values, "directional", NULL);
    struct cfg_span s = spin_cfg_item(spin_cfg_get(cfg, "network_args"), "directional");

    SPIN_TRY(spin_hash_settings(cfg, values, &model->base, sequence));
    model->directional = true;
    if (given) {
        if (!spin_cfg_bool((struct cfg_span){given, given + strlen(given)}, &model->directional))
            return spin_fail(SPIN_E_USAGE, "--directional '%s': expected true or false", given);
    } else if (s.at) {
        if (!spin_cfg_bool(s, &model->directional))
            return spin_fail(SPIN_E_MALFORMED, "'%s': directional is neither True nor False",
                             cfg->path);
    } else {
        spin_note(sequence, "no cfg_args says 'directional': assumed true as the method does");
    }
    return SPIN_OK;
}

static spin_status load_network(struct spin_torch *torch, struct model *model)
{
    struct hash_pair pair;
    int n_features[N_GRIDS], n_temporal = 0;

    SPIN_TRY(spin_hash_split(torch->root, "xyt_encoding.embeddings", "xyzt_encoding.embeddings",
                             "DASH, use --from dash", &pair));
    for (int g = 0; g < N_GRIDS; g++) {
        SPIN_TRY(spin_hash_load_grid(torch, pair.grid, grids[g].name, 3, &model->grid[g]));
        n_features[g] = model->grid[g].n_levels * model->grid[g].n_features;
        n_temporal += g == XYZ ? 0 : n_features[g];
    }
    SPIN_TRY(spin_mlp_load(torch, pair.network, "", "spatial_mlp.0", n_features[XYZ], -1,
                           &model->spatial));
    SPIN_TRY(spin_mlp_load(torch, pair.network, "", "temporal_mlp.0", n_temporal,
                           model->spatial.n_out, &model->temporal));
    model->layer = (size_t)model->spatial.n_out;
    model->layer = model->layer > (size_t)n_temporal ? model->layer : (size_t)n_temporal;
    model->layer = model->layer > (size_t)n_features[XYZ] ? model->layer : (size_t)n_features[XYZ];
    model->layer *= MLP_BLOCK;
    return spin_hash_load_heads(torch, pair.network, model->spatial.n_out, 7, &model->base);
}

static spin_status open_model(const struct hash_files *files,
                              const struct spin_plugin_values *values, struct model *model,
                              struct spin_sequence_info *sequence)
{
    struct spin_torch torch;
    struct cfg_args cfg;
    spin_status status;

    memset(&torch, 0, sizeof torch);
    SPIN_TRY(spin_strdup(files->deform, &model->base.path));
    status = spin_model_folder_cfg(files->model, NULL, &cfg);
    if (status == SPIN_OK)
        status = spin_fail_reading(spin_torch_open(files->deform, &torch), files->deform);
    if (status == SPIN_OK)
        status = spin_fail_reading(load_network(&torch, model), files->deform);
    if (status == SPIN_OK)
        status = settle(&cfg, values, model, sequence);
    spin_torch_close(&torch);
    spin_cfg_close(&cfg);
    SPIN_TRY(status);
    SPIN_TRY(spin_model_folder_read(files->cloud, &model->base.canonical, NULL, NULL));
    model->base.n = model->base.canonical.n;
    spin_hash_describe(&model->base, "Grid4D", sequence);
    return spin_mlp_team_create(3 * model->layer + 16 * MLP_BLOCK, &model->base.team);
}

static spin_status grid4d_open(const char *path, const struct spin_plugin_values *values,
                               void **self, struct spin_sequence_info *sequence)
{
    struct hash_files files;
    spin_status status;

    *sequence = (struct spin_sequence_info){.sh_degree = -1};
    SPIN_TRY(spin_alloc(1, sizeof(struct model), self));
    status = spin_hash_find(path, spin_plugin_value(values, "iteration", NULL), &files);
    if (status == SPIN_OK)
        status = open_model(&files, values, *self, sequence);
    spin_hash_files_free(&files);
    return status;
}

static void grid4d_close(void *self)
{
    struct model *model = self;

    if (!model)
        return;
    for (int g = 0; g < N_GRIDS; g++)
        spin_hash_grid_free(&model->grid[g]);
    spin_mlp_free(&model->spatial);
    spin_mlp_free(&model->temporal);
    spin_hash_model_free(&model->base);
    free(model);
}

/* ---- Evaluating ------------------------------------------------------------------------------ */

struct job {
    const struct model *model;
    struct spin_splats *out;
    unsigned columns;
    float time;
};

/* The features of a block: space into `space`, the three with time, one behind the other, into
 * `moving`. */
static void sample(const struct job *job, size_t first, int n, float *space, float *moving)
{
    const struct model *model = job->model;

    for (int p = 0; p < MLP_BLOCK; p++) {
        const float *mean = model->base.canonical.means + 3 * (first + (size_t)(p < n ? p : n - 1));
        float u[4], *to = moving;

        spin_hash_coordinates(&model->base, mean, job->time, u);
        for (int g = 0; g < N_GRIDS; g++) {
            const int *axis = grids[g].axis;
            float x[4] = {u[axis[0]], u[axis[1]], u[axis[2]], 0};

            spin_hash_sample(&model->grid[g], x, (g == XYZ ? space : to) + p);
            if (g != XYZ)
                to += model->grid[g].n_levels * model->grid[g].n_features * MLP_BLOCK;
        }
    }
}

/* relu(temporal) gated by what is at the point's place; then grid_mlp. Returns where it is. */
static const float *hidden(const struct job *job, size_t first, int n, float *scratch)
{
    const struct model *model = job->model;
    float *a = scratch, *b = scratch + model->layer, *gate = scratch + 2 * model->layer;
    int n_hidden = model->base.width * MLP_BLOCK;

    sample(job, first, n, a, b);
    spin_mlp_linear(&model->spatial, a, gate, false);
    for (int i = 0; i < n_hidden; i++) {
        gate[i] = 1 / (1 + expf(-gate[i]));
        if (model->directional)
            gate[i] = 2 * gate[i] - 1;
    }
    spin_mlp_linear(&model->temporal, b, a, true);
    for (int i = 0; i < n_hidden; i++)
        a[i] *= gate[i];
    for (int i = 0; i < model->base.depth; i++) {
        float *t = a;

        spin_mlp_linear(&model->base.grid_mlp[i], a, b, true);
        a = b;
        b = t;
    }
    return a;
}

/* Turned about the world's origin, then moved. */
static void move(const struct model *model, const float *warp, size_t first, int n, float *means)
{
    for (int p = 0; p < n; p++) {
        size_t at = 3 * (first + (size_t)p);
        float q[4];

        for (int c = 0; c < 4; c++)
            q[c] = warp[c * MLP_BLOCK + p] + (c == 0);
        spin_quat_rotate(q, model->base.canonical.means + at, means + at);
        for (int c = 0; c < 3; c++)
            means[at + (size_t)c] += warp[(4 + c) * MLP_BLOCK + p];
    }
}

static void evaluate(void *context, size_t first, int n, float *scratch)
{
    const struct job *job = context;
    const struct model *model = job->model;
    const struct spin_splats *from = &model->base.canonical;
    float *out = scratch + 3 * model->layer, *d_scale = out + 8 * MLP_BLOCK;
    const float *h = hidden(job, first, n, scratch);

    if (job->columns & SPIN_COL_MEANS) {
        spin_mlp_linear(&model->base.warp, h, out, false);
        move(model, out, first, n, job->out->means);
    }
    if (!(job->columns & (SPIN_COL_QUATS | SPIN_COL_LOG_SCALES)))
        return;
    spin_mlp_linear(&model->base.rotation, h, out, false);
    spin_mlp_linear(&model->base.scaling, h, d_scale, false);
    for (int p = 0; p < n; p++) {
        size_t i = first + (size_t)p;

        spin_hash_finish(from->log_scales + 3 * i, from->quats + 4 * i, d_scale + p, out + p,
                         job->columns & SPIN_COL_LOG_SCALES ? job->out->log_scales + 3 * i : NULL,
                         job->columns & SPIN_COL_QUATS ? job->out->quats + 4 * i : NULL);
    }
}

static spin_status grid4d_frame(void *self, int frame, double time, unsigned columns,
                                struct spin_splats *out)
{
    struct model *model = self;
    struct job job = {model, out, columns, (float)time};

    (void)frame;
    if (!isfinite(time))
        return spin_fail(SPIN_E_USAGE, "'%s' has no time %g", model->base.path, time);
    columns &= SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    SPIN_TRY(spin_splats_reserve(out, model->base.n, columns, model->base.canonical.sh_degree));
    spin_hash_copy_still(&model->base, columns, out);
    if (columns & ~(unsigned)(SPIN_COL_LOGIT_OPACITIES | SPIN_COL_SH))
        spin_mlp_team_run(&model->base.team, model->base.n, evaluate, &job);
    return spin_model_folder_check(model->base.path, time, columns, out);
}

static const struct spin_plugin_option options[] = {
    {"iteration", "N", "which save to read, a number or best; the last when not given", NULL},
    {"bound", "X", "half the side of the box of the grids, instead of what cfg_args says", NULL},
    {"scale-xyz", "X[,Y,Z]", "the option scale_xyz of the run, instead of what cfg_args says",
     NULL},
    {"directional", "BOOL", "the option of that name of the run, instead of what cfg_args says",
     NULL},
    {NULL, NULL, NULL, NULL},
};

const struct spin_importer spin_importer_grid4d = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "grid4d",
    .summary = "Grid4D: the model's folder, with cfg_args, point_cloud and deform",
    .upstream = "JiaweiXu8/Grid4D c9a93fb",
    .options = options,
    .probe = probe,
    .open = grid4d_open,
    .frame = grid4d_frame,
    .close = grid4d_close,
};
