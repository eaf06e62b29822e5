/* What sequence.json, beside frames that spin-export wrote, says of them: their times, and how a data set pairs. */
#ifndef SPIN_RUN_EXPORTED_FRAMES_H
#define SPIN_RUN_EXPORTED_FRAMES_H

#include "scene/bundle_meta.h"

/* Frames frame[n] were found at `input`. Where there is such a file that knows all of them: sets their times and
 * place[n], the places in the clip that was exported, and of meta n_source_frames, numbered and pair. What does not fit
 * is not used, with a warning. SPIN_E_MEMORY only. */
spin_status spin_exported_frames(const char *input, struct spin_frame_info *frame, int n,
                                 int *place, struct spin_bundle_meta *meta);

#endif
