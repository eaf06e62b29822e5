/* Words for the person at the terminal. All of it goes to stderr. */
#pragma once

#include "base/err.h"

/* -1 quiet (warnings only), 0 normal, 1 per run, 2 per frame, 3 per step, 4 per op. */
void spin_log_set_level(int level);
int spin_log_level(void);

/* One line when level <= the set level. Clears a progress line first. */
void spin_log(int level, const char *fmt, ...) SPIN_PRINTF(2, 3);
/* spin_warn() is in spin.h: plug-ins warn too. */

/* Warnings go to the sink first, without "warning: ", and to stderr when it returns true. NULL:
 * none. */
void spin_log_set_sink(bool (*sink)(const char *line));

/* Progress with rate and time left:
 *     retraining  1234/40000  3.1%  4.12 it/s  2:36:12 left  loss 0.0312
 * On a terminal one line that is written anew, at most six times a second; elsewhere a line of its
 * own every SPIN_PROGRESS seconds (60; 0: none), the first one after that time. Nothing below level
 * 0. begin; set as often as wanted; end clears the terminal's line. `from` is where counting starts
 * (resume). */
struct spin_progress {
    const char *what, *unit;
    double start_s, shown_s;
    double period_s; /* 0: nothing is shown */
    long long from, total;
    struct {
        double s;
        long long done;
    } past[2]; /* where it stood two times, 10 seconds or more apart; s 0: not yet */
    bool terminal;
};
void spin_progress_begin(struct spin_progress *p, const char *what, const char *unit,
                         long long from, long long total);
void spin_progress_set(struct spin_progress *p, long long done, const char *fmt, ...)
    SPIN_PRINTF(3, 4);
void spin_progress_end(struct spin_progress *p);

/* Seconds on a clock that only goes forward. */
double spin_now_s(void);
