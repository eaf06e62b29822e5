/* Edits a scene before its exporter gets it: drops splats, scales and moves the rest. Frames, 4D
 * splats and the cameras of the data set are edited alike. */
#pragma once

#include "base/pool.h"
#include "spin_run.h"
#include "scene/bundle_tracks.h"
#include "scene/clip.h"

enum spin_scene_edit_filter {
    SPIN_EDIT_CROP,
    SPIN_EDIT_MIN_VIEWS,
    SPIN_EDIT_FLOATERS,
    SPIN_EDIT_BACKDROP,
    SPIN_EDIT_FILTERS
};

struct spin_scene_edit {
    const struct spin_export_options *o;
    const struct spin_clip *clip;
    struct spin_pool *pool;
    struct spin_bundle_tracks tracks; /* opened with --backdrop off */
    uint32_t *track;                  /* [rows of the frame] track of each row */
    bool filters, moves; /* filters: splats may be dropped; moves: splats are scaled or moved */
    bool chosen; /* inputs of spin_scene_edit_frame() and _4d() were filtered before: only transform
                    them */
    uint64_t n_seen, n_kept; /* rows judged and kept so far, in all frames, or 4D splats */
    uint64_t n_left_out[SPIN_EDIT_FILTERS];
    unsigned char *reason;    /* [rows of the frame] 0, or 1 + the filter that drops the row */
    unsigned char *reason_4d; /* [4D splats] likewise; NULL until they are judged */
    struct spin_splats_4d splats_4d; /* result of the last spin_scene_edit_4d() */
    struct spin_views views;         /* views of the clip with transformed cameras */
};

/* e must be zeroed; end it also after a failure. Options and clip stay the caller's and must
 * outlive e. */
spin_status spin_scene_edit_begin(struct spin_scene_edit *e, const struct spin_export_options *o,
                                  const struct spin_clip *clip);
void spin_scene_edit_end(struct spin_scene_edit *e);
static inline bool spin_scene_edit_is_none(const struct spin_scene_edit *e)
{
    return (!e->filters || e->chosen) && !e->moves;
}
/* Resets the statistics, before frames are written again. */
void spin_scene_edit_again(struct spin_scene_edit *e);

/* Sets e->reason for each row of a frame to 0, or to 1 + the filter that drops it; valid until the
 * next call. counts: add to the statistics. */
spin_status spin_scene_edit_judge(struct spin_scene_edit *e, int frame, const struct spin_splats *s,
                                  bool counts);
/* Judges 4D splats into e->reason_4d, once. A row is judged at its position in the frame that shows
 * it and is nearest to its own time; a row that no frame shows is judged by --crop only, at its own
 * time. */
spin_status spin_scene_edit_judge_4d(struct spin_scene_edit *e, const struct spin_splats_4d *s);

/* Filters and transforms a frame, 0..n_frames-1 of the clip, with all attribute columns. counts:
 * add to the statistics. */
spin_status spin_scene_edit_frame(struct spin_scene_edit *e, int frame,
                                  const struct spin_splats *in, bool counts,
                                  struct spin_splats *out);
/* The same for 4D splats; *out is owned by e. */
spin_status spin_scene_edit_4d(struct spin_scene_edit *e, const struct spin_splats_4d *in,
                               const struct spin_splats_4d **out);
/* The views of the clip with their cameras transformed like the scene; NULL if there are none. */
spin_status spin_scene_edit_views(struct spin_scene_edit *e, const struct spin_views **out);

/* Logs how many splats were dropped; warns if none is left. */
void spin_scene_edit_say(const struct spin_scene_edit *e);
