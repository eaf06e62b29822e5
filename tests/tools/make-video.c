/* make-video OUT.mp4 FRAMES WIDTH HEIGHT [SEED [FPS [DROPPED]]]: a video to test with, as cameras
 * leave them: key frames only every eighth frame, and frames between them that need what comes
 * later. The time of frame DROPPED and of later frames is one frame later. Frame f is a
 * flat colour of its own, which tests/io/t-video.c knows, and a white square that wanders. */
#include <libavcodec/avcodec.h>
#include <libavformat/avformat.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static void fail(const char *what)
{
    fprintf(stderr, "make-video: %s\n", what);
    exit(1);
}

/* Y, U and V of a frame: limited range and BT.601, the defaults of unlabelled video. */
static void fill(AVFrame *frame, int f, int seed)
{
    const int value[3] = {40 + (f * 11 + seed * 5) % 160, 128 + (f * 7) % 60 - 30,
                          128 + (f * 13 + seed) % 60 - 30};

    for (int p = 0; p < 3; p++) {
        int height = p ? frame->height / 2 : frame->height;

        for (int y = 0; y < height; y++)
            memset(frame->data[p] + y * frame->linesize[p], value[p], (size_t)frame->linesize[p]);
    }
    for (int y = 0; y < 8; y++)
        memset(frame->data[0] + y * frame->linesize[0] + (f * 2) % (frame->width - 8), 235, 8);
}

static void drain(AVCodecContext *codec, AVFormatContext *file, AVStream *stream, AVPacket *packet)
{
    while (avcodec_receive_packet(codec, packet) >= 0) {
        packet->stream_index = stream->index;
        packet->duration = 1; /* otherwise the last frame might be outside the edit list */
        av_packet_rescale_ts(packet, codec->time_base, stream->time_base);
        if (av_interleaved_write_frame(file, packet) < 0)
            fail("cannot write a packet");
    }
}

static AVCodecContext *open_codec(int width, int height, int fps, int global_header)
{
    static const char *const names[] = {"libx264", "mpeg4"};

    for (int i = 0; i < 2; i++) {
        const AVCodec *found = avcodec_find_encoder_by_name(names[i]);
        AVCodecContext *codec = found ? avcodec_alloc_context3(found) : NULL;
        AVDictionary *options = NULL;

        if (!codec)
            continue;
        codec->width = width;
        codec->height = height;
        codec->time_base = (AVRational){1, fps};
        codec->pix_fmt = AV_PIX_FMT_YUV420P;
        codec->gop_size = 8;
        codec->max_b_frames = 2;
        codec->bit_rate = 4000000;
        codec->thread_count = 1;
        if (global_header)
            codec->flags |= AV_CODEC_FLAG_GLOBAL_HEADER;
        av_dict_set(&options, "crf", "4", 0);
        av_dict_set(&options, "x264-params", "scenecut=0:keyint=8:open-gop=0", 0);
        if (avcodec_open2(codec, found, &options) >= 0) {
            av_dict_free(&options);
            return codec;
        }
        av_dict_free(&options);
        avcodec_free_context(&codec);
    }
    fail("this FFmpeg has no encoder for it");
    return NULL;
}

int main(int argc, char **argv)
{
    int n = argc > 4 ? atoi(argv[2]) : 0, width = argc > 4 ? atoi(argv[3]) : 0,
        height = argc > 4 ? atoi(argv[4]) : 0, seed = argc > 5 ? atoi(argv[5]) : 0,
        fps = argc > 6 ? atoi(argv[6]) : 30, dropped = argc > 7 ? atoi(argv[7]) : n;
    AVFormatContext *file = NULL;
    AVPacket *packet = av_packet_alloc();
    AVFrame *frame = av_frame_alloc();
    AVCodecContext *codec;
    AVStream *stream;

    av_log_set_level(AV_LOG_QUIET);
    if (n < 1 || width < 16 || height < 16)
        fail("expected OUT.mp4 FRAMES WIDTH HEIGHT [SEED [FPS [DROPPED]]]");
    if (avformat_alloc_output_context2(&file, NULL, "mp4", argv[1]) < 0)
        fail("this FFmpeg cannot write mp4");
    codec = open_codec(width, height, fps, file->oformat->flags & AVFMT_GLOBALHEADER);
    stream = avformat_new_stream(file, NULL);
    if (!stream || avcodec_parameters_from_context(stream->codecpar, codec) < 0 ||
        avio_open(&file->pb, argv[1], AVIO_FLAG_WRITE) < 0 || avformat_write_header(file, NULL) < 0)
        fail("cannot begin the file");
    frame->format = codec->pix_fmt;
    frame->width = width;
    frame->height = height;
    if (av_frame_get_buffer(frame, 0) < 0)
        fail("not enough memory");
    for (int f = 0; f < n; f++) {
        if (av_frame_make_writable(frame) < 0)
            fail("not enough memory");
        fill(frame, f, seed);
        frame->pts = f + (f >= dropped);
        if (avcodec_send_frame(codec, frame) < 0)
            fail("cannot encode");
        drain(codec, file, stream, packet);
    }
    avcodec_send_frame(codec, NULL);
    drain(codec, file, stream, packet);
    if (av_write_trailer(file) < 0)
        fail("cannot end the file");
    avio_closep(&file->pb);
    avformat_free_context(file);
    avcodec_free_context(&codec);
    av_frame_free(&frame);
    av_packet_free(&packet);
    return 0;
}
