/* The implementation of image_shim.h with OpenImageIO.
 *
 * JPEG and PNG files are opened with the reader for their format, since OpenImageIO would
 * initialise all readers to detect the format. Every function of the table catches all exceptions.
 */
#include "io/image_shim.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <new>
#include <string>
#include <vector>

#include <dlfcn.h>

#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imageio.h>

namespace
{

struct failure {
    enum spin_image_result result;
    std::string why;
};

void configure_library()
{
    static const bool done = [] {
        OIIO::attribute("threads", 1); /* one, since callers read several images in parallel */
        OIIO::attribute("exr_threads", 1);
        OIIO::attribute(
            "debug", 0); /* else OpenImageIO prints that it ignores DateTime, see describe_film() */
        OIIO::attribute("plugin_searchpath", std::string());
        return true;
    }();
    (void)done;
}

/* Run work; convert any exception to a result and a message. */
template <typename Work> enum spin_image_result guarded(char *why, size_t n_why, Work work) noexcept
{
    const char *text = "unknown failure";
    enum spin_image_result result = SPIN_IMAGE_UNREADABLE;

    try {
        configure_library();
        work();
        return SPIN_IMAGE_OK;
    } catch (const failure &f) {
        std::snprintf(why, n_why, "%s", f.why.c_str());
        return f.result;
    } catch (const std::bad_alloc &) {
        result = SPIN_IMAGE_NO_MEMORY;
        text = "not enough memory";
    } catch (const std::exception &e) {
        std::snprintf(why, n_why, "%s", e.what());
        return result;
    } catch (...) {
    }
    std::snprintf(why, n_why, "%s", text);
    return result;
}

/* OpenImageIO reports errors only as texts, which come from the library of each format. A lack of
 * memory is therefore detected by the text. */
[[noreturn]] void fail(const std::string &why)
{
    if (why.find(" memory") != std::string::npos || why.find("bad_alloc") != std::string::npos)
        throw failure{SPIN_IMAGE_NO_MEMORY, "not enough memory"};
    throw failure{SPIN_IMAGE_UNREADABLE, why.empty() ? "not a readable image" : why};
}

std::unique_ptr<OIIO::ImageInput> open_input(const char *path, const std::string &format)
{
    OIIO::ImageSpec config, spec;

    /* Read alpha without premultiplication: this file composites it, on the stored values. */
    config.attribute("oiio:UnassociatedAlpha", 1);
    if (format.empty()) {
        auto guessed = OIIO::ImageInput::open(path, &config);
        if (!guessed)
            fail(OIIO::geterror());
        return guessed;
    }
    auto in = OIIO::ImageInput::create(format);
    if (!in)
        fail("OpenImageIO was built without " + format);
    if (!in->open(path, spec, config))
        fail(in->geterror());
    return in;
}

void check_spec(const OIIO::ImageSpec &spec, int64_t max_pixels)
{
    if (spec.width < 1 || spec.height < 1 || spec.nchannels < 1 || spec.depth > 1 || spec.deep)
        fail("not a two-dimensional image");
    if (static_cast<int64_t>(spec.width) > max_pixels / spec.height)
        throw failure{SPIN_IMAGE_TOO_LARGE,
                      std::to_string(spec.width) + " x " + std::to_string(spec.height) +
                          " pixels exceed the limit of " + std::to_string(max_pixels)};
}

/* Composite a value 0..255, with alpha 0..255, over a background 0..1. */
uint8_t blend_over(unsigned value, unsigned alpha, float background)
{
    float shown =
        static_cast<float>(value * alpha) / 255.0f + background * static_cast<float>(255u - alpha);

    return static_cast<uint8_t>(shown + 0.5f);
}

/* Convert pixels of n channels, grey or colour, to RGB. alpha: index of the alpha channel; -1:
 * there is none. */
void to_rgb(const uint8_t *pixels, size_t n_pixels, int n, int alpha, const float background[3],
            uint8_t *rgb)
{
    bool grey = n < 3;

    for (size_t i = 0; i < n_pixels; i++) {
        const uint8_t *from = pixels + i * static_cast<size_t>(n);
        unsigned a = alpha >= 0 ? from[alpha] : 255u;

        for (int c = 0; c < 3; c++)
            rgb[3 * i + static_cast<size_t>(c)] = blend_over(from[grey ? 0 : c], a, background[c]);
    }
}

/* Convert a linear value 0..1 to sRGB. */
float srgb_of_linear(float light)
{
    return light <= 0.0031308f ? light * 12.92f : 1.055f * std::pow(light, 1 / 2.4f) - 0.055f;
}

/* Read an image of floats, as in EXR, whose colours are premultiplied by alpha and usually linear,
 * and convert it to 8-bit RGB. */
void read_floats(OIIO::ImageInput &in, int n, int alpha, const float background[3], uint8_t *rgb)
{
    const OIIO::ImageSpec spec = in.spec();
    size_t n_pixels = static_cast<size_t>(spec.width) * static_cast<size_t>(spec.height);
    bool linear = spec.get_string_attribute("oiio:ColorSpace", "Linear") != "sRGB";
    std::vector<float> all(n_pixels * static_cast<size_t>(n));

    if (!in.read_image(0, 0, 0, n, OIIO::TypeDesc::FLOAT, all.data()))
        fail(in.geterror());
    for (size_t i = 0; i < n_pixels; i++) {
        const float *from = all.data() + i * static_cast<size_t>(n);
        float a = alpha >= 0 ? from[alpha] : 1;

        for (int c = 0; c < 3; c++) {
            float v = a > 0 ? from[n < 3 ? 0 : c] / a : 0;
            float shown = (linear ? srgb_of_linear(v) : v) * a + background[c] * (1 - a);

            rgb[3 * i + static_cast<size_t>(c)] =
                static_cast<uint8_t>(shown > 0 ? std::min(shown, 1.0f) * 255 + 0.5f : 0);
        }
    }
}

enum spin_image_result image_size(const char *path, const char *format, int *width, int *height,
                                  int *channels, char *why, size_t n_why)
{
    return guarded(why, n_why, [&] {
        auto in = open_input(path, format);
        check_spec(in->spec(), INT64_MAX);
        *width = in->spec().width;
        *height = in->spec().height;
        *channels = in->spec().nchannels;
    });
}

enum spin_image_result image_read(const char *path, const char *format, int64_t max_pixels,
                                  const float background[3], int *width, int *height, uint8_t **rgb,
                                  char *why, size_t n_why)
{
    return guarded(why, n_why, [&] {
        auto in = open_input(path, format);
        const OIIO::ImageSpec spec = in->spec();
        check_spec(spec, max_pixels);
        int n = spec.nchannels < 4 ? spec.nchannels : 4;
        int alpha = n == 2 || n == 4 ? n - 1 : -1;
        size_t n_pixels = static_cast<size_t>(spec.width) * static_cast<size_t>(spec.height);
        std::unique_ptr<uint8_t, decltype(&std::free)> out(
            static_cast<uint8_t *>(std::malloc(3 * n_pixels)), &std::free);
        bool floats = std::strcmp(in->format_name(), "openexr") == 0;
        std::vector<uint8_t> other(n == 3 || floats ? 0 : n_pixels * static_cast<size_t>(n));
        uint8_t *pixels = n == 3 ? out.get() : other.data();

        if (!out)
            throw std::bad_alloc();
        alpha = alpha == spec.alpha_channel ? alpha : -1;
        if (floats)
            read_floats(*in, n, alpha, background, out.get());
        else if (!in->read_image(0, 0, 0, n, OIIO::TypeDesc::UINT8, pixels))
            fail(in->geterror());
        if (n != 3 && !floats)
            to_rgb(pixels, n_pixels, n, alpha, background, out.get());
        *width = spec.width;
        *height = spec.height;
        *rgb = out.release();
    });
}

void encode(const OIIO::ImageSpec &spec, const char *format, OIIO::TypeDesc type,
            const void *pixels, unsigned char **bytes, size_t *n_bytes)
{
    std::vector<unsigned char> file;
    OIIO::Filesystem::IOVecOutput sink(file);
    auto out = OIIO::ImageOutput::create(format);

    if (!out || !out->supports("ioproxy"))
        fail(std::string("OpenImageIO was built without ") + format);
    out->set_ioproxy(&sink);
    if (!out->open(std::string("image.") + format, spec) || !out->write_image(type, pixels) ||
        !out->close())
        fail(out->geterror());
    *bytes = static_cast<unsigned char *>(std::malloc(file.size() + 1));
    if (!*bytes)
        throw std::bad_alloc();
    std::memcpy(*bytes, file.data(), file.size());
    *n_bytes = file.size();
}

enum spin_image_result image_encode_png(int width, int height, const uint8_t *rgb,
                                        unsigned char **bytes, size_t *n_bytes, char *why,
                                        size_t n_why)
{
    return guarded(why, n_why, [&] {
        encode(OIIO::ImageSpec(width, height, 3, OIIO::TypeDesc::UINT8), "png",
               OIIO::TypeDesc::UINT8, rgb, bytes, n_bytes);
    });
}

/* Set the standard attributes of OpenEXR that describe the colours and the frame rate. OpenImageIO
 * stores the time of day as capDate unless DateTime exists; it ignores a DateTime that is not a
 * string, so that equal images give equal bytes. */
void describe_film(OIIO::ImageSpec &spec, const struct spin_image_out *image)
{
    static const float rec709[8] = {0.64f, 0.33f, 0.30f, 0.60f, 0.15f, 0.06f, 0.3127f, 0.3290f};

    spec.attribute("DateTime", 0);
    spec.attribute("chromaticities", OIIO::TypeDesc(OIIO::TypeDesc::FLOAT, 8), rec709);
    spec.attribute("ImageDescription",
                   image->linear
                       ? "Display-referred sRGB colours (Rec. 709 primaries, D65 white), decoded "
                         "to linear light with the sRGB curve"
                       : "Display-referred sRGB colours (Rec. 709 primaries, D65 white), encoded "
                         "with the sRGB curve");
    if (image->fps[0] > 0)
        spec.attribute("framesPerSecond", OIIO::TypeRational, image->fps);
}

enum spin_image_result image_encode(const struct spin_image_out *image, unsigned char **bytes,
                                    size_t *n_bytes, char *why, size_t n_why)
{
    return guarded(why, n_why, [&] {
        bool exr = std::strcmp(image->format, "openexr") == 0;
        OIIO::TypeDesc colour =
            exr ? (image->bits == 16 ? OIIO::TypeDesc::HALF : OIIO::TypeDesc::FLOAT)
                : (image->bits == 16 ? OIIO::TypeDesc::UINT16 : OIIO::TypeDesc::UINT8);
        OIIO::ImageSpec spec(image->width, image->height, image->n_channels, colour);

        spec.channelnames.assign(image->names, image->names + image->n_channels);
        if (image->n_channels > image->n_colours) {
            spec.channelformats.assign(static_cast<size_t>(image->n_channels),
                                       OIIO::TypeDesc::FLOAT);
            std::fill_n(spec.channelformats.begin(), image->n_colours, colour);
        }
        for (int c = 0; c < image->n_channels; c++)
            if (std::strcmp(image->names[c], "A") == 0)
                spec.alpha_channel = c;
        spec.attribute("oiio:ColorSpace", image->linear ? "Linear" : "sRGB");
        if (exr)
            describe_film(spec, image);
        else
            spec.attribute("oiio:UnassociatedAlpha", 1);
        encode(spec, image->format, OIIO::TypeDesc::FLOAT, image->pixels, bytes, n_bytes);
    });
}

} // namespace

/* ---- Messages of libpng --------------------------------------------------------------------- */

/* OpenImageIO's error handler for libpng stores the message and returns. libpng then prints the
 * message to stderr, and only then calls longjmp. To prevent the printing, OpenImageIO binds to the
 * png_set_error_fn() below instead of libpng's. That function installs a handler that calls
 * OpenImageIO's handler and then longjmp. Handlers of other callers are unaffected. */
namespace
{

using png_handler = void (*)(void *png, const char *message);
std::atomic<png_handler> kept;

void on_png_error(void *png, const char *message)
{
    static const auto jump =
        reinterpret_cast<void (*)(void *, int)>(dlsym(RTLD_NEXT, "png_longjmp"));

    kept.load()(png, message);
    if (jump)
        jump(png, 1);
}

} // namespace

extern "C" __attribute__((visibility("default"))) void
png_set_error_fn(void *png, void *context, png_handler error, png_handler warning)
{
    static const auto set = reinterpret_cast<void (*)(void *, void *, png_handler, png_handler)>(
        dlsym(RTLD_NEXT, "png_set_error_fn"));
    png_handler first = nullptr;

    if (error && (kept.compare_exchange_strong(first, error) || first == error))
        error = on_png_error;
    if (set)
        set(png, context, error, warning);
}

extern "C" const struct spin_image_shim spin_image_shim_table = {
    SPIN_IMAGE_SHIM_ABI, OIIO_VERSION_STRING, image_size,
    image_read,          image_encode_png,    image_encode};
