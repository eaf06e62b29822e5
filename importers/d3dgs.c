/* Dynamic 3D Gaussians (Luiten et al., 3DV 2024): a run is one params.npz.
 *
 * Positions, colours and rotations are stored per frame, opacities and scales once (forks store
 * them per frame too: the number of dimensions tells). Colours are plain RGB, not SH, and may leave
 * 0..1: they become degree-0 SH unclamped. Frames are converted one by one, straight from the
 * map. */
#include "spin.h"

#include <limits.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/mem.h"
#include "io/npy.h"

#define SH_C0 0.28209479177387814
/* Checking a CRC reads every byte, so larger members are only checked for being there. */
#define CRC_LIMIT (64u << 20)

enum { MEANS, COLOURS, ROTATIONS, OPACITIES, SCALES, N_KEYS };

static const struct {
    const char *name;
    uint64_t width;
    unsigned column;
} keys[N_KEYS] = {
    {"means3D", 3, SPIN_COL_MEANS},          {"rgb_colors", 3, SPIN_COL_SH},
    {"unnorm_rotations", 4, SPIN_COL_QUATS}, {"logit_opacities", 1, SPIN_COL_LOGIT_OPACITIES},
    {"log_scales", 3, SPIN_COL_LOG_SCALES},
};

struct run {
    struct spin_npz npz;
    char *path;
    struct spin_array array[N_KEYS];
    uint64_t n_frames, n;
    size_t *counts; /* [n_frames] */
};

/* ---- Recognising ----------------------------------------------------------------------------- */

static bool has_line(const char *lines, const char *line)
{
    size_t n = strlen(line);

    for (const char *at = lines; (at = strstr(at, line)) != NULL; at += n) {
        if ((at == lines || at[-1] == '\n') && (at[n] == '\n' || at[n] == '\0'))
            return true;
    }
    return false;
}

static bool has_key(const struct spin_peek *peek, const char *key)
{
    char member[64];

    snprintf(member, sizeof member, "%s.npy", key);
    return has_line(peek->tail_names, member);
}

static int probe(const struct spin_peek *peek)
{
    int found = 0;

    if (peek->is_folder) {
        for (size_t i = 0; peek->names && peek->names[i]; i++) {
            if (strcmp(peek->names[i], "params.npz") == 0)
                return 60;
        }
        return 0;
    }
    if (!spin_zip_looks_like(peek->head, peek->n_head))
        return 0;
    if (peek->tail_names[0] == '\0') /* cut short: open() can say so if the first member is ours */
        return memmem(peek->head, peek->n_head, "means3D.npy", 11) ? 30 : 0;
    if (has_key(peek, "mask")) /* TC3DGS */
        return 0;
    for (int k = 0; k < N_KEYS; k++)
        found += has_key(peek, keys[k].name);
    if (has_key(peek, "cam_unnorm_rots")) /* SplaTAM: open() says so */
        return found >= 3 ? 30 : 0;
    if (has_key(peek, keys[MEANS].name) && has_key(peek, keys[ROTATIONS].name))
        return 90;
    return found >= 3 ? 60 : 0;
}

/* ---- Opening --------------------------------------------------------------------------------- */

static spin_status fail_shape(const struct spin_array *a, const char *key, const char *expected)
{
    char shape[128];

    spin_array_shape_text(a->n_dims, a->shape, shape, sizeof shape);
    return spin_fail(SPIN_E_MALFORMED, "array '%s' has shape %s, expected %s", key, shape,
                     expected);
}

static spin_status load_array(struct run *run, const char *key, struct spin_array *out)
{
    char member[64];
    const struct spin_zip_member *m;

    snprintf(member, sizeof member, "%s.npy", key);
    m = spin_zip_find(&run->npz.zip, member);
    SPIN_TRY(spin_npz_array(&run->npz, key, m && m->size < CRC_LIMIT, out));
    if (out->kind != 'f')
        return spin_fail(SPIN_E_UNSUPPORTED, "array '%s' does not hold floating-point numbers",
                         key);
    return SPIN_OK;
}

static spin_status load_means(struct run *run)
{
    struct spin_array *a = &run->array[MEANS];

    SPIN_TRY(load_array(run, keys[MEANS].name, a));
    if (a->n_dims != 3 || a->shape[2] != 3)
        return fail_shape(a, keys[MEANS].name, "[T, N, 3]");
    run->n_frames = a->shape[0];
    run->n = a->shape[1];
    if (run->n_frames == 0)
        return spin_fail(SPIN_E_MALFORMED, "array 'means3D' has 0 frames");
    if (run->n == 0)
        return spin_fail(SPIN_E_MALFORMED,
                         "0 Gaussians: training collapsed, check the camera poses");
    if (run->n_frames > INT_MAX || run->n > UINT32_MAX)
        return fail_shape(a, keys[MEANS].name, "fewer than 2^31 frames and 2^32 Gaussians");
    return SPIN_OK;
}

/* [T, N, width], or [N, width] for what does not change. */
static spin_status load_column(struct run *run, int key)
{
    struct spin_array *a = &run->array[key];
    char expected[128];

    SPIN_TRY(load_array(run, keys[key].name, a));
    if (a->n_dims == 3 && a->shape[0] == run->n_frames && a->shape[1] == run->n &&
        a->shape[2] == keys[key].width)
        return SPIN_OK;
    if (a->n_dims == 2 && a->shape[0] == run->n && a->shape[1] == keys[key].width)
        return SPIN_OK;
    snprintf(expected, sizeof expected, "[%llu, %llu, %llu] or [%llu, %llu] as 'means3D' has it",
             (unsigned long long)run->n_frames, (unsigned long long)run->n,
             (unsigned long long)keys[key].width, (unsigned long long)run->n,
             (unsigned long long)keys[key].width);
    return fail_shape(a, keys[key].name, expected);
}

static spin_status describe(struct run *run, struct spin_track *track)
{
    void *block = NULL;

    SPIN_TRY(spin_alloc((size_t)run->n_frames, sizeof *run->counts, &block));
    run->counts = block;
    for (uint64_t t = 0; t < run->n_frames; t++)
        run->counts[t] = (size_t)run->n;
    track->n_frames = (int)run->n_frames;
    track->counts = run->counts;
    track->sh_degree = 0;
    track->time_last = (double)(run->n_frames - 1);
    for (int k = 0; k < N_KEYS; k++) {
        track->columns |= keys[k].column;
        if (run->array[k].n_dims == 2)
            track->still_columns |= keys[k].column;
    }
    snprintf(track->variant, sizeof track->variant, "Dynamic 3D Gaussians, %llu Gaussians",
             (unsigned long long)run->n);
    if (spin_npz_has(&run->npz, "mask"))
        snprintf(track->notes, sizeof track->notes,
                 "array 'mask' (TC3DGS) is ignored: every Gaussian is present in every frame\n");
    else if (spin_npz_has(&run->npz, "cam_m"))
        snprintf(track->notes, sizeof track->notes,
                 "the per-camera colour corrections (cam_m, cam_c) are not imported\n");
    return SPIN_OK;
}

static spin_status open_run(const char *path, struct run *run, struct spin_track *track)
{
    if (spin_path_is_folder(path))
        SPIN_TRY(spin_path_join(path, "params.npz", &run->path));
    else
        SPIN_TRY(spin_strdup(path, &run->path));
    SPIN_TRY(spin_npz_open(run->path, &run->npz));
    if (spin_npz_has(&run->npz, "cam_unnorm_rots"))
        return spin_fail(SPIN_E_UNSUPPORTED,
                         "array 'cam_unnorm_rots' says that this is a map of SplaTAM or one of its "
                         "descendants, which has no frames");
    SPIN_TRY(load_means(run));
    for (int k = MEANS + 1; k < N_KEYS; k++)
        SPIN_TRY(load_column(run, k));
    return describe(run, track);
}

static spin_status d3dgs_open(const char *path, const struct spin_plugin_values *values,
                              void **self, struct spin_track *track)
{
    struct run *run;
    spin_status status;

    (void)values;
    *track = (struct spin_track){.sh_degree = -1};
    SPIN_TRY(spin_alloc(1, sizeof *run, self));
    run = *self;
    status = open_run(path, run, track);
    if (status != SPIN_OK && !strstr(spin_last_error(), path))
        return spin_more(status, "cannot read '%s'", run->path ? run->path : path);
    return status;
}

static void d3dgs_close(void *self)
{
    struct run *run = self;

    if (!run)
        return;
    spin_npz_close(&run->npz);
    free(run->path);
    free(run->counts);
    free(run);
}

/* ---- Reading --------------------------------------------------------------------------------- */

/* Values of one frame as they are stored; all must be finite. */
static spin_status read_column(const struct run *run, int key, int frame, float *out)
{
    const struct spin_array *a = &run->array[key];
    uint64_t count = run->n * keys[key].width;
    uint64_t first = a->n_dims == 3 ? (uint64_t)frame * count : 0;
    uint64_t bad = 0;

    spin_array_to_f32(a, first, count, out);
    for (uint64_t i = 0; i < count; i++)
        bad += !isfinite(out[i]);
    if (bad > 0)
        return spin_fail(SPIN_E_MALFORMED,
                         "cannot read '%s': array '%s' has %llu values in frame %d that are not "
                         "finite",
                         run->path, keys[key].name, (unsigned long long)bad, frame);
    return SPIN_OK;
}

/* The zero quaternion, which the method would turn into no rotation matrix at all, is identity. */
static void normalise(float *quats, size_t n)
{
    for (float *q = quats; q < quats + 4 * n; q += 4) {
        double norm = sqrt((double)q[0] * q[0] + (double)q[1] * q[1] + (double)q[2] * q[2] +
                           (double)q[3] * q[3]);

        if (norm > 0) {
            for (int i = 0; i < 4; i++)
                q[i] = (float)(q[i] / norm);
        } else {
            q[0] = 1;
            q[1] = q[2] = q[3] = 0;
        }
    }
}

static spin_status d3dgs_frame(void *self, int frame, double time, unsigned columns,
                               struct spin_splats *out)
{
    const struct run *run = self;
    size_t n = (size_t)run->n;

    (void)time;
    if (frame < 0 || (uint64_t)frame >= run->n_frames)
        return spin_fail(SPIN_E_NOT_FOUND, "'%s' has no frame %d", run->path, frame);
    columns &= SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    SPIN_TRY(spin_splats_reserve(out, n, columns, 0));
    if (columns & SPIN_COL_MEANS)
        SPIN_TRY(read_column(run, MEANS, frame, out->means));
    if (columns & SPIN_COL_LOGIT_OPACITIES)
        SPIN_TRY(read_column(run, OPACITIES, frame, out->logit_opacities));
    if (columns & SPIN_COL_LOG_SCALES)
        SPIN_TRY(read_column(run, SCALES, frame, out->log_scales));
    if (columns & SPIN_COL_QUATS) {
        SPIN_TRY(read_column(run, ROTATIONS, frame, out->quats));
        normalise(out->quats, n);
    }
    if (columns & SPIN_COL_SH) {
        SPIN_TRY(read_column(run, COLOURS, frame, out->sh));
        for (size_t i = 0; i < 3 * n; i++)
            out->sh[i] = (float)((out->sh[i] - 0.5) / SH_C0);
    }
    return SPIN_OK;
}

const struct spin_importer spin_importer_d3dgs = {
    .abi = SPIN_PLUGIN_ABI,
    .name = "d3dgs",
    .summary = "Dynamic 3D Gaussians: params.npz, or the folder it lies in",
    .upstream = "JonathonLuiten/Dynamic3DGaussians 7dbbd4d",
    .probe = probe,
    .open = d3dgs_open,
    .frame = d3dgs_frame,
    .close = d3dgs_close,
};
