/* Log lines and the progress line, all on stderr. */
#include "base/log.h"

#include <pthread.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "base/text.h"

static atomic_int log_level;
/* Whether a progress line is visible; it must then be erased before other output. */
static atomic_int line_shown;

static const double terminal_period_s = 1.0 / 6.0, plain_period_s = 60, window_s = 10;
static const char erase_line[] = "\r\033[K";

void spin_log_set_level(int level) { atomic_store(&log_level, level); }

int spin_log_level(void) { return atomic_load(&log_level); }

double spin_now_s(void)
{
    struct timespec t;

    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void write_line(const char *prefix, const char *fmt, va_list args)
{
    char line[8192];

    vsnprintf(line, sizeof line, fmt, args);
    spin_text_show_paths(line, sizeof line);
    spin_text_tidy(line, true);
    flockfile(stderr);
    if (atomic_exchange(&line_shown, 0))
        fputs(erase_line, stderr);
    fputs(prefix, stderr);
    fprintf(stderr, "%s\n", line);
    fflush(stderr);
    funlockfile(stderr);
}

void spin_log(int level, const char *fmt, ...)
{
    va_list args;

    if (level > spin_log_level())
        return;
    va_start(args, fmt);
    write_line("", fmt, args);
    va_end(args);
}

static pthread_mutex_t sink_mutex = PTHREAD_MUTEX_INITIALIZER;
static bool (*warning_sink)(const char *line);

void spin_log_set_sink(bool (*sink)(const char *line))
{
    pthread_mutex_lock(&sink_mutex);
    warning_sink = sink;
    pthread_mutex_unlock(&sink_mutex);
}

/* Asks the sink, if there is one, whether to print a warning. */
static bool passes_sink(const char *fmt, va_list args)
{
    char line[1024];
    bool passes = true;

    pthread_mutex_lock(&sink_mutex);
    if (warning_sink) {
        vsnprintf(line, sizeof line, fmt, args);
        spin_text_show_paths(line, sizeof line);
        passes = warning_sink(line);
    }
    pthread_mutex_unlock(&sink_mutex);
    return passes;
}

void spin_warn(const char *fmt, ...)
{
    va_list args;
    bool passes;

    if (spin_log_level() < -1)
        return;
    va_start(args, fmt);
    passes = passes_sink(fmt, args);
    va_end(args);
    if (!passes)
        return;
    va_start(args, fmt);
    write_line("warning: ", fmt, args);
    va_end(args);
}

/* Returns the seconds between progress lines if stderr is not a terminal: the environment variable
 * SPIN_PROGRESS, or the default. */
static double plain_period(void)
{
    static atomic_int warned;
    const char *text = getenv("SPIN_PROGRESS");
    char *end;
    double seconds;

    if (!text || !*text)
        return plain_period_s;
    seconds = strtod(text, &end);
    if (!*end && seconds >= 0 && seconds < 1e9)
        return seconds;
    if (!atomic_exchange(&warned, 1))
        spin_warn("SPIN_PROGRESS='%.40s' is not a number of seconds; using %g seconds", text,
                  plain_period_s);
    return plain_period_s;
}

void spin_progress_begin(struct spin_progress *p, const char *what, const char *unit,
                         long long from, long long total)
{
    memset(p, 0, sizeof *p);
    p->what = what;
    p->unit = unit;
    p->from = from;
    p->total = total;
    p->start_s = spin_now_s();
    p->terminal = isatty(STDERR_FILENO);
    if (!p->terminal)
        p->shown_s = p->start_s;
    if (spin_log_level() >= 0)
        p->period_s = p->terminal ? terminal_period_s : plain_period();
}

/* Returns the number of units per second in the last 10 to 20 seconds, so that the estimated time
 * left follows changes of load; 0 if the rate is unknown. */
static double recent_rate(struct spin_progress *p, double now, long long done)
{
    double since = p->past[0].s > 0 ? p->past[0].s : p->start_s;
    long long from = p->past[0].s > 0 ? p->past[0].done : p->from;

    if (now - (p->past[1].s > 0 ? p->past[1].s : p->start_s) >= window_s) {
        p->past[0] = p->past[1];
        p->past[1].s = now;
        p->past[1].done = done;
    }
    return done > from && now > since ? (double)(done - from) / (now - since) : 0;
}

void spin_progress_set(struct spin_progress *p, long long done, const char *fmt, ...)
{
    double now = p->period_s > 0 ? spin_now_s() : 0, rate;
    char left[32];
    va_list args;

    if (!(p->period_s > 0) || (p->shown_s > 0 && now - p->shown_s < p->period_s))
        return;
    p->shown_s = now;
    flockfile(stderr);
    fprintf(stderr, "%s%s  %lld", p->terminal ? erase_line : "", p->what, done);
    if (p->total > 0)
        fprintf(stderr, "/%lld  %.1f%%", p->total, 100.0 * (double)done / (double)p->total);
    rate = recent_rate(p, now, done);
    if (rate > 0) {
        fprintf(stderr, "  %.3g %s/s", rate, p->unit);
        if (p->total > 0) {
            spin_text_duration((double)(p->total - done) / rate, left);
            fprintf(stderr, "  %s left", left);
        }
    }
    if (fmt && *fmt) {
        fputs("  ", stderr);
        va_start(args, fmt);
        vfprintf(stderr, fmt, args);
        va_end(args);
    }
    if (!p->terminal)
        fputc('\n', stderr);
    fflush(stderr);
    atomic_store(&line_shown, p->terminal);
    funlockfile(stderr);
}

void spin_progress_end(struct spin_progress *p)
{
    flockfile(stderr);
    if (p->terminal && atomic_exchange(&line_shown, 0)) {
        fputs(erase_line, stderr);
        fflush(stderr);
    }
    funlockfile(stderr);
    p->period_s = 0;
}
