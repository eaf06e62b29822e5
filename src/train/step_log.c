/* Lines to a file, and what becomes of the file. */
#include "train/step_log.h"

#include <errno.h>
#include <string.h>

#include "base/err.h"
#include "base/log.h"

spin_status spin_step_log_open(struct spin_step_log *log, const char *path, bool append)
{
    log->path = path;
    if (!path)
        return SPIN_OK;
    log->file = fopen(path, append ? "a" : "w");
    if (!log->file)
        return spin_fail(SPIN_E_IO, "cannot write the log '%s': %s", path, strerror(errno));
    return SPIN_OK;
}

void spin_step_log_check(struct spin_step_log *log, bool flush)
{
    if (!ferror(log->file) && (!flush || fflush(log->file) == 0))
        return;
    snprintf(log->error, sizeof log->error, "%s", strerror(errno ? errno : EIO));
    spin_warn("cannot write the log '%s': %s; the work goes on without it", log->path, log->error);
    fclose(log->file);
    log->file = NULL;
}

void spin_step_log_close(struct spin_step_log *log)
{
    if (log->file)
        spin_step_log_check(log, true);
    if (log->file && fclose(log->file) != 0)
        snprintf(log->error, sizeof log->error, "%s", strerror(errno));
    log->file = NULL;
}
