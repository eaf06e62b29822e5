/* The plan of a retraining: checked options, the clip with its views, sizes of the network and the
 * images, estimated memory and time. All later stages read the plan; stages that change the number
 * of splats, or measure exposures, update it. */
#pragma once

#include "spin_train.h"
#include "eval/metrics.h"
#include "device/device.h"
#include "model/field.h"
#include "scene/lens.h"
#include "train/train_frame.h"
#include "train/trainer.h"

struct spin_retrain_report {
    /* The options that the caller gave; automatic values are replaced by those chosen for the clip.
     */
    struct spin_retrain_options options;
    int iterations;
    int densify_every; /* iterations between densifications of the clip; 0: none */
    double seconds,
        /* Seconds of the run, and of an iteration; the latter is NaN if --method frames reused all
           frames. */
        seconds_per_iteration;
    int frames;
    double splats_mean;
    char device[64];
    /* Quality of the test views: in the source, in the refined frames, and in the result. */
    struct spin_quality before, refined, test;
    /* Best PSNR of the test views in any evaluation of this run, and its iteration; 0: none. */
    double best_psnr;
    int64_t best_iteration;
    double refine_seconds; /* seconds of refinement, included in `seconds` */
    double outside_ball;   /* share of splats outside the unit ball of the encoder, 0..1 */
    size_t bytes_needed, bytes_available; /* bytes_available is 0 if unknown */
    /* If memory is short: changes of options with which the run would fit; empty if none were
     * found. */
    char fitting[96];
    size_t bytes_peak; /* largest memory use of this process so far */
    /* For a dry run: estimated seconds of the whole run; NaN if unknown, as on a GPU. */
    double seconds_estimated;
    int ranks; /* number of processes that share the work */
    /* For a dry run: upper bound of the bytes that all ranks together send in one iteration. */
    double bytes_sent;
    /* Message of the first error in writing files beside the output; empty if there was none. */
    char incomplete[512];
    /* Smoothed loss at the end of the training. With --method frames: the loss in the last
     * iteration of each frame that this run refined, averaged over these frames; NaN if all frames
     * were reused. */
    double loss_last;
};

/* The splats of the backdrop, see backdrop.h. */
struct spin_backdrop {
    size_t n;                    /* number of splats; 0: there is no backdrop */
    struct spin_refine_row *row; /* [n] initial values of the splats */
};

struct spin_plan {
    struct spin_retrain_options
        options; /* the options, in the plan of a single frame; otherwise unused */
    const struct spin_retrain_options
        *o; /* the options: &report->options or, for a single frame, &options */
    struct spin_retrain_report *report; /* each stage fills in the members that describe it */
    struct spin_device *device;         /* device of the run, owned by the caller */
    struct spin_clip clip;
    struct spin_field
        field; /* training_frames.c sets its scene transform when it loads the splats */
    /* [frames] number of splats of each frame, which refinement and the backdrop change. */
    size_t *counts;
    size_t n_of_frame; /* memory of `counts` in the plan of a single frame; otherwise unused */
    size_t n_rows;     /* number of 4D splats, with --method 4d; otherwise 0 */
    /* [frames] sizes of the frames in training, and the number of tracks, once tracks were found;
     * sizes is NULL before that, and without tracks. Owned by the caller. */
    const struct spin_frame_size *sizes;
    size_t n_tracks;
    int *camera; /* [n_cameras] ids of the training cameras, ascending */
    int n_cameras;
    struct spin_lenses lenses; /* lenses of the training cameras */
    bool lenses_stay; /* true if falloffs are fixed, so that only gains and offsets are learned */
    /* [n_cameras + lenses.n][SPIN_EXPOSURE] initial exposure parameters: a row for each camera,
     * then a row for each lens. */
    float *exposure;
    struct spin_pair *train, *test; /* pairs of a frame and a view, for training and for testing */
    size_t n_train, n_test;
    size_t max_pixels, max_tiles; /* pixels and tiles of the largest view */
    struct spin_backdrop backdrop;
    double extent; /* extent of the training cameras in world units, see spin_views_extent() */
    size_t pixels_budget; /* limit of the cache of decoded images, in bytes */
    char *part;           /* path of the checkpoint */
    /* Path of the clip for viewing that an interrupted run writes beside the checkpoint. */
    char *clip_of_state;
    char *parts; /* folder of the frame cache, with the frames refined so far (frame_cache.h) */
};

/* Plans everything that does not depend on the device; spin_plan_set_device() plans the rest. Zero
 * the plan first; close it also after a failure. */
spin_status spin_plan_open(struct spin_plan *plan, const struct spin_retrain_options *o,
                           struct spin_retrain_report *report);
void spin_plan_close(struct spin_plan *plan);
/* Handles the status of writing a file beside the output, such as a preview. A failure does not end
 * the training: the message of the first failure is printed as a warning and stored in
 * report->incomplete. Returns SPIN_E_CANCELLED if `status` is SPIN_E_CANCELLED, otherwise SPIN_OK.
 */
spin_status spin_plan_beside(const struct spin_plan *plan, spin_status status);
/* Sets the device of the run, and estimates for the report how much memory and how many seconds the
 * run needs on this device. */
void spin_plan_set_device(struct spin_plan *plan, struct spin_device *device);

/* Returns the index in the bundle of a frame of the clip. */
int spin_plan_index(const struct spin_plan *plan, int frame);
/* Returns the description of a frame in the bundle. */
const struct spin_frame_info *spin_plan_info(const struct spin_plan *plan, int frame);
/* Returns the middle frame of the clip or, if that has no splats, the next frame that has some. */
int spin_plan_middle_frame(const struct spin_plan *plan);
/* Fails if a mean in the splats s of a frame is not finite; the error names the array and the row.
 * refined: s is the refined frame instead of the source's. */
spin_status spin_plan_check_means(const struct spin_plan *plan, int frame, bool refined,
                                  const struct spin_splats *s);
/* Returns the index in plan->camera of the training camera with this id. The camera must exist. */
int spin_plan_camera(const struct spin_plan *plan, int id);
/* True if the bundle has all attribute columns of its source. */
bool spin_plan_has_source(const struct spin_plan *plan);
/* True if splats have residual values, as they do with --residual (other than off) or with tracks.
 */
bool spin_plan_has_residual(const struct spin_plan *plan);
/* True if the training of the clip densifies tracks, and splats without a track. False with refined
 * frames, which were densified during their refinement. */
bool spin_plan_densifies(const struct spin_plan *plan);
/* Iterations that end with a densification: the multiples of `every` after iteration `first` and
 * before iteration `until`; none if `every` is 0. */
struct spin_schedule {
    int64_t first, until;
    int every;
};
struct spin_schedule spin_plan_schedule(const struct spin_plan *plan);
/* Returns the sizes of a frame with n splats. Assumes that no splat has a track, since the plan is
 * made before tracks are found; with --method 4d no splat owns values. */
struct spin_frame_size spin_plan_frame_size(const struct spin_plan *plan, size_t n);
/* True if dynamic pixels have another weight in the loss than static ones (--dynamic-weight other
 * than 1). */
bool spin_plan_is_weighted(const struct spin_plan *plan);
/* True if the hash table is updated with lazy Adam. It is if the device supports lazy Adam, there
 * is only one rank, and the splats of an iteration read less than half of a hashed level
 * (spin_lazy_pays()). */
bool spin_plan_is_lazy(const struct spin_plan *plan);

/* Returns the bytes that the largest image takes on the device, including its mask if the weight of
 * dynamic pixels is not 1. */
size_t spin_plan_image_bytes(const struct spin_plan *plan);
/* Returns the SH degree in the last of `iterations` iterations. The degree starts at 0 and rises by
 * one every `increase_every` iterations, up to sh_degree; with increase_every 0 it is sh_degree in
 * all iterations. */
int spin_sh_degree_reached(int sh_degree, int increase_every, int iterations);
/* Returns the SH degree that frames reach with --method frames; it does not exceed the degree of
 * the source if frames start from the source's attributes. Returns 0 for other methods. */
int spin_plan_frame_sh_degree(const struct spin_plan *plan);
/* Returns the number of iterations after which the SH degree of a single frame rises by one.
 * Returns 0 if frames start from the source's attributes: they have the full degree from the start.
 */
int spin_plan_sh_increase_every(const struct spin_plan *plan);
/* True if refined frames start from the source's attributes, false if they start from coloured
 * points. */
bool spin_plan_starts_from_source(const struct spin_plan *plan);
/* Columns of the source from which the initial values of refined frames are made. */
unsigned spin_plan_start_columns(const struct spin_plan *plan);
/* Columns of the source from which initial values are made if frames start from coloured points:
 * means, colours and, if the source has them, all attributes, which are the initial values of
 * splats that no training camera sees (unseen.h). */
unsigned spin_plan_point_columns(const struct spin_plan *plan);
/* Makes the plan of a single frame, to be trained on a device of its own: the clip consists of this
 * frame, with its training views. The new plan contains pointers into the plan of the clip, which
 * must stay open, and into itself, so it must not be moved. Zero the new plan first; close it also
 * after a failure. */
spin_status spin_plan_of_frame(const struct spin_plan *clip, int frame, struct spin_device *device,
                               struct spin_plan *plan);
void spin_plan_close_frame(struct spin_plan *plan);

/* Opens a trainer for the plan and sets its learning rates. The caller sets the members of *size
 * that describe frames and tracks; the function sets the other members. */
spin_status spin_plan_open_trainer(const struct spin_plan *plan, struct spin_device *device,
                                   struct spin_trainer_size *size, struct spin_trainer *trainer);

/* Bytes of memory for refining one frame, assuming that densification doubles its number of splats.
 */
size_t spin_plan_refine_bytes(const struct spin_plan *plan);
/* Returns SPIN_E_MEMORY if the run needs more memory than is available, otherwise SPIN_OK. */
spin_status spin_plan_check_memory(const struct spin_plan *plan);
/* True if the estimated memory exceeds the available memory. */
bool spin_plan_is_short(const struct spin_plan *plan);
/* Estimates memory and time again, from the sizes of frames with tracks, which must outlive the
 * plan. Before that, the estimate of the memory is an upper bound. held: bytes of decoded images
 * that are already cached. */
void spin_plan_set_sizes(struct spin_plan *plan, const struct spin_frame_size *sizes,
                         size_t n_tracks, size_t held);
/* Updates the plan after refinement: copies the numbers of splats from counts [frames] and
 * estimates the memory again. held: bytes of decoded images that are already cached, which count as
 * available memory. */
spin_status spin_plan_recount(struct spin_plan *plan, const size_t *counts, size_t held);
