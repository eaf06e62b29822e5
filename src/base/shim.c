/* Where the shared objects lie, and whether they are of this version. */
#include "base/shim.h"

#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#ifndef SPIN_LIBDIR
#define SPIN_LIBDIR "/usr/local/lib"
#endif

/* Folders above the program's in which lib/ is looked for: tests lie two below the build's. */
#define MAX_PARENTS 4

struct search {
    struct spin_shim *shim;
    const void *table;
};

/* Where `ulimit -v` bounds the address space, a library may end the process while it is loaded, as one does
 * that starts threads: a child tries first. */
static bool ends_process(const char *path)
{
    struct rlimit limit;
    int how = 0;
    pid_t child;

    if (getrlimit(RLIMIT_AS, &limit) != 0 || limit.rlim_cur == RLIM_INFINITY)
        return false;
    child = fork();
    if (child == 0) {
        const struct rlimit none = {0, 0};

        (void)setrlimit(RLIMIT_CORE, &none);
        (void)dup2(open("/dev/null", O_WRONLY), STDERR_FILENO);
        (void)dlopen(path, RTLD_NOW | RTLD_LOCAL);
        _exit(0);
    }
    while (child > 0 && waitpid(child, &how, 0) < 0 && errno == EINTR)
        ;
    return WIFSIGNALED(how);
}

/* Take the object at path; false when there is none, or none that fits: then the reason is kept. */
static bool load(struct search *s, const char *path)
{
    const void *table;
    void *object;

    if (access(path, R_OK) != 0)
        return false;
    if (ends_process(path)) {
        snprintf(s->shim->why, sizeof s->shim->why,
                 "its libraries do not start in the memory that `ulimit -v` leaves");
        return false;
    }
    object = dlopen(path, RTLD_NOW | RTLD_LOCAL);
    if (!object) {
        snprintf(s->shim->why, sizeof s->shim->why, "%s", dlerror());
        return false;
    }
    table = dlsym(object, s->shim->symbol);
    if (!table || *(const int *)table != s->shim->abi) {
        snprintf(s->shim->why, sizeof s->shim->why, "'%.400s' belongs to another version", path);
        dlclose(object);
        return false;
    }
    s->table = table;
    return true;
}

static bool load_below(struct search *s, const char *folder, const char *below)
{
    char path[PATH_MAX + 64];

    snprintf(path, sizeof path, "%s/%s/%s", folder, below, s->shim->file);
    return load(s, path);
}

static bool load_beside_program(struct search *s)
{
    char folder[PATH_MAX];
    ssize_t n = readlink("/proc/self/exe", folder, sizeof folder - 1);

    if (n <= 0)
        return false;
    folder[n] = '\0';
    for (int i = 0; i <= MAX_PARENTS; i++) {
        char *slash = strrchr(folder, '/');

        if (!slash)
            return false;
        *slash = '\0';
        if (load_below(s, folder, "lib") || load_below(s, folder, "lib/spin4d"))
            return true;
    }
    return false;
}

static const void *find(struct spin_shim *shim)
{
    struct search s = {.shim = shim};
    const char *given = getenv(shim->override);

    if (given && *given) {
        if (!load(&s, given) && !*shim->why)
            snprintf(shim->why, sizeof shim->why, "%s names '%.400s', which is not there",
                     shim->override, given);
        return s.table;
    }
    if (!load_beside_program(&s))
        load_below(&s, SPIN_LIBDIR, "spin4d");
    return s.table;
}

spin_status spin_shim_need(struct spin_shim *shim, const void **table)
{
    static pthread_mutex_t mutex = PTHREAD_MUTEX_INITIALIZER;
    bool found;

    pthread_mutex_lock(&mutex);
    if (!shim->tried)
        *table = find(shim);
    shim->tried = true;
    found = *table != NULL;
    pthread_mutex_unlock(&mutex);
    if (found)
        return SPIN_OK;
    return spin_fail(SPIN_E_UNSUPPORTED,
                     "%s '%s' is missing or does not load%s%s (Debian: install %s, then make)",
                     shim->lacking, shim->file, *shim->why ? ": " : "", shim->why, shim->debian);
}
