/* SpacetimeGaussians (Li et al., CVPR 2024), lite and full: Gaussians on cubic paths, whose quaternions
 * change linearly and whose opacity is a bell in time.
 *
 * The bell is exp(-x^2), without a half, and its width is stored as a logarithm. Colours of the lite model
 * are RGB, not SH. The full model has no colours of Gaussians: its rasteriser blends nine features, and a
 * network makes the colour of a pixel from these and from the ray. Imported is the colour of a pixel that
 * one Gaussian covers alone, seen from the cameras: lib/pixel_decoder.h. */
#include "spin.h"
#include <stdlib.h>
#include <string.h>

#include "base/text.h"
#include "importers/lib/gaussian4d.h"
#include "importers/lib/model_folder.h"
#include "importers/lib/notes.h"
#include "importers/lib/pixel_decoder.h"
#include "math/quat.h"

/* Places in a row of a Gaussian's values. */
enum {
    PLACE = 0, /* at its own time */
    TIME = 3,
    WIDTH = 4,   /* natural logarithm */
    MOTION = 5,  /* linear, quadratic, cubic: x y z each */
    LOGIT = 14,  /* of the opacity at its own time */
    SCALE = 15,  /* natural logarithms */
    TURN = 18,   /* quaternion at its own time */
    CHANGE = 22, /* of the quaternion per unit of time */
    COLOUR = 26, /* full: the base colour, then 3 features of the view */
    FEATURE = 32 /* full: 3 features per unit of time */
};

/* Properties of a cloud: one by its name, or prefix0, prefix1, ... */
static const struct group {
    const char *name;
    int n[2]; /* lite, full; 0: one, without a number */
    int at;
} groups[] = {
    {"x", {0, 0}, PLACE},          {"y", {0, 0}, PLACE + 1},
    {"z", {0, 0}, PLACE + 2},      {"trbf_center", {0, 0}, TIME},
    {"trbf_scale", {0, 0}, WIDTH}, {"motion_", {9, 9}, MOTION},
    {"opacity", {0, 0}, LOGIT},    {"scale_", {3, 3}, SCALE},
    {"rot_", {4, 4}, TURN},        {"omega_", {4, 4}, CHANGE},
    {"f_dc_", {3, 6}, COLOUR},     {"f_t_", {-1, 3}, FEATURE}, /* -1: none */
};
enum { N_GROUPS = sizeof groups / sizeof *groups, LITE_WIDTH = 29, FULL_WIDTH = 35 };

/* How the network of the full model ends, by the option rgbfunction of the method. */
static const struct {
    const char *name;
    enum pixel_ending ending;
} endings[] = {
    {"sandwich", PIXEL_SIGMOID}, {"sandwichnoact", PIXEL_CLAMP}, {"sandwichnoactss", PIXEL_AS_IS}};
enum { N_ENDINGS = sizeof endings / sizeof *endings };

struct model {
    char *cloud, *decoder; /* paths; decoder NULL: there is none */
    size_t n, n_dropped;
    bool full;
    size_t width;                 /* of a row */
    float *rows;                  /* [n][width] */
    struct pixel_decoder colours; /* full; without its network there are base colours only */
    double duration;              /* frames that the run was trained on; 0: not known */
    bool warned_time;
    struct mlp_team team;
};

/* ---- Recognising ----------------------------------------------------------------------------- */

static bool in_head(const struct spin_peek *peek, const char *word)
{
    return memmem(peek->head, peek->n_head, word, strlen(word)) != NULL;
}

static int probe(const struct spin_peek *peek)
{
    bool cloud = false;

    /* A cloud, or the folder of one save: any PLY is a cloud to another importer, which says 90. */
    if (in_head(peek, "property float trbf_center") && in_head(peek, "property float motion_8") &&
        in_head(peek, "property float omega_3"))
        return 100;
    if (!peek->is_folder && in_head(peek, "mlp1.weight") && in_head(peek, "mlp2.weight") &&
        spin_text_ends(peek->path, ".pt"))
        return 80;
    for (size_t i = 0; peek->is_folder && peek->names && peek->names[i]; i++)
        cloud = cloud || strcmp(peek->names[i], "point_cloud") == 0;
    return cloud && in_head(peek, "trbfslinit=") ? 90 : 0; /* an option of the method */
}

/* ---- The cloud ------------------------------------------------------------------------------- */

/* f_dc_* and f_t_* tell lite from full. */
static spin_status check_colours(const struct spin_ply *ply, const struct spin_ply_element *e,
                                 struct model *m)
{
    int n_dc = spin_model_folder_count(e, "f_dc_"), n_t = spin_model_folder_count(e, "f_t_");

    m->full = n_t > 0;
    m->width = m->full ? FULL_WIDTH : LITE_WIDTH;
    if (spin_model_folder_count(e, "f_rest_") > 0)
        return spin_fail(
            SPIN_E_UNSUPPORTED,
            "'%s': properties f_rest_*: a fork of SpacetimeGaussians with SH, which is "
            "not read",
            ply->path);
    if (!(n_dc == 3 && n_t == 0) && !(n_dc == 6 && n_t == 3))
        return spin_fail(
            SPIN_E_MALFORMED,
            "'%s': %d properties f_dc_* and %d f_t_*, expected 3 and 0 (lite) or 6 and 3 "
            "(full)",
            ply->path, n_dc, n_t);
    return SPIN_OK;
}

/* The properties of a group into `target`; returns how many. 0 with *status set when one lacks. */
static size_t bind_group(const struct spin_ply *ply, const struct spin_ply_element *e,
                         const struct group *g, struct model *m, struct spin_ply_target *target,
                         spin_status *status)
{
    int n = g->n[m->full], found = n > 0 ? spin_model_folder_count(e, g->name) : 0;

    *status = SPIN_OK;
    if (n < 0)
        return 0;
    if (n > 0 && found != n)
        *status = spin_fail(SPIN_E_MALFORMED,
                            "'%s': %d properties %s*, expected %d as SpacetimeGaussians has",
                            ply->path, found, g->name, n);
    for (int i = 0; *status == SPIN_OK && i < (n > 0 ? n : 1); i++) {
        char name[32];

        snprintf(name, sizeof name, n > 0 ? "%s%d" : "%s", g->name, i);
        target[i] = (struct spin_ply_target){spin_ply_find(e, name), m->rows + g->at + i, m->width};
        if (target[i].property < 0)
            *status = spin_fail(
                SPIN_E_MALFORMED,
                "'%s': element 'vertex' has no property '%s', which SpacetimeGaussians has",
                ply->path, name);
    }
    return *status == SPIN_OK ? (size_t)(n > 0 ? n : 1) : 0;
}

/* Far below the largest float, wherever in 0..1 it is asked for. */
static bool stays_in_range(const float *row)
{
    double d = fmax(fabs((double)row[TIME]), fabs(1 - (double)row[TIME]));

    for (int c = 0; c < 3; c++) {
        const float *m = row + MOTION + c;
        double most = fabs((double)row[PLACE + c]) +
                      d * (fabs((double)m[0]) + d * (fabs((double)m[3]) + d * fabs((double)m[6])));

        if (!(most < 1e18) || row[SCALE + c] > 80)
            return false;
    }
    return true;
}

/* Rows with a value that is not finite, now or later, go; the others keep their order. */
static void drop_rows(struct model *m)
{
    size_t kept = 0;

    for (size_t i = 0; i < m->n; i++) {
        const float *row = m->rows + m->width * i;
        bool good = true;

        for (size_t k = 0; k < m->width; k++)
            good = good && isfinite(row[k]);
        if (good && stays_in_range(row))
            memmove(m->rows + m->width * kept++, row, m->width * sizeof *row);
    }
    m->n_dropped = m->n - kept;
    m->n = kept;
}

/* Forks add columns, whose meaning is not known. */
static void note_others(const struct spin_ply *ply, const struct spin_ply_element *e,
                        const struct model *m, struct spin_sequence_info *sequence)
{
    static const char *const normals[] = {"nx", "ny", "nz"};
    const char *first = NULL;
    size_t n = 0;

    for (size_t p = 0; p < e->n_properties; p++) {
        const char *name = e->property[p].name;
        bool known = false;

        for (int i = 0; i < 3; i++)
            known = known || strcmp(name, normals[i]) == 0;
        for (int g = 0; g < N_GROUPS; g++)
            known = known || (groups[g].n[m->full] > 0
                                  ? strncmp(name, groups[g].name, strlen(groups[g].name)) == 0
                                  : groups[g].n[m->full] == 0 && strcmp(name, groups[g].name) == 0);
        n += !known;
        first = known || first ? first : name;
    }
    if (n == 0)
        return;
    spin_note(sequence,
              "%zu properties that SpacetimeGaussians has not, the first is '%s': a fork of it "
              "may mean something else",
              n, first);
    spin_warn("'%s': property '%s' is none of SpacetimeGaussians and is not read", ply->path,
              first);
}

static spin_status read_cloud(struct model *m, struct spin_sequence_info *sequence)
{
    const struct spin_ply_element *e;
    struct spin_ply_target target[FULL_WIDTH];
    size_t n_targets = 0;
    struct spin_ply ply;
    spin_status status;

    SPIN_TRY(spin_model_folder_open(m->cloud, &ply, &e));
    SPIN_TRY_OUT(check_colours(&ply, e, m));
    m->n = (size_t)e->count;
    SPIN_TRY_OUT(spin_alloc(m->n, m->width * sizeof *m->rows, (void **)&m->rows));
    for (int g = 0; g < N_GROUPS; g++) {
        n_targets += bind_group(&ply, e, &groups[g], m, target + n_targets, &status);
        SPIN_TRY_OUT(status);
    }
    spin_ply_columns(&ply, e, target, n_targets);
    drop_rows(m);
    if (m->n == 0)
        SPIN_TRY_OUT(spin_fail(SPIN_E_MALFORMED, "'%s': none of %zu Gaussians has finite values",
                               m->cloud, m->n_dropped));
    note_others(&ply, e, m, sequence);
out:
    spin_ply_close(&ply);
    return status;
}

/* ---- Settings -------------------------------------------------------------------------------- */

/* K of a source_path that ends in colmap_<K>, the first frame of the run; -1: it does not. */
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

static spin_status read_duration(const struct cfg_args *cfg,
                                 const struct spin_plugin_values *values, struct model *m)
{
    const char *given = spin_plugin_value(values, "duration", NULL);
    double n = 0;

    SPIN_TRY(spin_cfg_read_number(cfg, "duration", &n));
    if (given && !spin_cfg_number((struct cfg_span){given, given + strlen(given)}, &n))
        n = -1;
    m->duration = n;
    if ((n >= 1 && n <= 1e6 && n == floor(n)) || (n == 0 && !given))
        return SPIN_OK;
    if (given)
        return spin_fail(SPIN_E_USAGE, "--duration '%s': expected a number of frames", given);
    return spin_fail(SPIN_E_MALFORMED, "'%s': 'duration' is %g, expected a number of frames",
                     cfg->path, n);
}

static spin_status read_ending(const struct cfg_args *cfg, const struct spin_plugin_values *values,
                               struct model *m)
{
    const char *given = spin_plugin_value(values, "rgb-function", NULL);
    struct cfg_span s = spin_cfg_get(cfg, "rgbfunction");

    if (given)
        s = (struct cfg_span){given, given + strlen(given)};
    else if (s.at && s.end - s.at > 2) /* its quotes */
        s = (struct cfg_span){s.at + 1, s.end - 1};
    for (int i = 0; i < N_ENDINGS; i++) {
        m->colours.ending = endings[i].ending;
        if (spin_cfg_is(s, endings[i].name))
            return SPIN_OK;
    }
    if (given)
        return spin_fail(SPIN_E_USAGE,
                         "--rgb-function '%s': expected sandwich, sandwichnoact or sandwichnoactss",
                         given);
    return spin_fail(
        SPIN_E_UNSUPPORTED,
        "'%s': a full model, and %s%s how its colours end: say --rgb-function sandwich "
        "(sigmoid), sandwichnoact (0 to 1) or sandwichnoactss (none)",
        m->cloud, cfg->path ? "no 'rgbfunction' that is known says in " : "no cfg_args says",
        cfg->path ? cfg->path : "");
}

/* ---- Colours of the full model --------------------------------------------------------------- */

static spin_status find_cameras(const char *path, const char *save,
                                const struct spin_plugin_values *values, struct model *m)
{
    const char *given = spin_plugin_value(values, "camera", NULL);
    char *file = NULL;
    spin_status status;

    if (given)
        return spin_camera_places_parse(given, &m->colours.cameras);
    SPIN_TRY(spin_model_folder_beside(path, save, "cameras.json", &file));
    status = file ? spin_camera_places_load(file, &m->colours.cameras) : SPIN_OK;
    free(file);
    return status;
}

/* What the full model's colours become: of the network, or without it the base colours. */
static spin_status settle_colours(const char *path, const char *save, const struct cfg_args *cfg,
                                  const struct spin_plugin_values *values, struct model *m,
                                  struct spin_sequence_info *sequence)
{
    const char *colour = spin_plugin_value(values, "colour", "auto");
    bool base = strcmp(colour, "base") == 0, views = strcmp(colour, "views") == 0;
    const char *lack = "was asked for";

    if (!base && !views && strcmp(colour, "auto") != 0)
        return spin_fail(SPIN_E_USAGE, "--colour '%s': expected auto, views or base", colour);
    if (!m->full)
        return views ? spin_fail(SPIN_E_USAGE, "--colour views: '%s' is of a lite model", m->cloud)
                     : SPIN_OK;
    SPIN_TRY(read_ending(cfg, values, m));
    if (!base) {
        SPIN_TRY(find_cameras(path, save, values, m));
        lack = !m->decoder ? "there is no point_cloud.pt beside the cloud"
                           : "there is no cameras.json: --camera says where they stand";
        base = !m->decoder || m->colours.cameras.n == 0;
        if (base && views)
            return spin_fail(SPIN_E_NOT_FOUND, "--colour views: '%s': %s", m->cloud, lack);
        if (base)
            spin_warn("'%s': base colours only, as %s", m->cloud, lack);
    }
    if (base)
        spin_note(sequence,
                  "full model: its network colours pixels, by what is blended and by the ray; "
                  "imported are the base colours, which it adds to (%s)",
                  lack);
    else
        spin_note(sequence,
                  "full model: its network colours pixels, by what is blended and by the ray; "
                  "imported is the colour of a pixel that one Gaussian covers alone, seen from %d "
                  "cameras, as SH of degree 1",
                  m->colours.cameras.n);
    return base ? SPIN_OK : spin_pixel_decoder_load(m->decoder, &m->colours);
}

/* ---- Opening --------------------------------------------------------------------------------- */

/* The cloud and the network beside it. `path` is what holds a save, or one of the two files. */
static spin_status find_files(const char *path, const char *wanted, struct model *m, char **save)
{
    size_t n = strlen(path);

    if (!spin_path_is_folder(path)) {
        bool network = spin_text_ends(path, ".pt");

        if (!network && !spin_text_ends(path, ".ply"))
            return spin_fail(SPIN_E_USAGE, "'%s' is neither the model's folder nor a PLY of it",
                             path);
        n -= network ? 3 : 4;
        SPIN_TRY(spin_alloc(n + 5, 1, (void **)&m->cloud));
        SPIN_TRY(spin_alloc(n + 4, 1, (void **)&m->decoder));
        snprintf(m->cloud, n + 5, "%.*s.ply", (int)n, path);
        snprintf(m->decoder, n + 4, "%.*s.pt", (int)n, path);
        SPIN_TRY(spin_path_folder(path, save));
    } else {
        SPIN_TRY(spin_model_folder_save(path, wanted, "point_cloud.ply", save));
        if (!*save)
            return spin_fail(SPIN_E_NOT_FOUND, "'%s' has no iteration_%s with point_cloud.ply",
                             path, wanted ? wanted : "<N>");
        SPIN_TRY(spin_path_join(*save, "point_cloud.ply", &m->cloud));
        SPIN_TRY(spin_path_join(*save, "point_cloud.pt", &m->decoder));
    }
    if (!spin_path_exists(m->decoder)) {
        free(m->decoder);
        m->decoder = NULL;
    }
    return SPIN_OK;
}

static void describe(struct model *m, const struct cfg_args *cfg,
                     struct spin_sequence_info *sequence)
{
    long first = first_frame(spin_cfg_get(cfg, "source_path"));
    struct cfg_span loader = spin_cfg_get(cfg, "loader");
    char from[64] = "";

    sequence->n_frames = 1;
    sequence->identity = true;
    sequence->counts = &m->n;
    sequence->columns = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    sequence->static_columns = SPIN_COL_LOG_SCALES | (m->colours.hidden.n_in > 0 ? 0 : SPIN_COL_SH);
    sequence->sh_degree = m->colours.hidden.n_in > 0 ? 1 : 0;
    sequence->continuous = true;
    sequence->half_open = m->duration == 0;
    sequence->time_last = m->duration > 0 ? (m->duration - 1) / m->duration : 1;
    snprintf(sequence->variant, sizeof sequence->variant, "SpacetimeGaussians, %s, %zu Gaussians",
             m->full ? "full" : "lite", m->n);
    if (first > 0)
        snprintf(from, sizeof from, ", the first is frame %ld of the video", first);
    if (m->duration > 0)
        spin_note(
            sequence,
            "the run has %g frames%s; frame i of them is at time i/%g: with a data set of just "
            "these frames say --frame-times unit",
            m->duration, from, m->duration);
    else
        spin_note(sequence,
                  "no cfg_args says how many frames the run has, 50 are usual: frame i of n "
                  "is at time i/n; --duration N");
    if (m->n_dropped > 0) {
        spin_note(sequence, "%zu of %zu Gaussians dropped: values that are not finite",
                  m->n_dropped, m->n + m->n_dropped);
        spin_warn("'%s': %zu of %zu Gaussians dropped: values that are not finite", m->cloud,
                  m->n_dropped, m->n + m->n_dropped);
    }
    if (spin_cfg_is(loader, "'immersivess'"))
        spin_note(sequence,
                  "trained on fisheye images, which its renderer warps after drawing: these "
                  "Gaussians are those of the pinhole image before that");
}

static spin_status open_model(const char *path, const struct spin_plugin_values *values,
                              struct model *m, struct spin_sequence_info *sequence)
{
    struct cfg_args cfg = {0};
    char *save = NULL;
    spin_status status;

    SPIN_TRY_OUT(find_files(path, spin_plugin_value(values, "iteration", NULL), m, &save));
    SPIN_TRY_OUT(spin_model_folder_cfg(path, save, &cfg));
    SPIN_TRY_OUT(read_duration(&cfg, values, m));
    SPIN_TRY_OUT(read_cloud(m, sequence));
    SPIN_TRY_OUT(settle_colours(path, save, &cfg, values, m, sequence));
    describe(m, &cfg, sequence);
    status = spin_mlp_team_create(PIXEL_SCRATCH, &m->team);
out:
    spin_cfg_close(&cfg);
    free(save);
    return status;
}

static spin_status spacetimegs_open(const char *path, const struct spin_plugin_values *values,
                                    void **self, struct spin_sequence_info *sequence)
{
    *sequence = (struct spin_sequence_info){.sh_degree = -1};
    SPIN_TRY(spin_alloc(1, sizeof(struct model), self));
    return open_model(path, values, *self, sequence);
}

static void spacetimegs_close(void *self)
{
    struct model *m = self;

    if (!m)
        return;
    free(m->cloud);
    free(m->decoder);
    free(m->rows);
    spin_pixel_decoder_free(&m->colours);
    spin_mlp_team_free(&m->team);
    free(m);
}

/* ---- One time -------------------------------------------------------------------------------- */

struct job {
    const struct model *model;
    struct spin_splats *out;
    unsigned columns;
    double time;
};

static void place_at(const float *row, double d, double out[3])
{
    for (int c = 0; c < 3; c++) {
        const float *m = row + MOTION + c;

        out[c] = row[PLACE + c] + d * (m[0] + d * (m[3] + d * (double)m[6]));
    }
}

static void decode(const struct job *job, size_t first, int n, float *scratch)
{
    const struct model *m = job->model;
    struct pixel_splat splat[MLP_BLOCK];

    for (int p = 0; p < MLP_BLOCK; p++) { /* the last one stands for those beyond it */
        const float *row = m->rows + m->width * (first + (size_t)(p < n ? p : n - 1));
        double d = job->time - row[TIME];

        place_at(row, d, splat[p].place);
        for (int i = 0; i < 3; i++) {
            splat[p].base[i] = row[COLOUR + i];
            splat[p].view[i] = row[COLOUR + 3 + i];
            splat[p].time[i] = (float)(d * row[FEATURE + i]);
        }
    }
    spin_pixel_decoder_sh(&m->colours, splat, n, scratch, job->out->sh + 12 * first);
}

/* exp(-(d / width)^2); 1 at its top however narrow it is. */
static double weight_at(const float *row, double d)
{
    double x = d / exp((double)row[WIDTH]);

    return d == 0 ? 1 : exp(-x * x);
}

static void evaluate_row(const struct job *job, size_t i)
{
    const struct model *m = job->model;
    const float *row = m->rows + m->width * i;
    struct spin_splats *out = job->out;
    double d = job->time - row[TIME], place[3];

    if (job->columns & SPIN_COL_MEANS) {
        place_at(row, d, place);
        for (size_t c = 0; c < 3; c++)
            out->means[3 * i + c] = (float)place[c];
    }
    if (job->columns & SPIN_COL_QUATS) { /* without length: no rotation, as the method draws it */
        for (size_t c = 0; c < 4; c++)
            out->quats[4 * i + c] = (float)(row[TURN + c] + d * row[CHANGE + c]);
        spin_quat_normalise(out->quats + 4 * i);
    }
    if (job->columns & SPIN_COL_LOG_SCALES)
        memcpy(out->log_scales + 3 * i, row + SCALE, 3 * sizeof *row);
    if (job->columns & SPIN_COL_LOGIT_OPACITIES)
        out->logit_opacities[i] = spin_logit_of(spin_sigmoid_of(row[LOGIT]) * weight_at(row, d));
    if (job->columns & SPIN_COL_SH && m->colours.hidden.n_in == 0)
        for (size_t c = 0; c < 3; c++)
            out->sh[3 * i + c] = m->full ? spin_pixel_base_dc(&m->colours, row[COLOUR + c])
                                         : spin_pixel_dc(row[COLOUR + c]);
}

static void evaluate(void *context, size_t first, int n, float *scratch)
{
    const struct job *job = context;

    for (int p = 0; p < n; p++)
        evaluate_row(job, first + (size_t)p);
    if (job->columns & SPIN_COL_SH && job->model->colours.hidden.n_in > 0)
        decode(job, first, n, scratch);
}

static spin_status spacetimegs_frame(void *self, int frame, double time, unsigned columns,
                                     struct spin_splats *out)
{
    struct model *m = self;
    struct job job = {m, out, columns & (SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES), time};

    (void)frame;
    if (!isfinite(time))
        return spin_fail(SPIN_E_USAGE, "'%s' has no time %g", m->cloud, time);
    if ((time < 0 || time > 1) && !m->warned_time) {
        m->warned_time = true;
        spin_warn("'%s': time %g is outside of 0 to 1, for which it was trained", m->cloud, time);
    }
    SPIN_TRY(spin_splats_reserve(out, m->n, job.columns, m->colours.hidden.n_in > 0 ? 1 : 0));
    spin_mlp_team_run(&m->team, m->n, evaluate, &job);
    return spin_model_folder_check(m->cloud, time, job.columns, out);
}

static const struct spin_plugin_option options[] = {
    {"iteration", "N", "which save to read; the last when not given", NULL},
    {"duration", "N", "frames that the run was trained on, instead of what cfg_args says", NULL},
    {"colour", "auto|views|base",
     "full model: as its network colours Gaussians for the cameras, or base colours only", "auto"},
    {"camera", "X,Y,Z[;...]", "full model: where cameras stand, instead of what cameras.json says",
     NULL},
    {"rgb-function", "NAME",
     "full model: sandwich, sandwichnoact or sandwichnoactss, instead of what cfg_args says", NULL},
    {NULL, NULL, NULL, NULL},
};

const struct spin_importer spin_importer_spacetimegs = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "spacetimegs",
    .summary = "SpacetimeGaussians, lite and full: the model's folder, or its point_cloud.ply",
    .upstream = "oppo-us-research/SpacetimeGaussians 427abfc",
    .options = options,
    .probe = probe,
    .open = spacetimegs_open,
    .frame = spacetimegs_frame,
    .close = spacetimegs_close,
};
