/* Writes .4dgs, version 1 (formats/4dgs.h): one file with a clip of 4D splats, each of which is
 * visible in an interval of time. Players can load the file in parts. lib/4dgs_frames.c writes
 * clips that consist of frames.
 *
 * All values are quantised. The position is quantised last, after the splat has been moved along
 * its path to the quantised centre of its time window, so that the errors of time and velocity do
 * not displace the splat while it is visible. The clip is divided into intervals of about half a
 * second, each with a chunk of the splats that are visible in this interval only. One more chunk
 * contains the splats that are visible in several intervals. */
#include "base/base.h"
#include "exporters/lib/4dgs_frames.h"
#include "exporters/lib/time_windows.h"
#include "formats/4dgs_write.h"
#include "io/sound.h"
#include "math/motion.h"
#include "math/sh.h"

/* Opacities below this are not drawn. */
#define LEAST_CUTOFF (1 / 255.0)
/* A splat that appears or disappears abruptly does so at least this fraction of a frame before or
 * after the time of a frame, so that rounding does not make it visible in another frame. */
#define MARGIN 1e-3
/* Largest number of frames from one keyframe to the next. */
#define MOST_DEPTH 1000

struct export
{
    struct spin_time_windows windows;
    struct spin_splat_rows rows;
    struct spin_sort_rows order; /* kept rows of windows.clip, in the order of the file */
    double fps;
    struct spin_4dgs_coding coding;
    double(*span)[2];              /* [clip.n] interval in which each row is visible, in seconds */
    uint32_t *window_of;           /* [clip.n] index of `span` of this row in the window table */
    struct spin_4dgs_splat *splat; /* [order.n] */
    double segment;                /* duration of a chunk in seconds */
    double slack; /* largest error of a position at the centre of the splat's window */
    struct spin_4dgs_coder coder;
    struct spin_4dgs_frames frames; /* used if the clip consists of frames */
    struct spin_4dgs_writer writer;
    struct spin_out out;
};

/* ---- Windows --------------------------------------------------------------------------------- */

/* Converts the start (which = 0) or the end (which = 1) of a row's visibility to seconds. Relative
 * to the time of the nearest frame, the result is on the same side as in the source, so that the
 * row is visible in the same frames. */
static double convert_cut(const struct export *x, size_t k, size_t which)
{
    const struct spin_export_job *job = x->windows.job;
    double cut = (double)job->splats_4d->cuts[2 * x->windows.from[k] + which];
    double at = (double)x->windows.clip.cuts[2 * k + which] * x->fps;
    int f = (int)spin_4dgs_clamp(rint(at), 0, job->n_frames - 1);

    at = job->times[f] >= cut ? fmin(at, f - MARGIN) : fmax(at, f + MARGIN);
    return spin_4dgs_clamp(at / x->fps, 0, x->coding.duration);
}

static void set_span(struct export *x, size_t k)
{
    bool cut = x->windows.clip.cuts != NULL;

    x->span[k][0] = cut ? convert_cut(x, k, 0) : 0;
    x->span[k][1] = cut ? convert_cut(x, k, 1) : x->coding.duration;
}

static int compare_spans(const void *a, const void *b)
{
    const double *x = a, *y = b;

    return x[0] != y[0] ? (x[0] > y[0]) - (x[0] < y[0]) : (x[1] > y[1]) - (x[1] < y[1]);
}

/* Sets the window table to the distinct windows of the rows. */
static spin_status choose_windows(struct export *x)
{
    size_t n = x->windows.clip.n, n_windows = 0;
    struct spin_4dgs_coding *c = &x->coding;

    SPIN_TRY(spin_alloc(n, sizeof *x->span, (void **)&x->span));
    SPIN_TRY(spin_alloc(n, sizeof *c->window, (void **)&c->window));
    SPIN_TRY(spin_alloc(n, sizeof *x->window_of, (void **)&x->window_of));
    for (size_t k = 0; k < n; k++)
        set_span(x, k);
    memcpy(c->window, x->span, n * sizeof *c->window);
    qsort(c->window, n, sizeof *c->window, compare_spans);
    for (size_t k = 0; k < n; k++)
        if (k == 0 || compare_spans(c->window[k], c->window[n_windows - 1]) != 0)
            memmove(c->window[n_windows++], c->window[k], sizeof *c->window);
    c->n_windows = n_windows;
    for (size_t k = 0; k < n; k++) {
        double(*found)[2] =
            bsearch(x->span[k], c->window, n_windows, sizeof *c->window, compare_spans);

        x->window_of[k] = (uint32_t)(found - c->window);
    }
    return SPIN_OK;
}

/* ---- Steps ----------------------------------------------------------------------------------- */

static int compare_floats(const void *a, const void *b)
{
    const float *x = a, *y = b;

    return (*x > *y) - (*x < *y);
}

/* Sets the bounding box of positions and the quantisation steps. The step of positions depends on
 * the median of all scales. */
static spin_status choose_steps(struct export *x)
{
    const struct spin_splats_4d *s = &x->windows.clip;
    SPIN_FREED float *scale = NULL;
    double *box = x->coding.box;

    SPIN_TRY(spin_alloc(x->order.n, 3 * sizeof *scale, (void **)&scale));
    for (size_t j = 0; j < x->order.n; j++) {
        float place[3];

        memcpy(scale + 3 * j, s->log_scales + 3 * (size_t)x->order.item[j].row, 3 * sizeof *scale);
        spin_splat_rows_place(&x->rows, x->order.item[j].row, place);
        for (int c = 0; c < 3; c++) {
            box[c] = j == 0 ? (double)place[c] : fmin(box[c], (double)place[c]);
            box[3 + c] = j == 0 ? (double)place[c] : fmax(box[3 + c], (double)place[c]);
        }
    }
    qsort(scale, 3 * x->order.n, sizeof *scale, compare_floats);
    spin_4dgs_choose_steps(&x->coding, exp((double)scale[3 * x->order.n / 2]));
    return SPIN_OK;
}

/* ---- Rows ------------------------------------------------------------------------------------ */

/* Quantises sigma and centre of the time window of row k, and moves the row along its path to the
 * quantised centre. Returns `life` in seconds, from which spin_4dgs_motion_step() computes the
 * quantisation step of the velocity: the duration of a row that never fades, otherwise the time in
 * which the window falls from its centre to the cutoff. */
static double code_time(struct export *x, size_t k, struct spin_4dgs_splat *to)
{
    struct spin_splats_4d *s = &x->windows.clip;
    const double *step = x->coding.step, *span = x->span[k];
    bool never = s->sigmas[k] >= SPIN_FOREVER;
    double sigma = 0, time_step = step[SPIN_4DGS_STEP_TIME], middle = 0.5 * (span[0] + span[1]);

    spin_4dgs_bin(to, SPIN_4DGS_FLAGS)[0] = never ? SPIN_4DGS_NEVER_FADES : 0;
    if (!never) {
        spin_4dgs_bin(to, SPIN_4DGS_SIGMA)[0] =
            spin_4dgs_round(log((double)s->sigmas[k]), step[SPIN_4DGS_STEP_SIGMA]);
        sigma = exp(spin_4dgs_bin(to, SPIN_4DGS_SIGMA)[0] * step[SPIN_4DGS_STEP_SIGMA]);
        s->sigmas[k] = (float)sigma;
        time_step = spin_4dgs_time_step(step, sigma);
    }
    spin_4dgs_bin(to, SPIN_4DGS_MU)[0] =
        spin_4dgs_round(never ? middle : (double)s->times[k], time_step);
    spin_time_windows_move(s, k, spin_4dgs_bin(to, SPIN_4DGS_MU)[0] * time_step);
    return never ? span[1] - span[0] : sqrt(-2 * log(x->coding.cutoff)) * sigma;
}

/* Quantises the velocity and the position. The position is chosen such that the error of the
 * velocity has no effect at one time: the centre of the splat's time window or, if the splat is not
 * visible then, the nearest time at which it is visible. */
static void code_place(struct export *x, size_t k, double life, struct spin_4dgs_splat *to,
                       struct spin_gaussian *shown)
{
    const struct spin_splats_4d *s = &x->windows.clip;
    double step = x->coding.step[SPIN_4DGS_STEP_POSITION];
    double v_step = spin_4dgs_motion_step(x->coding.step, life);
    double d =
        spin_4dgs_clamp((double)s->times[k], x->span[k][0], x->span[k][1]) - (double)s->times[k];
    float place[3], path[3] = {0};

    spin_splat_rows_place(&x->rows, k, place);
    if (s->degree > 0)
        spin_splat_rows_direction(&x->rows, s->paths + 3 * (size_t)s->degree * k, path);
    for (int c = 0; c < 3; c++) {
        int32_t v = spin_4dgs_bin(to, SPIN_4DGS_MOTION)[c] =
            spin_4dgs_round((double)path[c], v_step);
        double at = (double)place[c] + d * ((double)path[c] - v * v_step);
        int32_t *bin = &spin_4dgs_bin(to, SPIN_4DGS_POSITION)[c];

        *bin = spin_4dgs_round(at - x->coding.origin[c], step);
        x->slack = fmax(x->slack, fabs(x->coding.origin[c] + *bin * step - (double)place[c]));
        shown->place[c] = (float)(x->coding.origin[c] + *bin * step - at + (double)place[c]);
    }
}

static void code_row(struct export *x, size_t k, struct spin_4dgs_splat *to)
{
    struct spin_gaussian is, shown;
    double life = code_time(x, k, to);

    spin_splat_rows_get(&x->rows, k, &is);
    shown = is;
    code_place(x, k, life, to, &shown);
    spin_4dgs_code_attributes(&x->coder, k, &is, to, &shown);
    *spin_4dgs_bin(to, SPIN_4DGS_WINDOW) = (int32_t)x->window_of[k];
    spin_quant_error_row(&x->coder.quant, &is, &shown);
}

/* ---- Chunks ---------------------------------------------------------------------------------- */

/* Returns the chunk of a row: 1 + the index of the interval in which it is visible, or 0 if it is
 * visible in several intervals. */
static uint64_t chunk_of(const struct export *x, size_t k)
{
    const struct spin_splats_4d *s = &x->windows.clip;
    double reach = s->sigmas[k] < SPIN_FOREVER
                       ? sqrt(-2 * log(x->coding.cutoff)) * (double)s->sigmas[k] * (1 + 1e-6)
                       : HUGE_VAL;
    double first = fmax(x->span[k][0], (double)s->times[k] - reach);
    double last = fmin(x->span[k][1], (double)s->times[k] + reach);
    double segment = floor(first / x->segment);

    return last > first && last < (segment + 1) * x->segment ? (uint64_t)segment + 1 : 0;
}

/* Quantises the rows, and sorts them by chunk and, within a chunk, by position. */
static spin_status code_rows(struct export *x)
{
    spin_sort_rows_by_place(&x->order, &x->windows.view);
    SPIN_TRY(spin_alloc(x->windows.clip.n, sizeof *x->splat, (void **)&x->splat));
    for (size_t j = 0; j < x->order.n; j++) {
        struct spin_keyed *item = &x->order.item[j];

        code_row(x, item->row, &x->splat[item->row]);
        item->key = chunk_of(x, item->row);
    }
    spin_sort_rows_sort(&x->order);
    return spin_cancelled() ? spin_fail_cancelled() : SPIN_OK;
}

static spin_status write_chunk(struct export *x, const struct spin_keyed *row, size_t n)
{
    double duration = x->coding.duration, segment = (double)row->key;
    double interval[2] = {(segment - 1) * x->segment, fmin(segment * x->segment, duration)};
    SPIN_FREED struct spin_4dgs_splat *splat = NULL;

    if (row->key == 0) {
        interval[0] = 0;
        interval[1] = duration;
    }
    SPIN_TRY(spin_alloc(n, sizeof *splat, (void **)&splat));
    for (size_t j = 0; j < n; j++)
        splat[j] = x->splat[row[j].row];
    return spin_4dgs_write_chunk(&x->writer, interval, splat, n);
}

static spin_status write_chunks(struct export *x)
{
    for (size_t j = 0, n; j < x->order.n; j += n) {
        for (n = 1; j + n < x->order.n && x->order.item[j + n].key == x->order.item[j].key;)
            n++;
        SPIN_TRY(write_chunk(x, x->order.item + j, n));
        if (spin_cancelled())
            return spin_fail_cancelled();
    }
    return SPIN_OK;
}

/* ---- The plug-in ----------------------------------------------------------------------------- */

static void free_export(void *self)
{
    struct export *x = self;

    spin_out_abandon(&x->out);
    spin_4dgs_write_free(&x->writer);
    spin_4dgs_frames_free(&x->frames);
    spin_splat_rows_end(&x->rows);
    spin_sort_rows_free(&x->order);
    spin_time_windows_free(&x->windows);
    free(x->coding.window);
    free(x->window_of);
    free(x->span);
    free(x->splat);
    free(x);
}

/* Prepares the export of a clip that consists of frames, with a keyframe about once per second. */
static void expect_frames(struct export *x, const struct spin_export_job *job)
{
    x->coding.key_every = (int)spin_4dgs_clamp(rint(x->fps), 1, MOST_DEPTH);
    x->frames = (struct spin_4dgs_frames){
        .job = job, .rows = &x->rows, .coding = &x->coding, .writer = &x->writer};
}

static spin_status check_sound(const struct spin_sound *s)
{
    if (!s)
        return SPIN_OK;
    if (spin_sound_seconds(s) <= 0)
        return spin_malformed("a .4dgs must state the duration of the sound '%s', which cannot be "
                              "read: convert the sound to WAV, or use --sound none",
                              s->name);
    if (s->start < 0)
        spin_warn("a .4dgs cannot omit the beginning of a sound, so players other than spin4d "
                  "start the sound '%s' %.3g s late: use a WAV file, which spin-export cuts",
                  s->name, -s->start);
    return SPIN_OK;
}

static spin_status prepare(struct export *x, const struct spin_export_job *job)
{
    double least = job->splats_4d ? job->splats_4d->least_weight : 0;

    x->windows =
        (struct spin_time_windows){.job = job, .name = "a .4dgs", .stores_cuts = true, .degree = 1};
    if (job->splats_4d)
        SPIN_TRY(spin_time_windows_can(&x->windows));
    SPIN_TRY(spin_time_windows_fps(&x->windows, &x->fps));
    x->windows.length = (job->n_frames - 1) / x->fps;
    x->segment = fmax(floor(x->fps / 2 + 0.5), 1) / x->fps;
    SPIN_TRY(check_sound(job->sound));
    SPIN_TRY(spin_splat_rows_begin(&x->rows, job, NULL));
    x->coding =
        (struct spin_4dgs_coding){.duration = job->n_frames / x->fps,
                                  .fps = x->fps,
                                  .cutoff = least > 0 && least < 1 ? least : LEAST_CUTOFF,
                                  .sh_degree = x->rows.sh_degree > 0 ? x->rows.sh_degree : 0,
                                  .up = x->rows.up,
                                  .antialias = job->antialias,
                                  .sound = job->sound};
    SPIN_TRY(spin_out_open(job->output, job->force, &x->out));
    x->out.sync = job->sync;
    x->writer.out = &x->out;
    x->writer.coding = &x->coding;
    x->coder = (struct spin_4dgs_coder){.coding = &x->coding, .rows = &x->rows};
    if (!job->splats_4d)
        expect_frames(x, job);
    return SPIN_OK;
}

static spin_status add_frame(void *self, int frame, const struct spin_frame_info *info,
                             const struct spin_splats *splats)
{
    struct export *x = self;

    (void)frame;
    (void)info;
    return spin_cancelled() ? spin_fail_cancelled() : spin_4dgs_frames_add(&x->frames, splats);
}

static spin_status code_clip(struct export *x)
{
    const struct spin_export_job *job = x->windows.job;

    SPIN_TRY(spin_time_windows_convert(&x->windows));
    SPIN_TRY(spin_splat_rows_choose(&x->rows, &x->windows.view));
    SPIN_TRY(spin_sort_rows_fill(&x->order, &x->rows));
    if (x->order.n == 0)
        return spin_unsupported("no splats are left to write: relax the options that "
                                "drop splats");
    SPIN_TRY(spin_splat_rows_report_4d(&x->rows, job, x->windows.from, job->times, job->n_frames));
    x->coding.n = x->order.n;
    SPIN_TRY(choose_windows(x));
    SPIN_TRY(choose_steps(x));
    return code_rows(x);
}

static spin_status check_file(const struct export *x)
{
    double half = x->slack * 1.01;
    const struct spin_time_windows_check of = {.windows = &x->windows,
                                               .rows = &x->rows,
                                               .order = x->order.item,
                                               .n = x->order.n,
                                               .importer = "4dgs",
                                               .half = {half, half, half}};

    return spin_time_windows_check(&of);
}

static spin_status commit(struct export *x)
{
    if (x->windows.job->report)
        x->windows.job->report->bytes += x->out.bytes;
    return spin_out_commit(&x->out);
}

static spin_status write_frames(struct export *x)
{
    SPIN_TRY(spin_4dgs_frames_end(&x->frames));
    SPIN_TRY(commit(x));
    spin_4dgs_coder_report(&x->frames.coder);
    return x->windows.job->check ? spin_4dgs_frames_check(&x->frames) : SPIN_OK;
}

static spin_status write_file(struct export *x)
{
    if (!x->windows.job->splats_4d)
        return write_frames(x);
    SPIN_TRY(code_clip(x));
    SPIN_TRY(spin_4dgs_write_begin(&x->writer));
    SPIN_TRY(write_chunks(x));
    SPIN_TRY(spin_4dgs_write_end(&x->writer));
    SPIN_TRY(commit(x));
    spin_time_windows_warn(&x->windows);
    spin_4dgs_coder_report(&x->coder);
    return x->windows.job->check ? check_file(x) : SPIN_OK;
}

static const struct spin_plugin_option options[] = {
    SPIN_ROWS_OPTIONS,
    {"fps", "F", "frames per second of the clip; default: the bundle's", NULL},
    SPIN_ROWS_OPTION_SH,
    {0}};

SPIN_OWN_EXPORTER(4dgs, "4dgs", prepare, write_file, free_export,
                  .summary = "4D splats, or frames, as one .4dgs, which players load in parts",
                  .options = options, .checks = true, .splats_4d = true, .sound = "wav opus",
                  .frame = add_frame);
