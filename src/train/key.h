/* Two identifiers of inputs and options: the key of a refined frame, and the fingerprint of a whole
 * run. A refined frame or a checkpoint of an earlier run is reused only if its identifier equals
 * that of this run. */
#pragma once

#include "train/photos.h"
#include "io/json.h"
#include "train/plan.h"

/* ---- Settings -------------------------------------------------------------------------------- */

/* Settings that affect the result, as JSON. They are stored with the result; a resume requires that
 * the checkpoint has the same settings. */

/* Returns the settings that affect the refinement of a frame; the caller frees them. */
spin_json *spin_settings_refine(const struct spin_plan *plan);
/* Returns the settings that affect the training of the clip; the caller frees them. */
spin_json *spin_settings_network(const struct spin_plan *plan);

/* ---- Keys and fingerprints ------------------------------------------------------------------- */

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
