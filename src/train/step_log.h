/* The log of a training (--log): one JSON object per line. */
#pragma once

#include <pthread.h>

#include "spin.h"

struct spin_step_log {
    const char *path;
    FILE *file;     /* NULL: no log, or writing failed */
    char error[96]; /* why writing failed */
    pthread_mutex_t lock;
};

/* Opens the log. path NULL: no log. append: continue an existing log, as a resume does. Other
 * existing files are replaced only with force, inputs never. */
spin_status spin_step_log_open(struct spin_step_log *log, const char *path, bool append,
                               bool force);
/* Locks the log for this thread, which writes one line and calls spin_step_log_end(). Returns NULL,
 * without locking, if there is no log. */
FILE *spin_step_log_begin(struct spin_step_log *log);
/* Unlocks the log. flush: write the line to the file now. A write error ends the log with a
 * warning, and the training continues. */
void spin_step_log_end(struct spin_step_log *log, bool flush);
/* Closes the log. Afterwards log->error contains the first write error, or is empty. */
void spin_step_log_close(struct spin_step_log *log);
