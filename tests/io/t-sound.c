/* Sound tracks: formats by content, durations, and WAV files that are cut. K: sound io export
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "base/log.h"
#include "io/sound.h"
#include "io/file.h"
#include "tests/check.h"
#include "tests/tap.h"

enum { RATE = 1000, N = 500, HEAD = 44 };

static unsigned char wav[HEAD + 2 * N];

static void put_integer(unsigned char *to, uint32_t value, int bytes)
{
    for (int i = 0; i < bytes; i++)
        to[i] = (unsigned char)(value >> 8 * i);
}

/* A WAV file of one channel, whose sample i is i + 1. */
static void make_wav(void)
{
    memcpy(wav, "RIFF....WAVEfmt ", 16);
    put_integer(wav + 4, sizeof wav - 8, 4);
    put_integer(wav + 16, 16, 4);
    put_integer(wav + 20, 1, 2);
    put_integer(wav + 22, 1, 2);
    put_integer(wav + 24, RATE, 4);
    put_integer(wav + 28, 2 * RATE, 4);
    put_integer(wav + 32, 2, 2);
    put_integer(wav + 34, 16, 2);
    memcpy(wav + 36, "data", 4);
    put_integer(wav + 40, 2 * N, 4);
    for (uint32_t i = 0; i < N; i++)
        put_integer(wav + HEAD + 2 * i, i + 1, 2);
}

static const char *type_of(const void *data, size_t size)
{
    struct spin_sound s;

    return spin_sound_set(&s, "x", data, size) == SPIN_OK ? s.type : "none";
}

static bool is_type(const char *type, const char *head, size_t n, size_t size)
{
    static unsigned char data[4096];

    memset(data, 0, sizeof data);
    memcpy(data, head, n);
    return strcmp(type_of(data, size), type) == 0;
}

/* Two frames of MPEG audio of 96 bytes each, or of AAC of 8 bytes each, at `at`. */
static bool has_frames(const char *type, const unsigned char *head, size_t n_head, size_t n,
                       size_t at)
{
    unsigned char data[512] = "ID3\4";

    data[9] = (unsigned char)(at > 0 ? at - 10 : 0);
    for (int k = 0; k < 2; k++)
        memcpy(data + at + n * (size_t)k, head, n_head);
    return strcmp(type_of(data, at + 2 * n), type) == 0;
}

static void test_types(void)
{
    static const char m4a[] = "\0\0\0\x18"
                              "ftypM4A ....hdlr\0\0\0\0\0\0\0\0soun";
    static const char mp4[] = "\0\0\0\x18"
                              "ftypisom....hdlr\0\0\0\0\0\0\0\0sounhdlr\0\0\0\0\0\0\0\0vide";
    static const unsigned char mp3[] = {0xff, 0xfb, 0x14, 0xc0}; /* 32 kbit/s at 48 kHz */
    static const unsigned char aac[] = {0xff, 0xf1, 0x50, 0x80, 0x01, 0x1f, 0xfc};
    static const unsigned char utf16[] = {0xff, 0xfe, 'a', 0};
    char ogg[] = "OggS.......................\x13OpusHead",
         vorbis[] = "OggS.......................\x1e\1vorbis";

    ogg[26] = vorbis[26] = 1;
    ok(strcmp(type_of(wav, sizeof wav), "wav") == 0, "WAV");
    ok(strcmp(type_of(wav, 40), "none") == 0, "but not without samples");
    ok(is_type("opus", ogg, sizeof ogg, 100) && is_type("vorbis", vorbis, sizeof vorbis, 100),
       "Opus and Vorbis in Ogg");
    ok(is_type("flac", "fLaC", 4, 100), "FLAC");
    ok(is_type("m4a", m4a, sizeof m4a, 100) && is_type("none", mp4, sizeof mp4, 100),
       "MP4 with sound, but not with a video");
    ok(has_frames("mp3", mp3, sizeof mp3, 96, 0) && has_frames("mp3", mp3, sizeof mp3, 96, 30) &&
           is_type("none", (const char *)mp3, sizeof mp3, 200),
       "MP3, also after a tag; one frame alone is too little");
    ok(has_frames("aac", aac, sizeof aac, 8, 0), "AAC");
    ok(is_type("none", (const char *)utf16, sizeof utf16, 100) && is_type("none", "hello", 5, 100),
       "no text");
    ok(strcmp(type_of(wav, 0), "none") == 0 && strstr(spin_last_error(), "0 bytes"),
       "no empty file");
}

static void test_names(void)
{
    struct spin_sound s;

    ok(spin_sound_set(&s, "a/b.c/tone.take 2.wav", wav, sizeof wav) == SPIN_OK &&
           strcmp(s.name, "tone.take 2") == 0 && s.gain == 1 && s.start == 0,
       "the name lacks folder and extension");
    ok(strcmp(spin_sound_mime(&s), "audio/wav") == 0 && strcmp(spin_sound_ending(&s), ".wav") == 0,
       "media type and extension");
    ok(spin_sound_set(&s, "\33[2J.wav", wav, sizeof wav) == SPIN_OK && !strchr(s.name, 27),
       "the name is safe to print");
}

static void test_seconds(void)
{
    unsigned char opus[200] = "OggS", *page = opus + 100;
    struct spin_sound s;

    opus[26] = 1;
    memcpy(opus + 28, "OpusHead", 8);
    put_integer(opus + 38, 312, 2);
    memcpy(page, "OggS", 4);
    put_integer(page + 6, 24312, 4);
    ok(spin_sound_set(&s, "x", opus, sizeof opus) == SPIN_OK && spin_sound_seconds(&s) == 0.5,
       "Opus: the last page minus the samples to skip");
    ok(spin_sound_set(&s, "x", wav, sizeof wav) == SPIN_OK && spin_sound_seconds(&s) == 0.5,
       "WAV: the number of samples");
}

/* Returns sample i of an aligned file. */
static int sample(const struct spin_sound *s, size_t i)
{
    return s->data[HEAD + 2 * i] | s->data[HEAD + 2 * i + 1] << 8;
}

static void test_align(void)
{
    struct spin_sound s, out;
    unsigned char *owned;

    ok(spin_sound_set(&s, "x", wav, sizeof wav) == SPIN_OK, "a file to cut");
    ok(spin_sound_align(&s, &out, &owned) == SPIN_OK && out.data == wav && !owned,
       "a file that starts with the clip is not copied");
    s.start = -0.1;
    ok(spin_sound_align(&s, &out, &owned) == SPIN_OK && out.start == 0 && sample(&out, 0) == 101 &&
           spin_sound_seconds(&out) == 0.4 && out.size == HEAD + 800 &&
           out.data[4] == (HEAD + 792) % 256,
       "the samples before the first frame are dropped");
    free(owned);
    s.start = 0.25;
    ok(spin_sound_align(&s, &out, &owned) == SPIN_OK && out.start == 0 && sample(&out, 249) == 0 &&
           sample(&out, 250) == 1 && sample(&out, 749) == N && spin_sound_seconds(&out) == 0.75,
       "silence precedes a later sound");
    free(owned);
    s.start = 1e9;
    ok(spin_sound_align(&s, &out, &owned) == SPIN_OK && !owned && out.start == 1e9,
       "but not more than fits");
    put_integer(wav + 20, 0x11, 2);
    s.start = -0.1;
    ok(spin_sound_align(&s, &out, &owned) == SPIN_OK && !owned && out.start == -0.1,
       "compressed samples are not cut");
    make_wav();
}

TAP_MAIN
{
    spin_log_set_level(-1);
    make_wav();
    test_types();
    test_names();
    test_seconds();
    test_align();
}
