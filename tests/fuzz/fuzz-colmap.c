/* Any bytes as a COLMAP model, binary or text. The first byte says which, the next two how many of
 * the others are the cameras, two more how many the images; the rest are the points.
 * K: fuzz colmap */
#include "base/log.h"
#include "scene/probe.h"
#include "tests/fuzz/input.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

static char folder[64];

static void in_folder(const char *name, char path[128])
{
    snprintf(path, 128, "%s/%s", folder, name);
}

static void clean_up(void)
{
    static const char *const names[] = {"sparse/0/cameras.bin",
                                        "sparse/0/images.bin",
                                        "sparse/0/cameras.txt",
                                        "sparse/0/images.txt",
                                        "sparse/0/points3D.bin",
                                        "sparse/0/points3D.txt",
                                        "sparse/0",
                                        "sparse",
                                        ""};
    char path[128];

    for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
        in_folder(names[i], path);
        remove(path);
    }
}

static void make_folder(void)
{
    char path[128];

    spin_log_set_level(-2);
    /* In memory where there is such a place: a disk would take most of the time. */
    snprintf(folder, sizeof folder, "%s/fuzz-colmap-XXXXXX",
             access("/dev/shm", W_OK) == 0 ? "/dev/shm" : "/tmp");
    if (!mkdtemp(folder))
        abort();
    atexit(clean_up);
    in_folder("sparse", path);
    mkdir(path, 0700);
    in_folder("sparse/0", path);
    mkdir(path, 0700);
}

static void write_file(const char *name, const uint8_t *data, size_t n)
{
    char path[128];
    FILE *file;

    in_folder(name, path);
    file = fopen(path, "wb");
    if (!file || fwrite(data, 1, n, file) != n)
        abort();
    fclose(file);
}

/* No image is there, so reading ends when that is noticed; what was read until then is whole. */
static void check(const struct spin_views *views)
{
    for (size_t i = 0; i < views->n; i++) {
        const struct spin_camera *c = &views->view[i].camera;

        for (int k = 0; k < 12; k++) {
            if (!isfinite(c->w2c[k]))
                abort();
        }
        if (!(c->fx > 0) || c->width < 1 || !views->view[i].path)
            abort();
    }
}

/* The first n bytes of the rest as sparse/0/<name>.<bin or txt>; the other kind is not there. */
static void write_part(const char *name, bool binary, const uint8_t **data, size_t *left, size_t n)
{
    char file[64], path[128];

    n = n < *left ? n : *left;
    snprintf(file, sizeof file, "sparse/0/%s.%s", name, binary ? "txt" : "bin");
    in_folder(file, path);
    remove(path);
    snprintf(file, sizeof file, "sparse/0/%s.%s", name, binary ? "bin" : "txt");
    write_file(file, *data, n);
    *data += n;
    *left -= n;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t n)
{
    const struct spin_importer *importer;
    struct spin_views views = {0};
    size_t n_cameras, n_images, left;
    bool binary;

    if (n < 5)
        return 0;
    if (!folder[0])
        make_folder();
    binary = data[0] % 2 == 0;
    n_cameras = data[1] | (size_t)data[2] << 8;
    n_images = data[3] | (size_t)data[4] << 8;
    data += 5;
    left = n - 5;
    write_part("cameras", binary, &data, &left, n_cameras);
    write_part("images", binary, &data, &left, n_images);
    write_part("points3D", binary, &data, &left, left);
    if (spin_importer_find(folder, "colmap", true, &importer) != SPIN_OK)
        abort();
    (void)importer->views(folder, NULL, &views);
    check(&views);
    spin_views_free(&views);
    return 0;
}
