/* Views of camera rigs: lists the frames of each camera, pairs them by their numbers or times, and
 * adds the views. */
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

spin_status spin_rig_film(struct spin_rig_camera *c, const char *file, const char *instead)
{
    int width, height;
    int64_t n = 0;

    c->where = file;
    c->film = true;
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
    return SPIN_OK;
}

/* Lists the frames of all cameras that are videos. */
static spin_status list_films(struct spin_model *m, struct spin_rig_camera *c, size_t n,
                              struct spin_offsets *offsets)
{
    struct spin_rig_video *film;
    size_t n_films = 0;

    SPIN_TRY(spin_model_alloc(m, n, sizeof *film, (void **)&film));
    for (size_t i = 0; i < n; i++) {
        if (c[i].film)
            film[n_films++] = (struct spin_rig_video){.camera = c[i].name, .file = c[i].where};
    }
    if (n_films > 0)
        SPIN_TRY(spin_video_start());
    SPIN_TRY(spin_video_rows(m, film, n_films, offsets));
    n_films = 0;
    for (size_t i = 0; i < n; i++) {
        if (c[i].film)
            c[i].frames = film[n_films++].frames;
    }
    return SPIN_OK;
}

/* Adds the offsets of cameras with images to the frame numbers. Images without numbers are numbered
 * from 0. */
static spin_status shift_pictures(struct spin_rig_camera *c, size_t n, struct spin_offsets *offsets)
{
    for (size_t i = 0; i < n; i++) {
        struct spin_file_sequence *f = &c[i].frames;
        const struct spin_offset *offset = c[i].film ? NULL : spin_offsets_of(offsets, c[i].name);

        if (offset && offset->in_seconds)
            return spin_misuse("the offset of camera '%s' is in seconds, but the frame rate of its "
                               "images is unknown: give a number of frames",
                               c[i].name);
        for (size_t k = 0; k < f->n_frames && !c[i].film; k++) {
            if (f->frame[k].number < 0)
                f->frame[k].number = (int)k;
            f->frame[k].number += offset ? (int)offset->value : 0;
        }
    }
    return SPIN_OK;
}

/* ---- Views ----------------------------------------------------------------------------------- */

/* Refuses a camera that has as many frames as the first camera but starts at a different frame
 * number: equal frame numbers of the two cameras then probably mean different times. */
static spin_status check_first_numbers(const struct spin_rig_camera *c, size_t n)
{
    for (size_t i = 1; i < n; i++) {
        const struct spin_file_sequence *a = &c[0].frames, *b = &c[i].frames;

        if (a->n_frames == b->n_frames && a->frame[0].number != b->frame[0].number &&
            a->frame[a->n_frames - 1].number - a->frame[0].number ==
                b->frame[b->n_frames - 1].number - b->frame[0].number)
            return spin_malformed(
                "'%s' begins with frame %d and '%s' with frame %d: if they show the same time, "
                "give 'offsets' (see spin-importers(7)); otherwise remove the frames that only one "
                "of them has",
                c[0].where, a->frame[0].number, c[i].where, b->frame[0].number);
    }
    return SPIN_OK;
}

/* Sets *number to all frame numbers that occur in at least one camera, up to the last number of the
 * camera that ends first. */
static spin_status list_rows(struct spin_model *m, const struct spin_rig_camera *c, size_t n,
                             int **number, size_t *n_rows)
{
    size_t total = 0, fewest = 0, most = 0;
    int last[2] = {INT_MAX, 0};

    *n_rows = 0;
    for (size_t i = 0; i < n; i++) {
        int end = c[i].frames.n_frames ? c[i].frames.frame[c[i].frames.n_frames - 1].number : -1;

        if (end < 0)
            return spin_malformed("'%s' has no frames in the clip", c[i].where);
        fewest = end < last[0] ? i : fewest;
        most = end > last[1] ? i : most;
        last[0] = end < last[0] ? end : last[0];
        last[1] = end > last[1] ? end : last[1];
        total += c[i].frames.n_frames;
    }
    if (last[0] < last[1])
        spin_warn("'%s' ends with frame %d and '%s' with frame %d: the clip ends with frame %d",
                  c[fewest].where, last[0], c[most].where, last[1], last[0]);
    SPIN_TRY(spin_model_alloc(m, total, sizeof **number, (void **)number));
    for (size_t i = 0; i < n; i++) {
        for (size_t k = 0; k < c[i].frames.n_frames; k++) {
            int value = c[i].frames.frame[k].number;

            if (value >= 0 && value <= last[0])
                (*number)[(*n_rows)++] = value;
        }
    }
    *n_rows = spin_views_unique(*number, *n_rows);
    return SPIN_OK;
}

/* Warns if cameras lack images of some frames. Fails if at least half of all images are missing,
 * since equal frame numbers of different cameras then probably mean different frames. */
static spin_status check_missing(const struct spin_views *views, size_t first, size_t n,
                                 const int *number, size_t n_rows, const struct spin_rig_camera *c)
{
    size_t there = views->n - first, all = n * n_rows;
    char share[96];

    if (there == all)
        return SPIN_OK;
    if (2 * there <= all)
        return spin_malformed("the cameras have %zu of %zu images of frames %d to %d: the frame "
                              "numbers of '%s' and other cameras differ",
                              there, all, number[0], number[n_rows - 1], c[0].where);
    spin_warn("%s missing and left out: not every camera has every frame of %d to %d",
              spin_text_share(all - there, all, "image", "is", "are", share), number[0],
              number[n_rows - 1]);
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

/* Adds the view of frame `view->number`, if the camera has it. *at is the index in c->frames at
 * which the search begins, and is advanced; `view->number` increases from call to call. */
static spin_status add_view(struct spin_model *m, const struct spin_rig_camera *c, size_t *at,
                            struct spin_view *view, struct spin_views *out)
{
    const struct spin_file_frame *frame = c->frames.frame + *at;
    const char *mask;

    while (*at < c->frames.n_frames && frame->number < view->number) {
        frame++;
        (*at)++;
    }
    if (*at == c->frames.n_frames || frame->number != view->number)
        return SPIN_OK;
    view->camera = c->moving ? c->moving[*at] : c->camera;
    view->path = (char *)frame->path;
    SPIN_TRY(find_mask(m, c, frame->path, &mask));
    view->mask = (char *)mask;
    return spin_views_add(out, view);
}

/* Scales a static camera to the size of its first image, and a moving camera to the size of each
 * frame's image. */
static spin_status fit_camera(struct spin_rig_camera *c)
{
    for (size_t k = 0; k < (c->moving ? c->frames.n_frames : 1); k++)
        SPIN_TRY(
            spin_views_fit_image(c->moving ? &c->moving[k] : &c->camera, c->frames.frame[k].path));
    return SPIN_OK;
}

static spin_status add_views(struct spin_model *m, const struct spin_rig_camera *c, size_t n,
                             const int *number, size_t n_rows, struct spin_views *out)
{
    int hold = -1;
    size_t *at;

    SPIN_TRY(spin_option_count(m->values, "hold", 0, INT_MAX, &hold));
    SPIN_TRY(spin_model_alloc(m, n, sizeof *at, (void **)&at));
    for (size_t row = 0; row < n_rows; row++) {
        for (size_t i = 0; i < n; i++) {
            struct spin_view view = {
                .camera_id = (int)i, .dataset_frame = (int)row, .number = number[row]};

            view.test = hold < 0 ? n > 1 && i % 8 == 0 : hold > 0 && i % (size_t)hold == 0;
            SPIN_TRY(spin_views_time(m->values, "unit", row, n_rows, &view.time));
            SPIN_TRY(add_view(m, &c[i], &at[i], &view, out));
        }
    }
    return SPIN_OK;
}

spin_status spin_rig_views(struct spin_model *m, struct spin_rig_camera *c, size_t n,
                           struct spin_views *out)
{
    size_t n_rows, first = out->n;
    struct spin_offsets offsets;
    int *number;

    SPIN_TRY(spin_offsets_read(m, &offsets));
    SPIN_TRY(list_films(m, c, n, &offsets));
    SPIN_TRY(shift_pictures(c, n, &offsets));
    SPIN_TRY(spin_offsets_check(&offsets));
    if (offsets.n == 0)
        SPIN_TRY(check_first_numbers(c, n));
    SPIN_TRY(list_rows(m, c, n, &number, &n_rows));
    for (size_t i = 0; i < n; i++)
        SPIN_TRY(fit_camera(&c[i]));
    SPIN_TRY(add_views(m, c, n, number, n_rows, out));
    return check_missing(out, first, n, number, n_rows, c);
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
                  "times of the data set follow the rule '%s'; its frame rate is %.6g per second: "
                  "use spin-export --fps %.6g",
                  rule, rate, rate);
    else
        spin_note(out,
                  "times of the data set follow the rule '%s'; its frame rate is unknown: set it "
                  "with spin-export --fps",
                  rule);
}
