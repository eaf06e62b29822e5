/* Images, behind a C face: PNG and JPEG by libpng and libjpeg (spin-image-plain.so), other files by
 * OpenImageIO (spin-image.so). Each is loaded on first use, as OpenImageIO takes a fifth of a
 * second to start. Thread-safe. */
#pragma once

#include "io/file.h"

/* Wherever a path is taken, it may also name a frame of a video, as io/video.h has it. */

/* Load what reads and writes PNG and JPEG now. Errors say what to install. */
spin_status spin_image_start(void);

/* Size and channels without decoding. */
spin_status spin_image_size(const char *path, int *width, int *height, int *channels);

/* Look at a file without decoding: it is there, its header can be read, and it is all there: a JPEG
 * runs segment by segment to its end marker, a PNG chunk by chunk to IEND, anything else has a byte
 * at least. Of a video, whose imprint is that of the whole file, the frame is one that it has. */
spin_status spin_image_look(const char *path, int *width, int *height,
                            struct spin_imprint *imprint);

/* Decode to interleaved 8-bit RGB [h][w][3], allocated with malloc; grey is spread, 16-bit is
 * rounded, and what has alpha is composited over `background` (0..1; NULL: black) as the methods do
 * it: on the stored values, colour * alpha + background * (1 - alpha); EXR's are brought from light
 * to the screen first. Sizes above 64 Mi pixels are refused. */
spin_status spin_image_read(const char *path, const float background[3], int *width, int *height,
                            uint8_t **rgb);

/* The bytes of a PNG file of interleaved 8-bit RGB, allocated with malloc. */
spin_status spin_image_encode(int width, int height, const uint8_t *rgb, unsigned char **bytes,
                              size_t *n_bytes);

/* Write interleaved 8-bit RGB as PNG (write, then rename; sync: wait for the disk between). */
spin_status spin_image_write(const char *path, int width, int height, const uint8_t *rgb,
                             bool sync);

/* A picture of splats as films want it, written as spin_image_write() does. `image` [3][h][w] holds
 * the values that splats blend, which are those of the screen (sRGB), over black where there is
 * alpha. */
struct spin_film {
    int width, height;
    const float *image;
    const float *alpha; /* [h][w], or NULL */
    const float *depth; /* [2][h][w] expected and median, channels Z and ZMedian; EXR; or NULL */
    bool exr;           /* else PNG */
    int bits;           /* PNG: 8 or 16; EXR: 16 (half) or 32 */
    bool linear;        /* EXR: values become those of light, colour by colour */
};
spin_status spin_film_write(const char *path, const struct spin_film *film, bool sync);

/* Of a picture drawn from a view, the same wherever pictures are written: "cam_07_frame_00012.png".
 * label: goes before the ending, or NULL. The second camera that a row has with the same number,
 * which happens, is "cam_07_2". */
enum { SPIN_PICTURE_NAME = 128 };
void spin_picture_name(const struct spin_views *views, size_t view, int number, const char *label,
                       char name[SPIN_PICTURE_NAME]);
/* The same of a camera that moves: the number is the picture's, "orbit_frame_00012.png". */
void spin_picture_name_moving(const char *path, int number, char name[SPIN_PICTURE_NAME]);
