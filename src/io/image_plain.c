/* The implementation of image_shim.h with libjpeg-turbo and libpng. It avoids the time that loading
 * OpenImageIO takes, and is the only implementation in builds with few dependencies (make portable,
 * make windows, tests/card). The decoded pixels are identical to those of image_oiio.cpp. */
#include <errno.h>
#include <setjmp.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <jpeglib.h>
#include <jerror.h>
#include <png.h>

#include "io/image_shim.h"

/* The state of one call. After a failed read, open_picture() frees rgb. */
struct picture {
    const char *path;
    int64_t most; /* maximum number of pixels */
    const float *background;
    bool sizes; /* read only the size, not the pixels */
    FILE *file;
    int width, height, channels;
    uint8_t *rgb;
    bool no_memory; /* an allocation in libpng has failed */
    enum spin_image_result result;
    char *why;
    size_t n_why;
};

static enum spin_image_result fail(struct picture *p, enum spin_image_result result,
                                   const char *why)
{
    snprintf(p->why, p->n_why, "%s", why);
    return p->result = result;
}

/* Check the size in the header, and allocate p->rgb. Returns true if the pixels are to be read;
 * false after an error, or if only the size is requested. */
static bool prepare_pixels(struct picture *p)
{
    if (p->width < 1 || p->height < 1) {
        fail(p, SPIN_IMAGE_UNREADABLE, "not a two-dimensional image");
        return false;
    }
    if (p->sizes)
        return false;
    if (p->width > p->most / p->height) {
        snprintf(p->why, p->n_why, "%d x %d pixels exceed the limit of %lld", p->width, p->height,
                 (long long)p->most);
        p->result = SPIN_IMAGE_TOO_LARGE;
        return false;
    }
    p->rgb = malloc(3 * (size_t)p->width * (size_t)p->height);
    if (!p->rgb)
        fail(p, SPIN_IMAGE_NO_MEMORY, "not enough memory");
    return p->rgb != NULL;
}

/* ---- JPEG ------------------------------------------------------------------------------------ */

struct jpeg_end {
    struct jpeg_error_mgr base; /* must be the first member, for jpeg_fails() */
    jmp_buf jump;
    struct picture *picture;
};

static void jpeg_fails(j_common_ptr info)
{
    struct jpeg_end *end = (struct jpeg_end *)info->err;
    char text[JMSG_LENGTH_MAX];

    info->err->format_message(info, text);
    if (info->err->msg_code == JERR_OUT_OF_MEMORY)
        fail(end->picture, SPIN_IMAGE_NO_MEMORY, "not enough memory");
    else
        fail(end->picture, SPIN_IMAGE_UNREADABLE, text);
    longjmp(end->jump, 1);
}

/* Treat warnings as errors, since libjpeg only warns of a truncated file. */
static void jpeg_warns(j_common_ptr info, int level)
{
    if (level < 0)
        jpeg_fails(info);
}

static void read_jpeg(struct picture *p)
{
    /* Zeroed, since jpeg_create_decompress() may fail before it initialises the struct. */
    struct jpeg_decompress_struct jpeg = {0};
    struct jpeg_end end = {.picture = p};

    jpeg.err = jpeg_std_error(&end.base);
    end.base.error_exit = jpeg_fails;
    end.base.emit_message = jpeg_warns;
    if (setjmp(end.jump) == 0) {
        /* This call fails if memory runs out, or if the version of the installed library differs
         * from the one used for the build. */
        jpeg_create_decompress(&jpeg);
        jpeg_stdio_src(&jpeg, p->file);
        jpeg_read_header(&jpeg, TRUE);
        p->width = (int)jpeg.image_width;
        p->height = (int)jpeg.image_height;
        p->channels = jpeg.num_components;
        if (jpeg.num_components > 3)
            fail(p, SPIN_IMAGE_UNREADABLE, "a JPEG with four channels needs OpenImageIO");
        /* Start decompression even if only the size is requested, since jpeg_start_decompress()
         * also checks the tables. */
        else if (prepare_pixels(p) || p->sizes) {
            jpeg.out_color_space = JCS_RGB;
            jpeg_start_decompress(&jpeg);
            while (p->rgb && jpeg.output_scanline < jpeg.output_height) {
                JSAMPROW row = p->rgb + 3 * (size_t)p->width * jpeg.output_scanline;

                jpeg_read_scanlines(&jpeg, &row, 1);
            }
            if (p->rgb)
                jpeg_finish_decompress(&jpeg);
        }
    }
    jpeg_destroy_decompress(&jpeg);
}

/* ---- PNG ------------------------------------------------------------------------------------- */

static void png_fails(png_structp png, png_const_charp text)
{
    struct picture *p = png_get_error_ptr(png);

    fail(p, p->no_memory ? SPIN_IMAGE_NO_MEMORY : SPIN_IMAGE_UNREADABLE,
         p->no_memory ? "not enough memory" : text);
    png_longjmp(png, 1);
}

/* Record a lack of memory here, since libpng reports it with various messages. */
static png_voidp png_allocate(png_structp png, png_alloc_size_t n)
{
    struct picture *p = png_get_mem_ptr(png);
    void *block = malloc(n);

    p->no_memory = p->no_memory || !block;
    return block;
}

static void png_release(png_structp png, png_voidp block)
{
    (void)png;
    free(block);
}

/* Report why libpng did not create its structures. */
static void fail_png_creation(struct picture *p)
{
    if (p->no_memory)
        fail(p, SPIN_IMAGE_NO_MEMORY, "not enough memory");
    else
        fail(p, SPIN_IMAGE_UNREADABLE,
             "the installed libpng is not compatible with version " PNG_LIBPNG_VER_STRING
             ", with which spin4d was built");
}

static void png_warns(png_structp png, png_const_charp text) { (void)png, (void)text; }

/* Composite a value 0..255, with alpha 0..255, over a background 0..1. */
static uint8_t blend_over(unsigned value, unsigned alpha, float background)
{
    return (uint8_t)((float)(value * alpha) / 255.0f + background * (float)(255u - alpha) + 0.5f);
}

static void composite_pixels(struct picture *p, const uint8_t *pixels, int n)
{
    size_t count = (size_t)p->width * (size_t)p->height;

    for (size_t i = 0; i < count; i++, pixels += n)
        for (int c = 0; c < 3; c++)
            p->rgb[3 * i + (size_t)c] =
                blend_over(pixels[n < 3 ? 0 : c], n % 2 ? 255u : pixels[n - 1], p->background[c]);
}

static void read_png(struct picture *p)
{
    png_structp png = png_create_read_struct_2(PNG_LIBPNG_VER_STRING, p, png_fails, png_warns, p,
                                               png_allocate, png_release);
    png_infop info = png ? png_create_info_struct(png) : NULL;
    uint8_t *volatile pixels = NULL;
    png_bytep *volatile row = NULL;

    if (!info) {
        fail_png_creation(p);
    } else if (setjmp(png_jmpbuf(png)) == 0) {
        png_init_io(png, p->file);
        png_read_info(png, info);
        p->width = (int)png_get_image_width(png, info);
        p->height = (int)png_get_image_height(png, info);
        /* Convert palettes to RGB, samples to 8 bits or more, and tRNS to alpha. */
        png_set_expand(png);
        png_set_scale_16(png);
        png_set_interlace_handling(png);
        png_read_update_info(png, info);
        p->channels = png_get_channels(png, info);
        if (prepare_pixels(p)) {
            size_t bytes = (size_t)p->width * (size_t)p->channels;

            pixels = malloc(bytes * (size_t)p->height);
            row = malloc((size_t)p->height * sizeof *row);
            for (int y = 0; pixels && row && y < p->height; y++)
                row[y] = pixels + (size_t)y * bytes;
            if (pixels && row) {
                png_read_image(png, row);
                png_read_end(png, NULL);
                composite_pixels(p, pixels, p->channels);
            } else {
                fail(p, SPIN_IMAGE_NO_MEMORY, "not enough memory");
            }
        }
    }
    png_destroy_read_struct(&png, info ? &info : NULL, NULL);
    free(pixels);
    free(row);
}

/* ---- Both formats --------------------------------------------------------------------------- */

static enum spin_image_result open_picture(struct picture *p, const char *format)
{
    p->result = SPIN_IMAGE_OK;
    p->file = fopen(p->path, "rb");
    if (!p->file && errno == ENOMEM)
        return fail(p, SPIN_IMAGE_NO_MEMORY, "not enough memory");
    if (!p->file)
        return fail(p, SPIN_IMAGE_UNREADABLE, "cannot open the file");
    if (strcmp(format, "png") == 0)
        read_png(p);
    else
        read_jpeg(p);
    fclose(p->file);
    if (p->result != SPIN_IMAGE_OK) {
        free(p->rgb);
        p->rgb = NULL;
    }
    return p->result;
}

static enum spin_image_result image_size(const char *path, const char *format, int *width,
                                         int *height, int *channels, char *why, size_t n_why)
{
    struct picture p = {.path = path, .sizes = true, .why = why, .n_why = n_why};

    open_picture(&p, format);
    *width = p.width;
    *height = p.height;
    *channels = p.channels;
    return p.result;
}

static enum spin_image_result image_read(const char *path, const char *format, int64_t max_pixels,
                                         const float background[3], int *width, int *height,
                                         uint8_t **rgb, char *why, size_t n_why)
{
    struct picture p = {
        .path = path, .most = max_pixels, .background = background, .why = why, .n_why = n_why};

    open_picture(&p, format);
    *width = p.width;
    *height = p.height;
    *rgb = p.rgb;
    return p.result;
}

/* A growing output buffer. */
struct sink {
    struct picture base; /* must be the first member, for png_fails() */
    unsigned char *bytes;
    size_t n, room;
};

static void append_bytes(png_structp png, png_bytep data, size_t n)
{
    struct sink *sink = png_get_io_ptr(png);

    if (n > sink->room - sink->n) {
        size_t room = 2 * sink->room + n + 4096;
        unsigned char *bytes = realloc(sink->bytes, room);

        if (!bytes) {
            fail(&sink->base, SPIN_IMAGE_NO_MEMORY, "not enough memory");
            png_longjmp(png, 1);
        }
        sink->bytes = bytes;
        sink->room = room;
    }
    memcpy(sink->bytes + sink->n, data, n);
    sink->n += n;
}

static void flush_nothing(png_structp png) { (void)png; }

/* Convert a row of values 0..1 to 8-bit integers or to big-endian 16-bit integers. */
static void quantise_row(const struct spin_image_out *image, int y, unsigned char *row)
{
    size_t n = (size_t)image->width * (size_t)image->n_channels;
    const float *from = image->pixels + n * (size_t)y;
    float most = image->bits == 16 ? 65535.0f : 255.0f;

    for (size_t i = 0; i < n; i++) {
        unsigned v = (unsigned)(from[i] > 0 ? (from[i] < 1 ? from[i] : 1) * most + 0.5f : 0);

        if (image->bits == 16)
            *row++ = (unsigned char)(v >> 8);
        *row++ = (unsigned char)v;
    }
}

/* Encode a PNG file of `rgb`, 8-bit pixels, or of image->pixels if `rgb` is NULL. */
static void write_png(struct sink *sink, const struct spin_image_out *image, const uint8_t *rgb)
{
    png_structp png = png_create_write_struct_2(PNG_LIBPNG_VER_STRING, &sink->base, png_fails,
                                                png_warns, &sink->base, png_allocate, png_release);
    png_infop info = png ? png_create_info_struct(png) : NULL;
    unsigned char *row =
        malloc((size_t)image->width * (size_t)image->n_channels * (size_t)(image->bits / 8));

    if (!row) {
        fail(&sink->base, SPIN_IMAGE_NO_MEMORY, "not enough memory");
    } else if (!info) {
        fail_png_creation(&sink->base);
    } else if (setjmp(png_jmpbuf(png)) == 0) {
        png_set_write_fn(png, sink, append_bytes, flush_nothing);
        png_set_IHDR(png, info, (png_uint_32)image->width, (png_uint_32)image->height, image->bits,
                     image->n_channels == 4 ? PNG_COLOR_TYPE_RGBA : PNG_COLOR_TYPE_RGB,
                     PNG_INTERLACE_NONE, PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
        if (image->linear)
            png_set_gAMA(png, info, 1.0);
        else
            png_set_sRGB(png, info, PNG_sRGB_INTENT_ABSOLUTE);
        png_write_info(png, info);
        for (int y = 0; y < image->height; y++) {
            if (!rgb)
                quantise_row(image, y, row);
            png_write_row(png, rgb ? rgb + 3 * (size_t)image->width * (size_t)y : row);
        }
        png_write_end(png, info);
    }
    png_destroy_write_struct(&png, &info);
    free(row);
}

static enum spin_image_result encode_image(const struct spin_image_out *image, const uint8_t *rgb,
                                           unsigned char **bytes, size_t *n_bytes, char *why,
                                           size_t n_why)
{
    struct sink sink = {.base = {.result = SPIN_IMAGE_OK, .why = why, .n_why = n_why}};

    write_png(&sink, image, rgb);
    if (sink.base.result != SPIN_IMAGE_OK) {
        free(sink.bytes);
        return sink.base.result;
    }
    *bytes = sink.bytes;
    *n_bytes = sink.n;
    return SPIN_IMAGE_OK;
}

static enum spin_image_result image_encode(const struct spin_image_out *image,
                                           unsigned char **bytes, size_t *n_bytes, char *why,
                                           size_t n_why)
{
    return encode_image(image, NULL, bytes, n_bytes, why, n_why);
}

static enum spin_image_result image_encode_png(int width, int height, const uint8_t *rgb,
                                               unsigned char **bytes, size_t *n_bytes, char *why,
                                               size_t n_why)
{
    const struct spin_image_out image = {
        .format = "png", .width = width, .height = height, .n_channels = 3, .bits = 8};

    return encode_image(&image, rgb, bytes, n_bytes, why, n_why);
}

extern const struct spin_image_shim spin_image_shim_table;
const struct spin_image_shim spin_image_shim_table = {
    SPIN_IMAGE_SHIM_ABI, "libjpeg, libpng", image_size, image_read, image_encode_png, image_encode};
