/* Realtime-4DGS (Yang et al., ICLR 2024): chkpnt<N>.pth, a tuple of tensors.
 *
 * Gaussians are four-dimensional: at any time each is an ellipsoid of fixed shape on a straight
 * line, with a Gaussian window in time and cosines of time in its colour. The file states neither
 * the range of times nor which of two conventions its rotations follow. Options can state both;
 * without an option, a note for the user names the assumption.
 *
 * Hybrid 3D-4DGS (Oh et al., 2025): a fork of Realtime-4DGS that turns long-lived Gaussians into
 * static ones during training. A checkpoint contains two halves: dynamic Gaussians, which are those
 * of Realtime-4DGS, and static, permanent 3-D Gaussians.
 *
 * A training of Hybrid 3D-4DGS also writes a PLY that looks like a cloud of 3DGS, but contains only
 * the dynamic half, with every Gaussian at the centre of its window in time. */
#include "importers/lib/chkpnt.h"
#include "importers/lib/gaussian4d.h"

/* Largest number of floats in the SH of a row, spatial and temporal SH together. */
#define MAX_SH 144

/* The method's renderer skips Gaussians with this or a lower weight in time. */
#define LEAST_WEIGHT 0.05
/* Number of rows after which mapped pages of the file are released. */
#define PAGE_ROWS 4096
/* Training draws the Gaussians' initial times from the clip extended by 10% at both ends, a range
 * this many times as long as the clip. */
#define SPREAD 1.2

enum part {
    R4_ACTIVE,
    R4_XYZ, /* from here to R4_OPACITY: parts that static Gaussians have too */
    R4_DC,
    R4_REST,
    R4_SCALING,
    R4_ROTATION,
    R4_OPACITY,
    R4_T,
    R4_SCALING_T,
    R4_ROTATION_R,
    R4_ROT_4D,
    R4_ENV_MAP,
    R4_ACTIVE_T,
    R4_OPTIMIZER,
    R4_N_PARTS
};

struct rows {
    /* The parts in the checkpoint. */
    const char *who;                           /* prefix of the parts' names in messages, or NULL */
    const struct spin_value *part[R4_N_PARTS]; /* NULL: the part is missing */
    bool swapped;                              /* SH are stored as [N][3][K] instead of [N][K][3] */
    bool masked;      /* the tuple has one more item at its end, the mask of a fork */
    bool moving;      /* gaussian_dim is 4, so there are t and scaling_t */
    double iteration; /* iteration of the checkpoint; -1: unknown */
    /* Values that are read from the parts. */
    size_t n;
    bool rot_4d;             /* Gaussians are rotated in four dimensions: there is rotation_r */
    int n_sh;                /* number of SH in a row of the file; 0: SH are not read */
    int degree, degree_t;    /* spatial and temporal degree of the SH that the renderer uses */
    struct spin_array sh[2]; /* features_dc, features_rest; valid while the checkpoint is open */
    /* The columns, which are valid only during open(): xyz and scaling [n][3]; rotation and
     * rotation_r [n][4], not normalised; opacity [n], logits; t and scaling_t [n]. */
    float *column[R4_N_PARTS];
};

/* Variants of the conversion of rows to Gaussians. */
struct reading {
    bool older;      /* 4-D rotations follow the convention before 2024-09 */
    bool transposed; /* 3-D rotations are inverted */
    double extra;    /* added to the variance of the window in time, but not to the shape */
};

/* ---- Parts of a checkpoint ------------------------------------------------------------------- */

/* Where each part is stored. item, item3: index in the tuple of a 4-D and of a 3-D model (-1:
 * none). attribute: key in the dict of a fork, which is the name of the class's attribute. loaded:
 * key in loaded_pth. width: floats per row; 0: not read as a column. */
static const struct {
    const char *name;
    int item, item3;
    const char *attribute, *loaded;
    int width;
} all[R4_N_PARTS] = {
    [R4_ACTIVE] = {"active_sh_degree", 0, 0, "active_sh_degree", NULL, 0},
    [R4_XYZ] = {"xyz", 1, 1, "_xyz", "xyz", 3},
    [R4_DC] = {"features_dc", 2, 2, "_features_dc", "features_dc", 0},
    [R4_REST] = {"features_rest", 3, 3, "_features_rest", "features_rest", 0},
    [R4_SCALING] = {"scaling", 4, 4, "_scaling", "scaling", 3},
    [R4_ROTATION] = {"rotation", 5, 5, "_rotation", "rotation", 4},
    [R4_OPACITY] = {"opacity", 6, 6, "_opacity", "opacity", 1},
    [R4_T] = {"t", 13, -1, "_t", "t", 1},
    [R4_SCALING_T] = {"scaling_t", 14, -1, "_scaling_t", "scaling_t", 1},
    [R4_ROTATION_R] = {"rotation_r", 15, -1, "_rotation_r", "rotation_r", 4},
    [R4_ROT_4D] = {"rot_4d", 16, -1, "rot_4d", NULL, 0},
    [R4_ENV_MAP] = {"env_map", 17, -1, "env_map", NULL, 0},
    [R4_ACTIVE_T] = {"active_sh_degree_t", 18, -1, "active_sh_degree_t", NULL, 0},
    [R4_OPTIMIZER] = {"optimizer", 11, 10, NULL, NULL, 0},
};

static bool is_kind(const struct spin_value *v, enum spin_value_kind kind)
{
    return v && v->kind == kind;
}

/* Whether a part is missing, None, or without elements. */
static bool r4_lacks(const struct rows *r, enum part part)
{
    const struct spin_value *v = r->part[part];

    return !v || v->kind == SPIN_VALUE_NONE || spin_chkpnt_is_empty(v);
}

/* Sets the parts from the first 19 items of a 4-D model's tuple. */
static void r4_items(const struct spin_value *model, struct rows *r)
{
    r->moving = true;
    for (int p = 0; p < R4_N_PARTS; p++)
        r->part[p] = spin_value_at(model, (size_t)all[p].item);
}

static spin_status take_tuple(const struct spin_value *m, struct rows *r)
{
    r->masked = m->n == 20 || m->n == 13;
    if (m->n == 19 || m->n == 20) {
        r4_items(m, r);
        return SPIN_OK;
    }
    if (m->n != 12 && m->n != 13)
        return spin_unsupported("the model has %zu items, expected the 19 (or 12) of "
                                "Realtime-4DGS: this is a model of %s",
                                m->n, spin_chkpnt_method(m->n));
    for (int p = 0; p < R4_N_PARTS; p++)
        r->part[p] = all[p].item3 < 0 ? NULL : spin_value_at(m, (size_t)all[p].item3);
    return SPIN_OK;
}

/* Sets the parts from the dict that a fork saves instead of a tuple. */
static void take_attributes(const struct spin_value *m, struct rows *r)
{
    double dim = 4;

    spin_value_number(spin_value_get(m, "gaussian_dim"), &dim);
    r->moving = dim == 4;
    for (int p = 0; p < R4_N_PARTS; p++)
        r->part[p] = all[p].attribute ? spin_value_get(m, all[p].attribute) : NULL;
}

/* Sets the parts from the dict that training reads as loaded_pth, whose keys begin with `prefix`.
 * In this dict, the last two axes of the features are swapped, and there are no SH degrees. */
static void r4_loaded(const struct spin_value *dict, const char *prefix, struct rows *r)
{
    r->swapped = true;
    for (int p = 0; p < R4_N_PARTS; p++) {
        char name[64];

        snprintf(name, sizeof name, "%s%s", prefix, all[p].loaded ? all[p].loaded : "");
        if (all[p].loaded)
            r->part[p] = spin_value_get(dict, name);
    }
}

/* Finds the parts; *r must be zeroed. Checkpoints of other methods are refused; the message names
 * the method if it is recognised. */
static spin_status r4_find(const struct spin_value *root, struct rows *r)
{
    const struct spin_value *m = spin_value_at(root, 0);

    r->iteration = -1;
    if (is_kind(root, SPIN_VALUE_DICT) && spin_value_get(root, "xyz") &&
        spin_value_get(root, "scaling_t")) {
        if (spin_value_get(root, "static_xyz"))
            return spin_unsupported("a dict with static_xyz is a model of %s",
                                    spin_chkpnt_method(28));
        r4_loaded(root, "", r);
        r->moving = true;
        return SPIN_OK;
    }
    if (!is_kind(root, SPIN_VALUE_TUPLE) || root->n != 2)
        return spin_malformed("the checkpoint contains %s, expected a tuple (model, iteration)",
                              spin_chkpnt_kind(root));
    spin_value_number(spin_value_at(root, 1), &r->iteration);
    if (is_kind(m, SPIN_VALUE_DICT) && spin_value_get(m, "_xyz")) {
        take_attributes(m, r);
        return SPIN_OK;
    }
    if (!is_kind(m, SPIN_VALUE_TUPLE) || !is_kind(spin_value_at(root, 1), SPIN_VALUE_INT))
        return spin_malformed("the checkpoint contains %s and %s, expected a tuple and an int",
                              spin_chkpnt_kind(m), spin_chkpnt_kind(spin_value_at(root, 1)));
    return take_tuple(m, r);
}

/* ---- Tensors --------------------------------------------------------------------------------- */

static spin_status bind_part(struct spin_model *m, const struct rows *r, enum part part, int n_dims,
                             const int64_t *shape, struct spin_array *out)
{
    char name[64];

    snprintf(name, sizeof name, "%s%s", r->who ? r->who : "", all[part].name);
    return spin_chkpnt_bind(&m->torch, r->part[part], name, n_dims, shape, out);
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

static spin_status bind_sh(struct spin_model *m, struct rows *r)
{
    int64_t n = (int64_t)r->n;
    int64_t dc[3] = {n, r->swapped ? 3 : 1, r->swapped ? 1 : 3};
    int64_t rest[3] = {n, r->swapped ? 3 : -1, r->swapped ? -1 : 3};

    SPIN_TRY(bind_part(m, r, R4_DC, 3, dc, &r->sh[0]));
    SPIN_TRY(bind_part(m, r, R4_REST, 3, rest, &r->sh[1]));
    for (int i = 0; i < 2 && r->swapped; i++)
        swap_axes(&r->sh[i]);
    if (r->sh[1].shape[1] > 47)
        return spin_malformed("features_rest has %llu rows of SH, expected at most 47",
                              (unsigned long long)r->sh[1].shape[1]);
    r->n_sh = 1 + (int)r->sh[1].shape[1];
    return SPIN_OK;
}

/* Reads all SH of a row, [n_sh][3]. */
static void r4_sh(const struct rows *r, size_t i, float out[MAX_SH])
{
    uint64_t width = 3 * (uint64_t)(r->n_sh - 1);

    spin_array_to_f32(&r->sh[0], 3 * i, 3, out);
    if (width > 0)
        spin_array_to_f32(&r->sh[1], width * i, width, out + 3);
}

/* ---- SH degrees ------------------------------------------------------------------------------ */

/* Derives two properties from the number of SH in a row: the spatial degree, and whether the row
 * includes temporal SH, the factors of the cosines of time. `configured` is sh_degree of cfg_args,
 * or -1 if it is unknown. Returns false for a number that no setting of the method yields. */
static bool sh_to_degree(int n_sh, double configured, int *degree, bool *in_time)
{
    for (int d = 0; d <= 3; d++) {
        int n = (d + 1) * (d + 1);
        /* For each degree, the number of SH that training allocates with its default options. The
         * SH beyond the spatial ones are never used. */
        static const int unused[] = {1, 6, 16, 33};

        if (n_sh == 16 && configured != 2 &&
            d == 2) /* 16 SH mean degree 3, or degree 2 if cfg_args has sh_degree=2 */
            continue;
        if (n_sh == n || n_sh == 3 * n || n_sh == unused[d]) {
            *degree = d;
            *in_time = n_sh == 3 * n && n_sh != unused[d];
            return true;
        }
    }
    return false;
}

static spin_status read_degree(const struct spin_value *v, const char *what, int largest, int *out)
{
    double value = -1;

    if (!spin_value_number(v, &value) || value != floor(value) || value < 0 || value > largest)
        return spin_malformed("%s is %s %g, expected 0 to %d", what, spin_chkpnt_kind(v), value,
                              largest);
    *out = (int)value;
    return SPIN_OK;
}

static spin_status find_degrees(struct rows *r, double configured)
{
    bool in_time = false;
    int most = 0;

    if (!sh_to_degree(r->n_sh, configured, &most, &in_time))
        return spin_malformed(
            "features_dc and features_rest have %d rows of SH together, which matches no SH degree",
            r->n_sh);
    if (r->swapped) {
        r->degree = most;
        r->degree_t = in_time && r->moving ? 2 : 0;
    } else {
        SPIN_TRY(read_degree(r->part[R4_ACTIVE], "the active SH degree", 3, &r->degree));
        if (r->moving)
            SPIN_TRY(read_degree(r->part[R4_ACTIVE_T], "the active temporal SH degree", 2,
                                 &r->degree_t));
    }
    r->degree = r->degree < most ? r->degree : most;
    /* The renderer uses the cosines only if the spatial degree is 3. */
    if (!in_time || r->degree < 3)
        r->degree_t = 0;
    return SPIN_OK;
}

/* ---- Reading --------------------------------------------------------------------------------- */

/* Reads all tensors except the SH, and binds the SH if `with_sh`. If the number of SH fits two
 * degrees, sh_degree of cfg_args decides. A checkpoint without rows is not an error. */
static spin_status r4_read(struct spin_model *m, bool with_sh, struct rows *r)
{
    static const int64_t places[2] = {-1, 3};
    const struct spin_value *rot_4d = r->part[R4_ROT_4D], *right = r->part[R4_ROTATION_R];
    bool has_right = right && right->kind == SPIN_VALUE_TENSOR && !spin_chkpnt_is_empty(right);
    double configured = -1;
    struct spin_array t;

    SPIN_TRY(bind_part(m, r, R4_XYZ, 2, places, &t));
    r->n = (size_t)t.shape[0];
    if (r->n == 0)
        return SPIN_OK;
    r->rot_4d = r->moving && (rot_4d ? rot_4d->integer != 0 : has_right);
    if (r->rot_4d && !has_right)
        return spin_malformed("rot_4d is true, but the right quaternions are empty");
    SPIN_TRY(spin_cfg_read_number(&m->settings.cfg, "sh_degree", &configured));
    if (with_sh) {
        SPIN_TRY(bind_sh(m, r));
        SPIN_TRY(find_degrees(r, configured));
    }
    for (int p = 0; p < R4_N_PARTS; p++) { /* accepts nonfinite values: r4_add() drops such rows */
        int64_t shape[2] = {(int64_t)r->n, all[p].width};

        if (all[p].width == 0 || (p >= R4_T && !r->moving) || (p == R4_ROTATION_R && !r->rot_4d))
            continue;
        SPIN_TRY(bind_part(m, r, p, 2, shape, &t));
        SPIN_TRY(spin_model_scratch(m, r->n, (size_t)all[p].width * sizeof(float),
                                    (void **)&r->column[p]));
        spin_array_to_f32(&t, 0, t.count, r->column[p]);
    }
    return SPIN_OK;
}

/* ---- Gaussians ------------------------------------------------------------------------------- */

/* Computes the slice of a row with rot_4d, whose shape is the same at all times. */
static void r4_slice(const struct rows *r, size_t i, bool older, spin_slice *out)
{
    double left[4], right[4], scale[4], a[16];

    for (size_t k = 0; k < 4; k++) {
        left[k] = r->column[R4_ROTATION][4 * i + k];
        right[k] = r->column[R4_ROTATION_R][4 * i + k];
        scale[k] = exp(k < 3 ? r->column[R4_SCALING][3 * i + k] : r->column[R4_SCALING_T][i]);
    }
    spin_rotation4_of_pair(left, right, older, a);
    spin_slice_of(a, scale, out);
}

static float *add_row(struct spin_model *m, const struct rows *r, size_t i, size_t row,
                      const struct reading *reading, struct gaussian4d *gaussians)
{
    static const double still[3] = {0, 0, 0};
    double logit = r->column[R4_OPACITY][i], log_scale[3], quat[4];

    if (r->rot_4d) {
        spin_slice s;

        r4_slice(r, i, reading->older, &s);
        return spin_gaussian4d_add_slice(m, gaussians, row, r->column[R4_XYZ] + 3 * i,
                                         r->column[R4_T][i], logit, &s, reading->extra);
    }
    spin_unit_quat(r->column[R4_ROTATION] + 4 * i, quat);
    for (int k = 0; k < 3; k++) {
        log_scale[k] = r->column[R4_SCALING][3 * i + (size_t)k];
        quat[k + 1] = reading->transposed ? -quat[k + 1] : quat[k + 1];
    }
    /* Without rot_4d, exp(scaling_t) is the variance, not the standard deviation. */
    return spin_gaussian4d_add(
        m, gaussians, row, r->column[R4_XYZ] + 3 * i, r->moving ? r->column[R4_T][i] : 0, logit,
        still, r->moving ? exp(r->column[R4_SCALING_T][i]) + reading->extra : HUGE_VAL, log_scale,
        quat);
}

/* Adds all rows to `gaussians`, where they are numbered from `row` on. Rows without a time (not
 * r->moving) are permanent. Rows with nonfinite values are dropped and counted. Returns the number
 * of rows with an opacity below SPIN_FAINT. */
static size_t r4_add(struct spin_model *m, const struct rows *r, size_t row,
                     const struct reading *reading, struct gaussian4d *gaussians)
{
    const struct spin_splats_4d *s = &m->splats_4d;
    size_t n_faint = 0, width = 3 * (size_t)((r->degree + 1) * (r->degree + 1));

    for (size_t i = 0; i < r->n; i++) {
        float sh[MAX_SH], *to;

        for (int k = 0; k < 2 && i % PAGE_ROWS == 0 && r->n_sh > 0; k++)
            spin_torch_forget(&m->torch, &r->sh[k]);
        if (r->n_sh > 0)
            r4_sh(r, i, sh);
        if (r->n_sh > 0 && spin_finite_missing(sh, 3 * (size_t)r->n_sh) > 0) {
            gaussians->n_dropped++;
            continue;
        }
        n_faint += spin_sigmoid_of(r->column[R4_OPACITY][i]) < SPIN_FAINT;
        to = add_row(m, r, i, row + i, reading, gaussians);
        if (!to || r->n_sh == 0)
            continue;
        memcpy(to, sh, width * sizeof *sh);
        if (r->degree_t > 0) /* there are 16 SH for each cosine */
            memcpy(s->sh_cos + 2 * (to - s->sh), sh + width,
                   (size_t)r->degree_t * width * sizeof *sh);
    }
    return n_faint;
}

/* Returns the optional arrays of struct spin_splats_4d that the rows need. */
static unsigned r4_parts(const struct rows *r) { return r->degree_t > 0 ? SPIN_4D_SH_COS : 0; }

/* ---- Messages -------------------------------------------------------------------------------- */

/* Returns a text such as ", iteration 30000", or "" if the iteration is unknown. */
static const char *r4_iteration(const struct rows *r, char text[48])
{
    text[0] = '\0';
    if (r->iteration >= 0)
        snprintf(text, 48, ", iteration %.0f", r->iteration);
    return text;
}

/* Adds notes for the user if the times were guessed, and if there is an environment map. */
static void r4_note(const struct rows *r, const struct clip_times *times,
                    struct spin_sequence_info *sequence)
{
    const struct spin_value *env = r->part[R4_ENV_MAP];

    if (times->guessed)
        spin_note(sequence,
                  "time_duration is not in the run's folder: %g,%g is assumed, from the Gaussians' "
                  "times%s; set time_duration with --time-duration or --config",
                  times->first, times->last,
                  r->degree_t > 0 ? ", and colours depend on time_duration" : "");
    if (env && env->kind == SPIN_VALUE_TENSOR && !spin_chkpnt_is_empty(env))
        spin_note(sequence, "the environment map is not imported: the distant background, such as "
                            "the sky, is missing");
}

/* ---- Realtime-4DGS --------------------------------------------------------------------------- */

struct realtime_model {
    struct spin_model base;
    struct rows rows;
    struct reading reading;
    bool stale;   /* the stored SH and opacities are obsolete: see is_stale() */
    double ratio; /* the data set's times divided by those of the file */
    struct clip_times times;
    struct gaussian4d gaussians;
};

/* ---- Recognising ----------------------------------------------------------------------------- */

/* Whether the pickle begins with "((int, Parameter, ...", as in checkpoints of this method. */
static bool begins_like_ours(const struct spin_peek *peek)
{
    static const char parameter[] = "ctorch._utils\n_rebuild_parameter";
    const unsigned char *at = memmem(peek->head, peek->n_head, "\x80\x02(K", 4);

    return at && (size_t)(peek->head + peek->n_head - at) > 5 + sizeof parameter &&
           memcmp(at + 5, parameter, sizeof parameter - 1) == 0;
}

static int realtime_probe(const struct spin_peek *peek)
{
    bool named = spin_chkpnt_iteration(spin_path_name(peek->path)) >= 0;

    if (peek->is_folder) {
        bool found = false;

        for (size_t i = 0; peek->names && peek->names[i]; i++)
            found = found || spin_chkpnt_iteration(peek->names[i]) >= 0;
        /* A checkpoint beside a folder point_cloud may also be one of plain 3DGS or its
         * descendants. */
        return found ? (spin_peek_has(peek, "point_cloud") ? 20 : 70) : 0;
    }
    if (begins_like_ours(peek))
        return named ? 80 : 50;
    return named ? 40 : 0;
}

/* ---- Shapes ---------------------------------------------------------------------------------- */

/* Returns the median, over at most MOST Gaussians, of the largest standard deviation in space.
 * Rotations are assumed to follow the older convention if `older` is true, otherwise today's. */
static double median_extent(const struct rows *rows, bool older)
{
    enum { MOST = 4096 };
    static const double unusable = 1e300;
    double extent[MOST];
    size_t n = rows->n, step = n / MOST + 1, n_used = 0;

    for (size_t i = 0; i < n && n_used < MOST; i += step) {
        double value[3], vector[9], largest = 0;
        spin_slice s;

        r4_slice(rows, i, older, &s);
        if (!spin_eigen3(s.cov6, value, vector))
            largest = unusable;
        for (int k = 0; k < 3 && largest < unusable; k++)
            largest = value[k] > largest ? value[k] : largest;
        extent[n_used++] = largest;
    }
    qsort(extent, n_used, sizeof *extent, spin_by_double);
    return sqrt(extent[n_used / 2]);
}

/* Chooses the convention of rotations: that of option `convention` or, if its value is auto, the
 * older one if this makes the Gaussians clearly smaller, otherwise today's. Under the wrong
 * convention, Gaussians are larger, since the long time axis of static ones points into space. */
static spin_status choose_convention(struct realtime_model *m)
{
    enum { AUTO, TODAY, OLDER };
    struct spin_sequence_info *sequence = m->base.sequence;
    double today = median_extent(&m->rows, false), older = median_extent(&m->rows, true);
    bool hint = older < 0.95 * today;
    int asked;

    SPIN_TRY(spin_option_word(m->base.values, "convention", "auto|today|older", &asked));
    m->reading.older = asked == AUTO ? hint : asked == OLDER;
    if (asked == AUTO)
        spin_note(sequence,
                  "the file does not state its convention of rotations: assumed the one used %s "
                  "September "
                  "2024, by the sizes of the Gaussians (median %.3g; %.3g with the other "
                  "convention); set it "
                  "with --convention today|older",
                  m->reading.older ? "before" : "since", m->reading.older ? older : today,
                  m->reading.older ? today : older);
    else if (hint != m->reading.older)
        spin_note(sequence,
                  "the sizes of the Gaussians suggest the other convention of rotations (median "
                  "%.3g; %.3g with the requested one)",
                  hint ? older : today, hint ? today : older);
    return SPIN_OK;
}

/* ---- Opening --------------------------------------------------------------------------------- */

/* Whether this is a checkpoint of OMG4 for which networks compute colours and opacities. The SH and
 * opacities in the checkpoint are then obsolete, and the networks are in another file. */
static bool is_stale(const struct rows *r)
{
    const struct spin_value *groups = spin_value_get(r->part[R4_OPTIMIZER], "param_groups");

    for (size_t i = 0; groups && i < groups->n; i++) {
        const char *name = spin_value_text(spin_value_get(spin_value_at(groups, i), "name"));

        if (name && (strcmp(name, "f_static") == 0 || strcmp(name, "f_view") == 0))
            return true;
    }
    return false;
}

static void realtime_describe(const struct realtime_model *m)
{
    struct spin_sequence_info *sequence = m->base.sequence;
    const struct rows *r = &m->rows;
    char iteration[48];

    if (m->stale)
        spin_note(sequence, "this checkpoint of OMG4 lacks the networks for colours and opacities: "
                            "only the geometry is imported; import comp.xz for all attributes");
    r4_note(r, &m->times, sequence);
    if (r->masked)
        spin_note(sequence,
                  "the last item of the model is ignored: a mask that a fork of the method adds");
    /* Issue 50 of the method's repository: training can lose the gradients of the temporal SH. */
    if (!m->stale && r->degree_t > 0 && !m->base.splats_4d.sh_cos)
        spin_note(sequence, "all temporal SH are 0: colours do not change over time");
    sequence->continuous = r->moving;
    sequence->counts = r->moving ? NULL : &m->base.splats_4d.n;
    if (m->stale) {
        sequence->columns = SPIN_COL_MEANS | SPIN_COL_QUATS | SPIN_COL_LOG_SCALES;
        sequence->sh_degree = -1;
    }
    snprintf(sequence->variant, sizeof sequence->variant,
             "Realtime-4DGS%s, %zu Gaussians, %s, SH degree %d%s", r4_iteration(r, iteration), r->n,
             !r->moving  ? "static (3D)"
             : r->rot_4d ? "rot_4d"
                         : "no rot_4d",
             r->degree, r->degree_t > 0 ? " with time" : "");
}

static spin_status realtime_open_checkpoint(struct realtime_model *m)
{
    struct spin_model *base = &m->base;
    const struct run_config *settings = &base->settings;
    size_t n_faint;
    int rule;

    SPIN_TRY(spin_option_word(base->values, "cull", "time|none", &rule));
    base->splats_4d.least_weight = rule == 1 ? -1 : LEAST_WEIGHT;
    SPIN_TRY(r4_find(base->torch.root, &m->rows));
    m->stale = is_stale(&m->rows);
    SPIN_TRY(r4_read(base, !m->stale, &m->rows));
    if (m->rows.n == 0)
        return spin_malformed("the file contains 0 Gaussians");
    if (m->rows.rot_4d)
        SPIN_TRY(choose_convention(m));
    m->reading.transposed = !m->rows.rot_4d && m->rows.moving &&
                            spin_yaml_bool(settings, "compute_cov3D_python", false);
    SPIN_TRY(spin_gaussian4d_reserve(base, &m->gaussians, m->rows.n, m->rows.degree,
                                     r4_parts(&m->rows)));
    n_faint = r4_add(base, &m->rows, 0, &m->reading, &m->gaussians);
    SPIN_TRY(spin_gaussian4d_check(&m->gaussians, m->rows.n, m->stale ? 0 : n_faint,
                                   "values that are not finite", base->sequence));
    if (m->reading.transposed)
        spin_note(base->sequence,
                  "'%s' sets compute_cov3D_python: rotations are transposed, as in the method",
                  settings->yaml_path);
    return SPIN_OK;
}

static spin_status realtime_open_run(void *self, const char *path)
{
    struct realtime_model *m = self;
    struct spin_model *base = &m->base;
    const struct run_config *settings = &base->settings;
    double extra = 0;

    SPIN_TRY(spin_chkpnt_find(base, path));
    if (!base->path)
        return spin_not_found("'%s' contains no chkpnt<N>.pth", path);
    SPIN_TRY(spin_fail_reading(spin_torch_open(base->path, &base->torch), base->path));
    SPIN_TRY(spin_model_config(base)); /* its errors already name a file */
    SPIN_TRY(spin_run_config_ratio(settings, &m->ratio));
    SPIN_TRY(spin_cfg_read_number(&settings->cfg, "prefilter_var", &extra));
    m->reading.extra = extra > 0 && isfinite(extra) ? extra : 0;
    SPIN_TRY(spin_fail_reading(realtime_open_checkpoint(m), base->path));
    if (m->rows.moving)
        SPIN_TRY(spin_run_config_times(settings, spin_model_option(base, "time-duration"),
                                       base->splats_4d.times, m->gaussians.n, m->ratio, SPREAD,
                                       &m->times));
    spin_gaussian4d_drop_zeros(base);
    SPIN_TRY(spin_gaussian4d_finish(base, &m->gaussians, m->ratio, &m->times));
    realtime_describe(m);
    return SPIN_OK;
}

static const struct spin_plugin_option realtime_options[] = {
    {"time-duration", "A,B", "the clip's first and last time, as in the training YAML", NULL},
    {"config", "FILE", "the training YAML (default: the one beside the checkpoint)", NULL},
    {"convention", "WORD",
     "convention of rotations: today, older (before 2024-09), or auto for the one that makes the "
     "Gaussians smaller",
     "auto"},
    {"cull", "RULE", "which Gaussians a frame omits: time (weight in time below 0.05), or none",
     "time"},
    {NULL, NULL, NULL, NULL},
};

SPIN_MODEL_IMPORTER(realtime4dgs, struct realtime_model, realtime_open_run, spin_model_close,
                    .summary = "Realtime-4DGS: chkpnt<N>.pth, or its folder",
                    .upstream = "fudan-zvg/4d-gaussian-splatting 63725f2",
                    .options = realtime_options, .probe = realtime_probe, .frame = spin_model_slice,
                    .splats_4d = spin_model_splats_4d)

/* ---- Hybrid 3D-4DGS -------------------------------------------------------------------------- */

enum { N_ITEMS = 28 };

/* The two halves of a checkpoint: dynamic and static Gaussians, in the order that the method's
 * renderer uses. */
enum { MOVING, STILL, N_HALVES };

struct hybrid_model {
    struct spin_model base;
    struct rows half[N_HALVES];
    struct gaussian4d gaussians; /* of both halves, with consecutive row numbers */
    size_t n_moving;             /* number of dynamic Gaussians in `gaussians` */
    double ratio;                /* the data set's times divided by those of the file */
    struct clip_times times;
};

/* ---- Recognising ----------------------------------------------------------------------------- */

static int hybrid_probe(const struct spin_peek *peek)
{
    /* Recognises parameter groups in the optimiser of a checkpoint, or two options in cfg_args that
     * only this method combines. */
    if (spin_peek_contains(peek, "static_xyz") && spin_peek_contains(peek, "scaling_t"))
        return 95;
    return peek->is_folder && spin_peek_contains(peek, "from3dgs=") &&
                   spin_peek_contains(peek, "start_timestamp=")
               ? 95
               : 0;
}

/* ---- The two halves -------------------------------------------------------------------------- */

static spin_status take_parts(const struct spin_value *root, struct hybrid_model *m)
{
    struct rows *moving = &m->half[MOVING], *still = &m->half[STILL];
    const struct spin_value *model, *rot_4d;

    still->who = "static ";
    moving->iteration = -1;
    if (spin_value_get(root, "scaling_t") && spin_value_get(root, "static_xyz")) {
        r4_loaded(root, "", moving);
        r4_loaded(root, "static_", still);
        moving->moving = true;
        return SPIN_OK;
    }
    SPIN_TRY(spin_chkpnt_model(root, N_ITEMS, "Hybrid 3D-4DGS", &model, &moving->iteration));
    r4_items(model, moving);
    rot_4d = moving->part[R4_ROT_4D];
    if (!rot_4d || rot_4d->kind != SPIN_VALUE_BOOL)
        return spin_malformed("item 16 (rot_4d) is %s, expected a bool", spin_chkpnt_kind(rot_4d));
    still->part[R4_ACTIVE] = moving->part[R4_ACTIVE];
    for (int p = R4_XYZ; p <= R4_OPACITY; p++)
        still->part[p] = spin_value_at(model, (size_t)(19 + p - R4_XYZ));
    return SPIN_OK;
}

/* Checks a half without Gaussians: all its parts must be None or empty tensors. */
static spin_status check_nothing(const struct rows *r)
{
    const char *who = r->who ? r->who : "";

    for (int p = R4_DC; p <= R4_SCALING_T; p++) {
        if (!r4_lacks(r, p))
            return spin_malformed("%s%s is not empty, but %sxyz is", who, all[p].name, who);
    }
    return SPIN_OK;
}

static spin_status hybrid_read_rows(struct hybrid_model *m)
{
    const struct rows *moving = &m->half[MOVING], *still = &m->half[STILL];

    for (int h = 0; h < N_HALVES; h++) {
        if (r4_lacks(&m->half[h], R4_XYZ))
            SPIN_TRY(check_nothing(&m->half[h]));
        else
            SPIN_TRY(r4_read(&m->base, true, &m->half[h]));
    }
    if (moving->n == 0 && still->n == 0)
        return spin_malformed("the file contains 0 Gaussians");
    if (moving->n == 0 || still->n == 0)
        return SPIN_OK;
    if (moving->n_sh != still->n_sh)
        return spin_malformed(
            "dynamic Gaussians have %d rows of SH and static ones %d, expected the same",
            moving->n_sh, still->n_sh);
    if (!moving->rot_4d)
        return spin_malformed(
            "there are static Gaussians, which require 4-D rotations, but rot_4d is false");
    return SPIN_OK;
}

static spin_status add_rows(struct hybrid_model *m)
{
    static const struct reading reading = {false, false, 0};
    struct spin_sequence_info *sequence = m->base.sequence;
    size_t n_moving = m->half[MOVING].n, n_still = m->half[STILL].n, n_faint, n_dropped;

    SPIN_TRY(spin_gaussian4d_reserve(&m->base, &m->gaussians, n_moving + n_still,
                                     m->half[n_moving > 0 ? MOVING : STILL].degree,
                                     r4_parts(&m->half[MOVING])));
    n_faint = r4_add(&m->base, &m->half[MOVING], 0, &reading, &m->gaussians);
    m->n_moving = m->gaussians.n;
    n_dropped = m->gaussians.n_dropped;
    n_faint += r4_add(&m->base, &m->half[STILL], n_moving, &reading, &m->gaussians);
    if (n_dropped > 0)
        spin_note(
            sequence, "%s dropped because of values that are not finite",
            spin_text_share(n_dropped, n_moving, "dynamic Gaussian", "is", "are", (char[96]){0}));
    if (m->gaussians.n_dropped > n_dropped)
        spin_note(
            sequence,
            "%s dropped because of values that are not finite; the method's own conversion "
            "produces rotations with such values, and the method's renderer skips these Gaussians",
            spin_text_share(m->gaussians.n_dropped - n_dropped, n_still, "static Gaussian", "is",
                            "are", (char[96]){0}));
    return spin_gaussian4d_check(&m->gaussians, n_moving + n_still, n_faint, NULL, sequence);
}

/* ---- Opening --------------------------------------------------------------------------------- */

static void hybrid_describe(const struct hybrid_model *m)
{
    const struct rows *moving = &m->half[MOVING];
    struct spin_sequence_info *sequence = m->base.sequence;
    char iteration[48];

    sequence->continuous = m->n_moving > 0;
    sequence->counts = m->n_moving > 0 ? NULL : &m->base.splats_4d.n;
    snprintf(sequence->variant, sizeof sequence->variant,
             "Hybrid 3D-4DGS%s, %zu dynamic and %zu static Gaussians, SH degree %d%s",
             r4_iteration(moving, iteration), moving->n, m->half[STILL].n,
             m->base.splats_4d.sh_degree, moving->degree_t > 0 ? " with time" : "");
    r4_note(moving, &m->times, sequence);
}

static spin_status hybrid_open_checkpoint(struct hybrid_model *m)
{
    struct spin_model *base = &m->base;

    SPIN_TRY(take_parts(base->torch.root, m));
    SPIN_TRY(hybrid_read_rows(m));
    return add_rows(m);
}

static spin_status hybrid_open_run(void *self, const char *path)
{
    struct hybrid_model *m = self;
    struct spin_model *base = &m->base;

    base->splats_4d.least_weight = LEAST_WEIGHT;
    SPIN_TRY(spin_chkpnt_find(base, path));
    if (!base->path)
        return spin_not_found(
            "'%s' contains no chkpnt<N>.pth%s", path,
            spin_model_holds(path, "point_cloud")
                ? "; point_cloud.ply cannot replace the checkpoint, since it contains only the "
                  "dynamic half, without times and with wrong rotations"
                : "");
    SPIN_TRY(spin_fail_reading(spin_torch_open(base->path, &base->torch), base->path));
    SPIN_TRY(spin_model_config(base));
    SPIN_TRY(spin_run_config_ratio(&base->settings, &m->ratio));
    SPIN_TRY(spin_fail_reading(hybrid_open_checkpoint(m), base->path));
    if (m->n_moving > 0)
        SPIN_TRY(spin_run_config_times(&base->settings, spin_model_option(base, "time-duration"),
                                       base->splats_4d.times, m->n_moving, m->ratio, SPREAD,
                                       &m->times));
    spin_gaussian4d_drop_zeros(base);
    SPIN_TRY(spin_gaussian4d_finish(base, &m->gaussians, m->ratio, &m->times));
    hybrid_describe(m);
    return SPIN_OK;
}

static const struct spin_plugin_option hybrid_options[] = {
    {"time-duration", "A,B", "the clip's first and last time, as in the training YAML", NULL},
    {"config", "FILE", "the training YAML (default: the one beside the checkpoint)", NULL},
    {NULL, NULL, NULL, NULL},
};

SPIN_MODEL_IMPORTER(hybrid4dgs, struct hybrid_model, hybrid_open_run, spin_model_close,
                    .summary = "Hybrid 3D-4DGS: chkpnt<N>.pth, or its folder",
                    .upstream = "ohsngjun/3D-4DGS 9528828", .options = hybrid_options,
                    .probe = hybrid_probe, .frame = spin_model_slice,
                    .splats_4d = spin_model_splats_4d)
