/* 4DGaussians (Wu et al., CVPR 2024): a cloud of canonical Gaussians and a network that adds to
 * their raw attributes at any time.
 *
 * What the network's heads are used for is not in the checkpoint but in cfg_args beside it, which
 * is therefore read, or replaced by options. */
#include "spin.h"

#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "importers/lib/deform.h"
#include "importers/lib/model_folder.h"
#include "importers/lib/hexplane.h"
#include "importers/lib/notes.h"
#include "math/quat.h"

enum { POSITION, SCALE, ROTATION, OPACITY, COLOUR, N_HEADS };

/* `off` is the option of the method that switches a head off, `by_default` its default there. */
static const struct {
    const char *word, *tensor, *off;
    bool by_default;
    int width;
    unsigned column;
} heads[N_HEADS] = {
    {"position", "pos_deform", "no_dx", false, 3, SPIN_COL_MEANS},
    {"scale", "scales_deform", "no_ds", false, 3, SPIN_COL_LOG_SCALES},
    {"rotation", "rotations_deform", "no_dr", false, 4, SPIN_COL_QUATS},
    {"opacity", "opacity_deform", "no_do", true, 1, SPIN_COL_LOGIT_OPACITIES},
    {"sh", "shs_deform", "no_dshs", true, 48, SPIN_COL_SH},
};

struct model {
    char *path; /* of deformation.pth */
    struct spin_splats canonical;
    struct hexplane hex;
    struct hex_head head[N_HEADS]; /* those in use */
    bool used[N_HEADS];
    bool product; /* rotations are multiplied, not added: apply_rotation */
    struct mlp_team team;
};

/* ---- Recognising ----------------------------------------------------------------------------- */

static int probe(const struct spin_peek *peek)
{
    bool cfg = false, cloud = false, other = false, ours, modec;

    if (memmem(peek->head, peek->n_head, "feature_out_c.0.weight", 22)) /* of E-D3DGS */
        return 0;
    if (!peek->is_folder) {
        const char *name = strrchr(peek->path, '/');

        return strcmp(name ? name + 1 : peek->path, "deformation.pth") == 0 ? 85 : 0;
    }
    for (size_t i = 0; peek->names && peek->names[i]; i++) {
        const char *name = peek->names[i];

        if (strcmp(name, "deformation.pth") == 0)
            return 90;
        cfg = cfg || strcmp(name, "cfg_args") == 0;
        cloud = cloud || strcmp(name, "point_cloud") == 0;
        /* What plain 3DGS and the Deformable-3D-Gaussians family write there. */
        other = other || strcmp(name, "deform") == 0 || strcmp(name, "cameras.json") == 0 ||
                strcmp(name, "input.ply") == 0;
    }
    /* An option of the network, and one that MoDec-GS has besides. */
    ours = memmem(peek->head, peek->n_head, "kplanes_config=", 15) != NULL;
    modec = memmem(peek->head, peek->n_head, "LGD_method=", 11) != NULL;
    if (cloud && ours && !modec)
        return 90;
    return cfg && cloud && !other && !modec ? 45 : 0;
}

static spin_status fail_no_save(const char *path, const char *wanted)
{
    bool coarse;

    if (wanted)
        return spin_fail(SPIN_E_NOT_FOUND,
                         "'%s' has no iteration_%s with point_cloud.ply and deformation.pth", path,
                         wanted);
    if (spin_model_folder_search(path, "deformation_GAD.pth", &coarse))
        return spin_fail(SPIN_E_UNSUPPORTED,
                         "'%s' holds 'deformation_GAD.pth': it is a run of MoDec-GS, use --from "
                         "modecgs",
                         path);
    if (coarse)
        return spin_fail(SPIN_E_UNSUPPORTED,
                         "'%s' has only the coarse stage, which has no motion yet: train on, or "
                         "import its point_cloud.ply with --from ply",
                         path);
    return spin_fail(SPIN_E_NOT_FOUND,
                     "'%s' has no iteration_<N> with point_cloud.ply and deformation.pth", path);
}

/* ---- Which heads count ----------------------------------------------------------------------- */

/* "position,rotation" */
static spin_status parse_heads(const char *list, bool used[N_HEADS])
{
    for (int h = 0; h < N_HEADS; h++)
        used[h] = false;
    while (*list) {
        size_t n = strcspn(list, ",");
        bool found = false;

        for (int h = 0; h < N_HEADS; h++) {
            if (strlen(heads[h].word) == n && strncmp(list, heads[h].word, n) == 0)
                used[h] = found = true;
        }
        if (!found && !(n == 4 && strncmp(list, "none", 4) == 0))
            return spin_fail(SPIN_E_USAGE,
                             "--deform '%.*s': expected some of position,scale,rotation,opacity,sh "
                             "or none",
                             (int)n, list);
        list += n + (list[n] == ',');
    }
    return SPIN_OK;
}

/* An untrained Linear layer is still inside the bounds its values were drawn from. */
static bool looks_trained(const struct mlp_linear *l)
{
    double weight = sqrt(6.0 / (l->n_in + l->n_out)), bias = 1 / sqrt((double)l->n_in);

    for (size_t i = 0; i < (size_t)l->n_in * (size_t)l->n_out; i++) {
        if (fabs(l->weight[i]) > weight)
            return true;
    }
    for (int i = 0; i < l->n_out; i++) {
        if (fabs(l->bias[i]) > bias)
            return true;
    }
    return false;
}

/* Without cfg_args: say what was assumed, and what the weights hint at. */
static spin_status note_guess(struct spin_torch *torch, const char *prefix,
                              const struct model *model, struct spin_sequence_info *sequence)
{
    char trained[128] = "";
    int used = 0; /* the words of all heads fit */

    spin_note(sequence, "no cfg_args: assumed that position, scale and rotation are deformed, "
                        "opacity and SH not; --deform sets it");
    spin_warn("'%s': no cfg_args beside it, the method's defaults are assumed", model->path);
    for (int h = 0; h < N_HEADS; h++) {
        struct hex_head head = {0};
        spin_status status = SPIN_OK;

        if (spin_hex_has_head(torch->root, prefix, heads[h].tensor))
            status = spin_hex_load_head(torch, torch->root, prefix, heads[h].tensor,
                                        model->hex.width, heads[h].width, &head);
        if (status == SPIN_OK && head.first.n_in > 0 &&
            (looks_trained(&head.first) || looks_trained(&head.last)))
            used += snprintf(trained + used, sizeof trained - (size_t)used, " %s", heads[h].word);
        spin_hex_head_free(&head);
        SPIN_TRY(status);
    }
    spin_note(sequence, "weights that look trained:%s", trained);
    return SPIN_OK;
}

/* What cfg_args and the options say; options win. */
static spin_status settle(const struct cfg_args *cfg, const struct spin_plugin_values *values,
                          struct model *model, double *grid_pe)
{
    const char *deform = spin_plugin_value(values, "deform", NULL);
    const char *product = spin_plugin_value(values, "apply-rotation", NULL);
    const char *pe = spin_plugin_value(values, "grid-pe", NULL);

    for (int h = 0; h < N_HEADS; h++) {
        bool off = heads[h].by_default;

        SPIN_TRY(spin_cfg_read_bool(cfg, heads[h].off, &off));
        model->used[h] = !off;
    }
    SPIN_TRY(spin_cfg_read_bool(cfg, "apply_rotation", &model->product));
    SPIN_TRY(spin_cfg_read_number(cfg, "grid_pe", grid_pe));
    if (deform)
        SPIN_TRY(parse_heads(deform, model->used));
    if (product &&
        !spin_cfg_bool((struct cfg_span){product, product + strlen(product)}, &model->product))
        return spin_fail(SPIN_E_USAGE, "--apply-rotation '%s': expected true or false", product);
    if (pe && !spin_cfg_number((struct cfg_span){pe, pe + strlen(pe)}, grid_pe))
        return spin_fail(SPIN_E_USAGE, "--grid-pe '%s': expected a number", pe);
    return SPIN_OK;
}

/* ---- Opening --------------------------------------------------------------------------------- */

static spin_status fail_other_network(const struct spin_value *root)
{
    static const char *const theirs[] = {"feature_out_c.0.weight",
                                         "deformation_net.feature_out_c.0.weight"};

    for (size_t i = 0; i < sizeof theirs / sizeof *theirs; i++) {
        if (spin_value_get(root, theirs[i]))
            return spin_fail(
                SPIN_E_UNSUPPORTED,
                "tensor '%s' says that this is a network of E-D3DGS: use --from ed3dgs", theirs[i]);
    }
    return spin_fail(SPIN_E_MALFORMED,
                     "no tensor 'deformation_net.grid.grids.0.0': this is not a network of "
                     "4DGaussians");
}

static spin_status load_network(struct spin_torch *torch, const struct cfg_args *cfg,
                                const struct spin_plugin_values *values, struct model *model,
                                struct spin_sequence_info *sequence)
{
    const struct spin_value *root = torch->root;
    const char *prefix;
    double grid_pe = 0;

    if (!root || root->kind != SPIN_VALUE_DICT)
        return spin_fail(SPIN_E_MALFORMED, "what was saved is not a state dict");
    prefix = spin_hex_prefix(root);
    if (!prefix)
        return fail_other_network(root);
    SPIN_TRY(settle(cfg, values, model, &grid_pe));
    SPIN_TRY(spin_hex_load(torch, root, prefix, grid_pe, &model->hex));
    for (int h = 0; h < N_HEADS; h++) {
        if (model->used[h])
            SPIN_TRY(spin_hex_load_head(torch, root, prefix, heads[h].tensor, model->hex.width,
                                        heads[h].width, &model->head[h]));
    }
    if (!cfg->path && !spin_plugin_value(values, "deform", NULL))
        SPIN_TRY(note_guess(torch, prefix, model, sequence));
    return SPIN_OK;
}

static spin_status open_network(const struct cfg_args *cfg, const struct spin_plugin_values *values,
                                struct model *model, struct spin_sequence_info *sequence)
{
    struct spin_torch torch;
    spin_status status;

    memset(&torch, 0, sizeof torch);
    status = spin_torch_open(model->path, &torch);
    if (status == SPIN_OK)
        status = load_network(&torch, cfg, values, model, sequence);
    spin_torch_close(&torch);
    if (cfg->path && strstr(spin_last_error(), cfg->path))
        return status;
    return spin_fail_reading(status, model->path);
}

/* deformation_table.pth has no say in the result, but its length shows a save that was mixed up. */
static void check_table(const char *save, size_t n, struct spin_sequence_info *sequence)
{
    struct spin_torch torch;
    struct spin_array table;
    char *path = NULL;

    memset(&torch, 0, sizeof torch);
    if (spin_path_join(save, "deformation_table.pth", &path) == SPIN_OK && spin_path_exists(path) &&
        spin_torch_open(path, &torch) == SPIN_OK &&
        spin_torch_tensor(&torch, torch.root, "deformation_table", &table) == SPIN_OK &&
        table.count != n) {
        spin_note(sequence,
                  "deformation_table.pth is for %llu Gaussians, but point_cloud.ply has "
                  "%zu: are they from the same save?",
                  (unsigned long long)table.count, n);
        spin_warn("'%s' is for %llu Gaussians, but the cloud has %zu", path,
                  (unsigned long long)table.count, n);
    }
    spin_torch_close(&torch);
    free(path);
}

static unsigned moved(const struct model *model)
{
    unsigned columns = 0;

    for (int h = 0; h < N_HEADS; h++)
        columns |= model->used[h] ? heads[h].column : 0;
    return columns;
}

static void describe(const struct model *model, struct spin_sequence_info *sequence)
{
    const struct hexplane *hex = &model->hex;

    spin_deform_describe(&model->canonical, moved(model), sequence);
    sequence->half_open = true; /* its reader of Panoptic takes t / T */
    snprintf(sequence->variant, sizeof sequence->variant,
             "4DGaussians, %zu Gaussians, %d scales of planes, width %d", model->canonical.n,
             hex->n_scales, hex->width);
    spin_note(sequence, "times run from 0 to 1 and are not stored: frame i of n is at i/(n-1) for "
                        "D-NeRF and HyperNeRF scenes, i/300 for DyNeRF, i/n for multi-view ones");
}

static spin_status open_model(const char *save, const struct cfg_args *cfg,
                              const struct spin_plugin_values *values, struct model *model,
                              struct spin_sequence_info *sequence)
{
    char *cloud = NULL;
    spin_status status;

    SPIN_TRY(spin_path_join(save, "deformation.pth", &model->path));
    SPIN_TRY(spin_path_join(save, "point_cloud.ply", &cloud));
    status = spin_model_folder_read(cloud, &model->canonical, NULL, NULL);
    if (status == SPIN_OK)
        status = open_network(cfg, values, model, sequence);
    if (status == SPIN_OK && model->used[COLOUR] && model->canonical.sh_degree != 3)
        status = spin_fail(SPIN_E_UNSUPPORTED,
                           "'%s': SH of degree %d, but the network deforms SH of degree 3", cloud,
                           model->canonical.sh_degree);
    free(cloud);
    SPIN_TRY(status);
    check_table(save, model->canonical.n, sequence);
    describe(model, sequence);
    return spin_mlp_team_create(spin_hex_scratch(&model->hex) + 48 * MLP_BLOCK, &model->team);
}

static spin_status gaussian_open(const char *path, const struct spin_plugin_values *values,
                                 void **self, struct spin_sequence_info *sequence)
{
    const char *wanted = spin_plugin_value(values, "iteration", NULL);
    struct cfg_args cfg;
    char *save = NULL;
    spin_status status;

    *sequence = (struct spin_sequence_info){.sh_degree = -1};
    SPIN_TRY(spin_alloc(1, sizeof(struct model), self));
    SPIN_TRY(spin_model_folder_save(path, wanted, "deformation.pth", &save));
    if (!save)
        return fail_no_save(path, wanted);
    status = spin_model_folder_cfg(path, save, &cfg);
    if (status == SPIN_OK)
        status = open_model(save, &cfg, values, *self, sequence);
    spin_cfg_close(&cfg);
    free(save);
    return status;
}

static void gaussian_close(void *self)
{
    struct model *model = self;

    if (!model)
        return;
    for (int h = 0; h < N_HEADS; h++)
        spin_hex_head_free(&model->head[h]);
    spin_hex_free(&model->hex);
    spin_mlp_team_free(&model->team);
    spin_splats_free(&model->canonical);
    free(model->path);
    free(model);
}

/* ---- Evaluating ------------------------------------------------------------------------------ */

/* out = canonical mask + residual, rows of `width` from `first` on. */
static void add(const float *canonical, const float *mask, const float *residual, size_t first,
                int n, int width, float *out)
{
    for (int p = 0; p < n; p++) {
        size_t at = (first + (size_t)p) * (size_t)width;

        for (int c = 0; c < width; c++)
            out[at + (size_t)c] = canonical[at + (size_t)c] * mask[p] + residual[c * MLP_BLOCK + p];
    }
}

static void turn(const struct model *model, const float *residual, size_t first, int n, float *out)
{
    for (int p = 0; p < n; p++) {
        const float *q = model->canonical.quats + 4 * (first + (size_t)p);
        float r[4], *to = out + 4 * (first + (size_t)p);

        for (int c = 0; c < 4; c++)
            r[c] = residual[c * MLP_BLOCK + p];
        if (model->product) {
            spin_quat_product(q, r, to);
        } else { /* the mask leaves rotations alone */
            for (int c = 0; c < 4; c++)
                to[c] = q[c] + r[c];
        }
        spin_quat_normalise(to);
    }
}

static void evaluate(void *context, size_t first, int n, float *scratch)
{
    const struct deform_job *job = context;
    const struct model *model = job->model;
    const struct spin_splats *from = &model->canonical;
    const float *xyz = from->means + 3 * first;
    float *residual = scratch + spin_hex_scratch(&model->hex), *spare, mask[MLP_BLOCK];
    const float *hidden = spin_hex_hidden(&model->hex, xyz, n, job->time, scratch);

    spare = spin_hex_spare(&model->hex, hidden, scratch);
    spin_hex_mask(&model->hex, xyz, n, hidden, spare, mask);
    for (int h = 0; h < N_HEADS; h++) {
        if (!model->used[h] || !(job->columns & heads[h].column))
            continue;
        spin_hex_head(&model->head[h], hidden, spare, residual);
        if (h == POSITION)
            add(from->means, mask, residual, first, n, 3, job->out->means);
        else if (h == SCALE)
            add(from->log_scales, mask, residual, first, n, 3, job->out->log_scales);
        else if (h == ROTATION)
            turn(model, residual, first, n, job->out->quats);
        else if (h == OPACITY)
            add(from->logit_opacities, mask, residual, first, n, 1, job->out->logit_opacities);
        else
            add(from->sh, mask, residual, first, n, 48, job->out->sh);
    }
}

static spin_status gaussian_frame(void *self, int frame, double time, unsigned columns,
                                  struct spin_splats *out)
{
    struct model *model = self;

    (void)frame;
    return spin_deform_frame(model->path, &model->canonical, time, columns, moved(model),
                             &model->team, evaluate, model, out);
}

static const struct spin_plugin_option options[] = {
    {"iteration", "N", "which save to read; the last when not given", NULL},
    {"deform", "LIST",
     "what the network moves, of position,scale,rotation,opacity,sh, instead of what cfg_args says",
     NULL},
    {"apply-rotation", "BOOL", "rotations are multiplied, instead of what cfg_args says", NULL},
    {"grid-pe", "X", "the option grid_pe of the run, instead of what cfg_args says", NULL},
    {NULL, NULL, NULL, NULL},
};

const struct spin_importer spin_importer_4dgaussian = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "4dgaussian",
    .summary = "4DGaussians: the model's folder, with cfg_args and point_cloud/iteration_<N>",
    .upstream = "hustvl/4DGaussians 843d5ac",
    .options = options,
    .probe = probe,
    .open = gaussian_open,
    .frame = gaussian_frame,
    .close = gaussian_close,
};
