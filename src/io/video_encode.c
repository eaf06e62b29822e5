/* Writes videos through the shim: converts planar images to interleaved pixels, and reports
 * failures. */
#include <strings.h>

#include "base/base.h"
#include "io/video.h"
#include "io/video_shim.h"

struct spin_video_out {
    struct spin_out out; /* FFmpeg writes to the temporary name of this output */
    struct spin_video_writer *writer;
    int width, height;
    uint8_t *rgb;
};

static const struct spin_video_shim *shim;

static const char *format_of(const char *path)
{
    const char *dot = strrchr(path, '.');

    if (dot && strcasecmp(dot, ".mp4") == 0)
        return "mp4";
    return dot && strcasecmp(dot, ".webm") == 0 ? "webm" : NULL;
}

static void free_writer(struct spin_video_out *v)
{
    if (v->writer)
        shim->encoder->close(v->writer);
    free(v->rgb);
    free(v);
}

static spin_status fail_video(enum spin_video_result result, const char *path)
{
    return spin_fail(result == SPIN_VIDEO_NO_MEMORY ? SPIN_E_MEMORY : SPIN_E_IO,
                     "cannot write video '%s': %s", path, shim->why());
}

spin_status spin_video_create(const char *path, bool force, bool sync, int width, int height,
                              double fps, int quality, const struct spin_sound *sound,
                              struct spin_video_out **out, const char **codec)
{
    const struct spin_video_sound track = {sound ? sound->data : NULL, sound ? sound->size : 0,
                                           sound ? sound->start : 0, sound ? sound->gain : 1};
    const char *format = format_of(path);
    struct spin_video_out *v = NULL;
    enum spin_video_result result;
    spin_status status;

    *out = NULL;
    if (!format)
        return spin_misuse("video '%s': expected a name that ends in .mp4 or .webm", path);
    SPIN_TRY(spin_video_shim(&shim));
    SPIN_TRY(spin_alloc(1, sizeof *v, (void **)&v));
    v->width = width;
    v->height = height;
    /* swscale's SIMD code reads past the last pixel; memory for 16 more pixels suffices for all
     * variants of this code. */
    SPIN_TRY_OUT(spin_alloc((size_t)width * (size_t)height + 16, 3, (void **)&v->rgb));
    SPIN_TRY_OUT(spin_out_open(path, force, &v->out));
    v->out.sync = sync;
    result = shim->encoder->open(v->out.temporary, format, width, height, fps, quality,
                                 sound ? &track : NULL, &v->writer, codec);
    if (result != SPIN_VIDEO_OK) {
        status = fail_video(result, path);
        spin_out_abandon(&v->out);
        goto out;
    }
    *out = v;
    return SPIN_OK;
out:
    free_writer(v);
    return status;
}

spin_status spin_video_put(struct spin_video_out *v, const float *image)
{
    size_t n = (size_t)v->width * (size_t)v->height;
    enum spin_video_result result;

    for (size_t c = 0; c < 3; c++)
        for (size_t i = 0; i < n; i++) {
            float x = image[c * n + i];

            v->rgb[3 * i + c] = (uint8_t)(x > 0 ? (x < 1 ? x : 1) * 255.0f + 0.5f : 0);
        }
    result = shim->encoder->put(v->writer, v->rgb);
    return result == SPIN_VIDEO_OK ? SPIN_OK : fail_video(result, v->out.path);
}

spin_status spin_video_commit(struct spin_video_out *v)
{
    enum spin_video_result result = shim->encoder->end(v->writer);
    spin_status status;

    if (result != SPIN_VIDEO_OK) {
        status = fail_video(result, v->out.path);
        spin_out_abandon(&v->out);
    } else {
        status = spin_out_commit(&v->out);
    }
    free_writer(v);
    return status;
}

void spin_video_abandon(struct spin_video_out *v)
{
    if (!v)
        return;
    shim->encoder->close(v->writer);
    v->writer = NULL;
    spin_out_abandon(&v->out);
    free_writer(v);
}
