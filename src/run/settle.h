/* Finds the static splats of a clip whose frames share no rows, and stores them once for all
 * frames. This removes their flicker and makes the clip smaller. */
#pragma once

#include "scene/clip.h"

struct spin_settled {
    /* number of rows that all frames share; mean number of other rows per frame */
    double n_static, n_dynamic;
    double n_before; /* mean number of rows per frame of the source */
    int n_frames;
};

struct spin_settle_options {
    const char *input, *output;
    /* The data set, "renders" or captured images, and its importer with options; NULL: those that
     * the bundle records, or the defaults. */
    const char *data, *data_from;
    bool force;
    int n_threads;
    /* Shares of the static and of the dynamic rows to keep, each above 0 and at most 1. The kept
     * rows are chosen at random, and enlarged so that they cover the same area as all rows. */
    double keep_static, keep_dynamic;
    /* If this is above 0, both shares are chosen such that a frame has at most `most` rows on
     * average. */
    double most;
};

/* Returns whether a clip with captured images should be settled: it has eight or more frames, whose
 * rows have neither identities nor the same positions. */
spin_status spin_settle_applies(struct spin_bundle *bundle, bool *applies);
/* Writes the bundle `output`. Its frames begin with the static rows, which are bit-identical in all
 * frames, so that spin-retrain recognises them as static tracks; the dynamic rows of the frame
 * follow. The new bundle refers to the data set of the options; renders are drawn from `input`.
 * Fails with SPIN_E_UNSUPPORTED, and writes nothing, if the images are captured and their cameras
 * move, are fewer than four, or lack images of a frame.
 *
 * A row is dynamic if, in its own frame or in one of up to 31 others spread over the clip, the
 * colour of its pixel differs from the median of this pixel over time for most cameras that see it.
 * The dynamic rows are thus inside the visual hull of the motion. The test needs no matches between
 * rows, and ignores flicker below a threshold. The static rows are taken from the middle frame;
 * rows of other frames fill its holes, where a quarter of the frames have static rows. Captured
 * images also settle points. */
spin_status spin_settle(const struct spin_settle_options *o, struct spin_settled *settled);
/* Returns the step between the frames whose images give the median over time. n_pixels: of the
 * images of one frame, from all cameras. */
int spin_settle_step(int n_frames, double n_pixels);
