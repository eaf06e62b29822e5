/* A bundle opened for work: the selected frames, the data set, and which of its rows belongs to
 * which frame. Retraining, evaluation and export all begin here. */
#pragma once

#include "spin.h"
#include "scene/bundle.h"
#include "scene/dataset.h"
#include "scene/image_cache.h"

struct spin_clip_options {
    const char *input;
    const char *data, *data_from, *pair; /* NULL: as recorded in the bundle, else "auto" */
    struct spin_range range;
    const int *test_cameras;
    int n_test_cameras;
    bool as_trained; /* if there are no test_cameras: hold out those of the training, not the data
                        set's test split */
    double image_scale; /* 0 or 1: as stored */
    bool needs_views;   /* a missing data set is an error */
    /* A data set that only the bundle names and that cannot be read is a warning. If neither
     * needs_views nor wants_views is set, it is not opened. A data set given in `data` must
     * exist. */
    bool wants_views;
};

struct spin_clip {
    struct spin_bundle bundle;
    int n_frames;
    int *frame;         /* [n_frames] index into bundle.meta.frame */
    int *dataset_frame; /* [n_frames] row of the data set; -1: none */
    bool has_views;
    int n_taught; /* test_cameras that the training of this bundle did not hold out */
    struct spin_views views;
    char *data_path; /* absolute; NULL without a data set */
    char data_from[128];
    size_t n_max; /* splats of the largest frame */
    double n_mean;
};

/* Errors name the bundle or the data set. */
spin_status spin_clip_open(const struct spin_clip_options *o, struct spin_clip *out);
void spin_clip_close(struct spin_clip *clip);

/* Checks that times, which identify frames, are finite and distinct, in any order. index [n]
 * selects frames of info; NULL: the first n. */
spin_status spin_times_check(const struct spin_frame_info *info, const int *index, int n);

/* Selects the frames whose number is in the range, as indices into info[n]; allocated.
 * SPIN_E_NOT_FOUND if there are none. */
spin_status spin_range_select(const struct spin_range *range, const struct spin_frame_info *info,
                              int n, int **index, int *n_index);

/* The views of the clip's frames that belong to the split: (frame in 0..n_frames-1, view). */
struct spin_pair {
    int frame;
    size_t view;
};
spin_status spin_clip_pairs(const struct spin_clip *clip, enum spin_split split,
                            struct spin_pair **pairs, size_t *n);
