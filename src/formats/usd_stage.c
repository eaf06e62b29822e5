#include "formats/usd_stage.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "base/base.h"
#include "formats/gaussian.h"
#include "math/quat.h"
#include "math/sh.h"

#define MAX_FRAMES 1000000
#define ALL (SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES)

static const struct {
    const char *name, *half;
    unsigned width, bit;
} attributes[SPIN_USD_COLUMNS] = {
    {"positions", "positionsh", 3, SPIN_COL_MEANS},
    {"orientations", "orientationsh", 4, SPIN_COL_QUATS},
    {"scales", "scalesh", 3, SPIN_COL_LOG_SCALES},
    {"opacities", "opacitiesh", 1, SPIN_COL_LOGIT_OPACITIES},
    {"radiance:sphericalHarmonicsCoefficients", "radiance:sphericalHarmonicsCoefficientsh", 3,
     SPIN_COL_SH},
};

/* Finds the values of a column at a time. The schema has two attributes for each column, one with
 * floats and one with half floats; the one with floats is preferred. Sets *out to NULL if neither
 * has a value. */
static spin_status find_column(struct spin_usd_stage *s, const struct usd_node *node, int column,
                               double time, struct spin_usd_value **out)
{
    SPIN_TRY(spin_usd_find_value(s, node, attributes[column].name, time, out));
    return *out ? SPIN_OK : spin_usd_find_value(s, node, attributes[column].half, time, out);
}

static unsigned number_of(const struct spin_usd_value *v)
{
    const struct usd_file *file =
        (const struct usd_file *)(const void *)((const char *)v->layer -
                                                offsetof(struct usd_file, layer));

    return file->number;
}

/* ---- Frames ---------------------------------------------------------------------------------- */

struct times {
    double *at;
    size_t n, capacity;
};

static spin_status add_time(struct times *list, double time)
{
    if (list->n == MAX_FRAMES || !isfinite(time))
        return spin_malformed("too many time samples, or a sample whose time is not finite");
    SPIN_TRY(spin_array_grow(list->n, &list->capacity, sizeof *list->at, (void **)&list->at));
    list->at[list->n++] = time;
    return SPIN_OK;
}

/* Returns whether the samples of an attribute define frames. Those of transforms do and, if
 * `splats` is not NULL, also those of splat attributes. */
static bool is_sampled(struct spin_usd_stage *s, const struct usd_node *splats, const char *name)
{
    bool found = strncmp(name, "xformOp:", 8) == 0;

    s->moves = s->moves || found;
    for (int a = 0; splats && a < SPIN_USD_COLUMNS && !found; a++)
        found = strcmp(name, attributes[a].name) == 0 || strcmp(name, attributes[a].half) == 0;
    return found;
}

/* Adds all time codes of the stage in [from, to) that correspond to the time code `time` of the
 * clip. */
static spin_status add_clip_time(const struct usd_clips *c, double time, double from, double to,
                                 struct times *list)
{
    for (size_t i = 0; i < c->n_times; i++) {
        const double *t = c->times + 2 * i;
        bool last = i + 1 == c->n_times;
        double at = t[0];

        if (time != t[1]) {
            if (last || t[2] == t[0] || !((time > t[1]) == (time < t[3])) || time == t[3])
                continue;
            at += (time - t[1]) * (t[2] - t[0]) / (t[3] - t[1]);
        }
        if (at >= from && at < to)
            SPIN_TRY(add_time(list, at));
    }
    return c->n_times > 0 || !(time >= from && time < to) ? SPIN_OK : add_time(list, time);
}

/* Adds the sample times of the clip that entry i of `active` activates or, if the clip has no
 * samples, the time at which it becomes active. */
static spin_status add_clip(struct spin_usd_stage *s, const struct usd_node *node, size_t i,
                            struct times *list)
{
    struct usd_clips *c = node->clips;
    double from = c->active[2 * i];
    double to = i + 1 < c->n_active ? c->active[2 * i + 2] : INFINITY;
    size_t before = list->n;
    struct spin_usd_prim *prim;

    SPIN_TRY(spin_usd_open_clip(s, c, i));
    prim = spin_usd_prim_at(&c->open->layer, node->clip_path);
    for (struct spin_usd_field *f = prim ? prim->attribute : NULL; f; f = f->next)
        for (size_t k = 0; k < f->n_samples && is_sampled(s, node, f->name); k++)
            SPIN_TRY(add_clip_time(c, f->sample[k].time, from, to, list));
    return list->n > before ? SPIN_OK : add_time(list, from);
}

/* Adds the times at which a node has samples. splats: true if the node contains splats; false if it
 * is an ancestor of a node with splats, so that only its transforms matter. */
static spin_status add_node(struct spin_usd_stage *s, const struct usd_node *node, bool splats,
                            struct times *list)
{
    for (size_t i = 0; i < node->n; i++)
        for (struct spin_usd_field *f = node->opinion[i].prim->attribute; f; f = f->next)
            for (size_t k = 0; k < f->n_samples && is_sampled(s, splats ? node : NULL, f->name);
                 k++)
                SPIN_TRY(add_time(list, f->sample[k].time));
    for (size_t i = 0; splats && node->clips && i < node->clips->n_active; i++)
        SPIN_TRY(add_clip(s, node, i, list));
    return SPIN_OK;
}

static spin_status keep_times(struct spin_usd_stage *s, struct times *list)
{
    for (struct usd_node *p = s->splats; p; p = p->next)
        for (struct usd_node *a = p; a; a = a->parent)
            SPIN_TRY(add_node(s, a, a == p, list));
    if (list->n == 0)
        SPIN_TRY(add_time(list, 0));
    qsort(list->at, list->n, sizeof *list->at, spin_by_double);
    for (size_t i = 0; i < list->n; i++)
        if (i == 0 || list->at[i] != list->at[s->n_frames - 1])
            list->at[s->n_frames++] = list->at[i];
    SPIN_TRY(spin_arena_take(&s->arena, s->n_frames, sizeof *s->times, (void **)&s->times));
    SPIN_TRY(spin_arena_take(&s->arena, s->n_frames, sizeof *s->counts, (void **)&s->counts));
    memcpy(s->times, list->at, s->n_frames * sizeof *s->times);
    return SPIN_OK;
}

static spin_status find_times(struct spin_usd_stage *s)
{
    struct times list = {0};
    spin_status status = keep_times(s, &list);

    free(list.at);
    return status;
}

/* ---- Transforms of prims --------------------------------------------------------------------- */

/* As in USD, a matrix is multiplied by row vectors from the left: its last row is the translation.
 */
struct matrix {
    double m[4][4];
};

static const struct matrix identity = {{{1}, {0, 1}, {0, 0, 1}, {0, 0, 0, 1}}};

/* Returns the product of two transforms: first a, then b. */
static struct matrix join(const struct matrix *a, const struct matrix *b)
{
    struct matrix out = {{{0}}};

    for (int r = 0; r < 4; r++)
        for (int c = 0; c < 4; c++)
            for (int k = 0; k < 4; k++)
                out.m[r][c] += a->m[r][k] * b->m[k][c];
    return out;
}

static struct matrix rotation(int axis, double degrees)
{
    struct matrix out = identity;
    int i = (axis + 1) % 3, k = (axis + 2) % 3;
    double angle = degrees * 3.14159265358979323846 / 180;

    out.m[i][i] = out.m[k][k] = cos(angle);
    out.m[i][k] = sin(angle);
    out.m[k][i] = -sin(angle);
    return out;
}

static struct matrix of_quaternion(const double *q)
{
    double w = q[0], x = q[1], y = q[2], z = q[3];

    return (struct matrix){{{1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)},
                            {2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)},
                            {2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)},
                            {0, 0, 0, 1}}};
}

/* Sets *out to three successive rotations about the axes in `order`, such as "XYZ". degrees: angles
 * about x, y and z. */
static void rotate_three(const char *order, const double *degrees, struct matrix *out)
{
    *out = identity;
    for (int i = 0; i < 3; i++) {
        struct matrix one = rotation(order[i] - 'X', degrees[order[i] - 'X']);

        *out = join(out, &one);
    }
}

/* Reads one transform of a prim. name: name of its attribute, such as "xformOp:translate". */
static spin_status read_op(struct spin_usd_value *value, const char *name, struct matrix *out)
{
    const char *kind = name + strlen("xformOp:");
    size_t n = strcspn(kind, ":");
    double v[16];

    *out = identity;
    if (n == 9 && strncmp(kind, "transform", n) == 0) {
        SPIN_TRY(spin_usd_doubles(value, 16, 1, v));
        memcpy(out->m, v, sizeof v);
    } else if (n == 9 && strncmp(kind, "translate", n) == 0) {
        SPIN_TRY(spin_usd_doubles(value, 3, 1, out->m[3]));
    } else if (n == 5 && strncmp(kind, "scale", n) == 0) {
        SPIN_TRY(spin_usd_doubles(value, 3, 1, v));
        for (int c = 0; c < 3; c++)
            out->m[c][c] = v[c];
    } else if (n == 6 && strncmp(kind, "orient", n) == 0) {
        SPIN_TRY(spin_usd_doubles(value, 4, 1, v));
        *out = of_quaternion(v);
    } else if (n == 7 && strncmp(kind, "rotate", 6) == 0 && kind[6] >= 'X' && kind[6] <= 'Z') {
        SPIN_TRY(spin_usd_doubles(value, 1, 1, v));
        *out = rotation(kind[6] - 'X', v[0]);
    } else if (n == 9 && strncmp(kind, "rotate", 6) == 0 && strspn(kind + 6, "XYZ") >= 3) {
        SPIN_TRY(spin_usd_doubles(value, 3, 1, v));
        rotate_three(kind + 6, v, out);
    } else {
        return spin_unsupported("transform '%s' is not supported", name);
    }
    return SPIN_OK;
}

/* Appends the transforms of a prim to `inout`. The first transform in xformOpOrder is applied last.
 * *reset becomes true if the prim ignores the transforms of its ancestors. */
static spin_status apply_ops(struct spin_usd_stage *s, const struct usd_node *node, double time,
                             struct matrix *inout, bool *reset)
{
    struct spin_usd_value *order, *value, item;
    struct spin_usd_items items = {NULL, 0};
    struct matrix local = identity, one;

    SPIN_TRY(spin_usd_find_value(s, node, "xformOpOrder", time, &order));
    for (items.of = order; order && spin_usd_next(&items, &item);) {
        SPIN_FREED char *name = NULL;

        SPIN_TRY(spin_usd_text(&item, &name));
        *reset = *reset || strcmp(name, "!resetXformStack!") == 0;
        if (strcmp(name, "!resetXformStack!") == 0)
            continue;
        if (strncmp(name, "xformOp:", 8) != 0)
            return spin_unsupported("transform '%s' is not supported", name);
        SPIN_TRY(spin_usd_find_value(s, node, name, time, &value));
        if (!value)
            continue;
        SPIN_TRY_IN(read_op(value, name, &one), "'%s'", name);
        local = join(&one, &local);
    }
    *inout = join(inout, &local);
    return SPIN_OK;
}

/* Sets q to the quaternion w x y z of a rotation matrix in USD's row-vector convention. */
static void quaternion_of(const double r[3][3], double q[4])
{
    double trace = r[0][0] + r[1][1] + r[2][2];
    int i = r[1][1] > r[0][0] ? 1 : 0;
    int j, k;
    double root;

    i = r[2][2] > r[i][i] ? 2 : i;
    j = (i + 1) % 3;
    k = (i + 2) % 3;
    if (trace > 0) {
        root = sqrt(1 + trace);
        q[0] = root / 2;
        for (int c = 0; c < 3; c++)
            q[1 + c] = (r[(c + 1) % 3][(c + 2) % 3] - r[(c + 2) % 3][(c + 1) % 3]) / (2 * root);
        return;
    }
    root = sqrt(fmax(1 + r[i][i] - r[j][j] - r[k][k], 0));
    q[1 + i] = root / 2;
    q[0] = (r[j][k] - r[k][j]) / (2 * root);
    q[1 + j] = (r[i][j] + r[j][i]) / (2 * root);
    q[1 + k] = (r[i][k] + r[k][i]) / (2 * root);
}

static spin_status decompose(const struct matrix *a, struct spin_placement *out)
{
    double r[3][3], volume, off = 0;

    out->scale = sqrt(a->m[0][0] * a->m[0][0] + a->m[0][1] * a->m[0][1] + a->m[0][2] * a->m[0][2]);
    if (!(out->scale > 1e-6 && out->scale < 1e15))
        return spin_unsupported("its scale in the scene is %g, expected above 1e-6 and below 1e15",
                                out->scale);
    for (int i = 0; i < 3; i++)
        for (int c = 0; c < 3; c++)
            r[i][c] = a->m[i][c] / out->scale;
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++)
            off = fmax(off,
                       fabs(r[i][0] * r[k][0] + r[i][1] * r[k][1] + r[i][2] * r[k][2] - (i == k)));
    volume = r[0][0] * (r[1][1] * r[2][2] - r[1][2] * r[2][1]) -
             r[0][1] * (r[1][0] * r[2][2] - r[1][2] * r[2][0]) +
             r[0][2] * (r[1][0] * r[2][1] - r[1][1] * r[2][0]);
    if (!(off < 1e-3) || volume < 0)
        return spin_unsupported("its transform %s, which cannot be applied to splats",
                                volume < 0 ? "mirrors" : "scales the axes unequally or shears");
    quaternion_of((const double(*)[3])r, out->q);
    memcpy(out->shift, a->m[3], sizeof out->shift);
    return SPIN_OK;
}

/* Sets *out to the transform from a prim to the scene. If `turned` is true, a rotation to the axes
 * right, down, forward, which trainings use, is appended: from z up to y up, if the stage has z up,
 * and then half a turn about x. */
static spin_status place_prim(struct spin_usd_stage *s, const struct usd_node *node, double time,
                              bool turned, struct spin_placement *out)
{
    static const struct matrix half = {{{1}, {0, -1}, {0, 0, -1}, {0, 0, 0, 1}}};
    static const struct matrix up = {{{1}, {0, 0, -1}, {0, 1}, {0, 0, 0, 1}}};
    struct matrix all = identity;
    bool reset = false;

    for (; node && !reset; node = node->parent)
        SPIN_TRY(apply_ops(s, node, time, &all, &reset));
    if (turned && s->z_up)
        all = join(&all, &up);
    if (turned)
        all = join(&all, &half);
    return decompose(&all, out);
}

/* ---- The arrays of a frame ------------------------------------------------------------------- */

/* The values of the arrays of a prim at one time. */
struct arrays {
    struct spin_usd_value *value[SPIN_USD_COLUMNS];
    size_t n, n_sh; /* number of splats, and of SH coefficients per splat and channel */
    int sh_degree;
};

/* Finds the SH degree: the value of the degree attribute or, if this is missing, the degree for the
 * number of coefficients. Fails if the number of coefficients does not match the degree. */
static spin_status find_degree(struct spin_usd_stage *s, const struct usd_node *node, double time,
                               struct arrays *out)
{
    struct spin_usd_value *value;
    double stated = 0;
    size_t n = 0, degree = 0;

    SPIN_TRY(spin_usd_count(out->value[SPIN_USD_SH], 3, &n));
    SPIN_TRY(spin_usd_find_value(s, node, "radiance:sphericalHarmonicsDegree", time, &value));
    while (degree < 16 && (degree + 1) * (degree + 1) * out->n < n)
        degree++;
    if (value && spin_usd_doubles(value, 1, 1, &stated) == SPIN_OK && out->n > 0)
        degree = stated >= 0 && stated < 16 ? (size_t)stated : SIZE_MAX / 4;
    out->n_sh = (degree + 1) * (degree + 1);
    if (degree > 15 || out->n_sh * out->n != n)
        return spin_malformed("%zu SH coefficients do not match %zu positions of SH degree %g", n,
                              out->n, value ? stated : (double)degree);
    out->sh_degree = degree < 3 ? (int)degree : 3;
    s->cut = s->cut || degree > 3;
    return SPIN_OK;
}

/* Finds the arrays of a prim at a time, and checks their lengths. A prim that has no positions at
 * this time has no splats. */
static spin_status find_arrays(struct spin_usd_stage *s, const struct usd_node *node, double time,
                               struct arrays *out)
{
    *out = (struct arrays){.n_sh = 0};
    for (int a = 0; a < SPIN_USD_COLUMNS; a++) {
        size_t n;

        SPIN_TRY(find_column(s, node, a, time, &out->value[a]));
        if (!out->value[SPIN_USD_POSITIONS])
            return SPIN_OK;
        if (!out->value[a])
            continue;
        SPIN_TRY_IN(spin_usd_count(out->value[a], attributes[a].width, &n), "'%s'",
                    attributes[a].name);
        out->n = a == SPIN_USD_POSITIONS ? n : out->n;
        if (a != SPIN_USD_SH && n != out->n)
            return spin_malformed("'%s' has %zu values, but there are %zu positions",
                                  attributes[a].name, n, out->n);
    }
    if (!out->value[SPIN_USD_POSITIONS] || !out->value[SPIN_USD_SCALES])
        return spin_malformed("no %s", out->value[SPIN_USD_POSITIONS] ? "'scales'" : "'positions'");
    s->no_orientations = s->no_orientations || !out->value[SPIN_USD_ORIENTATIONS];
    s->no_opacities = s->no_opacities || !out->value[SPIN_USD_OPACITIES];
    s->no_sh = s->no_sh || !out->value[SPIN_USD_SH];
    return out->value[SPIN_USD_SH] ? find_degree(s, node, time, out) : SPIN_OK;
}

/* Returns the path of the file that contains the splats of a node, for messages. */
static const char *file_of(const struct spin_usd_stage *s, const struct usd_node *node)
{
    return s->packed                          ? s->package.path
           : node->clips && node->clips->open ? node->clips->open->path
           : node->n > 0                      ? node->opinion[node->n - 1].file->path
                                              : "";
}

static spin_status fail_node(const struct spin_usd_stage *s, const struct usd_node *node,
                             double time, spin_status status)
{
    return spin_fail_context(status, "'%s': prim '%s' at time code %g", file_of(s, node),
                             node->path, time);
}

/* Checks all arrays of all frames, sets s->counts and s->sh_degree, and finds the columns that
 * never change. */
static spin_status check_frames(struct spin_usd_stage *s)
{
    s->still = ALL;
    for (size_t f = 0; f < s->n_frames; f++)
        for (struct usd_node *p = s->splats; p; p = p->next) {
            struct arrays now;
            spin_status status = find_arrays(s, p, s->times[f], &now);

            if (status != SPIN_OK)
                return fail_node(s, p, s->times[f], status);
            s->counts[f] += now.n;
            s->sh_degree = now.sh_degree > s->sh_degree ? now.sh_degree : s->sh_degree;
            for (int a = 0; a < SPIN_USD_COLUMNS; a++) {
                struct usd_column *c = &p->column[a];
                unsigned number = now.value[a] ? number_of(now.value[a]) : 0;

                if (f > 0 && (c->from != now.value[a] || c->number != number))
                    s->still &= ~attributes[a].bit;
                c->from = now.value[a];
                c->number = number;
            }
        }
    for (struct usd_node *p = s->splats; p; p = p->next)
        for (int a = 0; a < SPIN_USD_COLUMNS; a++)
            p->column[a].from = NULL;
    s->still &= s->moves ? SPIN_COL_LOGIT_OPACITIES : ALL;
    return SPIN_OK;
}

/* ---- Reading --------------------------------------------------------------------------------- */

/* Reads the values of an array into node->column[a], unless the column still contains these values
 * from the previous frame. */
static spin_status load_column(struct usd_node *node, int a, struct spin_usd_value *from, size_t n)
{
    struct usd_column *c = &node->column[a];

    if (c->from == from && c->number == number_of(from) && c->n == n)
        return SPIN_OK;
    c->from = NULL;
    SPIN_TRY(spin_grow(n + 1, attributes[a].width * sizeof *c->value, (void **)&c->value));
    SPIN_TRY(spin_usd_floats(from, attributes[a].width, n, c->value));
    c->n = n;
    c->number = number_of(from);
    c->from = from;
    return SPIN_OK;
}

static spin_status load_scales(const float *from, size_t n, float *out)
{
    for (size_t i = 0; i < 3 * n; i++) {
        if (from[i] < 0)
            return spin_malformed("scale %g of row %zu is negative", (double)from[i], i / 3);
        out[i] = spin_finite_log_scale(logf(from[i]));
    }
    return SPIN_OK;
}

static spin_status load_opacities(const float *from, size_t n, float *out)
{
    for (size_t i = 0; i < n; i++) {
        if (from[i] < -1e-3f || from[i] > 1.001f)
            return spin_malformed("opacity %g of row %zu is not within 0 to 1", (double)from[i], i);
        out[i] = isnan(from[i]) ? from[i] : spin_opacity_logit(from[i]);
    }
    return SPIN_OK;
}

/* Fills one column of s->raw with the values of its array or, if there is none, with the default of
 * the schema. */
static spin_status fill_column(struct spin_usd_stage *s, const struct usd_node *node,
                               const struct arrays *now, int a)
{
    const float *v = now->value[a] ? node->column[a].value : NULL;
    struct spin_splats *raw = &s->raw;
    size_t n = now->n, width = 3 * (size_t)spin_sh_count(now->sh_degree);

    switch (a) {
    case SPIN_USD_POSITIONS:
        memcpy(raw->means, v, 3 * n * sizeof *v);
        return SPIN_OK;
    case SPIN_USD_ORIENTATIONS:
        for (size_t i = 0; i < n; i++) {
            static const float none[4] = {1, 0, 0, 0};

            memcpy(raw->quats + 4 * i, v ? v + 4 * i : none, sizeof none);
            if (spin_quat_norm(raw->quats + 4 * i) > 0)
                spin_quat_normalise(raw->quats + 4 * i);
            else
                raw->quats[4 * i] = NAN;
        }
        return SPIN_OK;
    case SPIN_USD_SCALES:
        return load_scales(v, n, raw->log_scales);
    case SPIN_USD_OPACITIES:
        for (size_t i = 0; i < n && !v; i++)
            raw->logit_opacities[i] = SPIN_LOGIT_LIMIT;
        return v ? load_opacities(v, n, raw->logit_opacities) : SPIN_OK;
    default:
        memset(raw->sh, 0, n * width * sizeof *raw->sh);
        for (size_t i = 0; i < n && v; i++)
            memcpy(raw->sh + i * width, v + 3 * i * now->n_sh, width * sizeof *v);
        return SPIN_OK;
    }
}

static spin_status read_node(struct spin_usd_stage *s, struct usd_node *node, double time,
                             bool turned, unsigned columns, size_t first, struct spin_splats *out)
{
    struct spin_placement placement;
    struct arrays now;

    SPIN_TRY(find_arrays(s, node, time, &now));
    if (now.n > out->n - first)
        return spin_fail(SPIN_E_IO, "the file changed while it was being read");
    SPIN_TRY(spin_splats_reserve(&s->raw, now.n, columns, now.sh_degree));
    for (int a = 0; a < SPIN_USD_COLUMNS && now.n > 0; a++) {
        size_t n = a == SPIN_USD_SH ? now.n * now.n_sh : now.n;

        if (!(columns & attributes[a].bit))
            continue;
        if (now.value[a])
            SPIN_TRY_IN(load_column(node, a, now.value[a], n), "'%s'", attributes[a].name);
        SPIN_TRY(fill_column(s, node, &now, a));
    }
    SPIN_TRY(place_prim(s, node, time, turned, &placement));
    spin_splats_place(&s->raw, columns, &placement, first, out);
    return SPIN_OK;
}

spin_status spin_usd_stage_read(struct spin_usd_stage *s, size_t frame, bool turned,
                                unsigned columns, struct spin_splats *out, size_t *n_dropped)
{
    static const char *const names[5] = {"positions", "orientations", "scales", "opacities",
                                         "SH coefficients"};
    double time = s->times[frame];
    size_t first = 0;

    SPIN_TRY(spin_splats_reserve(out, s->counts[frame], columns, s->sh_degree));
    for (struct usd_node *p = s->splats; p; p = p->next) {
        spin_status status = read_node(s, p, time, turned, columns, first, out);

        if (status != SPIN_OK)
            return fail_node(s, p, time, status);
        first += s->raw.n;
    }
    if (first != out->n)
        return spin_fail(SPIN_E_IO, "'%s' changed while it was being read", file_of(s, s->splats));
    out->antialias = s->antialias;
    spin_drop_nonfinite(columns, out, n_dropped);
    return spin_fail_context(spin_check_columns(names, columns, 0, out->n, out), "'%s'",
                             file_of(s, s->splats));
}

/* ---- Opening --------------------------------------------------------------------------------- */

static double metadata_number(const struct usd_file *file, const char *name)
{
    struct spin_usd_field *field = spin_usd_field(file->layer.root.metadata, name);
    double v = 0;

    if (!field || !field->value.layer || spin_usd_doubles(&field->value, 1, 1, &v) != SPIN_OK)
        return 0;
    return isfinite(v) && v > 0 ? v : 0;
}

static void read_metadata(struct spin_usd_stage *s, const struct usd_file *root)
{
    struct spin_usd_field *data = spin_usd_field(root->layer.root.metadata, "customLayerData");
    SPIN_FREED char *up = spin_usd_metadata_text(root, "upAxis");
    struct spin_usd_value value;
    double is = 0;

    s->z_up = up && strcmp(up, "Z") == 0;
    s->meters = metadata_number(root, "metersPerUnit");
    s->codes_per_second = metadata_number(root, "timeCodesPerSecond");
    if (data && data->value.layer && spin_usd_entry(&data->value, "antialias", &value) == SPIN_OK &&
        value.layer && spin_usd_doubles(&value, 1, 1, &is) == SPIN_OK)
        s->antialias = is != 0;
}

/* Sets s->linear if the colour space of a prim of splats is linear. */
static spin_status read_colour_space(struct spin_usd_stage *s, const struct usd_node *node)
{
    SPIN_FREED char *name = NULL;
    struct spin_usd_value *value;

    SPIN_TRY(spin_usd_find_value(s, node, "colorSpace:name", 0, &value));
    if (value)
        SPIN_TRY(spin_usd_text(value, &name));
    s->linear = s->linear || (name && strncmp(name, "lin_", 4) == 0);
    return SPIN_OK;
}

static spin_status fail_empty(const struct spin_usd_stage *s, const char *path)
{
    if (*s->other)
        return spin_unsupported("'%s': no prim of type " SPIN_USD_TYPE
                                "; prims of type %s are not supported",
                                path, s->other);
    return spin_malformed("'%s': no prim of type " SPIN_USD_TYPE "%s%s", path,
                          *s->missing ? "; not found: " : "", s->missing);
}

spin_status spin_usd_stage_open(const char *path, struct spin_usd_stage *s)
{
    struct usd_file *root;

    SPIN_TRY(spin_usd_open_root(s, path, &root));
    read_metadata(s, root);
    SPIN_TRY(spin_usd_compose(s, root));
    if (!s->splats)
        return fail_empty(s, path);
    for (struct usd_node *p = s->splats; p; p = p->next)
        SPIN_TRY(read_colour_space(s, p));
    SPIN_TRY_IN(find_times(s), "'%s'", path);
    return check_frames(s);
}

void spin_usd_stage_close(struct spin_usd_stage *s)
{
    for (struct usd_node *p = s->splats; p; p = p->next)
        for (int a = 0; a < SPIN_USD_COLUMNS; a++)
            free(p->column[a].value);
    spin_usd_close_files(s);
    spin_splats_free(&s->raw);
    spin_arena_free(&s->arena);
    memset(s, 0, sizeof *s);
}
