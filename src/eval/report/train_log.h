/* What spin-retrain --log wrote: one JSON object a line. */
#pragma once

#include "spin.h"

struct spin_train_log {
    size_t n_steps, n_tests;
    double *step, *loss;                  /* [n_steps] the loss as a mean over a stretch */
    double total_seconds;                 /* of the run, all of its parts */
    double *test, *seconds, *psnr, *ssim; /* [n_tests] iteration, time, test views */
    size_t room_steps, room_tests;        /* private */
};

/* At most `most` points of the loss. A line that was cut short at the end is passed over, any other
 * that makes no sense is an error with its number. */
spin_status spin_train_log_read(const char *path, size_t most, struct spin_train_log *out);
void spin_train_log_free(struct spin_train_log *history);
