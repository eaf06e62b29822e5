/* SpacetimeGaussians (Li et al., CVPR 2024), lite and full: Gaussians on cubic paths, with
 * quaternions that change linearly and a Gaussian window in time, which 4D splats represent
 * exactly.
 *
 * The window is exp(-x^2), without the factor 1/2, and its width is stored as a logarithm. Colours
 * of the lite model are RGB, not SH. Gaussians of the full model have no colours: its rasteriser
 * blends nine features, and a network computes the colour of a pixel from these and from the ray.
 * For each Gaussian, the importer computes the colour of a pixel that only this Gaussian covers,
 * for each of several cameras, and fits SH of degree 1 to these colours. */
#include "importers/lib/gaussian4d.h"
#include "importers/lib/model.h"
#include "importers/lib/run_config.h"
#include "math/motion.h"
#include "math/quat.h"
#include "math/sh.h"

/* Offsets of the values of a Gaussian in its row. */
enum {
    PLACE = 0, /* position at TIME */
    TIME = 3,
    WIDTH = 4,   /* natural logarithm of the width of the window */
    MOTION = 5,  /* coefficients of the path: linear, quadratic, cubic; x y z each */
    LOGIT = 14,  /* logit of the opacity at TIME */
    SCALE = 15,  /* natural logarithms of the scales */
    TURN = 18,   /* quaternion at TIME */
    CHANGE = 22, /* change of the quaternion per unit of time */
    COLOUR = 26, /* lite: the colour; full: the base colour, then 3 features of the view */
    FEATURE = 32 /* full: 3 features of the time, per unit of time */
};

/* The PLY properties of a cloud. A group is the property `name`, or <name>0, <name>1, ... */
static const struct group {
    const char *name;
    int n[2]; /* number of properties in lite and in full models; 0: only the property `name` */
    int at;
} groups[] = {
    {"x", {0, 0}, PLACE},          {"y", {0, 0}, PLACE + 1},
    {"z", {0, 0}, PLACE + 2},      {"trbf_center", {0, 0}, TIME},
    {"trbf_scale", {0, 0}, WIDTH}, {"motion_", {9, 9}, MOTION},
    {"opacity", {0, 0}, LOGIT},    {"scale_", {3, 3}, SCALE},
    {"rot_", {4, 4}, TURN},        {"omega_", {4, 4}, CHANGE},
    {"f_dc_", {3, 6}, COLOUR},     {"f_t_", {-1, 3}, FEATURE}, /* -1: lite models have no f_t_* */
};
enum { N_GROUPS = sizeof groups / sizeof *groups, LITE_WIDTH = 29, FULL_WIDTH = 35 };

/* The network of the full model computes the colour of a pixel:
 *
 *     ending(base + W2 relu(W1 [view, time, origin of the ray, direction of the ray]))
 *
 * base, view and time, three numbers each, are blended from the Gaussians over black; the ray is in
 * world coordinates, with a unit direction. The method's option rgbfunction selects the
 * ending. */
enum { PIXEL_INPUTS = 12, PIXEL_HIDDEN = 6 };
/* In this order, the endings for the values sandwich, sandwichnoact and sandwichnoactss of
 * rgbfunction. */
enum ending { SIGMOID, CLAMP, AS_IS };

struct model {
    struct spin_model base;
    const char *decoder; /* path of the network for colours; NULL: there is none */
    size_t n, n_dropped;
    bool full;
    size_t width;          /* number of floats in a row */
    float *rows;           /* [n][width]; for a lite model, valid only during open() */
    enum ending ending;    /* activation after the network of a full model */
    struct mlp_net colour; /* for a full model; colour.n is 0 if only base colours are imported */
    struct camera_places cameras;
    double duration; /* number of frames that training used; 0: unknown */
};

/* ---- Recognising ----------------------------------------------------------------------------- */

static int probe(const struct spin_peek *peek)
{
    /* The input is a cloud, or the folder of one checkpoint. The confidence must exceed 90, which
     * is that of the PLY importer. */
    if (spin_peek_contains(peek, "property float trbf_center") &&
        spin_peek_contains(peek, "property float motion_8") &&
        spin_peek_contains(peek, "property float omega_3"))
        return 100;
    if (!peek->is_folder && spin_peek_contains(peek, "mlp1.weight") &&
        spin_peek_contains(peek, "mlp2.weight") && spin_text_ends(peek->path, ".pt"))
        return 80;
    /* trbfslinit is an option of this method. */
    return spin_peek_has(peek, "point_cloud") && spin_peek_contains(peek, "trbfslinit=") ? 90 : 0;
}

/* ---- The cloud ------------------------------------------------------------------------------- */

/* Distinguishes lite from full models by the numbers of properties f_dc_* and f_t_*. */
static spin_status check_colours(const struct spin_ply *ply, const struct spin_ply_element *e,
                                 struct model *m)
{
    int n_dc = spin_model_count(e, "f_dc_"), n_t = spin_model_count(e, "f_t_");

    m->full = n_t > 0;
    m->width = m->full ? FULL_WIDTH : LITE_WIDTH;
    if (spin_model_count(e, "f_rest_") > 0)
        return spin_unsupported(
            "'%s' has properties f_rest_*: forks of SpacetimeGaussians with SH are not supported",
            ply->path);
    if (!(n_dc == 3 && n_t == 0) && !(n_dc == 6 && n_t == 3))
        return spin_malformed(
            "'%s' has %d properties f_dc_* and %d f_t_*, expected 3 and 0 (lite) or 6 and 3 (full)",
            ply->path, n_dc, n_t);
    return SPIN_OK;
}

/* Adds a note for the user and prints a warning if there are properties that SpacetimeGaussians
 * does not write. A fork of the method wrote them, so their meaning is unknown. */
static void note_others(const struct spin_ply *ply, const struct spin_ply_element *e,
                        const struct model *m)
{
    const char *first = NULL;
    size_t n = 0;

    for (size_t p = 0; p < e->n_properties; p++) {
        const char *name = e->property[p].name;
        bool known = strcmp(name, "nx") == 0 || strcmp(name, "ny") == 0 || strcmp(name, "nz") == 0;

        for (int g = 0; g < N_GROUPS; g++)
            known = known || (groups[g].n[m->full] > 0
                                  ? strncmp(name, groups[g].name, strlen(groups[g].name)) == 0
                                  : groups[g].n[m->full] == 0 && strcmp(name, groups[g].name) == 0);
        n += !known;
        first = known || first ? first : name;
    }
    if (n == 0)
        return;
    spin_note(m->base.sequence,
              "%zu properties do not belong to SpacetimeGaussians (the first is '%s'): if a fork "
              "wrote this run, its other properties may have another meaning too",
              n, first);
    spin_warn("'%s': property '%s' does not belong to SpacetimeGaussians and is ignored", ply->path,
              first);
}

static spin_status read_cloud(struct model *m)
{
    const struct spin_ply *ply = &m->base.ply;
    const struct spin_ply_element *e;
    struct spin_ply_target target[FULL_WIDTH], *t = target;

    SPIN_TRY(spin_model_vertices(&m->base, m->base.path, &e));
    SPIN_TRY(check_colours(ply, e, m));
    m->n = (size_t)e->count;
    SPIN_TRY(spin_arena_take(m->full ? &m->base.arena : &m->base.scratch, m->n,
                             m->width * sizeof *m->rows, (void **)&m->rows));
    for (const struct group *g = groups; g < groups + N_GROUPS; g++) {
        int n = g->n[m->full], found = n > 0 ? spin_model_count(e, g->name) : 0;

        if (n > 0 && found != n)
            return spin_malformed(
                "'%s' has %d properties %s*, expected the %d of SpacetimeGaussians", ply->path,
                found, g->name, n);
        for (int i = 0; n >= 0 && i < (n > 0 ? n : 1); i++) {
            char name[32];

            snprintf(name, sizeof name, n > 0 ? "%s%d" : "%s", g->name, i);
            *t = (struct spin_ply_target){spin_ply_find(e, name), m->rows + g->at + i, m->width};
            if (t++->property < 0)
                return spin_malformed(
                    "'%s': element 'vertex' has no property '%s', which SpacetimeGaussians has",
                    ply->path, name);
        }
    }
    spin_ply_columns(ply, e, target, (size_t)(t - target));
    note_others(ply, e, m);
    return SPIN_OK;
}

/* ---- Settings -------------------------------------------------------------------------------- */

/* Returns the number K of the first frame that training used, if `path`, the source_path of
 * cfg_args, ends in colmap_<K>; otherwise -1. */
static long first_frame(struct cfg_span path)
{
    const char *at = path.end;
    long number = 0, place = 1;

    if (!path.at || path.end - path.at < 2)
        return -1;
    for (at--; at > path.at && at[-1] >= '0' && at[-1] <= '9' && place < 100000000; at--) {
        number += place * (at[-1] - '0');
        place *= 10;
    }
    return place > 1 && at - path.at > 7 && memcmp(at - 7, "colmap_", 7) == 0 ? number : -1;
}

static spin_status read_duration(struct model *m)
{
    const struct cfg_args *cfg = &m->base.settings.cfg;
    struct cfg_span given = spin_model_option_span(&m->base, "duration");
    double n = 0;

    SPIN_TRY(spin_cfg_read_number(cfg, "duration", &n));
    if (given.at && !spin_cfg_number(given, &n))
        n = -1;
    m->duration = n;
    if ((n >= 1 && n <= 1e6 && n == floor(n)) || (n == 0 && !given.at))
        return SPIN_OK;
    if (given.at)
        return spin_misuse("--duration '%s': expected a number of frames", given.at);
    return spin_malformed("'%s': 'duration' is %g, expected a number of frames", cfg->path, n);
}

static spin_status read_ending(struct model *m)
{
    const struct cfg_args *cfg = &m->base.settings.cfg;
    int ending;

    SPIN_TRY(spin_model_word(&m->base, "rgb-function", "rgbfunction",
                             "sandwich|sandwichnoact|sandwichnoactss", &ending));
    m->ending = ending;
    if (ending >= 0)
        return SPIN_OK;
    return spin_unsupported(
        "'%s': the function that the full model applies to the output of its network is unknown, "
        "since %s%s: give --rgb-function sandwich (sigmoid), sandwichnoact (0 to 1) or "
        "sandwichnoactss (none)",
        m->base.path, cfg->path ? "there is no known 'rgbfunction' in " : "there is no cfg_args",
        cfg->path ? cfg->path : "");
}

/* ---- Colours of the full model --------------------------------------------------------------- */

/* Loads a 1x1 convolution without bias. */
static spin_status load_layer(struct model *m, const char *key, int n_out, int n_in,
                              enum mlp_ending ending)
{
    const int64_t shape[4] = {n_out, n_in, 1, 1};
    float *weight;

    SPIN_TRY(spin_model_floats(&m->base, key, 4, shape, NULL, &weight));
    m->colour.layer[m->colour.n++] = (struct mlp_layer){n_in, n_out, ending, weight, NULL};
    return SPIN_OK;
}

static spin_status load_decoder(struct spin_model *base)
{
    struct model *m = (struct model *)base;

    SPIN_TRY(spin_model_dict(base));
    SPIN_TRY(load_layer(m, "mlp1.weight", PIXEL_HIDDEN, PIXEL_INPUTS, MLP_RELU));
    SPIN_TRY(load_layer(m, "mlp2.weight", 3, PIXEL_HIDDEN, MLP_PLAIN));
    if (base->tensors->n != 2)
        return spin_unsupported(
            "the network has %zu tensors, expected only mlp1.weight and mlp2.weight",
            base->tensors->n);
    return SPIN_OK;
}

static spin_status find_cameras(const char *path, const char *save, struct model *m)
{
    const char *given = spin_model_option(&m->base, "camera"), *file;

    if (given)
        return spin_camera_places_parse(given, &m->cameras);
    SPIN_TRY(spin_model_find_upwards(&m->base, path, save, "cameras.json", &file));
    return file ? spin_camera_places_load(file, &m->cameras) : SPIN_OK;
}

/* Chooses which colours of a full model are imported: those that its network computes, or the base
 * colours. */
static spin_status choose_colours(const char *path, const char *save, struct model *m)
{
    enum { AUTO, VIEWS, BASE };
    int rule;
    bool base, views;
    const char *lack = "as requested", *cloud = m->base.path;

    SPIN_TRY(spin_option_word(m->base.values, "colour", "auto|views|base", &rule));
    base = rule == BASE;
    views = rule == VIEWS;
    if (!m->full)
        return views ? spin_misuse(
                           "--colour views: '%s' is a lite model, which has no network for colours",
                           cloud)
                     : SPIN_OK;
    SPIN_TRY(read_ending(m));
    if (!base) {
        SPIN_TRY(find_cameras(path, save, m));
        lack = !m->decoder ? "there is no point_cloud.pt beside the cloud"
                           : "there is no cameras.json: give positions with --camera";
        base = !m->decoder || m->cameras.n == 0;
        if (base && views)
            return spin_not_found("--colour views: '%s': %s", cloud, lack);
        if (base)
            spin_warn("'%s': only base colours are imported: %s", cloud, lack);
    }
    if (base)
        spin_note(m->base.sequence,
                  "full model: only the base colours are imported, without the contribution of the "
                  "network (%s)",
                  lack);
    else
        spin_note(
            m->base.sequence,
            "full model: its network computes the colour of each pixel from the blended features "
            "of all Gaussians there; splats cannot represent this, so each Gaussian is imported "
            "with SH of degree 1 that approximate the network's colours of this Gaussian alone, "
            "seen from %d cameras",
            m->cameras.n);
    return base ? SPIN_OK : spin_model_torch(&m->base, m->decoder, load_decoder);
}

/* ---- 4D splats ------------------------------------------------------------------------------- */

static double end_colour(const struct model *m, double x)
{
    if (m->ending == SIGMOID)
        return spin_sigmoid_of(x);
    return m->ending == CLAMP ? fmin(fmax(x, 0), 1) : x;
}

/* Returns the SH coefficient of degree 0 for a colour 0..1. */
static float dc_of(double colour) { return (float)((colour - 0.5) / SPIN_SH_C0); }

/* Whether all values of a row are finite, the coordinates of the position are below 1e18 at all
 * times from 0 to 1, and the scales do not overflow. */
static bool stays_in_range(const struct model *m, const float *row)
{
    double d = fmax(fabs((double)row[TIME]), fabs(1 - (double)row[TIME]));
    bool good = spin_finite_missing(row, m->width) == 0;

    for (int c = 0; c < 3; c++) {
        const float *at = row + MOTION + c;
        double most =
            fabs((double)row[PLACE + c]) +
            d * (fabs((double)at[0]) + d * (fabs((double)at[3]) + d * fabs((double)at[6])));

        good = good && most < 1e18 && row[SCALE + c] <= 80;
    }
    return good;
}

static void fill_row(struct model *m, size_t i)
{
    static const float unturned[4] = {1, 0, 0, 0};
    struct spin_splats_4d *s = &m->base.splats_4d;
    const float *row = m->rows + m->width * i, *turn = row + TURN, *change = row + CHANGE;
    size_t n_sh = m->colour.n > 0 ? 12 : 3;

    s->times[i] = stays_in_range(m, row) ? row[TIME] : NAN;
    memcpy(s->centres + 3 * i, row + PLACE, 3 * sizeof *row);
    memcpy(s->paths + 9 * i, row + MOTION, 9 * sizeof *row);
    memcpy(s->log_scales + 3 * i, row + SCALE, 3 * sizeof *row);
    if (spin_quat_norm(turn) > 0)
        memcpy(s->spins + 4 * i, change, 4 * sizeof *row);
    else /* the quaternion is 0: the rotation is constant, as in the method's renderer */
        turn = spin_quat_norm(change) > 0 ? change : unturned;
    memcpy(s->quats + 4 * i, turn, 4 * sizeof *row);
    s->logit_opacities[i] = row[LOGIT];
    /* Sigma is limited, since the narrowest and the widest windows are outside the range of float.
     */
    s->sigmas[i] =
        (float)fmin(fmax(exp((double)row[WIDTH]) / sqrt(2), 1e-37), (double)SPIN_FOREVER);
    for (size_t c = 0; c < 3; c++)
        s->sh[n_sh * i + c] =
            m->full ? dc_of(end_colour(m, row[COLOUR + c])) : dc_of(row[COLOUR + c]);
}

/* Fills the 4D splats. Drops rows whose values would be nonfinite at some time from 0 to 1, and
 * keeps the order of all other rows. */
static spin_status fill_splats(struct model *m)
{
    struct spin_splats_4d *s = &m->base.splats_4d;
    size_t *from;

    SPIN_TRY(spin_splats_4d_reserve(s, m->n, 3, m->colour.n > 0 ? 1 : 0, SPIN_4D_SPINS));
    SPIN_TRY(spin_model_scratch(&m->base, m->n, sizeof *from, (void **)&from));
    for (size_t i = 0; i < m->n; i++)
        fill_row(m, i);
    SPIN_TRY(spin_splats_4d_finish(s, &m->n_dropped, from));
    m->n = s->n;
    if (m->n == 0)
        return spin_malformed("'%s': none of %zu Gaussians has finite values", m->base.path,
                              m->n_dropped);
    for (size_t i = 0; i < m->n; i++)
        memmove(m->rows + m->width * i, m->rows + m->width * from[i], m->width * sizeof *m->rows);
    return SPIN_OK;
}

/* ---- Opening --------------------------------------------------------------------------------- */

/* Finds the cloud and, in the same folder, the network. `path` is a folder with checkpoints, the
 * folder of a checkpoint, or one of the two files. */
static spin_status find_files(const char *path, struct model *m, const char **save)
{
    const char *wanted = spin_model_option(&m->base, "iteration");
    int n = (int)strlen(path);

    if (!spin_path_is_folder(path)) {
        bool network = spin_text_ends(path, ".pt");

        if (!network && !spin_text_ends(path, ".ply"))
            return spin_misuse("'%s' is neither the model's folder nor one of its PLY files", path);
        n -= network ? 3 : 4;
        SPIN_TRY(spin_model_text(&m->base, &m->base.path, "%.*s.ply", n, path));
        SPIN_TRY(spin_model_text(&m->base, &m->decoder, "%.*s.pt", n, path));
        SPIN_TRY(spin_model_folder(&m->base, save, path));
    } else {
        SPIN_TRY(spin_model_checkpoint(&m->base, path, "point_cloud.ply", save));
        if (!*save)
            return spin_not_found("'%s' has no iteration_%s with point_cloud.ply", path,
                                  wanted ? wanted : "<N>");
        SPIN_TRY(spin_model_join(&m->base, &m->base.path, *save, "point_cloud.ply"));
        SPIN_TRY(spin_model_join(&m->base, &m->decoder, *save, "point_cloud.pt"));
    }
    if (!spin_path_exists(m->decoder))
        m->decoder = NULL;
    return SPIN_OK;
}

static void describe(const struct model *m)
{
    const struct cfg_args *cfg = &m->base.settings.cfg;
    struct spin_sequence_info *sequence = m->base.sequence;
    long first = first_frame(spin_cfg_get(cfg, "source_path"));
    char from[64] = "";

    spin_model_describe(&m->base, &m->n, m->colour.n > 0 ? 1 : 0,
                        ~(unsigned)SPIN_COL_LOG_SCALES &
                            ~(unsigned)(m->colour.n > 0 ? 0 : SPIN_COL_SH));
    sequence->half_open = m->duration == 0;
    sequence->n_clip_frames = (int)m->duration;
    sequence->time_last = m->duration > 0 ? (m->duration - 1) / m->duration : 1;
    snprintf(sequence->variant, sizeof sequence->variant, "SpacetimeGaussians, %s, %zu Gaussians",
             m->full ? "full" : "lite", m->n);
    if (first > 0)
        snprintf(from, sizeof from, ", the first is frame %ld of the video", first);
    if (m->duration > 0)
        spin_note(sequence,
                  "the run has %g frames%s; frame i is at time i/%g; for a data set with only "
                  "these frames use --frame-times unit",
                  m->duration, from, m->duration);
    else
        spin_note(sequence, "no cfg_args contains the number of frames (usually 50): frame i of n "
                            "is at time i/n; set n with --duration");
    if (m->n_dropped > 0) {
        spin_note(sequence, "%zu of %zu Gaussians dropped because of values that are not finite",
                  m->n_dropped, m->n + m->n_dropped);
        spin_warn("'%s': %zu of %zu Gaussians dropped because of values that are not finite",
                  m->base.path, m->n_dropped, m->n + m->n_dropped);
    }
    if (spin_cfg_is(spin_cfg_get(cfg, "loader"), "'immersivess'"))
        spin_note(sequence,
                  "the run was trained on fisheye images: the method renders pinhole images and "
                  "warps them to fisheye images, whereas spin4d only renders pinhole images");
}

static spin_status open_model(void *self, const char *path)
{
    struct model *m = self;
    const char *save;

    SPIN_TRY(find_files(path, m, &save));
    SPIN_TRY(spin_model_cfg(&m->base, path, save));
    SPIN_TRY(read_duration(m));
    SPIN_TRY(read_cloud(m));
    SPIN_TRY(choose_colours(path, save, m));
    SPIN_TRY(fill_splats(m));
    describe(m);
    if (m->colour.n == 0)
        return SPIN_OK;
    return spin_mlp_team_create((size_t)(PIXEL_INPUTS + PIXEL_HIDDEN + 3) * MLP_BLOCK,
                                &m->base.team);
}

/* ---- The splats at one time ------------------------------------------------------------------ */

struct job {
    const struct model *model;
    struct spin_splats *out;
    double time;
};

/* Means over the cameras, for one point: of ray directions d, of colours c, and of their products.
 */
struct means {
    double d[3], c[3], dd[3][3], dc[3][3];
};

/* Solves a x = b for three columns of b at once, and replaces b by x. `a` must be symmetric and
 * positive definite. */
static void solve3(double a[3][3], double b[3][3])
{
    for (int k = 0; k < 3; k++) {
        for (int i = k + 1; i < 3; i++) {
            double f = a[i][k] / a[k][k];

            for (int j = 0; j < 3; j++) {
                a[i][j] -= f * a[k][j];
                b[i][j] -= f * b[k][j];
            }
        }
    }
    for (int k = 2; k >= 0; k--) {
        for (int j = 0; j < 3; j++) {
            for (int i = k + 1; i < 3; i++)
                b[k][j] -= a[k][i] * b[i][j];
            b[k][j] /= a[k][k];
        }
    }
}

/* Fits SH of degree 1 to the colours by least squares. The fitted colour in direction d is mean
 * colour + slope . (d - mean d). Two terms are added to the squared error. The term (slope . mean
 * d)^2 has the same weight as all cameras together; it keeps degree 0 near the mean colour, because
 * some viewers draw degree 0 only. The term least^2 slope^2 keeps the slope small if the rays
 * differ by less than about `least` radians, since the slope would then be noise. */
static void fit_sh(const struct means *m, float sh[12])
{
    const double least = 1e-2;
    double a[3][3], slope[3][3];

    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            a[i][j] = m->dd[i][j]; /* The mean of d d^T, not the covariance of d: the first added
                                      term contributes mean d mean d^T, which cancels the
                                      subtraction in the covariance. */
            slope[i][j] = m->dc[i][j] - m->d[i] * m->c[j];
        }
        a[i][i] += least * least;
    }
    solve3(a, slope);
    for (int c = 0; c < 3; c++) {
        double x = slope[0][c], y = slope[1][c], z = slope[2][c];

        sh[c] = dc_of(m->c[c] - x * m->d[0] - y * m->d[1] - z * m->d[2]);
        sh[3 + c] = (float)(-y / SPIN_SH_C1);
        sh[6 + c] = (float)(z / SPIN_SH_C1);
        sh[9 + c] = (float)(-x / SPIN_SH_C1);
    }
}

/* Sets the inputs 6 to 11 of the network for one point: origin and direction of the ray from a
 * camera to the point. */
static void set_ray(const float camera[3], const double place[3], float *in)
{
    double d[3], norm;

    for (int c = 0; c < 3; c++)
        d[c] = place[c] - camera[c];
    norm = sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
    for (int c = 0; c < 3; c++) {
        in[(6 + c) * MLP_BLOCK] = camera[c];
        in[(9 + c) * MLP_BLOCK] = (float)(norm > 0 ? d[c] / norm : 0);
    }
}

/* Adds one camera to the means for a Gaussian. The colour for this camera is that of a pixel that
 * only this Gaussian covers: it is computed from the base colour and the output of the network. The
 * direction of the ray is one of the inputs `in`. */
static void add_camera(const struct model *m, const float base[3], const float *in,
                       const float *rgb, struct means *means)
{
    double weight = 1.0 / m->cameras.n, ray[3], colour[3];

    for (int i = 0; i < 3; i++) {
        ray[i] = in[(9 + i) * MLP_BLOCK];
        colour[i] = end_colour(m, base[i] + (double)rgb[i * MLP_BLOCK]);
    }
    for (int i = 0; i < 3; i++) {
        means->d[i] += weight * ray[i];
        means->c[i] += weight * colour[i];
        for (int j = 0; j < 3; j++) {
            means->dd[i][j] += weight * ray[i] * ray[j];
            means->dc[i][j] += weight * ray[i] * colour[j];
        }
    }
}

/* Fits the SH of the Gaussians `first` to `first` + n - 1. There must be at least one camera. */
static void fit_colours(void *context, size_t first, int n, float *scratch)
{
    const struct job *job = context;
    const struct model *m = job->model;
    const struct spin_splats_4d *s = &m->base.splats_4d;
    float *in = scratch, *hidden = in + PIXEL_INPUTS * MLP_BLOCK;
    float *rgb = hidden + PIXEL_HIDDEN * MLP_BLOCK;
    struct means means[MLP_BLOCK] = {0};
    const float *row[MLP_BLOCK];
    double place[MLP_BLOCK][3];

    for (int p = 0; p < MLP_BLOCK; p++) { /* pad the last block with its last point */
        size_t k = first + (size_t)(p < n ? p : n - 1);
        double d = job->time - (double)s->times[k];

        row[p] = m->rows + m->width * k;
        spin_path_at(s->centres + 3 * k, s->paths + 9 * k, s->degree, d, place[p]);
        for (int i = 0; i < 3; i++) {
            in[i * MLP_BLOCK + p] = row[p][COLOUR + 3 + i];
            in[(3 + i) * MLP_BLOCK + p] = (float)(d * row[p][FEATURE + i]);
        }
    }
    for (int camera = 0; camera < m->cameras.n; camera++) {
        for (int p = 0; p < MLP_BLOCK; p++)
            set_ray(m->cameras.place[camera], place[p], in + p);
        spin_mlp_run(&m->colour, in, hidden, rgb);
        for (int p = 0; p < n; p++)
            add_camera(m, row[p] + COLOUR, in + p, rgb + p, &means[p]);
    }
    for (int p = 0; p < n; p++)
        fit_sh(&means[p], job->out->sh + 12 * (first + (size_t)p));
}

static spin_status spacetimegs_frame(void *self, int frame, double time, unsigned columns,
                                     struct spin_splats *out)
{
    struct model *m = self;
    struct job job = {m, out, time};

    if (!isfinite(time))
        return spin_misuse("'%s': time %g is not finite", m->base.path, time);
    SPIN_TRY(spin_fail_reading(spin_model_slice(m, frame, time, columns, out), m->base.path));
    if (!(columns & SPIN_COL_SH) || m->colour.n == 0)
        return SPIN_OK;
    spin_mlp_team_run(&m->base.team, m->n, fit_colours, &job);
    return spin_model_check(m->base.path, time, SPIN_COL_SH, out);
}

/* Colours that the network computes are valid at one time only, so models that use the network have
 * no 4D splats. */
static spin_status spacetimegs_splats_4d(void *self, const struct spin_splats_4d **out)
{
    const struct model *m = self;

    *out = m->colour.n > 0 ? NULL : &m->base.splats_4d;
    return SPIN_OK;
}

static const struct spin_plugin_option options[] = {
    {"iteration", "N", "the checkpoint to read (default: the last)", NULL},
    {"duration", "N", "frames that the run was trained on (default: as in cfg_args)", NULL},
    {"colour", "auto|views|base",
     "full model: colours of its network for the cameras, or base colours only", "auto"},
    {"camera", "X,Y,Z[;...]", "full model: positions of cameras (default: those in cameras.json)",
     NULL},
    {"rgb-function", "NAME",
     "full model: sandwich, sandwichnoact or sandwichnoactss (default: as in cfg_args)", NULL},
    {NULL, NULL, NULL, NULL},
};

SPIN_MODEL_IMPORTER(
    spacetimegs, struct model, open_model, spin_model_close,
    .summary = "SpacetimeGaussians, lite and full: the model's folder, or its point_cloud.ply",
    .upstream = "oppo-us-research/SpacetimeGaussians 427abfc", .options = options, .probe = probe,
    .frame = spacetimegs_frame, .splats_4d = spacetimegs_splats_4d)
