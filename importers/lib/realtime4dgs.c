/* Checkpoints of Realtime-4DGS: their parts, and the rows in these. */
#include "importers/lib/realtime4dgs.h"

#include <stdlib.h>
#include <string.h>

#include "importers/lib/chkpnt.h"

/* Of time, for what is there at all times: no square of a time comes near it. */
#define ALL_TIMES 1e300

/* ---- Parts ----------------------------------------------------------------------------------- */

/* Where a part is: its item in the tuples of a 4-D and of a 3-D model (-1: none), its name in a fork's dict, which
 * is that of the attribute of the class, and in loaded_pth. width: floats of a row; 0: not read so. */
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

const char *spin_realtime4dgs_name(enum realtime4dgs_part part) { return all[part].name; }

bool spin_realtime4dgs_lacks(const struct realtime4dgs *r, enum realtime4dgs_part part)
{
    const struct spin_value *v = r->part[part];

    return !v || v->kind == SPIN_VALUE_NONE || spin_chkpnt_is_empty(v);
}

void spin_realtime4dgs_items(const struct spin_value *model, struct realtime4dgs *r)
{
    r->moving = true;
    for (int p = 0; p < R4_N_PARTS; p++)
        r->part[p] = spin_value_at(model, (size_t)all[p].item);
}

static spin_status take_tuple(const struct spin_value *m, struct realtime4dgs *r)
{
    r->masked = m->n == 20 || m->n == 13;
    if (m->n == 19 || m->n == 20) {
        spin_realtime4dgs_items(m, r);
        return SPIN_OK;
    }
    if (m->n != 12 && m->n != 13)
        return spin_fail(SPIN_E_UNSUPPORTED,
                         "the model has %zu items and Realtime-4DGS has 19 (or 12): it is one of "
                         "%s",
                         m->n, spin_chkpnt_maker(m->n));
    for (int p = 0; p < R4_N_PARTS; p++)
        r->part[p] = all[p].item3 < 0 ? NULL : spin_value_at(m, (size_t)all[p].item3);
    return SPIN_OK;
}

/* A fork's dict. */
static void take_attributes(const struct spin_value *m, struct realtime4dgs *r)
{
    double dim = 4;

    spin_value_number(spin_value_get(m, "gaussian_dim"), &dim);
    r->moving = dim == 4;
    for (int p = 0; p < R4_N_PARTS; p++)
        r->part[p] = all[p].attribute ? spin_value_get(m, all[p].attribute) : NULL;
}

void spin_realtime4dgs_loaded(const struct spin_value *dict, const char *prefix,
                              struct realtime4dgs *r)
{
    r->swapped = true;
    for (int p = 0; p < R4_N_PARTS; p++) {
        char name[64];

        snprintf(name, sizeof name, "%s%s", prefix, all[p].loaded ? all[p].loaded : "");
        if (all[p].loaded)
            r->part[p] = spin_value_get(dict, name);
    }
}

spin_status spin_realtime4dgs_parts(const struct spin_value *root, struct realtime4dgs *r)
{
    const struct spin_value *m = spin_value_at(root, 0);

    r->iteration = -1;
    if (is_kind(root, SPIN_VALUE_DICT) && spin_value_get(root, "xyz") &&
        spin_value_get(root, "scaling_t")) {
        if (spin_value_get(root, "static_xyz"))
            return spin_fail(SPIN_E_UNSUPPORTED, "a dict with static_xyz is one of %s",
                             spin_chkpnt_maker(28));
        spin_realtime4dgs_loaded(root, "", r);
        r->moving = true;
        return SPIN_OK;
    }
    if (!is_kind(root, SPIN_VALUE_TUPLE) || root->n != 2)
        return spin_fail(SPIN_E_MALFORMED, "the checkpoint holds %s, expected (model, iteration)",
                         spin_chkpnt_kind(root));
    spin_value_number(spin_value_at(root, 1), &r->iteration);
    if (is_kind(m, SPIN_VALUE_DICT) && spin_value_get(m, "_xyz")) {
        take_attributes(m, r);
        return SPIN_OK;
    }
    if (!is_kind(m, SPIN_VALUE_TUPLE) || !is_kind(spin_value_at(root, 1), SPIN_VALUE_INT))
        return spin_fail(SPIN_E_MALFORMED,
                         "the checkpoint holds %s and %s, expected a tuple and an int",
                         spin_chkpnt_kind(m), spin_chkpnt_kind(spin_value_at(root, 1)));
    return take_tuple(m, r);
}

/* ---- Tensors --------------------------------------------------------------------------------- */

static spin_status bind(struct spin_model *m, const struct realtime4dgs *r,
                        enum realtime4dgs_part part, int n_dims, const int64_t *shape,
                        struct spin_array *out)
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

static spin_status bind_sh(struct spin_model *m, struct realtime4dgs *r)
{
    int64_t n = (int64_t)r->n;
    int64_t dc[3] = {n, r->swapped ? 3 : 1, r->swapped ? 1 : 3};
    int64_t rest[3] = {n, r->swapped ? 3 : -1, r->swapped ? -1 : 3};

    SPIN_TRY(bind(m, r, R4_DC, 3, dc, &r->sh[0]));
    SPIN_TRY(bind(m, r, R4_REST, 3, rest, &r->sh[1]));
    for (int i = 0; i < 2 && r->swapped; i++)
        swap_axes(&r->sh[i]);
    if (r->sh[1].shape[1] > 47)
        return spin_fail(SPIN_E_MALFORMED, "features_rest has %llu rows of SH, expected at most 47",
                         (unsigned long long)r->sh[1].shape[1]);
    r->n_sh = 1 + (int)r->sh[1].shape[1];
    return SPIN_OK;
}

void spin_realtime4dgs_sh(const struct realtime4dgs *r, size_t i, float out[REALTIME4DGS_SH])
{
    uint64_t width = 3 * (uint64_t)(r->n_sh - 1);

    spin_array_to_f32(&r->sh[0], 3 * i, 3, out);
    if (width > 0)
        spin_array_to_f32(&r->sh[1], width * i, width, out + 3);
}

void spin_realtime4dgs_colours(const struct realtime4dgs *r, size_t i, double dt, double length,
                               float *out)
{
    float sh[REALTIME4DGS_SH];

    spin_realtime4dgs_sh(r, i, sh);
    if (r->degree_t > 0)
        spin_sh_fold(r->degree_t, dt, length, sh, out);
    else
        memcpy(out, sh, 3 * (size_t)((r->degree + 1) * (r->degree + 1)) * sizeof *out);
}

/* ---- Degrees --------------------------------------------------------------------------------- */

/* Degree of the spatial part for a number of SH and whether some for the cosines follow; false for a
 * number that no setting gives. */
static bool sh_to_degree(int n_sh, double told, int *degree, bool *in_time)
{
    for (int d = 0; d <= 3; d++) {
        int n = (d + 1) * (d + 1);
        /* Allocated when neither option is set; those beyond the spatial ones are never used. */
        static const int unused[] = {1, 6, 16, 33};

        if (n_sh == 16 && told != 2 && d == 2) /* 16 is degree 3, unless cfg_args says otherwise */
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
        return spin_fail(SPIN_E_MALFORMED, "%s is %s %g, expected 0 to %d", what,
                         spin_chkpnt_kind(v), value, largest);
    *out = (int)value;
    return SPIN_OK;
}

static spin_status find_degrees(struct realtime4dgs *r, double told)
{
    bool in_time = false;
    int most = 0;

    if (!sh_to_degree(r->n_sh, told, &most, &in_time))
        return spin_fail(SPIN_E_MALFORMED,
                         "features_dc and features_rest have %d rows of SH together, which no "
                         "degree has",
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
    /* The renderer reaches the cosines only behind the spatial degree 3. */
    if (!in_time || r->degree < 3)
        r->degree_t = 0;
    return SPIN_OK;
}

/* ---- Reading --------------------------------------------------------------------------------- */

spin_status spin_realtime4dgs_read(struct spin_model *m, bool with_sh, struct realtime4dgs *r)
{
    static const int64_t places[2] = {-1, 3};
    const struct spin_value *rot_4d = r->part[R4_ROT_4D], *right = r->part[R4_ROTATION_R];
    bool has_right = right && right->kind == SPIN_VALUE_TENSOR && !spin_chkpnt_is_empty(right);
    double told = -1;
    struct spin_array t;

    SPIN_TRY(bind(m, r, R4_XYZ, 2, places, &t));
    r->n = (size_t)t.shape[0];
    if (r->n == 0)
        return SPIN_OK;
    r->rot_4d = r->moving && (rot_4d ? rot_4d->integer != 0 : has_right);
    if (r->rot_4d && !has_right)
        return spin_fail(SPIN_E_MALFORMED, "rot_4d is true, but the right quaternions are empty");
    SPIN_TRY(spin_cfg_read_number(&m->settings.cfg, "sh_degree", &told));
    if (with_sh) {
        SPIN_TRY(bind_sh(m, r));
        SPIN_TRY(find_degrees(r, told));
    }
    for (int p = 0; p < R4_N_PARTS; p++) { /* values need not be finite */
        int64_t shape[2] = {(int64_t)r->n, all[p].width};

        if (all[p].width == 0 || (p >= R4_T && !r->moving) || (p == R4_ROTATION_R && !r->rot_4d))
            continue;
        SPIN_TRY(bind(m, r, p, 2, shape, &t));
        SPIN_TRY(spin_model_scratch(m, r->n, (size_t)all[p].width * sizeof(float),
                                    (void **)&r->column[p]));
        spin_array_to_f32(&t, 0, t.count, r->column[p]);
    }
    return SPIN_OK;
}

/* ---- Gaussians ------------------------------------------------------------------------------- */

void spin_realtime4dgs_slice(const struct realtime4dgs *r, size_t i, bool older, spin_slice *out)
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

static void add_row(const struct realtime4dgs *r, size_t i, size_t row,
                    const struct realtime4dgs_reading *reading, struct gaussian4d *gaussians)
{
    static const double still[3] = {0, 0, 0};
    double opacity = spin_sigmoid_of(r->column[R4_OPACITY][i]), log_scale[3], quat[4];

    if (r->rot_4d) {
        spin_slice s;

        spin_realtime4dgs_slice(r, i, reading->older, &s);
        spin_gaussian4d_add_slice(gaussians, row, r->column[R4_XYZ] + 3 * i, r->column[R4_T][i],
                                  opacity, &s, reading->extra);
        return;
    }
    spin_unit_quat(r->column[R4_ROTATION] + 4 * i, quat);
    for (int k = 0; k < 3; k++) {
        log_scale[k] = r->column[R4_SCALING][3 * i + (size_t)k];
        quat[k + 1] = reading->transposed ? -quat[k + 1] : quat[k + 1];
    }
    /* Here the exponential is the variance itself. */
    spin_gaussian4d_add(gaussians, row, r->column[R4_XYZ] + 3 * i,
                        r->moving ? r->column[R4_T][i] : 0, opacity, still,
                        r->moving ? exp(r->column[R4_SCALING_T][i]) + reading->extra : ALL_TIMES,
                        log_scale, quat);
}

static bool has_finite_sh(const struct realtime4dgs *r, size_t i)
{
    float sh[REALTIME4DGS_SH];

    spin_realtime4dgs_sh(r, i, sh);
    for (int k = 0; k < 3 * r->n_sh; k++) {
        if (!isfinite(sh[k]))
            return false;
    }
    return true;
}

size_t spin_realtime4dgs_add(const struct realtime4dgs *r, size_t row,
                             const struct realtime4dgs_reading *reading,
                             struct gaussian4d *gaussians)
{
    size_t n_faint = 0;

    for (size_t i = 0; i < r->n; i++) {
        if (r->n_sh > 0 && !has_finite_sh(r, i)) {
            gaussians->n_dropped++;
            continue;
        }
        n_faint += spin_sigmoid_of(r->column[R4_OPACITY][i]) < SPIN_FAINT;
        add_row(r, i, row + i, reading, gaussians);
    }
    return n_faint;
}

/* ---- Words ----------------------------------------------------------------------------------- */

const char *spin_realtime4dgs_iteration(const struct realtime4dgs *r, char text[48])
{
    text[0] = '\0';
    if (r->iteration >= 0)
        snprintf(text, 48, ", iteration %.0f", r->iteration);
    return text;
}

void spin_realtime4dgs_note(const struct realtime4dgs *r, const struct clip_times *times,
                            struct spin_sequence_info *sequence)
{
    const struct spin_value *env = r->part[R4_ENV_MAP];

    if (times->guessed)
        spin_note(sequence,
                  "time_duration is not in the run's folder: assumed %g,%g, as the Gaussians' "
                  "own times run%s; --time-duration or --config sets it",
                  times->first, times->last, r->degree_t > 0 ? ", and colours depend on it" : "");
    if (env && env->kind == SPIN_VALUE_TENSOR && !spin_chkpnt_is_empty(env))
        spin_note(sequence,
                  "the environment map is not imported: windows and far background are missing");
}
