/* Rows of a checkpoint of Realtime-4DGS. */
#include "importers/lib/realtime4dgs_rows.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "importers/lib/chkpnt.h"

/* Of time, for what is there at all times: no square of a time comes near it. */
#define ALL_TIMES 1e300

/* ---- Tensors --------------------------------------------------------------------------------- */

static spin_status bind(struct spin_torch *torch, const struct realtime4dgs_parts *p,
                        const struct spin_value *v, const char *what, int n_dims,
                        const int64_t *shape, struct spin_array *out)
{
    char name[64];

    snprintf(name, sizeof name, "%s%s", p->who ? p->who : "", what);
    return spin_chkpnt_bind(torch, v, name, n_dims, shape, out);
}

/* Values need not be finite. */
static spin_status load(struct spin_torch *torch, const struct realtime4dgs_parts *p,
                        const struct spin_value *v, const char *what, size_t n, int width,
                        float **out)
{
    int64_t shape[2] = {(int64_t)n, width};
    struct spin_array t;

    SPIN_TRY(bind(torch, p, v, what, 2, shape, &t));
    SPIN_TRY(spin_alloc(n, (size_t)width * sizeof **out, (void **)out));
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

static spin_status bind_sh(struct spin_torch *torch, const struct realtime4dgs_parts *p,
                           struct realtime4dgs_rows *rows)
{
    int64_t n = (int64_t)rows->n;
    int64_t dc[3] = {n, p->swapped ? 3 : 1, p->swapped ? 1 : 3};
    int64_t rest[3] = {n, p->swapped ? 3 : -1, p->swapped ? -1 : 3};

    SPIN_TRY(bind(torch, p, p->dc, "features_dc", 3, dc, &rows->dc));
    SPIN_TRY(bind(torch, p, p->rest, "features_rest", 3, rest, &rows->rest));
    if (p->swapped) {
        swap_axes(&rows->dc);
        swap_axes(&rows->rest);
    }
    if (rows->rest.shape[1] > 47)
        return spin_fail(SPIN_E_MALFORMED, "features_rest has %llu rows of SH, expected at most 47",
                         (unsigned long long)rows->rest.shape[1]);
    rows->n_sh = 1 + (int)rows->rest.shape[1];
    return SPIN_OK;
}

void spin_realtime4dgs_sh(const struct realtime4dgs_rows *rows, size_t i,
                          float out[REALTIME4DGS_SH])
{
    uint64_t width = 3 * (uint64_t)(rows->n_sh - 1);

    spin_array_to_f32(&rows->dc, 3 * i, 3, out);
    if (width > 0)
        spin_array_to_f32(&rows->rest, width * i, width, out + 3);
}

void spin_realtime4dgs_colours(const struct realtime4dgs_rows *rows, size_t i, double dt,
                               double length, float *out)
{
    float sh[REALTIME4DGS_SH];

    spin_realtime4dgs_sh(rows, i, sh);
    if (rows->degree_t > 0)
        spin_sh_fold(rows->degree_t, dt, length, sh, out);
    else
        memcpy(out, sh, 3 * (size_t)((rows->degree + 1) * (rows->degree + 1)) * sizeof *out);
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

static spin_status find_degrees(const struct realtime4dgs_parts *p, double told,
                                struct realtime4dgs_rows *rows)
{
    bool in_time = false;
    int most = 0;

    if (!sh_to_degree(rows->n_sh, told, &most, &in_time))
        return spin_fail(SPIN_E_MALFORMED,
                         "features_dc and features_rest have %d rows of SH together, which no "
                         "degree has",
                         rows->n_sh);
    if (p->swapped) {
        rows->degree = most;
        rows->degree_t = in_time && p->moving ? 2 : 0;
    } else {
        SPIN_TRY(read_degree(p->active, "the active SH degree", 3, &rows->degree));
        if (p->moving)
            SPIN_TRY(read_degree(p->active_t, "the active temporal SH degree", 2, &rows->degree_t));
    }
    rows->degree = rows->degree < most ? rows->degree : most;
    /* The renderer reaches the cosines only behind the spatial degree 3. */
    if (!in_time || rows->degree < 3)
        rows->degree_t = 0;
    return SPIN_OK;
}

/* ---- Opening --------------------------------------------------------------------------------- */

static spin_status load_columns(struct spin_torch *torch, const struct realtime4dgs_parts *p,
                                struct realtime4dgs_rows *rows)
{
    size_t n = rows->n;

    SPIN_TRY(load(torch, p, p->xyz, "xyz", n, 3, &rows->xyz));
    SPIN_TRY(load(torch, p, p->scaling, "scaling", n, 3, &rows->scaling));
    SPIN_TRY(load(torch, p, p->rotation, "rotation", n, 4, &rows->rotation));
    SPIN_TRY(load(torch, p, p->opacity, "opacity", n, 1, &rows->opacity));
    if (!p->moving)
        return SPIN_OK;
    SPIN_TRY(load(torch, p, p->t, "t", n, 1, &rows->t));
    SPIN_TRY(load(torch, p, p->scaling_t, "scaling_t", n, 1, &rows->scaling_t));
    if (rows->rot_4d)
        SPIN_TRY(load(torch, p, p->rotation_r, "rotation_r", n, 4, &rows->rotation_r));
    return SPIN_OK;
}

spin_status spin_realtime4dgs_rows_open(struct spin_torch *torch,
                                        const struct realtime4dgs_parts *parts, bool with_sh,
                                        double sh_degree, struct realtime4dgs_rows *rows)
{
    static const int64_t shape[2] = {-1, 3};
    bool right = parts->rotation_r && parts->rotation_r->kind == SPIN_VALUE_TENSOR &&
                 !spin_chkpnt_is_empty(parts->rotation_r);
    struct spin_array t;

    *rows = (struct realtime4dgs_rows){.moving = parts->moving};
    SPIN_TRY(bind(torch, parts, parts->xyz, "xyz", 2, shape, &t));
    rows->n = (size_t)t.shape[0];
    if (rows->n == 0)
        return SPIN_OK;
    rows->rot_4d = parts->moving && (parts->rot_4d ? parts->rot_4d->integer != 0 : right);
    if (rows->rot_4d && !right)
        return spin_fail(SPIN_E_MALFORMED, "rot_4d is true, but the right quaternions are empty");
    if (with_sh) {
        SPIN_TRY(bind_sh(torch, parts, rows));
        SPIN_TRY(find_degrees(parts, sh_degree, rows));
    }
    return load_columns(torch, parts, rows);
}

void spin_realtime4dgs_rows_free(struct realtime4dgs_rows *rows)
{
    float **all[] = {&rows->xyz,     &rows->scaling, &rows->rotation, &rows->rotation_r,
                     &rows->opacity, &rows->t,       &rows->scaling_t};

    for (size_t i = 0; i < sizeof all / sizeof *all; i++) {
        free(*all[i]);
        *all[i] = NULL;
    }
}

/* ---- Gaussians ------------------------------------------------------------------------------- */

void spin_realtime4dgs_slice(const struct realtime4dgs_rows *rows, size_t i, bool older,
                             spin_slice *out)
{
    double left[4], right[4], scale[4], a[16];

    for (size_t k = 0; k < 4; k++) {
        left[k] = rows->rotation[4 * i + k];
        right[k] = rows->rotation_r[4 * i + k];
        scale[k] = exp(k < 3 ? rows->scaling[3 * i + k] : rows->scaling_t[i]);
    }
    spin_rotation4_of_pair(left, right, older, a);
    spin_slice_of(a, scale, out);
}

static void add_row(const struct realtime4dgs_rows *rows, size_t i, size_t row,
                    const struct realtime4dgs_reading *r, struct gaussian4d *gaussians)
{
    static const double still[3] = {0, 0, 0};
    double opacity = spin_sigmoid_of(rows->opacity[i]), log_scale[3], quat[4];

    if (rows->rot_4d) {
        spin_slice s;

        spin_realtime4dgs_slice(rows, i, r->older, &s);
        spin_gaussian4d_add_slice(gaussians, row, rows->xyz + 3 * i, rows->t[i], opacity, &s,
                                  r->extra);
        return;
    }
    spin_unit_quat(rows->rotation + 4 * i, quat);
    for (int k = 0; k < 3; k++) {
        log_scale[k] = rows->scaling[3 * i + (size_t)k];
        quat[k + 1] = r->transposed ? -quat[k + 1] : quat[k + 1];
    }
    /* Here the exponential is the variance itself. */
    spin_gaussian4d_add(gaussians, row, rows->xyz + 3 * i, rows->moving ? rows->t[i] : 0, opacity,
                        still, rows->moving ? exp(rows->scaling_t[i]) + r->extra : ALL_TIMES,
                        log_scale, quat);
}

static bool has_finite_sh(const struct realtime4dgs_rows *rows, size_t i)
{
    float sh[REALTIME4DGS_SH];

    spin_realtime4dgs_sh(rows, i, sh);
    for (int k = 0; k < 3 * rows->n_sh; k++) {
        if (!isfinite(sh[k]))
            return false;
    }
    return true;
}

size_t spin_realtime4dgs_rows_add(const struct realtime4dgs_rows *rows, size_t row,
                                  const struct realtime4dgs_reading *reading,
                                  struct gaussian4d *gaussians)
{
    size_t n_faint = 0;

    for (size_t i = 0; i < rows->n; i++) {
        if (rows->n_sh > 0 && !has_finite_sh(rows, i)) {
            gaussians->n_dropped++;
            continue;
        }
        n_faint += spin_sigmoid_of(rows->opacity[i]) < SPIN_FAINT;
        add_row(rows, i, row + i, reading, gaussians);
    }
    return n_faint;
}
