/* Writes TSOG and .sogst: a clip of 4D splats as one file (formats/tsog.h, formats/sogst.h).
 *
 * Both formats quantise the centre of a splat's time window. Each splat is therefore moved along
 * its path to the quantised time; the remaining error is that the splat fades slightly too early or
 * too late. For the other values, ranges and evenly spaced codebooks limit the error to half a
 * step. Sigmas are limited to MOST_SIGMA: all sigmas are quantised in a common range, so a very
 * large sigma would make the steps too coarse for small ones. A splat whose sigma is limited is
 * moved in time towards the middle of the clip, such that its opacity at the middle keeps its value
 * and its derivative.
 *
 * TSOG can also contain a clip that consists of frames: each splat then has the index of the only
 * frame in which it is visible. The file sorts the splats of all frames in one list, so the frames
 * are read twice: for the ranges, then for the codes, which wait in a temporary file for the order
 * of the list. */
#include "base/base.h"
#include "exporters/lib/splat_rows.h"
#include "exporters/lib/pictures.h"
#include "exporters/lib/quant_error.h"
#include "exporters/lib/time_windows.h"
#include "formats/tsog.h"
#include "io/webp.h"
#include "math/activate.h"
#include "math/sh.h"

#define MOST_SIGMA 8 /* largest sigma, as a multiple of the clip's duration */
/* .sogst: a splat is drawn at times that differ from the centre of its time window by at most this
 * multiple of sigma. */
#define K_SIGMA 3.8
/* .sogst: the names of segments have three digits. */
#define MAX_SEGMENTS 999
/* .sogst: a splat that is drawn for longer than this many segments is persistent. */
#define PERSISTENT 3.0
#define PLAYED 1000000 /* largest number of splats that the player of TSOG draws */
/* Number of values of a 16-bit code. A clip of frames needs at least one value per frame, so this
 * is also the largest number of frames. */
#define STEPS 65536
enum { PER_GROUP = SPIN_4D_CENTROIDS };
/* Clips of frames: images are encoded in parallel as long as their encoders, with this number of
 * bytes for each pixel, need less memory than ENCODERS. */
enum { ENCODER = 40, ENCODERS = 1 << 30 };

struct container {
    const char *name;     /* name of the format in messages */
    const char *importer; /* the importer that reads the format */
    bool sogst; /* true: .sogst, with times in seconds, codebooks for times, and segments */
    int degree; /* highest degree of paths */
};

static const struct container tsog = {"TSOG", "tsog", false, 1},
                              sogst = {".sogst", "sogst", true, 2};

struct export
{
    const struct spin_export_job *job;
    const struct container *kind;
    /* Used if `frames` is true: a copy of the job in which splats_4d contains the rows of all
     * frames, and the time of a frame is its index. */
    struct spin_export_job own;
    bool frames; /* true: the clip consists of frames, not of 4D splats */
    struct spin_splat_rows rows;
    struct spin_sort_rows order; /* row j of the file is row item[j].row of windows.clip */
    struct spin_time_windows windows;
    double fps;
    double segment; /* duration of a segment in seconds; 0: the clip is not segmented */
    int level;
    struct spin_sog_4d coding;
    struct spin_sog_range scale, dc; /* [0] ranges of all log scales and of all SH of degree 0 */
    bool ranged;                     /* true: the ranges contain a row */
    struct spin_quant_error quant;
    /* Largest error of an opacity from quantising the centres and sigmas of time windows. */
    double fade_lost;
    struct spin_out out;
    struct spin_sound sound; /* sound.data is NULL if there is none */
    unsigned char *samples;  /* memory of `sound`, or NULL */

    /* In the following arrays, rows are in the order of the file. */
    /* SH coefficients above degree 0: of the rows, [n][n_rest]; of the palette,
     * [n_palette][n_rest]. */
    float *rest, *palette;
    uint32_t *label; /* [n] palette index of each row */
    /* 1 if the clip has no segments, else 1 + the number of segments: group 0 contains the
     * persistent splats, group g the splats of segment g - 1. */
    size_t n_groups;
    size_t *end;  /* [n_groups] index of the group's last row, plus 1 */
    double *span; /* [n_groups][2] first and last time at which the group is drawn */
    /* [n_groups][PER_GROUP] images of the groups, then the image of the palette, then [n_groups]
     * images of labels. */
    struct spin_picture *picture;
    struct spin_quant_error *block_quant;
    size_t n_blocks; /* blocks that block_quant can hold */

    /* The following members are used only if `frames` is true. Rows are numbered in the order of
     * the frames. windows.clip contains the rows of one frame. */
    double *places;            /* [n_frames] times of `own`: 0, 1, 2, ... */
    size_t *first;             /* [n_frames] number of the first row of each frame */
    size_t capacity;           /* rows that windows.clip can hold */
    float box[6];              /* bounding box of all positions, without a rotation of the scene */
    char *folder;              /* folder of temporary files; NULL: they are kept in memory */
    uint8_t *plane[PER_GROUP]; /* [n][4] pixels of the rows, in a temporary file */
    float *row_rest;           /* [n][n_rest] SH coefficients above degree 0, in a temporary file */
    uint32_t *row; /* [n] number of the row that is row j of the file, in a temporary file */
};

static const struct spin_splats_4d *clip_of(const struct export *x) { return &x->windows.clip; }

/* Warns if there are more splats than the player of the format draws. */
static void warn_of_kind(const struct export *x)
{
    if (!x->kind->sogst && x->coding.n > PLAYED)
        spin_warn(
            "the player of TSOG draws only %d of the %zu splats: drop some with --min-opacity",
            PLAYED, x->coding.n);
}

/* ---- Times ----------------------------------------------------------------------------------- */

/* Rounds to nine significant digits, the precision of meta.json. */
static double nine_digits(double v)
{
    char text[40];

    snprintf(text, sizeof text, "%.9g", v);
    return strtod(text, NULL);
}

static void widen_range(struct spin_sog_range *range, size_t c, double v, bool first)
{
    range->mins[c] = first ? v : fmin(range->mins[c], v);
    range->maxs[c] = first ? v : fmax(range->maxs[c], v);
}

static void finish_range(struct spin_sog_range *range)
{
    for (int c = 0; c < 3; c++) {
        range->mins[c] = nine_digits(range->mins[c]);
        range->maxs[c] = nine_digits(range->maxs[c]);
    }
}

/* Fills a codebook with 256 values from `least` to `most`: evenly spaced or, if `quotients` is
 * true, in a geometric series. */
static void fill_book(struct spin_sog_book *book, double least, double most, bool quotients)
{
    book->n = SPIN_CODEBOOK;
    for (int k = 0; k < SPIN_CODEBOOK; k++) {
        double share = (double)k / (SPIN_CODEBOOK - 1);

        book->value[k] = (float)nine_digits(quotients ? least * pow(most / least, share)
                                                      : least + (most - least) * share);
    }
}

/* Quantises a splat's time window: its centre, time[0], and its sigma, time[1]. shown: receives the
 * two values as readers decode them. */
static void code_time(const struct spin_sog_4d *coding, const float time[2], uint8_t *low,
                      uint8_t *high, float shown[2])
{
    if (coding->n_frames > 0) {
        int step = STEPS / coding->n_frames, q = (int)time[0] * step + step / 2;

        *low = (uint8_t)q;
        *high = (uint8_t)(q >> 8);
        memcpy(shown, time, 2 * sizeof *shown);
        return;
    }
    if (coding->centre.n == 0) {
        spin_sog_code(&coding->time, true, 2, time, low, high, shown);
        return;
    }
    low[0] = spin_codebook_nearest(coding->centre.value, time[0]);
    low[1] = spin_codebook_nearest(coding->sigma.value, time[1]);
    shown[0] = coding->centre.value[low[0]];
    shown[1] = coding->sigma.value[low[1]];
}

/* Returns the largest error of the centre of a time window, as a multiple of the window's sigma, if
 * centres are quantised with this codebook. */
static double worst_shift(const struct export *x, const float book[SPIN_CODEBOOK])
{
    double worst = 0;

    for (size_t j = 0; j < x->order.n; j++) {
        size_t k = x->order.item[j].row;
        float time = clip_of(x)->times[k], seen = book[spin_codebook_nearest(book, time)];

        worst = fmax(worst, fabs((double)time - (double)seen) / (double)clip_of(x)->sigmas[k]);
    }
    return worst;
}

/* Chooses the codebook of the centres of time windows: evenly spaced values or, if its
 * worst_shift() is smaller, a codebook that is adapted to the splats. */
static spin_status choose_centres(struct export *x)
{
    struct spin_sog_book *book = &x->coding.centre;
    float own[SPIN_CODEBOOK];
    SPIN_FREED float *times = NULL;

    fill_book(book, x->coding.time.mins[0], x->coding.time.maxs[0], false);
    SPIN_TRY(spin_alloc(x->order.n, sizeof *times, (void **)&times));
    for (size_t j = 0; j < x->order.n; j++)
        times[j] = clip_of(x)->times[x->order.item[j].row];
    SPIN_TRY(spin_codebook_make(times, x->order.n, own));
    if (worst_shift(x, own) < worst_shift(x, book->value))
        memcpy(book->value, own, sizeof own);
    return SPIN_OK;
}

/* Returns the largest error of a splat's opacity at three times: the centre of its time window, and
 * one sigma before and after the centre. time: exact centre and sigma; shown: decoded centre and
 * sigma. */
static double fade_lost(float logit, const float time[2], const float shown[2])
{
    double most = 0;

    for (int step = -1; step <= 1; step++) {
        double seen =
            ((double)time[0] + step * (double)time[1] - (double)shown[0]) / (double)shown[1];

        most = fmax(most, fabs(exp(-0.5 * step * step) - exp(-0.5 * seen * seen)));
    }
    return spin_sigmoid_of((double)logit) * most;
}

/* Quantises the centres and sigmas of time windows, and moves each splat along its path to the
 * quantised centre. */
static spin_status round_times(struct export *x)
{
    struct spin_splats_4d *s = &x->windows.clip;
    struct spin_sog_range *range = &x->coding.time;

    for (size_t j = 0; j < x->order.n; j++) {
        size_t k = x->order.item[j].row;

        widen_range(range, 0, (double)s->times[k], j == 0);
        widen_range(range, 1, (double)s->sigmas[k], j == 0);
    }
    finish_range(range);
    if (x->kind->sogst) {
        SPIN_TRY(choose_centres(x));
        fill_book(&x->coding.sigma, range->mins[1], range->maxs[1], true);
    }
    for (size_t j = 0; j < x->order.n; j++) {
        size_t k = x->order.item[j].row;
        float shown[2];
        uint8_t low[2], high[2];

        code_time(&x->coding, (const float[2]){s->times[k], s->sigmas[k]}, low, high, shown);
        x->fade_lost =
            fmax(x->fade_lost, fade_lost(s->logit_opacities[k],
                                         (const float[2]){s->times[k], s->sigmas[k]}, shown));
        spin_time_windows_move(s, k, (double)shown[0]);
        s->sigmas[k] = shown[1];
    }
    return SPIN_OK;
}

/* ---- Groups ---------------------------------------------------------------------------------- */

/* Returns the group of a row: 0 if the splat is persistent, else 1 + the index of its segment. */
static size_t group_of(const struct export *x, size_t k)
{
    double bucket = floor((double)clip_of(x)->times[k] / x->segment);

    if (2 * K_SIGMA * (double)clip_of(x)->sigmas[k] > PERSISTENT * x->segment)
        return 0;
    return 1 + (size_t)fmin(fmax(bucket, 0), (double)x->n_groups - 2);
}

/* Sorts the rows by group and, within a group, in Morton order. Sets the end and the span of each
 * group. */
static spin_status choose_order(struct export *x)
{
    size_t n = x->order.n;

    spin_sort_rows_by_place(&x->order, &x->windows.view);
    x->n_groups = 1;
    if (x->kind->sogst && x->segment > 0 && x->windows.length > x->segment)
        x->n_groups = 1 + (size_t)ceil(x->windows.length / x->segment - 1e-6);
    SPIN_TRY(spin_alloc(x->n_groups, sizeof *x->end, (void **)&x->end));
    SPIN_TRY(spin_alloc(x->n_groups, 2 * sizeof *x->span, (void **)&x->span));
    x->end[0] = n;
    if (x->n_groups == 1)
        return SPIN_OK;
    for (size_t g = 0; g < x->n_groups; g++) {
        x->end[g] = 0;
        x->span[2 * g] = ((double)g - 1) * x->segment;
        x->span[2 * g + 1] = (double)g * x->segment;
    }
    for (size_t j = 0; j < n; j++) {
        size_t k = x->order.item[j].row, g = group_of(x, k);
        double t = (double)clip_of(x)->times[k], reach = K_SIGMA * (double)clip_of(x)->sigmas[k];
        bool first = x->end[g]++ == 0;

        x->span[2 * g] = first ? t - reach : fmin(x->span[2 * g], t - reach);
        x->span[2 * g + 1] = first ? t + reach : fmax(x->span[2 * g + 1], t + reach);
        x->order.item[j].key = g;
    }
    spin_sort_rows_sort(&x->order);
    for (size_t g = 1; g < x->n_groups; g++)
        x->end[g] += x->end[g - 1];
    return SPIN_OK;
}

/* ---- Ranges, codebooks and palette ----------------------------------------------------------- */

static void turned_path(const struct export *x, size_t k, int power, float out[3])
{
    spin_splat_rows_direction(
        &x->rows, clip_of(x)->paths + 3 * (size_t)clip_of(x)->degree * k + 3 * power, out);
}

/* Widens the ranges by row k of windows.clip. */
static void widen_ranges(struct export *x, size_t k)
{
    struct spin_sog_4d *to = &x->coding;
    float v[3], room[3 * SPIN_SH_MAX];
    const float *sh = spin_splat_rows_sh(&x->rows, k, room);
    bool first = !x->ranged;

    x->ranged = true;
    for (size_t c = 0; c < 3; c++) {
        widen_range(&x->scale, 0, (double)clip_of(x)->log_scales[3 * k + c], first && c == 0);
        widen_range(&x->dc, 0, (double)sh[c], first && c == 0);
    }
    spin_splat_rows_place(&x->rows, k, v);
    for (size_t c = 0; c < 3; c++)
        widen_range(&to->means, c, spin_sog_log((double)v[c]), first);
    for (int p = 0; p < to->degree; p++) {
        turned_path(x, k, p, v);
        for (size_t c = 0; c < 3; c++)
            widen_range(p == 0 ? &to->motion : &to->accel, c,
                        to->linear ? (double)v[c] : spin_sog_log((double)v[c]), first);
    }
}

static void finish_ranges(struct export *x)
{
    struct spin_sog_4d *to = &x->coding;

    finish_range(&to->means);
    finish_range(&to->motion);
    finish_range(&to->accel);
    fill_book(&to->scales, x->scale.mins[0], x->scale.maxs[0], false);
    fill_book(&to->sh0, x->dc.mins[0], x->dc.maxs[0], false);
}

static size_t n_rest(const struct export *x) { return spin_n_rest(x->coding.sh_degree); }

/* Sets `to`, [n_rest], to the SH coefficients above degree 0 of row k of windows.clip. Coefficients
 * that the source lacks are not changed. */
static void copy_rest(const struct export *x, size_t k, float *to)
{
    size_t n_sh = 3 * (size_t)spin_splat_rows_n_sh(&x->rows);
    float room[3 * SPIN_SH_MAX];

    memcpy(to, spin_splat_rows_sh(&x->rows, k, room) + 3, (n_sh - 3) * sizeof *to);
}

/* Computes the palette and the codebook of `rest`. */
static spin_status choose_palette(struct export *x)
{
    size_t n = x->coding.n, width = n_rest(x);

    SPIN_TRY(spin_alloc(n, sizeof *x->label, (void **)&x->label));
    SPIN_TRY(spin_alloc(spin_sog_palette(n), width * sizeof *x->palette, (void **)&x->palette));
    SPIN_TRY(spin_palette_make(x->rest, n, width, spin_sog_palette(n), x->rows.pool, x->label,
                               x->palette, &x->coding.n_palette));
    x->coding.sh_n.n = SPIN_CODEBOOK;
    return spin_codebook_make(x->palette, x->coding.n_palette * width, x->coding.sh_n.value);
}

static void begin_coding(struct export *x)
{
    x->coding.degree = clip_of(x)->degree;
    x->coding.linear = !x->kind->sogst;
    x->coding.sh_degree = x->rows.sh_degree;
}

static spin_status choose_coding(struct export *x)
{
    begin_coding(x);
    SPIN_TRY(spin_sort_rows_fill(&x->order, &x->rows));
    x->coding.n = x->order.n;
    SPIN_TRY(round_times(x));
    SPIN_TRY(choose_order(x));
    for (size_t j = 0; j < x->order.n; j++)
        widen_ranges(x, x->order.item[j].row);
    finish_ranges(x);
    if (n_rest(x) == 0)
        return SPIN_OK;
    SPIN_TRY(spin_alloc(x->order.n, n_rest(x) * sizeof *x->rest, (void **)&x->rest));
    for (size_t j = 0; j < x->order.n; j++)
        copy_rest(x, x->order.item[j].row, x->rest + n_rest(x) * j);
    return choose_palette(x);
}

/* ---- Images ---------------------------------------------------------------------------------- */

static const char *const names[SPIN_4D_PICTURES] = {
    "means_l.webp",    "means_u.webp",       "scales.webp",    "quats.webp",    "sh0.webp",
    "timeline_l.webp", "timeline_u.webp",    "motion_l.webp",  "motion_u.webp", "accel_l.webp",
    "accel_u.webp",    "shN_centroids.webp", "shN_labels.webp"};

static const char *name_of(const struct export *x, int p)
{
    return x->kind->sogst && p == SPIN_4D_TIME ? "trbf.webp" : names[p];
}

static bool is_used(const struct export *x, int p)
{
    switch (p) {
    case SPIN_4D_TIME_HIGH:
        return !x->kind->sogst;
    case SPIN_4D_MOTION:
    case SPIN_4D_MOTION_HIGH:
        return x->coding.degree > 0;
    case SPIN_4D_ACCEL:
    case SPIN_4D_ACCEL_HIGH:
        return x->coding.degree > 1;
    case SPIN_4D_CENTROIDS:
    case SPIN_4D_LABELS:
        return x->coding.sh_degree > 0;
    default:
        return true;
    }
}

static size_t first_of(const struct export *x, size_t g) { return g > 0 ? x->end[g - 1] : 0; }

static int n_pictures(const struct export *x)
{
    return (int)(x->n_groups * PER_GROUP + 1 + x->n_groups);
}

/* Returns image p of group g. All groups share the image of the palette. */
static struct spin_picture *picture_of(const struct export *x, size_t g, int p)
{
    size_t at = g * PER_GROUP + (size_t)p;

    if (p >= SPIN_4D_CENTROIDS)
        at = x->n_groups * PER_GROUP + (p == SPIN_4D_LABELS ? 1 + g : 0);
    return &x->picture[at];
}

/* Makes image p of group g black, if the file contains it. */
static spin_status blank_picture(struct export *x, size_t g, int p)
{
    struct spin_picture *to = picture_of(x, g, p);
    struct spin_sog like = {.n = x->end[g] - first_of(x, g),
                            .sh_degree = x->coding.sh_degree,
                            .n_palette = x->coding.n_palette};
    bool palette = p == SPIN_4D_CENTROIDS;
    int width, height;

    if (!is_used(x, p) || (palette ? g > 0 : like.n == 0))
        return SPIN_OK;
    spin_sog_size(&like, palette ? SPIN_SOG_CENTROIDS : SPIN_SOG_MEANS_LOW, &width, &height);
    if (x->n_groups == 1 || palette)
        snprintf(to->name, sizeof to->name, "%s", name_of(x, p));
    else if (g == 0)
        snprintf(to->name, sizeof to->name, "persistent/%s", name_of(x, p));
    else
        snprintf(to->name, sizeof to->name, "seg_%03zu/%s", g - 1, name_of(x, p));
    return spin_picture_blank(to, width, height);
}

static spin_status blank_pictures(struct export *x)
{
    SPIN_TRY(spin_alloc((size_t)n_pictures(x), sizeof *x->picture, (void **)&x->picture));
    for (size_t g = 0; g < x->n_groups; g++)
        for (int p = 0; p < SPIN_4D_PICTURES; p++)
            SPIN_TRY(blank_picture(x, g, p));
    return SPIN_OK;
}

/* Writes the pixels of row k of windows.clip, without SH above degree 0, to at[]. */
static void code_row(const struct export *x, size_t k, uint8_t *const at[PER_GROUP],
                     struct spin_quant_error *quant)
{
    const struct spin_sog_4d *to = &x->coding;
    struct spin_gaussian is, shown;
    float room[3 * SPIN_SH_MAX], v[3], seen[3];
    const float *sh = spin_splat_rows_sh(&x->rows, k, room);

    spin_splat_rows_get(&x->rows, k, &is);
    spin_sog_code(&to->means, false, 3, is.place, at[SPIN_4D_MEANS], at[SPIN_4D_MEANS_HIGH],
                  shown.place);
    spin_sog_code_rotation(is.rotation, at[SPIN_4D_QUATS], shown.rotation);
    code_time(to, (const float[2]){clip_of(x)->times[k], clip_of(x)->sigmas[k]}, at[SPIN_4D_TIME],
              at[SPIN_4D_TIME_HIGH], seen);
    for (int p = 0; p < to->degree; p++) {
        turned_path(x, k, p, v);
        spin_sog_code(p == 0 ? &to->motion : &to->accel, to->linear, 3, v,
                      at[SPIN_4D_MOTION + 2 * p], at[SPIN_4D_MOTION_HIGH + 2 * p], seen);
    }
    for (size_t c = 0; c < 3; c++) {
        uint8_t scale = spin_codebook_nearest(to->scales.value, is.log_scale[c]);
        uint8_t dc = spin_codebook_nearest(to->sh0.value, sh[c]);

        at[SPIN_4D_SCALES][c] = scale;
        at[SPIN_4D_SH0][c] = dc;
        shown.log_scale[c] = to->scales.value[scale];
        shown.colour[c] = 0.5f + (float)SPIN_SH_C0 * to->sh0.value[dc];
    }
    at[SPIN_4D_SH0][3] = spin_byte_of(is.opacity * 255);
    shown.opacity = (float)at[SPIN_4D_SH0][3] / 255;
    spin_quant_error_row(quant, &is, &shown);
}

/* Adds the errors of the SH above degree 0 of row j of the file. */
static void measure_rest(const struct export *x, size_t j, struct spin_quant_error *quant)
{
    const float *book = x->coding.sh_n.value;
    size_t width = n_rest(x);
    float error[3 * SPIN_SH_MAX];

    for (size_t c = 0; c < width; c++) {
        float entry = x->palette[width * x->label[j] + c];

        error[c] = x->rest[width * j + c] - book[spin_codebook_nearest(book, entry)];
    }
    if (width > 0)
        spin_quant_error_add_sh(quant, error, width);
}

static void code_label(uint32_t label, uint8_t *pixel)
{
    pixel[0] = (uint8_t)label;
    pixel[1] = (uint8_t)(label >> 8);
}

static void code_palette(struct export *x)
{
    uint8_t *palette = picture_of(x, 0, SPIN_4D_CENTROIDS)->rgba;

    for (size_t i = 0; palette && i < x->coding.n_palette * n_rest(x); i++)
        palette[i / 3 * 4 + i % 3] = spin_codebook_nearest(x->coding.sh_n.value, x->palette[i]);
}

static void code_task(void *context, int task)
{
    struct export *x = context;
    size_t j = (size_t)task * SPIN_ROWS_BLOCK, end = j + SPIN_ROWS_BLOCK, g = 0;

    for (end = end < x->order.n ? end : x->order.n; j < end; j++) {
        uint8_t *at[PER_GROUP];

        while (x->end[g] <= j)
            g++;
        for (int p = 0; p < PER_GROUP; p++) {
            uint8_t *rgba = picture_of(x, g, p)->rgba;

            at[p] = rgba ? rgba + 4 * (j - first_of(x, g)) : NULL;
        }
        code_row(x, x->order.item[j].row, at, &x->block_quant[task]);
        measure_rest(x, j, &x->block_quant[task]);
        if (x->label)
            code_label(x->label[j],
                       picture_of(x, g, SPIN_4D_LABELS)->rgba + 4 * (j - first_of(x, g)));
    }
}

/* Runs fn(x, block) for blocks of n rows on all threads, and adds the errors in block_quant. */
static spin_status run_blocks(struct export *x, size_t n, spin_task_fn fn)
{
    size_t n_blocks = (n + SPIN_ROWS_BLOCK - 1) / SPIN_ROWS_BLOCK;

    if (n_blocks == 0)
        return SPIN_OK;
    if (n_blocks > x->n_blocks)
        SPIN_TRY(spin_grow(n_blocks, sizeof *x->block_quant, (void **)&x->block_quant));
    x->n_blocks = n_blocks > x->n_blocks ? n_blocks : x->n_blocks;
    memset(x->block_quant, 0, n_blocks * sizeof *x->block_quant);
    spin_pool_run(x->rows.pool, (int)n_blocks, fn, x);
    for (size_t b = 0; b < n_blocks; b++)
        spin_quant_error_merge(&x->quant, &x->block_quant[b]);
    return SPIN_OK;
}

static spin_status code_groups(struct export *x)
{
    SPIN_TRY(blank_pictures(x));
    SPIN_TRY(run_blocks(x, x->order.n, code_task));
    code_palette(x);
    spin_pictures_pack(x->picture, n_pictures(x), x->level, x->rows.pool);
    return SPIN_OK;
}

/* ---- Clips of frames ------------------------------------------------------------------------- */

/* Reserves capacity for n rows in windows.clip. */
static spin_status make_room(struct export *x, size_t n)
{
    struct spin_splats_4d *s = &x->windows.clip;
    const struct {
        float **values;
        size_t width;
    } array[] = {{&s->centres, 3},         {&s->quats, 4},
                 {&s->log_scales, 3},      {&s->sh, 3 * (size_t)spin_sh_count(s->sh_degree)},
                 {&s->logit_opacities, 1}, {&s->times, 1},
                 {&s->sigmas, 1},          {&s->cuts, 2}};

    if (n <= x->capacity)
        return SPIN_OK;
    for (size_t k = 0; k < sizeof array / sizeof *array; k++)
        SPIN_TRY(spin_grow(n, array[k].width * sizeof(float), (void **)array[k].values));
    SPIN_TRY(spin_grow(n, 2 * sizeof *s->spans, (void **)&s->spans));
    x->capacity = n;
    return SPIN_OK;
}

static void copy_row(struct spin_splats_4d *s, size_t k, const struct spin_splats *from, size_t i,
                     int frame)
{
    size_t n_sh = 3 * (size_t)spin_sh_count(s->sh_degree);

    memcpy(s->centres + 3 * k, from->means + 3 * i, 3 * sizeof(float));
    memcpy(s->quats + 4 * k, from->quats + 4 * i, 4 * sizeof(float));
    memcpy(s->log_scales + 3 * k, from->log_scales + 3 * i, 3 * sizeof(float));
    memcpy(s->sh + n_sh * k, from->sh + n_sh * i, n_sh * sizeof(float));
    s->logit_opacities[k] = spin_finite_logit(from->logit_opacities[i]);
    s->times[k] = s->cuts[2 * k] = (float)frame;
    s->cuts[2 * k + 1] = (float)(frame + 1);
    s->sigmas[k] = SPIN_FOREVER;
}

/* Sets windows.clip and `rows` to the splats of a frame. */
static spin_status load_frame(struct export *x, int frame, const struct spin_splats *splats)
{
    struct spin_time_windows *b = &x->windows;
    size_t n_dropped;

    SPIN_TRY(make_room(x, splats->n));
    for (size_t i = 0; i < splats->n; i++)
        copy_row(&b->clip, i, splats, i, frame);
    b->clip.n = splats->n;
    SPIN_TRY(spin_splats_4d_finish(&b->clip, &n_dropped, NULL));
    b->view = spin_splats_of_4d(&b->clip);
    return spin_splat_rows_choose(&x->rows, &b->view);
}

/* The first pass: widens the ranges by the splats of a frame. */
static spin_status take_frame(void *self, int frame, const struct spin_frame_info *info,
                              const struct spin_splats *splats)
{
    struct export *x = self;

    (void)info;
    SPIN_TRY(load_frame(x, frame, splats));
    begin_coding(x);
    for (size_t k = 0; k < clip_of(x)->n; k++) {
        widen_ranges(x, k);
        spin_sort_rows_widen(x->box, clip_of(x)->centres + 3 * k);
    }
    x->first[frame] = x->coding.n;
    x->coding.n += clip_of(x)->n;
    return SPIN_OK;
}

/* Loads a frame again, and sets *first to the number of its first row. */
static spin_status load_again(void *context, int frame, size_t *first)
{
    struct export *x = context;
    int next = frame + 1;
    const struct spin_splats *splats;

    SPIN_TRY(x->job->again(x->job->context, frame, &splats));
    SPIN_TRY(load_frame(x, frame, splats));
    *first = x->first[frame];
    if ((next < x->job->n_frames ? x->first[next] : x->coding.n) - *first != clip_of(x)->n)
        return spin_fail(SPIN_E_IO,
                         "frame %d of the export has changed since it was first read: another "
                         "program writes the input; export it again",
                         frame);
    return SPIN_OK;
}

/* Allocates an array in a temporary file, or in memory if this is not possible. */
static spin_status reserve(const struct export *x, size_t n, size_t width, void **out)
{
    size_t bytes;

    if (!spin_mul_size(n, width, &bytes))
        return spin_fail(SPIN_E_MEMORY, "%zu splats are too many", n);
    if (x->folder && spin_pages_reserve_in(x->folder, bytes, out) == SPIN_OK)
        return SPIN_OK;
    return spin_pages_reserve(bytes, out);
}

static spin_status reserve_rows(struct export *x)
{
    size_t n = x->coding.n;

    if (SPIN_PAGES_IN_FILES)
        SPIN_TRY(spin_path_folder(x->job->output, &x->folder));
    SPIN_TRY(spin_sort_rows_reserve(&x->order, n));
    SPIN_TRY(reserve(x, n, sizeof *x->row, (void **)&x->row));
    for (int p = 0; p < PER_GROUP; p++)
        if (is_used(x, p))
            SPIN_TRY(reserve(x, n, 4, (void **)&x->plane[p]));
    if (n_rest(x) > 0)
        SPIN_TRY(reserve(x, n, n_rest(x) * sizeof(float), (void **)&x->row_rest));
    return SPIN_OK;
}

static void code_frame_task(void *context, int task)
{
    struct export *x = context;
    size_t k = (size_t)task * SPIN_ROWS_BLOCK, end = k + SPIN_ROWS_BLOCK;

    for (end = end < clip_of(x)->n ? end : clip_of(x)->n; k < end; k++) {
        size_t row = x->order.n + k;
        uint8_t *at[PER_GROUP];

        for (int p = 0; p < PER_GROUP; p++) {
            at[p] = x->plane[p] ? x->plane[p] + 4 * row : NULL;
            if (at[p])
                memcpy(at[p], "\0\0\0\377", 4);
        }
        code_row(x, k, at, &x->block_quant[task]);
        if (x->row_rest)
            copy_rest(x, k, x->row_rest + n_rest(x) * row);
        x->order.item[row] = (struct spin_keyed){
            .key = spin_sort_rows_place_key(x->box, clip_of(x)->centres + 3 * k),
            .row = (uint32_t)row};
    }
}

/* Sorts the rows, and frees everything else that belongs to the sort. */
static void choose_frame_order(struct export *x)
{
    spin_sort_rows_sort(&x->order);
    for (size_t j = 0; j < x->coding.n; j++)
        x->row[j] = x->order.item[j].row;
    spin_sort_rows_free(&x->order);
}

static void measure_rest_task(void *context, int task)
{
    struct export *x = context;
    size_t j = (size_t)task * SPIN_ROWS_BLOCK, end = j + SPIN_ROWS_BLOCK;

    for (end = end < x->coding.n ? end : x->coding.n; j < end; j++)
        measure_rest(x, j, &x->block_quant[task]);
}

/* Sorts the SH above degree 0, computes their palette, and frees them. */
static spin_status choose_frame_palette(struct export *x)
{
    size_t width = n_rest(x);

    if (width == 0)
        return SPIN_OK;
    SPIN_TRY(reserve(x, x->coding.n, width * sizeof *x->rest, (void **)&x->rest));
    for (size_t j = 0; j < x->coding.n; j++)
        memcpy(x->rest + width * j, x->row_rest + width * x->row[j], width * sizeof *x->rest);
    spin_pages_release(x->row_rest);
    x->row_rest = NULL;
    SPIN_TRY(choose_palette(x));
    SPIN_TRY(run_blocks(x, x->coding.n, measure_rest_task));
    spin_pages_release(x->rest);
    x->rest = NULL;
    return SPIN_OK;
}

static spin_status report_frames(const struct export *x)
{
    size_t n_empty = 0, n_frames = (size_t)x->job->n_frames;

    if (x->coding.n > UINT32_MAX)
        return spin_unsupported("%zu splats in all frames, at most %u are supported: select fewer "
                                "frames with --range",
                                x->coding.n, UINT32_MAX);
    for (size_t f = 0; f < n_frames; f++)
        n_empty += x->first[f] == (f + 1 < n_frames ? x->first[f + 1] : x->coding.n);
    if (x->job->report)
        x->job->report->splats_mean = (double)x->coding.n / (double)n_frames;
    spin_splat_rows_warn_empty(n_empty, n_frames);
    return SPIN_OK;
}

/* The second pass: computes the codes of all rows, their order and their palette. */
static spin_status code_frames(struct export *x)
{
    size_t n = x->coding.n, first;

    SPIN_TRY(report_frames(x));
    finish_ranges(x);
    SPIN_TRY(reserve_rows(x));
    for (int f = 0; f < x->job->n_frames; f++) {
        SPIN_TRY(load_again(x, f, &first));
        x->order.n = first;
        SPIN_TRY(run_blocks(x, clip_of(x)->n, code_frame_task));
    }
    x->order.n = n;
    choose_frame_order(x);
    SPIN_TRY(choose_frame_palette(x));
    x->n_groups = 1;
    SPIN_TRY(spin_alloc(1, sizeof *x->end, (void **)&x->end));
    x->end[0] = n;
    return spin_alloc((size_t)n_pictures(x), sizeof *x->picture, (void **)&x->picture);
}

static spin_status fill_picture(struct export *x, int p)
{
    struct spin_picture *to = picture_of(x, 0, p);

    SPIN_TRY(blank_picture(x, 0, p));
    if (p == SPIN_4D_CENTROIDS)
        code_palette(x);
    if (p < PER_GROUP && x->plane[p])
        for (size_t j = 0; j < x->coding.n; j++)
            memcpy(to->rgba + 4 * j, x->plane[p] + 4 * (size_t)x->row[j], 4);
    if (p == SPIN_4D_LABELS && x->label)
        for (size_t j = 0; j < x->coding.n; j++)
            code_label(x->label[j], to->rgba + 4 * j);
    return SPIN_OK;
}

/* Encodes and writes the images of a clip of frames, of which only some are in memory at a time. */
static spin_status write_frame_pictures(struct export *x, struct spin_zip_writer *zip)
{
    int n_threads = spin_splat_rows_workers(&x->rows), step = 1;

    while (step < n_threads && (size_t)(step + 1) * x->coding.n < ENCODERS / ENCODER)
        step++;
    for (int p = 0, n; p < SPIN_4D_PICTURES; p += n) {
        struct spin_picture *picture = x->picture + p;

        n = p + step < SPIN_4D_PICTURES ? step : SPIN_4D_PICTURES - p;
        for (int q = p; q < p + n; q++)
            SPIN_TRY(fill_picture(x, q));
        spin_pictures_pack(picture, n, x->level, x->rows.pool);
        if (spin_cancelled())
            return spin_fail_cancelled();
        SPIN_TRY(spin_pictures_write(picture, n, zip));
        spin_pictures_free(picture, n, true);
        memset(picture, 0, (size_t)n * sizeof *picture);
    }
    return SPIN_OK;
}

/* ---- meta.json ------------------------------------------------------------------------------- */

static void print_book(FILE *to, const struct spin_sog_book *book)
{
    fprintf(to, "\"codebook\":[");
    for (size_t k = 0; k < book->n; k++)
        fprintf(to, "%s%.9g", k ? "," : "", (double)book->value[k]);
    fprintf(to, "]");
}

static void print_range(FILE *to, const struct spin_sog_range *range, int n, const char *open,
                        const char *close)
{
    for (int side = 0; side < 2; side++) {
        const double *v = side ? range->maxs : range->mins;

        fprintf(to, "%s%s", side ? ",\"maxs\":" : "\"mins\":", open);
        for (int c = 0; c < n; c++)
            fprintf(to, "%s%.9g", c ? "," : "", v[c]);
        fprintf(to, "%s", close);
    }
}

static void print_files(FILE *to, const struct export *x, int first, int n)
{
    fprintf(to, ",\"files\":[\"%s\"", name_of(x, first));
    if (n > 1)
        fprintf(to, ",\"%s\"", name_of(x, first + 1));
    fprintf(to, "]}");
}

/* Prints the sound. TSOG has no keys for the start and the name of a sound, so these are stored
 * under a key that only spin4d reads. */
static void print_sound(FILE *to, const struct spin_sound *s)
{
    fprintf(to, ",\"audio\":{\"file\":\"sound%s\",\"mimeType\":\"%s\",\"volume\":%.9g,",
            spin_sound_ending(s), spin_sound_mime(s), fmin(s->gain, 1));
    fprintf(to, "\"" SPIN_SOG_4D_OWN "\":{\"name\":");
    spin_text_json(to, s->name);
    if (s->start != 0)
        fprintf(to, ",\"start\":%.9g", s->start);
    fprintf(to, "}}");
}

static void print_still(FILE *to, const struct export *x)
{
    const struct spin_sog_4d *c = &x->coding;

    fprintf(to, "\"asset\":{\"generator\":\"spin4d " SPIN_VERSION "\"");
    if (x->sound.data && x->kind->sogst)
        print_sound(to, &x->sound);
    fprintf(to, "},%s\"count\":%zu,\"means\":{",
            x->job->antialias ? "\"model\":\"" SPIN_SOG_ANTIALIASED "\"," : "", c->n);
    print_range(to, &c->means, 3, "[", "]");
    print_files(to, x, SPIN_4D_MEANS, 2);
    fprintf(to, ",\"scales\":{");
    print_book(to, &c->scales);
    print_files(to, x, SPIN_4D_SCALES, 1);
    fprintf(to, ",\"quats\":{\"files\":[\"%s\"]},\"sh0\":{", name_of(x, SPIN_4D_QUATS));
    print_book(to, &c->sh0);
    print_files(to, x, SPIN_4D_SH0, 1);
    if (c->sh_degree == 0)
        return;
    fprintf(to, ",\"shN\":{\"count\":%zu,\"bands\":%d,", c->n_palette, c->sh_degree);
    print_book(to, &c->sh_n);
    print_files(to, x, SPIN_4D_CENTROIDS, 2);
}

static void print_tsog(FILE *to, const struct export *x)
{
    fprintf(to, "{\"version\":4,\"profile\":{\"id\":\"org.opsiclear.tsog-playback\","
                "\"version\":1},");
    print_still(to, x);
    if (x->frames) {
        fprintf(to, ",\"timeline\":{\"type\":0,\"N\":%d,\"delta\":%d", x->job->n_frames,
                STEPS / x->job->n_frames);
    } else {
        fprintf(to, ",\"timeline\":{\"type\":1,");
        print_range(to, &x->coding.time, 2, "[", "]");
    }
    print_files(to, x, SPIN_4D_TIME, 2);
    if (x->coding.degree > 0) {
        fprintf(to, ",\"temporal\":{\"means\":{");
        print_range(to, &x->coding.motion, 3, "[[", "]]");
        print_files(to, x, SPIN_4D_MOTION, 2);
        fprintf(to, "}");
    }
    if (x->sound.data)
        print_sound(to, &x->sound);
    fprintf(to, ",\"playback\":{\"duration\":%.9g,\"fps\":%.9g,\"rate\":1,\"loop\":true}}\n",
            /* In a clip of frames, the last frame is shown as long as all others. */
            (x->job->n_frames - !x->frames) / x->fps, x->fps);
}

static void print_stream(FILE *to, const struct export *x, size_t g)
{
    if (x->end[g] == first_of(x, g))
        fprintf(to, "null");
    else if (g == 0)
        fprintf(to, "\"persistent\"");
    else
        fprintf(to, "\"seg_%03zu\"", g - 1);
}

/* Prints meta.json of a .sogst. reveal: offset in the file of the end of the first segment that
 * contains splats; geometry: offset of the end of the last segment. */
static void print_sogst(FILE *to, const struct export *x, uint64_t reveal, uint64_t geometry)
{
    const double *cov2d = x->job->splats_4d->cov2d;

    fprintf(to,
            "{\"version\":1,\"format\":\"sogst\",\"time\":{\"min\":0,\"max\":%.9g,\"fps\":%.9g},",
            x->windows.length, x->fps);
    print_still(to, x);
    fprintf(to, ",\"motion\":{\"degree\":%d,", x->coding.degree);
    print_range(to, &x->coding.motion, 3, "[", "]");
    print_files(to, x, SPIN_4D_MOTION, 2);
    if (x->coding.degree > 1) {
        fprintf(to, ",\"accel\":{");
        print_range(to, &x->coding.accel, 3, "[", "]");
        print_files(to, x, SPIN_4D_ACCEL, 2);
    }
    fprintf(to, ",\"trbf\":{\"center\":{");
    print_book(to, &x->coding.centre);
    fprintf(to, "},\"sigma\":{");
    print_book(to, &x->coding.sigma);
    fprintf(to, "}");
    print_files(to, x, SPIN_4D_TIME, 1);
    if (cov2d[0] > 0)
        fprintf(to, ",\"cov2d_scale\":[%.9g,%.9g]", cov2d[0], cov2d[1]);
    if (x->n_groups > 1) {
        fprintf(to,
                ",\"segments\":{\"duration\":%.9g,\"k_sigma\":%g,\"persistent_span_mult\":%g,"
                "\"persistent\":[0,%zu],\"list\":[",
                x->segment, K_SIGMA, PERSISTENT, x->end[0]);
        for (size_t g = 1; g < x->n_groups; g++)
            fprintf(to, "%s{\"t0\":%.9g,\"t1\":%.9g,\"range\":[%zu,%zu]}", g > 1 ? "," : "",
                    x->span[2 * g], x->span[2 * g + 1], first_of(x, g), x->end[g]);
        fprintf(to, "]},\"streams\":{\"persistent\":");
        print_stream(to, x, 0);
        fprintf(to, ",\"segments\":[");
        for (size_t g = 1; g < x->n_groups; g++) {
            fprintf(to, "%s", g > 1 ? "," : "");
            print_stream(to, x, g);
        }
        fprintf(to, "],\"sh_deferred\":%s,\"reveal_bytes\":%llu,\"geometry_bytes\":%llu}",
                x->coding.sh_degree > 0 ? "true" : "false", (unsigned long long)reveal,
                (unsigned long long)geometry);
    }
    fprintf(to, "}\n");
}

static uint64_t bytes_of(const struct export *x, size_t n_groups)
{
    enum { HEADER = 30 };
    uint64_t sum = 0;

    for (size_t i = 0; i < n_groups * PER_GROUP; i++)
        if (x->picture[i].width > 0)
            sum += HEADER + strlen(x->picture[i].name) + x->picture[i].n_file;
    return sum;
}

/* Prints meta.json. The text contains byte counts that depend on its own length, so it is printed
 * again until the length no longer changes. */
static spin_status make_meta(const struct export *x, char **text, size_t *n)
{
    const uint64_t header = 30 + strlen("meta.json");
    size_t first = 1, before = 0;

    while (first + 1 < x->n_groups && x->end[first] == first_of(x, first))
        first++;
    *n = 0;
    *text = NULL;
    do {
        FILE *to;

        before = *n;
        free(*text);
        *text = NULL;
        to = spin_text_open(text, n);
        if (to && x->kind->sogst)
            print_sogst(to, x,
                        header + before +
                            bytes_of(x, first + 1 < x->n_groups ? first + 1 : x->n_groups),
                        header + before + bytes_of(x, x->n_groups));
        else if (to)
            print_tsog(to, x);
        if (!to || fclose(to) != 0)
            return spin_fail(SPIN_E_MEMORY, "not enough memory for meta.json");
    } while (*n != before);
    return SPIN_OK;
}

/* ---- One file -------------------------------------------------------------------------------- */

static spin_status write_members(struct export *x, struct spin_zip_writer *zip)
{
    SPIN_FREED char *meta = NULL;
    char name[16];
    size_t n;

    SPIN_TRY(make_meta(x, &meta, &n));
    zip->plain = true;
    SPIN_TRY(spin_zip_member_whole(zip, "meta.json", meta, n, NULL, 0));
    SPIN_TRY(x->frames ? write_frame_pictures(x, zip)
                       : spin_pictures_write(x->picture, n_pictures(x), zip));
    if (!x->sound.data)
        return SPIN_OK;
    snprintf(name, sizeof name, "sound%s", spin_sound_ending(&x->sound));
    return spin_zip_member_whole(zip, name, "", 0, x->sound.data, x->sound.size);
}

static spin_status write_file(struct export *x)
{
    struct spin_zip_writer zip;

    spin_zip_writer_begin(&x->out, &zip);
    SPIN_TRY(spin_zip_writer_end(&zip, write_members(x, &zip), &x->out));
    if (x->job->report)
        x->job->report->bytes += x->out.bytes;
    return spin_out_commit(&x->out);
}

/* ---- Check ----------------------------------------------------------------------------------- */

static spin_status check_file(struct export *x)
{
    const struct spin_sog_range *range = &x->coding.means;
    struct spin_time_windows_check of = {.windows = &x->windows,
                                         .rows = &x->rows,
                                         .order = x->order.item,
                                         .row = x->row,
                                         .n = x->coding.n,
                                         .load = x->frames ? load_again : NULL,
                                         .context = x,
                                         .importer = x->kind->importer};

    for (int c = 0; c < 3; c++)
        of.half[c] = (range->maxs[c] - range->mins[c]) / 131070 * 1.01;
    return spin_time_windows_check(&of);
}

/* ---- The plug-ins ---------------------------------------------------------------------------- */

/* Frees what only encoding and writing the file need, before the file is read back or at the end.
 */
static void free_encoded(struct export *x)
{
    if (x->picture)
        spin_pictures_free(x->picture, n_pictures(x), true);
    free(x->picture);
    if (x->frames)
        spin_pages_release(x->rest);
    else
        free(x->rest);
    free(x->palette);
    free(x->label);
    x->picture = NULL;
    x->rest = x->palette = NULL;
    x->label = NULL;
}

static void free_export(void *self)
{
    struct export *x = self;

    spin_out_abandon(&x->out);
    free_encoded(x);
    spin_splat_rows_end(&x->rows);
    spin_sort_rows_free(&x->order);
    spin_time_windows_free(&x->windows);
    free(x->end);
    free(x->span);
    free(x->block_quant);
    free(x->places);
    free(x->first);
    free(x->folder);
    for (int p = 0; p < PER_GROUP; p++)
        spin_pages_release(x->plane[p]);
    spin_pages_release(x->row_rest);
    spin_pages_release(x->row);
    free(x->samples);
    free(x);
}

/* Sets the duration of a segment of .sogst. The default is half a second or, if longer, a 999th of
 * the clip, rounded to a whole number of frames. */
static spin_status choose_segment(struct export *x)
{
    double half = fmax(floor(x->fps / 2 + 0.5), 1);

    x->segment = fmax(half, ceil(x->windows.length * x->fps / MAX_SEGMENTS - 1e-6)) / x->fps;
    SPIN_TRY(spin_option_number(x->job->values, "segment", 0, 1e6, &x->segment));
    if (x->segment > 0 && x->windows.length / x->segment > MAX_SEGMENTS + 1e-6)
        return spin_misuse("--segment %g: a clip of %g seconds would have more than %d segments; "
                           "choose longer segments",
                           x->segment, x->windows.length, MAX_SEGMENTS);
    return SPIN_OK;
}

static spin_status read_options(struct export *x)
{
    x->level = 3;
    SPIN_TRY(spin_option_count(x->job->values, "level", 0, 9, &x->level));
    SPIN_TRY(spin_time_windows_fps(&x->windows, &x->fps));
    x->windows.length = x->kind->sogst ? (x->job->n_frames - 1) / x->fps : 1;
    if (x->frames)
        x->windows.length = x->job->n_frames - 1;
    if (x->kind->sogst)
        SPIN_TRY(choose_segment(x));
    return spin_splat_rows_begin(&x->rows, x->job, NULL);
}

/* Prepares the export of a clip that consists of frames: the splats of a frame become 4D splats
 * that are visible only in this frame. The index of the frame is their time. */
static spin_status expect_frames(struct export *x)
{
    const float none[6] = SPIN_SORT_ROWS_NO_BOX;
    int n = x->job->n_frames;

    if (n > STEPS)
        return spin_unsupported(
            "%s can store at most %d frames, but the clip has %d: select fewer with --range",
            x->kind->name, STEPS, n);
    x->frames = true;
    x->own = *x->job;
    x->own.splats_4d = &x->windows.clip;
    memcpy(x->box, none, sizeof none);
    SPIN_TRY(spin_alloc((size_t)n, sizeof *x->first, (void **)&x->first));
    SPIN_TRY(spin_alloc((size_t)n, sizeof *x->places, (void **)&x->places));
    for (int f = 0; f < n; f++)
        x->places[f] = f;
    x->own.times = x->places;
    x->job = x->windows.job = &x->own;
    x->coding.n_frames = n;
    return spin_splats_4d_reserve(&x->windows.clip, 0, 0, x->job->sh_degree, SPIN_4D_CUTS);
}

static spin_status begin_export(struct export *x, const struct spin_export_job *job,
                                const struct container *kind)
{
    x->job = job;
    x->kind = kind;
    x->windows = (struct spin_time_windows){.job = job,
                                            .says_cov2d = x->kind->sogst,
                                            .name = kind->name,
                                            .most_sigma = MOST_SIGMA,
                                            .least_degree = kind->sogst ? 1 : 0,
                                            .degree = kind->degree};
    if (!x->job->splats_4d)
        SPIN_TRY(expect_frames(x));
    SPIN_TRY(spin_time_windows_can(&x->windows));
    SPIN_TRY(spin_webp_need());
    SPIN_TRY(read_options(x));
    SPIN_TRY(spin_out_open(x->job->output, x->job->force, &x->out));
    x->out.sync = x->job->sync;
    return SPIN_OK;
}

static spin_status encode_clip(struct export *x)
{
    if (!x->frames) {
        SPIN_TRY(spin_time_windows_convert(&x->windows));
        SPIN_TRY(spin_splat_rows_choose(&x->rows, &x->windows.view));
    }
    if ((x->frames ? x->coding.n : x->rows.n_kept) == 0)
        return spin_unsupported("no splats are left to write: relax the options that drop "
                                "splats");
    if (x->frames)
        return code_frames(x);
    SPIN_TRY(spin_splat_rows_report_4d(&x->rows, x->job, x->windows.from, x->job->times,
                                       x->job->n_frames));
    SPIN_TRY(choose_coding(x));
    if (spin_cancelled())
        return spin_fail_cancelled();
    SPIN_TRY(code_groups(x));
    return spin_cancelled() ? spin_fail_cancelled() : SPIN_OK;
}

static spin_status write_all(struct export *x)
{
    SPIN_TRY(encode_clip(x));
    SPIN_TRY(write_file(x));
    spin_time_windows_warn(&x->windows);
    warn_of_kind(x);
    spin_quant_error_log(&x->quant, x->kind->name);
    if (x->fade_lost > 2 / 255.0)
        spin_log(0, "%s rounds times: the opacity of fading splats is off by up to %.2g",
                 x->kind->name, x->fade_lost);
    if (!x->job->check)
        return SPIN_OK;
    free_encoded(x);
    return check_file(x);
}

/* In both formats, a sound starts with the clip. A WAV file is therefore padded with silence or cut
 * at its beginning. name: the format's name in messages. */
static spin_status choose_sound(struct export *x, const struct spin_sound *s, const char *name)
{
    if (!s)
        return SPIN_OK;
    SPIN_TRY(spin_sound_align(s, &x->sound, &x->samples));
    if (x->sound.start != 0)
        spin_warn("%s cannot store when a sound starts, so players other than spin4d start the "
                  "sound '%s' %.3g s %s: use a WAV file, whose samples spin-export shifts",
                  name, s->name, fabs(s->start), s->start < 0 ? "late" : "early");
    if (s->gain > 1)
        spin_warn(
            "%s cannot store a volume above 1: other players play the sound '%s' at 1 instead "
            "of %.3g",
            name, s->name, s->gain);
    return SPIN_OK;
}

static spin_status prepare_tsog(struct export *x, const struct spin_export_job *job)
{
    SPIN_TRY(choose_sound(x, job->sound, "TSOG"));
    return begin_export(x, job, &tsog);
}

static spin_status prepare_sogst(struct export *x, const struct spin_export_job *job)
{
    SPIN_TRY(choose_sound(x, job->sound, ".sogst"));
    if (job->sound)
        spin_warn("players do not play the sound '%s' of a .sogst: it is stored for spin-import",
                  job->sound->name);
    return begin_export(x, job, &sogst);
}

#define OPTION_FPS                                                                                 \
    {                                                                                              \
        "fps", "F", "frames per second of the clip; default: the bundle's", NULL                   \
    }
#define OPTION_LEVEL                                                                               \
    {                                                                                              \
        "level", "N", "effort of WebP, 0 (fast) to 9 (small)", "3"                                 \
    }

static const struct spin_plugin_option tsog_options[] = {
    SPIN_ROWS_OPTIONS, OPTION_FPS, SPIN_ROWS_OPTION_SH, OPTION_LEVEL, {0}};

static const struct spin_plugin_option sogst_options[] = {
    SPIN_ROWS_OPTIONS,
    OPTION_FPS,
    SPIN_ROWS_OPTION_SH,
    OPTION_LEVEL,
    {"segment", "S", "seconds that a player loads at a time; 0: all at once; default: about 0.5",
     NULL},
    {0}};

SPIN_OWN_EXPORTER(
    tsog, "tsog", prepare_tsog, write_all, free_export,
    .summary = "4D splats, or frames, as one TSOG, which plays in browsers; small files",
    .options = tsog_options, .checks = true, .splats_4d = true, .sound = "all",
    .frame = take_frame);

SPIN_OWN_EXPORTER(sogst, "sogst", prepare_sogst, write_all, free_export,
                  .summary = "4D splats as one .sogst, which players load in segments; small files",
                  .options = sogst_options, .checks = true, .splats_4d = true, .sound = "all");
