/* Realtime-4DGS (Yang et al., ICLR 2024): chkpnt<N>.pth, a tuple of tensors.
 *
 * Gaussians are 4-D: at a time each is an ellipsoid of fixed shape on a straight line, with a bell
 * of opacity in time and cosines in its colour. The file tells neither the range of times nor which
 * of two conventions its rotations follow: both may be given; otherwise a note says which was assumed. */
#include "spin.h"

#include <ctype.h>
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/option.h"
#include "importers/lib/chkpnt.h"
#include "importers/lib/notes.h"
#include "importers/lib/realtime4dgs_rows.h"
#include "importers/lib/run_config.h"
#include "importers/lib/gaussian4d.h"
#include "io/torch.h"

/* The renderer skips a Gaussian whose weight in time is not above this. */
#define LEAST_WEIGHT 0.05
/* Initial times are drawn from the clip and 10% beyond both its ends. */
#define SPREAD 1.2

struct model {
    struct spin_torch torch;
    char *path;
    struct run_config settings;
    struct realtime4dgs_parts parts;
    bool torch_open, stale;
    struct realtime4dgs_rows rows;
    struct realtime4dgs_reading reading;
    double ratio; /* the data set's times over the file's */
    struct clip_times times;
    struct gaussian4d gaussians;
    size_t count; /* of a static scene, for the track */
    bool whole;   /* no Gaussian is left out at any time */
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
        bool found = false, cloud = false;

        for (size_t i = 0; peek->names && peek->names[i]; i++) {
            found = found || spin_chkpnt_iteration(peek->names[i]) >= 0;
            cloud = cloud || strcmp(peek->names[i], "point_cloud") == 0;
        }
        /* Plain 3DGS and its kin save such checkpoints too, beside their clouds. */
        return found ? (cloud ? 20 : 70) : 0;
    }
    if (begins_like_ours(peek))
        return named ? 80 : 50;
    return named ? 40 : 0;
}

/* ---- Shapes ---------------------------------------------------------------------------------- */

/* Median of the largest standard deviation in space over at most a few thousand Gaussians. */
static double median_extent(const struct realtime4dgs_rows *rows, bool older)
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
static spin_status choose_convention(struct model *m, const char *asked,
                                     struct spin_sequence_info *sequence)
{
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

static spin_status add_rows(struct model *m, struct spin_sequence_info *sequence)
{
    size_t n_faint;

    m->reading.transposed = !m->rows.rot_4d && m->parts.moving &&
                            spin_yaml_bool(&m->settings, "compute_cov3D_python", false);
    SPIN_TRY(spin_gaussian4d_reserve(&m->gaussians, m->rows.n));
    n_faint = spin_realtime4dgs_rows_add(&m->rows, 0, &m->reading, &m->gaussians);
    SPIN_TRY(spin_gaussian4d_check(&m->gaussians, m->rows.n, m->stale ? 0 : n_faint,
                                   "values that are not finite", sequence));
    if (m->reading.transposed)
        spin_note(sequence, "'%s' has compute_cov3D_python, so rotations are transposed",
                  m->settings.yaml_path);
    return SPIN_OK;
}

/* ---- Opening --------------------------------------------------------------------------------- */

static spin_status read_settings(struct model *m)
{
    double extra = 0;

    SPIN_TRY(spin_run_config_ratio(&m->settings, &m->ratio));
    SPIN_TRY(spin_cfg_read_number(&m->settings.cfg, "prefilter_var", &extra));
    m->reading.extra = extra > 0 && isfinite(extra) ? extra : 0;
    return SPIN_OK;
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

static void note_losses(const struct model *m, struct spin_sequence_info *sequence)
{
    const struct spin_value *env = m->parts.env_map;

    if (m->stale)
        spin_note(sequence,
                  "a checkpoint of OMG4, whose colours and opacities live in networks that "
                  "are not in it: geometry only; import comp.xz for the rest");
    if (m->times.guessed)
        spin_note(sequence,
                  "time_duration is not in the run's folder: assumed %g,%g, as the Gaussians' "
                  "own times run%s; --time-duration or --config sets it",
                  m->times.first, m->times.last,
                  m->rows.degree_t > 0 ? ", and colours depend on it" : "");
    if (env && env->kind == SPIN_VALUE_TENSOR && !spin_chkpnt_is_empty(env))
        spin_note(sequence,
                  "the environment map is not imported: windows and far background are missing");
    if (m->parts.masked)
        spin_note(sequence, "the mask of a fork (its last item) is ignored");
    if (!m->stale && m->rows.degree_t > 0 && cosines_are_zero(m))
        spin_note(sequence, "all temporal SH are 0: colours do not change");
}

static void describe(struct model *m, struct spin_sequence_info *sequence)
{
    char iteration[48] = "";

    sequence->n_frames = 1;
    sequence->continuous = m->parts.moving;
    sequence->time_first = m->times.first;
    sequence->time_last = m->times.last;
    sequence->columns = SPIN_COL_MEANS | SPIN_COL_QUATS | SPIN_COL_LOG_SCALES;
    if (!m->stale) {
        sequence->columns |= SPIN_COL_ATTRIBUTES;
        sequence->sh_degree = m->rows.degree;
    }
    if (!m->parts.moving) {
        m->count = m->gaussians.n;
        sequence->counts = &m->count;
    }
    if (m->parts.iteration >= 0)
        snprintf(iteration, sizeof iteration, ", iteration %.0f", m->parts.iteration);
    snprintf(sequence->variant, sizeof sequence->variant,
             "Realtime-4DGS%s, %zu Gaussians, %s, SH degree %d%s", iteration, m->rows.n,
             !m->parts.moving ? "static (3D)"
             : m->rows.rot_4d ? "rot_4d"
                              : "no rot_4d",
             m->rows.degree, m->rows.degree_t > 0 ? " with time" : "");
}

static spin_status open_model(struct model *m, const struct spin_plugin_values *values,
                              struct spin_sequence_info *sequence)
{
    double sh_degree = -1;
    int rule;

    SPIN_TRY(spin_option_word(values, "cull", "time|none", &rule));
    m->whole = rule == 1;
    SPIN_TRY(spin_torch_open(m->path, &m->torch));
    m->torch_open = true;
    SPIN_TRY(spin_realtime4dgs_parts(m->torch.root, &m->parts));
    SPIN_TRY(spin_run_config_open(m->path, spin_plugin_value(values, "config", NULL),
                                  "time_duration", &m->settings));
    SPIN_TRY(read_settings(m));
    SPIN_TRY(spin_cfg_read_number(&m->settings.cfg, "sh_degree", &sh_degree));
    m->stale = spin_realtime4dgs_is_stale(&m->parts);
    SPIN_TRY(spin_realtime4dgs_rows_open(&m->torch, &m->parts, !m->stale, sh_degree, &m->rows));
    if (m->rows.n == 0)
        return spin_fail(SPIN_E_MALFORMED, "0 Gaussians");
    if (m->rows.rot_4d)
        SPIN_TRY(choose_convention(m, spin_plugin_value(values, "convention", "auto"), sequence));
    SPIN_TRY(add_rows(m, sequence));
    spin_realtime4dgs_rows_free(&m->rows);
    if (m->parts.moving)
        SPIN_TRY(
            spin_run_config_times(&m->settings, spin_plugin_value(values, "time-duration", NULL),
                                  m->gaussians.time, m->gaussians.n, m->ratio, SPREAD, &m->times));
    note_losses(m, sequence);
    describe(m, sequence);
    return SPIN_OK;
}

static spin_status realtime4dgs_open(const char *path, const struct spin_plugin_values *values,
                                     void **self, struct spin_sequence_info *sequence)
{
    struct model *m;

    *sequence = (struct spin_sequence_info){.sh_degree = -1};
    SPIN_TRY(spin_alloc(1, sizeof *m, self));
    m = *self;
    SPIN_TRY(spin_chkpnt_find(path, &m->path, sequence));
    if (!m->path)
        return spin_fail(SPIN_E_NOT_FOUND, "'%s' holds no chkpnt<N>.pth", path);
    return spin_fail_reading(open_model(m, values, sequence), m->path);
}

static void realtime4dgs_close(void *self)
{
    struct model *m = self;

    if (!m)
        return;
    if (m->torch_open)
        spin_torch_close(&m->torch);
    spin_run_config_close(&m->settings);
    spin_gaussian4d_free(&m->gaussians);
    spin_realtime4dgs_rows_free(&m->rows);
    free(m->path);
    free(m);
}

/* ---- One time -------------------------------------------------------------------------------- */

static spin_status realtime4dgs_frame(void *self, int frame, double time, unsigned columns,
                                      struct spin_splats *out)
{
    struct model *m = self;
    size_t width = 3 * (size_t)((m->rows.degree + 1) * (m->rows.degree + 1));

    if (frame < 0)
        return spin_fail(SPIN_E_NOT_FOUND, "'%s' has no frame %d", m->path, frame);
    columns &= SPIN_COL_MEANS | SPIN_COL_QUATS | SPIN_COL_LOG_SCALES |
               (m->stale ? 0 : SPIN_COL_ATTRIBUTES);
    time = m->parts.moving ? time / m->ratio : 0;
    spin_gaussian4d_select(&m->gaussians, time, m->whole ? -1 : LEAST_WEIGHT, 0);
    SPIN_TRY(spin_splats_reserve(out, m->gaussians.n_kept, columns, m->rows.degree));
    spin_gaussian4d_fill(&m->gaussians, time, columns, out);
    for (size_t k = 0; k < m->gaussians.n_kept && (columns & SPIN_COL_SH); k++) {
        size_t i = m->gaussians.kept[k];

        spin_realtime4dgs_colours(&m->rows, m->gaussians.row[i], time - m->gaussians.time[i],
                                  (m->times.last - m->times.first) / m->ratio, out->sh + width * k);
    }
    return SPIN_OK;
}

static const struct spin_plugin_option options[] = {
    {"time-duration", "A,B", "the clip's first and last time, as in the training YAML", NULL},
    {"config", "FILE", "the training YAML (the one beside the checkpoint)", NULL},
    {"convention", "WORD", "of rotations: auto, today, or older (before 2024-09)", "auto"},
    {"cull", "RULE", "leave out Gaussians by time (weight below 0.05), or none: not sliced", "time"},
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
    .close = realtime4dgs_close,
};
