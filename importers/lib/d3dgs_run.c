/* Arrays of params.npz to frames. */
#include "importers/lib/d3dgs_run.h"

#include <limits.h>
#include <string.h>

#include "math/quat.h"
#include "math/sh.h"

/* Checking a CRC reads every byte, so larger members are only checked for being there. */
#define D3DGS_CRC_LIMIT (64u << 20)

static const struct {
    const char *name;
    uint64_t width;
    int column; /* as of spin_model_values() */
} d3dgs_keys[D3DGS_N_KEYS] = {
    {"means3D", 3, 0},         {"rgb_colors", 3, 4}, {"unnorm_rotations", 4, 1},
    {"logit_opacities", 1, 3}, {"log_scales", 3, 2},
};

/* ---- Recognising ----------------------------------------------------------------------------- */

bool spin_d3dgs_has_key(const struct spin_peek *peek, const char *key)
{
    char line[64];
    size_t n = (size_t)snprintf(line, sizeof line, "%s.npy", key);

    for (const char *at = peek->tail_names; (at = strstr(at, line)) != NULL; at += n) {
        if ((at == peek->tail_names || at[-1] == '\n') && (at[n] == '\n' || at[n] == '\0'))
            return true;
    }
    return false;
}

int spin_d3dgs_count_keys(const struct spin_peek *peek)
{
    int found = 0;

    for (int k = 0; k < D3DGS_N_KEYS; k++)
        found += spin_d3dgs_has_key(peek, d3dgs_keys[k].name);
    return found;
}

/* ---- Opening --------------------------------------------------------------------------------- */

spin_status spin_d3dgs_fail_shape(const struct spin_array *a, const char *key, const char *expected)
{
    char shape[128];

    spin_array_shape_text(a->n_dims, a->shape, shape, sizeof shape);
    return spin_fail(SPIN_E_MALFORMED, "array '%s' has shape %s, expected %s", key, shape,
                     expected);
}

spin_status spin_d3dgs_array(struct d3dgs_run *run, const char *key, struct spin_array *out)
{
    char member[64];
    const struct spin_zip_member *m;

    snprintf(member, sizeof member, "%s.npy", key);
    m = spin_zip_find(&run->npz.zip, member);
    SPIN_TRY(spin_npz_array(&run->npz, key, m && m->size < D3DGS_CRC_LIMIT, out));
    if (out->kind != 'f')
        return spin_fail(SPIN_E_UNSUPPORTED, "array '%s' does not hold floating-point numbers",
                         key);
    return SPIN_OK;
}

static spin_status d3dgs_check_means(struct d3dgs_run *run)
{
    const char *key = d3dgs_keys[D3DGS_MEANS].name;
    struct spin_array *a = &run->array[D3DGS_MEANS];

    SPIN_TRY(spin_npz_head(&run->npz, key, a));
    if (a->n_dims != 3 || a->shape[2] != 3)
        return spin_d3dgs_fail_shape(a, key, "[T, N, 3]");
    run->n_frames = a->shape[0];
    run->n = a->shape[1];
    if (run->n_frames == 0)
        return spin_fail(SPIN_E_MALFORMED, "array 'means3D' has 0 frames");
    if (run->n == 0)
        return spin_fail(SPIN_E_MALFORMED,
                         "0 Gaussians: training collapsed, check the camera poses");
    if (run->n_frames > INT_MAX || run->n > UINT32_MAX)
        return spin_d3dgs_fail_shape(a, key, "fewer than 2^31 frames and 2^32 Gaussians");
    return SPIN_OK;
}

/* [T, N, width], or [N, width] for what does not change. */
static spin_status d3dgs_check_column(struct d3dgs_run *run, int key)
{
    struct spin_array *a = &run->array[key];
    char expected[128];

    SPIN_TRY(spin_npz_head(&run->npz, d3dgs_keys[key].name, a));
    if (a->n_dims == 3 && a->shape[0] == run->n_frames && a->shape[1] == run->n &&
        a->shape[2] == d3dgs_keys[key].width)
        return SPIN_OK;
    if (a->n_dims == 2 && a->shape[0] == run->n && a->shape[1] == d3dgs_keys[key].width)
        return SPIN_OK;
    snprintf(expected, sizeof expected, "[%llu, %llu, %llu] or [%llu, %llu] as 'means3D' has it",
             (unsigned long long)run->n_frames, (unsigned long long)run->n,
             (unsigned long long)d3dgs_keys[key].width, (unsigned long long)run->n,
             (unsigned long long)d3dgs_keys[key].width);
    return spin_d3dgs_fail_shape(a, d3dgs_keys[key].name, expected);
}

/* What the arrays unpack to and a frame made of them, held against the memory that is there, before any
 * is unpacked: deflate yields a thousand times what went in. */
static spin_status d3dgs_check_room(const struct d3dgs_run *run)
{
    uint64_t unpacked = 0, width = 0, frame, available = spin_memory_available();

    for (int k = 0; k < D3DGS_N_KEYS; k++) {
        unpacked += spin_npz_unpacked(&run->npz, d3dgs_keys[k].name);
        width += d3dgs_keys[k].width;
    }
    frame = run->n * width * sizeof(float);
    if (unpacked == 0 || unpacked + frame <= available)
        return SPIN_OK;
    return spin_fail(
        SPIN_E_MEMORY,
        "cannot read '%s': its arrays unpack to %.1f MB and a frame takes %.1f MB, but "
        "only %.1f MB of memory are there",
        run->base.path, (double)unpacked / 1e6, (double)frame / 1e6, (double)available / 1e6);
}

static void d3dgs_describe(const struct d3dgs_run *run)
{
    struct spin_sequence_info *sequence = run->base.sequence;

    for (uint64_t t = 0; t < run->n_frames; t++)
        run->counts[t] = (size_t)run->n;
    sequence->n_frames = (int)run->n_frames;
    sequence->counts = run->counts;
    sequence->identity = true;
    sequence->sh_degree = 0;
    sequence->time_last = (double)(run->n_frames - 1);
    for (int k = 0; k < D3DGS_N_KEYS; k++) {
        sequence->columns |= 1u << d3dgs_keys[k].column;
        if (run->array[k].n_dims == 2)
            sequence->static_columns |= 1u << d3dgs_keys[k].column;
    }
}

spin_status spin_d3dgs_load(const char *path, struct d3dgs_run *run)
{
    struct spin_model *base = &run->base;

    if (spin_path_is_folder(path))
        SPIN_TRY(spin_model_join(base, &base->path, path, "params.npz"));
    else
        SPIN_TRY(spin_model_text(base, &base->path, "%s", path));
    SPIN_TRY(spin_npz_open(base->path, &run->npz));
    if (spin_npz_has(&run->npz, "cam_unnorm_rots"))
        return spin_fail(SPIN_E_UNSUPPORTED,
                         "array 'cam_unnorm_rots' says that this is a map of SplaTAM or one of its "
                         "descendants, which has no frames");
    SPIN_TRY(d3dgs_check_means(run));
    for (int k = D3DGS_MEANS + 1; k < D3DGS_N_KEYS; k++)
        SPIN_TRY(d3dgs_check_column(run, k));
    SPIN_TRY(d3dgs_check_room(run));
    for (int k = 0; k < D3DGS_N_KEYS; k++)
        SPIN_TRY(spin_d3dgs_array(run, d3dgs_keys[k].name, &run->array[k]));
    SPIN_TRY(
        spin_model_alloc(base, (size_t)run->n_frames, sizeof *run->counts, (void **)&run->counts));
    d3dgs_describe(run);
    return SPIN_OK;
}

void spin_d3dgs_close(void *self)
{
    if (self)
        spin_npz_close(&((struct d3dgs_run *)self)->npz);
    spin_model_close(self);
}

/* ---- Reading --------------------------------------------------------------------------------- */

/* Values of one frame as they are stored; all must be finite. */
static spin_status d3dgs_column(const struct d3dgs_run *run, int key, int frame, float *out)
{
    const struct spin_array *a = &run->array[key];
    uint64_t count = run->n * d3dgs_keys[key].width;
    uint64_t first = a->n_dims == 3 ? (uint64_t)frame * count : 0;
    uint64_t bad;

    spin_array_to_f32(a, first, count, out);
    if (a->n_dims == 3)
        spin_npz_forget(&run->npz, a, first, count);
    bad = spin_finite_missing(out, (size_t)count);
    if (bad > 0)
        return spin_fail(SPIN_E_MALFORMED,
                         "cannot read '%s': array '%s' has %llu values in frame %d that are not "
                         "finite",
                         run->base.path, d3dgs_keys[key].name, (unsigned long long)bad, frame);
    return SPIN_OK;
}

spin_status spin_d3dgs_read(const struct d3dgs_run *run, int frame, unsigned columns,
                            struct spin_splats *out)
{
    size_t n = (size_t)run->n;

    if (frame < 0 || (uint64_t)frame >= run->n_frames)
        return spin_fail(SPIN_E_NOT_FOUND, "'%s' has no frame %d", run->base.path, frame);
    columns &= SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    SPIN_TRY(spin_splats_reserve(out, n, columns, 0));
    for (int k = 0; k < D3DGS_N_KEYS; k++) {
        size_t width;

        if (columns & 1u << d3dgs_keys[k].column)
            SPIN_TRY(
                d3dgs_column(run, k, frame, spin_model_values(out, d3dgs_keys[k].column, &width)));
    }
    /* The zero quaternion, which the method would turn into no rotation matrix at all, is identity. */
    for (size_t i = 0; columns & SPIN_COL_QUATS && i < n; i++)
        spin_quat_normalise(out->quats + 4 * i);
    for (size_t i = 0; columns & SPIN_COL_SH && i < 3 * n; i++)
        out->sh[i] = (float)((out->sh[i] - 0.5) / SPIN_SH_C0);
    return SPIN_OK;
}
