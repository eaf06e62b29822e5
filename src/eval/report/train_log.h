/* Reads a log of spin-retrain --log, which has one JSON object per line. */
#pragma once

#include "spin.h"

struct spin_train_log {
    size_t n_steps, n_tests;
    /* [n_steps] last iteration of each averaging interval, and mean loss in the interval */
    double *step, *loss;
    double total_seconds; /* duration of the training, including runs before a resume */
    /* [n_tests] evaluations of the test views: iteration, seconds since the start, PSNR, SSIM */
    double *test, *seconds, *psnr, *ssim;
    size_t room_steps, room_tests; /* capacities of the arrays */
};

/* Reads a log, and averages the loss over intervals so that at most `most` points remain. An
 * incomplete last line is ignored; any other malformed line is an error that contains the line
 * number. */
spin_status spin_train_log_read(const char *path, size_t most, struct spin_train_log *out);
void spin_train_log_free(struct spin_train_log *history);
