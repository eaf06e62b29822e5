/* SC-GS (Huang et al., CVPR 2024): the network of Deformable 3D Gaussians moves some hundred
 * control nodes, and each Gaussian follows the nodes that are nearest to it, in space and in
 * additional learned coordinates ("hyper"). The nearest nodes and their weights do not depend on
 * the time.
 *
 * The network adds residuals to the scales after the exponential, so a scale may become negative. A
 * negative scale renders the same ellipsoid as its absolute value, which the importer stores. */
#include "importers/lib/deform.h"
#include "math/activate.h"
#include "math/quat.h"

enum { WARM_UP = 3000, MOST_NODES = 1 << 20, MOST_COLUMNS = 256 };

/* Offsets of the values in a row of the network's outputs for a node. */
enum { WARP = 0, ROTATION = 3, SCALING = 7, LOCAL = 10, OPACITY = 14, COLOUR = 15, WIDTH = 18 };

struct model {
    struct spin_model base;
    struct deform_net net;
    struct mlp_net head[6]; /* in the order of `heads`; n is 0 if the model lacks the head */
    /* Settings from cfg_args. */
    int n_near;  /* number of nodes that move a Gaussian */
    int n_hyper; /* number of additional coordinates of nodes and Gaussians */
    bool mask, skinning, rotation_is_residual, still;
    double most_scale; /* limit for changes of scales; 0 or less: no limit */
    size_t n_nodes;
    float *nodes; /* [n_nodes][3 + n_hyper] */
    /* [n_nodes] logarithm of the radius and logit of the weight; NULL with skinning */
    float *radius, *weight;
    float *features; /* [n][n_features] properties fea_* of the PLY */
    int n_features;
    uint32_t *near; /* [n][n_near] nodes of each Gaussian */
    float *share;   /* [n][n_near] weights of these nodes, which sum to 1 */
    float *output;  /* [n_nodes][WIDTH] outputs of the network at the current time */
};

static const struct {
    const char *key;
    int n_out, at;
    bool optional;
} heads[6] = {{"gaussian_warp", 3, WARP, false},       {"gaussian_rotation", 4, ROTATION, false},
              {"gaussian_scaling", 3, SCALING, false}, {"local_rotation", 4, LOCAL, true},
              {"gaussian_opacity", 1, OPACITY, true},  {"gaussian_color", 3, COLOUR, true}};
enum { LOCAL_HEAD = 3, OPACITY_HEAD, COLOUR_HEAD, N_HEADS };

/* ---- Recognising ----------------------------------------------------------------------------- */

static int probe(const struct spin_peek *peek)
{
    if (!peek->is_folder)
        return strcmp(spin_path_name(peek->path), "deform.pth") == 0 &&
                       (spin_peek_contains(peek, "_node_radius") ||
                        spin_peek_contains(peek, "_node_weight"))
                   ? 100
                   : 0;
    if (!spin_peek_contains(peek, "node_num=") || !spin_peek_contains(peek, "deform_type=") ||
        spin_peek_contains(peek, "deform_type='mlp'"))
        return 0;
    return spin_peek_has(peek, "point_cloud") || spin_peek_has(peek, "deform") ? 100 : 0;
}

/* ---- cfg_args -------------------------------------------------------------------------------- */

static spin_status read_flags(struct model *m)
{
    static const char *const unsupported[] = {"use_hash", "hash_time", "progressive_brand_time"};
    const struct cfg_args *cfg = &m->base.settings.cfg;

    for (int i = 0; i < 3; i++) {
        bool on = false;

        SPIN_TRY(spin_cfg_read_bool(cfg, unsupported[i], &on));
        if (on)
            return spin_unsupported("'%s': %s=True selects a network that is not supported",
                                    cfg->path, unsupported[i]);
    }
    SPIN_TRY(spin_cfg_read_bool(cfg, "gs_with_motion_mask", &m->mask));
    SPIN_TRY(spin_cfg_read_bool(cfg, "skinning", &m->skinning));
    SPIN_TRY(spin_cfg_read_bool(cfg, "d_rot_as_res", &m->rotation_is_residual));
    return spin_cfg_read_bool(cfg, "is_scene_static", &m->still);
}

static spin_status read_count(const struct cfg_args *cfg, const char *key, int least, int *out)
{
    double value = *out;

    SPIN_TRY(spin_cfg_read_number(cfg, key, &value));
    if (!(value >= least && value <= MOST_COLUMNS && value == floor(value)))
        return spin_malformed("'%s': %s is %g, expected %d to %d", cfg->path, key, value, least,
                              MOST_COLUMNS);
    *out = (int)value;
    return SPIN_OK;
}

static spin_status read_settings(struct model *m, const struct deform_save *save)
{
    const char *given = spin_model_option(&m->base, "cfg-args");
    struct cfg_args *cfg = &m->base.settings.cfg;
    int type = 0;

    if (given)
        SPIN_TRY_IN(spin_cfg_open(given, cfg), "--cfg-args");
    else
        SPIN_TRY(spin_model_cfg(&m->base, save->model, NULL));
    if (!cfg->path)
        return spin_not_found("'%s' has no cfg_args, which alone states the number of nodes that "
                              "move a Gaussian: give it with --cfg-args",
                              save->model);
    m->n_near = 3;
    m->n_hyper = 8;
    m->rotation_is_residual = true;
    m->most_scale = -1;
    SPIN_TRY(read_flags(m));
    SPIN_TRY(read_count(cfg, "K", 1, &m->n_near));
    SPIN_TRY(read_count(cfg, "hyper_dim", 0, &m->n_hyper));
    SPIN_TRY(spin_cfg_read_number(cfg, "max_d_scale", &m->most_scale));
    SPIN_TRY(spin_model_word(&m->base, NULL, "deform_type", "node|static", &type));
    if (spin_cfg_get(cfg, "deform_type").at && type < 0)
        return spin_unsupported("'%s': deform_type is not 'node': use --from deformable3dgs for a "
                                "run without nodes",
                                cfg->path);
    m->still = m->still || type == 1;
    m->n_hyper = m->skinning ? 0 : m->n_hyper;
    return SPIN_OK;
}

/* ---- The network ----------------------------------------------------------------------------- */

static spin_status load_nodes(struct model *m)
{
    const int64_t shape[2] = {-1, 3 + m->n_hyper};
    struct spin_array info;
    int64_t rows[2];

    SPIN_TRY(spin_model_floats(&m->base, "nodes", 2, shape, &info, &m->nodes));
    m->n_nodes = (size_t)info.shape[0];
    if (m->n_nodes == 0 || m->n_nodes > MOST_NODES)
        return spin_malformed("tensor 'nodes' has %zu nodes, expected 1 to %d", m->n_nodes,
                              MOST_NODES);
    rows[0] = (int64_t)m->n_nodes;
    rows[1] = 1;
    if (m->skinning) {
        m->n_near = (int)m->n_nodes;
        return SPIN_OK;
    }
    if ((size_t)m->n_near > m->n_nodes)
        return spin_malformed("'%s' has K=%d, but there are only %zu nodes",
                              m->base.settings.cfg.path, m->n_near, m->n_nodes);
    SPIN_TRY(spin_model_floats(&m->base, "_node_radius", 1, rows, NULL, &m->radius));
    return spin_model_floats(&m->base, "_node_weight", 2, rows, NULL, &m->weight);
}

/* Loads the head for colours: three layers, whose input is the input of the network followed by the
 * output of the network's layers. */
static spin_status load_colour(struct model *m, struct mlp_net *net)
{
    for (int i = 0; i <= 4; i += 2) {
        char key[32];

        snprintf(key, sizeof key, "gaussian_color.%d", i);
        SPIN_TRY(spin_model_layer(&m->base, key,
                                  i == 0 ? m->net.n_in + m->net.width : spin_mlp_n_out(net),
                                  i == 4 ? 3 : -1, i == 4 ? MLP_PLAIN : MLP_RELU, net));
    }
    return SPIN_OK;
}

static spin_status load_heads(struct model *m)
{
    for (int i = 0; i < N_HEADS; i++) {
        bool colour = i == COLOUR_HEAD;

        if (heads[i].optional &&
            !spin_model_get(&m->base, "%s%s.weight", heads[i].key, colour ? ".0" : ""))
            continue;
        if (colour)
            SPIN_TRY(load_colour(m, &m->head[i]));
        else
            SPIN_TRY(spin_model_layer(&m->base, heads[i].key, m->net.width, heads[i].n_out,
                                      MLP_PLAIN, &m->head[i]));
    }
    return SPIN_OK;
}

static spin_status load_network(struct spin_model *base)
{
    static const char *const known[] = {"inited",
                                        "nodes",
                                        "_node_radius",
                                        "_node_weight",
                                        "gs_",
                                        "network.linear.",
                                        "network.timenet.0.",
                                        "network.timenet.2.",
                                        "network.gaussian_warp.",
                                        "network.gaussian_rotation.",
                                        "network.gaussian_scaling.",
                                        "network.local_rotation.",
                                        "network.gaussian_opacity.",
                                        "network.gaussian_color.",
                                        NULL};
    struct model *m = (struct model *)base;

    SPIN_TRY(spin_model_dict(base));
    SPIN_TRY(spin_model_keys(base, known));
    SPIN_TRY(load_nodes(m));
    base->prefix = "network.";
    SPIN_TRY(spin_deform_net_load(base, &m->net));
    return load_heads(m);
}

/* ---- The nodes of each Gaussian -------------------------------------------------------------- */

/* Inserts a node into the list of the nearest ones, which is sorted by squared distance. */
static void insert_node(int n, uint32_t *near, double *distance, uint32_t node, double d)
{
    int i = n - 1;

    for (; i > 0 && distance[i - 1] > d; i--) {
        distance[i] = distance[i - 1];
        near[i] = near[i - 1];
    }
    distance[i] = d;
    near[i] = node;
}

static void find_nearest(const struct model *m, const float *place, const float *features,
                         uint32_t *near, double *distance)
{
    size_t width = 3 + (size_t)m->n_hyper;

    for (int k = 0; k < m->n_near; k++)
        distance[k] = HUGE_VAL;
    for (uint32_t node = 0; node < m->n_nodes; node++) {
        const float *z = m->nodes + width * node;
        double d = 0;

        for (size_t c = 0; c < width; c++) {
            double e = (double)(c < 3 ? place[c] : features[c - 3]) - (double)z[c];

            d += e * e;
        }
        if (d < distance[m->n_near - 1])
            insert_node(m->n_near, near, distance, node, d);
    }
}

static void weight_nearest(const struct model *m, const uint32_t *near, double *weight)
{
    for (int k = 0; k < m->n_near; k++) {
        double radius = exp((double)m->radius[near[k]]), d = weight[k];

        weight[k] = (d > 0 ? exp(-d / (2 * radius * radius)) : 1) *
                        spin_sigmoid_of((double)m->weight[near[k]]) +
                    1e-7;
    }
}

/* With skinning, all nodes move every Gaussian, and their weights are the softmax of its
 * features. */
static void weight_all(const struct model *m, const float *features, uint32_t *near, double *weight)
{
    double most = -HUGE_VAL;

    for (int k = 0; k < m->n_near; k++)
        most = fmax(most, (double)features[k]);
    for (int k = 0; k < m->n_near; k++) {
        near[k] = (uint32_t)k;
        weight[k] = exp((double)features[k] - most);
    }
}

static void attach(void *context, size_t first, int n, float *scratch)
{
    const struct model *m = context;
    double *weight = (double *)(void *)scratch;

    for (size_t i = first; i < first + (size_t)n; i++) {
        const float *features = m->features ? m->features + i * (size_t)m->n_features : NULL;
        uint32_t *near = m->near + i * (size_t)m->n_near;
        double sum = 0;

        if (m->skinning) {
            weight_all(m, features, near, weight);
        } else {
            find_nearest(m, m->base.canonical.means + 3 * i, features, near, weight);
            weight_nearest(m, near, weight);
        }
        for (int k = 0; k < m->n_near; k++)
            sum += weight[k];
        for (int k = 0; k < m->n_near; k++)
            m->share[i * (size_t)m->n_near + (size_t)k] = (float)(weight[k] / sum);
    }
}

/* ---- The Gaussians at a time ----------------------------------------------------------------- */

static void evaluate_nodes(void *context, size_t first, int n, float *scratch)
{
    const struct model *m = context;
    const struct deform_net *net = &m->net;
    size_t width = (size_t)net->width * MLP_BLOCK, n_in = (size_t)net->n_in * MLP_BLOCK;
    float *a = scratch + n_in + width, *b = a + width, *hidden, *other;
    const float *at[MLP_BLOCK];

    for (int p = 0; p < MLP_BLOCK; p++) /* pad the last block with its last node */
        at[p] = m->nodes + (3 + (size_t)m->n_hyper) * (first + (size_t)(p < n ? p : n - 1));
    spin_deform_net_encode(net, at, scratch);
    hidden = spin_mlp_run(&net->linear, scratch, a, b);
    memcpy(scratch + n_in, hidden, width * sizeof *hidden);
    other = b + width;
    for (int i = 0; i < N_HEADS; i++) {
        const float *out;

        if (m->head[i].n == 0)
            continue;
        out = i == COLOUR_HEAD
                  ? spin_mlp_run(&m->head[i], scratch, other, other + spin_mlp_widest(&m->head[i]))
                  : spin_mlp_run(&m->head[i], hidden, other, NULL);
        for (int p = 0; p < n; p++)
            for (int c = 0; c < heads[i].n_out; c++)
                m->output[WIDTH * (first + (size_t)p) + (size_t)(heads[i].at + c)] =
                    out[c * MLP_BLOCK + p];
    }
}

static unsigned moved_columns(const struct model *m)
{
    return DEFORM_MOVED | (m->head[OPACITY_HEAD].n ? (unsigned)SPIN_COL_LOGIT_OPACITIES : 0) |
           (m->head[COLOUR_HEAD].n ? (unsigned)SPIN_COL_SH : 0);
}

/* Limits the changes of scales, and adds the identity to the local rotations of the nodes, which
 * the network yields as differences from the identity. */
static void finish_nodes(struct model *m)
{
    for (size_t i = 0; i < m->n_nodes; i++) {
        float *out = m->output + WIDTH * i;

        for (int c = 0; c < 3 && m->most_scale > 0; c++)
            out[SCALING + c] = (float)(tanh((double)out[SCALING + c]) * log(m->most_scale));
        out[LOCAL] += 1;
    }
}

/* Adds w times the displacement of a point by one node: the translation of the node and, if the
 * point rotates about the node, the effect of that rotation. */
static void add_warp(const struct model *m, uint32_t node, double w, const double place[3],
                     double sum[3])
{
    const float *out = m->output + WIDTH * node, *z = m->nodes + (3 + (size_t)m->n_hyper) * node;
    double r[3] = {place[0] - (double)z[0], place[1] - (double)z[1], place[2] - (double)z[2]};
    double q[4], norm = 0, cross[3];

    for (int c = 0; c < 3; c++)
        sum[c] += w * (double)out[WARP + c];
    if (m->head[LOCAL_HEAD].n == 0)
        return;
    for (int c = 0; c < 4; c++) {
        q[c] = (double)out[LOCAL + c];
        norm += q[c] * q[c];
    }
    for (int c = 0; c < 3; c++) /* for q = (q0, v): R r - r = 2 (q0 v x r + v x (v x r)) / |q|^2 */
        cross[c] = q[1 + (c + 1) % 3] * r[(c + 2) % 3] - q[1 + (c + 2) % 3] * r[(c + 1) % 3];
    for (int c = 0; c < 3; c++)
        sum[c] += w * 2 / norm *
                  (q[0] * cross[c] + q[1 + (c + 1) % 3] * cross[(c + 2) % 3] -
                   q[1 + (c + 2) % 3] * cross[(c + 1) % 3]);
}

static void write_row(const struct deform_job *job, unsigned columns, size_t i,
                      const double sum[WIDTH])
{
    const struct spin_splats *from = job->from;
    struct spin_splats *out = job->out;
    double q[4], length = 0;
    size_t n_sh = 3 * (size_t)((from->sh_degree + 1) * (from->sh_degree + 1));

    for (size_t c = 0; c < 4; c++) {
        q[c] = (double)from->quats[4 * i + c] + sum[ROTATION + c];
        length += q[c] * q[c];
    }
    for (size_t c = 0; c < 3 && columns & SPIN_COL_MEANS; c++)
        out->means[3 * i + c] = (float)((double)from->means[3 * i + c] + sum[WARP + c]);
    for (size_t c = 0; c < 4 && columns & SPIN_COL_QUATS; c++)
        out->quats[4 * i + c] = length > 0 ? (float)(q[c] / sqrt(length)) : c == 0;
    for (size_t c = 0; c < 3 && columns & SPIN_COL_LOG_SCALES; c++)
        out->log_scales[3 * i + c] = (float)log(
            fmax(fabs(exp((double)from->log_scales[3 * i + c]) + sum[SCALING + c]), 1e-30));
    if (columns & SPIN_COL_LOGIT_OPACITIES)
        out->logit_opacities[i] = spin_opacity_logit((float)fmin(
            fmax(spin_sigmoid_of((double)from->logit_opacities[i]) + sum[OPACITY], 0), 1));
    if (!(columns & SPIN_COL_SH))
        return;
    memcpy(out->sh + n_sh * i, from->sh + n_sh * i, n_sh * sizeof *out->sh);
    for (size_t c = 0; c < 3; c++)
        out->sh[n_sh * i + c] = (float)((double)out->sh[n_sh * i + c] + sum[COLOUR + c]);
}

static void move_block(void *context, size_t first, int n, float *scratch)
{
    const struct deform_job *job = context;
    const struct model *m = job->model;

    (void)scratch;
    for (size_t i = first; i < first + (size_t)n; i++) {
        const float *place = job->from->means + 3 * i;
        double at[3] = {(double)place[0], (double)place[1], (double)place[2]}, sum[WIDTH] = {0};
        double mask =
            m->mask ? spin_sigmoid_of((double)m->features[(i + 1) * (size_t)m->n_features - 1]) : 1;

        for (int k = 0; k < m->n_near; k++) {
            size_t entry = i * (size_t)m->n_near + (size_t)k;
            double w = (double)m->share[entry];

            add_warp(m, m->near[entry], w, at, sum);
            for (int c = ROTATION; c < WIDTH; c++)
                sum[c] += w * (double)m->output[WIDTH * m->near[entry] + (size_t)c];
        }
        for (int c = 0; c < WIDTH; c++)
            sum[c] *= mask;
        sum[ROTATION] += m->rotation_is_residual ? 0 : 1;
        write_row(job, job->columns & moved_columns(m), i, sum);
    }
}

static spin_status frame(void *self, int index, double time, unsigned columns,
                         struct spin_splats *out)
{
    struct model *m = self;

    (void)index;
    if (!m->still && isfinite(time)) {
        spin_deform_net_time(&m->net, (float)time);
        spin_mlp_team_run(&m->base.team, m->n_nodes, evaluate_nodes, m);
        finish_nodes(m);
    }
    return spin_deform_frame(&m->base, time, columns, m->still ? 0 : moved_columns(m), move_block,
                             out);
}

/* ---- Opening --------------------------------------------------------------------------------- */

static spin_status read_cloud(struct model *m, const char *path)
{
    struct spin_gs_ply cloud;
    int wanted = m->skinning ? -1 : m->n_hyper + m->mask;

    SPIN_TRY(spin_model_cloud(&m->base, path, &cloud));
    m->n_features = spin_model_count(cloud.vertex, "fea_");
    if (wanted >= 0 && m->n_features != wanted)
        return spin_malformed("'%s' has %d properties fea_*, expected %d, for hyper_dim=%d%s", path,
                              m->n_features, wanted, m->n_hyper,
                              m->mask ? " and a motion mask" : "");
    return spin_model_read(&m->base, path, m->n_features > 0 ? "fea_" : NULL, m->n_features,
                           &m->features);
}

static spin_status attach_all(struct model *m)
{
    struct spin_model *base = &m->base;
    size_t n = base->canonical.n, scratch;
    const struct deform_net *net = &m->net;

    if (m->skinning && m->n_features != m->n_near + m->mask)
        return spin_malformed("'%s' has %d properties fea_*, expected one for each of %d nodes%s",
                              base->path, m->n_features, m->n_near, m->mask ? " and a mask" : "");
    SPIN_TRY(spin_model_alloc(base, n, (size_t)m->n_near * sizeof *m->near, (void **)&m->near));
    SPIN_TRY(spin_model_alloc(base, n, (size_t)m->n_near * sizeof *m->share, (void **)&m->share));
    SPIN_TRY(spin_model_alloc(base, m->n_nodes, WIDTH * sizeof *m->output, (void **)&m->output));
    /* Scratch memory of each thread: the input, followed by the output of one layer for the skip
     * connection; the outputs of two layers; and those of two layers of a head. */
    scratch = ((size_t)net->n_in + 3 * (size_t)net->width + 8) * MLP_BLOCK +
              2 * spin_mlp_widest(&m->head[COLOUR_HEAD]);
    if (scratch < 2 * (size_t)m->n_near)
        scratch = 2 * (size_t)m->n_near;
    SPIN_TRY(spin_mlp_team_create(scratch, &base->team));
    spin_mlp_team_run(&base->team, n, attach, m);
    return SPIN_OK;
}

static void describe(struct model *m, const char *name)
{
    struct spin_sequence_info *sequence = m->base.sequence;
    long long iteration = spin_model_iteration(name);

    spin_model_describe(&m->base, &m->base.canonical.n, m->base.canonical.sh_degree,
                        m->still ? 0 : moved_columns(m));
    sequence->continuous = !m->still;
    sequence->time_last = m->still ? 0 : 1;
    snprintf(sequence->variant, sizeof sequence->variant,
             "SC-GS, %zu Gaussians, %zu nodes, %s, %d layers of %d%s", m->base.canonical.n,
             m->n_nodes, name, m->net.linear.n, m->net.width,
             m->head[LOCAL_HEAD].n ? ", local frames" : "");
    if (m->still)
        spin_note(sequence, "cfg_args states that the scene is static, so there is one frame");
    else
        spin_note(sequence, "times run from 0 to 1 and are not stored: frame i of n is at i/(n-1)");
    if (m->head[OPACITY_HEAD].n)
        spin_note(sequence, "opacities are clamped to 0..1, but not in the method's renderer");
    if (iteration >= 0 && iteration < WARM_UP)
        spin_note(sequence, "training does not use the network before iteration %d", WARM_UP);
}

static spin_status open_model(void *self, const char *path)
{
    struct model *m = self;
    struct spin_model *base = self;
    struct deform_save save;

    SPIN_TRY(spin_deform_find(base, path, false, &save));
    base->path = save.network;
    SPIN_TRY(read_settings(m, &save));
    SPIN_TRY(read_cloud(m, save.cloud));
    if (!m->still) {
        SPIN_TRY(spin_model_torch(base, base->path, load_network));
        SPIN_TRY(attach_all(m));
    }
    describe(m, save.name);
    return SPIN_OK;
}

static const struct spin_plugin_option options[] = {
    {"iteration", "N", "the checkpoint to read (default: the last)", NULL},
    {"cfg-args", "FILE", "the run's cfg_args, if it is not beside the model", NULL},
    {NULL, NULL, NULL, NULL},
};

SPIN_MODEL_IMPORTER(scgs, struct model, open_model, spin_model_close,
                    .summary = "SC-GS: the model's folder, with point_cloud and deform",
                    .upstream = "yihua7/SC-GS 26cd57d", .options = options, .probe = probe,
                    .frame = frame)
