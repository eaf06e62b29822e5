/* One retraining under way, in seven files: retrain.c from start to end and the output, retrain_plan.c
 * options to shapes, memory and time, retrain_images.c what it learns from, retrain_state.c save and
 * resume, retrain_own.c what splats have of their own, retrain_refine.c the frame-wise stage,
 * retrain_loop.c the iterations of the network.
 * Nothing outside of them needs this. */
#ifndef SPIN_TRAIN_RUN_H
#define SPIN_TRAIN_RUN_H

#include <stdio.h>

#include "eval/metrics.h"
#include "eval/dynamic_mask.h"
#include "device/clock.h"
#include "train/frame_cache.h"
#include "train/step.h"
#include "io/claim.h"

/* A frame of the frame-wise stage. */
struct spin_refined {
    char key[SPIN_FRAME_KEY]; /* what it is made from and how */
    bool from_input;          /* the input has it; else it is on the shelf */
    size_t n;                 /* splats */
};

struct spin_run {
    const struct spin_retrain_options *o;
    struct spin_retrain_report *report;
    struct spin_clip clip;
    struct spin_image_cache pixels;
    struct spin_device device;
    struct spin_field field;
    struct spin_trainer trainer;
    size_t *counts;            /* [frames] splats; of the refined frames once there are some */
    uint32_t **permutation;    /* [frames][n] the source's row at each place of ours */
    struct spin_splats splats; /* scratch of one frame */
    int *camera;               /* [n_cameras] ids of the training cameras, ascending */
    int n_cameras;
    struct spin_pair *train, *test; /* pairs (frame, view) */
    size_t n_train, n_test;
    uint32_t *sequence; /* [n_train] of the present epoch; [2 n_train] more for making it */
    int64_t epoch;      /* sequence belongs to; -1 none */
    float *truth;       /* [batch][3][max pixels] host */
    float *weight;      /* [batch][max pixels] host; NULL: all pixels count alike */
    struct spin_dynamic_mask dynamic; /* where they do not */
    size_t max_pixels, max_tiles;
    size_t pixels_budget; /* bytes of decoded images that are kept */
    double extent, init_log_scale;
    struct spin_refined *refined; /* [frames], or NULL: frames are not refined */
    bool is_refined;              /* that stage is over */
    struct spin_splats shelved;   /* scratch of one refined frame */
    uint64_t *imprint;            /* [views] what views that are learned from are told by */
    struct spin_claim claim;      /* on the output */
    char *part;                   /* path of the unfinished state */
    char *parts;                  /* folder of the frames refined so far */
    char *fingerprint;            /* what must be equal for a resume */
    char paths[32];     /* code paths that did the work: "v4", or "v3+v4" after a resume */
    bool sound;         /* the trainer stands between two steps */
    int64_t saved;      /* iteration of the state that is kept; -1: none is */
    FILE *log;          /* NULL: none is written, or no longer */
    char log_error[96]; /* why no longer */
    double worked_s, saved_s;
    double worked_before_s;
    double spent_s[SPIN_N_OPS], stepped_s; /* of all steps: each op, and on the wall */
};

/* ---- retrain_plan.c ---- */

spin_status spin_run_check(const struct spin_retrain_options *o);
/* The clip with its views; counts, pairs, cameras, extent. */
spin_status spin_run_open_clip(struct spin_run *r);
/* A frame's place in the bundle, and what is known of it. */
int spin_run_index(const struct spin_run *r, int frame);
const struct spin_frame_info *spin_run_info(const struct spin_run *r, int frame);
/* Where a frame's splats start, into r->splats. */
spin_status spin_run_means(struct spin_run *r, int frame);
/* Place of a training camera in r->camera. */
int spin_run_camera(const struct spin_run *r, int id);
/* The model's geometry, and the memory that the run takes. */
spin_status spin_run_plan(struct spin_run *r);
/* Seconds that it will take, roughly. */
double spin_run_guess(const struct spin_run *r);
/* Whether the table is lazy: a step's splats need less than half of it. */
bool spin_run_is_lazy(const struct spin_run *r);

/* ---- retrain_images.c ---- */

/* Look at every image that the run will need, and take the imprints of those it learns from. */
spin_status spin_run_look_at_images(struct spin_run *r);
/* What a frame is learned from, as a number: images, masks and cameras. frame -1: all frames. */
uint64_t spin_run_imprint(const struct spin_run *r, int frame);

/* ---- retrain_state.c ---- */

/* The "network" object of meta.json. */
spin_json *spin_run_to_json(const struct spin_run *r);
spin_status spin_run_fingerprint(struct spin_run *r);
/* Choose r->permutation. */
spin_status spin_run_sort(struct spin_run *r);
/* First values of everything that is trained; or the unfinished state. */
spin_status spin_run_begin(struct spin_run *r);
spin_status spin_run_save(struct spin_run *r);
spin_status spin_run_load(struct spin_run *r);
/* All parameters are finite; else an error that names the array and the iteration. */
spin_status spin_run_check_finite(struct spin_run *r);
/* Part of the work was done before by these code paths, "v3" or "v3+v4". */
void spin_run_did(struct spin_run *r, const char *paths);
/* An array on the device into an archive, piece by piece through the host. Its values must be finite. */
spin_status spin_run_write_array(struct spin_run *r, struct spin_zip_writer *w, const char *name,
                                 int n_dims, const uint64_t *shape, const float *at, size_t n);

/* ---- retrain_own.c ---- */

/* Splats have values of their own, to which the network adds. */
bool spin_run_has_residual(const struct spin_run *r);
void spin_run_residual_rates(const struct spin_run *r, double rate[SPIN_HEADS]);
/* First values of a frame. */
spin_status spin_run_residual_begin(struct spin_run *r, int frame);
spin_status spin_run_write_residual(struct spin_run *r, struct spin_bundle_writer *w, int frame);

/* ---- retrain_refine.c ---- */

/* Room for what is known of every frame; nothing is done yet. */
spin_status spin_run_refine_plan(struct spin_run *r);
/* What every frame will be made from. */
spin_status spin_run_refine_keys(struct spin_run *r);
/* Settings that decide the result. */
spin_json *spin_run_refine_settings(const struct spin_run *r);
/* Memory of one frame under way, should its points double. */
size_t spin_run_refine_bytes(const struct spin_run *r);
/* Refine all frames that are not there yet, and look at them. */
spin_status spin_run_refine(struct spin_run *r);
/* Columns of a refined frame. */
spin_status spin_run_refined(struct spin_run *r, int frame, unsigned columns,
                             struct spin_splats *out);
spin_status spin_run_write_refined(struct spin_run *r, struct spin_bundle_writer *w);
/* The "refined" object of meta.json. */
spin_json *spin_run_refined_to_json(const struct spin_run *r);

/* ---- retrain_loop.c ---- */

/* After a line, and with flush at once: a log that cannot be written ends here, with a warning. */
void spin_run_logged(struct spin_run *r, bool flush);

/* All iterations that are left. */
spin_status spin_run_loop(struct spin_run *r);
/* How often the pixels of a view count, [h][w]; only with --dynamic-weight. Not for two threads. */
spin_status spin_run_weigh(struct spin_run *r, size_t view, const float *truth, float *weight);
/* The bundle has all attributes of its source. */
bool spin_run_has_source(const struct spin_run *r);
/* Quality on the test views: of what a player shows. live_counts as in measure.h. */
spin_status spin_run_measure(struct spin_run *r, struct spin_frame_renderer *frame_renderer,
                             const size_t *live_counts, const char *what, struct spin_quality *out);
spin_status spin_run_measure_source(struct spin_run *r, struct spin_quality *out);
/* Pictures for --preview: of what a live player or a reader shows, with this at the end of their names. */
spin_status spin_run_preview(struct spin_run *r, struct spin_frame_renderer *shown,
                             const char *label);
/* Measure the network, say so, draw the previews. */
spin_status spin_run_look(struct spin_run *r);

#endif
