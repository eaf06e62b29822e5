/* One retraining under way, in four files: retrain.c from start to end and the output,
 * retrain_plan.c options to shapes, memory and time, retrain_state.c save and resume, retrain_loop.c
 * the iterations. Nothing outside of them needs this. */
#ifndef SPIN_CORE_RETRAIN_H
#define SPIN_CORE_RETRAIN_H

#include <stdio.h>

#include "core/clip.h"
#include "core/train.h"

struct spin_retraining {
    const struct spin_retrain_options *o;
    struct spin_retrain_report *report;
    struct spin_clip clip;
    struct spin_pixels pixels;
    struct spin_device device;
    struct spin_model model;
    struct spin_trainer trainer;
    size_t *counts;            /* [frames] splats */
    uint32_t **order;          /* [frames][n] the source's row at each place of ours */
    struct spin_splats splats; /* scratch of one frame */
    int *camera;               /* [n_cameras] ids of the training cameras, ascending */
    int n_cameras;
    struct spin_pair *train, *test; /* pairs (frame, view) */
    size_t n_train, n_test;
    uint32_t *sequence; /* [n_train] of the present epoch */
    int64_t epoch;      /* sequence belongs to; -1 none */
    float *truth;       /* [batch][3][max pixels] host */
    size_t max_pixels, max_tiles;
    double extent, scale_bias;
    char *part;        /* path of the unfinished state */
    char *fingerprint; /* what must be equal for a resume */
    FILE *log;
    double worked_s, saved_s;
    double worked_before_s;
};

/* ---- retrain_plan.c ---- */

spin_status spin_retrain_check(const struct spin_retrain_options *o);
/* The clip with its views; counts, pairs, cameras, extent. */
spin_status spin_retrain_open_clip(struct spin_retraining *r);
/* A frame's place in the bundle, and what is known of it. */
int spin_retrain_index(const struct spin_retraining *r, int frame);
const struct spin_frame_info *spin_retrain_info(const struct spin_retraining *r, int frame);
/* Where a frame's splats start, into r->splats. */
spin_status spin_retrain_means(struct spin_retraining *r, int frame);
/* Place of a training camera in r->camera. */
int spin_retrain_camera(const struct spin_retraining *r, int id);
/* The model's geometry, and the memory that the run takes. */
spin_status spin_retrain_plan(struct spin_retraining *r);
/* Seconds that it will take, roughly. */
double spin_retrain_guess(const struct spin_retraining *r);
/* Whether the table is lazy: a step's splats need less than half of it. */
bool spin_retrain_is_lazy(const struct spin_retraining *r);

/* ---- retrain_state.c ---- */

/* The "network" object of meta.json. */
spin_json *spin_retrain_to_json(const struct spin_retraining *r);
spin_status spin_retrain_fingerprint(struct spin_retraining *r);
/* Choose r->order. */
spin_status spin_retrain_sort(struct spin_retraining *r);
/* First values of everything that is trained; or the unfinished state. */
spin_status spin_retrain_begin(struct spin_retraining *r);
spin_status spin_retrain_save(struct spin_retraining *r);
spin_status spin_retrain_load(struct spin_retraining *r);
/* An array on the device into an archive, through a host copy. */
spin_status spin_retrain_write_array(struct spin_retraining *r, struct spin_zip_writer *w,
                                     const char *name, int n_dims, const uint64_t *shape,
                                     const float *at, size_t n);

/* ---- retrain_loop.c ---- */

/* All iterations that are left. */
spin_status spin_retrain_loop(struct spin_retraining *r);
/* The bundle has all attributes of its source. */
bool spin_retrain_has_source(const struct spin_retraining *r);
/* Quality on the test views: of the network as it stands, or of the source. */
spin_status spin_retrain_measure(struct spin_retraining *r, bool network, struct spin_quality *out);
/* Measure the network, say so, draw the previews. */
spin_status spin_retrain_look(struct spin_retraining *r);

#endif
