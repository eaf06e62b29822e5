/* Gaussian-Flow (Lin et al., CVPR 2024): chkpnt<N>.pth of its implementation in pointrix. Position,
 * quaternion and degree 0 of the SH of each Gaussian are a base value plus a polynomial and a
 * Fourier series in u, the time on an axis of the Gaussian's own. Scale, opacity and the other SH
 * are static.
 *
 * Peculiarities:
 * - The method scales and shifts times. Both numbers are options of the training, which are not in
 * the checkpoint but in the YAML file of the training.
 * - Only the first three orders of a series are evaluated, and their sum is always divided by 3,
 * whatever the number of orders in the checkpoint.
 * - Quaternions of a frame are normalised along the wrong axis: each of their four components is
 * divided by its norm over all Gaussians. The rasteriser does not normalise them, so it draws other
 * ellipsoids than for unit quaternions, which are almost aligned to the axes if there are many
 * Gaussians. The importer computes the covariance in the same way and decomposes it again. */
#include "importers/lib/chkpnt.h"
#include "importers/lib/deform.h"
#include "math/covariance.h"
#include "math/sh.h"

enum { ORDERS = 3, BASIS = 3 * ORDERS, MOST_ORDERS = 64 };

enum { POSITION, ROTATION, FEATURES, N_SERIES };

static const struct {
    const char *key, *setting; /* tensor; number of orders in the YAML file */
    int width;
} series[N_SERIES] = {{"pos_params", "pos_traj_dim", 3},
                      {"rot_params", "rot_traj_dim", 4},
                      {"feat_params", "feat_traj_dim", 3}};

#define MOVED (DEFORM_MOVED | (unsigned)SPIN_COL_SH)

struct timing {
    double scale, shift; /* u is the time times `scale`, plus `shift`, minus the centre */
    bool half_open;      /* frame i of n is at i/n */
    const char *path;    /* the YAML file that contains these settings; NULL: there is none */
};

struct model {
    struct spin_model base;
    struct timing timing;
    float *factor[N_SERIES]; /* [n][n_orders][width][3] factors of powers, sines and cosines */
    int n_orders[N_SERIES];
    float *centre; /* [n] time centres */
    /* The frame that is being evaluated. */
    float time;     /* scaled and shifted */
    float *quats;   /* [n][4] quaternions before normalisation */
    double norm[4]; /* norm of each component of `quats` over all Gaussians */
};

/* ---- Recognising ----------------------------------------------------------------------------- */

static int probe(const struct spin_peek *peek)
{
    return spin_peek_contains(peek, "pos_params") && spin_peek_contains(peek, "rot_params") &&
                   spin_peek_contains(peek, "time_center")
               ? 100
               : 0;
}

/* ---- The checkpoint -------------------------------------------------------------------------- */

/* Refuses a point cloud with attributes that Gaussian-Flow does not define. */
static spin_status check_keys(const struct spin_model *base)
{
    static const char *const known[] = {"position",    "features",   "features_rest", "scaling",
                                        "rotation",    "opacity",    "pos_params",    "rot_params",
                                        "feat_params", "time_center"};
    size_t n = strlen(base->prefix);

    for (size_t i = 0; i < base->tensors->n; i++) {
        const char *key = spin_value_text(base->tensors->item[2 * i]);
        bool found = !key || strncmp(key, base->prefix, n) != 0;

        for (size_t k = 0; !found && k < sizeof known / sizeof *known; k++)
            found = strcmp(key + n, known[k]) == 0;
        if (!found)
            return spin_unsupported("tensor '%.80s' does not belong to Gaussian-Flow: the run may "
                                    "be of a derived method",
                                    key);
    }
    return SPIN_OK;
}

/* Finds the state dict: that of the model in the checkpoints that a training saves while it runs,
 * and that of the point cloud in the one that the hook saves at the end. */
static spin_status find_tensors(struct spin_model *base)
{
    const struct spin_value *root = base->torch.root, *all = spin_value_get(root, "model");

    base->prefix = all ? "point_cloud." : "";
    all = all ? all : spin_value_get(root, "point_cloud");
    if (!all || all->kind != SPIN_VALUE_DICT)
        return spin_malformed("the file contains %s without the state dict 'model' or "
                              "'point_cloud' of Gaussian-Flow",
                              spin_chkpnt_kind(root));
    base->tensors = all;
    return check_keys(base);
}

/* Reads the first `width` numbers of each row of a tensor to out[i * step] for row i. */
static spin_status read_rows(struct spin_model *base, const char *key, int n_dims,
                             const int64_t *shape, size_t width, float *out, size_t step)
{
    const struct spin_value *v = spin_model_get(base, "%s", key);
    struct spin_array t;
    size_t bad = 0, all;
    char name[64];

    snprintf(name, sizeof name, "%s%s", base->prefix, key);
    if (!v)
        return spin_malformed("there is no tensor '%s'", name);
    SPIN_TRY(spin_chkpnt_bind(&base->torch, v, name, n_dims, shape, &t));
    all = (size_t)(t.count / t.shape[0]);
    for (size_t i = 0; i < t.shape[0] && width > 0; i++) {
        spin_array_to_f32(&t, i * all, width, out + i * step);
        bad += spin_finite_missing(out + i * step, width);
    }
    return bad == 0 ? SPIN_OK
                    : spin_malformed("tensor '%s' has %zu values that are not finite", name, bad);
}

/* Sets *degree to that of features_rest or, if it is smaller, to sh_degree, the degree up to which
 * the renderer evaluated the SH. */
static spin_status find_degree(const struct spin_model *base, int *degree)
{
    const struct spin_value *rest = spin_model_get(base, "features_rest");
    const struct spin_value *drawn = spin_value_get(base->tensors, "sh_degree");
    double most;

    *degree = 0;
    if (!rest || rest->kind != SPIN_VALUE_TENSOR || rest->tensor.n_dims != 3)
        return spin_malformed("there is no tensor '%sfeatures_rest' of three dimensions",
                              base->prefix);
    while (*degree < 3 && (uint64_t)spin_sh_count(*degree) < rest->tensor.shape[1] + 1)
        ++*degree;
    if ((uint64_t)spin_sh_count(*degree) != rest->tensor.shape[1] + 1)
        return spin_malformed("tensor '%sfeatures_rest' has %llu coefficients, expected 0, 3, 8 or "
                              "15 (SH degree 0 to 3)",
                              base->prefix, (unsigned long long)rest->tensor.shape[1]);
    if (spin_value_number(drawn, &most) && most < *degree)
        *degree = (int)fmax(most, 0);
    return SPIN_OK;
}

static spin_status load_series(struct model *m, int which, size_t n)
{
    struct spin_model *base = &m->base;
    const char *key = series[which].key;
    const struct spin_value *v = spin_model_get(base, "%s", key);
    uint64_t n_orders = v && v->tensor.n_dims == 4 ? v->tensor.shape[1] : 1;
    size_t step = 3 * (size_t)series[which].width * (size_t)n_orders;
    const int64_t shape[4] = {(int64_t)n, (int64_t)n_orders, series[which].width, 3};

    if (n_orders < 1 || n_orders > MOST_ORDERS)
        return spin_malformed("tensor '%s%s' has %llu orders, expected 1 to %d", base->prefix, key,
                              (unsigned long long)n_orders, MOST_ORDERS);
    m->n_orders[which] = (int)n_orders;
    SPIN_TRY(spin_model_alloc(base, n, step * sizeof(float), (void **)&m->factor[which]));
    return read_rows(base, key, 4, shape, step, m->factor[which], step);
}

static spin_status load_columns(struct model *m, size_t n, int degree)
{
    static const char *const names[] = {"position", "rotation", "scaling", "opacity"};
    const int64_t first[3] = {(int64_t)n, 1, 3}, others[3] = {(int64_t)n, -1, 3};
    const size_t step = 3 * (size_t)spin_sh_count(degree);
    struct spin_model *base = &m->base;
    struct spin_splats *s = &base->canonical;

    SPIN_TRY(spin_splats_reserve(s, n, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES, degree));
    for (int c = 0; c < 4; c++) { /* the columns before the SH, in their order */
        size_t width;
        float *out = spin_model_values(s, c, &width);
        const int64_t shape[2] = {(int64_t)n, (int64_t)width};

        SPIN_TRY(read_rows(base, names[c], 2, shape, width, out, width));
    }
    SPIN_TRY(read_rows(base, "features", 3, first, 3, s->sh, step));
    SPIN_TRY(read_rows(base, "features_rest", 3, others, step - 3, s->sh + 3, step));
    SPIN_TRY(spin_model_alloc(base, n, sizeof *m->centre, (void **)&m->centre));
    return read_rows(base, "time_center", 2, (int64_t[2]){(int64_t)n, 1}, 1, m->centre, 1);
}

static spin_status read_checkpoint(struct spin_model *base)
{
    struct model *m = (struct model *)base;
    const int64_t shape[2] = {-1, 3};
    const struct spin_value *position;
    struct spin_array t;
    int degree;

    SPIN_TRY(find_tensors(base));
    position = spin_model_get(base, "position");
    if (!position)
        return spin_malformed("there is no tensor '%sposition'", base->prefix);
    SPIN_TRY(spin_chkpnt_bind(&base->torch, position, "position", 2, shape, &t));
    if (t.shape[0] < 1 || t.shape[0] > INT_MAX)
        return spin_malformed("tensor '%sposition' has %llu Gaussians, expected 1 to 2^31 - 1",
                              base->prefix, (unsigned long long)t.shape[0]);
    SPIN_TRY(find_degree(base, &degree));
    for (int i = 0; i < N_SERIES; i++)
        SPIN_TRY(load_series(m, i, (size_t)t.shape[0]));
    return load_columns(m, (size_t)t.shape[0], degree);
}

/* ---- The settings of the training ------------------------------------------------------------ */

/* Reads a number of the open YAML file. If the key is missing, *out keeps its value. */
static spin_status read_number(const struct run_config *s, const char *key, double *out)
{
    const char *next;
    struct cfg_span value = spin_yaml_find(s, key, &next);

    if (value.at && (!spin_cfg_number(value, out) || !isfinite(*out)))
        return spin_malformed("'%s': %s is '%.*s', expected a number", s->yaml_path, key,
                              (int)(value.end - value.at < 40 ? value.end - value.at : 40),
                              value.at);
    return SPIN_OK;
}

static spin_status read_switch(const struct run_config *s, const char *key, bool *out)
{
    const char *next;
    struct cfg_span value = spin_yaml_find(s, key, &next);

    if (value.at && !spin_cfg_bool(value, out))
        return spin_malformed("'%s': %s is '%.*s', expected true or false", s->yaml_path, key,
                              (int)(value.end - value.at < 40 ? value.end - value.at : 40),
                              value.at);
    return SPIN_OK;
}

/* Whether the value of `key` contains the word, as a name with or without quotes does. */
static bool says(const struct run_config *s, const char *key, const char *word)
{
    const char *next;
    struct cfg_span value = spin_yaml_find(s, key, &next);

    return value.at && memmem(value.at, (size_t)(value.end - value.at), word, strlen(word));
}

/* Reads the settings of the open YAML file. Sets *fits to whether the file configures Gaussian-Flow
 * with the numbers of orders that the checkpoint has. */
static spin_status read_timing(const struct model *m, struct timing *out, bool *fits)
{
    const struct run_config *s = &m->base.settings;
    bool scaled = true, shifted = true, normalised = false;

    *out = (struct timing){.scale = 1};
    *fits = says(s, "point_cloud_type", "GaussianFlowPointCloud");
    for (int i = 0; *fits && i < N_SERIES; i++) {
        double n = ORDERS;

        SPIN_TRY(read_number(s, series[i].setting, &n));
        *fits = n == m->n_orders[i];
    }
    if (!*fits)
        return SPIN_OK;
    SPIN_TRY(read_switch(s, "rescale_t", &scaled));
    SPIN_TRY(read_switch(s, "offset_t", &shifted));
    SPIN_TRY(read_switch(s, "normalize_timestamp", &normalised));
    if (normalised)
        return spin_unsupported("'%s': normalize_timestamp divides times by a number that is not "
                                "stored",
                                s->yaml_path);
    SPIN_TRY(read_number(s, "rescale_value", &out->scale));
    SPIN_TRY(read_number(s, "offset_value", &out->shift));
    out->scale = scaled ? out->scale : 1;
    out->shift = shifted ? out->shift : 0;
    out->half_open = says(s, "data_set", "CustomDataset");
    return SPIN_OK;
}

/* Reads the settings of all YAML files in a folder that fit the checkpoint. The training copies its
 * own file, but also those of other data sets; files that fit must agree. */
static spin_status search_folder(struct model *m, const char *folder)
{
    struct spin_model *base = &m->base;
    char **names;
    size_t n;

    SPIN_TRY(spin_model_names(base, folder, &names, &n));
    for (size_t i = 0; i < n; i++) {
        struct timing found;
        const char *path;
        bool fits;

        if (!spin_text_ends(names[i], ".yaml") && !spin_text_ends(names[i], ".yml"))
            continue;
        SPIN_TRY(spin_model_join(base, &path, folder, "%s", names[i]));
        if (spin_path_is_folder(path))
            continue;
        SPIN_TRY(spin_yaml_open(path, &base->settings));
        SPIN_TRY(read_timing(m, &found, &fits));
        spin_yaml_close(&base->settings);
        if (!fits)
            continue;
        found.path = path;
        if (m->timing.path && (found.scale != m->timing.scale || found.shift != m->timing.shift ||
                               found.half_open != m->timing.half_open))
            return spin_malformed("'%s' and '%s' both fit the checkpoint, but differ in "
                                  "rescale_value, offset_value or data_set: give the file of the "
                                  "training with --config",
                                  m->timing.path, path);
        m->timing = found;
    }
    return SPIN_OK;
}

static spin_status search_config(struct model *m)
{
    struct spin_model *base = &m->base;
    const char *given = spin_model_option(base, "config"), *folder, *copies;
    bool fits;

    if (given) {
        SPIN_TRY_IN(spin_yaml_open(given, &base->settings), "--config");
        SPIN_TRY_IN(read_timing(m, &m->timing, &fits), "--config");
        m->timing.path = given;
        return fits ? SPIN_OK
                    : spin_malformed("--config: '%s' does not configure a GaussianFlowPointCloud "
                                     "with %d, %d and %d orders, as in the checkpoint",
                                     given, m->n_orders[POSITION], m->n_orders[ROTATION],
                                     m->n_orders[FEATURES]);
    }
    SPIN_TRY(spin_model_folder(base, &folder, base->path));
    SPIN_TRY(search_folder(m, folder));
    SPIN_TRY(spin_model_find(base, &copies, folder, "project_file"));
    return copies && spin_path_is_folder(copies) ? search_folder(m, copies) : SPIN_OK;
}

static spin_status read_settings(struct model *m)
{
    struct spin_model *base = &m->base;
    struct timing *t = &m->timing;
    int n_given = (spin_model_option(base, "rescale-value") != NULL) +
                  (spin_model_option(base, "offset-value") != NULL);

    t->scale = 1;
    SPIN_TRY(search_config(m));
    SPIN_TRY(spin_model_number(base, "rescale-value", "", &t->scale));
    SPIN_TRY(spin_model_number(base, "offset-value", "", &t->shift));
    if (!isfinite(t->scale) || !isfinite(t->shift))
        return spin_misuse("--rescale-value and --offset-value: expected finite numbers");
    if (t->path && n_given < 2)
        spin_note(base->sequence,
                  "rescale_value is %g and offset_value is %g, from '%s'%s; the training does not "
                  "store values from its command line",
                  t->scale, t->shift, spin_path_name(t->path),
                  n_given > 0 ? " and from an option" : "");
    else if (n_given < 2)
        spin_note(base->sequence,
                  "rescale_value is %g and offset_value is %g: no YAML file of the training was "
                  "found, so the method's defaults, 1 and 0, replace options that are not given, "
                  "but its files for D-NeRF and for custom data sets set 0.7 and 0.1: see --config",
                  t->scale, t->shift);
    base->sequence->half_open = t->half_open;
    spin_note(base->sequence, "times run from 0 to 1 and are not stored: frame i of n is at i/%s%s",
              t->half_open ? "n" : "(n-1)",
              t->path ? "" : ", but with CustomDataset at i/n: --frame-times count");
    return SPIN_OK;
}

/* ---- Evaluating ------------------------------------------------------------------------------ */

/* Computes the powers, sines and cosines of the time of a Gaussian: those of order k are basis[3 *
 * k] and the two numbers after it. */
static void compute_basis(const struct model *m, size_t row, double basis[BASIS])
{
    double u = (double)(m->time - m->centre[row]), power = 1;

    for (int k = 0; k < ORDERS; k++, power *= u) {
        basis[3 * k] = power;
        basis[3 * k + 1] = sin(2 * M_PI * k * u);
        basis[3 * k + 2] = cos(2 * M_PI * k * u);
    }
}

static float evaluate(const struct model *m, int which, size_t row, int c, const double *basis)
{
    int n = m->n_orders[which] < ORDERS ? m->n_orders[which] : ORDERS;
    size_t width = (size_t)series[which].width;
    double sum = 0;

    for (size_t k = 0; k < (size_t)n; k++) {
        const float *f =
            m->factor[which] + 3 * (((size_t)m->n_orders[which] * row + k) * width + (size_t)c);

        for (size_t i = 0; i < 3; i++)
            sum += (double)f[i] * basis[3 * k + i];
    }
    return (float)(sum / ORDERS);
}

static void turn_block(void *context, size_t first, int n, float *scratch)
{
    const struct model *m = context;
    double basis[BASIS];

    (void)scratch;
    for (size_t i = first; i < first + (size_t)n; i++) {
        compute_basis(m, i, basis);
        for (int c = 0; c < 4; c++)
            m->quats[4 * i + (size_t)c] =
                m->base.canonical.quats[4 * i + (size_t)c] + evaluate(m, ROTATION, i, c, basis);
    }
}

/* Computes the quaternions of a frame and the norm of each component. The sums are those of one
 * thread, so they do not depend on the number of threads. */
static void turn_all(struct model *m)
{
    size_t n = m->base.canonical.n;

    spin_mlp_team_run(&m->base.team, n, turn_block, m);
    memset(m->norm, 0, sizeof m->norm);
    for (size_t i = 0; i < 4 * n; i++)
        m->norm[i % 4] += (double)m->quats[i] * (double)m->quats[i];
    for (int c = 0; c < 4; c++)
        m->norm[c] = fmax(sqrt(m->norm[c]), 1e-12);
}

static void write_shape(const struct model *m, size_t row, unsigned wanted, struct spin_splats *out)
{
    double scale[3], q[4], cov6[6], log_scales[3] = {NAN, NAN, NAN}, unit[4] = {NAN, NAN, NAN, NAN};

    for (size_t c = 0; c < 3; c++)
        scale[c] = exp((double)m->base.canonical.log_scales[3 * row + c]);
    for (size_t c = 0; c < 4; c++)
        q[c] = (double)m->quats[4 * row + c] / m->norm[c];
    spin_covariance_unnormalised(scale, q, cov6);
    spin_covariance_split(cov6, log_scales, unit);
    for (size_t c = 0; c < 3 && wanted & SPIN_COL_LOG_SCALES; c++)
        out->log_scales[3 * row + c] = (float)log_scales[c];
    for (size_t c = 0; c < 4 && wanted & SPIN_COL_QUATS; c++)
        out->quats[4 * row + c] = (float)unit[c];
}

static void move_block(void *context, size_t first, int n, float *scratch)
{
    const struct deform_job *job = context;
    const struct model *m = job->model;
    const struct spin_splats *from = job->from;
    size_t n_sh = 3 * (size_t)spin_sh_count(from->sh_degree);
    double basis[BASIS];

    (void)scratch;
    for (size_t i = first; i < first + (size_t)n; i++) {
        compute_basis(m, i, basis);
        for (int c = 0; c < 3 && job->columns & SPIN_COL_MEANS; c++)
            job->out->means[3 * i + (size_t)c] =
                from->means[3 * i + (size_t)c] + evaluate(m, POSITION, i, c, basis);
        if (job->columns & (SPIN_COL_LOG_SCALES | SPIN_COL_QUATS))
            write_shape(m, i, job->columns, job->out);
        if (!(job->columns & SPIN_COL_SH))
            continue;
        memcpy(job->out->sh + n_sh * i, from->sh + n_sh * i, n_sh * sizeof *from->sh);
        for (int c = 0; c < 3; c++)
            job->out->sh[n_sh * i + (size_t)c] += evaluate(m, FEATURES, i, c, basis);
    }
}

static spin_status frame(void *self, int index, double time, unsigned columns,
                         struct spin_splats *out)
{
    struct model *m = self;

    (void)index;
    /* The method computes u in single precision. */
    m->time = (float)time * (float)m->timing.scale;
    m->time += (float)m->timing.shift;
    if (isfinite(time) && columns & (SPIN_COL_LOG_SCALES | SPIN_COL_QUATS))
        turn_all(m);
    return spin_deform_frame(&m->base, time, columns, MOVED, move_block, out);
}

/* ---- Opening --------------------------------------------------------------------------------- */

static spin_status open_model(void *self, const char *path)
{
    struct model *m = self;
    struct spin_model *base = self;
    const struct spin_splats *s = &base->canonical;

    SPIN_TRY(spin_chkpnt_find(base, path));
    if (!base->path)
        return spin_not_found("'%s' contains no chkpnt<N>.pth", path);
    SPIN_TRY(spin_model_torch(base, base->path, read_checkpoint));
    spin_model_describe(base, &s->n, s->sh_degree, MOVED);
    SPIN_TRY(read_settings(m));
    snprintf(base->sequence->variant, sizeof base->sequence->variant,
             "Gaussian-Flow, %zu Gaussians, %d, %d and %d orders", s->n, m->n_orders[POSITION],
             m->n_orders[ROTATION], m->n_orders[FEATURES]);
    SPIN_TRY(spin_model_alloc(base, s->n, 4 * sizeof *m->quats, (void **)&m->quats));
    return spin_mlp_team_create(1, &base->team);
}

static const struct spin_plugin_option options[] = {
    {"config", "FILE", "the YAML file of the training (default: beside the checkpoint)", NULL},
    {"rescale-value", "X", "the factor on times (default: as in the YAML file, else 1)", NULL},
    {"offset-value", "X", "the number added to scaled times (default: as in the YAML file, else 0)",
     NULL},
    {NULL, NULL, NULL, NULL},
};

SPIN_MODEL_IMPORTER(gaussianflow, struct model, open_model, spin_model_close,
                    .summary = "Gaussian-Flow: chkpnt<N>.pth, or the run's folder",
                    .upstream = "NJU-3DV/Gaussian-Flow 70c18e7", .options = options, .probe = probe,
                    .frame = frame)
