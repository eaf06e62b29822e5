/* The decoder of video_shim.h, with libavformat, libavcodec and libswscale. Only local files are
 * opened: other protocols, playlists and references to other files are disabled. */
#include "io/video_shim.h"

#include <libavcodec/avcodec.h>
#include <libavformat/avformat.h>
#include <libavutil/imgutils.h>
#include <libswscale/swscale.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define MAX_FRAMES (1 << 22)

struct spin_video_stream {
    AVFormatContext *file;
    AVCodecContext *codec;
    AVPacket *packet;
    AVFrame *frame;
    struct SwsContext *scale;
    uint8_t *stored; /* [height][width][3] a frame as stored, if the file's rotation is not 0 */
    const struct spin_video_index *index;
    int stream_index; /* index of the video stream in the file */
    int draining;
};

static _Thread_local char why[256]; /* why this thread's last call failed */

static void set_why(int error, const char *what)
{
    char text[AV_ERROR_MAX_STRING_SIZE] = "";

    if (error != 0)
        av_strerror(error, text, sizeof text);
    snprintf(why, sizeof why, "%s%s%s", what, error ? ": " : "", text);
}

enum spin_video_result spin_video_fail(enum spin_video_result result, int error, const char *what)
{
    set_why(error, what);
    return error == AVERROR(ENOMEM) ? SPIN_VIDEO_NO_MEMORY : result;
}

/* ---- Opening --------------------------------------------------------------------------------- */

static enum spin_video_result open_file(const char *path, AVFormatContext **out, int *stream_index)
{
    AVDictionary *options = NULL;
    size_t n = strlen(path) + 6;
    char *url = malloc(n);
    int error;

    av_log_set_level(AV_LOG_QUIET);
    if (!url)
        return spin_video_fail(SPIN_VIDEO_NO_MEMORY, 0, "not enough memory");
    snprintf(url, n, "file:%s", path); /* a colon in the path could look like a protocol */
    av_dict_set(&options, "protocol_whitelist", "file", 0);
    av_dict_set(&options, "format_whitelist", "mov,mp4,matroska,webm", 0);
    error = avformat_open_input(out, url, NULL, &options);
    av_dict_free(&options);
    free(url);
    if (error < 0)
        return spin_video_fail(SPIN_VIDEO_UNREADABLE, error,
                               "not a readable MP4, QuickTime, Matroska or WebM file");
    error = avformat_find_stream_info(*out, NULL);
    if (error >= 0)
        error = *stream_index = av_find_best_stream(*out, AVMEDIA_TYPE_VIDEO, -1, -1, NULL, 0);
    if (error < 0) {
        avformat_close_input(out);
        return spin_video_fail(SPIN_VIDEO_UNREADABLE, error, "it contains no video stream");
    }
    for (unsigned i = 0; i < (*out)->nb_streams; i++) {
        if ((int)i != *stream_index)
            (*out)->streams[i]->discard = AVDISCARD_ALL;
    }
    return SPIN_VIDEO_OK;
}

static int by_pts(const void *a, const void *b)
{
    const struct spin_video_entry *x = a, *y = b;

    return x->pts < y->pts ? -1 : x->pts > y->pts;
}

static enum spin_video_result add_entry(struct spin_video_index *index, int64_t *room,
                                        const AVPacket *packet)
{
    if (packet->flags & AV_PKT_FLAG_DISCARD) /* skip frames that the file's edit list excludes */
        return SPIN_VIDEO_OK;
    if (packet->pts == AV_NOPTS_VALUE)
        return spin_video_fail(SPIN_VIDEO_UNREADABLE, 0, "its frames have no timestamps");
    if (index->n == MAX_FRAMES)
        return spin_video_fail(SPIN_VIDEO_TOO_LARGE, 0, "it has more than 4194304 frames");
    if (index->n == *room) {
        int64_t larger = *room ? 2 * *room : 512;
        void *block = realloc(index->entry, (size_t)larger * sizeof *index->entry);

        if (!block)
            return spin_video_fail(SPIN_VIDEO_NO_MEMORY, 0, "not enough memory");
        index->entry = block;
        *room = larger;
    }
    index->entry[index->n++] = (struct spin_video_entry){
        .pts = packet->pts,
        .dts = packet->dts != AV_NOPTS_VALUE ? packet->dts : packet->pts,
        .key = (packet->flags & AV_PKT_FLAG_KEY) != 0,
    };
    return SPIN_VIDEO_OK;
}

static enum spin_video_result list_frames(AVFormatContext *file, int stream_index,
                                          struct spin_video_index *out)
{
    AVPacket *packet = av_packet_alloc();
    enum spin_video_result result = SPIN_VIDEO_OK;
    int64_t room = 0;
    int error = 0;

    if (!packet)
        return spin_video_fail(SPIN_VIDEO_NO_MEMORY, 0, "not enough memory");
    while (result == SPIN_VIDEO_OK && (error = av_read_frame(file, packet)) >= 0) {
        if (packet->stream_index == stream_index)
            result = add_entry(out, &room, packet);
        av_packet_unref(packet);
    }
    av_packet_free(&packet);
    if (error == AVERROR(ENOMEM))
        return spin_video_fail(SPIN_VIDEO_NO_MEMORY, error, "its frames cannot be listed");
    if (result == SPIN_VIDEO_OK && out->n == 0)
        return spin_video_fail(SPIN_VIDEO_UNREADABLE, 0, "it has no frames");
    if (out->n > 0)
        qsort(out->entry, (size_t)out->n, sizeof *out->entry, by_pts);
    if (result == SPIN_VIDEO_OK && !out->entry[0].key)
        return spin_video_fail(SPIN_VIDEO_UNREADABLE, 0, "it does not begin with a key frame");
    return result;
}

/* Returns the display matrix of the file, in which phones record how they were held; NULL if there
 * is none. */
static const int32_t *display_matrix(const AVStream *stream)
{
#if LIBAVFORMAT_VERSION_INT >= AV_VERSION_INT(60, 15, 100)
    const AVPacketSideData *data =
        av_packet_side_data_get(stream->codecpar->coded_side_data,
                                stream->codecpar->nb_coded_side_data, AV_PKT_DATA_DISPLAYMATRIX);

    return data && data->size >= 9 * sizeof(int32_t) ? (const int32_t *)(const void *)data->data
                                                     : NULL;
#else
    size_t size = 0;
    const uint8_t *data = av_stream_get_side_data(stream, AV_PKT_DATA_DISPLAYMATRIX, &size);

    return size >= 9 * sizeof(int32_t) ? (const int32_t *)(const void *)data : NULL;
#endif
}

/* Returns the sign of a matrix element, or 0 if it is less than a hundredth of `largest`. */
static int sign_of(int32_t value, double largest)
{
    return fabs((double)value) < 0.01 * largest ? 0 : value < 0 ? -1 : 1;
}

/* Sets the size of the frames as players show them, and the rotation and mirroring that players
 * apply to stored frames. The rows of the display matrix are (a, b, u), (c, d, v) and (tx, ty, w).
 * The matrix maps a stored position (x, y) to (a x + c y, b x + d y), plus a translation that is
 * ignored. */
static enum spin_video_result read_rotation(const AVStream *stream, struct spin_video_index *out)
{
    static const int32_t none[9] = {1 << 16, 0, 0, 0, 1 << 16, 0, 0, 0, 1 << 30};
    const int32_t *m = display_matrix(stream);
    double largest = 0;
    int a, b, c, d;

    m = m ? m : none;
    for (int i = 0; i < 5; i++)
        largest = i == 2 ? largest : fmax(largest, fabs((double)m[i]));
    a = sign_of(m[0], largest);
    b = sign_of(m[1], largest);
    c = sign_of(m[3], largest);
    d = sign_of(m[4], largest);
    if (largest == 0 || !!a == !!b || !!a != !!d || !!b != !!c)
        return spin_video_fail(SPIN_VIDEO_UNREADABLE, 0,
                               "its header turns the frames by an angle that is not a multiple of "
                               "90 degrees: re-encode it");
    out->swaps = b != 0;
    out->mirrors_x = a + c < 0;
    out->mirrors_y = b + d < 0;
    out->width = out->swaps ? stream->codecpar->height : stream->codecpar->width;
    out->height = out->swaps ? stream->codecpar->width : stream->codecpar->height;
    return SPIN_VIDEO_OK;
}

static enum spin_video_result read_stream(const AVStream *stream, int64_t max_pixels,
                                          struct spin_video_index *out)
{
    out->unit = av_q2d(stream->time_base);
    if (stream->codecpar->width < 1 || stream->codecpar->height < 1)
        return spin_video_fail(SPIN_VIDEO_UNREADABLE, 0, "its frames have no width or height");
    if (stream->codecpar->width > max_pixels / stream->codecpar->height)
        return spin_video_fail(SPIN_VIDEO_TOO_LARGE, 0, "its frames have too many pixels");
    return read_rotation(stream, out);
}

static enum spin_video_result video_index(const char *path, int64_t max_pixels,
                                          struct spin_video_index *out)
{
    AVFormatContext *file = NULL;
    enum spin_video_result result;
    int stream_index = 0;

    memset(out, 0, sizeof *out);
    result = open_file(path, &file, &stream_index);
    if (result != SPIN_VIDEO_OK)
        return result;
    result = read_stream(file->streams[stream_index], max_pixels, out);
    if (result == SPIN_VIDEO_OK)
        result = list_frames(file, stream_index, out);
    avformat_close_input(&file);
    if (result != SPIN_VIDEO_OK) {
        free(out->entry);
        memset(out, 0, sizeof *out);
    }
    return result;
}

static int stored_width(const struct spin_video_index *index)
{
    return index->swaps ? index->height : index->width;
}

static int stored_height(const struct spin_video_index *index)
{
    return index->swaps ? index->width : index->height;
}

static void video_close(struct spin_video_stream *s)
{
    if (!s)
        return;
    sws_freeContext(s->scale);
    free(s->stored);
    av_frame_free(&s->frame);
    av_packet_free(&s->packet);
    avcodec_free_context(&s->codec);
    avformat_close_input(&s->file);
    free(s);
}

static enum spin_video_result open_codec(struct spin_video_stream *s)
{
    const AVCodecParameters *parameters = s->file->streams[s->stream_index]->codecpar;
    const AVCodec *codec = avcodec_find_decoder(parameters->codec_id);
    int error;

    if (!codec)
        return spin_video_fail(SPIN_VIDEO_UNREADABLE, 0,
                               "the installed FFmpeg has no decoder for this format");
    s->codec = avcodec_alloc_context3(codec);
    s->packet = av_packet_alloc();
    s->frame = av_frame_alloc();
    if (!s->codec || !s->packet || !s->frame)
        return spin_video_fail(SPIN_VIDEO_NO_MEMORY, 0, "not enough memory");
    error = avcodec_parameters_to_context(s->codec, parameters);
    /* With several threads, FFmpeg would decode frames beyond the requested one. */
    s->codec->thread_count = 1;
    s->codec->max_pixels = (int64_t)s->index->width * s->index->height * 2;
    if (error >= 0)
        error = avcodec_open2(s->codec, codec, NULL);
    return error < 0
               ? spin_video_fail(SPIN_VIDEO_UNREADABLE, error, "its video stream cannot be decoded")
               : SPIN_VIDEO_OK;
}

static enum spin_video_result video_open(const char *path, const struct spin_video_index *index,
                                         struct spin_video_stream **out)
{
    struct spin_video_stream *s = calloc(1, sizeof *s);
    enum spin_video_result result;

    *out = NULL;
    if (!s)
        return spin_video_fail(SPIN_VIDEO_NO_MEMORY, 0, "not enough memory");
    s->index = index;
    result = open_file(path, &s->file, &s->stream_index);
    if (result == SPIN_VIDEO_OK)
        result = open_codec(s);
    if (result == SPIN_VIDEO_OK)
        *out = s;
    else
        video_close(s);
    return result;
}

/* ---- Decoding -------------------------------------------------------------------------------- */

static enum spin_video_result video_seek(struct spin_video_stream *s, int64_t key)
{
    /* Container formats index frames by decoding time. */
    int error =
        av_seek_frame(s->file, s->stream_index, s->index->entry[key].dts, AVSEEK_FLAG_BACKWARD);

    if (error < 0)
        return spin_video_fail(SPIN_VIDEO_UNREADABLE, error, "cannot seek to a key frame");
    avcodec_flush_buffers(s->codec);
    s->draining = 0;
    return SPIN_VIDEO_OK;
}

/* Returns the index of the frame with this presentation time, or -1 if there is none. */
static int64_t find_frame(const struct spin_video_index *index, int64_t pts)
{
    int64_t low = 0, high = index->n - 1;

    while (low <= high) {
        int64_t middle = low + (high - low) / 2;

        if (index->entry[middle].pts == pts)
            return middle;
        if (index->entry[middle].pts < pts)
            low = middle + 1;
        else
            high = middle - 1;
    }
    return -1;
}

/* Send the next packet to the decoder, or signal the end of the stream. */
static int send_packet(struct spin_video_stream *s)
{
    int error;

    for (;;) {
        error = av_read_frame(s->file, s->packet);
        if (error == AVERROR_EOF) {
            s->draining = 1;
            return avcodec_send_packet(s->codec, NULL);
        }
        if (error < 0)
            return error;
        if (s->packet->stream_index == s->stream_index)
            break;
        av_packet_unref(s->packet);
    }
    error = avcodec_send_packet(s->codec, s->packet);
    av_packet_unref(s->packet);
    return error;
}

static enum spin_video_result video_next(struct spin_video_stream *s, int64_t *frame)
{
    for (;;) {
        int error = avcodec_receive_frame(s->codec, s->frame);

        if (error == AVERROR_EOF)
            return spin_video_fail(SPIN_VIDEO_END, 0, "it ends before the requested frame");
        if (error == AVERROR(EAGAIN)) {
            error = s->draining ? AVERROR_EOF : send_packet(s);
            if (error < 0)
                return spin_video_fail(SPIN_VIDEO_UNREADABLE, error, "it is damaged or cut short");
            continue;
        }
        if (error < 0)
            return spin_video_fail(SPIN_VIDEO_UNREADABLE, error, "it is damaged or cut short");
        if (s->frame->width != stored_width(s->index) ||
            s->frame->height != stored_height(s->index))
            return spin_video_fail(SPIN_VIDEO_UNREADABLE, 0, "its frames differ in size");
        *frame = find_frame(s->index, s->frame->best_effort_timestamp);
        if (*frame >= 0)
            return SPIN_VIDEO_OK;
    }
}

/* ---- Pixels ---------------------------------------------------------------------------------- */

/* Returns the colour matrix that the file specifies. If the file specifies none, returns the usual
 * matrix for the size: BT.709 for 720 lines or more, else BT.601. */
static int colour_matrix(const AVFrame *frame)
{
    switch (frame->colorspace) {
    case AVCOL_SPC_BT709:
        return SWS_CS_ITU709;
    case AVCOL_SPC_BT470BG:
    case AVCOL_SPC_SMPTE170M:
        return SWS_CS_ITU601;
    case AVCOL_SPC_BT2020_NCL:
    case AVCOL_SPC_BT2020_CL:
        return SWS_CS_BT2020;
    default:
        return frame->height >= 720 ? SWS_CS_ITU709 : SWS_CS_ITU601;
    }
}

/* Converts the decoded frame to RGB, in its stored orientation. */
static enum spin_video_result stored_rgb(struct spin_video_stream *s, uint8_t *out)
{
    const AVFrame *frame = s->frame;
    int full = frame->color_range == AVCOL_RANGE_JPEG;
    uint8_t *planes[4] = {out, NULL, NULL, NULL};
    int lines[4] = {3 * frame->width, 0, 0, 0};

    s->scale = sws_getCachedContext(
        s->scale, frame->width, frame->height, (enum AVPixelFormat)frame->format, frame->width,
        frame->height, AV_PIX_FMT_RGB24, SWS_BICUBIC | SWS_ACCURATE_RND | SWS_FULL_CHR_H_INT, NULL,
        NULL, NULL);
    if (!s->scale && sws_isSupportedInput((enum AVPixelFormat)frame->format))
        return spin_video_fail(SPIN_VIDEO_NO_MEMORY, 0, "not enough memory");
    if (!s->scale)
        return spin_video_fail(SPIN_VIDEO_UNREADABLE, 0, "its pixel format is not supported");
    sws_setColorspaceDetails(s->scale, sws_getCoefficients(colour_matrix(frame)), full,
                             sws_getCoefficients(SWS_CS_ITU709), 1, 0, 1 << 16, 1 << 16);
    if (sws_scale(s->scale, (const uint8_t *const *)frame->data, frame->linesize, 0, frame->height,
                  planes, lines) != frame->height)
        return spin_video_fail(SPIN_VIDEO_UNREADABLE, 0, "its pixels cannot be converted to RGB");
    return SPIN_VIDEO_OK;
}

/* Copies a stored frame, turned and mirrored as players show it. */
static void turn_frame(const struct spin_video_index *index, const uint8_t *from, uint8_t *out)
{
    int width = stored_width(index), height = stored_height(index);

    for (int y = 0; y < height; y++)
        for (int x = 0; x < width; x++) {
            int u = index->swaps ? y : x, v = index->swaps ? x : y;

            u = index->mirrors_x ? index->width - 1 - u : u;
            v = index->mirrors_y ? index->height - 1 - v : v;
            memcpy(out + 3 * ((size_t)v * (size_t)index->width + (size_t)u),
                   from + 3 * ((size_t)y * (size_t)width + (size_t)x), 3);
        }
}

static enum spin_video_result video_rgb(struct spin_video_stream *s, uint8_t *out)
{
    const struct spin_video_index *index = s->index;
    enum spin_video_result result;

    if (!index->swaps && !index->mirrors_x && !index->mirrors_y)
        return stored_rgb(s, out);
    if (!s->stored)
        s->stored = malloc(3 * (size_t)index->width * (size_t)index->height);
    if (!s->stored)
        return spin_video_fail(SPIN_VIDEO_NO_MEMORY, 0, "not enough memory");
    result = stored_rgb(s, s->stored);
    if (result == SPIN_VIDEO_OK)
        turn_frame(index, s->stored, out);
    return result;
}

static const char *last_why(void) { return why; }

const struct spin_video_shim spin_video_shim_table = {
    SPIN_VIDEO_SHIM_ABI, LIBAVCODEC_IDENT, last_why,  video_index, video_open,
    video_seek,          video_next,       video_rgb, video_close, &spin_video_encoder_table,
};
