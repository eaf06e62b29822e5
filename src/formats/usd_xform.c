#include "formats/usd_xform.h"

#include <math.h>
#include <string.h>

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

spin_status spin_usd_place(struct spin_usd_stage *s, const struct usd_node *node, double time,
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
