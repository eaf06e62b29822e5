/* Log lines, warnings and progress, all on stderr. */
#pragma once

#include "base/err.h"

/* Set how much spin_log() prints. -1: nothing, so that only warnings appear; 0: normal output; 1:
 * also details of the command's work; 2: also lines for each frame; 3: also lines for each
 * iteration; 4: also lines for each operation. */
void spin_log_set_level(int level);
int spin_log_level(void);

/* Print one line if `level` is at most the level that was set. A visible progress line is erased
 * first. */
void spin_log(int level, const char *fmt, ...) SPIN_PRINTF(2, 3);
/* spin_warn(), which prints warnings, is declared in spin.h, since plug-ins use it too. */

/* Install a filter for warnings; NULL removes it. The filter receives each warning, without
 * "warning: ", and returns whether to print the warning on stderr. */
void spin_log_set_sink(bool (*sink)(const char *line));

/* Progress with rate and time left:
 *     retraining  1234/40000  3.1%  4.12 it/s  2:36:12 left  loss 0.0312
 * If stderr is a terminal, this line is rewritten at most six times a second. Otherwise a new line
 * is printed every SPIN_PROGRESS seconds, the first one after that time. (SPIN_PROGRESS is an
 * environment variable, by default 60; 0 means that no line is printed.) If the log level is below
 * 0, nothing is shown. Call spin_progress_begin(), then spin_progress_set() any number of times,
 * then spin_progress_end(), which erases the line from a terminal. `from`: the number of units that
 * were done before spin_progress_begin(), above 0 if an earlier run is resumed. */
struct spin_progress {
    const char *what, *unit;
    double start_s, shown_s;
    double period_s; /* minimum time between two lines; 0: show nothing */
    long long from, total;
    struct {
        double s;
        long long done;
        /* Two earlier states, at least 10 s apart, from which the rate is computed. s is 0 in a
         * state that is not set yet. */
    } past[2];
    bool terminal;
};
void spin_progress_begin(struct spin_progress *p, const char *what, const char *unit,
                         long long from, long long total);
void spin_progress_set(struct spin_progress *p, long long done, const char *fmt, ...)
    SPIN_PRINTF(3, 4);
void spin_progress_end(struct spin_progress *p);

/* Returns the time of a monotonic clock in seconds. */
double spin_now_s(void);
