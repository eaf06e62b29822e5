/* Data sets of 4DAnyone: synchronised videos that a network generated from a single video.
 *
 *     cameras.json                    camera_model, cameras[]: camera_id, K, image_width,
 *                                     image_height, camera_to_world (OpenCV's axes), video
 *     metadata.json                   output.fps (may be missing)
 *     videos/dense/00.mp4 ...         the videos, as named by `video`
 *     images/00/000000.png ...        frames of a video, read instead of the video if they exist
 *
 * The y axis of the world points up; the importer does not rotate the world. The folders
 * videos/sparse and skeletons do not contain views. The data set does not state held-out cameras.
 */
#include "importers/lib/views_rig.h"
#include "io/video.h"

enum { HEAD = 4096 };

static int probe(const struct spin_peek *peek)
{
    char head[HEAD];
    SPIN_FREED char *path = NULL;
    size_t n = 0;
    bool says;

    if (!spin_peek_has(peek, "cameras.json") ||
        spin_path_join(peek->path, "cameras.json", &path) != SPIN_OK)
        return 0;
    says = spin_file_head(path, head, sizeof head, &n) == SPIN_OK &&
           memmem(head, n, "\"camera_model\"", 14);
    return says ? 75 : 0;
}

/* ---- One camera ------------------------------------------------------------------------------ */

static spin_status read_size(const spin_json *json, struct spin_camera *out)
{
    double width, height;

    if (!spin_json_number(spin_json_get(json, "image_width"), &width) ||
        !spin_json_number(spin_json_get(json, "image_height"), &height))
        return spin_malformed("'image_width' and 'image_height' must both be numbers");
    return spin_views_size(width, height, out);
}

static spin_status read_camera(struct spin_model *m, const spin_json *json, int64_t place,
                               struct spin_rig_camera *out)
{
    const char *video = spin_json_string(spin_json_get(json, "video")), *name, *film, *pictures;
    double k[9], c2w[16];
    int64_t id;

    if (!spin_json_integer(spin_json_get(json, "camera_id"), &id) || id != place)
        return spin_malformed("'camera_id' is not %lld, the camera's index in the list",
                              (long long)place);
    SPIN_TRY(read_size(json, &out->camera));
    SPIN_TRY(spin_views_matrix(spin_json_get(json, "K"), "K", 3, k));
    SPIN_TRY(spin_views_intrinsics(k, "K", &out->camera));
    SPIN_TRY(spin_views_matrix(spin_json_get(json, "camera_to_world"), "camera_to_world", 4, c2w));
    SPIN_TRY(spin_views_check_pose(c2w, "'camera_to_world'"));
    spin_views_invert(c2w, out->camera.w2c);
    if (video)
        SPIN_TRY(spin_model_name(m, m->path, video, &video));
    if (!video || !spin_views_is_safe_name(video) || !spin_video_is_name(video))
        return spin_malformed("'video' is '%s', expected a video below the folder of the data set",
                              video ? video : "");
    name = spin_path_name(video);
    SPIN_TRY(spin_model_join(m, &film, m->path, "%s", video));
    SPIN_TRY(spin_model_join(m, &pictures, m->path, "images/%.*s", (int)(strrchr(name, '.') - name),
                             name));
    out->name = video;
    return spin_path_is_folder(pictures) ? spin_rig_pictures(m, out, pictures)
                                         : spin_rig_film(out, film, pictures);
}

/* ---- The files ------------------------------------------------------------------------------- */

static spin_status read_cameras(void *model, const spin_json *root, struct spin_views *out)
{
    struct spin_model *m = model;
    const char *kind = spin_json_string(spin_json_get(root, "camera_model"));
    const spin_json *list = spin_json_get(root, "cameras");
    size_t n = spin_json_length(list);
    struct spin_rig_camera *camera;

    if (!kind || strcmp(kind, "OPENCV") != 0)
        return spin_unsupported("'camera_model' is '%s', expected OPENCV", kind ? kind : "");
    if (!spin_json_is_array(list) || n == 0)
        return spin_malformed("list 'cameras' is missing or empty");
    SPIN_TRY(spin_model_alloc(m, n, sizeof *camera, (void **)&camera));
    for (size_t i = 0; i < n; i++) {
        SPIN_TRY_IN(read_camera(m, spin_json_at(list, i), (int64_t)i, &camera[i]), "camera %zu", i);
    }
    return spin_rig_views(m, camera, n, out);
}

static spin_status read_metadata(void *model, const spin_json *root, struct spin_views *out)
{
    spin_rig_note(model, spin_json_get(spin_json_get(root, "output"), "fps"), out);
    return SPIN_OK;
}

static spin_status read_set(struct spin_model *m, struct spin_views *out)
{
    bool found;

    SPIN_TRY(spin_views_read_json(m->path, "cameras.json", read_cameras, m, out, NULL));
    SPIN_TRY(spin_views_read_json(m->path, "metadata.json", read_metadata, m, out, &found));
    if (!found)
        spin_rig_note(m, NULL, out);
    spin_note(out, "the y axis of the data set's world points up: use spin-export --up y");
    return SPIN_OK;
}

static const struct spin_plugin_option options[] = {SPIN_RIG_OPTIONS, {NULL, NULL, NULL, NULL}};

SPIN_VIEWS_IMPORTER(views_4danyone, "4danyone", struct spin_model, read_set,
                    .summary = "views: videos of 4DAnyone, or their images, and cameras.json",
                    .upstream = "ant-research/4DAnyone f7da3ae", .options = options, .probe = probe)
