/* Renders every frame to PNG or EXR files, from the data set's cameras or a moving camera, for
 * inspection, compositing, or measurement with other programs. An image may consist of several
 * panels side by side. Files are named by spin_image_name() or by --pattern. */
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/mem.h"
#include "base/option.h"
#include "base/text.h"
#include "exporters/lib/camera_path.h"
#include "exporters/lib/transforms_file.h"
#include "io/numbered.h"
#include "io/output.h"
#include "io/image.h"

static const struct spin_plugin_option options[] = {
    {"views", "WHICH", "cameras to render: test, train or all", "test"},
    {"pattern", "PATTERN",
     "file names of one camera, such as shot.%04d.exr; default: by camera and frame", NULL},
    {"start", "N", "number in the name of the first image; the others follow",
     "the clip's numbers"},
    SPIN_DRAWING_OPTION_PATH,
    SPIN_DRAWING_OPTIONS,
    {"fps", "F",
     "frames per second for --duration and in EXR files; default: that of --path FILE or the "
     "bundle",
     NULL},
    {"format", "png|exr", "file format; default: by the pattern, else png", NULL},
    {"bits", "N",
     "bits per channel: 8 or 16 in PNG, 16 (half floats) or 32 in EXR; default: the lower", NULL},
    {"transfer", "linear|srgb",
     "values in EXR: linear light, as compositing programs expect, or srgb, as splats are blended",
     "linear"},
    {"clamp", NULL, "limit the colours of EXR files to those of a display, 0 to 1", NULL},
    {"depth", NULL, "write depth to EXR files: the mean as Z, the median as ZMedian", NULL},
    {"transforms", NULL,
     "also write the cameras for other trainers, to transforms_train.json and transforms_test.json",
     NULL},
    {0},
};

#define FAR 1e10f /* depth of pixels that no splat covers, as in film renderers */

enum which { TEST, TRAIN, ALL };

struct export
{
    struct spin_output_folder folder;
    const struct spin_export_job *job;
    char *output; /* the folder to write */
    /* names of the files; if its text is NULL, they are named by spin_image_name() */
    struct spin_pattern pattern;
    int start; /* number of the first image; -1: the clip's numbers */
    bool clamps;
    uint64_t n_bright; /* number of pixels brighter than white; not counted with --clamp */
    float brightest;   /* largest colour value of these pixels; 1 is white */
    enum which which;
    int n_unseen; /* number of frames without a view that --views selects */
    struct spin_film film;
    bool wants_depth;
    float *layers; /* [3][h][w]: alpha, expected depth, median depth */
    struct spin_camera_path drawing;
    bool wants_transforms;
    struct spin_transforms_file transforms;
};

static bool is_chosen(const struct export *x, const struct spin_view *view)
{
    if (x->drawing.camera_id >= 0)
        return view->camera_id == x->drawing.camera_id;
    return x->which == ALL || view->test == (x->which == TEST);
}

static bool any_chosen(const struct export *x)
{
    for (size_t i = 0; i < x->job->views->n; i++) {
        if (is_chosen(x, &x->job->views->view[i]))
            return true;
    }
    return false;
}

/* Reads layers of the last render into x->film: alpha if the background is transparent, and depth
 * if --depth is given. */
static spin_status take_layers(struct export *x, const struct spin_camera *camera)
{
    size_t n = (size_t)camera->width * (size_t)camera->height;

    if (!x->job->transparent && !x->wants_depth)
        return SPIN_OK;
    SPIN_TRY(spin_grow(3 * n, sizeof *x->layers, (void **)&x->layers));
    x->film.alpha = x->job->transparent ? x->layers : NULL;
    x->film.depth = x->wants_depth ? x->layers + n : NULL;
    SPIN_TRY(spin_render_layers(x->job->renderer, x->job->transparent ? x->layers : NULL,
                                x->wants_depth ? x->layers + n : NULL));
    for (size_t i = n; i < 3 * n && x->wants_depth; i++)
        x->layers[i] = x->layers[i] > 0 ? x->layers[i] : FAR;
    return SPIN_OK;
}

/* Finds colours above 1 in EXR images, which occur where several bright splats overlap. With
 * --clamp, limits them to 1; otherwise counts the pixels. The colours in `image` are premultiplied
 * by alpha, so their limit is alpha instead of 1. */
static void limit_colours(struct export *x)
{
    size_t n = (size_t)x->film.width * (size_t)x->film.height;
    float *image = x->drawing.wide;

    for (size_t i = 0; i < n && x->film.exr; i++) {
        float most = x->film.alpha ? x->film.alpha[i] : 1, largest = 0;

        for (size_t c = 0; c < 3; c++) {
            largest = fmaxf(largest, image[c * n + i]);
            if (x->clamps && image[c * n + i] > most)
                image[c * n + i] = most;
        }
        if (x->clamps || !(largest > 1.001f * most) || most < 1e-3f)
            continue;
        x->n_bright++;
        x->brightest = fmaxf(x->brightest, largest / most);
    }
}

/* Sets *path to the path of a file in the output folder. If there is a pattern, the file name is
 * made from the pattern and `number`; otherwise it is `name`, with the extension of the format. */
static spin_status path_of(const struct export *x, int number, char *name, char **path)
{
    if (x->pattern.text)
        return spin_pattern_path(&x->pattern, x->folder.path, number, path);
    if (x->film.exr)
        memcpy(strrchr(name, '.'), ".exr", 4);
    return spin_path_join(x->folder.path, name, path);
}

/* Renders an image and writes it to path_of(). number: number of the frame or, on a camera path, of
 * the image. */
static spin_status export_picture(struct export *x, char *name, int number, int frame,
                                  const struct spin_splats *splats,
                                  const struct spin_camera *camera, const struct spin_view *view)
{
    int last = x->job->n_frames > 1 ? x->job->n_frames - 1 : 1;
    SPIN_FREED char *path = NULL;

    SPIN_TRY(path_of(x, number, name, &path));
    SPIN_TRY(spin_camera_path_draw(&x->drawing, frame, splats, camera, view ? view->path : NULL));
    SPIN_TRY(take_layers(x, camera));
    x->film.width = x->drawing.n_panels * camera->width;
    x->film.height = camera->height;
    x->film.image = x->drawing.wide;
    limit_colours(x);
    SPIN_TRY(spin_film_write(path, &x->film, x->job->sync));
    spin_output_folder_add(&x->folder, spin_path_name(path), number);
    if (x->wants_transforms)
        spin_transforms_file_add(&x->transforms, spin_path_name(path), (double)frame / last, camera,
                                 view && view->test);
    if (x->job->report)
        x->job->report->images++;
    return SPIN_OK;
}

static void free_export(void *self)
{
    struct export *x = self;

    spin_output_folder_abandon(&x->folder);
    spin_camera_path_free(&x->drawing);
    spin_transforms_file_close(&x->transforms);
    free(x->layers);
    free(x->output);
    free(x);
}

/* Returns SPIN_E_USAGE if an option would have no effect. */
static spin_status check_options(const struct export *x)
{
    static const char *const moving[] = {"duration", "repeat"}, *const exr[] = {"transfer",
                                                                                "clamp"};
    const struct spin_plugin_values *v = x->job->values;
    bool times = spin_camera_path_moves(&x->drawing) && x->drawing.path != SPIN_PATH_FILE &&
                 !spin_plugin_value(v, "repeat", NULL);

    for (int i = 0; i < 2 && !spin_camera_path_moves(&x->drawing); i++)
        if (spin_plugin_value(v, moving[i], NULL))
            return spin_misuse("--%s needs a moving camera: see --path", moving[i]);
    for (int i = 0; i < 2 && !x->film.exr; i++)
        if (spin_plugin_value(v, exr[i], NULL))
            return spin_misuse("--%s needs --format exr", exr[i]);
    if (spin_plugin_value(v, "fps", NULL) && !times && !x->film.exr)
        return spin_misuse("--fps has no effect without --duration or --format exr");
    if (x->wants_transforms && (x->film.exr || x->drawing.n_panels > 1))
        return spin_misuse("--transforms needs PNG images of one panel");
    if (x->drawing.camera_id >= 0 && spin_plugin_value(v, "views", NULL))
        return spin_misuse("--camera and --views exclude each other: give one of the two");
    if (spin_camera_path_is_own(&x->drawing) && spin_plugin_value(v, "views", NULL))
        return spin_misuse("--views: %s",
                           x->job->views ? "the option selects cameras of the data set, but the "
                                           "images are rendered from another camera; omit --views"
                                         : "there is no data set; give --data DIR");
    return SPIN_OK;
}

/* Splits an output such as "film/shot.####.exr" into a folder and a pattern, and reads --pattern
 * and --start. */
static spin_status parse_names(struct export *x)
{
    const struct spin_plugin_values *v = x->job->values;
    const char *pattern;

    x->start = -1;
    SPIN_TRY(spin_option_count(v, "start", 0, 1000000000, &x->start));
    SPIN_TRY(spin_pattern_split(x->job->output, &x->output, &pattern));
    if (pattern && spin_plugin_value(v, "pattern", NULL))
        return spin_misuse("the output '%s' is already a pattern: omit --pattern", x->job->output);
    if (!pattern)
        SPIN_TRY(spin_strdup(x->job->output, &x->output));
    pattern = pattern ? pattern : spin_plugin_value(v, "pattern", NULL);
    return pattern ? spin_pattern_parse(pattern, &x->pattern) : SPIN_OK;
}

/* Sets the file format to the value of --format or, without this option, to the format of the
 * pattern's extension. */
static spin_status parse_format(struct export *x)
{
    const char *given = spin_plugin_value(x->job->values, "format", NULL);
    bool png, exr;
    int word = 0;

    SPIN_TRY(spin_option_word(x->job->values, "format", "png|exr", &word));
    x->film.exr = word == 1;
    if (!x->pattern.text)
        return SPIN_OK;
    png = spin_text_ends_any_case(x->pattern.text, ".png");
    exr = spin_text_ends_any_case(x->pattern.text, ".exr");
    if (!png && !exr)
        return spin_misuse("the pattern '%s' must end in .png or .exr", x->pattern.text);
    if (given && exr != x->film.exr)
        return spin_misuse("--format %s contradicts the extension of the pattern '%s'", given,
                           x->pattern.text);
    x->film.exr = exr;
    return SPIN_OK;
}

static spin_status parse_film(struct export *x)
{
    const struct spin_plugin_values *v = x->job->values;
    bool layers = x->job->transparent;
    int word, bits;

    SPIN_TRY(parse_format(x));
    bits = x->film.exr ? 16 : 8;
    SPIN_TRY(spin_option_count(v, "bits", 8, 32, &bits));
    if (bits != 16 && bits != (x->film.exr ? 32 : 8))
        return spin_misuse("--bits %d: expected %s", bits,
                           x->film.exr ? "16 or 32 in EXR" : "8 or 16 in PNG");
    x->film.bits = bits;
    SPIN_TRY(spin_option_word(v, "transfer", "linear|srgb", &word));
    x->film.linear = x->film.exr && word == 0;
    x->clamps = spin_plugin_value(v, "clamp", NULL) != NULL;
    /* A file of --camera holds the camera still: its images show the clip at the clip's rate. */
    x->film.fps = x->drawing.file.fps > 0 && !x->drawing.fixed ? x->drawing.file.fps : x->job->fps;
    SPIN_TRY(spin_option_number(v, "fps", 0.01, 1000, &x->film.fps));
    x->wants_depth = spin_plugin_value(v, "depth", NULL) != NULL;
    if (!x->film.exr && x->wants_depth)
        return spin_misuse("--depth needs --format exr");
    layers = layers || x->wants_depth;
    if (layers && (x->drawing.n_panels > 1 || x->drawing.panel[0] == SPIN_PANEL_TRUTH))
        return spin_misuse("%s needs a single panel, before or after",
                           x->wants_depth ? "--depth" : "--background none");
    return SPIN_OK;
}

/* Returns an error if no camera is chosen, or if images of several cameras would have the same name
 * because of a pattern. */
static spin_status check_cameras(const struct export *x)
{
    const struct spin_views *views = x->job->views;
    size_t n = 0, most = 0;
    int row = -1;

    if (spin_camera_path_is_own(&x->drawing))
        return SPIN_OK;
    if (!any_chosen(x))
        return x->drawing.camera_id >= 0
                   ? spin_not_found("the data set has no camera %d", x->drawing.camera_id)
                   : spin_not_found("the data set has no %s views: try --views all",
                                    x->which == TEST ? "test" : "train");
    for (size_t i = 0; i < views->n; i++) { /* views are sorted by frame */
        n = views->view[i].dataset_frame == row ? n : 0;
        row = views->view[i].dataset_frame;
        n += is_chosen(x, &views->view[i]);
        most = n > most ? n : most;
    }
    return x->pattern.text && most > 1
               ? spin_misuse("the pattern '%s' names one image of each frame, but %zu cameras are "
                             "rendered: choose one with --camera",
                             x->pattern.text, most)
               : SPIN_OK;
}

static spin_status begin_export(struct export *x, const struct spin_export_job *job)
{
    int which;

    x->job = job;
    SPIN_TRY(spin_camera_path_begin(&x->drawing, job));
    SPIN_TRY(parse_names(x));
    SPIN_TRY(parse_film(x));
    x->wants_transforms = spin_plugin_value(job->values, "transforms", NULL) != NULL;
    SPIN_TRY(check_options(x));
    SPIN_TRY(spin_option_word(job->values, "views", "test|train|all", &which));
    x->which = (enum which)which;
    SPIN_TRY(check_cameras(x));
    SPIN_TRY(
        spin_output_folder_begin(x->output, job->force, x->film.exr ? ".exr" : ".png", &x->folder));
    return SPIN_OK;
}

/* Renders the images of a frame from a camera on a path instead of the data set's cameras. File
 * names contain the number of the image on the path, not the number of the frame. */
static spin_status export_own(struct export *x, int frame, const struct spin_splats *splats)
{
    struct spin_camera_path *d = &x->drawing;

    for (int64_t p = spin_camera_path_first(d, frame); p < spin_camera_path_first(d, frame + 1);
         p++) {
        int number = (int)p + (x->start > 0 ? x->start : 0);
        struct spin_camera camera;
        char name[SPIN_IMAGE_NAME];

        if (spin_cancelled())
            return spin_fail_cancelled();
        SPIN_TRY(spin_camera_path_camera(d, p, splats, &camera));
        spin_image_name_moving(spin_camera_path_name(d), number, name);
        SPIN_TRY(export_picture(x, name, number, frame, splats, &camera, NULL));
    }
    return SPIN_OK;
}

static spin_status images_frame(void *self, int frame, const struct spin_frame_info *info,
                                const struct spin_splats *splats)
{
    struct export *x = self;
    const struct spin_views *views = x->job->views;
    int row = x->job->dataset_frame_of ? x->job->dataset_frame_of[frame] : frame;
    int number = x->start >= 0 ? x->start + frame : info->number;
    bool seen = false;
    char name[SPIN_IMAGE_NAME];

    if (spin_camera_path_is_own(&x->drawing))
        return export_own(x, frame, splats);
    for (size_t i = 0; i < views->n; i++) {
        const struct spin_view *view = &views->view[i];
        struct spin_camera camera = view->camera;

        if (row < 0 || view->dataset_frame != row || !is_chosen(x, view))
            continue;
        seen = true;
        if (spin_cancelled())
            return spin_fail_cancelled();
        spin_image_name(views, i, number, NULL, name);
        spin_camera_path_resize(&x->drawing, &camera);
        SPIN_TRY(export_picture(x, name, number, frame, splats, &camera, view));
    }
    x->n_unseen += !seen;
    return SPIN_OK;
}

static spin_status finish_export(struct export *x)
{
    if (x->n_unseen > 0)
        spin_warn("%s not rendered: the data set has no view of them that --views selects",
                  spin_text_share((size_t)x->n_unseen, (size_t)x->job->n_frames, "frame", "was",
                                  "were", (char[96]){0}));
    spin_camera_path_warn_blank(&x->drawing);
    if (x->n_bright > 0)
        spin_warn("%llu pixels are brighter than white: their values, before conversion to linear "
                  "light, are up to %.3g times that of white; --clamp limits them to white",
                  (unsigned long long)x->n_bright, (double)x->brightest);
    SPIN_TRY(spin_transforms_file_write(&x->transforms, &x->folder, x->job->sync));
    SPIN_TRY(spin_output_folder_list(&x->folder, "images", x->job->sync));
    spin_output_folder_remove_former(&x->folder);
    spin_output_folder_end(&x->folder);
    return SPIN_OK;
}

SPIN_OWN_EXPORTER(images, "images", begin_export, finish_export, free_export,
                  .summary = "PNG or EXR renders from the data set's cameras or a moving one",
                  .options = options, .antialias = true, .alpha = true, .looks_at_views = true,
                  .needs_renderer = true, .frame = images_frame);
