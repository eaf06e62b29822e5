/* MoDec-GS (Kwak et al., CVPR 2025): anchors that spawn Gaussians, moved by two networks, one for
 * the anchors at the nearest canonical time and one for what they spawned.
 *
 * Positions only: opacity, shape and colour of what an anchor spawns depend on the camera, so
 * there is no set of Gaussians per frame. Which offsets are alive depends on it too; all are
 * taken, or with --camera those that are alive for one of the given places. */
#include "spin.h"
#include <stdlib.h>

#include "base/err.h"
#include "importers/lib/camera_places.h"
#include "importers/lib/finite.h"
#include "importers/lib/model_folder.h"
#include "importers/lib/hexplane.h"
#include "importers/lib/notes.h"
#include "importers/lib/torchscript.h"
#include "io/npy.h"
#include "math/plane.h"

enum { MAX_OFFSETS = 64, MAX_FEATURES = 1024, MAX_SEGMENTS = 4096 };

enum { ANCHOR, FEATURE, OFFSETS, SCALING, N_HEADS };

/* `flag` says whether a head is multiplied by the dynamics of its anchor. */
static const struct {
    const char *tensor, *flag;
} heads[N_HEADS] = {
    {"pos_deform", "anchor_dynamics_position"},
    {"feature_deform", "anchor_dynamics_local_context_feature"},
    {"grid_offsets_deform", "anchor_dynamics_offset"},
    {"grid_scaling_deform", "anchor_dynamics_scaling"},
};

struct model {
    char *save;
    size_t n, most; /* anchors; anchors x offsets */
    int n_offsets, n_features;
    float *anchor;        /* [n][3] */
    float *offset;        /* [n][n_offsets][3] */
    float *feature;       /* [n][n_features] */
    float *scaling;       /* [n][6] after exp */
    float *dynamics;      /* [n][2] of the anchor, of what it spawns */
    bool scaled[N_HEADS]; /* by the dynamics */
    float *segment;       /* [n_segments] canonical times */
    int n_segments;
    struct hexplane global, local;
    struct hex_head head[N_HEADS], move; /* n_in == 0: there is none */
    struct mlp_linear alive[2];          /* opacity_mlp, with cameras */
    struct camera_places cameras;
    float *centre; /* [most][3] of the frame that was read last */
    bool *kept;    /* [most] */
    struct mlp_team team;
};

static int probe(const struct spin_peek *peek)
{
    const char *name = strrchr(peek->path, '/');

    if (peek->is_folder && memmem(peek->head, peek->n_head, "LGD_method=", 11))
        return 90;
    for (size_t i = 0; peek->is_folder && peek->names && peek->names[i]; i++) {
        if (strcmp(peek->names[i], "deformation_GAD.pth") == 0)
            return 95;
    }
    return strcmp(name ? name + 1 : peek->path, "deformation_GAD.pth") == 0 ? 90 : 0;
}

/* ---- Settings -------------------------------------------------------------------------------- */

static spin_status need(const struct cfg_args *cfg, const char *key, bool *out)
{
    if (!spin_cfg_get(cfg, key).at)
        return spin_fail(SPIN_E_MALFORMED, "'%s' has no '%s'", cfg->path, key);
    return spin_cfg_read_bool(cfg, key, out);
}

static spin_status refuse(const struct cfg_args *cfg, const char *key, bool wanted)
{
    bool is = wanted;

    SPIN_TRY(spin_cfg_read_bool(cfg, key, &is));
    if (is != wanted)
        return spin_fail(SPIN_E_UNSUPPORTED, "'%s': a run with %s=%s is not read", cfg->path, key,
                         is ? "True" : "False");
    return SPIN_OK;
}

/* How a dynamics value becomes a factor. */
struct dynamics {
    bool mask;       /* 1 or 0 */
    char activation; /* s, r or t: sigmoid, relu, tanh */
};

static spin_status read_dynamics(const struct cfg_args *cfg, const char *key, struct dynamics *out)
{
    struct cfg_span type = spin_cfg_get(cfg, key), act = spin_cfg_get(cfg, "dynamics_activation");

    if (spin_cfg_is(type, "'mask'"))
        out->mask = true;
    else if (!spin_cfg_is(type, "'mul'"))
        return spin_fail(SPIN_E_UNSUPPORTED, "'%s': %s is neither 'mask' nor 'mul'", cfg->path,
                         key);
    if (!act.at || spin_cfg_is(act, "'sigmoid'"))
        out->activation = 's';
    else if (spin_cfg_is(act, "'relu'"))
        out->activation = 'r';
    else if (spin_cfg_is(act, "'tanh'"))
        out->activation = 't';
    else
        return spin_fail(SPIN_E_UNSUPPORTED, "'%s': dynamics_activation is not known", cfg->path);
    return SPIN_OK;
}

static float dynamics_factor(const struct dynamics *d, float x)
{
    float sigmoid = 1 / (1 + expf(-x));

    if (d->mask)
        return sigmoid > 0.01f ? 1 : 0;
    return d->activation == 's' ? sigmoid : d->activation == 'r' ? (x > 0 ? x : 0) : tanhf(x);
}

/* The flags that change positions, and those under which the page does not say how to go on. */
static spin_status read_settings(const struct cfg_args *cfg, struct model *model)
{
    struct dynamics whole = {0}, part = {0};
    bool any = false;

    if (!cfg->path)
        return spin_fail(SPIN_E_NOT_FOUND,
                         "no cfg_args for '%s', without which nothing can be read", model->save);
    SPIN_TRY(refuse(cfg, "GLMD", true));
    SPIN_TRY(refuse(cfg, "TIA", true));
    if (spin_cfg_get(cfg, "LGD_method").at &&
        !spin_cfg_is(spin_cfg_get(cfg, "LGD_method"), "'explicit'"))
        return spin_fail(SPIN_E_UNSUPPORTED, "'%s': only LGD_method='explicit' is read", cfg->path);
    if (model->cameras.n > 0)
        SPIN_TRY(refuse(cfg, "use_feat_bank", false));
    SPIN_TRY(need(cfg, "anchor_dynamics", &any));
    for (int h = 0; any && h < N_HEADS; h++)
        SPIN_TRY(need(cfg, heads[h].flag, &model->scaled[h]));
    if (!any)
        return SPIN_OK;
    SPIN_TRY(read_dynamics(cfg, "anchor_dynamics_global_type", &whole));
    SPIN_TRY(read_dynamics(cfg, "anchor_dynamics_local_type", &part));
    for (size_t i = 0; i < model->n; i++) {
        model->dynamics[2 * i] = dynamics_factor(&whole, model->dynamics[2 * i]);
        model->dynamics[2 * i + 1] = dynamics_factor(&part, model->dynamics[2 * i + 1]);
    }
    return SPIN_OK;
}

/* ---- Anchors --------------------------------------------------------------------------------- */

static spin_status alloc_floats(size_t rows, size_t width, float **out)
{
    return spin_alloc(rows, width * sizeof **out, (void **)out);
}

static spin_status count_columns(const struct spin_ply *ply, const struct spin_ply_element *e,
                                 struct model *model)
{
    int n_offset = spin_model_folder_count(e, "f_offset_"),
        n_feature = spin_model_folder_count(e, "f_anchor_feat_");

    if (n_offset == 0 || n_feature == 0)
        return spin_fail(SPIN_E_MALFORMED,
                         "'%s': no properties 'f_offset_*' and 'f_anchor_feat_*', so these are not "
                         "the anchors of MoDec-GS",
                         ply->path);
    if (n_offset % 3 != 0 || n_offset > 3 * MAX_OFFSETS || n_feature > MAX_FEATURES)
        return spin_fail(SPIN_E_MALFORMED,
                         "'%s': %d properties f_offset_* and %d f_anchor_feat_*, expected a "
                         "multiple of 3 up to %d and up to %d",
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

    SPIN_TRY(alloc_floats(model->n, 3, &model->anchor));
    SPIN_TRY(alloc_floats(model->n, 3 * k, &model->offset));
    SPIN_TRY(alloc_floats(model->n, a, &model->feature));
    SPIN_TRY(alloc_floats(model->n, 6, &model->scaling));
    SPIN_TRY(alloc_floats(model->n, 2, &model->dynamics));
    for (int d = 0; d < 3; d++)
        SPIN_TRY(spin_model_folder_column(ply, e, axis[d], model->anchor + d, 3));
    for (size_t i = 0; i < 3 * k; i++) { /* axis-major in the file */
        char name[32];

        snprintf(name, sizeof name, "f_offset_%zu", i);
        SPIN_TRY(
            spin_model_folder_column(ply, e, name, model->offset + 3 * (i % k) + i / k, 3 * k));
    }
    SPIN_TRY(
        spin_model_folder_columns(ply, e, "f_anchor_feat_", model->n_features, model->feature, a));
    SPIN_TRY(spin_model_folder_columns(ply, e, "scale_", 6, model->scaling, 6));
    for (size_t i = 0; i < 6 * model->n; i++)
        model->scaling[i] = expf(model->scaling[i]);
    for (int i = 0; i < 2; i++) {
        const char *name = shared ? "dynamics" : i == 0 ? "dynamics_0" : "dynamics_1";

        SPIN_TRY(spin_model_folder_column(ply, e, name, model->dynamics + i, 2));
    }
    return SPIN_OK;
}

static spin_status read_anchors(struct model *model)
{
    const struct spin_ply_element *e;
    struct spin_ply ply;
    char *path = NULL;
    spin_status status;

    SPIN_TRY(spin_path_join(model->save, "point_cloud.ply", &path));
    status = spin_model_folder_open(path, &ply, &e);
    free(path);
    SPIN_TRY(status);
    SPIN_TRY_OUT(count_columns(&ply, e, model));
    SPIN_TRY_OUT(read_columns(&ply, e, model));
out:
    spin_ply_close(&ply);
    return status;
}

/* ---- Canonical times ------------------------------------------------------------------------- */

static spin_status use_times(const char *path, const struct spin_array *a, struct model *model)
{
    if (a->n_dims != 1 || a->count == 0 || a->count > MAX_SEGMENTS || a->kind != 'f')
        return spin_fail(SPIN_E_MALFORMED, "'%s' is not a list of 1 to %d times", path,
                         MAX_SEGMENTS);
    model->n_segments = (int)a->count;
    SPIN_TRY(alloc_floats(a->count, 1, &model->segment));
    spin_array_to_f32(a, 0, a->count, model->segment);
    for (int i = 0; i < model->n_segments; i++) {
        if (!isfinite(model->segment[i]))
            return spin_fail(SPIN_E_MALFORMED, "'%s': time %d is not finite", path, i);
    }
    return SPIN_OK;
}

/* canonical_times.npy, else as many even steps as cfg_args says. */
static spin_status read_times(const struct cfg_args *cfg, struct model *model)
{
    struct spin_map map = {NULL, 0};
    struct spin_array a;
    double count = 0;
    char *path = NULL;
    spin_status status;

    SPIN_TRY(spin_path_join(model->save, "canonical_times.npy", &path));
    if (spin_path_exists(path)) {
        status = spin_map_open(path, &map);
        if (status == SPIN_OK)
            status = spin_npy_parse(path, map.data, map.size, &a);
        if (status == SPIN_OK)
            status = use_times(path, &a, model);
        spin_map_close(&map);
        free(path);
        return status;
    }
    free(path);
    SPIN_TRY(spin_cfg_read_number(cfg, "TIA_num_segments", &count));
    if (!(count >= 1 && count <= MAX_SEGMENTS))
        return spin_fail(SPIN_E_NOT_FOUND,
                         "'%s' has no canonical_times.npy, and '%s' no usable TIA_num_segments",
                         model->save, cfg->path);
    model->n_segments = (int)count;
    SPIN_TRY(alloc_floats((size_t)model->n_segments, 1, &model->segment));
    for (int i = 0; i < model->n_segments; i++)
        model->segment[i] = (float)i / (float)model->n_segments;
    return SPIN_OK;
}

/* The nearest one; where that is still to come, a constant step back from it. Differs: the step
 * before would be the previous entry if the entries were even, but training shifts them. */
static float model_folder_time(const struct model *model, float time)
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

static spin_status load_global(struct spin_torch *torch, const char *prefix, double grid_pe,
                               struct model *model)
{
    int n_out[N_HEADS] = {3, model->n_features, 3 * model->n_offsets, 6};

    SPIN_TRY(spin_hex_load(torch, torch->root, prefix, grid_pe, &model->global));
    for (int h = 0; h < N_HEADS; h++) {
        if (spin_hex_has_head(torch->root, prefix, heads[h].tensor))
            SPIN_TRY(spin_hex_load_head(torch, torch->root, prefix, heads[h].tensor,
                                        model->global.width, n_out[h], &model->head[h]));
    }
    return SPIN_OK;
}

static spin_status load_local(struct spin_torch *torch, const char *prefix, double grid_pe,
                              bool moves, struct model *model)
{
    SPIN_TRY(spin_hex_load(torch, torch->root, prefix, grid_pe, &model->local));
    if (moves)
        return spin_hex_load_head(torch, torch->root, prefix, "pos_deform", model->local.width, 3,
                                  &model->move);
    return SPIN_OK;
}

static spin_status open_network(const char *name, const struct cfg_args *cfg, struct model *model)
{
    struct spin_torch torch;
    double grid_pe = 0;
    bool still = false;
    const char *prefix;
    char *path = NULL;
    spin_status status;

    SPIN_TRY(spin_cfg_read_number(cfg, "grid_pe", &grid_pe));
    SPIN_TRY(spin_cfg_read_bool(cfg, "no_dx", &still));
    SPIN_TRY(spin_path_join(model->save, name, &path));
    memset(&torch, 0, sizeof torch);
    SPIN_TRY_OUT(spin_torch_open(path, &torch));
    if (!torch.root || torch.root->kind != SPIN_VALUE_DICT)
        SPIN_TRY_OUT(spin_fail(SPIN_E_MALFORMED, "what was saved is not a state dict"));
    prefix = spin_hex_prefix(torch.root);
    if (!prefix)
        SPIN_TRY_OUT(spin_fail(SPIN_E_MALFORMED, "no tensor 'deformation_net.grid.grids.0.0'"));
    if (strcmp(name, "deformation_GAD.pth") == 0)
        SPIN_TRY_OUT(load_global(&torch, prefix, grid_pe, model));
    else
        SPIN_TRY_OUT(load_local(&torch, prefix, grid_pe, !still, model));
out:
    spin_torch_close(&torch);
    status = spin_fail_reading(status, path);
    free(path);
    return status;
}

/* ---- opacity_mlp.pt -------------------------------------------------------------------------- */

/* Only the sign of what comes out is of interest, so the tanh behind it is left out. */
static spin_status read_opacity(struct model *model)
{
    char *path = NULL;
    spin_status status;

    SPIN_TRY(spin_path_join(model->save, "opacity_mlp.pt", &path));
    status = spin_torchscript_load(path, model->n_features, model->n_offsets, model->alive);
    free(path);
    return status;
}

/* ---- Opening --------------------------------------------------------------------------------- */

/* Floats of scratch for a block of anchors: the networks, the four heads, input and layers of the
 * opacities, and the centres. */
static size_t count_scratch(const struct model *model)
{
    size_t global = spin_hex_scratch(&model->global), local = spin_hex_scratch(&model->local);
    size_t k = (size_t)model->n_offsets, a = (size_t)model->n_features;

    return (global > local ? global : local) + (3 + a + 3 * k + 6) * MLP_BLOCK +
           (a + 4 + a + k) * MLP_BLOCK + 3 * k * MLP_BLOCK + 4 * MLP_BLOCK;
}

static void describe(struct model *model, struct spin_sequence_info *sequence)
{
    sequence->n_frames = 1;
    sequence->identity = model->cameras.n == 0;
    sequence->counts = model->cameras.n > 0 ? NULL : &model->most;
    sequence->columns = SPIN_COL_MEANS;
    sequence->continuous = true;
    sequence->time_last = 1;
    snprintf(sequence->variant, sizeof sequence->variant,
             "MoDec-GS, %zu anchors with %d offsets, %d segments", model->n, model->n_offsets,
             model->n_segments);
    spin_note(sequence, "positions only: opacity, shape and colour depend on the camera");
    if (model->cameras.n == 0)
        spin_note(sequence, "all offsets are imported, also those that no camera sees: --camera "
                            "says where cameras are");
    spin_note(sequence, "times run from 0 to 1 and are not stored");
}

static spin_status open_model(const struct cfg_args *cfg, const struct spin_plugin_values *values,
                              struct model *model, struct spin_sequence_info *sequence)
{
    SPIN_TRY(spin_camera_places_parse(spin_plugin_value(values, "camera", NULL), &model->cameras));
    SPIN_TRY(read_anchors(model));
    SPIN_TRY(read_settings(cfg, model));
    SPIN_TRY(read_times(cfg, model));
    SPIN_TRY(open_network("deformation_GAD.pth", cfg, model));
    SPIN_TRY(open_network("deformation_LGD.pth", cfg, model));
    if (model->cameras.n > 0)
        SPIN_TRY(read_opacity(model));
    SPIN_TRY(alloc_floats(model->most, 3, &model->centre));
    SPIN_TRY(spin_alloc(model->most, sizeof *model->kept, (void **)&model->kept));
    describe(model, sequence);
    return spin_mlp_team_create(count_scratch(model), &model->team);
}

static spin_status modecgs_open(const char *path, const struct spin_plugin_values *values,
                                void **self, struct spin_sequence_info *sequence)
{
    const char *wanted = spin_plugin_value(values, "iteration", NULL);
    struct cfg_args cfg;
    struct model *model;
    bool coarse;
    spin_status status;

    *sequence = (struct spin_sequence_info){.sh_degree = -1};
    SPIN_TRY(spin_alloc(1, sizeof(struct model), self));
    model = *self;
    SPIN_TRY(spin_model_folder_save(path, wanted, "deformation_GAD.pth", &model->save));
    if (!model->save)
        return spin_fail(SPIN_E_NOT_FOUND,
                         "'%s' has no iteration_%s with point_cloud.ply and deformation_GAD.pth%s",
                         path, wanted ? wanted : "<N>",
                         spin_model_folder_search(path, "deformation.pth", &coarse)
                             ? "; what has 'deformation.pth' alone is a run of 4DGaussians, or of "
                               "MoDec-GS without GLMD, which is not read"
                             : "");
    status = spin_model_folder_cfg(path, model->save, &cfg);
    if (status == SPIN_OK)
        status = open_model(&cfg, values, model, sequence);
    spin_cfg_close(&cfg);
    return status;
}

static void modecgs_close(void *self)
{
    struct model *model = self;

    if (!model)
        return;
    spin_hex_free(&model->global);
    spin_hex_free(&model->local);
    for (int h = 0; h < N_HEADS; h++)
        spin_hex_head_free(&model->head[h]);
    spin_hex_head_free(&model->move);
    spin_mlp_free(&model->alive[0]);
    spin_mlp_free(&model->alive[1]);
    spin_mlp_team_free(&model->team);
    free(model->anchor);
    free(model->offset);
    free(model->feature);
    free(model->scaling);
    free(model->dynamics);
    free(model->segment);
    free(model->centre);
    free(model->kept);
    free(model->save);
    free(model);
}

/* ---- Evaluating ------------------------------------------------------------------------------ */

struct job {
    struct model *model;
    float time, canonical;
};

/* The parts of a worker's scratch. */
struct parts {
    float *network;            /* both networks, one after the other */
    float *deform[N_HEADS];    /* [..][MLP_BLOCK] anchors and what they have, deformed */
    float *in, *layer, *alive; /* of the opacities */
    float *centre;             /* [MLP_BLOCK * n_offsets][3] */
    float *residual;           /* [3][MLP_BLOCK] */
};

static struct parts split(const struct model *model, float *scratch)
{
    size_t global = spin_hex_scratch(&model->global), local = spin_hex_scratch(&model->local);
    size_t k = (size_t)model->n_offsets, a = (size_t)model->n_features;
    struct parts p;

    p.network = scratch;
    p.deform[ANCHOR] = scratch + (global > local ? global : local);
    p.deform[FEATURE] = p.deform[ANCHOR] + 3 * MLP_BLOCK;
    p.deform[OFFSETS] = p.deform[FEATURE] + a * MLP_BLOCK;
    p.deform[SCALING] = p.deform[OFFSETS] + 3 * k * MLP_BLOCK;
    p.in = p.deform[SCALING] + 6 * MLP_BLOCK;
    p.layer = p.in + (a + 4) * MLP_BLOCK;
    p.alive = p.layer + a * MLP_BLOCK;
    p.centre = p.alive + k * MLP_BLOCK;
    p.residual = p.centre + 3 * k * MLP_BLOCK;
    return p;
}

/* Anchors, features, offsets and scalings at the canonical time. */
static void deform_anchors(const struct job *job, size_t first, int n, struct parts *parts)
{
    const struct model *model = job->model;
    const float *from[N_HEADS] = {model->anchor, model->feature, model->offset, model->scaling};
    int width[N_HEADS] = {3, model->n_features, 3 * model->n_offsets, 6};
    const float *xyz = model->anchor + 3 * first;
    const float *h = spin_hex_hidden(&model->global, xyz, n, job->canonical, parts->network);
    float *spare = spin_hex_spare(&model->global, h, parts->network), mask[MLP_BLOCK];

    spin_hex_mask(&model->global, xyz, n, h, spare, mask);
    for (int i = 0; i < N_HEADS; i++) {
        bool any = model->head[i].first.n_in > 0;

        if (any)
            spin_hex_head(&model->head[i], h, spare, parts->deform[i]);
        for (int p = 0; p < n; p++) {
            size_t row = first + (size_t)p;
            float factor = model->scaled[i] ? model->dynamics[2 * row + (i != ANCHOR)] : 1;

            for (int c = 0; c < width[i]; c++) {
                float old = from[i][row * (size_t)width[i] + (size_t)c];
                float *to = &parts->deform[i][c * MLP_BLOCK + p];

                *to = any ? old * mask[p] + *to * factor : old;
            }
        }
    }
}

static void spawn(const struct model *model, int n, struct parts *parts)
{
    for (int p = 0; p < n; p++) {
        for (int k = 0; k < model->n_offsets; k++) {
            for (int d = 0; d < 3; d++)
                parts->centre[3 * (p * model->n_offsets + k) + d] =
                    parts->deform[ANCHOR][d * MLP_BLOCK + p] +
                    parts->deform[OFFSETS][(3 * k + d) * MLP_BLOCK + p] *
                        parts->deform[SCALING][d * MLP_BLOCK + p];
        }
    }
}

/* An offset counts when it is opaque for one of the cameras. */
static void find_alive(const struct model *model, size_t first, int n, struct parts *parts)
{
    size_t k = (size_t)model->n_offsets;
    int a = model->n_features;

    memcpy(parts->in, parts->deform[FEATURE], (size_t)a * MLP_BLOCK * sizeof(float));
    memset(parts->in + a * MLP_BLOCK, 0, 4 * MLP_BLOCK * sizeof(float));
    for (int c = 0; c < model->cameras.n; c++) {
        for (int p = 0; p < n; p++) {
            float *v = parts->in + a * MLP_BLOCK + p, norm = 0;

            for (int d = 0; d < 3; d++) {
                v[d * MLP_BLOCK] =
                    parts->deform[ANCHOR][d * MLP_BLOCK + p] - model->cameras.place[c][d];
                norm += v[d * MLP_BLOCK] * v[d * MLP_BLOCK];
            }
            norm = sqrtf(norm);
            for (int d = 0; d < 3 && norm > 0; d++)
                v[d * MLP_BLOCK] /= norm;
            v[3 * MLP_BLOCK] = norm; /* taken only where the layer is that wide */
        }
        spin_mlp_linear(&model->alive[0], parts->in, parts->layer, true);
        spin_mlp_linear(&model->alive[1], parts->layer, parts->alive, false);
        for (int p = 0; p < n; p++)
            for (size_t i = 0; i < k; i++)
                model->kept[(first + (size_t)p) * k + i] |=
                    parts->alive[i * MLP_BLOCK + (size_t)p] > 0;
    }
}

/* The second network, at the frame's own time. */
static void move_centres(const struct job *job, size_t first, int n, struct parts *parts)
{
    const struct model *model = job->model;
    float *to = job->model->centre + 3 * first * (size_t)model->n_offsets;
    int n_centres = n * model->n_offsets;

    if (model->move.first.n_in == 0) {
        memcpy(to, parts->centre, 3 * (size_t)n_centres * sizeof *to);
        return;
    }
    for (int at = 0; at < n_centres; at += MLP_BLOCK) {
        int left = n_centres - at < MLP_BLOCK ? n_centres - at : MLP_BLOCK;
        const float *xyz = parts->centre + 3 * at;
        const float *h = spin_hex_hidden(&model->local, xyz, left, job->time, parts->network);
        float *spare = spin_hex_spare(&model->local, h, parts->network), mask[MLP_BLOCK];

        spin_hex_mask(&model->local, xyz, left, h, spare, mask);
        spin_hex_head(&model->move, h, spare, parts->residual);
        for (int p = 0; p < left; p++)
            for (int d = 0; d < 3; d++)
                to[3 * (at + p) + d] =
                    xyz[3 * p + d] * mask[p] + parts->residual[d * MLP_BLOCK + p];
    }
}

static void evaluate(void *context, size_t first, int n, float *scratch)
{
    const struct job *job = context;
    struct parts parts = split(job->model, scratch);
    size_t k = (size_t)job->model->n_offsets;

    deform_anchors(job, first, n, &parts);
    spawn(job->model, n, &parts);
    for (size_t i = first * k; i < (first + (size_t)n) * k; i++)
        job->model->kept[i] = job->model->cameras.n == 0;
    if (job->model->cameras.n > 0)
        find_alive(job->model, first, n, &parts);
    move_centres(job, first, n, &parts);
}

static spin_status modecgs_frame(void *self, int frame, double time, unsigned columns,
                                 struct spin_splats *out)
{
    struct model *model = self;
    struct job job = {model, (float)time, model_folder_time(model, (float)time)};
    size_t n = 0;

    (void)frame;
    if (!isfinite(time))
        return spin_fail(SPIN_E_USAGE, "'%s' has no time %g", model->save, time);
    spin_mlp_team_run(&model->team, model->n, evaluate, &job);
    for (size_t i = 0; i < model->most; i++)
        n += model->kept[i];
    if (n == 0)
        return spin_fail(SPIN_E_UNSUPPORTED, "'%s': no offset is opaque for --camera at time %g",
                         model->save, time);
    columns &= SPIN_COL_MEANS;
    SPIN_TRY(spin_splats_reserve(out, n, columns, 0));
    n = 0;
    for (size_t i = 0; columns && i < model->most; i++) {
        if (model->kept[i])
            memcpy(out->means + 3 * n++, model->centre + 3 * i, 3 * sizeof *out->means);
    }
    return spin_model_folder_check(model->save, time, columns, out);
}

static const struct spin_plugin_option options[] = {
    {"iteration", "N", "which save to read; the last when not given", NULL},
    {"camera", "X,Y,Z[;...]", "take only what is opaque seen from one of these places", NULL},
    {NULL, NULL, NULL, NULL},
};

const struct spin_importer spin_importer_modecgs = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "modecgs",
    .summary = "MoDec-GS, positions only: the model's folder, with cfg_args and point_cloud",
    .upstream = "skwak-kaist/MoDec-GS, read from single files of its public repository",
    .options = options,
    .probe = probe,
    .open = modecgs_open,
    .frame = modecgs_frame,
    .close = modecgs_close,
};
