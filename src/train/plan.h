/* A retraining before it begins: options checked, the clip with its views, shapes, memory and time.
 * Every later stage reads the plan; only refinement changes it, when it changes the number of
 * splats. */
#pragma once

#include "spin_train.h"
#include "eval/metrics.h"
#include "device/device.h"
#include "model/field.h"
#include "scene/lens.h"
#include "train/cloud.h"
#include "train/trainer.h"

struct spin_retrain_report {
    struct spin_retrain_options
        options; /* as given, with the numbers that were chosen for the clip */
    int iterations;
    int densify_every; /* iterations between densifications of the clip; 0: none */
    double seconds,
        seconds_per_iteration; /* NAN: no frame was left to refine, and nothing else done */
    int frames;
    double splats_mean;
    char device[64];
    struct spin_quality before, refined, test;
    double refine_seconds;                /* part of seconds */
    double outside_ball;                  /* share of points outside the unit ball at the encoder */
    size_t bytes_needed, bytes_available; /* available 0: it is not known */
    char fitting[96];  /* options that would fit, when these do not; empty: none were found */
    size_t bytes_peak; /* of this process, when the work is done */
    double seconds_estimated; /* dry run */
    int ranks;                /* processes that share the work */
    double bytes_sent;        /* dry run: by all of them in a step, at most */
    char incomplete[512]; /* why something beside the output was not written, at first; empty: all
                             was */
    double loss_last;     /* smoothed; of frames refined now, their mean, or NAN: there were none */
};

/* See backdrop.h. */
struct spin_backdrop {
    size_t n;                    /* splats; 0: there is none */
    struct spin_refine_row *row; /* [n] first values */
};

struct spin_plan {
    struct spin_retrain_options options;  /* of a frame by itself */
    const struct spin_retrain_options *o; /* as the report has them */
    struct spin_retrain_report *report;   /* every stage writes its own fields */
    struct spin_device *device;           /* where the run works; the caller's */
    struct spin_clip clip;
    struct spin_field field; /* the scene transform is set by frames.c */
    size_t *counts;          /* [frames] splats; of the refined frames once there are some */
    size_t n_of_frame;       /* the one count of a frame by itself */
    size_t n_rows;           /* 4D splats, with --method 4d */
    int *camera;             /* [n_cameras] ids of the training cameras, ascending */
    int n_cameras;
    struct spin_lenses lenses; /* of the training cameras */
    bool lenses_stay;          /* as they begin: only gains and offsets learn */
    float *exposure; /* [n_cameras + lenses.n][SPIN_EXPOSURE] what training begins with: of cameras,
                        then of lenses */
    struct spin_pair *train, *test; /* pairs (frame, view) */
    size_t n_train, n_test;
    size_t max_pixels, max_tiles; /* of the largest view */
    struct spin_backdrop backdrop;
    double extent;        /* of the training cameras, in world units */
    size_t pixels_budget; /* bytes of decoded images that are kept */
    char *part;           /* path of the unfinished state */
    char *clip_of_state;  /* of the clip as it was then, which an interrupt leaves */
    char *parts;          /* folder of the frames refined so far */
};

/* All but what depends on the device. Zero the plan first; close it also after a failure. */
spin_status spin_plan_open(struct spin_plan *plan, const struct spin_retrain_options *o,
                           struct spin_retrain_report *report);
void spin_plan_close(struct spin_plan *plan);
/* What is written beside the output ends no training: a failure is a warning, once, and stays in
 * report->incomplete. Returns the status only of an interrupt. */
spin_status spin_plan_beside(const struct spin_plan *plan, spin_status status);
/* Where the run works: its memory and seconds go into the report. */
void spin_plan_set_device(struct spin_plan *plan, struct spin_device *device);

/* A frame's place in the bundle, and what is known of it. */
int spin_plan_index(const struct spin_plan *plan, int frame);
const struct spin_frame_info *spin_plan_info(const struct spin_plan *plan, int frame);
/* The clip's middle frame, or the next that has points. */
int spin_plan_middle_frame(const struct spin_plan *plan);
/* Means of a frame of the source, or refined, are finite; else an error that names the array and
 * the row. */
spin_status spin_plan_check_means(const struct spin_plan *plan, int frame, bool refined,
                                  const struct spin_splats *s);
/* Place of a training camera in plan->camera. */
int spin_plan_camera(const struct spin_plan *plan, int id);
/* The bundle has all attributes of its source. */
bool spin_plan_has_source(const struct spin_plan *plan);
/* Splats have residual values, to which the network adds. */
bool spin_plan_has_residual(const struct spin_plan *plan);
/* Tracks, and splats without one, are densified; refined frames, which were before, are not. */
bool spin_plan_densifies(const struct spin_plan *plan);
/* Densification comes after `first` and before `until`, every so many iterations; every 0: never.
 */
struct spin_schedule {
    int64_t first, until;
    int every;
};
struct spin_schedule spin_plan_schedule(const struct spin_plan *plan);
/* What a frame of n splats has of its own, as far as the points have not been looked at. */
struct spin_frame_size spin_plan_frame_size(const struct spin_plan *plan, size_t n);
/* Pixels do not all count alike (--dynamic-weight). */
bool spin_plan_is_weighted(const struct spin_plan *plan);
/* Whether the table takes lazy Adam: the device has it, and a step's splats need less than half of
 * the table. */
bool spin_plan_is_lazy(const struct spin_plan *plan);

/* Bytes of an image on the device, with its mask where pixels do not all count alike. */
size_t spin_plan_image_bytes(const struct spin_plan *plan);
/* The highest SH degree that so many iterations come to, of at most sh_degree, when a degree joins
 * every `increase_every`; 0: all from the start. */
int spin_sh_degree_reached(int sh_degree, int increase_every, int iterations);
/* SH degree that frames come to which the explicit method optimises, from a source at most that of
 * the source; refined for a network they have 0. */
int spin_plan_frame_sh_degree(const struct spin_plan *plan);
/* Iterations until the next degree joins; 0: all from the start, as what a source has learned. */
int spin_plan_sh_increase_every(const struct spin_plan *plan);
/* Frames by themselves start from the source's attributes; else from coloured points. */
bool spin_plan_starts_from_source(const struct spin_plan *plan);
/* The source's columns that they start from; those that coloured points are made of, and what no
 * camera sees. */
unsigned spin_plan_start_columns(const struct spin_plan *plan);
unsigned spin_plan_point_columns(const struct spin_plan *plan);
/* The plan of a frame by itself, on its own device: a clip of one frame, with its training views.
 * It holds on to the clip's plan, and must not be moved. Zero it first; close it also after a
 * failure. */
spin_status spin_plan_of_frame(const struct spin_plan *clip, int frame, struct spin_device *device,
                               struct spin_plan *plan);
void spin_plan_close_frame(struct spin_plan *plan);

/* A trainer for the plan, with its rates: size has frames and tracks, the plan fills in what else
 * there is. */
spin_status spin_plan_open_trainer(const struct spin_plan *plan, struct spin_device *device,
                                   struct spin_trainer_size *size, struct spin_trainer *trainer);

/* Bytes of one frame that is being refined, should its points double. */
size_t spin_plan_refine_bytes(const struct spin_plan *plan);
/* SPIN_E_MEMORY when the run needs more than there is. */
spin_status spin_plan_check_memory(const struct spin_plan *plan);
/* Refinement is over: the clip's splats are these [frames], and the memory is planned anew. held:
 * bytes of decoded images that are kept by now. */
spin_status spin_plan_recount(struct spin_plan *plan, const size_t *counts, size_t held);
