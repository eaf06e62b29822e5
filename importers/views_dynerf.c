/* Data sets of Neural 3D Video (DyNeRF) and Meet Room: static cameras in a file of LLFF, and the
 * frames of each camera.
 *
 *     poses_bounds.npy                [C][17]: 3 x 5 matrix, near, far; one row per camera
 *     cam00/images/0000.png ...       as 4DGaussians extracts them (or cam00/0000.png)
 *     images/cam00_0000.png ...       as n3v2blender extracts them
 *     frames/0000/images/cam00.png    as StreamRF extracts them
 *     cam00.mp4 ...                   the videos themselves, when no frames were extracted
 *
 * Row i of poses_bounds belongs to the i-th existing camera in the order of the camera numbers, not
 * to the camera with number i. The 3 x 5 matrix consists of the rotation of c2w, in LLFF's axes
 * [down, right, back]; of the camera's position; and of a column with height, width and focal
 * length of the full-size video. The importer does not transform the world, which is that of LLFF,
 * as in 4DGaussians and Deformable-3DGS. */
#include <strings.h>

#include "importers/lib/views_check.h"
#include "importers/lib/views_rig.h"
#include "io/npy.h"
#include "io/numbered.h"
#include "io/video.h"

enum { COLUMNS = 17 };

struct frame_image {
    const char *path;
    int camera, number; /* camera number and frame number, from the names */
};

struct set {
    struct spin_model base; /* base.path: the folder of the data set */
    struct spin_offsets offsets;
    struct frame_image *image;
    size_t n, capacity;
    int *video; /* camera numbers of the video files, sorted */
    size_t n_video;
    int *camera; /* camera numbers in the order of the rows of poses_bounds */
    size_t n_cameras;
    int *number; /* [n_rows] sorted frame numbers; the index is the frame of the data set */
    size_t n_rows;
    double *pose;                   /* [n_cameras][17] */
    struct spin_camera *intrinsics; /* [n_cameras] the cameras, scaled to the images' size */
};

static int probe(const struct spin_peek *peek)
{
    return spin_peek_has(peek, "poses_bounds.npy") ? 80 : 0;
}

/* ---- Finding the images ---------------------------------------------------------------------- */

static bool is_image(const char *name)
{
    const char *dot = strrchr(name, '.');

    return dot && name[0] != '.' &&
           (strcasecmp(dot, ".png") == 0 || strcasecmp(dot, ".jpg") == 0 ||
            strcasecmp(dot, ".jpeg") == 0);
}

static spin_status add_image(struct set *set, const char *folder, const char *name, int camera,
                             int number)
{
    SPIN_TRY(spin_array_grow(set->n, &set->capacity, sizeof *set->image, (void **)&set->image));
    set->image[set->n] = (struct frame_image){.camera = camera, .number = number};
    SPIN_TRY(spin_model_join(&set->base, &set->image[set->n].path, folder, "%s", name));
    set->n++;
    return SPIN_OK;
}

/* `names` lists the *n files of a folder. Moves images to the front of this list and sets *n to
 * their number. Sets (*camera)[i] to the camera of image i: `given` or, if `given` is -1, the
 * number in the name of the image. */
static spin_status find_cameras(struct set *set, const char *folder, char **names, int given,
                                size_t *n, int **camera)
{
    size_t n_names = *n;

    *n = 0;
    SPIN_TRY(spin_model_alloc(&set->base, n_names, sizeof **camera, (void **)camera));
    for (size_t i = 0; i < n_names; i++) {
        if (!is_image(names[i]))
            continue;
        (*camera)[*n] = given >= 0 ? given : spin_camera_number(names[i]);
        if ((*camera)[*n] < 0)
            return spin_malformed("image '%s/%s' is not named cam<number>...", folder, names[i]);
        names[(*n)++] = names[i];
    }
    return SPIN_OK;
}

/* Adds the images of a folder. If `camera` is 0 or more, all images are of that camera, and their
 * names contain frame numbers. If `number` is 0 or more, all images are of that frame, and their
 * names contain camera numbers. If both are -1, the names contain both numbers. Names that have an
 * order but no whole numbers, such as time stamps, are numbered from 0. */
static spin_status add_folder(struct set *set, const char *folder, int camera, int number)
{
    SPIN_LEAVES(spin_numbers_free) struct spin_numbers numbers = {0};
    struct spin_numbering numbering = {0};
    char **names;
    int *of, place = 0;

    if (!spin_path_is_folder(folder))
        return SPIN_OK;
    SPIN_TRY(spin_model_names(&set->base, folder, &names, &numbering.n));
    SPIN_TRY(find_cameras(set, folder, names, camera, &numbering.n, &of));
    numbering.name = (const char *const *)names;
    numbering.group = of;
    if (number < 0)
        SPIN_TRY_IN(spin_numbered_read(&numbering, &numbers), "folder '%s'", folder);
    if (number < 0 && numbering.n > 0 && !numbers.numbered)
        return spin_malformed("image '%s/%s' has no frame number in its name", folder, names[0]);
    for (size_t k = 0; k < numbering.n; k++) {
        size_t i = number < 0 ? numbers.order[k] : k;

        place = k > 0 && of[i] == set->image[set->n - 1].camera ? place + 1 : 0;
        SPIN_TRY(add_image(set, folder, names[i], of[i],
                           number >= 0              ? number
                           : numbers.number[i] >= 0 ? numbers.number[i]
                                                    : place));
    }
    return SPIN_OK;
}

/* Sets *out to folder/name/images, or to folder/name if that folder does not exist. */
static spin_status images_folder(struct set *set, const char *folder, const char *name,
                                 const char **out)
{
    SPIN_TRY(spin_model_join(&set->base, out, folder, "%s/images", name));
    return spin_path_is_folder(*out) ? SPIN_OK
                                     : spin_model_join(&set->base, out, folder, "%s", name);
}

/* Adds the images of one camera. Refuses an empty folder, which an interrupted extraction leaves
 * behind. */
static spin_status add_camera_folder(struct set *set, const char *name)
{
    size_t before = set->n;
    const char *folder;

    SPIN_TRY(images_folder(set, set->base.path, name, &folder));
    SPIN_TRY(add_folder(set, folder, spin_camera_number(name), -1));
    if (spin_path_is_folder(folder) && set->n == before)
        return spin_not_found(
            "folder '%s' contains no images: their extraction may have been interrupted", folder);
    return SPIN_OK;
}

/* Adds the images in the numbered subfolders of the folder `frames`. Each subfolder holds the
 * images of one frame. */
static spin_status add_frame_folders(struct set *set, const char *frames)
{
    SPIN_LEAVES(spin_numbers_free) struct spin_numbers numbers = {0};
    struct spin_numbering numbering = {.folders = true};
    const char *folder;
    char **names;
    size_t n;

    if (!spin_path_is_folder(frames))
        return SPIN_OK;
    SPIN_TRY(spin_model_names(&set->base, frames, &names, &n));
    for (size_t i = 0; i < n; i++)
        if (names[i][0] != '.' && strpbrk(names[i], "0123456789"))
            names[numbering.n++] = names[i];
    numbering.name = (const char *const *)names;
    SPIN_TRY_IN(spin_numbered_read(&numbering, &numbers), "folder '%s'", frames);
    for (size_t k = 0; k < numbering.n; k++) {
        size_t i = numbers.order[k];

        SPIN_TRY(images_folder(set, frames, names[i], &folder));
        SPIN_TRY(add_folder(set, folder, -1, numbers.number[i] >= 0 ? numbers.number[i] : (int)k));
    }
    return SPIN_OK;
}

/* Adds the frames of every video as images with paths such as "cam00.mp4#7", for frame 7. Readers
 * of images decode the frame when they open such a path. */
static spin_status add_video_frames(struct set *set, char **names)
{
    struct spin_rig_video *video;
    size_t n = 0;

    SPIN_TRY_IN(
        spin_video_start(),
        "there are %zu videos and no frames cam<NN>/images/<number>.png extracted from them",
        set->n_video);
    SPIN_TRY(spin_model_alloc(&set->base, set->n_video, sizeof *video, (void **)&video));
    for (size_t i = 0; names[i]; i++) {
        if (spin_camera_number(names[i]) < 0 || !spin_video_is_name(names[i]))
            continue;
        video[n].camera = names[i];
        SPIN_TRY(spin_model_join(&set->base, &video[n].file, set->base.path, "%s", names[i]));
        n++;
    }
    SPIN_TRY(spin_video_rows(&set->base, video, n, &set->offsets));
    for (size_t i = 0; i < n; i++) {
        for (size_t k = 0; k < video[i].frames.n_frames; k++)
            SPIN_TRY(add_image(
                set, set->base.path, video[i].frames.frame[k].path + strlen(set->base.path) + 1,
                spin_camera_number(video[i].camera), video[i].frames.frame[k].number));
    }
    return SPIN_OK;
}

/* Adds the offset of each camera to the frame numbers of its images, and drops images whose number
 * is then below 0. */
static spin_status shift_images(struct set *set)
{
    size_t kept = 0;

    for (size_t i = 0; i < set->n && set->offsets.n > 0; i++) {
        char name[32];
        const struct spin_offset *offset;

        snprintf(name, sizeof name, "cam%02d", set->image[i].camera);
        offset = spin_offsets_of(&set->offsets, name);
        if (offset && offset->in_seconds)
            return spin_misuse("the offset of camera '%s' is in seconds, but the frame rate of its "
                               "images is unknown: give a number of frames",
                               name);
        set->image[i].number += offset ? (int)offset->value : 0;
        if (set->image[i].number >= 0)
            set->image[kept++] = set->image[i];
    }
    set->n = set->offsets.n > 0 ? kept : set->n;
    return SPIN_OK;
}

/* Adds the images of the first of the three layouts of extracted frames that exists or, if there is
 * none, the frames of the videos. */
static spin_status find_images(struct set *set)
{
    const char *folder = set->base.path, *images, *frames;
    char **names;
    size_t n;

    SPIN_TRY(spin_model_names(&set->base, folder, &names, &n));
    SPIN_TRY(spin_model_alloc(&set->base, n, sizeof *set->video, (void **)&set->video));
    for (size_t i = 0; i < n; i++) {
        if (spin_camera_number(names[i]) < 0)
            continue;
        if (spin_video_is_name(names[i]))
            set->video[set->n_video++] = spin_camera_number(names[i]);
        else
            SPIN_TRY(add_camera_folder(set, names[i]));
    }
    SPIN_TRY(spin_model_join(&set->base, &images, folder, "images"));
    SPIN_TRY(spin_model_join(&set->base, &frames, folder, "frames"));
    if (set->n == 0)
        SPIN_TRY(add_folder(set, images, -1, -1));
    if (set->n == 0)
        SPIN_TRY(add_frame_folders(set, frames));
    if (set->n > 0)
        SPIN_TRY(shift_images(set));
    else if (set->n_video > 0)
        SPIN_TRY(add_video_frames(set, names));
    SPIN_TRY(spin_offsets_check(&set->offsets));
    if (set->n == 0)
        return spin_not_found("there are no images cam<NN>/images/<number>.png, "
                              "images/cam<NN>_<number>.png or frames/<number>/images/cam<NN>.png");
    return SPIN_OK;
}

/* ---- Cameras --------------------------------------------------------------------------------- */

static spin_status read_poses(struct set *set)
{
    struct spin_array array;
    SPIN_LEAVES(spin_map_close) struct spin_map map = {0};
    const char *path;
    char shape[128];

    SPIN_TRY(spin_model_join(&set->base, &path, set->base.path, "poses_bounds.npy"));
    SPIN_TRY(spin_map_open(path, &map));
    SPIN_TRY(spin_npy_parse(path, map.data, map.size, &array));
    if (array.n_dims != 2 || array.shape[1] != COLUMNS || array.shape[0] == 0 ||
        array.shape[0] > 1 << 20 || array.kind != 'f') {
        spin_array_shape_text(array.n_dims, array.shape, shape, sizeof shape);
        return spin_malformed("'%s' has shape %s, expected [cameras, %d] of floating-point numbers",
                              path, shape, COLUMNS);
    }
    set->n_cameras = (size_t)array.shape[0];
    SPIN_TRY(spin_model_alloc(&set->base, set->n_cameras, COLUMNS * sizeof *set->pose,
                              (void **)&set->pose));
    spin_array_to_f64(&array, 0, array.count, set->pose);
    return SPIN_OK;
}

/* Lists the distinct camera numbers of all images or, if `cameras` is false, the distinct frame
 * numbers. */
static spin_status list_numbers(struct set *set, bool cameras, int **out, size_t *n)
{
    SPIN_TRY(spin_model_alloc(&set->base, set->n, sizeof **out, (void **)out));
    for (size_t i = 0; i < set->n; i++)
        (*out)[i] = cameras ? set->image[i].camera : set->image[i].number;
    *n = spin_views_unique(*out, set->n);
    return SPIN_OK;
}

/* Assigns the rows of poses_bounds to the cameras that have images. If their number differs from
 * that of the rows, but there are as many videos as rows, assigns the rows to the cameras of the
 * videos. */
static spin_status match_cameras(struct set *set)
{
    size_t n = 0;

    SPIN_TRY(list_numbers(set, true, &set->camera, &n));
    set->n_video = spin_views_unique(set->video, set->n_video);
    if (n != set->n_cameras && set->n_video == set->n_cameras) {
        for (size_t i = 0; i < n; i++) {
            if (spin_views_index_of(set->video, set->n_video, set->camera[i]) < 0)
                return spin_malformed("camera %d has images but no video", set->camera[i]);
        }
        spin_warn("'%s': %s no images", set->base.path,
                  spin_text_share(set->n_cameras - n, set->n_cameras, "camera", "has", "have",
                                  (char[96]){0}));
        set->camera = set->video;
        return SPIN_OK;
    }
    if (n != set->n_cameras)
        return spin_malformed("poses_bounds.npy has %zu rows, but there are images of %zu cameras",
                              set->n_cameras, n);
    return SPIN_OK;
}

/* Converts a row of poses_bounds to a camera of the full-size video. */
static spin_status read_camera(const double row[COLUMNS], struct spin_camera *out)
{
    double c2w[12];

    for (int i = 0; i < COLUMNS; i++) {
        if (!isfinite(row[i]))
            return spin_malformed("column %d is not finite", i);
    }
    /* Converts LLFF's axes [down, right, back] to OpenCV's [right, down, forward]. */
    for (int i = 0; i < 3; i++) {
        c2w[4 * i] = row[5 * i + 1];
        c2w[4 * i + 1] = row[5 * i];
        c2w[4 * i + 2] = -row[5 * i + 2];
        c2w[4 * i + 3] = row[5 * i + 3];
    }
    SPIN_TRY(spin_views_check_pose(c2w, "the pose"));
    spin_views_invert(c2w, out->w2c);
    SPIN_TRY(spin_views_size(row[9], row[4], out));
    out->fx = out->fy = row[14];
    out->cx = out->width / 2.0;
    out->cy = out->height / 2.0;
    return spin_views_check_intrinsics(out);
}

/* Converts all rows of poses_bounds, and scales each camera to the size of its first image. */
static spin_status read_cameras(struct set *set)
{
    bool differs = false;

    SPIN_TRY(spin_model_alloc(&set->base, set->n_cameras, sizeof *set->intrinsics,
                              (void **)&set->intrinsics));
    for (size_t c = 0; c < set->n_cameras; c++) {
        SPIN_TRY_IN(read_camera(set->pose + COLUMNS * c, &set->intrinsics[c]),
                    "poses_bounds.npy: row %zu", c);
        differs = differs || set->pose[COLUMNS * c + 14] != set->pose[14];
        for (size_t i = 0; i < set->n; i++) {
            if (set->image[i].camera == set->camera[c]) {
                SPIN_TRY(spin_views_fit_image(&set->intrinsics[c], set->image[i].path));
                break;
            }
        }
    }
    if (differs)
        spin_warn("'%s': focal lengths differ between cameras; each keeps its own, other readers "
                  "use the first for all",
                  set->base.path);
    return SPIN_OK;
}

/* ---- Views ----------------------------------------------------------------------------------- */

/* Checks that no camera has two images of a frame, and that more than half of all images exist. If
 * fewer exist, equal frame numbers of different cameras probably mean different frames. */
static spin_status check_rows(struct set *set)
{
    size_t n = set->n_cameras * set->n_rows, n_there;
    bool *seen;
    int *camera;

    SPIN_TRY(list_numbers(set, true, &camera, &n_there));
    SPIN_TRY(spin_model_alloc(&set->base, n, sizeof *seen, (void **)&seen));
    for (size_t i = 0; i < set->n; i++) {
        int c = spin_views_index_of(set->camera, set->n_cameras, set->image[i].camera);
        int row = spin_views_index_of(set->number, set->n_rows, set->image[i].number);
        bool *at = &seen[(size_t)c * set->n_rows + (size_t)row];

        if (*at)
            return spin_malformed("camera %d has two images of frame %d, the second is '%s'",
                                  set->image[i].camera, set->image[i].number, set->image[i].path);
        *at = true;
    }
    if (2 * set->n <= n_there * set->n_rows)
        return spin_malformed("there are %zu images for %zu cameras and %zu frames: the frame "
                              "numbers of the cameras differ",
                              set->n, n_there, set->n_rows);
    return SPIN_OK;
}

/* Refuses a camera that has as many frames as the first camera but starts at a different frame
 * number: equal frame numbers of the two cameras then probably mean different times. */
static spin_status check_first_numbers(const struct set *set)
{
    int first[2] = {0}, count[2] = {0};

    for (size_t c = 0; c < set->n_cameras && set->offsets.n == 0; c++) {
        int least = INT_MAX, n = 0;

        for (size_t i = 0; i < set->n; i++) {
            if (set->image[i].camera != set->camera[c])
                continue;
            least = set->image[i].number < least ? set->image[i].number : least;
            n++;
        }
        first[c > 0] = least;
        count[c > 0] = n;
        if (c > 0 && n > 0 && n == count[0] && least != first[0])
            return spin_malformed("the images of camera %d begin with frame %d and those of camera "
                                  "%d with frame %d: if they show the same time, give 'offsets' "
                                  "(see spin-importers(7))",
                                  set->camera[0], first[0], set->camera[c], least);
    }
    return SPIN_OK;
}

static spin_status add_views(const struct set *set, const struct spin_plugin_values *values,
                             struct spin_views *out)
{
    int test = 0;

    SPIN_TRY(spin_option_count(values, "test", -1, INT_MAX, &test));
    if (test >= (int)set->n_cameras)
        return spin_misuse("option 'test' is %d, expected -1 or the index of a camera, 0 to %zu",
                           test, set->n_cameras - 1);
    for (size_t i = 0; i < set->n; i++) {
        const struct frame_image *image = &set->image[i];
        int c = spin_views_index_of(set->camera, set->n_cameras, image->camera);
        struct spin_view view = {.camera = set->intrinsics[c],
                                 .dataset_frame =
                                     spin_views_index_of(set->number, set->n_rows, image->number),
                                 .number = image->number,
                                 .camera_id = image->camera,
                                 .test = c == test,
                                 .path = (char *)image->path};

        SPIN_TRY(
            spin_views_time(values, "300", (size_t)view.dataset_frame, set->n_rows, &view.time));
        SPIN_TRY(spin_views_add(out, &view));
    }
    if (set->n != set->n_rows * set->n_cameras)
        spin_warn("'%s': %zu images for %zu cameras and %zu frames: %zu images are missing",
                  set->base.path, set->n, set->n_cameras, set->n_rows,
                  set->n_rows * set->n_cameras - set->n);
    return SPIN_OK;
}

static spin_status read_set(struct set *set, struct spin_views *out)
{
    SPIN_TRY(read_poses(set));
    SPIN_TRY(spin_offsets_read(&set->base, &set->offsets));
    SPIN_TRY(find_images(set));
    SPIN_TRY(match_cameras(set));
    SPIN_TRY(list_numbers(set, false, &set->number, &set->n_rows));
    SPIN_TRY(check_rows(set));
    SPIN_TRY(check_first_numbers(set));
    SPIN_TRY(read_cameras(set));
    return add_views(set, set->base.values, out);
}

static spin_status dynerf_views(const char *path, const struct spin_plugin_values *values,
                                struct spin_views *out)
{
    struct set set = {.base = {.path = path, .values = values}};
    spin_status status = read_set(&set, out);

    free(set.image);
    spin_model_clear(&set.base);
    return status;
}

static const struct spin_plugin_option options[] = {
    {"time", "RULE",
     "time of frame i of n: a number N for i/N (300 as in 4DGaussians), unit for i/(n-1), count "
     "for i/n, row for i",
     "300"},
    SPIN_OFFSETS_OPTION,
    {"test", "PLACE", "index of the camera that is held out, -1: none", "0"},
    {NULL, NULL, NULL, NULL},
};

const struct spin_importer spin_importer_views_dynerf = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "dynerf",
    .summary = "views: Neural 3D Video, Meet Room: poses_bounds.npy and extracted frames or videos",
    .upstream = "hustvl/4DGaussians scene/neural_3D_dataset_NDC.py",
    .options = options,
    .probe = probe,
    .views = dynerf_views,
};
