/* read-sound FILE: decodes the sound of a video, and prints its codec, and when it begins and ends
 * to be loud, in seconds of the video's time. */
#include <libavcodec/avcodec.h>
#include <libavformat/avformat.h>
#include <math.h>
#include <stdio.h>

static double first = NAN, last = NAN;

/* Sample i of the first channel: planar or interleaved floats. */
static double sample(const AVFrame *f, int i)
{
    const float *values = (const float *)(const void *)f->extended_data[0];

    return f->format == AV_SAMPLE_FMT_FLT ? values[i * f->ch_layout.nb_channels] : values[i];
}

static void hear(const AVFrame *f, double unit)
{
    for (int i = 0; i < f->nb_samples; i++) {
        double at = (double)f->pts * unit + (double)i / f->sample_rate;

        if (fabs(sample(f, i)) < 0.1)
            continue;
        first = isnan(first) ? at : first;
        last = at;
    }
}

int main(int argc, char **argv)
{
    AVFormatContext *file = NULL;
    const AVCodec *codec = NULL;
    AVCodecContext *c;
    AVPacket *packet = av_packet_alloc();
    AVFrame *frame = av_frame_alloc();
    int stream;

    if (argc != 2 || avformat_open_input(&file, argv[1], NULL, NULL) < 0 ||
        avformat_find_stream_info(file, NULL) < 0)
        return 1;
    stream = av_find_best_stream(file, AVMEDIA_TYPE_AUDIO, -1, -1, &codec, 0);
    if (stream < 0) {
        puts("none");
        return 0;
    }
    c = avcodec_alloc_context3(codec);
    avcodec_parameters_to_context(c, file->streams[stream]->codecpar);
    c->pkt_timebase = file->streams[stream]->time_base;
    if (avcodec_open2(c, codec, NULL) < 0)
        return 1;
    for (int more = 1; more;) {
        more = av_read_frame(file, packet) >= 0;
        if (more && packet->stream_index != stream) {
            av_packet_unref(packet);
            continue;
        }
        avcodec_send_packet(c, more ? packet : NULL);
        av_packet_unref(packet);
        while (avcodec_receive_frame(c, frame) >= 0)
            hear(frame, av_q2d(file->streams[stream]->time_base));
    }
    printf("%s from %.2f to %.2f of %.1f\n", avcodec_get_name(c->codec_id), first, last,
           (double)file->duration / AV_TIME_BASE);
    return 0;
}
