/* Shared by the tests of data set readers: small sets made here, and comparisons with
 * expected.npz. */
#ifndef SPIN_TESTS_IMPORTERS_SETS_H
#define SPIN_TESTS_IMPORTERS_SETS_H

#include "io/image.h"
#include "scene/dataset.h"
#include "scene/image_cache.h"
#include "tests/importers/runs.h"

static inline void make_folder(const char *folder, const char *name)
{
    if (spin_folder_make(path_in(folder, name)) != SPIN_OK)
        exit(1);
}

/* A grey image; its folder exists. */
static inline void make_image(const char *folder, const char *name, int width, int height)
{
    uint8_t *rgb = calloc((size_t)width * (size_t)height, 3);

    if (!rgb || spin_image_write(path_in(folder, name), width, height, rgb, false) != SPIN_OK) {
        printf("# %s\n", spin_last_error());
        exit(1);
    }
    free(rgb);
}

static inline void make_file(const char *folder, const char *name, const void *bytes, size_t n)
{
    FILE *file = fopen(path_in(folder, name), "wb");

    if (!file || fwrite(bytes, 1, n, file) != n || fclose(file) != 0)
        exit(1);
}

static inline void make_text(const char *folder, const char *name, const char *text)
{
    make_file(folder, name, text, strlen(text));
}

/* Creates the link folder/name to the file `target`. */
static inline void make_link(const char *target, const char *folder, const char *name)
{
    char *absolute = NULL;

    if (spin_path_absolute(target, &absolute) != SPIN_OK ||
        symlink(absolute, path_in(folder, name)) != 0)
        exit(1);
    free(absolute);
}

static inline void set_refused(const char *folder, const char *from, const char *word,
                               const char *what)
{
    struct spin_views views;
    spin_status status = spin_views_open(folder, from, &views, NULL, 0);
    bool good = status != SPIN_OK && (!word || strstr(spin_last_error(), word)) &&
                strchr(spin_last_error(), '\n') == NULL;

    ok(good, "%s", what);
    if (!good)
        printf("#   %s\n", status == SPIN_OK ? "it was read" : spin_last_error());
    if (status == SPIN_OK)
        spin_views_free(&views);
}

/* Reads, or reports the error. */
static inline bool set_opens(const char *folder, const char *from, struct spin_views *views,
                             const char *what)
{
    bool good = spin_views_open(folder, from, views, NULL, 0) == SPIN_OK;

    ok(good, "%s", what);
    if (!good)
        printf("#   %s\n", spin_last_error());
    return good;
}

/* The view whose image path ends in `ending`, or NULL. */
static inline const struct spin_view *view_of(const struct spin_views *views, const char *ending)
{
    for (size_t i = 0; i < views->n; i++) {
        size_t n = strlen(views->view[i].path), n_ending = strlen(ending);

        if (n >= n_ending && strcmp(views->view[i].path + n - n_ending, ending) == 0)
            return &views->view[i];
    }
    return NULL;
}

/* w2c as [4][4] floats. */
static inline void pose_of(const struct spin_view *view, float out[16])
{
    for (int j = 0; j < 16; j++)
        out[j] = j < 12 ? (float)view->camera.w2c[j] : j == 15;
}

/* Every truncation of a file is refused or read without harm. Returns how many were read. */
static inline int set_truncations(const char *folder, const char *name, const char *from)
{
    const char *path = path_in(folder, name);
    struct spin_map map = {0};
    size_t size;
    int n_good = 0;

    if (spin_map_open(path, &map) != SPIN_OK)
        exit(1);
    size = map.size;
    spin_map_close(&map);
    while (size-- > 0) {
        struct spin_views views;

        if (truncate(path, (off_t)size) == 0 &&
            spin_views_open(folder, from, &views, NULL, 0) == SPIN_OK) {
            n_good++;
            spin_views_free(&views);
        }
    }
    return n_good;
}

/* Folders among a fixture's altered files: "cases" of its manifest. */
static inline void set_cases(const char *folder, const char *from, const spin_json *manifest)
{
    const spin_json *cases = spin_json_get(manifest, "cases");

    for (size_t i = 0; i < spin_json_length(cases); i++) {
        const spin_json *c = spin_json_at(cases, i);
        const char *file = spin_json_string(spin_json_get(c, "file"));
        const char *expect = spin_json_string(spin_json_get(c, "expect"));
        const char *path = file ? path_in(folder, file) : folder;
        struct spin_views views;
        spin_status status;

        if (!file || !expect || !spin_path_is_folder(path))
            continue;
        status = spin_views_open(path, from, &views, NULL, 0);
        if (status == SPIN_OK)
            spin_views_free(&views);
        if (strcmp(expect, "error") == 0)
            ok(status != SPIN_OK, "%s is refused", file);
        else
            ok(1, "%s is survived (expect '%s')", file, expect);
    }
}

/* Calls `test` for each fixture folder of `root` whose name begins with `kind`. */
static inline void each_set_in(const char *root_name, const char *kind,
                               void (*test)(const char *folder, const char *name,
                                            const spin_json *manifest))
{
    const char *root = check_fixture(root_name);
    char **names = NULL;
    size_t n = 0;

    if (!root || spin_folder_list(root, &names, &n) != SPIN_OK) {
        skip(kind, "there are no fixtures of data sets here");
        return;
    }
    for (size_t i = 0; i < n; i++) {
        const char *folder = path_in(root, names[i]);
        spin_json *manifest =
            strncmp(names[i], kind, strlen(kind)) == 0 ? load_manifest(folder) : NULL;

        if (manifest)
            test(folder, names[i], manifest);
        spin_json_free(manifest);
    }
    spin_folder_list_free(names);
}

static inline void each_set(const char *kind, void (*test)(const char *folder, const char *name,
                                                           const spin_json *manifest))
{
    each_set_in("datasets", kind, test);
}

/* ---- Cameras with a folder of frames, or a video, each */

/* A number of the manifest's tolerances, or the one at the start of its text. */
static inline double rig_tolerance(const spin_json *manifest, const char *key)
{
    const spin_json *all = spin_json_get(manifest, "tolerance");
    const char *text = spin_json_string(spin_json_get(all, key));

    return text ? strtod(text, NULL) : manifest_tolerance(manifest, key, NAN);
}

/* Compares the views of all frames and cameras, in this order, with the arrays w2c ([C] or
 * [T][C]), K, size and `time`. */
static inline void check_rig(const struct spin_views *views, struct spin_npz *npz,
                             const spin_json *manifest, const char *time_key, const char *name)
{
    double frames = -1, far_pose = 0, far_k = 0, far_time = 0, *w2c, *k, *size, *time;
    struct spin_array pose_info, info;
    size_t n_cameras, n_right = 0;

    spin_json_number(spin_json_get(manifest, "frames"), &frames);
    near(views->n_dataset_frames, frames, 0, "has as many frames as the manifest says");
    w2c = check_load(npz, "w2c", &pose_info);
    k = check_load(npz, "K", &info);
    size = check_load(npz, "size", &info);
    time = check_load(npz, time_key, &info);
    if (!w2c || !k || !size || !time)
        return;
    n_cameras = (size_t)pose_info.shape[pose_info.n_dims - 3];
    if (!ok(views->n == n_cameras * (size_t)views->n_dataset_frames && views->numbered,
            "%s: a numbered view of each of %zu cameras in each", name, n_cameras))
        return;
    for (size_t i = 0; i < views->n; i++) {
        const struct spin_view *v = &views->view[i];
        const struct spin_camera *c = &v->camera;
        size_t camera = i % n_cameras, row = i / n_cameras;
        const double *m = w2c + 16 * (pose_info.n_dims == 4 ? i : camera);
        const double ours[9] = {c->fx, 0, c->cx, 0, c->fy, c->cy, 0, 0, 1};

        n_right += v->camera_id == (int)camera && v->dataset_frame == (int)row &&
                   c->width == (int)size[2 * camera] && c->height == (int)size[2 * camera + 1];
        for (int j = 0; j < 12; j++)
            far_pose = larger(far_pose, fabs(c->w2c[j] - m[j]));
        for (int j = 0; j < 9; j++)
            far_k = larger(far_k, fabs(ours[j] - k[9 * camera + (size_t)j]));
        far_time = larger(far_time, fabs(v->time - time[row]));
    }
    ok(n_right == views->n, "%s: cameras are in the order of their names, and have their sizes",
       name);
    near(far_pose, 0, rig_tolerance(manifest, "w2c"), "poses");
    near(far_k, 0, rig_tolerance(manifest, "w2c"), "intrinsics");
    near(far_time, 0, 1e-12, "times");
    free(w2c);
    free(k);
    free(size);
    free(time);
}

/* Compares the mean of each image's channels with mean_rgb [T][C][3]. */
static inline void check_rig_colours(const struct spin_views *views, struct spin_npz *npz,
                                     const spin_json *manifest)
{
    struct spin_array info;
    double *mean = check_load(npz, "mean_rgb", &info), far = 0;

    for (size_t i = 0; mean && i < views->n; i++) {
        double sum[3] = {0};
        uint8_t *rgb = NULL;
        int width, height;

        if (spin_image_read(views->view[i].path, NULL, &width, &height, &rgb) != SPIN_OK) {
            ok(0, "%s", spin_last_error());
            break;
        }
        for (size_t p = 0; p < 3 * (size_t)width * (size_t)height; p++)
            sum[p % 3] += rgb[p] / 255.0;
        for (int c = 0; c < 3; c++)
            far = larger(far, fabs(sum[c] / (width * height) - mean[3 * i + (size_t)c]));
        free(rgb);
    }
    near(far, 0, rig_tolerance(manifest, "mean_rgb"), "mean colours of the pictures");
    free(mean);
}

/* Opens the set in `folder`, whatever its folder is called, as `importer`, by detection. */
static inline bool rig_opens(const char *folder, const char *name, const char *importer,
                             struct spin_views *views, struct spin_npz *npz)
{
    char used[32] = "";
    const char *set = path_in(folder, has(folder, "clip") ? "clip" : "scene");

    if (!ok(spin_views_open(set, NULL, views, used, sizeof used) == SPIN_OK &&
                strcmp(used, importer) == 0,
            "%s: is recognised and read", name)) {
        printf("#   %s\n", spin_last_error());
        return false;
    }
    return ok(spin_npz_open(path_in(folder, "expected.npz"), npz) == SPIN_OK,
              "%s: has expected.npz", name);
}

#endif
