/* Frames of deformed clouds. */
#include "importers/lib/deform.h"

#include <string.h>

#include "importers/lib/model_folder.h"
#include "math/covariance.h"
#include "math/quat.h"

static void copy(float *to, const float *from, size_t n) { memcpy(to, from, n * sizeof *to); }

static void copy_still(const struct spin_splats *from, unsigned columns, struct spin_splats *out)
{
    size_t n = from->n, n_sh = 3 * (size_t)((from->sh_degree + 1) * (from->sh_degree + 1));

    if (columns & SPIN_COL_MEANS)
        copy(out->means, from->means, 3 * n);
    if (columns & SPIN_COL_LOG_SCALES)
        copy(out->log_scales, from->log_scales, 3 * n);
    if (columns & SPIN_COL_LOGIT_OPACITIES)
        copy(out->logit_opacities, from->logit_opacities, n);
    if (columns & SPIN_COL_SH)
        copy(out->sh, from->sh, n_sh * n);
    if (columns & SPIN_COL_QUATS) {
        copy(out->quats, from->quats, 4 * n);
        for (size_t i = 0; i < n; i++)
            spin_quat_normalise(out->quats + 4 * i);
    }
}

spin_status spin_deform_frame(const char *path, const struct spin_splats *canonical, double time,
                              unsigned columns, unsigned moved, struct mlp_team *team,
                              mlp_block_fn fn, const void *model, struct spin_splats *out)
{
    struct deform_job job = {model, out, columns, (float)time};

    if (!isfinite(time))
        return spin_fail(SPIN_E_USAGE, "'%s' has no time %g", path, time);
    columns &= SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    SPIN_TRY(spin_splats_reserve(out, canonical->n, columns, canonical->sh_degree));
    copy_still(canonical, columns & ~moved, out);
    if (columns & moved)
        spin_mlp_team_run(team, canonical->n, fn, &job);
    return spin_model_folder_check(path, time, columns, out);
}

void spin_deform_describe(const struct spin_splats *canonical, unsigned moved,
                          struct spin_sequence_info *sequence)
{
    sequence->n_frames = 1;
    sequence->identity = true;
    sequence->counts = &canonical->n;
    sequence->columns = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    sequence->static_columns = sequence->columns & ~moved;
    sequence->sh_degree = canonical->sh_degree;
    sequence->continuous = true;
    sequence->time_last = 1;
}

void spin_deform_shape(const float log_scale[3], const float quat[4], const float *d_scale,
                       const float *d_quat, float *out_log_scale, float *out_quat)
{
    double norm = spin_quat_norm(quat), scale[3], q[4], cov6[6];
    double log_scales[3] = {NAN, NAN, NAN}, unit[4] = {NAN, NAN, NAN, NAN};

    for (int i = 0; i < 4; i++)
        q[i] = (norm > 0 ? quat[i] / norm : 0) + d_quat[i * MLP_BLOCK];
    for (int i = 0; i < 3; i++)
        scale[i] = exp(log_scale[i]) + d_scale[i * MLP_BLOCK];
    spin_covariance_unnormalised(scale, q, cov6);
    spin_covariance_split(cov6, log_scales, unit);
    for (int i = 0; out_log_scale && i < 3; i++)
        out_log_scale[i] = (float)log_scales[i];
    for (int i = 0; out_quat && i < 4; i++)
        out_quat[i] = (float)unit[i];
}
