/* Any bytes as a checkpoint of the methods that save tuples: open it, and read what it holds at
 * both ends and in the middle of its times. K: fuzz chkpnt realtime4dgs hybrid4dgs ex4dgs */
#include "base/log.h"
#include "tests/fuzz/input.h"
#include "tests/fuzz/run.h"

extern const struct spin_importer spin_importer_realtime4dgs, spin_importer_hybrid4dgs,
    spin_importer_ex4dgs;

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t n)
{
    static const char *const cube[] = {"interp", "cube", NULL};
    const char *path = input_path(data, n);

    spin_log_set_level(-2);
    if (!path)
        return 0;
    read_run(&spin_importer_realtime4dgs, path, NULL);
    read_run(&spin_importer_hybrid4dgs, path, NULL);
    read_run(&spin_importer_ex4dgs, path, cube);
    return 0;
}
