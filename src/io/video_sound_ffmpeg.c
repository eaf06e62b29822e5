/* The sound track of a video: decoded from a file in memory, resampled, and encoded as AAC for MP4
 * or as Opus for WebM. The track is as long as the video: samples before the first frame are
 * dropped, and silence is added before a sound that starts later, and after its end. */
#include "io/video_shim.h"

#include <libavcodec/avcodec.h>
#include <libavformat/avformat.h>
#include <libavutil/audio_fifo.h>
#include <libavutil/channel_layout.h>
#include <libavutil/opt.h>
#include <libswresample/swresample.h>
#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

enum { RATE = 48000, BIT_RATE = 192000, BUFFER = 1 << 16 };

/* A file in memory, read through AVIOContext. */
struct memory {
    const uint8_t *data;
    int64_t size, at;
};

struct spin_video_track {
    struct memory memory;
    AVIOContext *io;
    AVFormatContext *in, *out;
    AVCodecContext *decoder, *encoder;
    AVStream *from, *to;
    SwrContext *resample;
    AVAudioFifo *samples; /* resampled samples that are not encoded yet */
    AVFrame *frame, *coded;
    AVPacket *packet;
    /* number of samples to drop, and of silent samples to insert, at the beginning */
    int64_t skip, silence;
    int64_t next; /* samples encoded so far */
    float gain;
    bool ended;     /* the file has no more samples */
    bool finishing; /* the video has ended: encode the last audio frame even if it is shorter */
};

static int read_memory(void *opaque, uint8_t *to, int n)
{
    struct memory *m = opaque;
    int64_t left = m->size - m->at;

    if (left <= 0)
        return AVERROR_EOF;
    n = (int)(left < n ? left : n);
    memcpy(to, m->data + m->at, (size_t)n);
    m->at += n;
    return n;
}

static int64_t seek_memory(void *opaque, int64_t offset, int whence)
{
    struct memory *m = opaque;

    if (whence == AVSEEK_SIZE)
        return m->size;
    offset += whence == SEEK_CUR ? m->at : whence == SEEK_END ? m->size : 0;
    if (offset < 0 || offset > m->size)
        return AVERROR(EINVAL);
    return m->at = offset;
}

void spin_video_track_close(struct spin_video_track *t)
{
    if (!t)
        return;
    avcodec_free_context(&t->decoder);
    avcodec_free_context(&t->encoder);
    avformat_close_input(&t->in);
    if (t->io)
        av_freep(&t->io->buffer);
    avio_context_free(&t->io);
    swr_free(&t->resample);
    if (t->samples)
        av_audio_fifo_free(t->samples);
    av_frame_free(&t->frame);
    av_frame_free(&t->coded);
    av_packet_free(&t->packet);
    free(t);
}

/* ---- Opening --------------------------------------------------------------------------------- */

static int open_memory(struct spin_video_track *t)
{
    uint8_t *buffer = av_malloc(BUFFER);

    t->in = avformat_alloc_context();
    if (buffer)
        t->io = avio_alloc_context(buffer, BUFFER, 0, &t->memory, read_memory, NULL, seek_memory);
    if (!t->in || !t->io) {
        if (!t->io)
            av_free(buffer);
        return AVERROR(ENOMEM);
    }
    t->in->pb = t->io;
    return avformat_open_input(&t->in, "sound", NULL, NULL);
}

static int open_decoder(struct spin_video_track *t)
{
    const AVCodec *codec = NULL;
    int error = open_memory(t), stream;

    if (error >= 0)
        error = avformat_find_stream_info(t->in, NULL);
    if (error < 0)
        return error;
    stream = av_find_best_stream(t->in, AVMEDIA_TYPE_AUDIO, -1, -1, &codec, 0);
    if (stream < 0)
        return stream;
    t->from = t->in->streams[stream];
    t->decoder = avcodec_alloc_context3(codec);
    if (!t->decoder)
        return AVERROR(ENOMEM);
    error = avcodec_parameters_to_context(t->decoder, t->from->codecpar);
    t->decoder->pkt_timebase = t->from->time_base;
    return error < 0 ? error : avcodec_open2(t->decoder, codec, NULL);
}

static const AVCodec *choose_encoder(const char *format)
{
    const AVCodec *codec;

    if (strcmp(format, "webm") != 0)
        return avcodec_find_encoder(AV_CODEC_ID_AAC);
    codec = avcodec_find_encoder_by_name("libopus");
    return codec ? codec : avcodec_find_encoder(AV_CODEC_ID_OPUS);
}

/* Returns a sample format of the encoder: floats, if possible. */
static enum AVSampleFormat choose_samples(const AVCodec *codec)
{
    const enum AVSampleFormat *format = codec->sample_fmts;

    while (format && *format != -1 && *format != AV_SAMPLE_FMT_FLTP && *format != AV_SAMPLE_FMT_FLT)
        format++;
    return format && *format != -1 ? *format
           : codec->sample_fmts    ? codec->sample_fmts[0]
                                   : AV_SAMPLE_FMT_FLTP;
}

/* Open the encoder, with one channel if the sound is mono, else with two. */
static int open_encoder(struct spin_video_track *t, const char *format)
{
    const AVCodec *codec = choose_encoder(format);
    AVCodecContext *c = t->encoder = codec ? avcodec_alloc_context3(codec) : NULL;
    int error;

    if (!c)
        return codec ? AVERROR(ENOMEM) : AVERROR_ENCODER_NOT_FOUND;
    av_channel_layout_default(&c->ch_layout, t->decoder->ch_layout.nb_channels == 1 ? 1 : 2);
    c->sample_rate = RATE;
    c->sample_fmt = choose_samples(codec);
    c->bit_rate = BIT_RATE / 2 * c->ch_layout.nb_channels;
    c->time_base = (AVRational){1, RATE};
    /* FFmpeg's own encoder of Opus is marked experimental */
    c->strict_std_compliance = FF_COMPLIANCE_EXPERIMENTAL;
    if (t->out->oformat->flags & AVFMT_GLOBALHEADER)
        c->flags |= AV_CODEC_FLAG_GLOBAL_HEADER;
    error = avcodec_open2(c, codec, NULL);
    if (error < 0)
        return error;
    t->to = avformat_new_stream(t->out, NULL);
    if (!t->to)
        return AVERROR(ENOMEM);
    t->to->time_base = c->time_base;
    return avcodec_parameters_from_context(t->to->codecpar, c);
}

/* Open the resampler and the FIFO. Samples in the FIFO are planar floats, since the gain is applied
 * to them. */
static int open_buffers(struct spin_video_track *t)
{
    AVCodecContext *c = t->encoder;
    int error = swr_alloc_set_opts2(&t->resample, &c->ch_layout, AV_SAMPLE_FMT_FLTP, RATE,
                                    &t->decoder->ch_layout, t->decoder->sample_fmt,
                                    t->decoder->sample_rate, 0, NULL);

    if (error >= 0)
        error = swr_init(t->resample);
    t->samples = av_audio_fifo_alloc(AV_SAMPLE_FMT_FLTP, c->ch_layout.nb_channels, RATE);
    t->frame = av_frame_alloc();
    t->coded = av_frame_alloc();
    t->packet = av_packet_alloc();
    if (error >= 0 && (!t->samples || !t->frame || !t->coded || !t->packet))
        error = AVERROR(ENOMEM);
    return error;
}

int spin_video_track_open(struct AVFormatContext *file, const char *format,
                          const struct spin_video_sound *sound, struct spin_video_track **out)
{
    struct spin_video_track *t = calloc(1, sizeof *t);
    int64_t start = llrint(sound->start * RATE);
    int error;

    *out = t;
    if (!t)
        return AVERROR(ENOMEM);
    t->memory = (struct memory){sound->data, (int64_t)sound->size, 0};
    t->out = file;
    t->gain = (float)sound->gain;
    t->skip = start < 0 ? -start : 0;
    t->silence = start > 0 ? start : 0;
    error = open_decoder(t);
    if (error >= 0)
        error = open_encoder(t, format);
    return error < 0 ? error : open_buffers(t);
}

/* ---- Decoding -------------------------------------------------------------------------------- */

/* Applies the gain to n samples of each channel, and appends them to the FIFO, except those before
 * the first video frame. */
static int keep_samples(struct spin_video_track *t, uint8_t **plane, int n)
{
    int drop = t->skip < n ? (int)t->skip : n, error = 0;
    void *kept[2] = {NULL, NULL};

    t->skip -= drop;
    for (int c = 0; c < t->encoder->ch_layout.nb_channels; c++) {
        float *at = (float *)(void *)plane[c] + drop;

        for (int i = 0; i < n - drop; i++)
            at[i] *= t->gain;
        kept[c] = at;
    }
    if (n > drop)
        error = av_audio_fifo_write(t->samples, kept, n - drop);
    return error < 0 ? error : 0;
}

/* Resamples a decoded frame or, if `frame` is NULL, the samples that the resampler has buffered. */
static int resample_frame(struct spin_video_track *t, const AVFrame *frame)
{
    int n = swr_get_out_samples(t->resample, frame ? frame->nb_samples : 0), error;
    uint8_t *plane[2] = {NULL, NULL};

    if (n <= 0)
        return n;
    error =
        av_samples_alloc(plane, NULL, t->encoder->ch_layout.nb_channels, n, AV_SAMPLE_FMT_FLTP, 0);
    if (error < 0)
        return error;
    n = swr_convert(t->resample, plane, n, frame ? (const uint8_t **)frame->extended_data : NULL,
                    frame ? frame->nb_samples : 0);
    error = n < 0 ? n : keep_samples(t, plane, n);
    av_freep(&plane[0]);
    return error;
}

/* Sends the next packet of the sound to the decoder, or signals the end of the file. */
static int send_packet(struct spin_video_track *t)
{
    int error = av_read_frame(t->in, t->packet);

    if (error < 0)
        return avcodec_send_packet(t->decoder, NULL);
    if (t->packet->stream_index == t->from->index)
        error = avcodec_send_packet(t->decoder, t->packet);
    av_packet_unref(t->packet);
    return error == AVERROR_INVALIDDATA ? 0 : error; /* skip damaged packets */
}

static int decode_more(struct spin_video_track *t)
{
    int error = avcodec_receive_frame(t->decoder, t->frame);

    if (error == AVERROR(EAGAIN))
        return send_packet(t);
    if (error == AVERROR_EOF) {
        t->ended = true;
        return resample_frame(t, NULL);
    }
    if (error < 0)
        return error;
    error = resample_frame(t, t->frame);
    av_frame_unref(t->frame);
    return error;
}

/* ---- Encoding -------------------------------------------------------------------------------- */

static int write_packets(struct spin_video_track *t)
{
    for (;;) {
        int error = avcodec_receive_packet(t->encoder, t->packet);

        if (error == AVERROR(EAGAIN) || error == AVERROR_EOF)
            return 0;
        if (error < 0)
            return error;
        t->packet->stream_index = t->to->index;
        av_packet_rescale_ts(t->packet, t->encoder->time_base, t->to->time_base);
        error = av_interleaved_write_frame(t->out, t->packet);
        if (error < 0)
            return error;
    }
}

/* Fills an audio frame with n samples, as planar floats: first the silence to insert at the
 * beginning, then samples of the FIFO, then silence. */
static int fill_frame(struct spin_video_track *t, AVFrame *frame, int n)
{
    int channels = t->encoder->ch_layout.nb_channels;
    int quiet = t->silence < n ? (int)t->silence : n, had;
    void *at[2] = {NULL, NULL};

    for (int c = 0; c < channels; c++)
        at[c] = frame->data[c] + (size_t)quiet * sizeof(float);
    av_samples_set_silence(frame->data, 0, n, channels, AV_SAMPLE_FMT_FLTP);
    t->silence -= quiet;
    had = n > quiet ? av_audio_fifo_read(t->samples, at, n - quiet) : 0;
    return had < 0 ? had : 0;
}

/* Copies an audio frame, and converts it to the sample format of the encoder: interleaved floats
 * for libopus. */
static int convert_frame(const AVFrame *from, AVFrame *to)
{
    int channels = from->ch_layout.nb_channels, bytes = av_get_bytes_per_sample(to->format);

    if (to->format == AV_SAMPLE_FMT_FLTP)
        return av_frame_ref(to, from);
    if (to->format != AV_SAMPLE_FMT_FLT && to->format != AV_SAMPLE_FMT_S16)
        return AVERROR(ENOSYS);
    to->nb_samples = from->nb_samples;
    if (av_channel_layout_copy(&to->ch_layout, &from->ch_layout) < 0 ||
        av_frame_get_buffer(to, 0) < 0)
        return AVERROR(ENOMEM);
    for (int i = 0; i < from->nb_samples; i++)
        for (int c = 0; c < channels; c++) {
            const float *v = (const float *)(const void *)from->data[c] + i;
            uint8_t *out = to->data[0] + (size_t)(i * channels + c) * (size_t)bytes;
            int16_t whole = (int16_t)lrintf(32767 * fmaxf(-1, fminf(*v, 1)));

            memcpy(out, bytes == 2 ? (const void *)&whole : (const void *)v, (size_t)bytes);
        }
    return 0;
}

/* Encodes the next n samples. */
static int encode_frame(struct spin_video_track *t, int n)
{
    AVFrame *raw = av_frame_alloc();
    int error = raw ? 0 : AVERROR(ENOMEM);

    if (raw) {
        raw->format = AV_SAMPLE_FMT_FLTP;
        raw->nb_samples = n;
        raw->sample_rate = RATE;
        error = av_channel_layout_copy(&raw->ch_layout, &t->encoder->ch_layout);
    }
    if (error >= 0)
        error = av_frame_get_buffer(raw, 0);
    if (error >= 0)
        error = fill_frame(t, raw, n);
    t->coded->format = t->encoder->sample_fmt;
    if (error >= 0)
        error = convert_frame(raw, t->coded);
    t->coded->sample_rate = RATE;
    t->coded->pts = t->next;
    t->next += n;
    if (error >= 0)
        error = avcodec_send_frame(t->encoder, t->coded);
    av_frame_unref(t->coded);
    av_frame_free(&raw);
    return error < 0 ? error : write_packets(t);
}

int spin_video_track_write(struct spin_video_track *t, double seconds)
{
    int64_t end = llrint(seconds * RATE);
    int most = t->encoder->frame_size > 0 ? t->encoder->frame_size : 1024, error = 0;

    while (t->next < end && error >= 0) {
        int n = end - t->next < most ? (int)(end - t->next) : most;

        /* Only the last audio frame may be shorter: leave these samples to the next call. */
        if (n < most && !t->finishing)
            return 0;
        while (!t->ended && av_audio_fifo_size(t->samples) + t->silence < n && error >= 0)
            error = decode_more(t);
        if (error >= 0)
            error = encode_frame(t, n);
    }
    return error < 0 ? error : 0;
}

int spin_video_track_end(struct spin_video_track *t, double seconds)
{
    int error;

    t->finishing = true;
    error = spin_video_track_write(t, seconds);
    if (error >= 0)
        error = avcodec_send_frame(t->encoder, NULL);
    return error < 0 ? error : write_packets(t);
}
