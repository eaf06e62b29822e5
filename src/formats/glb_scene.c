#include "formats/glb_scene.h"

#include <stdlib.h>
#include <string.h>

#include "base/mem.h"
#include "formats/glb_nodes.h"
#include "math/quat.h"
#include "math/scene_rotation.h"

#define POINTER "KHR_animation_pointer"
/* Frames times what they show, or times what switches them: a clip of four thousand frames. */
#define MAX_CELLS ((uint64_t)1 << 24)
#define MAX_PIECES ((size_t)1 << 16)
#define PACKED_SLACK (1u << 20) /* splats of SPZ, which may take less than a byte */
#define SAME_SCALE 1e-4

/* What an animation does to one node: a value for each key. */
struct key {
    size_t node, n;
    struct spin_glb_numbers time, value;
    double scale; /* of what is shown; 0: not known */
};

struct build {
    struct spin_gs_glb_scene *scene;
    struct spin_glb_nodes nodes;
    struct key *key; /* [n_keys] */
    size_t n_keys;
    float *time; /* [n_times] all times at which keys stand, increasing */
    size_t n_times;
    unsigned char *on; /* [n_times][n_keys] */
};

/* ---- Splats ---------------------------------------------------------------------------------- */

static spin_status add_piece(struct build *b, size_t node, const spin_json *primitive)
{
    static const double to_gltf[4] = {0, 0, 0, 1}; /* from right, down, forward */
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
    SPIN_TRY(spin_glb_nodes_place(&b->nodes, node, &piece.placement, &shown));
    if (!shown)
        return SPIN_OK;
    if (s->n_pieces == MAX_PIECES)
        return spin_fail(SPIN_E_UNSUPPORTED, "more than %zu meshes of splats", MAX_PIECES);
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
    for (size_t i = 0; i < b->nodes.n; i++) {
        spin_status status = add_mesh(b, i);

        if (status != SPIN_OK)
            return spin_fail_context(status, "node %zu", i);
    }
    if (b->scene->n_pieces == 0)
        return spin_fail(SPIN_E_MALFORMED, "its scene shows no splats (" SPIN_GS_GLB_EXTENSION ")");
    return SPIN_OK;
}

/* ---- Switches -------------------------------------------------------------------------------- */

/* "/nodes/3/extensions/KHR_node_visibility/visible" */
static int64_t pointed_node(const char *pointer)
{
    long long node = -1;
    int end = 0;

    if (pointer)
        sscanf(pointer, "/nodes/%9lld/extensions/" SPIN_GLB_VISIBILITY "/visible%n", &node, &end);
    return end > 0 && pointer[end] == '\0' ? node : -1;
}

/* A channel that switches a node becomes a key of it; others are only remembered. */
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
        return spin_fail(SPIN_E_MALFORMED,
                         "an animation switches a node that is not there, or twice");
    SPIN_TRY(spin_glb_find(&s->file,
                           spin_glb_item(&s->file, "accessors", spin_json_get(sampler, "input")), 1,
                           SPIN_GLB_F32, &key->time));
    SPIN_TRY(spin_glb_find(&s->file,
                           spin_glb_item(&s->file, "accessors", spin_json_get(sampler, "output")),
                           scale ? 3 : 1, scale ? SPIN_GLB_F32 : SPIN_GLB_U8, &key->value));
    if (key->time.n == 0 || key->time.n != key->value.n)
        return spin_fail(SPIN_E_MALFORMED, "%zu keys with %zu values", key->time.n, key->value.n);
    key->node = (size_t)node;
    key->n = key->time.n;
    b->nodes.node[node].key = (int64_t)b->n_keys++;
    return SPIN_OK;
}

/* The first animation is what players play. */
static spin_status find_keys(struct build *b)
{
    const spin_json *list = spin_json_get(b->scene->file.json, "animations");
    const spin_json *animation = spin_json_at(list, 0);
    const spin_json *channels = spin_json_get(animation, "channels");

    b->scene->moves = spin_json_length(list) > 1;
    SPIN_TRY(spin_alloc(spin_json_length(channels) + 1, sizeof *b->key, (void **)&b->key));
    for (size_t i = 0; i < spin_json_length(channels); i++) {
        spin_status status = add_channel(b, animation, spin_json_at(channels, i));

        if (status != SPIN_OK)
            return spin_fail_context(status, "channel %zu of the animation", i);
    }
    return SPIN_OK;
}

static int by_time(const void *a, const void *b)
{
    float x = *(const float *)a, y = *(const float *)b;

    return (x > y) - (x < y);
}

/* Whether key k has the times of the one before it: mostly all have the same. */
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
        return spin_fail(SPIN_E_UNSUPPORTED, "an animation of %zu keys", room);
    SPIN_TRY(spin_alloc(room + 1, sizeof *b->time, (void **)&b->time));
    for (size_t k = 0; k < b->n_keys; k++) {
        for (size_t i = 0; i < b->key[k].n && !has_times_before(b, k); i++, n++) {
            spin_glb_row(&b->key[k].time, i, &b->time[n]);
            if (!isfinite(b->time[n]) || (i > 0 && b->time[n] <= b->time[n - 1]))
                return spin_fail(SPIN_E_MALFORMED, "keys whose times do not increase");
        }
    }
    qsort(b->time, n, sizeof *b->time, by_time);
    for (size_t i = 0; i < n; i++) {
        if (b->n_times == 0 || b->time[i] > b->time[b->n_times - 1])
            b->time[b->n_times++] = b->time[i];
    }
    return SPIN_OK;
}

/* Whether value i shows the node. Scales that do must all be one. */
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
    SPIN_TRY(spin_glb_one_scale(scale, &one));
    *on = one > SPIN_GLB_NO_SCALE;
    if (*on && key->scale > 0 && fabs(one / key->scale - 1) > SAME_SCALE)
        return spin_fail(SPIN_E_UNSUPPORTED, "an animation scales node %zu by %g and by %g",
                         key->node, key->scale, one);
    key->scale = *on ? one : key->scale;
    return SPIN_OK;
}

/* At each time a key has the value of the last time before. */
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
    if (key->value.width == 3) /* it takes the place of the node's own */
        b->nodes.node[key->node].scale = key->scale;
    return SPIN_OK;
}

static spin_status run_keys(struct build *b)
{
    if (b->n_times * (uint64_t)b->n_keys > MAX_CELLS)
        return spin_fail(SPIN_E_UNSUPPORTED, "an animation of %zu nodes at %zu times", b->n_keys,
                         b->n_times);
    SPIN_TRY(spin_alloc(b->n_times * b->n_keys + 1, 1, (void **)&b->on));
    for (size_t k = 0; k < b->n_keys; k++)
        SPIN_TRY(run_key(b, k));
    return SPIN_OK;
}

/* ---- Frames ---------------------------------------------------------------------------------- */

/* Whether no switch hides a node or what it hangs from. */
static bool is_on(const struct build *b, size_t node, const unsigned char *on)
{
    for (int64_t at = (int64_t)node; at >= 0; at = b->nodes.node[at].parent) {
        if (b->nodes.node[at].key >= 0 && !on[b->nodes.node[at].key])
            return false;
    }
    return true;
}

/* The one node that a frame is: that which is switched on, or the only one that there is. */
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

/* What our exporter says of a frame. */
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
        return spin_fail(SPIN_E_UNSUPPORTED, "%zu meshes in more than %zu frames", s->n_pieces,
                         s->n_frames);
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
    /* Many nodes may show one mesh, but not to make gigabytes of a small file. */
    if (n_plain > s->file.n_bytes || frame->n > s->file.n_bytes + PACKED_SLACK)
        return spin_fail(SPIN_E_UNSUPPORTED, "%zu splats in a frame of a file of %llu bytes",
                         frame->n, (unsigned long long)s->file.n_bytes);
    read_extras(spin_json_get(spin_json_at(nodes, node_of_frame(b, on)), "extras"), frame);
    s->n_frames++;
    return SPIN_OK;
}

/* A frame for each time from which on something else is shown. */
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

/* What a file says that its readers must know. */
static spin_status check_required(const struct spin_gs_glb_scene *s)
{
    static const char *const known[] = {SPIN_GS_GLB_EXTENSION,
                                        SPIN_GS_GLB_EXTENSION "_compression_spz_2",
                                        "KHR_mesh_quantization",
                                        SPIN_GLB_VISIBILITY,
                                        POINTER,
                                        "KHR_materials_unlit"}; /* of points drawn instead */
    const spin_json *list = spin_json_get(s->file.json, "extensionsRequired");

    for (size_t i = 0; i < spin_json_length(list); i++) {
        const char *name = spin_json_string(spin_json_at(list, i));
        bool found = false;

        for (size_t k = 0; k < sizeof known / sizeof *known && name; k++)
            found = found || strcmp(name, known[k]) == 0;
        if (!found)
            return spin_fail(SPIN_E_UNSUPPORTED, "it requires '%.60s', which is not read",
                             name ? name : "");
    }
    return SPIN_OK;
}

spin_status spin_gs_glb_scene_open(const unsigned char *file, size_t size,
                                   struct spin_gs_glb_scene *out)
{
    struct build b = {.scene = out};
    spin_status status;

    SPIN_TRY_OUT(spin_glb_open(file, size, &out->file));
    SPIN_TRY_OUT(check_required(out));
    SPIN_TRY_OUT(spin_glb_nodes_read(out->file.json, &b.nodes));
    SPIN_TRY_OUT(find_keys(&b));
    SPIN_TRY_OUT(gather_times(&b));
    SPIN_TRY_OUT(run_keys(&b));
    SPIN_TRY_OUT(find_pieces(&b));
    SPIN_TRY_OUT(find_frames(&b));
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
        spin_status status = spin_gs_glb_read(&piece->points, columns, &s->raw);

        if (status != SPIN_OK)
            return spin_fail_context(status, "node %zu", piece->node);
        for (size_t i = 0; i < s->raw.n && (columns & SPIN_COL_QUATS); i++)
            spin_quat_normalise(s->raw.quats + 4 * i);
        spin_splats_place(&s->raw, columns, &piece->placement, first, out);
        first += s->raw.n;
    }
    return spin_check_columns(what, columns, 0, f->n, out);
}
