/* Saves, clouds and cfg_args of a model folder. */
#include "importers/lib/model_folder.h"

#include <limits.h>
#include <math.h>
#include <stdlib.h>

#include "base/mem.h"
#include "importers/lib/finite.h"

/* ---- Folders --------------------------------------------------------------------------------- */

long long spin_model_folder_iteration(const char *name)
{
    const char *digits = name + 10;
    long long n = 0;

    if (strncmp(name, "iteration_", 10) != 0 || !*digits || strlen(digits) > 15)
        return -1;
    for (; *digits; digits++) {
        if (*digits < '0' || *digits > '9')
            return -1;
        n = 10 * n + (*digits - '0');
    }
    return n;
}

bool spin_model_folder_holds(const char *folder, const char *file)
{
    char *path = NULL;
    bool found = spin_path_join(folder, file, &path) == SPIN_OK && spin_path_exists(path);

    free(path);
    return found;
}

static bool model_folder_whole(const struct model_folder_pick *pick, const char *name)
{
    char *folder = NULL, *other = NULL;
    bool good = spin_path_join(pick->folder, name, &folder) == SPIN_OK &&
                spin_model_folder_holds(folder, pick->file);

    if (good && pick->other)
        good = spin_path_join(pick->other, name, &other) == SPIN_OK &&
               spin_model_folder_holds(other, pick->other_file);
    else if (good && pick->other_file)
        good = spin_model_folder_holds(folder, pick->other_file);
    free(folder);
    free(other);
    return good;
}

spin_status spin_model_folder_choose(const struct model_folder_pick *pick, const char *wanted,
                                     char **out)
{
    char **names = NULL;
    size_t n = 0;
    long long best = -2;
    spin_status status = SPIN_OK;

    SPIN_TRY(spin_folder_list(pick->folder, &names, &n));
    for (size_t i = 0; i < n && status == SPIN_OK; i++) {
        long long number = spin_model_folder_iteration(names[i]);

        if (number < 0 && strcmp(names[i], "iteration_best") != 0)
            continue;
        if (wanted ? strcmp(names[i] + 10, wanted) != 0 : number <= best)
            continue;
        if (!model_folder_whole(pick, names[i]))
            continue;
        best = number;
        free(*out);
        *out = NULL;
        status = spin_strdup(names[i], out);
    }
    spin_folder_list_free(names);
    return status;
}

spin_status spin_model_folder_save(const char *path, const char *wanted, const char *network,
                                   char **out)
{
    struct model_folder_pick pick = {path, "point_cloud.ply", NULL, network};
    char *clouds = NULL, *name = NULL;
    spin_status status;

    if (!spin_path_is_folder(path)) {
        const char *file = spin_path_name(path);

        if (strcmp(file, network) != 0 && strcmp(file, "point_cloud.ply") != 0)
            return spin_fail(SPIN_E_USAGE,
                             "'%s' is neither the model's folder nor its "
                             "point_cloud/iteration_<N>",
                             path);
        return spin_path_folder(path, out);
    }
    if (spin_model_folder_holds(path, network))
        return spin_strdup(path, out);
    SPIN_TRY(spin_path_join(path, "point_cloud", &clouds));
    if (spin_path_is_folder(clouds))
        pick.folder = clouds;
    status = spin_model_folder_choose(&pick, wanted, &name);
    if (status == SPIN_OK && name)
        status = spin_path_join(pick.folder, name, out);
    free(clouds);
    free(name);
    return status;
}

bool spin_model_folder_search(const char *path, const char *file, bool *coarse)
{
    char *clouds = NULL, **names = NULL;
    const char *folder = path;
    bool found = spin_model_folder_holds(path, file);
    size_t n = 0;

    *coarse = false;
    if (spin_path_join(path, "point_cloud", &clouds) == SPIN_OK && spin_path_is_folder(clouds))
        folder = clouds;
    if (spin_folder_list(folder, &names, &n) != SPIN_OK)
        n = 0;
    for (size_t i = 0; i < n; i++) {
        char *save = NULL;

        *coarse = *coarse || strncmp(names[i], "coarse_iteration_", 17) == 0;
        if (spin_path_join(folder, names[i], &save) == SPIN_OK)
            found = found || spin_model_folder_holds(save, file);
        free(save);
    }
    spin_folder_list_free(names);
    free(clouds);
    return found;
}

spin_status spin_model_folder_beside(const char *path, const char *save, const char *name,
                                     char **out)
{
    static const char *const above[] = {"", "", "../", "../../"};

    *out = NULL;
    for (int i = 0; i < (save ? 4 : 1); i++) {
        char relative[64];

        snprintf(relative, sizeof relative, "%s%s", above[i], name);
        SPIN_TRY(spin_path_join(i == 0 ? path : save, relative, out));
        if (spin_path_exists(*out))
            return SPIN_OK;
        free(*out);
        *out = NULL;
    }
    return SPIN_OK;
}

spin_status spin_model_folder_cfg(const char *path, const char *save, struct cfg_args *cfg)
{
    char *file = NULL;
    spin_status status;

    memset(cfg, 0, sizeof *cfg);
    SPIN_TRY(spin_model_folder_beside(path, save, "cfg_args", &file));
    status = file ? spin_cfg_open(file, cfg) : SPIN_OK;
    free(file);
    return status;
}

/* ---- The cloud ------------------------------------------------------------------------------- */

spin_status spin_model_folder_column(const struct spin_ply *ply, const struct spin_ply_element *e,
                                     const char *name, float *out, size_t step)
{
    int p = spin_ply_find(e, name);
    uint64_t bad = 0;

    if (p < 0)
        return spin_fail(SPIN_E_MALFORMED, "'%s': element 'vertex' has no property '%s'", ply->path,
                         name);
    spin_ply_column(ply, e, p, out, step);
    for (uint64_t i = 0; i < e->count; i++)
        bad += !isfinite(out[i * step]);
    if (bad > 0)
        return spin_fail(SPIN_E_MALFORMED, "'%s': %llu values of '%s' are not finite", ply->path,
                         (unsigned long long)bad, name);
    return SPIN_OK;
}

spin_status spin_model_folder_columns(const struct spin_ply *ply, const struct spin_ply_element *e,
                                      const char *prefix, int n, float *out, size_t step)
{
    for (int i = 0; i < n; i++) {
        char name[64];

        snprintf(name, sizeof name, "%s%d", prefix, i);
        SPIN_TRY(spin_model_folder_column(ply, e, name, out + i, step));
    }
    return SPIN_OK;
}

int spin_model_folder_count(const struct spin_ply_element *e, const char *prefix)
{
    int n = 0;

    for (size_t i = 0; i < e->n_properties; i++)
        n += strncmp(e->property[i].name, prefix, strlen(prefix)) == 0;
    return n;
}

spin_status spin_model_folder_open(const char *path, struct spin_ply *ply,
                                   const struct spin_ply_element **vertex)
{
    spin_status status = SPIN_OK;

    SPIN_TRY(spin_ply_open(path, ply));
    *vertex = spin_ply_find_element(ply, "vertex");
    if (!*vertex)
        status = spin_fail(SPIN_E_MALFORMED, "'%s': no element 'vertex'", path);
    else if ((*vertex)->count == 0)
        status = spin_fail(SPIN_E_MALFORMED, "'%s': 0 vertices", path);
    else if ((*vertex)->count > INT_MAX)
        status = spin_fail(SPIN_E_UNSUPPORTED, "'%s': more than 2^31 vertices", path);
    if (status != SPIN_OK)
        spin_ply_close(ply);
    return status;
}

spin_status spin_model_folder_cloud(const char *path, struct spin_ply *ply,
                                    struct spin_gs_ply *cloud)
{
    spin_status status;

    SPIN_TRY(spin_ply_open(path, ply));
    status = spin_gs_ply_find(ply, cloud);
    if (status == SPIN_OK && cloud->vertex->count > INT_MAX)
        status = spin_fail(SPIN_E_UNSUPPORTED, "'%s': more than 2^31 vertices", path);
    if (status == SPIN_OK && cloud->n_rest > (int)spin_n_rest(3))
        status =
            spin_fail(SPIN_E_MALFORMED,
                      "'%s': %d properties f_rest_*, expected 0, 9, 24 or 45 (SH degree 0 to 3)",
                      path, cloud->n_rest);
    if (status != SPIN_OK)
        spin_ply_close(ply);
    return status;
}

spin_status spin_model_folder_read(const char *path, struct spin_splats *out,
                                   const char *extra_name, float **extra)
{
    const unsigned columns = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    struct spin_gs_ply cloud;
    struct spin_ply ply;
    size_t n;
    spin_status status;

    SPIN_TRY(spin_model_folder_cloud(path, &ply, &cloud));
    n = (size_t)cloud.vertex->count;
    if (n == 0)
        SPIN_TRY_OUT(spin_fail(SPIN_E_MALFORMED, "'%s': 0 vertices", path));
    SPIN_TRY_OUT(spin_splats_reserve(out, n, columns, cloud.sh_degree));
    SPIN_TRY_OUT(spin_gs_ply_read(&cloud, columns, 0, out));
    if (extra) {
        SPIN_TRY_OUT(spin_alloc(n, sizeof **extra, (void **)extra));
        SPIN_TRY_OUT(spin_model_folder_column(&ply, cloud.vertex, extra_name, *extra, 1));
    }
out:
    spin_ply_close(&ply);
    return status;
}

/* ---- Finished columns ------------------------------------------------------------------------ */

spin_status spin_model_folder_check(const char *path, double time, unsigned columns,
                                    const struct spin_splats *s)
{
    const struct {
        unsigned column;
        const float *values;
        size_t width;
        const char *name;
    } all[] = {
        {SPIN_COL_MEANS, s->means, 3, "positions"},
        {SPIN_COL_QUATS, s->quats, 4, "rotations"},
        {SPIN_COL_LOG_SCALES, s->log_scales, 3, "scales"},
        {SPIN_COL_LOGIT_OPACITIES, s->logit_opacities, 1, "opacities"},
        {SPIN_COL_SH, s->sh, 3 * (size_t)((s->sh_degree + 1) * (s->sh_degree + 1)), "colours"},
    };

    for (size_t c = 0; c < sizeof all / sizeof *all; c++) {
        size_t bad =
            columns & all[c].column ? spin_finite_missing(all[c].values, s->n * all[c].width) : 0;

        if (bad > 0)
            return spin_fail(SPIN_E_MALFORMED,
                             "'%s': %zu values of the %s at time %g are not finite", path, bad,
                             all[c].name, time);
    }
    return SPIN_OK;
}
