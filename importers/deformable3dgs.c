/* Deformable 3D Gaussians (Yang et al., CVPR 2024, ingra14m): a cloud of canonical Gaussians and a
 * network that computes, from position and time, residuals that are added to the activated
 * attributes of the Gaussians. MotionGS (Zhu et al., NeurIPS 2024) trains this model with other
 * losses and saves it in the same files.
 *
 * Two peculiarities:
 * - Residuals are added after the activation, and the rasteriser does not normalise the resulting
 * quaternions, so it draws a different ellipsoid than for unit quaternions. The importer computes
 * the covariance in the same way and decomposes it again.
 * - The cloud and the network of a checkpoint are in separate folders; both must be of the same
 * iteration. */
#include "importers/lib/deform.h"

enum {
    WARM_UP = 3000 /* training does not use the network before this iteration */
};

struct model {
    struct spin_model base;
    struct deform_net net;
    bool screw;    /* is_6dof: screw_w and screw_v move positions; otherwise `warp` does */
    bool motiongs; /* cfg_args contains options of MotionGS */
    struct mlp_net warp, screw_w, screw_v, rotation, scaling;
};

/* ---- Recognising ----------------------------------------------------------------------------- */

static int probe(const struct spin_peek *peek)
{
    if (!peek->is_folder) /* peek->head contains the keys of the state dict */
        return strcmp(spin_path_name(peek->path), "deform.pth") == 0 &&
                       (spin_peek_contains(peek, "linear.0.weight") ||
                        spin_peek_contains(peek, "timenet.0.weight"))
                   ? 85
                   : 0;
    if (!spin_peek_has(peek, "deform") || !spin_peek_has(peek, "point_cloud") ||
        spin_peek_contains(peek, "grid_args")) /* an option of Grid4D and DASH */
        return 0;
    return spin_peek_contains(peek, "is_6dof") ? 90 : 60;
}

/* ---- The network ----------------------------------------------------------------------------- */

static spin_status load_network(struct spin_model *base)
{
    struct model *m = (struct model *)base;
    const struct {
        const char *key;
        int n_out;
        struct mlp_net *net;
    } heads[] = {{"gaussian_warp", 3, &m->warp},
                 {"branch_w", 3, &m->screw_w},
                 {"branch_v", 3, &m->screw_v},
                 {"gaussian_rotation", 4, &m->rotation},
                 {"gaussian_scaling", 3, &m->scaling}};
    static const char *const known[] = {
        "linear.",   "timenet.0.", "timenet.2.",         "gaussian_warp.",
        "branch_w.", "branch_v.",  "gaussian_rotation.", "gaussian_scaling.",
        NULL};
    const struct spin_value *root = base->torch.root;
    bool warp;

    if (root->kind == SPIN_VALUE_TUPLE && root->n == 2 && root->item[0]->kind == SPIN_VALUE_DICT &&
        root->item[1]->kind == SPIN_VALUE_DICT)
        return spin_unsupported("the file contains a pair of dicts, as Grid4D and DASH save them: "
                                "use --from grid4d or --from dash");
    SPIN_TRY(spin_model_dict(base));
    SPIN_TRY(spin_model_keys(base, known));
    SPIN_TRY(spin_deform_net_load(base, &m->net));
    warp = spin_model_get(base, "gaussian_warp.weight") != NULL;
    m->screw = spin_model_get(base, "branch_w.weight") || spin_model_get(base, "branch_v.weight");
    if (m->screw == warp)
        return spin_malformed(
            "the network has %s of 'gaussian_warp' and 'branch_w', expected exactly one of the two",
            warp ? "both tensors" : "neither");
    for (int i = 0; i < 5; i++) {
        if (i > 2 || (i > 0) == m->screw)
            SPIN_TRY(spin_model_layer(base, heads[i].key, m->net.width, heads[i].n_out, MLP_PLAIN,
                                      heads[i].net));
    }
    return SPIN_OK;
}

/* ---- Opening --------------------------------------------------------------------------------- */

/* Recognises MotionGS by its options and adds a note about the unit of times. Times of MotionGS are
 * those of the data set, which may be seconds; times of Deformable 3D Gaussians run from 0 to 1. */
static spin_status read_motiongs(const struct cfg_args *cfg, struct model *m)
{
    struct cfg_span format = spin_cfg_get(cfg, "scene_format");
    struct spin_sequence_info *sequence = m->base.sequence;
    bool moved = false;

    m->motiongs =
        spin_cfg_get(cfg, "use_depth_and_flow").at || spin_cfg_get(cfg, "optimize_pose").at;
    SPIN_TRY(spin_cfg_read_bool(cfg, "optimize_pose", &moved));
    if (moved)
        spin_note(sequence, "optimize_pose=True: training moved the cameras and did not save them, "
                            "so images rendered with the cameras of the data set are shifted");
    if (m->motiongs && spin_cfg_is(format, "'plenopticVideo'")) {
        sequence->time_last = 10;
        sequence->half_open = true; /* frame i of 300 is at i/30 */
        spin_note(sequence,
                  "scene_format='plenopticVideo': times are seconds, 0 to 10, and are not stored");
    } else if (m->motiongs && (spin_cfg_is(format, "''") || spin_cfg_is(format, "'blender'"))) {
        spin_note(
            sequence,
            "scene_format=%.*s: times are those of the data set's transforms_train.json, which may "
            "be seconds; without that file they run from 0 to 1, frame i of n at i/(n-1)",
            (int)(format.end - format.at), format.at);
    } else {
        spin_note(sequence, "times run from 0 to 1 and are not stored: frame i of n is at i/(n-1)");
    }
    return SPIN_OK;
}

/* Opens cfg_args and warns if its options contradict the tensors: cfg_args is then probably of
 * another training. The tensors, not cfg_args, determine the kind of network. */
static spin_status check_cfg(const struct deform_save *save, struct model *m)
{
    const struct {
        const char *key;
        bool is;
    } said[] = {{"is_blender", m->net.time.n > 0}, {"is_6dof", m->screw}};
    const struct cfg_args *cfg = &m->base.settings.cfg;

    SPIN_TRY(spin_model_cfg(&m->base, save->model, save->cloud));
    for (size_t i = 0; i < 2; i++) {
        bool value = said[i].is;

        SPIN_TRY(spin_cfg_read_bool(cfg, said[i].key, &value));
        if (value == said[i].is)
            continue;
        spin_warn("'%s' has %s=%s, which does not match the network in '%s': the value is ignored",
                  cfg->path, said[i].key, value ? "True" : "False", m->base.path);
        spin_note(m->base.sequence,
                  "cfg_args has %s=%s, which does not match the network: the value is ignored",
                  said[i].key, value ? "True" : "False");
    }
    return read_motiongs(cfg, m);
}

static spin_status open_model(void *self, const char *path)
{
    struct model *m = self;
    struct spin_model *base = self;
    struct deform_save save;
    long long iteration;

    SPIN_TRY(spin_deform_find(base, path, true, &save));
    base->path = save.network;
    SPIN_TRY(spin_model_read(base, save.cloud, NULL, 0, NULL));
    SPIN_TRY(spin_model_torch(base, base->path, load_network));
    spin_model_describe(base, &base->canonical.n, base->canonical.sh_degree, DEFORM_MOVED);
    SPIN_TRY(check_cfg(&save, m));
    snprintf(base->sequence->variant, sizeof base->sequence->variant,
             "%s, %zu Gaussians, %s, %d layers of %d%s%s",
             m->motiongs ? "MotionGS" : "Deformable 3D Gaussians", base->canonical.n, save.name,
             m->net.linear.n, m->net.width, m->net.time.n ? ", time network" : "",
             m->screw ? ", 6dof" : "");
    iteration = spin_model_iteration(save.name);
    if (iteration >= 0 && iteration < WARM_UP)
        spin_note(base->sequence, "training does not use the network before iteration %d", WARM_UP);
    /* Scratch memory of each thread: the input, followed by the output of one layer for the skip
     * connection; the outputs of two layers; and the 4 + 3 outputs of heads. */
    return spin_mlp_team_create(((size_t)m->net.n_in + 3 * (size_t)m->net.width + 7) * MLP_BLOCK,
                                &base->team);
}

/* ---- Evaluating ------------------------------------------------------------------------------ */

/* Moves p by a screw motion, p' = R p + T, where R and T are the matrix exponential of the twist
 * (w, v). The method divides w and v by the angle |w| and then adds 1e-5 to every component, so w
 * is not exactly of unit length and R is not exactly a rotation. */
static void move_by_screw(const double w_raw[3], const double v_raw[3], const float p[3],
                          float out[3])
{
    double a = sqrt(w_raw[0] * w_raw[0] + w_raw[1] * w_raw[1] + w_raw[2] * w_raw[2]);
    double w[3], v[3], kp[3], kkp[3], kv[3], kkv[3];

    for (int c = 0; c < 3; c++) {
        w[c] = w_raw[c] / a + 1e-5;
        v[c] = v_raw[c] / a + 1e-5;
    }
    for (int c = 0; c < 3; c++) {
        int i = (c + 1) % 3, j = (c + 2) % 3;

        kp[c] = w[i] * p[j] - w[j] * p[i];
        kv[c] = w[i] * v[j] - w[j] * v[i];
    }
    for (int c = 0; c < 3; c++) {
        int i = (c + 1) % 3, j = (c + 2) % 3;

        kkp[c] = w[i] * kp[j] - w[j] * kp[i];
        kkv[c] = w[i] * kv[j] - w[j] * kv[i];
    }
    for (int c = 0; c < 3; c++)
        out[c] = (float)(p[c] + sin(a) * kp[c] + (1 - cos(a)) * kkp[c] + a * v[c] +
                         (1 - cos(a)) * kv[c] + (a - sin(a)) * kkv[c]);
}

static void move_gaussians(const struct deform_job *job, size_t first, int n, float *hidden,
                           float *head)
{
    const struct model *m = job->model;
    const float *from = job->from->means + 3 * first;
    float *out = job->out->means + 3 * first;
    double w[MLP_BLOCK][3];

    spin_mlp_run(m->screw ? &m->screw_w : &m->warp, hidden, head, NULL);
    for (int p = 0; p < n; p++)
        for (int c = 0; c < 3; c++) {
            w[p][c] = head[c * MLP_BLOCK + p];
            if (!m->screw)
                out[3 * p + c] = from[3 * p + c] + head[c * MLP_BLOCK + p];
        }
    if (!m->screw)
        return;
    spin_mlp_run(&m->screw_v, hidden, head, NULL);
    for (int p = 0; p < n; p++) {
        double v[3] = {head[p], head[MLP_BLOCK + p], head[2 * MLP_BLOCK + p]};

        move_by_screw(w[p], v, from + 3 * p, out + 3 * p);
    }
}

static void evaluate(void *context, size_t first, int n, float *scratch)
{
    const struct deform_job *job = context;
    const struct model *m = job->model;
    float *a = scratch + (size_t)(m->net.n_in + m->net.width) * MLP_BLOCK;
    float *b = a + (size_t)m->net.width * MLP_BLOCK, *head = b + (size_t)m->net.width * MLP_BLOCK;
    const float *at[MLP_BLOCK];
    float *hidden;

    for (int p = 0; p < MLP_BLOCK; p++) /* pad the last block with its last point */
        at[p] = job->from->means + 3 * (first + (size_t)(p < n ? p : n - 1));
    spin_deform_net_encode(&m->net, at, scratch);
    hidden = spin_mlp_run(&m->net.linear, scratch, a, b);
    if (job->columns & SPIN_COL_MEANS)
        move_gaussians(job, first, n, hidden, head);
    if (job->columns & (SPIN_COL_LOG_SCALES | SPIN_COL_QUATS)) {
        spin_mlp_run(&m->scaling, hidden, head, NULL);
        spin_mlp_run(&m->rotation, hidden, head + 3 * MLP_BLOCK, NULL);
        spin_deform_shape(job, first, n, head, head + 3 * MLP_BLOCK);
    }
}

static spin_status deformable_frame(void *self, int frame, double time, unsigned columns,
                                    struct spin_splats *out)
{
    (void)frame;
    spin_deform_net_time(&((struct model *)self)->net, (float)time);
    return spin_deform_frame(self, time, columns, DEFORM_MOVED, evaluate, out);
}

static const struct spin_plugin_option options[] = {
    {"iteration", "N", "the checkpoint to read (default: the last)", NULL},
    {NULL, NULL, NULL, NULL},
};

SPIN_MODEL_IMPORTER(
    deformable3dgs, struct model, open_model, spin_model_close,
    .summary = "Deformable 3D Gaussians, MotionGS: the model's folder, with point_cloud and deform",
    .upstream = "ingra14m/Deformable-3D-Gaussians ac42372, RuijieZhu94/MotionGS 8eab187",
    .options = options, .probe = probe, .frame = deformable_frame)
