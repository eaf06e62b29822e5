/* An open bundle with the frames that --range selects, and the data set, whose rows are paired with
 * the frames. Retraining, evaluation and export open their input by these functions. */
#pragma once

#include "spin.h"
#include "scene/bundle.h"
#include "scene/dataset.h"
#include "scene/image_cache.h"

struct spin_clip_options {
    const char *input;
    /* Options --data, --data-from and --pair. NULL: as recorded in the bundle; if nothing is
     * recorded, the importer is detected and frames are paired by "auto". */
    const char *data, *data_from, *pair;
    struct spin_range range;
    const int *test_cameras; /* [n_test_cameras] replaces the test split of the data set */
    int n_test_cameras;
    bool as_trained;    /* without test_cameras: hold out the cameras that the training held out */
    double image_scale; /* 0 or 1: size as stored */
    bool needs_views;   /* a data set that cannot be opened is an error */
    /* A data set whose path comes from the bundle, and that cannot be opened, is a warning. If
     * neither needs_views nor wants_views is set, such a data set is not opened at all. A data set
     * given as `data` or `data_from` is always opened, and failure is an error. */
    bool wants_views;
};

struct spin_clip {
    struct spin_bundle bundle;
    int n_frames;
    int *frame;         /* [n_frames] indices into bundle.meta.frame */
    int *dataset_frame; /* [n_frames] rows of the data set; -1: none */
    bool has_views;
    int n_taught; /* number of test_cameras that the training of this bundle did not hold out */
    struct spin_views views;
    char *data_path;     /* absolute path; NULL: no data set */
    char data_from[128]; /* importer that read the data set, with its options */
    size_t n_max;        /* number of splats of the largest frame */
    double n_mean;       /* mean number of splats per frame */
};

/* Error messages contain the path of the bundle or of the data set. */
spin_status spin_clip_open(const struct spin_clip_options *o, struct spin_clip *out);
void spin_clip_close(struct spin_clip *clip);

/* Checks that the times of n frames are finite and distinct, since times identify frames. Times may
 * be in any order. index [n]: the frames to check, as indices into info; NULL: the first n. */
spin_status spin_times_check(const struct spin_frame_info *info, const int *index, int n);

/* Sets *index [*n_index] to the indices into info[n] of the frames whose number is in the range;
 * the caller frees it. SPIN_E_NOT_FOUND if there is no such frame. */
spin_status spin_range_select(const struct spin_range *range, const struct spin_frame_info *info,
                              int n, int **index, int *n_index);

struct spin_pair {
    int frame;   /* 0..n_frames - 1 */
    size_t view; /* index into views.view */
};
/* Lists the views of all frames of the clip that belong to the split, frame by frame. The caller
 * frees *pairs. */
spin_status spin_clip_pairs(const struct spin_clip *clip, enum spin_split split,
                            struct spin_pair **pairs, size_t *n);
