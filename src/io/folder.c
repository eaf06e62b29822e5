/* One rule for every exporter that fills a folder: what was there is not touched unasked. */
#include "io/folder.h"

#include <stdlib.h>
#include <unistd.h>

#include "base/err.h"
#include "base/mem.h"

static spin_status take_existing(const char *path, bool force, struct spin_out_folder *out)
{
    char **names = NULL;

    if (!spin_path_is_folder(path))
        return spin_fail(SPIN_E_IO, "'%s' exists and is not a folder", path);
    SPIN_TRY(spin_folder_list(path, &names, &out->n_before));
    spin_folder_list_free(names);
    if (out->n_before > 0 && !force)
        return spin_fail(SPIN_E_IO, "folder '%s' exists and is not empty; use --force to overwrite",
                         path);
    return SPIN_OK;
}

spin_status spin_out_folder_begin(const char *path, bool force, struct spin_out_folder *out)
{
    *out = (struct spin_out_folder){0};
    if (spin_path_exists(path)) {
        SPIN_TRY(take_existing(path, force, out));
    } else {
        SPIN_TRY(spin_folder_make(path));
        out->created = true;
    }
    return spin_strdup(path, &out->path);
}

void spin_out_folder_end(struct spin_out_folder *folder)
{
    free(folder->path);
    *folder = (struct spin_out_folder){0};
}

void spin_out_folder_abandon(struct spin_out_folder *folder)
{
    if (folder->created && folder->path)
        (void)rmdir(folder->path); /* refuses when files are in it, which is what we want */
    spin_out_folder_end(folder);
}
