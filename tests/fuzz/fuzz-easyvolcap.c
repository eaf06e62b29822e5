/* Any bytes as cameras of EasyVolcap. The first two say how many of the others are intri.yml; the
 * rest are extri.yml. K: fuzz easyvolcap */
#include "base/log.h"
#include "scene/probe.h"
#include "tests/fuzz/input.h"

#include <math.h>
#include <stdlib.h>
#include <sys/stat.h>

static char folder[64];
/* The first file is not a valid image, so reading ends when the image is opened. */
static const char *const files[] = {"images/a/0.png", "intri.yml", "extri.yml"};

static void in_folder(const char *name, char path[128])
{
    snprintf(path, 128, "%s/%s", folder, name);
}

static void clean_up(void)
{
    static const char *const names[] = {"images/a", "images", ""};
    char path[128];

    for (size_t i = 0; i < 6; i++) {
        in_folder(i < 3 ? files[i] : names[i - 3], path);
        remove(path);
    }
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

static void make_folder(void)
{
    char path[128];

    spin_log_set_level(-2);
    snprintf(folder, sizeof folder, "%s/fuzz-easyvolcap-XXXXXX",
             access("/dev/shm", W_OK) == 0 ? "/dev/shm" : "/tmp");
    if (!mkdtemp(folder))
        abort();
    atexit(clean_up);
    in_folder("images", path);
    mkdir(path, 0700);
    in_folder("images/a", path);
    mkdir(path, 0700);
    write_file(files[0], (const uint8_t *)"x", 1);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t n)
{
    const struct spin_importer *importer;
    struct spin_views views = {0};
    size_t n_intri;

    if (n < 2)
        return 0;
    if (!folder[0])
        make_folder();
    n_intri = data[0] | (size_t)data[1] << 8;
    data += 2;
    n -= 2;
    n_intri = n_intri < n ? n_intri : n;
    write_file(files[1], data, n_intri);
    write_file(files[2], data + n_intri, n - n_intri);
    if (spin_importer_find(folder, "easyvolcap", true, &importer) != SPIN_OK)
        abort();
    (void)importer->views(folder, NULL, &views);
    for (size_t i = 0; i < views.n; i++) {
        for (int k = 0; k < 12; k++) {
            if (!isfinite(views.view[i].camera.w2c[k]))
                abort();
        }
    }
    spin_views_free(&views);
    return 0;
}
