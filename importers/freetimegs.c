/* FreeTimeGS (Wang et al., CVPR 2025) as trained by FreeTimeGsVanilla and its forks:
 * ckpts/ckpt_<step>.pt, or the same model as one .ftgs.ply. Splats move on straight lines with a
 * Gaussian window in time, which 4D splats represent exactly.
 *
 * Times run from 0 to 1 over the clip, with frame i of F at i/(F-1), and a velocity is the
 * displacement over the whole clip. The method's renderer raises every opacity to at least 1e-4.
 * No rasteriser draws splats with this opacity; the importer hides those with an opacity below
 * 1/255. */
#include "importers/lib/chkpnt.h"
#include "math/sh.h"

#define LEAST_SIGMA 0.02 /* limit to which the method raises shorter durations in checkpoints */
#define USUAL_FRAMES 300
#define MOST_FRAMES 1000000

struct model {
    struct spin_model base;
    double step;        /* iteration of the checkpoint; -1: the file is a PLY */
    double n_frames;    /* number of frames of the clip; 0: unknown */
    double fps;         /* frames per second of the clip; 0: unknown */
    bool moves;         /* use_velocity: if false, the splats do not move */
    double least_sigma; /* shorter durations are raised to this value */
};

/* ---- Recognising ----------------------------------------------------------------------------- */

/* Returns N for the name ckpt_<N>.pt and -1 for other names. */
static long long step_of(const char *name)
{
    char *end = NULL;
    long long n = strncmp(name, "ckpt_", 5) == 0 && name[5] >= '0' && name[5] <= '9'
                      ? strtoll(name + 5, &end, 10)
                      : -1;

    return end && strcmp(end, ".pt") == 0 ? n : -1;
}

/* Other methods use the same folder names, but their checkpoints contain means without durations. A
 * checkpoint with neither means nor durations is damaged: the probe accepts it, so that open()
 * reports the damage. */
static int probe_folder(const struct spin_peek *peek)
{
    if (spin_peek_contains(peek, "means") && !spin_peek_contains(peek, "durations"))
        return 0;
    for (size_t i = 0; peek->names && peek->names[i]; i++)
        if (step_of(peek->names[i]) >= 0)
            return 80;
    return spin_peek_has(peek, "ckpts") ? 60 : 0;
}

static int probe(const struct spin_peek *peek)
{
    if (spin_peek_contains(peek, "comment ftgs_version") ||
        (spin_peek_contains(peek, "property float log_duration") &&
         spin_peek_contains(peek, "property float time\n")))
        return 100;
    if (peek->is_folder)
        return probe_folder(peek);
    return spin_peek_contains(peek, "durations") && spin_peek_contains(peek, "velocities") ? 95
           : step_of(spin_path_name(peek->path)) >= 0                                      ? 40
                                                                                           : 0;
}

/* ---- The splats ------------------------------------------------------------------------------ */

static const struct {
    const char *key;
    int width;
} columns[] = {{"means", 3},      {"scales", 3}, {"quats", 4},    {"opacities", 1},
               {"velocities", 3}, {"times", 1},  {"durations", 1}};
enum { MEANS, SCALES, QUATS, OPACITIES, VELOCITIES, TIMES, DURATIONS, N_COLUMNS };

static spin_status reserve(struct model *m, size_t n, int sh_degree)
{
    struct spin_splats_4d *s = &m->base.splats_4d;

    s->least_opacity = 1 / 255.0;
    return spin_splats_4d_reserve(s, n, m->moves ? 1 : 0, sh_degree, 0);
}

static float *column_of(struct model *m, int column)
{
    struct spin_splats_4d *s = &m->base.splats_4d;

    return (float *[N_COLUMNS]){s->centres, s->log_scales, s->quats, s->logit_opacities,
                                s->paths,   s->times,      s->sigmas}[column];
}

/* Converts durations, which are stored as logarithms of sigma, raises them to at least least_sigma,
 * and fills the description of the sequence. */
static spin_status finish_splats(struct model *m)
{
    struct spin_splats_4d *s = &m->base.splats_4d;
    struct spin_sequence_info *sequence = m->base.sequence;
    size_t n_short = 0, n = s->n;
    char step[40] = "";

    for (size_t i = 0; i < n; i++) {
        double sigma = exp((double)s->sigmas[i]);

        n_short += sigma < m->least_sigma;
        s->sigmas[i] = (float)(sigma < m->least_sigma ? m->least_sigma : sigma);
    }
    SPIN_TRY(spin_model_finish_4d(&m->base));
    sequence->fps = m->fps > 0 ? m->fps : 30;
    sequence->n_clip_frames = (int)(m->n_frames > 0 ? m->n_frames : USUAL_FRAMES);
    sequence->time_first = 0;
    sequence->time_last = 1;
    if (m->step >= 0)
        snprintf(step, sizeof step, ", step %.0f", m->step);
    snprintf(sequence->variant, sizeof sequence->variant,
             "FreeTimeGS%s, %zu Gaussians, SH degree %d%s", step, n, s->sh_degree,
             m->moves ? "" : ", without motion");
    if (m->n_frames == 0)
        spin_note(sequence,
                  "the file does not contain the number of frames: assumed %d, the usual number; "
                  "--n-frames overrides this",
                  USUAL_FRAMES);
    if (m->fps == 0)
        spin_note(sequence,
                  "the file does not contain the frame rate: assumed 30 frames per second");
    if (n_short > 0)
        spin_note(
            sequence,
            "%s a duration below %g of the clip, clamped to this limit as in the method's renderer",
            spin_text_share(n_short, n, "Gaussian", "has", "have", (char[96]){0}), m->least_sigma);
    return SPIN_OK;
}

/* ---- Checkpoint ------------------------------------------------------------------------------ */

/* Settings that some programs store at the top level or in 'model_spec', and the only value of each
 * that is supported. */
static const struct {
    const char *key, *value; /* NULL: the setting must be off */
} said[] = {{"time_units", "normalized"},
            {"duration_activation", "exp"},
            {"use_marginal_gating", NULL},
            {"use_color_velocity", NULL}};
enum { N_SAID = sizeof said / sizeof *said };

static bool is_off(const struct spin_value *v)
{
    return v->kind == SPIN_VALUE_NONE ||
           ((v->kind == SPIN_VALUE_BOOL || v->kind == SPIN_VALUE_INT) && v->integer == 0);
}

static spin_status check_said(const struct spin_value *root)
{
    for (int i = 0; i < N_SAID; i++) {
        const struct spin_value *v = spin_value_get(root, said[i].key);
        const char *text = spin_value_text(v);

        if (v && said[i].value && (!text || strcmp(text, said[i].value) != 0))
            return spin_unsupported("'%s' is '%.40s', expected '%s'", said[i].key,
                                    text ? text : "not a string", said[i].value);
        if (v && !said[i].value && !is_off(v))
            return spin_unsupported("'%s' is enabled, which is not supported", said[i].key);
    }
    return SPIN_OK;
}

static spin_status check_spec(const struct spin_value *spec)
{
    const char *text = spin_value_text(spec);

    if (!spec || spec->kind == SPIN_VALUE_NONE)
        return SPIN_OK;
    if (spec->kind != SPIN_VALUE_DICT)
        return spin_unsupported(
            "'model_spec' is %s%.40s, not a dict: the checkpoint may be of another "
            "model than FreeTimeGS",
            text ? "the text " : "", text ? text : "of another type");
    for (size_t i = 0; i < spec->n; i++) {
        const char *key = spin_value_text(spec->item[2 * i]);
        bool ours = false;

        for (int k = 0; k < N_SAID && key; k++)
            ours = ours || strcmp(key, said[k].key) == 0;
        if (!ours)
            return spin_unsupported("'model_spec' has the key '%.40s', which FreeTimeGS does not "
                                    "define: the checkpoint may be of another model",
                                    key ? key : "(not a string)");
    }
    return check_said(spec);
}

/* Refuses 'splats' if it contains an array besides the nine of FreeTimeGS, since the checkpoint is
 * then of another method. */
static spin_status check_names(const struct spin_value *splats)
{
    if (!spin_value_get(splats, "times") || !spin_value_get(splats, "durations") ||
        !spin_value_get(splats, "velocities"))
        return spin_unsupported("'splats' lacks times, durations or velocities: this is a "
                                "checkpoint of gsplat without time, or of another method");
    for (size_t i = 0; i < splats->n; i++) {
        const char *key = spin_value_text(splats->item[2 * i]);
        bool known = key && (strcmp(key, "sh0") == 0 || strcmp(key, "shN") == 0);

        for (int c = 0; c < N_COLUMNS && key; c++)
            known = known || strcmp(key, columns[c].key) == 0;
        if (!known)
            return spin_unsupported("'splats' has the key '%.40s', which FreeTimeGS does not "
                                    "define: this is another model",
                                    key ? key : "(not a string)");
    }
    return SPIN_OK;
}

/* Sets *out to the tensor `key` of 'splats', which must have the shape `shape` [n_dims]; a tensor
 * of shape [n] is also accepted for [n][1]. */
static spin_status bind_tensor(struct model *m, const char *key, int n_dims, int64_t shape[3],
                               struct spin_array *out)
{
    const struct spin_value *v = spin_value_get(m->base.tensors, key);

    if (!v || v->kind != SPIN_VALUE_TENSOR)
        return spin_malformed("'splats' has no tensor '%s'", key);
    if (shape[1] == 1 && v->tensor.n_dims == 1)
        n_dims = 1;
    return spin_chkpnt_bind(&m->base.torch, v, key, n_dims, shape, out);
}

static spin_status load_sh(struct model *m, struct spin_array sh[2])
{
    struct spin_splats_4d *s = &m->base.splats_4d;
    size_t width = 3 * (size_t)((s->sh_degree + 1) * (s->sh_degree + 1));

    for (size_t i = 0; i < s->n; i++) {
        spin_array_to_f32(&sh[0], 3 * i, 3, s->sh + width * i);
        if (width > 3)
            spin_array_to_f32(&sh[1], (width - 3) * i, width - 3, s->sh + width * i + 3);
    }
    return SPIN_OK;
}

static spin_status read_checkpoint(struct spin_model *base)
{
    struct model *m = (struct model *)base;
    const struct spin_value *root = base->torch.root, *moves = spin_value_get(root, "use_velocity");
    int64_t places[3] = {-1, 3}, dc[3] = {-1, 1, 3}, rest[3] = {-1, -1, 3};
    struct spin_array t, sh[2];
    int degree = 0;

    base->tensors = spin_value_get(root, "splats");
    if (!base->tensors || base->tensors->kind != SPIN_VALUE_DICT)
        return spin_malformed("the checkpoint has no dict 'splats'");
    SPIN_TRY(check_names(base->tensors));
    SPIN_TRY(check_said(root));
    SPIN_TRY(check_spec(spin_value_get(root, "model_spec")));
    spin_value_number(spin_value_get(root, "step"), &m->step);
    m->step = m->step > 0 ? m->step : 0;
    if (spin_value_get(root, "n_frames") &&
        (!spin_value_number(spin_value_get(root, "n_frames"), &m->n_frames) ||
         !(m->n_frames >= 1 && m->n_frames <= MOST_FRAMES)))
        return spin_malformed("'n_frames' is %g, expected 1 to %d", m->n_frames, MOST_FRAMES);
    if (moves && moves->kind != SPIN_VALUE_BOOL && moves->kind != SPIN_VALUE_INT)
        return spin_malformed("'use_velocity' is neither true nor false");
    m->moves = !moves || moves->integer != 0;
    if (spin_value_get(root, "color_correction") &&
        !is_off(spin_value_get(root, "color_correction")))
        spin_note(base->sequence, "'color_correction', which corrects the colours of each training "
                                  "camera, is not imported");
    SPIN_TRY(bind_tensor(m, "means", 2, places, &t));
    if (t.shape[0] == 0)
        return spin_malformed("the file contains 0 Gaussians");
    dc[0] = rest[0] = (int64_t)t.shape[0];
    SPIN_TRY(bind_tensor(m, "sh0", 3, dc, &sh[0]));
    SPIN_TRY(bind_tensor(m, "shN", 3, rest, &sh[1]));
    while (degree < 3 && spin_sh_count(degree) < (int)sh[1].shape[1] + 1)
        degree++;
    if (spin_sh_count(degree) != (int)sh[1].shape[1] + 1)
        return spin_malformed("shN has %llu rows, expected 0, 3, 8 or 15",
                              (unsigned long long)sh[1].shape[1]);
    SPIN_TRY(reserve(m, (size_t)t.shape[0], degree));
    for (int c = 0; c < N_COLUMNS; c++) {
        int64_t shape[3] = {(int64_t)base->splats_4d.n, columns[c].width};

        SPIN_TRY(bind_tensor(m, columns[c].key, 2, shape, &t));
        if (column_of(m, c))
            spin_array_to_f32(&t, 0, t.count, column_of(m, c));
    }
    return load_sh(m, sh);
}

/* ---- PLY ------------------------------------------------------------------------------------- */

/* Returns the text after `key` in the last comment that begins with `key`, or NULL if there is
 * none. */
static const char *comment_of(const struct spin_ply *ply, const char *key)
{
    size_t n = strlen(key);
    const char *value = NULL;

    for (size_t i = 0; i < ply->n_comments; i++) {
        const char *text = ply->comment[i] + strspn(ply->comment[i], " \t");

        if (strncmp(text, key, n) == 0 && (text[n] == ' ' || text[n] == '\t'))
            value = text + n + strspn(text + n, " \t");
    }
    return value;
}

static spin_status read_comment(const struct spin_ply *ply, const char *key, double least,
                                double most, double *out)
{
    const char *text = comment_of(ply, key);
    char *end = NULL;

    if (!text)
        return spin_malformed("there is no comment '%s', which a .ftgs.ply must have", key);
    *out = strtod(text, &end);
    end += strspn(end, " \t\r");
    if (end == text || *end || !(*out >= least && *out <= most))
        return spin_malformed("comment '%s' is '%.40s', expected %g to %g", key, text, least, most);
    return SPIN_OK;
}

static spin_status check_header(const struct spin_ply *ply, struct model *m, int *sh_degree)
{
    const char *units = comment_of(ply, "time_units");
    const char *durations = comment_of(ply, "duration_activation");
    double version, degree, moves, floor_of;

    SPIN_TRY(read_comment(ply, "ftgs_version", 1, 1e9, &version));
    if (version != 1)
        return spin_unsupported("ftgs_version is %g, expected 1", version);
    if (!units || strncmp(units, "normalized", 10) != 0 || units[10 + strspn(units + 10, " \t\r")])
        return spin_unsupported("comment 'time_units' is '%.40s', expected 'normalized'",
                                units ? units : "missing");
    if (durations &&
        (strncmp(durations, "exp", 3) != 0 || durations[3 + strspn(durations + 3, " \t\r")]))
        return spin_unsupported("comment 'duration_activation' is '%.40s', expected 'exp'",
                                durations);
    if (comment_of(ply, "model_spec"))
        return spin_unsupported(
            "comment 'model_spec' is '%.40s': the file may be of another model than FreeTimeGS",
            comment_of(ply, "model_spec"));
    SPIN_TRY(read_comment(ply, "sh_degree", 0, 3, &degree));
    SPIN_TRY(read_comment(ply, "use_velocity", 0, 1, &moves));
    SPIN_TRY(read_comment(ply, "min_duration", 1e-30, 1e30, &m->least_sigma));
    SPIN_TRY(read_comment(ply, "opacity_floor", 0, 0.999999, &floor_of));
    if (comment_of(ply, "n_frames"))
        SPIN_TRY(read_comment(ply, "n_frames", 1, MOST_FRAMES, &m->n_frames));
    if (comment_of(ply, "fps"))
        SPIN_TRY(read_comment(ply, "fps", 0.001, 1e6, &m->fps));
    if (degree != floor(degree) || moves != floor(moves) || m->n_frames != floor(m->n_frames))
        return spin_malformed("sh_degree, use_velocity and n_frames must be whole numbers");
    if (floor_of >= 1 / 255.0)
        spin_note(
            m->base.sequence,
            "readers of the format render every Gaussian with an opacity of at least %g at all "
            "times; the importer does not reproduce this",
            floor_of);
    m->moves = moves != 0;
    *sh_degree = (int)degree;
    return SPIN_OK;
}

/* Names of the PLY properties of each column. */
static const char *const property_of[N_COLUMNS][4] = {
    {"x", "y", "z"},
    {"scale_0", "scale_1", "scale_2"},
    {"rot_0", "rot_1", "rot_2", "rot_3"},
    {"opacity"},
    {"velocity_0", "velocity_1", "velocity_2"},
    {"time"},
    {"log_duration"},
};

static spin_status read_ply(struct model *m)
{
    const struct spin_ply *ply = &m->base.ply;
    const struct spin_ply_element *e;
    struct spin_ply_target target[16 + 48];
    size_t n = 0, n_sh;
    int sh_degree = 0;

    SPIN_TRY(spin_model_vertices(&m->base, m->base.path, &e));
    SPIN_TRY(spin_fail_reading(check_header(ply, m, &sh_degree), m->base.path));
    if (ply->n_elements != 1 || e->has_list || ply->ascii || ply->big_endian)
        return spin_malformed(
            "'%s': a .ftgs.ply must consist of a single element of little-endian binary data",
            m->base.path);
    SPIN_TRY(reserve(m, (size_t)e->count, sh_degree));
    m->base.splats_4d.antialias = spin_ply_is_antialiased(ply);
    n_sh = (size_t)spin_sh_count(sh_degree);
    for (int c = 0; c < N_COLUMNS; c++)
        for (int k = 0; k < columns[c].width && column_of(m, c); k++)
            target[n++] = (struct spin_ply_target){spin_ply_find(e, property_of[c][k]),
                                                   column_of(m, c) + k, (size_t)columns[c].width};
    for (size_t k = 0; k < 3 * n_sh; k++) { /* f_dc, then f_rest channel by channel */
        bool dc = k < 3;
        size_t channel = dc ? k : (k - 3) / (n_sh - 1), row = dc ? 0 : 1 + (k - 3) % (n_sh - 1);
        char name[24];

        snprintf(name, sizeof name, dc ? "f_dc_%zu" : "f_rest_%zu", dc ? k : k - 3);
        target[n++] = (struct spin_ply_target){spin_ply_find(e, name),
                                               m->base.splats_4d.sh + 3 * row + channel, 3 * n_sh};
        if (target[n - 1].property < 0)
            return spin_malformed("'%s': element 'vertex' has no property '%s'", m->base.path,
                                  name);
    }
    for (size_t t = 0; t < n; t++) {
        if (target[t].property < 0)
            return spin_malformed("'%s': element 'vertex' lacks a property of a .ftgs.ply: x y z "
                                  "opacity scale_0..2 rot_0..3 time log_duration velocity_0..2",
                                  m->base.path);
        if (e->property[target[t].property].type != SPIN_PLY_F32)
            return spin_malformed("'%s': property '%s' is not a float", m->base.path,
                                  e->property[target[t].property].name);
    }
    spin_ply_columns(ply, e, target, n);
    return SPIN_OK;
}

/* ---- Opening --------------------------------------------------------------------------------- */

static spin_status open_model(void *self, const char *path)
{
    struct model *m = self;
    struct spin_model *base = &m->base;

    m->moves = true;
    m->least_sigma = LEAST_SIGMA;
    m->step = -1;
    SPIN_TRY(spin_model_newest(base, path, "ckpts", step_of, "ckpt_<step>.pt"));
    if (spin_text_ends(base->path, ".ply"))
        SPIN_TRY(read_ply(m));
    else
        SPIN_TRY(spin_model_torch(base, base->path, read_checkpoint));
    if (spin_model_option(base, "n-frames"))
        SPIN_TRY(spin_option_number(base->values, "n-frames", 1, MOST_FRAMES, &m->n_frames));
    return spin_fail_reading(finish_splats(m), base->path);
}

static const struct spin_plugin_option options[] = {
    {"n-frames", "N", "frames of the clip (default: as in the file, else 300)", NULL},
    {NULL, NULL, NULL, NULL},
};

SPIN_MODEL_IMPORTER(
    freetimegs, struct model, open_model, spin_model_close,
    .summary = "FreeTimeGS: ckpt_<step>.pt, the folder of the run, or .ftgs.ply",
    .upstream = "raiscui/FreeTimeGsVanilla ff48035, OpsiClear-4DGS/FreeTimeGsVanilla 662a832",
    .options = options, .probe = probe, .frame = spin_model_slice,
    .splats_4d = spin_model_splats_4d)
