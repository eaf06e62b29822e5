#include "io/webp.h"

#include <webp/decode.h>
#include <webp/encode.h>

#include "base/base.h"
#include "base/shim.h"

static __typeof__(WebPConfigInitInternal) *config_init;
static __typeof__(WebPConfigLosslessPreset) *config_lossless;
static __typeof__(WebPPictureInitInternal) *picture_init;
static __typeof__(WebPPictureImportRGBA) *picture_import;
static __typeof__(WebPPictureFree) *picture_free;
static __typeof__(WebPEncode) *encode;
static __typeof__(WebPGetInfo) *get_info;
static __typeof__(WebPInitDecoderConfigInternal) *decoder_init;
static __typeof__(WebPDecode) *decode;

spin_status spin_webp_need(void)
{
    static const struct spin_library_function functions[] = {
        {"WebPConfigInitInternal", &config_init},
        {"WebPConfigLosslessPreset", &config_lossless},
        {"WebPPictureInitInternal", &picture_init},
        {"WebPPictureImportRGBA", &picture_import},
        {"WebPPictureFree", &picture_free},
        {"WebPEncode", &encode},
        {"WebPGetInfo", &get_info},
        {"WebPInitDecoderConfigInternal", &decoder_init},
        {"WebPDecode", &decode},
        {0}};
    static struct spin_library library = {"libwebp.so.7", "SPIN_WEBP", "WebP",
                                          functions,      false,       ""};

    return spin_library_load(&library);
}

/* ---- Writing --------------------------------------------------------------------------------- */

struct sink {
    unsigned char *data;
    size_t n, room;
};

static int append_bytes(const uint8_t *data, size_t size, const WebPPicture *picture)
{
    struct sink *sink = picture->custom_ptr;

    while (size > sink->room - sink->n) {
        size_t room = sink->room ? 2 * sink->room : 4096 + size;

        if (spin_grow(room, 1, (void **)&sink->data) != SPIN_OK)
            return 0;
        sink->room = room;
    }
    memcpy(sink->data + sink->n, data, size);
    sink->n += size;
    return 1;
}

/* Whether the error is a lack of memory. This includes BAD_WRITE, since append_bytes() fails only
 * if memory runs out. */
static bool is_memory(WebPEncodingError error)
{
    return error == VP8_ENC_ERROR_OUT_OF_MEMORY || error == VP8_ENC_ERROR_BITSTREAM_OUT_OF_MEMORY ||
           error == VP8_ENC_ERROR_BAD_WRITE;
}

/* The installed library may differ in version from the header used for the build, so verify that
 * its output decodes to the image. */
static spin_status check_written(const struct sink *sink, const uint8_t *rgba, int width,
                                 int height)
{
    size_t n = (size_t)width * (size_t)height * 4;
    SPIN_FREED uint8_t *again = NULL;
    int w, h;

    SPIN_TRY(spin_webp_size(sink->data, sink->n, &w, &h));
    SPIN_TRY(spin_alloc(n, 1, (void **)&again));
    SPIN_TRY(w == width && h == height
                 ? spin_webp_read(sink->data, sink->n, width, height, again)
                 : spin_fail(SPIN_E_IO, "libwebp wrote %dx%d pixels instead of %dx%d", w, h, width,
                             height));
    if (memcmp(rgba, again, n) != 0)
        return spin_fail(
            SPIN_E_IO,
            "libwebp wrote pixels that differ from the image; the encoding must be lossless");
    return SPIN_OK;
}

spin_status spin_webp_write(const uint8_t *rgba, int width, int height, int effort,
                            unsigned char **out, size_t *n_out)
{
    WebPConfig config;
    WebPPicture picture;
    struct sink sink = {0};
    spin_status status = SPIN_OK;

    SPIN_TRY(spin_webp_need());
    if (width < 1 || height < 1 || width > SPIN_WEBP_MAX_SIDE || height > SPIN_WEBP_MAX_SIDE)
        return spin_unsupported("a WebP image cannot have %dx%d pixels, only 1 to %d per side",
                                width, height, SPIN_WEBP_MAX_SIDE);
    if (!config_init(&config, WEBP_PRESET_DEFAULT, 75, WEBP_ENCODER_ABI_VERSION) ||
        !config_lossless(&config, effort) || !picture_init(&picture, WEBP_ENCODER_ABI_VERSION))
        return spin_unsupported(
            "the installed libwebp is not compatible with the version with which spin4d was built");
    config.exact = 1;
    picture.use_argb = 1;
    picture.width = width;
    picture.height = height;
    picture.writer = append_bytes;
    picture.custom_ptr = &sink;
    if (!picture_import(&picture, rgba, 4 * width) || !encode(&config, &picture))
        status =
            is_memory(picture.error_code)
                ? spin_fail(SPIN_E_MEMORY,
                            "not enough memory to encode a WebP image of %dx%d pixels", width,
                            height)
                : spin_fail(SPIN_E_IO,
                            "libwebp cannot encode an image of %dx%d pixels (error %d of libwebp)",
                            width, height, picture.error_code);
    picture_free(&picture);
    if (status == SPIN_OK)
        status = check_written(&sink, rgba, width, height);
    if (status != SPIN_OK) {
        free(sink.data);
        return status;
    }
    *out = sink.data;
    *n_out = sink.n;
    return SPIN_OK;
}

/* ---- Reading --------------------------------------------------------------------------------- */

spin_status spin_webp_size(const void *data, size_t size, int *width, int *height)
{
    SPIN_TRY(spin_webp_need());
    if (!get_info(data, size, width, height))
        return spin_malformed("not a WebP image");
    return SPIN_OK;
}

static uint32_t word_at(const uint8_t *p)
{
    return p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24;
}

spin_status spin_webp_lossless(const void *data, size_t size, int *width, int *height)
{
    const uint8_t *file = data;
    /* Size of the image according to the VP8X chunk; 0: there is no such chunk. */
    uint32_t wide = 0, high = 0;

    *width = *height = 0;
    if (size < 12 || memcmp(file, "RIFF", 4) != 0 || memcmp(file + 8, "WEBP", 4) != 0)
        return spin_malformed("not a WebP image");
    if ((uint64_t)word_at(file + 4) + 8 != size)
        return spin_malformed("the WebP image has %zu bytes, but its header states %llu bytes",
                              size, (unsigned long long)word_at(file + 4) + 8);
    for (size_t at = 12; at < size;) {
        const uint8_t *chunk = file + at;
        size_t left = size - at, n = left < 8 ? SIZE_MAX : word_at(chunk + 4);

        if (left < 8 || n > left - 8 || (n & 1 && n == left - 8))
            return spin_malformed("the WebP image is cut short");
        if (memcmp(chunk, "VP8X", 4) == 0 && at == 12 && n == 10) {
            wide = (word_at(chunk + 12) & 0xffffff) + 1;
            high = (word_at(chunk + 14) >> 8) + 1;
        } else if (memcmp(chunk, "VP8L", 4) == 0 && *width == 0 && n >= 5 && chunk[8] == 0x2f &&
                   chunk[12] >> 5 == 0) {
            *width = (int)(word_at(chunk + 9) & 0x3fff) + 1;
            *height = (int)(word_at(chunk + 9) >> 14 & 0x3fff) + 1;
        } else if (memcmp(chunk, "VP8", 3) == 0 || memcmp(chunk, "AL", 2) == 0 ||
                   memcmp(chunk, "AN", 2) == 0) {
            return spin_malformed("the WebP image has a chunk '%.4s', expected only VP8L",
                                  (const char *)chunk);
        }
        at += 8 + n + (n & 1);
    }
    if (*width == 0 || (wide > 0 && ((int)wide != *width || (int)high != *height)))
        return spin_malformed("the WebP file does not contain exactly one lossless image");
    return SPIN_OK;
}

/* If allocations fail, libwebp 1.2 sometimes reports damage and sometimes ends the process.
 * Therefore check beforehand that the memory that libwebp needs can be allocated: it needs memory
 * for a copy of the pixels, for data of transforms, and for Huffman tables. */
static spin_status check_memory(int width, int height)
{
    SPIN_FREED void *block = malloc(2 * 4 * (size_t)width * (size_t)height + (1 << 20));

    return block ? SPIN_OK
                 : spin_fail(SPIN_E_MEMORY,
                             "not enough memory to decode a WebP image of %dx%d pixels", width,
                             height);
}

spin_status spin_webp_read(const void *data, size_t size, int width, int height, uint8_t *rgba)
{
    WebPDecoderConfig config;
    VP8StatusCode code;

    SPIN_TRY(spin_webp_need());
    SPIN_TRY(check_memory(width, height));
    if (!decoder_init(&config, WEBP_DECODER_ABI_VERSION))
        return spin_unsupported(
            "the installed libwebp is not compatible with the version with which spin4d was built");
    config.output.colorspace = MODE_RGBA;
    config.output.is_external_memory = 1;
    config.output.u.RGBA = (WebPRGBABuffer){
        .rgba = rgba, .stride = 4 * width, .size = (size_t)width * (size_t)height * 4};
    code = decode(data, size, &config);
    if (code == VP8_STATUS_OUT_OF_MEMORY)
        return spin_fail(SPIN_E_MEMORY, "not enough memory to decode a WebP image of %dx%d pixels",
                         width, height);
    return code == VP8_STATUS_OK ? SPIN_OK : spin_malformed("the WebP image is damaged");
}
