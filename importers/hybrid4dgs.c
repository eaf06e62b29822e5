/* Hybrid 3D-4DGS (Oh et al., 2025): a fork of Realtime-4DGS whose Gaussians of long life become static ones
 * in training. A checkpoint holds both: those of Realtime-4DGS, and 3-D ones that are there at all times.
 *
 * The PLY that a run leaves as well looks like a cloud of 3DGS and is none: it has the dynamic half only,
 * every Gaussian at its own time. */
#include "spin.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "importers/lib/chkpnt.h"
#include "importers/lib/gaussian4d.h"
#include "importers/lib/notes.h"
#include "importers/lib/realtime4dgs_rows.h"
#include "importers/lib/run_config.h"
#include "io/torch.h"

/* The renderer skips a Gaussian whose weight in time is not above this. */
#define LEAST_WEIGHT 0.05
/* Initial times are drawn from the clip and 10% beyond both its ends. */
#define SPREAD 1.2

enum { N_ITEMS = 28 };

/* The two halves, in the order of the method's renderer. */
enum { MOVING, STILL, N_HALVES };

struct model {
    struct spin_torch torch;
    bool torch_open;
    char *path;
    struct run_config settings;
    struct realtime4dgs_parts parts[N_HALVES];
    struct realtime4dgs_rows rows[N_HALVES];
    struct gaussian4d gaussians; /* of both halves; rows count on from one to the other */
    size_t n_moving;             /* of them */
    double ratio;                /* the data set's times over the file's */
    struct clip_times times;
    int degree;
};

/* ---- Recognising ----------------------------------------------------------------------------- */

static int probe(const struct spin_peek *peek)
{
    /* A group of a checkpoint's optimiser; two options of cfg_args, of which one is the method's own. */
    if (spin_chkpnt_says(peek, "static_xyz") && spin_chkpnt_says(peek, "scaling_t"))
        return 95;
    return peek->is_folder && spin_chkpnt_says(peek, "from3dgs=") &&
                   spin_chkpnt_says(peek, "start_timestamp=")
               ? 95
               : 0;
}

/* ---- The halves ------------------------------------------------------------------------------ */

static spin_status take_parts(const struct spin_value *root, struct model *m)
{
    struct realtime4dgs_parts *moving = &m->parts[MOVING], *still = &m->parts[STILL];
    const struct spin_value *model;

    still->who = "static ";
    moving->iteration = -1;
    if (spin_value_get(root, "scaling_t") && spin_value_get(root, "static_xyz")) {
        spin_realtime4dgs_loaded(root, "", moving);
        spin_realtime4dgs_loaded(root, "static_", still);
        moving->moving = true;
        return SPIN_OK;
    }
    SPIN_TRY(spin_chkpnt_model(root, N_ITEMS, "Hybrid 3D-4DGS", &model, &moving->iteration));
    spin_realtime4dgs_items(model, moving);
    if (!moving->rot_4d || moving->rot_4d->kind != SPIN_VALUE_BOOL)
        return spin_fail(SPIN_E_MALFORMED, "item 16 (rot_4d) is %s, expected a bool",
                         spin_chkpnt_kind(moving->rot_4d));
    still->active = moving->active;
    still->xyz = spin_value_at(model, 19);
    still->dc = spin_value_at(model, 20);
    still->rest = spin_value_at(model, 21);
    still->scaling = spin_value_at(model, 22);
    still->rotation = spin_value_at(model, 23);
    still->opacity = spin_value_at(model, 24);
    return SPIN_OK;
}

static bool is_nothing(const struct spin_value *v)
{
    return !v || v->kind == SPIN_VALUE_NONE || spin_chkpnt_is_empty(v);
}

/* A half without Gaussians is None, or empty tensors of any shape; all of them. */
static spin_status check_nothing(const struct realtime4dgs_parts *p)
{
    const struct {
        const struct spin_value *value;
        const char *name;
    } all[] = {{p->dc, "features_dc"},     {p->rest, "features_rest"}, {p->scaling, "scaling"},
               {p->rotation, "rotation"},  {p->opacity, "opacity"},    {p->t, "t"},
               {p->scaling_t, "scaling_t"}};

    for (size_t i = 0; i < sizeof all / sizeof *all; i++) {
        if (!is_nothing(all[i].value))
            return spin_fail(SPIN_E_MALFORMED, "%s%s is not empty, but %sxyz is",
                             p->who ? p->who : "", all[i].name, p->who ? p->who : "");
    }
    return SPIN_OK;
}

static spin_status read_rows(struct model *m)
{
    double sh_degree = -1;

    SPIN_TRY(spin_cfg_read_number(&m->settings.cfg, "sh_degree", &sh_degree));
    for (int h = 0; h < N_HALVES; h++) {
        if (is_nothing(m->parts[h].xyz))
            SPIN_TRY(check_nothing(&m->parts[h]));
        else
            SPIN_TRY(
                spin_realtime4dgs_rows_open(&m->torch, &m->parts[h], true, sh_degree, &m->rows[h]));
    }
    if (m->rows[MOVING].n == 0 && m->rows[STILL].n == 0)
        return spin_fail(SPIN_E_MALFORMED, "0 Gaussians");
    m->degree = m->rows[m->rows[MOVING].n > 0 ? MOVING : STILL].degree;
    if (m->rows[MOVING].n == 0 || m->rows[STILL].n == 0)
        return SPIN_OK;
    if (m->rows[MOVING].n_sh != m->rows[STILL].n_sh)
        return spin_fail(SPIN_E_MALFORMED,
                         "dynamic Gaussians have %d rows of SH and static ones %d, expected the "
                         "same",
                         m->rows[MOVING].n_sh, m->rows[STILL].n_sh);
    if (!m->rows[MOVING].rot_4d)
        return spin_fail(SPIN_E_MALFORMED,
                         "there are static Gaussians, which are made of 4-D rotations, but rot_4d "
                         "is false");
    return SPIN_OK;
}

static spin_status add_rows(struct model *m, struct spin_sequence_info *sequence)
{
    static const struct realtime4dgs_reading reading = {false, false, 0};
    size_t n_moving = m->rows[MOVING].n, n_still = m->rows[STILL].n, n_faint, n_dropped;

    SPIN_TRY(spin_gaussian4d_reserve(&m->gaussians, n_moving + n_still));
    n_faint = spin_realtime4dgs_rows_add(&m->rows[MOVING], 0, &reading, &m->gaussians);
    m->n_moving = m->gaussians.n;
    n_dropped = m->gaussians.n_dropped;
    n_faint += spin_realtime4dgs_rows_add(&m->rows[STILL], n_moving, &reading, &m->gaussians);
    if (n_dropped > 0)
        spin_note(sequence, "%zu of %zu dynamic Gaussians are dropped: values that are not finite",
                  n_dropped, n_moving);
    if (m->gaussians.n_dropped > n_dropped)
        spin_note(
            sequence,
            "%zu of %zu static Gaussians are dropped: values that are not finite; the method's "
            "own conversion makes such rotations, and its renderer skips them",
            m->gaussians.n_dropped - n_dropped, n_still);
    return spin_gaussian4d_check(&m->gaussians, n_moving + n_still, n_faint, NULL, sequence);
}

/* ---- Opening --------------------------------------------------------------------------------- */

static spin_status find_checkpoint(const char *path, struct model *m,
                                   struct spin_sequence_info *sequence)
{
    char *clouds = NULL;
    bool ply;

    SPIN_TRY(spin_chkpnt_find(path, &m->path, sequence));
    if (m->path)
        return SPIN_OK;
    SPIN_TRY(spin_path_join(path, "point_cloud", &clouds));
    ply = spin_path_exists(clouds);
    free(clouds);
    return spin_fail(SPIN_E_NOT_FOUND, "'%s' holds no chkpnt<N>.pth%s", path,
                     ply ? "; its point_cloud.ply cannot replace it: it has the dynamic half only, "
                           "without times and "
                           "turned wrong, and cannot stand for it"
                         : "");
}

static void describe(struct model *m, struct spin_sequence_info *sequence)
{
    const struct spin_value *env = m->parts[MOVING].env_map;
    bool in_time = m->rows[MOVING].degree_t > 0;
    char iteration[48] = "";

    sequence->n_frames = 1;
    sequence->continuous = m->n_moving > 0;
    sequence->time_first = m->times.first;
    sequence->time_last = m->times.last;
    sequence->columns = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    sequence->sh_degree = m->degree;
    if (m->n_moving == 0)
        sequence->counts = &m->gaussians.n;
    if (m->parts[MOVING].iteration >= 0)
        snprintf(iteration, sizeof iteration, ", iteration %.0f", m->parts[MOVING].iteration);
    snprintf(sequence->variant, sizeof sequence->variant,
             "Hybrid 3D-4DGS%s, %zu dynamic and %zu static Gaussians, SH degree %d%s", iteration,
             m->rows[MOVING].n, m->rows[STILL].n, m->degree, in_time ? " with time" : "");
    if (m->times.guessed)
        spin_note(sequence,
                  "time_duration is not in the run's folder: assumed %g,%g, as the Gaussians' "
                  "own times run%s; --time-duration or --config sets it",
                  m->times.first, m->times.last, in_time ? ", and colours depend on it" : "");
    if (env && env->kind == SPIN_VALUE_TENSOR && !spin_chkpnt_is_empty(env))
        spin_note(sequence,
                  "the environment map is not imported: windows and far background are missing");
}

static spin_status open_model(struct model *m, const struct spin_plugin_values *values,
                              struct spin_sequence_info *sequence)
{
    SPIN_TRY(spin_torch_open(m->path, &m->torch));
    m->torch_open = true;
    SPIN_TRY(take_parts(m->torch.root, m));
    SPIN_TRY(spin_run_config_open(m->path, spin_plugin_value(values, "config", NULL),
                                  "time_duration", &m->settings));
    SPIN_TRY(spin_run_config_ratio(&m->settings, &m->ratio));
    SPIN_TRY(read_rows(m));
    SPIN_TRY(add_rows(m, sequence));
    for (int h = 0; h < N_HALVES; h++)
        spin_realtime4dgs_rows_free(&m->rows[h]);
    if (m->n_moving > 0)
        SPIN_TRY(
            spin_run_config_times(&m->settings, spin_plugin_value(values, "time-duration", NULL),
                                  m->gaussians.time, m->n_moving, m->ratio, SPREAD, &m->times));
    describe(m, sequence);
    return SPIN_OK;
}

static spin_status hybrid4dgs_open(const char *path, const struct spin_plugin_values *values,
                                   void **self, struct spin_sequence_info *sequence)
{
    struct model *m;

    *sequence = (struct spin_sequence_info){.sh_degree = -1};
    SPIN_TRY(spin_alloc(1, sizeof *m, self));
    m = *self;
    SPIN_TRY(find_checkpoint(path, m, sequence));
    return spin_fail_reading(open_model(m, values, sequence), m->path);
}

static void hybrid4dgs_close(void *self)
{
    struct model *m = self;

    if (!m)
        return;
    if (m->torch_open)
        spin_torch_close(&m->torch);
    spin_run_config_close(&m->settings);
    spin_gaussian4d_free(&m->gaussians);
    for (int h = 0; h < N_HALVES; h++)
        spin_realtime4dgs_rows_free(&m->rows[h]);
    free(m->path);
    free(m);
}

/* ---- One time -------------------------------------------------------------------------------- */

static spin_status hybrid4dgs_frame(void *self, int frame, double time, unsigned columns,
                                    struct spin_splats *out)
{
    struct model *m = self;
    struct gaussian4d *g = &m->gaussians;
    size_t width = 3 * (size_t)((m->degree + 1) * (m->degree + 1)), n_moving = m->rows[MOVING].n;

    if (frame < 0)
        return spin_fail(SPIN_E_NOT_FOUND, "'%s' has no frame %d", m->path, frame);
    columns &= SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    time = m->n_moving > 0 ? time / m->ratio : 0;
    spin_gaussian4d_select(g, time, LEAST_WEIGHT, 0);
    SPIN_TRY(spin_splats_reserve(out, g->n_kept, columns, m->degree));
    spin_gaussian4d_fill(g, time, columns, out);
    for (size_t k = 0; k < g->n_kept && (columns & SPIN_COL_SH); k++) {
        size_t i = g->kept[k], row = g->row[i];
        bool still = row >= n_moving;

        spin_realtime4dgs_colours(&m->rows[still ? STILL : MOVING], still ? row - n_moving : row,
                                  time - g->time[i], (m->times.last - m->times.first) / m->ratio,
                                  out->sh + width * k);
    }
    return SPIN_OK;
}

static const struct spin_plugin_option options[] = {
    {"time-duration", "A,B", "the clip's first and last time, as in the training YAML", NULL},
    {"config", "FILE", "the training YAML (the one beside the checkpoint)", NULL},
    {NULL, NULL, NULL, NULL},
};

const struct spin_importer spin_importer_hybrid4dgs = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "hybrid4dgs",
    .summary = "Hybrid 3D-4DGS: chkpnt<N>.pth, or the folder it lies in",
    .upstream = "ohsngjun/3D-4DGS 9528828",
    .options = options,
    .probe = probe,
    .open = hybrid4dgs_open,
    .frame = hybrid4dgs_frame,
    .close = hybrid4dgs_close,
};
