/* Frames and checkpoints of methods with deformed clouds. */
#include "importers/lib/deform.h"

#include "math/covariance.h"
#include "math/quat.h"

spin_status spin_deform_frame(struct spin_model *m, double time, unsigned columns, unsigned moved,
                              mlp_block_fn fn, struct spin_splats *out)
{
    const struct spin_splats *from = &m->canonical;
    struct deform_job job = {m, from, out, columns, (float)time};

    if (!isfinite(time))
        return spin_misuse("'%s': time %g is not finite", m->path, time);
    columns &= SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    SPIN_TRY(spin_splats_reserve(out, from->n, columns, from->sh_degree));
    for (int c = 0; c < SPIN_MODEL_COLUMNS; c++) {
        size_t width;
        const float *values = spin_model_values(from, c, &width);

        if (columns & ~moved & 1u << c)
            memcpy(spin_model_values(out, c, &width), values, from->n * width * sizeof *values);
    }
    for (size_t i = 0; columns & ~moved & SPIN_COL_QUATS && i < from->n; i++)
        spin_quat_normalise(out->quats + 4 * i);
    if (columns & moved)
        spin_mlp_team_run(&m->team, from->n, fn, &job);
    return spin_model_check(m->path, time, columns, out);
}

void spin_deform_shape(const struct deform_job *job, size_t first, int n, const float *d_scale,
                       const float *d_quat)
{
    for (size_t p = 0, row = first; p < (size_t)n; p++, row++) {
        const float *quat = job->from->quats + 4 * row;
        double norm = spin_quat_norm(quat), scale[3], q[4], cov6[6];
        double log_scales[3] = {NAN, NAN, NAN}, unit[4] = {NAN, NAN, NAN, NAN};

        for (size_t i = 0; i < 4; i++)
            q[i] = (norm > 0 ? quat[i] / norm : 0) + d_quat[i * MLP_BLOCK + p];
        for (size_t i = 0; i < 3; i++)
            scale[i] = exp(job->from->log_scales[3 * row + i]) + d_scale[i * MLP_BLOCK + p];
        spin_covariance_unnormalised(scale, q, cov6);
        spin_covariance_split(cov6, log_scales, unit);
        for (size_t i = 0; job->columns & SPIN_COL_LOG_SCALES && i < 3; i++)
            job->out->log_scales[3 * row + i] = (float)log_scales[i];
        for (size_t i = 0; job->columns & SPIN_COL_QUATS && i < 4; i++)
            job->out->quats[4 * row + i] = (float)unit[i];
    }
}

/* ---- Checkpoints ----------------------------------------------------------------------------- */

/* Refuses a model whose last cloud and last network belong to different checkpoints: the user must
 * choose a checkpoint. */
static spin_status check_newest(struct spin_model *m, const char *path, const char *clouds,
                                const char *deforms, const char *found)
{
    const char *cloud, *deform;

    SPIN_TRY(spin_model_choose(m, NULL, clouds, "point_cloud.ply", NULL, NULL, &cloud));
    SPIN_TRY(spin_model_choose(m, NULL, deforms, "deform.pth", NULL, NULL, &deform));
    if (!cloud)
        return spin_not_found("'%s' has no iteration_<N> with point_cloud.ply", clouds);
    if (!deform)
        return spin_not_found("'%s' has no iteration_<N> with deform.pth", deforms);
    if (strcmp(cloud, deform) == 0)
        return SPIN_OK;
    return spin_malformed("'%s': the last cloud is from %s, but the last network is from %s: %s%s",
                          path, cloud, deform,
                          found ? "choose a checkpoint with --iteration; the last complete one is "
                                : "no iteration has both; the folders may come from two runs, or "
                                  "may not be copied completely",
                          found ? found : "");
}

spin_status spin_deform_find(struct spin_model *m, const char *path, bool together,
                             struct deform_save *out)
{
    const char *wanted = spin_model_option(m, "iteration"), *clouds, *deforms;

    out->model = path;
    if (!spin_path_is_folder(path)) {
        const char *whole, *folder;

        SPIN_TRY(spin_model_absolute(m, &whole, path));
        SPIN_TRY(spin_model_folder(m, &folder, whole));
        SPIN_TRY(spin_model_folder(m, &deforms, folder));
        SPIN_TRY(spin_model_folder(m, &out->model, deforms));
        if (strcmp(spin_path_name(whole), "deform.pth") != 0 ||
            strncmp(spin_path_name(folder), "iteration_", 10) != 0)
            return spin_misuse(
                "'%s' is neither the model's folder nor its deform/iteration_<N>/deform.pth", path);
        wanted = spin_path_name(folder) + 10;
    }
    SPIN_TRY(spin_model_join(m, &clouds, out->model, "point_cloud"));
    SPIN_TRY(spin_model_join(m, &deforms, out->model, "deform"));
    if (!spin_path_is_folder(clouds) || !spin_path_is_folder(deforms))
        return spin_not_found("'%s' has no folder '%s'", out->model,
                              spin_path_is_folder(clouds) ? "deform" : "point_cloud");
    SPIN_TRY(
        spin_model_choose(m, wanted, clouds, "point_cloud.ply", deforms, "deform.pth", &out->name));
    if (!wanted && together)
        SPIN_TRY(check_newest(m, out->model, clouds, deforms, out->name));
    if (!out->name)
        return spin_not_found("'%s' has no iteration_%s with both a cloud and a network",
                              out->model, wanted ? wanted : "<N>");
    SPIN_TRY(spin_model_join(m, &out->cloud, clouds, "%s/point_cloud.ply", out->name));
    return spin_model_join(m, &out->network, deforms, "%s/deform.pth", out->name);
}
