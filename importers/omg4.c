/* OMG4 (Optimized Minimal 4D Gaussian Splatting), a compressed Realtime-4DGS, and its variant with
 * velocities, OMG4-FTGS. The file is a pickle, compressed with xz.
 *
 * Shapes are Huffman-coded indices into codebooks. Four small networks compute opacity and colour
 * from position, time and six numbers per Gaussian, so each frame requires their evaluation for all
 * visible Gaussians. The 4D splats contain the opacity and colour that each Gaussian has at its own
 * time, the centre of its window. */
#include "importers/lib/file_sequence.h"
#include "importers/lib/gaussian4d.h"
#include "io/compress.h"
#include "math/motion.h"
#include "math/contract.h"
#include "math/ntc.h"

#define UNPACKED_LIMIT ((size_t)1 << 30)
#define LEAST_WEIGHT 0.05 /* the renderer omits Gaussians with a lower weight in time */
/* The renderer of OMG4-FTGS omits no Gaussians, but those with a lower weight are invisible. */
#define LEAST_WEIGHT_FTGS (1.0 / 255)
#define SPREAD 1.2 /* initial times cover a range this many times as long as the clip */

enum {
    OCTAVES = 16,
    HIDDEN = 64,
    N_FEATURES = 13,
    HEAD_IN = 16, /* features, and three of the appearance numbers */
    N_APP = 6     /* appearance numbers of a Gaussian */
};

enum { CONT, DC, OPACITY, SH, N_NETS };

/* Columns that the networks compute. */
#define LOOKS ((unsigned)(SPIN_COL_LOGIT_OPACITIES | SPIN_COL_SH))

static const struct {
    const char *key;
    int n_out; /* number of rows of the last matrix; a multiple of 16 */
    enum mlp_ending hidden;
} nets[N_NETS] = {{"MLP_cont", 16, MLP_RELU},
                  {"MLP_dc", 16, MLP_LEAKY},
                  {"MLP_opacity", 16, MLP_LEAKY},
                  {"MLP_sh", 144, MLP_LEAKY}};

struct model {
    struct spin_model base;
    struct spin_pickle pickle; /* contents of the file; valid only during open() */
    bool moving;               /* the file is of OMG4-FTGS, so there are velocities */
    struct clip_times times;
    size_t n;
    struct gaussian4d gaussians;
    size_t *kept, n_kept; /* rows of splats_4d for which the networks are evaluated */
    float *app;           /* [n][6] appearance numbers of the rows of the file */
    bool has_appearance;  /* opacities and colours of splats_4d have been computed */
    struct mlp_net net[N_NETS];
};

/* ---- Recognising ----------------------------------------------------------------------------- */

static int probe(const struct spin_peek *peek)
{
    size_t n_xz = 0;

    if (!peek->is_folder) {
        if (!spin_xz_detect(peek->head, peek->n_head))
            return 0;
        return strcmp(spin_path_name(peek->path), "comp.xz") == 0 ? 95 : 60;
    }
    for (size_t i = 0; peek->names && peek->names[i]; i++)
        n_xz += spin_file_has_suffix(peek->names[i], ".xz");
    return spin_peek_has(peek, "comp.xz") ? 95 : n_xz == 1 ? 50 : 0;
}

/* ---- Huffman codes --------------------------------------------------------------------------- */

/* Codes as pickled by the Python package dahuffman. They need not be canonical, so the tree is
 * built from the pickled table. */
struct huffman_node {
    uint32_t child[2]; /* indices of the children; 0: none */
    int64_t label;
};

struct huffman {
    struct huffman_node *node;
    size_t n, capacity;
};

#define MAX_CODE_BITS 63

/* Labels of inner nodes and of the end marker; all other leaves have labels >= 0. */
enum { INNER = -1, END = -2 };

static spin_status new_node(struct huffman *tree, uint32_t *out)
{
    if (tree->n > UINT32_MAX / 2)
        return spin_malformed("a Huffman table is too large");
    SPIN_TRY(spin_array_grow(tree->n, &tree->capacity, sizeof *tree->node, (void **)&tree->node));
    *out = (uint32_t)tree->n;
    tree->node[tree->n++] = (struct huffman_node){{0, 0}, INNER};
    return SPIN_OK;
}

static spin_status add_code(struct huffman *tree, int bits, uint64_t code, int64_t label)
{
    uint32_t at = 0;

    for (int b = bits - 1; b >= 0; b--) {
        int side = (int)(code >> b & 1);
        uint32_t next = tree->node[at].child[side];

        if (tree->node[at].label != INNER)
            return spin_malformed("a Huffman code is a prefix of another code");
        if (next == 0) {
            SPIN_TRY(new_node(tree, &next));
            tree->node[at].child[side] = next;
        }
        at = next;
    }
    if (tree->node[at].label != INNER || tree->node[at].child[0] || tree->node[at].child[1])
        return spin_malformed("two Huffman codes are equal, or one is a prefix of the other");
    tree->node[at].label = label;
    return SPIN_OK;
}

/* Builds a tree from the table {label: (bits, code), ..., end marker: (bits, code)}; *tree must be
 * zeroed. */
static spin_status huffman_build(const struct spin_value *table, struct huffman *tree)
{
    uint32_t root;

    if (!table || table->kind != SPIN_VALUE_DICT || table->n == 0)
        return spin_malformed("a Huffman table is empty or not a dict");
    SPIN_TRY(new_node(tree, &root));
    for (size_t i = 0; i < table->n; i++) {
        const struct spin_value *key = table->item[2 * i], *entry = table->item[2 * i + 1];
        const struct spin_value *bits = spin_value_at(entry, 0), *code = spin_value_at(entry, 1);
        double label = END;

        if (key->kind != SPIN_VALUE_OBJECT &&
            (!spin_value_number(key, &label) || !(label >= 0) || label > 1e9))
            return spin_malformed("a Huffman table has a label that is not a number");
        if (!bits || !code || bits->kind != SPIN_VALUE_INT || code->kind != SPIN_VALUE_INT ||
            bits->integer < 1 || bits->integer > MAX_CODE_BITS || code->integer < 0 ||
            code->integer >> bits->integer != 0)
            return spin_malformed(
                "a Huffman table has a code that is not a pair (bits, value) with at most %d bits",
                MAX_CODE_BITS);
        SPIN_TRY(add_code(tree, (int)bits->integer, (uint64_t)code->integer, (int64_t)label));
    }
    return SPIN_OK;
}

/* Decodes n labels, each of which must be below n_labels. The end marker may be missing or
 * truncated, so only the number of labels is checked. */
static spin_status huffman_read(const struct huffman *tree, const struct spin_value *bytes,
                                size_t n, uint64_t n_labels, uint32_t *out)
{
    uint32_t at = 0;
    size_t found = 0;

    for (size_t i = 0; i < 8 * bytes->n; i++) {
        int bit = (unsigned char)bytes->text[i / 8] >> (7 - i % 8) & 1;
        int64_t label;

        at = tree->node[at].child[bit];
        if (at == 0) {
            if (found == n) /* padding after the last label */
                return SPIN_OK;
            return spin_malformed("the bits after label %zu match no code of the Huffman table",
                                  found);
        }
        label = tree->node[at].label;
        if (label == INNER)
            continue;
        if (label == END)
            break;
        if ((uint64_t)label >= n_labels)
            return spin_malformed("label %lld is outside the codebook of %llu entries",
                                  (long long)label, (unsigned long long)n_labels);
        if (found == n)
            return spin_malformed("the index has more than %zu labels", n);
        out[found++] = (uint32_t)label;
        at = 0;
    }
    if (found != n)
        return spin_malformed("the index has %zu labels, expected %zu", found, n);
    return SPIN_OK;
}

/* ---- Arrays ---------------------------------------------------------------------------------- */

/* Returns the array of a numpy array or torch tensor of floating-point numbers; NULL for other
 * values, or if data are missing. */
static const struct spin_array *as_array(const struct spin_value *v)
{
    if (!v || v->kind != SPIN_VALUE_TENSOR || (v->tensor.kind != 'f' && v->tensor.kind != 'B') ||
        (v->tensor.count > 0 && !v->tensor.data) || v->tensor.count > v->tensor.storage_count)
        return NULL;
    return &v->tensor;
}

/* Reads an array [n][width], which is freed when open() returns; the first call sets m->n. */
static spin_status load_array(struct model *m, const char *key, size_t width, float **out)
{
    const struct spin_array *t = as_array(spin_value_get(m->pickle.root, key));

    if (!t || t->n_dims != 2 || t->shape[1] != width || (m->n && t->shape[0] != m->n))
        return spin_malformed(
            "'%s' is missing or is not an array [%s, %zu] of floating-point numbers", key,
            m->n ? "Gaussians" : "G", width);
    if (t->shape[0] == 0)
        return spin_malformed("the file contains 0 Gaussians");
    m->n = (size_t)t->shape[0];
    SPIN_TRY(spin_model_scratch(&m->base, m->n, width * sizeof **out, (void **)out));
    spin_array_to_f32(t, 0, t->count, *out);
    return SPIN_OK;
}

static const struct spin_value *get_list(struct model *m, const char *name, const char *what)
{
    char key[64];
    const struct spin_value *list;

    snprintf(key, sizeof key, "%s_%s", name, what);
    list = spin_value_get(m->pickle.root, key);
    return list && list->kind == SPIN_VALUE_LIST ? list : NULL;
}

/* Fills the columns of out [n][width] from column `at` on with entries of the codebook `code`. The
 * labels in `index`, Huffman-coded with `table`, are the indices of the entries for rows 0 to n
 * - 1. */
static spin_status read_part(struct model *m, const struct spin_value *code,
                             const struct spin_value *index, const struct spin_value *table,
                             size_t at, size_t width, float *out)
{
    const struct spin_array *book = as_array(code);
    size_t length = (size_t)book->shape[1];
    struct huffman tree = {0};
    float *values;
    uint32_t *labels;
    spin_status status;

    if (!index || index->kind != SPIN_VALUE_BYTES)
        return spin_malformed("the index is not of type bytes");
    SPIN_TRY(spin_model_scratch(&m->base, m->n, sizeof *labels, (void **)&labels));
    status = huffman_build(table, &tree);
    if (status == SPIN_OK)
        status = huffman_read(&tree, index, m->n, book->shape[0], labels);
    free(tree.node);
    SPIN_TRY(status);
    SPIN_TRY(spin_model_scratch(&m->base, (size_t)book->count, sizeof *values, (void **)&values));
    spin_array_to_f32(book, 0, book->count, values);
    for (size_t i = 0; i < m->n; i++)
        memcpy(out + i * width + at, values + labels[i] * length, length * sizeof *out);
    return SPIN_OK;
}

static spin_status read_parts(struct model *m, const char *name, size_t width, float *out)
{
    const struct spin_value *codes = get_list(m, name, "code");
    const struct spin_value *indices = get_list(m, name, "index");
    const struct spin_value *tables = get_list(m, name, "htable");
    size_t at = 0;

    if (!codes || !indices || !tables || indices->n != codes->n || tables->n != codes->n)
        return spin_malformed(
            "'%s_code', '%s_index' and '%s_htable' are not three lists of equal length", name, name,
            name);
    for (size_t i = 0; i < codes->n; i++) {
        const struct spin_array *book = as_array(spin_value_at(codes, i));

        if (!book || book->n_dims != 2 || book->shape[1] == 0 || book->shape[1] > width - at)
            return spin_malformed(
                "'%s_code' %zu is not a codebook, or is too wide for the %zu columns", name, i,
                width);
        SPIN_TRY_IN(read_part(m, spin_value_at(codes, i), spin_value_at(indices, i),
                              spin_value_at(tables, i), at, width, out),
                    "'%s' part %zu", name, i);
        at += (size_t)book->shape[1];
    }
    if (at != width)
        return spin_malformed("'%s_code' has %zu columns, expected %zu", name, at, width);
    return SPIN_OK;
}

/* Reads a quantised column, which is freed when open() returns. */
static spin_status load_coded(struct model *m, const char *name, size_t width, float **out)
{
    SPIN_TRY(spin_model_scratch(&m->base, m->n, width * sizeof **out, (void **)out));
    return read_parts(m, name, width, *out);
}

/* ---- Networks -------------------------------------------------------------------------------- */

/* Loads two consecutive matrices, [64][in] and [out][64], without biases, for evaluation in half
 * precision. */
static spin_status load_net(struct model *m, int net)
{
    const struct spin_array *t = as_array(spin_value_get(m->pickle.root, nets[net].key));
    int n_in = net == CONT ? 2 * OCTAVES * (m->moving ? 3 : 4) : HEAD_IN, n_out = nets[net].n_out;
    size_t first = (size_t)HIDDEN * (size_t)n_in, count = first + (size_t)HIDDEN * (size_t)n_out;
    float *weight;

    if (!t || t->n_dims != 1 || t->count != count)
        return spin_malformed("'%s' is missing or is not an array of %zu values", nets[net].key,
                              count);
    SPIN_TRY(spin_model_alloc(&m->base, count, sizeof *weight, (void **)&weight));
    spin_array_to_f32(t, 0, count, weight);
    if (spin_finite_missing(weight, count) > 0)
        return spin_malformed("'%s' has a weight that is not finite", nets[net].key);
    m->net[net] = (struct mlp_net){
        .n = 2,
        .half = true,
        .layer = {{n_in, HIDDEN, nets[net].hidden, weight, NULL},
                  {HIDDEN, n_out, MLP_PLAIN, weight + first, NULL}},
    };
    return SPIN_OK;
}

/* Writes sin and cos of 2^k pi x, k = 0..15. The angle is reduced in double, since it reaches 10^5
 * at k = 15. */
static void encode(float x, float *out)
{
    for (int k = 0; k < OCTAVES; k++) {
        double turns = (double)x * (1 << k);
        double angle = 3.141592653589793 * (turns - 2 * floor(0.5 * turns));

        out[(2 * k) * MLP_BLOCK] = spin_half((float)sin(angle));
        out[(2 * k + 1) * MLP_BLOCK] = spin_half((float)cos(angle));
    }
}

/* Offsets of the parts of a thread's scratch memory, in channels of MLP_BLOCK floats. */
enum {
    ENCODED = 0,
    INPUT = ENCODED + 8 * OCTAVES,
    HIDE = INPUT + HEAD_IN,
    FEATURES = HIDE + HIDDEN,
    RESULT = FEATURES + 16,
    N_CHANNELS = RESULT + 144
};

struct pass {
    struct model *m;
    double time;
    bool own; /* true: evaluate each Gaussian at its own time; false: all at `time` */
    unsigned columns;
    struct spin_splats *out;
};

static double time_of(const struct pass *p, size_t i)
{
    return p->own ? (double)p->m->base.splats_4d.times[i] : p->time;
}

/* Returns the contracted position that the networks receive: the position of the Gaussian at its
 * own time or, for OMG4-FTGS, at the time of evaluation. */
static spin_vec3 place_of(const struct pass *p, size_t i)
{
    const struct spin_splats_4d *s = &p->m->base.splats_4d;
    double place[3];
    float x[3];

    spin_path_at(s->centres + 3 * i, s->paths + 3 * i, p->m->moving ? 1 : 0,
                 time_of(p, i) - (double)s->times[i], place);
    for (size_t c = 0; c < 3; c++)
        x[c] = spin_contract_axis((float)place[c], 0, 1);
    return spin_v3(x[0], x[1], x[2]);
}

static void encode_block(const struct pass *p, size_t first, int n, float *encoded)
{
    const struct clip_times *t = &p->m->times;

    for (int b = 0; b < n; b++) {
        size_t i = p->m->kept[first + (size_t)b];
        spin_vec3 u = spin_contract(place_of(p, i));

        encode(u.x, encoded + b);
        encode(u.y, encoded + 2 * OCTAVES * MLP_BLOCK + b);
        encode(u.z, encoded + 4 * OCTAVES * MLP_BLOCK + b);
        if (!p->m->moving)
            encode((float)((time_of(p, i) - t->first) / (t->last - t->first)),
                   encoded + 6 * OCTAVES * MLP_BLOCK + b);
    }
}

/* Sets a network's inputs: the features, and the appearance numbers `from` to `from` + 2. */
static void fill_input(const struct pass *p, size_t first, int n, int from, const float *features,
                       float *in)
{
    const struct gaussian4d *g = &p->m->gaussians;

    memcpy(in, features, N_FEATURES * MLP_BLOCK * sizeof *in);
    for (int b = 0; b < n; b++) {
        const float *app = p->m->app + N_APP * g->row[p->m->kept[first + (size_t)b]] + from;

        for (int c = 0; c < 3; c++)
            in[(N_FEATURES + c) * MLP_BLOCK + b] = spin_half(app[c]);
    }
}

/* Copies a network's outputs for point b to the rows of sh [48][3] from `row` on. */
static void take_rows(const float *channel, int b, int row, int n_rows, float *sh)
{
    for (int i = 0; i < 3 * n_rows; i++)
        sh[3 * row + i] = channel[i * MLP_BLOCK + b];
}

static void run_colours(const struct pass *p, size_t first, int n, float *scratch)
{
    const struct model *m = p->m;
    float sh[MLP_BLOCK][144];
    float *in = scratch + INPUT * MLP_BLOCK, *hidden = scratch + HIDE * MLP_BLOCK;
    float *result = scratch + RESULT * MLP_BLOCK;

    spin_mlp_run(&m->net[DC], in, hidden, result);
    for (int b = 0; b < n; b++)
        take_rows(result, b, 0, 1, sh[b]);
    fill_input(p, first, n, 3, scratch + FEATURES * MLP_BLOCK, in);
    spin_mlp_run(&m->net[SH], in, hidden, result);
    for (int b = 0; b < n; b++) {
        size_t k = first + (size_t)b, i = m->kept[k];

        take_rows(result, b, 1, 47, sh[b]);
        /* The renderer of OMG4-FTGS uses the first 16 rows of SH only. */
        spin_sh_fold(m->moving ? 0 : 2, time_of(p, i) - (double)m->base.splats_4d.times[i],
                     m->times.last - m->times.first, sh[b], p->out->sh + 48 * k);
    }
}

static void run_block(void *context, size_t first, int n, float *scratch)
{
    const struct pass *p = context;
    const struct model *m = p->m;
    float *in = scratch + INPUT * MLP_BLOCK, *hidden = scratch + HIDE * MLP_BLOCK;
    float *result = scratch + RESULT * MLP_BLOCK;

    encode_block(p, first, n, scratch + ENCODED * MLP_BLOCK);
    spin_mlp_run(&m->net[CONT], scratch + ENCODED * MLP_BLOCK, hidden,
                 scratch + FEATURES * MLP_BLOCK);
    fill_input(p, first, n, 0, scratch + FEATURES * MLP_BLOCK, in);
    if (p->columns & SPIN_COL_LOGIT_OPACITIES) {
        spin_mlp_run(&m->net[OPACITY], in, hidden, result);
        for (int b = 0; b < n; b++) {
            size_t k = first + (size_t)b;

            p->out->logit_opacities[k] = spin_logit_of(
                spin_sigmoid_of(result[b]) *
                spin_splats_4d_weight(&m->base.splats_4d, m->kept[k], time_of(p, m->kept[k])));
        }
    }
    if (p->columns & SPIN_COL_SH)
        run_colours(p, first, n, scratch);
}

/* ---- Opening --------------------------------------------------------------------------------- */

struct columns {
    float *xyz, *t, *scale, *rotation, *right, *scale_t, *velocity;
};

static spin_status load_columns(struct model *m, struct columns *c)
{
    SPIN_TRY(load_array(m, m->moving ? "means" : "xyz", 3, &c->xyz));
    SPIN_TRY(load_array(m, m->moving ? "times" : "t", 1, &c->t));
    SPIN_TRY(load_coded(m, "scale", 3, &c->scale));
    SPIN_TRY(load_coded(m, "rotation", 4, &c->rotation));
    SPIN_TRY(spin_model_alloc(&m->base, m->n, N_APP * sizeof *m->app, (void **)&m->app));
    SPIN_TRY(read_parts(m, "app", N_APP, m->app));
    if (m->moving) {
        SPIN_TRY(load_coded(m, "durations", 1, &c->scale_t));
        return load_coded(m, "velocities", 3, &c->velocity);
    }
    SPIN_TRY(load_coded(m, "rotation_r", 4, &c->right));
    return load_coded(m, "scaling_t", 1, &c->scale_t);
}

static void add_row(struct model *m, const struct columns *c, size_t i)
{
    double quat[4], right[4], scale[4], velocity[3], a[16];
    spin_slice slice;

    for (size_t k = 0; k < N_APP; k++) {
        if (!isfinite(m->app[N_APP * i + k])) {
            m->gaussians.n_dropped++;
            return;
        }
    }
    if (m->moving) {
        spin_unit_quat(c->rotation + 4 * i, quat);
        for (size_t k = 0; k < 3; k++) {
            scale[k] = c->scale[3 * i + k];
            velocity[k] = c->velocity[3 * i + k];
        }
        spin_gaussian4d_add(&m->base, &m->gaussians, i, c->xyz + 3 * i, c->t[i], 0, velocity,
                            exp(2.0 * c->scale_t[i]), scale, quat);
        return;
    }
    for (size_t k = 0; k < 4; k++) {
        quat[k] = c->rotation[4 * i + k];
        right[k] = c->right[4 * i + k];
        scale[k] = exp(k < 3 ? c->scale[3 * i + k] : c->scale_t[i]);
    }
    spin_rotation4_of_pair(quat, right, 0, a);
    spin_slice_of(a, scale, &slice);
    spin_gaussian4d_add_slice(&m->base, &m->gaussians, i, c->xyz + 3 * i, c->t[i], 0, &slice, 0);
}

static spin_status find_times(struct model *m)
{
    struct spin_model *base = &m->base;
    const char *asked = spin_model_option(base, "time-duration");

    if (m->moving) /* the range of OMG4-FTGS is a constant in its code and affects no value */
        return spin_run_config_times(NULL, asked ? asked : "0,10", NULL, 0, 1, 1, &m->times);
    SPIN_TRY(spin_model_config(base));
    SPIN_TRY(spin_run_config_times(&base->settings, asked, base->splats_4d.times, m->gaussians.n, 1,
                                   SPREAD, &m->times));
    if (m->times.guessed)
        spin_note(
            base->sequence,
            "time_duration is not in the file: assumed %g,%g, from the Gaussians' own times; "
            "colours and opacities depend on this range: set it with --time-duration or --config",
            m->times.first, m->times.last);
    return SPIN_OK;
}

static spin_status find_file(struct spin_model *m, const char *path)
{
    char **names;
    const char *best = NULL;
    size_t n, n_xz = 0;

    if (!spin_path_is_folder(path))
        return spin_model_text(m, &m->path, "%s", path);
    SPIN_TRY(spin_model_names(m, path, &names, &n));
    for (size_t i = 0; i < n; i++) {
        bool is_comp = strcmp(names[i], "comp.xz") == 0;

        if (!spin_file_has_suffix(names[i], ".xz") || (best && strcmp(best, "comp.xz") == 0))
            continue;
        best = names[i];
        n_xz = is_comp ? 1 : n_xz + 1;
    }
    if (n_xz == 1)
        return spin_model_join(m, &m->path, path, "%s", best);
    return spin_not_found("'%s' contains %s", path,
                          n_xz ? "several *.xz, but no comp.xz: give one of the files"
                               : "no comp.xz");
}

static spin_status parse_pickle(struct model *m)
{
    SPIN_FREED unsigned char *bytes = NULL;
    size_t n = 0;

    SPIN_TRY(spin_xz_load(m->base.path, UNPACKED_LIMIT, &bytes, &n));
    return spin_pickle_parse(m->base.path, bytes, n, &m->pickle);
}

static spin_status read_pickle(struct model *m)
{
    struct columns c = {0};

    m->moving = spin_value_get(m->pickle.root, "means") != NULL;
    if (!m->moving && !spin_value_get(m->pickle.root, "xyz"))
        return spin_malformed("the pickle is not a dict with 'xyz' or 'means'");
    SPIN_TRY(load_columns(m, &c));
    for (int net = 0; net < N_NETS; net++)
        SPIN_TRY(load_net(m, net));
    SPIN_TRY(spin_gaussian4d_reserve(&m->base, &m->gaussians, m->n, 3, 0));
    for (size_t i = 0; i < m->n; i++)
        add_row(m, &c, i);
    SPIN_TRY(spin_gaussian4d_check(&m->gaussians, m->n, 0, "values that are not finite",
                                   m->base.sequence));
    return SPIN_OK;
}

static spin_status open_model(void *self, const char *path)
{
    struct model *m = self;
    spin_status status;

    SPIN_TRY(find_file(&m->base, path));
    status = parse_pickle(m);
    if (status == SPIN_OK) {
        status = read_pickle(m);
        spin_pickle_free(&m->pickle);
    }
    SPIN_TRY(spin_fail_reading(status, m->base.path));
    SPIN_TRY(find_times(m));
    m->base.splats_4d.least_weight = m->moving ? LEAST_WEIGHT_FTGS : LEAST_WEIGHT;
    SPIN_TRY(spin_gaussian4d_finish(&m->base, &m->gaussians, 1, &m->times));
    SPIN_TRY(spin_model_alloc(&m->base, m->gaussians.n, sizeof *m->kept, (void **)&m->kept));
    snprintf(m->base.sequence->variant, sizeof m->base.sequence->variant, "%s, %zu Gaussians",
             m->moving ? "OMG4-FTGS" : "OMG4", m->n);
    spin_note(m->base.sequence,
              "opacity and colour depend on position and time: 4D splats store the values at each "
              "Gaussian's own time; use --frames or --times for exact values");
    return SPIN_OK;
}

/* ---- The splats at one time ------------------------------------------------------------------ */

static spin_status run_networks(struct pass *p)
{
    struct model *m = p->m;

    if (!m->base.team.scratch) /* the first call starts the threads */
        SPIN_TRY(spin_mlp_team_create(N_CHANNELS * MLP_BLOCK, &m->base.team));
    spin_mlp_team_run(&m->base.team, m->n_kept, run_block, p);
    return SPIN_OK;
}

static spin_status fill_appearance(struct model *m, struct spin_splats *own)
{
    struct spin_splats_4d *s = &m->base.splats_4d;
    struct pass pass = {m, 0, true, LOOKS, own};

    SPIN_TRY(spin_splats_reserve(own, s->n, LOOKS, 3));
    for (m->n_kept = 0; m->n_kept < s->n; m->n_kept++)
        m->kept[m->n_kept] = m->n_kept;
    SPIN_TRY(run_networks(&pass));
    SPIN_TRY(spin_model_check(m->base.path, m->times.first, LOOKS, own));
    memcpy(s->logit_opacities, own->logit_opacities, s->n * sizeof *own->logit_opacities);
    memcpy(s->sh, own->sh, 48 * s->n * sizeof *own->sh);
    m->has_appearance = true;
    return SPIN_OK;
}

static spin_status omg4_splats_4d(void *self, const struct spin_splats_4d **out)
{
    struct model *m = self;
    struct spin_splats own = {0};
    spin_status status = m->has_appearance ? SPIN_OK : fill_appearance(m, &own);

    spin_splats_free(&own);
    *out = &m->base.splats_4d;
    return status;
}

static spin_status omg4_frame(void *self, int frame, double time, unsigned columns,
                              struct spin_splats *out)
{
    struct model *m = self;
    struct pass pass = {m, time, false, columns, out};

    SPIN_TRY(spin_model_slice(self, frame, time, columns, out));
    if (!(columns & LOOKS))
        return SPIN_OK;
    m->n_kept = 0;
    for (size_t i = 0; i < m->base.splats_4d.n; i++)
        if (spin_splats_4d_is_visible(&m->base.splats_4d, i, time))
            m->kept[m->n_kept++] = i;
    return run_networks(&pass);
}

static const struct spin_plugin_option options[] = {
    {"time-duration", "A,B", "the clip's first and last time, as in the training YAML", NULL},
    {"config", "FILE", "the training YAML (default: the one beside the file)", NULL},
    {NULL, NULL, NULL, NULL},
};

SPIN_MODEL_IMPORTER(omg4, struct model, open_model, spin_model_close,
                    .summary = "OMG4 and OMG4-FTGS: comp.xz, or its folder",
                    .upstream = "MinShirley/OMG4 58bd7ed", .options = options, .probe = probe,
                    .frame = omg4_frame, .splats_4d = omg4_splats_4d)
