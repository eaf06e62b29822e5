/* Implements --crop, --min-views, --floaters, --backdrop, --min-opacity and --max-scale of
 * spin-export, and drops the rows that no viewer can draw. */
#include "run/row_filter.h"

#include "base/base.h"
#include "geometry/neighbours.h"
#include "math/drawable.h"
#include "math/sh.h"

/* A splat is no floater if the RMS distance to its nearest neighbours is at most this many times
 * its largest scale. */
#define REACH 3.0
#define BLOCK 4096 /* rows per task */

static const char *const names[SPIN_ROW_REASONS] = {
    [SPIN_ROW_CROP] = "crop",
    [SPIN_ROW_MIN_VIEWS] = "min-views",
    [SPIN_ROW_FLOATERS] = "floaters",
    [SPIN_ROW_BACKDROP] = "backdrop off",
    [SPIN_ROW_NOT_FINITE] = "with NaN or infinity",
    [SPIN_ROW_NO_ROTATION] = "with a rotation of length zero",
    [SPIN_ROW_TOO_LARGE] = "larger than the scene",
    [SPIN_ROW_MIN_OPACITY] = "min-opacity",
};
static const enum spin_row_reason undrawable[SPIN_ROWS_REASONS] = {
    [SPIN_ROWS_NOT_FINITE] = SPIN_ROW_NOT_FINITE,
    [SPIN_ROWS_NO_ROTATION] = SPIN_ROW_NO_ROTATION,
    [SPIN_ROWS_TOO_LARGE] = SPIN_ROW_TOO_LARGE,
};

static bool is_undrawable(int reason)
{
    return reason == SPIN_ROW_NOT_FINITE || reason == SPIN_ROW_NO_ROTATION ||
           reason == SPIN_ROW_TOO_LARGE;
}

/* Returns whether the reason is an option of spin-export other than --decimate, which has its own
 * report. */
static bool is_filtered(int reason)
{
    return reason != SPIN_ROW_KEPT && reason != SPIN_ROW_DECIMATE && !is_undrawable(reason);
}

/* ---- Opening --------------------------------------------------------------------------------- */

/* Checks that every frame has N training views, as --min-views N requires. */
static spin_status check_views(const struct spin_clip *clip, int least)
{
    for (int f = 0; f < clip->n_frames; f++) {
        int n = 0;

        for (size_t v = 0; v < clip->views.n; v++)
            n += clip->views.view[v].dataset_frame == clip->dataset_frame[f] &&
                 !clip->views.view[v].test;
        if (n < least)
            return spin_misuse(
                "--min-views %d: frame %d has %d training view%s: give a smaller number", least,
                clip->bundle.meta.frame[clip->frame[f]].number, n, n == 1 ? "" : "s");
    }
    return SPIN_OK;
}

static spin_status check_options(const struct spin_export_options *o, const struct spin_clip *clip)
{
    const double *box = o->crop;

    for (int c = 0; c < 3 && o->n_crop == 6; c++)
        if (!(box[c] < box[3 + c]))
            return spin_misuse(
                "--crop: the bounding box spans %g to %g: give the smaller coordinate first",
                box[c], box[3 + c]);
    if (o->n_crop == 4 && !(box[3] > 0))
        return spin_misuse("--crop: the radius of the sphere is %g, expected more than 0", box[3]);
    if (o->min_views > 0 && !clip->has_views)
        return spin_misuse("--min-views needs a data set: give --data DIR");
    return check_views(clip, o->min_views);
}

spin_status spin_row_filter_open(struct spin_row_filter *f, const struct spin_export_options *o,
                                 const struct spin_clip *clip, bool renders)
{
    double least = o->min_opacity;

    f->o = o;
    f->clip = clip;
    f->min_logit = least > 0 ? (float)log(least / (1 - least)) : -INFINITY;
    f->max_scale = o->max_scale > 0 ? o->max_scale : renders ? INFINITY : 1;
    if (o->backdrop == SPIN_EXPORT_BACKDROP_OFF && !o->source)
        SPIN_TRY(spin_bundle_tracks_open((struct spin_bundle *)&clip->bundle, &f->tracks));
    if (o->backdrop == SPIN_EXPORT_BACKDROP_OFF && f->tracks.n_backdrop == 0)
        spin_warn("--backdrop off has no effect: these splats have no backdrop");
    f->varies = o->n_crop > 0 || o->min_views > 0 || o->floaters > 0 || f->tracks.n_backdrop > 0 ||
                o->min_opacity > 0;
    SPIN_TRY(check_options(o, clip));
    spin_row_filter_restart(f);
    return spin_pool_create(o->n_threads, &f->pool);
}

void spin_row_filter_close(struct spin_row_filter *f)
{
    if (f->pool)
        spin_pool_free(f->pool);
    spin_bundle_tracks_close(&f->tracks);
    free(f->track);
    free(f->reason);
    free(f->reason_4d);
    free(f->first_kept);
    spin_splats_free(&f->kept);
    spin_splats_4d_free(&f->kept_4d);
    *f = (struct spin_row_filter){0};
}

void spin_row_filter_restart(struct spin_row_filter *f)
{
    f->n_seen = 0;
    f->same_rows = true;
    f->n_first = SIZE_MAX;
    memset(f->n_by, 0, sizeof f->n_by);
}

/* ---- Reports --------------------------------------------------------------------------------- */

static uint64_t sum_of(const struct spin_row_filter *f, bool (*counts)(int reason))
{
    uint64_t sum = 0;

    for (int r = 0; r < SPIN_ROW_REASONS; r++)
        sum += counts(r) ? f->n_by[r] : 0;
    return sum;
}

uint64_t spin_row_filter_n_filtered(const struct spin_row_filter *f)
{
    return sum_of(f, is_filtered);
}

uint64_t spin_row_filter_n_undrawable(const struct spin_row_filter *f)
{
    return sum_of(f, is_undrawable);
}

/* Prints the number of rows for each reason that `counts` selects, such as "3 by --crop, 5 by
 * --floaters". `by` is the text between number and reason, "by --" in this example. */
static void print_reasons(const uint64_t *n_by, bool (*counts)(int reason), const char *by,
                          char text[256])
{
    size_t at = 0;

    text[0] = '\0';
    for (int r = 0; r < SPIN_ROW_REASONS; r++)
        if (counts(r) && n_by[r] > 0)
            at += (size_t)snprintf(text + at, 256 - at, "%s%llu %s%s", at ? ", " : "",
                                   (unsigned long long)n_by[r], by, names[r]);
}

void spin_row_filter_log(const struct spin_row_filter *f)
{
    uint64_t n = spin_row_filter_n_filtered(f);
    char text[256], count[48];

    print_reasons(f->n_by, is_filtered, "by --", text);
    if (f->varies && n == f->n_seen && n > 0)
        spin_warn("no splats are left; left out: %s", text);
    else if (f->varies)
        spin_log(0, "%llu of %s left out%s%s", (unsigned long long)n,
                 spin_text_count((long long)f->n_seen, "splat", count), n > 0 ? ": " : "", text);
}

/* Adds the rows of the frame with this number to the statistics, or the 4D splats if number is -1,
 * and warns of rows that cannot be drawn. */
static void count_rows(struct spin_row_filter *f, const unsigned char *reason, size_t n, int number)
{
    uint64_t n_by[SPIN_ROW_REASONS] = {0}, n_undrawable = 0;
    char text[256], count[48], frame[32] = "";

    for (size_t i = 0; i < n; i++)
        n_by[reason[i]]++;
    f->n_seen += n;
    for (int r = 0; r < SPIN_ROW_REASONS; r++) {
        f->n_by[r] += n_by[r];
        n_undrawable += is_undrawable(r) ? n_by[r] : 0;
    }
    print_reasons(n_by, is_undrawable, "", text);
    if (number >= 0)
        snprintf(frame, sizeof frame, "frame %d: ", number);
    if (n_undrawable > 0)
        spin_warn("%s%llu of %s left out: %s", frame, (unsigned long long)n_undrawable,
                  spin_text_count((long long)n, "splat", count), text);
}

/* ---- Options that choose a part of the scene ------------------------------------------------- */

/* The rows to which the options are applied. */
struct rows {
    size_t n;
    const float *place, *log_scale;
    unsigned char *reason;
};

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

static void drop_unseen(struct spin_row_filter *f, int frame, const struct rows *rows)
{
    const struct spin_views *views = &f->clip->views;
    int row = f->clip->dataset_frame[frame], least = f->o->min_views;

    for (size_t i = 0; i < rows->n; i++) {
        int seen = 0;
        double p[3];

        for (size_t v = 0; v < views->n && seen < least && !rows->reason[i]; v++)
            seen += views->view[v].dataset_frame == row && !views->view[v].test &&
                    spin_camera_project_visible(&views->view[v].camera, rows->place + 3 * i, p) &&
                    p[2] > spin_camera_near(&views->view[v].camera);
        if (!rows->reason[i] && is_finite(rows->place + 3 * i) && seen < least)
            rows->reason[i] = SPIN_ROW_MIN_VIEWS;
    }
}

/* Drops each remaining row whose RMS distance to its three nearest neighbours is both more than F
 * times the median of this distance (--floaters F) and more than REACH times the largest scale of
 * its splat. */
static spin_status drop_floaters(struct spin_row_filter *f, const struct rows *rows)
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
    SPIN_TRY(spin_knn_mean_dist2(f->pool, n, place, square));
    memcpy(sorted, square, n * sizeof *sorted);
    qsort(sorted, n, sizeof *sorted, spin_by_float);
    if (n > 0)
        limit = f->o->floaters * f->o->floaters * (double)sorted[n / 2];
    for (size_t k = 0; k < n; k++) {
        const float *scale = rows->log_scale + 3 * row[k];
        double reach =
            REACH * exp(fmax((double)scale[0], fmax((double)scale[1], (double)scale[2])));

        if ((double)square[k] > limit && !(reach * reach >= (double)square[k]))
            rows->reason[row[k]] = SPIN_ROW_FLOATERS;
    }
    return SPIN_OK;
}

/* Initialises rows->reason, and applies the options that test the position of a row. */
static spin_status filter_places(struct spin_row_filter *f, int frame, const struct rows *rows)
{
    for (size_t i = 0; i < rows->n; i++) {
        bool away = is_finite(rows->place + 3 * i) && crops_away(f->o, rows->place + 3 * i);

        rows->reason[i] = away ? SPIN_ROW_CROP : SPIN_ROW_KEPT;
    }
    if (f->o->min_views > 0)
        drop_unseen(f, frame, rows);
    return f->o->floaters > 0 ? drop_floaters(f, rows) : SPIN_OK;
}

/* Drops the rows of the backdrop, whose tracks are the last ones of the clip. */
static spin_status drop_backdrop(struct spin_row_filter *f, int frame, const struct rows *rows)
{
    size_t first = f->tracks.n - f->tracks.n_backdrop;

    if (f->tracks.n_backdrop == 0)
        return SPIN_OK;
    SPIN_TRY(spin_grow(rows->n + 1, sizeof *f->track, (void **)&f->track));
    SPIN_TRY(spin_bundle_tracks_numbers(&f->tracks, f->clip->frame[frame], rows->n, f->track));
    for (size_t i = 0; i < rows->n; i++)
        if (!rows->reason[i] && f->track[i] != SPIN_NOT_TRACKED && f->track[i] >= first)
            rows->reason[i] = SPIN_ROW_BACKDROP;
    return SPIN_OK;
}

/* ---- Undrawable, large and nearly transparent rows ------------------------------------------- */

struct drawable {
    const struct spin_row_filter *f;
    const struct spin_splats *s;
    unsigned char *reason;
    float limit; /* the largest permitted log scale */
};

static void filter_block(void *context, size_t first, size_t end)
{
    const struct drawable *d = context;
    const struct spin_splats *s = d->s;
    size_t n_sh = 3 * (size_t)spin_sh_count(s->sh_degree);

    for (size_t i = first; i < end; i++) {
        enum spin_undrawable why;

        if (d->reason[i])
            continue;
        why = spin_undrawable(s->means + 3 * i, s->quats + 4 * i, s->log_scales + 3 * i,
                              s->logit_opacities + i, s->sh + i * n_sh, n_sh, d->limit);
        if (why != SPIN_ROWS_REASONS)
            d->reason[i] = (unsigned char)undrawable[why];
        else if (s->logit_opacities[i] < d->f->min_logit)
            d->reason[i] = SPIN_ROW_MIN_OPACITY;
    }
    spin_bundle_release_rows(s, first, end - first, SPIN_COL_ATTRIBUTES);
}

/* Drops undrawable rows and applies --min-opacity and --max-scale. The size of the scene, which
 * limits the scales, is that of the rows that remain so far. */
static void filter_attributes(const struct spin_row_filter *f, const struct spin_splats *s,
                              unsigned char *reason)
{
    float low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    struct drawable d = {.f = f, .s = s, .reason = reason};
    size_t n_finite = 0;

    for (size_t i = 0; i < s->n; i++)
        if (!reason[i])
            n_finite += (size_t)spin_box_add(s->means + 3 * i, low, high);
    d.limit = spin_log_scale_limit(low, high, n_finite, f->max_scale);
    spin_pool_rows(f->pool, s->n, BLOCK, filter_block, &d);
}

/* ---- A frame --------------------------------------------------------------------------------- */

static int number_of(const struct spin_row_filter *f, int frame)
{
    return f->clip->bundle.meta.frame[f->clip->frame[frame]].number;
}

/* Sets the reason of each row of a frame. If `source` is true, these are rows of an imported frame;
 * --backdrop then has no effect, since only a training adds a backdrop. */
static spin_status filter_rows(struct spin_row_filter *f, int frame, const struct spin_splats *s,
                               bool source)
{
    struct rows rows = {s->n, s->means, s->log_scales, NULL};

    if (s->n > UINT32_MAX)
        return spin_unsupported("frame %d has %zu splats, but at most %u are supported",
                                number_of(f, frame), s->n, UINT32_MAX);
    SPIN_TRY(spin_grow(s->n + 1, 1, (void **)&f->reason));
    rows.reason = f->reason;
    SPIN_TRY(filter_places(f, frame, &rows));
    if (!source)
        SPIN_TRY(drop_backdrop(f, frame, &rows));
    filter_attributes(f, s, f->reason);
    return SPIN_OK;
}

spin_status spin_row_filter_apply(struct spin_row_filter *f, int frame, const struct spin_splats *s)
{
    return filter_rows(f, frame, s, false);
}

/* Sets *mark to an allocated array with 1 for each row that remains and 0 for each that is dropped,
 * and *n_kept to the number of rows that remain. */
static spin_status mark_kept(const unsigned char *reason, size_t n, size_t *n_kept,
                             unsigned char **mark)
{
    *n_kept = 0;
    SPIN_TRY(spin_alloc(n + 1, 1, (void **)mark));
    for (size_t i = 0; i < n; i++)
        *n_kept += (*mark)[i] = !reason[i];
    return SPIN_OK;
}

static spin_status choose_rows(struct spin_row_filter *f, int frame, const struct spin_splats *s,
                               bool source, size_t *n_kept, unsigned char **mark)
{
    SPIN_TRY(filter_rows(f, frame, s, source));
    if (f->drop)
        SPIN_TRY(f->drop(f->drop_context, frame, s, source, f->reason));
    return mark_kept(f->reason, s->n, n_kept, mark);
}

spin_status spin_row_filter_reread(struct spin_row_filter *f, int frame,
                                   const struct spin_splats **splats)
{
    SPIN_FREED unsigned char *mark = NULL;
    size_t n_kept;

    SPIN_TRY(choose_rows(f, frame, *splats, false, &n_kept, &mark));
    if (n_kept == (*splats)->n)
        return SPIN_OK;
    if (f->merge)
        SPIN_TRY(f->merge(f->drop_context, frame, false, f->reason, splats));
    SPIN_TRY(spin_splats_select(*splats, mark, &f->kept));
    *splats = &f->kept;
    return SPIN_OK;
}

/* Clears f->same_rows if a frame and the first frame differ in the number of rows or in which of
 * the rows remain. */
static spin_status compare_with_first(struct spin_row_filter *f, size_t n)
{
    if (f->n_first == SIZE_MAX) {
        SPIN_TRY(spin_grow(n + 1, 1, (void **)&f->first_kept));
        for (size_t i = 0; i < n; i++)
            f->first_kept[i] = !f->reason[i];
        f->n_first = n;
    }
    f->same_rows = f->same_rows && n == f->n_first;
    for (size_t i = 0; i < n && f->same_rows; i++)
        f->same_rows = f->first_kept[i] == !f->reason[i];
    return SPIN_OK;
}

spin_status spin_row_filter_frame(struct spin_row_filter *f, int frame,
                                  const struct spin_splats **splats)
{
    size_t n = (*splats)->n;

    SPIN_TRY(spin_row_filter_reread(f, frame, splats));
    SPIN_TRY(compare_with_first(f, n));
    count_rows(f, f->reason, n, number_of(f, frame));
    return SPIN_OK;
}

spin_status spin_row_filter_source(struct spin_row_filter *f, int frame,
                                   const struct spin_splats *all, struct spin_splats *out)
{
    SPIN_FREED unsigned char *mark = NULL;
    size_t n_kept;

    SPIN_TRY(choose_rows(f, frame, all, true, &n_kept, &mark));
    if (f->merge)
        SPIN_TRY(f->merge(f->drop_context, frame, true, f->reason, &all));
    return spin_splats_select(all, mark, out);
}

/* ---- 4D splats ------------------------------------------------------------------------------- */

/* Sets frame[i] to the frame in which the position of 4D splat i is tested: of the frames that show
 * the splat, the one nearest to its own time. Sets frame[i] to -1 if no frame shows the splat. */
static void find_frames(const struct spin_row_filter *filter, const struct spin_splats_4d *s,
                        int *frame)
{
    for (size_t i = 0; i < s->n; i++) {
        double nearest = INFINITY;

        frame[i] = -1;
        for (int f = 0; f < filter->clip->n_frames; f++) {
            double time = filter->clip->bundle.meta.frame[filter->clip->frame[f]].time;
            double away = fabs(time - (double)s->times[i]);

            if (away < nearest && spin_splats_4d_is_visible(s, i, time)) {
                nearest = away;
                frame[i] = f;
            }
        }
    }
}

/* Tests the positions of the 4D splats that find_frames() assigned to this frame. For --floaters,
 * the neighbours of a splat are searched among all 4D splats that the frame shows. */
static spin_status filter_slice(struct spin_row_filter *f, const struct spin_splats_4d *s,
                                int frame, const int *frame_of, struct spin_splats *slice)
{
    double time = f->clip->bundle.meta.frame[f->clip->frame[frame]].time;
    struct rows rows;
    size_t at = 0;

    SPIN_TRY(spin_splats_4d_slice(s, time, SPIN_COL_MEANS | SPIN_COL_LOG_SCALES, slice));
    SPIN_TRY(spin_grow(slice->n + 1, 1, (void **)&f->reason));
    rows = (struct rows){slice->n, slice->means, slice->log_scales, f->reason};
    SPIN_TRY(filter_places(f, frame, &rows));
    for (size_t i = 0; i < s->n; i++) {
        if (!spin_splats_4d_is_visible(s, i, time))
            continue;
        if (frame_of[i] == frame)
            f->reason_4d[i] = f->reason[at];
        at++;
    }
    return SPIN_OK;
}

static spin_status filter_slices(struct spin_row_filter *f, const struct spin_splats_4d *s)
{
    SPIN_LEAVES(spin_splats_free) struct spin_splats slice = {0};
    SPIN_FREED int *frame = NULL;

    SPIN_TRY(spin_alloc(s->n + 1, sizeof *frame, (void **)&frame));
    find_frames(f, s, frame);
    for (size_t i = 0; i < s->n; i++)
        if (frame[i] < 0 && crops_away(f->o, s->centres + 3 * i))
            f->reason_4d[i] = SPIN_ROW_CROP;
    for (int k = 0; k < f->clip->n_frames; k++) {
        size_t i = 0;

        while (i < s->n && frame[i] != k)
            i++;
        if (i < s->n)
            SPIN_TRY(filter_slice(f, s, k, frame, &slice));
    }
    return SPIN_OK;
}

spin_status spin_row_filter_apply_4d(struct spin_row_filter *f, const struct spin_splats_4d *s)
{
    const struct spin_splats view = spin_splats_of_4d(s);

    if (f->reason_4d)
        return SPIN_OK;
    SPIN_TRY(spin_alloc(s->n + 1, 1, (void **)&f->reason_4d));
    if (f->o->n_crop > 0 || f->o->min_views > 0 || f->o->floaters > 0)
        SPIN_TRY(filter_slices(f, s));
    filter_attributes(f, &view, f->reason_4d);
    return SPIN_OK;
}

spin_status spin_row_filter_4d(struct spin_row_filter *f, const struct spin_splats_4d **splats_4d)
{
    const struct spin_splats_4d *s = *splats_4d;
    SPIN_FREED unsigned char *mark = NULL;
    size_t n_kept;

    SPIN_TRY(spin_row_filter_apply_4d(f, s));
    SPIN_TRY(spin_grow(s->n + 1, 1, (void **)&f->reason));
    memcpy(f->reason, f->reason_4d, s->n);
    if (f->drop_4d)
        f->drop_4d(f->drop_context, f->reason);
    count_rows(f, f->reason, s->n, -1);
    SPIN_TRY(mark_kept(f->reason, s->n, &n_kept, &mark));
    if (n_kept == s->n)
        return SPIN_OK;
    spin_splats_4d_free(&f->kept_4d);
    SPIN_TRY(spin_splats_4d_select(s, mark, &f->kept_4d));
    *splats_4d = &f->kept_4d;
    return SPIN_OK;
}
