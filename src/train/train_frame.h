/* A frame in training: the parameters that its splats own, in device memory. These are positions
 * and, optionally, residual values (log scale, rotation, colour, opacity) and further SH
 * coefficients. The output of the network is added to the residual values; without a network the
 * residual values are the attributes themselves. */
#pragma once

#include "device/device.h"
#include "base/pool.h"
#include "spin.h"

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

/* ---- Points of a frame in host memory -------------------------------------------------------- */

/* The points of one frame in host memory, where densification changes their number, and their
 * initial values. */

/* Parameters of one Gaussian before activation functions, as the optimiser sees them. */
struct spin_refine_row {
    float pos_w[3];
    /* The members from here on form a row of residual values (model/residual.h). */
    float log_scale[3];
    float rotation[4]; /* quaternion w, x, y, z of any length */
    float dc[3];       /* first SH coefficient of each channel: r, g, b */
    float logit_opacity;
};
enum { SPIN_REFINE_WIDTH = 3 + SPIN_RESIDUAL }; /* floats of a row */

struct spin_refine_point {
    struct spin_refine_row p, m, v; /* parameters, and Adam's first and second moments of them */
    /* Since the last densification: the sum of |dL/d(ndc xy)| over the views in which the point was
     * visible, and the number of these views. */
    float gradient;
    uint32_t seen;
    uint32_t origin; /* index before the last densification: of this point or, if it is new, of its
                        parent */
    bool is_new;     /* true if the last densification created the point */
};

enum { SPIN_REFINE_SH = 45 }; /* SH coefficients beyond the first, [15][3] */

/* The points of a frame. Zero it before its first use; free it also after a failure. */
struct spin_refine_cloud {
    struct spin_refine_point *point; /* [n] */
    /* [n][3][SPIN_REFINE_SH]: for each point its SH coefficients beyond the first, Adam's first
     * moments of these and the second moments. NULL if sh_degree is 0. */
    float *sh;
    int sh_degree;
    size_t n, capacity;
};

/* Grows the capacity to at least n points; keeps the contents. */
spin_status spin_refine_cloud_reserve(struct spin_refine_cloud *cloud, size_t n);
void spin_refine_cloud_free(struct spin_refine_cloud *cloud);
/* Uploads the values and moments of the cloud's points to the first cloud->n splats of a frame
 * (send), or downloads them from there (fetch). Skips values that a splat of the frame does not
 * own. */
spin_status spin_refine_cloud_send(const struct spin_refine_cloud *cloud, struct spin_device *d,
                                   struct spin_train_frame *frame);
spin_status spin_refine_cloud_fetch(struct spin_refine_cloud *cloud, struct spin_device *d,
                                    const struct spin_train_frame *frame);

/* Initialises a cloud from coloured points as 3DGS does: isotropic scale from the distance to the 3
 * nearest neighbours, no rotation, opacity 0.1. pos_w [n][3] must be finite; rgb [n][3] has values
 * 0..1, or is NULL: all points are mid grey. */
spin_status spin_refine_init_from_points(struct spin_pool *pool, size_t n, const float *pos_w,
                                         const float *rgb, struct spin_refine_cloud *out);
/* Calls spin_refine_init_from_points() with the means of the splats as points. The colour is the
 * first of these that the splats have: rgb, the colour of the first SH coefficient, mid grey. */
spin_status spin_refine_init_from_colours(const struct spin_splats *splats,
                                          struct spin_refine_cloud *out);
/* Initialises a cloud from all attributes of splats, which must have all attribute columns, except
 * SH coefficients beyond the first. */
spin_status spin_refine_init_from_splats(const struct spin_splats *splats,
                                         struct spin_refine_cloud *out);
/* Adds SH of a degree above 0 to a cloud that one of the functions above has initialised.
 * `splats` has one splat for each point. Copies its coefficients beyond the first; those of a
 * degree that `splats` lacks are zero. With `splats` NULL all are zero. */
spin_status spin_refine_add_sh(int sh_degree, const struct spin_splats *splats,
                               struct spin_refine_cloud *cloud);

/* Converts the cloud to splats with all attribute columns and the cloud's SH degree. */
spin_status spin_refine_to_splats(const struct spin_refine_cloud *cloud, struct spin_splats *out);

/* ---- Sample of the points of a clip ---------------------------------------------------------- */

/* A sample of the points of a clip, and a ball that contains most of the points. */

struct spin_point_sample {
    float *point; /* [n][3] sampled points, followed by [n] floats of scratch */
    size_t n;
};

/* Allocates memory for the sampled points of n_frames frames. Zero *sample first; close it also
 * after a failure. */
spin_status spin_point_sample_open(struct spin_point_sample *sample, int n_frames);
void spin_point_sample_close(struct spin_point_sample *sample);
/* Adds the means of at most 20000 splats of a frame, at even distances in the order of its rows. */
void spin_point_sample_add(struct spin_point_sample *sample, const struct spin_splats *s);
/* Sets centre to the median of the points along each axis, and returns the radius of the ball
 * around it that contains 90 % of the points. The sample must contain at least one point. */
float spin_point_sample_enclose(struct spin_point_sample *sample, float centre[3]);
/* Squared distance of a point from a centre. */
double spin_point_square_to(const float *point, const float centre[3]);
