/* Dynamic 3D Gaussians (Luiten et al., 3DV 2024): a training yields one file, params.npz.
 *
 * Positions, colours and rotations are stored per frame, opacities and scales once. Some forks also
 * store opacities and scales per frame: an array is per frame if it has three dimensions. Colours
 * are plain RGB instead of SH and may be outside 0..1: they become degree-0 SH without clamping.
 *
 * TC3DGS (Javed et al., "Temporally Compressed 3D Gaussian Splatting") adds one array, mask [T, N,
 * 1], which contains the logit of each Gaussian's presence in each frame. The published code
 * interprets the mask in several ways. Training hides, in each frame, the Gaussians whose presence
 * is at most 0.1; this is also the default here. Hidden Gaussians are removed rather than scaled to
 * 0, since a scale of 0 has no logarithm. */
#include "importers/lib/model.h"
#include "io/npy.h"
#include "math/quat.h"
#include "math/sh.h"

enum { MEANS, COLOURS, ROTATIONS, OPACITIES, SCALES, N_KEYS };

/* The arrays of a file. A frame is converted from them only when it is read. */
struct run {
    struct spin_model base;
    struct spin_npz npz;
    struct spin_array array[N_KEYS];
    uint64_t n_frames, n;
    size_t *counts; /* [n_frames] */
};

/* The CRC of archive members of this many bytes or more is not checked, since the check would read
 * every byte. */
#define CRC_LIMIT (64u << 20)

static const struct {
    const char *name;
    uint64_t width;
    int column; /* column number for spin_model_values() */
} keys[N_KEYS] = {
    {"means3D", 3, 0},         {"rgb_colors", 3, 4}, {"unnorm_rotations", 4, 1},
    {"logit_opacities", 1, 3}, {"log_scales", 3, 2},
};

/* ---- Recognising ----------------------------------------------------------------------------- */

/* Whether the archive has an array `key`. */
static bool has_key(const struct spin_peek *peek, const char *key)
{
    char line[64];
    size_t n = (size_t)snprintf(line, sizeof line, "%s.npy", key);

    for (const char *at = peek->tail_names; (at = strstr(at, line)) != NULL; at += n) {
        if ((at == peek->tail_names || at[-1] == '\n') && (at[n] == '\n' || at[n] == '\0'))
            return true;
    }
    return false;
}

/* Returns how many of the arrays in `keys` the archive contains. */
static int count_keys(const struct spin_peek *peek)
{
    int found = 0;

    for (int k = 0; k < N_KEYS; k++)
        found += has_key(peek, keys[k].name);
    return found;
}

/* ---- Opening --------------------------------------------------------------------------------- */

static spin_status fail_shape(const struct spin_array *a, const char *key, const char *expected)
{
    char shape[128];

    spin_array_shape_text(a->n_dims, a->shape, shape, sizeof shape);
    return spin_malformed("array '%s' has shape %s, expected %s", key, shape, expected);
}

static spin_status bind_array(struct run *run, const char *key, struct spin_array *out)
{
    char member[64];
    const struct spin_zip_member *m;

    snprintf(member, sizeof member, "%s.npy", key);
    m = spin_zip_find(&run->npz.zip, member);
    SPIN_TRY(spin_npz_array(&run->npz, key, m && m->size < CRC_LIMIT, out));
    if (out->kind != 'f')
        return spin_unsupported("array '%s' does not contain floating-point numbers", key);
    return SPIN_OK;
}

static spin_status check_means(struct run *run)
{
    const char *key = keys[MEANS].name;
    struct spin_array *a = &run->array[MEANS];

    SPIN_TRY(spin_npz_head(&run->npz, key, a));
    if (a->n_dims != 3 || a->shape[2] != 3)
        return fail_shape(a, key, "[T, N, 3]");
    run->n_frames = a->shape[0];
    run->n = a->shape[1];
    if (run->n_frames == 0)
        return spin_malformed("array 'means3D' has 0 frames");
    if (run->n == 0)
        return spin_malformed("0 Gaussians: training collapsed, check the camera poses");
    if (run->n_frames > INT_MAX || run->n > UINT32_MAX)
        return fail_shape(a, key, "fewer than 2^31 frames and 2^32 Gaussians");
    return SPIN_OK;
}

/* Checks the shape of an array, which must be [T, N, width] or, if all frames share its values, [N,
 * width]. */
static spin_status check_column(struct run *run, int key)
{
    struct spin_array *a = &run->array[key];
    char expected[128];

    SPIN_TRY(spin_npz_head(&run->npz, keys[key].name, a));
    if (a->n_dims == 3 && a->shape[0] == run->n_frames && a->shape[1] == run->n &&
        a->shape[2] == keys[key].width)
        return SPIN_OK;
    if (a->n_dims == 2 && a->shape[0] == run->n && a->shape[1] == keys[key].width)
        return SPIN_OK;
    snprintf(expected, sizeof expected, "[%llu, %llu, %llu] or [%llu, %llu] as in 'means3D'",
             (unsigned long long)run->n_frames, (unsigned long long)run->n,
             (unsigned long long)keys[key].width, (unsigned long long)run->n,
             (unsigned long long)keys[key].width);
    return fail_shape(a, keys[key].name, expected);
}

/* Checks that the unpacked arrays and one frame fit into the available memory, before any array is
 * unpacked: deflate can expand data a thousandfold. */
static spin_status check_room(const struct run *run)
{
    uint64_t unpacked = 0, width = 0, frame, available = spin_memory_available();

    for (int k = 0; k < N_KEYS; k++) {
        unpacked += spin_npz_unpacked(&run->npz, keys[k].name);
        width += keys[k].width;
    }
    frame = run->n * width * sizeof(float);
    if (unpacked == 0 || unpacked + frame <= available)
        return SPIN_OK;
    return spin_fail(SPIN_E_MEMORY,
                     "cannot read '%s': its arrays unpack to %.1f MB and a frame requires another "
                     "%.1f MB, but only %.1f MB of memory are available",
                     run->base.path, (double)unpacked / 1e6, (double)frame / 1e6,
                     (double)available / 1e6);
}

static void describe(const struct run *run)
{
    struct spin_sequence_info *sequence = run->base.sequence;

    for (uint64_t t = 0; t < run->n_frames; t++)
        run->counts[t] = (size_t)run->n;
    sequence->n_frames = (int)run->n_frames;
    sequence->counts = run->counts;
    sequence->identity = true;
    sequence->sh_degree = 0;
    sequence->time_last = (double)(run->n_frames - 1);
    for (int k = 0; k < N_KEYS; k++) {
        sequence->columns |= 1u << keys[k].column;
        if (run->array[k].n_dims == 2)
            sequence->static_columns |= 1u << keys[k].column;
    }
}

/* Opens `path`, or its params.npz if `path` is a folder, and binds the arrays. */
static spin_status load_run(const char *path, struct run *run)
{
    struct spin_model *base = &run->base;

    if (spin_path_is_folder(path))
        SPIN_TRY(spin_model_join(base, &base->path, path, "params.npz"));
    else
        SPIN_TRY(spin_model_text(base, &base->path, "%s", path));
    SPIN_TRY(spin_npz_open(base->path, &run->npz));
    if (spin_npz_has(&run->npz, "cam_unnorm_rots"))
        return spin_unsupported("array 'cam_unnorm_rots' belongs to a map of SplaTAM or one of its "
                                "descendants, which has no frames");
    SPIN_TRY(check_means(run));
    for (int k = MEANS + 1; k < N_KEYS; k++)
        SPIN_TRY(check_column(run, k));
    SPIN_TRY(check_room(run));
    for (int k = 0; k < N_KEYS; k++)
        SPIN_TRY(bind_array(run, keys[k].name, &run->array[k]));
    SPIN_TRY(
        spin_model_alloc(base, (size_t)run->n_frames, sizeof *run->counts, (void **)&run->counts));
    describe(run);
    return SPIN_OK;
}

static void close_run(void *self)
{
    if (self)
        spin_npz_close(&((struct run *)self)->npz);
    spin_model_close(self);
}

/* ---- Reading --------------------------------------------------------------------------------- */

/* Reads the values of an array for one frame as stored, except that log scales of -infinity become
 * finite. Other nonfinite values are an error. */
static spin_status read_column(const struct run *run, int key, int frame, float *out)
{
    const struct spin_array *a = &run->array[key];
    uint64_t count = run->n * keys[key].width;
    uint64_t first = a->n_dims == 3 ? (uint64_t)frame * count : 0;
    uint64_t bad;

    spin_array_to_f32(a, first, count, out);
    if (a->n_dims == 3)
        spin_npz_forget(&run->npz, a, first, count);
    for (uint64_t i = 0; keys[key].column == 2 && i < count; i++)
        out[i] = spin_finite_log_scale(out[i]);
    bad = spin_finite_missing(out, (size_t)count);
    if (bad > 0)
        return spin_malformed(
            "cannot read '%s': array '%s' has %llu values in frame %d that are not finite",
            run->base.path, keys[key].name, (unsigned long long)bad, frame);
    return SPIN_OK;
}

/* Reads all Gaussians of one frame. */
static spin_status read_run(const struct run *run, int frame, unsigned columns,
                            struct spin_splats *out)
{
    size_t n = (size_t)run->n;

    if (frame < 0 || (uint64_t)frame >= run->n_frames)
        return spin_not_found("'%s' has no frame %d", run->base.path, frame);
    columns &= SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    SPIN_TRY(spin_splats_reserve(out, n, columns, 0));
    for (int k = 0; k < N_KEYS; k++) {
        size_t width;

        if (columns & 1u << keys[k].column)
            SPIN_TRY(read_column(run, k, frame, spin_model_values(out, keys[k].column, &width)));
    }
    /* A zero quaternion becomes the identity here; the method computes an invalid rotation matrix.
     */
    for (size_t i = 0; columns & SPIN_COL_QUATS && i < n; i++)
        spin_quat_normalise(out->quats + 4 * i);
    for (size_t i = 0; columns & SPIN_COL_SH && i < 3 * n; i++)
        out->sh[i] = (float)((out->sh[i] - 0.5) / SPIN_SH_C0);
    return SPIN_OK;
}

/* ---- Dynamic 3D Gaussians -------------------------------------------------------------------- */

static int d3dgs_probe(const struct spin_peek *peek)
{
    bool mask = has_key(peek, "mask"); /* the file is of TC3DGS */
    int found = count_keys(peek);

    if (peek->is_folder)
        return spin_peek_has(peek, "params.npz") && !mask ? 60 : 0;
    if (mask || !spin_zip_detect(peek->head, peek->n_head))
        return 0;
    if (peek->tail_names[0] == '\0') /* a truncated zip has no directory: if its first member is
                                        means3D, open() reports the truncation */
        return memmem(peek->head, peek->n_head, "means3D.npy", 11) ? 30 : 0;
    if (has_key(peek, "cam_unnorm_rots")) /* a map of SplaTAM: open() refuses it and explains why */
        return found >= 3 ? 30 : 0;
    if (has_key(peek, "means3D") && has_key(peek, "unnorm_rotations"))
        return 90;
    return found >= 3 ? 60 : 0;
}

static spin_status open_run(void *self, const char *path)
{
    /* Arrays that are not imported, and the note for the user about each. */
    static const struct {
        const char *key, *what;
    } lost[] = {
        {"mask", "array 'mask' (TC3DGS) is ignored: every Gaussian is present in every frame"},
        {"cam_m", "the per-camera colour corrections (cam_m, cam_c) are not imported"},
        {"part_colors",
         "the colours that mark the parts of objects (part_colors, PaMoSplat) are not imported"},
        {"seg_colors", "the flags of foreground and background (seg_colors) are not imported"},
    };
    struct run *run = self;
    struct spin_sequence_info *sequence = run->base.sequence;

    SPIN_TRY(spin_fail_reading(load_run(path, run), run->base.path));
    snprintf(sequence->variant, sizeof sequence->variant, "Dynamic 3D Gaussians, %llu Gaussians",
             (unsigned long long)run->n);
    for (size_t i = 0; i < sizeof lost / sizeof *lost; i++) {
        if (spin_npz_has(&run->npz, lost[i].key))
            spin_note(sequence, "%s", lost[i].what);
    }
    return SPIN_OK;
}

static spin_status d3dgs_frame(void *self, int frame, double time, unsigned columns,
                               struct spin_splats *out)
{
    (void)time;
    return read_run(self, frame, columns, out);
}

SPIN_MODEL_IMPORTER(d3dgs, struct run, open_run, close_run,
                    .summary = "Dynamic 3D Gaussians: params.npz, or its folder",
                    .upstream = "JonathonLuiten/Dynamic3DGaussians 7dbbd4d", .probe = d3dgs_probe,
                    .frame = d3dgs_frame)

/* ---- TC3DGS ---------------------------------------------------------------------------------- */

enum mode { FRAME, AVG, ANY, ALL, NONE, N_MODES };

static const struct {
    const char *name, *says;
} modes[N_MODES] = {
    {"frame", "Gaussians are left out of the frames whose mask hides them"},
    {"avg", "Gaussians are left out of all frames when their mean mask hides them"},
    {"any", "Gaussians are left out of all frames when the mask of some frame hides them"},
    {"all", "Gaussians are left out of all frames when the mask of every frame hides them"},
    {"none", "the mask is not used: Gaussians that training switched off are visible"},
};

struct tc_run {
    struct run base;
    struct spin_array mask;
    bool still_mask; /* the mask has the shape [N, 1] and is the same in all frames */
    enum mode mode;
    double threshold;
    float *row;    /* [n] the mask of one frame */
    double *sum;   /* [n] sum of the presence over all frames */
    uint32_t *off; /* [n] number of frames whose mask hides the Gaussian */
    bool *keep;    /* [n] whether a Gaussian is kept, in the current frame or in all frames */
};

static int tc3dgs_probe(const struct spin_peek *peek)
{
    if (!has_key(peek, "mask"))
        return 0;
    if (peek->is_folder)
        return has_key(peek, "means3D") ? 80 : 0;
    return has_key(peek, "means3D") && count_keys(peek) >= 3 ? 90 : 0;
}

/* ---- The mask -------------------------------------------------------------------------------- */

static spin_status load_mask(struct tc_run *run)
{
    struct spin_array *a = &run->mask;
    uint64_t t = run->base.n_frames, n = run->base.n;
    char expected[128];

    SPIN_TRY(bind_array(&run->base, "mask", a));
    if ((a->n_dims == 3 && a->shape[0] == t && a->shape[1] == n && a->shape[2] == 1) ||
        (a->n_dims == 2 && a->shape[0] == t && a->shape[1] == n))
        return SPIN_OK;
    run->still_mask = true;
    if (a->n_dims == 2 && a->shape[0] == n && a->shape[1] == 1)
        return SPIN_OK;
    snprintf(expected, sizeof expected, "[%llu, %llu, 1] as in 'means3D'", (unsigned long long)t,
             (unsigned long long)n);
    return fail_shape(a, "mask", expected);
}

static spin_status read_mask(struct tc_run *run, int frame)
{
    uint64_t n = run->base.n, bad = 0;

    spin_array_to_f32(&run->mask, run->still_mask ? 0 : (uint64_t)frame * n, n, run->row);
    for (uint64_t i = 0; i < n; i++)
        bad += isnan(run->row[i]);
    if (bad > 0)
        return spin_malformed("array 'mask' has %llu values in frame %d that are NaN",
                              (unsigned long long)bad, frame);
    return SPIN_OK;
}

/* Returns the presence of a Gaussian, which is the sigmoid of its mask. In mode FRAME, a Gaussian
 * is visible if its presence is above the threshold; in the other modes, also if it is equal. */
static double presence(float mask) { return 1 / (1 + exp(-(double)mask)); }

/* Sets base.counts, the number of Gaussians that are kept in each frame, in one pass over the mask.
 * In the modes AVG, ANY and ALL, all frames keep the same Gaussians; run->keep is then also set. */
static spin_status count_kept(struct tc_run *run)
{
    struct run *base = &run->base;
    size_t n = (size_t)base->n, n_kept = 0;

    for (uint64_t t = 0; t < base->n_frames && run->mode != NONE; t++) {
        base->counts[t] = 0;
        SPIN_TRY(read_mask(run, (int)t));
        for (size_t i = 0; i < n; i++) {
            double m = presence(run->row[i]);

            base->counts[t] += m > run->threshold;
            run->sum[i] += m;
            run->off[i] += m < run->threshold;
        }
    }
    if (run->mode == FRAME || run->mode == NONE)
        return SPIN_OK;
    for (size_t i = 0; i < n; i++) {
        run->keep[i] = run->mode == AVG   ? !(run->sum[i] / (double)base->n_frames < run->threshold)
                       : run->mode == ANY ? run->off[i] == 0
                                          : run->off[i] < base->n_frames;
        n_kept += run->keep[i];
    }
    for (uint64_t t = 0; t < base->n_frames; t++)
        base->counts[t] = n_kept;
    return SPIN_OK;
}

/* ---- Opening --------------------------------------------------------------------------------- */

static const struct spin_plugin_option tc3dgs_options[] = {
    {"tc-mask", "MODE",
     "how the mask hides Gaussians with a low presence: frame for each frame on its own; avg, any "
     "or all for the whole clip, if the presence is low on average, in any frame or in all frames; "
     "none to ignore the mask",
     "frame"},
    {"tc-threshold", "P",
     "presence below which a Gaussian is hidden, 0 to 1; --tc-mask frame also hides one that is "
     "equal",
     "0.1"},
    {NULL, NULL, NULL, NULL},
};

static spin_status read_options(const struct spin_plugin_values *values, struct tc_run *run)
{
    int mode;

    SPIN_TRY(spin_option_word(values, "tc-mask", "frame|avg|any|all|none", &mode));
    run->mode = mode;
    run->threshold = 0.1;
    return spin_option_number(values, "tc-threshold", 0, 1, &run->threshold);
}

static spin_status open_mask(struct tc_run *run)
{
    struct spin_model *base = &run->base.base;
    struct spin_sequence_info *sequence = base->sequence;
    size_t n = (size_t)run->base.n;

    if (!spin_npz_has(&run->base.npz, "mask"))
        return spin_malformed("there is no array 'mask', which TC3DGS requires: use --from d3dgs");
    SPIN_TRY(load_mask(run));
    SPIN_TRY(spin_model_alloc(base, n, sizeof *run->row, (void **)&run->row));
    SPIN_TRY(spin_model_alloc(base, n, sizeof *run->sum, (void **)&run->sum));
    SPIN_TRY(spin_model_alloc(base, n, sizeof *run->off, (void **)&run->off));
    SPIN_TRY(spin_model_alloc(base, n, sizeof *run->keep, (void **)&run->keep));
    SPIN_TRY(count_kept(run));
    if (run->mode == FRAME && !run->still_mask) /* row i can be another Gaussian in every frame */
        sequence->static_columns = 0;
    sequence->identity = run->mode != FRAME || run->still_mask;
    snprintf(sequence->variant, sizeof sequence->variant, "TC3DGS, %zu Gaussians", n);
    spin_note(sequence, "%s (--tc-mask %s, --tc-threshold %g)", modes[run->mode].says,
              modes[run->mode].name, run->threshold);
    return SPIN_OK;
}

static spin_status open_tc_run(void *self, const char *path)
{
    struct tc_run *run = self;
    spin_status status;

    SPIN_TRY(read_options(run->base.base.values, run));
    status = load_run(path, &run->base);
    if (status == SPIN_OK)
        status = open_mask(run);
    return spin_fail_reading(status, run->base.base.path);
}

/* ---- Reading --------------------------------------------------------------------------------- */

static spin_status tc3dgs_frame(void *self, int frame, double time, unsigned columns,
                                struct spin_splats *out)
{
    struct tc_run *run = self;
    size_t n = (size_t)run->base.n;

    (void)time;
    SPIN_TRY(read_run(&run->base, frame, columns, out));
    if (run->mode == NONE)
        return SPIN_OK;
    if (run->mode == FRAME) {
        SPIN_TRY(read_mask(run, frame));
        for (size_t i = 0; i < n; i++)
            run->keep[i] = presence(run->row[i]) > run->threshold;
    }
    for (int c = 0; c < SPIN_MODEL_COLUMNS; c++) {
        size_t width, to = 0;
        float *rows = spin_model_values(out, c, &width);

        for (size_t i = 0; columns & 1u << c && i < n; i++) {
            if (run->keep[i])
                memmove(rows + width * to++, rows + width * i, width * sizeof *rows);
        }
    }
    out->n = run->base.counts[frame];
    return SPIN_OK;
}

SPIN_MODEL_IMPORTER(
    tc3dgs, struct tc_run, open_tc_run, close_run,
    .summary = "TC3DGS: the params.npz of Dynamic 3D Gaussians with a mask per frame",
    .upstream = "saqibjaved1/Dynamic3DGaussians a8082da", .options = tc3dgs_options,
    .probe = tc3dgs_probe, .frame = tc3dgs_frame)
