/* usd: composition of layers, value clips, transforms, and malformed files. t-golden.c compares
 * the values.
 * K: usd usda usdz import */
#include "tests/importers/crates.h"
#include "tests/importers/slices.h"

#define HEAD "#usda 1.0\n(\n    defaultPrim = \"S\"\n)\n"
#define SPLATS "def ParticleField3DGaussianSplat \"S\" "
#define TWO                                                                                        \
    "    point3f[] positions = [(1, 2, 3), (4, 5, 6)]\n"                                           \
    "    quatf[] orientations = [(1, 0, 0, 0), (0, 0, 2, 0)]\n"                                    \
    "    float3[] scales = [(0.1, 0.2, 0.3), (0.1, 0.1, 0.1)]\n"                                   \
    "    float[] opacities = [0.5, 1]\n"                                                           \
    "    float3[] radiance:sphericalHarmonicsCoefficients = [(1, 2, 3), (-1, 0, 0.5)]\n"           \
    "    uniform int radiance:sphericalHarmonicsDegree = 0\n"

static const char *const as_is[] = {"axes", "source", NULL};

/* Writes a layer into a new folder and returns its path. */
static const char *layer(const char *text)
{
    const char *path = path_in(new_folder(), "s.usda");

    write_text(path, text);
    return path;
}

static bool opens(const char *path, const char *const *pairs, struct run *run)
{
    bool good =
        model_open(NULL, path, pairs, run) == SPIN_OK && !strcmp(run->importer->name, "usd");

    if (!good)
        printf("# %s\n", spin_last_error());
    return good;
}

/* Whether row `row` of a frame is at this position, to 1e-5. */
static bool is_at(struct run *run, int frame, size_t row, double x, double y, double z)
{
    struct spin_splats s = {0};
    const double want[3] = {x, y, z};
    bool good = run->self &&
                run->importer->frame(run->self, frame, 0, run->sequence.columns, &s) == SPIN_OK &&
                row < s.n;

    for (size_t c = 0; good && c < 3; c++)
        good = fabs((double)s.means[3 * row + c] - want[c]) < 1e-5;
    if (!good)
        printf("# %zu rows, %s\n", s.n, s.n > row ? "another place" : spin_last_error());
    for (size_t c = 0; !good && row < s.n && c < 3; c++)
        printf("#   %g\n", (double)s.means[3 * row + c]);
    spin_splats_free(&s);
    return good;
}

static void test_values(void)
{
    const char *path =
        layer(HEAD "# a comment\n" SPLATS "(\n    \"a ) in a doc\"\n)\n{\n" TWO "}\n");
    struct spin_splats s = {0};
    struct run run;

    if (ok(opens(path, NULL, &run) &&
               run.importer->frame(run.self, 0, 0, run.sequence.columns, &s) == SPIN_OK,
           "a layer opens")) {
        ok(s.n == 2 && s.means[0] == 1 && s.means[1] == -2 && s.means[2] == -3,
           "half a turn about x by default");
        ok(s.quats[0] == 0 && s.quats[1] == 1 && fabsf(s.quats[7]) == 1,
           "which also turns the splats, whose rotations are normalised");
        ok(fabs(exp((double)s.log_scales[1]) - 0.2) < 1e-7 && s.logit_opacities[0] == 0 &&
               s.logit_opacities[1] == 30 && s.sh_degree == 0 && s.sh[3] == -1,
           "scales, opacities and colours");
        ok(run.sequence.n_frames == 1 && !run.sequence.numbers && !*run.sequence.notes,
           "one frame, and nothing to note");
    }
    run_close(&run);
    spin_splats_free(&s);
    ok(opens(path, as_is, &run) && is_at(&run, 0, 1, 4, 5, 6), "--axes source");
    run_close(&run);
    path = with_line(path, "[0.5, 1]", "[0.5, # a ] and a \"\n1]");
    ok(opens(path, as_is, &run) && is_at(&run, 0, 1, 4, 5, 6), "a comment within brackets");
    run_close(&run);
    ok(opens(layer("#usda 1.0\n(\n    upAxis = \"Z\"\n)\n" SPLATS "{\n" TWO "}\n"), NULL, &run) &&
           is_at(&run, 0, 0, 1, -3, 2),
       "z up becomes y down");
    run_close(&run);
}

static void test_defaults(void)
{
    const char *path =
        layer("#usda 1.0\n(\n    metersPerUnit = 0.01\n)\n" SPLATS
              "(\n    apiSchemas = [\"ColorSpaceAPI\"]\n"
              ")\n{\n    point3h[] positionsh = [(1, 2, 3), (4, 5, 6)]\n"
              "    half3[] scalesh = [(0.1, 0.2, 0), (1, 1, 1)]\n"
              "    uniform token colorSpace:name = \"lin_rec709_scene\"\n"
              "    rel material:binding = </a>\n    float[] opacities.connect = </b.c>\n}\n"
              "def ParticleField_3DGaussianSplat \"Old\"\n{\n}\n"
              "class ParticleField3DGaussianSplat \"C\"\n{\n}\n"
              "def ParticleField3DGaussianSplat \"Off\" (\n    active = false\n)\n{\n}\n");
    struct spin_splats s = {0};
    struct run run;

    if (ok(opens(path, as_is, &run) &&
               run.importer->frame(run.self, 0, 0, run.sequence.columns, &s) == SPIN_OK,
           "half attributes and missing arrays")) {
        ok(s.n == 2 && s.means[2] == 3 && isfinite(s.log_scales[2]), "are read");
        for (size_t i = 0; i < s.n; i++)
            ok(s.quats[4 * i] == 1 && s.logit_opacities[i] == 30 && s.sh[3 * i] == 0,
               "have the schema's defaults; classes and prims that are not active are skipped");
        ok(strstr(run.sequence.notes, "linear light") && strstr(run.sequence.notes, "0.01 m") &&
               strstr(run.sequence.notes, "without opacities") &&
               strstr(run.sequence.notes, "without orientations") &&
               strstr(run.sequence.notes, "are grey") &&
               strstr(run.sequence.notes, "ParticleField_3DGaussianSplat are ignored"),
           "and notes");
    }
    run_close(&run);
    spin_splats_free(&s);
}

/* A reference, a payload and a sublayer; the stronger layer wins. */
static void test_layers(void)
{
    const char *folder = new_folder(), *path = path_in(folder, "s.usda");
    struct run run;

    write_text(path_in(folder, "a.usda"), HEAD SPLATS "{\n" TWO "}\n");
    write_text(path_in(folder, "sub.usda"),
               "#usda 1.0\nover \"World\"\n{\n    over \"B\"\n    {\n"
               "        point3f[] positions = [(7, 7, 7), (8, 8, 8)]\n    }\n}\n");
    write_text(path,
               "#usda 1.0\n(\n    subLayers = [@./sub.usda@]\n)\n"
               "def Xform \"World\"\n{\n"
               "    double3 xformOp:translate = (10, 0, 0)\n"
               "    float xformOp:rotateZ = 90\n    float3 xformOp:scale = (2, 2, 2)\n"
               "    uniform token[] xformOpOrder = [\"xformOp:translate\", \"xformOp:rotateZ\", "
               "\"xformOp:scale:unset\", \"xformOp:scale\"]\n"
               "    over \"A\" (\n        prepend references = @./a.usda@\n    )\n    {\n    }\n"
               "    def \"B\" (\n        payload = @a.usda@</S>\n    )\n    {\n    }\n"
               "    def \"M\" (\n        references = @mesh.obj@\n    )\n    {\n    }\n"
               "    def \"D\" (\n        delete references = @./a.usda@\n    )\n    {\n    }\n}\n");
    ok(opens(path, as_is, &run) && run.sequence.counts[0] == 4, "references and payloads");
    ok(is_at(&run, 0, 0, 10 - 4, 2, 6), "scaled first, then rotated, then translated");
    ok(is_at(&run, 0, 2, 10 - 14, 14, 14), "the sublayer overrides the payload");
    ok(run.self && strstr(run.sequence.notes, "does not exist: mesh.obj"),
       "a missing file is noted");
    run_close(&run);
}

static void test_transforms(void)
{
    static const struct {
        const char *op, *value;
        double x, y, z; /* of the row at 1, 2, 3; NaN: refused */
        const char *word;
    } ops[] = {
        {"matrix4d xformOp:transform",
         "( (0, 1, 0, 0), (-1, 0, 0, 0), (0, 0, 1, 0), (5, 6, 7, 1) )", 3, 7, 10, NULL},
        {"quatf xformOp:orient", "(0, 0.8, 0.6, 0)", 2.2, 0.4, -3, NULL},
        {"quatf xformOp:orient", "(0, 0, 0.8, 0.6)", -1, 3.44, 1.08, NULL},
        {"quatf xformOp:orient", "(0, 0, 0.6, 0.8)", -1, 2.32, 2.76, NULL},
        {"quatf xformOp:orient", "(0, 0, 1, 0)", -1, 2, -3, NULL},
        {"quatf xformOp:orient", "(0.8, 0, 0.6, 0)", 3.16, 2, -0.12, NULL},
        {"quatf xformOp:orient", "(0.70710678, 0.70710678, 0, 0)", 1, -3, 2, NULL},
        {"float3 xformOp:rotateXYZ", "(90, 0, 90)", 3, 1, 2, NULL},
        {"float3 xformOp:rotateZYX:pivot", "(90, 0, 90)", -2, -3, 1, NULL},
        {"float xformOp:rotateY", "90", 3, 2, -1, NULL},
        {"float3 xformOp:scale", "(1, 2, 1)", NAN, 0, 0, "unequally"},
        {"float3 xformOp:scale", "(1, 1, -1)", NAN, 0, 0, "mirrors"},
        {"float3 xformOp:scale", "(0, 0, 0)", NAN, 0, 0, "scale in the scene"},
        {"float3 xformOp:spin", "(0, 0, 0)", NAN, 0, 0, "not supported"},
        {"float3 xformOp:translate", "(1, 1)", NAN, 0, 0, "xformOp:translate"},
    };

    for (size_t i = 0; i < sizeof ops / sizeof *ops; i++) {
        char text[2048];
        struct run run;
        struct spin_splats s = {0};
        double q[4];

        snprintf(text, sizeof text,
                 HEAD SPLATS "{\n" TWO
                             "    %s = %s\n    uniform token[] xformOpOrder = [\"%s\"]\n}\n",
                 ops[i].op, ops[i].value, strchr(ops[i].op, ' ') + 1);
        ok(opens(layer(text), as_is, &run), "%s", ops[i].op);
        if (!ops[i].word)
            ok(is_at(&run, 0, 0, ops[i].x, ops[i].y, ops[i].z), "%s: moves", ops[i].op);
        else
            ok(run.self &&
                   run.importer->frame(run.self, 0, 0, run.sequence.columns, &s) != SPIN_OK &&
                   strstr(spin_last_error(), ops[i].word) && strstr(spin_last_error(), "s.usda"),
               "%s: %s", ops[i].op, spin_last_error());
        if (sscanf(ops[i].value, "(%lf, %lf, %lf, %lf)", &q[0], &q[1], &q[2], &q[3]) == 4 &&
            ok(run.importer->frame(run.self, 0, 0, run.sequence.columns, &s) == SPIN_OK, "read"))
            near(fabs(q[0] * (double)s.quats[0] + q[1] * (double)s.quats[1] +
                      q[2] * (double)s.quats[2] + q[3] * (double)s.quats[3]),
                 1, 1e-6, "and turns");
        run_close(&run);
        spin_splats_free(&s);
    }
}

static void test_samples(void)
{
    const char *path = layer(
        "#usda 1.0\n(\n    timeCodesPerSecond = 48\n)\n"
        "def Xform \"W\"\n{\n    double3 xformOp:translate.timeSamples = { 1: (0, 0, 0), 4: (9, 0, "
        "0) }\n"
        "    uniform token[] xformOpOrder = [\"!resetXformStack!\", \"xformOp:translate\"]\n" SPLATS
        "{\n" TWO "    point3f[] positions.timeSamples = {\n        3: [(0, 0, 3), (0, 0, 0)],\n"
        "        1: [(0, 0, 1), (1, 1, 1)], 2: None,\n    }\n}\n}\n");
    struct run run;

    ok(opens(path, as_is, &run) && run.sequence.n_frames == 4 && run.sequence.numbers[3] == 4 &&
           run.sequence.fps == 48 && run.sequence.times[0] == 1,
       "a frame at each time of a sample, in order");
    ok(is_at(&run, 0, 0, 0, 0, 1) && is_at(&run, 2, 0, 0, 0, 3) && is_at(&run, 3, 0, 9, 0, 3),
       "values are held until the next sample");
    ok(run.self && run.sequence.counts[1] == 0, "no splats while a sample is None");
    run_close(&run);
    ok(opens(with_line(path, ", 2: None", ""), as_is, &run) && run.sequence.n_frames == 3 &&
           run.sequence.static_columns == SPIN_COL_LOGIT_OPACITIES && !run.sequence.identity,
       "a sampled transform leaves only opacities the same");
    run_close(&run);
    ok(opens(layer(HEAD SPLATS "{\n" TWO "    point3f[] positions.timeSamples = { 1: [(0, 0, 0), "
                               "(0, 0, 1)], 1.5: [(1, 0, 0), (2, 0, 0)] }\n}\n"),
             NULL, &run) &&
           run.sequence.static_columns == SPIN_COL_ATTRIBUTES && run.sequence.identity &&
           !run.sequence.numbers,
       "splats whose positions alone have samples are tracks");
    run_close(&run);
    ok(opens(layer(HEAD SPLATS "{\n" TWO
                               "    float[] opacities.timeSamples = { 1: [1, 1], 2: [1, 0] }\n}\n"),
             NULL, &run) &&
           run.sequence.static_columns & SPIN_COL_LOG_SCALES && !run.sequence.identity,
       "splats whose opacities change are not");
    run_close(&run);
}

/* Frames of clips that start later, run faster, or have no samples of their own. */
static void test_clips(void)
{
    const char *folder = new_folder(), *path = path_in(folder, "clip.usda");
    struct run run;

    write_text(
        path_in(folder, "a.usda"),
        "#usda 1.0\nover \"P\"\n{\n    over \"S\"\n    {\n    point3f[] positions.timeSamples = "
        "{ 10: [(1, 0, 0), (0, 0, 0)], 12: [(2, 0, 0), (0, 0, 0)] }\n    }\n}\n");
    write_text(path_in(folder, "b.usda"), "#usda 1.0\n");
    write_text(path,
               "#usda 1.0\ndef \"W\" (\n    clips = {\n        dictionary default = {\n"
               "            double2[] active = [(0, 0), (2, 1)]\n"
               "            asset[] assetPaths = [@./a.usda@, @b.usda@]\n"
               "            string primPath = \"/P\"\n"
               "            double2[] times = [(0, 10), (2, 14)]\n        }\n    }\n)\n{\n" SPLATS
               "{\n    point3f[] positions\n    float3[] scales = [(1, 1, 1), (1, 1, 1)]\n"
               "}\n}\n");
    ok(opens(path, as_is, &run) && run.sequence.n_frames == 3 && run.sequence.times[1] == 1,
       "clips at another rate");
    ok(run.self && run.sequence.counts[2] == 0, "a clip without the prim has no splats");
    ok(is_at(&run, 0, 0, 1, 0, 0) && is_at(&run, 1, 0, 2, 0, 0), "samples of the first clip");
    run_close(&run);
}

/* Clips whose files have a time code in their names, one of which is missing. */
static void test_templates(void)
{
    static const struct {
        const char *from, *to, *word;
    } lies[] = {
        {"c.###", "c.##.##", "not supported"},
        {"c.###", "c", "not supported"},
        {"c.###", "d.###", "no file matches the clip template"},
        {"templateStride = 2", "templateStride = 0.5", "expected integers"},
        {"templateStride = 2", "templateStride = 0", "expected integers"},
        {"templateStride", "templateStep", "no 'templateStride'"},
        {"templateAssetPath", "templatePath", "neither assetPaths"},
    };
    const char *folder = new_folder(), *path = path_in(folder, "clip.usda");
    struct run run;

    for (int k = 0; k < 6; k += k == 0 ? 4 : 2) {
        char name[20], text[200];

        snprintf(name, sizeof name, "c.%03d.usda", 96 + k);
        snprintf(
            text, sizeof text,
            "#usda 1.0\nover \"S\"\n{\n    point3f[] positions.timeSamples = { %d: [(%d, 0, 0)]"
            " }\n}\n",
            96 + k, k);
        write_text(path_in(folder, name), text);
    }
    write_text(path,
               "#usda 1.0\n" SPLATS "(\n    clips = { dictionary \"default\" = {\n"
               "        asset templateAssetPath = @./c.###.usda@\n"
               "        double templateStartTime = 96\n        double templateEndTime = 100\n"
               "        double templateStride = 2\n        string primPath = \"/S\"\n    } }\n"
               ")\n{\n    float3[] scales = [(1, 1, 1)]\n}\n");
    ok(opens(path, as_is, &run) && run.sequence.n_frames == 2 && run.sequence.numbers[1] == 100 &&
           is_at(&run, 0, 0, 0, 0, 0) && is_at(&run, 1, 0, 4, 0, 0),
       "files named by a template");
    run_close(&run);
    for (size_t i = 0; i < sizeof lies / sizeof *lies; i++) {
        const char *bad = with_line(path, lies[i].from, lies[i].to);

        model_fails("usd", bad, NULL, "clip.usda", lies[i].word, lies[i].word);
    }
}

static void test_lies(void)
{
    static const struct {
        const char *from, *to, *word;
    } lies[] = {
        {"[0.5, 1]", "[0.5]", "'opacities' has 1 values"},
        {"(4, 5, 6)", "(4, 5)", "tuple"},
        {"(4, 5, 6)", "(4, 5, 6, 7)", "tuple"},
        {"(4, 5, 6)]", "(4, 5, 6)", "not of the same kind"},
        {"= 0\n", "= 1\n", "SH degree 1"},
        {"= 0\n", "= -1\n", "SH degree -1"},
        {"float3[] scales", "float3[] sizes", "no 'scales'"},
        {"point3f[] positions", "point3f[] places", "0 splats"},
        {"point3f[] positions", "positions", "the type and the name"},
        {"def Par", "def Bar", "no prim of type"},
        {"def Par", "over Par", "no prim of type"},
        {"\"S\" {", "\"S\" ", "expected '{'"},
        {"\"S\" {", "S {", "in quotes"},
        {"\"S\" {", "S {", "line 5:"},
        {"[0.5, 1]", "", "the type and the name"},
        {"[0.5, 1]", "\"a", "does not end on its line"},
        {"[0.5, 1]", "\"\"\"a", "ends within a text"},
    };
    static const struct {
        const char *from, *to, *word;
    } rows[] = {
        {"(4, 5, 6)", "(4, nan, 6)", "positions"},
        {"(4, 5, 6)", "(4, x, 6)", "expected a number"},
        {"(4, 5, 6)", "(4, 0x1, 6)", "expected a number"},
        {"0.1, 0.2", "-0.1, 0.2", "negative"},
        {"0.5, 1]", "0.5, 2]", "opacity 2"},
        {"(1, 0, 0, 0)", "(0, 0, 0, 0)", "orientations"},
        {"-1, 0, 0.5", "inf, 0, 0.5", "SH"},
    };
    const char *good = layer(HEAD SPLATS "{\n" TWO "}\n");

    for (size_t i = 0; i < sizeof lies / sizeof *lies; i++)
        model_fails("usd", with_line(good, lies[i].from, lies[i].to), NULL, "s.usda", lies[i].word,
                    lies[i].word);
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        struct spin_splats s = {0};
        struct run run;

        ok(opens(with_line(good, rows[i].from, rows[i].to), NULL, &run) &&
               run.importer->frame(run.self, 0, 0, run.sequence.columns, &s) != SPIN_OK &&
               strstr(spin_last_error(), rows[i].word) && strstr(spin_last_error(), "s.usda"),
           "%s is refused: %s", rows[i].to, spin_last_error());
        run_close(&run);
        spin_splats_free(&s);
    }
    ok(read_truncations("usd", good) == 1,
       "of all truncations only the last line feed is not missed");
    survive_flips("usd", good);
}

/* Layers nested too deeply, and cyclic ones. */
static void test_cycles(void)
{
    static char deep[20000], nested[20000];
    size_t n = (size_t)sprintf(deep, "#usda 1.0\n");
    size_t m = (size_t)sprintf(nested, "#usda 1.0\n" SPLATS "{\n    float[] opacities = ");

    for (int i = 0; i < 500; i++) {
        n += (size_t)sprintf(deep + n, "def \"a\" {\n");
        m += (size_t)sprintf(nested + m, "[");
    }
    model_fails("usd", layer(deep), NULL, "s.usda", "too deep", "prims within prims");
    model_fails("usd", layer(nested), NULL, "s.usda", "too deep", "brackets within brackets");
    model_fails("usd", layer("#usda 1.0\n(\n    subLayers = [@./s.usda@]\n)\n"), NULL, "s.usda",
                "cycle", "a layer that includes itself");
    model_fails("usd", layer("#usda 1.0\ndef \"a\" (\n    references = </a>\n)\n{\n}\n"), NULL,
                "s.usda", "cycle", "a prim that refers to itself");
    model_fails(
        "usd",
        layer("#usda 1.0\ndef \"a\"\n{\n    def \"b\" (\n        references = </a>\n    )\n"
              "    {\n    }\n    def \"c\" (\n        references = </a>\n    )\n    {\n    }\n}\n"),
        NULL, "s.usda", "cycle", "a prim that refers to its parent, twice");
    model_fails("usd", layer("#usda 1.0\n(\n    subLayers = [@./none.usda@]\n)\n"), NULL,
                "none.usda", "no such file", "a sublayer that does not exist");
}

static void put_member(struct spin_zip_writer *w, const char *name, const char *text)
{
    if (spin_zip_member_whole(w, name, text, strlen(text), "", 0) != SPIN_OK)
        exit(1);
}

/* Truncated or damaged crates, plain ones and those with compressed integers. */
static void test_crates(void)
{
    static const char *const names[] = {"usd/clip_packed", "usd/clip_half"};

    for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
        const char *folder = check_fixture(names[i]);

        if (!folder) {
            skip(names[i], "there is none here");
            continue;
        }
        ok(read_truncations("usd", path_in(folder, "scene.usdc")) == 0,
           "%s: no truncation can be read", names[i]);
        survive_flips("usd", path_in(folder, "scene.usdc"));
    }
}

static const float two_places[] = {1, 2, 3, 4, 5, 6}, ones[] = {1, 1, 1, 1, 1, 1};

static uint64_t vectors(struct crate *c, const float *v)
{
    return crate_array(c, 24, 2, v, 6 * sizeof *v);
}

static int two_splats(struct crate *c, int parent, const char *name)
{
    int prim = crate_prim(c, parent, name, "ParticleField3DGaussianSplat");

    crate_attribute(c, prim, "positions", vectors(c, two_places));
    crate_attribute(c, prim, "scales", vectors(c, ones));
    return prim;
}

static void test_empty_crate(void)
{
    const char *path = path_in(new_folder(), "empty.usdc");
    static struct crate c;

    crate_begin(&c);
    crate_prim(&c, -1, "", NULL);
    crate_write(&c, path);
    model_fails(NULL, path, NULL, "empty.usdc", "no prim of type", "a crate without prims");
}

/* References, payloads and transforms of a crate, whose inline values have one byte a number. */
static void test_crate_layers(void)
{
    const char *folder = new_folder(), *path = path_in(folder, "root.usdc");
    static const char *const order[] = {"xformOp:translate", "xformOp:transform", NULL};
    static const char *const below[] = {"./sub.usdc", NULL};
    static struct crate c;
    struct run run;
    int world, prim;

    crate_begin(&c);
    crate_prim(&c, -1, "", NULL);
    crate_field(&c, "defaultPrim", crate_text(&c, 11, "S"));
    two_splats(&c, 0, "S");
    crate_write(&c, path_in(folder, "a.usdc"));
    crate_begin(&c);
    crate_prim(&c, -1, "", NULL);
    world = crate_prim(&c, 0, "W", NULL);
    prim = crate_prim(&c, world, "Q", NULL);
    crate_attribute(&c, prim, "positions", vectors(&c, ones));
    crate_write(&c, path_in(folder, "sub.usdc"));
    crate_begin(&c);
    crate_prim(&c, -1, "", NULL);
    crate_field(&c, "subLayers", crate_texts(&c, 50, below));
    crate_field(&c, "timeCodesPerSecond", crate_word(9, CRATE_INLINE, 0x41c00000)); /* 24 */
    world = crate_prim(&c, 0, "W", "Xform");
    crate_attribute(&c, world, "xformOp:translate", crate_word(23, CRATE_INLINE, 0x00ff0a));
    crate_attribute(&c, world, "xformOp:transform", crate_word(15, CRATE_INLINE, 0x01020202));
    crate_attribute(&c, world, "xformOpOrder", crate_texts(&c, 11, order));
    prim = crate_prim(&c, world, "P", NULL); /* path 5 */
    crate_field(&c, "references", crate_reference(&c, 35, "a.usdc", 99));
    prim = crate_prim(&c, world, "Q", NULL);
    crate_field(&c, "payload", crate_reference(&c, 47, "./a.usdc", 99));
    prim = crate_prim(&c, world, "R", NULL);
    crate_field(&c, "payload", crate_reference(&c, 55, "", 5));
    prim = two_splats(&c, world, "Off");
    c.set[c.n_set++] = -1; /* a second spec of the prim */
    memcpy(c.spec[c.n_specs++], (int32_t[]){prim, c.n_set, 6}, 12);
    crate_field(&c, "active", crate_word(1, CRATE_INLINE, 0));
    crate_write(&c, path);
    ok(opens(path, as_is, &run) && run.sequence.counts[0] == 6, "three of four prims have splats");
    ok(is_at(&run, 0, 0, 12, 3, 6), "a reference, scaled and then translated");
    ok(is_at(&run, 0, 2, 12, 1, 2), "a payload, overridden by a sublayer");
    ok(is_at(&run, 0, 5, 18, 9, 12), "a payload within the layer");
    run_close(&run);
}

/* Samples, one of which is blocked, and value clips. */
static void test_crate_clips(void)
{
    static const float moved[] = {7, 7, 7, 8, 8, 8};
    static const char *const assets[] = {"./a.usdc", "./b.usdc", NULL};
    const char *folder = new_folder(), *path = path_in(folder, "root.usdc");
    static struct crate c;
    uint64_t set, words[4], clips;
    struct run run;
    int prim;

    for (int k = 0; k < 2; k++) {
        crate_begin(&c);
        crate_prim(&c, -1, "", NULL);
        prim = crate_prim(&c, 0, "P", NULL);
        words[0] = vectors(&c, k ? moved : two_places);
        words[1] = crate_word(51, CRATE_INLINE, 0);
        words[2] = vectors(&c, k ? two_places : moved);
        crate_attribute(&c, prim, "positions", crate_samples(&c, words, 3));
        crate_write(&c, path_in(folder, k ? "b.usdc" : "a.usdc"));
    }
    crate_begin(&c);
    words[0] = crate_array(&c, 19, 2, (double[]){0, 0, 3, 1}, 32);
    words[1] = crate_array(&c, 19, 2, (double[]){0, 0, 9, 9}, 32);
    words[2] = crate_texts(&c, 12, assets);
    words[3] = crate_text(&c, 10, "/P");
    set = crate_u64(&c, 4);
    for (int k = 0; k < 4; k++) {
        static const char *const keys[] = {"active", "times", "assetPaths", "primPath"};

        crate_u32(&c, crate_token(&c, keys[k]));
        crate_u64(&c, 8);
        crate_u64(&c, words[k]);
    }
    clips = crate_u64(&c, 1);
    crate_u32(&c, crate_token(&c, "default"));
    crate_u64(&c, 8);
    crate_u64(&c, crate_word(31, 0, set));
    crate_prim(&c, -1, "", NULL);
    prim = crate_prim(&c, 0, "S", "ParticleField3DGaussianSplat");
    crate_field(&c, "clips", crate_word(31, 0, clips));
    crate_attribute(&c, prim, "scales", vectors(&c, ones));
    crate_write(&c, path);
    ok(opens(path, as_is, &run) && run.sequence.n_frames == 4 && run.sequence.numbers[3] == 3,
       "the samples of the first clip, and the start of the second, which has no more");
    ok(is_at(&run, 0, 1, 4, 5, 6) && is_at(&run, 2, 1, 8, 8, 8) && is_at(&run, 3, 0, 1, 2, 3) &&
           run.sequence.counts[1] == 0,
       "their values, and none while a sample is blocked");
    run_close(&run);
}

/* A package of two layers in folders. */
static void test_packages(void)
{
    const char *path = path_in(new_folder(), "s.usdz"), *bad = path_in(new_folder(), "bad.usdz");
    struct spin_zip_writer w;
    struct run run;

    if (spin_zip_writer_open(path, false, &w) != SPIN_OK)
        exit(1);
    put_member(&w, "x/root.usda",
               "#usda 1.0\ndef \"A\" (\n    references = @../y/a.usda@\n)\n{\n}\n");
    put_member(&w, "y/a.usda", HEAD SPLATS "{\n" TWO "}\n");
    ok(spin_zip_writer_commit(&w) == SPIN_OK && opens(path, as_is, &run) &&
           is_at(&run, 0, 0, 1, 2, 3),
       "a package whose first member refers to another one");
    run_close(&run);
    if (spin_zip_writer_open(bad, false, &w) != SPIN_OK ||
        spin_zip_member_begin_deflated(&w, "a.usda", strlen(HEAD)) != SPIN_OK ||
        spin_zip_member_write(&w, HEAD, strlen(HEAD)) != SPIN_OK ||
        spin_zip_member_end(&w) != SPIN_OK || spin_zip_writer_commit(&w) != SPIN_OK)
        exit(1);
    model_fails(NULL, bad, NULL, "bad.usdz", "compressed", "a member that is compressed");
}

TAP_MAIN
{
    spin_log_set_level(-2);
    test_values();
    test_defaults();
    test_layers();
    test_transforms();
    test_samples();
    test_clips();
    test_templates();
    test_lies();
    test_cycles();
    test_crates();
    test_empty_crate();
    test_crate_layers();
    test_crate_clips();
    test_packages();
}
