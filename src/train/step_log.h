/* The log of a training (--log): a JSON object a line. */
#pragma once

#include <pthread.h>

#include "spin.h"

struct spin_step_log {
    const char *path;
    FILE *file;     /* NULL: none is written, or no longer */
    char error[96]; /* why no longer */
    pthread_mutex_t lock;
};

/* path NULL: none is written. append: to a log that is there, as a resume does; another file is
 * replaced only with force, an input never. */
spin_status spin_step_log_open(struct spin_step_log *log, const char *path, bool append,
                               bool force);
/* The file for a line of this thread, which must end it; or NULL: none is written. */
FILE *spin_step_log_begin(struct spin_step_log *log);
/* After the line, and with flush at once. A log that cannot be written ends here, with a warning:
 * the training goes on. */
void spin_step_log_end(struct spin_step_log *log, bool flush);
/* log->error says what was not written; empty: all was. */
void spin_step_log_close(struct spin_step_log *log);
