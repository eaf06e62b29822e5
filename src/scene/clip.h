/* Opens a bundle, selects the frames of --range, and opens the data set, whose rows are paired with
 * these frames. Retraining, evaluation and export open their input by these functions. */
#pragma once

#include "spin.h"
#include "scene/bundle.h"
#include "scene/dataset.h"
#include "scene/image_cache.h"

struct spin_clip_options {
    const char *input;
    /* Options --data, --data-from and --pair. If an option is NULL, the value that the bundle
     * records is used; a recorded pairing is used only with the recorded data set. Without a
     * recorded value, the importer is detected, and frames are paired by "auto". */
    const char *data, *data_from, *pair;
    struct spin_range range;
    const int *test_cameras; /* [n_test_cameras], replaces the test split of the data set */
    int n_test_cameras;
    /* number of outermost training cameras that become test cameras besides those of the split */
    int n_outer;
    /* true: without test_cameras, the cameras that the training held out become test cameras */
    bool as_trained;
    double image_scale; /* factor by which images are scaled; 0 or 1: images keep their size */
    bool needs_views;   /* true: it is an error if the data set cannot be opened */
    /* True: a data set whose path comes from the bundle is opened, with only a warning if that
     * fails. If neither needs_views nor wants_views is true, such a data set is not opened at all.
     * If `data` or `data_from` is given, the data set is always opened, and it is an error if that
     * fails. */
    bool wants_views;
    bool quiet; /* true: omits the warning of `wants_views` */
};

struct spin_clip {
    struct spin_bundle bundle;
    int n_frames;
    int *frame; /* [n_frames] indices into bundle.meta.frame */
    /* [n_frames] row of the data set that is paired with each frame; -1: no row */
    int *dataset_frame;
    bool has_views;
    /* True: the data set is not open, and `views` are the cameras that the bundle keeps of it: one
     * view per camera, without an image. All views are in row 0, and every frame is paired with row
     * 0. */
    bool has_kept;
    int n_trained_test_cameras; /* number of test_cameras that this bundle was trained on */
    struct spin_views views;
    char *data_path;     /* absolute path of the data set; NULL: no data set */
    char data_from[128]; /* importer that has read the data set, with its options */
    size_t n_max;        /* number of splats of the largest frame */
    double n_mean;       /* mean number of splats per frame */
};

/* Error messages contain the path of the bundle or of the data set. */
spin_status spin_clip_open(const struct spin_clip_options *o, struct spin_clip *out);
void spin_clip_close(struct spin_clip *clip);
/* Returns whether the images of the data set are rendered (scene/renders.h). Its cameras are then
 * in the coordinates of the bundle. */
bool spin_clip_is_drawn(const struct spin_clip *clip);

/* Checks that the times of n frames are finite and distinct, since times identify frames. Times may
 * be in any order. `index` [n] lists the frames to check, as indices into `info`; if it is NULL,
 * the first n frames are checked. */
spin_status spin_times_check(const struct spin_frame_info *info, const int *index, int n);

/* Sets *index [*n_index] to the indices, in info[n], of the frames whose number is in the range.
 * The caller frees *index. Fails with SPIN_E_NOT_FOUND if there is no such frame. */
spin_status spin_range_select(const struct spin_range *range, const struct spin_frame_info *info,
                              int n, int **index, int *n_index);

struct spin_pair {
    int frame;   /* index of the frame in the clip, 0..n_frames - 1 */
    size_t view; /* index into views.view */
};
/* Lists, frame by frame, the views of the clip that belong to the split. SPIN_SPLIT_OUTER selects
 * the test views outside the cone of the training cameras. The caller frees *pairs. */
spin_status spin_clip_pairs(const struct spin_clip *clip, enum spin_split split,
                            struct spin_pair **pairs, size_t *n);

/* ---- The training of the clip ---------------------------------------------------------------- */

/* The record of the training in meta.json, and warnings if the options of a command differ from
 * those of that training. */

/* Returns the record of the training that produced the splats `from`; NULL if the splats were
 * imported. */
const spin_json *spin_training_of(const struct spin_bundle *bundle, enum spin_splat_source from);
/* Warns if the background differs from that of the training, since transparent regions then show
 * the wrong colour. `what` is the verb of the warning, such as "measures". */
void spin_training_warn_background(const struct spin_bundle *bundle, enum spin_splat_source from,
                                   const float background[3], const char *what);
/* Warns if the image scale differs from that of the training: scores are not comparable, and splats
 * trained on small images lack detail. */
void spin_training_warn_scale(const struct spin_bundle *bundle, enum spin_splat_source from,
                              double image_scale);
/* Warns if some of the test cameras were used by the training, since their scores are then too
 * high. */
void spin_training_warn_test_cameras(const struct spin_clip *clip, int n_test_cameras);
