/* Reading the Gaussians of Ex4DGS. */
#include "importers/lib/ex4dgs_part.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "importers/lib/chkpnt.h"
#include "importers/lib/model_folder.h"
#include "math/covariance.h"
#include "math/quat.h"

enum { MOST_KEYS = 1000000 };

/* What can be drawn is far smaller, and sums of a few such values stay in the range of floats. */
#define LARGEST 1e18f

/* ---- Columns --------------------------------------------------------------------------------- */

/* Numbers of an item of the checkpoint's tuple, 0: none, and of a property of the PLYs. SH are an item for
 * degree 0 and the next for all others. */
static const struct {
    size_t width;
    bool keyed;
    int still, moving;
    const char *tensor, *stem;
} kinds[EX4DGS_N_COLUMNS] = {
    [EX4DGS_PLACE] = {3, true, 1, 23, "xyz", "xyz_"},
    [EX4DGS_ROTATION] = {4, true, 5, 30, "rotation", "rot_"},
    [EX4DGS_SCALE] = {3, false, 4, 26, "scaling", "scale_"},
    [EX4DGS_OPACITY] = {1, false, 6, 27, "opacity", "opacity"},
    [EX4DGS_SH] = {0, false, 2, 24, "features_dc", "f_"},
    [EX4DGS_DRIFT] = {3, false, 18, 0, "xyz_disp", "xyz_disp_"},
    [EX4DGS_CENTRE] = {2, false, 0, 28, "opacity center", "opacity_c_"},
    [EX4DGS_WIDTH] = {2, false, 0, 29, "opacity var", "opacity_v_"},
};

static int item_of(const struct ex4dgs_part *p, int column)
{
    return p->moving ? kinds[column].moving : kinds[column].still;
}

static size_t n_sh(int degree) { return (size_t)((degree + 1) * (degree + 1)); }

size_t spin_ex4dgs_width(const struct ex4dgs_part *p, enum ex4dgs_column column)
{
    if (item_of(p, (int)column) == 0)
        return 0;
    if (column == EX4DGS_SH)
        return 3 * n_sh(p->sh_degree);
    return kinds[column].width * (kinds[column].keyed ? (size_t)p->n_keys : 1);
}

static size_t width_of(const struct ex4dgs_part *p, int column)
{
    return spin_ex4dgs_width(p, (enum ex4dgs_column)column);
}

void spin_ex4dgs_part_free(struct ex4dgs_part *p)
{
    for (int c = 0; c < EX4DGS_N_COLUMNS; c++) {
        free(p->column[c]);
        p->column[c] = NULL;
    }
}

static spin_status reserve(struct ex4dgs_part *p)
{
    for (int c = 0; c < EX4DGS_N_COLUMNS; c++) {
        if (width_of(p, c) > 0)
            SPIN_TRY(spin_alloc(p->n, width_of(p, c) * sizeof(float), (void **)&p->column[c]));
    }
    return SPIN_OK;
}

/* The degree that has so many SH, or -1. */
static int degree_of(uint64_t n)
{
    for (int d = 0; d <= 3; d++) {
        if (n == n_sh(d))
            return d;
    }
    return -1;
}

/* ---- Out of a checkpoint --------------------------------------------------------------------- */

/* "motion xyz (item 23)" */
static const char *item_name(const struct ex4dgs_part *p, const char *tensor, int item,
                             char text[64])
{
    snprintf(text, 64, "%s%s (item %d)", p->moving ? "motion " : "", tensor, item);
    return text;
}

/* A column but SH: [n][width], [n][keys][width], or [n][2][1] of the two times and widths. */
static spin_status take_column(struct spin_torch *torch, const struct spin_value *model,
                               struct ex4dgs_part *p, int column)
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
    SPIN_TRY(spin_chkpnt_bind(torch, spin_value_at(model, (size_t)item),
                              item_name(p, kinds[column].tensor, item, name), n_dims, shape, &t));
    spin_array_to_f32(&t, 0, t.count, p->column[column]);
    return SPIN_OK;
}

/* Those above the degree `active` take no part in training yet, nor in drawing. */
static spin_status take_sh(struct spin_torch *torch, const struct spin_value *model, int active,
                           struct ex4dgs_part *p)
{
    int item = item_of(p, EX4DGS_SH);
    int64_t one[3] = {(int64_t)p->n, 1, 3}, all[3] = {(int64_t)p->n, -1, 3};
    struct spin_array dc, rest;
    size_t width;
    char name[64];

    SPIN_TRY(spin_chkpnt_bind(torch, spin_value_at(model, (size_t)item),
                              item_name(p, "features_dc", item, name), 3, one, &dc));
    SPIN_TRY(spin_chkpnt_bind(torch, spin_value_at(model, (size_t)item + 1),
                              item_name(p, "features_rest", item + 1, name), 3, all, &rest));
    p->sh_degree = degree_of(rest.shape[1] + 1);
    if (p->sh_degree < 0)
        return spin_fail(SPIN_E_MALFORMED, "%s has %llu rows of SH, expected 0, 3, 8 or 15", name,
                         (unsigned long long)rest.shape[1]);
    p->sh_degree = active < p->sh_degree ? active : p->sh_degree;
    SPIN_TRY(reserve(p));
    width = width_of(p, EX4DGS_SH);
    for (size_t i = 0; i < p->n; i++) {
        spin_array_to_f32(&dc, 3 * i, 3, p->column[EX4DGS_SH] + width * i);
        if (width > 3)
            spin_array_to_f32(&rest, 3 * rest.shape[1] * i, width - 3,
                              p->column[EX4DGS_SH] + width * i + 3);
    }
    return SPIN_OK;
}

/* Before the first dynamic Gaussians all their tensors are empty, of no particular shape. */
static spin_status check_empty(const struct spin_value *model, const struct ex4dgs_part *p)
{
    for (int c = 0; c < EX4DGS_N_COLUMNS; c++) {
        int item = item_of(p, c);

        if (item > 0 && !spin_chkpnt_is_empty(spin_value_at(model, (size_t)item)))
            return spin_fail(SPIN_E_MALFORMED,
                             "item %d (%s%s) is not empty, but item %d (%sxyz) is", item,
                             p->moving ? "motion " : "", kinds[c].tensor, item_of(p, EX4DGS_PLACE),
                             p->moving ? "motion " : "");
    }
    return SPIN_OK;
}

spin_status spin_ex4dgs_part_of_chkpnt(struct spin_torch *torch, const struct spin_value *model,
                                       int active, struct ex4dgs_part *p)
{
    static const int64_t keyed[3] = {-1, -1, 3}, plain[2] = {-1, 3};
    int item = item_of(p, EX4DGS_PLACE);
    const struct spin_value *place = spin_value_at(model, (size_t)item);
    struct spin_array t;
    char name[64];

    p->n_keys = 1;
    if (spin_chkpnt_is_empty(place))
        return check_empty(model, p);
    SPIN_TRY(spin_chkpnt_bind(torch, place, item_name(p, "xyz", item, name), p->moving ? 3 : 2,
                              p->moving ? keyed : plain, &t));
    if (p->moving && t.shape[1] > MOST_KEYS)
        return spin_fail(SPIN_E_MALFORMED, "%s has %llu key frames", name,
                         (unsigned long long)t.shape[1]);
    p->n = (size_t)t.shape[0];
    p->n_keys = p->moving ? (int)t.shape[1] : 1;
    SPIN_TRY(take_sh(torch, model, active, p));
    for (int c = 0; c < EX4DGS_N_COLUMNS; c++) {
        if (p->column[c] && c != EX4DGS_SH)
            SPIN_TRY(take_column(torch, model, p, c));
    }
    return SPIN_OK;
}

/* ---- Out of the PLYs ------------------------------------------------------------------------- */

/* Of one float of a row of a column: "x", "rot_0", "motion_xyz_12_0". f_rest_* are one channel after the
 * other. */
static void name_property(const struct ex4dgs_part *p, int column, int at, char text[64])
{
    const char *who = p->moving ? "motion_" : "", *stem = kinds[column].stem;
    int width = (int)kinds[column].width, rest = (int)n_sh(p->sh_degree) - 1;

    if (column == EX4DGS_SH && at < 3)
        snprintf(text, 64, "%sf_dc_%d", who, at);
    else if (column == EX4DGS_SH)
        snprintf(text, 64, "%sf_rest_%d", who, at % 3 * rest + at / 3 - 1);
    else if (p->moving && kinds[column].keyed)
        snprintf(text, 64, "%s%s%d_%d", who, stem, at / width, at % width);
    else if (column == EX4DGS_PLACE)
        snprintf(text, 64, "%c", "xyz"[at]);
    else if (column == EX4DGS_OPACITY)
        snprintf(text, 64, "%s%s", who, stem);
    else
        snprintf(text, 64, "%s%s%d", who, stem, at);
}

/* The degree of SH and the number of key frames, which the names tell. */
static spin_status count_properties(const char *path, const struct spin_ply_element *e,
                                    struct ex4dgs_part *p)
{
    int rest = spin_model_folder_count(e, p->moving ? "motion_f_rest_" : "f_rest_");
    int places = spin_model_folder_count(e, "motion_xyz_");
    int turns = spin_model_folder_count(e, "motion_rot_");

    p->n_keys = p->moving ? places / 3 : 1;
    p->sh_degree = rest % 3 == 0 ? degree_of((uint64_t)rest / 3 + 1) : -1;
    if (p->sh_degree < 0)
        return spin_fail(SPIN_E_MALFORMED,
                         "'%s': %d properties %sf_rest_*, expected 0, 9, 24 or 45", path, rest,
                         p->moving ? "motion_" : "");
    if (p->moving && (places % 3 != 0 || turns != 4 * p->n_keys))
        return spin_fail(SPIN_E_MALFORMED,
                         "'%s': %d properties motion_xyz_* and %d motion_rot_*, expected 3 and 4 "
                         "for every key frame",
                         path, places, turns);
    return SPIN_OK;
}

/* All columns' properties, in their order. */
static spin_status find_properties(const struct spin_ply *ply, const struct spin_ply_element *e,
                                   const struct ex4dgs_part *p, struct spin_ply_target *target)
{
    for (int c = 0; c < EX4DGS_N_COLUMNS; c++) {
        for (size_t at = 0; at < width_of(p, c); at++) {
            char name[64];

            name_property(p, c, (int)at, name);
            target->property = spin_ply_find(e, name);
            if (target->property < 0)
                return spin_fail(SPIN_E_MALFORMED, "'%s': element 'vertex' has no property '%s'",
                                 ply->path, name);
            target++;
        }
    }
    return SPIN_OK;
}

static spin_status read_columns(const struct spin_ply *ply, const struct spin_ply_element *e,
                                struct ex4dgs_part *p, struct spin_ply_target *target)
{
    size_t n = 0;

    p->n = (size_t)e->count;
    SPIN_TRY(reserve(p));
    for (int c = 0; c < EX4DGS_N_COLUMNS; c++) {
        for (size_t at = 0; at < width_of(p, c); at++, n++) {
            target[n].out = p->column[c] + at;
            target[n].step = width_of(p, c);
        }
    }
    spin_ply_columns(ply, e, target, n);
    return SPIN_OK;
}

static spin_status read_vertices(const struct spin_ply *ply, struct ex4dgs_part *p)
{
    const struct spin_ply_element *e = spin_ply_find_element(ply, "vertex");
    struct spin_ply_target *target = NULL;
    size_t n = 0;
    spin_status status;

    if (!e)
        return spin_fail(SPIN_E_MALFORMED, "'%s': no element 'vertex'", ply->path);
    SPIN_TRY(count_properties(ply->path, e, p));
    for (int c = 0; c < EX4DGS_N_COLUMNS; c++)
        n += width_of(p, c);
    SPIN_TRY(spin_alloc(n, sizeof *target, (void **)&target));
    status = find_properties(ply, e, p, target);
    if (status == SPIN_OK)
        status = read_columns(ply, e, p, target);
    free(target);
    return status;
}

spin_status spin_ex4dgs_part_of_ply(const char *folder, struct ex4dgs_part *p)
{
    struct spin_ply ply;
    char *path = NULL;
    spin_status status;

    SPIN_TRY(
        spin_path_join(folder, p->moving ? "dynamic_point_cloud.ply" : "point_cloud.ply", &path));
    status = spin_ply_open(path, &ply);
    free(path);
    SPIN_TRY(status);
    status = read_vertices(&ply, p);
    spin_ply_close(&ply);
    return status;
}

/* ---- Rows ------------------------------------------------------------------------------------ */

/* The rasteriser makes a matrix of a static quaternion as it is. Off unit length that is no rotation. */
static bool settle_shape(float log_scale[3], float quat[4])
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

static bool settle_row(const struct ex4dgs_part *p, size_t row)
{
    const size_t keys = (size_t)p->n_keys;

    for (int c = 0; c < EX4DGS_N_COLUMNS; c++) {
        size_t width = width_of(p, c);

        for (size_t i = 0; i < width; i++) {
            if (!(fabsf(p->column[c][width * row + i]) < LARGEST))
                return false;
        }
    }
    for (size_t k = 0; k < keys && p->moving; k++) {
        if (!(spin_quat_norm(p->column[EX4DGS_ROTATION] + 4 * (keys * row + k)) > 0))
            return false;
    }
    return p->moving ||
           settle_shape(p->column[EX4DGS_SCALE] + 3 * row, p->column[EX4DGS_ROTATION] + 4 * row);
}

size_t spin_ex4dgs_part_clean(struct ex4dgs_part *p)
{
    size_t n_all = p->n;

    p->n = 0;
    for (size_t i = 0; i < n_all; i++) {
        if (!settle_row(p, i))
            continue;
        for (int c = 0; c < EX4DGS_N_COLUMNS && p->n != i; c++) {
            size_t width = width_of(p, c);

            if (width > 0)
                memcpy(p->column[c] + width * p->n, p->column[c] + width * i,
                       width * sizeof(float));
        }
        p->n++;
    }
    return n_all - p->n;
}
