/* Options of spin-export and spin-import change what is written: frame rates, colours, axes,
 * bytes.
 * K: export import options fps */
#include "scene/bundle.h"
#include "tests/cmd/command.h"

/* The JSON chunk of a GLB. */
static spin_json *glb_json(const char *name)
{
    spin_json *j = NULL;
    struct spin_map map;
    char path[600];

    snprintf(path, sizeof path, "%s/%s", folder, name);
    if (spin_map_open(path, &map) != SPIN_OK)
        return NULL;
    if (map.size > 20) {
        const unsigned char *b = map.data;
        size_t n = b[12] + 256u * b[13] + 65536u * b[14];

        if (20 + n <= map.size)
            spin_json_parse(name, (const char *)b + 20, n, &j);
    }
    spin_map_close(&map);
    return j;
}

/* The time at which the animation of a GLB ends. */
static double seconds_of(const char *name)
{
    spin_json *j = glb_json(name);
    const spin_json *samplers =
        spin_json_get(spin_json_at(spin_json_get(j, "animations"), 0), "samplers");
    const spin_json *all = spin_json_get(j, "accessors");
    double input = number(spin_json_at(samplers, 0), "input"), end;

    end = number_at(spin_json_at(all, (size_t)input), "max", 0);
    spin_json_free(j);
    return end;
}

/* One export; its exit code must be 0. */
static void export(const char *bundle, const char *out, const char *more)
{
    if (!ok(shell("%s/spin-export %s/%s -o %s/%s -q %s", bin, folder, bundle, folder, out, more) ==
                0,
            "spin-export %s -o %s %s", bundle, out, more))
        printf("#   %s\n", said);
}

static bool same(const char *a, const char *b)
{
    return shell("diff -r %s/%s %s/%s", folder, a, folder, b) == 0;
}

static double html_fps(const char *name)
{
    double fps = NAN;

    shell("grep -o '\"fps\":[0-9.]*' %s/%s", folder, name);
    sscanf(said, "\"fps\":%lf", &fps);
    return fps;
}

static double sequence_fps(const char *sub)
{
    char path[600];
    spin_json *j = NULL;
    double fps;

    snprintf(path, sizeof path, "%s/%s/sequence.json", folder, sub);
    spin_json_load(path, &j);
    fps = number(j, "fps");
    spin_json_free(j);
    return fps;
}

/* The clip again, with frames half a second apart. */
static void write_timed(void)
{
    struct spin_bundle_writer w;
    struct spin_splats splats = {0};
    struct spin_bundle b;
    char path[600];
    bool good;

    snprintf(path, sizeof path, "%s/in.spin", folder);
    good = spin_bundle_open(path, &b) == SPIN_OK;
    snprintf(path, sizeof path, "%s/timed.spin", folder);
    good = good && spin_bundle_writer_open(path, true, false, &w) == SPIN_OK;
    for (int f = 0; good && f < b.meta.n_frames; f++) {
        good = spin_bundle_frame(&b, f, b.meta.columns, &splats) == SPIN_OK &&
               spin_bundle_write_frame(&w, f, b.meta.columns, b.meta.static_columns, &splats) ==
                   SPIN_OK;
        b.meta.frame[f].time *= 0.5;
    }
    if (!ok(good && spin_bundle_writer_finish(&w, &b.meta, NULL) == SPIN_OK,
            "a clip at two frames a second"))
        exit(tap_done());
    spin_splats_free(&splats);
    spin_bundle_close(&b);
}

/* Six frames whose times are frame numbers; six that are half a second apart. */
static void test_fps(void)
{
    export("in.spin", "a.glb", "--to gltf");
    near(seconds_of("a.glb"), 6.0 / 30, 1e-6, "GLB: thirty frames a second without a word");
    export("in.spin", "b.glb", "--to gltf --fps 12");
    near(seconds_of("b.glb"), 6.0 / 12, 1e-6, "GLB: --fps 12");
    export("in.spin", "c.glb", "--to gltf --range 1:6:2");
    near(seconds_of("c.glb"), 3.0 / 30, 1e-6, "GLB: --range with a step is no frame rate");
    export("timed.spin", "d.glb", "--to gltf");
    near(seconds_of("d.glb"), 6.0 / 2, 1e-6, "GLB: the bundle's");
    export("in.spin", "a.html", "--to html");
    near(html_fps("a.html"), 3, 0, "page: its six frames take two seconds");
    export("in.spin", "b.html", "--to html --fps 12 --every 2");
    near(html_fps("b.html"), 6, 0, "page: --fps 12 and every second frame");
    export("timed.spin", "c.html", "--to html");
    near(html_fps("c.html"), 2, 0, "page: the bundle's");
    export("in.spin", "ply", "--to ply");
    ok(isnan(sequence_fps("ply")), "sequence.json: unknown");
    export("in.spin", "ply2", "--to ply --range 1:6:2");
    ok(isnan(sequence_fps("ply2")), "sequence.json: unknown with a step too");
    export("timed.spin", "ply3", "--to ply");
    near(sequence_fps("ply3"), 2, 1e-9, "sequence.json: the bundle's");
}

static void test_splats(void)
{
    spin_json *turned, *plain;

    export("net.spin", "net", "--to ply");
    export("net.spin", "source", "--to ply --source");
    ok(!same("net/frame_00001.ply", "ply/frame_00001.ply"),
       "the network's splats are not the source's");
    ok(same("source/frame_00001.ply", "ply/frame_00001.ply"), "--source: they are");
    export("net.spin", "threads", "--to ply --threads 3 --device cpu");
    ok(same("net", "threads"), "--threads: the same bytes");
    export("net.spin", "sh1", "--to ply --sh 1");
    shell("head -c 2000 %s/sh1/frame_00001.ply | grep -ac 'property float f_rest'", folder);
    ok(atoi(said) == 9, "--sh 1: nine coefficients more");
    shell("head -c 4000 %s/net/frame_00001.ply | grep -ac 'property float f_rest'", folder);
    ok(atoi(said) == 45, "--sh keep: 45");
    export("in.spin", "named", "--to ply --pattern ball-%03d.ply --range 2:3");
    ok(shell("ls %s/named/ball-002.ply", folder) == 0, "--pattern");
    export("in.spin", "fast", "--to spz --spz-version 3 --level 1 --range 0:1");
    export("in.spin", "small", "--to spz --spz-version 3 --level 9 --range 0:1");
    ok(shell("cd %s && gzip -dc fast/*.spz >1 && gzip -dc small/*.spz >9 && cmp 1 9 && "
             "test $(cat small/*.spz | wc -c) -lt $(cat fast/*.spz | wc -c)",
             folder) == 0,
       "--level 9: the same splats in fewer bytes");
    export("in.spin", "source.glb", "--to gltf --axes source");
    turned = glb_json("a.glb");
    plain = glb_json("source.glb");
    ok(turned && plain && !same("a.glb", "source.glb"), "--axes source: other numbers");
    spin_json_free(turned);
    spin_json_free(plain);
    ok(shell("%s/spin-export %s/in.spin --to ply -o %s/ply -q", bin, folder, folder) == 1 &&
           shell("%s/spin-export %s/in.spin --to ply -o %s/ply -q --force", bin, folder, folder) ==
               0,
       "--force overwrites, nothing else does");
    ok(shell("%s/spin-export %s/net.spin --to ply -o %s/cuda --device cuda", bin, folder, folder) ==
               1 &&
           strstr(said, "no CUDA device"),
       "--device cuda: there is none");
}

static void test_pictures(void)
{
    export("in.spin", "black", "--to images --range 0:1");
    export("in.spin", "white", "--to images --range 0:1 --background white");
    ok(!same("black", "white"), "--background shows behind the splats");
    ok(shell("cd %s/black && find . -name '*.png' | sort", folder) == 0 &&
           strstr(said, "./cam_00_") && strstr(said, "./cam_15_") && !strstr(said, "./cam_03_"),
       "pictures from the test cameras: %s", said);
    ok(shell("%s/spin-export %s/in.spin --to images -o %s/x --data-from transforms", bin, folder,
             folder) == 1 &&
           strstr(said, "transforms"),
       "--data-from: another reader looks for other files");
    ok(shell("%s/spin-export %s/in.spin --to images -o %s/x --data %s", bin, folder, folder,
             folder) == 1,
       "--data: another folder is none");
    for (int i = 0; i < 2; i++) {
        static const char *const pair[] = {"number", "order"};
        char more[300];

        snprintf(more, sizeof more, "--to images --panels truth --data %s --pair %s --range 9:10",
                 clip, pair[i]);
        export("two.spin", pair[i], more);
    }
    export("in.spin", "first", "--to images --panels truth --range 0:1");
    export("in.spin", "second", "--to images --panels truth --range 1:2");
    ok(shell("cd %s && cmp order/cam_00_*.png first/cam_00_*.png && cmp number/cam_00_*.png "
             "second/cam_00_*.png",
             folder) == 0,
       "--pair: by order the first row's image, by number that of its number: %s", said);
}

static void import(const char *input, const char *out, const char *more)
{
    if (!ok(shell("%s/spin-import %s -o %s/%s %s", bin, input, folder, out, more) == 0,
            "spin-import %s", more))
        printf("#   %s\n", said);
}

static void test_import(void)
{
    struct spin_npz npz;
    char path[600];

    import(clip, "one.spin", "--threads 1");
    ok(strstr(said, "6, numbers 0 to 5") != NULL, "says what it read");
    import(clip, "three.spin", "--threads 3 -q");
    ok(!*said, "-q: says nothing");
    ok(same("one.spin", "three.spin"), "--threads: the same bytes");
    import(clip, "some.spin", "--range 1:6:2 --json");
    ok(said_number("frames") == 3, "--range: three frames");
    snprintf(path, sizeof path, "%s/ply", folder);
    import(path, "bare.spin", "--positions-only --json");
    snprintf(path, sizeof path, "%s/bare.spin", folder);
    if (ok(spin_npz_open(path, &npz) == SPIN_OK, "--positions-only: a bundle"))
        ok(spin_npz_has(&npz, "source/means/00000") && npz.zip.n == 7,
           "of positions and nothing else");
    spin_npz_close(&npz);
    snprintf(path, sizeof path, "%s/ply", folder);
    import(path, "from.spin", "--from ply --json");
    ok(strstr(said, "log_scales") && said_text("from", "ply"), "--from ply");
    ok(shell("%s/spin-import --from d3dgs %s -o %s/x.spin", bin, path, folder) == 1,
       "--from: another importer looks for other files");
    ok(shell("%s/spin-import %s --data %s --data-from transforms -o %s/x.spin", bin, clip, clip,
             folder) == 1 &&
           strstr(said, "transforms"),
       "--data-from: another reader looks for other files");
    snprintf(path, sizeof path, "%s/two", folder);
    ok(shell("%s/spin-import %s --data %s --pair order -o %s/ordered.spin", bin, path, clip,
             folder) == 0,
       "--pair order: %s", said);
    ok(shell("mv %s/frame_00011.ply %s/frame_00099.ply && %s/spin-import %s --data %s -o %s/x.spin",
             path, path, bin, path, clip, folder) != 0 &&
           strstr(said, "99"),
       "--pair auto: a number that the data set has not");
    ok(shell("%s/spin-import %s --data %s --pair order -o %s/kept.spin", bin, path, clip, folder) ==
               0 &&
           shell("%s/spin-eval %s/kept.spin", bin, folder) == 0,
       "spin-eval keeps to --pair of the import: %s", said);
    ok(shell("%s/spin-eval %s/kept.spin --pair number", bin, folder) == 2 && strstr(said, "99"),
       "unless it is told otherwise");
    ok(shell(
           "%s/spin-retrain %s/kept.spin -o %s/again.spin --device cpu --scale 0.25 --iterations 2 "
           "-q",
           bin, folder, folder) == 0 &&
           shell("%s/spin-eval %s/again.spin", bin, folder) == 0,
       "and so do spin-retrain and what it writes: %s", said);
}

static void test_poster(void)
{
    static const char tag[] = "og:image\" content=\"page.png\"";

    export("in.spin", "page.html", "--to html --poster");
    ok(is_png(".", "page.png", 1200, 630) &&
           shell("grep -q '%s' %s/page.html", tag, folder) == 0 &&
           shell("test $(wc -c <%s/page.png) -gt 20000", folder) == 0,
       "--poster: an image that is not of one colour, and the page names it");
}

TAP_MAIN
{
    begin_commands();
    ok(shell("%s/spin-retrain %s/in.spin -o %s/net.spin --preset paper --device cpu --scale 0.25 "
             "--levels 4 "
             "--hash-log2 10 "
             "--finest-resolution 32 --hidden 16 --iterations 2 -q",
             bin, folder, folder) == 0,
       "a network: %s", said);
    /* Frames 1 and 3 under the data set's numbers. */
    write_timed();
    ok(shell("%s/spin-export %s/in.spin --to ply -o %s/two --range 1:4:2", bin, folder, folder) ==
               0 &&
           shell("cd %s/two && rm sequence.json && mv frame_00001.ply frame_00009.ply && "
                 "mv frame_00003.ply frame_00011.ply",
                 folder) == 0 &&
           shell("%s/spin-import %s/two -o %s/two.spin", bin, folder, folder) == 0,
       "two frames with numbers");
    test_fps();
    test_splats();
    test_pictures();
    test_poster();
    test_import();
}
