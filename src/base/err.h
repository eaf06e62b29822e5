/* Status codes with a trail. The innermost failure calls spin_fail(); callers that know more add a
 * link in front with spin_more(). One trail per thread; spin_last_error() (spin.h) reads it. */
#ifndef SPIN_BASE_ERR_H
#define SPIN_BASE_ERR_H

#include "spin.h"

#if defined(__GNUC__)
#define SPIN_PRINTF(fmt, args) __attribute__((format(printf, fmt, args)))
#else
#define SPIN_PRINTF(fmt, args)
#endif

/* Start a new trail with this text and return code. Lower case, no full stop, names in 'quotes'. */
spin_status spin_fail(spin_status code, const char *fmt, ...) SPIN_PRINTF(2, 3);

/* Put "text: " in front of the trail and return code. */
spin_status spin_more(spin_status code, const char *fmt, ...) SPIN_PRINTF(2, 3);

/* Return from this function when expr fails. */
#define SPIN_TRY(expr)                                                                             \
    do {                                                                                           \
        spin_status spin_try_ = (expr);                                                            \
        if (spin_try_ != SPIN_OK)                                                                  \
            return spin_try_;                                                                      \
    } while (0)

/* Jump to out: with status set when expr fails. Needs a local `spin_status status`. */
#define SPIN_TRY_OUT(expr)                                                                         \
    do {                                                                                           \
        status = (expr);                                                                           \
        if (status != SPIN_OK)                                                                     \
            goto out;                                                                              \
    } while (0)

/* True once spin_cancel() was called. */
bool spin_cancelled(void);
/* SPIN_E_CANCELLED with the text "interrupted". */
spin_status spin_fail_cancelled(void);

#endif
