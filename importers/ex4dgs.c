/* Ex4DGS (Lee et al., NeurIPS 2024): static Gaussians that drift along lines, and dynamic ones
 * whose positions and rotations are interpolated between key frames and which are opaque between
 * two times.
 *
 * A training writes a checkpoint and two PLYs. Only the checkpoint contains the duration over which
 * static Gaussians drift; for the PLYs, it is read from cfg_args, whose value may differ. Like the
 * method's renderer, this importer prefers the checkpoint. The checkpoint also contains the
 * interval and the shift of the key frames; only cfg_args contains the kind of interpolation. */
#include "importers/lib/chkpnt.h"
#include "importers/lib/gaussian4d.h"
#include "math/keyframes.h"
#include "math/covariance.h"
#include "math/quat.h"

enum { N_ITEMS = 40, MOST_FRAMES = 1000000, MOST_KEYS = 1000000 };

/* Gaussians with larger values are dropped. Valid values are far smaller, and sums of a few values
 * below this limit do not overflow a float. */
#define LARGEST 1e18f

/* 4D splats interpolate quaternions linearly (a chord), the method spherically (an arc). A segment
 * is halved until chord and arc differ by at most NEAR degrees, but at most HALVINGS times.
 * Segments whose opacity never reaches LEAST_OPACITY are dropped: no renderer draws them. */
#define NEAR 0.1
enum { HALVINGS = 3 };
#define LEAST_OPACITY (1.0 / 255)

enum column {
    PLACE,    /* [3] position in every key frame */
    ROTATION, /* [4] quaternion w x y z in every key frame, not normalised */
    SCALE,    /* [3] logarithms of the scales */
    OPACITY,  /* logit of the opacity */
    SH,       /* [(sh_degree+1)^2][3] */
    DRIFT,    /* static: [3] displacement over `duration` frames */
    CENTRE,   /* dynamic: [2] the two times between which the Gaussian is opaque, in key frames */
    WIDTH, /* dynamic: [2] logarithms of the widths, in key frames, of the two edges of the opacity
            */
    N_COLUMNS
};

/* The static or the dynamic Gaussians. */
struct part {
    bool moving; /* the Gaussians are dynamic */
    size_t n;
    int n_keys; /* number of key frames; 1 for static Gaussians */
    int sh_degree;
    float *column[N_COLUMNS]; /* [n][width_of()]; NULL: not used by these Gaussians */
};

static const char *const kind_names[] = {
    [KEYFRAMES_LINEAR] = "linear", [KEYFRAMES_CUBE] = "cube", [KEYFRAMES_PCHIP] = "pchip"};

struct model {
    struct spin_model base; /* base.path: the checkpoint, or the folder with the PLYs */
    bool is_chkpnt;
    struct part still, moving;
    int sh_degree;
    size_t n;
    enum keyframes_kind kind;
    double interval;    /* number of frames from one key frame to the next */
    double shift;       /* number of frames from the first key frame to time 0 */
    double duration;    /* number of frames over which a static Gaussian moves by its drift */
    double frames;      /* number of frames of the clip; times run from 0 to frames - 1 */
    double least_width; /* added to the widths of both edges of the opacity, in key frames */
};

/* ---- Recognising ----------------------------------------------------------------------------- */

/* Recognises the method by properties of the PLYs, by an option in cfg_args, or by a parameter
 * group in the optimiser of a checkpoint. */
static int probe(const struct spin_peek *peek)
{
    bool ply =
        spin_peek_contains(peek, " xyz_disp_0") || spin_peek_contains(peek, " motion_xyz_0_0");

    if (ply && !peek->is_folder)
        return 100;
    return ply || spin_peek_contains(peek, "rot_interp_type=") ||
                   spin_peek_contains(peek, "motion_opacity_center")
               ? 95
               : 0;
}

/* ---- Finding the files ----------------------------------------------------------------------- */

/* Sets *out to the newest folder iteration_<N> with at least one of the two PLYs, or to NULL if
 * there is none. If only one PLY exists, read_parts() reports that the other is missing. */
static spin_status newest_save(struct spin_model *m, const char *clouds, const char **out)
{
    static const char *const files[] = {"point_cloud.ply", "dynamic_point_cloud.ply"};
    const char *wanted = spin_model_option(m, "iteration");

    *out = NULL;
    for (int i = 0; i < 2; i++) {
        const char *name;

        SPIN_TRY(spin_model_choose(m, wanted, clouds, files[i], NULL, NULL, &name));
        if (name && (!*out || spin_model_iteration(name) > spin_model_iteration(*out)))
            *out = name;
    }
    return SPIN_OK;
}

/* Finds the files to read. `path` is the model's folder, a checkpoint, a folder with the PLYs, or
 * one of the PLYs. From the model's folder, the newest iteration is read: its checkpoint or, if it
 * has none, its PLYs. */
static spin_status find_files(const char *path, struct model *m)
{
    struct spin_model *base = &m->base;
    const char *wanted = spin_model_option(base, "iteration");
    const char *dot = strrchr(spin_path_name(path), '.');
    const char *clouds, *save = NULL, *chkpnt;
    bool best;

    if (!spin_path_is_folder(path)) {
        m->is_chkpnt = !dot || strcmp(dot, ".ply") != 0;
        return m->is_chkpnt ? spin_model_text(base, &base->path, "%s", path)
                            : spin_model_folder(base, &base->path, path);
    }
    if (spin_model_holds(path, "dynamic_point_cloud.ply") ||
        spin_model_holds(path, "point_cloud.ply"))
        return spin_model_text(base, &base->path, "%s", path);
    SPIN_TRY(spin_model_join(base, &clouds, path, "point_cloud"));
    if (spin_path_is_folder(clouds))
        SPIN_TRY(newest_save(base, clouds, &save));
    SPIN_TRY(spin_chkpnt_choose(base, path, wanted, &chkpnt, &best));
    m->is_chkpnt = chkpnt && (!save || spin_chkpnt_iteration(chkpnt) >= spin_model_iteration(save));
    if (m->is_chkpnt)
        return spin_model_join(base, &base->path, path, "%s", chkpnt);
    if (save)
        return spin_model_join(base, &base->path, clouds, "%s", save);
    return spin_not_found("'%s' contains neither chkpnt%s.pth nor point_cloud/iteration_%s", path,
                          wanted ? wanted : "<N>", wanted ? wanted : "<N>");
}

/* ---- Settings -------------------------------------------------------------------------------- */

/* Settings from the options or, where an option is not given, from cfg_args. A setting is NAN if
 * neither contains it. */
struct given {
    double interval, pad, frames, var_pad, first;
    int kind; /* kind of interpolation; -1: not given */
};

static spin_status read_number(const struct spin_model *m, const char *option, double least,
                               const char *key, double *out)
{
    if (spin_model_option(m, option))
        return spin_option_number(m->values, option, least, MOST_FRAMES, out);
    return spin_cfg_read_number(&m->settings.cfg, key, out);
}

static spin_status read_kind(const struct spin_model *m, int *out)
{
    const struct cfg_args *cfg = &m->settings.cfg;
    struct cfg_span s = spin_cfg_get(cfg, "interp_type");

    SPIN_TRY(spin_model_word(m, "interp", "interp_type", "linear|cube|pchip", out));
    if (*out < 0 && s.at)
        return spin_unsupported("'%s': interp_type is %.*s, expected linear, cube or pchip",
                                cfg->path, (int)(s.end - s.at), s.at);
    return SPIN_OK;
}

static spin_status read_given(const struct spin_model *m, struct given *given)
{
    const struct cfg_args *cfg = &m->settings.cfg;
    struct cfg_span turn = spin_cfg_get(cfg, "rot_interp_type");

    *given = (struct given){NAN, NAN, NAN, 3, 0, -1};
    if (turn.at && !spin_cfg_is(turn, "'slerp'"))
        return spin_unsupported("'%s': rot_interp_type is %.*s, expected 'slerp'", cfg->path,
                                (int)(turn.end - turn.at), turn.at);
    SPIN_TRY(read_number(m, "interval", 1, "time_interval", &given->interval));
    SPIN_TRY(read_number(m, "time-pad", 0, "time_pad", &given->pad));
    SPIN_TRY(read_number(m, "duration", 1, "duration", &given->frames));
    SPIN_TRY(spin_cfg_read_number(cfg, "var_pad", &given->var_pad));
    SPIN_TRY(spin_cfg_read_number(cfg, "start_timestamp", &given->first));
    return read_kind(m, &given->kind);
}

/* Refuses a model with a missing setting. If a checkpoint is read, only the kind of interpolation
 * is required, since the checkpoint contains the other settings. */
static spin_status check_given(const struct model *m, const struct given *given)
{
    const struct {
        bool missing;
        const char *key, *option;
    } all[] = {
        {given->kind < 0, "interp_type", "interp"},
        {!m->is_chkpnt && isnan(given->interval), "time_interval", "interval"},
        {!m->is_chkpnt && isnan(given->pad), "time_pad", "time-pad"},
        {!m->is_chkpnt && isnan(given->frames), "duration", "duration"},
    };

    for (int i = 0; i < 4; i++) {
        if (all[i].missing)
            return spin_not_found("'%s': there is no cfg_args with %s beside the model: use --%s",
                                  m->base.path, all[i].key, all[i].option);
    }
    return SPIN_OK;
}

/* Adds a note for the user for each value of cfg_args or options that contradicts the checkpoint.
 * The values in the checkpoint are used. */
static void note_differences(const struct model *m, double interval, double shift)
{
    struct spin_sequence_info *sequence = m->base.sequence;

    if (!isnan(interval) && interval != m->interval)
        spin_note(sequence,
                  "time_interval is %g in cfg_args and %g in the checkpoint: the value in the "
                  "checkpoint is used",
                  interval, m->interval);
    if (!isnan(shift) && shift != m->shift)
        spin_note(sequence,
                  "time_pad in cfg_args implies a shift of %g frames, but the checkpoint has %g: "
                  "the value in the checkpoint is used",
                  shift, m->shift);
    if (m->duration < m->frames + m->shift + 1)
        spin_note(sequence,
                  "the checkpoint was saved before training covered the whole clip: its duration "
                  "is %g frames, that of a finished run %g",
                  m->duration, m->frames + m->shift + 1);
}

static spin_status apply_settings(struct model *m, const struct given *given)
{
    struct spin_sequence_info *sequence = m->base.sequence;
    double interval = m->is_chkpnt ? m->interval : given->interval;
    double shift = given->pad + (given->kind == KEYFRAMES_LINEAR ? 0 : interval);

    SPIN_TRY(check_given(m, given));
    m->kind = (enum keyframes_kind)given->kind;
    m->frames = given->frames;
    if (!m->is_chkpnt) {
        m->interval = interval;
        m->shift = shift;
        m->duration = m->frames;
    } else if (!(m->frames >= 1)) {
        m->frames = m->duration - m->shift - 1;
        spin_note(sequence,
                  "cfg_args does not contain the number of frames: assumed %g, from the "
                  "checkpoint's duration; --duration overrides this",
                  m->frames);
    }
    m->least_width = given->var_pad / m->interval / 2.36;
    if (!(m->interval >= 1 && m->interval <= MOST_FRAMES) || !(fabs(m->shift) <= MOST_FRAMES) ||
        !(m->duration >= 1 && m->duration <= MOST_FRAMES) ||
        !(m->frames >= 1 && m->frames <= MOST_FRAMES) ||
        !(m->least_width > 0 && m->least_width <= MOST_FRAMES))
        return spin_malformed("'%s': inconsistent settings: key frames every %g frames from frame "
                              "%g on, %g frames in the clip, duration %g, var_pad %g",
                              m->base.path, m->interval, -m->shift, m->frames, m->duration,
                              given->var_pad);
    if (m->is_chkpnt)
        note_differences(m, given->interval, shift);
    if (given->first > 0)
        spin_note(sequence, "start_timestamp=%g: this frame of the recording is at time 0",
                  given->first);
    return SPIN_OK;
}

static spin_status read_settings(struct model *m)
{
    struct spin_model *base = &m->base;
    const char *folder = base->path;
    struct given given;

    if (m->is_chkpnt)
        SPIN_TRY(spin_model_folder(base, &folder, base->path));
    SPIN_TRY(spin_model_cfg(base, folder, m->is_chkpnt ? NULL : base->path));
    SPIN_TRY(read_given(base, &given));
    return apply_settings(m, &given);
}

/* ---- Columns --------------------------------------------------------------------------------- */

/* Where each column is stored. width: floats per row or, if `keyed`, per row and key frame. still,
 * moving: index of the column in the checkpoint's tuple for static and for dynamic Gaussians; 0 if
 * these have no such column. SH occupies two consecutive items of the tuple: degree 0, then all
 * other degrees. tensor: name for messages. stem: prefix of the names of the PLY properties. */
static const struct {
    size_t width;
    bool keyed;
    int still, moving;
    const char *tensor, *stem;
} kinds[N_COLUMNS] = {
    [PLACE] = {3, true, 1, 23, "xyz", "xyz_"},
    [ROTATION] = {4, true, 5, 30, "rotation", "rot_"},
    [SCALE] = {3, false, 4, 26, "scaling", "scale_"},
    [OPACITY] = {1, false, 6, 27, "opacity", "opacity"},
    [SH] = {0, false, 2, 24, "features_dc", "f_"},
    [DRIFT] = {3, false, 18, 0, "xyz_disp", "xyz_disp_"},
    [CENTRE] = {2, false, 0, 28, "opacity center", "opacity_c_"},
    [WIDTH] = {2, false, 0, 29, "opacity var", "opacity_v_"},
};

static int item_of(const struct part *p, int column)
{
    return p->moving ? kinds[column].moving : kinds[column].still;
}

static size_t n_sh(int degree) { return (size_t)((degree + 1) * (degree + 1)); }

/* Returns the number of floats per row of a column; 0: these Gaussians have no such column. */
static size_t width_of(const struct part *p, int column)
{
    if (item_of(p, column) == 0)
        return 0;
    if (column == SH)
        return 3 * n_sh(p->sh_degree);
    return kinds[column].width * (kinds[column].keyed ? (size_t)p->n_keys : 1);
}

static spin_status reserve(struct spin_model *m, struct part *p)
{
    for (int c = 0; c < N_COLUMNS; c++) {
        if (width_of(p, c) > 0)
            SPIN_TRY(
                spin_model_alloc(m, p->n, width_of(p, c) * sizeof(float), (void **)&p->column[c]));
    }
    return SPIN_OK;
}

/* Returns the SH degree with n coefficients per colour channel, or -1 if there is none. */
static int degree_of(uint64_t n)
{
    for (int d = 0; d <= 3; d++) {
        if (n == n_sh(d))
            return d;
    }
    return -1;
}

/* ---- Checkpoint ------------------------------------------------------------------------------ */

/* Writes and returns the name of an item for messages, such as "motion xyz (item 23)". */
static const char *item_name(const struct part *p, const char *tensor, int item, char text[64])
{
    snprintf(text, 64, "%s%s (item %d)", p->moving ? "motion " : "", tensor, item);
    return text;
}

/* Reads a column other than SH: [n][width], [n][keys][width], or [n][2][1] for CENTRE and WIDTH. */
static spin_status take_column(struct spin_model *m, const struct spin_value *model, struct part *p,
                               int column)
{
    int64_t n = (int64_t)p->n, width = (int64_t)kinds[column].width;
    int64_t shape[3] = {n, width, 1};
    int n_dims = kinds[column].moving && !kinds[column].still ? 3 : 2;
    int item = item_of(p, column);
    struct spin_array t;
    char name[64];

    if (p->moving && kinds[column].keyed) {
        shape[1] = p->n_keys;
        shape[2] = width;
        n_dims = 3;
    }
    SPIN_TRY(spin_chkpnt_bind(&m->torch, spin_value_at(model, (size_t)item),
                              item_name(p, kinds[column].tensor, item, name), n_dims, shape, &t));
    spin_array_to_f32(&t, 0, t.count, p->column[column]);
    return SPIN_OK;
}

/* Reads SH up to the degree `active`. The checkpoint also contains higher degrees, but training had
 * not used these yet when it wrote the checkpoint. */
static spin_status take_sh(struct spin_model *m, const struct spin_value *model, int active,
                           struct part *p)
{
    int item = item_of(p, SH);
    int64_t one[3] = {(int64_t)p->n, 1, 3}, all[3] = {(int64_t)p->n, -1, 3};
    struct spin_array dc, rest;
    size_t width;
    char name[64];

    SPIN_TRY(spin_chkpnt_bind(&m->torch, spin_value_at(model, (size_t)item),
                              item_name(p, "features_dc", item, name), 3, one, &dc));
    SPIN_TRY(spin_chkpnt_bind(&m->torch, spin_value_at(model, (size_t)item + 1),
                              item_name(p, "features_rest", item + 1, name), 3, all, &rest));
    p->sh_degree = degree_of(rest.shape[1] + 1);
    if (p->sh_degree < 0)
        return spin_malformed("%s has %llu rows of SH, expected 0, 3, 8 or 15", name,
                              (unsigned long long)rest.shape[1]);
    p->sh_degree = active < p->sh_degree ? active : p->sh_degree;
    SPIN_TRY(reserve(m, p));
    width = width_of(p, SH);
    for (size_t i = 0; i < p->n; i++) {
        spin_array_to_f32(&dc, 3 * i, 3, p->column[SH] + width * i);
        if (width > 3)
            spin_array_to_f32(&rest, 3 * rest.shape[1] * i, width - 3,
                              p->column[SH] + width * i + 3);
    }
    return SPIN_OK;
}

/* Checks that all tensors of a part without Gaussians are empty, whatever their shapes. Dynamic
 * Gaussians do not exist until training creates them. */
static spin_status check_empty(const struct spin_value *model, const struct part *p)
{
    for (int c = 0; c < N_COLUMNS; c++) {
        int item = item_of(p, c);

        if (item > 0 && !spin_chkpnt_is_empty(spin_value_at(model, (size_t)item)))
            return spin_malformed("item %d (%s%s) is not empty, but item %d (%sxyz) is empty", item,
                                  p->moving ? "motion " : "", kinds[c].tensor, item_of(p, PLACE),
                                  p->moving ? "motion " : "");
    }
    return SPIN_OK;
}

/* Reads a part from the tuple of a checkpoint, with SH up to the degree `active`. A part that
 * training has not created yet has n = 0. */
static spin_status part_of_chkpnt(struct spin_model *m, const struct spin_value *model, int active,
                                  struct part *p)
{
    static const int64_t keyed[3] = {-1, -1, 3}, plain[2] = {-1, 3};
    int item = item_of(p, PLACE);
    const struct spin_value *place = spin_value_at(model, (size_t)item);
    struct spin_array t;
    char name[64];

    p->n_keys = 1;
    if (spin_chkpnt_is_empty(place))
        return check_empty(model, p);
    SPIN_TRY(spin_chkpnt_bind(&m->torch, place, item_name(p, "xyz", item, name), p->moving ? 3 : 2,
                              p->moving ? keyed : plain, &t));
    if (p->moving && t.shape[1] > MOST_KEYS)
        return spin_malformed("%s has %llu key frames, expected at most %d", name,
                              (unsigned long long)t.shape[1], MOST_KEYS);
    p->n = (size_t)t.shape[0];
    p->n_keys = p->moving ? (int)t.shape[1] : 1;
    SPIN_TRY(take_sh(m, model, active, p));
    for (int c = 0; c < N_COLUMNS; c++) {
        if (p->column[c] && c != SH)
            SPIN_TRY(take_column(m, model, p, c));
    }
    return SPIN_OK;
}

/* ---- PLYs ------------------------------------------------------------------------------------ */

/* Writes the name of the PLY property that contains value `at` of a row of the column, such as "x",
 * "rot_0" or "motion_xyz_12_0". f_rest_* are stored channel by channel. */
static void name_property(const struct part *p, int column, int at, char text[64])
{
    const char *who = p->moving ? "motion_" : "", *stem = kinds[column].stem;
    int width = (int)kinds[column].width, rest = (int)n_sh(p->sh_degree) - 1;

    if (column == SH && at < 3)
        snprintf(text, 64, "%sf_dc_%d", who, at);
    else if (column == SH)
        snprintf(text, 64, "%sf_rest_%d", who, at % 3 * rest + at / 3 - 1);
    else if (p->moving && kinds[column].keyed)
        snprintf(text, 64, "%s%s%d_%d", who, stem, at / width, at % width);
    else if (column == PLACE)
        snprintf(text, 64, "%c", "xyz"[at]);
    else if (column == OPACITY)
        snprintf(text, 64, "%s%s", who, stem);
    else
        snprintf(text, 64, "%s%s%d", who, stem, at);
}

/* Derives the degree of SH and the number of key frames from the property names. */
static spin_status count_properties(const char *path, const struct spin_ply_element *e,
                                    struct part *p)
{
    int rest = spin_model_count(e, p->moving ? "motion_f_rest_" : "f_rest_");
    int places = spin_model_count(e, "motion_xyz_");
    int turns = spin_model_count(e, "motion_rot_");

    p->n_keys = p->moving ? places / 3 : 1;
    p->sh_degree = rest % 3 == 0 ? degree_of((uint64_t)rest / 3 + 1) : -1;
    if (p->sh_degree < 0)
        return spin_malformed("'%s' has %d properties %sf_rest_*, expected 0, 9, 24 or 45", path,
                              rest, p->moving ? "motion_" : "");
    if (p->moving && (places % 3 != 0 || turns != 4 * p->n_keys))
        return spin_malformed("'%s' has %d properties motion_xyz_* and %d motion_rot_*, expected 3 "
                              "and 4 for every key frame",
                              path, places, turns);
    return SPIN_OK;
}

/* Reads a part from point_cloud.ply or dynamic_point_cloud.ply, all columns in one pass over the
 * file. */
static spin_status part_of_ply(struct spin_model *m, struct part *p)
{
    const struct spin_ply_element *e;
    struct spin_ply_target *target;
    const char *path;
    size_t n = 0;

    SPIN_TRY(spin_model_join(m, &path, m->path, "%s",
                             p->moving ? "dynamic_point_cloud.ply" : "point_cloud.ply"));
    SPIN_TRY(spin_model_ply(m, path));
    SPIN_TRY(spin_ply_vertices(&m->ply, &e));
    SPIN_TRY(count_properties(path, e, p));
    for (int c = 0; c < N_COLUMNS; c++)
        n += width_of(p, c);
    SPIN_TRY(spin_model_scratch(m, n, sizeof *target, (void **)&target));
    p->n = (size_t)e->count;
    SPIN_TRY(reserve(m, p));
    n = 0;
    for (int c = 0; c < N_COLUMNS; c++) {
        for (size_t at = 0; at < width_of(p, c); at++, n++) {
            char name[64];

            name_property(p, c, (int)at, name);
            target[n] =
                (struct spin_ply_target){spin_ply_find(e, name), p->column[c] + at, width_of(p, c)};
            if (target[n].property < 0)
                return spin_malformed("'%s': element 'vertex' has no property '%s'", path, name);
        }
    }
    spin_ply_columns(&m->ply, e, target, n);
    return SPIN_OK;
}

/* ---- Rows that can be drawn ------------------------------------------------------------------ */

/* Replaces the scales and the quaternion of a static Gaussian by those of the ellipsoid that the
 * method's rasteriser draws. The rasteriser does not normalise the quaternion, so the drawn
 * ellipsoid is different if the norm of the quaternion is not 1. Returns false if the result is not
 * an ellipsoid. */
static bool set_drawn_shape(float log_scale[3], float quat[4])
{
    double scale[3], raw[4], cov6[6], split[3], unit[4];

    if (fabs(spin_quat_norm(quat) - 1) <= 1e-6) {
        spin_quat_normalise(quat);
        return true;
    }
    for (int c = 0; c < 4; c++)
        raw[c] = quat[c];
    for (int c = 0; c < 3; c++)
        scale[c] = exp(log_scale[c]);
    spin_covariance_unnormalised(scale, raw, cov6);
    if (!spin_covariance_split(cov6, split, unit))
        return false;
    for (int c = 0; c < 3; c++)
        log_scale[c] = (float)split[c];
    for (int c = 0; c < 4; c++)
        quat[c] = (float)unit[c];
    return true;
}

static bool check_row(const struct part *p, size_t row)
{
    const size_t keys = (size_t)p->n_keys;

    for (int c = 0; c < N_COLUMNS; c++) {
        size_t width = width_of(p, c);

        for (size_t i = 0; i < width; i++) {
            if (!(fabsf(p->column[c][width * row + i]) < LARGEST))
                return false;
        }
    }
    for (size_t k = 0; k < keys && p->moving; k++) {
        if (!(spin_quat_norm(p->column[ROTATION] + 4 * (keys * row + k)) > 0))
            return false;
    }
    return p->moving || set_drawn_shape(p->column[SCALE] + 3 * row, p->column[ROTATION] + 4 * row);
}

/* Drops the rows of `p` that cannot be drawn, and returns their number. If the Gaussians are
 * static, also replaces their shapes as described at set_drawn_shape(). */
static size_t drop_undrawable(struct part *p)
{
    size_t n_all = p->n;

    p->n = 0;
    for (size_t i = 0; i < n_all; i++) {
        if (!check_row(p, i))
            continue;
        for (int c = 0; c < N_COLUMNS && p->n != i; c++) {
            size_t width = width_of(p, c);

            if (width > 0)
                memcpy(p->column[c] + width * p->n, p->column[c] + width * i,
                       width * sizeof(float));
        }
        p->n++;
    }
    return n_all - p->n;
}

/* ---- Opening --------------------------------------------------------------------------------- */

static spin_status take_number(const struct spin_value *model, size_t item, const char *name,
                               double *out)
{
    const struct spin_value *v = spin_value_at(model, item);

    if (!v || v->kind != SPIN_VALUE_INT || !spin_value_number(v, out))
        return spin_malformed("item %zu (%s) is %s, expected an int", item, name,
                              spin_chkpnt_kind(v));
    return SPIN_OK;
}

static spin_status take_model(struct spin_model *base)
{
    struct model *m = (struct model *)base;
    const struct spin_value *model;
    double active, iteration;

    SPIN_TRY(spin_chkpnt_model(base->torch.root, N_ITEMS, "Ex4DGS", &model, &iteration));
    SPIN_TRY(take_number(model, 0, "the active SH degree", &active));
    SPIN_TRY(take_number(model, 19, "duration", &m->duration));
    SPIN_TRY(take_number(model, 20, "interval", &m->interval));
    SPIN_TRY(take_number(model, 21, "time_shift", &m->shift));
    if (active < 0 || active > 3)
        return spin_malformed("the active SH degree is %g, expected 0 to 3", active);
    SPIN_TRY(part_of_chkpnt(base, model, (int)active, &m->still));
    return part_of_chkpnt(base, model, (int)active, &m->moving);
}

static spin_status read_parts(struct model *m)
{
    size_t n_all, n_dropped;

    if (m->is_chkpnt) {
        SPIN_TRY(spin_model_torch(&m->base, m->base.path, take_model));
    } else {
        SPIN_TRY(part_of_ply(&m->base, &m->still));
        SPIN_TRY(part_of_ply(&m->base, &m->moving));
    }
    if (m->still.n > 0 && m->moving.n > 0 && m->still.sh_degree != m->moving.sh_degree)
        return spin_malformed("'%s': the SH of static Gaussians have degree %d, those of dynamic "
                              "ones %d, expected the same",
                              m->base.path, m->still.sh_degree, m->moving.sh_degree);
    m->sh_degree = m->still.n > 0 ? m->still.sh_degree : m->moving.sh_degree;
    n_all = m->still.n + m->moving.n;
    n_dropped = drop_undrawable(&m->still) + drop_undrawable(&m->moving);
    m->n = n_all - n_dropped;
    if (m->n == 0)
        return spin_malformed("'%s': none of the %zu Gaussians has finite values", m->base.path,
                              n_all);
    if (n_dropped > 0)
        spin_note(m->base.sequence,
                  "%s dropped because of values that are not finite, or rotations of length 0",
                  spin_text_share(n_dropped, n_all, "Gaussian", "is", "are", (char[96]){0}));
    return SPIN_OK;
}

static spin_status open_model(void *self, const char *path)
{
    struct model *m = self;
    struct spin_sequence_info *sequence = m->base.sequence;

    m->moving.moving = true;
    SPIN_TRY(find_files(path, m));
    SPIN_TRY(read_parts(m));
    SPIN_TRY(read_settings(m));
    spin_model_describe(&m->base, &m->n, m->sh_degree,
                        SPIN_COL_MEANS |
                            (m->moving.n > 0 ? SPIN_COL_QUATS | SPIN_COL_LOGIT_OPACITIES : 0));
    sequence->identity = false;
    sequence->antialias = true;
    sequence->counts_frames = true;
    sequence->time_last = m->frames - 1;
    snprintf(
        sequence->variant, sizeof sequence->variant,
        "Ex4DGS, %.24s, %zu static, %zu dynamic Gaussians, %s between key frames %g frames apart",
        m->is_chkpnt ? spin_path_name(m->base.path) : "two PLYs", m->still.n, m->moving.n,
        kind_names[m->kind], m->interval);
    spin_note(sequence, "times are frames, 0 to %g", m->frames - 1);
    if (!m->is_chkpnt)
        spin_note(sequence,
                  "read from the PLYs of %s: static Gaussians drift over %g frames, as stated in "
                  "cfg_args; the method's renderer prefers the checkpoint, which stores a slightly "
                  "larger number",
                  spin_path_name(m->base.path), m->duration);
    if (m->moving.n > 0)
        spin_note(sequence,
                  "4D splats are segments between key frames, with rotations within %g degrees of "
                  "the method's; segments fainter than 1/255 are left out",
                  NEAR);
    spin_note(sequence,
              "the method dims thin splats with a low-pass filter of 0.1 square pixels; the "
              "imported splats are drawn antialiased instead, which has a similar effect");
    return SPIN_OK;
}

/* ---- The splats at one time ------------------------------------------------------------------ */

static spin_status find_keys(const struct model *m, double time, struct keyframes *out)
{
    double at = time + m->shift, key = floor(at / m->interval);
    int beside = m->kind == KEYFRAMES_LINEAR ? 0 : 1;

    if (!(time >= 0 && time <= m->frames - 1))
        return spin_not_found("'%s' has no time %g: its times are 0 to %g", m->base.path, time,
                              m->frames - 1);
    if (m->moving.n > 0 && (key < beside || key + 1 + beside >= m->moving.n_keys))
        return spin_unsupported(
            "'%s': time %g needs the key frames %g to %g, but the model has only %d", m->base.path,
            time, key - beside, key + 1 + beside, m->moving.n_keys);
    *out = (struct keyframes){m->kind, (int)key, (at - key * m->interval) / m->interval,
                              at / m->interval};
    return SPIN_OK;
}

static void put_still(const struct model *m, double time, unsigned columns, struct spin_splats *out)
{
    const struct part *p = &m->still;

    for (size_t i = 0; i < 3 * p->n && (columns & SPIN_COL_MEANS); i++)
        out->means[i] =
            (float)(p->column[PLACE][i] + (double)p->column[DRIFT][i] * time / m->duration);
    for (size_t i = 0; i < 4 * p->n && (columns & SPIN_COL_QUATS); i++)
        out->quats[i] = p->column[ROTATION][i];
    for (size_t i = 0; i < p->n && (columns & SPIN_COL_LOGIT_OPACITIES); i++)
        out->logit_opacities[i] = p->column[OPACITY][i];
}

static void put_moving(const struct model *m, const struct keyframes *at, unsigned columns,
                       struct spin_splats *out)
{
    const struct part *p = &m->moving;
    size_t keys = (size_t)p->n_keys;

    for (size_t i = 0; i < p->n; i++) {
        const float *places = p->column[PLACE] + 3 * keys * i;
        size_t row = m->still.n + i;

        for (size_t c = 0; c < 3 && (columns & SPIN_COL_MEANS); c++)
            out->means[3 * row + c] = (float)spin_keyframes_value(at, places + c, 3);
        if (columns & SPIN_COL_QUATS)
            spin_keyframes_turn(at, p->column[ROTATION] + 4 * keys * i, out->quats + 4 * row);
        if (columns & SPIN_COL_LOGIT_OPACITIES)
            out->logit_opacities[row] =
                spin_logit_of(spin_sigmoid_of(p->column[OPACITY][i]) *
                              spin_keyframes_visibility(at, p->column[CENTRE] + 2 * i,
                                                        p->column[WIDTH] + 2 * i, m->least_width));
    }
}

/* Copies a column that is constant in time: static Gaussians, then dynamic ones. */
static void put_fixed(const struct model *m, int column, size_t width, float *out)
{
    const struct part *const parts[] = {&m->still, &m->moving};

    for (int i = 0; i < 2; i++) {
        size_t n = parts[i]->n * width;

        if (n > 0)
            memcpy(out, parts[i]->column[column], n * sizeof *out);
        out += n;
    }
}

static spin_status ex4dgs_frame(void *self, int frame, double time, unsigned columns,
                                struct spin_splats *out)
{
    struct model *m = self;
    struct keyframes at = {0};

    (void)frame;
    columns &= SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    SPIN_TRY(find_keys(m, time, &at));
    SPIN_TRY(spin_splats_reserve(out, m->n, columns, m->sh_degree));
    out->antialias = true;
    put_still(m, time, columns, out);
    put_moving(m, &at, columns, out);
    if (columns & SPIN_COL_LOG_SCALES)
        put_fixed(m, SCALE, 3, out->log_scales);
    if (columns & SPIN_COL_SH)
        put_fixed(m, SH, 3 * n_sh(m->sh_degree), out->sh);
    return SPIN_OK;
}

/* ---- 4D splats ------------------------------------------------------------------------------- */

/* The path of a Gaussian is cut at a time at which the opacity jumps by more than this. */
#define LEAST_JUMP 1e-6

/* A segment of the path of dynamic Gaussian `row`. It is in the interval from key frame `key` to
 * the next one, from the fraction `from` to the fraction `to` of this interval. */
struct piece {
    size_t row;
    int key;
    double from, to;
};

struct pieces {
    struct piece *piece;
    size_t n, capacity;
    double worst; /* largest error of a rotation in any segment, in degrees */
};

static void turn_at(const struct model *m, const struct piece *p, double part, float out[4])
{
    const struct keyframes at = {m->kind, p->key, part, p->key + part};

    spin_keyframes_turn(&at, m->moving.column[ROTATION] + 4 * (size_t)m->moving.n_keys * p->row,
                        out);
}

/* Computes the chord of a segment's rotation: the quaternion `middle` at the midpoint, and the
 * change from the segment's start to its end. */
static void chord_of(const struct model *m, const struct piece *p, float middle[4], float change[4])
{
    float to[4];

    turn_at(m, p, p->from, middle);
    turn_at(m, p, p->to, to);
    for (int c = 0; c < 4; c++) {
        change[c] = to[c] - middle[c];
        middle[c] += change[c] / 2;
    }
    if (spin_quat_norm(middle) > 1e-3)
        return;
    /* The quaternions at the two ends are opposite, so the chord passes through 0: use the rotation
     * at the start for the whole segment. */
    turn_at(m, p, p->from, middle);
    memset(change, 0, 4 * sizeof *change);
}

/* Returns the largest angle between the chord and the arc at some points of a segment, in degrees.
 */
static double error_of(const struct model *m, const struct piece *p)
{
    float middle[4], change[4], arc[4];
    double worst = 0;

    chord_of(m, p, middle, change);
    for (int k = 1; k < 5; k++) {
        double q, apart[2] = {0, 0}, length = 0;

        for (int c = 0; c < 4; c++)
            length += pow(middle[c] + (k / 5.0 - 0.5) * change[c], 2);
        turn_at(m, p, p->from + k * (p->to - p->from) / 5, arc);
        for (int c = 0; c < 4; c++) {
            q = (middle[c] + (k / 5.0 - 0.5) * change[c]) / sqrt(length);
            apart[0] += pow(q - arc[c], 2);
            apart[1] += pow(q + arc[c], 2);
        }
        worst = fmax(worst, 4 * asin(sqrt(fmin(apart[0], apart[1])) / 2));
    }
    return worst * 180 / 3.141592653589793;
}

/* Returns the largest factor by which the window multiplies the opacity within a segment. */
static double peak_of(const struct model *m, const struct piece *p)
{
    const float *centre = m->moving.column[CENTRE] + 2 * p->row;
    double low = fmin(centre[0], centre[1]), high = fmax(centre[0], centre[1]);
    struct keyframes at = {m->kind, p->key, p->from, p->key + p->from};

    if (p->key + p->to > low && at.time < high)
        return 1;
    if (at.time < high)
        at.time = p->key + p->to;
    return spin_keyframes_visibility(&at, centre, m->moving.column[WIDTH] + 2 * p->row,
                                     m->least_width);
}

static spin_status add_piece(const struct model *m, struct pieces *all, struct piece p,
                             int halvings)
{
    double error = error_of(m, &p), middle = (p.from + p.to) / 2;
    struct piece first = {p.row, p.key, p.from, middle};

    if (error > NEAR && halvings > 0) {
        SPIN_TRY(add_piece(m, all, first, halvings - 1));
        p.from = middle;
        return add_piece(m, all, p, halvings - 1);
    }
    if (peak_of(m, &p) * spin_sigmoid_of(m->moving.column[OPACITY][p.row]) < LEAST_OPACITY)
        return SPIN_OK;
    all->worst = fmax(all->worst, error);
    SPIN_TRY(spin_array_grow(all->n, &all->capacity, sizeof *all->piece, (void **)&all->piece));
    all->piece[all->n++] = p;
    return SPIN_OK;
}

/* Returns the earlier of the two times between which a Gaussian is opaque, in key frames, if the
 * opacity jumps at this time; otherwise NAN. */
static double jump_of(const struct model *m, size_t row)
{
    const float *centre = m->moving.column[CENTRE] + 2 * row;
    struct keyframes at = {m->kind, 0, 0, fmin(centre[0], centre[1])};
    double before =
        spin_keyframes_visibility(&at, centre, m->moving.column[WIDTH] + 2 * row, m->least_width);

    return 1 - before > LEAST_JUMP ? at.time : NAN;
}

static spin_status find_pieces(const struct model *m, int first, int last, struct pieces *all)
{
    for (size_t row = 0; row < m->moving.n; row++) {
        double jump = jump_of(m, row);

        for (int key = first; key <= last; key++) {
            struct piece p = {row, key, 0, 1};

            if (jump > key && jump < key + 1) {
                struct piece before = {row, key, 0, jump - key};

                SPIN_TRY(add_piece(m, all, before, HALVINGS));
                p.from = before.to;
            }
            SPIN_TRY(add_piece(m, all, p, HALVINGS));
        }
    }
    return SPIN_OK;
}

static double time_of(const struct model *m, double key) { return key * m->interval - m->shift; }

/* Returns the time rounded to a float. If `inside`, returns the first float after the time, so that
 * the time itself is before the cut. */
static float cut_at(double time, bool inside)
{
    float cut = (float)time;

    return inside && (double)cut <= time ? nextafterf(cut, SPIN_FOREVER) : cut;
}

/* Returns the standard deviation of an edge of the window, in frames. The method's edges are
 * exp(-x^2), without the factor 1/2 of a Gaussian. The exponential of the width may overflow, so
 * the result is at most SPIN_FOREVER. */
static float sigma_of(const struct model *m, double log_width)
{
    return (float)fmin((exp(log_width) + m->least_width) * m->interval / sqrt(2),
                       (double)SPIN_FOREVER);
}

static void fill_window(const struct model *m, const struct piece *p, size_t i)
{
    const struct spin_splats_4d *s = &m->base.splats_4d;
    const float *centre = m->moving.column[CENTRE] + 2 * p->row;
    const float *width = m->moving.column[WIDTH] + 2 * p->row;
    double low = fmin(centre[0], centre[1]), high = fmax(centre[0], centre[1]);
    double jump = jump_of(m, p->row), from = p->key + p->from, to = p->key + p->to;
    bool on = from >= jump;

    /* The method measures both edges from the later time, so the opacity jumps at the earlier time,
     * and segments are cut there. Only segments after the jump have a plateau between the two
     * times. */
    s->plateaus[3 * i] = (float)time_of(m, on ? low : high);
    s->plateaus[3 * i + 1] = (float)time_of(m, high);
    s->plateaus[3 * i + 2] = sigma_of(m, (double)width[1]);
    s->sigmas[i] = sigma_of(m, (double)width[0]);
    s->cuts[2 * i] = cut_at(time_of(m, from), from == jump);
    s->cuts[2 * i + 1] = cut_at(time_of(m, to), to == jump);
}

static void fill_piece(const struct model *m, const struct piece *p, size_t i)
{
    const struct spin_splats_4d *s = &m->base.splats_4d;
    const struct part *moving = &m->moving;
    const float *places = moving->column[PLACE] + 3 * (size_t)moving->n_keys * p->row;
    double u = (p->from + p->to) / 2, c[4];
    float *path = s->paths + 3 * (size_t)s->degree * i;

    s->times[i] = (float)time_of(m, p->key + u);
    u = (s->times[i] + m->shift) / m->interval -
        p->key; /* recompute u, since the time was rounded to a float */
    for (int axis = 0; axis < 3; axis++) {
        spin_keyframes_cubic(m->kind, p->key, places + axis, 3, c);
        s->centres[3 * i + (size_t)axis] = (float)(c[0] + u * (c[1] + u * (c[2] + u * c[3])));
        path[axis] = (float)((c[1] + u * (2 * c[2] + 3 * u * c[3])) / m->interval);
        if (s->degree == 3) {
            path[3 + axis] = (float)((c[2] + 3 * u * c[3]) / pow(m->interval, 2));
            path[6 + axis] = (float)(c[3] / pow(m->interval, 3));
        }
    }
    chord_of(m, p, s->quats + 4 * i, s->spins + 4 * i);
    for (size_t k = 0; k < 4; k++)
        s->spins[4 * i + k] /= (float)((p->to - p->from) * m->interval);
    s->logit_opacities[i] = moving->column[OPACITY][p->row];
    fill_window(m, p, i);
}

static void fill_still(const struct model *m, size_t i)
{
    const struct spin_splats_4d *s = &m->base.splats_4d;
    const struct part *p = &m->still;

    for (size_t c = 0; c < 3; c++) {
        s->centres[3 * i + c] = p->column[PLACE][3 * i + c];
        s->paths[3 * (size_t)s->degree * i + c] =
            (float)((double)p->column[DRIFT][3 * i + c] / m->duration);
    }
    memcpy(s->quats + 4 * i, p->column[ROTATION] + 4 * i, 4 * sizeof(float));
    s->logit_opacities[i] = p->column[OPACITY][i];
    s->sigmas[i] = SPIN_FOREVER;
    if (s->cuts) {
        s->plateaus[3 * i + 2] = s->cuts[2 * i + 1] = SPIN_FOREVER;
        s->cuts[2 * i] = -SPIN_FOREVER;
    }
}

static spin_status fill_splats(struct model *m, const struct pieces *all)
{
    const unsigned parts = SPIN_4D_SPINS | SPIN_4D_PLATEAUS | SPIN_4D_CUTS;
    struct spin_splats_4d *s = &m->base.splats_4d;
    size_t n = m->still.n + all->n, n_dropped;

    SPIN_TRY(spin_splats_4d_reserve(s, n, all->n > 0 && m->kind != KEYFRAMES_LINEAR ? 3 : 1,
                                    m->sh_degree, all->n > 0 ? parts : 0));
    s->antialias = true;
    for (size_t i = 0; i < n; i++) {
        bool still = i < m->still.n;
        const struct part *part = still ? &m->still : &m->moving;
        size_t row = still ? i : all->piece[i - m->still.n].row, width = width_of(part, SH);

        if (still)
            fill_still(m, i);
        else
            fill_piece(m, &all->piece[i - m->still.n], i);
        memcpy(s->log_scales + 3 * i, part->column[SCALE] + 3 * row, 3 * sizeof(float));
        memcpy(s->sh + width * i, part->column[SH] + width * row, width * sizeof(float));
    }
    SPIN_TRY(spin_splats_4d_finish(s, &n_dropped, NULL));
    if (n_dropped > 0)
        spin_warn("'%s': %zu of %zu 4D splats dropped, since values of their paths are too large "
                  "for floats",
                  m->base.path, n_dropped, n);
    return SPIN_OK;
}

/* Sets *out to NULL if the model lacks key frames that a time of the clip requires. frame() then
 * still works at all other times. */
static spin_status ex4dgs_splats_4d(void *self, const struct spin_splats_4d **out)
{
    struct model *m = self;
    struct keyframes first, last;
    struct pieces all = {0};
    spin_status status = SPIN_OK;

    *out = NULL;
    if (m->base.splats_4d.n == 0) {
        if (find_keys(m, 0, &first) != SPIN_OK || find_keys(m, m->frames - 1, &last) != SPIN_OK)
            return SPIN_OK;
        status = find_pieces(m, first.key, last.key, &all);
        if (status == SPIN_OK)
            status = fill_splats(m, &all);
        free(all.piece);
        if (all.worst > NEAR)
            spin_warn("'%s': rotations of 4D splats are up to %.2g degrees off where key frames "
                      "differ much: use --frames for exact rotations",
                      m->base.path, all.worst);
    }
    *out = m->base.splats_4d.n > 0 ? &m->base.splats_4d : NULL;
    return status;
}

static const struct spin_plugin_option options[] = {
    {"iteration", "N", "the checkpoint to read (default: the last)", NULL},
    {"interp", "WORD",
     "interpolation between key frames: linear, cube or pchip (default: as in cfg_args)", NULL},
    {"interval", "N", "frames from one key frame to the next (default: as in cfg_args)", NULL},
    {"time-pad", "N", "the option time_pad of the run (default: as in cfg_args)", NULL},
    {"duration", "N", "frames of the clip (default: as in cfg_args)", NULL},
    {NULL, NULL, NULL, NULL},
};

SPIN_MODEL_IMPORTER(
    ex4dgs, struct model, open_model, spin_model_close,
    .summary = "Ex4DGS: the model's folder, with cfg_args and chkpnt<N>.pth or both PLYs",
    .upstream = "juno181/Ex4DGS 7fac649", .options = options, .probe = probe, .frame = ex4dgs_frame,
    .splats_4d = ex4dgs_splats_4d)
