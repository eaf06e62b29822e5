/* Finding the two halves of a save. */
#include "importers/lib/deform_save.h"

#include <stdlib.h>
#include <string.h>

#include "base/mem.h"
#include "importers/lib/model_folder.h"

/* The newest save of one side; *out stays NULL when there is none. */
static spin_status newest(const char *folder, const char *file, char **out)
{
    struct model_folder_pick pick = {folder, file, NULL, NULL};

    return spin_model_folder_choose(&pick, NULL, out);
}

/* Both sides must end with the same save, or the user must say which. */
static spin_status check_newest(const char *path, const char *clouds, const char *deforms,
                                const char *found)
{
    char *cloud = NULL, *deform = NULL;
    spin_status status;

    SPIN_TRY_OUT(newest(clouds, "point_cloud.ply", &cloud));
    SPIN_TRY_OUT(newest(deforms, "deform.pth", &deform));
    if (!cloud)
        status =
            spin_fail(SPIN_E_NOT_FOUND, "'%s' has no iteration_<N> with point_cloud.ply", clouds);
    else if (!deform)
        status = spin_fail(SPIN_E_NOT_FOUND, "'%s' has no iteration_<N> with deform.pth", deforms);
    else if (strcmp(cloud, deform) != 0)
        status = spin_fail(SPIN_E_MALFORMED,
                           "'%s': the last cloud is %s but the last network is %s; %s%s", path,
                           cloud, deform,
                           found ? "say which with --iteration; both have "
                                 : "the folders are of two runs or half copied",
                           found ? found : "");
out:
    free(cloud);
    free(deform);
    return status;
}

static spin_status join3(const char *folder, const char *name, const char *file, char **out)
{
    char *middle = NULL;
    spin_status status = spin_path_join(folder, name, &middle);

    if (status == SPIN_OK)
        status = spin_path_join(middle, file, out);
    free(middle);
    return status;
}

/* The save `wanted` of a model, NULL: the last. */
static spin_status find_in_model(const char *path, const char *wanted, bool together,
                                 struct deform_save *out)
{
    struct model_folder_pick pick = {NULL, "point_cloud.ply", NULL, "deform.pth"};
    char *clouds = NULL, *deforms = NULL;
    spin_status status;

    SPIN_TRY_OUT(spin_path_join(path, "point_cloud", &clouds));
    SPIN_TRY_OUT(spin_path_join(path, "deform", &deforms));
    if (!spin_path_is_folder(clouds) || !spin_path_is_folder(deforms)) {
        status = spin_fail(SPIN_E_NOT_FOUND, "'%s' has no folder '%s'", path,
                           spin_path_is_folder(clouds) ? "deform" : "point_cloud");
        goto out;
    }
    pick.folder = clouds;
    pick.other = deforms;
    SPIN_TRY_OUT(spin_model_folder_choose(&pick, wanted, &out->name));
    if (!wanted && together)
        SPIN_TRY_OUT(check_newest(path, clouds, deforms, out->name));
    if (!out->name) {
        status =
            spin_fail(SPIN_E_NOT_FOUND, "'%s' has no iteration_%s with both a cloud and a network",
                      path, wanted ? wanted : "<N>");
        goto out;
    }
    SPIN_TRY_OUT(join3(clouds, out->name, "point_cloud.ply", &out->cloud));
    SPIN_TRY_OUT(join3(deforms, out->name, "deform.pth", &out->network));
out:
    free(clouds);
    free(deforms);
    return status;
}

spin_status spin_deform_save_find(const char *path, const char *wanted, bool together,
                                  struct deform_save *out)
{
    static const char save[] = "iteration_";
    char *whole = NULL, *folder = NULL, *deforms = NULL;
    const char *name;
    spin_status status;

    memset(out, 0, sizeof *out);
    if (spin_path_is_folder(path)) {
        SPIN_TRY(spin_strdup(path, &out->model));
        return find_in_model(path, wanted, together, out);
    }
    SPIN_TRY_OUT(spin_path_absolute(path, &whole));
    SPIN_TRY_OUT(spin_path_folder(whole, &folder));
    SPIN_TRY_OUT(spin_path_folder(folder, &deforms));
    name = spin_path_name(folder);
    if (strcmp(spin_path_name(whole), "deform.pth") != 0 ||
        strncmp(name, save, sizeof save - 1) != 0) {
        status = spin_fail(SPIN_E_USAGE,
                           "'%s' is neither the model's folder nor its "
                           "deform/iteration_<N>/deform.pth",
                           path);
        goto out;
    }
    SPIN_TRY_OUT(spin_path_folder(deforms, &out->model));
    status = find_in_model(out->model, name + sizeof save - 1, together, out);
out:
    free(whole);
    free(folder);
    free(deforms);
    return status;
}

void spin_deform_save_free(struct deform_save *save)
{
    free(save->model);
    free(save->name);
    free(save->cloud);
    free(save->network);
}
