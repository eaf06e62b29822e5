/* Status codes with a trail. The innermost failure calls spin_fail(); callers that know more add a
 * link in front with spin_fail_context(). One trail per thread; spin_last_error() reads it.
 * Plug-ins do the same, so all of this is in spin.h; here is what only the library needs. */
#pragma once

#include "spin.h"

/* True once spin_cancel() was called. */
bool spin_cancelled(void);
/* SPIN_E_CANCELLED with the text "interrupted". */
spin_status spin_fail_cancelled(void);

/* A failure to read `path` with "cannot read 'path'" in front, unless it says the path already.
 * Success, and options that are wrong (SPIN_E_USAGE), as they are. */
spin_status spin_fail_reading(spin_status status, const char *path);
