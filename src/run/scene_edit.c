/* --crop, --min-views, --floaters, --backdrop, --scale and --translate of spin-export.
 *
 * Filters use the units and axes of the imported scene; the remaining splats are then scaled and
 * moved. Filters keep rows that are not finite, which exporters drop and report. */
#include "run/scene_edit.h"

#include "base/base.h"
#include "train/knn.h"

/* Splats whose neighbours are within this many standard deviations are not floaters. */
#define REACH 3.0

/* ---- Begin and end --------------------------------------------------------------------------- */

spin_status spin_scene_edit_begin(struct spin_scene_edit *e, const struct spin_export_options *o,
                                  const struct spin_clip *clip)
{
    const double *box = o->crop, *by = o->translate;

    e->o = o;
    e->clip = clip;
    if (o->backdrop == SPIN_EXPORT_BACKDROP_OFF && !o->source)
        SPIN_TRY(spin_bundle_tracks_open((struct spin_bundle *)&clip->bundle, &e->tracks));
    if (o->backdrop == SPIN_EXPORT_BACKDROP_OFF && e->tracks.n_backdrop == 0)
        spin_warn("--backdrop off has no effect: these splats have no backdrop");
    e->filters = o->n_crop > 0 || o->min_views > 0 || o->floaters > 0 || e->tracks.n_backdrop > 0;
    e->moves = (o->scale > 0 && o->scale != 1) || by[0] != 0 || by[1] != 0 || by[2] != 0;
    for (int c = 0; c < 3 && o->n_crop == 6; c++)
        if (!(box[c] < box[3 + c]))
            return spin_misuse(
                "--crop: the bounding box spans %g to %g: give the smaller coordinate first",
                box[c], box[3 + c]);
    if (o->n_crop == 4 && !(box[3] > 0))
        return spin_misuse("--crop: the radius of the sphere is %g, expected more than 0", box[3]);
    if (o->min_views > 0 && !clip->has_views)
        return spin_misuse("--min-views needs a data set: give --data DIR");
    return o->floaters > 0 ? spin_pool_create(o->n_threads, &e->pool) : SPIN_OK;
}

void spin_scene_edit_end(struct spin_scene_edit *e)
{
    if (e->pool)
        spin_pool_free(e->pool);
    spin_bundle_tracks_close(&e->tracks);
    free(e->track);
    free(e->reason);
    free(e->reason_4d);
    spin_splats_4d_free(&e->splats_4d);
    if (e->moves)
        spin_views_free(&e->views);
    *e = (struct spin_scene_edit){0};
}

void spin_scene_edit_again(struct spin_scene_edit *e)
{
    e->n_seen = e->n_kept = 0;
    memset(e->n_left_out, 0, sizeof e->n_left_out);
}

void spin_scene_edit_say(const struct spin_scene_edit *e)
{
    static const char *const names[] = {"crop", "min-views", "floaters", "backdrop off"};
    char text[160] = "", count[48];
    size_t at = 0;

    for (int k = 0; k < SPIN_EDIT_FILTERS; k++)
        if (e->n_left_out[k] > 0)
            at += (size_t)snprintf(text + at, sizeof text - at, "%s%llu by --%s", at ? ", " : "",
                                   (unsigned long long)e->n_left_out[k], names[k]);
    if (e->filters && e->n_kept == 0 && e->n_seen > 0)
        spin_warn("no splats are left: %s", text);
    else if (e->filters)
        spin_log(0, "%llu of %s left out%s%s", (unsigned long long)(e->n_seen - e->n_kept),
                 spin_text_count((long long)e->n_seen, "splat", count), at ? ": " : "", text);
}

/* ---- Filters --------------------------------------------------------------------------------- */

static bool is_finite(const float place[3])
{
    return isfinite(place[0]) && isfinite(place[1]) && isfinite(place[2]);
}

static bool crops_away(const struct spin_export_options *o, const float place[3])
{
    const double *box = o->crop;
    double square = 0;
    bool outside = false;

    for (int c = 0; c < 3; c++) {
        double away = (double)place[c] - box[c];

        square += away * away;
        outside = outside || away < 0 || (o->n_crop == 6 && (double)place[c] > box[3 + c]);
    }
    return o->n_crop == 4 ? square > box[3] * box[3] : o->n_crop == 6 && outside;
}

/* The rows being judged; reason is 0, or 1 + the filter that drops the row. */
struct rows {
    size_t n;
    const float *place, *log_scale;
    unsigned char *reason;
};

static spin_status leave_out_unseen(struct spin_scene_edit *e, int frame, const struct rows *rows)
{
    const struct spin_views *views = &e->clip->views;
    int row = e->clip->dataset_frame[frame], n_views = 0, least = e->o->min_views;

    for (size_t v = 0; v < views->n; v++)
        n_views += views->view[v].dataset_frame == row && !views->view[v].test;
    if (n_views < least)
        return spin_misuse("--min-views %d: frame %d has %d training view%s", least,
                           e->clip->bundle.meta.frame[e->clip->frame[frame]].number, n_views,
                           n_views == 1 ? "" : "s");
    for (size_t i = 0; i < rows->n; i++) {
        int seen = 0;
        double p[3];

        for (size_t v = 0; v < views->n && seen < least && !rows->reason[i]; v++)
            seen += views->view[v].dataset_frame == row && !views->view[v].test &&
                    spin_camera_sees(&views->view[v].camera, rows->place + 3 * i, p) &&
                    p[2] > spin_camera_near(&views->view[v].camera);
        if (!rows->reason[i] && is_finite(rows->place + 3 * i) && seen < least)
            rows->reason[i] = 1 + SPIN_EDIT_MIN_VIEWS;
    }
    return SPIN_OK;
}

/* Among the remaining rows: drops a row if the RMS distance to its three nearest neighbours exceeds
 * F times the median, and its own reach. */
static spin_status leave_out_floaters(struct spin_scene_edit *e, const struct rows *rows)
{
    size_t n = 0;
    SPIN_FREED size_t *row = NULL;
    SPIN_FREED float *place = NULL, *square = NULL, *sorted = NULL;
    double limit = 0;

    SPIN_TRY(spin_alloc(rows->n + 1, sizeof *row, (void **)&row));
    SPIN_TRY(spin_alloc(rows->n + 1, 3 * sizeof *place, (void **)&place));
    SPIN_TRY(spin_alloc(rows->n + 1, sizeof *square, (void **)&square));
    SPIN_TRY(spin_alloc(rows->n + 1, sizeof *sorted, (void **)&sorted));
    for (size_t i = 0; i < rows->n; i++)
        if (!rows->reason[i] && is_finite(rows->place + 3 * i)) {
            memcpy(place + 3 * n, rows->place + 3 * i, 3 * sizeof *place);
            row[n++] = i;
        }
    SPIN_TRY(spin_knn_mean_dist2(e->pool, n, place, square));
    memcpy(sorted, square, n * sizeof *sorted);
    qsort(sorted, n, sizeof *sorted, spin_by_float);
    if (n > 0)
        limit = e->o->floaters * e->o->floaters * (double)sorted[n / 2];
    for (size_t k = 0; k < n; k++) {
        const float *scale = rows->log_scale + 3 * row[k];
        double reach =
            REACH * exp(fmax((double)scale[0], fmax((double)scale[1], (double)scale[2])));

        if ((double)square[k] > limit && !(reach * reach >= (double)square[k]))
            rows->reason[row[k]] = 1 + SPIN_EDIT_FLOATERS;
    }
    return SPIN_OK;
}

/* The tracks of the backdrop are the last ones. */
static spin_status leave_out_backdrop(struct spin_scene_edit *e, int frame, const struct rows *rows)
{
    size_t first = e->tracks.n - e->tracks.n_backdrop;

    if (e->tracks.n_backdrop == 0)
        return SPIN_OK;
    SPIN_TRY(spin_grow(rows->n + 1, sizeof *e->track, (void **)&e->track));
    SPIN_TRY(spin_bundle_tracks_numbers(&e->tracks, e->clip->frame[frame], rows->n, e->track));
    for (size_t i = 0; i < rows->n; i++)
        if (!rows->reason[i] && e->track[i] != SPIN_NOT_TRACKED && e->track[i] >= first)
            rows->reason[i] = 1 + SPIN_EDIT_BACKDROP;
    return SPIN_OK;
}

static spin_status judge(struct spin_scene_edit *e, int frame, const struct rows *rows)
{
    memset(rows->reason, 0, rows->n);
    for (size_t i = 0; i < rows->n; i++)
        if (is_finite(rows->place + 3 * i) && crops_away(e->o, rows->place + 3 * i))
            rows->reason[i] = 1 + SPIN_EDIT_CROP;
    if (e->o->min_views > 0)
        SPIN_TRY(leave_out_unseen(e, frame, rows));
    return e->o->floaters > 0 ? leave_out_floaters(e, rows) : SPIN_OK;
}

/* Counts the kept rows, and the dropped ones by filter. */
static void count(struct spin_scene_edit *e, const unsigned char *reason, size_t n)
{
    e->n_seen += n;
    for (size_t i = 0; i < n; i++) {
        e->n_kept += !reason[i];
        if (reason[i])
            e->n_left_out[reason[i] - 1]++;
    }
}

/* Marks the rows to keep: those without a reason, or all if they were chosen before. */
static spin_status mark_rows(const struct spin_scene_edit *e, const unsigned char *reason, size_t n,
                             unsigned char **mark)
{
    SPIN_TRY(spin_alloc(n + 1, 1, (void **)mark));
    for (size_t i = 0; i < n; i++)
        (*mark)[i] = e->chosen || !reason[i];
    return SPIN_OK;
}

/* ---- Size and place -------------------------------------------------------------------------- */

static double scale_of(const struct spin_scene_edit *e)
{
    return e->o->scale > 0 ? e->o->scale : 1;
}

static void move_places(const struct spin_scene_edit *e, float *place, size_t n)
{
    for (size_t i = 0; i < 3 * n; i++)
        place[i] = (float)(scale_of(e) * (double)place[i] + e->o->translate[i % 3]);
}

static void move_scales(const struct spin_scene_edit *e, float *log_scale, size_t n)
{
    float more = (float)log(scale_of(e));

    for (size_t i = 0; i < 3 * n; i++)
        log_scale[i] += more;
}

spin_status spin_scene_edit_views(struct spin_scene_edit *e, const struct spin_views **out)
{
    const struct spin_views *from = &e->clip->views;

    *out = e->clip->has_views ? from : NULL;
    if (!e->clip->has_views || !e->moves)
        return SPIN_OK;
    spin_views_free(&e->views);
    for (size_t v = 0; v < from->n; v++) {
        struct spin_view view = from->view[v];
        double *m = view.camera.w2c;

        for (int r = 0; r < 3; r++) /* solve R (s p + t) + w' = s (R p + w) for w' */
            m[4 * r + 3] = scale_of(e) * m[4 * r + 3] - m[4 * r] * e->o->translate[0] -
                           m[4 * r + 1] * e->o->translate[1] - m[4 * r + 2] * e->o->translate[2];
        view.camera.z_near = scale_of(e) * spin_camera_near(&view.camera);
        SPIN_TRY(spin_views_add(&e->views, &view));
    }
    e->views.n_dataset_frames = from->n_dataset_frames;
    e->views.numbered = from->numbered;
    *out = &e->views;
    return SPIN_OK;
}

/* ---- Frames and 4D splats -------------------------------------------------------------------- */

spin_status spin_scene_edit_judge(struct spin_scene_edit *e, int frame, const struct spin_splats *s,
                                  bool counts)
{
    struct rows rows = {s->n, s->means, s->log_scales, NULL};

    SPIN_TRY(spin_grow(s->n + 1, 1, (void **)&e->reason));
    rows.reason = e->reason;
    SPIN_TRY(judge(e, frame, &rows));
    SPIN_TRY(leave_out_backdrop(e, frame, &rows));
    if (counts)
        count(e, e->reason, s->n);
    return SPIN_OK;
}

spin_status spin_scene_edit_frame(struct spin_scene_edit *e, int frame,
                                  const struct spin_splats *in, bool counts,
                                  struct spin_splats *out)
{
    SPIN_FREED unsigned char *mark = NULL;

    if (!e->chosen)
        SPIN_TRY(spin_scene_edit_judge(e, frame, in, counts));
    SPIN_TRY(mark_rows(e, e->reason, in->n, &mark));
    SPIN_TRY(spin_splats_take(in, mark, out));
    if (e->moves) {
        move_places(e, out->means, out->n);
        move_scales(e, out->log_scales, out->n);
    }
    return SPIN_OK;
}

/* Finds the frame in which each row is judged, or -1 if no frame shows it. */
static void find_frames(const struct spin_scene_edit *e, const struct spin_splats_4d *s, int *frame)
{
    for (size_t i = 0; i < s->n; i++) {
        double nearest = INFINITY;

        frame[i] = -1;
        for (int f = 0; f < e->clip->n_frames; f++) {
            double time = e->clip->bundle.meta.frame[e->clip->frame[f]].time;
            double away = fabs(time - (double)s->times[i]);

            if (away < nearest && spin_splats_4d_shows(s, i, time)) {
                nearest = away;
                frame[i] = f;
            }
        }
    }
}

/* Judges the rows assigned to this frame, among all rows that the frame shows. */
static spin_status judge_slice(struct spin_scene_edit *e, const struct spin_splats_4d *s, int frame,
                               const int *frame_of, struct spin_splats *slice,
                               unsigned char *reason)
{
    double time = e->clip->bundle.meta.frame[e->clip->frame[frame]].time;
    struct rows rows;
    size_t at = 0;

    SPIN_TRY(spin_splats_4d_slice(s, time, SPIN_COL_MEANS | SPIN_COL_LOG_SCALES, slice));
    SPIN_TRY(spin_grow(slice->n + 1, 1, (void **)&e->reason));
    rows = (struct rows){slice->n, slice->means, slice->log_scales, e->reason};
    SPIN_TRY(judge(e, frame, &rows));
    for (size_t i = 0; i < s->n; i++) {
        if (!spin_splats_4d_shows(s, i, time))
            continue;
        if (frame_of[i] == frame)
            reason[i] = e->reason[at];
        at++;
    }
    return SPIN_OK;
}

static spin_status judge_4d(struct spin_scene_edit *e, const struct spin_splats_4d *s,
                            unsigned char *reason)
{
    SPIN_LEAVES(spin_splats_free) struct spin_splats slice = {0};
    SPIN_FREED int *frame = NULL;

    SPIN_TRY(spin_alloc(s->n + 1, sizeof *frame, (void **)&frame));
    find_frames(e, s, frame);
    for (size_t i = 0; i < s->n; i++)
        if (frame[i] < 0 && crops_away(e->o, s->centres + 3 * i))
            reason[i] = 1 + SPIN_EDIT_CROP;
    for (int f = 0; f < e->clip->n_frames; f++) {
        size_t i = 0;

        while (i < s->n && frame[i] != f)
            i++;
        if (i < s->n)
            SPIN_TRY(judge_slice(e, s, f, frame, &slice, reason));
    }
    return SPIN_OK;
}

spin_status spin_scene_edit_judge_4d(struct spin_scene_edit *e, const struct spin_splats_4d *s)
{
    if (e->reason_4d)
        return SPIN_OK;
    SPIN_TRY(spin_alloc(s->n + 1, 1, (void **)&e->reason_4d));
    if (e->filters)
        SPIN_TRY(judge_4d(e, s, e->reason_4d));
    count(e, e->reason_4d, s->n);
    return SPIN_OK;
}

spin_status spin_scene_edit_4d(struct spin_scene_edit *e, const struct spin_splats_4d *in,
                               const struct spin_splats_4d **out)
{
    struct spin_splats_4d *to = &e->splats_4d;
    SPIN_FREED unsigned char *mark = NULL;
    size_t n_dropped;

    spin_splats_4d_free(to);
    if (!e->chosen)
        SPIN_TRY(spin_scene_edit_judge_4d(e, in));
    SPIN_TRY(mark_rows(e, e->reason_4d, in->n, &mark));
    SPIN_TRY(spin_splats_4d_take(in, mark, to));
    if (e->moves) {
        move_places(e, to->centres, to->n);
        move_scales(e, to->log_scales, to->n);
        for (size_t i = 0; i < 3 * to->n * (size_t)in->degree; i++)
            to->paths[i] = (float)(scale_of(e) * (double)to->paths[i]);
    }
    SPIN_TRY(spin_splats_4d_settle(to, &n_dropped, NULL));
    *out = to;
    return SPIN_OK;
}
