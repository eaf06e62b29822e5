/* Grid4D (Xu et al., NeurIPS 2024): a cloud of canonical Gaussians, four 3-D hash grids (one over
 * space, three over two axes and time) and a network that turns, moves and reshapes them.
 *
 * Residuals are added after the activations, so that a quaternion is not of unit
 * length when the method's rasteriser takes it for one: see spin_deform_shape(). */
#include "importers/lib/hashgrid_deform.h"

#include <string.h>

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
    struct mlp_net spatial, temporal;
    bool directional;
};

static int probe(const struct spin_peek *peek)
{
    return spin_hash_probe(peek, "xyt_encoding.", "'deform_");
}

/* ---- Opening --------------------------------------------------------------------------------- */

/* network_args['directional']: the gate is -1..1, not 0..1. */
static spin_status settle(struct hash_model *base)
{
    struct model *model = (struct model *)base;
    const char *given = spin_model_option(&base->base, "directional");
    const struct cfg_args *cfg = &base->base.settings.cfg;
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
        spin_note(base->base.sequence,
                  "no cfg_args says 'directional': assumed true as the method does");
    }
    return SPIN_OK;
}

static spin_status load_network(struct hash_model *base)
{
    struct model *model = (struct model *)base;
    int n_space = 0, n_temporal = 0;
    size_t spatial, temporal;

    for (int g = 0; g < N_GRIDS; g++) {
        SPIN_TRY(spin_hash_load_grid(base, grids[g].name, 3, &model->grid[g]));
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
    return spin_hash_load_heads(base, spin_mlp_n_out(&model->spatial), 7);
}

static spin_status open_model(void *self, const char *path)
{
    static const struct hash_method method = {.name = "Grid4D",
                                              .key = "xyt_encoding.embeddings",
                                              .other_key = "xyzt_encoding.embeddings",
                                              .other = "DASH, use --from dash",
                                              .load = load_network,
                                              .settle = settle};

    return spin_hash_open(self, path, &method);
}

SPIN_MODEL_OPEN(grid4d_open, struct model, open_model)

/* ---- Evaluating ------------------------------------------------------------------------------ */

/* The features of a block: space into `space`, the three with time, one behind the other, into
 * `moving`. */
static void sample(const struct deform_job *job, size_t first, int n, float *space, float *moving)
{
    const struct model *model = job->model;

    for (int p = 0; p < MLP_BLOCK; p++) {
        const float *mean = job->from->means + 3 * (first + (size_t)(p < n ? p : n - 1));
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
static float *hidden(const struct deform_job *job, size_t first, int n, float *scratch)
{
    const struct model *model = job->model;
    float *a = scratch, *b = a + model->base.layer, *gate = b + model->base.layer;
    int n_hidden = model->base.width * MLP_BLOCK;

    sample(job, first, n, a, b);
    spin_mlp_run(&model->spatial, a, gate, NULL);
    for (int i = 0; i < n_hidden; i++) {
        gate[i] = 1 / (1 + expf(-gate[i]));
        if (model->directional)
            gate[i] = 2 * gate[i] - 1;
    }
    spin_mlp_run(&model->temporal, b, a, NULL);
    for (int i = 0; i < n_hidden; i++)
        a[i] *= gate[i];
    return spin_mlp_run(&model->base.trunk, a, b, a);
}

/* Turned about the world's origin, then moved. */
static void move(const struct deform_job *job, const float *warp, size_t first, int n)
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

static void evaluate(void *context, size_t first, int n, float *scratch)
{
    const struct deform_job *job = context;
    const struct model *model = job->model;
    float *warp = scratch + 3 * model->base.layer, *d_scale = warp + 7 * MLP_BLOCK;
    float *d_quat = d_scale + 3 * MLP_BLOCK, *h = hidden(job, first, n, scratch);

    if (job->columns & SPIN_COL_MEANS) {
        spin_mlp_run(&model->base.warp, h, warp, NULL);
        move(job, warp, first, n);
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
    return spin_deform_frame(self, time, columns, DEFORM_MOVED, evaluate, out);
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
    .close = spin_model_close,
};
