/* Where the shared objects lie, and whether they are of this version. */
#include "io/shim.h"

#include <dlfcn.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#ifndef SPIN_PREFIX
#define SPIN_PREFIX "/usr/local"
#endif

/* Folders above the program's in which lib/ is looked for: tests lie two below the build's. */
#define MAX_PARENTS 4

struct search {
    const struct spin_shim *shim;
    const void *table;
    char *why;
    size_t n_why;
};

/* Take the object at path; false when there is none, or none that fits: then the reason is kept. */
static bool load(struct search *s, const char *path)
{
    const void *table;
    void *object;

    if (access(path, R_OK) != 0)
        return false;
    object = dlopen(path, RTLD_NOW | RTLD_LOCAL);
    if (!object) {
        snprintf(s->why, s->n_why, "%s", dlerror());
        return false;
    }
    table = dlsym(object, s->shim->symbol);
    if (!table || *(const int *)table != s->shim->abi) {
        snprintf(s->why, s->n_why, "'%.400s' belongs to another version", path);
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

const void *spin_shim_load(const struct spin_shim *shim, char *why, size_t n_why)
{
    struct search s = {.shim = shim, .why = why, .n_why = n_why};
    const char *given = getenv(shim->override);

    why[0] = '\0';
    if (given && *given) {
        if (!load(&s, given) && !*why)
            snprintf(why, n_why, "%s names '%.400s', which is not there", shim->override, given);
        return s.table;
    }
    if (!load_beside_program(&s))
        load_below(&s, SPIN_PREFIX, "lib/spin4d");
    return s.table;
}
