/* Any bytes as the two PLYs of Ex4DGS. The first byte chooses the interpolation, the next two say
 * how many of the others are the static Gaussians. K: fuzz ex4dgs ply */
#include "base/log.h"
#include "tests/fuzz/input.h"
#include "tests/fuzz/run.h"

#include <string.h>

extern const struct spin_importer spin_importer_ex4dgs;

static const char *const files[] = {"point_cloud.ply", "dynamic_point_cloud.ply"};
static char folder[64];

static void in_folder(const char *name, char path[128])
{
    snprintf(path, 128, "%s/%s", folder, name);
}

static void clean_up(void)
{
    char path[128];

    for (int i = 0; i < 2; i++) {
        in_folder(files[i], path);
        remove(path);
    }
    rmdir(folder);
}

static void write_file(const char *name, const uint8_t *data, size_t n)
{
    char path[128];
    FILE *file;

    in_folder(name, path);
    file = fopen(path, "wb");
    if (!file || fwrite(data, 1, n, file) != n || fclose(file) != 0)
        abort();
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t n)
{
    static const char *const kinds[] = {"linear", "cube", "pchip"};
    const char *pairs[] = {"interp", "", "interval", "5", "time-pad", "3", "duration", "10", NULL};
    size_t n_static;

    if (!folder[0]) {
        strcpy(folder, "/tmp/fuzz-ex4dgs.XXXXXX");
        if (!mkdtemp(folder))
            abort();
        atexit(clean_up);
    }
    spin_log_set_level(-2);
    if (n < 3)
        return 0;
    pairs[1] = kinds[data[0] % 3];
    n_static = data[1] | (size_t)data[2] << 8;
    n_static = n_static < n - 3 ? n_static : n - 3;
    write_file(files[0], data + 3, n_static);
    write_file(files[1], data + 3 + n_static, n - 3 - n_static);
    read_run(&spin_importer_ex4dgs, folder, pairs);
    return 0;
}
