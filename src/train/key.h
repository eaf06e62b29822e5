/* Texts that identify the inputs and options of a refined frame (key) or of a whole run
 * (fingerprint). A result from an earlier run is reused only if its text equals that of this run.
 */
#pragma once

#include "train/photos.h"
#include "io/json.h"
#include "train/plan.h"

/* ---- Settings -------------------------------------------------------------------------------- */

/* The settings that affect the result, as JSON. They are stored with the result; a resume requires
 * that they are equal to those of the checkpoint. */

/* Returns the settings that affect the refinement of a frame; the caller frees them. */
spin_json *spin_settings_refine(const struct spin_plan *plan);
/* Returns the settings that affect the training of the clip; the caller frees them. */
spin_json *spin_settings_network(const struct spin_plan *plan);

/* ---- Keys and fingerprints ------------------------------------------------------------------- */

enum { SPIN_FRAME_KEY = 40 }; /* bytes of a key, including the terminating null */

struct spin_refined {
    /* Identifies the inputs and options of the frame's refinement. */
    char key[SPIN_FRAME_KEY];
    /* True if the refined frame is in the input bundle, false if it is in the frame cache. */
    bool from_input;
};

/* Computes the key of a refined frame: a hash of the options of refinement, the frame's images, the
 * lenses, and the attributes that the refinement starts from. */
spin_status spin_frame_key(struct spin_plan *plan, const struct spin_photos *photos, int frame,
                           char key[SPIN_FRAME_KEY]);
/* Computes the fingerprint of a run: a text of the options, the frames, the keys of the refined
 * frames, the images, and the names, sizes and CRCs of the input's arrays in their order. refined
 * is [frames], or NULL if frames are not refined. The caller frees *out. */
spin_status spin_fingerprint(const struct spin_plan *plan, const struct spin_refined *refined,
                             const struct spin_photos *photos, const struct spin_device *device,
                             char **out);
