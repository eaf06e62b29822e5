/* The plan of a retraining: checked options, the clip with its views, shapes, memory and time. All
 * later stages read it; those that change the number of splats or measure exposures update it. */
#pragma once

#include "spin_train.h"
#include "eval/metrics.h"
#include "device/device.h"
#include "model/field.h"
#include "scene/lens.h"
#include "train/cloud.h"
#include "train/trainer.h"

struct spin_retrain_report {
    struct spin_retrain_options options; /* the given options, with numbers resolved for the clip */
    int iterations;
    int densify_every; /* iterations between densifications of the clip; 0: none */
    double seconds, seconds_per_iteration; /* latter NaN: FRAMES reused all frames */
    int frames;
    double splats_mean;
    char device[64];
    struct spin_quality before, refined, test;
    double refine_seconds;                /* part of `seconds` that refinement took */
    double outside_ball;                  /* share of points outside the unit ball of the encoder */
    size_t bytes_needed, bytes_available; /* bytes_available 0: unknown */
    char fitting[96];         /* if memory is short: options that would fit; empty: none found */
    size_t bytes_peak;        /* largest memory use of this process */
    double seconds_estimated; /* dry run only */
    int ranks;                /* processes that share the work */
    double bytes_sent;        /* dry run only: upper bound for all ranks in one iteration */
    /* First error in writing files beside the output; empty: none. */
    char incomplete[512];
    /* Smoothed loss at the end. With --method frames: the mean of the last losses of the frames
     * that this run refined; NaN if there were none. */
    double loss_last;
};

/* See backdrop.h. */
struct spin_backdrop {
    size_t n;                    /* splats; 0: no backdrop */
    struct spin_refine_row *row; /* [n] initial values */
};

struct spin_plan {
    struct spin_retrain_options options;  /* options of a single frame's plan; else unused */
    const struct spin_retrain_options *o; /* &report->options, or a single frame's &options */
    struct spin_retrain_report *report;   /* every stage writes its own fields */
    struct spin_device *device;           /* device of the run, owned by the caller */
    struct spin_clip clip;
    struct spin_field field; /* the scene transform is set by frames.c */
    size_t *counts;    /* [frames] numbers of splats, updated by refinement and the backdrop */
    size_t n_of_frame; /* `counts` of a single frame's plan; else unused */
    size_t n_rows;     /* 4D splats, with --method 4d */
    int *camera;       /* [n_cameras] ids of the training cameras, ascending */
    int n_cameras;
    struct spin_lenses lenses; /* lenses of the training cameras */
    bool lenses_stay;          /* falloffs are fixed: only gains and offsets learn */
    /* [n_cameras + lenses.n][SPIN_EXPOSURE] initial values: of cameras, then of lenses. */
    float *exposure;
    struct spin_pair *train, *test; /* pairs (frame, view) */
    size_t n_train, n_test;
    size_t max_pixels, max_tiles; /* size of the largest view */
    struct spin_backdrop backdrop;
    double extent;        /* extent of the training cameras, in world units */
    size_t pixels_budget; /* bytes of decoded images to cache */
    char *part;           /* path of the checkpoint */
    char *clip_of_state; /* path of the clip that an interrupted run leaves beside the checkpoint */
    char *parts;         /* folder of the frames refined so far */
};

/* Plans everything except device and memory. Zero it first; close it also after a failure. */
spin_status spin_plan_open(struct spin_plan *plan, const struct spin_retrain_options *o,
                           struct spin_retrain_report *report);
void spin_plan_close(struct spin_plan *plan);
/* Handles the status of writing a file beside the output. A failure does not end the training: the
 * first one becomes a warning and is stored in report->incomplete. Returns SPIN_E_CANCELLED for
 * that status, otherwise SPIN_OK. */
spin_status spin_plan_beside(const struct spin_plan *plan, spin_status status);
/* Sets the device of the run, and estimates memory and seconds for the report. */
void spin_plan_set_device(struct spin_plan *plan, struct spin_device *device);

/* A frame's index in the bundle. */
int spin_plan_index(const struct spin_plan *plan, int frame);
/* A frame's description in the bundle. */
const struct spin_frame_info *spin_plan_info(const struct spin_plan *plan, int frame);
/* The middle frame of the clip, or the next one that has splats. */
int spin_plan_middle_frame(const struct spin_plan *plan);
/* Fails if a mean of a frame is not finite, naming the array and the row. refined: the means are
 * those of a refined frame. */
spin_status spin_plan_check_means(const struct spin_plan *plan, int frame, bool refined,
                                  const struct spin_splats *s);
/* Index in plan->camera of the training camera with this id, which must exist. */
int spin_plan_camera(const struct spin_plan *plan, int id);
/* True if the bundle has all attribute columns of its source. */
bool spin_plan_has_source(const struct spin_plan *plan);
/* True if splats have residual values: with --residual or --tracks. */
bool spin_plan_has_residual(const struct spin_plan *plan);
/* True if the training of the clip densifies tracks and splats without a track. Refined frames are
 * not densified again. */
bool spin_plan_densifies(const struct spin_plan *plan);
/* Densification runs in each iteration that is a multiple of `every`, after `first` and before
 * `until`; every 0: never. */
struct spin_schedule {
    int64_t first, until;
    int every;
};
struct spin_schedule spin_plan_schedule(const struct spin_plan *plan);
/* Sizes of a frame with n splats. Assumes that none has a track, since tracks are found later. */
struct spin_frame_size spin_plan_frame_size(const struct spin_plan *plan, size_t n);
/* True if pixels have different weights (--dynamic-weight). */
bool spin_plan_is_weighted(const struct spin_plan *plan);
/* True if the table uses lazy Adam: the device supports it, there is one rank, and the splats of an
 * iteration need less than half of the table. */
bool spin_plan_is_lazy(const struct spin_plan *plan);

/* Bytes of an image on the device, with its mask if pixels have different weights. */
size_t spin_plan_image_bytes(const struct spin_plan *plan);
/* The SH degree in the last of `iterations` iterations, if it rises from 0 by one every
 * `increase_every` iterations up to sh_degree. increase_every 0: sh_degree from the start. */
int spin_sh_degree_reached(int sh_degree, int increase_every, int iterations);
/* SH degree that frames reach with --method frames, at most that of the source if they start from
 * it; 0 for other methods. */
int spin_plan_frame_sh_degree(const struct spin_plan *plan);
/* Iterations after which the SH degree of a single frame rises by one; 0: full degree from the
 * start, as for frames that start from the source's attributes. */
int spin_plan_sh_increase_every(const struct spin_plan *plan);
/* True if single frames start from the source's attributes, false for coloured points. */
bool spin_plan_starts_from_source(const struct spin_plan *plan);
/* Columns of the source that single frames start from. */
unsigned spin_plan_start_columns(const struct spin_plan *plan);
/* Columns of the source that coloured points are made from. Includes the attributes, which are the
 * initial values of splats that no camera sees (unseen.h). */
unsigned spin_plan_point_columns(const struct spin_plan *plan);
/* Plan of a single frame on its own device: a clip of one frame with its training views. The plan
 * points into the clip's plan and into itself, so it must not be moved. Zero it first; close it
 * also after a failure. */
spin_status spin_plan_of_frame(const struct spin_plan *clip, int frame, struct spin_device *device,
                               struct spin_plan *plan);
void spin_plan_close_frame(struct spin_plan *plan);

/* Opens a trainer for the plan and sets its rates. The caller sets the frames and tracks in *size;
 * the function sets its other members. */
spin_status spin_plan_open_trainer(const struct spin_plan *plan, struct spin_device *device,
                                   struct spin_trainer_size *size, struct spin_trainer *trainer);

/* Bytes for refining one frame, assuming that its points double. */
size_t spin_plan_refine_bytes(const struct spin_plan *plan);
/* SPIN_E_MEMORY if the run needs more than is available. */
spin_status spin_plan_check_memory(const struct spin_plan *plan);
/* Updates the plan after refinement: sets the numbers of splats [frames] and estimates memory
 * again. held: bytes of decoded images that are already cached. */
spin_status spin_plan_recount(struct spin_plan *plan, const size_t *counts, size_t held);
