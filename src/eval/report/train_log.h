/* Reads the log of spin-retrain --log, which has one JSON object per line. */
#pragma once

#include "spin.h"

struct spin_train_log {
    size_t n_steps, n_tests;
    /* [n_steps] last iteration of each interval, and mean loss of the interval */
    double *step, *loss;
    double total_seconds; /* duration of the run, including resumed parts */
    /* [n_tests] iteration, time in seconds, and PSNR and SSIM of the test views */
    double *test, *seconds, *psnr, *ssim;
    size_t room_steps, room_tests; /* private */
};

/* Reads a log and averages the loss to at most `most` points. An incomplete last line is ignored;
 * any other malformed line is an error, whose message contains the line number. */
spin_status spin_train_log_read(const char *path, size_t most, struct spin_train_log *out);
void spin_train_log_free(struct spin_train_log *history);
