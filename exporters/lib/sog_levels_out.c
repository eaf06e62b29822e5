#include "exporters/lib/sog_levels_out.h"

#include "base/base.h"
#include "geometry/merge_splats.h"
#include "geometry/neighbours.h"
#include "io/file.h"
#include "io/json.h"
#include "math/covariance.h"

enum {
    LEAF = 16384,   /* number of splats of level 0 in a leaf of the tree, at most */
    CHUNK = 131072, /* number of splats in a chunk, at most, unless a single leaf has more */
    RATIO = 4,      /* each level has 1/RATIO of the splats of the level before it */
};
#define COLUMNS (SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES)

struct leaf {
    size_t first, n; /* its range in the k-d tree's order */
    struct spin_splats level[SPIN_SOG_MOST_LEVELS];
    double error[SPIN_SOG_MOST_LEVELS]; /* accumulated cost of merging */
    double box[6];                      /* minimum x y z, maximum x y z */
    spin_json *lods;
    spin_status status;
    char why[256];
};

struct writing {
    struct spin_sog_levels_out *x;
    const struct spin_splats *splats;
    struct spin_kd_tree tree;
    struct leaf *leaf;
    size_t n_leaves, room;
    struct spin_sog_images images;
    struct spin_splat_rows rows;
    struct spin_sort_rows order;
    spin_json *filenames;
};

/* ---- Leaves ---------------------------------------------------------------------------------- */

/* Splits the tree's range [first, hi), whose node is [lo, hi), into leaves. */
static spin_status split(struct writing *w, size_t first, size_t lo, size_t hi)
{
    size_t middle = lo + (hi - lo) / 2;

    if (hi - first > LEAF) {
        SPIN_TRY(split(w, first, lo, middle));
        return split(w, middle, middle + 1, hi);
    }
    SPIN_TRY(spin_array_grow(w->n_leaves, &w->room, sizeof *w->leaf, (void **)&w->leaf));
    w->leaf[w->n_leaves++] = (struct leaf){.first = first, .n = hi - first};
    return SPIN_OK;
}

static void copy_row(const struct spin_splats *from, size_t i, struct spin_splats *to, size_t k)
{
    size_t n_sh = 3 * (size_t)spin_sh_count(to->sh_degree);

    memcpy(to->means + 3 * k, from->means + 3 * i, 3 * sizeof *to->means);
    memcpy(to->quats + 4 * k, from->quats + 4 * i, 4 * sizeof *to->quats);
    memcpy(to->log_scales + 3 * k, from->log_scales + 3 * i, 3 * sizeof *to->log_scales);
    to->logit_opacities[k] = from->logit_opacities[i];
    memcpy(to->sh + n_sh * k, from->sh + n_sh * i, n_sh * sizeof *to->sh);
}

/* Extends the box by the ellipsoids of one standard deviation. */
static void widen(double box[6], const struct spin_splats *s)
{
    static const int diagonal[3] = {0, 3, 5};

    for (size_t i = 0; i < s->n; i++) {
        double scale[3], quat[4], cov[6];

        for (size_t c = 0; c < 3; c++)
            scale[c] = exp((double)s->log_scales[3 * i + c]);
        for (size_t c = 0; c < 4; c++)
            quat[c] = (double)s->quats[4 * i + c];
        spin_covariance_of(scale, quat, cov);
        for (size_t c = 0; c < 3; c++) {
            double at = (double)s->means[3 * i + c], half = sqrt(cov[diagonal[c]]);

            box[c] = fmin(box[c], at - half);
            box[3 + c] = fmax(box[3 + c], at + half);
        }
    }
}

static spin_status make_levels(struct writing *w, struct leaf *l)
{
    SPIN_TRY(spin_splats_gather(w->splats, w->tree.order + l->first, l->n, &l->level[0]));
    for (int c = 0; c < 6; c++)
        l->box[c] = c < 3 ? HUGE_VAL : -HUGE_VAL;
    widen(l->box, &l->level[0]);
    for (int k = 1; k < w->x->n_levels; k++) {
        l->error[k] = l->error[k - 1];
        SPIN_TRY(spin_merge_splats(&l->level[k - 1], (l->level[k - 1].n + RATIO - 1) / RATIO,
                                   &l->level[k], &l->error[k]));
        widen(l->box, &l->level[k]);
    }
    return SPIN_OK;
}

static void leaf_task(void *context, int task)
{
    struct writing *w = context;
    struct leaf *l = &w->leaf[task];

    l->status = spin_cancelled() ? spin_fail_cancelled() : make_levels(w, l);
    if (l->status != SPIN_OK)
        snprintf(l->why, sizeof l->why, "%s", spin_last_error());
}

static spin_status make_leaves(struct writing *w)
{
    SPIN_TRY(spin_kd_tree_open(&w->tree, w->splats->n, w->splats->means));
    SPIN_TRY(split(w, 0, 0, w->splats->n));
    spin_pool_run(w->x->pool, (int)w->n_leaves, leaf_task, w);
    for (size_t i = 0; i < w->n_leaves; i++) {
        if (w->leaf[i].status != SPIN_OK)
            return spin_fail(w->leaf[i].status, "%s", w->leaf[i].why);
    }
    return SPIN_OK;
}

/* ---- Chunks ---------------------------------------------------------------------------------- */

/* Appends the splats of a leaf in Morton order to `to`, from row `at` on. */
static spin_status append(struct writing *w, const struct spin_splats *from, struct spin_splats *to,
                          size_t at)
{
    SPIN_TRY(spin_splat_rows_choose(&w->rows, from));
    SPIN_TRY(spin_sort_rows_fill(&w->order, &w->rows));
    spin_sort_rows_by_place(&w->order, from);
    for (size_t i = 0; i < from->n; i++)
        copy_row(from, w->order.item[i].row, to, at + i);
    return SPIN_OK;
}

static spin_status write_chunk(struct writing *w, int level, size_t index,
                               const struct spin_splats *s)
{
    struct spin_sog_levels_out *x = w->x;
    SPIN_FREED struct spin_quant_error *quant = NULL;
    SPIN_FREED char *folder = NULL;
    char name[48];
    uint64_t bytes;

    snprintf(name, sizeof name, "%d_%zu", level, index);
    SPIN_TRY(spin_path_join(x->output->path, name, &folder));
    SPIN_TRY(spin_folder_make(folder));
    spin_output_folder_mark(x->output, folder);
    SPIN_TRY(spin_splat_rows_choose(&w->rows, s));
    SPIN_TRY(spin_sort_rows_fill(&w->order, &w->rows));
    SPIN_TRY(spin_alloc(spin_splat_rows_blocks(&w->rows) + 1, sizeof *quant, (void **)&quant));
    w->images.begun = false; /* chunks do not share codebooks */
    SPIN_TRY(spin_sog_images_encode(&w->images, &w->rows, x->antialias, w->order.item, quant));
    SPIN_TRY(spin_sog_images_write_folder(&w->images, folder, x->sync, &bytes));
    x->bytes += bytes;
    for (size_t b = 0; level == 0 && b < spin_splat_rows_blocks(&w->rows); b++)
        spin_quant_error_merge(&x->quant, &quant[b]);
    snprintf(name, sizeof name, "%d_%zu/meta.json", level, index);
    spin_json_push_string(w->filenames, name);
    x->n_chunks++;
    return SPIN_OK;
}

/* Writes the leaves from `first` on to one chunk, as many as fit, and sets *end to the leaf after
 * them. */
static spin_status write_leaves(struct writing *w, int level, size_t index, size_t first,
                                size_t *end)
{
    SPIN_LEAVES(spin_splats_free) struct spin_splats s = {0};
    size_t n = 0, at = 0;

    for (*end = first; *end < w->n_leaves; ++*end) {
        if (*end > first && n + w->leaf[*end].level[level].n > CHUNK)
            break;
        n += w->leaf[*end].level[level].n;
    }
    SPIN_TRY(spin_splats_reserve(&s, n, COLUMNS, w->splats->sh_degree));
    for (size_t i = first; i < *end; i++) {
        struct leaf *l = &w->leaf[i];
        char key[16];

        SPIN_TRY(append(w, &l->level[level], &s, at));
        snprintf(key, sizeof key, "%d", level);
        spin_json_set(l->lods, key,
                      json_pack("{s:I, s:I, s:I}", "file", (json_int_t)w->x->n_chunks, "offset",
                                (json_int_t)at, "count", (json_int_t)l->level[level].n));
        at += l->level[level].n;
        w->x->counts[level] += l->level[level].n;
        spin_splats_free(&l->level[level]);
    }
    return write_chunk(w, level, index, &s);
}

/* Removes the folders of chunks of this level from number `index` on. */
static spin_status remove_former(const struct spin_sog_levels_out *x, int level, size_t index)
{
    for (;; index++) {
        SPIN_FREED char *folder = NULL, *meta = NULL;
        char name[48];

        snprintf(name, sizeof name, "%d_%zu", level, index);
        SPIN_TRY(spin_path_join(x->output->path, name, &folder));
        SPIN_TRY(spin_path_join(folder, "meta.json", &meta));
        if (!spin_path_exists(meta))
            return SPIN_OK;
        (void)spin_out_remove(folder);
    }
}

static spin_status write_chunks(struct writing *w)
{
    for (int level = 0; level < SPIN_SOG_MOST_LEVELS; level++) {
        size_t index = 0;

        for (size_t i = 0; level < w->x->n_levels && i < w->n_leaves; index++) {
            if (spin_cancelled())
                return spin_fail_cancelled();
            SPIN_TRY(write_leaves(w, level, index, i, &i));
        }
        SPIN_TRY(remove_former(w->x, level, index));
    }
    return SPIN_OK;
}

/* ---- The index ------------------------------------------------------------------------------- */

/* Rounds to seven significant digits, as the specification demands. */
static spin_json *number_of(double v)
{
    char text[32];

    snprintf(text, sizeof text, "%.7g", v);
    return json_real(strtod(text, NULL));
}

static spin_json *triple(const double v[3])
{
    spin_json *list = spin_json_array();

    for (int c = 0; c < 3; c++)
        json_array_append_new(list, number_of(v[c]));
    return list;
}

/* Returns the node of the leaves [first, end), and sets box to its bounding box. The leaves are
 * divided as split() did it. */
static spin_json *node_of(struct writing *w, size_t first, size_t lo, size_t hi, size_t *leaf,
                          double box[6])
{
    spin_json *node = spin_json_object(), *bound = spin_json_object(), *children;
    size_t middle = lo + (hi - lo) / 2;
    double right[6];

    spin_json_set(node, "bound", bound);
    if (hi - first <= LEAF) {
        struct leaf *l = &w->leaf[(*leaf)++];
        spin_json *errors = spin_json_array();

        memcpy(box, l->box, sizeof l->box);
        spin_json_set(node, "lods", json_incref(l->lods));
        for (int k = 0; k < w->x->n_levels; k++)
            json_array_append_new(errors, number_of(l->error[k]));
        spin_json_set(node, "errors", errors);
    } else {
        children = spin_json_array();
        spin_json_push(children, node_of(w, first, lo, middle, leaf, box));
        spin_json_push(children, node_of(w, middle, middle + 1, hi, leaf, right));
        for (int c = 0; c < 3; c++) {
            box[c] = fmin(box[c], right[c]);
            box[3 + c] = fmax(box[3 + c], right[3 + c]);
        }
        spin_json_set(node, "children", children);
    }
    spin_json_set(bound, "min", triple(box));
    spin_json_set(bound, "max", triple(box + 3));
    return node;
}

static spin_status make_index(struct writing *w)
{
    struct spin_sog_levels_out *x = w->x;
    SPIN_LEAVES(spin_json_freed) spin_json *root = spin_json_object();
    spin_json *counts = spin_json_array();
    int64_t n = 0;
    size_t leaf = 0;
    double box[6];

    for (int k = 0; k < x->n_levels; k++) {
        spin_json_push(counts, json_integer((json_int_t)x->counts[k]));
        n += (int64_t)x->counts[k];
    }
    spin_json_set_integer(root, "version", 1);
    spin_json_set(root, "asset", json_pack("{s:s}", "generator", "spin4d " SPIN_VERSION));
    spin_json_set_integer(root, "count", n);
    spin_json_set(root, "counts", counts);
    spin_json_set_integer(root, "lodLevels", x->n_levels);
    spin_json_set_bool(root, "lodErrors", true);
    spin_json_set(root, "filenames", json_incref(w->filenames));
    spin_json_set(root, "tree", node_of(w, 0, 0, w->splats->n, &leaf, box));
    x->index = spin_json_text(root, false);
    return x->index ? SPIN_OK
                    : spin_fail(SPIN_E_MEMORY, "not enough memory for '" SPIN_SOG_INDEX "'");
}

/* Removes the index of a former export, since the chunks that it lists are about to be replaced. */
static spin_status remove_index(const struct spin_sog_levels_out *x)
{
    SPIN_FREED char *path = NULL;

    SPIN_TRY(spin_path_join(x->output->path, SPIN_SOG_INDEX, &path));
    if (spin_path_exists(path))
        (void)spin_out_remove(path);
    return SPIN_OK;
}

spin_status spin_sog_levels_write(struct spin_sog_levels_out *x, const struct spin_splats *splats)
{
    struct writing w = {.x = x, .splats = splats, .images.level = x->effort};
    spin_status status = SPIN_OK;
    bool replacing = false; /* true: chunks of a former export may be lost */

    w.rows.pool = x->pool;
    w.rows.turn.kind = SPIN_TURN_NONE;
    w.rows.sh_degree = splats->sh_degree;
    w.filenames = spin_json_array();
    SPIN_TRY_OUT(make_leaves(&w));
    for (size_t i = 0; i < w.n_leaves; i++)
        w.leaf[i].lods = spin_json_object();
    SPIN_TRY_OUT(remove_index(x));
    replacing = true;
    SPIN_TRY_OUT(write_chunks(&w));
    SPIN_TRY_OUT(make_index(&w));
out:
    for (int level = 0; level < SPIN_SOG_MOST_LEVELS && replacing && status != SPIN_OK; level++)
        (void)remove_former(x, level, 0);
    for (size_t i = 0; i < w.n_leaves; i++) {
        json_decref(w.leaf[i].lods);
        for (int k = 0; k < SPIN_SOG_MOST_LEVELS; k++)
            spin_splats_free(&w.leaf[i].level[k]);
    }
    json_decref(w.filenames);
    free(w.leaf);
    spin_kd_tree_close(&w.tree);
    spin_sog_images_free(&w.images);
    spin_sort_rows_free(&w.order);
    free(w.rows.keep);
    free(w.rows.block);
    return status;
}

void spin_sog_levels_out_free(struct spin_sog_levels_out *x)
{
    free(x->index);
    x->index = NULL;
}
