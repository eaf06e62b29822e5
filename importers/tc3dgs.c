/* TC3DGS (Javed et al., "Temporally Compressed 3D Gaussian Splatting"): the params.npz of Dynamic 3D
 * Gaussians with one more array, mask [T, N, 1], the logit of "this Gaussian is present in this frame".
 *
 * The published code reads the mask in several ways. Training renders with a
 * hard mask per frame at 0.1, so that is what we do unless told otherwise. What the mask hides is
 * left out, not shrunk: a scale of 0 has no logarithm. */
#include <math.h>
#include <string.h>

#include "base/option.h"
#include "importers/lib/d3dgs_run.h"

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

struct run {
    struct d3dgs_run base;
    struct spin_array mask;
    bool still_mask; /* [N, 1] */
    enum mode mode;
    double threshold;
    float *row;    /* [n] the mask of one frame */
    double *sum;   /* [n] of the presence over frames */
    uint32_t *off; /* [n] frames that hide it */
    bool *keep;    /* [n] of the frame at hand, or of all frames */
};

static int probe(const struct spin_peek *peek)
{
    if (!spin_d3dgs_has_key(peek, "mask"))
        return 0;
    if (peek->is_folder)
        return spin_d3dgs_has_key(peek, "means3D") ? 80 : 0;
    return spin_d3dgs_has_key(peek, "means3D") && spin_d3dgs_count_keys(peek) >= 3 ? 90 : 0;
}

/* ---- The mask -------------------------------------------------------------------------------- */

static spin_status load_mask(struct run *run)
{
    struct spin_array *a = &run->mask;
    uint64_t t = run->base.n_frames, n = run->base.n;
    char expected[128];

    SPIN_TRY(spin_d3dgs_array(&run->base, "mask", a));
    if ((a->n_dims == 3 && a->shape[0] == t && a->shape[1] == n && a->shape[2] == 1) ||
        (a->n_dims == 2 && a->shape[0] == t && a->shape[1] == n))
        return SPIN_OK;
    run->still_mask = true;
    if (a->n_dims == 2 && a->shape[0] == n && a->shape[1] == 1)
        return SPIN_OK;
    snprintf(expected, sizeof expected, "[%llu, %llu, 1] as 'means3D' has it",
             (unsigned long long)t, (unsigned long long)n);
    return spin_d3dgs_fail_shape(a, "mask", expected);
}

static spin_status read_mask(struct run *run, int frame)
{
    uint64_t n = run->base.n, bad = 0;

    spin_array_to_f32(&run->mask, run->still_mask ? 0 : (uint64_t)frame * n, n, run->row);
    for (uint64_t i = 0; i < n; i++)
        bad += isnan(run->row[i]);
    if (bad > 0)
        return spin_fail(SPIN_E_MALFORMED, "array 'mask' has %llu values in frame %d that are NaN",
                         (unsigned long long)bad, frame);
    return SPIN_OK;
}

/* m > threshold, m being the sigmoid of the mask. */
static double presence(float mask) { return 1 / (1 + exp(-(double)mask)); }

/* What each frame has, in one pass over the mask; for the modes that look at all frames, who stays. */
static spin_status count(struct run *run)
{
    struct d3dgs_run *base = &run->base;
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

static const struct spin_plugin_option options[] = {
    {"tc-mask", "MODE",
     "what the mask does: frame (hide per frame), avg, any, all (leave out of the whole clip), "
     "none",
     "frame"},
    {"tc-threshold", "P", "presence at or below which a Gaussian is hidden, 0 to 1", "0.1"},
    {NULL, NULL, NULL, NULL},
};

static spin_status read_options(const struct spin_plugin_values *values, struct run *run)
{
    int mode;

    SPIN_TRY(spin_option_word(values, "tc-mask", "frame|avg|any|all|none", &mode));
    run->mode = mode;
    run->threshold = 0.1;
    return spin_option_number(values, "tc-threshold", 0, 1, &run->threshold);
}

static spin_status open_mask(struct run *run)
{
    struct spin_model *base = &run->base.base;
    struct spin_sequence_info *sequence = base->sequence;
    size_t n = (size_t)run->base.n;

    if (!spin_npz_has(&run->base.npz, "mask"))
        return spin_fail(SPIN_E_MALFORMED,
                         "no array 'mask', which TC3DGS has: import it with --from d3dgs");
    SPIN_TRY(load_mask(run));
    SPIN_TRY(spin_model_alloc(base, n, sizeof *run->row, (void **)&run->row));
    SPIN_TRY(spin_model_alloc(base, n, sizeof *run->sum, (void **)&run->sum));
    SPIN_TRY(spin_model_alloc(base, n, sizeof *run->off, (void **)&run->off));
    SPIN_TRY(spin_model_alloc(base, n, sizeof *run->keep, (void **)&run->keep));
    SPIN_TRY(count(run));
    if (run->mode == FRAME && !run->still_mask) /* rows differ from frame to frame */
        sequence->static_columns = 0;
    sequence->identity = run->mode != FRAME || run->still_mask;
    snprintf(sequence->variant, sizeof sequence->variant, "TC3DGS, %zu Gaussians", n);
    spin_note(sequence, "%s (--tc-mask %s, --tc-threshold %g)", modes[run->mode].says,
              modes[run->mode].name, run->threshold);
    return SPIN_OK;
}

static spin_status open_run(void *self, const char *path)
{
    struct run *run = self;
    spin_status status;

    SPIN_TRY(read_options(run->base.base.values, run));
    status = spin_d3dgs_load(path, &run->base);
    if (status == SPIN_OK)
        status = open_mask(run);
    return spin_fail_reading(status, run->base.base.path);
}

SPIN_MODEL_OPEN(tc3dgs_open, struct run, open_run)

/* ---- Reading --------------------------------------------------------------------------------- */

static spin_status tc3dgs_frame(void *self, int frame, double time, unsigned columns,
                                struct spin_splats *out)
{
    struct run *run = self;
    size_t n = (size_t)run->base.n;

    (void)time;
    SPIN_TRY(spin_d3dgs_read(&run->base, frame, columns, out));
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

const struct spin_importer spin_importer_tc3dgs = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "tc3dgs",
    .summary = "TC3DGS: the params.npz of Dynamic 3D Gaussians with a mask per frame",
    .upstream = "saqibjaved1/Dynamic3DGaussians a8082da",
    .options = options,
    .probe = probe,
    .open = tc3dgs_open,
    .frame = tc3dgs_frame,
    .close = spin_d3dgs_close,
};
