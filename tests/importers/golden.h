/* The meaning of a fixture's expected.npz: a table of methods with their arrays and the rows
 * that are visible. Tolerances are in the manifest. */
#ifndef SPIN_TESTS_IMPORTERS_GOLDEN_H
#define SPIN_TESTS_IMPORTERS_GOLDEN_H

#include <glob.h>

#include "math/sh.h"
#include "tests/importers/models.h"
#include "tests/importers/slices.h"

enum golden_kind {
    MEANS,
    QUATS, /* of either sign */
    SIGNED_QUATS,
    SCALES,
    LOG_SCALES,
    OPACITIES,
    LOGITS,
    SH,
    SH_CHANNELS, /* the same channel by channel, without degree 0 */
    SH_REST,     /* without degree 0; what the array does not have is 0 */
    BASE,        /* 0.5 + C0 of degree 0 */
    SEEN,        /* colours from `campos` */
    COV6,
};

/* An array is [T][N][width], [1][N][width] or [N][width]. */
struct golden_array {
    const char *key; /* '?': where there is one */
    enum golden_kind kind;
    const char *bound; /* in the manifest's tolerances; NULL: the key */
    double abs, rel;   /* where the manifest does not tell */
    const char *at;    /* array of the times that its blocks are of */
    size_t width;      /* of a row; 0: all */
    const char *rows;  /* "moving": not those that are static; else the array has the rows that this
                          one marks */
};

struct golden {
    const char *method, *fixtures, *path; /* below a fixture; '*': the largest number */
    const struct golden_array *array;
    const char *options[4];
    struct {
        const char *key;
        double above;
    } seen[2];
    const char *unless, *expected; /* not for an expected.npz with this key; NULL: expected.npz */
    unsigned still;
    double last;               /* times are from 0 to this; 0: not looked at */
    bool frames;               /* the times are numbers of frames, or an array `frames` has these */
    const char *said, *unsaid; /* in the notes or in the variant */
    const char *also[3];       /* paths that are the same run */
};

#define NOWHERE ((size_t)-1)
#define SETTLED (SPIN_COL_LOGIT_OPACITIES | SPIN_COL_SH)
#define ANY_STILL (~0u)

#define A(key_, kind_, ...)                                                                        \
    {                                                                                              \
        .key = (key_), .kind = (kind_), __VA_ARGS__                                                \
    }
#define ARRAYS(name, ...)                                                                          \
    static const struct golden_array golden_##name[] = {__VA_ARGS__, {.key = NULL}}

ARRAYS(deformed, A("xyz", MEANS), A("cov6", COV6),
       A("opacity", OPACITIES, .abs = 2e-6, .rel = 2e-5), A("sh", SH, .abs = 2e-6, .rel = 2e-5));
ARRAYS(hashed, A("xyz", MEANS), A("cov6", COV6), A("opacity", OPACITIES, .abs = 1e-6),
       A("sh", SH, .abs = 1e-6));
ARRAYS(unbounded, A("xyz", MEANS), A("rot", SIGNED_QUATS), A("scale_raw", LOG_SCALES),
       A("opacity", OPACITIES), A("sh", SH));
ARRAYS(features, A("xyz", MEANS), A("rot", QUATS), A("scale", SCALES), A("opacity", OPACITIES),
       A("cov6", COV6), A("?rgb_albedo", BASE), A("?rgb", BASE, .bound = "", .abs = 1e-5));
ARRAYS(rotor, A("mean", MEANS), A("cov6", COV6), A("opacity", OPACITIES),
       A("raw_features_dc", SH, .bound = "raw", .width = 3),
       A("rgb_dir_from_sliced_mean", SEEN, .bound = "rgb"));
ARRAYS(rotated, A("mean", MEANS), A("cov6", COV6), A("opacity", OPACITIES),
       A("sh_folded", SH, .at = "sh_folded_time_index"),
       A("rgb_dir_from_sliced_mean", SEEN, .bound = "rgb"));
ARRAYS(lines, A("mean", MEANS));
ARRAYS(plain, A("raw_xyz", MEANS, .bound = "raw"), A("raw_scaling", LOG_SCALES, .bound = "raw"),
       A("raw_rotation", QUATS, .bound = "", .abs = 1e-6),
       A("raw_opacity", LOGITS, .bound = "", .abs = 1e-4),
       A("raw_features_dc", SH, .bound = "raw", .width = 3));
ARRAYS(hybrid, A("xyz", MEANS), A("cov6", COV6), A("opacity", OPACITIES), A("sh", SH),
       A("?static_rot", QUATS, .rows = "is_static"),
       A("?static_scale", SCALES, .rows = "is_static"));
ARRAYS(comp, A("mean", MEANS), A("cov6", COV6), A("opacity", OPACITIES),
       A("sh_folded", SH, .at = "sh_time_index"));
ARRAYS(ftgs, A("mean", MEANS), A("raw_scale", LOG_SCALES, .bound = "", .abs = 1e-5),
       A("raw_rotation", QUATS, .bound = "", .abs = 1e-5), A("opacity", OPACITIES),
       A("sh48", SH, .at = "sh_time_index", .width = 48)); /* as its renderer does */
ARRAYS(centres, A("centre", MEANS));
ARRAYS(keyed, A("xyz", MEANS), A("?cov6", COV6), A("?opacity", OPACITIES), A("?sh", SH),
       A("?rot", QUATS, .rows = "moving"), A("?scale", SCALES, .rows = "moving"));
ARRAYS(free, A("xyz", MEANS), A("opacity", OPACITIES, .bound = "opacity, temporal"),
       A("cov6", COV6), A("rot", QUATS), A("scale", SCALES, .bound = "others"),
       A("f_dc", SH, .bound = "others", .width = 3), A("?f_rest", SH_CHANNELS, .bound = "others"));
ARRAYS(line, A("xyz", MEANS), A("opacity", OPACITIES), A("cov6", COV6),
       A("rot", QUATS, .bound = "others"), A("scale", SCALES, .bound = "others"),
       A("f_dc", SH, .bound = "others", .width = 3), A("?f_rest", SH_CHANNELS, .bound = "others"));
ARRAYS(nodes, A("xyz", MEANS), A("rot", QUATS), A("cov6", COV6), A("opacity", OPACITIES),
       A("f_dc", SH, .bound = "", .abs = 2e-5, .width = 3));
ARRAYS(rigid, A("xyz", MEANS), A("rot", QUATS), A("cov6", COV6),
       A("scale", SCALES, .bound = "others"), A("opacity", OPACITIES, .bound = "opacity, rgb"),
       A("rgb", BASE, .bound = "opacity, rgb"));
ARRAYS(states, A("xyz", MEANS), A("opacity", OPACITIES, .bound = "", .abs = 1e-5),
       A("cov6", COV6, .bound = "", .abs = 1e-6), A("?rgb", BASE, .bound = "", .abs = 1e-5));
ARRAYS(spawned, A("xyz", MEANS), A("rot", QUATS), A("scale", SCALES, .bound = "", .rel = 1e-4),
       A("cov6", COV6, .bound = "scale, cov6"), A("opacity", OPACITIES, .bound = "opacity, rgb"),
       A("rgb", BASE, .bound = "opacity, rgb"));
ARRAYS(particles, A("xyz", MEANS, .bound = "all", .abs = 1e-7),
       A("rot", QUATS, .bound = "all", .abs = 2e-7),
       A("scale", SCALES, .bound = "all", .abs = 1e-9, .rel = 1e-6),
       A("opacity", OPACITIES, .bound = "all", .abs = 2e-7),
       A("cov6", COV6, .bound = "all", .abs = 1e-7),
       A("f_dc", SH, .bound = "all", .abs = 1e-7, .width = 3),
       A("?f_rest", SH_CHANNELS, .bound = "all", .abs = 1e-7));
ARRAYS(parts, A("xyz", MEANS), A("rot", QUATS), A("cov6", COV6),
       A("opacity", OPACITIES, .bound = "opacity, rgb"), A("rgb", BASE, .bound = "opacity, rgb"));
ARRAYS(cloud, A("means", MEANS), A("quats_wxyz", QUATS), A("scales", SCALES),
       A("opacities", OPACITIES), A("sh_dc", SH));

#define G(method_, fixtures_, path_, array_, still_, ...)                                          \
    {                                                                                              \
        .method = (method_), .fixtures = (fixtures_), .path = (path_), .array = golden_##array_,   \
        .still = (still_), __VA_ARGS__                                                             \
    }

#define TC3DGS(expected_, ...)                                                                     \
    G("tc3dgs", "tc3dgs", "params.npz", cloud, ANY_STILL, .expected = (expected_),                 \
      .seen = {{"?visible", 0}}, .also = {""}, .options = {__VA_ARGS__})

static const struct golden goldens[] = {
    G("deformable3dgs", "deformable3dgs", "model", deformed, SETTLED, .last = 1,
      .said = "Deformable 3D Gaussians,", .also = {"model/deform/*/deform.pth"}),
    G("deformable3dgs", "motiongs", "model", deformed, SETTLED, .said = "MotionGS,",
      .also = {"model/deform/*/deform.pth"}),
    G("grid4d", "grid4d", "model", hashed, SETTLED, .last = 1,
      .also = {"model/deform/*/deform.pth"}),
    G("dash", "dash", "model", hashed, SETTLED, .last = 1, .also = {"model/deform/*/deform.pth"}),
    G("ed3dgs", "ed3dgs", "model", unbounded, ANY_STILL,
      .also = {"model/point_cloud/*", "model/point_cloud/*/deformation.pth"}),
    G("4dgaussian", "4dgaussian", "model", unbounded, ANY_STILL, .last = 1,
      .also = {"model/point_cloud/*", "model/point_cloud/*/deformation.pth"}),
    G("spacetimegs", "spacetimegs", "model", features, SPIN_COL_LOG_SCALES | SPIN_COL_SH,
      .options = {"colour", "base"},
      .also = {"model/point_cloud/*", "model/point_cloud/*/point_cloud.ply",
               "?model/point_cloud/*/point_cloud.pt"}),
    G("rotor4dgs", "rotor4dgs", "", rotor, ANY_STILL, .options = {"cull", "none"},
      .seen = {{"mask", 0}}, .said = "own times", .unsaid = "moves"),
    G("rotor4dgs", "rotor4dgs", "", rotor, ANY_STILL, .options = {"cull", "opacity"},
      .seen = {{"mask", 0}, {"opacity", 1.0 / 255}}),
    G("rotor4dgs", "rotor4dgs", "", rotor, ANY_STILL, .options = {"cull", "time"},
      .seen = {{"mask", 0}, {"marginal", 0.05}}),
    G("realtime4dgs", "realtime4dgs", "", rotated, ANY_STILL, .seen = {{"mask", 0}},
      .unsaid = "time_duration is not"),
    G("realtime4dgs", "realtime4dgs", "", lines, ANY_STILL, .options = {"cull", "none"}),
    G("realtime4dgs", "realtime4dgs", "", plain, ANY_STILL, .unless = "mean"),
    G("hybrid4dgs", "hybrid4dgs", "model", hybrid, ANY_STILL,
      .options = {"config", "train_config.yaml"}, .seen = {{"valid", 0}, {"mask", 0}},
      .unsaid = "own times"),
    G("omg4", "omg4", "", comp, ANY_STILL, .options = {"time-duration", "0,10"},
      .seen = {{"mask", 0}}, .unless = "raw_means", .unsaid = "FTGS"),
    G("omg4", "omg4", "", ftgs, ANY_STILL, .options = {"time-duration", "0,10"},
      .seen = {{"marginal", 1.0 / 255}}, .unless = "mask", .said = "FTGS"),
    G("modecgs", "modecgs", "model", centres, ANY_STILL, .said = "positions only",
      .also = {"model/point_cloud/*"}),
    G("modecgs", "modecgs", "model", centres, ANY_STILL, .options = {"camera", "0.3,-2.5,0.8"},
      .seen = {{"keep", 0}}),
    G("ex4dgs", "ex4dgs", "model", keyed, SPIN_COL_LOG_SCALES | SPIN_COL_SH),
    G("ex4dgs", "ex4dgs", "model/point_cloud/*", keyed, SPIN_COL_LOG_SCALES | SPIN_COL_SH,
      .expected = "expected_ply.npz", .said = "PLYs"),
    G("freetimegs", "freetimegs", "", free, ANY_STILL, .seen = {{"opacity", 1 / 255.0}}),
    G("freetimegs", "ftgs_ply", "scene.ftgs.ply", free, ANY_STILL,
      .seen = {{"opacity", 1 / 255.0}}),
    G("freetimegspp", "freetimegspp", "", free, ANY_STILL, .seen = {{"opacity", 1 / 255.0}},
      .also = {"gaussians.pt"}),
    G("scgs", "scgs", "model", nodes, ANY_STILL, .last = 1, .also = {"model/deform/*/deform.pth"}),
    G("gaussianflow", "gaussianflow", "", deformed, SPIN_COL_LOGIT_OPACITIES, .last = 1,
      .said = "Gaussian-Flow,", .also = {"chkpnt*.pth"}),
    G("shapeofmotion", "shapeofmotion", "checkpoints/last.ckpt", rigid,
      SPIN_COL_LOG_SCALES | SETTLED, .frames = true, .also = {""}),
    G("4dgs", "4dgs", "", states, ANY_STILL, .seen = {{"visible", 0}}, .unless = "centre"),
    G("stglite", "stglite", "scene.ply", line, ANY_STILL, .seen = {{"opacity", 1 / 255.0}}),
    G("gifstream", "gifstream", "", spawned, ANY_STILL, .options = {"camera", "0,0,-6"},
      .seen = {{"mask", 0}}, .frames = true, .also = {"ckpts", "ckpts/*"}),
    G("usd", "usd", "scene.usdc", particles, ANY_STILL, .options = {"axes", "source"},
      .frames = true, .also = {"?scene.usda", "?scene.usdz"}),
    G("d3dgs", "d3dgs", "params.npz", cloud, SPIN_COL_LOG_SCALES | SPIN_COL_LOGIT_OPACITIES,
      .also = {""}),
    G("d3dgs", "pamosplat", "params.npz", parts, SPIN_COL_LOG_SCALES | SPIN_COL_LOGIT_OPACITIES,
      .frames = true, .said = "part_colors"),
    G("ply", "trackersplat", "model", particles, 0, .frames = true),
    TC3DGS("expected_ste_0.1.npz"),
    TC3DGS("expected_ste_0.01.npz", "tc-mask", "frame", "tc-threshold", "0.01"),
    TC3DGS("expected_prune_avg_0.1.npz", "tc-mask", "avg", "tc-threshold", "0.1"),
    TC3DGS("expected_prune_any_0.1.npz", "tc-mask", "any", "tc-threshold", "0.1"),
    TC3DGS("expected_prune_all_0.1.npz", "tc-mask", "all", "tc-threshold", "0.1"),
    TC3DGS("expected_nomask.npz", "tc-mask", "none", "tc-threshold", "0.1"),
};

enum { N_GOLDENS = sizeof goldens / sizeof *goldens };

static inline const struct golden *golden_of(const char *method)
{
    for (size_t i = 0; i < N_GOLDENS; i++) {
        if (strcmp(goldens[i].method, method) == 0)
            return &goldens[i];
    }
    printf("# no golden values of '%s'\n", method);
    exit(1);
}

/* folder/pattern; of several entries that a '*' stands for the one with the largest number. NULL:
 * none. */
static inline const char *golden_path(const char *folder, const char *pattern)
{
    const char *best = NULL;
    long most = -1;
    glob_t found;

    if (!*pattern)
        return folder;
    if (glob(path_in(folder, pattern), 0, NULL, &found) != 0)
        return NULL;
    for (size_t i = 0; i < found.gl_pathc; i++) {
        const char *at = strstr(found.gl_pathv[i], "iteration_");
        long number = at ? atol(at + strlen("iteration_")) : 0;

        if (number > most) {
            most = number;
            best = path_in(folder, found.gl_pathv[i] + strlen(folder) + 1);
        }
    }
    globfree(&found);
    return best;
}

/* ---- Tables ---------------------------------------------------------------------------------- */

/* The dimension of n_rows is that of the rows; 0: the last but one, or the first. */
static inline struct table golden_load(struct spin_npz *npz, const char *key, size_t n_rows)
{
    struct spin_array info = {0};
    struct table t = {.value = check_load(npz, key, &info), .n_blocks = 1};
    int d = info.n_dims > 2 ? 1 : 0;

    if (!t.value)
        exit(1);
    for (int k = 0; n_rows && k < info.n_dims; k++) {
        if (info.shape[d = k] == n_rows)
            break;
        d = 0;
    }
    for (int k = 0; k < d; k++)
        t.n_blocks *= info.shape[k];
    t.n_rows = info.n_dims ? info.shape[d] : 1;
    t.width = info.count / (t.n_blocks * t.n_rows);
    return t;
}

static inline double golden_at(const struct table *t, size_t block, size_t row)
{
    return t->value[((t->n_blocks > 1 ? block : 0) * t->n_rows + row) * t->width];
}

struct tolerance {
    double abs, rel;
    bool of_extent, of_trace;
};

static inline struct tolerance golden_bound(const spin_json *manifest, const struct golden_array *a,
                                            const char *key)
{
    const spin_json *all = spin_json_get(manifest, "tolerance"), *entry;
    struct tolerance t = {a->abs, a->rel, false, false};
    const char *name = a->bound ? a->bound : key, *text, *at;

    all = all ? all : spin_json_get(manifest, "tolerances");
    if (!*name)
        return t;
    entry = spin_json_get(all, name);
    text = spin_json_string(entry);
    if (!entry && t.abs == 0 && t.rel == 0 &&
        !(spin_json_number(spin_json_get(all, "abs"), &t.abs) &&
          spin_json_number(spin_json_get(all, "rel"), &t.rel)))
        ok(0, "the manifest has a tolerance of %s", name);
    if (spin_json_number(entry, &t.abs) || !text)
        return t;
    t = (struct tolerance){0, 0, strstr(text, "extent") != NULL,
                           strstr(text, "xx+yy+zz") || strstr(text, "of the trace")};
    if (strncmp(text, "exact", 5) == 0) /* but for conversions between floats */
        t = (struct tolerance){.abs = a->abs, .rel = a->rel};
    else if (strncmp(text, "half precision", 14) == 0)
        t = (struct tolerance){.abs = 1e-3, .rel = 1e-3};
    else if (sscanf(text, "abs %lf", &t.abs) != 1 && sscanf(text, "rel %lf", &t.rel) != 1 &&
             sscanf(text, "%lf of the trace", &t.rel) != 1)
        ok(0, "the manifest's tolerance '%s' is understood", text);
    if ((at = strchr(text, '+')) != NULL && sscanf(at, "+ rel %lf", &t.rel) != 1)
        sscanf(at, "+ %lf", &t.rel);
    return t;
}

/* ---- Comparing ------------------------------------------------------------------------------- */

static inline void covariance_of_row(const struct spin_splats *s, size_t i, double out[6])
{
    double scale[3], quat[4];

    for (size_t c = 0; c < 3; c++)
        scale[c] = exp(s->log_scales[3 * i + c]);
    for (size_t c = 0; c < 4; c++)
        quat[c] = s->quats[4 * i + c];
    spin_covariance_of(scale, quat, out);
}

/* Colours seen from `eye` [3]: max(0, 1/2 + SH), as in 3DGS. */
static inline void colour_of_row(const struct spin_splats *s, size_t i, const double *eye,
                                 double out[3])
{
    size_t n = (size_t)spin_sh_count(s->sh_degree);
    double d[3], norm = 0;
    float basis[SPIN_SH_MAX];

    for (size_t c = 0; c < 3; c++) {
        d[c] = s->means[3 * i + c] - eye[c];
        norm += d[c] * d[c];
    }
    norm = sqrt(norm);
    spin_sh_basis(s->sh_degree,
                  spin_v3((float)(d[0] / norm), (float)(d[1] / norm), (float)(d[2] / norm)), basis);
    for (size_t c = 0; c < 3; c++) {
        double sum = 0.5;

        for (size_t k = 0; k < n; k++)
            sum += basis[k] * s->sh[3 * n * i + 3 * k + c];
        out[c] = fmax(sum, 0);
    }
}

/* Row i in the form of an array of this kind. Returns its width. */
static inline size_t golden_row(enum golden_kind kind, const struct spin_splats *s, size_t i,
                                const double *eye, double *want, double out[SPIN_SH_MAX * 3])
{
    size_t n_sh = 3 * (size_t)spin_sh_count(s->sh_degree < 0 ? 0 : s->sh_degree), width = 3;
    const float *from = s->means + 3 * i;
    double dot = 0, norm = 0;

    if (kind == COV6)
        return covariance_of_row(s, i, out), 6;
    if (kind == SEEN)
        return colour_of_row(s, i, eye, out), 3;
    if (kind == QUATS || kind == SIGNED_QUATS)
        from = s->quats + (width = 4) * i;
    else if (kind == SCALES || kind == LOG_SCALES)
        from = s->log_scales + 3 * i;
    else if (kind == OPACITIES || kind == LOGITS)
        from = s->logit_opacities + (width = 1) * i;
    else if (kind == SH || kind == BASE)
        from = s->sh + (width = n_sh) * i;
    else if (kind == SH_REST || kind == SH_CHANNELS) {
        from = s->sh + n_sh * i + 3;
        width = n_sh - 3;
    }
    for (size_t c = 0; c < width; c++) {
        double x = from[kind == SH_CHANNELS ? 3 * (c % (width / 3)) + c / (width / 3) : c];

        out[c] = kind == SCALES      ? exp(x)
                 : kind == OPACITIES ? 1 / (1 + exp(-x))
                 : kind == BASE      ? 0.5 + SPIN_SH_C0 * x
                                     : x;
    }
    for (size_t c = 0; kind == QUATS && c < 4; c++) {
        dot += out[c] * want[c];
        norm += want[c] * want[c];
    }
    for (size_t c = 0; kind == QUATS && c < 4; c++)
        want[c] *= (dot < 0 ? -1 : 1) / sqrt(norm);
    return kind == BASE ? 3 : width;
}

/* The row of an array for row `row` of the model; -1: none. */
static inline long golden_place(const struct golden_array *a, const struct table *marks, size_t row)
{
    size_t n = 0;

    if (!a->rows || row == NOWHERE)
        return row == NOWHERE ? -1 : (long)row;
    if (strcmp(a->rows, "moving") == 0)
        return marks->n_rows > 1                ? marks->value[row] == 0 ? (long)row : -1
               : row >= (size_t)marks->value[0] ? (long)row
                                                : -1;
    for (size_t i = 0; i < row; i++)
        n += marks->value[i] != 0;
    return marks->value[row] != 0 ? (long)n : -1;
}

struct golden_now {
    const spin_json *manifest;
    struct spin_npz *npz;
    const char *prefix;        /* of the arrays' names, or NULL */
    size_t index, n_all, *row; /* [s->n]; NOWHERE: in none of the arrays */
    const struct spin_splats *s;
    const char *name;
};

static inline void golden_compare(const struct golden_now *now, const struct golden_array *a)
{
    bool optional = *a->key == '?';
    const char *mark = a->rows;
    char key[80];
    struct table t, marks = {0}, eye = {0}, at = {0};
    const struct spin_splats *s = now->s;
    struct tolerance b;
    size_t block = now->index, n_rows = 0;
    double worst = 0, extent = 1, out[SPIN_SH_MAX * 3], want[SPIN_SH_MAX * 3];

    snprintf(key, sizeof key, "%s%s", now->prefix ? now->prefix : "", a->key + optional);
    if (optional && !spin_npz_has(now->npz, key))
        return;
    if (a->at) {
        at = golden_load(now->npz, a->at, 0);
        for (block = 0; block < at.n_rows && at.value[block] != (double)now->index;)
            block++;
        free(at.value);
        if (block == at.n_rows)
            return;
    }
    if (mark && strcmp(mark, "moving") == 0)
        mark = spin_npz_has(now->npz, "is_static") ? "is_static" : "n_static";
    if (mark)
        marks = golden_load(now->npz, mark, 0);
    if (a->kind == SEEN)
        eye = golden_load(now->npz, "campos", 0);
    b = golden_bound(now->manifest, a, key);
    t = golden_load(now->npz, key, now->n_all);
    if (b.of_extent)
        extent = fmax(1, largest(t.value + (t.n_blocks > 1 ? block : 0) * t.n_rows * t.width,
                                 t.n_rows * t.width));
    for (size_t i = 0; i < s->n; i++) {
        long place = golden_place(a, &marks, now->row[i]);
        size_t width = a->width ? a->width : t.width, n;
        size_t n_sh = 3 * (size_t)spin_sh_count(s->sh_degree < 0 ? 0 : s->sh_degree);
        double trace;

        if (place < 0)
            continue;
        memset(want, 0, sizeof want);
        memcpy(want, t.value + ((t.n_blocks > 1 ? block : 0) * t.n_rows + (size_t)place) * t.width,
               width * sizeof *want);
        n = golden_row(a->kind, s, i, eye.value, want, out);
        trace = want[0] + want[3] + want[5];
        if (a->kind == SH_REST && width < n_sh - 3)
            width = n_sh - 3;
        n_rows++;
        for (size_t c = 0; c < width; c++) {
            /* Some methods exceed 0..1, which a logit cannot represent. */
            double to = a->kind == OPACITIES ? fmin(fmax(want[c], 0), 1) : want[c];
            double error = fabs((c < n ? out[c] : 0) - to);
            double most = b.abs * extent + b.rel * (b.of_trace ? trace : fabs(want[c]));

            error = error == 0 ? 0 : error / most;
            worst = error <= worst ? worst : error; /* NaN stays */
        }
    }
    ok(worst <= 1 && (n_rows > 0 || s->n == 0), "%s: %s", now->name, key);
    if (!(worst <= 1))
        printf("#   off by %.3g times the tolerance\n", worst);
    free(t.value);
    free(marks.value);
    free(eye.value);
}

/* Rows for which all marks exceed their bounds; '?': a mark that may be missing. */
static inline size_t golden_rows(const struct golden *g, struct spin_npz *npz, size_t n_all,
                                 size_t index, size_t *row)
{
    size_t n = n_all;

    for (size_t i = 0; i < n_all; i++)
        row[i] = i;
    for (int k = 0; k < 2 && g->seen[k].key; k++) {
        const char *key = g->seen[k].key + (*g->seen[k].key == '?');
        struct table t = {0};
        size_t kept = 0;

        if (key != g->seen[k].key && !spin_npz_has(npz, key))
            continue;
        t = golden_load(npz, key, n_all);
        for (size_t i = 0; i < n; i++) {
            if (golden_at(&t, index, row[i]) > g->seen[k].above)
                row[kept++] = row[i];
        }
        n = kept;
        free(t.value);
    }
    return n;
}

/* Each column requested alone is identical. */
static inline void golden_columns(struct run *run, int frame, double time,
                                  const struct spin_splats *s, const char *name)
{
    struct spin_splats one = {0};
    const struct {
        unsigned bit;
        float *const *all, *const *alone;
        size_t width;
    } column[] = {
        {SPIN_COL_MEANS, &s->means, &one.means, 3},
        {SPIN_COL_QUATS, &s->quats, &one.quats, 4},
        {SPIN_COL_LOG_SCALES, &s->log_scales, &one.log_scales, 3},
        {SPIN_COL_LOGIT_OPACITIES, &s->logit_opacities, &one.logit_opacities, 1},
        {SPIN_COL_SH, &s->sh, &one.sh,
         s->sh_degree < 0 ? 0 : 3 * (size_t)spin_sh_count(s->sh_degree)},
    };
    unsigned bad = 0;

    for (int c = 0; c < 5; c++) {
        if (run->sequence.columns & column[c].bit)
            bad |= run->importer->frame(run->self, frame, time, column[c].bit, &one) != SPIN_OK ||
                           one.n != s->n ||
                           memcmp(*column[c].alone, *column[c].all, 4 * column[c].width * s->n)
                       ? column[c].bit
                       : 0;
    }
    ok(bad == 0, "%s: columns alone are the same", name);
    if (bad)
        printf("#   columns %#x are not\n", bad);
    spin_splats_free(&one);
}

/* The index of the frame with this number. */
static inline int golden_index(const struct run *run, int number)
{
    int i = 0;

    if (!run->sequence.numbers)
        return number;
    while (i < run->sequence.n_frames && run->sequence.numbers[i] != number)
        i++;
    return i;
}

/* One time: the values read, all at once and column by column. */
static inline void golden_time(const struct golden *g, struct run *run, struct golden_now *now,
                               double time)
{
    struct spin_splats s = {0};
    size_t n = golden_rows(g, now->npz, now->n_all, now->index, now->row);
    int frame = run->sequence.continuous || run->sequence.n_frames == 1 ? 0
                : g->frames ? golden_index(run, (int)time)
                            : (int)now->index;

    now->s = &s;
    if (ok(run->importer->frame(run->self, frame, time, run->sequence.columns, &s) == SPIN_OK &&
               s.n == n &&
               (run->sequence.continuous || !run->sequence.counts ||
                s.n == run->sequence.counts[frame]),
           "%s: %zu of %zu Gaussians are seen", now->name, n, now->n_all)) {
        for (const struct golden_array *a = g->array; a->key; a++)
            golden_compare(now, a);
        check_sane(&s, run->sequence.columns, now->name);
        golden_columns(run, frame, time, &s, now->name);
    } else {
        printf("#   %zu read: %s\n", s.n, spin_last_error());
    }
    spin_splats_free(&s);
}

/* Compares the run at `path` with the numbers of fixture `folder`; later: an offset of their
 * times. */
static inline void golden_run(const struct golden *g, const char *from, const char *path,
                              const char *const *pairs, const char *folder, double later,
                              const char *name)
{
    struct golden_now now = {.manifest = load_manifest(folder)};
    struct table first, times = {0};
    struct spin_npz npz;
    struct run run;

    if (!ok(model_open(from, path, pairs, &run) == SPIN_OK &&
                !strcmp(run.importer->name, g->method) &&
                spin_npz_open(path_in(folder, g->expected ? g->expected : "expected.npz"), &npz) ==
                    SPIN_OK,
            "%s: is of %s and opens", name, g->method)) {
        printf("#   %s\n", spin_last_error());
        run_close(&run);
        return;
    }
    ok(g->still == ANY_STILL || run.sequence.static_columns == g->still, "%s: what is still", name);
    ok(g->last == 0 || (run.sequence.time_first == 0 && run.sequence.time_last == g->last),
       "%s: from when to when", name);
    ok(!g->said || strstr(run.sequence.notes, g->said) || strstr(run.sequence.variant, g->said),
       "%s: the notes say '%s'", name, g->said ? g->said : "");
    ok(!g->unsaid ||
           !(strstr(run.sequence.notes, g->unsaid) || strstr(run.sequence.variant, g->unsaid)),
       "%s: the notes do not say '%s'", name, g->unsaid ? g->unsaid : "");
    first = golden_load(&npz, g->array->key, 0);
    if (spin_npz_has(&npz, "times"))
        times =
            golden_load(&npz, g->frames && spin_npz_has(&npz, "frames") ? "frames" : "times", 0);
    ok(run.sequence.continuous == (times.value && g->array != golden_plain && !g->frames),
       "%s: any time may be asked for where there are times", name);
    now.npz = &npz;
    now.n_all = first.n_rows;
    now.row = malloc((now.n_all + 1) * sizeof *now.row);
    for (; now.index < (times.value ? times.n_rows : first.n_blocks); now.index++) {
        double time = times.value ? times.value[now.index] + later : 0;
        char what[300];

        snprintf(what, sizeof what, "%s at %g", name, times.value ? time : (double)now.index);
        now.name = what;
        golden_time(g, &run, &now, time);
    }
    free(now.row);
    free(first.value);
    free(times.value);
    spin_json_free((spin_json *)now.manifest);
    spin_npz_close(&npz);
    run_close(&run);
}

/* Uses the first row of the table for this method, but reads from `path` with these options. */
static inline void golden_as(const char *method, const char *path, const char *const *pairs,
                             const char *folder, double later, const char *name)
{
    golden_run(golden_of(method), method, path, pairs, folder, later, name);
}

/* Compares a fixture as a row of the table says, if it is of that kind. */
static inline void golden_fixture(const struct golden *g, const char *folder, const char *name)
{
    const char *expected = path_in(folder, g->expected ? g->expected : "expected.npz"), *path;
    const char *pairs[] = {g->options[0], g->options[1], g->options[2], g->options[3], NULL};
    struct spin_npz npz;
    bool fits;
    char what[200];

    if (!spin_path_exists(expected) || spin_npz_open(expected, &npz) != SPIN_OK)
        return;
    fits = spin_npz_has(&npz, g->array->key) && !(g->unless && spin_npz_has(&npz, g->unless));
    spin_npz_close(&npz);
    if (!fits)
        return;
    if (pairs[0] && strcmp(pairs[0], "config") == 0)
        pairs[1] = path_in(folder, pairs[1]);
    snprintf(what, sizeof what, "%s/%s %s", g->fixtures, name, pairs[0] ? g->options[1] : "");
    path = golden_path(folder, g->path);
    golden_run(g, NULL, path ? path : folder, pairs, folder, 0, what);
    for (int i = 0; i < 3 && g->also[i]; i++) {
        bool optional = *g->also[i] == '?';

        path = golden_path(folder, g->also[i] + optional);
        snprintf(what, sizeof what, "%s/%s %s", g->fixtures, name, g->also[i]);
        if (ok(path || optional, "%s: is there", what) && path)
            golden_run(g, NULL, path, pairs, folder, 0, what);
    }
}

#endif
