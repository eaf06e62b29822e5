#include "formats/glb_nodes.h"

#include <math.h>
#include <string.h>

#include "base/mem.h"
#include "formats/glb_accessor.h"
#include "math/scene_rotation.h"

#define MAX_DEPTH 64
#define SAME_SCALE 1e-4 /* the most that scales along the axes differ, of the largest */
#define MAX_SIZE 1e15   /* of places and scales */

static spin_status read_numbers(const spin_json *list, size_t n, double *out)
{
    for (size_t i = 0; list && i < n; i++) {
        if (spin_json_length(list) != n || !spin_json_number(spin_json_at(list, i), &out[i]) ||
            !(fabs(out[i]) < MAX_SIZE))
            return spin_fail(SPIN_E_MALFORMED, "its place in the scene is not made of %zu numbers",
                             n);
    }
    return SPIN_OK;
}

spin_status spin_glb_one_scale(const double scale[3], double *out)
{
    double largest = fmax(fmax(scale[0], scale[1]), scale[2]);

    *out = 0;
    for (int c = 0; c < 3; c++) {
        if (!(scale[c] >= 0 && scale[c] >= largest * (1 - SAME_SCALE) && largest < MAX_SIZE))
            return spin_fail(SPIN_E_UNSUPPORTED,
                             "it is scaled by %g, %g, %g: expected one positive number", scale[0],
                             scale[1], scale[2]);
    }
    *out = largest;
    return SPIN_OK;
}

/* The unit quaternion w x y z of a rotation matrix of columns. */
static void quat_of_columns(const double *m, double q[4])
{
    double square[4] = {1 + m[0] + m[5] + m[10], 1 + m[0] - m[5] - m[10], 1 - m[0] + m[5] - m[10],
                        1 - m[0] - m[5] + m[10]};
    int k = 0;

    for (int i = 1; i < 4; i++)
        k = square[i] > square[k] ? i : k;
    q[0] = k == 0 ? square[0] : k == 1 ? m[6] - m[9] : k == 2 ? m[8] - m[2] : m[1] - m[4];
    q[1] = k == 0 ? m[6] - m[9] : k == 1 ? square[1] : k == 2 ? m[1] + m[4] : m[8] + m[2];
    q[2] = k == 0 ? m[8] - m[2] : k == 1 ? m[1] + m[4] : k == 2 ? square[2] : m[6] + m[9];
    q[3] = k == 0 ? m[1] - m[4] : k == 1 ? m[8] + m[2] : k == 2 ? m[6] + m[9] : square[3];
}

static spin_status normalise(double q[4])
{
    double norm = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);

    if (!(norm > 1e-6))
        return spin_fail(SPIN_E_MALFORMED, "its rotation has no length");
    for (int k = 0; k < 4; k++)
        q[k] /= norm;
    return SPIN_OK;
}

static spin_status split_matrix(const spin_json *list, struct spin_glb_node *node)
{
    double m[16], length[3], det;

    SPIN_TRY(read_numbers(list, 16, m));
    for (int c = 0; c < 3; c++)
        length[c] =
            sqrt(m[4 * c] * m[4 * c] + m[4 * c + 1] * m[4 * c + 1] + m[4 * c + 2] * m[4 * c + 2]);
    SPIN_TRY(spin_glb_one_scale(length, &node->scale));
    memcpy(node->shift, m + 12, sizeof node->shift);
    if (node->scale < SPIN_GLB_NO_SCALE)
        return SPIN_OK;
    for (int i = 0; i < 12; i++)
        m[i] /= node->scale;
    det = m[0] * (m[5] * m[10] - m[6] * m[9]) - m[4] * (m[1] * m[10] - m[2] * m[9]) +
          m[8] * (m[1] * m[6] - m[2] * m[5]);
    if (fabs(det - 1) > 1e-3)
        return spin_fail(SPIN_E_UNSUPPORTED, "its matrix is not a rotation and a scale");
    quat_of_columns(m, node->q);
    return normalise(node->q);
}

static spin_status read_node(const spin_json *object, struct spin_glb_node *node)
{
    const spin_json *matrix = spin_json_get(object, "matrix");
    const spin_json *visibility =
        spin_json_get(spin_json_get(object, "extensions"), SPIN_GLB_VISIBILITY);
    double rotation[4] = {0, 0, 0, 1}, scale[3] = {1, 1, 1};
    bool visible = true;

    spin_json_bool(spin_json_get(visibility, "visible"), &visible);
    node->hidden = !visible;
    node->q[0] = 1;
    if (matrix)
        return split_matrix(matrix, node);
    SPIN_TRY(read_numbers(spin_json_get(object, "translation"), 3, node->shift));
    SPIN_TRY(read_numbers(spin_json_get(object, "rotation"), 4, rotation));
    SPIN_TRY(read_numbers(spin_json_get(object, "scale"), 3, scale));
    for (int k = 0; k < 4; k++)
        node->q[(k + 1) % 4] = rotation[k];
    SPIN_TRY(normalise(node->q));
    return spin_glb_one_scale(scale, &node->scale);
}

static spin_status join_children(struct spin_glb_nodes *nodes, size_t i, const spin_json *children)
{
    for (size_t k = 0; k < spin_json_length(children); k++) {
        int64_t child = -1;

        if (!spin_json_integer(spin_json_at(children, k), &child) || child < 0 ||
            (size_t)child >= nodes->n || nodes->node[child].parent >= 0)
            return spin_fail(SPIN_E_MALFORMED, "its children are no nodes or those of another");
        nodes->node[child].parent = (int64_t)i;
    }
    return SPIN_OK;
}

/* The roots of the scene that is shown; without scenes, every root. */
static spin_status mark_scene(const spin_json *json, struct spin_glb_nodes *nodes)
{
    const spin_json *scenes = spin_json_get(json, "scenes"), *list;
    int64_t scene = spin_glb_integer(json, "scene", 0);

    if (spin_json_length(scenes) == 0) {
        for (size_t i = 0; i < nodes->n; i++)
            nodes->node[i].in_scene = nodes->node[i].parent < 0;
        return SPIN_OK;
    }
    if (scene < 0 || !spin_json_at(scenes, (size_t)scene))
        return spin_fail(SPIN_E_MALFORMED, "its scene is not there");
    list = spin_json_get(spin_json_at(scenes, (size_t)scene), "nodes");
    for (size_t i = 0; i < spin_json_length(list); i++) {
        int64_t node = -1;

        if (!spin_json_integer(spin_json_at(list, i), &node) || node < 0 ||
            (size_t)node >= nodes->n)
            return spin_fail(SPIN_E_MALFORMED, "its scene has a node that is not there");
        nodes->node[node].in_scene = true;
    }
    return SPIN_OK;
}

spin_status spin_glb_nodes_read(const spin_json *json, struct spin_glb_nodes *out)
{
    const spin_json *list = spin_json_get(json, "nodes");

    out->n = spin_json_length(list);
    SPIN_TRY(spin_alloc(out->n + 1, sizeof *out->node, (void **)&out->node));
    for (size_t i = 0; i < out->n; i++)
        out->node[i].parent = out->node[i].key = -1;
    for (size_t i = 0; i < out->n; i++) {
        const spin_json *object = spin_json_at(list, i);
        spin_status status = read_node(object, &out->node[i]);

        if (status == SPIN_OK)
            status = join_children(out, i, spin_json_get(object, "children"));
        if (status != SPIN_OK)
            return spin_fail_context(status, "node %zu", i);
    }
    return mark_scene(json, out);
}

/* p turned by a unit quaternion w x y z. */
static void turn_point(const double q[4], const double p[3], double out[3])
{
    const double t[3] = {2 * (q[2] * p[2] - q[3] * p[1]), 2 * (q[3] * p[0] - q[1] * p[2]),
                         2 * (q[1] * p[1] - q[2] * p[0])};

    out[0] = p[0] + q[0] * t[0] + q[2] * t[2] - q[3] * t[1];
    out[1] = p[1] + q[0] * t[1] + q[3] * t[0] - q[1] * t[2];
    out[2] = p[2] + q[0] * t[2] + q[1] * t[1] - q[2] * t[0];
}

spin_status spin_glb_nodes_place(const struct spin_glb_nodes *nodes, size_t i,
                                 struct spin_placement *inout, bool *shown)
{
    int64_t at = (int64_t)i, top = at;

    *shown = true;
    for (int depth = 0; at >= 0; depth++) {
        const struct spin_glb_node *node = &nodes->node[at];
        double joined[4], moved[3];

        if (depth == MAX_DEPTH)
            return spin_fail(SPIN_E_MALFORMED, "nodes are more than %d deep, or in a circle",
                             MAX_DEPTH);
        spin_scene_rotation_join(inout->q, node->q, joined);
        memcpy(inout->q, joined, sizeof joined);
        turn_point(node->q, inout->shift, moved);
        for (int c = 0; c < 3; c++)
            inout->shift[c] = node->scale * moved[c] + node->shift[c];
        inout->scale *= node->scale;
        *shown = *shown && node->scale > SPIN_GLB_NO_SCALE && (node->key >= 0 || !node->hidden);
        top = at;
        at = node->parent;
    }
    *shown = *shown && nodes->node[top].in_scene;
    if (*shown && !(inout->scale > SPIN_GLB_NO_SCALE && inout->scale < MAX_SIZE))
        return spin_fail(SPIN_E_UNSUPPORTED, "it is scaled by %g", inout->scale);
    return SPIN_OK;
}
