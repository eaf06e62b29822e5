/* Realtime-4DGS (Yang et al., ICLR 2024): chkpnt<N>.pth, a tuple of tensors.
 *
 * Gaussians are 4-D: at a time each is an ellipsoid of fixed shape on a straight line, with a bell
 * of opacity in time and cosines in its colour. The file tells neither the range of times nor which
 * of two conventions its rotations follow: both may be given, and are guessed aloud otherwise. */
#include "spin.h"

#include <ctype.h>
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "importers/lib/notes.h"
#include "importers/lib/realtime4dgs_parts.h"
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
    bool torch_open, rot_4d, older, stale;
    struct spin_array dc, rest;
    size_t n;             /* rows in the file */
    int rows;             /* of SH in the file */
    int degree, degree_t; /* active */
    double ratio;         /* the data set's times over the file's */
    double extra;         /* prefilter_var, or 0 */
    struct clip_times times;
    struct gaussian4d gaussians;
    float *sh;    /* [rows][3] scratch */
    size_t count; /* of a static scene, for the track */
};

/* ---- Recognising ----------------------------------------------------------------------------- */

/* N of chkpnt<N>.pth, INT64_MAX - 1 of chkpnt_best.pth, else -1. */
static long long iteration_of_name(const char *name)
{
    char *end;
    long long n;

    if (strcmp(name, "chkpnt_best.pth") == 0)
        return INT64_MAX - 1;
    if (strncmp(name, "chkpnt", 6) != 0 || !isdigit((unsigned char)name[6]))
        return -1;
    n = strtoll(name + 6, &end, 10);
    return strcmp(end, ".pth") == 0 ? n : -1;
}

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
    bool named = iteration_of_name(spin_path_name(peek->path)) >= 0;

    if (peek->is_folder) {
        bool found = false, cloud = false;

        for (size_t i = 0; peek->names && peek->names[i]; i++) {
            found = found || iteration_of_name(peek->names[i]) >= 0;
            cloud = cloud || strcmp(peek->names[i], "point_cloud") == 0;
        }
        /* Plain 3DGS and its kin save such checkpoints too, beside their clouds. */
        return found ? (cloud ? 20 : 70) : 0;
    }
    if (begins_like_ours(peek))
        return named ? 80 : 50;
    return named ? 40 : 0;
}

/* ---- Tensors --------------------------------------------------------------------------------- */

/* A tensor [n][width...] of floating-point numbers; n 0: any. Rows that repeat one another by a
 * stride of 0 would let a small file ask for any amount of memory. */
static spin_status bind(struct model *m, const struct spin_value *v, const char *what, int n_dims,
                        const int64_t *shape, struct spin_array *out)
{
    SPIN_TRY(spin_torch_tensor_of(&m->torch, v, what, n_dims, shape, out));
    if (out->kind != 'f' && out->kind != 'B')
        return spin_fail(SPIN_E_MALFORMED, "%s does not hold floating-point numbers", what);
    if (out->count > out->storage_count)
        return spin_fail(SPIN_E_MALFORMED, "%s has %llu elements, its storage %llu", what,
                         (unsigned long long)out->count, (unsigned long long)out->storage_count);
    return SPIN_OK;
}

/* Rows as floats, malloc'd; values need not be finite. */
static spin_status load(struct model *m, const struct spin_value *v, const char *what, int width,
                        float **out)
{
    int64_t shape[2] = {(int64_t)m->n, width};
    struct spin_array t;

    SPIN_TRY(bind(m, v, what, 2, shape, &t));
    SPIN_TRY(spin_alloc(m->n, (size_t)width * sizeof **out, (void **)out));
    spin_array_to_f32(&t, 0, t.count, *out);
    return SPIN_OK;
}

static void swap_axes(struct spin_array *t)
{
    uint64_t size = t->shape[1];
    int64_t stride = t->stride[1];

    t->shape[1] = t->shape[2];
    t->stride[1] = t->stride[2];
    t->shape[2] = size;
    t->stride[2] = stride;
}

static spin_status bind_sh(struct model *m)
{
    const struct realtime4dgs_parts *p = &m->parts;
    int64_t dc[3] = {(int64_t)m->n, p->swapped ? 3 : 1, p->swapped ? 1 : 3};
    int64_t rest[3] = {(int64_t)m->n, p->swapped ? 3 : -1, p->swapped ? -1 : 3};

    SPIN_TRY(bind(m, p->dc, "features_dc", 3, dc, &m->dc));
    SPIN_TRY(bind(m, p->rest, "features_rest", 3, rest, &m->rest));
    if (p->swapped) {
        swap_axes(&m->dc);
        swap_axes(&m->rest);
    }
    if (m->rest.shape[1] > 47)
        return spin_fail(SPIN_E_MALFORMED, "features_rest has %llu rows of SH, expected at most 47",
                         (unsigned long long)m->rest.shape[1]);
    m->rows = 1 + (int)m->rest.shape[1];
    SPIN_TRY(spin_alloc(48, 3 * sizeof *m->sh, (void **)&m->sh));
    return SPIN_OK;
}

/* All SH rows of one row of the file, in m->sh. */
static void read_sh(struct model *m, size_t row)
{
    uint64_t width = 3 * (uint64_t)(m->rows - 1);

    spin_array_to_f32(&m->dc, 3 * row, 3, m->sh);
    if (width > 0)
        spin_array_to_f32(&m->rest, width * row, width, m->sh + 3);
}

/* ---- Degrees --------------------------------------------------------------------------------- */

/* Degree of the spatial part for a number of rows and whether rows for the cosines follow;
 * false for a number that no setting gives. */
static bool rows_to_degree(int rows, double told, int *degree, bool *in_time)
{
    for (int d = 0; d <= 3; d++) {
        int n = (d + 1) * (d + 1);
        /* Allocated when neither option is set; rows beyond the spatial ones are never used. */
        static const int unused[] = {1, 6, 16, 33};

        if (rows == 16 && told != 2 && d == 2) /* 16 is degree 3, unless cfg_args says otherwise */
            continue;
        if (rows == n || rows == 3 * n || rows == unused[d]) {
            *degree = d;
            *in_time = rows == 3 * n && rows != unused[d];
            return true;
        }
    }
    return false;
}

static spin_status read_degree(const struct spin_value *v, const char *what, int largest, int *out)
{
    double value = -1;

    if (!spin_value_number(v, &value) || value != floor(value) || value < 0 || value > largest)
        return spin_fail(SPIN_E_MALFORMED, "%s is %s %g, expected 0 to %d", what,
                         spin_realtime4dgs_kind(v), value, largest);
    *out = (int)value;
    return SPIN_OK;
}

static spin_status find_degrees(struct model *m)
{
    double told = -1;
    bool in_time = false;
    int most = 0;

    SPIN_TRY(spin_cfg_read_number(&m->settings.cfg, "sh_degree", &told));
    if (!rows_to_degree(m->rows, told, &most, &in_time))
        return spin_fail(SPIN_E_MALFORMED,
                         "features_dc and features_rest have %d rows of SH together, which no "
                         "degree has",
                         m->rows);
    if (m->parts.swapped) {
        m->degree = most;
        m->degree_t = in_time ? 2 : 0;
    } else {
        SPIN_TRY(read_degree(m->parts.active, "the active SH degree", 3, &m->degree));
        if (m->parts.moving)
            SPIN_TRY(
                read_degree(m->parts.active_t, "the active temporal SH degree", 2, &m->degree_t));
    }
    m->degree = m->degree < most ? m->degree : most;
    /* The renderer reaches the cosines only behind the spatial degree 3. */
    if (!in_time || m->degree < 3)
        m->degree_t = 0;
    return SPIN_OK;
}

/* ---- Shapes ---------------------------------------------------------------------------------- */

struct columns {
    float *xyz, *scaling, *rotation, *opacity, *t, *scaling_t, *rotation_r;
};

static void columns_free(struct columns *c)
{
    free(c->xyz);
    free(c->scaling);
    free(c->rotation);
    free(c->opacity);
    free(c->t);
    free(c->scaling_t);
    free(c->rotation_r);
}

static spin_status load_columns(struct model *m, struct columns *c)
{
    const struct realtime4dgs_parts *p = &m->parts;

    SPIN_TRY(load(m, p->xyz, "xyz", 3, &c->xyz));
    SPIN_TRY(load(m, p->scaling, "scaling", 3, &c->scaling));
    SPIN_TRY(load(m, p->rotation, "rotation", 4, &c->rotation));
    SPIN_TRY(load(m, p->opacity, "opacity", 1, &c->opacity));
    if (!p->moving)
        return SPIN_OK;
    SPIN_TRY(load(m, p->t, "t", 1, &c->t));
    SPIN_TRY(load(m, p->scaling_t, "scaling_t", 1, &c->scaling_t));
    if (m->rot_4d)
        SPIN_TRY(load(m, p->rotation_r, "rotation_r", 4, &c->rotation_r));
    return SPIN_OK;
}

static void slice_row(const struct columns *c, size_t i, bool older, spin_slice *out)
{
    double left[4], right[4], scale[4], a[16];

    for (size_t k = 0; k < 4; k++) {
        left[k] = c->rotation[4 * i + k];
        right[k] = c->rotation_r[4 * i + k];
        scale[k] = exp(k < 3 ? c->scaling[3 * i + k] : c->scaling_t[i]);
    }
    spin_rotation4_of_pair(left, right, older, a);
    spin_slice_of(a, scale, out);
}

/* Median of the largest standard deviation in space over at most a few thousand Gaussians. */
static double median_extent(const struct columns *c, size_t n, bool older)
{
    enum { MOST = 4096 };
    static const double unusable = 1e300;
    double extent[MOST];
    size_t step = n / MOST + 1, n_used = 0;

    for (size_t i = 0; i < n && n_used < MOST; i += step) {
        double value[3], vector[9], largest = 0;
        spin_slice s;

        slice_row(c, i, older, &s);
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
static spin_status choose_convention(struct model *m, const struct columns *c, const char *asked,
                                     struct spin_sequence_info *sequence)
{
    double today = median_extent(c, m->n, false), older = median_extent(c, m->n, true);
    bool hint = older < 0.95 * today;

    if (strcmp(asked, "auto") != 0 && strcmp(asked, "today") != 0 && strcmp(asked, "older") != 0)
        return spin_fail(SPIN_E_USAGE, "--convention is '%s', expected auto, today or older",
                         asked);
    m->older = strcmp(asked, "auto") == 0 ? hint : strcmp(asked, "older") == 0;
    if (strcmp(asked, "auto") == 0)
        spin_note(sequence,
                  "the convention of rotations is not in the file: guessed '%s' from the sizes of "
                  "the Gaussians (median %.3g; %.3g with the other); --convention decides",
                  m->older ? "older" : "today", m->older ? older : today, m->older ? today : older);
    else if (hint != m->older)
        spin_note(sequence,
                  "the sizes of the Gaussians speak for the other convention of rotations (median "
                  "%.3g; %.3g with the one asked for)",
                  hint ? older : today, hint ? today : older);
    return SPIN_OK;
}

static bool sh_finite(struct model *m, size_t row)
{
    read_sh(m, row);
    for (int i = 0; i < 3 * m->rows; i++) {
        if (!isfinite(m->sh[i]))
            return false;
    }
    return true;
}

static void add_row(struct model *m, const struct columns *c, size_t i, bool transposed)
{
    static const double still[3] = {0, 0, 0};
    double time = m->parts.moving ? c->t[i] : 0;
    double opacity = spin_sigmoid_of(c->opacity[i]), log_scale[3], quat[4];

    if (m->rot_4d) {
        spin_slice s;

        slice_row(c, i, m->older, &s);
        spin_gaussian4d_add_slice(&m->gaussians, i, c->xyz + 3 * i, time, opacity, &s, m->extra);
        return;
    }
    /* Here the exponential is the variance itself. */
    spin_unit_quat(c->rotation + 4 * i, quat);
    for (int k = 0; k < 3; k++) {
        log_scale[k] = c->scaling[3 * i + (size_t)k];
        quat[k + 1] = transposed ? -quat[k + 1] : quat[k + 1];
    }
    spin_gaussian4d_add(&m->gaussians, i, c->xyz + 3 * i, time, opacity, still,
                        m->parts.moving ? exp(c->scaling_t[i]) + m->extra : 1, log_scale, quat);
}

static spin_status add_rows(struct model *m, const struct columns *c,
                            struct spin_sequence_info *sequence)
{
    bool transposed = !m->rot_4d && m->parts.moving &&
                      spin_yaml_bool(&m->settings, "compute_cov3D_python", false);
    size_t n_faint = 0, n_bad_sh = 0;

    SPIN_TRY(spin_gaussian4d_reserve(&m->gaussians, m->n));
    for (size_t i = 0; i < m->n; i++) {
        if (!m->stale && !sh_finite(m, i)) {
            n_bad_sh++;
            continue;
        }
        n_faint += spin_sigmoid_of(c->opacity[i]) < 0.02;
        add_row(m, c, i, transposed);
    }
    m->gaussians.n_dropped += n_bad_sh;
    if (m->gaussians.n == 0)
        return spin_fail(SPIN_E_MALFORMED, "none of the %zu Gaussians has finite values", m->n);
    if (m->gaussians.n_dropped > 0)
        spin_note(sequence, "%zu of %zu Gaussians are dropped: values that are not finite",
                  m->gaussians.n_dropped, m->n);
    if (!m->stale && n_faint > 0.99 * (double)m->n)
        spin_note(sequence,
                  "nearly all opacities are below 0.02: training saved this just after it "
                  "had reset them; positions are fine");
    if (transposed)
        spin_note(sequence, "'%s' has compute_cov3D_python, so rotations are transposed",
                  m->settings.yaml_path);
    return SPIN_OK;
}

/* ---- Opening --------------------------------------------------------------------------------- */

static spin_status find_checkpoint(const char *path, char **out,
                                   struct spin_sequence_info *sequence)
{
    char **names = NULL;
    const char *best = NULL;
    long long iteration = -1;
    size_t n = 0;
    bool both = false;
    spin_status status;

    if (!spin_path_is_folder(path))
        return spin_strdup(path, out);
    SPIN_TRY(spin_folder_list(path, &names, &n));
    for (size_t i = 0; i < n; i++) {
        long long it = iteration_of_name(names[i]);
        bool is_best = it == INT64_MAX - 1;

        both = both || is_best;
        if (it >= 0 && (!best || (!is_best && it > iteration))) {
            best = names[i];
            iteration = is_best ? -1 : it;
        }
    }
    status = best ? spin_path_join(path, best, out)
                  : spin_fail(SPIN_E_NOT_FOUND, "'%s' holds no chkpnt<N>.pth", path);
    if (best && both && iteration >= 0)
        spin_note(sequence, "'%s' is read; chkpnt_best.pth is there too: name it to import it",
                  best);
    spin_folder_list_free(names);
    return status;
}

static bool has_elements(const struct spin_value *v)
{
    return v && v->kind == SPIN_VALUE_TENSOR && v->tensor.count > 0;
}

static spin_status read_flags(struct model *m)
{
    const struct realtime4dgs_parts *p = &m->parts;
    double ratio = 1, extra = 0;
    const char *next;

    if (!p->moving)
        m->rot_4d = false;
    else if (p->rot_4d)
        m->rot_4d = p->rot_4d->integer != 0;
    else
        m->rot_4d = has_elements(p->rotation_r);
    if (m->rot_4d && !has_elements(p->rotation_r))
        return spin_fail(SPIN_E_MALFORMED, "rot_4d is true, but the right quaternions are empty");
    m->stale = spin_realtime4dgs_is_stale(p);
    spin_cfg_number(spin_yaml_find(&m->settings, "frame_ratio", &next), &ratio);
    SPIN_TRY(spin_cfg_read_number(&m->settings.cfg, "frame_ratio", &ratio));
    SPIN_TRY(spin_cfg_read_number(&m->settings.cfg, "prefilter_var", &extra));
    if (!(ratio > 0) || !isfinite(ratio))
        return spin_fail(SPIN_E_MALFORMED, "frame_ratio is %g", ratio);
    m->ratio = ratio;
    m->extra = extra > 0 && isfinite(extra) ? extra : 0;
    return SPIN_OK;
}

static spin_status count_rows(struct model *m)
{
    int64_t shape[2] = {-1, 3};
    struct spin_array t;

    SPIN_TRY(bind(m, m->parts.xyz, "xyz", 2, shape, &t));
    if (t.shape[0] == 0)
        return spin_fail(SPIN_E_MALFORMED, "0 Gaussians");
    m->n = (size_t)t.shape[0];
    return SPIN_OK;
}

/* Rows of the cosines that are all 0 tell a run whose gradients were lost (issue 50 upstream). */
static bool cosines_are_zero(struct model *m)
{
    for (size_t k = 0; k < m->gaussians.n; k++) {
        read_sh(m, m->gaussians.row[k]);
        for (int i = 48; i < 144; i++) {
            if (m->sh[i] != 0)
                return false;
        }
    }
    return true;
}

static void note_losses(struct model *m, struct spin_sequence_info *sequence)
{
    if (m->stale)
        spin_note(sequence,
                  "a checkpoint of OMG4, whose colours and opacities live in networks that "
                  "are not in it: geometry only; import comp.xz for the rest");
    if (m->times.guessed)
        spin_note(sequence,
                  "time_duration is not in the run's folder: guessed %g,%g from the Gaussians' "
                  "times%s; --time-duration or --config decides",
                  m->times.first, m->times.last,
                  m->degree_t > 0 ? ", and colours depend on it" : "");
    if (has_elements(m->parts.env_map))
        spin_note(sequence, "the environment map is lost: windows and far background go missing");
    if (m->parts.masked)
        spin_note(sequence, "the mask of a fork (its last item) is ignored");
    if (!m->stale && m->degree_t > 0 && cosines_are_zero(m))
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
        sequence->sh_degree = m->degree;
    }
    if (!m->parts.moving) {
        m->count = m->gaussians.n;
        sequence->counts = &m->count;
    }
    if (m->parts.iteration >= 0)
        snprintf(iteration, sizeof iteration, ", iteration %.0f", m->parts.iteration);
    snprintf(sequence->variant, sizeof sequence->variant,
             "Realtime-4DGS%s, %zu Gaussians, %s, SH degree %d%s", iteration, m->n,
             !m->parts.moving ? "static (3D)"
             : m->rot_4d      ? "rot_4d"
                              : "no rot_4d",
             m->degree, m->degree_t > 0 ? " with time" : "");
}

static spin_status open_model(struct model *m, const struct spin_plugin_values *values,
                              struct spin_sequence_info *sequence)
{
    struct columns c = {0};
    spin_status status;

    SPIN_TRY(spin_torch_open(m->path, &m->torch));
    m->torch_open = true;
    SPIN_TRY(spin_realtime4dgs_parts(m->torch.root, &m->parts));
    SPIN_TRY(spin_run_config_open(m->path, spin_plugin_value(values, "config", NULL),
                                  "time_duration", &m->settings));
    SPIN_TRY(count_rows(m));
    SPIN_TRY(read_flags(m));
    if (!m->stale) {
        SPIN_TRY(bind_sh(m));
        SPIN_TRY(find_degrees(m));
    }
    SPIN_TRY_OUT(load_columns(m, &c));
    if (m->rot_4d)
        SPIN_TRY_OUT(
            choose_convention(m, &c, spin_plugin_value(values, "convention", "auto"), sequence));
    SPIN_TRY_OUT(add_rows(m, &c, sequence));
    if (m->parts.moving)
        SPIN_TRY_OUT(
            spin_run_config_times(&m->settings, spin_plugin_value(values, "time-duration", NULL),
                                  m->gaussians.time, m->gaussians.n, m->ratio, SPREAD, &m->times));
    note_losses(m, sequence);
    describe(m, sequence);
out:
    columns_free(&c);
    return status;
}

static spin_status realtime4dgs_open(const char *path, const struct spin_plugin_values *values,
                                     void **self, struct spin_sequence_info *sequence)
{
    struct model *m;

    *sequence = (struct spin_sequence_info){.sh_degree = -1};
    SPIN_TRY(spin_alloc(1, sizeof *m, self));
    m = *self;
    SPIN_TRY(find_checkpoint(path, &m->path, sequence));
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
    free(m->sh);
    free(m->path);
    free(m);
}

/* ---- One time -------------------------------------------------------------------------------- */

/* sh [(degree+1)^2][3] of the row that m->sh holds. */
static void colours_at(const struct model *m, double dt, float *out)
{
    size_t width = 3 * (size_t)((m->degree + 1) * (m->degree + 1));

    if (m->degree_t > 0)
        spin_sh_fold(m->degree_t, dt, (m->times.last - m->times.first) / m->ratio, m->sh, out);
    else
        memcpy(out, m->sh, width * sizeof *out);
}

static spin_status realtime4dgs_frame(void *self, int frame, double time, unsigned columns,
                                      struct spin_splats *out)
{
    struct model *m = self;
    size_t width = 3 * (size_t)((m->degree + 1) * (m->degree + 1));

    if (frame < 0)
        return spin_fail(SPIN_E_NOT_FOUND, "'%s' has no frame %d", m->path, frame);
    columns &= SPIN_COL_MEANS | SPIN_COL_QUATS | SPIN_COL_LOG_SCALES |
               (m->stale ? 0 : SPIN_COL_ATTRIBUTES);
    time = m->parts.moving ? time / m->ratio : 0;
    spin_gaussian4d_select(&m->gaussians, time, LEAST_WEIGHT, 0);
    SPIN_TRY(spin_splats_reserve(out, m->gaussians.n_kept, columns, m->degree));
    spin_gaussian4d_fill(&m->gaussians, time, columns, out);
    for (size_t k = 0; k < m->gaussians.n_kept && (columns & SPIN_COL_SH); k++) {
        size_t i = m->gaussians.kept[k];

        read_sh(m, m->gaussians.row[i]);
        colours_at(m, time - m->gaussians.time[i], out->sh + width * k);
    }
    return SPIN_OK;
}

static const struct spin_plugin_option options[] = {
    {"time-duration", "A,B", "the clip's first and last time, as in the training YAML", NULL},
    {"config", "FILE", "the training YAML (else one beside the checkpoint)", NULL},
    {"convention", "WORD", "of rotations: auto, today, or older (before 2024-09)", "auto"},
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
