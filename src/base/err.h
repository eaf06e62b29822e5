/* Status codes with an error message. The function that detects an error calls spin_fail(); its
 * callers put their context before the message with spin_fail_context(). Each thread has its own
 * message, which spin_last_error() returns. spin.h declares these functions, since plug-ins use
 * them too; this header declares the others. */
#pragma once

#include "spin.h"

/* Whether spin_cancel() was called. */
bool spin_cancelled(void);
/* SPIN_E_CANCELLED with the text "interrupted". */
spin_status spin_fail_cancelled(void);

/* Prefix a failure to read `path` with "cannot read 'path'", unless the message contains the path
 * already. Does nothing for SPIN_OK and SPIN_E_USAGE. Returns status. */
spin_status spin_fail_reading(spin_status status, const char *path);
