#include "run/data_hint.h"

#include <ctype.h>
#include <sys/stat.h>

#include "base/base.h"
#include "io/file.h"
#include "io/json.h"
#include "scene/dataset.h"
#include "scene/probe.h"

/* ---- Data sets near a run -------------------------------------------------------------------- */

/* At most this many entries of the parent folder are examined. */
#define MAX_BESIDE 64

struct found {
    const struct spin_importer *importer; /* importer of the first data set */
    char *path;                           /* path of the first data set */
    int n;                                /* number of data sets */
};

/* If `path` is a data set, counts it, and keeps its path if it is the first one. Takes ownership of
 * `path`. */
static void count_data_set(struct found *found, char *path)
{
    const struct spin_importer *importer =
        path && spin_path_is_folder(path) ? spin_importer_guess(path, true) : NULL;

    found->n += importer != NULL;
    if (found->n != 1 || !importer) {
        free(path);
        return;
    }
    found->importer = importer;
    found->path = path;
}

static void search_folder(struct found *found, const char *input, const char *folder)
{
    char **names = NULL, *path;
    size_t n = 0;

    if (spin_folder_list(folder, &names, &n) != SPIN_OK)
        return;
    for (size_t i = 0; i < n && i < MAX_BESIDE; i++) {
        if (strcmp(names[i], spin_path_name(input)) == 0 ||
            spin_path_join(folder, names[i], &path) != SPIN_OK)
            continue;
        /* Skip other runs: a data set inside a run belongs to that run. */
        if (spin_importer_guess(path, false))
            free(path);
        else
            count_data_set(found, path);
    }
    spin_folder_list_free(names);
}

static struct found find_data_sets(const char *input)
{
    struct found found = {0};
    SPIN_FREED char *absolute = NULL, *folder = NULL;
    char *copy = NULL;

    spin_inputs_pause(true);
    if (spin_path_absolute(input, &absolute) == SPIN_OK &&
        spin_path_folder(absolute, &folder) == SPIN_OK) {
        if (spin_strdup(absolute, &copy) == SPIN_OK)
            count_data_set(&found, copy);
        copy = NULL;
        if (found.n == 0 && spin_strdup(folder, &copy) == SPIN_OK)
            count_data_set(&found, copy);
        if (found.n == 0)
            search_folder(&found, absolute, folder);
    }
    spin_inputs_pause(false);
    return found;
}

char *spin_data_beside(const char *input)
{
    struct found found = find_data_sets(input);

    if (found.n == 1)
        return found.path;
    free(found.path);
    return NULL;
}

void spin_data_hint(const char *input, char *text, size_t n_text)
{
    struct found found = find_data_sets(input);

    text[0] = '\0';
    if (found.n == 1)
        snprintf(
            text, n_text,
            "a data set (%s) was found beside the run: use --data '%s' if the run was trained on "
            "it\n",
            found.importer->name, found.path);
    else if (found.n > 1)
        snprintf(text, n_text,
                 "%d data sets were found beside the run, one of them in '%s': use --data to name "
                 "the one that the run was trained on\n",
                 found.n, found.path);
    free(found.path);
}

bool spin_data_has_focal(const char *folder)
{
    static const char *const names[] = {"transforms_train.json", "transforms.json"};
    bool found = false;

    for (int i = 0; i < 2 && !found; i++) {
        SPIN_LEAVES(spin_json_freed) spin_json *root = NULL;
        SPIN_FREED char *path = NULL;

        if (spin_path_join(folder, names[i], &path) == SPIN_OK && spin_path_exists(path) &&
            spin_json_load(path, &root) == SPIN_OK)
            found = spin_json_get(root, "fl_x") ||
                    spin_json_get(spin_json_at(spin_json_get(root, "frames"), 0), "fl_x");
    }
    return found;
}

/* ---- Points of a data set -------------------------------------------------------------------- */

/* Smallest file with points: an empty points3D.bin has 8 bytes. */
enum { EMPTY = 8 };

static const char *const models[] = {"sparse/0", "sparse", "sparse_", "colmap/sparse/0", "."};
static const char *const files[] = {"points3D.bin", "points3D.txt"};
static const char *const clouds[] = {"init_pt_cld.npz",
                                     "points3D_multipleview.ply",
                                     "points3D_downsample2.ply",
                                     "points3D_downsample.ply",
                                     "points3D.ply",
                                     "points3d.ply",
                                     "fused.ply",
                                     "sparse_pc.ply"};
enum {
    N_MODELS = sizeof models / sizeof *models,
    N_FILES = sizeof files / sizeof *files,
    N_CLOUDS = sizeof clouds / sizeof *clouds
};

static bool is_filled(const char *path)
{
    struct stat st;

    return stat(path, &st) == 0 && S_ISREG(st.st_mode) && st.st_size > EMPTY;
}

/* Sets *out to the first file of points of a COLMAP model in this folder, or to NULL. */
static spin_status find_model_points(const char *folder, char **out)
{
    *out = NULL;
    for (size_t i = 0; i < N_MODELS * N_FILES; i++) {
        char name[64];

        snprintf(name, sizeof name, "%s/%s", models[i / N_FILES], files[i % N_FILES]);
        SPIN_TRY(spin_path_join(folder, strncmp(name, "./", 2) == 0 ? name + 2 : name, out));
        if (is_filled(*out))
            return SPIN_OK;
        free(*out);
        *out = NULL;
    }
    return SPIN_OK;
}

/* Returns the length of the word in the name of a frame's folder, such as "frame000001", "frame_1"
 * and "colmap_1"; 0 for other names. */
static size_t frame_word(const char *name)
{
    static const char *const words[] = {"frame_", "frame", "colmap_"};

    for (size_t i = 0; i < sizeof words / sizeof *words; i++) {
        size_t n = strlen(words[i]);

        if (strncmp(name, words[i], n) == 0 && isdigit((unsigned char)name[n]) &&
            strspn(name + n, "0123456789") == strlen(name + n))
            return n;
    }
    return 0;
}

/* The first frame folder that has points, and the number of frame folders whose points have the
 * same path below the folder. */
struct frames {
    char *first;
    const char *name, *rest; /* the folder's name; the path below it */
    int n;
};

static spin_status count_frame(const char *folder, const char *name, struct frames *f)
{
    SPIN_FREED char *frame = NULL, *path = NULL;

    SPIN_TRY(spin_path_join(folder, name, &frame));
    if (f->n > 0) {
        SPIN_TRY(spin_path_join(frame, f->rest, &path));
        f->n += is_filled(path);
        return SPIN_OK;
    }
    SPIN_TRY(find_model_points(frame, &f->first));
    if (f->first) {
        f->name = name;
        f->rest = f->first + strlen(frame) + 1;
        f->n = 1;
    }
    return SPIN_OK;
}

/* Sets *path to a pattern for the points of all frames. */
static spin_status make_pattern(const char *folder, const struct frames *f, char **path)
{
    size_t n = strlen(f->name) + strlen(f->rest) + 8;
    SPIN_FREED char *name = NULL;

    SPIN_TRY(spin_alloc(n, 1, (void **)&name));
    snprintf(name, n, "%.*s%%d/%s", (int)frame_word(f->name), f->name, f->rest);
    return spin_path_join(folder, name, path);
}

static spin_status find_frame_points(const char *folder, char **path, bool *per_frame)
{
    struct frames f = {0};
    char **names = NULL;
    size_t n = 0;
    spin_status status = SPIN_OK;

    SPIN_TRY(spin_folder_list(folder, &names, &n));
    for (size_t i = 0; i < n && status == SPIN_OK; i++)
        if (frame_word(names[i]) > 0)
            status = count_frame(folder, names[i], &f);
    *path = f.first;
    *per_frame = f.n > 1;
    if (status == SPIN_OK && *per_frame) {
        char *first = f.first; /* f.rest points into it */

        *path = NULL;
        status = make_pattern(folder, &f, path);
        free(first);
    }
    spin_folder_list_free(names);
    return status;
}

/* Sets *path, which the caller frees, to the file of points in the data set `folder`, or to NULL if
 * there is none. If several frames of the data set have points, *path is a pattern with "%d" for
 * the number of the frame, and *per_frame is true. */
static spin_status find_points(const char *folder, char **path, bool *per_frame)
{
    *per_frame = false;
    SPIN_TRY(find_model_points(folder, path));
    if (!*path)
        SPIN_TRY(find_frame_points(folder, path, per_frame));
    for (size_t i = 0; i < N_CLOUDS && !*path; i++) {
        SPIN_TRY(spin_path_join(folder, clouds[i], path));
        if (is_filled(*path))
            break;
        free(*path);
        *path = NULL;
    }
    return SPIN_OK;
}

static bool is_cloud(const char *name)
{
    bool found = false;

    for (size_t i = 0; i < N_CLOUDS; i++)
        found = found || strcmp(name, clouds[i]) == 0;
    return found;
}

/* Returns whether the folder contains PLY files, all of which have names that data sets use for
 * points. */
static bool holds_only_points(const char *folder)
{
    char **names = NULL;
    size_t n = 0, n_clouds = 0, n_others = 0;

    if (spin_folder_list(folder, &names, &n) != SPIN_OK)
        return false;
    for (size_t i = 0; i < n; i++) {
        n_clouds += is_cloud(names[i]);
        n_others += !is_cloud(names[i]) && spin_text_ends_any_case(names[i], ".ply");
    }
    spin_folder_list_free(names);
    return n_clouds > 0 && n_others == 0;
}

/* ---- A data set instead of a run ------------------------------------------------------------- */

/* Sets *n to the number of cameras of these views. */
static spin_status count_cameras(const struct spin_views *views, int *n)
{
    SPIN_FREED int *camera = NULL;

    SPIN_TRY(spin_alloc(views->n, sizeof *camera, (void **)&camera));
    for (size_t i = 0; i < views->n; i++)
        camera[i] = views->view[i].camera_id;
    qsort(camera, views->n, sizeof *camera, spin_by_int);
    *n = 0;
    for (size_t i = 0; i < views->n; i++)
        *n += i == 0 || camera[i] != camera[i - 1];
    return SPIN_OK;
}

/* Describes the views of a data set. If each image has its own camera and its own frame, the data
 * set does not show whether it is a static scene or the video of one moving camera. */
static spin_status describe_views(const struct spin_views *views, char out[120])
{
    char frames[48], cameras[48];
    int n;

    SPIN_TRY(count_cameras(views, &n));
    if (n > 1 && (size_t)n == views->n && views->n_dataset_frames == n)
        snprintf(out, 120, "%d images, a static scene or the video of one camera", n);
    else
        snprintf(out, 120, "%s and %s", spin_text_count(n, "camera", cameras),
                 spin_text_count(views->n_dataset_frames, "frame", frames));
    return SPIN_OK;
}

/* Quotes a path for the shell if it contains special characters: out has QUOTED(length) bytes. */
#define QUOTED(length) (4 * (length) + 3)
static const char *quote(const char *path, char *out)
{
    bool plain = strpbrk(path, " \t'\"$`\\&;()<>|*?[]!#~") == NULL;
    char *to = out;

    for (*to++ = '\''; *path; path++)
        to += *path == '\'' ? sprintf(to, "'\\''") : sprintf(to, "%c", *path);
    strcpy(to, plain ? "" : "'");
    return plain ? out + 1 : out;
}

/* Returns whether to suggest a still of the first frame, made from the points of the data set. If
 * each frame has only one training image, as from one moving camera, a clip is suggested
 * instead. */
static bool makes_still(const struct spin_views *views)
{
    size_t n = 0;
    int cameras = 0;

    if (count_cameras(views, &cameras) == SPIN_OK && (size_t)cameras == views->n)
        return true;
    for (size_t i = 0; i < views->n; i++)
        n += views->view[i].dataset_frame == 0 && !views->view[i].test;
    return n > 1;
}

/* Writes to out [n] a suggestion to import the points of the data set, with the command for this;
 * "" if the data set has no points. */
static spin_status offer_points(const char *path, const struct spin_views *views, char *out,
                                size_t n)
{
    SPIN_FREED char *points = NULL, *absolute = NULL;
    enum { LONGEST = 300 };
    char input[QUOTED(LONGEST)], data[QUOTED(LONGEST)], name[200], quoted[QUOTED(200)];
    bool per_frame, still;

    *out = '\0';
    SPIN_TRY(find_points(path, &points, &per_frame));
    SPIN_TRY(spin_path_absolute(path, &absolute));
    if (!points || strlen(points) > LONGEST || strlen(path) > LONGEST)
        return SPIN_OK;
    snprintf(name, sizeof name, "%.180s.html", spin_path_name(absolute));
    still = !per_frame && makes_still(views);
    snprintf(out, n, "; or start from %s: spin4d %s%s --data %s%s -o %s",
             per_frame ? "the points of its frames"
             : still   ? "its points, for a still of its first frame"
                       : "its points",
             quote(points, input), spin_text_ends_any_case(points, ".ply") ? " --from points" : "",
             quote(path, data), still ? " --frames 1" : "", quote(name, quoted));
    return SPIN_OK;
}

spin_status spin_explain_data_set(const char *path, spin_status status)
{
    const struct spin_importer *importer;
    SPIN_LEAVES(spin_views_free) struct spin_views views = {0};
    SPIN_FREED char *error = NULL;
    char content[120], offer[3 * QUOTED(300) + 200];

    SPIN_TRY(spin_strdup(spin_last_error(), &error));
    if (spin_importer_guess(path, true))
        SPIN_TRY(spin_views_open(path, NULL, &views, NULL, 0));
    if (spin_importer_find(path, NULL, true, &importer) != SPIN_OK ||
        (views.n == 0 && spin_views_open(path, NULL, &views, NULL, 0) != SPIN_OK))
        return spin_fail(status, "%s", error);
    SPIN_TRY(describe_views(&views, content));
    SPIN_TRY(offer_points(path, &views, offer, sizeof offer));
    return spin_fail(SPIN_E_NOT_RECOGNISED,
                     "'%s' is a data set (%s) of %s, not a run: give the folder that a method "
                     "wrote, or one PLY file of points per frame, and name this data set with "
                     "--data, see docs/how-to/from-videos.md%s",
                     path, importer->name, content, offer);
}

bool spin_run_is_points(const char *path, const char *run)
{
    return holds_only_points(run) && spin_importer_guess(path, true) != NULL;
}
