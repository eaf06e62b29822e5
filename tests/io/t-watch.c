/* A file that is cut while it is in use: the handler of SIGBUS reports one path as a whole while
 * another thread releases and takes the entry of that file. K: io watch threads signal */
#include <pthread.h>
#include <signal.h>
#include <stdatomic.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <unistd.h>

#include "io/file.h"
#include "tests/tap.h"

enum { ROUNDS = 150, LENGTH = 900 };

static char path[2][LENGTH + 1];
static unsigned char *data;
static struct stat st;

/* Releases the entry and takes it again, with the paths in turn. */
static void *change_entry(void *started)
{
    for (unsigned i = 0;; i++) {
        spin_watch_map(data, path[i % 2], &st);
        atomic_store((atomic_bool *)started, true);
        for (volatile int wait = 0; wait < 200; wait++) /* keep the entry as long as it is free */
            ;
        spin_unwatch_map(data);
    }
    return NULL;
}

/* Reads a page that its file no longer has. */
static void read_cut_file(int file, int report)
{
    atomic_bool started = false;
    pthread_t thread;

    (void)dup2(report, STDERR_FILENO);
    spin_catch_cut_files("t-watch");
    data = mmap(NULL, 4096, PROT_READ, MAP_SHARED, file, 0);
    if (data == MAP_FAILED || pthread_create(&thread, NULL, change_entry, &started) != 0 ||
        ftruncate(file, 0) != 0)
        _exit(3);
    while (!atomic_load(&started))
        ;
    _exit(2 + *(volatile unsigned char *)data);
}

/* Returns whether `text` is the report of one of the two paths, without a byte of the other. */
static bool is_whole(const char *text)
{
    char want[2 * LENGTH + 128];

    for (int i = 0; i < 2; i++) {
        snprintf(want, sizeof want,
                 "t-watch: cannot read '%s': it was cut short while it was in use, or the disk "
                 "failed\n",
                 path[i]);
        if (strcmp(text, want) == 0)
            return true;
    }
    return false;
}

/* Runs read_cut_file() in a child process. Returns 1 if it ended with a whole report, 0 if the
 * signal found no entry and ended it, -1 otherwise. */
static int try_once(void)
{
    char text[4096] = "";
    FILE *file = tmpfile();
    int pipes[2], how = 0;
    pid_t child;
    size_t n;

    if (!file || ftruncate(fileno(file), 4096) != 0 || fstat(fileno(file), &st) != 0 ||
        pipe(pipes) != 0 || (child = fork()) < 0)
        return -1;
    if (child == 0)
        read_cut_file(fileno(file), pipes[1]);
    close(pipes[1]);
    for (n = 0; n < sizeof text - 1;) {
        ssize_t got = read(pipes[0], text + n, sizeof text - 1 - n);

        if (got <= 0)
            break;
        n += (size_t)got;
    }
    close(pipes[0]);
    fclose(file);
    if (waitpid(child, &how, 0) != child)
        return -1;
    if (WIFSIGNALED(how))
        return WTERMSIG(how) == SIGBUS && n == 0 ? 0 : -1;
    return WEXITSTATUS(how) == 1 && is_whole(text) ? 1 : -1;
}

TAP_MAIN
{
    int n_reports = 0, n_wrong = 0;

    memset(path[0], 'a', LENGTH);
    memset(path[1], 'b', LENGTH);
    for (int i = 0; i < ROUNDS; i++) {
        int got = try_once();

        n_reports += got == 1;
        n_wrong += got < 0;
    }
    ok(n_wrong == 0, "in %d rounds no report mixes two paths (%d do)", ROUNDS, n_wrong);
    ok(n_reports > 0, "and %d rounds end with a report", n_reports);
}
