/* Renders the clip to a video: MP4 or WebM, depending on the extension of the output. The camera is
 * one of the data set's, or moves along a path while the clip plays. An image may consist of
 * several panels side by side. */
#include "base/base.h"
#include "exporters/lib/camera_path.h"
#include "io/video.h"

static const struct spin_plugin_option options[] = {
    SPIN_DRAWING_OPTION_PATH,
    SPIN_DRAWING_OPTIONS,
    {"fps", "F",
     "frames per second; default: that of the file of --path, else the bundle's, else 30, or fewer "
     "if the video would take less than two seconds",
     NULL},
    {"quality", "Q", "0 (best) to 51 (smallest)", "18"},
    {0},
};

struct export
{
    struct spin_camera_path drawing;
    struct spin_video_out *video;
    /* Identifies the data set's camera that renders all frames: one of its views. NULL: the camera
     * is not in the data set. */
    const struct spin_view *first;
    int size[2]; /* width, height of a panel in pixels */
};

static const struct spin_view *view_of(const struct export *x, int frame, int camera_id)
{
    const struct spin_export_job *job = x->drawing.job;
    int row = job->dataset_frame_of ? job->dataset_frame_of[frame] : frame;

    for (size_t i = 0; i < job->views->n; i++)
        if (job->views->view[i].dataset_frame == row && job->views->view[i].camera_id == camera_id)
            return &job->views->view[i];
    return NULL;
}

static spin_status choose_camera(struct export *x)
{
    const struct spin_export_job *job = x->drawing.job;
    int row = job->dataset_frame_of ? job->dataset_frame_of[0] : 0, id = x->drawing.camera_id;

    if (spin_camera_path_is_own(&x->drawing))
        return SPIN_OK;
    x->first = id < 0 ? spin_initial_view_view(job->views, row, true) : view_of(x, 0, id);
    if (!x->first && id < 0)
        x->first = &job->views->view[0];
    if (!x->first)
        return spin_not_found("the data set has no camera %d for the first frame", id);
    return SPIN_OK;
}

/* Returns the sound of the video. If the video and the clip differ in duration, warns and returns
 * NULL. */
static const struct spin_sound *sound_of(const struct spin_camera_path *d)
{
    const struct spin_export_job *job = d->job;
    double clip = job->n_frames / job->fps, video = (double)d->n_pictures / d->fps;

    if (!job->sound || fabs(clip - video) <= 0.5 / d->fps)
        return job->sound;
    spin_warn(
        "the video takes %.4g s but the clip %.4g s: the video is written without the sound '%s'",
        video, clip, job->sound->name);
    return NULL;
}

static spin_status open_video(struct export *x)
{
    const struct spin_export_job *job = x->drawing.job;
    struct spin_camera camera = x->drawing.lens;
    const char *codec = "";
    char frames[48];
    double fps = x->drawing.fps, quality = 18;
    int width;

    if (x->first) {
        camera = x->first->camera;
        spin_camera_path_resize(&x->drawing, &camera);
    }
    width = camera.width * x->drawing.n_panels;
    SPIN_TRY(spin_option_number(job->values, "quality", 0, 51, &quality));
    SPIN_TRY(spin_video_create(job->output, job->force, job->sync, width, camera.height, fps,
                               (int)quality, sound_of(&x->drawing), &x->video, &codec));
    spin_log(0, "video: %s of %dx%d, %.4g per second, %s",
             spin_text_count((long long)x->drawing.n_pictures, "frame", frames), width,
             camera.height, fps, codec);
    x->size[0] = camera.width;
    x->size[1] = camera.height;
    return SPIN_OK;
}

static void free_export(void *self)
{
    struct export *x = self;

    spin_video_abandon(x->video);
    spin_camera_path_free(&x->drawing);
    free(x);
}

static spin_status begin_export(struct export *x, const struct spin_export_job *job)
{
    SPIN_TRY(spin_camera_path_begin(&x->drawing, job));
    SPIN_TRY(choose_camera(x));
    return open_video(x);
}

static spin_status draw_one(struct export *x, int frame, int64_t picture,
                            const struct spin_frame_info *info, const struct spin_splats *splats)
{
    struct spin_camera_path *d = &x->drawing;
    const struct spin_view *view = x->first ? view_of(x, frame, x->first->camera_id) : NULL;
    struct spin_camera camera;

    if (!x->first) {
        SPIN_TRY(spin_camera_path_camera(d, picture, splats, &camera));
    } else if (!view) {
        return spin_not_found("frame %d: the data set has no view of camera %d; choose another "
                              "--camera, or --path orbit, which needs no data set",
                              info->number, x->first->camera_id);
    } else {
        camera = view->camera;
        spin_camera_path_resize(d, &camera);
    }
    if (camera.width != x->size[0] || camera.height != x->size[1])
        return spin_unsupported(
            "frame %d: camera %d has %dx%d pixels, but %dx%d in earlier frames; set one "
            "size with --size",
            info->number, view ? view->camera_id : -1, camera.width, camera.height, x->size[0],
            x->size[1]);
    SPIN_TRY(spin_camera_path_draw(d, frame, splats, &camera, view ? view->path : NULL));
    SPIN_TRY(spin_video_put(x->video, d->wide));
    if (d->job->report)
        d->job->report->images++;
    return SPIN_OK;
}

static spin_status video_frame(void *self, int frame, const struct spin_frame_info *info,
                               const struct spin_splats *splats)
{
    struct export *x = self;

    for (int64_t p = spin_camera_path_first(&x->drawing, frame);
         p < spin_camera_path_first(&x->drawing, frame + 1); p++) {
        if (spin_cancelled())
            return spin_fail_cancelled();
        SPIN_TRY(draw_one(x, frame, p, info, splats));
    }
    return SPIN_OK;
}

static spin_status finish_export(struct export *x)
{
    spin_status status = spin_video_commit(x->video);

    x->video = NULL;
    if (status == SPIN_OK)
        spin_camera_path_warn_blank(&x->drawing);
    return status;
}

SPIN_OWN_EXPORTER(
    video, "video", begin_export, finish_export, free_export,
    .summary = "MP4 or WebM, from a camera of the data set or around the scene (FFmpeg)",
    .options = options, .sound = "all", .antialias = true, .looks_at_views = true,
    .needs_renderer = true, .frame = video_frame);
