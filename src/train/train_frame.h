/* One frame while it is trained: the explicit parameters of its splats on the device, which are
 * positions and, where there are some, residual values (log scale, rotation, colour, opacity) and
 * SH. With a network the residual values are added to its outputs; a frame by itself has nothing
 * else. */
#pragma once

#include "device/device.h"

/* Parameters and Adam's moments. While the frame is not in a batch its moments and its step counter
 * stay as they are (docs/method.md section 6). */
struct spin_train_frame {
    struct spin_frame_size {
        size_t n;          /* splats; what follows counts from the first of them */
        size_t n_free;     /* without a track; without tracks all of them */
        size_t n_pos;      /* with a position of their own */
        size_t n_residual; /* with residual values of their own */
    } size;
    double time;                 /* in the source's unit */
    float SPIN_DEV *pos, *m, *v; /* [n_pos][3] */
    float SPIN_DEV *residual, *residual_m,
        *residual_v;                  /* [SPIN_RESIDUAL n_residual] in groups (device.h), or NULL */
    float SPIN_DEV *sh, *sh_m, *sh_v; /* [n][sh_width] beyond the first coefficient, or NULL: of
                                       * frames whose splats all have residual values */
    size_t sh_width;
    /* Where splats may have tracks; else NULL. */
    uint32_t SPIN_DEV *track; /* [n] the track of a splat, or SPIN_NO_TRACK */
    float SPIN_DEV *gradient; /* [n] what densification goes by, see densify_stats() */
    uint32_t SPIN_DEV *seen;  /* [n] */
    float SPIN_DEV *turn; /* [n_pos][4] unit quaternions, see turns.h; NULL: no track moves, or such
                           * have no residual values here */
    int64_t steps;
};

/* All zero, and turns the identity; tracked: also what only frames whose splats may have tracks
 * have. After a failure close as well. */
spin_status spin_train_frame_open(struct spin_train_frame *frame, struct spin_device *d,
                                  struct spin_frame_size size, size_t sh_width, bool tracked);
void spin_train_frame_close(struct spin_train_frame *frame, struct spin_device *d);

/* Host memory with a row for every splat, `stride` floats apart. at NULL: not wanted. */
struct spin_rows {
    float *at;
    size_t stride;
};
struct spin_frame_rows {
    struct spin_rows pos, residual, sh; /* of 3, SPIN_RESIDUAL and sh_width floats */
};
enum spin_train_array { SPIN_TRAIN_VALUES, SPIN_TRAIN_MOMENT_1, SPIN_TRAIN_MOMENT_2 };

/* Rows to the device, and back, for the splats that have them. Splat i has row row_of[i]; NULL: row
 * i. */
spin_status spin_train_frame_upload(struct spin_train_frame *frame, struct spin_device *d,
                                    enum spin_train_array which, struct spin_frame_rows rows,
                                    const uint32_t *row_of);
spin_status spin_train_frame_download(const struct spin_train_frame *frame, struct spin_device *d,
                                      enum spin_train_array which, struct spin_frame_rows rows,
                                      const uint32_t *row_of);

struct spin_frame_rates {
    double pos, residual[SPIN_HEADS], sh;
    double tracked; /* splats with a track learn at so many times these rates */
};

/* Begin a step of the frame's own parameters with the gradients of all its splats, `of`: the groups
 * that the caller hands to the device's adam(). Returns how many. Positions with rate 0, and what
 * has no gradient, stay. */
enum { SPIN_TRAIN_FRAME_GROUPS = 2 * (SPIN_HEADS + 2) };
int spin_train_frame_step(struct spin_train_frame *frame, const struct spin_frame_rates *rates,
                          const struct spin_frame_of_batch *of,
                          struct spin_param_group group[SPIN_TRAIN_FRAME_GROUPS]);
