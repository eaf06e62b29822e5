#include "base/program.h"

#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#ifdef __linux__
#include <sys/auxv.h>
#endif

bool spin_program_path(char path[4096])
{
    ssize_t n = readlink("/proc/self/exe", path, 4095);

    path[n > 0 ? n : 0] = '\0';
#ifdef __linux__
    if (n <= 0) {
        char *whole = realpath((const char *)getauxval(AT_EXECFN), NULL);

        n = whole ? snprintf(path, 4096, "%s", whole) : 0;
        free(whole);
    }
#endif
    return n > 0 && n < 4096;
}

void spin_program_restart(char **argv)
{
#ifdef __linux__
    char path[4096], folder[4096];

    if (readlink("/proc/self/exe", path, sizeof path) > 0 || getenv("LD_ORIGIN_PATH") ||
        !spin_program_path(path))
        return;
    snprintf(folder, sizeof folder, "%s", path);
    *strrchr(folder, '/') = '\0';
    if (setenv("LD_ORIGIN_PATH", folder, 1) == 0)
        execv(path, argv);
#else
    (void)argv;
#endif
}
