#include "run/former_previews.h"

#include <unistd.h>

#include "base/base.h"
#include "io/file.h"

/* Returns whether the name is cam_CAMERA_frame_FRAME_iteration_ITERATION.png, see
 * spin_image_name(). */
static bool is_preview(const char *name)
{
    const char *frame = strstr(name, "_frame_"), *iteration = strstr(name, "_iteration_");
    size_t n_digits;

    if (strncmp(name, "cam_", 4) != 0 || !frame || !iteration || iteration < frame)
        return false;
    iteration += strlen("_iteration_");
    n_digits = strspn(iteration, "0123456789");
    return n_digits >= 7 && strcmp(iteration + n_digits, ".png") == 0;
}

static bool remove_file(const char *folder, const char *name)
{
    SPIN_FREED char *path = NULL;

    return spin_path_join(folder, name, &path) == SPIN_OK &&
           spin_out_check(path, true) == SPIN_OK && unlink(path) == 0;
}

void spin_former_previews_remove(const char *folder)
{
    char **names = NULL, text[48];
    size_t n = 0, n_removed = 0, n_left = 0;

    if (!spin_path_is_taken(folder) || spin_folder_list(folder, &names, &n) != SPIN_OK)
        return;
    for (size_t i = 0; i < n; i++)
        if (is_preview(names[i]))
            (*(remove_file(folder, names[i]) ? &n_removed : &n_left))++;
    spin_folder_list_free(names);
    if (n_removed > 0)
        spin_log(0, "removed %s of an earlier training from '%s'",
                 spin_text_count((long long)n_removed, "preview", text), folder);
    if (n_left > 0)
        spin_warn("cannot remove %s of an earlier training from '%s'",
                  spin_text_count((long long)n_left, "preview", text), folder);
}
