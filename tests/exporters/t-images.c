/* K: image export */
#include <unistd.h>

#include "base/err.h"
#include "base/log.h"
#include "io/image.h"
#include "tests/exporters/frame.h"

extern const struct spin_exporter spin_exporter_images;

static int n_renders, n_alphas, n_depths;
static bool renderer_fails, antialiased;
static size_t n_drawn; /* pixels of the last render */

/* Replaces the rasteriser: red is the camera's width, green the number of splats. */
spin_status spin_render(struct spin_renderer *r, const struct spin_splats *splats,
                        const struct spin_camera *camera, const float background[3], float *image)
{
    size_t plane = (size_t)camera->width * (size_t)camera->height;

    (void)r;
    if (renderer_fails)
        return spin_fail(SPIN_E_DEVICE, "no renderer today");
    n_renders++;
    n_drawn = plane;
    antialiased = splats->antialias;
    for (size_t i = 0; i < plane; i++) {
        image[i] = (float)camera->width / 255;
        image[plane + i] = (float)splats->n / 255;
        image[2 * plane + i] = background[2];
    }
    return SPIN_OK;
}

/* A quarter of the light passes; depths are 3 and 2. */
spin_status spin_render_layers(struct spin_renderer *r, float *alpha, float *depth)
{
    (void)r;
    n_alphas += alpha != NULL;
    n_depths += depth != NULL;
    for (size_t i = 0; i < n_drawn; i++) {
        if (alpha)
            alpha[i] = 0.75f;
        if (depth)
            depth[i] = 3;
        if (depth)
            depth[n_drawn + i] = 2;
    }
    return SPIN_OK;
}

static const float background[3] = {0, 0, 1};
static const int rows[] = {1, -1, 0};
static char folder[4096];

static struct spin_export_job make_job(const struct spin_views *views, const char *name,
                                       const struct spin_plugin_values *values)
{
    static char output[8][4200];
    static int next;
    char *path = output[next++ % 8];

    snprintf(path, sizeof output[0], "%s/%s", folder, name);
    return (struct spin_export_job){.output = path,
                                    .n_frames = 3,
                                    .views = views,
                                    .values = values,
                                    .dataset_frame_of = rows,
                                    .background = background};
}

/* Two rows, cameras 0 (held out, 4 x 2) and 3 (5 x 3), two pixels wider in the second row. */
static void make_views(struct spin_views *views, const char *image)
{
    for (int row = 0; row < 2; row++) {
        struct spin_view v = {.dataset_frame = row,
                              .path = (char *)image,
                              .test = true,
                              .camera = {.width = 4 + 2 * row, .height = 2}};

        if (spin_views_add(views, &v) != SPIN_OK)
            exit(1);
        v.camera = (struct spin_camera){.width = 5 + 2 * row, .height = 3};
        v.camera_id = 3;
        v.test = false;
        if (spin_views_add(views, &v) != SPIN_OK)
            exit(1);
    }
}

static struct spin_splats splats; /* 9 of them */

static spin_status export_clip(const struct spin_export_job *job)
{
    void *self = NULL;
    spin_status status = spin_exporter_images.begin(job, &self);

    if (status != SPIN_OK)
        return status;
    for (int i = 0; i < job->n_frames && status == SPIN_OK; i++) {
        struct spin_frame_info info = {.number = 40 + i, .n = 9};

        status = spin_exporter_images.frame(self, i, &info, &splats);
    }
    if (status == SPIN_OK)
        return spin_exporter_images.end(self);
    spin_exporter_images.abort(self);
    return status;
}

static int pixel_is(const char *output, const char *name, int width, int x, int r, int g, int b)
{
    char path[4400];
    int w = 0, h = 0, good = 0;
    uint8_t *rgb = NULL;

    snprintf(path, sizeof path, "%s/%s", output, name);
    if (spin_image_read(path, NULL, &w, &h, &rgb) == SPIN_OK)
        good = w == width && rgb[3 * x] == r && rgb[3 * x + 1] == g && rgb[3 * x + 2] == b;
    free(rgb);
    return good;
}

static void test_renders(const struct spin_views *views)
{
    static const char *const all[] = {"views", "all", NULL};
    static const char *const transforms[] = {"views", "all", "transforms", "1", NULL};
    char path[600];
    static const char *const compare[] = {"panels", "truth,after", "views", "train", NULL};
    struct spin_plugin_values values = {all};
    struct spin_export_job job = make_job(views, "test", NULL);

    ok(export_clip(&job) == SPIN_OK && n_renders == 2,
       "renders the held-out views of paired frames");
    ok(pixel_is(job.output, "cam_00_frame_00040.png", 6, 3, 6, 9, 255) &&
           pixel_is(job.output, "cam_00_frame_00042.png", 4, 0, 4, 9, 255),
       "under camera and frame number, from the cameras of their rows");
    ok(export_clip(&job) == SPIN_E_IO && strstr(spin_last_error(), "--force"),
       "refuses a used folder");
    job.force = true;
    ok(export_clip(&job) == SPIN_OK, "unless told to");
    n_renders = 0;
    job = make_job(views, "all", &values);
    ok(export_clip(&job) == SPIN_OK && n_renders == 4 &&
           pixel_is(job.output, "cam_03_frame_00040.png", 7, 4, 7, 9, 255),
       "renders all views");
    values.pairs = compare;
    job = make_job(views, "compare", &values);
    ok(export_clip(&job) == SPIN_OK &&
           pixel_is(job.output, "cam_03_frame_00042.png", 10, 0, 10, 20, 30) &&
           pixel_is(job.output, "cam_03_frame_00042.png", 10, 9, 5, 9, 255),
       "puts the data set's image to the left");
    values.pairs = transforms;
    job = make_job(views, "again", &values);
    for (int i = 0; i < 2; i++) {
        job.force = i == 1;
        for (int test = 0; test < 2; test++) {
            snprintf(path, sizeof path, "%s/transforms_%s.json", job.output,
                     test ? "test" : "train");
            ok((i == 0 || access(path, F_OK) == 0) && (test || export_clip(&job) == SPIN_OK) &&
                   access(path, F_OK) == 0,
               "has transforms, also when it is written again");
        }
    }
}

/* Alpha and depth are independent of each other, and fetched once per image. */
static void test_layers(const struct spin_views *views)
{
    static const char *const depth[] = {"format", "exr", "depth", "", NULL};
    struct spin_plugin_values values = {depth};
    struct spin_export_job job = make_job(views, "transparent", NULL);

    n_alphas = n_depths = 0;
    job.transparent = true;
    ok(export_clip(&job) == SPIN_OK && n_alphas == 2 && n_depths == 0, "alpha without depth");
    n_alphas = n_depths = 0;
    job = make_job(views, "depth", &values);
    ok(export_clip(&job) == SPIN_OK && n_alphas == 0 && n_depths == 2, "depth without alpha");
}

/* Cameras with the same number get an image each. */
static void test_twins(void)
{
    static const char *const all[] = {"views", "all", NULL};
    struct spin_plugin_values values = {all};
    struct spin_views views = {0};
    struct spin_export_job job = make_job(&views, "twins", &values);

    for (int k = 0; k < 3; k++) {
        struct spin_view v = {.camera_id = 123, .path = (char *)"none"};

        v.camera = (struct spin_camera){.width = 4 + k, .height = 2};
        if (spin_views_add(&views, &v) != SPIN_OK)
            exit(1);
    }
    ok(export_clip(&job) == SPIN_OK &&
           pixel_is(job.output, "cam_123_frame_00042.png", 4, 0, 4, 9, 255) &&
           pixel_is(job.output, "cam_123_2_frame_00042.png", 5, 0, 5, 9, 255) &&
           pixel_is(job.output, "cam_123_3_frame_00042.png", 6, 0, 6, 9, 255),
       "three cameras of one number: three pictures");
    spin_views_free(&views);
}

static void test_failures(const struct spin_views *views)
{
    static const char *const bad[] = {"views", "some", NULL};
    static const char *const train[] = {"views", "train", NULL};
    struct spin_plugin_values values = {bad};
    struct spin_export_job job = make_job(views, "never", &values);
    struct spin_views only_test = *views;

    ok(export_clip(&job) == SPIN_E_USAGE && strstr(spin_last_error(), "'some'"),
       "refuses other views");
    only_test.n = 1;
    values.pairs = train;
    job = make_job(&only_test, "never", &values);
    ok(export_clip(&job) == SPIN_E_NOT_FOUND && strstr(spin_last_error(), "no train views"),
       "says when there are no such views");
    renderer_fails = true;
    job = make_job(views, "never", NULL);
    ok(export_clip(&job) == SPIN_E_DEVICE && !spin_path_exists(job.output),
       "leaves nothing when rendering fails");
    renderer_fails = false;
}

TAP_MAIN
{
    static const uint8_t colour[] = {10, 20, 30};
    struct spin_views views = {0};
    char image[4200];

    if (spin_image_start() != SPIN_OK) {
        skip("images", spin_last_error());
        return;
    }
    spin_log_set_level(-2);
    snprintf(folder, sizeof folder, "%s", check_folder());
    snprintf(image, sizeof image, "%s/source.png", folder);
    if (!ok(spin_image_write(image, 1, 1, colour, false) == SPIN_OK, "makes an image"))
        return;
    make_views(&views, image);
    make_frame(&splats, 9, 0, 3);
    test_renders(&views);
    test_layers(&views);
    test_twins();
    test_failures(&views);
    spin_views_free(&views);
    spin_splats_free(&splats);
}
