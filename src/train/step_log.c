/* Writes the log. After a write error nothing more is written to it, but the training continues. */
#include "train/step_log.h"

#include <fcntl.h>
#include <unistd.h>

#include "base/base.h"
#include "io/file.h"

/* True for a character device, such as a terminal, to which the log may be written without --force.
 * False for a FIFO, which could block the training. */
static bool is_device(const char *path)
{
    struct stat st;

    return stat(path, &st) == 0 && S_ISCHR(st.st_mode);
}

/* True if the file is empty or begins with a line of this log, as log_step() and evaluate_clip() in
 * loop.c write them. */
static bool is_log(const char *path)
{
    static const char *const begin[] = {"{\"iteration\":", "{\"refine\":"};
    char head[16] = "";
    size_t n;

    if (spin_file_head(path, head, sizeof head - 1, &n) != SPIN_OK)
        return false;
    return n == 0 || strncmp(head, begin[0], strlen(begin[0])) == 0 ||
           strncmp(head, begin[1], strlen(begin[1])) == 0;
}

spin_status spin_step_log_open(struct spin_step_log *log, const char *path, bool append, bool force)
{
    int fd, flags = O_WRONLY | O_CREAT | O_CLOEXEC;

    log->path = path;
    if (!path)
        return SPIN_OK;
    append = append && spin_path_is_taken(path) && (!force || is_log(path));
    if (!is_device(path))
        SPIN_TRY(spin_out_check(path, append || force));
    if (append && !is_device(path) && !is_log(path))
        return spin_fail(
            SPIN_E_IO,
            "cannot append to '%s': it is not a log of spin-retrain; give another name, "
            "or --force to overwrite",
            path);
    pthread_mutex_init(&log->lock, NULL);
    flags |= append ? O_APPEND : force || is_device(path) ? O_TRUNC : O_EXCL;
    fd = open(path, flags, 0666);
    log->file = fd >= 0 ? fdopen(fd, append ? "a" : "w") : NULL;
    if (log->file)
        return SPIN_OK;
    (void)spin_fail(SPIN_E_IO, "cannot write the log '%s': %s", path, strerror(errno));
    if (fd >= 0)
        close(fd);
    return SPIN_E_IO;
}

static void check_write(struct spin_step_log *log, bool flush)
{
    if (!ferror(log->file) && (!flush || fflush(log->file) == 0))
        return;
    snprintf(log->error, sizeof log->error, "%s", strerror(errno ? errno : EIO));
    spin_warn("cannot write the log '%s': %s; the training goes on without it", log->path,
              log->error);
    fclose(log->file);
    log->file = NULL;
}

FILE *spin_step_log_begin(struct spin_step_log *log)
{
    if (!log->path)
        return NULL;
    pthread_mutex_lock(&log->lock);
    if (log->file)
        return log->file;
    pthread_mutex_unlock(&log->lock);
    return NULL;
}

void spin_step_log_end(struct spin_step_log *log, bool flush)
{
    check_write(log, flush);
    pthread_mutex_unlock(&log->lock);
}

void spin_step_log_close(struct spin_step_log *log)
{
    if (log->file)
        check_write(log, true);
    if (log->file && fclose(log->file) != 0)
        snprintf(log->error, sizeof log->error, "%s", strerror(errno));
    log->file = NULL;
}
