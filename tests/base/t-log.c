/* Log levels and the progress line, read back from a file put in place of stderr.  K: base */
#include <fcntl.h>
#include <unistd.h>

#include "base/log.h"
#include "tests/check.h"
#include "tests/tap.h"

static char path[256], text[4096];
static int saved;

static void capture(void)
{
    int fd = open(path, O_RDWR | O_CREAT | O_TRUNC, 0600);

    fflush(stderr);
    saved = dup(STDERR_FILENO);
    dup2(fd, STDERR_FILENO);
    close(fd);
}

static const char *captured(void)
{
    FILE *file;
    size_t n;

    fflush(stderr);
    dup2(saved, STDERR_FILENO);
    close(saved);
    file = fopen(path, "rb");
    n = file ? fread(text, 1, sizeof text - 1, file) : 0;
    text[n] = '\0';
    if (file)
        fclose(file);
    return text;
}

TAP_MAIN
{
    struct spin_progress p;
    double before, after;

    snprintf(path, sizeof path, "%s/stderr", check_folder());
    ok(spin_log_level() == 0, "the level is 0 at first");
    capture();
    spin_log(0, "read %d frames", 3);
    spin_log(1, "not shown");
    spin_warn("frame %d is empty", 2);
    is_text(captured(), "read 3 frames\nwarning: frame 2 is empty\n", "level 0 shows 0, not 1");

    spin_log_set_level(2);
    capture();
    spin_log(2, "two");
    spin_log(3, "three");
    is_text(captured(), "two\n", "level 2 shows 2, not 3");

    spin_log_set_level(-1);
    capture();
    spin_log(0, "not shown");
    spin_warn("shown");
    is_text(captured(), "warning: shown\n", "quiet shows warnings only");
    spin_log_set_level(-2);
    capture();
    spin_warn("not shown");
    is_text(captured(), "", "below that, nothing");

    spin_log_set_level(0);
    unsetenv("SPIN_PROGRESS");
    capture();
    spin_progress_begin(&p, "retraining", "it", 0, 100);
    p.shown_s -= 58;
    spin_progress_set(&p, 50, "loss %g", 0.5);
    spin_progress_end(&p);
    is_text(captured(), "", "no progress line in the first minute where there is no terminal");
    capture();
    spin_progress_begin(&p, "retraining", "it", 0, 100);
    p.start_s = p.shown_s -= 61;
    spin_progress_set(&p, 50, "loss %g", 0.5);
    spin_progress_set(&p, 51, "loss %g", 0.5);
    spin_progress_end(&p);
    is_text(captured(), "retraining  50/100  50.0%  0.82 it/s  1:01 left  loss 0.5\n",
            "then a plain line a minute");
    spin_log_set_level(-1);
    capture();
    spin_progress_begin(&p, "retraining", "it", 0, 100);
    p.shown_s -= 1e6;
    spin_progress_set(&p, 50, NULL);
    is_text(captured(), "", "none when quiet");
    spin_log_set_level(0);
    setenv("SPIN_PROGRESS", "2.5", 1);
    capture();
    spin_progress_begin(&p, "reading", "frames", 0, 0);
    p.start_s = p.shown_s -= 2.4;
    spin_progress_set(&p, 6, NULL);
    p.start_s = p.shown_s -= 0.1;
    spin_progress_set(&p, 5, NULL);
    is_text(captured(), "reading  5  2 frames/s\n", "SPIN_PROGRESS is the time between");
    setenv("SPIN_PROGRESS", "0", 1);
    capture();
    spin_progress_begin(&p, "reading", "frames", 0, 0);
    p.shown_s -= 1e6;
    spin_progress_set(&p, 5, NULL);
    is_text(captured(), "", "0: none");
    setenv("SPIN_PROGRESS", "often", 1);
    capture();
    spin_progress_begin(&p, "reading", "frames", 0, 0);
    spin_progress_begin(&p, "reading", "frames", 0, 0);
    is_text(captured(),
            "warning: SPIN_PROGRESS='often' is not a number of seconds; using 60 seconds\n",
            "another word is said, once");
    unsetenv("SPIN_PROGRESS");

    /* Rates of 10.14, so that a machine that stops for half a second still says 10.1. */
    capture(); /* as on a terminal */
    spin_progress_begin(&p, "retraining", "it", 100, 1317);
    p.terminal = true;
    p.shown_s = 0;
    p.period_s = 10;
    p.start_s -= 100;
    spin_progress_set(&p, 1114, "loss %g", 0.5);
    spin_progress_set(&p, 1115, "loss %g", 0.25);
    spin_log(0, "a line");
    spin_progress_end(&p);
    is_text(captured(),
            "\r\033[Kretraining  1114/1317  84.6%  10.1 it/s  0:20 left  loss 0.5\r\033[Ka line\n",
            "progress counts from where it resumed, not too often, and gives way to a line");

    capture(); /* a hundred steps in the first 1000 s, then ten a second */
    p.period_s = 10;
    p.shown_s = 0;
    p.from = 0;
    p.start_s = spin_now_s() - 1100;
    p.past[0].s = p.start_s + 1000;
    p.past[0].done = 100;
    p.past[1].s = p.start_s + 1050;
    p.past[1].done = 354;
    spin_progress_set(&p, 1114, NULL);
    ok(strstr(captured(), "  10.1 it/s  0:20 left") != NULL, "the time left is that of late");
    capture();
    p.shown_s = 0;
    p.start_s -= 25;
    p.past[0].s -= 25;
    p.past[1].s -= 25;
    spin_progress_set(&p, 1114, NULL);
    ok(strstr(captured(), "  10.1 it/s  0:20 left") != NULL, "since the last but one of two times");
    spin_progress_end(&p);

    before = spin_now_s();
    usleep(2000);
    after = spin_now_s();
    ok(after - before >= 0.002 && after - before < 5, "the clock goes forward");
}
