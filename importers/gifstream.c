/* GIFStream (XDimLab, CVPR 2025): ckpts/ckpt_<step>_rank<r>.pt with cfg.yml, one run for each group
 * of frames (GOP). Each anchor spawns splats at several offsets. Networks compute opacity, shape
 * and colour of these splats from features of the anchor and of the frame; another network moves
 * the anchor. A frame consists of the splats with an opacity above 0.
 *
 * If the networks also depend on the viewing direction (view_adaptive), only positions are
 * imported, unless --camera gives the position of the viewer. Trainings with compression_sim render
 * with rounded tensors, so this importer rounds them too; an entropy network may scale the rounding
 * step of each value. */
#include "geometry/neighbours.h"
#include "importers/lib/chkpnt.h"
#include "formats/gaussian.h"
#include "importers/lib/run_config.h"
#include "math/activate.h"
#include "math/quat.h"
#include "math/rounded.h"
#include "math/sh.h"

enum { MOST_OFFSETS = 64, MOST_FEATURES = 1024, MOST_FRAMES = 100000, MOST_NEIGHBOURS = 64 };

/* Tensors with one row per anchor. */
enum { ANCHORS, SCALES, OFFSETS, FEATURES, TIMES, FACTORS, N_TENSORS };
static const char *const names[N_TENSORS] = {"anchors",         "scales",        "offsets",
                                             "anchor_features", "time_features", "factors"};
/* The networks; CENTRE moves the anchors. */
enum { OPACITY, SHAPE, COLOUR, CENTRE, N_NETS };
static const char *const net_names[N_NETS] = {"mlp_opacity", "mlp_cov", "mlp_color", "mlp_motion"};
static const size_t net_outputs[N_NETS] = {
    1, 7, 3, 7}; /* number of outputs for each offset; for CENTRE, for all offsets together */

struct model {
    struct spin_model base;
    /* Number of anchors; n_read also counts the anchors that are dropped for nonfinite values. */
    size_t n, n_read;
    size_t width[N_TENSORS];  /* number of floats for each anchor */
    float *tensor[N_TENSORS]; /* [n][width] */
    /* k: number of offsets per anchor. per_frame: number of features per anchor and frame. */
    size_t k, n_frames, per_frame;
    size_t first_frame; /* number of the first frame: start_frame in cfg.yml */
    struct mlp_net net[N_NETS];
    size_t n_view, n_embed; /* number of inputs for the viewing direction, and for a camera */
    float *embed;           /* [n_embed] embedding of the first camera */
    struct camera_places camera;
    /* phi: factor from one frequency to the next in the encoding of time. n_knn: number of nearest
     * neighbours whose features the motion network also receives if `knn` is true. */
    double phi, n_knn;
    bool knn, rounded;      /* rounded: the tensors are rounded */
    double step[N_TENSORS]; /* rounding step; 0: values are not rounded */
    uint32_t *neighbour;    /* [n][n_knn] */
    float *out[N_NETS]; /* for the current frame: outputs of the networks [n k][net_outputs]; for
                           CENTRE, positions of the splats [n k][3] */
    double now,
        *embed_time; /* time of the current frame, and the inputs of CENTRE that depend on it */
    size_t frame, n_time;
};

/* ---- Recognising ----------------------------------------------------------------------------- */

static int probe(const struct spin_peek *peek)
{
    return spin_peek_contains(peek, "anchor_features") && spin_peek_contains(peek, "time_features")
               ? 95
               : 0;
}

/* Returns N for the name ckpt_<N>_rank0.pt and -1 for other names. */
static long long step_of(const char *name)
{
    char *end = NULL;
    long long n = strncmp(name, "ckpt_", 5) == 0 && name[5] >= '0' && name[5] <= '9'
                      ? strtoll(name + 5, &end, 10)
                      : -1;

    return end && strcmp(end, "_rank0.pt") == 0 ? n : -1;
}

/* ---- Settings -------------------------------------------------------------------------------- */

/* Reads a number from cfg.yml. If the key is missing, *out keeps its value. */
static spin_status read_setting(const struct model *m, const char *key, double least, double most,
                                double *out)
{
    const struct run_config *s = &m->base.settings;
    const char *next;
    struct cfg_span v = spin_yaml_find(s, key, &next);

    if (v.at && !(spin_cfg_number(v, out) && *out >= least && *out <= most))
        return spin_malformed("'%s': %s is '%.*s', expected a number from %g to %g", s->yaml_path,
                              key, v.end - v.at < 20 ? (int)(v.end - v.at) : 20, v.at, least, most);
    return SPIN_OK;
}

/* Opens the cfg.yml that --config names or, by default, the one in the folder of the run. This file
 * is required, since the checkpoints do not contain the settings. */
static spin_status read_settings(struct model *m, const char *path)
{
    const char *config = spin_model_option(&m->base, "config"), *folder, *up;
    double first = 0;

    SPIN_TRY(spin_model_folder(&m->base, &folder, m->base.path));
    SPIN_TRY(spin_model_folder(&m->base, &up, folder));
    if (!config)
        SPIN_TRY(spin_model_find(&m->base, &config, up, "cfg.yml"));
    if (!config)
        SPIN_TRY(spin_model_find(&m->base, &config, folder, "cfg.yml"));
    if (!config)
        return spin_not_found("'%s': there is no cfg.yml in the folder of the run, which is "
                              "required: name the file with --config",
                              path);
    SPIN_TRY(spin_yaml_open(config, &m->base.settings));
    m->phi = 2;
    m->n_knn = 6;
    SPIN_TRY(read_setting(m, "phi", 1e-3, 1e3, &m->phi));
    SPIN_TRY(read_setting(m, "n_knn", 1, MOST_NEIGHBOURS, &m->n_knn));
    SPIN_TRY(read_setting(m, "start_frame", 0, 1e8, &first));
    m->first_frame = (size_t)first;
    m->knn = spin_yaml_bool(&m->base.settings, "knn", false);
    m->n_view = spin_yaml_bool(&m->base.settings, "view_adaptive", false) ? 3 : 0;
    if (spin_yaml_bool(&m->base.settings, "normalize_world_space", false))
        spin_note(m->base.sequence,
                  "training normalised the world (normalize_world_space): positions "
                  "differ from those of the data set");
    return SPIN_OK;
}

/* ---- Tensors --------------------------------------------------------------------------------- */

static spin_status bind_tensor(struct model *m, int which, int n_dims, const int64_t *shape,
                               struct spin_array *out)
{
    const struct spin_value *v = spin_value_get(m->base.tensors, names[which]);

    if (!v || v->kind != SPIN_VALUE_TENSOR)
        return spin_malformed("there is no tensor '%s' in 'splats'", names[which]);
    return spin_chkpnt_bind(&m->base.torch, v, names[which], n_dims, shape, out);
}

static spin_status find_tensors(struct model *m)
{
    m->base.tensors = spin_value_get(m->base.torch.root, "splats");
    return m->base.tensors ? SPIN_OK : spin_malformed("there is no dict 'splats'");
}

/* Derives the sizes of a run from the tensors of its first file. */
static spin_status read_sizes(struct model *m)
{
    const int64_t shape[3] = {-1, -1, -1}, offsets[3] = {-1, -1, 3};
    struct spin_array a;

    SPIN_TRY(bind_tensor(m, FEATURES, 2, shape, &a));
    m->width[FEATURES] = (size_t)a.shape[1];
    SPIN_TRY(bind_tensor(m, TIMES, 3, shape, &a));
    m->n_frames = (size_t)a.shape[1];
    m->per_frame = (size_t)a.shape[2];
    SPIN_TRY(bind_tensor(m, OFFSETS, 3, offsets, &a));
    m->k = (size_t)a.shape[1];
    if (m->k < 1 || m->k > MOST_OFFSETS || m->n_frames < 1 || m->n_frames > MOST_FRAMES ||
        m->width[FEATURES] < 1 || m->width[FEATURES] > MOST_FEATURES || m->per_frame < 1 ||
        m->per_frame > MOST_FEATURES)
        return spin_malformed("each anchor has %zu offsets, %zu features and %zu features per "
                              "frame, in %zu frames: these sizes are 0 or too large",
                              m->k, m->width[FEATURES], m->per_frame, m->n_frames);
    m->width[ANCHORS] = 3;
    m->width[SCALES] = 6;
    m->width[FACTORS] = 4;
    m->width[OFFSETS] = 3 * m->k;
    m->width[TIMES] = m->n_frames * m->per_frame;
    return SPIN_OK;
}

/* Appends the anchors of a file to those of the previous files. In the first pass, before memory is
 * allocated, the function only checks all shapes and counts the anchors. */
static spin_status read_anchors(struct spin_model *base)
{
    struct model *m = (struct model *)base;
    struct spin_array a;
    size_t n = 0;

    SPIN_TRY(find_tensors(m));
    if (m->k == 0)
        SPIN_TRY(read_sizes(m));
    for (int t = 0; t < N_TENSORS; t++) {
        const int64_t flat[2] = {t == ANCHORS ? -1 : (int64_t)n, (int64_t)m->width[t]};
        const int64_t deep[3] = {(int64_t)n, (int64_t)(t == OFFSETS ? m->k : m->n_frames),
                                 (int64_t)(t == OFFSETS ? 3 : m->per_frame)};
        bool is_deep = t == OFFSETS || t == TIMES;

        SPIN_TRY(bind_tensor(m, t, is_deep ? 3 : 2, is_deep ? deep : flat, &a));
        n = (size_t)a.shape[0];
        if (m->tensor[t] && n > m->n_read - m->n)
            return spin_fail(SPIN_E_IO, "the file changed while it was being read");
        if (m->tensor[t])
            spin_array_to_f32(&a, 0, a.count, m->tensor[t] + m->n * m->width[t]);
    }
    m->n += n;
    return m->n <= INT_MAX / MOST_OFFSETS
               ? SPIN_OK
               : spin_unsupported("there are more anchors than spin4d supports");
}

/* Reads the anchors of all files of the checkpoint. Each rank of the training wrote one file. */
static spin_status read_ranks(struct model *m)
{
    size_t n = strlen(m->base.path), tail = strlen("0.pt");
    bool ranks = step_of(spin_path_name(m->base.path)) >= 0;
    const char *path = m->base.path;

    m->n = 0;
    for (int r = 0; path; r++) {
        SPIN_TRY(spin_model_torch(&m->base, path, read_anchors));
        if (!ranks)
            break;
        SPIN_TRY(
            spin_model_text(&m->base, &path, "%.*s%d.pt", (int)(n - tail), m->base.path, r + 1));
        path = spin_path_exists(path) ? path : NULL;
    }
    return SPIN_OK;
}

static spin_status load_anchors(struct model *m)
{
    double gop;

    SPIN_TRY(read_ranks(m));
    m->n_read = m->n;
    gop = (double)m->n_frames;
    SPIN_TRY(read_setting(m, "GOP_size", 1, MOST_FRAMES, &gop));
    if (gop != (double)m->n_frames)
        return spin_malformed("'%s': GOP_size is %g, but tensor 'time_features' of '%s' has %zu "
                              "frames",
                              m->base.settings.yaml_path, gop, m->base.path, m->n_frames);
    if (m->n == 0)
        return spin_malformed("'%s': tensor 'anchors' has 0 rows", m->base.path);
    for (int t = 0; t < N_TENSORS; t++)
        SPIN_TRY(
            spin_model_alloc(&m->base, m->n, m->width[t] * sizeof(float), (void **)&m->tensor[t]));
    return read_ranks(m);
}

/* Drops the anchors with values that are not finite. */
static spin_status drop_rows(struct model *m)
{
    size_t n = 0;
    char share[96];

    for (size_t i = 0; i < m->n; i++) {
        size_t bad = 0;

        for (int t = 0; t < N_TENSORS; t++)
            bad += spin_finite_missing(m->tensor[t] + i * m->width[t], m->width[t]);
        for (int t = 0; t < N_TENSORS && bad == 0; t++)
            memmove(m->tensor[t] + n * m->width[t], m->tensor[t] + i * m->width[t],
                    m->width[t] * sizeof(float));
        n += bad == 0;
    }
    if (n == 0)
        return spin_malformed("'%s': none of the %zu anchors has finite values", m->base.path,
                              m->n);
    if (n < m->n)
        spin_note(m->base.sequence,
                  "%s dropped, with %zu splats each, because of values that are not finite",
                  spin_text_share(m->n - n, m->n, "anchor", "is", "are", share), m->k);
    m->n = n;
    return SPIN_OK;
}

/* ---- Networks -------------------------------------------------------------------------------- */

/* Loads two layers, <stem>.0 and <stem>.2, with a ReLU between them. */
static spin_status load_two(struct model *m, const char *stem, size_t n_in, size_t n_out,
                            struct mlp_net *net)
{
    char key[80];

    snprintf(key, sizeof key, "%s.0", stem);
    SPIN_TRY(spin_model_layer(&m->base, key, n_in ? (int)n_in : -1, -1, MLP_RELU, net));
    snprintf(key, sizeof key, "%s.2", stem);
    return spin_model_layer(&m->base, key, net->layer[0].n_out, (int)n_out, MLP_PLAIN, net);
}

static spin_status load_embedding(struct model *m)
{
    const int64_t shape[2] = {-1, -1};
    struct spin_array a;

    m->base.tensors = spin_value_get(m->base.torch.root, "app_module");
    if (!m->base.tensors)
        return SPIN_OK;
    SPIN_TRY(spin_model_floats(&m->base, "embeds.weight", 2, shape, &a, &m->embed));
    if (a.shape[0] < 1 || a.shape[1] > MOST_FEATURES)
        return spin_malformed("tensor 'embeds.weight' has no embedding of a camera");
    m->n_embed = (size_t)a.shape[1];
    return SPIN_OK;
}

static spin_status load_networks(struct spin_model *base)
{
    struct model *m = (struct model *)base;
    size_t n_u = m->width[FEATURES] + m->per_frame;

    SPIN_TRY(load_embedding(m));
    base->tensors = spin_value_get(base->torch.root, "decoders");
    if (!base->tensors)
        return spin_malformed("there is no dict 'decoders'");
    for (int i = 0; i < N_NETS; i++) {
        size_t n_in = i == CENTRE ? 0 : n_u + m->n_view + (i == COLOUR ? m->n_embed : 0);

        SPIN_TRY(
            load_two(m, net_names[i], n_in, i == CENTRE ? 7 : m->k * net_outputs[i], &m->net[i]));
    }
    m->n_time = (size_t)m->net[CENTRE].layer[0].n_in - n_u;
    if ((size_t)m->net[CENTRE].layer[0].n_in < n_u || m->n_time % 2 != 0)
        return spin_malformed(
            "tensor 'mlp_motion.0.weight' has %d inputs, expected %zu plus an even "
            "number for the time",
            m->net[CENTRE].layer[0].n_in, n_u);
    return SPIN_OK;
}

/* ---- Rounding -------------------------------------------------------------------------------- */

/* Rounds a value to a multiple of the step. */
static float round_to(double x, double step) { return (float)(nearbyint(x / step) * step); }

/* Rounds the values of a tensor. If the tensor has an entropy network, the network is evaluated for
 * the features of each anchor: the rounding step of value c is divided by 1 + 0.8 tanh(o), where o
 * is output c of the last third of the outputs. */
static spin_status round_tensor(struct model *m, int t, const struct mlp_net *net)
{
    size_t widest = net->n ? spin_mlp_widest(net) : 0, width = m->width[t];
    SPIN_FREED float *scratch = NULL;
    const float *out = NULL;

    SPIN_TRY(spin_alloc(3 * widest + 1, sizeof *scratch, (void **)&scratch));
    for (size_t i = 0; i < m->n; i++) {
        float *x = m->tensor[t] + i * width;
        size_t p = i % MLP_BLOCK;

        for (size_t k = i; net->n && p == 0 && k < i + MLP_BLOCK; k++)
            for (size_t c = 0; c < m->width[FEATURES]; c++)
                scratch[c * MLP_BLOCK + k - i] =
                    m->tensor[FEATURES][(k < m->n ? k : i) * m->width[FEATURES] + c];
        if (net->n && p == 0)
            out = spin_mlp_run(net, scratch, scratch + widest, scratch + 2 * widest);
        for (size_t c = 0; c < width; c++) {
            double q = out ? 1 + 0.8 * tanh((double)out[(2 * width + c) * MLP_BLOCK + p]) : 1;

            x[c] = round_to((double)x[c], m->step[t] / q);
        }
    }
    return SPIN_OK;
}

/* Reads the rounding steps, and rounds the tensors that have one. Features are rounded first, since
 * they are the input of the entropy networks. */
static spin_status round_tensors(struct spin_model *base)
{
    static const int order[] = {FEATURES, TIMES, SCALES, OFFSETS, FACTORS};
    struct model *m = (struct model *)base;
    const struct spin_value *scaling = spin_value_get(base->torch.root, "scaling");

    for (size_t i = 0; i < sizeof order / sizeof *order; i++) {
        struct mlp_net net = {0};
        int t = order[i];
        char name[64];

        if (!spin_value_number(spin_value_get(scaling, names[t]), &m->step[t]))
            continue;
        if (!(m->step[t] > 0 && m->step[t] < 1e6))
            return spin_malformed(
                "the rounding step of '%s' in 'scaling' is %g, expected a number above 0", names[t],
                m->step[t]);
        snprintf(name, sizeof name, "%s_entropy_model", names[t]);
        base->tensors = spin_value_get(base->torch.root, name);
        if (base->tensors && i >= 2)
            SPIN_TRY_IN(load_two(m, "model", m->width[FEATURES], 3 * m->width[t], &net), "'%s'",
                        name);
        SPIN_TRY(round_tensor(m, t, &net));
    }
    return SPIN_OK;
}

/* Applies the sigmoid to the factors and the exponential to the scales of offsets, rounds the
 * tensors if the training rendered with rounded ones, and loads the networks. As in the method,
 * factors below 0.1 become 0; otherwise the last factor, that of the opacity, becomes 1. */
static spin_status activate(struct spin_model *base)
{
    struct model *m = (struct model *)base;
    const struct spin_value *sim = spin_value_get(base->torch.root, "compression_sim");
    float *f = m->tensor[FACTORS];

    m->rounded = sim && sim->kind == SPIN_VALUE_BOOL && sim->number != 0;
    for (size_t i = 0; i < 4 * m->n; i++)
        f[i] = (float)spin_sigmoid_of((double)f[i]);
    if (m->rounded)
        SPIN_TRY(round_tensors(base));
    for (size_t i = 0; i < 4 * m->n; i++)
        f[i] = f[i] < 0.1f ? 0 : i % 4 == 3 ? 1 : f[i];
    for (size_t i = 0; i < 6 * m->n; i++)
        if (i % 6 < 3) /* scales of the offsets; the other scales stay logarithms */
            m->tensor[SCALES][i] = spin_rounded_exp(m->tensor[SCALES][i]);
    return load_networks(base);
}

/* ---- Neighbours ------------------------------------------------------------------------------ */

/* The nearest neighbours of an anchor, sorted by distance. */
struct nearest {
    const float *points;
    uint32_t self, index[MOST_NEIGHBOURS];
    double square[MOST_NEIGHBOURS];
    size_t n, most;
};

static void add_nearest(void *context, uint32_t point)
{
    struct nearest *near = context;
    const float *a = near->points + 3 * (size_t)near->self, *b = near->points + 3 * (size_t)point;
    double square = 0;
    size_t at;

    for (int c = 0; c < 3; c++)
        square += ((double)a[c] - (double)b[c]) * ((double)a[c] - (double)b[c]);
    if (point == near->self || (near->n == near->most && square >= near->square[near->n - 1]))
        return;
    near->n += near->n < near->most;
    for (at = near->n - 1; at > 0 && near->square[at - 1] > square; at--) {
        near->square[at] = near->square[at - 1];
        near->index[at] = near->index[at - 1];
    }
    near->square[at] = square;
    near->index[at] = point;
}

/* Finds the nearest neighbours of all anchors. The search radius is doubled until it contains
 * enough neighbours. */
static spin_status find_neighbours(struct model *m)
{
    SPIN_LEAVES(spin_kd_tree_close) struct spin_kd_tree tree = {0};
    struct nearest near = {.points = m->tensor[ANCHORS], .most = (size_t)m->n_knn};
    float reach = 1e-6f;

    if (near.most >= m->n)
        return spin_malformed("'%s' has %zu anchors, expected more than n_knn, which is %zu",
                              m->base.path, m->n, near.most);
    SPIN_TRY(
        spin_model_alloc(&m->base, m->n, near.most * sizeof *m->neighbour, (void **)&m->neighbour));
    SPIN_TRY(spin_kd_tree_open(&tree, m->n, near.points));
    for (size_t i = 0; i < m->n; i++) {
        near.self = (uint32_t)i;
        for (;; reach *= 2) {
            near.n = 0;
            spin_kd_tree_within(&tree, near.points + 3 * i, reach, add_nearest, &near);
            if (isinf(reach) ||
                (near.n == near.most && sqrt(near.square[near.n - 1]) <= (double)reach))
                break;
        }
        memcpy(m->neighbour + i * near.most, near.index, near.most * sizeof *near.index);
        reach = fmaxf((float)sqrt(near.square[near.n - 1]), 1e-6f);
    }
    return SPIN_OK;
}

/* ---- Evaluating ------------------------------------------------------------------------------ */

/* Adds the features of an anchor, times `weight`, to one column of a block: first the features that
 * are the same in all frames and then, after `skip` further rows, the features for this frame. */
static void add_features(const struct model *m, size_t row, float weight, size_t skip, float *to)
{
    const float *f = m->tensor[FEATURES] + row * m->width[FEATURES];
    const float *t = m->tensor[TIMES] + row * m->width[TIMES] + m->frame * m->per_frame;
    float share = m->tensor[FACTORS][4 * row];

    for (size_t c = 0; c < m->width[FEATURES]; c++)
        to[c * MLP_BLOCK] += weight * f[c];
    to += (m->width[FEATURES] + skip) * MLP_BLOCK;
    for (size_t c = 0; c < m->per_frame; c++)
        to[c * MLP_BLOCK] += weight * t[c] * share;
}

/* Sets the inputs of the networks for attributes: features of the anchor, viewing direction,
 * features of the frame, and embedding of a camera. */
static void set_inputs(const struct model *m, size_t row, float *to)
{
    const float *place = m->tensor[ANCHORS] + 3 * row;
    size_t n_u = m->width[FEATURES] + m->n_view + m->per_frame;
    float *view = to + m->width[FEATURES] * MLP_BLOCK, norm = 0;

    for (size_t c = 0; c < n_u; c++)
        to[c * MLP_BLOCK] = 0;
    add_features(m, row, 1, m->n_view, to);
    for (size_t c = 0; c < m->n_view; c++) {
        view[c * MLP_BLOCK] = place[c] - m->camera.place[0][c];
        norm += view[c * MLP_BLOCK] * view[c * MLP_BLOCK];
    }
    for (size_t c = 0; c < m->n_view && norm > 0; c++)
        view[c * MLP_BLOCK] /= sqrtf(norm);
    for (size_t c = 0; c < m->n_embed; c++)
        to[(n_u + c) * MLP_BLOCK] = m->embed[c];
}

/* Sets the inputs of the motion network: the features, blended with those of the neighbours, and
 * sines and cosines of the time. */
static void set_motion_inputs(const struct model *m, size_t row, float *to)
{
    size_t n_u = m->width[FEATURES] + m->per_frame, most = (size_t)m->n_knn;
    float own = m->knn ? m->tensor[FACTORS][4 * row + 2] : 1;

    for (size_t c = 0; c < n_u; c++)
        to[c * MLP_BLOCK] = 0;
    add_features(m, row, own, 0, to);
    for (size_t k = 0; m->knn && k < most; k++)
        add_features(m, m->neighbour[row * most + k], (1 - own) / (float)most, 0, to);
    for (size_t c = 0; c < m->n_time; c++)
        to[(n_u + c) * MLP_BLOCK] = (float)m->embed_time[c];
}

/* Computes the positions of an anchor's splats from the output of the motion network. */
static void move_anchor(const struct model *m, size_t row, const float *motion, size_t step)
{
    const float *place = m->tensor[ANCHORS] + 3 * row,
                *offset = m->tensor[OFFSETS] + 3 * m->k * row;
    float q[4], f = m->tensor[FACTORS][4 * row + 1];

    for (size_t c = 0; c < 4; c++)
        q[c] = (c == 0) + 0.1f * f * motion[(3 + c) * step];
    spin_quat_normalise(q);
    for (size_t k = 0; k < m->k; k++) {
        float *to = m->out[CENTRE] + 3 * (row * m->k + k), spread[3], turned[3];

        for (size_t c = 0; c < 3; c++)
            spread[c] = offset[3 * k + c] * m->tensor[SCALES][6 * row + c];
        spin_quat_rotate(q, spread, turned);
        for (size_t c = 0; c < 3; c++)
            to[c] = place[c] + f * motion[c * step] + turned[c];
    }
}

static void evaluate(void *context, size_t first, int n, float *scratch)
{
    const struct model *m = context;
    size_t widest = 0;

    for (int i = 0; i < N_NETS; i++) {
        size_t wide = spin_mlp_widest(&m->net[i]);

        widest = wide > widest ? wide : widest;
    }
    for (int i = m->n_view && m->camera.n == 0 ? CENTRE : OPACITY; i < N_NETS; i++) {
        const float *out;

        for (int p = 0; p < MLP_BLOCK && (i == OPACITY || i == CENTRE); p++)
            (i == CENTRE ? set_motion_inputs : set_inputs)(m, first + (size_t)(p < n ? p : n - 1),
                                                           scratch + p);
        out = spin_mlp_run(&m->net[i], scratch, scratch + widest, scratch + 2 * widest);
        for (size_t p = 0; p < (size_t)n; p++) {
            size_t width = m->k * net_outputs[i];

            if (i == CENTRE)
                move_anchor(m, first + p, out + p, MLP_BLOCK);
            for (size_t c = 0; i != CENTRE && c < width; c++)
                m->out[i][(first + p) * width + c] = out[c * MLP_BLOCK + p];
        }
    }
}

/* Returns the opacity of a splat, which is visible if the result is above 0. */
static float opacity_of(const struct model *m, size_t i)
{
    return m->camera.n == 0 && m->n_view
               ? 1
               : spin_rounded_tanh(m->out[OPACITY][i]) * m->tensor[FACTORS][4 * (i / m->k) + 3];
}

static void write_row(const struct model *m, size_t i, float opacity, unsigned columns, size_t to,
                      struct spin_splats *out)
{
    const float *shape = m->out[SHAPE] + 7 * i, *scale = m->tensor[SCALES] + 6 * (i / m->k) + 3;

    if (columns & SPIN_COL_MEANS)
        memcpy(out->means + 3 * to, m->out[CENTRE] + 3 * i, 3 * sizeof(float));
    if (columns & SPIN_COL_QUATS) {
        memcpy(out->quats + 4 * to, shape + 3, 4 * sizeof(float));
        spin_quat_normalise(out->quats + 4 * to);
    }
    for (size_t c = 0; c < 3 && columns & SPIN_COL_LOG_SCALES; c++)
        out->log_scales[3 * to + c] =
            (float)((double)scale[c] - log1p(exp(-fmax((double)shape[c], -80))));
    if (columns & SPIN_COL_LOGIT_OPACITIES)
        out->logit_opacities[to] = spin_opacity_logit(opacity);
    for (size_t c = 0; c < 3 && columns & SPIN_COL_SH; c++)
        out->sh[3 * to + c] =
            (float)((spin_sigmoid_of((double)m->out[COLOUR][3 * i + c]) - 0.5) / SPIN_SH_C0);
}

/* Evaluates the networks for a frame. As in the method, the features of frame i are those at the
 * index i / (F - 1) * (F - 1), rounded down; by rounding errors this is sometimes i - 1. */
static void evaluate_frame(struct model *m, size_t frame)
{
    double last = (double)m->n_frames - 1, wave = M_PI;

    m->now = last > 0 ? (double)frame / last : 0;
    m->frame = (size_t)(m->now * last);
    for (size_t c = 0; c < m->n_time / 2; c++, wave *= m->phi) {
        m->embed_time[c] = sin(wave * m->now);
        m->embed_time[m->n_time / 2 + c] = cos(wave * m->now);
    }
    spin_mlp_team_run(&m->base.team, m->n, evaluate, m);
}

static spin_status frame(void *self, int index, double time, unsigned columns,
                         struct spin_splats *out)
{
    struct model *m = self;
    size_t n = 0, n_all = m->n * m->k;

    (void)time;
    if (index < 0 || (size_t)index >= m->n_frames)
        return spin_not_found("'%s' has no frame %d", m->base.path, index);
    evaluate_frame(m, (size_t)index);
    for (size_t i = 0; i < n_all; i++)
        n += opacity_of(m, i) > 0;
    columns &= SPIN_COL_MEANS | (m->n_view && m->camera.n == 0 ? 0 : SPIN_COL_ATTRIBUTES);
    SPIN_TRY(spin_splats_reserve(out, n, columns, 0));
    n = 0;
    for (size_t i = 0; i < n_all; i++) {
        float opacity = opacity_of(m, i);

        if (opacity > 0)
            write_row(m, i, opacity, columns, n++, out);
    }
    return spin_model_check(m->base.path, index, columns, out);
}

/* ---- Opening --------------------------------------------------------------------------------- */

static spin_status find_file(struct model *m, const char *path)
{
    const char *streams;

    SPIN_TRY(spin_model_find(&m->base, &streams, path, "compression/rank0"));
    if (streams && !spin_model_holds(path, "ckpts"))
        return spin_unsupported("'%s' has only the compressed streams in compression/, which are "
                                "not supported: give a run with ckpts/",
                                path);
    return spin_model_newest(&m->base, path, "ckpts", step_of, "ckpt_<step>_rank0.pt");
}

static spin_status prepare(struct model *m)
{
    size_t widest = 0;

    SPIN_TRY(
        spin_model_alloc(&m->base, m->n_time + 1, sizeof *m->embed_time, (void **)&m->embed_time));
    for (int i = 0; i < N_NETS; i++) {
        size_t width = i == CENTRE ? 3 : net_outputs[i], wide = spin_mlp_widest(&m->net[i]);

        SPIN_TRY(
            spin_model_alloc(&m->base, m->n * m->k, width * sizeof(float), (void **)&m->out[i]));
        widest = wide > widest ? wide : widest;
    }
    if (m->knn)
        SPIN_TRY(find_neighbours(m));
    return spin_mlp_team_create(3 * widest, &m->base.team);
}

static spin_status describe(struct model *m)
{
    struct spin_sequence_info *sequence = m->base.sequence;
    size_t n_pruned = 0;
    int *numbers;

    for (size_t i = 0; i < m->n; i++)
        n_pruned += m->tensor[FACTORS][4 * i + 3] == 0;
    SPIN_TRY(spin_model_alloc(&m->base, m->n_frames, sizeof *numbers, (void **)&numbers));
    for (size_t i = 0; i < m->n_frames; i++)
        numbers[i] = (int)(m->first_frame + i);
    sequence->n_frames = (int)m->n_frames;
    sequence->numbers = numbers;
    sequence->time_last = (double)m->n_frames - 1;
    sequence->columns = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    sequence->sh_degree = 0;
    snprintf(sequence->variant, sizeof sequence->variant,
             "GIFStream, %zu anchors with %zu offsets, %zu frames%s%s", m->n, m->k, m->n_frames,
             m->knn ? ", neighbours" : "", m->rounded ? ", rounded" : "");
    if (n_pruned == m->n)
        spin_note(sequence, "all anchors are pruned: there are no splats");
    if (m->n_embed)
        spin_note(sequence, "colours are computed with the embedding of the first camera");
    if (m->n_view && m->camera.n == 0) {
        sequence->columns = SPIN_COL_MEANS;
        sequence->sh_degree = -1;
        sequence->identity = true;
        spin_note(sequence, "positions only: opacity, shape and colour depend on the viewing "
                            "direction; --camera X,Y,Z imports them as seen from one position");
    } else if (m->n_view) {
        spin_note(sequence, "opacity, shape and colour are computed for the position of "
                            "--camera");
    }
    return SPIN_OK;
}

static spin_status open_model(void *self, const char *path)
{
    struct model *m = self;

    SPIN_TRY(spin_camera_places_parse(spin_model_option(&m->base, "camera"), &m->camera));
    if (m->camera.n > 1)
        return spin_misuse("--camera: expected one position X,Y,Z");
    SPIN_TRY(find_file(m, path));
    SPIN_TRY(read_settings(m, path));
    SPIN_TRY(load_anchors(m));
    SPIN_TRY(drop_rows(m));
    SPIN_TRY(spin_model_torch(&m->base, m->base.path, activate));
    SPIN_TRY(prepare(m));
    return describe(m);
}

static const struct spin_plugin_option options[] = {
    {"camera", "X,Y,Z", "for runs with view_adaptive: import splats as seen from this position",
     NULL},
    {"config", "FILE", "the cfg.yml of the training (default: that of the run's folder)", NULL},
    {NULL, NULL, NULL, NULL},
};

SPIN_MODEL_IMPORTER(gifstream, struct model, open_model, spin_model_close,
                    .summary = "GIFStream: the folder of a GOP, with ckpts and cfg.yml",
                    .upstream = "XDimLab/GIFStream c984866", .options = options, .probe = probe,
                    .frame = frame)
