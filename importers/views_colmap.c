/* COLMAP sparse models with undistorted images.
 *
 *     sparse/0/{cameras,images,points3D}.{bin,txt}, images/ one model; each image is one frame
 *     frame000001/{sparse/0, images}, frame000002/...       3DGStream: one folder per frame, the
 *                                                           model of the first one counts for all
 *
 * The principal point of the file is kept; the methods' own readers put it in the centre, which
 * principal=centre does too. Only pinhole cameras can be rendered: a model with distortion that is not
 * zero must be undistorted first.
 *
 * With one model the time of an image is its place in the file over the number of images
 * (4DGaussians, which takes it for a video of one camera), and each eighth image by name is held
 * out (3DGS's --eval). With a folder per frame each image is a camera of every frame, times are
 * 0, 1, 2, ..., and the first camera is held out (3DGStream). */
#include "spin.h"

#include <ctype.h>
#include <limits.h>
#include <stdlib.h>
#include <string.h>

#include "base/mem.h"
#include "base/option.h"
#include "importers/lib/colmap_model.h"
#include "importers/lib/views_check.h"
#include "io/file.h"
#include "io/json.h"

/* ---- Recognising ----------------------------------------------------------------------------- */

/* "frame000012": 12, else -1. */
static int frame_number(const char *name)
{
    int n = 0;

    if (strncmp(name, "frame", 5) != 0)
        return -1;
    for (const char *c = name + 5; *c; c++, n++) {
        if (!isdigit((unsigned char)*c))
            return -1;
    }
    return n > 0 ? spin_views_number(name) : -1;
}

static int probe(const struct spin_peek *peek)
{
    bool frames = false, cameras = false, videos = false;

    for (size_t i = 0; peek->is_folder && peek->names && peek->names[i]; i++) {
        if (strcmp(peek->names[i], "sparse") == 0)
            return 100;
        frames = frames || frame_number(peek->names[i]) >= 0;
        cameras = cameras || strcmp(peek->names[i], "cameras.json") == 0;
        videos = videos || strcmp(peek->names[i], "videos") == 0;
    }
    return frames || (cameras && videos) ? 50 : 0;
}

/* ---- Look-alikes ----------------------------------------------------------------------------- */

/* A clip of 4DAnyone has a folder videos/sparse, which is no model. */
static spin_status check_not_4danyone(const char *path)
{
    char *file = NULL;
    spin_json *json = NULL;
    bool found = false;

    SPIN_TRY(spin_path_join(path, "cameras.json", &file));
    if (spin_path_exists(file) && spin_json_load(file, &json) == SPIN_OK)
        found = spin_json_string(spin_json_get(json, "camera_model")) &&
                spin_json_is_array(spin_json_get(json, "cameras"));
    spin_json_free(json);
    free(file);
    return found ? spin_fail(SPIN_E_UNSUPPORTED,
                             "'%s/cameras.json' is of a clip of 4DAnyone, which spin4d does not "
                             "read yet",
                             path)
                 : SPIN_OK;
}

/* Length of what names the camera of an image: its folder, else its name without the ending. */
static size_t camera_part(const char *name)
{
    const char *end = strrchr(name, '/');

    if (!end)
        end = strrchr(name, '.');
    return end ? (size_t)(end - name) : strlen(name);
}

/* How many numbered files the folder of this camera has. */
static spin_status count_frames(const char *images, const char *name, size_t *n_frames)
{
    char *folder = NULL, **names = NULL;
    size_t n = 0;
    spin_status status = SPIN_OK;

    *n_frames = 0;
    SPIN_TRY(spin_path_join(images, name, &folder));
    folder[strlen(folder) - strlen(name) + camera_part(name)] = '\0';
    if (spin_path_is_folder(folder))
        status = spin_folder_list(folder, &names, &n);
    for (size_t i = 0; i < n; i++)
        *n_frames += names[i][0] != '.' && spin_views_number(names[i]) >= 0;
    spin_folder_list_free(names);
    free(folder);
    return status;
}

/* In a data set of FreeTimeGS each image of the model stands for a camera, and the folder that it lies in,
 * or that has its name, holds the frames. */
static spin_status check_not_freetimegs(const struct colmap_model *m, const char *images)
{
    for (size_t i = 0; i < m->n_images; i++) {
        const char *name = m->image[i].name;
        size_t n = camera_part(name), n_frames;

        if (i > 0 && n == camera_part(m->image[i - 1].name) &&
            strncmp(name, m->image[i - 1].name, n) == 0)
            return SPIN_OK;
        SPIN_TRY(count_frames(images, name, &n_frames));
        if (n_frames < 2)
            return SPIN_OK;
    }
    return spin_fail(
        SPIN_E_UNSUPPORTED,
        "each image of the model has a folder of frames in '%s': this looks like a data "
        "set of FreeTimeGS, which spin4d does not read yet",
        images);
}

/* ---- Views ----------------------------------------------------------------------------------- */

struct options {
    const char *images; /* folder */
    bool by_name;       /* time of one model's images */
    bool centre;        /* principal points in the middle */
    int hold;           /* each hold-th is test; 0: none; -1: what suits the layout */
};

/* Numbers in the names are the cameras' when no two are equal; else their places by name. */
static spin_status camera_ids(const struct colmap_model *m, int **out)
{
    int *sorted = NULL;
    bool usable = true;

    SPIN_TRY(spin_alloc(m->n_images, sizeof **out, (void **)out));
    SPIN_TRY(spin_alloc(m->n_images, sizeof *sorted, (void **)&sorted));
    for (size_t i = 0; i < m->n_images; i++) {
        sorted[i] = (*out)[i] = spin_views_number(m->image[i].name);
        usable = usable && sorted[i] >= 0;
    }
    usable = usable && spin_views_unique(sorted, m->n_images) == m->n_images;
    for (size_t i = 0; !usable && i < m->n_images; i++)
        (*out)[i] = (int)i;
    free(sorted);
    return SPIN_OK;
}

/* One view of each image, found in `folder`; row < 0: each image is a row of its own. */
static spin_status add_views(const struct colmap_model *m, const struct options *o,
                             const char *folder, const int *ids, int row, int number,
                             struct spin_views *out)
{
    char *images = NULL;
    spin_status status;

    SPIN_TRY(spin_path_join(folder, o->images, &images));
    status = SPIN_OK;
    for (size_t i = 0; i < m->n_images && status == SPIN_OK; i++) {
        const struct colmap_image *image = &m->image[i];
        size_t place = o->by_name ? i : image->place;
        struct spin_view view = {.camera = image->camera, .camera_id = ids[i]};

        view.dataset_frame = row < 0 ? (int)place : row;
        view.number = row < 0 ? spin_views_number(image->name) : number;
        view.time = row < 0 ? (double)place / (double)m->n_images : row;
        view.test = o->hold < 0    ? (row < 0 ? i % 8 == 0 : i == 0)
                    : o->hold == 0 ? false
                                   : i % (size_t)o->hold == 0;
        status = spin_path_join(images, image->name, &view.path);
        if (status == SPIN_OK)
            status = spin_views_add(out, &view);
        free(view.path);
    }
    free(images);
    return status;
}

/* Make all cameras those of the images that are there; the first n views tell. */
static spin_status fit_cameras(const struct colmap_model *m, struct spin_views *out, size_t first)
{
    for (size_t i = 0; i < m->n_images; i++)
        SPIN_TRY(spin_views_fit_image(&out->view[first + i].camera, out->view[first + i].path));
    for (size_t i = first + m->n_images; i < out->n; i++)
        out->view[i].camera = out->view[i - m->n_images].camera;
    return SPIN_OK;
}

static int by_frame_number(const void *a, const void *b)
{
    int x = frame_number(*(char *const *)a), y = frame_number(*(char *const *)b);

    return x < y ? -1 : x > y;
}

/* Folders frame<digits>, sorted by number, to the front of names. */
static spin_status keep_frames(const char *path, char **names, size_t *n)
{
    size_t kept = 0;

    for (size_t i = 0; i < *n; i++) {
        if (frame_number(names[i]) >= 0) {
            char *name = names[i];

            names[i] = names[kept];
            names[kept++] = name;
        }
    }
    qsort(names, kept, sizeof *names, by_frame_number);
    for (size_t i = 1; i < kept; i++) {
        if (frame_number(names[i]) == frame_number(names[i - 1]))
            return spin_fail(SPIN_E_MALFORMED, "'%s' and '%s' are both frame %d", names[i - 1],
                             names[i], frame_number(names[i]));
    }
    if (kept == 0)
        return spin_fail(SPIN_E_NOT_FOUND, "'%s' has neither 'sparse' nor frame folders", path);
    *n = kept;
    return SPIN_OK;
}

static spin_status read_frames(const char *path, char **names, size_t n, struct colmap_model *m,
                               const struct options *o, struct spin_views *out)
{
    char *folder = NULL;
    int *ids = NULL;
    spin_status status;

    for (size_t f = 0; f < n; f++) {
        SPIN_TRY_OUT(spin_path_join(path, names[f], &folder));
        if (f == 0) {
            SPIN_TRY_OUT(spin_colmap_model_read(folder, o->centre, m));
            SPIN_TRY_OUT(camera_ids(m, &ids));
        }
        SPIN_TRY_OUT(add_views(m, o, folder, ids, (int)f, frame_number(names[f]), out));
        free(folder);
        folder = NULL;
    }
    status = SPIN_OK;
out:
    free(folder);
    free(ids);
    return status;
}

static spin_status read_one(const char *path, struct colmap_model *m, const struct options *o,
                            struct spin_views *out)
{
    int *ids = NULL;
    char *images = NULL;
    spin_status status;

    SPIN_TRY(spin_colmap_model_read(path, o->centre, m));
    SPIN_TRY(spin_path_join(path, o->images, &images));
    SPIN_TRY_OUT(check_not_freetimegs(m, images));
    SPIN_TRY_OUT(camera_ids(m, &ids));
    status = add_views(m, o, path, ids, -1, -1, out);
out:
    free(images);
    free(ids);
    return status;
}

static spin_status read_options(const struct spin_plugin_values *values, struct options *o)
{
    int rule;

    o->images = spin_plugin_value(values, "images", "images");
    if (!spin_views_is_safe_name(o->images))
        return spin_fail(SPIN_E_USAGE, "option 'images' is '%s', expected a folder's name",
                         o->images);
    SPIN_TRY(spin_option_word(values, "time", "file|name", &rule));
    o->by_name = rule == 1;
    SPIN_TRY(spin_option_word(values, "principal", "file|centre", &rule));
    o->centre = rule == 1;
    o->hold = -1;
    return spin_option_count(values, "hold", 0, INT_MAX, &o->hold);
}

static spin_status colmap_views(const char *path, const struct spin_plugin_values *values,
                                struct spin_views *out)
{
    struct options o = {0};
    struct colmap_model m = {0};
    size_t first = out->n, n = 0;
    char *sparse = NULL, **names = NULL;
    spin_status status;

    SPIN_TRY(read_options(values, &o));
    SPIN_TRY(check_not_4danyone(path));
    SPIN_TRY(spin_path_join(path, "sparse", &sparse));
    if (spin_path_is_folder(sparse)) {
        SPIN_TRY_OUT(read_one(path, &m, &o, out));
    } else {
        SPIN_TRY_OUT(spin_folder_list(path, &names, &n));
        SPIN_TRY_OUT(keep_frames(path, names, &n));
        SPIN_TRY_OUT(read_frames(path, names, n, &m, &o, out));
    }
    SPIN_TRY_OUT(spin_views_check_images(out, first));
    SPIN_TRY_OUT(fit_cameras(&m, out, first));
out:
    spin_folder_list_free(names);
    free(sparse);
    spin_colmap_model_free(&m);
    return status;
}

static const struct spin_plugin_option options[] = {
    {"images", "FOLDER", "where the images are, such as images_2", "images"},
    {"time", "RULE",
     "one model: frame and time i/n of an image by its place in the file, or by its name", "file"},
    {"hold", "N",
     "hold out each N-th image by name, the first included; 0: none (8; with frame folders only "
     "the first)",
     NULL},
    {"principal", "RULE", "principal point: file, or centre as the methods' readers have it",
     "file"},
    {NULL, NULL, NULL, NULL},
};

const struct spin_importer spin_importer_views_colmap = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "colmap",
    .summary = "views: COLMAP's sparse model and undistorted images, one or one per frame folder",
    .upstream = "hustvl/4DGaussians scene/colmap_loader.py, SJoJoK/3DGStream 747ddfe",
    .options = options,
    .probe = probe,
    .views = colmap_views,
};
