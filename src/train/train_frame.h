/* A frame in training: the parameters that its splats own, on the device. These are positions and,
 * optionally, residual values (log scale, rotation, colour, opacity) and SH. A network adds its
 * outputs to the residual values; without one they are the attributes themselves. */
#pragma once

#include "device/device.h"

/* Parameters and Adam's moments. Moments and step counter change only when the frame is in a batch
 * (docs/method.md section 6). */
struct spin_train_frame {
    struct spin_frame_size {
        size_t n;          /* all splats of the frame; the other counts are of its first splats */
        size_t n_free;     /* splats without a track; all if there are no tracks */
        size_t n_pos;      /* splats that own a position */
        size_t n_residual; /* splats that own residual values */
    } size;
    double time;                 /* time of the frame, in the source's unit */
    float SPIN_DEV *pos, *m, *v; /* [n_pos][3] */
    float SPIN_DEV *residual, *residual_m,
        *residual_v;                  /* [SPIN_RESIDUAL n_residual] in groups (device.h), or NULL */
    float SPIN_DEV *sh, *sh_m, *sh_v; /* [n][sh_width] beyond the first coefficient, or NULL */
    size_t sh_width;
    /* track, gradient and seen are NULL unless splats may have tracks. */
    uint32_t SPIN_DEV *track; /* [n] the track of a splat, or SPIN_NO_TRACK */
    float SPIN_DEV *gradient; /* [n] sums of gradients over views, see densify_stats() */
    uint32_t SPIN_DEV *seen;  /* [n] number of views in each sum of gradients */
    /* [n_pos][4] unit quaternions, see turns.h. NULL: no track is dynamic, or dynamic tracks have
     * no residual values here. */
    float SPIN_DEV *turn;
    int64_t steps; /* Adam steps so far */
};

/* Allocates a frame whose values are zero and whose turns are the identity. tracked: splats may
 * have tracks. Close it also after a failure. */
spin_status spin_train_frame_open(struct spin_train_frame *frame, struct spin_device *d,
                                  struct spin_frame_size size, size_t sh_width, bool tracked);
void spin_train_frame_close(struct spin_train_frame *frame, struct spin_device *d);

/* Rows in host memory, one per splat and `stride` floats apart. at NULL: no rows. */
struct spin_rows {
    float *at;
    size_t stride;
};
struct spin_frame_rows {
    struct spin_rows pos, residual, sh; /* rows of 3, SPIN_RESIDUAL and sh_width floats */
};
enum spin_train_array { SPIN_TRAIN_VALUES, SPIN_TRAIN_MOMENT_1, SPIN_TRAIN_MOMENT_2 };

/* Uploads or downloads values of the splats that own them. Splat i has row row_of[i]; row_of NULL:
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

/* Begins an Adam step of the parameters that the frame owns, with the gradients of all its splats
 * in `of`. Fills `group` for the device's adam() and returns the number of groups. Omits positions
 * if their rate is 0, and values that have no gradient. */
enum { SPIN_TRAIN_FRAME_GROUPS = 2 * (SPIN_HEADS + 2) };
int spin_train_frame_step(struct spin_train_frame *frame, const struct spin_frame_rates *rates,
                          const struct spin_frame_of_batch *of,
                          struct spin_param_group group[SPIN_TRAIN_FRAME_GROUPS]);
