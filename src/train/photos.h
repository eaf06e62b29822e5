/* The training and test images of a run, with masks of dynamic pixels. Decoded images are cached as
 * far as memory allows. Not thread-safe. */
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
    /* Masks of dynamic pixels; used only if these have another weight (spin_plan_is_weighted()). */
    struct spin_dynamic_mask dynamic;
    struct spin_mattes mattes; /* used if --learn-alpha is auto and the images show a subject */
    /* Scratch: an image [max pixels][3], followed by a mask of one bit per pixel or a matte. */
    uint8_t *image;
    uint64_t *digest; /* [views] digest of each training image */
};

/* Zero it first; close it also after a failure. */
spin_status spin_photos_open(struct spin_photos *photos, const struct spin_plan *plan);
void spin_photos_close(struct spin_photos *photos);
/* Checks every image that the run will need, without decoding it, so that a missing or truncated
 * image is reported before the training starts. Computes the digests of the training images. */
spin_status spin_photos_check_images(struct spin_photos *photos, const struct spin_plan *plan);
/* Returns a digest of the images, masks and cameras that a frame is trained on or, with frame -1,
 * of those of all frames. Results of an earlier run are reused only if it had the same digest. */
uint64_t spin_photos_digest(const struct spin_photos *photos, const struct spin_plan *plan,
                            int frame);
/* Chooses whether the alpha of the training images is learned, and opens their mattes. Exposures
 * must have been chosen. */
spin_status spin_photos_choose_alpha(struct spin_photos *photos, struct spin_plan *plan);
/* Reserves device memory for n images with their masks and mattes. */
spin_status spin_photos_open_store(const struct spin_photos *photos, const struct spin_plan *plan,
                                   struct spin_device *device, size_t n,
                                   struct spin_image_store *store);
/* Copies the image of a view, with its mask and matte, into a store as image `number`. */
spin_status spin_photos_put(struct spin_photos *photos, const struct spin_plan *plan, size_t view,
                            struct spin_image_store *store, uint32_t number);

/* ---- Views of an iteration ------------------------------------------------------------------- */

/* Chooses the views of each iteration and loads their images. */

struct spin_sampler {
    const struct spin_plan *plan;
    struct spin_photos *photos;
    /* [n_train] indices of the plan's training pairs, in the order of this epoch; then scratch of
     * [2 n_train]. */
    uint32_t *sequence;
    int64_t epoch; /* epoch of the current sequence; -1 if there is none yet */
    uint64_t seed;
    /* Images on the device, found by their view. Holds as many as fit, but at least a batch. */
    struct spin_image_store images;
    struct spin_train_item *items;  /* [batch] images of this iteration */
    const struct spin_pair **pairs; /* [batch] frame and view of each item */
};

/* Opens a sampler for the plan's device. The sampler of a single frame loads all its images now,
 * since frames are then trained in parallel and spin_photos is not thread-safe. Zero the sampler
 * first; close it also after a failure. */
spin_status spin_sampler_open(struct spin_sampler *sampler, const struct spin_plan *plan,
                              struct spin_photos *photos);
void spin_sampler_close(struct spin_sampler *sampler);
/* Chooses the views of an iteration, numbered from 0, and loads those of their images that this
 * rank renders. The choice depends only on the seed and the iteration. If the batch size does not
 * divide the number of pairs, the pairs that remain at the end of an epoch are not used in it. */
spin_status spin_sampler_batch(struct spin_sampler *sampler, int64_t iteration);

/* ---- Test views ------------------------------------------------------------------------------ */

/* Measures the quality of the test views during and after training, and writes previews of them
 * (--preview). */

/* Renders the test views with the player `shown` and measures their quality. live_counts: see
 * metrics.h. `what` names the work in the progress display. */
spin_status spin_test_views_measure(const struct spin_plan *plan, struct spin_photos *photos,
                                    struct spin_player *shown, const size_t *live_counts,
                                    const char *what, struct spin_quality *out);
/* Measures the quality of the splats that the training starts from: with --method 4d the clip that
 * an earlier training wrote to the bundle, with other methods the source. If the source is needed
 * and the bundle lacks some of its attributes, nothing is measured and out->valid is false. */
spin_status spin_test_views_measure_input(struct spin_plan *plan, struct spin_photos *photos,
                                          struct spin_device *device, struct spin_quality *out);
/* Writes one PNG for each test camera, of the middle frame of the clip. It shows side by side: the
 * captured image, the source if the bundle has all its attributes, and the image rendered by
 * `shown`. File names end in `label`. Does nothing without --preview. A failure to write is handled
 * by spin_plan_beside(). */
spin_status spin_test_views_preview(struct spin_plan *plan, struct spin_photos *photos,
                                    struct spin_player *shown, const char *label);

/* ---- Splats that no training camera sees ----------------------------------------------------- */

/* Sets the initial values of splats that are not visible to any training camera. */

/* Changes the points of `cloud`, which are the initial values of frame f, made from the splats s as
 * faint points, since training makes them opaque. Training never changes splats that are not
 * visible to any training camera: they would stay faint and leave holes in other views. Such splats
 * get the attributes of the source or, if the source consists of points, a high opacity. All other
 * points of the cloud are marked as seen. */
spin_status spin_show_unseen(const struct spin_plan *plan, const struct spin_splats *s, int f,
                             struct spin_refine_cloud *cloud);
