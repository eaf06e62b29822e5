/* What spin-retrain --log wrote: one JSON object a line. */
#ifndef SPIN_CORE_HISTORY_H
#define SPIN_CORE_HISTORY_H

#include "spin.h"

struct spin_history {
    size_t n_steps, n_tests;
    double *step, *loss;                  /* [n_steps] the loss as a mean over a stretch */
    double *test, *seconds, *psnr, *ssim; /* [n_tests] iteration, time, test views */
    size_t room_steps, room_tests;        /* private */
};

/* At most `most` points of the loss. A line that was cut short at the end is passed over, any other
 * that makes no sense is an error with its number. */
spin_status spin_history_read(const char *path, size_t most, struct spin_history *out);
void spin_history_free(struct spin_history *history);

#endif
