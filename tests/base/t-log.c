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
    capture();
    spin_progress_begin(&p, "retraining", "it", 0, 100);
    spin_progress_set(&p, 50, "loss %g", 0.5);
    spin_progress_end(&p);
    is_text(captured(), "", "no progress line where there is no terminal");

    capture(); /* as on a terminal: the struct says whether it is one */
    spin_progress_begin(&p, "retraining", "it", 100, 400);
    p.shown = true;
    p.start_s -= 10;
    spin_progress_set(&p, 200, "loss %g", 0.5);
    spin_progress_set(&p, 201, "loss %g", 0.25);
    spin_log(0, "a line");
    spin_progress_end(&p);
    is_text(captured(),
            "\r\033[Kretraining  200/400  50.0%  10 it/s  0:20 left  loss 0.5\r\033[Ka line\n",
            "progress counts from where it resumed, not too often, and gives way to a line");

    before = spin_now_s();
    usleep(2000);
    after = spin_now_s();
    ok(after - before >= 0.002 && after - before < 5, "the clock goes forward");
}
