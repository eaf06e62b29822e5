/* transforms: JSON of D-NeRF, n3v2blender and nerfstudio compared with the reference readers,
 * and malformed files.
 * K: transforms import views */
#include "tests/importers/sets.h"

/* ---- Fixtures -------------------------------------------------------------------------------- */

/* A key of expected.npz with one row per view of the split, in the order of their paths. */
static const struct spin_view **split_views(const struct spin_views *views, bool test, size_t *n)
{
    const struct spin_view **list = malloc(views->n * sizeof *list + 1);

    *n = 0;
    for (size_t i = 0; i < views->n; i++) {
        size_t k = *n;

        if (views->view[i].test != test)
            continue;
        for (; k > 0 && strcmp(list[k - 1]->path, views->view[i].path) > 0; k--)
            list[k] = list[k - 1];
        list[k] = &views->view[i];
        ++*n;
    }
    return list;
}

struct context {
    struct spin_npz *npz;
    const char *reader, *name;
    double abs, rel;
};

/* Poses, times and, if known, angles of view or K = fx fy cx cy. */
static void compare_split(const struct context *x, const struct spin_views *views, bool test)
{
    const char *split = test ? "test" : "train";
    size_t n;
    const struct spin_view **list = split_views(views, test, &n);
    float *pose = malloc(n * 16 * sizeof *pose + 1), *time = malloc(n * sizeof *time + 1),
          *fov = malloc(n * 2 * sizeof *fov + 1), *k4 = malloc(n * 4 * sizeof *k4 + 1);
    const struct {
        const char *key;
        size_t width;
        const float *got;
    } all[] = {{"w2c", 16, pose}, {"time", 1, time}, {"fov", 2, fov}, {"K4", 4, k4}};

    for (size_t i = 0; i < n; i++) {
        const struct spin_camera *c = &list[i]->camera;

        pose_of(list[i], pose + 16 * i);
        time[i] = (float)list[i]->time;
        fov[2 * i] = (float)(2 * atan(c->width / (2 * c->fx)));
        fov[2 * i + 1] = (float)(2 * atan(c->height / (2 * c->fy)));
        k4[4 * i] = (float)c->fx;
        k4[4 * i + 1] = (float)c->fy;
        k4[4 * i + 2] = (float)c->cx;
        k4[4 * i + 3] = (float)c->cy;
    }
    for (size_t k = 0; k < sizeof all / sizeof *all; k++) {
        struct spin_array info;
        char key[60], what[160];
        double *want;

        snprintf(key, sizeof key, "%s_%s_%s", x->reader, split, all[k].key);
        if (!spin_npz_has(x->npz, key))
            continue;
        want = check_load(x->npz, key, &info);
        snprintf(what, sizeof what, "%s: %s", x->name, key);
        if (want && ok(info.count == n * all[k].width, "%s has %zu views", what, n))
            check_close(all[k].got, want, n * all[k].width, x->abs, x->rel, what);
        free(want);
    }
    free(list);
    free(pose);
    free(time);
    free(fov);
    free(k4);
}

static void compare_both(const struct context *x, const struct spin_views *views)
{
    compare_split(x, views, false);
    compare_split(x, views, true);
}

/* Mean colours of a split's images over white, as the reference reader composites them. */
static void compare_white(const struct context *x, struct spin_views *views, bool test,
                          double tolerance)
{
    static const float white[3] = {1, 1, 1};
    const char *key = test ? "fudan_test_mean_rgb_white" : "fudan_train_mean_rgb_white";
    struct spin_array info;
    struct spin_image_cache pixels;
    double *want, darkest = 1;
    float *mean, *image;
    size_t n, k = 0;
    const struct spin_view **list;

    if (!spin_npz_has(x->npz, key) || spin_image_cache_open(views, 0, white, &pixels) != SPIN_OK)
        return;
    list = split_views(views, test, &n);
    want = check_load(x->npz, key, &info);
    mean = calloc(n + 1, 3 * sizeof *mean);
    for (; k < n; k++) {
        size_t plane = (size_t)list[k]->camera.width * (size_t)list[k]->camera.height;

        image = malloc(3 * plane * sizeof *image);
        if (spin_image_cache_get(&pixels, (size_t)(list[k] - views->view), image) != SPIN_OK)
            break;
        for (size_t i = 0; i < 3 * plane; i++) {
            mean[3 * k + i / plane] += image[i] / (float)plane;
            darkest = fmin(darkest, image[i]);
        }
        free(image);
    }
    if (ok(k == n && want && info.count == 3 * n, "%s: %s has %zu images", x->name, key, n)) {
        check_close(mean, want, 3 * n, tolerance, 0, key);
        ok(darkest < 0.9, "%s: and they are not white alone", x->name);
    }
    free(list);
    free(want);
    free(mean);
    spin_image_cache_close(&pixels);
}

static void test_blender(const char *folder, const char *name, const spin_json *manifest)
{
    struct spin_npz npz;
    struct spin_views views;
    struct context x = {.npz = &npz, .name = name};
    char used[32] = "";

    x.abs = manifest_tolerance(manifest, "abs", 2e-5);
    x.rel = manifest_tolerance(manifest, "rel", 2e-5);
    if (!spin_json_get(manifest, "expected")) {
        set_cases(folder, "transforms", manifest);
        return;
    }
    if (!ok(spin_npz_open(path_in(folder, "expected.npz"), &npz) == SPIN_OK, "%s: has expected.npz",
            name))
        return;
    if (ok(spin_views_open(folder, NULL, &views, used, sizeof used) == SPIN_OK &&
               strcmp(used, "transforms") == 0,
           "%s: is recognised and read", name)) {
        x.reader = "fudan";
        compare_both(&x, &views);
        compare_white(&x, &views, false, manifest_tolerance(manifest, "mean_rgb", 0.006));
        compare_white(&x, &views, true, manifest_tolerance(manifest, "mean_rgb", 0.006));
        ok(view_of(&views, "train/r_000.png") && view_of(&views, "test/r_000.png") &&
               view_of(&views, "train/r_000.png")->dataset_frame ==
                   view_of(&views, "test/r_000.png")->dataset_frame,
           "what was seen at one time is one frame, in both files");
        spin_views_free(&views);
    } else {
        printf("#   %s\n", spin_last_error());
    }
    if (set_opens(folder, "transforms:pose=4dgaussians,time=max", &views,
                  "the cameras that 4DGaussians has")) {
        x.reader = "hustvl";
        compare_both(&x, &views);
        spin_views_free(&views);
    }
    if (set_opens(folder, "transforms:test-file=transforms_val.json", &views,
                  "another file of what is held out")) {
        ok(view_of(&views, "val/r_001.png") && view_of(&views, "val/r_001.png")->test &&
               !view_of(&views, "test/r_000.png"),
           "takes the place of transforms_test.json");
        spin_views_free(&views);
    }
    spin_npz_close(&npz);
    set_cases(folder, "transforms", manifest);
}

/* The JSON of n3v2blender is in a folder of the dynerf fixture, whose images it refers to by
 * other names. */
static void test_n3v(const char *folder, const char *name, const spin_json *manifest)
{
    const char *json = path_in(folder, "n3v2blender"), *copy = new_folder();
    struct spin_npz npz;
    struct spin_views views;
    struct context x = {.npz = &npz, .name = name, .reader = "fudan"};
    double frames = 0, cameras = 0;

    x.abs = manifest_tolerance(manifest, "abs", 2e-5);
    x.rel = manifest_tolerance(manifest, "rel", 2e-5);
    if (!spin_path_is_folder(json))
        return;
    spin_json_number(spin_json_get(manifest, "frames"), &frames);
    spin_json_number(spin_json_get(manifest, "cameras"), &cameras);
    make_link(path_in(json, "transforms_train.json"), copy, "transforms_train.json");
    make_link(path_in(json, "transforms_test.json"), copy, "transforms_test.json");
    make_folder(copy, "images");
    for (int c = 0; c < (int)cameras; c++) {
        for (int f = 0; f < (int)frames; f++) {
            char from[64], to[64];

            snprintf(from, sizeof from, "cam%02d/images/%04d.png", c, f);
            snprintf(to, sizeof to, "images/cam%02d_%04d.png", c, f);
            make_link(path_in(folder, from), copy, to);
        }
    }
    if (!ok(spin_npz_open(path_in(folder, "expected.npz"), &npz) == SPIN_OK, "%s: has expected.npz",
            name))
        return;
    if (set_opens(copy, NULL, &views, "what n3v2blender writes")) {
        compare_both(&x, &views);
        ok(views.n_dataset_frames == (int)frames && views.numbered &&
               views.view[views.n - 1].number == frames - 1,
           "has numbered frames");
        ok(views.view[0].camera_id == 0 && views.view[0].test &&
               views.view[views.n - 1].camera_id == (int)cameras - 1,
           "and cameras by their numbers");
        spin_views_free(&views);
    }
    spin_npz_close(&npz);
}

/* ---- Files made here ------------------------------------------------------------------------- */

/* Looks along +z from (3, 0, 0), with the y and z of OpenGL negated. */
#define POSE "[[1,0,0,3],[0,-1,0,0],[0,0,-1,0],[0,0,0,1]]"
#define FRAME(path, time)                                                                          \
    "{\"file_path\":\"" path "\",\"time\":" time ",\"transform_matrix\":" POSE "}"

static const char *make_set(const char *train, const char *test)
{
    const char *folder = new_folder();

    make_text(folder, "transforms_train.json", train);
    if (test)
        make_text(folder, "transforms_test.json", test);
    make_folder(folder, "a");
    make_image(folder, "a/0.png", 8, 6);
    make_image(folder, "a/1.png", 8, 6);
    return folder;
}

static void test_own(void)
{
    struct spin_views views;
    const char *folder = make_set(
        "{\"camera_angle_x\":1,\"frames\":[" FRAME("./a/1", "4") "," FRAME("a/0.png", "2") "]}",
        "{\"fl_x\":7,\"fl_y\":9,\"cx\":3,\"cy\":2,\"w\":8,\"h\":6,\"frames\":[" FRAME("a/1",
                                                                                      "3") "]}");

    if (set_opens(folder, NULL, &views, "a set of two files")) {
        const struct spin_view *v = views.view;

        ok(views.n == 3 && views.n_dataset_frames == 3 && v[0].time == 2 && v[1].time == 3 &&
               v[2].time == 4 && v[1].test && !v[0].test,
           "has the distinct times of both as frames");
        ok(v[0].camera.w2c[0] == 1 && v[0].camera.w2c[5] == 1 && v[0].camera.w2c[10] == 1 &&
               v[0].camera.w2c[3] == -3,
           "OpenGL's axes become OpenCV's");
        near(v[0].camera.fx, 4 / tan(0.5), 1e-12, "the angle of view gives the focal length");
        ok(v[0].camera.cx == 4 && v[0].camera.cy == 3, "and the centre is the image's");
        ok(v[1].camera.fx == 7 && v[1].camera.fy == 9 && v[1].camera.cx == 3 && v[1].camera.cy == 2,
           "a camera matrix is taken as it is");
        spin_views_free(&views);
    }
    if (set_opens(folder, "transforms:time=unit", &views, "times from 0 to 1")) {
        ok(views.view[0].time == 0 && views.view[1].time == 0.5 && views.view[2].time == 1,
           "span both files");
        spin_views_free(&views);
    }
    if (set_opens(folder, "transforms:time=max", &views, "times over the largest")) {
        ok(views.view[0].time == 0.5 && views.view[2].time == 1, "are as 4DGaussians has them");
        spin_views_free(&views);
    }
    set_refused(folder, "transforms:time=x", "'time'", "an unknown time rule");
    set_refused(folder, "transforms:pose=x", "'pose'", "an unknown rule for poses");
    set_refused(folder, "transforms:test-file=no.json", "no.json", "a test file that is missing");
    set_refused(folder, "transforms:test-file=../x", "'test-file'", "and one that climbs out");
    folder = make_set("{\"camera_angle_x\":1,\"w\":8,\"h\":6,\"fl_x\":5,\"fl_y\":5,\"frames\":["
                      "{\"file_path\":\"a/0\",\"fl_x\":6,\"fl_y\":6,\"transform_matrix\":"
                      "[[1,0,0,3],[0,-1,0,0],[0,0,-1,0]]}," FRAME("a/1", "1") "]}",
                      NULL);
    if (set_opens(folder, NULL, &views, "a set without transforms_test.json, a 3 x 4 matrix")) {
        ok(!views.view[0].test && views.view[0].time == 0, "trains, and no time is 0");
        ok(views.view[0].camera.fx == 6 && views.view[1].camera.fx == 5,
           "a frame's own focal length wins over the file's, and that over the angle");
        spin_views_free(&views);
    }
}

static void test_lies(void)
{
#define ONE(frame) "{\"camera_angle_x\":1,\"frames\":[" frame "]}"
#define WITH(pose) ONE("{\"file_path\":\"a/0\",\"transform_matrix\":" pose "}")
#define TOP(top) "{" top ",\"frames\":[" FRAME("a/0", "0") "]}"
    static const struct {
        const char *text, *word, *what;
    } cases[] = {
        {"[]", "JSON object", "a list in place of an object"},
        {"{\"camera_angle_x\":1}", "no list 'frames'", "no frames"},
        {"{\"camera_angle_x\":1,\"frames\":[]}", "is empty", "an empty list of frames"},
        {ONE("3"), "'file_path'", "a frame that is a number"},
        {TOP("\"x\":1"), "neither 'fl_x' nor 'camera_angle_x'", "no focal length"},
        {TOP("\"camera_angle_x\":\"1\""), "'camera_angle_x' is not a number", "a text as an angle"},
        {TOP("\"camera_angle_x\":0"), "expected 0 to pi", "an angle of 0"},
        {TOP("\"camera_angle_x\":3.2"), "expected 0 to pi", "an angle above pi"},
        {TOP("\"fl_x\":-1"), "focal", "a negative focal length"},
        {TOP("\"fl_x\":9,\"cx\":9"), "principal point", "a principal point outside"},
        {TOP("\"fl_x\":9,\"w\":16,\"h\":12"), "'w' and 'h'", "another size than the image's"},
        {TOP("\"fl_x\":9,\"w\":8"), "no number 'h'", "a width without a height"},
        {TOP("\"fl_x\":9,\"w\":1e9,\"h\":6"), "image size", "an absurd size"},
        {TOP("\"fl_x\":9,\"k1\":0.1"), "'k1' is 0.1", "distortion"},
        {TOP("\"fl_x\":9,\"camera_model\":\"OPENCV_FISHEYE\""), "OPENCV_FISHEYE", "a fisheye"},
        {WITH("7"), "4 x 4", "a pose that is a number"},
        {WITH("[[1,0,0,3],[0,1,0,0]]"), "4 x 4", "a pose of two rows"},
        {WITH("[[1,0,0],[0,1,0],[0,0,1]]"), "4 x 4", "a pose of three columns"},
        {WITH("[[1,0,0,null],[0,1,0,0],[0,0,1,0]]"), "not a number", "null in a pose"},
        {WITH("[[1,0,0,NaN],[0,1,0,0],[0,0,1,0]]"), "transforms_train.json", "NaN in a pose"},
        {WITH("[[1.01,0,0,3],[0,1,0,0],[0,0,1,0]]"), "orthonormal", "a pose that scales"},
        {WITH("[[1,0,0,3],[0,1,0,0],[0,0,-1,0]]"), "reflection", "a pose that mirrors"},
        {WITH("[[1,0,0,3],[0,1,0,0],[0,0,1,0],[0,0,1,1]]"), "last row", "a wrong last row"},
        {ONE("{\"file_path\":\"a/0\"}"), "no 'transform_matrix'", "no pose"},
        {ONE(FRAME("a/0", "\"0\"")), "'time'", "a time that is text"},
        {ONE(FRAME("../a/0", "0")), "below the folder", "a path that climbs out"},
        {ONE(FRAME("/etc/x", "0")), "below the folder", "an absolute path"},
        {ONE(FRAME("a/7", "0") "," FRAME("a/8", "0") "," FRAME("a/1", "0")),
         "2 of 3 images are missing", "missing images"},
    };

    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++)
        set_refused(make_set(cases[i].text, NULL), NULL, cases[i].word, cases[i].what);
    ok(set_truncations(make_set(ONE(FRAME("a/0", "0")), NULL), "transforms_train.json", NULL) == 0,
       "no truncation of transforms_train.json can be read");
}

/* ---- transforms.json of nerfstudio ------------------------------------------------------------
 */

#define LENS                                                                                       \
    "{\"camera_model\":\"OPENCV\",\"fl_x\":7,\"fl_y\":9,\"cx\":3,\"cy\":2,\"w\":8,\"h\":6,"        \
    "\"k1\":0,\"k2\":0.0,\"p1\":0,\"p2\":0,"
#define APPLIED "\"applied_transform\":[[0,1,0,5],[0,0,1,0],[1,0,0,0]],"
#define STILL(path, more)                                                                          \
    "{\"file_path\":\"" path "\"," more "\"colmap_im_id\":1,\"transform_matrix\":" POSE "}"

static const char *make_one(const char *head, const char *frames)
{
    const char *folder = new_folder();
    static char text[4000];

    snprintf(text, sizeof text, "%s\"frames\":[%s]}", head, frames);
    make_text(folder, "transforms.json", text);
    make_folder(folder, "images");
    for (int camera = 0; camera < 3; camera++)
        for (int i = 0; i < 4; i++) {
            char name[40];

            snprintf(name, sizeof name, "images/cam%02d_%04d.png", camera + 4, i);
            make_image(folder, name, 8, 6);
            snprintf(name, sizeof name, "images/frame_%05d.png", 4 * camera + i);
            make_image(folder, name, 8, 6);
        }
    return folder;
}

static int n_tests(const struct spin_views *views)
{
    int n = 0;

    for (size_t i = 0; i < views->n; i++)
        n += views->view[i].test;
    return n;
}

static void test_one_file(void)
{
    struct spin_views views;
    char frames[4000], timed[4000];
    const char *folder;
    size_t used = 0, used_timed = 0;

    for (int i = 9; i >= 0; i--) /* not in the order of their names; one has a lens of its own */
        used += (size_t)snprintf(
            frames + used, sizeof frames - used,
            "%s{\"file_path\":\"./images/frame_%05d.png\",%s"
            "\"transform_matrix\":" POSE "}",
            used ? "," : "", i,
            i == 3 ? "\"fl_x\":11,\"fl_y\":12,\"cx\":4,\"cy\":3,\"w\":8,\"h\":6," : "");
    for (int i = 0; i < 12; i++)
        used_timed += (size_t)snprintf(timed + used_timed, sizeof timed - used_timed,
                                       "%s{\"file_path\":\"images/cam%02d_%04d.png\",\"time\":%g,"
                                       "\"transform_matrix\":" POSE "}",
                                       used_timed ? "," : "", i / 4 + 4, i % 4, i % 4 / 3.0);
    folder = make_one(LENS APPLIED, frames);
    if (set_opens(folder, NULL, &views, "nerfstudio's transforms.json is recognised and read")) {
        const struct spin_view *own = view_of(&views, "frame_00003.png"),
                               *other = view_of(&views, "frame_00008.png");
        int ids = 0;

        for (size_t i = 0; i < views.n; i++)
            ids |= 1 << views.view[i].camera_id;
        ok(views.n == 10 && views.n_dataset_frames == 1 && ids == 1023,
           "without times all images are of one frame, each a camera of its own");
        ok(n_tests(&views) == 2 && other->test && view_of(&views, "frame_00000.png")->test,
           "each 8th by name is held out");
        ok(own->camera.fx == 11 && own->camera.fy == 12 && own->camera.cx == 4 &&
               own->camera.cy == 3 && other->camera.fx == 7 && other->camera.cy == 2,
           "a frame's own lens is its own only");
        ok(other->camera.w2c[3] == -3 && other->camera.w2c[5] == 1 && other->camera.w2c[0] == 1,
           "poses are as they stand, whatever was applied to them");
        spin_views_free(&views);
    }
    if (set_opens(folder, "transforms:hold=5", &views, "each 5th held out")) {
        ok(n_tests(&views) == 2 && view_of(&views, "frame_00005.png")->test, "are two of ten");
        spin_views_free(&views);
    }
    if (set_opens(folder, "transforms:hold=0", &views, "nothing held out")) {
        ok(n_tests(&views) == 0, "all train");
        spin_views_free(&views);
    }
    set_refused(folder, "transforms:test-file=x.json",
                "'test-file' applies to 'transforms_train.json'",
                "a test file beside transforms.json");
    folder = make_one(LENS "\"test_filenames\":[\"images/frame_00004.png\"],\"val_filenames\":"
                           "[\"./images/frame_00006.png\"],\"train_filenames\":[],",
                      frames);
    if (set_opens(folder, NULL, &views, "lists of what is held out")) {
        ok(n_tests(&views) == 2 && view_of(&views, "frame_00004.png")->test &&
               view_of(&views, "frame_00006.png")->test,
           "are followed");
        spin_views_free(&views);
    }
    if (set_opens(folder, "transforms:hold=10", &views, "and an option")) {
        ok(n_tests(&views) == 1 && view_of(&views, "frame_00000.png")->test, "instead of them");
        spin_views_free(&views);
    }
    folder = make_one(LENS, timed);
    if (set_opens(folder, NULL, &views, "cameras at several times")) {
        ok(views.n_dataset_frames == 4 && n_tests(&views) == 4 &&
               view_of(&views, "cam04_0002.png")->test &&
               !view_of(&views, "cam05_0000.png")->test &&
               view_of(&views, "cam06_0003.png")->dataset_frame == 3 &&
               view_of(&views, "cam06_0003.png")->camera_id == 6,
           "the first camera is held out, frames are the times");
        spin_views_free(&views);
    }
    make_text(folder, "transforms.json",
              LENS "\"frames\":[" FRAME("images/cam04_0000.png", "0") "," FRAME(
                  "images/cam04_0001.png", "0.5") "," FRAME("images/cam04_0002.png", "1") "]}");
    if (set_opens(folder, NULL, &views, "one camera at several times")) {
        ok(views.n == 3 && n_tests(&views) == 1, "is not held out as a whole");
        spin_views_free(&views);
    }
    folder = make_one(
        LENS, FRAME("images/frame_00004.png", "0") "," FRAME("images/frame_00007.png", "0.5"));
    if (set_opens(folder, NULL, &views, "numbers that differ between times only")) {
        ok(views.n == 2 && views.n_dataset_frames == 2 && views.view[0].camera_id == 0 &&
               views.view[1].camera_id == 0,
           "are of one moving camera");
        spin_views_free(&views);
    }
    for (int k = 0; k < 4; k++)
        make_image(folder, (const char *[]){"3-0.png", "5-0.png", "3-1.png", "5-1.png"}[k], 8, 6);
    make_text(folder, "transforms.json",
              LENS "\"frames\":[" FRAME("5-0.png", "0") "," FRAME("3-0.png", "0") "," FRAME(
                  "5-1.png", "1") "," FRAME("3-1.png", "1") "]}");
    if (set_opens(folder, NULL, &views, "two numbers in each name")) {
        ok(views.n == 4 && view_of(&views, "5-0.png")->camera_id == 5 &&
               view_of(&views, "5-1.png")->camera_id == 5 &&
               view_of(&views, "3-0.png")->camera_id == 3 &&
               view_of(&views, "3-1.png")->camera_id == 3 && n_tests(&views) == 2 &&
               view_of(&views, "3-1.png")->test,
           "the one that differs between images of one time is that of the camera");
        spin_views_free(&views);
    }
    make_text(folder, "transforms_train.json",
              LENS "\"frames\":[" FRAME("images/frame_00004.png", "0") "]}");
    if (set_opens(folder, NULL, &views, "transforms.json beside the files of D-NeRF")) {
        ok(views.n == 1 && !views.view[0].test, "is not read");
        spin_views_free(&views);
    }
    set_refused(folder, "transforms:hold=3", "'hold' applies to 'transforms.json'",
                "nor its option");
    set_refused(
        make_one("{\"camera_model\":\"OPENCV\",\"fl_x\":9,\"k1\":0.1,\"p2\":0.001,", frames), NULL,
        "'k1' is 0.1: images with lens distortion must be undistorted", "distortion");
    set_refused(make_one(LENS, STILL("images/cam04_0000.png", "\"p2\":-0.001,")), NULL,
                "transforms.json': frame 0: 'p2' is -0.001", "distortion of one frame");
    set_refused(
        make_one(LENS, STILL("images/cam04_0000.png", "\"camera_model\":\"OPENCV_FISHEYE\",")),
        NULL, "OPENCV_FISHEYE", "a fisheye of one frame");
    set_refused(make_one(LENS, STILL("images/none.png", "")), NULL, "1 of 1 image is missing",
                "an image that is missing");
    set_refused(make_one(LENS, ""), NULL, "is empty", "no frames");
}

TAP_MAIN
{
    spin_log_set_level(-2);
    test_own();
    test_lies();
    test_one_file();
    each_set("blender", test_blender);
    each_set("dynerf", test_n3v);
}
