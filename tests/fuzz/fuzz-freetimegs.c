/* Any bytes as a model of FreeTimeGS: what begins as a PLY as its .ftgs.ply, all else as its
 * checkpoint. K: fuzz freetimegs ftgs ply */
#include "base/log.h"
#include "tests/fuzz/input.h"
#include "tests/fuzz/run.h"

#include <string.h>

extern const struct spin_importer spin_importer_freetimegs;

static char folder[64], ply[128];

static void clean_up(void)
{
    remove(ply);
    rmdir(folder);
}

/* The file at `path` by a name that ends in .ply, which is how the importer knows one. */
static void name_as_ply(const char *path)
{
    if (ply[0])
        return;
    strcpy(folder, "/tmp/fuzz-freetimegs.XXXXXX");
    if (!mkdtemp(folder))
        abort();
    snprintf(ply, sizeof ply, "%s/scene.ftgs.ply", folder);
    if (symlink(path, ply) != 0)
        abort();
    atexit(clean_up);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t n)
{
    const char *path = input_path(data, n);

    spin_log_set_level(-2);
    if (!path)
        return 0;
    if (n >= 3 && memcmp(data, "ply", 3) == 0) {
        name_as_ply(path);
        path = ply;
    }
    read_run(&spin_importer_freetimegs, path, NULL);
    return 0;
}
