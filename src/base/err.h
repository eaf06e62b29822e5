/* Status codes with an error message. The function that detects an error calls spin_fail(); its
 * callers put their context before the message with spin_fail_context(). Each thread has its own
 * message, which spin_last_error() returns. These three functions are declared in spin.h, since
 * plug-ins use them too; this header declares other functions for errors. */
#pragma once

#include "spin.h"

/* Whether spin_cancel() was called. */
bool spin_cancelled(void);
/* Set the error message "interrupted"; returns SPIN_E_CANCELLED. */
spin_status spin_fail_cancelled(void);

/* Put "cannot read 'PATH'" before the error message of a failure to read `path`, unless the message
 * already contains the path. If `status` is SPIN_OK or SPIN_E_USAGE, the message stays unchanged.
 * Returns `status`. */
spin_status spin_fail_reading(spin_status status, const char *path);
