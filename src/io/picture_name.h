/* What the files of pictures are called. */
#ifndef SPIN_IO_PICTURE_NAME_H
#define SPIN_IO_PICTURE_NAME_H

#include "spin.h"

/* Of a picture drawn from a view, the same wherever pictures are written: "cam_07_frame_00012.png".
 * label: goes before the ending, or NULL. The second camera that a row has with the same number, which happens, is
 * "cam_07_2". */
enum { SPIN_PICTURE_NAME = 128 };
void spin_picture_name(const struct spin_views *views, size_t view, int number, const char *label,
                       char name[SPIN_PICTURE_NAME]);
/* The same of a camera that moves: the number is the picture's, "orbit_frame_00012.png". */
void spin_picture_name_moving(const char *path, int number, char name[SPIN_PICTURE_NAME]);

#endif
