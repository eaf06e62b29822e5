/* Views of camera rigs: lists the frames of each camera, checks that the frame numbers of all
 * cameras match, and adds the views. */
#include "importers/lib/views_rig.h"

#include "io/video.h"

static int by_name(const void *a, const void *b)
{
    return strcmp(((const struct spin_rig_camera *)a)->name,
                  ((const struct spin_rig_camera *)b)->name);
}

spin_status spin_rig_sort(const char *path, struct spin_rig_camera *c, size_t n)
{
    qsort(c, n, sizeof *c, by_name);
    for (size_t i = 1; i < n; i++) {
        if (strcmp(c[i].name, c[i - 1].name) == 0)
            return spin_malformed("'%s': there are two cameras called '%s'", path, c[i].name);
    }
    return SPIN_OK;
}

/* ---- Frames of a camera ---------------------------------------------------------------------- */

spin_status spin_rig_pictures(struct spin_model *m, struct spin_rig_camera *c, const char *folder)
{
    struct spin_sequence_info unused = {0};

    c->where = folder;
    if (!spin_path_is_folder(folder))
        return spin_not_found("there is no folder '%s' with images of camera '%s'", folder,
                              c->name);
    SPIN_TRY(spin_file_sequence_list(m, folder, "", &c->frames));
    if (c->frames.n_frames == 0)
        return spin_not_found("folder '%s' contains no images", folder);
    return spin_file_sequence_sort(m, &c->frames, false, &unused);
}

/* Lists the frames of a video as paths such as "00.mp4#7" for frame 7; readers of images decode the
 * frame when they open such a path. */
spin_status spin_rig_film(struct spin_model *m, struct spin_rig_camera *c, const char *file,
                          const char *instead)
{
    int width, height;
    const char *path;
    int64_t n = 0;

    c->where = file;
    if (!spin_path_exists(file))
        return spin_not_found("there is neither the video '%s' nor a folder '%s'", file, instead);
    SPIN_TRY_IN(spin_video_start(),
                "extract images from the videos (mkdir -p '%s'; ffmpeg -i '%s' -start_number 0 "
                "'%s/%%06d.png', and so on)",
                instead, file, instead);
    SPIN_TRY(spin_video_info(file, &width, &height, &n, NULL));
    if (width != c->camera.width || height != c->camera.height)
        return spin_malformed("video '%s' has %d x %d pixels, but its camera has %d x %d", file,
                              width, height, c->camera.width, c->camera.height);
    if (n < 1 || n > INT_MAX)
        return spin_malformed("video '%s' has %lld frames", file, (long long)n);
    SPIN_TRY(spin_file_sequence_reserve(m, &c->frames, (size_t)n));
    for (int64_t f = 0; f < n; f++) {
        SPIN_TRY(spin_model_text(m, &path, "%s#%lld", file, (long long)f));
        spin_file_sequence_add(&c->frames, path, path);
        c->frames.frame[f].number = (int)f;
    }
    return SPIN_OK;
}

/* ---- Views ----------------------------------------------------------------------------------- */

/* Sets *n_rows to the number of frames that all cameras have. Frames may be missing at the end
 * only: a camera with a gap is refused, since its later images would get wrong times. */
static spin_status count_rows(const struct spin_rig_camera *c, size_t n, size_t *n_rows)
{
    size_t fewest = 0, most = 0;

    for (size_t i = 1; i < n; i++) {
        fewest = c[i].frames.n_frames < c[fewest].frames.n_frames ? i : fewest;
        most = c[i].frames.n_frames > c[most].frames.n_frames ? i : most;
    }
    *n_rows = c[fewest].frames.n_frames;
    for (size_t i = 1; i < n; i++) {
        for (size_t k = 0; k < *n_rows; k++) {
            int number = c[i].frames.frame[k].number, expected = c[0].frames.frame[k].number;

            if (number != expected)
                return spin_malformed(
                    "'%s' has frame %d where '%s' has frame %d: an image is missing", c[i].where,
                    number, c[0].where, expected);
        }
    }
    if (*n_rows < c[most].frames.n_frames)
        spin_warn(
            "'%s' has %zu frames and '%s' has %zu: the first %zu frames of each camera are read",
            c[fewest].where, *n_rows, c[most].where, c[most].frames.n_frames, *n_rows);
    return SPIN_OK;
}

/* Sets *out to the mask of the image `picture`, or to NULL if there is none. The mask has the
 * image's name, with the extension .png or with that of the image. */
static spin_status find_mask(struct spin_model *m, const struct spin_rig_camera *c,
                             const char *picture, const char **out)
{
    const char *name = spin_path_name(picture), *dot = strrchr(name, '.');

    *out = NULL;
    if (!c->masks)
        return SPIN_OK;
    SPIN_TRY(spin_model_find(m, out, c->masks, "%.*s.png",
                             (int)(dot ? dot - name : (long)strlen(name)), name));
    return *out ? SPIN_OK : spin_model_find(m, out, c->masks, "%s", name);
}

static spin_status add_view(struct spin_model *m, const struct spin_rig_camera *c, size_t row,
                            struct spin_view *view, struct spin_views *out)
{
    const struct spin_file_frame *frame = &c->frames.frame[row];
    const char *mask;

    view->camera = c->moving ? c->moving[row] : c->camera;
    view->dataset_frame = (int)row;
    view->number = frame->number;
    view->path = (char *)frame->path;
    SPIN_TRY(find_mask(m, c, frame->path, &mask));
    view->mask = (char *)mask;
    return spin_views_add(out, view);
}

spin_status spin_rig_views(struct spin_model *m, struct spin_rig_camera *c, size_t n,
                           struct spin_views *out)
{
    size_t n_rows;
    int hold = -1;

    SPIN_TRY(spin_option_count(m->values, "hold", 0, INT_MAX, &hold));
    SPIN_TRY(count_rows(c, n, &n_rows));
    for (size_t i = 0; i < n; i++) {
        for (size_t k = 0; k < (c[i].moving ? n_rows : 1); k++)
            SPIN_TRY(spin_views_fit_image(c[i].moving ? &c[i].moving[k] : &c[i].camera,
                                          c[i].frames.frame[k].path));
    }
    for (size_t row = 0; row < n_rows; row++) {
        for (size_t i = 0; i < n; i++) {
            struct spin_view view = {.camera_id = (int)i};

            view.test = hold < 0 ? n > 1 && i % 8 == 0 : hold > 0 && i % (size_t)hold == 0;
            SPIN_TRY(spin_views_time(m->values, "unit", row, n_rows, &view.time));
            SPIN_TRY(add_view(m, &c[i], row, &view, out));
        }
    }
    return SPIN_OK;
}

/* ---- Frame rate ------------------------------------------------------------------------------ */

static double rate_of(const spin_json *fps)
{
    const char *text = spin_json_string(fps);
    double value = 0, over = 1;

    if (text && sscanf(text, "%lf/%lf", &value, &over) >= 1)
        value /= over;
    else
        spin_json_number(fps, &value);
    return isfinite(value) && value > 0 ? value : 0;
}

void spin_rig_note(struct spin_model *m, const spin_json *fps, struct spin_views *out)
{
    const char *rule = spin_plugin_value(m->values, "time", "unit");
    double rate = rate_of(fps);

    if (rate > 0)
        spin_note(out,
                  "times of the data set follow the rule '%s'; its frame rate is %.6g per second "
                  "(spin-export --fps %.6g)",
                  rule, rate, rate);
    else
        spin_note(out,
                  "times of the data set follow the rule '%s'; its frame rate is unknown (give it "
                  "to spin-export --fps)",
                  rule);
}
