#include "io/picture_name.h"

#include <stdio.h>

void spin_picture_name(const struct spin_views *views, size_t view, int number, const char *label,
                       char name[SPIN_PICTURE_NAME])
{
    const struct spin_view *v = &views->view[view];
    char twin[16] = "";
    size_t first = view;

    /* views are sorted by row, then camera */
    while (first > 0 && views->view[first - 1].dataset_frame == v->dataset_frame &&
           views->view[first - 1].camera_id == v->camera_id)
        first--;
    if (first < view)
        snprintf(twin, sizeof twin, "_%d", (int)(view - first + 1));
    snprintf(name, SPIN_PICTURE_NAME, "cam_%02d%s_frame_%05d%s%s.png", v->camera_id, twin, number,
             label ? "_" : "", label ? label : "");
}

void spin_picture_name_moving(const char *path, int number, char name[SPIN_PICTURE_NAME])
{
    snprintf(name, SPIN_PICTURE_NAME, "%s_frame_%05d.png", path, number);
}
