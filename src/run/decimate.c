#include "run/decimate.h"

#include "base/base.h"
#include "math/activate.h"

#define COLUMNS (SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES)
enum {
    VIEWS = 32,    /* views per frame from which weights are computed, if frames share no splats */
    LOOKS = 400,   /* approximate number of these views in the whole clip, if frames share splats */
    PICTURES = 16, /* number of views in which the loss is measured */
    AROUND = 8,    /* number of views that are placed if the clip has no cameras */
    SIDE = 400,    /* width and height of a placed view, in pixels */
    TRIES = 9,     /* largest number of outputs that are written to reach a given size */
    HALVINGS = 8,  /* number of bisections to reach a given loss */
    SAMPLES = 4,   /* largest number of frames from which merges are chosen */
};
#define MOST_MERGED 0.75 /* largest share of the splats that are merged into others */
/* How a splat of one frame is recognised in other frames: not at all, by its row, by its 4D splat
 * or by its track. */
enum { NOTHING, ROWS, FOUR_D, TRACKS };
#define NONE UINT32_MAX

/* ---- The goal -------------------------------------------------------------------------------- */

spin_status spin_decimate_parse(const char *text, struct spin_decimate_goal *out)
{
    static const struct {
        const char *name;
        enum spin_decimate_unit unit;
        double factor, most;
    } units[] = {{"", SPIN_DECIMATE_SPLATS, 1, 1e9},     {"%", SPIN_DECIMATE_SHARE, 0.01, 1},
                 {"B", SPIN_DECIMATE_BYTES, 1, 1e15},    {"kB", SPIN_DECIMATE_BYTES, 1e3, 1e15},
                 {"MB", SPIN_DECIMATE_BYTES, 1e6, 1e15}, {"GB", SPIN_DECIMATE_BYTES, 1e9, 1e15},
                 {"dB", SPIN_DECIMATE_DB, 1, 200}};
    char *end;
    double value = strtod(text, &end);

    for (size_t i = 0; i < sizeof units / sizeof *units && end > text; i++) {
        if (strcmp(end, units[i].name) != 0)
            continue;
        out->unit = units[i].unit;
        out->amount = value * units[i].factor;
        if (out->amount > 0 && out->amount <= units[i].most &&
            (out->unit != SPIN_DECIMATE_SPLATS || value == floor(value)))
            return SPIN_OK;
    }
    return spin_misuse("--decimate '%s': expected a number of splats (5000), a share (50%%), a "
                       "size in B, kB, MB or GB (2MB) or a PSNR to keep (40dB)",
                       text);
}

/* ---- A frame --------------------------------------------------------------------------------- */

static struct spin_decimate_set *set_of(const struct spin_decimation *d, int f)
{
    return &d->set[d->n_sets > 1 ? f : 0];
}

static double time_of(const struct spin_decimation *d, int f)
{
    return d->clip->bundle.meta.frame[d->clip->frame[f]].time;
}

/* Sets *out to an allocated array with the index of the 4D splat of each row of frame f; or to NULL
 * if frames are exported instead of 4D splats. */
static spin_status rows_of(const struct spin_decimation *d, int f, size_t n, uint32_t **out)
{
    size_t k = 0;

    *out = NULL;
    if (!d->splats_4d)
        return SPIN_OK;
    SPIN_TRY(spin_alloc(n + 1, sizeof **out, (void **)out));
    for (size_t i = 0; i < d->splats_4d->n && k < n; i++)
        if (spin_splats_4d_is_visible(d->splats_4d, i, time_of(d, f)))
            (*out)[k++] = (uint32_t)i;
    return SPIN_OK;
}

/* Reads frame f into d->splats, and marks in *mark the rows to draw: if `kept` is true those that
 * the decimation keeps, otherwise all that the row filter keeps. *row is set as by rows_of(). The
 * caller frees both arrays. */
static spin_status read_frame(struct spin_decimation *d, int f, bool kept, unsigned char **mark,
                              uint32_t **row)
{
    struct spin_decimate_set *set = set_of(d, f);
    spin_status status;

    if (spin_cancelled())
        return spin_fail_cancelled();
    *mark = NULL;
    *row = NULL;
    SPIN_TRY(spin_player_splats(d->frames, d->clip->frame[f], COLUMNS, &d->splats));
    SPIN_TRY_OUT(rows_of(d, f, d->splats.n, row));
    if (!d->splats_4d)
        SPIN_TRY_OUT(spin_row_filter_apply(d->filter, f, &d->splats));
    SPIN_TRY_OUT(spin_alloc(d->splats.n + 1, 1, (void **)mark));
    for (size_t i = 0; i < d->splats.n; i++) {
        size_t k = *row ? (*row)[i] : i;
        bool counts = d->splats_4d ? set->weight[k] >= 0 : !d->filter->reason[i];

        (*mark)[i] = counts && (!kept || set->keep[k]);
    }
    return SPIN_OK;
out:
    free(*row);
    *row = NULL;
    return status;
}

/* ---- Weights --------------------------------------------------------------------------------- */

/* Returns the opacity of a splat times the product of its two largest scales. The product is
 * proportional to the largest projected area of the splat. */
static float size_of(const struct spin_splats *s, size_t i)
{
    const float *scale = s->log_scales + 3 * i;
    double least = (double)spin_minf(scale[0], spin_minf(scale[1], scale[2]));

    return (float)(spin_sigmoid_of((double)s->logit_opacities[i]) *
                   exp((double)scale[0] + (double)scale[1] + (double)scale[2] - least));
}

static int n_views(const struct spin_decimation *d)
{
    int n = LOOKS / d->clip->n_frames;

    return d->sharing == NOTHING || n > VIEWS ? VIEWS : n > 1 ? n : 1;
}

/* Finds the views of frame f, which are d->pairs[*first] to d->pairs[*first + *n - 1]. */
static void find_views(const struct spin_decimation *d, int f, size_t *first, size_t *n)
{
    size_t end = d->n_pairs;

    for (*first = 0; *first < end;) { /* bisection */
        size_t middle = *first + (end - *first) / 2;

        if (d->pairs[middle].frame < f)
            *first = middle + 1;
        else
            end = middle;
    }
    for (*n = 0; *first + *n < d->n_pairs && d->pairs[*first + *n].frame == f;)
        ++*n;
}

/* Estimates the contribution, in pixels, that a splat would have if the camera were turned towards
 * it and nothing hid it. */
static float shown_by(const struct spin_camera *camera, const struct spin_splats *s, size_t i)
{
    const float *p = s->means + 3 * i;
    double square = 0;

    for (int k = 0; k < 3; k++) {
        const double *row = camera->w2c + 4 * k;

        square +=
            pow(row[0] * (double)p[0] + row[1] * (double)p[1] + row[2] * (double)p[2] + row[3], 2);
    }
    return (float)fmin((double)camera->width * camera->height,
                       2 * M_PI * camera->fx * camera->fy / square * (double)size_of(s, i));
}

/* Returns the weight of a splat that is outside all n views in `pair`: the largest contribution
 * that it would have if one of the cameras were turned towards it. Returns 0 if the splat is inside
 * at least one of the views, since other splats hide it there. */
static float unseen_weight(const struct spin_decimation *d, const struct spin_pair *pair, size_t n,
                           size_t i)
{
    float most = 0;
    double at[3];

    for (size_t k = 0; k < n; k++) {
        const struct spin_camera *camera = &d->clip->views.view[pair[k].view].camera;

        if (spin_camera_project_visible(camera, d->part.means + 3 * i, at))
            return 0;
        most = spin_maxf(most, shown_by(camera, &d->part, i));
    }
    return most;
}

/* Sets the weight of each splat in d->part to the maximum of its contributions over the views.
 * Using the mean instead costs 0.5 to 1.8 dB of PSNR on the clip 'court' if half or 70 % of the
 * splats are kept (tests/bench/README.md). */
static spin_status compute_weights(struct spin_decimation *d, int f, float *weight)
{
    size_t first, n, wanted = (size_t)n_views(d);
    SPIN_FREED float *seen = NULL;

    find_views(d, f, &first, &n);
    for (size_t i = 0; i < d->part.n && d->n_pairs == 0; i++)
        weight[i] = size_of(&d->part, i);
    if (n == 0 || d->part.n == 0)
        return SPIN_OK;
    wanted = wanted < n ? wanted : n;
    SPIN_TRY(spin_alloc(d->part.n, sizeof *seen, (void **)&seen));
    SPIN_TRY(spin_player_show_splats(&d->drawing, &d->part));
    for (size_t k = 0; k < wanted; k++) { /* each frame uses other views than the frame before it */
        size_t at = first + (k * n / wanted + (size_t)f) % n;

        SPIN_TRY(spin_player_draw(&d->drawing, &d->clip->views.view[d->pairs[at].view].camera,
                                  d->background, NULL));
        SPIN_TRY(spin_player_contributions(&d->drawing, seen));
        for (size_t i = 0; i < d->part.n; i++)
            weight[i] = spin_maxf(weight[i], seen[i]);
    }
    for (size_t i = 0; i < d->part.n; i++)
        if (weight[i] == 0)
            weight[i] = unseen_weight(d, d->pairs + first, n, i);
    return SPIN_OK;
}

static spin_status add_frame_weights(struct spin_decimation *d, int f)
{
    struct spin_decimate_set *set = set_of(d, f);
    SPIN_FREED unsigned char *mark = NULL;
    SPIN_FREED uint32_t *row = NULL;
    SPIN_FREED float *weight = NULL;
    size_t k = 0;

    SPIN_TRY(read_frame(d, f, false, &mark, &row));
    SPIN_TRY(spin_splats_select(&d->splats, mark, &d->part));
    SPIN_TRY(spin_alloc(d->part.n + 1, sizeof *weight, (void **)&weight));
    SPIN_TRY(compute_weights(d, f, weight));
    for (size_t i = 0; i < d->splats.n; i++) {
        float *sum = &set->weight[row ? row[i] : i];

        if (mark[i])
            *sum = spin_maxf(*sum, 0) + weight[k++];
    }
    spin_bundle_release(&d->splats);
    return SPIN_OK;
}

/* Returns whether 4D splat i exists at some time between the first and the last frame of the clip.
 * Such a splat takes part in the decimation if the row filter keeps it, even if no frame shows it.
 */
static bool exists_in_clip(const struct spin_decimation *d, size_t i)
{
    const double *span = d->splats_4d->spans + 2 * i;

    return span[0] <= time_of(d, d->clip->n_frames - 1) && span[1] >= time_of(d, 0);
}

static spin_status begin_4d(struct spin_decimation *d)
{
    SPIN_TRY(spin_row_filter_apply_4d(d->filter, d->splats_4d));
    for (size_t i = 0; i < d->splats_4d->n; i++)
        d->set[0].weight[i] = exists_in_clip(d, i) && !d->filter->reason_4d[i] ? 0 : -1;
    return SPIN_OK;
}

/* ---- Splats that several frames share -------------------------------------------------------- */

/* Returns whether all frames have the same rows: row i is the same splat in each of them. */
static bool keeps_rows(const struct spin_decimation *d)
{
    const struct spin_clip *c = d->clip;
    enum spin_splat_source from = d->frames->from;

    for (int f = 1; f < c->n_frames; f++)
        if (spin_bundle_count(&c->bundle, c->frame[f], from) !=
            spin_bundle_count(&c->bundle, c->frame[0], from))
            return false;
    return d->frames->tracks.values ? d->frames->tracks.same_rows
                                    : c->bundle.meta.identity && from != SPIN_FROM_REFINED &&
                                          c->bundle.refined.columns == 0;
}

static int find_sharing(const struct spin_decimation *d)
{
    if (d->splats_4d || d->clip->n_frames == 1 || keeps_rows(d))
        return ROWS;
    if (d->frames->from == SPIN_FROM_SOURCE && d->clip->bundle.meta.four_d.n > 0)
        return FOUR_D;
    return d->frames->tracks.values ? TRACKS : NOTHING;
}

/* Sets item[i] to the index of the row, 4D splat or track that row i of frame f belongs to, or to
 * NONE for a single-frame splat. */
static spin_status read_items(const struct spin_decimation *d, int f, size_t n, uint32_t *item)
{
    struct spin_bundle *b = (struct spin_bundle *)(uintptr_t)&d->clip->bundle;
    const int64_t shape[1] = {(int64_t)n};
    const struct spin_splats_4d *s;
    struct spin_bundle_values v;
    size_t k = 0;

    if (d->sharing == ROWS) {
        for (size_t i = 0; i < n; i++)
            item[i] = (uint32_t)i;
        return SPIN_OK;
    }
    if (d->sharing == FOUR_D) {
        SPIN_TRY(spin_bundle_splats_4d(b, &s));
        for (size_t i = 0; i < s->n && k < n; i++)
            if (spin_splats_4d_is_visible(s, i, time_of(d, f)))
                item[k++] = (uint32_t)i;
        return SPIN_OK;
    }
    SPIN_TRY(spin_bundle_values_open(b, "trained/track", d->clip->frame[f], 'u', 1, shape, &v));
    spin_bundle_values_get(&v, 0, n, item);
    spin_bundle_values_close(&v);
    return SPIN_OK;
}

/* ---- The choice of splats -------------------------------------------------------------------- */

/* An element of the sorted list: a row that takes part in the decimation. */
struct entry {
    float weight;
    uint32_t item, set, row;
};

/* Orders entries by descending weight, and entries of equal weight so that those of the same splat
 * are adjacent. */
static int by_weight(const void *a, const void *b)
{
    const struct entry *x = a, *y = b;

    if (x->weight != y->weight)
        return x->weight < y->weight ? 1 : -1;
    if (x->item != y->item)
        return x->item < y->item ? -1 : 1;
    if (x->set != y->set)
        return x->set < y->set ? -1 : 1;
    return (x->row > y->row) - (x->row < y->row);
}

static size_t add_entries(const struct spin_decimation *d, int s, const uint32_t *item,
                          struct entry *to)
{
    const struct spin_decimate_set *set = &d->set[s];
    size_t n = 0;

    for (size_t i = 0; i < set->n; i++)
        if (set->weight[i] >= 0)
            to[n++] = (struct entry){.weight = set->weight[i],
                                     .item = item ? item[i] : NONE,
                                     .set = (uint32_t)s,
                                     .row = (uint32_t)i};
    return n;
}

/* Replaces the weights of all entries of the same splat by their mean. */
static spin_status take_means(struct entry *entry, size_t n)
{
    uint32_t n_items = 0;
    SPIN_FREED double *sum = NULL;
    SPIN_FREED uint32_t *count = NULL;

    for (size_t i = 0; i < n; i++)
        if (entry[i].item != NONE && entry[i].item >= n_items)
            n_items = entry[i].item + 1;
    SPIN_TRY(spin_alloc((size_t)n_items + 1, sizeof *sum, (void **)&sum));
    SPIN_TRY(spin_alloc((size_t)n_items + 1, sizeof *count, (void **)&count));
    for (size_t i = 0; i < n; i++)
        if (entry[i].item != NONE) {
            sum[entry[i].item] += (double)entry[i].weight;
            count[entry[i].item]++;
        }
    for (size_t i = 0; i < n; i++)
        if (entry[i].item != NONE)
            entry[i].weight = (float)(sum[entry[i].item] / count[entry[i].item]);
    return SPIN_OK;
}

static size_t most_of(const struct spin_decimate_set *set, enum spin_decimate_unit unit,
                      double amount)
{
    double n = unit == SPIN_DECIMATE_SHARE ? fmax(floor(amount * (double)set->n_counted + 1e-9), 1)
                                           : amount;

    return n < (double)set->n_counted ? (size_t)n : set->n_counted;
}

/* Visits the sorted entries by descending weight, and keeps a splat if none of the frames that
 * contain it has reached limit[set], the number of splats to keep in a frame. */
static void keep_heaviest(struct spin_decimation *d, const struct entry *entry, size_t n,
                          const size_t *limit)
{
    size_t end;

    for (size_t i = 0; i < n; i++) {
        d->set[entry[i].set].keep[entry[i].row] = 0;
        d->set[entry[i].set].n_kept = 0;
    }
    for (size_t i = 0; i < n; i = end) {
        bool fits = true;

        end = i + 1;
        while (entry[i].item != NONE && end < n && entry[end].item == entry[i].item)
            end++;
        for (size_t k = i; k < end; k++)
            fits = fits && d->set[entry[k].set].n_kept < limit[entry[k].set];
        for (size_t k = i; k < end && fits; k++) {
            d->set[entry[k].set].keep[entry[k].row] = 1;
            d->set[entry[k].set].n_kept++;
        }
    }
}

/* ---- Merges ---------------------------------------------------------------------------------- */

/* Returns whether splats may be merged: frames must share them, by rows, tracks or 4D splats. */
static bool merges_splats(const struct spin_decimation *d)
{
    return !d->splats_4d && d->sharing != NOTHING && !(d->sharing == ROWS && d->filter->varies);
}

/* The splats that every frame contains and keeps, of which some are to be merged. */
struct common {
    uint32_t *item; /* [n] ascending */
    float *weight;  /* [n] */
    size_t n;
};

static int by_item(const void *a, const void *b)
{
    uint32_t x = *(const uint32_t *)a, y = *(const uint32_t *)b;

    return (x > y) - (x < y);
}

/* Lists the common splats among the sorted entries, of which those of one splat are adjacent and in
 * the order of the sets. A track that has two rows in a frame is not common. */
static spin_status list_common(const struct spin_decimation *d, const struct entry *entry, size_t n,
                               struct common *out)
{
    size_t end, n_sets = (size_t)d->n_sets;
    SPIN_FREED float *weight = NULL;
    uint32_t most = 0;

    SPIN_TRY(spin_grow(n / n_sets + 1, sizeof *out->item, (void **)&out->item));
    SPIN_TRY(spin_grow(n / n_sets + 1, sizeof *out->weight, (void **)&out->weight));
    out->n = 0;
    for (size_t i = 0; i < n; i++)
        if (entry[i].item != NONE && entry[i].item > most)
            most = entry[i].item;
    SPIN_TRY(spin_alloc((size_t)most + 1, sizeof *weight, (void **)&weight));
    for (size_t i = 0; i < n; i = end) {
        bool everywhere = entry[i].item != NONE;

        for (end = i + 1; everywhere && end < n && entry[end].item == entry[i].item;)
            end++;
        everywhere = everywhere && end - i == n_sets && d->set[entry[i].set].keep[entry[i].row];
        for (size_t k = i; k < end && everywhere; k++)
            everywhere = entry[k].set == k - i;
        if (!everywhere)
            continue;
        weight[entry[i].item] = entry[i].weight;
        out->item[out->n++] = entry[i].item;
    }
    if (out->n > 0)
        qsort(out->item, out->n, sizeof *out->item, by_item);
    for (size_t i = 0; i < out->n; i++)
        out->weight[i] = weight[out->item[i]];
    return SPIN_OK;
}

/* Sets *row to an allocated array with the row of each of the items in frame f, whose `n` rows
 * belong to item[n]; NONE: the frame does not contain the item. */
static spin_status find_rows(const struct spin_decimation *d, int f, size_t n, size_t n_items,
                             uint32_t **row)
{
    SPIN_FREED uint32_t *item = NULL;

    SPIN_TRY(spin_alloc(n + 1, sizeof *item, (void **)&item));
    SPIN_TRY(spin_alloc(n_items + 1, sizeof **row, (void **)row));
    memset(*row, 0xff, (n_items + 1) * sizeof **row);
    SPIN_TRY(read_items(d, f, n, item));
    for (size_t i = 0; i < n; i++)
        if (item[i] < n_items)
            (*row)[item[i]] = (uint32_t)i;
    return SPIN_OK;
}

/* Copies the common splats of frame f to *out. */
static spin_status read_common(struct spin_decimation *d, int f, const struct common *c,
                               struct spin_splats *out)
{
    SPIN_FREED unsigned char *mark = NULL;
    SPIN_FREED uint32_t *unused = NULL, *row = NULL;

    SPIN_TRY(read_frame(d, f, false, &mark, &unused));
    SPIN_TRY(find_rows(d, f, d->splats.n, (size_t)c->item[c->n - 1] + 1, &row));
    for (size_t i = 0; i < c->n; i++)
        row[i] = row[c->item[i]]; /* item[i] >= i */
    return spin_splats_gather(&d->splats, row, c->n, out);
}

/* Plans the merges that leave n of the common splats, which are more. */
static spin_status plan_merges(struct spin_decimation *d, const struct common *c, size_t n)
{
    struct spin_splats sample[SAMPLES] = {{0}};
    int n_samples = d->clip->n_frames < SAMPLES ? d->clip->n_frames : SAMPLES;
    spin_status status = SPIN_OK;

    for (int k = 0; k < n_samples; k++)
        SPIN_TRY_OUT(read_common(d, n_samples > 1 ? k * (d->clip->n_frames - 1) / (n_samples - 1) : 0,
                                 c, &sample[k]));
    SPIN_TRY_OUT(spin_merge_plan_make(sample, n_samples, c->weight, n, &d->merges));
    for (size_t i = 0; i < d->merges.n; i++)
        for (int k = 0; k < 2; k++)
            if (d->merges.pair[i][k] != SPIN_MERGE_NONE)
                d->merges.pair[i][k] = c->item[d->merges.pair[i][k]];
out:
    for (int k = 0; k < SAMPLES; k++)
        spin_splats_free(&sample[k]);
    return status;
}

/* Marks the splats as not kept that the plan merges into others. */
static spin_status leave_out_merged(struct spin_decimation *d)
{
    uint32_t n_items = 0;

    for (size_t i = 0; i < d->merges.n; i++)
        if (d->merges.pair[i][1] >= n_items)
            n_items = d->merges.pair[i][1] + 1;
    for (int s = 0; s < d->n_sets; s++) {
        SPIN_FREED uint32_t *row = NULL;

        SPIN_TRY(find_rows(d, s, d->set[s].n, n_items, &row));
        for (size_t i = 0; i < d->merges.n; i++)
            d->set[s].keep[row[d->merges.pair[i][1]]] = 0;
        d->set[s].n_kept -= d->merges.n;
    }
    return SPIN_OK;
}

/* Returns the largest number of splats that a frame keeps beyond its limit. */
static size_t most_excess(const struct spin_decimation *d, const size_t *limit)
{
    size_t most = 0;

    for (int s = 0; s < d->n_sets; s++)
        if (d->set[s].n_kept > limit[s] && d->set[s].n_kept - limit[s] > most)
            most = d->set[s].n_kept - limit[s];
    return most;
}

/* Chooses the splats to keep, and those to merge into them. Some of the excess is dropped before
 * merging, since both alone are worse: with 70, 50, 25 and 10 % of the splats of a frame of real
 * footage, images have 47.6, 35.3, 24.1 and 17.5 dB if the others are dropped, 44.0, 38.7, 33.7 and
 * 29.9 dB if nothing is dropped before, and 47.3, 40.5, 35.0 and 30.4 dB as here.
 *
 * At most MOST_MERGED of the splats that all frames have are merged. If more would have to be, more
 * are dropped before. */
static spin_status keep_and_merge(struct spin_decimation *d, const struct entry *entry, size_t n,
                                  const size_t *limit)
{
    SPIN_FREED size_t *wider = NULL;
    struct common common = {0};
    spin_status status = SPIN_OK;
    size_t n_merges = SIZE_MAX;

    SPIN_TRY_OUT(spin_alloc((size_t)d->n_sets, sizeof *wider, (void **)&wider));
    for (int attempt = 0; attempt < 4; attempt++) {
        for (int s = 0; s < d->n_sets; s++) {
            double all = (double)d->set[s].n_counted, excess = all - (double)limit[s];
            double merged = floor(excess * fmin(0.5, excess / fmax(all, 1)));

            wider[s] = limit[s] + (size_t)fmin(merged, (double)n_merges);
        }
        keep_heaviest(d, entry, n, wider);
        SPIN_TRY_OUT(list_common(d, entry, n, &common));
        if (most_excess(d, limit) <= (size_t)(MOST_MERGED * (double)common.n))
            break;
        n_merges = (size_t)(0.5 * MOST_MERGED * (double)common.n);
    }
    n_merges = most_excess(d, limit);
    if (n_merges > (size_t)(MOST_MERGED * (double)common.n)) {
        keep_heaviest(d, entry, n, limit);
    } else if (n_merges > 0) {
        SPIN_TRY_OUT(plan_merges(d, &common, common.n - n_merges));
        SPIN_TRY_OUT(leave_out_merged(d));
    }
out:
    free(common.item);
    free(common.weight);
    return status;
}

/* ---- The choice of all frames ---------------------------------------------------------------- */

/* Chooses which splats to keep in the sets `first` to `end` - 1; other sets have no influence on
 * the choice. */
static spin_status choose_sets(struct spin_decimation *d, int first, int end,
                               enum spin_decimate_unit unit, double amount)
{
    bool items = d->sharing == FOUR_D || d->sharing == TRACKS, merges = merges_splats(d);
    SPIN_FREED struct entry *entry = NULL;
    SPIN_FREED uint32_t *item = NULL;
    SPIN_FREED size_t *limit = NULL;
    size_t n = 0, most = 0, all = 0;

    for (int s = first; s < end; s++) {
        all += d->set[s].n_counted;
        most = d->set[s].n > most ? d->set[s].n : most;
    }
    SPIN_TRY(spin_alloc(all + 1, sizeof *entry, (void **)&entry));
    SPIN_TRY(spin_alloc(most + 1, sizeof *item, (void **)&item));
    SPIN_TRY(spin_alloc((size_t)d->n_sets, sizeof *limit, (void **)&limit));
    for (int s = first; s < end; s++) {
        limit[s] = most_of(&d->set[s], unit, amount);
        if (items || merges)
            SPIN_TRY(read_items(d, s, d->set[s].n, item));
        n += add_entries(d, s, items || merges ? item : NULL, entry + n);
    }
    if (items)
        SPIN_TRY(take_means(entry, n));
    qsort(entry, n, sizeof *entry, by_weight);
    spin_merge_plan_free(&d->merges);
    if (merges)
        return keep_and_merge(d, entry, n, limit);
    keep_heaviest(d, entry, n, limit);
    return SPIN_OK;
}

spin_status spin_decimation_choose(struct spin_decimation *d, enum spin_decimate_unit unit,
                                   double amount)
{
    if (d->sharing == FOUR_D || d->sharing == TRACKS)
        return choose_sets(d, 0, d->n_sets, unit, amount);
    for (int s = 0; s < d->n_sets; s++)
        SPIN_TRY(choose_sets(d, s, s + 1, unit, amount));
    return SPIN_OK;
}

/* ---- Opening --------------------------------------------------------------------------------- */

static spin_status find_pairs(struct spin_decimation *d)
{
    if (!d->clip->has_views)
        return SPIN_OK;
    SPIN_TRY(spin_clip_pairs(d->clip, SPIN_SPLIT_TRAIN, &d->pairs, &d->n_pairs));
    if (d->n_pairs > 0)
        return SPIN_OK;
    free(d->pairs);
    return spin_clip_pairs(d->clip, SPIN_SPLIT_ALL, &d->pairs, &d->n_pairs);
}

static spin_status make_sets(struct spin_decimation *d)
{
    const struct spin_clip *c = d->clip;

    d->n_sets = d->sharing == ROWS ? 1 : c->n_frames;
    SPIN_TRY(spin_alloc((size_t)d->n_sets, sizeof *d->set, (void **)&d->set));
    for (int s = 0; s < d->n_sets; s++) {
        struct spin_decimate_set *set = &d->set[s];

        set->n = d->splats_4d ? d->splats_4d->n
                              : spin_bundle_count(&c->bundle, c->frame[s], d->frames->from);
        SPIN_TRY(spin_alloc(set->n + 1, sizeof *set->weight, (void **)&set->weight));
        SPIN_TRY(spin_alloc(set->n + 1, 1, (void **)&set->keep));
        for (size_t i = 0; i < set->n; i++)
            set->weight[i] = -1;
    }
    return SPIN_OK;
}

spin_status spin_decimation_open(struct spin_decimation *d)
{
    struct spin_progress progress;
    spin_status status = SPIN_OK;

    SPIN_TRY(find_pairs(d));
    SPIN_TRY(spin_player_open(&d->drawing, d->frames->device, NULL, SPIN_FROM_SOURCE));
    d->drawing.keeps_contributions = true;
    d->sharing = find_sharing(d);
    SPIN_TRY(make_sets(d));
    if (d->splats_4d)
        SPIN_TRY(begin_4d(d));
    spin_progress_begin(&progress, "ranking", "frames", 0, d->clip->n_frames);
    for (int f = 0; f < d->clip->n_frames && status == SPIN_OK; f++) {
        status = add_frame_weights(d, f);
        spin_progress_set(&progress, f + 1, "%zu splats", d->splats.n);
    }
    spin_progress_end(&progress);
    for (int s = 0; s < d->n_sets; s++)
        for (size_t i = 0; i < d->set[s].n; i++)
            d->set[s].n_counted += d->set[s].weight[i] >= 0;
    return status;
}

void spin_decimation_close(struct spin_decimation *d)
{
    for (int s = 0; s < d->n_sets && d->set; s++) {
        free(d->set[s].weight);
        free(d->set[s].keep);
    }
    spin_merge_plan_free(&d->merges);
    free(d->set);
    free(d->pairs);
    spin_splats_free(&d->splats);
    spin_splats_free(&d->merged);
    spin_splats_free(&d->part);
    spin_viewpoints_close(&d->placed);
    spin_player_close(&d->drawing);
}

/* ---- The splats that remain ------------------------------------------------------------------ */

/* Marks all but the `most` largest of the remaining rows as decimated. This is used for rows that
 * do not correspond to those of the clip; `most` is the number of splats that the clip keeps in the
 * same frame. */
static spin_status drop_smallest(const struct spin_splats *all, size_t most, unsigned char *reason)
{
    SPIN_FREED struct entry *entry = NULL;
    size_t n = 0;

    SPIN_TRY(spin_alloc(all->n + 1, sizeof *entry, (void **)&entry));
    for (size_t i = 0; i < all->n; i++)
        if (!reason[i])
            entry[n++] =
                (struct entry){.weight = size_of(all, i), .item = NONE, .row = (uint32_t)i};
    qsort(entry, n, sizeof *entry, by_weight);
    for (size_t i = most; i < n; i++)
        reason[entry[i].row] = SPIN_ROW_DECIMATE;
    return SPIN_OK;
}

/* Returns whether row i of a retrained frame is row i of the same imported frame. Refined frames
 * have other rows than imported frames, and a training with densification adds and sorts rows, so
 * an equal number of rows does not prove that they correspond. */
static bool preserves_rows(const struct spin_decimation *d)
{
    const struct spin_bundle *b = &d->clip->bundle;

    return d->frames->from == SPIN_FROM_TRAINED && !b->trained_n && b->refined.columns == 0;
}

static spin_status drop_rows(void *context, int f, const struct spin_splats *all, bool source,
                             unsigned char *reason)
{
    const struct spin_decimation *d = context;
    const struct spin_decimate_set *set = set_of(d, f);

    if (all->n != set->n || (source && !preserves_rows(d)))
        return drop_smallest(all, set->n_kept, reason);
    for (size_t i = 0; i < all->n; i++)
        if (!reason[i] && !set->keep[i])
            reason[i] = SPIN_ROW_DECIMATE;
    return SPIN_OK;
}

static void drop_rows_4d(const void *context, unsigned char *reason)
{
    const struct spin_decimation *d = context;

    for (size_t i = 0; i < d->splats_4d->n; i++)
        if ((!reason[i] && !d->set[0].keep[i]) || !exists_in_clip(d, i))
            reason[i] = SPIN_ROW_DECIMATE;
}

/* Merges rows of a frame, except those that the filter dropped for other reasons. Rows of the
 * source that do not correspond to those of the clip are not merged. */
static spin_status merge_rows(void *context, int f, bool source, const unsigned char *reason,
                              const struct spin_splats **out)
{
    struct spin_decimation *d = context;
    struct spin_merge_plan rows = {0};
    SPIN_FREED unsigned char *skip = NULL;
    SPIN_FREED uint32_t *row = NULL;
    uint32_t n_items = 0;
    spin_status status = SPIN_OK;

    if (d->merges.n == 0 || (*out)->n != set_of(d, f)->n || (source && !preserves_rows(d)))
        return SPIN_OK;
    for (size_t i = 0; i < d->merges.n; i++)
        for (int k = 0; k < 2; k++)
            if (d->merges.pair[i][k] != SPIN_MERGE_NONE && d->merges.pair[i][k] >= n_items)
                n_items = d->merges.pair[i][k] + 1;
    SPIN_TRY(find_rows(d, f, (*out)->n, n_items, &row));
    SPIN_TRY(spin_alloc((*out)->n + 1, 1, (void **)&skip));
    for (size_t i = 0; i < (*out)->n; i++)
        skip[i] = reason[i] && reason[i] != SPIN_ROW_DECIMATE;
    SPIN_TRY_OUT(spin_alloc(d->merges.n, sizeof *rows.pair, (void **)&rows.pair));
    for (rows.n = 0; rows.n < d->merges.n; rows.n++)
        for (int k = 0; k < 2; k++) {
            uint32_t item = d->merges.pair[rows.n][k];

            rows.pair[rows.n][k] = item == SPIN_MERGE_NONE ? item : row[item];
        }
    SPIN_TRY_OUT(spin_merge_plan_apply(&rows, *out, skip, &d->merged));
    *out = &d->merged;
out:
    spin_merge_plan_free(&rows);
    return status;
}

void spin_decimation_attach(struct spin_decimation *d)
{
    d->filter->drop = drop_rows;
    d->filter->merge = merge_rows;
    d->filter->drop_4d = drop_rows_4d;
    d->filter->drop_context = d;
}

size_t spin_decimation_count(const struct spin_decimation *d, int f)
{
    return set_of(d, f)->n_kept;
}

/* ---- The loss -------------------------------------------------------------------------------- */

/* Reads the splats of frame f into d->part: all that the row filter keeps or, if `kept` is true,
 * only those that the decimation keeps too. */
static spin_status read_part(struct spin_decimation *d, int f, bool kept)
{
    SPIN_FREED unsigned char *mark = NULL;
    SPIN_FREED uint32_t *row = NULL;

    const struct spin_splats *all = &d->splats;

    SPIN_TRY(read_frame(d, f, kept, &mark, &row));
    if (kept && !d->splats_4d)
        SPIN_TRY(merge_rows(d, f, false, d->filter->reason, &all));
    return spin_splats_select(all, mark, &d->part);
}

static spin_status read_all(void *context, int f, const struct spin_splats **out)
{
    struct spin_decimation *d = context;

    *out = &d->part;
    return read_part(d, f, false);
}

/* Places cameras around the subject if the clip has none. If no suitable position exists, no camera
 * is placed, and the loss is not measured. */
static spin_status place_cameras(struct spin_decimation *d)
{
    const struct spin_viewpoints_options o = {
        .n_cameras = AROUND, .width = SIDE, .height = SIDE, .fovy_deg = 53};
    spin_status status;

    if (d->n_pairs > 0 || d->placed.camera)
        return SPIN_OK;
    status = spin_viewpoints_open(&o, d->clip->n_frames, read_all, d, &d->placed);
    return status == SPIN_E_UNSUPPORTED ? SPIN_OK : status;
}

static spin_status draw(struct spin_decimation *d, int f, bool kept,
                        const struct spin_camera *camera, float *image)
{
    SPIN_TRY(read_part(d, f, kept));
    SPIN_TRY(spin_player_show_splats(&d->drawing, &d->part));
    return spin_player_draw(&d->drawing, camera, d->background, image);
}

/* Adds to *sum the squared error that the decimation causes in one view, and to *n the number of
 * values. A view that shows no splat is skipped. */
static spin_status add_picture(struct spin_decimation *d, int f, const struct spin_camera *camera,
                               double *sum, double *n, int *n_pictures)
{
    size_t pixels = (size_t)camera->width * (size_t)camera->height;
    SPIN_FREED float *image = NULL;
    bool blank = true;

    SPIN_TRY(spin_alloc(6 * pixels, sizeof *image, (void **)&image));
    SPIN_TRY(draw(d, f, false, camera, image));
    for (size_t i = 0; i < 3 * pixels && blank; i++)
        blank = image[i] == d->background[i / pixels];
    if (blank)
        return SPIN_OK;
    SPIN_TRY(draw(d, f, true, camera, image + 3 * pixels));
    for (size_t i = 0; i < 3 * pixels; i++) {
        double off =
            fmin(fmax((double)image[i], 0), 1) - fmin(fmax((double)image[3 * pixels + i], 0), 1);

        *sum += off * off;
    }
    *n += 3.0 * (double)pixels;
    ++*n_pictures;
    return SPIN_OK;
}

spin_status spin_decimation_measure(struct spin_decimation *d, struct spin_decimated *out)
{
    int n_frames = d->clip->n_frames;
    double sum = 0, n = 0;
    size_t n_pictures = d->n_pairs < PICTURES ? d->n_pairs : PICTURES;

    SPIN_TRY(place_cameras(d));
    n_pictures = d->n_pairs > 0 ? n_pictures : (size_t)d->placed.n;
    *out = (struct spin_decimated){.by_views = d->n_pairs > 0};
    /* If frames share their rows, but the filter may drop a row in some frames only, the splats are
     * counted in the whole clip instead of per frame. */
    out->in_all = d->splats_4d || (d->n_sets == 1 && d->filter->varies);
    for (int s = 0; s < d->n_sets; s++) {
        out->before += (double)d->set[s].n_counted;
        out->after += (double)d->set[s].n_kept;
    }
    out->before /= d->n_sets;
    out->after /= d->n_sets;
    for (size_t i = 0; i < d->merges.n; i++)
        out->merged += d->merges.pair[i][0] != SPIN_MERGE_NONE;
    for (size_t k = 0; k < n_pictures; k++) {
        size_t at = d->n_pairs * k / n_pictures;
        int f = d->n_pairs > 0 ? d->pairs[at].frame : (int)(k * (size_t)n_frames / n_pictures);
        const struct spin_camera *camera = d->n_pairs > 0
                                               ? &d->clip->views.view[d->pairs[at].view].camera
                                               : &d->placed.camera[k].camera;

        SPIN_TRY(add_picture(d, f, camera, &sum, &n, &out->n_pictures));
    }
    out->psnr = sum > 0 ? 10 * log10(n / sum) : HUGE_VAL;
    return SPIN_OK;
}

/* ---- The search for a given loss or size ----------------------------------------------------- */

spin_status spin_decimation_choose_loss(struct spin_decimation *d, double decibels)
{
    double low = 0, high = 1;
    struct spin_decimated found;

    for (int k = 0; k < HALVINGS; k++) {
        double middle = (low + high) / 2;

        SPIN_TRY(spin_decimation_choose(d, SPIN_DECIMATE_SHARE, middle));
        SPIN_TRY(spin_decimation_measure(d, &found));
        if (found.n_pictures == 0)
            return spin_unsupported("--decimate: no image shows a splat, so the loss cannot be "
                                    "measured: give a number or a share of splats instead");
        if (found.psnr >= decibels)
            high = middle;
        else
            low = middle;
    }
    return spin_decimation_choose(d, SPIN_DECIMATE_SHARE, high);
}

/* Keeps this share of the splats, writes the output to a temporary folder beside its final path,
 * removes that folder and sets *bytes to the size of the files in it. */
static spin_status try_share(struct spin_decimation *d, double share, const char *output,
                             spin_decimation_write_fn write, void *context, uint64_t *bytes)
{
    int level = spin_log_level();
    size_t n = strlen(output) - spin_text_ends(output, "/");
    char suffix[SPIN_OUT_SUFFIX];
    SPIN_FREED char *folder = NULL, *path = NULL;
    spin_status status;

    SPIN_TRY(spin_decimation_choose(d, SPIN_DECIMATE_SHARE, share));
    spin_out_suffix(suffix);
    SPIN_TRY(spin_alloc(n + sizeof suffix, 1, (void **)&folder));
    snprintf(folder, n + sizeof suffix, "%.*s%s", (int)n, output, suffix);
    SPIN_TRY(spin_path_join(folder, spin_path_name(output), &path));
    SPIN_TRY(spin_folder_make(folder));
    spin_log_set_level(-2); /* only the final write prints messages */
    status = write(context, path);
    spin_log_set_level(level);
    *bytes = spin_out_remove(folder);
    return status;
}

spin_status spin_decimation_choose_bytes(struct spin_decimation *d, double bytes,
                                         const char *output, spin_decimation_write_fn write,
                                         void *context, int *n_tries, uint64_t *reached)
{
    /* `low` is so small that one splat per frame is kept */
    double low = 1e-12, high = 1, n_low, n_high;
    uint64_t n;

    SPIN_TRY(try_share(d, high, output, write, context, reached));
    *n_tries = 1;
    n_high = (double)*reached;
    if (n_high <= bytes)
        return SPIN_OK;
    SPIN_TRY(try_share(d, low, output, write, context, &n));
    ++*n_tries;
    n_low = (double)n;
    if (n_low > bytes)
        return spin_unsupported("--decimate: the smallest possible output has %llu bytes, more "
                                "than %.0f: give a larger size",
                                (unsigned long long)n, bytes);
    while (*n_tries < TRIES && n_low < 0.98 * bytes) {
        double part = (0.995 * bytes - n_low) / (n_high - n_low);
        double share = low + (high - low) * fmin(fmax(part, 0.02), 0.98);

        SPIN_TRY(try_share(d, share, output, write, context, &n));
        ++*n_tries;
        if ((double)n <= bytes) {
            low = share;
            n_low = (double)n;
        } else {
            high = share;
            n_high = (double)n;
        }
    }
    *reached = (uint64_t)n_low;
    return spin_decimation_choose(d, SPIN_DECIMATE_SHARE, low);
}
