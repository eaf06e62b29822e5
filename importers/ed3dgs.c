/* E-D3DGS (Bae et al., ECCV 2024, "Per-Gaussian Embedding-Based Deformation"): a cloud of canonical Gaussians,
 * each with a learnt vector. Two networks, coarse and fine, turn that vector and one of the time into
 * residuals of the raw attributes; positions are no input.
 *
 * The vector of a time is looked up in a table that training resizes and residuals are weighed in, both by the
 * iteration: the number in the name of a save is part of the model. So are some options of the run, which
 * only cfg_args tells. */
#include "spin.h"
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "importers/lib/mlp_eval.h"
#include "importers/lib/model_folder.h"
#include "importers/lib/notes.h"
#include "math/quat.h"

enum { POSITION, SCALE, ROTATION, OPACITY, COLOUR, N_HEADS };
enum { COARSE, FINE, N_STAGES };
enum { MAX_DEPTH = 32, MAX_ROWS = 1 << 20 };

static const struct {
    const char *tensor;
    int width;
    unsigned column;
} heads[N_HEADS] = {
    {"pos_deform", 3, SPIN_COL_MEANS},       {"scales_deform", 3, SPIN_COL_LOG_SCALES},
    {"rotations_deform", 4, SPIN_COL_QUATS}, {"opacity_deform", 1, SPIN_COL_LOGIT_OPACITIES},
    {"rgb_deform", 48, SPIN_COL_SH},
};

static const char letters[N_STAGES] = {'c', 'f'}; /* in the names of a stage's tensors */

struct head {
    struct mlp_linear first, last;
};

struct stage {
    bool used;
    int rows;                    /* of the table when it is resized for this stage */
    struct mlp_linear both;      /* first layer, of [time, embedding] */
    struct mlp_linear embedding; /* its part of the embedding; the bias holds that of a time */
    struct mlp_linear layer[MAX_DEPTH];
    int depth; /* layers after the first */
    struct head head[N_HEADS];
};

struct model {
    char *path; /* of deformation.pth */
    size_t n;
    struct spin_splats canonical;
    float *embedding; /* [n][n_embedding] */
    int n_embedding;
    float *table; /* [n_rows][n_time] */
    int n_rows, n_time;
    double shift; /* added to every time */
    struct stage stage[N_STAGES];
    bool used[N_HEADS];
    float weight[N_HEADS]; /* of residuals */
    size_t layer;          /* floats of the widest layer of a block */
    struct mlp_team team;
};

/* What cfg_args says. */
struct settings {
    long long iteration; /* of the save */
    double min_rows, max_rows, resized_until, deform_from;
    bool anneal, coarse_table, whole_table;
    double n_frames; /* 0: not said */
};

/* ---- Recognising ----------------------------------------------------------------------------- */

static bool in_head(const struct spin_peek *peek, const char *word)
{
    return memmem(peek->head, peek->n_head, word, strlen(word)) != NULL;
}

static int probe(const struct spin_peek *peek)
{
    bool cloud = false;

    /* The network, alone or in the folder of a save. */
    if (in_head(peek, "feature_out_c.0.weight") || in_head(peek, "feature_out_f.0.weight"))
        return 95;
    for (size_t i = 0; peek->is_folder && peek->names && peek->names[i]; i++)
        cloud = cloud || strcmp(peek->names[i], "point_cloud") == 0;
    return cloud && in_head(peek, "gaussian_embedding_dim=") ? 90 : 0; /* options of the method */
}

/* ---- Settings -------------------------------------------------------------------------------- */

/* The iteration of the save, from the folder's name or else as the user says. */
static spin_status read_iteration(const char *save, const char *wanted, long long *out)
{
    char asked[40] = "", *whole = NULL;
    long long named, said;

    SPIN_TRY(spin_path_absolute(save, &whole));
    named = spin_model_folder_iteration(spin_path_name(whole));
    free(whole);
    snprintf(asked, sizeof asked, "iteration_%s", wanted ? wanted : "");
    said = spin_model_folder_iteration(asked);
    *out = named >= 0 ? named : said;
    if (*out < 0)
        return spin_fail(
            SPIN_E_USAGE,
            "'%s' is not called iteration_<N>, and the model depends on N: say it with "
            "--iteration",
            save);
    if (named >= 0 && said >= 0 && named != said)
        return spin_fail(SPIN_E_USAGE, "--iteration %s, but '%s' is of iteration %lld", wanted,
                         save, named);
    return SPIN_OK;
}

static bool is_count(double x) { return x >= 1 && x <= MAX_ROWS && x == floor(x); }

/* Training writes all options, and each of these changes the result. */
static spin_status read_settings(const struct cfg_args *cfg, struct model *m, struct settings *s)
{
    bool off[N_HEADS] = {false}, none[N_STAGES] = {false};
    const struct {
        const char *key;
        double *number;
        bool *flag;
    } needed[] = {
        {"min_embeddings", &s->min_rows, NULL},
        {"max_embeddings", &s->max_rows, NULL},
        {"c2f_temporal_iter", &s->resized_until, NULL},
        {"deform_from_iter", &s->deform_from, NULL},
        {"use_anneal", NULL, &s->anneal},
        {"use_coarse_temporal_embedding", NULL, &s->coarse_table},
        {"no_c2f_temporal_embedding", NULL, &s->whole_table},
        {"no_coarse_deform", NULL, &none[COARSE]},
        {"no_fine_deform", NULL, &none[FINE]},
        {"no_ds", NULL, &off[SCALE]},
        {"no_dr", NULL, &off[ROTATION]},
        {"no_do", NULL, &off[OPACITY]},
        {"no_dc", NULL, &off[COLOUR]},
    };

    for (size_t i = 0; i < sizeof needed / sizeof *needed; i++) {
        const char *key = needed[i].key;

        if (!spin_cfg_get(cfg, key).at)
            return spin_fail(SPIN_E_MALFORMED, "'%s' has no '%s', which changes the result",
                             cfg->path, key);
        SPIN_TRY(needed[i].flag ? spin_cfg_read_bool(cfg, key, needed[i].flag)
                                : spin_cfg_read_number(cfg, key, needed[i].number));
    }
    SPIN_TRY(spin_cfg_read_number(cfg, "total_num_frames", &s->n_frames));
    for (int h = 0; h < N_HEADS; h++)
        m->used[h] = !off[h];
    for (int i = 0; i < N_STAGES; i++)
        m->stage[i].used = !none[i];
    if (!is_count(s->min_rows) || !is_count(s->max_rows))
        return spin_fail(SPIN_E_MALFORMED,
                         "'%s': min_embeddings %g and max_embeddings %g, expected 1 to %d",
                         cfg->path, s->min_rows, s->max_rows, MAX_ROWS);
    if (!s->whole_table && !(s->resized_until > 0))
        return spin_fail(SPIN_E_MALFORMED, "'%s': c2f_temporal_iter is %g, expected above 0",
                         cfg->path, s->resized_until);
    if (s->n_frames != 0 && !is_count(s->n_frames))
        return spin_fail(SPIN_E_MALFORMED,
                         "'%s': total_num_frames is %g, expected a number of frames", cfg->path,
                         s->n_frames);
    return SPIN_OK;
}

/* What the iteration makes of them: rows of the table and weights of the residuals. */
static void settle(const struct settings *s, struct model *m)
{
    double at = (double)s->iteration, rows = s->max_rows;
    double a = s->anneal ? fmin(at / 1000, 1) : 1;
    double b = s->anneal ? fmin(fmax((at - s->deform_from) / 1000, 0), 1) : 1;
    const double weight[N_HEADS] = {a, a * b, a, a * b, b};

    if (!s->whole_table)
        rows = floor(s->min_rows +
                     (s->max_rows - s->min_rows) * fmin(at, s->resized_until) / s->resized_until);
    m->stage[FINE].rows = (int)rows;
    m->stage[COARSE].rows = s->coarse_table ? (int)s->min_rows : (int)rows;
    for (int h = 0; h < N_HEADS; h++)
        m->weight[h] = (float)weight[h];
}

/* ---- The network ----------------------------------------------------------------------------- */

/* Early files have a word before every key. NULL when this is no such network. */
static const char *find_prefix(const struct spin_value *root)
{
    static const char *const known[] = {"", "deformation_net.", "module."};

    for (size_t i = 0; i < sizeof known / sizeof *known; i++) {
        if (spin_mlp_has(root, known[i], "feature_out_c.0") ||
            spin_mlp_has(root, known[i], "feature_out_f.0"))
            return known[i];
    }
    return NULL;
}

static spin_status load_head(struct spin_torch *torch, const char *prefix, const char *name,
                             int width, int n_out, struct head *out)
{
    char key[80];

    snprintf(key, sizeof key, "%s.1", name);
    SPIN_TRY(spin_mlp_load(torch, torch->root, prefix, key, width, width, &out->first));
    snprintf(key, sizeof key, "%s.3", name);
    return spin_mlp_load(torch, torch->root, prefix, key, width, n_out, &out->last);
}

/* Layers of the trunk are numbered 0, 2, 4 and so on: as many as there are names of them. */
static spin_status check_trunk(const struct spin_value *root, const char *prefix, char letter,
                               int depth)
{
    char stem[64];
    int n = 0;

    snprintf(stem, sizeof stem, "%sfeature_out_%c.", prefix, letter);
    for (size_t i = 0; i < root->n; i++) {
        const char *key = spin_value_text(root->item[2 * i]);

        n += key && strncmp(key, stem, strlen(stem)) == 0;
    }
    if (n == 2 * (1 + depth))
        return SPIN_OK;
    return spin_fail(SPIN_E_MALFORMED,
                     "%d tensors '%s*', of which 0, 2, 4, ... make %d layers: one is missing or "
                     "there are unknown ones",
                     n, stem, 1 + depth);
}

/* Methods built on this one may add to its network, which would change the result. */
static spin_status check_keys(const struct spin_value *root, const char *prefix)
{
    for (size_t i = 0; i < root->n; i++) {
        const char *key = spin_value_text(root->item[2 * i]);
        bool known = false;

        if (key && strncmp(key, prefix, strlen(prefix)) == 0) {
            const char *name = key + strlen(prefix);

            known = strcmp(name, "weight") == 0 || strcmp(name, "offsets") == 0 ||
                    strncmp(name, "feature_out_", 12) == 0;
            for (int h = 0; h < N_HEADS; h++)
                known = known || strncmp(name, heads[h].tensor, strlen(heads[h].tensor)) == 0;
        }
        if (!known)
            return spin_fail(SPIN_E_UNSUPPORTED,
                             "tensor '%.80s' does not belong to this method: the run may be of one "
                             "derived from it",
                             key ? key : "");
    }
    return SPIN_OK;
}

/* The columns of the first layer that the embedding goes into. */
static spin_status split_first(const struct model *m, struct stage *s)
{
    size_t n_out = (size_t)s->both.n_out, n = (size_t)m->n_embedding;

    SPIN_TRY(spin_alloc(n_out * n, sizeof(float), (void **)&s->embedding.weight));
    SPIN_TRY(spin_alloc(n_out, sizeof(float), (void **)&s->embedding.bias));
    s->embedding.n_in = m->n_embedding;
    s->embedding.n_out = s->both.n_out;
    for (size_t o = 0; o < n_out; o++)
        memcpy(s->embedding.weight + o * n,
               s->both.weight + o * (size_t)s->both.n_in + (size_t)m->n_time, n * sizeof(float));
    return SPIN_OK;
}

static spin_status load_stage(struct spin_torch *torch, const char *prefix, char letter,
                              struct model *m, struct stage *s)
{
    char key[64];
    int width;

    snprintf(key, sizeof key, "feature_out_%c.0", letter);
    SPIN_TRY(spin_mlp_load(torch, torch->root, prefix, key, -1, -1, &s->both));
    if (s->both.n_in != m->n_time + m->n_embedding)
        return spin_fail(
            SPIN_E_MALFORMED,
            "tensor '%s%s.weight' takes %d inputs, but 'weight' has %d columns and the "
            "cloud %d properties embedding_*",
            prefix, key, s->both.n_in, m->n_time, m->n_embedding);
    width = s->both.n_out;
    for (; s->depth < MAX_DEPTH; s->depth++) {
        snprintf(key, sizeof key, "feature_out_%c.%d", letter, 2 * (s->depth + 1));
        if (!spin_mlp_has(torch->root, prefix, key))
            break;
        SPIN_TRY(spin_mlp_load(torch, torch->root, prefix, key, width, width, &s->layer[s->depth]));
    }
    SPIN_TRY(check_trunk(torch->root, prefix, letter, s->depth));
    for (int h = 0; h < N_HEADS; h++) {
        snprintf(key, sizeof key, "%s_%c", heads[h].tensor, letter);
        if (m->used[h])
            SPIN_TRY(load_head(torch, prefix, key, width, heads[h].width, &s->head[h]));
    }
    if (m->layer < (size_t)width * MLP_BLOCK)
        m->layer = (size_t)width * MLP_BLOCK;
    return split_first(m, s);
}

/* The mean of those time offsets of training cameras that are not 0: what the method adds to the time of every
 * view that it draws. */
static spin_status load_shift(struct spin_torch *torch, const char *prefix, struct model *m,
                              struct spin_sequence_info *sequence)
{
    static const int64_t shape[2] = {-1, 1};
    struct spin_array info;
    float *offset = NULL;
    double sum = 0;
    int n = 0;

    SPIN_TRY(spin_mlp_floats(torch, torch->root, prefix, "offsets", 2, shape, &info, &offset));
    for (uint64_t i = 0; i < info.count; i++) {
        sum += offset[i];
        n += offset[i] != 0;
    }
    free(offset);
    m->shift = n > 0 ? sum / n : 0;
    if (n > 0)
        spin_note(sequence,
                  "times are shifted by %g, the mean of the offsets of %d training cameras, as the "
                  "method draws them",
                  m->shift, n);
    return SPIN_OK;
}

static spin_status load_network(struct spin_torch *torch, const struct settings *s, struct model *m,
                                struct spin_sequence_info *sequence)
{
    static const int64_t shape[2] = {-1, -1};
    const struct spin_value *root = torch->root;
    struct spin_array info;
    const char *prefix;

    if (!root || root->kind != SPIN_VALUE_DICT)
        return spin_fail(SPIN_E_MALFORMED, "what was saved is not a state dict");
    prefix = find_prefix(root);
    if (!prefix)
        return spin_fail(SPIN_E_MALFORMED, "no tensor 'feature_out_c.0.weight', which E-D3DGS has");
    SPIN_TRY(check_keys(root, prefix));
    SPIN_TRY(spin_mlp_floats(torch, root, prefix, "weight", 2, shape, &info, &m->table));
    if (info.shape[0] != (uint64_t)s->max_rows || info.shape[1] < 1 ||
        info.shape[1] > MLP_MAX_WIDTH)
        return spin_fail(
            SPIN_E_MALFORMED,
            "tensor '%sweight' has shape [%llu, %llu], expected %g rows (max_embeddings) "
            "of 1 to %d",
            prefix, (unsigned long long)info.shape[0], (unsigned long long)info.shape[1],
            s->max_rows, MLP_MAX_WIDTH);
    m->n_rows = (int)info.shape[0];
    m->n_time = (int)info.shape[1];
    SPIN_TRY(load_shift(torch, prefix, m, sequence));
    for (int i = 0; i < N_STAGES; i++) {
        if (m->stage[i].used)
            SPIN_TRY(load_stage(torch, prefix, letters[i], m, &m->stage[i]));
    }
    return SPIN_OK;
}

static spin_status open_network(const struct settings *s, struct model *m,
                                struct spin_sequence_info *sequence)
{
    struct spin_torch torch;
    spin_status status;

    memset(&torch, 0, sizeof torch);
    status = spin_torch_open(m->path, &torch);
    if (status == SPIN_OK)
        status = load_network(&torch, s, m, sequence);
    spin_torch_close(&torch);
    return spin_fail_reading(status, m->path);
}

/* ---- The cloud ------------------------------------------------------------------------------- */

static spin_status read_cloud(const char *path, struct model *m)
{
    const unsigned columns = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    struct spin_gs_ply cloud;
    struct spin_ply ply;
    spin_status status;

    SPIN_TRY(spin_model_folder_cloud(path, &ply, &cloud));
    m->n = (size_t)cloud.vertex->count;
    m->n_embedding = spin_model_folder_count(cloud.vertex, "embedding_");
    if (m->n == 0)
        SPIN_TRY_OUT(spin_fail(SPIN_E_MALFORMED, "'%s': 0 vertices", path));
    if (m->n_embedding == 0 || m->n_embedding > MLP_MAX_WIDTH)
        SPIN_TRY_OUT(spin_fail(SPIN_E_MALFORMED,
                               "'%s': %d properties embedding_*, expected 1 to %d", path,
                               m->n_embedding, MLP_MAX_WIDTH));
    if (m->used[COLOUR] && cloud.sh_degree != 3)
        SPIN_TRY_OUT(spin_fail(SPIN_E_UNSUPPORTED,
                               "'%s': SH of degree %d, but the network deforms SH of degree 3",
                               path, cloud.sh_degree));
    SPIN_TRY_OUT(spin_splats_reserve(&m->canonical, m->n, columns, cloud.sh_degree));
    SPIN_TRY_OUT(spin_gs_ply_read(&cloud, columns, 0, &m->canonical));
    SPIN_TRY_OUT(
        spin_alloc(m->n, (size_t)m->n_embedding * sizeof *m->embedding, (void **)&m->embedding));
    SPIN_TRY_OUT(spin_model_folder_columns(&ply, cloud.vertex, "embedding_", m->n_embedding,
                                           m->embedding, (size_t)m->n_embedding));
out:
    spin_ply_close(&ply);
    return status;
}

/* ---- Opening --------------------------------------------------------------------------------- */

static void describe(const struct settings *s, struct model *m, struct spin_sequence_info *sequence)
{
    bool moves = m->stage[COARSE].used || m->stage[FINE].used;

    sequence->n_frames = 1;
    sequence->identity = true;
    sequence->counts = &m->n;
    sequence->columns = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    sequence->sh_degree = m->canonical.sh_degree;
    sequence->continuous = true;
    sequence->half_open = s->n_frames == 0;
    sequence->time_last = s->n_frames > 1 ? (s->n_frames - 1) / s->n_frames : 1;
    for (int h = 0; h < N_HEADS; h++) {
        if (!m->used[h] || !moves)
            sequence->static_columns |= heads[h].column;
    }
    snprintf(sequence->variant, sizeof sequence->variant,
             "E-D3DGS, iteration %lld, %zu Gaussians, %d and %d rows of time", s->iteration, m->n,
             m->stage[COARSE].used ? m->stage[COARSE].rows : 0,
             m->stage[FINE].used ? m->stage[FINE].rows : 0);
    if (s->n_frames > 0)
        spin_note(sequence, "frame i of the run's %g is at time i/%g", s->n_frames, s->n_frames);
    else
        spin_note(sequence, "cfg_args does not say how many frames the run has: frame i of n is at "
                            "time i/n");
}

/* cfg_args as the user names it, or beside the save. */
static spin_status open_settings(const char *path, const char *save, const char *given,
                                 struct cfg_args *cfg)
{
    if (given)
        return spin_cfg_open(given, cfg);
    SPIN_TRY(spin_model_folder_cfg(path, save, cfg));
    if (!cfg->path)
        return spin_fail(SPIN_E_NOT_FOUND,
                         "'%s' has no cfg_args, without which the network cannot be evaluated: say "
                         "where it is with --cfg-args",
                         path);
    return SPIN_OK;
}

static spin_status open_model(const char *path, const struct spin_plugin_values *values,
                              struct model *m, struct spin_sequence_info *sequence)
{
    const char *wanted = spin_plugin_value(values, "iteration", NULL);
    struct settings settings = {0};
    struct cfg_args cfg = {0};
    char *save = NULL, *cloud = NULL;
    spin_status status;

    SPIN_TRY_OUT(spin_model_folder_save(path, wanted, "deformation.pth", &save));
    if (!save)
        SPIN_TRY_OUT(spin_fail(SPIN_E_NOT_FOUND,
                               "'%s' has no iteration_%s with point_cloud.ply and deformation.pth",
                               path, wanted ? wanted : "<N>"));
    SPIN_TRY_OUT(spin_path_join(save, "deformation.pth", &m->path));
    SPIN_TRY_OUT(spin_path_join(save, "point_cloud.ply", &cloud));
    SPIN_TRY_OUT(read_iteration(save, wanted, &settings.iteration));
    SPIN_TRY_OUT(open_settings(path, save, spin_plugin_value(values, "cfg-args", NULL), &cfg));
    SPIN_TRY_OUT(read_settings(&cfg, m, &settings));
    SPIN_TRY_OUT(read_cloud(cloud, m));
    m->layer = (size_t)(m->n_embedding > 48 ? m->n_embedding : 48) * MLP_BLOCK;
    SPIN_TRY_OUT(open_network(&settings, m, sequence));
    settle(&settings, m);
    describe(&settings, m, sequence);
    status = spin_mlp_team_create(4 * m->layer, &m->team);
out:
    spin_cfg_close(&cfg);
    free(save);
    free(cloud);
    return status;
}

static spin_status ed3dgs_open(const char *path, const struct spin_plugin_values *values,
                               void **self, struct spin_sequence_info *sequence)
{
    *sequence = (struct spin_sequence_info){.sh_degree = -1};
    SPIN_TRY(spin_alloc(1, sizeof(struct model), self));
    return open_model(path, values, *self, sequence);
}

static void stage_free(struct stage *s)
{
    spin_mlp_free(&s->both);
    spin_mlp_free(&s->embedding);
    for (int i = 0; i < MAX_DEPTH; i++)
        spin_mlp_free(&s->layer[i]);
    for (int h = 0; h < N_HEADS; h++) {
        spin_mlp_free(&s->head[h].first);
        spin_mlp_free(&s->head[h].last);
    }
}

static void ed3dgs_close(void *self)
{
    struct model *m = self;

    if (!m)
        return;
    for (int i = 0; i < N_STAGES; i++)
        stage_free(&m->stage[i]);
    spin_mlp_team_free(&m->team);
    spin_splats_free(&m->canonical);
    free(m->embedding);
    free(m->table);
    free(m->path);
    free(m);
}

/* ---- The vector of a time -------------------------------------------------------------------- */

/* Between which two of n rows a place lies, and the second one's share. */
struct between {
    int low, high;
    double share;
};

static struct between between_rows(double place, int n)
{
    int low = place < n - 1 ? (int)place : n - 1;

    return (struct between){low, low + 1 < n ? low + 1 : low, place - low};
}

/* Value `c` of row `i` of the table when it is resized to n rows. */
static double resized(const struct model *m, int i, int n, int c)
{
    double place = n > 1 ? i * (double)(m->n_rows - 1) / (n - 1) : 0;
    struct between b = between_rows(place, m->n_rows);
    const float *t = m->table + c;

    return (1 - b.share) * (double)t[(size_t)b.low * (size_t)m->n_time] +
           b.share * (double)t[(size_t)b.high * (size_t)m->n_time];
}

/* The place of a time among n rows, reflected at both ends. */
static double place_of(double time, int n)
{
    double last = n - 1, place;

    if (n == 1)
        return 0;
    place = fmod(fabs(time * last), 2 * last);
    return place > last ? 2 * last - place : place;
}

/* The first layer's bias with what it makes of the time, the same for all Gaussians. */
static void set_time(const struct model *m, double time, struct stage *s)
{
    struct between b = between_rows(place_of(time + m->shift, s->rows), s->rows);

    for (int o = 0; o < s->both.n_out; o++)
        s->embedding.bias[o] = s->both.bias[o];
    for (int c = 0; c < m->n_time; c++) {
        double e = (1 - b.share) * resized(m, b.low, s->rows, c) +
                   b.share * resized(m, b.high, s->rows, c);

        for (int o = 0; o < s->both.n_out; o++)
            s->embedding.bias[o] +=
                (float)(e * s->both.weight[(size_t)o * (size_t)s->both.n_in + (size_t)c]);
    }
}

/* ---- Evaluating ------------------------------------------------------------------------------ */

struct job {
    const struct model *model;
    struct spin_splats *out;
    unsigned columns;
};

static float *column_of(struct spin_splats *s, int head)
{
    float *const all[N_HEADS] = {s->means, s->log_scales, s->quats, s->logit_opacities, s->sh};

    return all[head];
}

/* A stage's residuals of n Gaussians, added to what is there. Four layers of scratch. */
static void add_stage(const struct job *job, const struct stage *s, size_t first, int n,
                      float *scratch)
{
    const struct model *m = job->model;
    float *in = scratch, *hidden = in + m->layer, *spare = hidden + m->layer;
    float *residual = spare + m->layer;

    for (int p = 0; p < MLP_BLOCK; p++) {
        size_t i = first + (size_t)(p < n ? p : n - 1);

        for (int c = 0; c < m->n_embedding; c++)
            in[c * MLP_BLOCK + p] = m->embedding[i * (size_t)m->n_embedding + (size_t)c];
    }
    spin_mlp_linear(&s->embedding, in, hidden, true);
    for (int i = 0; i < s->depth; i++) {
        float *t = hidden;

        spin_mlp_linear(&s->layer[i], hidden, spare, true);
        hidden = spare;
        spare = t;
    }
    for (int h = 0; h < N_HEADS; h++) {
        size_t width = (size_t)heads[h].width;
        float *out = column_of(job->out, h);

        if (!m->used[h] || !(job->columns & heads[h].column))
            continue;
        spin_mlp_linear(&s->head[h].first, hidden, spare, true);
        spin_mlp_linear(&s->head[h].last, spare, residual, false);
        for (size_t p = 0; p < (size_t)n; p++) {
            for (size_t c = 0; c < width; c++)
                out[(first + p) * width + c] += m->weight[h] * residual[c * MLP_BLOCK + p];
        }
    }
}

static void evaluate(void *context, size_t first, int n, float *scratch)
{
    const struct job *job = context;

    for (int i = 0; i < N_STAGES; i++) {
        if (job->model->stage[i].used)
            add_stage(job, &job->model->stage[i], first, n, scratch);
    }
}

static void copy_canonical(struct model *m, unsigned columns, struct spin_splats *out)
{
    size_t n_sh = 3 * (size_t)((m->canonical.sh_degree + 1) * (m->canonical.sh_degree + 1));

    for (int h = 0; h < N_HEADS; h++) {
        size_t width = h == COLOUR ? n_sh : (size_t)heads[h].width;

        if (columns & heads[h].column)
            memcpy(column_of(out, h), column_of(&m->canonical, h), width * m->n * sizeof(float));
    }
}

static spin_status ed3dgs_frame(void *self, int frame, double time, unsigned columns,
                                struct spin_splats *out)
{
    struct model *m = self;
    struct job job = {m, out, columns & (SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES)};
    unsigned moving = 0;

    (void)frame;
    if (!isfinite(time))
        return spin_fail(SPIN_E_USAGE, "'%s' has no time %g", m->path, time);
    SPIN_TRY(spin_splats_reserve(out, m->n, job.columns, m->canonical.sh_degree));
    copy_canonical(m, job.columns, out);
    for (int i = 0; i < N_STAGES; i++) {
        if (m->stage[i].used)
            set_time(m, time, &m->stage[i]);
    }
    for (int h = 0; h < N_HEADS; h++)
        moving |= m->used[h] ? heads[h].column : 0;
    if (moving & job.columns)
        spin_mlp_team_run(&m->team, m->n, evaluate, &job);
    for (size_t i = 0; i < m->n && job.columns & SPIN_COL_QUATS; i++)
        spin_quat_normalise(out->quats + 4 * i);
    return spin_model_folder_check(m->path, time, job.columns, out);
}

static const struct spin_plugin_option options[] = {
    {"iteration", "N",
     "which save to read, the last when not given; of a save by itself, its number when its "
     "folder's "
     "name does not say",
     NULL},
    {"cfg-args", "FILE", "the options of the run, where none lie beside the model", NULL},
    {NULL, NULL, NULL, NULL},
};

const struct spin_importer spin_importer_ed3dgs = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "ed3dgs",
    .summary = "E-D3DGS: the model's folder, with cfg_args and point_cloud/iteration_<N>",
    .upstream = "JeongminB/E-D3DGS a68543e",
    .options = options,
    .probe = probe,
    .open = ed3dgs_open,
    .frame = ed3dgs_frame,
    .close = ed3dgs_close,
};
