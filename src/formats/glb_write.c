/* The binary container of glTF 2.0 (its section 4): a header, the JSON padded with spaces, the bytes. */
#include "formats/glb_write.h"

#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/mem.h"
#include "math/portable.h"

enum { HEADER = 12, CHUNK_HEADER = 8, TOO_FAR = -1 /* no errno */ };
enum { ARRAY_BUFFER = 34962 };
#define MAX_BYTES UINT32_MAX /* its lengths have 32 bits */

/* ---- Rows ------------------------------------------------------------------------------------ */

static bool is_colour(const struct spin_glb_clip *c, int attribute)
{
    return attribute == c->n_attributes - 1;
}

static int components_of(const struct spin_glb_clip *c, int attribute)
{
    return attribute == SPIN_GLB_ROTATION || is_colour(c, attribute) ? 4
           : attribute == SPIN_GLB_OPACITY                           ? 1
                                                                     : 3;
}

static float clamp(float x) { return spin_minf(spin_maxf(x, 0), 1); }

static uint16_t u16_of(float x) { return (uint16_t)(clamp(x) * 65535 + 0.5f); }

/* The curve of sRGB (IEC 61966-2-1), undone. */
static float linear_of(float x)
{
    return x <= 0.04045f ? x / 12.92f : powf((x + 0.055f) / 1.055f, 2.4f);
}

void spin_glb_code(const struct spin_glb_clip *clip, const struct spin_gaussian *row,
                   const float *sh, int n_sh, unsigned char *const column[], size_t at)
{
    float *rotation = (float *)(void *)column[SPIN_GLB_ROTATION] + 4 * at;
    float *scale = (float *)(void *)column[SPIN_GLB_SCALE] + 3 * at;
    uint16_t *colour = (uint16_t *)(void *)column[clip->n_attributes - 1] + 4 * at;

    memcpy(column[SPIN_GLB_POSITION] + 12 * at, row->place, sizeof row->place);
    for (int k = 0; k < 4; k++)
        rotation[k] = row->rotation[(k + 1) % 4];
    for (int c = 0; c < 3; c++)
        scale[c] = expf(row->log_scale[c]);
    memcpy(column[SPIN_GLB_OPACITY] + 4 * at, &row->opacity, sizeof row->opacity);
    for (int k = 0; k < spin_sh_count(clip->sh_degree); k++) {
        float *out = (float *)(void *)column[SPIN_GLB_SH + k] + 3 * at;

        for (int c = 0; c < 3; c++)
            out[c] = k < n_sh ? sh[3 * k + c] : 0;
    }
    for (int c = 0; c < 3; c++)
        colour[c] = u16_of(linear_of(clamp(row->colour[c])));
    colour[3] = u16_of(row->opacity);
}

void spin_glb_order(const struct spin_glb_clip *clip, unsigned char *const column[], size_t n)
{
#if __BYTE_ORDER__ == __ORDER_BIG_ENDIAN__
    int last = clip->n_attributes - 1;

    for (int a = 0; a < last; a++)
        spin_little_endian(column[a], n * clip->width[a] / 4);
    for (size_t i = 0; i < n * clip->width[last] / 2; i++)
        ((uint16_t *)(void *)column[last])[i] =
            __builtin_bswap16(((uint16_t *)(void *)column[last])[i]);
#else
    (void)clip;
    (void)column;
    (void)n;
#endif
}

/* ---- The document ---------------------------------------------------------------------------- */

static spin_json *add_object(spin_json *list)
{
    spin_json *object = spin_json_object();

    spin_json_push(list, object);
    return object;
}

static void set_numbers(spin_json *object, const char *key, const float *value, int n)
{
    spin_json *list = spin_json_array();

    for (int i = 0; i < n; i++)
        spin_json_push_number(list, (double)value[i]);
    spin_json_set(object, key, list);
}

struct document {
    const struct spin_glb_clip *clip;
    spin_json *root, *views, *accessors, *meshes;
};

static size_t add_accessor(struct document *d, int components, bool is_u16, uint64_t n,
                           uint64_t offset, int target, const float *low, const float *high,
                           int n_bounds)
{
    static const char *const types[] = {"", "SCALAR", "", "VEC3", "VEC4"};
    size_t index = spin_json_length(d->views);
    spin_json *view = add_object(d->views), *accessor = add_object(d->accessors);

    spin_json_set_integer(view, "buffer", 0);
    spin_json_set_integer(view, "byteOffset", (int64_t)offset);
    spin_json_set_integer(view, "byteLength", (int64_t)n * components * (is_u16 ? 2 : 4));
    if (target)
        spin_json_set_integer(view, "target", target);
    spin_json_set_integer(accessor, "bufferView", (int64_t)index);
    spin_json_set_integer(accessor, "componentType", is_u16 ? SPIN_GLB_U16 : SPIN_GLB_F32);
    if (is_u16)
        spin_json_set_bool(accessor, "normalized", true);
    spin_json_set_integer(accessor, "count", (int64_t)n);
    spin_json_set_string(accessor, "type", types[components]);
    if (n_bounds > 0) {
        set_numbers(accessor, "min", low, n_bounds);
        set_numbers(accessor, "max", high, n_bounds);
    }
    return index;
}

static void add_mesh(struct document *d, const struct spin_glb_frame *frame, spin_json *node)
{
    spin_json *mesh, *primitives = spin_json_array(), *primitive, *attributes = spin_json_object();
    spin_json *extensions = spin_json_object(), *splats = spin_json_object();

    spin_json_set_integer(node, "mesh", (int64_t)spin_json_length(d->meshes));
    mesh = add_object(d->meshes);
    primitive = add_object(primitives);
    for (int a = 0; a < d->clip->n_attributes; a++) {
        char name[SPIN_GLB_NAME] = "COLOR_0";

        if (!is_colour(d->clip, a))
            spin_glb_attribute_name(a, name);
        spin_json_set_integer(attributes, name, (int64_t)frame->column[a]);
    }
    spin_json_set_string(splats, "kernel", "ellipse");
    spin_json_set_string(splats, "colorSpace", "srgb_rec709_display");
    spin_json_set(extensions, SPIN_GLB_SPLATS, splats);
    spin_json_set_integer(primitive, "mode", SPIN_GLB_POINTS);
    spin_json_set(primitive, "attributes", attributes);
    spin_json_set(primitive, "extensions", extensions);
    spin_json_set(mesh, "primitives", primitives);
}

static void add_nodes(struct document *d)
{
    const struct spin_glb_clip *clip = d->clip;
    spin_json *nodes = spin_json_array(), *scenes = spin_json_array(), *roots = spin_json_array();
    bool still = clip->still && clip->still->n > 0;

    for (int f = 0; f < clip->n_frames; f++) {
        const float shown = f == 0, scale[3] = {shown, shown, shown}; /* where nothing plays */
        spin_json *node = add_object(nodes), *extras = spin_json_object();
        char name[32];

        snprintf(name, sizeof name, "frame_%d", clip->frame[f].number);
        spin_json_set_string(node, "name", name);
        if (clip->frame[f].n > 0)
            add_mesh(d, &clip->frame[f], node);
        if (clip->animated)
            set_numbers(node, "scale", scale, 3);
        spin_json_set_integer(extras, "frame", clip->frame[f].number);
        spin_json_set_number(extras, "time", clip->frame[f].time);
        spin_json_set(node, "extras", extras);
    }
    if (still) {
        spin_json *node = add_object(nodes);

        spin_json_set_string(node, "name", "still");
        add_mesh(d, clip->still, node);
        spin_json_push(roots, spin_json_integer_value(clip->n_frames));
    }
    for (int f = 0; f < clip->n_frames; f++)
        spin_json_push(roots, spin_json_integer_value(f));
    spin_json_set(add_object(scenes), "nodes", roots);
    spin_json_set_integer(d->root, "scene", 0);
    spin_json_set(d->root, "scenes", scenes);
    spin_json_set(d->root, "nodes", nodes);
}

/* n_frames + 1 times, then for each frame as many scales. */
static void add_animation(struct document *d, uint64_t at)
{
    const float first = 0, last = (float)(d->clip->n_frames / d->clip->fps);
    uint64_t n = (uint64_t)d->clip->n_frames + 1;
    size_t input = add_accessor(d, 1, false, n, at, 0, &first, &last, 1);
    spin_json *animations = spin_json_array(), *animation = add_object(animations);
    spin_json *samplers = spin_json_array(), *channels = spin_json_array();

    at += 4 * n;
    for (int f = 0; f < d->clip->n_frames; f++, at += 12 * n) {
        spin_json *sampler = add_object(samplers), *channel = add_object(channels);
        spin_json *target = spin_json_object();

        spin_json_set_integer(sampler, "input", (int64_t)input);
        spin_json_set_string(sampler, "interpolation", "STEP");
        spin_json_set_integer(sampler, "output",
                              (int64_t)add_accessor(d, 3, false, n, at, 0, NULL, NULL, 0));
        spin_json_set_integer(target, "node", f);
        spin_json_set_string(target, "path", "scale");
        spin_json_set_integer(channel, "sampler", f);
        spin_json_set(channel, "target", target);
    }
    spin_json_set_string(animation, "name", "frames");
    spin_json_set(animation, "samplers", samplers);
    spin_json_set(animation, "channels", channels);
    spin_json_set(d->root, "animations", animations);
}

static void add_asset(const struct spin_glb_clip *clip, spin_json *root)
{
    spin_json *asset = spin_json_object(), *extras = spin_json_object();

    spin_json_set_string(asset, "version", "2.0");
    spin_json_set_string(asset, "generator", "spin4d " SPIN_VERSION);
    spin_json_set_string(extras, "axes", clip->axes);
    if (clip->source && *clip->source)
        spin_json_set_string(extras, "source", clip->source);
    if (clip->fps > 0)
        spin_json_set_number(extras, "fps", clip->fps);
    spin_json_set_integer(extras, "frames", clip->n_frames);
    spin_json_set(asset, "extras", extras);
    spin_json_set(root, "asset", asset);
}

/* Lists that would be empty are left out. */
static void set_list(spin_json *root, const char *key, spin_json *list)
{
    if (spin_json_length(list) > 0)
        spin_json_set(root, key, list);
    else
        spin_json_free(list);
}

/* The JSON; allocated. keys: where those of the animation begin. */
static char *make_text(const struct spin_glb_clip *clip, uint64_t keys)
{
    struct document d = {.clip = clip,
                         .root = spin_json_object(),
                         .views = spin_json_array(),
                         .accessors = spin_json_array(),
                         .meshes = spin_json_array()};
    spin_json *used = spin_json_array(), *buffers = spin_json_array();
    char *text;

    add_asset(clip, d.root);
    for (size_t i = 0; i < clip->n_columns; i++) {
        const struct spin_glb_column *c = &clip->column[i];

        add_accessor(&d, components_of(clip, c->attribute), is_colour(clip, c->attribute), c->n,
                     c->offset, ARRAY_BUFFER, c->low, c->high,
                     c->attribute == SPIN_GLB_POSITION ? 3 : 0);
    }
    add_nodes(&d);
    if (clip->animated)
        add_animation(&d, keys);
    if (spin_json_length(d.meshes) > 0)
        spin_json_push_string(used, SPIN_GLB_SPLATS);
    if (clip->n_bytes > 0)
        spin_json_set_integer(add_object(buffers), "byteLength", (int64_t)clip->n_bytes);
    set_list(d.root, "extensionsUsed", used);
    set_list(d.root, "meshes", d.meshes);
    set_list(d.root, "accessors", d.accessors);
    set_list(d.root, "bufferViews", d.views);
    set_list(d.root, "buffers", buffers);
    text = spin_json_text(d.root, false);
    spin_json_free(d.root);
    return text;
}

/* ---- The file -------------------------------------------------------------------------------- */

void spin_glb_begin(struct spin_glb_clip *clip)
{
    size_t n_meshes = (size_t)clip->n_frames + (clip->animated ? 1 : 0);

    clip->n_attributes = SPIN_GLB_SH + spin_sh_count(clip->sh_degree) + 1;
    clip->row = 0;
    for (int a = 0; a < clip->n_attributes; a++) {
        clip->width[a] = (size_t)components_of(clip, a) * (is_colour(clip, a) ? 2 : 4);
        clip->row += clip->width[a];
    }
    /* 216: of an attribute's accessor, view and name when every number in them is as long as it can be; 768: of the
     * other things of a frame. */
    clip->room = 1024 + n_meshes * (768 + 216 * (size_t)clip->n_attributes);
}

uint64_t spin_glb_bytes(const struct spin_glb_clip *clip, uint64_t n_rows)
{
    uint64_t n = (uint64_t)clip->n_frames, n_keys = clip->animated ? 4 * (n + 1) * (1 + 3 * n) : 0;

    return HEADER + 2 * CHUNK_HEADER + clip->room + n_rows * clip->row + n_keys;
}

int spin_glb_put(const struct spin_glb_clip *clip, uint64_t at, const void *data, size_t bytes)
{
    uint64_t first = HEADER + 2 * CHUNK_HEADER + (uint64_t)clip->room;

    if (at > MAX_BYTES || bytes > MAX_BYTES || first + at + bytes > MAX_BYTES)
        return TOO_FAR;
    return spin_out_put(clip->out, first + at, data, bytes);
}

spin_status spin_glb_failed(const struct spin_glb_clip *clip, int error)
{
    if (error != TOO_FAR)
        return spin_out_failed(clip->out, error);
    return spin_fail(SPIN_E_UNSUPPORTED,
                     "cannot write '%s': a .glb ends at 4 GiB; export fewer frames with "
                     "--range, or give a folder for one .glb per frame",
                     clip->out->path);
}

/* Key i is at i / fps. Frame f is shown from its own key on; the last one also at a key behind it, which repeats its
 * value, or players would cut it. */
static spin_status write_keys(struct spin_glb_clip *clip)
{
    size_t n_frames = (size_t)clip->n_frames, n = n_frames + 1;
    float *key = NULL;
    int error;

    SPIN_TRY(spin_alloc(n, 3 * sizeof *key, (void **)&key));
    for (size_t i = 0; i < n; i++)
        key[i] = (float)((double)i / clip->fps);
    spin_little_endian(key, n);
    error = spin_glb_put(clip, clip->n_bytes, key, n * sizeof *key);
    clip->n_bytes += n * sizeof *key;
    for (size_t f = 0; f < n_frames && !error; f++, clip->n_bytes += 3 * n * sizeof *key) {
        for (size_t i = 0; i < 3 * n; i++)
            key[i] = i / 3 == f || (f + 1 == n_frames && i / 3 == n_frames);
        spin_little_endian(key, 3 * n);
        error = spin_glb_put(clip, clip->n_bytes, key, 3 * n * sizeof *key);
    }
    free(key);
    return error ? spin_glb_failed(clip, error) : SPIN_OK;
}

static void put_u32(unsigned char *at, uint64_t value)
{
    for (int i = 0; i < 4; i++)
        at[i] = (unsigned char)(value >> (8 * i));
}

/* Header, JSON, and the header of the bytes: all that stands before them. */
static spin_status write_front(const struct spin_glb_clip *clip, const char *text)
{
    const char *path = clip->out->path;
    size_t n = text ? strlen(text) : 0, room = clip->room;
    size_t n_front = HEADER + CHUNK_HEADER + room + (clip->n_bytes > 0 ? CHUNK_HEADER : 0);
    unsigned char *front = NULL;
    spin_status status;

    if (!text)
        return spin_fail(SPIN_E_MEMORY, "cannot write '%s': no memory for its JSON", path);
    if (n > room)
        return spin_fail(SPIN_E_UNSUPPORTED,
                         "cannot write '%s': its JSON takes %zu bytes, %zu were kept for it", path,
                         n, room);
    SPIN_TRY(spin_alloc(n_front, 1, (void **)&front));
    memcpy(front, "glTF", 4);
    put_u32(front + 4, 2);
    put_u32(front + 8, n_front + clip->n_bytes);
    put_u32(front + 12, room);
    memcpy(front + 16, "JSON", 4);
    memcpy(front + 20, text, n);
    memset(front + 20 + n, ' ', room - n);
    if (clip->n_bytes > 0) {
        put_u32(front + 20 + room, clip->n_bytes);
        memcpy(front + 24 + room, "BIN", 4);
    }
    status = spin_out_write_at(clip->out, 0, front, n_front);
    free(front);
    return status;
}

spin_status spin_glb_end(struct spin_glb_clip *clip)
{
    uint64_t keys = clip->n_bytes;
    char *text;
    spin_status status;

    if (clip->animated)
        SPIN_TRY(write_keys(clip));
    text = make_text(clip, keys);
    status = write_front(clip, text);
    free(text);
    return status;
}
