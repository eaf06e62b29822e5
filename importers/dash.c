/* DASH (Chen et al., 2025): a cloud of canonical Gaussians of which some are dynamic; a 4-D hash
 * grid and a network move and reshape those.
 *
 * A descendant of Grid4D. As in the method's render script, the heads for
 * opacity and colour are stored but not used, and static Gaussians stay exactly as they are. */
#include "spin.h"
#include <stdlib.h>

#include "base/err.h"
#include "importers/lib/finite.h"
#include "importers/lib/hashgrid_deform.h"
#include "importers/lib/notes.h"
#include "math/grid.h"
#include "math/quat.h"

struct model {
    struct hash_model base; /* extra: not 0 for dynamic Gaussians */
    struct hash_grid grid;
    struct mlp_linear first;
    size_t layer; /* floats of the widest layer of a block */
};

static int probe(const struct spin_peek *peek)
{
    return spin_hash_probe(peek, "xyzt_encoding.", "'D4_");
}

/* ---- Opening --------------------------------------------------------------------------------- */

static spin_status load_network(struct spin_torch *torch, struct model *model)
{
    struct hash_pair pair;
    int n_features, widest;

    SPIN_TRY(spin_hash_split(torch->root, "xyzt_encoding.embeddings", "xyt_encoding.embeddings",
                             "Grid4D, use --from grid4d", &pair));
    SPIN_TRY(spin_hash_load_grid(torch, pair.grid, "xyzt_encoding", 4, &model->grid));
    n_features = model->grid.n_levels * model->grid.n_features;
    SPIN_TRY(spin_mlp_load(torch, pair.network, "", "d4_mlp.0", n_features, -1, &model->first));
    widest = model->first.n_out > n_features ? model->first.n_out : n_features;
    widest = widest > 4 ? widest : 4; /* a layer also holds a quaternion */
    model->layer = (size_t)widest * MLP_BLOCK;
    return spin_hash_load_heads(torch, pair.network, model->first.n_out, 3, &model->base);
}

static spin_status open_model(const struct hash_files *files,
                              const struct spin_plugin_values *values, struct model *model,
                              struct spin_sequence_info *sequence)
{
    struct hash_model *base = &model->base;
    struct spin_torch torch;
    struct cfg_args cfg;
    size_t n_dynamic = 0;
    spin_status status;

    memset(&torch, 0, sizeof torch);
    SPIN_TRY(spin_strdup(files->deform, &base->path));
    status = spin_model_folder_cfg(files->model, NULL, &cfg);
    if (status == SPIN_OK)
        status = spin_fail_reading(spin_torch_open(files->deform, &torch), files->deform);
    if (status == SPIN_OK)
        status = spin_fail_reading(load_network(&torch, model), files->deform);
    if (status == SPIN_OK)
        status = spin_hash_settings(&cfg, values, base, sequence);
    spin_torch_close(&torch);
    spin_cfg_close(&cfg);
    SPIN_TRY(status);
    SPIN_TRY(spin_model_folder_read(files->cloud, &base->canonical, "dynamic", &base->extra));
    base->n = base->canonical.n;
    spin_hash_describe(base, "DASH", sequence);
    for (size_t i = 0; i < base->n; i++)
        n_dynamic += base->extra[i] != 0;
    spin_note(sequence, "%zu of %zu Gaussians are dynamic", n_dynamic, base->n);
    if (spin_model_folder_iteration(files->name) >= 0 &&
        spin_model_folder_iteration(files->name) <= 2000)
        spin_note(sequence,
                  "%s looks like a save of the first training stage, which works "
                  "otherwise: the result may be wrong",
                  files->name);
    return spin_mlp_team_create(2 * model->layer + 8 * MLP_BLOCK, &base->team);
}

static spin_status dash_open(const char *path, const struct spin_plugin_values *values, void **self,
                             struct spin_sequence_info *sequence)
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

struct job {
    const struct model *model;
    struct spin_splats *out;
    unsigned columns;
    float time;
};

static const float *hidden(const struct job *job, size_t first, int n, float *scratch)
{
    const struct model *model = job->model;
    float *a = scratch, *b = scratch + model->layer;

    for (int p = 0; p < MLP_BLOCK; p++) {
        const float *mean = model->base.canonical.means + 3 * (first + (size_t)(p < n ? p : n - 1));
        float x[4];

        spin_hash_coordinates(&model->base, mean, job->time, x);
        spin_hash_sample(&model->grid, x, b + p);
    }
    spin_mlp_linear(&model->first, b, a, true);
    for (int i = 0; i < model->base.depth; i++) {
        float *t = a;

        spin_mlp_linear(&model->base.grid_mlp[i], a, b, true);
        a = b;
        b = t;
    }
    return a;
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
    const struct job *job = context;
    const struct model *model = job->model;
    const struct hash_model *base = &model->base;
    const struct spin_splats *from = &base->canonical;
    float *d_mean = scratch + 2 * model->layer, *d_quat = scratch;
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
            d_quat = h == scratch ? scratch + model->layer : scratch;
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
            spin_hash_finish(from->log_scales + 3 * i, from->quats + 4 * i,
                             d_mean + 4 * MLP_BLOCK + p, d_quat + p,
                             job->columns & SPIN_COL_LOG_SCALES ? job->out->log_scales + 3 * i
                                                                : NULL,
                             job->columns & SPIN_COL_QUATS ? job->out->quats + 4 * i : NULL);
    }
}

static spin_status dash_frame(void *self, int frame, double time, unsigned columns,
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
