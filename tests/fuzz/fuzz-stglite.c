/* Any bytes as a PLY of 4D splats for SuperSplat-4D or OpenSplat4D. K: fuzz stglite ply */
#include "base/log.h"
#include "tests/fuzz/input.h"
#include "tests/fuzz/run.h"

extern const struct spin_importer spin_importer_stglite;

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t n)
{
    const char *path = input_path(data, n);

    spin_log_set_level(-2);
    if (path)
        read_run(&spin_importer_stglite, path, NULL);
    return 0;
}
