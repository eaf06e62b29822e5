/* Fuzz targets for readers that want a path: the input as a file in memory. */
#ifndef SPIN_TESTS_FUZZ_INPUT_H
#define SPIN_TESTS_FUZZ_INPUT_H

#include <stdint.h>
#include <stdio.h>
#include <sys/mman.h>
#include <unistd.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t n);

/* The path of a file that holds the n bytes, or NULL. The file is kept and reused. */
static inline const char *input_path(const uint8_t *data, size_t n)
{
    static int fd = -1;
    static char path[64];

    if (fd < 0) {
        fd = memfd_create("fuzz", MFD_CLOEXEC);
        snprintf(path, sizeof path, "/proc/self/fd/%d", fd);
    }
    if (fd < 0 || ftruncate(fd, 0) != 0 || pwrite(fd, data, n, 0) != (ssize_t)n)
        return NULL;
    return path;
}

#endif
