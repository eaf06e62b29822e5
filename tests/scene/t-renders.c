/* Data sets rendered from a clip: which of the cameras that the clip keeps are used, their lenses
 * at the size of the images, the near plane, and the paths of images.  K: renders cameras views */
#include "scene/renders.h"

#include "base/err.h"
#include "base/log.h"
#include "math/rng.h"
#include "scene/bundle.h"
#include "tests/check.h"
#include "tests/tap.h"

enum { KEPT = 10, SPLATS = 600, FRAMES = 3, FIRST_NUMBER = 7 };
static const unsigned columns = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
static float depth = 0.4f; /* of the splats in the frame that sets the near plane */

/* No two cameras have a value in common. */
static struct spin_camera kept_camera(int k, int width, int height)
{
    return (struct spin_camera){
        .width = width + k,
        .height = height + k,
        .fx = 50 + k,
        .fy = 70 + 2 * k,
        .cx = 0.5 * width - 2 + 0.3 * k,
        .cy = 0.5 * height - 4 + 0.1 * k,
        .w2c = {1, 0, 0, -0.01 * k, 0, 1, 0, 0.02 * k, 0, 0, 1, 0.001 * k},
    };
}

/* A disc in front of the cameras, farther away in the last frame; the first frame is empty. */
static void fill_frame(struct spin_splats *s, int f)
{
    size_t n = f == 0 ? 0 : SPLATS;

    if (spin_splats_reserve(s, n, columns, 0) != SPIN_OK)
        exit(1);
    for (size_t i = 0; i < n; i++) {
        float radius = 0.1f * sqrtf(spin_rng_uniform(1, 0, i));
        float angle = 6.2832f * spin_rng_uniform(1, 1, i);
        const float at[3] = {radius * cosf(angle), radius * sinf(angle), depth * (float)f};

        for (size_t c = 0; c < 3; c++) {
            s->means[3 * i + c] = at[c];
            s->log_scales[3 * i + c] = -5;
            s->sh[3 * i + c] = spin_rng_uniform(1, 2 + c, i);
        }
        memcpy(s->quats + 4 * i, (const float[4]){1}, 4 * sizeof(float));
        s->logit_opacities[i] = 3;
    }
}

/* Writes a bundle that keeps n cameras, of which the first has this size. */
static const char *write_bundle(int n, int width, int height)
{
    static char path[400];
    static int count;
    struct spin_bundle_writer w;
    struct spin_bundle_meta meta = {0};
    struct spin_splats s = {0};

    snprintf(path, sizeof path, "%s/%d.spin", check_folder(), count++);
    if (spin_bundle_meta_reserve(&meta, FRAMES) != SPIN_OK)
        exit(1);
    snprintf(meta.from, sizeof meta.from, "d3dgs");
    for (int f = 0; f < FRAMES; f++) {
        meta.frame[f] = (struct spin_frame_info){FIRST_NUMBER + f, 0.25 * f, f ? SPLATS : 0};
        meta.source_index[f] = f;
    }
    meta.n_source_frames = FRAMES;
    meta.numbered = true;
    meta.columns = columns;
    for (int k = 0; k < n; k++) {
        struct spin_view view = {.camera = kept_camera(k, width, height), .camera_id = 100 + k};

        if (spin_views_add(&meta.cameras, &view) != SPIN_OK)
            exit(1);
    }
    if (spin_bundle_writer_open(path, false, false, &w) != SPIN_OK)
        exit(1);
    for (int f = 0; f < FRAMES; f++) {
        fill_frame(&s, f);
        if (spin_bundle_write_frame(&w, f, columns, 0, &s) != SPIN_OK)
            exit(1);
    }
    ok(spin_bundle_writer_finish(&w, &meta, NULL) == SPIN_OK, "a clip that keeps %d cameras: %s", n,
       spin_last_error());
    spin_bundle_meta_free(&meta);
    spin_splats_free(&s);
    return path;
}

/* Reads the data set of a bundle with options "name", "value", ..., NULL. */
static bool read_views(const char *path, const char *const *pairs, struct spin_views *out)
{
    struct spin_plugin_values values = {pairs};

    *out = (struct spin_views){0};
    if (spin_renders.views(path, &values, out) == SPIN_OK)
        return true;
    printf("# %s\n", spin_last_error());
    return false;
}

/* Checks that the data set consists of these kept cameras, first the training cameras. */
static void check_choice(const char *path, const char *const *pairs, const int *wanted, int n,
                         int n_train)
{
    struct spin_views views;
    bool good = read_views(path, pairs, &views) && views.n == (size_t)n * FRAMES;

    for (int i = 0; i < n * FRAMES && good; i++) {
        const struct spin_view *v = &views.view[i];
        int k = i % n, f = i / n;

        good = v->dataset_frame == f && v->number == FIRST_NUMBER + f && v->time == 0.25 * f &&
               v->camera_id == k && v->test == (k >= n_train) &&
               v->camera.w2c[3] == -0.01 * wanted[k];
    }
    ok(good, "%d of %d cameras train, in all frames", n_train, n);
    ok(strstr(views.notes, "cameras that the clip keeps") != NULL, "and a note: %s", views.notes);
    spin_views_free(&views);
}

static void test_choice(const char *path)
{
    static const char *const five[] = {"cameras", "3", "test", "2", NULL}, *const none[] = {NULL},
                             *const tests[] = {"cameras", "1", "test", "1000", NULL},
                             *const trains[] = {"test", "0", NULL};
    static const int of_five[] = {0, 2, 6, 4, 8}, of_all[] = {0, 1, 2, 4, 5, 7, 8, 3, 6, 9},
                     in_order[] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9};

    check_choice(path, five, of_five, 5, 3);
    check_choice(path, none, of_all, KEPT, 7);
    check_choice(path, tests, in_order, KEPT, 1);
    check_choice(path, trains, in_order, KEPT, KEPT);
}

/* Cameras are placed if the clip keeps few, or if an option applies to placed cameras only. */
static void test_placed(const char *path)
{
    static const char *const few[][7] = {{"cameras", "4", "test", "0"},
                                         {"cameras", "4", "test", "0", "fov", "50"},
                                         {"cameras", "4", "test", "0", "up", "-y"},
                                         {"cameras", "4", "test", "0", "seed", "0"}};
    static const int in_order[] = {0, 2, 4, 6};
    struct spin_views views;

    for (int i = 1; i < 4; i++) {
        ok(read_views(path, few[i], &views) && strstr(views.notes, "around the subject"),
           "%s places cameras: %s", few[i][4], views.notes);
        spin_views_free(&views);
    }
    ok(read_views(write_bundle(7, 64, 48), few[0], &views) &&
           strstr(views.notes, "around the subject") && strstr(views.notes, "for 4 cameras"),
       "seven cameras are too few: %s", views.notes);
    spin_views_free(&views);
    check_choice(write_bundle(8, 64, 48), few[0], in_order, 4, 4);
}

/* Checks the lenses of all views: the image shows no more than that of the source. */
static void check_lenses(const char *path, const char *const *pairs, int width, int height,
                         int source_width, int source_height)
{
    struct spin_views views;
    double worst = 0;

    ok(read_views(path, pairs, &views) && views.n == (size_t)KEPT * FRAMES, "reads");
    for (size_t i = 0; i < views.n; i++) {
        const struct spin_camera *c = &views.view[i].camera;
        int k = (int)lrint(-100 * c->w2c[3]);
        struct spin_camera from = kept_camera(k, source_width, source_height), parsed;
        double factor = larger((double)width / from.width, (double)height / from.height);
        char *bundle = NULL;
        int frame = -1;

        worst = larger(worst, fabs(c->fx - factor * from.fx));
        worst = larger(worst, fabs(c->fy - factor * from.fy));
        worst = larger(worst, fabs(c->cx - 0.5 * width - factor * (from.cx - 0.5 * from.width)));
        worst = larger(worst, fabs(c->cy - 0.5 * height - factor * (from.cy - 0.5 * from.height)));
        if (source_width == 64) /* the median camera sees the splats */
            worst = larger(worst, fabs(c->z_near - 0.25 * ((double)depth + 0.001 * KEPT / 2)) / 10);
        if (c->width != width || c->height != height || memcmp(c->w2c, from.w2c, sizeof c->w2c) ||
            c->z_near != views.view[0].camera.z_near ||
            spin_renders_parse(views.view[i].path, &bundle, &frame, &parsed) != SPIN_OK ||
            strcmp(bundle, path) != 0 || frame != views.view[i].dataset_frame ||
            memcmp(&parsed, c, sizeof parsed) != 0)
            worst = INFINITY;
        free(bundle);
    }
    ok(worst < 1e-9, "%d x %d, from %d x %d: lenses, near plane and paths: %g off", width, height,
       source_width, source_height, worst);
    spin_views_free(&views);
}

static void test_lenses(const char *path)
{
    static const char *const wide[] = {"size", "96x48", NULL},
                             *const high[] = {"size", "48x96", NULL}, *const none[] = {NULL};
    struct spin_views views;
    bool good;

    check_lenses(path, wide, 96, 48, 64, 48);
    check_lenses(path, high, 48, 96, 64, 48);
    check_lenses(path, none, 277, 208, 64, 48); /* as many pixels as 320 x 180 */
    check_lenses(write_bundle(KEPT, 4000, 10), none, 4800, 16, 4000, 10);
    check_lenses(write_bundle(KEPT, 10, 4000), none, 16, 4800, 10, 4000);
    depth = 4;
    good = read_views(write_bundle(KEPT, 64, 48), none, &views);
    for (size_t i = 0; i < views.n; i++)
        good = good && views.view[i].camera.z_near == SPIN_NEAR;
    ok(good, "far from the splats, the near plane of all cameras is that of 3DGS");
    spin_views_free(&views);
}

/* Options in range and out of range, and those of placed cameras. */
static void test_options(const char *path)
{
    static const char *const good[][2] = {{"size", "16x8192"}, {"size", "8192x16"}},
                             *const bad[][2] = {
                                 {"size", "15x16"},   {"size", "16x15"},   {"size", "8193x16"},
                                 {"size", "16x8193"}, {"size", "16x16x"},  {"size", "16"},
                                 {"up", "w"},         {"up", "xy"},        {"up", "-"},
                                 {"fov", "4"},        {"fov", "151"},      {"seed", "-1"},
                                 {"cameras", "0"},    {"cameras", "1001"}, {"test", "-1"},
                                 {"test", "1001"}};
    static const char *const placed[] = {"cameras", "4",  "test", "0", "size", "64x48",
                                         "fov",     "90", "up",   "x", NULL};
    struct spin_views views;

    for (size_t i = 0; i < sizeof good / sizeof *good; i++) {
        const char *const pairs[] = {good[i][0], good[i][1], NULL};

        ok(read_views(path, pairs, &views), "%s=%s", pairs[0], pairs[1]);
        spin_views_free(&views);
    }
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        const char *const pairs[] = {bad[i][0], bad[i][1], NULL};
        struct spin_plugin_values values = {pairs};

        views = (struct spin_views){0};
        ok(spin_renders.views(path, &values, &views) == SPIN_E_USAGE, "%s=%s is refused: %s",
           pairs[0], pairs[1], spin_last_error());
        spin_views_free(&views);
    }
    ok(read_views(path, placed, &views) && views.n > 0, "places cameras");
    for (size_t i = 0; i < views.n && i < 4; i++)
        ok(fabs(views.view[i].camera.fy - 24) < 1e-9 && views.view[i].camera.w2c[4] < 0,
           "with this field of view, and x up");
    spin_views_free(&views);
}

static void test_paths(void)
{
    static const char *const wrong[] = {"a.spin", "a.spin#draw=1,2", "a.spin#draw=1,2,3,4"};

    for (int i = 0; i < 3; i++) {
        struct spin_camera c;
        char *bundle = NULL;
        int frame;

        ok(spin_renders_parse(wrong[i], &bundle, &frame, &c) == SPIN_E_MALFORMED && !bundle,
           "'%s' is the path of no image", wrong[i]);
    }
    ok(spin_renders_reads("any", "renders") && !spin_renders_reads("any", "colmap") &&
           !spin_renders_reads("any", NULL),
       "a data set is rendered if its importer is 'renders'");
}

TAP_MAIN
{
    char path[400];

    spin_log_set_level(-2);
    snprintf(path, sizeof path, "%s", write_bundle(KEPT, 64, 48));
    ok(spin_renders_reads(path, NULL), "or if it is a bundle");
    test_choice(path);
    test_placed(path);
    test_lenses(path);
    test_options(path);
    test_paths();
}
