/* Deformable 3D Gaussians (Yang et al., CVPR 2024, ingra14m): a cloud of canonical Gaussians and a
 * network of position and time that adds to their finished attributes. MotionGS (Zhu et al., NeurIPS 2024)
 * trains this model with other losses and saves it in the same files.
 *
 * Two traps. The sums are taken after activation, and the sum of quaternions goes to the rasteriser as
 * it is: what is drawn is not the ellipsoid of its direction. So the covariance is formed as the
 * rasteriser does and taken apart again. And the two halves of a save lie in separate folders: they
 * must be of the same iteration. */
#include "spin.h"

#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "importers/lib/deform.h"
#include "importers/lib/deform_save.h"
#include "importers/lib/model_folder.h"
#include "importers/lib/notes.h"

#define MOVED ((unsigned)SPIN_COL_MEANS | SPIN_COL_QUATS | SPIN_COL_LOG_SCALES)

enum {
    MAX_LAYERS = 32,
    POSITION_FREQUENCIES = 10, /* not stored; 63 inputs */
    POSITION_INPUTS = 3 + 6 * POSITION_FREQUENCIES,
    MAX_TIME_FREQUENCIES = 64,
    WARM_UP = 3000 /* iterations before which training does not use the network */
};

struct model {
    char *path; /* of deform.pth */
    struct spin_splats canonical;
    struct mlp_linear linear[MAX_LAYERS];
    int n_layers, wide; /* the layer that also takes the input again */
    int n_in, width;
    struct mlp_linear time[2]; /* time network, or none */
    int n_time;                /* inputs of the first layer that depend on time */
    float *inputs;             /* [n_time] of the frame's time, then scratch */
    int frequencies;           /* of time */
    bool screw;                /* 6dof: screw and pivot instead of warp */
    bool motiongs;             /* by its cfg_args */
    struct mlp_linear warp, screw_w, screw_v, rotation, scaling;
    struct mlp_team team;
};

/* ---- Recognising ----------------------------------------------------------------------------- */

static int probe(const struct spin_peek *peek)
{
    bool deform = false, cloud = false;

    if (!peek->is_folder) /* the keys of the state dict are near the beginning */
        return strcmp(spin_path_name(peek->path), "deform.pth") == 0 &&
                       (memmem(peek->head, peek->n_head, "linear.0.weight", 15) ||
                        memmem(peek->head, peek->n_head, "timenet.0.weight", 16))
                   ? 85
                   : 0;
    for (size_t i = 0; peek->names && peek->names[i]; i++) {
        deform = deform || strcmp(peek->names[i], "deform") == 0;
        cloud = cloud || strcmp(peek->names[i], "point_cloud") == 0;
    }
    if (!deform || !cloud)
        return 0;
    if (memmem(peek->head, peek->n_head, "grid_args", 9)) /* Grid4D and DASH */
        return 0;
    return memmem(peek->head, peek->n_head, "is_6dof", 7) ? 90 : 60;
}

/* ---- The network ----------------------------------------------------------------------------- */

static bool ends_in_parameter(const char *key, size_t n_stem)
{
    return strcmp(key + n_stem, ".weight") == 0 || strcmp(key + n_stem, ".bias") == 0;
}

static bool is_known(const char *key)
{
    static const char *const stems[] = {"timenet.0",       "timenet.2", "gaussian_warp",
                                        "branch_w",        "branch_v",  "gaussian_rotation",
                                        "gaussian_scaling"};
    size_t n = strlen("linear.");

    for (size_t i = 0; i < sizeof stems / sizeof *stems; i++)
        if (strncmp(key, stems[i], strlen(stems[i])) == 0 &&
            ends_in_parameter(key, strlen(stems[i])))
            return true;
    return strncmp(key, "linear.", n) == 0 && strspn(key + n, "0123456789") > 0 &&
           ends_in_parameter(key, n + strspn(key + n, "0123456789"));
}

/* Methods built on this one keep its folders and add heads: those would change the result. */
static spin_status check_keys(const struct spin_value *root)
{
    if (root->kind == SPIN_VALUE_TUPLE && root->n == 2 && root->item[0]->kind == SPIN_VALUE_DICT &&
        root->item[1]->kind == SPIN_VALUE_DICT)
        return spin_fail(SPIN_E_UNSUPPORTED,
                         "a pair of dicts, as Grid4D and DASH save it: use --from grid4d or --from "
                         "dash");
    if (root->kind != SPIN_VALUE_DICT)
        return spin_fail(SPIN_E_MALFORMED, "what was saved is not a state dict");
    for (size_t i = 0; i < root->n; i++) {
        const char *key = spin_value_text(root->item[2 * i]);

        if (!key)
            return spin_fail(SPIN_E_MALFORMED, "a state dict with a key that is not text");
        if (!is_known(key))
            return spin_fail(SPIN_E_UNSUPPORTED,
                             "tensor '%.80s' does not belong to this method: the run may be of one "
                             "derived from it",
                             key);
    }
    return SPIN_OK;
}

/* linear.0 [W, I], then [W, W] but for one [W, I + W]. */
static spin_status load_layers(struct spin_torch *torch, struct model *m)
{
    char name[32];

    for (int i = 0;; i++) {
        struct mlp_linear *l = &m->linear[i];

        snprintf(name, sizeof name, "linear.%d", i);
        if (i > 0 && !spin_mlp_has(torch->root, "", name))
            break;
        if (i == MAX_LAYERS)
            return spin_fail(SPIN_E_UNSUPPORTED, "more than %d layers 'linear'", MAX_LAYERS);
        SPIN_TRY(spin_mlp_load(torch, torch->root, "", name, -1, i ? m->width : -1, l));
        m->n_layers = i + 1;
        if (i == 0) {
            m->n_in = l->n_in;
            m->width = l->n_out;
        } else if (l->n_in == m->n_in + m->width && m->wide == 0) {
            m->wide = i;
        } else if (l->n_in != m->width) {
            return spin_fail(SPIN_E_MALFORMED,
                             "tensor '%s.weight' has shape [%d, %d], expected [%d, %d]%s", name,
                             l->n_out, l->n_in, m->width, m->width,
                             m->wide ? ", as an earlier layer takes the input again" : "");
        }
    }
    for (size_t i = 0; i < torch->root->n; i++) {
        const char *key = spin_value_text(torch->root->item[2 * i]);

        if (strncmp(key, "linear.", 7) == 0 && strtol(key + 7, NULL, 10) >= m->n_layers)
            return spin_fail(SPIN_E_MALFORMED, "tensor '%.80s' but no 'linear.%d.weight'", key,
                             m->n_layers);
    }
    if (m->wide == 0)
        return spin_fail(SPIN_E_MALFORMED,
                         "no layer 'linear' takes the input again: layers are missing");
    return SPIN_OK;
}

/* How time enters: through a small network, or by its frequencies alone. */
static spin_status load_time(struct spin_torch *torch, struct model *m)
{
    int inputs;

    m->n_time = m->n_in - POSITION_INPUTS;
    if (m->n_time < 1)
        return spin_fail(SPIN_E_MALFORMED,
                         "tensor 'linear.0.weight' has %d inputs, expected more than the %d of a "
                         "position",
                         m->n_in, POSITION_INPUTS);
    inputs = m->n_time;
    if (spin_mlp_has(torch->root, "", "timenet.0") || spin_mlp_has(torch->root, "", "timenet.2")) {
        SPIN_TRY(spin_mlp_load(torch, torch->root, "", "timenet.0", -1, -1, &m->time[0]));
        SPIN_TRY(spin_mlp_load(torch, torch->root, "", "timenet.2", m->time[0].n_out, m->n_time,
                               &m->time[1]));
        inputs = m->time[0].n_in;
    }
    m->frequencies = (inputs - 1) / 2;
    if (inputs % 2 == 0 || m->frequencies > MAX_TIME_FREQUENCIES)
        return spin_fail(SPIN_E_MALFORMED,
                         "time has %d inputs, expected 1 and two for each of at most %d "
                         "frequencies",
                         inputs, MAX_TIME_FREQUENCIES);
    return SPIN_OK;
}

static spin_status load_network(struct spin_torch *torch, struct model *m)
{
    const struct spin_value *root = torch->root;
    bool warp = spin_mlp_has(root, "", "gaussian_warp");

    SPIN_TRY(check_keys(root));
    SPIN_TRY(load_layers(torch, m));
    SPIN_TRY(load_time(torch, m));
    m->screw = spin_mlp_has(root, "", "branch_w") || spin_mlp_has(root, "", "branch_v");
    if (m->screw == warp)
        return spin_fail(SPIN_E_MALFORMED, "%s 'gaussian_warp' and 'branch_w'; expected one",
                         warp ? "both tensors" : "neither tensor");
    if (m->screw) {
        SPIN_TRY(spin_mlp_load(torch, root, "", "branch_w", m->width, 3, &m->screw_w));
        SPIN_TRY(spin_mlp_load(torch, root, "", "branch_v", m->width, 3, &m->screw_v));
    } else {
        SPIN_TRY(spin_mlp_load(torch, root, "", "gaussian_warp", m->width, 3, &m->warp));
    }
    SPIN_TRY(spin_mlp_load(torch, root, "", "gaussian_rotation", m->width, 4, &m->rotation));
    return spin_mlp_load(torch, root, "", "gaussian_scaling", m->width, 3, &m->scaling);
}

static spin_status open_network(struct model *m)
{
    struct spin_torch torch;
    spin_status status;

    memset(&torch, 0, sizeof torch);
    status = spin_torch_open(m->path, &torch);
    if (status == SPIN_OK)
        status = load_network(&torch, m);
    spin_torch_close(&torch);
    return spin_fail_reading(status, m->path);
}

/* ---- Opening --------------------------------------------------------------------------------- */

/* MotionGS differs by its options, and by its times: those of the data set, which may be seconds. */
static spin_status read_motiongs(const struct cfg_args *cfg, struct model *m,
                                 struct spin_sequence_info *sequence)
{
    struct cfg_span format = spin_cfg_get(cfg, "scene_format");
    bool moved = false;

    m->motiongs =
        spin_cfg_get(cfg, "use_depth_and_flow").at || spin_cfg_get(cfg, "optimize_pose").at;
    SPIN_TRY(spin_cfg_read_bool(cfg, "optimize_pose", &moved));
    if (moved)
        spin_note(sequence,
                  "optimize_pose=True: training moved the cameras and did not save them, so what "
                  "the data set's cameras see is shifted");
    if (m->motiongs && spin_cfg_is(format, "'plenopticVideo'")) {
        sequence->time_last = 10;
        sequence->half_open = true; /* 300 frames at i/30 */
        spin_note(sequence,
                  "scene_format='plenopticVideo': times are seconds, 0 to 10, and are not stored");
    } else if (m->motiongs && (spin_cfg_is(format, "''") || spin_cfg_is(format, "'blender'"))) {
        spin_note(
            sequence,
            "scene_format=%.*s: times are those of the data set's transforms_train.json, which "
            "may be seconds; without that file they run from 0 to 1, frame i of n at i/(n-1)",
            (int)(format.end - format.at), format.at);
    } else {
        spin_note(sequence, "times run from 0 to 1 and are not stored: frame i of n is at i/(n-1)");
    }
    return SPIN_OK;
}

/* The tensors say what the network is; a cfg_args that says otherwise is of another run. */
static spin_status check_cfg(const char *path, const char *cloud, struct model *m,
                             struct spin_sequence_info *sequence)
{
    const struct {
        const char *key;
        bool is;
    } said[] = {{"is_blender", m->time[0].n_in > 0}, {"is_6dof", m->screw}};
    struct cfg_args cfg;
    spin_status status = spin_model_folder_cfg(path, cloud, &cfg);

    for (size_t i = 0; i < 2 && status == SPIN_OK; i++) {
        bool value = said[i].is;

        status = spin_cfg_read_bool(&cfg, said[i].key, &value);
        if (status != SPIN_OK || value == said[i].is)
            continue;
        spin_warn(
            "'%s' says %s=%s, but the network in '%s' is of the other kind: the network decides",
            cfg.path, said[i].key, value ? "True" : "False", m->path);
        spin_note(sequence,
                  "cfg_args says %s=%s, but the network is of the other kind: the network decides",
                  said[i].key, value ? "True" : "False");
    }
    if (status == SPIN_OK)
        status = read_motiongs(&cfg, m, sequence);
    spin_cfg_close(&cfg);
    return status;
}

static void describe(struct model *m, const char *name, struct spin_sequence_info *sequence)
{
    snprintf(
        sequence->variant, sizeof sequence->variant, "%s, %zu Gaussians, %s, %d layers of %d%s%s",
        m->motiongs ? "MotionGS" : "Deformable 3D Gaussians", m->canonical.n, name, m->n_layers,
        m->width, m->time[0].n_in ? ", time network" : "", m->screw ? ", 6dof" : "");
    if (spin_model_folder_iteration(name) >= 0 && spin_model_folder_iteration(name) < WARM_UP)
        spin_note(sequence, "before iteration %d training does not use the network yet", WARM_UP);
}

/* Floats of one block: the input with a layer's output behind it, two layers, a head. */
static size_t scratch_floats(const struct model *m)
{
    return ((size_t)m->n_in + 3 * (size_t)m->width + 4) * MLP_BLOCK;
}

static spin_status open_model(const struct deform_save *save, struct model *m,
                              struct spin_sequence_info *sequence)
{
    SPIN_TRY(spin_strdup(save->network, &m->path));
    SPIN_TRY(spin_model_folder_read(save->cloud, &m->canonical, NULL, NULL));
    SPIN_TRY(open_network(m));
    spin_deform_describe(&m->canonical, MOVED, sequence);
    SPIN_TRY(check_cfg(save->model, save->cloud, m, sequence));
    describe(m, save->name, sequence);
    SPIN_TRY(
        spin_alloc((size_t)m->n_time +
                       (size_t)(1 + 2 * m->frequencies + m->time[0].n_out + m->n_time) * MLP_BLOCK,
                   sizeof *m->inputs, (void **)&m->inputs));
    return spin_mlp_team_create(scratch_floats(m), &m->team);
}

static spin_status deformable_open(const char *path, const struct spin_plugin_values *values,
                                   void **self, struct spin_sequence_info *sequence)
{
    struct deform_save save;
    spin_status status;

    *sequence = (struct spin_sequence_info){.sh_degree = -1};
    SPIN_TRY(spin_alloc(1, sizeof(struct model), self));
    status = spin_deform_save_find(path, spin_plugin_value(values, "iteration", NULL), true, &save);
    if (status == SPIN_OK)
        status = open_model(&save, *self, sequence);
    spin_deform_save_free(&save);
    return status;
}

static void deformable_close(void *self)
{
    struct model *m = self;

    if (!m)
        return;
    for (int i = 0; i < MAX_LAYERS; i++)
        spin_mlp_free(&m->linear[i]);
    spin_mlp_free(&m->time[0]);
    spin_mlp_free(&m->time[1]);
    spin_mlp_free(&m->warp);
    spin_mlp_free(&m->screw_w);
    spin_mlp_free(&m->screw_v);
    spin_mlp_free(&m->rotation);
    spin_mlp_free(&m->scaling);
    spin_mlp_team_free(&m->team);
    spin_splats_free(&m->canonical);
    free(m->inputs);
    free(m->path);
    free(m);
}

/* ---- Evaluating ------------------------------------------------------------------------------ */

/* v, then sin(2^k v) and cos(2^k v) for each frequency: one value of `width`, every `step` floats. */
static void encode(float v, int frequencies, int width, size_t step, float *out)
{
    out[0] = v;
    for (int k = 0; k < frequencies; k++) {
        float angle = ldexpf(v, k);

        out[(size_t)(width * (2 * k + 1)) * step] = sinf(angle);
        out[(size_t)(width * (2 * k + 2)) * step] = cosf(angle);
    }
}

/* The inputs that depend on time; a block of equal points for the network, of which one is kept. */
static void encode_time(struct model *m, float time)
{
    float *in = m->inputs + m->n_time, *middle, *last;

    if (m->time[0].n_in == 0) {
        encode(time, m->frequencies, 1, 1, m->inputs);
        return;
    }
    middle = in + (size_t)(1 + 2 * m->frequencies) * MLP_BLOCK;
    last = middle + (size_t)m->time[0].n_out * MLP_BLOCK;
    encode(time, m->frequencies, 1, MLP_BLOCK, in);
    spin_mlp_linear(&m->time[0], in, middle, true);
    spin_mlp_linear(&m->time[1], middle, last, false);
    for (int i = 0; i < m->n_time; i++)
        m->inputs[i] = last[i * MLP_BLOCK];
}

/* The last hidden layer. `wide` has the input in front, and room for a layer behind it. */
static const float *hidden_of(const struct model *m, float *wide, float *a, float *b)
{
    float *behind = wide + (size_t)m->n_in * MLP_BLOCK;
    const float *in = wide;

    for (int i = 0; i < m->n_layers; i++) {
        float *to = i + 1 == m->wide ? behind : in == a ? b : a;

        spin_mlp_linear(&m->linear[i], i == m->wide ? wide : in, to, true);
        in = to;
    }
    return in;
}

/* The screw motion of a twist: p' = R p + T with R and T of the matrix exponential. The constant is
 * added by the method to every component, after the division, so R is not quite a rotation. */
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

static void move(const struct deform_job *job, size_t first, int n, const float *hidden,
                 float *head)
{
    const struct model *m = job->model;
    double w[MLP_BLOCK][3];

    spin_mlp_linear(m->screw ? &m->screw_w : &m->warp, hidden, head, false);
    for (int p = 0; p < n && !m->screw; p++)
        for (int c = 0; c < 3; c++) {
            size_t at = 3 * (first + (size_t)p) + (size_t)c;

            job->out->means[at] = m->canonical.means[at] + head[c * MLP_BLOCK + p];
        }
    if (!m->screw)
        return;
    for (int p = 0; p < n; p++)
        for (int c = 0; c < 3; c++)
            w[p][c] = head[c * MLP_BLOCK + p];
    spin_mlp_linear(&m->screw_v, hidden, head, false);
    for (int p = 0; p < n; p++) {
        double v[3] = {head[p], head[MLP_BLOCK + p], head[2 * MLP_BLOCK + p]};
        size_t at = 3 * (first + (size_t)p);

        move_by_screw(w[p], v, m->canonical.means + at, job->out->means + at);
    }
}

static void shape(const struct deform_job *job, size_t first, int n, const float *hidden,
                  float *head)
{
    const struct model *m = job->model;
    float d_scale[3 * MLP_BLOCK];

    spin_mlp_linear(&m->scaling, hidden, d_scale, false);
    spin_mlp_linear(&m->rotation, hidden, head, false);
    for (int p = 0; p < n; p++) {
        size_t i = first + (size_t)p;

        spin_deform_shape(m->canonical.log_scales + 3 * i, m->canonical.quats + 4 * i, d_scale + p,
                          head + p,
                          job->columns & SPIN_COL_LOG_SCALES ? job->out->log_scales + 3 * i : NULL,
                          job->columns & SPIN_COL_QUATS ? job->out->quats + 4 * i : NULL);
    }
}

static void evaluate(void *context, size_t first, int n, float *scratch)
{
    const struct deform_job *job = context;
    const struct model *m = job->model;
    float *a = scratch + (size_t)(m->n_in + m->width) * MLP_BLOCK;
    float *b = a + (size_t)m->width * MLP_BLOCK, *head = b + (size_t)m->width * MLP_BLOCK;
    const float *hidden;

    for (int p = 0; p < MLP_BLOCK; p++) { /* the last block repeats its last point */
        const float *xyz = m->canonical.means + 3 * (first + (size_t)(p < n ? p : n - 1));

        for (int c = 0; c < 3; c++)
            encode(xyz[c], POSITION_FREQUENCIES, 3, MLP_BLOCK, scratch + c * MLP_BLOCK + p);
        for (int i = 0; i < m->n_time; i++)
            scratch[(POSITION_INPUTS + i) * MLP_BLOCK + p] = m->inputs[i];
    }
    hidden = hidden_of(m, scratch, a, b);
    if (job->columns & SPIN_COL_MEANS)
        move(job, first, n, hidden, head);
    if (job->columns & (SPIN_COL_LOG_SCALES | SPIN_COL_QUATS))
        shape(job, first, n, hidden, head);
}

static spin_status deformable_frame(void *self, int frame, double time, unsigned columns,
                                    struct spin_splats *out)
{
    struct model *m = self;

    (void)frame;
    encode_time(m, (float)time);
    return spin_deform_frame(m->path, &m->canonical, time, columns, MOVED, &m->team, evaluate, m,
                             out);
}

static const struct spin_plugin_option options[] = {
    {"iteration", "N", "which save to read; the last when not given", NULL},
    {NULL, NULL, NULL, NULL},
};

const struct spin_importer spin_importer_deformable3dgs = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "deformable3dgs",
    .summary = "Deformable 3D Gaussians, MotionGS: the model's folder, with point_cloud and deform",
    .upstream = "ingra14m/Deformable-3D-Gaussians ac42372, RuijieZhu94/MotionGS 8eab187",
    .options = options,
    .probe = probe,
    .open = deformable_open,
    .frame = deformable_frame,
    .close = deformable_close,
};
