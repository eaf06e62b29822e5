/* Shape of Motion (Wang et al.): checkpoints/last.ckpt. All foreground splats share a few rigid
 * motions, the motion bases, and each splat blends them with weights of its own. Its translation is
 * the weighted sum of the translations of all bases. Its rotation is found by orthonormalising the
 * weighted sums of the six numbers that describe the rotation of each basis. Background splats are
 * static. Motions are tabulated for each frame and are undefined between frames. */
#include "importers/lib/chkpnt.h"
#include "math/quat.h"
#include "math/sh.h"

enum { MOST_BASES = 4096, MOST_FRAMES = 1000000 };

enum { MEANS, QUATS, SCALES, COLOURS, OPACITIES, N_COLUMNS };

static const struct {
    const char *name;
    int width;
} columns[N_COLUMNS] = {{"means", 3}, {"quats", 4}, {"scales", 3}, {"colors", 3}, {"opacities", 1}};

struct model {
    struct spin_model base;
    size_t n_fore, n_all; /* number of foreground rows, which come first; number of all rows */
    size_t n_bases, n_frames;
    float *column[N_COLUMNS]; /* [n_all][width] values of the file */
    float *weights;           /* [n_fore][n_bases] weights, which sum to 1 in each row */
    float *turns,
        *shifts; /* motions of the bases: [n_bases][n_frames][6] and [n_bases][n_frames][3] */
    size_t *row; /* [n] rows that are kept, ascending */
    size_t n, n_fore_kept;
    size_t *counts; /* [n_frames] number of splats in each frame, which is always n */
};

/* ---- Recognising ----------------------------------------------------------------------------- */

static int probe(const struct spin_peek *peek)
{
    if (peek->is_folder)
        return spin_peek_has(peek, "checkpoints") && spin_peek_has(peek, "cfg.yaml") ? 80
               : spin_peek_has(peek, "last.ckpt")                                    ? 60
                                                                                     : 0;
    return spin_peek_contains(peek, "fg.params.") ||
                   spin_peek_contains(peek, "motion_bases.params.")
               ? 100
               : 0;
}

/* ---- The file -------------------------------------------------------------------------------- */

static spin_status bind_tensor(struct model *m, const char *name, int n_dims, const int64_t *shape,
                               struct spin_array *out)
{
    const struct spin_value *v = spin_model_get(&m->base, "%s", name);

    if (!v || v->kind != SPIN_VALUE_TENSOR)
        return spin_malformed("there is no tensor '%s'", name);
    return spin_chkpnt_bind(&m->base.torch, v, name, n_dims, shape, out);
}

/* Finds the state dict, which is the value of key 'model' or the root of the file. Trainings on
 * several GPUs put "module." before every name. */
static spin_status find_tensors(struct model *m)
{
    struct spin_model *base = &m->base;
    const struct spin_value *inner = spin_value_get(base->torch.root, "model");

    base->tensors = inner ? inner : base->torch.root;
    if (!base->tensors || base->tensors->kind != SPIN_VALUE_DICT)
        return spin_malformed("the file contains %s, expected a dict with the state dict 'model'",
                              spin_chkpnt_kind(base->torch.root));
    if (spin_value_get(base->tensors, "module.fg.params.means"))
        base->prefix = "module.";
    return SPIN_OK;
}

/* Warns about parameters of the foreground that Shape of Motion does not define. */
static void warn_others(const struct model *m)
{
    const struct spin_value *all = m->base.tensors;
    size_t n = strlen(m->base.prefix);

    for (size_t i = 0; i < all->n; i++) {
        const char *key = spin_value_text(all->item[2 * i]);
        bool known = !key || strncmp(key, m->base.prefix, n) != 0 ||
                     strncmp(key + n, "fg.params.", 10) != 0 ||
                     strcmp(key + n + 10, "motion_coefs") == 0;

        for (int c = 0; c < N_COLUMNS && !known; c++)
            known = strcmp(key + n + 10, columns[c].name) == 0;
        if (!known)
            spin_warn("'%s': tensor '%s' does not belong to Shape of Motion and is ignored: the "
                      "run may be of a derived method",
                      m->base.path, key);
    }
}

static bool has_background(const struct model *m)
{
    for (int c = 0; c < N_COLUMNS; c++)
        if (spin_model_get(&m->base, "bg.params.%s", columns[c].name))
            return true;
    return false;
}

/* Reads one part of a column into rows `first` to `first` + n - 1. Opacities may be [n] or [n][1].
 */
static spin_status read_part(struct model *m, const char *part, int column, size_t first, size_t n)
{
    const int64_t shape[2] = {(int64_t)n, columns[column].width};
    const struct spin_value *v;
    struct spin_array t;
    char name[64];
    int n_dims = 2;

    snprintf(name, sizeof name, "%s.params.%s", part, columns[column].name);
    v = spin_model_get(&m->base, "%s", name);
    if (column == OPACITIES && v && v->kind == SPIN_VALUE_TENSOR && v->tensor.n_dims == 1)
        n_dims = 1;
    SPIN_TRY(bind_tensor(m, name, n_dims, shape, &t));
    spin_array_to_f32(&t, 0, t.count, m->column[column] + first * (size_t)columns[column].width);
    return SPIN_OK;
}

static spin_status count_rows(struct model *m, const char *part, size_t *n)
{
    const int64_t shape[2] = {-1, 3};
    struct spin_array t;
    char name[64];

    snprintf(name, sizeof name, "%s.params.means", part);
    SPIN_TRY(bind_tensor(m, name, 2, shape, &t));
    *n = (size_t)t.shape[0];
    return *n <= INT_MAX ? SPIN_OK : spin_unsupported("'%s' has 2^31 or more rows", name);
}

static spin_status load_columns(struct model *m)
{
    bool background = has_background(m);
    size_t n_back = 0;

    SPIN_TRY(count_rows(m, "fg", &m->n_fore));
    if (background)
        SPIN_TRY(count_rows(m, "bg", &n_back));
    m->n_all = m->n_fore + n_back;
    if (m->n_all == 0)
        return spin_malformed("tensor 'fg.params.means' has 0 Gaussians, and there is no "
                              "background");
    for (int c = 0; c < N_COLUMNS; c++) {
        SPIN_TRY(spin_model_alloc(&m->base, m->n_all, (size_t)columns[c].width * sizeof(float),
                                  (void **)&m->column[c]));
        SPIN_TRY(read_part(m, "fg", c, 0, m->n_fore));
        if (background)
            SPIN_TRY(read_part(m, "bg", c, m->n_fore, n_back));
    }
    return SPIN_OK;
}

/* Replaces the coefficients of a row by their softmax, the weights of the bases. */
static void softmax(float *values, size_t n)
{
    double most = -HUGE_VAL, sum = 0;

    for (size_t k = 0; k < n; k++)
        most = (double)values[k] > most ? (double)values[k] : most;
    for (size_t k = 0; k < n; k++)
        sum += exp((double)values[k] - most);
    for (size_t k = 0; k < n; k++)
        values[k] = (float)(exp((double)values[k] - most) / sum);
}

/* Refuses motions with a value that is not finite, since this value would affect all splats of a
 * frame. */
static spin_status check_basis(const struct model *m, const char *name, const float *values,
                               size_t width)
{
    for (size_t i = 0; i < m->n_bases * m->n_frames * width; i++)
        if (!isfinite(values[i]))
            return spin_malformed("tensor '%s' has a value that is not finite for basis %zu in "
                                  "frame %zu, which would affect all splats of the foreground",
                                  name, i / width / m->n_frames, i / width % m->n_frames);
    return SPIN_OK;
}

static spin_status load_bases(struct model *m)
{
    const int64_t turns[3] = {-1, -1, 6};
    int64_t shifts[3] = {0, 0, 3}, weights[2] = {(int64_t)m->n_fore, 0};
    struct spin_array t;

    SPIN_TRY(bind_tensor(m, "motion_bases.params.rots", 3, turns, &t));
    m->n_bases = (size_t)t.shape[0];
    m->n_frames = (size_t)t.shape[1];
    if (m->n_bases < 1 || m->n_bases > MOST_BASES || m->n_frames < 1 || m->n_frames > MOST_FRAMES)
        return spin_malformed("tensor 'motion_bases.params.rots' has %zu bases and %zu frames, "
                              "expected at least one of each",
                              m->n_bases, m->n_frames);
    SPIN_TRY(spin_model_alloc(&m->base, t.count, sizeof(float), (void **)&m->turns));
    spin_array_to_f32(&t, 0, t.count, m->turns);
    shifts[0] = (int64_t)m->n_bases;
    shifts[1] = (int64_t)m->n_frames;
    SPIN_TRY(bind_tensor(m, "motion_bases.params.transls", 3, shifts, &t));
    SPIN_TRY(spin_model_alloc(&m->base, t.count, sizeof(float), (void **)&m->shifts));
    spin_array_to_f32(&t, 0, t.count, m->shifts);
    weights[1] = (int64_t)m->n_bases;
    SPIN_TRY(bind_tensor(m, "fg.params.motion_coefs", 2, weights, &t));
    SPIN_TRY(spin_model_alloc(&m->base, t.count + 1, sizeof(float), (void **)&m->weights));
    spin_array_to_f32(&t, 0, t.count, m->weights);
    for (size_t i = 0; i < m->n_fore; i++)
        softmax(m->weights + m->n_bases * i, m->n_bases);
    SPIN_TRY(check_basis(m, "motion_bases.params.rots", m->turns, 6));
    return check_basis(m, "motion_bases.params.transls", m->shifts, 3);
}

/* ---- Motions --------------------------------------------------------------------------------- */

/* Computes the rotation, whose columns are r[0], r[1] and r[2], and the translation of a foreground
 * row; returns false if the blended numbers are not a rotation. */
static bool motion_of(const struct model *m, size_t row, size_t frame, double r[3][3],
                      double shift[3])
{
    double six[6] = {0}, dot = 0, norms[2] = {0};

    memset(shift, 0, 3 * sizeof *shift);
    for (size_t k = 0; k < m->n_bases; k++) {
        double w = (double)m->weights[m->n_bases * row + k];
        const float *turn = m->turns + 6 * (m->n_frames * k + frame);

        for (int c = 0; c < 6; c++)
            six[c] += w * (double)turn[c];
        for (int c = 0; c < 3; c++)
            shift[c] += w * (double)m->shifts[3 * (m->n_frames * k + frame) + (size_t)c];
    }
    for (int c = 0; c < 3; c++)
        norms[0] += six[c] * six[c];
    norms[0] = sqrt(norms[0]);
    for (int c = 0; c < 3; c++) {
        r[0][c] = six[c] / norms[0];
        dot += r[0][c] * six[3 + c];
    }
    for (int c = 0; c < 3; c++) {
        r[1][c] = six[3 + c] - dot * r[0][c];
        norms[1] += r[1][c] * r[1][c];
    }
    norms[1] = sqrt(norms[1]);
    for (int c = 0; c < 3; c++)
        r[1][c] /= norms[1];
    for (int c = 0; c < 3; c++)
        r[2][c] = r[0][(c + 1) % 3] * r[1][(c + 2) % 3] - r[0][(c + 2) % 3] * r[1][(c + 1) % 3];
    return norms[0] > 1e-12 && norms[1] > 1e-12;
}

/* Sets q to the unit quaternion of the rotation with the columns r[0], r[1] and r[2]. */
static void quat_of(double r[3][3], double q[4])
{
    double diagonal[4] = {r[0][0] + r[1][1] + r[2][2], r[0][0] - r[1][1] - r[2][2],
                          r[1][1] - r[0][0] - r[2][2], r[2][2] - r[0][0] - r[1][1]};
    int best = 0, j, k;

    for (int i = 1; i < 4; i++)
        best = diagonal[i] > diagonal[best] ? i : best;
    q[best] = sqrt(fmax(1 + diagonal[best], 0)) / 2;
    if (best == 0) {
        for (int c = 0; c < 3; c++)
            q[1 + c] = (r[(c + 1) % 3][(c + 2) % 3] - r[(c + 2) % 3][(c + 1) % 3]) / (4 * q[0]);
        return;
    }
    j = best % 3 + 1;
    k = j % 3 + 1;
    q[0] = (r[j - 1][k - 1] - r[k - 1][j - 1]) / (4 * q[best]);
    q[j] = (r[j - 1][best - 1] + r[best - 1][j - 1]) / (4 * q[best]);
    q[k] = (r[k - 1][best - 1] + r[best - 1][k - 1]) / (4 * q[best]);
}

static void multiply_quats(const double a[4], const float b[4], float out[4])
{
    double q[4], length = 0;

    q[0] = a[0] * (double)b[0];
    for (int c = 0; c < 3; c++) {
        int i = 1 + (c + 1) % 3, j = 1 + (c + 2) % 3;

        q[0] -= a[1 + c] * (double)b[1 + c];
        q[1 + c] = a[0] * (double)b[1 + c] + a[1 + c] * (double)b[0] + a[i] * (double)b[j] -
                   a[j] * (double)b[i];
    }
    for (int c = 0; c < 4; c++)
        length += q[c] * q[c];
    for (int c = 0; c < 4; c++)
        out[c] = (float)(q[c] / sqrt(length));
}

/* ---- Rows ------------------------------------------------------------------------------------ */

/* Returns whether a row can be imported: its values are below 1e18 (a logit of the opacity may also
 * be infinite), its scales do not overflow, its quaternion is not zero, and its blended motion is a
 * rotation in every frame. */
static bool is_valid(const struct model *m, size_t row)
{
    double r[3][3], shift[3];

    for (int c = 0; c < N_COLUMNS; c++) {
        size_t width = (size_t)columns[c].width;

        for (size_t k = 0; k < width; k++)
            if (!(fabsf(m->column[c][width * row + k]) < 1e18f) &&
                !(c == OPACITIES && isinf(m->column[c][row])))
                return false;
    }
    for (size_t k = 0; k < 3; k++)
        if (m->column[SCALES][3 * row + k] > 80)
            return false;
    if (!(spin_quat_norm(m->column[QUATS] + 4 * row) > 0))
        return false;
    for (size_t f = 0; f < m->n_frames && row < m->n_fore; f++)
        if (!motion_of(m, row, f, r, shift))
            return false;
    return true;
}

static spin_status keep_rows(struct model *m)
{
    char share[96];

    SPIN_TRY(spin_model_alloc(&m->base, m->n_all, sizeof *m->row, (void **)&m->row));
    for (size_t i = 0; i < m->n_all; i++) {
        if (!is_valid(m, i))
            continue;
        m->n_fore_kept += i < m->n_fore;
        m->row[m->n++] = i;
    }
    if (m->n == 0)
        return spin_malformed("none of the %zu Gaussians has finite values and a rotation in "
                              "every frame",
                              m->n_all);
    if (m->n < m->n_all)
        spin_note(m->base.sequence,
                  "%s dropped because of values that are not finite, or frames without a rotation",
                  spin_text_share(m->n_all - m->n, m->n_all, "Gaussian", "is", "are", share));
    return SPIN_OK;
}

static void write_row(const struct model *m, size_t k, size_t frame, unsigned wanted,
                      struct spin_splats *out)
{
    size_t row = m->row[k];
    const float *place = m->column[MEANS] + 3 * row, *quat = m->column[QUATS] + 4 * row;
    double r[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}, shift[3] = {0}, turn[4] = {1, 0, 0, 0};

    if (row < m->n_fore && wanted & (SPIN_COL_MEANS | SPIN_COL_QUATS)) {
        motion_of(m, row, frame, r, shift);
        quat_of(r, turn);
    }
    for (size_t c = 0; c < 3 && wanted & SPIN_COL_MEANS; c++)
        out->means[3 * k + c] = (float)(r[0][c] * (double)place[0] + r[1][c] * (double)place[1] +
                                        r[2][c] * (double)place[2] + shift[c]);
    if (wanted & SPIN_COL_QUATS)
        multiply_quats(turn, quat, out->quats + 4 * k);
    if (wanted & SPIN_COL_LOG_SCALES)
        memcpy(out->log_scales + 3 * k, m->column[SCALES] + 3 * row, 3 * sizeof(float));
    if (wanted & SPIN_COL_LOGIT_OPACITIES)
        out->logit_opacities[k] = spin_finite_logit(m->column[OPACITIES][row]);
    for (size_t c = 0; c < 3 && wanted & SPIN_COL_SH; c++)
        out->sh[3 * k + c] =
            (float)((1 / (1 + exp(-(double)m->column[COLOURS][3 * row + c])) - 0.5) / SPIN_SH_C0);
}

static spin_status frame(void *self, int index, double time, unsigned wanted,
                         struct spin_splats *out)
{
    const struct model *m = self;

    (void)time;
    if (index < 0 || (size_t)index >= m->n_frames)
        return spin_not_found("'%s' has no frame %d", m->base.path, index);
    wanted &= SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    SPIN_TRY(spin_splats_reserve(out, m->n, wanted, 0));
    for (size_t k = 0; k < m->n; k++)
        write_row(m, k, (size_t)index, wanted, out);
    return spin_model_check(m->base.path, index, wanted, out);
}

/* ---- Opening --------------------------------------------------------------------------------- */

static spin_status describe(struct model *m)
{
    struct spin_sequence_info *sequence = m->base.sequence;

    SPIN_TRY(spin_model_alloc(&m->base, m->n_frames, sizeof *m->counts, (void **)&m->counts));
    for (size_t f = 0; f < m->n_frames; f++)
        m->counts[f] = m->n;
    spin_model_describe(&m->base, m->counts, 0, SPIN_COL_MEANS | SPIN_COL_QUATS);
    sequence->continuous = false;
    sequence->n_frames = (int)m->n_frames;
    sequence->time_last = (double)(m->n_frames - 1);
    snprintf(sequence->variant, sizeof sequence->variant,
             "Shape of Motion, %zu dynamic and %zu static Gaussians, %zu bases", m->n_fore_kept,
             m->n - m->n_fore_kept, m->n_bases);
    spin_note(sequence, "times are numbers of frames: the file does not contain the frame rate");
    spin_note(sequence,
              "training normalised the world: only the cameras in the checkpoint ('w2cs') "
              "match the Gaussians, not those of the data set");
    spin_note(sequence,
              "the splats are drawn as 3D splats; versions of the method before August 2024 "
              "drew flat ones, but the file does not state its version");
    return SPIN_OK;
}

static spin_status read_checkpoint(struct spin_model *base)
{
    struct model *m = (struct model *)base;

    SPIN_TRY(find_tensors(m));
    SPIN_TRY(load_columns(m));
    SPIN_TRY(load_bases(m));
    warn_others(m);
    SPIN_TRY(keep_rows(m));
    return describe(m);
}

static spin_status open_model(void *self, const char *path)
{
    struct spin_model *base = self;

    if (!spin_path_is_folder(path))
        SPIN_TRY(spin_model_text(base, &base->path, "%s", path));
    else
        SPIN_TRY(spin_model_find(base, &base->path, path, "checkpoints/last.ckpt"));
    if (!base->path)
        SPIN_TRY(spin_model_find(base, &base->path, path, "last.ckpt"));
    if (!base->path)
        return spin_not_found("'%s' contains no checkpoints/last.ckpt", path);
    return spin_model_torch(base, base->path, read_checkpoint);
}

SPIN_MODEL_IMPORTER(shapeofmotion, struct model, open_model, spin_model_close,
                    .summary = "Shape of Motion: checkpoints/last.ckpt, or the run's folder",
                    .upstream = "vye16/shape-of-motion 697d462", .probe = probe, .frame = frame)
