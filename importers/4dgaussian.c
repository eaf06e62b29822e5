/* 4DGaussians (Wu et al., CVPR 2024): a cloud of canonical Gaussians and a network that computes,
 * for any time, residuals that are added to the raw attributes of the Gaussians.
 *
 * Only cfg_args, a file beside the checkpoint, records which heads of the network are in use.
 * Options override cfg_args. */
#include "importers/lib/deform.h"
#include "importers/lib/hexplane.h"

#include <string.h>

#include "math/quat.h"

enum { POSITION, SCALE, ROTATION, OPACITY, COLOUR, N_HEADS };

/* `off` is the method's option that disables a head; `by_default` is the default of that option. */
static const struct {
    const char *word, *tensor, *off;
    bool by_default;
    int width, number; /* number of floats per row, and column number for spin_model_values() */
} heads[N_HEADS] = {
    {"position", "pos_deform", "no_dx", false, 3, 0},
    {"scale", "scales_deform", "no_ds", false, 3, 2},
    {"rotation", "rotations_deform", "no_dr", false, 4, 1},
    {"opacity", "opacity_deform", "no_do", true, 1, 3},
    {"sh", "shs_deform", "no_dshs", true, 48, 4},
};

struct model {
    struct spin_model base;
    struct hexplane hex;
    struct mlp_net head[N_HEADS]; /* only the heads in `used` are loaded */
    bool used[N_HEADS];
    double grid_pe; /* the training's setting grid_pe; 0: unknown */
    bool product;   /* apply_rotation: rotations and residuals are multiplied, not added */
};

/* ---- Recognising ----------------------------------------------------------------------------- */

static int probe(const struct spin_peek *peek)
{
    bool cloud = spin_peek_has(peek, "point_cloud"), modec;

    if (spin_peek_contains(peek, "feature_out_c.0.weight")) /* a network of E-D3DGS */
        return 0;
    if (!peek->is_folder)
        return strcmp(spin_path_name(peek->path), "deformation.pth") == 0 ? 85 : 0;
    if (spin_peek_has(peek, "deformation.pth"))
        return 90;
    /* kplanes_config is an option of this network. MoDec-GS has the same network, but only MoDec-GS
     * has the option LGD_method. */
    modec = spin_peek_contains(peek, "LGD_method=");
    if (cloud && spin_peek_contains(peek, "kplanes_config=") && !modec)
        return 90;
    /* Plain 3DGS and the family of Deformable 3D Gaussians write these files; 4DGaussians does not.
     */
    if (spin_peek_has(peek, "deform") || spin_peek_has(peek, "cameras.json") ||
        spin_peek_has(peek, "input.ply"))
        return 0;
    return spin_peek_has(peek, "cfg_args") && cloud && !modec ? 45 : 0;
}

static spin_status fail_no_save(const char *path, const char *wanted)
{
    bool coarse;

    if (wanted)
        return spin_not_found("'%s' has no iteration_%s with point_cloud.ply and deformation.pth",
                              path, wanted);
    if (spin_model_search(path, "deformation_GAD.pth", &coarse))
        return spin_unsupported(
            "'%s' contains 'deformation_GAD.pth', so it is a run of MoDec-GS: use --from modecgs",
            path);
    if (coarse)
        return spin_unsupported("'%s' has only the coarse stage, which has no motion yet: continue "
                                "training, or import its point_cloud.ply with --from ply",
                                path);
    return spin_not_found("'%s' has no iteration_<N> with point_cloud.ply and deformation.pth",
                          path);
}

/* ---- Heads in use ---------------------------------------------------------------------------- */

/* Parses the value of option `deform`, a list such as "position,rotation", or "none". */
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
            return spin_misuse("--deform: '%.*s' is not an attribute, expected position, scale, "
                               "rotation, opacity, sh or none",
                               (int)n, list);
        list += n + (list[n] == ',');
    }
    return SPIN_OK;
}

/* Guesses whether a layer was trained: if it was not, all its values are within the bounds of their
 * random initialisation. */
static bool is_trained(const struct mlp_layer *l)
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

/* For models without cfg_args: adds notes for the user that name the heads that are assumed to be
 * in use, and the heads that look trained. */
static spin_status note_guess(struct model *model)
{
    struct spin_model *m = &model->base;
    char trained[128] = "";
    int used = 0; /* length of `trained`, which has space for the words of all heads */

    spin_note(m->sequence, "there is no cfg_args: assumed that the network deforms position, scale "
                           "and rotation, but not opacity and SH; --deform overrides this");
    spin_warn("'%s': there is no cfg_args beside this file: the method's defaults are assumed",
              m->path);
    for (int h = 0; h < N_HEADS; h++) {
        struct mlp_net head = {0};

        if (!spin_model_get(m, "%s.1.weight", heads[h].tensor))
            continue;
        SPIN_TRY(spin_model_head(m, heads[h].tensor, model->hex.width, heads[h].width, &head));
        if (is_trained(&head.layer[0]) || is_trained(&head.layer[1]))
            used += snprintf(trained + used, sizeof trained - (size_t)used, " %s", heads[h].word);
    }
    spin_note(m->sequence, "heads that appear to be trained:%s", trained);
    return SPIN_OK;
}

/* Sets used, product and grid_pe from cfg_args and from options, which override cfg_args. */
static spin_status choose_heads(struct model *model)
{
    const struct spin_model *m = &model->base;
    const char *deform = spin_model_option(m, "deform");

    for (int h = 0; h < N_HEADS; h++) {
        bool off = heads[h].by_default;

        SPIN_TRY(spin_cfg_read_bool(&m->settings.cfg, heads[h].off, &off));
        model->used[h] = !off;
    }
    SPIN_TRY(spin_model_bool(m, "apply-rotation", "apply_rotation", &model->product));
    SPIN_TRY(spin_model_number(m, "grid-pe", "grid_pe", &model->grid_pe));
    return deform ? parse_heads(deform, model->used) : SPIN_OK;
}

/* ---- Opening --------------------------------------------------------------------------------- */

static spin_status fail_other_network(const struct spin_value *root)
{
    static const char *const theirs[] = {"feature_out_c.0.weight",
                                         "deformation_net.feature_out_c.0.weight"};

    for (size_t i = 0; i < sizeof theirs / sizeof *theirs; i++) {
        if (spin_value_get(root, theirs[i]))
            return spin_unsupported(
                "tensor '%s' belongs to a network of E-D3DGS: use --from ed3dgs", theirs[i]);
    }
    return spin_malformed("there is no tensor 'deformation_net.grid.grids.0.0': this is not a "
                          "network of 4DGaussians");
}

static spin_status load_network(struct spin_model *m)
{
    struct model *model = (struct model *)m;

    SPIN_TRY(spin_model_dict(m));
    if (!spin_hex_find(m))
        return fail_other_network(m->tensors);
    SPIN_TRY(spin_hex_load(m, model->grid_pe, &model->hex));
    for (int h = 0; h < N_HEADS; h++) {
        if (model->used[h])
            SPIN_TRY(spin_model_head(m, heads[h].tensor, model->hex.width, heads[h].width,
                                     &model->head[h]));
    }
    if (!m->settings.cfg.path && !spin_model_option(m, "deform"))
        SPIN_TRY(note_guess(model));
    return SPIN_OK;
}

/* Warns if deformation_table.pth does not have one value per Gaussian: table and cloud then belong
 * to different checkpoints. The table itself does not affect the result. */
static void check_table(struct spin_model *m, const char *save)
{
    size_t n = m->canonical.n;
    struct spin_torch torch = {0};
    struct spin_array table;
    const char *path;

    if (spin_model_find(m, &path, save, "deformation_table.pth") == SPIN_OK && path &&
        spin_torch_open(path, &torch) == SPIN_OK &&
        spin_torch_tensor(&torch, torch.root, "deformation_table", &table) == SPIN_OK &&
        table.count != n) {
        spin_note(m->sequence,
                  "deformation_table.pth is for %llu Gaussians, but point_cloud.ply has %zu: the "
                  "files may be of different checkpoints",
                  (unsigned long long)table.count, n);
        spin_warn("'%s' is for %llu Gaussians, but the cloud has %zu", path,
                  (unsigned long long)table.count, n);
    }
    spin_torch_close(&torch);
}

static unsigned moved(const struct model *model)
{
    unsigned columns = 0;

    for (int h = 0; h < N_HEADS; h++)
        columns |= model->used[h] ? 1u << heads[h].number : 0;
    return columns;
}

static spin_status open_model(void *self, const char *path)
{
    struct model *model = self;
    struct spin_model *m = self;
    const char *save, *cloud;

    SPIN_TRY(spin_model_checkpoint(m, path, "deformation.pth", &save));
    if (!save)
        return fail_no_save(path, spin_model_option(m, "iteration"));
    SPIN_TRY(spin_model_cfg(m, path, save));
    SPIN_TRY(spin_model_join(m, &m->path, save, "deformation.pth"));
    SPIN_TRY(spin_model_join(m, &cloud, save, "point_cloud.ply"));
    SPIN_TRY(spin_model_read(m, cloud, NULL, 0, NULL));
    SPIN_TRY(choose_heads(model));
    SPIN_TRY(spin_model_torch(m, m->path, load_network));
    if (model->used[COLOUR] && m->canonical.sh_degree != 3)
        return spin_unsupported("'%s' has SH of degree %d, but the network deforms SH of degree 3",
                                cloud, m->canonical.sh_degree);
    check_table(m, save);
    spin_model_describe(m, &m->canonical.n, m->canonical.sh_degree, moved(model));
    m->sequence->half_open =
        true; /* in the method's reader of Panoptic, frame t of T is at t / T */
    snprintf(m->sequence->variant, sizeof m->sequence->variant,
             "4DGaussians, %zu Gaussians, %d scales of planes, width %d", m->canonical.n,
             model->hex.n_scales, model->hex.width);
    spin_note(m->sequence,
              "times run from 0 to 1 and are not stored: frame i of n is at i/(n-1) for D-NeRF and "
              "HyperNeRF scenes, i/300 for DyNeRF, i/n for multi-view scenes");
    return spin_mlp_team_create(spin_hex_scratch(&model->hex) + 48 * MLP_BLOCK, &m->team);
}

/* ---- Evaluating ------------------------------------------------------------------------------ */

/* Sets `to` to the rotation q with the residual r, normalised: the product q r if model->product,
 * otherwise the sum. Unlike the other attributes, rotations are not multiplied by the mask. */
static void add_rotation(const struct model *model, const float q[4], const float r[4], float to[4])
{
    if (model->product) {
        spin_quat_product(q, r, to);
    } else {
        for (int c = 0; c < 4; c++)
            to[c] = q[c] + r[c];
    }
    spin_quat_normalise(to);
}

static void evaluate(void *context, size_t first, int n, float *scratch)
{
    const struct deform_job *job = context;
    const struct model *model = job->model;
    float *residual = scratch + spin_hex_scratch(&model->hex), *spare, mask[MLP_BLOCK];
    float *hidden = spin_hex_hidden(&model->hex, job->from->means + 3 * first, n, job->time,
                                    scratch, &spare, mask);

    for (int h = 0; h < N_HEADS; h++) {
        size_t width;
        const float *from = spin_model_values(job->from, heads[h].number, &width);
        float *out = spin_model_values(job->out, heads[h].number, &width);

        if (!model->used[h] || !(job->columns & 1u << heads[h].number))
            continue;
        spin_mlp_run(&model->head[h], hidden, spare, residual);
        for (size_t p = 0; p < (size_t)n; p++) {
            size_t at = (first + p) * width;
            float r[4] = {0};

            for (size_t c = 0; c < width && h != ROTATION; c++)
                out[at + c] = from[at + c] * mask[p] + residual[c * MLP_BLOCK + p];
            for (size_t c = 0; c < 4 && h == ROTATION; c++)
                r[c] = residual[c * MLP_BLOCK + p];
            if (h == ROTATION)
                add_rotation(model, from + at, r, out + at);
        }
    }
}

static spin_status gaussian_frame(void *self, int frame, double time, unsigned columns,
                                  struct spin_splats *out)
{
    (void)frame;
    return spin_deform_frame(self, time, columns, moved(self), evaluate, out);
}

static const struct spin_plugin_option options[] = {
    {"iteration", "N", "the checkpoint to read (default: the last)", NULL},
    {"deform", "LIST",
     "attributes that the network deforms: position,scale,rotation,opacity,sh or none (default: as "
     "in cfg_args)",
     NULL},
    {"apply-rotation", "BOOL",
     "true: multiply rotations by their residuals; false: add them (default: as in cfg_args)",
     NULL},
    {"grid-pe", "X", "the option grid_pe of the run (default: as in cfg_args)", NULL},
    {NULL, NULL, NULL, NULL},
};

SPIN_MODEL_IMPORTER(
    4dgaussian, struct model, open_model, spin_model_close,
    .summary = "4DGaussians: the model's folder, with cfg_args and point_cloud/iteration_<N>",
    .upstream = "hustvl/4DGaussians 843d5ac", .options = options, .probe = probe,
    .frame = gaussian_frame)
