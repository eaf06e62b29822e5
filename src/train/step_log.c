/* Lines to a file, and what becomes of the file. */
#include "train/step_log.h"

#include "base/base.h"

spin_status spin_step_log_open(struct spin_step_log *log, const char *path, bool append)
{
    log->path = path;
    if (!path)
        return SPIN_OK;
    pthread_mutex_init(&log->lock, NULL);
    log->file = fopen(path, append ? "a" : "w");
    if (!log->file)
        return spin_fail(SPIN_E_IO, "cannot write the log '%s': %s", path, strerror(errno));
    return SPIN_OK;
}

static void check(struct spin_step_log *log, bool flush)
{
    if (!ferror(log->file) && (!flush || fflush(log->file) == 0))
        return;
    snprintf(log->error, sizeof log->error, "%s", strerror(errno ? errno : EIO));
    spin_warn("cannot write the log '%s': %s; the work goes on without it", log->path, log->error);
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
    check(log, flush);
    pthread_mutex_unlock(&log->lock);
}

void spin_step_log_close(struct spin_step_log *log)
{
    if (log->file)
        check(log, true);
    if (log->file && fclose(log->file) != 0)
        snprintf(log->error, sizeof log->error, "%s", strerror(errno));
    log->file = NULL;
}
