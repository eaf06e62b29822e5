/* A frame in training: the explicit parameters of its splats on the device, which are positions
 * and, where there are some, residual values (log scale, rotation, colour, opacity) and SH. With a
 * network the residual values are added to its outputs; a single frame has nothing else. */
#pragma once

#include "device/device.h"

/* Parameters and Adam's moments. Moments and step counter change only when the frame is in a batch
 * (docs/method.md section 6). */
struct spin_train_frame {
    struct spin_frame_size {
        size_t n;          /* splats; each count below is of the first of them */
        size_t n_free;     /* without a track; all if there are no tracks */
        size_t n_pos;      /* with a position of their own */
        size_t n_residual; /* with residual values of their own */
    } size;
    double time;                 /* in the source's unit */
    float SPIN_DEV *pos, *m, *v; /* [n_pos][3] */
    float SPIN_DEV *residual, *residual_m,
        *residual_v;                  /* [SPIN_RESIDUAL n_residual] in groups (device.h), or NULL */
    float SPIN_DEV *sh, *sh_m, *sh_v; /* [n][sh_width] beyond the first coefficient, or NULL */
    size_t sh_width;
    /* If splats may have tracks; else NULL. */
    uint32_t SPIN_DEV *track; /* [n] the track of a splat, or SPIN_NO_TRACK */
    float SPIN_DEV *gradient; /* [n] statistics for densification, see densify_stats() */
    uint32_t SPIN_DEV *seen;  /* [n] the same */
    /* [n_pos][4] unit quaternions, see turns.h. NULL: no track is dynamic, or dynamic tracks have
     * no residual values here. */
    float SPIN_DEV *turn;
    int64_t steps;
};

/* All values are zero, and turns the identity. tracked: splats may have tracks. Close it also after
 * a failure. */
spin_status spin_train_frame_open(struct spin_train_frame *frame, struct spin_device *d,
                                  struct spin_frame_size size, size_t sh_width, bool tracked);
void spin_train_frame_close(struct spin_train_frame *frame, struct spin_device *d);

/* Host memory with a row for every splat, `stride` floats apart. at NULL: none. */
struct spin_rows {
    float *at;
    size_t stride;
};
struct spin_frame_rows {
    struct spin_rows pos, residual, sh; /* of 3, SPIN_RESIDUAL and sh_width floats */
};
enum spin_train_array { SPIN_TRAIN_VALUES, SPIN_TRAIN_MOMENT_1, SPIN_TRAIN_MOMENT_2 };

/* Uploads and downloads rows of the splats that have such values. Splat i has row row_of[i]; NULL:
 * row i. */
spin_status spin_train_frame_upload(struct spin_train_frame *frame, struct spin_device *d,
                                    enum spin_train_array which, struct spin_frame_rows rows,
                                    const uint32_t *row_of);
spin_status spin_train_frame_download(const struct spin_train_frame *frame, struct spin_device *d,
                                      enum spin_train_array which, struct spin_frame_rows rows,
                                      const uint32_t *row_of);

struct spin_frame_rates {
    double pos, residual[SPIN_HEADS], sh;
    double tracked; /* factor on the rates of pos and residual, for splats with a track */
};

/* Begins an Adam step of the frame's own parameters, with the gradients of all its splats in `of`.
 * Sets the groups for the device's adam() and returns their number. Positions with rate 0, and
 * values without a gradient, do not change. */
enum { SPIN_TRAIN_FRAME_GROUPS = 2 * (SPIN_HEADS + 2) };
int spin_train_frame_step(struct spin_train_frame *frame, const struct spin_frame_rates *rates,
                          const struct spin_frame_of_batch *of,
                          struct spin_param_group group[SPIN_TRAIN_FRAME_GROUPS]);
