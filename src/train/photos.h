/* The training and test images of a run, with masks of dynamic pixels. Decoded images are cached
 * within a memory budget. Not thread-safe. */
#pragma once

#include "eval/dynamic_mask.h"
#include "eval/matte.h"
#include "render/image_store.h"
#include "train/plan.h"
#include "train/step.h"
#include "eval/metrics.h"
#include "train/train_frame.h"

struct spin_photos {
    struct spin_image_cache cache;
    /* Masks of dynamic pixels; used only if --dynamic-weight is not 1 (spin_plan_is_weighted()). */
    struct spin_dynamic_mask dynamic;
    struct spin_mattes mattes; /* used if --learn-alpha is auto and the images show a subject */
    /* Scratch for an image [max pixels][3], followed by a mask of one bit per pixel. */
    uint8_t *image;
    uint64_t *digest; /* [views] digest of each view; 0 for views that are not used */
};

/* Zero the struct before the call, and close it also after a failure. */
spin_status spin_photos_open(struct spin_photos *photos, const struct spin_plan *plan);
void spin_photos_close(struct spin_photos *photos);
/* Checks all image files that the run needs, without decoding them, so that a missing or truncated
 * file is reported before the training starts. Computes the digests of the training views. */
spin_status spin_photos_check_images(struct spin_photos *photos, const struct spin_plan *plan);
/* Measures plan->edges and plan->empty in a few training images, and updates the estimates of the
 * plan. */
spin_status spin_photos_measure_content(struct spin_photos *photos, struct spin_plan *plan);
/* Returns a digest of the training images of a frame, with their masks and cameras; frame -1 means
 * all frames. Results of an earlier run are reused only if the digest is the same. */
uint64_t spin_photos_digest(const struct spin_photos *photos, const struct spin_plan *plan,
                            int frame);
/* Decides whether to learn alpha, and if so, opens the mattes of the training images.
 * --learn-exposure auto must have been resolved before, since alpha is not learned together with
 * exposures. */
spin_status spin_photos_choose_alpha(struct spin_photos *photos, struct spin_plan *plan);
/* Reserves device memory for n images, with masks and mattes if they are used. */
spin_status spin_photos_open_store(const struct spin_photos *photos, const struct spin_plan *plan,
                                   struct spin_device *device, size_t n,
                                   struct spin_image_store *store);
/* Uploads the image of a view, with its mask and matte, to slot `number` of a store. */
spin_status spin_photos_put(struct spin_photos *photos, const struct spin_plan *plan, size_t view,
                            struct spin_image_store *store, uint32_t number);

/* ---- Views of an iteration ------------------------------------------------------------------- */

/* Chooses the views of each iteration and loads their images. */

struct spin_sampler {
    const struct spin_plan *plan;
    struct spin_photos *photos;
    /* [n_train] indices of the plan's training pairs, in the order of the current epoch, followed
     * by [2 n_train] of scratch. */
    uint32_t *sequence;
    int64_t epoch; /* epoch of `sequence`; -1 before the first epoch */
    uint64_t seed;
    /* Cache of images on the device, with the index of the view as the key. Its capacity is at
     * least a batch. */
    struct spin_image_store images;
    struct spin_train_item *items;  /* [batch] images of the current iteration */
    const struct spin_pair **pairs; /* [batch] frame and view of each item */
};

/* Opens a sampler for the plan's device. The sampler of a single frame loads all images of the
 * frame at once, since several frames are trained in parallel and spin_photos is not thread-safe.
 * Zero *sampler before the call, and close it also after a failure. */
spin_status spin_sampler_open(struct spin_sampler *sampler, const struct spin_plan *plan,
                              struct spin_photos *photos);
void spin_sampler_close(struct spin_sampler *sampler);
/* Chooses the views of an iteration, counted from 0, and loads the images of the views that this
 * rank renders. The choice depends only on the seed and the iteration. If the number of pairs is
 * not a multiple of the batch size, the last pairs of an epoch are not used in that epoch. */
spin_status spin_sampler_batch(struct spin_sampler *sampler, int64_t iteration);
/* Returns the frame of item k of the iteration after the one whose batch was loaded last; -1 if
 * that is the first iteration of an epoch, whose order is not known yet. */
int spin_sampler_next_frame(const struct spin_sampler *sampler, int64_t iteration, size_t k);

/* ---- Test views ------------------------------------------------------------------------------ */

/* Measures the quality of the test views during and after training, and writes previews of them
 * (--preview). */

/* Renders the test views with the player `shown` and measures their quality. live_counts: see
 * struct spin_metrics. `what` names the work in the progress display. */
spin_status spin_test_views_measure(const struct spin_plan *plan, struct spin_photos *photos,
                                    struct spin_player *shown, const size_t *live_counts,
                                    const char *what, struct spin_quality *out);
/* Measures the quality of the splats before the training: with --method 4d, of the retrained clip
 * in the bundle; with other methods, of the source. If the source lacks attributes, nothing is
 * measured and out->valid is false. */
spin_status spin_test_views_measure_input(struct spin_plan *plan, struct spin_photos *photos,
                                          struct spin_device *device, struct spin_quality *out);
/* Writes one PNG of the middle frame of the clip for each test camera, with three images side by
 * side: the captured image, the source (omitted if it lacks attributes), and the render of `shown`.
 * File names end in `label`. Does nothing without --preview. A failure to write is only a warning,
 * see spin_plan_beside(). */
spin_status spin_test_views_preview(struct spin_plan *plan, struct spin_photos *photos,
                                    struct spin_player *shown, const char *label);
/* Removes from this folder all files named as spin_test_views_preview() names them, and logs their
 * number. Previews of an earlier training would otherwise remain beside those of the new one and
 * look like its later iterations. Does nothing if the folder cannot be read. */
void spin_previews_remove(const char *folder);

/* ---- Splats that no training camera sees ----------------------------------------------------- */

/* Initial values of splats that are not visible in any training view. */

/* Changes points of `cloud`, the initial values of frame f, which were made from the splats s with
 * an opacity of 0.1. Training raises this opacity, but never changes splats that are not visible in
 * any training view: they would remain faint and leave holes in other views. This function gives
 * such splats the attributes of the source or, if the source consists of points, an opacity of 0.8.
 * It sets the member `seen` of all other points to 1. */
spin_status spin_show_unseen(const struct spin_plan *plan, const struct spin_splats *s, int f,
                             struct spin_refine_cloud *cloud);
