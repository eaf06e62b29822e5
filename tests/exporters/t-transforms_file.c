/* --transforms of the exporter of images: all values of both files, for cameras in general position
 * that are described by their axes.  K: images transforms cameras */
#include "exporters/lib/transforms_file.h"

#include <unistd.h>

#include "base/err.h"
#include "io/output.h"
#include "tests/check.h"
#include "tests/rig.h"
#include "tests/tap.h"

enum { CAMERAS = 3 };

static struct pose pose_of(int k)
{
    const double eye[3] = {1 + k, -2, 3 - 0.5 * k}, target[3] = {0.5, 0.25 * k, -1};

    return pose_towards(eye, target, (const double[3]){0.1, -1, 0.2}, 0.3 * k);
}

static struct spin_camera lens_of(int k)
{
    return (struct spin_camera){64 + k, 48 - k, 70 + k, 55 - k, 20 + k, 33 - k, {0}, 0};
}

static bool is_number(const spin_json *object, const char *name, double want)
{
    double got = NAN;

    return spin_json_number(spin_json_get(object, name), &got) && fabs(got - want) < 1e-9;
}

/* Compares a matrix with the axes of the camera: those of OpenGL point right, up and backward. */
static double matrix_error(const spin_json *rows, const struct pose *p)
{
    double worst = spin_json_length(rows) == 4 ? 0 : INFINITY;

    for (size_t r = 0; r < 4; r++) {
        const spin_json *row = spin_json_at(rows, r);
        double want[4] = {0, 0, 0, 1};

        if (r < 3) {
            want[0] = p->right[r];
            want[1] = -p->down[r];
            want[2] = -p->ahead[r];
            want[3] = p->eye[r];
        }
        for (size_t k = 0; k < 4; k++) {
            double got = NAN;

            if (spin_json_length(row) != 4 || !spin_json_number(spin_json_at(row, k), &got))
                return INFINITY;
            worst = larger(worst, fabs(got - want[k]));
        }
    }
    return worst;
}

/* Checks a file that contains the images `first` to `last`. */
static void check_file(const char *folder, const char *name, int first, int last)
{
    static const char *const images[CAMERAS] = {"a.b", "two", "last"};
    struct spin_camera lens = lens_of(first);
    char path[600];
    spin_json *root = NULL;
    const spin_json *frames;

    snprintf(path, sizeof path, "%s/%s", folder, name);
    ok(spin_json_load(path, &root) == SPIN_OK, "%s", name);
    frames = spin_json_get(root, "frames");
    ok(is_number(root, "camera_angle_x", 2 * atan(lens.width / 2.0 / lens.fx)) &&
           is_number(root, "w", lens.width) && is_number(root, "h", lens.height) &&
           spin_json_length(frames) == (size_t)(last - first + 1),
       "the lens of the first image, and %zu images", spin_json_length(frames));
    for (int k = first; k <= last; k++) {
        const spin_json *frame = spin_json_at(frames, (size_t)(k - first));
        struct pose p = pose_of(k);

        lens = lens_of(k);
        is_text(spin_json_string(spin_json_get(frame, "file_path")), images[k],
                "a name without extension");
        ok(is_number(frame, "time", 0.25 * k) && is_number(frame, "w", lens.width) &&
               is_number(frame, "h", lens.height) && is_number(frame, "fl_x", lens.fx) &&
               is_number(frame, "fl_y", lens.fy) && is_number(frame, "cx", lens.cx) &&
               is_number(frame, "cy", lens.cy),
           "time and lens of image %d", k);
        near(matrix_error(spin_json_get(frame, "transform_matrix"), &p), 0, 1e-9, "and its pose");
    }
    spin_json_free(root);
}

static bool exists(const char *folder, const char *name)
{
    char path[600];

    snprintf(path, sizeof path, "%s/%s", folder, name);
    return access(path, F_OK) == 0;
}

/* Adds images of these cameras, of which those from n_train on are held out, and writes the files.
 */
static void write_files(struct spin_output_folder *folder, int n, int n_train)
{
    static const char *const file[CAMERAS] = {"a.b.png", "two.png", "last"};
    struct spin_transforms_file t = {0};
    spin_json *root[2];

    for (int k = 0; k < n; k++) {
        struct pose p = pose_of(k);
        struct spin_camera c = camera_of(lens_of(k), &p);

        spin_transforms_file_add(&t, file[k], 0.25 * k, &c, k >= n_train);
    }
    ok(spin_transforms_file_write(&t, folder, false) == SPIN_OK, "writes %d cameras: %s", n,
       spin_last_error());
    for (int i = 0; i < 2; i++)
        root[i] = json_incref(t.root[i]);
    spin_transforms_file_close(&t);
    ok(!t.root[0] && !t.root[1], "and closes");
    for (int i = 0; i < 2; i++) {
        ok(!root[i] || root[i]->refcount == 1, "without a reference to the file");
        json_decref(root[i]);
    }
}

TAP_MAIN
{
    char path[500], missing[600];
    struct spin_output_folder folder = {0};
    struct spin_transforms_file t = {0};
    struct spin_camera c = lens_of(0);

    snprintf(path, sizeof path, "%s/out", check_folder());
    ok(spin_output_folder_begin(path, false, ".png", &folder) == SPIN_OK, "an empty folder");
    write_files(&folder, 0, 0);
    ok(!exists(path, "transforms_train.json") && !exists(path, "transforms_test.json"),
       "no images, no files");
    write_files(&folder, 1, 0);
    ok(!exists(path, "transforms_train.json") && exists(path, "transforms_test.json"),
       "held-out images only");
    write_files(&folder, CAMERAS, 2);
    check_file(path, "transforms_train.json", 0, 1);
    check_file(path, "transforms_test.json", 2, 2);
    spin_output_folder_end(&folder);

    /* A file that cannot be written is an error. */
    snprintf(missing, sizeof missing, "%s/missing", path);
    folder = (struct spin_output_folder){.path = missing};
    spin_transforms_file_add(&t, "a.png", 0, &c, false);
    ok(spin_transforms_file_write(&t, &folder, false) == SPIN_E_NOT_FOUND &&
           strstr(spin_last_error(), "missing"),
       "a folder that does not exist: %s", spin_last_error());
    spin_transforms_file_close(&t);
}
