/* Renders of every frame from the data set's cameras as PNG, OUT/<camera>/<frame>.png: for looking,
 * and for measuring with other programs. With --compare the data set's image stands to the left. */
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "base/err.h"
#include "base/log.h"
#include "base/mem.h"
#include "io/folder.h"

static const struct spin_plugin_option options[] = {
    {"views", "WHICH", "cameras to render: test, train or all", "test"},
    {"compare", NULL, "put the data set's image left of each render", NULL},
    {0},
};

enum which { TEST, TRAIN, ALL };

struct export
{
    struct spin_out_folder folder;
    const struct spin_export_job *job;
    enum which which;
    bool compare;
    int n_unseen; /* frames without any view */
    float *image; /* [3][h][w] of a render, then [3][h][2 w] of a pair */
    float *pair;
    size_t n_pixels; /* there is room for */
};

static spin_status parse_which(const char *text, enum which *out)
{
    static const char *const names[] = {[TEST] = "test", [TRAIN] = "train", [ALL] = "all"};

    for (size_t i = 0; i < sizeof names / sizeof names[0]; i++) {
        if (strcmp(text, names[i]) == 0) {
            *out = (enum which)i;
            return SPIN_OK;
        }
    }
    return spin_fail(SPIN_E_USAGE, "--views '%s': expected test, train or all", text);
}

static bool is_chosen(const struct export *x, const struct spin_view *view)
{
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

static spin_status reserve_pixels(struct export *x, size_t n)
{
    if (n <= x->n_pixels)
        return SPIN_OK;
    x->n_pixels = 0;
    SPIN_TRY(spin_grow(n, 3 * sizeof(float), (void **)&x->image));
    if (x->compare)
        SPIN_TRY(spin_grow(n, 6 * sizeof(float), (void **)&x->pair));
    x->n_pixels = n;
    return SPIN_OK;
}

/* Copy a [3][h][w] image into column `left` of a [3][h][2 w] one. */
static void place(const float *image, size_t width, size_t height, size_t left, float *pair)
{
    for (size_t row = 0; row < 3 * height; row++)
        memcpy(pair + row * 2 * width + left, image + row * width, width * sizeof *image);
}

static spin_status write_view(struct export *x, const struct spin_view *view,
                              const struct spin_splats *splats, const char *path)
{
    int width = view->camera.width, height = view->camera.height;
    size_t w = (size_t)width, h = (size_t)height;

    SPIN_TRY(reserve_pixels(x, w * h));
    if (x->compare) {
        SPIN_TRY(spin_image_load(view->path, width, height, x->job->background, x->image));
        place(x->image, w, h, 0, x->pair);
    }
    SPIN_TRY(spin_render(x->job->renderer, splats, &view->camera, x->job->background, x->image));
    if (!x->compare)
        return spin_image_save(path, width, height, x->image);
    place(x->image, w, h, w, x->pair);
    return spin_image_save(path, 2 * width, height, x->pair);
}

/* Render one view into its place, making the camera's folder first. */
static spin_status export_view(struct export *x, const struct spin_view *view, int number,
                               const struct spin_splats *splats)
{
    char name[32], *folder = NULL, *path = NULL;
    spin_status status;

    snprintf(name, sizeof name, "%d", view->camera_id);
    SPIN_TRY_OUT(spin_path_join(x->folder.path, name, &folder));
    SPIN_TRY_OUT(spin_folder_make(folder));
    snprintf(name, sizeof name, "%05d.png", number);
    SPIN_TRY_OUT(spin_path_join(folder, name, &path));
    status = write_view(x, view, splats, path);
out:
    if (status != SPIN_OK && folder)
        (void)rmdir(folder); /* only when nothing is in it */
    free(path);
    free(folder);
    return status;
}

static void finish(struct export *x)
{
    free(x->image);
    free(x->pair);
    free(x);
}

static spin_status images_begin(const struct spin_export_job *job, void **self)
{
    struct export *x = NULL;
    spin_status status;

    if (!job->views)
        return spin_fail(SPIN_E_USAGE,
                         "rendering images needs the cameras of a data set; give --data DIR");
    SPIN_TRY(spin_alloc(1, sizeof *x, (void **)&x));
    x->job = job;
    x->compare = spin_plugin_value(job->values, "compare", NULL) != NULL;
    SPIN_TRY_OUT(parse_which(spin_plugin_value(job->values, "views", "test"), &x->which));
    if (!any_chosen(x)) {
        status = spin_fail(SPIN_E_NOT_FOUND, "the data set has no %s views; try --views all",
                           x->which == TEST ? "test" : "train");
        goto out;
    }
    SPIN_TRY_OUT(spin_out_folder_begin(job->output, job->force, &x->folder));
    *self = x;
    return SPIN_OK;
out:
    finish(x);
    return status;
}

static spin_status images_frame(void *self, int frame, const struct spin_frame_info *info,
                                const struct spin_splats *splats)
{
    struct export *x = self;
    const struct spin_views *views = x->job->views;
    int row = x->job->row_of_frame ? x->job->row_of_frame[frame] : frame;
    bool seen = false;

    for (size_t i = 0; i < views->n; i++) {
        const struct spin_view *view = &views->view[i];

        if (row < 0 || view->row != row || !is_chosen(x, view))
            continue;
        seen = true;
        if (spin_cancelled())
            return spin_fail_cancelled();
        SPIN_TRY(export_view(x, view, info->number, splats));
    }
    x->n_unseen += !seen;
    return SPIN_OK;
}

static spin_status images_end(void *self)
{
    struct export *x = self;

    if (x->n_unseen > 0)
        spin_warn("%d of %d frames have no such view in the data set and were not rendered",
                  x->n_unseen, x->job->n_frames);
    spin_out_folder_end(&x->folder);
    finish(x);
    return SPIN_OK;
}

static void images_abort(void *self)
{
    struct export *x = self;

    spin_out_folder_abandon(&x->folder);
    finish(x);
}

extern const struct spin_exporter spin_exporter_images;
const struct spin_exporter spin_exporter_images = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "images",
    .summary = "PNG renders from the data set's cameras",
    .options = options,
    .wants = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES,
    .needs_renderer = true,
    .begin = images_begin,
    .frame = images_frame,
    .end = images_end,
    .abort = images_abort,
};
