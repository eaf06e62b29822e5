/* The encoder of video_shim.h, with libavcodec, libavformat and libswscale. MP4 files contain H.264
 * if x264 is available, else MPEG-4; WebM files contain VP9 if an encoder for it is available, else
 * VP8. Colours are converted to BT.709, and the file states this. */
#include "io/video_shim.h"

#include <libavcodec/avcodec.h>
#include <libavformat/avformat.h>
#include <libavutil/opt.h>
#include <libswscale/swscale.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

struct spin_video_writer {
    AVFormatContext *file;
    AVCodecContext *codec;
    AVStream *stream;
    AVFrame *frame;
    AVPacket *packet;
    struct spin_video_track *track; /* NULL: there is no sound */
    struct SwsContext *scale;
    /* The image with its sides padded to even sizes, [height][width][3]; NULL if the sides are
     * even. */
    uint8_t *even;
    int width, height; /* size of the input images */
    int64_t next;
};

static enum spin_video_result fail(int error, const char *what)
{
    return spin_video_fail(SPIN_VIDEO_UNREADABLE, error, what);
}

static const AVCodec *choose_encoder(const char *format)
{
    static const char *const mp4[] = {"libx264", "mpeg4", NULL};
    static const char *const webm[] = {"libvpx-vp9", "libvpx", NULL};
    const char *const *name = strcmp(format, "webm") == 0 ? webm : mp4;
    const AVCodec *codec = NULL;

    for (; *name && !codec; name++)
        codec = avcodec_find_encoder_by_name(*name);
    return codec;
}

/* Set the quality, converted from the scale 0..51 to that of the encoder. */
static void set_quality(AVCodecContext *c, int quality)
{
    char crf[16];

    if (strcmp(c->codec->name, "mpeg4") == 0) {
        c->flags |= AV_CODEC_FLAG_QSCALE;
        c->global_quality = FF_QP2LAMBDA * (1 + quality * 30 / 51);
        return;
    }
    /* Of all encoders used here, only those of VP8 and VP9 have names that begin with "libv". */
    snprintf(crf, sizeof crf, "%d", c->codec->name[3] == 'v' ? 4 + quality : quality);
    av_opt_set(c->priv_data, "crf", crf, 0);
    if (c->codec->name[3] == 'v')
        av_opt_set(c->priv_data, "cpu-used", "4", 0);
}

static void close_writer(struct spin_video_writer *w)
{
    if (!w)
        return;
    spin_video_track_close(w->track);
    sws_freeContext(w->scale);
    av_frame_free(&w->frame);
    av_packet_free(&w->packet);
    avcodec_free_context(&w->codec);
    if (w->file) {
        avio_closep(&w->file->pb);
        avformat_free_context(w->file);
    }
    free(w->even);
    free(w);
}

static int open_codec(struct spin_video_writer *w, const AVCodec *codec, double fps, int quality)
{
    AVCodecContext *c = w->codec = avcodec_alloc_context3(codec);
    int error;

    if (!c)
        return AVERROR(ENOMEM);
    c->width = w->width + (w->width & 1);
    c->height = w->height + (w->height & 1);
    c->framerate = av_d2q(fps, 100000);
    c->time_base = av_inv_q(c->framerate);
    c->pix_fmt = AV_PIX_FMT_YUV420P;
    c->color_range = AVCOL_RANGE_MPEG;
    c->colorspace = AVCOL_SPC_BT709;
    c->color_primaries = AVCOL_PRI_BT709;
    c->color_trc = AVCOL_TRC_BT709;
    c->gop_size = 30;
    if (w->file->oformat->flags & AVFMT_GLOBALHEADER)
        c->flags |= AV_CODEC_FLAG_GLOBAL_HEADER;
    set_quality(c, quality);
    error = avcodec_open2(c, codec, NULL);
    if (error < 0)
        return error;
    w->stream = avformat_new_stream(w->file, NULL);
    if (!w->stream)
        return AVERROR(ENOMEM);
    w->stream->time_base = c->time_base;
    w->stream->avg_frame_rate = c->framerate;
    return avcodec_parameters_from_context(w->stream->codecpar, c);
}

static int open_frame(struct spin_video_writer *w)
{
    AVCodecContext *c = w->codec;

    w->packet = av_packet_alloc();
    w->frame = av_frame_alloc();
    if (!w->packet || !w->frame)
        return AVERROR(ENOMEM);
    w->frame->format = c->pix_fmt;
    w->frame->width = c->width;
    w->frame->height = c->height;
    w->frame->colorspace = c->colorspace;
    w->frame->color_range = c->color_range;
    if (c->width != w->width || c->height != w->height) {
        w->even = malloc((size_t)c->width * (size_t)c->height * 3);
        if (!w->even)
            return AVERROR(ENOMEM);
    }
    w->scale = sws_getContext(c->width, c->height, AV_PIX_FMT_RGB24, c->width, c->height,
                              c->pix_fmt, SWS_BICUBIC | SWS_ACCURATE_RND, NULL, NULL, NULL);
    if (!w->scale) /* both pixel formats are supported, so this is a lack of memory */
        return AVERROR(ENOMEM);
    sws_setColorspaceDetails(w->scale, sws_getCoefficients(SWS_CS_ITU709), 1,
                             sws_getCoefficients(SWS_CS_ITU709), 0, 0, 1 << 16, 1 << 16);
    return av_frame_get_buffer(w->frame, 0);
}

static enum spin_video_result video_open(const char *path, const char *format, int width,
                                         int height, double fps, int quality,
                                         const struct spin_video_sound *sound,
                                         struct spin_video_writer **out, const char **name)
{
    struct spin_video_writer *w = calloc(1, sizeof *w);
    const AVCodec *codec = choose_encoder(format);
    AVDictionary *options = NULL;
    int error, sound_error = 0;

    av_log_set_level(AV_LOG_QUIET);
    if (!w || !codec) {
        free(w);
        return fail(w ? 0 : AVERROR(ENOMEM),
                    w ? "the installed FFmpeg has no encoder for this format"
                      : "cannot start encoding");
    }
    w->width = width;
    w->height = height;
    error = avformat_alloc_output_context2(&w->file, NULL, format, NULL);
    if (error >= 0)
        error = open_codec(w, codec, fps, quality);
    if (error >= 0)
        error = open_frame(w);
    if (error >= 0 && sound)
        error = sound_error = spin_video_track_open(w->file, format, sound, &w->track);
    if (error >= 0)
        error = avio_open(&w->file->pb, path, AVIO_FLAG_WRITE);
    if (error >= 0) {
        w->file->flags |= AVFMT_FLAG_BITEXACT; /* write neither date nor version into the file */
        error = avformat_write_header(w->file, &options);
    }
    av_dict_free(&options);
    if (error < 0) {
        close_writer(w);
        return fail(error, sound_error < 0 ? "cannot decode the sound, or cannot start its encoder"
                                           : "cannot start encoding");
    }
    *name = codec->name;
    *out = w;
    return SPIN_VIDEO_OK;
}

/* Write all packets that the encoder has ready. */
static int write_packets(struct spin_video_writer *w)
{
    for (;;) {
        int error = avcodec_receive_packet(w->codec, w->packet);

        if (error == AVERROR(EAGAIN) || error == AVERROR_EOF)
            return 0;
        if (error < 0)
            return error;
        w->packet->stream_index = w->stream->index;
        w->packet->duration = 1;
        av_packet_rescale_ts(w->packet, w->codec->time_base, w->stream->time_base);
        error = av_interleaved_write_frame(w->file, w->packet);
        if (error < 0)
            return error;
    }
}

/* Returns the image with even width and height. If the width is odd, the last column is repeated;
 * if the height is odd, the last row is repeated. */
static const uint8_t *pad_to_even(struct spin_video_writer *w, const uint8_t *rgb)
{
    size_t to = 3 * (size_t)w->codec->width, from = 3 * (size_t)w->width;

    if (!w->even)
        return rgb;
    for (int y = 0; y < w->codec->height; y++) {
        const uint8_t *line = rgb + (size_t)(y < w->height ? y : w->height - 1) * from;
        uint8_t *out = w->even + (size_t)y * to;

        memcpy(out, line, from);
        if (to > from)
            memcpy(out + from, line + from - 3, 3);
    }
    return w->even;
}

/* Returns the duration in seconds of the frames so far. */
static double seconds_of(const struct spin_video_writer *w)
{
    return (double)w->next * av_q2d(w->codec->time_base);
}

static enum spin_video_result video_put(struct spin_video_writer *w, const uint8_t *rgb)
{
    const uint8_t *planes[4] = {pad_to_even(w, rgb), NULL, NULL, NULL};
    int lines[4] = {3 * w->codec->width, 0, 0, 0};
    int error = av_frame_make_writable(w->frame);

    if (error >= 0 && sws_scale(w->scale, planes, lines, 0, w->codec->height, w->frame->data,
                                w->frame->linesize) != w->codec->height)
        error = AVERROR(EINVAL);
    w->frame->pts = w->next++;
    if (w->codec->flags & AV_CODEC_FLAG_QSCALE)
        w->frame->quality = w->codec->global_quality;
    if (error >= 0)
        error = avcodec_send_frame(w->codec, w->frame);
    if (error >= 0)
        error = write_packets(w);
    if (error >= 0 && w->track)
        error = spin_video_track_write(w->track, seconds_of(w));
    return error < 0 ? fail(error, "cannot write a frame") : SPIN_VIDEO_OK;
}

static enum spin_video_result video_end(struct spin_video_writer *w)
{
    int error = avcodec_send_frame(w->codec, NULL);

    if (error >= 0)
        error = write_packets(w);
    if (error >= 0 && w->track)
        error = spin_video_track_end(w->track, seconds_of(w));
    if (error >= 0)
        error = av_write_trailer(w->file);
    if (error >= 0)
        error = avio_closep(&w->file->pb);
    return error < 0 ? fail(error, "cannot finish the file") : SPIN_VIDEO_OK;
}

const struct spin_video_encoder spin_video_encoder_table = {video_open, video_put, video_end,
                                                            close_writer};
