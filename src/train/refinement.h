/* Refinement, the first stage of a retraining (docs/method.md section 2): each frame is optimised
 * independently. */
#pragma once

#include "spin.h"
#include "io/json.h"
#include "train/photos.h"
#include "train/plan.h"
#include "train/step.h"

/* ---- Settings -------------------------------------------------------------------------------- */

/* Settings that affect the result, as JSON. They are stored with the result; a resume requires that
 * the checkpoint has the same settings. */

/* Returns the settings that affect the refinement of a frame; the caller frees them. */
spin_json *spin_settings_refine(const struct spin_plan *plan);
/* Returns the settings that affect the training of the clip; the caller frees them. */
spin_json *spin_settings_network(const struct spin_plan *plan);

/* ---- Keys and fingerprints ------------------------------------------------------------------- */

/* Two identifiers of inputs and options: the key of a refined frame, and the fingerprint of a whole
 * run. A refined frame or a checkpoint of an earlier run is reused only if its identifier equals
 * that of this run. */

enum { SPIN_FRAME_KEY = 40 }; /* size of a key in bytes, with the terminating null */

struct spin_refined {
    /* Identifies the inputs and options of the refinement, see spin_frame_key(). */
    char key[SPIN_FRAME_KEY];
    /* True if the refined frame is in the input bundle, false if it is in the frame cache. */
    bool from_input;
};

/* Computes the key of a refined frame: a hash of the options of the refinement, the images of the
 * frame, the lenses, and the columns of the source from which the refinement starts. */
spin_status spin_frame_key(struct spin_plan *plan, const struct spin_photos *photos, int frame,
                           char key[SPIN_FRAME_KEY]);
/* Computes the fingerprint of a run: JSON text with the options, the frames, the keys of the
 * refined frames, a digest of the images, and a hash of the names, sizes and CRCs of the input's
 * arrays. refined is [frames], or NULL if frames are not refined. The caller frees *out. */
spin_status spin_fingerprint(const struct spin_plan *plan, const struct spin_refined *refined,
                             const struct spin_photos *photos, const struct spin_device *device,
                             char **out);

/* ---- Cache of refined frames ----------------------------------------------------------------- */

/* Cache of the refined frames of an unfinished run: a folder with one small bundle for each frame.
 * Bundles are written atomically, and contain a key that identifies the inputs and options of the
 * frame. A run that was killed can therefore be resumed with all frames that it finished. */

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
/* Computes the keys of all frames, which identify frames that an earlier run refined. */
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
