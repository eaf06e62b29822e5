/* colmap: binary and text models against what the reference reader yields, one folder per frame,
 * and malformed files.
 * K: colmap import views */
#include "tests/importers/sets.h"

/* ---- Fixtures -------------------------------------------------------------------------------- */

static int by_path(const void *a, const void *b)
{
    return strcmp(((const struct spin_view *)a)->path, ((const struct spin_view *)b)->path);
}

static void compare_model(struct spin_views *views, const char *folder, const char *name,
                          const spin_json *manifest)
{
    double abs = manifest_tolerance(manifest, "abs", 2e-6), *pose, *fov, *held;
    double rel = manifest_tolerance(manifest, "rel", 2e-6);
    float *got_pose = malloc(views->n * 16 * sizeof(float)),
          *got_fov = malloc(views->n * 2 * sizeof(float));
    struct spin_array info, held_info;
    struct spin_npz npz;
    size_t n_held = 0;
    bool right = true;

    if (!ok(spin_npz_open(path_in(folder, "expected.npz"), &npz) == SPIN_OK, "%s: has expected.npz",
            name))
        return;
    qsort(views->view, views->n, sizeof *views->view, by_path);
    for (size_t i = 0; i < views->n; i++) {
        const struct spin_camera *c = &views->view[i].camera;

        pose_of(&views->view[i], got_pose + 16 * i);
        got_fov[2 * i] = (float)(2 * atan(c->width / (2 * c->fx)));
        got_fov[2 * i + 1] = (float)(2 * atan(c->height / (2 * c->fy)));
        n_held += views->view[i].test;
    }
    pose = check_load(&npz, "w2c", &info);
    fov = check_load(&npz, "fov", &info);
    held = check_load(&npz, "test_index_llffhold8", &held_info);
    if (pose && fov && ok(info.shape[0] == views->n, "%s: %zu views", name, views->n)) {
        check_close(got_pose, pose, 16 * views->n, abs, rel, "poses, sorted by name");
        check_close(got_fov, fov, 2 * views->n, abs, rel, "angles of view");
    }
    for (uint64_t i = 0; held && i < held_info.count; i++)
        right = right && views->view[(size_t)held[i]].test;
    ok(held && right && n_held == held_info.count, "%s: each eighth by name is held out", name);
    free(got_pose);
    free(got_fov);
    free(pose);
    free(fov);
    free(held);
    spin_npz_close(&npz);
}

static void test_set(const char *folder, const char *name, const spin_json *manifest)
{
    struct spin_views views;
    char used[32] = "";

    if (spin_json_get(manifest, "expected")) {
        if (ok(spin_views_open(folder, NULL, &views, used, sizeof used) == SPIN_OK &&
                   strcmp(used, "colmap") == 0,
               "%s: is recognised and read", name)) {
            ok(views.n_dataset_frames == (int)views.n, "%s: each image is a frame", name);
            compare_model(&views, folder, name, manifest);
            spin_views_free(&views);
        } else {
            printf("#   %s\n", spin_last_error());
        }
    }
    set_cases(folder, "colmap", manifest);
}

/* ---- Files made here ------------------------------------------------------------------------- */

static const char lenses[] = "# comment\n1 PINHOLE 8 6 10 11 3 2\n2 OPENCV 8 6 9 9 4 3 0 0 0 0\n";
static const char images[] = "# two lines per image\n"
                             "7 1 0 0 0 1 2 3 1 b.png\n"
                             "\n"
                             "3 -2 0 0 0 4 5 6 2 a.png\n"
                             "1 2 -1 3 4 5\n";

static void make_model(const char *folder, const char *cameras_txt, const char *images_txt)
{
    make_folder(folder, "sparse/0");
    make_text(folder, "sparse/0/cameras.txt", cameras_txt);
    make_text(folder, "sparse/0/images.txt", images_txt);
}

static void make_images(const char *folder, const char *where, int width, int height)
{
    char name[64];

    make_folder(folder, where);
    for (int i = 0; i < 2; i++) {
        snprintf(name, sizeof name, "%s/%c.png", where, 'a' + i);
        make_image(folder, name, width, height);
    }
}

static const char *make_set(const char *cameras_txt, const char *images_txt)
{
    const char *folder = new_folder();

    make_model(folder, cameras_txt, images_txt);
    make_images(folder, "images", 8, 6);
    return folder;
}

static void test_text(void)
{
    const char *folder = make_set(lenses, images);
    struct spin_views views;

    if (set_opens(folder, NULL, &views, "a text model whose second lines may be empty")) {
        const struct spin_view *v = views.view;

        ok(views.n == 2 && views.n_dataset_frames == 2 && v[0].dataset_frame == 0 &&
               view_of(&views, "images/b.png") == v && v[1].time == 0.5,
           "frames come in the order of the file, times are i/n");
        ok(v[0].camera.fx == 10 && v[0].camera.fy == 11 && v[0].camera.cx == 3 &&
               v[0].camera.cy == 2 && v[0].camera.w2c[3] == 1,
           "the principal point is the file's");
        ok(v[1].camera.w2c[0] == 1 && v[1].camera.w2c[11] == 6,
           "a quaternion of any length and sign is a rotation");
        ok(v[1].test && !v[0].test && v[1].camera_id == 0, "the first by name is held out");
        spin_views_free(&views);
    }
    make_text(folder, "sparse/0/images.txt",
              "# two\r\n7 1 0 0 0 1 2 3 1 b.png\r\n\r\n"
              "3 -2 0 0 0 4 5 6 2 a.png\r\n\r\n");
    if (set_opens(folder, NULL, &views, "lines that end as on Windows")) {
        ok(views.n == 2 && view_of(&views, "images/b.png") == views.view, "are the same");
        spin_views_free(&views);
    }
    make_text(folder, "sparse/0/images.txt", images);
    if (set_opens(folder, "colmap:time=name,principal=centre,hold=0", &views, "with options")) {
        ok(view_of(&views, "images/a.png") == views.view && views.view[1].time == 0.5,
           "frames come in the order of the names");
        ok(views.view[1].camera.cx == 4 && views.view[1].camera.cy == 3,
           "the principal point is the centre");
        ok(!views.view[0].test && !views.view[1].test, "and nothing is held out");
        spin_views_free(&views);
    }
    make_text(folder, "sparse/0/points3D.txt",
              "# points\n5 1 2 3 9 9 9 0.5 1 2\n\n6 1 2 9 9 9 9 0\n");
    if (set_opens(folder, NULL, &views, "a text model with points"))
        spin_views_free(&views);
    make_text(folder, "sparse/0/points3D.txt", "5 1 x 3\n");
    set_refused(folder, NULL, "point 5", "a point that is no number");
    remove(path_in(folder, "sparse/0/points3D.txt"));
    make_images(folder, "images_2", 4, 3);
    if (set_opens(folder, "colmap:images=images_2", &views, "images of half the size")) {
        const struct spin_camera *c = &views.view[0].camera;

        ok(c->width == 4 && c->height == 3 && c->fx == 5 && c->fy == 5.5 && c->cx == 1.5 &&
               c->cy == 1,
           "get a camera of half the size");
        spin_views_free(&views);
    }
    make_images(folder, "images_2", 4, 4);
    set_refused(folder, "colmap:images=images_2", "another aspect ratio",
                "images of another aspect ratio");
    set_refused(folder, "colmap:images=../x", "'images'", "a folder that climbs out");
    set_refused(folder, "colmap:hold=-2", "'hold'", "a hold below 0");
    set_refused(folder, "colmap:time=x", "'time'", "an unknown time rule");
    set_refused(folder, "colmap:principal=x", "'principal'", "an unknown principal point");
    set_refused(folder, "colmap:images=none", "2 of 2 images are missing", "missing images");
    make_text(folder, "sparse/0/images.txt", "3 1 0 0 0 4 5 6 1 ../a.png\n\n");
    set_refused(folder, NULL, "'../a.png', expected a path below", "an image that climbs out");
}

static void test_frames(void)
{
    const char *folder = new_folder();
    struct spin_views views;
    char name[64];

    for (int f = 0; f < 3; f++) {
        snprintf(name, sizeof name, "frame%06d/images", 8 + f);
        make_images(folder, name, 8, 6);
    }
    make_model(path_in(folder, "frame000008"), lenses, images);
    make_text(folder, "frames.txt", "not a frame");
    if (set_opens(folder, NULL, &views, "a folder per frame")) {
        ok(views.n == 6 && views.n_dataset_frames == 3 && views.numbered &&
               views.view[0].number == 8 && views.view[5].number == 10 && views.view[5].time == 2,
           "has numbered frames");
        ok(views.view[0].test && !views.view[1].test && views.view[4].test,
           "of cameras, the first of which is held out");
        ok(views.view[4].camera.w2c[11] == 6 && views.view[5].camera.w2c[11] == 3 &&
               views.view[5].camera.fy == 11,
           "the first frame's model counts for all");
        spin_views_free(&views);
    }
    if (set_opens(folder, "colmap:hold=2", &views, "with another hold")) {
        ok(views.view[0].test && !views.view[1].test, "it is each second");
        spin_views_free(&views);
    }
    set_refused(folder, "colmap:time=name", "'time'", "a time rule of one model");
    remove(path_in(folder, "frame000010/images/b.png"));
    if (set_opens(folder, NULL, &views, "a camera that misses a frame")) {
        ok(views.n == 5 && views.view[4].dataset_frame == 2 && views.view[4].camera_id == 0,
           "is read without this image");
        spin_views_free(&views);
    }
    make_image(folder, "frame000010/images/b.png", 8, 6);
    remove(path_in(folder, "frame000009/images/a.png"));
    remove(path_in(folder, "frame000009/images/b.png"));
    if (set_opens(folder, NULL, &views, "a frame without images")) {
        ok(views.n == 4 && views.n_dataset_frames == 2 && views.lacks_frames &&
               views.view[2].number == 10 && views.view[2].time == 2,
           "is left out, and the others keep their numbers and times");
        spin_views_free(&views);
    }
    remove(path_in(folder, "frame000010/images/b.png"));
    set_refused(folder, NULL, "3 of 6 images are missing", "half of all images");
    make_folder(folder, "frame8");
    set_refused(folder, NULL, "both frame 8", "two folders of one number");
    set_refused(new_folder(), "colmap", "neither a COLMAP model nor frame folders",
                "an empty folder");
}

/* The fixture's binary model with a few bytes changed. */
static void test_binary(const char *root)
{
    static const struct {
        const char *file;
        size_t offset, n;
        const char *bytes, *word, *what;
    } cases[] = {
        {"cameras.bin", 0, 8, "\xff\xff\xff\xff\xff\xff\xff\x7f", "the file announces",
         "more cameras than bytes"},
        {"cameras.bin", 12, 4, "\x63\0\0\0", "number 99", "an unknown camera model"},
        {"cameras.bin", 12, 4, "\x05\0\0\0", "OPENCV_FISHEYE", "a fisheye"},
        {"cameras.bin", 12, 4, "\xff\xff\xff\xff", "does not define", "a negative camera model"},
        {"cameras.bin", 16, 8, "\xff\xff\xff\xff\0\0\0\0", "image size", "an absurd width"},
        {"cameras.bin", 16, 8, "\0\0\0\0\0\0\0\0", "image size", "no width"},
        {"cameras.bin", 32, 8, "\0\0\0\0\0\0\xf8\x7f", "focal", "a focal length that is NaN"},
        {"cameras.bin", 8, 4, "\x63\0\0\0", "refers to camera",
         "an image of a camera that is not there"},
        {"images.bin", 0, 8, "\xff\xff\xff\0\0\0\0\0", "the file announces",
         "more images than bytes"},
        {"images.bin", 12, 32, "\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0",
         "quaternion", "a quaternion of 0"},
        {"images.bin", 44, 8, "\0\0\0\0\0\0\xf0\x7f", "not finite", "an infinite translation"},
        {"images.bin", 72, 3, "../", "below the folder of images", "a name that climbs out"},
        {"images.bin", 72, 1, "/", "below the folder of images", "an absolute name"},
        {"points3D.bin", 0, 8, "\xff\xff\0\0\0\0\0\0", "points, more than fit into the remaining",
         "more points than bytes"},
        {"points3D.bin", 8 + 43, 8, "\xff\xff\0\0\0\0\0\0", "observations of the point",
         "a point seen more often than there are bytes"},
    };

    for (size_t i = 0; i <= sizeof cases / sizeof *cases; i++) {
        static const char *const files[] = {"cameras.bin", "images.bin", "points3D.bin"};
        const char *folder = new_folder();

        make_folder(folder, "sparse/0");
        make_link(path_in(root, "images"), folder, "images");
        for (int f = 0; f < 3; f++) {
            struct spin_map map;
            unsigned char bytes[4096];
            char from[64];

            snprintf(from, sizeof from, "sparse/0/%s", files[f]);
            if (spin_map_open(path_in(root, from), &map) != SPIN_OK || map.size > sizeof bytes)
                exit(1);
            memcpy(bytes, map.data, map.size);
            if (i < sizeof cases / sizeof *cases && strcmp(files[f], cases[i].file) == 0)
                memcpy(bytes + cases[i].offset, cases[i].bytes, cases[i].n);
            make_file(folder, from, bytes, map.size);
            spin_map_close(&map);
        }
        if (i < sizeof cases / sizeof *cases) {
            set_refused(folder, NULL, cases[i].word, cases[i].what);
            continue;
        }
        ok(set_truncations(folder, "sparse/0/points3D.bin", NULL) == 0,
           "no truncation of points3D.bin can be read");
        remove(path_in(folder, "sparse/0/points3D.bin"));
        ok(set_truncations(folder, "sparse/0/images.bin", NULL) == 0,
           "no truncation of images.bin can be read");
        ok(set_truncations(folder, "sparse/0/cameras.bin", NULL) == 0, "nor of cameras.bin");
    }
}

static void test_lies(void)
{
    static const struct {
        const char *cameras, *images, *word, *what;
    } cases[] = {
        {"1 PINHOLE 8 6 10 11 3\n", images, "a parameter", "too few parameters"},
        {"x PINHOLE 8 6 10 11 3 2\n", images, "the id", "an id that is no number"},
        {"1 LENS 8 6 10 11 3 2\n", images, "'LENS'", "an unknown camera model"},
        {"1 SIMPLE_RADIAL 8 6 10 4 3 0.1\n", images, "distortion of 0.1", "distortion"},
        {"1 FOV 8 6 10 10 4 3 0\n", images, "FOV", "a lens that is no pinhole"},
        {"1 PINHOLE 8 6 10 0 4 3\n", images, "focal", "a focal length of 0"},
        {"1 PINHOLE 8 6 10 10 9 3\n", images, "principal point", "a principal point outside"},
        {"1 PINHOLE 8.5 6 10 10 4 3\n", images, "image size", "half a pixel"},
        {"1 PINHOLE 8 6 10 10 4 3\n1 PINHOLE 8 6 10 10 4 3\n", images, "two cameras",
         "two cameras with one id"},
        {"", images, "refers to camera 1, which", "no cameras"},
        {lenses, "", "no images", "no images"},
        {lenses, "1 1 0 0 0 0 0 0 1\n\n", "name of the image", "an image without a name"},
        {lenses, "1 1 0 0 0 0 0 1\n\n", "the camera's id", "a number too few"},
        {lenses, "1 1 0 0 nan 0 0 0 1 a.png\n\n", "QZ", "NaN in a quaternion"},
        {lenses, "1 0 0 0 0 0 0 0 1 a.png\n\n", "quaternion", "a quaternion of 0"},
        {lenses, "1 1 0 0 0 0 0 0 1 ../a.png\n\n", "below the folder of images",
         "a name that climbs out"},
        {lenses, "1 1 0 0 0 0 0 0 5 a.png\n\n", "refers to camera 5", "a camera that is not there"},
        {lenses, "1 1 0 0 0 0 0 0 1 a.png\n\n2 1 0 0 0 0 0 0 1 a.png\n", "two images called",
         "two images of one name"},
    };

    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++)
        set_refused(make_set(cases[i].cameras, cases[i].images), NULL, cases[i].word,
                    cases[i].what);
}

/* A folder that all readers recognise is read in the order of the methods' own code. */
static void test_order(void)
{
    static const char *const order[][2] = {{"sparse", "colmap"},
                                           {"transforms_train.json", "transforms"},
                                           {"poses_bounds.npy", "dynerf"},
                                           {"train_meta.json", "panoptic"}};
    const char *folder = new_folder();

    for (int i = 0; i < 4; i++)
        make_text(folder, order[i][0], "x");
    for (int i = 0; i < 4; i++) {
        const struct spin_importer *found = NULL;

        ok(spin_importer_find(folder, NULL, true, &found) == SPIN_OK &&
               strcmp(found->name, order[i][1]) == 0,
           "'%s' is taken for %s", order[i][0], order[i][1]);
        remove(path_in(folder, order[i][0]));
    }
}

/* ---- Cameras whose frames are in folders -------------------------------------------------------
 */

static void make_frames(const char *folder, const char *camera, int first, int n)
{
    char name[64];

    snprintf(name, sizeof name, "images/%s", camera);
    make_folder(folder, name);
    for (int k = 0; k < n; k++) {
        snprintf(name, sizeof name, "images/%s/%03d.png", camera, first + k);
        make_image(folder, name, 8, 6);
    }
}

#define NESTED "1 1 0 0 0 0 0 9 1 c1/000.png\n\n2 1 0 0 0 0 0 0 1 c0/000.png\n\n"

static bool is_rig(const struct spin_views *views)
{
    return views->n == 4 && views->n_dataset_frames == 2 && views->view[0].camera.w2c[11] == 0 &&
           views->view[1].camera.w2c[11] == 9 && views->view[3].camera_id == 1;
}

static void test_rig(void)
{
    static const struct {
        const char *images, *folders[2], *what;
    } cases[] = {
        {NESTED, {"c0", "c1"}, "frames behind every image"},
        {"1 1 0 0 0 0 0 9 1 c1.png\n\n2 1 0 0 0 0 0 0 1 c0.jpg\n\n",
         {"c0", "c1"},
         "frames in folders called as the images"},
        {"1 1 0 0 0 0 0 9 1 c.1.png\n\n2 1 0 0 0 0 0 0 1 c.0.png\n\n",
         {"c.0", "c.1"},
         "whose names have a dot"},
        {NESTED, {"x", "y"}, "frames in folders of other names"},
        {"1 1 0 0 0 0 0 9 1 c1-b/000.png\n\n2 1 0 0 0 0 0 0 1 c1/000.png\n\n",
         {"c1", "c1-b"},
         "names of which one begins with the other"},
    };
    struct spin_views views;
    const char *folder;

    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        folder = new_folder();
        make_model(folder, lenses, cases[i].images);
        make_frames(folder, cases[i].folders[0], 7, 2);
        make_frames(folder, cases[i].folders[1], 7, 2);
        make_text(folder, "images/note.txt", "no folder");
        if (!set_opens(folder, NULL, &views, cases[i].what))
            continue;
        ok(is_rig(&views) && views.numbered && views.view[2].number == 7 + 1 &&
               views.view[2].time == 1 && views.view[2].test && !views.view[1].test,
           "are cameras in the order of their names, the first held out, with times i/(n-1)");
        spin_views_free(&views);
    }
    folder = new_folder();
    make_model(folder, lenses, NESTED);
    make_frames(folder, "c0", 0, 2);
    make_frames(folder, "c1", 0, 3);
    make_frames(folder, "c2", 0, 2);
    make_text(folder, "manifest.json", "{\"fps\": \"24/1\"}");
    if (set_opens(folder, "colmap:time=count,hold=2,principal=centre", &views,
                  "a folder and a frame more, with options")) {
        ok(is_rig(&views) && views.view[2].time == 0.5 && views.view[1].camera.cx == 4,
           "are left out, and the options are heard");
        ok(strstr(views.notes, "--fps 24") != NULL, "and the manifest tells the frames a second");
        spin_views_free(&views);
    }
    set_refused(folder, "colmap:time=file", "'time'", "a time rule of the other layout");
    make_frames(folder, "c1", 5, 1);
    remove(path_in(folder, "images/c1/001.png"));
    if (set_opens(folder, NULL, &views, "a picture missing between")) {
        ok(views.n == 3 && views.view[2].camera_id == 0, "is left out");
        spin_views_free(&views);
    }
    make_text(folder, "manifest.json", "[]");
    make_image(folder, "images/c1/001.png", 8, 6);
    set_refused(folder, NULL, "manifest.json", "a manifest that is none");
}

/* Each image is a frame. */
static void test_no_rig(void)
{
    const char *folder = new_folder();
    struct spin_views views;

    make_model(folder, lenses, NESTED);
    make_frames(folder, "x", 0, 2);
    set_refused(folder, NULL, "2 of 2 images are missing", "fewer folders than cameras");
    make_frames(folder, "c0", 0, 2);
    make_frames(folder, "c1", 0, 1);
    make_text(folder, "images/c1/.001.png", "hidden");
    if (set_opens(folder, NULL, &views, "a camera of one frame")) {
        ok(views.n == 2 && views.view[1].time == 0.5, "its images are frames");
        spin_views_free(&views);
    }
    make_frames(folder, "c1", 1, 1);
    make_model(folder, lenses, "1 1 0 0 0 0 0 0 1 c0/000.png\n\n2 1 0 0 0 0 0 0 1 c0/001.png\n\n");
    if (set_opens(folder, NULL, &views, "a model of all images of a folder")) {
        ok(views.n == 2, "they are frames");
        spin_views_free(&views);
    }
    make_model(folder, lenses, "1 1 0 0 0 0 0 0 1 a.png\n\n2 1 0 0 0 0 0 0 1 b.png\n\n");
    make_images(folder, "images", 8, 6);
    if (set_opens(folder, NULL, &views, "images beside as many folders")) {
        ok(views.n == 2, "they are frames");
        spin_views_free(&views);
    }
}

/* A fixture whose images have an alpha channel: the difference over white and over black is
 * their transparency. */
static void test_freetimegs(const char *folder, const char *name, const spin_json *manifest)
{
    static const float white[3] = {1, 1, 1};
    struct spin_views views;
    struct spin_array info;
    struct spin_npz npz;
    double *alpha, far = 0;

    if (!rig_opens(folder, name, "colmap", &views, &npz))
        return;
    check_rig(&views, &npz, manifest, "time", name);
    alpha = check_load(&npz, "mean_alpha", &info);
    for (size_t i = 0; alpha && i < views.n; i++) {
        uint8_t *on_black = NULL, *on_white = NULL;
        double sum = 0;
        int w, h;

        if (spin_image_read(views.view[i].path, NULL, &w, &h, &on_black) != SPIN_OK ||
            spin_image_read(views.view[i].path, white, &w, &h, &on_white) != SPIN_OK)
            exit(1);
        for (int p = 0; p < 3 * w * h; p++)
            sum += (on_white[p] - on_black[p]) / 255.0;
        far = larger(far, fabs(1 - sum / (3 * w * h) - alpha[i]));
        free(on_black);
        free(on_white);
    }
    near(far, 0, 0.004, "mean of alpha, to 8 bits");
    free(alpha);
    spin_npz_close(&npz);
    spin_views_free(&views);
}

/* A clip of 4DAnyone has a folder videos/sparse, which is no COLMAP model. */
static void test_clip(void)
{
    const char *clip = new_folder();

    make_folder(clip, "videos/sparse");
    make_text(clip, "cameras.json", "[]");
    set_refused(clip, "colmap", "neither a COLMAP model", "a clip is no model");
}

TAP_MAIN
{
    const char *root = check_fixture("datasets/colmap_mini");

    spin_log_set_level(-2);
    test_order();
    test_text();
    test_frames();
    test_lies();
    test_rig();
    test_no_rig();
    test_clip();
    if (root)
        test_binary(root);
    else
        skip("binary models", "there is no fixture here");
    each_set("colmap", test_set);
    each_set_in("datasets4d", "freetimegs", test_freetimegs);
}
