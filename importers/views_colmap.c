/* Data sets that are a sparse model of COLMAP with undistorted images. The model is in the
 * folder of the data set, in one of its subfolders sparse/0, sparse, sparse_ and colmap/sparse/0,
 * or in the folder of the images. The images are in one of these layouts:
 *
 *     images/<name>
 *         the images of the model; each is one frame
 *     images/<camera>/<number>.png, images/<camera>_<number>.png
 *         the model contains all frames of several cameras
 *     images/<camera>/<number>.png, <camera>/<number>.jpg, <camera>.mp4
 *         a rig: each image of the model is a camera, whose frames are in a folder or a video that
 *         is named after the image or its number, as in FreeTimeGS and in MultipleView of
 *         4DGaussians
 *     images/<number>/<name>, <number>/<name>, <number>/images/<name>
 *         a rig, with one folder per frame
 *     frame000001/{sparse/0, images}, frame000002/...; colmap_0/{sparse/0, images}, colmap_1/...
 *         3DGStream and SpacetimeGaussians: one folder per frame; the model of the first folder is
 *         used for all frames
 *
 * The principal point of the file is kept. The methods' own readers move it to the image centre, as
 * option `principal` with the value centre does.
 *
 * Times and held-out views depend on the layout:
 *
 *     first layout           image i of n in the file is at time i/n, as in 4DGaussians, which
 *                            reads such a data set as a video of one camera; every eighth image
 *                            in the order of names is held out, as by 3DGS's --eval
 *     second, third layout   frame k of n is at k/(n-1); every eighth camera is held out
 *     folders per frame      each image of the model is a camera of every frame; times are 0, 1,
 *                            2, ..., or k/n for SpacetimeGaussians; the first camera is held out,
 *                            as in 3DGStream */
#include "importers/lib/colmap.h"
#include "importers/lib/views_rig.h"
#include "io/numbered.h"

struct colmap {
    struct spin_model base;
    struct spin_colmap model;
    const char *images; /* option `images`: the folder of images; NULL: not given */
    bool numbered;      /* the names of all images have numbers */
    bool by_name; /* times follow the order of the images' names; false: the order in the file */
    int hold; /* hold out every hold-th image or camera; 0: none; -1: the default of the layout */
};

/* ---- Recognising ----------------------------------------------------------------------------- */

/* Returns N for a folder name frame<N>, frame_<N> or colmap_<N>, and -1 for other names. */
static int folder_number(const char *name)
{
    size_t n = strncmp(name, "colmap_", 7) == 0 ? 7 : strncmp(name, "frame_", 6) == 0 ? 6 : 5;

    if (n == 5)
        return spin_frame_number(name);
    return name[n] && strspn(name + n, "0123456789") == strlen(name + n) ? spin_views_number(name)
                                                                         : -1;
}

static bool has_model_files(const struct spin_peek *peek)
{
    return (spin_peek_has(peek, "images.bin") && spin_peek_has(peek, "cameras.bin")) ||
           (spin_peek_has(peek, "images.txt") && spin_peek_has(peek, "cameras.txt"));
}

static int probe(const struct spin_peek *peek)
{
    bool frames = false;

    if (spin_peek_has(peek, "sparse") || spin_peek_has(peek, "sparse_") || has_model_files(peek))
        return 100;
    for (size_t i = 0; peek->is_folder && peek->names && peek->names[i]; i++) {
        if (strncmp(peek->names[i], "colmap_", 7) == 0 && folder_number(peek->names[i]) >= 0)
            return 100;
        frames = frames || folder_number(peek->names[i]) >= 0;
    }
    return frames ? 50 : 0;
}

/* ---- Views ----------------------------------------------------------------------------------- */

/* Sets *out to the number in the name of each image, or to NULL if the names have no numbers. */
static spin_status image_numbers(struct colmap *m, int **out)
{
    SPIN_LEAVES(spin_numbers_free) struct spin_numbers numbers = {0};
    size_t n = m->model.n_images;
    const char **name;
    spin_status status;

    *out = NULL;
    SPIN_TRY(spin_model_alloc(&m->base, n, sizeof *name, (void **)&name));
    for (size_t i = 0; i < n; i++)
        name[i] = spin_path_name(m->model.image[i].name);
    status = spin_numbered_read(&(struct spin_numbering){.name = name, .n = n}, &numbers);
    if (status != SPIN_OK || numbers.number[0] < 0)
        return status == SPIN_E_MEMORY ? status : SPIN_OK;
    SPIN_TRY(spin_model_alloc(&m->base, n, sizeof **out, (void **)out));
    memcpy(*out, numbers.number, n * sizeof **out);
    return SPIN_OK;
}

/* Sets *out to the camera id of each image: the number in its name or, if the names have no
 * numbers, its index in the order of names. */
static spin_status camera_ids(struct colmap *m, int **out)
{
    SPIN_TRY(image_numbers(m, out));
    m->numbered = *out != NULL;
    if (m->numbered)
        return SPIN_OK;
    SPIN_TRY(spin_model_alloc(&m->base, m->model.n_images, sizeof **out, (void **)out));
    for (size_t i = 0; i < m->model.n_images; i++)
        (*out)[i] = (int)i;
    return SPIN_OK;
}

/* Replaces backslashes in the names of images by slashes, unless `images` contains a file with the
 * original name. */
static spin_status set_names(struct colmap *m, const char *images)
{
    for (size_t i = 0; i < m->model.n_images; i++) {
        struct spin_colmap_image *image = &m->model.image[i];

        SPIN_TRY(spin_model_name(&m->base, images, image->name, &image->name));
        if (!spin_views_is_safe_name(image->name))
            return spin_malformed("'%s': the name of an image is '%.80s', expected a path below "
                                  "the folder of images",
                                  m->model.sparse, image->name);
    }
    return SPIN_OK;
}

/* Adds a view for each image of the model; the image files are in `images`. All views belong to
 * frame `row` of the data set or, if `row` is negative, each to a frame of its own. */
static spin_status add_views(struct colmap *m, const char *images, const int *ids, int row,
                             int number, struct spin_views *out)
{
    const struct spin_colmap *c = &m->model;
    const char *path;

    for (size_t i = 0; i < c->n_images; i++) {
        const struct spin_colmap_image *image = &c->image[i];
        size_t place = m->by_name ? i : image->place;
        struct spin_view view = {.camera = image->camera, .camera_id = ids[i]};

        view.dataset_frame = row < 0 ? (int)place : row;
        view.number = row >= 0 ? number : m->numbered ? ids[i] : -1;
        view.time = row < 0 ? (double)place / (double)c->n_images : row;
        view.test = m->hold < 0    ? (row < 0 ? i % 8 == 0 : i == 0)
                    : m->hold == 0 ? false
                                   : i % (size_t)m->hold == 0;
        SPIN_TRY(spin_colmap_picture(&m->base, images, image->name, &path));
        view.path = (char *)path;
        SPIN_TRY(spin_views_add(out, &view));
    }
    return SPIN_OK;
}

/* Scales each camera to the size of its first image that exists. The views from index `first` on
 * were added by add_views(), one call per frame. */
static spin_status fit_views(const struct colmap *m, struct spin_views *out, size_t first)
{
    size_t n = m->model.n_images;

    for (size_t i = 0; i < n; i++) {
        size_t k = first + i;

        while (k + n < out->n && !spin_path_exists(out->view[k].path))
            k += n;
        SPIN_TRY(spin_views_fit_image(&out->view[k].camera, out->view[k].path));
        for (size_t j = first + i; j < out->n; j += n)
            out->view[j].camera = out->view[k].camera;
    }
    return SPIN_OK;
}

/* ---- Folders of frames ----------------------------------------------------------------------- */

struct frame_folder {
    const char *name;   /* name of the folder */
    const char *images; /* folder of the images of the frame */
    int number;
};

static int by_frame_number(const void *a, const void *b)
{
    int x = ((const struct frame_folder *)a)->number, y = ((const struct frame_folder *)b)->number;

    return x < y ? -1 : x > y;
}

static spin_status sort_folders(struct frame_folder *f, size_t n)
{
    qsort(f, n, sizeof *f, by_frame_number);
    for (size_t i = 1; i < n; i++) {
        if (f[i].number == f[i - 1].number)
            return spin_malformed("'%s' and '%s' are both frame %d", f[i - 1].name, f[i].name,
                                  f[i].number);
    }
    return SPIN_OK;
}

/* Adds the views of all frame folders, and leaves out images that do not exist, with a warning. */
static spin_status add_folders(struct colmap *m, const struct frame_folder *f, size_t n,
                               struct spin_views *out)
{
    bool per_count = strncmp(f[0].name, "colmap_", 7) == 0;
    size_t first = out->n;
    int *ids;

    if (spin_model_option(&m->base, "time"))
        return spin_misuse("option 'time' does not apply to frame folders");
    SPIN_TRY(camera_ids(m, &ids));
    for (size_t i = 0; i < n; i++)
        SPIN_TRY(add_views(m, f[i].images, ids, (int)i, f[i].number, out));
    for (size_t i = first; i < out->n && per_count; i++)
        out->view[i].time /= (double)n;
    SPIN_TRY(spin_views_check_most(out, first));
    SPIN_TRY(fit_views(m, out, first));
    return spin_views_drop_missing(out, first);
}

/* Sets *out to the folder with the images of a frame folder: the subfolder that option `images`
 * names, otherwise the subfolder images or, if there is none, the frame folder itself. */
static spin_status folder_images(struct colmap *m, const char *path, const char *name,
                                 const char **out)
{
    SPIN_TRY(spin_model_join(&m->base, out, path, "%s/%s", name, m->images ? m->images : "images"));
    if (!m->images && !spin_path_is_folder(*out))
        SPIN_TRY(spin_model_join(&m->base, out, path, "%s", name));
    return SPIN_OK;
}

/* Reads the folders frame<N>, frame_<N> or colmap_<N> in the order of N. The first one contains the
 * model. */
static spin_status read_frames(struct colmap *m, const char *path, struct spin_views *out)
{
    const char *folder;
    char **names;
    struct frame_folder *f;
    size_t n, kept = 0;

    SPIN_TRY(spin_model_names(&m->base, path, &names, &n));
    SPIN_TRY(spin_model_alloc(&m->base, n, sizeof *f, (void **)&f));
    for (size_t i = 0; i < n; i++) {
        if (folder_number(names[i]) < 0)
            continue;
        f[kept] = (struct frame_folder){.name = names[i], .number = folder_number(names[i])};
        SPIN_TRY(folder_images(m, path, names[i], &f[kept++].images));
    }
    if (kept == 0)
        return spin_not_found("'%s' has neither a COLMAP model nor frame folders", path);
    SPIN_TRY(sort_folders(f, kept));
    SPIN_TRY(spin_model_join(&m->base, &folder, path, "%s", f[0].name));
    SPIN_TRY(spin_colmap_find(&m->model, folder));
    if (!m->model.sparse)
        return spin_not_found("'%s' has neither images.bin nor images.txt in 'sparse/0', 'sparse' "
                              "or the folder itself",
                              folder);
    SPIN_TRY(spin_colmap_read(&m->model));
    SPIN_TRY(set_names(m, f[0].images));
    return add_folders(m, f, kept, out);
}

/* If some folders in `parent` are numbered and contain the first image of the model, directly or in
 * the subfolder images, reads them as the frames of a rig and sets *found. */
static spin_status read_numbered(struct colmap *m, const char *parent, struct spin_views *out,
                                 bool *found)
{
    const char *first = m->model.image[0].name, *folder, *path;
    char **names;
    struct frame_folder *f;
    size_t n, kept = 0;

    *found = false;
    if (!spin_path_is_folder(parent))
        return SPIN_OK;
    SPIN_TRY(spin_model_names(&m->base, parent, &names, &n));
    SPIN_TRY(spin_model_alloc(&m->base, n, sizeof *f, (void **)&f));
    for (size_t i = 0; i < n; i++) {
        if (spin_views_number(names[i]) < 0 || spin_colmap_is_other(names[i]))
            continue;
        SPIN_TRY(folder_images(m, parent, names[i], &folder));
        SPIN_TRY(spin_colmap_picture(&m->base, folder, first, &path));
        f[kept] = (struct frame_folder){names[i], folder, spin_views_number(names[i])};
        kept += spin_path_exists(path);
    }
    *found = kept > 1;
    if (!*found)
        return SPIN_OK;
    SPIN_TRY(sort_folders(f, kept));
    return add_folders(m, f, kept, out);
}

/* ---- One model ------------------------------------------------------------------------------- */

static spin_status read_manifest(void *model, const spin_json *root, struct spin_views *out)
{
    spin_rig_note(model, spin_json_get(root, "fps"), out);
    return SPIN_OK;
}

static spin_status read_rig(struct colmap *m, struct spin_colmap_rig *rig, const char *path,
                            struct spin_views *out)
{
    bool found;

    SPIN_TRY(spin_rig_views(&m->base, rig->camera, rig->n, out));
    SPIN_TRY(spin_views_read_json(path, "manifest.json", read_manifest, &m->base, out, &found));
    if (!found)
        spin_rig_note(&m->base, NULL, out);
    return SPIN_OK;
}

/* Sets *out to the folder that contains the images of the model: that of option `images`, otherwise
 * the first of some usual folders that contains the first image. */
static spin_status find_images(struct colmap *m, const char *path, const char **out)
{
    static const char *const places[] = {"images", ".", "input", "../images", "../../images"};
    const char *folder, *picture;

    SPIN_TRY(spin_model_join(&m->base, out, path, "%s", m->images ? m->images : "images"));
    for (size_t i = 0; i < 1 + sizeof places / sizeof *places && !m->images; i++) {
        if (i == 0)
            folder = m->model.sparse; /* some programs write the model beside the images */
        else
            SPIN_TRY(spin_model_join(&m->base, &folder, path, "%s", places[i - 1]));
        SPIN_TRY(spin_colmap_picture(&m->base, folder, m->model.image[0].name, &picture));
        if (spin_path_exists(picture)) {
            *out = folder;
            break;
        }
    }
    return SPIN_OK;
}

static spin_status read_single(struct colmap *m, const char *images, struct spin_views *out)
{
    size_t first = out->n;
    int *ids, rule;

    SPIN_TRY(spin_option_word(m->base.values, "time", "file|name", &rule));
    m->by_name = rule == 1;
    SPIN_TRY(camera_ids(m, &ids));
    SPIN_TRY(add_views(m, images, ids, -1, -1, out));
    SPIN_TRY(spin_views_check_most(out, first));
    SPIN_TRY(spin_views_drop_missing(out, first));
    for (size_t i = first; i < out->n; i++)
        SPIN_TRY(spin_views_fit_image(&out->view[i].camera, out->view[i].path));
    return SPIN_OK;
}

static spin_status read_one(struct colmap *m, const char *path, struct spin_views *out)
{
    const char *const parents[] = {m->images ? m->images : "images", ".", "frames"};
    struct spin_colmap_rig rig = {0};
    const char *images, *parent;
    bool found;

    SPIN_TRY(spin_colmap_read(&m->model));
    SPIN_TRY(find_images(m, path, &images));
    SPIN_TRY(set_names(m, images));
    for (size_t i = 0; i < sizeof parents / sizeof *parents; i++) {
        SPIN_TRY(spin_model_join(&m->base, &parent, path, "%s", parents[i]));
        SPIN_TRY(read_numbered(m, parent, out, &found));
        if (found)
            return SPIN_OK;
    }
    SPIN_TRY(spin_colmap_find_rig(&m->model, path, images, &rig));
    if (rig.n > 0)
        return read_rig(m, &rig, path, out);
    return read_single(m, images, out);
}

static spin_status read_options(struct colmap *m)
{
    const struct spin_plugin_values *values = m->base.values;
    int rule;

    m->images = spin_model_option(&m->base, "images");
    if (m->images && !spin_views_is_safe_name(m->images))
        return spin_misuse("option 'images' is '%s', expected the name of a folder in the data set",
                           m->images);
    SPIN_TRY(spin_option_word(values, "principal", "file|centre", &rule));
    m->model.centre = rule == 1;
    m->hold = -1;
    return spin_option_count(values, "hold", 0, INT_MAX, &m->hold);
}

static spin_status read_set(struct colmap *m, const char *path, struct spin_views *out)
{
    m->model.base = &m->base;
    SPIN_TRY(read_options(m));
    SPIN_TRY(spin_colmap_find(&m->model, path));
    if (m->model.sparse)
        return read_one(m, path, out);
    return read_frames(m, path, out);
}

static spin_status colmap_views(const char *path, const struct spin_plugin_values *values,
                                struct spin_views *out)
{
    struct colmap m = {.base = {.path = path, .values = values}};
    spin_status status = read_set(&m, path, out);

    free(m.model.image);
    free(m.model.lens);
    spin_model_clear(&m.base);
    return status;
}

static const struct spin_plugin_option options[] = {
    {"images", "FOLDER", "the folder of the images, such as images_2", "images"},
    {"time", "RULE",
     "single model: image i of n is at time i/n, in the order of the file (file) or of the names "
     "(name); FreeTimeGS: time of frame i of n: unit for i/(n-1), count for i/n, row for i, a "
     "number N for i/N (default: file; FreeTimeGS: unit)",
     NULL},
    {"hold", "N",
     "hold out every N-th image or camera by name, including the first; 0: none (default: 8; with "
     "frame folders: only the first camera)",
     NULL},
    SPIN_OFFSETS_OPTION,
    {"principal", "RULE", "principal point: file, or centre as in the methods' readers", "file"},
    {NULL, NULL, NULL, NULL},
};

const struct spin_importer spin_importer_views_colmap = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "colmap",
    .summary = "views: COLMAP's sparse model and undistorted images; folders per frame, or per "
               "camera (FreeTimeGS)",
    .upstream = "hustvl/4DGaussians scene/colmap_loader.py, SJoJoK/3DGStream 747ddfe",
    .options = options,
    .probe = probe,
    .views = colmap_views,
};
