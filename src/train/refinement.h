/* Refinement, the first stage of a retraining (docs/method.md section 2): each frame is optimised
 * independently. */
#pragma once

#include "train/key.h"
#include "train/step.h"
#include "spin.h"

/* ---- Cache of refined frames ----------------------------------------------------------------- */

/* Cache of the refined frames of an unfinished run: a folder with one small bundle for each frame.
 * Bundles are written atomically, and contain a key that identifies the inputs and options of the
 * frame (key.h). A run that was killed can therefore be resumed with all frames that it finished.
 */

/* A cached frame. */
struct spin_shelved {
    size_t n;      /* number of splats */
    char path[16]; /* SIMD path of the device that refined the frame */
};

/* Adds frame `index` of the bundle to the cache: all attribute columns of `splats`, the key, and
 * the SIMD path of the device that refined the frame. Creates the folder if necessary. */
spin_status spin_frame_cache_put(const char *folder, int index, const char *key, const char *path,
                                 const struct spin_splats *splats);
/* Sets *found to whether frame `index` is cached and, if it is, sets *out to its description.
 * SPIN_E_USAGE if the cached frame has another key. */
spin_status spin_frame_cache_find(const char *folder, int index, const char *key, bool *found,
                                  struct spin_shelved *out);
/* Reads columns of frame `index`. SPIN_E_USAGE if the cached frame has another key. */
spin_status spin_frame_cache_get(const char *folder, int index, const char *key, unsigned columns,
                                 struct spin_splats *out);
/* Removes all cached frames, and then the folder if it is empty. */
void spin_frame_cache_clear(const char *folder);

/* ---- Refinement ------------------------------------------------------------------------------ */

struct spin_refinement {
    struct spin_refined *frame; /* [frames] keys; NULL if frames are not refined */
    size_t *counts;             /* [frames] number of splats of each refined frame */
    struct spin_splats scratch; /* scratch for reading a refined frame */
};

/* Allocates memory. SPIN_E_NOT_FOUND if refined frames start from the source's attributes and the
 * input lacks them. Zero *refinement before the call, and close it also after a failure. */
spin_status spin_refinement_open(struct spin_refinement *refinement, const struct spin_plan *plan);
void spin_refinement_close(struct spin_refinement *refinement);
/* Computes the keys of all frames (key.h), which identify frames that an earlier run refined. */
spin_status spin_refinement_keys(struct spin_refinement *refinement, struct spin_plan *plan,
                                 const struct spin_photos *photos);
/* Refines all frames that are neither in the input nor in the cache with the same key, updates the
 * numbers of splats in the plan, and measures the quality of the refined frames. */
spin_status spin_refinement_run(struct spin_refinement *refinement, struct spin_plan *plan,
                                struct spin_photos *photos, struct spin_device *device,
                                struct spin_simd_paths *simd_paths, struct spin_step_log *step_log);
/* Reads columns of a refined frame, from the input or from the cache. */
spin_status spin_refinement_read(struct spin_refinement *refinement, struct spin_plan *plan,
                                 int frame, unsigned columns, struct spin_splats *out);
/* Returns the columns of refined frames that the output contains. */
unsigned spin_refinement_columns(const struct spin_plan *plan);
/* Returns the object "refined" of meta.json, which the caller frees. */
spin_json *spin_refinement_to_json(const struct spin_refinement *refinement,
                                   const struct spin_plan *plan);
