/* What an export changes of a scene before its exporter sees it: splats that are left out, another
 * size, another place. A frame's splats and 4D splats go the same way; so do the data set's
 * cameras. */
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
    struct spin_bundle_tracks tracks; /* with --backdrop off */
    uint32_t *track;                  /* of the rows at hand */
    bool filters, moves;              /* there is something to leave out; to scale or move */
    bool chosen; /* what spin_scene_edit_frame() and _4d() get has been judged before: they move it
                  */
    uint64_t n_seen, n_kept; /* rows so far: of all frames, or of 4D splats */
    uint64_t n_left_out[SPIN_EDIT_FILTERS];
    unsigned char *reason;           /* of the rows at hand: 0, or 1 + what leaves it out */
    unsigned char *reason_4d;        /* of the clip's 4D splats; NULL: they were not judged yet */
    struct spin_splats_4d splats_4d; /* those of the last spin_scene_edit_4d() */
    struct spin_views views;         /* moved, where the clip's were */
};

/* Zero e before; end it also after a failure. Options and clip stay the caller's. */
spin_status spin_scene_edit_begin(struct spin_scene_edit *e, const struct spin_export_options *o,
                                  const struct spin_clip *clip);
void spin_scene_edit_end(struct spin_scene_edit *e);
static inline bool spin_scene_edit_is_none(const struct spin_scene_edit *e)
{
    return (!e->filters || e->chosen) && !e->moves;
}
/* What is left out is counted from 0 again: the frames are written once more. */
void spin_scene_edit_again(struct spin_scene_edit *e);

/* Of each row of a frame 0, or 1 + the filter that leaves it out: in e->reason, until the next
 * call. counts: what is left out is added up. */
spin_status spin_scene_edit_judge(struct spin_scene_edit *e, int frame, const struct spin_splats *s,
                                  bool counts);
/* A row is judged where it is at that of the frames that show it whose time is nearest to its own;
 * one that no frame shows, where it is at its own time, and by --crop alone. Done and counted once:
 * in e->reason_4d. */
spin_status spin_scene_edit_judge_4d(struct spin_scene_edit *e, const struct spin_splats_4d *s);

/* A frame, 0..n_frames-1 of the clip, which has all attribute columns, into *out. counts: what is
 * left out is added up. */
spin_status spin_scene_edit_frame(struct spin_scene_edit *e, int frame,
                                  const struct spin_splats *in, bool counts,
                                  struct spin_splats *out);
/* *out is e's. */
spin_status spin_scene_edit_4d(struct spin_scene_edit *e, const struct spin_splats_4d *in,
                               const struct spin_splats_4d **out);
/* The cameras of the clip, moved with the scene; NULL: it has none. */
spin_status spin_scene_edit_views(struct spin_scene_edit *e, const struct spin_views **out);

/* What was left out, a line; a warning when nothing stayed. */
void spin_scene_edit_say(const struct spin_scene_edit *e);
