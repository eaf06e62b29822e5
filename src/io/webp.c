#include "io/webp.h"

#include <dlfcn.h>
#include <pthread.h>
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/mem.h"

#define LIBRARY "libwebp.so.7"
/* Of the encoder's interface below. The library refuses a version whose high byte is not its own. */
#define ENCODER_ABI 0x020e

/* ---- The library's interface, as its encode.h has it at that version -------------------------- */

struct config {
    int lossless;
    float quality;
    int method, image_hint, target_size;
    float target_psnr;
    int segments, sns_strength, filter_strength, filter_sharpness, filter_type, autofilter;
    int alpha_compression, alpha_filtering, alpha_quality, pass, show_compressed, preprocessing;
    int partitions, partition_limit, emulate_jpeg_size, thread_level, low_memory, near_lossless;
    int exact; /* colours of transparent pixels stay */
    int use_delta_palette, use_sharp_yuv, qmin, qmax;
    int later[32]; /* of versions to come */
};

struct picture {
    int use_argb, colorspace, width, height;
    uint8_t *y, *u, *v;
    int y_stride, uv_stride;
    uint8_t *a;
    int a_stride;
    uint32_t pad1[2];
    uint32_t *argb;
    int argb_stride;
    uint32_t pad2[3];
    int (*writer)(const uint8_t *data, size_t size, const struct picture *picture);
    void *custom;
    int extra_info_type;
    uint8_t *extra_info;
    void *stats;
    int error_code;
    void *progress_hook, *user_data;
    uint32_t pad3[3];
    uint8_t *pad4, *pad5;
    uint32_t pad6[8];
    void *memory, *memory_argb, *pad7[2];
    void *later[16];
};

static int (*config_init)(struct config *config, int preset, float quality, int abi);
static int (*config_lossless)(struct config *config, int level);
static int (*picture_init)(struct picture *picture, int abi);
static int (*picture_import)(struct picture *picture, const uint8_t *rgba, int stride);
static void (*picture_free)(struct picture *picture);
static int (*encode)(const struct config *config, struct picture *picture);
static int (*get_info)(const uint8_t *data, size_t size, int *width, int *height);
static uint8_t *(*decode_into)(const uint8_t *data, size_t size, uint8_t *out, size_t n_out,
                               int stride);

static pthread_once_t once = PTHREAD_ONCE_INIT;
static char failure[256]; /* why there is no library */

static void start(void)
{
    const struct {
        const char *name;
        void *into;
    } functions[] = {{"WebPConfigInitInternal", &config_init},
                     {"WebPConfigLosslessPreset", &config_lossless},
                     {"WebPPictureInitInternal", &picture_init},
                     {"WebPPictureImportRGBA", &picture_import},
                     {"WebPPictureFree", &picture_free},
                     {"WebPEncode", &encode},
                     {"WebPGetInfo", &get_info},
                     {"WebPDecodeRGBAInto", &decode_into}};
    const char *name = getenv("SPIN_WEBP");
    void *library = dlopen(name ? name : LIBRARY, RTLD_NOW | RTLD_LOCAL);

    if (!library) {
        snprintf(failure, sizeof failure, "%s", dlerror());
        return;
    }
    for (size_t i = 0; i < sizeof functions / sizeof *functions; i++) {
        *(void **)functions[i].into = dlsym(library, functions[i].name);
        if (!*(void **)functions[i].into)
            snprintf(failure, sizeof failure, "it lacks %s", functions[i].name);
    }
}

spin_status spin_webp_need(void)
{
    pthread_once(&once, start);
    if (*failure)
        return spin_fail(SPIN_E_UNSUPPORTED, "WebP needs the library '" LIBRARY "': %s", failure);
    return SPIN_OK;
}

/* ---- Writing --------------------------------------------------------------------------------- */

struct sink {
    unsigned char *data;
    size_t n, room;
};

static int take(const uint8_t *data, size_t size, const struct picture *picture)
{
    struct sink *sink = picture->custom;

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

/* The library may be another than the one whose interface stands above: what it made must be the picture. */
static spin_status check_written(const struct sink *sink, const uint8_t *rgba, int width,
                                 int height)
{
    size_t n = (size_t)width * (size_t)height * 4;
    uint8_t *again = NULL;
    int w, h;
    spin_status status;

    SPIN_TRY(spin_webp_size(sink->data, sink->n, &w, &h));
    SPIN_TRY(spin_alloc(n, 1, (void **)&again));
    status = w == width && h == height
                 ? spin_webp_read(sink->data, sink->n, width, height, again)
                 : spin_fail(SPIN_E_IO, "libwebp wrote %dx%d pixels of %dx%d", w, h, width, height);
    if (status == SPIN_OK && memcmp(rgba, again, n) != 0)
        status = spin_fail(SPIN_E_IO, "libwebp wrote other values than it was given");
    free(again);
    return status;
}

spin_status spin_webp_write(const uint8_t *rgba, int width, int height, int effort,
                            unsigned char **out, size_t *n_out)
{
    struct config config = {0};
    struct picture picture = {0};
    struct sink sink = {0};
    spin_status status = SPIN_OK;

    SPIN_TRY(spin_webp_need());
    if (width < 1 || height < 1 || width > SPIN_WEBP_MAX_SIDE || height > SPIN_WEBP_MAX_SIDE)
        return spin_fail(SPIN_E_UNSUPPORTED, "a WebP of %dx%d pixels", width, height);
    if (!config_init(&config, 0, 75, ENCODER_ABI) || !config_lossless(&config, effort) ||
        !picture_init(&picture, ENCODER_ABI))
        return spin_fail(SPIN_E_UNSUPPORTED, "'" LIBRARY "' is of another version");
    config.exact = 1;
    picture.use_argb = 1;
    picture.width = width;
    picture.height = height;
    picture.writer = take;
    picture.custom = &sink;
    if (!picture_import(&picture, rgba, 4 * width) || !encode(&config, &picture))
        status = spin_fail(SPIN_E_MEMORY, "libwebp cannot write %dx%d pixels (its error %d)", width,
                           height, picture.error_code);
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
        return spin_fail(SPIN_E_MALFORMED, "no WebP picture");
    return SPIN_OK;
}

spin_status spin_webp_read(const void *data, size_t size, int width, int height, uint8_t *rgba)
{
    SPIN_TRY(spin_webp_need());
    if (!decode_into(data, size, rgba, (size_t)width * (size_t)height * 4, 4 * width))
        return spin_fail(SPIN_E_MALFORMED, "a damaged WebP picture");
    return SPIN_OK;
}
