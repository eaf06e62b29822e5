/* Any bytes as a zip archive: open, look up and unpack every member.  K: fuzz zip */
#include "io/zip.h"
#include "scene/probe.h"
#include "tests/fuzz/input.h"

#include <stdlib.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t n)
{
    const char *path = input_path(data, n);
    struct spin_zip zip;
    struct spin_peek peek;
    const unsigned char *bytes;
    void *owned;
    volatile unsigned sum = 0;

    if (!path)
        return 0;
    if (spin_peek_open(path, &peek) == SPIN_OK)
        spin_peek_free(&peek);
    if (spin_zip_open(path, &zip) != SPIN_OK)
        return 0;
    for (size_t i = 0; i < zip.n; i++) {
        const struct spin_zip_member *m = spin_zip_find(&zip, zip.member[i].name);

        if (!m)
            abort(); /* every name can be found */
        /* Without the CRC check the fuzzer reaches what lies behind it. */
        if (spin_zip_read(&zip, &zip.member[i], i % 2, 1 << 24, &bytes, &owned) == SPIN_OK) {
            for (uint64_t k = 0; k < zip.member[i].size; k += 64)
                sum += bytes[k];
            free(owned);
        }
    }
    spin_zip_close(&zip);
    return 0;
}
