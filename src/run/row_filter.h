/* Decides which splats spin-export leaves out, for all exporters. Between the player and the
 * exporter, each frame, or the 4D splats of the clip, passes through one filter, which gives every
 * row it drops a reason (enum spin_row_reason of spin.h); if several apply, the first of the enum
 * counts. Exporters receive the remaining rows.
 *
 * Filters use the units and axes of the imported scene. Scaling and moving follow
 * (run/scene_move.h). */
#pragma once

#include "base/pool.h"
#include "spin_run.h"
#include "scene/bundle_tracks.h"
#include "scene/clip.h"

struct spin_decimation;

struct spin_row_filter {
    const struct spin_export_options *o;
    const struct spin_clip *clip;
    struct spin_decimation *decimation; /* the rows chosen by --decimate; NULL: no limit */
    bool varies;                        /* options may drop a row in some frames only */
    /* Statistics of all frames since spin_row_filter_restart(), or of the 4D splats. */
    uint64_t n_seen, n_by[SPIN_ROW_REASONS];
    bool same_rows; /* the counted frames have the same rows, and the same of them remain */
    /* An enum spin_row_reason for each row of the frame judged last, and for each 4D splat; NULL
     * before. */
    unsigned char *reason, *reason_4d;

    /* Private. */
    struct spin_pool *pool;
    float min_logit;
    double max_scale; /* in diagonals of the frame's bounding box; INFINITY: no limit */
    struct spin_bundle_tracks tracks; /* opened with --backdrop off */
    uint32_t *track;                  /* [rows of the frame] */
    unsigned char *first_kept; /* [n_first] whether the first counted frame keeps each row */
    size_t n_first;
    struct spin_splats kept;
    struct spin_splats_4d kept_4d;
};

/* renders: the exporter renders images, like spin-eval with splats of any size, unless --max-scale
 * is given. Options and clip stay the caller's and must outlive the filter. Close a filter that was
 * zeroed before, also after a failure. */
spin_status spin_row_filter_open(struct spin_row_filter *f, const struct spin_export_options *o,
                                 const struct spin_clip *clip, bool renders);
void spin_row_filter_close(struct spin_row_filter *f);
/* Resets the statistics, before the frames are written again. */
void spin_row_filter_restart(struct spin_row_filter *f);

/* Sets f->reason for the rows of a frame, 0..n_frames-1 of the clip, with all attribute columns, or
 * f->reason_4d for 4D splats, once; --decimate is not applied. A 4D row is judged at its position
 * in the frame that shows it and is nearest to its own time; a row that no frame shows is judged by
 * --crop only, at its own time. */
spin_status spin_row_filter_judge(struct spin_row_filter *f, int frame,
                                  const struct spin_splats *s);
spin_status spin_row_filter_judge_4d(struct spin_row_filter *f, const struct spin_splats_4d *s);

/* Replaces *splats, a frame, by its remaining rows: the same pointer if all remain, otherwise a
 * copy that the next call overwrites. Counts the others, and warns of those that cannot be drawn.
 */
spin_status spin_row_filter_frame(struct spin_row_filter *f, int frame,
                                  const struct spin_splats **splats);
/* The same without counts and warnings, for frames that are read again. */
spin_status spin_row_filter_reread(struct spin_row_filter *f, int frame,
                                   const struct spin_splats **splats);
/* Copies the remaining rows of `all`, the imported splats of a retrained frame, whose rows may
 * differ; without counts and warnings. */
spin_status spin_row_filter_source(struct spin_row_filter *f, int frame,
                                   const struct spin_splats *all, struct spin_splats *out);
/* The same for 4D splats, counted. */
spin_status spin_row_filter_4d(struct spin_row_filter *f, const struct spin_splats_4d **splats_4d);

/* The rows dropped by options other than --decimate; those that cannot be drawn. */
uint64_t spin_row_filter_n_filtered(const struct spin_row_filter *f);
uint64_t spin_row_filter_n_undrawable(const struct spin_row_filter *f);
/* Logs how many rows each option dropped; warns if none is left. */
void spin_row_filter_log(const struct spin_row_filter *f);
