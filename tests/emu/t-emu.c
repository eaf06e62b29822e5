/* The emulation detects every fault of faults.cu in every order, and none in the correct kernels.
 * K: emu cuda kernels */
#include <dlfcn.h>
#include <sys/wait.h>
#include <unistd.h>

#include "tests/tap.h"

static const char *const orders[] = {"forward", "reverse", "shuffle:5"};
enum { ORDERS = 3, RIGHT = 0, WRONG = 1, ABORTED = 2, BROKEN = 3 };

/* Runs the kernel in a child process; `said` receives its stderr. */
static int outcome(const char *object, const char *order, const char *what, char *said, size_t n)
{
    int ends[2], status;
    size_t got = 0;
    ssize_t more;
    pid_t child;

    said[0] = '\0';
    if (pipe(ends) != 0)
        return BROKEN;
    fflush(NULL);
    child = fork();
    if (child == 0) {
        const char *build = getenv("SPIN_BUILD");
        char path[512];
        void *shared;
        int (*run)(const char *);

        dup2(ends[1], 2);
        setenv("SPIN_EMU_ORDER", order, 1);
        snprintf(path, sizeof path, "%s/tests/emu/%s", build ? build : "build/release", object);
        shared = dlopen(path, RTLD_NOW);
        if (!shared)
            fprintf(stderr, "%s\n", dlerror());
        run = shared ? (int (*)(const char *))dlsym(shared, "run") : NULL;
        _exit(run ? run(what) : BROKEN);
    }
    close(ends[1]);
    while ((more = read(ends[0], said + got, n - 1 - got)) > 0)
        got += (size_t)more;
    said[got] = '\0';
    close(ends[0]);
    if (waitpid(child, &status, 0) != child)
        return BROKEN;
    return WIFEXITED(status) ? WEXITSTATUS(status) : ABORTED;
}

/* The kernel's result is right in every order. */
static void is_right(const char *object, const char *what)
{
    char said[2000];

    for (int i = 0; i < ORDERS; i++)
        if (!ok(outcome(object, orders[i], what, said, sizeof said) == RIGHT, "%s: %s is right, %s",
                object, what, orders[i]))
            printf("#   %s\n", said);
}

/* In every order the kernel is aborted with a message that contains `words`, or by a sanitizer that
 * found the fault first. */
static void is_reported(const char *object, const char *what, const char *words)
{
    char said[4000];

    for (int i = 0; i < ORDERS; i++) {
        int how = outcome(object, orders[i], what, said, sizeof said);

        if (!ok((how == ABORTED || how == 99) &&
                    (strstr(said, words) || strstr(said, "AddressSanitizer")),
                "%s: %s is reported: %s, %s", object, what, words, orders[i]))
            printf("#   %d: %s\n", how, said);
    }
}

/* In at least `least` of the orders the result is wrong, so that comparing results detects the
 * fault. */
static void shows(const char *what, int least)
{
    char said[2000];
    int wrong = 0;

    for (int i = 0; i < ORDERS; i++)
        wrong += outcome("faults.so", orders[i], what, said, sizeof said) == WRONG;
    ok(wrong >= least, "%s gives a wrong result in %d of 3 orders", what, wrong);
}

TAP_MAIN
{
    static const char *const objects[] = {"faults.so", "faults-race.so"};

    for (int k = 0; k < 2; k++) {
        is_right(objects[k], "sum");
        is_right(objects[k], "warp");
        is_right(objects[k], "rows");
        is_right(objects[k], "dynamic");
        is_right(objects[k], "mma");
        is_right(objects[k], "poisoned");
        is_reported(objects[k], "mma-float", "not a number of tf32");
        is_reported(objects[k], "mma-left", "has left");
        is_reported(objects[k], "warp-mask", "outside of the mask");
        is_reported(objects[k], "warp-outside", "outside of the mask");
        is_reported(objects[k], "warp-masks", "different masks");
        is_reported(objects[k], "warp-left", "has left");
        is_reported(objects[k], "two-barriers", "different operations");
        is_reported(objects[k], "early", "has left");
        is_reported(objects[k], "sum-index", "outside of its array");
    }
    is_reported("faults.so", "dynamic-past", "behind its dynamic shared memory");
    is_reported("faults.so", "dynamic-large", "more shared memory than a block may have");
    shows("sum-barrier", 1);
    shows("rows-unmerged", 3);
    shows("mma-exchanged", 3);
    is_reported("faults-race.so", "sum-barrier", "a race");
    is_reported("faults-race.so", "rows-plain", "a race");
}
