/* Refinement: explicit 3DGS optimisation of one frame, so that its points lie where the network training
 * needs them (docs/method.md section 2). Frames are independent of each other. */
#ifndef SPIN_TRAIN_REFINE_H
#define SPIN_TRAIN_REFINE_H

#include "device/device.h"
#include "train/densify.h"

/* One training picture of the frame. */
struct spin_refine_view {
    struct spin_camera camera;
    uint32_t image; /* number of its photograph */
    int lens;       /* of spin_refine_options.lenses */
};

/* What an iteration did. */
struct spin_refine_step {
    int iteration, view; /* from 1; index of the view drawn */
    size_t n;            /* points drawn */
    double loss;
    bool densified;
    struct spin_densify_change change;
};

struct spin_refine_options {
    int iterations;                      /* 2000 */
    double lr_position, lr_position_end; /* times the extent; 1.6e-4, 1.6e-6 */
    double lr_dc, lr_sh;                 /* 2.5e-3; of SH beyond the first, a twentieth of it */
    double lr_opacity, lr_scale, lr_rotation; /* 0.05, 5e-3, 1e-3 */
    int sh_increase_every; /* 1000 iterations until the next degree of SH joins; 0: all from the start */
    double lr_exposure; /* of every view's gain and offset, forgotten afterwards; 0: none */
    const float *
        lenses; /* [n_lenses][SPIN_EXPOSURE] their falloff, which stays, where there is an exposure */
    int n_lenses;
    double lambda_dssim;                 /* 0.2 */
    double lambda_scale, lambda_opacity; /* of the mean scale (in extents) and opacity; 0 */
    bool antialias;
    float background[3];
    int densify_from, densify_until, densify_every; /* -1: min(500, K/5); -1: 3K/4; 100 */
    const int *densify_at;                          /* [n_densify_at] exactly these, or NULL */
    int n_densify_at;
    bool no_final_prune; /* no pruning after the last iteration */
    struct spin_densify_options densify;
    void (*watch)(void *context, const struct spin_refine_step *step); /* or NULL */
    void *context;
};

/* The table of docs/method.md section 2. densify.extent must still be set. */
void spin_refine_defaults(struct spin_refine_options *o);

struct spin_refine_stats {
    int iterations, densifications;
    int blind; /* iterations whose view shows no splat */
    size_t n_first, n_last;
    struct spin_densify_change change; /* sums, with the pruning at the end */
    double loss_first, loss_last;
};

/* The highest SH degree that so many iterations come to, of at most sh_degree; increase_every as in the options. */
int spin_refine_sh_degree(int sh_degree, int increase_every, int iterations);

/* Optimise the cloud of one frame in place, at its SH degree. order [iterations]: the view of each iteration;
 * NULL: random permutations by (seed, frame), a new one whenever all views had their turn. The
 * same bits for any number of threads. stats may be NULL. On failure the cloud is valid, its
 * values unspecified. */
spin_status spin_refine_frame(struct spin_device *device, const struct spin_refine_options *o,
                              const struct spin_images *images,
                              const struct spin_refine_view *views, int n_views, const int *order,
                              struct spin_refine_cloud *cloud, struct spin_refine_stats *stats);

/* Bytes that a frame of n points and pictures of these pixels and tiles takes, host and device together. */
size_t spin_refine_bytes(const struct spin_device *device, size_t n, size_t pixels, size_t tiles,
                         int sh_degree);

#endif
