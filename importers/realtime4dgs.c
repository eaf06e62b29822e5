/* Realtime-4DGS (Yang et al., ICLR 2024): chkpnt<N>.pth, a tuple of tensors.
 *
 * Gaussians are 4-D: at a time each is an ellipsoid of fixed shape on a straight line, with a bell
 * of opacity in time and cosines in its colour. The file tells neither the range of times nor which
 * of two conventions its rotations follow: both may be given; otherwise a note says which was assumed. */
#include <stdlib.h>
#include <string.h>

#include "base/option.h"
#include "importers/lib/chkpnt.h"
#include "importers/lib/realtime4dgs.h"

struct model {
    struct spin_model base;
    struct realtime4dgs rows;
    struct realtime4dgs_reading reading;
    bool stale;
    double ratio; /* the data set's times over the file's */
    struct clip_times times;
    struct gaussian4d gaussians;
};

/* ---- Recognising ----------------------------------------------------------------------------- */

/* Does a tuple that holds a tuple begin the pickle: an int, then a parameter? */
static bool begins_like_ours(const struct spin_peek *peek)
{
    static const char parameter[] = "ctorch._utils\n_rebuild_parameter";
    const unsigned char *at = memmem(peek->head, peek->n_head, "\x80\x02(K", 4);

    return at && (size_t)(peek->head + peek->n_head - at) > 5 + sizeof parameter &&
           memcmp(at + 5, parameter, sizeof parameter - 1) == 0;
}

static int probe(const struct spin_peek *peek)
{
    bool named = spin_chkpnt_iteration(spin_path_name(peek->path)) >= 0;

    if (peek->is_folder) {
        bool found = false;

        for (size_t i = 0; peek->names && peek->names[i]; i++)
            found = found || spin_chkpnt_iteration(peek->names[i]) >= 0;
        /* Plain 3DGS and its kin save such checkpoints too, beside their clouds. */
        return found ? (spin_peek_has(peek, "point_cloud") ? 20 : 70) : 0;
    }
    if (begins_like_ours(peek))
        return named ? 80 : 50;
    return named ? 40 : 0;
}

/* ---- Shapes ---------------------------------------------------------------------------------- */

/* Median of the largest standard deviation in space over at most a few thousand Gaussians. */
static double median_extent(const struct realtime4dgs *rows, bool older)
{
    enum { MOST = 4096 };
    static const double unusable = 1e300;
    double extent[MOST];
    size_t n = rows->n, step = n / MOST + 1, n_used = 0;

    for (size_t i = 0; i < n && n_used < MOST; i += step) {
        double value[3], vector[9], largest = 0;
        spin_slice s;

        spin_realtime4dgs_slice(rows, i, older, &s);
        if (!spin_eigen3(s.cov6, value, vector))
            largest = unusable;
        for (int k = 0; k < 3 && largest < unusable; k++)
            largest = value[k] > largest ? value[k] : largest;
        extent[n_used++] = largest;
    }
    qsort(extent, n_used, sizeof *extent, spin_compare_times);
    return sqrt(extent[n_used / 2]);
}

/* Under the wrong convention the long time axis of static Gaussians lies in space, so the right one
 * has the smaller ellipsoids. */
static spin_status choose_convention(struct model *m)
{
    const char *asked = spin_plugin_value(m->base.values, "convention", "auto");
    struct spin_sequence_info *sequence = m->base.sequence;
    double today = median_extent(&m->rows, false), older = median_extent(&m->rows, true);
    bool hint = older < 0.95 * today;

    if (strcmp(asked, "auto") != 0 && strcmp(asked, "today") != 0 && strcmp(asked, "older") != 0)
        return spin_fail(SPIN_E_USAGE, "--convention is '%s', expected auto, today or older",
                         asked);
    m->reading.older = strcmp(asked, "auto") == 0 ? hint : strcmp(asked, "older") == 0;
    if (strcmp(asked, "auto") == 0)
        spin_note(sequence,
                  "the rotation convention is not in the file: assumed the one used %s September "
                  "2024, by the sizes of the Gaussians (median %.3g; %.3g with the other); "
                  "--convention today|older sets it",
                  m->reading.older ? "before" : "since", m->reading.older ? older : today,
                  m->reading.older ? today : older);
    else if (hint != m->reading.older)
        spin_note(sequence,
                  "the sizes of the Gaussians suggest the other convention of rotations (median "
                  "%.3g; %.3g with the one asked for)",
                  hint ? older : today, hint ? today : older);
    return SPIN_OK;
}

/* ---- Opening --------------------------------------------------------------------------------- */

/* Once OMG4's networks exist they draw, and SH and opacities in its checkpoints are leftovers. */
static bool is_stale(const struct realtime4dgs *r)
{
    const struct spin_value *groups = spin_value_get(r->part[R4_OPTIMIZER], "param_groups");

    for (size_t i = 0; groups && i < groups->n; i++) {
        const char *name = spin_value_text(spin_value_get(spin_value_at(groups, i), "name"));

        if (name && (strcmp(name, "f_static") == 0 || strcmp(name, "f_view") == 0))
            return true;
    }
    return false;
}

/* Rows of the cosines that are all 0 tell a run whose gradients were lost (issue 50 upstream). */
static bool cosines_are_zero(const struct model *m)
{
    float sh[REALTIME4DGS_SH];

    for (size_t k = 0; k < m->gaussians.n; k++) {
        spin_realtime4dgs_sh(&m->rows, m->gaussians.row[k], sh);
        for (int i = 48; i < REALTIME4DGS_SH; i++) {
            if (sh[i] != 0)
                return false;
        }
    }
    return true;
}

static void describe(const struct model *m)
{
    struct spin_sequence_info *sequence = m->base.sequence;
    const struct realtime4dgs *r = &m->rows;
    char iteration[48];

    if (m->stale)
        spin_note(sequence,
                  "a checkpoint of OMG4, whose colours and opacities live in networks that "
                  "are not in it: geometry only; import comp.xz for the rest");
    spin_realtime4dgs_note(r, &m->times, sequence);
    if (r->masked)
        spin_note(sequence, "the mask of a fork (its last item) is ignored");
    if (!m->stale && r->degree_t > 0 && cosines_are_zero(m))
        spin_note(sequence, "all temporal SH are 0: colours do not change");
    spin_gaussian4d_describe(&m->gaussians, &m->times, sequence);
    sequence->continuous = r->moving;
    sequence->counts = r->moving ? NULL : &m->gaussians.n;
    if (m->stale) {
        sequence->columns = SPIN_COL_MEANS | SPIN_COL_QUATS | SPIN_COL_LOG_SCALES;
        sequence->sh_degree = -1;
    }
    snprintf(sequence->variant, sizeof sequence->variant,
             "Realtime-4DGS%s, %zu Gaussians, %s, SH degree %d%s",
             spin_realtime4dgs_iteration(r, iteration), r->n,
             !r->moving  ? "static (3D)"
             : r->rot_4d ? "rot_4d"
                         : "no rot_4d",
             r->degree, r->degree_t > 0 ? " with time" : "");
}

static spin_status read_rows(struct model *m)
{
    const struct run_config *settings = &m->base.settings;
    double extra = 0;
    size_t n_faint;

    SPIN_TRY(spin_run_config_ratio(settings, &m->ratio));
    SPIN_TRY(spin_cfg_read_number(&settings->cfg, "prefilter_var", &extra));
    m->reading.extra = extra > 0 && isfinite(extra) ? extra : 0;
    m->stale = is_stale(&m->rows);
    SPIN_TRY(spin_realtime4dgs_read(&m->base, !m->stale, &m->rows));
    if (m->rows.n == 0)
        return spin_fail(SPIN_E_MALFORMED, "0 Gaussians");
    if (m->rows.rot_4d)
        SPIN_TRY(choose_convention(m));
    m->reading.transposed = !m->rows.rot_4d && m->rows.moving &&
                            spin_yaml_bool(settings, "compute_cov3D_python", false);
    SPIN_TRY(spin_gaussian4d_reserve(&m->base, &m->gaussians, m->rows.n));
    n_faint = spin_realtime4dgs_add(&m->rows, 0, &m->reading, &m->gaussians);
    m->gaussians.sh_degree = m->rows.degree;
    SPIN_TRY(spin_gaussian4d_check(&m->gaussians, m->rows.n, m->stale ? 0 : n_faint,
                                   "values that are not finite", m->base.sequence));
    if (m->reading.transposed)
        spin_note(m->base.sequence, "'%s' has compute_cov3D_python, so rotations are transposed",
                  settings->yaml_path);
    return SPIN_OK;
}

static spin_status open_checkpoint(struct model *m)
{
    struct spin_model *base = &m->base;
    int rule;

    SPIN_TRY(spin_option_word(base->values, "cull", "time|none", &rule));
    m->gaussians.least_weight = rule == 1 ? -1 : REALTIME4DGS_LEAST_WEIGHT;
    SPIN_TRY(spin_torch_open(base->path, &base->torch));
    SPIN_TRY(spin_realtime4dgs_parts(base->torch.root, &m->rows));
    SPIN_TRY(spin_run_config_open(base->path, spin_model_option(base, "config"), "time_duration",
                                  &base->settings));
    SPIN_TRY(read_rows(m));
    if (m->rows.moving)
        SPIN_TRY(spin_run_config_times(&base->settings, spin_model_option(base, "time-duration"),
                                       m->gaussians.time, m->gaussians.n, m->ratio,
                                       REALTIME4DGS_SPREAD, &m->times));
    describe(m);
    return SPIN_OK;
}

static spin_status open_model(void *self, const char *path)
{
    struct model *m = self;

    SPIN_TRY(spin_chkpnt_find(&m->base, path));
    if (!m->base.path)
        return spin_fail(SPIN_E_NOT_FOUND, "'%s' holds no chkpnt<N>.pth", path);
    return spin_fail_reading(open_checkpoint(m), m->base.path);
}

SPIN_MODEL_OPEN(realtime4dgs_open, struct model, open_model)

/* ---- One time -------------------------------------------------------------------------------- */

static void colour(const void *model, size_t i, double dt, float *out)
{
    const struct model *m = model;

    spin_realtime4dgs_colours(&m->rows, m->gaussians.row[i], dt,
                              (m->times.last - m->times.first) / m->ratio, out);
}

static spin_status realtime4dgs_frame(void *self, int frame, double time, unsigned columns,
                                      struct spin_splats *out)
{
    struct model *m = self;

    if (m->stale)
        columns &= SPIN_COL_MEANS | SPIN_COL_QUATS | SPIN_COL_LOG_SCALES;
    return spin_gaussian4d_frame(&m->base, &m->gaussians, frame,
                                 m->rows.moving ? time / m->ratio : 0, columns, colour, out);
}

static const struct spin_plugin_option options[] = {
    {"time-duration", "A,B", "the clip's first and last time, as in the training YAML", NULL},
    {"config", "FILE", "the training YAML (the one beside the checkpoint)", NULL},
    {"convention", "WORD", "of rotations: auto, today, or older (before 2024-09)", "auto"},
    {"cull", "RULE", "leave out Gaussians by time (weight below 0.05), or none: not sliced",
     "time"},
    {NULL, NULL, NULL, NULL},
};

const struct spin_importer spin_importer_realtime4dgs = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "realtime4dgs",
    .summary = "Realtime-4DGS: chkpnt<N>.pth, or the folder it lies in",
    .upstream = "fudan-zvg/4d-gaussian-splatting 63725f2",
    .options = options,
    .probe = probe,
    .open = realtime4dgs_open,
    .frame = realtime4dgs_frame,
    .close = spin_model_close,
};
