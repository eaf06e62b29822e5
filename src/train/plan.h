/* The plan of a retraining: checked options, the clip with its views, sizes of the network and the
 * images, estimates of memory and time. All later stages read the plan; stages that change the
 * numbers of splats or measure exposures update it. */
#pragma once

#include "spin_train.h"
#include "eval/metrics.h"
#include "device/device.h"
#include "model/field.h"
#include "scene/lens.h"
#include "train/train_frame.h"
#include "train/trainer.h"

struct spin_retrain_report {
    /* The options of the caller, in which automatic values are replaced by the values chosen for
     * the clip. */
    struct spin_retrain_options options;
    int iterations;
    /* Number of iterations between densifications of the clip; 0: no densification. */
    int densify_every;
    /* Seconds of the run, and seconds per iteration; the latter is NaN if --method frames reused
     * all frames. */
    double seconds, seconds_per_iteration;
    int frames;
    double splats_mean;
    char device[64];
    /* Quality of the test views, rendered from the source, the refined frames and the result. */
    struct spin_quality before, refined, test;
    /* Best test PSNR of all evaluations in this run, and its iteration; 0 before the first
     * evaluation. */
    double best_psnr;
    int64_t best_iteration;
    double refine_seconds; /* seconds of refinement, included in `seconds` */
    double outside_ball;   /* share of splats, 0..1, outside the unit ball of the contraction */
    size_t bytes_needed, bytes_available; /* bytes_available is 0 if unknown */
    /* If the arrays of the frames are kept in temporary files, because the memory is insufficient
     * for them: their size, which bytes_needed does not include, and free space of the disk;
     * otherwise 0. */
    size_t bytes_scratch;
    uint64_t bytes_disk;
    /* If the memory is insufficient: options, in the syntax of the command line, with which the run
     * would fit; empty if none were found. */
    char fitting[96];
    size_t bytes_peak; /* peak memory use of this process so far */
    /* For a dry run: estimated seconds of the whole run; NaN if unknown, as on a GPU. */
    double seconds_estimated;
    int ranks; /* number of ranks, that is, processes that share the work */
    /* For a dry run: upper bound of the bytes that all ranks together send in one iteration. */
    double bytes_sent;
    /* Message of the first failure to write a file beside the output, such as a preview; empty if
     * there was none. */
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
    /* Storage of *o in the plan of a single frame; otherwise unused. */
    struct spin_retrain_options options;
    /* Options of the run: &report->options or, in the plan of a single frame, &options. */
    const struct spin_retrain_options *o;
    struct spin_retrain_report *report; /* each stage sets the members that describe its work */
    struct spin_device *device;         /* device of the run, owned by the caller */
    struct spin_clip clip;
    /* Its scene transform is the identity; spin_frames_load() sets that of the trainer's copy. */
    struct spin_field field;
    /* [frames] number of splats of each frame; updated by refinement, backdrop and densification.
     */
    size_t *counts;
    size_t n_of_frame; /* storage of *counts in the plan of a single frame; otherwise unused */
    size_t n_rows;     /* number of 4D splats, with --method 4d; otherwise 0 */
    /* [frames] sizes of the frames with tracks, and the number of tracks. sizes is NULL before
     * tracks are found, and without tracks. The caller owns the array. */
    const struct spin_frame_size *sizes;
    size_t n_tracks;
    int *camera; /* [n_cameras] ids of the training cameras, in ascending order */
    int n_cameras;
    struct spin_lenses lenses; /* lenses of the training cameras */
    bool lenses_stay;          /* true if falloffs are not trained, only gains and offsets */
    /* [n_cameras + lenses.n][SPIN_EXPOSURE] initial exposure parameters: a row for each camera,
     * then a row for each lens. */
    float *exposure;
    /* Pairs of a frame and a view, of training and of test cameras. */
    struct spin_pair *train, *test;
    size_t n_train, n_test;
    size_t max_pixels, max_tiles; /* largest number of pixels, and of tiles, of any view */
    struct spin_backdrop backdrop;
    double extent; /* extent of the training cameras in world units, see spin_views_extent() */
    /* Of a training image, for the estimates: number of pixels at edges, which determines how many
     * splats densification adds, and share of pixels of the background colour, which are quick to
     * render. */
    double edges, empty;
    /* Folder of temporary files for the arrays of the frames, see --scratch; NULL: none are
     * written. scratch_folder: the folder that the options select. */
    const char *scratch;
    char *scratch_folder;
    size_t pixels_budget; /* size limit of the cache of decoded images, in bytes */
    char *part;           /* path of the checkpoint */
    /* Path of the bundle that an interrupted run writes beside the checkpoint, so that its splats
     * can be viewed. */
    char *clip_of_state;
    char *parts; /* folder of the cache of refined frames (refinement.h) */
};

/* Makes the plan, except for the device and the estimates that depend on it: spin_plan_set_device()
 * sets these. Zero *plan before the call, and close it also after a failure. */
spin_status spin_plan_open(struct spin_plan *plan, const struct spin_retrain_options *o,
                           struct spin_retrain_report *report);
void spin_plan_close(struct spin_plan *plan);
/* Handles the status of writing a file beside the output, such as a preview. A failure does not end
 * the training: the message of the first failure is printed as a warning, and stored in
 * report->incomplete. Returns SPIN_E_CANCELLED if `status` is SPIN_E_CANCELLED, otherwise SPIN_OK.
 */
spin_status spin_plan_beside(const struct spin_plan *plan, spin_status status);
/* Sets the device of the run, and the estimates of the report for this device: memory in bytes,
 * time in seconds. */
void spin_plan_set_device(struct spin_plan *plan, struct spin_device *device);

/* Converts the index of a frame in the clip to its index in the bundle. */
int spin_plan_index(const struct spin_plan *plan, int frame);
/* Returns the description of a frame in the bundle. */
const struct spin_frame_info *spin_plan_info(const struct spin_plan *plan, int frame);
/* Returns the middle frame of the clip or, if the middle frame has no splats, the next frame with
 * splats. */
int spin_plan_middle_frame(const struct spin_plan *plan);
/* Fails if a mean in the splats s of a frame is not finite; the error names the array and the row.
 * refined: true if s is a refined frame, false if it is a frame of the source. */
spin_status spin_plan_check_means(const struct spin_plan *plan, int frame, bool refined,
                                  const struct spin_splats *s);
/* Returns the index in plan->camera of the training camera with this id. The camera must exist. */
int spin_plan_camera(const struct spin_plan *plan, int id);
/* True if the source in the bundle has all attribute columns. */
bool spin_plan_has_source(const struct spin_plan *plan);
/* True if splats have residual values, that is, with tracks or if --residual is not off. */
bool spin_plan_has_residual(const struct spin_plan *plan);
/* True if the training of the clip densifies. False with refined frames, which were densified
 * during refinement. */
bool spin_plan_densifies(const struct spin_plan *plan);
/* Iterations that end with a densification: all multiples of `every` that are greater than `first`
 * and less than `until`; none if `every` is 0. */
struct spin_schedule {
    int64_t first, until;
    int every;
};
struct spin_schedule spin_plan_schedule(const struct spin_plan *plan);
/* Returns the sizes of a frame with n splats before tracks are found: all splats own their values
 * or, with --method 4d, none do. */
struct spin_frame_size spin_plan_frame_size(const struct spin_plan *plan, size_t n);
/* True if --dynamic-weight is not 1, so that the loss weights dynamic pixels differently from
 * static ones. */
bool spin_plan_is_weighted(const struct spin_plan *plan);
/* True if the hash table is updated with lazy Adam. This requires a device that supports it, a
 * single rank, and iterations that read less than half of a hashed level (spin_lazy_pays()). */
bool spin_plan_is_lazy(const struct spin_plan *plan);

/* Returns the size in bytes of the largest image on the device, including its mask if
 * --dynamic-weight is not 1. */
size_t spin_plan_image_bytes(const struct spin_plan *plan);
/* Returns the SH degree in the last of `iterations` iterations. The degree starts at 0 and rises by
 * one every `increase_every` iterations, up to sh_degree; with increase_every 0 it is sh_degree in
 * all iterations. */
int spin_sh_degree_reached(int sh_degree, int increase_every, int iterations);
/* Returns the SH degree that frames reach with --method frames; it does not exceed the degree of
 * the source if frames start from the source's attributes. Returns 0 for other methods. */
int spin_plan_frame_sh_degree(const struct spin_plan *plan);
/* Returns the number of iterations between increases of the SH degree of a single frame. Returns 0
 * if frames start from the source's attributes, since the degree is then not increased. */
int spin_plan_sh_increase_every(const struct spin_plan *plan);
/* True if refined frames start from the source's attributes, false if they start from coloured
 * points. */
bool spin_plan_starts_from_source(const struct spin_plan *plan);
/* Returns the columns of the source from which refined frames are initialised. */
unsigned spin_plan_start_columns(const struct spin_plan *plan);
/* Returns the columns of the source from which frames are initialised if they start from coloured
 * points: means, colours and, if the source has them, all attributes, for the splats that are not
 * visible in any training view (spin_show_unseen()). */
unsigned spin_plan_point_columns(const struct spin_plan *plan);
/* Makes the plan for training a single frame on its own device: its clip consists of this frame and
 * the training views of the frame. The new plan contains pointers into the plan `clip`, which must
 * remain open, and into itself, so it must not be moved in memory. Zero *plan before the call, and
 * close it also after a failure. */
spin_status spin_plan_of_frame(const struct spin_plan *clip, int frame, struct spin_device *device,
                               struct spin_plan *plan);
void spin_plan_close_frame(struct spin_plan *plan);

/* Opens a trainer for the plan and sets its learning rates. The caller sets the members of *size
 * that describe frames and tracks; this function sets all other members. */
spin_status spin_plan_open_trainer(const struct spin_plan *plan, struct spin_device *device,
                                   struct spin_trainer_size *size, struct spin_trainer *trainer);

/* Returns the estimated memory for refining one frame, in bytes. */
size_t spin_plan_refine_bytes(const struct spin_plan *plan);
/* SPIN_E_MEMORY if the run needs more memory than is available. */
spin_status spin_plan_check_memory(const struct spin_plan *plan);
/* True if the estimated memory exceeds the available memory. */
bool spin_plan_is_short(const struct spin_plan *plan);
/* Updates the estimates of memory and time after tracks were found; before, the estimate of memory
 * is an upper bound. sizes [frames] must outlive the plan. held: size in bytes of the decoded
 * images that are already cached. */
void spin_plan_set_sizes(struct spin_plan *plan, const struct spin_frame_size *sizes,
                         size_t n_tracks, size_t held);
/* Sets plan->edges and plan->empty, and updates the estimates of memory and time. */
void spin_plan_set_content(struct spin_plan *plan, double edges, double empty, size_t held);
/* Updates the plan after refinement: copies the numbers of splats from counts [frames] and
 * estimates the memory again. held: size in bytes of the decoded images that are already cached,
 * which counts as available memory. */
spin_status spin_plan_recount(struct spin_plan *plan, const size_t *counts, size_t held);
