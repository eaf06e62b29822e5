/* nerfstudio trains in coordinates p' = scale (T p), where p are the original coordinates of the
 * scene, and T and scale are "transform" and "scale" of dataparser_transforms.json. The poses in
 * transforms.json may be in other coordinates q, since "applied_transform" A and "applied_scale" a
 * of this file were already applied to the poses. T includes A, and scale includes a. For these
 * poses, therefore, p' = (scale / a) (T A^-1 q). */
#include "run/nerfstudio_world.h"

#include "base/base.h"
#include "io/file.h"
#include "io/json.h"
#include "math/covariance.h"
#include "math/scene_rotation.h"
#include "scene/splats_4d.h"

#define SAME 1e-9       /* transforms that differ from the identity by less are ignored */
#define ORTHOGONAL 1e-3 /* tolerance of the dot products of the rows of a rotation */

/* A rotation and a shift, as a matrix [3][4]. */
struct rigid {
    double m[12];
};

/* Reads the first three rows of a matrix with rows of four numbers. */
static spin_status read_rigid(const spin_json *rows, const char *key, struct rigid *out)
{
    double dot, worst = 0, *m = out->m;

    for (size_t i = 0; i < 12; i++)
        if (!spin_json_number(spin_json_at(spin_json_at(rows, i / 4), i % 4), &m[i]) ||
            !isfinite(m[i]))
            return spin_malformed("'%s' has no number in row %zu, column %zu", key, i / 4, i % 4);
    for (int i = 0; i < 9; i++) {
        const double *a = m + i / 3 * 4, *b = m + i % 3 * 4;

        dot = a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        worst = fmax(worst, fabs(dot - (i % 4 == 0)));
    }
    dot = m[0] * (m[5] * m[10] - m[6] * m[9]) - m[1] * (m[4] * m[10] - m[6] * m[8]) +
          m[2] * (m[4] * m[9] - m[5] * m[8]);
    if (worst > ORTHOGONAL || dot < 0)
        return spin_malformed("'%s' is not a rotation with a shift", key);
    return SPIN_OK;
}

static spin_status read_scale(const spin_json *json, const char *key, double *out)
{
    *out = 1;
    if (!json || (spin_json_number(json, out) && *out > 1e-9 && *out < 1e9))
        return SPIN_OK;
    return spin_malformed("'%s' is not a positive number", key);
}

/* out = a b^-1 */
static void divide_rigid(const struct rigid *a, const struct rigid *b, struct rigid *out)
{
    for (int i = 0; i < 3; i++) {
        double *row = out->m + 4 * i;
        const double *x = a->m + 4 * i;

        row[3] = x[3];
        for (int j = 0; j < 3; j++) {
            const double *y = b->m + 4 * j;

            row[j] = x[0] * y[0] + x[1] * y[1] + x[2] * y[2];
            row[3] -= row[j] * y[3];
        }
    }
}

/* Divides *transform and *scale by those that were already applied to the poses in
 * transforms.json. */
static spin_status remove_applied(const char *data, struct rigid *transform, double *scale)
{
    SPIN_FREED char *path = NULL;
    SPIN_LEAVES(spin_json_freed) spin_json *json = NULL;
    const spin_json *rows;
    struct rigid applied, whole = *transform;
    double a;

    SPIN_TRY(spin_path_join(data, "transforms.json", &path));
    if (!spin_path_exists(path))
        return SPIN_OK;
    SPIN_TRY(spin_json_load(path, &json));
    SPIN_TRY_IN(read_scale(spin_json_get(json, "applied_scale"), "applied_scale", &a),
                "cannot read '%s'", path);
    *scale /= a;
    if (!(rows = spin_json_get(json, "applied_transform")))
        return SPIN_OK;
    SPIN_TRY_IN(read_rigid(rows, "applied_transform", &applied), "cannot read '%s'", path);
    divide_rigid(&whole, &applied, transform);
    return SPIN_OK;
}

static spin_status read_parser(const char *path, struct rigid *transform, double *scale)
{
    SPIN_LEAVES(spin_json_freed) spin_json *json = NULL;

    SPIN_TRY(spin_json_load(path, &json));
    SPIN_TRY_IN(read_rigid(spin_json_get(json, "transform"), "transform", transform),
                "cannot read '%s'", path);
    return spin_fail_context(read_scale(spin_json_get(json, "scale"), "scale", scale),
                             "cannot read '%s'", path);
}

static bool is_identity(const struct rigid *t, double scale)
{
    double worst = fabs(scale - 1);

    for (int i = 0; i < 12; i++)
        worst = fmax(worst, fabs(t->m[i] - (i % 5 == 0)));
    return worst < SAME;
}

/* Sets *out to the inverse of p' = scale (R p + t), which is p = R^T (p' / scale) - R^T t. */
static void invert(const struct rigid *t, double scale, struct spin_placement *out)
{
    double r[9];

    for (int i = 0; i < 9; i++)
        r[i] = t->m[i % 3 * 4 + i / 3];
    spin_quat_of_matrix(r, out->q);
    out->scale = 1 / scale;
    for (int i = 0; i < 3; i++)
        out->shift[i] = -(r[3 * i] * t->m[3] + r[3 * i + 1] * t->m[7] + r[3 * i + 2] * t->m[11]);
}

/* Sets *out to the path of dataparser_transforms.json in `folder`, if the file exists. Sets *ours
 * if spin-export wrote the frames in this folder; the file is then ignored, here and in later
 * calls. */
static spin_status find_in_folder(const char *folder, char **out, bool *ours)
{
    SPIN_FREED char *path = NULL, *sequence = NULL;

    SPIN_TRY(spin_path_join(folder, "sequence.json", &sequence));
    *ours = *ours || spin_path_exists(sequence);
    SPIN_TRY(spin_path_join(folder, SPIN_PARSER_FILE, &path));
    if (!*ours && spin_path_exists(path)) {
        *out = path;
        path = NULL;
    }
    return SPIN_OK;
}

static spin_status find_file(const char *input, const char *data, char **out)
{
    SPIN_FREED char *folder = NULL;
    bool ours = false;

    *out = NULL;
    SPIN_TRY(spin_path_absolute(input, &folder));
    for (int level = 0; level < 3 && !*out; level++) {
        char *above;

        SPIN_TRY(find_in_folder(folder, out, &ours));
        SPIN_TRY(spin_path_folder(folder, &above));
        free(folder);
        folder = above;
    }
    return *out || !data ? SPIN_OK : find_in_folder(data, out, &ours);
}

spin_status spin_parser_find(const char *input, const char *data, const char *data_from,
                             struct spin_placement *out, char **path, bool *found)
{
    struct rigid transform;
    double scale;

    *found = false;
    SPIN_TRY(find_file(input, data, path));
    if (!*path)
        return SPIN_OK;
    SPIN_TRY(read_parser(*path, &transform, &scale));
    if (data && strcmp(data_from, "transforms") == 0)
        SPIN_TRY(remove_applied(data, &transform, &scale));
    *found = !is_identity(&transform, scale);
    invert(&transform, scale, out);
    return SPIN_OK;
}

/* ---- 4D splats ------------------------------------------------------------------------------- */

static void turn_rows(const struct spin_scene_rotation *turn, double scale, const double *shift,
                      float *rows, size_t n)
{
    for (size_t i = 0; i < n; i++) {
        float *x = rows + 3 * i;
        spin_vec3 v = spin_scene_rotation_place(turn, spin_v3(x[0], x[1], x[2]));

        x[0] = (float)(scale * v.x + shift[0]);
        x[1] = (float)(scale * v.y + shift[1]);
        x[2] = (float)(scale * v.z + shift[2]);
    }
}

/* Turns rotations, or their rates of change, which are quaternions too. */
static void turn_quats(const struct spin_scene_rotation *turn, float *quats, size_t n)
{
    for (size_t i = 0; i < n; i++) {
        float out[4];

        spin_scene_rotation_quat(turn, quats + 4 * i, out);
        memcpy(quats + 4 * i, out, sizeof out);
    }
}

static void turn_sh(const struct spin_scene_rotation *turn, int count, float *sh, size_t n)
{
    float out[3 * SPIN_SH_MAX];

    for (size_t i = 0; i < n; i++, sh += 3 * count) {
        spin_scene_rotation_sh(turn, count, sh, out);
        memcpy(sh, out, 3 * (size_t)count * sizeof *sh);
    }
}

spin_status spin_splats_4d_place(const struct spin_splats_4d *from, const struct spin_placement *p,
                                 struct spin_splats_4d *out)
{
    static const double none[3] = {0};
    int count = spin_sh_count(from->sh_degree);
    struct spin_scene_rotation turn;
    SPIN_FREED unsigned char *all = NULL;

    SPIN_TRY(spin_alloc(from->n + 1, 1, (void **)&all));
    memset(all, 1, from->n);
    SPIN_TRY(spin_splats_4d_select(from, all, out));
    spin_scene_rotation_from(p->q, &turn);
    turn_rows(&turn, p->scale, p->shift, out->centres, out->n);
    if (out->paths)
        turn_rows(&turn, p->scale, none, out->paths, out->n * (size_t)out->degree);
    turn_quats(&turn, out->quats, out->n);
    if (out->spins)
        turn_quats(&turn, out->spins, out->n);
    for (size_t i = 0; i < 3 * out->n; i++)
        out->log_scales[i] += (float)log(p->scale);
    turn_sh(&turn, count, out->sh, out->n);
    if (out->sh_cos)
        turn_sh(&turn, count, out->sh_cos, 2 * out->n);
    return SPIN_OK;
}
