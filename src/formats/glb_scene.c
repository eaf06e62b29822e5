#include "formats/glb.h"

#include "base/base.h"
#include "math/covariance.h"
#include "math/quat.h"
#include "math/scene_rotation.h"

#define POINTER "KHR_animation_pointer"
/* Limit on three numbers: frames times mesh primitives, times of the animation times animated
 * nodes, and key frames. It prevents small files from expanding to gigabytes. A clip with one node
 * per frame may have at most 4096 frames. */
#define MAX_CELLS ((uint64_t)1 << 24)
#define MAX_PIECES ((size_t)1 << 16)
/* If the binary chunk has n bytes, a frame may have at most n + PACKED_SLACK splats, of which at
 * most n may be stored without SPZ. */
#define PACKED_SLACK (1u << 20)
#define SAME_SCALE 1e-4 /* relative tolerance within which scales count as equal */
#define NO_SCALE 1e-6   /* a node with a smaller scale is invisible */
#define MAX_SIZE 1e15   /* limit of positions and scales */
#define MAX_DEPTH 64    /* limit of the depth of nested nodes */
#define VISIBILITY "KHR_node_visibility"

/* ---- Nodes ----------------------------------------------------------------------------------- */

/* A node and its transform: rotation, then scale, then shift, then the parent's transform. All axes
 * must have the same scale: unequal scales would skew the ellipsoids of splats, and spherical
 * harmonics cannot be skewed. */
struct node {
    double q[4], scale, shift[3];
    int64_t parent; /* index of the parent node; -1: none */
    /* Index in build.key[] of the channel that shows and hides the node; -1: none. */
    int64_t key;
    /* True: KHR_node_visibility hides the node. Ignored if `key` is not -1. */
    bool hidden;
    bool in_scene; /* true: the node is a root of the scene */
};

struct nodes {
    struct node *node; /* [n]; must be freed even after a failure */
    size_t n;
};

static spin_status read_numbers(const spin_json *list, size_t n, double *out)
{
    for (size_t i = 0; list && i < n; i++) {
        if (spin_json_length(list) != n || !spin_json_number(spin_json_at(list, i), &out[i]) ||
            !(fabs(out[i]) < MAX_SIZE))
            return spin_malformed("a property of the transform is not a list of %zu numbers below "
                                  "1e15",
                                  n);
    }
    return SPIN_OK;
}

/* Sets *out to the common value of three scales. SPIN_E_UNSUPPORTED if the scales differ, are
 * negative or are not numbers. */
static spin_status one_scale(const double scale[3], double *out)
{
    double largest = fmax(fmax(scale[0], scale[1]), scale[2]);

    *out = 0;
    for (int c = 0; c < 3; c++) {
        if (!(scale[c] >= 0 && scale[c] >= largest * (1 - SAME_SCALE) && largest < MAX_SIZE))
            return spin_unsupported("the scale is %g, %g, %g, expected three equal numbers of 0 or "
                                    "more",
                                    scale[0], scale[1], scale[2]);
    }
    *out = largest;
    return SPIN_OK;
}

static spin_status normalise_quat(double q[4])
{
    double norm = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);

    if (!(norm > 1e-6))
        return spin_malformed("'rotation' is a quaternion of length 0");
    for (int k = 0; k < 4; k++)
        q[k] /= norm;
    return SPIN_OK;
}

static spin_status split_matrix(const spin_json *list, struct node *node)
{
    double m[16], length[3], rows[9], det;

    SPIN_TRY(read_numbers(list, 16, m));
    for (int c = 0; c < 3; c++)
        length[c] =
            sqrt(m[4 * c] * m[4 * c] + m[4 * c + 1] * m[4 * c + 1] + m[4 * c + 2] * m[4 * c + 2]);
    SPIN_TRY(one_scale(length, &node->scale));
    memcpy(node->shift, m + 12, sizeof node->shift);
    if (node->scale < NO_SCALE)
        return SPIN_OK;
    for (int i = 0; i < 12; i++)
        m[i] /= node->scale;
    det = m[0] * (m[5] * m[10] - m[6] * m[9]) - m[4] * (m[1] * m[10] - m[2] * m[9]) +
          m[8] * (m[1] * m[6] - m[2] * m[5]);
    if (fabs(det - 1) > 1e-3)
        return spin_unsupported("'matrix' is not a rotation times a uniform scale");
    for (int i = 0; i < 9; i++)
        rows[i] = m[i % 3 * 4 + i / 3];
    spin_quat_of_matrix(rows, node->q);
    return SPIN_OK;
}

static spin_status read_node(const spin_json *object, struct node *node)
{
    const spin_json *matrix = spin_json_get(object, "matrix");
    const spin_json *visibility = spin_json_get(spin_json_get(object, "extensions"), VISIBILITY);
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
    SPIN_TRY(normalise_quat(node->q));
    return one_scale(scale, &node->scale);
}

static spin_status join_children(struct nodes *nodes, size_t i, const spin_json *children)
{
    for (size_t k = 0; k < spin_json_length(children); k++) {
        int64_t child = -1;

        if (!spin_json_integer(spin_json_at(children, k), &child) || child < 0 ||
            (size_t)child >= nodes->n || nodes->node[child].parent >= 0)
            return spin_malformed("a node in 'children' does not exist, or has two parents");
        nodes->node[child].parent = (int64_t)i;
    }
    return SPIN_OK;
}

/* Marks the nodes that are roots of the default scene; if the file has no scenes, marks all nodes
 * without a parent. */
static spin_status mark_scene(const spin_json *json, struct nodes *nodes)
{
    const spin_json *scenes = spin_json_get(json, "scenes"), *list;
    int64_t scene = spin_glb_integer(json, "scene", 0);

    if (spin_json_length(scenes) == 0) {
        for (size_t i = 0; i < nodes->n; i++)
            nodes->node[i].in_scene = nodes->node[i].parent < 0;
        return SPIN_OK;
    }
    if (scene < 0 || !spin_json_at(scenes, (size_t)scene))
        return spin_malformed("the default scene %lld does not exist", (long long)scene);
    list = spin_json_get(spin_json_at(scenes, (size_t)scene), "nodes");
    for (size_t i = 0; i < spin_json_length(list); i++) {
        int64_t node = -1;

        if (!spin_json_integer(spin_json_at(list, i), &node) || node < 0 ||
            (size_t)node >= nodes->n)
            return spin_malformed("scene %lld lists a node that does not exist", (long long)scene);
        nodes->node[node].in_scene = true;
    }
    return SPIN_OK;
}

static spin_status read_nodes(const spin_json *json, struct nodes *out)
{
    const spin_json *list = spin_json_get(json, "nodes");

    out->n = spin_json_length(list);
    SPIN_TRY(spin_alloc(out->n + 1, sizeof *out->node, (void **)&out->node));
    for (size_t i = 0; i < out->n; i++)
        out->node[i].parent = out->node[i].key = -1;
    for (size_t i = 0; i < out->n; i++) {
        const spin_json *object = spin_json_at(list, i);

        SPIN_TRY_IN(read_node(object, &out->node[i]), "node %zu", i);
        SPIN_TRY_IN(join_children(out, i, spin_json_get(object, "children")), "node %zu", i);
    }
    return mark_scene(json, out);
}

/* Rotates p by a unit quaternion w x y z. */
static void turn_point(const double q[4], const double p[3], double out[3])
{
    const double t[3] = {2 * (q[2] * p[2] - q[3] * p[1]), 2 * (q[3] * p[0] - q[1] * p[2]),
                         2 * (q[1] * p[1] - q[2] * p[0])};

    out[0] = p[0] + q[0] * t[0] + q[2] * t[2] - q[3] * t[1];
    out[1] = p[1] + q[0] * t[1] + q[3] * t[0] - q[1] * t[2];
    out[2] = p[2] + q[0] * t[2] + q[1] * t[1] - q[2] * t[0];
}

/* Appends to `inout` the transforms of node i and of all its ancestors. *shown becomes true if node
 * i is in the scene and neither the node nor an ancestor is permanently hidden. */
static spin_status place_node(const struct nodes *nodes, size_t i, struct spin_placement *inout,
                              bool *shown)
{
    int64_t at = (int64_t)i, top = at;

    *shown = true;
    for (int depth = 0; at >= 0; depth++) {
        const struct node *node = &nodes->node[at];
        double joined[4], moved[3];

        if (depth == MAX_DEPTH)
            return spin_malformed("nodes are nested more than %d levels deep, or form a cycle",
                                  MAX_DEPTH);
        spin_scene_rotation_join(inout->q, node->q, joined);
        memcpy(inout->q, joined, sizeof joined);
        turn_point(node->q, inout->shift, moved);
        for (int c = 0; c < 3; c++)
            inout->shift[c] = node->scale * moved[c] + node->shift[c];
        inout->scale *= node->scale;
        *shown = *shown && node->scale > NO_SCALE && (node->key >= 0 || !node->hidden);
        top = at;
        at = node->parent;
    }
    *shown = *shown && nodes->node[top].in_scene;
    if (*shown && !(inout->scale > NO_SCALE && inout->scale < MAX_SIZE))
        return spin_unsupported("the scale in the scene is %g, expected above 1e-6 and below 1e15",
                                inout->scale);
    return SPIN_OK;
}

/* A channel of the animation that shows and hides one node, with n key frames. */
struct key {
    size_t node, n;
    struct spin_glb_numbers time, value;
    double scale; /* scale of the node while it is visible; 0: not yet known */
};

struct build {
    struct spin_gs_glb_scene *scene;
    struct nodes nodes;
    struct key *key; /* [n_keys] the channels that show and hide nodes */
    size_t n_keys;
    float *time; /* [n_times] times of all key frames, strictly increasing */
    size_t n_times;
    unsigned char *on; /* [n_times][n_keys] 1: the node of this channel is shown at this time */
};

/* ---- Splats ---------------------------------------------------------------------------------- */

static spin_status add_piece(struct build *b, size_t node, const spin_json *primitive)
{
    static const double to_gltf[4] = {0, 0, 0, 1}; /* half a turn about z: from RDF to glTF's LUF */
    struct spin_gs_glb_scene *s = b->scene;
    struct spin_gs_glb_piece piece = {.placement = {.q = {1}, .scale = 1}, .node = node};
    bool shown;

    SPIN_TRY(spin_gs_glb_find(&s->file, primitive, &piece.points));
    if (piece.points.packed) {
        int axes = piece.points.spz.axes;
        double q[4];

        SPIN_TRY(spin_spz_axes(axes ? axes : SPIN_SPZ_RIGHT_UP_BACK, q));
        spin_scene_rotation_join(q, to_gltf, piece.placement.q);
    }
    SPIN_TRY(place_node(&b->nodes, node, &piece.placement, &shown));
    if (!shown)
        return SPIN_OK;
    if (s->n_pieces == MAX_PIECES)
        return spin_unsupported("the scene has more than %zu meshes of splats", MAX_PIECES);
    SPIN_TRY(spin_grow(s->n_pieces + 1, sizeof *s->piece, (void **)&s->piece));
    s->piece[s->n_pieces++] = piece;
    s->sh_degree = piece.points.sh_degree > s->sh_degree ? piece.points.sh_degree : s->sh_degree;
    s->linear = s->linear || piece.points.linear;
    return SPIN_OK;
}

static spin_status add_mesh(struct build *b, size_t node)
{
    struct spin_gs_glb_scene *s = b->scene;
    const spin_json *object = spin_json_at(spin_json_get(s->file.json, "nodes"), node);
    const spin_json *mesh = spin_glb_item(&s->file, "meshes", spin_json_get(object, "mesh"));
    const spin_json *list = spin_json_get(mesh, "primitives");

    for (size_t k = 0; k < spin_json_length(list); k++) {
        if (spin_gs_glb_is_splats(spin_json_at(list, k)))
            SPIN_TRY(add_piece(b, node, spin_json_at(list, k)));
        else
            s->others = true;
    }
    return SPIN_OK;
}

static spin_status find_pieces(struct build *b)
{
    for (size_t i = 0; i < b->nodes.n; i++)
        SPIN_TRY_IN(add_mesh(b, i), "node %zu", i);
    if (b->scene->n_pieces == 0 && spin_json_get(b->scene->file.json, "meshes"))
        return spin_malformed("the scene contains no visible splats (" SPIN_GLB_SPLATS ")");
    return SPIN_OK;
}

/* ---- Animations that show and hide nodes ----------------------------------------------------- */

/* Parses a pointer to the visibility of a node, "/nodes/3/extensions/KHR_node_visibility/visible".
 * Returns the index of the node, or -1 if the pointer has another form. */
static int64_t pointed_node(const char *pointer)
{
    long long node = -1;
    int end = 0;

    if (pointer)
        sscanf(pointer, "/nodes/%9lld/extensions/" VISIBILITY "/visible%n", &node, &end);
    return end > 0 && pointer[end] == '\0' ? node : -1;
}

/* Appends a channel to b->key[] if it shows and hides a node. For all other channels, only sets
 * scene->moves. */
static spin_status add_channel(struct build *b, const spin_json *animation,
                               const spin_json *channel)
{
    struct spin_gs_glb_scene *s = b->scene;
    const spin_json *target = spin_json_get(channel, "target");
    const spin_json *pointer = spin_json_get(spin_json_get(target, "extensions"), POINTER);
    const spin_json *samplers = spin_json_get(animation, "samplers"), *sampler;
    const char *path = spin_json_string(spin_json_get(target, "path")), *interpolation;
    int64_t node = spin_glb_integer(target, "node", -1),
            at = spin_glb_integer(channel, "sampler", -1);
    bool scale = path && strcmp(path, "scale") == 0;
    struct key *key = &b->key[b->n_keys];

    sampler = at >= 0 ? spin_json_at(samplers, (size_t)at) : NULL;
    interpolation = spin_json_string(spin_json_get(sampler, "interpolation"));
    if (path && strcmp(path, "pointer") == 0)
        node = pointed_node(spin_json_string(spin_json_get(pointer, "pointer")));
    else if (!scale)
        node = -1;
    if (node < 0 || !interpolation || strcmp(interpolation, "STEP") != 0) {
        s->moves = true;
        return SPIN_OK;
    }
    if ((size_t)node >= b->nodes.n || b->nodes.node[node].key >= 0)
        return spin_malformed("node %lld does not exist, or two channels animate it",
                              (long long)node);
    SPIN_TRY(spin_glb_find(&s->file,
                           spin_glb_item(&s->file, "accessors", spin_json_get(sampler, "input")), 1,
                           SPIN_GLB_IS(SPIN_GLB_F32), &key->time));
    SPIN_TRY(spin_glb_find(
        &s->file, spin_glb_item(&s->file, "accessors", spin_json_get(sampler, "output")),
        scale ? 3 : 1, SPIN_GLB_IS(scale ? SPIN_GLB_F32 : SPIN_GLB_U8), &key->value));
    if (key->time.n == 0 || key->time.n != key->value.n)
        return spin_malformed("'input' has %zu times, 'output' has %zu values", key->time.n,
                              key->value.n);
    key->node = (size_t)node;
    key->n = key->time.n;
    b->nodes.node[node].key = (int64_t)b->n_keys++;
    return SPIN_OK;
}

/* Reads the channels of the first animation, which is the one that players play. */
static spin_status find_keys(struct build *b)
{
    const spin_json *list = spin_json_get(b->scene->file.json, "animations");
    const spin_json *animation = spin_json_at(list, 0);
    const spin_json *channels = spin_json_get(animation, "channels");

    b->scene->moves = spin_json_length(list) > 1;
    SPIN_TRY(spin_alloc(spin_json_length(channels) + 1, sizeof *b->key, (void **)&b->key));
    for (size_t i = 0; i < spin_json_length(channels); i++)
        SPIN_TRY_IN(add_channel(b, animation, spin_json_at(channels, i)),
                    "channel %zu of the animation", i);
    return SPIN_OK;
}

static int by_time(const void *a, const void *b)
{
    float x = *(const float *)a, y = *(const float *)b;

    return (x > y) - (x < y);
}

/* Returns whether channel k has the same times as channel k - 1, as is usual in exported files. */
static bool has_times_before(const struct build *b, size_t k)
{
    return k > 0 && b->key[k].time.at == b->key[k - 1].time.at && b->key[k].n == b->key[k - 1].n;
}

static spin_status gather_times(struct build *b)
{
    size_t n = 0, room = 0;

    for (size_t k = 0; k < b->n_keys; k++)
        room += has_times_before(b, k) ? 0 : b->key[k].n;
    if (room > MAX_CELLS)
        return spin_unsupported("the animation has %zu key frames, more than the limit of %llu",
                                room, (unsigned long long)MAX_CELLS);
    SPIN_TRY(spin_alloc(room + 1, sizeof *b->time, (void **)&b->time));
    for (size_t k = 0; k < b->n_keys; k++) {
        for (size_t i = 0; i < b->key[k].n && !has_times_before(b, k); i++, n++) {
            spin_glb_row(&b->key[k].time, i, &b->time[n]);
            if (!isfinite(b->time[n]) || (i > 0 && b->time[n] <= b->time[n - 1]))
                return spin_malformed("the times of an animation's key frames do not increase");
        }
    }
    qsort(b->time, n, sizeof *b->time, by_time);
    for (size_t i = 0; i < n; i++) {
        if (b->n_times == 0 || b->time[i] > b->time[b->n_times - 1])
            b->time[b->n_times++] = b->time[i];
    }
    return SPIN_OK;
}

/* Sets *on to whether key frame i shows the node. All key frames that show a node must give it the
 * same scale. */
static spin_status read_switch(struct key *key, size_t i, bool *on)
{
    double scale[3], one;
    float value[3];

    spin_glb_row(&key->value, i, value);
    if (key->value.width == 1) {
        *on = value[0] != 0;
        return SPIN_OK;
    }
    for (int c = 0; c < 3; c++)
        scale[c] = (double)value[c];
    SPIN_TRY(one_scale(scale, &one));
    *on = one > NO_SCALE;
    if (*on && key->scale > 0 && fabs(one / key->scale - 1) > SAME_SCALE)
        return spin_unsupported("the animation changes the scale of node %zu from %g to %g; a "
                                "scale may only change to and from 0",
                                key->node, key->scale, one);
    key->scale = *on ? one : key->scale;
    return SPIN_OK;
}

/* Fills column k of b->on: at each time, the node is shown if the last key frame up to this time
 * shows it. */
static spin_status run_key(struct build *b, size_t k)
{
    struct key *key = &b->key[k];
    bool on = false;
    float next;

    SPIN_TRY(read_switch(key, 0, &on));
    for (size_t t = 0, i = 1; t < b->n_times; t++) {
        for (; i < key->n; i++) {
            spin_glb_row(&key->time, i, &next);
            if (next > b->time[t])
                break;
            SPIN_TRY(read_switch(key, i, &on));
        }
        b->on[t * b->n_keys + k] = on;
    }
    if (key->value.width == 3) /* an animated scale replaces the scale of the node */
        b->nodes.node[key->node].scale = key->scale;
    return SPIN_OK;
}

static spin_status run_keys(struct build *b)
{
    if (b->n_times * (uint64_t)b->n_keys > MAX_CELLS)
        return spin_unsupported("the animation of %zu nodes at %zu times exceeds the limit of "
                                "%llu values",
                                b->n_keys, b->n_times, (unsigned long long)MAX_CELLS);
    SPIN_TRY(spin_alloc(b->n_times * b->n_keys + 1, 1, (void **)&b->on));
    for (size_t k = 0; k < b->n_keys; k++)
        SPIN_TRY(run_key(b, k));
    return SPIN_OK;
}

/* ---- Frames ---------------------------------------------------------------------------------- */

/* Returns whether the animation shows the node and all its ancestors. on [n_keys]: 1 for each
 * channel whose node is shown, a row of b->on. */
static bool is_on(const struct build *b, size_t node, const unsigned char *on)
{
    for (int64_t at = (int64_t)node; at >= 0; at = b->nodes.node[at].parent) {
        if (b->nodes.node[at].key >= 0 && !on[b->nodes.node[at].key])
            return false;
    }
    return true;
}

/* Returns the node whose extras describe a frame: the only animated node that is visible in this
 * frame or, in a file without animation, the only node. Returns b->nodes.n if there are several
 * such nodes or none. */
static size_t node_of_frame(const struct build *b, const unsigned char *on)
{
    size_t node = b->nodes.n, n_on = 0;

    if (b->n_keys == 0)
        return b->nodes.n == 1 ? 0 : node;
    for (size_t k = 0; k < b->n_keys; k++) {
        node = on[k] ? b->key[k].node : node;
        n_on += on[k];
    }
    return n_on == 1 ? node : b->nodes.n;
}

/* Reads the frame number and time that spin4d's exporter stores in the extras of a node. */
static void read_extras(const spin_json *extras, struct spin_gs_glb_frame *frame)
{
    int64_t number = spin_glb_integer(extras, "frame", -1);

    spin_json_number(spin_json_get(extras, "time"), &frame->extras_time);
    if (number >= 0 && number <= INT32_MAX)
        frame->number = (int)number;
}

static spin_status add_frame(struct build *b, const unsigned char *on, double time)
{
    struct spin_gs_glb_scene *s = b->scene;
    struct spin_gs_glb_frame *frame = &s->frame[s->n_frames];
    const spin_json *nodes = spin_json_get(s->file.json, "nodes");
    size_t at = s->n_frames ? frame[-1].first + frame[-1].n_shown : 0, n_plain = 0;

    *frame =
        (struct spin_gs_glb_frame){.first = at, .number = -1, .time = time, .extras_time = NAN};
    if (s->n_pieces * (uint64_t)(s->n_frames + 1) > MAX_CELLS)
        return spin_unsupported("%zu meshes in more than %zu frames exceed the limit of %llu "
                                "values",
                                s->n_pieces, s->n_frames, (unsigned long long)MAX_CELLS);
    for (size_t i = 0; i < s->n_pieces; i++) {
        const struct spin_gs_glb_points *points = &s->piece[i].points;

        if (!is_on(b, s->piece[i].node, on))
            continue;
        SPIN_TRY(spin_grow(at + 1, sizeof *s->shown, (void **)&s->shown));
        s->shown[at++] = i;
        frame->n_shown++;
        frame->n += points->n;
        n_plain += points->packed ? 0 : points->n;
    }
    /* Many nodes may show the same mesh, so a small file can have huge frames: limit them. */
    if (n_plain > s->file.n_bytes || frame->n > s->file.n_bytes + PACKED_SLACK)
        return spin_unsupported("frame %zu has %zu splats, too many for a file of %llu bytes",
                                s->n_frames, frame->n, (unsigned long long)s->file.n_bytes);
    read_extras(spin_json_get(spin_json_at(nodes, node_of_frame(b, on)), "extras"), frame);
    s->n_frames++;
    return SPIN_OK;
}

/* Adds a frame for each time at which the set of visible nodes changes. */
static spin_status find_frames(struct build *b)
{
    struct spin_gs_glb_scene *s = b->scene;
    const unsigned char *before = NULL;
    bool all = true;

    SPIN_TRY(spin_alloc(b->n_times + 1, sizeof *s->frame, (void **)&s->frame));
    if (b->n_keys == 0)
        return add_frame(b, NULL, 0);
    for (size_t t = 0; t < b->n_times; t++) {
        const unsigned char *on = b->on + t * b->n_keys;

        if (before && memcmp(before, on, b->n_keys) == 0)
            continue;
        SPIN_TRY(add_frame(b, on, (double)b->time[t]));
        before = on;
    }
    for (size_t f = 0; f < s->n_frames; f++)
        all = all && !isnan(s->frame[f].extras_time);
    for (size_t f = 0; f < s->n_frames && all; f++)
        s->frame[f].time = s->frame[f].extras_time;
    return SPIN_OK;
}

/* ---- The scene ------------------------------------------------------------------------------- */

/* Refuses files that require an unknown extension. */
static spin_status check_required(const struct spin_gs_glb_scene *s)
{
    static const char *const known[] = {SPIN_GLB_SPLATS,
                                        SPIN_GLB_SPLATS "_compression_spz_2",
                                        "KHR_mesh_quantization",
                                        VISIBILITY,
                                        POINTER,
                                        "KHR_materials_unlit"}; /* does not affect splats */
    const spin_json *list = spin_json_get(s->file.json, "extensionsRequired");

    for (size_t i = 0; i < spin_json_length(list); i++) {
        const char *name = spin_json_string(spin_json_at(list, i));
        bool found = false;

        for (size_t k = 0; k < sizeof known / sizeof *known && name; k++)
            found = found || strcmp(name, known[k]) == 0;
        if (!found)
            return spin_unsupported("the file requires extension '%.60s', which is not supported",
                                    name ? name : "");
    }
    return SPIN_OK;
}

/* KHR_gaussian_splatting has no flag for antialiasing and no frame rate, so spin4d's exporter
 * stores both in the asset's extras. SPZ data contain a flag for antialiasing. */
static void read_asset(struct spin_gs_glb_scene *s)
{
    const spin_json *extras = spin_json_get(spin_json_get(s->file.json, "asset"), "extras");

    spin_json_number(spin_json_get(extras, "fps"), &s->fps);
    if (!(s->fps > 0) || !isfinite(s->fps))
        s->fps = 0;
    spin_json_bool(spin_json_get(extras, "antialias"), &s->antialias);
    for (size_t i = 0; i < s->n_pieces; i++)
        s->antialias = s->antialias || s->piece[i].points.spz.antialias;
}

spin_status spin_gs_glb_scene_open(const unsigned char *file, size_t size,
                                   struct spin_gs_glb_scene *out)
{
    struct build b = {.scene = out};
    spin_status status;

    SPIN_TRY_OUT(spin_glb_open(file, size, &out->file));
    SPIN_TRY_OUT(check_required(out));
    SPIN_TRY_OUT(read_nodes(out->file.json, &b.nodes));
    SPIN_TRY_OUT(find_keys(&b));
    SPIN_TRY_OUT(gather_times(&b));
    SPIN_TRY_OUT(run_keys(&b));
    SPIN_TRY_OUT(find_pieces(&b));
    SPIN_TRY_OUT(find_frames(&b));
    read_asset(out);
out:
    free(b.nodes.node);
    free(b.key);
    free(b.time);
    free(b.on);
    return status;
}

void spin_gs_glb_scene_close(struct spin_gs_glb_scene *scene)
{
    spin_glb_close(&scene->file);
    spin_splats_free(&scene->raw);
    free(scene->piece);
    free(scene->frame);
    free(scene->shown);
    *scene = (struct spin_gs_glb_scene){0};
}

spin_status spin_gs_glb_scene_read(struct spin_gs_glb_scene *s, size_t frame, unsigned columns,
                                   struct spin_splats *out)
{
    static const char *const what[5] = {"POSITION", "ROTATION", "SCALE", "OPACITY", "SH_DEGREE_*"};
    const struct spin_gs_glb_frame *f = &s->frame[frame];
    size_t first = 0;

    columns &= SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    SPIN_TRY(spin_splats_reserve(out, f->n, columns, s->sh_degree));
    for (size_t k = 0; k < f->n_shown; k++) {
        const struct spin_gs_glb_piece *piece = &s->piece[s->shown[f->first + k]];

        SPIN_TRY_IN(spin_gs_glb_read(&piece->points, columns, &s->raw), "node %zu", piece->node);
        for (size_t i = 0; i < s->raw.n && (columns & SPIN_COL_QUATS); i++)
            spin_quat_normalise(s->raw.quats + 4 * i);
        spin_splats_place(&s->raw, columns, &piece->placement, first, out);
        first += s->raw.n;
    }
    return spin_check_columns(what, columns, 0, f->n, out);
}
