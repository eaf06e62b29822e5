/* Outputs, looked at and locked before long work. */
#include "io/output_lock.h"

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include "base/err.h"
#include "base/mem.h"

spin_status spin_output_check_file(const char *path, bool force)
{
    struct spin_out out;

    SPIN_TRY(spin_out_open(path, force, &out));
    spin_out_abandon(&out);
    spin_out_sweep(path);
    return SPIN_OK;
}

spin_status spin_output_check_folder(const char *path)
{
    SPIN_TRY(spin_folder_make(path));
    if (access(path, W_OK | X_OK) == 0)
        return SPIN_OK;
    return spin_fail(SPIN_E_IO, "cannot write to folder '%s': %s", path, strerror(errno));
}

spin_status spin_output_check_empty_folder(const char *path, bool force)
{
    char **names = NULL;
    size_t n = 0;

    if (spin_path_is_folder(path)) {
        SPIN_TRY(spin_folder_list(path, &names, &n));
        spin_folder_list_free(names);
    }
    if (n > 0 && !force)
        return spin_fail(SPIN_E_IO, "folder '%s' exists and is not empty; use --force to overwrite",
                         path);
    return spin_output_check_folder(path);
}

/* ---- The lock ------------------------------------------------------------------------------ */

/* The file that is open still has this name: its holder has not removed it meanwhile. */
static bool is_named(int fd, const char *path)
{
    struct stat ours, there;

    return fstat(fd, &ours) == 0 && stat(path, &there) == 0 && ours.st_dev == there.st_dev &&
           ours.st_ino == there.st_ino;
}

enum lock { HELD, TAKEN, GONE, NO_LOCKS, NO_FILE };

/* GONE: the file was removed meanwhile, try again. NO_FILE: errno says why. fd is open after HELD and
 * NO_LOCKS. */
static enum lock try_lock(const char *path, int *fd)
{
    enum lock got = HELD;

    *fd = open(path, O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0666);
    if (*fd < 0)
        return NO_FILE;
    if (flock(*fd, LOCK_EX | LOCK_NB) != 0)
        got = errno == EWOULDBLOCK ? TAKEN : NO_LOCKS;
    else if (!is_named(*fd, path))
        got = GONE;
    if (got == TAKEN || got == GONE)
        close(*fd);
    return got;
}

spin_status spin_output_lock_take(const char *output, struct spin_output_lock *out)
{
    size_t n = strlen(output) + sizeof ".lock";
    void *block = NULL;
    enum lock got;

    *out = (struct spin_output_lock){.fd = -1};
    SPIN_TRY(spin_alloc(n, 1, &block));
    out->path = block;
    snprintf(out->path, n, "%s.lock", output);
    do
        got = try_lock(out->path, &out->fd);
    while (got == GONE);
    if (got == NO_LOCKS)
        spin_warn("there are no locks where '%s' lies: see to it that no other run writes it",
                  output);
    if (got == HELD || got == NO_LOCKS)
        return SPIN_OK;
    out->path = NULL;
    if (got == TAKEN)
        (void)spin_fail(SPIN_E_IO, "'%s' is being written by another run, which holds '%s.lock'",
                        output, output);
    else
        (void)spin_fail(SPIN_E_IO, "cannot write '%s': %s", output,
                        errno == ENOENT ? "no such file or folder" : strerror(errno));
    free(block);
    return SPIN_E_IO;
}

/* Removed while it is still held: who opened it before sees that its name is gone. A file with bytes in
 * it is somebody else's. */
void spin_output_lock_drop(struct spin_output_lock *lock)
{
    struct stat st;

    if (!lock->path)
        return;
    if (fstat(lock->fd, &st) == 0 && st.st_size == 0)
        unlink(lock->path);
    close(lock->fd);
    free(lock->path);
    *lock = (struct spin_output_lock){.fd = -1};
}
