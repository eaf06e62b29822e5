#include "exporters/lib/transforms_file.h"

#include <math.h>
#include <string.h>

#include "base/err.h"
#include "base/mem.h"
#include "io/file.h"

static const char *const file_name[2] = {"transforms_train.json", "transforms_test.json"};

/* Creates the matrix camera-to-world. Its axes are those of OpenGL: y up, and z backward. */
static spin_json *matrix_of(const struct spin_camera *c)
{
    spin_json *rows = spin_json_array();

    for (int r = 0; r < 4; r++) {
        spin_json *row = spin_json_array();

        for (int k = 0; k < 4; k++) {
            double value = k == 3 ? r == 3 : 0;

            if (r < 3 && k < 3)
                value = (k == 0 ? 1 : -1) * c->w2c[4 * k + r];
            for (int i = 0; i < 3 && r < 3 && k == 3; i++)
                value -= c->w2c[4 * i + r] * c->w2c[4 * i + 3];
            spin_json_push(row, spin_json_number_value(value));
        }
        spin_json_push(rows, row);
    }
    return rows;
}

static spin_json *begin_file(const struct spin_camera *c)
{
    spin_json *root = spin_json_object();

    spin_json_set_number(root, "camera_angle_x", 2 * atan(0.5 * c->width / c->fx));
    spin_json_set_integer(root, "w", c->width);
    spin_json_set_integer(root, "h", c->height);
    spin_json_set(root, "frames", spin_json_array());
    return root;
}

void spin_transforms_file_add(struct spin_transforms_file *t, const char *name, double time,
                              const struct spin_camera *c, bool test)
{
    const char *dot = strrchr(name, '.');
    spin_json *frame = spin_json_object();

    if (!t->root[test])
        t->root[test] = begin_file(c);
    spin_json_set(frame, "file_path",
                  json_pack("s%", name, dot ? (size_t)(dot - name) : strlen(name)));
    spin_json_set_number(frame, "time", time);
    spin_json_set_integer(frame, "w", c->width);
    spin_json_set_integer(frame, "h", c->height);
    spin_json_set_number(frame, "fl_x", c->fx);
    spin_json_set_number(frame, "fl_y", c->fy);
    spin_json_set_number(frame, "cx", c->cx);
    spin_json_set_number(frame, "cy", c->cy);
    spin_json_set(frame, "transform_matrix", matrix_of(c));
    spin_json_push(spin_json_get(t->root[test], "frames"), frame);
}

spin_status spin_transforms_file_write(struct spin_transforms_file *t,
                                       struct spin_output_folder *folder, bool sync)
{
    for (int i = 0; i < 2; i++) {
        SPIN_FREED char *path = NULL, *text = NULL;

        if (!t->root[i])
            continue;
        SPIN_TRY(spin_path_join(folder->path, file_name[i], &path));
        text = spin_json_text(t->root[i], true);
        if (!text)
            return spin_fail(SPIN_E_MEMORY, "cannot write '%s': not enough memory", path);
        spin_output_folder_mark(folder, path);
        SPIN_TRY(spin_out_whole(path, text, strlen(text), sync));
    }
    return SPIN_OK;
}

void spin_transforms_file_close(struct spin_transforms_file *t)
{
    for (int i = 0; i < 2; i++)
        json_decref(t->root[i]);
    *t = (struct spin_transforms_file){0};
}
