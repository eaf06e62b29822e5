/* Log lines, warnings and progress, all on stderr. */
#pragma once

#include "base/err.h"

/* Levels: -1 quiet (warnings only), 0 normal, 1 lines per run, 2 per frame, 3 per iteration, 4 per
 * operation. */
void spin_log_set_level(int level);
int spin_log_level(void);

/* Print one line if `level` is at most the level set. Erases a progress line first. */
void spin_log(int level, const char *fmt, ...) SPIN_PRINTF(2, 3);
/* spin.h declares spin_warn(), since plug-ins warn too. */

/* Install a filter for warnings, or NULL for none: it receives each line without "warning: ", and
 * returns whether stderr shows it. */
void spin_log_set_sink(bool (*sink)(const char *line));

/* Progress with rate and time left:
 *     retraining  1234/40000  3.1%  4.12 it/s  2:36:12 left  loss 0.0312
 * On a terminal, one line is rewritten at most six times a second; elsewhere a line is printed
 * every SPIN_PROGRESS seconds (default 60; 0: never), first after this time. Levels below 0 show
 * nothing. Call begin, then set any number of times, then end, which erases the terminal's line.
 * `from`: the value at the begin, above 0 after a resume. */
struct spin_progress {
    const char *what, *unit;
    double start_s, shown_s;
    double period_s; /* 0: show nothing */
    long long from, total;
    struct {
        double s;
        long long done;
    } past[2]; /* two earlier states, at least 10 s apart, for the rate; s is 0 if not set yet */
    bool terminal;
};
void spin_progress_begin(struct spin_progress *p, const char *what, const char *unit,
                         long long from, long long total);
void spin_progress_set(struct spin_progress *p, long long done, const char *fmt, ...)
    SPIN_PRINTF(3, 4);
void spin_progress_end(struct spin_progress *p);

/* Seconds on a monotonic clock. */
double spin_now_s(void);
