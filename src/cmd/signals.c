/* Ctrl-C, a terminal that closes, and their relatives. */
#include "cmd/signals.h"

#include <signal.h>
#include <unistd.h>

#include "spin.h"

static volatile sig_atomic_t signal_seen;

/* The first asks the work to stop and keep what it has; a second Ctrl-C means now. */
static void on_signal(int number)
{
    if (number == SIGINT && signal_seen == SIGINT)
        _exit(128 + number);
    signal_seen = number;
    spin_cancel();
}

/* SIGPIPE is ignored so that a reader who leaves does not end a long run half-way; the failed write
 * is reported by spin_args_finish(). */
void spin_signals_catch(void)
{
    struct sigaction action = {.sa_handler = on_signal, .sa_flags = SA_RESTART};

    sigemptyset(&action.sa_mask);
    sigaction(SIGINT, &action, NULL);
    sigaction(SIGTERM, &action, NULL);
    if (signal(SIGHUP, SIG_IGN) != SIG_IGN) /* under nohup it stays ignored */
        sigaction(SIGHUP, &action, NULL);
    signal(SIGPIPE, SIG_IGN);
    signal(SIGXFSZ, SIG_IGN); /* the write fails instead, and says so */
}

int spin_signals_exit_code(void) { return 128 + (signal_seen ? signal_seen : SIGINT); }
