/* Hybrid 3D-4DGS (Oh et al., 2025): a fork of Realtime-4DGS whose Gaussians of long life become static ones
 * in training. A checkpoint holds both: those of Realtime-4DGS, and 3-D ones that are there at all times.
 *
 * The PLY that a run leaves as well looks like a cloud of 3DGS and is none: it has the dynamic half only,
 * every Gaussian at its own time. */
#include "importers/lib/chkpnt.h"
#include "importers/lib/realtime4dgs.h"

enum { N_ITEMS = 28 };

/* The two halves, in the order of the method's renderer. */
enum { MOVING, STILL, N_HALVES };

struct model {
    struct spin_model base;
    struct realtime4dgs half[N_HALVES];
    struct gaussian4d gaussians; /* of both halves; rows count on from one to the other */
    size_t n_moving;             /* of them */
    double ratio;                /* the data set's times over the file's */
    struct clip_times times;
};

/* ---- Recognising ----------------------------------------------------------------------------- */

static int probe(const struct spin_peek *peek)
{
    /* A group of a checkpoint's optimiser; two options of cfg_args, of which one is the method's own. */
    if (spin_peek_says(peek, "static_xyz") && spin_peek_says(peek, "scaling_t"))
        return 95;
    return peek->is_folder && spin_peek_says(peek, "from3dgs=") &&
                   spin_peek_says(peek, "start_timestamp=")
               ? 95
               : 0;
}

/* ---- The halves ------------------------------------------------------------------------------ */

static spin_status take_parts(const struct spin_value *root, struct model *m)
{
    struct realtime4dgs *moving = &m->half[MOVING], *still = &m->half[STILL];
    const struct spin_value *model, *rot_4d;

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
    rot_4d = moving->part[R4_ROT_4D];
    if (!rot_4d || rot_4d->kind != SPIN_VALUE_BOOL)
        return spin_fail(SPIN_E_MALFORMED, "item 16 (rot_4d) is %s, expected a bool",
                         spin_chkpnt_kind(rot_4d));
    still->part[R4_ACTIVE] = moving->part[R4_ACTIVE];
    for (int p = R4_XYZ; p <= R4_OPACITY; p++)
        still->part[p] = spin_value_at(model, (size_t)(19 + p - R4_XYZ));
    return SPIN_OK;
}

/* A half without Gaussians is None, or empty tensors of any shape; all of them. */
static spin_status check_nothing(const struct realtime4dgs *r)
{
    const char *who = r->who ? r->who : "";

    for (int p = R4_DC; p <= R4_SCALING_T; p++) {
        if (!spin_realtime4dgs_lacks(r, p))
            return spin_fail(SPIN_E_MALFORMED, "%s%s is not empty, but %sxyz is", who,
                             spin_realtime4dgs_name(p), who);
    }
    return SPIN_OK;
}

static spin_status read_rows(struct model *m)
{
    const struct realtime4dgs *moving = &m->half[MOVING], *still = &m->half[STILL];

    for (int h = 0; h < N_HALVES; h++) {
        if (spin_realtime4dgs_lacks(&m->half[h], R4_XYZ))
            SPIN_TRY(check_nothing(&m->half[h]));
        else
            SPIN_TRY(spin_realtime4dgs_read(&m->base, true, &m->half[h]));
    }
    if (moving->n == 0 && still->n == 0)
        return spin_fail(SPIN_E_MALFORMED, "0 Gaussians");
    m->gaussians.sh_degree = moving->n > 0 ? moving->degree : still->degree;
    if (moving->n == 0 || still->n == 0)
        return SPIN_OK;
    if (moving->n_sh != still->n_sh)
        return spin_fail(SPIN_E_MALFORMED,
                         "dynamic Gaussians have %d rows of SH and static ones %d, expected the "
                         "same",
                         moving->n_sh, still->n_sh);
    if (!moving->rot_4d)
        return spin_fail(SPIN_E_MALFORMED,
                         "there are static Gaussians, which are made of 4-D rotations, but rot_4d "
                         "is false");
    return SPIN_OK;
}

static spin_status add_rows(struct model *m)
{
    static const struct realtime4dgs_reading reading = {false, false, 0};
    struct spin_sequence_info *sequence = m->base.sequence;
    size_t n_moving = m->half[MOVING].n, n_still = m->half[STILL].n, n_faint, n_dropped;

    SPIN_TRY(spin_gaussian4d_reserve(&m->base, &m->gaussians, n_moving + n_still));
    n_faint = spin_realtime4dgs_add(&m->half[MOVING], 0, &reading, &m->gaussians);
    m->n_moving = m->gaussians.n;
    n_dropped = m->gaussians.n_dropped;
    n_faint += spin_realtime4dgs_add(&m->half[STILL], n_moving, &reading, &m->gaussians);
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

static void describe(const struct model *m)
{
    const struct realtime4dgs *moving = &m->half[MOVING];
    struct spin_sequence_info *sequence = m->base.sequence;
    char iteration[48];

    spin_gaussian4d_describe(&m->gaussians, &m->times, sequence);
    sequence->continuous = m->n_moving > 0;
    sequence->counts = m->n_moving > 0 ? NULL : &m->gaussians.n;
    snprintf(sequence->variant, sizeof sequence->variant,
             "Hybrid 3D-4DGS%s, %zu dynamic and %zu static Gaussians, SH degree %d%s",
             spin_realtime4dgs_iteration(moving, iteration), moving->n, m->half[STILL].n,
             m->gaussians.sh_degree, moving->degree_t > 0 ? " with time" : "");
    spin_realtime4dgs_note(moving, &m->times, sequence);
}

static spin_status open_checkpoint(struct model *m)
{
    struct spin_model *base = &m->base;

    SPIN_TRY(spin_torch_open(base->path, &base->torch));
    SPIN_TRY(take_parts(base->torch.root, m));
    SPIN_TRY(spin_run_config_open(base->path, spin_model_option(base, "config"), "time_duration",
                                  &base->settings));
    SPIN_TRY(spin_run_config_ratio(&base->settings, &m->ratio));
    SPIN_TRY(read_rows(m));
    SPIN_TRY(add_rows(m));
    if (m->n_moving > 0)
        SPIN_TRY(spin_run_config_times(&base->settings, spin_model_option(base, "time-duration"),
                                       m->gaussians.time, m->n_moving, m->ratio,
                                       REALTIME4DGS_SPREAD, &m->times));
    describe(m);
    return SPIN_OK;
}

static spin_status open_model(void *self, const char *path)
{
    struct model *m = self;

    m->gaussians.least_weight = REALTIME4DGS_LEAST_WEIGHT;
    SPIN_TRY(spin_chkpnt_find(&m->base, path));
    if (!m->base.path)
        return spin_fail(
            SPIN_E_NOT_FOUND, "'%s' holds no chkpnt<N>.pth%s", path,
            spin_model_holds(path, "point_cloud")
                ? "; its point_cloud.ply cannot replace it: it has the dynamic half only, "
                  "without times and "
                  "turned wrong, and cannot stand for it"
                : "");
    return spin_fail_reading(open_checkpoint(m), m->base.path);
}

SPIN_MODEL_OPEN(hybrid4dgs_open, struct model, open_model)

/* ---- One time -------------------------------------------------------------------------------- */

static void colour(const void *model, size_t i, double dt, float *out)
{
    const struct model *m = model;
    size_t row = m->gaussians.row[i], n_moving = m->half[MOVING].n;
    bool still = row >= n_moving;

    spin_realtime4dgs_colours(&m->half[still ? STILL : MOVING], still ? row - n_moving : row, dt,
                              (m->times.last - m->times.first) / m->ratio, out);
}

static spin_status hybrid4dgs_frame(void *self, int frame, double time, unsigned columns,
                                    struct spin_splats *out)
{
    struct model *m = self;

    time = m->n_moving > 0 ? time / m->ratio : 0;
    return spin_gaussian4d_frame(&m->base, &m->gaussians, frame, time, columns, colour, out);
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
    .close = spin_model_close,
};
