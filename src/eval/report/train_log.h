/* The log of spin-retrain --log: one JSON object per line. */
#pragma once

#include "spin.h"

struct spin_train_log {
    size_t n_steps, n_tests;
    double *step, *loss;  /* [n_steps] loss, averaged over intervals of
                           * iterations */
    double total_seconds; /* of the run, including resumed parts */
    /* [n_tests] iteration, time, PSNR and SSIM of the test views */
    double *test, *seconds, *psnr, *ssim;
    size_t room_steps, room_tests; /* private */
};

/* Reads at most `most` points of the loss. An incomplete last line is ignored; any other malformed
 * line is an error with its number. */
spin_status spin_train_log_read(const char *path, size_t most, struct spin_train_log *out);
void spin_train_log_free(struct spin_train_log *history);
