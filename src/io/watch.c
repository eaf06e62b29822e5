/* Reading a mapped page that was truncated from its file raises SIGBUS. No thread can continue
 * after that: the handler reports the file, removes partial output and ends the process. The
 * handler takes no locks, because the thread that raised the signal may hold them. */
#include <pthread.h>
#include <signal.h>
#include <stdatomic.h>
#include <unistd.h>

#include "base/base.h"
#include "io/file.h"

/* Entries beyond these limits are not watched. */
enum { MAPS = 256, OUTS = 64 };

/* The handler may read a path while another thread releases the entry. Therefore paths are stored
 * in the entries, and never freed. */
static struct {
    /* Start of the map, set after the other members; NULL: the entry is free. */
    _Atomic(const unsigned char *) data;
    char path[PATH_MAX];
    struct stat st;
} maps[MAPS];
static struct {
    /* The caller's pointer, set after `path`; NULL: the entry is free. */
    _Atomic(const char *) given;
    char path[PATH_MAX];
} outs[OUTS];
static pthread_mutex_t mutex = PTHREAD_MUTEX_INITIALIZER; /* protects writes to maps and outs */
static atomic_bool dying;
static char name[64]; /* name of the command, for the message */

/* Acquire the mutex in order to write a path. Blocks forever once the handler runs, since the
 * handler may be about to remove the file with the entry's old path. */
static void lock_entries(void)
{
    pthread_mutex_lock(&mutex);
    while (atomic_load(&dying))
        pause();
}

void spin_watch_map(const void *data, const char *path, const struct stat *st)
{
    if (strlen(path) >= PATH_MAX)
        return;
    lock_entries();
    for (int i = 0; i < MAPS; i++) {
        if (atomic_load(&maps[i].data))
            continue;
        strcpy(maps[i].path, path);
        maps[i].st = *st;
        atomic_store(&maps[i].data, data);
        break;
    }
    pthread_mutex_unlock(&mutex);
}

static int find_map(const void *data)
{
    for (int i = 0; i < MAPS; i++) {
        if (atomic_load(&maps[i].data) == (const unsigned char *)data)
            return i;
    }
    return -1;
}

void spin_unwatch_map(const void *data)
{
    int i;

    pthread_mutex_lock(&mutex);
    i = find_map(data);
    if (i >= 0)
        atomic_store(&maps[i].data, NULL);
    pthread_mutex_unlock(&mutex);
}

spin_status spin_watch_check(const void *data)
{
    struct stat now;
    spin_status status = SPIN_OK;
    int i;

    pthread_mutex_lock(&mutex);
    i = find_map(data);
    if (i >= 0 && stat(maps[i].path, &now) == 0 && now.st_dev == maps[i].st.st_dev &&
        now.st_ino == maps[i].st.st_ino) {
        const struct stat *then = &maps[i].st;

        if (now.st_size < then->st_size)
            status = spin_fail(SPIN_E_IO, "cannot read '%s': it was cut short while it was in use",
                               maps[i].path);
        else if (now.st_size > then->st_size || now.st_mtim.tv_sec != then->st_mtim.tv_sec ||
                 now.st_mtim.tv_nsec != then->st_mtim.tv_nsec)
            status = spin_fail(SPIN_E_IO, "cannot read '%s': it was changed while it was in use",
                               maps[i].path);
    }
    pthread_mutex_unlock(&mutex);
    return status;
}

void spin_watch_out(const char *path)
{
    if (strlen(path) >= PATH_MAX)
        return;
    lock_entries();
    for (int i = 0; i < OUTS; i++) {
        if (atomic_load(&outs[i].given))
            continue;
        strcpy(outs[i].path, path);
        atomic_store(&outs[i].given, path);
        break;
    }
    pthread_mutex_unlock(&mutex);
}

void spin_unwatch_out(const char *path)
{
    for (int i = 0; i < OUTS; i++) {
        const char *same = path;

        if (atomic_compare_exchange_strong(&outs[i].given, &same, NULL))
            return;
    }
}

/* ---- The signal handler --------------------------------------------------------------------- */

struct line {
    char text[1024];
    size_t n;
};

static void append_text(struct line *line, const char *text)
{
    for (; *text && line->n < sizeof line->text; text++)
        line->text[line->n++] = *(const unsigned char *)text < 0x20 || *text == 0x7f ? '?' : *text;
}

static void report_cut_file(const char *path)
{
    struct line line = {{0}, 0};
    ssize_t n;

    append_text(&line, name);
    append_text(&line, ": cannot read '");
    append_text(&line, path);
    append_text(&line, "': it was cut short while it was in use, or the disk failed");
    line.text[line.n < sizeof line.text ? line.n++ : line.n - 1] = '\n';
    if (isatty(STDERR_FILENO))
        n = write(STDERR_FILENO, "\r\033[K", 4); /* erase the progress line */
    n = write(STDERR_FILENO, line.text, line.n);
    (void)n;
}

static void remove_outs(void)
{
    /* The folders are empty only after their files are removed. */
    for (int pass = 0; pass < 2; pass++) {
        for (int i = 0; i < OUTS; i++) {
            if (atomic_load(&outs[i].given))
                (void)(pass ? rmdir(outs[i].path) : unlink(outs[i].path));
        }
    }
}

static void on_bus(int number, siginfo_t *info, void *context)
{
    uintptr_t at = (uintptr_t)info->si_addr;

    (void)context;
    for (int i = 0; i < MAPS; i++) {
        uintptr_t first = (uintptr_t)atomic_load(&maps[i].data);

        if (!first || at < first || at - first >= (uintptr_t)maps[i].st.st_size)
            continue;
        /* Wait if another thread already runs the rest of this handler. */
        while (atomic_exchange(&dying, true))
            pause();
        /* From here on, no thread writes a path of an entry that is in use. Check again that this
         * entry is in use, since another thread may have released it before `dying` was set. */
        if ((uintptr_t)atomic_load(&maps[i].data) != first)
            continue;
        report_cut_file(maps[i].path);
        remove_outs();
        _exit(1);
    }
    /* The address is in no watched map. After the return, the access is repeated, and the default
     * action ends the process. */
    signal(number, SIG_DFL);
}

void spin_catch_cut_files(const char *command)
{
    struct sigaction action = {.sa_sigaction = on_bus, .sa_flags = SA_SIGINFO};

    strncpy(name, command, sizeof name - 1);
    sigemptyset(&action.sa_mask);
    sigaction(SIGBUS, &action, NULL);
}
