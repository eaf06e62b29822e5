/* Any bytes as a tar archive, packed by gzip or not: read every member.  K: fuzz tar archives */
#include "io/archive.h"
#include "tests/fuzz/input.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t n)
{
    const char *path = input_path(data, n);
    struct spin_stream s;
    struct spin_tar tar = {.stream = &s};
    unsigned char bytes[1000];

    if (!path)
        return 0;
    if (spin_stream_open(path, 1 << 24, &s) == SPIN_OK) {
        while (spin_tar_next(&tar) == SPIN_OK && tar.name)
            if (tar.unread > 0 &&
                spin_tar_read(&tar, bytes,
                              tar.unread < sizeof bytes ? (size_t)tar.unread : sizeof bytes) !=
                    SPIN_OK)
                break;
        spin_tar_close(&tar);
    }
    spin_stream_close(&s);
    return 0;
}
