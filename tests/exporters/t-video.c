/* Reads back what the video exporter wrote: size, count and pixels; and the poses of moving
 * cameras.
 * K: video images export */
#include "base/err.h"
#include "base/log.h"
#include "exporters/lib/camera_path.h"
#include "geometry/camera_rig.h"
#include "io/image.h"
#include "io/video.h"
#include "tests/exporters/frame.h"

extern const struct spin_exporter spin_exporter_video, spin_exporter_images;

enum { W = 48, H = 32, FRAMES = 5 };

static int n_renders;
static struct spin_camera seen[64];
static char folder[4096];

spin_status spin_render_layers(struct spin_renderer *r, float *alpha, float *depth)
{
    (void)r;
    (void)alpha;
    (void)depth;
    return spin_fail(SPIN_E_DEVICE, "no picture asks for layers");
}

/* Replaces the rasteriser: a smooth image that encodes the splats and the number of the render. */
static void paint(size_t n, int k, int width, int height, float *image)
{
    for (int y = 0; y < height; y++) {
        for (int x = 0; x < width; x++) {
            float *at = image + y * width + x;

            at[0] = (float)x / (float)width;
            at[width * height] = (float)(n == 9 ? 0.2 : 0.8);
            at[2 * width * height] = 0.1f + 0.1f * (float)(k % 8);
        }
    }
}

spin_status spin_render(struct spin_renderer *r, const struct spin_splats *splats,
                        const struct spin_camera *camera, const float background[3], float *image)
{
    (void)r;
    (void)background;
    seen[n_renders % 64] = *camera;
    paint(splats->n, n_renders++, camera->width, camera->height, image);
    return SPIN_OK;
}

static spin_status source_frame(void *of, int frame, struct spin_splats *out)
{
    (void)of;
    (void)frame;
    make_frame(out, 4, 0, 7);
    return SPIN_OK;
}

static const char *named(const char *name)
{
    static char path[8][4400];
    static int next;
    char *p = path[next++ % 8];

    snprintf(p, sizeof path[0], "%s/%s", folder, name);
    return p;
}

/* A held-out camera 4 at z = -5 that looks along z, and a camera 2. */
static void make_views(struct spin_views *views, const char *image)
{
    for (int row = 0; row < FRAMES; row++) {
        struct spin_view v = {
            .dataset_frame = row,
            .camera_id = 2,
            .path = (char *)image,
            .camera = {W, H, 40, 40, W / 2.0, H / 2.0, {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 6}, 0}};

        if (spin_views_add(views, &v) != SPIN_OK)
            exit(1);
        v.camera_id = 4;
        v.test = true;
        v.camera.w2c[11] = 5;
        if (spin_views_add(views, &v) != SPIN_OK)
            exit(1);
    }
}

static spin_status export_clip(const struct spin_exporter *exporter,
                               const struct spin_export_job *job)
{
    struct spin_splats s = {0};
    void *self = NULL;
    spin_status status = exporter->begin(job, &self);

    n_renders = 0;
    if (status != SPIN_OK)
        return status;
    make_frame(&s, 9, 0, 3);
    for (int i = 0; i < 27; i++)
        s.means[i] = i % 3 == 0 ? (float)(i / 3 - 4) / 4 : 0;
    for (int i = 0; i < job->n_frames && status == SPIN_OK; i++) {
        struct spin_frame_info info = {.number = 10 + i, .n = 9};

        status = exporter->frame(self, i, &info, &s);
    }
    spin_splats_free(&s);
    if (status == SPIN_OK)
        return exporter->end(self);
    exporter->abort(self);
    return status;
}

/* dB between a frame of the file and what render k painted, in panel p of n. */
static double quality(const char *file, int frame, int k, size_t n_splats, int p, int n)
{
    int w = 0, h = 0;
    uint8_t *rgb = NULL;
    float *want = malloc(sizeof(float) * 3 * W * H);
    double sum = 0;

    if (spin_video_read(file, frame, NULL, &w, &h, &rgb) != SPIN_OK || w != W * n || h != H)
        return 0;
    paint(n_splats, k, W, H, want);
    for (int c = 0; c < 3; c++)
        for (int y = 0; y < H; y++)
            for (int x = 0; x < W; x++) {
                double d =
                    rgb[3 * (y * w + p * W + x) + c] / 255.0 - (double)want[(c * H + y) * W + x];

                sum += d * d;
            }
    free(want);
    free(rgb);
    return 10 * log10(3.0 * W * H / (sum + 1e-12));
}

static void check_file(const struct spin_export_job *job, const char *what)
{
    int w = 0, h = 0;
    int64_t n = 0;
    double least = 99;

    if (!ok(export_clip(&spin_exporter_video, job) == SPIN_OK, "%s: writes: %s", what,
            spin_last_error()))
        return;
    ok(spin_video_info(job->output, &w, &h, &n, NULL) == SPIN_OK && w == W && h == H && n == FRAMES,
       "%s: %lld frames of %dx%d", what, (long long)n, w, h);
    for (int f = 0; f < FRAMES; f++)
        least = fmin(least, quality(job->output, f, f, 9, 0, 1));
    ok(least > 28, "%s: every frame is as it was painted (at least %.1f dB)", what, least);
}

static void test_files(struct spin_export_job job)
{
    static const char *const panels[] = {"panels", "before,after", "repeat", "2", NULL};
    struct spin_plugin_values values = {panels};
    int w = 0, h = 0;
    int64_t n = 0;

    job.output = named("clip.mp4");
    check_file(&job, "mp4");
    ok(export_clip(&spin_exporter_video, &job) == SPIN_E_IO && strstr(spin_last_error(), "--force"),
       "does not overwrite, and names --force");
    job.output = named("clip.webm");
    check_file(&job, "webm");
    ok(seen[0].w2c[11] == 5, "from the held-out camera");
    job.output = named("pair.mp4");
    job.values = &values;
    ok(export_clip(&spin_exporter_video, &job) == SPIN_OK, "two panels, each frame twice");
    ok(spin_video_info(job.output, &w, &h, &n, NULL) == SPIN_OK && w == 2 * W && n == 2 * FRAMES,
       "a wide video, twice as long");
    ok(quality(job.output, 3, 6, 4, 0, 2) > 24 && quality(job.output, 3, 7, 9, 1, 2) > 24,
       "before to the left of after");
}

/* The size of a file, and the duration in seconds of an MP4's track from its box mdhd (ISO
 * 14496-12). */
static size_t measure(const char *path, double *seconds)
{
    struct spin_map map;
    const unsigned char *at;
    size_t n;
    uint32_t word[2] = {0};

    if (spin_map_open(path, &map) != SPIN_OK)
        return 0;
    n = map.size;
    at = memmem(map.data, map.size, "mdhd", 4);
    for (int k = 0; at && k < 8; k++) /* version 0: flags, two dates, ticks a second, ticks */
        word[k / 4] = word[k / 4] << 8 | at[16 + k];
    *seconds = word[0] ? (double)word[1] / word[0] : -1;
    spin_map_close(&map);
    return n;
}

static void test_speed_and_quality(struct spin_export_job job)
{
    static const char *const options[][5] = {
        {NULL}, {"fps", "10", NULL}, {"quality", "2", NULL}, {"quality", "45", NULL}};
    static const double lasts[] = {2, FRAMES / 10.0, 2, 2}; /* seconds; two at least, unless told */
    struct spin_plugin_values values;
    size_t bytes[4] = {0};
    double db[4] = {0};

    for (int i = 0; i < 4; i++) {
        char name[32];
        double seconds = 0;

        snprintf(name, sizeof name, "how%d.mp4", i);
        job.output = named(name);
        values.pairs = options[i];
        job.values = &values;
        ok(export_clip(&spin_exporter_video, &job) == SPIN_OK, "writes with %s %s",
           options[i][0] ? options[i][0] : "neither", options[i][0] ? options[i][1] : "");
        bytes[i] = measure(job.output, &seconds);
        near(seconds, lasts[i], 0.02,
             "it lasts as long as its frames at that speed, or two seconds");
        for (int f = 0; f < FRAMES; f++)
            db[i] += quality(job.output, f, f, 9, 0, 1) / FRAMES;
    }
    ok(bytes[2] > bytes[0] && bytes[0] > bytes[3], "better is larger: %zu, %zu, %zu bytes",
       bytes[2], bytes[0], bytes[3]);
    ok(db[2] > db[0] + 1 && db[0] > db[3] + 1, "and nearer: %.1f, %.1f, %.1f dB", db[2], db[0],
       db[3]);
}

/* The distance from the eye to (0, 0, 0), and whether it faces that point. */
static double eye_distance(const struct spin_camera *camera, bool *at_middle)
{
    double eye[3];

    spin_camera_centre(camera, eye);
    *at_middle = fabs(camera->w2c[3]) < 1e-6 && fabs(camera->w2c[7]) < 1e-6 && camera->w2c[11] > 0;
    return sqrt(eye[0] * eye[0] + eye[1] * eye[1] + eye[2] * eye[2]);
}

static void test_orbit(struct spin_export_job job)
{
    static const char *const orbit[] = {"path", "orbit", "repeat", "4", "size", "48x32", NULL};
    static const char *const spiral[] = {"path", "spiral", "repeat", "4", "size", "48x32", NULL};
    struct spin_plugin_values values = {orbit};
    bool all = true, still = true, at_middle;
    double det = 0;

    job.values = &values;
    job.output = named("orbit");
    ok(export_clip(&spin_exporter_images, &job) == SPIN_OK && n_renders == 4 * FRAMES,
       "pictures all around the scene");
    ok(spin_path_exists(named("orbit/orbit_frame_00019.png")) &&
           !spin_path_exists(named("orbit/orbit_frame_00020.png")),
       "numbered from 0");
    for (int i = 0; i < n_renders; i++) {
        const double *m = seen[i].w2c;

        all = all && fabs(eye_distance(&seen[i], &at_middle) - 5) < 1e-6 && at_middle;
        det = m[0] * (m[5] * m[10] - m[6] * m[9]) - m[1] * (m[4] * m[10] - m[6] * m[8]) +
              m[2] * (m[4] * m[9] - m[5] * m[8]);
        all = all && fabs(det - 1) < 1e-9 && fabs(m[5] - 1) < 1e-9;
    }
    ok(all, "at one distance, upright, towards the middle");
    near(seen[0].w2c[10], 1, 1e-9, "beginning with the data set's camera");
    near(seen[10].w2c[10], -1, 1e-9, "and from behind half-way");
    values.pairs = spiral;
    job.output = named("spiral");
    ok(export_clip(&spin_exporter_images, &job) == SPIN_OK, "and in a spiral");
    for (int i = 0; i < n_renders; i++) {
        double away = eye_distance(&seen[i], &at_middle);

        still = still && at_middle && away > 4 && away < 6;
    }
    ok(still, "near the first view, towards the middle");
}

/* Four cameras that look at (1, 2, 3) from the sides of a square, 2 away, but the first, which is
 * held out: 5. */
static double worst_of(const double a[12], const double b[12])
{
    double worst = 0;

    for (int k = 0; k < 12; k++)
        worst = larger(worst, fabs(a[k] - b[k]));
    return worst;
}

static void test_rig(struct spin_export_job job)
{
    static const char *const train[] = {"path", "train", "repeat", "4", "size", "48x32", NULL};
    double beyond = 0, off = 0, step[2] = {INFINITY, 0};
    void *self = NULL;
    static const char *const orbit[] = {"path", "orbit", "repeat", "4", "size", "48x32", NULL};
    static const double axis[4][2] = {{0, 1}, {1, 0}, {0, -1}, {-1, 0}}; /* x, z of what is ahead */
    struct spin_plugin_values values = {orbit};
    struct spin_views views = {0};
    double pivot[3] = {0}, median = 0, worst = 0, near_by = 0;

    for (int k = 0; k < 4; k++) {
        double x = axis[k][0], z = axis[k][1], away = k ? 2 : 5;
        struct spin_view v = {.camera_id = k, .test = k == 0, .path = (char *)"none"};
        double m[12] = {z, 0, -x, -z + 3 * x, 0, 1, 0, -2, x, 0, z, -x - 3 * z + away};

        v.camera = (struct spin_camera){W, H, 40, 40, W / 2.0, H / 2.0, {0}, 0};
        memcpy(v.camera.w2c, m, sizeof m);
        if (spin_views_add(&views, &v) != SPIN_OK)
            exit(1);
    }
    ok(spin_camera_pivot(&views, 0, pivot, &median) && fabs(pivot[0] - 1) < 1e-9 &&
           fabs(pivot[1] - 2) < 1e-9 && fabs(pivot[2] - 3) < 1e-9 && median == 2,
       "the place that all cameras look at, and how far away half of them are");
    views.n = 1;
    ok(!spin_camera_pivot(&views, 0, pivot, &median), "one camera has none");
    views.n = 4;
    job.views = &views;
    job.values = &values;
    job.n_frames = 1;
    job.output = named("rig");
    ok(export_clip(&spin_exporter_images, &job) == SPIN_OK && n_renders == 4, "once around");
    for (int i = 0; i < 4; i++) {
        const double *m = seen[i].w2c;
        double eye[3], away = 0;

        spin_camera_centre(&seen[i], eye);
        for (int c = 0; c < 3; c++)
            away += (eye[c] - (1 + c)) * (eye[c] - (1 + c));
        worst = larger(worst, fabs(sqrt(away) - 2));
        near_by = larger(near_by, fabs(m[0] * 1 + m[1] * 2 + m[2] * 3 + m[3]));
    }
    ok(worst < 1e-9 && near_by < 1e-9, "about that place, and not from beyond the other cameras");
    job.n_frames = FRAMES;
    values.pairs = train;
    job.output = named("train");
    ok(export_clip(&spin_exporter_images, &job) == SPIN_OK && n_renders == 4 * FRAMES &&
           spin_path_exists(named("train/train_frame_00019.png")),
       "through the training cameras");
    for (int i = 0; i < n_renders; i++) {
        const double *m = seen[i].w2c;
        double eye[3];

        spin_camera_centre(&seen[i], eye);
        beyond = larger(beyond, hypot(eye[0] - 1, eye[2] - 3));
        off = larger(off, fabs(m[0] + 2 * m[1] + 3 * m[2] + m[3]));
        if (i > 0) {
            double was[3];

            spin_camera_centre(&seen[i - 1], was);
            step[0] = fmin(step[0], hypot(eye[0] - was[0], eye[2] - was[2]));
            step[1] = larger(step[1], hypot(eye[0] - was[0], eye[2] - was[2]));
        }
    }
    ok(worst_of(seen[0].w2c, views.view[1].camera.w2c) < 1e-9, "from the first of them");
    ok(worst_of(seen[n_renders - 1].w2c, views.view[3].camera.w2c) < 1e-9, "to the last");
    ok(beyond < 2.2 && off < 0.2, "within the rig, towards its middle: %g, %g", beyond, off);
    ok(step[1] < 1.8 * step[0], "at about even speed: %g to %g", step[0], step[1]);
    views.n = 2;
    ok(spin_exporter_images.begin(
           &(struct spin_export_job){
               .output = named("never"), .n_frames = 1, .views = &views, .values = &values},
           &self) == SPIN_E_NOT_FOUND &&
           strstr(spin_last_error(), "found 1"),
       "one training camera is no path");
    views.n = 4;
    spin_views_free(&views);
}

/* Ten cameras on a ring in a random order, each of them twice. */
static void test_rig_order(void)
{
    struct spin_views views = {0};
    struct spin_rig_path path;
    double w2c[12];

    for (int k = 0; k < 20; k++) {
        double a = 0.6 * (k % 10 * 7 % 10);
        struct spin_view v = {.camera_id = k, .path = (char *)"none"};
        double m[12] = {cos(a), 0, -sin(a), 0, 0, 1, 0, 0, sin(a), 0, cos(a), 4};

        memcpy(v.camera.w2c, m, sizeof m);
        if (spin_views_add(&views, &v) != SPIN_OK)
            exit(1);
    }
    ok(spin_rig_path_open(&views, 0, &path) == SPIN_OK && path.n == 10, "each place once");
    near(path.stop[9].at, 9 * 8 * sin(0.3), 1e-9, "along the ring, not across");
    spin_rig_path_camera(&path, 0.5, w2c);
    near(w2c[0] * w2c[5] * w2c[10] + w2c[4] * w2c[9] * w2c[2] + w2c[8] * w2c[1] * w2c[6] -
             w2c[8] * w2c[5] * w2c[2] - w2c[4] * w2c[1] * w2c[10] - w2c[0] * w2c[9] * w2c[6],
         1, 1e-9, "a rotation between two of them");
    near(w2c[11], 4, 0.02, "as far from the middle");
    spin_rig_path_free(&path);
    spin_views_free(&views);
}

/* Without a data set: from the front, like the first view of a page. */
static void test_front(struct spin_export_job job)
{
    static const char *const orbit[] = {"path", "orbit", "repeat", "1", NULL};
    static const char *const bad[][2] = {{"path", "train"}, {"panels", "truth"}, {"views", "all"}};
    struct spin_plugin_values values = {NULL};
    struct spin_initial_view front;
    static const double middle[3] = {0};
    double eye[3];
    void *self = NULL;

    job.views = NULL;
    job.values = &values;
    job.output = named("front");
    spin_initial_view_first(NULL, NULL, 0, false, middle, 1, &front); /* as export_clip has them */
    ok(export_clip(&spin_exporter_images, &job) == SPIN_OK && n_renders == FRAMES &&
           spin_path_exists(named("front/front_frame_00004.png")),
       "pictures without a data set");
    spin_camera_centre(&seen[0], eye);
    ok(fabs(eye[0] - front.eye[0]) + fabs(eye[1] - front.eye[1]) + fabs(eye[2] - front.eye[2]) <
           1e-5,
       "from where a page begins");
    near(2 * atan(0.5 * seen[0].height / seen[0].fy) * 57.29577951308232, front.fovy_deg, 1e-6,
         "as high a view");
    ok(seen[0].width == 1280 && seen[0].height == 720, "1280 by 720");
    values.pairs = orbit;
    job.output = named("front-orbit");
    ok(export_clip(&spin_exporter_images, &job) == SPIN_OK && n_renders == FRAMES,
       "around it, too");
    for (int i = 0; i < 3; i++) {
        const char *pairs[] = {bad[i][0], bad[i][1], NULL};

        values.pairs = pairs;
        job.output = named("never");
        ok(spin_exporter_images.begin(&job, &self) == SPIN_E_USAGE &&
               strstr(spin_last_error(), "--data DIR"),
           "--%s %s asks for --data", bad[i][0], bad[i][1]);
    }
}

/* --size keeps the vertical field of view; --duration repeats or skips frames. */
static void test_size_and_duration(struct spin_export_job job)
{
    static const char *const pairs[] = {"path", "orbit", "size", "64x16", "duration",
                                        "0.56", "fps",   "25",   NULL};
    static const char *const few[] = {"path", "orbit", "duration", "0.12", "size", "48x32", NULL};
    static const char *const still[] = {"size", "96x64", NULL};
    struct spin_plugin_values values = {pairs};

    job.values = &values;
    job.output = named("sized");
    ok(export_clip(&spin_exporter_images, &job) == SPIN_OK && n_renders == 14 &&
           spin_path_exists(named("sized/orbit_frame_00013.png")),
       "0.56 seconds at 25 a second are 14 pictures of 5 frames");
    ok(seen[0].width == 64 && seen[0].height == 16 && seen[0].fx == 20 && seen[0].fy == 20 &&
           seen[0].cx == 32 && seen[0].cy == 8,
       "of the size asked for, with square pixels, the same height of view");
    near(fabs(atan2(seen[7].w2c[8], seen[7].w2c[10])) * 57.29577951308232, 180, 1e-6,
         "half-way round with half of the pictures");
    values.pairs = few;
    job.output = named("few");
    ok(export_clip(&spin_exporter_images, &job) == SPIN_OK && n_renders == 3 &&
           spin_path_exists(named("few/orbit_frame_00002.png")),
       "three pictures of five frames");
    values.pairs = still;
    job.output = named("still");
    ok(export_clip(&spin_exporter_images, &job) == SPIN_OK && seen[0].width == 96 &&
           seen[0].fx == 80 && seen[0].cx == 48,
       "the data set's cameras too");
}

/* Whether a "t" is the third letter in a panel ("after"), white in a black box. */
static bool has_label(const char *name, int panel, int width)
{
    static const char *const rows[7] = {".#...", ".#...", "###..", ".#...",
                                        ".#...", ".#..#", "..##."};
    int w = 0, h = 0;
    bool good = true;
    uint8_t *rgb = NULL;

    if (spin_image_read(named(name), NULL, &w, &h, &rgb) != SPIN_OK || w % width != 0)
        return false;
    for (int y = -2; y < 9; y++)
        for (int x = 0; x < 5; x++) {
            bool ink = y >= 0 && y < 7 && rows[y][x] == '#';
            const uint8_t *at = rgb + 3 * ((y + 2) * w + panel * width + 12 + x + 2);

            good = good && at[0] == 255 * ink && at[1] == 255 * ink && at[2] == 255 * ink;
        }
    free(rgb);
    return good;
}

static void test_labels(struct spin_export_job job)
{
    static const char *const sized[] = {"size", "80x60", "panels", "before,after", NULL};
    static const char *const plain[] = {"size",      "80x60", "panels", "before,after",
                                        "no-labels", "1",     NULL};
    static const char *const alone[] = {"size", "80x60", NULL};
    struct spin_plugin_values values = {sized};

    job.values = &values;
    job.output = named("labels");
    ok(export_clip(&spin_exporter_images, &job) == SPIN_OK &&
           has_label("labels/cam_04_frame_00010.png", 1, 80),
       "the names of panels that stand side by side");
    values.pairs = plain;
    job.output = named("unlabelled");
    ok(export_clip(&spin_exporter_images, &job) == SPIN_OK &&
           !has_label("unlabelled/cam_04_frame_00010.png", 1, 80),
       "are left out by --no-labels");
    values.pairs = alone;
    job.output = named("alone");
    ok(export_clip(&spin_exporter_images, &job) == SPIN_OK &&
           !has_label("alone/cam_04_frame_00010.png", 0, 80),
       "and a picture by itself has none");
}

static void test_drawing_refusals(struct spin_export_job job)
{
    static const char *const bad[][5] = {{"size", "64", NULL},
                                         {"size", "64x8", NULL},
                                         {"size", "64x64x3", NULL},
                                         {"size", "20000x64", NULL},
                                         {"duration", "0", NULL},
                                         {"duration", "2", NULL},
                                         {"size", "64x64", "panels", "after,truth", NULL}};
    static const char *const both[] = {"path", "orbit", "duration", "2", "repeat", "2", NULL};
    struct spin_plugin_values values;
    void *self = NULL;

    job.values = &values;
    job.output = named("never");
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        values.pairs = bad[i];
        ok(spin_exporter_images.begin(&job, &self) == SPIN_E_USAGE && !self &&
               strstr(spin_last_error(), bad[i][0]),
           "refuses --%s %s%s", bad[i][0], bad[i][1], bad[i][2] ? " with truth" : "");
    }
    values.pairs = both;
    ok(spin_exporter_images.begin(&job, &self) == SPIN_E_USAGE &&
           strstr(spin_last_error(), "--repeat"),
       "refuses --duration with --repeat");
    ok(!spin_path_exists(job.output), "and makes no folder");
}

static void test_refusals(struct spin_export_job job)
{
    static const char *const bad[][2] = {{"path", "round"}, {"panels", "now"}, {"panels", ""},
                                         {"repeat", "0"},   {"fps", "0"},      {"quality", "52"},
                                         {"camera", "x"}};
    static const char *const truth[] = {"path", "orbit", "panels", "truth", NULL};
    static const char *const other[] = {"camera", "7", NULL};
    struct spin_plugin_values values = {truth};
    void *self = NULL;

    job.output = named("never.mp4");
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        const char *pairs[] = {bad[i][0], bad[i][1], NULL};

        values.pairs = pairs;
        job.values = &values;
        ok(spin_exporter_video.begin(&job, &self) == SPIN_E_USAGE && !self &&
               strstr(spin_last_error(), bad[i][0]),
           "refuses --%s '%s'", bad[i][0], bad[i][1]);
    }
    values.pairs = truth;
    ok(spin_exporter_video.begin(&job, &self) == SPIN_E_USAGE, "a moving camera has no truth");
    values.pairs = other;
    ok(spin_exporter_video.begin(&job, &self) == SPIN_E_NOT_FOUND, "there is no camera 7");
    job.values = NULL;
    job.output = named("never.avi");
    ok(spin_exporter_video.begin(&job, &self) == SPIN_E_USAGE, "refuses other names");
    job.output = named("never.mp4");
    ok(spin_exporter_video.begin(&job, &self) == SPIN_OK, "begins");
    spin_exporter_video.abort(self);
    ok(!spin_path_exists(job.output), "a video that is given up leaves nothing");
}

TAP_MAIN
{
    static const uint8_t colour[] = {10, 20, 30};
    static const int rows[FRAMES] = {0, 1, 2, 3, 4};
    static const float background[3] = {0};
    struct spin_views views = {0};
    struct spin_export_job job = {.n_frames = FRAMES,
                                  .fps = 25,
                                  .views = &views,
                                  .dataset_frame_of = rows,
                                  .source_frame = source_frame,
                                  .background = background};

    spin_log_set_level(-2);
    snprintf(folder, sizeof folder, "%s", check_folder());
    if (spin_image_start() != SPIN_OK) {
        skip("videos and paths", spin_last_error());
        return;
    }
    ok(spin_image_write(named("source.png"), 1, 1, colour, false) == SPIN_OK, "makes an image");
    make_views(&views, named("source.png"));
    test_orbit(job);
    test_rig(job);
    test_rig_order();
    test_front(job);
    test_size_and_duration(job);
    test_labels(job);
    test_drawing_refusals(job);
    if (spin_video_start() != SPIN_OK) {
        skip("videos", spin_last_error());
    } else {
        test_files(job);
        test_speed_and_quality(job);
        test_refusals(job);
    }
    spin_views_free(&views);
}
