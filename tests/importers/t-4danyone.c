/* 4danyone: clips compared with the method's own cameras and the colours of their videos, image
 * files instead of videos, and malformed files.
 * K: 4danyone import views video */
#include "io/video.h"
#include "tests/importers/sets.h"

static bool films; /* this build reads them */

/* ---- Fixtures -------------------------------------------------------------------------------- */

static void test_set(const char *folder, const char *name, const spin_json *manifest)
{
    struct spin_views views;
    struct spin_npz npz;

    if (!films) {
        skip(name, "this build reads no films");
        return;
    }
    if (!rig_opens(folder, name, "4danyone", &views, &npz))
        return;
    check_rig(&views, &npz, manifest, "time", name);
    check_rig_colours(&views, &npz, manifest);
    ok(strstr(views.notes, "points up") && strstr(views.notes, "--fps 30"),
       "%s: the notes say which axis is up and the frames a second", name);
    spin_npz_close(&npz);
    spin_views_free(&views);
}

/* ---- Files made here ------------------------------------------------------------------------- */

#define K_GOOD "[[10, 0, 4], [0, 11, 3], [0, 0, 1]]"

/* The parameters of a camera. */
struct entry {
    const char *id, *k, *pose, *size, *video;
};
static const struct entry good = {"1", K_GOOD,
                                  "[[1, 0, 0, 1], [0, -1, 0, 2], [0, 0, -1, 5], [0, 0, 0, 1]]",
                                  "\"image_width\": 8, \"image_height\": 6", "videos/dense/01.mp4"};

static void make_cameras(const char *folder, const char *model, const struct entry *second)
{
    char text[2048];

    snprintf(text, sizeof text,
             "{%s\"cameras\": [{\"camera_id\": 0, \"K\": " K_GOOD ", \"camera_to_world\": "
             "[[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], %s, "
             "\"video\": \"videos/dense/00.mp4\"},\n{\"camera_id\": %s, \"K\": %s, "
             "\"camera_to_world\": %s, %s, \"video\": \"%s\"}]}",
             model, good.size, second->id, second->k, second->pose, second->size, second->video);
    make_text(folder, "cameras.json", text);
}

#define MODEL "\"camera_model\": \"OPENCV\", "

/* Two cameras whose videos have been extracted: two frames. */
static const char *make_set(void)
{
    const char *folder = new_folder();
    char name[64];

    make_cameras(folder, MODEL, &good);
    for (int i = 0; i < 4; i++) {
        snprintf(name, sizeof name, "images/%02d", i % 2);
        make_folder(folder, name);
        snprintf(name, sizeof name, "images/%02d/%06d.png", i % 2, i / 2);
        make_image(folder, name, 8, 6);
    }
    return folder;
}

static void test_pictures(void)
{
    const char *folder = make_set();
    struct spin_views views;

    make_folder(folder, "videos/sparse");
    if (set_opens(folder, NULL, &views, "pictures in place of films")) {
        const struct spin_camera *c = &views.view[1].camera;

        ok(views.n == 4 && views.n_dataset_frames == 2 && views.numbered,
           "have two frames of two cameras");
        ok(c->w2c[0] == 1 && c->w2c[3] == -1 && c->w2c[5] == -1 && c->w2c[7] == 2 &&
               c->w2c[10] == -1 && c->w2c[11] == 5,
           "a pose is the inverse of camera_to_world");
        ok(c->fx == 10 && c->fy == 11 && c->cx == 4 && c->cy == 3, "K is taken");
        ok(views.view[0].test && !views.view[1].test && views.view[2].time == 1,
           "the first camera is held out, and times are i/(n-1)");
        ok(strstr(views.notes, "its frame rate is unknown") != NULL,
           "without metadata.json the notes say that no rate is known");
        spin_views_free(&views);
    }
    make_text(folder, "metadata.json", "{\"output\": {\"fps\": \"30000/1001\"}}");
    if (set_opens(folder, "4danyone:time=count,hold=0", &views, "with options")) {
        ok(!views.view[0].test && views.view[2].time == 0.5, "nothing is held out, times are i/n");
        ok(strstr(views.notes, "--fps 29.97") != NULL, "a rate may be a ratio");
        spin_views_free(&views);
    }
    if (set_opens(folder, "4danyone:time=25,hold=1", &views, "with others")) {
        ok(views.view[1].test && views.view[2].time == 0.04, "all are held out, times are seconds");
        spin_views_free(&views);
    }
    make_text(folder, "metadata.json", "{\"output\": {\"fps\": \"1/0\"}}");
    if (set_opens(folder, NULL, &views, "a rate of 1/0")) {
        ok(strstr(views.notes, "frame rate is unknown") != NULL, "is none");
        spin_views_free(&views);
    }
    make_text(folder, "metadata.json", "{");
    set_refused(folder, NULL, "metadata.json", "a metadata.json that is cut short");
    remove(path_in(folder, "metadata.json"));
    make_image(folder, "images/00/000002.png", 8, 6);
    if (set_opens(folder, NULL, &views, "a first camera with a frame more")) {
        ok(views.n == 4 && views.n_dataset_frames == 2, "is read as far as the others go");
        spin_views_free(&views);
    }
    remove(path_in(folder, "images/00/000002.png"));
    make_image(folder, "images/01/000002.png", 8, 6);
    if (set_opens(folder, NULL, &views, "a camera with a frame more")) {
        ok(views.n == 4, "is read as far as the others go");
        spin_views_free(&views);
    }
    remove(path_in(folder, "images/01/000001.png"));
    if (set_opens(folder, NULL, &views, "a picture missing between")) {
        ok(views.n == 3 && views.view[2].camera_id == 0, "is left out");
        spin_views_free(&views);
    }
    remove(path_in(folder, "images/01/000002.png"));
    make_image(folder, "images/01/000001.png", 8, 6);
    remove(path_in(folder, "images/01/000000.png"));
    make_image(folder, "images/01/000002.png", 8, 6);
    set_refused(folder, NULL, "give 'offsets'", "a camera with as many images, from 1 on");
    if (set_opens(folder, "4danyone:offsets=1=-1", &views, "an offset as an option")) {
        ok(views.n == 4 && views.view[1].number == 0 &&
               strstr(views.view[1].path, "images/01/000001.png"),
           "moves the images of the camera");
        spin_views_free(&views);
    }
    make_text(folder, "offsets.txt", "# camera, frames\n01: -1\n00 0 # none\n");
    if (set_opens(folder, NULL, &views, "offsets in a file")) {
        ok(views.n == 4 && views.view[1].number == 0 && views.view[2].number == 1, "count as well");
        spin_views_free(&views);
    }
    make_text(folder, "offsets.txt", "01 0\n");
    if (set_opens(folder, NULL, &views, "a camera that starts late")) {
        ok(views.n == 3 && views.n_dataset_frames == 2 && views.view[2].number == 1,
           "lacks the first frames");
        spin_views_free(&views);
    }
    make_text(folder, "offsets.txt", "01 one\n");
    set_refused(folder, NULL, "neither a whole number", "an offset that is none");
    make_text(folder, "offsets.txt", "01 0.5\n");
    set_refused(folder, NULL, "neither a whole number", "half a frame");
    make_text(folder, "offsets.txt", "07 1\n");
    set_refused(folder, NULL, "no such camera", "an offset of an unknown camera");
    make_text(folder, "offsets.txt", "01 0.5s\n");
    set_refused(folder, NULL, "frame rate", "seconds without a frame rate");
    remove(path_in(folder, "offsets.txt"));
    remove(path_in(folder, "images/01/000002.png"));
    make_image(folder, "images/01/000000.png", 8, 6);
    make_image(folder, "images/01/000001.jpg.png", 8, 6);
    make_text(folder, "images/01/000001.jpg", "x");
    set_refused(folder, NULL, "both frame 1", "a frame that is there twice");
    set_refused(make_set(), "4danyone:hold=-1", "'hold'", "a hold below 0");
    set_refused(make_set(), "4danyone:time=0", "'time'", "a time rule that divides by 0");
    ok(set_truncations(make_set(), "cameras.json", "4danyone") == 0,
       "no truncation of cameras.json can be read");
}

static void test_lies(void)
{
    static const struct {
        struct entry second;
        const char *word, *what;
    } cases[] = {
        {{"2", NULL, NULL, NULL, NULL}, "'camera_id' is not 1", "ids with a gap"},
        {{"0", NULL, NULL, NULL, NULL}, "'camera_id' is not 1", "an id that is there twice"},
        {{"\"1\"", NULL, NULL, NULL, NULL}, "'camera_id' is not 1", "an id that is a text"},
        {{NULL, "[[10, 0, 4], [0, 11, 3]]", NULL, NULL, NULL}, "3 x 3", "K of two rows"},
        {{NULL, "[[10, 0, 4], [0, null, 3], [0, 0, 1]]", NULL, NULL, NULL},
         "'K'[1][1]",
         "K without a number"},
        {{NULL, "[[10, 0, 4], [0, NaN, 3], [0, 0, 1]]", NULL, NULL, NULL},
         "cameras.json",
         "K with NaN"},
        {{NULL, "[[10, 0, 4], [0, 11, 3], [0, 0, 2]]", NULL, NULL, NULL},
         "'K' is not",
         "K that is no pinhole"},
        {{NULL, "[[10, 1, 4], [0, 11, 3], [0, 0, 1]]", NULL, NULL, NULL}, "skew", "a skew"},
        {{NULL, "[[0, 0, 4], [0, 11, 3], [0, 0, 1]]", NULL, NULL, NULL},
         "focal",
         "a focal length of 0"},
        {{NULL, "[[10, 0, 9], [0, 11, 3], [0, 0, 1]]", NULL, NULL, NULL},
         "principal point",
         "a principal point outside"},
        {{NULL, NULL, "[[1, 0, 0, 1], [0, -1, 0, 2], [0, 0, -1, 5], [0, 0, 0, 2]]", NULL, NULL},
         "last row",
         "another last row"},
        {{NULL, NULL, "[[1, 0, 0, 1], [0, -1, 0, 2], [0, 0, -1.1, 5], [0, 0, 0, 1]]", NULL, NULL},
         "orthonormal",
         "a pose that scales"},
        {{NULL, NULL, "[[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, -1, 5], [0, 0, 0, 1]]", NULL, NULL},
         "reflection",
         "a pose that mirrors"},
        {{NULL, NULL, "3", NULL, NULL}, "'camera_to_world' is not a 4 x 4", "a pose that is none"},
        {{NULL, NULL, NULL, "\"image_width\": 8", NULL}, "image_height", "no height"},
        {{NULL, NULL, NULL, "\"image_width\": 8, \"image_height\": 0", NULL},
         "image size",
         "a height of 0"},
        {{NULL, NULL, NULL, "\"image_width\": 8, \"image_height\": 8", NULL},
         "another aspect ratio",
         "pictures of another aspect ratio"},
        {{NULL, NULL, NULL, NULL, "../01.mp4"}, "below the folder", "a film that climbs out"},
        {{NULL, NULL, NULL, NULL, "/01.mp4"}, "below the folder", "a film with an absolute name"},
        {{NULL, NULL, NULL, NULL, "01.png"}, "expected a video", "a film that is a picture"},
        {{NULL, NULL, NULL, NULL, "videos/dense/02.mp4"},
         "there is neither the video",
         "a film that is missing"},
    };
    const char *folder = make_set();

    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        const struct entry *c = &cases[i].second;

        make_cameras(folder, MODEL,
                     &(struct entry){c->id ? c->id : good.id, c->k ? c->k : good.k,
                                     c->pose ? c->pose : good.pose, c->size ? c->size : good.size,
                                     c->video ? c->video : good.video});
        set_refused(folder, NULL, cases[i].word, cases[i].what);
    }
    make_cameras(folder, "\"camera_model\": \"OPENCV_FISHEYE\", ", &good);
    set_refused(folder, NULL, "expected OPENCV", "another camera model");
    make_cameras(folder, "", &good);
    set_refused(folder, "4danyone", "'camera_model' is ''", "no camera model");
    set_refused(folder, NULL, "cannot recognise", "which is not recognised either");
    make_text(folder, "cameras.json", "{" MODEL "\"cameras\": []}");
    set_refused(folder, NULL, "'cameras'", "no cameras");
    make_text(folder, "cameras.json", "{" MODEL "\"cameras\": 3}");
    set_refused(folder, NULL, "'cameras'", "cameras that are no list");
}

/* The films of the fixture, moved about. */
static void test_films(void)
{
    const char *clip = check_fixture("datasets4d/4danyone_mini/clip"), *folder = new_folder();
    struct spin_views views;
    spin_json *root = NULL, *camera;
    char *text;

    if (!clip || !films) {
        skip("films", "this build reads none, or there is no fixture");
        if (clip)
            set_refused(clip, NULL, "ffmpeg -i", "without FFmpeg the way to pictures is told");
        return;
    }
    make_folder(folder, "videos/dense");
    make_link(path_in(clip, "videos/dense/00.mp4"), folder, "videos/dense/00.mp4");
    make_link(path_in(clip, "videos/dense/01.mp4"), folder, "videos/dense/01.mp4");
    make_link(path_in(clip, "cameras.json"), folder, "cameras.json");
    set_refused(folder, NULL, "videos/dense/02.mp4", "a film that is missing");
    make_text(folder, "videos/dense/02.mp4", "x");
    set_refused(folder, NULL, "cannot read video", "a film that is none");
    remove(path_in(folder, "videos/dense/02.mp4"));
    make_link(path_in(clip, "videos/dense/02.mp4"), folder, "videos/dense/02.mp4");
    if (spin_json_load(path_in(clip, "cameras.json"), &root) != SPIN_OK)
        exit(1);
    camera = spin_json_at(spin_json_get(root, "cameras"), 2);
    spin_json_set_number(camera, "image_width", 34);
    text = spin_json_text(root, false);
    remove(path_in(folder, "cameras.json"));
    make_text(folder, "cameras.json", text);
    set_refused(folder, NULL, "its camera has 34 x", "a film of another size");
    free(text);
    spin_json_set_number(camera, "image_width", 32);
    text = spin_json_text(root, false);
    make_text(folder, "cameras.json", text);
    if (set_opens(folder, NULL, &views, "a clip of films alone")) {
        ok(strstr(views.view[0].path, "videos/dense/00.mp4#0") != NULL,
           "names the frames from the videos");
        spin_views_free(&views);
    }
    free(text);
    spin_json_free(root);
}

TAP_MAIN
{
    spin_log_set_level(-2);
    films = spin_video_start() == SPIN_OK;
    test_pictures();
    test_lies();
    test_films();
    each_set_in("datasets4d", "4danyone", test_set);
}
