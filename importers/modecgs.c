/* MoDec-GS (Kwak et al., CVPR 2025): anchors that spawn Gaussians at several offsets each. One
 * network moves the anchors and is evaluated at the canonical time nearest to the frame; a second
 * network moves the spawned Gaussians and is evaluated at the time of the frame.
 *
 * Only positions are imported: opacity, shape and colour of spawned Gaussians depend on the camera,
 * so there is no set of Gaussians per frame. By default, the positions at all offsets are imported;
 * with --camera, only the positions of Gaussians that are opaque from at least one given camera. */
#include "importers/lib/hexplane.h"
#include "importers/lib/run_config.h"
#include "io/npy.h"
#include "io/zip.h"
#include "math/rounded.h"

enum { MAX_OFFSETS = 64, MAX_FEATURES = 1024, MAX_SEGMENTS = 4096 };

enum { ANCHOR, FEATURE, OFFSETS, SCALING, N_HEADS };

/* The heads of the network for anchors. If the option `flag` in cfg_args is set, the output of a
 * head is multiplied by the dynamics of the anchor. */
static const struct {
    const char *tensor, *flag;
} heads[N_HEADS] = {
    {"pos_deform", "anchor_dynamics_position"},
    {"feature_deform", "anchor_dynamics_local_context_feature"},
    {"grid_offsets_deform", "anchor_dynamics_offset"},
    {"grid_scaling_deform", "anchor_dynamics_scaling"},
};

struct model {
    struct spin_model base; /* base.path: the folder of the checkpoint */
    size_t n, most;         /* number of anchors; number of anchors x number of offsets */
    int n_offsets, n_features;
    float *anchor;   /* [n][3] */
    float *offset;   /* [n][n_offsets][3] */
    float *feature;  /* [n][n_features] */
    float *scaling;  /* [n][6] factors of offsets and of scales, after exp */
    float *dynamics; /* [n][2] factors for the residuals of positions and for all other residuals */
    bool scaled[N_HEADS];        /* for each head: residuals are multiplied by the dynamics */
    float segment[MAX_SEGMENTS]; /* [n_segments] canonical times */
    int n_segments;
    double grid_pe;
    bool still; /* no_dx is set: spawned Gaussians do not move */
    struct hexplane global,
        local; /* planes of the networks for anchors and for spawned Gaussians */
    struct mlp_net head[N_HEADS], move;
    struct mlp_net alive; /* the network opacity_mlp, which is loaded if there are cameras */
    struct camera_places cameras;
    float *centre; /* [most][3] positions in the frame that was read last */
    bool *kept;    /* [most] whether the position is imported in that frame */
};

static int probe(const struct spin_peek *peek)
{
    if (!peek->is_folder)
        return strcmp(spin_path_name(peek->path), "deformation_GAD.pth") == 0 ? 90 : 0;
    if (spin_peek_contains(peek, "LGD_method="))
        return 90;
    return spin_peek_has(peek, "deformation_GAD.pth") ? 95 : 0;
}

/* ---- Settings -------------------------------------------------------------------------------- */

static spin_status need(const struct cfg_args *cfg, const char *key, bool *out)
{
    if (!spin_cfg_get(cfg, key).at)
        return spin_malformed("'%s' has no '%s'", cfg->path, key);
    return spin_cfg_read_bool(cfg, key, out);
}

static spin_status refuse(const struct cfg_args *cfg, const char *key, bool wanted)
{
    bool is = wanted;

    SPIN_TRY(spin_cfg_read_bool(cfg, key, &is));
    if (is != wanted)
        return spin_unsupported("'%s': a run with %s=%s is not supported", cfg->path, key,
                                is ? "True" : "False");
    return SPIN_OK;
}

/* The conversion of a stored dynamics value to a factor of residuals. */
struct dynamics {
    int type; /* 0, "mask": a factor of 0 or 1; 1, "mul": the activated value */
    enum { SIGMOID, RELU, TANH } activation;
};

static spin_status read_dynamics(const struct spin_model *m, const char *key, struct dynamics *out)
{
    const struct cfg_args *cfg = &m->settings.cfg;
    int activation;

    SPIN_TRY(spin_model_word(m, NULL, key, "mask|mul", &out->type));
    if (out->type < 0)
        return spin_unsupported("'%s': %s is neither 'mask' nor 'mul'", cfg->path, key);
    SPIN_TRY(spin_model_word(m, NULL, "dynamics_activation", "sigmoid|relu|tanh", &activation));
    if (activation < 0 && spin_cfg_get(cfg, "dynamics_activation").at)
        return spin_unsupported("'%s': dynamics_activation is none of sigmoid, relu and tanh",
                                cfg->path);
    out->activation = activation < 0 ? SIGMOID : activation;
    return SPIN_OK;
}

static float dynamics_factor(const struct dynamics *d, float x)
{
    float sigmoid = 1 / (1 + spin_rounded_exp(-x));

    if (d->type == 0)
        return sigmoid > 0.01f ? 1 : 0;
    return d->activation == SIGMOID ? sigmoid
           : d->activation == RELU  ? (x > 0 ? x : 0)
                                    : spin_rounded_tanh(x);
}

/* Reads the flags in cfg_args that change positions, and refuses a flag with a value whose effect
 * is not known. */
static spin_status read_settings(struct model *model)
{
    const struct cfg_args *cfg = &model->base.settings.cfg;
    struct dynamics whole = {0}, part = {0};
    bool any = false;

    if (!cfg->path)
        return spin_not_found(
            "'%s': there is no cfg_args, which is required: copy it into the model's folder",
            model->base.path);
    SPIN_TRY(refuse(cfg, "GLMD", true));
    SPIN_TRY(refuse(cfg, "TIA", true));
    if (spin_cfg_get(cfg, "LGD_method").at &&
        !spin_cfg_is(spin_cfg_get(cfg, "LGD_method"), "'explicit'"))
        return spin_unsupported("'%s': only LGD_method='explicit' is supported", cfg->path);
    if (model->cameras.n > 0)
        SPIN_TRY(refuse(cfg, "use_feat_bank", false));
    SPIN_TRY(need(cfg, "anchor_dynamics", &any));
    for (int h = 0; any && h < N_HEADS; h++)
        SPIN_TRY(need(cfg, heads[h].flag, &model->scaled[h]));
    if (!any)
        return SPIN_OK;
    SPIN_TRY(read_dynamics(&model->base, "anchor_dynamics_global_type", &whole));
    SPIN_TRY(read_dynamics(&model->base, "anchor_dynamics_local_type", &part));
    for (size_t i = 0; i < model->n; i++) {
        model->dynamics[2 * i] = dynamics_factor(&whole, model->dynamics[2 * i]);
        model->dynamics[2 * i + 1] = dynamics_factor(&part, model->dynamics[2 * i + 1]);
    }
    return SPIN_OK;
}

/* ---- Anchors --------------------------------------------------------------------------------- */

static spin_status alloc_floats(struct model *model, size_t rows, size_t width, float **out)
{
    return spin_model_alloc(&model->base, rows, width * sizeof **out, (void **)out);
}

static spin_status count_columns(const struct spin_ply *ply, const struct spin_ply_element *e,
                                 struct model *model)
{
    int n_offset = spin_model_count(e, "f_offset_"),
        n_feature = spin_model_count(e, "f_anchor_feat_");

    if (n_offset == 0 || n_feature == 0)
        return spin_malformed("'%s': the properties 'f_offset_*' or 'f_anchor_feat_*' are missing: "
                              "these are not the anchors of MoDec-GS",
                              ply->path);
    if (n_offset % 3 != 0 || n_offset > 3 * MAX_OFFSETS || n_feature > MAX_FEATURES)
        return spin_malformed("'%s' has %d properties f_offset_* and %d f_anchor_feat_*, expected "
                              "a multiple of 3 up to %d, and 1 to %d",
                              ply->path, n_offset, n_feature, 3 * MAX_OFFSETS, MAX_FEATURES);
    model->n = (size_t)e->count;
    model->n_offsets = n_offset / 3;
    model->n_features = n_feature;
    model->most = model->n * (size_t)model->n_offsets;
    return SPIN_OK;
}

static spin_status read_columns(const struct spin_ply *ply, const struct spin_ply_element *e,
                                struct model *model)
{
    static const char *const axis[] = {"x", "y", "z"};
    size_t k = (size_t)model->n_offsets, a = (size_t)model->n_features;
    bool shared = spin_ply_find(e, "dynamics") >= 0;

    SPIN_TRY(alloc_floats(model, model->n, 3, &model->anchor));
    SPIN_TRY(alloc_floats(model, model->n, 3 * k, &model->offset));
    SPIN_TRY(alloc_floats(model, model->n, a, &model->feature));
    SPIN_TRY(alloc_floats(model, model->n, 6, &model->scaling));
    SPIN_TRY(alloc_floats(model, model->n, 2, &model->dynamics));
    for (int d = 0; d < 3; d++)
        SPIN_TRY(spin_model_column(ply, e, axis[d], model->anchor + d, 3));
    for (size_t i = 0; i < 3 * k; i++) { /* in the file: x of all offsets, then y, then z */
        char name[32];

        snprintf(name, sizeof name, "f_offset_%zu", i);
        SPIN_TRY(spin_model_column(ply, e, name, model->offset + 3 * (i % k) + i / k, 3 * k));
    }
    SPIN_TRY(spin_model_columns(ply, e, "f_anchor_feat_", model->n_features, model->feature, a));
    SPIN_TRY(spin_model_columns(ply, e, "scale_", 6, model->scaling, 6));
    for (size_t i = 0; i < 6 * model->n; i++)
        model->scaling[i] = spin_rounded_exp(model->scaling[i]);
    for (int i = 0; i < 2; i++) {
        const char *name = shared ? "dynamics" : i == 0 ? "dynamics_0" : "dynamics_1";

        SPIN_TRY(spin_model_column(ply, e, name, model->dynamics + i, 2));
    }
    return SPIN_OK;
}

static spin_status read_anchors(struct model *model)
{
    const struct spin_ply_element *e;
    const char *path;

    SPIN_TRY(spin_model_join(&model->base, &path, model->base.path, "point_cloud.ply"));
    SPIN_TRY(spin_model_vertices(&model->base, path, &e));
    SPIN_TRY(count_columns(&model->base.ply, e, model));
    return read_columns(&model->base.ply, e, model);
}

/* ---- Canonical times ------------------------------------------------------------------------- */

static spin_status use_times(const char *path, const struct spin_array *a, struct model *model)
{
    if (a->n_dims != 1 || a->count == 0 || a->count > MAX_SEGMENTS || a->kind != 'f')
        return spin_malformed("'%s' is not a list of 1 to %d times", path, MAX_SEGMENTS);
    model->n_segments = (int)a->count;
    spin_array_to_f32(a, 0, a->count, model->segment);
    for (int i = 0; i < model->n_segments; i++) {
        if (!isfinite(model->segment[i]))
            return spin_malformed("'%s': time %d is not finite", path, i);
    }
    return SPIN_OK;
}

/* Reads the canonical times from canonical_times.npy. Without this file, they are evenly spaced,
 * and cfg_args contains their number, TIA_num_segments. */
static spin_status read_times(struct model *model)
{
    const struct cfg_args *cfg = &model->base.settings.cfg;
    SPIN_LEAVES(spin_map_close) struct spin_map map = {0};
    struct spin_array a;
    double count = 0;
    const char *path;

    SPIN_TRY(spin_model_find(&model->base, &path, model->base.path, "canonical_times.npy"));
    if (path) {
        SPIN_TRY(spin_map_open(path, &map));
        SPIN_TRY(spin_npy_parse(path, map.data, map.size, &a));
        return use_times(path, &a, model);
    }
    SPIN_TRY(spin_cfg_read_number(cfg, "TIA_num_segments", &count));
    if (!(count >= 1 && count <= MAX_SEGMENTS))
        return spin_not_found(
            "'%s' has no canonical_times.npy, and '%s' has no valid TIA_num_segments",
            model->base.path, cfg->path);
    model->n_segments = (int)count;
    for (int i = 0; i < model->n_segments; i++)
        model->segment[i] = (float)i / (float)model->n_segments;
    return SPIN_OK;
}

/* Returns the canonical time nearest to `time` or, if that is later than `time`, this canonical
 * time minus the mean length of a segment. The result of the subtraction is not always the previous
 * canonical time, since training shifts the canonical times. */
static float canonical_time(const struct model *model, float time)
{
    int nearest = 0;

    for (int i = 1; i < model->n_segments; i++) {
        if (fabsf(model->segment[i] - time) < fabsf(model->segment[nearest] - time))
            nearest = i;
    }
    if (model->segment[nearest] > time)
        return model->segment[nearest] - 1 / (float)model->n_segments;
    return model->segment[nearest];
}

/* ---- Networks -------------------------------------------------------------------------------- */

static spin_status load_planes(struct model *model, struct hexplane *hex)
{
    SPIN_TRY(spin_model_dict(&model->base));
    if (!spin_hex_find(&model->base))
        return spin_malformed("there is no tensor 'deformation_net.grid.grids.0.0'");
    return spin_hex_load(&model->base, model->grid_pe, hex);
}

static spin_status load_global(struct spin_model *base)
{
    struct model *model = (struct model *)base;
    int n_out[N_HEADS] = {3, model->n_features, 3 * model->n_offsets, 6};

    SPIN_TRY(load_planes(model, &model->global));
    for (int h = 0; h < N_HEADS; h++) {
        if (spin_model_get(base, "%s.1.weight", heads[h].tensor))
            SPIN_TRY(spin_model_head(base, heads[h].tensor, model->global.width, n_out[h],
                                     &model->head[h]));
    }
    return SPIN_OK;
}

static spin_status load_local(struct spin_model *base)
{
    struct model *model = (struct model *)base;

    SPIN_TRY(load_planes(model, &model->local));
    return model->still ? SPIN_OK
                        : spin_model_head(base, "pos_deform", model->local.width, 3, &model->move);
}

static spin_status open_network(struct model *model, const char *name,
                                spin_status (*load)(struct spin_model *m))
{
    const char *path;

    SPIN_TRY(spin_model_join(&model->base, &path, model->base.path, "%s", name));
    return spin_model_torch(&model->base, path, load);
}

/* ---- opacity_mlp.pt -------------------------------------------------------------------------- */

/* Reads the floats of storage `index`, all of which must be finite. Their number must be *count; if
 * *count is 0, any number is accepted and stored in *count. TorchScript numbers storages in the
 * order of their appearance: weight and bias of the first layer, then of the second. */
static spin_status read_storage(struct model *model, const struct spin_zip *zip, int index,
                                size_t *count, const float **out)
{
    const struct spin_zip_member *m = NULL;
    const unsigned char *data;
    void *owned = NULL;
    float *values;
    char name[24];
    spin_status status;

    snprintf(name, sizeof name, "/data/%d", index);
    for (size_t i = 0; i < zip->n; i++) {
        size_t n = strlen(zip->member[i].name), tail = strlen(name);

        if (n > tail && strcmp(zip->member[i].name + n - tail, name) == 0)
            m = &zip->member[i];
    }
    if (!m || m->size % 4 != 0 || m->size == 0 || (*count && m->size != 4 * (uint64_t)*count))
        return spin_malformed("member 'data/%d' is missing, or does not have the size of the layer",
                              index);
    SPIN_TRY(spin_zip_read(zip, m, true, 1u << 24, &data, &owned));
    *count = (size_t)m->size / 4;
    status = alloc_floats(model, *count, 1, &values);
    if (status == SPIN_OK)
        memcpy(values, data, (size_t)m->size);
    free(owned);
    SPIN_TRY(status);
    *out = values;
    if (spin_finite_missing(values, *count) > 0)
        return spin_malformed("member 'data/%d' has values that are not finite", index);
    return SPIN_OK;
}

/* Reads the two layers of opacity_mlp: Linear(A + 3 or A + 4, A), whose inputs are A features and
 * the view, and Linear(A, offsets). torch.jit.trace() saved them in a zip whose program is not
 * read. Only the sign of the output matters, so the tanh after the last layer is omitted. */
static spin_status read_layers(struct model *model, const struct spin_zip *zip)
{
    struct mlp_layer *layer = model->alive.layer;
    size_t a = (size_t)model->n_features, k = (size_t)model->n_offsets;
    size_t n_in = 0, n_bias = a, n_out = a * k, n_last = k;

    SPIN_TRY(read_storage(model, zip, 0, &n_in, &layer[0].weight));
    if (n_in != a * (a + 3) && n_in != a * (a + 4))
        return spin_malformed(
            "member 'data/0' has %zu values, expected %zu or %zu for %zu features", n_in,
            a * (a + 3), a * (a + 4), a);
    SPIN_TRY(read_storage(model, zip, 1, &n_bias, &layer[0].bias));
    SPIN_TRY(read_storage(model, zip, 2, &n_out, &layer[1].weight));
    SPIN_TRY(read_storage(model, zip, 3, &n_last, &layer[1].bias));
    layer[0].n_in = (int)(n_in / a);
    layer[0].n_out = layer[1].n_in = (int)a;
    layer[0].ending = MLP_RELU;
    layer[1].n_out = (int)k;
    model->alive.n = 2;
    return SPIN_OK;
}

static spin_status read_opacity(struct model *model)
{
    SPIN_LEAVES(spin_zip_close) struct spin_zip zip = {0};
    const char *path;
    spin_status status;

    SPIN_TRY(spin_model_join(&model->base, &path, model->base.path, "opacity_mlp.pt"));
    status = spin_zip_open(path, &zip);
    if (status == SPIN_OK)
        status = read_layers(model, &zip);
    return spin_fail_reading(status, path);
}

/* ---- Opening --------------------------------------------------------------------------------- */

/* The parts of a thread's scratch memory, which is for a block of anchors. */
enum {
    NETWORK = N_HEADS, /* scratch memory of the network that is evaluated; the N_HEADS parts before
                          it contain the deformed attributes */
    INPUT,             /* INPUT, LAYER and ALIVE: input, hidden layer and output of opacity_mlp */
    LAYER,
    ALIVE,
    CENTRE,   /* [MLP_BLOCK * n_offsets][3] */
    RESIDUAL, /* [3][MLP_BLOCK] */
    N_PARTS
};

/* Sets the start of each part in `scratch`, unless that is NULL; returns the number of floats of
 * all parts. */
static size_t split_scratch(const struct model *model, float *scratch, float *part[N_PARTS])
{
    size_t global = spin_hex_scratch(&model->global), local = spin_hex_scratch(&model->local);
    size_t k = (size_t)model->n_offsets, a = (size_t)model->n_features, at = 0;
    const size_t width[N_PARTS] = {
        3, a, 3 * k, 6, (global > local ? global : local) / MLP_BLOCK, a + 4, a, k, 3 * k, 4};

    for (int i = 0; i < N_PARTS; at += width[i++] * MLP_BLOCK) {
        if (scratch)
            part[i] = scratch + at;
    }
    return at;
}

static spin_status open_model(void *self, const char *path)
{
    struct model *model = self;
    struct spin_model *base = self;
    struct spin_sequence_info *sequence = base->sequence;
    const struct cfg_args *cfg = &base->settings.cfg;
    const char *wanted = spin_model_option(base, "iteration");
    bool coarse;

    SPIN_TRY(spin_model_checkpoint(base, path, "deformation_GAD.pth", &base->path));
    if (!base->path)
        return spin_not_found(
            "'%s' has no iteration_%s with point_cloud.ply and deformation_GAD.pth%s", path,
            wanted ? wanted : "<N>",
            spin_model_search(path, "deformation.pth", &coarse)
                ? "; a run with 'deformation.pth' alone is of 4DGaussians, or of MoDec-GS without "
                  "GLMD (MoDec-GS without GLMD is not supported)"
                : "");
    SPIN_TRY(spin_model_cfg(base, path, base->path));
    SPIN_TRY(spin_camera_places_parse(spin_model_option(base, "camera"), &model->cameras));
    SPIN_TRY(read_anchors(model));
    SPIN_TRY(read_settings(model));
    SPIN_TRY(read_times(model));
    SPIN_TRY(spin_cfg_read_number(cfg, "grid_pe", &model->grid_pe));
    SPIN_TRY(spin_cfg_read_bool(cfg, "no_dx", &model->still));
    SPIN_TRY(open_network(model, "deformation_GAD.pth", load_global));
    SPIN_TRY(open_network(model, "deformation_LGD.pth", load_local));
    if (model->cameras.n > 0)
        SPIN_TRY(read_opacity(model));
    SPIN_TRY(alloc_floats(model, model->most, 3, &model->centre));
    SPIN_TRY(spin_model_alloc(base, model->most, sizeof *model->kept, (void **)&model->kept));
    spin_model_describe(base, model->cameras.n > 0 ? NULL : &model->most, -1, ~0u);
    sequence->identity = model->cameras.n == 0;
    sequence->columns = SPIN_COL_MEANS;
    snprintf(sequence->variant, sizeof sequence->variant,
             "MoDec-GS, %zu anchors with %d offsets, %d segments", model->n, model->n_offsets,
             model->n_segments);
    spin_note(
        sequence,
        "positions only, since opacity, shape and colour depend on the position of the camera");
    if (model->cameras.n == 0)
        spin_note(
            sequence,
            "the points at all offsets are imported, including invisible ones: to import only "
            "points that some cameras show, give the positions of the cameras with --camera");
    spin_note(sequence, "times run from 0 to 1 and are not stored");
    return spin_mlp_team_create(split_scratch(model, NULL, NULL), &base->team);
}

/* ---- Evaluating ------------------------------------------------------------------------------ */

struct job {
    struct model *model;
    float time, canonical;
};

/* Computes the positions, features, offsets and scalings of n anchors at the canonical time. */
static void deform_anchors(const struct job *job, size_t first, int n, float *const *part)
{
    const struct model *model = job->model;
    const float *from[N_HEADS] = {model->anchor, model->feature, model->offset, model->scaling};
    int width[N_HEADS] = {3, model->n_features, 3 * model->n_offsets, 6};
    const float *xyz = model->anchor + 3 * first;
    float *spare, mask[MLP_BLOCK];
    float *h = spin_hex_hidden(&model->global, xyz, n, job->canonical, part[NETWORK], &spare, mask);

    for (int i = 0; i < N_HEADS; i++) {
        bool any = model->head[i].n > 0;

        if (any)
            spin_mlp_run(&model->head[i], h, spare, part[i]);
        for (int p = 0; p < n; p++) {
            size_t row = first + (size_t)p;
            float factor = model->scaled[i] ? model->dynamics[2 * row + (i != ANCHOR)] : 1;

            for (int c = 0; c < width[i]; c++) {
                float old = from[i][row * (size_t)width[i] + (size_t)c];
                float *to = &part[i][c * MLP_BLOCK + p];

                *to = any ? old * mask[p] + *to * factor : old;
            }
        }
    }
}

static void spawn(const struct model *model, int n, float *const *part)
{
    for (int p = 0; p < n; p++) {
        for (int k = 0; k < model->n_offsets; k++) {
            for (int d = 0; d < 3; d++)
                part[CENTRE][3 * (p * model->n_offsets + k) + d] =
                    part[ANCHOR][d * MLP_BLOCK + p] +
                    part[OFFSETS][(3 * k + d) * MLP_BLOCK + p] * part[SCALING][d * MLP_BLOCK + p];
        }
    }
}

/* Sets `kept` of each offset whose Gaussian is opaque from at least one of the cameras. */
static void find_alive(const struct model *model, size_t first, int n, float *const *part)
{
    size_t k = (size_t)model->n_offsets;
    int a = model->n_features;

    memcpy(part[INPUT], part[FEATURE], (size_t)a * MLP_BLOCK * sizeof(float));
    memset(part[INPUT] + a * MLP_BLOCK, 0, 4 * MLP_BLOCK * sizeof(float));
    for (int c = 0; c < model->cameras.n; c++) {
        for (int p = 0; p < n; p++) {
            float *v = part[INPUT] + a * MLP_BLOCK + p, norm = 0;

            for (int d = 0; d < 3; d++) {
                v[d * MLP_BLOCK] = part[ANCHOR][d * MLP_BLOCK + p] - model->cameras.place[c][d];
                norm += v[d * MLP_BLOCK] * v[d * MLP_BLOCK];
            }
            norm = sqrtf(norm);
            for (int d = 0; d < 3 && norm > 0; d++)
                v[d * MLP_BLOCK] /= norm;
            v[3 * MLP_BLOCK] = norm; /* the distance, which only a layer with A + 4 inputs uses */
        }
        spin_mlp_run(&model->alive, part[INPUT], part[LAYER], part[ALIVE]);
        for (int p = 0; p < n; p++)
            for (size_t i = 0; i < k; i++)
                model->kept[(first + (size_t)p) * k + i] |=
                    part[ALIVE][i * MLP_BLOCK + (size_t)p] > 0;
    }
}

/* Moves the spawned Gaussians with the second network, at the time of the frame. */
static void move_centres(const struct job *job, size_t first, int n, float *const *part)
{
    const struct model *model = job->model;
    float *to = job->model->centre + 3 * first * (size_t)model->n_offsets;
    int n_centres = n * model->n_offsets;

    if (model->move.n == 0) {
        memcpy(to, part[CENTRE], 3 * (size_t)n_centres * sizeof *to);
        return;
    }
    for (int at = 0; at < n_centres; at += MLP_BLOCK) {
        int left = n_centres - at < MLP_BLOCK ? n_centres - at : MLP_BLOCK;
        const float *xyz = part[CENTRE] + 3 * at;
        float *spare, mask[MLP_BLOCK];
        float *h =
            spin_hex_hidden(&model->local, xyz, left, job->time, part[NETWORK], &spare, mask);

        spin_mlp_run(&model->move, h, spare, part[RESIDUAL]);
        for (int p = 0; p < left; p++)
            for (int d = 0; d < 3; d++)
                to[3 * (at + p) + d] = xyz[3 * p + d] * mask[p] + part[RESIDUAL][d * MLP_BLOCK + p];
    }
}

static void evaluate(void *context, size_t first, int n, float *scratch)
{
    const struct job *job = context;
    float *part[N_PARTS];
    size_t k = (size_t)job->model->n_offsets;

    split_scratch(job->model, scratch, part);
    deform_anchors(job, first, n, part);
    spawn(job->model, n, part);
    for (size_t i = first * k; i < (first + (size_t)n) * k; i++)
        job->model->kept[i] = job->model->cameras.n == 0;
    if (job->model->cameras.n > 0)
        find_alive(job->model, first, n, part);
    move_centres(job, first, n, part);
}

static spin_status modecgs_frame(void *self, int frame, double time, unsigned columns,
                                 struct spin_splats *out)
{
    struct model *model = self;
    struct job job = {model, (float)time, canonical_time(model, (float)time)};
    size_t n = 0;

    (void)frame;
    if (!isfinite(time))
        return spin_misuse("'%s': time %g is not finite", model->base.path, time);
    spin_mlp_team_run(&model->base.team, model->n, evaluate, &job);
    for (size_t i = 0; i < model->most; i++)
        n += model->kept[i];
    if (n == 0)
        return spin_unsupported(
            "'%s': no Gaussian is opaque from the positions of --camera at time %g",
            model->base.path, time);
    columns &= SPIN_COL_MEANS;
    SPIN_TRY(spin_splats_reserve(out, n, columns, 0));
    n = 0;
    for (size_t i = 0; columns && i < model->most; i++) {
        if (model->kept[i])
            memcpy(out->means + 3 * n++, model->centre + 3 * i, 3 * sizeof *out->means);
    }
    return spin_model_check(model->base.path, time, columns, out);
}

static const struct spin_plugin_option options[] = {
    {"iteration", "N", "the checkpoint to read (default: the last)", NULL},
    {"camera", "X,Y,Z[;...]", "import only points that are opaque from one of these positions",
     NULL},
    {NULL, NULL, NULL, NULL},
};

SPIN_MODEL_IMPORTER(
    modecgs, struct model, open_model, spin_model_close,
    .summary = "MoDec-GS, positions only: the model's folder, with cfg_args and point_cloud",
    .upstream = "skwak-kaist/MoDec-GS, read from single files of its public repository",
    .options = options, .probe = probe, .frame = modecgs_frame)
