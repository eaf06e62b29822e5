/* DASH (Chen et al., 2025): a cloud of canonical Gaussians of which some are dynamic; a 4-D hash
 * grid and a network move and reshape those.
 *
 * A descendant of Grid4D. As in the method's render script, the heads for
 * opacity and colour are stored but not used, and static Gaussians stay exactly as they are. */
#include "importers/lib/hashgrid_deform.h"

#include <string.h>

#include "math/quat.h"

struct model {
    struct hash_model base; /* extra: not 0 for dynamic Gaussians; the trunk begins with d4_mlp */
    struct hash_grid grid;
};

static int probe(const struct spin_peek *peek)
{
    return spin_hash_probe(peek, "xyzt_encoding.", "'D4_");
}

/* ---- Opening --------------------------------------------------------------------------------- */

static spin_status load_network(struct hash_model *base)
{
    struct model *model = (struct model *)base;
    int n_features;

    SPIN_TRY(spin_hash_load_grid(base, "xyzt_encoding", 4, &model->grid));
    n_features = model->grid.n_levels * model->grid.n_features;
    base->base.tensors = base->network;
    SPIN_TRY(spin_model_layer(&base->base, "d4_mlp.0", n_features, -1, MLP_RELU, &base->trunk));
    SPIN_TRY(spin_hash_load_heads(base, spin_mlp_n_out(&base->trunk), 3));
    base->layer = spin_mlp_widest(&base->trunk);
    base->n_scratch = 2 * base->layer + 10 * MLP_BLOCK;
    return SPIN_OK;
}

static spin_status open_model(void *self, const char *path)
{
    static const struct hash_method method = {.name = "DASH",
                                              .extra = "dynamic",
                                              .key = "xyzt_encoding.embeddings",
                                              .other_key = "xyt_encoding.embeddings",
                                              .other = "Grid4D, use --from grid4d",
                                              .load = load_network};
    struct hash_model *m = self;
    size_t n_dynamic = 0;
    long long iteration;

    SPIN_TRY(spin_hash_open(m, path, &method));
    for (size_t i = 0; i < m->base.canonical.n; i++)
        n_dynamic += m->extra[i] != 0;
    spin_note(m->base.sequence, "%zu of %zu Gaussians are dynamic", n_dynamic, m->base.canonical.n);
    iteration = spin_model_iteration(m->save);
    if (iteration >= 0 && iteration <= 2000)
        spin_note(m->base.sequence,
                  "%s looks like a save of the first training stage, which works "
                  "otherwise: the result may be wrong",
                  m->save);
    return SPIN_OK;
}

SPIN_MODEL_OPEN(dash_open, struct model, open_model)

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

static void evaluate(void *context, size_t first, int n, float *scratch)
{
    const struct deform_job *job = context;
    const struct model *model = job->model;
    const struct hash_model *base = &model->base;
    float *a = scratch, *b = a + base->layer, *d_mean = b + base->layer;
    float *d_scale = d_mean + 3 * MLP_BLOCK, *d_quat = d_scale + 3 * MLP_BLOCK, *h;
    bool any = false, shape = (job->columns & (SPIN_COL_QUATS | SPIN_COL_LOG_SCALES)) != 0;

    for (int p = 0; p < n; p++)
        any = any || base->extra[first + (size_t)p] != 0;
    for (int p = 0; any && p < MLP_BLOCK; p++) {
        const float *mean = job->from->means + 3 * (first + (size_t)(p < n ? p : n - 1));
        float x[4];

        spin_hash_coordinates(base, mean, job->time, x);
        spin_hash_sample(&model->grid, x, b + p);
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
    return spin_deform_frame(self, time, columns, DEFORM_MOVED, evaluate, out);
}

static const struct spin_plugin_option options[] = {
    {"iteration", "N", "which save to read, a number or best; the last when not given", NULL},
    {"bound", "X", "half the side of the box of the grid, instead of what cfg_args says", NULL},
    {"scale-xyz", "X[,Y,Z]", "the option scale_xyz of the run, instead of what cfg_args says",
     NULL},
    {NULL, NULL, NULL, NULL},
};

const struct spin_importer spin_importer_dash = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "dash",
    .summary = "DASH: the model's folder, with cfg_args, point_cloud and deform",
    .upstream = "chenj02/DASH 0898b2d",
    .options = options,
    .probe = probe,
    .open = dash_open,
    .frame = dash_frame,
    .close = spin_model_close,
};
