/* Reads and writes images: chooses a shim (a shared object that wraps an image library), checks
 * that files are complete, and reports failures.
 *
 * The check for completeness is needed because the decoders are lenient: libjpeg fills missing
 * parts with grey and reports success, and libpng prints to the terminal. */
#include "io/image.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "base/base.h"
#include "base/shim.h"
#include "io/image_shim.h"
#include "io/video.h"

#define MAX_PIXELS ((int64_t)64 << 20)
static const struct spin_image_shim *plain, *oiio;

static spin_status need_plain(void)
{
    static struct spin_shim where = {.file = "spin-image-plain.so",
                                     .override = "SPIN_IMAGE_PLAIN_SHIM",
                                     .symbol = SPIN_IMAGE_SHIM_SYMBOL,
                                     .abi = SPIN_IMAGE_SHIM_ABI,
                                     .lacking =
                                         "images cannot be read or written: the shared object",
                                     .debian = "libjpeg-dev and libpng-dev"};

    return spin_shim_load(&where, (const void **)&plain);
}

/* Load the plain shim first: its libpng must bind to its own functions, not to those that
 * image_oiio.cpp interposes for OpenImageIO. */
static spin_status need_oiio(void)
{
    static struct spin_shim where = {
        .file = "spin-image.so",
        .override = "SPIN_IMAGE_SHIM",
        .symbol = SPIN_IMAGE_SHIM_SYMBOL,
        .abi = SPIN_IMAGE_SHIM_ABI,
        .lacking = "images other than PNG and JPEG cannot be read or written: the shared object",
        .debian = "libopenimageio-dev"};

    (void)need_plain();
    return spin_shim_load(&where, (const void **)&oiio);
}

spin_status spin_image_start(void)
{
    return need_plain() == SPIN_OK || need_oiio() == SPIN_OK ? SPIN_OK : need_plain();
}

/* ---- Completeness --------------------------------------------------------------------------- */

static const unsigned char png_magic[8] = {0x89, 'P', 'N', 'G', '\r', '\n', 0x1a, '\n'};

/* Detect the format from the first bytes, ignoring the file's name. Returns "" for formats other
 * than PNG and JPEG. */
static const char *format_of(const struct spin_map *map)
{
    if (map->size >= 8 && memcmp(map->data, png_magic, 8) == 0)
        return "png";
    if (map->size >= 3 && map->data[0] == 0xff && map->data[1] == 0xd8 && map->data[2] == 0xff)
        return "jpeg";
    return "";
}

/* Whether a PNG is complete: its chunks (length, name, data, CRC) must end with the chunk IEND. */
static bool png_ends(const struct spin_map *map)
{
    size_t at = sizeof png_magic;

    while (map->size - at >= 12) {
        const unsigned char *c = map->data + at;
        uint64_t length = (uint64_t)c[0] << 24 | (uint64_t)c[1] << 16 | (uint64_t)c[2] << 8 | c[3];

        if (length > map->size - at - 12)
            return false;
        if (memcmp(c + 4, "IEND", 4) == 0)
            return true;
        at += 12 + (size_t)length;
    }
    return false;
}

/* Return the offset of the first marker at or after `at` that ends entropy-coded data: restart
 * markers and stuffed FF bytes belong to these data. If there is none, return the size of the file.
 */
static size_t skip_scan(const struct spin_map *map, size_t at)
{
    while (at + 1 < map->size) {
        const unsigned char *ff = memchr(map->data + at, 0xff, map->size - at - 1);

        if (!ff)
            break;
        if (ff[1] != 0 && ff[1] != 0xff && (ff[1] & 0xf8) != 0xd0)
            return (size_t)(ff - map->data);
        at = (size_t)(ff - map->data) + 1;
    }
    return map->size;
}

/* Whether a JPEG is complete: its segments (FF, marker, length, data) and scans must end with the
 * end-of-image marker. */
static bool jpeg_ends(const struct spin_map *map)
{
    size_t at = 2;

    while (at + 4 <= map->size || at + 2 == map->size) {
        const unsigned char *m = map->data + at;

        /* Skip fill bytes and stray bytes, as decoders do. */
        if (m[0] != 0xff || m[1] == 0xff) {
            at++;
            continue;
        }
        if (m[1] == 0xd9)
            return true;
        if (at + 4 > map->size)
            return false;
        if (m[1] == 0 || m[1] == 1 || (m[1] & 0xf8) == 0xd0) { /* markers without a length */
            at += 2;
            continue;
        }
        at += 2 + ((size_t)m[2] << 8 | m[3]);
        if (m[1] == 0xda)
            at = skip_scan(map, at);
    }
    return false;
}

/* ---- Frames of videos ----------------------------------------------------------------------- */

/* Split a path such as "cam00.mp4#12" into the video's name, allocated, and the frame. *file is
 * NULL if the path does not have this form, or if the whole path is that of an existing file. */
static spin_status find_video(const char *path, char **file, int64_t *frame)
{
    size_t n;

    *file = NULL;
    if (!spin_video_path(path, &n, frame) || spin_path_exists(path))
        return SPIN_OK;
    *file = strndup(path, n);
    return *file ? SPIN_OK : spin_fail(SPIN_E_MEMORY, "not enough memory for %zu bytes", n + 1);
}

/* ---- Images that are rendered ---------------------------------------------------------------- */

static spin_draw_image_fn draw_image;

void spin_drawn_images_set(spin_draw_image_fn draw) { draw_image = draw; }

bool spin_image_is_drawn(const char *path) { return strstr(path, SPIN_DRAWN_MARK) != NULL; }

static spin_status read_drawn(const char *path, const float background[3], int *width, int *height,
                              uint8_t **rgb)
{
    if (!draw_image)
        return spin_unsupported("cannot read the image '%s': this command does not render images",
                                path);
    return draw_image(path, background, width, height, rgb);
}

/* Sets the size of the image, and a digest that is computed from the path of the image and the size
 * of the bundle file. Fails if the bundle does not exist. */
static spin_status check_drawn(const char *path, int *width, int *height,
                               struct spin_digest *digest)
{
    uint64_t hash = SPIN_HASH_BEGIN;
    SPIN_FREED char *bundle = NULL;
    struct stat st;

    SPIN_TRY(read_drawn(path, NULL, width, height, NULL));
    SPIN_TRY(spin_strdup(path, &bundle));
    *strstr(bundle, SPIN_DRAWN_MARK) = '\0';
    if (stat(bundle, &st) != 0)
        return spin_not_found(
            "cannot render the images of the data set: bundle '%s' does not exist", bundle);
    spin_hash(&hash, path, strlen(path));
    digest->size = (uint64_t)st.st_size;
    digest->crc = (uint32_t)(hash ^ hash >> 32);
    return SPIN_OK;
}

/* ---- Reading and writing -------------------------------------------------------------------- */

/* Report the failure of a shim, with the first line of the shim's message, without a full stop. */
static spin_status fail_image(enum spin_image_result result, const char *path, char *why)
{
    static const spin_status codes[] = {
        [SPIN_IMAGE_OK] = SPIN_OK,
        [SPIN_IMAGE_UNREADABLE] = SPIN_E_MALFORMED,
        [SPIN_IMAGE_TOO_LARGE] = SPIN_E_UNSUPPORTED,
        [SPIN_IMAGE_NO_MEMORY] = SPIN_E_MEMORY,
    };
    size_t n = strcspn(why, "\r\n");

    while (n > 0 && (why[n - 1] == '.' || why[n - 1] == ' '))
        n--;
    return spin_fail(codes[result], "cannot read image '%s': %.*s", path, (int)n, why);
}

static spin_status check_exists(const char *path)
{
    if (!spin_path_exists(path))
        return spin_not_found("image '%s' does not exist", path);
    if (spin_path_is_folder(path))
        return spin_fail(SPIN_E_IO, "cannot read image '%s': it is a folder", path);
    return SPIN_OK;
}

/* Map the file to detect its format and, if `whole` is set, to check that it is complete. `digest`
 * may be NULL. */
static spin_status inspect_file(const char *path, bool whole, const char **format,
                                struct spin_digest *digest)
{
    struct spin_map map;
    bool ends;

    SPIN_TRY(check_exists(path));
    SPIN_TRY(spin_map_open(path, &map));
    *format = format_of(&map);
    ends = !whole || (strcmp(*format, "jpeg") == 0  ? jpeg_ends(&map)
                      : strcmp(*format, "png") == 0 ? png_ends(&map)
                                                    : map.size > 0);
    if (digest)
        *digest = spin_map_digest(&map);
    spin_map_close(&map);
    if (!ends)
        return spin_malformed("cannot read image '%s': the file is cut short", path);
    return SPIN_OK;
}

/* A request to a shim: for the size of an image and, if `rgb` is not NULL, also for its pixels. */
struct request {
    const char *path, *format;
    const float *background;
    int *width, *height, *channels;
    uint8_t **rgb;
    char why[256];
};

static enum spin_image_result call_shim(const struct spin_image_shim *shim, struct request *q)
{
    return q->rgb ? shim->read(q->path, q->format, MAX_PIXELS, q->background, q->width, q->height,
                               q->rgb, q->why, sizeof q->why)
                  : shim->size(q->path, q->format, q->width, q->height, q->channels, q->why,
                               sizeof q->why);
}

/* Try libpng or libjpeg first. Use OpenImageIO, which is slow to load, for other formats and for
 * files that these libraries cannot read. */
static spin_status read_by_shims(struct request *q)
{
    enum spin_image_result result = SPIN_IMAGE_UNREADABLE;
    spin_status status = *q->format ? spin_image_start() : need_oiio();

    if (status != SPIN_OK)
        return spin_fail_context(status, "cannot read image '%s'", q->path);
    if (*q->format && plain)
        result = call_shim(plain, q);
    if (result == SPIN_IMAGE_UNREADABLE && need_oiio() == SPIN_OK)
        result = call_shim(oiio, q);
    return result == SPIN_IMAGE_OK ? SPIN_OK : fail_image(result, q->path, q->why);
}

spin_status spin_image_size(const char *path, int *width, int *height, int *channels)
{
    struct request q = {.path = path, .width = width, .height = height, .channels = channels};
    SPIN_FREED char *file = NULL;
    int64_t frame;

    if (spin_image_is_drawn(path)) {
        *channels = 3;
        return read_drawn(path, NULL, width, height, NULL);
    }
    SPIN_TRY(find_video(path, &file, &frame));
    if (file) {
        *channels = 3;
        return spin_video_info(file, width, height, &frame, NULL);
    }
    SPIN_TRY(inspect_file(path, false, &q.format, NULL));
    return read_by_shims(&q);
}

static spin_status check_video_frame(const char *file, int64_t frame, int *width, int *height,
                                     struct spin_digest *digest)
{
    int64_t n_frames;

    SPIN_TRY(spin_video_info(file, width, height, &n_frames, digest));
    if (frame >= n_frames)
        return spin_not_found("video '%s' has no frame %lld, only 0 to %lld", file,
                              (long long)frame, (long long)n_frames - 1);
    return SPIN_OK;
}

spin_status spin_image_check(const char *path, int *width, int *height, struct spin_digest *digest)
{
    int channels;
    struct request q = {.path = path, .width = width, .height = height, .channels = &channels};
    SPIN_FREED char *file = NULL;
    int64_t frame;

    if (spin_image_is_drawn(path))
        return check_drawn(path, width, height, digest);
    SPIN_TRY(find_video(path, &file, &frame));
    if (file)
        return check_video_frame(file, frame, width, height, digest);
    SPIN_TRY(inspect_file(path, true, &q.format, digest));
    SPIN_TRY(read_by_shims(&q));
    if ((int64_t)*width > MAX_PIXELS / *height)
        return spin_unsupported("cannot read image '%s': %d x %d pixels exceed the limit of 64 Mi",
                                path, *width, *height);
    return SPIN_OK;
}

spin_status spin_image_read(const char *path, const float background[3], int *width, int *height,
                            uint8_t **rgb)
{
    static const float black[3];
    struct request q = {.path = path,
                        .background = background ? background : black,
                        .width = width,
                        .height = height,
                        .rgb = rgb};
    SPIN_FREED char *file = NULL;
    int64_t frame;

    *rgb = NULL;
    if (spin_image_is_drawn(path))
        return read_drawn(path, background, width, height, rgb);
    SPIN_TRY(find_video(path, &file, &frame));
    if (file)
        return spin_video_read(file, frame, NULL, width, height, rgb);
    SPIN_TRY(inspect_file(path, true, &q.format, NULL));
    return read_by_shims(&q);
}

static spin_status fail_encoding(enum spin_image_result result, const char *why)
{
    return result == SPIN_IMAGE_OK
               ? SPIN_OK
               : spin_fail(result == SPIN_IMAGE_NO_MEMORY ? SPIN_E_MEMORY : SPIN_E_IO,
                           "cannot encode an image: %s", why);
}

spin_status spin_image_encode(int width, int height, const uint8_t *rgb, unsigned char **bytes,
                              size_t *n_bytes)
{
    char why[256] = "";

    *bytes = NULL;
    *n_bytes = 0;
    SPIN_TRY(spin_image_start());
    return fail_encoding(
        (plain ? plain : oiio)->encode_png(width, height, rgb, bytes, n_bytes, why, sizeof why),
        why);
}

spin_status spin_image_write(const char *path, int width, int height, const uint8_t *rgb, bool sync)
{
    SPIN_FREED unsigned char *bytes = NULL;
    size_t n_bytes = 0;
    spin_status status = spin_image_encode(width, height, rgb, &bytes, &n_bytes);

    if (status != SPIN_OK)
        return spin_fail_context(status, "cannot write image '%s'", path);
    return spin_out_whole(path, bytes, n_bytes, sync);
}

/* ---- Images for film production ------------------------------------------------------------- */

static float finite_or_0(float v) { return isfinite(v) ? v : 0; }

/* Compute the colour of pixel i as stored in the file. The input is premultiplied by alpha, since
 * it is composited over black. It is divided by alpha before the conversion to linear values; EXR
 * stores the result premultiplied again, PNG stores it as it is (straight alpha). */
static void colour_of(const struct spin_film *film, size_t i, float out[3])
{
    size_t plane = (size_t)film->width * (size_t)film->height;
    float alpha = film->alpha ? finite_or_0(film->alpha[i]) : 1, back = film->exr ? alpha : 1;

    for (size_t c = 0; c < 3; c++) {
        float v = finite_or_0(film->image[c * plane + i]);

        v = alpha > 0 ? v / alpha : 0;
        out[c] = (film->linear ? spin_light_of(v) : v) * back;
    }
    if (film->alpha)
        out[3] = alpha;
}

/* Express frames per second as a fraction: N / 1, N * 1000 / 1001 (29.97 and other NTSC rates), or,
 * rounded to three decimals, N / 1000. */
static void set_rate(double fps, int out[2])
{
    double ntsc = fps * 1.001;

    if (fabs(fps - rint(fps)) < 1e-6) {
        out[0] = (int)rint(fps);
        out[1] = 1;
    } else if (fabs(ntsc - rint(ntsc)) < 1e-3) {
        out[0] = 1000 * (int)rint(ntsc);
        out[1] = 1001;
    } else {
        out[0] = (int)rint(1000 * fps);
        out[1] = 1000;
    }
}

spin_status spin_film_write(const char *path, const struct spin_film *film, bool sync)
{
    static const char *const all[] = {"R", "G", "B", "A", "Z", "ZMedian"};
    const char *names[6];
    size_t plane = (size_t)film->width * (size_t)film->height, n = 0, n_bytes = 0;
    struct spin_image_out out = {.format = film->exr ? "openexr" : "png",
                                 .width = film->width,
                                 .height = film->height,
                                 .names = names,
                                 .n_colours = film->alpha ? 4 : 3,
                                 .bits = film->bits,
                                 .linear = film->linear};
    unsigned char *bytes = NULL;
    float *pixels = NULL;
    char why[256] = "";
    spin_status status;

    for (size_t k = 0; k < 6; k++)
        if (k < 3 || (k == 3 ? film->alpha != NULL : film->depth != NULL))
            names[n++] = all[k];
    out.n_channels = (int)n;
    if (film->fps > 0)
        set_rate(film->fps, out.fps);
    SPIN_TRY(spin_alloc(plane, n * sizeof *pixels, (void **)&pixels));
    for (size_t i = 0; i < plane; i++) {
        colour_of(film, i, pixels + n * i);
        for (size_t k = 0; k < 2 && film->depth; k++)
            pixels[n * i + (size_t)out.n_colours + k] = film->depth[k * plane + i];
    }
    out.pixels = pixels;
    SPIN_TRY_OUT(film->exr ? need_oiio() : spin_image_start());
    SPIN_TRY_OUT(fail_encoding(
        (film->exr || !plain ? oiio : plain)->encode(&out, &bytes, &n_bytes, why, sizeof why),
        why));
    status = spin_out_whole(path, bytes, n_bytes, sync);
out:
    free(pixels);
    free(bytes);
    return status == SPIN_OK ? SPIN_OK : spin_fail_context(status, "cannot write image '%s'", path);
}

/* ---- Names of images ------------------------------------------------------------------------ */

void spin_image_name(const struct spin_views *views, size_t view, int number, const char *label,
                     char name[SPIN_IMAGE_NAME])
{
    const struct spin_view *v = &views->view[view];
    char twin[16] = "";
    size_t first = view;

    /* A frame may have several views with the same camera number: find the first of them. Views are
     * sorted by frame, then by camera. */
    while (first > 0 && views->view[first - 1].dataset_frame == v->dataset_frame &&
           views->view[first - 1].camera_id == v->camera_id)
        first--;
    if (first < view)
        snprintf(twin, sizeof twin, "_%d", (int)(view - first + 1));
    snprintf(name, SPIN_IMAGE_NAME, "cam_%02d%s_frame_%05d%s%s.png", v->camera_id, twin, number,
             label ? "_" : "", label ? label : "");
}

void spin_image_name_moving(const char *path, int number, char name[SPIN_IMAGE_NAME])
{
    snprintf(name, SPIN_IMAGE_NAME, "%s_frame_%05d.png", path, number);
}
