/* Any bytes as a stage of USD: text, a crate or a package. K: fuzz usd usda usdc usdz */
#include "base/log.h"
#include "tests/fuzz/input.h"
#include "tests/fuzz/run.h"

extern const struct spin_importer spin_importer_usd;

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t n)
{
    const char *path = input_path(data, n);

    spin_log_set_level(-2);
    if (path)
        read_run(&spin_importer_usd, path, NULL);
    return 0;
}
