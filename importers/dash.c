/* DASH (Chen et al., 2025): a cloud of canonical Gaussians of which some are dynamic; a 4-D hash
 * grid and a network move and reshape those.
 *
 * A descendant of Grid4D. As in the method's render script, the heads for
 * opacity and colour are stored but not used, and static Gaussians stay exactly as they are. */
#include "spin.h"

#include <stdlib.h>
#include <string.h>

#include "importers/lib/hashgrid_deform.h"
#include "importers/lib/notes.h"
#include "math/quat.h"

struct model {
    struct hash_model base; /* extra: not 0 for dynamic Gaussians */
    struct hash_grid grid;
    struct mlp_linear first;
};

static int probe(const struct spin_peek *peek)
{
    return spin_hash_probe(peek, "xyzt_encoding.", "'D4_");
}

/* ---- Opening --------------------------------------------------------------------------------- */

static spin_status load_network(struct spin_torch *torch, struct hash_model *base)
{
    struct model *model = (struct model *)base;
    struct hash_pair pair;
    int n_features, widest;

    SPIN_TRY(spin_hash_split(torch->root, "xyzt_encoding.embeddings", "xyt_encoding.embeddings",
                             "Grid4D, use --from grid4d", &pair));
    SPIN_TRY(spin_hash_load_grid(torch, pair.grid, "xyzt_encoding", 4, &model->grid));
    n_features = model->grid.n_levels * model->grid.n_features;
    SPIN_TRY(spin_mlp_load(torch, pair.network, "", "d4_mlp.0", n_features, -1, &model->first));
    widest = model->first.n_out > n_features ? model->first.n_out : n_features;
    widest = widest > 4 ? widest : 4; /* a layer also holds a quaternion */
    base->layer = (size_t)widest * MLP_BLOCK;
    base->n_scratch = 2 * base->layer + 8 * MLP_BLOCK;
    return spin_hash_load_heads(torch, pair.network, model->first.n_out, 3, base);
}

static spin_status dash_open(const char *path, const struct spin_plugin_values *values, void **self,
                             struct spin_sequence_info *sequence)
{
    static const struct hash_method method = {"DASH", "dynamic", load_network, NULL};
    struct hash_model *base;
    size_t n_dynamic = 0;
    long long iteration;

    *sequence = (struct spin_sequence_info){.sh_degree = -1};
    SPIN_TRY(spin_alloc(1, sizeof(struct model), self));
    base = *self;
    SPIN_TRY(spin_hash_open(path, values, &method, base, sequence));
    for (size_t i = 0; i < base->canonical.n; i++)
        n_dynamic += base->extra[i] != 0;
    spin_note(sequence, "%zu of %zu Gaussians are dynamic", n_dynamic, base->canonical.n);
    iteration = spin_model_folder_iteration(base->save);
    if (iteration >= 0 && iteration <= 2000)
        spin_note(sequence,
                  "%s looks like a save of the first training stage, which works "
                  "otherwise: the result may be wrong",
                  base->save);
    return SPIN_OK;
}

static void dash_close(void *self)
{
    struct model *model = self;

    if (!model)
        return;
    spin_hash_grid_free(&model->grid);
    spin_mlp_free(&model->first);
    spin_hash_model_free(&model->base);
    free(model);
}

/* ---- Evaluating ------------------------------------------------------------------------------ */

static const float *hidden(const struct deform_job *job, size_t first, int n, float *scratch)
{
    const struct model *model = job->model;
    float *a = scratch, *b = scratch + model->base.layer;

    for (int p = 0; p < MLP_BLOCK; p++) {
        const float *mean = model->base.canonical.means + 3 * (first + (size_t)(p < n ? p : n - 1));
        float x[4];

        spin_hash_coordinates(&model->base, mean, job->time, x);
        spin_hash_sample(&model->grid, x, b + p);
    }
    spin_mlp_linear(&model->first, b, a, true);
    return spin_hash_layers(&model->base, a, b);
}

static void copy_static(const struct spin_splats *from, size_t i, unsigned columns,
                        struct spin_splats *out)
{
    if (columns & SPIN_COL_MEANS)
        memcpy(out->means + 3 * i, from->means + 3 * i, 3 * sizeof *out->means);
    if (columns & SPIN_COL_LOG_SCALES)
        memcpy(out->log_scales + 3 * i, from->log_scales + 3 * i, 3 * sizeof *out->log_scales);
    if (columns & SPIN_COL_QUATS) {
        memcpy(out->quats + 4 * i, from->quats + 4 * i, 4 * sizeof *out->quats);
        spin_quat_normalise(out->quats + 4 * i);
    }
}

static void evaluate(void *context, size_t first, int n, float *scratch)
{
    const struct deform_job *job = context;
    const struct model *model = job->model;
    const struct hash_model *base = &model->base;
    const struct spin_splats *from = &base->canonical;
    float *d_mean = scratch + 2 * base->layer, *d_quat = scratch;
    bool any = false, shape = (job->columns & (SPIN_COL_QUATS | SPIN_COL_LOG_SCALES)) != 0;
    const float *h;

    for (int p = 0; p < n; p++)
        any = any || base->extra[first + (size_t)p] != 0;
    if (any) {
        float *d_scale = d_mean + 4 * MLP_BLOCK;

        h = hidden(job, first, n, scratch);
        if (job->columns & SPIN_COL_MEANS)
            spin_mlp_linear(&base->warp, h, d_mean, false);
        if (shape) {
            spin_mlp_linear(&base->scaling, h, d_scale, false);
            d_quat = h == scratch ? scratch + base->layer : scratch;
            spin_mlp_linear(&base->rotation, h, d_quat, false);
        }
    }
    for (int p = 0; p < n; p++) {
        size_t i = first + (size_t)p;

        if (base->extra[i] == 0) {
            copy_static(from, i, job->columns, job->out);
            continue;
        }
        for (int c = 0; (job->columns & SPIN_COL_MEANS) && c < 3; c++)
            job->out->means[3 * i + (size_t)c] =
                from->means[3 * i + (size_t)c] + d_mean[c * MLP_BLOCK + p];
        if (shape)
            spin_deform_shape(from->log_scales + 3 * i, from->quats + 4 * i,
                              d_mean + 4 * MLP_BLOCK + p, d_quat + p,
                              job->columns & SPIN_COL_LOG_SCALES ? job->out->log_scales + 3 * i
                                                                 : NULL,
                              job->columns & SPIN_COL_QUATS ? job->out->quats + 4 * i : NULL);
    }
}

static spin_status dash_frame(void *self, int frame, double time, unsigned columns,
                              struct spin_splats *out)
{
    (void)frame;
    return spin_hash_frame(self, time, columns, evaluate, out);
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
    .close = dash_close,
};
