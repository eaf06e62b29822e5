/* Status codes with an error message. The innermost failure calls spin_fail(); callers prefix
 * context with spin_fail_context(). Each thread has its own message, which spin_last_error()
 * returns. Plug-ins use the same functions, which is why spin.h declares them; this header declares
 * what only the library needs. */
#pragma once

#include "spin.h"

/* Whether spin_cancel() was called. */
bool spin_cancelled(void);
/* SPIN_E_CANCELLED with the text "interrupted". */
spin_status spin_fail_cancelled(void);

/* Prefix a failure to read `path` with "cannot read 'path'", unless the message contains the path
 * already. SPIN_OK and SPIN_E_USAGE are returned as they are. */
spin_status spin_fail_reading(spin_status status, const char *path);
