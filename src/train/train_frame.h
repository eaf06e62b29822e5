/* A frame in training: the parameters that its splats own, in device memory. These are positions
 * and, optionally, residual values (log scale, rotation, colour, logit opacity) and SH coefficients
 * beyond the first. The output of the network and the values of the splat's track, if there are
 * any, are added to the residual values. */
#pragma once

#include "device/device.h"
#include "base/pool.h"
#include "spin.h"

/* Parameters of a frame, and their Adam moments. Parameters, moments and `steps` change only in
 * iterations whose images show the frame (docs/method.md section 6). */
struct spin_train_frame {
    struct spin_frame_size {
        size_t n;          /* number of splats */
        size_t n_free;     /* the first n_free splats have no track; without tracks, n_free is n */
        size_t n_pos;      /* the first n_pos splats own a position */
        size_t n_residual; /* the first n_residual splats own residual values */
    } size;
    double time;                 /* time of the frame, in the unit of the source */
    float SPIN_DEV *pos, *m, *v; /* [n_pos][3] positions, and their first and second moments */
    /* [SPIN_RESIDUAL n_residual] residual values in groups (model/field.h), and their moments;
     * NULL if no splat owns residual values. */
    float SPIN_DEV *residual, *residual_m, *residual_v;
    /* [n][sh_width] SH coefficients beyond the first, and their moments; NULL if sh_width is 0. */
    float SPIN_DEV *sh, *sh_m, *sh_v;
    size_t sh_width;
    /* track, gradient and seen are NULL if the frame was opened with `tracked` false; gradient and
     * seen also after spin_train_frame_drop_statistics(). */
    uint32_t SPIN_DEV *track; /* [n] track of each splat, or SPIN_NO_TRACK */
    /* [n] sum over views of the norm of the screen gradient of each splat, see densify_stats() of
     * device.h. */
    float SPIN_DEV *gradient;
    uint32_t SPIN_DEV *seen; /* [n] number of views in this sum, for each splat */
    /* [n_pos][4] turn (track_matching.h) of each splat that owns a position, a unit quaternion.
     * NULL if no splat with a track owns both a position and residual values in this frame: all
     * turns are then the identity. */
    float SPIN_DEV *turn;
    int64_t steps; /* number of Adam steps of the frame so far */
    /* `steps` when spin_check_parameters() last found all parameters finite; -1: never. */
    int64_t checked;
    /* The memory of all arrays: of gradient and seen, and of the others. */
    void SPIN_DEV *statistics, *block;
};

/* Allocates a frame. All values are zero, and all turns are the identity. tracked: true if splats
 * may have tracks, and statistics are gathered. folder: on the CPU, the folder of temporary files
 * in which to keep the arrays (spin_pages_reserve_in()); NULL: in the memory of the device. Close
 * the frame also after a failure. */
spin_status spin_train_frame_open(struct spin_train_frame *frame, struct spin_device *d,
                                  const char *folder, struct spin_frame_size size, size_t sh_width,
                                  bool tracked);
/* Lets the system read the arrays of a frame that is kept in a temporary file, in the background.
 */
void spin_train_frame_read_ahead(const struct spin_train_frame *frame);
/* Returns the size of all arrays of a frame in bytes, and sets *statistics to the part of it that
 * spin_train_frame_drop_statistics() releases. */
size_t spin_train_frame_bytes(struct spin_frame_size size, size_t sh_width, bool tracked,
                              size_t *statistics);
void spin_train_frame_close(struct spin_train_frame *frame, struct spin_device *d);
/* Releases the densification statistics, when no densification follows. */
void spin_train_frame_drop_statistics(struct spin_train_frame *frame, struct spin_device *d);

/* Rows in host memory, one for each splat; consecutive rows begin `stride` floats apart. If `at` is
 * NULL, the values are not transferred. */
struct spin_rows {
    float *at;
    size_t stride;
};
struct spin_frame_rows {
    /* Rows of 3, SPIN_RESIDUAL and sh_width floats. */
    struct spin_rows pos, residual, sh;
};
enum spin_train_array { SPIN_TRAIN_VALUES, SPIN_TRAIN_MOMENT_1, SPIN_TRAIN_MOMENT_2 };

/* Upload or download the values, or one of their moments, for all splats that own such values.
 * Splat i corresponds to row row_of[i] or, if row_of is NULL, to row i. Other rows are left
 * unchanged. */
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

/* Prepares an Adam step of the parameters that the frame owns: increments frame->steps, sets
 * group[] to the parameters for the device's adam(), and returns the number of groups. `of`
 * contains the gradients of all splats of the frame. Positions are omitted if their learning rate
 * is 0; residual values and SH coefficients are omitted if `of` has no gradient of them. */
enum { SPIN_TRAIN_FRAME_GROUPS = 2 * (SPIN_HEADS + 2) };
int spin_train_frame_step(struct spin_train_frame *frame, const struct spin_frame_rates *rates,
                          const struct spin_frame_of_batch *of,
                          struct spin_param_group group[SPIN_TRAIN_FRAME_GROUPS]);

/* ---- Points of a frame in host memory -------------------------------------------------------- */

/* The points of one frame in host memory, in which they are initialised and densified. */

/* The trained parameters of one Gaussian, before activation functions. */
struct spin_refine_row {
    float pos_w[3];
    /* This and the following members are a row of residual values (model/field.h). */
    float log_scale[3];
    float rotation[4]; /* quaternion w, x, y, z of any length */
    float dc[3];       /* first SH coefficient of each channel: r, g, b */
    float logit_opacity;
};
enum { SPIN_REFINE_WIDTH = 3 + SPIN_RESIDUAL }; /* number of floats in a row */

struct spin_refine_point {
    struct spin_refine_row p, m, v; /* parameters, and their first and second Adam moments */
    /* Statistics since the last densification: the sum of |dL/d(x, y)|, the norm of the loss
     * gradient of the screen position in normalised device coordinates, over the views in which the
     * point was visible; and the number of these views. */
    float gradient;
    uint32_t seen;
    /* Index before the last densification, of this point or, if it is new, of its parent. */
    uint32_t origin;
    bool is_new; /* true if the last densification created the point */
};

enum { SPIN_REFINE_SH = 45 }; /* floats of the SH coefficients beyond the first, [15][3] */

/* The points of a frame. Zero the struct before its first use, and free it also after a failure. */
struct spin_refine_cloud {
    struct spin_refine_point *point; /* [n] */
    /* [n][3][SPIN_REFINE_SH]: for each point, its SH coefficients beyond the first, their first and
     * their second Adam moments. NULL if sh_degree is 0. */
    float *sh;
    int sh_degree;
    size_t n, capacity;
};

/* Ensures capacity for at least n points; keeps the contents. */
spin_status spin_refine_cloud_reserve(struct spin_refine_cloud *cloud, size_t n);
void spin_refine_cloud_free(struct spin_refine_cloud *cloud);
/* Upload (send) the values and moments of the cloud's points to the first cloud->n splats of a
 * frame, or download (fetch) those of the splats to the points. Values that a splat does not own
 * are skipped. */
spin_status spin_refine_cloud_send(const struct spin_refine_cloud *cloud, struct spin_device *d,
                                   struct spin_train_frame *frame);
spin_status spin_refine_cloud_fetch(struct spin_refine_cloud *cloud, struct spin_device *d,
                                    const struct spin_train_frame *frame);

/* Initialises a cloud from coloured points as 3DGS does: isotropic scale from the distances to the
 * 3 nearest neighbours, no rotation, opacity 0.1. pos_w [n][3] must be finite. rgb [n][3] is in
 * 0..1; NULL: all points are mid grey. SPIN_E_MALFORMED if a position is not finite. */
spin_status spin_refine_init_from_points(struct spin_pool *pool, size_t n, const float *pos_w,
                                         const float *rgb, struct spin_refine_cloud *out);
/* Calls spin_refine_init_from_points() with the means of the splats as points. Their colours are
 * the column rgb if there is one, otherwise those of the first SH coefficients, otherwise mid grey.
 */
spin_status spin_refine_init_from_colours(const struct spin_splats *splats,
                                          struct spin_refine_cloud *out);
/* Initialises a cloud from all attributes of splats except SH coefficients beyond the first. The
 * splats must have all attribute columns. */
spin_status spin_refine_init_from_splats(const struct spin_splats *splats,
                                         struct spin_refine_cloud *out);
/* Adds SH coefficients beyond the first, up to sh_degree > 0, to a cloud that one of the functions
 * above has initialised. They are copied from `splats`, which has one splat for each point;
 * coefficients that `splats` lacks are zero. If `splats` is NULL, all are zero. */
spin_status spin_refine_add_sh(int sh_degree, const struct spin_splats *splats,
                               struct spin_refine_cloud *cloud);

/* Converts the cloud to splats with all attribute columns and the cloud's SH degree. */
spin_status spin_refine_to_splats(const struct spin_refine_cloud *cloud, struct spin_splats *out);

/* ---- Sample of the points of a clip ---------------------------------------------------------- */

/* Samples points of a clip, and computes a ball that contains most of them. */

struct spin_point_sample {
    float *point;   /* [n][3] sampled points, followed by [n] floats of scratch */
    size_t n, most; /* most: largest number of points sampled in a frame */
};

/* Allocates memory for the sampled points of n_frames frames. Zero *sample before the call, and
 * close it also after a failure. */
spin_status spin_point_sample_open(struct spin_point_sample *sample, int n_frames);
void spin_point_sample_close(struct spin_point_sample *sample);
/* Adds the means of at most 20000 splats of a frame, or fewer if the clip has more than 200 frames,
 * in evenly spaced rows. */
void spin_point_sample_add(struct spin_point_sample *sample, const struct spin_splats *s);
/* Sets centre to the median of the points along each axis, and returns the radius of the ball
 * around this centre that contains 90 % of the points. The sample must contain at least one point.
 */
float spin_point_sample_enclose(struct spin_point_sample *sample, float centre[3]);
/* Returns the squared distance of a point from a centre. */
double spin_point_square_to(const float *point, const float centre[3]);
