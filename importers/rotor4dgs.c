/* 4D-Rotor-Gaussians (Duan et al., SIGGRAPH 2024): step-<N>.ckpt of nerfstudio, a dict of tensors.
 *
 * A Gaussian's 4-D rotation is a rotor of eight numbers, which is not normalised: its norm scales
 * the shape. Colours do not change over time. The method's renderer omits hardly any Gaussian: a
 * Gaussian with a long window in time is in every frame, even where its opacity is nearly 0. The
 * importer omits Gaussians that are invisible in 8-bit images. */
#include <ctype.h>

#include "importers/lib/chkpnt.h"
#include "importers/lib/gaussian4d.h"

/* 3DGS renderers skip Gaussians with a lower opacity. */
#define LEAST_OPACITY (1.0 / 255)
/* The lowest weight in time at which the method's renderer draws a Gaussian: 0.5 dt^2 / variance
 * must be below 16. */
#define FAR_WEIGHT 1.1253517471925912e-7 /* exp(-16) */
/* The lowest weight in time at which Realtime-4DGS draws a Gaussian. */
#define BELL_WEIGHT 0.05

struct model {
    struct spin_model base;
    struct spin_array dc, rest;
    size_t n, n_rest; /* number of rows in the file; number of SH after degree 0 */
    double step;      /* iteration of the checkpoint; -1: unknown */
    struct clip_times times;
    struct gaussian4d gaussians;
    int sh_degree;
};

/* ---- Recognising ----------------------------------------------------------------------------- */

/* Returns N for the name step-<N>.ckpt and -1 for other names. */
static long long step_of_name(const char *name)
{
    char *end;
    long long n;

    if (strncmp(name, "step-", 5) != 0 || !isdigit((unsigned char)name[5]))
        return -1;
    n = strtoll(name + 5, &end, 10);
    return strcmp(end, ".ckpt") == 0 ? n : -1;
}

static int probe(const struct spin_peek *peek)
{
    if (peek->is_folder) {
        for (size_t i = 0; peek->names && peek->names[i]; i++) {
            if (strcmp(peek->names[i], "nerfstudio_models") == 0 ||
                step_of_name(peek->names[i]) >= 0)
                return 60;
        }
        return 0;
    }
    if (spin_peek_contains(peek, "pipeline") && spin_peek_contains(peek, "quats1"))
        return 90;
    return step_of_name(spin_path_name(peek->path)) >= 0 ? 40 : 0;
}

/* ---- Tensors --------------------------------------------------------------------------------- */

/* Sets m->prefix. Versions of the method use different prefixes for the names of tensors; the
 * prefix of 'quats1' is used for all tensors. */
static spin_status find_prefix(struct spin_model *m)
{
    const struct spin_value *d = m->tensors;
    bool splatfacto = false;

    for (size_t i = 0; i < d->n; i++) {
        const char *key = spin_value_text(d->item[2 * i]);

        if (!key)
            continue;
        splatfacto = splatfacto || spin_text_ends(key, ".means");
        if (spin_text_ends(key, "quats1") && strlen(key) < 256)
            return spin_model_text(m, &m->prefix, "%.*s", (int)strlen(key) - 6, key);
    }
    return spin_unsupported(
        splatfacto
            ? "'pipeline' contains an ordinary splatfacto model, which does not change over time"
            : "'pipeline' has no tensor whose name ends in 'quats1'");
}

/* Sets *out to the tensor whose name is the prefix followed by `key`. It must have the shape
 * `shape` [n_dims] and contain floating-point numbers. */
static spin_status bind_tensor(struct model *m, const char *key, int n_dims, const int64_t *shape,
                               struct spin_array *out)
{
    const struct spin_value *v = spin_model_get(&m->base, "%s", key);
    char name[300];

    snprintf(name, sizeof name, "%s%s", m->base.prefix, key);
    if (!v)
        return spin_malformed("there is no tensor '%s'", name);
    return spin_chkpnt_bind(&m->base.torch, v, name, n_dims, shape, out);
}

static spin_status load_tensor(struct model *m, const char *key, int width, float **out)
{
    int64_t shape[2] = {(int64_t)m->n, width};
    struct spin_array t;

    SPIN_TRY(bind_tensor(m, key, 2, shape, &t));
    SPIN_TRY(spin_model_scratch(&m->base, m->n, (size_t)width * sizeof **out, (void **)out));
    spin_array_to_f32(&t, 0, t.count, *out);
    return SPIN_OK;
}

static spin_status count_rows(struct model *m)
{
    int64_t shape[2] = {-1, 3};
    struct spin_array t;

    SPIN_TRY(bind_tensor(m, "xyz", 2, shape, &t));
    if (t.shape[0] == 0)
        return spin_malformed("the file contains 0 Gaussians");
    m->n = (size_t)t.shape[0];
    return SPIN_OK;
}

static spin_status bind_sh(struct model *m)
{
    int64_t three[3] = {(int64_t)m->n, 1, 3}, two[2] = {(int64_t)m->n, 3};
    int64_t rest[3] = {(int64_t)m->n, -1, 3};
    int degree = 0;

    if (bind_tensor(m, "features_dc", 3, three, &m->dc) != SPIN_OK)
        SPIN_TRY(bind_tensor(m, "features_dc", 2, two, &m->dc)); /* layout of ordinary splatfacto */
    SPIN_TRY(bind_tensor(m, "features_rest", 3, rest, &m->rest));
    m->n_rest = (size_t)m->rest.shape[1];
    while (degree < 4 && (size_t)((degree + 1) * (degree + 1)) != m->n_rest + 1)
        degree++;
    if (m->n_rest + 1 != (size_t)((degree + 1) * (degree + 1)))
        return spin_malformed("'%sfeatures_rest' has %zu rows of SH, expected 0, 3, 8, 15 or 24",
                              m->base.prefix, m->n_rest);
    if (degree == 4)
        spin_note(m->base.sequence, "SH of degree 4 are cut to degree 3");
    m->sh_degree = degree < 3 ? degree : 3;
    return SPIN_OK;
}

static size_t sh_width(const struct model *m)
{
    return 3 * (size_t)((m->sh_degree + 1) * (m->sh_degree + 1));
}

static void read_sh(const struct model *m, size_t row, float *out)
{
    spin_array_to_f32(&m->dc, 3 * row, 3, out);
    if (m->sh_degree > 0)
        spin_array_to_f32(&m->rest, 3 * m->n_rest * row, sh_width(m) - 3, out + 3);
}

/* ---- Shapes ---------------------------------------------------------------------------------- */

enum { XYZ, TIME, SCALES, SCALES_T, QUATS1, QUATS2, OPACITIES, N_COLUMNS };

static const struct {
    const char *key;
    int width;
} columns_of[N_COLUMNS] = {{"xyz", 3},    {"t", 1},      {"scales_xyz", 3}, {"scales_t", 1},
                           {"quats1", 4}, {"quats2", 4}, {"opacities", 1}};

static float *add_row(struct model *m, float *const c[N_COLUMNS], size_t i)
{
    double rotor[8], scale[4], matrix[16];
    spin_slice slice;

    for (size_t k = 0; k < 4; k++) {
        rotor[k] = c[QUATS1][4 * i + k];
        rotor[k + 4] = c[QUATS2][4 * i + k];
        scale[k] = exp(k < 3 ? c[SCALES][3 * i + k] : c[SCALES_T][i]);
    }
    spin_matrix4_of_rotor(rotor, matrix);
    spin_slice_of(matrix, scale, &slice);
    return spin_gaussian4d_add_slice(&m->base, &m->gaussians, i, c[XYZ] + 3 * i, c[TIME][i],
                                     c[OPACITIES][i], &slice, 0);
}

static spin_status add_rows(struct model *m, float *const c[N_COLUMNS])
{
    size_t n_faint = 0, n_bad_sh = 0;

    SPIN_TRY(spin_gaussian4d_reserve(&m->base, &m->gaussians, m->n, m->sh_degree, 0));
    for (size_t i = 0; i < m->n; i++) {
        float sh[48], *to;

        read_sh(m, i, sh);
        if (spin_finite_missing(sh, sh_width(m)) > 0) {
            n_bad_sh++;
            continue;
        }
        n_faint += spin_sigmoid_of(c[OPACITIES][i]) < SPIN_FAINT;
        to = add_row(m, c, i);
        if (to)
            memcpy(to, sh, sh_width(m) * sizeof *sh);
    }
    m->gaussians.n_dropped += n_bad_sh;
    return spin_gaussian4d_check(&m->gaussians, m->n, n_faint,
                                 "values that are not finite, or rotors of length 0",
                                 m->base.sequence);
}

/* ---- Opening --------------------------------------------------------------------------------- */

static spin_status read_cull(struct model *m)
{
    enum { OPACITY, WEIGHT, NONE };
    int rule;

    SPIN_TRY(spin_option_word(m->base.values, "cull", "opacity|time|none", &rule));
    m->base.splats_4d.least_weight = rule == WEIGHT ? BELL_WEIGHT : FAR_WEIGHT;
    m->base.splats_4d.least_opacity = rule == OPACITY ? LEAST_OPACITY : 0;
    return SPIN_OK;
}

static void describe(const struct model *m)
{
    struct spin_sequence_info *sequence = m->base.sequence;
    char step[48] = "";

    if (m->step >= 0)
        snprintf(step, sizeof step, ", step %.0f", m->step);
    snprintf(sequence->variant, sizeof sequence->variant,
             "4D-Rotor-Gaussians%s, %zu Gaussians, SH degree %d", step, m->n, m->sh_degree);
    if (m->times.guessed)
        spin_note(sequence,
                  "the range of times is not in the checkpoint: assumed %g,%g, from the Gaussians' "
                  "own times; set it with --time-range",
                  m->times.first, m->times.last);
}

static spin_status open_checkpoint(struct model *m)
{
    struct spin_model *base = &m->base;
    float *c[N_COLUMNS];

    SPIN_TRY(read_cull(m));
    SPIN_TRY(spin_torch_open(base->path, &base->torch));
    m->step = -1;
    spin_value_number(spin_value_get(base->torch.root, "step"), &m->step);
    base->tensors = spin_value_get(base->torch.root, "pipeline");
    if (!base->tensors || base->tensors->kind != SPIN_VALUE_DICT)
        return spin_malformed(
            "the checkpoint has no dict 'pipeline', so it is not one of nerfstudio");
    SPIN_TRY(find_prefix(base));
    SPIN_TRY(count_rows(m));
    SPIN_TRY(bind_sh(m));
    for (int k = 0; k < N_COLUMNS; k++)
        SPIN_TRY(load_tensor(m, columns_of[k].key, columns_of[k].width, &c[k]));
    SPIN_TRY(add_rows(m, c));
    SPIN_TRY(spin_run_config_times(&base->settings, spin_model_option(base, "time-range"),
                                   base->splats_4d.times, m->gaussians.n, 1, 1, &m->times));
    spin_gaussian4d_drop_zeros(base);
    SPIN_TRY(spin_gaussian4d_finish(base, &m->gaussians, 1, &m->times));
    describe(m);
    return SPIN_OK;
}

static spin_status open_model(void *self, const char *path)
{
    struct model *m = self;

    SPIN_TRY(spin_model_newest(&m->base, path, "nerfstudio_models", step_of_name, "step-<N>.ckpt"));
    return spin_fail_reading(open_checkpoint(m), m->base.path);
}

static const struct spin_plugin_option options[] = {
    {"time-range", "A,B", "first and last time of the clip, as in the data set's file", NULL},
    {"cull", "RULE",
     "which Gaussians a frame omits: opacity (below 1/255), time (weight in time below 0.05), or "
     "none",
     "opacity"},
    {NULL, NULL, NULL, NULL},
};

SPIN_MODEL_IMPORTER(rotor4dgs, struct model, open_model, spin_model_close,
                    .summary = "4D-Rotor-Gaussians: step-<N>.ckpt, or the folder of the run",
                    .upstream = "weify627/4D-Rotor-Gaussians 1ea2ff9", .options = options,
                    .probe = probe, .frame = spin_model_slice, .splats_4d = spin_model_splats_4d)
