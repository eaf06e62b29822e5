/* K: gltf glb export */
#include "base/log.h"
#include "exporters/lib/frames.h"
#include "formats/glb.h"
#include "tests/exporters/frame.h"

#define E "KHR_gaussian_splatting"

extern const struct spin_exporter spin_exporter_gltf;

struct glb {
    struct spin_map map;
    spin_json *json;
    const unsigned char *bytes; /* of the binary chunk */
    size_t n_bytes;
};

static uint32_t u32_at(const unsigned char *at)
{
    return at[0] | (uint32_t)at[1] << 8 | (uint32_t)at[2] << 16 | (uint32_t)at[3] << 24;
}

static void close_glb(struct glb *g)
{
    spin_json_free(g->json);
    spin_map_close(&g->map);
    *g = (struct glb){0};
}

/* Header, JSON chunk, and at most one binary chunk, whose lengths add up. */
static int open_glb(const char *path, struct glb *g)
{
    const unsigned char *d;
    size_t n_json, at;

    *g = (struct glb){0};
    if (spin_map_open(path, &g->map) != SPIN_OK || g->map.size < 20)
        return 0;
    d = g->map.data;
    n_json = u32_at(d + 12);
    at = 20 + n_json;
    if (memcmp(d, "glTF", 4) || u32_at(d + 4) != 2 || u32_at(d + 8) != g->map.size ||
        memcmp(d + 16, "JSON", 4) || n_json % 4 || at > g->map.size ||
        spin_json_parse(path, (const char *)d + 20, n_json, &g->json) != SPIN_OK)
        return 0;
    if (at == g->map.size)
        return 1;
    g->n_bytes = u32_at(d + at);
    g->bytes = d + at + 8;
    return memcmp(d + at + 4, "BIN", 4) == 0 && at + 8 + g->n_bytes == g->map.size &&
           g->n_bytes % 4 == 0;
}

static int64_t integer_of(const spin_json *object, const char *key)
{
    int64_t n = -1;

    spin_json_integer(spin_json_get(object, key), &n);
    return n;
}

static const spin_json *item(const struct glb *g, const char *list, int64_t i)
{
    return spin_json_at(spin_json_get(g->json, list), (size_t)i);
}

/* The values of an accessor that obeys the rules; NULL if it violates one. */
static const void *values_of(const struct glb *g, int64_t i, const char *type, int64_t component,
                             size_t bytes_of_one, size_t *n)
{
    const spin_json *a = item(g, "accessors", i);
    const spin_json *v = item(g, "bufferViews", integer_of(a, "bufferView"));
    int64_t offset = integer_of(v, "byteOffset"), length = integer_of(v, "byteLength");
    bool normalised = false;

    spin_json_bool(spin_json_get(a, "normalized"), &normalised);
    offset = offset < 0 ? 0 : offset;
    *n = (size_t)integer_of(a, "count");
    if (integer_of(a, "componentType") != component || normalised != (component == 5123) ||
        strcmp(spin_json_string(spin_json_get(a, "type")), type) || integer_of(v, "buffer") != 0 ||
        (size_t)length != *n * bytes_of_one || (size_t)(offset + length) > g->n_bytes || offset % 4)
        return NULL;
    return g->bytes + offset;
}

static const void *attribute_of(const struct glb *g, int mesh, const char *name, const char *type,
                                int64_t component, size_t bytes_of_one, size_t *n)
{
    const spin_json *m = item(g, "meshes", mesh);
    const spin_json *p = spin_json_at(spin_json_get(m, "primitives"), 0);
    int64_t i = integer_of(spin_json_get(p, "attributes"), name);

    *n = 0;
    return i < 0 ? NULL : values_of(g, i, type, component, bytes_of_one, n);
}

static const float *floats(const struct glb *g, int mesh, const char *name, int n_components,
                           size_t want)
{
    static const char *const types[] = {"SCALAR", "VEC2", "VEC3", "VEC4"};
    size_t n;
    const float *x =
        attribute_of(g, mesh, name, types[n_components - 1], 5126, 4 * (size_t)n_components, &n);

    return n == want ? x : NULL;
}

/* ---- Values ---------------------------------------------------------------------------------- */

static int bounds_are_right(const struct glb *g, const float *place, size_t n)
{
    const spin_json *m = spin_json_at(spin_json_get(item(g, "meshes", 0), "primitives"), 0);
    const spin_json *a =
        item(g, "accessors", integer_of(spin_json_get(m, "attributes"), "POSITION"));
    int good = 1;

    for (size_t c = 0; c < 3; c++) {
        double low = INFINITY, high = -INFINITY, value = NAN;

        for (size_t i = 0; i < n; i++) {
            low = fmin(low, place[3 * i + c]);
            high = larger(high, place[3 * i + c]);
        }
        spin_json_number(spin_json_at(spin_json_get(a, "min"), c), &value);
        good &= (float)value == (float)low;
        spin_json_number(spin_json_at(spin_json_get(a, "max"), c), &value);
        good &= (float)value == (float)high;
    }
    return good;
}

static int sh_is_right(const struct glb *g, const struct spin_splats *s, int to, int turned)
{
    static const char signs[] = "+-+-+-+-+-+-+-+-"; /* of odd order: minus */
    size_t n_from = (size_t)((s->sh_degree + 1) * (s->sh_degree + 1)), k = 0;
    int good = 1;

    for (int l = 0; l <= to; l++) {
        for (int m = 0; m < 2 * l + 1; m++, k++) {
            char name[64];
            const float *got;

            snprintf(name, sizeof name, E ":SH_DEGREE_%d_COEF_%d", l, m);
            got = floats(g, 0, name, 3, s->n);
            if (!got)
                return 0;
            for (size_t i = 0; i < 3 * s->n; i++) {
                float want = k < n_from ? s->sh[(i / 3 * n_from + k) * 3 + i % 3] : 0;

                good &= got[i] == (turned && signs[k] == '-' ? -want : want);
            }
        }
    }
    return good;
}

static int colour_is_right(const struct glb *g, const struct spin_splats *s)
{
    size_t n;
    const uint16_t *got = attribute_of(g, 0, "COLOR_0", "VEC4", 5123, 8, &n);
    int good = got && n == s->n;

    for (size_t i = 0; good && i < n; i++) {
        struct want w = want_of(s, i);

        for (int c = 0; c < 3; c++) {
            double x = fmin(fmax(0.5 + 0.28209479177387814 * w.dc[c], 0), 1);

            x = x <= 0.04045 ? x / 12.92 : pow((x + 0.055) / 1.055, 2.4);
            good &= fabs(got[4 * i + (size_t)c] / 65535.0 - x) < 1e-5;
        }
        good &= fabs(got[4 * i + 3] / 65535.0 - w.opacity) < 1e-5;
    }
    return good;
}

static void check_extension(const struct glb *g)
{
    const spin_json *used = spin_json_get(g->json, "extensionsUsed");
    const spin_json *p = spin_json_at(spin_json_get(item(g, "meshes", 0), "primitives"), 0);
    const spin_json *x = spin_json_get(spin_json_get(p, "extensions"), E);

    ok(spin_json_length(used) == 1 && strcmp(spin_json_string(spin_json_at(used, 0)), E) == 0 &&
           !spin_json_get(g->json, "extensionsRequired") && integer_of(p, "mode") == 0 &&
           !spin_json_get(p, "indices"),
       "points that use the extension and do not require it");
    is_text(spin_json_string(spin_json_get(x, "kernel")), "ellipse", "its kernel");
    is_text(spin_json_string(spin_json_get(x, "colorSpace")), "srgb_rec709_display",
            "its colour space");
    ok(integer_of(spin_json_at(spin_json_get(g->json, "buffers"), 0), "byteLength") ==
           (int64_t)g->n_bytes,
       "the buffer has the chunk's length");
}

static void check_rows(const struct glb *g, const struct spin_splats *s, int turned)
{
    const float *place = floats(g, 0, "POSITION", 3, s->n);
    const float *rotation = floats(g, 0, E ":ROTATION", 4, s->n);
    const float *scale = floats(g, 0, E ":SCALE", 3, s->n);
    const float *opacity = floats(g, 0, E ":OPACITY", 1, s->n);
    int good[4] = {1, 1, 1, 1};

    if (!ok(place && rotation && scale && opacity, "four attributes of the splats' count"))
        return;
    for (size_t i = 0; i < s->n; i++) {
        struct want w = want_of(s, i);
        const float *r = rotation + 4 * i;
        double q[4] = {r[3], r[0], r[1], r[2]};

        if (turned) { /* half a turn about z: (0, 0, 0, 1) times q */
            double p[4] = {-w.q[3], -w.q[2], w.q[1], w.q[0]};

            memcpy(w.q, p, sizeof w.q);
            w.place[0] = -w.place[0];
            w.place[1] = -w.place[1];
        }
        for (int k = 0; k < 3; k++) {
            good[0] &= place[3 * i + (size_t)k] == w.place[k];
            good[2] &= fabs(log(scale[3 * i + (size_t)k]) - w.log_scale[k]) < 1e-6;
        }
        good[1] &= degrees_between(q, w.q) < 1e-4;
        good[3] &= fabs(opacity[i] - w.opacity) < 1e-6;
    }
    ok(good[0], "places keep their bits, in the source's order");
    ok(good[1], "rotations are x y z w");
    ok(good[2], "scales are linear");
    ok(good[3], "opacities are after the sigmoid");
    ok(bounds_are_right(g, place, s->n), "POSITION has its bounds");
}

static void test_values(int from, const char *sh, int to, const char *axes)
{
    const char *pairs[] = {"sh", sh, "axes", axes, NULL};
    struct spin_plugin_values values = {pairs};
    int turned = strcmp(axes, "gltf") == 0;
    char name[64];
    struct spin_splats s = {0};
    struct glb g;

    snprintf(name, sizeof name, "d%d%s%s", from, sh, axes);
    struct spin_export_job job = {.output = in_folder(name),
                                  .n_frames = 1,
                                  .sh_degree = from,
                                  .source = "d3\"gs\n\xff",
                                  .values = &values};
    make_frame(&s, 9001, from, 31);
    ok(run(&spin_exporter_gltf, &job, &s, 12) == SPIN_OK, "writes degree %d as %s, axes %s", from,
       sh, axes);
    strcat(name, "/frame_00012.glb");
    if (!ok(open_glb(in_folder(name), &g), "a GLB whose lengths add up"))
        return;
    check_extension(&g);
    check_rows(&g, &s, turned);
    ok(sh_is_right(&g, &s, to, turned), "one accessor a coefficient, signs turned with the axes");
    ok(colour_is_right(&g, &s), "COLOR_0 is linear light");
    const spin_json *asset = spin_json_get(g.json, "asset");
    const spin_json *extras = spin_json_get(item(&g, "nodes", 0), "extras");
    is_text(spin_json_string(spin_json_get(asset, "generator")), "spin4d " SPIN_VERSION,
            "the generator");
    is_text(spin_json_string(spin_json_get(spin_json_get(asset, "extras"), "source")), "d3\"gs__",
            "the source, in plain text");
    ok(integer_of(extras, "frame") == 12 && !spin_json_get(item(&g, "nodes", 0), "scale"),
       "the frame's number; its node is not scaled");
    close_glb(&g);
    spin_splats_free(&s);
}

/* ---- The clip in one file ----------------------------------------------------------------------
 */

/* Scale of a node at key k. */
static float scale_at(const struct glb *g, int node, size_t k)
{
    const spin_json *a = spin_json_at(spin_json_get(g->json, "animations"), 0);
    const spin_json *channel = spin_json_at(spin_json_get(a, "channels"), (size_t)node);
    const spin_json *target = spin_json_get(channel, "target");
    const spin_json *sampler =
        spin_json_at(spin_json_get(a, "samplers"), (size_t)integer_of(channel, "sampler"));
    size_t n;
    const float *x = values_of(g, integer_of(sampler, "output"), "VEC3", 5126, 12, &n);

    if (!x || k >= n || integer_of(target, "node") != node ||
        strcmp(spin_json_string(spin_json_get(target, "path")), "scale") ||
        strcmp(spin_json_string(spin_json_get(sampler, "interpolation")), "STEP"))
        return -1;
    return x[3 * k] == x[3 * k + 1] && x[3 * k] == x[3 * k + 2] ? x[3 * k] : -1;
}

static void check_animation(const struct glb *g, int n_frames, double fps)
{
    const spin_json *a = spin_json_at(spin_json_get(g->json, "animations"), 0);
    const spin_json *sampler = spin_json_at(spin_json_get(a, "samplers"), 0);
    size_t n;
    const float *time = values_of(g, integer_of(sampler, "input"), "SCALAR", 5126, 4, &n);
    int good = time && n == (size_t)n_frames + 1, one = 1;

    for (size_t k = 0; good && k < n; k++)
        good &= fabs(time[k] - (double)k / fps) < 1e-6;
    ok(good, "a key at every 1/%g s, and one at the end", fps);
    ok((int)spin_json_length(spin_json_get(a, "channels")) == n_frames, "a channel per frame");
    for (int f = 0; f < n_frames; f++) {
        double node = -1;

        for (int k = 0; k <= n_frames; k++)
            one &= scale_at(g, f, (size_t)k) == (f == (k < n_frames ? k : n_frames - 1));
        spin_json_number(spin_json_at(spin_json_get(item(g, "nodes", f), "scale"), 1), &node);
        one &= node == (f == 0);
    }
    ok(one, "one frame is shown at a time, the first where nothing plays");
}

static void test_clip(void)
{
    static const char *const pairs[] = {"fps", "12.5", NULL};
    static const size_t counts[] = {300, 5000, 0, 77};
    struct spin_plugin_values values = {pairs};
    struct spin_export_job job = {
        .output = in_folder("clip.glb"), .n_frames = 4, .sh_degree = 1, .values = &values};
    struct spin_splats s = {0};
    struct glb g;
    void *self = NULL;
    int good = 1;

    ok(spin_exporter_gltf.begin(&job, &self) == SPIN_OK, "begins one file for the clip");
    for (int f = 0; f < 4; f++) {
        struct spin_frame_info info = {.number = 10 + f, .time = f / 12.5};

        make_frame(&s, counts[f], 1, (uint32_t)f);
        good &= spin_exporter_gltf.frame(self, f, &info, &s) == SPIN_OK;
    }
    ok(good && !spin_path_exists(job.output), "takes four frames; the file is not there yet");
    ok(spin_exporter_gltf.end(self) == SPIN_OK, "ends");
    if (!ok(open_glb(job.output, &g), "a GLB whose lengths add up"))
        return;
    ok(spin_json_length(spin_json_get(g.json, "nodes")) == 4 &&
           spin_json_length(spin_json_get(g.json, "meshes")) == 3 &&
           !spin_json_get(item(&g, "nodes", 2), "mesh") &&
           integer_of(item(&g, "nodes", 3), "mesh") == 2,
       "a node per frame, a mesh for those that are not empty");
    ok(spin_json_length(spin_json_get(spin_json_at(spin_json_get(g.json, "scenes"), 0), "nodes")) ==
           4,
       "all in the scene");
    check_animation(&g, 4, 12.5);
    const float *place = floats(&g, 2, "POSITION", 3, 77);
    make_frame(&s, 77, 1, 3);
    ok(place && place[0] == -s.means[0] && place[3 * 76 + 2] == s.means[3 * 76 + 2],
       "the last frame's places are its own");
    close_glb(&g);
    ok(spin_exporter_gltf.begin(&job, &self) == SPIN_E_IO && strstr(spin_last_error(), "--force"),
       "does not overwrite unasked");
    spin_splats_free(&s);
}

static int64_t accessor_of(const struct glb *g, int mesh, const char *name)
{
    const spin_json *m = item(g, "meshes", mesh);
    const spin_json *p = spin_json_at(spin_json_get(m, "primitives"), 0);

    return integer_of(spin_json_get(p, "attributes"), name);
}

/* Attributes that two frames share are stored once: the second frame moves, the third has the
 * positions of the first and one opacity of its own. */
static void test_shared_attributes(void)
{
    enum { N = 9000, ROW = 12 + 16 + 12 + 4 + 12 + 8 };
    static const char *const name[] = {"POSITION",
                                       "KHR_gaussian_splatting:ROTATION",
                                       "KHR_gaussian_splatting:SCALE",
                                       "KHR_gaussian_splatting:OPACITY",
                                       "KHR_gaussian_splatting:SH_DEGREE_0_COEF_0",
                                       "COLOR_0"};
    static const bool own[3][6] = {{1, 1, 1, 1, 1, 1}, {1, 0, 0, 0, 0, 0}, {0, 0, 0, 1, 0, 1}};
    struct spin_export_job job = {.output = in_folder("shared.glb"), .n_frames = 3};
    struct spin_splats s = {0};
    struct glb g;
    void *self = NULL;
    const float *place, *opacity;
    int good = spin_exporter_gltf.begin(&job, &self) == SPIN_OK;

    for (int f = 0; f < 3; f++) {
        struct spin_frame_info info = {.number = f, .time = f};

        make_frame(&s, N, 0, 1);
        for (size_t i = 0; i < N && f == 1; i++)
            s.means[3 * i] += 1;
        if (f == 2)
            s.logit_opacities[N - 1] += 0.5f;
        good &= spin_exporter_gltf.frame(self, f, &info, &s) == SPIN_OK;
    }
    ok(good && spin_exporter_gltf.end(self) == SPIN_OK && open_glb(job.output, &g),
       "three frames that have much in common");
    for (int a = 0; a < 6; a++)
        for (int f = 1; f < 3; f++)
            good &= own[f][a] == (accessor_of(&g, f, name[a]) != accessor_of(&g, 0, name[a]));
    ok(good, "share the accessors of that");
    ok(g.n_bytes > N * (ROW + 12 + 4 + 8) && g.n_bytes < N * (ROW + 12 + 4 + 8) + 256,
       "which lie in the file once: %zu bytes", g.n_bytes);
    place = floats(&g, 1, name[0], 3, N);
    opacity = floats(&g, 2, name[3], 1, N);
    ok(place && floats(&g, 0, name[0], 3, N)[3] - place[3] == 1 && opacity &&
           opacity[N - 1] > floats(&g, 1, name[3], 1, N)[N - 1] &&
           opacity[0] == floats(&g, 1, name[3], 1, N)[0],
       "and what is not the same is each frame's own");
    close_glb(&g);
    spin_splats_free(&s);
}

static void test_clip_edges(void)
{
    struct spin_export_job job = {.output = in_folder("one.glb"), .n_frames = 1};
    struct spin_splats s = {0};
    struct glb g;
    void *self = NULL;
    char **names = NULL;
    size_t n = 0;

    make_frame(&s, 14, 1, 2);
    s.logit_opacities[1] = INFINITY;
    ok(run(&spin_exporter_gltf, &job, &s, 0) == SPIN_OK && open_glb(job.output, &g),
       "a clip of one frame");
    ok(!spin_json_get(g.json, "animations") && floats(&g, 0, "POSITION", 3, 14), "is not animated");
    close_glb(&g);
    make_frame(&s, 0, 1, 2);
    job.output = in_folder("none.glb");
    ok(run(&spin_exporter_gltf, &job, &s, 0) == SPIN_OK && open_glb(job.output, &g) &&
           g.n_bytes == 0 && !spin_json_get(g.json, "buffers") && !spin_json_get(g.json, "meshes"),
       "an empty frame has neither mesh nor buffer");
    close_glb(&g);
    ok(spin_folder_make(in_folder("gone")) == SPIN_OK, "makes a folder");
    job.output = in_folder("gone/clip.glb");
    ok(spin_exporter_gltf.begin(&job, &self) == SPIN_OK, "begins a file in it");
    spin_exporter_gltf.abort(self);
    ok(spin_folder_list(in_folder("gone"), &names, &n) == SPIN_OK && n == 0,
       "an abort leaves nothing");
    spin_folder_list_free(names);
    spin_splats_free(&s);
}

static char warned[2][400];
static int n_warned;

static bool keep_warning(const char *line)
{
    snprintf(warned[n_warned++ % 2], sizeof *warned, "%s", line);
    return false;
}

/* Larger than a .glb may be: reported after the first frame, once. */
static void test_too_large(void)
{
    struct spin_export_job one = {.output = in_folder("size.glb"), .n_frames = 1};
    struct spin_export_job job = {.output = in_folder("large.glb"), .n_frames = 4000};
    struct spin_frame_info info = {.number = 3};
    struct spin_splats s = {0};
    struct spin_map map;
    void *self = NULL;
    char want[400];

    make_frame(&s, 20000, 0, 5);
    info.n = s.n;
    ok(run(&spin_exporter_gltf, &one, &s, 0) == SPIN_OK &&
           spin_map_open(one.output, &map) == SPIN_OK,
       "a frame by itself");
    snprintf(
        want, sizeof want,
        "4000 frames as large as the first need up to %.1f GB, but a .glb cannot exceed 4.3 GB: "
        "reduce the clip with --range, --sh or --min-opacity, or write a folder",
        4000 * (double)map.size / 1e9);
    spin_map_close(&map);
    spin_log_set_level(-1);
    spin_log_set_sink(keep_warning);
    spin_frames_log_size(one.output, 1, UINT64_MAX, true);
    ok(n_warned == 0, "what may be less than the disk has room for is no warning");
    spin_frames_log_size(one.output, 1, UINT64_MAX, false);
    ok(n_warned == 1 && strstr(warned[0], " has only "), "what will be more is one");
    n_warned = 0;
    ok(spin_exporter_gltf.begin(&job, &self) == SPIN_OK &&
           spin_exporter_gltf.frame(self, 0, &info, &s) == SPIN_OK,
       "begins a clip of many");
    s.means[0] += 1;
    info.number++;
    ok(spin_exporter_gltf.frame(self, 1, &info, &s) == SPIN_OK, "a second frame");
    spin_exporter_gltf.abort(self);
    spin_log_set_sink(NULL);
    spin_log_set_level(-2);
    ok(n_warned == 1, "one warning: %d", n_warned);
    is_text(warned[0], want, "says how large it may be");
    spin_splats_free(&s);
}

/* Every number with its maximal length: the reserve for the JSON must hold them. */
static void test_room(void)
{
    enum { FRAMES = 50 };
    static struct spin_glb_column column[(FRAMES + 1) * SPIN_GLB_MAX_ATTRIBUTES];
    static struct spin_glb_frame frame[FRAMES];
    struct spin_out out;
    struct spin_glb_clip clip = {
        .out = &out,
        .axes = "glTF, from x right, y down, z forward",
        .source = "\1\1\1\1\1\1\1\1\1\1\1\1\1\1\1\1\1\1\1\1\1\1\1\1\1\1\1\1\1\1\1",
        .fps = 1.0 / 3,
        .n_frames = FRAMES,
        .frame = frame,
        .still = frame,
        .animated = true};
    size_t n;
    int good = 1;

    for (clip.sh_degree = 0; clip.sh_degree <= 3; clip.sh_degree++) {
        spin_glb_begin(&clip);
        n = (size_t)clip.n_attributes;
        for (int f = 0; f < FRAMES; f++) {
            frame[f] = (struct spin_glb_frame){
                .n = 1, .number = -2147483647, .time = -1.2345678901234567e-300 / (f + 3)};
            for (size_t a = 0; a < n; a++)
                frame[f].column[a] = 4123456789u;
        }
        clip.column = column;
        clip.n_columns = n * (FRAMES + 1);
        for (size_t i = 0; i < clip.n_columns; i++) {
            const float far = -1.2345678e-38f / (float)(i + 3);

            column[i] = (struct spin_glb_column){.attribute = (int)(i % n),
                                                 .n = 4123456789u,
                                                 .offset = 4123456789u,
                                                 .low = {far, far, far},
                                                 .high = {far, far, far}};
        }
        clip.n_bytes = 4000000000u;
        good &= spin_out_open(in_folder("room.glb"), true, &out) == SPIN_OK;
        good &= spin_glb_failed(&clip, spin_glb_put(&clip, 4200000000u, "", 200000000)) ==
                    SPIN_E_UNSUPPORTED &&
                strstr(spin_last_error(), "4 GiB");
        good &= spin_glb_end(&clip) == SPIN_OK;
        good &= spin_out_commit(&out) == SPIN_OK;
    }
    ok(good, "the longest JSON fits; a place beyond 4 GiB is refused: %s", spin_last_error());
}

TAP_MAIN
{
    static const char *const bad[][2] = {
        {"axes", "rub"}, {"fps", "0"}, {"fps", "x"}, {"sh", "5"}, {"pattern", "%x"}};

    spin_log_set_level(-2);
    test_values(0, "keep", 0, "gltf");
    test_values(3, "keep", 3, "gltf");
    test_values(3, "1", 1, "source");
    test_values(1, "2", 2, "gltf");
    test_clip();
    test_shared_attributes();
    test_clip_edges();
    test_too_large();
    test_room();
    check_folder_rules(&spin_exporter_gltf, "frame_00001.glb", bad, sizeof bad / sizeof bad[0]);
}
