/* Finds and loads shared objects. Objects that other users can write to, or that belong to another
 * version of spin4d, are refused. */
#include "base/shim.h"

#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <pthread.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include "base/program.h"

#ifndef SPIN_LIBDIR
#define SPIN_LIBDIR "/usr/local/lib"
#endif

/* The end of the error message for a missing shared object: how to install the packages that it
 * needs and build it. Since this is not possible on Windows, the advice there is to use WSL. */
#ifdef _WIN32
#define HINT "spin4d for Windows does not include it; in WSL: install %s, then build spin4d"
#else
#define HINT "on Debian: install %s, then build spin4d again"
#endif

struct search {
    struct spin_shim *shim;
    const void *table;
    uid_t owner; /* owner of the program's file; 0 (root) if unknown */
};

/* Whether the address space of this process is limited (`ulimit -v`). */
static bool has_space_limit(void)
{
    struct rlimit limit;

    return getrlimit(RLIMIT_AS, &limit) == 0 && limit.rlim_cur != RLIM_INFINITY;
}

/* Whether loading the library would end the process. This can happen if the address space is
 * limited (`ulimit -v`), for instance if the library starts threads. Loads the library in a child
 * process to find out; without a limit, returns false. */
static bool ends_process(const char *path)
{
    int how = 0;
    pid_t child;

    if (!has_space_limit())
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

/* Whether an error of the loader means that memory ran out, even if the text does not say so. A
 * failed malloc() sets errno. A segment that cannot be mapped does not; it means a lack of memory
 * only if the address space is limited. */
static bool is_lack_of_memory(int error, const char *text)
{
    return error == ENOMEM || (has_space_limit() && strstr(text, "failed to map segment"));
}

/* Load an object with dlopen(). On failure, write the reason to `why`. */
static void *open_object(const char *path, char *why, size_t n_why)
{
    void *object;
    const char *text;
    int error;

    errno = 0;
    object = dlopen(path, RTLD_NOW | RTLD_LOCAL);
    error = errno;
    if (object)
        return object;
    text = dlerror();
    snprintf(why, n_why, "%s%s", is_lack_of_memory(error, text) ? "not enough memory: " : "", text);
    return NULL;
}

/* Load the shared object at path. Returns false if the file does not exist, or if it cannot be
 * used; in the latter case, shim->why receives the reason. */
static bool load_object(struct search *s, const char *path)
{
    const void *table;
    void *object;

    if (access(path, R_OK) != 0)
        return false;
    s->shim->refused = false;
    if (ends_process(path)) {
        snprintf(s->shim->why, sizeof s->shim->why,
                 "its libraries need more memory than `ulimit -v` allows");
        return false;
    }
    object = open_object(path, s->shim->why, sizeof s->shim->why);
    if (!object)
        return false;
    table = dlsym(object, s->shim->symbol);
    if (!table || *(const int *)table != s->shim->abi) {
        snprintf(s->shim->why, sizeof s->shim->why, "'%.400s' belongs to another version of spin4d",
                 path);
        dlclose(object);
        return false;
    }
    s->table = table;
    return true;
}

/* Whether users other than root, the current user and the owner of the program's file can write to
 * path. The reason then also states what to do. */
static bool is_writable_by_others(struct search *s, const char *path)
{
    struct spin_shim *shim = s->shim;
    struct stat st;

    if (stat(path, &st) != 0)
        return false; /* a missing file is left to load_object() */
    if (st.st_mode & (S_IWGRP | S_IWOTH))
        snprintf(shim->why, sizeof shim->why,
                 "'%.350s' is writable by its group or by all users: remove these permissions with "
                 "chmod go-w",
                 path);
    else if (st.st_uid != 0 && st.st_uid != geteuid() && st.st_uid != s->owner)
        snprintf(shim->why, sizeof shim->why,
                 "'%.350s' belongs to user %lu, who is neither root, nor you, nor the owner of the "
                 "program: change its owner with chown",
                 path, (unsigned long)st.st_uid);
    else
        return false;
    shim->refused = true;
    return true;
}

/* Load the object from the folder parent/below, unless other users can write to the object or the
 * folder. */
static bool load_from(struct search *s, const char *parent, const char *below)
{
    char path[PATH_MAX + 64];

    snprintf(path, sizeof path, "%s/%s/%s", parent, below, s->shim->file);
    if (access(path, F_OK) != 0 || is_writable_by_others(s, path))
        return false;
    *strrchr(path, '/') = '\0';
    if (is_writable_by_others(s, path))
        return false;
    snprintf(path, sizeof path, "%s/%s/%s", parent, below, s->shim->file);
    return load_object(s, path);
}

/* Load the object from lib/ or lib/spin4d/ in the folder whose subfolder bin/ or tests/ROOM/
 * contains the program: the build folder, or the prefix of an installation. */
static bool load_beside_program(struct search *s)
{
    char folder[4096];
    struct stat st;
    char *bin, *tests;

    if (!spin_program_path(folder))
        return false;
    if (stat(folder, &st) == 0)
        s->owner = st.st_uid;
    *strrchr(folder, '/') = '\0';
    bin = strrchr(folder, '/');
    if (!bin)
        return false;
    *bin = '\0';
    tests = strrchr(folder, '/');
    if (strcmp(bin + 1, "bin") != 0) {
        if (!tests || strcmp(tests + 1, "tests") != 0)
            return false;
        *tests = '\0';
    }
    return load_from(s, folder, "lib") || load_from(s, folder, "lib/spin4d");
}

static const void *find_table(struct spin_shim *shim)
{
    struct search s = {.shim = shim};
    const char *given = getenv(shim->override);

    if (given && *given) {
        if (!load_object(&s, given) && !*shim->why)
            snprintf(shim->why, sizeof shim->why, "%s is '%.400s', which does not exist",
                     shim->override, given);
        return s.table;
    }
    if (!load_beside_program(&s))
        load_from(&s, SPIN_LIBDIR, "spin4d");
    return s.table;
}

/* Whether the text of a failure says that memory ran out. Texts with "static TLS" mention memory,
 * but refer to another limit. */
static bool says_no_memory(const char *why)
{
    return strstr(why, "memory") && !strstr(why, "static TLS");
}

static pthread_mutex_t mutex = PTHREAD_MUTEX_INITIALIZER;

spin_status spin_shim_load(struct spin_shim *shim, const void **table)
{
    bool found;

    pthread_mutex_lock(&mutex);
    if (!shim->tried) {
        *shim->why = '\0';
        *table = find_table(shim);
    }
    found = *table != NULL;
    shim->tried = found || !says_no_memory(shim->why);
    pthread_mutex_unlock(&mutex);
    if (found)
        return SPIN_OK;
    if (!shim->tried)
        return spin_fail(SPIN_E_MEMORY, "%s '%s' cannot be loaded for lack of memory: %s",
                         shim->lacking, shim->file, shim->why);
    if (shim->refused)
        return spin_unsupported("%s '%s' is refused: %s (see spin4d(7))", shim->lacking, shim->file,
                                shim->why);
    return spin_unsupported("%s '%s' is missing or cannot be loaded%s%s (" HINT ")", shim->lacking,
                            shim->file, *shim->why ? ": " : "", shim->why, shim->debian);
}

static void load_library(struct spin_library *library)
{
    const char *name = getenv(library->override);
    void *object = open_object(name ? name : library->file, library->why, sizeof library->why);

    for (const struct spin_library_function *f = library->function; object && f->name; f++) {
        *(void **)f->into = dlsym(object, f->name);
        if (!*(void **)f->into)
            snprintf(library->why, sizeof library->why, "it lacks the function %s", f->name);
    }
}

spin_status spin_library_load(struct spin_library *library)
{
    pthread_mutex_lock(&mutex);
    if (!library->tried) {
        *library->why = '\0';
        load_library(library);
    }
    library->tried = !says_no_memory(library->why);
    pthread_mutex_unlock(&mutex);
    if (!*library->why)
        return SPIN_OK;
    if (!library->tried)
        return spin_fail(SPIN_E_MEMORY,
                         "%s needs the library '%s': not enough memory to load it: %s",
                         library->user, library->file, library->why);
    return spin_unsupported("%s needs the library '%s': %s", library->user, library->file,
                            library->why);
}
