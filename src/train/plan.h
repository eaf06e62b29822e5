/* The plan of a retraining: checked options, the clip with its views, shapes, memory and time. All
 * later stages read it; only refinement changes it, when it changes the number of splats. */
#pragma once

#include "spin_train.h"
#include "eval/metrics.h"
#include "device/device.h"
#include "model/field.h"
#include "scene/lens.h"
#include "train/cloud.h"
#include "train/trainer.h"

struct spin_retrain_report {
    struct spin_retrain_options options; /* as given, with numbers resolved for the clip */
    int iterations;
    int densify_every; /* iterations between densifications of the clip; 0: none */
    double seconds, seconds_per_iteration; /* NAN: nothing was left to refine or to train */
    int frames;
    double splats_mean;
    char device[64];
    struct spin_quality before, refined, test;
    double refine_seconds;                /* part of seconds */
    double outside_ball;                  /* share of points outside the unit ball of the encoder */
    size_t bytes_needed, bytes_available; /* available 0: unknown */
    char fitting[96];         /* options that would fit if these do not; empty: none were found */
    size_t bytes_peak;        /* of this process, at the end */
    double seconds_estimated; /* dry run only */
    int ranks;                /* processes that share the work */
    double bytes_sent;        /* dry run only: by all of them in an iteration, at most */
    /* Why something beside the output could not be written, the first time; empty: all was. */
    char incomplete[512];
    double loss_last; /* smoothed; of frames refined now, their mean, or NAN: none was */
};

/* See backdrop.h. */
struct spin_backdrop {
    size_t n;                    /* splats; 0: no backdrop */
    struct spin_refine_row *row; /* [n] initial values */
};

struct spin_plan {
    struct spin_retrain_options options;  /* of a single frame */
    const struct spin_retrain_options *o; /* those of the report, or of a single frame */
    struct spin_retrain_report *report;   /* every stage writes its own fields */
    struct spin_device *device;           /* device of the run, owned by the caller */
    struct spin_clip clip;
    struct spin_field field; /* the scene transform is set by frames.c */
    size_t *counts;          /* [frames] splats; after refinement those of the refined frames */
    size_t n_of_frame;       /* the one count of a single frame */
    size_t n_rows;           /* 4D splats, with --method 4d */
    int *camera;             /* [n_cameras] ids of the training cameras, ascending */
    int n_cameras;
    struct spin_lenses lenses; /* of the training cameras */
    bool lenses_stay;          /* falloffs are fixed: only gains and offsets learn */
    /* [n_cameras + lenses.n][SPIN_EXPOSURE] initial values: of cameras, then of lenses. */
    float *exposure;
    struct spin_pair *train, *test; /* pairs (frame, view) */
    size_t n_train, n_test;
    size_t max_pixels, max_tiles; /* of the largest view */
    struct spin_backdrop backdrop;
    double extent;        /* of the training cameras, in world units */
    size_t pixels_budget; /* bytes of decoded images to cache */
    char *part;           /* path of the checkpoint */
    char *clip_of_state; /* path of the clip that an interrupted run leaves beside the checkpoint */
    char *parts;         /* folder of the frames refined so far */
};

/* Plans all that does not depend on the device. Zero the plan first; close it also after a failure.
 */
spin_status spin_plan_open(struct spin_plan *plan, const struct spin_retrain_options *o,
                           struct spin_retrain_report *report);
void spin_plan_close(struct spin_plan *plan);
/* For failures to write files beside the output, which do not end the training: the first is a
 * warning, and stored in report->incomplete. Returns SPIN_OK, or SPIN_E_CANCELLED if that is the
 * status. */
spin_status spin_plan_beside(const struct spin_plan *plan, spin_status status);
/* Sets the device of the run, and estimates memory and seconds for the report. */
void spin_plan_set_device(struct spin_plan *plan, struct spin_device *device);

/* A frame's index in the bundle, and its description there. */
int spin_plan_index(const struct spin_plan *plan, int frame);
const struct spin_frame_info *spin_plan_info(const struct spin_plan *plan, int frame);
/* The middle frame of the clip, or the next one that has splats. */
int spin_plan_middle_frame(const struct spin_plan *plan);
/* Fails if a mean of a frame is not finite, naming the array and the row. refined: the means are
 * those of a refined frame. */
spin_status spin_plan_check_means(const struct spin_plan *plan, int frame, bool refined,
                                  const struct spin_splats *s);
/* Index of a training camera, which must exist, in plan->camera. */
int spin_plan_camera(const struct spin_plan *plan, int id);
/* True if the bundle has all attribute columns of its source. */
bool spin_plan_has_source(const struct spin_plan *plan);
/* True if splats have residual values, to which a network adds. */
bool spin_plan_has_residual(const struct spin_plan *plan);
/* True if tracks, and splats without one, are densified. Refined frames are not, since refinement
 * has already done so. */
bool spin_plan_densifies(const struct spin_plan *plan);
/* Densification happens after iteration `first` and before `until`, every so many iterations; every
 * 0: never. */
struct spin_schedule {
    int64_t first, until;
    int every;
};
struct spin_schedule spin_plan_schedule(const struct spin_plan *plan);
/* Sizes of a frame with n splats, assuming that none has a track. Tracks are found later. */
struct spin_frame_size spin_plan_frame_size(const struct spin_plan *plan, size_t n);
/* True if pixels have different weights (--dynamic-weight). */
bool spin_plan_is_weighted(const struct spin_plan *plan);
/* True if the table uses lazy Adam: the device has it, there is one rank, and the splats of an
 * iteration need less than half of the table. */
bool spin_plan_is_lazy(const struct spin_plan *plan);

/* Bytes of an image on the device, with its mask if pixels have different weights. */
size_t spin_plan_image_bytes(const struct spin_plan *plan);
/* The SH degree that is reached after so many iterations, at most sh_degree, if it rises by one
 * every `increase_every`; 0: all degrees from the start. */
int spin_sh_degree_reached(int sh_degree, int increase_every, int iterations);
/* SH degree that frames reach with --method frames, at most that of the source if they start from
 * it; 0 for other methods. */
int spin_plan_frame_sh_degree(const struct spin_plan *plan);
/* Iterations until the next degree joins; 0: all from the start, as for a source that has learned
 * them. */
int spin_plan_sh_increase_every(const struct spin_plan *plan);
/* True if single frames start from the source's attributes, false for coloured points. */
bool spin_plan_starts_from_source(const struct spin_plan *plan);
/* Columns of the source that single frames start from; those that coloured points are made of,
 * including the attributes for splats that no camera sees. */
unsigned spin_plan_start_columns(const struct spin_plan *plan);
unsigned spin_plan_point_columns(const struct spin_plan *plan);
/* Plan of a single frame on its own device: a clip of one frame with its training views. Refers to
 * the clip's plan, and must not be moved. Zero it first; close it also after a failure. */
spin_status spin_plan_of_frame(const struct spin_plan *clip, int frame, struct spin_device *device,
                               struct spin_plan *plan);
void spin_plan_close_frame(struct spin_plan *plan);

/* Opens a trainer for the plan and sets its rates. The caller sets frames and tracks in size, the
 * function the rest. */
spin_status spin_plan_open_trainer(const struct spin_plan *plan, struct spin_device *device,
                                   struct spin_trainer_size *size, struct spin_trainer *trainer);

/* Bytes for refining one frame, assuming that its points double. */
size_t spin_plan_refine_bytes(const struct spin_plan *plan);
/* SPIN_E_MEMORY if the run needs more than is available. */
spin_status spin_plan_check_memory(const struct spin_plan *plan);
/* Call it after refinement: the clip has these numbers of splats [frames], and memory is planned
 * again. held: bytes of decoded images that are already cached. */
spin_status spin_plan_recount(struct spin_plan *plan, const size_t *counts, size_t held);
