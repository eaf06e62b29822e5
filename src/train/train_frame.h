/* A frame in training: the parameters that its splats own, in device memory. These are positions
 * and, optionally, residual values (log scale, rotation, colour, opacity) and further SH
 * coefficients. The output of the network is added to the residual values; without a network the
 * residual values are the attributes themselves. */
#pragma once

#include "device/device.h"

/* Parameters and Adam's moments of a frame. The moments and `steps` change only in iterations whose
 * batch shows the frame (docs/method.md section 6). */
struct spin_train_frame {
    struct spin_frame_size {
        size_t n;      /* number of splats; the other members count splats from the first one on */
        size_t n_free; /* the first n_free splats have no track; n if there are no tracks */
        size_t n_pos;  /* the first n_pos splats own a position */
        size_t n_residual; /* the first n_residual splats own residual values */
    } size;
    double time;                 /* time of the frame, in the unit of the source */
    float SPIN_DEV *pos, *m, *v; /* [n_pos][3] positions, first and second moments */
    /* [SPIN_RESIDUAL n_residual] residual values in groups (device.h), and their moments; NULL if
     * no splat owns residual values. */
    float SPIN_DEV *residual, *residual_m, *residual_v;
    /* [n][sh_width] SH coefficients beyond the first, and their moments; NULL if sh_width is 0. */
    float SPIN_DEV *sh, *sh_m, *sh_v;
    size_t sh_width;
    /* track, gradient and seen are NULL if the frame was opened with `tracked` false. */
    uint32_t SPIN_DEV *track; /* [n] the track of each splat, or SPIN_NO_TRACK */
    /* [n] sum over views of the gradients of each splat, see densify_stats(). */
    float SPIN_DEV *gradient;
    uint32_t SPIN_DEV *seen; /* [n] number of views in the sum of each splat */
    /* [n_pos][4] unit quaternion of each splat that owns a position, see turns.h. NULL if no splat
     * with a track owns both a position and residual values in this frame: all turns are then the
     * identity. */
    float SPIN_DEV *turn;
    int64_t steps; /* number of Adam steps so far */
};

/* Allocates a frame. All values are zero and all turns are the identity. tracked: splats may have
 * tracks, and statistics are gathered. Close it also after a failure. */
spin_status spin_train_frame_open(struct spin_train_frame *frame, struct spin_device *d,
                                  struct spin_frame_size size, size_t sh_width, bool tracked);
void spin_train_frame_close(struct spin_train_frame *frame, struct spin_device *d);

/* Rows in host memory, one for each splat, that begin `stride` floats apart. With `at` NULL there
 * are none, and the values are not transferred. */
struct spin_rows {
    float *at;
    size_t stride;
};
struct spin_frame_rows {
    /* Rows of 3, SPIN_RESIDUAL and sh_width floats. */
    struct spin_rows pos, residual, sh;
};
enum spin_train_array { SPIN_TRAIN_VALUES, SPIN_TRAIN_MOMENT_1, SPIN_TRAIN_MOMENT_2 };

/* Uploads or downloads the values, or one of the moments, of all splats that own the values. Splat
 * i has row row_of[i], or row i if row_of is NULL. Other rows are left unchanged. */
spin_status spin_train_frame_upload(struct spin_train_frame *frame, struct spin_device *d,
                                    enum spin_train_array which, struct spin_frame_rows rows,
                                    const uint32_t *row_of);
spin_status spin_train_frame_download(const struct spin_train_frame *frame, struct spin_device *d,
                                      enum spin_train_array which, struct spin_frame_rows rows,
                                      const uint32_t *row_of);

struct spin_frame_rates {
    double pos, residual[SPIN_HEADS], sh;
    double tracked; /* factor on the rates `pos` and `residual` for splats with a track */
};

/* Begins an Adam step of the parameters that the frame owns: increments frame->steps, describes the
 * parameters in `group` for the device's adam(), and returns the number of groups. `of` contains
 * the gradients of all splats of the frame. Positions are omitted if their rate is 0; residual
 * values and SH are omitted if `of` has no gradient for them. */
enum { SPIN_TRAIN_FRAME_GROUPS = 2 * (SPIN_HEADS + 2) };
int spin_train_frame_step(struct spin_train_frame *frame, const struct spin_frame_rates *rates,
                          const struct spin_frame_of_batch *of,
                          struct spin_param_group group[SPIN_TRAIN_FRAME_GROUPS]);
