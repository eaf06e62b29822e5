/* Images, with a C interface: PNG and JPEG by libpng and libjpeg (spin-image-plain.so), other
 * formats by OpenImageIO (spin-image.so). Each shared object is loaded on first use, since loading
 * OpenImageIO takes a fifth of a second. Thread-safe. */
#pragma once

#include "spin.h"
#include "io/file.h"

/* For the functions that read, a path may also name a frame of a video, such as "cam00.mp4#12"; see
 * io/video.h. */

/* Load the reader and writer of PNG and JPEG now. Errors state what to install. */
spin_status spin_image_start(void);

/* Read the size of an image and its number of channels, without decoding its pixels. */
spin_status spin_image_size(const char *path, int *width, int *height, int *channels);

/* Check, without decoding, that a file exists, that its header is readable, and that it is
 * complete: a JPEG must have all segments up to its end marker, a PNG all chunks up to IEND, and
 * any other file must not be empty. For a frame of a video, check that the video has this frame;
 * `digest` then identifies the whole video. */
spin_status spin_image_check(const char *path, int *width, int *height, struct spin_digest *digest);

/* Decode to interleaved 8-bit RGB [h][w][3], allocated with malloc. Grey is replicated, 16-bit
 * values are rounded, and alpha is composited over `background` (0..1; NULL: black) as the
 * published methods do: on the stored values, as colour * alpha + background * (1 - alpha). EXR
 * values are first converted from linear to sRGB. Images above 64 Mi pixels are refused. */
spin_status spin_image_read(const char *path, const float background[3], int *width, int *height,
                            uint8_t **rgb);

/* Encode interleaved 8-bit RGB as a PNG file in memory, allocated with malloc. */
spin_status spin_image_encode(int width, int height, const uint8_t *rgb, unsigned char **bytes,
                              size_t *n_bytes);

/* Write interleaved 8-bit RGB as a PNG file, which gets its final name when it is complete. sync:
 * flush the file to the disk before it gets this name. */
spin_status spin_image_write(const char *path, int width, int height, const uint8_t *rgb,
                             bool sync);

/* A rendered image for compositing in film production. The file gets its final name when it is
 * complete. `image` [3][h][w] contains the blended sRGB values, composited over black if there is
 * an alpha channel. */
struct spin_film {
    int width, height;
    const float *image;
    const float *alpha; /* [h][w]; NULL: the file gets no alpha channel */
    /* [2][h][w]: expected and median depth, written as channels Z and ZMedian. NULL: no depth is
     * written; must be NULL for PNG. */
    const float *depth;
    bool exr;    /* write an EXR file; if false, a PNG file */
    int bits;    /* bits per value; PNG: 8 or 16; EXR: 16 (half) or 32 */
    bool linear; /* write linear colours, converted from sRGB; false for PNG */
    double fps;  /* frames per second, stored in EXR files; 0: unknown */
};
spin_status spin_film_write(const char *path, const struct spin_film *film, bool sync);

/* Format the file name of an image rendered from a view, such as "cam_07_frame_00012.png" for
 * camera 7 and frame number 12. All commands use these names. If a frame has two cameras with
 * number 7, the second is called "cam_07_2". label: a text that is inserted before the extension,
 * after an underscore; NULL: none. */
enum { SPIN_IMAGE_NAME = 128 };
void spin_image_name(const struct spin_views *views, size_t view, int number, const char *label,
                     char name[SPIN_IMAGE_NAME]);
/* Format the file name of image `number` of a camera path, such as "orbit_frame_00012.png" for the
 * path "orbit". */
void spin_image_name_moving(const char *path, int number, char name[SPIN_IMAGE_NAME]);

/* ---- Images that are rendered ---------------------------------------------------------------- */

/* Images that are rendered from a bundle when they are read, instead of being decoded from a file.
 * Their path is the path of the bundle, followed by "#draw=" and a description of the view. The
 * functions above read them like other images. */

#define SPIN_DRAWN_MARK "#draw="

/* Renders the image over the background (NULL: black) to interleaved 8-bit RGB [h][w][3], allocated
 * with malloc. If rgb is NULL, only the size is set. */
typedef spin_status (*spin_draw_image_fn)(const char *path, const float background[3], int *width,
                                          int *height, uint8_t **rgb);
/* Sets the function that renders all such images. While it is NULL, they cannot be read. */
void spin_drawn_images_set(spin_draw_image_fn draw);

bool spin_image_is_drawn(const char *path);
