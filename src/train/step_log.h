/* The log of a training (--log): a JSON object a line. */
#pragma once

#include <pthread.h>

#include "spin.h"

struct spin_step_log {
    const char *path;
    FILE *file;     /* NULL: no log, or writing failed */
    char error[96]; /* why writing failed */
    pthread_mutex_t lock;
};

/* path NULL: no log. append: to an existing log, as a resume does. Other files are replaced only
 * with force, and inputs never. */
spin_status spin_step_log_open(struct spin_step_log *log, const char *path, bool append,
                               bool force);
/* Locks the log for a line of this thread, until spin_step_log_end(). NULL: no log, and nothing is
 * locked. */
FILE *spin_step_log_begin(struct spin_step_log *log);
/* Call it after the line; flush: writes it out now. If writing fails the log ends with a warning,
 * and the training goes on. */
void spin_step_log_end(struct spin_step_log *log, bool flush);
/* log->error says why lines are missing; empty: none are. */
void spin_step_log_close(struct spin_step_log *log);
