/* panoptic: a data set of the D3DGS layout against what the method's own reader yields, and
 * malformed lists.
 * K: panoptic import views */
#include "tests/importers/sets.h"

/* ---- Fixtures -------------------------------------------------------------------------------- */

/* [T][C] of the split; views of one split come in file order when camera numbers grow. */
static void compare_split(const struct spin_views *views, struct spin_npz *npz, bool test,
                          const spin_json *manifest, const char *name)
{
    const char *prefix = test ? "test" : "train";
    struct spin_array k_info, m_info;
    char k_key[32], m_key[32], what[200];
    double *k, *m;
    size_t n = 0, n_views = 0;
    float *got_k = malloc(views->n * 9 * sizeof(float)),
          *got_m = malloc(views->n * 16 * sizeof(float));

    snprintf(k_key, sizeof k_key, "%s_K", prefix);
    snprintf(m_key, sizeof m_key, "%s_w2c", prefix);
    k = check_load(npz, k_key, &k_info);
    m = check_load(npz, m_key, &m_info);
    for (size_t i = 0; i < views->n; i++) {
        const struct spin_camera *c = &views->view[i].camera;
        const float now[9] = {
            (float)c->fx, 0, (float)c->cx, 0, (float)c->fy, (float)c->cy, 0, 0, 1};

        if (views->view[i].test != test)
            continue;
        memcpy(got_k + 9 * n, now, sizeof now);
        for (int j = 0; j < 16; j++)
            got_m[16 * n + (size_t)j] = j < 12 ? (float)c->w2c[j] : j == 15;
        n++;
    }
    n_views = k && k_info.n_dims == 4 ? (size_t)(k_info.shape[0] * k_info.shape[1]) : 0;
    if (k && m && ok(n == n_views, "%s: %zu views in %s", name, n, prefix)) {
        double abs = manifest_tolerance(manifest, "abs", 2e-5);
        double rel = manifest_tolerance(manifest, "rel", 2e-5);

        snprintf(what, sizeof what, "%s: %s", name, k_key);
        check_close(got_k, k, 9 * n, abs, rel, what);
        snprintf(what, sizeof what, "%s: %s", name, m_key);
        check_close(got_m, m, 16 * n, abs, rel, what);
    }
    free(k);
    free(m);
    free(got_k);
    free(got_m);
}

static void test_data_set(const char *folder, const char *name, const spin_json *manifest)
{
    struct spin_views views;
    struct spin_array info;
    struct spin_npz npz;
    char used[32] = "";
    double frames = -1, *radius;

    if (!ok(spin_views_open(folder, NULL, &views, used, sizeof used) == SPIN_OK &&
                !strcmp(used, "panoptic"),
            "%s: is recognised and read", name)) {
        printf("#   %s\n", spin_last_error());
        return;
    }
    spin_json_number(spin_json_get(manifest, "frames"), &frames);
    near(views.n_dataset_frames, frames, 0, "has as many frames as the manifest says");
    ok(views.numbered && views.view[0].number >= 0, "%s: file names have frame numbers", name);
    ok(spin_path_exists(views.view[0].path), "%s: image paths are right", name);
    if (ok(spin_npz_open(path_in(folder, "expected.npz"), &npz) == SPIN_OK, "%s: has expected.npz",
           name)) {
        compare_split(&views, &npz, false, manifest, name);
        compare_split(&views, &npz, true, manifest, name);
        radius = check_load(&npz, "scene_radius", &info);
        if (radius)
            near(spin_views_extent(&views), radius[0], 2e-5 * radius[0],
                 "the extent is the method's");
        free(radius);
        spin_npz_close(&npz);
    }
    spin_views_free(&views);
}

/* ---- Files made here ------------------------------------------------------------------------- */

struct text {
    const char *w, *k, *w2c, *fn, *cam_id;
};

/* Two frames, one camera. */
static const struct text good = {
    "8",
    "[[[[10,0,4],[0,10,3],[0,0,1]]],[[[10,0,4],[0,10,3],[0,0,1]]]]",
    "[[[[1,0,0,0],[0,1,0,0],[0,0,1,2],[0,0,0,1]]],[[[1,0,0,0],[0,1,0,0],[0,0,1,2],[0,0,0,1]]]]",
    "[[\"7/000003.jpg\"],[\"7/000005.jpg\"]]",
    NULL,
};

static const char *write_set(const struct text *train, const struct text *test)
{
    const char *folder = new_folder();

    if (spin_folder_make(path_in(folder, "ims/7")) != SPIN_OK)
        exit(1);
    for (int i = 3; i <= 5; i += 2) {
        FILE *image =
            fopen(path_in(folder, i == 3 ? "ims/7/000003.jpg" : "ims/7/000005.jpg"), "wb");

        if (!image)
            exit(1);
        fclose(image);
    }
    for (int i = 0; i < 2; i++) {
        const struct text *t = i == 0 ? train : test;
        FILE *file;

        if (!t)
            continue;
        file = fopen(path_in(folder, i == 0 ? "train_meta.json" : "test_meta.json"), "wb");
        if (!file)
            exit(1);
        fprintf(file, "{\"w\":%s,\"h\":6,\"k\":%s,\"w2c\":%s,\"fn\":%s", t->w, t->k, t->w2c, t->fn);
        if (t->cam_id)
            fprintf(file, ",\"cam_id\":%s", t->cam_id);
        fprintf(file, "}");
        fclose(file);
    }
    return folder;
}

static void refused(const struct text *train, const char *word, const char *what)
{
    set_refused(write_set(train, NULL), NULL, word, what);
}

static void test_own(void)
{
    struct text named = good;
    struct spin_views views;

    ok(spin_views_open(write_set(&good, NULL), NULL, &views, NULL, 0) == SPIN_OK && views.n == 2,
       "a set without test_meta.json");
    if (views.n == 2) {
        ok(!views.view[0].test && views.view[1].dataset_frame == 1 && views.view[1].time == 1,
           "trains with every camera");
        ok(views.view[0].camera_id == 7, "the folder's name is the camera's number");
        ok(views.numbered && views.view[0].number == 3 && views.view[1].number == 5,
           "frame numbers are the files'");
    }
    spin_views_free(&views);
    named.cam_id = "[[31],[31]]";
    ok(spin_views_open(write_set(&named, &good), NULL, &views, NULL, 0) == SPIN_OK &&
           views.n == 4 && views.view[1].camera_id == 31 && views.view[0].test &&
           !views.view[1].test,
       "cam_id decides where it is given, and views are sorted by it");
    spin_views_free(&views);
}

static void test_lies(void)
{
    static const char one_row[] = "[[[[10,0,4],[0,10,3],[0,0,1]]]]";
    static const char pose[] =
        "[[[[%s],[%s],[0,0,1,2],[%s]]],[[[1,0,0,0],[0,1,0,0],[0,0,1,2],[0,0,0,1]]]]";
    static const struct {
        const char *rows[3], *word, *what;
    } poses[] = {
        {{"1,0,0,0", "0,1.01,0,0", "0,0,0,1"}, "orthonormal", "a rotation that scales"},
        {{"1,0.1,0,0", "0,1,0,0", "0,0,0,1"}, "orthonormal", "a rotation that shears"},
        {{"1,0,0,0", "0,-1,0,0", "0,0,0,1"},
         "determinant is negative: negate two axes",
         "a reflection"},
        {{"1,0,0,0", "0,-0.99999999,0,0", "0,0,0,1"}, "determinant is negative", "almost one"},
        {{"1,0,0,0", "0,1,0,0", "0,0,0,2"}, "last row", "a last row that is not 0 0 0 1"},
        {{"1,0,0,null", "0,1,0,0", "0,0,0,1"}, "not a number", "null in a pose"},
        {{"1,0,0,NaN", "0,1,0,0", "0,0,0,1"}, "train_meta.json", "NaN in a pose"},
        {{"1,0,0,1e999", "0,1,0,0", "0,0,0,1"},
         "train_meta.json",
         "a number too large for a double"},
        {{"1,0,0", "0,1,0,0", "0,0,0,1"}, "4 x 4", "a short row"},
    };
    static const struct {
        const char *k, *word, *what;
    } ks[] = {
        {"[[0,0,4],[0,10,3],[0,0,1]]", "focal", "a focal length of 0"},
        {"[[10,0,4],[0,-10,3],[0,0,1]]", "focal", "a negative focal length"},
        {"[[10,0,9],[0,10,3],[0,0,1]]", "principal point", "a principal point outside the image"},
        {"[[10,1,4],[0,10,3],[0,0,1]]", "skew", "a skew"},
        {"[[10,0,4],[0,10,3],[0,0,2]]", "'k' is not", "a k that is no camera matrix"},
        {"[[10,0,4],[0,10,3]]", "3 x 3", "a k of two rows"},
        {"7", "3 x 3", "a k that is a number"},
    };
    static const struct {
        const char *fn, *word, *what;
    } fns[] = {
        {"[[\"../x.jpg\"],[\"7/000005.jpg\"]]", "below 'ims'", "a file name that climbs out"},
        {"[[\"7/../../x.jpg\"],[\"7/000005.jpg\"]]", "below 'ims'", "and one that does so later"},
        {"[[\"/etc/x.jpg\"],[\"7/000005.jpg\"]]", "below 'ims'", "an absolute file name"},
        {"[[3],[\"7/000005.jpg\"]]", "'fn'", "a file name that is a number"},
        {"[[\"7/000004.jpg\"],[\"7/000006.jpg\"]]", "2 of 2 images are missing", "missing images"},
        {"[[\"7/000003.jpg\"]]", "1 frames", "a list of too few frames"},
        {"[[\"7/000003.jpg\"],[]]", "0 cameras", "a frame without cameras"},
        {"{}", "no list 'fn'", "an object in place of a list"},
    };
    struct text t = good;
    char text[1000];

    for (size_t i = 0; i < sizeof poses / sizeof *poses; i++) {
        snprintf(text, sizeof text, pose, poses[i].rows[0], poses[i].rows[1], poses[i].rows[2]);
        t.w2c = text;
        refused(&t, poses[i].word, poses[i].what);
    }
    t = good;
    for (size_t i = 0; i < sizeof ks / sizeof *ks; i++) {
        snprintf(text, sizeof text, "[[%s],[%s]]", ks[i].k, ks[i].k);
        t.k = text;
        refused(&t, ks[i].word, ks[i].what);
    }
    t = good;
    for (size_t i = 0; i < sizeof fns / sizeof *fns; i++) {
        t.fn = fns[i].fn;
        refused(&t, fns[i].word, fns[i].what);
    }
    t = good;
    t.k = one_row;
    refused(&t, "expected 1", "lists of different lengths");
    t = good;
    t.k = "[]";
    refused(&t, "no frames", "empty lists");
    t = good;
    t.w = "8.5";
    refused(&t, "image size", "half a pixel");
    t = good;
    t.w = "1e300";
    refused(&t, "image size", "an absurd size");
    t = good;
    t.cam_id = "[[1.5],[1]]";
    refused(&t, "cam_id", "a camera number that is none");
}

static void test_fixture(const char *folder, const char *name, const spin_json *manifest)
{
    if (spin_json_get(manifest, "expected"))
        test_data_set(folder, name, manifest);
    set_cases(folder, "panoptic", manifest);
}

TAP_MAIN
{
    spin_log_set_level(-1);
    test_own();
    test_lies();
    ok(set_truncations(write_set(&good, NULL), "train_meta.json", NULL) == 0,
       "no truncation of train_meta.json can be read");
    each_set("panoptic", test_fixture);
}
