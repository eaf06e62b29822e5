/* The POSIX functions that spin4d calls, for the build with MinGW: src/packaging/windows.sh
 * includes this header before every source, and provides empty files for system headers that
 * Windows lacks. File names are UTF-8, with slashes in arguments and results. Files are binary.
 * Comments describe where a function does less than POSIX requires. */
#ifndef SPIN_BASE_WINDOWS_POSIX_H
#define SPIN_BASE_WINDOWS_POSIX_H

/* Include these headers before the macros below redefine the names of their functions. */
#include <direct.h>
#include <errno.h>
#include <fcntl.h>
#include <io.h>
#include <malloc.h>
#include <process.h>
#include <pthread.h>
#include <sched.h>
#include <signal.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <time.h>
#include <unistd.h>

/* ---- Files ---------------------------------------------------------------------------------- */

#undef stat
#undef fstat
#undef st_mtime
#undef pthread_sigmask

typedef int uid_t;
struct posix_stat {
    uint64_t st_dev, st_ino, st_size;
    /* The permissions in st_mode depend only on the file attribute "read only"; access control
     * lists are ignored. */
    unsigned st_mode, st_nlink;
    uid_t st_uid; /* always 0 */
    struct timespec st_mtim;
};
#define st_mtime st_mtim.tv_sec
#define O_CLOEXEC 0
#define O_NONBLOCK 0
#define O_NOFOLLOW 0

int posix_stat(const char *path, struct posix_stat *out);
int posix_lstat(const char *path, struct posix_stat *out);
int posix_fstat(int fd, struct posix_stat *out);
int posix_open(const char *path, int flags, ...); /* files can be removed while they are open */
int posix_access(const char *path, int mode);
int posix_unlink(const char *path);
int posix_rmdir(const char *path);
int posix_mkdir(const char *path, int mode);
int posix_rename(const char *from, const char *to);
int posix_link(const char *from, const char *to);
char *posix_realpath(const char *path, char *none);
/* Only "/proc/self/exe" is supported. */
ssize_t posix_readlink(const char *path, char *out, size_t n);
ssize_t posix_pwrite(int fd, const void *data, size_t n, int64_t at);
int posix_flock(int fd, int how);
FILE *posix_fopen(const char *path, const char *mode);
FILE *posix_open_memstream(char **text, size_t *n); /* fclose() sets *text */
FILE *posix_fmemopen(void *text, size_t n,
                     const char *mode); /* fclose() writes to `text`; the mode must be "w" */
int posix_fclose(FILE *file);
#define stat posix_stat
#define lstat posix_lstat
#define fstat posix_fstat
#define open posix_open
#define access posix_access
#define unlink posix_unlink
#define rmdir posix_rmdir
#define mkdir posix_mkdir
#define rename posix_rename
#define link posix_link
#define realpath posix_realpath
#define readlink posix_readlink
#define pwrite posix_pwrite
#define flock posix_flock
#define fsync _commit
#define fopen posix_fopen
#define open_memstream posix_open_memstream
#define fmemopen posix_fmemopen
#define fclose posix_fclose
#define ftell _ftelli64
#define flockfile _lock_file
#define funlockfile _unlock_file
enum { LOCK_EX = 2, LOCK_NB = 4 };

struct dirent {
    char d_name[3 * 260 + 1];
};
typedef struct posix_dir DIR;
DIR *posix_opendir(const char *path);
struct dirent *posix_readdir(DIR *dir);
int posix_closedir(DIR *dir);
#define opendir posix_opendir
#define readdir posix_readdir
#define closedir posix_closedir

struct statvfs {
    uint64_t f_bavail, f_frsize;
};
int statvfs(const char *folder, struct statvfs *out);

/* ---- Memory and processors ------------------------------------------------------------------ */

enum { PROT_READ = 1, PROT_WRITE = 2, MAP_PRIVATE = 2, MAP_ANONYMOUS = 32, MADV_DONTNEED = 4 };
#define MAP_FAILED ((void *)-1)
/* Maps anonymous memory for reading and writing, or a file for reading only. */
void *mmap(void *none, size_t n, int protection, int flags, int fd, int64_t zero);
int munmap(void *at, size_t n); /* a file can only be unmapped as a whole */
int madvise(void *at, size_t n, int advice);
/* Free the block with SPIN_ALIGNED_FREE() of base/mem.h. */
#define aligned_alloc(alignment, n) _aligned_malloc(n, alignment)

enum { _SC_PAGESIZE, _SC_AVPHYS_PAGES, _SC_NPROCESSORS_ONLN };
long long sysconf(int name);
typedef uint64_t cpu_set_t;
int sched_getaffinity(int self, size_t n, cpu_set_t *out);
#define CPU_COUNT(set) __builtin_popcountll(*(set))

struct rusage {
    long long ru_maxrss; /* peak memory of the process, in KiB */
};
enum { RUSAGE_SELF };
int getrusage(int self, struct rusage *out);
/* Windows has none of the limits below: getrlimit() and setrlimit() always fail. */
struct rlimit {
    uint64_t rlim_cur, rlim_max;
};
enum { RLIMIT_AS, RLIMIT_DATA, RLIMIT_CORE };
#define RLIM_INFINITY UINT64_MAX
#define getrlimit(which, out) ((void)(out), -1)
#define setrlimit(which, in) ((void)(in), -1)

/* ---- Processes, signals, libraries ---------------------------------------------------------- */

#define fork() (errno = ENOSYS, -1) /* always fails */
#define waitpid(child, how, flags) ((void)(how), -1)
#define WIFSIGNALED(how) ((how) != 0)
#define geteuid() 0
int posix_kill(pid_t pid, int zero);
/* Runs the program as a child process, waits for it and exits with its exit code. */
intptr_t posix_execv(const char *path, char *const *argv);
#define kill posix_kill
#define execv posix_execv
#define execvp posix_execv /* does not search PATH: all callers pass an existing path */

/* SIGINT is raised by Ctrl-C, SIGTERM by Ctrl-Break, and SIGBUS by an in-page error of a mapped
 * file. */
enum { SIGHUP = 101, SIGBUS, SIGPIPE, SIGXFSZ, SA_SIGINFO = 1, SA_RESTART };
typedef struct {
    void *si_addr;
} siginfo_t;
typedef int posix_sigset;
struct sigaction {
    void (*sa_handler)(int number);
    void (*sa_sigaction)(int number, siginfo_t *info, void *context);
    int sa_flags;
    posix_sigset sa_mask;
};
int sigaction(int number, const struct sigaction *in, struct sigaction *none);
#define sigset_t posix_sigset
#define sigemptyset(set) ((void)(*(set) = 0))
#define sigfillset(set) ((void)(*(set) = 1))
#define sigdelset(set, number) ((void)(set))
#define pthread_sigmask(how, set, old) ((void)(set), (void)(old))
#define signal posix_signal
/* Does nothing, and returns SIG_DFL. No signals other than SIGINT, SIGTERM and SIGBUS occur. */
void (*posix_signal(int number, void (*how)(int)))(int);
int pause(void);

enum { RTLD_NOW = 2, RTLD_LOCAL = 0 };
/* For "libzstd.so.1", loads libzstd.dll beside the program. */
void *dlopen(const char *path, int flags);
void *dlsym(void *object, const char *name);
int dlclose(void *object);
const char *dlerror(void);

/* ---- Text ----------------------------------------------------------------------------------- */

char *strndup(const char *text, size_t n);
char *strsep(char **rest, const char *ends);
void *memmem(const void *in, size_t n, const void *what, size_t n_what);

/* The actual main() is in main.c: it converts the arguments to UTF-8 with slashes. */
#define main posix_main
int posix_main(int argc, char **argv);

#endif
