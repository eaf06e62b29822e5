/* A bundle opened for work: the frames that were asked for, the data set, and which row of it shows
 * which frame. Retraining, evaluation and export all begin here. */
#pragma once

#include "spin.h"
#include "scene/bundle.h"
#include "scene/dataset.h"
#include "scene/image_cache.h"

struct spin_clip_options {
    const char *input;
    const char *data, *data_from, *pair; /* NULL: what the bundle says; "auto" */
    struct spin_range range;
    const int *test_cameras;
    int n_test_cameras;
    bool as_trained; /* without these: what retraining was told to hold out, not what the data set
                        says */
    double image_scale; /* 0 or 1: as stored */
    bool needs_views;   /* a missing data set is an error */
    /* One that the bundle names and that cannot be read is a warning. Neither of both: it is not
     * opened. What `data` names must be there. */
    bool wants_views;
};

struct spin_clip {
    struct spin_bundle bundle;
    int n_frames;
    int *frame;         /* [n_frames] index into bundle.meta.frame */
    int *dataset_frame; /* [n_frames] row of the data set, or -1 */
    bool has_views;
    int n_taught; /* of test_cameras: those that a training of this bundle does not hold out */
    struct spin_views views;
    char *data_path; /* absolute; NULL without a data set */
    char data_from[128];
    size_t n_max; /* splats of the largest frame */
    double n_mean;
};

/* Errors name the bundle or the data set. */
spin_status spin_clip_open(const struct spin_clip_options *o, struct spin_clip *out);
void spin_clip_close(struct spin_clip *clip);

/* Frames are told apart by their times: these must be finite, and no two the same, in any order. Of
 * the frames index[n], or of the first n (NULL). */
spin_status spin_times_check(const struct spin_frame_info *info, const int *index, int n);

/* Frame numbers in the range, as indices into info[n]. SPIN_E_NOT_FOUND when there are none. */
spin_status spin_range_select(const struct spin_range *range, const struct spin_frame_info *info,
                              int n, int **index, int *n_index);

/* Every view of the clip's frames that is in the split: (frame in 0..n_frames-1, view). */
struct spin_pair {
    int frame;
    size_t view;
};
spin_status spin_clip_pairs(const struct spin_clip *clip, enum spin_split split,
                            struct spin_pair **pairs, size_t *n);
