/* Divides the tracks of a trained clip into rows. Reads the frames once, in the order of their
 * times, and extends the current segment of each track until a splat does not fit, which begins a
 * new segment. A splat without a track is a segment of one frame. */
#include "train/rows_4d.h"

#include "base/base.h"
#include "model/field.h"

const double spin_rows_4d_least_weight = 0.01;

/* Largest deviation of a splat's position from the row of its segment, in units of the geometric
 * mean of the row's scales. This and the next constants were tuned on the clip "court"
 * (docs/results.md). */
static const float place_tolerance = 0.5f;
/* Largest deviations of a splat's log scale, rotation, first SH coefficient and logit opacity from
 * the row of its segment. `first` and `width` are the position and the number of these values in a
 * row of SPIN_TRACK floats. */
static const struct {
    size_t first, width;
    float tolerance;
} attribute_group[] = {{3, 3, 0.25f}, {7, 4, 0.2f}, {10, 3, 0.15f}, {13, 1, 1.0f}};
enum { ATTRIBUTE_GROUPS = sizeof attribute_group / sizeof *attribute_group };

/* The standard deviation of a segment's Gaussian window is bell_of_span times the duration of the
 * segment plus bell_of_frame times the interval between frames. */
static const double bell_of_span = 0.3, bell_of_frame = 0.25;

/* Largest number of frames of a segment, except in static tracks. */
enum { MOST_FRAMES = 8 };

/* The current segment of a track. */
struct piece {
    /* First frame, and number of frames; n is 0 if the track has no current segment. n may exceed
     * MOST_FRAMES in a static track: `value` then contains only the first MOST_FRAMES splats, since
     * the values of all splats are the same. */
    int first, n;
    float value[MOST_FRAMES][SPIN_TRACK];
};

struct cut {
    struct spin_rows_4d *rows;
    struct spin_plan *plan;
    struct spin_bundle_tracks tracks;
    struct piece *piece; /* [tracks] current segment of each track */
    float *time;         /* [frames] time of each frame, 0..1 */
    uint32_t *number;    /* track of each splat of the current frame */
    float *means, *values;
};

/* ---- Segments -------------------------------------------------------------------------------- */

/* Converts a segment to a row. A straight line, that is, a position and a velocity, is fitted to
 * the positions by least squares; the other values are averaged. */
static void fit_row(const struct cut *c, const struct piece *p, float row[SPIN_TRACK],
                    float motion[SPIN_MOTION])
{
    double mean[SPIN_TRACK] = {0}, middle = 0, square = 0, slope[3] = {0};

    for (int i = 0; i < p->n; i++) {
        middle += (double)c->time[p->first + i] / p->n;
        for (int k = 0; k < SPIN_TRACK; k++)
            mean[k] += (double)p->value[i][k] / p->n;
    }
    for (int i = 0; i < p->n; i++) {
        double d = (double)c->time[p->first + i] - middle;

        square += d * d;
        for (int k = 0; k < 3; k++)
            slope[k] += d * ((double)p->value[i][k] - mean[k]);
    }
    for (int k = 0; k < SPIN_TRACK; k++)
        row[k] = (float)mean[k];
    for (int k = 0; k < 3; k++)
        motion[k] = square > 0 ? (float)(slope[k] / square) : 0;
    motion[3] = (float)middle;
}

/* True if the deviations of all splats of a segment from the segment's row are within the
 * tolerances. */
static bool fits_row(const struct cut *c, const struct piece *p)
{
    float row[SPIN_TRACK], motion[SPIN_MOTION];
    double size;

    fit_row(c, p, row, motion);
    size = (double)place_tolerance * exp((double)(row[3] + row[4] + row[5]) / 3);
    for (int i = 0; i < p->n; i++) {
        float d = c->time[p->first + i] - motion[3];
        double away = 0;

        for (int k = 0; k < 3; k++)
            away += pow((double)(row[k] + d * motion[k] - p->value[i][k]), 2);
        if (away > size * size)
            return false;
        for (int l = 0; l < ATTRIBUTE_GROUPS; l++)
            for (size_t k = attribute_group[l].first;
                 k < attribute_group[l].first + attribute_group[l].width; k++)
                if (fabsf(row[k] - p->value[i][k]) > attribute_group[l].tolerance)
                    return false;
    }
    return true;
}

static spin_status reserve_row(struct spin_rows_4d *rows)
{
    size_t capacity = rows->capacity;

    SPIN_TRY(
        spin_array_grow(rows->n, &capacity, SPIN_TRACK * sizeof(float), (void **)&rows->values));
    return spin_array_grow(rows->n, &rows->capacity, SPIN_MOTION * sizeof(float),
                           (void **)&rows->motion);
}

/* Adapts the Gaussian window of a segment that contains the first or the last frame of the clip:
 * since no segment beyond that end cross-fades with this one, moves the centre of the window
 * halfway to the end and makes the window wider. Returns the duration of the window; for other
 * segments, that is the duration of the segment. */
static double move_to_end(const struct cut *c, const struct piece *p, float *row, float *motion)
{
    int last = p->first + p->n - 1, n = c->rows->n_frames;
    double span = (double)c->time[last] - (double)c->time[p->first];
    float end = c->time[p->first == 0 ? 0 : n - 1], d = (end - motion[3]) / 2;

    if (p->first > 0 && last < n - 1)
        return span;
    for (int k = 0; k < 3; k++)
        row[k] += d * motion[k];
    motion[3] += d;
    return 1.5 * span;
}

/* Ends a segment and adds its row. If the segment consists of all frames, its window is constant.
 */
static spin_status end_piece(struct cut *c, struct piece *p)
{
    struct spin_rows_4d *rows = c->rows;
    float *row, *motion;
    double frame = rows->n_frames > 1 ? 1.0 / (rows->n_frames - 1) : 1, span;

    if (p->n == 0)
        return SPIN_OK;
    SPIN_TRY(reserve_row(rows));
    row = rows->values + SPIN_TRACK * rows->n;
    motion = rows->motion + SPIN_MOTION * rows->n;
    if (p->n > MOST_FRAMES) { /* the track is static, so all frames have the same values */
        memcpy(row, p->value[0], sizeof p->value[0]);
        memset(motion, 0, SPIN_MOTION * sizeof *motion);
        motion[3] = (c->time[p->first] + c->time[p->first + p->n - 1]) / 2;
    } else {
        fit_row(c, p, row, motion);
    }
    span = p->n < rows->n_frames ? move_to_end(c, p, row, motion) : HUGE_VAL;
    motion[4] = (float)(1 / (bell_of_span * span + bell_of_frame * frame));
    rows->n_whole += p->n == rows->n_frames;
    rows->n++;
    p->n = 0;
    return SPIN_OK;
}

/* Adds a splat of frame f to the current segment of a track. If the splat does not fit, ends the
 * segment and begins a new one with this splat. still: true if the track is static, so that its
 * splats have the same values in all frames. */
static spin_status grow_piece(struct cut *c, struct piece *p, int f, bool still,
                              const float value[SPIN_TRACK])
{
    if (p->n > 0 && (p->first + p->n != f || (!still && p->n == MOST_FRAMES)))
        SPIN_TRY(end_piece(c, p));
    if (p->n == 0)
        p->first = f;
    if (p->n < MOST_FRAMES)
        memcpy(p->value[p->n], value, sizeof p->value[0]);
    p->n++;
    if (still || fits_row(c, p))
        return SPIN_OK;
    p->n--;
    SPIN_TRY(end_piece(c, p));
    p->first = f;
    p->n = 1;
    memcpy(p->value[0], value, sizeof p->value[0]);
    return SPIN_OK;
}

/* ---- The pass -------------------------------------------------------------------------------- */

static spin_status reserve_frame(struct cut *c, size_t n)
{
    void *number = c->number, *means = c->means, *values = c->values;

    SPIN_TRY(spin_grow(n + 1, sizeof *c->number, &number));
    c->number = number;
    SPIN_TRY(spin_grow(n + 1, 3 * sizeof *c->means, &means));
    c->means = means;
    SPIN_TRY(spin_grow(n + 1, SPIN_RESIDUAL * sizeof *c->values, &values));
    c->values = values;
    return SPIN_OK;
}

static spin_status cut_frame(struct cut *c, int f)
{
    struct spin_bundle *bundle = &c->plan->clip.bundle;
    int index = spin_plan_index(c->plan, f);
    size_t n = spin_bundle_count(bundle, index, SPIN_FROM_TRAINED);

    SPIN_TRY(reserve_frame(c, n));
    SPIN_TRY(spin_bundle_tracks_frame(&c->tracks, index, n, c->means, c->values));
    SPIN_TRY(spin_bundle_tracks_numbers(&c->tracks, index, n, c->number));
    for (size_t i = 0; i < n; i++) {
        uint32_t k = c->number[i];
        float value[SPIN_TRACK];

        memcpy(value, c->means + 3 * i, 3 * sizeof *value);
        memcpy(value + 3, c->values + SPIN_RESIDUAL * i, SPIN_RESIDUAL * sizeof *value);
        if (k == SPIN_NOT_TRACKED) {
            struct piece alone = {0};

            SPIN_TRY(grow_piece(c, &alone, f, false, value));
            SPIN_TRY(end_piece(c, &alone));
        } else {
            SPIN_TRY(grow_piece(c, &c->piece[k], f,
                                k >= c->tracks.n_moving && k >= c->tracks.n_varying, value));
        }
    }
    return SPIN_OK;
}

/* Sets rows->of and rows->counts, the rows that are rendered in each frame. */
static spin_status list_frames(struct cut *c)
{
    struct spin_rows_4d *rows = c->rows;
    double reach = sqrt(-2 * log(spin_rows_4d_least_weight));
    SPIN_FREED uint32_t *shown = NULL;

    SPIN_TRY(spin_alloc(rows->n + 1, sizeof *shown, (void **)&shown));
    for (int f = 0; f < rows->n_frames; f++) {
        size_t n = 0;

        for (size_t i = 0; i < rows->n; i++) {
            const float *motion = rows->motion + SPIN_MOTION * i;

            if (fabs((double)(c->time[f] - motion[3]) * (double)motion[4]) <= reach)
                shown[n++] = (uint32_t)i;
        }
        SPIN_TRY(spin_alloc(n + 1, sizeof *shown, (void **)&rows->of[f]));
        memcpy(rows->of[f], shown, n * sizeof *shown);
        rows->counts[f] = n;
    }
    return SPIN_OK;
}

static spin_status check_input(const struct cut *c)
{
    const struct spin_plan *plan = c->plan;

    if (!spin_bundle_is_trained_by_tracks(c->tracks.bundle))
        return spin_not_found(
            "--method 4d needs a clip that was trained with --method tracks: train this clip with "
            "--method tracks first, and use that output as the input");
    for (int f = 1; f < plan->clip.n_frames; f++)
        if (spin_plan_info(plan, f)->time < spin_plan_info(plan, f - 1)->time)
            return spin_unsupported("frame %d follows frame %d but has an earlier time: --method "
                                    "4d needs frames in the order of their times",
                                    spin_plan_info(plan, f)->number,
                                    spin_plan_info(plan, f - 1)->number);
    return SPIN_OK;
}

/* Sets the numbers of splats in the plan to the numbers of rows that are rendered in each frame. */
static void set_counts(struct spin_plan *plan, const struct spin_rows_4d *rows)
{
    plan->n_rows = rows->n;
    plan->clip.n_max = 0;
    plan->clip.n_mean = 0;
    for (int f = 0; f < rows->n_frames; f++) {
        plan->counts[f] = rows->counts[f];
        plan->clip.n_max = rows->counts[f] > plan->clip.n_max ? rows->counts[f] : plan->clip.n_max;
        plan->clip.n_mean += (double)rows->counts[f] / rows->n_frames;
    }
    plan->report->splats_mean = plan->clip.n_mean;
}

spin_status spin_rows_4d_cut(struct spin_rows_4d *rows, struct spin_plan *plan)
{
    struct cut c = {.rows = rows, .plan = plan};
    size_t n_frames = (size_t)plan->clip.n_frames;
    spin_status status;

    rows->n_frames = plan->clip.n_frames;
    SPIN_TRY_OUT(spin_bundle_tracks_open(&plan->clip.bundle, &c.tracks));
    SPIN_TRY_OUT(check_input(&c));
    SPIN_TRY_OUT(spin_alloc(n_frames, sizeof *rows->of, (void **)&rows->of));
    SPIN_TRY_OUT(spin_alloc(n_frames, sizeof *rows->counts, (void **)&rows->counts));
    SPIN_TRY_OUT(spin_alloc(n_frames, sizeof *c.time, (void **)&c.time));
    SPIN_TRY_OUT(spin_alloc(c.tracks.n, sizeof *c.piece, (void **)&c.piece));
    for (int f = 0; f < rows->n_frames; f++)
        c.time[f] = spin_field_time(&plan->field, spin_plan_info(plan, f)->time);
    for (int f = 0; f < rows->n_frames; f++)
        SPIN_TRY_OUT(cut_frame(&c, f));
    for (size_t k = 0; k < c.tracks.n; k++)
        SPIN_TRY_OUT(end_piece(&c, &c.piece[k]));
    SPIN_TRY_OUT(list_frames(&c));
    set_counts(plan, rows);
out:
    spin_bundle_tracks_close(&c.tracks);
    free(c.piece);
    free(c.time);
    free(c.number);
    free(c.means);
    free(c.values);
    return status;
}

void spin_rows_4d_close(struct spin_rows_4d *rows)
{
    for (int f = 0; rows->of && f < rows->n_frames; f++)
        free(rows->of[f]);
    free(rows->of);
    free(rows->counts);
    free(rows->values);
    free(rows->motion);
    memset(rows, 0, sizeof *rows);
}

/* ---- Training -------------------------------------------------------------------------------- */

/* Reads an array of three numbers, such as the log gains of a camera, to `to` [3]. Numbers that are
 * missing or not finite leave their value unchanged. */
static void read_three(const spin_json *array, float *to)
{
    for (size_t c = 0; c < 3; c++) {
        double value = 0;

        if (spin_json_number(spin_json_at(array, c), &value) && isfinite(value))
            to[c] = (float)value;
    }
}

spin_status spin_rows_4d_photometric(struct spin_plan *plan)
{
    const spin_json *json = plan->clip.bundle.json;
    const spin_json *cameras = spin_json_get(spin_json_get(json, "trained"), "cameras");
    struct spin_lenses lenses = {0};
    float *lens = plan->exposure + SPIN_EXPOSURE * (size_t)plan->n_cameras;

    SPIN_TRY(spin_lenses_from_json(spin_json_get(json, "lenses"), plan->o->image_scale, &lenses));
    for (size_t i = 0; i < spin_json_length(cameras); i++) {
        const spin_json *one = spin_json_at(cameras, i);
        double id = NAN;

        spin_json_number(spin_json_get(one, "camera"), &id);
        for (int k = 0; k < plan->n_cameras; k++)
            if (plan->camera[k] == id) {
                read_three(spin_json_get(one, "log_gain"), plan->exposure + SPIN_EXPOSURE * k);
                read_three(spin_json_get(one, "offset"), plan->exposure + SPIN_EXPOSURE * k + 3);
            }
    }
    for (int k = 0; k < plan->lenses.n && k < lenses.n; k++) {
        memcpy(plan->lenses.lens[k].falloff, lenses.lens[k].falloff, sizeof lenses.lens[k].falloff);
        memcpy(lens + SPIN_EXPOSURE * k, lenses.lens[k].falloff, sizeof lenses.lens[k].falloff);
    }
    spin_lenses_free(&lenses);
    return SPIN_OK;
}

/* Each row becomes a track of the trainer. The splats of a frame are the rows that are rendered in
 * it, in the same order. */
spin_status spin_rows_4d_load(const struct spin_rows_4d *rows, const struct spin_plan *plan,
                              struct spin_trainer *t, struct spin_frames *frames)
{
    struct spin_device *d = t->device;
    size_t n = rows->n;
    SPIN_FREED float *groups = NULL;

    SPIN_TRY(spin_alloc((size_t)rows->n_frames, sizeof *frames->permutation,
                        (void **)&frames->permutation));
    frames->n = rows->n_frames;
    for (int f = 0; f < frames->n; f++) {
        SPIN_TRY(spin_frames_reserve(frames, t, f, rows->counts[f]));
        for (size_t i = 0; i < rows->counts[f]; i++)
            frames->permutation[f][i] = (uint32_t)i;
        t->frame[f].time = spin_plan_info(plan, f)->time;
        d->op->upload(d, t->frame[f].track, rows->of[f], rows->counts[f] * sizeof **rows->of);
    }
    SPIN_TRY(spin_alloc(n + 1, SPIN_TRACK * sizeof *groups, (void **)&groups));
    for (size_t i = 0; i < n; i++)
        memcpy(groups + 3 * i, rows->values + SPIN_TRACK * i, 3 * sizeof *groups);
    spin_residual_from_rows(n, rows->values + 3, SPIN_TRACK, NULL, groups + 3 * n);
    d->op->upload(d, t->tracks.p, groups, SPIN_TRACK * n * sizeof *groups);
    d->op->upload(d, t->motion, rows->motion, SPIN_MOTION * n * sizeof *rows->motion);
    return SPIN_OK;
}

/* ---- The result ------------------------------------------------------------------------------ */

/* Sets 4D splat i of *out to track i of the trainer: copies its values from the groups of n tracks
 * (model/field.h), and converts its motion to the unit of time of the clip. */
static void set_row(const struct spin_field *field, size_t n, size_t i, const float *groups,
                    const float *motion, struct spin_splats_4d *out)
{
    double span = field->time_last > field->time_first ? field->time_last - field->time_first : 1;
    const float *residual = groups + 3 * n;

    memcpy(out->centres + 3 * i, groups + 3 * i, 3 * sizeof *groups);
    memcpy(out->log_scales + 3 * i, residual + 3 * i, 3 * sizeof *groups);
    memcpy(out->quats + 4 * i, residual + 3 * n + 4 * i, 4 * sizeof *groups);
    memcpy(out->sh + 3 * i, residual + 7 * n + 3 * i, 3 * sizeof *groups);
    out->logit_opacities[i] = residual[10 * n + i];
    for (int c = 0; c < 3; c++)
        out->paths[3 * i + (size_t)c] = (float)((double)motion[c] / span);
    out->times[i] = (float)(field->time_first + (double)motion[3] * span);
    out->sigmas[i] = motion[4] > 0 ? (float)(span / (double)motion[4]) : SPIN_FOREVER;
}

spin_status spin_rows_4d_read(const struct spin_plan *plan, struct spin_trainer *t,
                              enum spin_round_4d round, struct spin_splats_4d *out)
{
    struct spin_device *d = t->device;
    size_t n = t->n_tracks, n_dropped;
    SPIN_FREED float *groups = NULL;
    float *motion;

    SPIN_TRY(spin_splats_4d_reserve(out, n, 1, 0, 0));
    SPIN_TRY(spin_alloc(n + 1, (SPIN_TRACK + SPIN_MOTION) * sizeof *groups, (void **)&groups));
    motion = groups + SPIN_TRACK * n;
    SPIN_TRY(d->op->download(d, groups, t->tracks.p, SPIN_TRACK * n * sizeof *groups));
    SPIN_TRY(d->op->download(d, motion, t->motion, SPIN_MOTION * n * sizeof *motion));
    for (size_t i = 0; i < n; i++)
        set_row(&t->field, n, i, groups, motion + SPIN_MOTION * i, out);
    out->antialias = plan->o->antialias;
    out->least_weight = spin_rows_4d_least_weight;
    spin_splats_4d_round(out, round);
    return spin_splats_4d_finish(out, &n_dropped, NULL);
}
