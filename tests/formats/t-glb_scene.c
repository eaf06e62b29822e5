/* Scenes of GLB: component types, nodes, clips that an animation switches, SPZ inside, and
 * malformed documents.
 * K: gltf glb formats */
#include "tests/formats/glb_files.h"
#include "tests/formats/spz_files.h"

#define E SPIN_GLB_SPLATS

static spin_status read_scene(const unsigned char *bytes, size_t n, struct spin_splats *out)
{
    struct spin_gs_glb_scene scene = {0};
    spin_status status = spin_gs_glb_scene_open(bytes, n, &scene);

    for (size_t f = 0; status == SPIN_OK && f < scene.n_frames; f++)
        status = spin_gs_glb_scene_read(&scene, f, ALL, out);
    spin_gs_glb_scene_close(&scene);
    return status;
}

/* ---- Two splats in every type ------------------------------------------------------------------
 */

/* Each attribute in each type that it may have, one accessor and view each, in this order. */
static const struct {
    const char *name, *type;
    int component, normalised, stride;
    double row[2][4];
} numbers[] = {
    {"POSITION", "VEC3", 5126, 0, 12, {{1, 2, 3}, {-4, 5, 6.5}}},
    {"ROTATION", "VEC4", 5126, 0, 16, {{0, 0, 0, 1}, {0.5, -0.5, 0.5, 0.5}}},
    {"SCALE", "VEC3", 5126, 0, 12, {{1, 0.5, 0.25}, {2, 1, 1}}},
    {"OPACITY", "SCALAR", 5126, 0, 4, {{0.5}, {0.25}}},
    {"SH_DEGREE_0_COEF_0", "VEC3", 5126, 0, 12, {{0.1, 0.2, 0.3}, {-1, 0, 1}}},
    {"SH_DEGREE_1_COEF_0", "VEC3", 5126, 0, 12, {{1, 2, 3}, {4, 5, 6}}},
    {"SH_DEGREE_1_COEF_1", "VEC3", 5126, 0, 12, {{0.1, 0.2, 0.3}, {0.4, 0.5, 0.6}}},
    {"SH_DEGREE_1_COEF_2", "VEC3", 5126, 0, 12, {{-7, 8, 9}, {10, 11, 12}}},
    {"POSITION", "VEC3", 5120, 0, 4, {{1, 2, 3}, {-4, 5, -128}}}, /* 8 */
    {"POSITION", "VEC3", 5121, 0, 4, {{1, 2, 3}, {4, 5, 255}}},
    {"POSITION", "VEC3", 5122, 0, 8, {{1, 2, 3}, {-4, 5, -32768}}},
    {"POSITION", "VEC3", 5123, 0, 8, {{1, 2, 3}, {4, 5, 65535}}},
    {"POSITION", "VEC3", 5120, 1, 4, {{127, -127, 0}, {-128, 63, 1}}}, /* 12 */
    {"POSITION", "VEC3", 5121, 1, 4, {{255, 0, 51}, {1, 2, 3}}},
    {"POSITION", "VEC3", 5122, 1, 8, {{32767, -32767, 0}, {-32768, 1, 2}}},
    {"POSITION", "VEC3", 5123, 1, 8, {{65535, 0, 13107}, {1, 2, 3}}},
    {"ROTATION", "VEC4", 5120, 1, 4, {{0, 0, 0, 127}, {64, -64, 64, 64}}}, /* 16 */
    {"ROTATION", "VEC4", 5122, 1, 8, {{0, 0, 0, 32767}, {16384, -16384, 16384, 16384}}},
    {"SCALE", "VEC3", 5121, 0, 4, {{1, 2, 3}, {4, 5, 255}}}, /* 18 */
    {"SCALE", "VEC3", 5123, 0, 8, {{1, 2, 3}, {4, 5, 65535}}},
    {"SCALE", "VEC3", 5121, 1, 4, {{51, 102, 255}, {1, 2, 3}}},
    {"SCALE", "VEC3", 5123, 1, 8, {{13107, 2, 65535}, {1, 2, 3}}},
    {"OPACITY", "SCALAR", 5121, 1, 4, {{51}, {204}}}, /* 22 */
    {"OPACITY", "SCALAR", 5123, 1, 4, {{13107}, {52428}}},
    {"OPACITY", "SCALAR", 5121, 0, 4, {{1}, {0}}}, /* 24: the rest is not allowed */
    {"ROTATION", "VEC4", 5121, 1, 4, {{0}, {0}}},
    {"SCALE", "VEC3", 5120, 1, 4, {{1, 1, 1}, {1, 1, 1}}},
    {"SH_DEGREE_0_COEF_0", "VEC3", 5121, 1, 4, {{0}, {0}}},
};
enum { N_NUMBERS = sizeof numbers / sizeof *numbers, SH_1 = 5, ROOM = 1 << 16 };

static double width_of(int i) { return numbers[i].type[0] == 'S' ? 1 : numbers[i].type[3] - '0'; }

/* What a reader must make of component k. */
static double value_of(int i, int row, int k)
{
    static const double largest[] = {127, 255, 32767, 65535};
    double x = numbers[i].row[row][k];

    return numbers[i].normalised ? fmax(x / largest[numbers[i].component - 5120], -1) : x;
}

static unsigned char chunk[ROOM];
static char views[ROOM], accessors[ROOM]; /* of the document */
static size_t n_chunk;
static int n_views;

static void add_view(const void *bytes, size_t n, int stride)
{
    size_t used = strlen(views);
    char with[40] = "";

    if (stride)
        snprintf(with, sizeof with, ",\"byteStride\":%d", stride);
    snprintf(views + used, ROOM - used, "%s{\"buffer\":0,\"byteOffset\":%zu,\"byteLength\":%zu%s}",
             used ? "," : "", n_chunk, n, with);
    memcpy(chunk + n_chunk, bytes, n);
    n_chunk += (n + 3) / 4 * 4;
    n_views++;
}

/* The view added last as an accessor; returns its index. */
static int add_accessor(const char *type, int component, int normalised, int count)
{
    static int n;
    size_t used = strlen(accessors);

    snprintf(
        accessors + used, ROOM - used,
        "%s{\"bufferView\":%d,\"componentType\":%d,\"normalized\":%s,\"count\":%d,\"type\":\"%s\"}",
        used ? "," : "", n_views - 1, component, normalised ? "true" : "false", count, type);
    return n++;
}

static void store_component(unsigned char *at, int component, double value)
{
    float f = (float)value;
    int64_t whole = (int64_t)value;

    if (component == 5126) {
        memcpy(at, &f, sizeof f);
        spin_little_endian(at, 1);
        return;
    }
    at[0] = (unsigned char)whole;
    if (component >= 5122)
        at[1] = (unsigned char)(whole >> 8);
}

static void make_numbers(void)
{
    for (int i = 0; i < N_NUMBERS; i++) {
        unsigned char bytes[32] = {0};
        int size = numbers[i].component == 5126 ? 4 : numbers[i].component >= 5122 ? 2 : 1;

        for (int row = 0; row < 2; row++)
            for (int k = 0; k < (int)width_of(i); k++)
                store_component(bytes + row * numbers[i].stride + k * size, numbers[i].component,
                                numbers[i].row[row][k]);
        add_view(bytes, 2 * (size_t)numbers[i].stride, numbers[i].stride);
        add_accessor(numbers[i].type, numbers[i].component, numbers[i].normalised, 2);
    }
}

/* A mesh primitive of these accessors; `more` goes into its extension. */
static const char *primitive_of(int place, int rotation, int scale, int opacity, int dc, int degree,
                                const char *more)
{
    static char text[2048];
    size_t used = (size_t)snprintf(
        text, sizeof text,
        "{\"mode\":0,\"extensions\":{\"" E "\":{%s}},\"attributes\":{\"POSITION\":%d,\"" E
        ":ROTATION\":%d,\"" E ":SCALE\":%d,\"" E ":OPACITY\":%d,\"" E ":SH_DEGREE_0_COEF_0\":%d",
        more, place, rotation, scale, opacity, dc);

    for (int m = 0; m < 3 && degree > 0; m++)
        used += (size_t)snprintf(text + used, sizeof text - used,
                                 ",\"" E ":SH_DEGREE_1_COEF_%d\":%d", m, SH_1 + m);
    snprintf(text + used, sizeof text - used, "}}");
    return text;
}

static const char *plain(void) { return primitive_of(0, 1, 2, 3, 4, 1, ""); }

/* A file of one mesh of these primitives; `rest` are nodes and whatever else. */
static unsigned char *make_scene(const char *primitives, const char *rest, size_t *size)
{
    size_t room = 2 * ROOM + strlen(primitives) + strlen(rest) + 1000;
    char *json = malloc(room);
    unsigned char *file;

    snprintf(json, room,
             "{\"meshes\":[{\"primitives\":[%s]}],\"buffers\":[{\"byteLength\":%zu}],"
             "\"bufferViews\":[%s],\"accessors\":[%s],%s}",
             primitives, n_chunk, views, accessors, rest);
    file = make_glb(json, chunk, n_chunk, size);
    free(json);
    return file;
}

/* Opens; the file is kept until the next one. */
static spin_status open_scene(const char *primitives, const char *rest,
                              struct spin_gs_glb_scene *out)
{
    static unsigned char *file;
    size_t size;

    spin_gs_glb_scene_close(out);
    free(file);
    file = make_scene(primitives, rest, &size);
    return spin_gs_glb_scene_open(file, size, out);
}

static void is_refused(const char *primitives, const char *rest, const char *word, const char *what)
{
    struct spin_gs_glb_scene scene = {0};
    struct spin_splats s = {0};
    spin_status status = open_scene(primitives, rest, &scene);

    if (status == SPIN_OK)
        status = spin_gs_glb_scene_read(&scene, 0, ALL, &s);
    if (!ok(status != SPIN_OK && strstr(spin_last_error(), word), "%s", what))
        printf("#   status %d, %s\n", status, status == SPIN_OK ? "" : spin_last_error());
    spin_gs_glb_scene_close(&scene);
    spin_splats_free(&s);
}

static void test_types(void)
{
    struct spin_gs_glb_scene scene = {0};
    struct spin_splats s = {0};

    for (int i = 0; i < 24; i++) {
        bool place = strcmp(numbers[i].name, "POSITION") == 0, turn = numbers[i].name[0] == 'R';
        bool scale = strcmp(numbers[i].name, "SCALE") == 0, alpha = numbers[i].name[0] == 'O';
        double worst = 0;

        if (!place && !turn && !scale && !alpha)
            continue;
        if (!ok(open_scene(primitive_of(place ? i : 0, turn ? i : 1, scale ? i : 2, alpha ? i : 3,
                                        4, 0, ""),
                           "\"nodes\":[{\"mesh\":0}]", &scene) == SPIN_OK &&
                    spin_gs_glb_scene_read(&scene, 0, ALL, &s) == SPIN_OK && s.n == 2,
                "%s of type %d%s", numbers[i].name, numbers[i].component,
                numbers[i].normalised ? " normalised" : ""))
            printf("#   %s\n", spin_last_error());
        for (int row = 0; row < 2; row++) {
            double norm = 0;

            for (int k = 0; k < 4; k++)
                norm += turn ? pow(value_of(i, row, k), 2) : 0;
            for (int k = 0; k < (int)width_of(i); k++) {
                double want = value_of(i, row, k);
                double got = place   ? s.means[3 * row + k]
                             : turn  ? s.quats[4 * row + (k + 1) % 4] * sqrt(norm)
                             : scale ? exp((double)s.log_scales[3 * row + k])
                                     : 1 / (1 + exp(-(double)s.logit_opacities[row]));

                worst = larger(worst, fabs(got - want) / fmax(fabs(want), 1));
            }
        }
        ok(worst < 1e-6, "is what the specification says, to %g", worst);
    }
    spin_gs_glb_scene_close(&scene);
    spin_splats_free(&s);
    is_refused(primitive_of(0, 1, 2, 24, 4, 0, ""), "\"nodes\":[{\"mesh\":0}]", ":OPACITY",
               "opacities that are whole numbers");
    is_refused(primitive_of(0, 25, 2, 3, 4, 0, ""), "\"nodes\":[{\"mesh\":0}]", ":ROTATION",
               "rotations without signs");
    is_refused(primitive_of(0, 1, 26, 3, 4, 0, ""), "\"nodes\":[{\"mesh\":0}]", ":SCALE",
               "scales with signs");
    is_refused(primitive_of(0, 1, 2, 3, 27, 0, ""), "\"nodes\":[{\"mesh\":0}]", ":SH_DEGREE_0",
               "SH that are no floats");
    is_refused(primitive_of(0, 1, 2, 1, 4, 0, ""), "\"nodes\":[{\"mesh\":0}]", ":OPACITY",
               "opacities of four numbers");
    is_refused(primitive_of(0, 1, 7, 3, 4, 0, ""), "\"nodes\":[{\"mesh\":0}]",
               "'SCALE' is -7 in row 0", "a negative scale");
}

/* ---- Nodes -------------------------------------------------------------------------------------
 */

/* A child moved by (1, 0, 0) in a parent that is turned a quarter about z, doubled and moved: x y z
 * becomes 1 - 2 y, 2 + 2 (x + 1), 3 + 2 z. */
static void check_turned(const char *rest, const char *what)
{
    struct spin_gs_glb_scene scene = {0};
    struct spin_splats s = {0};
    const double half = sqrt(0.5);
    double worst = 0;

    if (!ok(open_scene(plain(), rest, &scene) == SPIN_OK &&
                spin_gs_glb_scene_read(&scene, 0, ALL, &s) == SPIN_OK && s.n == 2,
            "%s", what))
        printf("#   %s\n", spin_last_error());
    for (size_t i = 0; i < s.n; i++) {
        const double *p = numbers[0].row[i], *r = numbers[1].row[i], *c = numbers[2].row[i];
        const double place[3] = {1 - 2 * p[1], 2 + 2 * (p[0] + 1), 3 + 2 * p[2]};
        /* (half, 0, 0, half) times (w, x, y, z) */
        const double q[4] = {half * (r[3] - r[2]), half * (r[0] - r[1]), half * (r[1] + r[0]),
                             half * (r[2] + r[3])};

        for (size_t k = 0; k < 3; k++) {
            worst = larger(worst, fabs(s.means[3 * i + k] - place[k]));
            worst = larger(worst, fabs(s.log_scales[3 * i + k] - log(2 * c[k])));
            worst = larger(worst, fabs(s.sh[12 * i + k] - numbers[4].row[i][k]));
            /* what was seen along x is seen along y, and what was along y along -x */
            worst = larger(worst, fabs(s.sh[12 * i + 3 + k] - numbers[7].row[i][k]));
            worst = larger(worst, fabs(s.sh[12 * i + 6 + k] - numbers[6].row[i][k]));
            worst = larger(worst, fabs(s.sh[12 * i + 9 + k] + numbers[5].row[i][k]));
        }
        for (size_t k = 0; k < 4; k++)
            worst = larger(worst, fabs(s.quats[4 * i + k] - q[k]));
    }
    ok(worst < 1e-5, "places, rotations, scales and SH are those of the scene, to %g", worst);
    spin_gs_glb_scene_close(&scene);
    spin_splats_free(&s);
}

static size_t count_of(const char *rest)
{
    struct spin_gs_glb_scene scene = {0};
    size_t n = open_scene(plain(), rest, &scene) == SPIN_OK ? scene.frame[0].n : 0;

    spin_gs_glb_scene_close(&scene);
    return n;
}

/* A frame without splats is a file without meshes. */
static void test_no_splats(void)
{
    struct spin_gs_glb_scene scene = {0};
    struct spin_splats s = {0};
    size_t size;
    unsigned char *file =
        make_glb("{\"nodes\":[{\"extras\":{\"frame\":7}}]}", (const unsigned char *)"", 0, &size);

    ok(spin_gs_glb_scene_open(file, size, &scene) == SPIN_OK && scene.n_frames == 1 &&
           scene.frame[0].number == 7 && spin_gs_glb_scene_read(&scene, 0, ALL, &s) == SPIN_OK &&
           s.n == 0,
       "a file without meshes is a frame of no splats: %s", spin_last_error());
    spin_gs_glb_scene_close(&scene);
    spin_splats_free(&s);
    free(file);
}

static void test_nodes(void)
{
    static const char child[] = "{\"mesh\":0,\"translation\":[1,0,0]}";
    char text[40000] = "\"nodes\":[{\"children\":[1]";
    size_t used;

    snprintf(text, sizeof text,
             "\"nodes\":[{\"children\":[1],\"translation\":[1,2,3],\"scale\":[2,2,2],"
             "\"rotation\":[0,0,0.70710678118654752,0.70710678118654752]},%s]",
             child);
    check_turned(text, "a node in a node");
    snprintf(text, sizeof text,
             "\"nodes\":[{\"children\":[1],\"matrix\":[0,2,0,0,-2,0,0,0,0,0,2,0,1,2,3,1]},%s]",
             child);
    check_turned(text, "the same as a matrix");
    ok(count_of("\"nodes\":[{\"mesh\":0},{\"mesh\":0,\"translation\":[9,0,0]}]") == 4,
       "two nodes of one mesh");
    ok(count_of("\"scene\":1,\"scenes\":[{\"nodes\":[0,1]},{\"nodes\":[1]}],"
                "\"nodes\":[{\"mesh\":0},{\"mesh\":0}]") == 2,
       "of the scene that is shown");
    ok(count_of(
           "\"nodes\":[{\"mesh\":0},{\"mesh\":0,\"scale\":[0,0,0]},{\"mesh\":0,\"extensions\":{"
           "\"KHR_node_visibility\":{\"visible\":false}}}]") == 2,
       "without those that are hidden");
    ok(count_of("\"nodes\":[{\"mesh\":0},{\"children\":[2],\"extensions\":{"
                "\"KHR_node_visibility\":{\"visible\":false}}},{\"mesh\":0}]") == 2,
       "or hang from one that is");
    is_refused(plain(), "\"nodes\":[{\"mesh\":0,\"scale\":[1,2,1]}]", "scale is 1, 2, 1",
               "different scales along the axes");
    is_refused(plain(), "\"nodes\":[{\"mesh\":0,\"scale\":[-1,1,1]}]", "scale is -1, 1, 1",
               "a mirror");
    is_refused(plain(), "\"nodes\":[{\"mesh\":0,\"matrix\":[-1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1]}]",
               "not a rotation", "a mirror as a matrix");
    is_refused(plain(), "\"nodes\":[{\"mesh\":0,\"matrix\":[1,0,0,0,1,0,0,0,0,0,1,0,0,0,0,1]}]",
               "not a rotation", "a flat matrix");
    is_refused(plain(), "\"nodes\":[{\"mesh\":0,\"matrix\":[1,0,0]}]", "16 numbers",
               "a short matrix");
    is_refused(plain(), "\"nodes\":[{\"mesh\":0,\"translation\":[1e300,0,0]}]", "3 numbers",
               "a place that is far away");
    is_refused(plain(), "\"nodes\":[{\"mesh\":0,\"rotation\":[0,0,0,0]}]",
               "'rotation' is a quaternion of length 0", "a rotation of no length");
    is_refused(plain(), "\"nodes\":[{\"mesh\":0,\"children\":[1]},{\"children\":[0]}]",
               "form a cycle", "nodes in a circle");
    is_refused(plain(), "\"nodes\":[{\"mesh\":0},{\"children\":[0]},{\"children\":[0]}]",
               "two parents", "a node with two parents");
    is_refused(plain(), "\"nodes\":[{\"mesh\":0,\"children\":[7]}]", "children",
               "a child that is not there");
    is_refused(plain(), "\"scenes\":[{\"nodes\":[3]}],\"nodes\":[{\"mesh\":0}]", "does not exist",
               "a scene of a node that is not there");
    is_refused(plain(), "\"nodes\":[{\"mesh\":0,\"scale\":[0,0,0]}]", "no visible splats",
               "a scene that shows nothing");
    is_refused(plain(), "\"nodes\":[{}]", "no visible splats", "no mesh");
    used = (size_t)snprintf(text, sizeof text, "\"nodes\":[{\"mesh\":0}");
    for (int i = 0; i < 900; i++) /* 1802 splats in some 1200 bytes */
        used += (size_t)snprintf(text + used, sizeof text - used, ",{\"mesh\":0}");
    snprintf(text + used, sizeof text - used, "]");
    is_refused(plain(), text, "1802 splats, too many for a file", "hundreds of nodes of one mesh");
}

/* ---- Clips -------------------------------------------------------------------------------------
 */

static int time_accessor, decreasing, scale_accessor[3], visible_accessor[3], sizes_accessor;

/* Node 0 is on at first, node 1 from 0.5 on, node 2 from 1 to the last key. */
static void make_keys(void)
{
    static const float times[4] = {0, 0.5f, 1, 1.5f}, back[4] = {0, 1, 0.5f, 2};
    static const float sizes[12] = {1, 1, 1, 2, 2, 2, 0, 0, 0, 0, 0, 0};

    add_view(times, sizeof times, 0);
    time_accessor = add_accessor("SCALAR", 5126, 0, 4);
    add_view(back, sizeof back, 0);
    decreasing = add_accessor("SCALAR", 5126, 0, 4);
    add_view(sizes, sizeof sizes, 0);
    sizes_accessor = add_accessor("VEC3", 5126, 0, 4);
    for (int node = 0; node < 3; node++) {
        unsigned char visible[4];
        float scale[12];

        for (int key = 0; key < 4; key++) {
            visible[key] = key == node || (node == 2 && key == 3);
            for (int c = 0; c < 3; c++)
                scale[3 * key + c] = 0.5f * visible[key];
        }
        add_view(scale, sizeof scale, 0);
        scale_accessor[node] = add_accessor("VEC3", 5126, 0, 4);
        add_view(visible, sizeof visible, 0);
        visible_accessor[node] = add_accessor("SCALAR", 5121, 0, 4);
    }
}

/* Nodes 0 and 2 with the mesh, 1 without; `channels` and `samplers` of their animation. */
static const char *clip_of(const char *channels, const char *samplers)
{
    static char text[8192];

    snprintf(text, sizeof text,
             "\"nodes\":[{\"mesh\":0,\"extras\":{\"frame\":4,\"time\":0.25},\"scale\":[9,9,9]},"
             "{\"extras\":{\"frame\":5,\"time\":0.75},\"scale\":[0,0,0]},"
             "{\"mesh\":0,\"translation\":[10,0,0],\"extras\":{\"frame\":6,\"time\":1.25},"
             "\"scale\":[0,0,0]}],\"animations\":[{\"channels\":[%s],\"samplers\":[%s]}]",
             channels, samplers);
    return text;
}

static const char *sampler_of(int input, int output, const char *interpolation)
{
    static char text[8][128];
    static int n;
    char *to = text[n++ % 8];

    snprintf(to, sizeof *text, "{\"input\":%d,\"output\":%d,\"interpolation\":\"%s\"}", input,
             output, interpolation);
    return to;
}

static const char *scale_clip(void)
{
    char samplers[1000];

    snprintf(samplers, sizeof samplers, "%s,%s,%s",
             sampler_of(time_accessor, scale_accessor[0], "STEP"),
             sampler_of(time_accessor, scale_accessor[1], "STEP"),
             sampler_of(time_accessor, scale_accessor[2], "STEP"));
    return clip_of("{\"sampler\":0,\"target\":{\"node\":0,\"path\":\"scale\"}},"
                   "{\"sampler\":1,\"target\":{\"node\":1,\"path\":\"scale\"}},"
                   "{\"sampler\":2,\"target\":{\"node\":2,\"path\":\"scale\"}}",
                   samplers);
}

static void check_clip(const char *rest, double scale, const char *what)
{
    struct spin_gs_glb_scene scene = {0};
    struct spin_splats s = {0};

    if (!ok(open_scene(plain(), rest, &scene) == SPIN_OK && scene.n_frames == 3 && !scene.moves,
            "%s: three frames", what)) {
        printf("#   %s\n", spin_last_error());
        spin_gs_glb_scene_close(&scene);
        return;
    }
    ok(scene.frame[0].n == 2 && scene.frame[1].n == 0 && scene.frame[2].n == 2,
       "%s: the second is empty", what);
    ok(scene.frame[0].number == 4 && scene.frame[2].number == 6 && scene.frame[1].time == 0.75,
       "%s: numbers and times of the nodes", what);
    ok(spin_gs_glb_scene_read(&scene, 2, ALL, &s) == SPIN_OK && s.n == 2, "%s: is read", what);
    near(s.means[0], 10 + scale * 1, 1e-6, "the third is its own node's, as large as it is shown");
    near(s.log_scales[0], log(scale * 1), 1e-6, "and so are its splats");
    ok(spin_gs_glb_scene_read(&scene, 1, ALL, &s) == SPIN_OK && s.n == 0, "%s: nothing", what);
    spin_gs_glb_scene_close(&scene);
    spin_splats_free(&s);
}

static void test_clips(void)
{
    struct spin_gs_glb_scene scene = {0};
    char channels[2000], samplers[1000];
    size_t used = 0, size;
    unsigned char *file;

    check_clip(scale_clip(), 0.5, "by scale");
    file = make_scene(plain(), scale_clip(), &size);
    check_hostile(read_scene, file, size, 0);
    free(file);
    for (int node = 0; node < 3; node++)
        used +=
            (size_t)snprintf(channels + used, sizeof channels - used,
                             "%s{\"sampler\":%d,\"target\":{\"path\":\"pointer\",\"extensions\":{"
                             "\"KHR_animation_pointer\":{\"pointer\":\"/nodes/%d/extensions/"
                             "KHR_node_visibility/visible\"}}}}",
                             node ? "," : "", node, node);
    snprintf(samplers, sizeof samplers, "%s,%s,%s",
             sampler_of(time_accessor, visible_accessor[0], "STEP"),
             sampler_of(time_accessor, visible_accessor[1], "STEP"),
             sampler_of(time_accessor, visible_accessor[2], "STEP"));
    { /* without extras: keys' times, no numbers */
        char text[9000];

        snprintf(text, sizeof text, "%s", scale_clip());
        for (char *at; (at = strstr(text, "extras"));)
            memcpy(at, "ignore", 6);
        ok(open_scene(plain(), text, &scene) == SPIN_OK && scene.n_frames == 3 &&
               scene.frame[0].time == 0 && scene.frame[1].time == 0.5 && scene.frame[2].time == 1 &&
               scene.frame[0].number == -1,
           "frames begin at their keys");
        snprintf(text, sizeof text, "%s", scale_clip());
        memcpy(strstr(text, "\"time\":0.75"), "\"tome\":0.75", 11);
        ok(open_scene(plain(), text, &scene) == SPIN_OK && scene.n_frames == 3 &&
               scene.frame[0].time == 0 && scene.frame[1].time == 0.5 && scene.frame[1].number == 5,
           "and so they do where the time of one is not known otherwise");
    }
    /* Here the nodes' own scales count: the third must have one. */
    {
        char text[9000], *at;

        snprintf(text, sizeof text, "%s", clip_of(channels, samplers));
        at = strstr(text, "1.25},\"scale\":[0,0,0]");
        memcpy(at + 6, "\"scale\":[3,3,3]", 15);
        check_clip(text, 3, "by visibility");
    }
    snprintf(samplers, sizeof samplers, "%s",
             sampler_of(time_accessor, scale_accessor[0], "LINEAR"));
    ok(open_scene(plain(),
                  clip_of("{\"sampler\":0,\"target\":{\"node\":0,\"path\":\"scale\"}}", samplers),
                  &scene) == SPIN_OK &&
           scene.moves && scene.n_frames == 1 && scene.frame[0].n == 2,
       "what fades is one frame, and it is said");
    snprintf(samplers, sizeof samplers, "%s", sampler_of(time_accessor, scale_accessor[0], "STEP"));
    ok(open_scene(
           plain(),
           clip_of("{\"sampler\":0,\"target\":{\"node\":0,\"path\":\"translation\"}}", samplers),
           &scene) == SPIN_OK &&
           scene.moves && scene.n_frames == 1,
       "so is what moves");
    spin_gs_glb_scene_close(&scene);
    is_refused(plain(),
               clip_of("{\"sampler\":0,\"target\":{\"node\":0,\"path\":\"scale\"}},"
                       "{\"sampler\":0,\"target\":{\"node\":0,\"path\":\"scale\"}}",
                       samplers),
               "two channels animate it", "a node that is switched twice");
    is_refused(plain(),
               clip_of("{\"sampler\":0,\"target\":{\"node\":3,\"path\":\"scale\"}}", samplers),
               "does not exist", "a switched node that is not there");
    is_refused(plain(),
               clip_of("{\"sampler\":0,\"target\":{\"node\":0,\"path\":\"scale\"}}",
                       sampler_of(decreasing, scale_accessor[0], "STEP")),
               "do not increase", "times that go back");
    is_refused(plain(),
               clip_of("{\"sampler\":0,\"target\":{\"node\":0,\"path\":\"scale\"}}",
                       sampler_of(time_accessor, 0, "STEP")),
               "4 times, 'output' has 2 values", "keys without values");
    is_refused(plain(),
               clip_of("{\"sampler\":0,\"target\":{\"node\":0,\"path\":\"scale\"}}",
                       sampler_of(time_accessor, sizes_accessor, "STEP")),
               "from 1 to 2", "a node that is shown in two sizes");
    is_refused(plain(),
               clip_of("{\"sampler\":0,\"target\":{\"node\":0,\"path\":\"scale\"}}",
                       sampler_of(time_accessor, time_accessor, "STEP")),
               "channel 0", "values of another kind");
}

/* ---- What the extension says -------------------------------------------------------------------
 */

static void test_extension(void)
{
    static const char node[] = "\"nodes\":[{\"mesh\":0}]";
    struct spin_gs_glb_scene scene = {0};
    char text[4096];

    ok(open_scene(primitive_of(0, 1, 2, 3, 4, 0,
                               "\"kernel\":\"ellipse\",\"colorSpace\":\"lin_rec709_display\","
                               "\"projection\":\"perspective\",\"sortingMethod\":\"any\""),
                  node, &scene) == SPIN_OK &&
           scene.linear,
       "colours of linear light are told apart");
    snprintf(text, sizeof text, "%s,{\"mode\":4,\"attributes\":{\"POSITION\":0}}", plain());
    ok(open_scene(text, node, &scene) == SPIN_OK && scene.others && scene.frame[0].n == 2,
       "triangles beside splats are left out, and it is said");
    snprintf(text, sizeof text, "%s,", plain());
    snprintf(text + strlen(text), sizeof text - strlen(text), "%s",
             primitive_of(8, 1, 2, 3, 4, 0, ""));
    ok(open_scene(text, node, &scene) == SPIN_OK && scene.frame[0].n == 4 && scene.sh_degree == 1,
       "two primitives of one mesh");
    ok(open_scene(plain(),
                  "\"extensionsRequired\":[\"KHR_mesh_quantization\",\"KHR_materials_unlit\",\"" E
                  "\"],\"nodes\":[{\"mesh\":0}]",
                  &scene) == SPIN_OK,
       "extensions that are known");
    spin_gs_glb_scene_close(&scene);
    is_refused(plain(),
               "\"extensionsRequired\":[\"EXT_meshopt_compression\"],\"nodes\":[{\"mesh\":0}]",
               "EXT_meshopt_compression", "one that is not");
    is_refused(primitive_of(0, 1, 2, 3, 4, 0, "\"kernel\":\"disc\""), node, "'kernel' is 'disc'",
               "another kernel");
    is_refused(primitive_of(0, 1, 2, 3, 4, 0, "\"projection\":\"fisheye\""), node,
               "'projection' is 'fisheye'", "another projection");
    is_refused(primitive_of(0, 1, 2, 3, 4, 0, "\"colorSpace\":\"xyz\""), node,
               "'colorSpace' is 'xyz'", "other colours");
    is_refused("{\"mode\":4,\"extensions\":{\"" E "\":{}},\"attributes\":{\"POSITION\":0}}", node,
               "primitive is not points", "triangles that say they are splats");
    is_refused("{\"mode\":0,\"extensions\":{\"" E "\":{}},\"attributes\":{\"POSITION\":0}}", node,
               ":ROTATION", "points without rotations");
    is_refused("{\"mode\":0,\"extensions\":{\"" E "\":{}},\"attributes\":{}}", node, "'POSITION'",
               "points without places");
}

/* ---- SPZ inside --------------------------------------------------------------------------------
 */

static void test_spz(void)
{
    const struct spin_spz_header header = {
        .n = 2, .sh_degree = 1, .fraction = SPIN_SPZ_FRACTION, .version = 3};
    static const char node[] = "\"nodes\":[{\"mesh\":0,\"translation\":[0,0,5]}]";
    unsigned char bytes[16 + 2 * 29];
    struct spin_gs_glb_scene scene = {0};
    struct spin_splats is = {0}, s = {0};
    unsigned char *packed;
    size_t n_packed;
    uint32_t seed = 8;
    char more[200];
    int good = 1;

    spin_spz_code_header(&header, bytes);
    for (size_t i = 16; i < sizeof bytes; i++)
        bytes[i] = (unsigned char)draw(&seed, 0, 255.99f);
    packed = pack(bytes, sizeof bytes, &n_packed);
    if (spin_spz_read(packed, n_packed, ALL, &is) != SPIN_OK)
        exit(1);
    add_view(packed, n_packed, 0);
    snprintf(more, sizeof more, "\"extensions\":{\"" E "_compression_spz_2\":{\"bufferView\":%d}}",
             n_views - 1);
    /* The attributes only say how many there are; POSITION's accessor does. */
    if (!ok(open_scene(primitive_of(0, 90, 91, 92, 93, 0, more), node, &scene) == SPIN_OK &&
                spin_gs_glb_scene_read(&scene, 0, ALL, &s) == SPIN_OK && s.n == 2 &&
                s.sh_degree == 1,
            "an SPZ in place of attributes"))
        printf("#   %s\n", spin_last_error());
    /* From right, up, back to left, up, forward: half a turn about y. Of SH of degree 1, -y z -x, z
     * and x change sign. */
    for (size_t i = 0; i < s.n; i++) {
        const float *p = is.means + 3 * i, *q = is.quats + 4 * i;
        const float place[3] = {-p[0], p[1], 5 - p[2]}, turned[4] = {-q[2], q[3], q[0], -q[1]};
        double dot = 0;

        for (size_t k = 0; k < 3; k++) {
            good &= fabsf(s.means[3 * i + k] - place[k]) < 1e-5f;
            good &= s.log_scales[3 * i + k] == is.log_scales[3 * i + k];
            good &= s.sh[12 * i + k] == is.sh[12 * i + k];
            good &= s.sh[12 * i + 3 + k] == is.sh[12 * i + 3 + k];
            good &= s.sh[12 * i + 6 + k] == -is.sh[12 * i + 6 + k];
            good &= s.sh[12 * i + 9 + k] == -is.sh[12 * i + 9 + k];
        }
        for (size_t k = 0; k < 4; k++)
            dot += (double)s.quats[4 * i + k] * turned[k];
        good &= fabs(fabs(dot) - 1) < 1e-6;
        good &= s.logit_opacities[i] == is.logit_opacities[i];
    }
    ok(good, "turned from the axes of SPZ to those of glTF");
    spin_gs_glb_scene_close(&scene);
    is_refused(primitive_of(4, 90, 91, 92, 93, 0,
                            "\"extensions\":{\"" E "_compression_spz_2\":{\"bufferView\":0}}"),
               node, "gzip", "a view that is no SPZ");
    free(packed);
    spin_splats_free(&is);
    spin_splats_free(&s);
}

TAP_MAIN
{
    make_numbers();
    make_keys();
    test_types();
    test_nodes();
    test_no_splats();
    test_clips();
    test_extension();
    test_spz();
}
