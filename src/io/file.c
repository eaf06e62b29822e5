/* Files: mapping, listing, parts of paths, and output files that are renamed when complete. */
#include "io/file.h"

#include <dirent.h>
#include <fcntl.h>
#include <pthread.h>
#include <signal.h>
#include <stdatomic.h>
#include <sys/mman.h>
#include <sys/statvfs.h>
#ifdef __linux__
#include <sys/vfs.h>
#endif
#include <time.h>
#include <unistd.h>
#include <zlib.h>

#include "base/base.h"

enum { OUT_BUFFER = 1 << 20 };

/* ---- Opening ------------------------------------------------------------------------------- */

static const char *error_text(int error)
{
    return error == ENOENT ? "no such file or folder"
           : error == EFAULT /* a system call read mapped bytes that were truncated */
               ? "an input file was cut short while it was in use"
               : strerror(error);
}

/* Fail with the message "cannot VERB 'PATH': REASON", where REASON describes the current value of
 * errno. */
static spin_status fail_errno(const char *verb, const char *path)
{
    int error = errno;
    spin_status code = error == ENOENT || error == ENOTDIR ? SPIN_E_NOT_FOUND
                       : error == ENOMEM                   ? SPIN_E_MEMORY
                                                           : SPIN_E_IO;

    return spin_fail(code, "cannot %s '%s': %s", verb, path, error_text(error));
}

/* Refuse a Git LFS pointer, the placeholder that Git leaves for a large file that was not fetched.
 */
static spin_status check_pointer(const struct spin_map *map, const char *path)
{
    static const char begin[] = "version https://git-lfs.github.com/spec/";

    if (map->size < sizeof begin - 1 || memcmp(map->data, begin, sizeof begin - 1) != 0)
        return SPIN_OK;
    return spin_unsupported("cannot read '%s': it is a Git LFS pointer; the file itself was never "
                            "fetched (git lfs pull)",
                            path);
}

/* Open a regular file for reading. Without O_NONBLOCK, opening a fifo would block. */
static spin_status open_file(const char *path, int *fd, struct stat *st)
{
    spin_status status;

    *fd = open(path, O_RDONLY | O_CLOEXEC | O_NONBLOCK);
    if (*fd < 0)
        return fail_errno("open", path);
    if (fstat(*fd, st) != 0)
        status = fail_errno("open", path);
    else if (S_ISDIR(st->st_mode))
        status = spin_fail(SPIN_E_IO, "cannot open '%s': it is a folder", path);
    else if (!S_ISREG(st->st_mode))
        status = spin_fail(SPIN_E_IO, "cannot open '%s': it is not an ordinary file", path);
    else
        return SPIN_OK;
    close(*fd);
    *fd = -1;
    return status;
}

spin_status spin_map_open(const char *path, struct spin_map *out)
{
    struct stat st;
    int fd;
    void *data;

    out->data = (const unsigned char *)"";
    out->size = 0;
    SPIN_TRY(open_file(path, &fd, &st));
    if (spin_inputs_add(&st) != SPIN_OK) {
        close(fd);
        return SPIN_E_MEMORY;
    }
    if (st.st_size > 0) {
        data = mmap(NULL, (size_t)st.st_size, PROT_READ, MAP_PRIVATE, fd, 0);
        if (data == MAP_FAILED) {
            spin_status status = fail_errno("map", path);

            close(fd);
            return status;
        }
        out->data = data;
        out->size = (size_t)st.st_size;
        spin_watch_map(data, path, &st);
    }
    close(fd);
    if (check_pointer(out, path) != SPIN_OK) {
        spin_map_close(out);
        return SPIN_E_UNSUPPORTED;
    }
    return SPIN_OK;
}

spin_status spin_map_check(const struct spin_map *map)
{
    return map->size > 0 ? spin_watch_check(map->data) : SPIN_OK;
}

void spin_map_close(struct spin_map *map)
{
    if (map->size > 0) {
        spin_unwatch_map(map->data);
        munmap((void *)(uintptr_t)map->data, map->size);
    }
    map->data = (const unsigned char *)"";
    map->size = 0;
}

/* Both ends of the range are rounded down to whole pages: bytes of the first page before the range
 * are reloaded on access, and bytes after the range, which sequential reads need next, stay mapped.
 */
void spin_map_release(const void *bytes, size_t n)
{
    uintptr_t page = (uintptr_t)sysconf(_SC_PAGESIZE);
    uintptr_t first = (uintptr_t)bytes / page * page, end = ((uintptr_t)bytes + n) / page * page;

    if (end > first)
        (void)madvise((void *)first, end - first, MADV_DONTNEED);
}

void spin_map_forget(const struct spin_map *map, const void *bytes, size_t n)
{
    uintptr_t base = (uintptr_t)map->data, first = (uintptr_t)bytes;

    if (map->size > 0 && first >= base && first + n <= base + map->size)
        spin_map_release(bytes, n);
}

uint32_t spin_crc32(uint32_t crc, const void *data, size_t n)
{
    return n > 0 ? (uint32_t)crc32_z(crc, data, n) : crc;
}

struct spin_digest spin_map_digest(const struct spin_map *map)
{
    return (struct spin_digest){map->size, spin_crc32(0, map->data, map->size)};
}

spin_status spin_file_head(const char *path, void *out, size_t n, size_t *n_out)
{
    spin_status status = SPIN_OK;
    struct stat st;
    int fd;

    *n_out = 0;
    SPIN_TRY(open_file(path, &fd, &st));
    while (*n_out < n) {
        ssize_t got = read(fd, (char *)out + *n_out, n - *n_out);

        if (got < 0 && errno == EINTR)
            continue;
        if (got < 0)
            status = fail_errno("read", path);
        if (got <= 0)
            break;
        *n_out += (size_t)got;
    }
    close(fd);
    return status;
}

/* ---- Parts of paths ------------------------------------------------------------------------- */

bool spin_path_exists(const char *path)
{
    struct stat st;

    return stat(path, &st) == 0;
}

bool spin_path_is_taken(const char *path)
{
    struct stat st;

    return lstat(path, &st) == 0;
}

bool spin_path_is_folder(const char *path)
{
    struct stat st;

    return stat(path, &st) == 0 && S_ISDIR(st.st_mode);
}

/* *out receives the concatenation of three texts, allocated. */
static spin_status concat_texts(const char *a, const char *b, const char *c, char **out)
{
    size_t na = strlen(a), nb = strlen(b), nc = strlen(c);
    void *text;

    *out = NULL;
    SPIN_TRY(spin_alloc(na + nb + nc + 1, 1, &text));
    memcpy(text, a, na);
    memcpy((char *)text + na, b, nb);
    memcpy((char *)text + na + nb, c, nc);
    *out = text;
    return SPIN_OK;
}

spin_status spin_path_join(const char *dir, const char *name, char **out)
{
    size_t n = strlen(dir);

    return concat_texts(dir, n > 0 && dir[n - 1] != '/' ? "/" : "", name, out);
}

spin_status spin_path_folder(const char *path, char **out)
{
    size_t n = strlen(path);

    while (n > 1 && path[n - 1] == '/') /* the folder of "a/b/" is "a" */
        n--;
    while (n > 0 && path[n - 1] != '/')
        n--;
    while (n > 1 && path[n - 1] == '/')
        n--;
    if (n == 0)
        return spin_strdup(".", out);
    *out = strndup(path, n);
    return *out ? SPIN_OK : spin_fail(SPIN_E_MEMORY, "not enough memory for %zu bytes", n + 1);
}

const char *spin_path_name(const char *path)
{
    const char *slash = strrchr(path, '/');

    return slash ? slash + 1 : path;
}

spin_status spin_path_absolute(const char *path, char **out)
{
    *out = realpath(path, NULL);
    /* In a browser, files are in a file system without links, where reading one fails with EPERM.
     */
    if (!*out && errno == EPERM && path[0] == '/' && access(path, F_OK) == 0)
        return spin_strdup(path, out);
    return *out ? SPIN_OK : fail_errno("find", path);
}

/* *out receives the path of `to` relative to `from`; both must be absolute and without links. The
 * result is "../" for each folder of `from` below the lowest folder that contains both, followed by
 * the part of `to` below that folder. *out is NULL if that folder is the root. */
static spin_status make_relative(const char *from, const char *to, char **out)
{
    size_t shared = 0, i = 0, ups = 0, n;
    const char *rest;
    void *text;

    *out = NULL;
    for (;; i++) {
        bool from_ends = from[i] == '/' || from[i] == '\0';
        bool to_ends = to[i] == '/' || to[i] == '\0';

        if (from_ends && to_ends)
            shared = i;
        if (from[i] != to[i] || from[i] == '\0')
            break;
    }
    if (shared == 0)
        return SPIN_OK;
    for (const char *p = from + shared; *p; p++)
        ups += *p == '/';
    rest = to[shared] == '/' ? to + shared + 1 : "";
    n = 3 * ups + strlen(rest) + 2;
    SPIN_TRY(spin_alloc(n, 1, &text));
    *out = text;
    for (i = 0; i < ups; i++)
        memcpy(*out + 3 * i, "../", 3);
    strcpy(*out + 3 * ups, rest);
    n = strlen(*out);
    if (n == 0)
        strcpy(*out, ".");
    else if ((*out)[n - 1] == '/')
        (*out)[n - 1] = '\0';
    return SPIN_OK;
}

spin_status spin_path_relative(const char *from, const char *to, char **out)
{
    SPIN_FREED char *from_real = NULL, *to_real = NULL;

    *out = NULL;
    SPIN_TRY(spin_path_absolute(from, &from_real));
    SPIN_TRY(spin_path_absolute(to, &to_real));
    SPIN_TRY(make_relative(from_real, to_real, out));
    if (!*out) {
        *out = to_real;
        to_real = NULL;
    }
    return SPIN_OK;
}

/* ---- Folders ------------------------------------------------------------------------------- */

static spin_status make_folder(const char *path)
{
    int error;

    if (mkdir(path, 0777) == 0)
        return SPIN_OK;
    error = errno;
    if (spin_path_is_folder(path))
        return SPIN_OK;
    if (error == EEXIST)
        return spin_fail(SPIN_E_IO, "cannot make folder '%s': a file has that name", path);
    errno = error;
    return fail_errno("make folder", path);
}

uint64_t spin_path_free_bytes(const char *path)
{
    struct statvfs fs;

    return statvfs(path, &fs) == 0 ? (uint64_t)fs.f_bavail * fs.f_frsize : UINT64_MAX;
}

bool spin_path_is_in_memory(const char *path)
{
#ifdef __linux__
    struct statfs fs;

    return statfs(path, &fs) == 0 && ((uint32_t)fs.f_type == 0x01021994u /* tmpfs */ ||
                                      (uint32_t)fs.f_type == 0x858458f6u /* ramfs */);
#else
    (void)path;
    return false;
#endif
}

bool spin_path_same_disk(const char *a, const char *b)
{
    struct stat of[2];

    return stat(a, &of[0]) == 0 && stat(b, &of[1]) == 0 && of[0].st_dev == of[1].st_dev;
}

spin_status spin_folder_make(const char *path)
{
    SPIN_FREED char *partial = NULL;
    spin_status status = SPIN_OK;

    if (!*path)
        return SPIN_OK;
    SPIN_TRY(spin_strdup(path, &partial));
    for (char *p = partial + 1; status == SPIN_OK && *p; p++) {
        if (*p != '/')
            continue;
        *p = '\0';
        status = make_folder(partial);
        *p = '/';
    }
    if (status == SPIN_OK)
        status = make_folder(partial);
    return status;
}

static int by_bytes(const void *a, const void *b)
{
    return strcmp(*(const char *const *)a, *(const char *const *)b);
}

/* Read all names of an open folder into a growing, NULL-terminated list. */
static spin_status read_names(DIR *dir, const char *path, char ***names, size_t *n)
{
    size_t capacity = 0;
    struct dirent *entry;

    for (;;) {
        SPIN_TRY(spin_array_grow(*n + 1, &capacity, sizeof **names, (void **)names));
        (*names)[*n] = NULL;
        errno = 0;
        entry = readdir(dir);
        if (!entry)
            return errno ? fail_errno("list folder", path) : SPIN_OK;
        if (strcmp(entry->d_name, ".") == 0 || strcmp(entry->d_name, "..") == 0)
            continue;
        SPIN_TRY(spin_strdup(entry->d_name, &(*names)[*n]));
        (*names)[++*n] = NULL;
    }
}

spin_status spin_folder_list(const char *path, char ***names, size_t *n)
{
    DIR *dir = opendir(path);
    spin_status status;

    *names = NULL;
    *n = 0;
    if (!dir)
        return fail_errno("list folder", path);
    status = read_names(dir, path, names, n);
    closedir(dir);
    if (status != SPIN_OK) {
        spin_folder_list_free(*names);
        *names = NULL;
        *n = 0;
        return status;
    }
    qsort(*names, *n, sizeof **names, by_bytes);
    return SPIN_OK;
}

void spin_folder_list_free(char **names)
{
    for (size_t i = 0; names && names[i]; i++)
        free(names[i]);
    free(names);
}

/* ---- Output files: written under a temporary name, then renamed ----------------------------- */

static spin_status fail_exists(const char *path)
{
    return spin_fail(SPIN_E_IO, "cannot write '%s': it exists; use --force to overwrite", path);
}

spin_status spin_out_check(const char *path, bool force)
{
    struct stat st;

    if (stat(path, &st) == 0) { /* if stat() fails, opening the file will report the error */
        if (S_ISDIR(st.st_mode))
            return spin_fail(SPIN_E_IO, "cannot write '%s': it is a folder", path);
        if (!S_ISREG(st.st_mode))
            return spin_fail(SPIN_E_IO, "cannot write '%s': it is not an ordinary file", path);
        if (spin_inputs_have(&st))
            return spin_fail(SPIN_E_IO, "cannot write '%s': it is an input; give another name",
                             path);
    }
    return force || !spin_path_is_taken(path) ? SPIN_OK : fail_exists(path);
}

static uint32_t hash_text(uint32_t hash, const char *text)
{
    return spin_crc32(hash, text, strlen(text));
}

static pthread_once_t pid_scope_once = PTHREAD_ONCE_INIT;
/* Identifies the scope in which this process's PID is valid: host, boot and PID namespace. */
static uint32_t pid_scope;

static void hash_pid_scope(void)
{
    char text[64] = "";
    struct stat st;
    FILE *file = fopen("/proc/sys/kernel/random/boot_id", "re");

    if (file && fgets(text, sizeof text, file))
        pid_scope = hash_text(pid_scope, text);
    if (file)
        fclose(file);
    if (stat("/proc/self/ns/pid", &st) == 0) {
        snprintf(text, sizeof text, "%llu", (unsigned long long)st.st_ino);
        pid_scope = hash_text(pid_scope, text);
    }
#ifndef _WIN32
    if (gethostname(text, sizeof text - 1) == 0)
        pid_scope = hash_text(pid_scope, text);
#endif
}

void spin_out_suffix(char suffix[SPIN_OUT_SUFFIX])
{
    static atomic_uint n;
    struct timespec now = {0};
    char text[96];

    pthread_once(&pid_scope_once, hash_pid_scope);
    clock_gettime(CLOCK_REALTIME, &now);
    snprintf(text, sizeof text, "%ld %lld %ld %u", (long)getpid(), (long long)now.tv_sec,
             (long)now.tv_nsec, atomic_fetch_add(&n, 1));
    snprintf(suffix, SPIN_OUT_SUFFIX, ".tmp.%ld.%08x%08x", (long)getpid(), (unsigned)pid_scope,
             (unsigned)hash_text(pid_scope, text));
}

/* Create a temporary file beside the path. Returns its descriptor, or -1 with errno set. */
static int open_temporary(const char *path, char *name, size_t n_name)
{
    const int flags = O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC | O_NOFOLLOW;
    char suffix[SPIN_OUT_SUFFIX];
    int fd = -1;

    for (int try = 0; try < 100 && fd < 0 && (try == 0 || errno == EEXIST); try++) {
        spin_out_suffix(suffix);
        snprintf(name, n_name, "%s%s", path, suffix);
        fd = open(name, flags, 0666);
    }
    return fd;
}

spin_status spin_out_open(const char *path, bool force, struct spin_out *out)
{
    size_t n;
    void *name;
    spin_status status;
    int fd;

    memset(out, 0, sizeof *out);
    SPIN_TRY(spin_out_check(path, force));
    out->force = force;
    n = strlen(path) + SPIN_OUT_SUFFIX;

    /* One block contains the temporary name and the buffer of stdio, since both are needed as long
     * as the stream is open. */
    SPIN_TRY(spin_alloc(n + OUT_BUFFER, 1, &name));
    out->temporary = name;
    SPIN_TRY_OUT(spin_strdup(path, &out->path));
    fd = open_temporary(path, out->temporary, n);
    if (fd >= 0)
        out->file = fdopen(fd, "w+b");
    if (!out->file) {
        status = fail_errno("write", path);
        if (fd >= 0) {
            close(fd);
            unlink(out->temporary);
        }
        goto out;
    }
    setvbuf(out->file, out->temporary + n, _IOFBF, OUT_BUFFER);
    spin_watch_out(out->temporary);
    return SPIN_OK;
out:
    free(out->path);
    free(out->temporary);
    memset(out, 0, sizeof *out);
    return status;
}

spin_status spin_out_write(struct spin_out *out, const void *data, size_t bytes)
{
    if (bytes > 0 && fwrite(data, 1, bytes, out->file) != bytes)
        return fail_errno("write", out->path);
    out->bytes += bytes;
    return SPIN_OK;
}

int spin_out_put(struct spin_out *out, uint64_t at, const void *data, size_t bytes)
{
    const unsigned char *from = data;

    while (bytes > 0) {
        ssize_t n = pwrite(fileno(out->file), from, bytes, (off_t)at);

        if (n < 0 && errno == EINTR)
            continue;
        if (n <= 0)
            return n < 0 ? errno : EIO;
        from += n;
        at += (uint64_t)n;
        bytes -= (size_t)n;
    }
    return 0;
}

spin_status spin_out_failed(const struct spin_out *out, int error)
{
    errno = error;
    return fail_errno("write", out->path);
}

spin_status spin_out_write_at(struct spin_out *out, uint64_t at, const void *data, size_t bytes)
{
    int error = spin_out_put(out, at, data, bytes);

    return error ? spin_out_failed(out, error) : SPIN_OK;
}

spin_status spin_out_length(struct spin_out *out, uint64_t *bytes)
{
    struct stat st;

    if (fflush(out->file) != 0 || fstat(fileno(out->file), &st) != 0)
        return fail_errno("write", out->path);
    *bytes = (uint64_t)st.st_size;
    return SPIN_OK;
}

static void forget_out(struct spin_out *out)
{
    if (out->temporary)
        spin_unwatch_out(out->temporary);
    free(out->path);
    free(out->temporary);
    memset(out, 0, sizeof *out);
}

/* Whether link() succeeded although it reported a failure, as can happen on NFS: the file then has
 * two names. */
static bool is_linked(const char *path)
{
    struct stat st;

    return lstat(path, &st) == 0 && st.st_nlink == 2;
}

/* Rename the file to its final name. Without `force`, link() does this, since it fails if the final
 * name exists. File systems without hard links need a separate check before rename(). */
static spin_status give_final_name(const struct spin_out *out)
{
    if (!out->force) {
        if (link(out->temporary, out->path) == 0 || is_linked(out->temporary)) {
            unlink(out->temporary);
            return SPIN_OK;
        }
        if (spin_path_is_taken(out->path))
            return fail_exists(out->path);
    }
    return rename(out->temporary, out->path) == 0 ? SPIN_OK : fail_errno("write", out->path);
}

/* Without out->sync, the data may still be in the system's cache, not on the disk, when this
 * returns. */
spin_status spin_out_commit(struct spin_out *out)
{
    spin_status status = SPIN_OK;

    if (ferror(out->file) || fflush(out->file) != 0 || (out->sync && fsync(fileno(out->file)) != 0))
        status = fail_errno("write", out->path);
    if (fclose(out->file) != 0 && status == SPIN_OK)
        status = fail_errno("write", out->path);
    out->file = NULL;
    if (status == SPIN_OK)
        status = give_final_name(out);
    if (status == SPIN_OK)
        spin_inputs_own(out->path);
    else
        unlink(out->temporary);
    forget_out(out);
    return status;
}

void spin_out_abandon(struct spin_out *out)
{
    if (out->file)
        fclose(out->file);
    if (out->temporary)
        unlink(out->temporary);
    forget_out(out);
}

spin_status spin_out_whole(const char *path, const void *data, size_t bytes, bool sync)
{
    SPIN_LEAVES(spin_out_abandon) struct spin_out out = {0};

    SPIN_TRY(spin_out_open(path, true, &out));
    out.sync = sync;
    SPIN_TRY(spin_out_write(&out, data, bytes));
    return spin_out_commit(&out);
}

/* The suffix of a temporary name, split into its parts. */
struct ending {
    const char *at; /* start of the suffix; NULL: the name has no such suffix */
    long pid;
    uint32_t pid_scope;
    /* The suffix contains pid_scope; earlier versions wrote suffixes without it: ".tmp.4711". */
    bool has_scope;
};

static struct ending find_ending(const char *entry)
{
    struct ending e = {0};
    char *end;

    for (const char *p = entry; (p = strstr(p, ".tmp.")) != NULL; p++) {
        const char *digits = p + strlen(".tmp.");
        unsigned long long rest;

        e.pid = strtol(digits, &end, 10);
        if (*digits < '1' || *digits > '9')
            continue;
        if (*end == '\0')
            e.at = p;
        if (*end != '.' || strspn(end + 1, "0123456789abcdef") != 16 || end[17] != '\0')
            continue;
        rest = strtoull(end + 1, NULL, 16);
        e.at = p;
        e.pid_scope = (uint32_t)(rest >> 32);
        e.has_scope = true;
        return e;
    }
    return e;
}

static bool is_idle(const char *path, time_t seconds)
{
    struct stat st;

    return lstat(path, &st) == 0 && st.st_mtime + seconds < time(NULL);
}

/* Whether the writer of a temporary file has ended. If the writer ran on another host or in another
 * container, only the time of its last write is known; the writer is then assumed to have ended
 * after an hour without writes, since an export may compute for many minutes between writes. A
 * writer on this host and in this container has ended if no process has its PID. If the name does
 * not identify host and container, the writer is assumed to have ended if no process on this host
 * has its PID and the file was not written for a minute. */
static bool writer_has_ended(const struct ending *e, const char *path)
{
    bool is_dead = kill((pid_t)e->pid, 0) != 0 && errno == ESRCH;

    pthread_once(&pid_scope_once, hash_pid_scope);
    return !e->has_scope               ? is_dead && is_idle(path, 60)
           : e->pid_scope == pid_scope ? is_dead
                                       : is_idle(path, 3600);
}

uint64_t spin_out_remove(const char *path)
{
    char **names = NULL, *entry = NULL;
    size_t n = 0;
    uint64_t bytes = 0;
    struct stat st;

    if (lstat(path, &st) != 0)
        return 0;
    if (!S_ISDIR(st.st_mode)) {
        unlink(path);
        return (uint64_t)st.st_size;
    }
    if (spin_folder_list(path, &names, &n) == SPIN_OK)
        for (size_t i = 0; i < n; i++)
            if (spin_path_join(path, names[i], &entry) == SPIN_OK) {
                bytes += spin_out_remove(entry);
                free(entry);
            }
    spin_folder_list_free(names);
    rmdir(path);
    return bytes;
}

/* Remove the temporary files and folders that killed writers of the output `name` left behind; if
 * `name` is NULL, those of all outputs with the extension `ending`. */
static void remove_stale(const char *folder, const char *name, const char *ending)
{
    char *entry = NULL, **names = NULL;
    size_t n = 0, n_ending = strlen(ending);

    if (spin_folder_list(folder, &names, &n) != SPIN_OK)
        return;
    for (size_t i = 0; i < n; i++) {
        const struct ending e = find_ending(names[i]);
        size_t n_before = e.at ? (size_t)(e.at - names[i]) : 0;

        if (!e.at || spin_path_join(folder, names[i], &entry) != SPIN_OK)
            continue;
        if (name ? strlen(name) == n_before && memcmp(names[i], name, n_before) == 0
                 : n_ending > 0 && n_before > n_ending &&
                       memcmp(e.at - n_ending, ending, n_ending) == 0)
            if (writer_has_ended(&e, entry))
                spin_out_remove(entry);
        free(entry);
    }
    spin_folder_list_free(names);
}

void spin_out_sweep(const char *path)
{
    SPIN_FREED char *folder = NULL, *file = NULL;

    if (spin_path_folder(path, &folder) != SPIN_OK || spin_strdup(path, &file) != SPIN_OK)
        return;
    for (size_t n = strlen(file); n > 1 && file[n - 1] == '/'; n--)
        file[n - 1] = '\0';
    remove_stale(folder, spin_path_name(file), "");
}

void spin_out_sweep_folder(const char *folder, const char *ending)
{
    remove_stale(folder, NULL, ending);
}
