/* Refinement, the per-frame stage of a retraining (docs/method.md section 2), in which every frame
 * is optimised independently. */
#pragma once

#include "train/key.h"
#include "train/step.h"
#include "spin.h"

/* ---- Cache of refined frames ----------------------------------------------------------------- */

/* Cache of the refined frames of an unfinished run: a folder beside the output with one small
 * bundle for each frame. Each bundle is written atomically and contains a key that identifies the
 * frame's inputs and options, so a run that was killed can continue with all the frames that it
 * finished. */

/* A cached frame. */
struct spin_shelved {
    size_t n;      /* number of splats */
    char path[16]; /* SIMD path of the device that refined the frame */
};

/* Adds frame `index` to the cache, with all attribute columns of `splats`, its key and the SIMD
 * path of the device that refined it. Creates the folder if necessary. */
spin_status spin_frame_cache_put(const char *folder, int index, const char *key, const char *path,
                                 const struct spin_splats *splats);
/* Sets *found to whether frame `index` is cached and, if it is, describes it in *out. SPIN_E_USAGE
 * if the frame is cached under another key. */
spin_status spin_frame_cache_find(const char *folder, int index, const char *key, bool *found,
                                  struct spin_shelved *out);
/* Reads these columns of frame `index`. The frame must be cached under this key. */
spin_status spin_frame_cache_get(const char *folder, int index, const char *key, unsigned columns,
                                 struct spin_splats *out);
/* Removes all cached frames, and then the folder if it is empty. */
void spin_frame_cache_clear(const char *folder);

/* ---- Refinement ------------------------------------------------------------------------------ */

struct spin_refinement {
    struct spin_refined *frame; /* [frames]; NULL if frames are not refined */
    size_t *counts;             /* [frames] number of splats of each refined frame */
    struct spin_splats scratch; /* a refined frame while it is read */
};

/* Allocates memory. SPIN_E_NOT_FOUND if refined frames are to start from the source's attributes
 * and the input does not have these. Zero *refinement first; close it also after a failure. */
spin_status spin_refinement_open(struct spin_refinement *refinement, const struct spin_plan *plan);
void spin_refinement_close(struct spin_refinement *refinement);
/* Computes the key of every frame (key.h), by which frames that were refined earlier are found. */
spin_status spin_refinement_keys(struct spin_refinement *refinement, struct spin_plan *plan,
                                 const struct spin_photos *photos);
/* Refines all frames that are neither in the input nor in the cache, updates the numbers of splats
 * in the plan, and measures the quality of the refined frames. */
spin_status spin_refinement_run(struct spin_refinement *refinement, struct spin_plan *plan,
                                struct spin_photos *photos, struct spin_device *device,
                                struct spin_simd_paths *simd_paths, struct spin_step_log *step_log);
/* Reads the given columns of a refined frame, from the input or from the cache. */
spin_status spin_refinement_read(struct spin_refinement *refinement, struct spin_plan *plan,
                                 int frame, unsigned columns, struct spin_splats *out);
/* The columns of refined frames that the output contains. */
unsigned spin_refinement_columns(const struct spin_plan *plan);
/* Returns the "refined" object of meta.json, which the caller frees. */
spin_json *spin_refinement_to_json(const struct spin_refinement *refinement,
                                   const struct spin_plan *plan);
