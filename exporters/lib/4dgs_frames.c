#include "exporters/lib/4dgs_frames.h"

#include "base/base.h"
#include "exporters/lib/readback.h"
#include "exporters/lib/static_rows.h"

/* ---- Quantised splats ------------------------------------------------------------------------ */

/* A value that exceeds the range of the format by less than this does not count as clamped, since
 * float rounding can be the cause. */
#define NEAR 1e-5

int32_t spin_4dgs_round(double value, double step)
{
    return (int32_t)spin_4dgs_clamp(rint(value / step), INT32_MIN, INT32_MAX);
}

/* Quantises a rotation. The largest component of the quaternion x y z w is made positive and
 * omitted. */
static void code_rotation(const float wxyz[4], double step, struct spin_4dgs_splat *to)
{
    const float q[4] = {wxyz[1], wxyz[2], wxyz[3], wxyz[0]};
    int32_t *bin = spin_4dgs_bin(to, SPIN_4DGS_ROTATION);
    int largest = 0;

    for (int k = 1; k < 4; k++)
        largest = fabsf(q[k]) > fabsf(q[largest]) ? k : largest;
    spin_4dgs_bin(to, SPIN_4DGS_LARGEST)[0] = largest;
    for (int k = 0; k < 4; k++)
        if (k != largest)
            *bin++ = spin_4dgs_round(q[largest] < 0 ? -(double)q[k] : (double)q[k], step);
}

static void code_colour(struct spin_4dgs_coder *coder, const float colour[3],
                        struct spin_4dgs_splat *to)
{
    int32_t *bin = spin_4dgs_bin(to, SPIN_4DGS_COLOUR), rgb[3];
    bool clamped = false;

    for (int c = 0; c < 3; c++) {
        double inside = spin_4dgs_clamp((double)colour[c], 0, 1);

        coder->lost_colour = fmax(coder->lost_colour, fabs(inside - (double)colour[c]));
        clamped |= fabs(inside - (double)colour[c]) > NEAR;
        rgb[c] = spin_4dgs_round(inside, coder->coding->step[SPIN_4DGS_STEP_COLOUR]);
    }
    coder->n_colours += clamped;
    bin[0] = rgb[1];
    bin[1] = rgb[0] - rgb[1];
    bin[2] = rgb[2] - rgb[1];
}

static double decode_sh(unsigned char code) { return code * 8 / 255.0 - 4; }

static void code_sh(struct spin_4dgs_coder *coder, size_t k, struct spin_4dgs_splat *to)
{
    size_t n = (size_t)spin_splat_rows_n_sh(coder->rows);
    float rotated[3 * SPIN_SH_MAX], off[SPIN_4DGS_REST];
    const float *sh = spin_splat_rows_sh(coder->rows, k, rotated);
    bool clamped = false;

    memset(to->sh, 128, sizeof to->sh);
    for (size_t i = 3; i < 3 * n; i++) {
        double value = (double)sh[i], inside = spin_4dgs_clamp(value, -4, 4);

        coder->lost_sh = fmax(coder->lost_sh, fabs(inside - value));
        clamped |= fabs(inside - value) > NEAR;
        to->sh[i - 3] = (unsigned char)rint((inside + 4) * 255 / 8);
        off[i - 3] = (float)(decode_sh(to->sh[i - 3]) - value);
    }
    coder->n_sh += clamped;
    if (n > 1)
        spin_quant_error_add_sh(&coder->quant, off, 3 * n - 3);
}

void spin_4dgs_code_attributes(struct spin_4dgs_coder *coder, size_t row,
                               const struct spin_gaussian *is, struct spin_4dgs_splat *to,
                               struct spin_gaussian *shown)
{
    const double *step = coder->coding->step;
    const int32_t *colour = spin_4dgs_bin(to, SPIN_4DGS_COLOUR);
    int32_t *scale = spin_4dgs_bin(to, SPIN_4DGS_SCALE);
    int32_t *opacity = spin_4dgs_bin(to, SPIN_4DGS_OPACITY);

    code_rotation(is->rotation, step[SPIN_4DGS_STEP_ROTATION], to);
    code_colour(coder, is->colour, to);
    code_sh(coder, row, to);
    *opacity = spin_4dgs_round((double)is->opacity, step[SPIN_4DGS_STEP_OPACITY]);
    shown->opacity = (float)(*opacity * step[SPIN_4DGS_STEP_OPACITY]);
    spin_4dgs_rotation(spin_4dgs_bin(to, SPIN_4DGS_ROTATION), *spin_4dgs_bin(to, SPIN_4DGS_LARGEST),
                       step[SPIN_4DGS_STEP_ROTATION], shown->rotation);
    for (int c = 0; c < 3; c++) {
        scale[c] = spin_4dgs_round((double)is->log_scale[c], step[SPIN_4DGS_STEP_SCALE]);
        shown->log_scale[c] = (float)(scale[c] * step[SPIN_4DGS_STEP_SCALE]);
        shown->colour[c] = (float)((colour[0] + (c == 1 ? 0 : colour[c == 0 ? 1 : 2])) *
                                   step[SPIN_4DGS_STEP_COLOUR]);
    }
}

void spin_4dgs_coder_report(const struct spin_4dgs_coder *c)
{
    if (c->n_colours > 0)
        spin_warn("a .4dgs stores colours of 0 to 1: those of %llu splats are clamped, by up to "
                  "%.2g",
                  (unsigned long long)c->n_colours, c->lost_colour);
    if (c->n_sh > 0)
        spin_warn("a .4dgs stores SH coefficients of -4 to 4: those of %llu splats are clamped, by "
                  "up to %.2g",
                  (unsigned long long)c->n_sh, c->lost_sh);
    spin_quant_error_log(&c->quant, "a .4dgs");
}

/* ---- Frames ---------------------------------------------------------------------------------- */

/* Largest distance of a position from the origin, in quantisation steps. The difference of two
 * positions then fits into 32 bits. */
#define MOST_STEPS (1 << 30)

enum { HASHED = SPIN_4DGS_BINS + (SPIN_4DGS_REST + 3) / 4 };

static double time_of(const struct spin_4dgs_frames *x, int frame)
{
    return frame / x->coding->fps;
}

/* ---- The beginning --------------------------------------------------------------------------- */

static int compare_floats(const void *a, const void *b)
{
    const float *x = a, *y = b;

    return (*x > *y) - (*x < *y);
}

static void widen_box(double box[6], const float place[3], bool first)
{
    for (int c = 0; c < 3; c++) {
        box[c] = first ? (double)place[c] : fmin(box[c], (double)place[c]);
        box[3 + c] = first ? (double)place[c] : fmax(box[3 + c], (double)place[c]);
    }
}

/* Chooses the quantisation steps from the first frame that has splats. */
static spin_status choose_steps(struct spin_4dgs_frames *x)
{
    SPIN_FREED float *scale = NULL;
    size_t n = x->order.n;

    SPIN_TRY(spin_alloc(n, 3 * sizeof *scale, (void **)&scale));
    for (size_t j = 0; j < n; j++) {
        size_t row = x->order.item[j].row;
        float place[3];

        spin_splat_rows_place(x->rows, row, place);
        widen_box(x->coding->box, place, j == 0);
        memcpy(scale + 3 * j, x->rows->splats->log_scales + 3 * row, 3 * sizeof *scale);
    }
    qsort(scale, 3 * n, sizeof *scale, compare_floats);
    spin_4dgs_choose_steps(x->coding, exp((double)scale[3 * n / 2]));
    return SPIN_OK;
}

/* Writes the beginning of the file: one window that covers the whole clip, and empty chunks for the
 * frames before the first splat. */
static spin_status begin_file(struct spin_4dgs_frames *x)
{
    struct spin_4dgs_coding *c = x->coding;

    x->coder = (struct spin_4dgs_coder){.coding = c, .rows = x->rows};
    SPIN_TRY(choose_steps(x));
    SPIN_TRY(spin_alloc(1, sizeof *c->window, (void **)&c->window));
    c->window[0][1] = c->duration;
    c->n_windows = 1;
    SPIN_TRY(spin_4dgs_write_begin(x->writer));
    x->begun = true;
    for (int f = 0; f < x->n_frames; f++) {
        const double interval[2] = {time_of(x, f), time_of(x, f + 1)};

        SPIN_TRY(spin_4dgs_write_chunk(x->writer, interval, NULL, 0));
    }
    return SPIN_OK;
}

/* ---- The rows of a frame --------------------------------------------------------------------- */

static spin_status code_row(struct spin_4dgs_frames *x, size_t row, struct spin_4dgs_splat *to)
{
    int32_t *bin = spin_4dgs_bin(to, SPIN_4DGS_POSITION);
    double step = x->coding->step[SPIN_4DGS_STEP_POSITION];
    struct spin_gaussian is, shown;

    *to = (struct spin_4dgs_splat){0};
    spin_splat_rows_get(x->rows, row, &is);
    shown = is;
    widen_box(x->coding->box, is.place, false);
    for (int c = 0; c < 3; c++) {
        bin[c] = spin_4dgs_round((double)is.place[c] - x->coding->origin[c], step);
        if (abs(bin[c] / 2) > MOST_STEPS / 2)
            return spin_unsupported("frame %d: a coordinate of a splat is %g, farther from the "
                                    "splats of the first frame "
                                    "than a .4dgs can store: drop the splat with --crop",
                                    x->job->numbers ? x->job->numbers[x->n_frames] : x->n_frames,
                                    (double)is.place[c]);
        shown.place[c] = (float)(x->coding->origin[c] + bin[c] * step);
    }
    *spin_4dgs_bin(to, SPIN_4DGS_FLAGS) = SPIN_4DGS_NEVER_FADES;
    spin_4dgs_code_attributes(&x->coder, row, &is, to, &shown);
    spin_quant_error_row(&x->coder.quant, &is, &shown);
    return SPIN_OK;
}

static spin_status code_rows(struct spin_4dgs_frames *x)
{
    size_t n = x->rows->splats->n;

    SPIN_TRY(spin_grow(n + 1, sizeof *x->coded, (void **)&x->coded));
    SPIN_TRY(spin_grow(n + 1, 1, (void **)&x->taken));
    for (size_t j = 0; j < x->order.n; j++) {
        size_t row = x->order.item[j].row;

        SPIN_TRY(code_row(x, row, &x->coded[row]));
    }
    return SPIN_OK;
}

/* ---- Splats that continue -------------------------------------------------------------------- */

/* Returns whether, for every i, row i has been the same splat in all frames so far. */
static bool has_rows(const struct spin_4dgs_frames *x)
{
    return x->job->identity && !(x->job->report && x->job->report->rows_differ);
}

/* Matches splats with the same row number. For a delta, their SH must be equal too, since only a
 * keyframe can change SH. */
static void match_rows(struct spin_4dgs_frames *x, bool key)
{
    for (size_t j = 0; j < x->shown.n; j++) {
        size_t row = x->shown.row[j];
        const struct spin_4dgs_splat *was = &x->shown.splat[j];

        if (row < x->rows->splats->n && x->rows->keep[row] &&
            (key || memcmp(was->sh, x->coded[row].sh, sizeof was->sh) == 0))
            x->mate[j] = (uint32_t)row;
    }
}

/* Hashes all values of a splat except the centre of its time window, which each keyframe sets anew.
 */
static struct spin_static_row hash_row(const struct spin_4dgs_splat *splat, uint32_t row)
{
    struct spin_static_row out = {{0, 0}, row};
    struct spin_4dgs_splat copy = *splat;
    uint32_t word[HASHED] = {0};

    *spin_4dgs_bin(&copy, SPIN_4DGS_MU) = 0;
    memcpy(word, copy.bin, sizeof copy.bin);
    memcpy(word + SPIN_4DGS_BINS, copy.sh, sizeof copy.sh);
    spin_static_hash(out.hash, word, HASHED);
    return out;
}

static int by_hash(const void *a, const void *b)
{
    const struct spin_static_row *x = a, *y = b;
    int first = (x->hash[0] > y->hash[0]) - (x->hash[0] < y->hash[0]);
    int second = (x->hash[1] > y->hash[1]) - (x->hash[1] < y->hash[1]);

    return first ? first : second ? second : (x->row > y->row) - (x->row < y->row);
}

/* Compares two entries by their hashes, but not by their rows. */
static int compare_hashes(const struct spin_static_row *a, const struct spin_static_row *b)
{
    struct spin_static_row same = *a;

    same.row = b->row;
    return by_hash(&same, b);
}

static spin_status match_values(struct spin_4dgs_frames *x)
{
    size_t n_was = x->shown.n, n_is = x->order.n, i = 0, j = 0;
    SPIN_FREED struct spin_static_row *was = NULL, *is = NULL;

    SPIN_TRY(spin_alloc(n_was + 1, sizeof *was, (void **)&was));
    SPIN_TRY(spin_alloc(n_is + 1, sizeof *is, (void **)&is));
    for (size_t k = 0; k < n_was; k++)
        was[k] = hash_row(&x->shown.splat[k], (uint32_t)k);
    for (size_t k = 0; k < n_is; k++)
        is[k] = hash_row(&x->coded[x->order.item[k].row], x->order.item[k].row);
    qsort(was, n_was, sizeof *was, by_hash);
    qsort(is, n_is, sizeof *is, by_hash);
    while (i < n_was && j < n_is) {
        int order = compare_hashes(&was[i], &is[j]);

        if (order == 0)
            x->mate[was[i].row] = is[j].row;
        i += order <= 0;
        j += order >= 0;
    }
    return SPIN_OK;
}

/* Finds, for each splat of the previous state, the row of the new frame that continues it. *n
 * receives the number of rows found. */
static spin_status match(struct spin_4dgs_frames *x, bool key, size_t *n)
{
    SPIN_TRY(spin_grow(x->shown.n + 1, sizeof *x->mate, (void **)&x->mate));
    for (size_t j = 0; j < x->shown.n; j++)
        x->mate[j] = UINT32_MAX;
    if (has_rows(x))
        match_rows(x, key);
    else
        SPIN_TRY(match_values(x));
    memset(x->taken, 0, x->rows->splats->n);
    *n = 0;
    for (size_t j = 0; j < x->shown.n; j++)
        if (x->mate[j] != UINT32_MAX) {
            x->taken[x->mate[j]] = 1;
            ++*n;
        }
    return SPIN_OK;
}

/* ---- A state --------------------------------------------------------------------------------- */

static void append(struct spin_4dgs_frames *x, size_t row, uint32_t id, int32_t mu)
{
    struct spin_4dgs_splat *to = &x->next.splat[x->next.n];

    *to = x->coded[row];
    to->id = id;
    *spin_4dgs_bin(to, SPIN_4DGS_MU) = mu;
    x->next.row[x->next.n++] = (uint32_t)row;
}

/* Builds the next state, which is sorted by id because new splats get the highest ids. Sets
 * *changes to the differences from the previous state, which are used if the state is not a
 * keyframe. */
static void make_state(struct spin_4dgs_frames *x, bool key, struct spin_4dgs_changes *changes)
{
    double step = x->coding->step[SPIN_4DGS_STEP_TIME];
    int32_t now = spin_4dgs_round(time_of(x, x->n_frames), step);

    *changes =
        (struct spin_4dgs_changes){.before = x->before, .after = x->after, .death = x->death};
    x->next.n = 0;
    for (size_t j = 0; j < x->shown.n; j++) {
        struct spin_4dgs_splat *was = &x->shown.splat[j], *is = &x->next.splat[x->next.n];

        if (x->mate[j] == UINT32_MAX) {
            x->death[changes->n_deaths++] = was->id;
            continue;
        }
        append(x, x->mate[j], was->id, key ? now : *spin_4dgs_bin(was, SPIN_4DGS_MU));
        if (memcmp(was->bin, is->bin, sizeof was->bin) != 0) {
            x->before[changes->n_updates] = *was;
            x->after[changes->n_updates++] = *is;
        }
    }
    changes->born = x->next.splat + x->next.n;
    for (size_t j = 0; j < x->order.n; j++)
        if (!x->taken[x->order.item[j].row]) {
            append(x, x->order.item[j].row, x->n_ids++, now);
            changes->n_births++;
        }
    changes->n_live = x->next.n;
}

static spin_status reserve_state(struct spin_4dgs_frames *x)
{
    size_t n = x->shown.n + 1;

    SPIN_TRY(spin_grow(x->order.n + 1, sizeof *x->next.splat, (void **)&x->next.splat));
    SPIN_TRY(spin_grow(x->order.n + 1, sizeof *x->next.row, (void **)&x->next.row));
    SPIN_TRY(spin_grow(n, sizeof *x->before, (void **)&x->before));
    SPIN_TRY(spin_grow(n, sizeof *x->after, (void **)&x->after));
    return spin_grow(n, sizeof *x->death, (void **)&x->death);
}

/* Writes the next state: as a keyframe if the last one is key_every states ago or most splats are
 * new, otherwise as a delta. */
static spin_status write_state(struct spin_4dgs_frames *x)
{
    const double interval[2] = {time_of(x, x->n_frames), time_of(x, x->n_frames + 1)};
    bool key = x->n_frames == 0 || x->shown.n == 0 || x->n_frames - x->key >= x->coding->key_every;
    struct spin_4dgs_changes changes;
    size_t n;

    SPIN_TRY(match(x, key, &n));
    if (!key && 2 * n < x->order.n) {
        key = true;
        SPIN_TRY(match(x, key, &n));
    }
    SPIN_TRY(reserve_state(x));
    make_state(x, key, &changes);
    if (key)
        x->key = x->n_frames;
    return key ? spin_4dgs_write_chunk(x->writer, interval, x->next.splat, x->next.n)
               : spin_4dgs_write_delta(x->writer, interval, &changes);
}

/* Keeps the rows of a frame for --check. */
static spin_status keep_rows(struct spin_4dgs_frames *x)
{
    size_t n = x->shown.n;
    uint32_t **to;

    SPIN_TRY(spin_grow((size_t)x->n_frames + 1, sizeof *x->row_of, (void **)&x->row_of));
    SPIN_TRY(spin_grow((size_t)x->n_frames + 1, sizeof *x->n_of, (void **)&x->n_of));
    to = &x->row_of[x->n_frames];
    *to = NULL;
    x->n_of[x->n_frames] = n;
    SPIN_TRY(spin_alloc(n + 1, sizeof **to, (void **)to));
    memcpy(*to, x->shown.row, n * sizeof **to);
    return SPIN_OK;
}

spin_status spin_4dgs_frames_add(struct spin_4dgs_frames *x, const struct spin_splats *splats)
{
    struct spin_4dgs_written last;

    SPIN_TRY(spin_splat_rows_choose(x->rows, splats));
    SPIN_TRY(spin_sort_rows_fill(&x->order, x->rows));
    spin_sort_rows_by_place(&x->order, splats);
    if (!x->begun && x->order.n > 0)
        SPIN_TRY(begin_file(x));
    if (x->begun) {
        SPIN_TRY(code_rows(x));
        SPIN_TRY(write_state(x));
    }
    last = x->shown;
    x->shown = x->next;
    x->next = last;
    if (x->job->check)
        SPIN_TRY(keep_rows(x));
    x->n_frames++;
    return SPIN_OK;
}

spin_status spin_4dgs_frames_end(struct spin_4dgs_frames *x)
{
    if (!x->begun)
        return spin_unsupported("no splats are left to write: relax the options that "
                                "drop splats");
    x->coding->n = x->n_ids;
    return spin_4dgs_write_end(x->writer);
}

void spin_4dgs_frames_free(struct spin_4dgs_frames *x)
{
    for (int f = 0; x->row_of && f < x->n_frames; f++)
        free(x->row_of[f]);
    free(x->row_of);
    free(x->n_of);
    spin_sort_rows_free(&x->order);
    free(x->shown.splat);
    free(x->shown.row);
    free(x->next.splat);
    free(x->next.row);
    free(x->coded);
    free(x->taken);
    free(x->mate);
    free(x->before);
    free(x->after);
    free(x->death);
}

/* ---- Check ----------------------------------------------------------------------------------- */

/* Compares frame f of the job with `back`, the frame that the importer has read. */
static spin_status check_frame(struct spin_4dgs_frames *x, struct spin_readback *values, int f,
                               const struct spin_splats *back)
{
    /* no rotation: `back` has the axes of the source */
    const struct spin_splat_rows plain = {.splats = back};
    size_t n_sh = 3 * (size_t)spin_sh_count(back->sh_degree);
    const struct spin_splats *splats;
    struct spin_gaussian there;

    if (back->n != x->n_of[f])
        return spin_fail(SPIN_E_IO, "frame %d has %zu splats, expected %zu", f, back->n,
                         x->n_of[f]);
    spin_readback_frame(values, x->job, f);
    SPIN_TRY(x->job->again(x->job->context, f, &splats));
    SPIN_TRY(spin_splat_rows_choose(x->rows, splats));
    for (size_t j = 0; j < back->n; j++) {
        spin_splat_rows_get(&plain, j, &there);
        spin_readback_row(values, x->rows, x->row_of[f][j], &there, back->sh + n_sh * j,
                          back->sh_degree);
    }
    spin_readback_end(values);
    return SPIN_OK;
}

static const struct spin_importer *own_importer(void)
{
    for (const struct spin_importer *const *i = spin_importer_list(); *i; i++)
        if (strcmp((*i)->name, "4dgs") == 0)
            return *i;
    return NULL;
}

static spin_status check_frames(struct spin_4dgs_frames *x, struct spin_readback *values)
{
    const struct spin_importer *importer = own_importer();
    const struct spin_plugin_values none = {NULL};
    struct spin_sequence_info sequence;
    struct spin_splats back = {0};
    void *self = NULL;
    spin_status status = importer->open(x->job->output, &none, &self, &sequence);

    for (int f = 0; f < x->n_frames && status == SPIN_OK; f++) {
        status =
            importer->frame(self, f, time_of(x, f), SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES, &back);
        if (status == SPIN_OK)
            status = check_frame(x, values, f, &back);
    }
    if (self)
        importer->close(self);
    spin_splats_free(&back);
    return status;
}

spin_status spin_4dgs_frames_check(struct spin_4dgs_frames *x)
{
    struct spin_readback values;

    spin_readback_begin(&values);
    SPIN_TRY_IN(check_frames(x, &values), "check: '%s'", x->job->output);
    if (x->job->report)
        spin_readback_fill_check(&values, x->n_frames, &x->job->report->check);
    return spin_readback_verify(&values, &x->coder.quant, x->job->output);
}
