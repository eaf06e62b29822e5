/* Runs one iteration of a training (docs/method.md sections 3 to 7). loop.c repeats iterations, and
 * provides images, evaluations and checkpoints. */
#pragma once

#include <pthread.h>

#include "train/trainer.h"
#include "spin.h"

/* One image of a batch. */
struct spin_train_item {
    int frame;
    const struct spin_camera *camera;
    int exposure, lens;            /* rows of the camera and its lens in spin_exposures.param */
    uint32_t image;                /* slot of the image in the image store */
    const uint8_t SPIN_DEV *matte; /* matte of the image, see struct spin_view_of_batch */
    float background_change[3];
};

struct spin_train_values {
    double loss, l1, ssim; /* means over the images of the batch */
    /* True if at least one splat is visible in at least one view of the batch. */
    bool seen;
    /* Array [n] of the caller, or NULL. It receives the loss of each item that this rank renders;
     * the values of other items are left unchanged. */
    double *each;
};

/* Returns the rank that renders item `item` of a batch of n items. Each rank renders consecutive
 * items, since adjacent items may show the same frame and then share its evaluation. */
int spin_step_rank(int item, int n, int n_ranks);

/* Returns the splats of a frame as they are rendered, that is, with the values of their tracks
 * added to their own. The result is valid until the next call or the next iteration. */
struct spin_frame_batch spin_trainer_frame(struct spin_trainer *t, int frame);

/* Runs one iteration: computes the mean loss of n items (at most max_items) and its gradient, and
 * makes one Adam step. Items that show the same frame share one pass through the network. The host
 * waits for the device once for each group of views that are rendered together, to read the number
 * of intersections, and once at the end, to read the losses. Fails only if the memory for
 * intersections is insufficient, the device fails, or an all-reduce fails. All ranks must call it
 * with the same items, and have bit-identical parameters afterwards; a rank needs the images only
 * of the items that it renders. */
spin_status spin_trainer_step(struct spin_trainer *t, const struct spin_images *images,
                              const struct spin_train_item *items, int n,
                              struct spin_train_values *values);

/* ---- Log ------------------------------------------------------------------------------------- */

/* The log of a training (--log): one JSON object per line. */

struct spin_step_log {
    const char *path;
    FILE *file;     /* NULL without a log, or after a write error */
    char error[96]; /* message of the first write error; empty if there was none */
    pthread_mutex_t lock;
};

/* Opens the log; with path NULL, there is no log. append: append to an existing log, as a resume
 * does. Otherwise, an existing file is an error unless `force` is true, and an input of the run is
 * never replaced. */
spin_status spin_step_log_open(struct spin_step_log *log, const char *path, bool append,
                               bool force);
/* Locks the log and returns its file. The caller writes one line to the file and then calls
 * spin_step_log_end(). Without a log, it returns NULL and does not lock; the caller must then not
 * call spin_step_log_end(). */
FILE *spin_step_log_begin(struct spin_step_log *log);
/* Unlocks the log. flush: write the line to the file immediately, not only when the buffer is full.
 * After a write error, prints a warning and closes the log; the training continues. */
void spin_step_log_end(struct spin_step_log *log, bool flush);
/* Closes the log. Afterwards, log->error contains the first write error, or is empty. */
void spin_step_log_close(struct spin_step_log *log);

/* ---- SIMD paths ------------------------------------------------------------------------------ */

/* Records the SIMD paths of the CPU device that a training used, since the results of different
 * SIMD paths differ in the last bits. */

struct spin_simd_paths {
    const char *now; /* SIMD path of this run's device */
    /* All SIMD paths of the training: "v4", or "v3+v4" after a resume on another CPU. */
    char all[32];
};

void spin_simd_paths_begin(struct spin_simd_paths *paths, const char *now);
/* Adds the SIMD paths of earlier work, such as "v3" or "v3+v4"; NULL if there are none. Warns if
 * one of them is not yet in paths->all. */
void spin_simd_paths_add(struct spin_simd_paths *paths, const char *before);
