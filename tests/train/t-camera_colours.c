/* Gains of cameras and falloff of their lenses from points and images: a wall in two greys in
 * front of a row of cameras, with known ground truth. One camera is overexposed where the wall
 * is bright, one is dark in red, one sees a plate that hides the wall from it alone, one sees
 * the wall's edge only.
 * K: lens falloff exposure */
#include "spin_run.h"
#include "train/photometric_fit.h"

#include "base/log.h"
#include "io/image.h"
#include "tests/check.h"
#include "tests/tap.h"
#include "train/plan.h"

enum { W = 96, H = 64, CAMERAS = 8, WHITE = 2, RED = 3, PLATE = 6, EDGE = 7 };
static const double wall_z = 4, plate_z = 0.1, plate_x = 0.05, plate_y = 0.038, plate_grey = 0.2;
static const double c1[2] = {-0.12,
                             -0.06}; /* of the lenses of cameras 0 to 3 and 7, and of the others */
static char folder[600];

static double eye_of(int camera) { return camera == EDGE ? 6.15 : 0.2 * (camera - 3); }
static int lens_of(int camera) { return camera > RED && camera != EDGE; }
static double focal_of(int camera) { return lens_of(camera) ? 80 : 60; }

static double gain_of(int camera, int rgb)
{
    return camera == WHITE ? 1.3 : camera == EDGE ? 0.4 : camera == RED && rgb == 0 ? 0.7 : 1;
}

static void write_picture(int camera)
{
    static uint8_t rgb[3 * W * H];
    char path[700];

    for (int i = 0; i < 3 * W * H; i++) {
        double u = i / 3 % W + 0.5 - W / 2, v = (double)(i / 3 / W) + 0.5 - H / 2,
               f = focal_of(camera), r2 = (u * u + v * v) / (W / 2 * W / 2);
        bool plate =
            camera == PLATE && fabs(u * plate_z / f) < plate_x && fabs(v * plate_z / f) < plate_y;
        double grey = plate ? plate_grey : eye_of(camera) + u * wall_z / f < 0 ? 0.45 : 0.85;

        grey *= gain_of(camera, i % 3) * (1 + c1[lens_of(camera)] * r2);
        rgb[i] = (uint8_t)rint(255 * fmin(grey, 1));
    }
    snprintf(path, sizeof path, "%s/data/ims/%d", folder, camera);
    mkdir(path, 0777);
    snprintf(path, sizeof path, "%s/data/ims/%d/000000.png", folder, camera);
    if (spin_image_write(path, W, H, rgb, false) != SPIN_OK)
        exit(1);
}

static FILE *open_in(const char *name)
{
    char path[700];
    FILE *f;

    snprintf(path, sizeof path, "%s/%s", folder, name);
    f = fopen(path, "w");
    if (!f)
        exit(1);
    return f;
}

static void write_meta(void)
{
    FILE *f = open_in("data/train_meta.json");

    fprintf(f, "{\"w\": %d, \"h\": %d, \"k\": [[", W, H);
    for (int k = 0; k < CAMERAS; k++)
        fprintf(f, "%s[[%g, 0, %d], [0, %g, %d], [0, 0, 1]]", k ? ", " : "", focal_of(k), W / 2,
                focal_of(k), H / 2);
    fprintf(f, "]], \"w2c\": [[");
    for (int k = 0; k < CAMERAS; k++)
        fprintf(f, "%s[[1, 0, 0, %g], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]", k ? ", " : "",
                -eye_of(k));
    fprintf(f, "]], \"fn\": [[");
    for (int k = 0; k < CAMERAS; k++)
        fprintf(f, "%s\"%d/000000.png\"", k ? ", " : "", k);
    fprintf(f, "]], \"cam_id\": [[");
    for (int k = 0; k < CAMERAS; k++)
        fprintf(f, "%s%d", k ? ", " : "", k);
    fprintf(f, "]]}\n");
    fclose(f);
}

static void put_grid(FILE *f, int columns, int rows, double x, double y, double z, double middle)
{
    for (int i = 0; i < columns * rows; i++)
        fprintf(f, "%g %g %g\n", middle + x * ((i % columns + 0.5) / columns * 2 - 1),
                y * ((i / columns + 0.5) / rows * 2 - 1), z);
}

/* The plate's points come first: they are more than every fourth of all points, which is how
 * many are compared. */
static void write_points(void)
{
    FILE *f = open_in("points/000000.ply");

    fprintf(f,
            "ply\nformat ascii 1.0\nelement vertex %d\nproperty float x\nproperty float y\n"
            "property float z\nend_header\n",
            64 * 60 + 121 * 75);
    put_grid(f, 64, 60, plate_x, plate_y, plate_z, eye_of(PLATE));
    put_grid(f, 121, 75, 3, 2, wall_z, 0);
    fclose(f);
}

static void check(const struct spin_plan *plan, double spread)
{
    double gain = 0;

    near(spread, 0.17, 0.02, "the camera that is dark in red is farthest from the others");
    for (int k = 1; k < EDGE; k++)
        for (int rgb = 0; rgb < 3; rgb++)
            gain = larger(gain, fabs((double)(plan->exposure[6 * k + rgb] - plan->exposure[rgb]) -
                                     log(gain_of(k, rgb))));
    ok(gain < 0.01, "gains of the cameras: %.4f", gain);
    if (!ok(plan->lenses.n == 2, "two lenses"))
        return;
    for (int k = 0; k < 2; k++)
        for (int rgb = 0; rgb < 3; rgb++) {
            const float *fall = plan->lenses.lens[k].falloff;
            double want = c1[plan->lenses.lens[k].focal > 0.7];

            near((double)fall[rgb] + (double)fall[3 + rgb], want, 0.01, "falloff at r = 1");
        }
}

TAP_MAIN
{
    struct spin_import_options i = {0};
    struct spin_retrain_options o;
    struct spin_retrain_report report = {0};
    struct spin_plan plan = {0};
    struct spin_photos photos = {0};
    char points[700], data[700], bundle[700], path[700];
    struct spin_photometric_result look = {.spread = NAN};

    spin_log_set_level(-2);
    snprintf(folder, sizeof folder, "%s", check_folder());
    snprintf(points, sizeof points, "%s/points", folder);
    snprintf(data, sizeof data, "%s/data", folder);
    snprintf(bundle, sizeof bundle, "%s/in.spin", folder);
    snprintf(path, sizeof path, "%s/data/ims", folder);
    mkdir(points, 0777);
    mkdir(data, 0777);
    mkdir(path, 0777);
    for (int k = 0; k < CAMERAS; k++)
        write_picture(k);
    write_meta();
    write_points();
    i.input = points;
    i.data = data;
    i.output = bundle;
    if (!ok(spin_import(&i, NULL) == SPIN_OK, "imports: %s", spin_last_error()))
        return;
    spin_retrain_preset("quick", &o);
    o.input = bundle;
    o.output = path;
    o.learn_exposure = SPIN_EXPOSURE_ON;
    ok(spin_plan_open(&plan, &o, &report) == SPIN_OK && spin_photos_open(&photos, &plan) == SPIN_OK,
       "plans: %s", spin_last_error());
    ok(spin_photometric_fit_cameras(&plan, &photos, &look) == SPIN_OK, "compares: %s",
       spin_last_error());
    ok(look.gains == SPIN_PHOTOMETRIC_SEEN && look.falloff == SPIN_PHOTOMETRIC_SEEN,
       "both are believed: %d, %d", (int)look.gains, (int)look.falloff);
    check(&plan, look.spread);
    spin_photos_close(&photos);
    spin_plan_close(&plan);
}
