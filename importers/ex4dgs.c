/* Ex4DGS (Lee et al., NeurIPS 2024): static Gaussians that drift along lines, and dynamic ones whose
 * positions and rotations are interpolated between key frames and whose opacity is on between two times.
 *
 * A run leaves a checkpoint and two PLYs, which agree but for one number: the drift is divided by the
 * length of the clip, which the checkpoint has, while for the PLYs it is that of cfg_args. The method's
 * renderer takes the checkpoint when it is there, and so does this importer. Key frames' distance and
 * shift are in the checkpoint too, but how to go between them is in cfg_args only. */
#include "spin.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/option.h"
#include "importers/lib/chkpnt.h"
#include "importers/lib/ex4dgs_part.h"
#include "importers/lib/gaussian4d.h"
#include "importers/lib/keyframes.h"
#include "importers/lib/model_folder.h"
#include "importers/lib/notes.h"

enum { N_ITEMS = 40, MOST_FRAMES = 1000000 };

static const char *const kind_names[] = {
    [KEYFRAMES_LINEAR] = "linear", [KEYFRAMES_CUBE] = "cube", [KEYFRAMES_PCHIP] = "pchip"};

struct model {
    char *path; /* of the checkpoint, or of the folder with the PLYs */
    bool is_chkpnt;
    struct ex4dgs_part still, moving;
    int sh_degree;
    size_t n;
    enum keyframes_kind kind;
    double interval;    /* frames from one key frame to the next */
    double shift;       /* frames from the first key frame to time 0 */
    double duration;    /* frames in which a static Gaussian goes as far as its drift */
    double frames;      /* of the clip: times run from 0 to frames - 1 */
    double least_width; /* of the edges of opacity, in key frames */
};

/* ---- Recognising ----------------------------------------------------------------------------- */

/* By properties of its PLYs, an option of cfg_args, or a group of a checkpoint's optimiser. */
static int probe(const struct spin_peek *peek)
{
    bool ply = spin_chkpnt_says(peek, " xyz_disp_0") || spin_chkpnt_says(peek, " motion_xyz_0_0");

    if (ply && !peek->is_folder)
        return 100;
    return ply || spin_chkpnt_says(peek, "rot_interp_type=") ||
                   spin_chkpnt_says(peek, "motion_opacity_center")
               ? 95
               : 0;
}

/* ---- Finding the files ----------------------------------------------------------------------- */

/* The newest save with either PLY; that the other is missing is said when it is read. */
static spin_status newest_save(const char *clouds, const char *wanted, char **out)
{
    static const char *const files[] = {"point_cloud.ply", "dynamic_point_cloud.ply"};

    for (int i = 0; i < 2; i++) {
        struct model_folder_pick pick = {clouds, files[i], NULL, NULL};
        char *name = NULL;

        SPIN_TRY(spin_model_folder_choose(&pick, wanted, &name));
        if (name &&
            (!*out || spin_model_folder_iteration(name) > spin_model_folder_iteration(*out))) {
            free(*out);
            *out = name;
        } else {
            free(name);
        }
    }
    return SPIN_OK;
}

/* The newest save, and of its two forms the checkpoint. */
static spin_status find_in_model(const char *path, const char *wanted, struct model *m)
{
    char *clouds = NULL, *save = NULL, *chkpnt = NULL;
    bool best;
    spin_status status;

    SPIN_TRY_OUT(spin_path_join(path, "point_cloud", &clouds));
    if (spin_path_is_folder(clouds))
        SPIN_TRY_OUT(newest_save(clouds, wanted, &save));
    SPIN_TRY_OUT(spin_chkpnt_choose(path, wanted, &chkpnt, &best));
    m->is_chkpnt =
        chkpnt && (!save || spin_chkpnt_iteration(chkpnt) >= spin_model_folder_iteration(save));
    if (m->is_chkpnt)
        status = spin_path_join(path, chkpnt, &m->path);
    else if (save)
        status = spin_path_join(clouds, save, &m->path);
    else
        status = spin_fail(SPIN_E_NOT_FOUND,
                           "'%s' holds neither chkpnt%s.pth nor point_cloud/iteration_%s", path,
                           wanted ? wanted : "<N>", wanted ? wanted : "<N>");
out:
    free(clouds);
    free(save);
    free(chkpnt);
    return status;
}

/* `path` is the model's folder, a checkpoint, a folder with the PLYs, or one of them. */
static spin_status find_files(const char *path, const char *wanted, struct model *m)
{
    const char *dot = strrchr(spin_path_name(path), '.');

    if (!spin_path_is_folder(path)) {
        m->is_chkpnt = !dot || strcmp(dot, ".ply") != 0;
        return m->is_chkpnt ? spin_strdup(path, &m->path) : spin_path_folder(path, &m->path);
    }
    if (spin_model_folder_holds(path, "dynamic_point_cloud.ply") ||
        spin_model_folder_holds(path, "point_cloud.ply"))
        return spin_strdup(path, &m->path);
    return find_in_model(path, wanted, m);
}

/* ---- Settings -------------------------------------------------------------------------------- */

/* What options and cfg_args say; NAN: nothing. */
struct told {
    double interval, pad, frames, var_pad, first;
    int kind; /* -1: nothing */
};

static spin_status read_number(const struct spin_plugin_values *values, const char *option,
                               double least, const struct cfg_args *cfg, const char *key,
                               double *out)
{
    if (spin_plugin_value(values, option, NULL))
        return spin_option_number(values, option, least, MOST_FRAMES, out);
    return spin_cfg_read_number(cfg, key, out);
}

static spin_status read_kind(const struct spin_plugin_values *values, const struct cfg_args *cfg,
                             int *out)
{
    struct cfg_span span = spin_cfg_get(cfg, "interp_type");

    if (spin_plugin_value(values, "interp", NULL))
        return spin_option_word(values, "interp", "linear|cube|pchip", out);
    if (!span.at)
        return SPIN_OK;
    if (span.end - span.at >= 2)
        span = (struct cfg_span){span.at + 1, span.end - 1}; /* without quotes */
    for (int i = 0; i < 3; i++) {
        if (spin_cfg_is(span, kind_names[i])) {
            *out = i;
            return SPIN_OK;
        }
    }
    return spin_fail(SPIN_E_UNSUPPORTED,
                     "'%s': interp_type is '%.*s', expected linear, cube or pchip", cfg->path,
                     (int)(span.end - span.at), span.at);
}

static spin_status read_told(const struct spin_plugin_values *values, const struct cfg_args *cfg,
                             struct told *told)
{
    struct cfg_span turn = spin_cfg_get(cfg, "rot_interp_type");

    *told = (struct told){NAN, NAN, NAN, 3, 0, -1};
    if (turn.at && !spin_cfg_is(turn, "'slerp'"))
        return spin_fail(SPIN_E_UNSUPPORTED, "'%s': rot_interp_type is %.*s, expected 'slerp'",
                         cfg->path, (int)(turn.end - turn.at), turn.at);
    SPIN_TRY(read_number(values, "interval", 1, cfg, "time_interval", &told->interval));
    SPIN_TRY(read_number(values, "time-pad", 0, cfg, "time_pad", &told->pad));
    SPIN_TRY(read_number(values, "duration", 1, cfg, "duration", &told->frames));
    SPIN_TRY(spin_cfg_read_number(cfg, "var_pad", &told->var_pad));
    SPIN_TRY(spin_cfg_read_number(cfg, "start_timestamp", &told->first));
    return read_kind(values, cfg, &told->kind);
}

/* What must be known and is not. A checkpoint lacks the kind of interpolation only. */
static spin_status check_told(const struct model *m, const struct told *told)
{
    const struct {
        bool missing;
        const char *key, *option;
    } all[] = {
        {told->kind < 0, "interp_type", "interp"},
        {!m->is_chkpnt && isnan(told->interval), "time_interval", "interval"},
        {!m->is_chkpnt && isnan(told->pad), "time_pad", "time-pad"},
        {!m->is_chkpnt && isnan(told->frames), "duration", "duration"},
    };

    for (int i = 0; i < 4; i++) {
        if (all[i].missing)
            return spin_fail(SPIN_E_NOT_FOUND, "'%s': no cfg_args beside it says %s: use --%s",
                             m->path, all[i].key, all[i].option);
    }
    return SPIN_OK;
}

/* The checkpoint's numbers count, whatever is told. */
static void note_differences(const struct model *m, double interval, double shift,
                             struct spin_sequence_info *sequence)
{
    if (!isnan(interval) && interval != m->interval)
        spin_note(
            sequence,
            "time_interval is %g in cfg_args and %g in the checkpoint: the checkpoint decides",
            interval, m->interval);
    if (!isnan(shift) && shift != m->shift)
        spin_note(sequence,
                  "time_pad of cfg_args is a shift of %g frames, that of the checkpoint %g: the "
                  "checkpoint decides",
                  shift, m->shift);
    if (m->duration < m->frames + m->shift + 1)
        spin_note(sequence,
                  "saved before the whole clip took part in training: the checkpoint's duration is "
                  "%g, in the end it is %g",
                  m->duration, m->frames + m->shift + 1);
}

static spin_status settle(struct model *m, const struct told *told,
                          struct spin_sequence_info *sequence)
{
    double interval = m->is_chkpnt ? m->interval : told->interval;
    double shift = told->pad + (told->kind == KEYFRAMES_LINEAR ? 0 : interval);

    SPIN_TRY(check_told(m, told));
    m->kind = (enum keyframes_kind)told->kind;
    m->frames = told->frames;
    if (!m->is_chkpnt) {
        m->interval = interval;
        m->shift = shift;
        m->duration = m->frames;
    } else if (!(m->frames >= 1)) {
        m->frames = m->duration - m->shift - 1;
        spin_note(sequence,
                  "cfg_args does not say how many frames the clip has: %g, by the checkpoint's "
                  "duration; --duration decides",
                  m->frames);
    }
    m->least_width = told->var_pad / m->interval / 2.36;
    if (!(m->interval >= 1 && m->interval <= MOST_FRAMES) || !(fabs(m->shift) <= MOST_FRAMES) ||
        !(m->duration >= 1 && m->duration <= MOST_FRAMES) ||
        !(m->frames >= 1 && m->frames <= MOST_FRAMES) ||
        !(m->least_width > 0 && m->least_width <= MOST_FRAMES))
        return spin_fail(SPIN_E_MALFORMED,
                         "'%s': key frames %g frames apart from frame %g on, %g frames, a duration "
                         "of %g, var_pad %g: these do not fit together",
                         m->path, m->interval, -m->shift, m->frames, m->duration, told->var_pad);
    if (m->is_chkpnt)
        note_differences(m, told->interval, shift, sequence);
    if (told->first > 0)
        spin_note(sequence, "start_timestamp=%g: time 0 is that frame of the recording",
                  told->first);
    return SPIN_OK;
}

static spin_status read_settings(struct model *m, const struct spin_plugin_values *values,
                                 struct spin_sequence_info *sequence)
{
    struct cfg_args cfg = {0};
    struct told told;
    char *folder = NULL;
    spin_status status;

    SPIN_TRY(m->is_chkpnt ? spin_path_folder(m->path, &folder) : spin_strdup(m->path, &folder));
    status = spin_model_folder_cfg(folder, m->is_chkpnt ? NULL : m->path, &cfg);
    free(folder);
    if (status == SPIN_OK)
        status = read_told(values, &cfg, &told);
    spin_cfg_close(&cfg);
    return status == SPIN_OK ? settle(m, &told, sequence) : status;
}

/* ---- Opening --------------------------------------------------------------------------------- */

static spin_status take_number(const struct spin_value *model, size_t item, const char *name,
                               double *out)
{
    const struct spin_value *v = spin_value_at(model, item);

    if (!v || v->kind != SPIN_VALUE_INT || !spin_value_number(v, out))
        return spin_fail(SPIN_E_MALFORMED, "item %zu (%s) is %s, expected an int", item, name,
                         spin_chkpnt_kind(v));
    return SPIN_OK;
}

static spin_status take_model(struct spin_torch *torch, struct model *m)
{
    const struct spin_value *model;
    double active, iteration;

    SPIN_TRY(spin_chkpnt_model(torch->root, N_ITEMS, "Ex4DGS", &model, &iteration));
    SPIN_TRY(take_number(model, 0, "the active SH degree", &active));
    SPIN_TRY(take_number(model, 19, "duration", &m->duration));
    SPIN_TRY(take_number(model, 20, "interval", &m->interval));
    SPIN_TRY(take_number(model, 21, "time_shift", &m->shift));
    if (active < 0 || active > 3)
        return spin_fail(SPIN_E_MALFORMED, "the active SH degree is %g, expected 0 to 3", active);
    SPIN_TRY(spin_ex4dgs_part_of_chkpnt(torch, model, (int)active, &m->still));
    return spin_ex4dgs_part_of_chkpnt(torch, model, (int)active, &m->moving);
}

static spin_status read_chkpnt(struct model *m)
{
    struct spin_torch torch;
    spin_status status;

    SPIN_TRY(spin_torch_open(m->path, &torch));
    status = take_model(&torch, m);
    spin_torch_close(&torch);
    return spin_fail_reading(status, m->path);
}

static spin_status read_parts(struct model *m, struct spin_sequence_info *sequence)
{
    size_t n_all, n_dropped;

    if (m->is_chkpnt) {
        SPIN_TRY(read_chkpnt(m));
    } else {
        SPIN_TRY(spin_ex4dgs_part_of_ply(m->path, &m->still));
        SPIN_TRY(spin_ex4dgs_part_of_ply(m->path, &m->moving));
    }
    if (m->still.n > 0 && m->moving.n > 0 && m->still.sh_degree != m->moving.sh_degree)
        return spin_fail(SPIN_E_MALFORMED,
                         "'%s': the SH of static Gaussians have degree %d, of dynamic ones %d",
                         m->path, m->still.sh_degree, m->moving.sh_degree);
    m->sh_degree = m->still.n > 0 ? m->still.sh_degree : m->moving.sh_degree;
    n_all = m->still.n + m->moving.n;
    n_dropped = spin_ex4dgs_part_clean(&m->still) + spin_ex4dgs_part_clean(&m->moving);
    m->n = n_all - n_dropped;
    if (m->n == 0)
        return spin_fail(SPIN_E_MALFORMED, "'%s': none of the %zu Gaussians has finite values",
                         m->path, n_all);
    if (n_dropped > 0)
        spin_note(sequence,
                  "%zu of %zu Gaussians are dropped: values that are not finite, or rotations of "
                  "length 0",
                  n_dropped, n_all);
    return SPIN_OK;
}

static void describe(struct model *m, struct spin_sequence_info *sequence)
{
    sequence->n_frames = 1;
    sequence->counts = &m->n;
    sequence->columns = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    sequence->static_columns =
        m->moving.n > 0 ? SPIN_COL_LOG_SCALES | SPIN_COL_SH : SPIN_COL_ATTRIBUTES;
    sequence->sh_degree = m->sh_degree;
    sequence->antialias = true;
    sequence->continuous = true;
    sequence->counts_frames = true;
    sequence->time_last = m->frames - 1;
    snprintf(sequence->variant, sizeof sequence->variant,
             "Ex4DGS, %.24s, %zu static, %zu dynamic Gaussians, %s between keys %g frames apart",
             m->is_chkpnt ? spin_path_name(m->path) : "two PLYs", m->still.n, m->moving.n,
             kind_names[m->kind], m->interval);
    spin_note(sequence, "times are frames, 0 to %g", m->frames - 1);
    if (!m->is_chkpnt)
        spin_note(sequence,
                  "the PLYs of %s are read: the motion of static Gaussians is spread over %g "
                  "frames, in the "
                  "checkpoint over a few more",
                  spin_path_name(m->path), m->duration);
    spin_note(sequence, "trained with a filter of 0.1 square pixels that dims thin splats: drawn "
                        "antialiased, which is similar");
}

static spin_status ex4dgs_open(const char *path, const struct spin_plugin_values *values,
                               void **self, struct spin_sequence_info *sequence)
{
    struct model *m;

    *sequence = (struct spin_sequence_info){.sh_degree = -1};
    SPIN_TRY(spin_alloc(1, sizeof *m, self));
    m = *self;
    m->moving.moving = true;
    SPIN_TRY(find_files(path, spin_plugin_value(values, "iteration", NULL), m));
    SPIN_TRY(read_parts(m, sequence));
    SPIN_TRY(read_settings(m, values, sequence));
    describe(m, sequence);
    return SPIN_OK;
}

static void ex4dgs_close(void *self)
{
    struct model *m = self;

    if (!m)
        return;
    spin_ex4dgs_part_free(&m->still);
    spin_ex4dgs_part_free(&m->moving);
    free(m->path);
    free(m);
}

/* ---- One time -------------------------------------------------------------------------------- */

static spin_status find_keys(const struct model *m, double time, struct keyframes *out)
{
    double at = time + m->shift, key = floor(at / m->interval);
    int beside = m->kind == KEYFRAMES_LINEAR ? 0 : 1;

    if (!(time >= 0 && time <= m->frames - 1))
        return spin_fail(SPIN_E_NOT_FOUND, "'%s' has no time %g: its frames count from 0 to %g",
                         m->path, time, m->frames - 1);
    if (m->moving.n > 0 && (key < beside || key + 1 + beside >= m->moving.n_keys))
        return spin_fail(SPIN_E_UNSUPPORTED,
                         "'%s': time %g needs the key frames %g to %g, and there are %d", m->path,
                         time, key - beside, key + 1 + beside, m->moving.n_keys);
    *out = (struct keyframes){m->kind, (int)key, (at - key * m->interval) / m->interval,
                              at / m->interval};
    return SPIN_OK;
}

static void put_still(const struct model *m, double time, unsigned columns, struct spin_splats *out)
{
    const struct ex4dgs_part *p = &m->still;

    for (size_t i = 0; i < 3 * p->n && (columns & SPIN_COL_MEANS); i++)
        out->means[i] = (float)(p->column[EX4DGS_PLACE][i] +
                                (double)p->column[EX4DGS_DRIFT][i] * time / m->duration);
    for (size_t i = 0; i < 4 * p->n && (columns & SPIN_COL_QUATS); i++)
        out->quats[i] = p->column[EX4DGS_ROTATION][i];
    for (size_t i = 0; i < p->n && (columns & SPIN_COL_LOGIT_OPACITIES); i++)
        out->logit_opacities[i] = p->column[EX4DGS_OPACITY][i];
}

static void put_moving(const struct model *m, const struct keyframes *at, unsigned columns,
                       struct spin_splats *out)
{
    const struct ex4dgs_part *p = &m->moving;
    size_t keys = (size_t)p->n_keys;

    for (size_t i = 0; i < p->n; i++) {
        const float *places = p->column[EX4DGS_PLACE] + 3 * keys * i;
        size_t row = m->still.n + i;

        for (size_t c = 0; c < 3 && (columns & SPIN_COL_MEANS); c++)
            out->means[3 * row + c] = (float)spin_keyframes_value(at, places + c, 3);
        if (columns & SPIN_COL_QUATS)
            spin_keyframes_turn(at, p->column[EX4DGS_ROTATION] + 4 * keys * i,
                                out->quats + 4 * row);
        if (columns & SPIN_COL_LOGIT_OPACITIES)
            out->logit_opacities[row] = spin_logit_of(
                spin_sigmoid_of(p->column[EX4DGS_OPACITY][i]) *
                spin_keyframes_visibility(at, p->column[EX4DGS_CENTRE] + 2 * i,
                                          p->column[EX4DGS_WIDTH] + 2 * i, m->least_width));
    }
}

/* What no time changes, of both parts one after the other. */
static void put_fixed(const struct model *m, enum ex4dgs_column column, float *out)
{
    const struct ex4dgs_part *const parts[] = {&m->still, &m->moving};

    for (int i = 0; i < 2; i++) {
        size_t n = parts[i]->n * spin_ex4dgs_width(parts[i], column);

        if (n > 0)
            memcpy(out, parts[i]->column[column], n * sizeof *out);
        out += n;
    }
}

static spin_status ex4dgs_frame(void *self, int frame, double time, unsigned columns,
                                struct spin_splats *out)
{
    struct model *m = self;
    struct keyframes at;

    (void)frame;
    columns &= SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    SPIN_TRY(find_keys(m, time, &at));
    SPIN_TRY(spin_splats_reserve(out, m->n, columns, m->sh_degree));
    out->antialias = true;
    put_still(m, time, columns, out);
    put_moving(m, &at, columns, out);
    if (columns & SPIN_COL_LOG_SCALES)
        put_fixed(m, EX4DGS_SCALE, out->log_scales);
    if (columns & SPIN_COL_SH)
        put_fixed(m, EX4DGS_SH, out->sh);
    return SPIN_OK;
}

static const struct spin_plugin_option options[] = {
    {"iteration", "N", "which save to read; the last when not given", NULL},
    {"interp", "WORD", "between key frames: linear, cube or pchip, instead of what cfg_args says",
     NULL},
    {"interval", "N", "frames from one key frame to the next, instead of what cfg_args says", NULL},
    {"time-pad", "N", "the option time_pad of the run, instead of what cfg_args says", NULL},
    {"duration", "N", "frames of the clip, instead of what cfg_args says", NULL},
    {NULL, NULL, NULL, NULL},
};

const struct spin_importer spin_importer_ex4dgs = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "ex4dgs",
    .summary = "Ex4DGS: the model's folder, with cfg_args and chkpnt<N>.pth or both PLYs",
    .upstream = "juno181/Ex4DGS 7fac649",
    .options = options,
    .probe = probe,
    .open = ex4dgs_open,
    .frame = ex4dgs_frame,
    .close = ex4dgs_close,
};
