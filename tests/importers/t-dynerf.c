/* dynerf: poses_bounds.npy with frames in three layouts against the true cameras and what
 * 4DGaussians' reader yields, and malformed arrays.
 * K: dynerf import views */
#include "io/video.h"
#include "tests/importers/sets.h"

/* ---- Fixtures -------------------------------------------------------------------------------- */

/* 4DGaussians halves the focal length whatever the size of the images is (1352/2704). */
#define REFERENCE_FOCAL 0.5

static void compare_split(const struct spin_views *views, struct spin_npz *npz, bool test,
                          const spin_json *manifest, const char *name)
{
    const char *prefix = test ? "test" : "train";
    double abs = manifest_tolerance(manifest, "abs", 2e-5), worst = 0, *m, *time, *focal;
    double rel = manifest_tolerance(manifest, "rel", 2e-5);
    struct spin_array info;
    char key[40];
    float *got = malloc(views->n * 16 * sizeof *got), focal_got = 0;
    size_t n = 0, n_expected;

    snprintf(key, sizeof key, "hustvl_%s_w2c", prefix);
    m = check_load(npz, key, &info);
    snprintf(key, sizeof key, "hustvl_%s_time", prefix);
    time = check_load(npz, key, &info);
    n_expected = time ? (size_t)info.count : 0;
    snprintf(key, sizeof key, "hustvl_%s_focal", prefix);
    focal = check_load(npz, key, &info);
    /* The reference's order: camera by camera. */
    for (int camera = 0; camera < 100 && time; camera++) {
        for (size_t i = 0; i < views->n; i++) {
            const struct spin_view *v = &views->view[i];

            if (v->test != test || v->camera_id != camera)
                continue;
            pose_of(v, got + 16 * n);
            worst = larger(worst, fabs(v->time - time[n]));
            focal_got = (float)(v->camera.fx * REFERENCE_FOCAL);
            n++;
        }
    }
    ok(n == n_expected, "%s: %zu views in %s", name, n, prefix);
    snprintf(key, sizeof key, "%s: %s poses", name, prefix);
    if (m && n == n_expected)
        check_close(got, m, 16 * n, abs, rel, key);
    near(worst, 0, 1e-12, "times are index/300 as 4DGaussians has them");
    if (focal)
        near(focal_got, *focal, 1e-5, "focal length");
    free(got);
    free(m);
    free(time);
    free(focal);
}

static void compare_truth(const struct spin_views *views, struct spin_npz *npz,
                          const spin_json *manifest, const char *name)
{
    struct spin_array info;
    double *m = check_load(npz, "gt_w2c", &info);
    size_t n = m ? (size_t)info.shape[0] : 0;
    float *got = calloc(n * 16 + 1, sizeof *got);
    char what[100];

    for (size_t i = 0; i < views->n; i++) {
        if (views->view[i].dataset_frame == 0 && (size_t)views->view[i].camera_id < n)
            pose_of(&views->view[i], got + 16 * views->view[i].camera_id);
    }
    snprintf(what, sizeof what, "%s: the true cameras", name);
    if (m)
        check_close(got, m, 16 * n, manifest_tolerance(manifest, "abs", 2e-5),
                    manifest_tolerance(manifest, "rel", 2e-5), what);
    free(m);
    free(got);
}

static void test_set(const char *folder, const char *name, const spin_json *manifest)
{
    struct spin_views views;
    struct spin_npz npz;
    char used[32] = "";
    double frames = -1, cameras = -1;

    if (!spin_json_get(manifest, "expected")) {
        set_cases(folder, "dynerf", manifest);
        return;
    }
    if (!ok(spin_views_open(folder, NULL, &views, used, sizeof used) == SPIN_OK &&
                strcmp(used, "dynerf") == 0,
            "%s: is recognised and read", name)) {
        printf("#   %s\n", spin_last_error());
        return;
    }
    spin_json_number(spin_json_get(manifest, "frames"), &frames);
    spin_json_number(spin_json_get(manifest, "cameras"), &cameras);
    near(views.n_dataset_frames, frames, 0, "has as many frames as the manifest says");
    near((double)views.n, frames * cameras, 0, "and a view of every camera in each");
    ok(views.numbered && views.view[0].number == 0, "%s: frames have numbers", name);
    if (ok(spin_npz_open(path_in(folder, "expected.npz"), &npz) == SPIN_OK, "%s: has expected.npz",
           name)) {
        compare_truth(&views, &npz, manifest, name);
        compare_split(&views, &npz, false, manifest, name);
        compare_split(&views, &npz, true, manifest, name);
        spin_npz_close(&npz);
    }
    spin_views_free(&views);
    set_cases(folder, "dynerf", manifest);
}

/* ---- Files made here ------------------------------------------------------------------------- */

enum { N_COLUMNS = 17, VIDEO_W = 64, VIDEO_H = 48 };

/* Looks along +z from (camera, 0, 0): LLFF columns [down, right, back]. */
static void plain_row(double row[N_COLUMNS], int camera)
{
    static const double plain[N_COLUMNS] = {0, 1, 0, 0, 6, 1, 0, 0, 0, 8, 0, 0, -1, 0, 10, 1, 9};

    memcpy(row, plain, sizeof plain);
    row[3] = camera;
}

static void make_poses(const char *folder, const double *rows, int n_rows, int n_columns)
{
    char header[128];
    unsigned char bytes[8192];
    size_t n = (size_t)n_rows * (size_t)n_columns * sizeof *rows;
    int n_header = snprintf(header, sizeof header,
                            "{'descr': '<f8', 'fortran_order': False, 'shape': (%d, %d), }", n_rows,
                            n_columns);

    memcpy(bytes, "\x93NUMPY\1\0", 8);
    bytes[8] = 118;
    bytes[9] = 0;
    memset(bytes + 10, ' ', 118);
    memcpy(bytes + 10, header, (size_t)n_header);
    bytes[127] = '\n';
    memcpy(bytes + 128, rows, n);
    make_file(folder, "poses_bounds.npy", bytes, 128 + n);
}

/* Two cameras; layout 0: cam<NN>/images, 1: images/, 2: frames/, 3: nothing. Two frames. */
static const char *make_set(int layout, int width, int height)
{
    const char *folder = new_folder();
    double rows[2 * N_COLUMNS];
    char name[64];

    plain_row(rows, 0);
    plain_row(rows + N_COLUMNS, 1);
    make_poses(folder, rows, 2, N_COLUMNS);
    for (int f = 0; f < 2 && layout < 3; f++) {
        for (int c = 0; c < 2; c++) {
            static const char *const folders[] = {"cam%02d/images", "images", "frames/%04d/images"};

            snprintf(name, sizeof name, folders[layout], layout == 0 ? 9 + c : f);
            make_folder(folder, name);
            if (layout == 0)
                snprintf(name, sizeof name, "cam%02d/images/%04d.png", 9 + c, f);
            else if (layout == 1)
                snprintf(name, sizeof name, "images/cam_%d_%04d.png", 9 + c, f);
            else
                snprintf(name, sizeof name, "frames/%04d/images/cam%02d.png", f, 9 + c);
            make_image(folder, name, width, height);
        }
    }
    return folder;
}

static void test_layouts(void)
{
    static const char *const what[] = {"folders of cameras", "one folder of images",
                                       "folders of frames"};
    struct spin_views views;
    const char *folder;
    char name[600];

    for (int layout = 0; layout < 3; layout++) {
        if (!set_opens(make_set(layout, 8, 6), NULL, &views, what[layout]))
            continue;
        ok(views.n == 4 && views.n_dataset_frames == 2 && views.numbered,
           "has two frames of two cameras");
        ok(views.view[0].camera_id == 9 && views.view[1].camera_id == 10 && views.view[0].test &&
               !views.view[1].test && views.view[1].camera.w2c[3] == -1,
           "rows of poses_bounds go to the cameras in the order of their numbers");
        ok(views.view[0].camera.w2c[0] == 1 && views.view[0].camera.w2c[5] == 1 &&
               views.view[0].camera.w2c[10] == 1,
           "and LLFF's axes become OpenCV's");
        spin_views_free(&views);
    }
    folder = make_set(2, 8, 6);
    snprintf(name, sizeof name, "%s", path_in(folder, "frames/0000"));
    ok(rename(name, path_in(folder, "frames/1.5")) == 0, "folders of frames with");
    snprintf(name, sizeof name, "%s", path_in(folder, "frames/0001"));
    ok(rename(name, path_in(folder, "frames/0.25")) == 0, "times as names");
    if (set_opens(folder, NULL, &views, "decimal numbers")) {
        ok(views.n == 4 && views.n_dataset_frames == 2 && views.view[0].dataset_frame == 0 &&
               strstr(views.view[0].path, "/0.25/") && strstr(views.view[3].path, "/1.5/") &&
               views.view[0].number == 0 && views.view[3].number == 1,
           "only give the order of the frames");
        spin_views_free(&views);
    }
    if (set_opens(make_set(0, 8, 6), "dynerf:offsets=cam09=-1", &views, "a camera that is early")) {
        ok(views.n == 3 && views.view[0].camera_id == 9 && strstr(views.view[0].path, "0001.png"),
           "loses its first image");
        spin_views_free(&views);
    }
    if (set_opens(make_set(0, 4, 3), NULL, &views, "images of half the size")) {
        const struct spin_camera *c = &views.view[0].camera;

        ok(c->width == 4 && c->height == 3 && c->fx == 5 && c->fy == 5 && c->cx == 2 &&
               c->cy == 1.5,
           "get a camera of half the size");
        spin_views_free(&views);
    }
}

static void test_options(void)
{
    static const struct {
        const char *from;
        double time;
    } rules[] = {{"dynerf", 1.0 / 300},
                 {"dynerf:time=unit", 1},
                 {"dynerf:time=count", 0.5},
                 {"dynerf:time=row", 1},
                 {"dynerf:time=30", 1.0 / 30}};
    const char *folder = make_set(0, 8, 6);
    struct spin_views views;
    char used[64] = "";

    for (size_t i = 0; i < sizeof rules / sizeof *rules; i++) {
        if (!set_opens(folder, rules[i].from, &views, rules[i].from))
            continue;
        near(views.view[3].time, rules[i].time, 1e-15, "is the time of the second frame");
        spin_views_free(&views);
    }
    ok(spin_views_open(folder, "dynerf:test=-1,time=row", &views, used, sizeof used) == SPIN_OK &&
           strcmp(used, "dynerf:test=-1,time=row") == 0 && !views.view[0].test,
       "nothing is held out when asked, and the options are handed on");
    spin_views_free(&views);
    set_refused(folder, "dynerf:time=0", "'time'", "a time rule that divides by 0");
    set_refused(folder, "dynerf:test=2", "camera, 0 to 1",
                "a camera to hold out that is not there");
    set_refused(folder, "dynerf:test=x", "whole number", "and one that is no number");
    set_refused(folder, "dynerf:speed=2", "no option 'speed'", "an option it does not have");
    set_refused(folder, "dynerf:time", "no value", "an option without a value");
    set_refused(folder, "panoptic:time=1", "no option 'time'", "an option of another reader");
}

static void test_lies(void)
{
    static const struct {
        int column;
        double value;
        const char *word, *what;
    } cases[] = {
        {1, 1.01, "orthonormal", "a pose that scales"},
        {1, -1, "reflection", "a pose that mirrors"},
        {3, NAN, "column 3", "NaN in a pose"},
        {8, INFINITY, "column 8", "infinity"},
        {14, 0, "focal", "a focal length of 0"},
        {14, -3, "focal", "a negative focal length"},
        {9, 8.5, "image size", "half a pixel"},
        {9, 1e9, "image size", "an absurd size"},
        {9, 12, "another aspect ratio", "images of another aspect ratio"},
    };
    double rows[3 * N_COLUMNS];
    const char *folder = make_set(0, 8, 6);

    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        plain_row(rows, 0);
        plain_row(rows + N_COLUMNS, 1);
        rows[N_COLUMNS + cases[i].column] = cases[i].value;
        make_poses(folder, rows, 2, N_COLUMNS);
        set_refused(folder, NULL, cases[i].word, cases[i].what);
    }
    plain_row(rows + 2 * N_COLUMNS, 2);
    make_poses(folder, rows, 3, N_COLUMNS);
    set_refused(folder, NULL, "3 rows", "more rows than cameras");
    make_poses(folder, rows, 2, 15);
    set_refused(folder, NULL, "[2, 15]", "rows of 15 columns");
    make_poses(folder, rows, 0, N_COLUMNS);
    set_refused(folder, NULL, "[0, 17]", "no rows");
    plain_row(rows, 0);
    plain_row(rows + N_COLUMNS, 1);
    make_poses(folder, rows, 2, N_COLUMNS);
    ok(set_truncations(folder, "poses_bounds.npy", NULL) == 0,
       "no truncation of poses_bounds.npy can be read");
}

static void test_gaps(void)
{
    const char *folder = make_set(0, 8, 6);
    struct spin_views views;

    make_image(folder, "cam10/images/0002.png", 8, 6);
    if (set_opens(folder, NULL, &views, "a camera with a frame less at its end")) {
        ok(views.n == 5 && views.n_dataset_frames == 3, "has the others");
        spin_views_free(&views);
    }
    make_image(folder, "cam09/images/0003.png", 8, 6);
    if (set_opens(folder, NULL, &views, "a frame missing between")) {
        ok(views.n == 6 && views.n_dataset_frames == 4, "is left out");
        spin_views_free(&views);
    }
    remove(path_in(folder, "cam09/images/0003.png"));
    make_text(folder, "cam09/images/0001.jpg", "x");
    set_refused(folder, NULL, "are both frame 1", "a frame that is there twice");
}

static void test_videos(void)
{
    const char *folder = make_set(3, 0, 0);

    set_refused(folder, NULL, "no images", "neither frames nor videos");
    make_text(folder, "cam00.mp4", "x");
    make_text(folder, "cam_1.mp4", "x");
    set_refused(folder, NULL,
                spin_video_start() == SPIN_OK ? "cannot read video" : "libavformat-dev",
                "videos that are none, or a build that cannot read them");
    make_folder(folder, "cam00/images");
    set_refused(folder, NULL, "interrupted", "an empty folder of images");
    make_image(folder, "cam00/images/0000.png", 8, 6);
    {
        struct spin_views views;

        if (set_opens(folder, NULL, &views, "frames of one of two videos")) {
            ok(views.n == 1 && views.view[0].camera_id == 0, "are its camera's");
            spin_views_free(&views);
        }
    }
    make_image(folder, "cam00/images/x.png", 8, 6);
    set_refused(folder, NULL, "no frame number", "an image without a number");
    for (int i = 0; i < 2; i++) {
        const char *name = i ? "cam00.avi" : "cam00.webm";
        char word[64];

        folder = make_set(3, 0, 0);
        make_text(folder, name, "x");
        snprintf(word, sizeof word, "%s': not a readable MP4", name);
        set_refused(folder, NULL, spin_video_start() == SPIN_OK ? word : "1 videos",
                    "videos that are known by name and cannot be read");
    }
}

/* Reads the pixels of every view in a non-sequential order, and compares them with the image at
 * the view's path (tests/io/t-video.c compares those with the encoded ones). Returns the largest
 * difference. */
static double read_all_views(struct spin_image_cache *pixels, const struct spin_views *views)
{
    const size_t plane = VIDEO_W * VIDEO_H;
    float *image = malloc(3 * plane * sizeof *image);
    double worst = 0;

    for (size_t i = 0; i < views->n; i++) {
        size_t at = i * 7 % views->n;
        uint8_t *rgb = NULL;
        int width, height;

        if (spin_image_cache_get(pixels, at, image) != SPIN_OK ||
            spin_image_read(views->view[at].path, NULL, &width, &height, &rgb) != SPIN_OK) {
            printf("# %s\n", spin_last_error());
            worst = INFINITY;
        }
        for (size_t k = 0; rgb && k < 3 * plane; k++)
            worst = larger(worst, fabs(image[k] - rgb[3 * (k % plane) + k / plane] / 255.0));
        free(rgb);
    }
    free(image);
    return worst;
}

/* Makes the video of a camera. Returns false if this FFmpeg cannot. */
static bool make_video(const char *folder, int camera, int frames, int fps, int dropped)
{
    const char *build = getenv("SPIN_BUILD");
    char command[9000];

    snprintf(
        command, sizeof command, "'%s/tests/tools/make-video' '%s/cam%02d.mp4' %d %d %d 0 %d %d",
        build ? build : "build/release", folder, camera, frames, VIDEO_W, VIDEO_H, fps, dropped);
    return spin_video_start() == SPIN_OK && system(command) == 0;
}

/* Returns the frame of the video that is the image of a camera in a frame of the data set, or -1.
 */
static int frame_of_view(const struct spin_views *views, int frame, int camera)
{
    for (size_t i = 0; i < views->n; i++)
        if (views->view[i].dataset_frame == frame && views->view[i].camera_id == camera)
            return (int)strtol(strrchr(views->view[i].path, '#') + 1, NULL, 10);
    return -1;
}

static void test_rates(void)
{
    const char *folder = make_set(3, 0, 0);
    struct spin_views views;

    if (!make_video(folder, 0, 12, 30, 99) || !make_video(folder, 1, 24, 60, 99)) {
        skip("videos of different rates", "no FFmpeg, or it cannot encode");
        return;
    }
    if (set_opens(folder, NULL, &views, "videos of 30 and 60 frames per second")) {
        ok(views.n_dataset_frames == 12 && frame_of_view(&views, 7, 0) == 7 &&
               frame_of_view(&views, 7, 1) == 14,
           "are paired by time, at the lower rate");
        spin_views_free(&views);
    }
    make_video(folder, 0, 10, 25, 99);
    make_video(folder, 1, 12, 30, 99);
    if (set_opens(folder, NULL, &views, "videos of 25 and 30 frames per second")) {
        ok(views.n_dataset_frames == 10 && frame_of_view(&views, 4, 1) == 5 &&
               frame_of_view(&views, 9, 1) == 11,
           "are paired with the nearest frame");
        spin_views_free(&views);
    }
    if (set_opens(folder, "dynerf:offsets=cam01=0.2s", &views, "a camera that starts later")) {
        ok(frame_of_view(&views, 4, 1) == -1 && frame_of_view(&views, 5, 1) == 0,
           "lacks the frames before");
        spin_views_free(&views);
    }
    make_video(folder, 0, 12, 30, 5);
    make_video(folder, 1, 13, 30, 99);
    if (set_opens(folder, NULL, &views, "a video that lacks a frame")) {
        ok(views.n_dataset_frames == 13 && frame_of_view(&views, 5, 0) == -1 &&
               frame_of_view(&views, 6, 0) == 5 && frame_of_view(&views, 12, 0) == 11 &&
               frame_of_view(&views, 5, 1) == 5,
           "is paired by its time stamps");
        spin_views_free(&views);
    }
    make_video(folder, 0, 13, 30, 99);
    if (set_opens(folder, "dynerf:offsets=cam01=-2", &views, "a camera that starts earlier")) {
        ok(frame_of_view(&views, 0, 1) == 2 && frame_of_view(&views, 10, 1) == 12, "by two frames");
        spin_views_free(&views);
    }
}

static void test_from_videos(void)
{
    const char *folder = make_set(3, 0, 0), *build = getenv("SPIN_BUILD");
    struct spin_image_cache pixels, none;
    struct spin_views views;
    char command[9000];
    int failed = spin_video_start() != SPIN_OK;

    for (int c = 0; c < 2 && !failed; c++) {
        snprintf(command, sizeof command, "'%s/tests/tools/make-video' '%s/cam%02d.%s' 12 %d %d %d",
                 build ? build : "build/release", folder, c, c ? "mkv" : "mp4", VIDEO_W, VIDEO_H,
                 c);
        failed = system(command) != 0;
    }
    failed = failed || rename(path_in(folder, "cam01.mkv"), path_in(folder, "cam01.webm")) != 0;
    if (failed) {
        skip("views straight from videos", "no FFmpeg, or it cannot encode");
        return;
    }
    if (!set_opens(folder, NULL, &views, "two videos and no frames"))
        return;
    ok(views.n == 24 && views.n_dataset_frames == 12 && views.numbered &&
           views.view[23].number == 11,
       "have twelve frames of two cameras");
    ok(view_of(&views, "cam01.webm#11") && views.view[0].camera.width == VIDEO_W &&
           views.view[0].camera.fx == 10.0 * VIDEO_W / 8,
       "whose paths name them, in cameras of the videos' size");
    ok(spin_image_cache_open(&views, SIZE_MAX, NULL, &pixels) == SPIN_OK &&
           spin_image_cache_open(&views, 0, NULL, &none) == SPIN_OK,
       "opens their pixels");
    ok(read_all_views(&none, &views) < 1e-6 && none.held == 0,
       "frames are right when none is kept");
    ok(read_all_views(&pixels, &views) < 1e-6, "and when all are");
    spin_image_cache_close(&pixels);
    if (spin_image_cache_open(&views, SIZE_MAX, NULL, &pixels) == SPIN_OK) {
        float *image = malloc(3 * VIDEO_W * VIDEO_H * sizeof *image);

        ok(spin_image_cache_get(&none, 0, image) ==
                   SPIN_OK && /* the decoder is at the first frame */
               spin_image_cache_get(&pixels, 2 * 6, image) == SPIN_OK &&
               pixels.held == 6 * 3 * VIDEO_W * VIDEO_H,
           "what is decoded on the way is kept");
        free(image);
        spin_image_cache_close(&pixels);
    }
    spin_image_cache_close(&none);
    spin_views_free(&views);
}

TAP_MAIN
{
    spin_log_set_level(-2);
    test_layouts();
    test_options();
    test_lies();
    test_gaps();
    test_videos();
    test_from_videos();
    test_rates();
    each_set("dynerf", test_set);
}
