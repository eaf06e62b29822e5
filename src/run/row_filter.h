/* Decides which splats spin-export omits, for all exporters. Each frame, or the 4D splats of the
 * clip, passes through one filter on its way from the player to the exporter. The filter gives
 * every row that it drops a reason (enum spin_row_reason of spin.h). If several reasons apply, the
 * first of them in the enum is given. Exporters receive the remaining rows.
 *
 * The options of the filter use the units and axes of the imported scene, since --scale and
 * --translate are applied after the filter (run/scene_move.h). */
#pragma once

#include "base/pool.h"
#include "spin_run.h"
#include "scene/bundle_tracks.h"
#include "scene/clip.h"

struct spin_row_filter {
    const struct spin_export_options *o;
    const struct spin_clip *clip;
    /* Callbacks of --decimate, or NULL. They are called after all other reasons are set, and set
     * the reason of further rows to drop. `source` states whether the rows are those of the
     * imported frame. */
    spin_status (*drop)(void *context, int frame, const struct spin_splats *s, bool source,
                        unsigned char *reason);
    void (*drop_4d)(const void *context, unsigned char *reason);
    /* Sets *out to the splats of the frame in which rows that remain have the values of several
     * rows, or leaves it unchanged. Called after drop(). */
    spin_status (*merge)(void *context, int frame, bool source, const unsigned char *reason,
                         const struct spin_splats **out);
    void *drop_context;
    /* True if the options may drop a row in some frames and keep it in others. */
    bool varies;
    /* Statistics of the 4D splats, or of all frames that were counted since spin_row_filter_open()
     * or the last spin_row_filter_restart(). */
    uint64_t n_seen, n_by[SPIN_ROW_REASONS];
    /* True if all counted frames have the same number of rows, and the same rows remain in each of
     * them. */
    bool same_rows;
    /* `reason` contains an enum spin_row_reason for each row of the frame that was filtered last;
     * `reason_4d` contains one for each 4D splat. Each array is NULL until rows, or 4D splats, are
     * filtered for the first time. */
    unsigned char *reason, *reason_4d;

    /* Private. */
    struct spin_pool *pool;
    float min_logit;
    /* largest permitted scale, in diagonals of the frame's bounding box; INFINITY: no limit */
    double max_scale;
    struct spin_bundle_tracks tracks; /* opened with --backdrop off */
    uint32_t *track;                  /* [rows of the frame] */
    unsigned char *first_kept; /* [n_first], 1 if the first counted frame keeps the row, else 0 */
    size_t n_first;
    struct spin_splats kept;
    struct spin_splats_4d kept_4d;
};

/* `renders` states whether the exporter renders images. Such an exporter gets splats of any size,
 * as in spin-eval, whereas others get no splats larger than the scene; --max-scale sets the limit
 * for both. Options and clip remain property of the caller and must outlive the filter. The caller
 * zeroes the filter before this call, and closes it even if this call fails. */
spin_status spin_row_filter_open(struct spin_row_filter *f, const struct spin_export_options *o,
                                 const struct spin_clip *clip, bool renders);
void spin_row_filter_close(struct spin_row_filter *f);
/* Resets the statistics. Called before the frames are written again. */
void spin_row_filter_restart(struct spin_row_filter *f);

/* spin_row_filter_apply() sets f->reason for the rows of frame `frame` of the clip (0..n_frames-1),
 * whose splats must have all attribute columns. spin_row_filter_apply_4d() sets f->reason_4d for 4D
 * splats, on the first call only. --decimate is not applied. The position of a 4D splat is tested
 * in one frame only: of the frames that show the splat, the one nearest to its own time. If no
 * frame shows the splat, --crop tests its position at its own time, and --min-views and --floaters
 * do not apply. */
spin_status spin_row_filter_apply(struct spin_row_filter *f, int frame,
                                  const struct spin_splats *s);
spin_status spin_row_filter_apply_4d(struct spin_row_filter *f, const struct spin_splats_4d *s);

/* Replaces *splats, the rows of a frame, by the rows that remain. If all remain, the pointer stays
 * unchanged; otherwise it points to a copy that the next call overwrites. Counts the dropped rows,
 * and warns of rows that cannot be drawn. */
spin_status spin_row_filter_frame(struct spin_row_filter *f, int frame,
                                  const struct spin_splats **splats);
/* Like spin_row_filter_frame(), but without counts and warnings, for frames that are read again. */
spin_status spin_row_filter_reread(struct spin_row_filter *f, int frame,
                                   const struct spin_splats **splats);
/* Copies to *out the rows that remain of `all`, which are the imported splats of a frame. The rows
 * of the retrained frame may differ from the imported rows. Nothing is counted, and no warnings are
 * printed. */
spin_status spin_row_filter_source(struct spin_row_filter *f, int frame,
                                   const struct spin_splats *all, struct spin_splats *out);
/* Replaces *splats_4d by the 4D splats that remain, like spin_row_filter_frame(), and counts the
 * dropped ones. */
spin_status spin_row_filter_4d(struct spin_row_filter *f, const struct spin_splats_4d **splats_4d);

/* These functions return the number of rows that options other than --decimate have dropped, and
 * the number of rows that were dropped because they cannot be drawn. */
uint64_t spin_row_filter_n_filtered(const struct spin_row_filter *f);
uint64_t spin_row_filter_n_undrawable(const struct spin_row_filter *f);
/* Logs how many rows each option dropped, and warns if no row remains. */
void spin_row_filter_log(const struct spin_row_filter *f);
