/* The error message: each thread has a message of one line, to which callers prepend their context.
 *
 * Messages are formatted into a second buffer first, so that the result of spin_last_error() may be
 * an argument. Since messages contain names from untrusted files, control and invisible characters
 * become '?': the message stays one line and cannot control a terminal. */
#include "base/err.h"

#include <stdarg.h>
#include <stdatomic.h>
#include <string.h>

#include "base/text.h"

enum { TRAIL = 4096 };

static _Thread_local char trail[TRAIL];
static atomic_int cancelled; /* of a lock-free type, since signal handlers set it */

spin_status spin_fail(spin_status code, const char *fmt, ...)
{
    char text[TRAIL];
    va_list args;

    va_start(args, fmt);
    vsnprintf(text, sizeof text, fmt, args);
    va_end(args);
    spin_text_show_paths(text, sizeof text);
    spin_text_tidy(text, false);
    memcpy(trail, text, strlen(text) + 1);
    return code;
}

spin_status spin_fail_context(spin_status code, const char *fmt, ...)
{
    char text[2 * TRAIL + 4];
    va_list args;
    size_t n;

    if (code == SPIN_OK || code == SPIN_E_CANCELLED)
        return code;
    va_start(args, fmt);
    vsnprintf(text, TRAIL, fmt, args);
    va_end(args);
    spin_text_show_paths(text, TRAIL);
    n = strlen(text);
    if (trail[0])
        snprintf(text + n, sizeof text - n, ": %s", trail);
    /* If the text is too long, its end, the innermost part of the message, is cut off. */
    text[TRAIL - 1] = '\0';
    spin_text_tidy(text, false);
    memcpy(trail, text, strlen(text) + 1);
    return code;
}

spin_status spin_fail_reading(spin_status status, const char *path)
{
    char quoted[TRAIL];

    if (status == SPIN_OK || status == SPIN_E_USAGE)
        return status;
    snprintf(quoted, sizeof quoted, "'%s'", path); /* all messages quote paths in this way */
    spin_text_show_paths(quoted, sizeof quoted);
    spin_text_tidy(quoted, false);
    if (strstr(trail, quoted))
        return status;
    return spin_fail_context(status, "cannot read '%s'", path);
}

const char *spin_last_error(void) { return trail; }

void spin_cancel(void) { atomic_store_explicit(&cancelled, 1, memory_order_relaxed); }

bool spin_cancelled(void) { return atomic_load_explicit(&cancelled, memory_order_relaxed) != 0; }

spin_status spin_fail_cancelled(void) { return spin_fail(SPIN_E_CANCELLED, "interrupted"); }
