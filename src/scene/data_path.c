#include "scene/data_path.h"

#include "base/base.h"
#include "io/file.h"
#include "scene/probe.h"

spin_status spin_bundle_set_data_path(struct spin_bundle_meta *meta, const char *folder,
                                      const char *data)
{
    SPIN_TRY(spin_path_relative(folder, data, &meta->data_path));
    return spin_path_absolute(data, &meta->data_absolute);
}

/* Joins a folder and a relative path. The result need not exist. Each leading "../" of the path
 * removes one component of the folder. */
static spin_status resolve_path(const char *folder, const char *path, char **out)
{
    SPIN_FREED char *from = NULL;

    SPIN_TRY(spin_path_absolute(folder, &from));
    for (size_t n; *path; path += n + (path[n] == '/')) {
        char *slash = strrchr(from, '/');

        n = strcspn(path, "/");
        if (n == 2 && strncmp(path, "..", 2) == 0 && slash)
            *slash = '\0';
        else if (n > 1 || (n == 1 && *path != '.'))
            break;
    }
    return *path ? spin_path_join(from, path, out) : spin_strdup(*from ? from : "/", out);
}

/* Returns whether a path is a data set. The relative path that the bundle records is often just
 * "..", which leads to an unrelated folder if the bundle was moved without its data set. */
static bool is_data_set(const char *path) { return spin_importer_guess(path, true) != NULL; }

spin_status spin_bundle_data_path(const struct spin_bundle *bundle, char **out)
{
    const char *path = bundle->meta.data_path, *absolute = bundle->meta.data_absolute;
    bool there;
    SPIN_FREED char *folder = NULL, *beside = NULL;

    *out = NULL;
    if (!path)
        return SPIN_OK;
    if (path[0] == '/')
        return spin_strdup(path, out);
    SPIN_TRY(spin_path_folder(bundle->path, &folder));
    SPIN_TRY(resolve_path(folder, path, &beside));
    there = spin_path_exists(beside);
    if (absolute &&
        (!there || (spin_path_exists(absolute) && !is_data_set(beside) && is_data_set(absolute))))
        return spin_strdup(absolute, out);
    return there ? spin_path_absolute(beside, out) : spin_strdup(beside, out);
}
