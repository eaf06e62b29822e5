/* One iteration of a training (docs/method.md sections 3 to 7). loop.c repeats it, and adds data,
 * evaluations and checkpoints. */
#pragma once

#include <pthread.h>

#include "train/trainer.h"
#include "spin.h"

/* One image of a batch. */
struct spin_train_item {
    int frame;
    const struct spin_camera *camera;
    int exposure, lens;            /* rows of the camera and of its lens in spin_exposures.param */
    uint32_t image;                /* number of the item's image in the image store */
    const uint8_t SPIN_DEV *matte; /* see struct spin_view_of_batch */
    float background_change[3];
};

struct spin_train_values {
    double loss, l1, ssim; /* means over the images of the batch */
    /* True if at least one splat is visible in at least one view of the batch. */
    bool seen;
    /* NULL, or an array [n] of the caller that receives the loss of each item that this rank
     * renders. The values of the other items are left unchanged. */
    double *each;
};

/* Returns the rank that renders item `item` of a batch of n. Each rank renders a range of
 * consecutive items, since neighbouring items may show the same frame. */
int spin_step_rank(int item, int n, int n_ranks);

/* Returns a frame's splats as they are rendered, with the values that splats own combined with
 * those of their tracks. The result is valid until the next call or the next iteration. */
struct spin_frame_batch spin_trainer_frame(struct spin_trainer *t, int frame);

/* Runs one iteration: computes the mean loss of the n items (at most max_items) and its gradient,
 * and makes one Adam step. Items that show the same frame share one pass through the network. The
 * host waits for the device only to read the number of intersections of each group of views that
 * are rendered together and, at the end, the losses. Fails only if the rasteriser's lists cannot
 * grow, if the device fails, or if an all-reduce fails. All ranks call it with the same items, and
 * have bit-identical parameters afterwards; each rank needs only the images of the items that it
 * renders. */
spin_status spin_trainer_step(struct spin_trainer *t, const struct spin_images *images,
                              const struct spin_train_item *items, int n,
                              struct spin_train_values *values);

/* ---- Log ------------------------------------------------------------------------------------- */

/* The log of a training (--log): one JSON object per line. */

struct spin_step_log {
    const char *path;
    FILE *file;     /* NULL if there is no log or if writing it has failed */
    char error[96]; /* message of the first write error; empty if there was none */
    pthread_mutex_t lock;
};

/* Opens the log; with path NULL there is no log. append: continues an existing log, as a resume
 * does. Without append, an existing file is replaced only if `force` is true, and never if it is an
 * input of the run. */
spin_status spin_step_log_open(struct spin_step_log *log, const char *path, bool append,
                               bool force);
/* Locks the log and returns its file. The caller writes one line to the file and then calls
 * spin_step_log_end(). If there is no log, it returns NULL without locking, and the caller must not
 * call spin_step_log_end(). */
FILE *spin_step_log_begin(struct spin_step_log *log);
/* Unlocks the log. With flush, the line is written to disk immediately, otherwise when the buffer
 * is full. After a write error it prints a warning and writes nothing more to the log; the training
 * continues. */
void spin_step_log_end(struct spin_step_log *log, bool flush);
/* Closes the log. Afterwards log->error contains the first write error, or is empty. */
void spin_step_log_close(struct spin_step_log *log);

/* ---- SIMD paths ------------------------------------------------------------------------------ */

/* Records the SIMD paths of the CPU device that took part in a training, since their results differ
 * in the last bits. */

struct spin_simd_paths {
    const char *now; /* SIMD path of this run's device */
    char all[32];    /* all paths of the training: "v4", or "v3+v4" after a resume on another CPU */
};

void spin_simd_paths_begin(struct spin_simd_paths *paths, const char *now);
/* Adds the SIMD paths that did earlier parts of the work: "v3", "v3+v4" or, if there are none,
 * NULL. Warns if one of them is not in the list yet. */
void spin_simd_paths_add(struct spin_simd_paths *paths, const char *before);
