/* Grid4D (Xu et al., NeurIPS 2024): a cloud of canonical Gaussians, four 3-D hash grids (one over
 * space, three over two axes and time) and a network that turns, moves and reshapes them.
 *
 * Residuals are added after the activations, so that a quaternion is not of unit
 * length when the method's rasteriser takes it for one: see spin_deform_shape(). */
#include "spin.h"

#include <stdlib.h>
#include <string.h>

#include "importers/lib/hashgrid_deform.h"
#include "importers/lib/notes.h"
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
};

static int probe(const struct spin_peek *peek)
{
    return spin_hash_probe(peek, "xyt_encoding.", "'deform_");
}

/* ---- Opening --------------------------------------------------------------------------------- */

/* network_args['directional']: the gate is -1..1, not 0..1. */
static spin_status settle(const struct cfg_args *cfg, const struct spin_plugin_values *values,
                          struct hash_model *base, struct spin_sequence_info *sequence)
{
    struct model *model = (struct model *)base;
    const char *given = spin_plugin_value(values, "directional", NULL);
    struct cfg_span s = spin_cfg_item(spin_cfg_get(cfg, "network_args"), "directional");

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

static spin_status load_network(struct spin_torch *torch, struct hash_model *base)
{
    struct model *model = (struct model *)base;
    struct hash_pair pair;
    int n_features[N_GRIDS], n_temporal = 0, widest;

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
    widest = model->spatial.n_out > n_temporal ? model->spatial.n_out : n_temporal;
    widest = widest > n_features[XYZ] ? widest : n_features[XYZ];
    base->layer = (size_t)widest * MLP_BLOCK;
    base->n_scratch = 3 * base->layer + 16 * MLP_BLOCK;
    return spin_hash_load_heads(torch, pair.network, model->spatial.n_out, 7, base);
}

static spin_status grid4d_open(const char *path, const struct spin_plugin_values *values,
                               void **self, struct spin_sequence_info *sequence)
{
    static const struct hash_method method = {"Grid4D", NULL, load_network, settle};

    *sequence = (struct spin_sequence_info){.sh_degree = -1};
    SPIN_TRY(spin_alloc(1, sizeof(struct model), self));
    return spin_hash_open(path, values, &method, *self, sequence);
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

/* The features of a block: space into `space`, the three with time, one behind the other, into
 * `moving`. */
static void sample(const struct deform_job *job, size_t first, int n, float *space, float *moving)
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
static const float *hidden(const struct deform_job *job, size_t first, int n, float *scratch)
{
    const struct model *model = job->model;
    float *a = scratch, *b = a + model->base.layer, *gate = b + model->base.layer;
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
    return spin_hash_layers(&model->base, a, b);
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
    const struct deform_job *job = context;
    const struct model *model = job->model;
    const struct spin_splats *from = &model->base.canonical;
    float *out = scratch + 3 * model->base.layer, *d_scale = out + 8 * MLP_BLOCK;
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

        spin_deform_shape(from->log_scales + 3 * i, from->quats + 4 * i, d_scale + p, out + p,
                          job->columns & SPIN_COL_LOG_SCALES ? job->out->log_scales + 3 * i : NULL,
                          job->columns & SPIN_COL_QUATS ? job->out->quats + 4 * i : NULL);
    }
}

static spin_status grid4d_frame(void *self, int frame, double time, unsigned columns,
                                struct spin_splats *out)
{
    (void)frame;
    return spin_hash_frame(self, time, columns, evaluate, out);
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
