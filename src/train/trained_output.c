/* Writes the arrays and the meta.json of the output bundle. */
#include "train/trained_output.h"

#include "base/base.h"
#include "math/quat.h"
#include "model/field.h"
#include "scene/dataset.h"
#include "scene/kept_cameras.h"
#include "scene/renders.h"
#include "train/refinement.h"
#include "train/rows_4d.h"

/* ---- Precision ------------------------------------------------------------------------------- */

/* Values are rounded to multiples of a quantisation step, 1 / per_unit(). With --precision half,
 * the step is 2^-11, about the spacing of half floats near 1. With --precision compact, the step is
 * so large that rounding errors are just not visible in 8-bit images. The steps of positions are
 * smaller, since positions are large compared with the sizes of splats: about 2^-16 (half) or 2^-14
 * (compact) times the camera extent. */
enum { BITS = 11, POSITION_BITS = 16, COMPACT_POSITION_BITS = 14 };

/* Returns the number of quantisation steps per unit for the values of a column; 0: the values are
 * not rounded. */
static float per_unit(const struct spin_output *output, unsigned column)
{
    enum spin_precision precision = output->plan->o->precision;
    bool compact = precision == SPIN_PRECISION_COMPACT;
    double extent = output->plan->extent;

    if (precision == SPIN_PRECISION_FULL)
        return 0;
    if (column == SPIN_COL_MEANS)
        return extent > 1e-30 ? (float)exp2((compact ? COMPACT_POSITION_BITS : POSITION_BITS) -
                                            floor(log2(extent)))
                              : 0;
    if (!compact)
        return 0x1p11f;
    return column == SPIN_COL_QUATS ? 64 : column == SPIN_COL_SH ? 128 : 32;
}

static void round_values(const struct spin_output *output, unsigned column, float *values, size_t n)
{
    float of = per_unit(output, column);

    if (of > 0)
        spin_round_values(values, n, column == SPIN_COL_MEANS ? POSITION_BITS : BITS, 1 / of);
}

/* The columns in a row of residual values: first float and number of floats of each column. A row
 * of a track is a displacement followed by a row of residual values. */
static const struct {
    unsigned column;
    size_t first, width;
} part[] = {{SPIN_COL_LOG_SCALES, 0, 3},
            {SPIN_COL_QUATS, 3, 4},
            {SPIN_COL_SH, 7, 3},
            {SPIN_COL_LOGIT_OPACITIES, 10, 1}};
enum { PARTS = sizeof part / sizeof *part };

static void round_rows(const struct spin_output *output, float *rows, size_t n, size_t stride)
{
    for (size_t i = 0; i < n; i++)
        for (int k = 0; k < PARTS; k++)
            round_values(output, part[k].column, rows + stride * i + part[k].first, part[k].width);
}

/* Passes the quantisation steps of columns of the group "source" or "refined" to the packer. All
 * values of a column have the same step. */
static spin_status set_column_units(const struct spin_output *output, struct spin_packer *packer,
                                    const char *group, unsigned columns, int sh_degree)
{
    for (unsigned column = 1; column < SPIN_COLUMNS_END; column <<= 1) {
        size_t width = spin_column_width(column, sh_degree);
        float unit[SPIN_UNITS];
        char series[40];

        if (!(columns & column) || per_unit(output, column) <= 0)
            continue;
        for (size_t i = 0; i < width; i++)
            unit[i] = per_unit(output, column);
        snprintf(series, sizeof series, "%s/%s", group, spin_column_name(column));
        SPIN_TRY(spin_packer_units(packer, series, width, unit));
    }
    return SPIN_OK;
}

/* Passes the quantisation steps of positions, residual values and tracks to the packer. */
static spin_status set_units(const struct spin_output *output, struct spin_packer *packer)
{
    float unit[SPIN_TRACK];

    for (int i = 0; i < 3; i++)
        unit[i] = per_unit(output, SPIN_COL_MEANS);
    for (int k = 0; k < PARTS; k++)
        for (size_t i = 0; i < part[k].width; i++)
            unit[3 + part[k].first + i] = per_unit(output, part[k].column);
    if (unit[0] <= 0)
        return SPIN_OK;
    SPIN_TRY(spin_packer_units(packer, "trained/means", 3, unit));
    SPIN_TRY(spin_packer_units(packer, "trained/residual", SPIN_RESIDUAL, unit + 3));
    return spin_packer_units(packer, "trained/tracks", SPIN_TRACK, unit);
}

static void round_splats(const struct spin_output *output, unsigned columns, struct spin_splats *s)
{
    for (unsigned column = 1; column < SPIN_COLUMNS_END; column <<= 1) {
        size_t n = s->n * spin_column_width(column, s->sh_degree);

        if (columns & column)
            round_values(output, column, *spin_column_of(s, column), n);
    }
}

/* ---- Arrays ---------------------------------------------------------------------------------- */

/* Inverts permutation [n], the row in the output of each splat of the trainer: sets *out [n] to the
 * trainer's splat in each row of the output. The caller frees *out. */
static spin_status invert_permutation(const uint32_t *permutation, size_t n, uint32_t **out)
{
    uint32_t *place;

    SPIN_TRY(spin_alloc(n + 1, sizeof *place, (void **)&place));
    for (size_t i = 0; i < n; i++)
        place[permutation[i]] = (uint32_t)i;
    *out = place;
    return SPIN_OK;
}

/* The trainer rotates displacement and rotation of a track by the turn of the splat
 * (track_matching.h) before it adds the splat's own values. The output contains no turns, so this
 * adds the difference between the rotated and the original values of the track to the splat's own
 * values: rows are the positions [n_pos][3] or, if `residual` is true, the residual values
 * [n_residual][SPIN_RESIDUAL] of a frame. tracks: values of all tracks, in groups. */
static spin_status fold_turns(const struct spin_trainer *t, const struct spin_train_frame *frame,
                              const float *tracks, bool residual, float *rows)
{
    struct spin_device *d = t->device;
    size_t n = frame->size.n_pos, width = residual ? 4 : 3;
    const float *shared = tracks + (residual ? (3 + 3) * t->n_tracks : 0);
    SPIN_FREED float *turn = NULL;
    uint32_t *track;

    if (!frame->turn)
        return SPIN_OK;
    SPIN_TRY(spin_alloc(n + frame->size.n, 5 * sizeof *turn, (void **)&turn));
    track = (uint32_t *)(turn + 4 * n);
    SPIN_TRY(d->op->download(d, turn, frame->turn, 4 * n * sizeof *turn));
    SPIN_TRY(d->op->download(d, track, frame->track, frame->size.n * sizeof *track));
    for (size_t i = frame->size.n_free; i < n; i++) {
        const float *value = shared + width * track[i];
        float turned[4], *to = rows + (residual ? SPIN_RESIDUAL * i + 3 : 3 * i);

        spin_turn(turn + 4 * i, (int)width, value, turned);
        for (size_t c = 0; c < width; c++)
            to[c] += turned[c] - value[c];
    }
    return SPIN_OK;
}

/* Writes the positions of a frame or, if `residual` is true, its residual values, in the order of
 * the output's rows. Splats that do not own such values are omitted. */
static spin_status write_frame(const struct spin_output *output, struct spin_bundle_writer *w,
                               int frame, const float *tracks, bool residual)
{
    const struct spin_train_frame *from = &output->trainer->frame[frame];
    size_t n = residual ? from->size.n_residual : from->size.n_pos;
    size_t width = residual ? SPIN_RESIDUAL : 3, to = 0;
    uint64_t shape[2] = {n, width};
    struct spin_rows rows = {.stride = width};
    struct spin_frame_rows of = {0};
    SPIN_FREED uint32_t *place = NULL;
    float *packed;
    SPIN_FREED void *block = NULL;

    SPIN_TRY(invert_permutation(output->frames->permutation[frame], from->size.n, &place));
    SPIN_TRY(spin_alloc(width * n + 1, 2 * sizeof(float), &block));
    rows.at = block;
    packed = rows.at + width * n;
    *(residual ? &of.residual : &of.pos) = rows;
    SPIN_TRY(spin_train_frame_download(from, output->trainer->device, SPIN_TRAIN_VALUES, of, NULL));
    SPIN_TRY(fold_turns(output->trainer, from, tracks, residual, rows.at));
    for (size_t i = 0; i < from->size.n; i++)
        if (place[i] < n)
            memcpy(packed + width * to++, rows.at + width * place[i], width * sizeof *packed);
    if (residual)
        round_rows(output, packed, n, width);
    else
        round_values(output, SPIN_COL_MEANS, packed, width * n);
    return spin_bundle_write_array(w, residual ? "trained/residual" : "trained/means", frame, "<f4",
                                   2, shape, packed);
}

/* ---- Tracks ---------------------------------------------------------------------------------- */

/* Sets *out [n] to the track of each splat of a frame, in the order of the output's rows. The
 * caller frees *out. */
static spin_status read_numbers(const struct spin_output *output, int frame, uint32_t **out)
{
    const struct spin_train_frame *from = &output->trainer->frame[frame];
    struct spin_device *d = output->trainer->device;
    size_t n = from->size.n;
    uint32_t *track;

    SPIN_TRY(spin_alloc(n + 1, 2 * sizeof *track, (void **)&track));
    SPIN_TRY(d->op->download(d, track + n, from->track, n * sizeof *track));
    for (size_t i = 0; i < n; i++)
        track[output->frames->permutation[frame][i]] = track[n + i];
    *out = track;
    return SPIN_OK;
}

/* Sets *same_rows to true if each row of the output belongs to the same track in all frames,
 * otherwise to false. */
static spin_status compare_rows(const struct spin_output *output, bool *same_rows)
{
    const struct spin_trainer *t = output->trainer;
    SPIN_FREED uint32_t *first = NULL;

    *same_rows = true;
    SPIN_TRY(read_numbers(output, 0, &first));
    for (int f = 1; *same_rows && f < t->n_frames; f++) {
        SPIN_FREED uint32_t *track = NULL;

        SPIN_TRY(read_numbers(output, f, &track));
        *same_rows = t->frame[f].size.n == t->frame[0].size.n &&
                     memcmp(first, track, t->frame[f].size.n * sizeof *track) == 0;
    }
    return SPIN_OK;
}

static int by_key(const void *a, const void *b)
{
    uint64_t x = *(const uint64_t *)a, y = *(const uint64_t *)b;

    return (x > y) - (x < y);
}

/* Sorts the rows of a frame in the output by track, so that the track numbers compress well. */
static spin_status sort_rows(const struct spin_output *output, int frame)
{
    size_t n = output->trainer->frame[frame].size.n;
    uint32_t *permutation = output->frames->permutation[frame];
    SPIN_FREED uint32_t *track = NULL, *place = NULL;
    SPIN_FREED uint64_t *key = NULL;

    SPIN_TRY(read_numbers(output, frame, &track));
    SPIN_TRY(invert_permutation(permutation, n, &place));
    SPIN_TRY(spin_alloc(n + 1, sizeof *key, (void **)&key));
    for (size_t row = 0; row < n; row++)
        key[row] = (uint64_t)track[row] << 32 | row;
    qsort(key, n, sizeof *key, by_key);
    for (size_t row = 0; row < n; row++)
        permutation[place[(uint32_t)key[row]]] = (uint32_t)row;
    return SPIN_OK;
}

/* Writes the track number of each splat, and sets *same_rows. If each row belongs to the same track
 * in all frames, writes the numbers of one frame only; otherwise sorts the rows of each frame by
 * track and writes the numbers of all frames. */
static spin_status write_numbers(const struct spin_output *output, struct spin_bundle_writer *w,
                                 bool *same_rows)
{
    const struct spin_trainer *t = output->trainer;

    SPIN_TRY(compare_rows(output, same_rows));
    for (int f = 0; f < (*same_rows ? 1 : t->n_frames); f++) {
        uint64_t shape[1] = {t->frame[f].size.n};
        SPIN_FREED uint32_t *track = NULL;

        if (!*same_rows)
            SPIN_TRY(sort_rows(output, f));
        SPIN_TRY(read_numbers(output, f, &track));
        SPIN_TRY(spin_bundle_write_array(w, "trained/track", f, "<u4", 1, shape, track));
    }
    return SPIN_OK;
}

/* Converts the values of the tracks from groups to rows, and writes them. */
static spin_status write_tracks(const struct spin_output *output, struct spin_bundle_writer *w,
                                const float *groups)
{
    size_t n = output->trainer->n_tracks;
    uint64_t shape[2] = {n, SPIN_TRACK};
    SPIN_FREED float *rows = NULL;

    SPIN_TRY(spin_alloc(n + 1, SPIN_TRACK * sizeof *rows, (void **)&rows));
    for (size_t i = 0; i < n; i++)
        memcpy(rows + SPIN_TRACK * i, groups + 3 * i, 3 * sizeof *rows);
    spin_residual_to_rows(n, groups + 3 * n, NULL, rows + 3, SPIN_TRACK);
    for (size_t i = 0; i < n; i++)
        round_values(output, SPIN_COL_MEANS, rows + SPIN_TRACK * i, 3);
    round_rows(output, rows + 3, n, SPIN_TRACK);
    return spin_bundle_write_array(w, "trained/tracks", -1, "<f4", 2, shape, rows);
}

/* A parameter array of the network, in device memory. */
struct weights {
    const struct spin_output *output;
    const char *name;
    const float SPIN_DEV *at;
};

static spin_status read_weights(void *context, uint64_t first, size_t n, uint32_t *to)
{
    const struct weights *w = context;
    float *values = (float *)(void *)to;

    SPIN_TRY(spin_read_device_values(w->output->trainer, w->name, w->at, (size_t)first, n, values));
    if (w->output->plan->o->precision != SPIN_PRECISION_FULL)
        spin_round_values(values, n, BITS, 0);
    return SPIN_OK;
}

/* Writes the values of the tracks, the track number of each splat, and the values that splats own.
 */
static spin_status write_values(const struct spin_output *output, struct spin_bundle_writer *w,
                                bool *same_rows)
{
    struct spin_trainer *t = output->trainer;
    size_t floats = SPIN_TRACK * t->n_tracks;
    /* [SPIN_TRACK n_tracks] values of the tracks, in groups (model/field.h). */
    SPIN_FREED float *tracks = NULL;

    SPIN_TRY(spin_alloc(floats + 1, sizeof *tracks, (void **)&tracks));
    if (floats > 0) {
        SPIN_TRY(t->device->op->download(t->device, tracks, t->tracks.p, floats * sizeof *tracks));
        SPIN_TRY(write_tracks(output, w, tracks));
        SPIN_TRY(write_numbers(output, w, same_rows));
    }
    for (int f = 0; f < t->n_frames; f++)
        SPIN_TRY(write_frame(output, w, f, tracks, false));
    for (int f = 0; spin_plan_has_residual(output->plan) && f < t->n_frames; f++)
        SPIN_TRY(write_frame(output, w, f, tracks, true));
    return SPIN_OK;
}

static spin_status write_network(const struct spin_output *output, struct spin_bundle_writer *w,
                                 const float SPIN_DEV *whole, bool *same_rows)
{
    struct spin_trainer *t = output->trainer;
    uint64_t features = (uint64_t)t->field.grid.n_features;
    uint64_t table[2] = {t->field.n_table / features, features}, heads[1] = {t->heads.n};

    SPIN_TRY(set_units(output, &w->packer));
    SPIN_TRY(write_values(output, w, same_rows));
    if (!t->network)
        return SPIN_OK;
    SPIN_TRY(spin_pack_write(&w->zip, "trained/table", 2, table, read_weights,
                             &(struct weights){output, "trained/table", whole}));
    return spin_pack_write(&w->zip, "trained/heads", 1, heads, read_weights,
                           &(struct weights){output, "trained/heads", t->heads.p});
}

/* Writes the trained 4D splats as the source of the output, and describes them in *meta. */
static spin_status write_rows(const struct spin_output *output, struct spin_bundle_writer *w,
                              struct spin_bundle_meta *meta)
{
    static const enum spin_round_4d round[] = {SPIN_ROUND_COMPACT, SPIN_ROUND_HALF,
                                               SPIN_ROUND_NOTHING};
    SPIN_LEAVES(spin_splats_4d_free) struct spin_splats_4d rows = {0};
    enum spin_round_4d rounded = round[output->plan->o->precision];
    size_t n_frames = (size_t)meta->n_frames;
    SPIN_FREED size_t *counts = NULL;
    SPIN_FREED double *times = NULL;

    SPIN_TRY(spin_rows_4d_read(output->plan, output->trainer, rounded, &rows));
    SPIN_TRY(spin_bundle_write_4d(w, &rows, rounded, meta));
    SPIN_TRY(spin_alloc(n_frames, sizeof *times, (void **)&times));
    SPIN_TRY(spin_alloc(n_frames, sizeof *counts, (void **)&counts));
    for (size_t f = 0; f < n_frames; f++)
        times[f] = meta->frame[f].time;
    SPIN_TRY(spin_splats_4d_counts(&rows, times, n_frames, counts));
    for (size_t f = 0; f < n_frames; f++)
        meta->frame[f].n = counts[f];
    meta->identity = false;
    return SPIN_OK;
}

/* Writes the source (columns or 4D splats), the refined frames, and the trained values; with
 * --method 4d, only the trained 4D splats. */
static spin_status write_splats(const struct spin_output *output, struct spin_bundle_writer *w,
                                struct spin_bundle_meta *meta, const float SPIN_DEV *whole,
                                bool *same_rows)
{
    struct spin_plan *plan = output->plan;
    unsigned kept = spin_refinement_columns(plan);
    /* If the source consists of points, its positions are rounded as well, except with refined
     * frames, whose keys depend on the exact positions. */
    bool points = !(meta->columns & SPIN_COL_ATTRIBUTES) && !output->refinement->frame;
    unsigned rounded = points ? SPIN_COL_MEANS : 0;
    SPIN_LEAVES(spin_splats_free) struct spin_splats splats = {0};
    const struct spin_splats_4d *four_d;

    if (plan->o->method == SPIN_METHOD_4D)
        return write_rows(output, w, meta);
    SPIN_TRY(spin_bundle_splats_4d(&plan->clip.bundle, &four_d));
    if (four_d)
        SPIN_TRY(spin_bundle_write_4d(w, four_d, SPIN_ROUND_NOTHING, meta));
    else
        SPIN_TRY(set_column_units(output, &w->packer, "source", rounded, meta->sh_degree));
    for (int f = 0; !four_d && f < plan->clip.n_frames; f++) {
        SPIN_TRY(spin_bundle_frame(&plan->clip.bundle, spin_plan_index(plan, f), meta->columns,
                                   &splats));
        round_splats(output, rounded, &splats);
        SPIN_TRY(spin_bundle_write_frame(w, f, meta->columns, meta->static_columns, &splats));
    }
    for (int f = 0; output->refinement->frame && f < plan->clip.n_frames; f++) {
        SPIN_TRY(spin_refinement_read(output->refinement, plan, f, kept, &splats));
        if (plan->o->method == SPIN_METHOD_FRAMES && f == 0)
            SPIN_TRY(set_column_units(output, &w->packer, "refined", kept, splats.sh_degree));
        /* Round only if refined frames are the result: with other methods, the clip was trained
         * from their exact values. */
        if (plan->o->method == SPIN_METHOD_FRAMES)
            round_splats(output, kept, &splats);
        SPIN_TRY(spin_bundle_write_refined(w, f, kept, &splats));
    }
    if (plan->o->method != SPIN_METHOD_FRAMES)
        return write_network(output, w, whole, same_rows);
    return SPIN_OK;
}

/* ---- meta.json ------------------------------------------------------------------------------- */

static const char *precision_name(const struct spin_retrain_options *o)
{
    static const char *const name[] = {"compact", "half", "full"};

    return name[o->precision];
}

/* Stores the cameras of the data set in *meta, as they are in the first frame of the clip that is
 * paired with a frame of the data set. Cameras of renders (scene/renders.h) are not stored, since
 * they belong to no data set. */
static spin_status keep_cameras(const struct spin_plan *plan, struct spin_bundle_meta *meta)
{
    const struct spin_clip *clip = &plan->clip;
    const struct spin_views *own = &clip->bundle.meta.cameras;
    int f = 0;

    if (own->n > 0 && (!plan->o->data || strcmp(plan->o->data, spin_renders.name) == 0))
        return spin_kept_cameras_choose(own, 0, &meta->cameras);
    if (strncmp(clip->data_from, spin_renders.name, strlen(spin_renders.name)) == 0)
        return SPIN_OK;
    while (f < clip->n_frames - 1 && clip->dataset_frame[f] < 0)
        f++;
    return spin_kept_cameras_choose(&clip->views, clip->dataset_frame[f], &meta->cameras);
}

static spin_status fill_meta(const struct spin_output *output, struct spin_bundle_meta *meta)
{
    const struct spin_bundle_meta *from = &output->plan->clip.bundle.meta;
    SPIN_FREED char *folder = NULL;

    SPIN_TRY(spin_bundle_meta_reserve(meta, output->plan->clip.n_frames));
    memcpy(meta->from, from->from, sizeof meta->from);
    memcpy(meta->upstream, from->upstream, sizeof meta->upstream);
    memcpy(meta->variant, from->variant, sizeof meta->variant);
    for (int f = 0; f < output->plan->clip.n_frames; f++) {
        meta->frame[f] = *spin_plan_info(output->plan, f);
        meta->source_index[f] = from->source_index[spin_plan_index(output->plan, f)];
    }
    meta->n_source_frames = from->n_source_frames;
    memcpy(meta->shift, from->shift, sizeof meta->shift);
    meta->fps = from->fps;
    meta->sound = from->sound;
    meta->numbered = from->numbered;
    meta->columns = from->columns;
    meta->static_columns = from->static_columns;
    meta->identity = from->identity;
    meta->sh_degree = from->sh_degree;
    meta->antialias = from->antialias;
    snprintf(meta->pair, sizeof meta->pair, "%s",
             output->plan->o->pair ? output->plan->o->pair : from->pair);
    memcpy(meta->data_from, output->plan->clip.data_from, sizeof meta->data_from);
    SPIN_TRY(keep_cameras(output->plan, meta));
    SPIN_TRY(spin_path_folder(output->plan->o->output, &folder));
    return spin_bundle_set_data_path(meta, folder, output->plan->clip.data_path);
}

static void set_quality(spin_json *j, const char *key, const struct spin_quality *q)
{
    spin_json *value;

    if (!q->valid) {
        spin_json_set_null(j, key);
        return;
    }
    value = spin_json_object();
    spin_json_set_number(value, "psnr", q->psnr);
    spin_json_set_number(value, "ssim", q->ssim);
    spin_json_set(j, key, value);
}

/* Sets *json to a list of the training cameras, each with its id, and its learned log gain and
 * offset for r, g, b. */
static spin_status cameras_to_json(const struct spin_output *output, spin_json **json)
{
    const struct spin_param *exposure = &output->trainer->exposures.param;
    struct spin_device *d = output->trainer->device;
    spin_json *all;
    SPIN_FREED void *block = NULL;

    SPIN_TRY(spin_alloc(exposure->n + 1, sizeof(float), &block));
    SPIN_TRY(d->op->download(d, block, exposure->p, exposure->n * sizeof(float)));
    all = spin_json_array();
    for (size_t i = 0; i < output->trainer->exposures.n_cameras; i++) {
        spin_json *one = spin_json_object(), *gain = spin_json_array(), *offset = spin_json_array();
        const float *row = (const float *)block + 6 * i;

        for (int c = 0; c < 3; c++) {
            spin_json_push_number(gain, (double)row[c]);
            spin_json_push_number(offset, (double)row[3 + c]);
        }
        spin_json_set_integer(one, "camera", output->plan->camera[i]);
        spin_json_set(one, "log_gain", gain);
        spin_json_set(one, "offset", offset);
        spin_json_push(all, one);
    }
    *json = all;
    return SPIN_OK;
}

static void tracks_to_json(const struct spin_trainer *t, bool same_rows, spin_json *network)
{
    spin_json *j = spin_json_object();

    spin_json_set_integer(j, "n", (int64_t)t->n_tracks);
    spin_json_set_integer(j, "moving", (int64_t)t->n_moving);
    spin_json_set_integer(j, "varying", (int64_t)t->n_varying);
    if (t->n_backdrop > 0)
        spin_json_set_integer(j, "backdrop", (int64_t)t->n_backdrop);
    spin_json_set_bool(j, "same_rows", same_rows);
    spin_json_set(network, "tracks", j);
}

/* Adds the number of splats of each frame, since a densification changes the numbers of the source.
 */
static void counts_to_json(const struct spin_trainer *t, spin_json *network)
{
    spin_json *splats = spin_json_array();

    for (int f = 0; f < t->n_frames; f++)
        spin_json_push_number(splats, (double)t->frame[f].size.n);
    spin_json_set(network, "splats", splats);
}

/* Sets *json to the object "trained" of meta.json. */
static spin_status trained_to_json(const struct spin_output *output, bool same_rows,
                                   spin_json **json)
{
    const struct spin_trainer *t = output->trainer;
    const struct spin_retrain_report *report = output->plan->report;
    spin_json *j, *cameras = NULL;

    SPIN_TRY(cameras_to_json(output, &cameras));
    j = spin_field_to_json(&t->field, t->network != NULL);
    spin_json_set(j, "options", spin_settings_network(output->plan));
    spin_json_set_string(j, "device", output->trainer->device->op->name);
    spin_json_set(j, "cameras", cameras);
    if (t->n_tracks > 0 && !t->motion)
        tracks_to_json(t, same_rows, j);
    if (t->tracked && !t->motion)
        counts_to_json(t, j);
    spin_json_set_string(j, "fingerprint", output->fingerprint);
    spin_json_set_string(j, "path", output->simd_paths);
    set_quality(j, "before", &report->before);
    set_quality(j, "test", &report->test);
    *json = j;
    return SPIN_OK;
}

/* Returns the name of the object in meta.json that describes the training. */
static const char *result_of(const struct spin_plan *plan)
{
    return plan->o->method == SPIN_METHOD_4D       ? "trained_4d"
           : plan->o->method == SPIN_METHOD_FRAMES ? "refined"
                                                   : "trained";
}

/* Returns the ids of the cameras with test views, without duplicates. */
static spin_json *held_out_cameras(const struct spin_views *views)
{
    spin_json *list = spin_json_array();

    for (size_t i = 0; i < views->n; i++) {
        size_t k = 0;

        if (!views->view[i].test)
            continue;
        while (!views->view[k].test || views->view[k].camera_id != views->view[i].camera_id)
            k++;
        if (k == i)
            spin_json_push_number(list, views->view[i].camera_id);
    }
    return list;
}

/* Adds to `extra` the members of meta.json that describe the training and the refinement: held-out
 * cameras, precision, lenses, settings and quality. */
static spin_status add_description(const struct spin_output *output, bool same_rows,
                                   spin_json *extra)
{
    const struct spin_plan *plan = output->plan;
    spin_json *refined = NULL, *trained = NULL, *held_out;

    if (plan->o->n_test_cameras > 0 || plan->o->test_outer > 0)
        held_out = held_out_cameras(&plan->clip.views);
    else
        held_out = json_incref(spin_json_get(plan->clip.bundle.json, "held_out"));
    if (held_out)
        spin_json_set(extra, "held_out", held_out);
    spin_json_set_string(extra, "precision", precision_name(plan->o));
    if (plan->o->learn_exposure == SPIN_EXPOSURE_ON)
        spin_json_set(extra, "lenses", spin_lenses_to_json(&plan->lenses));
    if (output->refinement->frame) {
        refined = spin_refinement_to_json(output->refinement, plan);
        set_quality(refined, "test", &plan->report->refined);
        spin_json_set(extra, "refined", refined);
    }
    if (plan->o->method != SPIN_METHOD_FRAMES) {
        SPIN_TRY(trained_to_json(output, same_rows, &trained));
        spin_json_set(extra, result_of(plan), trained);
    } else {
        set_quality(refined, "before", &plan->report->before);
        spin_json_set_string(refined, "fingerprint", output->fingerprint);
        spin_json_set_string(refined, "path", output->simd_paths);
    }
    return SPIN_OK;
}

/* ---- The output ------------------------------------------------------------------------------ */

static spin_status write_whole(const struct spin_output *output, const float SPIN_DEV *whole)
{
    const struct spin_retrain_options *o = output->plan->o;
    SPIN_LEAVES(spin_bundle_writer_abandon) struct spin_bundle_writer w = {0};
    SPIN_LEAVES(spin_bundle_meta_free) struct spin_bundle_meta meta = {0};
    SPIN_LEAVES(spin_json_freed) spin_json *extra = spin_json_object();
    bool same_rows = false;

    SPIN_TRY(spin_bundle_writer_open(o->output, o->force, true, &w));
    w.zip.n_threads = o->n_threads;
    w.packs = true;
    SPIN_TRY(fill_meta(output, &meta));
    SPIN_TRY(write_splats(output, &w, &meta, whole, &same_rows));
    SPIN_TRY(add_description(output, same_rows, extra));
    return spin_bundle_writer_finish(&w, &meta, json_incref(extra));
}

spin_status spin_output_write(const struct spin_output *output)
{
    struct spin_trainer *t = output->trainer;
    spin_status status = SPIN_OK;

    if (spin_rank() == 0) {
        status = write_whole(output, t->network ? spin_trainer_take_table(t) : NULL);
        if (t->network)
            spin_trainer_put_back(t);
    }
    return spin_ranks_agree(status);
}

bool spin_output_is_done(const struct spin_plan *plan, const char *fingerprint)
{
    struct spin_bundle bundle;
    const char *method = result_of(plan), *text, *precision;
    bool same;

    if (spin_bundle_open(plan->o->output, &bundle) != SPIN_OK)
        return false;
    text = spin_json_string(spin_json_get(spin_json_get(bundle.json, method), "fingerprint"));
    precision = spin_json_string(spin_json_get(bundle.json, "precision"));
    same = text && spin_fingerprint_equal(text, fingerprint) && precision &&
           strcmp(precision, precision_name(plan->o)) == 0;
    spin_bundle_close(&bundle);
    return same;
}
