/* The log of a training (--log): one JSON object per line. */
#pragma once

#include <pthread.h>

#include "spin.h"

struct spin_step_log {
    const char *path;
    FILE *file;     /* NULL if there is no log or if writing it has failed */
    char error[96]; /* message of the first write error; empty if there was none */
    pthread_mutex_t lock;
};

/* Opens the log; with path NULL there is no log. append: continues an existing log, as a resume
 * does. Without append, an existing file is replaced only if `force` is true, and never if it is an
 * input of the run. */
spin_status spin_step_log_open(struct spin_step_log *log, const char *path, bool append,
                               bool force);
/* Locks the log and returns its file. The caller writes one line to the file and then calls
 * spin_step_log_end(). If there is no log, it returns NULL without locking, and the caller must not
 * call spin_step_log_end(). */
FILE *spin_step_log_begin(struct spin_step_log *log);
/* Unlocks the log. With flush, the line is written to disk immediately, otherwise when the buffer
 * is full. After a write error it prints a warning and writes nothing more to the log; the training
 * continues. */
void spin_step_log_end(struct spin_step_log *log, bool flush);
/* Closes the log. Afterwards log->error contains the first write error, or is empty. */
void spin_step_log_close(struct spin_step_log *log);
