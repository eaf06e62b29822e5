/* E-D3DGS (Bae et al., ECCV 2024, "Per-Gaussian Embedding-Based Deformation"): a cloud of canonical
 * Gaussians, each with a learnt vector. Two networks, coarse and fine, map this vector and a vector
 * for the time to residuals of the raw attributes; positions are not an input.
 *
 * As training proceeds, it enlarges the table of time vectors and fades in the residuals, so the
 * result depends on the iteration, which only the name of the checkpoint's folder records. The
 * result also depends on some options of the training, which only cfg_args records. */
#include "importers/lib/deform.h"

#include <string.h>

#include "math/quat.h"

enum { POSITION, SCALE, ROTATION, OPACITY, COLOUR, N_HEADS };
enum { COARSE, FINE, N_STAGES };
enum { MAX_ROWS = 1 << 20 };

static const struct {
    const char *tensor;
    int width, number; /* number of floats per row, and column number for spin_model_values() */
} heads[N_HEADS] = {{"pos_deform", 3, 0},
                    {"scales_deform", 3, 2},
                    {"rotations_deform", 4, 1},
                    {"opacity_deform", 1, 3},
                    {"rgb_deform", 48, 4}};

static const char letters[N_STAGES] = {'c', 'f'}; /* the letter of each stage in tensor names */

struct stage {
    bool used;
    int rows; /* number of rows of the table of time vectors after it is resized for this stage */
    /* The first layer has the embedding as its only input; its bias contains the contribution of
     * the time. */
    struct mlp_net trunk;
    struct mlp_layer both; /* the first layer as stored; its inputs are the time vector and the
                              embedding */
    float *bias;           /* [width] bias of the trunk's first layer for the current time */
    struct mlp_net head[N_HEADS];
};

struct model {
    struct spin_model base;
    float *embedding; /* [n][n_embedding] */
    int n_embedding;
    float *table; /* [n_rows][n_time] the time vectors as stored */
    int n_rows, n_time;
    double shift; /* offset that is added to every time */
    struct stage stage[N_STAGES];
    bool used[N_HEADS];
    float weight[N_HEADS];   /* factors by which the residuals are multiplied */
    size_t layer;            /* number of floats of a block in the widest layer */
    struct settings {        /* settings of the training that affect the result */
        long long iteration; /* iteration of the checkpoint */
        double min_rows, max_rows, resized_until, deform_from;
        bool anneal, coarse_table, whole_table;
        double n_frames; /* number of frames of the clip; 0: unknown */
    } settings;
};

/* ---- Recognising ----------------------------------------------------------------------------- */

static int probe(const struct spin_peek *peek)
{
    /* peek->head is the beginning of the network file, even if the input is the folder of a
     * checkpoint. */
    if (spin_peek_contains(peek, "feature_out_c.0.weight") ||
        spin_peek_contains(peek, "feature_out_f.0.weight"))
        return 95;
    /* gaussian_embedding_dim is an option of this method. */
    return spin_peek_has(peek, "point_cloud") && spin_peek_contains(peek, "gaussian_embedding_dim=")
               ? 90
               : 0;
}

/* ---- Settings -------------------------------------------------------------------------------- */

/* Reads the iteration of the checkpoint from the name of its folder, else from option `iteration`.
 */
static spin_status read_iteration(struct spin_model *m, const char *save, long long *out)
{
    const char *wanted = spin_model_option(m, "iteration"), *whole;
    char asked[40] = "";
    long long named, said;

    SPIN_TRY(spin_model_absolute(m, &whole, save));
    named = spin_model_iteration(spin_path_name(whole));
    snprintf(asked, sizeof asked, "iteration_%s", wanted ? wanted : "");
    said = spin_model_iteration(asked);
    *out = named >= 0 ? named : said;
    if (*out < 0)
        return spin_misuse("'%s' is not called iteration_<N>, but the result depends on N: give N "
                           "with --iteration",
                           save);
    if (named >= 0 && said >= 0 && named != said)
        return spin_misuse("--iteration is %s, but '%s' is of iteration %lld", wanted, save, named);
    return SPIN_OK;
}

static bool is_count(double x) { return x >= 1 && x <= MAX_ROWS && x == floor(x); }

/* Reads the options in cfg_args that affect the result. Training writes all of its options to
 * cfg_args, so it is an error if one is missing; only total_num_frames may be missing. */
static spin_status read_settings(struct model *m)
{
    const struct cfg_args *cfg = &m->base.settings.cfg;
    struct settings *s = &m->settings;
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
            return spin_malformed("'%s' has no option '%s', which affects the result", cfg->path,
                                  key);
        SPIN_TRY(needed[i].flag ? spin_cfg_read_bool(cfg, key, needed[i].flag)
                                : spin_cfg_read_number(cfg, key, needed[i].number));
    }
    SPIN_TRY(spin_cfg_read_number(cfg, "total_num_frames", &s->n_frames));
    for (int h = 0; h < N_HEADS; h++)
        m->used[h] = !off[h];
    for (int i = 0; i < N_STAGES; i++)
        m->stage[i].used = !none[i];
    if (!is_count(s->min_rows) || !is_count(s->max_rows))
        return spin_malformed(
            "'%s': min_embeddings is %g and max_embeddings is %g, expected 1 to %d", cfg->path,
            s->min_rows, s->max_rows, MAX_ROWS);
    if (!s->whole_table && !(s->resized_until > 0))
        return spin_malformed("'%s': c2f_temporal_iter is %g, expected above 0", cfg->path,
                              s->resized_until);
    if (s->n_frames != 0 && !is_count(s->n_frames))
        return spin_malformed("'%s': total_num_frames is %g, expected a positive integer",
                              cfg->path, s->n_frames);
    return SPIN_OK;
}

/* Derives the sizes of the tables and the weights of the residuals from the iteration. */
static void derive_weights(struct model *m)
{
    const struct settings *s = &m->settings;
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

/* Checks that the trunk has no tensors besides those of `depth` layers, which are numbered 0, 2, 4,
 * ...: a further tensor would have a number after a gap, or an unknown name. */
static spin_status check_trunk(const struct spin_model *m, char letter, int depth)
{
    char stem[64];
    int n = 0;

    snprintf(stem, sizeof stem, "%sfeature_out_%c.", m->prefix, letter);
    for (size_t i = 0; i < m->tensors->n; i++) {
        const char *key = spin_value_text(m->tensors->item[2 * i]);

        n += key && strncmp(key, stem, strlen(stem)) == 0;
    }
    if (n == 2 * depth)
        return SPIN_OK;
    return spin_malformed("there are %d tensors '%s*', but only %d complete layers 0, 2, 4, ...: a "
                          "tensor is missing or unknown",
                          n, stem, depth);
}

/* Copies the trunk's first layer to s->both, and keeps in the trunk only those columns of its
 * weights that are multiplied by the embedding. */
static spin_status split_first(struct model *m, struct stage *s)
{
    struct mlp_layer *first = &s->trunk.layer[0];
    size_t n_out = (size_t)first->n_out, n = (size_t)m->n_embedding;
    float *weight;

    s->both = *first;
    SPIN_TRY(spin_model_alloc(&m->base, n_out * n, sizeof *weight, (void **)&weight));
    SPIN_TRY(spin_model_alloc(&m->base, n_out, sizeof *s->bias, (void **)&s->bias));
    for (size_t o = 0; o < n_out; o++)
        memcpy(weight + o * n, s->both.weight + o * (size_t)s->both.n_in + (size_t)m->n_time,
               n * sizeof *weight);
    first->n_in = m->n_embedding;
    first->weight = weight;
    first->bias = s->bias;
    return SPIN_OK;
}

static spin_status load_stage(struct model *m, char letter, struct stage *s)
{
    const struct mlp_layer *first = &s->trunk.layer[0];
    size_t widest;
    char stem[64], key[80];

    snprintf(stem, sizeof stem, "feature_out_%c", letter);
    snprintf(key, sizeof key, "%s.0", stem);
    SPIN_TRY(spin_model_layer(&m->base, key, -1, -1, MLP_RELU, &s->trunk));
    if (first->n_in != m->n_time + m->n_embedding)
        return spin_malformed(
            "tensor '%s%s.weight' has %d inputs, expected %d + %d: one for each "
            "column of tensor '%sweight' and each property embedding_* of the cloud",
            m->base.prefix, key, first->n_in, m->n_time, m->n_embedding, m->base.prefix);
    SPIN_TRY(spin_model_trunk(&m->base, stem, 2, first->n_out, &s->trunk));
    SPIN_TRY(check_trunk(&m->base, letter, s->trunk.n));
    for (int h = 0; h < N_HEADS; h++) {
        snprintf(key, sizeof key, "%s_%c", heads[h].tensor, letter);
        if (m->used[h])
            SPIN_TRY(spin_model_head(&m->base, key, first->n_out, heads[h].width, &s->head[h]));
    }
    SPIN_TRY(split_first(m, s));
    widest = spin_mlp_widest(&s->trunk);
    m->layer = m->layer > widest ? m->layer : widest;
    return SPIN_OK;
}

/* Loads the mean of the nonzero time offsets of training cameras; the method adds this mean to the
 * time of every view that it renders. */
static spin_status load_shift(struct model *m)
{
    static const int64_t shape[2] = {-1, 1};
    struct spin_array info;
    float *offset;
    double sum = 0;
    int n = 0;

    SPIN_TRY(spin_model_floats(&m->base, "offsets", 2, shape, &info, &offset));
    for (uint64_t i = 0; i < info.count; i++) {
        sum += offset[i];
        n += offset[i] != 0;
    }
    m->shift = n > 0 ? sum / n : 0;
    if (n > 0)
        spin_note(m->base.sequence,
                  "times are shifted by %g, the mean of the offsets of %d training cameras, as in "
                  "the method's renderer",
                  m->shift, n);
    return SPIN_OK;
}

static spin_status load_network(struct spin_model *base)
{
    /* Early files have a prefix before every key. */
    static const char *const prefixes[] = {"", "deformation_net.", "module."};
    static const char *const known[] = {"weight",         "offsets",       "feature_out_",
                                        "pos_deform",     "scales_deform", "rotations_deform",
                                        "opacity_deform", "rgb_deform",    NULL};
    static const int64_t shape[2] = {-1, -1};
    struct model *m = (struct model *)base;
    struct spin_array info;
    bool found = false;

    SPIN_TRY(spin_model_dict(base));
    for (int i = 0; i < 3 && !found; i++) {
        base->prefix = prefixes[i];
        found = spin_model_get(base, "feature_out_c.0.weight") ||
                spin_model_get(base, "feature_out_f.0.weight");
    }
    if (!found)
        return spin_malformed(
            "there is no tensor 'feature_out_c.0.weight': this is not a network of E-D3DGS");
    SPIN_TRY(spin_model_keys(base, known));
    SPIN_TRY(spin_model_floats(base, "weight", 2, shape, &info, &m->table));
    if (info.shape[0] != (uint64_t)m->settings.max_rows || info.shape[1] < 1 ||
        info.shape[1] > MLP_MAX_WIDTH)
        return spin_malformed("tensor '%sweight' has shape [%llu, %llu], expected %g rows "
                              "(max_embeddings) of 1 to %d",
                              base->prefix, (unsigned long long)info.shape[0],
                              (unsigned long long)info.shape[1], m->settings.max_rows,
                              MLP_MAX_WIDTH);
    m->n_rows = (int)info.shape[0];
    m->n_time = (int)info.shape[1];
    SPIN_TRY(load_shift(m));
    for (int i = 0; i < N_STAGES; i++) {
        if (m->stage[i].used)
            SPIN_TRY(load_stage(m, letters[i], &m->stage[i]));
    }
    return SPIN_OK;
}

/* ---- Opening --------------------------------------------------------------------------------- */

static spin_status read_cloud(const char *path, struct model *m)
{
    struct spin_gs_ply cloud;
    size_t n;

    SPIN_TRY(spin_model_cloud(&m->base, path, &cloud));
    n = (size_t)cloud.vertex->count;
    m->n_embedding = spin_model_count(cloud.vertex, "embedding_");
    if (n > 0 && (m->n_embedding == 0 || m->n_embedding > MLP_MAX_WIDTH))
        return spin_malformed("'%s' has %d properties embedding_*, expected 1 to %d", path,
                              m->n_embedding, MLP_MAX_WIDTH);
    if (n > 0 && m->used[COLOUR] && cloud.sh_degree != 3)
        return spin_unsupported("'%s' has SH of degree %d, but the network deforms SH of degree 3",
                                path, cloud.sh_degree);
    return spin_model_read(&m->base, path, "embedding_", m->n_embedding, &m->embedding);
}

static unsigned moved(const struct model *m)
{
    unsigned columns = 0;

    for (int h = 0; h < N_HEADS && (m->stage[COARSE].used || m->stage[FINE].used); h++)
        columns |= m->used[h] ? 1u << heads[h].number : 0;
    return columns;
}

static void describe(const struct model *m)
{
    struct spin_sequence_info *sequence = m->base.sequence;
    const struct settings *s = &m->settings;

    spin_model_describe(&m->base, &m->base.canonical.n, m->base.canonical.sh_degree, moved(m));
    sequence->half_open = s->n_frames == 0;
    sequence->time_last = s->n_frames > 1 ? (s->n_frames - 1) / s->n_frames : 1;
    snprintf(
        sequence->variant, sizeof sequence->variant,
        "E-D3DGS, iteration %lld, %zu Gaussians, time embeddings of %d (coarse) and %d (fine) rows",
        s->iteration, m->base.canonical.n, m->stage[COARSE].used ? m->stage[COARSE].rows : 0,
        m->stage[FINE].used ? m->stage[FINE].rows : 0);
    if (s->n_frames > 0)
        spin_note(sequence, "frame i of the run's %g frames is at time i/%g", s->n_frames,
                  s->n_frames);
    else
        spin_note(sequence,
                  "cfg_args does not contain the number of frames: frame i of n is at time i/n");
}

static spin_status open_model(void *self, const char *path)
{
    struct model *m = self;
    struct spin_model *base = self;
    const char *wanted = spin_model_option(base, "iteration"), *save, *cloud;
    const char *given = spin_model_option(base, "cfg-args");
    spin_status status;

    SPIN_TRY(spin_model_checkpoint(base, path, "deformation.pth", &save));
    if (!save)
        return spin_not_found("'%s' has no iteration_%s with point_cloud.ply and deformation.pth",
                              path, wanted ? wanted : "<N>");
    SPIN_TRY(spin_model_join(base, &base->path, save, "deformation.pth"));
    SPIN_TRY(spin_model_join(base, &cloud, save, "point_cloud.ply"));
    SPIN_TRY(read_iteration(base, save, &m->settings.iteration));
    SPIN_TRY(given ? spin_cfg_open(given, &base->settings.cfg) : spin_model_cfg(base, path, save));
    if (!base->settings.cfg.path)
        return spin_not_found("'%s' has no cfg_args, without which the network cannot be "
                              "evaluated: give it with --cfg-args",
                              path);
    SPIN_TRY(read_settings(m));
    SPIN_TRY(read_cloud(cloud, m));
    m->layer = (size_t)48 * MLP_BLOCK;
    status = spin_model_torch(base, base->path, load_network);
    SPIN_TRY(given ? spin_fail_context(status, "with --cfg-args '%s'", given) : status);
    derive_weights(m);
    describe(m);
    return spin_mlp_team_create(4 * m->layer, &base->team);
}

/* ---- The time vector ------------------------------------------------------------------------- */

/* Linear interpolation between two rows; `share` is the weight of row `high`. */
struct between {
    int low, high;
    double share;
};

static struct between between_rows(double place, int n)
{
    int low = place < n - 1 ? (int)place : n - 1;

    return (struct between){low, low + 1 < n ? low + 1 : low, place - low};
}

/* Returns value `c` of row `i` of the table of time vectors, linearly resized to n rows. */
static double resized(const struct model *m, int i, int n, int c)
{
    double place = n > 1 ? i * (double)(m->n_rows - 1) / (n - 1) : 0;
    struct between b = between_rows(place, m->n_rows);
    const float *t = m->table + c;

    return (1 - b.share) * (double)t[(size_t)b.low * (size_t)m->n_time] +
           b.share * (double)t[(size_t)b.high * (size_t)m->n_time];
}

/* Maps a time to a fractional row of a table of n rows; times outside 0 to 1 are reflected. */
static double place_of(double time, int n)
{
    double last = n - 1, place;

    if (n == 1)
        return 0;
    place = fmod(fabs(time * last), 2 * last);
    return place > last ? 2 * last - place : place;
}

/* Sets the bias of the trunk's first layer for a time. The result is the stored bias plus the
 * contribution of the time vector, which is the same for all Gaussians. */
static void set_time(const struct model *m, double time, struct stage *s)
{
    struct between b = between_rows(place_of(time + m->shift, s->rows), s->rows);

    for (int o = 0; o < s->both.n_out; o++)
        s->bias[o] = s->both.bias[o];
    for (int c = 0; c < m->n_time; c++) {
        double e = (1 - b.share) * resized(m, b.low, s->rows, c) +
                   b.share * resized(m, b.high, s->rows, c);

        for (int o = 0; o < s->both.n_out; o++)
            s->bias[o] += (float)(e * s->both.weight[(size_t)o * (size_t)s->both.n_in + (size_t)c]);
    }
}

/* ---- Evaluating ------------------------------------------------------------------------------ */

/* Adds the residuals of a stage to the Gaussians `first` to `first` + n - 1. `scratch` has 4 *
 * m->layer floats. */
static void add_stage(const struct deform_job *job, const struct stage *s, size_t first, int n,
                      float *scratch)
{
    const struct model *m = job->model;
    float *in = scratch, *a = in + m->layer, *b = a + m->layer, *residual = b + m->layer, *hidden;

    for (int p = 0; p < MLP_BLOCK; p++) {
        size_t i = first + (size_t)(p < n ? p : n - 1);

        for (int c = 0; c < m->n_embedding; c++)
            in[c * MLP_BLOCK + p] = m->embedding[i * (size_t)m->n_embedding + (size_t)c];
    }
    hidden = spin_mlp_run(&s->trunk, in, a, b);
    for (int h = 0; h < N_HEADS; h++) {
        size_t width;
        float *out = spin_model_values(job->out, heads[h].number, &width);

        if (!m->used[h] || !(job->columns & 1u << heads[h].number))
            continue;
        spin_mlp_run(&s->head[h], hidden, hidden == a ? b : a, residual);
        for (size_t p = 0; p < (size_t)n; p++) {
            for (size_t c = 0; c < width; c++)
                out[(first + p) * width + c] += m->weight[h] * residual[c * MLP_BLOCK + p];
        }
    }
}

static void evaluate(void *context, size_t first, int n, float *scratch)
{
    const struct deform_job *job = context;
    const struct model *m = job->model;

    for (int h = 0; h < N_HEADS; h++) {
        size_t width;
        const float *from = spin_model_values(job->from, heads[h].number, &width);

        if (m->used[h] && job->columns & 1u << heads[h].number)
            memcpy(spin_model_values(job->out, heads[h].number, &width) + first * width,
                   from + first * width, (size_t)n * width * sizeof *from);
    }
    for (int i = 0; i < N_STAGES; i++) {
        if (m->stage[i].used)
            add_stage(job, &m->stage[i], first, n, scratch);
    }
    for (size_t i = first;
         m->used[ROTATION] && job->columns & SPIN_COL_QUATS && i < first + (size_t)n; i++)
        spin_quat_normalise(job->out->quats + 4 * i);
}

static spin_status ed3dgs_frame(void *self, int frame, double time, unsigned columns,
                                struct spin_splats *out)
{
    struct model *m = self;

    (void)frame;
    for (int i = 0; i < N_STAGES; i++) {
        if (m->stage[i].used && isfinite(time))
            set_time(m, time, &m->stage[i]);
    }
    return spin_deform_frame(&m->base, time, columns, moved(m), evaluate, out);
}

static const struct spin_plugin_option options[] = {
    {"iteration", "N",
     "the checkpoint to read (default: the last), or the iteration of a checkpoint whose folder "
     "has another name",
     NULL},
    {"cfg-args", "FILE", "the cfg_args of the run, if there is none beside the model", NULL},
    {NULL, NULL, NULL, NULL},
};

SPIN_MODEL_IMPORTER(
    ed3dgs, struct model, open_model, spin_model_close,
    .summary = "E-D3DGS: the model's folder, with cfg_args and point_cloud/iteration_<N>",
    .upstream = "JeongminB/E-D3DGS a68543e", .options = options, .probe = probe,
    .frame = ed3dgs_frame)
